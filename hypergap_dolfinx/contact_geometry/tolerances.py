# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of contact's geometry: one value, one meaning, and the measurement behind each."""

FACING = 0.25
"""Least cosine between normals (in the plane: edges) of facets that face each other.
Measured: 0.025 and 0.5 change nothing in 157 tests of contact; 11 fail with 0.9, and
test_finds_what_faces without it (-2)."""

ROUND_OFF_FACET = 1e-14
"""Area of a piece over its facet's, and distance of an edge from a straight one on the reference
facet, treated as zero.
Measured: round-off 1e-16."""

NEWTON_FACET = 10
"""Most Newton steps to a point of a curved facet, and to where a ray meets one.
Measured: round-off after 4."""

NEWTON_CURVES = 5
"""Newton steps to the crossing of two curved edges.
Measured: steps of at most 2e-2, 1e-4, 4e-9 and 3e-16 of an edge at 3316 crossings of P2 facets."""

PARALLEL_CURVES = 0.1
"""Sine of the angle between two curved edges below which their crossing moves towards that of
straight ones.
Measured: outlines that are one, moved by 1e-9: C changes by 1e-7 without it."""

DRIFT = 0.5
"""Largest distance of the crossing of two curved edges from that of the straight ones, in edge
lengths.
Measured: rough P2 facets, 24 scenes: the same with 0.25, 1."""

LAST = 1e-8
"""Step of Newton's method on a facet, in reference coordinates, that is the last one.
Measured: squared it is round-off: g, C and ∂²g of ironing change by 2e-13."""

WIDTH = 1e-6
"""Least standard deviation of a quadrature rule's points across a polygon, over that along it.
Measured: triangles of widths 1e-2 to 1e-14: absolute sums of weights 1.6 (degree 4) and 2.2 (6)
times the area; without it 1500 and 6900, or no numbers."""

KINK_ORDER = 0.5
"""Cosine of a surface's turn in the plane below which a chain of facets, or a fan, ends.
Measured: 0.05 changes nothing in 128 tests of contact; test_slip fails with 0.8, and test_corner
without it (-2): a fan goes round a corner of 90°."""

REACHED = 0.999
"""Covered part of an edge of Γ1 above which both its vertices get weights, if it wasn't whole.
Measured: flat die, degree 1: the vertex moves its edge's cut by 0.07 of it when it gets or loses
its multiplier; with one threshold steps of 0.05 cells cycle."""

KEPT = 0.9
"""Covered part of an edge of Γ1 above which both its vertices keep weights, degree 2.
Measured: flat die drawn along with friction .2: with 0.95 the vertex comes and goes within
Newton's iteration, 32 steps a load step and 28 halvings; 6.7 and none with 0.9, 6.3 with 0.8."""

COMES = 0.2
"""Covered part of an edge of Γ1 above which the vertex beyond Γ0's end gets a share.
Measured: flat die, degree 1, steps of .05 and .1 cells: 3.7 and 4.8 Newton steps (at most 10 and
12); with one threshold, .02 or more, some load steps have no solution, with 1e-3 up to 38 steps,
and meshes that match nearly take 3 more."""

GOES = 0.02
"""Covered part of an edge of Γ1 above which the vertex beyond Γ0's end keeps its share.
Measured: as COMES."""

STEEPER = 2.0
"""Largest pressure of the vertex beyond Γ0's end over that of the vertex before the end.
Measured: flat die, degree 1, foundation as Γ1: ripple .9 % with 1, .53 % with 1.7, .37 % with 2
(5.95 Newton steps), .22 % with 2.7 (6.2), .26 % with 5 (7.1)."""

END = 1e-7
"""Distance of ends that are opposite, in edge lengths.
Measured: 1e-12 to 1e-6 change nothing in 128 tests of contact; with 1e-3 one of 157 fails, with 0
nine."""

FARTHER = 8.0
"""Longest way along Γ0 between neighbouring rays, in lengths of their edges, that one fan spans.
Measured: 1e9 changes nothing in 128 tests of contact; with 2 one of 157 fails (volumes between
rough loops), with 0.8 six."""
