# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

NOUGHT = 1e-13
"""Value of a shape function that counts as zero.
Measured: round-off 7e-16 (degree 5), 4e-15 (degree 10)."""

NARROW_CELL = 30.0
"""Reach over width of a cell above which its factors are pulled back first.
Measured: round-off is that many times as large."""

ENOUGH = 12
"""Degree of a Gauss rule above which curved tetrahedra get at most 2k + 2.
Measured: halves of distorted quadrilaterals, degrees 8 to 16."""

ON_SURFACE = 1e-10
"""Distance of α from 0 or 1 on Γ0 or Γ1.
Measured: round-off 2e-16, next node 0.03 (degree 10)."""

AROUND_FOLLOWED = 3
"""Rings of facets searched for multipliers to follow.
Measured: 1 changes nothing in 106 tests of test_pieces, test_ends, test_solids_pieces,
test_multipliers and test_adjust; 2 and 9 nothing in the 64 of the first two."""

INDEPENDENT_NEIGHBOURS = 1e-6
"""Smallest singular value of neighbours that determine a polynomial.
Measured: ends and pieces: 0.023 and more, or 5e-16."""

WEIGHT = 250.0
"""Weight of smoothing.
Measured: errors over λ's, mean and largest of 508 scenes: 0.396, 0.99; with 200 0.400, 1.02,
with 300 0.406, 1.04."""

SMOOTH = 1 / 20
"""Weight of the distance from polynomials over two facets, beside the difference of both sides.
Measured: the same: with 1/60 0.413, 1.15, with 1/10 0.414, 1.24."""

PASSES = (1, 3, 9, 27)
"""Counts of passes that restore what smoothing took from tractions; the best is chosen.
Measured: the same: 1 to 9 0.494, 2.57, 1 to 81 0.484, 1.25; 1, 2, 4, 8, 16 with weight 160 0.397,
1.02."""

ROUNDS_ADJUST = 3
"""Moves of Γ1, since B depends on its position.
Measured: test_adjust: with 1 a move that no mesh of the gap follows goes unnoticed; 2 and 6 change
nothing."""

SAG_CURVED = 1e-5
"""Distance of curved facets from straight ones, in lengths, above which they are curved.
Measured: circle of 500: 1.6e-3; files 1e-8."""

ACROSS = 0.01
"""Mean distance of two surfaces, over their longest facet, that is told: beside chords' sag, and
all of it where facets are straight and spaces of degree 2 or more.
Measured: two squares of 4 cells, a side load on top: .8 of a facet apart the support has .71 of the
moment, .01 of a facet apart .996. Two rings, straight facets, degree 2, a radial field: .051, .026,
.013, .009 of a facet apart the gradient is off by 6.0, 1.9, .66, .36 %, with the right jump by 4.0,
1.3, .44, .24 %; with degree 1, off by 22 to 3.6 %, it changes nothing."""

UNEVEN = 5.5
"""Ratio by which facets of Γ1 may be narrower, per degree, without a warning.
Measured: cubes, smooth field: λ's error 2.3 × at 4, 4 × at 8."""

SMOOTH_ROOT = (0.15, 0.15), (0.3, 0.2)
"""μ: weight of jumps of slopes beside that of moments, for roots at free edges; plane, space; the
second ones with gaps' law beyond edges.
Measured: L², means over four places of the edge. Plane, with .1, .15, .2: Hertz, degree 1, a/2
3.5e-2, 3.3e-2, 3.3e-2, a/10 1.0e-2, 9.2e-3, 8.2e-3; degree 2, a/3 5.1e-3, 4.3e-3, 4.0e-3; a
profile x⁴, degree 2, a/3 3.7e-2, 4.1e-2, 4.6e-2. Space, with .2, .3, .4: Hertz, degree 1, a/3
8.7e-2, 7.2e-2, 6.4e-2; degree 2, a/2 8.1e-2, 8.1e-2, 8.4e-2; r⁴ likewise 4.8e-1, 4.7e-1, 4.6e-1
and 3.7e-1, 3.6e-1, 3.6e-1. With gaps' law in space, degree 2, a/2, .15, .2, .25, .3: Hertz
4.8e-2, 4.8e-2, 5.2e-2, 5.5e-2, r⁴ 1.1e-1, 1.0e-1, 1.2e-1, 1.4e-1. Random smooth indenters beside
their exact pressures, with .15, .2, .25 over .3's errors, mean (largest): 22 ellipses .82 (1.18),
.85 (1.06), .92 (1.02), 21 flat ones with round rims .68, .75, .87 (1.00), 19 sums of powers .78
(1.04), .76, .82 (1.00); 30 with the finer side as Γ1 .98 (1.74), .92 (1.30), .94 (1.12)."""

TOTAL_ROOT = 50.0
"""Weight of a region's total force, relative, beside those of facets' forces.
Measured: Hertz's line, degree 1, a/2, 3, 5, 10: with 0 3.8e-2, 2.5e-2, 1.6e-2, 9.5e-3; with 20 to
100 3.3e-2, 2.2e-2, 1.5e-2, 9.3e-3; with 200 the last is 1.1e-2 (more steps are needed)."""

MISSED_ROOT = 0.035
"""Root mean square error of facets' forces, relative, from which on a root isn't drawn.
Measured: Hertz's lines and spheres at most .022, Cattaneo's shear .032; random coarse
punches sheared, with scattered tractions, where roots are worse than none .04 to .08."""

RINGS_ROOT = 1, 0
"""The mesh's facets beside those with a free edge on which pressure has a root; plane, space.
Measured: plane, Hertz, a/2, 3, 5, 10, degree 1: with 0 3.0e-2, 2.8e-2, 2.1e-2, 1.2e-2, with 1
3.3e-2, 2.2e-2, 1.5e-2, 9.2e-3, with 2 7.7e-2, 2.3e-2, 1.8e-2, 1.0e-2; degree 2, a/3, with 0, 1, 2:
2.0e-2, 4.3e-3, 4.2e-3. Space, with 0, 1, 2: Hertz, degree 1, a/3 7.2e-2, 9.0e-2, 9.2e-2, degree 2,
a/2 8.1e-2, 8.4e-2, 9.1e-2."""

PARTS_ROOT = 32, 8
"""Parts of edges for integrals of roots, and to draw them, in the plane and in space.
Measured: plane, Hertz, degree 1, a/3, with 4, 16, 32, 64: 2.6e-2, 2.1e-2, 2.2e-2, 2.2e-2; degree 2,
a/5, 3.6e-3, from 16 on 3.2e-3."""

STEPS_ROOT = 30
"""Most steps of Levenberg and Marquardt's method for roots.
Measured: Hertz, edges on nodes: 20 to 31; errors change by less than 1 % from 15 on."""
