# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Ties that share a smooth piece of a body's surface.

Ties between the same bodies are solved as one interface, a union. With a Σ of its own each tie
would end where the next one starts, with too few or too many multipliers there. One Σ over all of
them avoids that.

Where other bodies meet on that piece, it is Γ1 of all its ties or Γ0 of all, if their sides aren't
given: λ then goes on from tie to tie. Else a dof at a T-joint is on two Γ1s, has no multiplier, and
λ is constant beside it.
"""

from collections import defaultdict
from collections.abc import Sequence
from itertools import product

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.checks import name_of_tie
from hypergap_dolfinx.core.graph import PartsOf, components
from hypergap_dolfinx.errors import InterfaceError, InvertedCellError
from hypergap_dolfinx.interface_laws.coupling import Coupling
from hypergap_dolfinx.mortar.constraint import Multipliers, smooth_pieces
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.tolerances import NOISE, STRAIGHT
from hypergap_dolfinx.surface.trace import Surface
from hypergap_dolfinx.tie import Tie
from hypergap_dolfinx.tolerances import NEAR_PIECES, SAME_COST


class _Union(Tie):
    """Tie over the facets of several ties. These have issued the warnings already."""

    _tells = False


class Joined:
    """The interfaces of a problem's ties."""

    def __init__(self, ties: Sequence[Tie], *, align: bool = True):
        """Join ties to unions. Collective.

        Args:
            ties: The ties.
            align: True to exchange sides of ties where bodies meet on a smooth surface.

        Raises:
            ValueError: Something that isn't a tie.
        """
        wrong = [tie for tie in ties if not isinstance(tie, Tie)]
        if wrong:
            raise ValueError(
                f"ties has a {type(wrong[0]).__name__}: make each with Tie(side0, side1) first"
                f"{'; couplings go into couplings=' * isinstance(wrong[0], Coupling)}."
            )
        self.ties = list(ties)
        if align and any(tie._may_turn_over for tie in ties):
            _align(self.ties)
        self.interfaces: list[Tie] = []
        """Ties and unions, in the order of the first tie of each."""
        self._of: dict[int, tuple[int, npt.NDArray[np.intp] | None]] = {}
        """Interface number of each tie, and places of its multipliers in a union."""
        self.names: list[str] = []
        """Name of each interface in messages: numbers of its ties, bodies and facets."""
        for group in _groups(self.ties):
            whole, places = _union([self.ties[t] for t in group])
            if whole is None:
                for t in group:
                    self._of[t] = len(self.interfaces), None
                    self.interfaces.append(self.ties[t])
                    self.names.append(name_of_tie(f"tie {t}", self.ties[t]))
                continue
            for t, at in zip(group, places, strict=True):
                self._of[t] = len(self.interfaces), at
            self.interfaces.append(whole)
            numbers = f"ties {', '.join(map(str, group[:-1]))} and {group[-1]}"
            self.names.append(name_of_tie(numbers, whole))

    def destroy(self):
        """Destroy the PETSc objects of unions. Collective."""
        for tie in self.interfaces:
            if all(tie is not other for other in self.ties):
                tie.destroy()

    def turned_over(self, interface: int) -> "Joined | None":
        """Interfaces with Γ0 and Γ1 of one interface and its ties exchanged. Collective.

        Returns:
            The new interfaces; None unless :meth:`Tie.between` chose the sides of all its ties and
            no problem has them yet.
        """
        group = [tie for t, tie in enumerate(self.ties) if self._of[t][0] == interface]
        if not all(tie._may_turn_over for tie in group):
            return None
        if not all([tie._turn_over(": the other one is prescribed") for tie in group]):
            return None
        for tie in group:
            tie._settle()
        self.destroy()
        return Joined(self.ties, align=False)

    def settle(self):
        """Fix the sides of all ties."""
        for tie in self.ties:
            tie._settle()

    def find(self, tie) -> int:
        """Number of the interface that contains a tie.

        Raises:
            ValueError: A tie that isn't one of these.
        """
        return self._of[self._number(tie)][0]

    def of_piece(self, tie: Tie, multipliers: npt.NDArray) -> npt.NDArray:
        """Multipliers of a tie among those of its interface.

        Args:
            tie: The tie.
            multipliers: This rank's rows of its interface's, ``(num_multipliers, block_size)``.
        """
        places = self._of[self._number(tie)][1]
        return multipliers if places is None else multipliers[places]

    def _number(self, tie) -> int:
        """A tie's number among the ties."""
        t = next((t for t, other in enumerate(self.ties) if other is tie), None)
        if t is None:
            what = "the tie" if isinstance(tie, Tie) else f"a {type(tie).__name__}"
            raise ValueError(f"{what} is not one of this problem's ties: give one of problem.ties.")
        return t


