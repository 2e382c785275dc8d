# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Which multipliers give way where an interface ends or meets another one.

The minimum in eq. (22) is over the free x_a, so a prescribed x_a has no constraint: keeping it
could lose rank. Where patches or ties meet, a dof can't have a constraint in each. Such multipliers
are dropped and λ follows its neighbours there, as in mortar methods with cross points.

A patch must carry forces and moments though, and for that it needs n multipliers. On one that is
left with fewer, λ is constant and linear in space instead, as far as these constraints don't follow
from those of other such patches. (Every other patch's multipliers have a dof of their own.) A small
one that is prescribed all over takes all that don't: what faces it on Γ0 must follow.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.constraint import Dropped, Replaced, triplets
from hypergap_dolfinx.solve.interface import Interface

FEW = 32  # multipliers of a patch; with more, Γ1 must not be prescribed all over
INDEPENDENT = 1e-3  # sine of the angle between a row and the others, from which it counts


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
    return comm.allreduce(values)


def dropped_multipliers(
    ties: Sequence[Interface], bodies: Sequence[tuple[int, int]], prescribed: Sequence[npt.NDArray]
) -> list[Dropped]:
    """The multipliers that are dropped. Collective.

    Args:
        ties: The ties.
        bodies: Numbers of the bodies on both sides of each tie.
        prescribed: Which owned dofs of each body are prescribed, ``(num_dofs * block_size,)``.

    Returns:
        For each tie.
    """
    marks = []
    for tie, pair in zip(ties, bodies, strict=True):
        marks.append(_prescribed(tie, 1, prescribed[pair[1]], tie.constraint.dofs))
    touched = [_touched(tie) for tie in ties]
    dropped = []
    for t, (tie, mark) in enumerate(zip(ties, marks, strict=True)):
        # Of other ties, and of Γ0 where the tie ends at the tip of a cut through one body
        others = [
            dofs
            for other, pair in enumerate(bodies)
            for side, dofs in enumerate(touched[other])
            if pair[side] == bodies[t][1] and (other, side) != (t, 1)
        ]
        shared = np.isin(tie.constraint.dofs, np.concatenate(others)) if others else False
        _, at, count = np.unique(tie.constraint.dofs, return_inverse=True, return_counts=True)
        dropped.append(mark | (shared | (count[at] > 1))[:, None])
    replaced: list[list[Replaced]] = [[] for _ in ties]
    if any(drop.any() for drop in dropped):
        _replace(ties, bodies, prescribed, marks, dropped, replaced)
    return [Dropped(*parts) for parts in zip(dropped, marks, replaced, strict=True)]


def _prescribed(tie: Interface, side: int, prescribed, dofs) -> npt.NDArray[np.bool_]:
    """Which components of dofs of one side are prescribed, on every rank."""
    owned = prescribed.reshape(-1, tie.block_size).astype(np.int8)
    offset = tie.spaces[side].dofmap.index_map.local_range[0]
    return look_up(tie.sigma.comm, owned, offset, dofs).astype(bool)


def _touched(tie: Interface) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Dofs (blocks) of both sides that the tie's Σ reaches, on every rank."""
    columns = np.unique(triplets(tie.constraint.B[0])[1]).astype(np.int64)
    return np.unique(np.concatenate(tie.sigma.comm.allgather(columns))), tie.constraint.dofs


def _positions(tie: Interface) -> npt.NDArray[np.float64]:
    """Where the multipliers' dofs lie, ``(num_multipliers, n)``."""
    surface = tie.surfaces[1]
    dofs, first = np.unique(surface.dofs, return_index=True)
    facet, local = np.divmod(first, surface.dofs.shape[1])
    x = surface.points(facet, surface.element.points[local])
    return x[np.searchsorted(dofs, tie.constraint.dofs)]


def _rows(tie: Interface, side: int, multipliers) -> tuple[npt.NDArray, npt.NDArray]:
    """Rows of B_i of some multipliers, on every rank. Collective.

    Returns:
        The dofs (blocks) of the columns, and the dense rows, ``(num_multipliers, num_columns)``.
    """
    rows = tie.constraint.rows[multipliers]
    i, j, value = triplets(tie.constraint.B[side])
    use = np.isin(i, rows)
    order = np.argsort(rows)
    entries = np.column_stack((order[np.searchsorted(rows, i[use], sorter=order)], j[use]))
    comm = tie.sigma.comm
    entries = np.concatenate(comm.allgather(entries.astype(np.int64)))
    columns, at = np.unique(entries[:, 1], return_inverse=True)
    B = np.zeros((len(rows), len(columns)))
    B[entries[:, 0], at] = np.concatenate(comm.allgather(value[use]))
    return columns, B


class Rows:
    """Rows that don't follow from each other; a column is a body's dof, told by two numbers."""

    def __init__(self):
        """None yet."""
        self._column: dict[tuple[int, int], int] = {}
        self._basis = np.zeros((0, 0))

    def add(self, columns: Sequence[tuple[int, int]], values: npt.NDArray, size: float) -> bool:
        """Add a row, unless it is small or follows from the others; whether it was added."""
        at = [self._column.setdefault(column, len(self._column)) for column in columns]
        basis = np.zeros((len(self._basis), len(self._column)))
        basis[:, : self._basis.shape[1]] = self._basis
        row = np.zeros(len(self._column))
        np.add.at(row, at, values)
        for _ in range(2):  # twice is enough
            row -= (basis @ row) @ basis
        rest = np.linalg.norm(row)
        independent = bool(rest > INDEPENDENT * size)
        self._basis = np.vstack((basis, row[None] / rest)) if independent else basis
        return independent


@dataclass(frozen=True)
class _Patch:
    """The multipliers of a patch and their rows."""

    multipliers: npt.NDArray[np.intp]
    """Their numbers, ``(num_multipliers,)``."""
    x: npt.NDArray[np.float64]
    """Where their dofs lie, ``(num_multipliers, n)``."""
    columns: list[tuple[int, int]]
    """Body and dof (block) of the columns."""
    free: npt.NDArray[np.bool_]
    """Which components of these are not prescribed, ``(num_columns, block_size)``."""
    B: npt.NDArray[np.float64]
    """The rows, ``(num_multipliers, num_columns)``."""

    @classmethod
    def gather(cls, tie: Interface, bodies, prescribed, multipliers) -> "_Patch":
        """Gather the rows on every rank. Collective."""
        columns: list[tuple[int, int]] = []
        free, B = [], []
        for side, body in enumerate(bodies):
            dofs, part = _rows(tie, side, multipliers)
            columns += [(body, int(dof)) for dof in dofs]
            free.append(~_prescribed(tie, side, prescribed[body], dofs))
            B.append(part)
        x = _positions(tie)[multipliers]
        return cls(multipliers, x, columns, np.vstack(free), np.hstack(B))

    def candidates(self, kept: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
        """Values of λ at the dofs: a constant, linear ones, then those of the kept multipliers.

        Returns:
            ``(num_candidates, num_multipliers)``.
        """
        x = self.x - self.x.mean(axis=0)
        _, size, axes = np.linalg.svd(x)
        moments = (x @ axes.T).T[: len(size)][size > 1e-6 * size.max(initial=0)]
        scale = np.abs(moments).max(axis=1, keepdims=True)
        return np.vstack((np.ones(len(x)), moments / scale, np.eye(len(x))[kept]))


def _replace(ties, bodies, prescribed, marks, dropped, replaced):
    """Give patches with fewer than n multipliers left other ones instead. Collective."""
    n = ties[0].surfaces[1].gdim
    patches: dict[tuple[int, int], _Patch] = {}
    short = []  # tie, patch, component, values of λ to try, what was taken of them
    for t, (tie, drop) in enumerate(zip(ties, dropped, strict=True)):
        every = np.bincount(tie.constraint.patch)
        for component in range(tie.block_size):
            left = np.bincount(tie.constraint.patch[~drop[:, component]], minlength=len(every))
            for p in np.flatnonzero(left < np.minimum(every, n)):
                if (t, p) not in patches:
                    mine = np.flatnonzero(tie.constraint.patch == p)
                    patches[t, p] = _Patch.gather(tie, bodies[t], prescribed, mine)
                patch = patches[t, p]
                values = patch.candidates(~drop[patch.multipliers, component])
                short.append((t, patch, component, list(values), []))
    accepted: dict[int, Rows] = {}
    for number in range(1, n + 1):  # one for every patch, then a second, ...
        for _, patch, component, values, taken in short:
            rows = accepted.setdefault(component, Rows())
            while values and len(taken) < number:
                row = values[0] @ patch.B
                free = row * patch.free[:, component]
                if rows.add(patch.columns, free, float(np.linalg.norm(row))):
                    taken.append(values[0])
                values.pop(0)
    for t, patch, component, values, taken in short:
        if marks[t][patch.multipliers, component].all() and len(patch.x) <= FEW:
            values += list(np.eye(len(patch.x)))
            for value in values:
                row = value @ patch.B
                free = row * patch.free[:, component]
                if accepted[component].add(patch.columns, free, float(np.linalg.norm(row))):
                    taken.append(value)
        dropped[t][patch.multipliers, component] = True
        dropped[t][patch.multipliers[: len(taken)], component] = False
        rank = np.linalg.matrix_rank(patch.B * patch.free[:, component])
        weights = np.reshape(taken, (-1, len(patch.multipliers))).T
        complete = len(taken) == rank
        replaced[t].append(Replaced(component, patch.multipliers, weights, bool(complete)))
