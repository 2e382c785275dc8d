# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pairs of pieces of two surfaces that face each other.

Faces of a body that turn away from the other one are left out, so whole boundaries can be tied.
Pieces are separated at a kink only if both sides have it at the same place: coarse facets of a wavy
surface have apparent kinks, at different places on each side. Separating there would give pieces
with different outlines inside of the surfaces, and gaps between them.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.compiled import call, doubles, ints
from hypergap_dolfinx.core.graph import components
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.surface.pieces import Side
from hypergap_dolfinx.surface.tolerances import CORNER, OPPOSITE_COSINE
from hypergap_dolfinx.surface.trace import Surface
from hypergap_dolfinx.surface.triangulation import facing_pieces, kinks, neighbours, spread
from hypergap_dolfinx.trimming.outlines import Rim
from hypergap_dolfinx.trimming.tolerances import BEHIND_FACET, NEARLY, OFF_OUTLINES

Groups = tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]
"""Number of each facet's pair of pieces, for both surfaces."""


def pairs_of_pieces(surface0: Surface, surface1: Surface):
    """Smooth pieces of both surfaces that lie opposite to each other.

    Returns:
        Number of each facet's pair of pieces, for both surfaces, where facets that turn away from
        the other side have the number of pairs; the number of pairs; and the facets' neighbours,
        for both.

    Raises:
        InterfaceError: The surfaces branch, touch themselves in a vertex or don't face each other.
    """
    surfaces = surface0, surface1
    behind = tuple(neighbours(s.polygons, s.name, s.x) for s in surfaces)
    keep = _facing(surfaces, behind)
    own0, own1 = (_restricted(*part) for part in zip(surfaces, behind, keep, strict=True))
    parts, between = (own0[0], own1[0]), (own0[1], own1[1])
    found = _join_unmatched(parts, facing_pieces(parts, between), between)
    num = int(found[1].max()) + 1
    groups = []
    for pair, kept in zip(found, keep, strict=True):
        groups.append(np.full(len(kept), num, dtype=np.int32))
        groups[-1][kept] = pair
    return groups, num, behind


def _restricted(surface: Surface, behind, keep):
    """The surface of some facets, and their neighbours among these."""
    if keep.all():
        return surface, behind
    number = np.full(len(keep) + 1, -1)  # and −1 of −1
    number[:-1][keep] = np.arange(keep.sum())
    part = replace(surface, facets=surface.facets[keep], own_nodes=surface.nodes_of(keep))
    return part, number[behind[keep]]


def _facing(surfaces: tuple[Surface, Surface], behind):
    """Masks of both surfaces' facets on faces of the body that face the other one.

    All are taken if neither surface has corners, or if no face is found.
    """
    faces = [_faces(*pair) for pair in zip(surfaces, behind, strict=True)]
    good = [np.zeros(face.max() + 1, dtype=bool) for face in faces]
    for i in (0, 1):
        if len(good[0]) == len(good[1]) == 1:
            good[i][:] = True
            continue
        own, other = surfaces[i], surfaces[1 - i]
        middles, centres = (s.x[s.facets].mean(axis=1) for s in (own, other))
        for face in range(len(good[i])):
            for j in spread(np.flatnonzero(faces[i] == face)):
                away = centres - middles[j]
                distance = np.linalg.norm(away, axis=1)
                distance[other.normals @ own.normals[j] >= OPPOSITE_COSINE] = np.inf
                k = int(distance.argmin())
                depth = BEHIND_FACET * max(own.size[j], other.size[k])
                if np.isfinite(distance[k]) and away[k] @ own.normals[j] > -depth:
                    good[i][face] = good[1 - i][faces[1 - i][k]] = True
    if not all(each.any() for each in good):
        return [np.ones(len(face), dtype=bool) for face in faces]
    return [each[face] for each, face in zip(good, faces, strict=True)]


def _faces(surface: Surface, behind) -> npt.NDArray[np.int32]:
    """Number of each facet's face between corners."""
    given = *behind.shape, ints(behind), doubles(surface.normals), np.cos(CORNER)
    if not call("has_corner", *given):
        return np.zeros(len(behind), dtype=np.int32)
    f, k = np.nonzero(behind > np.arange(len(behind))[:, None])
    sharp = np.einsum("ei,ei->e", surface.normals[f], surface.normals[behind[f, k]])
    sharp = sharp < np.cos(CORNER)
    corners = np.zeros(behind.shape, dtype=bool)
    corners[kinks(surface, behind)] = True
    joined = ~(sharp & corners[f, k])
    return components(len(behind), f[joined], behind[f, k][joined])


def _join_unmatched(
    surfaces: tuple[Surface, Surface], groups: Groups, behind: tuple[npt.NDArray, npt.NDArray]
) -> Groups:
    """Join pairs of pieces at kinks that the other side hasn't at the same place.

    Corners sharper than ``CORNER`` always separate pieces.
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
    """Pair of pieces beyond each edge of a piece's loop, −1 at boundaries and corners."""
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
    """Pairs of pieces to be joined: those beyond edges that the other side hasn't."""
    pair = int(groups[0][sides[0].facets[0]])
    rims: list[list[tuple[Rim, npt.NDArray]]] = []
    for side, group, own in zip(sides, groups, behind, strict=True):
        try:
            loops = side.loops()
        except InterfaceError:  # kinks make it touch itself in a vertex, if it hasn't before
            beyond = own[side.facets]
            touching = np.unique(group[beyond[beyond >= 0]])
            if not (touching != pair).any():
                raise
            return {(pair, int(g)) for g in touching if g != pair}
        own_rims = [Rim(side, loop) for loop in loops]
        rims.append(
            [(rim, _beyond(side, group, own, rim.ends[:, 0])[rim.edge]) for rim in own_rims]
        )
    found = set()
    for i in (0, 1):
        others = rims[1 - i]
        for rim, beyond in rims[i]:
            if not others or (beyond < 0).all():
                continue
            off, apart = np.full(len(rim.x), np.inf), np.zeros(len(rim.x), dtype=bool)
            for other, theirs in others:
                edge, s, distance, _, to_node = rim.off(other)
                before, after = np.roll(theirs, 1), np.roll(theirs, -1)
                inside = theirs[edge] >= 0  # not beside the other surface's boundary
                inside &= (s > 0) | (before[edge] >= 0)
                inside &= (s < 1) | (after[edge] >= 0)
                nearer = distance < off
                off[nearer] = distance[nearer]
                apart[nearer] = (inside & (distance > OFF_OUTLINES) & (to_node > NEARLY))[nearer]
            for j in np.flatnonzero(apart):
                found |= {(pair, int(g)) for g in (beyond[j - 1], beyond[j]) if g not in (-1, pair)}
    return found
