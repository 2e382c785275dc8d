# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

COINCIDE = 2e-9
"""Distance of coincident nodes or midpoints, over the size of the interface or of a loop.

Measured: less than 2³⁰ cells of a grid; for midpoints 0 fails 39 of 174 tests of test_strip,
test_overlap, test_ends, 1e-13 to 1e-6 none."""

END = 1e-7
"""Overlap, in facet lengths, treated as zero.

Measured: files with 8 digits."""

SAME_TURN = 1e-3
"""Relative difference of both sides' turns at one kink.

Measured: 0.1× to 10× change nothing in 174 tests of test_strip, test_overlap, test_ends."""

ALIGNED = 0.1
"""Mean cosine between two chains that run in the same direction.

Measured: test_strip, test_overlap: facing chains 0.77 and more, others 0.0016 and less."""

APPROXIMATED = 1e-3
"""Distance, in edge lengths, of nodes of curved outlines that differ by the surfaces'
approximation only.

Measured: pad on a sphere, degree 2: corners are 1e-5 to 1e-8 apart; without it walls cut one
off, Σ's area is 2e-5 off instead of 6e-8; of parameters, in those of edges: Q2, 6e-5, without it
5.5e-4 instead of 7e-6."""

NEWTON_RIM = 8
"""Steps to the nearest point of an outline's edge, or of a curved edge in the plane, at most.

Measured: straight edges need 2; the 8th step is up to 8e-9 edges (test_solids_overlap); in the
plane 4 pass test_overlap, 3 fail."""

WITHIN = 0.95
"""Part of an edge through a wall, around its middle, in which a corner of the outline is cut off.

Measured: 0 to 0.9999 change nothing in 99 tests of test_slab, test_straight, test_curved,
test_solids_overlap, where no wall cuts off a corner."""

REACH_WALLS = 0.5
"""Distance of the outlines of facing pieces, in edge lengths, above which they don't match.

Measured: up to 0.10 in test_slab, 0.07 in test_front."""

FLAT_GAP_CELL = 1e-9
"""D of a cell, over its scale, up to which it is flat.

Measured: 0.1× to 10× change nothing in test_front, test_slab, test_straight, test_curved."""

THIN_CELL = 1e-4
"""D of a cell, over its scale, up to which fronts avoid it at first.

Measured: a block turned by 1e-8 to 1e-5, degree 1: error of λ 1e-11, with 1e-9 up to 10."""

PARALLEL_RIMS = 1e-2
"""D over its scale of a cell between edges of both outlines, up to which walls replace them if
curved cells are inverted.

Measured: pads on a cylinder and a sphere, degree 3: 24 and 39 straight edges and Σ's area 5e-4
off if only inverted ones are replaced, none and 3e-7, 3e-8."""

SHIFT = 0.1
"""Displacement, in edges, by which ties between moves of the front are told apart.

Measured: structured meshes, 1 to 20 cells a side."""

SWEEP = 0.1
"""Further displacement, in edges, that heights stand for, so that fronts sweep over surfaces.

Measured: spheres: 200 000 facets take 0.5 of the time, 10 000 as long; waved, jittered squares
of 50 000 facets: fronts take 0.55 of the time and leave as much."""

SWEPT = 10_000
"""Vertices above which surfaces with walls are swept too.

Measured: waved, jittered squares of 10 000 facets gain nothing."""

LEFT = 2e-3
"""Triangles left, for each cell, up to which cavities are filled before another front is tried.

Measured: waved, jittered squares: mostly none, up to 1e-3; below 1000 facets a cavity leaves
more."""

EXTRAPOLATE = 2.0
"""∂λ/∂α from which cells are swapped for others with smaller values.

Measured: condition of G_AA, nine closed scenes: up to 13.5, with 3 6.0, with 2 5.1, with 1.25
5.0."""

LEAN = 0.3
"""Least outward component of the displacement of walls, over that of the farthest vertex.

Measured: without it the frames of test_hole get interior nodes; 0.03 fails no test of test_front
but cavities of test_curved have up to 92 faces, not 62; 3 changes nothing there."""

SWEEPS = 3000
"""Sweeps of the search for weights, at most.

Measured: skew meshes need up to 2000."""

CELLS = 30
"""Cells for each facet from which a front is given up.

Measured: any_surfaces: up to 6."""

AROUND_SWAPS = 6
"""Cells around an edge that are swapped for others, at most.

Measured: 3 to 7 pass test_front, test_straight, test_curved; without them test_swaps fails."""

NEAR_MATCHING = 0.05
"""Distance of twins of matching facets, in their heights, and of their vertices, in edges.

Measured: 0.1× to 10× change nothing in test_front, test_slab, test_straight, test_curved."""

SEES = 1e-3
"""Least distance inside all faces, in edges, of a point from which a cavity's faces are seen.
Measured: 0 and 1e-2 change nothing in the tests of gap_mesh; 0 accepts cells thinner than
THIN_CELL."""

INSET = 0.02
"""Least distance in α of interior nodes from both surfaces.

Measured: 0.1× to 10× change nothing in test_front, test_slab, test_straight, test_curved."""

LARGE_CAVITY = 400
"""Faces above which a cavity is given up.

Measured: those filled have up to 64 (test_solids_overlap); with 40 a scene of test_front fails."""

WHOLE_COVERED = 1 - 1e-9
"""Covered part of a facet from which it is whole.

Measured: round-off 1e-15."""
