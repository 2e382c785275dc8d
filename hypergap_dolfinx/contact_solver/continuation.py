# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Newton steps that are taken backwards.

Forces between bodies are continuous, with kinks where nodes pass. At a kink a branch of equilibria
can end: where a corner ploughs with friction, bodies snap to another branch, which Newton steps
from both sides of the kink never find. Beyond such an end the tangent does negative work on the
Newton step, which leads back to it: then a step of the same length is taken backwards.

Bodies can also be in equilibrium at a kink, as where symmetric meshes lie edge on edge: forces on
its both sides differ, and steps go to and fro over it. They are as long as that difference makes
them, which is that of integrals over pieces of curved facets: little.
"""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import BACK, OSCILLATES


class Continuation:
    """Newton's iteration in one load step, seen from outside."""

    def __init__(self, comm: MPI.Comm, least: float):
        """Start.

        Args:
            comm: Communicator of the bodies.
            least: Displacement treated as zero: shorter steps have no direction.
        """
        self._comm, self._num_back, self._square = comm, 0, 0.0
        self._least = least
        self._num_turned = 0
        self._last: Sequence[npt.NDArray[np.float64]] | None = None

    @property
    def is_at_kink(self) -> bool:
        """True if three steps go to and fro, and don't become shorter."""
        return self._num_turned > 1

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
        turned = product < OSCILLATES * self._square
        to_and_fro = product < OSCILLATES * max(square, self._square)
        self._num_turned = self._num_turned + 1 if to_and_fro else 0
        moves_on = square > self._least**2
        back = bool(moves_on and turned and work < 0 and self._num_back < BACK)
        self._last, self._square = [(1 - 2 * back) * part for part in moves], square
        self._num_back += back
        return back
