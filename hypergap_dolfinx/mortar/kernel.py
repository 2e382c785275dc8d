# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The gap finite element: eqs. (6)–(19) of Giffin (2024), with NumPy arrays alone.

The Jacobian of eq. (6) is :math:`\mathbf J = [\mathbf X; \nabla_\xi\alpha^T]` with
:math:`X_{ij} = \partial x_i/\partial\xi_j`. Both quantities needed follow from the
cofactor matrix of :math:`\mathbf X`, in any dimension and without an inverse:

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
from functools import cache, cached_property

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.errors import InvertedCellError
from hypergap_dolfinx.mortar.tolerances import ENOUGH


def cofactor(X: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Cofactor matrices cof(X) = det(X) X⁻ᵀ, also of singular matrices.

    Args:
        X: Matrices, ``(..., n, n)`` with n = 2 or 3.

    Returns:
        ``(..., n, n)``.
    """
    cof = np.empty_like(X)  # in the memory layout of X
    if X.shape[-1] == 2:
        cof[..., 0, 0], cof[..., 0, 1] = X[..., 1, 1], -X[..., 1, 0]
        cof[..., 1, 0], cof[..., 1, 1] = -X[..., 0, 1], X[..., 0, 0]
        return cof
    for i in range(3):
        k, m = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            p, q = (j + 1) % 3, (j + 2) % 3
            cof[..., i, j] = X[..., k, p] * X[..., m, q] - X[..., k, q] * X[..., m, p]
    return cof


def normal_and_direction(X, dalpha):
    """The vectors N = n dΓ_α dα/d□ (eqs. 7–12) and v = ∂ξ/∂α (eq. 16).

    Args:
        X: ∂x/∂ξ, ``(..., n, n)``.
        dalpha: ∂α/∂ξ, ``(..., n)``.

    Returns:
        N and v, ``(..., n)`` each.
    """
    cof, n = cofactor(X), X.shape[-1]
    N, v = (np.empty_like(X[..., 0]) for _ in range(2))
    for i in range(n):  # products of whole arrays: einsum is slow on axes this short
        N[..., i] = sum(cof[..., i, j] * dalpha[..., j] for j in range(n))
    with np.errstate(divide="ignore", invalid="ignore"):  # empty cells are found by their N
        inverse = 1 / sum(N[..., i] ** 2 for i in range(n))
        for j in range(n):
            v[..., j] = sum(cof[..., i, j] * N[..., i] for i in range(n)) * inverse
    return N, v


def curved_rule(dim: int, degree: int, geometry: int) -> int:
    """Degree of the Gauss rule for curved cells, from the degrees of φ_a and of the geometry."""
    full = 2 * (degree + geometry)
    return full if dim == 2 else min(full, max(ENOUGH, 2 * degree + 2))


@dataclass(frozen=True)
class GapElement:
    """Tables of the gap element on the reference simplex: geometry ψ, field φ, α linear."""

    psi: npt.NDArray[np.float64]
    """ψ_m, ``(num_points, num_geometry_nodes)``."""
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

        psi, phi = (e.tabulate(0, points)[0, :, :, 0] for e in (geometry, element))
        return cls(psi, gradients(geometry), phi, gradients(element), np.asarray(weights))

    @classmethod
    @cache
    def with_quadrature(cls, geometry, element, degree: int) -> "GapElement":
        """Tabulate basix elements at the points of a Gauss rule of a given degree."""
        return cls.at(geometry, element, *basix.make_quadrature(element.cell_type, degree))

    @cached_property
    def reference_tensors(self) -> npt.NDArray[np.float64]:
        """∂φ_a/∂ξ_i ∂φ_b/∂ξ_j times the weight at each point, its symmetric part in i and j.

        Upper triangles of both pairs of indices, i ≤ j and a ≤ b: the parts for j < i are added to
        those for i < j. ``(num_points, n (n + 1) / 2, num_nodes (num_nodes + 1) / 2)``.
        """
        T = np.einsum("p,pai,pbj->pijab", self.weights, self.dphi, self.dphi, optimize=True)
        n, nodes = self.dphi.shape[2], self.dphi.shape[1]
        i, j = np.triu_indices(n)
        T = T[:, i, j] + np.where(i < j, 1.0, 0.0)[:, None, None] * T[:, j, i]
        a, b = np.triu_indices(nodes)
        return T[:, :, a, b]


def jacobians(element: GapElement, x):
    """∂x/∂ξ of cells at an element's points, ``(num_cells, num_points, n, n)``.

    Args:
        element: The tables.
        x: Geometry nodes, ``(num_cells, num_geometry_nodes, n)``.
    """
    # From the first node on: derivatives of basis functions add up to zero but for round-off
    return np.einsum("cmi,pmj->cpij", x - x[:, :1], element.dpsi, optimize=True)


def geometry_at_points(element: GapElement, x, alpha):
    """N and v of cells at an element's points.

    Args:
        element: The tables.
        x: Geometry nodes, ``(num_cells, num_geometry_nodes, n)``.
        alpha: α at the vertices, ``(num_cells, n + 1)``.

    Returns:
        N and v, ``(num_cells, num_points, n)`` each.
    """
    X = jacobians(element, x)
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
    n = x.shape[2]
    edges = np.hstack((-np.ones((n, 1)), np.eye(n)))[None]  # ∂ψ_m/∂ξ_j, (1, j, m)
    T = element.reference_tensors.sum(axis=0, keepdims=True)
    return _contract(edges, T, x, alpha, normal)


def curved_gap_matrices(element: GapElement, x, alpha, normal, arc=None):
    """G_ab = ∫ ∂φ_a/∂α ∂φ_b/∂α √det ḡ d□ (eqs. 13 and 19) by quadrature.

    Args:
        element: Tables at the points of a Gauss rule.
        x: Geometry nodes, ``(num_cells, num_geometry_nodes, n)``.
        alpha: α at the vertices, ``(num_cells, n + 1)``.
        normal: Reference normals from Γ0 to Γ1, ``(num_cells, n)``.
        arc: Factor of areas at the points, ``(num_cells, num_points)``; 1 if not given.

    Returns:
        ``(num_cells, num_nodes, num_nodes)``.

    Raises:
        InvertedCellError: N points against the reference normal at a point.
    """
    dpsi = element.dpsi.transpose(0, 2, 1)
    return _contract(dpsi, element.reference_tensors, x, alpha, normal, arc)


def _contract(dpsi, T, x, alpha, normal, arc=None):
    """G_ab = Σ_p Σ_ij (|N| v_i v_j)_p T_pijab, as one product of matrices for many cells.

    With ∂ψ_m/∂ξ_j at points, ``(num_points, n, num_geometry_nodes)``, and the
    :attr:`~GapElement.reference_tensors` T there.
    """
    num_points, n, num_geometry = dpsi.shape
    nodes = int(np.sqrt(2 * T.shape[2]))
    dpsi = np.ascontiguousarray(dpsi.transpose(1, 0, 2)).reshape(-1, num_geometry)
    T = T.transpose(1, 0, 2).reshape(-1, T.shape[2])  # (pair of i j, point), (pair of a b)
    upper = np.zeros((nodes, nodes), dtype=np.intp)
    upper[np.triu_indices(nodes)] = np.arange(T.shape[1])
    pair = np.maximum(upper, upper.T).ravel()
    G = np.empty((len(x), nodes * nodes))
    size = max(8192 // num_points, 64)  # cells at a time: their arrays fit in a cache
    for start in range(0, len(x), size):
        part = slice(start, start + size)
        x_part = x[part] - x[part, :1]  # basis functions' derivatives add up to round-off, not to 0
        xs = np.ascontiguousarray(x_part.transpose(2, 1, 0))  # (i, m, cell): long axis last
        X = (dpsi @ xs).reshape(n, n, num_points, -1)  # (i, j, point, cell)
        vertices = alpha[part].T
        N, v = normal_and_direction(np.moveaxis(X, (0, 1), (2, 3)), (vertices[1:] - vertices[0]).T)
        _check_orientation(N, normal[part], x[part])
        length = np.sqrt(sum(N[..., i] ** 2 for i in range(n)))
        length = length if arc is None else length * arc[part].T
        vv = np.stack([length * v[..., i] * v[..., j] for i in range(n) for j in range(i, n)])
        np.take(vv.reshape(len(T), -1).T @ T, pair, axis=1, out=G[part])
    return G.reshape(-1, nodes, nodes)


def _check_orientation(N, normal, x):
    """Raise if N, ``(num_points, num_cells, n)``, opposes the normal: eq. (12) hides its sign."""
    sign = sum(N[..., i] * normal[..., i] for i in range(normal.shape[-1]))
    wrong = ~(sign > 0).all(axis=0)
    if wrong.any():
        raise InvertedCellError(
            f"{wrong.sum()} gap elements are inverted or empty, the first at "
            f"{spot(x[wrong.argmax()])}: Γ0 and Γ1 differ too much there; refine the "
            "coarser side or make the two surfaces closer in shape."
        )