def _align(ties: Sequence[Tie]):
    """Exchange sides so that a smooth surface is Γ1 of all its ties, or Γ0 of all. Collective.

    Of both ways for all ties that are related so, it is the one that exchanges less: areas, times
    the logarithm of the ratio of cell sizes or, where these are alike, of moduli. If both cost the
    same but for round-off, it is the one with fewer facets in Γ1. Sides that are given stay.
    """
    on_body: list[list[tuple[int, int]]] = []  # ties and sides
    for t, i in product(range(len(ties)), (0, 1)):
        if ties[t].free_interior or ties[t].discontinuous:
            continue
        mine = ties[t].components[i]
        for on in on_body:
            s, j = on[0]
            if mine.same(ties[s].components[j]):
                on.append((t, i))
                break
        else:
            on_body.append([(t, i)])
    pairs = np.array(
        [
            (on[a], on[b])
            for on in on_body
            for a, b in _connected([ties[t].surfaces[i] for t, i in on])
        ],
        dtype=np.intp,
    ).reshape(-1, 2, 2)
    # Vertices of a graph: a side of a tie as Γ1. Those of one component come together
    tie, side = np.moveaxis(pairs, 2, 0)
    first, second = np.concatenate((2 * tie + side, 2 * tie + 1 - side)).T
    label = components(2 * len(ties), first, second)
    for t in range(len(ties)):
        sides = np.flatnonzero(label == label[2 * t])
        if sides[0] != 2 * t or label[2 * t] == label[2 * t + 1] or (sides % 2 == 0).all():
            continue
        ways = [sides[sides % 2 == i] // 2 for i in (0, 1)]
        cost = [
            sum(
                ties[s].area * ties[s]._preference if ties[s]._may_turn_over else np.inf
                for s in way
            )
            for way in ways
        ]
        if min(cost) < np.inf:
            if np.isclose(cost[0], cost[1], rtol=SAME_COST, atol=0.0):
                cost = [sum(_more_facets(ties[s]) for s in way) for way in ways]
            for s in ways[int(np.argmin(cost))]:
                ties[s]._turn_over(", as in ties beside it")


def _more_facets(tie: Tie) -> int:
    """Facets that Γ0 has more than Γ1."""
    return len(tie.surfaces[0].facets) - len(tie.surfaces[1].facets)


def _connected(surfaces: Sequence[Surface]) -> list[tuple[int, int]]:
    """Pairs of surfaces of one body with a dof in common on one smooth piece."""
    if len(surfaces) < 2:
        return []
    pieces = smooth_pieces(surfaces)
    num = 1 + max(int(piece.max(initial=0)) for piece in pieces)
    keys = [
        np.unique(surface.dofs * num + piece[:, None])
        for surface, piece in zip(surfaces, pieces, strict=True)
    ]
    of, key = np.repeat(np.arange(len(keys)), list(map(len, keys))), np.concatenate(keys)
    order = np.argsort(key, kind="stable")
    of, key = of[order], key[order]
    pairs: set[tuple[int, int]] = set()
    ahead = 1
    while (same := key[ahead:] == key[:-ahead]).any():
        pairs.update(zip(of[:-ahead][same].tolist(), of[ahead:][same].tolist(), strict=True))
        ahead += 1
    return sorted(pairs)


def _groups(ties: Sequence[Tie]) -> list[list[int]]:
    """Groups of ties between the same bodies on one smooth piece of Γ1."""
    alike = defaultdict(list)
    for t, tie in enumerate(ties):
        # The first tie on the same spaces: each has collapsed a component by itself
        first = next(
            s
            for s, other in enumerate(ties)
            if all(map(Component.same, tie.components, other.components))
        )
        if not (tie.free_interior or tie.discontinuous):
            jump = tie.jump and tie.jump.key
            motion = tie.motion and tie.motion.key
            law = tie.closes_gap, tie.adjusts, jump, tie.gives_way, motion, tie.axisymmetric
            alike[first, law].append(t)
    pairs, parts_of = [], PartsOf()
    for same in alike.values():
        if len(same) < 2:
            continue
        same = [t for t in same if _is_near(ties[t])]
        sides = [_parts(ties[t], parts_of) for t in same] if len(same) > 1 else []
        pairs += [
            (same[i], same[j])
            for i, j in _connected([ties[t].surfaces[1] for t in same])
            if sides[i] == sides[j]
        ]
    i, j = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    label = components(len(ties), i, j)
    return [np.flatnonzero(label == k).tolist() for k in range(int(label.max(initial=-1)) + 1)]


def _is_near(tie: Tie) -> bool:
    """True if the sides are near enough for a common Σ. Collective."""
    length = max(surface.size.max(initial=0.0) for surface in tie.surfaces)
    return bool(tie.domain.distance() <= NEAR_PIECES * length)


def _parts(tie: Tie, parts_of: PartsOf) -> list[frozenset[int]]:
    """Connected parts of the bodies' meshes under a tie's sides. Collective."""
    return [
        parts_of(V, np.unique(surface.dofs))
        for V, surface in zip(tie.spaces, tie.surfaces, strict=True)
    ]


def _union(ties: Sequence[Tie]) -> tuple[Tie | None, list[npt.NDArray[np.intp]]]:
    """One tie over all facets. Collective.

    Returns:
        The union and, for each given tie, the rows of its multipliers in the union. None for a
        single tie, if a common Σ can't be made, or if the meshes have moved since the ties were
        made, which still tie the old positions.
    """
    if len(ties) == 1:
        return None, []
    sides = []
    for i in (0, 1):
        facets = np.unique(np.concatenate([tie.facets[i] for tie in ties])).astype(np.int32)
        sides.append((ties[0].components[i].given, facets))
    adjusts = all(tie.adjusts for tie in ties)
    try:
        first = ties[0]
        whole = _Union(
            *sides,
            close_gap=first.closes_gap,
            adjust=adjusts,
            jump=first.jump,
            motion=first.motion,
            axisymmetric=first.axisymmetric,
            **first._gives,
        )
    except (InterfaceError, InvertedCellError):  # the same on all ranks
        return None, []
    every = Multipliers.of(whole.constraint, whole.domain)
    places = [_places(tie, whole, every) for tie in ties]
    comm = whole.domain.comm
    failed = any(at is None for at in places)
    failed |= not adjusts and any(_has_moved(tie, whole) for tie in ties)
    if comm.allreduce(failed):
        whole.destroy()
        return None, []
    return whole, [at for at in places if at is not None]


def _has_moved(tie: Tie, whole: Tie) -> bool:
    """True if facets have moved since a tie was made."""
    for mine, now in zip(tie.surfaces, whole.surfaces, strict=True):
        a, b = mine.nodes, now.nodes[_facets_of_whole(mine, now)]
        if np.abs(a - b).max() > STRAIGHT * mine.size.max() + NOISE * np.abs(a).max():
            return True
    return False


def _facets_of_whole(mine: Surface, whole: Surface) -> list[int]:
    """Numbers of a tie's facets in the union; facets are identified by their dofs."""
    known = {row.tobytes(): f for f, row in enumerate(np.sort(whole.dofs, axis=1))}
    return [known[row.tobytes()] for row in np.sort(mine.dofs, axis=1)]


def _places(tie: Tie, whole: Tie, every: Multipliers) -> npt.NDArray[np.intp] | None:
    """This rank's rows of the union's multipliers at those of a tie; None if some are missing."""
    own = Multipliers.of(tie.constraint, tie.domain)
    at = np.full(len(own.dofs), -1, dtype=np.intp)
    facets = _facets_of_whole(own.surface, every.surface)
    for f, mine, dofs in zip(facets, own.on_facets, own.surface.dofs, strict=True):
        there = dict(zip(every.surface.dofs[f].tolist(), every.on_facets[f].tolist(), strict=True))
        for m, dof in zip(mine.tolist(), dofs.tolist(), strict=True):
            if m >= 0:
                at[m] = there[dof]
    if (at < 0).any():
        return None
    start, end = tie.constraint.R_A.getOwnershipRangeColumn()
    here = np.flatnonzero((start <= tie.constraint.rows) & (tie.constraint.rows < end))
    here = here[np.argsort(tie.constraint.rows[here])]
    return whole.constraint.rows[at[here]] - whole.constraint.R_A.getOwnershipRangeColumn()[0]
