# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bodies in contact, solved load step by load step."""

import logging
from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem
from hypergap_dolfinx.algebra import revolution
from hypergap_dolfinx.algebra.checks import name_of_body, turned_over
from hypergap_dolfinx.algebra.load_path import OF_RIGID, OF_TIE, LoadPath, Value, values_of
from hypergap_dolfinx.contact import Contact
from hypergap_dolfinx.contact_geometry.status import table
from hypergap_dolfinx.contact_solver.contact_rows import ContactPair, ContactRows, SystemState
from hypergap_dolfinx.contact_solver.contact_system import ContactSystem
from hypergap_dolfinx.contact_solver.friction_rows import FrictionRows
from hypergap_dolfinx.contact_solver.predictor import Extrapolation
from hypergap_dolfinx.core.collective import raise_on_all, spot
from hypergap_dolfinx.errors import InterfaceError, InvertedCellError, SolveError, UnsolvableError
from hypergap_dolfinx.interface_laws.coupling import Coupling, motions_of
from hypergap_dolfinx.interface_laws.given_values import is_read
from hypergap_dolfinx.interface_laws.reference_point import PointComponent
from hypergap_dolfinx.interface_laws.rigid_body import RigidBody, RigidBodyMotion
from hypergap_dolfinx.joining import Joined
from hypergap_dolfinx.solvers.checkpoint import Checkpoint, Part
from hypergap_dolfinx.solvers.hooks import Hooks
from hypergap_dolfinx.solvers.records import times
from hypergap_dolfinx.surface.component import Component, lagrange_components
from hypergap_dolfinx.surface.moving import Displacements, MovingSurface
from hypergap_dolfinx.surface.tolerances import OWN_GAP
from hypergap_dolfinx.surface.trace import gap_of_chords, is_mixed
from hypergap_dolfinx.tie import Tie
from hypergap_dolfinx.tolerances import (
    ALIKE,
    BEHIND_BODY,
    FAR_PRESSURE,
    HALVINGS,
    LEANING,
    STIFF,
    TILT,
)

LOG = logging.getLogger("hypergap_dolfinx")


