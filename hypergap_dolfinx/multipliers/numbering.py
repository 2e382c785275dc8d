# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""All ties' multipliers in one numbering, and what uses the dofs under them."""

from collections import defaultdict
from collections.abc import Sequence
from functools import cached_property

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.graph import PartsOf
from hypergap_dolfinx.core.sparse import triplets
from hypergap_dolfinx.mortar.constraint import Multipliers
from hypergap_dolfinx.multipliers.interface import Interface

Pair = tuple[int, int]
"""Two bodies, or a body and a dof (block) of it."""


def look_up(comm: MPI.Comm, owned: npt.NDArray, offset: int, dofs) -> npt.NDArray:
    """Values at global dofs (blocks) on every rank. Collective.

    Args:
        comm: Communicator.
        owned: This rank's values, ``(num_owned, block_size)``.
        offset: Global number of the first owned dof.
        dofs: Global dofs, the same on every rank, ``(num,)``.

    Returns:
        ``(num, block_size)``, the same on every rank.
    """
    mine = (dofs >= offset) & (dofs < offset + len(owned))
    values = np.zeros((len(dofs), owned.shape[1]), dtype=owned.dtype)
    values[mine] = owned[dofs[mine] - offset]
    comm.Allreduce(MPI.IN_PLACE, values)
    return values


def prescribed_dofs(tie: Interface, side: int, prescribed, dofs) -> npt.NDArray[np.bool_]:
    """Which components of dofs of one side are prescribed, on every rank. Collective.

    Of Γ0's that turn, the components of R u₀.
    """
    owned = prescribed.reshape(-1, tie.block_size).astype(np.int8)
    offset = tie.spaces[side].dofmap.index_map.local_range[0]
    held = look_up(tie.sigma.comm, owned, offset, dofs).astype(bool)
    if side == 0 and tie.turn is not None:
        held = ~(~held @ (tie.turn != 0).T)
    return held


def values_at(tie: Interface, side: int, owned: npt.NDArray, dofs) -> npt.NDArray:
    """Values at dofs of one side on every rank, as they are compared; R u₀ of Γ0. Collective."""
    offset = tie.spaces[side].dofmap.index_map.local_range[0]
    values = look_up(tie.sigma.comm, owned, offset, dofs)
    return values if side or tie.turn is None else values @ tie.turn.T


class Every:
    """All ties' multipliers in one numbering."""

    def __init__(self, ties: Sequence[Interface], bodies: Sequence[Pair]):
        """Number them. Collective.

        Args:
            ties: The ties.
            bodies: Numbers of the bodies on both sides of each.
        """
        self.ties, self.bodies = ties, bodies
        self.lists = [Multipliers.of(tie.constraint, tie.domain) for tie in ties]
        sizes = [len(m.dofs) for m in self.lists]
        self.starts = np.cumsum([0, *sizes])
        self.tie = np.repeat(np.arange(len(ties)), sizes)
        self.dof = np.concatenate([m.dofs for m in self.lists])
        self.patch = np.concatenate([m.patch for m in self.lists])
        self.touched = [_touched(tie) for tie in ties]
        self._parts_of = PartsOf()
        self._bodies: dict[tuple[int, int], tuple[int, frozenset[int]]] = {}

    def __len__(self) -> int:
        """How many there are."""
        return int(self.starts[-1])

    def local(self, m: int) -> tuple[Multipliers, int]:
        """A multiplier's tie's list, and its number there."""
        t = self.tie[m]
        return self.lists[t], int(m - self.starts[t])

    def body(self, t: int, side: int) -> tuple[int, frozenset[int]]:
        """What a tie has on a side: a body, and the parts of its mesh. Collective when it is new.

        Parts of one mesh that aren't connected are bodies of their own here.
        """
        if (t, side) not in self._bodies:
            dofs = self.touched[t][side]
            found = self._parts_of(self.ties[t].spaces[side], dofs)
            self._bodies[t, side] = self.bodies[t][side], found
        return self._bodies[t, side]

    @cached_property
    def tied(self) -> set[frozenset]:
        """Pairs of such bodies that ties tie to each other. Collective."""
        each = range(len(self.ties))
        return {frozenset((self.body(t, 0), self.body(t, 1))) for t in each}

    def x(self, numbers) -> npt.NDArray[np.float64]:
        """Where the dofs under some multipliers lie, ``(num, n)``."""
        return np.array([lists.x[local] for lists, local in map(self.local, numbers)])

    @cached_property
    def places(self) -> dict[tuple[int, int], list[int]]:
        """The multipliers at each dof (body and block) that has several."""
        found = defaultdict(list)
        body = np.array([pair[1] for pair in self.bodies])[self.tie]
        key = np.stack((body, self.dof), axis=1)
        _, at, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
        for m in np.flatnonzero(count[at.ravel()] > 1):
            found[int(body[m]), int(self.dof[m])].append(int(m))
        return found

    def users(self) -> dict[int, set[tuple[int, int]]]:
        """Ties and sides, other than its own Γ1, that use the dof under a multiplier."""
        found = defaultdict(set)
        for t, pair in enumerate(self.bodies):
            mine = slice(self.starts[t], self.starts[t + 1])
            for s, other in enumerate(self.bodies):
                for side in (0, 1):
                    if other[side] != pair[1] or (s, side) == (t, 1):
                        continue
                    for m in np.flatnonzero(np.isin(self.dof[mine], self.touched[s][side])):
                        found[int(m + self.starts[t])].add((s, side))
        return found


def _touched(tie: Interface) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Dofs (blocks) of both sides that the tie's Σ reaches, on every rank. Collective."""
    columns = np.unique(triplets(tie.constraint.B[0])[1]).astype(np.int64)
    return np.unique(np.concatenate(tie.sigma.comm.allgather(columns))), tie.constraint.dofs
