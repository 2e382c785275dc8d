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

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import basix
from basix.finite_element import FiniteElement

TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])  # a × b = aᵀ TURN b
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


@dataclass(frozen=True)
class Derivatives:
    """Of scalars by nodes on both sides and parameters, one behind the other."""

    value: npt.NDArray[np.float64]
    """``(num,)``."""
    first: npt.NDArray[np.float64]
    """``(num, num_variables)``."""
    second: npt.NDArray[np.float64]
    """``(num, num_variables, num_variables)``."""


def volumes(elements: tuple[FiniteElement, FiniteElement], X, Q, s) -> Derivatives:
    """Volumes of cells, by their base's nodes, their apex' nodes and s₁, s₂, r.

    Args:
        elements: Of the base's and the apex' geometry.
        X: Nodes of the bases' edges, ``(num_cells, num_nodes, 2)``.
        Q: Nodes of the apexes' edges, ``(num_cells, num_apex_nodes, 2)``.
        s: s₁, s₂ and r, ``(num_cells, 3)``.
    """
    num, a, b = len(X), X.shape[1], Q.shape[1]
    origin = X[:, :1]  # differences keep their digits far from the origin
    X, Q = X - origin, Q - origin
    points, weights = basix.make_quadrature(basix.CellType.interval, 2 * (a - 1))
    width = s[:, 1] - s[:, 0]
    at = s[:, :1] + width[:, None] * points[:, 0]
    N, dN, _ = shapes(elements[0], at)  # (cell, point, node)
    dS = width[:, None] * weights
    M, dM, ddM = shapes(elements[1], s[:, 2])  # (cell, node)
    E, dE, ddE = shapes(elements[0], s[:, :2])  # (cell, end, node)
    q, dq, ddq = (np.einsum("ca,cai->ci", m, Q) for m in (M, dM, ddM))
    x, dx = (np.einsum("cpa,cai->cpi", n, X) for n in (N, dN))
    y, dy, ddy = (np.einsum("cea,cai->cei", n, X) for n in (E, dE, ddE))
    to = q[:, None] - x
    first = np.empty((num, 2 * (a + b) + 3))
    nodes, apex = slice(0, 2 * a), slice(2 * a, 2 * (a + b))
    ends, r = slice(2 * (a + b), -1), -1
    sign = np.array((-1.0, 1.0))
    value = 0.5 * (dS * cross(to, dx)).sum(axis=1)
    by = np.einsum("cp,cpa,cpi->cai", dS, N, dx) + np.einsum("cp,cpa,cpi->cai", dS, dN, to)
    first[:, nodes] = (-0.5 * by @ TURN.T).reshape(num, 2 * a)
    chord = y[:, 1] - y[:, 0]
    first[:, apex] = (0.5 * M[:, :, None] * (chord @ TURN.T)[:, None]).reshape(num, 2 * b)
    reach = q[:, None] - y
    first[:, ends] = 0.5 * sign * cross(reach, dy)
    first[:, r] = 0.5 * cross(dq, chord)
    H = np.zeros((num, first.shape[1], first.shape[1]))
    skew = np.einsum("cp,cpa,cpb->cab", dS, N, dN)
    skew = skew - skew.transpose(0, 2, 1)
    H[:, nodes, nodes] = np.einsum("cab,ij->caibj", -0.5 * skew, TURN).reshape(num, 2 * a, 2 * a)
    by = np.einsum("cm,ca,ij->cmiaj", M, E[:, 1] - E[:, 0], 0.5 * TURN)
    H[:, apex, nodes] = by.reshape(num, 2 * b, 2 * a)
    by = np.einsum("ci,ij,ca->caj", dq, 0.5 * TURN, E[:, 1] - E[:, 0])
    H[:, r, nodes] = by.reshape(num, 2 * a)
    by = np.einsum("ca,ij,cj->cai", dM, 0.5 * TURN, chord)
    H[:, r, apex] = by.reshape(num, 2 * b)
    by = E[..., None] * dy[:, :, None] + dE[..., None] * reach[:, :, None]
    by = (-0.5 * sign)[:, None, None] * by @ TURN.T
    H[:, ends, nodes] = by.reshape(num, 2, 2 * a)
    by = np.einsum("cb,cei,e->cebi", M, dy @ TURN.T, 0.5 * sign)
    H[:, ends, apex] = by.reshape(num, 2, 2 * b)
    H[:, r, ends] = 0.5 * sign * cross(dq[:, None], dy)
    H += H.transpose(0, 2, 1)
    H[:, nodes, nodes] /= 2  # was symmetric
    index = np.arange(2 * (a + b), 2 * (a + b) + 2)
    H[:, index, index] = 0.5 * sign * cross(reach, ddy)
    H[:, r, r] = 0.5 * cross(ddq, chord)
    return Derivatives(value, first, H)


