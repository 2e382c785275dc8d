# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""How the saddle system is solved, and which way is taken if the user names none."""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.graph import parts
from hypergap_dolfinx.solve import saddle
from hypergap_dolfinx.solve.blocks import ConstraintBlocks
from hypergap_dolfinx.solve.projected import ProjectedSystem
from hypergap_dolfinx.solve.substructures import (
    Substructures,
    column_sums,
    order_of_bodies,
    rigid_modes,
)

SOLVERS = ("direct", "bodies", "iterative")

_KRYLOV = {
    "ksp_type": "gmres",
    "ksp_pc_side": "right",  # so that the residual is that of the system
    "ksp_gmres_cgs_refinement_type": "refine_ifneeded",
    "ksp_gmres_restart": 60,
    "ksp_max_it": 120,
    "pc_type": "python",
}
_LU = {
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_14": 30,
}


def _prefixed(prefix: str, options: dict) -> dict:
    return {prefix + key: value for key, value in options.items()}


OPTIONS = {
    "direct": saddle.DIRECT,
    "bodies": {
        **_KRYLOV,
        "ksp_rtol": 1e-13,
        **_prefixed("body_", _LU),
        **_prefixed("square_", _LU),
    },
    "iterative": {
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
        **_prefixed("interface_", _LU),
    },
}
"""PETSc options of each solver: ``"direct"`` factorises the whole system, ``"bodies"`` one body at
a time, and ``"iterative"`` takes algebraic multigrid for all of them.

The number of iterations of ``"bodies"`` (in 3D about 25) grows neither with the mesh nor with the
contrast in stiffness as long as Γ1 is the softer side; if Γ1 is 1000 times the stiffer one, it
takes twice as many. That of ``"iterative"`` depends on neither: 19, 21, 21
with 22 000, 144 000 and 1 025 000 displacements of degree 1 (45 with degree 2), and at most half as
many more for contrasts of 1e-6 to 1e6, whichever side is Γ1 (with cells graded 1:50, 3 times as
many)."""

ADVICE = {
    "direct": "",
    "bodies": '; take solver="direct"',
    "iterative": (
        '; solver="iterative" is for stiffness that is symmetric and positive definite, and for '
        'cells of good shape: take solver="direct"'
    ),
}
"""What to do where a solver fails."""

PLANE = {"mat_mumps_icntl_7": 2}
"""In the plane MUMPS orders by approximate minimum fill: in all a third to a half less time than
with METIS, for bodies tied or not, from 10 000 to 500 000 displacements and degrees 1 to 3."""
FIRST = 1e-10
"""Residual at which ``"bodies"`` begins anew: a second, short run does what a step of refinement
does for factors (the worst of the 3D patch tests: 4e-13; in one go 3e-12)."""
LARGE = 5000
"""Number of displacements in 3D from which the default is ``"bodies"``."""


def options(solver: str, dim: int) -> dict:
    """PETSc options of a solver in the plane or in space."""
    return {**OPTIONS[solver], **PLANE} if solver == "direct" and dim == 2 else OPTIONS[solver]


def default(
    K: Sequence[PETSc.Mat],
    constraints: ConstraintBlocks,
    spaces: Sequence[fem.FunctionSpace],
) -> str:
    """The solver that is taken if the user names none. Collective.

    In the plane, and for small bodies, factors of the whole system cost no more than those of the
    parts and an iteration. In space they soon do: with 56 000 displacements of degree 2 the whole
    takes 1.4 × 10¹¹ operations, one fused mesh 0.95 × 10¹¹, the bodies 0.3 × 10¹¹.
    """
    size = sum(k.getSize()[0] for k in K)
    mesh = spaces[0].mesh
    large = constraints.bodies and mesh.topology.dim == 3 and size >= LARGE
    possible = large and why_not("bodies", constraints, spaces) is None
    return "bodies" if possible else "direct"


def why_not(
    solver: str, constraints: ConstraintBlocks, spaces: Sequence[fem.FunctionSpace]
) -> str | None:
    """What keeps a system from being solved by a solver that isn't direct, or None. Collective."""
    if constraints.interior_sizes:
        return "free interior nodes belong to no body"
    if solver == "iterative":
        block_sizes = {V.dofmap.index_map_bs for V in spaces}
        if len(block_sizes) > 1 or not block_sizes <= {1, spaces[0].mesh.geometry.dim}:
            return "multigrid is for bodies that all have displacements, or all have a scalar"
        return None
    if order_of_bodies(len(spaces), constraints.bodies) is None:
        return "the ties lead round in a circle, or from a body to itself"
    comm, ties = spaces[0].mesh.comm, range(len(constraints.bodies))
    wrong = 0
    for body in range(len(spaces)):
        mine = [t for t in ties if constraints.bodies[t][1] == body]
        start = spaces[body].dofmap.index_map.local_range[0] * spaces[body].dofmap.index_map_bs
        own = np.concatenate([[], *(constraints.own[t] for t in mine)]).astype(np.intp)
        rows = [constraints.free[t][body].getLocalSize()[0] for t in mine]  # type: ignore[union-attr]
        wrong += [len(constraints.own[t]) for t in mine] != rows
        wrong += len(np.unique(own)) != len(own)
        wrong += bool(constraints.prescribed[body][own - start].any())
    return "some multipliers have no free dof of Γ1 of their own" if comm.allreduce(wrong) else None


