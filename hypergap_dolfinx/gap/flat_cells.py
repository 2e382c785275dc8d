# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Cells of a slab without content: walls and facets that they lie flat on; and what is left."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.kernel import cofactor
from hypergap_dolfinx.gap.slab_cells import Slab, find

FLAT = 1e-9  # sine of the angle at which a cell's two edges, one on each side, count as parallel


def turned_over(slab: Slab) -> npt.NDArray[np.bool_]:
    """Which cells are flat or inverted with Γ1 where it belongs, ``(num_cells,)``."""
    x, alpha = slab.x[slab.cells], slab.alpha[slab.cells]
    X = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
    dalpha = alpha[:, 1:] - alpha[:, :1]
    N = np.einsum("cij,cj->ci", cofactor(X), dalpha)
    size = (np.linalg.norm(X, axis=1) ** 2).max(axis=1) * np.abs(dalpha).max(axis=1)
    return ~(np.einsum("ci,ci->c", N, slab.normal) > FLAT * size)


def faces_of(slab: Slab):
    """The faces of the cells.

    Returns:
        Vertices, ``(num_cells, 4, 3)``; how many cells have each face, ``(num_cells, 4)``; whether
        it is a facet of a side, ``(num_cells, 4)``.
    """
    faces = np.sort(np.stack([np.delete(slab.cells, k, axis=1) for k in range(4)], 1), axis=2)
    flat = faces.reshape(-1, 3)
    _, which, count = np.unique(flat, axis=0, return_inverse=True, return_counts=True)
    facet = find(slab.facets, flat) >= 0
    return faces, count[which.reshape(-1, 4)], facet.reshape(-1, 4)


def without_flat_cells(slab: Slab) -> Slab:
    """Take away what cells without content can be taken away without touching a facet."""
    return _without_flat_walls(_without_flat_facets(slab))


def _without_flat_facets(slab: Slab) -> Slab:
    """Take away cells on two facets of a side, with all of their nodes there.

    Such a cell has the facets' diagonal in front and the other one behind. All cells around the
    latter are made anew such that the facets become faces of cells with a content. Where no choice
    does that, the cell stays.
    """
    one_sided = np.ptp(slab.alpha[slab.cells], axis=1) == 0
    for cell in slab.cells[one_sided]:
        on = slab.facets[np.isin(slab.facets, cell).all(axis=1)]
        corners, count = np.unique(on, return_counts=True)
        if len(on) != 2 or len(corners) != 4:
            continue
        c, d = corners[count == 1]
        around = np.isin(slab.cells, (c, d)).sum(axis=1) == 2
        behind = around & ~np.isin(slab.cells, cell).all(axis=1)
        ring = _ring(slab.cells[behind], c, d)
        for k in range(len(ring)):  # all triangles of the ring's polygon meet in its vertex k
            r = np.roll(ring, -k)
            one, two = r[1:-1], r[2:]
            zero = np.full(len(one), r[0])
            new = np.vstack(
                (
                    np.column_stack((zero, one, two, np.full(len(one), d))),
                    np.column_stack((zero, two, one, np.full(len(one), c))),
                )
            )
            if not turned_over(replace(slab, cells=new)).any():
                slab = replace(slab, cells=np.vstack((slab.cells[~around], new)))
                break
    return slab


def _ring(cells, c, d) -> npt.NDArray[np.int64]:
    """The vertices around an edge that cells share, counterclockwise seen from its second end.

    Args:
        cells: Cells around the edge, ``(num_cells, 4)``; one is left out, whose orientation may be
            round-off.
        c: The edge's first end.
        d: Its second one.

    Returns:
        ``(num_cells + 1,)``; none if the cells don't form such a row.
    """
    after = {}
    for cell in cells.tolist():
        i, j = cell.index(c), cell.index(d)
        p, q = (k for k in range(4) if k not in (i, j))
        odd = sum(a > b for n, a in enumerate((i, j, p, q)) for b in (i, j, p, q)[n + 1 :]) % 2
        after[cell[q if odd else p]] = cell[p if odd else q]
    start = set(after) - set(after.values())
    if len(start) != 1 or len(after) < len(cells):
        return np.empty(0, dtype=np.int64)
    ring = list(start)
    while ring[-1] in after:
        ring.append(after.pop(ring[-1]))
    return np.array([] if after else ring, dtype=np.int64)


def _without_flat_walls(slab: Slab) -> Slab:
    """Take away cells that lie flat in the side walls: their four nodes are all on the boundary.

    What is left has another diagonal there, and walls are free to have any. Facets are not: a flat
    cell on them, with all of its nodes on one side, stays.
    """
    while True:
        flat = turned_over(slab)
        if not flat.any():
            return slab
        _, count, facet = faces_of(slab)
        peel = flat & ((count == 1).sum(axis=1) == 2) & ~facet.any(axis=1)
        if not peel.any():
            return slab
        slab = replace(slab, cells=slab.cells[~peel])


def error_of(slab: Slab):
    """What is wrong with a slab whose Γ1 is back where it belongs, and where, or None.

    Each cell has a content; each facet is a face of one cell; two cells share each face inside;
    and what else is bare is a wall, between the sides' rims.
    """
    x = slab.x
    wrong = turned_over(slab)
    if wrong.any():
        return f"{wrong.sum()} cells are flat or inverted", x[slab.cells[wrong.argmax()]].mean(0)
    faces, count, facet = faces_of(slab)
    facets = slab.facets
    missing = find(faces[facet & (count == 1)], facets) < 0
    if missing.any():
        place = x[facets[missing.argmax()]].mean(axis=0)
        return f"{missing.sum()} facets are no faces of it", place
    rim = np.zeros(len(x), dtype=bool)
    for side, offset in zip(slab.sides, slab.offsets, strict=True):
        for loop in side.loops():
            rim[offset + loop] = True
    alpha = slab.alpha[faces]
    wall = rim[faces].all(axis=2) & (np.ptp(alpha, axis=2) > 0)
    torn = (count > 2) | ((count == 1) & ~facet & ~wall)
    if torn.any():
        return f"the cells at {torn.sum()} faces don't fit", x[faces[torn][0]].mean(axis=0)
    return None
