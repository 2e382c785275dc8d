# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Working sets: guesses, small complementarity problems, and what holds free bodies."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import CLOSED_GAP, HOLDS, PIVOT, STEPS, TRIALS

Array = npt.NDArray[np.float64]


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


def solved(M: Array, b: Array, zero: Array) -> tuple[Array, bool]:
    """Solve the complementarity problem z ≥ 0, w = b + Mz ≥ 0, zᵀw = 0.

    By block pivoting or, where that doesn't end, by Lemke's method.

    Args:
        M: ``(num, num)``, of numbers around 1; z is unique if each principal minor is positive (a
            P-matrix). If M is positive semi-definite there is a solution unless w ≥ 0 for no z ≥ 0.
        b: ``(num,)``.
        zero: Sizes treated as zero, of z and w alike, ``(num,)``.

    Returns:
        z and True; without a solution a ray and False: z ≥ 0 of which multiples increase w nowhere
        where z > 0, or zero if none was found.
    """
    size = np.sqrt(np.maximum(np.diag(M), 1))
    scaled = M / size / size[:, None], b / size, zero / size
    z = _by_blocks(*scaled)
    z, is_solved = _by_lemke(*scaled) if z is None else (z, True)
    return z / size, is_solved


def solution(M: Array, b: Array) -> tuple[Array, bool]:
    """Solution of a system of equations; False if a pivot is zero, as a second load shows."""
    try:
        x, probe = np.linalg.solve(M, np.stack((b, np.cos(np.arange(len(b)))), 1)).T
    except np.linalg.LinAlgError:
        return np.linalg.lstsq(M, b)[0], False
    return x, bool(np.abs(probe).max(initial=0) * PIVOT <= 1)


def _by_blocks(M: Array, b: Array, zero: Array) -> Array | None:
    """Block pivoting: all that is wrong is exchanged at once; None where that doesn't end."""
    on, fewest, left = b < -zero, len(b) + 1, TRIALS
    while left:
        z = np.zeros(len(b))
        z[on], is_regular = solution(M[np.ix_(on, on)], -b[on])
        if not is_regular:
            return None
        w = np.where(on, 0, b + M @ z)
        wrong = np.where(on, z, w) < -zero
        count = int(wrong.sum())
        if not np.isfinite(z).all():
            return None
        if not count:
            return np.maximum(z, 0)
        left = TRIALS if count < fewest else left - 1
        fewest = min(count, fewest)
        on ^= wrong
    return None


def _by_lemke(M: Array, b: Array, zero: Array) -> tuple[Array, bool]:
    """As :func:`solved`, by Lemke's method: no regular matrices, but a pivot for each change."""
    num = len(b)
    if (b >= -zero).all():
        return np.zeros(num), True
    # Columns: w, z, the artificial variable, right-hand side
    table = np.hstack((np.eye(num), -M, -np.ones((num, 1)), b[:, None]))
    basis, enters, extra = np.arange(num), 2 * num, 2 * num
    row = int(b.argmin())
    for _ in range(TRIALS * (num + 1) ** 2):
        table[row] /= table[row, enters]
        factors = table[:, enters].copy()
        factors[row] = 0
        table -= factors[:, None] * table[row]
        leaves, basis[row] = int(basis[row]), enters
        if leaves == extra:
            z = np.zeros(2 * num + 1)
            z[basis] = table[:, -1]
            return np.maximum(z[num : 2 * num], 0), True
        enters = leaves + num if leaves < num else leaves - num
        column = table[:, enters]
        can = column > PIVOT * max(np.abs(column).max(), 1)
        if not can.any():
            ray = np.zeros(2 * num + 1)
            ray[enters], ray[basis] = 1, -column
            return np.maximum(ray[num : 2 * num], 0), False
        ratio = np.where(can, np.maximum(table[:, -1], 0) / np.where(can, column, 1), np.inf)
        ties = np.flatnonzero(ratio <= ratio.min() + zero.min())
        # What is artificial leaves first; else the lexicographically smallest row, against cycles
        if (basis[ties] == extra).any():
            row = int(ties[basis[ties] == extra][0])
        else:
            rows = table[ties, :num] / column[ties, None]
            row = int(ties[np.lexsort(rows.T[::-1])[0]])
    return np.zeros(num), False


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


def is_too_much(load: Array, pushes: Callable[[Array], Array]) -> bool:
    """True if no pressures, with friction, balance a load on free motions.

    Of all forces on these motions, those nearest to the load are found. What they leave of it is a
    motion on which the load does work and no contact forces do. They are sums of few pushes: those
    that do work on what others leave join these.

    Args:
        load: ``(num_free,)``.
        pushes: Gives forces on the motions by a unit of each pressure, and by the friction that
            does most work on a motion, ``(num, num_free)``.
    """
    load = load / max(float(np.linalg.norm(load)), np.finfo(float).tiny)
    left, used, forces, eps = load, np.empty((0, len(load))), np.ones(1), np.finfo(float).eps
    for _ in range(STEPS):
        if left @ load <= eps:
            break
        rows = _unit(pushes(left))
        work = rows @ left
        if 2 * forces.sum() * max(work.max(), eps) <= left @ load:  # no forces do as much work
            return True
        most = np.argsort(-work, kind="stable")[: len(load)]
        used = np.vstack((used, rows[most[work[most] > eps]]))
        forces, _ = solved(used @ used.T, -used @ load, np.full(len(used), eps))
        used, forces = used[forces > 0], forces[forces > 0]
        left = load - forces @ used
    return False


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
