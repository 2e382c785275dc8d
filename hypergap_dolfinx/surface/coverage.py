# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""How well functions of a facet are known where Σ reaches only a part of it.

Of a part p of a facet f that is

.. math:: \min_v \int_p v^2 \, dX \Big/ \int_f v^2 \, dX

over the functions v that the facet carries, in its reference coordinates. Where it is small, λ is
found from forces of hardly any size, with as many times their round-off. The area alone doesn't
tell: of a corner with 30 % of a quadrilateral it is 4e-3 for degree 1 and 2e-5 for degree 2, of
30 % in a corner of a triangle 3e-2 and 2e-3.
"""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.surface.trace import Surface, tabulate

WHOLE = 1 - 1e-9  # part of a facet from which it isn't cut


def covered_parts(
    surface: Surface,
    facets: npt.NDArray,
    X: npt.NDArray[np.float64],
    shares: npt.NDArray[np.float64],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """What pieces cover of a surface's facets.

    Args:
        surface: Γ1.
        facets: The facet of each piece, ``(num_pieces,)``.
        X: Reference coordinates of the pieces' corners in it, ``(num_pieces, n, n - 1)``; edges
            are taken straight.
        shares: Part of its facet that each piece is, ``(num_pieces,)``.

    Returns:
        The share of each facet's size, and the least share of the square of a function on it,
        ``(num_facets,)`` each.
    """
    num, dim = len(surface.facets), X.shape[2]
    covered = np.bincount(facets, shares, minlength=num)
    least = np.where(covered < WHOLE, 0.0, 1.0)
    cut = np.flatnonzero((covered > 0) & (covered < WHOLE))
    number = np.full(num, -1)
    number[cut] = np.arange(len(cut))
    use = np.flatnonzero(number[facets] >= 0)
    if not len(use):
        return covered, least
    element = surface.element
    points, weights, inverse = _rule(element)
    corners = X[use]
    at = corners[:, None, 0] + points @ (corners[:, 1:] - corners[:, :1])
    phi = tabulate(element, at.reshape(-1, dim)).reshape(*at.shape[:2], -1) @ inverse.T
    weighted = (shares[use, None] * weights)[..., None] * phi
    squares = weighted.transpose(0, 2, 1) @ phi
    total = np.zeros((len(cut), *squares.shape[1:]))
    np.add.at(total, number[facets[use]], squares)
    least[cut] = np.maximum(np.linalg.eigvalsh(total)[:, 0], 0.0)
    return covered, least


@lru_cache(maxsize=32)
def _rule(element: basix.finite_element.FiniteElement) -> tuple[npt.NDArray, ...]:
    """A rule for squares of functions on a simplex, and what makes them orthonormal on the facet.

    Returns:
        Points, weights whose sum is one, and L⁻¹ with L Lᵀ the mean of φ φᵀ over the facet.
    """
    simplices = {1: basix.CellType.interval, 2: basix.CellType.triangle}
    simplex = simplices[element.points.shape[1]]
    # In a triangle those of a quadrilateral have twice the degree
    degree = 2 * element.degree * (1 if element.cell_type == simplex else 2)
    points, weights = basix.make_quadrature(simplex, degree)
    x, w = basix.make_quadrature(element.cell_type, 2 * element.degree)
    phi = tabulate(element, x)
    mass = (phi * w[:, None]).T @ phi / w.sum()
    return points, weights / weights.sum(), np.linalg.inv(np.linalg.cholesky(mass))
