# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tie DOLFINx bodies across non-matching meshes with hyper-dimensional gap finite elements.

Interface: a pair of surfaces Γ0 and Γ1 with the condition between them. Tie: an interface given by
a user, with equality; :class:`Contact`: one with inequality. Piece: a connected smooth part of a
surface, bounded by kinks. Union: several ties that share a piece of Γ1, solved as one interface.
"""

from mpi4py import MPI as _MPI  # noqa: F401 (it finds the MPI library for DOLFINx)

try:
    import petsc4py as _petsc4py  # noqa: F401 (DOLFINx can be had without)

    import dolfinx.fem.petsc as _petsc  # noqa: F401
except ImportError as e:
    raise ImportError(
        f"hypergap_dolfinx needs DOLFINx with PETSc, and petsc4py ({e}): take "
        "pip install 'hypergap-dolfinx[dolfinx]', conda-forge's fenics-dolfinx and petsc4py, or "
        "Debian's python3-dolfinx."
    ) from e

from hypergap_dolfinx.contact import Contact
from hypergap_dolfinx.contact_problem import ContactProblem
from hypergap_dolfinx.core import compat, progress
from hypergap_dolfinx.errors import InterfaceError, InvertedCellError, SolveError
from hypergap_dolfinx.interface_laws.coupling import Coupling
from hypergap_dolfinx.interface_laws.rigid_body import RigidBody
from hypergap_dolfinx.nonlinear import NonlinearTiedProblem
from hypergap_dolfinx.problem import TiedProblem
from hypergap_dolfinx.solvers.checkpoint import State
from hypergap_dolfinx.tie import Tie
from hypergap_dolfinx.touching import find_touching

__all__ = [
    "Contact",
    "ContactProblem",
    "Coupling",
    "InterfaceError",
    "InvertedCellError",
    "NonlinearTiedProblem",
    "RigidBody",
    "SolveError",
    "State",
    "Tie",
    "TiedProblem",
    "compat",
    "find_touching",
    "progress",
]
__version__ = "0.1.0"
