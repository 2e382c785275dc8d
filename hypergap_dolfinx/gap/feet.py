# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What is opposite of what where two chains have different shapes, as bodies in contact have."""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.strip import Chain, parametrise

APART = 1e-6
"""Share of arc length in parameters that are feet, which keeps nodes apart that have one foot."""


def parametrise_by_feet(
    c0: Chain, c1: Chain
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Parameters from 0 to 1 of the nodes of two facing chains, by where Γ1's project to on Γ0.

    Loops are parametrised by arc length.
    """
    if c0.closed or c1.closed:
        return parametrise(c0, c1)
    s0 = c0.arc
    foot = np.empty(len(c1.x))
    for i, x in enumerate(c1.x):
        edge, position, _ = c0.project(x)
        foot[i] = s0[edge] + position * (s0[edge + 1] - s0[edge])
    foot[0], foot[-1] = 0, 1
    return s0, (1 - APART) * np.maximum.accumulate(foot) + APART * c1.arc
