# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Σ and Γ1 at the present displacements as DOLFINx meshes, with values on them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix
import basix.ufl
from dolfinx import fem
from hypergap_dolfinx.contact_geometry.tolerances import ROUND_OFF_FACET, SLIVER
from hypergap_dolfinx.mortar.domain import distributed, share
from hypergap_dolfinx.mortar.free_edges import around_corners
from hypergap_dolfinx.surface.trace import Surface


@dataclass(frozen=True)
class OpenColumns:
    """Σ where the bodies are: a prism on each simplex of Γ1's facets; the same on every rank."""

    x: npt.NDArray[np.float64]
    """Corners on Γ1 and, in the same order, on Γ0, ``(num, 2, n, n)``."""
    facets: npt.NDArray[np.intp]
    """Facets of Γ1, ``(num,)``."""
    X: npt.NDArray[np.float64]
    """Reference coordinates of the corners on Γ1, ``(num, n, n - 1)``."""
    vertices: npt.NDArray[np.integer]
    """Vertices of Γ1 that share the pressure there, ``(num, num_shares)``."""
    shares: npt.NDArray[np.float64]
    """Their shares at the corners, linear between these, ``(num, n, num_shares)``."""
    gap: npt.NDArray[np.float64]
    """Volume over area: mean distance of the bodies, ``(num,)``."""

    def of(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Values at the corners on Γ1, ``(num, n, …)``, from those of its vertices.

        Their integral over Γ1 is that of the values over the parts of vertices: the force of
        pressures.
        """
        return np.einsum("cks,cs...->ck...", self.shares, values[self.vertices])

    def on_some(self, facets: npt.NDArray[np.bool_]) -> "OpenColumns":
        """Those on some facets, given by a mask."""
        return OpenColumns(**{name: part[facets[self.facets]] for name, part in vars(self).items()})

    def cover(self, surface: Surface) -> npt.NDArray[np.bool_]:
        """Mask of Γ1's facets of which all lies opposite Γ0, ``(num_facets,)``."""
        sizes = _sizes(self.X)
        whole = math.factorial(surface.gdim - 1) * basix.cell.volume(surface.geometry.cell_type)
        return np.bincount(self.facets, sizes, len(surface.facets)) >= (1 - SLIVER) * whole

    def left(
        self, surface: Surface, facets: npt.NDArray[np.intp]
    ) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
        """What they leave of some of Γ1's facets.

        Returns:
            Simplices: facets, ``(num,)``, and reference coordinates, ``(num, n, n - 1)``.
        """
        corners = basix.geometry(surface.geometry.cell_type)[
            around_corners(surface.facets.shape[1])
        ]
        order = np.argsort(self.facets, kind="stable")
        first, end = (
            np.searchsorted(self.facets[order], facets, side) for side in ("left", "right")
        )
        parts = _ConvexParts.of(np.arange(len(facets)), np.tile(corners, (len(facets), 1, 1)))
        for k in range((end - first).max(initial=0)):
            has = (end - first)[parts.of_facet] > k
            some = parts.some(has)
            less = some.without(self.X[order[first[some.of_facet] + k]])
            parts = _ConvexParts.joined([parts.some(~has), *less])
        i, X = parts.simplices()
        return facets[i], X


@dataclass(frozen=True)
class _ConvexParts:
    """Convex parts of facets: polygons, or intervals."""

    of_facet: npt.NDArray[np.intp]
    """Number of the facet, ``(num,)``."""
    x: npt.NDArray[np.float64]
    """Reference coordinates of the corners, ``(num, most_corners, dim)``."""
    num: npt.NDArray[np.intp]
    """Number of corners, ``(num,)``."""

    @classmethod
    def of(cls, of_facet, x: npt.NDArray[np.float64]) -> "_ConvexParts":
        """Parts with as many corners each."""
        return cls(of_facet, x, np.full(len(x), x.shape[1]))

    def some(self, which) -> "_ConvexParts":
        """Some of them."""
        return _ConvexParts(self.of_facet[which], self.x[which], self.num[which])

    @staticmethod
    def joined(every: Sequence["_ConvexParts"]) -> "_ConvexParts":
        """All of several."""
        most = max(parts.x.shape[1] for parts in every)
        x = [np.pad(p.x, ((0, 0), (0, most - p.x.shape[1]), (0, 0))) for p in every]
        of_facet, num = ([getattr(p, name) for p in every] for name in ("of_facet", "num"))
        return _ConvexParts(np.concatenate(of_facet), np.concatenate(x), np.concatenate(num))

    def simplices(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
        """Simplices that fill them: parts' facets and corners."""
        if self.x.shape[2] == 1:
            return self.of_facet, self.x[:, :2]
        part, k = np.nonzero(np.arange(1, self.x.shape[1] - 1) + 1 < self.num[:, None])
        corners = np.stack((0 * k, k + 1, k + 2), axis=1)
        return self.of_facet[part], self.x[part[:, None], corners]

    def are_some(self) -> npt.NDArray[np.bool_]:
        """Mask of those that are more than round-off."""
        i, X = _ConvexParts(np.arange(len(self.num)), self.x, self.num).simplices()
        return np.bincount(i, _sizes(X), len(self.num)) > ROUND_OFF_FACET

    def without(self, X: npt.NDArray[np.float64]) -> "list[_ConvexParts]":
        """What a simplex leaves of each, ``(num, n, n - 1)``, without round-off."""
        counts, found, part = _sizes(X) > ROUND_OFF_FACET, [], self
        X = np.where(counts[:, None, None], X, np.eye(X.shape[1], X.shape[2], k=-1))
        inverse = np.linalg.inv(np.concatenate((X, np.ones((*X.shape[:2], 1))), axis=2))
        for i in range(X.shape[1]):  # by its barycentric coordinates
            slope, at = inverse[:, :-1, i], inverse[:, -1:, i]
            found.append(part.where_positive(-(np.einsum("pcd,pd->pc", part.x, slope) + at)))
            part = part.where_positive(np.einsum("pcd,pd->pc", part.x, slope) + at)
        meets = counts & part.are_some()
        return [self.some(~meets), *(rest.some(meets & rest.are_some()) for rest in found)]

    def where_positive(self, height: npt.NDArray[np.float64]) -> "_ConvexParts":
        """What of them is where linear functions aren't negative, from values at the corners."""
        (num, most), k = height.shape, np.arange(height.shape[1])
        exists = k < self.num[:, None]
        before = np.where(k > 0, k - 1, np.maximum(self.num[:, None] - 1, 0))
        last = np.take_along_axis(height, before, axis=1)
        cuts = exists & (last * height < 0)
        share = np.divide(last, last - height, out=np.zeros_like(height), where=cuts)[:, :, None]
        start = np.take_along_axis(self.x, before[:, :, None], axis=1)
        x = np.stack((start + share * (self.x - start), self.x), axis=2)
        on = np.stack((cuts, exists & (height >= 0)), axis=2).reshape(num, 2 * most)
        count = on.sum(axis=1)
        order = np.argsort(~on, axis=1, kind="stable")[:, : max(count.max(initial=0), 2), None]
        x = np.take_along_axis(x.reshape(num, 2 * most, x.shape[3]), order, axis=1)
        if x.shape[2] == 1:
            there = np.arange(x.shape[1])[:, None] < count[:, None, None]
            low = np.where(there, x, np.inf).min(axis=1, keepdims=True)
            high = np.where(there, x, -np.inf).max(axis=1, keepdims=True)
            x = np.where(count[:, None, None] > 0, np.concatenate((low, high), axis=1), 0)
            count = np.minimum(count, 2)
        return _ConvexParts(self.of_facet, x, count)


def _sizes(X: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Sizes of simplices, ``(num, n, n - 1)``, in those of a reference cell."""
    return np.abs(np.linalg.det(np.diff(X, axis=1)))


def on_sigma(
    comm: MPI.Comm, columns: OpenColumns, owner: npt.NDArray[np.integer], values, name: str
) -> fem.Function:
    """Values as a function on Σ, constant in each cell. Collective.

    Cells have vertices of their own: two may be at one place, where the gap is closed.

    Args:
        comm: Communicator.
        columns: Σ.
        owner: Rank of a body's cell beside each facet of Γ1.
        values: Of each column, ``(num, …)``.
        name: Name of the function.
    """
    n = columns.x.shape[3]
    cells = np.add.outer(np.arange(n), np.arange(n + 1))  # simplices of a prism
    x = columns.x.reshape(-1, 2 * n, n)[:, cells].reshape(-1, n + 1, n)
    rank, values = (np.repeat(part, n, axis=0) for part in (owner[columns.facets], values))
    return _drawn(comm, x, rank, values[:, None], 0, name)


def on_surface(
    comm: MPI.Comm, surface: Surface, facets: npt.NDArray, X: npt.NDArray, values, name: str
) -> fem.Function:
    """Values as a function on a surface, linear in each of its cells. Collective.

    Cells have vertices of their own.

    Args:
        comm: Communicator.
        surface: The surface; curved facets have straight cells.
        facets: Facet of each cell, ``(num,)``.
        X: Reference coordinates of its corners, ``(num, n, n - 1)``.
        values: There, ``(num, n, …)``.
        name: Name of the function.
    """
    n = surface.gdim
    x = surface.points(np.repeat(facets, n), X.reshape(-1, n - 1)).reshape(-1, n, n)
    return _drawn(comm, x, surface.owner[facets], values, 1, name)


def _drawn(comm: MPI.Comm, x, rank, values, degree: int, name: str) -> fem.Function:
    """Function of degree 0 or 1 on simplices, given on every rank, of which each has some."""
    num, corners, n = x.shape
    nodes, mine = x.reshape(-1, n), rank == comm.rank
    kind = ("interval", "triangle", "tetrahedron")[corners - 2]
    element = basix.ufl.element("Lagrange", kind, 1, shape=(n,))
    numbers = np.arange(len(nodes)).reshape(num, corners)
    mesh, order = distributed(comm, numbers[mine], share(comm, nodes), element)
    shape = values.shape[2:]
    discontinuous = ("Discontinuous Lagrange", degree)
    V = fem.functionspace(mesh, (*discontinuous, shape) if shape else discontinuous)
    f = fem.Function(V, name=name)
    f.x.array.reshape(-1, *shape)[V.dofmap.list] = values[mine][order]
    return f
