# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Multipliers of all ties in one numbering, and replacements on pieces that are left with too few.

If all ends of a small piece are at cross points or prescribed, λ is constant, linear, … in space
instead, as far as these rows don't follow from those of other such pieces. A piece so narrow that
its own multipliers lie on lines gets the slopes of λ across these lines too.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.collective import look_up
from hypergap_dolfinx.core.graph import PartsOf, components
from hypergap_dolfinx.core.sparse import triplets
from hypergap_dolfinx.mortar.constraint import Multipliers
from hypergap_dolfinx.multipliers.interface import Interface
from hypergap_dolfinx.multipliers.tolerances import CONSISTENT, INDEPENDENT_ROWS, SAME_PLACE

Pair = tuple[int, int]
"""Two bodies, or a body and a dof (block) of it."""

Follows = dict[int, tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]]
"""Multipliers, and weights at others that make λ there."""


def prescribed_dofs(tie: Interface, side: int, prescribed, dofs) -> npt.NDArray[np.bool_]:
    """Mask of prescribed components of one side's dofs, on every rank. Collective.

    On Γ0 of a tie with a rotation, the components of R u₀.
    """
    owned = prescribed.reshape(-1, tie.block_size).astype(np.int8)
    offset = tie.spaces[side].dofmap.index_map.local_range[0]
    held = look_up(tie.domain.comm, owned, offset, dofs).astype(bool)
    if side == 0 and tie.turn is not None:
        held = ~(~held @ (tie.turn != 0).T)
    return held


def values_at(tie: Interface, side: int, owned: npt.NDArray, dofs) -> npt.NDArray:
    """Values at dofs of one side on every rank, as they are compared; R u₀ of Γ0. Collective."""
    offset = tie.spaces[side].dofmap.index_map.local_range[0]
    values = look_up(tie.domain.comm, owned, offset, dofs)
    return values if side or tie.turn is None else values @ tie.turn.T


class Numbering:
    """All ties' multipliers in one numbering."""

    def __init__(self, ties: Sequence[Interface], bodies: Sequence[Pair]):
        """Number the multipliers of ties, between bodies of these numbers. Collective."""
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
        """Number of multipliers."""
        return int(self.starts[-1])

    def local(self, m: int) -> tuple[Multipliers, int]:
        """Multipliers of the tie that a multiplier belongs to, and its number among them."""
        t = self.tie[m]
        return self.lists[t], int(m - self.starts[t])

    def body(self, t: int, side: int) -> tuple[int, frozenset[int]]:
        """A tie's body on a side: its number and the parts of its mesh. Collective when new.

        Parts of one mesh that aren't connected are bodies of their own here.
        """
        if (t, side) not in self._bodies:
            dofs = self.touched[t][side]
            found = self._parts_of(self.ties[t].spaces[side], dofs)
            self._bodies[t, side] = self.bodies[t][side], found
        return self._bodies[t, side]

    def pair(self, t: int) -> tuple:
        """Such bodies of a tie's Γ0 and Γ1. Collective when new."""
        return self.body(t, 0), self.body(t, 1)

    def between(self, t: int) -> frozenset:
        """Such bodies of a tie. Collective when new."""
        return frozenset(self.pair(t))

    @cached_property
    def tied(self) -> set[frozenset]:
        """Pairs of such bodies that ties tie to each other. Collective."""
        return set(map(self.between, range(len(self.ties))))

    def are_alike(self, s: int, t: int) -> bool:
        """True if λ of two ties may be one."""
        ties = self.ties[s], self.ties[t]
        first, second = ((tie.closes_gap, tie.motion and tie.motion.key) for tie in ties)
        return first == second and not any(tie.free_interior or tie.discontinuous for tie in ties)

    def place(self, m: int) -> Pair:
        """Body of Γ1 and dof (block) under a multiplier."""
        return self.bodies[self.tie[m]][1], int(self.dof[m])

    def breaks(self, users) -> npt.NDArray[np.bool_]:
        """Mask of ties without which no circle of Γ0's and Γ1's bodies is left. Collective.

        Such a tie loses its multipliers at dofs on Γ0 of others, which ``users`` has
        (:meth:`users`): those that would lose the largest share are kept first. Multipliers at ends
        count as far as Σ reaches their facets.
        """
        if not users:  # no multiplier to lose
            return np.zeros(len(self.ties), dtype=bool)
        lost = np.zeros(len(self.ties))
        for m, others in users.items():
            if any(side == 0 for _, side in others):
                lists, local = self.local(m)
                lost[self.tie[m]] += lists.least[lists.facets_of(local)[0]].max()
        share = lost / np.maximum(np.diff(self.starts), 1)
        arcs = [(self.body(t, 0), self.body(t, 1)) for t in range(len(share))]
        breaks = np.zeros(len(share), dtype=bool)
        behind: defaultdict[tuple, set[tuple]] = defaultdict(set)
        for t in np.argsort(-share, kind="stable"):
            start, end = arcs[t]
            reached, todo = {end}, [end]
            while todo:
                new = behind[todo.pop()] - reached
                reached |= new
                todo += new
            breaks[t] = start in reached
            if not breaks[t]:
                behind[start].add(end)
        return breaks

    def x(self, numbers) -> npt.NDArray[np.float64]:
        """Positions of the dofs under some multipliers, ``(num, n)``."""
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
            for (s, other), side in product(enumerate(self.bodies), (0, 1)):
                if other[side] != pair[1] or (s, side) == (t, 1):
                    continue
                for m in np.flatnonzero(np.isin(self.dof[mine], self.touched[s][side])):
                    found[int(m + self.starts[t])].add((s, side))
        return found


