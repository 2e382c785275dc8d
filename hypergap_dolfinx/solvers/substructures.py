# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""A preconditioner of the saddle system that treats one body at a time.

The factors of the bodies are several times cheaper than those of all of them together. A tie is
taken in one direction, from Γ0 to Γ1 (Dirichlet–Neumann): a step

1. finds Γ1's displacements from the tie, with a factor of the square part of B₁,
2. solves Γ1's body under these displacements, and reads the multipliers off its residual,
3. loads Γ0's body with them and solves it.

What is left out, that Γ0 moves Γ1, makes the preconditioned operator :math:`I + S_0^{-1} P^T S_1 P`
on Γ0, with the bodies' Schur complements :math:`S_i` and :math:`P = -B_1^{-1}B_0`. So the number of
iterations doesn't depend on the mesh; it grows as Γ1's body is stiffer than Γ0's.
"""

from collections.abc import Sequence
from itertools import pairwise

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.tolerances import NOTHING
from hypergap_dolfinx.core.sparse import column_sums, mean_diagonal, product


def order_of_bodies(num_bodies: int, bodies: Sequence[tuple[int, int]]) -> list[int] | None:
    """Order bodies such that those with Γ1 of a tie come before those with its Γ0.

    Args:
        num_bodies: Number of bodies.
        bodies: Γ0's and Γ1's body of each tie.

    Returns:
        The bodies, or None if the ties lead round in a circle.
    """
    left, order = list(range(num_bodies)), []
    while left:
        ready = [i for i in left if not any(i == i0 and i1 in left for i0, i1 in bodies)]
        if not ready:
            return None
        order += ready
        left = [i for i in left if i not in ready]
    return order


class Body:
    """A body's part in a step: its solver, with Γ1's own dofs held if it has any."""

    def __init__(
        self,
        K: PETSc.Mat,
        modes: npt.NDArray[np.float64],
        prefix: str,
        held: dict[int, tuple[PETSc.Mat, npt.NDArray[np.int32]]],
        loaded: Sequence[PETSc.Mat],
    ):
        """Set up the solvers, without values yet. Collective.

        Args:
            K: Stiffness.
            modes: Its :func:`~hypergap_dolfinx.algebra.rigid_motions.rigid_modes`.
            prefix: Prefix of the solvers' options.
            held: For each tie whose Γ1 the body has, B₁ and the dofs under its rows.
            loaded: B₀ of the ties whose Γ0 the body has.
        """
        self._K, self._modes, self._loaded = K, modes, loaded
        start, end = K.getOwnershipRange()
        own = np.concatenate([[], *(own for _, own in held.values())])
        free = np.setdiff1d(np.arange(start, end), own).astype(PETSc.IntType)
        self._own = {t: own - start for t, (_, own) in held.items()}
        self._part = free - start
        self._is = PETSc.IS().createGeneral(free, comm=K.comm) if held else None
        self._u, self._r = K.createVecs()
        self._solver = create_solver(f"{prefix}body_", K.comm)
        self._matrix: PETSc.Mat | None = None
        self._vectors: tuple[PETSc.Vec, ...] = ()
        self._squares = {}
        for t, (B, own) in held.items():
            square = square_part(B, own)
            solver = create_solver(f"{prefix}square_", K.comm)
            solver.setOperators(square)
            self._squares[t] = solver, *square.createVecs()
            square.destroy()

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        objects = [obj for triple in self._squares.values() for obj in triple]
        objects += [self._solver, self._matrix, self._is, self._u, self._r, *self._vectors]
        for obj in objects:
            if obj is not None:
                obj.destroy()

    def set_up(self):
        """Take the present stiffness. Collective."""
        for obj in (self._matrix, *self._vectors):
            if obj is not None:
                obj.destroy()
        if self._is is not None:
            self._matrix = self._K.createSubMatrix(self._is, self._is)
        else:
            self._matrix = self._K.copy()
            self._pin(self._matrix)
        self._vectors = self._matrix.createVecs()
        self._solver.setOperators(self._matrix)
        self._solver.setUp()

    def _pin(self, matrix: PETSc.Mat):
        """Hold a body that floats by springs at as many dofs of Γ0 as it has rigid motions."""
        K, Q, comm = self._K, self._modes, self._K.comm.tompi4py()
        stiffness = mean_diagonal(K)
        _, force, vectors = np.linalg.svd(comm.allreduce(Q.T @ product(K, Q)) / stiffness)
        floating = Q @ vectors[force < NOTHING].conj().T
        if not floating.shape[1] or not self._loaded:
            return
        sums = sum(column_sums(B).array_r.real for B in self._loaded)
        on = np.flatnonzero(sums > 0)
        dofs = np.concatenate(comm.allgather(on + K.getOwnershipRange()[0]))
        rows = np.concatenate(comm.allgather(floating[on]))
        springs = K.createVecRight()
        springs.set(0.0)
        for _ in range(floating.shape[1]):  # Gram and Schmidt, the largest first
            k = np.linalg.norm(rows, axis=1).argmax()
            direction = rows[k] / np.linalg.norm(rows[k])
            rows = rows - np.outer(rows @ direction.conj(), direction)
            if comm.rank == 0:
                springs.setValue(int(dofs[k]), stiffness)
        springs.assemble()
        matrix.setDiagonal(matrix.getDiagonal() + springs)
        springs.destroy()

    def solve(self, r: npt.NDArray, constraints: Sequence[npt.NDArray]):
        """Displacements, and the multipliers that hold Γ1's. Collective.

        Args:
            r: This rank's loads.
            constraints: Right-hand side of B₁u for each tie whose Γ1 the body has.

        Returns:
            This rank's displacements, and the multipliers of each tie.
        """
        u, b, x = self._u, *self._vectors[::-1]
        if not self._own:
            b.array[:] = r
            self._solver.solve(b, x)
            return x.array_r, []
        u.set(0.0)
        for (t, own), value in zip(self._own.items(), constraints, strict=True):
            solver, x1, b1 = self._squares[t]
            b1.array[:] = value
            solver.solve(b1, x1)
            u.array[own] = x1.array_r
        known = u.array_r.copy()
        self._K.mult(u, self._r)
        rest = r - self._r.array_r
        b.array[:] = rest[self._part]
        self._solver.solve(b, x)
        u.array[:] = known
        u.array[self._part] += x.array_r
        self._K.mult(u, self._r)
        rest = r - self._r.array_r
        multipliers = []
        for t, own in self._own.items():
            solver, x1, b1 = self._squares[t]
            x1.array[:] = rest[own]
            solver.solveTranspose(x1, b1)
            multipliers.append(b1.array_r.copy())
        return u.array_r, multipliers


def square_part(B: PETSc.Mat, own: npt.NDArray) -> PETSc.Mat:
    """Columns of B₁ under its rows' multipliers. Collective."""
    rows = PETSc.IS().createStride(B.getLocalSize()[0], B.getOwnershipRange()[0], 1, B.comm)
    columns = PETSc.IS().createGeneral(own.astype(PETSc.IntType), comm=B.comm)
    square = B.createSubMatrix(rows, columns)
    for obj in (rows, columns):
        obj.destroy()
    return square


