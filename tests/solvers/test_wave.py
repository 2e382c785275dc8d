# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Complex scalars: what is exact stays exact, with every solver; what is refused."""

import runpy
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
from assembly import SOLVED, bending, displacement_error, problem, rectangle, tie, traction_error
from helpers import raises

import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import Contact, NonlinearTiedProblem, SolveError, Tie, TiedProblem, files
from meshes import BOTTOM, LEFT, RIGHT, TOP

comm = MPI.COMM_WORLD
COMPLEX = np.issubdtype(default_scalar_type, np.complexfloating)
OTHER = np.float64 if COMPLEX else np.complex128
needs_complex = pytest.mark.skipif(not COMPLEX, reason="needs complex scalars")
PHASE, DAMPED = 0.6 - 0.8j, 1.0 + 0.3j
TIED = [(0, TOP), (1, BOTTOM)]


def turned(x):
    """Pure bending, out of phase."""
    return tuple(PHASE * part for part in bending(x))


def blocks(modulus=DAMPED):
    """A block on another one."""
    return [
        rectangle((n, 2), (0, i), (1, i + 1), cell=cell, degree=2, E=modulus)
        for i, (n, cell) in enumerate(((3, "triangle"), (4, "quadrilateral")))
    ]


@needs_complex
@pytest.mark.ranks(2)
@pytest.mark.parametrize("solver", ("direct", "bodies"))
def test_damped_bodies(solver):
    """A complex modulus: displacements, tractions, gaps, and what files take."""
    bodies = blocks()
    t = tie(bodies, *TIED)
    p = problem(bodies, [t], TIED, [(0, LEFT, (0, 1)), (1, RIGHT, (0,))], turned, solver=solver)
    p.solve()
    assert displacement_error(p, turned) <= SOLVED
    assert traction_error(p, t, bodies, turned) <= 10 * SOLVED
    alpha, traction, gap, slip = files.on_sigma(t, p)
    assert all(np.abs(f.x.array).max(initial=0) <= 10 * SOLVED for f in (gap, slip))
    assert traction.dtype == default_scalar_type
    assert not alpha.x.array.imag.any()


@needs_complex
@pytest.mark.ranks(2)
def test_three_damped_bodies():
    """They meet in a point: rows of B are compared there, to choose multipliers."""
    corners = ((0, 0), (2, 1)), ((0, 1), (1, 2)), ((1, 1), (2, 2))
    bodies = [
        rectangle((n, n), low, high, degree=2, E=DAMPED)
        for n, (low, high) in zip((5, 2, 1), corners, strict=True)
    ]
    pairs = [((0, TOP), (1, BOTTOM)), ((0, TOP), (2, BOTTOM)), ((1, RIGHT), (2, LEFT))]
    ties = [tie(bodies, *pair) for pair in pairs]
    held = [(0, LEFT, (0, 1)), (2, TOP, (0, 1))]  # the last tie is left with one multiplier
    p = problem(bodies, ties, [side for pair in pairs for side in pair], held, turned)
    p.solve()
    assert displacement_error(p, turned) <= SOLVED


@needs_complex
@pytest.mark.ranks(2)
def test_damped_bodies_that_are_free():
    """One that nothing holds is found, or held by the other."""
    bodies = blocks()
    t = tie(bodies, *TIED)
    free = problem(bodies, [t], TIED, [(0, BOTTOM, (1,))], turned)
    with raises(SolveError, "1 rigid motion of the bodies is free"):
        free.solve()
    for solver in ("direct", "bodies"):  # the upper one floats
        p = problem(bodies, [t], TIED, [(0, BOTTOM, (0, 1))], turned, solver=solver)
        p.solve()
        assert displacement_error(p, turned) <= SOLVED


def shifted(bodies):
    """Forms with ∇ + iβ, Hermitian and positive definite; the solution is linear times a phase."""
    a, L, bcs = [], [], []
    for body, tag, value in zip(bodies, (BOTTOM, TOP), (0, PHASE), strict=True):
        V = fem.functionspace(body.mesh, ("Lagrange", 1))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        beta = 1j * ufl.as_vector((0.7, 0.4))
        a.append(ufl.inner(ufl.grad(u) + beta * u, ufl.grad(v) + beta * v) * ufl.dx)
        L.append(ufl.inner(fem.Constant(body.mesh, default_scalar_type(1j)), v) * ufl.dx)
        dofs = fem.locate_dofs_topological(V, 1, body.facets(tag))
        bcs.append(fem.dirichletbc(default_scalar_type(value), dofs, V))
    return a, L, bcs


