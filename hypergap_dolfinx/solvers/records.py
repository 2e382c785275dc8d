# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Records of load steps and their Newton steps, and their lines in the log."""

import logging
import time
from collections import deque
from dataclasses import dataclass

from mpi4py import MPI

from hypergap_dolfinx.core import progress

LOG = logging.getLogger("hypergap_dolfinx")


def times(number: int, what: str) -> str:
    """A number of things: "1 step", "2 steps"."""
    return f"{number} {what}{'' if number == 1 else 's'}"


@dataclass(frozen=True)
class NewtonRecord:
    """State after a Newton step. The first record of a load step is its initial state."""

    residual: float
    """Residual over the forces in the bodies."""
    gap: float
    """Largest gap (a length) where a pressure acts, 0 without contact."""
    came: int
    """Number of vertices that came into contact in this step."""
    went: int
    """Number of vertices that left contact in this step."""
    iterations: int
    """Iterations of linear solvers since the last record; 1 for a direct solve."""
    seconds: float
    """Wall-clock seconds since the last record."""

    def __str__(self) -> str:
        """The record in one line."""
        moves = f", {self.came} came, {self.went} went" if self.came or self.went else ""
        gap = f", gap {self.gap:.1e}" if self.gap else ""
        return (
            f"residual {self.residual:.1e}{gap}{moves}, {times(self.iterations, 'iteration')}, "
            f"{self.seconds:.2f} s"
        )


@dataclass(frozen=True)
class StepRecord:
    """One call of a problem's ``solve()``."""

    number: int
    """Number of the load step, from 1; a failed one has the number of the next."""
    steps: tuple[NewtonRecord, ...]
    """All Newton steps, including those of failed parts of the load step."""
    halvings: int
    """Number of times that the load step was halved."""
    seconds: float
    """Wall-clock seconds."""
    message: str
    """Summary, or the reason why it failed."""
    solved: bool
    """True if it was solved."""

    def __str__(self) -> str:
        """The record in a line, and one for each Newton step."""
        lines = [f"load step {self.number}: {self.message}, {self.seconds:.2f} s"]
        return "\n".join([*lines, *(f"  {k}: {step}" for k, step in enumerate(self.steps))])


class Recorder:
    """The last load steps of a problem; rank 0 tells them in the log."""

    def __init__(self, comm: MPI.Comm, most: int = 1000):
        """Start.

        Args:
            comm: Communicator of the problem.
            most: Number of load steps that are kept.
        """
        self._comm = comm
        self.done: deque[StepRecord] = deque(maxlen=most)
        """The last load steps."""
        self.start(1)

    def start(self, number: int, iterations: int = 0):
        """Start a load step.

        Args:
            number: Its number.
            iterations: Linear iterations so far.
        """
        self._number, self._steps = number, list[NewtonRecord]()
        self._began = self._last = time.perf_counter()
        self._iterations = iterations

    def note(self, residual: float, iterations: int, *, gap=0.0, came=0, went=0, step=0):
        """Record a Newton step; the arguments as in :class:`NewtonRecord`.

        Args:
            residual: The residual.
            iterations: Linear iterations so far.
            gap: Largest gap.
            came: Number of vertices that came.
            went: Number of vertices that went.
            step: Number of Newton steps so far.
        """
        now, last = time.perf_counter(), self._last
        spent = max(iterations - self._iterations, 0)
        record = NewtonRecord(float(residual), float(gap), came, went, spent, now - last)
        self._last, self._iterations = now, iterations
        self._steps.append(record)
        if self._comm.rank == 0:
            LOG.debug("load step %d, Newton step %d: %s", self._number, step, record)

    def tell(self, text: str, *, keep: bool = False):
        """Report on a part of the load step in the log, or else on the terminal.

        Args:
            text: One line.
            keep: True if it stays on the terminal.
        """
        text = f"load step {self._number}: {text}"
        if not LOG.isEnabledFor(logging.INFO):
            progress.show(self._comm, text, keep=keep)
        elif self._comm.rank == 0:
            LOG.info(text)

    def end(self, message: str, *, halvings: int = 0, solved: bool = True):
        """End the load step.

        Args:
            message: Summary, or the reason why it failed.
            halvings: Times that it was halved.
            solved: True if it was solved.
        """
        seconds = time.perf_counter() - self._began
        steps = tuple(self._steps)
        self.done.append(StepRecord(self._number, steps, halvings, seconds, message, solved))
        self.tell(f"{message}, {seconds:.2f} s", keep=True)
