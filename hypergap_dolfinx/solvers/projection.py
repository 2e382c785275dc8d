# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Conjugate gradients and algebraic multigrid for :math:`\Pi^T K \Pi x = \Pi^T (f - K u_c)`.

.. math::
    \Pi = I - D^{-1} B^T S^{-1} B, \qquad S = B D^{-1} B^T

removes the gaps from displacements; so :math:`u = \Pi x + u_c` holds all ties, with
:math:`u_c = D^{-1} B^T S^{-1} c`. Conjugate gradients don't mind that the system is singular. S
lives on Γ1 and is factorised. Multigrid holds the ties on its finest level by Π, too. On coarser
ones it gets :math:`K + B^T W B`: springs across the gap, which also hold bodies that nothing else
holds. They are as stiff as the cells that Π moves: weaker ones
would leave gaps to the iteration, stiffer ones make multigrid worse.

D decides which side moves to close a gap. With K's diagonal that is the softer one, so that
contrasts in stiffness hardly matter (see :data:`CONTRAST`).
"""

import weakref
from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.algebra.hierarchy import Hierarchy, block_diagonal, nest
from hypergap_dolfinx.algebra.rigid_motions import motions, orthonormal
from hypergap_dolfinx.algebra.saddle import failure
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.solvers.bodywise import create_solver
from hypergap_dolfinx.solvers.tolerances import CONTRAST, ROUND_OFF_PROJECTED, SMALL_FORCES


@dataclass(frozen=True)
class Constraints:
    """Constraints B u = c of displacements; this rank's dofs are those of all bodies in turn."""

    B: PETSc.Mat
    """The constraints."""
    sides: Sequence[tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], slice]]
    """This rank's own dofs of Γ1, other dofs, and rows, of each interface."""
    forces: PETSc.Mat | None = None
    """F of the forces Fᵀλ, if that isn't B (friction)."""

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        for matrix in (self.B, self.forces):
            if matrix is not None:
                matrix.destroy()


class _Operator:
    """ΠᵀKΠ as the context of a Python matrix."""

    def __init__(self, projection: "Projection"):
        self._projection = weakref.proxy(projection)  # PETSc's references are no garbage for Python

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec):
        """Apply it. Collective."""
        self._projection.mult(x, y)


