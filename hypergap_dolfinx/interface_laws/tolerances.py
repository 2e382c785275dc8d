# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

FAR_POINT = 1e4
"""Distance of the point of a coupling from its surface, in root mean square radii of this, that is
refused.
Measured: a bent block: its rotation is off by 9e-9 at 3e3, 3e-7 at 3e4, 1e-4 at 3e5; with a rigid
one by 1e-12 at 3e4, and factors fail at 3e6."""
