# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Working set of a Newton step: multipliers that hold rigid bodies."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import CLOSED_GAP, HOLDS


@dataclass
class Guesses:
    """Guesses of a step's working set, each from the states of the last solution.

    They end when all states are right. They also end when few states are wrong, or when their
    number no longer falls: then the complementarity problem of these few is solved.
    """

    least: int
    """Number of wrong states up to which the small problem is solved at once."""
    patience: int = 0
    """Guesses, in all, that needn't have fewer wrong states than the one before."""
    _last: float = np.inf

    def allow(self, num_wrong: int) -> bool:
        """True if the states of a solution become the next guess."""
        return num_wrong > self.least and (num_wrong < self._last or self.patience > 0)

    def take(self, num_wrong: int):
        """Record a guess."""
        self.patience -= num_wrong >= self._last
        self._last = num_wrong


def holding(active, distance, valid, holds, across=()) -> tuple[npt.NDArray[np.bool_], int]:
    """An active set enlarged until it holds the bodies that nothing else holds.

    Multipliers that close soonest come first.

    Args:
        active: The set, ``(num,)``.
        distance: Gaps over areas, ``(num,)``.
        valid: Mask of the existing multipliers, ``(num,)``.
        holds: Rows of the gaps on motions that are free without contact, ``(num, num_free)``.
        across: Rows of friction where it sticks, ``(num_sticking, num_free)``.

    Returns:
        The set, and the number of motions that stay free even so.
    """
    num = holds.shape[1]
    size = np.linalg.norm(holds, axis=1)
    rows = _unit(holds)
    basis, _ = _extended(np.empty((0, num)), _unit(np.reshape(across, (-1, num))))
    can = valid & (size > HOLDS * size.max(initial=0))
    way = np.full(len(size), np.inf)
    way[can] = distance[can] * np.where(distance[can] > 0, size[can].max(initial=0) / size[can], 1)
    way[can] = np.round(way[can] / max(CLOSED_GAP * np.abs(distance[can]).max(initial=0), 1e-300))
    order = np.lexsort((way, ~active))
    order = order[can[order]]
    held, taken = _extended(basis, rows[order])
    result = active.copy()
    result[order[taken]] = True
    return result, num - len(held)


def num_free(holds) -> int:
    """Number of motions that no row holds; ``holds`` is ``(num, num_free)``."""
    num = holds.shape[1]
    return num - len(_extended(np.empty((0, num)), _unit(holds))[0])


def _unit(rows) -> npt.NDArray[np.float64]:
    size = np.linalg.norm(rows, axis=1)
    return rows / np.where(size > 0, size, 1)[:, None]


def _extended(basis, rows) -> tuple[npt.NDArray[np.float64], list[int]]:
    """An orthonormal basis enlarged by unit rows outside its span, and the numbers of these."""
    taken = []
    for k, row in enumerate(rows):
        if len(basis) == rows.shape[1]:
            break
        rest = row - (row @ basis.T) @ basis
        length = np.linalg.norm(rest)
        if length > HOLDS:
            basis = np.vstack((basis, rest / length))
            taken.append(k)
    return basis, taken
