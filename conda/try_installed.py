# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A tie and a contact in space, with the package that is installed: what its recipe tests."""

from mpi4py import MPI  # before dolfinx

import numpy as np

import hypergap_dolfinx
import ufl
from dolfinx import fem, mesh
from hypergap_dolfinx import Contact, ContactProblem, Tie, TiedProblem

boxes = [((0, 0, 0), (1, 1, 1)), ((0, 0, 1), (1, 1, 2))]
bodies = [mesh.create_box(MPI.COMM_WORLD, b, (n, n, n)) for b, n in zip(boxes, (2, 3), strict=True)]
V = [fem.functionspace(body, ("Lagrange", 1, (3,))) for body in bodies]


def facets(W, z):
    """Facets of a body at a height."""
    return mesh.locate_entities_boundary(W.mesh, 2, lambda x: np.isclose(x[2], z))


def prescribed(W, z, uz):
    """A displacement along z, the rest 0."""
    dofs = fem.locate_dofs_topological(W, 2, facets(W, z))
    return fem.dirichletbc(np.array((0, 0, uz)), dofs, W)


def form(u, v):
    """Elasticity without lateral contraction."""
    return ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx


sides = [(W, facets(W, 1)) for W in V]
bcs = [prescribed(V[0], 0, 0.0), prescribed(V[1], 2, -0.1)]

tie = Tie.between(*sides)
a = [form(ufl.TrialFunction(W), ufl.TestFunction(W)) for W in V]
problem = TiedProblem(a, [None, None], bcs=bcs, ties=[tie])
problem.solve()
q = tie.quadrature(2)
tied = abs(q.integrate(q.evaluate(tie.traction(problem)))[2])

u = [fem.Function(W) for W in V]
contact = Contact.between(*sides)
F = [form(w, ufl.TestFunction(W)) for w, W in zip(u, V, strict=True)]
pressed = ContactProblem(F, u, bcs=bcs, contacts=[contact])
pressed.solve()
touching = abs(contact.force(pressed)[2])

print(hypergap_dolfinx.__version__, hypergap_dolfinx.__file__)
print(f"force through the tie {tied:.4f}, through the contact {touching:.4f}")
assert abs(tied - 0.05) < 2e-3 and abs(touching - 0.05) < 2e-3
