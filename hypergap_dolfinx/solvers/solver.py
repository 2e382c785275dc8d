# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Solvers of the saddle-point system: their interface, their PETSc options, and the direct one."""

import logging
import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from hypergap_dolfinx.algebra import saddle
from hypergap_dolfinx.algebra.blocks import ConstraintBlocks
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.solvers.tolerances import REFINED
from hypergap_dolfinx.surface.trace import is_mixed

LOG = logging.getLogger("hypergap_dolfinx")


def prefixed(prefix: str, options: dict[str, Any]) -> dict[str, Any]:
    """Options of a part of a solver, by its prefix."""
    return {prefix + key: value for key, value in options.items()}


def names_types(options: dict | None) -> bool:
    """True if PETSc options name a type of solver, not only tolerances.

    Raises:
        ValueError: Options that are no dictionary.
    """
    if not isinstance(options, dict | None):
        raise ValueError(
            f'petsc_options is a dictionary such as {{"ksp_rtol": 1e-9}}, not {options!r}.'
        )
    return bool({"ksp_type", "pc_type"} & set(options or {}))


class Options:
    """PETSc options that are in its database only while they are needed."""

    def __init__(self, prefix: str, options: dict[str, Any], defaults: dict[str, Any], unfit: str):
        """Choose them: given ones, the command line's, defaults, in this order.

        Args:
            prefix: Prefix of PETSc's objects.
            options: The user's.
            defaults: The solver's.
            unfit: End of the message if PETSc can't solve with them.

        Raises:
            ValueError: The prefix doesn't end with ``_``.
        """
        if not prefix.endswith("_"):
            raise ValueError(f"petsc_options_prefix is {prefix!r}; let it end with _.")
        given = PETSc.Options().getAll()
        free = {key: value for key, value in defaults.items() if prefix + key not in given}
        self._options = {prefix + key: value for key, value in {**free, **options}.items()}
        self._unused = {prefix + key for key in options}
        self._unfit = unfit

    def tell_unused(self, comm):
        """Warn once, after a solve, of options that PETSc hasn't used."""
        if self._unused and comm.rank == 0:
            names = ", ".join(sorted(self._unused))
            LOG.warning("PETSc asked for none of these options: %s; are they misspelt?", names)
        self._unused = set()

    @contextmanager
    def in_use(self, reads: bool = True) -> Iterator[None]:
        """Put them into the database: MUMPS reads its own when it factorises.

        Args:
            reads: False if PETSc reads none: they aren't put there.

        Raises:
            SolveError: PETSc can't solve with these options.
        """
        database = PETSc.Options()
        before, now = (database.getAll(), self._options) if reads else ({}, {})
        for key, value in now.items():
            database[key] = value
        try:
            yield
        except PETSc.Error as error:
            cause = error.__cause__
            if cause is not None and not isinstance(cause, PETSc.Error):
                raise cause from None  # of Python that PETSc called; old PETSc raises it itself
            of_others = 76, 86  # PETSC_ERR_LIB, PETSC_ERR_UNKNOWN_TYPE
            reason = str(error).strip().splitlines()[-1].removeprefix("[0] ")
            raise SolveError(
                f"PETSc can't solve with these options: {reason} (code {error.ierr})."
                + self._unfit * (error.ierr not in of_others)
            ) from error
        finally:
            self._unused = {key for key in self._unused if not compat.is_used(database, key)}
            for key in now:
                del database[key]
                if key in before:
                    database[key] = before[key]


@dataclass(frozen=True)
class System:
    """[K Bᵀ; B −C] and its blocks."""

    A: PETSc.Mat
    """The nested matrix; its state changes with K."""
    K: Sequence[PETSc.Mat]
    """Stiffness of each body; has no values before the first :meth:`Solver.update`."""
    constraints: ConstraintBlocks
    """B and C."""
    spaces: Sequence[fem.FunctionSpace]
    """Space of each body."""


