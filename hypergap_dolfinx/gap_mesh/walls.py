# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls: the triangles that close Σ at the outlines of two facing pieces.

:func:`rims` pairs the boundary loops of both pieces; :class:`WallRim` makes the walls between two
loops; :class:`Outline` places points of walls on curved outlines. (An edge through the gap between
nodes of both outlines is a chord of these. Its inner points belong on the outlines, or Σ is too
small or too large by the distance of chords.)
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.gap_mesh.strip import merge
from hypergap_dolfinx.gap_mesh.tetrahedra import EDGES, find
from hypergap_dolfinx.gap_mesh.tolerances import (
    APPROXIMATED,
    COINCIDE,
    NEWTON_RIM,
    REACH_WALLS,
    WITHIN,
)
from hypergap_dolfinx.surface.nearest import nearest as place_of
from hypergap_dolfinx.surface.nearest import on_loop
from hypergap_dolfinx.surface.pieces import TRIANGLE_CORNERS, Side
from hypergap_dolfinx.surface.tolerances import CORNER, NOISE
from hypergap_dolfinx.surface.trace import lengths
from hypergap_dolfinx.trimming.outlines import is_along
from hypergap_dolfinx.trimming.tolerances import CORNER_OUTLINE

NO_WALLS = np.empty((0, 3), dtype=np.intp)


@dataclass(frozen=True)
class WallRim:
    """A pair of facing boundary loops, in Γ0's direction of travel, with a common start."""

    nodes: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]
    """Vertices of each loop in its piece."""
    s: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
    """Their parameters from 0 to 1, equal where nodes coincide; the last closes the loop."""
    tangents: npt.NDArray[np.float64]
    """Gradient of the parameter along Γ1's edges, ``(num_nodes1, 3)``."""
    length: float
    """Length of the loops."""
    shared: npt.NDArray[np.float64]
    """Parameters of coincident nodes, from 0 to 1, where walls end; infinite if there are none."""

    def walls(self, n0: int, shift, weights) -> npt.NDArray[np.intp]:
        """Triangles between the loops, by the apex rule of :func:`~.strip.merge`.

        Args:
            n0: Number of vertices of Γ0's piece; Γ1's are numbered behind them.
            shift: Displacement of Γ1's vertices, so that equal distances are decided as in the
                front, ``(num_vertices1, 3)``.
            weights: Weights of both sides' vertices, ``(num_vertices0 + num_vertices1,)``.

        Returns:
            Vertices, counterclockwise seen from outside, ``(num_triangles, 3)``.
        """
        c0, c1 = self.nodes
        w0, w1 = weights[c0] / self.length**2, weights[n0 + c1] / self.length**2
        moved = [np.einsum("ei,ei->e", self.tangents, shift[c]) for c in (c1, np.roll(c1, -1))]
        s0, s1 = self.s
        middles = [
            _middles(s0[:-1], s0[1:], w0),
            _middles(s1[:-1] + moved[0], s1[1:] + moved[1], w1),
        ]
        for i, s in enumerate(self.s):  # all stay in their wall, in their order
            wall = np.searchsorted(self.shared, (s[1:] + s[:-1]) / 2) - 1
            middles[i] = wall + _squeezed(middles[i], self.shared[wall], self.shared[wall + 1])
            middles[i] = np.maximum.accumulate(middles[i])
        side, edge, apex = merge(*middles)
        a, b = (np.where(side == i, edge, 0) for i in (0, 1))
        a1, b1 = (a + 1) % len(c0), (b + 1) % len(c1)
        on0 = np.column_stack((c0[a], c0[a1], n0 + c1[apex % len(c1)]))
        on1 = np.column_stack((n0 + c1[b1], n0 + c1[b], c0[apex % len(c0)]))
        return np.where((side == 0)[:, None], on0, on1)


def _middles(start, end, weights):
    """Places at equal power distance from the ends of edges: middles if weights are equal."""
    ds, dw = end - start, np.roll(weights, -1) - weights
    return (start + end) / 2 + dw / (2 * np.where(ds > 0, ds, 1))


def _squeezed(s, start, end):
    """Parameters, which may lie before or behind a wall, mapped to 0 to 1 in the same order."""
    if not np.isfinite(start).all():
        return s
    t = (2 * s - start - end) / (end - start)
    return (1 + t / (1 + np.abs(t))) / 2


