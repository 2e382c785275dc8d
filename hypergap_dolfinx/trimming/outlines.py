# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Outlines of two surfaces in space: differences, crossings, common runs."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.surface.nearest import on_loop
from hypergap_dolfinx.surface.pieces import Side
from hypergap_dolfinx.surface.tolerances import CORNER, FACING_COSINE, FILE_DIGITS
from hypergap_dolfinx.trimming.curved_outlines import Arcs
from hypergap_dolfinx.trimming.tolerances import (
    AWAY,
    CORNER_OUTLINE,
    INSIDE_WEIGHT,
    LEVEL,
    NEARBY,
    NEWTON_OUTLINES,
    SAGS,
)


class Rim:
    """A boundary loop of a piece as a polygon through the nodes of its geometry."""

    def __init__(self, side: Side, loop: npt.NDArray[np.intp]):
        """A piece, and the vertices of a loop around it."""
        self.side = side
        n, degree = len(loop), side.surface.geometry.degree
        ends = np.column_stack((loop, np.roll(loop, -1)))
        curved = np.zeros(n, dtype=bool)
        if degree > 1:
            f, k = np.nonzero(side.behind < 0)
            beside = np.empty(len(side.x), dtype=np.intp)  # the triangle at each edge, by its start
            beside[side.triangles[f, k]] = f
            triangle = beside[loop]
            curved = side.surface.curved[side.facets[triangle]]
        self.num = np.where(curved, degree, 1)  # of this polygon's edges on each of the loop's
        self.base = np.cumsum(self.num) - self.num
        self.edge = np.repeat(np.arange(n), self.num)  # the loop's edge that each is part of
        self.s = (np.arange(self.num.sum()) - self.base[self.edge]) / self.num[self.edge]
        self.ends = ends
        self.x = side.x[ends[self.edge, 0]]
        inner = np.flatnonzero(self.s)
        normals = side.vertex_normals[ends[self.edge]]
        self.normal = (1 - self.s)[:, None] * normals[:, 0] + self.s[:, None] * normals[:, 1]
        if len(inner):
            self._arcs = Arcs.between(side, triangle, ends)
            self.x[inner] = self._arcs[self.edge[inner]].at(self.s[inner])[0]
        self.t = np.roll(self.x, -1, axis=0) - self.x
        self.length = np.linalg.norm(self.t, axis=1)
        unit = self.t / self.length[:, None]
        before = np.roll(unit, 1, axis=0)
        self._turn = np.arctan2(_dot(self.normal, np.cross(before, unit)), _dot(before, unit))
        self._tilts = self._around()

    def curvature(self, corner: float) -> npt.NDArray[np.float64]:
        """Curvature of the polygon within the surface, at its nodes; zero at corners.

        A curve turns at one node after the other, a corner or a ragged outline doesn't. A coarse
        polygon of a closed curve has no corner.

        Args:
            corner: Turn from which a node is a corner; :data:`.CORNER_OUTLINE` if there is one.
        """
        turn, length = self._turn, self.length
        if np.abs(turn).max() >= corner:
            corner = min(corner, CORNER_OUTLINE)
        curvature = 2 * np.abs(turn) / (length + np.roll(length, 1))
        is_corner, going = np.abs(turn) >= corner, np.zeros(len(turn))
        for way in (-1, 1):
            same = np.roll(is_corner, way) | (turn * np.roll(turn, way) > 0)
            going = np.maximum(going, np.where(same, np.roll(curvature, way), 0))
        return np.where(is_corner, 0, np.minimum(curvature, going))

    def foot(self, x, edge, s) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
        """Places on arcs, nearest to points, from those on the polygon: an edge, a parameter."""
        edge, s = edge.copy(), s.copy()
        some = np.flatnonzero((self.num[self.edge[edge]] > 1) & (s > 0) & (s < 1))
        if len(some):
            e = self.edge[edge[some]]
            num, arcs = self.num[e], self._arcs[e]
            t = self.s[edge[some]] + s[some] / num
            for _ in range(NEWTON_OUTLINES):
                y, _, dy, _ = arcs.at(t)
                t = np.clip(t + _dot(x[some] - y, dy) / _dot(dy, dy), 0, 1)
            k = np.minimum(np.floor(num * t), num - 1).astype(np.intp)
            edge[some], s[some] = self.base[e] + k, num * t - k
        return edge, s

    def place(self, place: float) -> tuple[int, int, float]:
        """Vertices of an edge and a parameter on it, from a node's number and the one behind it."""
        k = int(place)
        e = int(self.edge[k])
        a, b = self.ends[e].tolist()
        return a, b, float(self.s[k] + (place - k) / self.num[e])

    def _around(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.intp]]:
        """Normals of triangles at the polygon's nodes, and of those beside them.

        Returns:
            Normals one after the other, and where those of each node start.
        """
        side, loop = self.side, self.ends[:, 0]
        number = np.full(len(side.x), -1)
        number[loop] = np.arange(len(loop))
        f, k = np.nonzero(number[side.triangles] >= 0)
        own = number[side.triangles[f, k]]
        beside = side.behind[f]
        triangles = np.column_stack((f, np.where(beside < 0, f[:, None], beside)))
        order = np.argsort(own, kind="stable")
        starts = np.searchsorted(own[order], np.arange(len(loop)))
        normals = side.normals[triangles[order]].reshape(-1, 3)
        return normals, 4 * starts

    def tilt(self, nodes, across) -> npt.NDArray[np.float64]:
        """Largest angles by which the surface beside nodes is inclined in some directions."""
        normals, starts = self._tilts
        edge = self.edge[nodes]
        count = np.diff(np.append(starts, len(normals)))[edge]
        first = np.cumsum(count) - count
        each = np.repeat(np.arange(len(edge)), count)
        at = np.arange(len(each)) - first[each] + starts[edge][each]
        sine = np.abs(_dot(normals[at], across[each]))
        return np.arcsin(np.minimum(np.maximum.reduceat(sine, first), 1))

    def off(self, other: "Rim", corner: float = CORNER_OUTLINE):
        """Distances of its nodes from another outline, less the uncertainty of both meshes.

        Of two polygons with their nodes on one curve of curvature κ, a node of one lies outside a
        chord of the other of length L, by κ L² s (1 − s) / 2 at its parameter s; inside only if
        the curve doesn't bend evenly there, or by a small part of L. Across a gap they also differ
        by the uncertainty of the normals.

        Args:
            other: The other one.
            corner: Turn from which nodes are corners.

        Returns:
            The nearest edge, the parameter on it, from 0 to 1, and the distance; the nearest node
            and its distance; all ``(num_nodes,)``, distances in lengths of edges.
        """
        there = on_loop(self.x, other.x)
        edge, s = there.edge, there.s[:, None]
        after = (edge + 1) % len(other.x)
        t = other.t[edge] / other.length[edge, None]
        n = self.normal - (1 - s) * other.normal[edge] - s * other.normal[after]
        n -= _dot(n, t)[:, None] * t
        n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)
        height, distance = _along(there.apart, n)
        m = np.cross(t, n)
        tilt = self.tilt(np.arange(len(self.x)), m)
        tilt += np.maximum(other.tilt(edge, m), other.tilt(after, m))
        own, there_by = self.curvature(corner), other.curvature(corner)
        beside = np.stack([np.roll(own, k) for k in (-1, 0, 1)])
        curvature = np.maximum(there_by[edge], there_by[after])  # of an edge: not beyond corners
        curvature = np.minimum(beside.max(axis=0), curvature)
        ways = np.sign(other._turn)
        inwards = (
            _dot(there.apart, m) * (ways[edge] + ways[after]) > FILE_DIGITS * other.length[edge]
        )
        bends = np.abs(ways[edge] * there_by[edge] - ways[after] * there_by[after])
        even = np.where(inwards, np.minimum(curvature, bends), curvature)
        sag, arc = SAGS / 8 * curvature, SAGS / 2 * even * there.s * (1 - there.s)
        size = other.length[edge]
        explained = np.maximum(arc * size**2, np.minimum(sag * size**2, NEARBY * size))
        explained += height * np.tan(np.minimum(tilt, CORNER))
        explained = np.minimum(explained, AWAY * other.length[edge])
        length = np.maximum(self.length, other.length[edge])
        to_node = _along(self.x - other.x[there.node], n)[1]
        off = (distance - explained) / length
        return *other.foot(self.x, edge, there.s), off, there.node, (to_node - explained) / length


