# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Weighted gaps of Γ1's vertices from those of its edges' halves, or its facets' parts in space.

A vertex a has the halves e of its edges. Its covered share is :math:`c_a = 1 - \prod_e (1 - c_e)`,
1 where one half lies opposite Γ0 as a whole. Where ends and corners pass, c goes to 0, and so do
the entries of the vertex's row: a small force would then need a large pressure. So the row is

.. math:: \hat g_a = g_a + \theta (1 - c_a)^2 S_a, \qquad S_a = \sum_b c_b g_b,

with the other vertices b of a's facets. The smaller c_a, the more the row repeats those of its
neighbours. Its multiplier may then replace a neighbour's, but can't press where no neighbour does.
As c goes to 0, forces become those without the row, so equilibria are continuous functions of the
load. Where c is below :data:`SLIVER`, or below :data:`HARD` and no vertex beside it has a larger
covered share, the row is left out, and neighbours take its pressure. With the matrix L of these
sums, ĝ = L g, and multipliers p have the pressures Lᵀp.

Slips aren't shared. Coulomb's law holds at each vertex, with its own slip and its part of Lᵀp. A
law of p and of L times the slips would be that of a mean slip, which needn't be opposite to any of
those it stands for: forces would jump where c comes to be 0.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_geometry.tolerances import BLENDS, HARD, SLIVER
from hypergap_dolfinx.surface.moving import Sparse, joined

Floats = npt.NDArray[np.float64]


