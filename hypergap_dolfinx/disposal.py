# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""When PETSc's objects go: destruction is collective, Python's garbage collection is not.

The ranks may let go of two problems in different orders. So what a rank no longer needs waits
until all ranks meet, when the next tie or problem is made: what all of them have let go is
destroyed then, in the same order.
"""

import sys
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Any

from mpi4py import MPI

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
        for obj in _waiting[ranks].pop(number):
            obj.destroy()
    _made[ranks] += 1
    return ranks, _made[ranks]


def leave(ticket: Ticket | None, objects: Iterable[Any]):
    """Let go of PETSc objects: at once on one rank, else when the ranks meet next.

    Args:
        ticket: The owner's, or None if it was never made.
        objects: What to destroy; None is left out.
    """
    left = [obj for obj in objects if obj is not None]
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
        for obj in self._release():
            obj.destroy()

    def __del__(self, is_finalizing: Callable[[], bool] = sys.is_finalizing):
        """Let the PETSc objects go; at the end of Python they go with the process."""
        if not is_finalizing():  # a default, since modules have lost their names by then
            leave(self._ticket, self._release())

    def _release(self) -> list[Any]:
        """The PETSc objects, which their owner forgets."""
        raise NotImplementedError
