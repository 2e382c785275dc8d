# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Levels of multigrid for bodies with constraints between them, from each body's own aggregates.

Smoothed aggregation (PETSc's GAMG) makes prolongators of each stiffness :math:`K_i` alone, with the
body's own rigid motions. Joined block by block, :math:`P`, they coarsen the matrix
:math:`K + B^T W B` with springs W across gaps:

.. math:: P^T (K + B^T W B) P = P^T K P + (BP)^T W (BP).

Aggregates that reach across an interface would have one set of rigid motions for both sides, so
that on coarse levels bodies could not slide. Prolongators know nothing of B: they serve all sets of
constraints, and :math:`P^T K P` is computed only if K changes. At first it is that of GAMG itself.

Smoothing reads the levels' matrices many times, and memory takes the time. So real ones that are
symmetric are stored by their upper halves, in blocks, and springs are applied as
:math:`B^T W (B x)` beside them. For its smoother each level needs the largest eigenvalue of
its matrix over the diagonal. On the finest level springs change it by a few percent, and it is kept
as long as K is. On coarser levels they may double it.
"""

from collections.abc import Sequence
from math import gcd

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.tolerances import UNSYMMETRIC
from hypergap_dolfinx.core.sparse import mean_diagonal


def nest(blocks: Sequence[Sequence[PETSc.Mat | None]], comm) -> PETSc.Mat:
    """Blocks as one matrix for vectors that aren't nested. Collective."""
    matrix = PETSc.Mat().createNest(blocks, comm=comm)
    matrix.setNestVecType("standard")
    matrix.assemble()
    return matrix


def block_diagonal(blocks: Sequence[PETSc.Mat]) -> PETSc.Mat:
    """Blocks along the diagonal as a nested matrix. Collective."""
    num = range(len(blocks))
    return nest(
        [[b if i == j else None for j in num] for i, b in enumerate(blocks)], blocks[0].comm
    )


def _joined(blocks: Sequence[PETSc.Mat]) -> PETSc.Mat:
    """Blocks along the diagonal as an AIJ matrix of its own. Collective."""
    nested = block_diagonal(blocks)
    found = nested.convert("aij", PETSc.Mat())
    nested.destroy()
    return found


class _Body:
    """Prolongators of a body alone and its Galerkin products, from the finest level on."""

    def __init__(self, K: PETSc.Mat, modes: npt.NDArray[np.float64] | None, prefix: str):
        """Make the aggregates. Collective."""
        vectors = [K.createVecRight() for _ in (() if modes is None else modes.T)]
        for vector, mode in zip(vectors, () if modes is None else modes.T, strict=True):
            vector.array[:] = mode
        if vectors:
            near = PETSc.NullSpace().create(vectors=vectors, comm=K.comm)
            K.setNearNullSpace(near)
            near.destroy()
        pc = PETSc.PC().create(K.comm)
        pc.setOptionsPrefix(prefix)
        pc.setOperators(K)
        pc.setFromOptions()
        pc.setUp()
        levels = range(pc.getMGLevels() - 1, 0, -1)
        self.P = [pc.getMGInterpolation(level) for level in levels]
        self.products = [pc.getMGSmoother(level - 1).getOperators()[1] for level in levels]
        for obj in (pc, *vectors):
            obj.destroy()
        self._coarsest = self.products[-1] if self.products else K

    def lengthen(self, num: int):
        """Repeat the coarsest level until there are so many prolongators. Collective."""
        K = self._coarsest
        while len(self.P) < num:
            one = PETSc.Mat().createConstantDiagonal(K.getSizes(), 1.0, K.comm)
            self.P.append(one.convert("aij"))
            self.products.append(K.copy())


class _Sprung:
    """K + BᵀWB of one level as the context of a Python matrix."""

    def __init__(self, K: PETSc.Mat, springs: PETSc.Mat):
        """Take the matrices, of which the springs √W B become its own."""
        self._K, self._springs, self._c = K, springs, springs.createVecLeft()

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec):
        """Apply it. Collective."""
        self._K.mult(x, y)
        self._springs.mult(x, self._c)
        self._springs.multTransposeAdd(self._c, y, y)

    def multTranspose(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec):
        """Apply its transpose. Collective."""
        self._K.multTranspose(x, y)
        self._springs.mult(x, self._c)
        self._springs.multTransposeAdd(self._c, y, y)

    def getDiagonal(self, matrix: PETSc.Mat, diagonal: PETSc.Vec):
        """The diagonal. Collective."""
        squares, one = self._springs.copy(), self._c.duplicate()
        rows, columns, values = squares.getValuesCSR()
        squares.setValuesCSR(rows, columns, values**2)
        squares.assemble()
        one.set(1.0)
        self._K.getDiagonal(diagonal)
        squares.multTransposeAdd(one, diagonal, diagonal)
        for obj in (squares, one):
            obj.destroy()

    def destroy(self, matrix: PETSc.Mat):
        """Destroy the springs. Collective."""
        for obj in (self._springs, self._c):
            obj.destroy()


