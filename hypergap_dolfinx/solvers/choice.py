# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Choice of the solver: by name, or by the system if none is named."""

import logging

from petsc4py import PETSc

import numpy as np

from hypergap_dolfinx.algebra.checks import name_of_body
from hypergap_dolfinx.solvers.bodywise import Bodies
from hypergap_dolfinx.solvers.multigrid import Multigrid
from hypergap_dolfinx.solvers.solver import (
    Direct,
    DirectStep,
    KSPSolver,
    Solver,
    System,
    names_types,
)
from hypergap_dolfinx.solvers.tolerances import BUDGET, BUDGET_BODIES, LARGE_SYSTEM

LOG = logging.getLogger("hypergap_dolfinx")

SOLVERS: dict[str, type[KSPSolver]] = {cls.name: cls for cls in (Direct, Bodies, Multigrid)}
"""Solvers by their names for users."""


def create(
    system: System, solver: str | None, prefix: str, options: dict | None, *, newton: bool = False
) -> Solver:
    """The solver that a user names, or the one for the system if they name none. Collective.

    Args:
        system: The system; K needs no values yet.
        solver: One of :data:`SOLVERS`, or None.
        prefix: Prefix of all PETSc options.
        options: The user's PETSc options.
        newton: True if it solves for Newton's steps; the default is ``"direct"`` then.

    Raises:
        ValueError: An unknown name, or a solver that isn't possible for the system.
    """
    if solver is None and (newton or names_types(options)):
        solver = "direct"
    if solver is None:
        first, why = default(system)
        if system.A.comm.rank == 0:
            LOG.info('the default solver is "%s": %s', first.name, why)
        if issubclass(first, Direct):
            return Direct(system, prefix, options)
        return FallingBack(system, first, prefix, options)
    if solver not in SOLVERS:
        raise ValueError(f"solver is one of {', '.join(SOLVERS)}, not {solver!r}.")
    cls = SOLVERS[solver]
    reason = cls.why_not(system)
    if reason:
        raise ValueError(f'solver="{solver}" is not possible: {reason}; take "direct".')
    return (DirectStep if newton and cls is Direct else cls)(system, prefix, options)


class BudgetedBodies(Bodies):
    """``"bodies"`` as a default."""

    OPTIONS = {**Bodies.OPTIONS, "ksp_max_it": BUDGET_BODIES}  # noqa: RUF012

    @classmethod
    def why_not(cls, system: System) -> str | None:
        """Reason why not, or None: multigrid for bodies that Γ0 alone holds. Collective."""
        reason = super().why_not(system)
        if reason:
            return reason
        constraints, spaces = system.constraints, system.spaces
        held = [mask.any() for mask in constraints.prescribed]
        held = spaces[0].mesh.comm.allreduce(np.array(held, dtype=int))
        held[[i1 for _, i1 in constraints.bodies]] = 1
        if held.all():
            return None
        body = int(held.argmin())
        name = name_of_body(body, spaces[body])
        return f"{name} has neither Γ1 nor prescribed values"


class BudgetedMultigrid(Multigrid):
    """Multigrid that takes no more iterations than factors would be worth."""

    OPTIONS = {**Multigrid.OPTIONS, "ksp_max_it": BUDGET}  # noqa: RUF012


Budgeted = BudgetedBodies | BudgetedMultigrid
"""A solver that is one by default."""


def default(system: System) -> tuple[type[Direct] | type[Budgeted], str]:
    """The default solver, and the reason. Collective.

    In the plane, and for small bodies, factors of the whole system cost no more than those of the
    parts and an iteration. Where the bodies aren't for an iteration, multigrid may be.
    """
    size = sum(K.getSize()[0] for K in system.K)
    if not system.constraints.bodies:
        return Direct, "nothing is tied"
    if system.spaces[0].mesh.topology.dim < 3:
        return Direct, "bodies are in the plane"
    if size < LARGE_SYSTEM:
        return Direct, f"{size} unknowns in space, fewer than {LARGE_SYSTEM}"
    reasons = [f"{size} unknowns in space"]
    cls: type[Budgeted]
    for cls in (BudgetedBodies, BudgetedMultigrid):
        reason = cls.why_not(system)
        if reason is None:
            return cls, "; ".join(reasons)
        reasons.append(f'not "{cls.name}", {reason}')
    return Direct, "; ".join(reasons)


class FallingBack(Solver):
    """A solver that is replaced by ``"direct"`` for good, if it fails or factors are cheaper.

    Both have a number of iterations for each matrix, their KSP's largest one, be it one solve that
    converges slowly, or the steps of a time loop.
    """

    def __init__(self, system: System, first: type[Budgeted], prefix: str, options: dict | None):
        """Create the first solver, for which alone the user's options are. Collective."""
        self._system, self._prefix = system, prefix
        self._solver: KSPSolver = first(system, prefix, options)
        self._given_up: PETSc.KSP | None = None
        self._state, self._spent = -1, 0  # iterations with A of this state

    @property
    def options(self):
        """PETSc options of the one that is in use."""
        return self._solver.options

    @property
    def ksp(self) -> PETSc.KSP:
        """The KSP of the one that is in use."""
        return self._solver.ksp

    @property
    def iterations(self) -> int:
        """Number of iterations of the last solve."""
        return self._solver.iterations

    @property
    def name(self):
        """The name of the one that is in use."""
        return self._solver.name

    def update(self):
        """Take the present values of K, or make factors if those are cheaper. Collective."""
        state = self._system.A.stateGet()
        if state != self._state:
            self._state, self._spent = state, 0
        if self._given_up is None and self._spent >= self._solver.ksp.max_it:
            self._fall_back(f"{self._spent} iterations with one matrix cost as much as its factors")
        self._solver.update()

    def solve(self, b: PETSc.Vec, x: PETSc.Vec):
        """Solve, if need be directly. Collective."""
        self._solver.solve(b, x)
        self._spent += self._solver.iterations
        failure = self._solver.failure()
        if failure and self._given_up is None:
            self._fall_back(failure.partition(";")[0].removesuffix("."))
            self._solver.update()
            self._solver.solve(b, x)

    def _fall_back(self, reason: str):
        """Solve directly from now on. Collective."""
        if self._system.A.comm.rank == 0:
            LOG.warning(
                'the default solver, "%s", is given up for "direct": %s; name solver="direct" to '
                "save that.",
                self.name,
                reason,
            )
        self._given_up = self._solver.retire()
        self._solver = Direct(self._system, self._prefix)

    def failure(self) -> str | None:
        """Failure of the last solve, or None. Collective."""
        return self._solver.failure()

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        self._solver.destroy()
        if self._given_up is not None:
            self._given_up.destroy()
