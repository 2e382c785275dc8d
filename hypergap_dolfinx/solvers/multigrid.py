# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Conjugate gradients and algebraic multigrid for tied bodies."""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.hierarchy import Hierarchy, nest
from hypergap_dolfinx.core.sparse import nonzero_columns
from hypergap_dolfinx.solvers.bodywise import LU
from hypergap_dolfinx.solvers.projection import Constraints, Projection
from hypergap_dolfinx.solvers.solver import IterativeSolver, Substitute, System, prefixed
from hypergap_dolfinx.solvers.tolerances import ROUND_OFF_PROJECTED


def joined_ties(system: System) -> Constraints | None:
    """The ties' blocks as one matrix; None without ties. Collective."""
    constraints, K = system.constraints, system.K
    if not constraints.free:
        return None
    sides = _find_sides(K, constraints.free, constraints.bodies, constraints.own)
    return Constraints(_join(K, constraints.free), sides)


def _join(K: Sequence[PETSc.Mat], B: Sequence[Sequence[PETSc.Mat | None]]) -> PETSc.Mat:
    """The ties' blocks as one matrix. Collective."""
    rows, zeros = [], []
    for row in B:
        size = next(b for b in row if b is not None).getSizes()[0]
        for i, k in enumerate(K):
            if row[i] is None:
                zeros.append(PETSc.Mat().createAIJ((size, k.getSizes()[1]), nnz=0, comm=k.comm))
                zeros[-1].assemble()
                row = [*row[:i], zeros[-1], *row[i + 1 :]]
        rows.append(row)
    nested = nest(rows, K[0].comm)
    joined = nested.convert("aij", PETSc.Mat())  # a copy in one matrix
    for obj in (nested, *zeros):
        obj.destroy()
    return joined


def _find_sides(K, B, bodies, own) -> list[tuple[npt.NDArray, npt.NDArray, slice]]:
    """This rank's own dofs of Γ1, other dofs and rows of each tie. Collective."""
    ends = np.cumsum([0, *(k.getLocalSize()[0] for k in K)])
    sides, num_rows = [], 0
    for row, (_, body), dofs in zip(B, bodies, own, strict=True):
        mine = dofs - K[body].getOwnershipRange()[0] + ends[body]
        found = [np.empty(0, dtype=np.intp)]
        for start, block in zip(ends, row):
            if block is not None:
                found.append(nonzero_columns(block) + start)
        last = num_rows + next(b for b in row if b is not None).getLocalSize()[0]
        rows = slice(num_rows, last)
        sides.append((mine, np.setdiff1d(np.concatenate(found), mine), rows))
        num_rows = last
    return sides


class ProjectedSystem(Substitute):
    """The projected system for a KSP, and the way back to displacements and multipliers."""

    def __init__(self, system: System, prefix: str):
        """Join the ties' blocks. Collective.

        Args:
            system: The saddle-point system.
            prefix: Prefix of the solvers' options.
        """
        self._projection = Projection(system.K, system.spaces, prefix)
        self._constraints = joined_ties(system)
        self._num_bodies = len(system.K)

    @property
    def matrix(self) -> PETSc.Mat:
        """The projected stiffness."""
        return self._projection.matrix

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        self._projection.destroy()
        if self._constraints is not None:
            self._constraints.destroy()

    def update(self, ksp: PETSc.KSP) -> bool:
        """Take the present stiffness, with new aggregates; always possible. Collective."""
        self._projection.forget_aggregates()
        self._projection.update(ksp, self._constraints)
        return True

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec):
        """Solve for nested vectors of the saddle-point system. Collective.

        Prescribed displacements of stiff bodies are large loads at first, next to which the forces
        that are left are small: then the solver is called again, to be as exact for those.
        """
        of, parts = self._projection, x.getNestSubVecs()
        loads, given = (
            np.concatenate([np.empty(0), *(part.array_r for part in some)])
            for some in (
                b.getNestSubVecs()[: self._num_bodies],
                b.getNestSubVecs()[self._num_bodies :],
            )
        )
        u = of.b.duplicate()
        u.set(0.0)
        of.lift(u, given)
        of.load(loads, u, of.b)
        size, tolerances = of.b.norm(), ksp.getTolerances()
        # Ties can take all loads: what is left is round-off
        ksp.setTolerances(atol=max(ksp.atol, ROUND_OFF_PROJECTED * of.constraint_forces))
        of.add_solution(ksp, u)
        ksp.setTolerances(*tolerances)
        self.iterations = of.iterations
        of.load(loads, u, of.r)
        if ksp.getConvergedReason() > 0 and of.refine(ksp, u, size, ksp.rtol):
            self.iterations += of.iterations
            of.load(loads, u, of.r)
        found = np.concatenate((u.array_r, of.multipliers))
        ends = np.cumsum([part.getLocalSize() for part in parts])
        for part, values in zip(parts, np.split(found, ends[:-1]), strict=True):
            part.array[:] = values
        u.destroy()


class Multigrid(IterativeSolver):
    """``"iterative"``: conjugate gradients on displacements that hold the ties, and multigrid.

    The number of iterations depends neither on the mesh nor on contrasts: 15, 16, 18 with 10 000,
    37 000 and 133 000 displacements of degree 1 (about 35 with degree 2), 16 to 19 with contrasts
    of 1e-6 to 1e6 (with cells graded 1:50, up to twice as many).
    """

    name = "iterative"
    OPTIONS = {  # noqa: RUF012
        "ksp_type": "cg",
        "ksp_norm_type": "unpreconditioned",
        "ksp_rtol": 1e-10,
        "ksp_max_it": 500,
        "pc_type": "mg",
        "pc_mg_cycle_type": "w",
        "pc_use_amat": False,  # smoothers of another matrix may make multigrid indefinite
        # Unlike SOR, Jacobi doesn't depend on the ranks. Its largest eigenvalue isn't that from
        # smoothing the aggregates, which is too small with contrasts
        "mg_levels_ksp_type": "chebyshev",
        "mg_levels_ksp_max_it": 3,
        "mg_levels_esteig_ksp_max_it": 20,
        "mg_levels_pc_type": "jacobi",
        **prefixed("aggregates_", Hierarchy.OPTIONS),
        "interface_ksp_type": "preonly",
        "interface_pc_type": "redundant",  # small, and solved with several times an iteration
        **prefixed("interface_redundant_", LU | {"pc_type": "cholesky"}),
    }
    SUITED = "for cells of good shape, and for Poisson's ratios up to 0.49"
    """What it is for beside definite stiffness, in messages."""
    ADVICE = (
        '; solver="iterative" is for stiffness that is symmetric and positive definite (complex: '
        f'Hermitian), {SUITED}: take solver="direct"'
    )

    @classmethod
    def why_not(cls, system: System) -> str | None:
        """Reason why not, or None: multigrid needs bodies with the same kind of field."""
        reason = super().why_not(system)
        if reason:
            return reason
        block_sizes = {V.dofmap.index_map_bs for V in system.spaces}
        if len(block_sizes) > 1 or not block_sizes <= {1, system.spaces[0].mesh.geometry.dim}:
            return "multigrid is for bodies that all have displacements, or all have a scalar"
        return None

    def _create(self) -> Substitute:
        return ProjectedSystem(self._system, self._prefix)
