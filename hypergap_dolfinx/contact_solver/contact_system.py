# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Newton's iteration for bodies in contact: predictor, steps, continuation."""

import logging
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem
from hypergap_dolfinx.algebra.displacement import DisplacementField
from hypergap_dolfinx.algebra.floating import FreeMotions, RigidBodyDiagnostics
from hypergap_dolfinx.algebra.tolerances import NOTHING
from hypergap_dolfinx.contact_solver import complementarity, multigrid_tangent
from hypergap_dolfinx.contact_solver.contact_rows import (
    ContactPair,
    ContactRows,
    NormalState,
    SystemState,
    share_ends,
)
from hypergap_dolfinx.contact_solver.continuation import Continuation, Kink
from hypergap_dolfinx.contact_solver.force_balance import ForceBalance
from hypergap_dolfinx.contact_solver.friction_rows import FrictionRows
from hypergap_dolfinx.contact_solver.linearised import LinearisedContact, Solution, largest_change
from hypergap_dolfinx.contact_solver.multigrid_tangent import (
    IterationFailed,
    MultigridTangent,
    NotPositive,
)
from hypergap_dolfinx.contact_solver.predictor import motions_of, prescribed_motions, turns_together
from hypergap_dolfinx.contact_solver.tangent import Tangent, ways
from hypergap_dolfinx.contact_solver.tolerances import (
    AT_REST,
    LARGE_CONTACT,
    PATIENCE,
    REUSED,
    ROUND_OFF_FORCES,
    SHORTENED,
    STEPS,
    TIGHT,
    TRIALS,
)
from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.errors import InterfaceError, SolveError
from hypergap_dolfinx.interface_laws.coupling import CoupledMotion
from hypergap_dolfinx.interface_laws.rigid_body import RigidBodyMotion
from hypergap_dolfinx.mortar import free_edges
from hypergap_dolfinx.multipliers.interface import TiedInterfaces
from hypergap_dolfinx.solvers.multigrid import Multigrid
from hypergap_dolfinx.solvers.newton import NonlinearSystem
from hypergap_dolfinx.solvers.predicted_stress import PredictedStress, is_slender
from hypergap_dolfinx.solvers.solver import names_types
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.moving import Displacements
from hypergap_dolfinx.surface.trace import is_mixed

LOG = logging.getLogger("hypergap_dolfinx")
T = TypeVar("T")


