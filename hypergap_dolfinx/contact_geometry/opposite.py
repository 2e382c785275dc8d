# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pieces of Γ1's facets in space, each opposite one facet of Γ0.

Facets of Γ0 are projected along the normal of each facet of Γ1. The facet of Γ1 is divided into as
many parts as it has vertices, by lines from its middle to its edges' middles. The intersection of a
part and a facet of Γ0 is a piece, a polygon in the plane across the normal. Nodes of Γ0 that pass
change the division of a part into pieces, never its size.

Pieces are first found with straight edges. Edges of curved facets, however, move with the nodes in
their middles too, and derivatives have to be those of the true domain. So the area between a curved
edge and a straight one is taken from the piece on one side and given to the piece on the other
side. Together pieces fill the same part as before.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache, cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.contact_geometry.tolerances import (
    LAST,
    NEWTON,
    PARALLEL_CURVES,
    ROUND_OFF_FACET,
    SLACK,
)
from hypergap_dolfinx.core.compiled import call, doubles, ints, library, struct, structs
from hypergap_dolfinx.surface.search import along_curve
from hypergap_dolfinx.surface.trace import Surface, around, lengths, tabulate


class Label(IntEnum):
    """Label of a piece's edge that isn't on one of Γ0's facet."""

    INNER = -1


@dataclass(frozen=True)
class Frames:
    """Γ0 and Γ1 where they are, and planes across the normals of Γ1's facets in their middles."""

    surfaces: tuple[Surface, Surface]
    middle: npt.NDArray[np.float64]
    """``(num_facets, 3)``."""
    tangents: npt.NDArray[np.float64]
    """``(num_facets, 2, 3)``."""
    normal: npt.NDArray[np.float64]
    """Cross product of the tangents, ``(num_facets, 3)``."""
    dual: npt.NDArray[np.float64]
    """Basis dual to the tangents in the plane, ``(num_facets, 2, 3)``."""
    slopes: npt.NDArray[np.float64]
    """Slopes of the functions of Γ1's dofs in the facets' middle, ``(2, num_dofs1)``."""

    @classmethod
    def of(cls, surfaces: tuple[Surface, Surface]) -> "Frames":
        """Frames of all facets of Γ1."""
        above = surfaces[1]
        middle = reference_corners(above.geometry.cell_type).mean(axis=0)[None]
        values = above.geometry.tabulate(1, middle)[:, 0, :, 0]  # (value and slopes, node)
        at = np.einsum("dm,fmi->fdi", values, above.nodes)
        a, b = at[:, 1], at[:, 2]
        normal = cross(a, b)
        square = np.maximum(np.einsum("fi,fi->f", normal, normal), 1e-300)[:, None]
        dual = np.stack((cross(b, normal) / square, cross(normal, a) / square), axis=1)
        slopes = above.element.tabulate(1, middle)[1:, 0, :, 0]
        return cls(surfaces, at[:, 0], at[:, 1:], normal, dual, slopes)

    def project(self, facet, x) -> npt.NDArray[np.float64]:
        """Coordinates of points in facets' planes, ``(num, ..., 2)``."""
        origin = self.middle[facet]
        shape = (len(facet), *[1] * (x.ndim - 2), 3)
        return np.einsum("fki,f...i->f...k", self.dual[facet], x - origin.reshape(shape))

    @cached_property
    def planes(self) -> npt.NDArray[np.float64]:
        """Origins, dual bases and unit normals, ``(num_facets, 4, 3)``."""
        axes = self.normal / lengths(self.normal)[:, None]
        return np.concatenate((self.middle[:, None], self.dual, axes[:, None]), axis=1)

    @cached_property
    def in_c(self) -> Any:
        """Γ0 and Γ1 for the C code; valid as long as both live."""
        return structs("Facets", [surface.polynomials for surface in self.surfaces])


def cross(a, b) -> npt.NDArray[np.float64]:
    """Cross products of vectors, ``(num, 3)``: NumPy's own is slow for short ones."""
    result = np.empty_like(a)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return result


@cache
def reference_corners(cell_type: basix.CellType) -> npt.NDArray[np.float64]:
    """Vertices of a reference facet, one after the other around it, ``(num_corners, 2)``."""
    corners = basix.geometry(cell_type)
    return corners[around(np.arange(len(corners))[None])[0]]


