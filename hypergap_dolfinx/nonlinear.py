# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Nonlinear bodies, tied: the counterpart of ``dolfinx.fem.petsc.NonlinearProblem``."""

import weakref
from collections.abc import Callable, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem
from hypergap_dolfinx.algebra import revolution
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.joining import Joined
from hypergap_dolfinx.solvers import choice
from hypergap_dolfinx.solvers.hooks import Hooks
from hypergap_dolfinx.solvers.newton import NonlinearSystem
from hypergap_dolfinx.tie import Tie


class NonlinearTiedProblem(NonlinearSystem):
    """Nonlinear problem F_i(u_i; v_i) = 0 on several bodies, tied to each other, for PETSc's SNES.

    Solves F_i(u_i) + Σ_t Bᵀ_ti λ_t = 0 and Σ_i B_ti u_i = 0: the ties are linear in the
    displacements and hold whatever rotation the bodies make together.

    PETSc's own options keep costly parts of a step for later ones and later calls of :meth:`solve`.
    With the Jacobian, and so its factors, kept, Newton's steps are cheap, but there are more of
    them, and load steps are to be small::

        petsc_options = {"snes_lag_jacobian": -2, "snes_lag_jacobian_persists": True}

    With only the factors kept, ``solver="bodies"`` and ``"iterative"`` take as many of Newton's
    steps as before, with more iterations in each (``"direct"`` as many as with one Jacobian)::

        petsc_options = {"snes_lag_preconditioner": -2, "snes_lag_preconditioner_persists": True}

    Here −2 means once and never again, n > 0 in each n-th step. To begin anew, make a new problem.

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
            u: Solution function of each body, as used in F; its values are the first guess.
            bcs: Dirichlet conditions of any of the bodies.
            ties: The ties between them.
            J: Jacobian form of each body; F's derivative if not given.
            solver: Solver of Newton's steps as for :class:`TiedProblem`; default ``"direct"``.
            before_step: Function that is called before the residual is evaluated at new values of
                u, line searches included: to update what the forms read, as stresses at quadrature
                points. A SolveError in it ends the solve.
            accepted: Function that is called with 1.0 when a solve has succeeded: to move history
                on.
            taken_back: Function that is called when one has failed.
            internal_variables: Functions and constants that these hooks change: set back where a
                solve fails, part of :meth:`state`.
            petsc_options_prefix: Prefix of the PETSc objects' options, with ``_`` at its end.
            petsc_options: Options of the SNES, and of the solver as for :class:`TiedProblem`.
            form_compiler_options: Options of FFCx.
            jit_options: Options of the JIT compiler.

        Raises:
            ValueError: Numbers of forms and functions that differ; a tie or boundary condition on
                a space that belongs to no body; a solver that isn't possible.
            InterfaceError: Γ1 is prescribed on whole facets that Γ0 is to be tied to.
        """
        if any(isinstance(given, ufl.Form | fem.Function) for given in (F, u)):
            raise ValueError("F and u are lists, with one form and one function for each body.")
        ties = [ties] if isinstance(ties, Tie) else ties
        bcs = [bcs] if isinstance(bcs, fem.DirichletBC) else list(bcs or ())
        hooks = Hooks(
            internal_variables,
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
            hooks=hooks,
            form_compiler_options=form_compiler_options,
            jit_options=jit_options,
        )
        self._solver = choice.create(
            self._system, solver, petsc_options_prefix, petsc_options, newton=True
        )
        revolution.tell(F, self._pieces.ties, "tie")
        self._failed: BaseException | None = None
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

    def _release(self) -> list:
        return [self.__dict__.pop("_snes", None), *super()._release()]

    def solve(self) -> list[fem.Function]:
        """Solve, starting from u and the multipliers of the last solve. Collective.

        Returns:
            The solution of each body, the same functions as in ``u``.

        Raises:
            SolveError: The Newton iteration or a linear solve failed; says how.
            KeyboardInterrupt: Ctrl-C, on all ranks, at the end of the Newton step: u and the
                multipliers are what they were.
        """
        self._check_usable()
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
        return self._u

    def _solve_step(self):
        """Solve for the present values. Collective."""
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
            self._hooks("accepted", 1.0)
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

    def _evaluated(self, x: PETSc.Vec, r: PETSc.Vec):
        """Evaluate the residual; an exception waits for the end of PETSc's call, which locks x."""
        if self._failed is None:
            try:
                return self._residual(x, r)
            except BaseException as error:
                self._failed = error
        for part in r.getNestSubVecs():
            part.set(np.nan)

    def _record(self, step: int, norm: float):
        """Record a Newton step."""
        iterations = self._snes.getLinearSolveIterations()
        self._records.note(norm / (np.linalg.norm(self._forces) or 1), iterations, step=step)

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
            self._check_constants()  # an undetermined constant fails here
        names = {v: k for k, v in vars(PETSc.SNES.ConvergedReason).items() if isinstance(v, int)}
        raise SolveError(
            f"Newton's iteration failed after {self._snes.getIterationNumber()} steps: SNES "
            f"reason {reason} ({names.get(reason, 'unknown')}), residual "
            f"{self._snes.getFunctionNorm():.1e}; smaller load steps may help."
        )

    @property
    def solver(self) -> PETSc.SNES:
        """The SNES."""
        return self._snes
