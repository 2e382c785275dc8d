# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Rigid motions of bodies, as columns over their dofs, and those that nothing hinders."""

from collections.abc import Sequence
from itertools import combinations, pairwise

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem, la
from hypergap_dolfinx.algebra.blocks import ConstraintBlocks
from hypergap_dolfinx.algebra.tolerances import APART, DEPENDENT, MOVES, NOTHING
from hypergap_dolfinx.core.graph import components, parts
from hypergap_dolfinx.core.sparse import (
    absolute,
    column_length,
    nonzero_columns,
    product,
    row_length,
)
from hypergap_dolfinx.surface.component import Component, lagrange_components
from hypergap_dolfinx.surface.trace import extents


def places(V: fem.FunctionSpace) -> npt.NDArray[np.float64]:
    """Positions of this rank's owned nodes, ``(num_nodes, n)``."""
    return V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local, : V.mesh.geometry.dim]


def moment(arms: npt.NDArray, forces: npt.NDArray) -> npt.NDArray:
    """Moment of forces ``(num, n)``: ``(3,)``, or ``(1,)`` in the plane."""
    if arms.shape[1] == 2:
        return (arms[:, 0] * forces[:, 1] - arms[:, 1] * forces[:, 0]).sum(keepdims=True)
    return np.cross(arms, forces).sum(axis=0)


def motions(
    V: fem.FunctionSpace,
    centre: npt.NDArray[np.float64] | None = None,
    x: npt.NDArray[np.float64] | None = None,
) -> npt.NDArray[np.float64]:
    """Rigid displacements of a body, constants of other fields. Collective.

    Args:
        V: Its space.
        centre: Centre of the rotations; the mean of the nodes if not given.
        x: Present positions of this rank's owned nodes; their :func:`places` if not given.

    Returns:
        This rank's owned rows, ``(num_dofs, num_modes)``.
    """
    n, block_size = V.mesh.geometry.dim, V.dofmap.index_map_bs
    x = places(V) if x is None else x
    planes = list(combinations(range(n), 2)) if V.value_shape == (n,) else []
    modes = np.zeros((len(x), block_size, block_size + len(planes)))
    modes[:, range(block_size), range(block_size)] = 1.0
    if planes:
        x = x - (mean(V.mesh.comm, [x]) if centre is None else centre)
    for mode, (i, j) in enumerate(planes, block_size):
        modes[:, i, mode], modes[:, j, mode] = x[:, j], -x[:, i]
    return modes.reshape(-1, modes.shape[2])


def rigid_modes(
    V: fem.FunctionSpace,
    prescribed: npt.NDArray[np.bool_],
    part: npt.NDArray[np.int32],
    num_parts: int,
    x: npt.NDArray[np.float64] | None = None,
) -> npt.NDArray[np.float64]:
    """A basis of the :func:`motions` of a body's parts, 0 where it is prescribed. Collective.

    Args:
        V: Its space.
        prescribed: Mask of the owned dofs (unrolled) that are prescribed.
        part: The part of each node, from :func:`hypergap_dolfinx.core.graph.parts`.
        num_parts: Number of parts.
        x: Its :func:`places`, if they are known.

    Returns:
        Orthonormal columns, this rank's owned rows, ``(num_dofs, num_modes)``.
    """
    part = np.repeat(part, V.dofmap.index_map_bs)[:, None]
    modes = np.where(prescribed[:, None], 0, motions(V, x=x))
    modes = np.hstack([np.where(part == p, modes, 0) for p in range(num_parts)])
    return orthonormal(V.mesh.comm, modes)


