# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Surfaces in space: neighbours, kinks, smooth pieces and boundary loops."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.core.compiled import call, doubles, ints
from hypergap_dolfinx.core.graph import components
from hypergap_dolfinx.errors import InterfaceError, NotFacingError
from hypergap_dolfinx.surface.nearest import nearest
from hypergap_dolfinx.surface.tolerances import (
    CORNER,
    CURVES,
    NOISE,
    OPPOSITE_COSINE,
    STANDS_OUT,
    TURN,
)
from hypergap_dolfinx.surface.trace import Surface, around, lengths


def neighbours(facets: npt.NDArray, name: str, x: npt.NDArray) -> npt.NDArray[np.int32]:
    """The facet behind each edge of each facet, −1 behind a boundary edge.

    Args:
        facets: Vertices of each facet in cyclic order, ``(num_facets, 3)`` or ``(num_facets, 4)``;
            edge k goes from vertex k to vertex k + 1.
        name: Name of the surface for messages.
        x: Vertex coordinates.

    Returns:
        Facet numbers, shaped as ``facets``.

    Raises:
        InterfaceError: More than two facets meet in an edge, or two of opposite orientation.
    """
    behind = np.empty(facets.shape, dtype=np.int32)
    if call("find_neighbours", len(x), *facets.shape, ints(facets), behind) == 0:
        return behind
    a, b = facets.ravel().astype(np.int64), np.roll(facets, -1, axis=1).ravel().astype(np.int64)
    key = 2 * (np.minimum(a, b) * len(x) + np.maximum(a, b)) + (a > b)
    order = np.argsort(key)
    key = key[order]
    twice = np.flatnonzero(key[1:] == key[:-1])
    if not len(twice):
        raise MemoryError("no memory for a surface's edges")
    at = order[twice[0]]
    place = spot(x[[a[at], b[at]]])
    if (key // 2 == key[twice[0]] // 2).sum() == 2:
        raise InterfaceError(
            f"{name} is folded at {place}: the two facets at an edge there have their bodies "
            "on opposite sides; are cells turned over?"
        )
    raise InterfaceError(
        f"{name} branches at {place}: more than two facets meet in an edge there (make one tie "
        "for each branch)."
    )


def edge_ends(surface: Surface, facet, k) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Vertices where edges k (modulo their number) of facets start and end."""
    polygons = surface.polygons
    num = polygons.shape[1]
    return polygons[facet, k % num], polygons[facet, (k + 1) % num]


def kinks(surface: Surface, behind: npt.NDArray[np.int32]):
    """Edges at which a surface has a kink: it turns there, and hardly beside it.

    Facets that approximate a smooth surface turn about as much at the next parallel edges. Curved
    ones turn inside: what counts is the angle between them where they meet. ``behind`` are the
    facets' neighbours.

    Returns:
        One of the two facets of each such edge, and the edge's local number there.
    """
    f, k = np.nonzero(behind > np.arange(len(behind))[:, None])
    g = behind[f, k]
    turn = _angles(surface.normals[f], surface.normals[g])
    bent = np.flatnonzero(surface.curved[f] | surface.curved[g])
    edges, beyond = (f[bent], k[bent]), (g[bent], (behind[g] == f[:, None]).argmax(axis=1)[bent])
    left = _angles(*(_normals_at_edges(surface, *each) for each in (edges, beyond)))
    smooth = np.zeros(len(f), dtype=bool)
    smooth[bent] = left <= CURVES * turn[bent]
    turn[bent] = left
    kink = np.empty(len(f), dtype=np.int32)
    facets = *behind.shape, ints(surface.polygons), ints(behind), turn
    limits = TURN, NOISE * np.abs(surface.x).max(), CORNER, STANDS_OUT
    if call("find_kinks", len(surface.x), doubles(surface.x), *facets, *limits, kink):
        raise MemoryError("no memory for a surface's corners")
    keep = (kink > 0) & ~smooth
    return f[keep], k[keep]


def _angles(n0, n1) -> npt.NDArray[np.float64]:
    """Angles between normals, ``(num,)``."""
    return np.arctan2(lengths(np.cross(n0, n1)), np.einsum("ei,ei->e", n0, n1))


def _normals_at_edges(surface: Surface, facet, k) -> npt.NDArray[np.float64]:
    """Normals of curved facets in the middle of their edges, ``(num_edges, 3)``."""
    if not len(facet):
        return np.empty((0, 3))
    corners = around(basix.geometry(surface.geometry.cell_type)[None])[0]
    X = (corners + np.roll(corners, -1, axis=0))[k] / 2
    derivatives = surface.geometry.tabulate(1, X)[1:, :, :, 0]
    return np.cross(*(np.einsum("ea,eai->ei", d, surface.nodes_of(facet)) for d in derivatives))


def _on_lines(surface: Surface, edges, other: Surface, other_edges) -> npt.NDArray[np.bool_]:
    """Mask of kinks on lines that run along kinks of the other surface somewhere.

    Such a line also separates pieces beyond the other surface's boundary.
    """
    (f, k), (g, m) = edges, other_edges
    first, last = edge_ends(surface, f, k)
    a, b = surface.x[first], surface.x[last]
    start, end = (other.x[end] for end in edge_ends(other, g, m))
    t = end - start
    length, square = np.linalg.norm(b - a, axis=1), (t**2).sum(axis=1)
    near = np.empty(len(f), dtype=bool)
    chunk = max(1, 2_000_000 // max(1, len(g)))
    for c in range(0, len(f), chunk):
        part = slice(c, c + chunk)
        middle = (a[part] + b[part])[:, None] / 2
        s = np.clip(np.einsum("eoi,oi->eo", middle - start, t) / square, 0, 1)
        distance = np.linalg.norm(start + s[..., None] * t - middle, axis=2)
        reach = 0.25 * np.maximum(length[part, None], np.sqrt(square))
        near[part] = (distance < reach).any(axis=1)
    line = components(len(surface.x), first, last)[first]
    return np.isin(line, line[near])


def facing_pieces(surfaces: tuple[Surface, Surface], behind):
    """Smooth pieces of both surfaces that lie opposite to each other.

    A piece ends at its surface's boundary and where both surfaces have a kink.

    Returns:
        Number of each facet's pair of pieces, for both surfaces.

    Raises:
        InterfaceError: The surfaces don't face each other.
    """
    lines = [kinks(surfaces[0], behind[0])]
    if len(lines[0][0]):  # else kinks of the other one don't matter
        lines.append(kinks(surfaces[1], behind[1]))
    pieces = []
    for i, surface in enumerate(surfaces):
        f, k = np.nonzero(behind[i] >= 0)
        joined = np.ones(behind[i].shape, dtype=bool)
        if len(lines) == 2 and len(lines[1][0]):
            on = _on_lines(surface, lines[i], surfaces[1 - i], lines[1 - i])
            e, m = (part[on] for part in lines[i])
            joined[e, m] = False
            g = behind[i][e, m]
            joined[g, np.argmax(behind[i][g] == e[:, None], axis=1)] = False
        keep = joined[f, k]
        pieces.append(components(len(surface.facets), f[keep], behind[i][f, k][keep]))
    # Each piece is paired with the one that most of it lies opposite to
    num = [int(p.max()) + 1 for p in pieces]
    pairs = []
    for i in (0, 1):
        piece, opposite = _opposite(surfaces[i], pieces[i], surfaces[1 - i])
        votes = np.zeros((num[i], num[1 - i]), dtype=int)
        np.add.at(votes, (piece, pieces[1 - i][opposite]), 1)
        own, theirs = np.arange(num[i]), votes.argmax(axis=1)
        pairs.append((own, num[0] + theirs) if i == 0 else (theirs, num[0] + own))
    group = components(sum(num), *(np.concatenate(part) for part in zip(*pairs, strict=True)))
    return group[: num[0]][pieces[0]], group[num[0] :][pieces[1]]


def spread(facets: npt.NDArray[np.intp], num: int = 64) -> npt.NDArray[np.intp]:
    """At most ``num`` of some facets, evenly spread over their numbers."""
    return facets[np.unique(np.linspace(0, len(facets) - 1, num).astype(np.intp))]


def _centres(surface: Surface, facets=slice(None)) -> npt.NDArray[np.float64]:
    """Means of the vertices of facets, ``(num_facets, 3)``."""
    v = surface.facets[facets]
    return sum(surface.x[v[:, k]] for k in range(v.shape[1])) / v.shape[1]


def _opposite(surface: Surface, pieces, other: Surface):
    """Sampled facets of each piece: their piece, and the other surface's facet opposite to them.

    Raises:
        InterfaceError: The outward normals agree, or the surfaces are far apart.
    """
    order = np.argsort(pieces, kind="stable")
    start = np.searchsorted(pieces[order], np.arange(pieces.max() + 2))
    samples = np.concatenate([spread(order[a:b]) for a, b in pairwise(start)])
    centres, middles = _centres(other), _centres(surface, samples)
    found = nearest(middles, centres)
    normals = surface.normals[samples]
    cosine = np.einsum("si,si->s", normals, other.normals[found])
    agree = cosine > 0
    for j in np.flatnonzero(cosine >= OPPOSITE_COSINE):  # prefer facets that face it
        turned = other.normals @ normals[j]
        penalty = np.where(turned < OPPOSITE_COSINE, 1, np.where(turned < 0, 4, 1e6))
        found[j] = (lengths(centres - middles[j]) * penalty).argmin()
    if agree.mean() > 0.5:
        raise InterfaceError(
            f"Γ0 and Γ1 don't face each other: their outward normals agree around {spot(middles)}; "
            "is one of them the wrong side of its body, or the same surface given twice?"
        )
    cosine = np.einsum("si,si->s", normals, other.normals[found])
    if (cosine > OPPOSITE_COSINE).all():
        angle = np.degrees(np.arccos(np.clip(-cosine.min(), -1, 1)))
        raise NotFacingError(
            f"Γ0 and Γ1 don't face each other: everywhere around {spot(middles)} they are "
            f"more than {angle:.0f}° from parallel; check the tags."
        )
    apart = middles - centres[found]
    off = lengths(apart).min()
    reach = np.linalg.norm(np.ptp(np.vstack((surface.x, other.x)), axis=0)) / 2
    if off > reach:
        x = {side.name: side.x for side in (surface, other)}
        raise NotFacingError(
            f"Γ0 and Γ1 don't face each other: they are {off:.3g} apart, Γ0 around "
            f"{spot(x['Γ0'])}, Γ1 around {spot(x['Γ1'])}; check the tags."
        )
    return pieces[samples], found


def loops(facets: npt.NDArray, behind: npt.NDArray, name: str, x: npt.NDArray):
    """Boundary loops: vertices in the direction of the facets' edges.

    Arguments are as of :func:`neighbours`, and its result ``behind``.

    Raises:
        InterfaceError: Two parts of the surface touch in one vertex only.
    """
    f, k = np.nonzero(behind < 0)
    if not len(f):
        return []
    start, end = facets[f, k], facets[f, (k + 1) % 3]
    count = np.bincount(start, minlength=len(x))
    if (count > 1).any():
        raise InterfaceError(
            f"{name} touches itself in a single vertex at {spot(x[count.argmax()])}; tie the parts "
            "there with ties of their own."
        )
    after = dict(zip(start.tolist(), end.tolist(), strict=True))
    found = []
    for first in start.tolist():
        loop, node = [], first
        while node in after:
            loop.append(node)
            node = after.pop(node)
        if loop:
            found.append(np.array(loop))
    return found
