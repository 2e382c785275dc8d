# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""The weighted slip of fans in the plane, and its derivatives. NumPy alone: no MPI, no PETSc.

A cell between a piece of an edge, :math:`\mathbf x(s)`, and an apex :math:`\mathbf q` on the other
side (:mod:`~hypergap_dolfinx.gap.fans`) makes of what moves along both, :math:`\Delta\mathbf u`,

.. math:: \tfrac12 \int_{s_1}^{s_2} \mathbf x'\cdot\Bigl(\Delta\mathbf u(\mathbf q)
   - \Delta\mathbf u(s) - \tau\,\Delta\mathbf u'(s)\Bigr) ds, \qquad
   \tau = \frac{(\mathbf q - \mathbf x)\cdot\mathbf x'}{\mathbf x'\cdot\mathbf x'},

the motion of the apex along the edge's tangent against that of the edge below it. It is nothing for
a translation, the cell's volume for a rotation, and nothing if :math:`\Delta\mathbf u` is where the
bodies are: with :math:`\Delta\mathbf u = \mathbf x - \mathbf x_n` slip is that of material points
that are opposite to each other now, and a rotation of closed bodies, however large, is none.
"""

import numpy as np
import numpy.typing as npt

from basix.finite_element import FiniteElement
from hypergap_dolfinx.gap.fans import interval_rule, shapes

STEP = 1e-30  # imaginary: derivatives without a difference


def slips(elements: tuple[FiniteElement, FiniteElement], X, Q, s) -> npt.NDArray[np.float64]:
    """What cells make of motions of their base's nodes and their apex' nodes.

    Args:
        elements: Of the base's and the apex' geometry.
        X: Nodes of the bases' edges, ``(num_cells, num_nodes, 2)``.
        Q: Nodes of the apexes' edges, ``(num_cells, num_apex_nodes, 2)``.
        s: s₁, s₂ and r, ``(num_cells, 3)``.

    Returns:
        ``(num_cells, 2 (num_nodes + num_apex_nodes))``.
    """
    origin = X[:, :1].real  # differences keep their digits far from the origin
    X, Q = X - origin, Q - origin
    points, weights = interval_rule(3 * X.shape[1] - 5)
    width = s[:, 1] - s[:, 0]
    N, dN = _shapes(elements[0], s[:, :1] + width[:, None] * points)
    M, _ = _shapes(elements[1], s[:, 2])
    q = np.einsum("ca,cai->ci", M, Q)
    x, dx = (np.einsum("cpa,cai->cpi", n, X) for n in (N, dN))
    tau = np.einsum("cpi,cpi->cp", q[:, None] - x, dx) / np.einsum("cpi,cpi->cp", dx, dx)
    along = 0.5 * (width[:, None] * weights)[..., None] * dx
    base = -np.einsum("cpa,cpi->cai", N + tau[..., None] * dN, along)
    apex = M[:, :, None] * along.sum(axis=1)[:, None]
    return np.hstack((base, apex)).reshape(len(X), 2 * (X.shape[1] + Q.shape[1]))


def slopes(elements: tuple[FiniteElement, FiniteElement], X, Q, s) -> npt.NDArray[np.float64]:
    """Derivatives of :func:`slips` by the base's nodes, the apex' nodes and s₁, s₂, r.

    Args:
        elements: As for :func:`slips`, as all others.
        X: Nodes of the bases' edges.
        Q: Nodes of the apexes' edges.
        s: Parameters.

    Returns:
        ``(num_cells, num, num + 3)`` with num = 2 (num_nodes + num_apex_nodes).
    """
    num, split = len(X), (2 * X.shape[1], 2 * (X.shape[1] + Q.shape[1]))
    flat = np.hstack((X.reshape(num, -1), Q.reshape(num, -1), s))
    # All cells once for each variable
    moved = flat + 1j * STEP * np.eye(flat.shape[1])[:, None]  # (variable, cell, variable)
    nodes, apex, at = np.split(moved.reshape(-1, flat.shape[1]), split, axis=1)
    found = slips(elements, nodes.reshape(-1, *X.shape[1:]), apex.reshape(-1, *Q.shape[1:]), at)
    return found.imag.reshape(-1, num, split[1]).transpose(1, 2, 0) / STEP


def _shapes(element: FiniteElement, s) -> tuple[npt.NDArray, npt.NDArray]:
    """Shape functions and their derivatives at parameters, also at complex ones."""
    N, dN, ddN = shapes(element, s.real)
    if not np.iscomplexobj(s):
        return N, dN
    step = 1j * s.imag[..., None]
    return N + step * dN, dN + step * ddN
