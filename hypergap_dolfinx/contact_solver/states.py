# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Where bodies in contact are, to go back there or on the way to somewhere else."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.contact_rows import Pressed


@dataclass(frozen=True)
class State:
    """What a load step changes, and gives back if it fails."""

    values: Sequence[npt.NDArray[np.float64]]
    """This rank's unknowns of bodies and ties."""
    pressed: Sequence[Pressed]
    """Of each contact."""

    def towards(self, other: "State", share: float) -> "State":
        """One on the way to another or beyond, with its own sets.

        Args:
            other: The other one.
            share: Of the way: 0 is here, 1 there.
        """
        values = [a + share * (b - a) for a, b in zip(self.values, other.values, strict=True)]
        pressed = []
        for one, two in zip(self.pressed, other.pressed, strict=True):
            ends = {k: (a, two.arrays[k]) for k, a in one.arrays.items() if a.dtype != bool}
            pressed.append(replace(one, **{k: a + share * (b - a) for k, (a, b) in ends.items()}))
        return State(values, pressed)
