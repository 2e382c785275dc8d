# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Damping of Newton's iteration where it oscillates or diverges.

Forces between bodies are continuous, with kinks where nodes pass. At a kink a branch of equilibria
can end: where a corner ploughs with friction, bodies snap to another branch, which Newton steps
from both sides of the kink never find. Viscous bodies flow there.

Beyond such an end the tangent does negative work on the Newton step, which leads back to it: then
a step of the same length is taken backwards. If that doesn't help, pseudo-transient continuation
does: the bodies' stiffness times a share is added to the tangent, and falls with the residual.
Before all this, a step after which the residual is much larger is shortened (a line search).
"""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import (
    ATTEMPTS,
    BACK,
    FALLS,
    GROWS,
    GROWTH,
    LEAST,
    MOST,
    NOISE_RELAXATION,
    OSCILLATES,
    SHARE,
    SHORTENED,
    SHRINKS,
)


class Relaxation:
    """Damping of the iteration for one load step."""

    def __init__(self, comm: MPI.Comm):
        """Start without damping.

        Args:
            comm: Communicator of the bodies.
        """
        self._comm = comm
        self._last: Sequence[npt.NDArray[np.float64]] | None = None
        self._first = self._length = self._longest = self._residual = self._square = 0.0
        self._turns = self._exact = self.acts = False
        self._judges, self._num_shortened, self._num_back, self._num_refused = False, 0, 0, 0
        self.share = 0.0
        """Share of the bodies' stiffness to be added to the tangent."""

    def update(self, residual: float):
        """Choose the share for the next step.

        Args:
            residual: Norm of the residual.
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
        """True if bodies only creep."""
        return self.share > MOST

    def shortens(self, residual: float) -> bool:
        """True if the last step is to be shortened.

        Args:
            residual: Norm of the residual after it; not a number if cells are inverted there.
        """
        worst = GROWTH * self._residual if self._judges else np.inf
        if self._last is None or residual <= worst or self._num_shortened == ATTEMPTS:
            return False
        self._num_shortened += 1
        self._last = [SHORTENED * part for part in self._last]
        self._square *= SHORTENED**2
        return True

    def takes(self, moves: Sequence[npt.NDArray[np.float64]], work: float, *, exact: bool) -> float:
        """Share of a step to take: 1, 0 if it is too long, negative to go back. Collective.

        Args:
            moves: This rank's increments of each body's displacements.
            work: Work of the tangent on them.
            exact: True if the tangent was exact: else that may be why this step or the next one
                reverses.
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
        longest = self._longest if self.acts else GROWTH * self._first
        refused = exact and self._length > longest and self._num_refused < ATTEMPTS
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