def _touched(tie: Interface) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Dofs (blocks) of both sides that the tie's Σ reaches, on every rank. Collective."""
    columns = np.unique(triplets(tie.constraint.B[0])[1]).astype(np.int64)
    return np.unique(np.concatenate(tie.domain.comm.allgather(columns))), tie.constraint.dofs


class Rows:
    """Linearly independent rows; a column is a body's dof, given by two numbers."""

    def __init__(self):
        """Start without rows."""
        self._column: dict[Pair, int] = {}
        self._basis = np.zeros((0, 0))

    def add(self, columns: Sequence[Pair], values, size: float, sine=INDEPENDENT_ROWS) -> bool:
        """Add a row unless it is small or follows from the others; True if it was added."""
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
    """Mask of the columns that aren't prescribed, ``(num_columns,)``."""
    B: npt.NDArray[np.float64]
    """The rows, ``(num_multipliers, num_columns)``."""
    units: npt.NDArray[np.float64]
    """λ that is 1 at one place and 0 at the others, ``(num_places, num_multipliers)``."""
    values: list[tuple[npt.NDArray, float]]
    """λ at the multipliers to try, and the sine of the angle from which each is taken."""
    wanted: int
    taken: list[npt.NDArray[np.float64]] = field(default_factory=list)
    complete: bool = False
    """True if the rows taken constrain all that the piece's own multipliers would."""

    def add(self, rows: Rows, value: npt.NDArray, sine: float):
        """Take a multiplier if its row doesn't follow from others."""
        row = value @ self.B
        if rows.add(self.columns, row * self.free, float(np.linalg.norm(row)), sine):
            self.taken.append(value)


def _polynomials(x: npt.NDArray, degree: int) -> list[tuple[npt.NDArray, float]]:
    """Values of λ to try at places: polynomials of degree k − 1, and linear ones."""
    x = x - x.mean(axis=0)
    _, size, axes = np.linalg.svd(x)
    along = (x @ axes.T).T[: len(size)][size > SAME_PLACE * size.max(initial=0)]
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
    comm = tie.domain.comm
    entries = np.concatenate(comm.allgather(entries.astype(np.int64)))
    columns, at = np.unique(entries[:, 1], return_inverse=True)
    B = np.zeros((len(rows), len(columns)))
    B[entries[:, 0], at] = np.concatenate(comm.allgather(value[use]))
    return columns, B


def pieces(numbering: Numbering, label, drop, follows: Follows) -> npt.NDArray[np.int32]:
    """Piece of each multiplier: patches of ties that share a multiplier that exists.

    ``label`` is the class of each, those of one class are one; ``drop`` is the mask of those that
    are dropped, of one component.
    """
    num = int(numbering.patch.max()) + 1
    patch = np.unique(numbering.tie * num + numbering.patch, return_inverse=True)[1].ravel()
    first = np.full(len(numbering), -1)
    kept = np.flatnonzero(~drop)[::-1]
    first[label[kept]] = kept  # some multiplier of each class
    joined = patch[first[label[kept]]]
    across = [(m, others[0]) for m, (others, _) in follows.items() if not drop[m]]
    i, j = patch[np.array(across, dtype=np.intp).reshape(-1, 2)].T
    return components(int(patch.max()) + 1, np.append(patch[kept], i), np.append(joined, j))[patch]


