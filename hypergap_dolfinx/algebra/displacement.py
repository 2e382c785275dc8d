# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Displacements among the fields of a body: contact's forces, motions and norms are theirs alone.

Other fields (a pressure, a temperature) have other units, and equations that are no balance of
forces: each field's are satisfied to a share of the terms in them.
"""

from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.core.graph import parts, parts_at
from hypergap_dolfinx.core.sparse import row_length
from hypergap_dolfinx.surface.component import Component, unrolled
from hypergap_dolfinx.surface.moving import MovingSurface


class DisplacementField:
    """The displacements of one body."""

    def __init__(self, part: Component, V: fem.FunctionSpace):
        """Find its dofs.

        Args:
            part: The displacements among the body's fields.
            V: The body's space.
        """
        self.part = part
        dofmap = part.space.dofmap
        mine = np.ones(dofmap.index_map.size_local * dofmap.index_map_bs, dtype=bool)
        self.others = ~part.into_body(mine)
        """Mask of this rank's owned dofs of other fields, ``(num_dofs_of_body,)``."""
        self.num_others = int(part.space.mesh.comm.allreduce(self.others.sum()))
        """Number of dofs of other fields on all ranks."""
        self._num_fields = 1 + V.num_sub_spaces if self.num_others else 1
        self._field = np.zeros(len(mine) if part.dofs is None else len(self.others), dtype=np.intp)
        for i in range(self._num_fields - 1):
            dofs = np.unique(unrolled(V.sub(i)))
            self._field[dofs[dofs < len(self._field)]] = i + 1
        self._field[~self.others] = 0

    def squares(self, values: npt.NDArray) -> npt.NDArray[np.float64]:
        """Sums of squares of this rank's values: of the displacements, then of each component's."""
        if not self.num_others:
            return np.array([np.vdot(values, values).real])
        return np.bincount(self._field, np.abs(values) ** 2, self._num_fields)

    @cached_property
    def parts(self) -> tuple[npt.NDArray[np.int32], int]:
        """Connected part of each owned node, and their number. Collective."""
        return parts(self.part.space)

    def stiffness(
        self,
        K: PETSc.Mat,
        held: npt.NDArray[np.bool_],
        nodes: npt.NDArray[np.int64] | None = None,
    ) -> float:
        """Mean absolute value on the displacements' diagonal, of the softest part. Collective.

        Args:
            K: The body's stiffness.
            held: Mask of this rank's prescribed dofs, whose rows have the whole body's size.
            nodes: Global numbers of nodes, the same on every rank, whose parts are meant; all.

        Returns:
            The mean; infinite if all is prescribed.
        """
        part, num_parts = self.parts
        diagonal = K.getDiagonal()
        mine = np.abs(self.part.of_body(diagonal.array_r))
        diagonal.destroy()
        free = ~self.part.of_body(held)
        each = np.repeat(part, len(mine) // max(len(part), 1))[free]
        sums = np.zeros((2, num_parts))  # of no numbers at all bincount makes integers
        for found, of in zip(sums, (mine[free], np.ones(len(each))), strict=True):
            found += np.bincount(each, of, num_parts)
        comm = self.part.space.mesh.comm
        comm.Allreduce(MPI.IN_PLACE, sums)
        meant = sums[1] > 0
        if nodes is not None and num_parts > 1:
            meant &= np.isin(np.arange(num_parts), list(parts_at(self.part.space, part, nodes)))
        return float((sums[0] / np.maximum(sums[1], 1))[meant].min(initial=np.inf))

    def of_slopes(self, K: PETSc.Mat, side: MovingSurface) -> npt.NDArray[np.float64]:
        """Forces at a surface's dofs by displacements that are linear in space. Collective.

        Each dof is where they are zero: masses and springs in K hardly count.

        Args:
            K: The body's stiffness.
            side: The surface.

        Returns:
            By e_b x_a, ``(num_dofs, n, b, a)``, the same on every rank.
        """
        n, map_ = side.reference.gdim, self.part.space.dofmap.index_map
        x = self.part.space.tabulate_dof_coordinates()[: map_.size_local, :n]
        powers = np.column_stack((x, np.ones(len(x))))
        dofs = side.dofs - map_.local_range[0]
        own = (dofs >= 0) & (dofs < len(x))
        dofs, found = dofs[own], np.zeros((len(dofs), n, n, n))
        forces, (u, f) = np.empty((len(dofs), n, n, n + 1)), K.createVecs()
        for b, a in np.ndindex(n, n + 1):
            given = np.zeros_like(x)
            given[:, b] = powers[:, a]
            u.array[:] = self.part.into_body(given.ravel())
            K.mult(u, f)
            forces[..., b, a] = self.part.of_body(f.array_r).real.reshape(-1, n)[dofs]
        for vector in (u, f):
            vector.destroy()
        found[own] = forces[..., :n] - forces[..., n:] * x[dofs, None, None]
        return self.part.space.mesh.comm.allreduce(found)

    def lengths(self, K: PETSc.Mat) -> npt.NDArray[np.float64]:
        """Root mean squares of the norms of each field's rows by each field. Collective.

        Returns:
            ``(num_fields, num_fields)``, fields as in :meth:`squares`.
        """
        if not self.num_others:
            return np.array([[row_length(K)]])
        comm, num = self.part.space.mesh.comm, self._num_fields
        indptr, columns, values = K.getValuesCSR()
        rows = np.repeat(self._field, np.diff(indptr))
        pair = num * rows + np.concatenate(comm.allgather(self._field))[columns]
        squares = comm.allreduce(np.bincount(pair, np.abs(values) ** 2, num**2))
        sizes = comm.allreduce(np.bincount(self._field, minlength=num))
        return np.sqrt(squares.reshape(num, num) / np.maximum(sizes, 1)[:, None])
