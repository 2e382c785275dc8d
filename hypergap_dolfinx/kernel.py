# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""The gap finite element: eqs. (6)–(19) of Giffin (2024), with NumPy arrays alone.

The Jacobian of eq. (6) is :math:`\mathbf J = [\mathbf X; \nabla_\xi\alpha^T]` with
:math:`X_{ij} = \partial x_i/\partial\xi_j`. Both of what the paper needs follow from the cofactor
matrix of :math:`\mathbf X`, in any dimension and without inverting anything:

* eqs. (7)–(10): the spatial part of :math:`d\Sigma` is, up to its sign,
  :math:`\mathbf N = \mathrm{cof}(\mathbf X)\,\nabla_\xi\alpha`, so that
  :math:`\mathbf n\,d\Gamma_\alpha d\alpha = \mathbf N\,d\square` and eq. (12) is its length. The
  sign is chosen such that n points from Γ0 to Γ1.
* eqs. (16)–(17): :math:`\mathbf v = \bar{\mathbf g}^{-1}\nabla_\xi\alpha = \partial\xi/\partial
  \alpha` is the direction in which α grows by one and the tangential position stays:
  :math:`\mathbf v = \mathrm{cof}(\mathbf X)^T\mathbf N/|\mathbf N|^2`. It satisfies
  :math:`(\mathbf I - \mathbf n\mathbf n^T)\mathbf X\mathbf v = 0`, :math:`\nabla_\xi\alpha\cdot
  \mathbf v = 1`. Unlike :math:`\bar{\mathbf g}`, which mixes h² with 1, it is free of scale.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import basix

CHUNK = 8192  # cells at a time: what fits in a cache


class InvertedCellError(RuntimeError):
    """A gap element is turned over: the normal of Γ_α points back to Γ0."""


