# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The blocks that the pages' short examples are about: two of them, one on the other."""

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh

comm = MPI.COMM_WORLD


def facets_at(body, y, axis=1):
    """Facets of a body where a coordinate has a value."""
    return mesh.locate_entities_boundary(
        body, body.topology.dim - 1, lambda x: np.isclose(x[axis], y)
    )


def stress(u, E=100.0, nu=0.3):
    """Hooke's law."""
    eps = ufl.sym(ufl.grad(u))
    lmbda, mu = E * nu / (1 + nu) / (1 - 2 * nu), E / 2 / (1 + nu)
    return 2 * mu * eps + lmbda * ufl.tr(eps) * ufl.Identity(len(u))


def clamped(V, y):
    """No displacements where y has a value."""
    dofs = fem.locate_dofs_topological(V, 1, facets_at(V.mesh, y))
    return fem.dirichletbc(np.zeros(2), dofs, V)


def blocks(gap=0.0, cells=((8, 3), (5, 3)), narrow=0.0):
    """Two blocks, 2 long and 1 high; the upper one is shorter by ``narrow`` at both ends."""
    corners = [(0, 0), (2, 1)], [(narrow, 1 + gap), (2 - narrow, 2 + gap)]
    kind = mesh.CellType.quadrilateral
    return [mesh.create_rectangle(comm, c, n, kind) for c, n in zip(corners, cells)]


def linear(V):
    """Bilinear forms of elastic blocks, and a load on the upper one."""
    forms = []
    for W in V:
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        forms.append(ufl.inner(stress(u), ufl.sym(ufl.grad(v))) * ufl.dx)
    load = fem.Constant(V[1].mesh, (0.0, -1.0))
    return forms, [None, ufl.inner(load, ufl.TestFunction(V[1])) * ufl.dx]


def rubber(w, stiffness=1.0):
    """Residual of a neo-Hookean body."""
    D = ufl.Identity(2) + ufl.grad(w)
    J = ufl.det(D)
    psi = stiffness * (ufl.inner(D, D) - 2 - 2 * ufl.ln(J) + ufl.ln(J) ** 2) / 2
    return ufl.derivative(psi * ufl.dx, w)


def pressed(**options):
    """The upper block above the lower one: the contact, the problem, the motion of its top."""
    from hypergap_dolfinx import Contact, ContactProblem

    lower, upper = blocks(gap=0.1, narrow=0.5)
    V = [fem.functionspace(body, ("Lagrange", 1, (2,))) for body in (lower, upper)]
    u = [fem.Function(W) for W in V]
    top = fem.Constant(upper, (0.0, 0.0))
    dofs = fem.locate_dofs_topological(V[1], 1, facets_at(upper, 2.1))
    bcs = [clamped(V[0], 0), fem.dirichletbc(top, dofs, V[1])]
    contact = Contact.between((V[0], facets_at(lower, 1)), (V[1], facets_at(upper, 1.1)), **options)
    return contact, ContactProblem([rubber(w) for w in u], u, bcs=bcs, contacts=[contact]), top