def create_solver(prefix: str, comm) -> PETSc.KSP:
    """A KSP with the options of a prefix. Collective."""
    solver = PETSc.KSP().create(comm)
    solver.setOptionsPrefix(prefix)
    solver.setFromOptions()
    return solver


class Substructures:
    """The preconditioner, as the context of a PCPYTHON."""

    def __init__(
        self,
        K: Sequence[PETSc.Mat],
        B: Sequence[Sequence[PETSc.Mat | None]],
        sides: Sequence[tuple[Sequence[int], int]],
        own: Sequence[npt.NDArray[np.int32]],
        order: Sequence[int],
        modes: Sequence[npt.NDArray[np.float64]],
    ):
        """Take the blocks; solvers are made on demand.

        Args:
            K: Stiffness of each body.
            B: For each tie, its block on each body, or None.
            sides: The bodies that each interface moves besides Γ1's, and Γ1's.
            own: Global dofs under this rank's multipliers of each tie, in B₁'s order of rows.
            order: Order of the bodies, see :func:`order_of_bodies`.
            modes: The bodies' :func:`~hypergap_dolfinx.algebra.rigid_motions.rigid_modes`.
        """
        self._K, self._B, self._sides, self._own = K, B, sides, own
        self._order, self._modes = order, modes
        sizes = [k.getLocalSize()[0] for k in K]
        sizes += [len(columns) for columns in own]
        ends = np.cumsum([0, *sizes])
        self._parts = [slice(*pair) for pair in pairwise(ends)]
        self._solvers: list[Body] = []
        self._loads: dict[tuple[int, int], tuple[PETSc.Vec, PETSc.Vec]] = {}

    def setUp(self, pc: PETSc.PC):
        """Take the bodies' present stiffness. Collective."""
        if not self._solvers:
            prefix = pc.getOptionsPrefix() or ""
            for i, K in enumerate(self._K):
                held = {
                    t: (self._B[t][i], self._own[t])
                    for t, (_, i1) in enumerate(self._sides)
                    if i1 == i
                }
                loaded = [self._B[t][i] for t, (moved, _) in enumerate(self._sides) if i in moved]
                self._solvers.append(Body(K, self._modes[i], prefix, held, loaded))
            for t, (moved, _) in enumerate(self._sides):
                for i in moved:
                    self._loads[t, i] = self._B[t][i].createVecs()  # type: ignore[union-attr]
        for body in self._solvers:
            body.set_up()

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec):
        """A step. Collective."""
        num_bodies = len(self._K)
        r = [x.array_r[part] for part in self._parts]
        result = y.array
        for i in self._order:
            ties = [t for t, (_, i1) in enumerate(self._sides) if i1 == i]
            u, multipliers = self._solvers[i].solve(r[i], [r[num_bodies + t] for t in ties])
            result[self._parts[i]] = u
            for t, value in zip(ties, multipliers, strict=True):
                result[self._parts[num_bodies + t]] = value
                for j in self._sides[t][0]:
                    load, multiplier = self._loads[t, j]
                    multiplier.array[:] = value
                    self._B[t][j].multTranspose(multiplier, load)  # type: ignore[union-attr]
                    r[j] = r[j] - load.array_r

    def destroy(self, pc: PETSc.PC | None = None):
        """Destroy the PETSc objects. Collective."""
        for body in self._solvers:
            body.destroy()
        for vectors in self._loads.values():
            for vector in vectors:
                vector.destroy()
        self._solvers, self._loads = [], {}
