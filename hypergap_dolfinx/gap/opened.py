# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Σ between bodies where they are now as a DOLFINx mesh, with the pressure and the gap on it."""

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx
from dolfinx import fem
from hypergap_dolfinx import compat
from hypergap_dolfinx.gap import weighted
from hypergap_dolfinx.gap.opening import Displacements, Opening
from hypergap_dolfinx.gap.surface import tabulate


def pressure(
    comm: MPI.Comm, opening: Opening, u: Displacements, p: npt.NDArray[np.float64]
) -> fem.Function:
    """Σ_a w_a p_a on Σ, discontinuous. Collective.

    Args:
        comm: Communicator.
        opening: Σ.
        u: Displacements of both sides.
        p: Multipliers, ``(num_multipliers,)``.
    """
    values = np.einsum("cpb,cb->cp", opening.w, opening.at_cells(p))
    return _on_sigma(comm, opening, u, values, "pressure")


def gap(
    comm: MPI.Comm, opening: Opening, u: Displacements, *, follows: bool = True
) -> fem.Function:
    """The normal gap on Σ, eq. (17) of positions, discontinuous. Collective.

    Args:
        comm: Communicator.
        opening: Σ.
        u: Displacements of both sides.
        follows: Whether the gap is that of the bodies where they are, or linear in u.
    """
    now = opening.positions(u)
    x = now if follows else opening.positions((np.zeros_like(u[0]), np.zeros_like(u[1])))
    num_points = len(opening.points)
    each = np.broadcast_to(np.eye(num_points), (len(x), num_points, num_points))
    cells = weighted.weigh(opening.table, x, opening.alpha, each)
    volume = cells.g + np.einsum("cpmi,cmi->cp", cells.dg, now - x)
    values = np.divide(volume, cells.m, out=np.zeros_like(volume), where=cells.m > 0)
    return _on_sigma(comm, opening, u, values, "gap")


def _on_sigma(
    comm: MPI.Comm, opening: Opening, u: Displacements, values, name: str
) -> fem.Function:
    """A function on Σ from values at its cells' Gauss points, by least squares. Collective.

    Each cell has nodes of its own: they may be at one place, where the gap is closed.
    """
    x, k = opening.positions(u), opening.element.degree
    n, num_nodes = x.shape[2], x.shape[1]
    mine = np.flatnonzero(opening.rank == comm.rank)
    nodes = x.reshape(-1, n) if comm.rank == 0 else np.empty((0, n))
    cells = mine[:, None] * num_nodes + np.arange(num_nodes)
    coordinates = basix.ufl.element(
        "Lagrange",
        opening.element.cell_type.name,
        k,
        lagrange_variant=opening.element.lagrange_variant,
        shape=(n,),
    )

    def stay(comm, num_parts, cell_types, cells):
        return compat.destinations(np.full(len(mine), comm.rank, dtype=np.int32))

    mesh = dolfinx.mesh.create_mesh(comm, cells, e=coordinates, x=nodes, partitioner=stay)
    start = sum(comm.allgather(len(mine))[: comm.rank])
    order = mine[mesh.topology.original_cell_index - start]
    V = fem.functionspace(mesh, ("Discontinuous Lagrange", k - 1))
    f = fem.Function(V, name=name)
    T = tabulate(V.ufl_element().basix_element, opening.points)
    weights = opening.table.weights[:, None]
    fit = np.linalg.solve(T.T @ (weights * T), (weights * T).T)  # (dof, point)
    f.x.array[V.dofmap.list] = values[order] @ fit.T
    return f
