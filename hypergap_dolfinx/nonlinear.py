# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Nonlinear problems on tied bodies: counterpart of ``dolfinx.fem.petsc.NonlinearProblem``."""

import weakref
from collections.abc import Callable, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem
from hypergap_dolfinx.algebra import revolution
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.interface_laws.coupling import Coupling, motions_of
from hypergap_dolfinx.joining import Joined
from hypergap_dolfinx.solvers import choice
from hypergap_dolfinx.solvers.hooks import Hooks
from hypergap_dolfinx.solvers.newton import NonlinearSystem
from hypergap_dolfinx.tie import Tie


class NonlinearTiedProblem(NonlinearSystem):
    """Nonlinear problem F_i(u_i; v_i) = 0 on several tied bodies, for PETSc's SNES.

    Solves F_i(u_i) + Σ_t Bᵀ_ti λ_t = 0 and Σ_i B_ti u_i = 0. The ties are linear in the
    displacements, and exact for common rotations of any size.

    PETSc options can reuse costly parts of a Newton step in later steps and later calls of
    :meth:`solve`. Reuse of the Jacobian and its factors makes Newton steps cheap, but there are
    more of them, and load steps have to be small::

        petsc_options = {"snes_lag_jacobian": -2, "snes_lag_jacobian_persists": True}

    Reuse of the factors alone keeps the number of Newton steps, with more linear iterations in
    each, for ``solver="bodies"`` and ``"iterative"``; ``"direct"`` behaves as above::

        petsc_options = {"snes_lag_preconditioner": -2, "snes_lag_preconditioner_persists": True}

    −2 means once, n > 0 means every n-th step. A new problem starts afresh.

    Example:
        As in :class:`TiedProblem`'s example, with a conductivity of 1 + u²:

        >>> from hypergap_dolfinx import NonlinearTiedProblem
        >>> u, F = [fem.Function(W) for W in V], []
        >>> for f in u:
        ...     v = ufl.TestFunction(f.function_space)
        ...     F.append((1 + f**2) * ufl.inner(ufl.grad(f), ufl.grad(v)) * ufl.dx)
        >>> problem = NonlinearTiedProblem(F, u, bcs=bcs, ties=[tie])
        >>> u0, u1 = problem.solve()
        >>> q.integrate(q.evaluate(tie.traction(problem))).round(2)  # exact: 7/3
        array([2.33])
    """

    def __init__(
        self,
        F: Sequence[ufl.Form],
        u: Sequence[fem.Function],
        *,
        bcs: Sequence[fem.DirichletBC] = (),
        ties: Sequence[Tie] = (),
        couplings: Sequence[Coupling] = (),
        J: Sequence[ufl.Form] | None = None,
        solver: str | None = None,
        before_step: Callable[[], Any] | None = None,
        accepted: Callable[[float], Any] | None = None,
        taken_back: Callable[[], Any] | None = None,
        internal_variables: Sequence[fem.Function | fem.Constant] = (),
        petsc_options_prefix: str = "hypergap_",
        petsc_options: dict | None = None,
        form_compiler_options: dict | None = None,
        jit_options: dict | None = None,
    ):
        """Compile the forms and set up the SNES. Collective.

        Args:
            F: Residual form of each body.
            u: Solution function of each body, as used in F; its values are the initial guess.
            bcs: Dirichlet conditions of all bodies, in any order.
            ties: The ties.
            couplings: Couplings of surfaces with points.
            J: Jacobian form of each body; the derivative of F by default.
            solver: Solver of the Newton steps as for :class:`TiedProblem`; ``"direct"`` by default.
            before_step: Callback ``f()`` before each evaluation of the residual at new values of u,
                also in line searches, to update data of the forms such as stresses at quadrature
                points. If it raises a SolveError the solve ends.
            accepted: Callback ``f(1.0)`` after a successful solve, to update the history.
            taken_back: Callback ``f()`` after a failed solve.
            internal_variables: Functions and constants that these callbacks change. They are
                restored if a solve fails, and are part of :meth:`state`.
            petsc_options_prefix: Prefix of PETSc options, ending with ``_``.
            petsc_options: Options of the SNES, and of the solver as for :class:`TiedProblem`.
            form_compiler_options: Options of FFCx.
            jit_options: Options of the JIT compiler.

        Raises:
            ValueError: Different numbers of forms and functions; a tie or boundary condition on a
                space of no body; a solver that can't solve this problem.
            InterfaceError: Γ1 of a tie is prescribed on whole facets where Γ0 can move, and no
                multiplier is left to tie it there, see :class:`Tie`.
        """
        if any(isinstance(given, ufl.Form | fem.Function) for given in (F, u)):
            raise ValueError("F and u are lists, with one form and one function for each body.")
        ties = [ties] if isinstance(ties, Tie) else ties
        self._watch(bcs)
        bcs = [bcs] if isinstance(bcs, fem.DirichletBC) else list(bcs or ())
        coupled = motions_of(couplings)
        search = "snes_linesearch_type"
        given = f"{petsc_options_prefix}{search}" in PETSc.Options().getAll()
        turning = any(one.can_turn for one in coupled) and isinstance(petsc_options, dict | None)
        if turning and not given:  # residuals of rotations, of another unit, shorten good steps
            petsc_options = {search: "basic", **(petsc_options or {})}
        hooks = Hooks(
            internal_variables,
            unknowns=u,
            before_step=before_step,
            accepted=accepted,
            taken_back=taken_back,
        )
        super().__init__(
            F,
            u,
            bcs,
            Joined(ties),
            J=J,
            couplings=coupled,
            hooks=hooks,
            form_compiler_options=form_compiler_options,
            jit_options=jit_options,
        )
        self._solver = choice.create(
            self._system, solver, petsc_options_prefix, petsc_options, newton=True
        )
        revolution.tell(F, self._pieces.ties, "tie")
        revolution.tell_couplings(F, coupled)
        self._failed: BaseException | None = None
        self._num_tangents = 0
        self._snes = PETSc.SNES().create(self._A.comm)
        me = weakref.proxy(self)  # PETSc's references are no garbage that Python would find
        self._snes.setFunction(lambda snes, x, r: me._evaluated(x, r), self._b)
        self._snes.setJacobian(lambda snes, x, A, P: me._jacobian(x), self._A)
        self._snes.setOptionsPrefix(petsc_options_prefix)
        self._snes.setUpdate(lambda snes, step: me._interrupts.check())
        self._snes.setMonitor(lambda snes, step, norm: me._record(step, norm))
        self._snes.setKSP(self._solver.as_ksp(f"{petsc_options_prefix}step_"))
        with self._solver.options.in_use():
            self._snes.setFromOptions()
        self._made = True

    def _release(self) -> list:
        return [self.__dict__.pop("_snes", None), *super()._release()]

    def solve(self) -> list[fem.Function]:
        """Solve, with u and the multipliers of the last solve as the initial guess. Collective.

        Returns:
            The solution of each body, the same functions as in ``u``.

        Raises:
            SolveError: Newton's method or a linear solver failed; the message says how.
            KeyboardInterrupt: Ctrl-C, raised on all ranks at the end of the Newton step. u and the
                multipliers have their values from before the call.
        """
        self._check_usable()
        self._check_bcs()
        with self._interrupts:
            self._records.start(self._num_steps + 1)
            try:
                self._solve_step()
            except BaseException as error:
                self._records.end(str(error) or "interrupted", solved=False)
                raise
            self._num_steps += 1
            self._records.end(f"{self._snes.getIterationNumber()} Newton steps")
            self._interrupts.check()
        return self.u

    def _solve_step(self):
        """Solve for the present values. Collective."""
        self._warn_of_moved()
        self._read_couplings()
        self._check_prescribed()
        for u, x in zip(self._u, self._x.getNestSubVecs()):
            x.array[:] = u.x.array[: x.getLocalSize()]
        self._solved = False
        internal, self._failed = self._hooks.copies(), None
        if not self._motions_known:
            self._hooks("before_step")
            self.assemble_matrix()
            self._scales_fixed = True  # a residual that is compared with others keeps its units
            self._check_motions()
        self._constraints.read_jumps()
        self._constraints.compliances.update()  # the first residual comes before the first matrix
        of_ties = self._x.getNestSubVecs()[len(self._u) :]
        before = [part.array_r.copy() for part in of_ties]
        bodies = [u.x.array.copy() for u in self._u]
        try:
            with self._solver.options.in_use():
                self._snes.solve(None, self._x)
            failed, self._failed = self._failed, None
            if failed is not None:
                raise failed
            self._solver.options.tell_unused(self._A.comm)
            self._check_solved()
            if self._snes.getIterationNumber():
                self._check_constants()
            self._assign(self._x)
            self._take_couplings()
            self._constraints.check_coupled(self._lifted())
            self._hooks("accepted", 1.0)
            for one in self._couplings:
                one.commit()
        except BaseException as error:
            for part, values in zip(of_ties, before, strict=True):
                part.array[:] = values
            if not isinstance(error, SolveError):  # then users can reset u, and may look at it
                for u, array in zip(self._u, bodies, strict=True):
                    u.x.array[:] = array
            self._hooks.restore(internal)
            if isinstance(error, SolveError) or self._interrupts.agreed:
                self._hooks("taken_back")  # on all ranks
            raise
        self._solved = True
        self._warn_of_turns()

    def _check_first(self):
        """Raise if the first tangent, whose factors can be no older, is singular. Collective."""
        if self._num_tangents == 1 and not self._is_regular:
            if self._renew_couplings():  # they turn with each residual
                self._A.assemble()
            self._check_constants()
            self._check_regular(self._solver.ksp.getSolution())

    def _evaluated(self, x: PETSc.Vec, r: PETSc.Vec):
        """Evaluate the residual; exceptions are kept until PETSc's call, which locks x, ends."""
        if self._failed is None:
            try:
                return self._residual(x, r)
            except BaseException as error:
                self._failed = error
        for part in r.getNestSubVecs():
            part.set(np.nan)

    def _jacobian(self, x: PETSc.Vec):
        self._num_tangents += 1
        self._assign(x)
        try:
            self.assemble_matrix()
        except ValueError as error:
            step = self._snes.getIterationNumber()
            if not step:
                raise
            raise SolveError(
                f"Newton's iteration failed after {step} steps: {error} Displacements may have "
                "turned cells over; smaller load steps may help."
            ) from error

    def _record(self, step: int, norm: float):
        """Record a Newton step."""
        iterations = self._snes.getLinearSolveIterations()
        self._records.note(norm / (np.linalg.norm(self._forces) or 1), iterations, step=step)
        if step and self._failed is None:
            try:
                self._check_first()
            except BaseException as error:  # raised when PETSc's call ends
                self._failed = error

    def _check_solved(self):
        reason = self._snes.getConvergedReason()
        if reason > 0:
            return
        failure = None
        if reason == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
            failure = self._solver.failure()
        if failure:
            raise SolveError(failure)
        if self._snes.getLinearSolveIterations() and np.isfinite(self._snes.getFunctionNorm()):
            self._check_first()
            self._check_constants()  # an undetermined constant fails here
        names = {v: k for k, v in vars(PETSc.SNES.ConvergedReason).items() if isinstance(v, int)}
        raise SolveError(
            f"Newton's iteration failed after {self._snes.getIterationNumber()} steps: SNES "
            f"reason {reason} ({names.get(reason, 'unknown')}), residual "
            f"{self._snes.getFunctionNorm():.1e}; smaller load steps may help."
        )

    @property
    def iterations(self) -> int:
        """Number of Newton steps in the last :meth:`solve`."""
        return self._snes.getIterationNumber()

    @property
    def solver(self) -> PETSc.SNES:
        """The SNES."""
        return self._snes
