# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Which multipliers exist where interfaces end, meet or are held.

The minimum in eq. (22) is over the free x_a, so a prescribed x_a has no constraint: keeping it
could lose rank. What remains keeps this **invariant**:

* no row of B, on what is free, follows from the others: where multipliers had to be replaced, each
  new row makes an angle with those before it whose sine is at least
  :data:`~hypergap_dolfinx.multipliers.replacements.INDEPENDENT` (`CONSISTENT` for rows that a
  patch test needs);
* there are no more rows than free dofs that can answer to them;
* each patch's λ can be any polynomial of degree k − 1, and can carry a force and a moment.

Three rules lead there:

1. λ belongs to a surface. Where several ties lie on one smooth piece of a body's surface, and the
   bodies opposite are one or tied to each other there, the multipliers at one place are *one*.
   So pieces between the same two bodies are one interface, however many ties it is given as,
   unless they are said to be discontinuous: then their ends are as cross points.
2. A dof of Γ1 that none of the ties covers by enough of a facet has no multiplier, nor has one
   that is prescribed, or that another interface uses too: there λ follows its neighbours, as in
   mortar methods with cross points. (Where a compliance says what λ is between two sides that are
   prescribed, no dof has to answer.)
3. A patch that is left with too few multipliers gets other ones instead: λ is constant, linear, …
   in space, as far as these rows don't follow from those of other such patches. Where those that
   are left lie on lines (one cell wide, held along both edges), λ's slopes across are added.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.core.graph import components
from hypergap_dolfinx.core.sparse import triplets
from hypergap_dolfinx.mortar.constraint import smooth_pieces
from hypergap_dolfinx.multipliers.interface import Interface
from hypergap_dolfinx.multipliers.numbering import Every, Pair, prescribed_dofs
from hypergap_dolfinx.multipliers.replacements import Replacement, pieces, replacements, slopes
from hypergap_dolfinx.multipliers.tolerances import COVERED_FACET, KNOWN, SAME_PLACE


def interfaces(ties: Sequence[Interface], bodies: Sequence[Pair]) -> list[list[int]]:
    """Ties that are pieces of one interface, and share a block of rows: between the same bodies."""
    found: dict[tuple, list[int]] = {}
    for t, (tie, pair) in enumerate(zip(ties, bodies, strict=True)):
        key = (*pair, t) if tie.free_interior else pair
        found.setdefault(key, []).append(t)
    return list(found.values())


@dataclass(frozen=True)
class Columns:
    """The multipliers that exist, of one interface, in the order of their rows in B."""

    rank: npt.NDArray[np.intp]
    """The rank that has each, in ascending order, ``(num_columns,)``."""
    own: npt.NDArray[np.int64]
    """Global dof (unrolled) of V₁ that answers to each; −1 where several do, ``(num_columns,)``."""


@dataclass
class Choice:
    """What became of the multipliers of all ties; the same on every rank."""

    interfaces: list[list[int]]
    """The ties of each interface that has a multiplier."""
    columns: list[Columns]
    """The multipliers that exist, of each interface."""
    entries: list[tuple[npt.NDArray, npt.NDArray, npt.NDArray, npt.NDArray]]
    """E with λ = E λ' of each tie: row (multiplier times block size plus component), interface,
    column and value of each nonzero."""
    complete: list[bool]
    """Whether all of a tie's multipliers exist, one by one."""
    lost: list[npt.NDArray[np.intp]]
    """Rows of each tie without a multiplier in reach, because everything there is prescribed."""
    unsaid: list[bool] = field(default_factory=list)
    """Whether a tie has a compliance, and rows of which all is prescribed where it is 0."""

    def add(self, of: Sequence[int], other: "Choice"):
        """Take in what was chosen for some of the ties, which have these numbers here."""
        start = len(self.interfaces)
        self.interfaces += [[of[t] for t in group] for group in other.interfaces]
        self.columns += other.columns
        for t, (row, group, column, value) in zip(of, other.entries, strict=True):
            self.entries[t] = row, group + start, column, value
        for k, t in enumerate(of):
            self.complete[t], self.lost[t] = other.complete[k], other.lost[k]
            self.unsaid[t] = other.unsaid[k]


