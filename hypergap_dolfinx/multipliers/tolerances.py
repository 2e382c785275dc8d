# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

COVERED_FACET = 0.3
"""Part of a facet that Σ must reach for multipliers of its own.
Measured: 0.03 and 0.9 change nothing in test_multipliers, test_pieces, test_cross_points, test_ends
and test_property; λ's round-off is what :data:`KNOWN` bounds."""

KNOWN = 1e-4
"""Least share of a function's square in that part for them.
Measured: round-off of λ: a corner with 30 % of a Q2 facet (2e-5) 1.1e-9, 1.3e-11 without; an end
with 31 % of an edge of degree 3 (2e-6) 1.1e-11, 7e-14 without."""

SAME_PLACE = 1e-6
"""Distance of dofs at one place, in facet lengths, and thickness of a flat piece, in its extents.
Measured: 0.1× and 10× change nothing in test_multipliers, test_pieces and test_cross_points."""

INDEPENDENT_ROWS = 0.3
"""Sine of the angle between a row and those taken before it from which it is independent.
Measured: 0.03 and 0.9 change nothing in test_pieces, test_cross_points, test_multipliers but its
test_rows, which checks the meaning."""

CONSISTENT = 0.03
"""Sine from which a row that a patch test needs is independent.
Measured: 0.003 and 0.3 change nothing in test_pieces, test_cross_points, test_ends and
test_property."""

BESIDE_END = 1.0
"""Distance, in facet sizes, up to which the body across an interface that ends is beside a place.
Measured: scenes 9, 54 of random assemblies in space: H¹ 1.16, 1.13 of the interpolant's with 0.3,
1.09, 1.12 with 1 and 10; λ's error of scene 44 is 0.41 with 10 for 0.26."""
