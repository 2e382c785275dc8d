# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""The weighted gap: the volume between two bodies as a weight on Γ1 sees it, and its derivatives.

In a gap cell :math:`\mathbf N\cdot\mathbf{Xv} = \det\mathbf X`, since :math:`\mathbf{Xv}` is
parallel to the normal. So with weights :math:`w_a`, of which the sum is 1,

.. math:: g_a = \int_\square w_a \det\mathbf X\,d\xi, \qquad m_a = \int_\square w_a|\mathbf N|\,d\xi

are a volume and an area, and :math:`g_a / m_a` is a length: positive where the bodies are apart.
:math:`\det\mathbf X` is a polynomial of the nodes, of which the derivatives are cofactors.
NumPy alone: no MPI, no PETSc.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.kernel import GapElement, cofactor, normal_and_direction

CYCLE = np.array((1, 2, 0))


@dataclass(frozen=True)
class WeightedCells:
    """The gap of single cells, weighted for each of their vertices."""

    g: npt.NDArray[np.float64]
    """Volume, ``(num_cells, n + 1)``."""
    m: npt.NDArray[np.float64]
    """Area, ``(num_cells, n + 1)``."""
    dg: npt.NDArray[np.float64]
    """∂g/∂x at the geometry nodes, ``(num_cells, n + 1, num_geometry_nodes, n)``."""


def jacobians(element: GapElement, x) -> npt.NDArray[np.float64]:
    """∂x/∂ξ of cells at an element's points, ``(num_cells, num_points, n, n)``."""
    num, nodes, n = x.shape
    steps = (x - x[:, :1]).transpose(0, 2, 1).reshape(-1, nodes)
    table = element.dpsi.transpose(1, 0, 2).reshape(nodes, -1)  # (m, p j)
    return (steps @ table).reshape(num, n, len(element.dpsi), n).swapaxes(1, 2)


def vertex_weights(element: GapElement, x, alpha) -> npt.NDArray[np.float64]:
    """Weights of the vertices at an element's points: α ∂ψ/∂α (eq. 20), none negative, of sum 1.

    Where the foot of the point opposite lies in the cell's base the ∂ψ/∂α are the foot's
    barycentric coordinates; beside it some are negative, which makes areas of either sign. These
    are clipped, and the sum of all is made 1 again.

    Args:
        element: The tables.
        x: Geometry nodes, ``(num_cells, num_geometry_nodes, n)``.
        alpha: α at the vertices, ``(num_cells, n + 1)``.

    Returns:
        ``(num_cells, num_points, n + 1)``.
    """
    n = x.shape[2]
    dalpha = (alpha[:, 1:] - alpha[:, :1])[:, None]
    _, v = normal_and_direction(jacobians(element, x), dalpha)
    barycentric = np.vstack((-np.ones(n), np.eye(n)))  # ∂ψ_b/∂ξ_j
    w = np.maximum(alpha[:, None] * (v @ barycentric.T), 0)
    w[~np.isfinite(w)] = 0
    return w / np.maximum(w.sum(axis=2, keepdims=True), 1e-300)


def weigh(element: GapElement, x, alpha, w) -> WeightedCells:
    """The weighted gap of cells and its first derivatives.

    Args:
        element: The tables.
        x: Geometry nodes, ``(num_cells, num_geometry_nodes, n)``.
        alpha: α at the vertices, ``(num_cells, n + 1)``.
        w: Weights at the points, ``(num_cells, num_points, n + 1)``.
    """
    X = jacobians(element, x)
    cof = cofactor(X)
    dalpha = alpha[:, 1:] - alpha[:, :1]
    area = np.linalg.norm(np.einsum("cpij,cj->cpi", cof, dalpha), axis=2)
    volume = np.einsum("cpj,cpj->cp", X[..., 0, :], cof[..., 0, :])
    weighted = (element.weights[None, :, None] * w).swapaxes(1, 2)  # (c, b, p)
    num, vertices, points = weighted.shape
    n, nodes = x.shape[2], x.shape[1]
    products = weighted[:, :, None, :, None] * cof.swapaxes(1, 2)[:, None]  # (c, b, i, p, j)
    table = element.dpsi.swapaxes(1, 2).reshape(points * n, nodes)
    dg = (products.reshape(-1, points * n) @ table).reshape(num, vertices, n, nodes)
    return WeightedCells(
        g=(weighted @ volume[..., None])[..., 0],
        m=(weighted @ area[..., None])[..., 0],
        dg=dg.swapaxes(2, 3),
    )


def second_derivatives(element: GapElement, x, pressure) -> npt.NDArray[np.float64]:
    """∂²/∂x² of ∫ p det X dξ of cells in space.

    Args:
        element: The tables.
        x: Geometry nodes, ``(num_cells, num_geometry_nodes, n)``.
        pressure: p at the points, ``(num_cells, num_points)``.

    Returns:
        ``(num_cells, num_geometry_nodes, n, num_geometry_nodes, n)``.
    """
    weighted = element.weights * pressure
    # ∂cof_ij/∂X_kl = ε_ikr ε_jls X_rs, antisymmetric in i and k: three blocks, each one product
    d = element.dpsi  # (p, m, j)
    cross = d[:, :, None, CYCLE] * d[:, None, :, CYCLE[[1, 2, 0]]]
    table = (cross - cross.transpose(0, 2, 1, 3)).transpose(0, 3, 1, 2)  # (p, s, m, q)
    num, nodes = len(x), d.shape[1]
    X = jacobians(element, x) * weighted[..., None, None]  # (c, p, r, s)
    blocks = X.transpose(0, 2, 1, 3).reshape(3 * num, 3 * len(d)) @ table.reshape(-1, nodes**2)
    blocks = blocks.reshape(num, 3, nodes, nodes)
    H = np.zeros((num, nodes, 3, nodes, 3))
    for r in range(3):
        i, k = (r + 1) % 3, (r + 2) % 3
        H[:, :, i, :, k], H[:, :, k, :, i] = blocks[:, r], -blocks[:, r]
    return H
