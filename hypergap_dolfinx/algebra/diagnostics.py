# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Which body goes where, for messages: what nothing holds, and what a failed load step lost."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.algebra.floating import FreeMotions
from hypergap_dolfinx.algebra.rigid_motions import mean, places
from hypergap_dolfinx.algebra.tolerances import ASTRAY, MOVES, ROTATES
from hypergap_dolfinx.core.collective import spot


class Strays:
    """Bodies that only contact holds, by their names."""

    def __init__(
        self, spaces: Sequence[fem.FunctionSpace], free: FreeMotions, names: Sequence[str]
    ):
        """Take what there is.

        Args:
            spaces: Space of each body.
            free: The motions that nothing but contact holds.
            names: Of the bodies, for messages.
        """
        self._spaces, self._free, self._names = spaces, free, names
        self._comm = spaces[0].mesh.comm
        sizes = [(free.at(i, 0 * places(V).ravel()) ** 2).sum() for i, V in enumerate(spaces)]
        sizes = np.sqrt(self._comm.allreduce(np.array(sizes)))
        self._moves = sizes > MOVES * sizes.max()

    def unheld(
        self,
        u: Sequence[npt.NDArray[np.float64]],
        holds: npt.NDArray[np.float64],
        num: int,
        friction: bool,
    ) -> str:
        """What is wrong where nothing holds bodies, and how they move if that is one motion.

        Collective.

        Args:
            u: This rank's owned displacements of each body, ``(num_dofs,)``.
            holds: What is in contact makes of the free motions, ``(num_rows, num_free)``.
            num: How many motions nothing holds.
            friction: Whether there is any.
        """
        slid = ": it fell or slid away, its load may be more than friction can hold"
        return (
            f"{num} rigid motion{'s'[: num > 1]} of the bodies {'are' if num > 1 else 'is'} held "
            f"by nothing, not even by contact{slid if friction else ' without friction'}: "
            f"{self._moving(u, holds)}; hold them by boundary conditions."
        )

    def _moving(self, u, holds) -> str:
        """The bodies that nothing holds, of the same arguments. Collective."""
        size = np.maximum(np.linalg.norm(holds, axis=1), 1e-300)
        every = np.vstack((holds / size[:, None], np.zeros((self._free.num,) * 2)))
        _, values, motions = np.linalg.svd(every)
        left = motions[values <= max(MOVES, values[-1])].T
        moving = [self._free.at(i, part) @ left for i, part in enumerate(u)]
        sizes = np.sqrt(self._comm.allreduce(np.array([(v**2).sum(axis=0) for v in moving])))
        told = []
        for i, (V, some) in enumerate(zip(self._spaces, sizes > MOVES * sizes.max(), strict=True)):
            if not some.any():
                continue
            x = places(V)
            v = moving[i][:, some.argmax()].reshape(x.shape)
            x, v = self._those_that_move(x + u[i].reshape(x.shape), v)
            how = f", {in_words(self._comm, x, v)}" if some.sum() == 1 else ""
            told.append(f"{self._names[i]}, at {spot(mean(self._comm, [x]))}{how}")
        return "; ".join(told)

    def _those_that_move(self, x, v):
        """Nodes of a body, of several parts perhaps, and how they move. Collective."""
        speed = np.linalg.norm(v, axis=1)
        on = speed > MOVES * self._comm.allreduce(speed.max(initial=0), MPI.MAX)
        return x[on], v[on]

    def lost(
        self,
        before: Sequence[npt.NDArray[np.float64]],
        now: Sequence[npt.NDArray[np.float64]],
        told: str,
    ) -> str:
        """Where a failed load step led what only contact holds, as a sentence. Collective.

        Args:
            before: This rank's owned displacements of each body where it started.
            now: Where it failed.
            told: What is told of that.
        """
        only, off = [], []
        for i, (V, start, end) in enumerate(zip(self._spaces, before, now, strict=True)):
            if not self._moves[i]:
                continue
            x = places(V)
            x, way = x + start.reshape(x.shape), (end - start).reshape(x.shape)
            middle, shift = mean(self._comm, [x]), mean(self._comm, [way])
            extent = 2 * np.sqrt(mean(self._comm, [(x - middle) ** 2]).sum())
            only.append(f"{self._names[i]} at {spot(middle)}")
            if np.isfinite(shift).all() and np.linalg.norm(shift) > ASTRAY * extent:
                off.append(
                    f"{only[-1]} had gone by {spot(shift)}: it falls, slides off or is ejected"
                )
        if off:
            return f" Then {'; '.join(off)}."
        known = not only or any(f"{one.split(' at ')[0]}," in told for one in only)
        return "" if known else f" Only contact holds {', '.join(only)}."

    def of(self, bodies: Sequence[int | None]) -> str:
        """Those of some bodies that only contact holds, by name."""
        some = [self._names[i] for i in bodies if i is not None and self._moves[i]]
        return " or ".join(some) or "a body"


def in_words(comm: MPI.Comm, x: npt.NDArray[np.float64], v: npt.NDArray[np.float64]) -> str:
    """A rigid motion in words. Collective.

    Args:
        comm: Communicator.
        x: This rank's places, ``(num, n)``.
        v: How they move, ``(num, n)``.
    """
    n, middle, shift = x.shape[1], mean(comm, [x]), mean(comm, [v])
    r, w = (np.pad(part, ((0, 0), (0, 3 - n))) for part in (x - middle, v - shift))
    square, num = comm.allreduce((r**2).sum()), comm.allreduce(len(x))
    inertia = square * np.eye(3) - comm.allreduce(r.T @ r)
    spin = np.linalg.pinv(inertia) @ comm.allreduce(np.cross(r, w).sum(axis=0))
    rate = np.linalg.norm(spin)
    if rate * np.sqrt(square / num) <= ROTATES * np.linalg.norm(shift):
        return f"along {_direction(shift)}"
    around = middle + (np.cross(spin, np.pad(shift, (0, 3 - n))) / rate**2)[:n]
    axis = f" on the axis {_direction(spin)}" if n == 3 else ""
    return f"that turns around {spot(around)}{axis}"


def _direction(v: npt.NDArray[np.float64]) -> str:
    """A vector of length 1, without what is round-off: the sign of a motion is that too."""
    v = np.round(v / np.linalg.norm(v), 3)
    return spot(v * np.sign(v[v != 0][0]))
