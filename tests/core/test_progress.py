# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Progress is a line on rank 0's terminal, and nothing anywhere else."""

import io
import sys

from mpi4py import MPI
from petsc4py import PETSc

import pytest

from hypergap_dolfinx.core import progress

pytestmark = pytest.mark.ranks

comm = MPI.COMM_WORLD


@pytest.mark.parametrize("terminal", (True, False), ids=("terminal", "pipe"))
def test_progress(terminal, monkeypatch):
    stream = io.StringIO()
    stream.isatty = lambda: terminal
    monkeypatch.setattr(sys, "stderr", stream)
    progress.show(comm, "level 3")
    progress.monitor(PETSc.SNES().create(comm), 2, 1e-3)
    progress.monitor(PETSc.KSP().create(comm), 17, 0.5)
    progress.show(comm)
    texts = ("level 3", "Newton step 2, residual 1.0e-03", "iteration 17, residual 5.0e-01", "")
    shown = comm.rank == 0 and terminal
    assert stream.getvalue() == "".join(f"\r\x1b[K{text}" for text in texts) * shown
