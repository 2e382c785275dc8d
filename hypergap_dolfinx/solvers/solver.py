# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What a solver of the saddle system is, to those who call it; it knows itself how it solves.

PETSc options of a solver.

The saddle system factorised as a whole, by default with MUMPS.
"""

import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

from petsc4py import PETSc

from dolfinx import fem
from hypergap_dolfinx.algebra import saddle
from hypergap_dolfinx.algebra.blocks import ConstraintBlocks
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.solvers.tolerances import UNKNOWN_TYPE
from hypergap_dolfinx.surface.trace import is_mixed


def prefixed(prefix: str, options: dict[str, Any]) -> dict[str, Any]:
    """Options of what a solver consists of."""
    return {prefix + key: value for key, value in options.items()}


def names_types(options: dict | None) -> bool:
    """Whether PETSc options say how to solve, and not only how exactly."""
    return bool({"ksp_type", "pc_type"} & set(options or {}))


class Options:
    """PETSc options that are in its database only while they are needed."""

    def __init__(self, prefix: str, options: dict[str, Any], defaults: dict[str, Any], unfit: str):
        """Choose them: given ones, the command line's, defaults, in this order.

        Args:
            prefix: Of PETSc's objects.
            options: The user's.
            defaults: Those of the solver.
            unfit: What is said of options that PETSc can't solve with.

        Raises:
            ValueError: No prefix.
        """
        if not prefix:
            raise ValueError("the PETSc options prefix cannot be empty.")
        given = PETSc.Options().getAll()
        free = {key: value for key, value in defaults.items() if prefix + key not in given}
        self._options = {prefix + key: value for key, value in {**free, **options}.items()}
        self._unfit = unfit

    @contextmanager
    def in_use(self) -> Iterator[None]:
        """Put them into the database: MUMPS reads its own when it is called.

        Raises:
            SolveError: PETSc can't solve with these options.
        """
        database = PETSc.Options()
        before = database.getAll()
        for key, value in self._options.items():
            database[key] = value
        try:
            yield
        except PETSc.Error as error:
            cause = error.__cause__
            if cause is not None and not isinstance(cause, PETSc.Error):
                raise cause from None  # of Python that PETSc called; old PETSc raises it itself
            reason = str(error).strip().splitlines()[-1].removeprefix("[0] ")
            raise SolveError(
                f"PETSc can't solve with these options: {reason} (code {error.ierr})."
                + self._unfit * (error.ierr != UNKNOWN_TYPE)
            ) from error
        finally:
            for key in self._options:
                del database[key]
                if key in before:
                    database[key] = before[key]


PRESSURE = (
    "; in mixed spaces a pressure that is known up to a constant only makes a matrix singular too: "
    "hold it at a node"
)


@dataclass(frozen=True)
class System:
    """[K Bᵀ; B 0] and what it is made of."""

    A: PETSc.Mat
    """The nested matrix. Its state tells whether K has changed."""
    K: Sequence[PETSc.Mat]
    """Stiffness of each body; has no values before the first :meth:`Solver.update`."""
    constraints: ConstraintBlocks
    """B."""
    spaces: Sequence[fem.FunctionSpace]
    """Space of each body."""


class Solver(ABC):
    """Solves the saddle system, for one right-hand side after the other. All is collective.

    Call :meth:`update` when K has values, or others; then :meth:`solve`, and look at
    :meth:`failure`. What a user asks for that can't be is a SolveError at once.
    """

    options: Options
    """PETSc's, for calls of PETSc from outside."""

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
        """Take the values of K as they are now; does nothing if they are the same."""

    @abstractmethod
    def solve(self, b: PETSc.Vec, x: PETSc.Vec):
        """Solve with A as it is now; what is costly to make is that of the last update.

        Args:
            b: The right-hand side, nested.
            x: Takes the solution.
        """

    @abstractmethod
    def failure(self) -> str | None:
        """What went wrong in the last solve, in one line, such that another solver may help."""

    @abstractmethod
    def destroy(self):
        """Destroy the PETSc objects."""

    def as_ksp(self, prefix: str) -> PETSc.KSP:
        """A KSP for a SNES: it updates when SNES rebuilds its preconditioner, and solves.

        Args:
            prefix: Of its options, which nobody needs.
        """
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
    """A solver with one KSP that takes PETSc options; the base of all that a user can name."""

    name: ClassVar[str]
    """What a user calls it."""
    OPTIONS: ClassVar[dict[str, Any]]
    """PETSc options of the KSP, and of what it consists of."""
    ADVICE: ClassVar[str] = ""
    """What to do where it fails."""
    UNFIT: ClassVar[str] = ""
    """What is said of options that PETSc can't solve with."""
    REPLACEABLE: ClassVar[bool] = False
    """Whether a type of KSP or PC among the user's options takes the place of all defaults."""

    def __init__(self, system: System, prefix: str, options: dict | None = None):
        """Create the KSP and set its options; K needs no values yet. Collective.

        Args:
            system: What is to be solved.
            prefix: Of all PETSc options.
            options: The user's, over the defaults and the command line's.
        """
        replaced = self.REPLACEABLE and names_types(options)
        defaults = {} if replaced else self.defaults(system)
        self.options = Options(prefix, options or {}, defaults, self.UNFIT)
        self._system, self._prefix = system, prefix
        self._state: int | None = None  # of A, at the last update
        self._ksp = PETSc.KSP().create(system.A.comm)
        self._ksp.setOperators(system.A)
        self._ksp.setOptionsPrefix(prefix)
        system.A.setOptionsPrefix(f"{prefix}A_")
        with self.options.in_use():
            self._ksp.setFromOptions()

    @classmethod
    def why_not(cls, system: System) -> str | None:
        """What keeps the system from being solved like this, or None. Collective."""
        return None

    @classmethod
    def defaults(cls, system: System) -> dict[str, Any]:
        """The options where the user has none."""
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
        """Take the values of K as they are now. Collective."""
        state = self._system.A.stateGet()
        if state != self._state:
            with self.options.in_use():
                self._update()
            self._state = state

    def solve(self, b: PETSc.Vec, x: PETSc.Vec):
        """Solve with A as it is now. Collective."""
        with self.options.in_use():
            self._solve(b, x)

    def failure(self) -> str | None:
        """What went wrong in the last solve. Collective."""
        return saddle.failure(self._ksp, self._advice())

    def _advice(self) -> str:
        """What a message on a failure says to do."""
        return self.ADVICE + (PRESSURE if any(map(is_mixed, self._system.spaces)) else "")

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        self.retire().destroy()

    def retire(self) -> PETSc.KSP:
        """Destroy all but the KSP, which a user may hold. Collective."""
        return self._ksp

    @abstractmethod
    def _update(self):
        """Take the values of K, with the options in PETSc's database."""

    @abstractmethod
    def _solve(self, b: PETSc.Vec, x: PETSc.Vec):
        """Solve, with the options in PETSc's database."""


