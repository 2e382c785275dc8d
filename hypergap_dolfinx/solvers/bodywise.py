# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The saddle-point system solved with factors of each body and an iteration over the ties.

The factors of the bodies are several times cheaper than those of all of them together. The
preconditioner takes a tie in one direction, from Γ0 to Γ1 (Dirichlet–Neumann). A step

1. finds Γ1's displacements from the tie, with a factor of the square part of B₁,
2. solves Γ1's body under these displacements, and reads the multipliers off its residual,
3. loads Γ0's body with them and solves it.

It neglects that Γ0 moves Γ1, but for rigid motions of Γ0: the stiffness with which Γ1's body holds
these is added to Γ0's body, which nothing else may hold. For other displacements of Γ0 the
preconditioned operator is :math:`I + S_0^{-1} P^T S_1 P`, with the bodies' Schur complements
:math:`S_i` and :math:`P = -B_1^{-1}B_0`: the number of iterations doesn't depend on the mesh; it
grows as Γ1's body is stiffer than Γ0's.
"""

from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra import saddle
from hypergap_dolfinx.algebra.blocks import ConstraintBlocks
from hypergap_dolfinx.algebra.checks import name_of_body
from hypergap_dolfinx.algebra.hierarchy import nest
from hypergap_dolfinx.algebra.rigid_motions import mean, motions, places
from hypergap_dolfinx.algebra.tolerances import NOTHING
from hypergap_dolfinx.core.graph import parts
from hypergap_dolfinx.core.sparse import coo_matrix, mean_diagonal, nonzero_columns
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.solvers.solver import IterativeSolver, Substitute, System, prefixed
from hypergap_dolfinx.solvers.tolerances import FIRST, RESCALE

LU = {
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_14": 30,
}
"""A factor of a part of the system."""


class Bodies(IterativeSolver):
    """``"bodies"``: the saddle-point system, preconditioned body by body.

    With two bodies the number of iterations (in 3D about 25) grows neither with the mesh nor with
    the contrast in stiffness as long as Γ1 is the softer side; if Γ1 is 1000 times the stiffer one,
    it takes twice as many. It grows with the number of bodies that are tied one behind the other.
    """

    name = "bodies"
    OPTIONS = {  # noqa: RUF012
        "ksp_type": "gmres",
        "ksp_pc_side": "right",  # so that the residual is that of the system
        "ksp_gmres_cgs_refinement_type": "refine_ifneeded",
        "ksp_gmres_restart": 60,
        "ksp_max_it": 120,
        "ksp_rtol": 1e-13,
        "pc_type": "python",
        **prefixed("body_", LU),
        **prefixed("square_", LU),
    }
    ADVICE = '; take solver="direct"'

    def __init__(self, system: System, prefix: str, options: dict | None = None):
        """Create the KSP, as any solver does, and refuse another preconditioner. Collective.

        Args:
            system: The system.
            prefix: Prefix of all PETSc options.
            options: The user's, over the defaults and the command line's.

        Raises:
            SolveError: Options name another type of preconditioner, which has no matrix here.
        """
        super().__init__(system, prefix, options)
        pc = self._ksp.getPC().getType()
        if pc not in ("python", "none"):
            self.destroy()
            raise SolveError(
                f'solver="{self.name}" has a preconditioner of its own, and pc_type is {pc!r}: '
                'leave it out, or take solver="direct" or "iterative".'
            )

    @classmethod
    def why_not(cls, system: System) -> str | None:
        """Reason why not, or None: multipliers need own dofs, bodies an order. Collective."""
        constraints, spaces = system.constraints, system.spaces
        reason = super().why_not(system)
        if reason:
            return reason
        try:
            order_of_bodies(len(spaces), _directions(constraints))
        except CycleError as error:
            return _why_circle(constraints, spaces, error.args[1][::-1])
        ties, wrong = range(len(constraints.bodies)), np.zeros(len(spaces), dtype=int)
        for body, V in enumerate(spaces):
            mine = [t for t in ties if constraints.bodies[t][1] == body]
            start = V.dofmap.index_map.local_range[0] * V.dofmap.index_map_bs
            own = np.concatenate([[], *(constraints.own[t] for t in mine)]).astype(np.intp)
            rows = [constraints.free[t][body].getLocalSize()[0] for t in mine]  # type: ignore[union-attr]
            wrong[body] += [len(constraints.own[t]) for t in mine] != rows
            wrong[body] += len(np.unique(own)) != len(own)
            wrong[body] += bool(constraints.prescribed[body][own - start].any())
        wrong = spaces[0].mesh.comm.allreduce(wrong)
        if not wrong.any():
            return None
        body = int(wrong.argmax())
        return (
            f"some multipliers on {name_of_body(body, spaces[body])} share dofs of Γ1, or have "
            "prescribed ones"
        )

    def _create(self) -> Substitute:
        return BodywiseSystem(self._system)

    def _advice(self) -> str:
        num = len(self._system.spaces)
        if num == 2:
            return self.ADVICE
        return f"; iterations grow with the bodies tied in a row, and there are {num}{self.ADVICE}"


def _directions(constraints: ConstraintBlocks) -> list[tuple[int, int, int]]:
    """A body that an interface moves, that of its Γ1, and the interface; those of Γ0 first."""
    pairs = enumerate(zip(constraints.moved, constraints.bodies, strict=True))
    found = [(i, i1, g, i0) for g, (moved, (i0, i1)) in pairs for i in moved]
    return [each[:3] for each in sorted(found, key=lambda each: each[0] != each[3])]


def _why_circle(constraints: ConstraintBlocks, spaces, bodies: Sequence[int]) -> str:
    """Reason why bodies, from each Γ0's to Γ1's, have no order, and what gives them one."""
    directions, pairs = _directions(constraints), pairwise(bodies)
    circle = [next(one for one in directions if one[:2] == pair) for pair in pairs]
    names = [constraints.name(g) for *_, g in circle]
    if len(circle) == 1:
        return f"{names[0]} ties a body to itself"
    for (i, _, g), name in zip(circle, names, strict=True):
        i0, i1 = constraints.bodies[g]
        if i != i0:
            third, body0, body1 = (name_of_body(k, spaces[k]) for k in (i, i0, i1))
            return (
                f"{name} moves {third}, too, since an interface ends on the smooth Γ0 of {body0} "
                f"there (give Γ1 to {body0} in its ties with {body1} and {third})"
            )
    return (
        f"{', '.join(names[:-1])} and {names[-1]} lead round in a circle, from Γ0's body to Γ1's "
        "(exchange the sides of one)"
    )


class BodywiseSystem(Substitute):
    """The saddle-point system for a KSP that is preconditioned body by body.

    Multipliers and constraints are scaled to the size of K: a small residual would hide a large one
    of the constraints otherwise, if that has other units.
    """

    def __init__(self, system: System):
        """Scale the ties by the present values of K. Collective.

        Args:
            system: The saddle-point system.
        """
        self._A, self._K = system.A, system.K
        self.scales = self._scales_now()
        self._B = [[b and b.copy() for b in row] for row in system.constraints.free]
        for row, scale in zip(self._B, self.scales, strict=True):
            for b in row:
                if b is not None:
                    b.scale(scale)
        self.matrix, self._Bt = saddle.saddle_matrix(self._K, self._B)
        self.matrix.setNestVecType("standard")  # KSPs that make vectors want no nested ones
        self.matrix.assemble()
        self.x, self.b = self.matrix.createVecs()
        self.preconditioner = Substructures(system, self._B)

    def update(self, ksp: PETSc.KSP) -> bool:
        """Take the present stiffness; False if its size has changed. Collective."""
        ratio = self._scales_now() / self.scales
        if not (np.abs(np.log10(ratio)) < RESCALE).all():
            return False
        self.matrix.assemble()
        ksp.setOperators(self.matrix)
        ksp.getPC().setPythonContext(self.preconditioner)
        return True

    def _scales_now(self) -> npt.NDArray[np.float64]:
        sizes, num = saddle.block_sizes(self._A), len(self._K)
        return np.array(saddle.scales(sizes, len(sizes) - num)[num:])

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        blocks = [b for row in self._B for b in row if b is not None]
        for obj in (self.preconditioner, self.matrix, self.x, self.b, *self._Bt, *blocks):
            obj.destroy()

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec):
        """Solve with nested vectors in the units of the system. Collective."""
        parts = [part.array_r.copy() for part in b.getNestSubVecs()]
        num_bodies = len(self._K)
        for part, scale in zip(parts[num_bodies:], self.scales, strict=True):
            part *= scale
        self.b.array[:] = np.concatenate(parts)
        rtol = ksp.rtol
        ksp.setTolerances(rtol=max(rtol, FIRST))
        ksp.setInitialGuessNonzero(False)
        ksp.solve(self.b, self.x)
        self.iterations = ksp.getIterationNumber()
        ksp.setTolerances(rtol=rtol)
        if rtol < FIRST and ksp.getConvergedReason() > 0:
            ksp.setInitialGuessNonzero(True)
            ksp.solve(self.b, self.x)
            self.iterations += ksp.getIterationNumber()
        values = np.split(self.x.array_r, np.cumsum([len(part) for part in parts])[:-1])
        scales = [*np.ones(num_bodies), *self.scales]
        for part, value, scale in zip(x.getNestSubVecs(), values, scales, strict=True):
            part.array[:] = scale * value


def order_of_bodies(num_bodies: int, bodies: Sequence[Sequence[int]]) -> list[int]:
    """Order bodies such that those with Γ1 of a tie come before those with its Γ0.

    Args:
        num_bodies: Number of bodies.
        bodies: Γ0's and Γ1's body of each tie, and what else belongs to it.

    Raises:
        CycleError: If ties lead round in a circle. Its second argument has the bodies, from Γ1's to
            Γ0's, the first one again at the end.
    """
    graph = {i: [i1 for i0, i1, *_ in bodies if i0 == i] for i in range(num_bodies)}
    return list(TopologicalSorter(graph).static_order())


class Body:
    """A body's part in a step: its solver, with Γ1's own dofs held if it has any."""

    def __init__(
        self, K: PETSc.Mat, prefix: str, held: dict[int, tuple[PETSc.Mat, npt.NDArray[np.int32]]]
    ):
        """Set up the solvers, without values yet. Collective.

        Args:
            K: Stiffness.
            prefix: Prefix of the solvers' options.
            held: For each tie whose Γ1 the body has, B₁ and the dofs under its rows.
        """
        self._K = K
        start, end = K.getOwnershipRange()
        own = np.concatenate([[], *(own for _, own in held.values())])
        free = np.setdiff1d(np.arange(start, end), own).astype(PETSc.IntType)
        self._own = {t: own - start for t, (_, own) in held.items()}
        self._part = free - start
        self._is = PETSc.IS().createGeneral(free, comm=K.comm)
        self._u, self._r = K.createVecs()
        self._solver = create_solver(f"{prefix}body_", K.comm)
        self._others = np.zeros((K.getLocalSize()[0], 0))
        self._matrix: PETSc.Mat | None = None
        self._vectors: tuple[PETSc.Vec, ...] = ()
        self._squares = {}
        for t, (B, own) in held.items():
            rows = PETSc.IS().createStride(B.getLocalSize()[0], B.getOwnershipRange()[0], 1, B.comm)
            columns = PETSc.IS().createGeneral(own, comm=B.comm)
            square = B.createSubMatrix(rows, columns)
            solver = create_solver(f"{prefix}square_", K.comm)
            solver.setOperators(square)
            self._squares[t] = solver, *square.createVecs()
            for obj in (rows, columns, square):
                obj.destroy()

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        objects = [obj for triple in self._squares.values() for obj in triple]
        objects += [self._solver, self._matrix, self._is, self._u, self._r, *self._vectors]
        for obj in objects:
            if obj is not None:
                obj.destroy()

    def set_up(self, others: npt.NDArray):
        """Take the present stiffness, and add Y Yᴴ of the bodies that Γ0 moves. Collective.

        Args:
            others: This rank's rows of Y.
        """
        for obj in (self._matrix, *self._vectors):
            if obj is not None:
                obj.destroy()
        self._others = others
        self._matrix = self._K.createSubMatrix(self._is, self._is)
        if others.shape[1]:
            self._matrix = _bordered(self._matrix, others[self._part])
        self._vectors = self._matrix.createVecs()
        self._solver.setOperators(self._matrix)
        self._solver.setUp()

    def forces(self, u: npt.NDArray) -> npt.NDArray:
        """Forces that make displacements, with those on the others. Collective."""
        self._u.array[:] = u
        self._K.mult(self._u, self._r)
        comm = self._K.comm.tompi4py()
        return self._r.array_r + self._others @ comm.allreduce(self._others.conj().T @ u)

    def solve(self, r: npt.NDArray, constraints: Sequence[npt.NDArray]):
        """Displacements, and the multipliers that hold Γ1's. Collective.

        Args:
            r: This rank's loads.
            constraints: Right-hand side of B₁u for each tie whose Γ1 the body has.

        Returns:
            This rank's displacements, and the multipliers of each tie.
        """
        u, b, x = self._u, *self._vectors[::-1]
        num = len(self._part)
        b.set(0.0)
        if not self._own:
            b.array[:num] = r
            self._solver.solve(b, x)
            return x.array_r[:num], []
        u.set(0.0)
        for (t, own), value in zip(self._own.items(), constraints, strict=True):
            solver, x1, b1 = self._squares[t]
            b1.array[:] = value
            solver.solve(b1, x1)
            u.array[own] = x1.array_r
        known = u.array_r.copy()
        self._K.mult(u, self._r)
        rest = r - self._r.array_r
        b.array[:num] = rest[self._part]
        self._solver.solve(b, x)
        u.array[:] = known
        u.array[self._part] += x.array_r[:num]
        self._K.mult(u, self._r)
        rest = r - self._r.array_r
        multipliers = []
        for t, own in self._own.items():
            solver, x1, b1 = self._squares[t]
            x1.array[:] = rest[own]
            solver.solveTranspose(x1, b1)
            multipliers.append(b1.array_r.copy())
        return u.array_r, multipliers


def _bordered(K: PETSc.Mat, Y: npt.NDArray) -> PETSc.Mat:
    """[K sY; sYᴴ −s²] with a factor s of the size of Y: K + Y Yᴴ, sparse. Collective.

    Args:
        K: The matrix, which is destroyed.
        Y: This rank's rows.
    """
    comm, num, scale = K.comm, Y.shape[1], mean_diagonal(K)
    at_end = num * (comm.rank == comm.size - 1)
    i, j = np.nonzero(Y)
    entries = K.getOwnershipRange()[0] + i, j, scale**0.5 * Y[i, j]
    border = coo_matrix(comm, (K.getLocalSize()[0], at_end), *entries)
    adjoint = border.copy().hermitianTranspose()
    corner = PETSc.Mat().createConstantDiagonal(((at_end, num),) * 2, -scale, comm).convert("aij")
    nested = nest([[K, border], [adjoint, corner]], comm)
    found = nested.convert("aij", PETSc.Mat())
    for obj in (nested, K, border, adjoint, corner):
        obj.destroy()
    return found


def create_solver(prefix: str, comm) -> PETSc.KSP:
    """A KSP with the options of a prefix. Collective."""
    solver = PETSc.KSP().create(comm)
    solver.setOptionsPrefix(prefix)
    solver.setFromOptions()
    return solver


class Substructures:
    """The preconditioner, as the context of a PCPYTHON."""

    def __init__(self, system: System, B: Sequence[Sequence[PETSc.Mat | None]]):
        """Take the blocks; solvers are made on demand. Collective.

        Args:
            system: The saddle-point system.
            B: Its constraints, scaled.
        """
        constraints = system.constraints
        self._K, self._B = system.K, B
        # Global dofs under this rank's multipliers of each tie, in B₁'s order of rows
        self._own = [own.astype(PETSc.IntType) for own in constraints.own]
        # The bodies that each interface moves besides Γ1's, and Γ1's
        moved = zip(constraints.moved, constraints.bodies, strict=True)
        self._sides = [(others, i1) for others, (_, i1) in moved]
        self._order = order_of_bodies(len(self._K), _directions(constraints))
        self._spaces, self._prescribed = system.spaces, constraints.prescribed
        sizes = [k.getLocalSize()[0] for k in self._K] + [len(own) for own in self._own]
        ends = np.cumsum([0, *sizes])
        self._parts = [slice(*pair) for pair in pairwise(ends)]
        self._solvers: list[Body] = []
        self._moves: list[tuple[npt.NDArray, list[tuple[int, int, npt.NDArray]]]] = []
        self._loads: dict[tuple[int, int], tuple[PETSc.Vec, PETSc.Vec]] = {}

    def setUp(self, pc: PETSc.PC):
        """Take the bodies' present stiffness. Collective."""
        if not self._solvers:
            prefix = pc.getOptionsPrefix() or ""
            for i, K in enumerate(self._K):
                held = {t: (self._B[t][i], self._own[t]) for t in self._held_by(i)}
                self._solvers.append(Body(K, prefix, held))
            for t, (moved, i1) in enumerate(self._sides):
                for i in (*moved, i1):
                    self._loads[t, i] = self._B[t][i].createVecs()  # type: ignore[union-attr]
            self._moves = [self._motions(i) for i in range(len(self._K))]
        for i in self._order:
            self._solvers[i].set_up(self._others(i))

    def _motions(self, i: int) -> tuple[npt.NDArray, list[tuple[int, int, npt.NDArray]]]:
        """Rigid motions of a body's Γ0, part by part, and how others move along. Collective.

        Returns:
            This rank's rows of the motions, columns of length 1; for each body with Γ1 on Γ0 and
            each column that moves it: both numbers, and the same motion of that body.
        """
        V, size = self._spaces[i], self._K[i].getLocalSize()[0]
        bs, comm, (part, num_parts) = V.dofmap.index_map_bs, V.mesh.comm, parts(V)
        moves: dict[int, npt.NDArray] = {}  # dofs that move each body with Γ1
        for (others, j), row in zip(self._sides, self._B, strict=True):
            if i in others:
                at = nonzero_columns(row[i])
                moves.setdefault(j, np.zeros(size))[at] = 1
        if not moves:
            return np.zeros((size, 0)), []
        on = np.max(list(moves.values()), axis=0)
        centre = mean(comm, [places(V)[on.reshape(-1, bs).any(axis=1)]])
        masks = np.repeat(part, bs) == np.arange(num_parts)[:, None]
        Q = np.hstack([motions(V, centre) * (on * mask)[:, None] for mask in masks])
        sizes = np.sqrt(np.maximum(comm.allreduce((Q**2).sum(axis=0)), 1e-300))
        along = []
        for j, of in sorted(moves.items()):
            R = motions(self._spaces[j], centre) * ~self._prescribed[j][:, None]
            for k in np.flatnonzero(comm.allreduce(of @ np.abs(Q))).tolist():
                along.append((j, k, R[:, k % R.shape[1]] / sizes[k]))
        return Q / sizes, along

    def _others(self, i: int) -> npt.NDArray:
        """Y of a body: Y Yᴴ is the others' stiffness in rigid motions of its Γ0. Collective.

        For their stiffness S on Γ0 and motions Q, S Q (QᴴS Q)⁻¹ (S Q)ᴴ is S in these motions.
        """
        Q, along = self._moves[i]
        forces = np.zeros(Q.shape, PETSc.ScalarType)
        for j, k, motion in along:
            forces[:, k] += self._force(i, Q[:, k], j, motion)
        energies = self._K[i].comm.tompi4py().allreduce(Q.T @ forces)
        values, vectors = np.linalg.eigh((energies + energies.conj().T) / 2)
        some = values > NOTHING * mean_diagonal(self._K[i])
        scales = np.sqrt(self._excess(i) * np.where(some, values, 1))
        return forces @ (vectors * (some / scales))  # as many columns with any stiffness

    def _force(self, i: int, u: npt.NDArray, j: int, along: npt.NDArray) -> npt.NDArray:
        """Forces on a body's Γ0 by a body with Γ1 that moves along with it. Collective.

        Args:
            i: The body with Γ0.
            u: Its displacements.
            j: The body with Γ1.
            along: Displacements with which it would follow if nothing held it.
        """
        held, found, gaps = self._held_by(j), np.zeros(len(u)), []
        for t in held:
            gap = self._gap(t, j, along)
            gaps.append(-gap - self._gap(t, i, u) if i in self._sides[t][0] else -gap)
        _, multipliers = self._solvers[j].solve(-self._solvers[j].forces(along), gaps)
        for t, value in zip(held, multipliers, strict=True):
            if i in self._sides[t][0]:
                found = found + self._load(t, i, value)
        return found

    def _gap(self, t: int, i: int, u: npt.NDArray) -> npt.NDArray:
        """Gaps of a tie from displacements of one body. Collective."""
        displacement, gap = self._loads[t, i]
        displacement.array[:] = u
        self._B[t][i].mult(displacement, gap)  # type: ignore[union-attr]
        return gap.array_r.copy()

    def _load(self, t: int, i: int, multipliers: npt.NDArray) -> npt.NDArray:
        """Forces of a tie's multipliers on a body. Collective."""
        load, multiplier = self._loads[t, i]
        multiplier.array[:] = multipliers
        self._B[t][i].multTranspose(multiplier, load)  # type: ignore[union-attr]
        return load.array_r.copy()

    def _excess(self, i: int) -> float:
        """Ratio by which bodies with Γ1 on a body's Γ0 are stiffer, or 1.

        The eigenvalues of the preconditioned system are about so large then. Without it those of
        the rigid motions would be 1, outside of the others.
        """
        tied = [mean_diagonal(self._K[i1]) for others, i1 in self._sides if i in others]
        return max([1.0, *(of / mean_diagonal(self._K[i]) for of in tied)])

    def _held_by(self, i: int) -> list[int]:
        """The ties that hold a body's Γ1."""
        return [t for t, (_, i1) in enumerate(self._sides) if i1 == i]

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec):
        """A step. Collective."""
        num_bodies = len(self._K)
        r = [x.array_r[part] for part in self._parts]
        result = y.array
        for i in self._order:
            ties = self._held_by(i)
            u, multipliers = self._solvers[i].solve(r[i], [r[num_bodies + t] for t in ties])
            result[self._parts[i]] = u
            for t, value in zip(ties, multipliers, strict=True):
                result[self._parts[num_bodies + t]] = value
                for j in self._sides[t][0]:
                    r[j] = r[j] - self._load(t, j, value)

    def destroy(self, pc: PETSc.PC | None = None):
        """Destroy the PETSc objects. Collective."""
        for body in self._solvers:
            body.destroy()
        for vectors in self._loads.values():
            for vector in vectors:
                vector.destroy()
        self._solvers, self._loads = [], {}
