# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Matrix of Newton's steps for bodies in contact; its pattern and analysis are kept.

Active sets change from step to step, and so do the facets that face each other. So each multiplier
has an equation, p = 0 if it is inactive, and there is room for entries that may come next.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra import saddle
from hypergap_dolfinx.algebra.displacement import DisplacementField
from hypergap_dolfinx.algebra.pattern import Pattern
from hypergap_dolfinx.algebra.tolerances import BACKWARD
from hypergap_dolfinx.contact_solver.complementarity import Guesses
from hypergap_dolfinx.contact_solver.contact_rows import ContactRows, Linear
from hypergap_dolfinx.contact_solver.tolerances import (
    GUESSED,
    ITERATIONS,
    REDUCED,
    REUSED,
)
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.errors import SolveError, UnsolvableError
from hypergap_dolfinx.solvers.solver import PLANE, DirectStep, Options, names_types
from hypergap_dolfinx.solvers.tolerances import UNKNOWN
from hypergap_dolfinx.surface.moving import Sparse, joined

ROOM = {"mat_mumps_icntl_14": 30}
"""LDLᵀ needs less workspace to spare than LU; memory that isn't used takes time, too."""
COLUMNS = {"mat_mumps_icntl_27": 128}
"""Right-hand sides that are solved for at once: a third less time than with MUMPS's own 32."""
SPACE = {"mat_mumps_icntl_7": 5}
"""In space LDLᵀ is ordered by METIS, as LU is by MUMPS itself: a third less operations."""
UNFIT = (
    " The matrix has zeros on its diagonal, those of what is in contact; "
    'pc_type "lu" (MUMPS) takes them.'
)


@dataclass(frozen=True)
class Way:
    """A way to solve, and the accuracy that it has to reach."""

    options: Options
    residual: float = saddle.RESIDUAL_ACCEPTED
    """Largest accepted residual over the right-hand side."""
    keeps: bool = False
    """True if factors are kept while the matrix hardly changes."""


def ways(prefix: str, given: dict[str, Any] | None, *, plane: bool, symmetric: bool) -> list[Way]:
    """Solvers of Newton's steps, in the order in which they are tried.

    Args:
        prefix: Prefix of the KSP's options.
        given: The user's options.
        plane: True if the bodies are in the plane.
        symmetric: True if the matrix is symmetric (no friction).
    """
    defaults = {**DirectStep.OPTIONS, **COLUMNS, **(PLANE if plane else {})}
    named = names_types(given) or f"{prefix}pc_type" in PETSc.Options().getAll()
    pc = (given or {}).get("pc_type") or PETSc.Options().getAll().get(f"{prefix}pc_type")
    if pc not in (None, "lu", "cholesky"):
        defaults = {"ksp_type": "gmres", "ksp_max_it": 1000, "ksp_rtol": 1e-8}
    found = [Way(Options(prefix, given or {}, defaults, UNFIT), keeps=not named)]
    if symmetric and not named:
        defaults = {**defaults, **ROOM, **({} if plane else SPACE), "pc_type": "cholesky"}
        options = Options(prefix, given or {}, defaults, UNFIT)
        found.insert(0, Way(options, BACKWARD, keeps=True))
    return found


class StackedNumbering:
    """One numbering of the unknowns of several parts, by rank, then by part."""

    def __init__(self, ranges: Sequence[npt.NDArray]):
        """Number the unknowns.

        Args:
            ranges: First number of each part on each rank, and the end, ``(num_ranks + 1,)`` each.
        """
        self._ranges = np.array(ranges, dtype=np.int64)
        sizes = np.diff(self._ranges, axis=1)  # (part, rank)
        before = np.append(0, np.cumsum(sizes.sum(axis=0)))[:-1]
        self._start = before + np.cumsum(sizes, axis=0) - sizes
        self.sizes = sizes
        """Number of unknowns by part and rank."""

    def of(self, part: int, index: npt.NDArray) -> npt.NDArray[np.int64]:
        """Global numbers of numbers in a part."""
        ranges = self._ranges[part]
        rank = np.searchsorted(ranges[1:], index, side="right")
        return self._start[part, rank] + index - ranges[rank]

    def of_rank(self, rank: int) -> tuple[int, int]:
        """First number of a rank, and the end."""
        sizes = self.sizes.sum(axis=0)
        return int(sizes[:rank].sum()), int(sizes[: rank + 1].sum())