class Solver(ABC):
    """A solver of the saddle-point system for many right-hand sides. All methods are collective.

    Call :meth:`update` when K has new values; then :meth:`solve`, and check :meth:`failure`.
    Options that PETSc refuses raise a SolveError at once.
    """

    name: str
    """Its name for users."""
    options: Options
    """PETSc options, for calls of PETSc from outside."""

    @property
    @abstractmethod
    def ksp(self) -> PETSc.KSP:
        """The KSP."""

    @property
    @abstractmethod
    def iterations(self) -> int:
        """Number of iterations of the last solve."""

    @abstractmethod
    def update(self):
        """Update to the present values of K; does nothing if they are unchanged."""

    @abstractmethod
    def solve(self, b: PETSc.Vec, x: PETSc.Vec):
        """Solve with the present A; factors and preconditioners are those of the last update.

        Args:
            b: The right-hand side, nested.
            x: Takes the solution.
        """

    @abstractmethod
    def failure(self) -> str | None:
        """Failure of the last solve in one line, or None."""

    @abstractmethod
    def destroy(self):
        """Destroy the PETSc objects."""

    def as_ksp(self, prefix: str) -> PETSc.KSP:
        """A KSP for a SNES: it updates when SNES rebuilds its preconditioner, and solves."""
        shell = PETSc.KSP().create(self.ksp.comm)
        shell.setOptionsPrefix(prefix)
        shell.setType(PETSc.KSP.Type.PREONLY)
        shell.getPC().setType(PETSc.PC.Type.PYTHON)
        shell.getPC().setPythonContext(_Shell(self))
        return shell


class _Shell:
    """A solver as the context of a PCPYTHON."""

    def __init__(self, solver: Solver):
        self._solver = weakref.proxy(solver)  # PETSc's references are no garbage that Python finds

    def setUp(self, pc: PETSc.PC):
        """Not called while SNES keeps its preconditioner. Collective."""
        self._solver.update()

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec):
        """A failure is the KSP's too, so that SNES can count it. Collective."""
        self._solver.solve(b, x)
        if self._solver.failure():
            pc.setFailedReason(PETSc.PC.FailedReason.SUBPC_ERROR)


class KSPSolver(Solver):
    """Solver with one KSP that takes PETSc options; base class of all named solvers."""

    OPTIONS: ClassVar[dict[str, Any]]
    """PETSc options of the KSP and of its parts."""
    ADVICE: ClassVar[str] = ""
    """End of the message if it fails."""
    UNFIT: ClassVar[str] = ""
    """End of the message if PETSc can't solve with the options."""
    REPLACEABLE: ClassVar[bool] = False
    """True if a type of KSP or PC among the user's options replaces all defaults."""

    def __init__(self, system: System, prefix: str, options: dict | None = None):
        """Create the KSP and set its options; K needs no values yet. Collective.

        Args:
            system: The system.
            prefix: Prefix of all PETSc options.
            options: The user's, over the defaults and the command line's.
        """
        replaced = self.REPLACEABLE and names_types(options)
        defaults = {} if replaced else self.defaults(system)
        self.options = Options(prefix, options or {}, defaults, self.UNFIT)
        self._system, self._prefix = system, prefix
        self._state: int | None = None  # of A, at the last update
        self._errors = saddle.Errors(system.A, len(system.constraints.full))
        self._ksp = PETSc.KSP().create(system.A.comm)
        self._ksp.setOperators(system.A)
        self._ksp.setOptionsPrefix(prefix)
        system.A.setOptionsPrefix(f"{prefix}A_")
        with self.options.in_use():
            self._ksp.setFromOptions()

    @classmethod
    def why_not(cls, system: System) -> str | None:
        """Reason why the system can't be solved like this, or None. Collective."""
        return None

    @classmethod
    def defaults(cls, system: System) -> dict[str, Any]:
        """Default options."""
        return cls.OPTIONS

    @property
    def ksp(self) -> PETSc.KSP:
        """The KSP."""
        return self._ksp

    @property
    def iterations(self) -> int:
        """Number of iterations of the last solve."""
        return self._ksp.getIterationNumber()

    def update(self):
        """Update to the present values of K. Collective."""
        state = self._system.A.stateGet()
        if state != self._state:
            with self.options.in_use():
                self._update()
            self._state = state

    def solve(self, b: PETSc.Vec, x: PETSc.Vec):
        """Solve with the present A. Collective."""
        with self.options.in_use(self._reads()):
            self._solve(b, x)

    def _reads(self) -> bool:
        """True if PETSc may read options in a solve."""
        return True

    def failure(self) -> str | None:
        """Failure of the last solve, or None. Collective."""
        same_units = not any(map(is_mixed, self._system.spaces))
        return saddle.failure(self._ksp, self._advice(), self._errors, same_units=same_units)

    def _advice(self) -> str:
        """End of the message on a failure."""
        if self._ksp.getPC().getType() == "fieldsplit":
            return (
                "; give each split a solver of its own (fieldsplit_0_pc_type …): by default one is "
                "for the block of zeros, too"
            )
        if not any(map(is_mixed, self._system.spaces)):
            return self.ADVICE
        return (
            f"{self.ADVICE}; in mixed spaces a pressure that is known up to a constant only makes "
            "a matrix singular too: hold it at a node"
        )

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        self.retire().destroy()

    def retire(self) -> PETSc.KSP:
        """Destroy everything except the KSP, which a user may hold. Collective."""
        return self._ksp

    @abstractmethod
    def _update(self):
        """Update to the values of K, with the options in PETSc's database."""

    @abstractmethod
    def _solve(self, b: PETSc.Vec, x: PETSc.Vec):
        """Solve, with the options in PETSc's database."""


