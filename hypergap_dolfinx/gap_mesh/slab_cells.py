# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tetrahedra between two facing pieces: α, normals, and hosts of their points on both sides."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.compiled import call, doubles, ints
from hypergap_dolfinx.core.graph import row_codes
from hypergap_dolfinx.gap_mesh.cells import Hosts
from hypergap_dolfinx.gap_mesh.tetrahedra import NONE, find, have
from hypergap_dolfinx.gap_mesh.walls import NO_WALLS, Outline, in_walls
from hypergap_dolfinx.surface.pieces import Side
from hypergap_dolfinx.surface.trace import lengths


@dataclass(frozen=True)
class Slab:
    """Tetrahedra between two facing pieces; vertices are Γ0's, Γ1's, then interior ones."""

    sides: tuple[Side, Side]
    cells: npt.NDArray[np.integer]
    """``(num_cells, 4)``."""
    inner: Hosts
    """Hosts of the interior vertices, ``(1, num_interior)``, in the pieces' triangles."""
    straight: npt.NDArray[np.integer] = field(default_factory=lambda: NONE)
    """Edges that are straight though the surfaces are curved, ``(num_edges, 2)``."""
    walls: npt.NDArray[np.integer] = field(default_factory=lambda: NO_WALLS)
    """Triangles along the curved outlines of both sides, ``(num_walls, 3)``."""
    excess: float = 0.0
    """Area by which straight edges enlarge the slab."""
    known: dict[bytes, Hosts] = field(default_factory=dict, init=False)
    """Cached hosts of all cells' points, by :func:`key_of` points."""

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
        """A facet of each side at each vertex, in the piece's numbers; −1 if there is none."""
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
    def _cells(self) -> npt.NDArray[np.int32]:
        """The cells as the C library takes them."""
        return np.ascontiguousarray(self.cells, dtype=np.int32)

    @cached_property
    def bases(self) -> npt.NDArray[np.int32]:
        """The facet of each side that is a face of the cell or −1, ``(2, num_cells)``."""
        bases = np.empty((2, len(self.cells)), dtype=np.int32)
        sides = [(len(side.triangles), ints(side.triangles)) for side in self.sides]
        num = [len(side.x) for side in self.sides]
        cells = len(self.cells), self._cells
        if call("find_bases", *num, *sides[0], *sides[1], *cells, bases):
            raise MemoryError("no memory for the cells of the gap domain")
        return bases

    @cached_property
    def beside(self) -> npt.NDArray[np.int32]:
        """A facet of each side at a vertex of each cell, ``(2, num_cells)``.

        At a vertex on that side if there is one, else at an interior vertex.
        """
        beside = np.empty((2, len(self.cells)), dtype=np.int32)
        cells = len(self.cells), self._cells
        for start, side, seeds, own in zip(
            self.offsets, self.sides, self.seeds, beside, strict=True
        ):
            ends = start, start + len(side.x)
            call("facets_beside", *ends, ints(seeds), *cells, own)
        return beside

    @cached_property
    def vertex_normals(self) -> npt.NDArray[np.float64]:
        """Unit normals at the vertices, from Γ0 to Γ1, ``(num_vertices, 3)``."""
        total = np.zeros_like(self.x)
        for i, side in enumerate(self.sides):
            sign, start = 1 - 2 * i, self.offsets[i]
            total[start : start + len(side.x)] = sign * side.vertex_normals
            if self.inner.alpha.size:
                total[-self.inner.alpha.size :] += sign * side.normals[self.inner.facets[i][0]]
        return total / np.maximum(lengths(total), 1e-300)[:, None]

    def normals(self, cells) -> npt.NDArray[np.float64]:
        """Reference normals: a base's, else the mean at the cell's vertices, ``(num, 3)``."""
        normal = np.empty((len(cells), 3))
        of_sides = (doubles(side.normals) for side in self.sides)
        given = ints(self.cells[cells]), self.vertex_normals, ints(self.bases[:, cells]), *of_sides
        call("cell_normals", len(cells), *given, normal)
        return normal

    @cached_property
    def normal(self) -> npt.NDArray[np.float64]:
        """The normals of all cells, ``(num_cells, 3)``."""
        return self.normals(np.arange(len(self.cells)))

    @property
    def rank(self) -> npt.NDArray[np.int32]:
        """Owner of the facet of Γ1 at each cell: other owners of Γ0's don't cut Σ into pieces."""
        facet = np.where(self.bases[1] >= 0, self.bases[1], self.beside[1])
        return self.sides[1].surface.owner[self.sides[1].facets[facet]]

    def hosts(self, points: npt.NDArray[np.float64], cells: npt.NDArray[np.intp]) -> Hosts:
        """Positions of points of the reference tetrahedron on both surfaces.

        Nodes of Γ0 and Γ1 are found in their own facet. A node between them or on a straight edge
        is projected by a walk over the surface from a facet at the cell, a node in a wall to the
        outlines.

        Args:
            points: Reference points, ``(num_points, 3)``.
            cells: Cells, ``(num_cells,)``.
        """
        key = key_of(points)
        if key in self.known:
            return self.known[key][cells]
        weights = np.column_stack((1 - points.sum(axis=1), points))
        weights[np.abs(weights) < 1e-12] = 0
        shape = len(cells), len(points)
        found = Hosts(
            np.empty(shape),
            (np.empty(shape, np.intp), np.empty(shape, np.intp)),
            (np.empty((*shape, 2)), np.empty((*shape, 2))),
        )
        count = (weights > 0).sum(axis=1)
        if (count == 1).any():
            self._at_vertices(cells, weights.argmax(axis=1), count == 1, found)
        for number in range(2, 5):
            if (count == number).any():
                self._between(cells, weights, count == number, found)
        if np.array_equal(cells, np.arange(len(self.cells))):
            self.known[key] = found
        return found

    @cached_property
    def _outlines(self) -> tuple[Outline, Outline]:
        return Outline(self.sides[0]), Outline(self.sides[1])

    @cached_property
    def _vertices(self) -> Hosts:
        """Hosts of the vertices, ``(num_vertices,)``; facet −1 of Γ0's on Γ1 and the reverse."""
        num, num_inner = len(self.alpha), self.inner.alpha.size
        facets, X = [], []
        for i, side in enumerate(self.sides):
            at = np.zeros((num, 2))
            triangle, corner = self.seeds[i], np.full(num, -1)
            corner[self.offsets[i] + side.triangles.ravel()] = np.arange(side.triangles.size)
            own = np.flatnonzero(corner >= 0)
            at[own] = side.X.reshape(-1, 2)[corner[own]]
            facet = np.where(triangle >= 0, side.facets[triangle], -1)
            if num_inner:
                at[-num_inner:] = side.in_facets(self.inner.facets[i][0], self.inner.X[i][0])
            facets.append(facet)
            X.append(at)
        return Hosts(self.alpha, (facets[0], facets[1]), (X[0], X[1]))

    def _at_vertices(self, cells, local, some, found: Hosts):
        """Fill in the hosts of some points: those at vertices, of local numbers ``local``."""
        at, cells = np.flatnonzero(some), np.ascontiguousarray(cells, dtype=np.int64)
        found.alpha[:, some] = self.alpha[self.cells[cells][:, local[some]]]
        points = some.size, at.size, ints(local[some]), ints(at)
        for i, side in enumerate(self.sides):
            vertices = ints(self._vertices.facets[i]), doubles(self._vertices.X[i])
            beside = ints(side.facets[self.beside[i]])
            given = len(cells), cells, self._cells, *points, *vertices, beside
            call("vertex_hosts", *given, found.facets[i], found.X[i])

    def _between(self, cells, weights, some, found: Hosts):
        """Fill in the hosts of some points between equally many vertices; shared ones only once.

        Weights are the barycentric coordinates of all points, ``(num_points, 4)``.
        """
        number = int((weights[some][0] > 0).sum())
        support = np.argsort(weights[some] == 0, axis=1, kind="stable")[:, :number]
        w = np.take_along_axis(weights[some], support, axis=1)  # (point, vertex)
        v = self.cells[cells][:, support].reshape(-1, number)
        w = np.broadcast_to(w, (len(cells), *w.shape)).reshape(-1, number)
        first, which = _same(v, w)
        v, w, cell = v[first], w[first], np.repeat(cells, some.sum())[first]
        shape = len(cells), int(some.sum())
        alpha, moved = self.alpha[v], have(v, self.straight)
        wall = in_walls(v, self.walls) & (np.ptp(alpha, axis=1) > 0) & ~moved
        x = np.einsum("nv,nvi->ni", w, self.x[v])
        found.alpha[:, some] = np.einsum("nv,nv->n", w, alpha)[which].reshape(shape)
        for i, side in enumerate(self.sides):
            on, off = (alpha == i).all(axis=1) & ~moved, (alpha == 1 - i).all(axis=1)
            triangle, xi = self.beside[i][cell], np.zeros((len(v), 2))
            triangle[on], xi[on] = self._own_facet(i, v[on], w[on])
            # Seeds depend on the point's vertices alone, so all cells that share it agree
            seed = self.seeds[i][v].max(axis=1)
            away = ~on & ~off & ~wall
            if wall.any():
                first = np.where(alpha[wall] == i, v[wall], -1).max(axis=1) - self.offsets[i]
                triangle[wall], xi[wall] = self._outlines[i].project(x[wall], first)
            facet, X = side.facets[triangle], side.in_facets(triangle, xi)
            facet[away], X[away] = side.hosts(x[away], np.where(seed >= 0, seed, triangle)[away])
            found.facets[i][:, some] = facet[which].reshape(shape)
            found.X[i][:, some] = X[which].reshape(*shape, 2)

    def _own_facet(self, i: int, vertices, weights):
        """Triangles and coordinates in them of points between vertices of Γ_i itself."""
        side = self.sides[i]
        v = vertices - self.offsets[i]
        triangle = find(side.triangles, v)
        lost = triangle < 0  # an edge through the slab with both ends on Γ_i
        triangle[lost] = self.seeds[i][vertices[lost].max(axis=1)]
        # Weight of each of the triangle's vertices
        match = side.triangles[triangle][:, :, None] == v[:, None, :]
        X = (match * weights[:, None, :]).sum(axis=2)[:, 1:]
        if lost.any():
            x = np.einsum("nv,nvi->ni", weights[lost], side.x[v[lost]])
            triangle[lost], X[lost] = side.project(x, triangle[lost])
        return triangle, X


def key_of(points: npt.NDArray[np.float64]) -> bytes:
    """A key for points of the reference cell, the same for the same points up to round-off."""
    return (np.round(points, 12) + 0.0).tobytes()


def _same(vertices, weights):
    """Identify points by their vertices and weights, ``(num_points, 2)`` or 3 or 4 columns.

    Returns:
        Indices of the distinct points, and for each point its number among them.
    """
    number = vertices.shape[1]
    if number == 4:  # inside of a cell
        return np.arange(len(vertices)), np.arange(len(vertices))
    values, code = np.unique(np.round(weights, 9), return_inverse=True)
    key = vertices * len(values) + code.reshape(weights.shape)
    key.sort(axis=1)
    _, first, which = np.unique(row_codes(key), return_index=True, return_inverse=True)
    return first, which
