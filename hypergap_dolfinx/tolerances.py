# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tolerances of the doors: one value, one meaning, and the measurement behind each."""

import numpy as np

ALIKE = 1.1
"""Ratio of node distances up to which stiffness chooses Γ1.

Measured: –"""

THIN_LAYER = 0.01
"""Thickness over length of cells of a layer that is Γ1 though finer.

Measured: –"""

STIFF = 100.0
"""Ratio of stiffnesses from which it chooses Γ1 whatever the sizes.

Measured: –"""

BEHIND_BODY = 0.5
"""Overlap, in thicknesses of the thinner body (2 V / A, at most its extent), from which a vertex of
Γ1 is on the other side of Γ0's body.

Measured: a clip over a hollow pin, wall .6: what lies opposite through the pin overlaps by .9;
with the extents, 2, it was pushed out."""

CLOSED_NORMAL = 0.5
"""Length of the mean normal up to which a surface looks to all sides.

Measured: half a circle 0.64, half a sphere 0.5."""

FLAT_TURN = 1e-6
"""Turn of a surface in space that is none.

Measured: files with 8 digits."""

FINER = 1.5
"""How much finer than Γ0 a Γ1 may be unwarned.

Measured: Hertz: p0 within 0.2 % at 1.5, 3.8 % at 3 (h = a/10)."""

HALVINGS = 6
"""Times that a load step is halved.

Measured: –"""

NEAR_PIECES = 0.5
"""Distance of surfaces, in facet lengths, up to which they are pieces of one interface.

Measured: –"""

NEAR_FLAT = 1e-3
"""Distance of flat facets that touch, in sizes of the smaller one.

Measured: fits of AS1, a CAD assembly: 1e-8."""

BULGES = 2
"""The same of curved ones, in heights of the surface that turns tell of.

Measured: polygons of 6 to 60 edges in one circle: 1.03; spheres of irregular triangles, 1 : 4:
below 1.5."""

FACING_ANGLE = np.pi / 3
"""Angle by which normals may miss being opposite, if a distance is given.

Measured: –"""

TILT = np.pi / 36
"""The same by default, of flat facets.

Measured: –"""

TURNS_EXPLAINED = 0.75
"""How much more of curved ones, in sums of both facets' turns.

Measured: polygons in one circle: 0.5; a chamfer of 45° on a plate: 0.89."""

CORNER_ASSEMBLY = np.pi * 65 / 180
"""Turn that is a corner, not part of a curved surface.

Measured: a hexagon for a circle: 60°."""

COVER = 1e-6
"""Part of the smaller facet in common that is none.

Measured: files with 8 digits."""

LEAF = 4096
"""Pairs of boxes that are compared one by one.

Measured: –"""

PARTS = 8
"""Straight parts that an edge of Γ1 is drawn with.

Measured: –"""

LIFT = 0.01
"""How far from Γ0's body Γ1 is drawn in space, in its extent.

Measured: –"""

SEEN_THROUGH = 0.3
"""Opacity of a body in space that is in contact with itself.

Measured: by eye."""