class ContactSystem(NonlinearSystem):
    """Residual F_i(u_i) − Σ_c Cᵀ_ci p_c + Σ_t Bᵀ_ti λ_t of the bodies, and gaps of the contacts.

    A load step (:meth:`_newton`) has three independent parts:

    1. *Predictor*, before the first step (:mod:`~hypergap_dolfinx.contact_solver.predictor`).
       Bodies whose prescribed displacements move them far, or turn them together, are first moved
       as rigid ones (:meth:`_lead`). Without contact, and where a load step fails, displacements
       go on as in the last load step, as far as the load does (:meth:`_go_on`).
    2. *Step* (:meth:`_step`, :mod:`~hypergap_dolfinx.contact_solver.linearised`). The linearised
       contact problem, with its inequalities and the tangent at the last pressures, is solved
       exactly. Displacements change by its solution; pressures and active sets are its own. The
       last sets, with what touches or overlaps, are only the first guess; without a solution it is
       solved again from the last sets alone. They are enlarged where nothing else holds a body.
    3. *Continuation* (:mod:`~hypergap_dolfinx.contact_solver.continuation`; halving is in
       ``ContactProblem.solve``)::

           residual isn't finite ───────────────→ the step is shortened, up to TRIALS times
           step turns back, with negative work ─→ it is taken backwards, up to PATIENCE times
           stiffness was added, and forces along
           the step act still at its end ───────→ it is lengthened to where they vanish
           a step turns back, and forces along it
           are reversed by a jump ──────────────→ it is shortened to that kink, which is held
           PATIENCE steps, and forces along the
           next are reversed by its end ────────→ it is shortened to where they vanish
           STEPS steps, the last one of no use ─→ the load step fails
           it fails ────────────────────────────→ once more as the last one goes on; then halved
           no solution, PATIENCE times in a row → it fails: a body leaves; at once where no contact
           forces balance its load, in no step (:func:`~.complementarity.is_too_much`)

    The iteration ends after a step (or at the start, if the residual is round-off) when both hold:

    - Forces balance: the residual of bodies, ties and contact forces is at most rtol times the
      forces in the bodies, or round-off (``ForceBalance``). That of a body adds up to zero.
    - Contact's laws hold: no gap is open where a pressure acts, none is negative, sticking vertices
      don't slip, and tractions are μ p at the others (``ContactRows.is_closed``).

    At a kink of a gap any derivative between those on both sides may act (Clarke's). Newton steps
    end at a kink that is held (:class:`~.continuation.Kink`). Across others they
    become as short as displacements that are treated as zero. Then forces may balance that lie
    between those of the last two states (:meth:`_balances_between`).

    With friction there is one more step if gaps aren't closed to round-off.
    """

    def __init__(
        self,
        F: Sequence[ufl.Form],
        u: Sequence[fem.Function],
        bcs: Sequence[fem.DirichletBC],
        pieces: TiedInterfaces,
        pairs: Sequence[ContactPair],
        *,
        parts: Sequence[Component],
        names: Sequence[str],
        rigid: Sequence[RigidBodyMotion] = (),
        couplings: Sequence[CoupledMotion] = (),
        rtol: float,
        solver: str | None = None,
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
            parts: Displacements of each body among its fields.
            rigid: The rigid bodies among them, the last ones.
            couplings: Couplings of surfaces with points; their unknowns are behind the bodies in
                parts and names.
            names: Names of the bodies, for messages.
            rtol: Residual, over the forces in the bodies, treated as zero.
            solver: ``"direct"``, ``"iterative"``, or None: chosen by the size.
            petsc_options_prefix: Prefix of the KSP's options.
            petsc_options: Options of the KSP.
            compiling: J and options, as for :class:`NonlinearSystem`.
        """
        self._pairs, self._stresses = list(pairs), list[PredictedStress]()
        self._fields = [
            DisplacementField(part, f.function_space)
            for part, f in zip(parts, [*u, *(one.q for one in couplings)], strict=True)
        ]
        self._rigid, self._num_elastic = list(rigid), len(u) - len(rigid)
        self._points = [*rigid, *couplings]
        super().__init__(F, u, bcs, pieces, couplings=couplings, **compiling)
        pieces = self._pieces  # ties may have exchanged their sides
        self._rtol, self._names, self._moving = rtol, names, list(parts)
        others = [field.others for field in self._fields]
        self._fixed = [held | part for held, part in zip(self._held, others, strict=True)]
        self._comm = self._u[0].function_space.mesh.comm
        self._rows = [
            (ContactRows if pair.contact.friction is None else FrictionRows)(pair, self._held)
            for pair in pairs
        ]
        for rows in self._rows:
            rows.start_solve()
        self._frictional = [rows for rows in self._rows if isinstance(rows, FrictionRows)]
        share_ends(self._rows, pieces.interfaces)
        self._prefix, self._given = petsc_options_prefix, petsc_options
        self._tangent: Tangent | MultigridTangent = self._chosen(solver)
        self._free: FreeMotions | None = None
        self._tied = bool(pieces.interfaces or couplings)
        self._iterations = self._num_free = 0
        self._before: tuple[list, list, list] | None = None  # values, residual and forces
        self._kink = Kink(self._rows, self._move_to)
        self._stiffness_of, self._told_loose = list[int | None](), list[int]()
        self._finest = min(float(s.reference.size.min()) for rows in self._rows for s in rows.sides)
        depends = self._depends[: self._num_elastic]
        self._balance = ForceBalance(
            self._fields, self._K, self._held, depends, self._couplings, self._finest, rtol
        )
        self._poking = [np.empty((0, self._dim)) for _ in pairs]  # corners, when last looked at
        self._recorded = [rows.state.active for rows in self._rows]  # what was in contact

    def _derivative(self, F: ufl.Form, u: fem.Function) -> ufl.Form:
        for body in self._rigid:
            if body.q is u:
                return body.J
        found = super()._derivative(F, u)
        if is_mixed(u.function_space):
            return found
        if is_slender(u) and u in ufl.algorithms.expand_derivatives(found).coefficients():
            self._stresses.append(PredictedStress(u))
            found += self._stresses[-1].stiffness(F)
        return found

    def _chosen(self, solver: str | None) -> Tangent | MultigridTangent:
        """The way to solve for Newton's steps. Collective.

        Raises:
            ValueError: An unknown name, or a solver that isn't possible.
        """
        reason = multigrid_tangent.why_not(self._system, self._rows)
        symmetric = not self._frictional and not any(b.can_turn_freely for b in self._points)
        if solver is None:
            large = self._dim == 3 and sum(K.getSize()[0] for K in self._K) >= LARGE_CONTACT
            can = symmetric and not reason and not self._names_types
            solver = "iterative" if large and can else "direct"
        if solver not in ("direct", "iterative"):
            raise ValueError(f"solver is one of direct, iterative, not {solver!r}.")
        options = self._prefix, self._given
        if solver == "iterative":
            if reason:
                raise ValueError(f'solver="iterative" is not possible: {reason}; take "direct".')
            reduction = max(TIGHT * self._rtol, ROUND_OFF_FORCES)
            given = self._system, self._rows, *options, reduction
            return MultigridTangent(*given, symmetric=symmetric, is_linear=self._is_linear)
        found = ways(*options, plane=self._dim == 2, symmetric=symmetric)
        fields = self._fields[: self._num_elastic]
        sizes = len(self._points), self._num_ties
        return Tangent(self._A, fields, self._rows, self._prefix, found, *sizes)

    @property
    def _is_linear(self) -> bool:
        """True with small sliding and linear forms."""
        follows = any(pair.contact.geometry.follows for pair in self._pairs)
        return not follows and not any(of.on_u for of in self._depends)

    @property
    def solver_name(self) -> str:
        """Name of the solver in use, also of one that the default chose or fell back to."""
        return self._tangent.name

    def _assign(self, x: PETSc.Vec):
        """Copy a vector into u, and move the nodes of rigid bodies. Collective."""
        super()._assign(x)
        for body in self._rigid:
            body.assign()

    def _lifted(self) -> list[npt.NDArray]:
        """Displacements with those that are prescribed, rigid bodies' as users have set them."""
        for body in self._rigid:
            body.read()
        return super()._lifted()

    @cached_property
    def _dim(self) -> int:
        return self._u[0].function_space.mesh.topology.dim

    @property
    def _names_types(self) -> bool:
        """True if PETSc options name a type of solver."""
        return names_types(self._given)

    def _falling_back(self, solve: Callable[[], T]) -> T:
        """Solve; where multigrid fails, with factors from now on. Collective."""
        try:
            return solve()
        except IterationFailed as error:
            self._fall_back(self._why_failed(error))
            return solve()

    def _why_failed(self, error: IterationFailed) -> str:
        """What is known about a failure of multigrid. Collective."""
        assert isinstance(self._tangent, MultigridTangent)
        message = str(error).removesuffix(".")
        if isinstance(error, NotPositive):
            return f"{message}: the matrix of a Newton step isn't positive definite"
        if slides := self._held_by_slip():
            return f"{message}: nothing but friction that slips holds {slides}"
        if self._tangent.has_converged:  # so the bodies' stiffness isn't to blame
            return message
        return (
            f"{message}; it is for stiffness that is symmetric and positive definite, "
            f"{Multigrid.SUITED} (near 0.5 take mixed spaces of displacement and pressure)"
        )

    def _held_by_slip(self) -> str:
        """Bodies that the working set holds by friction that slips alone, or nothing. Collective.

        It resists them only by the turning of its directions.
        """
        if not self._num_free or not any([rows.slips.any() for rows in self._frictional]):
            return ""
        held = self._holds(self._rows, lambda rows: rows.state.active, lambda rows: rows.stuck)
        left = self._strays.num_left(held)
        return self._strays.moving(self._owned(), held, self._began) if left else ""

    def _holds(
        self,
        every: Sequence[ContactRows],
        closed: Callable[[ContactRows], npt.NDArray[np.bool_]],
        sticks: Callable[[FrictionRows], npt.NDArray[np.bool_]],
    ) -> npt.NDArray[np.float64]:
        """Springs and rows of contacts by the free motions, ``(num_rows, num_free)``. Collective.

        Args:
            every: The contacts.
            closed: Mask of multipliers that count.
            sticks: Mask of those that count along the surface.
        """
        assert self._free is not None
        modes = [self._free.at(i, part) for i, part in enumerate(self._owned())]
        found = [self._springs(modes)]
        for rows in every:
            moves = rows.moved(modes)
            found.append(rows.holds(moves)[closed(rows)])
            if isinstance(rows, FrictionRows):
                found.append(rows.holds_across(moves)[sticks(rows)].reshape(-1, self._num_free))
        return np.vstack(found)

    def _fall_back(self, reason: str) -> bool:
        """Take factors in place of multigrid; False if they are taken. Collective."""
        if not isinstance(self._tangent, MultigridTangent):
            return False
        if self._comm.rank == 0:
            LOG.warning(
                'contact: solver="iterative" is given up for "direct": %s; name solver="direct" '
                "to save its iterations.",
                reason,
            )
        iterations = self._tangent.iterations
        self._tangent.destroy()
        self._given = None  # options of another solver
        self._tangent = self._chosen("direct")
        self._tangent.iterations = iterations
        self._tangent.remember_stiffness(self._stiffness())
        return True

    def _sides(self) -> list:
        contacts = [pair.contact for pair in self._pairs]
        return [
            *super()._sides(),
            *(side for c in contacts for side in zip(c.spaces, c.facets, strict=True)),
        ]

    def _forget(self):
        super()._forget()
        self._balance.last_unbalanced = np.inf
        self._tangent.destroy()

    def _release(self) -> list:
        return [self.__dict__.pop("_tangent", None), *super()._release()]

    def _prepare_once(self):
        """Find what the first solve finds; the stiffness at the start is a measure later on."""
        if self._free is None:
            self._prepare()

    def _prepare(self):
        """Start a solve; at first find the rigid motions that only contact holds. Collective."""
        for u, x in zip(self._u, self._x.getNestSubVecs()):
            x.array[:] = u.x.array[: x.getLocalSize()]
        for rows in self._rows:
            rows.start_solve()
        for body in self._points:
            body.assign()
        if self._free is None:
            for body in self._points:
                body.read(springs=False)
            self._hooks("before_step")
            self.assemble_matrix()
            self._scales_fixed = True
            self._tangent.remember_stiffness(self._stiffness())
            self._free = FreeMotions(self._fields, self._K, self._constraints)
            self._num_free = self._free.num
            self._strays = RigidBodyDiagnostics(self._moving, self._free, self._names)
        if self._constraints.conducts:
            self._warn_of_loose()

    def _warn_of_loose(self):
        """Say which bodies are held by ties only that conduct nothing now. Collective."""
        loose = self._constraints.loose()
        if loose and loose != self._told_loose:
            free = FreeMotions(self._fields, self._K, self._constraints, loose)
            if free.num > self._num_free:
                strays = RigidBodyDiagnostics(self._moving, free, self._names)
                moving = strays.moving(self._owned(), np.zeros((0, free.num)))
                if self._comm.rank == 0:
                    LOG.warning(
                        f"nothing but contact and ties whose conductance is 0 holds {moving}: its "
                        "place is arbitrary where contact doesn't hold it."
                    )
        self._told_loose = loose

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

    def _go(self, start: SystemState, end: SystemState, share: float):
        """Restore a state between two states, or before the first one at a negative share.

        Its multipliers and sets are those of :meth:`SystemState.towards`.
        """
        self._restore(start.towards(end, share))

    def _newton(self, ahead: Sequence[npt.NDArray] | None = None) -> int:
        """Newton's iteration for the present values of the load. Collective.

        Args:
            ahead: Changes of this rank's unknowns with which the last load step goes on; None if
                the load doesn't.

        Returns:
            The number of its steps.

        Raises:
            SolveError: It failed.
        """
        self._assign(self._x)
        self._began = [part.copy() for part in self._owned()]
        self._tangent.start_step()
        for rows in self._rows:
            rows.start_step()
        self._constraints.read_jumps()
        self._goal = self._lifted()
        way = None
        if ahead is None:
            self._lead()
        else:
            way = self._go_on(ahead)
        for stress in self._stresses:
            stress.start()
        self._reach = np.inf
        least = min(rows.closed for rows in self._rows)
        continuation = Continuation(self._comm, least)
        self._balance.start_step()
        self._num_rays, polished, self._before = 0, False, None
        self._holding: npt.NDArray[np.bool_] | None = None
        self._kink.leave()
        share, step = 1.0, 0
        while True:
            for rows in self._rows:
                rows.update_geometry()
            if self._kink.is_held:
                self._kink.stay([part.array_r.copy() for part in self._x.getNestSubVecs()])
            self._hooks("before_step")
            self._evaluate(self._x, self._b)
            if not self._is_finite():
                share *= continuation.shorten()
                if way is None or abs(share) < SHORTENED**TRIALS:
                    raise SolveError(self._inverted())
                self._go(*way, share)
                continue
            if way is not None:
                reaches = partial(self._reaches_kink, way, share)
                factor = continuation.factor(self._left_of_bodies, reaches)
                if factor != 1:
                    share, self._reach = factor * share, factor * self._reach
                    self._go(*way, share)
                    continue
            jump, to_go = self._jump()
            if step == 0:
                self._assemble_what_moved()
            stiffness, zero = self._stiffness(), self._zero_pressure()
            for rows in self._rows:
                rows.start_set(stiffness, zero)
            is_balanced = self._balances() or (not self._kink.is_held and self._balances_between())
            self._record(step)
            self._interrupts.check()
            if is_balanced and (step or (self._is_exact and not self._hold_too_much())):
                if polished or all(rows.is_exact for rows in self._rows):
                    self._check_held()
                    return step
                polished = True
            if step >= STEPS and not self._balance.converges:
                raise SolveError(self._stalled(step))
            self._balance.last_unbalanced = self._balance.unbalanced
            if self._num_free:
                self._hold()
            if step:
                for stress in self._stresses:
                    stress.update()
                try:
                    self.assemble_matrix()
                except ValueError as error:  # points of the residual needn't see cells inverted
                    raise SolveError(self._inverted()) from error
            step, self._iterations = step + 1, self._iterations + 1
            way, work, is_stiffened = self._step(jump, stiffness)
            moves = [b - a for a, b in zip(way[0].values[: len(self._u)], way[1].values)]
            moves = self._of_displacements(moves)
            forces = self._left_of_bodies if to_go <= least and not self._kink.is_held else None
            share = continuation.share(moves, work, forces, is_stiffened)
            if share != 1:
                self._go(*way, share)

    def _reaches_kink(
        self,
        way: tuple[SystemState, SystemState],
        share: float,
        start: float,
        end: float,
    ) -> bool:
        """Go to a kink across which forces along a step are reversed; false if there is none.

        Args:
            way: The states before and after the step.
            share: Share of the step at whose end they are reversed.
            start: Forces along the step at its start.
            end: The same at that end.
        """
        if share <= 0:
            return False
        before, after = (state.values for state in way)
        changes = [share * (b - a) for a, b in zip(before, after, strict=True)]
        size = largest_change(self._comm, changes, self._fixed)
        self._kink.find(before, changes, size, start, end)
        self._hooks("before_step")
        self._evaluate(self._x, self._b)
        return self._kink.is_held

    def _move_to(self, values: Sequence[npt.NDArray]):
        """Move bodies to these unknowns of this rank, and find the gaps there. Collective."""
        for x, part in zip(self._x.getNestSubVecs(), values, strict=True):
            x.array[:] = part
        self._assign(self._x)
        for rows in self._rows:
            rows.update_geometry()

    def _is_clear(self, ahead: Sequence[npt.NDArray], since: Sequence[Displacements]) -> bool:
        """True if nothing overlaps or has passed after these changes. Collective.

        Args:
            ahead: Changes of this rank's unknowns.
            since: Displacements of each contact's sides at the start of the load step.
        """
        start, _ = self._go_on(ahead)
        try:
            for rows in self._rows:
                rows.update_geometry()
            return not any([rows.overlaps for rows in self._rows]) and not self._passed(since)
        except InterfaceError:  # no gaps there; where the bodies are, there are some
            return False
        finally:
            self._restore(start)

    def _passed(self, since: Sequence[Displacements]) -> str:
        """Message about what went through a wall since the start of the load step, or nothing.

        Args:
            since: Displacements of each contact's sides there.
        """
        for c, (rows, u) in enumerate(zip(self._rows, since, strict=True)):
            at, self._poking[c] = rows.passed(u)
            if len(at):
                return (
                    f"one side of contact {c} went through the other one, around {spot(at)}, "
                    "where they have moved by more than half of a wall: take smaller load steps."
                )
        return ""

    def _go_on(self, ahead: Sequence[npt.NDArray]) -> tuple[SystemState, SystemState]:
        """Change the unknowns by these values; the states before and after. Collective."""
        start = self._state()
        for x, more in zip(self._x.getNestSubVecs(), ahead, strict=True):
            x.array[:] += more
        self._assign(self._x)
        return start, self._state()

    def _record(self, step: int):
        """Record a Newton step."""
        now = [rows.state.active for rows in self._rows]
        changes = [a ^ b for a, b in zip(now, self._recorded, strict=True)]
        num = sum(map(np.count_nonzero, changes))
        came = sum(int(np.count_nonzero(a & b)) for a, b in zip(now, changes)) if num else 0
        gap = max(rows.largest_gap for rows in self._rows)
        residual = self._balance.unbalanced / (self._balance.in_bodies or 1)
        found = {"gap": gap, "came": came, "went": int(num) - came, "step": step}
        self._records.note(residual, self._tangent.iterations, **found)
        self._recorded = now

    def _is_finite(self) -> bool:
        """True if the residual is one of numbers. Collective."""
        return all(np.isfinite([b.norm() for b in self._b.getNestSubVecs()]))

    def _step(
        self, jump: Sequence[npt.NDArray[np.float64]] | None, stiffness: float
    ) -> tuple[tuple[SystemState, SystemState], float, bool]:
        """Solve the linearised contact problem, and take its solution. Collective.

        Args:
            jump: Increments that prescribed displacements have to make; None without any.
            stiffness: Stiffness of the bodies' nodes, as the working sets were chosen with.

        Returns:
            The states before and after, and the work of the increments of forces on those of
            displacements: Hill's second-order work, negative where an equilibrium isn't stable;
            and whether stiffness was added.
        """
        start = self._state()
        last = [(rows.state.p, rows.clearance) for rows in self._rows]
        parts = self._x.getNestSubVecs()
        num_tied = sum(part.getSize() for part in parts[len(parts) - self._num_ties :])
        num_tied += sum(field.num_others for field in self._fields)  # pressures, as a rule
        nearness = self._nearness if self._num_free else None

        def solve(guesses: complementarity.Guesses) -> Solution:
            equations = [rows.equations(jump) for rows in self._rows]
            problem = LinearisedContact(self._tangent, self._rows, equations, stiffness)
            return problem.solve(
                self._right(), num_tied, self._fixed, nearness, guesses, self._reach
            )

        balance = self._balance  # forces of soft bodies balance, too
        self._tangent.floor = 0.01 * self._rtol * balance.in_bodies + balance.round_off
        found = self._kink.solved(lambda: self._solution(solve), self._moves_of)
        if not found.is_solved and self._leaves_what_touches(start, stiffness):
            again = self._solution(solve)
            found = again if again.is_solved else found
        self._num_rays = self._num_rays + 1 if found.leaves else 0
        no_more = self._num_rays == PATIENCE or (found.leaves and self._is_too_much())
        if not found.is_solved or no_more:
            raise SolveError(self._unsolved(found))
        self._check_turns(found.changes)
        for rows, *solution in zip(self._rows, found.y, found.f, found.changed, strict=True):
            rows.accept(*solution)
        for x, dx in zip(parts, found.changes, strict=True):
            x.array[:] -= dx
        self._assign(self._x)
        largest = largest_change(self._comm, found.changes, self._fixed)
        self._reach = np.inf if found.leaves else largest / SHORTENED  # held near its place
        changes = self._of_displacements(found.changes)
        work = self._comm.allreduce(float(np.real(sum(map(np.dot, changes, balance.left)))))
        for rows, (p, g) in zip(self._rows, last, strict=True):
            work -= ((rows.state.p - p) * g)[rows.state.active].sum()
        return (start, self._state()), work, found.is_stiffened

    def _solution(self, solve: Callable[[complementarity.Guesses], Solution]) -> Solution:
        """Solution of the linearised problem from the present working sets. Collective."""
        guesses, sets = self._tangent.guesses(), list[NormalState]()
        if isinstance(self._tangent, MultigridTangent):
            sets = [rows.state.copy() for rows in self._rows]
        while True:
            try:
                found = solve(guesses)
            except IterationFailed as error:  # factors start from the same sets
                self._fall_back(self._why_failed(error))
                for rows, state in zip(self._rows, sets, strict=True):
                    rows.restore(state)
                guesses = self._tangent.guesses()
                continue
            except SolveError:
                # What slips in nearly one direction all but doesn't hold a body: then it sticks
                if not self._num_free or not any([rows.stick() for rows in self._frictional]):
                    raise
                continue
            if not found.is_guess:
                break
            guesses.take(sum(int(part.sum()) for part in found.changed))
            for rows, *solution in zip(self._rows, found.y, found.f, found.changed, strict=True):
                rows.guess(*solution)
            if self._num_free:
                self._hold()
        if not found.is_solved and any([rows.slide() for rows in self._rows]):
            # A base that sticks can be all but singular: where the motion along it is held, too
            if self._num_free:
                self._hold()
            again = self._falling_back(lambda: solve(guesses))
            found = again if again.is_solved else found
        return found

    def _moves_of(self, found: Solution) -> list[Displacements]:
        """Displacements of each contact's sides by a solution. Collective."""
        sides = [rows.from_bodies(found.changes) for rows in self._rows]
        return [(-u0, -u1) for u0, u1 in sides]

    def _leaves_what_touches(self, start: SystemState, stiffness: float) -> bool:
        """Go back to the last sets: what touches can say the same twice. False if they are these.

        Args:
            start: The state with the sets that led to no solution.
            stiffness: As for :meth:`_step`.
        """
        self._restore(start)
        zero = self._zero_pressure()
        for rows in self._rows:
            rows.start_set(stiffness, zero, touches=False)
        if self._num_free:
            self._hold()
        pairs = zip(self._rows, start.contacts, strict=True)
        return any((rows.state.active != before.active).any() for rows, before in pairs)

    def _check_turns(self, changes: Sequence[npt.NDArray]):
        """Raise if a step turns a rigid body by more than a turn: then nothing holds it."""
        n, names = self._num_elastic, self._names[self._num_elastic :]
        for name, body, change in zip(names, self._points, changes[n:], strict=False):
            turn = body.turn_by(change)
            if not turn <= 2 * np.pi:
                raise SolveError(
                    f"{name} turns by {np.degrees(turn):.3g}° in a Newton step: neither contact"
                    f"{' nor friction' * self._has_friction} nor springs balance its torque; "
                    "hold it by held=."
                )

    def _is_too_much(self) -> bool:
        """True if no contact forces balance the load on free motions, in no step. Collective.

        With small sliding and linear forms all steps have the same motions, rows and load.
        """
        if not self._is_linear or self._hooks.has("before_step") or self._points:
            return False
        assert self._free is not None
        modes = [self._free.at(i, 0 * part) for i, part in enumerate(self._owned())]
        moves = [rows.moved(modes) for rows in self._rows]

        def pushes(motion):
            return np.vstack([of.pushes(part, motion) for of, part in zip(self._rows, moves)])

        return complementarity.is_too_much(self._load(modes), pushes)

    def _nearness(self) -> float:
        """Share of the bodies' diagonal with which free motions go a facet's size. Collective.

        Without a load on these motions there is no such share, and any one holds the bodies.
        """
        assert self._free is not None
        modes = [self._free.at(i, part) for i, part in enumerate(self._owned())]
        largest = self._comm.allreduce(max(float(np.abs(m).max(initial=0)) for m in modes), MPI.MAX)
        size = min(float(rows.sides[1].reference.size.max()) for rows in self._rows)
        found = largest * float(np.abs(self._load(modes)).max()) / (self._stiffness() * size)
        return found if found > NOTHING else AT_REST

    # What a load step that fails says

    def _inverted(self) -> str:
        """Message about cells that displacements turn over. Collective."""
        at = []
        assert self._free is not None
        left = self._of_displacements([b.array_r for b in self._b.getNestSubVecs()])
        elastic = slice(self._num_elastic)
        for name, x, b in zip(self._names[elastic], self._free.places, left, strict=False):
            wrong = ~np.isfinite(b).reshape(x.shape).all(axis=1)
            if wrong.any():
                at.append(f" of {name} around {spot(x[wrong][:1])} of its mesh")
        where = next((part for parts in self._comm.allgather(at) for part in parts), None)
        if where is None:  # seen by points of the tangent only
            return "cells are inverted."
        return f"cells{where} are inverted, or F is no number there, however short the step is."

    def _stalled(self, step: int) -> str:
        """Message about an iteration without progress. Collective."""
        parts = [rows.unsatisfied() for rows in self._rows]
        worst = [float(np.abs(part).max(initial=0)) for part in parts]
        c = int(np.argmax(worst))
        rows, part = self._rows[c], parts[c]
        forces = np.bincount(rows.C.i, np.abs(rows.C.values * rows.state.p[rows.C.i]), len(rows.g))
        k = int(np.abs(part).argmax()) if worst[c] else int(forces.argmax())
        at = self._place(rows, k)
        gap = max(part.largest_gap for part in self._rows)
        way_out = "; with friction, give (larger) elastic_slip=, or solve without friction first"
        return (
            f"no equilibrium is found: after {step} Newton steps forces are off by "
            f"{self._balance.unbalanced:.2g}, gaps in contact by {gap:.2g}, "
            f"and contact {c} changes most at {at}{way_out * self._has_friction}."
        )

    @property
    def _has_friction(self) -> bool:
        """True if there is friction anywhere at present. Collective."""
        return any([rows.has_friction for rows in self._rows])

    @staticmethod
    def _place(rows: ContactRows, number: int) -> str:
        """Place of a multiplier at the start of the load step: what fails may be far away."""
        assert rows.start is not None
        return spot(rows.sides[1].displaced(rows.start[1]).x[[number % len(rows.g)]])

    def _unsolved(self, found: Solution) -> str:
        """Message about a linearised problem without a solution: a body leaves. Collective."""
        pulls = [values[: len(rows.g)] for rows, values in zip(self._rows, found.base, strict=True)]
        c = int(np.argmin([part.min(initial=0) for part in pulls]))
        rows, k = self._rows[c], int(pulls[c].argmin())
        at = self._place(rows, k)
        if self._num_free and rows.has_friction:
            return (
                f"the linearised contact problem has no solution: {self._strays.of(rows.bodies)}, "
                "that nothing else holds, slides, tips or is drawn away; its load may be more than "
                "friction can hold, or Γ1's facets there are too few to hold it: refine them, or "
                "make that body Γ1; bodies that lie on each other find their places more easily "
                "with no friction in the first load step."
            )
        if not self._num_free:
            return (
                f"the linearised contact problem has no solution: contact {c} can neither be "
                f"closed nor open around {at}."
            )
        return (
            f"contact would have to pull at {at}: {self._strays.of(rows.bodies)}, that "
            f"nothing else holds, is drawn away, or tilts; hold it by {self._strays.remedy}."
        )

    def _check_held(self):
        """Raise if nothing can hold a body, or sticking with more than friction can. Collective."""
        if self._num_free:
            sets = [rows.state.copy() for rows in self._rows]
            self._hold()
            for rows, state in zip(self._rows, sets, strict=True):
                rows.restore(state)
        for rows in self._hold_too_much():
            if not self._num_free:
                raise SolveError(
                    f"contact {self._rows.index(rows)}: gaps of several vertices depend on the "
                    "same displacements, the others of which are prescribed: pressures there are "
                    "arbitrary, and friction more than these allow; prescribe fewer of them, or "
                    "give a small compliance=."
                )
            raise SolveError(
                f"{self._strays.of(rows.bodies)}, that nothing else holds, slides: its load is "
                f"more than friction can hold; hold it by {self._strays.remedy}, or prescribe how "
                "it moves."
            )

    def _hold_too_much(self) -> list[FrictionRows]:
        """Contacts with sticking tractions beyond friction, as where its coefficient has fallen."""
        nothing = self._balance.nothing
        return [rows for rows in self._frictional if rows.holds_too_much(nothing)]

    def _assemble_what_moved(self):
        """Assemble the stiffness of bodies but for those that the last steps hardly moved."""
        self._slack = REUSED * self._finest
        self.assemble_matrix()
        self._slack = 0.0

    def _zero_pressure(self) -> float:
        """Pressure treated as zero beside the largest one."""
        states = [rows.state for rows in self._rows]
        return NOTHING * max(
            float(np.abs(state.p[state.active]).max(initial=0)) for state in states
        )

    def _jump(self) -> tuple[list[npt.NDArray[np.float64]] | None, float]:
        """Increments of owned dofs still prescribed, None without any; the largest. Collective."""
        found = [
            np.where(held, wanted[: len(held)] - u.x.array[: len(held)], 0)
            for u, wanted, held in zip(self._u, self._goal, self._held, strict=True)
        ]
        largest = max(float(np.abs(part).max(initial=0)) for part in found)
        largest = self._comm.allreduce(largest, MPI.MAX)
        return found if largest else None, largest

    def _hold(self):
        """Enlarge active sets until they hold, unless those that held before act. Collective."""
        assert self._free is not None
        if self._holding is not None and not (self._holding & ~self._acting()).any():
            return
        modes = [self._free.at(i, part) for i, part in enumerate(self._owned())]
        moves = [rows.moved(modes) for rows in self._rows]
        pairs = list(zip(self._rows, moves, strict=True))
        holds = np.vstack([rows.holds(part) for rows, part in pairs])
        every = np.concatenate([rows.state.active for rows in self._rows])
        distance, valid = (
            np.concatenate([getattr(rows, name) for rows in self._rows])
            for name in ("distance", "valid")
        )
        frictional = [(rows, part) for rows, part in pairs if isinstance(rows, FrictionRows)]

        def across():
            rows_across = [rows.resists(part) for rows, part in frictional]
            rows_across.append(self._springs(modes))
            return np.vstack([p.reshape(-1, self._num_free) for p in (holds[:0], *rows_across)])

        active, num_free = complementarity.holding(every, distance, valid, holds, across())
        ends = np.cumsum([len(rows.g) for rows in self._rows])[:-1]
        for rows, part in zip(self._rows, np.split(active, ends), strict=True):
            rows.activate(part)
        if num_free and frictional:
            for rows, _ in frictional:
                rows.stick()
            num_free = complementarity.num_free(np.vstack((holds[active], across())))
        if num_free:
            found = np.vstack((holds[active], across()))
            now, friction = self._owned(), self._has_friction
            raise SolveError(self._strays.unheld(self._began, now, found, num_free, friction))
        self._holding = self._acting()

    def _of_displacements(self, values: Sequence[npt.NDArray]) -> list[npt.NDArray]:
        """This rank's displacements among values of each body."""
        return [part.of_body(of) for part, of in zip(self._moving, values, strict=False)]

    def _acting(self) -> npt.NDArray[np.bool_]:
        """Mask of the multipliers that are active, and of those that stick."""
        sets = [rows.state.active for rows in self._rows]
        return np.concatenate([*sets, *(rows.stuck for rows in self._frictional)])

    def _owned(self) -> list[npt.NDArray[np.float64]]:
        """This rank's owned displacements of each body."""
        return [u.x.array[: len(held)] for u, held in zip(self._u, self._held, strict=True)]

    def _lost(self, state: SystemState, error: Exception) -> str:
        """Message on where a failed step led bodies that only contact holds. Collective."""
        before = state.values[: len(self._u)]
        return self._strays.lost(before, self._owned(), str(error)) if self._num_free else ""

    def _load(self, modes: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
        """Forces on free rigid motions that contact is to balance, ``(num,)``. Collective."""
        parts = [m.T @ b.array_r for m, b in zip(modes, self._b.getNestSubVecs(), strict=False)]
        return self._comm.allreduce(sum(parts))

    def _springs(self, modes: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
        """Elongations of rigid bodies' springs by free motions, ``(num, num_free)``. Collective."""
        pairs = zip(self._points, modes[self._num_elastic :], strict=True)
        rows = [body.shared(part)[body.springs > 0] for body, part in pairs]
        return np.vstack([np.zeros((0, self._num_free)), *rows])

    def _forces_left(self) -> tuple[list[npt.NDArray], list[list[npt.NDArray]]]:
        """This rank's residual of bodies and ties with contact forces, and those by contact."""
        found = self._right()
        return found, [rows.subtract_forces(found, self._held) for rows in self._rows]

    def _left_of_bodies(self) -> list[npt.NDArray]:
        """This rank's residual of displacements, with contact forces."""
        return self._of_displacements(self._forces_left()[0][: len(self._u)])

    def _right(self) -> list[npt.NDArray]:
        """This rank's residual of bodies and ties without the contacts' forces."""
        return [part.array_r.copy() for part in self._b.getNestSubVecs()]

    def _balances(self) -> bool:
        """True if the residual is zero within rtol and the active gaps are closed. Collective."""
        left, of_contacts = self._forces_left()
        self._stiffness()
        balance = self._balance
        balance.measure(left, self._num_ties, self._owned(), self._forces, of_contacts)
        beyond = balance.unexplained()
        self._is_exact = not beyond and not self._tied  # ties have gaps, too
        if not balance.satisfies_others or not beyond <= self._rtol * balance.in_bodies:
            return False
        return all([rows.is_closed(balance.nothing) for rows in self._rows])

    def _balances_between(self) -> bool:
        """True if forces between those of this and of the last state balance; takes these then.

        Both states are the same within what is treated as zero, on both sides of a kink.
        Collective.
        """
        parts, last = self._x.getNestSubVecs(), self._before
        values = [part.array_r.copy() for part in parts]
        self._before = values, self._balance.left, [rows.acting for rows in self._rows]
        if last is None:
            return False
        apart = [b - a for a, b in zip(values, last[0], strict=True)]
        far = max(float(np.abs(part).max(initial=0)) for part in self._of_displacements(apart))
        if self._comm.allreduce(far, MPI.MAX) > min(rows.closed for rows in self._rows):
            return False
        change = [b - a for a, b in zip(self._balance.left, last[1], strict=True)]
        sums = np.array([sum(map(np.vdot, of, change)).real for of in (self._balance.left, change)])
        self._comm.Allreduce(MPI.IN_PLACE, sums)
        if not 0 < -sums[0] < sums[1]:
            return False
        share, state = -sums[0] / sums[1], self._state()
        for part, more in zip(parts, apart, strict=True):
            part.array[:] += share * more
        self._assign(self._x)
        for rows, acting in zip(self._rows, last[2], strict=True):
            rows.act_between(acting, share)
        self._evaluate(self._x, self._b)
        if self._balances():
            return True
        self._restore(state)
        for rows in self._rows:
            rows.update_geometry()
        self._evaluate(self._x, self._b)
        return self._balances()

    def _slides(self, jump: Sequence[npt.NDArray[np.float64]]) -> bool:
        """True if active surfaces are prescribed to move farther than their facets are long."""
        parts = self._of_displacements(jump)
        largest = max(float(abs(part).max(initial=0)) for part in parts)
        far = self._comm.allreduce(largest, MPI.MAX)
        return not self._num_free and any(
            rows.state.p.any() and far > rows.sides[1].reference.size.max() for rows in self._rows
        )

    def _lead(self):
        """Move bodies as rigid ones if they are prescribed to move far or to turn together.

        Contact forces turn with bodies that stay together, and are zero where they separate.
        Collective.
        """
        jump, _ = self._jump()
        assert self._free is not None
        pushes = any(rows.state.p.any() for rows in self._rows)
        if self._tied or self._points or self._num_free or jump is None or not pushes:
            return
        now, ways, held = map(self._of_displacements, (self._owned(), jump, self._held))
        motions = prescribed_motions(self._comm, self._free, now, ways, held)
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
        for part, field, x, u, motion in zip(parts, self._moving, self._free.places, now, motions):
            part.array[:] += field.into_body(motion.shift(x + u.reshape(x.shape)).ravel())
        self._assign(self._x)

    def _stiffness(self) -> float:
        """Mean diagonal of the softest body, else of rigid ones' springs. Collective."""
        if self._stiffness_of != self._known:
            self._stiffness_of = list(self._known)
            self._balance.measure_stiffness()
        return self._balance.stiffness or max(rows.springs for rows in self._rows)

    def half_space_compliance(self, rows: ContactRows) -> float:
        """1/E* of half-spaces of a contact's bodies, 0 if it isn't known. Collective.

        Drawn pressures have it: it is no compliance of the contact.
        """
        found = 0.0
        for i, side in zip(rows.bodies, rows.sides, strict=True):
            if i is None or i >= self._num_elastic:
                continue  # rigid
            if self._fields[i].num_others or not free_edges.bends(side):
                return 0.0
            part = free_edges.compliance(side, self._fields[i].of_slopes(self._K[i], side))
            if not part:
                return 0.0
            found += part
        return found
