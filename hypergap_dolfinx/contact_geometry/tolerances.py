# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of contact's geometry: one value, one meaning, and the measurement behind each."""

ROUND_OFF_FACET = 1e-14
"""Area of a piece, or of what isn't seen, over its facet's, and distance of an edge from a straight
one on the reference facet, treated as zero.
Measured: round-off 1e-16; for areas 1e-6 changes nothing where two blocks pass, with 1e-4 gaps jump
by 1e-7."""

NEWTON = 10
"""Most Newton steps to a point of a curved facet, to where a ray meets one, and to the crossing of
two curved edges.
Measured: round-off after 4; steps of at most 2e-2, 1e-4, 4e-9 and 3e-16 of an edge at 3316
crossings of P2 facets."""

PARALLEL_CURVES = 0.1
"""Sine of the angle between two curved edges below which their crossing moves towards that of
straight ones.
Measured: outlines that are one, moved by 1e-9: C changes by 1e-7 without it."""

LAST = 1e-8
"""Step of Newton's method on a facet, in reference coordinates, that is the last one.
Measured: squared it is round-off: g, C and ∂²g of ironing change by 2e-13."""

WIDTH = 1e-6
"""Least standard deviation of a quadrature rule's points across a polygon, over that along it.
Measured: triangles of widths 1e-2 to 1e-14: absolute sums of weights 1.6 (degree 4) and 2.2 (6)
times the area; without it 1500 and 6900, or no numbers."""

COSINES = 0.1, 0.4
"""Cosines between normals from which on edges or facets face each other, and do so fully.
Measured: 60 random scenes of the plane: 57 solved, 1163 Newton steps; (.05, .2) 58, 1110;
(.2, .6) 56, 1060."""

COSINES_SPACE = 0.5, 0.8
"""The same in space: along rays that meet a wall at less, distances are many times those across it.
Measured: blocks pressed into wider ones of other cells, all free facets given: with (.1, .4) 2 of
10 scenes have the force that facing facets alone give, with (.3, .6) and (.5, .8) all; pressed by
.2 with (.3, .6) no equilibrium, with (.5, .8) that force in 5 Newton steps; any_contacts --dim 3,
scene 18: more than 200 Newton steps with (.3, .6), solved with (.5, .8)."""

FADING_DEGREE = 15
"""Least degree of quadrature along edges, but where straight ones face each other fully.
Measured: forces as a box passes a bracket's inner corner: jump by .016, with 5, by 1e-8."""

INSIDE = -0.5, -0.25
"""Least reference coordinate, negative outside, from which on rays meet a facet, and do so fully.
Measured: rays to folded facets of degree 2, 300 pairs of surfaces: gaps at most 3.4 times those
of flat ones without it, 1.1 with it, with (-.25, -.1), 1.3 with (-1, -.5)."""

NEAREST = 0.25, 0.75
"""Depth of a point over its overlap along the ray, in space over the depth by the sheet's plane,
from which on a sheet counts, and does so fully.
Measured: the same scenes: (.1, .5) 56 solved, (.5, .9) 58; without it 16 of 60. In the plane over
the sheet's depth, as in space: 963, 1115, 1492 and 1750 fail."""

SLACK = 0.1
"""Length that is added to depths, in edges of Γ1.
Measured: the same scenes: .02 57 solved, 1457 Newton steps, .5 56, 1048."""

BLENDS = 0.5
"""Largest share of the neighbours' rows in that of a vertex that is covered in part.
Measured: force on a flat punch as its corners pass between nodes: changes by 1.3 %, with .2
.2 %, without 2.9 %; the same scenes: 58 solved, 1269 Newton steps with .2, 1284 without."""

HARD = 0.01
"""Covered part of a vertex, or of one beside it, from which it has a multiplier.
Measured: flat die drawn along by .3 cells: converges with .001 and .01, not with .05;
any_contacts, scene 354: solved with .01, not with 1e-4: what sheets that fade in cover has no
neighbour that says the same."""

SLIVER = 1e-6
"""The same beside such a vertex: forces jump by about as much of them.
Measured: a block on a wider one, 58 pairs of meshes, pressed by 30 %: 2 fail, with 1e-5 and 1e-4 1
and 2 of 40 of them, with .001 4 of 58, with .01 9, as less is covered with the row than without."""

SHARED = 0.7
"""Part of an edge of Γ1 around its middle over which weights go over from one vertex to the other.
Measured: force on a flat punch: changes by 1.3 %, with .02 2.4 %, with .95 .9 %; peak of
Hertz's pressure .25 % off, with .5 .18 %; flat die drawn along in two ways: both converge, with .5,
.6 and .65 one of them doesn't; least eigenvalue of C K⁻¹ Cᵀ .69 of that with .02."""
