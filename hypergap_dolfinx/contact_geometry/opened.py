# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Σ between bodies where they are now as a DOLFINx mesh, with the pressure and the gap on it."""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
from dolfinx import fem
from hypergap_dolfinx.mortar.domain import distributed


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
    mesh, order = distributed(comm, vertices, x, cells.rank, element)
    values = getattr(cells, name) if values is None else values
    shape = values.shape[1:]
    kind = "Discontinuous Lagrange"
    V = fem.functionspace(mesh, (kind, 0, shape) if shape else (kind, 0))
    f = fem.Function(V, name=name)
    f.x.array.reshape(-1, *shape)[V.dofmap.list.ravel()] = values[order]
    return f
