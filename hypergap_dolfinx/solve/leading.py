# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Rigid motions that prescribed displacements lead bodies along: linear ones distort what turns."""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

SPREAD = 1e-12
"""Square of the extent of points, over that of their longest direction, that says nothing of how
a body turns around it."""
TURNS = 1e-10
"""Turn that is none but for round-off."""
TOGETHER = 0.5
"""How one turns against the other, over how they turn, from which they don't turn together."""


@dataclass(frozen=True)
class RigidMotion:
    """A rotation around a point, which then goes to another."""

    turn: npt.NDArray[np.float64]
    """``(n, n)``."""
    start: npt.NDArray[np.float64]
    end: npt.NDArray[np.float64]

    @property
    def turns(self) -> bool:
        """Whether it turns at all."""
        return bool(np.linalg.norm(self.turn - np.eye(len(self.end))) > TURNS)

    def shift(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """By how much points move, ``(num, n)`` each."""
        return (x - self.start) @ self.turn.T + self.end - x


def leading(
    comm: MPI.Comm, x: npt.NDArray[np.float64], moves: npt.NDArray[np.float64]
) -> RigidMotion | None:
    """The rigid motion that is nearest to how points move, if they tell it. Collective.

    Args:
        comm: Communicator.
        x: This rank's points, ``(num, n)``.
        moves: How they move, ``(num, n)``.
    """
    n, ends = x.shape[1], np.stack((x, x + moves))
    num = comm.allreduce(len(x))
    if not num:
        return None
    if not comm.allreduce(bool(moves.any()), MPI.LOR):
        return RigidMotion(np.eye(n), np.zeros(n), np.zeros(n))
    middles = ends.sum(axis=1)
    comm.Allreduce(MPI.IN_PLACE, middles)
    middles /= num
    before, after = ends - middles[:, None]
    products = np.array((before.T @ before, after.T @ before))
    comm.Allreduce(MPI.IN_PLACE, products)
    square, product = products
    extents = np.linalg.eigvalsh(square)
    if extents[1 - n] <= SPREAD * extents[-1]:
        return None
    left, _, right = np.linalg.svd(product)
    left[:, -1] *= np.linalg.det(left @ right)  # no reflection
    return RigidMotion(left @ right, *middles)


def turns_together(a: RigidMotion, b: RigidMotion) -> bool:
    """Whether two motions turn with each other, rather than one against the other.

    Args:
        a: A motion.
        b: Another one.
    """
    one = np.eye(len(a.end))
    most = max(np.linalg.norm(motion.turn - one) for motion in (a, b))
    return bool(most > TURNS and np.linalg.norm(a.turn - b.turn) < TOGETHER * most)
