# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The constraints of several ties on several bodies as blocks of one saddle-point system."""

from collections.abc import Sequence
from itertools import chain

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.algebra.checks import Coincidences
from hypergap_dolfinx.algebra.tolerances import NOTHING
from hypergap_dolfinx.core.sparse import coo_matrix
from hypergap_dolfinx.errors import InterfaceError, PrescribedSideError
from hypergap_dolfinx.interface_laws.compliance import Conductance
from hypergap_dolfinx.interface_laws.coupling import CoupledMotion
from hypergap_dolfinx.interface_laws.coupling_rows import CouplingRows
from hypergap_dolfinx.multipliers.existence import Choice, Columns, choose
from hypergap_dolfinx.multipliers.interface import Interface
from hypergap_dolfinx.multipliers.law_fields import Compliances, Extension, JumpField
from hypergap_dolfinx.multipliers.numbering import prescribed_dofs, values_at
from hypergap_dolfinx.surface.component import Component


class ConstraintBlocks:
    """B and C of [K Bᵀ; B −C]: B has a row of blocks for each interface, a column for each field.

    Rows of couplings with points come last; the unknowns of these are a body's.

    An interface is a tie, or several that are its pieces: those between the same two bodies.

    The fields are the bodies' displacements, then the free interior nodes of ties that have them,
    then the jumps of ties with a law. Rows and columns of prescribed dofs are left out.
    """

    def __init__(
        self,
        spaces: Sequence[fem.FunctionSpace],
        bcs: Sequence[Sequence[fem.DirichletBC]],
        ties: Sequence[Interface],
        names: Sequence[str] | None = None,
        couplings: Sequence[CoupledMotion] = (),
    ):
        """Pull the ties back to the bodies. Collective.

        Args:
            spaces: Function space of each body.
            bcs: Dirichlet conditions of each body.
            ties: The ties.
            names: Names of the ties in messages; their numbers if not given.
            couplings: Couplings of surfaces with points, whose unknowns are bodies here.

        Raises:
            ValueError: A tie on a space that belongs to no body; ties on a field of a body and on
                a part of that field.
            InterfaceError: Γ1 is prescribed on whole facets that Γ0 is to be tied to, and no
                multiplier is left there.
        """
        self._spaces = list(spaces)
        self._ties = list(ties)
        self.couplings = list(couplings)
        """Couplings of surfaces with points."""
        self._names = names or [f"tie {t}" for t in range(len(self._ties))]
        self._components: list[tuple[int, Component]] = []  # with the numbers of their bodies
        tied = [self._fields_of(t, tie) for t, tie in enumerate(self._ties)]
        self.sides = [(self._components[f0][0], self._components[f1][0]) for f0, f1 in tied]
        """Γ0's and Γ1's body of each tie."""
        self.prescribed = [self._prescribed(V, b) for V, b in zip(spaces, bcs, strict=True)]
        """Mask of each body's owned dofs (unrolled) that are prescribed."""
        self._pairs: dict[int, tuple[Coincidences, npt.NDArray[np.bool_]] | None] = {}
        held = [part.of_body(self.prescribed[i]) for i, part in self._components]
        choice = choose(self._ties, tied, held)
        self._interfaces = choice.interfaces
        self._of_tie = {t: g for g, group in enumerate(choice.interfaces) for t in group}
        self.bodies = [self.sides[group[0]] for group in self._interfaces]
        """Γ0's and Γ1's body of each interface."""
        for t, lost in enumerate(choice.lost):
            self._check_lost_rows(t, lost)
        self.own = [
            self._own_dofs(columns, self._ties[group[0]])
            for columns, group in zip(choice.columns, choice.interfaces, strict=True)
        ]
        """Global dofs (unrolled) of Γ1's body that answer to this rank's rows of each interface;
        fewer than rows if several dofs answer to one row together."""
        self._rows = [self._extensions(t, choice) for t in range(len(self._ties))]
        unknown = [
            name if undetermined else None
            for name, undetermined in zip(self._names, choice.undetermined, strict=True)
        ]
        self.compliances = Compliances(
            self._ties, self._rows, len(self._interfaces) + len(self.couplings), unknown
        )
        self.jump_fields = [
            JumpField(tie, row) for tie, row in zip(self._ties, self._rows) if tie.law and row
        ]
        self.full = self._pulled_back()
        """B on all dofs, ``[interface][field]``; then the couplings' rows."""
        self.coupled = [self._couple(k, one) for k, one in enumerate(self.couplings)]
        """Equations of each coupling, and its bodies: the surface's, and its unknowns."""
        self._check_redundant()
        self._wanted: list[PETSc.Vec | None] | None = None  # Σ_i B_i u_i of each interface
        self.free = [
            [self._without_prescribed(i, B) for i, B in enumerate(row)] for row in self.full
        ]
        """B on dofs that are not prescribed, ``[interface][field]``."""

    def destroy(self):
        """Destroy the PETSc matrices. Collective."""
        wanted = self._wanted or []
        for obj in chain(*(r.values() for r in self._rows), *self.full, *self.free, wanted):
            if obj is not None:
                obj.destroy()
        for owner in (self.compliances, *self.jump_fields, *(rows for rows, *_ in self.coupled)):
            owner.destroy()

    def name(self, g: int) -> str:
        """Name of an interface in messages: those of its ties."""
        return " with ".join(self._names[t] for t in self._interfaces[g])

    def too_few(self, moving: Sequence[int]) -> str:
        """Sentences about ties with too few multipliers to hold bodies at others that are held."""
        found = ""
        for t, (tie, sides) in enumerate(zip(self._ties, self.sides, strict=True)):
            g = self._of_tie.get(t)
            rows = 0 if g is None else next(B for B in self.full[g] if B).getSize()[0]
            if len(set(sides).intersection(moving)) == 1 and rows < tie.block_size**2:
                found += (
                    f" {self._names[t]} has too few multipliers to hold it: it covers "
                    f"{tie.domain.covered.sum():.2g} facets of Γ1; tie more of them, or refine Γ1."
                )
        return found

    @property
    def conducts(self) -> bool:
        """True if a tie has a conductance, which may be 0."""
        return any(jump.linear for jump in self.jump_fields)

    def loose(self) -> list[int]:
        """Numbers of interfaces all of whose ties have a conductance of 0 now. Collective."""
        found = []
        for g, group in enumerate(self._interfaces):
            every = (self._ties[t].law for t in group)
            laws = [law for law in every if isinstance(law, Conductance)]
            if len(laws) == len(group):
                largest = max(law.values().max(initial=0) for law in laws)
                if self._ties[group[0]].domain.comm.allreduce(largest, MPI.MAX) == 0:
                    found.append(g)
        return found

    @property
    def moved(self) -> list[list[int]]:
        """The bodies besides Γ1's that each interface moves: Γ0's, and others at cross points."""
        num = len(self._spaces)
        return [
            [i for i, B in enumerate(row[:num]) if B is not None and i != i1] or [i0]
            for row, (i0, i1) in zip(self.free, self.bodies, strict=False)
        ]

    def carried(self) -> list[npt.NDArray[np.bool_]]:
        """Mask of this rank's rows of each interface that tie across a distance. Collective."""
        found = []
        for g, row in enumerate(self.full):
            num, couples = next(B for B in row if B).getLocalSize()[0], g >= len(self._interfaces)
            rows = np.full(num, couples)  # those of couplings are no strains of meshes
            for tie, E in zip(self._ties, self._rows, strict=True):
                if tie.motion is not None and g in E:
                    rows[E[g].reached()] = True
            found.append(rows)
        return found

    @property
    def interior_sizes(self) -> list[tuple[int, int]]:
        """Local and global numbers of free interior dofs, of the ties that have them."""
        return [tie.blocks()[2].getSizes()[1] for tie in self._ties if tie.free_interior]

    def apply(self, g: int, fields: Sequence[PETSc.Vec], c: PETSc.Vec):
        """Compute c = Σ_i B_i u_i − c₀ of an interface, prescribed dofs included. Collective.

        The offset c₀ of jumps and positions is that of the last :meth:`read_jumps`.

        Args:
            g: Number of the interface.
            fields: u_i of the bodies alone, or of all fields.
            c: Takes the result.
        """
        c.set(0.0)
        for u, B in zip(fields, self.full[g], strict=False):
            if B is not None:
                B.multAdd(u, c, c)
        if self._wanted is None:
            self.read_jumps()
        wanted = self._wanted and self._wanted[g]
        if wanted:
            c.axpy(-1.0, wanted)

    def read_jumps(self):
        """Read the offsets c₀ from the jumps and positions as they are now. Collective."""
        for wanted in filter(None, self._wanted or []):
            wanted.destroy()
        self._wanted = [None] * len(self.full)
        for tie, row in zip(self._ties, self._rows, strict=True):
            offset = tie.offset()
            if offset is None:
                continue
            for g, E in row.items():
                wanted = self._wanted[g]
                if wanted is None:
                    wanted = next(B for B in self.full[g] if B).createVecLeft()
                    wanted.set(0.0)
                    self._wanted[g] = wanted
                E.add_transposed(offset, wanted)
            offset.destroy()

    def update_couplings(
        self, fields: Sequence[PETSc.Vec], multipliers: Sequence[PETSc.Vec]
    ) -> list[npt.NDArray]:
        """Set the couplings' blocks at a state. Collective.

        Args:
            fields: Displacements of each body.
            multipliers: Multipliers of each row of blocks.

        Returns:
            This rank's c(u, q) of each coupling.
        """
        found, first = [], len(self._interfaces)
        for g, (rows, i, own) in enumerate(self.coupled, first):
            found.append(
                rows.update(fields[i].array_r, fields[own].array_r, multipliers[g].array_r)
            )
            self._free_again(g)
        return found

    def reset_couplings(self):
        """Set the couplings' blocks to those of small rotations. Collective."""
        for g, (rows, *_) in enumerate(self.coupled, len(self._interfaces)):
            rows.reset()
            self._free_again(g)

    def _free_again(self, g: int):
        """Set the blocks of free dofs of a row of blocks from the full ones. Collective."""
        for i, (B, free) in enumerate(zip(self.full[g], self.free[g], strict=True)):
            if B is not None and free is not None:
                B.copy(free, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
                self._drop_prescribed(i, free)

    def mixed(self) -> dict[tuple[int, int], PETSc.Mat]:
        """Second derivatives of couplings' equations by two bodies' unknowns."""
        found: dict[tuple[int, int], PETSc.Mat] = {}
        for rows, i, own in self.coupled:
            found |= dict(zip(((i, own), (own, i)), rows.mixed, strict=False))
        return found

    def check_coupled(self, values: Sequence[npt.NDArray], *, linear: bool = False):
        """Raise if prescribed displacements aren't those of a rigid coupling. Collective.

        Args:
            values: Displacements of each body with the prescribed ones, this rank's owned.
            linear: True for small rotations.

        Raises:
            InterfaceError: With the place and the values.
        """
        for k, (one, (_, i, _)) in enumerate(zip(self.couplings, self.coupled, strict=True)):
            held = one.component.of_body(self.prescribed[i])
            wrong = one.contradiction(one.component.of_body(values[i]), held, linear=linear)
            if wrong:
                raise InterfaceError(f"coupling {k}: {wrong}")

    def check_prescribed(self, values: Sequence[PETSc.Vec]):
        """Raise if both sides of a tie are prescribed, and differently. Collective.

        Args:
            values: The prescribed displacements of each body, zero elsewhere.

        Raises:
            InterfaceError: With the place and the values.
        """
        for t, (tie, bodies) in enumerate(zip(self._ties, self.sides, strict=True)):
            if tie.closes_gap or tie.gives_way is not None:
                continue
            size = max(values[body].norm(PETSc.NormType.INFINITY) for body in set(bodies))
            if size == 0 and tie.nodal_jump() is None:
                continue
            if t not in self._pairs:
                self._pairs[t] = self._both_prescribed(t)
            known = self._pairs[t]
            if known is None:
                continue
            pairs, both = known
            jump, given = tie.nodal_jump(), []
            for i, (part, body, dofs) in enumerate(zip(tie.components, bodies, pairs.dofs)):
                owned = part.of_body(values[body].array_r).reshape(-1, tie.block_size)
                given.append(values_at(tie, i, owned, dofs))
            at = None
            if jump is not None:
                side, nodal = jump
                at = values_at(tie, side, nodal, pairs.dofs[side])
            pairs.check(self._names[t], both, given, size, at)

    def _both_prescribed(self, t: int) -> tuple[Coincidences, npt.NDArray[np.bool_]] | None:
        """Coincident nodes of a tie, and the mask of components prescribed on both sides.

        None without any such component. Collective.
        """
        tie = self._ties[t]

        def held(i: int, dofs: npt.NDArray) -> npt.NDArray[np.bool_]:
            part = tie.components[i].of_body(self.prescribed[self.sides[t][i]])
            return prescribed_dofs(tie, i, part, dofs)

        if not all(held(i, np.unique(side.dofs)).any() for i, side in enumerate(tie.surfaces)):
            return None
        pairs = Coincidences(tie)
        both = held(0, pairs.dofs[0]) & held(1, pairs.dofs[1])
        return (pairs, both) if both.any() else None

    def multipliers(self, t: int, x: Sequence[PETSc.Vec]) -> npt.NDArray:
        """All multipliers λ = E λ' of a tie, ``(num_multipliers, block_size)``. Collective.

        Args:
            t: Number of the tie.
            x: λ' of each interface.
        """
        full = self._ties[t].blocks()[0].createVecLeft()
        full.set(0.0)
        for g, E in self._rows[t].items():
            E.add(x[g], full)
        values = full.array_r.copy()
        full.destroy()
        return values.reshape(-1, self._ties[t].block_size)

    def _fields_of(self, t: int, tie: Interface) -> tuple[int, int]:
        """Numbers of the components on both sides of a tie, among those that ties have."""
        found = []
        for side, part in enumerate(tie.components):
            body = part.among(self._spaces)
            if body is None:
                raise ValueError(
                    f"Γ{side} of {self._names[t]} is on a space that is in no form; make the tie "
                    "and the forms on the same function spaces."
                )
            others = [other for _, other in self._components]
            known = next((f for f, other in enumerate(others) if part.same(other)), None)
            if known is None:
                if any(part.overlaps(other) for other in others):
                    raise ValueError(
                        f"Γ{side} of {self._names[t]} and another tie's side are on a field and on "
                        "a component of it; tie the field's components one by one in both."
                    )
                known = len(self._components)
                self._components.append((body, part))
            found.append(known)
        return found[0], found[1]

    @staticmethod
    def _own_dofs(columns: Columns, tie: Interface) -> npt.NDArray[np.int64]:
        """Dofs of Γ1's body that answer to this rank's multipliers, of an interface."""
        part = tie.components[1]
        own = columns.own[(columns.rank == tie.domain.comm.rank) & (columns.own >= 0)]
        start = part.space.dofmap.index_map.local_range[0] * tie.block_size
        return part.global_dofs()[own - start]

    @staticmethod
    def _prescribed(V: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]) -> npt.NDArray[np.bool_]:
        """Mask of a body's owned dofs (unrolled) that are prescribed."""
        marker = np.zeros(V.dofmap.index_map.size_local * V.dofmap.index_map_bs, dtype=bool)
        for bc in bcs:
            dofs = bc.dof_indices()[0]  # 0.9 may count ghosts as owned
            marker[dofs[dofs < len(marker)]] = True
        return marker

    def _extensions(self, t: int, choice: Choice) -> dict[int, Extension]:
        """E with λ = Σ_g E_g λ'_g of a tie, by the interface g. Collective.

        Free interior nodes have multipliers of their own, which always remain.
        """
        tie, own = self._ties[t], self._of_tie.get(t)
        if own is not None and choice.complete[t] and len(choice.interfaces[own]) == 1:
            return {own: Extension()}
        comm, block_size = tie.domain.comm, tie.block_size
        i, group, j, value = choice.entries[t]
        multiplier, component = np.divmod(i, block_size)
        row = tie.constraint.rows[multiplier] * block_size + component
        start, end = np.multiply(tie.constraint.R_A.getOwnershipRangeColumn(), block_size)
        here = (start <= row) & (row < end)
        interior = np.setdiff1d(np.arange(start, end), row) if tie.free_interior else row[:0]
        offset = np.append(0, np.cumsum(comm.allgather(len(interior))))
        found = {}
        for g in sorted({*group.tolist(), *([] if own is None else [own])}):
            mine = here & (group == g)
            rank = choice.columns[g].rank
            num = int((rank == comm.rank).sum())
            rows, columns, values = row[mine], j[mine], value[mine]
            if g == own and tie.free_interior:
                columns = columns + offset[rank[columns]]
                last = np.searchsorted(rank, comm.rank, side="right") + offset[comm.rank]
                rows = np.concatenate((rows, interior))
                columns = np.concatenate((columns, last + np.arange(len(interior))))
                values = np.concatenate((values, np.ones(len(interior))))
                num += len(interior)
            found[g] = Extension(coo_matrix(comm, (end - start, num), rows, columns, values))
        return found

    def _pulled_back(self) -> list[list[PETSc.Mat | None]]:
        """Σ_t E_tᵀ B_t of all ties, ``[interface][field]``. Collective."""
        interior = len(self._spaces)
        self._num_fields = interior + len(self.interior_sizes) + len(self.jump_fields)
        full: list[list[PETSc.Mat | None]] = [[None] * self._num_fields for _ in self._interfaces]
        for t, (tie, bodies) in enumerate(zip(self._ties, self.sides, strict=True)):
            for i, B in zip((*bodies, interior), tie.blocks(), strict=False):
                for g, E in self._rows[t].items():
                    product = E.rows_of(B)
                    before = full[g][i]
                    if before is None:
                        full[g][i] = product
                    else:  # pieces of one interface, or both sides on one body
                        before.axpy(1.0, product)
                        product.destroy()
            interior += tie.free_interior
        for field, jump in enumerate(self.jump_fields, interior):
            for g, block in jump.blocks.items():
                full[g][field] = block
        return full

    def _couple(self, k: int, one: CoupledMotion) -> tuple[CouplingRows, int, int]:
        """Append a coupling's row of blocks; its equations and bodies. Collective."""
        body = one.component.among(self._spaces)
        if body is None:
            raise ValueError(
                f"coupling {k} is on a space that is in no form; make it and the forms on the same "
                "function spaces."
            )
        own = self._spaces.index(one.q.function_space)
        row: list[PETSc.Mat | None] = [None] * self._num_fields
        rows = CouplingRows(one, one.component.of_body(self.prescribed[body]))
        row[body], row[own] = rows.blocks
        self.full.append(row)
        return rows, body, own

    def _check_redundant(self):
        """Raise if distributing couplings hold what others hold, or conditions. Collective."""
        some = [k for k, one in enumerate(self.couplings) if not one.is_rigid and one.held.any()]
        if not some:
            return
        num = len(self.couplings[0].components)
        found = [np.zeros((len(held), num * len(some))) for held in self.prescribed]
        for s, k in enumerate(some):
            rows, i, _ = self.coupled[k]
            rows.add_means(found[i], num * s)
        comm = self._spaces[0].mesh.comm
        size = np.sqrt(comm.allreduce(sum((part**2).sum(axis=0) for part in found)))
        by_points = [np.diag(1.0 - np.concatenate([self.couplings[k].held for k in some]))]
        rigid = (of for of, one in zip(self.coupled, self.couplings) if one.is_rigid)
        by_points += [rows.drop_rigid(found[i]) for rows, i, _ in rigid]
        gram = comm.allreduce(sum(part.T @ part for part in found))
        gram += sum(part @ part.T for part in by_points)
        size = np.where(size > 0, size, 1.0)
        values, vectors = np.linalg.eigh(gram / np.outer(size, size))
        if values[0] > NOTHING:
            return
        part = np.abs(vectors[:, 0])
        s, component = divmod(int(np.flatnonzero(part > part.max() / 2)[-1]), num)
        one = self.couplings[some[s]]
        raise ValueError(
            f"coupling {some[s]} holds what others or boundary conditions hold already (its "
            f"{one.components[component]}): leave that out of its held=."
        )

    def _without_prescribed(self, i: int, B: PETSc.Mat | None) -> PETSc.Mat | None:
        """A block without the columns of prescribed dofs. Collective."""
        if B is None:
            return None
        B = B.copy()
        self._drop_prescribed(i, B)
        return B

    def _drop_prescribed(self, i: int, B: PETSc.Mat):
        """Set the columns of prescribed dofs to 0. Collective."""
        if i < len(self.prescribed):
            mask = B.createVecRight()
            mask.array[:] = ~self.prescribed[i]
            B.diagonalScale(R=mask)
            mask.destroy()

    def _check_lost_rows(self, t: int, lost: npt.NDArray[np.intp]):
        """Raise if rows without a multiplier face dofs of Γ0 that can move. Collective."""
        tie = self._ties[t]
        if not len(lost):
            return
        multiplier, component = np.divmod(lost, tie.block_size)
        lost = tie.constraint.rows[multiplier] * tie.block_size + component
        B0 = self._without_prescribed(self.sides[t][0], tie.blocks()[0])
        assert B0 is not None
        start, end = B0.getOwnershipRange()
        lost = lost[(start <= lost) & (lost < end)]
        indptr, _, values = B0.getValuesCSR()
        size = np.add.reduceat(np.append(np.abs(values), 0), indptr[:-1]) * (np.diff(indptr) > 0)
        largest = tie.domain.comm.allreduce(size.max(initial=0), MPI.MAX)
        untied = (size[lost - start] > NOTHING * largest).sum()
        B0.destroy()
        untied = tie.domain.comm.allreduce(int(untied))
        if untied:
            raise PrescribedSideError(
                f"{untied} displacements of Γ1 of {self._names[t]} are prescribed on whole facets "
                "while Γ0 can move there, so nothing would tie it; swap the sides of the tie.",
                t,
            )
