# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""The weighted gap of fans in the plane, and its derivatives. NumPy alone: no MPI, no PETSc.

A cell between a piece of an edge, :math:`\mathbf x(s)` from :math:`s_1` to :math:`s_2`, and an apex
:math:`\mathbf q(r)` on the other side has the volume

.. math:: g = \tfrac12 \int_{s_1}^{s_2} (\mathbf q - \mathbf x) \times \mathbf x' \,ds,

which is a polynomial of the edge's nodes, the apex' nodes and the parameters. Those move with the
bodies where rays cross edges; their derivatives follow from :math:`\Phi = 0` there.
"""

from functools import cache, cached_property

import numpy as np
import numpy.typing as npt

import basix
from basix.finite_element import FiniteElement

TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])  # a × b = aᵀ TURN b
SIGN = np.array((-1.0, 1.0))  # of a base's ends
NEWTON = 8  # steps to where a ray meets a curved edge: round-off after 3 or 4


def shapes(element: FiniteElement, s) -> npt.NDArray[np.float64]:
    """Shape functions and two derivatives, ``(3, *s.shape, num_nodes)``."""
    if not s.size:
        return np.zeros((3, *s.shape, element.dim))
    values = element.tabulate(2, np.ascontiguousarray(s.reshape(-1, 1)))[..., 0]
    return values.reshape(3, *s.shape, -1)


def cross(a, b) -> npt.NDArray[np.float64]:
    """A × b in the plane."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


class Volumes:
    """Volumes of cells, by their base's nodes, their apex' nodes and s₁, s₂, r, in this order."""

    def __init__(self, elements: tuple[FiniteElement, FiniteElement], X, Q, s):
        """Look up shape functions.

        Args:
            elements: Of the base's and the apex' geometry.
            X: Nodes of the bases' edges, ``(num_cells, num_nodes, 2)``.
            Q: Nodes of the apexes' edges, ``(num_cells, num_apex_nodes, 2)``.
            s: s₁, s₂ and r, ``(num_cells, 3)``.
        """
        origin = X[:, :1]  # differences keep their digits far from the origin
        X, Q = X - origin, Q - origin
        points, weights = interval_rule(2 * (X.shape[1] - 1))
        width = s[:, 1:2] - s[:, :1]
        self._dS = width * weights
        # At both ends of the base, then at the rule's points
        N = shapes(elements[0], np.hstack((s[:, :2], s[:, :1] + width * points)))
        self._N, self._x = N, np.einsum("dcpa,cai->dcpi", N, X)
        self._M = shapes(elements[1], s[:, 2])
        self._q = np.einsum("dca,cai->dci", self._M, Q)
        self.chord = self._x[0, :, 1] - self._x[0, :, 0]
        """From end to end of the base, ``(num_cells, 2)``."""
        num, a, b = len(X), X.shape[1], Q.shape[1]
        self._shape = num, a, b
        self._nodes, self._apex = slice(0, 2 * a), slice(2 * a, 2 * (a + b))
        self._s, self._r = slice(2 * (a + b), -1), -1

    @property
    def _reach(self) -> npt.NDArray[np.float64]:
        """From the base's ends and points to the apex."""
        return self._q[0][:, None] - self._x[0]

    @cached_property
    def value(self) -> npt.NDArray[np.float64]:
        """``(num_cells,)``."""
        return 0.5 * (self._dS * cross(self._reach[:, 2:], self._x[1, :, 2:])).sum(axis=1)

    @cached_property
    def first(self) -> npt.NDArray[np.float64]:
        """Derivatives, ``(num_cells, num_variables)``."""
        num, a, b = self._shape
        first = np.empty((num, 2 * (a + b) + 3))
        reach, (N, dN, _), (_, dx, _) = self._reach, self._N, self._x
        by = np.einsum("cp,cpa,cpi->cai", self._dS, N[:, 2:], dx[:, 2:])
        by += np.einsum("cp,cpa,cpi->cai", self._dS, dN[:, 2:], reach[:, 2:])
        first[:, self._nodes] = (-0.5 * by @ TURN.T).reshape(num, -1)
        by = 0.5 * self._M[0][:, :, None] * (self.chord @ TURN.T)[:, None]
        first[:, self._apex] = by.reshape(num, -1)
        first[:, self._s] = 0.5 * SIGN * cross(reach[:, :2], dx[:, :2])
        first[:, self._r] = 0.5 * cross(self._q[1], self.chord)
        return first

    @cached_property
    def second(self) -> npt.NDArray[np.float64]:
        """Second derivatives, ``(num_cells, num_variables, num_variables)``."""
        num, a, b = self._shape
        nodes, apex, ends, r = self._nodes, self._apex, self._s, self._r
        (N, dN, _), (M, dM, _), (_, dq, ddq) = self._N, self._M, self._q
        reach, (_, dy, ddy) = self._reach[:, :2], self._x[:, :, :2]
        E, dE = N[:, :2], dN[:, :2]
        H = np.zeros((num, 2 * (a + b) + 3, 2 * (a + b) + 3))
        skew = np.einsum("cp,cpa,cpb->cab", self._dS, N[:, 2:], dN[:, 2:])
        skew = skew - skew.transpose(0, 2, 1)
        by = np.einsum("cab,ij->caibj", -0.5 * skew, TURN)
        H[:, nodes, nodes] = by.reshape(num, 2 * a, 2 * a) / 2  # symmetric: it is added twice
        by = np.einsum("cm,ca,ij->cmiaj", M, E[:, 1] - E[:, 0], 0.5 * TURN)
        H[:, apex, nodes] = by.reshape(num, 2 * b, 2 * a)
        by = np.einsum("ci,ij,ca->caj", dq, 0.5 * TURN, E[:, 1] - E[:, 0])
        H[:, r, nodes] = by.reshape(num, 2 * a)
        by = np.einsum("ca,ij,cj->cai", dM, 0.5 * TURN, self.chord)
        H[:, r, apex] = by.reshape(num, 2 * b)
        by = E[..., None] * dy[:, :, None] + dE[..., None] * reach[:, :, None]
        by = (-0.5 * SIGN)[:, None, None] * by @ TURN.T
        H[:, ends, nodes] = by.reshape(num, 2, 2 * a)
        by = np.einsum("cb,cei,e->cebi", M, dy @ TURN.T, 0.5 * SIGN)
        H[:, ends, apex] = by.reshape(num, 2, 2 * b)
        H[:, r, ends] = 0.5 * SIGN * cross(dq[:, None], dy)
        H += H.transpose(0, 2, 1)
        index = np.arange(2 * (a + b), 2 * (a + b) + 2)
        H[:, index, index] = 0.5 * SIGN * cross(reach, ddy)
        H[:, r, r] = 0.5 * cross(ddq, self.chord)
        return H