@dataclass(frozen=True)
class FacetPieces:
    """Parts of Γ1 opposite Γ0, facet by facet and vertex by vertex."""

    facets: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]
    """Facets of Γ0 and of Γ1, ``(num_pieces,)`` each."""
    part: npt.NDArray[np.intp]
    """Part of Γ1's facet that it is in, ``(num_pieces,)``."""
    X: npt.NDArray[np.float64]
    """Corners in the reference facet of Γ1, counterclockwise, ``(num_pieces, num, 2)``; behind the
    last one they repeat it."""
    num: npt.NDArray[np.intp]
    """Numbers of corners, ``(num_pieces,)``."""
    label: npt.NDArray[np.intp]
    """Number of Γ0's facet's edge from each corner to the next, or :data:`Label.INNER`."""
    bend: npt.NDArray[np.float64] | None = None
    """Distance of these edges from straight ones at the start, in the middle and at the end,
    ``(num_pieces, num, 3, 2)``; None where all are straight."""

    def some(self, some) -> "FacetPieces":
        """Subset, by numbers or a mask."""
        facets = self.facets[0][some], self.facets[1][some]
        part, X, num, label = (of[some] for of in (self.part, self.X, self.num, self.label))
        bend = None if self.bend is None else self.bend[some]
        return FacetPieces(facets, part, X, num, label, bend)

    def _edges(self, piece, k) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Ends of straight edges, ``(num, 2, 2)``, and distances from these, ``(num, 3, 2)``."""
        ends = np.stack((self.X[piece, k], self.X[piece, (k + 1) % self.num[piece]]), axis=1)
        bend = np.zeros((len(ends), 3, 2)) if self.bend is None else self.bend[piece, k]
        return ends, bend

    def along(self, piece, k, t) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Points of edges, and derivatives by t.

        Args:
            piece: ``(num,)``.
            k: The edges' first corners, ``(num,)``.
            t: From 0 to 1, ``(num_points,)``.

        Returns:
            On the reference facet, ``(num, num_points, 2)`` each.
        """
        return _parabolas(*self._edges(piece, k), t)

    def bulges(self, num: int) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """Points and weights for the area between curved edges and straight ones.

        Args:
            num: Number of points.

        Returns:
            Piece of each curved edge, ``(num_edges,)``, ``(num_edges, num, 2)`` and
            ``(num_edges, num)``: positive right of edges.
        """
        if self.bend is None:
            return np.empty(0, dtype=np.intp), np.empty((0, num, 2)), np.empty((0, num))
        piece, k = self.bend.any(axis=(2, 3)).nonzero()
        ends, bend = self._edges(piece, k)
        t, weights = basix.make_quadrature(basix.CellType.interval, 2 * num - 1)
        points, slopes = _parabolas(ends, 0.5 * bend, t[:, 0])  # half way between both
        away = 2 * (points - _parabolas(ends, 0 * bend, t[:, 0])[0])
        return piece, points, weights * _cross2(away, slopes)

    def bent(self, piece, k, X) -> "FacetPieces":
        """The same pieces with curved edges.

        Args:
            piece: ``(num,)``.
            k: Their first corners', ``(num,)``.
            X: Start, middle and end of each edge, ``(num, 3, 2)``.
        """
        start, end = self._edges(piece, k)[0].swapaxes(0, 1)
        straight = np.stack((start, 0.5 * (start + end), end), axis=1)
        away = X - straight
        bends = np.abs(away).max(axis=(1, 2), initial=0) > ROUND_OFF_FACET
        if not bends.any():
            return self
        bend = np.zeros((*self.X.shape[:2], 3, 2))
        bend[piece[bends], k[bends]] = away[bends]
        return replace(self, bend=bend)

    @property
    def area(self) -> npt.NDArray[np.float64]:
        """Areas in the reference facet, ``(num_pieces,)``."""
        return polygon_areas(self.X)


def polygon_areas(y) -> npt.NDArray[np.float64]:
    """Areas of polygons, ``(num, num_corners, 2)``, whose corners may repeat."""
    steps = y - y[:, :1]
    a, b = steps[:, 1:-1], steps[:, 2:]
    return 0.5 * (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=1)