class _Smooth:
    """Smooth pieces of the bodies' surfaces that ties lie on, found when they are asked for."""

    def __init__(self, every: Every):
        self._every = every
        self._pieces: dict[tuple[int, int], list[npt.NDArray]] = {}

    def _piece(self, side: int, t: int) -> npt.NDArray:
        """Piece of each facet of a tie's side, numbered over all ties on that side of the body."""
        body = self._every.bodies[t][side]
        on = [s for s, pair in enumerate(self._every.bodies) if pair[side] == body]
        if (side, body) not in self._pieces:
            surfaces = [self._every.ties[s].surfaces[side] for s in on]
            self._pieces[side, body] = smooth_pieces(surfaces)
        return self._pieces[side, body][on.index(t)]

    def on_side1(self, m: int) -> set[int]:
        """Pieces of Γ1's body at a multiplier."""
        multipliers, local = self._every.local(m)
        return set(self._piece(1, self._every.tie[m])[multipliers.facets_of(local)[0]])

    def on_side0(self, m: int) -> set[int]:
        """The piece of Γ0's body that is nearest to a multiplier."""
        multipliers, local = self._every.local(m)
        t = self._every.tie[m]
        x = self._every.ties[t].domain.surfaces[0].nodes.mean(axis=1)
        facet = np.linalg.norm(x - multipliers.x[local], axis=1).argmin()
        return {self._piece(0, t)[facet]}


def _merge(every: Every, users) -> npt.NDArray[np.int32]:
    """Rule 1: the number of the class that each multiplier is in."""
    ties, bodies = every.ties, every.bodies
    smooth = _Smooth(every)
    alike = [(tie.closes_gap, tie.motion and tie.motion.key) for tie in ties]

    def may(a: int, b: int, side: int) -> bool:
        """Whether two ties with the same body on one side act as one interface at a place."""
        s, t = every.tie[a], every.tie[b]
        if s == t or alike[s] != alike[t]:
            return False
        if any(ties[i].free_interior or ties[i].discontinuous for i in (s, t)):
            return False
        if every.body(s, side) != every.body(t, side):
            return False
        opposite = every.body(s, 1 - side), every.body(t, 1 - side)
        return opposite[0] == opposite[1] or frozenset(opposite) in every.tied

    pairs = [
        (a, b)
        for same in every.places.values()
        for a, b in combinations(same, 2)
        if may(a, b, 1) and smooth.on_side1(a) & smooth.on_side1(b)
    ]
    # On one smooth piece of Γ0, bodies on the other side whose corners meet
    by_body = defaultdict(list)
    for m in users:
        by_body[bodies[every.tie[m]][0]].append(m)
    for same in by_body.values():
        x = every.x(same)
        size = min(every.lists[every.tie[m]].surface.size.min() for m in same)
        for i, a in enumerate(same):
            near = np.abs(x[i + 1 :] - x[i]).max(axis=1) <= SAME_PLACE * size
            for b in np.array(same[i + 1 :], dtype=int)[near]:
                if every.dof[a] == every.dof[b] and bodies[every.tie[a]] == bodies[every.tie[b]]:
                    continue
                if may(a, b, 0) and smooth.on_side0(a) & smooth.on_side0(b):
                    pairs.append((a, int(b)))
    first, second = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    return components(len(every), first, second)


