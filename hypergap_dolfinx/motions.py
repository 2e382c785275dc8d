# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Rigid motions that neither boundary conditions nor ties hinder."""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from hypergap_dolfinx.blocks import ConstraintBlocks
from hypergap_dolfinx.substructures import rigid_modes

SMALL = 1e-12  # force of a motion, over the largest there could be, that counts as none


def free_motions(
    spaces: Sequence[fem.FunctionSpace], K: Sequence[PETSc.Mat], constraints: ConstraintBlocks
) -> int:
    """The number of rigid motions (constants of other fields) without any force. Collective.

    Args:
        spaces: Space of each body.
        K: Assembled stiffness of each body.
        constraints: The ties.
    """
    columns = []  # of this rank: forces of each motion on the bodies, the held dofs and the ties
    for i, V in enumerate(spaces):
        held = constraints.prescribed[i]
        x = K[i].createVecRight()
        blocks = [row[i] for row in constraints.free]
        for mode in rigid_modes(V, np.zeros_like(held)).T:
            x.array[:] = np.where(held, 0, mode)
            forces = [_product(A, x) for A in (K[i], *blocks)]
            zero = [np.zeros(2 * A.getLocalSize()[0]) for A in K]
            zero[i] = np.concatenate((forces[0], np.where(held, mode, 0)))
            rows = [next(B for B in row if B is not None) for row in constraints.free]
            ties = [
                np.zeros(B.getLocalSize()[0]) if f is None else f
                for B, f in zip(rows, forces[1:], strict=True)
            ]
            columns.append(np.concatenate((*zero, *ties)))
        x.destroy()
    R = np.linalg.qr(np.column_stack(columns), mode="r")
    values = np.linalg.svd(np.vstack(spaces[0].mesh.comm.allgather(R)), compute_uv=False)
    return int((values < SMALL * values.max(initial=1.0)).sum())


def _product(A: PETSc.Mat | None, x: PETSc.Vec):
    """A x over the mean length of A's rows, or None."""
    if A is None:
        return None
    y = A.createVecLeft()
    A.mult(x, y)
    values = y.array_r / ((A.norm() / np.sqrt(A.getSize()[0])) or 1.0)
    y.destroy()
    return values