def orthonormal(comm: MPI.Comm, R: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Orthonormal columns that span those of R, with rows on all ranks. Collective."""
    R = R / np.sqrt(np.maximum(comm.allreduce((R**2).sum(axis=0)), 1e-300))
    values, vectors = np.linalg.eigh(comm.allreduce(R.T @ R))
    keep = values > DEPENDENT**2
    return R @ (vectors[:, keep] / np.sqrt(values[keep]))


def independent(comm: MPI.Comm, R: npt.NDArray[np.float64]) -> bool:
    """True if columns of about unit length, with rows on all ranks, are independent. Collective."""
    values = np.linalg.eigvalsh(comm.allreduce(R.T @ R))
    return bool(values.min(initial=np.inf) > DEPENDENT**2)


def mean(comm: MPI.Comm, x: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    """Mean of positions on all ranks. Collective."""
    total = sum(part.sum(axis=0) for part in x)
    return comm.allreduce(total) / comm.allreduce(sum(len(part) for part in x))


Field = tuple[int, Component]
"""A body and one of its fields: each field of a mixed space has motions of its own."""


def fields_of(spaces: Sequence[fem.FunctionSpace]) -> list[Field]:
    """The fields of bodies that can move rigidly, or be constant. Collective."""
    return [(i, part) for i, V in enumerate(spaces) for part in lagrange_components(V)]


def free_motions(
    spaces: Sequence[fem.FunctionSpace], K: Sequence[PETSc.Mat], constraints: ConstraintBlocks
) -> tuple[int, list[int]]:
    """Rigid motions (constants of other fields) that nothing hinders. Collective.

    Parts of a mesh that aren't connected count as bodies, unless there are many. Bodies that ties
    connect move together if nothing else holds them. If tied surfaces nearly coincide, such a
    rotation strains the tie a little; that is an error of the meshes and holds nothing. If they are
    apart (:data:`APART`), a rotation moves one side past the other, and the tie does hold it; a tie
    whose motion carries one side to the other is across a distance, however short.

    Args:
        spaces: Space of each body.
        K: Assembled stiffness of each body.
        constraints: The ties.

    Returns:
        Their number, and the numbers of the bodies that move.
    """
    fields = fields_of(spaces)
    if not fields:
        return 0, []
    comm = fields[0][1].space.mesh.comm
    in_part = [parts(part.space) for _, part in fields]
    x = [places(part.space) for _, part in fields]
    alone = []
    for (i, part), numbered, at in zip(fields, in_part, x, strict=True):
        nothing = np.zeros_like(part.of_body(constraints.prescribed[i]))
        alone.append(rigid_modes(part.space, nothing, *numbered, at))
    held = [part.of_body(constraints.prescribed[i]) for i, part in fields]
    if all(independent(comm, R[mask]) for R, mask in zip(alone, held, strict=True)):
        return 0, []  # each is held by what is prescribed on it
    hindrance = Hindrance(fields, K, constraints, alone)
    all_rows = [np.ones(_num_rows(row), dtype=bool) for row in constraints.free]
    groups, apart = tied_groups(fields, in_part, x, constraints)
    together = []
    for g in range(max(int(group.max()) for group in groups) + 1):
        moved = {f: group[in_part[f][0]] == g for f, group in enumerate(groups) if g in group}
        centre = mean(comm, [x[f][mask] for f, mask in moved.items()])
        common = []
        for f, mask in moved.items():
            V = fields[f][1].space
            mask = np.repeat(mask, V.dofmap.index_map_bs)
            common.append(comm.allreduce(alone[f][mask].T @ motions(V, centre, x[f])[mask]))
        together.append(np.zeros((hindrance.num, common[0].shape[1])))
        columns = np.concatenate([hindrance.columns[f] for f in moved])
        together[-1][columns] = np.vstack(common)
        together[-1] = orthonormal(MPI.COMM_SELF, together[-1])
    joint = np.hstack(together)
    free = hindrance.unhindered(all_rows), hindrance.unhindered(apart, joint) @ joint.T
    found = max(free, key=len)
    moves = np.linalg.norm(found, axis=0)
    moves = moves > MOVES * moves.max(initial=0.0)
    of_fields = zip(fields, hindrance.columns, strict=True)
    return len(found), sorted({i for (i, _), own in of_fields if moves[own].any()})


def _num_rows(row: Sequence[PETSc.Mat | None]) -> int:
    """This rank's rows of a row of blocks."""
    return next(B for B in row if B is not None).getLocalSize()[0]


def rotates(V: fem.FunctionSpace) -> bool:
    """True if a body's field is a displacement."""
    return V.value_shape == (V.mesh.geometry.dim,)


def _apart(
    fields: Sequence[Field],
    places: Sequence[npt.NDArray[np.float64]],
    num_bodies: int,
    sizes: Sequence[npt.NDArray[np.float64] | None],
    row: Sequence[PETSc.Mat | None],
) -> npt.NDArray[np.bool_]:
    """Mask of a tie's rows that tie surfaces which are apart, ``(num_rows,)``. Collective.

    A row's product with constants is 0, so that with positions is its weight times a distance.

    Args:
        fields: The bodies' fields.
        places: Positions of this rank's owned nodes of each.
        num_bodies: Number of bodies.
        sizes: Size of the cells around each node, of fields that are displacements.
        row: The tie's block on each field.
    """
    first = fields[0][1].space
    n, num_rows = first.mesh.geometry.dim, _num_rows(row)
    # The positions of free interior nodes are not known here
    if any(B is not None for B in row[num_bodies:]):
        return np.zeros(num_rows, dtype=bool)
    moment, weight, size = np.zeros((num_rows, n)), np.zeros(num_rows), np.zeros(num_rows)
    # Digits are few far from the origin, which may be anywhere, but the same for all bodies
    origin = first.mesh.comm.bcast(places[0][:1].sum(axis=0))
    for (i, part), x, h in zip(fields, places, sizes, strict=True):
        B = row[i]
        if B is None or h is None:
            continue
        columns = np.column_stack((x - origin, np.ones(len(x)), h))
        columns = part.into_body(np.repeat(columns, part.space.dofmap.index_map_bs, axis=0))
        moment += product(B, columns[:, :n]).real
        magnitudes = absolute(B)
        mine, weighted = product(magnitudes, columns[:, n:]).real.T
        magnitudes.destroy()
        weight += mine
        size = np.maximum(size, np.divide(weighted, mine, out=np.zeros(num_rows), where=mine > 0))
    # Half of the weight is on either side
    return 2 * np.linalg.norm(moment, axis=1) > APART * size * weight


def _cell_sizes(V: fem.FunctionSpace) -> npt.NDArray[np.float64]:
    """Mean extent of the cells around each of this rank's owned nodes, ``(num_nodes,)``."""
    nodes, topology = V.dofmap.index_map, V.mesh.topology
    cells = V.dofmap.list[: topology.index_map(topology.dim).size_local]
    extent = extents(V.tabulate_dof_coordinates()[cells])
    sums = []
    for values in (extent, np.ones(len(cells))):
        total = la.vector(nodes)
        weights: npt.NDArray[np.float64] = np.repeat(values, cells.shape[1])
        total.array[:] = np.bincount(cells.ravel(), weights, len(total.array))
        total.scatter_reverse(la.InsertMode.add)
        sums.append(total.array[: nodes.size_local])
    return sums[0] / sums[1]


def tied_groups(
    fields: Sequence[Field],
    in_part,
    places: Sequence[npt.NDArray[np.float64]],
    constraints: ConstraintBlocks,
) -> tuple[list[npt.NDArray[np.int32]], list[npt.NDArray[np.bool_]]]:
    """Groups of parts that ties without a distance connect. Collective.

    Args:
        fields: The bodies' fields.
        in_part: Part of each of their nodes, and the number of parts.
        places: Positions of this rank's owned nodes of each.
        constraints: The ties.

    Returns:
        The group of each part of each field, the same on every rank; and a mask of this rank's rows
        of each tie whose surfaces are apart.
    """
    num_bodies, tied_at_all = len(constraints.prescribed), bool(constraints.full)
    num_places = num_bodies + len(constraints.interior_sizes)
    sizes = [_cell_sizes(p.space) if tied_at_all and rotates(p.space) else None for _, p in fields]
    apart = [
        _apart(fields, places, num_bodies, sizes, row[:num_places]) | carried
        for row, carried in zip(constraints.full, constraints.carried(), strict=True)
    ]
    comm = fields[0][1].space.mesh.comm
    starts = np.cumsum([0, *(num for _, num in in_part)])
    # One displacement of several may be tied to a scalar: these don't move as one
    kinds = [part.space.dofmap.index_map_bs for _, part in fields]
    kind = np.repeat(kinds, np.diff(starts))
    pairs = [np.empty((0, 2), dtype=np.intp)]
    for row, far in zip(constraints.full, apart, strict=True):  # prescribed dofs tie too
        touched = np.zeros(starts[-1], dtype=np.int32)
        for (i, field), (part, _), start in zip(fields, in_part, starts, strict=False):
            B = row[i]
            if B is not None:
                mask = np.zeros(B.getLocalSize()[1], dtype=bool)
                mask[nonzero_columns(B, ~far)] = True
                nodes = np.flatnonzero(field.of_body(mask)) // field.space.dofmap.index_map_bs
                touched[start + part[nodes]] = 1
        touched = comm.allreduce(touched)
        for alike in set(kinds):
            tied = np.flatnonzero(touched * (kind == alike))
            pairs.append(np.stack((np.repeat(tied[:1], max(len(tied) - 1, 0)), tied[1:]), axis=1))
    i, j = np.vstack(pairs).T
    return np.split(components(starts[-1], i, j), starts[1:-1]), apart


class Hindrance:
    """Forces against rigid motions of bodies: of their stiffness, of supports and of ties."""

    def __init__(
        self,
        fields: Sequence[Field],
        K: Sequence[PETSc.Mat],
        constraints: ConstraintBlocks,
        moved: Sequence[npt.NDArray[np.float64]],
    ):
        """Measure them. Collective.

        Args:
            fields: The bodies' fields.
            K: Stiffness of each body.
            constraints: The ties.
            moved: The motions of each field, this rank's rows, ``(num_dofs, num_motions)``.
        """
        self._comm = K[0].comm.tompi4py()
        ends = np.cumsum([0, *(modes.shape[1] for modes in moved)])
        self.columns = [np.arange(*pair) for pair in pairwise(ends)]
        """Number of each field's motions among all."""
        self.num = int(ends[-1])
        """Number of motions."""
        held = [part.of_body(constraints.prescribed[i]) for i, part in fields]
        free = []  # on the bodies' dofs
        self._bodies = []  # columns and rows of each field
        for f, ((i, part), modes) in enumerate(zip(fields, moved, strict=True)):
            free.append(part.into_body(np.where(held[f][:, None], 0, modes)))
            # Fields have units of their own, and so have their columns
            dofs = part.dofs
            size = (row_length(K[i]) if dofs is None else column_length(K[i], dofs)) or 1.0
            rows = np.vstack((product(K[i], free[f]) / size, modes[held[f]]))
            self._bodies.append((self.columns[f], rows))
        self._ties = []
        for row in constraints.free:
            blocks = {i: B for i, B in enumerate(row[: len(K)]) if B is not None}
            # One for all blocks: the sum of the bodies' contributions is to vanish
            size = max(row_length(B) for B in blocks.values()) or 1.0
            of = [f for f, (i, _) in enumerate(fields) if i in blocks]
            forces = [product(blocks[fields[f][0]], free[f]) / size for f in of]
            self._ties.append((np.hstack([self.columns[f] for f in of]), np.hstack(forces)))

    def unhindered(self, rows, combinations: npt.NDArray | None = None) -> npt.NDArray:
        """Combinations of motions without any resistance. Collective.

        Args:
            rows: Mask of each tie's rows that hinder them.
            combinations: Combinations to choose from, in columns; all if not given.

        Returns:
            Orthonormal combinations of the motions or of those columns, ``(num_free, num)``.
        """
        found = [np.zeros((1, self.num))]  # on this rank: rows whose null space is free motions
        of_ties = [(at, part[mask]) for (at, part), mask in zip(self._ties, rows, strict=True)]
        for columns, part in (*self._bodies, *of_ties):
            R = np.linalg.qr(part, mode="r")  # at most as many rows as there are motions
            found.append(np.zeros((len(R), self.num), dtype=R.dtype))
            found[-1][:, columns] = R
        R = np.vstack(found)
        R = np.linalg.qr(R if combinations is None else R @ combinations, mode="r")
        R = np.vstack(self._comm.allgather(R))
        _, values, combinations = np.linalg.svd(R, full_matrices=False)
        return combinations[values < NOTHING * values.max(initial=1.0)]