def _gathered(numbering: Numbering, numbers, prescribed, component: int):
    """Columns of some multipliers' rows, the mask of free ones, and the rows. Collective."""
    columns: dict[Pair, int] = {}
    free: list[bool] = []
    parts = []
    for t in np.unique(numbering.tie[numbers]):
        local = numbers[numbering.tie[numbers] == t] - numbering.starts[t]
        tie = numbering.ties[t]
        for side, body in enumerate(numbering.bodies[t]):
            dofs, part = _rows(tie, side, local)
            held = prescribed_dofs(tie, side, prescribed[body], dofs)[:, component]
            for dof, is_held in zip(dofs.tolist(), held.tolist(), strict=True):
                if columns.setdefault((body, dof), len(columns)) == len(free):
                    free.append(not is_held)
            at = [columns[body, dof] for dof in dofs.tolist()]
            parts.append((np.flatnonzero(numbering.tie[numbers] == t), at, part))
    B = np.zeros((len(numbers), len(columns)))
    for rows, at, part in parts:
        B[np.ix_(rows, at)] += part
    return list(columns), np.array(free, dtype=bool), B


def ties_with_too_few(numbering: Numbering, label, drop, follows: Follows) -> npt.NDArray[np.bool_]:
    """Mask of ties with pieces that are left with too few multipliers, or with ones on lines."""
    few = np.zeros(len(numbering.ties), dtype=bool)
    for _, numbers, *_ in _short_pieces(numbering, label, drop, follows):
        few[numbering.tie[numbers]] = True
    for t, lists in enumerate(numbering.lists):
        mine = drop[slice(*numbering.starts[t : t + 2])]
        few[t] |= any(lists.lacking(part) for part in mine.T)
    return few


def _short_pieces(numbering: Numbering, label, drop, follows):
    """Pieces that are left with too few multipliers.

    Yields:
        Component, multipliers, those that are left, classes of all, and number wanted.
    """
    n, gone = numbering.ties[0].surfaces[1].gdim, drop.copy()
    gone[list(follows)] = True
    for component in range(drop.shape[1]):
        piece = pieces(numbering, label, drop[:, component], follows)
        order = np.argsort(piece, kind="stable")
        for numbers in np.split(order, np.flatnonzero(np.diff(piece[order])) + 1):
            classes = np.unique(label[numbers])
            degree = numbering.lists[numbering.tie[numbers[0]]].surface.element.degree
            polynomials = degree if n == 2 else degree * (degree + 1) // 2
            wanted = min(len(classes), max(n, polynomials))
            left = numbers[~gone[numbers, component]]
            if len(np.unique(label[left])) < wanted:
                yield component, numbers, left, classes, wanted


def _short_patches(numbering: Numbering, label, drop, prescribed, follows) -> list[Replacement]:
    """Pieces that are left with too few multipliers. Collective."""
    found = []
    for component, numbers, left, classes, wanted in _short_pieces(numbering, label, drop, follows):
        columns, free, B = _gathered(numbering, numbers, prescribed, component)
        units = (label[numbers] == classes[:, None]).astype(float)
        kept = np.isin(classes, label[left])
        degree = numbering.lists[numbering.tie[numbers[0]]].surface.element.degree
        values = _polynomials(numbering.x(numbers), degree) + [
            (unit, INDEPENDENT_ROWS) for unit in units[kept]
        ]
        found.append(Replacement(component, numbers, columns, free, B, units, values, wanted))
    return found


def _take_in_turn(patches: Sequence[Replacement], accepted: defaultdict[int, Rows]):
    """Take one multiplier for each piece, then a second, …, so that none remains without."""
    for number in range(1, max((patch.wanted for patch in patches), default=0) + 1):
        for patch in patches:
            while patch.values and len(patch.taken) < min(number, patch.wanted):
                patch.add(accepted[patch.component], *patch.values.pop(0))


