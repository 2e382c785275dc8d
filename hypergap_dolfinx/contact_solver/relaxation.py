# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What helps Newton's iteration where it goes to and fro, or too far.

Forces between bodies are continuous, with kinks where nodes pass. At one of them an equilibrium can
end: where a corner ploughs with friction, bodies snap to another one, which Newton's steps from
both sides of the kink never find. Viscous bodies flow there.

Beyond such an end the tangent does negative work on Newton's step, which leads back to it: bodies
flow the other way, and by the same length if they are just so viscous that the tangent's work
becomes positive as it was negative. Where that isn't it, they are viscous for a while. That is
pseudo-transient continuation: the bodies' stiffness times a share is added to the tangent, and goes
with the residual. Before all this, a step after which residuals are much larger is shortened.
"""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import (
    BACK,
    FALLS,
    GROWS,
    LEAST,
    LONG,
    MOST,
    NOISE_RELAXATION,
    OSCILLATES,
    REFUSED,
    SHARE,
    SHORTENED,
    SHORTEST,
    SHRINKS,
    WORSE,
)


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
        self._judges, self._num_shortened, self._num_back, self._num_refused = False, 0, 0, 0
        self.share = 0.0
        """Of the bodies' stiffness, to be added to the tangent."""

    def update(self, residual: float):
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

    @property
    def creeps(self) -> bool:
        """Whether it leads nowhere."""
        return self.share > MOST

    def shortens(self, residual: float) -> bool:
        """Whether less is to be taken of the last step.

        Args:
            residual: Of the forces, where it led; no number if cells are inverted there.
        """
        worst = WORSE * self._residual if self._judges else np.inf
        if self._last is None or residual <= worst or self._num_shortened == SHORTEST:
            return False
        self._num_shortened += 1
        self._last = [SHORTENED * part for part in self._last]
        self._square *= SHORTENED**2
        return True

    def takes(self, moves: Sequence[npt.NDArray[np.float64]], work: float, *, exact: bool) -> float:
        """How much of a step is to be taken: 1, none if it is too long, or back. Collective.

        Args:
            moves: This rank's changes of displacements, of each body.
            work: That of the tangent on them.
            exact: Whether it was made with the exact tangent: else that may be why it turns, or why
                the next one does.
        """
        corrects, self._exact = not self._exact, exact
        self._judges = exact and self._last is not None and not self.acts
        self._num_shortened = 0
        last = moves if self._last is None else self._last
        sums = np.array([sum(map(np.dot, moves, other)) for other in (last, moves)])
        self._comm.Allreduce(MPI.IN_PLACE, sums)
        product, square = sums
        self._length = np.sqrt(square)
        self._first = self._first or self._length
        least = max(SHRINKS * np.sqrt(self._square), NOISE_RELAXATION * self._first)
        turned = product < OSCILLATES * np.sqrt(square * self._square)
        turned &= self._length > least
        longest = self._longest if self.acts else LONG * self._first
        refused = exact and self._length > longest and self._num_refused < REFUSED
        share = 0.0 if refused else 1.0
        if turned and exact and work < 0 and not self.acts and self._num_back < BACK:
            share, self._num_back = -min(1.0, longest / self._length), self._num_back + 1
            self._turns = self._judges = refused = False
        elif refused:
            self._turns, self._length = True, self._first
        else:
            self._turns = turned and (self.acts or not corrects)
        self._num_refused = self._num_refused + 1 if refused else 0
        if share:
            self._last, self._square = [share * part for part in moves], share**2 * square
        return share
