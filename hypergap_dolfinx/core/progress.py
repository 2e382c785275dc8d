# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Progress of long computations in one line on the terminal; none in a pipe."""

import sys

from mpi4py import MPI
from petsc4py import PETSc


def show(comm: MPI.Comm, text: str = "", *, keep: bool = False):
    """Replace the line on the terminal, on rank 0.

    Args:
        comm: Communicator.
        text: The new line; without it, the line is cleared.
        keep: True if the line stays and the next one goes below it.
    """
    if comm.rank == 0 and sys.stderr.isatty():
        print(f"\r\x1b[K{text}", end="\n" if keep else "", file=sys.stderr, flush=True)


def monitor(solver: PETSc.SNES | PETSc.KSP, iteration: int, norm: float):
    """Show a solver's iterations: ``problem.solver.setMonitor(progress.monitor)``.

    Args:
        solver: A SNES or KSP.
        iteration: Number of the iteration.
        norm: Norm of the residual.
    """
    name = "Newton step" if isinstance(solver, PETSc.SNES) else "iteration"
    show(solver.comm.tompi4py(), f"{name} {iteration}, residual {norm:.1e}")
