# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One linearised contact problem, solved exactly: factors, and a small complementarity problem.

Without friction the problem is min ½ dᵀHd + rᵀd subject to g + Cd ≥ 0. For a working set A it is a
linear system with the matrix S = [H C_Aᵀ; C_A −c]. Its solution may have negative pressures in A,
or negative gaps outside A. Each such row gets an unknown z: a slack in A, a pressure outside. The
solution depends linearly on z, with one right-hand side of S for each unknown. So the signs of
these few rows are a linear complementarity problem
(:mod:`~hypergap_dolfinx.contact_solver.complementarity`), and nothing is factorised again. Rows
that its solution gives a wrong sign join, until there are none. The matrix of the complementarity
problem is a principal pivot of C H⁻¹ Cᵀ. So the solution is unique if H is positive on
displacements that keep the rows under pressure closed.

If H is that with the rows of A closed, but not without those that open, the small problem may have
no solution but a ray: a body turns, and nothing resists. The first row that gets a wrong sign along
it joins. If there is none, the linearised problem has no solution.

With friction a multiplier has n equations: one of the gap, the others of its slip, which sticks or
slips. A multiplier with a wrong state gets n unknowns. So does one whose law isn't linear in its
state, as where tractions turn. The small problem then contains Coulomb's law, and is solved by
Newton's method with a line search. The normal forces that bound friction at a vertex are sums of
several multipliers. So they are found with gaps and slips, behind these.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver import complementarity
from hypergap_dolfinx.contact_solver.complementarity import Guesses
from hypergap_dolfinx.contact_solver.contact_rows import ContactRows, Linear
from hypergap_dolfinx.contact_solver.multigrid_tangent import MultigridTangent, NotPositive
from hypergap_dolfinx.contact_solver.tangent import Tangent
from hypergap_dolfinx.contact_solver.tolerances import ADDED, PIVOT, SHORTENED, STEPS, TRIALS
from hypergap_dolfinx.surface.moving import Sparse

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Solution:
    """Solution of a linearised contact problem."""

    changes: list[Array]
    """What is subtracted from this rank's unknowns of bodies and ties."""
    y: list[Array]
    """Gaps and slips of each contact over areas times √stiffness, flat."""
    f: list[Array]
    """Pressures and tractions, times areas over √stiffness, likewise."""
    changed: list[npt.NDArray[np.bool_]]
    """Mask of those that were unknowns of the small problem, likewise."""
    is_solved: bool
    """False if the problem has no solution; values are those of the working set then."""
    leaves: bool
    """True if there is a solution only with bodies held near their places."""
    base: list[Array]
    """Multipliers of the working set, in the same units and order."""
    is_stiffened: bool = False
    """True if stiffness was added."""
    is_guess: bool = False
    """True if so many states are wrong that those found are tried as a working set."""


@dataclass
class _Laws:
    """Laws of contact and friction, not satisfied yet."""

    error: Array
    are_satisfied: bool
    parts: list[tuple[npt.NDArray[np.intp], tuple[npt.NDArray, Array], tuple[npt.NDArray, Array]]]
    """By contact the places of its unknowns; places of gaps, and derivatives by these; the same of
    multipliers."""

    def slope(self, A: Array, B: Array) -> Array:
        """Derivative by unknowns, of which A and B are those of multipliers and gaps."""
        found = np.zeros_like(A)
        for rows, *parts in self.parts:
            for (at, by), matrix in zip(parts, (B, A), strict=True):
                found[rows.T] += by.transpose(2, 0, 1) @ matrix[at.T]
        return found


def largest_change(comm: MPI.Comm, changes, held) -> float:
    """Largest change of displacements that aren't prescribed. Collective."""
    parts = [np.abs(dx[~on]).max(initial=0) for on, dx in zip(held, changes, strict=False)]
    return comm.allreduce(float(max(parts)), MPI.MAX)


