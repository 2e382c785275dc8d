# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The compliances of several ties, as blocks in the place of the zero in [K Bᵀ; B 0]."""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.interface_laws.compliance import Compliance
from hypergap_dolfinx.multipliers.interface import Interface
from hypergap_dolfinx.multipliers.prolongation import Extension


class Compliances:
    """−C of all interfaces: Σ_t E_tgᵀ C_t E_th, with values that may change."""

    def __init__(
        self,
        ties: Sequence[Interface],
        rows: Sequence[dict[int, Extension]],
        num: int,
        unknown: Sequence[str | None],
    ):
        """Make the blocks, with the values of now. Collective.

        Args:
            ties: The ties.
            rows: E of each tie by interface.
            num: Number of interfaces.
            unknown: What messages call ties whose λ is left out somewhere: both sides are
                prescribed there, and they don't give way. None for others.
        """
        self._soft: list[tuple[Compliance, dict[int, Extension]]] = []
        self._unknown: list[tuple[Compliance, str, npt.NDArray]] = []  # where it gave way before
        for tie, row, name in zip(ties, rows, unknown, strict=True):
            if tie.compliance is not None:
                self._soft.append((tie.compliance, row))
                if name:
                    self._unknown.append((tie.compliance, name, tie.compliance.gives_way()))
        self._comm = ties[0].sigma.comm if ties else None
        self.blocks: list[list[PETSc.Mat | None]] = [[None] * num for _ in range(num)]
        """−C, ``[interface][interface]``; None is zero."""
        self._values: list[npt.NDArray] = []
        self.update()

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self._soft)

    def destroy(self):
        """Destroy the PETSc matrices. Collective."""
        for block in (block for row in self.blocks for block in row if block):
            block.destroy()

    def update(self):
        """Take the compliances as they are now. Collective.

        Raises:
            ValueError: A tie gives way that was to tie where both sides are prescribed.
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
            for g, E in row.items():
                left = E.rows_of(C)
                for h, F in row.items():
                    product = F.columns_of(left)
                    self._subtract(g, h, product)
                    product.destroy()
                left.destroy()
            C.destroy()

    def _subtract(self, g: int, h: int, C: PETSc.Mat):
        """Subtract from a block. Collective."""
        before = self.blocks[g][h]
        if before is None:
            before = self.blocks[g][h] = C.copy()
            before.scale(-1.0)
        else:
            before.axpy(-1.0, C, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)

    def apply(self, g: int, multipliers: Sequence[PETSc.Vec], c: PETSc.Vec):
        """Subtract Σ_h C_gh λ_h from c. Collective."""
        for block, multiplier in zip(self.blocks[g], multipliers, strict=True):
            if block is not None:
                block.multAdd(multiplier, c, c)
