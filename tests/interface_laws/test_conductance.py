# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Ties that conduct: λ = h (u₁ − u₀), from free (h = 0) to tied, wherever h is not 0."""

from mpi4py import MPI

import numpy as np
import pytest
from assembly import (
    SOLVED,
    comm,
    held_outside,
    linear,
    problem,
    tie,
    traction_error,
)
from helpers import interpolated, raises, sweep, two_ranks
from test_compliance import HELD, TIED, Slab, blocks, error, stretched, traction_of

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import NonlinearTiedProblem, SolveError, Tie, TiedProblem
from meshes import BOTTOM, LEFT, RIGHT, TOP


@two_ranks(unit=[1.0])
@pytest.mark.parametrize("unit", (1e-9, 1.0, 1e9))
def test_layers(unit):
    """From all but tied to free in one problem."""
    slab = Slab(unit=unit, how="conductance")
    for k in ((1.0, 1.0), (1.0, 1e-6), (1e6, 1.0)):
        for h in (1e-12, 1.0, 1e12):
            errors = slab.errors(k, 1 / h)
            assert max(errors) <= (1e-12 if k[0] == k[1] else 1e-11), (k, h, errors)


def test_in_space():
    slab = Slab(3, how="conductance")
    for h in (1e-12, 2.0, 1e12):
        assert max(slab.errors((1.0, 3.0), 1 / h)) <= 1e-12


@two_ranks()
def test_nothing_conducts():
    slab = Slab(how="conductance")
    slab.c.value = 0.0
    for i, u in enumerate(slab.problem.solve()):
        np.testing.assert_allclose(u.x.array, i, atol=1e-14)
    np.testing.assert_allclose(slab.tie.traction(slab.problem).x.array, 0, atol=1e-14)
    floats = Slab(flux=True, how="conductance")
    assert max(floats.errors(c=1e3)) <= 1e-11  # held by it
    floats.c.value = 0.0
    with raises(SolveError, "singular"):
        floats.problem.solve()


def heat(n, h, degree=1):
    """What flows between temperatures 0 and 1 on squares of n[i] × n[i] cells."""
    a, bcs, sides = [], [], []
    for i, num in enumerate(n):
        mesh, ft = meshes.block(comm, (num, num), lambda x, i=i: x + i * np.eye(2)[1])
        V = fem.functionspace(mesh, ("Lagrange", degree))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        a.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        end = fem.locate_dofs_topological(V, 1, ft.find((BOTTOM, TOP)[i]))
        bcs.append(fem.dirichletbc(default_scalar_type(i), end, V))
        sides.append((V, ft.find((TOP, BOTTOM)[i])))
    t = Tie(*sides, conductance=interpolated(sides[1][0], h))
    p = TiedProblem(a, [None, None], bcs=bcs, ties=[t])
    p.solve()
    q = t.quadrature(2)
    return float(np.real(q.integrate(q.evaluate(t.traction(p))[..., 0])))


@two_ranks()
def test_one_vertex():
    """Heat flows where h is 0 at all vertices but one; with finer cells it is all but the same."""
    for beta, fine, within in ((1e-3, 1.99894e-4, 1e-4), (1.0, 0.13104, 0.03), (1e6, 0.4224, 0.09)):
        hat = lambda x, beta=beta: beta * np.maximum(1 - abs(x[0] - 0.4) / 0.2, 0)  # noqa: E731
        for n in ((10, 5), (20, 10), (5, 15)):
            assert abs(heat(n, hat) / fine - 1) <= within


class Varying:
    """A conductance that varies along the interface, with known temperatures."""

    @staticmethod
    def temperature(i, x, m=np):
        """Harmonic, with the same flux at y = 1."""
        below = x[1] + 0.1 * m.cos(np.pi * x[0]) * m.sinh(np.pi * x[1]) / np.cosh(np.pi)
        return below + i * (1 + 0.5 * m.cos(np.pi * x[0]) * m.cosh(np.pi * (x[1] - 1)))

    @staticmethod
    def conductance(x):
        """The flux over the jump."""
        wave = np.cos(np.pi * x[0])
        return (1 + 0.1 * np.pi * wave) / (1 + 0.5 * wave)