def create_system(
    solver: str,
    K: Sequence[PETSc.Mat],
    constraints: ConstraintBlocks,
    spaces: Sequence[fem.FunctionSpace],
    prefix: str,
):
    """What takes the place of the saddle system for a solver that isn't direct. Collective."""
    if solver == "bodies":
        return BodywiseSystem(K, constraints, spaces)
    return ProjectedSystem(K, constraints.free, constraints.bodies, constraints.own, spaces, prefix)


class BodywiseSystem:
    """The saddle system for a KSP that is preconditioned body by body.

    Multipliers and constraints are scaled to the size of K: a small residual would hide a large one
    of the constraints otherwise, if that has other units.
    """

    def __init__(
        self,
        K: Sequence[PETSc.Mat],
        constraints: ConstraintBlocks,
        spaces: Sequence[fem.FunctionSpace],
    ):
        """Scale the ties by the values that K has now. Collective.

        Args:
            K: Stiffness of each body.
            constraints: The ties' blocks.
            spaces: Space of each body.
        """
        self._K, self._bodies = K, constraints.bodies
        self._own, self._free = constraints.own, constraints.free
        self.iterations = 0
        self.scales = self._scales_now()
        self._B = [[b and b.copy() for b in row] for row in self._free]
        for row, scale in zip(self._B, self.scales, strict=True):
            for b in row:
                if b is not None:
                    b.scale(scale)
        self.matrix, self._Bt = saddle.saddle_matrix(K, self._B)
        self.matrix.setNestVecType("standard")  # KSPs that make vectors want no nested ones
        self.matrix.assemble()
        self.x, self.b = self.matrix.createVecs()
        modes = [
            rigid_modes(V, held, *parts(V))
            for V, held in zip(spaces, constraints.prescribed, strict=True)
        ]
        order = order_of_bodies(len(K), self._bodies)
        assert order is not None
        columns = [own.astype(PETSc.IntType) for own in constraints.own]
        self.preconditioner = Substructures(K, self._B, self._bodies, columns, order, modes)

    def attach(self, ksp: PETSc.KSP):
        """Give a KSP what it is to solve. Collective."""
        ksp.setOperators(self.matrix)
        ksp.getPC().setPythonContext(self.preconditioner)

    def update(self, ksp: PETSc.KSP) -> bool:
        """Take the stiffness as it is now, if it is of the same size. Collective."""
        self.matrix.assemble()
        ratio = np.array(self._scales_now()) / self.scales
        return bool((np.abs(np.log10(ratio)) < 0.5).all())

    def _scales_now(self) -> list[float]:
        """Size of K over that of B, for each tie. Collective."""
        return [
            _mean_diagonal(self._K[i1], own) / _mean_column(row[i1], own)
            for own, row, (_, i1) in zip(self._own, self._free, self._bodies, strict=True)
        ]

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        blocks = [b for row in self._B for b in row if b is not None]
        for obj in (self.preconditioner, self.matrix, self.x, self.b, *self._Bt, *blocks):
            obj.destroy()

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec):
        """Solve with nested vectors in the units of the system. Collective."""
        parts = [part.array_r.copy() for part in b.getNestSubVecs()]
        num_bodies = len(self._K)
        for part, scale in zip(parts[num_bodies:], self.scales, strict=True):
            part *= scale
        self.b.array[:] = np.concatenate(parts)
        rtol = ksp.rtol
        ksp.setTolerances(rtol=max(rtol, FIRST))
        ksp.setInitialGuessNonzero(False)
        ksp.solve(self.b, self.x)
        self.iterations = ksp.getIterationNumber()
        ksp.setTolerances(rtol=rtol)
        if rtol < FIRST and ksp.getConvergedReason() > 0:
            ksp.setInitialGuessNonzero(True)
            ksp.solve(self.b, self.x)
            self.iterations += ksp.getIterationNumber()
        values = np.split(self.x.array_r, np.cumsum([len(part) for part in parts])[:-1])
        scales = [1.0] * num_bodies + self.scales
        for part, value, scale in zip(x.getNestSubVecs(), values, scales, strict=True):
            part.array[:] = scale * value


def _mean_diagonal(K: PETSc.Mat, dofs: npt.NDArray[np.int64]) -> float:
    diagonal = K.getDiagonal()
    values = diagonal.array_r[dofs - K.getOwnershipRange()[0]]
    total, num = K.comm.tompi4py().allreduce(np.array((np.abs(values).sum(), len(values))))
    diagonal.destroy()
    return total / num if total else 1.0


def _mean_column(B: PETSc.Mat, dofs: npt.NDArray[np.int64]) -> float:
    sums = column_sums(B)
    values = sums.array_r[dofs - B.getOwnershipRangeColumn()[0]]
    total, num = B.comm.tompi4py().allreduce(np.array((values.sum(), len(values))))
    sums.destroy()
    return total / num if total else 1.0