def replacements(
    numbering: Numbering, label, held, drop, prescribed, follows: Follows
) -> list[Replacement]:
    """Choose other multipliers for pieces with too few; drops these. Collective.

    Args:
        numbering: The multipliers.
        label: Class of each; those of one class are one.
        held: Mask of prescribed components of their dofs, ``(num_multipliers, block_size)``.
        drop: Mask of components that are dropped, of the same shape; changed here.
        prescribed: Mask of each body's owned dofs that are prescribed.
        follows: Those that follow others, and have no row of their own.
    """
    patches = _short_patches(numbering, label, drop, prescribed, follows)
    accepted: defaultdict[int, Rows] = defaultdict(Rows)
    _take_in_turn(patches, accepted)
    # Rows that are tried one by one: the cost grows with the cube of their number. 3 and 10⁹ change
    # nothing in test_multipliers, test_pieces, test_cross_points, test_ends and test_property
    few = 32
    for patch in patches:
        if held[patch.numbers, patch.component].all() and len(patch.units) <= few:
            # A small piece that is prescribed all over takes all independent rows, so that the
            # dofs of Γ0 that face it follow
            for unit in (*(value for value, _ in patch.values), *patch.units):
                patch.add(accepted[patch.component], unit, INDEPENDENT_ROWS)
            patch.complete = True
        else:
            rank = np.linalg.matrix_rank(patch.B * patch.free)
            patch.complete = len(patch.taken) == rank
        drop[patch.numbers, patch.component] = True
    return patches


def slopes(
    numbering: Numbering, drop, gone, entries, prescribed, instead: Sequence[Replacement]
) -> list[Replacement]:
    """Additional multipliers of narrow pieces whose own ones lie on lines. Collective.

    Along the lines λ follows from what is left; it gets polynomials across them, of all of a tie
    (which a patch test needs) and of each facet, as far as opposite dofs answer to them.

    ``entries`` are multiplier, component, column and value of each nonzero of E, in parts;
    ``instead`` are the :func:`replacements`, the rest is as there.
    """
    found = []
    for component, t in product(range(drop.shape[1]), range(len(numbering.lists))):
        found += _across(numbering, t, component, drop, gone, entries, prescribed)
    accepted: defaultdict[int, Rows] = defaultdict(Rows)
    # All others have dofs of Γ1 that answer to them
    known = [(piece, piece.taken) for piece in instead] + [(piece, piece.units) for piece in found]
    for piece, values in known:
        for value in values:
            accepted[piece.component].add(piece.columns, value @ piece.B * piece.free, 0.0)
    _take_in_turn(found, accepted)
    return found


def _across(
    numbering: Numbering, t: int, component: int, drop, gone, entries, prescribed
) -> list[Replacement]:
    """Slopes to try on one tie, if its multipliers lie on lines. Collective."""
    lists, mine = numbering.lists[t], slice(*numbering.starts[t : t + 2])
    lacking = lists.lacking(drop[mine, component])
    if not lacking:
        return []
    lacking = [(at + mine.start, values) for at, values in lacking]
    narrow = np.unique(np.concatenate([at for at, _ in lacking]))
    # E of what these follow
    m, of, column, weights = map(np.concatenate, zip(*entries, strict=True))
    use = np.isin(column, column[np.isin(m, narrow) & (of == component)])
    m, weights = m[use], weights[use]
    numbers = np.union1d(m, narrow)
    row = np.searchsorted(numbers, m)
    own, at = np.unique(column[use], return_inverse=True)
    E = np.zeros((len(numbers), len(own)))
    E[row, at] = weights
    stands = ~gone[m, component]  # for itself: where a column's value is λ
    place = np.zeros(len(own), dtype=np.intp)
    place[at[stands]] = row[stands]
    values = []
    for value, sine in _polynomials(numbering.x(numbers), lists.surface.element.degree):
        rest = np.isin(numbers, narrow) * (value - E @ value[place])
        if np.abs(rest).max() > SAME_PLACE:
            values.append((rest, sine))
    for at, part in lacking:
        value = np.zeros(len(numbers))
        value[np.searchsorted(numbers, at)] = part / np.abs(part).max()
        values.append((value, INDEPENDENT_ROWS))
    columns, free, B = _gathered(numbering, numbers, prescribed, component)
    num = len(values)
    return [Replacement(component, numbers, columns, free, B, E.T, values, num, complete=True)]
