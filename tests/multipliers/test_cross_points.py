# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Ties that meet: cross points, T-junctions, chains, nested frames."""

from itertools import product

from mpi4py import MPI

import any_assemblies
import helpers
import numpy as np
import pytest
from assembly import (
    check,
    displacement_error,
    linear,
    problem,
    quadratic,
    rectangle,
    stretching,
    tie,
)
from helpers import sweep, two_ranks

import meshes
import ufl
from dolfinx import fem
from hypergap_dolfinx import Tie, TiedProblem, find_touching
from meshes import BOTTOM, LEFT, RIGHT, TOP

comm = MPI.COMM_WORLD
RULE = {"quadrature_degree": 6}
ELEMENTS = {
    "P1": ("triangle", 1),
    "Q1": ("quadrilateral", 1),
    "P2": ("triangle", 2),
    "Q2": ("quadrilateral", 2),
    "Q3": ("quadrilateral", 3),
}
# P1 and Q1 have the same dofs on an edge, and so do P2 and Q2. The algebra is the same on several
# ranks: one element shows what ranks change
SOME = [*ELEMENTS] if helpers.thorough else ["P1", "Q2", "Q3"]
NAMES = SOME if comm.size == 1 else ["Q2"]
ALL_SIDES = ("P1", "Q2")
"""Elements with which more choices of sides are made; the others differ in their dofs alone."""


def check_ties(bodies, pairs, swaps, fixed, degree, **options):
    """Tie pairs of (body, tag), the ones that say so with their sides swapped."""
    turned = [pair[::-1] if swap else pair for pair, swap in zip(pairs, swaps, strict=True)]
    tied = [side for pair in pairs for side in pair]
    ties = [tie(bodies, *pair) for pair in turned]
    check(bodies, ties, tied, fixed, quadratic if degree > 1 else linear, **options)


def sides(number):
    """Ways to choose Γ1 of several ties: all, or a few on several ranks."""
    choices = list(product((False, True), repeat=number))
    return choices if comm.size == 1 else choices[1::5]


FOUR = [((0, RIGHT), (1, LEFT)), ((2, RIGHT), (3, LEFT)), ((0, TOP), (2, BOTTOM))]
FOUR += [((1, TOP), (3, BOTTOM))]


@pytest.mark.ranks(2, cells=[(2, 3, 4, 5), (1, 1, 1, 1)])
@pytest.mark.parametrize(
    ("name", "cells"),
    sweep(product(NAMES, ((1, 1, 1, 1), (2, 3, 4, 5), (5, 1, 3, 2), (2, 2, 2, 2))), 5),
)
def test_four_blocks(name, cells):
    """Around a point, which is in Γ1 of two ties, in Γ1 of one and Γ0 of another, ..."""
    cell, degree = ELEMENTS[name]
    corners = ((0, 0), (0.5, 0), (0, 0.5), (0.5, 0.5))
    bodies = [
        rectangle((n, n), (x, y), (x + 0.5, y + 0.5), cell=cell, degree=degree)
        for n, (x, y) in zip(cells, corners, strict=True)
    ]
    every = name in ALL_SIDES and cells in ((1, 1, 1, 1), (2, 3, 4, 5))
    for swaps in sweep(sides(4), 5 if every else 11):
        check_ties(bodies, FOUR, swaps, [(0, BOTTOM, (0, 1))], degree)


@two_ranks(name=["Q2"])
@pytest.mark.parametrize("name", sweep(("P1", "Q2"), 2))
def test_four_blocks_between_walls(name):
    cell, degree = ELEMENTS[name]
    corners = ((0, 0), (0.5, 0), (0, 0.5), (0.5, 0.5))
    fixed = [(i, LEFT if i % 2 == 0 else RIGHT, (0, 1)) for i in range(4)]
    for cells, swaps in product(((2, 3, 4, 5), (1, 2, 1, 1)), sides(4)[1::4]):
        bodies = [
            rectangle((n, n), (x, y), (x + 0.5, y + 0.5), cell=cell, degree=degree)
            for n, (x, y) in zip(cells, corners, strict=True)
        ]
        check_ties(bodies, FOUR, swaps, fixed, degree)


