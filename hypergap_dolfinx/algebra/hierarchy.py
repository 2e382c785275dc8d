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

On the finest level smoothing holds the constraints instead: with a projection Π on displacements
that do, residuals are those of :math:`\Pi^T K \Pi`, and corrections are :math:`\Pi P x`. Springs
that hold gaps as well would be so stiff that smoothing is slow. With friction Π is oblique, which
lengthens what it projects: springs it is, then.

Smoothing reads the levels' matrices many times, and memory takes the time. So real ones that are
symmetric are stored by their upper halves, in blocks, and what springs add on coarse levels beside
them: :math:`B P` has as many rows as B, with more entries in each. For its smoother each level
needs the largest eigenvalue of its matrix over the diagonal. If D is K's diagonal, that of the
finest level is no larger with Π than without, and is kept as long as K is. On coarser levels
springs may double it.
"""

from collections.abc import Sequence
from math import gcd
from typing import Protocol

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.tolerances import UNSYMMETRIC
from hypergap_dolfinx.core.sparse import mean_diagonal


def nest(blocks: Sequence[Sequence[PETSc.Mat | None]], comm) -> PETSc.Mat:
    """Blocks as one matrix for vectors that aren't nested. Collective."""
    every = [(block, block.stateGet()) for row in blocks for block in row if block is not None]
    matrix = PETSc.Mat().createNest(blocks, comm=comm)
    matrix.setNestVecType("standard")
    matrix.assemble()
    for block, state in every:
        block.stateSet(state)  # PETSc counts this as a change of the blocks
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


class _Sum:
    """K + BᵀWB of a coarse level as the context of a Python matrix."""

    def __init__(self, K: PETSc.Mat, added: PETSc.Mat):
        """Take the matrices, of which the second becomes its own."""
        self._K, self._added = K, added

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec):
        """Apply it. Collective."""
        self._K.mult(x, y)
        self._added.multAdd(x, y, y)

    def multTranspose(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec):
        """Apply its transpose. Collective."""
        self._K.multTranspose(x, y)
        self._added.multAdd(x, y, y)

    def getDiagonal(self, matrix: PETSc.Mat, diagonal: PETSc.Vec):
        """The diagonal. Collective."""
        self._K.getDiagonal(diagonal)
        added = self._added.getDiagonal()
        diagonal.axpy(1.0, added)
        added.destroy()

    def destroy(self, matrix: PETSc.Mat):
        """Destroy what was added. Collective."""
        self._added.destroy()


class Projector(Protocol):
    """Projection Π = I − D⁻¹FᵀS⁻¹B on displacements that hold constraints. All is collective."""

    has_diagonal: bool
    """True if D is the stiffness's diagonal."""
    is_symmetric: bool
    """True if F is B."""

    def project(self, u: PETSc.Vec):
        """Apply Π in place."""

    def project_transpose(self, r: PETSc.Vec):
        """Apply I − FᵀS⁻¹BD⁻¹ in place."""


class _Projected:
    """Πᵀ K Π as the context of a Python matrix; Πᵀ K if D is K's diagonal.

    Then D⁻¹ Πᵀ = Π D⁻¹, so that what smoothing adds holds the constraints.
    """

    def __init__(self, projector: Projector, K: PETSc.Mat):
        """Take a projector and a matrix, which stay the caller's."""
        self._projector, self._K, self._u = projector, K, K.createVecRight()

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec):
        """Apply it. Collective."""
        if not self._projector.has_diagonal:
            x.copy(self._u)
            self._projector.project(self._u)
            x = self._u
        self._K.mult(x, y)
        self._projector.project_transpose(y)

    def getDiagonal(self, matrix: PETSc.Mat, diagonal: PETSc.Vec):
        """That of K. Collective."""
        self._K.getDiagonal(diagonal)

    def destroy(self, matrix: PETSc.Mat):
        """Destroy a vector. Collective."""
        self._u.destroy()


