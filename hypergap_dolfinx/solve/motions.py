# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Rigid motions that neither boundary conditions nor ties hinder."""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem, la
from hypergap_dolfinx.graph import components, parts
from hypergap_dolfinx.solve.blocks import ConstraintBlocks
from hypergap_dolfinx.solve.matrices import absolute, nonzero_columns, product, row_length
from hypergap_dolfinx.solve.modes import NOTHING, common_modes, places, rigid_modes

APART = 0.5
"""Distance across a tie, over the size of the cells beside it, from which on that isn't an error of
the meshes. Closed rings of 12 and 20 cells have 0.05, polygons of 3 edges in rings of 7 up to 0.28;
blocks that are one cell apart 0.74 with 3 cells on 4, and 0.99 with 4 on 4."""

Modes = dict[int, npt.NDArray[np.float64]]
"""For each body, this rank's rows of motions that bodies make together, ``(num_dofs, num_modes)``.
"""


def free_motions(
    spaces: Sequence[fem.FunctionSpace], K: Sequence[PETSc.Mat], constraints: ConstraintBlocks
) -> int:
    """The number of rigid motions (constants of other fields) that nothing hinders. Collective.

    Parts of a mesh that aren't connected count as bodies, unless there are many. What ties connect
    moves together if nothing else holds it. Where tied surfaces nearly coincide, such a rotation
    strains the tie a little; that is an error of the meshes and holds nothing. Where they are apart
    (:data:`APART`), a rotation moves one side past the other, and the tie does hold it.

    Args:
        spaces: Space of each body.
        K: Assembled stiffness of each body.
        constraints: The ties.
    """
    in_part = [parts(V) for V in spaces]
    alone: list[Modes] = [
        {i: rigid_modes(V, np.zeros(held.shape, dtype=bool), *numbered)}
        for i, (V, held, numbered) in enumerate(
            zip(spaces, constraints.prescribed, in_part, strict=True)
        )
    ]
    every = [np.ones(_num_rows(row), dtype=bool) for row in constraints.free]
    groups, apart = tied_groups(spaces, in_part, constraints)
    together: list[Modes] = []
    for g in range(max(int(group.max()) for group in groups) + 1):
        nodes = {i: group[in_part[i][0]] == g for i, group in enumerate(groups) if g in group}
        modes = common_modes([spaces[i] for i in nodes], list(nodes.values()))
        together.append(dict(zip(nodes, modes, strict=True)))
    return max(_num_free(K, constraints, alone, every), _num_free(K, constraints, together, apart))


def _num_rows(row: Sequence[PETSc.Mat | None]) -> int:
    """This rank's rows of a row of blocks."""
    return next(B for B in row if B is not None).getLocalSize()[0]


def _rotates(V: fem.FunctionSpace) -> bool:
    """Whether a body's field is a displacement."""
    return V.value_shape == (V.mesh.geometry.dim,)


def _apart(
    spaces: Sequence[fem.FunctionSpace],
    sizes: Sequence[npt.NDArray[np.float64] | None],
    row: Sequence[PETSc.Mat | None],
) -> npt.NDArray[np.bool_]:
    """Which of a tie's rows tie what is apart, ``(num_rows,)``. Collective.

    A row makes nothing of constants; so what it makes of positions is its weight times a distance.

    Args:
        spaces: Space of each body.
        sizes: Size of the cells around each node, of bodies that have displacements.
        row: The tie's block on each field.
    """
    n, num_rows = spaces[0].mesh.geometry.dim, _num_rows(row)
    # Nobody here knows where free interior nodes are
    if any(B is not None for B in row[len(spaces) :]):
        return np.zeros(num_rows, dtype=bool)
    moment, weight, size = np.zeros((num_rows, n)), np.zeros(num_rows), np.zeros(num_rows)
    for V, h, B in zip(spaces, sizes, row, strict=False):
        if B is None or h is None:
            continue
        x = places(V)
        # Digits are few far from the origin, which may be anywhere, but the same for all bodies
        origin = spaces[0].mesh.comm.bcast(places(spaces[0])[:1].sum(axis=0))
        columns = np.column_stack((x - origin, np.ones(len(x)), h))
        columns = np.repeat(columns, V.dofmap.index_map_bs, axis=0)
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
    extent = np.ptp(V.tabulate_dof_coordinates()[cells], axis=1).max(axis=1, initial=0.0)
    sums = []
    for values in (extent, np.ones(len(cells))):
        total = la.vector(nodes)
        total.array[:] = 0.0
        np.add.at(total.array, cells, values[:, None])
        total.scatter_reverse(la.InsertMode.add)
        sums.append(total.array[: nodes.size_local])
    return sums[0] / sums[1]


