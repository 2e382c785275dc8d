# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The saddle system solved with factors of one body at a time, and an iteration over the ties."""

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra import saddle
from hypergap_dolfinx.algebra.blocks import ConstraintBlocks
from hypergap_dolfinx.algebra.rigid_motions import rigid_modes
from hypergap_dolfinx.core.graph import parts
from hypergap_dolfinx.solvers.solver import IterativeSolver, Substitute, System, prefixed
from hypergap_dolfinx.solvers.substructures import Substructures, order_of_bodies
from hypergap_dolfinx.solvers.tolerances import FIRST, RESCALE
from hypergap_dolfinx.surface.trace import is_mixed

LU = {
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_14": 30,
}
"""A factor of a part of the system."""


class Bodies(IterativeSolver):
    """``"bodies"``: the saddle system, preconditioned body by body.

    With two bodies the number of iterations (in 3D about 25) grows neither with the mesh nor with
    the contrast in stiffness as long as Γ1 is the softer side; if Γ1 is 1000 times the stiffer one,
    it takes twice as many. It grows with the number of bodies that are tied one behind the other.
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
        """Reason why not, or None: multipliers need own dofs, bodies an order. Collective."""
        constraints, spaces = system.constraints, system.spaces
        if constraints.interior_sizes:
            return "free interior nodes belong to no body"
        if constraints.compliances:
            return "a tie has a compliance"
        if constraints.jump_fields:
            return "a tie has a law or a conductance"
        if any(map(is_mixed, spaces)):
            return "a body may be singular by itself where a space is mixed (a pressure is free)"
        if order_of_bodies(len(spaces), _directions(constraints)) is None:
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
        return BodywiseSystem(self._system)

    def _advice(self) -> str:
        num = len(self._system.spaces)
        if num == 2:
            return self.ADVICE
        return f"; iterations grow with the bodies tied in a row, and there are {num}{self.ADVICE}"


def _directions(constraints: ConstraintBlocks) -> list[tuple[int, int]]:
    """Pairs of bodies: one that an interface moves, and that of its Γ1."""
    pairs = zip(constraints.moved, constraints.bodies, strict=True)
    return [(i, i1) for moved, (_, i1) in pairs for i in moved]


class BodywiseSystem(Substitute):
    """The saddle system for a KSP that is preconditioned body by body.

    Multipliers and constraints are scaled to the size of K: a small residual would hide a large one
    of the constraints otherwise, if that has other units.
    """

    def __init__(self, system: System):
        """Scale the ties by the present values of K. Collective.

        Args:
            system: The saddle system.
        """
        self._A, self._K = system.A, system.K
        K, constraints, spaces = system.K, system.constraints, system.spaces
        self.scales = self._scales_now()
        self._B = [[b and b.copy() for b in row] for row in constraints.free]
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
        order = order_of_bodies(len(K), _directions(constraints))
        assert order is not None
        moved = zip(constraints.moved, constraints.bodies, strict=True)
        sides = [(others, i1) for others, (_, i1) in moved]
        columns = [own.astype(PETSc.IntType) for own in constraints.own]
        self.preconditioner = Substructures(K, self._B, sides, columns, order, modes)

    def update(self, ksp: PETSc.KSP) -> bool:
        """Take the present stiffness; False if its size has changed. Collective."""
        ratio = self._scales_now() / self.scales
        if not (np.abs(np.log10(ratio)) < RESCALE).all():
            return False
        self.matrix.assemble()
        ksp.setOperators(self.matrix)
        ksp.getPC().setPythonContext(self.preconditioner)
        return True

    def _scales_now(self) -> npt.NDArray[np.float64]:
        return np.array(saddle.scales(self._A)[len(self._K) :])

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
        scales = [*np.ones(num_bodies), *self.scales]
        for part, value, scale in zip(x.getNestSubVecs(), values, scales, strict=True):
            part.array[:] = scale * value
