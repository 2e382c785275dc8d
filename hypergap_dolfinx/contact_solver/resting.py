# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Where bodies that only contact holds come to rest, as rigid ones. NumPy alone."""

import numpy as np
import numpy.typing as npt

NONE = 1e-9
"""Balance and cost, over the largest, that is none."""
PIVOTS = 50
"""Exchanges, for each motion, after which what is found is taken."""


def resting(holds, load, distance) -> npt.NDArray[np.intp]:
    """On what rigid bodies rest to which a load is applied, once they have moved there.

    They go where the load does the most work while no gap closes to less than nothing: a linear
    program. Solved is its dual, by the simplex method: of all pressures that balance the load those
    that do the least work in the gaps.

    Args:
        holds: What a pressure does along each motion, ``(num, num_motions)``.
        load: What balances it there, ``(num_motions,)``.
        distance: Gaps, with the pressures' weights, ``(num,)``; none is negative.

    Returns:
        Which have a pressure; none if no pressures balance the load.
    """
    num, k = holds.shape
    scale = np.abs(holds).max(axis=0, initial=0)
    none = np.empty(0, dtype=np.intp)
    if not num or not load.any() or not scale.all():
        return none
    b = load / scale / np.abs(load / scale).max()
    A = np.hstack(((holds / scale).T, np.diag(np.where(b < 0, -1.0, 1.0))))
    A[:, :num] /= np.abs(A[:, :num]).max()
    cost = np.zeros((2, num + k))  # first that of what balances nothing
    cost[0, num:], cost[1, :num] = 1, distance / max(distance.max(), 1e-300)
    basis = np.arange(num, num + k)
    for _ in range(PIVOTS * k):
        inverse = np.linalg.inv(A[:, basis])
        x = inverse @ b
        lost, work = cost - cost[:, basis] @ inverse @ A
        lost[np.abs(lost) <= NONE] = 0
        work = np.where(lost == 0, work, 0)
        enters = lost.argmin() if lost.min() < 0 else work.argmin()
        if lost[enters] >= 0 and work[enters] >= -NONE:
            break
        falls = inverse @ A[:, enters]
        ways = np.full(k, np.inf)
        np.divide(x, falls, ways, where=falls > NONE)
        if not np.isfinite(ways.min()):
            break
        basis[ways.argmin()] = enters
    acts = basis[x > NONE]
    return none if (acts >= num).any() else acts
