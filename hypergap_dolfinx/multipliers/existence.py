# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Choice of the multipliers where interfaces end, meet or are held.

The minimum in eq. (22) is over the free x_a, so no constraint belongs to a prescribed x_a: it could
make B rank-deficient. The multipliers that exist keep this **invariant**:

* the rows of B, restricted to free dofs, are linearly independent: where multipliers had to be
  replaced, each new row makes an angle with those before it whose sine is at least
  :data:`INDEPENDENT_ROWS` (:data:`CONSISTENT` for rows that a patch test needs);
* there are no more rows than free dofs that can satisfy them;
* each patch's λ can be any polynomial of degree k − 1, and can carry a force and a moment.

Three rules lead there:

1. λ belongs to a surface: if several ties lie on one smooth piece of a body's surface, and the
   bodies opposite are one or tied to each other there, the multipliers at one place are *one*.
   So pieces between the same two bodies are one interface, however many ties it is given as,
   unless they are said to be discontinuous: then their ends are as cross points.
2. A dof of Γ1 that none of the ties covers by enough of a facet has no multiplier, nor has one
   that is prescribed, or that another interface has on its Γ1 too: there λ follows its neighbours,
   as in mortar methods with cross points. The same holds for dofs on another interface's Γ0 if
   that one is left with too few multipliers, or if ties lead round in a circle, for one tie of it
   (:meth:`~.numbering.Numbering.breaks`). So B is triangular, but for an exception: rows of such
   ties have dofs of Γ1 that are in no other rows; without them, in an order in which Γ0's body
   comes before Γ1's, a row's dof of Γ1 is else in rows of later bodies only. (If a compliance
   determines λ between two prescribed sides, no dof has to answer.) The exception is an interface
   that ends between two bodies on a smooth Γ0 (:mod:`~.multipliers.ends`). It keeps its
   multipliers; those on Γ0 are one body's, which by rule 1 are the other one's too, or which that
   one follows: as many rows as both have dofs there.
3. A patch that is left with too few multipliers gets other ones instead: λ is constant, linear, …
   in space, as far as these rows don't follow from those of other such patches. If those that are
   left lie on lines (one cell wide, held along both edges), λ's slopes across are added.
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
from hypergap_dolfinx.multipliers.ends import Ends, Follows, SmoothPieces, find_ends
from hypergap_dolfinx.multipliers.interface import Interface
from hypergap_dolfinx.multipliers.numbering import (
    Numbering,
    Pair,
    Replacement,
    pieces,
    prescribed_dofs,
    replacements,
    slopes,
    ties_with_too_few,
)
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
    """Global dof (unrolled) of V₁ that answers to each; −1 if several do, ``(num_columns,)``."""


@dataclass
class Choice:
    """The multipliers chosen for all ties; the same on every rank."""

    interfaces: list[list[int]]
    """The ties of each interface that has a multiplier."""
    columns: list[Columns]
    """The multipliers that exist, of each interface."""
    entries: list[tuple[npt.NDArray, npt.NDArray, npt.NDArray, npt.NDArray]]
    """E with λ = E λ' of each tie: row (multiplier times block size plus component), interface,
    column and value of each nonzero."""
    complete: list[bool]
    """True for a tie of which each multiplier exists by itself."""
    lost: list[npt.NDArray[np.intp]]
    """Rows of each tie without a multiplier in reach, because everything there is prescribed."""
    undetermined: list[bool] = field(default_factory=list)
    """True for a tie with a compliance that is 0 at rows with nothing free."""

    def add(self, of: Sequence[int], other: "Choice"):
        """Insert the choice for some of the ties, which have these numbers here."""
        start = len(self.interfaces)
        self.interfaces += [[of[t] for t in group] for group in other.interfaces]
        self.columns += other.columns
        for t, (row, group, column, value) in zip(of, other.entries, strict=True):
            self.entries[t] = row, group + start, column, value
        for k, t in enumerate(of):
            self.complete[t], self.lost[t] = other.complete[k], other.lost[k]
            self.undetermined[t] = other.undetermined[k]


