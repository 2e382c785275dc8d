# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""A body's boundary, sampled and displaced: what is inside of it, how far off, and its normals."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

import basix
from dolfinx.mesh import exterior_facet_indices
from hypergap_dolfinx import compat

FEW = 12
"""Pieces that are looked at first for the nearest one."""
SHARP = 30.0
"""Degrees by which the boundary turns at a sharp corner in the plane."""


@dataclass
class Pieces:
    """Edges or triangles of a displaced boundary."""

    x: np.ndarray
    """Corners, out of the body by their order in space, ``(num, dim, dim)``."""
    facet: np.ndarray
    """Facet of each."""

    def contains(self, points):
        """Mask of points inside."""
        found = np.zeros(len(points), dtype=bool)
        low, high = self.x.min(axis=(0, 1)), self.x.max(axis=(0, 1))
        near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        for part in chunks(near, len(self.x)):
            found[part] = (_crosses if self.x.shape[2] == 2 else _winds)(points[part], self.x)
        return found

    def nearest(self, points, most=np.inf):
        """Distance to the boundary, and the facet there; beyond ``most`` not the least one."""
        distance, facet = np.full(len(points), np.inf), np.zeros(len(points), dtype=int)
        measure = _to_edges if self.x.shape[2] == 2 else _to_triangles
        middles = self.x.mean(axis=1)
        reach = np.linalg.norm(self.x - middles[:, None], axis=2).max()
        left = np.arange(len(points))
        if len(self.x) > FEW and len(points):  # most points need those with the nearest middles
            away, near = cKDTree(middles).query(points, FEW)
            d = measure(np.repeat(points, FEW, axis=0), self.x[near.ravel()], paired=True)
            d = d.reshape(near.shape)
            at = d.argmin(axis=1)[:, None]
            distance, facet = (np.take_along_axis(a, at, 1)[:, 0] for a in (d, self.facet[near]))
            left = np.flatnonzero((distance > away[:, -1] - reach) & (away[:, 0] - reach <= most))
        for part in chunks(left, len(self.x)):
            d = measure(points[part], self.x)
            at = d.argmin(axis=1)
            distance[part], facet[part] = d[np.arange(len(at)), at], self.facet[at]
        return distance, facet


