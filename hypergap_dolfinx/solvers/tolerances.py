# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

UNKNOWN = 1e-3
"""Error of constants that are found again from their loads, from which they are unknown.

Measured: flows without an outlet 0.2 to 1.7, held at a node 2e-16."""

FIRST = 1e-10
"""Residual at which `"bodies"` begins anew.

Measured: 3D patch tests: 4e-13; in one go 3e-12."""

RESCALE = 0.5
"""Decades of stiffness after which ties are scaled anew.

Measured: factors of 1e8 cost digits."""

FEW_COLUMNS = 0.1
"""Forces of ties, over the loads, for which the solver is called again.

Measured: a block on one 1 to 1e6 times as stiff: 5e-2 to 5e-8."""

ROUND_OFF_PROJECTED = 1e-15
"""Forces, over those of single nodes, that are none.

Measured: round-off of sums."""

CONTRAST = 1e4
"""Largest ratio of Γ1's weight to Γ0's beside it.

Measured: beyond it Π gets lost in round-off."""

LARGE_SYSTEM = 5000
"""Displacements in 3D from which `"bodies"` is the default.

Measured: pays from there on."""

UNKNOWN_TYPE = 86
"""PETSc's error for a type that it doesn't have.

Measured: –"""
