# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Surfaces that match, or nearly do: each facet and its twin make three tetrahedra."""

import numpy as np
import numpy.typing as npt

NEAR = 0.05  # how far apart (in edge lengths) twins may be
DIRECTION = np.array((0.6130, 0.5023, 0.6098))  # vertices are told apart by their place along it
CROWD = 500  # vertices at about the same place along it, beyond which none are looked for


def twins(x0, facets0, x1, facets1, size: float) -> npt.NDArray[np.intp] | None:
    """The vertex of Γ1 at each vertex of Γ0, if facets match too.

    Args:
        x0: Γ0's vertices, ``(num_vertices, 3)``.
        facets0: Its facets, ``(num_facets, 3)``.
        x1: Γ1's vertices.
        facets1: Its facets, turned like Γ0's.
        size: Length of the edges.

    Returns:
        ``(num_vertices,)``; None if the surfaces don't match.
    """
    if len(x0) != len(x1) or len(facets0) != len(facets1):
        return None
    order = np.argsort(x1 @ DIRECTION, kind="stable")
    place = (x1 @ DIRECTION)[order]
    low = np.searchsorted(place, x0 @ DIRECTION - NEAR * size)
    count = np.searchsorted(place, x0 @ DIRECTION + NEAR * size) - low
    if count.min() == 0 or count.sum() > CROWD * len(x0):
        return None
    i = np.repeat(np.arange(len(x0)), count)
    j = order[np.arange(len(i)) - np.repeat(np.cumsum(count) - count - low, count)]
    difference = x0[i] - x1[j]
    square = np.einsum("pi,pi->p", difference, difference)
    nearest = np.lexsort((square, i))[np.cumsum(count) - count]
    twin = j[nearest]
    if square[nearest].max() > (NEAR * size) ** 2 or len(np.unique(twin)) < len(twin):
        return None
    return twin if np.array_equal(_sorted(twin[facets0]), _sorted(facets1)) else None


def _sorted(facets):
    """Facets that begin with their smallest vertex, in rising order."""
    first = facets.argmin(axis=1)[:, None]
    facets = np.take_along_axis(facets, (first + np.arange(3)) % 3, axis=1)
    return facets[np.lexsort(facets.T[::-1])]


def prisms(facets, twin, n0: int) -> npt.NDArray[np.intp]:
    """Cells between facets and their twins.

    Cut by the order of their vertices, so that neighbours agree.

    Args:
        facets: Γ0's, counterclockwise seen from Γ1, ``(num_facets, 3)``.
        twin: Γ1's vertices, numbered from 0, at Γ0's.
        n0: Number of Γ0's vertices.

    Returns:
        ``(3 num_facets, 4)``.
    """
    order = np.argsort(facets, axis=1)
    a, b, c = np.take_along_axis(facets, order, axis=1).T
    a1, b1, c1 = (n0 + twin[v] for v in (a, b, c))
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
