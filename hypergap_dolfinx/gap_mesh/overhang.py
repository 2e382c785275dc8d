# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Overhang: the excess of Σ over the common part of both sides, where outlines nearly match.

Outlines whose nodes are beside each other at a tiny distance aren't cut: that would leave triangles
as narrow. Σ then goes from all of Γ0 to all of Γ1, and its walls lean. Linear displacements still
fulfil the constraint, since nodes have their true places on both sides. But tractions act on the
common part only if Σ is as wide as this part at each α: so the excess is taken out of the
integrals, as integrals over the walls times the distance by which these are outside. The remaining
error is of second order.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.gap_mesh.cells import Overhang
from hypergap_dolfinx.gap_mesh.slab_cells import Slab
from hypergap_dolfinx.gap_mesh.tetrahedra import FACES
from hypergap_dolfinx.surface.trace import lengths
from hypergap_dolfinx.trimming.tolerances import NEARLY, OFF_OUTLINES

VERTICES = np.vstack((np.zeros(3), np.eye(3)))  # of the reference tetrahedron


def overhang(slabs: Sequence[Slab], degree: int) -> Overhang | None:
    """Excess of slabs over the common part of their sides, None if there is none.

    Cells are numbered one slab after the other; ``degree`` is that of the functions on them.
    """
    found: tuple[list, list] = [], []
    start = 0
    for slab in slabs:
        leaning = _leaning(slab)
        for parts, points in zip(found, (_points, _rims), strict=True):
            cells, at, weights = points(leaning, degree)
            parts.append((start + cells, at, weights))
        start += len(slab.cells)
    whole, rims = (
        Overhang(*map(np.concatenate, zip(*parts, strict=True)))  # type: ignore[arg-type]
        for parts in found
    )
    return replace(whole, rims=rims) if len(whole.cells) else None


def _leaning(slab: Slab) -> tuple[npt.NDArray, ...]:
    """Triangles of leaning walls: an edge of one side's outline, and a node of the other side.

    Returns:
        The cell with this face; local numbers of the edge's ends and of the node, which is beside
        the second end, ``(num, 3)``; the edge's length; and the distance by which the other outline
        is outside of it at its ends, ``(num, 2)``.
    """
    cells, corners = _walls(slab)
    v = slab.cells[cells[:, None], corners]
    normal = slab.normals(cells)
    t = slab.x[v[:, 1]] - slab.x[v[:, 0]]
    length = lengths(t)
    outwards = (1 - 2 * slab.alpha[v[:, :1]]) * np.cross(t, normal)
    outwards /= np.maximum(lengths(outwards), 1e-300)[:, None]
    twin = _twins(slab, v, normal, length)
    turned = np.flatnonzero(twin[v[:, 0]] == v[:, 2])
    for ends in (corners, v):
        ends[turned] = ends[turned][:, [1, 0, 2]]
    known = (twin[v[:, 0]] >= 0) & (twin[v[:, 1]] == v[:, 2])
    off = np.einsum("tki,ti->tk", slab.x[twin[v[:, :2]]] - slab.x[v[:, :2]], outwards)
    lean = known & (np.abs(off).max(axis=1, initial=0) > OFF_OUTLINES * length)
    return cells[lean], corners[lean], length[lean], off[lean]


