# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Contact segments in space: columns between pieces of Γ1 and Γ0.

A column stands on a piece of a facet of Γ1, along the facet's normal, up to the facet of Γ0 there.
All of its volume belongs to the nearest vertex of Γ1: :math:`g_a = \int f\,dX` over its pieces. So
weights are never negative, and nothing jumps as nodes pass nodes. Pieces' edges move with Γ0. Since
f is continuous across them, their motion isn't in ∂g/∂u, and in ∂²g/∂u² only through jumps of f's
derivatives.

This holds on facets of Γ1 that lie as a whole opposite one sheet of Γ0. On others sheets have
weights (``sheets.py``). Rows of vertices that Γ0 covers in part are blended with those of their
neighbours (``blending.py``).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import override

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.contact_geometry.heights import (
    EdgeRays,
    Rays,
    cast,
    directions,
    merged,
)
from hypergap_dolfinx.contact_geometry.moments import degree_of, rule
from hypergap_dolfinx.contact_geometry.opened import OpenColumns
from hypergap_dolfinx.contact_geometry.opposite import (
    FacetPieces,
    Frames,
    Label,
    OwnPairs,
    find_pieces,
    parts_of,
    reference_corners,
)
from hypergap_dolfinx.contact_geometry.protocol import Segments
from hypergap_dolfinx.contact_geometry.sheets import BodyTriangles, Faded, sort_out, weights_of
from hypergap_dolfinx.contact_geometry.tolerances import ROUND_OFF_FACET
from hypergap_dolfinx.core.graph import lots
from hypergap_dolfinx.surface.moving import Displacements, Sides, Sparse, displaced, joined
from hypergap_dolfinx.surface.tolerances import FACING_COSINE
from hypergap_dolfinx.surface.trace import Surface

Floats = npt.NDArray[np.float64]


