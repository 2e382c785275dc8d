# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Sparse matrices of PETSc: norms, nonzero columns, products, assembly from triplets."""

from collections.abc import Callable

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.compat import set_triplets


def row_length(A: PETSc.Mat) -> float:
    """Root mean square of the Euclidean norms of the rows. Collective."""
    return A.norm() / (A.getSize()[0] or 1) ** 0.5


def column_length(A: PETSc.Mat, columns: npt.NDArray) -> float:
    """Root mean square of the Euclidean norms of the rows, restricted to some columns. Collective.

    Args:
        A: The matrix.
        columns: Local numbers of this rank's columns.
    """
    part, mask = A.copy(), A.createVecRight()
    mask.set(0.0)
    mask.array[columns] = 1.0
    part.diagonalScale(R=mask)
    length = row_length(part)
    for obj in (part, mask):
        obj.destroy()
    return length


def mean_diagonal(K: PETSc.Mat) -> float:
    """Mean absolute value on the diagonal. Collective."""
    diagonal = K.getDiagonal()
    mean = diagonal.norm(PETSc.NormType.NORM_1) / diagonal.getSize()
    diagonal.destroy()
    return mean


def nonzero_columns(
    B: PETSc.Mat, rows: npt.NDArray[np.bool_] | None = None
) -> npt.NDArray[np.intp]:
    """Local numbers of this rank's columns with nonzero entries. Collective.

    Args:
        B: The matrix.
        rows: Mask of this rank's rows that count, ``(num_rows,)``; all if not given.
    """
    magnitudes, y, sums = absolute(B), B.createVecLeft(), B.createVecRight()
    y.array[:] = 1.0 if rows is None else rows
    magnitudes.multTranspose(y, sums)
    found = np.flatnonzero(sums.array_r)
    for obj in (magnitudes, y, sums):
        obj.destroy()
    return found


def absolute(B: PETSc.Mat) -> PETSc.Mat:
    """A copy with absolute values. Collective."""
    result = B.copy()
    rows, columns, values = B.getValuesCSR()
    result.setValuesCSR(rows, columns, np.abs(values))
    result.assemble()
    return result


def of_columns(
    act: Callable[[PETSc.Vec, PETSc.Vec], None],
    vectors: tuple[PETSc.Vec, PETSc.Vec],
    columns: npt.NDArray,
) -> npt.NDArray:
    """A linear operator of PETSc applied to each column of an array. Collective.

    Args:
        act: The operator: takes a vector, and writes into another.
        vectors: Work vectors for both; they are destroyed.
        columns: This rank's rows.

    Returns:
        The images of the columns, with the rows of the second vector, of PETSc's scalar type.
    """
    x, y = vectors
    found = np.empty((y.getLocalSize(), columns.shape[1]), dtype=PETSc.ScalarType)
    for k, column in enumerate(columns.T):
        x.array[:] = column
        act(x, y)
        found[:, k] = y.array_r
    for vector in vectors:
        vector.destroy()
    return found


def product(A: PETSc.Mat, columns: npt.NDArray) -> npt.NDArray:
    """Product of a matrix and several vectors, as :func:`of_columns`. Collective."""
    return of_columns(A.mult, A.createVecs(), columns)


def coo_matrix(comm: MPI.Comm, sizes, i, j, values) -> PETSc.Mat:
    """An AIJ matrix from (row, column, value) triplets; duplicates are added. Collective.

    Args:
        comm: Communicator.
        sizes: Local numbers of rows and columns.
        i: Global rows, on any rank.
        j: Global columns.
        values: Values.

    Returns:
        The assembled matrix.
    """
    rows, columns = sizes
    A = PETSc.Mat().create(comm)
    A.setSizes(((rows, None), (columns, None)))
    A.setType(PETSc.Mat.Type.AIJ)
    values = np.ascontiguousarray(values, dtype=PETSc.ScalarType)
    set_triplets(A, np.ravel(i), np.ravel(j), values.ravel())
    return A


def triplets(B: PETSc.Mat) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
    """Global rows, global columns and real parts of the entries of this rank's rows."""
    start, end = B.getOwnershipRange()
    indptr, columns, values = B.getValuesCSR()
    return np.repeat(np.arange(start, end), np.diff(indptr)), columns, values.real
