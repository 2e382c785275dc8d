# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Compliances and laws of ties as blocks of the saddle-point system, with λ = E λ' of multipliers.

A compliance enters as the block −C in place of the zero, [K Bᵀ; B −C], with C = Σ_t E_tᵀ C_t E_t.
A law λ = f(w) makes the jump w a field beside the bodies', with a stiffness ∂F/∂w and a coupling
−M to λ: F(w) − M λ = 0 and Σ_i B_i u_i − M w = c.
"""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.sparse import coo_matrix, nonzero_columns, triplets
from hypergap_dolfinx.interface_laws.compliance import Compliance
from hypergap_dolfinx.multipliers.interface import Interface


class Extension:
    """E in λ = E λ': λ of a tie, λ' of an interface; without a matrix if it is the identity."""

    def __init__(self, matrix: PETSc.Mat | None = None):
        """Take a matrix, which is owned here; without one it is the identity."""
        self.matrix = matrix

    def destroy(self):
        """Destroy the PETSc matrix. Collective."""
        if self.matrix is not None:
            self.matrix.destroy()

    def add(self, multipliers: PETSc.Vec, full: PETSc.Vec):
        """Add E λ' to all multipliers of the tie. Collective."""
        if self.matrix is None:
            full.axpy(1.0, multipliers)
        else:
            self.matrix.multAdd(multipliers, full, full)

    def add_transposed(self, rows: PETSc.Vec, c: PETSc.Vec):
        """Add Eᵀ times the tie's rows to the interface's. Collective."""
        if self.matrix is None:
            c.axpy(1.0, rows)
        else:
            self.matrix.multTransposeAdd(rows, c, c)

    def rows_of(self, B: PETSc.Mat) -> PETSc.Mat:
        """Eᵀ B, a new matrix. Collective."""
        return B.copy() if self.matrix is None else self.matrix.transposeMatMult(B)

    def columns_of(self, C: PETSc.Mat) -> PETSc.Mat:
        """C E, a new matrix. Collective."""
        return C.copy() if self.matrix is None else C.matMult(self.matrix)

    def reached(self) -> slice | npt.NDArray[np.intp]:
        """This rank's multipliers of the interface that the tie uses. Collective."""
        return slice(None) if self.matrix is None else nonzero_columns(self.matrix)


class Compliances:
    """Blocks −C_gh = −Σ_t E_tgᵀ C_t E_th of interfaces g and h, with values that may change."""

    def __init__(
        self,
        ties: Sequence[Interface],
        rows: Sequence[dict[int, Extension]],
        num: int,
        unknown: Sequence[str | None],
    ):
        """Make the blocks with the present values. Collective.

        Args:
            ties: The ties.
            rows: E of each tie by interface.
            num: Number of interfaces.
            unknown: Names, for messages, of ties with places without λ: both sides are
                prescribed there, and the compliance is 0. None for other ties.
        """
        self._soft: list[tuple[Compliance, dict[int, Extension]]] = []
        self._unknown: list[tuple[Compliance, str, npt.NDArray]] = []  # and mask of nonzeros
        for tie, row, name in zip(ties, rows, unknown, strict=True):
            if tie.compliance is not None:
                self._soft.append((tie.compliance, row))
                if name:
                    self._unknown.append((tie.compliance, name, tie.compliance.gives_way()))
        self._comm = ties[0].domain.comm if ties else None
        self.blocks: list[list[PETSc.Mat | None]] = [[None] * num for _ in range(num)]
        """−C, ``[interface][interface]``; None is zero."""
        self._values: list[npt.NDArray] = []
        self.update()

    def __bool__(self) -> bool:
        """True if any tie has a compliance."""
        return bool(self._soft)

    def destroy(self):
        """Destroy the PETSc matrices. Collective."""
        for block in (block for row in self.blocks for block in row if block):
            block.destroy()

    def update(self):
        """Update the blocks if a compliance has changed. Collective.

        Raises:
            ValueError: A compliance is no longer 0 where both sides are prescribed.
        """
        if not self._soft:
            return
        now = [soft.values() for soft, _ in self._soft]
        assert self._comm is not None
        same = bool(self._values) and all(map(np.array_equal, self._values, now))
        if all(self._comm.allgather(same)):
            return
        for soft, name, before in self._unknown:
            if (soft.gives_way() & ~before).any():
                raise ValueError(
                    f"the compliance of {name} was 0 when the problem was made, where both sides "
                    "are prescribed, so it has no λ there; make the problem anew as it is now."
                )
        self._values = now
        for block in (block for row in self.blocks for block in row if block):
            block.zeroEntries()
        for (soft, row), values in zip(self._soft, self._values, strict=True):
            C = soft.matrix(values)
            C.scale(-1.0)
            for g, E in row.items():
                left = E.rows_of(C)
                for h, F in row.items():
                    product, before = F.columns_of(left), self.blocks[g][h]
                    if before is None:
                        self.blocks[g][h] = product
                    else:
                        before.axpy(1.0, product)
                        product.destroy()
                left.destroy()
            C.destroy()

    def apply(self, g: int, multipliers: Sequence[PETSc.Vec], c: PETSc.Vec):
        """Subtract Σ_h C_gh λ_h from c. Collective."""
        for block, multiplier in zip(self.blocks[g], multipliers, strict=True):
            if block is not None:
                block.multAdd(multiplier, c, c)


