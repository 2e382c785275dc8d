# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What is known up to a constant only, though neither K nor B alone tells.

Pressures: where displacements are prescribed all around, the forces of a constant pressure on a
tie's two sides are balanced by λ. Bodies that a tie would hold whose conductance is 0: the loads
may balance each other, so that there are solutions.
"""

from petsc4py import PETSc

import numpy as np

from hypergap_dolfinx.algebra import saddle
from hypergap_dolfinx.solvers.solver import Solver, System
from hypergap_dolfinx.surface.component import lagrange_components
from hypergap_dolfinx.surface.trace import is_mixed

UNKNOWN = 1e-3
"""Error of constants that are to be found again, from which they are unknown: with factors of
singular matrices 0.2 to 1.7, of others 2e-16."""


def undetermined(system: System, solver: Solver, b: PETSc.Vec) -> bool:
    """Whether constants of bodies aren't found again from the loads that they make. Collective.

    Of mixed bodies' scalars, or where a tie has a conductance all fields of bodies that aren't.

    Args:
        system: The saddle system.
        solver: With its factors.
        b: A vector of the system, of which nothing but the layout is taken.
    """
    conducts = system.constraints.conducts
    if solver.ksp.getPC().getType() != "lu" or not (conducts or any(map(is_mixed, system.spaces))):
        return False  # what iterates may be told of a null space
    x = b.duplicate()
    x.set(0.0)
    prescribed = system.constraints.prescribed
    of_x = x.getNestSubVecs()
    for i, (part, V, held) in enumerate(zip(of_x, system.spaces, prescribed)):
        if is_mixed(V):
            for field in lagrange_components(V):
                if field.space.value_shape == ():
                    ones = np.ones(field.space.dofmap.index_map.size_local)
                    part.array[:] += np.where(held, 0, field.into_body(ones))
        elif conducts:  # other ones on each body, such that ties have a jump
            part.array[:] = np.where(held, 0, i + 1)
    loads, found = x.duplicate(), x.duplicate()
    system.A.mult(x, loads)
    solver.solve(loads, found)
    found.axpy(-1.0, x)
    found_parts = found.getNestSubVecs()
    error = max(part.norm(PETSc.NormType.INFINITY) for part in found_parts[: len(system.spaces)])
    saddle.destroy_parts((*of_x, *found_parts))
    for vector in (x, loads, found):
        vector.destroy()
    return not error < UNKNOWN
