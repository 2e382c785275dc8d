# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""NonlinearTiedProblem: the linear problem's answer, quadratic convergence, large rotations."""

import gc
import weakref
from itertools import pairwise

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from helpers import two_ranks

import meshes
import ufl
from dolfinx import fem
from hypergap_dolfinx import NonlinearTiedProblem, SolveError, Tie, TiedProblem
from hypergap_dolfinx.solvers import choice

comm = MPI.COMM_WORLD


def energy(u):
    """Compressible neo-Hookean material."""
    F = ufl.Identity(2) + ufl.grad(u)
    J = ufl.det(F)
    return 0.5 * (ufl.inner(F, F) - 2 - 2 * ufl.ln(J) + ufl.ln(J) ** 2)


def small_strain_energy(u):
    eps = ufl.sym(ufl.grad(u))
    return ufl.inner(eps, eps) + 0.5 * ufl.tr(eps) ** 2


def two_blocks(degree=2, gap=0.0, **options):
    """Spaces, tags and tie of a block on another one."""
    lower, ft0 = meshes.block(comm, (5, 2), lambda x: x * (2, 1))
    upper, ft1 = meshes.block(comm, (7, 3), lambda x: x * (2, 1) + (0, 1 + gap))
    V = [fem.functionspace(mesh, ("Lagrange", degree, (2,))) for mesh in (lower, upper)]
    sides = (V[0], ft0.find(meshes.TOP)), (V[1], ft1.find(meshes.BOTTOM))
    return V, (ft0, ft1), Tie(*sides, **options)


def problem_of(V, fts, tie, density, places, tags=(meshes.BOTTOM, meshes.TOP), **options):
    """The bottom of one block and the top of the other move to given places."""
    us = [fem.Function(W) for W in V]
    F = [ufl.derivative(density(u) * ufl.dx, u) for u in us]
    bcs = []
    for W, ft, tag, place in zip(V, fts, tags, places, strict=True):
        if place is not None:
            g = fem.Function(W)
            g.interpolate(place)
            dofs = fem.locate_dofs_topological(W, 1, ft.find(tag))
            bcs.append(fem.dirichletbc(g, dofs))
            bcs[-1].function = g
    return NonlinearTiedProblem(F, us, bcs=bcs, ties=[tie], **options), bcs


def rotation(angle):
    """Displacement of a rotation around the origin."""
    c, s = np.cos(angle), np.sin(angle)
    return lambda x: np.array([(c - 1) * x[0] - s * x[1], s * x[0] + (c - 1) * x[1]])


def fixed(x):
    return 0 * x[:2]


def sheared(x):
    return np.array([0.3 + 0.1 * x[0] ** 2 + 0.2 * x[1], 0.1 * x[0]])


@pytest.mark.ranks(2)
@pytest.mark.parametrize("options", ({}, {"interior": "free"}, {"close_gap": True, "gap": 0.05}))
def test_linear_forms(options):
    """One step gives what TiedProblem gives, with prescribed displacements on Γ0 and Γ1 too."""
    V, fts, tie = two_blocks(**options)
    places, tags = (sheared, sheared), (meshes.LEFT, meshes.LEFT)
    problem, bcs = problem_of(V, fts, tie, small_strain_energy, places, tags)
    us = problem.solve()
    assert problem.iterations == problem.solver.getIterationNumber() == 1
    a, L = [], []
    for W in V:
        u, v, w = ufl.TrialFunction(W), ufl.TestFunction(W), fem.Function(W)
        form = ufl.derivative(small_strain_energy(w) * ufl.dx, w, v)
        a.append(ufl.derivative(form, w, u))
        L.append(ufl.inner(fem.Constant(W.mesh, (0.0, 0.0)), v) * ufl.dx)
    reference = TiedProblem(a, L, bcs=bcs, ties=[tie])
    for one in (problem, reference):
        with pytest.raises(AttributeError, match=r"^bcs of a .* can't be set; nothing can"):
            one.bcs = bcs
    for u, v in zip(us, reference.solve(), strict=True):
        assert np.abs(u.x.array - v.x.array).max(initial=0) <= 1e-11  # a condition of 1e4
    difference = problem.multipliers(tie) - reference.multipliers(tie)
    assert np.abs(difference).max(initial=0) <= 1e-10 * np.abs(reference.x.array).max()
    before, states = [u.x.array.copy() for u in us], [K.stateGet() for K in problem._K]
    for bc in bcs:
        bc.function.x.array[:] *= 2
    if not options:
        for u, v in zip(problem.solve(), before, strict=True):
            assert np.abs(u.x.array - 2 * v).max(initial=0) <= 1e-11
        assert [K.stateGet() for K in problem._K] == states  # assembled once