class Hierarchy:
    """Prolongators of several bodies and Galerkin products on all levels."""

    OPTIONS = {  # noqa: RUF012
        "pc_type": "gamg",
        # Of these multigrids only the prolongators are used
        "mg_levels_ksp_type": "richardson",
        "mg_levels_pc_type": "none",
        "mg_coarse_ksp_type": "preonly",
        "mg_coarse_pc_type": "none",
    }
    """Options of each body's PC."""

    def __init__(
        self, K: Sequence[PETSc.Mat], modes: Sequence[npt.NDArray[np.float64] | None], prefix: str
    ):
        """Make the aggregates. Collective.

        Args:
            K: Stiffness of each body.
            modes: This rank's rows of its rigid motions, or None for constants.
            prefix: Prefix of the options of each body's PC.
        """
        bodies = [_Body(*of, prefix) for of in zip(K, modes, strict=True)]
        for body in bodies:
            body.lengthen(max(len(of.P) for of in bodies))
        levels = list(zip(*(of.products for of in bodies), strict=True))
        self._P = [_joined(blocks) for blocks in zip(*(of.P for of in bodies), strict=True)]
        self._products = [_joined(blocks) for blocks in levels]
        self._block_sizes = [gcd(*(k.getBlockSize() for k in of)) for of in (K, *levels)]
        for matrix in (matrix for of in bodies for matrix in (*of.P, *of.products)):
            matrix.destroy()
        self._num_updates = 0
        self._stiffness: list[PETSc.Mat] = []
        self._levels: list[PETSc.Mat] = []
        self._largest: float | None = None  # eigenvalue of the finest level

    def set_stiffness(self, K: PETSc.Mat, ksp: PETSc.KSP):
        """Compute PᵀKP on all levels; the first stiffness is that of the aggregates. Collective.

        Args:
            K: All bodies' stiffness as one AIJ matrix, which becomes the hierarchy's.
            ksp: The KSP that will have the levels.
        """
        if self._num_updates:
            before, self._products = self._products, []
            for level, P in enumerate(self._P):
                fine, last = self._products[-1] if level else K, before[level]
                self._products.append(fine.ptap(P, last if self._num_updates > 1 else None))
                if self._num_updates == 1:
                    last.destroy()  # a product of GAMG's
        self._num_updates += 1
        self._largest = None
        self._scale = 1.0 / mean_diagonal(K)  # PETSc tells zero pivots by size, without a unit
        self._is_assembled = _needs_entries(ksp) or _asymmetry(K) > UNSYMMETRIC
        for matrix in self._stiffness:
            matrix.destroy()
        self._stiffness = [K, *(matrix.copy() for matrix in self._products)]
        for matrix in self._stiffness:
            matrix.scale(self._scale)
        if not self._is_assembled:
            fine = zip(self._stiffness[:-1], self._block_sizes)
            self._stiffness[:-1] = [_half(*of) for of in fine]

    def attach(self, ksp: PETSc.KSP, operator: PETSc.Mat, springs: PETSc.Mat | None):
        """Set a KSP's operators, and those of its multigrid's levels. Collective.

        Args:
            ksp: The KSP; if its PC isn't ``mg`` it gets the finest level alone.
            operator: What it iterates on.
            springs: √W B, or None.
        """
        for matrix in self._levels:
            matrix.destroy()
        self._levels = self._sprung(springs) if springs is not None else []
        levels = self._levels or self._stiffness
        ksp.setOperators(operator, levels[0])
        pc = ksp.getPC()
        if pc.getType() != PETSc.PC.Type.MG:
            return
        num = len(levels)
        pc.setType(PETSc.PC.Type.NONE)  # PETSc's residuals would be those of the first matrices
        pc.setType(PETSc.PC.Type.MG)
        pc.setMGLevels(num)
        pc.setFromOptions()
        for level, P in enumerate(self._P):
            pc.setMGInterpolation(num - 1 - level, P)
        for level, matrix in enumerate(levels[1:], 1):
            pc.getMGSmoother(num - 1 - level).setOperators(matrix)
        self._set_up(pc, levels[0], num - 1)

    def _set_up(self, pc: PETSc.PC, finest: PETSc.Mat, number: int):
        """Set up multigrid, with the largest eigenvalue for the smoother of the finest level."""
        prefix, database, name = pc.getOptionsPrefix(), PETSc.Options(), "ksp_chebyshev_eigenvalues"
        one, esteig = f"{prefix}mg_levels_{number}_{name}", "ksp_chebyshev_esteig"
        levels = [f"{prefix}mg_levels_{of}" for of in ("", f"{number}_")]
        given = any(of + option in database for of in levels for option in (name, esteig))
        kinds = {database.getString(of + "pc_type", "jacobi") for of in levels}
        if given or kinds != {"jacobi"}:  # its eigenvalues, or those with another preconditioner
            pc.setUp()
            return
        if self._largest is None:
            self._largest = _largest_eigenvalue(finest, f"{prefix}mg_levels_esteig_")
        database[one] = f"{0.1 * self._largest},{1.1 * self._largest}"  # as PETSc for others
        try:
            pc.setUp()
        finally:
            del database[one]

    def _sprung(self, springs: PETSc.Mat) -> list[PETSc.Mat]:
        """Each level with (√W B P)ᵀ √W B P. Collective."""
        found, coarsened, done = [], springs.copy(), []
        coarsened.scale(self._scale**0.5)
        for level, K in enumerate(self._stiffness):
            if level:
                coarsened = coarsened.matMult(self._P[level - 1])
            if self._is_assembled or level == len(self._P):
                found.append(_assembled(K, coarsened))
                done.append(coarsened)
            else:
                context = _Sprung(K, coarsened)
                matrix = PETSc.Mat().createPython(K.getSizes(), context, comm=K.comm)
                matrix.setUp()
                found.append(matrix)
        for matrix in done:
            matrix.destroy()
        return found

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        for matrix in (*self._P, *self._products, *self._stiffness, *self._levels):
            matrix.destroy()
        self._P, self._products, self._stiffness, self._levels = [], [], [], []


