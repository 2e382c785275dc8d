# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Newton steps of bodies in contact by multigrid, with the projected iteration of ties.

The equations of the working set are :math:`\tilde K x + F^T f = r`, :math:`G x = c`. The rows of G
are those of closed gaps and of slips that stick. Slipping tractions have equations of their own and
are eliminated; then F differs from G, and K̃ isn't symmetric. Without friction F = G, K̃ is
symmetric, and conjugate gradients solve the system. With friction GMRES does, with the same
preconditioner.

Aggregates are those of the bodies (:mod:`~hypergap_dolfinx.algebra.hierarchy`) and are made once.
The preconditioner has springs in the place of the rows, new ones for each working set. Slipping
tractions turn, which may be all that holds a body: it has springs for them, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra import saddle
from hypergap_dolfinx.algebra.hierarchy import nest
from hypergap_dolfinx.contact_solver.complementarity import Guesses
from hypergap_dolfinx.contact_solver.contact_rows import ContactRows, Linear
from hypergap_dolfinx.contact_solver.tangent import StackedNumbering
from hypergap_dolfinx.contact_solver.tolerances import (
    HOLDS,
    NEARLY_STICKS,
    ROUGH,
    STEPS,
)
from hypergap_dolfinx.core.sparse import coo_matrix
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.solvers.bodywise import LU
from hypergap_dolfinx.solvers.multigrid import Multigrid, joined_ties
from hypergap_dolfinx.solvers.projection import Constraints, Projection
from hypergap_dolfinx.solvers.solver import Options, System, prefixed
from hypergap_dolfinx.surface.moving import Sparse, joined

Array = npt.NDArray[np.float64]


def why_not(system: System, rows: Sequence[ContactRows]) -> str | None:
    """Reason why contact can't be solved like this, or None. Collective."""
    if any(part.on_rigid_body for part in rows):
        return "a rigid body moves"
    reason = Multigrid.why_not(system)
    gives = any(part.has_compliance for part in rows)
    return reason or ("a contact has a compliance" if gives else None)


class IterationFailed(SolveError):
    """Failure of multigrid in a Newton step; factors replace it."""


class NotPositive(IterationFailed):
    """Failure since the matrix isn't positive on what the constraints allow."""


@dataclass(frozen=True)
class _Equations:
    """The equations of all contacts, by what becomes of them; the same on every rank."""

    held: npt.NDArray[np.bool_]
    """Mask of the multipliers whose equations are constraints, ``(num,)``."""
    G: Sparse
    """Constraints by multiplier and global dof."""
    F: Sparse
    """Forces of their multipliers, likewise."""
    more: Sparse
    """What is added to the stiffness."""
    forces: Sparse
    """Forces of the other multipliers."""
    slopes: Sparse
    """Equations of these by dofs."""
    by_held: Sparse
    """Equations of these by the multipliers of constraints."""
    inverse: Array
    """Inverse derivatives by themselves, zero for constraints, ``(num,)``."""
    moved: Array
    """Addition to the right-hand side of constraints that nearly stick, ``(num,)``."""
    directions: Sparse
    """Directions of the multipliers, as columns."""

    def eliminated(self) -> tuple[Sparse, Sparse]:
        """F and the addition to the stiffness, once the other multipliers are eliminated."""
        forces = self.forces.scaled(self.inverse)  # V^T F_Q
        by_dofs, by_held = forces.T @ self.slopes, self.by_held.T @ forces
        return joined(self.F, _negative(by_held)), joined(self.more, _negative(by_dofs))


def _negative(matrix: Sparse) -> Sparse:
    return Sparse(matrix.i, matrix.j, -matrix.values)


def _column(values: Array) -> Sparse:
    """Values as a matrix of one column."""
    at = np.flatnonzero(values)
    return Sparse(at, np.zeros_like(at), values[at])


