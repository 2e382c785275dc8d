# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What is kept from one Newton step of contact to the next: patterns, analyses, factors."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import elasticity, two_blocks
from test_contact import Blocks

from dolfinx import fem
from hypergap_dolfinx.algebra import pattern, saddle
from hypergap_dolfinx.contact_solver import tangent
from hypergap_dolfinx.solvers.newton import Dependence
from hypergap_dolfinx.surface.moving import Sparse


def dense(entries, size):
    A = np.zeros((size, size))
    np.add.at(A, (entries.i, entries.j), entries.values)
    return A


def test_pattern():
    """What a multiplier acts on is coupled, with what lies beside it; values come to places."""
    facets = np.array([[0, 1], [1, 2], [2, 3]])  # of Γ0; node 4 is Γ1's
    a, node = np.array([1, 1, 1]), np.array([4, 0, 0])
    found = pattern.coupled(a, node, (2, 5), 2, 2, facets)
    dofs, own = [0, 1, 2, 3, 8, 9], [11, 13]  # two dofs a node; p and q of multiplier 1
    there = np.zeros((14, 14), dtype=bool)
    there[np.ix_(dofs + own, dofs + own)] = True
    there[[10, 12], [10, 12]] = True  # that of multiplier 0 is zero
    np.testing.assert_array_equal(dense(Sparse(*found.places, np.ones(there.sum())), 14), there)
    entries = Sparse(np.array([11, 11, 0]), np.array([2, 2, 8]), np.array([1.0, 2.0, 4.0]))
    placed = Sparse(*found.places, found.values(entries))
    np.testing.assert_array_equal(dense(placed, 14), dense(entries, 14))
    held = np.arange(14) == 2
    assert found.without(held).values(entries) is None
    again = found.without(held).joined(pattern.Pattern.of(14, entries))
    assert (again.values(entries) > 0).sum() == 2


@pytest.mark.ranks(2)
def test_analysis_is_kept(monkeypatch):
    """Load steps with what faces each other as before need no new matrix; equal ones no factors."""
    scene = Blocks(sliding="small")
    problem, found = scene.problem, []
    for top in (-0.05, -0.1):
        scene.top.value = top
        problem.solve()
        found.append(problem._tangent._retained)
        state = found[-1].A.stateGet()
    assert found[0] is found[1] and found[0].ksp.getPC().getType() == "cholesky"
    problem.solve()
    assert problem.iterations <= 1 and problem._tangent._retained.A.stateGet() == state
    # What there is no room for gets some
    before = [u.x.array.copy() for u in scene.u]
    few = pattern.Pattern.of(found[0].patterns[0].size, Sparse.empty())
    monkeypatch.setattr(type(problem._rows[0]), "pattern", lambda _: few)
    problem._tangent.destroy()
    for top in (0.01, -0.05, -0.1):
        scene.top.value = top
        problem.solve()
    for u, other in zip(scene.u, before, strict=True):
        np.testing.assert_allclose(u.x.array, other, atol=1e-12)


@pytest.mark.ranks(2)
def test_factors_are_kept(monkeypatch):
    """A matrix that hardly changes is solved with the factors there are, if few steps do."""
    solve, found = saddle.solve, []
    for near, iterations in ((0.0, 8), (tangent.REUSED, 8), (tangent.REUSED, 0)):
        monkeypatch.setattr(tangent, "REUSED", near)
        monkeypatch.setattr(tangent, "ITERATIONS", iterations)
        scene, count = Blocks(), []
        monkeypatch.setattr(saddle, "solve", lambda *args, c=count: c.append(1) or solve(*args))
        for top in (-0.05, -0.1, -0.1001):
            scene.top.value = top
            scene.problem.solve()
        found.append((len(count), np.concatenate([u.x.array for u in scene.u])))
    (every, u), *others = found
    assert others[0][0] < every == others[1][0]
    for _, other in others:
        np.testing.assert_allclose(other, u, atol=1e-12)


@pytest.mark.parametrize("fails", ("symmetric", "kept"))
def test_another_way(fails, monkeypatch):
    """LU where LDLᵀ doesn't solve, for good; and once more where what was kept doesn't."""
    displacements, kinds = [], []
    for way in (None, fails):
        scene = Blocks(gap=0.01, n=(3, 4))
        problem = scene.problem
        step = problem._tangent
        scene.top.value = -0.05
        if way == "symmetric":
            step._ways[0] = replace(step._ways[0], residual=0.0)
        problem.solve()
        if way == "kept":
            kept, solve = step._retained, saddle.solve

            def spoilt(ksp, b, x, kept=kept, solve=solve):
                solve(ksp, b, x)
                if kept is step._retained:
                    ksp.getRhs().scale(2.0)

            monkeypatch.setattr(saddle, "solve", spoilt)
        scene.top.value = -0.1
        problem.solve()
        monkeypatch.undo()
        kinds.append((step._retained.ksp.getPC().getType(), len(step._ways)))
        displacements.append(np.concatenate([u.x.array for u in scene.u]))
    assert kinds[1] == (("lu", 1) if fails == "symmetric" else ("cholesky", 2))
    np.testing.assert_allclose(*displacements, atol=1e-12)


def test_dependence():
    """Values of a form change with its constants, coordinates and functions."""
    (V, _), _ = two_blocks()
    _, L = elasticity(V)
    depends = Dependence(L, fem.form(L), fem.Function(V))
    assert depends.changed() and not depends.changed()
    L.constants()[0].value[0] = 1
    assert depends.changed() and not depends.changed()
    V.mesh.geometry.x[:] *= 2
    assert depends.changed() and not depends.changed()
    scene = Blocks()
    depends = Dependence(scene.F[0], scene.problem.F[0], scene.u[0])
    assert depends.changed() and not depends.changed()
    scene.u[0].x.array[-1] += 1
    assert not depends.changed(slack=1.5) and depends.changed() and not depends.changed()