@dataclass
class Blended:
    """Gaps of vertices; derivatives are by both sides' dofs, Γ1's behind Γ0's."""

    rays: Any
    """What has gaps of halves: :class:`PlaneRays` in the plane, :class:`SpaceColumns` in space."""
    beside: npt.NDArray[np.int64]
    """Vertices and others beside them, ``(2, num_all_pairs)``."""
    num: int
    """Number of Γ1's vertices."""

    def __post_init__(self):
        """Find gaps and weights."""
        self.facets = self.rays.facets
        """Vertices of Γ1's facets, around them, ``(num_facets1, num_corners)``."""
        halves, self.covered, self.areas, self._slopes, self._by_covered = self.rays.gaps()
        left = np.ones(self.num)
        np.multiply.at(left, self.facets, 1 - self.covered)
        self._left = left
        self._c = 1 - left
        self._g = self._sums(halves)
        self._q, self._dq = BLENDS * left**2, -2 * BLENDS * left
        hard = (self._c > 0) & (self._c < 1)
        self.pairs = self.beside.compress(hard[self.beside[0]], axis=1)
        """Vertices that are covered in part, and others beside them, ``(2, num_pairs)``."""

    @cached_property
    def g(self) -> Floats:
        """L g, ``(num,)``."""
        return self.blended(self._g)

    @cached_property
    def m(self) -> Floats:
        """L of the areas of vertices, 0 where there is no multiplier, ``(num,)``."""
        a, b = self.pairs
        most = self._c.copy()
        np.maximum.at(most, a, self._c[b])
        least = HARD if self.beside.size else SLIVER  # rows that share nothing aren't hard
        return np.where((self._c < SLIVER) | (most < least), 0, self.blended(self.sizes))

    @cached_property
    def sizes(self) -> Floats:
        """Covered areas of vertices, ``(num,)``."""
        return self._sums(self.areas)

    @cached_property
    def C(self) -> Sparse:
        """∂ĝ/∂u."""
        a, b = self.pairs
        if not len(a):
            return self._slopes
        K, by_c = self._K, self._matrix(self._dq * self._sums_of(self._g), self._q[a] * self._g[b])
        of_both = joined(self.L, replace(by_c, j=self.num + by_c.j))
        return of_both @ joined(self._slopes, replace(K, i=self.num + K.i))

    def pressures(self, p: Floats) -> Floats:
        """Lᵀp, pressures of vertices from multipliers, ``(num, ...)`` each."""
        a, b = self.pairs
        result = p.astype(float)
        np.add.at(result, b, (self.shares * p[a].T).T)
        return result

    def blended(self, values: Floats) -> Floats:
        """L of values at vertices, ``(num,)``."""
        return values + self._q * self._sums_of(values)

    def curvature(self, p: Floats) -> Sparse:
        """Σ_a p_a ∂²ĝ_a/∂u²."""
        a, b = self.pairs
        S = self._sums_of(self._g)
        by_c = p * self._dq * S
        np.add.at(by_c, b, p[a] * self._q[a] * self._g[b])
        by_half = (by_c * self._left)[self.facets] * self._per_left
        H = self.rays.curvature(self.pressures(p)[self.facets], by_half)
        if not len(a) or not p[a].any():
            return H
        G, K = self._slopes, self._K
        weights = np.bincount(b, p[a] * self._q[a], self.num)
        beside = (p * self._dq)[a]
        by_g = self._matrix(weights, beside * self._c[b]) @ G
        M = K.T @ joined(by_g, self._matrix(BLENDS * p * S, beside * self._g[b]) @ K)
        # Of the product of what halves leave uncovered: of each one's by those before it
        halves, pairs = self._halves_of_c
        vertex = self.facets.ravel()[pairs[0]]
        B = halves.T @ (Sparse(pairs[0], pairs[1], -(by_c * self._left)[vertex]) @ halves)
        return joined(H, M, M.T, B, B.T)

    @cached_property
    def parting(self) -> Sparse:
        """Change of the gaps by Δu, with pairs of opposite points kept."""
        return self.L @ self.rays.parting()

    def bears(self) -> Sparse:
        """Normal forces of vertices, also from their neighbours' rows, per unit of multipliers."""
        return self.L.T.scaled(self.sizes)

    def slips(self, target: npt.NDArray[np.intp]) -> Sparse:
        """T with s = T Δu, along the directions of vertices' targets, ``(num,)``."""
        return self.rays.along(self._every_slip, target)

    @cached_property
    def _every_slip(self) -> Sparse:
        """Slips of all vertices, as vectors in space, by Δu."""
        return self.rays.slips(np.ones(self.num, dtype=bool))

    def slip_slopes(self, target, moved: Floats, on: npt.NDArray[np.bool_]) -> Sparse:
        """∂s/∂u if Δu moves with u.

        Args:
            target: As for :meth:`slips`.
            moved: Δu by both sides' dofs, ``(num_dofs, n)``.
            on: Mask of the vertices that count, ``(num,)``.
        """
        slips = self.rays.slips(on, moved) if moved.any() else self._every_slip
        return self.rays.along(slips, target)

    def slip_curvature(self, target, q: Floats) -> Sparse:
        """∂(Tᵀq)/∂u from tractions, ``(n - 1, num)``; it isn't symmetric."""
        return self.rays.slip_curvature(q, target)

    def force_slopes(self, p: Floats) -> Sparse:
        """∂(Lᵀp)/∂u times areas, ``(num, n num_dofs)``."""
        a, b = self.pairs
        own, beside = np.bincount(b, p[a] * self._q[a], self.num), p[a] * self._dq[a] * self._c[b]
        return self._matrix(own, beside, self.pairs[::-1]).scaled(self.sizes) @ self._K

    def _sums(self, halves: Floats) -> Floats:
        """Sums at vertices."""
        return np.bincount(self.facets.ravel(), halves.ravel(), self.num)

    def _sums_of(self, values: Floats) -> Floats:
        """Σ_b c_b values_b beside vertices that are covered in part, 0 elsewhere."""
        a, b = self.pairs
        return np.bincount(a, self._c[b] * values[b], self.num).astype(float)

    def _by_vertex(self, halves: Sparse) -> Sparse:
        """Rows of vertices, sums of their halves'."""
        return Sparse(self.facets.ravel()[halves.i].astype(np.int64), halves.j, halves.values)

    def _matrix(self, own: Floats, beside: Floats, pairs=None) -> Sparse:
        """A matrix by vertices from its diagonal and from values of pairs."""
        every = np.arange(self.num)
        i, j = self.pairs if pairs is None else pairs
        return Sparse(*map(np.concatenate, ((every, i), (every, j), (own, beside))))

    @cached_property
    def L(self) -> Sparse:
        """The matrix of weights, ``(num, num)``."""
        return self._matrix(np.ones(self.num), self.shares)

    @cached_property
    def shares(self) -> Floats:
        """q_a c_b of pairs."""
        a, b = self.pairs
        return self._q[a] * self._c[b]

    @cached_property
    def _per_left(self) -> Floats:
        """1 over what a half leaves uncovered (below 0 if seen twice), 0 if that is nothing."""
        left = 1 - self.covered
        return np.divide(1, left, out=np.zeros_like(left), where=left != 0)

    @cached_property
    def _K(self) -> Sparse:
        """∂c/∂u of vertices near to those that are covered in part."""
        K, left = self._by_covered, 1 - self.covered
        others = np.ones(self.num)  # of halves that leave anything
        np.multiply.at(others, self.facets, np.where(left == 0, 1, left))
        none = self._sums(left == 0)[self.facets] - (left == 0)
        others = np.where(none > 0, 0, others[self.facets] / np.where(left == 0, 1, left))
        by = self._by_vertex(Sparse(K.i, K.j, K.values * others.ravel()[K.i]))
        return by.some(self.near[by.i])

    @cached_property
    def near(self) -> npt.NDArray[np.bool_]:
        """Mask of vertices that are covered in part and of those beside them, ``(num,)``."""
        near = np.zeros(self.num, dtype=bool)
        near[self.pairs] = True
        return near

    @property
    def _halves_of_c(self) -> tuple[Sparse, npt.NDArray[np.intp]]:
        """∂c_e/∂u over 1 − c_e of halves, and pairs of one vertex' halves, ``(2, num_pairs)``."""
        K, vertices = self._by_covered, self.facets.ravel()
        K = K.some(self.near[vertices[K.i]]).scaled(self._per_left.ravel())
        halves = np.unique(K.i)
        halves = halves[np.argsort(vertices[halves], kind="stable")]
        start = np.searchsorted(vertices[halves], vertices[halves])
        before = np.arange(len(halves)) - start
        at = np.arange(before.sum()) - np.repeat(np.cumsum(before) - before - start, before)
        return K, np.stack((np.repeat(halves, before), halves[at]))
