# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Choice of the solver: by name, or by the system if none is named."""

from petsc4py import PETSc

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
from hypergap_dolfinx.solvers.tolerances import LARGE_SYSTEM

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
        first = default(system)
        if first is Direct:
            return Direct(system, prefix, options)
        return FallingBack(system, first, prefix, options)
    if solver not in SOLVERS:
        raise ValueError(f"solver is one of {', '.join(SOLVERS)}, not {solver!r}.")
    cls = SOLVERS[solver]
    reason = cls.why_not(system)
    if reason:
        raise ValueError(f'solver="{solver}" is not possible: {reason}; take "direct".')
    return (DirectStep if newton and cls is Direct else cls)(system, prefix, options)


def default(system: System) -> type[KSPSolver]:
    """The default solver. Collective.

    In the plane, and for small bodies, factors of the whole system cost no more than those of the
    parts and an iteration. In space they soon do: with 56 000 displacements of degree 2 the whole
    takes 1.4 × 10¹¹ operations, one fused mesh 0.95 × 10¹¹, the bodies 0.3 × 10¹¹.
    """
    size = sum(K.getSize()[0] for K in system.K)
    in_space = system.spaces[0].mesh.topology.dim == 3
    large = system.constraints.bodies and in_space and size >= LARGE_SYSTEM
    return Bodies if large and Bodies.why_not(system) is None else Direct


class FallingBack(Solver):
    """A solver that is replaced by ``"direct"`` for good if it fails: Γ1 is much the stiffer."""

    def __init__(self, system: System, first: type[KSPSolver], prefix: str, options: dict | None):
        """Create the first solver, for which alone the user's options are. Collective."""
        self._system, self._prefix = system, prefix
        self._solver: KSPSolver = first(system, prefix, options)
        self._given_up: PETSc.KSP | None = None

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

    def update(self):
        """Take the present values of K. Collective."""
        self._solver.update()

    def solve(self, b: PETSc.Vec, x: PETSc.Vec):
        """Solve, if need be directly. Collective."""
        self._solver.solve(b, x)
        if self._solver.failure() and self._given_up is None:
            self._given_up = self._solver.retire()
            self._solver = Direct(self._system, self._prefix)
            self._solver.update()
            self._solver.solve(b, x)

    def failure(self) -> str | None:
        """Failure of the last solve, or None. Collective."""
        return self._solver.failure()

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        self._solver.destroy()
        if self._given_up is not None:
            self._given_up.destroy()
