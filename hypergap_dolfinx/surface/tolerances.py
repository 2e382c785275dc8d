# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

import numpy as np

STRAIGHT = 1e-12
"""Distance from a straight edge, in sizes of facet or cell, that is none.

Measured: 4e-15 in straight meshes; a circle of n facets has 0.8 / n."""

LAST_DIGITS = 8 * np.finfo(float).eps
"""Error of a coordinate, in the largest one.

Measured: straight edges, degree 3: up to ε."""

NOISE = 64 * np.finfo(float).eps
"""Error of a difference of coordinates, in the largest one.

Measured: turns of straight edges: 0.75 ε."""

ORTHOGONAL = 1e-10
"""Entries of RᵀR − 1 up to which R is a rotation.

Measured: –"""

ZERO = 1e-15
"""Entry of a rotation that is none.

Measured: cos(π/2): 6e-17."""

OFF_CARRIED = 1e-6
"""Distance from Γ1 to where Γ0 is carried, in Γ1's size, that is none.

Measured: files with 8 digits."""

SAG_OUTLINE = 0.25
"""The same in lengths of facets, of outlines of different extent.

Measured: facets that turn by 60°: .13."""

SAME_NODE = 1e-10
"""Distance of one node in two reference elements.

Measured: round-off 3e-16, nodes 0.03 apart (degree 10)."""

KINK = np.pi / 3
"""Turn that is a corner whatever is beside it.

Measured: –"""

STANDS_OUT = 4
"""Times the turns beside it from which a turn is a corner.

Measured: –"""

TURN = 1e-8
"""Turn that is none.

Measured: files with 8 digits."""

FACING_COSINE = -0.3
"""Cosine of normals of surfaces that face each other.

Measured: –"""

LEANS_SEARCH = 0.5
"""Tangent of the angle by which the way to a point may lean from a normal.

Measured: –"""

BUNCH = 4
"""Triangles in a tree's smallest parts.

Measured: –"""

CURVE = 10
"""Bits of the curve along which they are sorted.

Measured: –"""

CORNER = np.radians(80)
"""Turn from facet to facet that is a corner whatever is beside it.

Measured: any_surfaces: tori of 5 facets around a tube turn by 72°."""

CURVES = 0.5
"""Of the turn between straight facets, what is left between curved ones at a corner.

Measured: any_surfaces: tori of 5 facets around a tube."""

OUTSIDE = 1e-4
"""Weight below zero from which a point isn't in the triangle where the way to it ended.

Measured: above `NEARLY`: outlines are as far apart; matching hexahedra with a notch, halved: u₁
− u₀ up to 3e-3, 1e-15 now."""

FURTHER_WALK = 8
"""Facets that a point may cross on a curved surface, from its straight facet.

Measured: –"""

NEWTON_PROJECTION = 6
"""Steps to where a line along a surface's normals meets it.

Measured: –"""

FACING_NEIGHBOURS = -0.5
"""Cosine of the outward normals of facets that face each other.

Measured: –"""

SAMPLES_KINKS = 64
"""Facets of a piece that are asked what lies opposite.

Measured: –"""

COVERED_SIDE = 0.95
"""Part of a facet of Γ1 that Γ0 must reach for multipliers of contact on all its vertices; in the
plane, if they had them.

Measured: in the plane, flat punch, cut at 0.01 to 0.99: corner 2.2 to 4.9 times the mean, beyond
it up to 8.5."""
