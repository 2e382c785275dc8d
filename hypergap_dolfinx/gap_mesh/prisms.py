# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cells between facets that match or nearly do, or that are quarters of the other's.

Each facet and its twin make three tetrahedra (:class:`Prisms`), whatever their neighbours do:
the front fills the rest. Each facet and its four quarters make seven (:func:`between_quarters`).

Surfaces are given as ``x0, facets0, x1, facets1, size``: vertices of Γ0, ``(num_vertices0, 3)``,
its facets, counterclockwise seen from Γ1, ``(num_facets0, 3)``, the same of Γ1, whose facets turn
like Γ0's, and the length of the finer side's edges.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.graph import components, lots, row_codes
from hypergap_dolfinx.gap_mesh.tetrahedra import find, single_faces
from hypergap_dolfinx.gap_mesh.tolerances import NEAR_MATCHING
from hypergap_dolfinx.surface.trace import lengths, normals_by_area

CORNERS = np.array(tuple(product((-1, 1), repeat=3)))  # of a cube


def twins(x0, facets0, x1, facets1, size: float) -> npt.NDArray[np.intp]:
    """Pairs of facets whose vertices lie at the same places, up to :data:`.NEAR_MATCHING`.

    Where outlines nearly match, facets cut along them are whole ones but for slivers, which have
    two vertices at one place. They are paired with an edge of the other side: between the twins on
    both sides of the slivers, those of Γ0 come first, seen along the edge from the left.

    Returns:
        The facets of Γ0 and their twins on Γ1, with vertices in the same order, ``(num_pairs, 2,
        3)``; one of the edge's ends stands twice.
    """
    n0 = len(x0)
    i, j, _ = _near(x0, x1, NEAR_MATCHING * size)
    near = np.zeros(n0, dtype=bool), np.zeros(len(x1), dtype=bool)
    near[0][i] = near[1][j] = True
    sides = [f[at[f].all(axis=1)] for f, at in zip((facets0, facets1), near, strict=True)]
    if not all(map(len, sides)):
        return np.empty((0, 2, 3), dtype=np.intp)
    place = components(n0 + len(x1), i, n0 + j)
    places = place[:n0], place[n0:]
    sides = [_turned(*each) for each in zip(sides, places, strict=True)]
    num = [(np.diff(np.sort(at[f], axis=1)) > 0).sum(axis=1) for f, at in zip(sides, places)]
    whole = [facets[n == 2] for facets, n in zip(sides, num, strict=True)]
    corners = np.vstack([at[facets] for facets, at in zip(whole, places, strict=True)])
    found, key = np.unique(row_codes(corners), return_inverse=True)
    keys, at = np.split(key, [len(whole[0])]), np.empty((2, len(found)), dtype=np.intp)
    for own, k in zip(at, keys, strict=True):
        own[k] = np.arange(len(k))
    both = np.all([np.bincount(k, minlength=len(found)) == 1 for k in keys], axis=0)
    pairs = np.stack([facets[own[both]] for facets, own in zip(whole, at, strict=True)], axis=1)
    near_pairs = [pairs[some][_are_near(x0, x1, pairs[some])] for some in lots(len(pairs))]
    slivers = [facets[n == 1] for facets, n in zip(sides, num, strict=True)]
    return np.concatenate((*near_pairs, *(_edges(k, slivers, sides, places) for k in (0, 1))))


def _are_near(x0, x1, pairs) -> npt.NDArray[np.bool_]:
    """Mask of pairs that are near each other for their heights."""
    v = np.stack((x0[pairs[:, 0]], x1[pairs[:, 1]]), axis=1)  # (pair, side, vertex, x_i)
    heights = np.minimum(*(lengths(normals_by_area(v[:, i])) for i in (0, 1)))
    heights /= np.linalg.norm(v - np.roll(v, 1, axis=2), axis=3).max(axis=(1, 2), initial=1e-300)
    return np.linalg.norm(v[:, 0] - v[:, 1], axis=2).max(axis=1) <= NEAR_MATCHING * heights