class JumpField:
    """The jump w = P w' of one tie, in the same space as its λ = Σ_g E_g λ'_g.

    If multipliers are missing, λ follows its neighbours, and so does the jump: the law never gives
    a traction that no multiplier can balance.
    """

    def __init__(self, tie: Interface, rows: dict[int, Extension]):
        """Make the blocks, with the tangent for a jump of zero. Collective.

        Args:
            tie: The tie.
            rows: E by interface.
        """
        assert tie.law is not None
        self._law, self._block_size = tie.law, tie.block_size
        M = self._law.mass()
        self._P = _joined(rows, M)
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
        """Tangent stiffness ∂F/∂w'."""

    def destroy(self):
        """Destroy the PETSc objects, but the blocks. Collective."""
        for obj in (self._P, self._w, self.K):
            obj.destroy()

    @property
    def linear(self) -> bool:
        """True if F is linear."""
        return self._law.linear

    def _at(self) -> tuple[npt.NDArray, npt.NDArray]:
        """Forces F(w) and their slopes."""
        return self._law.at(self._w.array_r.reshape(-1, self._block_size))

    def _tangent(self) -> PETSc.Mat:
        """Pᵀ ∂F/∂w P, a new matrix. Collective."""
        _, slope = self._at()
        whole = self._law.tangent(slope)
        left = self._P.rows_of(whole)
        K = self._P.columns_of(left)
        for obj in (whole, left):
            obj.destroy()
        return K

    def take(self, jump: PETSc.Vec):
        """Take w'. Collective."""
        self._w.set(0.0)
        self._P.add(jump, self._w)

    def update(self):
        """Update the tangent to w', for the parameters that the law has now. Collective."""
        now = self._tangent()
        self.K.zeroEntries()
        self.K.axpy(1.0, now, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        now.destroy()

    def add_force(self, b: PETSc.Vec):
        """Add PᵀF(w) to a vector. Collective."""
        force = self._w.duplicate()
        force.array[:] = self._at()[0].ravel()
        self._P.add_transposed(force, b)
        force.destroy()


def _joined(rows: dict[int, Extension], M: PETSc.Mat) -> Extension:
    """P: the nonempty columns of all E_g, side by side on the rank of each. Collective."""
    if all(E.matrix is None for E in rows.values()):
        return Extension()
    comm = M.comm.tompi4py()
    mine = {g: nonzero_columns(E.matrix) for g, E in rows.items()}
    counts = np.array(comm.allgather([len(columns) for columns in mine.values()]))  # (rank, g)
    before = np.cumsum(np.append(0, counts.ravel()))[:-1].reshape(counts.shape)
    parts = []
    for k, (g, columns) in enumerate(mine.items()):
        E = rows[g].matrix
        assert E is not None
        used = np.concatenate(comm.allgather(columns + E.getOwnershipRangeColumn()[0]))
        number = np.concatenate(
            [np.arange(num) + at for num, at in zip(counts[:, k], before[:, k])]
        )
        i, j, value = triplets(E)
        has = value != 0
        parts.append((i[has], number[np.searchsorted(used, j[has])], value[has]))
    sizes = M.getLocalSize()[0], int(counts[comm.rank].sum())
    entries = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Extension(coo_matrix(comm, sizes, *entries))
