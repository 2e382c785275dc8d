# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""A tie's multipliers as those that an interface has: λ = E λ'."""

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.matrices import nonzero_columns


class Extension:
    """E, mostly the identity, of which there is no matrix then."""

    def __init__(self, matrix: PETSc.Mat | None = None):
        """With a matrix, which it owns, or as the identity without one."""
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
        """Which of the interface's multipliers on this rank the tie has. Collective."""
        return slice(None) if self.matrix is None else nonzero_columns(self.matrix)
