# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What helps Newton's iteration where it goes to and fro: bodies that are viscous for a while.

Forces between bodies are continuous, with kinks where nodes pass. At one of them an equilibrium can
end: where a corner ploughs with friction, bodies snap to another one, which Newton's steps from
both sides of the kink never find. Viscous ones flow there. That is pseudo-transient continuation:
the bodies' stiffness times a share is added to the tangent, and goes with the residual.
"""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

TURNS = -0.5
"""Cosine between steps from which they go to and fro."""
SHRINKS = 0.5
"""Length of a step, over the last one's, below which it ends even so."""
LONG = 3.0
"""Length of a step, over that of the load step's first one, from which it goes nowhere."""
NOISE = 1e-6
"""Length of a step, over that of the load step's first one, below which it is round-off's."""
SHARE = 0.3
"""Share of the bodies' stiffness at first."""
GROWS = 4.0
"""Times the share where steps turn again, or are longer than those that went to and fro."""
FALLS = 0.1
"""Times the share at least from step to step where the residual falls."""
LEAST = 1e-3
"""Share that is none."""
RELAXED = 50
"""Steps that are granted beside those of a load step."""


class Relaxation:
    """Of the iteration for one load step."""

    def __init__(self, comm: MPI.Comm):
        """None at first.

        Args:
            comm: Communicator of the bodies.
        """
        self._comm = comm
        self._last: Sequence[npt.NDArray[np.float64]] | None = None
        self._first = self._length = self._longest = self._residual = self._square = 0.0
        self._turns = self._exact = self.acts = False
        self.share = 0.0
        """Of the bodies' stiffness, to be added to the tangent."""

    def look(self, residual: float):
        """Choose the share for the next step.

        Args:
            residual: Of the forces.
        """
        if self.acts and self._turns:
            self.share = max(GROWS * self.share, SHARE)
        elif self.acts:
            self.share *= min(max(residual / max(self._residual, 1e-300), FALLS), 1)
            self.share *= self.share > LEAST
        elif self._turns and self._exact:
            self.acts, self.share, self._longest = True, SHARE, self._length
        self._residual, self._turns = residual, False

    def takes(self, moves: Sequence[npt.NDArray[np.float64]], *, exact: bool) -> bool:
        """Whether a step isn't too long. Collective.

        Args:
            moves: This rank's changes of displacements, of each body.
            exact: Whether it was made with the exact tangent: else that may be why it turns, or why
                the next one does.
        """
        corrects, self._exact = not self._exact, exact
        last = moves if self._last is None else self._last
        sums = np.array([sum(map(np.dot, moves, other)) for other in (last, moves)])
        self._comm.Allreduce(MPI.IN_PLACE, sums)
        product, square = sums
        self._length = np.sqrt(square)
        self._first = self._first or self._length
        if self._length > (self._longest if self.acts else LONG * self._first) and exact:
            self._turns, self._length = True, self._first
            return False
        least = max(SHRINKS * np.sqrt(self._square), NOISE * self._first)
        turned = product < TURNS * np.sqrt(square * self._square)
        turned &= self._length > least
        self._turns = turned and (self.acts or not corrects)
        self._last, self._square = moves, square
        return True
