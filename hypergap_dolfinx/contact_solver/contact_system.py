# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The semi-smooth Newton iteration for bodies in contact.

:meth:`ContactSystem._newton` solves a load step. It stops (:meth:`ContactSystem._balances`) at an
iterate, after at least one step, at which

- the residual of bodies, ties and contact forces is at most rtol times the forces in the bodies,
  or of the size of round-off in them (ROUND_OFF_FORCES),
- active gaps are closed; with friction sticking vertices don't slip, and tractions are μ p
  elsewhere (``ContactRows.is_closed``),
- the active sets are those of the iterate before (checked in :meth:`ContactSystem._newton`).

A SolveError is raised if an active multiplier has to pull there. With friction there is one more
step if gaps aren't closed to round-off.
"""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem
from hypergap_dolfinx.algebra.floating import FreeMotions, RigidBodyDiagnostics
from hypergap_dolfinx.contact_solver import active_set
from hypergap_dolfinx.contact_solver.contact_rows import (
    ContactPair,
    ContactRows,
    Linear,
    NormalState,
    SystemState,
    share_ends,
)
from hypergap_dolfinx.contact_solver.friction_rows import (
    FrictionRows,
    FrictionState,
    hold_by_sticking,
)
from hypergap_dolfinx.contact_solver.exact_step import LinearisedContact
from hypergap_dolfinx.contact_solver.predictor import motions_of, prescribed_motions, turns_together
from hypergap_dolfinx.contact_solver.relaxation import Relaxation
from hypergap_dolfinx.contact_solver.tangent import Tangent, ways
from hypergap_dolfinx.contact_solver.tolerances import (
    AHEAD,
    OSCILLATES,
    BACK,
    ENOUGH,
    PATIENCE,
    PROGRESS,
    RAYS,
    TRIALS,
    EXCEEDS,
    RELAXED,
    REUSED,
    ROUND_OFF_FORCES,
    SHIFT,
    SHIFTS,
    SHORTENED,
    STEPS,
    UNPRESSED,
)
from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.core.sparse import mean_diagonal, row_length
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.multipliers.interface import TiedInterfaces
from hypergap_dolfinx.solvers.newton import NonlinearSystem
from hypergap_dolfinx.surface.moving import Displacements


import os

DEBUG = bool(os.environ.get("DEBUGC"))


class ContactSystem(NonlinearSystem):
    """F_i(u_i) − Σ_c Cᵀ_ci p_c + Σ_t Bᵀ_ti λ_t, and the gaps of what is in contact."""

    def __init__(
        self,
        F: Sequence[ufl.Form],
        u: Sequence[fem.Function],
        bcs: Sequence[fem.DirichletBC],
        pieces: TiedInterfaces,
        pairs: Sequence[ContactPair],
        *,
        names: Sequence[str],
        rtol: float,
        petsc_options_prefix: str,
        petsc_options: dict | None,
        **compiling,
    ):
        """Compile the forms. Collective.

        Args:
            F: Residual form of each body.
            u: Displacement of each body.
            bcs: Dirichlet conditions of any of the bodies.
            pieces: The ties, and the interfaces that they are pieces of.
            pairs: The contacts with their bodies.
            names: Names of the bodies, for messages.
            rtol: Residual, over the forces in the bodies, treated as zero.
            petsc_options_prefix: Prefix of the KSP's options.
            petsc_options: Options of the KSP.
            compiling: J and options, as for :class:`NonlinearSystem`.
        """
        super().__init__(F, u, bcs, pieces, **compiling)
        self._rtol, self._names = rtol, names
        self._comm = self._u[0].function_space.mesh.comm
        self._rows = [
            (ContactRows if pair.contact.friction is None else FrictionRows)(pair, self._held)
            for pair in pairs
        ]
        for rows in self._rows:
            rows.register()
        self._frictional = [rows for rows in self._rows if isinstance(rows, FrictionRows)]
        share_ends(self._rows, pieces.interfaces)
        self._tangent = Tangent(
            self._A,
            len(self._K),
            self._rows,
            petsc_options_prefix,
            ways(
                petsc_options_prefix,
                petsc_options,
                plane=self._u[0].function_space.mesh.topology.dim == 2,
                symmetric=not self._frictional,
            ),
        )
        self._free: FreeMotions | None = None
        self._tied = bool(pieces.interfaces)
        self._iterations = self._num_free = 0
        self._softest, self._stiffness_of = 0.0, list[int | None]()
        self._row_lengths = list[float]()

    def _release(self) -> list:
        return [self.__dict__.pop("_tangent", None), *super()._release()]

    def _prepare(self):
        """Start a solve; at first find the rigid motions that only contact holds. Collective."""
        for u, x in zip(self._u, self._x.getNestSubVecs()):
            x.array[:] = u.x.array[: x.getLocalSize()]
        for rows in self._rows:
            rows.start_solve()
        if self._free is None:
            self.assemble_matrix()
            self._scales_fixed = True
            self._tangent.remember_stiffness()
            self._free = FreeMotions(self._system.spaces, self._K, self._constraints)
            self._num_free = self._free.num
            self._strays = RigidBodyDiagnostics(self._system.spaces, self._free, self._names)

    def _state(self) -> SystemState:
        parts = self._x.getNestSubVecs()
        return SystemState(
            [part.array_r.copy() for part in parts], [rows.state.copy() for rows in self._rows]
        )

    def _restore(self, state: SystemState):
        for part, value in zip(self._x.getNestSubVecs(), state.values, strict=True):
            part.array[:] = value
        self._assign(self._x)
        for rows, contact in zip(self._rows, state.contacts, strict=True):
            rows.restore(contact)

    def _go(
        self, start: SystemState, end: SystemState, share: float
    ) -> tuple[SystemState, SystemState]:
        """Take a share of the way between two states: the first one, and the state reached."""
        end = start.towards(end, share)
        self._restore(end)
        return start, end

    def _newton(self) -> int:
        """Newton's iteration for the present values of the load. Collective.

        Returns:
            The number of its steps.

        Raises:
            SolveError: It failed.
        """
        self._assign(self._x)
        self._tangent.start_step()
        for rows in self._rows:
            rows.start_step()
        self._constraints.read_jumps()
        self._goal = self._lifted()
        self._lead()
        return self._alternate() if self._frictional and os.environ.get('OLDF') else self._iterate()

    def _iterate(self) -> int:
        """Newton's iteration without friction: each step solves its linearised contact problem."""
        self._largest, self._rays, best, since = 0.0, 0, np.inf, 0
        polished, backwards, before, square = False, 0, [], 0.0
        for step in range(STEPS + 1):
            for rows in self._rows:
                rows.update_geometry()
            self._evaluate(self._x, self._b)
            jump = self._jump()
            if step == 0:
                self._assemble_what_moved()
            for rows in self._rows:
                rows.start_set(self._stiffness(), self._zero_pressure())
            if self._num_free:
                self._hold()
            if self._balances() and (step or self._is_exact):
                if polished or all(rows.is_exact for rows in self._rows):
                    self._check_pushing()
                    return step
                polished = True
            if step == STEPS:
                break
            if step:
                try:
                    self.assemble_matrix()
                except ValueError as error:  # points of the residual needn't see cells inverted
                    raise SolveError(f"Newton's iteration diverged: {error}") from error
            self._iterations += 1
            if step == 0 and self._slides(jump):
                self._carry()
                continue
            natural = self._natural()
            since = since + 1 if natural > PROGRESS * best else 0
            best = min(best, natural)
            if DEBUG:
                print(f"  residual {natural:.3e} since {since}")
            start, end, work = self._step_exactly()
            if DEBUG:
                print("   work", work)
            moves = [b - a for a, b in zip(start.values[:len(self._u)], end.values)]
            product = np.array([sum(map(np.dot, moves, other)) for other in (moves, before or moves)])
            self._comm.Allreduce(MPI.IN_PLACE, product)
            turned = before and product[1] < OSCILLATES * np.sqrt(product[0] * square)
            before, square = moves, product[0]
            if self._frictional and work < 0 and turned and backwards < BACK:
                self._restore(start.towards(end, -1.0))
                backwards += 1
            else:
                self._search((start, end), always=since >= PATIENCE and step > 0)
        raise SolveError(f"Newton's iteration did not end in {step} steps.")

    def _natural(self) -> float:
        """Size of what is left of forces, gaps and pulls, as forces. Collective."""
        c = self._stiffness()
        left = [
            np.minimum(rows.state.p * rows.m / c, rows.distance)[rows.valid] for rows in self._rows
        ]
        return float(np.hypot(self._unbalanced, c * np.linalg.norm(np.concatenate(left))))

    def _search(self, way, *, always: bool):
        """Shorten a step until its end is one of numbers, and of less penalty. Collective."""
        start, end = way
        owned = self._owned()
        ends = self._x.getNestSubVecs()[: len(owned)]
        if not always:
            share = 1.0
            for _ in range(TRIALS):
                self._evaluate(self._x, self._b)
                if np.isfinite(
                    self._comm.allreduce(
                        sum(float(np.abs(b.array_r).sum()) for b in self._b.getNestSubVecs())
                    )
                ):
                    return
                share /= 4
                start.towards(end, share)
                self._restore(start.towards(end, share))
                self._set_sets(end)
            raise SolveError("Newton's iteration diverged: the residual is no number.")
        moves = [b - a for a, b in zip(start.values[: len(owned)], end.values)]
        held = self._held
        moves = [np.where(h, 0, m) for h, m in zip(held, moves)]
        price = 2 * max(max(np.abs(s.p).max(initial=0) for s in state.contacts) for state in way)

        def at(share):
            self._restore(start.towards(end, share))
            for rows in self._rows:
                rows.update_geometry()
            self._evaluate(self._x, self._b)
            parts = self._b.getNestSubVecs()
            slope = self._comm.allreduce(
                sum(float(np.dot(m, b.array_r)) for m, b in zip(moves, parts))
            )
            overlap = sum(
                float(np.maximum(-rows.clearance, 0)[rows.valid].sum()) for rows in self._rows
            )
            return slope, price * overlap

        first, before = at(0.0)
        share, (last, overlap) = 1.0, at(1.0)
        for _ in range(TRIALS):
            middle, between = at(share / 2)
            change = share / 6 * (first + 4 * middle + last) + overlap - before
            if DEBUG:
                print("    search", share, change, first, before)
            if change <= ENOUGH * share * min(first - before, 0):
                break
            share, last, overlap = share / 2, middle, between
        else:
            share = 1.0
        self._restore(start.towards(end, share))
        self._set_sets(end)

    def _set_sets(self, end):
        for rows, state in zip(self._rows, end.contacts, strict=True):
            rows.state.active = state.active.copy()
            rows.state.p = state.p.copy()

    def _step_exactly(self):
        """Solve the linearised contact problem, and take its solution. Collective."""
        stiffness, right = self._stiffness(), self._right()
        moves = self._jump()
        increments = (
            moves if self._comm.allreduce(any(part.any() for part in moves), MPI.LOR) else None
        )
        equations = [rows.equations(stiffness, increments, exact=True) for rows in self._rows]
        problem = LinearisedContact(
            self._tangent, self._rows, equations, stiffness, self._zero_pressure()
        )
        ties = self._x.getNestSubVecs()[len(self._x.getNestSubVecs()) - self._num_ties :]
        expected = sum(part.getSize() for part in ties) + sum(
            int(rows.state.active.sum()) for rows in self._rows
        )
        shift, near = (0.0, 0.0), 0.0
        for _ in range(SHIFTS + 1):
            found = problem.solve(right, shift)
            negative = self._tangent.negative
            if DEBUG and (found.num or negative not in (None, expected) or not found.is_solved):
                print(
                    f"   step: {found.num} rhs, inertia {negative} of {expected}, shift {shift}, solved {found.is_solved}, active "
                )
            convex = negative is None or negative <= expected
            if found.is_solved:
                if convex:
                    break
                free = [
                    np.where(held, 0, dx)
                    for held, dx in zip(self._held, found.changes, strict=False)
                ]
                if self._tangent.work(free) > 0:
                    break
            if convex and self._num_free:
                near = 4 * near or self._nearness()
            else:
                shift = (4 * shift[0] or SHIFT, 0.0)
            shift = (shift[0], near)
        self._rays = self._rays + 1 if near else 0
        if not found.is_solved or self._rays == RAYS:
            self._tell_pull(found)
        start, last = self._state(), [(rows.state.p, rows.clearance) for rows in self._rows]
        work = self._comm.allreduce(sum(map(np.dot, found.changes, self._left)))
        parts = zip(self._rows, found.y, found.f, found.changed, strict=True)
        for rows, *solution in parts:
            rows.accept(*solution, stiffness)
        for x, dx in zip(self._x.getNestSubVecs(), found.changes, strict=True):
            x.array[:] -= dx
        self._assign(self._x)
        for rows, (p, g) in zip(self._rows, last, strict=True):
            work -= ((rows.state.p - p) * g)[rows.state.active].sum()
        return start, self._state(), work

    def _tell_pull(self, found):
        """Raise that a body that only contact holds leaves."""
        if not self._num_free:
            raise SolveError("the linearised contact problem has no solution.")
        pulls = [values[: len(rows.g)] for rows, values in zip(self._rows, found.f, strict=True)]
        c = int(np.argmin([part.min(initial=0) for part in pulls]))
        rows, k = self._rows[c], int(pulls[c].argmin())
        at = spot(rows.sides[1].displaced(rows.u[1]).x[[k]])
        raise SolveError(
            f"contact would have to pull at {at}: {self._strays.of(rows.bodies)}, that "
            "nothing else holds, is drawn away, or tilts; hold it by boundary conditions."
        )

    def _nearness(self) -> float:
        """Share of the bodies' diagonal with which free motions go a facet's size. Collective."""
        modes = [self._free.at(i, part) for i, part in enumerate(self._owned())]
        largest = self._comm.allreduce(max(float(np.abs(m).max(initial=0)) for m in modes), MPI.MAX)
        size = min(float(rows.sides[1].reference.size.max()) for rows in self._rows)
        return largest * float(np.abs(self._load(modes)).max()) / (self._stiffness() * size)

    def _alternate(self) -> int:
        """Newton's iteration with friction: sets are guessed by signs."""
        before: list[npt.NDArray] = []
        earlier: list[npt.NDArray] = []
        polished, returned, self._largest, way = False, 0, 0.0, None
        relaxation = Relaxation(self._comm)
        for step in range(STEPS + RELAXED + 1):
            for rows in self._rows:
                rows.update_geometry()
            self._evaluate(self._x, self._b)
            jump = self._jump()
            if step == 0:
                self._assemble_what_moved()
            last = [rows.state.copy() for rows in self._rows]
            held = self._choose(before)
            as_before, as_earlier = [
                bool(sets) and all(map(np.array_equal, sets, held)) for sets in (before, earlier)
            ]
            returned = returned + 1 if as_earlier and not as_before else 0
            retained = returned > 1 and self._retain(last)
            if retained:
                held = before
            earlier, settled = before, as_before or retained
            if self._balances() and step and settled and not retained:
                if polished or all(rows.is_exact for rows in self._rows):
                    self._check_pushing()
                    return step
                polished = True
            if step >= STEPS and not relaxation.acts:
                break
            lasting = bool(before) and all(map(ContactRows.as_before, self._rows, before, held))
            if way and relaxation.shortens(self._unbalanced):
                way = self._go(*way, SHORTENED)
                continue
            if not np.isfinite(self._unbalanced):
                raise SolveError("Newton's iteration diverged: the residual is no number.")
            before = held
            relaxation.update(self._unbalanced)
            if relaxation.creeps:
                break
            if step:
                try:
                    self.assemble_matrix()
                except ValueError as error:  # points of the residual needn't see cells inverted
                    raise SolveError(f"Newton's iteration diverged: {error}") from error
            if step == 0 and self._slides(jump):
                self._carry()
            else:
                # The last load step's pressures are as good as those of sets that are settled
                exact = settled or lasting or (step == 0 and self._continues())
                way, increments, work = self._step(exact, jump, relaxation.share)
                share = relaxation.takes(increments, work, exact=exact)
                if share != 1:
                    way = self._go(*way, share)
            self._iterations += 1
        raise SolveError(f"Newton's iteration did not end in {step} steps.")

    def _assemble_what_moved(self):
        """Assemble the stiffness of bodies but for those that the last steps hardly moved."""
        sizes = [side.reference.size.min() for rows in self._rows for side in rows.sides]
        self._slack = REUSED * float(min(sizes))
        self.assemble_matrix()
        self._slack = 0.0

    def _retain(self, last: Sequence[NormalState]) -> bool:
        """Retain the sticking sets, with the exact tangent, where they alternate.

        The iterate that follows is checked anew. ``last`` are the states before sets were chosen.
        """
        if not all(
            np.array_equal(rows.state.active, a.active) for rows, a in zip(self._rows, last)
        ):
            return False
        for rows, state in zip(self._rows, last, strict=True):
            if isinstance(rows, FrictionRows) and isinstance(state, FrictionState):
                rows.retain(state)
        return True

    def _check_pushing(self):
        """Raise if multipliers that are active only to hold a body would have to pull it."""
        zero = self._zero_pressure()
        for rows in self._rows:
            p = rows.state.p * rows.state.active
            if p.min(initial=0) < -max(EXCEEDS * np.abs(p).max(initial=0), zero):
                at = spot(rows.sides[1].displaced(rows.u[1]).x[[p.argmin()]])
                raise SolveError(
                    f"contact would have to pull at {at}: {self._strays.of(rows.bodies)}, that "
                    "nothing else holds, is drawn away, or tilts; hold it by boundary conditions."
                )
        for rows in self._frictional:
            if rows.holds_too_much:
                raise SolveError(
                    f"{self._strays.of(rows.bodies)}, that nothing else holds, slides: its load is "
                    "more than friction can hold; hold it by boundary conditions, or move it by "
                    "them."
                )

    def _zero_pressure(self) -> float:
        """Pressure treated as zero beside the largest one."""
        states = [rows.state for rows in self._rows]
        return UNPRESSED * max(
            float(np.abs(state.p[state.active]).max(initial=0)) for state in states
        )

    def _jump(self) -> list[npt.NDArray[np.float64]]:
        """Increments that prescribed displacements still have to make, of the owned dofs."""
        return [
            np.where(held, wanted[: len(held)] - u.x.array[: len(held)], 0)
            for u, wanted, held in zip(self._u, self._goal, self._held, strict=True)
        ]

    def _choose(self, before: Sequence[npt.NDArray[np.bool_]]) -> list[npt.NDArray[np.bool_]]:
        """Choose the active sets, enlarged where they alone hold bodies. Collective.

        Args:
            before: The last sets; empty in the first step.
        """
        stiffness, zero = self._stiffness(), self._zero_pressure()
        for c, rows in enumerate(self._rows):
            rows.choose_active(stiffness, zero, before[c] if before else None)
        if self._num_free:
            self._hold()
        return [rows.sets for rows in self._rows]

    def _hold(self):
        """Enlarge active sets until they hold; ``first`` if no pressure acts yet. Collective."""
        assert self._free is not None
        modes = [self._free.at(i, part) for i, part in enumerate(self._owned())]
        moves = [self._free_moves(rows, modes) for rows in self._rows]
        pairs = list(zip(self._rows, moves, strict=True))
        holds = np.vstack([rows.holds(part) for rows, part in pairs])
        every = np.concatenate([rows.state.active for rows in self._rows])
        distance, valid = (
            np.concatenate([getattr(rows, name) for rows in self._rows])
            for name in ("distance", "valid")
        )
        frictional = [(rows, part) for rows, part in pairs if isinstance(rows, FrictionRows)]
        sticking = [rows.holds_across(part)[rows.stuck] for rows, part in frictional]
        across = np.vstack([part.reshape(-1, self._num_free) for part in (holds[:0], *sticking)])
        active, num_free = active_set.holding(every, distance, valid, holds, across)
        ends = np.cumsum([len(rows.g) for rows in self._rows])[:-1]
        for rows, part in zip(self._rows, np.split(active, ends), strict=True):
            rows.activate(part)
        if num_free and frictional:
            num_free = hold_by_sticking(frictional, np.vstack((holds[active], across)))
        if num_free:
            sticking = [rows.holds_across(part)[rows.stuck] for rows, part in frictional]
            across = np.vstack([part.reshape(-1, self._num_free) for part in (across, *sticking)])
            found = np.vstack((holds[active], across))
            raise SolveError(self._strays.unheld(self._owned(), found, num_free, bool(frictional)))

    def _owned(self) -> list[npt.NDArray[np.float64]]:
        """This rank's owned displacements of each body."""
        return [u.x.array[: len(held)] for u, held in zip(self._u, self._held, strict=True)]

    def _lost(self, state: SystemState, error: Exception) -> str:
        """Message on where a failed step led bodies that only contact holds. Collective."""
        return self._strays.lost(state.values, self._owned(), str(error)) if self._num_free else ""

    def _load(self, modes: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
        """Forces on free rigid motions that contact is to balance, ``(num,)``. Collective."""
        parts = [m.T @ b.array_r for m, b in zip(modes, self._b.getNestSubVecs(), strict=False)]
        return self._comm.allreduce(sum(parts))

    def _free_moves(
        self, rows: ContactRows, every: Sequence[npt.NDArray[np.float64]]
    ) -> list[Displacements]:
        """Free rigid motions of each body at a contact's sides. Collective."""
        return [rows.from_bodies([modes[:, k] for modes in every]) for k in range(self._num_free)]

    def _forces_left(self) -> tuple[list[npt.NDArray], list[list[npt.NDArray]]]:
        """This rank's residual of bodies and ties with contact forces, and those by contact."""
        found = self._right()
        return found, [rows.subtract_forces(found, self._held) for rows in self._rows]

    def _right(self) -> list[npt.NDArray]:
        """This rank's residual of bodies and ties without the contacts' forces."""
        return [part.array_r.copy() for part in self._b.getNestSubVecs()]

    def _balances(self) -> bool:
        """True if the residual is zero within rtol and the active gaps are closed. Collective."""
        num = len(self._b.getNestSubVecs()) - self._num_ties  # forces at jumps too
        owned = self._owned()
        left, contact = self._forces_left()
        closed = all([rows.is_closed() for rows in self._rows])
        parts = [*left[:num], *owned]
        self._left = parts[: len(self._u)]
        squares = np.array([np.vdot(part, part).real for part in parts])
        self._comm.Allreduce(MPI.IN_PLACE, squares)
        self._unbalanced = worst = np.sqrt(squares[:num].sum())
        if not closed:
            return False  # forces needn't be known to see that
        size, least = sum([force**2 for force in self._forces]), 0.0
        self._stiffness()
        for length, square in zip(self._row_lengths, squares[num:], strict=True):
            least += length**2 * square
        for forces in contact:
            size += sum([(force**2).sum() for force in forces])
        self._largest = max(self._largest, np.sqrt(least))  # its digits are lost when forces fall
        self._is_exact = worst <= ROUND_OFF_FORCES * self._largest
        return bool(worst <= self._rtol * np.sqrt(size) or self._is_exact)

    def _continues(self) -> bool:
        """True if the active sets are those that had pressures."""
        return all(np.array_equal(rows.state.active, rows.state.p > 0) for rows in self._rows)

    def _slides(self, jump: Sequence[npt.NDArray[np.float64]]) -> bool:
        """True if active surfaces are prescribed to move farther than their facets are long."""
        largest = max(float(abs(part).max(initial=0)) for part in jump)
        far = self._comm.allreduce(largest, MPI.MAX)
        return not self._num_free and any(
            rows.state.p.any() and far > rows.sides[1].reference.size.max() for rows in self._rows
        )

    def _lead(self):
        """Let bodies that are prescribed to move far, or turn together, follow as rigid ones.

        Forces go along with bodies that stay together, and are forgotten where one leaves the
        other. Collective.
        """
        jump = self._jump()
        assert self._free is not None
        moves = self._comm.allreduce(any(part.any() for part in jump), MPI.LOR)
        pushes = any(rows.state.p.any() for rows in self._rows)
        if self._tied or self._num_free or not (moves and pushes):
            return
        motions = prescribed_motions(self._comm, self._free.places, self._owned(), jump, self._held)
        if None in motions:
            return
        far, together = self._slides(jump), True
        moved_by_user = any(None in rows.bodies for rows in self._rows)
        if not (far or moved_by_user or any(motion.turns for motion in motions)):
            return
        for rows in self._rows:
            of_sides, apart = motions_of(rows, motions)
            turn = None not in of_sides and turns_together(*of_sides)
            together &= turn
            if far and apart > 1:  # in facet sizes
                rows.forget()
            elif turn and isinstance(rows, FrictionRows):
                rows.turn(of_sides[1])
        if not (far or together):
            return
        parts = self._x.getNestSubVecs()
        for part, x, u, motion in zip(parts, self._free.places, self._owned(), motions):
            part.array[:] += motion.shift(x + u.reshape(x.shape)).ravel()
        self._assign(self._x)

    def _carry(self):
        """Move prescribed bodies under the present forces, and forget those. Collective.

        Gaps at a body's old place say nothing about its new one.
        """
        stiffness = self._stiffness()
        self._take(
            self._forces_left()[0],
            [rows.without_forces(stiffness) for rows in self._rows],
            0.0,
        )
        for rows in self._rows:
            rows.forget()

    def _step(
        self, settled: bool, jump: Sequence[npt.NDArray[np.float64]], viscous: float
    ) -> tuple[tuple[SystemState, SystemState], list[npt.NDArray[np.float64]], float]:
        """Solve for one Newton step, and take it. Collective.

        Args:
            settled: True if the sets are those of the last step: then the tangent is exact, as it
                always is without friction for bodies that only contact holds.
            jump: Increments that prescribed displacements have to make.
            viscous: Share of the bodies' stiffness that is added.

        Returns:
            The states before and after, this rank's increments of each body's displacements, and
            the work of the increments of forces on them: Hill's second-order work, negative where
            an equilibrium isn't stable.
        """
        stiffness, right, start = self._stiffness(), self._right(), self._state()
        rolls = self._num_free > 0  # then pressures may be all that keeps bodies in place
        moves = self._comm.allreduce(any([part.any() for part in jump]), MPI.LOR)
        prescribed = jump if moves else None
        last = [(rows.state.p, rows.clearance) for rows in self._rows]
        equations = [
            rows.equations(
                stiffness,
                prescribed,
                exact=settled or (rolls and not isinstance(rows, FrictionRows)),
            )
            for rows in self._rows
        ]
        changes, unknowns = self._take(right, equations, viscous)
        for rows, linear, values in zip(self._rows, equations, unknowns, strict=True):
            rows.take(linear, values)
        now = [part.array_r.copy() for part in self._x.getNestSubVecs()]
        end = SystemState(now, [rows.state.copy() for rows in self._rows])
        work = self._comm.allreduce(sum(map(np.dot, changes, self._left)))
        for rows, (p, g) in zip(self._rows, last, strict=True):
            work -= ((rows.state.p - p) * g)[rows.state.active].sum()
        return (start, end), changes, work

    def _stiffness(self) -> float:
        """Mean diagonal of the softest body; lengths of matrix rows with it. Collective."""
        if self._stiffness_of != self._known:
            self._stiffness_of = list(self._known)
            self._softest = min([mean_diagonal(K) for K in self._K])
            self._row_lengths = [row_length(K) for K in self._K]
        return self._softest

    def _take(
        self, right: Sequence[npt.NDArray], equations: Sequence[Linear], viscous: float
    ) -> tuple[list[npt.NDArray], list[npt.NDArray]]:
        """Solve, and subtract the solution; arguments as :meth:`Tangent.solve`. Collective.

        Returns:
            This rank's increments of each body's displacements, and the contacts' unknowns.
        """
        solution, unknowns = self._tangent.solve(right, equations, viscous)
        for x, dx in zip(self._x.getNestSubVecs(), solution, strict=True):
            x.array[:] -= dx
        self._assign(self._x)
        return solution[: len(self._u)], unknowns
