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

Around a kink steps can also go in cycles that aren't along one line. Then none of them is shorter
than the shortest so far. Once that has failed, and the load step was halved for it, they are halved
until one is shorter.
"""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import IN_LINE, OSCILLATES, PATIENCE, SHORTENED


class Continuation:
    """Observer of Newton's iteration in one load step: decides on the lengths of steps."""

    def __init__(self, comm: MPI.Comm, least: float, *, damps: bool = True):
        """Start.

        Args:
            comm: Communicator of the bodies.
            least: Displacement treated as zero: shorter steps have no direction.
            damps: True if steps in cycles are halved.
        """
        self._comm, self._num_back, self._square = comm, 0, 0.0
        self._least, self._damps = least, damps
        self._num_in_line, self._share = 0, 1.0
        self._shortest, self._num_longer = np.inf, 0
        self._last: Sequence[npt.NDArray[np.float64]] | None = None

    def share(self, moves: Sequence[npt.NDArray[np.float64]], work: float) -> float:
        """Share of the step to take, negative if backwards. Collective.

        Args:
            moves: This rank's increments of each body's displacements.
            work: Second-order work of the step.
        """
        last = moves if self._last is None else self._last
        sums = np.array([sum(map(np.dot, moves, other)) for other in (last, moves)])
        self._comm.Allreduce(MPI.IN_PLACE, sums)
        (product, square), before = sums, self._square
        turned = product < OSCILLATES * before
        in_line = before > 0 and abs(product) > IN_LINE * np.sqrt(square * before)
        self._num_in_line = self._num_in_line + 1 if in_line else 0
        moves_on = square > self._least**2
        share = 1.0
        if moves_on and turned and work < 0 and self._num_back < PATIENCE:
            share, self._num_back, self._num_in_line = -1.0, self._num_back + 1, 0
            self._shortest = np.inf  # it leads elsewhere
        elif moves_on and self._num_in_line > PATIENCE:
            falls = 1 / self._share - product / before  # over a whole step
            share = min(1 / falls, self._share / SHORTENED) if falls > 0 else 1.0
        elif moves_on and self._damps:
            share = 0.5 ** self._cycles(square)
        self._last, self._square = [share * part for part in moves], share**2 * square
        self._share = share
        return share

    def _cycles(self, square: float) -> int:
        """Times that no step of several was shorter than all before, since one was."""
        self._num_longer = 0 if square < self._shortest else self._num_longer + 1
        self._shortest = min(square, self._shortest)
        return self._num_longer // (PATIENCE + 1)