def is_along(x, y, edge, s, some=slice(None)) -> bool:
    """True if two loops of nodes x and y, ``(num_nodes, 3)``, run in the same direction.

    Args:
        x: The first one.
        y: The second one.
        edge: Edge of the second one that is nearest to nodes of the first one.
        s: Parameter on it, from 0 to 1.
        some: These nodes of the first one.
    """
    # Chords of two edges: at a node the nearest edge may be the one before or the one behind it
    ways = [np.roll(z, -1, axis=0) - np.roll(z, 1, axis=0) for z in (x, y)]
    other = (1 - s)[:, None] * ways[1][edge] + s[:, None] * ways[1][(edge + 1) % len(y)]
    return bool(np.einsum("ni,ni->", ways[0][some], other) > 0)


def _along(apart, normal):
    """Lengths of vectors' parts along normals and across them."""
    height = np.einsum("pi,pi->p", apart, normal)
    return np.abs(height), np.linalg.norm(apart - height[:, None] * normal, axis=1)


class Shared:
    """Places where two outlines coincide within the meshes' uncertainty, and runs between them."""

    def __init__(self, rims: tuple[list[Rim], ...], tolerance: float, paired: float, corner: float):
        """Outlines of facing pieces.

        Args:
            rims: Their loops.
            tolerance: Distance treated as zero, in lengths of edges.
            paired: The same of nodes in pairs.
            corner: Turn from which nodes are corners.
        """
        self.sizes = [np.array([len(rim.x) for rim in own], dtype=np.intp) for own in rims]
        self.starts = [np.cumsum(sizes) - sizes for sizes in self.sizes]
        found = [self._nearest(rims[i], rims[1 - i], self.starts[1 - i], corner) for i in (0, 1)]
        (at0, off0, node0, away0), (at1, off1, node1, away1) = found
        limit = max(tolerance, paired)
        pairs = np.flatnonzero(away0 <= limit)
        pairs = pairs[(node1[node0[pairs]] == pairs) & (away1[node0[pairs]] <= limit)]
        alone = [np.ones(len(off), dtype=bool) for off in (off0, off1)]
        alone[0][pairs] = alone[1][node0[pairs]] = False
        # Nodes within curved edges have none to be paired with where the other side is straight
        inner = [np.concatenate([rim.s > 0 for rim in own] or [()]).astype(bool) for own in rims]
        one, other = (
            np.flatnonzero(a & (off <= np.where(within, limit, tolerance)))
            for a, off, within in zip(alone, (off0, off1), inner, strict=True)
        )
        self.at = (
            np.concatenate((pairs, one, at1[other])).astype(float),
            np.concatenate((node0[pairs], at0[one], other)).astype(float),
        )
        """Places on both outlines: a node's number, and the parameter on the edge behind it."""
        self._find_runs()

    @staticmethod
    def _nearest(rims: list[Rim], others: list[Rim], starts, corner: float):
        """Nearest place and its distance, nearest node and its distance, of all nodes."""
        num = sum(len(rim.x) for rim in rims)
        at, node = np.zeros(num), np.zeros(num, dtype=np.intp)
        off, away = np.full((2, num), np.inf)
        start = 0
        for rim in rims:
            own = slice(start, start := start + len(rim.x))
            for other, first in zip(others, starts, strict=True):
                edge, s, distance, nearest, to_node = rim.off(other, corner)
                place = first + np.where(s < 1, edge + s, (edge + 1) % len(other.x))
                better = distance < off[own]
                at[own][better], off[own][better] = place[better], distance[better]
                better = to_node < away[own]
                node[own][better], away[own][better] = first + nearest[better], to_node[better]
        return at, off, node, away

    def _find_runs(self):
        """Find places from which both outlines run to the next one without a node between."""
        num = len(self.at[0])
        after, straight = np.empty((2, 2, num), dtype=np.intp)
        self._order = []
        for i, own in enumerate(self.at):
            order = np.lexsort((-self.at[1 - i], own))
            loop = np.searchsorted(self.starts[i], own, side="right") - 1
            first = np.searchsorted(loop[order], np.arange(len(self.starts[i]) + 1))
            for low, high in pairwise(first):
                after[i, order[low:high]] = np.roll(order[low:high], -1)
            step = (own[after[i]] - own) % self.sizes[i][loop]
            straight[i] = own + step <= np.floor(own) + 1
            straight[i] &= (step > 0) | (after[i] != np.arange(num))
            self._order.append((order, own[order], loop[order]))
        run = after[1, after[0]] == np.arange(num)
        self.runs = run & straight[0].astype(bool) & straight[1, after[0]].astype(bool)
        self.ended = np.zeros(num, dtype=bool)
        self.ended[after[0, self.runs]] = True

    @property
    def ends(self) -> npt.NDArray[np.intp]:
        """Places where a run ends, or none is."""
        return np.flatnonzero(~(self.runs & self.ended))

    def whole(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Masks of the loops that are runs all around."""
        found = []
        for i, (order, _, loop) in enumerate(self._order):
            run = (self.runs, self.ended)[i][order]
            num, runs = (
                np.bincount(loop[some], minlength=len(self.sizes[i])) for some in (..., run)
            )
            found.append((num == runs) & (num > 0))
        return found[0], found[1]

    def is_run(self, i: int, places) -> npt.NDArray[np.bool_]:
        """Mask of places on outline i that are in a run."""
        places = np.asarray(places, dtype=float)
        order, own, loops = self._order[i]
        loop = np.searchsorted(self.starts[i], places, side="right") - 1
        first, last = (np.searchsorted(loops, loop, side=side) for side in ("left", "right"))
        k = np.searchsorted(own, places, side="right") - 1
        k = np.where(k < first, last - 1, k)
        run = (self.runs, self.ended)[i]
        return (last > first) & run[order[k]] if len(order) else np.zeros(len(places), dtype=bool)


@dataclass(frozen=True)
class Edges:
    """Straight edges of an outline."""

    a: npt.NDArray[np.float64]
    """Starting points, ``(num_edges, 3)``."""
    b: npt.NDArray[np.float64]
    """End points."""
    normal: npt.NDArray[np.float64]
    """Normals of the surface, ``(num_edges, 3)``."""


@dataclass(frozen=True)
class Meetings:
    """Nodes of one outline on edges of the other, and crossings of edges."""

    edge: npt.NDArray[np.intp]
    """Edge of the first outline, ``(num,)``."""
    s: npt.NDArray[np.float64]
    """Parameter on it, from 0 to 1."""
    other: npt.NDArray[np.intp]
    """Edge of the second outline."""
    r: npt.NDArray[np.float64]
    """Parameter on it."""


def meetings(edges: Edges, others: Edges, snap: float) -> Meetings:
    """All places where two outlines with opposite normals meet, along the first one's normals.

    Distances up to ``snap`` are treated as zero.
    """
    found = []
    length = np.linalg.norm(edges.b - edges.a, axis=1)
    others_length = np.linalg.norm(others.b - others.a, axis=1)
    middle, others_middle = (edges.a + edges.b) / 2, (others.a + others.b) / 2
    chunk = max(1, 1_000_000 // max(len(others.a), 1))  # pairs at a time, to bound memory
    for c in range(0, len(length), chunk):
        part = slice(c, c + chunk)
        apart = others_middle - middle[part, None]
        height = np.einsum("eoi,ei->eo", apart, edges.normal[part])
        square = np.einsum("eoi,eoi->eo", apart, apart) - height**2
        reach = 0.6 * (length[part, None] + others_length)
        facing = edges.normal[part] @ others.normal.T < FACING_COSINE
        e, o = np.nonzero((square < (reach + snap) ** 2) & facing)
        found.append(_meetings(edges, others, e + c, o, snap))
    e, s, o, r = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return Meetings(e, s, o, r)


def _meetings(edges: Edges, others: Edges, e, o, snap: float) -> tuple[npt.NDArray, ...]:
    """The meetings of some pairs of edges."""
    t = edges.b[e] - edges.a[e]
    length = np.linalg.norm(t, axis=1)
    t /= length[:, None]
    m = np.cross(edges.normal[e], t)
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    # In the plane of the edge: along it, and to its left
    p, q = (
        np.column_stack([_dot(y[o] - edges.a[e], v) for v in (t, m)]) for y in (others.a, others.b)
    )
    d = q - p
    size = np.maximum(np.linalg.norm(d, axis=1), 1e-300)

    def on_edge(y):
        return (np.abs(y[:, 1]) <= snap) & (y[:, 0] >= -snap) & (y[:, 0] <= length + snap)

    def on_other(y0):
        """Parameter of the point (y0, 0) on the other edge, and True if it lies on it."""
        along = ((y0 - p[:, 0]) * d[:, 0] - p[:, 1] * d[:, 1]) / size
        across = np.abs(-p[:, 1] * d[:, 0] - (y0 - p[:, 0]) * d[:, 1]) / size
        return along, (across <= snap) & (along >= -snap) & (along <= size + snap)

    p_on, q_on = on_edge(p), on_edge(q)
    (a_at, a_on), (b_at, b_on) = on_other(0 * length), on_other(length)
    parts = []
    for on, y, r in ((p_on, p, 0.0), (q_on, q, 1.0)):
        parts.append((on, np.clip(y[:, 0] / length, 0, 1), np.full(len(e), r)))
    for on, at, s in ((a_on, a_at, 0.0), (b_on, b_at, 1.0)):
        parts.append((on, np.full(len(e), s), np.clip(at / size, 0, 1)))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = p[:, 1] / (p[:, 1] - q[:, 1])
        where = (p[:, 0] + share * d[:, 0]) / length
        cross = (p[:, 1] * q[:, 1] < 0) & (where > 0) & (where < 1)
    parts.append((cross & ~(p_on | q_on | a_on | b_on), where, share))
    return tuple(
        np.concatenate(arrays)
        for arrays in zip(*((e[on], s[on], o[on], r[on]) for on, s, r in parts), strict=True)
    )


def _dot(a, b) -> npt.NDArray[np.float64]:
    return np.einsum("pi,pi->p", a, b)


def locate(side: Side, points, normals) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
    """The triangles of a piece that points lie above or below, along the piece's normals.

    Points have normals of their own surface, which faces the piece, ``(num_points, 3)``.

    Returns:
        The nearest such triangle, or −1, and the weights of its vertices,
        ``(num_points,)`` and ``(num_points, 3)``.
    """
    host, weights = np.full(len(points), -1), np.zeros((len(points), 3))
    p, f = side.tree.candidates(points, normals)
    at, t = _feet(side, f, points[p])
    curved = not side.is_affine
    least = at.min(axis=1, initial=np.inf)
    near = (curved & np.isfinite(least)) | (
        least >= -INSIDE_WEIGHT
    )  # a curved triangle may contain points beside it
    p, f, at, t, least = p[near], f[near], at[near], np.abs(t[near]), least[near]
    order = np.lexsort((t, np.maximum(-INSIDE_WEIGHT - least, 0), p))
    first = order[np.unique(p[order], return_index=True)[1]]
    p, f, at = p[first], f[first], at[first]
    if curved and len(p):
        f, xi = side.project(points[p], f)
        at = np.column_stack((1 - xi.sum(axis=1), xi))
        inside = at.min(axis=1, initial=np.inf) >= -INSIDE_WEIGHT
        p, f, at = p[inside], f[inside], np.maximum(at[inside], 0)
        at /= at.sum(axis=1)[:, None]
    host[p], weights[p] = f, at
    return host, weights


def _feet(side: Side, triangle, points):
    """Weights of the vertices and height of points along interpolated vertex normals."""
    x, n = side.x[side.triangles[triangle]], side.vertex_normals[side.triangles[triangle]]
    height = np.zeros(len(points))
    for _ in range(NEWTON_OUTLINES):
        y = x + height[:, None, None] * n
        e, f, d = y[:, 1] - y[:, 0], y[:, 2] - y[:, 0], points - y[:, 0]
        N = np.cross(e, f)
        square = np.maximum(_dot(N, N), 1e-300)
        a, b = _dot(np.cross(d, f), N) / square, _dot(np.cross(e, d), N) / square
        lifts = _dot(np.einsum("pk,pki->pi", np.column_stack((1 - a - b, a, b)), n), N)
        height = height + _dot(d, N) / np.maximum(lifts, LEVEL * np.sqrt(square))
    return np.column_stack((1 - a - b, a, b)), height
