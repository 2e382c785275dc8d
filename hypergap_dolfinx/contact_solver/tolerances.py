# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

COVERED_AREA = 1e-3
"""Area of a weight, over its facets', from which it is one.

Measured: –"""

HOLDS = 1e-6
"""Sine between what multipliers hold of motions that is none.

Measured: –"""

REST = 2 / 3
"""Of the level that has the whole force and that of the last set, how near contact is to the first.

Measured: exact for spheres; Hertz in space, a/4 to a/12: 4 to 8 Newton steps; sets alone, up to
a/8: at most 6, with 0.5 7, with 1 9."""

DIGITS_SETS = 9
"""Digits of ways to contact that are compared.

Measured: –"""

NEAR_ENDS = 0.5
"""Distance of both sides' ends, in facet lengths, up to which they are at one place.

Measured: –"""

PARALLEL_ENDS = 0.5
"""Cosine of the normals of two contacts from which they hold the same of a place.

Measured: –"""

FREE = 1e-8
"""Derivative of a gap at what can move, over that at all, that is none.

Measured: prescribed ones are exact zeros."""

EXCEEDS = 1e-7
"""Traction beyond μ p, over the largest μ p, that is none.

Measured: round-off 1e-12; a column at 1e-6 above and below what holds it."""

UNTOLD = 1e-12
"""Weight of changes of what sticks, beside the bodies' stiffness.

Measured: blocks between walls, cells 2:3, 4:6 with the finer as Γ1: none without, the same with
1e-10 and 1e-13; error of a block that sticks 7e-14, 5e-11 with 1e-10, 4e-12."""

EXACT = 1e-11
"""Gap, in sizes of facets, beyond which there is one more Newton step with friction.

Measured: moment of friction in ironing at rtol 1e-8: 1.3e-14, without 3.3e-12; Newton steps 4.5,
without 4.0."""

STEPS = 25
"""Newton steps after which a load step is halved.

Measured: Hertz up to 8, ironing up to 8."""

AHEAD = 10
"""Newton steps in which sets look ahead.

Measured: later ones could cycle."""

SPREAD = 1e-12
"""Square of points' extent, over that of their longest direction, that says nothing of a turn
around it.

Measured: –"""

ROTATION_ZERO = 1e-10
"""Turn (norm of R − 1) that is none but for round-off.

Measured: translations: 1e-15."""

TOGETHER = 0.5
"""Turn against each other, over the larger turn, from which two bodies don't turn together.

Measured: 1/20 of the other's: 31 Newton steps for 3 with an elastic slip."""

OSCILLATES = -0.5
"""Cosine between Newton's steps from which they go to and fro.

Measured: flat die, μ = 0.5, Γ1 = die: -0.99 to -1.00 where they do."""

SHRINKS = 0.5
"""Length of such a step, over the last one's, below which they end even so.

Measured: –"""

LONG = 3.0
"""The same over that of the load step's first one, from which it goes nowhere.

Measured: flat die, Γ1 = die, μ = 0.2, dragged by a cell at first: 27 Newton steps without, 19
with it."""

NOISE_RELAXATION = 1e-6
"""Length of a step, over the load step's first one, below which it is round-off's.

Measured: the same: 0.02 and more."""

SHARE = 0.3
"""Share of the bodies' stiffness at first.

Measured: the same, at two snaps: 17 and 26 Newton steps; with 1: 17 and 42, without none ends."""

GROWS = 4.0
"""Times the share where steps turn again, or are longer than those that turned.

Measured: –"""

FALLS = 0.1
"""Times the share at least from step to step where the residual falls.

Measured: –"""

LEAST = 1e-3
"""Share that is none.

Measured: –"""

MOST = 5.0
"""Share from which bodies only creep, and the load step is halved.

Measured: beams 20 to 67 times as long as thick under a stiff round body, 44 load steps: 6317
Newton steps without, 4131 with 5, 4133 with 1.3."""

REFUSED = 4
"""Times in a row that a step is too long.

Measured: flat die of degree 2 dragged by two cells: one that closes a gap of 0.01 stays as long
at any share."""

BACK = 3
"""Steps back, where the tangent's work is negative, before bodies are viscous.

Measured: flat die, μ = 0.5: one is enough, 7 and 8 Newton steps at a snap, 14 to 19 without."""

WORSE = 3.0
"""Residual after a step, over that before it, from which it is shortened.

Measured: flat die, μ = 0.2: every third step 6 to 8 Newton steps, 8 to 10 without; 1.5: the
same."""

SHORTENED = 0.25
"""Part of it that is taken.

Measured: flat die of degree 2 as Γ1, μ = 0.2, dragged by a cell at a time: 9.8 Newton steps, no
halvings; with 0.5 10.7 and one, with 0.1 22 and one."""

SHORTEST = 4
"""Times that it is shortened.

Measured: the same: one halving with 2, three with 1, five without."""

RELAXED = 50
"""Newton steps that are granted for it.

Measured: the die: up to 25 are used."""

FAR_STEP = 1.0
"""Prescribed motion, in sizes of facets, from which bodies follow it as rigid ones first, or are
carried.

Measured: ironing in steps of 5 cells: 6 to 8 Newton steps, without 7 to 19 and halvings; steps
of 0.33 cells: 3 to 6."""

CLOSED_GAP = 1e-9
"""Gap, in sizes of facets, that is none.

Measured: round-off 1e-15."""

PULLS = 1e-8
"""Negative pressure, over the largest, that is none.

Measured: –"""

UNPRESSED = 1e-12
"""Pressure, over the largest of all contacts, that is round-off.

Measured: a rod without a weight between nuts that aren't tightened, beside bolts: 4e-18 to
2e-16."""

ROUND_OFF_FORCES = 1e-14
"""Residual, over stiffness times displacement, that is none.

Measured: –"""

RESIDUAL_LDLT = 1e-8
"""Residual of a solution with LDLᵀ, over the right-hand side, from which LU is taken.

Measured: ironing, 1300 to 18 700 displacements: 1e-14 to 8e-12."""

NEAR_FACTORS = 1e-4
"""Change of a matrix, over its size, below which it is solved by GMRES with the factors that there
are.

Measured: ironing, Hertz: 1e-10 to 3e-5 take 2 to 4 iterations, 1e-4 to 6e-4 5 or 6, 2e-3 to 1e-2
7 to 13."""

ITERATIONS = 8
"""Iterations after which it is factorised.

Measured: as above."""

REDUCED = 1e-10
"""Residual that they leave, over the one at what is known before.

Measured: as many Newton steps as with factors."""

SLACK = 1e-4
"""Displacement, in sizes of facets, since a body's stiffness was assembled, after which it does for
a load step's first step.

Measured: ironing: as many Newton steps with 0 to 1e-4."""
