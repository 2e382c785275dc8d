# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Prescribed jumps: rigid ones leave stresses alone, those of a dislocation are known."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from assembly import (
    NU,
    SOLVED,
    Body,
    comm,
    in_halves,
    is_regular,
    linear,
    problem,
    rectangle,
    tie,
    traction_error,
)
from helpers import interpolated, raises, two_ranks

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import InterfaceError, NonlinearTiedProblem, Tie, TiedProblem
from meshes import BOTTOM, END, INNER, OUTER, START, TOP

TIED = [(0, TOP), (1, BOTTOM)]
HELD = [(0, BOTTOM, (0, 1))]
SLIP = np.array((0.3, -0.1))


def turned(x):
    """A rigid displacement, of arrays: a slip and a turn."""
    return np.array((SLIP[0] - 0.2 * x[1], SLIP[1] + 0.2 * x[0]))


def moved(x, by=1.0):
    """The slip alone."""
    return np.outer(by * SLIP, np.ones(x.shape[1]))


def blocks(**options):
    return [
        rectangle((5, 2), (0, 0), (2, 1), **options),
        rectangle((3, 2), (0, 1), (2, 2), cell="triangle", **options),
    ]


def error(p, jump):
    """Largest deviation from the linear field, which the second body has with a jump on top."""
    wrong = 0.0
    for i, u in enumerate(p.u):
        exact = interpolated(
            u.function_space, lambda x, i=i: np.array(linear(x)) + (jump(x) if i else 0)
        )
        wrong = max(wrong, np.abs(u.x.array - exact.x.array).max(initial=0))
    return comm.allreduce(wrong, MPI.MAX)


@two_ranks(how=["callable", "below"], swap=[True])
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("how", ("array", "constant", "function", "below", "callable"))
def test_slip(how, swap):
    """The second block is held by nothing but the tie, and moves by what is given."""
    bodies = blocks(degree=2)
    sign, sides = (-1, TIED[::-1]) if swap else (1, TIED)
    exact = moved if how in ("array", "constant") else turned
    if how == "array":
        jump = sign * SLIP
    elif how == "constant":
        jump = fem.Constant(bodies[0].mesh, default_scalar_type(sign * SLIP))
    elif how == "callable":
        jump = lambda x: sign * turned(x)  # noqa: E731
    else:
        body = bodies[sides[how == "function"][0]]
        jump = interpolated(body.V, lambda x: sign * turned(x))
    interior = "free" if how == "below" else "interpolated"
    t = tie(bodies, *sides, jump=jump, interior=interior)
    p = problem(bodies, [t], TIED, HELD)
    p.solve()
    assert error(p, exact) <= SOLVED
    assert traction_error(p, t, bodies) <= 10 * SOLVED
    if how == "array":
        gap, slip = t.gap(*(p.u[::-1] if swap else p.u))
        q = t.quadrature(2)
        np.testing.assert_allclose(q.evaluate(gap), SLIP[1], atol=1e-11)
        np.testing.assert_allclose(q.evaluate(slip)[..., 0], sign * SLIP[0], atol=1e-11)


@pytest.mark.parametrize("solver", ("direct", "bodies", "iterative"))
def test_load_steps_factorise_once(solver):
    bodies = blocks()
    jump = fem.Constant(bodies[1].mesh, default_scalar_type((0, 0)))
    p = problem(bodies, [tie(bodies, *TIED, jump=jump)], TIED, HELD, solver=solver)
    p.assemble_matrix()
    with PETSc.Log.Event("MatLUFactorNum") as event:
        pass
    PETSc.Log.begin()
    counts = []
    for step in range(3):
        jump.value[:] = step * SLIP
        p.assemble_vector()
        p.solve_system()
        counts.append(event.getPerfInfo()["count"])
        bound = 1e-8 if solver == "iterative" else SOLVED
        assert error(p, lambda x, step=step: moved(x, step)) <= bound
    assert counts[0] == counts[-1] > 0


