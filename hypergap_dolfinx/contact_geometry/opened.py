# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Σ and Γ1 at the present displacements as DOLFINx meshes, with values on them."""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
from dolfinx import fem
from hypergap_dolfinx.mortar.domain import distributed, share
from hypergap_dolfinx.surface.trace import Surface


@dataclass(frozen=True)
class OpenCells:
    """Σ's cells where the bodies are; the same on every rank."""

    x: npt.NDArray[np.float64]
    """Vertices, ``(num_cells, n + 1, n)``."""
    rank: npt.NDArray[np.integer]
    """Rank of a body's cell beside each, ``(num_cells,)``."""
    gap: npt.NDArray[np.float64]
    """Volume over area: mean distance of the bodies, ``(num_cells,)``."""
    pressure: npt.NDArray[np.float64]
    """Mean pressure, ``(num_cells,)``, or traction, ``(num_cells, n)``."""


def on_sigma(comm: MPI.Comm, cells: OpenCells, name: str, values=None) -> fem.Function:
    """The gap, the pressure or other values as a function on Σ, constant in each cell. Collective.

    Cells have vertices of their own: two may be at one place, where the gap is closed.

    Args:
        comm: Communicator.
        cells: Σ.
        name: ``"gap"`` or ``"pressure"``, or the name of other values.
        values: Other values, ``(num_cells, num)``.
    """
    n = cells.x.shape[2]
    x = cells.x.reshape(-1, n)
    kind = {2: "triangle", 3: "tetrahedron"}[n]
    element = basix.ufl.element("Lagrange", kind, 1, shape=(n,))
    vertices = np.arange(len(x)).reshape(-1, n + 1)
    mine = cells.rank == comm.rank
    mesh, order = distributed(comm, vertices[mine], share(comm, x), element)
    values = (getattr(cells, name) if values is None else values)[mine]
    shape = values.shape[1:]
    kind = "Discontinuous Lagrange"
    V = fem.functionspace(mesh, (kind, 0, shape) if shape else (kind, 0))
    f = fem.Function(V, name=name)
    f.x.array.reshape(-1, *shape)[V.dofmap.list.ravel()] = values[order]
    return f


def on_surface(
    comm: MPI.Comm, surface: Surface, parts: Sequence[tuple[npt.NDArray, npt.NDArray]], values, name
) -> fem.Function:
    """Values as a function on a surface, linear in each of its cells. Collective.

    Cells have vertices of their own.

    Args:
        comm: Communicator.
        surface: The surface; curved facets have straight cells.
        parts: Facets, and the corners of simplices on the reference facet that are cells of each.
        values: Gives values at points: of facets, ``(num,)``, and reference coordinates,
            ``(num_points, dim)``.
        name: Name of the function.
    """
    n = surface.gdim
    x, rank, at = [], [], []
    for facets, corners in parts:
        X = corners.reshape(-1, n - 1)
        points = surface.points(np.repeat(facets, len(X)), np.tile(X, (len(facets), 1)))
        found = values(facets, X)
        x.append(points.reshape(-1, n, n))
        at.append(found.reshape(-1, n, *found.shape[2:]))
        rank.append(np.repeat(surface.owner[facets], len(corners)))
    nodes = np.concatenate(x).reshape(-1, n)
    kind = {2: "interval", 3: "triangle"}[n]
    element = basix.ufl.element("Lagrange", kind, 1, shape=(n,))
    numbers = np.arange(len(nodes)).reshape(-1, n)
    mine = np.concatenate(rank) == comm.rank
    mesh, order = distributed(comm, numbers[mine], share(comm, nodes), element)
    everything = np.concatenate(at)[mine]
    shape = everything.shape[2:]
    discontinuous = ("Discontinuous Lagrange", 1)
    V = fem.functionspace(mesh, (*discontinuous, shape) if shape else discontinuous)
    f = fem.Function(V, name=name)
    f.x.array.reshape(-1, *shape)[V.dofmap.list] = everything[order]
    return f