def cofactor(X: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Cofactor matrices cof(X) = det(X) X⁻ᵀ, also of singular ones.

    Args:
        X: Matrices, ``(..., n, n)`` with n = 2 or 3.

    Returns:
        ``(..., n, n)``.
    """
    if X.shape[-1] == 2:
        cof = np.empty_like(X)
        cof[..., 0, 0], cof[..., 0, 1] = X[..., 1, 1], -X[..., 1, 0]
        cof[..., 1, 0], cof[..., 1, 1] = -X[..., 0, 1], X[..., 0, 0]
        return cof
    a, b, c = X[..., 0], X[..., 1], X[..., 2]
    return np.stack((np.cross(b, c), np.cross(c, a), np.cross(a, b)), axis=-1)


def normal_and_direction(X, dalpha):
    """The vectors N = n dΓ_α dα/d□ (eqs. 7–12) and v = ∂ξ/∂α (eq. 16).

    Args:
        X: ∂x/∂ξ, ``(..., n, n)``.
        dalpha: ∂α/∂ξ, ``(..., n)``.

    Returns:
        N and v, ``(..., n)`` each.
    """
    cof = cofactor(X)
    N = np.einsum("...ij,...j->...i", cof, dalpha)
    v = np.einsum("...ij,...i->...j", cof, N)
    with np.errstate(divide="ignore", invalid="ignore"):  # empty cells are found by their N
        return N, v / np.einsum("...i,...i->...", N, N)[..., None]


@dataclass(frozen=True)
class GapElement:
    """Tables of the gap element on the reference simplex: geometry ψ, field φ, α linear."""

    dpsi: npt.NDArray[np.float64]
    """∂ψ_m/∂ξ_j, ``(num_points, num_geometry_nodes, n)``."""
    phi: npt.NDArray[np.float64]
    """φ_a, ``(num_points, num_nodes)``."""
    dphi: npt.NDArray[np.float64]
    """∂φ_a/∂ξ_j, ``(num_points, num_nodes, n)``."""
    weights: npt.NDArray[np.float64]
    """Quadrature weights, ``(num_points,)``."""

    @classmethod
    def at(cls, geometry, element, points, weights) -> "GapElement":
        """Tabulate basix elements at reference points."""

        def gradients(e):
            return np.ascontiguousarray(e.tabulate(1, points)[1:, :, :, 0].transpose(1, 2, 0))

        phi = element.tabulate(0, points)[0, :, :, 0]
        return cls(gradients(geometry), phi, gradients(element), np.asarray(weights))

    @classmethod
    def with_quadrature(cls, geometry, element, degree: int) -> "GapElement":
        """Tabulate basix elements at the points of a Gauss rule of a given degree."""
        return cls.at(geometry, element, *basix.make_quadrature(element.cell_type, degree))

    @property
    def reference_tensor(self) -> npt.NDArray[np.float64]:
        """∫ ∂φ_a/∂ξ_i ∂φ_b/∂ξ_j d□, ``(n * n, num_nodes * num_nodes)``."""
        T = np.einsum("p,pai,pbj->ijab", self.weights, self.dphi, self.dphi, optimize=True)
        n, nodes = self.dphi.shape[2], self.dphi.shape[1]
        return T.reshape(n * n, nodes * nodes)


def geometry_at_points(element: GapElement, x, alpha):
    """N and v of cells at an element's points.

    Args:
        element: The tables.
        x: Geometry nodes, ``(num_cells, num_geometry_nodes, n)``.
        alpha: α at the vertices, ``(num_cells, n + 1)``.

    Returns:
        N and v, ``(num_cells, num_points, n)`` each.
    """
    X = np.einsum("cmi,pmj->cpij", x, element.dpsi, optimize=True)
    dalpha = (alpha[:, 1:] - alpha[:, :1])[:, None]  # (cell, 1, n)
    return normal_and_direction(X, dalpha)


def alpha_derivatives(element: GapElement, v):
    """∂φ_a/∂α at an element's points, eq. (19): ``(num_cells, num_points, num_nodes)``."""
    return np.einsum("paj,cpj->cpa", element.dphi, v, optimize=True)


def affine_gap_matrices(element: GapElement, x, alpha, normal):
    """G_ab of cells with constant J: one contraction with a reference tensor.

    Args:
        element: Tables with a rule exact to degree 2 (k − 1).
        x: Vertices, ``(num_cells, n + 1, n)``.
        alpha: α at the vertices, ``(num_cells, n + 1)``.
        normal: Reference normals from Γ0 to Γ1, ``(num_cells, n)``.

    Returns:
        ``(num_cells, num_nodes, num_nodes)``.

    Raises:
        InvertedCellError: N points against the reference normal.
    """
    T = element.reference_tensor
    nodes = element.phi.shape[1]
    G = np.empty((len(x), nodes * nodes))
    for start in range(0, len(x), CHUNK):
        part = slice(start, start + CHUNK)
        X = (x[part, 1:] - x[part, :1]).transpose(0, 2, 1)
        N, v = normal_and_direction(X, alpha[part, 1:] - alpha[part, :1])
        _check_orientation(N, normal[part], x[part])
        vv = np.linalg.norm(N, axis=1)[:, None, None] * v[:, :, None] * v[:, None, :]
        np.matmul(vv.reshape(len(vv), -1), T, out=G[part])
    return G.reshape(-1, nodes, nodes)


def curved_gap_matrices(element: GapElement, x, alpha, normal):
    """G_ab = ∫ ∂φ_a/∂α ∂φ_b/∂α √det ḡ d□ (eqs. 13 and 19) by quadrature.

    Args:
        element: Tables at the points of a Gauss rule.
        x: Geometry nodes, ``(num_cells, num_geometry_nodes, n)``.
        alpha: α at the vertices, ``(num_cells, n + 1)``.
        normal: Reference normals from Γ0 to Γ1, ``(num_cells, n)``.

    Returns:
        ``(num_cells, num_nodes, num_nodes)``.

    Raises:
        InvertedCellError: N points against the reference normal at a point.
    """
    nodes = element.phi.shape[1]
    G = np.empty((len(x), nodes, nodes))
    for start in range(0, len(x), CHUNK):
        part = slice(start, start + CHUNK)
        N, v = geometry_at_points(element, x[part], alpha[part])
        _check_orientation(N, normal[part, None], x[part])
        dphi = alpha_derivatives(element, v)  # (cell, point, node)
        weights = element.weights * np.linalg.norm(N, axis=2)
        np.matmul((dphi * weights[..., None]).transpose(0, 2, 1), dphi, out=G[part])
    return G


def _check_orientation(N, normal, x):
    """The length in eq. (12) hides the sign of dΣ; look at it before it is lost."""
    sign = np.einsum("...i,...i->...", N, np.broadcast_to(normal, N.shape))
    wrong = ~(sign > 0) if sign.ndim == 1 else ~(sign > 0).all(axis=1)
    if wrong.any():
        raise InvertedCellError(
            f"{wrong.sum()} gap elements are inverted or empty, the first at "
            f"{x[wrong.argmax()].mean(axis=0)}: Γ0 and Γ1 differ too much there; refine the "
            "coarser side or make the two surfaces closer in shape."
        )
