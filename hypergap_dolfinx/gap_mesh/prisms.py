# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cells between surfaces that match or nearly do, or whose facets are quarters of the other's.

Each facet and its twin make three tetrahedra (:func:`between_twins`); each facet and its four
quarters make seven (:func:`between_quarters`).

All functions take the surfaces as ``x0, facets0, x1, facets1, size``: vertices of Γ0,
``(num_vertices0, 3)``, its facets, counterclockwise seen from Γ1, ``(num_facets0, 3)``, the same of
Γ1, whose facets turn like Γ0's, and the length of the finer side's edges.
"""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap_mesh.tolerances import NEAR_MATCHING

SPACE_DIRECTION = np.array(
    (0.6130, 0.5023, 0.6098)
)  # vertices are told apart by their place along it


def twins(x0, facets0, x1, facets1, size: float) -> npt.NDArray[np.intp] | None:
    """The vertex of Γ1 at each vertex of Γ0, ``(num_vertices0,)``; None if surfaces don't match."""
    if len(x0) != len(x1) or len(facets0) != len(facets1):
        return None
    twin = _nearest(x0, x1, NEAR_MATCHING * size)
    if twin is None:
        return None
    return twin if np.array_equal(_sorted(twin[facets0]), _sorted(facets1)) else None


def _nearest(x0, x1, reach: float) -> npt.NDArray[np.intp] | None:
    """The vertex of Γ1 nearest to each of Γ0, no two the same; None if one is out of reach."""
    for x in x0[:: max(len(x0) // 8, 1)]:  # a few first: mostly the very first has none near it
        difference = x1 - x
        if np.einsum("vi,vi->v", difference, difference).min() > reach**2:
            return None
    order = np.argsort(x1 @ SPACE_DIRECTION, kind="stable")
    place = (x1 @ SPACE_DIRECTION)[order]
    low = np.searchsorted(place, x0 @ SPACE_DIRECTION - reach)
    count = np.searchsorted(place, x0 @ SPACE_DIRECTION + reach) - low
    if count.min() == 0 or count.sum() > 500 * len(x0):  # or they take too much memory
        return None
    i = np.repeat(np.arange(len(x0)), count)
    j = order[np.arange(len(i)) - np.repeat(np.cumsum(count) - count - low, count)]
    difference = x0[i] - x1[j]
    square = np.einsum("pi,pi->p", difference, difference)
    nearest = np.lexsort((square, i))[np.cumsum(count) - count]
    twin = j[nearest]
    apart = square[nearest].max() > reach**2 or len(np.unique(twin)) < len(twin)
    return None if apart else twin


def middles(x0, facets0, x1, facets1, size: float) -> npt.NDArray[np.intp] | None:
    """Γ1's vertices at Γ0's vertices and edges, if its facets are quarters of Γ0's.

    Returns:
        For each facet of Γ0 the vertices at its corners, and those in the middle of the edges
        opposite to them, ``(num_facets0, 6)``; None if its facets aren't quarters.
    """
    if len(facets1) != 4 * len(facets0):
        return None
    twin = _nearest(x0, x1, NEAR_MATCHING * size)
    if twin is None:
        return None
    corner = np.full(len(x1), -1)
    corner[twin] = np.arange(len(x0))
    pairs = facets1[:, [(0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)]].reshape(-1, 2)
    pairs = np.unique(pairs[(corner[pairs] >= 0) @ (1, 2) == 1][:, ::-1], axis=0)
    middle, count = np.unique(pairs[:, 0], return_counts=True)
    if not len(count) or (count != 2).any():
        return None
    ends = np.sort(corner[pairs[:, 1]].reshape(-1, 2), axis=1)
    order = np.lexsort(ends.T[::-1])
    key = (ends @ (len(x0), 1))[order]
    sought = np.sort(facets0[:, [(1, 2), (2, 0), (0, 1)]], axis=2) @ (len(x0), 1)
    at = order[np.minimum(np.searchsorted(key, sought), len(key) - 1)]
    six = np.hstack((twin[facets0], middle[at]))
    return six if np.array_equal(_sorted(_quarters(six)), _sorted(facets1)) else None


def _quarters(six) -> npt.NDArray[np.intp]:
    """Quarters of facets from their corners and middles: three at the corners, and the middle."""
    a, b, c, bc, ca, ab = six.T
    parts = ((a, ab, ca), (b, bc, ab), (c, ca, bc), (bc, ca, ab))
    return np.vstack([np.column_stack(part) for part in parts])


def between_quarters(x0, facets0, x1, facets1, size: float) -> npt.NDArray[np.intp] | None:
    """Cells between facets of one side and their quarters on the other: neighbours always agree.

    There is a cell between each corner and its quarter. Between these is an octahedron, cut along
    one of its diagonals: four cells, of which none is flat if no facet is.

    Returns:
        ``(7 num_facets, 4)``, Γ1's vertices numbered behind Γ0's; None if facets aren't quarters.
    """
    n0 = len(x0)
    six = middles(x0, facets0, x1, facets1, size)
    if six is not None:
        return _sevens(facets0, six + n0)
    six = middles(x1, facets1, x0, facets0, size)
    return None if six is None else _sevens(facets1 + n0, six)[:, [1, 0, 2, 3]]


def _sevens(facets, six) -> npt.NDArray[np.intp]:
    """The cells between facets and their quarters above them."""
    a, b, c = facets.T
    a1, b1, c1, bc, ca, ab = six.T
    corners = ((a, a1, ab, ca), (b, b1, bc, ab), (c, c1, ca, bc))
    octahedron = ((a, bc, ca, ab), (a, b, bc, ab), (c, a, bc, ca), (a, b, c, bc))
    return np.vstack([np.column_stack(cell) for cell in (*corners, *octahedron)])


def _sorted(facets):
    """Facets rotated to begin with their smallest vertex, in increasing order."""
    first = facets.argmin(axis=1)[:, None]
    facets = np.take_along_axis(facets, (first + np.arange(3)) % 3, axis=1)
    return facets[np.lexsort(facets.T[::-1])]


def between_twins(x0, facets0, x1, facets1, size: float) -> npt.NDArray[np.intp] | None:
    """Cells between facets and their twins: prisms cut by the order of their vertices.

    So neighbours agree.

    Returns:
        ``(3 num_facets, 4)``, Γ1's vertices numbered behind Γ0's; None if the surfaces don't match.
    """
    twin = twins(x0, facets0, x1, facets1, size)
    if twin is None:
        return None
    order = np.argsort(facets0, axis=1)
    a, b, c = np.take_along_axis(facets0, order, axis=1).T
    a1, b1, c1 = (len(x0) + twin[v] for v in (a, b, c))
    cells = np.stack(((a, b, c, c1), (a, b, c1, b1), (a, b1, c1, a1)), axis=0)  # (cell, vertex, f)
    cells = cells.transpose(2, 0, 1).copy()
    odd = (order[:, 1] - order[:, 0]) % 3 != 1  # turned round by the sorting
    cells[odd] = cells[odd][:, :, [1, 0, 2, 3]]
    return cells.reshape(-1, 4)


def rim_walls(cells, facets0, facets1) -> npt.NDArray[np.intp]:
    """The cells' faces on the walls, counterclockwise seen from inside."""
    local = np.array([(1, 3, 2), (0, 2, 3), (0, 3, 1), (0, 1, 2)])  # seen from inside
    faces = np.vstack((cells[:, local].reshape(-1, 3), facets0, facets1[:, ::-1]))
    key = np.sort(faces, axis=1)
    _, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]
