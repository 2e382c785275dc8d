# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

HOLDS = 1e-6
"""Relative size, or sine, below which constraints on motions, rotations and extents of points are
zero.
Measured: 0.1× to 10× change nothing in 147 tests of contact; derivatives by prescribed dofs are
exact zeros."""

SAME_END = 0.5
"""Distance of both sides' ends in facet lengths, sine between normals of two contacts, and part of
a normal that isn't prescribed, up to which they hold the same gap.
Measured: distances and cosines of 0.1 to 0.9 change nothing in 147 tests of contact."""

EXCEEDS = 1e-7
"""Traction beyond μ p, and pull, over the largest one, treated as zero.
Measured: round-off 1e-12; a column at 1e-6 above and below what holds it; for pulls 1e-9 and 1e-7
change nothing in 147 tests of contact."""

EXACT = 1e-11
"""Gap, in facet sizes, treated as zero: of vertices that join a working set, and beyond which there
is one more Newton step with friction.
Measured: moment of friction in ironing at rtol 1e-8: 1.3e-14, without 3.3e-12; Newton steps 4.5,
without 4.0. Structured blocks in space: with 1e-9 vertices join that are open by 2e-10, and one of
160 scenes has no equilibrium."""

STEPS = 25
"""Newton steps after which a load step is halved, most of them in its small problem with friction,
and rounds of the search for forces that balance a load.
Measured: Hertz up to 8, ironing up to 8; small problems 17 in both load steps of the bolted
assembly, at most 6 in 127 tests of contact_solver; 60 changes nothing there but seconds, where
there is no solution; 1 to 6 rounds for 1600 loads on random sets of points."""

CLOSED_GAP = 1e-9
"""Relative gap treated as zero: in facet sizes, or over the largest gap.
Measured: round-off 1e-15; for the order of gaps 1e-8 and 1e-10 change nothing in 147 tests of
contact."""

ROUND_OFF_FORCES = 1e-14
"""Residual, over stiffness times displacement, treated as round-off.
Measured: 0.1× to 10× change nothing in 147 tests of contact."""

ITERATIONS = 8
"""GMRES iterations with old factors after which the matrix is factorised.
Measured: ironing, Hertz: changes of 1e-10 to 3e-5 take 2 to 4 iterations, 1e-4 to 6e-4 5 or 6."""

REDUCED = 1e-10
"""Reduction of the residual by these iterations.
Measured: as many Newton steps as with factors; any_contacts, scene 92: 51, 77 with 1e-9."""

REUSED = 1e-4
"""Relative change of a matrix below which its factors are reused (GMRES), and displacement, in
facet sizes, below which a load step's first step reuses a body's stiffness.
Measured: ironing, Hertz: matrices that change by 1e-10 to 3e-5 take 2 to 4 iterations, 1e-4 to 6e-4
5 or 6, 2e-3 to 1e-2 7 to 13; as many Newton steps with displacements of 0 to 1e-4."""

OSCILLATES = -0.5
"""Part of the last Newton step that the next one takes back, as a negative number, from which they
oscillate; part of the forces along a step that is reversed at its end, or left there, from which a
line search changes its length.
Measured: flat die, μ = 0.5: 126 Newton steps in 32 load steps; 160 and a halving with the cosine
between steps, which also turns steps back that become shorter: then ironing in space takes up to 13
in a load step, not 9, and a rigid saw 46, not 21. With 0 the saw takes 28, and 12 random scenes of
the plane that take many steps 898 for 858. Forces, four such scenes: two solved, with -1 one."""

PATIENCE = 3
"""Newton steps of one kind after which another follows: steps backwards in a load step, where the
tangent's work is negative; steps of a load step whose length isn't shortened by a line search;
steps in a row of which the problem has no solution, before a body is said to leave.
Measured: backwards, flat die, μ = 0.5: 81 Newton steps in 24 load steps with 1 and 3, 143 and two
halvings without; shortened from the first, 4th and 7th step on, slender_contact: 404, 389 and 391,
and 134 scenes of any_contacts have 68, 64 and 81 load steps of more than 12 Newton steps; without a
solution, 127 tests of contact_solver: 515, with 6 554; with 1 one of them fails."""