def crossings(elements: tuple[FiniteElement, FiniteElement], X0, X1, unknown, s) -> Derivatives:
    """Where rays along Γ1's normals cross: Φ = (x₀(s₀) − x₁(s₁)) · (chord of Γ1's edge) = 0.

    Args:
        elements: Of both sides' geometry.
        X0: Nodes of Γ0's edges, ``(num, num_nodes0, 2)``.
        X1: Nodes of Γ1's edges, ``(num, num_nodes1, 2)``.
        unknown: Side of the parameter that is looked for, ``(num,)``.
        s: Parameters on both sides, and where to start, ``(num, 2)``.

    Returns:
        The parameters that were looked for, by X0 and X1.
    """
    num, a, b = len(X0), X0.shape[1], X1.shape[1]
    origin, s, each = X1[:, :1], s.copy(), np.arange(len(X0))
    X0, X1 = X0 - origin, X1 - origin
    c = X1[:, 1] - X1[:, 0]  # the vertices come first
    for _ in range(NEWTON):
        N, M = shapes(elements[0], s[:, 0]), shapes(elements[1], s[:, 1])
        x0, dx0, ddx0 = (np.einsum("ca,cai->ci", n, X0) for n in N)
        x1, dx1, ddx1 = (np.einsum("ca,cai->ci", m, X1) for m in M)
        phi = ((x0 - x1) * c).sum(axis=1)
        slope = np.where(unknown == 0, (dx0 * c).sum(axis=1), -(dx1 * c).sum(axis=1))
        s[each, unknown] -= phi / slope
        if (np.abs(phi / slope) < 1e-15).all() or (a == 2 and b == 2 and _):
            break
    on0 = (unknown == 0)[:, None]
    chord = np.zeros(b)
    chord[:2] = -1, 1
    by = np.zeros((num, a + b, 2))
    by[:, :a] = N[0][..., None] * c[:, None]
    by[:, a:] = -M[0][..., None] * c[:, None] + chord[:, None] * (x0 - x1)[:, None]
    by = by.reshape(num, 2 * (a + b))
    t = -by / slope[:, None]
    value = s[each, unknown]
    H = np.zeros((num, a + b, 2, a + b, 2))
    for i in (0, 1):
        cross_term = N[0][:, :, None] * chord
        H[:, :a, i, a:, i] = cross_term
        H[:, a:, i, :a, i] = cross_term.transpose(0, 2, 1)
        own = M[0][:, :, None] * chord
        H[:, a:, i, a:, i] = -own - own.transpose(0, 2, 1)
    H = H.reshape(num, 2 * (a + b), 2 * (a + b))
    mixed = np.zeros((num, a + b, 2))
    mixed[:, :a] = np.where(on0, N[1], 0)[..., None] * c[:, None]
    moves = np.where(on0, dx0, -dx1)
    mixed[:, a:] = np.where(on0, 0, -M[1])[..., None] * c[:, None] + chord[:, None] * moves[:, None]
    mixed = mixed.reshape(num, 2 * (a + b))
    bend = np.where(unknown == 0, (ddx0 * c).sum(axis=1), -(ddx1 * c).sum(axis=1))
    H += mixed[:, :, None] * t[:, None] + t[:, :, None] * mixed[:, None]
    H += bend[:, None, None] * t[:, :, None] * t[:, None]
    return Derivatives(value, t, -H / slope[:, None, None])
