# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Pieces that part at a kink only if both sides have it at one place.

Coarse facets of a wavy surface look kinked here and there, on each side elsewhere. What would be
parted there has outlines that differ inside of the surfaces, and room between them that no piece
has.
"""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.outlines import NEARLY, OFF, Rim
from hypergap_dolfinx.gap.pieces import Side
from hypergap_dolfinx.gap.surface import Surface
from hypergap_dolfinx.gap.triangulation import CORNER
from hypergap_dolfinx.graph import components

Groups = tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]
"""The number of the pair of pieces that each facet belongs to, for both surfaces."""


def join_unmatched(
    surfaces: tuple[Surface, Surface], groups: Groups, behind: tuple[npt.NDArray, npt.NDArray]
) -> Groups:
    """Join pairs of pieces at kinks of one side that lie beside those of the other one.

    Corners that are sharper than ``triangulation.CORNER`` part pieces in any case.

    Args:
        surfaces: Γ0 and Γ1.
        groups: As of ``triangulation.facing_pieces``.
        behind: The facets' neighbours.

    Returns:
        The pairs of pieces that are left.
    """
    while (num := int(groups[1].max()) + 1) > 1:
        pairs = [
            pair
            for g in range(num)
            for pair in _unmatched(
                [
                    Side.of(s, np.flatnonzero(own == g), behind=b)
                    for s, own, b in zip(surfaces, groups, behind, strict=True)
                ],
                groups,
                behind,
            )
        ]
        if not pairs:
            break
        joined = components(num, *np.array(pairs).T)
        groups = joined[groups[0]], joined[groups[1]]
    return groups


def _beyond(side: Side, group, behind, loop) -> npt.NDArray[np.intp]:
    """The pair of pieces beyond each edge of a loop: −1 at the surface's boundary and at corners.

    Args:
        side: A piece of whole facets.
        group: Of each facet of the surface.
        behind: The facets' neighbours.
        loop: Vertices of the piece.

    Returns:
        ``(num_edges,)``.
    """
    surface, mine = side.surface, np.unique(side.facets)
    vertex = np.unique(surface.facets[mine])[loop].astype(np.int64)
    polygons = surface.polygons[mine].astype(np.int64)
    n = len(surface.x)
    key = (polygons * n + np.roll(polygons, -1, axis=1)).ravel()
    order = np.argsort(key)
    at = order[np.searchsorted(key[order], vertex * n + np.roll(vertex, -1))]
    f, g = mine[at // polygons.shape[1]], behind[mine].ravel()[at]
    sharp = np.einsum("ei,ei->e", surface.normals[f], surface.normals[g]) < np.cos(CORNER)
    return np.where((g < 0) | sharp, -1, group[g])


def _unmatched(sides: list[Side], groups: Groups, behind) -> set[tuple[int, int]]:
    """Pairs of pieces to be joined with one, which lie beyond edges that the other side hasn't."""
    rims: list[list[tuple[Rim, npt.NDArray]]] = []
    for side, group, neighbours in zip(sides, groups, behind, strict=True):
        loops = side.loops()
        rims.append([(Rim(side, loop), _beyond(side, group, neighbours, loop)) for loop in loops])
    own = int(groups[0][sides[0].facets[0]])
    found = set()
    for i in (0, 1):
        others = rims[1 - i]
        for rim, beyond in rims[i]:
            if not others or (beyond < 0).all():
                continue
            off, least = np.full(len(rim.x), np.inf), np.zeros(len(rim.x), dtype=bool)
            for other, theirs in others:
                edge, s, distance, _, to_node = rim.off(other)
                before, after = np.roll(theirs, 1), np.roll(theirs, -1)
                inside = theirs[edge] >= 0  # not beside the other surface's boundary
                inside &= (s > 0) | (before[edge] >= 0)
                inside &= (s < 1) | (after[edge] >= 0)
                nearer = distance < off
                off[nearer] = distance[nearer]
                least[nearer] = (inside & (distance > OFF) & (to_node > NEARLY))[nearer]
            for j in np.flatnonzero(least):
                found |= {(own, int(g)) for g in (beyond[j - 1], beyond[j]) if g >= 0}
    return found
