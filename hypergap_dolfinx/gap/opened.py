# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Σ between bodies where they are now as a DOLFINx mesh, with the pressure and the gap on it."""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx
from dolfinx import fem
from hypergap_dolfinx import compat


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
    """Mean pressure, ``(num_cells,)``."""


def on_sigma(comm: MPI.Comm, cells: OpenCells, name: str) -> fem.Function:
    """The gap or the pressure as a function on Σ, constant in each cell. Collective.

    Cells have vertices of their own: two may be at one place, where the gap is closed.

    Args:
        comm: Communicator.
        cells: Σ.
        name: ``"gap"`` or ``"pressure"``.
    """
    num_vertices, n = cells.x.shape[1:]
    mine = np.flatnonzero(cells.rank == comm.rank)
    nodes = cells.x.reshape(-1, n) if comm.rank == 0 else np.empty((0, n))
    kind = {2: "triangle", 3: "tetrahedron"}[n]

    def stay(comm, num_parts, cell_types, cells):
        return compat.destinations(np.full(len(mine), comm.rank, dtype=np.int32))

    mesh = dolfinx.mesh.create_mesh(
        comm,
        mine[:, None] * num_vertices + np.arange(num_vertices),
        e=basix.ufl.element("Lagrange", kind, 1, shape=(n,)),
        x=nodes,
        partitioner=stay,
    )
    start = sum(comm.allgather(len(mine))[: comm.rank])
    order = mine[mesh.topology.original_cell_index - start]
    V = fem.functionspace(mesh, ("Discontinuous Lagrange", 0))
    f = fem.Function(V, name=name)
    f.x.array[V.dofmap.list.ravel()] = getattr(cells, name)[order]
    return f
