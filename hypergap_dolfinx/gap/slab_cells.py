# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tetrahedra between two facing pieces: α, normals, and where their points lie on both sides."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.cells import Hosts
from hypergap_dolfinx.gap.pieces import Side


@dataclass(frozen=True)
class Slab:
    """Tetrahedra between two facing pieces; vertices are Γ0's, Γ1's, then interior ones."""

    sides: tuple[Side, Side]
    cells: npt.NDArray[np.integer]
    """``(num_cells, 4)``."""
    inner: Hosts
    """Hosts of the interior vertices, ``(1, num_interior)``, in the pieces' triangles."""

    @cached_property
    def x(self) -> npt.NDArray[np.float64]:
        """Vertex coordinates, ``(num_vertices, 3)``."""
        alpha = self.inner.alpha[0, :, None]
        x0, x1 = (
            side.points(facets[0], X[0]) if len(alpha) else np.empty((0, 3))
            for side, facets, X in zip(self.sides, self.inner.facets, self.inner.X, strict=True)
        )
        return np.vstack((self.sides[0].x, self.sides[1].x, (1 - alpha) * x0 + alpha * x1))

    @cached_property
    def alpha(self) -> npt.NDArray[np.float64]:
        """α at the vertices, ``(num_vertices,)``."""
        n0, n1 = (len(side.x) for side in self.sides)
        return np.concatenate((np.zeros(n0), np.ones(n1), self.inner.alpha[0]))

    @property
    def offsets(self) -> tuple[int, int]:
        """Number of the first vertex of each side."""
        return 0, len(self.sides[0].x)

    @cached_property
    def seeds(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """A facet of each side at each vertex, in the piece's numbers; −1 where there is none."""
        found = []
        for i, side in enumerate(self.sides):
            seed = np.full(len(self.alpha), -1)
            facet = np.repeat(np.arange(len(side.triangles)), 3)
            seed[self.offsets[i] + side.triangles.ravel()] = facet
            if self.inner.alpha.size:
                seed[-self.inner.alpha.size :] = self.inner.facets[i][0]
            found.append(seed)
        return found[0], found[1]

    @cached_property
    def bases(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """The facet of each side that is a face of the cell, −1 where there is none."""
        found = []
        for i, side in enumerate(self.sides):
            base = np.full(len(self.cells), -1)
            on = self.alpha[self.cells] == i
            three = np.flatnonzero(on.sum(axis=1) == 3)
            face = self.cells[three][on[three]].reshape(-1, 3) - self.offsets[i]
            base[three] = find(side.triangles, face)
            found.append(base)
        return found[0], found[1]

    @cached_property
    def normal(self) -> npt.NDArray[np.float64]:
        """Reference normals: a base's, else the mean at the cell's vertices, ``(num_cells, 3)``."""
        total = np.zeros_like(self.x)
        for i, side in enumerate(self.sides):
            unit = (1 - 2 * i) * side.normals
            corner = self.offsets[i] + side.triangles.ravel()
            for k in range(3):
                each = np.repeat(unit[:, k], 3)
                total[:, k] += np.bincount(corner, each, minlength=len(total))
            if self.inner.alpha.size:
                total[-self.inner.alpha.size :] += unit[self.inner.facets[i][0]]
        total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
        normal = total[self.cells].sum(axis=1)
        for i, side in enumerate(self.sides):
            base = self.bases[i] >= 0
            normal[base] = (1 - 2 * i) * side.normals[self.bases[i][base]]
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)

    @property
    def rank(self) -> npt.NDArray[np.int32]:
        """Owner of a facet beside each cell, ``(num_cells,)``."""
        rank = np.full(len(self.cells), -1, dtype=np.int32)
        for i, side in enumerate(self.sides):
            facet = np.where(self.bases[i] >= 0, self.bases[i], self._seed(i))
            left = rank < 0 if i == 0 else self.bases[1] >= 0
            rank[left] = side.surface.owner[side.facets[facet]][left]
        return rank

    def _seed(self, i: int) -> npt.NDArray[np.intp]:
        """A facet of a side at each cell."""
        seed = self.seeds[i][self.cells]
        # A vertex on the side itself before an interior one
        prefer = np.where(self.alpha[self.cells] == i, 2, 0) + (seed >= 0)
        return np.take_along_axis(seed, prefer.argmax(axis=1)[:, None], axis=1)[:, 0]

    def hosts(self, points: npt.NDArray[np.float64], cells: npt.NDArray[np.intp]) -> Hosts:
        """Where points of the reference tetrahedron lie on both surfaces.

        Nodes of Γ0 and Γ1 are found in their own facet. A node between them is projected: a walk
        over the surface, from a facet at the cell, ends in the nearest one.

        Args:
            points: Reference points, ``(num_points, 3)``.
            cells: Cells, ``(num_cells,)``.
        """
        weights = np.column_stack((1 - points.sum(axis=1), points))
        weights[np.abs(weights) < 1e-12] = 0
        vertices = self.cells[cells]  # (cell, vertex)
        alpha = self.alpha[vertices] @ weights.T
        x = weights @ self.x[vertices]  # (cell, point, i)
        facets, X = [], []
        for i, side in enumerate(self.sides):
            support = weights != 0  # (point, vertex)
            off = self.alpha[vertices] != i  # (cell, vertex)
            on = ~(off[:, None] & support).any(axis=2)  # (cell, point)
            host = np.broadcast_to(self._seed(i)[cells][:, None], alpha.shape).copy()
            at = np.zeros((*alpha.shape, 2))
            host[on], at[on] = self._own_facet(i, vertices, weights, on)
            away = ~on & (np.abs(alpha - (1 - i)) > 1e-12)
            first, which = _same(vertices, weights, away)
            # From what lies around the point: other cells that have it find the same
            around = np.where(support[None], vertices[:, None], -1)[away][first]
            seed = np.where(around >= 0, self.seeds[i][around], -1).max(axis=1)
            seed = np.where(seed >= 0, seed, host[away][first])
            found, there = side.project(x[away][first], seed)
            host[away], at[away] = found[which], there[which]
            facets.append(side.facets[host])
            X.append(side.in_facets(host.ravel(), at.reshape(-1, 2)).reshape(at.shape))
        # An interior vertex has the hosts that gave it its place
        interior = (self.alpha[vertices] > 0) & (self.alpha[vertices] < 1)
        for point in np.flatnonzero(weights.max(axis=1) == 1):
            c = np.flatnonzero(interior[:, weights[point].argmax()])
            if len(c):
                own = vertices[c, weights[point].argmax()] - sum(len(s.x) for s in self.sides)
                for i, side in enumerate(self.sides):
                    triangle = self.inner.facets[i][0, own]
                    facets[i][c, point] = side.facets[triangle]
                    X[i][c, point] = side.in_facets(triangle, self.inner.X[i][0, own])
        return Hosts(alpha, (facets[0], facets[1]), (X[0], X[1]))

    def _own_facet(self, i: int, vertices, weights, on):
        """Facets and reference coordinates of points on Γ_i itself."""
        side = self.sides[i]
        cell, point = np.nonzero(on)
        w = weights[point]
        v = np.where(w != 0, vertices[cell] - self.offsets[i], -1)  # what the point lies between
        facet = np.empty(len(v), dtype=np.intp)
        count = (w != 0).sum(axis=1)
        for n in (1, 2, 3):
            mine = count == n
            corners = v[mine][w[mine] != 0].reshape(-1, n)
            if n == 1:
                facet[mine] = self.seeds[i][corners[:, 0] + self.offsets[i]]
            else:
                facet[mine] = find(side.triangles, corners)
        lost = facet < 0  # an edge through the slab with both ends on Γ_i
        facet[lost] = self._seed_of(i, v[lost])
        # Weight of each of the facet's vertices
        match = side.triangles[facet][:, :, None] == v[:, None, :]
        bary = (match * w[:, None, :]).sum(axis=2)
        X = bary[:, 1:]
        if lost.any():
            x = np.einsum("pv,pvi->pi", w[lost], side.x[np.maximum(v[lost], 0)])
            facet[lost], X[lost] = side.project(x, facet[lost])
        return facet, X

    def _seed_of(self, i: int, v):
        return self.seeds[i][v.max(axis=1) + self.offsets[i]]


def _same(vertices, weights, some):
    """Points of cells that are one, by their vertices and weights.

    Args:
        vertices: ``(num_cells, 4)``.
        weights: Of the vertices at the points of each cell, ``(num_points, 4)``.
        some: Which points, ``(num_cells, num_points)``.

    Returns:
        Where each is met first, and the number of each point's.
    """
    cell, point = np.nonzero(some)
    values, code = np.unique(np.round(weights, 9), return_inverse=True)
    code = code.reshape(weights.shape)[point]
    key = np.where(weights[point] != 0, vertices[cell] * len(values) + code, -1)
    key.sort(axis=1)
    order = np.lexsort(key.T)
    new = np.ones(len(order), dtype=bool)
    new[1:] = (key[order[1:]] != key[order[:-1]]).any(axis=1)
    which = np.empty(len(order), dtype=np.intp)
    which[order] = np.cumsum(new) - 1
    return order[new], which


def find(triangles: npt.NDArray, corners: npt.NDArray) -> npt.NDArray[np.intp]:
    """A triangle that has the given vertices, two or three of them; −1 where there is none.

    Args:
        triangles: ``(num_triangles, 3)``.
        corners: ``(num, 2)`` or ``(num, 3)``.

    Returns:
        ``(num,)``.
    """
    if not len(corners):
        return np.empty(0, dtype=np.intp)
    n = int(max(triangles.max(), corners.max())) + 1
    each = np.arange(len(triangles))
    if corners.shape[1] == 3:
        lots, facet = [np.sort(triangles, axis=1)], each
    else:
        lots = [np.sort(triangles[:, [k, (k + 1) % 3]], axis=1) for k in range(3)]
        facet = np.tile(each, 3)

    def key(v):
        return np.ravel_multi_index(tuple(v.T.astype(np.int64)), (n,) * v.shape[1])

    known = key(np.vstack(lots))
    order = np.argsort(known, kind="stable")
    wanted = key(np.sort(corners, axis=1))
    at = order[np.minimum(np.searchsorted(known[order], wanted), len(order) - 1)]
    return np.where(known[at] == wanted, facet[at], -1)
