# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Condensation of pressures at ends of contacts that ties, supports or other contacts hold."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import SAME_END
from hypergap_dolfinx.surface.moving import MovingSurface
from hypergap_dolfinx.surface.trace import Surface

HELD = "held"
"""Common node of everything that can't move."""


@dataclass(frozen=True)
class EndingSide:
    """A side of a contact or a tie."""

    space: int
    """Number of its function space."""
    moving: MovingSurface
    held: npt.NDArray[np.bool_] | None = None
    """Mask of prescribed components of a contact's dofs, ``(num_dofs, n)``."""

    @property
    def surface(self) -> Surface:
        """The undeformed surface."""
        return self.moving.reference

    def node(self, vertex: int) -> Hashable:
        """Node at a vertex."""
        return self.space, int(self.moving.vertex_dofs[vertex])

    def is_held(self, vertex: int, normal: npt.NDArray[np.float64]) -> bool:
        """True if the displacement along a normal is prescribed at a vertex."""
        if self.held is None:
            return False
        at = np.searchsorted(self.moving.dofs, self.moving.vertex_dofs[vertex])
        return bool(np.linalg.norm(normal[~self.held[at]]) <= SAME_END)


Ends = Sequence[EndingSide]


class _Places:
    """Classes of nodes that move as one, by ties or because they are held (union-find)."""

    def __init__(self) -> None:
        self._parent: dict[Hashable, Hashable] = {}

    def find(self, node: Hashable) -> Hashable:
        while (parent := self._parent.get(node, node)) != node:
            node = parent
        return node

    def join(self, a: Hashable, b: Hashable):
        self._parent[self.find(a)] = self.find(b)


def condensations(contacts: Sequence[Ends], ties: Sequence[Ends]) -> list[npt.NDArray[np.intp]]:
    """Vertices of Γ1 that carry the pressures of others, which have none of their own.

    At the end of a contact the gap may be held already: both bodies are tied or prescribed there,
    or another contact with the same normal ends there between the same bodies. A pressure of its
    own would make the system singular on matching meshes. The vertex shares that of its neighbour,
    so that no part of the surface loses its pressure.

    Args:
        contacts: Γ0 and Γ1 of each contact.
        ties: Γ0 and Γ1 of each tie.

    Returns:
        For each contact the vertex that carries each vertex's pressure, ``(num_vertices,)``; -1 if
        all of the surface is held.
    """
    places = _Places()
    along: dict[Hashable, list[tuple[Hashable, npt.NDArray]]] = {}
    for side in (side for sides in contacts for side in sides):
        normals = side.surface.vertex_normals
        for v in np.flatnonzero(side.surface.at_end).tolist():
            if side.is_held(v, normals[v]):
                places.join(side.node(v), HELD)
    for sides in ties:
        for v1, v0 in _facing(sides):
            if v0 is not None:
                places.join(sides[1].node(v1), sides[0].node(v0))
    result = []
    for sides in contacts:
        normals, lost, found = sides[1].surface.vertex_normals, [], []
        for v1, v0 in _facing(sides):
            node = sides[1].node(v1)
            a = places.find(node)
            # Γ0 slides past, or is far away: then only another contact with it there counts
            b: Hashable = (sides[0].space, node if a == HELD else a)
            if v0 is not None:
                b = places.find(sides[0].node(v0))
            if sides[0].held is not None and sides[0].held.all():
                b = HELD
            if _connected(a, b, normals[v1], along):
                lost.append(v1)
            found.append((a, b, normals[v1]))
        for a, b, normal in found:
            along.setdefault(a, []).append((b, normal))
            along.setdefault(b, []).append((a, normal))
        result.append(_neighbours(sides[1].surface, lost))
    return result


def _facing(sides: Ends) -> list[tuple[int, int | None]]:
    """Ends of Γ1, each with the nearer end of the edge of Γ0's boundary that is beside it, or None.

    In space nodes lie between each other along an edge that both sides share.
    """
    surface0, surface1 = sides[0].surface, sides[1].surface
    edges, found = surface0.outline, []
    start, way = surface0.x[edges[:, 0]], np.diff(surface0.x[edges], axis=1)[:, 0]
    square = np.maximum((way**2).sum(axis=1), 1e-300)
    for v in np.flatnonzero(surface1.at_end).tolist():
        off = surface1.x[v] - start
        share = np.clip((off * way).sum(axis=1) / square, 0, 1)
        distance = np.linalg.norm(off - share[:, None] * way, axis=1)
        near = len(edges) > 0 and distance.min() <= SAME_END * surface1.vertex_sizes[v]
        k = distance.argmin() if near else 0
        found.append((v, int(edges[k, int(share[k] > 0.5)]) if near else None))
    return found


def _connected(a: Hashable, b: Hashable, normal, along) -> bool:
    """True if contacts with that normal connect two nodes."""
    seen, front = {a}, [a]
    while front:
        if b in seen:
            return True
        front = [
            other
            for node in front
            for other, n in along.get(node, ())
            if 1 - (n @ normal) ** 2 <= SAME_END**2 and other not in seen
        ]
        seen.update(front)
    return False


def _neighbours(surface: Surface, lost: Sequence[int]) -> npt.NDArray[np.intp]:
    """Nearest vertex along the surface that isn't lost, for each that is; -1 for none."""
    result = np.arange(len(surface.x))
    if not len(lost):
        return result
    result[lost] = -1
    facets, num = surface.facets, surface.facets.shape[1]
    i, j = np.repeat(facets, num, axis=1).ravel(), np.tile(facets, num).ravel()
    # The nearest one comes last, and so overwrites others
    order = np.lexsort((-j, -np.linalg.norm(surface.x[i] - surface.x[j], axis=1)))
    i, j = i[order], j[order]
    while (use := (result[i] < 0) & (result[j] >= 0)).any():
        result[i[use]] = result[j[use]]
    return result