@pytest.mark.ranks(degree=[1])
@pytest.mark.parametrize("degree", (1, 2))
def test_quadratic_convergence(degree):
    V, fts, tie = two_blocks(degree)
    problem, _ = problem_of(
        V, fts, tie, energy, (fixed, sheared), petsc_options={"snes_rtol": 1e-14}
    )
    norms = []
    problem.solver.setMonitor(lambda snes, step, norm: norms.append(norm))
    problem.solve()
    print(norms)
    fast = [b / a**2 for a, b in pairwise(norms) if 1e-7 < a < 1e-1]
    assert len(fast) >= 2 and max(fast) < 10
    assert norms[-1] <= 1e-12


def test_large_rotation_is_rigid():
    """The tie carries a body through half a turn without any strain."""
    V, fts, tie = two_blocks()
    options = {"snes_rtol": 1e-14}
    problem, bcs = problem_of(V, fts, tie, energy, (fixed, None), petsc_options=options)
    for angle in np.linspace(0, np.pi, 6)[1:]:
        bcs[0].function.interpolate(rotation(angle))
        us = problem.solve()
    for u in us:
        exact = fem.Function(u.function_space)
        exact.interpolate(rotation(np.pi))
        assert np.abs(u.x.array - exact.x.array).max(initial=0) <= 1e-9
    assert max(np.abs(f.x.array).max(initial=0) for f in tie.gap(*us)) <= 1e-9


@two_ranks()
def test_failure_is_an_error():
    V, fts, tie = two_blocks()
    options = {"snes_max_it": 1}
    problem, _ = problem_of(V, fts, tie, energy, (fixed, sheared), petsc_options=options)
    with pytest.raises(SolveError, match=r"after 1 steps.*DIVERGED_MAX_IT"):
        problem.solve()
    problem, _ = problem_of(V, fts, tie, lambda u: energy(u) + u[0], (None, None))
    with pytest.raises(SolveError):
        problem.solve()


@two_ranks()
def test_stiffness_that_is_no_number_later():
    """Cells turned over may be seen by the stiffness alone: smaller load steps may help."""
    V, fts, tie = two_blocks()
    problem, _ = problem_of(V, fts, tie, energy, (fixed, sheared))
    problem.solve()
    x = problem.x.copy()
    x.set(np.nan)  # not in a solve: PETSc's log of events would be wrong for later tests
    with pytest.raises(SolveError, match=r"after \d+ steps: the stiffness of body 0 has NaN"):
        problem._jacobian(x)


def test_numbers_of_forms():
    V, _, tie = two_blocks(1)
    u = fem.Function(V[0])
    F = ufl.derivative(energy(u) * ufl.dx, u)
    with pytest.raises(ValueError, match="1 residual forms, 2 functions"):
        NonlinearTiedProblem([F], [u, u], ties=[tie])


@pytest.mark.ranks
def test_is_freed():
    """No circle through PETSc keeps the problem and its matrices alive."""
    V, fts, tie = two_blocks(1)
    problem, _ = problem_of(V, fts, tie, energy, (fixed, sheared))
    alive = weakref.ref(problem)
    del problem
    gc.collect()
    assert alive() is None


@pytest.mark.ranks(2, E=[1e9])
@pytest.mark.parametrize("E", (1e-12, 1e9))
def test_units(E):
    """Small stiffness isn't hidden by prescribed displacements: the same in any unit."""
    results = []
    for modulus in (1.0, E):
        V, fts, tie = two_blocks()

        def density(u, modulus=modulus):
            # One kernel for all values
            return fem.Constant(u.function_space.mesh, modulus) * energy(u)

        places = (lambda x: 0 * x[:2], lambda x: 0.1 + 0 * x[:2])
        problem, _ = problem_of(V, fts, tie, density, places)
        results.append([u.x.array.copy() for u in problem.solve()])
    for u, v in zip(*results, strict=True):
        np.testing.assert_allclose(u, v, atol=1e-8)


def load_steps(solver=None, steps=(0.02, 0.04, 0.06), **options):
    """Displacements, numbers of Newton's steps, and how often J was assembled and factorised."""
    V, fts, tie = two_blocks()
    options = {"snes_rtol": 1e-10, **options}
    problem, bcs = problem_of(
        V, fts, tie, energy, (fixed, None), solver=solver, petsc_options=options
    )
    PETSc.Log.begin()
    events = [PETSc.Log.Event(name) for name in ("SNESJacobianEval", "MatLUFactorNum")]
    before = [comm.allreduce(event.getPerfInfo()["count"], MPI.MAX) for event in events]
    newton = []
    for step in steps:
        bcs[0].function.interpolate(lambda x, step=step: step * sheared(x))
        us = problem.solve()
        newton.append(problem.solver.getIterationNumber())
    counts = [comm.allreduce(event.getPerfInfo()["count"], MPI.MAX) for event in events]
    return us, newton, *(after - b for after, b in zip(counts, before, strict=True))


