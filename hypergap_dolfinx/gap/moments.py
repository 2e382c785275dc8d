# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Quadrature on polygons, from their moments.

Integrands aren't polynomials where facets are curved: a rule on triangles that a polygon is cut
into gives another value where another cut is taken, or where a corner comes on a straight edge.
Points and weights that depend on moments alone don't jump as polygons change.
"""

from functools import cache

import numpy as np
import numpy.typing as npt

import basix

REACH = 0.2
"""By how much points are farther from the middle for each degree, in standard deviations of the
polygon; for degree 0 they would be at 1, a square's edges are at 1.7, a triangle's at 1.4."""
WIDTH = 1e-6
"""Standard deviation over that along a polygon at which points are across it at least: what slivers
have is round-off."""


def rule(X: npt.NDArray[np.float64], degree: int) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
    """Points, which polygon each is of, and weights.

    One point on each for degree 1, three for degree 2, 15 for degree 4.

    Args:
        X: Corners of convex polygons, counterclockwise; behind the last one they repeat it,
            ``(num, num_corners, 2)``.
        degree: Of polynomials that are integrated exactly, 1 or even.

    Returns:
        ``(num_points, 2)``, ``(num_points,)`` and ``(num_points,)``.
    """
    first, steps = X[:, 0], X - X[:, :1]
    a, b = steps[:, 1:-1], steps[:, 2:]
    areas = 0.5 * (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    total, each = areas.sum(axis=1), np.arange(len(areas))
    share = areas / total[:, None]
    middle = np.einsum("pt,pti->pi", share, a + b) / 3
    if degree == 1:
        return first + middle, each, total
    # ∫ x xᵀ over a triangle with a corner at 0
    square = sum(np.einsum("pt,pti,ptj->pij", share, end, end) for end in (a, b))
    mixed = np.einsum("pt,pti,ptj->pij", share, a, b)
    second = (2 * square + mixed + mixed.swapaxes(1, 2)) / 12
    second -= middle[:, :, None] * middle[:, None]
    # The square root's lower triangle. Where points lie is free: any weights that fit are right
    least = WIDTH**2 * (second[:, 0, 0] + second[:, 1, 1]) + 1e-300
    c = np.sqrt(np.maximum(second[:, 0, 0], least))
    d = second[:, 0, 1] / c
    e = np.sqrt(np.maximum(second[:, 1, 1] - d**2, least if degree > 2 else 0))
    points, inverse = _points(degree)
    away = np.stack((c[:, None] * points[:, 0], d[:, None] * points[:, 0]), axis=2)
    away[..., 1] += e[:, None] * points[:, 1]
    at = ((first + middle)[:, None] + away).reshape(-1, 2)
    each = np.repeat(each, len(points))
    if degree == 2:
        return at, each, np.repeat(total / len(points), len(points))
    # Moments where mean and standard deviations are 0 and 1
    inner, weights = basix.make_quadrature(basix.CellType.triangle, degree)
    y = a[:, :, None] * inner[:, :1] + b[:, :, None] * inner[:, 1:] - middle[:, None, None]
    y[..., 0] /= c[:, None, None]
    y[..., 1] -= d[:, None, None] * y[..., 0]
    y[..., 1] /= e[:, None, None]
    moments = np.einsum("pt,q,ptqk->pk", 2 * areas, weights, _monomials(y, degree))
    return at, each, (moments @ inverse).ravel()


@cache
def _points(degree: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Points on circles, and what makes their weights of moments."""
    if degree == 2:  # equal weights have the first and second moments
        turns = 2 * np.pi / 3 * np.arange(3)
        return 2**0.5 * np.column_stack((np.cos(turns), np.sin(turns))), np.empty((0, 0))
    circles = []
    for k in range(degree // 2 + 1):  # as many points as monomials: no polynomial is 0 at them
        turns = 2 * np.pi / (4 * k + 1) * np.arange(4 * k + 1)
        radius = (1 + REACH * degree) * np.sin(np.pi * k / degree)
        circles.append(radius * np.column_stack((np.cos(turns), np.sin(turns))))
    points = np.vstack(circles)
    return points, np.linalg.inv(_monomials(points, degree))


def _monomials(x, degree: int) -> npt.NDArray[np.float64]:
    """All up to a degree, ``(..., num)``."""
    powers = x[..., None, :] ** np.arange(degree + 1)[:, None]  # (..., power, component)
    i, j = np.nonzero(np.add.outer(np.arange(degree + 1), np.arange(degree + 1)) <= degree)
    return powers[..., i, 0] * powers[..., j, 1]
