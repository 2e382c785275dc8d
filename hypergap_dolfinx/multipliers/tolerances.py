# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

COVERED_FACET = 0.3
"""Part of a facet that Σ must reach for multipliers of its own.

Measured: –"""

KNOWN = 1e-4
"""Least share of a function's square in that part for them.

Measured: round-off of λ: a corner with 30 % of a Q2 facet (2e-5) 1.1e-9, 1.3e-11 without; an end
with 31 % of an edge of degree 3 (2e-6) 1.1e-11, 7e-14 without."""

SAME_PLACE = 1e-6
"""Distance of two bodies' dofs at one place, in facet lengths.

Measured: –"""

FEW_MULTIPLIERS = 32
"""Multipliers of a piece whose rows are looked at one by one.

Measured: –"""

NARROW_PIECE = 1e-6
"""Extent of a piece in a direction, over its largest, that is none.

Measured: –"""

INDEPENDENT_ROWS = 0.3
"""Sine between a row and those taken before it.

Measured: –"""

CONSISTENT = 0.03
"""The same where a patch test needs the row.

Measured: –"""
