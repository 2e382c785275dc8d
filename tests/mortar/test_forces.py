# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Force and moment through a tie: those of the loads, whichever side is Γ1."""

from mpi4py import MPI

import numpy as np
import pytest

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import Tie, TiedProblem

comm = MPI.COMM_WORLD
two_ranks = pytest.mark.ranks(2)


def stacked(dim, finer):
    """Two blocks, the upper one with a load on its top."""
    sides, a, L, bcs = [], [], [], []
    lower, upper = (meshes.BOTTOM, meshes.TOP) if dim == 2 else (meshes.BACK, meshes.FRONT)
    for i in range(2):
        n = 5 if i == finer else 3
        lift = np.eye(dim)[-1] * i
        cells = (
            {"n": (n, 2), "cell": "quadrilateral"}
            if dim == 2
            else {"n": (n, n, 2), "cell": "tetrahedron"}
        )
        mesh, ft = meshes.block(comm, mapping=lambda x, lift=lift: x + lift, **cells)
        V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        a.append(ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx)
        load = np.array((0.3, -0.2, 0.1)[:dim]) * i
        f = fem.Constant(mesh, default_scalar_type(load))
        ds = ufl.Measure("ds", mesh, subdomain_data=ft)
        L.append(ufl.inner(f, v) * ds(upper))
        sides.append((V, ft.find(lower if i else upper)))
        if i == 0:
            dofs = fem.locate_dofs_topological(V, dim - 1, ft.find(lower))
            bcs.append(fem.dirichletbc(fem.Function(V), dofs))
    return sides, a, L, bcs


@two_ranks
@pytest.mark.parametrize("dim", (2, 3))
@pytest.mark.parametrize("finer", (0, 1))
def test_force_and_moment(dim, finer):
    """The moment of λ itself is off, that of the forces at nodes isn't."""
    sides, a, L, bcs = stacked(dim, finer)
    tie = Tie.between(*sides)
    assert tie.swapped is (finer == 1)
    problem = TiedProblem(a, L, bcs=bcs, ties=[tie])
    u = problem.solve()
    load, origin = np.array((0.3, -0.2, 0.1)[:dim]), np.zeros(dim)
    arm = np.array((0.5, 0.5, 2.0) if dim == 3 else (0.5, 2.0))
    moment = (
        np.atleast_1d(np.cross(arm, load)) if dim == 3 else arm[:1] * load[1] - arm[1] * load[0]
    )
    for on, sign in ((None, -1), (u[0], 1), (u[1], -1)):  # what is below bears the loads
        np.testing.assert_allclose(tie.force(problem, on=on), sign * load, atol=1e-12)
        np.testing.assert_allclose(tie.moment(problem, origin, on=on), sign * moment, atol=1e-12)
    assert abs(tie.area - 1) <= 1e-13
    q = tie.quadrature(4)
    t, x = q.evaluate(tie.traction(problem)), q.x
    own = q.integrate(x[..., 0] * t[..., 1] - x[..., 1] * t[..., 0])
    mine = tie.moment(problem, origin, on=u[1 if tie.swapped else 0])[-1]
    assert 1e-6 < abs(own - mine) < 0.1


@two_ranks
def test_force_of_a_component():
    """Heat, and one component of a displacement."""
    sides, *_ = stacked(2, 0)
    a, L, bcs, ends = [], [], [], []
    for i, (V, facets) in enumerate(sides):
        W = fem.functionspace(V.mesh, ("Lagrange", 1))
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        a.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        L.append(ufl.inner(fem.Constant(W.mesh, default_scalar_type(i)), v) * ufl.dx)
        if i == 0:
            dofs = fem.locate_dofs_geometrical(W, lambda x: np.isclose(x[1], 0))
            bcs.append(fem.dirichletbc(fem.Function(W), dofs))
        ends.append((W, facets))
    tie = Tie(*ends)
    problem = TiedProblem(a, L, bcs=bcs, ties=[tie])
    u = problem.solve()
    np.testing.assert_allclose(tie.force(problem, on=u[0]), [1], atol=1e-12)
    with pytest.raises(ValueError, match="a moment needs displacements"):
        tie.moment(problem, (0, 0))
    with pytest.raises(ValueError, match="on= takes the displacement"):
        tie.force(problem, on=fem.Function(sides[0][0]))
