# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Multipliers for pieces of an interface that are left with too few of their own.

Where all ends of a small piece are at cross points or prescribed, λ is constant, linear, … in space
instead, as far as these rows don't follow from those of other such pieces. Where a piece is so
narrow that its own lie on lines, it gets λ's slopes across them too.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.graph import components
from hypergap_dolfinx.core.sparse import triplets
from hypergap_dolfinx.multipliers.interface import Interface
from hypergap_dolfinx.multipliers.numbering import Every, Pair, prescribed_dofs
from hypergap_dolfinx.multipliers.tolerances import (
    CONSISTENT,
    FEW_MULTIPLIERS,
    INDEPENDENT_ROWS,
    NARROW_PIECE,
)


class Rows:
    """Rows that don't follow from each other; a column is a body's dof, told by two numbers."""

    def __init__(self):
        """None yet."""
        self._column: dict[Pair, int] = {}
        self._basis = np.zeros((0, 0))

    def add(
        self,
        columns: Sequence[Pair],
        values: npt.NDArray,
        size: float,
        sine: float = INDEPENDENT_ROWS,
    ) -> bool:
        """Add a row, unless it is small or follows from the others; whether it was added."""
        at = [self._column.setdefault(column, len(self._column)) for column in columns]
        basis = np.zeros((len(self._basis), len(self._column)))
        basis[:, : self._basis.shape[1]] = self._basis
        row = np.zeros(len(self._column))
        np.add.at(row, at, values)
        for _ in range(2):  # twice is enough
            row -= (basis @ row) @ basis
        rest = np.linalg.norm(row)
        independent = bool(rest > sine * size)
        self._basis = np.vstack((basis, row[None] / rest)) if independent else basis
        return independent


@dataclass
class Replacement:
    """A component of λ on a smooth piece that is left with too few multipliers."""

    component: int
    numbers: npt.NDArray[np.intp]
    """The piece's multipliers, in the numbering of all ties, ``(num_multipliers,)``."""
    columns: list[Pair]
    """Body and dof (block) of the columns."""
    free: npt.NDArray[np.bool_]
    """Which columns aren't prescribed, ``(num_columns,)``."""
    B: npt.NDArray[np.float64]
    """The rows, ``(num_multipliers, num_columns)``."""
    units: npt.NDArray[np.float64]
    """λ that is 1 at one place and 0 at the others, ``(num_places, num_multipliers)``."""
    values: list[tuple[npt.NDArray, float]]
    """λ at the multipliers to try, and the sine of the angle from which each is taken."""
    wanted: int
    taken: list[npt.NDArray[np.float64]] = field(default_factory=list)
    complete: bool = False
    """Whether what is taken constrains all that the piece's own multipliers would."""

    def add(self, rows: Rows, value: npt.NDArray, sine: float):
        """Take a multiplier if its row doesn't follow from others."""
        row = value @ self.B
        if rows.add(self.columns, row * self.free, float(np.linalg.norm(row)), sine):
            self.taken.append(value)


def _polynomials(x: npt.NDArray, degree: int) -> list[tuple[npt.NDArray, float]]:
    """Values of λ to try at places: polynomials of degree k − 1, and linear ones."""
    x = x - x.mean(axis=0)
    _, size, axes = np.linalg.svd(x)
    along = (x @ axes.T).T[: len(size)][size > NARROW_PIECE * size.max(initial=0)]
    along = along / np.abs(along).max(axis=1, keepdims=True)
    exponents = np.indices((max(degree, 2),) * len(along)).reshape(len(along), -1)
    total = exponents.sum(axis=0) if len(along) else np.zeros(1, dtype=int)
    return [
        (
            np.prod(along ** powers[:, None], axis=0) * np.ones(len(x)),
            CONSISTENT if p < degree else INDEPENDENT_ROWS,
        )
        for p in range(max(degree, 2))
        for powers in exponents.T[total == p]
    ]


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


def pieces(every: Every, label, drop) -> npt.NDArray[np.int32]:
    """The piece that each multiplier is in: patches of ties that share one that exists.

    Args:
        every: The multipliers.
        label: Class of each; those of one class are one.
        drop: Which are dropped, of one component.
    """
    num = int(every.patch.max()) + 1
    patch = np.unique(every.tie * num + every.patch, return_inverse=True)[1].ravel()
    first = np.full(len(every), -1)
    kept = np.flatnonzero(~drop)[::-1]
    first[label[kept]] = kept  # some multiplier of each class
    joined = patch[first[label[kept]]]
    return components(int(patch.max()) + 1, patch[kept], joined)[patch]


def _gathered(every: Every, numbers, prescribed, component: int):
    """Columns of some multipliers' rows, which of them are free, and the rows. Collective."""
    columns: dict[Pair, int] = {}
    free: list[bool] = []
    parts = []
    for t in np.unique(every.tie[numbers]):
        local = numbers[every.tie[numbers] == t] - every.starts[t]
        tie = every.ties[t]
        for side, body in enumerate(every.bodies[t]):
            dofs, part = _rows(tie, side, local)
            held = prescribed_dofs(tie, side, prescribed[body], dofs)[:, component]
            for dof, is_held in zip(dofs.tolist(), held.tolist(), strict=True):
                if columns.setdefault((body, dof), len(columns)) == len(free):
                    free.append(not is_held)
            at = [columns[body, dof] for dof in dofs.tolist()]
            parts.append((np.flatnonzero(every.tie[numbers] == t), at, part))
    B = np.zeros((len(numbers), len(columns)))
    for rows, at, part in parts:
        B[np.ix_(rows, at)] += part
    return list(columns), np.array(free, dtype=bool), B


