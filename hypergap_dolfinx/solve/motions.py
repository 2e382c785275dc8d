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

from dolfinx import fem
from hypergap_dolfinx.graph import components, parts
from hypergap_dolfinx.solve.blocks import ConstraintBlocks
from hypergap_dolfinx.solve.matrices import nonzero_columns, row_length
from hypergap_dolfinx.solve.modes import NOTHING, common_modes, rigid_modes


def free_motions(
    spaces: Sequence[fem.FunctionSpace], K: Sequence[PETSc.Mat], constraints: ConstraintBlocks
) -> int:
    """The number of rigid motions (constants of other fields) that nothing hinders. Collective.

    Parts of a mesh that aren't connected count as bodies, unless there are many. What ties connect
    moves together if nothing else holds it. Where tied surfaces don't coincide, such a rotation
    strains the tie a little; that is an error of the meshes and holds nothing either.

    Args:
        spaces: Space of each body.
        K: Assembled stiffness of each body.
        constraints: The ties.
    """
    comm = spaces[0].mesh.comm
    in_part = [parts(V) for V in spaces]
    moved = [
        rigid_modes(V, np.zeros(held.shape, dtype=bool), *numbered)
        for V, held, numbered in zip(spaces, constraints.prescribed, in_part, strict=True)
    ]
    return max(
        _free_alone(comm, moved, K, constraints),
        sum(
            _free_together(comm, spaces, K, constraints.prescribed, nodes)
            for nodes in _tied_groups(spaces, in_part, constraints)
        ),
    )


def _tied_groups(spaces, in_part, constraints: ConstraintBlocks) -> list[dict[int, npt.NDArray]]:
    """Groups of parts that ties connect: the bodies they are in, and which of their nodes."""
    comm = spaces[0].mesh.comm
    starts = np.cumsum([0, *(num for _, num in in_part)])
    pairs = [np.empty((0, 2), dtype=np.intp)]
    for row in constraints.full:  # prescribed dofs tie too
        touched = np.zeros(starts[-1], dtype=np.int32)
        for V, B, (part, _), start in zip(spaces, row, in_part, starts, strict=False):
            if B is not None:
                nodes = nonzero_columns(B) // V.dofmap.index_map_bs
                touched[start + part[nodes]] = 1
        tied = np.flatnonzero(comm.allreduce(touched))
        pairs.append(np.stack((np.repeat(tied[:1], max(len(tied) - 1, 0)), tied[1:]), axis=1))
    i, j = np.vstack(pairs).T
    group = components(starts[-1], i, j)
    return [
        {
            i: group[start + part] == g
            for i, (start, (part, num)) in enumerate(zip(starts, in_part))
            if g in group[start : start + num]
        }
        for g in range(group.max() + 1)
    ]


def _free_alone(comm, moved, K, constraints: ConstraintBlocks) -> int:
    """Motions of each body by itself, or of several with whatever the ties allow."""
    ends = np.cumsum([0, *(modes.shape[1] for modes in moved)])
    rows = []  # of this rank: forces of the motions on the bodies, on held dofs and on the ties

    def add(parts: dict[int, npt.NDArray]):
        """As few rows as some bodies have motions say as much."""
        R = np.linalg.qr(np.hstack(list(parts.values())), mode="r")
        rows.append(np.zeros((len(R), ends[-1])))
        rows[-1][:, np.concatenate([np.arange(ends[i], ends[i + 1]) for i in parts])] = R

    for i, modes in enumerate(moved):
        add({i: _forces(K[i], constraints.prescribed[i], modes)})
    for row in constraints.free:
        add(
            {
                i: _product(B, np.where(constraints.prescribed[i][:, None], 0, modes))
                for i, (B, modes) in enumerate(zip(row, moved, strict=False))
                if B is not None
            }
        )
    return _num_small(comm, np.vstack(rows))


def _free_together(comm, spaces, K, prescribed, nodes: dict[int, npt.NDArray]) -> int:
    """Motions of tied parts as one."""
    modes = common_modes([spaces[i] for i in nodes], list(nodes.values()))
    forces = [_forces(K[i], prescribed[i], part) for i, part in zip(nodes, modes, strict=True)]
    return _num_small(comm, np.vstack(forces))


def _forces(K: PETSc.Mat, held, modes):
    """Forces of motions on a body, and the motions of its held dofs; two rows a dof."""
    held = held[:, None]
    return np.vstack((_product(K, np.where(held, 0, modes)), np.where(held, modes, 0)))


def _num_small(comm, rows) -> int:
    """How many combinations of the columns are nothing."""
    R = np.linalg.qr(rows, mode="r")
    values = np.linalg.svd(np.vstack(comm.allgather(R)), compute_uv=False)
    return int((values < NOTHING * values.max(initial=1.0)).sum())


def _product(A: PETSc.Mat, columns) -> npt.NDArray[np.float64]:
    """A times columns, over the mean length of A's rows."""
    x, y = A.createVecs()
    size = row_length(A) or 1.0
    result = np.empty((A.getLocalSize()[0], columns.shape[1]))
    for k, column in enumerate(columns.T):
        x.array[:] = column
        A.mult(x, y)
        result[:, k] = y.array_r / size
    x.destroy()
    y.destroy()
    return result