class Substitute(ABC):
    """A system in the place of the saddle system, which a KSP can iterate on. All is collective."""

    iterations = 0
    """Number of iterations of the last solve."""

    @abstractmethod
    def update(self, ksp: PETSc.KSP) -> bool:
        """Give a KSP what it is to solve, with the values that K has now.

        Returns:
            Whether that was possible; if not, the system is to be made anew.
        """

    @abstractmethod
    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec):
        """Solve for nested vectors of the saddle system, with K's values of now in its operator.

        Args:
            ksp: The KSP, with what the last :meth:`update` made as its preconditioner.
            b: The right-hand side.
            x: Takes the solution.
        """

    @abstractmethod
    def destroy(self):
        """Destroy the PETSc objects."""


class IterativeSolver(KSPSolver):
    """A solver whose KSP iterates on another system than the one it stands for."""

    _substitute: Substitute | None = None
    _failure: str | None = None

    @abstractmethod
    def _create(self) -> Substitute:
        """The system that is iterated on, for the values that K has now. Collective."""

    def _update(self):
        if self._substitute is not None and not self._substitute.update(self._ksp):
            self._substitute.destroy()
            self._substitute = None
        if self._substitute is None:
            self._substitute = self._create()
            self._substitute.update(self._ksp)

    def _solve(self, b: PETSc.Vec, x: PETSc.Vec):
        assert self._substitute is not None, "update() comes first"
        # Its blocks are K itself: if SNES lags, the preconditioner is of then, the system of now
        self._substitute.solve(self._ksp, b, x)
        self._failure = saddle.failure(self._ksp, self._advice())
        if self._failure is None:
            error = saddle.backward_error(self._system.A, x, b)
            if not error <= saddle.BACKWARD:  # or no number
                self._failure = (
                    f'the linear solve with solver="{self.name}" ended, but misses the system by '
                    f'{error:.0e} of its terms; take solver="direct".'
                )

    def failure(self) -> str | None:
        """What went wrong in the last solve, also if the iteration itself converged."""
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
        "ksp_type": "richardson",  # the factors, and a step of refinement for the digits they lose
        "ksp_norm_type": "none",
        "ksp_max_it": 2,
        "pc_type": "lu",
        "pc_factor_mat_solver_type": "mumps",
        "mat_mumps_icntl_14": 100,  # 20 % of workspace to spare is too little for saddle systems
    }
    UNFIT = (
        " The matrix is a MatNest with a block of zeros; "
        'pc_type "lu" (MUMPS) and "fieldsplit" take it.'
    )
    REPLACEABLE = True

    @classmethod
    def defaults(cls, system: System) -> dict[str, Any]:
        """The options where the user has none; the best ordering depends on the dimension."""
        plane = system.spaces[0].mesh.topology.dim == 2
        return {**cls.OPTIONS, **PLANE} if plane else cls.OPTIONS

    def _update(self):
        """The KSP sees itself that A has changed."""

    def _solve(self, b: PETSc.Vec, x: PETSc.Vec):
        saddle.solve(self._ksp, b, x)

    def as_ksp(self, prefix: str) -> PETSc.KSP:
        """The KSP itself is one for a SNES: all of SNES's options for its KSP hold."""
        return self._ksp


class DirectStep(Direct):
    """The same for Newton's steps, of which the next one refines."""

    OPTIONS = {  # noqa: RUF012
        **{key: value for key, value in Direct.OPTIONS.items() if not key.startswith("ksp_")},
        "ksp_type": "preonly",
    }
