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
from hypergap_dolfinx.core.compiled import call
from hypergap_dolfinx.core.sparse import triplets
from hypergap_dolfinx.surface.search import meet, meeting
from hypergap_dolfinx.surface.tolerances import FACING_COSINE
from hypergap_dolfinx.surface.trace import Surface, lengths, normals_by_area


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
        return replace(surface, nodes=nodes, geometry=surface.element)

    @cached_property
    def nodes_by_dofs(self) -> npt.NDArray[np.float64]:
        """Derivatives of a displaced facet's nodes by its dofs, ``(num_parts, node, dof)``."""
        return self.rest.functions(self.rest.geometry.points)

    @cached_property
    def _corners(self) -> list[int]:
        """Geometry nodes of a facet that are its vertices; cached, as Basix is slow here."""
        return [nodes[0] for nodes in self.rest.geometry.entity_dofs[0]]

    @cached_property
    def _last(self) -> list[tuple[npt.NDArray[np.float64], Surface]]:
        return []

    def displaced(self, u: npt.NDArray[np.float64]) -> Surface:
        """The surface displaced by u at :attr:`dofs`, ``(num_dofs, n)``.

        The last one is kept if u can't be written to.
        """
        for known, surface in self._last:
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
        found = replace(rest, x=x, nodes=nodes)
        if not u.flags.writeable:
            self._last[:] = [(u, found)]
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
    c = [np.stack([s.x[at] for s in ways]) for ways, at in zip(sides, corners, strict=True)]
    shift = (c[-1][1] - c[-1][0]).mean(axis=(0, 1))
    for ends in c:
        ends[1] -= shift
    swept = [_boxes(_there_and_back(ends)) for ends in c]
    near, none = meeting(swept[0], swept[-1]), np.empty(0, dtype=np.intp)
    if not len(near):
        return [(none, none)] * len(sides)
    n = [np.stack([_units(part) for part in ends]) for ends in c]
    every = list(zip(corners, c, n, swept, strict=True))
    pairs = zip(every, every[::-1], (near, near[:, ::-1]))  # one pair for one surface
    return [_went_through(*pair, least, itself=len(sides) == 1) for pair in pairs]