def test_between_keeps_the_direction():
    """The jump is the second side's over the first's, whichever becomes Γ1."""
    bodies = blocks()
    sides = [(bodies[i].V, bodies[i].facets(tag)) for i, tag in TIED]
    below = interpolated(bodies[1].V, lambda x: -turned(x))
    for given, jump, swapped in ((sides, turned, False), (sides[::-1], below, True)):
        t = Tie.between(*given, jump=jump)
        assert t.swapped is swapped
        p = problem(bodies, [t], TIED, HELD)
        p.solve()
        assert error(p, turned) <= SOLVED


@two_ranks(same=[False])
@pytest.mark.parametrize("same", (True, False))
def test_pieces(same):
    """An interface in two pieces, with one jump or one each, that go on in each other."""
    bodies = [
        rectangle((6, 2), (0, 0), (2, 1)),
        rectangle((4, 2), (0, 1), (2, 2), cell="triangle"),
    ]
    jumps = [turned] * 2 if same else [lambda x: turned(x), lambda x: 1 * turned(x)]
    pieces = zip(in_halves(bodies, TIED, 1), jumps, strict=True)
    ties = [Tie(*sides, jump=jump) for sides, jump in pieces]
    p = problem(bodies, ties, TIED, HELD)
    p.solve()
    assert is_regular(p)
    assert error(p, turned) <= SOLVED
    assert max(traction_error(p, t, bodies) for t in ties) <= 10 * SOLVED


def test_solids():
    """Scalars in space: temperatures with a jump."""
    V, sides, a = [], [], []
    for z, n, tag in ((0, 3, meshes.FRONT), (1, 2, meshes.BACK)):
        mesh, ft = meshes.block(
            comm, (n, n, 1), lambda x, z=z: x + np.array((0, 0, z)), cell="tetrahedron"
        )
        V.append(fem.functionspace(mesh, ("Lagrange", 1)))
        sides.append((V[-1], ft.find(tag)))
        u, v = ufl.TrialFunction(V[-1]), ufl.TestFunction(V[-1])
        a.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
    bottom = fem.locate_dofs_geometrical(V[0], lambda x: np.isclose(x[2], 0))
    bcs = [fem.dirichletbc(default_scalar_type(1.0), bottom, V[0])]
    for jump in (0.25, lambda x: 0.25):
        t = Tie(*sides, jump=jump)
        u0, u1 = TiedProblem(a, [None, None], bcs=bcs, ties=[t]).solve()
        np.testing.assert_allclose(u0.x.array, 1.0, atol=1e-12)
        np.testing.assert_allclose(u1.x.array, 1.25, atol=1e-12)


def test_nonlinear():
    """Newton's iteration takes a jump as it takes prescribed displacements: in one step."""
    bodies = blocks()
    jump = fem.Function(bodies[1].V)
    t = tie(bodies, *TIED, jump=jump)
    us = [fem.Function(body.V) for body in bodies]
    F, bcs = [], []
    for i, (body, u) in enumerate(zip(bodies, us, strict=True)):
        v = ufl.TestFunction(body.V)
        F.append(ufl.inner(body.stress(u), ufl.sym(ufl.grad(v))) * ufl.dx)
        g = interpolated(body.V, lambda x, i=i: np.array(linear(x)) + i * turned(x))
        outer = np.setdiff1d(body.boundary, body.facets(TIED[i][1]))
        bcs.append(fem.dirichletbc(g, fem.locate_dofs_topological(body.V, 1, outer)))
    p = NonlinearTiedProblem(F, us, bcs=bcs, ties=[t])
    jump.interpolate(turned)
    p.solve()
    assert p.solver.getIterationNumber() == 1
    assert error(p, turned) <= SOLVED


# An edge dislocation (Volterra): across a cut displacements jump by b = (1, 0), stresses don't


def dislocation(x, upper):
    """Displacement, of arrays, in one half of the plane: the cut is at θ = 0 and 2π."""
    r = np.hypot(x[0], x[1])
    away = np.arctan2(-x[0], x[1]) if upper else np.arctan2(x[0], -x[1])  # from the half's middle
    theta = away + (0.5 if upper else 1.5) * np.pi
    c = 4 * (1 - NU)
    ux = theta + np.sin(2 * theta) / c
    uy = -2 * (1 - 2 * NU) / c * np.log(r) - np.cos(2 * theta) / c
    return np.array((ux, uy)) / (2 * np.pi)


