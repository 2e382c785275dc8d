# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Contact in space: the patch test of a block on a wider one."""

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx import mesh as meshing
from hypergap_dolfinx import Contact, ContactProblem

comm = MPI.COMM_WORLD
SPANS = (((0, 0, -0.5), (2, 2, 0)), ((0.5, 0.5, 0), (1.5, 1.5, 0.5)))


def boundary(mesh, axis, *places):
    """Facets in planes across an axis."""
    return meshing.locate_entities_boundary(
        mesh, 2, lambda x: np.isclose(x[axis][:, None], places).any(axis=1)
    )


def pressure_error(degree, n, swap, strain):
    """Blocks between walls, of which the lower one is loaded where it is free."""
    large = strain > 0.1
    stretch = 1 - strain
    p = 3 * strain
    if large:
        p = -(stretch - 1 / stretch + np.log(stretch) / stretch)
    u, F, bcs, sides = [], [], [], []
    for i, (low, high) in enumerate(SPANS):
        cells = (n[i], n[i], 1)
        mesh = meshing.create_box(comm, [low, high], cells, meshing.CellType.tetrahedron)
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        w = fem.Function(V)
        G, eps = ufl.Identity(3) + ufl.grad(w), ufl.sym(ufl.grad(w))
        J = ufl.det(G)
        psi = ufl.inner(eps, eps) + 0.5 * ufl.tr(eps) ** 2
        if large:
            psi = 0.5 * (ufl.inner(G, G) - 3 - 2 * ufl.ln(J)) + 0.5 * ufl.ln(J) ** 2
        form = ufl.derivative(psi * ufl.dx, w)
        held = [(c, boundary(mesh, c, low[c], high[c]), 0.0) for c in (0, 1)]
        held.append((2, boundary(mesh, 2, (low, high)[i][2]), 0.5 * strain * (1 - 2 * i)))
        for component, facets, value in held:
            dofs = fem.locate_dofs_topological(V.sub(component), 2, facets)
            bcs.append(fem.dirichletbc(default_scalar_type(value), dofs, V.sub(component)))
        facets = boundary(mesh, 2, 0)
        if i == 0:
            middle = meshing.compute_midpoints(mesh, 2, facets)
            free = np.sort(facets[(np.abs(middle[:, :2] - 1) > 0.5).any(axis=1)])
            tags = meshing.meshtags(mesh, 2, free, np.ones(len(free), dtype=np.int32))
            load = fem.Constant(mesh, default_scalar_type(p))
            form += load * ufl.TestFunction(V)[2] * ufl.Measure("ds", mesh, subdomain_data=tags)(1)
        u.append(w)
        F.append(form)
        sides.append((V, facets))
    contact = Contact(*(sides[::-1] if swap else sides))
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact], rtol=1e-12)
    problem.solve()
    force = contact.force(problem)[2] * (-1 if swap else 1)
    error = np.abs(contact.pressures(problem)[contact.active] / p - 1).max()
    return max(error, abs(force / p - 1))


@pytest.mark.ranks(2, swap=[False])
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("strain", (1e-3, 0.2))
def test_patch(strain, swap):
    assert pressure_error(1, (4, 3), swap, strain) <= 1e-11


def test_patch_of_degree_2():
    """Multipliers at vertices: their pressures pass through all nodes."""
    assert pressure_error(2, (4, 2), False, 1e-3) <= 1e-10
