# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The order of a surface's facets in the plane, and ways along it from one place to another."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.strip import chains
from hypergap_dolfinx.gap.surface import Surface

KINK = 0.5
"""Cosine of the turn of a surface from which it goes on beyond a vertex."""


@dataclass(frozen=True)
class Order:
    """A surface's facets one after the other, in chains that end where it turns too far to go on.

    They are the same until another vertex turns too far.
    """

    kinks: npt.NDArray[np.bool_]
    """Where it does, ``(num_vertices,)``."""
    facets: npt.NDArray[np.intp]
    """Chain by chain, ``(num_facets,)``."""
    start: npt.NDArray[np.intp]
    """Where each chain starts among them, ``(num_chains,)``."""
    count: npt.NDArray[np.intp]
    """Its number of facets, ``(num_chains,)``."""
    closed: npt.NDArray[np.bool_]
    """Whether it is a loop, ``(num_chains,)``."""
    ends: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]
    """First and last facets of those that aren't loops."""
    is_end: npt.NDArray[np.bool_]
    """Whether a facet is a first and whether it is a last one, ``(2, num_facets)``."""
    chain: npt.NDArray[np.intp]
    """Of each facet, ``(num_facets,)``."""
    position: npt.NDArray[np.intp]
    """In its chain, ``(num_facets,)``."""

    @classmethod
    def of(cls, surface: Surface, last: "Order | None" = None) -> "Order":
        """That of a surface where it is; the last one, where it was, if it still holds.

        Raises:
            InterfaceError: It branches.
        """
        kinks = find_kinks(surface)
        if last is not None and np.array_equal(kinks, last.kinks):
            return last
        found = chains(surface, kinks)
        facets = np.concatenate([part.facets for part in found]).astype(np.intp)
        count = np.array([len(part.facets) for part in found])
        closed = np.array([part.closed for part in found])
        start = np.cumsum(count) - count
        ends = facets[start[~closed]], facets[(start + count - 1)[~closed]]
        is_end = np.zeros((2, len(facets)), dtype=bool)
        for which, some in zip(is_end, ends, strict=True):
            which[some] = True
        chain, position = np.empty_like(facets), np.empty_like(facets)
        chain[facets] = np.repeat(np.arange(len(found)), count)
        position[facets] = np.arange(len(facets)) - np.repeat(start, count)
        return cls(kinks, facets, start, count, closed, ends, is_end, chain, position)

    def ways(self, length, a, b) -> npt.NDArray[np.float64]:
        """Ways between middles of facets of the same chains, the shorter ones round loops.

        Args:
            length: Of all facets, ``(num_facets,)``.
            a: Facets, ``(num,)``.
            b: Others, ``(num,)``.
        """
        length, arc = length[self.facets], np.empty(len(length))
        arc[self.facets] = np.cumsum(length) - length / 2
        way = np.abs(arc[a] - arc[b])
        round_ = np.where(self.closed, np.add.reduceat(length, self.start), np.inf)
        return np.minimum(way, round_[self.chain[a]] - way)

    def between(self, begin, end) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """Facets from one place to another, the shorter way round loops.

        Args:
            begin: Facets and parameters, ``(num_ways, 2)``.
            end: Others of the same chains, ``(num_ways, 2)``.

        Returns:
            For each facet the number of its way, ``(num,)``, its own, ``(num,)``, and the
            parameters from which to which the way goes on it, ``(num, 2)``.
        """
        chain = self.chain[begin[:, 0]]
        count = self.count[chain]
        steps = self.position[end[:, 0]] - self.position[begin[:, 0]]
        half = count // 2
        steps = np.where(self.closed[chain], (steps + half) % count - half, steps)
        back = steps < 0
        first, last = np.where(back, end.T, begin.T), np.where(back, begin.T, end.T)
        num = np.abs(steps) + 1
        way = np.repeat(np.arange(len(num)), num)
        k = np.arange(len(way)) - (np.cumsum(num) - num)[way]
        start, place = self.start[chain], self.position[first[0]]
        facet = self.facets[start[way] + (place[way] + k) % count[way]]
        limits = np.tile((0, 1), (len(way), 1))  # numbers of the parameters of starts and ends
        limits[k == 0, 0] = first[1]
        limits[k == num[way] - 1, 1] = last[1]
        back = back[way]
        limits[back] = limits[back, ::-1]
        return way, facet, limits


def beside(surface: Surface) -> npt.NDArray[np.intp]:
    """The facets that end and start at each vertex, −1 if there is none, ``(2, num_vertices)``."""
    found = np.full((2, len(surface.x)), -1)
    each = np.arange(len(surface.facets))
    found[0, surface.facets[:, 1]] = found[1, surface.facets[:, 0]] = each
    return found


def find_kinks(surface: Surface) -> npt.NDArray[np.bool_]:
    """Vertices at which a surface turns too far to go on, ``(num_vertices,)``."""
    before, behind = beside(surface)
    inner = np.flatnonzero((before >= 0) & (behind >= 0))
    n0, n1 = surface.normals[before[inner]], surface.normals[behind[inner]]
    kinks = np.zeros(len(surface.x), dtype=bool)
    kinks[inner] = np.einsum("vi,vi->v", n0, n1) < KINK
    return kinks
