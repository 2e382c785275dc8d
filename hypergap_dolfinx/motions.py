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
from hypergap_dolfinx.blocks import ConstraintBlocks
from hypergap_dolfinx.substructures import motions, orthonormal, rigid_modes

SMALL = 1e-12  # force of a motion, over the largest there could be, that counts as none


def free_motions(
    spaces: Sequence[fem.FunctionSpace], K: Sequence[PETSc.Mat], constraints: ConstraintBlocks
) -> int:
    """The number of rigid motions (constants of other fields) that nothing hinders. Collective.

    A mesh counts as one body, also if it has several parts.

    Bodies that are tied move together if nothing else holds them. Where they don't coincide, such
    a rotation strains the tie a little; that is an error of the meshes and holds nothing either.

    Args:
        spaces: Space of each body.
        K: Assembled stiffness of each body.
        constraints: The ties.
    """
    comm = spaces[0].mesh.comm
    moved = [rigid_modes(V, np.zeros(held.shape, dtype=bool))
             for V, held in zip(spaces, constraints.prescribed, strict=True)]  # fmt: skip
    return max(
        _free_alone(comm, moved, K, constraints),
        sum(
            _free_together(comm, [spaces[i] for i in group], [K[i] for i in group],
                           [constraints.prescribed[i] for i in group])
            for group in _tied_groups(len(spaces), constraints.bodies)
        ),
    )  # fmt: skip


def _tied_groups(num_bodies: int, bodies: Sequence[tuple[int, int]]) -> list[list[int]]:
    """Bodies that ties connect."""
    group = list(range(num_bodies))
    for i0, i1 in bodies:
        group = [group[i0] if g == group[i1] else g for g in group]
    return [[i for i in range(num_bodies) if group[i] == g] for g in sorted(set(group))]


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


def _free_together(comm, spaces, K, prescribed) -> int:
    """Motions of tied bodies as one."""
    x = [V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local] for V in spaces]
    num = sum(V.dofmap.index_map.size_global for V in spaces)
    centre = comm.allreduce(sum(part.sum(axis=0) for part in x)) / num
    n = spaces[0].mesh.geometry.dim
    parts = [motions(V, centre[:n]) for V in spaces]
    together = orthonormal(comm, np.vstack(parts))
    parts = np.split(together, np.cumsum([len(part) for part in parts])[:-1])
    forces = [_forces(*body) for body in zip(K, prescribed, parts, strict=True)]
    return _num_small(comm, np.vstack(forces))


def _forces(K: PETSc.Mat, held, modes):
    """Forces of motions on a body, and the motions of its held dofs; two rows a dof."""
    held = held[:, None]
    return np.vstack((_product(K, np.where(held, 0, modes)), np.where(held, modes, 0)))


def _num_small(comm, rows) -> int:
    """How many combinations of the columns are nothing."""
    R = np.linalg.qr(rows, mode="r")
    values = np.linalg.svd(np.vstack(comm.allgather(R)), compute_uv=False)
    return int((values < SMALL * values.max(initial=1.0)).sum())


def _product(A: PETSc.Mat, columns) -> npt.NDArray[np.float64]:
    """A times columns, over the mean length of A's rows."""
    x, y = A.createVecs()
    size = (A.norm() / np.sqrt(A.getSize()[0] or 1)) or 1.0
    result = np.empty((A.getLocalSize()[0], columns.shape[1]))
    for k, column in enumerate(columns.T):
        x.array[:] = column
        A.mult(x, y)
        result[:, k] = y.array_r / size
    x.destroy()
    y.destroy()
    return result