@dataclass
class _Retained:
    """A matrix with its pattern and its solver."""

    patterns: list[Pattern]
    mine: list[npt.NDArray[np.intp]]
    """This rank's entries of each pattern."""
    num_base: int
    """Number of this rank's entries of bodies and ties."""
    A: PETSc.Mat
    entries: compat.Triplets
    units: npt.NDArray[np.float64] | None
    """Units of this rank's rows, if they differ."""
    numbers: list[npt.NDArray[np.int64]]
    """This rank's number of each contact's unknowns, -1 for other ranks' and prescribed ones."""
    load_step: int
    """Load step in which it was made."""
    vectors: tuple[PETSc.Vec, PETSc.Vec]
    """Solution and right-hand side."""
    ksp: PETSc.KSP | None = None
    old: bool = False
    """True if the last solve used factors of a similar matrix."""
    _values: list[npt.NDArray] | None = None
    _factorised: list[npt.NDArray] | None = None
    _iterating: PETSc.KSP | None = None

    def fill(self, values: list[npt.NDArray]):
        """Set this rank's entries; factors stay valid if none changed. Collective."""
        same = self._values is not None and all(map(_is_same, values, self._values))
        if not self.A.comm.tompi4py().allreduce(same, MPI.LAND):
            self.entries.set(np.concatenate(values).astype(PETSc.ScalarType, copy=False))
            self._values = values

    def factorised(self):
        """Record that there are factors of the present matrix."""
        self._factorised = self._values

    def has_factors_near(self, values: list[npt.NDArray]) -> bool:
        """True if there are factors of nearly, but not exactly, these entries. Collective."""
        if self._factorised is None:
            return False
        pairs = list(zip(values, self._factorised, strict=True))
        changes = [part - before for part, before in pairs if part is not before]
        squares = [[np.vdot(a, a).real for a in of] for of in (changes, self._factorised)]
        sums = np.array(list(map(sum, squares)), dtype=float)
        self.A.comm.tompi4py().Allreduce(MPI.IN_PLACE, sums)
        return bool(0 < sums[0] <= REUSED**2 * sums[1])

    @property
    def iterations(self) -> int:
        """Iterations of the last :meth:`iterate`."""
        return self._iterating.getIterationNumber() if self._iterating is not None else 0

    def iterate(self, start: npt.NDArray) -> bool:
        """Solve by GMRES with factors of a similar matrix; True if that converged. Collective.

        Args:
            start: This rank's part of an approximate solution.
        """
        assert self.ksp is not None
        x, b = self.vectors
        pc, r, dx = self.ksp.getPC(), b.duplicate(), x.duplicate()
        if self._iterating is None:
            self._iterating = PETSc.KSP().create(self.A.comm)
            self._iterating.setType(PETSc.KSP.Type.GMRES)
            self._iterating.setPC(pc)
            self._iterating.setOperators(self.A)
            self._iterating.setPCSide(PETSc.PC.Side.RIGHT)
            self._iterating.setTolerances(rtol=REDUCED, max_it=ITERATIONS)
        x.array[:] = start
        self.A.mult(x, r)
        r.aypx(-1.0, b)
        pc.setReusePreconditioner(True)
        self._iterating.solve(r, dx)
        pc.setReusePreconditioner(False)
        x.axpy(1.0, dx)
        for obj in (r, dx):
            obj.destroy()
        return self._iterating.getConvergedReason() > 0

    def forget(self):
        """Destroy solvers and factors. Collective."""
        for ksp in (self.ksp, self._iterating):
            if ksp is not None:
                ksp.destroy()
        self.ksp = self._iterating = self._factorised = None

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        self.forget()
        for obj in (*self.vectors, self.A):
            obj.destroy()


