# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

import numpy as np

OFF_OUTLINES = 4e-10
"""Distance of outlines treated as zero, in edge lengths.
Measured: a plate 1e-9 larger than its block: u 9e-10 with 1e-9."""

NEARLY = 1e-5
"""Distance of outlines, in edge lengths, treated as zero where nodes of both outlines come in
pairs.
Measured: any_surfaces: noise of 1e-6, which can't be cut in 10 of 23 scenes; meshes off by ε
facets: u 2e-12, λ 11 ε²."""

INSIDE_WEIGHT = 1e-9
"""Negative weight up to which a point is inside of a triangle.
Measured: Newton's method for curved ones ends at 1e-10; 1e-12 changes nothing in test_clip,
test_parting."""

CORNER_OUTLINE = np.radians(50)
"""Turn of an outline in its surface from which a node is a corner.
Measured: the same scenes as of SAGS: 80° fails in one of each, 50° in none."""

SAGS = 2.0
"""Distance of polygons through nodes of one curve, over the sag that their turns give.
Measured: 16 bent plates under two or four blocks, 6 curved partitions of any_assemblies: 1 fails in
one of each, 2 in none."""

NEARBY = 0.02
"""Distance of a node from another outline, in edges, that a curve's sag explains on either side.
Measured: 80 ties of rings over holes of random radii: areas are off by .3 % in the mean, with 1 by
1.8 %; of 320 of arched L-shapes four change, by .2 %, with 0 two are refused and 59 change."""

AWAY = 0.5
"""Distance of outlines, in lengths of their edges, that no bend explains.
Measured: flush tubes of five facets 0.16; a bolt of six facets that ends 0.8 of one behind its
hole."""

NEWTON_OUTLINES = 6
"""Newton steps to a point's projection along a triangle's normals, or a crossing of curved edges.
Measured: round-off after 5, crossings after 3; bush in a hole, 5 to 12 straight facets around,
staggered, overlapping in part: 118 of 120 get cells, with 4 steps 115."""

LEVEL = 0.2
"""Cosine between such normals and the triangle's below which steps are limited.
Measured: at least 0.90 in 146 tests of test_clip, test_parting, test_solids_overlap,
test_quadrilaterals and test_curved."""

SNAP = 2e-9
"""Distance of nodes and edges treated as zero, in lengths of the outlines' edges.
Measured: cuts of 1e-12 to .9, degree 2: u 4e-10, λ 6e-7; λ 1e-6 with 1.2e-9, u 2e-9 with 1e-8."""

COARSER = 10.0
"""Factor on that distance for another attempt where no cells fit.
Measured: 100 squares moved by 1e-10 to 1e-4: 2 fail at first, none with it."""

TRIES = 3
"""Number of attempts.
Measured: the same: 2 were enough."""

CHORDS = 2
"""Straight parts of a curved outline's edge, per degree.
Measured: pad on a cylinder: rates 2.0, 3.0."""

BLUNT = -0.98
"""Cosine of angles opposite to which an edge gets a node.
Measured: a block turned by 1e-7 to 1e-3, degree 2: λ 1e-11, 1e-7 without."""

ROUNDS_BLUNT = 20
"""Largest number of searches for such angles.
Measured: 2 in 146 tests of test_clip, test_parting, test_solids_overlap, test_quadrilaterals and
test_curved; 8 where a row of bent facets lies along an outline (test_bent_row_along_an_outline),
with 5 no cells fit."""

NARROW_ANGLE = 1e-11
"""Sine of a triangle's largest angle that no flip makes.
Measured: with 0 a bush engaged by 0.01 of a facet fails in test_clip; 1e-12 and 1e-10 change
nothing there."""

BEHIND_FACET = 0.5
"""Depth in a body, in facet sizes, up to which facets may face it.
Measured: tubes of five facets: 0.18; with 5 whole boundaries fail in test_parting, 0.05 changes
nothing there."""