def rims(side0: Side, side1: Side) -> list[WallRim]:
    """Pairs of boundary loops of two facing pieces.

    Raises:
        InterfaceError: The loops don't match.
    """
    loops0, loops1 = side0.loops(), [loop[::-1] for loop in side1.loops()]
    if len(loops0) != len(loops1):
        raise InterfaceError(
            f"Γ0 has {len(loops0)} boundary loops and Γ1 has {len(loops1)} around "
            f"{spot(side1.x)}: do the surfaces have the same shape there?"
        )
    found = []
    for loop1 in loops1:
        distances = [_distance(side1.x[loop1], side0.x[loop0]) for loop0 in loops0]
        loop0 = loops0.pop(distances.index(min(distances)))
        c0, c1, s0, s1, shared = _parametrise(side0, loop0, side1, loop1)
        x = side1.x[c1]
        edge = np.roll(x, -1, axis=0) - x
        size = np.linalg.norm(edge, axis=1)
        t = edge / np.maximum(size, 1e-300)[:, None] / size.sum()
        found.append(WallRim((c0, c1), (s0, s1), t, size.sum(), shared))
    return found


def _distance(x, y) -> tuple[bool, float]:
    """Sort key for matching loops: True if they go different ways round, then mean distance.

    Both rims of a narrow band are near each other, but the band is on the left of both.
    """
    some = np.unique(np.linspace(0, len(x) - 1, 32).astype(np.intp))
    there = on_loop(x[some], y)
    same_way = is_along(x, y, there.edge, there.s, some)
    return not same_way, float(lengths(there.apart).mean())


def _parametrise(side0: Side, loop0, side1: Side, loop1):
    """Roll two loops to a common start, and give their nodes parameters from 0 to 1.

    Returns:
        The loops; their parameters (one more than nodes: the last closes the loop), equal at
        coincident nodes; and the parameters of these nodes.

    Raises:
        InterfaceError: The loops are apart.
    """
    x0, x1 = side0.x[loop0], side1.x[loop1]
    nearest = on_loop(x1, x0).node
    distance = lengths(x1 - x0[nearest])
    size = np.ptp(x0, axis=0).max()
    shared = distance < COINCIDE * size + NOISE * np.abs(x0).max()
    curved = any(side.surface.curved[side.facets].any() for side in (side0, side1))
    if curved:
        shared |= distance < APPROXIMATED * np.minimum(_shortest(x1), _shortest(x0)[nearest])
    corners = [np.flatnonzero(_corners(x)) for x in (x0, x1)]
    if all(map(len, corners)):  # meshes of one bend have them at different places
        y0, y1 = x0[corners[0]], x1[corners[1]]
        there, back = place_of(y1, y0), place_of(y0, y1)
        reach = REACH_WALLS * np.minimum(
            _shortest(x1)[corners[1]], _shortest(x0)[corners[0]][there]
        )
        apart = _across(y1 - y0[there], side0.vertex_normals[loop0[corners[0]]][there])
        same = (back[there] == np.arange(len(there))) & (lengths(apart) < reach)
        shared[corners[1][same]], nearest[corners[1][same]] = True, corners[0][there[same]]
    first = int(distance.argmin())
    start = int(nearest[first])
    loop0, x0 = np.roll(loop0, -start), np.roll(x0, -start, axis=0)
    loop1, x1, shared, nearest = (
        np.roll(a, -first, axis=0) for a in (loop1, x1, shared, (nearest - start) % len(x0))
    )
    _check_apart(side0, loop0, side1, loop1)
    s0, s1 = _arc(x0), _arc(x1)
    # Anchors: coincident nodes in the same order on both loops
    j = np.flatnonzero(shared[1:]) + 1
    i = nearest[j]
    keep = (i == np.maximum.accumulate(i)) & (i > 0) if len(i) else i.astype(bool)
    anchors0 = np.concatenate(([0.0], s0[i[keep]], [1.0]))
    anchors1 = np.concatenate(([0.0], s1[j[keep]], [1.0]))
    s1 = np.interp(s1, anchors1, anchors0)
    ends = np.unique(anchors0)
    if not shared.any():  # Γ1's first node lies a little off Γ0's
        ends = np.array((-np.inf, np.inf))
        t = x0[1] - x0[0]
        s1 = s1 + np.clip((x1[0] - x0[0]) @ t / (t @ t), -0.5, 0.5) * s0[1]
    elif curved:  # beside short edges surfaces may be further apart
        ends = np.union1d(ends, _joined(s0, s1))
    return loop0, loop1, s0, s1, ends