@dataclass
class SpaceColumns:
    """Columns on facets that see one sheet, and parts of faded ones; gaps of all parts."""

    sides: Sides
    frames: Frames
    pieces: FacetPieces
    """Pieces on which columns stand."""
    rays: Rays
    """Rays at a rule's points on these."""
    piece: npt.NDArray[np.intp]
    """Piece of each of them."""
    weights: Floats
    faded: Faded | None
    """None if there is none."""
    shown: tuple[FacetPieces, Floats]
    """All pieces that are seen, and heights of columns there, to look at."""

    @classmethod
    def between(
        cls, sides: Sides, u: Displacements, itself: OwnPairs | None = None
    ) -> "SpaceColumns | None":
        """Columns at given displacements; None if no part of Γ1 sees Γ0.

        Args:
            sides: Γ0 and Γ1.
            u: Their displacements.
            itself: The pairs of facets that meet if both sides are one surface.
        """
        frames = Frames.of(displaced(sides, u))
        pieces, body = find_pieces(frames, itself), BodyTriangles.of(frames.surfaces[0], itself)
        if not len(pieces.num):
            return None
        rays, piece, weights = _cast(frames, pieces)
        seen = weights_of(frames, rays, body)
        least, most = np.ones(len(pieces.num)), np.zeros(len(pieces.num))
        np.minimum.at(least, piece, seen)
        np.maximum.at(most, piece, seen)
        parts = rays.heights[:2]
        height, area = (np.bincount(piece, weights * f, len(least)) for f in parts)
        height /= np.where(area > 0, area, 1)
        own, faded = sort_out(frames, pieces, least, most, height)
        if own.all():
            return cls(sides, frames, pieces, rays, piece, weights, None, (pieces, height))
        some = None
        if faded.any():
            parts = parts_of(frames.surfaces[1].geometry.cell_type)
            dofs = sides[0].at_facets, len(sides[0].dofs) + sides[1].at_facets
            some = Faded(frames, pieces.some(faded), dofs, body, parts)
        shown = pieces.some(own | faded), height[own | faded]
        number, on = np.cumsum(own) - 1, np.flatnonzero(own[piece])
        points = rays.some(on), number[piece[on]], weights[on]
        return cls(sides, frames, pieces.some(own), *points, some, shown)

    @cached_property
    def facets(self) -> npt.NDArray[np.int32]:
        """Vertices around Γ1's facets, ``(num_facets1, num_corners)``."""
        return self.frames.surfaces[1].polygons

    @cached_property
    def directions(self) -> Floats:
        """Directions in which vertices slip, ``(num, 2, 3)``."""
        return directions(self.frames)

    @cached_property
    def vertex(self) -> npt.NDArray[np.intp]:
        """Vertex of Γ1 that has each piece, ``(num_pieces,)``."""
        return self.facets[self.pieces.facets[1], self.pieces.part].astype(np.intp)

    @cached_property
    def size(self) -> tuple[int, int]:
        """Numbers of Γ1's vertices and of both sides' dofs."""
        return len(self.frames.surfaces[1].x), sum(len(side.dofs) for side in self.sides)

    def gaps(self) -> tuple[Floats, Floats, Floats, Sparse, Sparse]:
        """Gaps, covered shares and areas of parts; ∂g/∂u, summed over vertices; ∂covered/∂u."""
        shape = self.facets.shape
        f1, part = self.pieces.facets[1], self.pieces.part
        each = shape[1] * f1 + part
        g, areas = (
            np.bincount(each[self.piece], self.weights * f, self.facets.size).astype(float)
            for f in self.rays.heights[:2]
        )
        covered = np.zeros(self.facets.size)
        covered[np.unique(each)] = 1
        C, K = self._own_slopes, Sparse.empty()
        if self.faded:
            more, K = self.faded.gaps(g, covered, areas)
            C = joined(C, self._by_vertex(more))
            covered = np.minimum(covered, 1)
        return g.reshape(shape), covered.reshape(shape), areas.reshape(shape), C, K

    @cached_property
    def _own_slopes(self) -> Sparse:
        """∂g/∂u of columns."""
        dofs = self.dofs()
        blocks = np.zeros((*dofs.shape, 3))  # of pieces
        self.rays.add_by_dofs(self.piece, self.weights, self.rays.heights[2], blocks)
        return merged(self.vertex[:, None], dofs, blocks[:, None, :, None], self.size)

    def _by_vertex(self, parts: Sparse, num: int = 1) -> Sparse:
        """Sums over parts of vertices, of each component."""
        part, k = np.divmod(parts.i, num)
        rows = num * self.facets.ravel()[part].astype(np.int64) + k
        return Sparse(rows, parts.j, parts.values)

    def parting(self) -> Sparse:
        """Change of the gaps by displacements, with pairs of opposite points kept."""
        C = self._own_slopes
        return joined(C, self._by_vertex(self.faded.parting())) if self.faded else C

    def curvature(self, p: Floats, by_covered: Floats) -> Sparse:
        """Σ p ∂²g/∂u² + Σ by_covered ∂²covered/∂u², with values of parts."""
        H = Sparse.empty()
        if self.faded:
            H = self.faded.curvature(p.ravel(), by_covered.ravel())
        pressure = p[self.pieces.facets[1], self.pieces.part]
        on = np.flatnonzero(pressure)
        if not len(on):
            return H
        pair, facets = self.pairs(on)
        dofs, points = self.dofs(*facets), self.on_some(on)
        blocks = np.zeros((*dofs.shape, dofs.shape[1], 3, 3))
        for some in lots(len(points), 6000):
            rays, piece = self.rays.some(points[some]), self.piece[points[some]]
            factor = pressure[piece] * self.weights[points[some]]
            rays.add_curvatures(pair[piece], factor, blocks)
        for edges in self._edges(pressure != 0):
            factor = pressure[edges.piece] * edges.weights
            edges.add_kinks(pair[edges.piece], factor, blocks)
        return joined(H, merged(dofs, dofs, blocks, (self.size[1],) * 2, symmetric=True))

    def slips(self, on, moved: Floats | None = None) -> Sparse:
        """Slips of columns and of all faded parts: T, or ∂s/∂u if Δu moves with u.

        Args:
            on: Mask of Γ1's vertices whose columns count, ``(num,)``.
            moved: Δu by both sides' dofs, ``(num_dofs, 3)``, if it moves with u.

        Returns:
            Three components of vertices a, rows 3 a + i.
        """
        some = np.flatnonzero(on[self.vertex])
        points, vertex = self.on_some(some), self.vertex[some]
        number = np.zeros(len(self.vertex), dtype=np.intp)
        number[some] = np.arange(len(some))
        piece, weights = number[self.piece[points]], self.weights[points]
        dofs = self.dofs(*(facet[some] for facet in self.pieces.facets))
        moves = None if moved is None else moved[dofs]
        rays, blocks = self.rays.some(points), np.zeros((3 * len(some), dofs.shape[1], 3))
        for k, e in enumerate(np.eye(3)):
            by_q = rays.slips(piece, e, moves)
            rays.add_by_dofs(3 * piece + k, weights, by_q, blocks)
        rows = 3 * vertex[:, None] + np.arange(3)
        blocks = blocks.reshape(*rows.shape, dofs.shape[1], 1, 3)
        T = merged(rows, dofs, blocks, (3 * self.size[0], self.size[1]))
        return joined(T, self._by_vertex(self.faded.slips(moved), 3)) if self.faded else T

    def along(self, slips: Sparse, target: npt.NDArray[np.intp]) -> Sparse:
        """Slips in the directions of vertices' targets, ``(num,)``, component by component."""
        e = self.directions[target]
        num, across, n = e.shape
        i, j = np.arange(num)[:, None, None] + num * np.arange(across)[:, None], np.arange(num * n)
        i, j = np.broadcast_to(i, e.shape), np.broadcast_to(j.reshape(num, 1, n), e.shape)
        return Sparse(i.ravel(), j.ravel(), e.ravel()) @ slips

    def slip_curvature(self, q: Floats, target: npt.NDArray[np.intp]) -> Sparse:
        """∂(Tᵀq)/∂u from tractions of vertices, ``(2, num)``; it isn't symmetric."""
        traction = np.einsum("ka,aki->ai", q, self.directions[target])
        H = Sparse.empty()
        if self.faded:
            H = self.faded.slip_curvature(traction[self.facets.ravel()])
        own = traction[self.vertex]
        on = np.flatnonzero(own.any(axis=1))
        if not len(on):
            return H
        pair, facets = self.pairs(on)
        dofs, points = self.dofs(*facets), self.on_some(on)
        piece, blocks = self.piece[points], np.zeros((*dofs.shape, dofs.shape[1], 3, 3))
        forces = self.weights[points, None] * own[piece]
        self.rays.some(points).add_slip_curvatures(pair[piece], forces, blocks)
        return joined(H, merged(dofs, dofs, blocks, (self.size[1],) * 2))

    def on_some(self, on) -> npt.NDArray[np.intp]:
        """Numbers of the points on some pieces.

        All points of the rule: with fewer, second derivatives of curved quadrilaterals are 10 %
        off, and Newton's iteration is no longer quadratic.
        """
        mask = np.zeros(len(self.vertex), dtype=bool)
        mask[on] = True
        return np.flatnonzero(mask[self.piece])

    def pairs(self, on) -> tuple[npt.NDArray[np.intp], tuple[npt.NDArray, ...]]:
        """Pairs of facets of some pieces.

        Returns:
            Number of the pair of each piece, ``(num_pieces,)``, and both facets of pairs.
        """
        f0, f1 = (facet[on] for facet in self.pieces.facets)
        new = np.ones(len(on), dtype=bool)  # pieces of a pair follow each other
        new[1:] = (f0[1:] != f0[:-1]) | (f1[1:] != f1[:-1])
        pair = np.zeros(len(self.vertex), dtype=np.intp)
        pair[on] = np.cumsum(new) - 1
        return pair, (f0[new], f1[new])

    def _edges(self, which) -> Iterator[EdgeRays]:
        """Points on the pieces' edges that lie on Γ0's, some at a time.

        Args:
            which: Mask of the pieces, ``(num_pieces,)``.
        """
        pieces = self.pieces
        there = (np.arange(pieces.X.shape[1]) < pieces.num[:, None]) & (pieces.label != Label.INNER)
        there &= which[:, None]
        curved = pieces.bend is not None
        points, weights = basix.make_quadrature(basix.CellType.interval, 5 if curved else 3)
        num, every = len(points), np.nonzero(there)
        for some in lots(len(every[0]), 2000):
            piece, k = (part[some] for part in every)
            X, step = (part.reshape(-1, 2) for part in pieces.along(piece, k, points[:, 0]))
            f0, f1 = (np.repeat(facet[piece], num) for facet in pieces.facets)
            yield EdgeRays(
                cast(self.frames, (f0, f1), X),
                np.repeat(piece, num),
                np.tile(weights, len(piece)),
                np.column_stack((step[:, 1], -step[:, 0])),
            )

    @cached_property
    def columns(self) -> OpenColumns:
        """As :meth:`Segments.columns`."""
        (pieces, heights), surfaces = self.shown, self.frames.surfaces
        piece, corner = np.nonzero(np.arange(pieces.X.shape[1] - 2) + 2 < pieces.num[:, None])
        facets = tuple(facet[piece] for facet in pieces.facets)
        X = pieces.X[piece[:, None], np.stack((0 * corner, corner + 1, corner + 2), axis=1)]
        every, flat = tuple(np.repeat(facet, 3) for facet in facets), X.reshape(-1, 2)
        below = cast(self.frames, every, flat).xi
        x = [s.points(f, at) for s, f, at in zip(surfaces, every, (below, flat), strict=True)]
        vertices = self.facets[facets[1], pieces.part[piece]]
        return OpenColumns(
            x=np.stack(x[::-1]).reshape(2, -1, 3, 3).swapaxes(0, 1),
            facets=facets[1],
            X=X,
            vertices=vertices[:, None],
            shares=np.ones((len(piece), 3, 1)),
            gap=heights[piece],
        )

    def dofs(self, f0=None, f1=None) -> npt.NDArray[np.intp]:
        """Dofs of pairs of facets, Γ1's behind all of Γ0's, ``(num, num_facet_dofs)``.

        Args:
            f0: Facets of Γ0, the pieces' by default.
            f1: Facets of Γ1, likewise.
        """
        if f0 is None:
            f0, f1 = self.pieces.facets
        below, above = self.sides
        return np.hstack((below.at_facets[f0], len(below.dofs) + above.at_facets[f1]))


