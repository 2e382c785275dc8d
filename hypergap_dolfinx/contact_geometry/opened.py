# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Σ and Γ1 at the present displacements as DOLFINx meshes, with values on them."""

import math
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
        sizes = np.abs(np.linalg.det(np.diff(self.X, axis=1)))
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
        found = []
        for f in facets:
            parts = [corners]
            for X in self.X[self.facets == f]:
                parts = [rest for part in parts for rest in _without(part, X)]
            found += [(f, X) for part in parts for X in _simplices(part)]
        on, X = zip(*found, strict=True) if found else ((), ())
        return np.array(on, dtype=np.intp), np.reshape(X, (-1, *self.X.shape[1:]))


def _simplices(part: npt.NDArray[np.float64]) -> list[npt.NDArray[np.float64]]:
    """Simplices that fill a convex polygon, or an interval."""
    if part.shape[1] == 1:
        return [part] if len(part) == 2 else []
    return [part[[0, k, k + 1]] for k in range(1, len(part) - 1)]


def _size(simplex: npt.NDArray[np.float64]) -> float:
    return abs(float(np.linalg.det(np.diff(simplex, axis=0))))


def _without(part: npt.NDArray[np.float64], simplex) -> list[npt.NDArray[np.float64]]:
    """Convex parts of what a simplex leaves of a convex part, without round-off."""
    if _size(simplex) <= ROUND_OFF_FACET:
        return [part]
    found = []
    for i in range(len(simplex)):  # by its barycentric coordinates
        x, corners = (np.vstack((points.T, np.ones(len(points)))) for points in (part, simplex))
        height = np.linalg.solve(corners, x)[i]
        found.append(_where_positive(part, -height))
        part = _where_positive(part, height)
    return [x for x in found if sum(map(_size, _simplices(x))) > ROUND_OFF_FACET]


def _where_positive(part: npt.NDArray[np.float64], height) -> npt.NDArray[np.float64]:
    """Convex part where a linear function isn't negative, from its values at the corners."""
    found = []
    for k in range(len(part)):
        before, here = height[k - 1], height[k]
        if before * here < 0:
            found.append(part[k - 1] + before / (before - here) * (part[k] - part[k - 1]))
        if here >= 0:
            found.append(part[k])
    if part.shape[1] == 1 and found:
        found = [min(found), max(found)]
    return np.reshape(found, (-1, part.shape[1]))


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