class Projection:
    """Displacements of several bodies that hold constraints, for a KSP. All is collective."""

    def __init__(self, K: Sequence[PETSc.Mat], spaces: Sequence[fem.FunctionSpace], prefix: str):
        """Store the bodies, of which the stiffness needs no values yet.

        Args:
            K: Stiffness of each body.
            spaces: Their spaces.
            prefix: Prefix of the solvers' options.
        """
        self._bodies, self._spaces, self._prefix = list(K), list(spaces), prefix
        self.K = block_diagonal(K)
        """The stiffness, nested."""
        comm = self.K.comm
        (self._u, self.r), self.diagonal = self.K.createVecs(), self.K.createVecRight()
        self._solver = create_solver(f"{prefix}interface_", comm)
        if comm.size == 1 and self._solver.getPC().getType() == PETSc.PC.Type.REDUNDANT:
            self._solver.destroy()
            self._solver = create_solver(f"{prefix}interface_redundant_", comm)
        self._hierarchy: Hierarchy | None = None
        self._state: list[int] = []
        self._constraints: Constraints | None = None
        self._more: PETSc.Mat | None = None
        self._of_constraints: list = []
        self.matrix = PETSc.Mat().createPython(self.K.getSizes(), _Operator(self), comm=comm)
        self.matrix.setUp()
        self.x, self.b = self.matrix.createVecs()
        self.has_diagonal = self.is_symmetric = True
        """True if D is K's diagonal; if F is B."""
        self.factor = 1.0
        """Factor of the stiffness."""
        self.iterations = 0
        """Number of iterations of the last solve."""

    def destroy(self):
        """Destroy the PETSc objects."""
        self._forget()
        objects = [self.K, self._u, self.r, self.diagonal, self._solver, self.matrix]
        for obj in (*objects, self.x, self.b, self._hierarchy):
            if obj is not None:
                obj.destroy()
        self._hierarchy = None

    def _forget(self):
        """Destroy what belongs to the constraints."""
        for obj in self._of_constraints:
            obj.destroy()
        self._constraints, self._of_constraints = None, []

    def update(
        self,
        ksp: PETSc.KSP,
        constraints: Constraints | None,
        more: PETSc.Mat | None = None,
        beside: PETSc.Mat | None = None,
        *,
        fewer: bool = False,
    ):
        """Take the present stiffness, and constraints, for a KSP.

        Args:
            ksp: The KSP.
            constraints: The constraints, which stay the caller's, or None.
            more: What is added to the stiffness, but not to the preconditioner.
            beside: Springs √W B of the preconditioner that aren't constraints, or None.
            fewer: True if the constraints are some of those before.
        """
        self._forget()
        self._more = more
        self._make_levels(ksp)
        springs = self._constrain(constraints) if constraints is not None else None
        if beside is not None and springs is not None:
            both = nest([[springs], [beside]], springs.comm)
            whole = both.convert("aij", PETSc.Mat())
            for obj in (both, springs, beside):
                obj.destroy()
            beside = whole
        springs = beside or springs
        assert self._hierarchy is not None
        self._hierarchy.attach(ksp, self.matrix, springs, weakref.proxy(self), fewer=fewer)
        if springs is not None:
            springs.destroy()

    def _make_levels(self, ksp: PETSc.KSP):
        """Make aggregates if there are none; coarsen K if it changed."""
        if self._hierarchy is None:
            self._hierarchy = Hierarchy(self._bodies, self._modes(), f"{self._prefix}aggregates_")
            self._state = []
        state = [K.stateGet() for K in self._bodies]
        if state != self._state:
            A = self.K.convert("aij", PETSc.Mat())  # a copy in one matrix
            for K, before in zip(self._bodies, state, strict=True):
                K.stateSet(before)  # PETSc counts reading as a change
            A.getDiagonal(self.diagonal)
            self._hierarchy.set_stiffness(A, ksp)
            self._state = state

    def forget_aggregates(self):
        """Make aggregates anew with the next update."""
        if self._hierarchy is not None:
            self._hierarchy.destroy()
            self._hierarchy = None

    def _modes(self) -> list[npt.NDArray[np.float64] | None]:
        """Rigid motions of each body; None for scalars, whose constants PETSc knows."""
        return [
            orthonormal(V.mesh.comm, motions(V)) if K.getBlockSize() > 1 else None
            for K, V in zip(self._bodies, self._spaces, strict=True)
        ]

    def _constrain(self, constraints: Constraints) -> PETSc.Mat:
        """Factorise S for the constraints; √W B."""
        self._constraints, B = constraints, constraints.B
        self._c, self._y = B.createVecLeft(), B.createVecLeft()
        self._F, self.is_symmetric = constraints.forces or B, constraints.forces is None
        squares = B.copy()
        rows, columns, values = B.getValuesCSR()
        squares.setValuesCSR(rows, columns, values**2)
        squares.assemble()
        self._inverse = self._weights(squares)
        scaled = [matrix.copy() for matrix in ((B,) if self.is_symmetric else (B, self._F))]
        for matrix in scaled:
            matrix.diagonalScale(R=self._inverse)
        self._BD, self._FD = scaled[0], scaled[-1]
        S = B.matTransposeMult(self._FD)
        stiffness = self._stiffness_of_springs(squares, S)
        self._solver.reset()  # there may be more constraints, or fewer
        self._solver.setOperators(S)
        self._solver.setUp()
        springs = B.copy()
        stiffness.sqrtabs()
        springs.diagonalScale(L=stiffness)
        self._of_constraints = [self._c, self._y, *scaled, self._inverse, S]
        for obj in (squares, stiffness):
            obj.destroy()
        return springs

    def mult(self, x: PETSc.Vec, y: PETSc.Vec):
        """Apply ΠᵀKΠ."""
        assert self._hierarchy is not None
        if not (self._hierarchy.projects and self.has_diagonal):
            x.copy(self._u)
            self.project(self._u)
            x = self._u
        self._stiffness_times(x, y, self._more)
        self.project_transpose(y)

    def _stiffness_times(self, u: PETSc.Vec, y: PETSc.Vec, more: PETSc.Mat | None):
        self.K.mult(u, y)
        if self.factor != 1:
            y.scale(self.factor)
        if more is not None:
            more.multAdd(u, y, y)

    def project(self, u: PETSc.Vec):
        """Apply Π in place."""
        if self._constraints is not None:
            self._constraints.B.mult(u, self._c)
            self._solver.solve(self._c, self._y)
            self._y.scale(-1.0)
            self._FD.multTransposeAdd(self._y, u, u)

    def project_transpose(self, r: PETSc.Vec):
        """Apply Πᵀ in place; y has the multipliers, which take part of the loads."""
        if self._constraints is not None:
            self._BD.mult(r, self._c)
            self._solver.solve(self._c, self._y)
            self._c.axpby(-1.0, 0.0, self._y)
            self._F.multTransposeAdd(self._c, r, r)

    def work(self, values: npt.NDArray, more: PETSc.Mat | None = None) -> float:
        """Work of the stiffness on displacements.

        Args:
            values: This rank's part of these.
            more: What is added to the stiffness.
        """
        x, y = self.b.duplicate(), self.b.duplicate()
        x.array[:] = values
        self._stiffness_times(x, y, more)
        found = y.dot(x)
        for vector in (x, y):
            vector.destroy()
        return found.real

    def lift(self, u: PETSc.Vec, given: npt.NDArray):
        """Change displacements such that B u = c.

        Args:
            u: The displacements.
            given: This rank's part of c.

        Raises:
            SolveError: The constraints depend on each other.
        """
        if self._constraints is not None:
            self._constraints.B.mult(u, self._c)
            self._c.array[:] = given - self._c.array_r
            self._solver.solve(self._c, self._y)
            message = failure(self._solver)
            if message:
                raise SolveError(message)
            self._FD.multTransposeAdd(self._y, u, u)

    def load(self, loads: npt.NDArray, u: PETSc.Vec, r: PETSc.Vec):
        """Set r = Πᵀ(f − K u), and the multipliers."""
        self._stiffness_times(u, r, self._more)
        r.array[:] = loads - r.array_r
        self.project_transpose(r)
        if self._constraints is not None:  # what is left may be the round-off of large loads
            first = self._y.copy()
            self.project_transpose(r)
            self._y.axpy(1.0, first)
            first.destroy()

    def add_solution(self, ksp: PETSc.KSP, u: PETSc.Vec):
        """Solve for the loads b, and add the displacements to u."""
        ksp.solve(self.b, self.x)
        self.x.copy(self._u)
        self.project(self._u)
        u.axpy(1.0, self._u)
        self.iterations = ksp.getIterationNumber()

    def refine(self, ksp: PETSc.KSP, u: PETSc.Vec, size: float, rtol: float) -> bool:
        """Solve for the residual r if the constraints' forces are small beside the loads.

        Prescribed displacements of stiff bodies are such loads.

        Args:
            ksp: The KSP.
            u: The displacements, which it changes.
            size: Size of the loads.
            rtol: Residual over the constraints' forces.

        Returns:
            Whether it solved again.
        """
        if self._constraints is None:
            return False
        forces, left = self.constraint_forces, self.b.duplicate()
        left.pointwiseMult(self.diagonal, u)
        goal = max(rtol * forces, ROUND_OFF_PROJECTED * left.norm())
        left.destroy()
        if forces > SMALL_FORCES * size or self.r.norm() <= goal:
            return False
        self.r.copy(self.b)
        tolerances, reason = ksp.getTolerances(), ksp.getConvergedReason()
        ksp.setTolerances(rtol=0.0, atol=goal)
        before = u.copy()
        self.add_solution(ksp, u)
        ksp.setTolerances(*tolerances)
        if ksp.getConvergedReason() < 0:  # at round-off; what was found before is as asked for
            before.copy(u)
            ksp.setConvergedReason(reason)
        before.destroy()
        return True

    @property
    def multipliers(self) -> npt.NDArray:
        """This rank's multipliers of the last loads."""
        return self._y.array_r if self._constraints is not None else np.empty(0)

    @property
    def constraint_forces(self) -> float:
        """Norm of the forces of the multipliers of the last loads."""
        if self._constraints is None:
            return 0.0
        self._F.multTranspose(self._y, self._u)
        return self._u.norm()

    def _weights(self, squares: PETSc.Mat) -> PETSc.Vec:
        """D⁻¹."""
        diagonal, smallest = self.diagonal, self.diagonal.min()[1]
        assert self._constraints is not None
        if smallest <= 0:
            raise SolveError(
                f"the stiffness isn't positive definite: {smallest:.1e} is on its diagonal; take "
                'solver="direct".'
            )
        D = diagonal.array_r.real.copy()
        for own, others, rows in self._constraints.sides:
            D[own] = np.minimum(
                D[own], CONTRAST * self._stiffness_behind(squares, others, rows)[own]
            )
        inverse = diagonal.duplicate()
        inverse.array[:] = 1.0 / D
        equal = np.array_equal(D, diagonal.array_r.real)
        self.has_diagonal = diagonal.comm.tompi4py().allreduce(equal, MPI.LAND)
        return inverse

    def _stiffness_of_springs(self, squares: PETSc.Mat, S: PETSc.Mat) -> PETSc.Vec:
        """W's diagonal: about the energy of what Π moves.

        Where F is B for smooth gaps, since springs are on coarse levels alone; else for each gap.
        """
        energy, springs = self.diagonal.duplicate(), squares.createVecLeft()
        energy.array[:] = self.diagonal.array_r * self._inverse.array_r**2
        squares.mult(energy, springs)
        squares.mult(self._inverse, self._c)
        sums = self._c.array_r
        if self.is_symmetric:
            starts, _, values = S.getValuesCSR()
            sums = np.add.reduceat(np.append(np.abs(values), 0.0), starts[:-1])  # no row is empty
        springs.array[:] = springs.array_r / (self._c.array_r * sums)
        energy.destroy()
        return springs

    def _stiffness_behind(self, squares: PETSc.Mat, others, rows: slice) -> npt.NDArray[np.float64]:
        """Stiffness behind a tie at each dof: a harmonic mean, inf without a tie."""
        softness, share = self.diagonal.duplicate(), self.diagonal.duplicate()
        softness.set(0.0)
        share.set(0.0)
        softness.array[others] = 1.0 / self.diagonal.array_r[others]
        share.array[others] = 1.0
        squares.mult(softness, self._c)
        squares.mult(share, self._y)
        found = np.zeros(len(self._y.array_r), dtype=bool)
        found[rows] = self._y.array_r[rows].real > 0
        self._c.array[found] /= self._y.array_r[found]
        self._c.array[~found] = 0.0
        self._y.array[:] = found
        squares.multTranspose(self._c, softness)
        squares.multTranspose(self._y, share)
        soft, shared = softness.array_r.real, share.array_r.real
        behind = soft > 0
        stiffness = np.full(len(behind), np.inf)
        stiffness[behind] = shared[behind] / soft[behind]
        for obj in (softness, share):
            obj.destroy()
        return stiffness
