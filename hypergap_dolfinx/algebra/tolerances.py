# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

MOVES = 1e-3
"""Part of the largest motion below which messages leave a body's motion out.
Measured: 0.1× and 10× change nothing in test_contact_input."""

ROTATES = 0.1
"""Speed of rotation over that of translation from which messages call a motion a rotation.
Measured: 0.1× and 10× change nothing in test_contact_input."""

ASTRAY = 0.5
"""Displacement of a body in a failed load step, over its extent, that a message mentions.
Measured: a block that slides off its support: 3."""

INVERTED_CORNER = 1e-10
"""Negative det J at a corner, over diameterⁿ, that is accepted as zero.
Measured: corners of 180°, digits of files."""

CONTRADICT = 1e-6
"""Difference of prescribed values, over the largest, that is a contradiction.
Measured: round-off 1e-16, single precision 1e-7."""

NOTHING = 1e-12
"""Relative size treated as zero: forces and energies of rigid motions over K's rows, entries of B
over the largest, prescribed displacements over the interface, a contact's pressure over the largest
of all, the compliance of contact that sticks, or has no friction, over that of the bodies.
Measured: round-off 2e-15 to 5e-13; held at one node 2.5e-5; prescribed entries are exact zeros; a
rod without a weight between nuts that aren't tightened: pressures of 4e-18 to 2e-16; blocks between
walls, cells 2:3, 4:6 with the finer as Γ1: none without that compliance, the same with 1e-10 and
1e-13; error of a block that sticks 7e-14, 5e-11 with 1e-10, 4e-12."""

APART = 0.5
"""Distance across a tie, in cell sizes, from which it is more than an error of the meshes.
Measured: polygons in rings up to 0.28, blocks a cell apart from 0.74."""

DEPENDENT = 1e-5
"""Sine of the angle between motions up to which they are the same.
Measured: the same motions 4e-8 by their Gram matrix (eigenvalue 1.6e-15), 2e-15 by an SVD."""

RESIDUAL_ACCEPTED = 1e-3
"""Residual of a direct solve, over the loads, that is a failure.
Measured: ε × condition, or about 1."""

BACKWARD = 1e-6
"""Backward error of an iteration that is a failure; residual of a symmetric factorisation, over the
right-hand side, from which an unsymmetric one replaces it.
Measured: up to 6e-10, contrasts 1e-6 to 1e6; symmetric factors in ironing, 1300 to 18 700
displacements: 1e-14 to 8e-12."""

UNSYMMETRIC = 1e-9
"""Relative difference of yᵀKx and xᵀKy from which multigrid's levels are stored as a whole.
Measured: round-off 1e-16; elasticity with convection, 1800 displacements, GMRES: 7e-7 as many
iterations with the upper halves, 7e-6 22 for 19, 7e-5 31 for 19, 7e-4 none for 33."""