def dislocated(n, tied=True):
    """Error of two half rings' stresses (H¹ of displacements), tied or each by itself."""
    bodies, bcs, finer = [], [], []
    for n_hoop, upper in ((3 * n, True), (2 * n, False)):
        mesh, ft = meshes.ring_sector(comm, n_hoop, n, 1.0, 2.0, angle=np.pi, degree=2)
        mesh.geometry.x[:, :2] *= 1 if upper else -1
        body = Body(mesh, ft, fem.functionspace(mesh, ("Lagrange", 2, (2,))))
        g = interpolated(body.V, lambda x, upper=upper: dislocation(x, upper))
        tags = (INNER, OUTER) if tied else (INNER, OUTER, START, END)
        dofs = fem.locate_dofs_topological(body.V, 1, body.facets(tags))
        bcs.append(fem.dirichletbc(g, dofs))
        bodies.append(body)
        W = fem.functionspace(mesh, ("Lagrange", 4, (2,)))
        finer.append(interpolated(W, lambda x, upper=upper: dislocation(x, upper)))
    ties = []
    if tied:
        ties.append(tie(bodies, (0, START), (1, END), jump=(1, 0)))
        ties.append(tie(bodies, (0, END), (1, START)))
    p = TiedProblem([body.a for body in bodies], [None, None], bcs=bcs, ties=ties)
    error = 0.0
    for u, exact in zip(p.solve(), finer, strict=True):
        e = ufl.grad(u - exact)
        error += fem.assemble_scalar(fem.form(ufl.inner(e, e) * ufl.dx(degree=6)))
    return comm.allreduce(error) ** 0.5


def test_dislocation():
    """As exact as both halves with their exact displacements; those at the cut's ends jump too."""
    errors = [dislocated(n) for n in (4, 8)]
    print(errors, [dislocated(n, tied=False) for n in (4, 8)])
    assert errors[1] <= 1.05 * dislocated(8, tied=False)
    assert abs(np.log2(errors[0] / errors[1]) - 2) < 0.1


# Bad input


@pytest.mark.ranks(2)
def test_bad_input():
    bodies = blocks()
    V = bodies[0].V
    for wrong, said in (
        (1.0, "1 component given, the space has 2"),
        ((1, 2, 3), "3 components given"),
        ((np.nan, 0), r"the jump is .*nan.* it must be finite"),
        ("wide", "the jump is given as numbers, .*, not as str"),
        (ufl.SpatialCoordinate(V.mesh), "not as a UFL expression; interpolate"),
        ((fem.Function(V), 0), "not as a tuple with a Function"),
        (lambda x: (None, 0), "the callable gives a tuple with NoneType, not numbers"),
        (lambda x: (x[0], np.append(x[1], (0, 0))), "the callable gives .* values at .* points"),
        (fem.Constant(V.mesh, default_scalar_type(1.0)), "1 component given"),
        (lambda x: x, "3 components given"),
        (lambda x: 1 / 0, "no value on V₁: division by zero"),
        ((1j, 0), "it is complex, and PETSc's scalars are real"),
        (lambda x: (np.where(x[0] > 1.5, np.inf, 0), 0), "the jump is .*inf"),
        (fem.Function(fem.functionspace(V.mesh, ("Lagrange", 2, (2,)))), "on a space of neither"),
    ):
        with raises(ValueError, said):
            tie(bodies, *TIED, jump=wrong)
    jump = fem.Constant(V.mesh, default_scalar_type((0, 0)))
    p = problem(bodies, [tie(bodies, *TIED, jump=jump)], TIED, HELD)
    jump.value[1] = np.inf
    with raises(ValueError, "the jump is .*inf"):
        p.solve()


@two_ranks()
def test_contradiction():
    """What both sides prescribe is to differ by the jump."""
    bodies = blocks()
    both = [(0, meshes.LEFT, (0, 1)), (1, meshes.LEFT, (0, 1))]
    p = problem(bodies, [tie(bodies, *TIED, jump=SLIP)], TIED, both)
    with raises(InterfaceError, r"contradict tie 0 .*, with a jump of \[ ?0.3 -0.1\]"):
        p.solve()