@cache
def parts_of(cell_type: basix.CellType) -> npt.NDArray[np.float64]:
    """Parts of a reference facet, one for each vertex, from there counterclockwise.

    Returns:
        ``(num_corners, 4, 2)``.
    """
    own = reference_corners(cell_type)
    middles = (own + np.roll(own, -1, axis=0)) / 2
    centre = np.broadcast_to(own.mean(axis=0), own.shape)
    return np.stack((own, middles, centre, np.roll(middles, 1, axis=0)), axis=1)


@dataclass(frozen=True)
class OwnPairs:
    """Facets of one surface that meet each other, found where it is undeformed.

    Each pair counts once: facets of Γ1 meet those that come before them, but for their neighbours.
    The surface is divided into halves, one before the other, such that what is opposite to each
    other is in different ones; within them the order is that of steps from an end.
    """

    turn: npt.NDArray[np.int32]
    """Place of each facet in the order, ``(num_facets,)``."""
    first: npt.NDArray[np.int32]
    """First neighbour of each facet, ``(num_facets + 1,)``."""
    near: npt.NDArray[np.int32]
    """Those that share a vertex, and those that share one with these, and itself, sorted."""
    walls: npt.NDArray[np.float64]
    """Overlap beyond which what lies opposite a facet is the other side of its own body: half of
    the wall there, ``(num_facets,)``."""

    @classmethod
    def of(cls, surface: Surface) -> "OwnPairs":
        """Those of a surface."""
        from scipy import sparse  # here, as importing it takes longer than all else

        facets, num = surface.facets, len(surface.facets)
        rows = np.repeat(np.arange(num), facets.shape[1])
        has = sparse.csr_array((np.ones(facets.size), (rows, facets.ravel())))
        shared = (has @ has.T).tocsr()
        near = (shared @ shared).tocsr()
        near.sort_indices()
        first, near = ints(near.indptr), ints(near.indices)
        own = cls(np.zeros(num, np.int32), first, near, np.full(num, np.inf))
        pieces = find_pieces(Frames.of((surface, surface)))
        f0, f1 = pieces.facets
        corner = np.arange(pieces.X.shape[1]) < pieces.num[:, None]
        X = (pieces.X * corner[..., None]).sum(axis=1) / pieces.num[:, None]
        x, n0, n1 = surface.points(f1, X), surface.normals[f0], surface.normals[f1]
        apart = surface.x[facets[f0]].mean(axis=1) - x
        height = np.einsum("pi,pi->p", apart, n0) / np.einsum("pi,pi->p", n1, n0)
        behind = height < -SLACK * surface.size[f1]
        near = own._are_near(f0, f1)
        wall = behind & ~near
        np.minimum.at(own.walls, f1[wall], -height[wall] / 2)
        # The facet that is next in front of each
        front = np.flatnonzero(~behind & ~near)
        front = front[np.lexsort((height[front], f1[front]))]
        front = front[np.unique(f1[front], return_index=True)[1]]
        ends = np.concatenate((f0[front], f1[front])), np.concatenate((f1[front], f0[front]))
        opposite = sparse.csr_array((np.ones(len(ends[0])), ends), shape=(num, num))
        return replace(own, turn=_turns(surface, (shared > 1).astype(float), opposite))

    @cached_property
    def _keys(self) -> npt.NDArray[np.intp]:
        """Numbers of all pairs of neighbours, sorted."""
        num = len(self.turn)
        return np.repeat(np.arange(num), np.diff(self.first)) * num + self.near

    def _are_near(self, f0, f1) -> npt.NDArray[np.bool_]:
        """Mask of pairs that are neighbours, ``(num_pairs,)``."""
        keys = f1 * len(self.turn) + f0
        at = np.searchsorted(self._keys, keys)
        return self._keys[np.minimum(at, len(self._keys) - 1)] == keys

    def meet(self, f0, f1) -> npt.NDArray[np.bool_]:
        """Mask of pairs of facets of Γ0 and Γ1 that can meet, ``(num_pairs,)``."""
        return (self.turn[f0] < self.turn[f1]) & ~self._are_near(f0, f1)

    @cached_property
    def in_c(self) -> Any:
        """The same for C; it lives as long as they do."""
        fields = {"turn": self.turn, "first": self.first, "near": self.near, "walls": self.walls}
        return struct("Own", **fields)


