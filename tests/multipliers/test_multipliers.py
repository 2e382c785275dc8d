# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which multipliers exist: the invariant of ``multipliers/existence.py``, on what it leaves."""

from itertools import product

import numpy as np
import pytest
from assembly import comm, dense, linear, problem, rectangle, tie
from helpers import sweep
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import structural_rank

from hypergap_dolfinx.gap_mesh.cells import covered_parts
from hypergap_dolfinx.multipliers.numbering import Rows
from hypergap_dolfinx.multipliers.tolerances import CONSISTENT, INDEPENDENT_ROWS
from hypergap_dolfinx.surface.trace import create_surface
from meshes import BOTTOM, LEFT, RIGHT, TOP

SINE = 0.05
"""Least sine of the angle between a row and the span of all others: .07 at worst in these scenes
(nine blocks of degree 3), mostly .3 … .9. With rows that nearly follow from others it was 1e-4."""
ELEMENTS = {"Q1": ("quadrilateral", 1), "P2": ("triangle", 2), "Q3": ("quadrilateral", 3)}


def blocks(cells, columns, cell, degree):
    """Blocks row by row, side by side: bodies and the pairs that touch."""
    bodies, pairs = [], []
    for i, n in enumerate(cells):
        low = i % columns, i // columns
        high = low[0] + 1, low[1] + 1
        bodies.append(rectangle((n, n), low, high, cell=cell, degree=degree))
        if low[0]:
            pairs.append(((i - 1, RIGHT), (i, LEFT)))
        if low[1]:
            pairs.append(((i - columns, TOP), (i, BOTTOM)))
    return bodies, pairs


def wall(cell, degree):
    """Bricks of one cell on a plate of larger ones."""
    bodies = [rectangle((4, 2), (0, -1), (6, 0), cell=cell, degree=degree)]
    bodies += [rectangle((1, 1), (i, 0), (i + 1, 1), cell=cell, degree=degree) for i in range(6)]
    pairs = [((0, TOP), (i, BOTTOM)) for i in range(1, 7)]
    return bodies, pairs + [((i, RIGHT), (i + 1, LEFT)) for i in range(1, 6)]


SCENES = {
    "four of one cell": lambda *element: blocks((1, 1, 1, 1), 2, *element),
    "four": lambda *element: blocks((2, 3, 4, 5), 2, *element),
    "nine of one cell": lambda *element: blocks([1] * 9, 3, *element),
    "nine": lambda *element: blocks((2, 3, 4, 3, 2, 1, 1, 5, 2), 3, *element),
    "bricks": wall,
}


def rows_of(p) -> np.ndarray:
    """B on what is free, without empty columns; rows of unit length."""
    rows = []
    for row in p._constraints.free:
        num = next(B for B in row if B is not None).getSize()[0]
        sizes = [K.getSize()[0] for K in p._K]
        rows.append(
            np.hstack(
                [
                    np.zeros((num, size)) if B is None else dense(B)
                    for B, size in zip(row, sizes, strict=False)
                ]
            )
        )
    B = np.vstack(rows)
    B = B[:, np.abs(B).max(axis=0) > 1e-12 * np.abs(B).max()]
    return B / np.linalg.norm(B, axis=1, keepdims=True)


@pytest.mark.ranks(2, held=["below"], name=["P2"])
@pytest.mark.parametrize(("held", "scene"), sweep(product(("outside", "below"), SCENES), 3))
@pytest.mark.parametrize("name", ("Q1", "P2", pytest.param("Q3", marks=pytest.mark.slow)))
def test_no_row_follows_from_the_others(scene, name, held):
    """And there are no more of them than free dofs that can answer, each to one."""
    bodies, pairs = SCENES[scene](*ELEMENTS[name])
    tied = [side for pair in pairs for side in pair]
    fixed = [(0, BOTTOM, (0, 1))]
    if held == "outside":
        every = product(range(len(bodies)), (LEFT, RIGHT, BOTTOM, TOP))
        fixed = [(i, tag, (0, 1)) for i, tag in every if (i, tag) not in tied]
    for step in (1, 2, 3) if (comm.size, name) == (1, "Q1") else (2,):
        swaps = [i % step == 0 for i in range(len(pairs))]
        if scene == "bricks":  # the plate is on the same side of all of its ties
            swaps[:6] = [step == 1] * 6
        ties = [tie(bodies, *pair[:: -1 if s else 1]) for pair, s in zip(pairs, swaps, strict=True)]
        B = rows_of(problem(bodies, ties, tied, fixed, linear))
        sines = 1 / np.linalg.norm(np.linalg.pinv(B), axis=0)
        print(B.shape, sines.min())
        assert sines.min() >= SINE
        assert structural_rank(csr_matrix(np.abs(B) > 1e-12)) == len(B)


def test_rows():
    """A row counts from an angle on; one that is consistent may be nearer to the others."""
    columns = [(0, 0), (0, 1), (1, 0)]
    assert CONSISTENT < INDEPENDENT_ROWS
    for tilt, taken in ((0.9 * INDEPENDENT_ROWS, False), (1.1 * INDEPENDENT_ROWS, True)):
        rows = Rows()
        assert rows.add(columns, np.array((1.0, 1.0, 0.0)), np.sqrt(2))
        sine = tilt / np.sqrt(1 - tilt**2) * np.sqrt(2)
        row = np.array((1.0, 1.0, sine))
        assert rows.add(columns, row, np.linalg.norm(row)) == taken
        assert rows.add(columns, row, np.linalg.norm(row), CONSISTENT) == (not taken)
    # What a row loses with its prescribed columns may leave nothing of it
    assert not Rows().add(columns, np.array((0.0, 0.0, 0.1)), 1.0)


@pytest.mark.serial
@pytest.mark.parametrize("degree, least", ((1, 1.07e-2), (2, 1.6e-4), (3, 1.8e-6)))
def test_least_share(degree, least):
    """Of an edge that is covered up to .3, once in one piece and once in two; of whole edges."""
    body = rectangle((4, 1), (0, 0), (1, 1), cell="quadrilateral", degree=degree)
    surface = create_surface(body.V, body.facets(TOP), "Γ1")
    ends = np.array([(0.0, 0.3), (0.3, 0.1), (0.1, 0.0), (0.0, 1.0)])
    pieces, shares = np.array([0, 1, 1, 2]), np.array([0.3, 0.2, 0.1, 1.0])
    covered, found = covered_parts(surface, pieces, ends[:, :, None], shares)
    np.testing.assert_allclose(covered, (0.3, 0.3, 1, 0))
    np.testing.assert_allclose(found, (least, least, 1, 0), rtol=0.05)
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6)
