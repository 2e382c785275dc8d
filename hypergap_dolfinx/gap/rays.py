# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Contact's Σ in the plane: fans between Γ1's vertices and what Γ1's rays cut from Γ0.

From the middle of each edge of Γ1 a ray goes along its normal to Γ0. Between two rays Γ0 is the
base of a fan of cells with Γ1's vertex as apex, which has their whole weight; the edge of Γ1 is
the base of a cell with the ray's end as apex, of which the foot is the edge's middle: ∂ψ/∂α is a
half for both its vertices. So weights are never negative, and nothing jumps as nodes pass nodes.

A place is a facet and the number of a parameter on it, ``(..., 2)``; where there is none both are
:data:`Fixed.NONE`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.moving import COVERED
from hypergap_dolfinx.gap.order import Order, beside, find_kinks
from hypergap_dolfinx.gap.surface import Surface, lengths

END = 1e-7
"""Distance along an edge, in its lengths, of ends that are opposite to each other."""
FACES = 0.25
"""Cosine between edges of Γ0 and Γ1 from which they face each other."""
FARTHER = 8.0
"""Longest way on Γ0 between neighbouring rays, in lengths of their edges."""
CHUNK = 256  # edges of Γ1 at a time
REACHED = 0.999
"""Part of an edge of Γ1 that Γ0 must reach for weights of both vertices, if only one had them."""
KEPT = 0.9
"""The same of degree 2, if both had them: for degree 1 it is :data:`COVERED`."""


class Fixed(IntEnum):
    """Parameters that don't depend on displacements: an edge's start, end and middle."""

    NONE, START, END, MIDDLE = range(-1, 3)


POSITIONS = np.array((0.0, 1.0, 0.5))  # of start, end and middle


@dataclass(frozen=True)
class Crossings:
    """Points of Γ0 and Γ1 at one position along the chord of Γ1's edge."""

    facets: npt.NDArray[np.intp]
    """On Γ0 and on Γ1, ``(num, 2)``."""
    unknown: npt.NDArray[np.intp]
    """Side on which a crossing moves along its facet, ``(num,)``."""
    given: npt.NDArray[np.float64]
    """Reference coordinate on the other side, ``(num,)``."""
    guess: npt.NDArray[np.float64]
    """Reference coordinate of what moves, if facets were straight, ``(num,)``."""


@dataclass(frozen=True)
class Fans:
    """Cells of Σ: a base between two parameters of a facet, and an apex on the other side.

    Parameters are reference coordinates in facets: those of :class:`Fixed`, then those of
    crossings, which move with the bodies.
    """

    side: npt.NDArray[np.intp]
    """Side of the base, ``(num_cells,)``."""
    base: npt.NDArray[np.intp]
    """Its facet, ``(num_cells,)``."""
    apex: npt.NDArray[np.intp]
    """The apex' facet, ``(num_cells,)``."""
    parameters: npt.NDArray[np.intp]
    """Of the base's start and end, and of the apex, ``(num_cells, 3)``."""
    vertices: npt.NDArray[np.intp]
    """Vertices of Γ1 that share the cell, ``(num_cells, 2)``; each has one half."""
    crossings: Crossings
    whole: npt.NDArray[np.bool_]
    """Edges of Γ1 of which both vertices have a weight, ``(num_facets1,)``."""
    order: Order
    """Γ0's."""


