# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Actions of all ranks together: raising the same error and destroying PETSc's objects.

Destruction is collective, Python's garbage collection is not.

The ranks may let go of two problems in different orders. So what a rank no longer needs waits
until all ranks meet, when the next tie or problem is made: what all of them have let go is
destroyed then, in the same order. What a user still has is only let go: PETSc counts references.
"""

import sys
from collections import defaultdict
from collections.abc import Callable, Iterable
from copy import copy
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.tolerances import DIGITS_MESSAGES
from hypergap_dolfinx.errors import InterfaceError

Ranks = tuple[int, ...]
Ticket = tuple[Ranks, int]
"""The ranks that share an object, and its number among theirs: the same on each of them."""

_made: defaultdict[Ranks, int] = defaultdict(int)
_waiting: defaultdict[Ranks, dict[int, list[Any]]] = defaultdict(dict)


def enter(comm: MPI.Comm) -> Ticket:
    """A ticket for a new owner of PETSc objects; destroys what waits. Collective.

    Args:
        comm: Communicator of the objects.

    Returns:
        What :func:`leave` wants.
    """
    world = MPI.COMM_WORLD.Get_group()
    group = comm.Get_group()
    ranks = tuple(MPI.Group.Translate_ranks(group, range(comm.size), world))
    for g in (group, world):
        g.Free()
    gone = set.intersection(*comm.allgather(set(_waiting[ranks])))
    for number in sorted(gone):
        waiting = _waiting[ranks].pop(number)
        # Python's objects first: if theirs were the last references, PETSc would keep what they had
        waiting.sort(key=lambda obj: isinstance(obj, PETSc.Object))
        while waiting:
            waiting.pop(0).destroy()
    _made[ranks] += 1
    return ranks, _made[ranks]


def leave(ticket: Ticket | None, objects: Iterable[Any]):
    """Let go of PETSc objects: at once on one rank, else when the ranks meet next.

    Args:
        ticket: The owner's, or None if it was never made.
        objects: What to destroy; None is left out.
    """
    # References of their own: not those of Python's objects, which users may have
    left = [copy(obj) if isinstance(obj, PETSc.Object) else obj for obj in objects if obj]
    if ticket is None or len(ticket[0]) == 1:
        for obj in left:
            obj.destroy()
    else:
        _waiting[ticket[0]].setdefault(ticket[1], []).extend(left)


class Owner:
    """What owns PETSc objects, and lets them go when it goes itself."""

    _ticket: Ticket | None = None

    def destroy(self):
        """Destroy the PETSc objects now. Collective.

        Without it they go by themselves; on several ranks, when the next tie or problem is made.
        """
        for obj in filter(None, self._release()):
            obj.destroy()

    def __del__(self, is_finalizing: Callable[[], bool] = sys.is_finalizing):
        """Let the PETSc objects go; at the end of Python they go with the process."""
        if not is_finalizing():  # a default, since modules have lost their names by then
            leave(self._ticket, self._release())

    def _release(self) -> list[Any]:
        """The PETSc objects, which their owner forgets; None is left out."""
        raise NotImplementedError


def spot(x: npt.NDArray[np.floating]) -> str:
    """A place for a message, without what is round-off in its coordinates.

    Args:
        x: Its coordinates, or those of points of which it is the middle, ``(…, n)``.
    """
    middle = x.reshape(-1, x.shape[-1]).mean(axis=0)
    size = np.abs(x[np.isfinite(x)]).max(initial=0)
    decimals = DIGITS_MESSAGES - 1 - int(np.floor(np.log10(size))) if size > 0 else 0
    rounded = (round(float(value), decimals) + 0.0 for value in middle)
    return f"({', '.join(f'{value:.{DIGITS_MESSAGES}g}' for value in rounded)})"


def raise_on_all(comm: MPI.Comm, message: str | None, error: type[Exception] = InterfaceError):
    """Raise the lowest rank's message on every rank, if any rank has one. Collective."""
    first = next((m for m in comm.allgather(message) if m), None)
    if first:
        raise error(first)