@pytest.mark.ranks(2, cells=[(2, 3, 4), (3, 1, 2)])
@pytest.mark.parametrize(
    ("cut", "cells", "name"),
    sweep(product((0.5, 0.37), ((1, 1, 1), (2, 3, 4), (3, 1, 2), (5, 4, 1)), NAMES), 4),
)
def test_t_junction(name, cells, cut):
    """Two blocks under one, which gives both ties all of its lower side."""
    cell, degree = ELEMENTS[name]
    corners = (((0, 0), (cut, 0.5)), ((cut, 0), (1, 0.5)), ((0, 0.5), (1, 1)))
    pairs = [((0, RIGHT), (1, LEFT)), ((0, TOP), (2, BOTTOM)), ((1, TOP), (2, BOTTOM))]
    bodies = [
        rectangle((n, 2), *corner, cell=cell, degree=degree)
        for n, corner in zip(cells, corners, strict=True)
    ]
    all_fixed = ([(0, BOTTOM, (0, 1))], [(2, TOP, (0, 1)), (0, LEFT, (0,)), (2, LEFT, (0,))])
    every = list(product(sides(3), all_fixed))
    more = name in ALL_SIDES and cut == 0.5 and cells in ((1, 1, 1), (2, 3, 4))
    for swaps, fixed in sweep(every, 7 if more else 13):
        check_ties(bodies, pairs, swaps, fixed, degree)


@pytest.mark.ranks(2, cells=[(3, 2)])
@pytest.mark.parametrize(
    ("name", "cells"), sweep(product(NAMES, ((3, 2), (1, 1), (1, 5), (1, 2))), 5)
)
def test_chain_of_ten(name, cells):
    cell, degree = ELEMENTS[name]
    pairs = [((i, RIGHT), (i + 1, LEFT)) for i in range(9)]
    fixed = [(0, LEFT, (0, 1)), (9, RIGHT, (0, 1)), *((i, BOTTOM, (1,)) for i in range(10))]
    bodies = [
        rectangle((1, cells[i % 2]), (i, 0), (i + 1, 10), cell=cell, degree=degree)
        for i in range(10)
    ]
    all_swaps = ([False] * 9, [True] * 9, [False, True] * 4 + [False])
    all_held = (fixed[:1], fixed[:2], fixed[:1] + fixed[2:])
    every = list(product(all_swaps, all_held))
    for swaps, held in sweep(every, 7 if name in ALL_SIDES and cells == (1, 2) else 13):
        check_ties(bodies, pairs, swaps, held, degree)


