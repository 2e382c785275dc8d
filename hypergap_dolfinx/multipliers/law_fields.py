# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Jumps w of interfaces with a law λ = f(w): fields beside the bodies', with a stiffness each."""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.matrices import nonzero_columns
from hypergap_dolfinx.mortar.constraint import coo_matrix, triplets
from hypergap_dolfinx.multipliers.interface import Interface
from hypergap_dolfinx.multipliers.prolongation import Extension


class Opening:
    """The jump w = P w' of one tie, in the space that its λ = Σ_g E_g λ'_g has left.

    Where multipliers are missing, λ follows its neighbours, and the jump does too: so the law is
    never asked for a traction that it doesn't have there.
    """

    def __init__(self, tie: Interface, rows: dict[int, Extension]):
        """Make the blocks, with the tangent where nothing has opened. Collective.

        Args:
            tie: The tie.
            rows: E by interface.
        """
        assert tie.law is not None
        self._law, self._block_size = tie.law, tie.block_size
        M = self._law.mass()
        self._P = Extension() if _is_whole(rows) else Extension(_reached(rows, M))
        MP = self._P.columns_of(M)
        self.blocks: dict[int, PETSc.Mat] = {}
        """−Eᵀ M P, by interface."""
        for g, E in rows.items():
            self.blocks[g] = E.rows_of(MP)
            self.blocks[g].scale(-1.0)
        self._w = M.createVecRight()
        for obj in (M, MP):
            obj.destroy()
        self._w.set(0.0)
        self.K: PETSc.Mat = self._tangent()
        """∂F/∂w'."""

    def destroy(self):
        """Destroy the PETSc objects, but the blocks. Collective."""
        for obj in (self._P, self._w, self.K):
            obj.destroy()

    @property
    def linear(self) -> bool:
        """Whether F is."""
        return self._law.linear

    def _rows(self) -> npt.NDArray:
        """w, ``(num_multipliers, block_size)`` of this rank."""
        return self._w.array_r.reshape(-1, self._block_size)

    def _tangent(self) -> PETSc.Mat:
        """Pᵀ ∂F/∂w P, a new matrix. Collective."""
        _, slope = self._law.at(self._rows())
        whole = self._law.tangent(slope)
        left = self._P.rows_of(whole)
        K = self._P.columns_of(left)
        for obj in (whole, left):
            obj.destroy()
        return K

    def take(self, opening: PETSc.Vec):
        """Take w' as it is now. Collective."""
        self._w.set(0.0)
        self._P.add(opening, self._w)

    def update(self):
        """The tangent of the law as it is now, for what was taken. Collective."""
        now = self._tangent()
        self.K.zeroEntries()
        self.K.axpy(1.0, now, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        now.destroy()

    def add_force(self, b: PETSc.Vec):
        """Add PᵀF(w) to a vector. Collective."""
        force = self._w.duplicate()
        force.array[:] = self._law.at(self._rows())[0].ravel()
        self._P.add_transposed(force, b)
        force.destroy()


def _is_whole(rows: dict[int, Extension]) -> bool:
    """Whether E is the identity."""
    return len(rows) == 1 and next(iter(rows.values())).matrix is None


def _reached(rows: dict[int, Extension], M: PETSc.Mat) -> PETSc.Mat:
    """The columns of all E that aren't empty, side by side on the rank of each. Collective."""
    comm = M.comm.tompi4py()
    mine = {g: nonzero_columns(E.matrix) for g, E in rows.items()}
    counts = np.array(comm.allgather([len(columns) for columns in mine.values()]))  # (rank, g)
    before = np.cumsum(np.append(0, counts.ravel()))[:-1].reshape(counts.shape)
    parts = []
    for k, (g, columns) in enumerate(mine.items()):
        E = rows[g].matrix
        assert E is not None
        every = np.concatenate(comm.allgather(columns + E.getOwnershipRangeColumn()[0]))
        number = np.concatenate(
            [np.arange(num) + at for num, at in zip(counts[:, k], before[:, k])]
        )
        i, j, value = triplets(E)
        has = value != 0
        parts.append((i[has], number[np.searchsorted(every, j[has])], value[has]))
    sizes = M.getLocalSize()[0], int(counts[comm.rank].sum())
    return coo_matrix(comm, sizes, *(np.concatenate(part) for part in zip(*parts, strict=True)))


def openings(ties: Sequence[Interface], rows: Sequence[dict[int, Extension]]) -> list[Opening]:
    """Those of all ties with a law that has multipliers. Collective.

    Args:
        ties: The ties.
        rows: E of each tie by interface.
    """
    return [
        Opening(tie, row)
        for tie, row in zip(ties, rows, strict=True)
        if tie.law is not None and row
    ]