@dataclass(frozen=True)
class _Rays:
    """Where the rays of Γ1's edges meet Γ0, and where Γ0's ends are opposite of Γ1."""

    hit: npt.NDArray[np.intp]
    """The nearest facet of Γ0 that faces an edge where it starts, ends and has its middle, or
    :data:`Fixed.NONE`, ``(num_facets1, 3)``."""
    t: npt.NDArray[np.float64]
    """Where on it, ``(num_facets1, 3)``."""
    cut: npt.NDArray[np.intp]
    """Where an edge is the nearest to an end of Γ0: the facet that ends there, of what starts and
    of what ends on the edge, or :data:`Fixed.NONE`, ``(num_facets1, 2)``."""
    foot: npt.NDArray[np.float64]
    """Where on the edge, ``(num_facets1, 2)``."""

    @classmethod
    def of(cls, surface0: Surface, surface1: Surface, order: Order) -> "_Rays":
        """Look for them."""
        v0, v1 = surface0.x[surface0.facets], surface1.x[surface1.facets]
        t0, t1 = v0[:, 1] - v0[:, 0], v1[:, 1] - v1[:, 0]
        size, num = lengths(t0), len(v1)
        hit, t = np.full(3 * num, Fixed.NONE), np.zeros(3 * num)
        best = [np.full((num, len(ends)), np.inf) for ends in order.ends]
        position = [np.zeros((num, len(ends))) for ends in order.ends]
        for start in range(0, num, CHUNK):
            some = slice(start, min(start + CHUNK, num))
            a, c = v1[some, 0], t1[some]
            length = lengths(c)[:, None]
            # Positions along Γ1's edges, in lengths of them, of both ends of Γ0's
            s = np.einsum("fekx,fx->kfe", v0 - a[:, None, None], c) / length**2
            faces = (s[0] - s[1]) * length > FACES * size
            before, behind = (
                POSITIONS[:, None, None] + np.zeros((3, 1, len(v0))) for _ in range(2)
            )
            before[..., order.ends[0]] -= END
            behind[..., order.ends[1]] += END
            k, row, facet = np.nonzero(faces & (s[0] > before) & (s[1] <= behind))
            first, tau = s[0][row, facet], POSITIONS[k]
            where = np.clip((first - tau) / (first - s[1][row, facet]), 0, 1)
            x = v0[facet, 0] + where[:, None] * t0[facet]
            ray = 3 * (start + row) + k
            # The farthest first: nearer ones take their places
            order_ = np.lexsort((lengths(x - a[row] - tau[:, None] * c[row]), ray))[::-1]
            hit[ray[order_]], t[ray[order_]] = facet[order_], where[order_]
            for i, ends in enumerate(order.ends):
                if len(ends):
                    at = s[i][:, ends]
                    x = v0[ends, i] - a[:, None] - at[..., None] * c[:, None]
                    far = np.sqrt((x**2).sum(axis=2))
                    far[~faces[:, ends] | (at <= END) | (at >= 1 - END)] = np.inf
                    best[i][some], position[i][some] = far, at
        cut, foot = np.full((num, 2), Fixed.NONE), np.zeros((num, 2))
        for i, ends in enumerate(order.ends):  # Γ0 runs against Γ1
            if len(ends):
                nearest, each = best[i].argmin(axis=0), np.arange(len(ends))
                there = np.isfinite(best[i][nearest, each])
                cut[nearest[there], 1 - i] = ends[there]
                foot[nearest[there], 1 - i] = position[i][nearest, each][there]
        return cls(hit.reshape(num, 3), t.reshape(num, 3), cut, foot)


@dataclass(frozen=True)
class _Covered:
    """The parts of Γ1's edges that Γ0 is opposite of."""

    limits: npt.NDArray[np.intp]
    """Parameters of their starts and ends, ``(num_facets1, 2)``."""
    places: npt.NDArray[np.intp]
    """Places on Γ0 opposite of both, and of the middle if both vertices have multipliers,
    ``(num_facets1, 3, 2)``."""
    owner: npt.NDArray[np.intp]
    """Number of the vertex (0 or 1) that has all, if only one has, ``(num_facets1,)``."""
    crossings: Crossings

    @property
    def there(self) -> npt.NDArray[np.bool_]:
        """Edges of which something is covered, ``(num_facets1,)``."""
        return self.places[:, Fixed.START, 0] >= 0

    @property
    def whole(self) -> npt.NDArray[np.bool_]:
        """Edges of which both vertices have multipliers, ``(num_facets1,)``."""
        return self.places[:, Fixed.MIDDLE, 0] >= 0


def _cover(rays: _Rays, order: Order, walls: npt.NDArray[np.intp], least) -> _Covered:
    """What of Γ1's edges is covered.

    Args:
        rays: Of Γ1's edges.
        order: Γ0's.
        walls: Places opposite of both ends of edges where they are known, ``(num_facets1, 2, 2)``.
        least: Part of an edge, ``(num_facets1,)``: if more is covered both vertices have a weight.
    """
    facet, cut = rays.hit.copy(), rays.cut.copy()
    # Two parts of Γ0 with a hole between them: the larger counts
    hole = np.flatnonzero((cut >= 0).all(axis=1) & (rays.foot[:, 0] >= rays.foot[:, 1]))
    cut[hole, (rays.foot[hole, 1] < 1 - rays.foot[hole, 0]).astype(int)] = Fixed.NONE
    walled = walls[..., 0] >= 0
    cuts = ~walled & (cut >= 0)
    facet[:, :2] = np.where(walled, walls[..., 0], np.where(cuts, cut, facet[:, :2]))
    facet[(facet[:, :2] < 0).any(axis=1)] = Fixed.NONE
    cuts &= facet[:, :1] >= 0
    position = np.where(cuts, rays.foot, (0.0, 1.0))
    facet[position[:, 1] - position[:, 0] <= least, Fixed.MIDDLE] = Fixed.NONE
    # Where a ray meets an end of Γ0 the parameter is known
    parameter = np.full(facet.shape, Fixed.NONE)
    for number in (Fixed.START, Fixed.END):
        parameter[order.is_end[number, facet] & (rays.t == POSITIONS[number])] = number
    parameter[facet < 0] = Fixed.NONE
    parameter[:, Fixed.MIDDLE] = Fixed.NONE
    parameter[:, :2] = np.where(cuts, (Fixed.END, Fixed.START), parameter[:, :2])
    parameter[:, :2] = np.where(walled, walls[..., 1], parameter[:, :2])
    # Others are those of crossings: where Γ0 ends on Γ1, and where rays meet Γ0
    limits = np.tile((Fixed.START, Fixed.END), (len(facet), 1)).astype(np.intp)
    f, k = np.nonzero(cuts)
    g, m = np.nonzero((facet >= 0) & (parameter == Fixed.NONE))
    numbers = len(POSITIONS) + np.arange(len(f) + len(g))
    limits[f, k], parameter[g, m] = np.split(numbers, [len(f)])
    crossings = Crossings(
        np.column_stack((np.append(facet[f, k], facet[g, m]), np.append(f, g))),
        np.repeat((1, 0), (len(f), len(g))),
        np.append(1.0 - k, POSITIONS[m]),
        np.append(rays.foot[f, k], rays.t[g, m]),
    )
    owner = (position[:, 0] > 1 - position[:, 1]).astype(np.intp)
    return _Covered(limits, np.stack((facet, parameter), axis=2), owner, crossings)


