# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Dofs in an order that the mesh's input alone decides, whatever the number of ranks.

Cells are ordered as they were given to DOLFINx, and in each the dofs as the element has them: nodes
of a cell keep their order, and dofs lie at the same reference points. A dof comes where it is met
first. Multipliers have no such place: they are ordered by their rows of B, applied to a field of
random numbers that are the same for the same dofs.
"""

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.tolerances import NOTHING
from hypergap_dolfinx.core import compat


class InputOrder:
    """Order of the dofs (blocks) of a space."""

    def __init__(self, V: Any):
        """Gather the numbering on rank 0. Collective.

        Args:
            V: A function space, or a compiled one, as functions of boundary conditions have.
        """
        compiled = getattr(V, "_cpp_object", V)
        mesh, dofmap = compiled.mesh, compiled.dofmap
        self.comm: MPI.Comm = mesh.comm
        self.block_size = dofmap.index_map_bs
        num = mesh.topology.index_map(mesh.topology.dim).size_local
        cells, index_map = dofmap.map()[:num], dofmap.index_map
        dofs = index_map.local_to_global(np.ascontiguousarray(cells).ravel()).reshape(cells.shape)
        original = _places(mesh.topology)
        parts = self.comm.gather((original, dofs, index_map.size_local))
        self.size_local = index_map.size_local * self.block_size
        self._sizes, self._order = list[int](), np.empty(0, dtype=np.int64)
        if parts is not None:
            where, numbers, sizes = zip(*parts, strict=True)
            flat = np.concatenate(numbers)[np.argsort(np.concatenate(where))].ravel()
            found, first = np.unique(flat, return_index=True)
            self._order = found[np.argsort(first)]
            self._sizes = [size * self.block_size for size in sizes]
        self._mesh = mesh

    def places(self, dofs: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
        """Numbers of global dofs (blocks) in this order; on rank 0 alone."""
        at = np.empty(len(self._order), dtype=np.intp)
        at[self._order] = np.arange(len(at))
        return at[dofs]

    def gathered(self, values: npt.NDArray) -> npt.NDArray | None:
        """Values in this order on rank 0, ``(num_dofs, block_size)``. Collective.

        Args:
            values: This rank's values, the owned ones first.
        """
        parts = self.comm.gather(values[: self.size_local])
        if parts is None:
            return None
        return np.concatenate(parts).reshape(-1, self.block_size)[self._order]

    def scattered(self, values: npt.NDArray | None) -> npt.NDArray:
        """This rank's owned values from those on rank 0. Collective."""
        parts = None
        if values is not None:
            flat = np.empty_like(values)
            flat[self._order] = values
            parts = np.split(flat.ravel(), np.cumsum(self._sizes)[:-1])
        return self.comm.scatter(parts)

    def fingerprint(self) -> npt.NDArray[np.float64]:
        """Fingerprint that distinguishes meshes and their orders. Collective."""
        nodes, topology = compat.geometry_dofmap(self._mesh), self._mesh.topology
        original = _places(topology)
        x = self._mesh.geometry.x[nodes[: len(original)]]  # (cell, node, 3)
        phase = original[:, None] + np.arange(nodes.shape[1])
        sums = [np.einsum("cn,cni->i", f(phase), x) for f in (np.cos, np.sin)]
        size = np.abs(x).sum()
        found = self.comm.allreduce(np.concatenate(([len(original), size], *sums)))
        return np.append(found[0], found[1:] / (found[1] or 1))


def random_field(order: InputOrder, seed: int) -> npt.NDArray[np.float64]:
    """Random numbers that are the same for the same dofs; this rank's. Collective."""
    values = None
    if order.comm.rank == 0:
        shape = sum(order._sizes) // order.block_size, order.block_size
        values = np.random.default_rng(seed).random(shape)
    return order.scattered(values)


class RowOrder:
    """Order of a distributed vector's entries by a field of numbers that all differ."""

    def __init__(self, comm: MPI.Comm, key: npt.NDArray[np.float64]):
        """Sort. Collective.

        Args:
            comm: Communicator.
            key: This rank's numbers.
        """
        self._comm, self._order, self._sizes = comm, np.empty(0, dtype=np.intp), list[int]()
        self.key: npt.NDArray[np.float64] | None = None
        """The numbers in this order, on rank 0; None if some are the same."""
        parts = comm.gather(key)
        if parts is not None:
            every = np.concatenate(parts)
            self._sizes, self._order = list(map(len, parts)), np.argsort(every)
            every = every[self._order]
            different = np.diff(every) > NOTHING * np.abs(every).max(initial=0)
            self.key = every if different.all() else None

    def gathered(self, values: npt.NDArray) -> npt.NDArray | None:
        """Values in this order on rank 0. Collective."""
        parts = self._comm.gather(values)
        return None if parts is None else np.concatenate(parts)[self._order]

    def scattered(self, values: npt.NDArray | None) -> npt.NDArray:
        """This rank's values from those on rank 0. Collective."""
        parts = None
        if values is not None:
            flat = np.empty_like(values)
            flat[self._order] = values
            parts = np.split(flat, np.cumsum(self._sizes)[:-1])
        return self._comm.scatter(parts)


def orders_of_multipliers(
    B: Sequence[Sequence[PETSc.Mat | None]], orders: Sequence[InputOrder]
) -> tuple[list[RowOrder], list[RowOrder]]:
    """Orders of the rows of B, and of its columns behind those of the bodies. Collective.

    Args:
        B: B on all dofs, ``[interface][field]``; bodies are the first fields.
        orders: Orders of the bodies' dofs.
    """
    rows, columns, random = [], [], [random_field(o, i) for i, o in enumerate(orders)]
    num_fields = len(B[0]) if B else len(orders)
    keys: list[npt.NDArray | None] = [None] * (num_fields - len(orders))
    for g, row in enumerate(B):
        made = [block for block in row if block]
        comm = made[0].comm.tompi4py()
        total = np.zeros(made[0].getLocalSize()[0])
        for block, field in zip(row, random, strict=False):
            if block is not None:
                total += _product(block, field)
        rows.append(RowOrder(comm, total))
        count = comm.bcast(len(rows[-1]._order))
        numbers = np.random.default_rng(len(orders) + g).random(count) if comm.rank == 0 else None
        mine = rows[-1].scattered(numbers)
        for k, block in enumerate(row[len(orders) :]):
            if block is not None:
                part, before = _product(block, mine, transposed=True), keys[k]
                keys[k] = part if before is None else before + part
    for key in keys:
        assert key is not None
        columns.append(RowOrder(comm, key))
    return rows, columns


def _product(
    B: PETSc.Mat, values: npt.NDArray, *, transposed: bool = False
) -> npt.NDArray[np.float64]:
    """This rank's part of B or Bᵀ times a vector. Collective."""
    left, right = B.createVecLeft(), B.createVecRight()
    x, y = (left, right) if transposed else (right, left)
    x.array[:] = values
    (B.multTranspose if transposed else B.mult)(x, y)
    found = y.array_r.real.copy()
    for vector in (left, right):
        vector.destroy()
    return found


def _places(topology) -> npt.NDArray[np.int64]:
    """Places of this rank's cells in the input of a mesh.

    Raises:
        ValueError: The mesh has none.
    """
    try:
        return topology.original_cell_index[: topology.index_map(topology.dim).size_local]
    except RuntimeError:
        raise ValueError(
            "states need meshes that were read or created, whose cells have an order; one made by "
            "create_submesh has none: write it to a file and read it, or save u.x.array."
        ) from None