@pytest.mark.ranks(2, name=["Q1"])
@pytest.mark.parametrize("name", ("P1", "Q1", "P2"))
def test_nine_blocks(name):
    """Four cross points; ties whose two ends are at one."""
    cell, degree = ELEMENTS[name]
    across = [((i, RIGHT), (i + 1, LEFT)) for i in (0, 1, 3, 4, 6, 7)]
    pairs = across + [((i, TOP), (i + 3, BOTTOM)) for i in range(6)]
    for seed, cells in product(range(3), ([1] * 9, [1, 2] * 4 + [1], [2, 3, 4, 3, 2, 1, 1, 5, 2])):
        if seed and (comm.size > 1 or not helpers.thorough):
            continue
        rng = np.random.default_rng(seed)
        bodies = [
            rectangle((n, n), (i % 3, i // 3), (i % 3 + 1, i // 3 + 1), cell=cell, degree=degree)
            for i, n in enumerate(cells)
        ]
        order = rng.permutation(12)
        swaps = rng.integers(2, size=12).astype(bool)
        fixed = [(i, BOTTOM, (0, 1)) for i in range(3)]
        check_ties(bodies, [pairs[i] for i in order], swaps, fixed, degree)


def frame(n, low, high, cell, degree):
    """A square ring with n cells along each side and one across."""

    def mapping(x):
        side, s = np.divmod(4 * x[:, 1] % 4, 1)
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
        at = side.astype(int)
        outline = corners[at] + s[:, None] * (corners[at + 1] - corners[at])
        return (low + x[:, :1] * (high - low)) * outline

    return rectangle((1, 4 * n), 0, 0, mapping=mapping, cell=cell, degree=degree, periodic=True)


@pytest.mark.ranks(name=["P2"])
@pytest.mark.parametrize("name", sweep(("Q1", "P1", "P2", "Q2"), 2))
def test_three_nested_frames(name):
    """Closed interfaces; the frame in the middle is in two ties, with one side or with both."""
    cell, degree = ELEMENTS[name]
    pairs = [((0, RIGHT), (1, LEFT)), ((1, RIGHT), (2, LEFT))]
    for cells, swaps in sweep(product(((2, 3, 2), (1, 4, 3), (3, 1, 1)), sides(2)), 2):
        bodies = [frame(n, r, r + 1, cell, degree) for n, r in zip(cells, (1, 2, 3), strict=True)]
        # Two frames of one cell a side share four dofs: λ is not unique
        traction = cells != (3, 1, 1)
        check_ties(bodies, pairs, swaps, [(2, RIGHT, (0, 1))], degree, traction=traction)


@two_ranks(swaps=[(False, True)])
@pytest.mark.parametrize(
    "swaps", sweep(((False, True), (False, False), (True, False), (True, True)), 2)
)
def test_layers(swaps):
    """A body of one layer of cells: all of its dofs are in Γ0 or Γ1 of two ties."""
    corners = (((0, 0), (1, 1)), ((0, 1), (1, 1.2)), ((0, 1.2), (1, 2)))
    pairs = [((0, TOP), (1, BOTTOM)), ((1, TOP), (2, BOTTOM))]
    for name, fixed in product(NAMES, ([(0, LEFT, (0, 1))], [(i, LEFT, (0, 1)) for i in range(3)])):
        cell, degree = ELEMENTS[name]
        bodies = [
            rectangle((n, 1), *corner, cell=cell, degree=degree)
            for n, corner in zip((2, 3, 4), corners, strict=True)
        ]
        check(
            bodies,
            [tie(bodies, *(p[::-1] if s else p)) for p, s in zip(pairs, swaps)],
            [s for p in pairs for s in p],
            fixed,
            stretching,
        )


@pytest.mark.ranks(2, name=["P1"])
@pytest.mark.parametrize("name", ("P1", "Q2"))
@pytest.mark.parametrize("swaps", sides(4)[::3])
def test_multigrid(name, swaps):
    """Whichever way the ties lead, also round in a circle, and whichever nodes they share."""
    cell, degree = ELEMENTS[name]
    corners = ((0, 0), (0.5, 0), (0, 0.5), (0.5, 0.5))
    bodies = [
        rectangle((n, n), (x, y), (x + 0.5, y + 0.5), cell=cell, degree=degree)
        for n, (x, y) in zip((2, 3, 5, 4), corners, strict=True)
    ]
    ties = [tie(bodies, *(p[::-1] if s else p)) for p, s in zip(FOUR, swaps, strict=True)]
    tied = [side for pair in FOUR for side in pair]
    tied_problem = problem(bodies, ties, tied, [(0, BOTTOM, (0, 1))], solver="iterative")
    tied_problem.solve()
    assert displacement_error(tied_problem) <= 1e-8


def wave(x, m=np):
    z = x[2] if len(x) == 3 else 0
    return m.sin(1.7 * x[0] - 0.9 * x[1] + 0.8 * z) + m.cos(1.2 * x[0] + 2.1 * x[1] - z)


def over_interpolant(boxes, cell, place, tied, degree=2):
    """H¹ error over the interpolant's of a wall of boxes, low, high, count, u given all around.

    ``tied`` says what is Γ0 and Γ1 of the ties, two boxes each, in the order they are found.
    """
    spaces, exact, forms, loads, bcs = [], [], [], [], []
    for low, high, n in boxes:
        low, high = np.array(low), np.array(high)
        at = slice(len(low))
        mesh, facets = meshes.block(
            comm,
            n,
            lambda x, a=low, b=high, at=at: place(a + x[:, at] * (b - a)),
            cell=cell,
            degree=degree,
        )
        V = fem.functionspace(mesh, ("Lagrange", degree))
        u, v, f = ufl.TrialFunction(V), ufl.TestFunction(V), wave(ufl.SpatialCoordinate(mesh), ufl)
        spaces.append(V)
        exact.append(fem.Function(V))
        exact[-1].interpolate(wave)
        forms.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        loads.append(-ufl.inner(ufl.div(ufl.grad(f)), v) * ufl.dx(metadata=RULE))
        outer = [
            2 * k + e + 1 for k in range(len(n)) for e, x in enumerate((low, high)) if x[k] == e
        ]
        held = facets.indices[np.isin(facets.values, outer)]
        bcs.append(fem.dirichletbc(exact[-1], fem.locate_dofs_topological(V, len(n) - 1, held)))
    ties = []
    for sides in find_touching(spaces):
        pair = tuple(spaces.index(V) for V, _ in sides)
        ties.append(Tie(*(sides if pair in tied else sides[::-1])))
    us = TiedProblem(forms, loads, bcs=bcs, ties=ties).solve()
    squares = np.zeros(2)
    for pair in zip(us, exact, strict=True):
        for k, f in enumerate(pair):
            e = ufl.grad(f - wave(ufl.SpatialCoordinate(f.function_space.mesh), ufl))
            form = fem.form(ufl.inner(e, e) * ufl.dx(metadata=RULE))
            squares[k] += fem.assemble_scalar(form).real
    ratio = np.sqrt(squares[0] / squares[1])
    print(ratio)
    return ratio


@pytest.mark.serial
def test_strip_between_t_joints():
    """An interface of two facets: λ keeps its order, though Γ1 is Γ0 of the tie beside it."""
    boxes = (
        ((0, 0.355, 0), (0.6, 1, 1), (4, 4, 4)),
        ((0.6, 0.355, 0), (1, 1, 1), (4, 4, 4)),
        ((0, 0, 0), (0.377, 0.355, 1), (4, 4, 4)),
        ((0.377, 0, 0), (1, 0.355, 1), (4, 4, 5)),
    )
    assert over_interpolant(boxes, "hexahedron", np.copy, ((0, 2), (1, 3))) < 1.03


def bent(x):
    return x + 0.06 * np.sin(x[:, ::-1] * (2.5, 2.9) + (0.7, 0.3))


CIRCLES = ((0, 1), (1, 2)), ((0, 2), (1, 3))
"""Ties that have the first box of a pair as Γ0: both times three of them lead round in a circle."""


@pytest.mark.serial
@pytest.mark.parametrize("tied", CIRCLES)
def test_two_facets_in_circles_of_ties(tied):
    """A circle costs multipliers at one of its ties: λ keeps its order on two curved facets."""
    for n, counts in ((6, (3, 3, 4, 2)), (12, (7, 5, 7, 5))):  # they become shorter
        a, b = 0.5794 - 0.9376 / n, 0.5794 + 0.9376 / n
        corners = ((0, 0), (a, 0.5)), ((a, 0), (1, 0.5)), ((0, 0.5), (b, 1)), ((b, 0.5), (1, 1))
        boxes = [(*box, (m, n // 2)) for box, m in zip(corners, counts, strict=True)]
        assert over_interpolant(boxes, "quadrilateral", bent, tied) < 1.1


@pytest.mark.serial
@pytest.mark.parametrize(("scene", "dim", "most"), ((250, 2, 1.05), (9, 3, 1.15)))
def test_interfaces_that_end_on_a_smooth_surface(scene, dim, most):
    """They keep their multipliers: else both bodies come apart there, and these are 1.18, 1.35."""
    assert any_assemblies.run(scene, dim, np.inf)["h1"] < most
