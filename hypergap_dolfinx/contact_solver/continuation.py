# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Newton steps taken backwards, shortened or lengthened.

Forces between bodies are continuous functions of the displacements, with kinks where nodes pass. A
branch of equilibria can end at a kink, for example where a corner ploughs with friction. The bodies
then snap to another branch, which Newton steps from both sides of the kink never find. Beyond such
an end the Newton step leads back to it, and the tangent does negative work on the step. Then a step
of the same length is taken backwards.

Newton steps d along one line are a sequence whose limit follows from two of them (Aitken's Δ²
process). If a share α of one step was taken, and the next step is r times that step, d vanishes at
the share α / (1 − r). So steps to and fro, as from a stiffness that changes within the step, are
halved. Steps that creep on, as from stiffness added to a tangent that isn't positive, are
lengthened.

Newton's method converges in a few steps, or its steps can go on without an end. So the first ones
are taken whole, also where forces grow for a while, as in a snap-through. Afterwards there is a
line search: a step d at whose end forces along it are reversed, dᵀR(u + d) ≥ −½ dᵀR(u) > 0, is
shortened to where they vanish, by a secant. R has the step's own pressures.
"""

from collections.abc import Callable, Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import (
    IN_LINE,
    OSCILLATES,
    PATIENCE,
    SHORTENED,
    TRIALS,
)

Moves = Sequence[npt.NDArray[np.float64]]


class Continuation:
    """Observer of Newton's iteration in one load step: decides on the lengths of steps."""

    def __init__(self, comm: MPI.Comm, least: float):
        """Start.

        Args:
            comm: Communicator of the bodies.
            least: Displacement treated as zero: shorter steps have no direction.
        """
        self._comm, self._num_back, self._square = comm, 0, 0.0
        self._least, self._along = least, 0.0
        self._num_steps, self._num_in_line, self._share = 0, 0, 1.0
        self._last: Moves | None = None

    def share(self, moves: Moves, work: float, forces: Callable[[], Moves] | None = None) -> float:
        """Share of the step to take, negative if backwards. Collective.

        Args:
            moves: This rank's increments of each body's displacements.
            work: Second-order work of the step.
            forces: Gives this rank's residual of each body at the step's start, with its pressures;
                None if :meth:`shortened` isn't to look at the step.
        """
        last = moves if self._last is None else self._last
        self._num_steps += 1
        left = forces() if forces and self._num_steps > TRIALS else ()
        sums = np.array([sum(map(np.dot, moves, other)) for other in (last, moves, left)])
        self._comm.Allreduce(MPI.IN_PLACE, sums)
        (product, square, along), before = sums, self._square
        turned = product < OSCILLATES * before
        in_line = before > 0 and abs(product) > IN_LINE * np.sqrt(square * before)
        self._num_in_line = self._num_in_line + 1 if in_line else 0
        moves_on = square > self._least**2
        share = 1.0
        if moves_on and turned and work < 0 and self._num_back < PATIENCE:
            share, self._num_back, self._num_in_line = -1.0, self._num_back + 1, 0
        elif moves_on and self._num_in_line > PATIENCE:
            falls = 1 / self._share - product / before  # over a whole step
            share = min(1 / falls, self._share / SHORTENED) if falls > 0 else 1.0
        self._last, self._square = [share * part for part in moves], share**2 * square
        self._share, self._along = share, along if share == 1 else 0.0
        return share

    def shortened(self, forces: Callable[[], Moves]) -> float:
        """Part of the last step to keep; 1 if the line search doesn't shorten it. Collective.

        Args:
            forces: Gives this rank's residual of each body at its end, with its pressures.
        """
        if self._along >= 0:
            return 1.0
        assert self._last is not None
        along, start = self._comm.allreduce(sum(map(np.dot, self._last, forces()))), self._along
        self._along = 0.0
        if along <= OSCILLATES * start:
            return 1.0
        part = float(max(start / (start - along), SHORTENED))
        self._last = [part * of for of in self._last]
        self._share, self._square = part * self._share, part**2 * self._square
        return part