def assert_same(us, reference):
    for u, v in zip(us, reference, strict=True):
        np.testing.assert_allclose(u.x.array, v.x.array, atol=1e-10)


@pytest.mark.parametrize("solver", choice.SOLVERS)
def test_solvers_agree(solver):
    reference, newton, *_ = load_steps(steps=(0.3,))
    us, its, *_ = load_steps(solver, steps=(0.3,))
    assert its == newton
    assert_same(us, reference)


@pytest.mark.ranks(2)
@pytest.mark.parametrize("solver", ("bodies", "iterative"))
def test_confined(solver):
    """Displacements are exact after one step: only tractions are left for the second one."""
    V, fts, tie = two_blocks()
    us, goals = ([fem.Function(W) for W in V] for _ in range(2))
    bcs = []
    for W, ft, goal in zip(V, fts, goals, strict=True):
        goal.interpolate(lambda x: np.array([0 * x[0], -0.1 * x[1]]))
        for tag in (meshes.LEFT, meshes.RIGHT, meshes.BOTTOM, meshes.TOP):
            if (ft, tag) not in ((fts[0], meshes.TOP), (fts[1], meshes.BOTTOM)):
                bcs.append(fem.dirichletbc(goal, fem.locate_dofs_topological(W, 1, ft.find(tag))))
    F = [ufl.derivative(energy(u) * ufl.dx, u) for u in us]
    problem = NonlinearTiedProblem(F, us, bcs=bcs, ties=[tie], solver=solver)
    problem.solve()
    assert problem.iterations == 2
    for u, goal in zip(us, goals, strict=True):
        assert np.abs(u.x.array - goal.x.array).max(initial=0) <= 1e-10


def test_a_solver_of_the_users():
    """A type that is named replaces all options of the default, as for TiedProblem."""
    V, fts, tie = two_blocks()
    options = {"pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
    problem, _ = problem_of(V, fts, tie, energy, (fixed, sheared), petsc_options=options)
    us = problem.solve()
    assert problem.solver.getKSP().getType() == "gmres"
    reference, _ = problem_of(V, fts, tie, energy, (fixed, sheared))
    assert_same(us, reference.solve())
    assert reference.solver.getKSP().getType() == "preonly"


@pytest.mark.parametrize("solver, factors", (("direct", 1), ("bodies", 3), ("iterative", 1)))
def test_a_factorisation_that_is_kept(solver, factors):
    """The docstring's examples: what is factorised once does for all load steps."""
    reference, newton, assembled, factorised = load_steps(solver)
    assert assembled == sum(newton) and factorised >= assembled
    kept = {"snes_lag_jacobian": -2, "snes_lag_jacobian_persists": True}
    us, its, assembled, factorised = load_steps(solver, **kept)
    assert (assembled, factorised) == (1, factors) and sum(its) > sum(newton)
    assert_same(us, reference)
    kept = {"snes_lag_preconditioner": -2, "snes_lag_preconditioner_persists": True}
    us, its, assembled, factorised = load_steps(solver, **kept)
    assert (assembled, factorised) == (sum(its), factors)
    if solver != "direct":  # the others iterate on the system of now
        assert its == newton
    assert_same(us, reference)


def test_a_factorisation_for_some_steps():
    _, newton, assembled, factorised = load_steps("bodies", snes_lag_jacobian=2)
    assert assembled == 2 * 3 and sum(newton) == 3 * 3 and factorised < 3 * sum(newton)


@pytest.mark.parametrize("reaction, match", ((-30.0, "symmetric and positive"), (-1e4, "diagonal")))
def test_a_solver_that_fails(reaction, match):
    """Its own words and advice, not SNES's, and not the first time alone."""
    V, fts, tie = two_blocks()

    def density(u):
        return small_strain_energy(u) + reaction * ufl.inner(u, u)

    problem, _ = problem_of(V, fts, tie, density, (fixed, sheared), solver="iterative")
    for _ in range(2):
        with pytest.raises(SolveError, match=f'{match}.* take solver="direct"'):
            problem.solve()


def test_a_solver_that_is_not_possible():
    V, fts, tie = two_blocks(interior="free")
    for solver, match in (("bodies", "free interior nodes"), ("cholesky", "solver is one of")):
        with pytest.raises(ValueError, match=match):
            problem_of(V, fts, tie, energy, (fixed, sheared), solver=solver)
