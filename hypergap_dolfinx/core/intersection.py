# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Intersections of simplices on a line or in a plane, many pairs at once."""

import numpy as np
import numpy.typing as npt


def axes_across(normal: npt.NDArray) -> npt.NDArray[np.float64]:
    """Unit vectors across normals, ``(num, n - 1, n)``: counterclockwise as seen from the tip."""
    if normal.shape[1] == 2:
        return np.stack((-normal[:, 1], normal[:, 0]), axis=1)[:, None]
    across = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, across)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack((first, np.cross(normal, first)), axis=1)


def common_part(x0: npt.NDArray, x1: npt.NDArray):
    """Intersections of simplices on a line or in a plane; triangles are counterclockwise.

    Args:
        x0: Vertices of the first simplices, ``(num, n, n - 1)``.
        x1: Vertices of the second ones.

    Returns:
        Vertices of the intersections, some of them repeated, ``(num, num_points, n - 1)``; their
        centroids ``(num, n - 1)``, their measures, and the measures of the smaller simplices.
    """
    if x0.shape[2] == 1:
        ends = [np.sort(x[:, :, 0], axis=1) for x in (x0, x1)]
        start, end = (
            f(ends[0][:, k], ends[1][:, k]) for k, f in enumerate((np.maximum, np.minimum))
        )
        common = np.stack((start, end), axis=1)[..., None]
        return common, common.mean(axis=1), end - start, np.min([np.ptp(e, 1) for e in ends], 0)
    common = x0
    for k in range(3):
        start, edge = x1[:, k], x1[:, (k + 1) % 3] - x1[:, k]
        common = _cut(common, _cross(edge[:, None], common - start[:, None]))
    parts = _cross(common[:, 1:-1] - common[:, :1], common[:, 2:] - common[:, :1])  # of a fan
    area = parts.sum(axis=1)
    thirds = common[:, :1] + common[:, 1:-1] + common[:, 2:]
    middle = np.einsum("pt,pti->pi", parts, thirds) / 3 / np.where(area > 0, area, 1)[:, None]
    smaller = np.min([_cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) for x in (x0, x1)], axis=0)
    return common, middle, area, smaller


def _cross(a: npt.NDArray, b: npt.NDArray) -> npt.NDArray[np.float64]:
    """Cross products of vectors in the plane."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _cut(polygon: npt.NDArray, distance: npt.NDArray) -> npt.NDArray[np.float64]:
    """Clip convex polygons at a line each.

    Args:
        polygon: Vertices; some may be repeated, ``(num, num_vertices, 2)``.
        distance: Signed distances of the vertices from the line in any unit, negative outside.

    Returns:
        Polygons with one vertex more; all vertices are one point if nothing is left.
    """
    num, count, _ = polygon.shape
    after, beyond = np.roll(polygon, -1, axis=1), np.roll(distance, -1, axis=1)
    inside = distance >= 0
    crosses = inside != (beyond >= 0)
    t = distance / np.where(crosses, distance - beyond, 1)
    crossing = polygon + t[..., None] * (after - polygon)
    points = np.stack((polygon, crossing), axis=2).reshape(num, 2 * count, 2)
    keep = np.stack((inside, crosses), axis=2).reshape(num, 2 * count)
    order = np.argsort(~keep, axis=1, kind="stable")
    last = np.maximum(keep.sum(axis=1, keepdims=True), 1) - 1
    order = np.take_along_axis(order, np.minimum(np.arange(count + 1), last), axis=1)
    return np.take_along_axis(points, order[..., None], axis=1)
