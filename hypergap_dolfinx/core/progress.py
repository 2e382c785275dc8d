# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Progress line on the terminal for long computations; silent in a pipe."""

import sys

from mpi4py import MPI
from petsc4py import PETSc


def show(comm: MPI.Comm, text: str = "", *, keep: bool = False):
    """Replace the progress line, on rank 0.

    Args:
        comm: Communicator.
        text: The new line; empty to clear it.
        keep: True to keep the line and continue below it.
    """
    if comm.rank == 0 and sys.stderr.isatty():
        print(f"\r\x1b[K{text}", end="\n" if keep else "", file=sys.stderr, flush=True)


def monitor(solver: PETSc.SNES | PETSc.KSP, iteration: int, norm: float):
    """Monitor of a solver's iterations, for ``problem.solver.setMonitor(progress.monitor)``.

    Args:
        solver: A SNES or KSP.
        iteration: Number of the iteration.
        norm: Norm of the residual.
    """
    name = "Newton step" if isinstance(solver, PETSc.SNES) else "iteration"
    show(solver.comm.tompi4py(), f"{name} {iteration}, residual {norm:.1e}")
