# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Polygons in a plane whose edges bend.

Which polygons there are is found with straight edges. If it stayed at that, derivatives would be
those of another domain: edges of curved facets move with nodes in their middles too, and what is
integrated on both sides isn't the same there. So what is between curved and straight edges is given
by one side to the other: together they fill the same.
"""

from functools import cache

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.contact_geometry.tolerances import DRIFT, NEWTON_CURVES, PARALLEL_CURVES
from hypergap_dolfinx.surface.trace import lengths


@cache
def _to_powers(degree: int) -> npt.NDArray[np.float64]:
    """Coefficients of powers of t of curves with equally spaced nodes, ``(power, node)``."""
    return np.linalg.inv(np.vander(np.linspace(0, 1, degree + 1), increasing=True))


def edge_points(corners, degree: int) -> npt.NDArray[np.float64]:
    """Points that divide polygons' edges equally.

    Args:
        corners: ``(..., num_corners, 2)``.
        degree: Number of parts.

    Returns:
        Each edge's with its ends, ``(..., num_corners, degree + 1, 2)``.
    """
    share = np.linspace(0, 1, degree + 1)[:, None]
    start, end = corners[..., None, :], np.roll(corners, -1, axis=-2)[..., None, :]
    return start + share * (end - start)


def bent(y, num, edge, nodes, sides: int, which) -> npt.NDArray[np.float64]:
    """Where edges are that polygons have of the second of two others, if edges bend.

    Args:
        y: Corners with straight edges, ``(num_polygons, num_corners, 2)``.
        num: Numbers of corners, ``(num_polygons,)``.
        edge: On which edge that from each corner to the next is, ``(num_polygons, num_corners)``.
        nodes: Of both others' edges, ``(num_polygons, num_edges, degree + 1, 2)``.
        sides: Number of the first one's.
        which: Polygons and first corners of the edges that are asked for, ``(num,)`` each.

    Returns:
        Start, middle and end of each, ``(num, 3, 2)``. They end where the first one's edges cross
        them.
    """
    (polygon, k), others = which, nodes.shape[1] - sides
    to_powers, own = _to_powers(nodes.shape[2] - 1), edge[which]
    curve = np.einsum("nm,pmi->pni", to_powers, nodes[polygon, own])
    ends = []
    for turn, at in ((-1, k), (1, (k + 1) % num[polygon])):
        beside = edge[polygon, (k + turn) % num[polygon]]
        t = _nearest(nodes[polygon, own], y[polygon, at])
        t[beside == sides + (own - sides + turn) % others] = (1 + turn) // 2  # a corner of both
        cross = np.flatnonzero(beside < sides)
        other = nodes[polygon, beside][cross]
        s = _nearest(other, y[polygon, at][cross])
        other = np.einsum("nm,pmi->pni", to_powers, other)
        t[cross] = _crossings(curve[cross], other, t[cross], s)
        ends.append(t)
    start, end = ends
    points = [_evaluate(curve, t)[0] for t in (start, 0.5 * (start + end), end)]
    return np.stack(points, axis=1)


def _nearest(nodes, point) -> npt.NDArray[np.float64]:
    """Where points are along straight edges, from 0 to 1."""
    step = nodes[:, -1] - nodes[:, 0]
    square = np.maximum(np.einsum("pi,pi->p", step, step), 1e-300)
    return np.einsum("pi,pi->p", point - nodes[:, 0], step) / square


def _evaluate(curves, t) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Points and derivatives of curves, ``(num, power, 2)``, each at its t."""
    value, slope = curves[:, -1].copy(), np.zeros_like(curves[:, -1])
    for n in range(curves.shape[1] - 2, -1, -1):
        slope = slope * t[:, None] + value
        value = value * t[:, None] + curves[:, n]
    return value, slope


def _crossings(a, b, s, t) -> npt.NDArray[np.float64]:
    """Where curves are crossed by others; nearer to where straight ones are if all but parallel."""
    first, s, t = s, s.copy(), t.copy()
    straight = np.abs(_sine(a[:, 1:].sum(axis=1), b[:, 1:].sum(axis=1)))
    for _ in range(NEWTON_CURVES):
        (x, dx), (y, dy) = _evaluate(a, s), _evaluate(b, t)
        rest, det = y - x, cross(dx, dy)
        det = np.where(np.abs(det) > 1e-300, det, np.inf)
        s += np.clip(cross(rest, dy) / det, -1, 1)
        t += np.clip(cross(rest, dx) / det, -1, 1)
    sine = np.minimum(np.abs(_sine(dx, dy)), straight)
    share = np.minimum(sine / PARALLEL_CURVES, 1)
    return first + share**2 * (3 - 2 * share) * np.clip(s - first, -DRIFT, DRIFT)


def _sine(a, b) -> npt.NDArray[np.float64]:
    """Of the angle between vectors, ``(num, 2)``."""
    return cross(a, b) / np.maximum(lengths(a) * lengths(b), 1e-300)


def cross(a, b) -> npt.NDArray[np.float64]:
    """Of vectors in the plane, ``(..., 2)``."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def along(ends, bend, t) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Points of parabolas, and derivatives.

    Args:
        ends: Start and end of straight edges, ``(num, 2, 2)``.
        bend: How far they are away at the start, in the middle and at the end, ``(num, 3, 2)``.
        t: From 0 to 1, ``(num_points,)``.

    Returns:
        ``(num, num_points, 2)`` each.
    """
    powers = np.column_stack((t**0, t, t**2))
    slopes = np.column_stack((0 * t, t**0, 2 * t))
    straight, curved = _to_powers(1), _to_powers(2)
    return tuple((of[:, :2] @ straight) @ ends + (of @ curved) @ bend for of in (powers, slopes))


def bulges(ends, bend, num: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Points and weights for what is between parabolas and straight edges.

    Args:
        ends: As for :func:`along`.
        bend: Likewise.
        num: Number of points.

    Returns:
        ``(num_edges, num, 2)`` and ``(num_edges, num)``: positive right of edges.
    """
    t, weights = basix.make_quadrature(basix.CellType.interval, 2 * num - 1)
    points, slopes = along(ends, 0.5 * bend, t[:, 0])  # half way between both
    away = 2 * (points - along(ends, 0 * bend, t[:, 0])[0])
    return points, weights * cross(away, slopes)