SHORTENED = 0.25
"""Factor by which a step is shortened at whose end the residual is no number, the least one of the
line search, part of the residual that a step leaves if the load step is to go on, and by whose
inverse a line search lengthens a step, a step may be longer than the last one, and an added share
of stiffness grows.
Measured: shortened by 0.5: nothing changes in 127 tests of contact_solver; longer: any_contacts,
scenes 13 and 92: 149 Newton steps, 199 without a limit; added: 11 scenes of slender and round
bodies: growth by 2, 4, 16 takes 360, 360, 356 Newton steps."""

TRIALS = 6
"""Times that a step is shortened, or halved in the small problem, or an added share increased; half
the number of compliances along a path; rounds of block pivoting without fewer wrong signs before
Lemke's method, and its pivots over the square of the rows.
Measured: shortened up to 3 and 12 times, halved up to 4 and 30 times: nothing changes in the same
tests and scenes; without a share that grows one of the scenes fails."""

ADDED = 0.05
"""First share of the stiffness without stress that is added where a tangent isn't positive.
Measured: those 11 scenes: 360 Newton steps, with 0.01 365, with 0.3 362; without one fails.
any_contacts, scenes 1116, 1250, 547: 354 Newton steps and 5 halvings; with .25 1116 fails, the
others take 258 and 8."""

PIVOT = 1e-10
"""Pivot treated as zero, in a matrix of numbers around 1, and change of gaps or forces along a
ray, over the largest one.
Measured: a block that only a pull would hold: 3e-14 to 1e-12; 1e-13 and 1e-8 change nothing in
the same tests and scenes; 1e-13 to 1e-6 along rays nothing with 110 random bodies in grooves.
With friction, 451 small problems of blocks, stacks, wedges and discs that nothing else holds: the
least singular value over the largest is 1e-19 to 1e-14 in 75 of them, in the others from 1e-11
on."""

GUESSED = 500
"""Number of unknowns of the small problem above which their states are the next working set, as
long as they become fewer, and laws of right states stay linearised: a factorisation takes less time
than their right-hand sides.
Measured: bolted assembly, processor seconds of its solves: 6.9, with 240 6.9, with 120 7.1, with
1000 7.0; without, its first load step isn't solved after 2 minutes. Laws: 7 Newton steps, 5.7 s;
all linearised 19, 6.8; none 4, 5.9."""

NEARLY_STICKS = (0.01, 1e-4)
"""Derivative of its law by a slipping traction that multigrid takes for zero: for rough solutions,
and for accurate ones.
Measured: bolted assembly, whose guesses 1e-6 leads astray: given up, with 1e-4 for both as well;
ironing in space with friction, 12th load step, .01 for both: 25 guesses in each Newton step."""

ROUGH = 0.5
"""Reduction of the residual by multigrid with which signs of multipliers and gaps are seen.
Measured: Hertz, 30 000 displacements: 47 iterations in 26 working sets, 4.3 processor seconds; .1
80 in 24, 4.9."""

TIGHT = 0.1
"""Reduction of the residual by multigrid in a Newton step, over rtol.
Measured: Hertz with small sliding is solved in one Newton step, as with factors; 1 takes two. The
patch test in space, rtol 1e-13: one, in 37 iterations; with 1e-9 whatever rtol is three, in 51."""

LARGE_CONTACT = 20000
"""Displacements in space from which multigrid is the default, without friction.
Measured: Hertz in space in one step, processor seconds: 17 000 displacements 2.0 (direct 2.0),
21 000 2.5 (3.2), 25 000 2.7 (3.9), 30 000 2.9 (5.3); a round block on a flat one, 22 000, two load
steps: 6.4 (10.5)."""

AT_REST = 1e-4
"""Share of the bodies' diagonal that is added where a linearised problem has no solution and no
load acts on free motions, as at the start of load steps of a body that friction alone holds.
Measured: a ring between two plates that hold it by friction alone, squeezed by .83 radii in 20 load
steps: 83 Newton steps, 11 processor seconds; 1e-6 82, 24; 1e-2 139 and 7 halvings, 14; without 107
and 7, 89."""