def _joined(s0, s1) -> npt.NDArray[np.float64]:
    """Replace parameters of Γ1 by Γ0's, in place, if only the surfaces' approximation parts them.

    Returns:
        The new parameters.
    """
    inner, d0, d1 = s1[1:-1], np.diff(s0), np.diff(s1)
    k = np.clip(np.searchsorted((s0[1:] + s0[:-1]) / 2, inner), 1, len(s0) - 2)  # the nearest
    size = np.minimum(np.minimum(d0[k - 1], d0[k]), np.minimum(d1[:-1], d1[1:]))
    near = np.abs(inner - s0[k]) < APPROXIMATED * size
    inner[near] = s0[k[near]]
    return inner[near]


def _corners(x) -> npt.NDArray[np.bool_]:
    """Mask of a closed loop's nodes at which it turns by :data:`.CORNER_OUTLINE` or more."""
    edge = np.roll(x, -1, axis=0) - x
    edge /= np.maximum(lengths(edge), 1e-300)[:, None]
    return np.einsum("ei,ei->e", edge, np.roll(edge, 1, axis=0)) <= np.cos(CORNER_OUTLINE)


def _shortest(x) -> npt.NDArray[np.float64]:
    """The shorter edge at each node of a closed loop."""
    edges = _edges(x)
    return np.minimum(edges, np.roll(edges, 1))


def _edges(x) -> npt.NDArray[np.float64]:
    """Lengths of a closed loop's edges."""
    return np.linalg.norm(np.roll(x, -1, axis=0) - x, axis=1)


def _arc(x) -> npt.NDArray[np.float64]:
    """Arc length along a closed loop, from 0 to 1."""
    s = np.append(0, np.cumsum(_edges(x)))
    return s / s[-1]


def _check_apart(side0: Side, loop0, side1: Side, loop1):
    """Raise an error unless outlines are near each other: they match, or were cut to match."""
    x0, x1 = side0.x[loop0], side1.x[loop1]
    size = max(_edges(x0).max(), _edges(x1).max())
    there = on_loop(x1, x0)
    distance = lengths(_across(there.apart, side0.vertex_normals[loop0[there.edge]]))
    if distance.max() > REACH_WALLS * size:
        worst = distance.argmax()
        raise InterfaceError(
            f"the boundary of Γ1 at {spot(x1[worst])} lies {distance[worst]:.3g} off that "
            "of Γ0: do the surfaces have the same shape there?"
        )


def _across(apart, normals) -> npt.NDArray[np.float64]:
    """Parts of vectors across normals: a gap between outlines is fine, ``(num, 3)``."""
    return apart - np.einsum("pi,pi->p", apart, normals)[:, None] * normals


def along(walls: npt.NDArray[np.integer], x, n0: int, rims: Sequence[WallRim]):
    """Those of the walls between loops that lie along the outlines and don't cut off a corner.

    Vertices have coordinates x; the n0 ones of Γ0 come first.
    """
    edges = walls[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2)
    keep = np.ones(len(edges), dtype=bool)
    for rim in rims:
        s = np.full(len(x), np.nan)
        s[rim.nodes[0]], s[n0 + rim.nodes[1]] = rim.s[0][:-1], rim.s[1][:-1]
        t = np.roll(x[rim.nodes[0]], -1, axis=0) - x[rim.nodes[0]]
        t /= np.maximum(lengths(t), 1e-300)[:, None]
        corners = rim.s[0][:-1][np.einsum("ei,ei->e", t, np.roll(t, 1, axis=0)) < np.cos(CORNER)]
        middle, half = s[edges].mean(axis=1), np.ptp(s[edges], axis=1) / 2
        far = half > 0.25  # the other way round
        middle, half = (np.where(far, 0.5 + y, z) for y, z in ((middle, middle), (-half, half)))
        apart = (corners[:, None] - middle + 0.5) % 1 - 0.5
        keep &= ~(np.abs(apart) < WITHIN * half).any(axis=0)
    return walls[keep.reshape(-1, 3).all(axis=1)]