class _Interpolation:
    """Π P as the context of a Python matrix, and Pᵀ: residuals are projected."""

    def __init__(self, projector: Projector, P: PETSc.Mat):
        """Take a projector and a prolongator, which stay the caller's."""
        self._projector, self._P, self._u = projector, P, P.createVecLeft()

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, u: PETSc.Vec):
        """Interpolate. Collective."""
        self._P.mult(x, u)
        self._projector.project(u)

    def multAdd(self, matrix: PETSc.Mat, x: PETSc.Vec, u: PETSc.Vec, v: PETSc.Vec):
        """Add what is interpolated to u. Collective."""
        self.mult(matrix, x, self._u)
        v.waxpy(1.0, u, self._u) if v != u else v.axpy(1.0, self._u)

    def multTranspose(self, matrix: PETSc.Mat, r: PETSc.Vec, y: PETSc.Vec):
        """Restrict. Collective."""
        self._P.multTranspose(r, y)

    def destroy(self, matrix: PETSc.Mat):
        """Destroy a vector. Collective."""
        self._u.destroy()


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
        self._stiffness: list[PETSc.Mat] = []  # all levels without springs
        self._levels: list[PETSc.Mat] = []
        self.projects = False
        """True if the finest level projects; with K's diagonal as D it holds the constraints."""
        self._largest: dict[int, float] = {}  # eigenvalues of levels

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
        self._largest = {}
        self._scale = 1.0 / mean_diagonal(K)  # PETSc tells zero pivots by size, without a unit
        self._needs_entries = not self._P or _needs_entries(ksp)
        self._is_whole = self._needs_entries or _asymmetry(K) > UNSYMMETRIC
        self._destroy_levels()
        for matrix in self._stiffness:
            matrix.destroy()
        self._stiffness = [K, *(matrix.copy() for matrix in self._products)]
        for matrix in self._stiffness:
            matrix.scale(self._scale)
        if not self._is_whole:
            fine = zip(self._stiffness[:-1], self._block_sizes)
            self._stiffness[:-1] = [_half(*of) for of in fine]

    def attach(
        self,
        ksp: PETSc.KSP,
        operator: PETSc.Mat,
        springs: PETSc.Mat | None,
        projector: Projector,
        *,
        fewer: bool = False,
    ):
        """Set a KSP's operators, and those of its multigrid's levels. Collective.

        Args:
            ksp: The KSP; if its PC isn't ``mg`` it gets the finest level alone.
            operator: What it iterates on.
            springs: √W B, or None.
            projector: Π, with springs.
            fewer: True if the springs are some of those before: they have no larger eigenvalues,
                nearly.
        """
        self._destroy_levels()
        self.projects = springs is not None and not self._needs_entries and projector.is_symmetric
        if springs is not None:
            self._levels = self._with_springs(springs)
            if self.projects:
                K = self._stiffness[0]
                finest = _Projected(projector, K)
                self._levels.insert(0, PETSc.Mat().createPython(K.getSizes(), finest, comm=K.comm))
                self._levels[0].setUp()
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
        of_K = self.projects and projector.has_diagonal  # then the finest level's is no larger
        kept = set(range(num - self.projects) if fewer else ()) | ({num - 1} if of_K else set())
        self._largest = {k: self._largest[k] for k in kept & self._largest.keys()}
        if not self.projects:
            self._set_up(pc, levels)
            return
        context = _Interpolation(projector, self._P[0])
        interpolation = PETSc.Mat().createPython(self._P[0].getSizes(), context, comm=ksp.comm)
        interpolation.setUp()
        pc.setMGInterpolation(num - 1, interpolation)
        interpolation.destroy()
        self._set_up(pc, [self._stiffness[0], *levels[1:]] if of_K else levels)

    def _set_up(self, pc: PETSc.PC, levels: Sequence[PETSc.Mat]):
        """Set up multigrid, with the largest eigenvalues for the smoothers of its levels.

        Args:
            pc: Multigrid.
            levels: Matrices with these over their diagonals, the finest level's first.
        """
        prefix, database, set_here = f"{pc.getOptionsPrefix()}mg_levels_", PETSc.Options(), []
        for number, matrix in zip(range(len(levels) - 1, 0, -1), levels, strict=False):
            if not _is_ours(prefix, number):
                continue
            if number not in self._largest:
                self._largest[number] = _largest_eigenvalue(matrix, f"{prefix}esteig_")
            largest = self._largest[number]
            set_here.append(f"{prefix}{number}_ksp_chebyshev_eigenvalues")
            database[set_here[-1]] = f"{0.1 * largest},{1.1 * largest}"  # as PETSc does
        try:
            pc.setUp()
        finally:
            for option in set_here:
                del database[option]

    def _with_springs(self, springs: PETSc.Mat) -> list[PETSc.Mat]:
        """Each level with (√W B P)ᵀ √W B P, without the finest one if that projects. Collective."""
        found, part = [], springs.copy()
        part.scale(self._scale**0.5)
        for level, K in enumerate(self._stiffness):
            if level:
                fine, part = part, part.matMult(self._P[level - 1])
                fine.destroy()
            elif self.projects:
                continue
            transposed = part.copy().transpose()
            added = transposed.matMult(part)
            transposed.destroy()
            if self._needs_entries or level == len(self._P):
                found.append(K.copy())
                found[-1].axpy(1.0, added, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
                added.destroy()
            else:
                found.append(PETSc.Mat().createPython(K.getSizes(), _Sum(K, added), comm=K.comm))
                found[-1].setUp()
        part.destroy()
        return found

    def _destroy_levels(self):
        """Destroy the levels of the last springs. Collective."""
        for matrix in self._levels:
            matrix.destroy()
        self._levels = []

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        self._destroy_levels()
        for matrix in (*self._P, *self._products, *self._stiffness):
            matrix.destroy()
        self._P, self._products, self._stiffness = [], [], []


def _needs_entries(ksp: PETSc.KSP) -> bool:
    """True if a KSP's preconditioner reads the entries of its matrices."""
    pc = ksp.getPC()
    if pc.getType() != PETSc.PC.Type.MG:
        return True
    given = PETSc.Options(pc.getOptionsPrefix()).getAll()
    of_levels = [k for k in given if k.startswith(("mg_levels", "mg_fine")) and "_pc_" in k]
    named = {"pc_mg_galerkin", "pc_mg_distinct_smoothup"} & set(given)
    return bool(named) or not {given[k] for k in of_levels} <= {"jacobi"}


def _is_ours(prefix: str, number: int) -> bool:
    """True if a level's smoother has no eigenvalues of the user's, nor a preconditioner."""
    database, levels = PETSc.Options(), (prefix, f"{prefix}{number}_")
    options = "ksp_chebyshev_eigenvalues", "ksp_chebyshev_esteig"
    given = any(of + option in database for of in levels for option in options)
    kinds = {database.getString(of + "pc_type", "jacobi") for of in levels}
    return not given and kinds == {"jacobi"}


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