def tied_groups(
    spaces: Sequence[fem.FunctionSpace], in_part, constraints: ConstraintBlocks
) -> tuple[list[npt.NDArray[np.int32]], list[npt.NDArray[np.bool_]]]:
    """Groups of parts that ties without a distance connect. Collective.

    Args:
        spaces: Space of each body.
        in_part: Part of each of its nodes, and their number.
        constraints: The ties.

    Returns:
        The group of each part of each body, the same on every rank; and which of this rank's rows
        of each tie tie what is apart.
    """
    sizes = [_cell_sizes(V) if constraints.full and _rotates(V) else None for V in spaces]
    apart = [_apart(spaces, sizes, row) for row in constraints.full]
    comm = spaces[0].mesh.comm
    starts = np.cumsum([0, *(num for _, num in in_part)])
    pairs = [np.empty((0, 2), dtype=np.intp)]
    for row, far in zip(constraints.full, apart, strict=True):  # prescribed dofs tie too
        touched = np.zeros(starts[-1], dtype=np.int32)
        for V, B, (part, _), start in zip(spaces, row, in_part, starts, strict=False):
            if B is not None:
                nodes = nonzero_columns(B, ~far) // V.dofmap.index_map_bs
                touched[start + part[nodes]] = 1
        tied = np.flatnonzero(comm.allreduce(touched))
        pairs.append(np.stack((np.repeat(tied[:1], max(len(tied) - 1, 0)), tied[1:]), axis=1))
    i, j = np.vstack(pairs).T
    return np.split(components(starts[-1], i, j), starts[1:-1]), apart


def _num_free(
    K: Sequence[PETSc.Mat], constraints: ConstraintBlocks, moved: Sequence[Modes], rows
) -> int:
    """How many combinations of motions nothing hinders. Collective."""
    return len(unhindered(K, constraints, moved, rows))


def unhindered(
    K: Sequence[PETSc.Mat], constraints: ConstraintBlocks, moved: Sequence[Modes], rows
) -> npt.NDArray:
    """The combinations of motions that nothing hinders. Collective.

    Args:
        K: Stiffness of each body.
        constraints: The ties.
        moved: The motions.
        rows: Which rows of each tie hinder them.

    Returns:
        Orthonormal, ``(num_free, num_motions)``.
    """
    comm, prescribed = K[0].comm.tompi4py(), constraints.prescribed
    ends = np.cumsum([0, *(next(iter(modes.values())).shape[1] for modes in moved)])
    found = [np.zeros((1, ends[-1]))]  # of this rank: what holds the motions

    def add(parts: dict[int, npt.NDArray]):
        """As few rows as some motions are say as much."""
        if parts:
            R = np.linalg.qr(np.hstack(list(parts.values())), mode="r")
            found.append(np.zeros((len(R), ends[-1]), dtype=R.dtype))
            columns = [np.arange(ends[m], ends[m + 1]) for m in parts]
            found[-1][:, np.concatenate(columns)] = R

    for i, (k, held) in enumerate(zip(K, prescribed, strict=True)):
        mine = {m: modes[i] for m, modes in enumerate(moved) if i in modes}
        size, held = row_length(k) or 1.0, held[:, None]
        add(
            {
                m: np.vstack(
                    (product(k, np.where(held, 0, modes)) / size, np.where(held, modes, 0))
                )
                for m, modes in mine.items()
            }
        )
    for row, hinder in zip(constraints.free, rows, strict=True):
        blocks = {i: B for i, B in enumerate(row[: len(K)]) if B is not None}
        # One for all: what the bodies' motions make together is to vanish as it does
        size = max(row_length(B) for B in blocks.values()) or 1.0
        parts = {}
        for m, modes in enumerate(moved):
            both = [i for i in blocks if i in modes]
            if both:
                forces = [
                    product(blocks[i], np.where(prescribed[i][:, None], 0, modes[i])) for i in both
                ]
                parts[m] = np.sum(forces, axis=0)[hinder] / size
        add(parts)
    R = np.linalg.qr(np.vstack(found), mode="r")
    _, values, combinations = np.linalg.svd(np.vstack(comm.allgather(R)), full_matrices=False)
    return combinations[values < NOTHING * values.max(initial=1.0)]