def _short_patches(every: Every, label, drop, prescribed) -> list[Replacement]:
    """Pieces that are left with too few multipliers. Collective."""
    n, found = every.ties[0].surfaces[1].gdim, []
    for component in range(drop.shape[1]):
        piece = pieces(every, label, drop[:, component])
        order = np.argsort(piece, kind="stable")
        for numbers in np.split(order, np.flatnonzero(np.diff(piece[order])) + 1):
            places, first, at = np.unique(label[numbers], return_index=True, return_inverse=True)
            degree = every.lists[every.tie[numbers[0]]].surface.element.degree
            polynomials = degree if n == 2 else degree * (degree + 1) // 2
            wanted = min(len(places), max(n, polynomials))
            kept = ~drop[numbers[first], component]
            if kept.sum() >= wanted:
                continue
            columns, free, B = _gathered(every, numbers, prescribed, component)
            units = (at.ravel() == np.arange(len(places))[:, None]).astype(float)
            values = _polynomials(every.x(numbers), degree) + [
                (unit, INDEPENDENT_ROWS) for unit in units[kept]
            ]
            found.append(Replacement(component, numbers, columns, free, B, units, values, wanted))
    return found


def _take_in_turn(patches: Sequence[Replacement], accepted: defaultdict[int, Rows]):
    """One for every piece, then a second, …: none goes without for another's sake."""
    for number in range(1, max((patch.wanted for patch in patches), default=0) + 1):
        for patch in patches:
            while patch.values and len(patch.taken) < min(number, patch.wanted):
                patch.add(accepted[patch.component], *patch.values.pop(0))


def replacements(every: Every, label, held, drop, prescribed) -> list[Replacement]:
    """Choose other multipliers for pieces with too few; drops these. Collective.

    Args:
        every: The multipliers.
        label: Class of each; those of one class are one.
        held: Which components of their dofs are prescribed, ``(num_multipliers, block_size)``.
        drop: Which components are dropped, of the same shape; changed here.
        prescribed: Which owned dofs of each body are prescribed.
    """
    patches = _short_patches(every, label, drop, prescribed)
    accepted: defaultdict[int, Rows] = defaultdict(Rows)
    _take_in_turn(patches, accepted)
    for patch in patches:
        if held[patch.numbers, patch.component].all() and len(patch.units) <= FEW_MULTIPLIERS:
            # A small one that is prescribed all over takes all that don't follow from others:
            # what faces it on Γ0 must follow
            for unit in (*(value for value, _ in patch.values), *patch.units):
                patch.add(accepted[patch.component], unit, INDEPENDENT_ROWS)
            patch.complete = True
        else:
            rank = np.linalg.matrix_rank(patch.B * patch.free)
            patch.complete = len(patch.taken) == rank
        drop[patch.numbers, patch.component] = True
    return patches


def slopes(
    every: Every, drop, entries, prescribed, instead: Sequence[Replacement]
) -> list[Replacement]:
    """Multipliers that narrow pieces have beside their own, where these lie on lines. Collective.

    Along the lines λ follows from what is left; it gets polynomials across them, of all of a tie
    (which a patch test needs) and of each facet, as far as opposite dofs answer to them.

    Args:
        every: The multipliers.
        drop: Which are dropped, ``(num_multipliers, block_size)``.
        entries: Multiplier, component, column and value of each nonzero of E, in parts.
        prescribed: Which owned dofs of each body are prescribed.
        instead: What pieces with too few have.
    """
    found = []
    for component in range(drop.shape[1]):
        for t in range(len(every.lists)):
            found += _across(every, t, component, drop, entries, prescribed)
    accepted: defaultdict[int, Rows] = defaultdict(Rows)
    # All others have dofs of Γ1 that answer to them
    known = [(piece, piece.taken) for piece in instead] + [(piece, piece.units) for piece in found]
    for piece, values in known:
        for value in values:
            accepted[piece.component].add(piece.columns, value @ piece.B * piece.free, 0.0)
    _take_in_turn(found, accepted)
    return found


def _across(every: Every, t: int, component: int, drop, entries, prescribed) -> list[Replacement]:
    """Those of one tie to try, if there are any. Collective."""
    lists, mine = every.lists[t], slice(*every.starts[t : t + 2])
    lacking = lists.lacking(drop[mine, component])
    if not lacking:
        return []
    lacking = [(at + mine.start, values) for at, values in lacking]
    narrow = np.unique(np.concatenate([at for at, _ in lacking]))
    # E of what these follow
    m, of, column, weights = (np.concatenate(part) for part in zip(*entries, strict=True))
    use = np.isin(column, column[np.isin(m, narrow) & (of == component)])
    m, weights = m[use], weights[use]
    numbers = np.union1d(m, narrow)
    row = np.searchsorted(numbers, m)
    own, at = np.unique(column[use], return_inverse=True)
    E = np.zeros((len(numbers), len(own)))
    E[row, at] = weights
    stands = ~drop[m, component]  # for itself: where a column's value is λ
    place = np.zeros(len(own), dtype=np.intp)
    place[at[stands]] = row[stands]
    values = []
    for value, sine in _polynomials(every.x(numbers), lists.surface.element.degree):
        rest = np.isin(numbers, narrow) * (value - E @ value[place])
        if np.abs(rest).max() > NARROW_PIECE:
            values.append((rest, sine))
    for at, part in lacking:
        value = np.zeros(len(numbers))
        value[np.searchsorted(numbers, at)] = part / np.abs(part).max()
        values.append((value, INDEPENDENT_ROWS))
    columns, free, B = _gathered(every, numbers, prescribed, component)
    num = len(values)
    return [Replacement(component, numbers, columns, free, B, E.T, values, num, complete=True)]
