# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

MANY_PARTS = 20
"""Number of a mesh's connected parts beyond which their rigid motions aren't kept apart.

Measured: rigid motions of 47,000 dofs in 2, 20 and 200 parts take 4 MB, 124 MB and 1.4 GB, and 0.03
s, 0.4 s and 8 s."""