def _turns(surface: Surface, beside, opposite) -> npt.NDArray[np.int32]:
    """The order in which a surface meets itself; it doesn't depend on the facets' numbers.

    Args:
        surface: The surface.
        beside: Facets that share an edge, sparse, ``(num_facets, num_facets)``.
        opposite: Facets that are opposite to each other, likewise.

    Returns:
        ``(num_facets,)``.
    """
    along = surface.x[surface.facets].mean(axis=1) @ (1.0, np.sqrt(2) / 3, np.sqrt(3) / 7)
    far = np.lexsort((along, -_steps(beside, np.argsort(along, kind="stable"))))
    step = _steps(beside, far)
    half = _halves(beside, opposite, far[np.argsort(step[far], kind="stable")])
    turn = np.empty(len(along), dtype=np.int32)
    turn[np.lexsort((along, step, half))] = np.arange(len(along))
    return turn


def _steps(beside, starts) -> npt.NDArray[np.intp]:
    """Steps from facet to facet, ``(num_facets,)``, part by part from the first of ``starts``."""
    found, count = np.full(len(starts), -1), 0
    for start in starts:
        front = np.arange(len(starts)) == start if found[start] < 0 else np.zeros(0, dtype=bool)
        while front.any():
            found[front], count = count, count + 1
            front = (beside @ front > 0) & (found < 0)
    return found


def _halves(beside, opposite, starts) -> npt.NDArray[np.intp]:
    """Halves of a surface, 0 or 1, that grow from the first of ``starts``, ``(num_facets,)``."""
    found = np.full(len(starts), -1)
    for start in starts:
        first = np.arange(len(starts)) == start if found[start] < 0 else np.zeros(0, dtype=bool)
        second = np.zeros_like(first)
        while first.any() or second.any():
            found[second], found[first] = 1, 0
            reached = beside @ first + opposite @ second, beside @ second + opposite @ first
            first, second = ((front > 0) & (found < 0) for front in reached)
    return found


def find_pieces(frames: Frames, own: OwnPairs | None = None) -> FacetPieces:
    """Find all pieces; of one surface those of facets that meet."""
    below, above = frames.surfaces
    parts = parts_of(above.geometry.cell_type)
    f0, f1, part, count, edge, y, X = _cut(frames, parts)
    # Edge k of the corners as seen from the other side is edge num − 2 − k of the facet
    sides, num = below.facets.shape[1], parts.shape[1]
    label = np.where(edge < num, Label.INNER, (sides - 2 - edge + num) % sides)
    pieces = FacetPieces((f0, f1), part, X, count, label)
    if max(surface.geometry.degree for surface in frames.surfaces) > 1:
        pieces = _bent(frames, pieces, parts, part, y, edge)
    return pieces.some(own.meet(*pieces.facets)) if own else pieces


def _cut(frames: Frames, parts):
    """Cut parts of Γ1's facets with Γ0's, in C.

    Args:
        frames: Γ0 and Γ1.
        parts: Parts of Γ1's reference facet, ``(num_parts, 4, 2)``.

    Returns:
        Both facets and the part of each piece, ``(num_pieces,)``; the number of corners, likewise;
        the number of the edge on which each edge is, those of Γ0's facet behind the part's,
        ``(num_pieces, num_corners)``; corners in the plane and on the reference facet.
    """
    below, above = frames.surfaces
    sides = frames.in_c
    reach = np.linalg.norm(above.nodes - frames.middle[:, None], axis=2).max(axis=1)
    order = ints(along_curve(below.x[below.facets].mean(axis=1)))
    given = sides, order, *map(doubles, (below.normals, frames.planes, reach, parts))
    room = 6 * (len(below.facets) + len(above.facets))  # of equal grids' parts up to 5
    while True:
        numbers = np.empty((4, room), dtype=np.int32)
        edge = np.empty((room, library("space").lib.MOST_CORNERS), dtype=np.int32)
        points = np.empty((2, *edge.shape, 2))
        of0, of1, part, count = numbers
        fields = {"facets": [of0, of1], "part": part, "count": count, "edge": edge}
        pieces = struct("Pieces", max=room, **fields, y=points[0], X=points[1])
        if call("find_pieces", *given, 0.0, ROUND_OFF_FACET, LAST, pieces):
            raise MemoryError("no memory for the pieces of the gap domain")
        if pieces.num <= room:
            break
        room = pieces.num
    num, corners = pieces.num, int(numbers[3, : pieces.num].max(initial=1))
    y, X = points[:, :num, :corners]
    return *numbers[:, :num].astype(np.intp), edge[:num, :corners].astype(np.intp), y, X


