# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Quadrature on polygons, from their moments.

On curved facets integrands aren't polynomials. A rule on the triangles of a divided polygon would
then jump where the division changes, or where a corner appears on a straight edge. Here points and
weights depend on the polygon's moments alone, and are continuous.
"""

from functools import cache

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.contact_geometry.tolerances import WIDTH
from hypergap_dolfinx.core.compiled import call, doubles, ints


def rule(X: npt.NDArray[np.float64], degree: int) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
    """Points of a rule on polygons, the polygon of each, and weights.

    One point on each for degree 1, three for degree 2, 15 for degree 4.

    Args:
        X: Corners of convex polygons, counterclockwise; behind the last one they repeat it,
            ``(num, num_corners, 2)``.
        degree: Degree of polynomials that are integrated exactly, 1 or even.

    Returns:
        ``(num_points, 2)``, ``(num_points,)`` and ``(num_points,)``.
    """
    points, powers, inverse = standard_points(degree)
    inner = inner_points(degree)
    at, weights = np.empty((len(X), len(points), 2)), np.empty((len(X), len(points)))
    polygons = *X.shape[:2], doubles(X), len(points), doubles(points), WIDTH**2
    terms = len(powers), ints(powers), doubles(inverse), len(inner), inner
    call("polygon_rule", *polygons, *terms, at, weights)
    return at.reshape(-1, 2), np.repeat(np.arange(len(X)), len(points)), weights.ravel()


@cache
def inner_points(degree: int) -> npt.NDArray[np.float64]:
    """Points and weights of a rule for moments on the reference triangle, ``(num_inner, 3)``."""
    return np.column_stack(basix.make_quadrature(basix.CellType.triangle, degree))


def degree_of(surfaces) -> int:
    """Degree of the rule on polygons that two surfaces need, for their displacements' functions."""
    degree = max(surface.geometry.degree for surface in surfaces)
    # Degree 1 is enough for linear integrands on straight triangles
    linear = degree == 1 and all(surface.geometry.dim == 3 for surface in surfaces)
    return 1 if linear else 2 * degree


@cache
def standard_points(degree: int) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
    """Points on circles where mean and standard deviations are 0 and 1, and their weights.

    Returns:
        ``(num_points, 2)``; the powers of the moments that determine weights, ``(num, 2)``, none if
        weights are equal; and the matrix from moments to weights, ``(num, num_points)``.
    """
    circles = []
    if degree == 1:
        circles.append(np.zeros((1, 2)))
    elif degree == 2:  # equal weights have the first and second moments
        circles.append(2**0.5 * _circle(3))
    else:  # as many points as monomials: no polynomial is 0 at them
        for k in range(degree // 2 + 1):
            # Farther out for higher degrees: on a square and a triangle weights of degree 4, 6
            # and 10 have absolute sums of 1.00, 1.08 and 1.2 times the area
            radius = (1 + 0.2 * degree) * np.sin(np.pi * k / degree)
            circles.append(radius * _circle(4 * k + 1))
    points = np.vstack(circles)
    if degree <= 2:
        return points, np.empty((0, 2), dtype=int), np.empty((0, 0))
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    return points, np.array(powers), np.linalg.inv((points[:, None] ** powers).prod(axis=2))


def _circle(num: int) -> npt.NDArray[np.float64]:
    """Equally spaced points, ``(num, 2)``."""
    turns = 2 * np.pi / num * np.arange(num)
    return np.column_stack((np.cos(turns), np.sin(turns)))
