# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which rigid motions are free: ties across a distance hold rotations, errors of meshes don't."""

from mpi4py import MPI

import numpy as np
import pytest
from assembly import rectangle
from helpers import two_ranks

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import SolveError, Tie, TiedProblem
from hypergap_dolfinx.algebra import rigid_motions
from hypergap_dolfinx.algebra.rigid_motions import Hindrance, free_motions
from hypergap_dolfinx.contact_solver.predictor import leading, turns_together
from meshes import BOTTOM, INNER, LEFT, OUTER, RIGHT, TOP

comm = MPI.COMM_WORLD
PULL = 0.7
AROUND = ((LEFT, RIGHT), (BOTTOM, TOP))


def corner(V):
    """The node at the origin, held."""
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[:2], 0).all(axis=0))
    return fem.dirichletbc(np.zeros(2, default_scalar_type), dofs, V)


def shearing(x):
    """A periodic displacement that vanishes at the corners."""
    return x[1] * (1 - x[1]), x[0] * (1 - x[0])


def cell(bcs=True, pairs=AROUND, **options):
    """A unit cell whose opposite faces, meshed differently, are tied to each other."""

    def shifted(x):
        return x + 0.15 * x[:, ::-1] * np.sin(np.pi * x)

    body = rectangle((4, 3), (0, 0), (1, 1), degree=2, mapping=shifted)
    x, v, n = ufl.SpatialCoordinate(body.mesh), ufl.TestFunction(body.V), ufl.FacetNormal(body.mesh)
    stress = body.stress(ufl.as_vector(shearing(x)))
    # Opposite faces are pulled apart too: the ties carry that
    L = ufl.inner(-ufl.div(stress), v) * ufl.dx + ufl.inner(stress * n + PULL * n, v) * ufl.ds
    ties = [Tie(*((body.V, body.facets(tag)) for tag in pair)) for pair in pairs]
    bcs = [corner(body.V)] if bcs else []
    return TiedProblem([body.a], [L], bcs=bcs, ties=ties, **options)


@two_ranks()
@pytest.mark.parametrize("solver, tolerance", (("direct", 1e-12), ("iterative", 1e-9)))
def test_an_elastic_cell(solver, tolerance):
    """One corner holds it: the ties hold the rotation, and carry what pulls the faces apart."""
    problem = cell(solver=solver)
    (u,) = problem.solve()
    exact = fem.Function(u.function_space)
    exact.interpolate(lambda x: np.array(shearing(x)))
    np.testing.assert_allclose(u.x.array, exact.x.array, atol=tolerance)
    for tie, load in zip(problem.ties, ((PULL, 0), (0, PULL)), strict=True):
        q = tie.quadrature(2)
        traction = q.evaluate(tie.traction(problem))
        np.testing.assert_allclose(
            traction, np.broadcast_to(load, traction.shape), atol=20 * tolerance
        )


def num_free(problem):
    problem.assemble_matrix()
    V = [u.function_space for u in problem.u]
    return free_motions(V, problem._K, problem._constraints)[0]


@pytest.mark.ranks(2)
@pytest.mark.parametrize("pairs", (AROUND, AROUND[:1], AROUND[1:]))
def test_a_cell_that_nothing_holds(pairs):
    """It can move as a whole, but not rotate: not even with one pair of faces tied."""
    assert num_free(cell(bcs=False, pairs=pairs)) == 2
    with pytest.raises(SolveError, match="singular: 2 rigid motions of the bodies are free"):
        cell(bcs=False, pairs=pairs).solve()


@pytest.mark.ranks(2, n=[(3, 7)])
@pytest.mark.parametrize("n", ((3, 7), (7, 3), (40, 3), (6, 30), (12, 12)))
def test_rings(n):
    """Polygons that don't fit each other, or leave a narrow gap: still no rotation is held."""
    sides, a = [], []
    for k, r, tag in zip(n, (1.0, 1.5), (OUTER, INNER), strict=True):
        mesh, ft = meshes.ring_sector(comm, k, 1, r, r + 0.5, angle=2 * np.pi)
        if n[0] == n[1] and tag == OUTER:
            mesh.geometry.x[:, :2] *= 0.98, 0.97
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        a.append(ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx)
        sides.append((V, ft.find(tag)))
    assert num_free(TiedProblem(a, [None, None], ties=[Tie(*sides)])) == 3


@pytest.mark.ranks(2)
def test_near_and_far_ties():
    """Two blocks with a crooked interface rotate as one; a third, far above, beside itself."""

    def crooked(low, high):
        def placed(x):
            edge = 0.1 * np.sin(3 * x[:, 0])
            y = low + (high - low) * x[:, 1] + edge * (x[:, 1] if low == 0 else 1 - x[:, 1])
            return np.column_stack((x[:, 0], y))

        return placed

    bodies = [
        rectangle((n, 3), 0, 0, mapping=crooked(*heights))
        for n, heights in ((4, (0, 1)), (7, (1, 2)))
    ]
    bodies.append(rectangle((5, 3), (0, 3), (1, 4)))
    near, far = (
        Tie(*((bodies[i + j].V, bodies[i + j].facets(tag)) for j, tag in enumerate((TOP, BOTTOM))))
        for i in (0, 1)
    )
    a, bc = [body.a for body in bodies], corner(bodies[0].V)
    assert num_free(TiedProblem(a[:2], [None] * 2, bcs=[bc], ties=[near])) == 1
    assert num_free(TiedProblem(a, [None] * 3, bcs=[bc], ties=[near, far])) == 1
    assert num_free(TiedProblem(a, [None] * 3, ties=[near, far])) == 3


def test_turns_together():
    """Translations don't turn, whatever round-off says; nor do bodies that turn on each other."""
    x = np.random.default_rng(2).random((20, 3))
    spin = np.cross((0.3, -0.2, 0.7), x)

    def motion(speed, shift):
        found = leading(MPI.COMM_SELF, x, speed * spin + shift)
        assert found is not None
        return found

    for shift in np.random.default_rng(3).random((50, 3)):
        assert not turns_together(motion(0, shift), motion(0, 0.3 * shift))
    assert turns_together(motion(0.1, shift), motion(0.1, 0))
    assert not turns_together(motion(0.1, shift), motion(0.005, 0))
    assert not turns_together(motion(0.1, shift), motion(-0.1, 0))


def test_bodies_that_are_held_need_no_forces(monkeypatch):
    """Of what is prescribed on each all over, neither stiffness nor ties are asked."""
    bodies = [rectangle((2, 2), (0, i), (1, i + 1)) for i in (0, 1)]
    tie = Tie(*((body.V, body.facets(tag)) for body, tag in zip(bodies, (TOP, BOTTOM))))
    asked = []

    class Counted(Hindrance):
        def __init__(self, *args):
            asked.append(1)
            super().__init__(*args)

    monkeypatch.setattr(rigid_motions, "Hindrance", Counted)
    for sides, wanted in (((LEFT, LEFT), 0), ((BOTTOM, None), 1), ((None, TOP), 1)):
        bcs = []
        for body, side in zip(bodies, sides, strict=True):
            if side is not None:
                dofs = fem.locate_dofs_topological(body.V, 1, body.facets(side))
                bcs.append(fem.dirichletbc(np.zeros(2, default_scalar_type), dofs, body.V))
        asked.clear()
        TiedProblem([b.a for b in bodies], [None, None], bcs=bcs, ties=[tie]).solve()
        assert len(asked) == wanted
