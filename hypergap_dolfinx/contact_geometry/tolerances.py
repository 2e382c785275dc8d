# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

FACING = 0.25
"""Cosine between normals (in the plane: edges) from which facets face each other.
Measured: –"""

ROUND_OFF_FACET = 1e-14
"""Area of a piece over its facet's, and distance of an edge from a straight one on the reference
facet, that are zero.
Measured: round-off 1e-16."""

NEWTON_FACET = 10
"""Newton steps to a point of a curved facet, and to where a ray meets one.
Measured: round-off after 4."""

NEWTON_CURVES = 5
"""Steps to where two curved edges cross.

Measured: –"""

PARALLEL_CURVES = 0.1
"""Sine of the angle between two curved edges below which where they cross counts less.

Measured: outlines that are one, moved by 1e-9: C changes by 1e-7 without it."""

DRIFT = 0.5
"""By how much, in edges, such a crossing is elsewhere than straight edges' at most.

Measured: rough P2 facets, 24 scenes: the same with 0.25, 1."""

LAST = 1e-8
"""Step of Newton's method on a facet after which none is needed.

Measured: squared it is round-off: g, C and ∂²g of ironing change by 2e-13."""

WIDTH = 1e-6
"""Standard deviation across a polygon, over that along it, at which points are at least.

Measured: triangles of widths 1e-2 to 1e-14: absolute sums of weights 1.6 (degree 4) and 2.2 (6)
times the area; without it 1500 and 6900, or no numbers."""

REACH_POINTS = 0.2
"""By how much points of a rule are farther from a polygon's middle for each degree, in standard
deviations.

Measured: a square and a triangle: weights of degree 4, 6 and 10 have absolute sums of 1.00, 1.08
and 1.2 times the area."""

KINK_ORDER = 0.5
"""Cosine of a surface's turn from which it goes on.

Measured: –"""

REACHED = 0.999
"""The same if they had none.

Measured: flat die, degree 1: the vertex moves its edge's cut by 0.07 of it when it gets or loses
its multiplier; with one threshold steps of 0.05 cells cycle."""

KEPT = 0.9
"""The same if they had them, for degree 2.

Measured: flat die drawn along with friction .2: with 0.95 the vertex comes and goes within
Newton's iteration, 32 steps a load step and 28 halvings; 6.7 and none with 0.9, 6.3 with 0.8."""

COMES = 0.2
"""Part of an edge of Γ1 that Γ0 must reach for a share of the vertex beyond its end, if it had
none.

Measured: flat die, degree 1, steps of .05 and .1 cells: 3.7 and 4.8 Newton steps (at most 10 and
12); with one threshold, .02 or more, some load steps have no solution, with 1e-3 up to 38 steps,
and meshes that match nearly take 3 more."""

GOES = 0.02
"""The same if it had one.

Measured: likewise."""

STEEPER = 2.0
"""Pressure of that vertex, over that of the one before the end, up to which it may be.

Measured: flat die, degree 1, foundation as Γ1: ripple .9 % with 1, .53 % with 1.7, .37 % with 2
(5.95 Newton steps), .22 % with 2.7 (6.2), .26 % with 5 (7.1)."""

END = 1e-7
"""Distance of ends that are opposite, in edge lengths.

Measured: –"""

FARTHER = 8.0
"""Longest way between neighbouring rays, in lengths of their edges.

Measured: –"""