def _assembled(K: PETSc.Mat, springs: PETSc.Mat) -> PETSc.Mat:
    """K + BᵀWB by its entries, of an AIJ matrix K. Collective."""
    transposed, found = springs.copy().transpose(), K.copy()
    coupling = transposed.matMult(springs)
    found.axpy(1.0, coupling, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    for obj in (transposed, coupling):
        obj.destroy()
    return found


def _needs_entries(ksp: PETSc.KSP) -> bool:
    """True if a KSP's preconditioner reads the entries of its matrices."""
    pc = ksp.getPC()
    if pc.getType() != PETSc.PC.Type.MG:
        return True
    given = PETSc.Options(pc.getOptionsPrefix()).getAll()
    of_levels = [k for k in given if k.startswith(("mg_levels", "mg_fine")) and "_pc_" in k]
    return "pc_mg_galerkin" in given or not {given[k] for k in of_levels} <= {"jacobi", "none"}


def _asymmetry(K: PETSc.Mat) -> float:
    """Difference of yᴴKx from the conjugate of xᴴKy over |x| |Ky|; 0 if Kᴴ = K. Collective."""
    (x, y), product, found = K.createVecs(), K.createVecLeft(), []
    x.setRandom()
    y.pointwiseMult(x, x)  # setRandom would give the same numbers
    for a, b in ((x, y), (y, x)):
        K.mult(a, product)
        found.append(product.dot(b))
    size = x.norm() * product.norm()
    for vector in (x, y, product):
        vector.destroy()
    return abs(found[1] - np.conj(found[0])) / size if size else 0.0


def _largest_eigenvalue(A: PETSc.Mat, prefix: str) -> float:
    """Largest eigenvalue of a matrix over its diagonal, nearly. Collective."""
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setType(PETSc.KSP.Type.GMRES)
    ksp.getPC().setType(PETSc.PC.Type.JACOBI)
    ksp.setNormType(PETSc.KSP.NormType.NONE)
    ksp.setComputeEigenvalues(True)
    ksp.setFromOptions()
    ksp.setOperators(A)
    x, b = A.createVecs()
    b.setRandom()
    ksp.solve(b, x)
    found = float(ksp.computeEigenvalues().real.max())
    for obj in (ksp, x, b):
        obj.destroy()
    return found


def _half(K: PETSc.Mat, block_size: int) -> PETSc.Mat:
    """The upper half of a symmetric matrix in blocks, in its place; of complex ones the whole."""
    if np.issubdtype(PETSc.ScalarType, np.complexfloating):
        return K
    K.setBlockSize(block_size)
    K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    half = K.convert("sbaij", PETSc.Mat())
    K.destroy()
    return half
