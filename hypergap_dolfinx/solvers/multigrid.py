# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The saddle system solved by conjugate gradients and algebraic multigrid."""

from hypergap_dolfinx.solvers.bodywise import LU
from hypergap_dolfinx.solvers.projected import ProjectedSystem
from hypergap_dolfinx.solvers.solver import IterativeSolver, Substitute, System, prefixed
from hypergap_dolfinx.surface.trace import is_mixed


class Multigrid(IterativeSolver):
    """``"iterative"``: conjugate gradients on displacements that hold the ties, and multigrid.

    The number of iterations depends neither on the mesh nor on contrasts: 19, 21, 21 with 22 000,
    144 000 and 1 025 000 displacements of degree 1 (45 with degree 2), and at most half as many
    more for contrasts of 1e-6 to 1e6, whichever side is Γ1 (with cells graded 1:50, 3 times as
    many).
    """

    name = "iterative"
    OPTIONS = {  # noqa: RUF012
        "ksp_type": "cg",
        "ksp_norm_type": "unpreconditioned",
        "ksp_rtol": 1e-10,
        "ksp_max_it": 500,
        "pc_type": "gamg",
        "pc_mg_cycle_type": "w",
        "pc_use_amat": False,  # smoothers of another matrix may make multigrid indefinite
        # Unlike SOR, Jacobi doesn't depend on the ranks. Its largest eigenvalue isn't that from
        # smoothing the aggregates, which is too small with contrasts
        "mg_levels_ksp_type": "chebyshev",
        "mg_levels_ksp_max_it": 3,
        "mg_levels_esteig_ksp_max_it": 20,
        "mg_levels_pc_type": "jacobi",
        "pc_gamg_use_sa_esteig": False,
        **prefixed("interface_", LU),
    }
    ADVICE = (
        '; solver="iterative" is for stiffness that is symmetric and positive definite '
        '(complex: Hermitian), and for cells of good shape: take solver="direct"'
    )

    @classmethod
    def why_not(cls, system: System) -> str | None:
        """Multigrid wants bodies that are alike."""
        if system.constraints.interior_sizes:
            return "free interior nodes belong to no body"
        if system.constraints.compliances:
            return "a tie has a compliance"
        if system.constraints.openings:
            return "a tie has a law or a conductance"
        if any(map(is_mixed, system.spaces)):
            return "multigrid is for bodies with one field, and a space is mixed"
        block_sizes = {V.dofmap.index_map_bs for V in system.spaces}
        if len(block_sizes) > 1 or not block_sizes <= {1, system.spaces[0].mesh.geometry.dim}:
            return "multigrid is for bodies that all have displacements, or all have a scalar"
        return None

    def _create(self) -> Substitute:
        system = self._system
        return ProjectedSystem(system.K, system.constraints, system.spaces, self._prefix)
