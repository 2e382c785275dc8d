# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Σ in three dimensions: the slab of tetrahedra between two triangulated surfaces.

Surfaces are taken apart into smooth pieces that face each other; a front of flips fills the slab
between two pieces. This module knows where points of its cells lie on the bodies.
"""

from dataclasses import dataclass
from functools import cached_property

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.errors import InterfaceError, raise_on_all
from hypergap_dolfinx.gap import front
from hypergap_dolfinx.gap.cavity import Place
from hypergap_dolfinx.gap.cells import GapCells, Hosts
from hypergap_dolfinx.gap.kernel import GapElement, geometry_at_points
from hypergap_dolfinx.gap.surface import Surface
from hypergap_dolfinx.gap.triangulation import facing_pieces, project
from hypergap_dolfinx.gap.walls import Side


@dataclass(frozen=True)
class Slab:
    """Tetrahedra between two facing pieces; vertices are Γ0's, Γ1's, then interior ones."""

    sides: tuple[Side, Side]
    cells: npt.NDArray[np.int64]
    """``(num_cells, 4)``."""
    inner: Hosts
    """Hosts of the interior vertices, ``(1, num_interior)``; facets are the pieces' numbers."""

    @cached_property
    def x(self) -> npt.NDArray[np.float64]:
        """Vertex coordinates, ``(num_vertices, 3)``."""
        alpha = self.inner.alpha[0, :, None]
        x0, x1 = (
            side.surface.points(side.facets[facets[0]], X[0]) if len(alpha) else np.empty((0, 3))
            for side, facets, X in zip(self.sides, self.inner.facets, self.inner.X, strict=True)
        )
        return np.vstack((self.sides[0].x, self.sides[1].x, (1 - alpha) * x0 + alpha * x1))

    @cached_property
    def alpha(self) -> npt.NDArray[np.float64]:
        """α at the vertices, ``(num_vertices,)``."""
        n0, n1 = (len(side.vertices) for side in self.sides)
        return np.concatenate((np.zeros(n0), np.ones(n1), self.inner.alpha[0]))

    @property
    def offsets(self) -> tuple[int, int]:
        """Number of the first vertex of each side."""
        return 0, len(self.sides[0].vertices)

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
            base[three] = _find(side.triangles, face)
            found.append(base)
        return found[0], found[1]

    @cached_property
    def normal(self) -> npt.NDArray[np.float64]:
        """Reference normals: a base's, else the mean at the cell's vertices, ``(num_cells, 3)``."""
        total = np.zeros_like(self.x)
        for i, side in enumerate(self.sides):
            unit = (1 - 2 * i) * side.surface.normals[side.facets]
            for k in range(3):
                np.add.at(total, self.offsets[i] + side.triangles[:, k], unit)
            if self.inner.alpha.size:
                total[-self.inner.alpha.size :] += unit[self.inner.facets[i][0]]
        total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
        normal = total[self.cells].sum(axis=1)
        for i, side in enumerate(self.sides):
            base = self.bases[i] >= 0
            normal[base] = (1 - 2 * i) * side.surface.normals[side.facets[self.bases[i][base]]]
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
            host[away], at[away] = project(side.x, side.triangles, side.behind, x[away], host[away])
            facets.append(side.facets[host])
            X.append(at)
        # An interior vertex has the hosts that gave it its place
        interior = (self.alpha[vertices] > 0) & (self.alpha[vertices] < 1)
        for point in np.flatnonzero(weights.max(axis=1) == 1):
            c = np.flatnonzero(interior[:, weights[point].argmax()])
            if len(c):
                own = vertices[c, weights[point].argmax()] - sum(
                    len(side.vertices) for side in self.sides
                )
                for i, side in enumerate(self.sides):
                    facets[i][c, point] = side.facets[self.inner.facets[i][0, own]]
                    X[i][c, point] = self.inner.X[i][0, own]
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
                facet[mine] = _find(side.triangles, corners)
        lost = facet < 0  # an edge through the slab with both ends on Γ_i
        facet[lost] = self._seed_of(i, v[lost])
        # Weight of each of the facet's vertices
        match = side.triangles[facet][:, :, None] == v[:, None, :]
        bary = (match * w[:, None, :]).sum(axis=2)
        X = bary[:, 1:]
        if lost.any():
            x = np.einsum("pv,pvi->pi", w[lost], side.x[np.maximum(v[lost], 0)])
            facet[lost], X[lost] = project(side.x, side.triangles, side.behind, x, facet[lost])
        return facet, X

    def _seed_of(self, i: int, v):
        return self.seeds[i][v.max(axis=1) + self.offsets[i]]


def _find(triangles, corners) -> npt.NDArray[np.intp]:
    """A triangle that has the given vertices, two or three of them; −1 where there is none."""
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


def _place(sides: tuple[Side, Side]) -> Place:
    """How an interior node is hosted: where it projects to on both sides."""
    seeds = []
    for side in sides:
        seed = np.empty(len(side.vertices), dtype=np.intp)
        seed[side.triangles.ravel()] = np.repeat(np.arange(len(side.triangles)), 3)
        seeds.append(seed)
    n0 = len(sides[0].vertices)

    def place(x, alpha: float, vertices):
        facets, X, feet, normal = [], [], [], np.zeros(3)
        for i, side in enumerate(sides):
            own = (vertices - i * n0)[(vertices >= n0) == i]
            own = own[own < len(side.vertices)]
            own = own if len(own) else np.arange(len(side.vertices))
            near = own[np.linalg.norm(side.x[own] - x, axis=1).argmin()]
            facet, at = project(side.x, side.triangles, side.behind, x[None], seeds[i][[near]])
            feet.append(side.surface.points(side.facets[facet], at)[0])
            normal += (1 - 2 * i) * side.surface.normals[side.facets[facet[0]]]
            facets.append(int(facet[0]))
            X.append(at[0])
        normal /= max(np.linalg.norm(normal), 1e-300)
        x = (1 - alpha) * feet[0] + alpha * feet[1]
        return x, alpha, normal, (alpha, facets, X)

    return place


