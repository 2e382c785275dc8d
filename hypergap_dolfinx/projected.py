# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""The saddle system without multipliers, for multigrid: :math:`\Pi^T K \Pi x = \Pi^T (f - K u_c)`.

.. math::
    \Pi = I - D^{-1} B^T S^{-1} B, \qquad S = B D^{-1} B^T

takes the gaps out of displacements; so :math:`u = \Pi x + u_c` holds all ties, with
:math:`u_c = D^{-1} B^T S^{-1} c`. Conjugate gradients don't mind that the system is singular. S
lives on Γ1 and is factorised. Multigrid gets :math:`K + B^T W B`: springs across the gap, which
also hold bodies that nothing else holds. They are as stiff as the cells that Π moves, so that what
they leave of a gap costs no more to take out than it costs to have, on any mesh.

D says which side gives way. With K's diagonal that is the softer one, and the contrast in stiffness
doesn't matter.
"""

import weakref
from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.substructures import column_sums, create_solver, mean_diagonal

CONTRAST = 1e4
"""Largest ratio in D of Γ1 to a Γ0 with fewer dofs than there are multipliers, which can't give way
to all of them: S is as ill-conditioned then, and Π gets lost in round-off beyond that."""


class _Operator:
    """ΠᵀKΠ as the context of a Python matrix."""

    def __init__(self, system: "ProjectedSystem"):
        self._system = weakref.proxy(system)  # PETSc's references are no garbage that Python finds

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec):
        """Apply it. Collective."""
        self._system.mult(x, y)


def _nest(blocks: Sequence[Sequence[PETSc.Mat | None]], comm) -> PETSc.Mat:
    """Blocks as one matrix that takes ordinary vectors. Collective."""
    nest = PETSc.Mat().createNest(blocks, comm=comm)
    nest.setNestVecType("standard")
    nest.assemble()
    return nest


def _merge(nest: PETSc.Mat) -> PETSc.Mat:
    """A copy of all blocks in one AIJ matrix. Collective."""
    return nest.convert("aij", PETSc.Mat())


class ProjectedSystem:
    """The projected system for a KSP, and the way back to displacements and multipliers."""

    def __init__(
        self,
        K: Sequence[PETSc.Mat],
        B: Sequence[Sequence[PETSc.Mat | None]],
        bodies: Sequence[tuple[int, int]],
        own: Sequence[npt.NDArray],
        spaces: Sequence[fem.FunctionSpace],
        prefix: str,
    ):
        """Join the bodies' and the ties' blocks. Collective.

        Args:
            K: Stiffness of each body.
            B: For each tie, its block on each body, or None.
            bodies: Γ0's and Γ1's body of each tie.
            own: Global dofs of Γ1 under this rank's multipliers of each tie.
            spaces: Space of each body.
            prefix: Of the solvers' options.
        """
        comm, num = K[0].comm, range(len(K))
        self.iterations = 0
        self._K = _nest([[k if i == j else None for j in num] for i, k in enumerate(K)], comm)
        self._u, self._r = self._K.createVecs()
        self._B = self._join(K, B) if B else None
        self._sides = self._find_sides(K, B, bodies, own)
        self._solver = create_solver(f"{prefix}interface_", comm)
        self._of_values: list = []  # what is made anew when K changes
        if self._B is not None:
            self._Bt = self._B.copy().transpose()
            self._c = self._B.createVecLeft()
            self._y = self._B.createVecLeft()
            self._squares = self._B.copy()
            rows, columns, values = self._B.getValuesCSR()
            self._squares.setValuesCSR(rows, columns, values**2)
            self._squares.assemble()
        sizes = self._K.getSizes()
        self.matrix = PETSc.Mat().createPython(sizes, _Operator(self), comm=comm)
        self.matrix.setUp()
        self.x, self.b = self.matrix.createVecs()
        self._rigid: PETSc.NullSpace | None = None
        self._block_size = K[0].getBlockSize()
        if self._block_size > 1:
            places = [V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local] for V in spaces]
            coordinates = self.matrix.createVecRight()
            coordinates.setBlockSize(self._block_size)
            coordinates.array[:] = np.vstack(places)[:, : self._block_size].ravel()
            self._rigid = PETSc.NullSpace().createRigidBody(coordinates)
            coordinates.destroy()

    @staticmethod
    def _join(K: Sequence[PETSc.Mat], B: Sequence[Sequence[PETSc.Mat | None]]) -> PETSc.Mat:
        """The ties' blocks as one matrix. Collective."""
        rows, zeros = [], []
        for row in B:
            size = next(b for b in row if b is not None).getSizes()[0]
            for i, k in enumerate(K):
                if row[i] is None:
                    zeros.append(PETSc.Mat().createAIJ((size, k.getSizes()[1]), nnz=0, comm=k.comm))
                    zeros[-1].assemble()
                    row = [*row[:i], zeros[-1], *row[i + 1 :]]
            rows.append(row)
        nest = _nest(rows, K[0].comm)
        joined = _merge(nest)
        for obj in (nest, *zeros):
            obj.destroy()
        return joined

    @staticmethod
    def _find_sides(K, B, bodies, own) -> list[tuple[npt.NDArray, npt.NDArray]]:
        """Γ1's own dofs of each tie and the others that it has, among this rank's. Collective."""
        ends = np.cumsum([0, *(k.getLocalSize()[0] for k in K)])
        sides = []
        for row, (_, body), dofs in zip(B, bodies, own, strict=True):
            mine = dofs - K[body].getOwnershipRange()[0] + ends[body]
            found = [np.empty(0, dtype=np.intp)]
            for start, block in zip(ends, row):
                if block is not None:
                    sums = column_sums(block)
                    found.append(np.flatnonzero(sums.array_r) + start)
                    sums.destroy()
            sides.append((mine, np.setdiff1d(np.concatenate(found), mine)))
        return sides

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        objects = [*self._of_values, self._K, self._u, self._r, self._solver]
        objects += [self.matrix, self.x, self.b, self._rigid]
        if self._B is not None:
            objects += [self._B, self._Bt, self._c, self._y, self._squares]
        for obj in objects:
            if obj is not None:
                obj.destroy()
        self._of_values = []

    def mult(self, x: PETSc.Vec, y: PETSc.Vec):
        """Apply ΠᵀKΠ. Collective."""
        x.copy(self._u)
        self._project(self._u)
        self._K.mult(self._u, y)
        self._project_transpose(y)

    def _project(self, u: PETSc.Vec):
        """Apply Π in place."""
        if self._B is not None:
            self._B.mult(u, self._c)
            self._solver.solve(self._c, self._y)
            self._y.scale(-1.0)
            self._DBt.multAdd(self._y, u, u)

    def _project_transpose(self, r: PETSc.Vec):
        """Apply Πᵀ in place; y has the multipliers, which take part of the loads."""
        if self._B is not None:
            self._DBt.multTranspose(r, self._c)
            self._solver.solve(self._c, self._y)
            self._c.axpby(-1.0, 0.0, self._y)
            self._Bt.multAdd(self._c, r, r)

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec):
        """Solve for nested vectors of the saddle system. Collective."""
        loads, given = self._split(b)
        displacements, multipliers = self._split(x)
        u = self.b.duplicate()  # what holds the ties' right-hand side
        u.set(0.0)
        if self._B is not None:
            self._c.array[:] = np.concatenate([part.array_r for part in given])
            self._solver.solve(self._c, self._y)
            self._DBt.mult(self._y, u)
        self._load(loads, u, self.b)
        self._project_transpose(self.b)
        ksp.solve(self.b, self.x)
        self.iterations = ksp.getIterationNumber()
        self.x.copy(self._u)
        self._project(self._u)
        u.axpy(1.0, self._u)
        self._load(loads, u, self._r)
        self._project_transpose(self._r)
        self._distribute(u, displacements)
        if self._B is not None:
            self._distribute(self._y, multipliers)
        u.destroy()

    def _split(self, x: PETSc.Vec) -> tuple[list[PETSc.Vec], list[PETSc.Vec]]:
        """The bodies' and the ties' parts of a nested vector."""
        parts = x.getNestSubVecs()
        num = self._K.getNestSize()[0]
        return parts[:num], parts[num:]

    def _load(self, loads: Sequence[PETSc.Vec], u: PETSc.Vec, r: PETSc.Vec):
        """Set r = f − K u. Collective."""
        self._K.mult(u, r)
        r.array[:] = np.concatenate([part.array_r for part in loads]) - r.array_r

    @staticmethod
    def _distribute(x: PETSc.Vec, parts: Sequence[PETSc.Vec]):
        ends = np.cumsum([part.getLocalSize() for part in parts])
        for part, values in zip(parts, np.split(x.array_r, ends[:-1]), strict=True):
            part.array[:] = values

    def attach(self, ksp: PETSc.KSP):
        """Give a KSP what it is to solve. Collective."""
        self.update(ksp)

    def update(self, ksp: PETSc.KSP) -> bool:
        """Take the stiffness as it is now. Collective."""
        for obj in self._of_values:
            obj.destroy()
        A = _merge(self._K)
        self._of_values = [A]
        if self._B is not None:
            inverse, springs = self._weights(A)
            self._DBt = self._Bt.copy()
            self._DBt.diagonalScale(L=inverse)
            S = self._B.matMult(self._DBt)
            self._solver.setOperators(S)
            self._solver.setUp()
            scaled = self._B.copy()
            scaled.diagonalScale(L=springs)
            coupling = self._Bt.matMult(scaled)
            A.axpy(1.0, coupling, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            self._of_values += [self._DBt, S]
            for obj in (inverse, springs, scaled, coupling):
                obj.destroy()
        A.scale(1.0 / mean_diagonal(A))  # PETSc tells zero pivots by their size, without a unit
        A.setBlockSize(self._block_size)
        if self._rigid is not None:
            A.setNearNullSpace(self._rigid)
        ksp.setOperators(self.matrix, A)
        return True

    def _weights(self, K: PETSc.Mat) -> tuple[PETSc.Vec, PETSc.Vec]:
        """D⁻¹ and W's diagonal: for a gap g, about the energy of what Π moves. Collective."""
        diagonal = K.getDiagonal()
        D = diagonal.array_r.copy()
        comm = K.comm.tompi4py()
        for own, others in self._sides:
            local = [D[own].sum(), len(own), D[others].sum(), len(others)]
            sum1, num1, sum0, num0 = comm.allreduce(np.array(local, dtype=float))
            limit = CONTRAST * sum0 / num0 if num1 > num0 > 0 else np.inf
            if sum1 > limit * num1:
                D[own] *= limit * num1 / sum1
        inverse, energy = diagonal.duplicate(), diagonal.duplicate()
        inverse.array[:] = 1.0 / D
        energy.array[:] = diagonal.array_r / D**2
        springs = self._squares.createVecLeft()
        self._squares.mult(energy, springs)
        self._squares.mult(inverse, self._c)
        springs.array[:] = springs.array_r / self._c.array_r**2
        for obj in (diagonal, energy):
            obj.destroy()
        return inverse, springs
