# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of the doors: one value, one meaning, and the measurement behind each."""

import numpy as np

ALIKE = 1.1
"""Ratio of node distances up to which stiffness chooses Γ1.
Measured: 1.01 and 2 change nothing in 135 tests of test_sides, test_domain and test_bad_input."""

FEW_FACETS = 2
"""Facets of a coarser side of degree 1, in the plane, up to which the finer one is Γ1.
Measured: 60 random scenes of the plane, degree 1, that have such sides: largest H¹ error over the
interpolant's 1.50 with 0, 1.18 with 2; geometric mean 1.033, 1.022; λ's errors 3 % larger. With
degree 2, and in space, it is no better."""

THIN_LAYER = 0.01
"""Thickness over length of cells of a layer that is Γ1 though finer.
Measured: 0.001 and 0.1 change nothing in 74 tests of test_sides and test_domain."""

STIFF = 100.0
"""Ratio of stiffnesses from which it chooses a contact's Γ1 whatever the sizes.
Measured: 10 to 1000 change nothing in 36 tests of test_contact and test_contact_input."""

BEHIND_BODY = 0.5
"""Overlap, in thicknesses of the thinner body (2 V / A, at most its extent), from which a vertex of
Γ1 is on the other side of Γ0's body; half of it is told before the first load step.
Measured: a clip over a hollow pin, wall .6: what lies opposite through the pin overlaps by .9;
with the extents, 2, it was pushed out. Before the first load step: of 237 tests 6 overlap by .04 to
.14, a thin slanted beam by .6, bodies on the wrong sides by 2.4; press-fits by .04 at most."""

CLOSED_NORMAL = 0.5
"""Length of the mean unit normal up to which a surface counts as closed.
Measured: half a circle 0.64, half a sphere 0.5."""

FINER = 1.5
"""Ratio of facet sizes, Γ0's over Γ1's, above which a contact warns.
Measured: Hertz: p0 within 0.2 % at 1.5, 3.8 % at 3 (h = a/10)."""

HALVINGS = 6
"""Times that a load step is halved.
Measured: steps that succeed need at most 2 in 70 tests of test_contact, test_contact_input,
test_contact_scenes and test_contact_bodies."""

NEAR_FLAT = 1e-3
"""Distance of flat facets that touch, over the size of the smaller one.
Measured: fits of AS1, a CAD assembly: 1e-8."""

FACING_ANGLE = np.pi / 3
"""Deviation of curved facets' normals from opposite ones that no turn makes larger.
Measured: test_touching: 45° loses curved facets (2 of 140 tests), 75° changes nothing."""

TILT = np.pi / 36
"""Deviation of flat facets' normals from opposite ones, and of contact's forces from Γ1's normals
in the mean, from which it is told; half the turn of a contact's corner from which it is on Γ1.
Measured: test_touching: 45° takes chamfers (2 of 48 tests), 0.5° changes nothing. Forces: of 284
contacts in tests and demos 27 lean by .02, 15 by .05, 14 by .1 and by .995 at most. Of 23 random
punches that slide on coarse facets, 11 lean by more: tangential over normal force off by .07 to
.38; 12 by less: .01 to .09."""

SEEN = 0.1
"""Width of facets' common part, over the smaller one's size, that is no sign of their distance.
Measured: with 0 collars on rods with imprinted edges take facets beyond these, and H¹ errors are 30
and 59 times the interpolant's in test_joints."""

NEAR_PIECES = 0.5
"""Distance of surfaces, in facet lengths, up to which ties are joined to a union.
Measured: 1e9 changes nothing in test_pieces, test_mixed, test_periodic, test_cross_points and
test_solids_pieces."""

SAME_COST = 1e-9
"""Relative difference of areas times preferences for sides that is round-off.
Measured: a T-joint with cells twice and half as long, 1 to 3 ranks: 2e-14."""

FAR_PRESSURE = 1.0
"""Distance of surfaces on which a pressure acts, in facet sizes of Γ1, and twice their overlap and
with small sliding their slide, in those of the finer side, from which it is told.
Measured: 300 random scenes of the plane, with sharp corners on coarse facets: told in 53. A disk
of radius .5 with facets of .1, pressed by .05 and .1 on flat facets of Γ1: of .5 to 2 with forces
40 to 100 % too small, told; of .25 with 23 and 4 %, of .125 with 4 %, not told.
"""

LEANING = 0.01
"""Mean by force of gaps up to edges that lean, or across which friction acts, in facet sizes of
Γ1, from which it is told.
Measured: a punch pressed into coarse facets, 10, 9, 7, 4, 2 and 13 % less force than on fine ones:
.013, .017, .019, .019, .018, .044; on finer facets, by at most 3 %: .002. Of 200 random scenes of
the plane it tells 30 of which nothing else is told. Of moments of friction: 200 of them .006 at
most but where overlaps of .7 and 1.1 facets are told, .025 and .089."""