class LinearisedContact:
    """A linearised contact problem of several contacts. All is collective."""

    def __init__(
        self,
        tangent: Tangent | MultigridTangent,
        rows: Sequence[ContactRows],
        equations: Sequence[Linear],
        stiffness: float,
    ):
        """Store the parts of the problem.

        Args:
            tangent: The matrix.
            rows: The contacts, with their working sets.
            equations: Their equations with these.
            stiffness: Stiffness of the bodies' nodes, by which rows are scaled.
        """
        self._tangent, self._rows, self._equations = tangent, rows, equations
        self._root = float(np.sqrt(stiffness))
        self._comm = rows[0].spaces[0].mesh.comm
        self._on = np.concatenate([part.is_in for part in rows])
        self._ends = list(accumulate([part.num_unknowns for part in rows], initial=0))
        self._starts = list(accumulate([part.num_lengths for part in rows], initial=0))

    @cached_property
    def _own(self) -> npt.NDArray[np.intp]:
        """Numbers of the gaps and slips of unknowns among all lengths."""
        each = zip(self._starts, self._rows, strict=False)
        return np.concatenate([at + np.arange(part.num_unknowns) for at, part in each])

    def solve(
        self,
        right: Sequence[npt.NDArray],
        num_tied: int,
        held: Sequence[npt.NDArray[np.bool_]],
        nearness: Callable[[], float] | None,
        guesses: Guesses,
        reach: float,
    ) -> Solution:
        """Solve the problem, with stiffness added to H if needed.

        A share of the stiffness without stress is added if H isn't positive (multigrid needs that
        of guesses of the working set, too), or if the step is too long, which happens near a snap-
        through, where H is hardly positive. A matrix with more negative pivots than multipliers is
        accepted if H does positive work on the solution. Bodies that contact doesn't hold in the
        linearised problem (a ray along which no row joins) get a share of the diagonal. If a row
        far away ends a ray, the step may be too long, and gets a share of the stiffness.

        Args:
            right: This rank's right-hand side of bodies and ties.
            num_tied: Number of the ties' multipliers.
            held: Mask of each body's prescribed owned dofs.
            nearness: Gives the first share of the diagonal; None if no body is free.
            guesses: Guesses of the working set before.
            reach: Largest displacement that is accepted, but for prescribed ones.

        Raises:
            SolveError: The linear solver failed.
        """
        num = num_tied + int(self._on.sum())
        stiff = near = 0.0
        for trial in range(TRIALS + 1):
            try:
                found = self._solve(right, num, (stiff, near), guesses)
            except NotPositive:
                if trial == TRIALS:
                    raise
                stiff = stiff / SHORTENED or ADDED
                continue
            if found.is_guess:
                return found
            negative = self._tangent.negative
            is_positive = negative is not None and negative <= num
            if found.is_solved:
                is_short = largest_change(self._comm, found.changes, held) <= reach
                free = [np.where(on, 0, dx) for on, dx in zip(held, found.changes, strict=False)]
                if is_short and (is_positive or self._tangent.work(free) > 0):
                    break
                is_positive &= is_short
            elif negative is None:  # of LU, with friction
                is_positive = True
            if is_positive and nearness:
                near = near / SHORTENED or nearness()
            else:
                stiff = stiff / SHORTENED or ADDED
        return replace(found, leaves=near > 0, is_stiffened=stiff > 0)

    def _solve(self, right, num: int, shift: tuple[float, float], guesses: Guesses) -> Solution:
        """Solve it with shares of the stiffness without stress, and of its diagonal, added.

        Args:
            right: As in :meth:`solve`.
            num: Number of multipliers in the matrix.
            shift: Both shares.
            guesses: As in :meth:`solve`.
        """
        changes, y, f = self._base(right, shift)
        more = self._wrong(y, f, guesses)
        if not guesses.allow(len(more)) and self._tangent.improves(len(more)):
            changes, y, f = self._base(right, shift, anew=True)
            more = self._wrong(y, f, guesses)
        if not len(more):
            return self._found(changes, y, f, more, f)
        if guesses.allow(len(more)):
            pulled = self._pulled(f)
            f = np.where(pulled, np.minimum(f, y[self._own] - 1), f)
            more = np.union1d(more, np.flatnonzero(pulled))
            return replace(self._found(changes, y, f, more, f), is_guess=True)
        y0, f0, of, z = y, f, np.empty(0, dtype=np.intp), np.empty(0)
        gaps, forces, loads = self._watched()
        A, B = np.empty((len(f), 0)), np.empty((len(y), 0))
        while len(more):
            by_f, by_y = self._columns(self._tangent.responses(loads, more), gaps, forces, more)
            A, B, of = np.hstack((A, by_f)), np.hstack((B, by_y)), np.append(of, more)
            z = np.append(z, np.zeros(len(more)))
            small = self._lcp if all(p.num_unknowns == len(p.g) for p in self._rows) else self._law
            found, is_solved = small(y0, f0, A, B, of, z)
            if is_solved:
                z = found
                y, f = y0 + B @ z, f0 + A @ z
                more = self._wrong(y, f, guesses)
                more = more[~np.isin(more, of)]
                continue
            holds = (self._tangent.negative or 0) <= num  # H positive with A closed, or not known
            more = self._first_along(y, f, B @ found, A @ found, of) if holds else more[:0]
            if not len(more):
                return self._found(changes, y0, f0, of, f0, solved=False)
        unknowns = np.zeros(len(f))
        unknowns[of] = z
        beside = np.bincount(loads.j, loads.values * unknowns[loads.i], self._tangent.num_local)
        changes, _, now = self._base(right, shift, beside=beside, anew=True)
        return self._found(changes, y, np.where(self._on, now, f), of, f0)

    def _first_along(self, y, f, by_y, by_f, of) -> npt.NDArray[np.intp]:
        """Number of the first row, not one of these, that gets a wrong sign along a ray, if any."""
        y, by_y = y[self._own], by_y[self._own]
        now, slope = np.where(self._on, (f, by_f), (y, by_y))
        largest = np.where(self._on, *(np.abs(by).max(initial=0) for by in (by_f, by_y)))
        falls = np.concatenate([np.resize(p.valid, p.num_unknowns) for p in self._rows])
        falls &= slope < -PIVOT * largest
        falls[of] = False
        rows = np.flatnonzero(falls)
        return rows[np.argsort(np.maximum(now[rows], 0) / -slope[rows], kind="stable")[:1]]

    def _watched(self) -> list[Sparse]:
        """Gaps and multipliers by this rank's unknowns of the matrix, and right-hand sides."""
        return [
            self._tangent.watch([getattr(p, name)() for p in self._rows], np.diff(ends).tolist())
            for name, ends in (
                ("watched_gaps", self._starts),
                ("watched_forces", self._ends),
                ("loads", self._ends),
            )
        ]

    def _columns(self, x: Array, gaps: Sparse, forces: Sparse, of) -> tuple[Array, Array]:
        """Derivatives of multipliers and of gaps by new unknowns, ``(num, len(of))`` each.

        Args:
            x: Solutions for these, ``(len(of), num_local)``.
            gaps: Gaps by this rank's unknowns.
            forces: Multipliers, likewise.
            of: Numbers of the new unknowns.
        """
        num = len(self._on)
        both = np.hstack([-forces.products(x, num), gaps.products(x, self._starts[-1])])
        self._comm.Allreduce(MPI.IN_PLACE, both)
        by_f, by_y = both.T[:num], both.T[num:]
        by_f[of, np.arange(len(of))] += ~self._on[of]
        return by_f, by_y + self._given(self._split(by_f, self._ends))

    def _given(self, f: list[Array]) -> Array:
        """What each contact's multipliers add to its gaps."""
        return np.concatenate([p.given(of) for p, of in zip(self._rows, f, strict=True)])

    def _lcp(self, y0, f0, A, B, of, z) -> tuple[Array, bool]:
        """The unknowns without friction: pressures outside of the working set, slacks in it."""
        on = self._on[of]
        least = np.concatenate([np.resize(p.least(), p.num_unknowns) for p in self._rows])[of]
        M, b = np.where(on[:, None], A[of], B[of]), np.where(on, f0[of], y0[of])
        return complementarity.solved(M, b, least)

    def _law(self, y0, f0, A, B, of, z) -> tuple[Array, bool]:
        """The unknowns with friction, zero and False if none are found.

        If Newton's method fails, it is repeated with a compliance of the rows that falls to zero.
        With a large one there is one solution, multipliers of zero, but where a load acts on a body
        that nothing else holds: there the path may not begin. Gaps have the round-off of the
        compliance times A. A step of the path that fails is halved.
        """
        own, (watched, vertices) = slice(len(of)), self._vertices(of)
        y0, f0, A, B = y0[watched], f0[of], A[of], B[watched]
        found, give = self._newton(y0, f0, A, B, vertices, z), float(np.abs(B[own]).max())
        if found is not None:
            return found, True
        z, power, step, failures = np.linalg.lstsq(A, -f0, rcond=PIVOT)[0], -1.0, 1.0, 0
        begins = bool(np.linalg.norm(f0 + A @ z) <= PIVOT * np.linalg.norm(f0))
        while failures < TRIALS:
            share = give * SHORTENED**power if power < 2 * TRIALS else 0.0
            zero = 1 + share * np.abs(A).max()
            soft, by_z = y0.copy(), B.copy()
            soft[own] += share * f0
            by_z[own] += share * A
            found = self._newton(soft, f0, A, by_z, vertices, z, zero)
            if found is None and not begins:
                break
            if found is None:
                step, failures = step / 2, failures + 1
                power -= step
            elif share:
                z, power, begins = found, power + step, True
            else:
                return found, True
        return np.zeros(len(of)), False

    def _newton(self, y0, f0, A, B, vertices, z, zero=1.0) -> Array | None:
        """Newton's method with a line search, and with full steps if that finds no descent.

        Errors of gaps and of forces have no common scale. In a stiff row a smaller error of the gap
        may need a larger error of the force, and a line search finds no descent. ``zero`` is a
        factor of what is treated as zero.
        """
        found = self._descended(y0, f0, A, B, vertices, z, zero, TRIALS)
        return self._descended(y0, f0, A, B, vertices, z, zero, 0) if found is None else found

    def _descended(self, y0, f0, A, B, vertices, z, zero: float, trials: int) -> Array | None:
        """Newton's method with so many trials of a shorter step; all steps are full for none.

        Where states make the equations singular, a step goes far, to other states. But it is no
        solution: this is the least one, if there is any in these states. Without a line search the
        way ends there: any states could follow.
        """
        laws = self._laws(y0 + B @ z, f0 + A @ z, vertices, zero)
        for _ in range(STEPS):
            if laws.are_satisfied:
                return z
            slope = laws.slope(A, B)
            way, is_regular = complementarity.solution(slope, -laws.error)
            if not is_regular:
                near = z + np.linalg.lstsq(slope, -laws.error, rcond=PIVOT)[0]
                if self._laws(y0 + B @ near, f0 + A @ near, vertices, zero).are_satisfied:
                    return near
                if not trials:
                    return None
            size, share, start = np.linalg.norm(laws.error), 1.0, z
            for _ in range(max(trials, 1)):
                z = start + share * way
                laws = self._laws(y0 + B @ z, f0 + A @ z, vertices, zero)
                if not trials or np.linalg.norm(laws.error) < size:
                    break
                share /= 2
            else:
                return None
            if not is_regular and laws.are_satisfied:
                return None  # nothing holds what went far
        return None

    def _vertices(self, of):
        """Numbers of the gaps that the laws of these unknowns take, and the contacts with any.

        Returns:
            The numbers of these unknowns' gaps and slips, then of the normal forces that bound
            friction there; each contact, numbers of its vertices, and places of their unknowns in
            ``of`` and of what they take among these numbers.
        """
        place, found, numbers, end = np.full(self._on.shape, -1), [], [self._own[of]], len(of)
        place[of] = np.arange(len(of))
        each = zip(self._rows, self._split(place, self._ends), self._starts, strict=False)
        for part, places, start in each:
            places = places.reshape(-1, len(part.g))
            at = np.flatnonzero(places[0] >= 0)
            more = start + np.arange(part.num_unknowns, part.num_lengths).reshape(-1, len(part.g))
            if len(at):
                rows, more = places[:, at], more[:, at]
                forces = np.arange(end, end := end + more.size).reshape(more.shape)
                numbers.append(more.ravel())
                found.append((part, at, rows, np.vstack((rows, forces))))
        return np.concatenate(numbers), found

    def _laws(self, y, f, vertices, zero=1.0) -> "_Laws":
        """Laws of some unknowns at their gaps, slips and normal forces, and multipliers.

        Args:
            y: Gaps, slips and normal forces, as :meth:`_vertices` numbers them.
            f: Multipliers.
            vertices: The contacts, likewise.
            zero: As of :meth:`_newton`.
        """
        found = _Laws(np.zeros(len(f)), True, [])
        for part, at, rows, known in vertices:
            error, by_y, by_f, least = part.law(y[known], f[rows], at)
            found.error[rows] = error
            found.are_satisfied &= bool((np.abs(error) <= zero * least).all())
            found.parts.append((rows, (known, by_y), (rows, by_f)))
        return found

    def _base(self, right, shift, **options) -> tuple[list[Array], Array, Array]:
        """Solution of the linear system: displacements, gaps and slips, pressures and tractions."""
        changes, unknowns = self._tangent.solve(right, self._equations, shift=shift, **options)
        root = self._root
        f = self._split(root * np.where(self._on, np.concatenate(unknowns), 0), self._ends)
        y = np.concatenate([part.new_gaps(changes) for part in self._rows]) + self._given(f)
        return changes, y, np.concatenate(f)

    def _wrong(self, y: Array, f: Array, guesses: Guesses) -> npt.NDArray[np.intp]:
        """Numbers of the unknowns whose laws don't hold; if they are many, whose state is wrong.

        Laws in the right state are solved exactly by guesses if these are cheap, or by few columns,
        from solutions that are accurate enough.
        """
        parts = list(zip(self._rows, *self._both(y, f), strict=True))
        for exactly in (not self._tangent.is_rough, False):
            masks = [part.wrong(*of, exactly=exactly) for part, *of in parts]
            found = np.flatnonzero(np.concatenate(masks))
            if len(found) <= guesses.least or guesses.patience > 0:
                break
        return found

    def _pulled(self, f: Array) -> npt.NDArray[np.bool_]:
        """Mask of the unknowns in the working set that open with others in rough solutions."""
        masks = [part.pulled(of) for part, of in zip(self._rows, self._split(f, self._ends))]
        return np.concatenate(masks) & self._tangent.is_rough

    @staticmethod
    def _split(values: npt.NDArray, ends: Sequence[int]) -> list[npt.NDArray]:
        """Values by contact."""
        return [values[a:b] for a, b in pairwise(ends)]

    def _both(self, y: Array, f: Array) -> tuple[list[Array], list[Array]]:
        """Gaps and multipliers by contact."""
        return self._split(y, self._starts), self._split(f, self._ends)

    def _found(self, changes, y, f, of, base, *, solved: bool = True) -> Solution:
        changed = np.zeros(len(f), dtype=bool)
        changed[of] = True
        new, now = self._both(y, f)
        mask, before = (self._split(part, self._ends) for part in (changed, base))
        return Solution(changes, new, now, mask, solved, leaves=False, base=before)
