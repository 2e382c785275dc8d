# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A surface that moves with its body: displaced facets as functions of the body's dofs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.core.compiled import call, ints, struct
from hypergap_dolfinx.core.sparse import triplets
from hypergap_dolfinx.surface.tolerances import FACING_COSINE
from hypergap_dolfinx.surface.trace import Surface


@dataclass(frozen=True)
class MovingSurface:
    """Γ_i under a displacement; the same on every rank."""

    reference: Surface
    """The undeformed surface, as in the mesh."""

    @cached_property
    def dofs(self) -> npt.NDArray[np.int64]:
        """Global dofs (blocks) on the surface, sorted, ``(num_dofs,)``."""
        return np.unique(self.reference.dofs)

    @cached_property
    def at_facets(self) -> npt.NDArray[np.intp]:
        """Index in ``dofs`` of each facet's dofs, ``(num_facets, num_facet_dofs)``."""
        return np.searchsorted(self.dofs, self.reference.dofs)

    @cached_property
    def vertex_dofs(self) -> npt.NDArray[np.int64]:
        """Global dof at each vertex, ``(num_vertices,)``."""
        surface = self.reference
        at = surface.functions(basix.geometry(surface.geometry.cell_type)).argmax(axis=2)
        dofs = np.empty(len(surface.x), dtype=np.int64)
        part = np.arange(len(surface.facets)) % surface.num_parts
        dofs[surface.facets] = np.take_along_axis(surface.dofs, at[part], axis=1)
        return dofs

    @cached_property
    def rest(self) -> Surface:
        """The reference with geometry of the displacement's degree, if that is higher."""
        surface = self.reference
        if surface.element.degree < surface.geometry.degree:
            return surface
        facets, X = np.arange(len(surface.facets)), surface.element.points
        nodes = surface.points(np.repeat(facets, len(X)), np.tile(X, (len(facets), 1)))
        nodes = nodes.reshape(len(facets), len(X), -1)
        return replace(surface, own_nodes=nodes, geometry=surface.element)

    @cached_property
    def nodes_by_dofs(self) -> npt.NDArray[np.float64]:
        """Derivatives of a displaced facet's nodes by its dofs, ``(num_parts, node, dof)``."""
        return self.rest.functions(self.rest.geometry.points)

    @cached_property
    def _corners(self) -> list[int]:
        """Geometry nodes of a facet that are its vertices; cached, as Basix is slow here."""
        return [nodes[0] for nodes in self.rest.geometry.entity_dofs[0]]

    @cached_property
    def _known(self) -> dict[str, tuple[npt.NDArray[np.float64], Surface]]:
        return {}

    def keep(self, u: npt.NDArray[np.float64]):
        """Keep the surface displaced by u, which can't be written to, besides the last one."""
        self._known["kept"] = u, self.displaced(u)

    def displaced(self, u: npt.NDArray[np.float64]) -> Surface:
        """The surface displaced by u at :attr:`dofs`, ``(num_dofs, n)``.

        The last one is kept if u can't be written to.
        """
        for known, surface in self._known.values():
            if known is u:
                return surface
        rest = self.rest
        nodes = rest.nodes + self._of_parts(self.nodes_by_dofs, u)
        if rest.turned is not None:
            start, end = u[self.at_facets[:, :2]].swapaxes(0, 1)  # of edges of the mesh
            added = rest.turned * ((end - start) @ (1, 1j))[:, None]
            nodes += np.stack((added.real, added.imag), axis=-1)
        x = np.empty_like(rest.x)
        x[rest.facets] = nodes[:, self._corners]
        found = replace(rest, x=x, own_nodes=nodes)
        if not u.flags.writeable:
            self._known["last"] = u, found
        return found

    def at_vertices(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Values at vertices from those at :attr:`dofs`, ``(num_dofs, n)``."""
        surface = self.reference
        corners = surface.functions(basix.geometry(surface.geometry.cell_type))
        found = np.empty((len(surface.x), values.shape[1]))
        found[surface.facets] = self._of_parts(corners, values)
        return found

    def _of_parts(self, table, values) -> npt.NDArray[np.float64]:
        """A table of functions times values at dofs, ``(num_facets, num_points, n)``."""
        num, n = self.reference.num_parts, values.shape[1]
        of_facets = values[self.at_facets].reshape(-1, num, table.shape[2], n)
        return (table @ of_facets).reshape(len(self.at_facets), -1, n)

    def turns(self, u: npt.NDArray[np.float64]) -> float:
        """Root mean square of facets' turns under u at :attr:`dofs`, in radians where small."""
        change = self.displaced(u).normals - self.reference.normals
        return float(np.sqrt((change**2).sum(axis=1).mean()))


Sides = tuple[MovingSurface, MovingSurface]
Displacements = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
"""Values at the dofs of Γ0 and Γ1, ``(num_dofs_i, n)`` each."""


def displaced(sides: Sides, u: Displacements) -> tuple[Surface, Surface]:
    """The displaced Γ0 and Γ1."""
    return sides[0].displaced(u[0]), sides[1].displaced(u[1])


Ints = npt.NDArray[np.intp]


def went_through(sides: Sequence[tuple[Surface, Surface]], least: float) -> list[tuple[Ints, Ints]]:
    """Vertices of surfaces that went through a wall of another one on straight ways.

    Such a vertex crosses the middle of the wall from the front, ends behind it, and comes nearer by
    half of the wall at least. The wall is what lies between a facet and the far side of its own
    surface or, if that is less, between the vertex and the far side of its own, both along the
    facet's normal. What slides past an end, a little deeper than the surface beside it, crosses no
    middle: there it faces a facet that is nearer than half of that depth, and than half of the wall
    at that facet, which isn't the far side. Surfaces without a far side have no walls.

    Args:
        sides: Each surface before and after: two, or one that meets itself, but no vertex its own
            facets.
        least: Depth treated as zero.

    Returns:
        Of each surface vertices whose facets all went through, halfway to the vertex, and corners
        of which some facets did, ``(num,)`` each.
    """
    corners = [_simplices(before) for before, _ in sides]
    c = [np.zeros((2, *at.shape, 3)) for at in corners]
    for ends, ways, at in zip(c, sides, corners, strict=True):
        for x, surface in zip(ends, ways, strict=True):
            x[..., : surface.x.shape[1]] = surface.x[at]
    shift = (c[-1][1] - c[-1][0]).mean(axis=(0, 1))
    for ends in c:
        ends[1] -= shift
    in_c = [
        struct("Moved", n=at.shape[1], num=len(at), vertices=ints(at), x=ends)
        for at, ends in zip(corners, c, strict=True)
    ]
    result, none = [], np.empty(0, dtype=np.intp)
    for at, mine, others in zip(corners, in_c, in_c[::-1], strict=True):
        found = np.empty(at.shape, np.int32)
        if call("find_passed", mine, others, len(sides) == 1, least, FACING_COSINE, found):
            raise MemoryError("no memory for the walls of surfaces")
        if not found.any():
            result.append((none, none))
            continue
        through = np.ones(at.max() + 1, dtype=bool)
        through[at[found == 0]] = False
        passed = np.flatnonzero(through)
        result.append((passed, np.setdiff1d(at[found > 0], passed)))
    return result


def _simplices(surface: Surface) -> npt.NDArray[np.int32]:
    """Vertices of a surface's straight edges or triangles, ``(num, n)``."""
    if surface.facets.shape[1] < 4:
        return surface.facets
    return surface.polygons[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)


@dataclass(frozen=True)
class Sparse:
    """A sparse matrix as triplets, the same on every rank."""

    i: npt.NDArray[np.int64]
    j: npt.NDArray[np.int64]
    values: npt.NDArray[np.float64]

    @classmethod
    def empty(cls) -> "Sparse":
        """A matrix without entries."""
        none = np.empty(0, dtype=np.int64)
        return cls(none, none, np.empty(0))

    @classmethod
    def of(cls, matrix: PETSc.Mat) -> "Sparse":
        """Entries of a matrix on one rank; the matrix is destroyed."""
        found = cls(*(np.array(part) for part in triplets(matrix)))
        matrix.destroy()
        return found

    def some(self, use: npt.NDArray[np.bool_]) -> "Sparse":
        """The entries of a mask, ``(num_entries,)``."""
        return Sparse(self.i[use], self.j[use], self.values[use])

    def scaled(self, factors: npt.NDArray[np.float64]) -> "Sparse":
        """Rows times factors, ``(num_rows,)``; without those that are zero."""
        found = self.some(factors[self.i] != 0)
        return replace(found, values=factors[found.i] * found.values)

    @property
    def T(self) -> "Sparse":
        """The transpose."""
        return Sparse(self.j, self.i, self.values)

    def __matmul__(self, other: "Sparse") -> "Sparse":
        """Matrix product with duplicate entries summed."""
        count = np.bincount(other.i, minlength=self.j.max(initial=-1) + 1)
        (i, j), values = np.empty((2, num := count[self.j].sum()), np.int64), np.empty(num)
        given = (part for of in (self, other) for part in (len(of.i), of.i, of.j, of.values))
        num = call("multiply", *given, i, j, values)
        if num < 0:
            raise MemoryError("no memory for a product of matrices")
        return Sparse(i[:num], j[:num], values[:num])

    @property
    def summed(self) -> "Sparse":
        """The matrix with duplicate entries summed, row by row."""
        rows = np.arange(self.i.max(initial=-1) + 1)
        return Sparse(rows, rows, np.ones(len(rows))) @ self

    def products(self, x: npt.NDArray[np.float64], num: int) -> npt.NDArray[np.float64]:
        """The matrix of ``num`` rows times each of several vectors, ``(num_vectors, num)``."""
        found = np.zeros((len(x), num))
        call("apply", len(self.i), self.i, self.j, self.values, *x.shape, x, num, found)
        return found

    def times(self, values: Sequence[npt.NDArray[np.float64]], num: int) -> npt.NDArray[np.float64]:
        """The matrix of ``num`` rows times values at both sides' dofs, ``(num,)``."""
        flat = np.concatenate([part.ravel() for part in values])
        found = np.bincount(self.i, self.values * flat[self.j], num)
        return found.astype(float)  # without entries: integers


def joined(*parts: Sparse) -> Sparse:
    """The sum of sparse matrices."""
    parts = tuple(part for part in parts if len(part.i)) or parts[:1]
    if len(parts) == 1:
        return parts[0]
    i, j, values = zip(*[(part.i, part.j, part.values) for part in parts], strict=True)
    return Sparse(np.concatenate(i), np.concatenate(j), np.concatenate(values))