def _at_cross_points(every: Every, users, label, members) -> npt.NDArray[np.bool_]:
    """Which multipliers another interface competes with for their dofs, ``(num,)``."""
    crossed = np.zeros(len(every), dtype=bool)
    for same in every.places.values():
        for a, b in combinations(same, 2):
            crossed[[a, b]] |= every.tie[a] == every.tie[b]  # patches that meet at a kink
    for m, others in users.items():
        mine = [every.tie[k] for k in members[label[m]]]
        # What ties the bodies that meet here ends here, and gives way
        ending = {
            frozenset((every.body(s, side), every.body(t, side)))
            for s, t in combinations(mine, 2)
            for side in (0, 1)
        }
        for s, side in sorted(others):
            if s in mine and side == 1:
                continue
            between = frozenset((every.body(s, 0), every.body(s, 1))) if ending else None
            crossed[m] |= s in mine or between not in ending
    return crossed


def _covered(every: Every, label, members) -> npt.NDArray[np.bool_]:
    """Which multipliers have a facet that their interface covers by enough, ``(num,)``."""
    enough = np.concatenate(
        [
            lists.on_any((lists.covered > COVERED_FACET) & (lists.least > KNOWN))
            for lists in every.lists
        ]
    )
    for same in members.values():
        if len(same) > 1 and not enough[same].any():
            total: defaultdict[tuple, float] = defaultdict(float)
            for lists, local in map(every.local, same):
                for facet in lists.facets_of(local)[0]:
                    total[tuple(np.sort(lists.surface.dofs[facet]))] += lists.covered[facet]
            enough[same] = max(total.values()) > COVERED_FACET
        elif len(same) > 1:
            enough[same] = True
    return enough


def choose(
    ties: Sequence[Interface], bodies: Sequence[Pair], prescribed: Sequence[npt.NDArray]
) -> Choice:
    """Choose the multipliers. Collective.

    A body with several fields counts as several bodies here: ties of different fields don't meet.

    Args:
        ties: The ties.
        bodies: Numbers of the bodies on both sides of each tie.
        prescribed: Which owned dofs of each body are prescribed, ``(num_dofs * block_size,)``.
    """
    sizes = [tie.block_size for tie in ties]
    none, num = np.empty(0, dtype=np.intp), len(ties)
    entries = [(none, none, none, none)] * num
    chosen = Choice([], [], entries, [True] * num, [none] * num, [False] * num)
    for size in dict.fromkeys(sizes):
        of = [t for t, other in enumerate(sizes) if other == size]
        chosen.add(of, _choose([ties[t] for t in of], [bodies[t] for t in of], prescribed))
    return chosen


def _choose(ties: Sequence[Interface], bodies: Sequence[Pair], prescribed) -> Choice:
    """The same for ties with as many components. Collective."""
    groups = interfaces(ties, bodies)
    every = Every(ties, bodies)
    users = every.users()
    label = _merge(every, users)
    members: defaultdict[int, list[int]] = defaultdict(list)
    for m in np.flatnonzero(np.bincount(label)[label] > 1).tolist():
        members[int(label[m])].append(m)
    for m in users:
        members.setdefault(int(label[m]), [m])
    held = np.vstack(
        [
            prescribed_dofs(tie, 1, prescribed[pair[1]], lists.dofs)
            for tie, pair, lists in zip(ties, bodies, every.lists, strict=True)
        ]
    )
    said = [_from_compliance(every, t, prescribed) for t in range(len(ties))]
    held &= ~np.vstack([by_compliance for by_compliance, _ in said])
    gone = _at_cross_points(every, users, label, members) | ~_covered(every, label, members)
    drop = held | gone[:, None]
    for same in members.values():
        drop[same] = held[same].all(axis=0) | gone[same].any()
    chosen = _Assembly(every, groups, label, held, drop, prescribed).choice()
    chosen.unsaid = [unsaid for _, unsaid in said]
    return chosen


