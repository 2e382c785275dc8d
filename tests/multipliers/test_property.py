# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Random scenes: the patch test holds, or an exception comes that the documentation names."""

from itertools import pairwise, permutations

import helpers
import numpy as np
import pytest
from assembly import (
    comm,
    displacement_error,
    linear,
    problem,
    rectangle,
    smooth_errors,
    smooth_problem,
    tie,
)
from hypothesis import HealthCheck, assume, event, given, settings
from hypothesis import strategies as st

from hypergap_dolfinx import InterfaceError, InvertedCellError, SolveError
from meshes import BOTTOM, LEFT, RIGHT, TOP

pytestmark = pytest.mark.ranks(2)

ELEMENTS = st.sampled_from((("triangle", 1), ("triangle", 2), ("quadrilateral", 1)))
EXAMPLES = (60 if helpers.thorough else 24) if comm.size == 1 else 8


@st.composite
def polygons(draw):
    """An interface: a polygon's corners from (0, 1) to (1, 1)."""
    num = draw(st.integers(0, 3))
    heights = draw(st.lists(st.floats(-0.4, 0.4), min_size=num, max_size=num))
    return np.linspace(0, 1, num + 2), 1 + np.array([0, *heights, 0])


@st.composite
def scenes(draw):
    """Two blocks above each other on both sides of a polygon, scaled and shifted."""
    corners = draw(polygons())
    along = len(corners[0]) - 1
    bodies = []
    for fewest in (1, 2):  # on one edge a side, a corner can't be told from a curve
        cell, degree = draw(ELEMENTS)
        bodies.append((draw(st.integers(fewest, 6)) * along, draw(st.integers(1, 3)), cell, degree))
    tags = st.sampled_from((LEFT, RIGHT, BOTTOM, TOP))
    right = draw(st.integers(0, 3)) > 0
    pair = ((0, TOP), (1, BOTTOM)) if right else ((0, draw(tags)), (1, draw(tags)))
    swap = draw(st.booleans())
    unit = 10.0 ** draw(st.integers(-6, 6))
    shift = draw(st.sampled_from((0.0, 0.0, 1.0, 100.0)))
    E = [10.0 ** draw(st.integers(-6, 6))] * 2
    ends = draw(st.sampled_from(((), (0,), (1,), (0, 1))))
    damage = draw(st.sampled_from((None,) * 8 + (np.nan, np.inf)))
    return corners, bodies, pair[::-1] if swap else pair, unit, shift, E, ends, damage


def create(scene):
    """The bodies of a scene, held at the lower edge and at some of the sides."""
    corners, sizes, _, unit, shift, E, _, _ = scene
    edges = ((lambda x: 0 * x, lambda x: np.interp(x, *corners)),)
    edges += ((lambda x: np.interp(x, *corners), lambda x: 0 * x + 2),)
    bodies = []
    for (n, m, cell, degree), (low, high), e in zip(sizes, edges, E, strict=True):

        def mapping(x, low=low, high=high):
            y = low(x[:, 0]) + x[:, 1] * (high(x[:, 0]) - low(x[:, 0]))
            return unit * (np.column_stack((x[:, 0], y)) + shift)

        bodies.append(rectangle((n, m), 0, 0, cell=cell, degree=degree, E=e, mapping=mapping))
    return bodies


@settings(
    max_examples=EXAMPLES,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
@given(scenes())
def test_patch_or_exception(scene):
    pair, shift, ends, damage = (scene[i] for i in (2, 4, 6, 7))
    bodies = create(scene)
    right = {pair[0], pair[1]} == {(0, TOP), (1, BOTTOM)}
    if damage is not None and len(bodies[1].mesh.geometry.x):
        bodies[1].mesh.geometry.x[0, 1] = damage
    fixed = [(0, BOTTOM, (0, 1)), *((i, LEFT, (0, 1)) for i in ends)]
    try:
        p = problem(bodies, [tie(bodies, *pair)], [(0, TOP), (1, BOTTOM)], fixed)
        us = p.solve()
    except (InterfaceError, InvertedCellError, SolveError, ValueError) as error:
        said = str(error)
        assert "\n" not in said
        # Good scenes are refused for one reason only: Γ1 is prescribed or the surfaces are folded
        assert not right or damage is not None or "swap the sides" in said, said
        return
    values = np.concatenate([u.x.array for u in us])
    assert np.isfinite(values).all()
    if right and damage is None:
        assert displacement_error(p, linear) <= 1e-11 * max(1.0, 0.01 * shift)


@st.composite
def walls(draw):
    """Courses of blocks on each other: cells, where they are, elements; tied by up to 12 ties."""
    cell, degree = draw(ELEMENTS)
    columns = draw(st.lists(st.integers(1, 3), min_size=2, max_size=3))
    blocks = []
    for row, num in enumerate(columns):
        inner = [draw(st.floats(0.2, 0.8)) for _ in range(num - 1)]
        cuts = np.array([0, *np.cumsum([*inner, 1]) / (sum(inner) + 1)][: num + 1])
        for left, right in pairwise(cuts):
            n = draw(st.integers(1, 5)), draw(st.integers(1, 4))
            blocks.append((n, (left, row / 2), (right, (row + 1) / 2)))
    return cell, degree, blocks, draw(st.booleans())


@settings(
    max_examples=EXAMPLES // 3,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
@given(walls())
def test_walls(wall):
    """A smooth field in as many bodies and ties as there may be: no pair spoils another's."""
    cell, degree, blocks, swap = wall
    bodies = [rectangle(*block, cell=cell, degree=degree) for block in blocks]
    pairs = []
    for (i, (_, low, high)), (j, (_, low2, high2)) in permutations(enumerate(blocks), 2):
        if low[1] == low2[1] and abs(high[0] - low2[0]) < 1e-9:
            pairs.append(((i, RIGHT), (j, LEFT)))
        if low2[1] == high[1] and min(high[0], high2[0]) - max(low[0], low2[0]) > 1e-6:
            pairs.append(((i, TOP), (j, BOTTOM)))
    assume(len(pairs) <= 12)
    tied = [side for pair in pairs for side in pair]
    ties = [tie(bodies, *(pair[::-1] if swap else pair)) for pair in pairs]
    p = smooth_problem(bodies, ties, tied)
    ratios = smooth_errors(p) / smooth_errors(smooth_problem(bodies, (), tied, "held"))
    event(f"{len(pairs)} ties")
    # Blocks of one cell beside finer ones: exact data are better than what the coarse ones have
    assert ratios.max() <= 3