def _turned(facets, place):
    """Facets rotated to begin with the vertex at the place of the smallest number."""
    first = place[facets].argmin(axis=1)[:, None]
    return np.take_along_axis(facets, (first + np.arange(3)) % 3, axis=1)


def _edges(k: int, slivers, sides, places) -> npt.NDArray[np.intp]:
    """One side's slivers, paired with the other's leftmost edges, or rightmost if it is Γ1."""
    own, at, other = places[k], places[1 - k], sides[1 - k]
    if not len(slivers[k]):
        return np.empty((0, 2, 3), dtype=np.intp)

    def directed(facets):
        """Edges from a place to one of a higher number: places, vertices, and what is beside."""
        edges = np.stack((facets, np.roll(facets, -1, axis=1)), axis=2).reshape(-1, 2)
        up = at[edges[:, 0]] < at[edges[:, 1]]
        edges[~up] = edges[~up][:, ::-1]
        return np.column_stack((at[edges], edges)), up == (k == 0)

    ends = np.sort(own[slivers[k]], axis=1)[:, [0, 2]]
    edges, _ = directed(other)
    num = int(max(part.max(initial=0) for part in places)) + 1
    edges = edges[np.isin(edges[:, :2] @ (num, 1), ends @ (num, 1))]
    beside, there = directed(slivers[1 - k])
    taken = set(map(tuple, beside[there].tolist()))
    found = {e[:2]: e[2:] for e in map(tuple, edges.tolist()) if e not in taken}
    pairs = []
    for sliver, two in zip(slivers[k], map(tuple, ends.tolist()), strict=True):
        if two in found:
            edge = np.array(found[two])[(own[sliver] == two[1]).astype(int)]
            pairs.append((sliver, edge) if k == 0 else (edge, sliver))
    return np.array(pairs, dtype=np.intp).reshape(-1, 2, 3)


def _near(x, y, reach: float):
    """Pairs of places in x and y within reach: their numbers, and the squares of distances."""
    cell, low = 8 * reach, y.min(axis=0)
    strides = np.cumprod(np.append(1, ((np.ptp(y, axis=0) / cell).astype(np.int64) + 2)[:2]))

    def keys(points):
        return np.floor((points - low) / cell).astype(np.int64) @ strides

    order = np.argsort(keys(y), kind="stable")
    known = keys(y)[order]
    pairs = []
    for some in lots(len(x)):
        around = np.sort(keys(x[some, None] + reach * CORNERS), axis=1)  # of a cube around each
        i, k = np.nonzero(np.diff(around, axis=1, prepend=-1) != 0)
        places = around[i, k]
        first, last = (np.searchsorted(known, places, side=side) for side in ("left", "right"))
        count = last - first
        i = some.start + np.repeat(i, count)
        j = order[np.arange(len(i)) - np.repeat(np.cumsum(count) - count - first, count)]
        square = ((x[i] - y[j]) ** 2).sum(axis=1)
        use = square < reach**2
        pairs.append((i[use], j[use], square[use]))
    return tuple(map(np.concatenate, zip(*pairs, strict=True)))


def middles(x0, facets0, x1, facets1, size: float) -> npt.NDArray[np.intp] | None:
    """Γ1's vertices at Γ0's vertices and edges, if its facets are quarters of Γ0's.

    Returns:
        For each facet of Γ0 the vertices at its corners, and those in the middle of the edges
        opposite to them, ``(num_facets0, 6)``; None if its facets aren't quarters.
    """
    if len(facets1) != 4 * len(facets0):
        return None
    i, j, square = _near(x0, x1, NEAR_MATCHING * size)
    order = np.lexsort((square, i))
    found, first = np.unique(i[order], return_index=True)
    twin = j[order][first]
    if len(found) < len(x0) or len(np.unique(twin)) < len(twin):
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