def _from_compliance(every: Every, t: int, prescribed) -> tuple[npt.NDArray[np.bool_], bool]:
    """Which multipliers of a tie its compliance or law alone says: the rest of a row is prescribed.

    Collective.

    Returns:
        ``(num_multipliers, block_size)``; and whether it is 0 at others of these.

    Raises:
        ValueError: A compliance that says one part of them, along or across the normal.
    """
    tie = every.ties[t]
    fixed = np.zeros((len(every.lists[t].dofs), tie.block_size), dtype=bool)
    if tie.free_interior or tie.gives_way is None:
        return fixed, False
    order = np.argsort(tie.constraint.rows)
    moves = fixed.copy()
    for side, body in enumerate(every.bodies[t]):
        dofs = np.unique(every.touched[t][side])
        free = ~prescribed_dofs(tie, side, prescribed[body], dofs)
        i, j, _ = triplets(tie.constraint.B[side])
        m = order[np.searchsorted(tie.constraint.rows[order], i)]
        np.logical_or.at(moves, m, free[np.searchsorted(dofs, j)])
    fixed = ~tie.sigma.comm.allreduce(moves)  # of truth values the sum is "or"
    if tie.compliance is None:
        return fixed, False
    parts = tie.compliance.gives_way()[:, tie.constraint.rows]
    half = fixed.all(axis=1) & parts.any(axis=0) & ~parts.all(axis=0)
    if half.any():
        first = int(half.argmax())
        where = "across" if parts[0, first] else "along"
        raise ValueError(
            f"the compliance is 0 {where} the normal at {spot(every.lists[t].x[first])}, where "
            "both sides are prescribed, so λ is not determined there; give both parts or none, or "
            "prescribe one side only."
        )
    says = parts.all(axis=0)[:, None]
    return fixed & says, bool((fixed & ~says).any())