class Substitute(ABC):
    """System for a KSP in place of the saddle-point system. All methods are collective."""

    iterations = 0
    """Number of iterations of the last solve."""

    @abstractmethod
    def update(self, ksp: PETSc.KSP) -> bool:
        """Set a KSP's operators for the present K; False if the system is to be made anew."""

    @abstractmethod
    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec):
        """Solve for nested vectors with the present K, and the last update's preconditioner."""

    @abstractmethod
    def destroy(self):
        """Destroy the PETSc objects."""


class IterativeSolver(KSPSolver):
    """Solver whose KSP iterates on a substitute of the saddle-point system."""

    _substitute: Substitute | None = None
    _failure: str | None = None

    @classmethod
    def why_not(cls, system: System) -> str | None:
        """Reason why the system can't be solved like this, or None. Collective."""
        constraints = system.constraints
        reasons = {
            "free interior nodes belong to no body": constraints.interior_sizes,
            "a tie has a compliance": constraints.compliances,
            "a coupling's point has no stiffness": constraints.couplings,
            "a tie has a law or a conductance": constraints.jump_fields,
            "a space is mixed: a body may be singular by itself (a pressure is free)": any(
                map(is_mixed, system.spaces)
            ),
        }
        return next((reason for reason, applies in reasons.items() if applies), None)

    @abstractmethod
    def _create(self) -> Substitute:
        """The system that is iterated on, for the present values of K. Collective."""

    def _update(self):
        if self._substitute is not None and not self._substitute.update(self._ksp):
            self._substitute.destroy()
            self._substitute = None
        if self._substitute is None:
            self._substitute = self._create()
            self._substitute.update(self._ksp)

    def _solve(self, b: PETSc.Vec, x: PETSc.Vec):
        assert self._substitute is not None, "update() comes first"
        # Its blocks are K itself: if SNES lags, only the preconditioner is an older one
        self._substitute.solve(self._ksp, b, x)
        self._failure = saddle.failure(self._ksp, self._advice())
        if self._failure is None:
            error = self._errors.backward(x, b)
            if not error <= saddle.BACKWARD:  # or no number
                self._failure = (
                    f'the linear solve with solver="{self.name}" ended, but misses the system by '
                    f'{error:.0e} of its terms; take solver="direct".'
                )

    def failure(self) -> str | None:
        """Failure of the last solve, or None; may fail though the iteration converged."""
        return self._failure

    @property
    def iterations(self) -> int:
        """Number of iterations of the last solve."""
        return self._substitute.iterations if self._substitute is not None else 0

    def retire(self) -> PETSc.KSP:
        """Destroy all but the KSP. Collective."""
        if self._substitute is not None:
            self._substitute.destroy()
            self._substitute = None
        return super().retire()


