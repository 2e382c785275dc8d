# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

import numpy as np

CORNER_OUTLINE = np.radians(80)
"""Turn of an outline that is a corner.

Measured: –"""

OFF_OUTLINES = 4e-10
"""Distance of outlines, in edge lengths, that is none.

Measured: a plate 1e-9 larger than its block: u 9e-10 with 1e-9."""

NEARLY = 1e-5
"""The same where nodes of both outlines come in pairs.

Measured: any_surfaces: noise of 1e-6, which can't be cut in 10 of 23 scenes; meshes off by ε
facets: u 2e-12, λ 11 ε²."""

STEEP = np.radians(80)
"""Error of a normal at an outline at most.

Measured: –"""

PAIRS = 1_000_000
"""Pairs looked at in one go.

Measured: –"""

ROUND_OFF_WEIGHTS = 1e-12
"""How negative a weight may be inside of a triangle.

Measured: –"""

INSIDE_WEIGHT = 1e-9
"""The same in a curved triangle.

Measured: Newton's method ends at 1e-10."""

AWAY = 0.5
"""Distance of outlines, in lengths of their edges, that no bend explains.

Measured: flush tubes of five facets 0.16; a bolt of six facets that ends 0.8 of one behind its
hole."""

NEWTON_OUTLINES = 6
"""Steps of Newton's method to where a point lies along a triangle's normals.

Measured: round-off after 5; bush in a hole, 5 to 12 straight facets around, staggered,
overlapping in part: 118 of 120 get cells, with 4 steps 115."""

LEVEL = 0.2
"""Cosine between such normals and the triangle's below which steps are no longer.

Measured: –"""

BESIDE = 0.5
"""The same in a straight triangle of points that the curved one may have.

Measured: –"""

NEWTON_CROSSING = 8
"""Steps to where two curved edges cross.

Measured: –"""

FOLDS = 0.2
"""Share of a cut triangle's area that bent edges leave it everywhere.

Measured: –"""

SNAP = 2e-9
"""Distance, in outline edges, below which nodes and edges are at one place.

Measured: cuts of 1e-12 to .9, degree 2: u 4e-10, λ 6e-7; λ 1e-6 with 1.2e-9, u 2e-9 with 1e-8."""

COARSER = 10.0
"""Times that distance with which it is tried again where no cells fit.

Measured: 100 squares moved by 1e-10 to 1e-4: 2 fail at first, none with it."""

TRIES = 3
"""Times that it is tried.

Measured: the same: 2 were enough."""

CHORDS = 2
"""Straight parts of a curved outline's edge, per degree.

Measured: pad on a cylinder: rates 2.0, 3.0."""

BLUNT = -0.98
"""Cosine of angles opposite to which an edge gets a node.

Measured: a block turned by 1e-7 to 1e-3, degree 2: λ 1e-11, 1e-7 without."""

ROUNDS_BLUNT = 5
"""Times that such angles are looked for.

Measured: –"""

NARROW_ANGLE = 1e-11
"""Sine of a triangle's largest angle that no flip makes.

Measured: –"""

FLIPS = 50
"""Flips, over the number of points squared, at which it is given up.

Measured: –"""

BEHIND_FACET = 0.5
"""Depth in a body, in facet sizes, up to which what lies there may face it.

Measured: tubes of five facets: 0.18."""
