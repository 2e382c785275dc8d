# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Functions of quadrilateral facets on triangles.

A quadrilateral's functions of degree k have terms up to :math:`s^k t^k`, polynomials of degree 2k
on its two halves, which make Σ's cells costly. On four triangles that meet at its middle, degree
m ≥ k is enough to keep all that a tie needs: polynomials up to degree m, continuity with the next
facet, and the moments

.. math:: \int_{\square} (I v) \, p \, ds \, dt = \int_{\square} v \, p \, ds \, dt
   \qquad\text{for all } p \in P_{\max(1, k - 1)},

so that loads of tractions of degree k − 1 are those on the facet (of constant ones also where dΓ is
linear, in distorted planar quadrilaterals). Nodes on the facet's edges and at its own dofs
interpolate. The other inner nodes interpolate up to the smallest change that restores the moments.
Interpolation alone fails the linear patch test: with degree 2 the stress is 3 % off.
"""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.surface.tolerances import SAME_NODE
from hypergap_dolfinx.surface.trace import tabulate

SQUARE_CORNERS = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
QUARTERS = (
    np.vstack((SQUARE_CORNERS, (0.5, 0.5))),
    np.array([(0, 1, 4), (1, 3, 4), (3, 2, 4), (2, 0, 4)]),
)
"""Points of the reference facet, and the four triangles of a whole facet between them."""
HALVES = SQUARE_CORNERS, np.array([[(0, 1, 3), (0, 3, 2)], [(0, 1, 2), (1, 3, 2)]])
"""The same with two triangles, for facets that are cut: along one diagonal, along the other."""


def on_triangles(
    element: basix.finite_element.FiniteElement,
    nodes: basix.finite_element.FiniteElement,
    X: npt.NDArray[np.float64],
) -> npt.NDArray[np.float64]:
    """I v of a facet's basis functions v at points, ``(num_points, num_dofs)``.

    Args:
        element: The facet's Lagrange element, of degree k.
        nodes: Lagrange element of the triangles, of degree m ≥ k; the same functions if m ≥ 2k.
        X: Points of the reference facet, ``(num_points, 2)``.
    """
    if nodes.degree >= 2 * element.degree:
        return tabulate(element, X)
    x, y = X.T - 0.5
    triangle = np.argmax((-y, x, y, -x), axis=0)  # in the order of QUARTERS
    corners = QUARTERS[0][QUARTERS[1]]
    J = corners[:, 1:] - corners[:, :1]
    xi = np.einsum("pi,pij->pj", X - corners[triangle, 0], np.linalg.inv(J)[triangle])
    return np.einsum("pa,pab->pb", tabulate(nodes, xi), _rows(element, nodes)[triangle])


@lru_cache(maxsize=64)
def _rows(
    element: basix.finite_element.FiniteElement, nodes: basix.finite_element.FiniteElement
) -> npt.NDArray[np.float64]:
    """I v of the facet's basis functions at the triangles' nodes, ``(4, num_nodes, num_dofs)``."""
    k, m = element.degree, nodes.degree
    exponents = np.indices((k + 1, k + 1)).reshape(2, -1)
    exponents = exponents[:, exponents.sum(axis=0) <= max(1, k - 1)]

    def moments(points, weights, values):
        """Integrals of functions, ``(num_points, num_functions)``, times each monomial."""
        p = np.prod((points - 0.5)[:, :, None] ** exponents, axis=1)  # (point, monomial)
        return (weights[:, None] * p).T @ values

    rule, weights = basix.make_quadrature(nodes.cell_type, m + k)
    shape = tabulate(nodes, rule)
    places, M = np.empty((0, 2)), np.empty((exponents.shape[1], 0))  # of the nodes so far
    numbers = []
    for v in QUARTERS[0][QUARTERS[1]]:
        J = v[1:] - v[0]
        own = moments(v[0] + rule @ J, weights * np.linalg.det(J), shape)
        for place, column in zip(v[0] + nodes.points @ J, own.T, strict=True):
            at = np.flatnonzero(np.abs(places - place).max(axis=1) < SAME_NODE)
            if not len(at):
                at, places = np.array([len(places)]), np.vstack((places, place))
                M = np.column_stack((M, np.zeros(len(M))))
            M[:, at[0]] += column
            numbers.append(at[0])
    points, weights = basix.make_quadrature(element.cell_type, 2 * k)
    exact = moments(points, weights, tabulate(element, points))
    values = tabulate(element, places)
    dofs = np.abs(places[:, None] - element.points).max(axis=2).min(axis=1) < SAME_NODE
    inside = (np.minimum(places, 1 - places).min(axis=1) > SAME_NODE) & ~dofs
    values[inside] += np.linalg.pinv(M[:, inside]) @ (exact - M @ values)
    return values[numbers].reshape(len(QUARTERS[1]), nodes.dim, element.dim)