def _bent(frames: Frames, pieces: FacetPieces, parts, part, y, edge) -> FacetPieces:
    """Make the edges curved that lie on Γ0's.

    Args:
        frames: Γ0 and Γ1.
        pieces: Pieces with straight edges.
        parts: Parts of Γ1's reference facet, ``(num_parts, 4, 2)``.
        part: Number of the part of each piece, ``(num_pieces,)``.
        y: Corners in the facets' planes, as the pieces' ``X``.
        edge: Number of the edge on which each edge is, the part's first, as ``label``.
    """
    below, above = frames.surfaces
    degree = max(surface.geometry.degree for surface in frames.surfaces)
    (f0, f1), num = pieces.facets, parts.shape[1]
    piece, k = np.nonzero((edge >= num) & (np.arange(y.shape[1]) < pieces.num[:, None]))
    # Where one piece takes what another one leaves, or no other is there
    at = f0[piece], pieces.label[piece, k]
    key = (below.edge_numbers[at] * len(above.facets) + f1[piece]) * len(parts) + part[piece]
    _, where, pair = np.unique(key, return_inverse=True, return_counts=True)
    some = (pair[where] == 2) | below.is_outline[at]
    piece, k = piece[some], k[some]
    if not len(piece):
        return pieces
    own = _seen(frames, _edge_points(parts, degree))[f1, part]
    corners = reference_corners(below.geometry.cell_type)[::-1]  # seen from the other side
    ring = _edge_points(corners, degree)
    x = (tabulate(below.geometry, ring.reshape(-1, 2)) @ below.nodes)[f0]
    nodes = np.concatenate((own, frames.project(f1, x).reshape(len(x), *ring.shape)), axis=1)
    y = _bent_edges(y, pieces.num, edge, nodes, num, (piece, k))
    return pieces.bent(piece, k, _in_curved(frames, f1[piece], y))


def _seen(frames: Frames, X) -> npt.NDArray[np.float64]:
    """Reference points, ``(..., 2)``, of Γ1's facets in their planes, ``(num_facets, ..., 2)``."""
    surface = frames.surfaces[1]
    x = tabulate(surface.geometry, X.reshape(-1, 2)) @ surface.nodes
    return frames.project(np.arange(len(x)), x).reshape(len(x), *X.shape)


def _in_curved(frames: Frames, facet, y) -> npt.NDArray[np.float64]:
    """Reference coordinates of points of curved facets.

    Args:
        frames: Γ0 and Γ1.
        facet: Facets of Γ1, ``(num,)``.
        y: Points in the facets' planes, ``(num, num_points, 2)``.
    """
    surface = frames.surfaces[1]
    nodes = frames.project(np.arange(len(surface.nodes)), surface.nodes)[facet]
    X = reference_corners(surface.geometry.cell_type).mean(axis=0) + y
    for _ in range(NEWTON):
        table = surface.geometry.tabulate(1, X.reshape(-1, 2))[..., 0]  # (value or slope, ...)
        at, p, q = table.reshape(3, *y.shape[:2], -1) @ nodes
        rest, det = y - at, _cross2(p, q)
        step = np.stack((_cross2(rest, q) / det, _cross2(p, rest) / det), axis=-1)
        X += np.clip(step, -0.5, 0.5)
        if np.abs(step).max(initial=0) < LAST:
            break
    return X


@cache
def _to_powers(degree: int) -> npt.NDArray[np.float64]:
    """Coefficients of powers of t of curves with equally spaced nodes, ``(power, node)``."""
    return np.linalg.inv(np.vander(np.linspace(0, 1, degree + 1), increasing=True))


def _edge_points(corners, degree: int) -> npt.NDArray[np.float64]:
    """Points that divide polygons' edges equally.

    Args:
        corners: ``(..., num_corners, 2)``.
        degree: Number of parts.

    Returns:
        Each edge's with its ends, ``(..., num_corners, degree + 1, 2)``.
    """
    share = np.linspace(0, 1, degree + 1)[:, None]
    start, end = corners[..., None, :], np.roll(corners, -1, axis=-2)[..., None, :]
    return start + share * (end - start)