@dataclass
class SpaceSegments(Segments):
    """Contact segments in space."""

    itself: bool = field(default=False, kw_only=True)
    """True if both sides are one surface, which meets itself."""

    @cached_property
    def _own(self) -> OwnPairs | None:
        """Facets of one surface that meet each other."""
        return OwnPairs.of(self.sides[0].rest) if self.itself else None

    @cached_property
    def _samples(self) -> list[tuple[npt.NDArray[np.intp], Floats]]:
        """Facets and coordinates in them of vertices and of middles of edges and facets."""
        found = []
        for side in self.sides:
            surface = side.reference
            corners = reference_corners(surface.geometry.cell_type)
            X = np.vstack((corners, (corners + np.roll(corners, -1, axis=0)) / 2))
            X = np.vstack((X, corners.mean(axis=0)))
            edges = len(surface.x) + surface.edge_numbers
            own = edges.max(initial=0) + 1 + np.arange(len(edges))
            _, first = np.unique(np.column_stack((surface.polygons, edges, own)), return_index=True)
            facets, k = np.divmod(first, len(X))
            found.append((facets, X[k]))
        return found

    @override
    def _find(self, u: Displacements) -> SpaceColumns:
        found = SpaceColumns.between(self.sides, u, self._own)
        if found is None or not len(found.shown[1]):
            raise self._faces_nothing(u)
        return found

    @override
    def reaches(self, u: Displacements, least, p) -> npt.NDArray[np.float64]:
        far, deep, _ = found = np.zeros((3, self.num_multipliers))
        if self.itself:  # a place nearest to a surface is its own
            return found
        surfaces = displaced(self.sides, u)
        bodies = [BodyTriangles.of(s, cuts=min(s.geometry.degree, 2)) for s in surfaces]
        for side, body in enumerate(bodies):
            facets, X = self._samples[side]
            x, other = surfaces[side].points(facets, X), surfaces[1 - side].nodes
            reach = surfaces[1].size.max()
            low, high = other.min(axis=(0, 1)) - reach, other.max(axis=(0, 1)) + reach
            near = np.flatnonzero(((low <= x) & (x <= high)).all(axis=1))
            facets, X = facets[near], X[near]
            feet = bodies[1 - side].feet(x[near])
            on = np.flatnonzero(np.abs(feet.depths) > least.min())
            on = on[~feet.some(on).at_end]  # beyond an end nothing is known
            if side == 1:
                f0, f1 = feet.facet[on], facets[on]
                cos = np.einsum("pi,pi->p", surfaces[0].normals[f0], surfaces[1].normals[f1])
                faces = on[cos <= FACING_COSINE]
                _raise(far, surfaces[1], facets[faces], X[faces], -feet.depths[faces])
            on = on[feet.depths[on] > 0]  # in both bodies, if the way out starts in the own one
            on = on[body.feet(feet.some(on).x).depths > 0]
            feet = feet.some(on)
            at = (facets[on], X[on]) if side == 1 else (feet.facet, feet.X)
            _raise(deep, surfaces[1], *at, feet.depths)
        return found


