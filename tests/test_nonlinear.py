# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""NonlinearTiedProblem: the linear problem's answer, quadratic convergence, large rotations."""

import gc
import weakref
from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest

import meshes
import ufl
from dolfinx import fem
from hypergap_dolfinx import NonlinearTiedProblem, SolveError, Tie, TiedProblem

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
    assert problem.solver.getIterationNumber() == 1
    a, L = [], []
    for W in V:
        u, v, w = ufl.TrialFunction(W), ufl.TestFunction(W), fem.Function(W)
        form = ufl.derivative(small_strain_energy(w) * ufl.dx, w, v)
        a.append(ufl.derivative(form, w, u))
        L.append(ufl.inner(fem.Constant(W.mesh, (0.0, 0.0)), v) * ufl.dx)
    reference = TiedProblem(a, L, bcs=bcs, ties=[tie])
    for u, v in zip(us, reference.solve(), strict=True):
        assert np.abs(u.x.array - v.x.array).max(initial=0) <= 1e-11  # a condition of 1e4
    difference = problem.multipliers(tie) - reference.multipliers(tie)
    assert np.abs(difference).max(initial=0) <= 1e-10 * np.abs(reference.x.array).max()


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


@pytest.mark.ranks
def test_failure_is_an_error():
    V, fts, tie = two_blocks()
    options = {"snes_max_it": 1}
    problem, _ = problem_of(V, fts, tie, energy, (fixed, sheared), petsc_options=options)
    with pytest.raises(SolveError, match=r"after 1 steps.*DIVERGED_MAX_IT"):
        problem.solve()
    problem, _ = problem_of(V, fts, tie, lambda u: energy(u) + u[0], (None, None))
    with pytest.raises(SolveError):
        problem.solve()


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