def _slab(sides: tuple[Side, Side], filling: front.Filling) -> Slab:
    """The cells with their interior vertices' hosts as arrays."""
    alpha = np.array([host[0] for host in filling.hosts]).reshape(1, -1)
    f0, f1 = (np.array([h[1][i] for h in filling.hosts], np.intp).reshape(1, -1) for i in (0, 1))
    X0, X1 = (np.array([h[2][i] for h in filling.hosts]).reshape(1, -1, 2) for i in (0, 1))
    return Slab(sides, filling.cells, Hosts(alpha, (f0, f1), (X0, X1)))


def _num_turned(slab: Slab) -> int:
    """How many cells are turned over somewhere, with the surfaces' curved geometry."""
    surfaces = [side.surface for side in slab.sides]
    g = max(surface.geometry.degree for surface in surfaces)
    k = max(surface.element.degree for surface in surfaces)
    geometry, space = (
        basix.create_element(
            basix.ElementFamily.P,
            basix.CellType.tetrahedron,
            degree,
            basix.LagrangeVariant.equispaced,
        )
        for degree in (g, k)
    )
    each = np.arange(len(slab.cells))
    hosts = slab.hosts(geometry.points, each)
    alpha = hosts.alpha[..., None]
    x0, x1 = (
        surface.points(facet.ravel(), X.reshape(-1, 2)).reshape(*facet.shape, 3)
        for surface, facet, X in zip(surfaces, hosts.facets, hosts.X, strict=True)
    )
    tables = GapElement.with_quadrature(geometry, space, 2 * (k + g))
    N, _ = geometry_at_points(tables, (1 - alpha) * x0 + alpha * x1, slab.alpha[slab.cells])
    return int((np.einsum("cpi,ci->cp", N, slab.normal) <= 0).any(axis=1).sum())


def fill(sides: tuple[Side, Side]) -> Slab:
    """Cells between two facing pieces.

    Raises:
        InterfaceError: Their boundaries don't match; there is no valid mesh.
    """
    problem = front.Problem.between(*sides)
    straight = not any(side.surface.curved[side.facets].any() for side in sides)

    def num_bad(filling: front.Filling) -> int:
        return 0 if straight else _num_turned(_slab(sides, filling))

    filling = front.construct(problem, _place(sides), num_bad)
    if filling is None:
        raise InterfaceError(
            f"no mesh of the gap between Γ0 and Γ1 around {sides[1].x.mean(axis=0)}. Do the "
            "surfaces have the same shape there? Refine the coarser one."
        )
    return _slab(sides, filling)


def mesh_slab(comm: MPI.Comm, surface0: Surface, surface1: Surface) -> GapCells:
    """Mesh Σ between two surfaces in space, on rank 0. Collective.

    Args:
        comm: Communicator.
        surface0: Γ0.
        surface1: Γ1.

    Returns:
        The cells, the same on every rank.

    Raises:
        InterfaceError: Surfaces that don't face each other or don't end at the same place, or
            for which there is no valid mesh.
        RuntimeError: There is no C compiler.
    """
    group0, group1 = facing_pieces(surface0, surface1)
    sides = [
        (
            Side.of(surface0, np.flatnonzero(group0 == g)),
            Side.of(surface1, np.flatnonzero(group1 == g)),
        )
        for g in range(int(group1.max()) + 1)
    ]
    result, error = None, None
    if comm.rank == 0:
        try:
            slabs = [fill(pair) for pair in sides]
            result = [(slab.cells, slab.inner) for slab in slabs]
        except (InterfaceError, RuntimeError) as e:
            error = e
    kind = comm.bcast(type(error) if error else InterfaceError)
    raise_on_all(comm, str(error) if error else None, kind)
    slabs = [Slab(pair, *part) for pair, part in zip(sides, comm.bcast(result), strict=True)]

    num_cells = np.cumsum([0] + [len(slab.cells) for slab in slabs])
    offsets = np.cumsum([0] + [len(slab.x) for slab in slabs])

    def hosts(points: npt.NDArray[np.float64], cells: npt.NDArray[np.intp]) -> Hosts:
        order = np.argsort(cells, kind="stable")
        parts = np.split(cells[order], np.searchsorted(cells[order], num_cells[1:-1]))
        found = Hosts.concatenate(
            [
                slab.hosts(points, part - start)
                for slab, part, start in zip(slabs, parts, num_cells[:-1], strict=True)
            ]
        )
        return found[np.argsort(order, kind="stable")]

    return GapCells(
        x=np.vstack([slab.x for slab in slabs]),
        alpha=np.concatenate([slab.alpha for slab in slabs]),
        cells=np.vstack([slab.cells + start for slab, start in zip(slabs, offsets)]),
        normal=np.vstack([slab.normal for slab in slabs]),
        rank=np.concatenate([slab.rank for slab in slabs]),
        patch=group1,
        hosts=hosts,
    )
