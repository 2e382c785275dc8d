# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The saddle system solved with factors of one body at a time, and an iteration over the ties."""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.graph import parts
from hypergap_dolfinx.solve import saddle
from hypergap_dolfinx.solve.blocks import ConstraintBlocks
from hypergap_dolfinx.solve.modes import rigid_modes
from hypergap_dolfinx.solve.solver import IterativeSolver, Substitute, System, prefixed
from hypergap_dolfinx.solve.substructures import Substructures, column_sums, order_of_bodies

LU = {
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_14": 30,
}
"""A factor of a part of the system."""
FIRST = 1e-10
"""Residual at which the iteration begins anew: a second, short run does what a step of refinement
does for factors (the worst of the 3D patch tests: 4e-13; in one go 3e-12)."""


class Bodies(IterativeSolver):
    """``"bodies"``: the saddle system, preconditioned body by body.

    The number of iterations (in 3D about 25) grows neither with the mesh nor with the contrast in
    stiffness as long as Γ1 is the softer side; if Γ1 is 1000 times the stiffer one, it takes twice
    as many.
    """

    name = "bodies"
    OPTIONS = {  # noqa: RUF012
        "ksp_type": "gmres",
        "ksp_pc_side": "right",  # so that the residual is that of the system
        "ksp_gmres_cgs_refinement_type": "refine_ifneeded",
        "ksp_gmres_restart": 60,
        "ksp_max_it": 120,
        "ksp_rtol": 1e-13,
        "pc_type": "python",
        **prefixed("body_", LU),
        **prefixed("square_", LU),
    }
    ADVICE = '; take solver="direct"'

    @classmethod
    def why_not(cls, system: System) -> str | None:
        """Each multiplier needs a free dof of its own, bodies an order. Collective."""
        constraints, spaces = system.constraints, system.spaces
        if constraints.interior_sizes:
            return "free interior nodes belong to no body"
        if order_of_bodies(len(spaces), constraints.bodies) is None:
            return "the ties lead round in a circle, or from a body to itself"
        ties, wrong = range(len(constraints.bodies)), 0
        for body, V in enumerate(spaces):
            mine = [t for t in ties if constraints.bodies[t][1] == body]
            start = V.dofmap.index_map.local_range[0] * V.dofmap.index_map_bs
            own = np.concatenate([[], *(constraints.own[t] for t in mine)]).astype(np.intp)
            rows = [constraints.free[t][body].getLocalSize()[0] for t in mine]  # type: ignore[union-attr]
            wrong += [len(constraints.own[t]) for t in mine] != rows
            wrong += len(np.unique(own)) != len(own)
            wrong += bool(constraints.prescribed[body][own - start].any())
        none = "some multipliers have no free dof of Γ1 of their own"
        return none if spaces[0].mesh.comm.allreduce(wrong) else None

    def _create(self) -> Substitute:
        return BodywiseSystem(self._system.K, self._system.constraints, self._system.spaces)


class BodywiseSystem(Substitute):
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

    def update(self, ksp: PETSc.KSP) -> bool:
        """Take the stiffness as it is now, if it is of the same size. Collective."""
        ratio = np.array(self._scales_now()) / self.scales
        if not (np.abs(np.log10(ratio)) < 0.5).all():
            return False
        self.matrix.assemble()
        ksp.setOperators(self.matrix)
        ksp.getPC().setPythonContext(self.preconditioner)
        return True

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
