# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

TIE = 1e-9
"""Difference of parameters of midpoints (0 to 1) that are equal: Γ0's first.

Measured: –"""

END = 1e-7
"""Overlap, in facet lengths, that is none.

Measured: files with 8 digits."""

SAME_TURN = 1e-3
"""Relative difference of both sides' turns at one kink.

Measured: –"""

COINCIDE_CHAINS = 2e-9
"""Distance of nodes at one place, in sizes of the interface.

Measured: less than 2³⁰ cells of a grid."""

SAMPLES_CHAINS = 64
"""Places at which chains are compared in direction.

Measured: –"""

COINCIDE_WALLS = 1e-9
"""The same in space, in sizes of a loop.

Measured: –"""

APPROXIMATED = 1e-3
"""Distance of nodes of curved outlines that are one but for the surfaces' approximation, in edge
lengths.

Measured: pad on a sphere, degree 2: corners are 1e-5 to 1e-8 apart; without it walls cut one
off, Σ's area is 2e-5 off instead of 6e-8; of parameters, in those of edges: Q2, 6e-5, without it
5.5e-4 instead of 7e-6."""

NEWTON_RIM = 8
"""Steps to the nearest point of an outline's edge.

Measured: –"""

CONVERGED_RIM = 1e-13
"""A step, in edges, after which there is none.

Measured: –"""

WITHIN = 0.95
"""Share of an edge through a wall within which a corner isn't at its end.

Measured: –"""

FURTHER_RIM = 100
"""Edges that such a point may be away.

Measured: –"""

REACH_WALLS = 0.5
"""How far apart edges of facing pieces may be, in facet lengths.

Measured: –"""

FLAT_GAP_CELL = 1e-9
"""D of a cell, over the product of its two edges on the surfaces, that is none.

Measured: –"""

THIN_CELL = 1e-4
"""The same of cells that fronts do without at first.

Measured: a block turned by 1e-8 to 1e-5, degree 1: error of λ 1e-11, with 1e-9 up to 10."""

PARALLEL_RIMS = 1e-2
"""D of a cell between edges of both outlines, over their lengths, up to which it goes if curved
cells are turned over.

Measured: pads on a cylinder and a sphere, degree 3: 24 and 39 straight edges and Σ's area 5e-4
off if only those go that are turned over, none and 3e-7, 3e-8."""

SHIFT = 0.1
"""Displacement, in edges, by which ties between moves of the front are told apart.

Measured: structured meshes, 1 to 20 cells a side."""

SWEEP = 0.1
"""Displacement, in edges, that heights stand for besides, so that fronts sweep over surfaces.

Measured: spheres: 200 000 facets take 0.5 of the time, 10 000 as long; waved, jittered squares
of 50 000 facets: fronts take 0.55 of the time and leave as much."""

SWEPT = 10_000
"""Vertices of surfaces with walls from which they are swept too.

Measured: the same of 10 000 facets gain nothing."""

LEFT = 2e-3
"""Triangles left, for each cell, up to which cavities are filled before another front is tried.

Measured: waved, jittered squares: mostly none, up to 1e-3; below 1000 facets a cavity leaves
more."""

EXTRAPOLATE = 2.0
"""∂λ/∂α from which cells are swapped for others, if these have smaller ones.

Measured: condition of G_AA, nine closed scenes: up to 13.5, with 3 6.0, with 2 5.1, with 1.25
5.0."""

LEAN = 0.3
"""Share of it by which walls lean outwards at least.

Measured: frames, round holes."""

SWEEPS = 3000
"""Sweeps of the search for weights.

Measured: skew meshes need up to 2000."""

VISITS = 30_000_000
"""Edges looked at in them: a second.

Measured: –"""

VISITS_EACH = 30
"""The same for each edge, of more than a million.

Measured: squares of 2 000 … 200 000 facets: 5 … 15."""

CELLS = 30
"""Cells for each facet from which a front is given up.

Measured: any_surfaces: up to 6."""

ROUNDS_SWAPS = 12
"""Of swaps of cells that are turned over.

Measured: –"""

AROUND_SWAPS = 6
"""Cells around an edge that are swapped.

Measured: –"""

NEAR_MATCHING = 0.05
"""Distance of twins of matching surfaces, in edges.

Measured: –"""

SOME = 8
"""Vertices that are looked at before all are.

Measured: spheres of 50 000 facets: 0.01 instead of 3 µs a facet."""

CROWD = 500
"""Vertices in one plane beyond which twins are not looked for.

Measured: –"""

INSET = 0.02
"""Share of α that interior nodes keep from both surfaces.

Measured: –"""

SEES = 1e-3
"""How far inside of all faces, in edges, a cone's node must be.

Measured: –"""

ROUNDS_CAVITY = 100
"""Times that a cavity is enlarged.

Measured: any_surfaces: up to 15."""

LARGE_CAVITY = 400
"""Faces of a cavity that is given up.

Measured: –"""

WHOLE_COVERED = 1 - 1e-9
"""Part of a facet from which it isn't cut.

Measured: round-off 1e-15."""
