# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The constraints of several ties on several bodies, as blocks of one saddle system."""

from collections.abc import Sequence
from itertools import chain

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.gap.constraint import Dropped, independent_rows
from hypergap_dolfinx.solve.checks import Coincidences
from hypergap_dolfinx.solve.cross_points import dropped_multipliers, look_up
from hypergap_dolfinx.solve.interface import Interface


class ConstraintBlocks:
    """B of the saddle system [K Bᵀ; B 0]: a row of blocks for each tie, a column for each field.

    The fields are the bodies' displacements, then the free interior nodes of ties that have them.
    Rows of prescribed dofs are gone, and so are columns: what they hold is known.
    """

    def __init__(
        self,
        spaces: Sequence[fem.FunctionSpace],
        bcs: Sequence[Sequence[fem.DirichletBC]],
        ties: Sequence[Interface],
    ):
        """Pull the ties back to the bodies. Collective.

        Args:
            spaces: Function space of each body.
            bcs: Dirichlet conditions of each body.
            ties: The ties.

        Raises:
            ValueError: A tie on a space that belongs to no body.
            InterfaceError: Γ1 is prescribed on whole facets that Γ0 is to be tied to.
        """
        self._spaces = list(spaces)
        self._ties = list(ties)
        self._bodies = [self._bodies_of(t, tie) for t, tie in enumerate(self._ties)]
        self._rows: list[PETSc.Mat | None] = []
        self._full: list[list[PETSc.Mat | None]] = []
        self._free: list[list[PETSc.Mat | None]] = []
        self._own: list[npt.NDArray[np.int64]] = []
        self._gaps: dict[int, PETSc.Vec] = {}
        self._pairs: dict[int, Coincidences] = {}
        prescribed = [self._prescribed(V, b) for V, b in zip(self._spaces, bcs, strict=True)]
        self._held = prescribed
        interior = len(self._spaces)
        self._num_fields = interior + sum(tie.free_interior for tie in self._ties)
        dropped = dropped_multipliers(self._ties, self._bodies, prescribed)
        for t, tie in enumerate(self._ties):
            self._add(t, prescribed, interior, dropped[t])
            interior += tie.free_interior

    def destroy(self):
        """Destroy the PETSc matrices. Collective."""
        for obj in chain(self._rows, *self._full, *self._free, self._gaps.values()):
            if obj is not None:
                obj.destroy()

    @property
    def free(self) -> list[list[PETSc.Mat | None]]:
        """B on what is not prescribed, ``[tie][field]``."""
        return self._free

    @property
    def full(self) -> list[list[PETSc.Mat | None]]:
        """B on all dofs, ``[tie][field]``."""
        return self._full

    @property
    def bodies(self) -> list[tuple[int, int]]:
        """Γ0's and Γ1's body of each tie."""
        return self._bodies

    @property
    def prescribed(self) -> list[npt.NDArray[np.bool_]]:
        """Which owned dofs (unrolled) of each body are prescribed."""
        return self._held

    @property
    def own(self) -> list[npt.NDArray[np.int64]]:
        """Global dof (unrolled) of V₁ under each of this rank's multipliers, for each tie."""
        return self._own

    @property
    def interior_sizes(self) -> list[tuple[int, int]]:
        """Local and global numbers of free interior dofs, of the ties that have them."""
        return [tie.blocks()[2].getSizes()[1] for tie in self._ties if tie.free_interior]

    def apply(self, t: int, fields: Sequence[PETSc.Vec], c: PETSc.Vec):
        """Compute c = Σ_i B_i u_i of a tie, prescribed dofs included. Collective.

        A tie that closes the gap takes the positions x_i + u_i instead of the u_i.

        Args:
            t: Number of the tie.
            fields: u_i; of the bodies alone or of all fields.
            c: Takes the result.
        """
        c.set(0.0)
        for u, B in zip(fields, self._full[t], strict=False):
            if B is not None:
                B.multAdd(u, c, c)
        if self._ties[t].closes_gap:
            c.axpy(1.0, self._gap(t))

    def _gap(self, t: int) -> PETSc.Vec:
        """Σ_i B_i x_i with the positions x_i of the dofs. Collective."""
        if t not in self._gaps:
            bodies = self._bodies[t]
            c = next(B for B in self._full[t] if B is not None).createVecLeft()
            c.set(0.0)
            origin = self._ties[t].surfaces[0].x[0]  # far from the origin digits are few
            for body in sorted(set(bodies)):
                V, B = self._spaces[body], self._full[t][body]
                assert B is not None
                x = B.createVecRight()
                n, owned = V.mesh.geometry.dim, V.dofmap.index_map.size_local
                x.array[:] = (V.tabulate_dof_coordinates()[:owned, :n] - origin).ravel()
                B.multAdd(x, c, c)
                x.destroy()
            self._gaps[t] = c
        return self._gaps[t]

    def check_prescribed(self, values: Sequence[PETSc.Vec]):
        """Raise where both sides of a tie are prescribed, and differently. Collective.

        Args:
            values: The prescribed displacements of each body, zero elsewhere.

        Raises:
            InterfaceError: With the place and the values.
        """
        for t, (tie, bodies) in enumerate(zip(self._ties, self._bodies, strict=True)):
            if tie.closes_gap:
                continue
            if t not in self._pairs:
                self._pairs[t] = Coincidences(tie)
            pairs, comm, both, given = self._pairs[t], tie.sigma.comm, [], []
            for V, body, dofs in zip(tie.spaces, bodies, pairs.dofs, strict=True):
                shape, start = (-1, tie.block_size), V.dofmap.index_map.local_range[0]
                held = self._held[body].reshape(shape).astype(np.int8)
                both.append(look_up(comm, held, start, dofs).astype(bool))
                given.append(look_up(comm, values[body].array_r.reshape(shape), start, dofs))
            pairs.check(t, both, given)

    def multipliers(self, t: int, x: PETSc.Vec) -> npt.NDArray[np.float64]:
        """All multipliers λ = E λ' of a tie, ``(num_multipliers, block_size)``. Collective."""
        E = self._rows[t]
        if E is None:
            values = x.array_r.copy()
        else:
            full = E.createVecLeft()
            E.mult(x, full)
            values = full.array_r.copy()
            full.destroy()
        return values.reshape(-1, self._ties[t].block_size)

    def _bodies_of(self, t: int, tie: Interface) -> tuple[int, int]:
        """The bodies on both sides of a tie."""
        found = []
        for side, V in enumerate(tie.spaces):
            body = next((i for i, W in enumerate(self._spaces) if W == V), None)
            if body is None:
                raise ValueError(
                    f"Γ{side} of tie {t} is on a space that is in no form; make the tie and the "
                    "forms on the same function spaces."
                )
            found.append(body)
        return found[0], found[1]

    @staticmethod
    def _prescribed(V: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]) -> npt.NDArray[np.bool_]:
        """Which owned dofs (unrolled) of a body are prescribed."""
        marker = np.zeros(V.dofmap.index_map.size_local * V.dofmap.index_map_bs, dtype=bool)
        for bc in bcs:
            dofs = bc.dof_indices()[0]  # 0.9 may count ghosts as owned
            marker[dofs[dofs < len(marker)]] = True
        return marker

    def _add(self, t: int, prescribed, interior: int, dropped: Dropped):
        """The blocks of a tie, with the rows and columns that are left free."""
        tie, bodies = self._ties[t], self._bodies[t]
        E, lost = independent_rows(tie.constraint, tie.domain, dropped)
        self._check_lost_rows(t, lost, prescribed[bodies[0]])
        dofs = tie.constraint.dofs[:, None] * tie.block_size + np.arange(tie.block_size)
        dofs = dofs[~dropped.dropped]
        start, end = np.multiply(tie.spaces[1].dofmap.index_map.local_range, tie.block_size)
        self._own.append(dofs[(dofs >= start) & (dofs < end)])
        full: dict[int, PETSc.Mat] = {}
        for i, B in zip((*bodies, interior), tie.blocks(), strict=False):
            B = E.transposeMatMult(B) if E else B.copy()
            if i in full:  # both sides on one body
                full[i].axpy(1.0, B)
                B.destroy()
            else:
                full[i] = B
        free = {i: B.copy() for i, B in full.items()}
        for body in set(bodies):
            mask = free[body].createVecRight()
            mask.array[:] = ~prescribed[body]
            free[body].diagonalScale(R=mask)
            mask.destroy()
        self._rows.append(E)
        self._full.append([full.get(i) for i in range(self._num_fields)])
        self._free.append([free.get(i) for i in range(self._num_fields)])

    def _check_lost_rows(self, t: int, lost, prescribed0):
        """Rows without a multiplier are harmless where nothing of Γ0 faces them that can move."""
        tie = self._ties[t]
        B0 = tie.blocks()[0].copy()
        mask = B0.createVecRight()
        mask.array[:] = ~prescribed0
        B0.diagonalScale(R=mask)
        start, _ = B0.getOwnershipRange()
        indptr, _, values = B0.getValuesCSR()
        size = np.add.reduceat(np.append(np.abs(values), 0), indptr[:-1]) * (np.diff(indptr) > 0)
        untied = (size[lost - start] > 1e-12 * size.max(initial=0)).sum()
        mask.destroy()
        B0.destroy()
        untied = tie.sigma.comm.allreduce(int(untied))
        if untied:
            raise InterfaceError(
                f"{untied} displacements of Γ1 of tie {t} are prescribed on whole facets while "
                "Γ0 can move there, so nothing would tie it; swap the sides of the tie."
            )
