# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Which pieces of Γ1's facets in space lie opposite which facets of Γ0.

Each facet of Γ1 looks along its own normal. It is divided into as many parts as it has vertices, by
lines from its middle to its edges' middles; what a facet of Γ0 covers of such a part is a piece, a
polygon in the plane across the normal. No piece is ever made larger or smaller by where nodes of
the other side are: as these pass, what changes is how a part is divided.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.contact_geometry import curves
from hypergap_dolfinx.contact_geometry.tolerances import (
    BENDS,
    LAST,
    LEANS_OPPOSITE,
    NEWTON_OPPOSITE,
    ROOM_PIECES,
    SLIVER,
)
from hypergap_dolfinx.core.compiled import call, doubles, ints, library, struct, structs
from hypergap_dolfinx.core.graph import components
from hypergap_dolfinx.surface.search import along_curve
from hypergap_dolfinx.surface.trace import (
    Surface,
    around,
    lengths,
    tabulate,
)


class Label(IntEnum):
    """Of a piece's edge that is none of Γ0's facet."""

    INNER = -1


@dataclass(frozen=True)
class Frames:
    """Planes across the normals of Γ1's facets in their middles."""

    middle: npt.NDArray[np.float64]
    """``(num_facets, 3)``."""
    tangents: npt.NDArray[np.float64]
    """``(num_facets, 2, 3)``."""
    normal: npt.NDArray[np.float64]
    """Cross product of the tangents, ``(num_facets, 3)``."""
    dual: npt.NDArray[np.float64]
    """Basis dual to the tangents in the plane, ``(num_facets, 2, 3)``."""

    @classmethod
    def of(cls, surface: Surface) -> "Frames":
        """Of all facets of a surface."""
        middle = reference_middle(surface)[None]
        values = surface.geometry.tabulate(1, middle)[:, 0, :, 0]  # (value and slopes, node)
        at = np.einsum("dm,fmi->fdi", values, surface.nodes)
        normal, dual = dual_basis(at[:, 1:])
        return cls(at[:, 0], at[:, 1:], normal, dual)

    def project(self, facet, x) -> npt.NDArray[np.float64]:
        """Coordinates of points in facets' planes, ``(num, ..., 2)``."""
        origin = self.middle[facet]
        shape = (len(facet), *[1] * (x.ndim - 2), 3)
        return np.einsum("fki,f...i->f...k", self.dual[facet], x - origin.reshape(shape))


def cross(a, b) -> npt.NDArray[np.float64]:
    """Of vectors, ``(num, 3)``: NumPy's own is slow for short ones."""
    result = np.empty_like(a)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return result


