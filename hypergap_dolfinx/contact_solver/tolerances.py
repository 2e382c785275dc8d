# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

COVERED_AREA = 1e-3
"""Smallest area of a weight, over its facets', for which there is a multiplier.
Measured: 0.1× to 10× change nothing in 147 tests of contact."""

HOLDS = 1e-6
"""Relative size, or sine, below which constraints on motions, and extents of points, are zero.
Measured: 0.1× to 10× change nothing in 147 tests of contact; derivatives by prescribed dofs are
exact zeros."""

NEAR_ENDS = 0.5
"""Distance of both sides' ends, in facet lengths, up to which they are one place.
Measured: 0.1 to 0.9 change nothing in 147 tests of contact."""

PARALLEL_ENDS = 0.5
"""Cosine between normals of two contacts above which they constrain the same direction.
Measured: 0.1 to 0.9 change nothing in 147 tests of contact."""

EXCEEDS = 1e-7
"""Traction beyond μ p, and pull, over the largest one, treated as zero.
Measured: round-off 1e-12; a column at 1e-6 above and below what holds it; for pulls 1e-9 and 1e-7
change nothing in 147 tests of contact."""

UNTOLD = 1e-12
"""Weight of increments of sticking tractions, beside the bodies' stiffness.
Measured: blocks between walls, cells 2:3, 4:6 with the finer as Γ1: none without, the same with
1e-10 and 1e-13; error of a block that sticks 7e-14, 5e-11 with 1e-10, 4e-12."""

EXACT = 1e-11
"""Gap, in facet sizes, beyond which there is one more Newton step with friction.
Measured: moment of friction in ironing at rtol 1e-8: 1.3e-14, without 3.3e-12; Newton steps 4.5,
without 4.0."""

STEPS = 25
"""Newton steps after which a load step is halved.
Measured: Hertz up to 8, ironing up to 8."""

ROTATION_ZERO = 1e-10
"""Norm of R − 1 treated as no rotation.
Measured: translations: 1e-15."""

TOGETHER = 0.5
"""Relative rotation, over the larger one, below which two bodies rotate together.
Measured: 1/20 of the other's: 31 Newton steps for 3 with an elastic slip."""

OSCILLATES = -0.5
"""Cosine between Newton steps below which they oscillate.
Measured: flat die, μ = 0.5, Γ1 = die: -0.99 to -1.00 where they do."""

BACK = 3
"""Steps taken backwards, where the tangent's work is negative, before damping starts.
Measured: flat die, μ = 0.5: one is enough, 7 and 8 Newton steps at a snap, 14 to 19 without."""

SHORTENED = 0.25
"""Factor by which a step is shortened that is too long.
Measured: flat die of degree 2 as Γ1, μ = 0.2, dragged by a cell at a time: 9.8 Newton steps, no
halvings; with 0.5 10.7 and one, with 0.1 22 and one."""

CLOSED_GAP = 1e-9
"""Relative gap treated as zero: in facet sizes, or over the largest gap.
Measured: round-off 1e-15; for the order of gaps 1e-8 and 1e-10 change nothing in 147 tests of
contact."""

UNPRESSED = 1e-12
"""Pressure, over the largest of all contacts, treated as zero.
Measured: a rod without a weight between nuts that aren't tightened, beside bolts: 4e-18 to
2e-16."""

ROUND_OFF_FORCES = 1e-14
"""Residual, over stiffness times displacement, treated as round-off.
Measured: 0.1× to 10× change nothing in 147 tests of contact."""

RESIDUAL_LDLT = 1e-8
"""Residual of an LDLᵀ solution, over the right-hand side, above which LU is used.
Measured: ironing, 1300 to 18 700 displacements: 1e-14 to 8e-12."""

ITERATIONS = 8
"""GMRES iterations with old factors after which the matrix is factorised.
Measured: ironing, Hertz: changes of 1e-10 to 3e-5 take 2 to 4 iterations, 1e-4 to 6e-4 5 or 6."""

REDUCED = 1e-10
"""Reduction of the residual by these iterations.
Measured: as many Newton steps as with factors."""

REUSED = 1e-4
"""Relative change of a matrix below which its factors are reused (GMRES), and displacement, in
facet sizes, below which a load step's first step reuses a body's stiffness.
Measured: ironing, Hertz: matrices that change by 1e-10 to 3e-5 take 2 to 4 iterations, 1e-4 to 6e-4
5 or 6, 2e-3 to 1e-2 7 to 13; as many Newton steps with displacements of 0 to 1e-4."""

BLOCKS = 10
"""Rounds of block pivoting without fewer wrong signs, after which they are exchanged one by one;
rounds a row after which it is given up.
Measured: later"""

PIVOT = 1e-10
"""Pivot treated as zero, in a matrix of numbers around 1.
Measured: later"""

ADDED = 0.05
"""First share of the elastic stiffness that is added where a tangent has too many negative pivots.
Measured: later"""

ADDED_TIMES = 6
"""Times that this share is increased.
Measured: later"""

PATIENCE = 4
"""Newton steps without a smaller residual after which steps are searched along.
Measured: later"""

RAYS = 3
"""Newton steps in a row with a linearised problem that has no solution after which a body leaves.
Measured: later"""

DECREASE = 1e-4
"""Part of the expected decrease of the penalty that is enough for a step.
Measured: later"""

TRIALS = 6
"""Times that a step is halved.
Measured: later"""

PROGRESS = 0.9
"""Residual, over the smallest so far, that is progress.
Measured: later"""

DENSE = 60
"""Newton steps in a small problem with friction, before and with a line search.
Measured: later"""

ADDED_FACTOR = 4.0
"""Factor by which this share is increased.
Measured: later"""

STALLED = 16
"""Newton steps without progress after which a load step is halved.
Measured: later"""

TRIALS_DENSE = 10
"""Times that a step in a small problem with friction is halved.
Measured: later"""
