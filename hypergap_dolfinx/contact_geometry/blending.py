# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Weighted gaps of Γ1's vertices in the plane from those of its edges' halves.

A vertex a has the halves e of its edges, and is covered by :math:`c_a = 1 - \prod_e (1 - c_e)`, 1
where one of them lies opposite Γ0 as a whole. Where ends and corners pass, c goes to 0, and so does
the weight of its row: a row that is hard to satisfy by little forces. So the row is

.. math:: \hat g_a = t(c_a)\,\bigl(g_a + \theta (1 - c_a)^2 S_a\bigr), \qquad S_a = \sum_b c_b g_b,

with the vertices b beside a, and a smooth step t from 0 at c = 0 to 1 at :data:`HARD`: the less is
covered, the more it says what its neighbours' rows say already. Below HARD it has no multiplier;
its neighbours get the pressure, and forces jump by no more than about HARD of it. With the matrix L
of these sums, ĝ = L g, multipliers p have the pressures Lᵀp. The same holds for slips.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_geometry.rays import PlaneRays
from hypergap_dolfinx.contact_geometry.tolerances import BLENDS, HARD
from hypergap_dolfinx.surface.moving import Sparse, joined

Floats = npt.NDArray[np.float64]


@dataclass
class Blended:
    """Gaps and slips of vertices; derivatives are by both sides' dofs, Γ1's behind Γ0's."""

    rays: PlaneRays
    facets: npt.NDArray[np.int32]
    """Vertices of Γ1's edges, ``(num_edges1, 2)``."""
    lengths: Floats
    """Chords of Γ1's edges, ``(num_edges1,)``."""
    num: int
    """Number of Γ1's vertices."""

    def __post_init__(self):
        """Find gaps and weights."""
        halves, self.covered, slopes, self._by_covered = self.rays.gaps()
        self._slopes = self._by_vertex(slopes)
        left = np.ones((self.num, 2))  # of what halves leave uncovered, by end of an edge
        for k, vertices in enumerate(self.facets.T):
            left[vertices, k] = 1 - self.covered[:, k]
        self._others = np.stack([left[v, 1 - k] for k, v in enumerate(self.facets.T)], axis=1)
        self._c = 1 - left.prod(axis=1)
        self._g = self._sums(halves)
        self.areas = self.covered * self.lengths[:, None] / 2
        """Areas of halves, ``(num_edges1, 2)``."""
        c, rest = self._c, 1 - self._c
        x = np.clip(c / HARD, 0, 1)
        self._t, dt, ddt = x**2 * (3 - 2 * x), 6 * x * (1 - x) / HARD, (6 - 12 * x) / HARD**2
        ddt[(x <= 0) | (x >= 1)] = 0
        self._dt, self._ddt = dt, ddt
        self._q = BLENDS * self._t * rest**2
        self._dq = BLENDS * (dt * rest**2 - 2 * self._t * rest)
        self._ddq = BLENDS * (ddt * rest**2 - 4 * dt * rest + 2 * self._t)
        hard = (c > 0) & (c < 1)
        both = np.concatenate((self.facets, self.facets[:, ::-1]))
        self._pairs = both[hard[both[:, 0]]].T

    @cached_property
    def g(self) -> Floats:
        """L g, ``(num,)``."""
        return self.blended(self._g)

    @cached_property
    def m(self) -> Floats:
        """L of the areas of vertices, 0 below :data:`HARD`, ``(num,)``."""
        return np.where(self._c < HARD, 0, self.blended(self.sizes))

    @cached_property
    def sizes(self) -> Floats:
        """Areas of vertices, ``(num,)``."""
        return self._sums(self.areas)

    @cached_property
    def C(self) -> Sparse:
        """∂ĝ/∂u."""
        own = self._own(self._slopes)
        if not len(self._hard):
            return own
        G, K, columns = self._dense(self._slopes, self._by_c)
        extra, hard = self._q[:, None] * self._sums_beside(G, K), self._hard
        rows = extra[hard] + self._by_own_c[hard, None] * K[hard]
        return joined(own, _entries(rows, hard, columns))

    def pressures(self, p: Floats) -> Floats:
        """Lᵀp, pressures of vertices from multipliers, ``(num, ...)`` each."""
        a, b = self._pairs
        result = (self._t * p.T).T
        np.add.at(result, b, ((self._q[a] * self._c[b]) * p[a].T).T)
        return result

    def given_over(self, values: npt.NDArray, gone: npt.NDArray[np.bool_]) -> npt.NDArray:
        """Values without those of vertices that are hardly covered, which others have instead.

        Args:
            values: ``(..., num)``, or masks of such.
            gone: Mask of those vertices, ``(num,)``.
        """
        a, b = self._pairs
        on = gone[a]
        a, b = a[on], b[on]
        result = np.where(gone, np.zeros_like(values), values)
        share = BLENDS * (1 - self._c[a]) ** 2 * self._c[b]
        if values.dtype == bool:
            result[..., b] |= values[..., a] & (share > 0)
        else:
            np.add.at(result.T, b, (share * values[..., a]).T)
        return result

    def blended(self, values: Floats) -> Floats:
        """L of values at vertices, ``(num,)``."""
        return self._t * values + self._q * self._sums_of(values)

    def curvature(self, p: Floats) -> Sparse:
        """Σ_a p_a ∂²ĝ_a/∂u²."""
        a, b = self._pairs
        by_c = p * self._by_own_c
        np.add.at(by_c, b, p[a] * self._q[a] * self._g[b])
        by_half = by_c[self.facets] * self._others
        H = self.rays.curvature(self.pressures(p)[self.facets], by_half)
        if not len(a) or not p[a].any():
            return H
        G, K, columns = self._dense(self._slopes, self._by_c)
        weights = np.zeros(self.num)
        np.add.at(weights, b, p[a] * self._q[a])
        hard = self._hard
        weights += p * self._dt
        dS = self._sums_beside(G, K)
        M = (weights[:, None] * K).T @ G + ((p * self._dq)[hard, None] * K[hard]).T @ dS[hard]
        bends = self._ddt * self._g + self._ddq * self._sums_of(self._g)
        M += (0.5 * (p * bends)[hard, None] * K[hard]).T @ K[hard]
        ends = [self._dense_halves(k, columns) for k in range(2)]
        M -= (by_c[:, None] * ends[0]).T @ ends[1]
        return joined(H, _entries(M + M.T, columns, columns))

    @cached_property
    def slips(self) -> Sparse:
        """L T: slips of vertices are L T Δu."""
        return joined(self._own(self._T), self._beside(self._T))

    @cached_property
    def parting(self) -> Sparse:
        """What Δu adds to gaps of points that stay opposite to each other, as :attr:`slips`."""
        T = self._by_vertex(self.rays.slips(across=True))
        return joined(self._own(T), self._beside(T))

    @cached_property
    def _T(self) -> Sparse:
        """T of vertices."""
        return self._by_vertex(self.rays.slips())

    def slip_slopes(self, moved: Floats) -> Sparse:
        """∂ŝ/∂u if Δu moves with u.

        Args:
            moved: Δu by both sides' dofs, all components.
        """
        slopes = self._by_vertex(self.rays.slips(moved))
        if not len(self._hard):
            return self._own(slopes)
        T = self._T
        s = np.bincount(T.i, T.values * moved[T.j], self.num)
        S, K, columns = self._dense(slopes, self._by_c)
        a, b = self._pairs
        rows = np.zeros_like(S)
        np.add.at(rows, a, self._q[a, None] * (self._c[b, None] * S[b] + s[b, None] * K[b]))
        rows += (self._dt * s + self._dq * self._sums_of(s))[:, None] * K
        hard = self._hard
        return joined(self._own(slopes), _entries(rows[hard], hard, columns))

    def slip_curvature(self, q: Floats) -> Sparse:
        """∂((L T)ᵀq)/∂u from tractions, ``(num,)``; it isn't symmetric."""
        H = self.rays.slip_curvature(self.pressures(q)[self.facets])
        a, b = self._pairs
        if not len(a) or not q[a].any():
            return H
        T, K, columns = self._dense(self._T, self._by_c)
        by_a, by_b = q[a] * self._dq[a] * self._c[b], q[a] * self._q[a]
        M = (by_a[:, None] * T[b]).T @ K[a] + (by_b[:, None] * T[b]).T @ K[b]
        M += ((q * self._dt)[:, None] * T).T @ K
        return joined(H, _entries(M, columns, columns))

    @cached_property
    def _hard(self) -> npt.NDArray[np.intp]:
        """Vertices that are covered in part, sorted."""
        return np.unique(self._pairs[0])

    @cached_property
    def _by_own_c(self) -> Floats:
        """∂ĝ/∂c by a vertex' own c."""
        return self._dt * self._g + self._dq * self._sums_of(self._g)

    def _own(self, T: Sparse) -> Sparse:
        """Rows times t."""
        return Sparse(T.i, T.j, T.values * self._t[T.i])

    def _sums(self, halves: Floats) -> Floats:
        """Sums at vertices."""
        return np.bincount(self.facets.ravel(), halves.ravel(), self.num)

    def _sums_of(self, values: Floats) -> Floats:
        """Σ_b c_b values_b beside vertices that are covered in part, 0 elsewhere."""
        a, b = self._pairs
        return np.bincount(a, self._c[b] * values[b], self.num).astype(float)

    def _sums_beside(self, G: Floats, K: Floats) -> Floats:
        """∂S, from ∂g and ∂c, ``(num, num_columns)`` each."""
        a, b = self._pairs
        result = np.zeros_like(G)
        np.add.at(result, a, self._c[b, None] * G[b] + self._g[b, None] * K[b])
        return result

    def _by_vertex(self, halves: Sparse) -> Sparse:
        """Rows of vertices, sums of their halves'."""
        return Sparse(self.facets.ravel()[halves.i].astype(np.int64), halves.j, halves.values)

    def _beside(self, T: Sparse) -> Sparse:
        """Rows q_a Σ_b c_b T_b."""
        a, b = self._pairs
        parts = [Sparse.empty()]
        for row, other in zip(a.tolist(), b.tolist(), strict=True):
            on = T.i == other
            values = self._q[row] * self._c[other] * T.values[on]
            parts.append(Sparse(np.full(on.sum(), row), T.j[on], values))
        return joined(*parts)

    @cached_property
    def _by_c(self) -> Sparse:
        """∂c/∂u of vertices."""
        K = self._by_covered
        return self._by_vertex(Sparse(K.i, K.j, K.values * self._others.ravel()[K.i]))

    @cached_property
    def _near(self) -> npt.NDArray[np.bool_]:
        """Mask of vertices that are covered in part and of those beside them, ``(num,)``."""
        near = np.zeros(self.num, dtype=bool)
        near[self._pairs] = True
        return near

    def _dense(self, *parts: Sparse):
        """Rows of vertices that are covered in part and of those beside them.

        Args:
            parts: Rows of vertices.

        Returns:
            For each of them ``(num, num_columns)``; then the columns.
        """
        on = [self._near[part.i] for part in parts]
        columns = np.unique(np.concatenate([part.j[use] for part, use in zip(parts, on)]))
        found = []
        for part, use in zip(parts, on, strict=True):
            rows = np.zeros((self.num, len(columns)))
            np.add.at(rows, (part.i[use], np.searchsorted(columns, part.j[use])), part.values[use])
            found.append(rows)
        return *found, columns

    def _dense_halves(self, k: int, columns: npt.NDArray) -> Floats:
        """∂c_e/∂u of the halves at one end of edges, by vertex, ``(num, num_columns)``."""
        K = self._by_covered
        vertex = self.facets.ravel()[K.i]
        on = (K.i % 2 == k) & self._near[vertex]
        rows = np.zeros((self.num, len(columns)))
        np.add.at(rows, (vertex[on], np.searchsorted(columns, K.j[on])), K.values[on])
        return rows


def _entries(rows: Floats, i: npt.NDArray, j: npt.NDArray) -> Sparse:
    """A dense matrix with its numbers of rows and columns."""
    a, b = np.nonzero(rows)
    return Sparse(i[a].astype(np.int64), j[b], rows[a, b])