def _walls(slab: Slab) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Cells with a face in a wall, and its corners, counterclockwise seen from outside.

    The corners are the ends of an edge, then a node of the other side.
    """
    rim = np.zeros(len(slab.x), dtype=bool)
    for side, start in zip(slab.sides, slab.offsets, strict=True):
        f, k = np.nonzero(side.behind < 0)
        rim[start + side.triangles[f, k]] = True
    near = np.flatnonzero(rim[slab.cells].sum(axis=1) > 2)
    faces = slab.cells[near][:, FACES]  # (cell, face, vertex)
    on1 = (slab.alpha[faces] == 1).sum(axis=2)
    cell, face = np.nonzero(rim[faces].all(axis=2) & (on1 > 0) & (on1 < 3))
    keys = np.sort(faces[cell, face], axis=1)
    _, first, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
    cell, face = cell[first[count == 1]], face[first[count == 1]]
    alone = (slab.alpha[faces[cell, face]] == (on1[cell, face] == 1)[:, None]).argmax(axis=1)
    return near[cell], FACES[face[:, None], (alone[:, None] + (1, 2, 0)) % 3]


def _twins(slab: Slab, triangles, normal, length) -> npt.NDArray[np.intp]:
    """The vertex of the other side beside each vertex, −1 if there is none.

    Wall triangles are an edge's ends and a node of the other side; length is the edge's.
    """
    longest = np.zeros(len(slab.x))
    np.maximum.at(longest, triangles[:, :2], length[:, None])
    pairs = np.vstack((triangles[:, [0, 2]], triangles[:, [1, 2]]))
    apart, n = slab.x[pairs[:, 1]] - slab.x[pairs[:, 0]], np.tile(normal, (2, 1))
    away = lengths(apart - np.einsum("pi,pi->p", apart, n)[:, None] * n)
    near = np.flatnonzero(away <= NEARLY * longest[pairs].max(axis=1))
    pairs = pairs[near[np.argsort(-away[near], kind="stable")]]
    nearest = np.full(len(slab.x), -1)
    for alpha in (0, 1):
        own = np.where(slab.alpha[pairs[:, :1]] == alpha, pairs, pairs[:, ::-1])
        nearest[own[:, 0]] = own[:, 1]  # the nearest comes last
    mutual = nearest[nearest] == np.arange(len(nearest))
    return np.where((nearest >= 0) & mutual, nearest, -1)


def _points(triangles: tuple[npt.NDArray, ...], degree: int) -> tuple[npt.NDArray, ...]:
    """Quadrature on leaning walls for products of two derivatives of functions of a degree.

    A point of a wall triangle (:func:`_leaning`) is at s along the edge and at a share of the way
    up to the other outline, s at most. It is outside by that share of the node's distance; the
    common part ends at the inner one of both outlines.

    Returns:
        Cells, reference coordinates and weights, which contain the width that is left out.
    """
    cells, corners, length, off = triangles
    gauss, weights = basix.make_quadrature(basix.CellType.interval, 2 * degree + 2)
    gauss = gauss[:, 0]
    first, last = off.T
    crossed = first * last < 0
    crossing = np.divide(first, first - last, out=np.ones(len(first)), where=crossed)
    found = []
    for low, high in ((np.zeros_like(crossing), crossing), (crossing, np.ones_like(crossing))):
        some = np.flatnonzero(high > low)
        a, b, step = (y[some, None] for y in (first, last, high - low))
        s = low[some, None] + step * gauss  # (triangle, point along)
        up = s[:, :, None] * gauss  # (triangle, point along, point up)
        width = up * b[:, None] - np.minimum((1 - s) * a + s * b, 0)[:, :, None]
        area = (length[some, None] * step * s * weights)[:, :, None] * weights
        along = np.broadcast_to(s[:, :, None], up.shape)
        num = len(gauss) ** 2
        shares = np.stack((1 - along, along - up, up), axis=-1).reshape(-1, num, 3)
        at = shares @ VERTICES[corners[some]]
        found.append((np.repeat(cells[some], num), at.reshape(-1, 3), (width * area).ravel()))
    return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))


def _rims(triangles: tuple[npt.NDArray, ...], degree: int) -> tuple[npt.NDArray, ...]:
    """Quadrature on outlines' edges for products of two functions of a degree.

    Returns:
        Cells, reference coordinates and weights, which contain the width by which the edge is
        outside of the other outline.
    """
    cells, corners, length, off = triangles
    s, weights = basix.make_quadrature(basix.CellType.interval, 2 * degree + 1)
    shares = np.hstack((1 - s, s))  # (point, end)
    width = np.maximum(-(off @ shares.T), 0)
    at = shares @ VERTICES[corners[:, :2]]
    area = length[:, None] * width * weights
    return np.repeat(cells, len(weights)), at.reshape(-1, 3), area.ravel()
