# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Levels of multigrid for bodies with constraints between them, from each body's own aggregates.

Smoothed aggregation (PETSc's GAMG) makes prolongators of each stiffness :math:`K_i` alone, with the
body's own rigid motions. Joined block by block, :math:`P`, they coarsen the matrix
:math:`K + B^T W B` with springs W across gaps:

.. math:: P^T (K + B^T W B) P = P^T K P + (BP)^T W (BP).

Aggregates that reach across an interface would have one set of rigid motions for both sides, so
that on coarse levels bodies could not slide. Prolongators know nothing of B: they serve all sets of
constraints, and :math:`P^T K P` is computed only if K changes.
"""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

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


def _prolongators(K: PETSc.Mat, modes: npt.NDArray[np.float64] | None, prefix: str):
    """Prolongators of a body alone, from the finest level on. Collective."""
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
    num = pc.getMGLevels()
    found = [pc.getMGInterpolation(level) for level in range(num - 1, 0, -1)]
    for obj in (pc, *vectors):
        obj.destroy()
    return found


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
        found = [_prolongators(*of, prefix) for of in zip(K, modes, strict=True)]
        for body, (of_body, matrix) in enumerate(zip(found, K, strict=True)):
            coarsest = of_body[-1].getSizes()[1] if of_body else matrix.getSizes()[0]
            while len(of_body) < max(map(len, found)):  # its coarsest level is that of all others
                one = PETSc.Mat().createConstantDiagonal((coarsest, coarsest), 1.0, K[0].comm)
                found[body].append(one.convert("aij"))
        self._P = [_joined(blocks) for blocks in zip(*found, strict=True)]
        for matrix in (P for of_body in found for P in of_body):
            matrix.destroy()
        self._products: list[PETSc.Mat] = []
        self._levels: list[PETSc.Mat] = []

    def set_stiffness(self, K: PETSc.Mat):
        """Compute PᵀKP on all levels, of all bodies' stiffness as one AIJ matrix. Collective."""
        before, self._products = self._products, []
        for level, P in enumerate(self._P):
            fine = self._products[-1] if level else K
            self._products.append(fine.ptap(P, before[level]) if before else fine.ptap(P))

    def attach(self, ksp: PETSc.KSP, operator: PETSc.Mat, K: PETSc.Mat, springs: PETSc.Mat | None):
        """Set a KSP's operators, and those of its multigrid's levels. Collective.

        Args:
            ksp: The KSP; if its PC isn't ``mg`` it gets the finest level alone.
            operator: What it iterates on.
            K: The stiffness as AIJ, which becomes the finest level.
            springs: √W B, or None.
        """
        for matrix in self._levels:
            matrix.destroy()
        self._levels = [K, *(matrix.copy() for matrix in self._products)]
        if springs is not None:
            self._add_springs(springs)
        scale = 1.0 / mean_diagonal(K)  # PETSc tells zero pivots by their size, without a unit
        for matrix in self._levels:
            matrix.scale(scale)
        ksp.setOperators(operator, K)
        pc = ksp.getPC()
        if pc.getType() != PETSc.PC.Type.MG:
            return
        num = len(self._levels)
        pc.setType(PETSc.PC.Type.NONE)  # PETSc's residuals would be those of the first matrices
        pc.setType(PETSc.PC.Type.MG)
        pc.setMGLevels(num)
        pc.setFromOptions()
        for level, P in enumerate(self._P):
            pc.setMGInterpolation(num - 1 - level, P)
        for level, matrix in enumerate(self._levels[1:], 1):
            pc.getMGSmoother(num - 1 - level).setOperators(matrix)

    def _add_springs(self, springs: PETSc.Mat):
        """Add (√W B P)ᵀ √W B P to each level."""
        coarsened = springs.copy()
        for level, matrix in enumerate(self._levels):
            if level:
                finer, coarsened = coarsened, coarsened.matMult(self._P[level - 1])
                finer.destroy()
            transposed = coarsened.copy().transpose()
            coupling = transposed.matMult(coarsened)
            matrix.axpy(1.0, coupling, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            for obj in (transposed, coupling):
                obj.destroy()
        coarsened.destroy()

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        for matrix in (*self._P, *self._products, *self._levels):
            matrix.destroy()
        self._P, self._products, self._levels = [], [], []
