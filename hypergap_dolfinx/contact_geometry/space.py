# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""Contact's Σ in space: the weighted gap of columns on the dofs of both sides.

A column stands on a piece of a facet of Γ1, along the facet's normal, up to the facet of Γ0 there.
The vertex of Γ1 that is next to it has it as a whole: :math:`g_a = \int f\,dX` over its pieces. So
weights are never negative, and nothing jumps as nodes pass nodes. Where the surfaces touch, columns
fill what is between them. Pieces' edges move with Γ0; as f is continuous across them only those at
Γ0's outline are in ∂g/∂u, and in ∂²g/∂u² the jumps of f's derivatives.
"""

from dataclasses import dataclass, field
from functools import cached_property

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.contact_geometry import curves, heights, slips
from hypergap_dolfinx.contact_geometry.columns import Blocks, merged
from hypergap_dolfinx.contact_geometry.heights import Rays
from hypergap_dolfinx.contact_geometry.moments import rule
from hypergap_dolfinx.contact_geometry.opened import OpenCells
from hypergap_dolfinx.contact_geometry.opposite import (
    Frames,
    Label,
    Pieces,
    find_pieces,
    polygon_areas,
    reference_corners,
)
from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.errors import NotFacingError
from hypergap_dolfinx.surface.moving import Displacements, Sides, Sparse, displaced
from hypergap_dolfinx.surface.tolerances import COVERED_SIDE
from hypergap_dolfinx.surface.trace import Surface, lengths


@dataclass
class _State:
    """Σ at displacements."""

    u: Displacements
    surfaces: tuple[Surface, Surface]
    frames: Frames
    pieces: Pieces
    vertex: npt.NDArray[np.intp]
    """Vertex of Γ1 that has each piece, ``(num_pieces,)``."""
    rays: Rays
    """At the points of a rule on the pieces."""
    piece: npt.NDArray[np.intp]
    """The piece of each of them."""
    weights: npt.NDArray[np.float64]
    gap: tuple[npt.NDArray, npt.NDArray, Sparse] | None = None
    """g, m and C, once they are asked for."""

    def on_some(self, on) -> tuple[Rays, npt.NDArray, npt.NDArray]:
        """The rays on some pieces.

        All of the rule's: with fewer of them second derivatives of curved quadrilaterals are 10 %
        off, and Newton's iteration is no longer quadratic.

        Args:
            on: Numbers of pieces.

        Returns:
            The rays, and the piece and the weight of each.
        """
        asked = np.zeros(len(self.vertex), dtype=bool)
        asked[on] = True
        points = np.flatnonzero(asked[self.piece])
        return self.rays.some(points), self.piece[points], self.weights[points]

    def pairs(self, on) -> tuple[npt.NDArray[np.intp], tuple[npt.NDArray, ...]]:
        """The pairs of facets that some pieces are of.

        Args:
            on: Numbers of pieces.

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
    def areas(self) -> npt.NDArray[np.float64]:
        """As seen along the rays, ``(num_pieces,)``."""
        return np.bincount(self.piece, self.weights * self.rays.heights[1], len(self.vertex))

    @cached_property
    def volumes(self) -> npt.NDArray[np.float64]:
        """Of the columns, ``(num_pieces,)``."""
        return np.bincount(self.piece, self.weights * self.rays.heights[0], len(self.vertex))


@dataclass(frozen=True)
class _Edges:
    """Points of a rule on those edges of pieces that are Γ0's, and how they move on Γ1."""

    rays: Rays
    piece: npt.NDArray[np.intp]
    weights: npt.NDArray[np.float64]
    normal: npt.NDArray[np.float64]
    """Out of the piece, of the length of the edge, in Γ1's reference facet, ``(num, 2)``."""
    outline: npt.NDArray[np.bool_]
    """Whether Γ0 ends there."""


