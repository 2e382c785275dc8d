# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Actions that all ranks take together: destroying PETSc objects, errors, look-ups.

Destroying a PETSc object is collective, but Python's garbage collection is not: two ranks may
release the objects of two problems in different orders. So released objects wait until the next
tie or problem is made. Then the ranks agree on those that all of them have released, and destroy
these in the same order. An object that the user still refers to survives: PETSc counts references.
"""

import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from copy import copy
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.errors import InterfaceError, SolveError

Ranks = tuple[int, ...]
Ticket = tuple[Ranks, int]
"""The ranks that share an object, and its number among theirs: the same on each of them."""

_made: defaultdict[Ranks, int] = defaultdict(int)
_waiting: defaultdict[Ranks, dict[int, list[Any]]] = defaultdict(dict)


def enter(comm: MPI.Comm) -> Ticket:
    """A ticket for a new owner of PETSc objects. Collective.

    Destroys the objects that all ranks have released.

    Args:
        comm: Communicator of the objects.

    Returns:
        The ticket, for :func:`leave`.
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
    """Release PETSc objects: destroyed now on one rank, else by a later :func:`enter`.

    Args:
        ticket: Ticket of their owner, None if it has none.
        objects: The objects; None is skipped.
    """
    # References of their own: not those of Python's objects, which users may have
    left = [copy(obj) if isinstance(obj, PETSc.Object) else obj for obj in objects if obj]
    if ticket is None or len(ticket[0]) == 1:
        for obj in left:
            obj.destroy()
    else:
        _waiting[ticket[0]].setdefault(ticket[1], []).extend(left)


class Owner:
    """Base class of owners of PETSc objects, which are released with their owner."""

    _ticket: Ticket | None = None

    def destroy(self):
        """Destroy the PETSc objects now, except those that the user still holds. Collective.

        Otherwise they are destroyed with their owner; on several ranks, when the next tie or
        problem is made.
        """
        objects = self._release()
        while objects:  # PETSc's go with their last reference
            obj = objects.pop(0)
            if obj and not isinstance(obj, PETSc.Object):
                obj.destroy()

    def __del__(self, is_finalizing: Callable[[], bool] = sys.is_finalizing):
        """Release the PETSc objects, unless Python is shutting down."""
        if not is_finalizing():  # a default: modules are empty by then
            leave(self._ticket, self._release())

    def _release(self) -> list[Any]:
        """Give up the PETSc objects and return them; entries may be None."""
        raise NotImplementedError


def spot(x: npt.NDArray[np.floating]) -> str:
    """A point for a message, rounded to six digits.

    Args:
        x: Coordinates of the point, or of points around it, ``(…, n)``.
    """
    middle = x.reshape(-1, x.shape[-1]).mean(axis=0)
    size = np.abs(x[np.isfinite(x)]).max(initial=0)
    digits = 6  # format of messages: hides round-off
    decimals = digits - 1 - int(np.floor(np.log10(size))) if size > 0 else 0
    rounded = (round(float(value), decimals) + 0.0 for value in middle)
    return f"({', '.join(f'{value:.{digits}g}' for value in rounded)})"


def run_on_all(comm: MPI.Comm, what: str, call: Callable[[], Any]):
    """Call a user's function; an exception on one rank is raised on all. Collective.

    Args:
        comm: Communicator.
        what: First words of the message on ranks without an exception of their own.
        call: The function.

    Raises:
        SolveError: On other ranks; for other exceptions than a SolveError a RuntimeError.
    """
    error: BaseException | None = None
    try:
        call()
    except BaseException as e:
        error = e
    told = error and (isinstance(error, SolveError), f"{type(error).__name__}: {error}")
    every = comm.allgather(told)
    if error is not None:
        raise error
    for rank, found in enumerate(every):
        if found:
            text = f"{what} on rank {rank}: {found[1]}"
            raise SolveError(text) if found[0] else RuntimeError(text)


def raise_on_all(comm: MPI.Comm, message: str | None, error: type[Exception] = InterfaceError):
    """Raise the lowest rank's message on every rank, if any rank has one. Collective."""
    first = next((m for m in comm.allgather(message) if m), None)
    if first:
        raise error(first)


def gathered(comm: MPI.Comm, array: npt.NDArray) -> npt.NDArray:
    """All ranks' arrays of one type, ``(num, ...)``, one after the other. Collective."""
    if comm.size == 1:
        return array
    size = int(np.prod(array.shape[1:], dtype=np.intp))
    sizes = [size * num for num in comm.allgather(len(array))]
    every = np.empty((sum(sizes) // max(size, 1), *array.shape[1:]), dtype=array.dtype)
    comm.Allgatherv(np.ascontiguousarray(array), (every, sizes))
    return every


def look_up(comm: MPI.Comm, owned: npt.NDArray, offset: int, dofs) -> npt.NDArray:
    """Values at global dofs (blocks) on every rank. Collective.

    Args:
        comm: Communicator.
        owned: This rank's values, ``(num_owned, ...)``.
        offset: Global number of the first owned dof.
        dofs: Global dofs, the same on every rank, ``(num,)``.

    Returns:
        ``(num, ...)``, the same on every rank.
    """
    mine = (dofs >= offset) & (dofs < offset + len(owned))
    values = np.zeros((len(dofs), *owned.shape[1:]), dtype=owned.dtype)
    values[mine] = owned[dofs[mine] - offset]
    comm.Allreduce(MPI.IN_PLACE, values)
    return values


def values_at(f: fem.Function, dofs) -> npt.NDArray:
    """Values of a function at global dofs (blocks), ``(num, block_size)``. Collective."""
    dofmap, index_map = f.function_space.dofmap, f.function_space.dofmap.index_map
    owned = f.x.array.reshape(-1, dofmap.index_map_bs)[: index_map.size_local]
    return look_up(f.function_space.mesh.comm, owned, index_map.local_range[0], dofs)


def wait_idly(comm: MPI.Comm):
    """A barrier that leaves the processor to others, for ranks with nothing to do. Collective.

    MPI asks again and again whether all have come, which takes as much time as the work of the one
    that is waited for. Here the pauses are a hundredth of what has been waited.
    """
    request, start = comm.Ibarrier(), time.perf_counter()
    while not request.Test():
        time.sleep((time.perf_counter() - start) / 100)