PLANE = {"mat_mumps_icntl_7": 2}
"""In the plane MUMPS orders by approximate minimum fill: in all a third to a half less time than
with METIS, for bodies tied or not, from 10 000 to 500 000 displacements and degrees 1 to 3."""


class Direct(KSPSolver):
    """``"direct"``: MUMPS's LU of the whole; or any KSP that takes a MatNest.

    LDLᵀ would need 2 × 2 pivots for the zero block.
    """

    name = "direct"
    OPTIONS = {  # noqa: RUF012
        "ksp_type": "richardson",  # the factors, and steps of refinement where they lose digits
        "ksp_norm_type": "none",
        "ksp_max_it": 5,
        "pc_type": "lu",
        "pc_factor_mat_solver_type": "mumps",
        "mat_mumps_cntl_1": 0.1,  # pivots: with 0.01 twice as many solutions need refinement
        "mat_mumps_icntl_14": 100,  # 20 % more workspace is too little for saddle points
    }
    UNFIT = (
        " The matrix is a MatNest with a block of zeros; "
        'pc_type "lu" (MUMPS) takes it, and "fieldsplit" with a solver for each split.'
    )
    REPLACEABLE = True
    _factorised: int | None = None  # state of A
    _steps = 0

    @classmethod
    def defaults(cls, system: System) -> dict[str, Any]:
        """Default options; the best ordering depends on the dimension."""
        plane = system.spaces[0].mesh.topology.dim == 2
        return {**cls.OPTIONS, **PLANE} if plane else cls.OPTIONS

    def _update(self):
        """Nothing to do: the KSP checks the state of A."""

    def _reads(self) -> bool:
        """True if the KSP factorises first."""
        return self._system.A.stateGet() != self._factorised

    @property
    def iterations(self) -> int:
        """Number of iterations of the last solve, with those that refine."""
        return self._steps

    def _solve(self, b: PETSc.Vec, x: PETSc.Vec):
        ksp, self._errors.norms, self._factorised = self._ksp, None, None
        kind = ksp.getType(), ksp.getPC().getType(), ksp.getNormType()
        refines = kind == ("richardson", "lu", PETSc.KSP.NormType.NONE)
        most, guess = ksp.max_it, ksp.getInitialGuessNonzero()
        if refines:  # one by one, since PETSc computes a residual of its own before another one
            ksp.max_it = min(most, 1)
            ksp.setInitialGuessNonzero(False)  # a poor one would only cost digits
        try:
            saddle.solve(ksp, b, x)
            self._steps = ksp.getIterationNumber()
            if ksp.getConvergedReason() > 0:
                self._factorised = self._system.A.stateGet()
                if refines:
                    self._refine(b, x, most)
        finally:
            ksp.max_it = most
            ksp.setInitialGuessNonzero(guess)

    def _refine(self, b: PETSc.Vec, x: PETSc.Vec, most: int):
        """Refine a solution until its error is round-off, or stays as it is. Collective."""
        last, error = np.inf, self._errors.backward(x, b)
        while REFINED < error < last / 2 and self._steps < most:
            self._ksp.setInitialGuessNonzero(True)
            self._ksp.solve(b, x)
            self._steps += 1
            last, error = error, self._errors.backward(x, b)

    def as_ksp(self, prefix: str) -> PETSc.KSP:
        """The KSP itself is one for a SNES: all of SNES's options for its KSP hold."""
        return self._ksp


class DirectStep(Direct):
    """``"direct"`` for Newton's steps, without refinement: the next step refines."""

    OPTIONS = {  # noqa: RUF012
        **{key: value for key, value in Direct.OPTIONS.items() if not key.startswith("ksp_")},
        "ksp_type": "preonly",
    }