def dual_basis(tangents) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Normals of pairs of tangents, ``(num, 2, 3)``, and the dual bases across these."""
    normal = cross(tangents[:, 0], tangents[:, 1])
    square = np.maximum(np.einsum("fi,fi->f", normal, normal), 1e-300)[:, None]
    pair = cross(tangents[:, 1], normal) / square, cross(normal, tangents[:, 0]) / square
    return normal, np.stack(pair, axis=1)


def sides_of(surfaces: tuple[Surface, Surface]):
    """Γ0 and Γ1 for C; it lives as long as they do."""
    return structs("Facets", [surface.polynomials for surface in surfaces])


def reference_corners(surface: Surface) -> npt.NDArray[np.float64]:
    """Vertices of the reference facet, one after the other around it."""
    return basix.geometry(surface.geometry.cell_type)[
        around(np.arange(surface.facets.shape[1])[None])[0]
    ]


def reference_middle(surface: Surface) -> npt.NDArray[np.float64]:
    """Middle of the reference facet."""
    return reference_corners(surface).mean(axis=0)


@dataclass(frozen=True)
class Pieces:
    """What of Γ1 lies opposite Γ0, facet by facet and vertex by vertex."""

    facets: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]
    """Facets of Γ0 and of Γ1, ``(num_pieces,)`` each."""
    vertex: npt.NDArray[np.intp]
    """Vertex of Γ1 whose part of the facet it is in, ``(num_pieces,)``."""
    X: npt.NDArray[np.float64]
    """Corners in the reference facet of Γ1, counterclockwise, ``(num_pieces, num, 2)``; behind the
    last one they repeat it."""
    num: npt.NDArray[np.intp]
    """Numbers of corners, ``(num_pieces,)``."""
    label: npt.NDArray[np.intp]
    """Number of Γ0's facet's edge from each corner to the next, or :data:`Label.INNER`."""
    bend: npt.NDArray[np.float64] | None = None
    """How far these edges are from straight ones at the start, in the middle and at the end,
    ``(num_pieces, num, 3, 2)``; None where all are straight."""

    def some(self, some) -> "Pieces":
        """A part of them: numbers, or which."""
        facets = self.facets[0][some], self.facets[1][some]
        vertex, X, num, label = (part[some] for part in (self.vertex, self.X, self.num, self.label))
        bend = None if self.bend is None else self.bend[some]
        return Pieces(facets, vertex, X, num, label, bend)

    def edges(self, piece, k) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Ends of edges if they were straight, and how far they are away from that.

        Args:
            piece: ``(num,)``.
            k: Their first corners', ``(num,)``.

        Returns:
            On the reference facet, ``(num, 2, 2)`` and ``(num, 3, 2)``.
        """
        ends = np.stack((self.X[piece, k], self.X[piece, (k + 1) % self.num[piece]]), axis=1)
        bend = np.zeros((len(ends), 3, 2)) if self.bend is None else self.bend[piece, k]
        return ends, bend

    def bent(self, piece, k, X) -> "Pieces":
        """The same, but that edges bend.

        Args:
            piece: ``(num,)``.
            k: Their first corners', ``(num,)``.
            X: Where they start, have their middle and end, ``(num, 3, 2)``.
        """
        start, end = self.edges(piece, k)[0].swapaxes(0, 1)
        straight = np.stack((start, 0.5 * (start + end), end), axis=1)
        away = X - straight
        bends = np.abs(away).max(axis=(1, 2), initial=0) > BENDS
        if not bends.any():
            return self
        bend = np.zeros((*self.X.shape[:2], 3, 2))
        bend[piece[bends], k[bends]] = away[bends]
        return replace(self, bend=bend)

    @property
    def curved(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Piece and first corner of each edge that bends."""
        if self.bend is None:
            return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
        piece, k = self.bend.any(axis=(2, 3)).nonzero()
        return piece, k

    @property
    def area(self) -> npt.NDArray[np.float64]:
        """In the reference facet, ``(num_pieces,)``."""
        return polygon_areas(self.X)


def polygon_areas(y) -> npt.NDArray[np.float64]:
    """Of polygons, ``(num, num_corners, 2)``, of which corners may repeat."""
    steps = y - y[:, :1]
    a, b = steps[:, 1:-1], steps[:, 2:]
    return 0.5 * (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=1)


def find_pieces(surfaces: tuple[Surface, Surface], frames: Frames) -> Pieces:
    """All pieces.

    Args:
        surfaces: Γ0 and Γ1 where they are.
        frames: Of Γ1.
    """
    below, above = surfaces
    own = reference_corners(above)
    middles = (own + np.roll(own, -1, axis=0)) / 2
    centre = np.broadcast_to(own.mean(axis=0), own.shape)
    # (part, corner, 2), from the vertex counterclockwise
    parts = np.stack((own, middles, centre, np.roll(middles, 1, axis=0)), axis=1)
    f0, f1, part, count, edge, y, X = _cut(surfaces, frames, parts)
    # Edge k of the corners as seen from the other side is edge num − 2 − k of the facet
    sides, num = below.facets.shape[1], parts.shape[1]
    label = np.where(edge < num, Label.INNER, (sides - 2 - edge + num) % sides)
    pieces = Pieces((f0, f1), above.polygons[f1, part].astype(np.intp), X, count, label)
    if max(surface.geometry.degree for surface in surfaces) > 1:
        pieces = _bent(surfaces, frames, pieces, parts, part, y, edge)
    return _nearest_sheet(surfaces, frames, pieces)


def _cut(surfaces, frames: Frames, parts):
    """Cut parts of Γ1's facets with Γ0's, in C.

    Args:
        surfaces: Γ0 and Γ1 where they are.
        frames: Of Γ1.
        parts: Of Γ1's reference facet, ``(num_parts, 4, 2)``.

    Returns:
        Of each piece both facets and the part, ``(num_pieces,)``; the number of corners, likewise;
        which edge each edge is on, those of Γ0's facet behind the part's, ``(num_pieces,
        num_corners)``; corners in the plane and on the reference facet.
    """
    below, above = surfaces
    axes = frames.normal / lengths(frames.normal)[:, None]
    planes = np.concatenate((frames.middle[:, None], frames.dual, axes[:, None]), axis=1)
    reach = np.linalg.norm(above.nodes - frames.middle[:, None], axis=2).max(axis=1)
    order = ints(along_curve(below.x[below.facets].mean(axis=1)))
    given = sides_of(surfaces), order, *map(doubles, (below.normals, planes, reach, parts))
    room = ROOM_PIECES * (len(below.facets) + len(above.facets))
    while True:
        numbers = np.empty((4, room), dtype=np.int32)
        edge = np.empty((room, library("space").lib.MOST_CORNERS), dtype=np.int32)
        points = np.empty((2, *edge.shape, 2))
        of0, of1, part, count = numbers
        fields = {"facets": [of0, of1], "part": part, "count": count, "edge": edge}
        pieces = struct("Pieces", max=room, **fields, y=points[0], X=points[1])
        if call("find_pieces", *given, LEANS_OPPOSITE, SLIVER, LAST, pieces):
            raise MemoryError("no memory for the pieces of the gap domain")
        if pieces.num <= room:
            break
        room = pieces.num
    num, corners = pieces.num, int(numbers[3, : pieces.num].max(initial=1))
    y, X = points[:, :num, :corners]
    return *numbers[:, :num].astype(np.intp), edge[:num, :corners].astype(np.intp), y, X


def _bent(surfaces, frames: Frames, pieces: Pieces, parts, part, y, edge) -> Pieces:
    """Let edges of pieces bend that are Γ0's.

    Args:
        surfaces: Γ0 and Γ1 where they are.
        frames: Of Γ1.
        pieces: With straight ones.
        parts: Of Γ1's reference facet, ``(num_parts, 4, 2)``.
        part: The number of the one that each piece is in, ``(num_pieces,)``.
        y: Corners in the facets' planes, as the pieces' ``X``.
        edge: Which edge each is on, the part's first, as ``label``.
    """
    below, above = surfaces
    degree = max(surface.geometry.degree for surface in surfaces)
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
    own = _seen(above, frames, curves.edge_points(parts, degree))[f1, part]
    ring = curves.edge_points(reference_corners(below)[::-1], degree)  # from the other side
    x = (tabulate(below.geometry, ring.reshape(-1, 2)) @ below.nodes)[f0]
    nodes = np.concatenate((own, frames.project(f1, x).reshape(len(x), *ring.shape)), axis=1)
    y = curves.bent(y, pieces.num, edge, nodes, num, (piece, k))
    return pieces.bent(piece, k, _in_curved(above, frames, f1[piece], y))


def _seen(surface: Surface, frames: Frames, X) -> npt.NDArray[np.float64]:
    """Reference points, ``(..., 2)``, of each facet in its plane, ``(num_facets, ..., 2)``."""
    x = tabulate(surface.geometry, X.reshape(-1, 2)) @ surface.nodes
    return frames.project(np.arange(len(x)), x).reshape(len(x), *X.shape)


def _in_curved(surface: Surface, frames: Frames, facet, y) -> npt.NDArray[np.float64]:
    """Reference coordinates of points of curved facets.

    Args:
        surface: Γ1.
        frames: Its.
        facet: ``(num,)``.
        y: In the facets' planes, ``(num, num_points, 2)``.
    """
    nodes = frames.project(np.arange(len(surface.nodes)), surface.nodes)[facet]
    X = reference_middle(surface) + y
    for _ in range(NEWTON_OPPOSITE):
        table = surface.geometry.tabulate(1, X.reshape(-1, 2))[..., 0]  # (value or slope, ...)
        at, p, q = table.reshape(3, *y.shape[:2], -1) @ nodes
        rest, det = y - at, curves.cross(p, q)
        step = np.stack((curves.cross(rest, q) / det, curves.cross(p, rest) / det), axis=-1)
        X += np.clip(step, -0.5, 0.5)
        if np.abs(step).max(initial=0) < LAST:
            break
    return X


def _nearest_sheet(surfaces, frames: Frames, pieces: Pieces) -> Pieces:
    """Of what lies one behind the other what is nearest: a part of Γ0 that hangs together."""
    below, above = surfaces
    (f0, f1), num = pieces.facets, below.facets.shape[1]
    keys = (f1[:, None] * len(below.x) + below.facets[f0]).ravel()
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    piece = order // num
    sheet = components(len(f0), piece[same], piece[same + 1])
    if sheet.max(initial=-1) + 1 == len(np.unique(f1)):
        return pieces
    apart = below.x[below.facets[f0]].mean(axis=1) - frames.middle[f1]
    normal, other = frames.normal[f1], below.normals[f0]
    height = np.einsum("pi,pi->p", other, apart) / np.einsum("pi,pi->p", other, normal)
    area = pieces.area
    mean = np.bincount(sheet, np.abs(height) * area) / np.bincount(sheet, area)
    facet = np.zeros(len(mean), dtype=np.intp)
    facet[sheet] = f1
    best = np.full(len(above.facets), np.inf)
    np.minimum.at(best, facet, mean)
    first = np.full(len(above.facets), len(mean))
    nearest = np.flatnonzero(mean <= best[facet])
    np.minimum.at(first, facet[nearest], nearest)
    return pieces.some(first[f1] == sheet)
