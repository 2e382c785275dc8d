# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Conjugate gradients and algebraic multigrid for :math:`\Pi^T K \Pi x = \Pi^T (f - K u_c)`.

.. math::
    \Pi = I - D^{-1} B^T S^{-1} B, \qquad S = B D^{-1} B^T

removes the gaps from displacements; so :math:`u = \Pi x + u_c` holds all ties, with
:math:`u_c = D^{-1} B^T S^{-1} c`. Conjugate gradients don't mind that the system is singular. S
lives on Γ1 and is factorised. Multigrid gets :math:`K + B^T W B`: springs across the gap, which
also hold bodies that nothing else holds. They are as stiff as the cells that Π moves: weaker ones
would leave gaps to the iteration, stiffer ones make multigrid worse.

D decides which side moves to close a gap. With K's diagonal that is the softer one, so that
contrasts in stiffness hardly matter (see :data:`CONTRAST`).
"""

import weakref
from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.rigid_motions import common_modes
from hypergap_dolfinx.algebra.saddle import failure
from hypergap_dolfinx.core.sparse import mean_diagonal, nonzero_columns
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.solvers.bodywise import LU, create_solver
from hypergap_dolfinx.solvers.solver import IterativeSolver, Substitute, System, prefixed
from hypergap_dolfinx.solvers.tolerances import CONTRAST, ROUND_OFF_PROJECTED, SMALL_FORCES


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


class ProjectedSystem(Substitute):
    """The projected system for a KSP, and the way back to displacements and multipliers."""

    def __init__(self, system: System, prefix: str):
        """Join the bodies' and the ties' blocks. Collective.

        Args:
            system: The saddle system.
            prefix: Prefix of the solvers' options.
        """
        K, constraints = system.K, system.constraints
        comm, num = K[0].comm, range(len(K))
        B = constraints.free
        self._K = _nest([[k if i == j else None for j in num] for i, k in enumerate(K)], comm)
        (self._u, self._r), self._diagonal = self._K.createVecs(), self._K.createVecRight()
        self._B = self._join(K, B) if B else None
        self._sides = self._find_sides(K, B, constraints.bodies, constraints.own)
        self._solver = create_solver(f"{prefix}interface_", comm)
        self._of_values: list = []  # matrices that are made anew when K changes
        if self._B is not None:
            self._Bt = self._B.copy().transpose()
            self._c, self._y = self._B.createVecLeft(), self._B.createVecLeft()
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
            modes = np.vstack(common_modes(system.spaces))
            vectors = [self.matrix.createVecRight() for _ in modes.T]
            for vector, mode in zip(vectors, modes.T, strict=True):
                vector.array[:] = mode
            self._rigid = PETSc.NullSpace().create(vectors=vectors, comm=comm)
            for vector in vectors:
                vector.destroy()

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
        joined = nest.convert("aij", PETSc.Mat())  # a copy in one matrix
        for obj in (nest, *zeros):
            obj.destroy()
        return joined

    @staticmethod
    def _find_sides(K, B, bodies, own) -> list[tuple[npt.NDArray, npt.NDArray, slice]]:
        """This rank's own dofs of Γ1, other dofs and rows of each tie. Collective."""
        ends = np.cumsum([0, *(k.getLocalSize()[0] for k in K)])
        sides, num_rows = [], 0
        for row, (_, body), dofs in zip(B, bodies, own, strict=True):
            mine = dofs - K[body].getOwnershipRange()[0] + ends[body]
            found = [np.empty(0, dtype=np.intp)]
            for start, block in zip(ends, row):
                if block is not None:
                    found.append(nonzero_columns(block) + start)
            last = num_rows + next(b for b in row if b is not None).getLocalSize()[0]
            rows = slice(num_rows, last)
            sides.append((mine, np.setdiff1d(np.concatenate(found), mine), rows))
            num_rows = last
        return sides

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        objects = [*self._of_values, self._K, self._u, self._r, self._diagonal]
        objects += [self._solver, self.matrix, self.x, self.b, self._rigid]
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
        """Solve for nested vectors of the saddle system. Collective.

        Prescribed displacements of stiff bodies are large loads at first, next to which the forces
        that are left are small: then the solver is called again, to be as exact for those.
        """
        loads, given = self._split(b)
        displacements, multipliers = self._split(x)
        u = self.b.duplicate()
        u.set(0.0)
        if self._B is not None:
            self._c.array[:] = np.concatenate([part.array_r for part in given])
            self._solver.solve(self._c, self._y)
            message = failure(self._solver)
            if message:
                raise SolveError(message)
            self._DBt.mult(self._y, u)
        self._load(loads, u, self.b)
        size = self.b.norm()
        self._add_solution(ksp, u)
        self.iterations = ksp.getIterationNumber()
        self._load(loads, u, self._r)
        if ksp.getConvergedReason() > 0 and self._refine(ksp, u, size):
            self._load(loads, u, self._r)
        self._distribute(u, displacements)
        if self._B is not None:
            self._distribute(self._y, multipliers)
        u.destroy()

    def _add_solution(self, ksp: PETSc.KSP, u: PETSc.Vec):
        """Solve for the loads b, and add the displacements to u. Collective."""
        ksp.solve(self.b, self.x)
        self.x.copy(self._u)
        self._project(self._u)
        u.axpy(1.0, self._u)

    def _refine(self, ksp: PETSc.KSP, u: PETSc.Vec, size: float) -> bool:
        """Solve for the residual r of loads of a size if the ties' forces are small. Collective."""
        if self._B is None:
            return False
        self._Bt.mult(self._y, self._u)
        forces = self._u.norm()
        self._u.pointwiseMult(self._diagonal, u)
        goal = max(ksp.rtol * forces, ROUND_OFF_PROJECTED * self._u.norm())
        if forces > SMALL_FORCES * size or self._r.norm() <= goal:
            return False
        self._r.copy(self.b)
        tolerances, reason = ksp.getTolerances(), ksp.getConvergedReason()
        ksp.setTolerances(rtol=0.0, atol=goal)
        before = u.copy()
        self._add_solution(ksp, u)
        self.iterations += ksp.getIterationNumber()
        ksp.setTolerances(*tolerances)
        if ksp.getConvergedReason() < 0:  # at round-off; what was found before is as asked for
            before.copy(u)
            ksp.setConvergedReason(reason)
        before.destroy()
        return True

    def _split(self, x: PETSc.Vec) -> tuple[list[PETSc.Vec], list[PETSc.Vec]]:
        """The bodies' and the ties' parts of a nested vector."""
        parts = x.getNestSubVecs()
        num = self._K.getNestSize()[0]
        return parts[:num], parts[num:]

    def _load(self, loads: Sequence[PETSc.Vec], u: PETSc.Vec, r: PETSc.Vec):
        """Set r = Πᵀ(f − K u), and y to the multipliers. Collective."""
        self._K.mult(u, r)
        r.array[:] = np.concatenate([part.array_r for part in loads]) - r.array_r
        self._project_transpose(r)

    @staticmethod
    def _distribute(x: PETSc.Vec, parts: Sequence[PETSc.Vec]):
        ends = np.cumsum([part.getLocalSize() for part in parts])
        for part, values in zip(parts, np.split(x.array_r, ends[:-1]), strict=True):
            part.array[:] = values

    def update(self, ksp: PETSc.KSP) -> bool:
        """Take the present stiffness; always possible. Collective."""
        for obj in self._of_values:
            obj.destroy()
        A = self._K.convert("aij", PETSc.Mat())  # a copy in one matrix
        A.getDiagonal(self._diagonal)
        self._of_values = [A]
        if self._B is not None:
            inverse, springs = self._weights()
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

    def _weights(self) -> tuple[PETSc.Vec, PETSc.Vec]:
        """D⁻¹ and W's diagonal: for a gap g, about the energy of what Π moves. Collective."""
        diagonal, smallest = self._diagonal, self._diagonal.min()[1]
        if smallest <= 0:
            raise SolveError(
                f"the stiffness isn't positive definite: {smallest:.1e} is on its diagonal; take "
                'solver="direct".'
            )
        D = diagonal.array_r.real.copy()
        for own, others, rows in self._sides:
            D[own] = np.minimum(D[own], CONTRAST * self._stiffness(others, rows)[own])
        inverse, energy = diagonal.duplicate(), diagonal.duplicate()
        inverse.array[:] = 1.0 / D
        energy.array[:] = diagonal.array_r / D**2
        springs = self._squares.createVecLeft()
        self._squares.mult(energy, springs)
        self._squares.mult(inverse, self._c)
        springs.array[:] = springs.array_r / self._c.array_r**2
        energy.destroy()
        return inverse, springs

    def _stiffness(self, others, rows: slice) -> npt.NDArray[np.float64]:
        """Stiffness behind a tie at each dof: a harmonic mean, inf without a tie. Collective."""
        softness, share = self._diagonal.duplicate(), self._diagonal.duplicate()
        softness.set(0.0)
        share.set(0.0)
        softness.array[others] = 1.0 / self._diagonal.array_r[others]
        share.array[others] = 1.0
        self._squares.mult(softness, self._c)
        self._squares.mult(share, self._y)
        found = np.zeros(len(self._y.array_r), dtype=bool)
        found[rows] = self._y.array_r[rows].real > 0
        self._c.array[found] /= self._y.array_r[found]
        self._c.array[~found] = 0.0
        self._y.array[:] = found
        self._squares.multTranspose(self._c, softness)
        self._squares.multTranspose(self._y, share)
        soft, shared = softness.array_r.real, share.array_r.real
        behind = soft > 0
        stiffness = np.full(len(behind), np.inf)
        stiffness[behind] = shared[behind] / soft[behind]
        for obj in (softness, share):
            obj.destroy()
        return stiffness


