# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Σ in three dimensions: the slab of tetrahedra between two triangulated surfaces.

Γ1 is pushed off Γ0 along its vertex normals by about half a cell, which makes the slab an ordinary
solid. Its sides are closed like the strip in 2D, Gmsh fills it, and of the result only the
connectivity is kept: the vertices go back to where they belong.
"""

from dataclasses import dataclass, replace
from functools import cached_property

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.errors import InterfaceError, raise_on_all
from hypergap_dolfinx.gap import tetrahedra
from hypergap_dolfinx.gap.cells import GapCells, Hosts
from hypergap_dolfinx.gap.kernel import cofactor
from hypergap_dolfinx.gap.walls import Side
from hypergap_dolfinx.gap.surface import Surface
from hypergap_dolfinx.gap.triangulation import facing_pieces, loops, neighbours, project

ATTEMPTS = (
    *[(offset, True, tetrahedra.HXT) for offset in (0.5, 0.25, 1.0)],
    *[(offset, True, tetrahedra.DELAUNAY) for offset in (0.5, 0.25)],
    *[(offset, False, tetrahedra.HXT) for offset in (0.5, 1.0, 2.0)],
    *[(offset, False, tetrahedra.DELAUNAY) for offset in (1.0, 2.0)],
    *[(offset, True, tetrahedra.HXT) for offset in (0.1, 2.0)],
)
"""Offsets in cell sizes, whether along each vertex's own normal or the mean one, and algorithms.

