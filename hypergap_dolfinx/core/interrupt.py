# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Ctrl-C during a solve, which all ranks notice at the same place."""

import signal
import threading
from types import FrameType

from mpi4py import MPI


class Interrupts:
    """Context in which SIGINT waits for the next :meth:`check`.

    Raised where it arrives, Python's KeyboardInterrupt would leave PETSc's objects half assembled
    or locked, and other ranks waiting, if it reaches one of them only. A second SIGINT is raised
    where it arrives. A handler of the user's own stays, and outside the main thread nothing is
    done.
    """

    _left = False  # one that came too late for the last check

    def __init__(self, comm: MPI.Comm):
        """Store the communicator of the ranks that check together."""
        self._comm, self._pending, self._replaced = comm, False, False
        self.agreed = False
        """True once :meth:`check` has raised."""

    def __enter__(self) -> "Interrupts":
        """Replace Python's handler."""
        main = threading.current_thread() is threading.main_thread()
        if main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, self._note)
            self._replaced = True
        self._pending, Interrupts._left, self.agreed = Interrupts._left, False, False
        return self

    def __exit__(self, kind, *_):
        """Give Python's handler back; what came after the last check is for the next solve."""
        if self._replaced:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        if self._pending and not self.agreed:
            if self._comm.size == 1 and kind is None:
                raise KeyboardInterrupt
            Interrupts._left = True

    def _note(self, number: int, frame: FrameType | None):
        self._pending = not self._pending
        if not self._pending:
            signal.default_int_handler(number, frame)

    def check(self):
        """Raise a KeyboardInterrupt on all ranks if a signal has reached any. Collective."""
        if self._comm.allreduce(self._pending, MPI.LOR):
            self.agreed = True
            raise KeyboardInterrupt