@dataclass(frozen=True)
class Prisms:
    """Cells between facets and their twins."""

    pairs: npt.NDArray[np.intp]
    """The facets, Γ1's vertices numbered behind Γ0's, ``(num_pairs, 2, 3)``."""
    cells: npt.NDArray[np.int32]
    """Three for each, fewer for slivers, ``(num_cells, 4)``."""

    @classmethod
    def between(cls, pairs, n0: int, height, are_valid) -> "Prisms":
        """Prisms cut by the heights of their vertices, so that neighbours agree.

        Args:
            pairs: As of :func:`twins`.
            n0: Number of Γ0's vertices.
            height: Of each of Γ1's vertices. Between an edge and its twin the upper vertex on Γ0
                and the lower one on Γ1 are connected.
            are_valid: Mask of valid cells, of some.
        """
        found = [(pairs[:0], np.empty((0, 4), dtype=np.int32))]
        for some in lots(len(pairs)):
            own = pairs[some]
            order = np.argsort(-height[own[:, 1]], axis=1, kind="stable")
            own = own + np.array((0, n0))[:, None]
            sorted_pairs = np.take_along_axis(own, order[:, None], axis=2)
            (a, a1), (b, b1), (c, c1) = sorted_pairs.transpose(2, 1, 0)
            cells = np.stack(((a, b, c, c1), (a, b, c1, b1), (a, b1, c1, a1)))
            cells = np.ascontiguousarray(cells.transpose(2, 0, 1), dtype=np.int32)
            odd = (order[:, 1] - order[:, 0]) % 3 != 1  # turned round by the sorting
            cells[odd] = cells[odd][:, :, [1, 0, 2, 3]]
            there = (np.diff(np.sort(cells, axis=2), axis=2) > 0).all(axis=2)
            good = ~there
            good[there] = are_valid(cells[there])
            use = good.all(axis=1)
            found.append((own[use], cells[use][there[use]]))
        return cls(*map(np.concatenate, zip(*found, strict=True)))

    def left(self, facets) -> list[npt.NDArray[np.integer]]:
        """Facets of both sides, ``(num_facets, 3)`` each, that have no twins."""
        return [part[find(self.pairs[:, i], part) < 0] for i, part in enumerate(facets)]

    def walls(self, walls):
        """Walls of a slab between two surfaces, and of the room that the prisms leave in it.

        Where an edge of one outline and its twin have a wall, that of their prism replaces it.

        Args:
            walls: Walls of the slab, counterclockwise seen from inside, ``(num_walls, 3)``.

        Returns:
            The slab's and the room's walls, counterclockwise seen from inside.
        """
        faces = outer_faces(self.cells)
        quads = np.stack((self.pairs, np.roll(self.pairs, -1, axis=2)), axis=3)
        quads = quads.transpose(0, 2, 1, 3).reshape(-1, 4)  # an edge of Γ0, its twin
        four = quads[:, [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]]
        of_walls = _among(four.reshape(-1, 3), walls).reshape(-1, 4)
        four = four[of_walls.sum(axis=1) == 2].reshape(-1, 3)
        others = walls[~_among(walls, four)]
        walls = np.vstack((others, faces[_among(faces, four)]))
        inner = ~_among(faces, np.vstack((walls, self.pairs.reshape(-1, 3))))
        rest = walls[~_among(walls, faces)]
        return walls, np.vstack((rest, faces[inner][:, ::-1]))


def _among(triangles, others) -> npt.NDArray[np.bool_]:
    """Mask of triangles that are among others, whatever the order of their vertices."""
    codes = row_codes(np.sort(np.vstack((triangles, others)), axis=1))
    return np.isin(codes[: len(triangles)], codes[len(triangles) :])


def outer_faces(cells) -> npt.NDArray[np.intp]:
    """The cells' faces with no other cell behind them, counterclockwise seen from inside."""
    return single_faces(cells, np.empty((0, 3), dtype=np.intp))[0][:, ::-1]
