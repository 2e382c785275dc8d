# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

SAME = 1e-6
"""Sine between free motions of single parts and of what is tied that are the same.

Measured: –"""

MOVES = 1e-3
"""Share of a motion that messages don't tell of.

Measured: –"""

ROTATES = 0.1
"""What a motion turns, over what it shifts, from which messages say that it turns.

Measured: –"""

ASTRAY = 0.5
"""Way of a body in a failed load step, in its extent, from which it went astray.

Measured: a block that slides off its support: 3."""

CHECKED_AT_ONCE = 100_000
"""Cells at a time.

Measured: –"""

FLAT_CELL = 1e-14
"""Volume of a cell, over diameterⁿ, that is none.

Measured: –"""

INVERTED_CORNER = 1e-10
"""How negative det J may be at a corner, over diameterⁿ.

Measured: corners of 180°, files' digits."""

CONTRADICT = 1e-6
"""Difference of prescribed values, over the largest, that contradicts.

Measured: round-off 1e-16, single precision 1e-7."""

NO_LENGTH = 1e-12
"""The same in sizes of the interface.

Measured: –"""

UNTIED = 1e-12
"""Entries at Γ0 that can move, over the largest, that are none.

Measured: prescribed ones are exact zeros."""

APART = 0.5
"""Distance across a tie, in cell sizes, that is no error of meshes.

Measured: polygons in rings up to 0.28, blocks a cell apart from 0.74."""

NOTHING = 1e-12
"""Force or energy of a rigid motion, over K's rows, that is none.

Measured: round-off 2e-15 to 5e-13; held at one node 2.5e-5."""

DEPENDENT = 1e-10
"""Eigenvalue of a Gram matrix of unit columns that is zero.

Measured: the same motions 1e-16."""

RESIDUAL_ACCEPTED = 1e-3
"""Residual of a direct solve, over the loads, that is a failure.

Measured: ε × condition, or about 1."""

BACKWARD = 1e-6
"""Backward error of an iteration that is a failure.

Measured: up to 6e-10, contrasts 1e-6 to 1e6."""

RETRIES = 4
"""Times that MUMPS gets three times its workspace.

Measured: 100 % to 8100 %."""
