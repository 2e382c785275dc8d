# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Ties with a law of one's own, λ = f(u₁ − u₀), in UFL: springs that push and pull, adhesives."""

import numpy as np
import pytest
from assembly import (
    SOLVED,
    comm,
    exact_stress,
    held_outside,
    in_halves,
    problem,
    rectangle,
    tie,
    traction_error,
)
from helpers import raises, two_ranks
from test_compliance import HELD, TIED, blocks, error

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import NonlinearTiedProblem, SolveError, Tie

G, DELTA = 0.02, 0.1


class Springs:
    """Along the normal, where it opens and where it closes, and across it."""

    def __init__(self, mesh, pull=2.0, push=30.0, across=0.5):
        values = np.array((pull, push, across), dtype=default_scalar_type)
        self.k = fem.Constant(mesh, values)

    def __call__(self, jump, n):
        opening = ufl.dot(jump, n)
        along = ufl.conditional(ufl.gt(ufl.real(opening), 0), self.k[0], self.k[1]) * opening
        return along * n + self.k[2] * (jump - opening * n)

    def traction(self, jump):
        """λ at y = 1."""
        return self.k.value[2] * jump[0], self.k.value[0 if jump[1] > 0 else 1] * jump[1]


def adhesive(jump, n):
    """Xu's and Needleman's: softens beyond an opening of DELTA."""
    w = ufl.variable(jump)
    opening = ufl.dot(w, n)
    slip = w - opening * n
    opened = ufl.exp(-opening / DELTA - ufl.dot(slip, slip) / DELTA**2)
    return ufl.diff(-G * (1 + opening / DELTA) * opened, w)


def adhesive_traction(jump):
    """The same, by hand."""
    slip, opening = np.array(jump) / DELTA
    opened = G / DELTA * np.exp(-opening - slip**2)
    return 2 * (1 + opening) * slip * opened, opening * opened


def under(body, traction):
    """A displacement with this traction at all y."""
    unit = np.array([exact_stress(body, np.zeros(2), f)[:, 1] for f in (shear, pull)]).T
    a, b = np.linalg.solve(unit, traction)
    return lambda x: (a * x[1], b * x[1])


def shear(x):
    """A unit of it."""
    return x[1], 0 * x[0]


def pull(x):
    """A unit of it."""
    return 0 * x[0], x[1]


def solved(bodies, ties, jump, traction):
    """The problem whose solution has a jump and a traction."""
    field, above = under(bodies[0], traction), np.array(jump)[:, None]
    p = held_outside(
        bodies,
        ties,
        TIED,
        lambda i, x: np.array(field(x)) + i * above,
        petsc_options={"snes_rtol": 1e-12},
    )
    p.solve()
    assert error(p, field, lambda x: above) <= SOLVED
    assert max(traction_error(p, t, bodies, field) for t in ties) <= 100 * SOLVED
    return p


@two_ranks()
@pytest.mark.parametrize("interior", ("interpolated", "free"))
def test_linear(interior):
    """A law that is a compliance has its solution, and takes one step."""
    bodies = blocks()
    law = Springs(bodies[0].mesh, 1 / 0.7, 1 / 0.7, 1 / 0.7)
    jump = lambda x: (0.1 * x[0], 0.2 + 0 * x[0])  # noqa: E731
    found = []
    for how in ({"law": law}, {"compliance": 0.7}):
        t = tie(bodies, *TIED, jump=jump, interior=interior, **how)
        p = held_outside(bodies, [t], TIED, lambda i, x: (np.sin(x[0]) * x[1] + i, 0.3 * x[0] ** 2))
        p.solve()
        assert p.solver.getIterationNumber() == 1
        found.append([*(u.x.array.copy() for u in p.u), t.traction(p).x.array.copy()])
    for mine, other in zip(*found, strict=True):
        np.testing.assert_allclose(mine, other, rtol=0, atol=1e-12)


@two_ranks(law=["adhesive"])
@pytest.mark.parametrize("law", ("pulled", "pushed", "adhesive"))
def test_exact(law):
    """On both branches of springs, and with an adhesive that softens already."""
    bodies = blocks()
    jump = (0.03, -0.02 if law == "pushed" else 0.15)
    springs = Springs(bodies[0].mesh)
    traction = adhesive_traction(jump) if law == "adhesive" else springs.traction(jump)
    t = tie(bodies, *TIED, law=adhesive if law == "adhesive" else springs)
    p = solved(bodies, [t], jump, traction)
    assert p.solver.getIterationNumber() <= 6
    if law == "pulled":  # with other constants it is another one
        springs.k.value[:] *= 2.0
        before = p.u[0].x.array.copy()
        p.solve()
        assert np.abs(p.u[0].x.array - before).max() > 0.01


def test_between():
    """The law is that of the second side over the first, whichever becomes Γ1."""
    bodies = blocks()
    sides = [(bodies[i].V, bodies[i].facets(tag)) for i, tag in TIED]
    bend = fem.Constant(bodies[0].mesh, default_scalar_type(2.0))
    found = []
    for swap in (False, True):
        bend.value = -2.0 if swap else 2.0
        law = lambda w, n: [w[i] + bend * w[i] ** 2 for i in range(2)]  # noqa: E731
        t = Tie.between(*sides[:: -1 if swap else 1], law=law)
        assert t.swapped is swap
        p = held_outside(bodies, [t], TIED, lambda i, x: (0.1 * i * x[0], 0.2 * i + 0.1 * x[0]))
        found.append([*(u.x.array.copy() for u in p.solve()), t.traction(p).x.array.copy()])
    for mine, other in zip(*found, strict=True):
        np.testing.assert_allclose(mine, other, rtol=0, atol=1e-12)