def in_walls(vertices: npt.NDArray[np.integer], walls: npt.NDArray[np.integer]):
    """Mask of the edges or triangles, ``(num, 2)`` or ``(num, 3)``, that are in walls."""
    return find(walls, vertices) >= 0


def kinds(cells: npt.NDArray[np.integer], walls: npt.NDArray[np.integer]):
    """Bit mask for each cell of its faces and edges that are in walls, ``(num,)``."""
    parts = [cells[:, [i for i in range(4) if i != k]] for k in range(4)]
    parts += [cells[:, edge] for edge in EDGES]
    return sum(in_walls(part, walls).astype(int) << i for i, part in enumerate(parts))


class Outline:
    """The (curved) edges at which a piece ends."""

    def __init__(self, side: Side):
        """Set up all loops of a piece."""
        self.side = side
        self.triangle, self.corner = np.nonzero(side.behind < 0)
        start = side.triangles[self.triangle, self.corner]
        end = side.triangles[self.triangle, (self.corner + 1) % 3]
        self.first = np.full(len(side.x), -1)  # the edge that starts at each vertex
        self.first[start] = np.arange(len(start))
        last = np.full(len(side.x), -1)
        last[end] = np.arange(len(end))
        self.after, self.before = self.first[end], last[start]

    def project(self, points, vertex) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
        """Nearest places on the outline to points, sought from a vertex of the outline for each.

        Returns:
            The piece's triangles and reference coordinates in them, ``(num_points, 2)``.
        """
        start = self.first[vertex]  # at a corner both edges have a nearest place
        both = np.concatenate((start, self.before[start]))
        edge, s = self._walk(both, np.tile(points, (2, 1)))
        triangle, places = self.triangle[edge], self._places(edge, s)
        away = lengths(
            (self.side.points(triangle, places).reshape(2, -1, 3) - points).reshape(-1, 3)
        )
        n = len(points)
        nearer = np.arange(n) + np.where(away[n:] < away[:n], n, 0)
        return triangle[nearer], places[nearer]

    def _walk(self, edge, points) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
        """Edges and parameters on them at which a walk from some edges ends."""
        edge, s = edge.copy(), np.zeros(len(points))
        way = np.zeros(len(points))  # direction in which each came along the outline
        active = np.arange(len(points))
        for _ in range(len(self.triangle)):  # a few: points lie beside their start
            found = self._nearest(edge[active], points[active])
            go = np.sign(np.where(found > 1, 1, np.minimum(found, 0)))
            s[active] = np.clip(found, 0, 1)
            on = (go != 0) & (go != -way[active])  # a walk that would turn round is at a corner
            active, go = active[on], go[on]
            if not len(active):
                break
            way[active] = go
            edge[active] = np.where(go > 0, self.after[edge[active]], self.before[edge[active]])
        return edge, s

    def _places(self, edge, s) -> npt.NDArray[np.float64]:
        start, end = (
            TRIANGLE_CORNERS[self.corner[edge]],
            TRIANGLE_CORNERS[(self.corner[edge] + 1) % 3],
        )
        return start + s[:, None] * (end - start)

    def _nearest(self, edge, points) -> npt.NDArray[np.float64]:
        """Parameters on edges at which these are nearest to points, by Gauss-Newton steps."""
        start = TRIANGLE_CORNERS[self.corner[edge]]
        along = TRIANGLE_CORNERS[(self.corner[edge] + 1) % 3] - start
        geometry = self.side.geometry(self.triangle[edge])
        s = np.full(len(edge), 0.5)
        for _ in range(NEWTON_RIM):
            x, dx = geometry(start + s[:, None] * along)
            tangent = np.einsum("pj,pji->pi", along, dx)
            square = np.maximum(np.einsum("pi,pi->p", tangent, tangent), 1e-300)
            before, s = s, s - np.einsum("pi,pi->p", x - points, tangent) / square
            s = np.clip(s, -1, 2)
            if np.abs(s - before).max() < NOISE:
                break
        return s