def _bent_edges(y, num, edge, nodes, sides: int, which) -> npt.NDArray[np.float64]:
    """Curved edges of intersections of two polygons, those that are edges of the second.

    Args:
        y: Corners with straight edges, ``(num_polygons, num_corners, 2)``.
        num: Numbers of corners, ``(num_polygons,)``.
        edge: Number of the edge from each corner to the next, ``(num_polygons, num_corners)``.
        nodes: Nodes of the edges of both, ``(num_polygons, num_edges, degree + 1, 2)``.
        sides: Number of edges of the first one.
        which: Polygons and first corners of the requested edges, ``(num,)`` each.

    Returns:
        Start, middle and end of each, ``(num, 3, 2)``. They end where edges of the first polygon
        cross them.
    """
    (polygon, k), others = which, nodes.shape[1] - sides
    to_powers, own = _to_powers(nodes.shape[2] - 1), edge[which]
    curve = np.einsum("nm,pmi->pni", to_powers, nodes[polygon, own])
    ends = []
    for turn, at in ((-1, k), (1, (k + 1) % num[polygon])):
        beside = edge[polygon, (k + turn) % num[polygon]]
        t = _nearest(nodes[polygon, own], y[polygon, at])
        t[beside == sides + (own - sides + turn) % others] = (1 + turn) // 2  # a corner of both
        crossed = np.flatnonzero(beside < sides)
        other = nodes[polygon, beside][crossed]
        s = _nearest(other, y[polygon, at][crossed])
        other = np.einsum("nm,pmi->pni", to_powers, other)
        t[crossed] = _crossings(curve[crossed], other, t[crossed], s)
        ends.append(t)
    start, end = ends
    points = [_evaluate(curve, t)[0] for t in (start, 0.5 * (start + end), end)]
    return np.stack(points, axis=1)


def _nearest(nodes, point) -> npt.NDArray[np.float64]:
    """Positions of points along straight edges, from 0 to 1."""
    step = nodes[:, -1] - nodes[:, 0]
    square = np.maximum(np.einsum("pi,pi->p", step, step), 1e-300)
    return np.einsum("pi,pi->p", point - nodes[:, 0], step) / square


def _evaluate(curves, t) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Points and derivatives of curves, ``(num, power, 2)``, each at its t."""
    value, slope = curves[:, -1].copy(), np.zeros_like(curves[:, -1])
    for n in range(curves.shape[1] - 2, -1, -1):
        slope = slope * t[:, None] + value
        value = value * t[:, None] + curves[:, n]
    return value, slope


def _crossings(a, b, s, t) -> npt.NDArray[np.float64]:
    """Crossings of curves with others, moved to those of straight ones if nearly parallel.

    They are at most an edge from these.
    """
    first = s
    straight = np.abs(_sine(a[:, 1:].sum(axis=1), b[:, 1:].sum(axis=1)))
    for _ in range(NEWTON):
        (x, dx), (y, dy) = _evaluate(a, s), _evaluate(b, t)
        rest, det = y - x, _cross2(dx, dy)
        det = np.where(np.abs(det) > 1e-300, det, np.inf)
        step = np.clip(np.stack((_cross2(rest, dy), _cross2(rest, dx))) / det, -1, 1)
        s, t = s + step[0], t + step[1]
        if np.abs(step).max(initial=0) < LAST:
            break
    sine = np.minimum(np.abs(_sine(dx, dy)), straight)
    share = np.minimum(sine / PARALLEL_CURVES, 1)
    return first + share**2 * (3 - 2 * share) * np.clip(s - first, -1, 1)


def _sine(a, b) -> npt.NDArray[np.float64]:
    """Sine of the angle between vectors, ``(num, 2)``."""
    return _cross2(a, b) / np.maximum(lengths(a) * lengths(b), 1e-300)


def _cross2(a, b) -> npt.NDArray[np.float64]:
    """Cross products of vectors in the plane, ``(..., 2)``."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _parabolas(ends, bend, t) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Points of parabolas and derivatives by t, as :meth:`FacetPieces.along`.

    Args:
        ends: Start and end of straight edges, ``(num, 2, 2)``.
        bend: Distances from these at the start, in the middle and at the end, ``(num, 3, 2)``.
        t: From 0 to 1, ``(num_points,)``.
    """
    powers = np.column_stack((t**0, t, t**2))
    slopes = np.column_stack((0 * t, t**0, 2 * t))
    straight, curved = _to_powers(1), _to_powers(2)
    return tuple((of[:, :2] @ straight) @ ends + (of @ curved) @ bend for of in (powers, slopes))