@pytest.mark.parametrize("same", (True, False))
def test_pieces(same):
    """One interface in two pieces with one law, or with two that say the same."""
    upper = rectangle((4, 2), (0, 1), (2, 2), cell="triangle")
    bodies = [rectangle((6, 2), (0, 0), (2, 1)), upper]
    jump = (0.03, 0.15)
    laws = adhesive, adhesive if same else lambda w, n: adhesive(w, n)
    pieces = zip(in_halves(bodies, TIED, 1), laws, strict=True)
    solved(bodies, [Tie(*sides, law=law) for sides, law in pieces], jump, adhesive_traction(jump))


@two_ranks()
def test_both_sides_prescribed():
    """λ is what the law says of the jump that is prescribed."""
    bodies = blocks()
    t = tie(bodies, *TIED, law=adhesive, jump=(0.0, -0.15))
    p = held_outside(bodies, [t], [], lambda i, x: (0.03 * i + 0 * x[0], 0 * x[0]))
    p.solve()
    q = t.quadrature(0)
    exact = np.broadcast_to(adhesive_traction((0.03, 0.15)), q.x.shape)
    np.testing.assert_allclose(q.evaluate(t.traction(p)), exact, atol=SOLVED)


def test_scalar_in_space():
    """Heat that flows by a law: the flux between two slabs of thickness 1 and conductivity 1."""
    us, F, bcs, sides = [], [], [], []
    for i, n in enumerate((3, 2)):
        place = lambda x, i=i: x + i * np.eye(3)[2]  # noqa: E731
        mesh, ft = meshes.block(comm, (n, n, 1), place, cell="tetrahedron")
        V = fem.functionspace(mesh, ("Lagrange", 1))
        us.append(fem.Function(V))
        F.append(ufl.inner(ufl.grad(us[i]), ufl.grad(ufl.TestFunction(V))) * ufl.dx)
        ends = fem.locate_dofs_geometrical(V, lambda x, i=i: np.isclose(x[2], 2 * i))
        # The flux is q, and the jump 1 with the law T + T³: so q = 2
        bcs.append(fem.dirichletbc(default_scalar_type(5.0 * i), ends, V))
        sides.append((V, ft.find((meshes.FRONT, meshes.BACK)[i])))
    t = Tie(*sides, law=lambda jump, n: jump + jump**3)
    p = NonlinearTiedProblem(F, us, bcs=bcs, ties=[t], petsc_options={"snes_rtol": 1e-12})
    p.solve()
    np.testing.assert_allclose(t.traction(p).x.array, 2.0, atol=1e-10)


@pytest.mark.ranks(2)
def test_bad_input():
    bodies = blocks()
    mesh = bodies[0].mesh
    f = fem.Function(bodies[0].V, name="f")
    for wrong, said in (
        (3.0, "a law is a function of the jump and the normal .* not a float"),
        (ufl.SpatialCoordinate(mesh), "not a SpatialCoordinate"),
        (lambda w: w, "the law is no UFL expression of the jump: .* positional argument"),
        (lambda w, n: None, "no UFL expression of the jump"),
        (lambda w, n: "w", "no UFL expression of the jump"),
        (lambda w, n: ufl.dot(w, n), r"values of shape \(\), the jump has \(2,\)"),
        (lambda w, n: f, "the law has f in it"),
        (
            lambda w, n: ufl.SpatialCoordinate(mesh),
            "it may have the jump, the normal and constants",
        ),
        (lambda w, n: ufl.sqrt(ufl.dot(w, w)) * w, r"its derivative is \(?nan"),
    ):
        with raises(ValueError, said):
            tie(bodies, *TIED, law=wrong)
    with raises(ValueError, "a compliance or a law, not both"):
        tie(bodies, *TIED, law=adhesive, compliance=1.0)
    t = tie(bodies, *TIED, law=adhesive)
    with raises(ValueError, "for a NonlinearTiedProblem"):
        problem(bodies, [t], TIED, HELD)
    with raises(ValueError, '"bodies" is not possible: a tie has a law'):
        held_outside(bodies, [t], TIED, lambda i, x: 0 * x[:2], solver="bodies")


@two_ranks()
def test_failed_step():
    """With u set back, the jumps and λ are what they were before it."""
    bodies = blocks()
    g = fem.Constant(bodies[0].mesh, np.zeros(2, dtype=default_scalar_type))
    jump = (0.03, 0.15)
    t = tie(bodies, *TIED, law=adhesive, jump=g)
    p = solved(bodies, [t], jump, adhesive_traction(jump))
    before = [u.x.array.copy() for u in p.u]
    steps = p.solver.getTolerances()[-1]
    p.solver.setTolerances(max_it=1)
    g.value[:] = 0.02, -0.05
    with raises(SolveError, "failed after 1 steps"):
        p.solve()
    for u, values in zip(p.u, before, strict=True):
        u.x.array[:] = values
    p.solver.setTolerances(max_it=steps)
    g.value[:] = 0.0
    p.solve()
    assert p.solver.getIterationNumber() <= 1  # 4 from the failed state


@two_ranks()
def test_one_facet():
    """A rank may have none of the cells."""
    bodies = [rectangle((1, 1), (0, i), (1, i + 1)) for i in (0, 1)]
    t = tie(bodies, *TIED, law=lambda w, n: w / 0.7)
    solved(bodies, [t], (0.07, 0.14), (0.1, 0.2))


def test_given_traction():
    """A law may have nothing of the mesh."""
    bodies = blocks()
    t = tie(bodies, *TIED, law=lambda w, n: ufl.as_vector((0.1, 0.0)))
    solved(bodies, [t], (0.03, 0.15), (0.1, 0.0))