class ContactProblem(ContactSystem):
    """Nonlinear problem F_i(u_i; v_i) = 0 on several bodies with contacts and ties.

    Solves F_i(u_i) − Σ_c Cᵀ_ci p_c + Σ_t Bᵀ_ti λ_t = 0 with p_c ≥ 0, g_c ≥ 0, p_c g_c = 0 and
    C = ∂g/∂u. Each call of :meth:`solve` is one load step.

    Example:
        The blocks of :class:`Contact` (with λ = μ = 1); the upper one is moved down:

        >>> u = [fem.Function(V) for V in (V0, V1)]
        >>> def residual(w):
        ...     sigma = 2 * ufl.sym(ufl.grad(w)) + ufl.div(w) * ufl.Identity(2)
        ...     return ufl.inner(sigma, ufl.grad(ufl.TestFunction(w.function_space))) * ufl.dx
        >>> top = fem.Constant(above, (0.0, 0.0))
        >>> bcs = [
        ...     fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, at(V.mesh, y)), V)
        ...     for value, V, y in ((fem.Constant(below, (0.0, 0.0)), V0, -1), (top, V1, 1.1))
        ... ]
        >>> problem = ContactProblem([residual(w) for w in u], u, bcs=bcs, contacts=[contact])
        >>> for down in (0.05, 0.2):
        ...     top.value[1] = -down
        ...     u0, u1 = problem.solve()
        ...     force = abs(contact.force(problem)[1])
        ...     print(f"{force:.3f}, {contact.active.sum()} vertices in contact")
        0.000, 0 vertices in contact
        0.312, 5 vertices in contact
        >>> p, g = contact.pressure(problem), contact.gap(u0, u1)
        >>> bool(abs(g.x.array).max() < 0.01)
        True
    """

    def __init__(
        self,
        F: Sequence[ufl.Form | RigidBody | None],
        u: Sequence[fem.Function],
        *,
        bcs: Sequence[fem.DirichletBC] = (),
        contacts: Sequence[Contact],
        ties: Sequence[Tie] = (),
        couplings: Sequence[Coupling] = (),
        J: Sequence[ufl.Form] | None = None,
        rtol: float = 1e-8,
        before_step: Callable[[], Any] | None = None,
        accepted: Callable[[float], Any] | None = None,
        taken_back: Callable[[], Any] | None = None,
        internal_variables: Sequence[fem.Function | fem.Constant] = (),
        solver: str | None = None,
        petsc_options_prefix: str = "hypergap_",
        petsc_options: dict | None = None,
        form_compiler_options: dict | None = None,
        jit_options: dict | None = None,
    ):
        """Compile the forms. Collective.

        Args:
            F: Residual form of each body; None for a rigid obstacle, whose u is set by the user; a
                :class:`RigidBody` for a rigid body under forces and torques.
            u: Displacement of each body, as used in F; its values are the initial displacements.
            bcs: Dirichlet conditions of all bodies, in any order.
            contacts: The contacts.
            ties: The ties.
            couplings: Couplings of surfaces with points.
            J: Jacobian form of each body with a residual form. By default the derivative of F; in
                slender bodies with the stress that the last Newton step predicted.
            rtol: Tolerance of the residual, relative to the forces in the bodies.
            before_step: Callback ``f()`` before each evaluation of the residual at new
                displacements, to update data of the forms such as stresses at quadrature points.
                If it raises a SolveError the Newton step has failed.
            accepted: Callback ``f(share)`` after a solved load step, or a solved part of a halved
                one, to update the history. ``share`` is the part of the load step reached, 1.0 at
                its end; update rates only then. If it raises a SolveError the step is rejected.
            taken_back: Callback ``f()`` after a part of a load step has failed and the last state
                is restored.
            internal_variables: Functions and constants that these callbacks change. They are not
                interpolated when a load step is halved, are restored with the state, and are part
                of :meth:`state`.
            solver: ``"direct"`` factorises. ``"iterative"`` is multigrid with an iteration in the
                space of displacements that close the active gaps: much faster, with less memory,
                from about 20 000 displacements in 3D on, for symmetric positive definite
                stiffness. If it fails, a factorisation replaces it, with a message in the log. By
                default the problem chooses; with friction ``"direct"``.
            petsc_options_prefix: Prefix of PETSc options, ending with ``_``.
            petsc_options: Options of the KSP of the Newton steps (with ``"direct"`` its matrix is
                an AIJ). Without a type they use MUMPS: LDLᵀ, or LU with friction or where LDLᵀ
                fails.
            form_compiler_options: Options of FFCx.
            jit_options: Options of the JIT compiler.

        Raises:
            ValueError: Different numbers of forms and functions; a residual that isn't linear in a
                test function; no contacts; a contact, tie or boundary condition on a space of no
                body; a rigid Γ1 that is finer than Γ0; an rtol outside of 0 ≤ rtol < 1.
            InterfaceError: The same facets in two contacts, or in a contact and a tie.
        """
        if not all(isinstance(given, Sequence) for given in (F, u)) or not all(
            isinstance(f, fem.Function) for f in u
        ):
            raise ValueError("F and u are lists, with one form and one function for each body.")
        if len(F) != len(u):
            raise ValueError(f"{len(F)} residual forms and {len(u)} functions: give one of each.")
        for i, V in enumerate(f.function_space for f in u):
            if not is_mixed(V) and V.value_shape != (V.mesh.geometry.dim,):
                raise ValueError(
                    f"body {i} has values of shape {V.value_shape}; in contact problems bodies "
                    "have displacements."
                )
        contacts = [contacts] if isinstance(contacts, Contact) else list(contacts or ())
        if not contacts:
            raise ValueError(
                "there are no contacts; bodies without any are a NonlinearTiedProblem."
            )
        if not (isinstance(rtol, float | int | np.floating) and 0 <= rtol < 1):
            raise ValueError(f"rtol is a number ≥ 0 and below 1, not {rtol!r}.")
        ties = [ties] if isinstance(ties, Tie) else list(ties or ())
        self._watch(bcs)
        bcs = [bcs] if isinstance(bcs, fem.DirichletBC) else list(bcs or ())
        for name, given, kind in (("contacts", contacts, Contact), ("ties", ties, Tie)):
            wrong = [one for one in given if not isinstance(one, kind)]
            if wrong:
                raise ValueError(
                    f"{name} has a {type(wrong[0]).__name__}: make each with "
                    f"{kind.__name__}(side0, side1)."
                )
        hooks = Hooks(
            internal_variables,
            unknowns=u,
            before_step=before_step,
            accepted=accepted,
            taken_back=taken_back,
        )
        coupled = motions_of(couplings)
        rigid = {i: one.motion for i, one in enumerate(F) if isinstance(one, RigidBody)}
        _check_rigid(rigid, u, contacts, ties, bcs)
        _check_apart(contacts, ties)
        of_bodies = [None if isinstance(form, RigidBody) else form for form in F]
        elastic = [i for i, form in enumerate(of_bodies) if form is not None]
        forms = [form for form in of_bodies if form is not None]
        moving = [*elastic, *rigid]
        self._every = list(u)
        pairs, told_sizes = [], list[str]()
        for c, contact in enumerate(contacts):
            bodies = [self._body(c, i, part) for i, part in enumerate(contact.components)]
            numbers = [moving.index(b) if b in moving else None for b in bodies]
            if numbers == [None, None]:
                raise ValueError(f"contact {c} is between two rigid bodies.")
            are_rigid = [b not in elastic for b in bodies]
            if all(are_rigid) and contact.compliance is None:
                raise ValueError(
                    f"contact {c} is between two rigid bodies, where pressures are undetermined: "
                    "give it a compliance."
                )
            if are_rigid[1] and not all(are_rigid) and contact.geometry.finer > ALIKE:
                raise ValueError(
                    f"Γ1 of contact {c} is rigid, with smaller facets than Γ0: there would be "
                    "more pressures than displacements; swap its sides."
                )
            if contact.geometry.is_wall and contact.geometry.doubt_of_sizes and not are_rigid[0]:
                told_sizes.append(contact.geometry.doubt_of_sizes)
            fields = u[bodies[0]], u[bodies[1]]
            both, on = (numbers[0], numbers[1]), (rigid.get(bodies[0]), rigid.get(bodies[1]))
            pairs.append(ContactPair(contact, fields, both, contact.components, on))
        super().__init__(
            [*forms, *(body.F for body in rigid.values())],
            [*(u[i] for i in elastic), *(body.q for body in rigid.values())],
            [*bcs, *(bc for body in rigid.values() for bc in body.bcs)],
            Joined(ties),
            pairs,
            parts=[
                *(_displacements(i, u[i].function_space, contacts) for i in elastic),
                *map(PointComponent.of_point, (*rigid.values(), *coupled)),
            ],
            names=[
                *(name_of_body(i, u[i].function_space) for i in moving),
                *(f"coupling {k}" for k in range(len(coupled))),
            ],
            rigid=list(rigid.values()),
            couplings=coupled,
            rtol=rtol,
            solver=solver,
            petsc_options_prefix=petsc_options_prefix,
            petsc_options=petsc_options,
            J=None if J is None else [*J, *(body.J for body in rigid.values())],
            hooks=hooks,
            form_compiler_options=form_compiler_options,
            jit_options=jit_options,
        )
        self._contacts = list(contacts)
        moved = [f for f, form in zip(u, F, strict=True) if form is None]
        values: list[tuple[str, Value]] = [
            (OF_TIE.format(t), v) for t, tie in enumerate(ties) for v in tie.given
        ]
        for c, one in enumerate(contacts):
            parts = (part for part in (one.friction, one.compliance) if part)
            values += [(f"{part.what} of contact {c}", part.given) for part in parts]
        for i, body in rigid.items():
            names = (f"{what} of body {i}, a rigid one," for what in OF_RIGID)
            values += list(zip(names, body.given, strict=True))
        for k, end in enumerate(coupled):
            values += list(zip((f"{w} of coupling {k}" for w in OF_RIGID), end.given, strict=True))
        without = (*self._u, *hooks.internal_variables)
        self._path = LoadPath(self._comm, values_of(forms, bcs, moved, values, without=without))
        self._last = Extrapolation(self._comm)
        self._cells: dict[int, dict[str, Any]] = defaultdict(dict)  # before displacements, by body
        self._halvings = 0
        for doubt in told_sizes if self._comm.rank == 0 else ():
            LOG.warning(doubt)
        revolution.tell(of_bodies, contacts, "contact")
        revolution.tell(of_bodies, ties, "tie")
        revolution.tell_couplings(forms, coupled)
        self._made = True

    def _body(self, c: int, side: int, part: Component) -> int:
        """The body on one side of a contact."""
        body = part.among([f.function_space for f in self._every])
        if body is None:
            raise ValueError(
                f"Γ{side} of contact {c} is on a space of no body; make the contact and the forms "
                "on the same function spaces."
            )
        return body

    @property
    def contacts(self) -> list[Contact]:
        """The contacts."""
        return list(self._contacts)

    @property
    def every_u(self) -> list[fem.Function]:
        """The displacements of all bodies, also of rigid ones."""
        return list(self._every)

    @property
    def iterations(self) -> int:
        """Number of Newton steps in the last :meth:`solve`, including failed load steps."""
        return self._iterations

    @property
    def halvings(self) -> int:
        """Number of times that the last :meth:`solve` halved its load step."""
        return self._halvings

    def rows(self, contact: Contact) -> ContactRows:
        """Gaps and pressures of a contact after a solve, as arrays.

        Args:
            contact: One of the problem's contacts.

        Raises:
            ValueError: A contact that isn't one of the problem's, or a problem that isn't solved.
        """
        c = next((c for c, other in enumerate(self._contacts) if other is contact), None)
        if c is None:
            what = "the contact" if isinstance(contact, Contact) else f"a {type(contact).__name__}"
            raise ValueError(
                f"{what} is not one of this problem's contacts: give one of problem.contacts."
            )
        if not self._solved:
            raise ValueError("the problem is not solved yet: call solve() first.")
        return self._rows[c]

    def solve(self) -> list[fem.Function]:
        """Solve one load step, from the last state to the present values. Collective.

        If Newton's method fails, the load step is halved, up to six times: all constants and
        functions in forms and boundary conditions are interpolated. If that fails too, the last
        solved part of it remains: to go back to its start, take :meth:`state` before, and
        :meth:`restore` that. The first load step starts with the values at construction: set loads
        after it. In a time loop the interpolated values include those of the last time step:
        intermediate states then lead to the new state, but aren't states in time.

        Returns:
            The displacement of each body, the same functions as in ``u``.

        Raises:
            SolveError: The load step has no solution beyond the part that the message names.
            InterfaceError: No Σ exists between the surfaces in their initial positions.
            KeyboardInterrupt: Ctrl-C, raised on all ranks at the end of the Newton step. The last
                solved state remains.
            ValueError: A negative coefficient of friction.
        """
        self._check_usable()
        self._check_bcs()
        with self._interrupts:
            self._records.start(self._num_steps + 1, self._tangent.iterations)
            self._iterations = self._halvings = 0
            try:
                self._solve_step()
            except BaseException as error:
                why = str(error) or "interrupted"
                self._records.end(why, halvings=self._halvings, solved=False)
                raise
            finally:
                self._warn_of_overlap()
            self._num_steps += 1
            self._solved = True
            self._records.end(self._summary(), halvings=self._halvings)
            if self._num_steps == 1:
                self._warn_of_reach(self._comm)
            self._warn_of_distance()
            self._warn_of_prescribed()
            self._warn_of_cells(self._comm)
            self._warn_of_turns()
            self._interrupts.check()
        return self._every

    def _solve_step(self):
        """Solve one load step, halved where necessary. Collective."""
        self._warn_of_moved(self._contacts)
        self._path.start_step()
        finite = all(np.isfinite(u.x.array).all() for u in self._u)
        wrong = self._path.wrong or (None if finite else "a displacement at the start, in u,")
        message = wrong and f"{wrong} is no number: it is NaN or infinite; set it before solve()."
        raise_on_all(self._comm, message, SolveError)
        for body in self._rigid:
            raise_on_all(self._comm, body.wrong(), ValueError)
        self._read_couplings()
        self._check_prescribed()
        changes = self._comm.allreduce(self._path.changes, MPI.LOR)
        self._prepare()
        if not self._num_steps:
            self._warn_of_stiffness(self._comm)
            self._warn_of_chords(self._comm)
        self._poked = [part[:0] for part in self._poking]
        done, size, ahead = 0.0, 1.0, None
        while done < 1:
            before, values = self._state(), [u.x.array.copy() for u in self._set]
            internal, since = self._hooks.copies(), [rows.before() for rows in self._rows]
            s = min(done + size, 1.0)
            self._path.interpolate(s)
            load = self._path.increments(done, s)
            try:
                if not self._last.in_contact:
                    ahead = self._ahead(load, before, since)
                self._newton(ahead)
                if passed := self._passed(since):
                    raise SolveError(passed)
                self._accept(s)
            except (SolveError, InterfaceError, InvertedCellError) as error:
                lost = self._lost(before, error)
                self._restore(before)
                self._hooks.restore(internal)
                self._hooks("taken_back")
                if isinstance(error, UnsolvableError):
                    self._stop_at(done)
                    raise
                if not isinstance(error, SolveError) and not self._iterations:
                    self._path.commit(done)
                    raise  # surfaces without a Σ where the bodies were
                first = changes and ahead is None and self._last.in_contact
                ahead = self._ahead(load, before, since) if first else None
                if ahead is not None:
                    self._records.tell(f"tried again from another start: {error}")
                    continue
                is_last = not changes or size <= 0.5**HALVINGS
                if is_last and self._fall_back("no equilibrium is found with it"):
                    continue
                if not changes:
                    raise SolveError(
                        f"contact: {error}{lost} The load step can't be halved: no value has "
                        "changed since the last one, or since the problem was made (load it then)"
                        f"{self._unseen_values()}."
                    ) from error
                size /= 2
                self._halvings += 1
                if is_last:
                    self._stop_at(done)
                    raise SolveError(
                        f"contact: no solution beyond {100 * done:.3g} % of the load step; "
                        f"{error}{lost}"
                    ) from error
                self._records.tell(f"halved at {100 * s:.3g} %: {error}")
            except BaseException:
                self._hooks.restore(internal)
                self._interrupted(before, values, done)
                raise
            else:
                for one in (*self._rows, *self._points):
                    one.commit()
                self._poked = [
                    a if len(a) else b for a, b in zip(self._poked, self._poking, strict=True)
                ]
                now = self._state()
                on = any(state.p.any() for state in (*before.contacts, *now.contacts))
                self._last.remember(load, before.values, now.values, in_contact=on)
                done, size, ahead = s, min(2 * size, 1.0), None
                if done < 1:
                    self._records.tell(f"solved up to {100 * done:.3g} %")
        self._path.commit()
        self._react()

    def _forget(self):
        super()._forget()
        self._last.forget()

    def _ahead(
        self,
        load: Sequence[npt.NDArray],
        before: SystemState,
        since: Sequence[Displacements],
    ) -> list[npt.NDArray] | None:
        """Changes of the unknowns as in the last load step; None if they close a gap. Collective.

        Args:
            load: Increments of the values that this rank owns.
            before: The present state.
            since: Displacements of each contact's sides there.
        """
        changes = None if self._num_free else self._last.changes(load, before.values)
        return changes if changes is None or self._is_clear(changes, since) else None

    def _accept(self, s: float):
        """Call ``accepted``; raise if it changed a value that the load step sets back. Collective.

        Args:
            s: Part of the load step that is reached.
        """
        if not self._hooks.has("accepted"):
            return
        before = self._path.copies()
        self._hooks("accepted", s)
        kind = self._path.changed_since(before)
        raise_on_all(
            self._comm,
            kind
            and f"accepted changed {kind}, which the load step sets back: give what it changes as "
            "internal_variables.",
            ValueError,
        )

    def _react(self):
        """Find the reactions of what is held of rigid bodies and couplings. Collective."""
        self._take_couplings()
        for body in self._rigid:
            body.react([load for rows in self._rows for load in rows.loads_on(body)])

    @property
    def _set(self) -> list[fem.Function]:
        """Functions that a solve sets: unknowns, and the displacements of rigid bodies."""
        return [*self._u, *(body.u for body in self._rigid)]

    def _stop_at(self, done: float):
        """End a load step at the last solved state. Collective.

        Args:
            done: Part of the load step that was reached.
        """
        self._path.commit(done)
        if done or self._solved:
            for rows in self._rows:
                rows.update_geometry()
            self._react()

    def status(self) -> str:
        """Table to print before a solve, for present displacements. Collective.

        It has surfaces, facet sizes, gaps and overlaps of all contacts, facets with nothing
        opposite, and bodies that only contact holds, or nothing at all.
        """
        self._check_usable()
        self._prepare_once()
        fresh = [self._fresh(c) for c in range(len(self._rows))]
        found = [one.geometry.status(rows) for one, rows in zip(self._contacts, fresh, strict=True)]
        return table(found, self._free_in_words([r for r, s in zip(fresh, found) if not s.error]))

    def _fresh(self, c: int) -> ContactRows:
        """Rows of a contact without its state, for gaps where the bodies are now. Collective."""
        rows = type(self._rows[c])(self._pairs[c], self._held)
        rows.condensed_to = self._rows[c].condensed_to
        return rows

    def _free_in_words(self, found_rows: Sequence[ContactRows]) -> list[str]:
        """Messages about bodies that only contact can hold. Collective.

        Args:
            found_rows: Rows of contacts with known gaps.
        """
        if not self._num_free:
            return []
        owned = self._owned()
        assert self._free is not None
        springs = self._springs([self._free.at(i, part) for i, part in enumerate(owned)])
        if not self._strays.num_left(springs):
            return []
        only = self._strays.moving(owned, springs)
        found = [f"only contact can hold {only}; otherwise hold it by {self._strays.remedy}."]
        holds = self._holds(found_rows, lambda rows: rows.valid, lambda r: r.valid & r.has_friction)
        if self._strays.num_left(holds):
            what = self._strays.moving(owned, holds)
            found.append(
                f"nothing holds {what}, even if all that faces something touches; hold it "
                f"by {self._strays.remedy}."
            )
        return found

    def _values(self) -> Sequence[Value]:
        return self._path.values

    def _parts(self, checkpoint: Checkpoint, lost: list[str]) -> list[Part]:
        """Arrays of the state, including values at the start of a load step and contacts."""
        parts = super()._parts(checkpoint, lost)
        for k, value in enumerate(zip(self._path.values, self._path.start, strict=True)):
            parts.append(checkpoint.start(f"start{k}", *value))
        for i, body in enumerate(self._rigid):
            parts.append(checkpoint.shared(f"rigid body {i}", body.kept, body.resume))
        for c, rows in enumerate(self._rows):
            orders = list(map(checkpoint.order, rows.spaces))
            parts += checkpoint.contact(f"contact {c}", rows, orders)
        return parts

    def _interrupted(self, before: SystemState, values: Sequence[npt.NDArray], done: float):
        """Restore the last solved state after an interrupt.

        Not collective unless all ranks have agreed on the interrupt.
        """
        for u, array in zip(self._set, values, strict=True):
            u.x.array[:] = array
        for part, array in zip(self._x.getNestSubVecs(), before.values, strict=True):
            part.array[:] = array
        for rows, contact in zip(self._rows, before.contacts, strict=True):
            rows.restore(contact)
        self._known = [None] * len(self._known)  # matrices may be half assembled
        if self._interrupts.agreed:
            self._hooks("taken_back")
            self._stop_at(done)
        else:
            self._path.commit(done)

    def _summary(self) -> str:
        """Summary of a load step, in one line."""
        halved = f", halved {times(self._halvings, 'time')}" if self._halvings else ""
        num, every = (
            sum(int(part.sum()) for part in parts)
            for parts in ([rows.state.active for rows in self._rows], [r.valid for r in self._rows])
        )
        frictional = [rows for rows in self._rows if isinstance(rows, FrictionRows)]
        stuck = sum(int((rows.stuck & rows.state.active).sum()) for rows in frictional)
        sticking = f", {stuck} of them stick"
        return (
            f"{times(self._iterations, 'Newton step')}{halved}, "
            f"{num} of {every} vertices in contact{sticking if frictional else ''}"
        )

    def _warn_of_stiffness(self, comm):
        """Warn of a Γ1 that is far stiffer than Γ0 and not coarser. Collective."""
        for c, (contact, rows) in enumerate(zip(self._contacts, self._rows, strict=True)):
            i, j = (None if b is None or b >= self._num_elastic else b for b in rows.bodies)
            if i is None or contact.geometry.finer * ALIKE < 1:
                continue
            size = [
                np.inf
                if b is None
                else self._fields[b].stiffness(self._K[b], self._held[b], side.dofs)
                for b, side in zip((i, j), rows.sides, strict=True)
            ]
            if size[1] > STIFF * size[0] and comm.rank == 0:
                LOG.warning(
                    f"contact {c}: Γ1's body is {'rigid' if j is None else "far stiffer than Γ0's"}"
                    ", with facets that aren't longer; pressures will scatter: swap its sides "
                    "(Contact.between with stiffness does)."
                )

    def _unseen_values(self) -> str:
        """Note on jumps that may have changed without being seen, or nothing."""
        given = [t.jump.value for t in self.ties if isinstance(t, Tie) and t.jump]
        if not any(is_read(v) and not isinstance(v, fem.Constant | fem.Function) for v in given):
            return ""
        return "; jumps given as functions of x aren't seen: give a fem.Constant or fem.Function"

    def _warn_of_chords(self, comm):
        """Warn of overlaps and clearances beside which the gap between chords counts."""
        for c, contact in enumerate(self._contacts):
            own = gap_of_chords(*contact.geometry.surfaces)
            if not own:
                continue
            status = contact.geometry.status(self._fresh(c))
            gaps = status.gaps[status.facing]
            size = float(np.abs(gaps).mean()) if len(gaps) else np.inf
            if own <= OWN_GAP * size or size <= status.closed:
                continue
            if comm.rank == 0:
                are = "overlap by" if gaps.mean() < 0 else "have gaps of"
                LOG.warning(
                    f"contact {c}: its surfaces {are} {size:.3g} on average, and about {own:.2g} "
                    "is the gap between chords of a curved surface: pressures are off by that "
                    "share; curve both meshes (in Gmsh gmsh.model.mesh.setOrder(2)), or take "
                    "facets as long on both sides."
                )

    def _warn_of_distance(self):
        """Warn, once for each contact, of what means of gaps don't see."""
        kinds = (
            (0, "a corner went more than half of the way through the other side, and may go on"),
            (FAR_PRESSURE, "a pressure acts on surfaces up to {:.1f} facets apart"),
            (FAR_PRESSURE / 2, "surfaces overlap by {:.1f} facets of the finer side"),
            (
                LEANING,
                "facets of Γ1 tilt towards a wall of Γ0 beside them, and the gap up to it, {:.2f} "
                "facets in the mean, makes the contact force too small",
            ),
            (np.degrees(TILT), "forces lean by {:.0f}° from Γ1's normals, besides friction"),
            (
                LEANING,
                "friction acts across gaps of {:.2f} facets in the mean, so that its moments on "
                "both bodies differ",
            ),
        )
        for c, rows in enumerate(self._rows):
            slide, vertex = (0.0, 0) if ("slid", c) in self._told else rows.slid()
            if slide > FAR_PRESSURE / 2:
                self._warn_once(
                    ("slid", c),
                    f"contact {c}: at {spot(rows.sides[1].displaced(rows.u[1]).x[[vertex]])} "
                    f"surfaces slid along each other by {slide:.1f} facets of the finer side, but "
                    'with sliding="small" pressures act between the places that face each other '
                    'in the meshes; take sliding="finite".',
                )
            left = [k for k in range(len(kinds)) if ("far", c, k) not in self._told]
            poked = self._poked[c]
            found = [(float(len(poked)), 0), *(rows.reaches(FAR_PRESSURE / 2) if left else [])]
            for k, (size, vertex) in enumerate(found):
                bound, words = kinds[k]
                if k not in left or size <= bound:
                    continue
                x = rows.sides[1].displaced(rows.u[1]).x if k else poked
                self._warn_once(
                    ("far", c, k),
                    f"contact {c}: at {spot(x[[vertex]])} {words.format(size)}: a gap is the mean "
                    "over the facets of Γ1 at a vertex, and these are too coarse for a corner, "
                    "step or curve there; refine them, or take as Γ1 the side that has the corner, "
                    "else the finer one.",
                )

    def _warn_of_prescribed(self):
        """Warn, once for each contact, of overlaps where both sides are prescribed."""
        for c, (contact, rows) in enumerate(zip(self._contacts, self._rows, strict=True)):
            fixed = (rows.m > 0) & ~rows.valid
            depth = np.divide(-rows.g, rows.m, out=np.zeros(len(rows.m)), where=fixed)
            if ("fixed", c) in self._told or depth.max(initial=0) <= rows.closed:
                continue
            if depth.max() <= 2 * gap_of_chords(*contact.geometry.surfaces):
                continue
            at = rows.sides[1].reference.x[[int(depth.argmax())]]
            self._warn_once(
                ("fixed", c),
                f"contact {c}: both surfaces are prescribed around {spot(at)} of the meshes, "
                f"where they overlap by {depth.max():.3g}: no pressure can part them there; "
                "prescribe one of them only, or other displacements.",
            )

    def _warn_of_cells(self, comm):
        """Warn, once for each body, of cells that its displacements turn over. Collective."""
        follow = zip(self._contacts, self._rows, strict=True)
        moved = {b for contact, rows in follow if contact.geometry.follows for b in rows.bodies}
        for b in sorted(moved & set(range(self._num_elastic))):
            if ("over", b) in self._told:
                continue
            u = self._moving[b].own_function(self._u[b])
            places = [x for part in comm.allgather(turned_over(u, self._cells[b])) for x in part]
            if places:
                self._warn_once(
                    ("over", b),
                    f"{self._names[b]}: the displacements turn cells over, the first around "
                    f"{spot(places[0][None])} of its mesh, unseen by the residual: strains are 1 "
                    "and more there, and results wrong; press less, take a law that resists "
                    "compression (ln J), refine, or round sharp corners.",
                )

    def _turning(self) -> list[tuple[str, float, str]]:
        """The same, and contacts with small sliding."""
        words = (
            'but with sliding="small" normals are those of the meshes: forces are wrong by about '
            'that angle; take sliding="finite".'
        )
        return super()._turning() + [
            (f"contact {c}", max(map(MovingSurface.turns, rows.sides, rows.u)), words)
            for c, rows in enumerate(self._rows)
            if not self._contacts[c].geometry.follows
        ]

    def _warn_of_overlap(self):
        """Warn, once for each contact, of meshes that overlap by much of a body's thickness."""
        for c, (contact, rows) in enumerate(zip(self._contacts, self._rows, strict=True)):
            depth = contact.geometry.depth
            if None not in rows.bodies and rows.overlap > depth / 2:  # obstacles have moved before
                share = rows.overlap * BEHIND_BODY / depth
                self._warn_once(
                    ("start", c),
                    f"contact {c}: the bodies overlap by {rows.overlap:.3g} before the first load "
                    f"step, {share:.0%} of the thinner one's thickness; contact pushes that out, "
                    "as a press-fit: if it isn't meant, check positions, units and u.",
                )

    def _warn_of_reach(self, comm):
        """Warn of surfaces with nothing opposite."""
        for c, (contact, rows) in enumerate(zip(self._contacts, self._rows, strict=True)):
            if comm.rank == 0 and not (rows.m > 0).any():
                x0, x1 = (spot(surface.x) for surface in contact.surfaces)
                LOG.warning(
                    f"contact {c}: nothing of Γ1 (around {x1}) lies opposite Γ0 (around {x0}) yet; "
                    "are these the right facets, on the right sides of their bodies?"
                )


