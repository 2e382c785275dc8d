# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The saddle system factorised as a whole, by default with MUMPS."""

from typing import Any

from petsc4py import PETSc

from hypergap_dolfinx.algebra import saddle
from hypergap_dolfinx.solvers.solver import KSPSolver, System

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