def _went_through(mine, others, near: Ints, least: float, *, itself: bool) -> tuple[Ints, Ints]:
    """The same of one surface.

    Args:
        mine: Vertices of its simplices, ``(num, n)``, before and after these themselves,
            ``(2, num, n, n)``, and their unit normals, ``(2, num, n)``, and boxes around their
            ways, ``(num, 2, n)``.
        others: Those of the other one.
        near: Simplices of both that may meet, ``(num_pairs, 2)``.
        least: Depth treated as zero.
        itself: True if both are one surface.
    """
    (own, y, own_n, _), (corners, c, n, swept) = mine, others
    x, num = ((y + y.mean(axis=2, keepdims=True)) / 2).reshape(2, -1, y.shape[3]), own.shape[1]
    y, ways = y[0], (x[:, :, None], c)
    v, f = (num * near[:, :1] + np.arange(num)).ravel(), np.repeat(near[:, 1], num)
    may = meet(_boxes(_there_and_back(ways[0]))[v], swept[f])
    v, f = v[may], f[may]
    h0, h1 = np.einsum("tpi,tpi->tp", x[:, v] - c[:, f, 0], n[:, f])
    may = h1 < np.minimum(2 * h0, -least)  # else it doesn't come nearer by what it ends behind
    if itself:
        may &= (corners[f][:, :, None] != own[v // num][:, None]).all(axis=(1, 2))
    if not may.any():
        return v[:0], v[:0]
    way_x, way_f = map(_boxes, ways)
    may &= (h0 < 0) | meet(way_x[v], way_f[f])
    v, f, h0, h1 = v[may], f[may], h0[may], h1[may]
    far = 2 * np.minimum(h0 - h1, -h1)
    on = own[v // num]
    deep = np.minimum(
        _walls(y, x[0][v], far[:, None] * n[0, f], own, on),
        _walls(c[0], c[0][f].mean(axis=1), -far[:, None] * n[0, f], corners, corners[f]),
    )
    deep *= far / 2
    goes = np.flatnonzero((h0 > -deep) & np.isfinite(deep))
    v, f, deep = v[goes], f[goes], deep[goes]
    if not len(v):
        return v, v
    middle = c[:, f] - (deep[:, None] * n[:, f])[:, :, None]
    low, high = np.zeros(len(v)), np.ones(len(v))
    for _ in range(np.finfo(float).nmant):  # halving: in space it is a cubic
        t = (low + high)[:, None] / 2
        at = x[0, v] + t * (x[1, v] - x[0, v])
        facet = middle[0] + t[:, None] * (middle[1] - middle[0])
        front = np.einsum("pi,pi->p", at - facet[:, 0], normals_by_area(facet)) > 0
        low, high = np.where(front, t[:, 0], low), np.where(front, high, t[:, 0])
    passed, found = np.ones(own.max() + 1, dtype=bool), np.zeros(x.shape[1], dtype=bool)
    there = np.flatnonzero(_are_inside(at, facet))
    if not itself:
        p, s, off, shares = _near(at[there], t[there, 0], c, deep[there] / 2)
        on, way = v[there[p]], 2 * off[:, None] * n[0, s]
        foot = np.einsum("pc,pci->pi", shares, c[0, s])
        lean, beside = (
            np.einsum("pi,pi->p", normals, n[0, s])
            for normals in (own_n[0, on // num], n[0, f[there[p]]])
        )
        shallow = (lean < np.finfo(float).eps ** 0.5) & (beside > FACING_COSINE)
        shallow &= np.isinf(np.minimum(_walls(y, x[0][on], way), _walls(c[0], foot, -way)))
        there = np.delete(there, p[shallow])
    found[v[there]] = True
    np.logical_and.at(passed, own.ravel(), found)
    return np.flatnonzero(passed), np.setdiff1d(own.ravel()[found], np.flatnonzero(passed))


def _simplices(surface: Surface) -> npt.NDArray[np.int32]:
    """Vertices of a surface's straight edges or triangles, ``(num, n)``."""
    if surface.facets.shape[1] < 4:
        return surface.facets
    return surface.polygons[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)


def _boxes(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Boxes around moving sets of points, ``(num_times, num_sets, num_points, n)``."""
    return np.stack((x.min(axis=(0, 2)), x.max(axis=(0, 2))), axis=1)


def _there_and_back(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Places before and after, ``(2, ...)``, and as far back as they moved."""
    return np.concatenate((x, 2 * x[:1] - x[1:]))


def _units(corners: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Unit normals of simplices, ``(num, n, n)``."""
    n = normals_by_area(corners)
    return n / np.maximum(lengths(n), np.finfo(float).tiny)[:, None]


def _walls(corners, x, ways, vertices=None, near=None) -> npt.NDArray[np.float64]:
    """Shares of ways, from points, at which they first leave through a simplex; ∞: nowhere.

    Args:
        corners: Corners of the simplices, ``(num_simplices, n, n)``.
        x: The points, ``(num, n)``.
        ways: The ways, likewise.
        vertices: Vertices of the simplices, ``(num_simplices, n)``, if near is given.
        near: Vertices for each point whose simplices don't count, ``(num, num_near)``. Simplices on
            which a point is never count.
    """
    p, s = meeting(_boxes(np.stack((x, x + ways))[:, :, None]), _boxes(corners[None])).T
    found = np.full(len(x), np.inf)
    n = normals_by_area(corners[s])
    along, high = (np.einsum("pi,pi->p", a, n) for a in (ways[p], corners[s, 0] - x[p]))
    on = (along > 0) & (high > np.finfo(float).eps ** 0.5 * along) & (high <= along)
    if near is not None:
        on &= (vertices[s][:, :, None] != near[p][:, None]).all(axis=(1, 2))
    if not on.any():
        return found
    p, s, share = p[on], s[on], high[on] / along[on]
    hit = _are_inside(x[p] + share[:, None] * ways[p], corners[s])
    np.minimum.at(found, p[hit], share[hit])
    return found


def _near(x, t, corners, least):
    """Points and moving simplices less than a distance apart, the distances, and :func:`_feet`.

    Args:
        x: The points, ``(num, n)``.
        t: Share of the simplices' ways at each point, ``(num,)``.
        corners: The simplices before and after, ``(2, num_simplices, n, n)``.
        least: The distance for each point, ``(num,)``.
    """
    ball = np.stack((x - least[:, None], x + least[:, None]))[:, :, None]
    p, s = meeting(_boxes(ball), _boxes(corners)).T
    now = corners[0, s] + t[p, None, None] * (corners[1, s] - corners[0, s])
    shares = _feet(x[p], now)
    off = np.linalg.norm(x[p] - np.einsum("pc,pci->pi", shares, now), axis=1)
    near = off < least[p]
    return p[near], s[near], off[near], shares[near]


def _feet(x, corners) -> npt.NDArray[np.float64]:
    """Weights of simplices' corners in the places on them nearest to points, ``(num, n)``."""
    e, apart = np.roll(corners, -1, axis=1) - corners, x[:, None] - corners
    square = np.maximum(np.einsum("pci,pci->pc", e, e), np.finfo(float).tiny)
    along = (np.einsum("pci,pci->pc", apart, e) / square).clip(0, 1)
    edge = np.linalg.norm(apart - along[..., None] * e, axis=2).argmin(axis=1)
    each, num = np.arange(len(x)), corners.shape[1]
    shares = np.zeros((len(x), num))
    shares[each, edge] = 1 - along[each, edge]
    shares[each, (edge + 1) % num] = along[each, edge]
    within = _shares(x, corners)
    return np.where((within >= 0).all(axis=1, keepdims=True), within, shares)


def _shares(x, corners) -> npt.NDArray[np.float64]:
    """Shares of simplices' corners in the feet of points in their planes, ``(num, n)``."""
    e = corners[:, 1:] - corners[:, :1]
    found = np.linalg.pinv(e @ e.swapaxes(1, 2)) @ (e @ (x - corners[:, 0])[..., None])
    return np.column_stack((1 - found.sum(axis=(1, 2)), found[..., 0]))


def _are_inside(x, corners) -> npt.NDArray[np.bool_]:
    """Mask of points whose feet in the planes of simplices are inside, each of its own."""
    return (_shares(x, corners) >= -(np.finfo(float).eps ** 0.5)).all(axis=1)


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
    return Sparse(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("i", "j", "values"))
    )