def _displacements(i: int, V: fem.FunctionSpace, contacts: Sequence[Contact]) -> Component:
    """Displacements of a body among its fields. Collective.

    They are those in contact; without a contact, the first vector of a mixed space.
    """
    given = [part for one in contacts for part in one.components if V.contains(part.given)]
    if any(not given[0].same(other) for other in given):
        raise ValueError(f"contacts are on different components of body {i}; take one of them.")
    if given or not is_mixed(V):
        return given[0] if given else Component.of(V)
    vectors = [p for p in lagrange_components(V) if p.space.value_shape == (V.mesh.geometry.dim,)]
    if not vectors:
        raise ValueError(
            f"body {i} has no displacements among the components of its space; make a vector in "
            f"{V.mesh.geometry.dim} dimensions one of them."
        )
    return vectors[0]


def _check_rigid(
    rigid: dict[int, RigidBodyMotion],
    u: Sequence[fem.Function],
    contacts: Sequence[Contact],
    ties: Sequence[Tie],
    bcs: Sequence[fem.DirichletBC],
):
    """Raise if rigid bodies don't fit to what else is given."""
    if len(set(map(id, rigid.values()))) < len(rigid):
        raise ValueError("a rigid body is given twice; make one for each body.")
    for i, body in rigid.items():
        if u[i] is not body.u:
            raise ValueError(f"u[{i}] isn't the u of the rigid body in F[{i}]; give that.")
        V = body.u.function_space
        t = next((t for t, tie in enumerate(ties) if V in tie.spaces), None)
        if t is not None:
            raise ValueError(
                f"tie {t} is on body {i}, a rigid one, which can't be tied: give it contact with "
                "friction, or a stiff body in its place."
            )
        if fem.bcs_by_block([V._cpp_object], [b for b in bcs if isinstance(b, fem.DirichletBC)])[0]:
            raise ValueError(
                f"a boundary condition is on body {i}, a rigid one: hold it by held= and "
                "prescribed instead."
            )
        swept = any(one.axisymmetric and V in one.spaces for one in contacts)
        if swept and not body.held[[0, 2]].all():
            raise ValueError(
                f"body {i} is rigid and axisymmetric: it can move along the axis only; make it "
                'with held=("x", "rotation").'
            )


def _check_apart(contacts: Sequence[Contact], ties: Sequence[Tie]):
    """Raise if the same facets of two bodies are given twice. Collective."""
    given: list[tuple[str, Contact | Tie]] = [
        (f"contact {c}", one) for c, one in enumerate(contacts)
    ]
    given += [(f"tie {t}", tie) for t, tie in enumerate(ties)]
    for (name, one), (other_name, other) in combinations(given, 2):
        if isinstance(one, Tie):
            continue
        comm, twice = one.spaces[0].mesh.comm, False
        for order in ((0, 1), (1, 0)):
            shared = [_share(one, i, other, j) for i, j in enumerate(order)]
            twice |= bool(np.any(comm.allgather(shared), axis=0).all())
        if twice:
            raise InterfaceError(
                f"{name} and {other_name} have facets of Γ0 and of Γ1 in common; give the facets "
                "of two bodies to one of them."
            )


def _share(one: Contact | Tie, i: int, other: Contact | Tie, j: int) -> bool:
    """True if two sides of one field have common facets on this rank."""
    same = one.components[i].overlaps(other.components[j])
    return same and bool(np.isin(one.facets[i], other.facets[j]).any())