def chunks(index, m, most=1_000_000):
    """Parts of an index, for arrays of m numbers for each."""
    return np.array_split(index, max(1, len(index) * m // most + 1)) if len(index) else ()


def _crosses(p, x):
    """Whether a ray to the right crosses edges an odd number of times, ``(num_points,)``."""
    (ax, ay), (bx, by) = x[:, 0].T, x[:, 1].T
    between = (ay > p[:, 1:]) != (by > p[:, 1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = ax + (p[:, 1:] - ay) / (by - ay) * (bx - ax)
    return (between & (p[:, :1] < at)).sum(axis=1) % 2 == 1


def _winds(p, x):
    """Whether triangles wind around points: the sum of their solid angles, ``(num_points,)``."""
    a, b, c = (x[None, :, k] - p[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    det = np.einsum("pti,pti->pt", a, np.cross(b, c))
    dots = [np.einsum("pti,pti->pt", *pair) for pair in ((a, b), (b, c), (c, a))]
    rest = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return np.arctan2(det, rest).sum(axis=1) > np.pi


def _to_edges(p, x, paired=False):
    """Distances of points to edges, ``(num_points, num)``; paired: to one each."""
    d = x[:, 1] - x[:, 0]
    rel = p - x[:, 0] if paired else p[:, None] - x[:, 0]
    t = np.einsum("...i,...i", rel, d) / np.maximum(np.einsum("ei,ei->e", d, d), 1e-300)
    return _length(rel - np.clip(t, 0, 1)[..., None] * d)


def _to_triangles(p, x, paired=False):
    """Distances of points to triangles, as to edges."""
    edges = [_to_edges(p, x[:, pair], paired) for pair in ((0, 1), (1, 2), (2, 0))]
    n = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    n /= np.maximum(_length(n)[:, None], 1e-300)
    p = p if paired else p[:, None]
    above = True
    for k in range(3):
        side = np.cross(n, x[:, k - 2] - x[:, k])
        above = above & (np.einsum("...i,...i", p - x[:, k], side) >= 0)
    return np.where(above, np.abs(np.einsum("...i,...i", p - x[:, 0], n)), np.min(edges, axis=0))


def _length(x):
    return np.sqrt(np.einsum("...i,...i", x, x))


class Boundary:
    """Exterior facets of a body, sampled, and where its displacement takes them."""

    def __init__(self, V):
        """Sample them."""
        mesh, dim = V.mesh, V.mesh.geometry.dim
        mesh.topology.create_connectivity(dim - 1, dim)
        mesh.topology.create_connectivity(dim, dim - 1)
        mesh.topology.create_connectivity(dim, 0)
        self.facets = exterior_facet_indices(mesh.topology)
        to_cell, to_facet = (
            mesh.topology.connectivity(*d) for d in ((dim - 1, dim), (dim, dim - 1))
        )
        cell = np.array([to_cell.links(f)[0] for f in self.facets])
        local = np.array(
            [np.flatnonzero(to_facet.links(c) == f)[0] for c, f in zip(cell, self.facets)]
        )
        kind = mesh.ufl_domain().ufl_coordinate_element().cell_type
        corners, facets = basix.geometry(kind), basix.topology(kind)[dim - 1]
        weights, self._pieces = samples(len(facets[0]), dim)
        points = np.stack([weights @ corners[f] for f in facets])  # (local facet, point, dim)
        of_mesh, of_V = (
            np.stack([element.sub_elements[0].tabulate(0, X)[0] for X in points])[local]
            for element in (mesh.ufl_domain().ufl_coordinate_element(), V.ufl_element())
        )
        x = mesh.geometry.x[compat.geometry_dofmap(mesh)[cell], :dim]
        self.X = np.einsum("fpn,fni->fpi", of_mesh, x)
        self.dofs, self._tabulated = V.dofmap.list[cell], of_V
        vertices = np.array([mesh.topology.connectivity(dim, 0).links(c) for c in cell])
        self.vertices = np.take_along_axis(vertices, np.array(facets)[local], axis=1)
        self.corner_points = weights.argmax(axis=0)
        ends = x[np.arange(len(x))[:, None], np.array(facets)[local]]
        self.size = np.linalg.norm(ends[:, :, None] - ends[:, None], axis=3).max(axis=(1, 2))
        self._out = np.ones(len(cell), dtype=bool)
        outwards = self.X.mean(axis=1) - x[:, : len(corners)].mean(axis=1)
        self._out = (outwards * self.normals_at(self.X)).sum(axis=1) > 0
        self.normals = self.normals_at(self.X)

    def normals_at(self, x):
        """Unit outward normals of facets with samples x, means over each."""
        x = x[:, self._pieces]  # (facet, piece, corner, dim)
        if x.shape[3] == 2:
            d = (x[:, :, 1] - x[:, :, 0]).mean(axis=1)
            n = np.column_stack((d[:, 1], -d[:, 0]))
        else:
            n = np.cross(x[:, :, 1] - x[:, :, 0], x[:, :, 2] - x[:, :, 0]).mean(axis=1)
        n[~self._out] *= -1
        return n / np.linalg.norm(n, axis=1, keepdims=True)

    @property
    def measures(self):
        """Lengths or areas of facets."""
        x = self.X[:, self._pieces]  # (facet, piece, corner, dim)
        d = x[:, :, 1] - x[:, :, 0]
        if x.shape[3] == 3:
            d = np.cross(d, x[:, :, 2] - x[:, :, 0]) / 2
        return np.linalg.norm(d, axis=2).sum(axis=1)

    @property
    def sharp(self):
        """Mask of samples at sharp corners in the plane, ``(facet, point)``."""
        x = self.X[:, self._pieces]
        d = np.where(self._out, 1, -1)[:, None, None] * (x[:, :, 1] - x[:, :, 0])[:, [0, -1]]
        angle = np.arctan2(d[..., 1], d[..., 0])  # (facet, end)
        order = np.argsort(self.vertices.ravel()).reshape(-1, 2)  # both ends at each vertex
        turn = np.diff(angle.ravel()[order], axis=1)[:, 0]
        turn = np.abs((turn + np.pi) % (2 * np.pi) - np.pi)
        ends = np.zeros(angle.size, dtype=bool)
        ends[order[turn > np.radians(SHARP)]] = True
        found = np.zeros(self.X.shape[:2], dtype=bool)
        found[:, self.corner_points] = ends.reshape(angle.shape)
        return found

    def at(self, u):
        """Places of the samples, ``(facet, point, dim)``.

        Args:
            u: Displacements at the dofs, ``(num_dofs, dim)``.
        """
        return self.X + np.einsum("fpa,fai->fpi", self._tabulated, u[self.dofs])

    def pieces(self, x, chosen=slice(None)):
        """Edges or triangles between samples x of chosen facets."""
        facet = np.arange(len(x))[chosen]
        found = x[facet][:, self._pieces]
        turned = ~self._out[facet]
        found[turned] = found[turned][:, :, ::-1]
        dim = x.shape[2]
        return Pieces(found.reshape(-1, dim, dim), np.repeat(facet, len(self._pieces)))


def samples(num_vertices, dim):
    """Samples of a facet, by weights of its vertices, and the pieces between them."""
    if dim == 2:
        n = 4
        t, i = np.linspace(0, 1, n + 1), np.arange(n)
        return np.column_stack((1 - t, t)), np.column_stack((i, i + 1))
    n = 2
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
    if num_vertices == 3:
        i, j = i[i + j <= n], j[i + j <= n]
        weights = np.column_stack((n - i - j, i, j)) / n
    else:
        s, t = i / n, j / n
        weights = np.column_stack(((1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t))
    number = {pair: k for k, pair in enumerate(zip(i.tolist(), j.tolist(), strict=True))}
    pieces = []
    for a, b in number:
        for step in (((0, 0), (1, 0), (0, 1)), ((1, 0), (1, 1), (0, 1))):
            corners = [(a + da, b + db) for da, db in step]
            if all(c in number for c in corners):
                pieces.append([number[c] for c in corners])
    return weights, np.array(pieces)
