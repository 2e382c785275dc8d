# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""A semi-smooth Newton iteration for bodies in contact."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem
from hypergap_dolfinx.algebra.floating import FreeMotions, RigidBodyDiagnostics
from hypergap_dolfinx.contact_solver import active_set
from hypergap_dolfinx.contact_solver.contact_rows import (
    ContactRows,
    Linear,
    Pressed,
    State,
    Touching,
    owned_values,
    share_ends,
)
from hypergap_dolfinx.contact_solver.friction_rows import FrictionRows, Rubbed, hold_by_sticking
from hypergap_dolfinx.contact_solver.predictor import motions_of, prescribed_motions, turns_together
from hypergap_dolfinx.contact_solver.relaxation import Relaxation
from hypergap_dolfinx.contact_solver.tangent import Tangent, ways
from hypergap_dolfinx.contact_solver.tolerances import (
    AHEAD,
    FAR_STEP,
    PULLS,
    RELAXED,
    ROUND_OFF_FORCES,
    SHORTENED,
    SLACK,
    STEPS,
    UNPRESSED,
)
from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.core.sparse import mean_diagonal, row_length
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.multipliers.interface import TiedInterfaces
from hypergap_dolfinx.solvers.newton import NonlinearSystem
from hypergap_dolfinx.surface.moving import Displacements