class _Assembly:
    """Numbers the multipliers that exist, and says what λ is at all others."""

    def __init__(self, every: Every, groups, label, held, drop, prescribed):
        self._every, self._groups, self._label = every, groups, label
        self._held, self._drop = held, drop
        self._prescribed = prescribed
        self._group = np.empty(len(every.ties), dtype=np.intp)
        for g, group in enumerate(groups):
            self._group[group] = g
        self._piece_of: dict[int, npt.NDArray[np.int32]] = {}
        # Of each column: interface, rank, the multiplier that it stands for, component, own dof
        self._columns: list[npt.NDArray[np.int64]] = []
        # Of each entry of E: multiplier, component, column, value
        self._entries: list[tuple] = []
        self._lost: list[tuple[int, int]] = []  # multiplier and component

    def choice(self) -> Choice:
        """Carry it out. Collective."""
        every, block_size = self._every, self._held.shape[1]
        new = replacements(every, self._label, self._held, self._drop, self._prescribed)
        elsewhere = np.zeros_like(self._drop)
        for piece in new:
            elsewhere[piece.numbers, piece.component] = True
        # One column for each class that is left, at its first multiplier
        first = np.unique(self._label, return_index=True)[1][self._label]
        m, component = np.nonzero(~self._drop)
        own = first[m] == m
        column = np.full(self._drop.shape, -1, dtype=np.intp)
        column[m[own], component[own]] = np.arange(own.sum())
        dofs = every.dof[m[own]] * block_size + component[own]
        self._add_columns(m[own], component[own], dofs)
        column[m, component] = column[first[m], component]
        self._entries.append((m, component, column[m, component], np.ones(len(m))))
        for m, component in np.argwhere(self._drop & ~elsewhere).tolist():
            weights, others, beside = self._follow(m, component)
            if not beside and self._all_held(m, component):
                self._lost.append((m, component))
            at = column[others, component]
            num = len(others)
            self._entries.append((np.full(num, m), np.full(num, component), at, weights))
        for piece in new + slopes(every, self._drop, self._entries, self._prescribed, new):
            self._add_replacement(piece)
        return self._numbered()

    def _add_columns(self, m, component, own):
        """Columns at multipliers, with the dofs that answer to them; on the ranks of these."""
        every = self._every
        tie = every.tie[m]
        rank = np.empty(len(m), dtype=np.intp)
        for t in np.unique(tie):
            ends = every.ties[t].surfaces[1].dof_range[1:]
            rank[tie == t] = np.searchsorted(ends, every.dof[m[tie == t]], side="right")
        self._columns.append(np.stack((self._group[tie], rank, m, component, own), axis=1))

    def _follow(self, m: int, component: int):
        """Weights and the multipliers that λ follows, and whether these are beside it."""
        every, drop = self._every, self._drop[:, component]
        lists, local = every.local(m)
        start = every.starts[every.tie[m]]
        weights, others, beside = lists.follow(local, drop[start : start + len(lists.dofs)])
        if len(others):
            return weights, start + others, beside
        # Its own tie has none left there, but another one of the same piece
        if component not in self._piece_of:
            self._piece_of[component] = pieces(every, self._label, drop)
        piece = self._piece_of[component]
        mine = np.flatnonzero((piece == piece[m]) & ~drop)
        if len(mine):
            nearest = np.linalg.norm(every.x(mine) - lists.x[local], axis=1).argmin()
            return np.ones(1), mine[nearest : nearest + 1], beside
        return weights, others, beside

    def _all_held(self, m: int, component: int) -> bool:
        """Whether all dofs of the facets at a multiplier are prescribed."""
        lists, local = self._every.local(m)
        start = self._every.starts[self._every.tie[m]]
        at = lists.on_facets[lists.facets_of(local)[0]]
        return bool((self._held[start + at, component] | (at < 0)).all())

    def _add_replacement(self, piece: Replacement):
        """Columns of the multipliers that a piece has instead of its own."""
        numbers, component = piece.numbers, piece.component
        start = sum(len(columns) for columns in self._columns)
        at = np.repeat(numbers[:1], len(piece.taken))
        self._add_columns(at, np.full(len(at), component), np.full(len(at), -1))
        for i, values in enumerate(piece.taken):
            num = len(numbers)
            self._entries.append(
                (numbers, np.full(num, component), np.full(num, start + i), values)
            )
        if not piece.complete:
            self._lost += [(m, component) for m in numbers if self._all_held(m, component)]

    def _numbered(self) -> Choice:
        """Sort the columns of each interface by rank."""
        every, block_size = self._every, self._held.shape[1]
        columns = np.concatenate(self._columns)
        interface, rank, m, component, own = columns.T
        # An interface may have nothing left: neighbours hold its place, or all is prescribed
        left = np.isin(np.arange(len(self._groups)), interface)
        left |= [any(every.ties[t].free_interior for t in group) for group in self._groups]
        groups = [group for group, keep in zip(self._groups, left, strict=True) if keep]
        interface = (np.cumsum(left) - 1)[interface]
        order = np.lexsort((np.arange(len(columns)), component, m, rank, interface))
        starts = np.searchsorted(interface[order], np.arange(len(groups) + 1))
        number = np.empty(len(order), dtype=np.intp)
        number[order] = np.arange(len(order)) - starts[interface[order]]
        m, component, column, value = (
            np.concatenate(part) for part in zip(*self._entries, strict=True)
        )
        m, column = m.astype(np.intp), column.astype(np.intp)
        tie = every.tie[m]
        row = (m - every.starts[tie]) * block_size + component.astype(np.intp)
        lost = np.array(self._lost, dtype=np.intp).reshape(-1, 2)
        lost_tie = every.tie[lost[:, 0]]
        lost_row = (lost[:, 0] - every.starts[lost_tie]) * block_size + lost[:, 1]
        each = range(len(every.ties))
        return Choice(
            groups,
            [Columns(rank[order[a:b]], own[order[a:b]]) for a, b in pairwise(starts)],
            [
                (row[mine], interface[column[mine]], number[column[mine]], value[mine])
                for mine in (tie == t for t in each)
            ],
            [self._is_complete(slice(*every.starts[t : t + 2])) for t in each],
            [lost_row[lost_tie == t] for t in each],
        )

    def _is_complete(self, mine: slice) -> bool:
        """Whether all multipliers exist, and none is one with another tie's."""
        alone = np.bincount(self._label)[self._label[mine]] == 1
        return bool(alone.all() and not self._drop[mine].any())