def _is_same(a: npt.NDArray, b: npt.NDArray) -> bool:
    return a is b or np.array_equal(a, b)


class Tangent:
    """[K Bᵀ; B −C] of bodies and ties with the equations of contacts. All is collective."""

    name = "direct"
    """Its name for users."""

    def __init__(
        self,
        A: PETSc.Mat,
        fields: Sequence[DisplacementField],
        rows: Sequence[ContactRows],
        prefix: str,
        ways: Sequence[Way],
        num_rigid: int = 0,
        num_ties: int = 0,
    ):
        """Store the matrix and the contacts.

        Args:
            A: The nested matrix of bodies and ties.
            fields: Displacements of elastic bodies, whose block rows are the first ones.
            rows: The contacts.
            prefix: Prefix of the KSP's options.
            ways: Ways to solve; where one fails, the next one replaces it for good.
            num_rigid: Number of rigid bodies, whose block rows come next.
            num_ties: Number of ties, whose block rows come last.
        """
        self._nest, self._num_bodies, self._rows = A, len(fields) + num_rigid, list(rows)
        self._fields, self._num_ties = list(fields), num_ties
        self._mine = [part.mine for part in rows]
        self._prefix, self._ways = prefix, list(ways)
        self._retained: _Retained | None = None
        self._last_base: tuple[list[float], npt.NDArray] | None = None
        self._load_step = self.iterations = 0
        self._is_regular = False
        self.floor = 0.0
        """Force that is a residual of zero; factors don't need it."""
        self.is_rough = False
        """True if the last solution is accurate enough only for signs: never."""

    def destroy(self):
        """Destroy the PETSc objects."""
        if self._retained is not None:
            self._retained.destroy()
            self._retained = None

    def start_step(self):
        """Start a load step: entries of the last one need no room any more."""
        self._load_step += 1

    def remember_stiffness(self, of_rigid: float):
        """Remember the present stiffness of the bodies, which is that without stress.

        Args:
            of_rigid: Stiffness taken for each unknown of a rigid body.
        """
        self._elastic, self._diagonals = [], []
        num = len(self._fields)
        for i, j, block in self._blocks():
            indptr, columns, values = block.getValuesCSR()
            rows = np.repeat(np.arange(*block.getOwnershipRange()), np.diff(indptr))
            own = values * (i == j < num)
            if i == j < num and self._fields[i].num_others:
                # Of displacements alone: equations of other fields are satisfied as they are
                moves = np.concatenate(block.comm.tompi4py().allgather(~self._fields[i].others))
                mine = np.repeat(~self._fields[i].others, np.diff(indptr))
                own = own * (mine & moves[columns])
            elif num <= i == j < self._num_bodies:
                own = of_rigid * (columns == rows)
            self._elastic.append(own)
            self._diagonals.append(own * (columns == rows))

    def solve(
        self,
        right: Sequence[npt.NDArray],
        equations: Sequence[Linear],
        *,
        shift: tuple[float, float] = (0.0, 0.0),
        beside: npt.NDArray | None = None,
        anew: bool = False,
    ) -> tuple[list[npt.NDArray], list[npt.NDArray[np.float64]]]:
        """Solve with the present values of the nested matrix.

        Args:
            right: This rank's right-hand side of bodies and ties.
            equations: Equations of each contact.
            shift: Share of the bodies' stiffness without stress that is added, and of its diagonal.
            beside: What is subtracted from the right-hand side, in this rank's unknowns.
            anew: True for factors of this very matrix.

        Returns:
            This rank's displacements of each body and multipliers of ties, and the unknowns of each
            contact, the same on every rank.

        Raises:
            SolveError: The solver failed.
        """
        base = self._base(shift)
        values = self._values(equations, len(base))
        fresh = values is None
        if values is None:
            values = self._renew(equations)
        for number, way in enumerate(self._ways):
            try:
                solution = self._solve(right, equations, [base, *values], way, beside, anew=anew)
                if not any(shift):
                    self._check_regular(way)
            except SolveError:
                if not fresh or number == len(self._ways) - 1:
                    self.destroy()
                if not fresh:  # what was analysed with other values may lead to poor pivots
                    break
                if self._retained is None:
                    raise
                self._retained.forget()
            else:
                self._ways = self._ways[number:]
                return solution
        return self.solve(right, equations, shift=shift, beside=beside, anew=anew)

    def _base(self, shift: tuple[float, float]) -> npt.NDArray:
        """This rank's entries of the nested matrix, the same array while they are the same."""
        blocks = list(self._blocks())
        state = [*shift, *(block.stateGet() for *_, block in blocks)]
        if self._last_base is None or self._last_base[0] != state:
            values = [block.getValuesCSR()[2] for *_, block in blocks]
            if any(shift):
                for part, *added in zip(values, self._elastic, self._diagonals, strict=True):
                    part += shift[0] * added[0] + shift[1] * added[1]
            self._last_base = state, np.concatenate(values)
        return self._last_base[1]

    def _values(
        self, equations: Sequence[Linear], num_base: int
    ) -> list[npt.NDArray[np.float64]] | None:
        """This rank's entries of equations, by contact; None if there is no place for all."""
        retained, found = self._retained, []
        fits = retained is not None and retained.num_base == num_base
        if retained is not None:
            for pattern, mine, linear in zip(
                retained.patterns, retained.mine, equations, strict=True
            ):
                values = pattern.values(linear.matrix)
                fits &= values is not None
                found.append(np.empty(0) if values is None else values[mine])
        return found if self._nest.comm.tompi4py().allreduce(fits, MPI.LAND) else None

    def _solve(self, right, equations, values, way: Way, beside, *, anew: bool):
        """Solve in one way, with values for all places."""
        retained = self._retained
        assert retained is not None
        ksp = retained.ksp = retained.ksp or self._created(retained.A, way)
        near = way.keeps and retained.units is None and not anew
        near = near and retained.has_factors_near(values)
        retained.fill(values)
        x, b = retained.vectors
        pairs = list(zip(equations, self._mine, strict=True))
        own = [linear.right[mine] for linear, mine in pairs]
        b.array[:] = np.concatenate([*right, *own])
        if beside is not None:
            b.array[:] -= beside
        start = [np.zeros_like(part) for part in right] + [one.start[mine] for one, mine in pairs]
        retained.old = near and retained.iterate(np.concatenate(start))
        self.iterations += retained.iterations if near else 0
        if not retained.old:
            with way.options.in_use():
                saddle.solve(ksp, b, x)
            self.iterations += ksp.getIterationNumber()
            way.options.tell_unused(ksp.comm)
            message = saddle.failure(ksp, units=retained.units, bound=way.residual)
            if message and ksp.getType() not in ("preonly", "richardson"):
                raise UnsolvableError(message)  # a smaller load step is no easier for it
            if message:
                raise SolveError(message)
            retained.factorised()
        if not np.isfinite(x.norm()):
            raise SolveError("the linear solve gave no numbers.")
        values, ends = x.array_r.copy(), accumulate(map(len, start), initial=0)
        found = [values[a:b] for a, b in pairwise(ends)]
        contacts = found[len(right) :]
        return found[: len(right)], [
            rows.gathered(part) for rows, part in zip(self._rows, contacts, strict=True)
        ]

    def _check_regular(self, way: Way):
        """Raise if the last solution isn't the only one; the first that isn't zero tells."""
        retained = self._retained
        assert retained is not None and retained.ksp is not None
        ksp, x = retained.ksp, retained.vectors[0]
        direct = ksp.getPC().getType() in ("lu", "cholesky")
        if self._is_regular or retained.old or not direct or not x.norm():
            return
        num = sum(
            rows.getLocalSize()[0] for i, j, rows in self._blocks() if i == j < self._num_bodies
        )
        units = 1.0 if retained.units is None else retained.units
        with way.options.in_use():
            error = saddle.error_again(retained.A, ksp.solve, x, num, units)
        if not error <= UNKNOWN:
            raise UnsolvableError(saddle.not_unique(error))
        self._is_regular = True

    def guesses(self) -> Guesses:
        """Rule for guesses of a step's working set: each costs a factorisation."""
        return Guesses(GUESSED)

    def improves(self, num_wrong: int) -> bool:
        """True if the solution needs new factors, since the last ones are old.

        Args:
            num_wrong: Number of wrong states in it.
        """
        return num_wrong > 0 and self._retained is not None and self._retained.old

    @property
    def negative(self) -> int | None:
        """Number of negative pivots of the last factors; None if unknown."""
        assert self._retained is not None and self._retained.ksp is not None
        pc = self._retained.ksp.getPC()
        if pc.getType() != "cholesky" or pc.getFactorSolverType() != "mumps":
            return None
        return pc.getFactorMatrix().getMumpsInfog(12)

    def work(self, changes: Sequence[npt.NDArray]) -> float:
        """Work of the last matrix, without multipliers, on changes of the bodies. Collective.

        Args:
            changes: This rank's displacements of each body, 0 where they are prescribed.
        """
        retained = self._retained
        assert retained is not None
        x, b = (v.duplicate() for v in retained.vectors)
        x.set(0.0)
        values = np.concatenate(changes)
        x.array[: len(values)] = values
        retained.A.mult(x, b)
        found = x.dot(b)
        for vector in (x, b):
            vector.destroy()
        return found.real

    @property
    def num_local(self) -> int:
        """Number of this rank's unknowns of the matrix."""
        assert self._retained is not None
        return self._retained.vectors[0].getLocalSize()

    def watch(self, entries: Sequence[Sparse], sizes: Sequence[int]) -> Sparse:
        """Rows by contacts' unknowns, given by this rank's unknowns of the matrix instead.

        Args:
            entries: Rows of each contact, columns are its unknowns.
            sizes: Numbers of rows of each contact.
        """
        retained = self._retained
        assert retained is not None
        found, before = [], 0
        for numbers, part, size in zip(retained.numbers, entries, sizes, strict=True):
            column = numbers[part.j]
            use = column >= 0
            found.append(Sparse(before + part.i[use], column[use], part.values[use]))
            before += size
        return joined(*found)

    def responses(self, loads: Sparse, of: npt.NDArray[np.intp]) -> npt.NDArray:
        """Solutions for several right-hand sides, with the last factors. Collective.

        Args:
            loads: This rank's part of them, columns are its unknowns.
            of: Rows for which to solve, in ascending order.

        Returns:
            This rank's part, ``(len(of), num_local)``.

        Raises:
            SolveError: The solver failed.
        """
        retained = self._retained
        assert retained is not None and retained.ksp is not None
        ksp, (x, b) = retained.ksp, retained.vectors
        pc, num, loads = ksp.getPC(), len(of), loads.some(np.isin(loads.i, of))
        row = np.searchsorted(of, loads.i)
        if pc.getType() not in ("lu", "cholesky") or pc.getFactorSolverType() != "mumps":
            found = np.empty((num, self.num_local))
            for k, solution in enumerate(found):
                mine = row == k
                b.array[:] = np.bincount(loads.j[mine], loads.values[mine], self.num_local)
                with self._ways[0].options.in_use():
                    ksp.solve(b, x)
                message = saddle.failure(ksp, units=retained.units)
                if message:
                    raise UnsolvableError(message)
                solution[:] = x.array_r.real
            return found
        # Sparse right-hand sides, in rows that MUMPS wants on the first rank
        right, is_first = PETSc.Mat().create(b.comm), b.comm.rank == 0
        right.setSizes([(total * is_first, total) for total in (num, b.getSize())])
        right.setType(PETSc.Mat.Type.AIJ)
        entries = compat.Triplets(right, row, b.getOwnershipRange()[0] + loads.j)
        entries.set(loads.values.astype(PETSc.ScalarType))
        columns = PETSc.Mat().createTranspose(right)
        X = PETSc.Mat().createDense((b.getSizes(), (PETSc.DECIDE, num)), comm=b.comm)
        X.assemble()
        with self._ways[0].options.in_use():
            pc.getFactorMatrix().matSolve(columns, X)
        found = X.getDenseArray().real.T.copy()
        for matrix in (columns, right, X):
            matrix.destroy()
        if not b.comm.tompi4py().allreduce(bool(np.isfinite(found).all()), MPI.LAND):
            raise SolveError("the linear solve gave no numbers.")
        return found

    def _renew(self, equations: Sequence[Linear]) -> list[npt.NDArray[np.float64]]:
        """Make a matrix with room for equations; their values."""
        patterns = [rows.pattern() for rows in self._rows]
        for c, linear in enumerate(equations):
            patterns[c] = patterns[c].joined(Pattern.of(patterns[c].size, linear.matrix))
            if self._retained is not None and self._retained.load_step == self._load_step:
                patterns[c] = patterns[c].joined(self._retained.patterns[c])
        self.destroy()
        self._retained = self._made(patterns)
        values = self._values(equations, self._retained.num_base)
        assert values is not None
        return values

    def _made(self, patterns: list[Pattern]) -> _Retained:
        """A matrix with room for what the nested one has, and for patterns of contacts."""
        nest = self._nest
        comm = nest.comm.tompi4py()
        num = nest.getNestSize()[0]
        ranges = [nest.getNestSubMatrix(i, i).getOwnershipRanges() for i in range(num)]
        numbering = StackedNumbering([*ranges, *(rows.ranges for rows in self._rows)])
        first, end = numbering.of_rank(comm.rank)
        i, j, mine, numbers = [], [], [], []
        for k, of, block in self._blocks():
            indptr, columns, _ = block.getValuesCSR()
            rows_of = np.arange(*block.getOwnershipRange())
            i.append(np.repeat(numbering.of(k, rows_of), np.diff(indptr)))
            j.append(numbering.of(of, columns))
        num_base = sum(map(len, i))
        for c, (rows, pattern) in enumerate(zip(self._rows, patterns, strict=True)):
            part, number = rows.unknowns
            among = np.full(len(part), -1)
            for body in {*part[part >= -1].tolist()}:
                among[part == body] = numbering.of(
                    num + c if body == -1 else body, number[part == body]
                )
            numbers.append(np.where((first <= among) & (among < end), among - first, -1))
            row, column = (among[at] for at in pattern.places)
            mine.append(np.flatnonzero((first <= row) & (row < end)))
            i.append(row[mine[-1]])
            j.append(column[mine[-1]])
        size = end - first
        A = PETSc.Mat().create(nest.comm)
        A.setSizes(((size, None), (size, None)))
        A.setType(PETSc.Mat.Type.AIJ)
        entries = compat.Triplets(A, np.concatenate(i), np.concatenate(j))
        units = None
        if num > self._num_bodies:
            units = np.ones(size)
            of_nest = np.repeat(
                saddle.scales(saddle.block_sizes(nest), self._num_ties),
                numbering.sizes[:num, comm.rank],
            )
            units[: len(of_nest)] = of_nest
        return _Retained(
            patterns, mine, num_base, A, entries, units, numbers, self._load_step, A.createVecs()
        )

    def _created(self, A: PETSc.Mat, way: Way) -> PETSc.KSP:
        """A KSP for a matrix."""
        ksp = PETSc.KSP().create(A.comm)
        ksp.setOperators(A)
        ksp.setOptionsPrefix(self._prefix)
        try:
            with way.options.in_use():
                ksp.setFromOptions()
        except SolveError:
            ksp.destroy()
            raise
        return ksp

    def _blocks(self) -> Iterator[tuple[int, int, PETSc.Mat]]:
        num = self._nest.getNestSize()[0]
        for i in range(num):
            for j in range(num):
                block = self._nest.getNestSubMatrix(i, j)
                if block:
                    yield i, j, block