The first that gives a valid Σ is taken."""
FLAT = 1e-9  # sine of the angle at which a cell's two edges, one on each side, count as parallel
COINCIDE = 1e-9  # distance, in sizes of a loop, below which two nodes are one
REACH = 0.5  # how far apart (in facet lengths) the edges of facing pieces may be


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
        normal = np.zeros((len(self.cells), 3))
        for i, side in enumerate(self.sides):
            seed = self.seeds[i][self.cells]
            unit = (1 - 2 * i) * side.surface.normals[side.facets]
            total = np.zeros_like(self.x)
            for k in range(3):
                np.add.at(total, self.offsets[i] + side.triangles[:, k], unit)
            if self.inner.alpha.size:
                total[-self.inner.alpha.size :] = unit[self.inner.facets[i][0]]
            total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
            normal += (total[self.cells] * (seed >= 0)[..., None]).sum(axis=1)
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


def _volumes(x, cells) -> npt.NDArray[np.float64]:
    return np.linalg.det(x[cells[:, 1:]] - x[cells[:, :1]]) / 6


def _enclosed(x, triangles) -> float:
    """Volume inside a closed triangulation, by the divergence theorem."""
    return float(np.linalg.det(x[triangles] - x.mean(axis=0)).sum() / 6)


def _fill(gmsh, sides: tuple[Side, Side]) -> Slab:
    """Mesh the slab between two pieces; tries several offsets.

    Raises:
        InterfaceError: The loops don't match; no offset gives a valid mesh.
    """
    side0, side1 = sides
    walls = side_walls(side0, side1)
    n0 = len(side0.vertices)
    triangles = np.vstack((side0.triangles[:, ::-1], n0 + side1.triangles[:, ::-1], walls))
    h = max(side.surface.size[side.facets].mean() for side in sides)
    reasons = []
    shells = [triangles]
    if not len(walls):  # closed surfaces: the outer one first
        shells = [triangles[: len(side0.facets)], triangles[len(side0.facets) :]]
        shells.sort(key=lambda part: -_enclosed(np.vstack((side0.x, side1.x)), part))
    normals = side1.vertex_normals
    mean = normals.mean(axis=0) / max(np.linalg.norm(normals.mean(axis=0)), 1e-3)
    for offset, own, algorithm in ATTEMPTS:
        pushed = side1.x - offset * h * (normals if own else mean)
        surface = np.vstack((side0.x, pushed))
        try:
            x, cells = tetrahedra.fill(gmsh, surface, shells, algorithm)
        except tetrahedra.MeshingError as error:
            reasons.append((f"Gmsh: {error}", None))
            continue
        volume = _volumes(x, cells)
        cells[volume < 0] = cells[volume < 0][:, [0, 2, 1, 3]]
        reason = _pushed_off_error(x, cells, triangles, len(side0.facets) + len(side1.facets))
        if reason is None:
            slab = Slab(sides, cells, _interior_hosts(sides, pushed, x[len(surface) :]))
            slab = _without_flat_walls(slab)
            wrong = _turned_over(slab)
            if not wrong.any():
                return slab
            place = slab.x[slab.cells[wrong.argmax()]].mean(axis=0)
            reason = f"{wrong.sum()} cells are flat or inverted", place
        reasons.append(reason)
    reason, place = min(reasons, key=lambda r: r[1] is None)
    place = side1.x.mean(axis=0) if place is None else place
    raise InterfaceError(
        f"no mesh of the gap between Γ0 and Γ1 around {place}, tried with {len(ATTEMPTS)} offsets: "
        f"{reason}. Do the surfaces have the same shape there? Refine the coarser one."
    )


def _pushed_off_error(x, cells, triangles, num_facets: int):
    """What is wrong with the mesh of the pushed-off slab, and where, or None."""
    faces = np.vstack([np.delete(cells, k, axis=1) for k in range(4)])
    missing = _find(faces, triangles[:num_facets]) < 0
    if missing.any():
        place = x[triangles[:num_facets][missing.argmax()]].mean(axis=0)
        return f"{missing.sum()} facets are no faces of it", place
    volume = _volumes(x, cells)
    if not volume.min() > 0:
        return "it has cells without volume", x[cells[volume.argmin()]].mean(axis=0)
    enclosed = _enclosed(x, triangles)
    if not np.isclose(volume.sum(), enclosed, rtol=1e-8):
        return f"it has the volume {volume.sum():.6g}, not {enclosed:.6g}", x.mean(axis=0)
    return None


def _turned_over(slab: Slab) -> npt.NDArray[np.bool_]:
    """Which cells are flat or inverted with Γ1 where it belongs, ``(num_cells,)``."""
    x, alpha = slab.x[slab.cells], slab.alpha[slab.cells]
    X = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
    dalpha = alpha[:, 1:] - alpha[:, :1]
    N = np.einsum("cij,cj->ci", cofactor(X), dalpha)
    size = (np.linalg.norm(X, axis=1) ** 2).max(axis=1) * np.abs(dalpha).max(axis=1)
    return ~(np.einsum("ci,ci->c", N, slab.normal) > FLAT * size)


def _without_flat_walls(slab: Slab) -> Slab:
    """Take away cells that lie flat in the side walls: their four nodes are all on the boundary.

    What is left has another diagonal there, and walls are free to have any.
    """
    while True:
        flat = _turned_over(slab)
        if not flat.any():
            return slab
        faces = np.sort(np.stack([np.delete(slab.cells, k, axis=1) for k in range(4)], 1), axis=2)
        _, which, count = np.unique(
            faces.reshape(-1, 3), axis=0, return_inverse=True, return_counts=True
        )
        bare = (count[which.reshape(-1, 4)] == 1).sum(axis=1)
        base = (slab.bases[0] >= 0) | (slab.bases[1] >= 0)
        peel = flat & (bare == 2) & ~base
        if not peel.any():
            return slab
        slab = replace(slab, cells=slab.cells[~peel])


def _interior_hosts(sides: tuple[Side, Side], pushed, x) -> Hosts:
    """Where vertices that the mesher added in the pushed-off slab belong.

    Args:
        sides: The pieces.
        pushed: Vertices of Γ1's piece in the slab.
        x: The vertices added, ``(num_interior, 3)``.
    """
    facets, X, distance = [], [], []
    for vertices, side in zip((sides[0].x, pushed), sides, strict=True):
        centres = vertices[side.triangles].mean(axis=1)
        nearest = [np.linalg.norm(centres - point, axis=1).argmin() for point in x]
        seed = np.array(nearest, dtype=np.intp)
        facet, at = project(vertices, side.triangles, side.behind, x, seed)
        weights = np.column_stack((1 - at.sum(axis=1), at))
        foot = np.einsum("pv,pvi->pi", weights, vertices[side.triangles[facet]])
        facets.append(facet[None])
        X.append(at[None])
        distance.append(np.linalg.norm(x - foot, axis=1))
    total = distance[0] + distance[1]
    alpha = distance[0] / np.where(total > 0, total, 1)
    return Hosts(alpha[None], (facets[0], facets[1]), (X[0], X[1]))


def _mesh(sides: list[tuple[Side, Side]]) -> list[tuple]:
    """Cells and interior vertices of the slabs."""
    with tetrahedra.session() as gmsh:
        slabs = [_fill(gmsh, pair) for pair in sides]
    return [(slab.cells, slab.inner) for slab in slabs]


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
        ImportError: Gmsh is missing.
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
            result = _mesh(sides)
        except (InterfaceError, ImportError) as e:
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
