# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Contact segments in space: columns between pieces of Γ1 and Γ0.

A column stands on a piece of a facet of Γ1, along the facet's normal, up to the facet of Γ0 there.
The vertex of Γ1 next to it has all of its volume: :math:`g_a = \int f\,dX` over its pieces. So
weights are never negative, and nothing jumps as nodes pass nodes. Columns fill the space between
surfaces that touch. Pieces' edges move with Γ0; as f is continuous across them only those
at Γ0's outline are in ∂g/∂u, and in ∂²g/∂u² the jumps of f's derivatives.
"""

from dataclasses import dataclass
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
from hypergap_dolfinx.contact_geometry.moments import rule
from hypergap_dolfinx.contact_geometry.opened import OpenCells
from hypergap_dolfinx.contact_geometry.opposite import (
    FacetPieces,
    Frames,
    Label,
    stand_ins,
)
from hypergap_dolfinx.contact_geometry.protocol import Found, Segments
from hypergap_dolfinx.contact_geometry.sheets import find_met
from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.errors import NotFacingError
from hypergap_dolfinx.surface.moving import Displacements, Sparse, displaced


@dataclass
class _Columns(Found):
    """Columns, and a rule's points on their pieces."""

    frames: Frames
    pieces: FacetPieces
    at_end: npt.NDArray[np.bool_]
    """Mask of the pieces' edges beyond which Γ0 isn't met, ``(num_pieces, num)``."""
    vertex: npt.NDArray[np.intp]
    """Vertex of Γ1 that has each piece, ``(num_pieces,)``."""
    rays: Rays
    """Rays at the points."""
    piece: npt.NDArray[np.intp]
    """Piece of each of them."""
    weights: npt.NDArray[np.float64]
    gap: tuple[npt.NDArray, npt.NDArray, Sparse] | None = None
    """g, m and C, once they are needed."""

    def on_some(self, on) -> npt.NDArray[np.intp]:
        """Numbers of the points on some pieces.

        All points of the rule: with fewer, second derivatives of curved quadrilaterals are 10 %
        off, and Newton's iteration is no longer quadratic.
        """
        mask = np.zeros(len(self.vertex), dtype=bool)
        mask[on] = True
        return np.flatnonzero(mask[self.piece])

    def pairs(self, on) -> tuple[npt.NDArray[np.intp], tuple[npt.NDArray, ...]]:
        """The pairs of facets of some pieces.

        Returns:
            Number of the pair of each piece, ``(num_pieces,)``, and both facets of pairs.
        """
        f0, f1 = (facet[on] for facet in self.pieces.facets)
        new = np.ones(len(on), dtype=bool)  # pieces of a pair follow each other
        new[1:] = (f0[1:] != f0[:-1]) | (f1[1:] != f1[:-1])
        pair = np.zeros(len(self.vertex), dtype=np.intp)
        pair[on] = np.cumsum(new) - 1
        return pair, (f0[new], f1[new])

    @cached_property
    def sizes(self) -> list[npt.NDArray[np.float64]]:
        """Volumes of the columns, and areas as seen along the rays, ``(num_pieces,)`` each."""
        parts = self.rays.heights[:2]
        return [np.bincount(self.piece, self.weights * f, len(self.vertex)) for f in parts]