class Multigrid(IterativeSolver):
    """``"iterative"``: conjugate gradients on displacements that hold the ties, and multigrid.

    The number of iterations depends neither on the mesh nor on contrasts: 19, 21, 21 with 22 000,
    144 000 and 1 025 000 displacements of degree 1 (45 with degree 2), and at most half as many
    more for contrasts of 1e-6 to 1e6, whichever side is Γ1 (with cells graded 1:50, 3 times as
    many).
    """

    name = "iterative"
    OPTIONS = {  # noqa: RUF012
        "ksp_type": "cg",
        "ksp_norm_type": "unpreconditioned",
        "ksp_rtol": 1e-10,
        "ksp_max_it": 500,
        "pc_type": "gamg",
        "pc_mg_cycle_type": "w",
        "pc_use_amat": False,  # smoothers of another matrix may make multigrid indefinite
        # Unlike SOR, Jacobi doesn't depend on the ranks. Its largest eigenvalue isn't that from
        # smoothing the aggregates, which is too small with contrasts
        "mg_levels_ksp_type": "chebyshev",
        "mg_levels_ksp_max_it": 3,
        "mg_levels_esteig_ksp_max_it": 20,
        "mg_levels_pc_type": "jacobi",
        "pc_gamg_use_sa_esteig": False,
        **prefixed("interface_", LU),
    }
    ADVICE = (
        '; solver="iterative" is for stiffness that is symmetric and positive definite '
        '(complex: Hermitian), and for cells of good shape: take solver="direct"'
    )

    @classmethod
    def why_not(cls, system: System) -> str | None:
        """Reason why not, or None: multigrid needs bodies with the same kind of field."""
        reason = super().why_not(system)
        if reason:
            return reason
        block_sizes = {V.dofmap.index_map_bs for V in system.spaces}
        if len(block_sizes) > 1 or not block_sizes <= {1, system.spaces[0].mesh.geometry.dim}:
            return "multigrid is for bodies that all have displacements, or all have a scalar"
        return None

    def _create(self) -> Substitute:
        return ProjectedSystem(self._system, self._prefix)