@needs_complex
@pytest.mark.ranks(2)
def test_hermitian_bodies():
    """Every solver, and Newton's steps, have the same answer."""
    bodies = blocks()
    a, L, bcs = shifted(bodies)
    V = [form.arguments()[0].ufl_function_space() for form in a]
    t = Tie((V[0], bodies[0].facets(TOP)), (V[1], bodies[1].facets(BOTTOM)))
    found = {}
    for solver in ("direct", "bodies", "iterative"):
        p = TiedProblem(a, L, bcs=bcs, ties=[t], solver=solver)
        found[solver] = [u.x.array.copy() for u in p.solve()]
    us = [fem.Function(W) for W in V]
    F = [ufl.action(form, u) - load for form, load, u in zip(a, L, us, strict=True)]
    newton = NonlinearTiedProblem(F, us, bcs=bcs, ties=[t], J=a)
    found["newton"] = [u.x.array for u in newton.solve()]
    assert newton.solver.getIterationNumber() <= 2
    exact = found.pop("direct")
    assert max(np.abs(x.imag).max() for x in exact) > 0.1
    for name, xs in found.items():
        error = max(np.abs(x - y).max() for x, y in zip(xs, exact, strict=True))
        assert error <= (1e-8 if name == "iterative" else 1e-12), name


@needs_complex
def test_iterative_is_for_hermitian_bodies():
    bodies = blocks(1.0 + 3.0j)
    t = tie(bodies, *TIED)
    p = problem(bodies, [t], TIED, [(0, BOTTOM, (0, 1))], turned, solver="iterative")
    with raises(SolveError, 'solver="direct"'):
        p.solve()


@pytest.mark.ranks(2)
def test_real_and_complex_mixed():
    """A coefficient, a constant, a prescribed value or a solution of the other kind."""
    bodies = blocks(1.0)
    t = tie(bodies, *TIED)
    V = bodies[0].V
    v, f = ufl.TestFunction(V), fem.Function(V, dtype=OTHER)
    L = ufl.inner(fem.Constant(V.mesh, OTHER((1, 0))), v) * ufl.dx
    here = "PETSc's scalars here are " + np.dtype(default_scalar_type).name
    a = [body.a for body in bodies]
    with raises(ValueError, f"^the Constant .* of a form is of {OTHER.__name__}, and {here}"):
        TiedProblem(a, [L, None], ties=[t])
    with raises(ValueError, f"^the Function .* of a form is of {OTHER.__name__}, and {here}"):
        TiedProblem(a, [ufl.inner(f, v) * ufl.dx, None], ties=[t])
    with raises(ValueError, "^the function of body 0 is of"):
        TiedProblem(a, [None, None], ties=[t], u=[f, fem.Function(bodies[1].V)])
    with raises(ValueError, "^the function of body 0 is of|^the Function"):
        NonlinearTiedProblem([ufl.inner(f, v) * ufl.dx], [f], J=a[:1])
    dofs = fem.locate_dofs_topological(V, 1, bodies[0].facets(BOTTOM))
    for bc in (
        fem.dirichletbc(np.zeros(2, OTHER), dofs, V),
        fem.dirichletbc(f, dofs),
    ):
        with raises(ValueError, "^the value of a Dirichlet condition is of"):
            TiedProblem(a, [None, None], bcs=[bc], ties=[t])


@pytest.mark.skipif(COMPLEX, reason="needs real scalars")
def test_demo_with_real_scalars(monkeypatch):
    """It says in one line what it needs."""
    demo = Path(__file__).parents[2] / "demos" / "wave.py"
    monkeypatch.setattr("sys.argv", ["wave.py"])
    with pytest.raises(SystemExit, match=r"^wave\.py needs DOLFINx with complex numbers.*\.$"):
        runpy.run_path(str(demo), run_name="__main__")


@needs_complex
def test_contact_is_refused():
    bodies = blocks()
    with raises(ValueError, "real scalars"):
        Contact(*((body.V, body.facets(tag)) for body, (_, tag) in zip(bodies, TIED, strict=True)))
