# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Sizes of matrices, and where they have entries."""

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt


def row_length(A: PETSc.Mat) -> float:
    """Root mean square of the lengths of a matrix's rows. Collective."""
    return A.norm() / (A.getSize()[0] or 1) ** 0.5


def mean_diagonal(K: PETSc.Mat) -> float:
    """Mean of the diagonal. Collective."""
    diagonal = K.getDiagonal()
    mean = diagonal.sum() / diagonal.getSize()
    diagonal.destroy()
    return mean


def column_sums(B: PETSc.Mat) -> PETSc.Vec:
    """Sums of the absolute values in each column. Collective."""
    sums = B.createVecRight()
    sums.set(0.0)
    _, columns, values = B.getValuesCSR()
    sums.setValues(columns, np.abs(values), addv=PETSc.InsertMode.ADD)
    sums.assemble()
    return sums


def nonzero_columns(B: PETSc.Mat) -> npt.NDArray[np.intp]:
    """Which of this rank's columns aren't empty, numbered from 0. Collective."""
    sums = column_sums(B)
    found = np.flatnonzero(sums.array_r)
    sums.destroy()
    return found