def _merge(numbering: Numbering, users, smooth: SmoothPieces) -> npt.NDArray[np.int32]:
    """Rule 1: number of the class of each multiplier; those of one class are one."""
    bodies, tie = numbering.bodies, numbering.tie

    def may(a: int, b: int, side: int) -> bool:
        """True if two ties on one smooth piece of a body act as one interface at a place."""
        s, t = tie[a], tie[b]
        if s == t or not numbering.are_alike(s, t):
            return False
        if numbering.body(s, side) != numbering.body(t, side):
            return False
        opposite = numbering.body(s, 1 - side), numbering.body(t, 1 - side)
        if opposite[0] != opposite[1] and frozenset(opposite) not in numbering.tied:
            return False
        return bool(smooth.at(a, side) & smooth.at(b, side))

    pairs = [
        (a, b)
        for same in numbering.places.values()
        for a, b in combinations(same, 2)
        if may(a, b, 1)
    ]
    # On one smooth piece of Γ0, bodies on the other side whose corners meet
    by_body = defaultdict(list)
    for m in users:
        by_body[bodies[tie[m]][0]].append(m)
    for same in by_body.values():
        x = numbering.x(same)
        size = min(numbering.lists[tie[m]].surface.size.min() for m in same)
        for i, a in enumerate(same):
            near = np.abs(x[i + 1 :] - x[i]).max(axis=1) <= SAME_PLACE * size
            for b in np.array(same[i + 1 :], dtype=int)[near]:
                same_dof = numbering.dof[a] == numbering.dof[b] and bodies[tie[a]] == bodies[tie[b]]
                if not same_dof and may(a, b, 0):
                    pairs.append((a, int(b)))
    first, second = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    return components(len(numbering), first, second)


def _at_cross_points(numbering: Numbering, users, mine, alone, breaks, ends: Ends):
    """Mask of the multipliers whose dofs another interface uses too, ``(num,)``.

    ``alone`` is the mask of ties on whose Γ0 no other one may have a multiplier, ``breaks`` that of
    :meth:`~.numbering.Numbering.breaks`.
    """
    crossed = np.zeros(len(numbering), dtype=bool)
    for same in numbering.places.values():
        for a, b in combinations(same, 2):
            crossed[[a, b]] |= numbering.tie[a] == numbering.tie[b]  # patches that meet at a kink
    for m, others in users.items():
        ending = ends.between[numbering.place(m)]
        is_end = numbering.between(numbering.tie[m]) in ending
        for s, side in others:
            if s in mine[m] if side else not (alone[s] or breaks[mine[m]].any()):
                continue
            # Of an interface that ends and those on the surface all keep theirs
            other_end = numbering.between(s) in ending
            crossed[m] |= s in mine[m] or ((not side or other_end) if is_end else not other_end)
    return crossed


