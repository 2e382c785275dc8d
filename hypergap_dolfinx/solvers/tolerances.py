# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

UNKNOWN = 1e-3
"""Error of constants, and of a solution, recovered from their loads from which they are
undetermined.
Measured: flows without an outlet 0.2 to 1.7, held at a node 2e-16. Triangles of degree 2 with one
quadrature point, 40 pairs of blocks, E 1e-6 to 1e11: 3 to 190; regular at most 6e-12, in tests of
solvers, algebra, interface_laws and contact_solver 5e-10, in any_contacts 0 to 99 and 132 scenes of
bodies that contact and friction alone hold 4e-12, in slender_contact 2e-8."""

REFINED = 1e-15
"""Backward error of a direct solve from which it is refined.
Measured: 5e-17 to 2e-10, after a step of refinement up to 3e-16."""

FIRST = 1e-10
"""Residual at which `"bodies"` restarts its iteration.
Measured: 3D patch tests: 4e-13; without a restart 3e-12."""

RESCALE = 0.5
"""Change of the stiffness, in decades, from which ties are scaled anew.
Measured: factors of 1e8 cost digits."""

SMALL_FORCES = 0.1
"""Forces of ties, over the loads, below which `"iterative"` solves again for the residual.
Measured: a block on one 1 to 1e6 times as stiff: 5e-2 to 5e-8."""

ROUND_OFF_PROJECTED = 1e-15
"""Forces treated as zero, over those that single nodes' displacements make.
Measured: round-off of sums."""

CONTRAST = 1e4
"""Largest ratio of Γ1's weight to Γ0's beside it.
Measured: beyond it Π gets lost in round-off."""

LARGE_SYSTEM = 30000
"""Displacements in 3D from which bodies are not factorised together by default.
Measured: boxes in a row, processor seconds of `"bodies"` (and direct), degree 1: 9500 displacements
0.7 (0.5), 19 000 1.7 (1.4), 33 000 3.5 (2.7), 74 000 6.5 (7.2), 88 000 10.2 (10.6); degree 2:
26 000 2.9 (2.2), 48 000 6.7 (5.4), with 0.6 to 0.9 of the memory. Of `"iterative"`: 27 000 1.8
(1.5), 32 000 1.7 (2.1), 88 000 5.6 (10.6); degree 2: 48 000 5.8 (5.4), with 0.2 to 0.5."""

BUDGET_BODIES = 40
"""Iterations of `"bodies"` with one matrix by default, after which all is factorised.
Measured: with 36 iterations it takes 1.0 to 1.3 times direct's seconds (26 000 to 88 000
displacements). Two to five boxes in a row take 30 to 45 in two runs of up to 32, a plate with Γ1
under boxes 70 to 144, or doesn't converge in 120."""

BUDGET = 100
"""Iterations of multigrid with one matrix by default, after which it is factorised.
Measured: three boxes, degree 1: factors take as long as 40 iterations with 27 000 displacements, 65
with 42 000, 90 with 85 000. A solve takes 22 to 51, ν = .49 100, ν = .499 302, cells 1:8 95."""

SLENDER = 10.0
"""Extent of a body over its thickness, above which its geometric stiffness has predicted stress.
Measured: scenes of slender_contact, of 28 to 151: 471 Newton steps without, 390 with it; beams,
arches and brackets of any_contacts, 6 scenes: 328 with 20, 224."""

TURNED = 0.05
"""Root mean square of the turns of an interface's facets, in radians, from which directions that
stay those of the mesh are told.
Measured: a tie with a compliance of 1/20 along its normal and 1/2 across, turned by 1°, 5°, 10° and
pulled along its normal: tractions across of 1.4, 7, 14 % of those along it, and 0, 1, 4 % less
along it."""