def _raise(values: Floats, surface: Surface, facets, X, given: Floats):
    """Raise values of a surface's vertices to those given at points in their parts of facets.

    Args:
        values: ``(num_vertices,)``.
        surface: Γ1.
        facets: ``(num,)``.
        X: Reference coordinates, ``(num, 2)``.
        given: ``(num,)``.
    """
    apart = X[:, None] - reference_corners(surface.geometry.cell_type)
    apart = np.einsum("pki,pki->pk", apart, apart)
    point, k = np.nonzero(apart <= apart.min(axis=1, keepdims=True) + ROUND_OFF_FACET)
    np.maximum.at(values, surface.polygons[facets[point], k], given[point])


def _cast(frames: Frames, pieces: FacetPieces):
    """Rays from the points of a rule on pieces, the piece of each, and weights."""
    X, piece, weights = rule(pieces.X, degree_of(frames.surfaces))
    on, at, more = pieces.bulges(3)
    if len(on):
        X, weights = np.vstack((X, at.reshape(-1, 2))), np.append(weights, more)
        piece = np.append(piece, np.repeat(on, more.shape[1]))
        order = np.argsort(piece, kind="stable")
        X, piece, weights = X[order], piece[order], weights[order]
    facets = pieces.facets[0][piece], pieces.facets[1][piece]
    return cast(frames, facets, X), piece, weights