@cache
def interval_rule(degree: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Points and weights between 0 and 1."""
    points, weights = basix.make_quadrature(basix.CellType.interval, degree)
    return points[:, 0], weights


class Crossings:
    """Where rays along Γ1's normals cross: Φ = (x₀(s₀) − x₁(s₁)) · (chord of Γ1's edge) = 0."""

    def __init__(self, elements: tuple[FiniteElement, FiniteElement], X0, X1, unknown, s):
        """Find them.

        Args:
            elements: Of both sides' geometry.
            X0: Nodes of Γ0's edges, ``(num, num_nodes0, 2)``.
            X1: Nodes of Γ1's edges, ``(num, num_nodes1, 2)``.
            unknown: Side of the parameter that is looked for, ``(num,)``.
            s: Parameters on both sides, and where to start, ``(num, 2)``.
        """
        a, b = X0.shape[1], X1.shape[1]
        origin, s, each = X1[:, :1], s.copy(), np.arange(len(X0))
        X0, X1 = X0 - origin, X1 - origin
        c = X1[:, 1] - X1[:, 0]  # the vertices come first
        on0 = unknown == 0
        for _ in range(NEWTON):
            N, M = shapes(elements[0], s[:, 0]), shapes(elements[1], s[:, 1])
            x0, x1 = np.einsum("dca,cai->dci", N, X0), np.einsum("dca,cai->dci", M, X1)
            moves = np.where(on0[:, None], x0[1], -x1[1])
            phi, slope = (((x0[0] - x1[0]) * c).sum(axis=1), (moves * c).sum(axis=1))
            step = phi / slope
            s[each, unknown] -= step
            if (np.abs(step) < 1e-15).all() or (a == 2 and b == 2 and _):
                break
        self.value: npt.NDArray[np.float64] = s[each, unknown]
        """The parameters that were looked for, ``(num,)``."""
        chord = np.zeros(b)
        chord[:2] = -1, 1
        by = np.empty((len(X0), a + b, 2))
        by[:, :a] = N[0][..., None] * c[:, None]
        by[:, a:] = -M[0][..., None] * c[:, None] + chord[:, None] * (x0[0] - x1[0])[:, None]
        self.first: npt.NDArray[np.float64] = by.reshape(len(X0), -1) / -slope[:, None]
        """Derivatives by X0 and X1, ``(num, num_variables)``."""
        self._at = on0, N, M, chord, c, moves, slope, np.where(on0[:, None], x0[2], -x1[2])

    @cached_property
    def second(self) -> npt.NDArray[np.float64]:
        """Second derivatives, ``(num, num_variables, num_variables)``."""
        on0, N, M, chord, c, moves, slope, bends = self._at
        t, (num, a), b = self.first, N[0].shape, len(chord)
        H = np.zeros((num, a + b, 2, a + b, 2))
        across = N[0][:, :, None] * chord
        own = M[0][:, :, None] * chord
        for i in (0, 1):
            H[:, :a, i, a:, i] = across
            H[:, a:, i, :a, i] = across.transpose(0, 2, 1)
            H[:, a:, i, a:, i] = -own - own.transpose(0, 2, 1)
        H = H.reshape(num, 2 * (a + b), 2 * (a + b))
        mixed = np.zeros((num, a + b, 2))
        mixed[:, :a] = (on0[:, None] * N[1])[..., None] * c[:, None]
        mixed[:, a:] = -(~on0[:, None] * M[1])[..., None] * c[:, None]
        mixed[:, a:] += chord[:, None] * moves[:, None]
        twice = mixed.reshape(num, -1)[:, :, None] * t[:, None]
        H += twice + twice.transpose(0, 2, 1)
        H += (bends * c).sum(axis=1)[:, None, None] * t[:, :, None] * t[:, None]
        return H / -slope[:, None, None]