def _covered(numbering: Numbering, members) -> npt.NDArray[np.bool_]:
    """Mask of the multipliers with a facet that their interface covers enough, ``(num,)``."""
    parts = [m.on_any((m.covered > COVERED_FACET) & (m.least > KNOWN)) for m in numbering.lists]
    enough = np.concatenate(parts)
    for same in members.values():
        if len(same) > 1 and not enough[same].any():
            total: defaultdict[tuple, float] = defaultdict(float)
            for lists, local in map(numbering.local, same):
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
        prescribed: Mask of each body's owned dofs that are, ``(num_dofs * block_size,)``.
    """
    sizes = [tie.block_size for tie in ties]
    none, num = np.empty(0, dtype=np.intp), len(ties)
    chosen = Choice([], [], [(none,) * 4] * num, [True] * num, [none] * num, [False] * num)
    for size in dict.fromkeys(sizes):
        of = [t for t, other in enumerate(sizes) if other == size]
        chosen.add(of, _choose([ties[t] for t in of], [bodies[t] for t in of], prescribed))
    return chosen


def _choose(ties: Sequence[Interface], bodies: Sequence[Pair], prescribed) -> Choice:
    """Choose the multipliers of ties with the same number of components. Collective."""
    num, groups = len(ties), interfaces(ties, bodies)
    numbering = Numbering(ties, bodies)
    users = numbering.users()
    smooth = SmoothPieces(numbering)
    label = _merge(numbering, users, smooth)
    members: defaultdict[int, list[int]] = defaultdict(list)
    for m in np.flatnonzero(np.bincount(label)[label] > 1).tolist():
        members[int(label[m])].append(m)
    for m in users:
        members.setdefault(int(label[m]), [m])
    mine = {m: numbering.tie[members[label[m]]] for m in users}
    ends = find_ends(numbering, users, mine, smooth)
    # What isn't one with a multiplier across an interface that ends follows those there
    follows: Follows = {}
    for m, across in ends.across.items():
        if numbering.tie[across[0][0]] not in mine[m]:
            follows |= dict.fromkeys(members[label[m]], across)
    by_compliance = [_from_compliance(numbering, t, prescribed) for t in range(num)]
    parts = zip(ties, bodies, numbering.lists, by_compliance, strict=True)
    held = np.vstack(
        [
            prescribed_dofs(tie, 1, prescribed[pair[1]], lists.dofs) & ~determined
            for tie, pair, lists, (determined, _) in parts
        ]
    )
    covered, alone = _covered(numbering, members), np.zeros(num, dtype=bool)
    breaks, changed = numbering.breaks(users), True
    while changed:
        gone = _at_cross_points(numbering, users, mine, alone, breaks, ends) | ~covered
        drop = held | gone[:, None]
        for same in members.values():
            drop[same] = held[same].all(axis=0) | gone[same].any()
        few = ties_with_too_few(numbering, label, drop, follows) if users else alone
        changed = bool((few & ~alone).any())
        alone |= few
    chosen = _Assembly(numbering, groups, label, held, drop, prescribed, follows).choice()
    chosen.undetermined = [undetermined for _, undetermined in by_compliance]
    return chosen


def _from_compliance(numbering: Numbering, t: int, prescribed) -> tuple[npt.NDArray, bool]:
    """Multipliers that a tie's compliance or law alone determines: the rest of a row is prescribed.

    Collective.

    Returns:
        Their mask, ``(num_multipliers, block_size)``; and True if the compliance is 0 at others
        whose rows are prescribed.

    Raises:
        ValueError: A compliance that determines one part of them, along or across the normal.
    """
    tie = numbering.ties[t]
    fixed = np.zeros((len(numbering.lists[t].dofs), tie.block_size), dtype=bool)
    if tie.free_interior or tie.gives_way is None:
        return fixed, False
    order = np.argsort(tie.constraint.rows)
    moves = fixed.copy()
    for side, body in enumerate(numbering.bodies[t]):
        dofs = np.unique(numbering.touched[t][side])
        free = ~prescribed_dofs(tie, side, prescribed[body], dofs)
        i, j, _ = triplets(tie.constraint.B[side])
        m = order[np.searchsorted(tie.constraint.rows[order], i)]
        np.logical_or.at(moves, m, free[np.searchsorted(dofs, j)])
    fixed = ~tie.domain.comm.allreduce(moves)  # of truth values the sum is "or"
    if tie.compliance is None:
        return fixed, False
    parts = tie.compliance.gives_way()[:, tie.constraint.rows]
    half = fixed.all(axis=1) & parts.any(axis=0) & ~parts.all(axis=0)
    if half.any():
        first = int(half.argmax())
        where = "across" if parts[0, first] else "along"
        raise ValueError(
            f"the compliance is 0 {where} the normal at {spot(numbering.lists[t].x[first])}, where "
            "both sides are prescribed, so λ is not determined there; give both parts or none, or "
            "prescribe one side only."
        )
    says = parts.all(axis=0)[:, None]
    return fixed & says, bool((fixed & ~says).any())


def _through(numbers, weights, rows) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
    """Multipliers and weights of a sum; those that have ``rows`` in terms of others."""
    if not rows:
        return numbers, weights
    parts = [rows.get(j, (np.array([j]), np.ones(1))) for j in numbers]
    if not parts:
        return np.empty(0, dtype=np.intp), np.empty(0)
    scaled = [w * part[1] for w, part in zip(weights, parts, strict=True)]
    found, at = np.unique(np.concatenate([part[0] for part in parts]), return_inverse=True)
    return found, np.bincount(at, np.concatenate(scaled), len(found))


class _Assembly:
    """Columns of E for the multipliers that exist, and its rows for all others."""

    def __init__(self, numbering: Numbering, groups, label, held, drop, prescribed, follows):
        self._numbering, self._groups, self._label = numbering, groups, label
        self._held, self._drop, self._follows = held, drop, follows
        self._prescribed = prescribed
        self._group = np.empty(len(numbering.ties), dtype=np.intp)
        for g, group in enumerate(groups):
            self._group[group] = g
        self._piece_of: dict[int, npt.NDArray[np.int32]] = {}
        # Each column: interface, rank, the multiplier that it stands for, component, own dof
        self._columns: list[npt.NDArray[np.int64]] = []
        # Each entry of E: multiplier, component, column, value
        self._entries: list[tuple] = []
        self._lost: list[tuple[int, int]] = []  # multiplier and component

    def choice(self) -> Choice:
        """Make the columns and the entries. Collective."""
        numbering, block_size = self._numbering, self._held.shape[1]
        new = replacements(
            numbering, self._label, self._held, self._drop, self._prescribed, self._follows
        )
        elsewhere = np.zeros_like(self._drop)
        for piece in new:
            elsewhere[piece.numbers, piece.component] = True
        # One column for each class that is left, at its first multiplier
        first = np.unique(self._label, return_index=True)[1][self._label]
        gone = self._drop.copy()
        gone[list(self._follows)] = True
        m, component = np.nonzero(~gone)
        own = first[m] == m
        column = np.full(gone.shape, -1, dtype=np.intp)
        column[m[own], component[own]] = np.arange(own.sum())
        dofs = numbering.dof[m[own]] * block_size + component[own]
        self._add_columns(m[own], component[own], dofs)
        column[m, component] = column[first[m], component]
        self._entries.append((m, component, column[m, component], np.ones(len(m))))
        across = {}
        for m, component in np.argwhere(gone & ~self._drop).tolist():
            others, weights = self._follows[m]
            dropped = others[gone[others, component]]
            rows = {j: self._follow(j, component, gone)[:2] for j in dropped}
            across[m, component] = _through(others, weights, rows)
            self._add_row(m, component, *across[m, component], column)
        for m, component in np.argwhere(self._drop & ~elsewhere).tolist():
            others, weights, beside = self._follow(m, component, self._drop)
            if not beside and self._all_held(m, component):
                self._lost.append((m, component))
            rows = {j: across[j, component] for j in others if (j, component) in across}
            self._add_row(m, component, *_through(others, weights, rows), column)
        for piece in new + slopes(
            numbering, self._drop, gone, self._entries, self._prescribed, new
        ):
            self._add_replacement(piece)
        return self._numbered()

    def _add_columns(self, m, component, own):
        """Add columns at multipliers on the ranks of the dofs that answer to them."""
        numbering = self._numbering
        tie = numbering.tie[m]
        rank = np.empty(len(m), dtype=np.intp)
        for t in np.unique(tie):
            ends = numbering.ties[t].surfaces[1].dof_range[1:]
            rank[tie == t] = np.searchsorted(ends, numbering.dof[m[tie == t]], side="right")
        self._columns.append(np.stack((self._group[tie], rank, m, component, own), axis=1))

    def _add_row(self, m: int, component: int, others, weights, column):
        of = np.full((2, len(others)), ((m,), (component,)))
        self._entries.append((*of, column[others, component], weights))

    def _follow(self, m: int, component: int, drop):
        """Numbers and weights of the multipliers that λ follows, and True if they are beside it."""
        numbering, drop = self._numbering, drop[:, component]
        lists, local = numbering.local(m)
        start = numbering.starts[numbering.tie[m]]
        weights, others, beside = lists.follow(local, drop[start : start + len(lists.dofs)])
        if len(others):
            return start + others, weights, beside
        # Its own tie has none left there, but another one of the same piece
        if component not in self._piece_of:
            dropped = self._drop[:, component]
            self._piece_of[component] = pieces(numbering, self._label, dropped, self._follows)
        piece = self._piece_of[component]
        mine = np.flatnonzero((piece == piece[m]) & ~drop)
        if len(mine):
            nearest = np.linalg.norm(numbering.x(mine) - lists.x[local], axis=1).argmin()
            return mine[nearest : nearest + 1], np.ones(1), beside
        return others, weights, beside

    def _all_held(self, m: int, component: int) -> bool:
        """True if all dofs of the facets at a multiplier are prescribed."""
        lists, local = self._numbering.local(m)
        start = self._numbering.starts[self._numbering.tie[m]]
        at = lists.on_facets[lists.facets_of(local)[0]]
        return bool((self._held[start + at, component] | (at < 0)).all())

    def _add_replacement(self, piece: Replacement):
        """Add columns for the multipliers that a piece has instead of its own."""
        numbers, component = piece.numbers, piece.component
        start = sum(len(columns) for columns in self._columns)
        at = np.repeat(numbers[:1], len(piece.taken))
        self._add_columns(at, np.full(len(at), component), np.full(len(at), -1))
        of = np.full(len(numbers), component)
        for column, values in enumerate(piece.taken, start):
            self._entries.append((numbers, of, np.full(len(numbers), column), values))
        if not piece.complete:
            self._lost += [(m, component) for m in numbers if self._all_held(m, component)]

    def _numbered(self) -> Choice:
        """Sort the columns of each interface by rank."""
        numbering, block_size = self._numbering, self._held.shape[1]
        columns = np.concatenate(self._columns)
        interface, rank, m, component, own = columns.T
        # An interface may have nothing left: neighbours hold its place, or all is prescribed
        left = np.isin(np.arange(len(self._groups)), interface)
        left |= [any(numbering.ties[t].free_interior for t in group) for group in self._groups]
        groups = [group for group, keep in zip(self._groups, left, strict=True) if keep]
        interface = (np.cumsum(left) - 1)[interface]
        order = np.lexsort((np.arange(len(columns)), component, m, rank, interface))
        starts = np.searchsorted(interface[order], np.arange(len(groups) + 1))
        number = np.empty(len(order), dtype=np.intp)
        number[order] = np.arange(len(order)) - starts[interface[order]]
        m, component, column, value = map(np.concatenate, zip(*self._entries, strict=True))
        m, column = m.astype(np.intp), column.astype(np.intp)
        tie = numbering.tie[m]
        row = (m - numbering.starts[tie]) * block_size + component.astype(np.intp)
        lost = np.array(self._lost, dtype=np.intp).reshape(-1, 2)
        lost_tie = numbering.tie[lost[:, 0]]
        lost_row = (lost[:, 0] - numbering.starts[lost_tie]) * block_size + lost[:, 1]
        each = range(len(numbering.ties))
        # A tie is complete if all its multipliers exist, and none is shared with another tie
        whole = (np.bincount(self._label)[self._label] == 1) & ~self._drop.any(axis=1)
        whole[list(self._follows)] = False
        return Choice(
            groups,
            [Columns(rank[order[a:b]], own[order[a:b]]) for a, b in pairwise(starts)],
            [
                (row[mine], interface[column[mine]], number[column[mine]], value[mine])
                for mine in (tie == t for t in each)
            ],
            [bool(part.all()) for part in np.split(whole, numbering.starts[1:-1])],
            [lost_row[lost_tie == t] for t in each],
        )
