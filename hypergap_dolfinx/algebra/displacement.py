# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Displacements among the fields of a body: contact's forces, motions and norms are theirs alone.

Other fields (a pressure, a temperature) have other units, and equations that are no balance of
forces: they are satisfied to a share of what the displacements have in them.
"""

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.sparse import mean_diagonal, row_length
from hypergap_dolfinx.surface.component import Component


class DisplacementField:
    """The displacements of one body."""

    def __init__(self, part: Component):
        """Find its dofs.

        Args:
            part: The displacements among the body's fields.
        """
        self.part = part
        dofmap = part.space.dofmap
        mine = np.ones(dofmap.index_map.size_local * dofmap.index_map_bs, dtype=bool)
        self.others = ~part.into_body(mine)
        """Mask of this rank's owned dofs of other fields, ``(num_dofs_of_body,)``."""
        self.num_others = int(part.space.mesh.comm.allreduce(self.others.sum()))
        """Number of dofs of other fields on all ranks."""

    def split(self, values: npt.NDArray) -> tuple[npt.NDArray, npt.NDArray]:
        """This rank's values of the displacements, and those of other fields."""
        return self.part.of_body(values), values[self.others]

    def stiffness(self, K: PETSc.Mat) -> float:
        """Mean absolute value on the displacements' diagonal. Collective."""
        if not self.num_others:
            return mean_diagonal(K)
        diagonal = K.getDiagonal()
        mine = np.abs(self.part.of_body(diagonal.array_r))
        diagonal.destroy()
        comm = self.part.space.mesh.comm
        return comm.allreduce(float(mine.sum())) / comm.allreduce(len(mine))

    def lengths(self, K: PETSc.Mat) -> tuple[float, float, float]:
        """Root mean squares of the norms of rows. Collective.

        Returns:
            Of the displacements' rows by displacements and by other fields, and of these' rows by
            displacements.
        """
        if not self.num_others:
            return row_length(K), 0.0, 0.0
        num = K.getSize()[0] - self.num_others, self.num_others
        found = []
        for rows, columns in ((0, 0), (0, 1), (1, 0)):
            block, left, right = K.copy(), K.createVecLeft(), K.createVecRight()
            for mask, i in ((left, rows), (right, columns)):
                mask.array[:] = self.others if i else ~self.others
            block.diagonalScale(L=left, R=right)
            found.append(block.norm() / num[rows] ** 0.5)
            for obj in (block, left, right):
                obj.destroy()
        return found[0], found[1], found[2]
