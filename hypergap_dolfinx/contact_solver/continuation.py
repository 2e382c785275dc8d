# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Newton steps taken backwards, shortened or lengthened.

Forces between bodies are continuous functions of the displacements, with kinks where nodes pass. A
branch of equilibria can end at a kink, for example where a corner ploughs with friction. The bodies
then snap to another branch, which Newton steps from both sides of the kink never find. Beyond such
an end the Newton step leads back to it, and the tangent does negative work on the step. Then a step
of the same length is taken backwards.

Along other steps d there is a line search for the place where the forces along them, dᵀR, vanish.
R has the step's own pressures. It goes by secants, and ends where less than half of the forces is
left, or reversed.

- Where stiffness was added to a tangent that isn't positive, steps are too short, and at their ends
  the forces may even have grown: a body snaps. Such a step is lengthened, up to the longest step of
  the load step.
- Where a step turns back, and the forces along it are reversed by a jump, it ends at that kink
  (:mod:`~hypergap_dolfinx.contact_solver.kinks`).
- Newton's method converges in a few steps, or its steps can go on without an end. So the first ones
  are taken whole also where forces along them are reversed: a slender body that turns is stretched,
  and the next step takes that back. Later ones are shortened.
"""

from collections.abc import Callable, Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import OSCILLATES, PATIENCE, SHORTENED

Moves = Sequence[npt.NDArray[np.float64]]


class Continuation:
    """Observer of Newton's iteration in one load step: decides on the lengths of steps."""

    def __init__(self, comm: MPI.Comm, least: float):
        """Start.

        Args:
            comm: Communicator of the bodies.
            least: Displacement treated as zero: shorter steps have no direction.
        """
        self._comm, self._least = comm, least
        self._num_steps, self._num_back, self._is_stiffened = 0, 0, False
        self._square, self._longest, self._along = 0.0, 0.0, 0.0
        self._last_place, self._place = 0.0, 1.0
        self._turns_back = False
        self._last: Moves | None = None

    def share(
        self,
        moves: Moves,
        work: float,
        forces: Callable[[], Moves] | None = None,
        is_stiffened: bool = False,
    ) -> float:
        """Share of the step to take first: 1, or -1 if backwards. Collective.

        Args:
            moves: This rank's increments of each body's displacements.
            work: Second-order work of the step.
            forces: Gives this rank's residual of each body at the step's start, with its pressures;
                None for a step without a line search.
            is_stiffened: True if stiffness was added for this step.
        """
        last = moves if self._last is None else self._last
        self._num_steps, self._is_stiffened = self._num_steps + 1, is_stiffened
        product, square = self._products(moves, last, moves)
        before = self._square
        self._last, self._square, self._along = moves, square, 0.0
        self._last_place, self._place = 0.0, 1.0
        self._longest = max(self._longest, square)
        largest = max((float(np.abs(part).max(initial=0)) for part in moves), default=0.0)
        if self._comm.allreduce(largest, MPI.MAX) <= self._least:
            return 1.0
        self._turns_back = product < OSCILLATES * before
        if self._turns_back and work < 0 and self._num_back < PATIENCE:
            self._num_back, self._last = self._num_back + 1, [-part for part in moves]
            return -1.0
        if forces and (is_stiffened or self._turns_back or self._num_steps > PATIENCE):
            (self._along,) = self._products(moves, forces())
        return 1.0

    def _products(self, moves: Moves, *others: Moves) -> npt.NDArray[np.float64]:
        """Products of increments with others or with forces. Collective."""
        sums = np.array([sum(map(np.dot, moves, other)) for other in others], dtype=float)
        self._comm.Allreduce(MPI.IN_PLACE, sums)
        return sums

    def factor(
        self,
        forces: Callable[[], Moves],
        reaches_kink: Callable[[float, float], bool] = lambda start, end: False,
    ) -> float:
        """Factor by which the line search changes the last step; 1 where it ends. Collective.

        Args:
            forces: Gives this rank's residual of each body at the step's end, with its pressures.
            reaches_kink: Goes to a kink that reverses the forces along the step, from those at its
                start and at its end; false if there is none.
        """
        if self._along >= 0:
            return 1.0
        assert self._last is not None
        place, last_place, start, self._along = self._place, self._last_place, self._along, 0.0
        along = self._comm.allreduce(sum(map(np.dot, self._last, forces()))) / place
        left = along / start
        if self._is_stiffened and left > -OSCILLATES:
            if self._square > SHORTENED**2 * self._longest:
                return 1.0
            self._along = along
        elif left > OSCILLATES or (self._turns_back and reaches_kink(start, along)):
            return 1.0
        elif not self._is_stiffened and self._num_steps <= PATIENCE:
            return 1.0
        zero = last_place + (place - last_place) / max(1 - left, SHORTENED**2)
        factor = float(np.clip(zero / place, SHORTENED, 1 / SHORTENED))
        self._last_place = place
        self._scale(factor)
        return factor

    def shorten(self) -> float:
        """Factor that shortens a step at whose end there is no residual; its search ends."""
        self._along = 0.0
        self._scale(SHORTENED)
        return SHORTENED

    def _scale(self, factor: float):
        """Take another length of the last step, by this factor."""
        self._last = [factor * part for part in self._last or []]
        self._square, self._place = factor**2 * self._square, factor * self._place
