# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

import numpy as np

STRAIGHT = 1e-12
"""Deviation from a straight edge treated as zero, relative to the size of the facet or cell.
Measured: 4e-15 in straight meshes; a circle of n facets has 0.8 / n."""

NOISE = 64 * np.finfo(float).eps
"""Round-off of coordinates and their differences, relative to the largest coordinate.
Measured: straight edges, degree 3: up to ε; turns of straight edges: 0.75 ε."""

ORTHOGONAL = 1e-10
"""Entries of RᵀR − 1 up to which R is a rotation.
Measured: 1000 rotations: 1.4e-15; written with 12 digits 1.6e-12, with 8 digits 1.7e-8."""

OFF_CARRIED = 1e-6
"""Distance between Γ1 and the image of Γ0 treated as zero, relative to Γ1's size.
Measured: files with 8 digits."""

SAG_OUTLINE = 0.25
"""Distance from Γ1 to the image of Γ0 treated as zero, in facet lengths, where the outlines'
extents differ.
Measured: facets that turn by 60°: 0.13."""

SAME_NODE = 1e-10
"""Distance of equal nodes in two reference elements.
Measured: round-off 3e-16, nodes 0.03 apart (degree 10)."""

STANDS_OUT = 3
"""Ratio to the turns beside it from which a turn is a corner.
Measured: edges of unstructured spheres, cylinders and tori 0.9, 2.6, 2.5 (two edges of 5.4); of
skew blocks' corners 3.5 and more (72 blocks, edges of faces at up to 60°)."""

TURN = 1e-8
"""Turn treated as zero.
Measured: files with 8 digits."""

KINK = np.pi / 3
"""Turn between edges of a curve in the plane that is a corner in any case; that of an edge in space
from which it is on a contact's Γ1.
Measured: 80° changes nothing in test_strip, 30° fails there. Six ellipsoids and plates of
any_contacts with unstructured quadrilaterals turn by up to 51° at an edge, boxes by 61° to 106°."""

OPPOSITE_COSINE = -0.5
"""Largest cosine of the normals of faces and samples that surfaces are compared with.
Measured: −0.3 changes nothing in test_clip and test_parting."""

FACING_COSINE = -0.3
"""Largest cosine of the normals of surfaces that face each other.
Measured: −0.03 and −0.5 change nothing in test_clip, test_parting but test_tree, which has −0.3."""

LEANS_SEARCH = 0.5
"""Largest tangent of the angle between a triangle's normal and the direction to a point above it.
Measured: 0.05 and 5 change nothing in test_clip, test_parting but test_tree, which has 0.5."""

CORNER = np.radians(80)
"""Turn between facets, or edges of an outline in space, that is a corner in any
case; largest error of a normal at an outline.
Measured: tests' tori of 5 facets around a tube turn by 72°; normals at outlines bend by 60°."""

CURVES = 0.5
"""Share of the turn between straight facets that remains between curved ones at a kink.
Measured: tests' tori of 5 facets around a tube; of 107 bent boxes of degree 2 (random assemblies)
two have a face in pieces, with 0 101; in 18 of these at most 21° remain within faces, at least 48°
at their edges, and facets count as beyond a corner from 32.5° (of :data:`CORNER_ASSEMBLY`)."""

OUTSIDE = 1e-4
"""Negative weight from which a point isn't in the triangle where its walk ended.
Measured: above `NEARLY`, the distance of equal outlines; matching hexahedra with a notch, halved:
u₁ − u₀ 1e-15, without it 3e-3."""

FURTHER_WALK = 8
"""Facets that a point may cross on a curved surface, from its straight facet.
Measured: 1 and 80 change nothing in test_curved."""

NEWTON_PROJECTION = 6
"""Newton steps for the projection on curved facets along normals.
Measured: 3 and 60 change nothing in test_curved."""

CORNER_ASSEMBLY = np.pi * 65 / 180
"""Turn from which an edge is a corner, not part of a curved surface.
Measured: a hexagon for a circle: 60°."""

GOES_ON = 4
"""Turn between two facets, over those beyond them, up to which it is curvature, not a corner.
Measured: the same rings: 2 incomplete with 2, 4 and 16, 30 with 1; 1.5 and 100 change nothing in
test_touching."""

FILE_DIGITS = 1e-6
"""Turn of a surface, or common part of the smaller facet, that files' last digits make.
Measured: files with 8 digits; for the part 1e-8 to 1e-3 change nothing in test_touching."""

OWN_GAP = 0.05
"""Gap between chords of a curved surface, over the distance or overlap closed, that is told.
Measured: rings of 16 and 24, 24 and 16, 32 and 48 edges, straight, degree 1: pressures of a
press-fit are off by 23, 22 and 5 % with shares of .29, .18 and .06, with .05 and less by what an
overlap so large costs curved cells too, or 4 % more."""