def varying_error(n, degree):
    """L² of temperatures."""
    a, bcs, sides = [], [], []
    for i, cell in enumerate(("triangle", "quadrilateral")):
        place = lambda x, i=i: x + i * np.eye(2)[1]  # noqa: E731
        mesh, ft = meshes.block(comm, (n + n * i // 2,) * 2, place, cell=cell)
        V = fem.functionspace(mesh, ("Lagrange", degree))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        a.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        exact = interpolated(V, lambda x, i=i: Varying.temperature(i, x))
        outside = np.sort(np.hstack([ft.find(t) for t in (LEFT, RIGHT, (BOTTOM, TOP)[i])]))
        bcs.append(fem.dirichletbc(exact, fem.locate_dofs_topological(V, 1, outside)))
        sides.append((V, ft.find((TOP, BOTTOM)[i])))
    t = Tie(*sides, conductance=Varying.conductance)
    squares = 0.0
    for i, u in enumerate(TiedProblem(a, [None, None], bcs=bcs, ties=[t]).solve()):
        x = ufl.SpatialCoordinate(u.function_space.mesh)
        wrong = u - Varying.temperature(i, x, ufl)
        form = fem.form(ufl.inner(wrong, wrong) * ufl.dx(degree=6))
        squares += comm.allreduce(fem.assemble_scalar(form).real, MPI.SUM)
    return np.sqrt(squares)


@pytest.mark.parametrize("degree", sweep((2, 1), 2))
def test_rates(degree):
    coarse, fine = (varying_error(n, degree) for n in (4, 8))
    assert np.log2(coarse / fine) >= degree + 0.95


# Blocks under constant stress: the second one moves by σn over h


@two_ranks(h=[(0.5, 2.0)], interior=["free"])
@pytest.mark.parametrize("interior", ("interpolated", "free"))
@pytest.mark.parametrize("h", (0.7, (0.5, 2.0), (1e12, 3.0)))
def test_springs(h, interior):
    """Along the normal and across it; with a jump on top."""
    bodies = blocks(degree=2)
    t = tie(bodies, *TIED, conductance=h, interior=interior, jump=(0.1, 0.2))
    p = problem(bodies, [t], TIED, HELD)
    p.solve()
    normal, tangential = (h, h) if np.isscalar(h) else h
    opening = traction_of(bodies[0], linear) / (tangential, normal) + (0.1, 0.2)
    assert error(p, linear, lambda x: opening[:, None]) <= SOLVED
    assert traction_error(p, t, bodies) <= 10 * SOLVED


def test_slides():
    """Of a pair one may be 0: no shear passes, and nothing holds the block along the interface."""
    bodies = blocks()
    t = tie(bodies, *TIED, conductance=(2.0, 0.0))
    with raises(SolveError, "singular: a body is free that would be held by a conductance"):
        problem(bodies, [t], TIED, HELD, stretched).solve()
    p = problem(bodies, [t], TIED, [*HELD, (1, RIGHT, (0,))], stretched)
    p.solve()
    opening = np.array((0, traction_of(bodies[0], stretched)[1] / 2.0))
    assert error(p, stretched, lambda x: opening[:, None]) <= SOLVED


@two_ranks()
def test_both_sides_prescribed():
    """λ is what the conductance makes of the jump, 0 in places or not."""
    bodies = blocks(degree=2)
    h = fem.Function(fem.functionspace(bodies[1].mesh, ("Lagrange", 1)))
    t = tie(bodies, *TIED, conductance=h, jump=(0.1, 0.2))
    p = problem(bodies, [t], TIED, [(0, TOP, (0, 1)), (1, BOTTOM, (0, 1))])
    q = t.quadrature(2)
    for slope in (0.0, 3.0):
        h.interpolate(lambda x, slope=slope: 1 + slope * x[0])
        p.solve()
        exact = -(1 + slope * q.x[..., :1]) * (0.1, 0.2)
        np.testing.assert_allclose(q.evaluate(t.traction(p)), exact, atol=10 * SOLVED)


@two_ranks()
def test_nonlinear():
    """Newton's iteration takes one step."""
    bodies = blocks()
    h = fem.Constant(bodies[0].mesh, default_scalar_type(0.7))
    t = tie(bodies, *TIED, conductance=h)
    for value in (0.7, 1e6, 1e-6):
        h.value = value
        opening = traction_of(bodies[0], linear) / value

        def exact(i, x, opening=opening):
            return np.array(linear(x)) + i * opening[:, None]

        p = held_outside(bodies, [t], TIED, exact)
        p.solve()
        assert p.solver.getIterationNumber() == 1
        assert error(p, linear, lambda x, opening=opening: opening[:, None]) <= SOLVED
    h.value = -1.0
    with raises(ValueError, "the conductance is -1"):
        p.solve()


@two_ranks()
def test_nonlinear_and_nothing_conducts():
    """Newton's iteration fails where a body is free; the message says why."""
    bodies = blocks()
    t = tie(bodies, *TIED, conductance=0.0)
    us, F = [fem.Function(body.V) for body in bodies], []
    for body, u in zip(bodies, us, strict=True):
        v = ufl.TestFunction(body.V)
        load = fem.Constant(body.mesh, default_scalar_type((0.1, 0.2)))
        F.append(
            ufl.inner(body.stress(u), ufl.sym(ufl.grad(v))) * ufl.dx - ufl.inner(load, v) * ufl.dx
        )
    below = fem.locate_dofs_topological(bodies[0].V, 1, bodies[0].facets(BOTTOM))
    bc = fem.dirichletbc(default_scalar_type((0, 0)), below, bodies[0].V)
    # It depends on round-off whether the factorisation notices
    with raises(SolveError, "singular: a body is(n't held| free that would be held)"):
        NonlinearTiedProblem(F, us, bcs=[bc], ties=[t]).solve()


@pytest.mark.ranks(2)
def test_bad_input():
    bodies = blocks()
    for wrong, said in (
        (lambda x: x[0] - 1, r"the conductance is -1 at \(0, 1\); it must be ≥ 0 and finite"),
        (np.inf, r"\(infinite: tie without it\)"),
        ((1, 2, 3), "conductance is one value, or a pair"),
        ("high", "a conductance is given as numbers"),
        (1j, "it has an imaginary part; a conductance is real"),
    ):
        with raises(ValueError, said):
            tie(bodies, *TIED, conductance=wrong)
    with raises(ValueError, "give a compliance or a conductance, not both"):
        tie(bodies, *TIED, compliance=1.0, conductance=1.0)
    t = tie(bodies, *TIED, conductance=0.1 + 0j)  # as PETSc's scalars may be
    with raises(ValueError, '"bodies" is not possible: a tie has a law or a conductance'):
        problem(bodies, [t], TIED, HELD, solver="bodies")