def cast(
    surface0: Surface,
    surface1: Surface,
    last: Fans | None = None,
    walls: Sequence[tuple[int, int]] = (),
) -> Fans:
    """Find Σ's cells between two surfaces where they are.

    Args:
        surface0: Γ0.
        surface1: Γ1.
        last: Those where they were. With a vertex' weight the bodies move a little: that one comes
            and another goes at one place would leave places where neither is right.
        walls: Vertices of Γ1 and of Γ0 that are opposite whatever the rays say: the ends at a wall.

    Raises:
        InterfaceError: A surface branches.
    """
    order = Order.of(surface0, last.order if last else None)
    num = len(surface1.facets)
    known = np.full((num, 2, 2), Fixed.NONE)
    for a, b in walls:
        f, k = np.argwhere(surface1.facets == a)[0]
        known[f, k] = np.argwhere(surface0.facets == b)[0]
    kept = COVERED if surface1.element.degree == 1 else KEPT
    least = np.where(last.whole, kept, REACHED) if last else np.full(num, REACHED)
    covered = _cover(_Rays.of(surface0, surface1, order), order, known, least)
    f = np.flatnonzero(covered.there)
    owner, whole = covered.owner[f], covered.whole[f]
    own = surface1.facets[f, owner]
    place = covered.places[f, np.where(whole, Fixed.MIDDLE, 1 - owner)]
    base, apex, parameters, vertices = _fans(surface0, surface1, order, covered)
    return Fans(
        np.repeat((1, 0), (len(f), len(base))),
        np.append(f, base),
        np.append(place[:, 0], apex),
        np.vstack((np.column_stack((covered.limits[f], place[:, 1])), parameters)),
        np.vstack((np.where(whole[:, None], surface1.facets[f], own[:, None]), vertices)),
        covered.crossings,
        covered.whole,
        order,
    )


def _fans(surface0: Surface, surface1: Surface, order: Order, covered: _Covered):
    """Cells with their bases on Γ0: a fan at each vertex of Γ1, or one on each side of it.

    Returns:
        Facets of bases and apexes, parameters and vertices, as :class:`Fans` has them.
    """
    sides = np.arange(2)
    edges = beside(surface1).T  # (vertex, side)
    there = (edges >= 0) & covered.there[edges]
    # Γ0 runs against Γ1: a fan goes from what is behind the vertex to what is before it
    kind = np.where(covered.whole[edges], Fixed.MIDDLE, sides)
    there &= covered.whole[edges] | (covered.owner[edges] == 1 - sides)
    places = covered.places[edges, kind]  # (vertex, side, 2)
    chain = order.chain[places[..., 0]]
    both = there.all(axis=1) & ~find_kinks(surface1) & (chain[:, 0] == chain[:, 1])
    a = np.flatnonzero(both)
    reach = surface1.size[edges[a]].sum(axis=1)
    ways = order.ways(surface0.size, *places[a, :, 0].T)
    both[a[ways > FARTHER * reach]] = False
    a = np.flatnonzero(both)
    begin, end = places[a, 1], places[a, 0]
    apex = np.column_stack((edges[a, 1], np.full(len(a), Fixed.START)))
    # On the vertex' own side its edge ends, or what is covered of it
    b, i = np.nonzero(there & ~both[:, None])
    edge, opposite = edges[b, i], places[b, i]
    own = covered.places[edge, 1 - i]
    left = (i == 0)[:, None]
    begins, ends = np.where(left, own, opposite), np.where(left, opposite, own)
    apexes = np.column_stack((edge, covered.limits[edge, 1 - i]))
    same = order.chain[own[:, 0]] == order.chain[opposite[:, 0]]
    vertex, begin, end, apex = (
        np.concatenate((part, other[same]))
        for part, other in ((a, b), (begin, begins), (end, ends), (apex, apexes))
    )
    fan, facet, limits = order.between(begin, end)
    parameters = np.column_stack((limits, apex[fan, 1]))
    return facet, apex[fan, 0], parameters, np.repeat(vertex[fan, None], 2, axis=1)