class ContactSystem(NonlinearSystem):
    """F_i(u_i) − Σ_c Cᵀ_ci p_c + Σ_t Bᵀ_ti λ_t, and the gaps of what is in contact."""

    def __init__(
        self,
        F: Sequence[ufl.Form],
        u: Sequence[fem.Function],
        bcs: Sequence[fem.DirichletBC],
        pieces: TiedInterfaces,
        touching: Sequence[Touching],
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
            pieces: The ties, and what they are pieces of.
            touching: The contacts.
            names: Of the bodies, for messages.
            rtol: Residual, over the forces in the bodies, that is none.
            petsc_options_prefix: Prefix of the KSP's options.
            petsc_options: Options of the KSP.
            compiling: J and options, as for :class:`NonlinearSystem`.
        """
        super().__init__(F, u, bcs, pieces, **compiling)
        self._rtol, self._names = rtol, names
        held = self._constraints.prescribed
        self._rows = [
            (ContactRows if one.contact.friction is None else FrictionRows)(one, held)
            for one in touching
        ]
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
                symmetric=all(one.contact.friction is None for one in touching),
            ),
        )
        self._free: FreeMotions | None = None
        self._tied = bool(pieces.interfaces)
        self._iterations = 0
        self._softest, self._stiffness_of = 0.0, list[int | None]()

    def _release(self) -> list:
        return [self.__dict__.pop("_tangent", None), *super()._release()]

    def _prepare(self):
        """Once: what nothing but contact holds. Collective."""
        for u, x in zip(self._u, self._x.getNestSubVecs()):
            x.array[:] = u.x.array[: x.getLocalSize()]
        for rows in self._rows:
            rows.begin()
        if self._free is None:
            self.assemble_matrix()
            self._scales_fixed = True
            self._free = FreeMotions(self._system.spaces, self._K, self._constraints)
            self._strays = RigidBodyDiagnostics(self._system.spaces, self._free, self._names)

    def _state(self) -> State:
        parts = self._x.getNestSubVecs()
        return State([part.array_r.copy() for part in parts], [r.now.copy() for r in self._rows])

    def _restore(self, state: State):
        for part, value in zip(self._x.getNestSubVecs(), state.values, strict=True):
            part.array[:] = value
        self._assign(self._x)
        for rows, now in zip(self._rows, state.pressed, strict=True):
            rows.now = now.copy()

    def _go(self, start: State, end: State, share: float) -> tuple[State, State]:
        """Take a share of the way between two states: the one, and where that leads."""
        end = start.towards(end, share)
        self._restore(end)
        return start, end

    def _newton(self) -> int:
        """Newton's iteration for the values that are set. Collective.

        Returns:
            The number of its steps.

        Raises:
            SolveError: It failed.
        """
        self._assign(self._x)
        self._tangent.set_out()
        for rows in self._rows:
            rows.set_out()
        self._constraints.read_jumps()
        self._goal = self._lifted()
        self._lead()
        before: list[npt.NDArray] = []
        earlier: list[npt.NDArray] = []
        polished, returned, self._largest, way = False, 0, 0.0, None
        relaxation = Relaxation(self._u[0].function_space.mesh.comm)
        for step in range(STEPS + RELAXED + 1):
            for rows in self._rows:
                rows.look()
            self._evaluate(self._x, self._b)
            jump = self._jump()
            if step == 0:
                self._assemble_what_moved()
            last = [rows.now.copy() for rows in self._rows]
            held = self._choose(before, ahead=step < AHEAD)
            as_before, as_earlier = (
                bool(sets) and all(map(np.array_equal, sets, held)) for sets in (before, earlier)
            )
            returned = returned + 1 if as_earlier and not as_before else 0
            kept = returned > 1 and self._keep(last)
            if kept:
                held = before
            earlier, settled = before, as_before or kept
            if self._balances() and step and settled and not kept:
                if polished or all(rows.is_exact for rows in self._rows):
                    self._check_pushing()
                    return step
                polished = True
            if step >= STEPS and not relaxation.acts:
                break
            if way and relaxation.shortens(self._unbalanced):
                way = self._go(*way, SHORTENED)
                continue
            if not np.isfinite(self._unbalanced):
                raise SolveError("Newton's iteration diverged: the residual is no number.")
            lasting = bool(before) and all(map(ContactRows.as_before, self._rows, before, held))
            before = held
            relaxation.look(self._unbalanced)
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
                start = self._state()
                moves, work = self._step(exact, jump, relaxation.share)
                way = start, self._state()
                share = relaxation.takes(moves, work, exact=exact)
                if share != 1:
                    way = self._go(*way, share)
            self._iterations += 1
        raise SolveError(f"Newton's iteration did not end in {step} steps.")

    def _assemble_what_moved(self):
        """Assemble the stiffness of bodies but for those that the last steps hardly moved."""
        sizes = [side.reference.size.min() for rows in self._rows for side in rows.sides]
        self._slack = SLACK * float(min(sizes))
        self.assemble_matrix()
        self._slack = 0.0

    def _keep(self, last: Sequence[Pressed]) -> bool:
        """Where sticking and slipping go to and fro, go on as before, with the exact tangent.

        What that leads to is looked at anew: it is no solution yet.

        Args:
            last: The state before what sticks was chosen.
        """
        if not all(np.array_equal(rows.now.on, a.on) for rows, a in zip(self._rows, last)):
            return False
        for rows, now in zip(self._rows, last, strict=True):
            if isinstance(rows, FrictionRows) and isinstance(now, Rubbed):
                rows.keep(now)
        return True

    def _check_pushing(self):
        """Raise if what is active only to hold a body would have to pull it."""
        none = self._no_pressure()
        for rows in self._rows:
            p = rows.now.p * rows.now.on
            if p.min(initial=0) < -max(PULLS * np.abs(p).max(initial=0), none):
                at = spot(rows.sides[1].displaced(rows.u[1]).x[[p.argmin()]])
                raise SolveError(
                    f"contact would have to pull at {at}: {self._strays.of(rows.bodies)}, that "
                    "nothing else holds, is drawn away, or tilts; hold it by boundary conditions."
                )
            if isinstance(rows, FrictionRows) and rows.holds_too_much:
                raise SolveError(
                    f"{self._strays.of(rows.bodies)}, that nothing else holds, slides: its load is "
                    "more than friction can hold; hold it by boundary conditions, or move it by "
                    "them."
                )

    def _no_pressure(self) -> float:
        """Pressure that is none beside the largest one."""
        return UNPRESSED * max(
            float(np.abs(rows.now.p[rows.now.on]).max(initial=0)) for rows in self._rows
        )

    def _jump(self) -> list[npt.NDArray[np.float64]]:
        """What prescribed displacements still have to move, of each body's owned dofs."""
        prescribed = self._constraints.prescribed
        return [
            np.where(held, wanted[: len(held)] - owned_values(u), 0)
            for u, wanted, held in zip(self._u, self._goal, prescribed, strict=True)
        ]

    def _choose(
        self, before: Sequence[npt.NDArray[np.bool_]], *, ahead: bool
    ) -> list[npt.NDArray[np.bool_]]:
        """The active sets, of which the rows hold what nothing else does. Collective.

        Args:
            before: The last ones, if there are any.
            ahead: Whether zones that are too large may lose more than what pulls: mostly this
                saves steps, but sets can cycle by it.
        """
        assert self._free is not None
        stiffness, none = self._stiffness(), self._no_pressure()
        for rows in self._rows:
            now, c = rows.now, stiffness / rows.typical_area
            g = rows.clearance
            if before:  # what a step leaves of a closed gap is its curvature's: p alone tells
                g = np.where(now.on, np.minimum(g, 0), g)
            on = active_set.pushing(now.p, g, rows.m, rows.valid, rows.in_series(c), now.on, none)
            now.on = np.where(rows.split, now.on, on)
            if not before:
                rows.apart = None
                if not rows.now.p.any():
                    rows.now.on |= rows.distance <= rows.closed
                    rows.apart = rows.distance
        for rows, last in zip(self._rows, before if ahead else (), strict=False):
            facets = rows.sides[1].reference.facets
            last = last[: len(rows.g)].astype(bool)
            force = rows.now.p * rows.m
            plane = facets.shape[1] == 2
            if rows.apart is not None:
                given = rows.apart, force, rows.closed
                near = active_set.as_near(last, rows.now.on, *given, plane=plane)
                if not np.array_equal(near, rows.now.on):
                    rows.now.on = near
                    continue
            pulled = active_set.without_pull if plane else active_set.without_pull_on_surface
            rows.now.on = pulled(last, rows.now.on, facets, force)
        for rows in self._rows:
            if isinstance(rows, FrictionRows):
                rows.choose(stiffness, none, anew=not before)
        if self._free.num:
            self._hold(first=not before and not any(rows.now.p.any() for rows in self._rows))
        return [rows.sets for rows in self._rows]

    def _hold(self, *, first: bool):
        """Enlarge active sets until they hold, ``first`` before anything pushes. Collective."""
        assert self._free is not None
        modes = [self._free.at(i, part) for i, part in enumerate(self._owned())]
        moves = [self._free_moves(rows, modes) for rows in self._rows]
        pairs = list(zip(self._rows, moves, strict=True))
        holds = np.vstack([rows.holds(part) for rows, part in pairs])
        every = np.concatenate([rows.now.on for rows in self._rows])
        distance, area, valid = (
            np.concatenate([getattr(rows, name) for rows in self._rows])
            for name in ("distance", "m", "valid")
        )
        rubbing = [(rows, part) for rows, part in pairs if isinstance(rows, FrictionRows)]
        sticking = [rows.holds_across(part)[rows.stuck] for rows, part in rubbing]
        across = np.vstack([part.reshape(-1, self._free.num) for part in (holds[:0], *sticking)])
        on, num_free = active_set.seeded(
            every, distance, area, valid, holds, self._load(modes), across, first=first
        )
        ends = np.cumsum([len(rows.g) for rows in self._rows])[:-1]
        for rows, part in zip(self._rows, np.split(on, ends), strict=True):
            rows.now.on = part
        if num_free and rubbing:
            num_free = hold_by_sticking(rubbing, np.vstack((holds[on], across)))
        if num_free:
            sticking = [rows.holds_across(part)[rows.stuck] for rows, part in rubbing]
            across = np.vstack([part.reshape(-1, self._free.num) for part in (across, *sticking)])
            found = np.vstack((holds[on], across))
            raise SolveError(self._strays.unheld(self._owned(), found, num_free, bool(rubbing)))

    def _owned(self) -> list[npt.NDArray[np.float64]]:
        """This rank's owned displacements of each body."""
        return [owned_values(u) for u in self._u]

    def _lost(self, state: State, error: Exception) -> str:
        """Where a load step that failed led bodies that only contact holds. Collective.

        Args:
            state: Where it started.
            error: Why it failed.
        """
        assert self._free is not None
        return self._strays.lost(state.values, self._owned(), str(error)) if self._free.num else ""

    def _load(self, modes: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
        """Forces on free rigid motions that contact is to balance, ``(num,)``. Collective.

        Args:
            modes: The motions where the bodies are, of each.
        """
        parts = [m.T @ b.array_r for m, b in zip(modes, self._b.getNestSubVecs(), strict=False)]
        return self._u[0].function_space.mesh.comm.allreduce(sum(parts))

    def _free_moves(
        self, rows: ContactRows, every: Sequence[npt.NDArray[np.float64]]
    ) -> list[Displacements]:
        """Free rigid motions at a contact's sides, where the bodies are. Collective.

        Args:
            rows: The contact.
            every: The motions of each body.
        """
        assert self._free is not None
        modes = [None if body is None else every[body] for body in rows.bodies]
        return [
            rows.displacements(
                [
                    np.zeros_like(owned_values(f)) if m is None else m[:, k]
                    for m, f in zip(modes, rows.fields, strict=True)
                ]
            )
            for k in range(self._free.num)
        ]

    def _forces_left(self) -> list[npt.NDArray]:
        """The residual of bodies and ties with the contacts' forces, this rank's part of each."""
        found = self._right()
        for rows in self._rows:
            for i, (body, force) in enumerate(zip(rows.bodies, rows.acting(), strict=True)):
                if body is not None:
                    dofs, values = rows.owned(i, force)
                    found[body][dofs] -= values * ~self._constraints.prescribed[body][dofs]
        return found

    def _right(self) -> list[npt.NDArray]:
        """The residual of bodies and ties without the contacts' forces, this rank's of each."""
        return [part.array_r.copy() for part in self._b.getNestSubVecs()]

    def _balances(self) -> bool:
        """Whether the residual is none and what is in contact is closed. Collective."""
        num = len(self._b.getNestSubVecs()) - len(self._constraints.bodies)  # forces at jumps too
        parts = [*self._forces_left()[:num], *self._owned()]
        self._left = parts[: len(self._u)]
        squares = np.array([np.vdot(part, part).real for part in parts])
        self._u[0].function_space.mesh.comm.Allreduce(MPI.IN_PLACE, squares)
        self._unbalanced = worst = np.sqrt(squares[:num].sum())
        if not all(rows.is_closed(rows.closed) for rows in self._rows):
            return False  # forces needn't be known to see that
        size, least = sum(force**2 for force in self._forces), 0.0
        for K, square in zip(self._K, squares[num:], strict=True):
            least += row_length(K) ** 2 * square
        for rows in self._rows:
            size += sum((force**2).sum() for force in rows.acting())
        self._largest = max(self._largest, np.sqrt(least))  # what bodies come back from left digits
        return bool(worst <= max(self._rtol * np.sqrt(size), ROUND_OFF_FORCES * self._largest))

    def _continues(self) -> bool:
        """Whether what is in contact is what was, and pushes."""
        return all(np.array_equal(rows.now.on, rows.now.p > 0) for rows in self._rows)

    def _slides(self, jump: Sequence[npt.NDArray[np.float64]]) -> bool:
        """Whether what is in contact is prescribed to move farther than its facets are long."""
        comm = self._u[0].function_space.mesh.comm
        far = comm.allreduce(max(float(abs(part).max(initial=0)) for part in jump), MPI.MAX)
        assert self._free is not None
        return not self._free.num and any(
            rows.now.p.any() and far > FAR_STEP * rows.sides[1].reference.size.max()
            for rows in self._rows
        )

    def _lead(self):
        """Let bodies that are prescribed to move far, or turn together, follow as rigid ones.

        Forces go along with what keeps together, and are none where one leaves the other.
        Collective.
        """
        jump, comm = self._jump(), self._u[0].function_space.mesh.comm
        assert self._free is not None
        goes = comm.allreduce(any(part.any() for part in jump), MPI.LOR)
        pushes = any(rows.now.p.any() for rows in self._rows)
        if self._tied or self._free.num or not (goes and pushes):
            return
        prescribed = self._constraints.prescribed
        motions = prescribed_motions(comm, self._free.places, self._owned(), jump, prescribed)
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
            if far and apart > FAR_STEP:
                rows.forget()
            elif turn and isinstance(rows, FrictionRows):
                rows.turn(of_sides[1])
        if not (far or together):
            return
        parts = self._x.getNestSubVecs()
        for part, x, u, motion in zip(parts, self._free.places, self._u, motions, strict=False):
            part.array[:] += motion.shift(x + owned_values(u).reshape(x.shape)).ravel()
        self._assign(self._x)

    def _carry(self):
        """Move prescribed bodies under the forces that they have, and forget those. Collective.

        Gaps where a body was say nothing about where it goes.
        """
        self._take(
            self._forces_left(),
            [rows.without_forces(self._stiffness()) for rows in self._rows],
            0.0,
        )
        for rows in self._rows:
            rows.forget()

    def _step(
        self, settled: bool, jump: Sequence[npt.NDArray[np.float64]], viscous: float
    ) -> tuple[list[npt.NDArray[np.float64]], float]:
        """Solve for one step, and take it. Collective.

        Args:
            settled: Whether the sets are those of the last step: then the tangent is exact, as it
                always is without friction for bodies that only contact holds.
            jump: What prescribed displacements have to move.
            viscous: Share of the bodies' stiffness that is added.

        Returns:
            This rank's changes of displacements, of each body, and the work that changes of forces
            do on them: Hill's second-order work, below 0 where an equilibrium isn't stable.
        """
        assert self._free is not None
        stiffness, equations, moves = self._stiffness(), [], None
        rolls = self._free.num > 0  # then pressures may be all that keeps bodies where they are
        comm = self._u[0].function_space.mesh.comm
        goes = comm.allreduce(any(part.any() for part in jump), MPI.LOR)
        for rows in self._rows:
            if rows.now.on.any():
                if goes:
                    moves = rows.displacements(
                        [
                            np.zeros_like(owned_values(f)) if body is None else jump[body]
                            for body, f in zip(rows.bodies, rows.fields, strict=True)
                        ]
                    )
                equations.append(rows.linearised(stiffness, moves))
            else:
                equations.append(rows.without_forces(stiffness))
            if settled or (rolls and not isinstance(rows, FrictionRows)):
                equations[-1] = equations[-1].stiffened(rows.curvature())
        last = [(rows.now.p, rows.clearance) for rows in self._rows]
        changes, unknowns = self._take(self._right(), equations, viscous)
        for rows, linear, values in zip(self._rows, equations, unknowns, strict=True):
            if rows.now.on.any():
                rows.take(linear, values)
            else:
                rows.forget()
        work = comm.allreduce(sum(map(np.dot, changes, self._left)))
        for rows, (p, g) in zip(self._rows, last, strict=True):
            work -= ((rows.now.p - p) * g)[rows.now.on].sum()
        return changes, work

    def _stiffness(self) -> float:
        """Mean diagonal of the softest body. Collective."""
        if self._stiffness_of != self._known:
            self._stiffness_of = list(self._known)
            self._softest = min(mean_diagonal(K) for K in self._K)
        return self._softest

    def _take(
        self, right: Sequence[npt.NDArray], equations: Sequence[Linear], viscous: float
    ) -> tuple[list[npt.NDArray], list[npt.NDArray]]:
        """Solve, and subtract the solution. Collective.

        Args:
            right: This rank's right-hand side of bodies and ties.
            equations: Those of contacts.
            viscous: Share of the bodies' stiffness that is added.

        Returns:
            This rank's changes of displacements, of each body, and the contacts' unknowns.
        """
        solution, unknowns = self._tangent.solve(right, equations, viscous)
        for x, dx in zip(self._x.getNestSubVecs(), solution, strict=True):
            x.array[:] -= dx
        self._assign(self._x)
        return solution[: len(self._u)], unknowns
