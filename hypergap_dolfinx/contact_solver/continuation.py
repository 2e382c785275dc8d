# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What is done with Newton steps that lead nowhere: searched along, taken backwards, given up.

Forces between bodies are continuous, with kinks where nodes pass. At a kink a branch of equilibria
can end: where a corner ploughs with friction, bodies snap to another branch, which Newton steps
from both sides of the kink never find. Beyond such an end the tangent does negative work on the
Newton step, which leads back to it: then a step of the same length is taken backwards.
"""

from collections.abc import Callable, Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import (
    BACK,
    DECREASE,
    OSCILLATES,
    PATIENCE,
    PROGRESS,
    STALLED,
    TRIALS,
)


class Continuation:
    """Newton's iteration in one load step, seen from outside."""

    def __init__(self, comm: MPI.Comm):
        """Start.

        Args:
            comm: Communicator of the bodies.
        """
        self._comm = comm
        self._least, self._since, self._num_back = np.inf, 0, 0
        self._last: Sequence[npt.NDArray[np.float64]] | None = None
        self._square = 0.0

    def update(self, residual: float):
        """Take the residual before a step.

        Args:
            residual: Its size.
        """
        self._since = 0 if residual <= PROGRESS * self._least else self._since + 1
        self._least = min(self._least, residual)

    @property
    def searches(self) -> bool:
        """True if steps are to be searched along."""
        return self._since >= PATIENCE

    @property
    def stalls(self) -> bool:
        """True if the iteration makes no progress."""
        return self._since >= STALLED

    def goes_back(self, moves: Sequence[npt.NDArray[np.float64]], work: float) -> bool:
        """True if a step is to be taken backwards. Collective.

        Args:
            moves: This rank's increments of each body's displacements.
            work: Second-order work of the step.
        """
        last = moves if self._last is None else self._last
        sums = np.array([sum(map(np.dot, moves, other)) for other in (last, moves)])
        self._comm.Allreduce(MPI.IN_PLACE, sums)
        product, square = sums
        turned = product < OSCILLATES * np.sqrt(square * self._square)
        back = bool(turned and work < 0 and self._num_back < BACK)
        self._last, self._square = [(1 - 2 * back) * part for part in moves], square
        self._num_back += back
        return back


def searched(at: Callable[[float], tuple[float, float]]) -> float:
    """Share of a step to take: of decrease in an energy and a penalty, 1 if none is found.

    The energy isn't known; its changes are those of its slopes by Simpson's rule.

    Args:
        at: Slope of the energy along the step and the penalty, at a share of the step.
    """
    (start, before), (last, after), share = at(0.0), at(1.0), 1.0
    for _ in range(TRIALS):
        middle, between = at(share / 2)
        change = share / 6 * (start + 4 * middle + last) + after - before
        if change <= DECREASE * share * min(start - before, 0):
            return share
        share, last, after = share / 2, middle, between
    return 1.0