def _directions(own: Sparse, num: int, size: int, stiffness: float) -> Sparse:
    """Principal directions of the multipliers' own derivatives, as columns.

    A traction that slips may stick across its direction: that is a constraint.

    Args:
        own: Derivatives of equations of multipliers by multipliers.
        num: Number of multipliers.
        size: Number of unknowns of each.
        stiffness: Stiffness of the bodies' nodes.
    """
    blocks, every = np.zeros((num, size, size)), np.arange(size)
    (i, a), (j, b) = np.divmod(own.i, num), np.divmod(own.j, num)
    is_held = np.ones((size, num), dtype=bool)
    at = own.i == own.j
    is_held[i[at], a[at]] = np.abs(own.values[at]) <= HOLDS * stiffness
    at = (a == b) & ~is_held[i, a] & ~is_held[j, b]
    blocks[a[at], i[at], j[at]] = own.values[at]
    # What is held already is a direction of its own
    blocks[:, every, every] += 10 * (np.abs(blocks).max() + stiffness) * is_held.T
    _, vectors = np.linalg.eigh(blocks)
    a, i, j = np.nonzero(vectors)
    return Sparse(i * num + a, j * num + a, vectors[a, i, j])


class MultigridTangent:
    """Solutions of the linearised equations, like those of a ``Tangent``. All is collective."""

    negative = None
    """Number of negative pivots, which is unknown."""

    name = "iterative"
    """Its name for users."""

    def __init__(
        self,
        system: System,
        rows: Sequence[ContactRows],
        prefix: str,
        options: dict | None,
        reduction: float,
        *,
        symmetric: bool,
        is_linear: bool,
    ):
        """Store the bodies, ties and contacts.

        Args:
            system: The bodies and ties.
            rows: The contacts.
            prefix: Prefix of the PETSc options.
            options: The user's.
            reduction: Reduction of the residual in a Newton step.
            symmetric: True if there is no friction.
            is_linear: True if one Newton step is exact: its residual is small beside the contacts'
                forces, too.
        """
        # As many iterations as with the ties' three sweeps, each of 3/4 of the seconds
        defaults = {**Multigrid.OPTIONS, "ksp_max_it": 200, "mg_levels_ksp_max_it": 2}
        if not symmetric:
            defaults |= {"ksp_type": "gmres", "ksp_pc_side": "right", "ksp_gmres_restart": 200}
            defaults |= prefixed("interface_redundant_", LU)  # pivots
        self._prefix = prefix
        self._made: Projection | None = None
        self._options = Options(prefix, options or {}, defaults, "")
        self._system, self._rows, self._symmetric = system, list(rows), symmetric
        self._reduction, self._is_linear = reduction, is_linear
        self._comm = system.K[0].comm.tompi4py()
        with self._options.in_use():
            self._ksp = PETSc.KSP().create(system.K[0].comm)
            self._ksp.setOptionsPrefix(prefix)
            self._ksp.setFromOptions()
        self._ties = joined_ties(system)
        numbering = StackedNumbering([K.getOwnershipRanges() for K in system.K])
        self._range = numbering.of_rank(self._comm.rank)
        self._num_dofs = self._range[1] - self._range[0]
        self._num_tied = self._ties.B.getLocalSize()[0] if self._ties is not None else 0
        num_mine = [len(part.mine) for part in rows]
        ends = self._num_dofs + self._num_tied + np.cumsum([0, *num_mine])
        self._starts, self.num_local = ends[:-1], int(ends[-1])
        """First place of each contact's among this rank's unknowns; the number of these."""
        self._first = np.cumsum([0, *(part.num_unknowns for part in rows)])
        self._dofs = [self._dofs_of(part, numbering) for part in rows]
        self.iterations = 0
        """Number of iterations in all."""
        self.is_rough = False
        """True if the last solution is accurate enough only for signs."""
        self._of_columns = 0
        """Number of iterations for columns of a Newton step."""
        self.has_converged = False
        """True if an accurate solution was found."""
        self.floor = 0.0
        """Force that is a residual of zero."""
        self._most: npt.NDArray[np.bool_] | None = None
        """Mask of the multipliers whose constraints' eigenvalues are known."""
        self._equations: list[Linear] | None = None
        self._near, self._given = 0.0, (0.0, 0.0, list[int]())
        self._constraints: Constraints | None = None
        self._more: PETSc.Mat | None = None
        self._last: tuple[Array, Array, float] | None = None
        self._at_rest: PETSc.Vec | None = None

    @staticmethod
    def _dofs_of(rows: ContactRows, numbering: StackedNumbering) -> npt.NDArray[np.int64]:
        """Global number of each of a contact's dofs among all bodies'; -1 of prescribed ones."""
        part, number = rows.unknowns
        found = np.full(len(part), -1)
        for body in {*part[part >= 0].tolist()}:
            found[part == body] = numbering.of(body, number[part == body])
        return found[part != -1]

    def destroy(self):
        """Destroy the PETSc objects."""
        self._forget()
        for obj in (self._made, self._ksp, self._ties, self._at_rest):
            if obj is not None:
                obj.destroy()
        self._made = self._ties = self._at_rest = None

    def _forget(self):
        """Destroy what belongs to the last equations."""
        for obj in (self._constraints, self._more):
            if obj is not None and obj is not self._ties:
                obj.destroy()
        self._constraints = self._more = None

    def start_step(self):
        """Start a load step."""
        self._last = None

    def remember_stiffness(self, stiffness: float):
        """Remember the diagonal of the bodies' present stiffness, which is that without stress.

        Args:
            stiffness: That of the softest part, the unit of contacts' equations.
        """
        if self._made is None:  # K has values from now on
            with self._options.in_use():
                self._made = Projection(self._system.K, self._system.spaces, self._prefix)
        self._at_rest = self._projection.K.createVecRight()
        self._projection.K.getDiagonal(self._at_rest)
        self._stiffness = stiffness

    @property
    def _projection(self) -> Projection:
        assert self._made is not None
        return self._made

    def guesses(self) -> Guesses:
        """Rule for guesses of a step's working set: each costs far less than a column."""
        self._of_columns, self._most = 0, None
        return Guesses(0, STEPS)

    def improves(self, num_wrong: int) -> bool:
        """True if the last solution is to be solved for accurately.

        Args:
            num_wrong: Number of wrong states in it.
        """
        return self.is_rough

    # Solutions

    def solve(
        self,
        right: Sequence[npt.NDArray],
        equations: Sequence[Linear],
        *,
        shift: tuple[float, float] = (0.0, 0.0),
        beside: npt.NDArray | None = None,
        anew: bool = False,
    ) -> tuple[list[npt.NDArray], list[Array]]:
        """Solve with the present stiffness; arguments and results are those of ``Tangent.solve``.

        Args:
            right: This rank's right-hand side of bodies and ties.
            equations: Equations of each contact.
            shift: Share of the bodies' stiffness, and of its diagonal without stress, that is
                added.
            beside: What is subtracted from the right-hand side, in this rank's unknowns.
            anew: True for an accurate solution, False for one whose signs alone matter.

        Raises:
            IterationFailed: The iteration failed.
        """
        try:
            with self._options.in_use():
                self._update(equations, shift, NEARLY_STICKS[anew and not self._symmetric])
        except SolveError as error:  # aggregates and springs need a positive diagonal
            raise IterationFailed(f"{error}".removesuffix(".")) from error
        own = [part.right[rows.mine] for part, rows in zip(equations, self._rows, strict=True)]
        flat = np.concatenate([*right, *own])
        loads, start, size = flat[: self._num_dofs], None, 0.0
        again = self._last is not None and np.array_equal(self._last[0], loads)
        if self._comm.allreduce(again, MPI.LAND):
            assert self._last is not None
            _, start, size = self._last
        x, size = self._solved(flat if beside is None else flat - beside, start, size, anew)
        self._last = loads, x[: self._num_dofs], size
        self._options.tell_unused(self._comm)
        ends = np.cumsum([len(part) for part in (*right, *own)])
        found = np.split(x, ends[:-1])
        return found[: len(right)], [
            rows.gathered(part) for rows, part in zip(self._rows, found[len(right) :], strict=True)
        ]

    def responses(self, loads: Sparse, of: npt.NDArray[np.intp]) -> Array:
        """Solutions for several right-hand sides; as ``Tangent.responses``.

        All of a Newton step, also those with stiffness added, are to take no more iterations than
        one solve may: factors take a substitution for each. What is left is known by the first.
        """
        found, start = np.zeros((len(of), self.num_local)), self.iterations
        left = self._ksp.max_it - self._of_columns
        for k, number in enumerate(of.tolist()):
            at = loads.i == number
            flat = np.bincount(loads.j[at], loads.values[at], self.num_local).astype(float)
            found[k], _ = self._solved(flat, None, 0.0, True, alone=True)
            if (self.iterations - start) * len(of) > left * (k + 1):
                raise IterationFailed(
                    f"finding a working set would take more than {self._ksp.max_it} iterations "
                    "(ksp_max_it)"
                )
        self._of_columns += self.iterations - start
        return found

    def _solved(self, flat: Array, start, size: float, accurate: bool, *, alone=False):
        """This rank's solution for its right-hand side, and the size of the residual at first.

        Args:
            flat: The right-hand side.
            start: This rank's displacements to start with, or None.
            size: Size of the first residual, if it is known.
            accurate: False for a solution whose signs alone matter.
            alone: True for a right-hand side that isn't that of the equations.
        """
        now = self._now
        loads, tied, rest = np.split(flat, (self._num_dofs, self._starts[0]))
        parts = np.split(rest, self._starts[1:] - self._starts[0])
        c = np.concatenate([rows.gathered(b) for rows, b in zip(self._rows, parts, strict=True)])
        c = now.directions.T.times((c,), len(c))
        c = c if alone else c + now.moved
        slipping = now.forces.T @ _column(now.inverse * c)
        loads = loads - self._of_rank(slipping)
        of, ksp, u = self._projection, self._ksp, self._projection.b.duplicate()
        u.set(0.0)
        if start is not None:
            u.array[:] = start
        with self._options.in_use():
            try:
                of.lift(u, np.concatenate((tied, c[self._own])))
            except SolveError as error:
                raise IterationFailed(f"{error}".removesuffix(".")) from error
            of.load(loads, u, of.b)
            norm = of.b.norm()
            size = max(size, norm)
            least = max(self._reduction * size, 0.0 if alone else self.floor)
            goal = least if accurate else max(ROUGH * norm, least)
            self.is_rough = not accurate and norm > least
            if norm > goal:
                ksp.setTolerances(rtol=0.0, atol=goal)
                of.add_solution(ksp, u)
                self.iterations += of.iterations
                message = (saddle.failure(ksp) or "").removesuffix(".")
                if "DIVERGED_INDEFINITE_MAT" in message:
                    raise NotPositive(message)
                if message:
                    raise IterationFailed(message)
                self.has_converged |= accurate
                of.load(loads, u, of.r)
                refines = self._is_linear and accurate and not alone
                if refines and of.refine(ksp, u, size, self._reduction):
                    self.iterations += of.iterations
                    of.load(loads, u, of.r)
        x, y = u.array_r.real.copy(), of.multipliers.real.copy()
        u.destroy()
        if not self._comm.allreduce(bool(np.isfinite(x).all()), MPI.LAND):
            raise IterationFailed("the linear solve gave no numbers")
        return np.concatenate((x, y[: len(tied)], *self._unknowns(x, c, y[len(tied) :]))), size

    def _unknowns(self, x: Array, c: Array, y: Array) -> list[Array]:
        """This rank's unknowns of each contact from its displacements and multipliers."""
        now, num = self._now, len(c)
        f, moves = np.zeros((2, num))
        f[self._own] = y
        at = now.slopes.some((self._range[0] <= now.slopes.j) & (now.slopes.j < self._range[1]))
        moves += np.bincount(at.i, at.values * x[at.j - self._range[0]], num)
        both = np.stack((f, moves))
        self._comm.Allreduce(MPI.IN_PLACE, both)
        f, moves = both
        other = c - moves - now.by_held.times((f,), num)
        f = now.directions.times((f + now.inverse * other,), num)
        return [f[a + rows.mine] for a, rows in zip(self._first, self._rows)]

    def _of_rank(self, column: Sparse) -> Array:
        """This rank's part of a column by global dofs."""
        at = column.some((self._range[0] <= column.i) & (column.i < self._range[1]))
        return np.bincount(at.i - self._range[0], at.values, self._num_dofs).astype(float)

    # Equations

    def _update(self, equations: Sequence[Linear], shift: tuple[float, float], sticks: float):
        """Take the present stiffness, and equations; as the arguments of :meth:`solve`.

        Args:
            equations: The equations.
            shift: The shares.
            sticks: Derivative of a traction by itself that is zero.
        """
        self._projection.factor = 1 + shift[0]
        near = shift[1]
        states = [K.stateGet() for K in self._system.K]
        given = near, sticks, states
        same = self._equations is not None and given == self._given
        if same and all(map(_is_same, equations, self._equations or ())):
            return
        self._now = now = self._sorted(equations, sticks)
        F, more = now.eliminated()
        self._forget()
        started = np.cumsum([0, *(rows.num_unknowns for rows in self._rows)])
        own = [a + rows.mine[now.held[a + rows.mine]] for a, rows in zip(started, self._rows)]
        self._own = np.concatenate(own)
        self._constraints = self._joined(own, now.G, None if self._symmetric else F)
        self._more = self._matrix(more, near)
        springs = self._springs(equations)
        among = self._most is not None and not (now.held & ~self._most).any()
        fewer = among and not any(len(linear.springs.i) for linear in equations)
        self._most = self._most if fewer else now.held
        self._projection.update(self._ksp, self._constraints, self._more, springs, fewer=fewer)
        self._equations, self._near, self._given = list(equations), near, given

    def _sorted(self, equations: Sequence[Linear], sticks: float) -> _Equations:
        """The equations of all contacts in global numbers."""
        num, k = self._first[-1], self._stiffness
        parts, turns = [[Sparse.empty()] for _ in range(4)], [Sparse.empty()]
        present = np.concatenate([linear.start for linear in equations])
        for start, linear, dofs, rows in zip(self._first, equations, self._dofs, self._rows):
            matrix, size = linear.matrix.summed, len(dofs)
            own = matrix.some((matrix.i >= size) & (matrix.j >= size))
            own = Sparse(own.i - size, own.j - size, own.values)
            turn = _directions(own, len(rows.g), rows.num_unknowns // len(rows.g), k)
            turns.append(Sparse(start + turn.i, start + turn.j, turn.values))
            dof = np.arange(size)
            turn = joined(
                Sparse(dof, dof, np.ones(size)), Sparse(size + turn.i, size + turn.j, turn.values)
            )
            matrix = turn.T @ (matrix @ turn)
            is_dof = matrix.i < size, matrix.j < size
            i, j = (
                np.where(of, np.append(dofs, -1)[np.where(of, at, -1)], start + at - size)
                for of, at in zip(is_dof, (matrix.i, matrix.j), strict=True)
            )
            every = Sparse(i, j, matrix.values)
            for part, (a, b) in zip(parts, ((0, 1), (1, 0), (0, 0), (1, 1)), strict=True):
                part.append(every.some((is_dof[0] == (not a)) & (is_dof[1] == (not b))))
        forces, slopes, more, own = (joined(*part) for part in parts)
        forces, directions = forces.T, joined(*turns)
        at = own.i == own.j
        diagonal = np.bincount(own.i[at], own.values[at], num)
        held = np.abs(diagonal) <= sticks * k
        return _Equations(
            held,
            slopes.some(held[slopes.i]),
            forces.some(held[forces.i]),
            more,
            forces.some(~held[forces.i]),
            slopes.some(~held[slopes.i]),
            own.some(~held[own.i] & held[own.j]),
            np.where(held, 0, 1 / np.where(held, 1, diagonal)),
            np.where(held, -diagonal * directions.T.times((present,), num), 0),
            directions,
        )

    def _joined(self, own: Sequence[npt.NDArray], G: Sparse, F: Sparse | None):
        """Constraints of ties and contacts; None if there are none at all."""
        mine = np.concatenate(own)
        if not self._comm.allreduce(len(mine)):
            return self._ties
        first = self._comm.scan(len(mine)) - len(mine)
        row = np.full(self._first[-1], -1)
        row[mine] = first + np.arange(len(mine))
        found, sides = [], list(self._ties.sides) if self._ties is not None else []
        for matrix in (G,) if F is None else (G, F):
            use = row[matrix.i] >= 0
            sizes = len(mine), self._num_dofs
            entries = row[matrix.i[use]], matrix.j[use], matrix.values[use]
            part = coo_matrix(self._system.K[0].comm, sizes, *entries)
            if self._ties is not None:
                both = nest([[self._ties.B], [part]], part.comm)
                whole = both.convert("aij", PETSc.Mat())
                for obj in (both, part):
                    obj.destroy()
                part = whole
            found.append(part)
        start = self._num_tied
        for rows, dofs, part in zip(self._rows, self._dofs, own, strict=True):
            num = len(rows.sides[0].dofs) * (len(dofs) // sum(len(s.dofs) for s in rows.sides))
            others, mine = (np.unique(self._local(of)) for of in (dofs[:num], dofs[num:]))
            sides.append((mine, np.setdiff1d(others, mine), slice(start, start + len(part))))
            start += len(part)
        return Constraints(found[0], sides, found[1] if F is not None else None)

    def _springs(self, equations: Sequence[Linear]) -> PETSc.Mat | None:
        """Springs of tractions that aren't constraints, for the preconditioner."""
        num_rows, found = 0, []
        for linear, dofs in zip(equations, self._dofs, strict=True):
            rows = linear.springs
            found.append(Sparse(num_rows + rows.i, dofs[rows.j], rows.values))
            num_rows += int(rows.i.max(initial=-1)) + 1
        if not num_rows:
            return None
        size = num_rows // self._comm.size + (self._comm.rank < num_rows % self._comm.size)
        first, every = self._comm.scan(size) - size, joined(*found)
        use = (first <= every.i) & (every.i < first + size)
        entries = every.i[use], every.j[use], every.values[use]
        return coo_matrix(self._system.K[0].comm, (size, self._num_dofs), *entries)

    def _local(self, dofs: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """This rank's dofs among global ones, in its numbers."""
        first, end = self._range
        return dofs[(first <= dofs) & (dofs < end)] - first

    def _matrix(self, entries: Sparse, near: float) -> PETSc.Mat | None:
        """What is added to the stiffness, with a share of its diagonal at rest."""
        if not len(entries.i) and not near:
            return None
        first, end = self._range
        use = (first <= entries.i) & (entries.i < end)
        i, j, values = entries.i[use], entries.j[use], entries.values[use]
        if near:
            assert self._at_rest is not None
            every = np.arange(first, end)
            i, j = np.append(i, every), np.append(j, every)
            values = np.append(values, near * self._at_rest.array_r.real)
        return coo_matrix(self._system.K[0].comm, (self._num_dofs,) * 2, i, j, values)

    # As for factors

    def watch(self, entries: Sequence[Sparse], sizes: Sequence[int]) -> Sparse:
        """Rows of numbers of contacts' unknowns, for this rank's unknowns; as ``Tangent.watch``."""
        found, before = [], 0
        first, end = self._range
        for start, dofs, rows, part, size in zip(
            self._starts, self._dofs, self._rows, entries, sizes, strict=True
        ):
            places = np.where((first <= dofs) & (dofs < end), dofs - first, -1)
            own = np.full(rows.num_unknowns, -1)
            own[rows.mine] = start + np.arange(len(rows.mine))
            column = np.append(places, own)[part.j]
            use = column >= 0
            found.append(Sparse(before + part.i[use], column[use], part.values[use]))
            before += size
        return joined(*found)

    def work(self, changes: Sequence[npt.NDArray]) -> float:
        """Work of the last matrix on changes of the bodies; as ``Tangent.work``."""
        more = self._matrix(self._now.more, self._near)  # without eliminated multipliers
        found = self._projection.work(np.concatenate(changes), more)
        if more is not None:
            more.destroy()
        return found


def _is_same(a: Linear, b: Linear) -> bool:
    """True if two equations have the same matrix."""
    same = np.array_equal(a.matrix.values, b.matrix.values)
    return (
        same and np.array_equal(a.matrix.i, b.matrix.i) and np.array_equal(a.matrix.j, b.matrix.j)
    )