@dataclass
class Opening:
    """Σ between two surfaces in space, with weights for each vertex of Γ1.

    It is found anew wherever the bodies are: g is continuous, and its derivatives are those of
    everything that moves. The same on every rank.
    """

    sides: Sides
    _last: _State | None = field(default=None, repr=False)

    @classmethod
    def between(cls, comm: MPI.Comm, sides: Sides, u: Displacements) -> "Opening":
        """Σ where the bodies are.

        Args:
            comm: Communicator.
            sides: Γ0 and Γ1.
            u: Their displacements.

        Raises:
            NotFacingError: Nothing of Γ1 lies opposite Γ0.
        """
        opening = cls(sides)
        opening._at(u)
        return opening

    @property
    def num_multipliers(self) -> int:
        """One for each vertex of Γ1, in reach of Γ0 or not."""
        return len(self.sides[1].reference.x)

    def _at(self, u: Displacements) -> _State:
        """Σ where the bodies are, the last one if they haven't moved."""
        last = self._last
        if last is None or any(not np.array_equal(*pair) for pair in zip(u, last.u, strict=True)):
            self._last = last = _place(self.sides, u)
        return last

    def gap(self, u: Displacements) -> tuple[npt.NDArray, npt.NDArray, Sparse]:
        """The weighted gap.

        Args:
            u: Displacements.

        Returns:
            g and m, ``(num_multipliers,)``, and C = ∂g/∂u,
            ``(num_multipliers, 3 (num_dofs0 + num_dofs1))``.
        """
        state = self._at(u)
        if state.gap is not None:
            return state.gap
        g, m = (
            np.bincount(state.vertex, part, self.num_multipliers)
            for part in (state.volumes, state.areas)
        )
        dofs = self._dofs(*state.pieces.facets)
        blocks = np.zeros((*dofs.shape, 3))  # of pieces
        state.rays.add_by_dofs(state.piece, state.weights, state.rays.heights[2], blocks)
        rim = _edges(state, outline=True)
        if len(rim.piece):
            moved = rim.weights * rim.rays.heights[0]
            rim.rays.add_by_dofs(rim.piece, moved, rim.rays.edges(rim.normal)[0], blocks)
        state.gap = g, m, self._by_vertices(state.vertex[:, None], dofs, blocks)
        return state.gap

    def curvature(self, u: Displacements, p: npt.NDArray[np.float64]) -> Sparse:
        """H = Σ_a p_a ∂²g_a/∂u², of the size of u.

        Args:
            u: Displacements.
            p: ``(num_multipliers,)``.
        """
        state = self._at(u)
        pressure = p[state.vertex]
        on = np.flatnonzero(pressure)
        if not len(on):
            return Sparse.empty()
        rays, piece, weights = state.on_some(on)
        pair, facets = state.pairs(on)
        dofs = self._dofs(*facets)
        blocks = Blocks(*dofs.shape)
        blocks.add_curvatures(pair[piece], pressure[piece] * weights, rays)
        edges = _edges(state, pressure != 0)
        if len(edges.piece):  # a facet of Γ0 may reach over all that is in contact
            a, b = _kinks(edges, pressure[edges.piece] * edges.weights)
            by_dofs = np.zeros((2, len(edges.piece), dofs.shape[1], 3))
            for by_q, by_dof in zip((a, b), by_dofs, strict=True):
                edges.rays.add_by_dofs(np.arange(len(a)), np.ones(len(a)), by_q, by_dof)
            blocks.add_products(pair[edges.piece], *by_dofs)
        return self._by_dofs(dofs, blocks.values)

    def slip(self, u: Displacements, lender: npt.NDArray[np.intp]) -> Sparse:
        """What the weighted slip of Γ1 on Γ0 is made of, in two directions at each vertex of Γ1.

        Args:
            u: Displacements.
            lender: The vertex whose directions each has, ``(num_multipliers,)``: slips of
                several are added where they share a traction.

        Returns:
            T with s = T (u − u_since), with 2 num_multipliers rows: those of the second directions
            are behind those of the first.
        """
        state = self._at(u)
        return self._slips(state, lender, np.arange(len(state.vertex)))

    def slip_slopes(
        self,
        u: Displacements,
        since: Displacements,
        lender: npt.NDArray[np.intp],
        on: npt.NDArray[np.bool_],
    ) -> Sparse:
        """∂s/∂u, of the size of T.

        Args:
            u: Displacements.
            since: Those from which slip is counted.
            lender: As for :meth:`slip`.
            on: Vertices that are asked for, ``(num_multipliers,)``.
        """
        state = self._at(u)
        some = np.flatnonzero(on[state.vertex])
        if not len(some):
            return Sparse.empty()
        return self._slips(state, lender, some, since)

    def _slips(self, state: _State, lender, on, since: Displacements | None = None) -> Sparse:
        """Slips on some pieces by the dofs, or derivatives of those since some displacements."""
        rays, piece, weights = state.on_some(on)
        number = np.zeros(len(state.vertex), dtype=np.intp)
        number[on] = np.arange(len(on))
        piece, vertex = number[piece], state.vertex[on]
        dofs = self._dofs(*(facet[on] for facet in state.pieces.facets))
        moves = None
        if since is not None:
            moves = np.concatenate([a - b for a, b in zip(state.u, since, strict=True)])[dofs]
        directions = slips.directions(state.surfaces[1], state.frames)[lender[vertex]]
        blocks = np.zeros((2 * len(on), dofs.shape[1], 3))
        for k in (0, 1):
            by_q = slips.slips(rays, piece, directions[piece, k], moves)
            rays.add_by_dofs(2 * piece + k, weights, by_q, blocks)
        rows = vertex[:, None] + self.num_multipliers * np.arange(2)
        return self._by_vertices(rows, dofs, blocks)

    def slip_curvature(
        self, u: Displacements, q: npt.NDArray[np.float64], lender: npt.NDArray[np.intp]
    ) -> Sparse:
        """∂(Tᵀq)/∂u, of the size of u; it isn't symmetric.

        Args:
            u: Displacements.
            q: ``(2, num_multipliers)``.
            lender: As for :meth:`slip`.
        """
        state = self._at(u)
        directions = slips.directions(state.surfaces[1], state.frames)
        traction = np.einsum("ka,aki->ai", q, directions[lender])[state.vertex]
        on = np.flatnonzero(traction.any(axis=1))
        if not len(on):
            return Sparse.empty()
        rays, piece, weights = state.on_some(on)
        pair, facets = state.pairs(on)
        dofs = self._dofs(*facets)
        blocks = np.zeros((len(dofs), dofs.shape[1], dofs.shape[1], 3, 3))
        forces = weights[:, None] * traction[piece]
        slips.add_curvatures(rays, pair[piece], forces, blocks)
        return self._by_dofs(dofs, blocks)

    def smoothed(self, u: Displacements, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Pressures for people: half of each piece has its vertex' p, half the mean of its facet.

        They have the force of p, and less of its scatter from node to node.

        Args:
            u: Displacements.
            p: ``(num_multipliers,)``.
        """
        state = self._at(u)
        facet, area = state.pieces.facets[1], state.areas
        num = len(state.surfaces[1].facets)
        force, size = (np.bincount(facet, w, num) for w in (area * p[state.vertex], area))
        mean = np.divide(force, size, out=np.zeros_like(size), where=size > 0)[facet]
        mean = 0.5 * (mean + p[state.vertex])
        total, size = (
            np.bincount(state.vertex, w, self.num_multipliers) for w in (area * mean, area)
        )
        return np.divide(total, size, out=np.zeros_like(total), where=size > 0)

    def cells(self, u: Displacements, p: npt.NDArray[np.float64]) -> OpenCells:
        """The columns where the bodies are, each as tetrahedra, to look at.

        Args:
            u: Displacements.
            p: Pressures, ``(num_multipliers,)``, or tractions, ``(num_multipliers, 3)``.
        """
        state = self._at(u)
        pieces = state.pieces
        piece, corner = np.nonzero(np.arange(pieces.X.shape[1] - 2) + 2 < pieces.num[:, None])
        facets = tuple(facet[piece] for facet in pieces.facets)
        ends = []
        for at in (0 * corner, corner + 1, corner + 2):
            X = pieces.X[piece, at]
            xi = heights.cast(state.surfaces, state.frames, facets, X).xi
            ends.append(
                [s.points(f, x) for s, f, x in zip(state.surfaces, facets, (xi, X), strict=True)]
            )
        prism = np.stack([x for side in (1, 0) for x in (end[side] for end in ends)], axis=1)
        x = prism[:, [[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]]].reshape(-1, 4, 3)
        area, cell = state.areas, np.repeat(piece, 3)
        return OpenCells(
            x=x,
            rank=state.surfaces[1].owner[pieces.facets[1][cell]],
            gap=(state.volumes / area)[cell],
            pressure=p[state.vertex][cell],
        )

    @property
    def _num_dofs(self) -> int:
        return sum(len(side.dofs) for side in self.sides)

    def _dofs(self, f0, f1) -> npt.NDArray[np.intp]:
        """Dofs of pairs of facets, Γ1's behind all of Γ0's, ``(num, num_facet_dofs)``."""
        below, above = (side.at_facets[f] for side, f in zip(self.sides, (f0, f1), strict=True))
        return np.hstack((below, len(self.sides[0].dofs) + above))

    def _by_vertices(self, rows, dofs, blocks) -> Sparse:
        """Sum of rows, ``(num, a)``, with blocks ``(num a, num_facet_dofs, 3)``, by dofs."""
        size = rows.shape[1] * self.num_multipliers, self._num_dofs
        return merged(rows, dofs, blocks.reshape(*rows.shape, -1, 1, 3), size)

    def _by_dofs(self, dofs, blocks) -> Sparse:
        """Sum of blocks, ``(num, num_dofs, num_dofs, 3, 3)``, by dofs, ``(num, num_dofs)``."""
        return merged(dofs, dofs, blocks, (self._num_dofs, self._num_dofs))


def _kinks(edges: _Edges, factor) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """What moving edges add to ∂²∫f/∂q²: jumps of f's derivatives.

    At Γ0's outline f is taken for zero, as it is in contact.

    Returns:
        a and b, ``(num, 7, 3)`` each, of a ⊗ b + b ⊗ a.
    """
    motion, slope = edges.rays.edges(edges.normal)
    half = ((edges.outline - 0.5) * slope * factor)[:, None, None] * motion
    if edges.outline.any():
        half += (edges.outline * factor)[:, None, None] * edges.rays.heights[2]
    return half, motion


def _place(sides: Sides, u: Displacements) -> _State:
    """Find Σ at displacements.

    Raises:
        NotFacingError: There is none.
    """
    surfaces = displaced(sides, u)
    below, above = surfaces
    frames = Frames.of(above)
    pieces = find_pieces(surfaces, frames)
    if not len(pieces.num):
        raise NotFacingError(
            f"nothing of Γ1 (around {spot(above.x)}) lies opposite Γ0 (around {spot(below.x)}) "
            "along its normals; check the tags."
        )
    degree = max(surface.geometry.degree for surface in surfaces)
    # What is linear on straight triangles has enough with 1
    linear = degree == 1 and all(surface.geometry.dim == 3 for surface in surfaces)
    rays, piece, weights = _cast(surfaces, frames, pieces, 1 if linear else 2 * degree)
    vertex = _stand_ins(above, pieces)[pieces.vertex]
    copy = u[0].copy(), u[1].copy()
    return _State(copy, surfaces, frames, pieces, vertex, rays, piece, weights)


def _cast(surfaces, frames: Frames, pieces: Pieces, degree: int):
    """Rays from the points of a rule on pieces, which piece each is on, and weights."""
    X, piece, weights = rule(pieces.X, degree)
    on, k = pieces.curved
    if len(on):  # what is between straight edges and curved ones
        at, more = curves.bulges(*pieces.edges(on, k), 3)
        X, weights = np.vstack((X, at.reshape(-1, 2))), np.append(weights, more)
        piece = np.append(piece, np.repeat(on, more.shape[1]))
        order = np.argsort(piece, kind="stable")
        X, piece, weights = X[order], piece[order], weights[order]
    facets = tuple(f[piece] for f in pieces.facets)
    return heights.cast(surfaces, frames, facets, X), piece, weights


def _edges(state: _State, which=True, *, outline: bool = False) -> _Edges:
    """Points on the pieces' edges that are Γ0's.

    Args:
        state: Σ.
        which: Pieces that are asked for, ``(num_pieces,)``.
        outline: Whether only Γ0's outline is.
    """
    pieces = state.pieces
    there = (np.arange(pieces.X.shape[1]) < pieces.num[:, None]) & (pieces.label != Label.INNER)
    at_end = state.surfaces[0].is_outline[pieces.facets[0][:, None], pieces.label]
    there &= np.broadcast_to(which, len(there))[:, None]
    if outline:
        there &= at_end
    piece, k = np.nonzero(there)
    curved = pieces.bend is not None
    points, weights = basix.make_quadrature(basix.CellType.interval, 5 if curved else 3)
    at = curves.along(*pieces.edges(piece, k), points[:, 0])
    X, step = (part.reshape(-1, 2) for part in at)
    num = len(points)
    facets = tuple(np.repeat(f[piece], num) for f in pieces.facets)
    return _Edges(
        heights.cast(state.surfaces, state.frames, facets, X),
        np.repeat(piece, num),
        np.tile(weights, len(piece)),
        np.column_stack((step[:, 1], -step[:, 0])),
        np.repeat(at_end[piece, k], num),
    )


def _stand_ins(surface: Surface, pieces: Pieces) -> npt.NDArray[np.intp]:
    """The vertex of Γ1 that has what is next to each one, ``(num_vertices,)``.

    A vertex of which no facet is covered by more than :data:`COVERED_SIDE` has no multiplier: its
    share goes to the nearest vertex that has one.
    """
    whole = polygon_areas(reference_corners(surface)[None])[0]
    covered = np.bincount(pieces.facets[1], pieces.area, len(surface.facets)) / whole
    has = np.zeros(len(surface.x), dtype=bool)
    has[surface.facets[covered > COVERED_SIDE]] = True
    stand_in = np.arange(len(surface.x))
    without = np.zeros_like(has)
    without[pieces.vertex] = True
    without &= ~has
    facets = surface.facets
    v, near = (part.ravel() for part in np.broadcast_arrays(facets[:, :, None], facets[:, None]))
    use = without[v] & has[near]
    v, near = v[use], near[use]
    order = np.lexsort((near, lengths(surface.x[near] - surface.x[v]), v))
    first = order[np.unique(v[order], return_index=True)[1]]
    stand_in[v[first]] = near[first]
    without[v] = False
    for alone in np.flatnonzero(without).tolist():
        near = np.flatnonzero(has)
        if not len(near):  # nothing but a part of one facet
            near, has[alone] = np.array([alone]), True
        stand_in[alone] = near[lengths(surface.x[near] - surface.x[alone]).argmin()]
    return stand_in
