# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Interfaces that end on a smooth surface of a third body.

Where an interface between two bodies ends on a smooth surface of a third one, λ on that surface is
one function. At a common node of the two bodies it has one multiplier. Elsewhere along the line (in
space) it is that of one body, which the other one follows, and the dofs there are left to the
interface that ends.
"""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.mortar.constraint import Multipliers, smooth_pieces
from hypergap_dolfinx.multipliers.numbering import Follows, Numbering, Pair
from hypergap_dolfinx.multipliers.tolerances import BESIDE_END
from hypergap_dolfinx.surface.trace import tabulate


class SmoothPieces:
    """Smooth pieces of the surfaces of bodies."""

    def __init__(self, numbering: Numbering):
        """Those of the ties' bodies."""
        self._numbering = numbering
        self._found: dict[int, dict[Pair, npt.NDArray[np.int32]]] = {}
        self._middles: dict[int, npt.NDArray[np.float64]] = {}  # of facets of Γ0

    def of(self, t: int, side: int) -> npt.NDArray[np.int32]:
        """Piece of each facet of a tie's side, numbered across all ties of its body."""
        bodies, ties = self._numbering.bodies, self._numbering.ties
        body = bodies[t][side]
        if body not in self._found:
            on = [(s, k) for s, pair in enumerate(bodies) for k in (0, 1) if pair[k] == body]
            pieces = smooth_pieces([ties[s].surfaces[k] for s, k in on])
            self._found[body] = dict(zip(on, pieces, strict=True))
        return self._found[body][t, side]

    def at(self, m: int, side: int) -> set[int]:
        """Pieces of a side at a multiplier; on Γ0 the nearest one."""
        t, (multipliers, local) = self._numbering.tie[m], self._numbering.local(m)
        facets = multipliers.facets_of(local)[0]
        if side == 0:
            if t not in self._middles:
                self._middles[t] = self._numbering.ties[t].domain.surfaces[0].nodes.mean(axis=1)
            away = self._middles[t] - multipliers.x[local]
            facets = np.einsum("fi,fi->f", away, away).argmin(keepdims=True)
        return set(self.of(t, side)[facets])


@dataclass
class Ends:
    """Interfaces that end on smooth surfaces."""

    between: Mapping[Pair, set[frozenset]] = field(default_factory=lambda: defaultdict(set))
    """Bodies of the interfaces that end at each place (body and dof)."""
    across: Follows = field(default_factory=dict)
    """For multipliers of a surface with dofs on Γ1 of an interface that ends there: those of the
    body across that interface, and weights with which they make λ."""


def find_ends(numbering: Numbering, users, mine, smooth: SmoothPieces) -> Ends:
    """Find the interfaces that end. Collective.

    An interface ends at a multiplier of another tie if the body across the interface is Γ1 of a
    tie to that tie's Γ0 there, on the same smooth piece.

    Args:
        numbering: The multipliers.
        users: Their :meth:`~.numbering.Numbering.users`.
        mine: Ties that have each of these as one multiplier.
        smooth: Smooth pieces.
    """
    ends = Ends()
    bodies = list(map(numbering.pair, range(len(numbering.ties)))) if users else []
    for m, others in users.items():
        t, x = numbering.tie[m], numbering.x([m])[0]
        for s, side in sorted(others):
            if side and s in mine[m]:
                continue
            wanted = bodies[t][0], bodies[s][1 - side]
            for r in (r for r, pair in enumerate(bodies) if pair == wanted and r != t):
                if not numbering.are_alike(t, r) or smooth.at(m, 0).isdisjoint(smooth.of(r, 0)):
                    continue
                found = _value_at(numbering.lists[r], x)
                if found is not None:
                    ends.between[numbering.place(m)].add(numbering.between(s))
                    if side:
                        ends.across.setdefault(m, (numbering.starts[r] + found[0], found[1]))
    return ends


def _value_at(multipliers: Multipliers, x: npt.NDArray):
    """Multipliers and weights for λ at a point; None if Γ1 is farther than :data:`BESIDE_END`."""
    surface = multipliers.surface
    element, dim = surface.element, surface.gdim - 1
    nearest = np.linalg.norm(multipliers.x - x, axis=1).argmin()
    near = multipliers.on_facets[multipliers.facets_of(nearest)[0]]
    around = [multipliers.facets_of(m)[0] for m in np.unique(near[near >= 0])]
    facets = np.unique(np.concatenate(around))
    facets = facets[(multipliers.on_facets[facets] >= 0).all(axis=1)]
    if not len(facets):
        return None
    X = np.full((len(facets), dim), 1 / (dim + 1))
    for _ in range(10):  # Gauss and Newton
        steps = np.einsum(
            "dpa,pai->pid",
            surface.geometry.tabulate(1, X)[1:, :, :, 0],
            surface.nodes_of(facets),
        )
        rest = (x - surface.points(facets, X))[:, :, None]
        X = np.clip(X + (np.linalg.pinv(steps) @ rest)[:, :, 0], 0, 1)
        if surface.facets.shape[1] == dim + 1:
            X /= np.maximum(X.sum(axis=1, keepdims=True), 1)
    apart = np.linalg.norm(x - surface.points(facets, X), axis=1)
    best = apart.argmin()
    if apart[best] > BESIDE_END * surface.size[facets[best]]:
        return None
    return multipliers.on_facets[facets[best]], tabulate(element, X[best : best + 1])[0]
