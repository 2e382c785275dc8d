# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What of some points, or of an outline, is nearest to others (``c/surface.c``)."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.compiled import call, doubles


@dataclass(frozen=True)
class OnLoop:
    """What of a closed loop is nearest to points."""

    node: npt.NDArray[np.int32]
    """The nearest node, ``(num_points,)``."""
    edge: npt.NDArray[np.int32]
    """The nearest edge: from the node of its number to the next one, ``(num_points,)``."""
    s: npt.NDArray[np.float64]
    """Parameter on it, from 0 to 1."""
    apart: npt.NDArray[np.float64]
    """From there to the point, ``(num_points, 3)``."""


def on_loop(points: npt.NDArray[np.float64], loop: npt.NDArray[np.float64]) -> OnLoop:
    """What of a closed loop is nearest to points; of several that are as near, the first.

    Args:
        points: ``(num_points, 3)``.
        loop: Its nodes, ``(num_nodes, 3)``.
    """
    node, edge = np.empty((2, len(points)), dtype=np.int32)
    s = np.empty(len(points))
    _find(points, loop, node, edge, s)
    foot = loop[edge] + s[:, None] * (loop[(edge + 1) % len(loop)] - loop[edge])
    return OnLoop(node, edge, s, points - foot)


def nearest(
    points: npt.NDArray[np.float64], others: npt.NDArray[np.float64]
) -> npt.NDArray[np.int32]:
    """The nearest of other points to each point; of several that are as near, the first.

    Args:
        points: ``(num_points, 3)``.
        others: ``(num_others, 3)``.

    Returns:
        ``(num_points,)``.
    """
    node = np.empty(len(points), dtype=np.int32)
    _find(points, others, node, None, None)
    return node


def _find(points, others, node, edge, s):
    given = len(points), doubles(points), len(others), doubles(others)
    if call("find_nearest", *given, node, edge, s):
        raise MemoryError("no memory for what is nearest")