@dataclass
class SpaceSegments(Segments[_Columns]):
    """Contact segments in space: columns."""

    @override
    def _find(self, u: Displacements) -> _Columns:
        below, above = surfaces = displaced(self.sides, u)
        frames = Frames.of(surfaces)
        pieces, at_end = find_met(frames)
        if not len(pieces.num):
            raise NotFacingError(
                f"nothing of Γ1 (around {spot(above.x)}) lies opposite Γ0 (around {spot(below.x)}) "
                "along its normals; check the tags."
            )
        vertex = stand_ins(above, pieces)[pieces.vertex]
        rays, piece, weights = _cast(frames, pieces)
        return _Columns(u, frames, pieces, at_end, vertex, rays, piece, weights)

    @override
    def gap(self, u: Displacements) -> tuple[npt.NDArray, npt.NDArray, Sparse]:
        state = self._at(u)
        if state.gap is not None:
            return state.gap
        dofs, rim = self._dofs(*state.pieces.facets), self._edges(state, outline=True)
        num, vertex = self.num_multipliers, state.vertex
        g, m = [np.bincount(vertex, part, num) for part in state.sizes]
        blocks = np.zeros((*dofs.shape, 3))  # of pieces
        state.rays.add_by_dofs(state.piece, state.weights, state.rays.heights[2], blocks)
        if len(rim.piece):
            rim.add_slopes(blocks)
        blocks = blocks[:, None, :, None]
        state.gap = g, m, merged(vertex[:, None], dofs, blocks, (num, self.num_dofs))
        return state.gap

    @override
    def curvature(self, u: Displacements, p: npt.NDArray[np.float64]) -> Sparse:
        state = self._at(u)
        pressure = p[state.vertex]
        on = np.flatnonzero(pressure)
        if not len(on):
            return Sparse.empty()
        pair, facets = state.pairs(on)
        dofs, points = self._dofs(*facets), state.on_some(on)
        edges, piece = self._edges(state, pressure != 0), state.piece[points]
        blocks = np.zeros((*dofs.shape, dofs.shape[1], 3, 3))
        factor = pressure[piece] * state.weights[points]
        state.rays.some(points).add_curvatures(pair[piece], factor, blocks)
        if len(edges.piece):  # a facet of Γ0 may reach over all that is in contact
            factor = pressure[edges.piece] * edges.weights
            edges.add_kinks(pair[edges.piece], factor, blocks)
        return merged(dofs, dofs, blocks, (self.num_dofs, self.num_dofs), symmetric=True)

    @override
    def slip(self, u: Displacements, target: npt.NDArray[np.intp]) -> Sparse:
        state = self._at(u)
        return self._slips(state, target, np.arange(len(state.vertex)))

    @override
    def slip_slopes(
        self,
        u: Displacements,
        since: Displacements,
        target: npt.NDArray[np.intp],
        on: npt.NDArray[np.bool_],
    ) -> Sparse:
        state = self._at(u)
        some = np.flatnonzero(on[state.vertex])
        if not len(some):
            return Sparse.empty()
        return self._slips(state, target, some, since)

    def _slips(self, state: _Columns, target, on, since: Displacements | None = None) -> Sparse:
        """T of some pieces, or ∂s/∂u of slips since given displacements."""
        points, vertex = state.on_some(on), state.vertex[on]
        number = np.zeros(len(state.vertex), dtype=np.intp)
        number[on] = np.arange(len(on))
        piece, weights = number[state.piece[points]], state.weights[points]
        dofs = self._dofs(*[facet[on] for facet in state.pieces.facets])
        moves = None
        if since is not None:
            moves = np.concatenate([a - b for a, b in zip(state.u, since, strict=True)])[dofs]
        e, rays = directions(state.frames)[target[vertex]], state.rays.some(points)
        blocks = np.zeros((2 * len(on), dofs.shape[1], 3))
        for k in (0, 1):
            by_q = rays.slips(piece, e[piece, k], moves)
            rays.add_by_dofs(2 * piece + k, weights, by_q, blocks)
        rows = vertex[:, None] + self.num_multipliers * np.arange(2)
        blocks = blocks.reshape(*rows.shape, -1, 1, 3)
        return merged(rows, dofs, blocks, (2 * self.num_multipliers, self.num_dofs))

    @override
    def slip_curvature(
        self, u: Displacements, q: npt.NDArray[np.float64], target: npt.NDArray[np.intp]
    ) -> Sparse:
        state = self._at(u)
        traction = np.einsum("ka,aki->ai", q, directions(state.frames)[target])[state.vertex]
        on = np.flatnonzero(traction.any(axis=1))
        if not len(on):
            return Sparse.empty()
        pair, facets = state.pairs(on)
        dofs, points = self._dofs(*facets), state.on_some(on)
        piece, blocks = state.piece[points], np.zeros((*dofs.shape, dofs.shape[1], 3, 3))
        forces = state.weights[points, None] * traction[piece]
        state.rays.some(points).add_slip_curvatures(pair[piece], forces, blocks)
        return merged(dofs, dofs, blocks, (self.num_dofs, self.num_dofs))

    @override
    def smoothed(self, u: Displacements, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        # Half of each piece has its vertex' pressure, half the mean of its facet
        state = self._at(u)
        facet, area, num = state.pieces.facets[1], state.sizes[1], len(state.frames.middle)
        force, size = (np.bincount(facet, w, num) for w in (area * p[state.vertex], area))
        mean = np.divide(force, size, out=np.zeros_like(size), where=size > 0)[facet]
        mean = 0.5 * (mean + p[state.vertex])
        total, size = (
            np.bincount(state.vertex, w, self.num_multipliers) for w in (area * mean, area)
        )
        return np.divide(total, size, out=np.zeros_like(total), where=size > 0)

    @override
    def cells(self, u: Displacements, p: npt.NDArray[np.float64]) -> OpenCells:
        # Three tetrahedra for each triangle of a piece
        state = self._at(u)
        pieces, surfaces = state.pieces, state.frames.surfaces
        piece, corner = np.nonzero(np.arange(pieces.X.shape[1] - 2) + 2 < pieces.num[:, None])
        facets = tuple(facet[piece] for facet in pieces.facets)
        ends = []
        for at in (0 * corner, corner + 1, corner + 2):
            X = pieces.X[piece, at]
            xi = cast(state.frames, facets, X).xi
            ends.append([s.points(f, x) for s, f, x in zip(surfaces, facets, (xi, X), strict=True)])
        prism = np.stack([x for side in (1, 0) for x in (end[side] for end in ends)], axis=1)
        x = prism[:, [[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]]].reshape(-1, 4, 3)
        cell, (volume, area) = np.repeat(piece, 3), state.sizes
        return OpenCells(
            x=x,
            rank=surfaces[1].owner[pieces.facets[1][cell]],
            gap=(volume / area)[cell],
            pressure=p[state.vertex][cell],
        )

    def _edges(self, state: _Columns, which=True, *, outline: bool = False) -> EdgeRays:
        """Points on the pieces' edges that lie on Γ0's.

        Args:
            state: Columns.
            which: Mask of the pieces, ``(num_pieces,)``.
            outline: True for edges at Γ0's outline only.
        """
        pieces = state.pieces
        there = (np.arange(pieces.X.shape[1]) < pieces.num[:, None]) & (pieces.label != Label.INNER)
        at_end = state.at_end
        there &= np.broadcast_to(which, len(there))[:, None]
        if outline:
            there &= at_end
        piece, k = np.nonzero(there)
        curved = pieces.bend is not None
        points, weights = basix.make_quadrature(basix.CellType.interval, 5 if curved else 3)
        along = pieces.along(piece, k, points[:, 0])
        X, step = [part.reshape(-1, 2) for part in along]
        num = len(points)
        f0, f1 = [np.repeat(facet[piece], num) for facet in pieces.facets]
        return EdgeRays(
            cast(state.frames, (f0, f1), X),
            np.repeat(piece, num),
            np.tile(weights, len(piece)),
            np.column_stack((step[:, 1], -step[:, 0])),
            np.repeat(at_end[piece, k], num),
        )

    def _dofs(self, f0, f1) -> npt.NDArray[np.intp]:
        """Dofs of pairs of facets, Γ1's behind all of Γ0's, ``(num, num_facet_dofs)``."""
        below, above = self.sides
        return np.hstack((below.at_facets[f0], len(below.dofs) + above.at_facets[f1]))


def _cast(frames: Frames, pieces: FacetPieces):
    """Rays from the points of a rule on pieces, the piece of each, and weights."""
    degree = max(surface.geometry.degree for surface in frames.surfaces)
    # Degree 1 is enough for linear integrands on straight triangles
    linear = degree == 1 and all(surface.geometry.dim == 3 for surface in frames.surfaces)
    X, piece, weights = rule(pieces.X, 1 if linear else 2 * degree)
    on, at, more = pieces.bulges(3)
    if len(on):
        X, weights = np.vstack((X, at.reshape(-1, 2))), np.append(weights, more)
        piece = np.append(piece, np.repeat(on, more.shape[1]))
        order = np.argsort(piece, kind="stable")
        X, piece, weights = X[order], piece[order], weights[order]
    facets = pieces.facets[0][piece], pieces.facets[1][piece]
    return cast(frames, facets, X), piece, weights
