# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Condensation of pressures at ends of contacts that ties, supports or other contacts hold."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import NEAR_ENDS, PARALLEL_ENDS
from hypergap_dolfinx.surface.trace import Surface, normals_by_area

HELD = "held"
"""Common node of everything that can't move."""


@dataclass(frozen=True)
class EndingSide:
    """A side of a contact or a tie."""

    space: Hashable
    """Function space of the dofs."""
    surface: Surface
    dofs: npt.NDArray[np.int64]
    """Dofs of the vertices, ``(num_vertices,)``."""
    held: npt.NDArray[np.bool_] | None = None
    """Mask of prescribed components of a contact's vertices, ``(num_vertices, n)``."""


Sides = tuple[EndingSide, EndingSide]


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


def condensations(contacts: Sequence[Sides], ties: Sequence[Sides]) -> list[npt.NDArray[np.intp]]:
    """Vertices of Γ1 to which others without a pressure of their own are condensed.

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
        normals = _vertex_normals(side.surface)
        for v in _ends(side.surface).tolist():
            if side.held is not None and side.held[v][np.abs(normals[v]) > PARALLEL_ENDS].all():
                places.join(_node(side, v), HELD)
    for sides in ties:
        for v1, v0 in _facing(sides):
            if v0 is not None:
                places.join(_node(sides[1], v1), _node(sides[0], v0))
    result = []
    for sides in contacts:
        normals, lost, found = _vertex_normals(sides[1].surface), [], []
        for v1, v0 in _facing(sides):
            node = _node(sides[1], v1)
            a = places.find(node)
            # Γ0 slides past, or is far away: then only another contact with it there counts
            b: Hashable = (sides[0].space, node if a == HELD else a)
            if v0 is not None:
                b = places.find(_node(sides[0], v0))
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


def _node(side: EndingSide, vertex: int) -> Hashable:
    return side.space, int(side.dofs[vertex])


def _vertex_normals(surface: Surface) -> npt.NDArray[np.float64]:
    """Unit normals at the vertices, ``(num_vertices, n)``."""
    normals = np.zeros_like(surface.x)
    for corner in surface.facets.T:
        np.add.at(normals, corner, normals_by_area(surface.x[surface.facets]))
    return normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]


def _ends(surface: Surface) -> npt.NDArray[np.intp]:
    """Vertices at a surface's boundary."""
    start, outline = surface.polygons, surface.is_outline
    if surface.gdim == 2:
        return np.unique(start[outline])
    return np.unique((start[outline], np.roll(start, -1, axis=1)[outline]))


def _facing(sides: Sides) -> list[tuple[int, int | None]]:
    """Ends of Γ1, each with the end of Γ0 at the same place or None."""
    surface0, surface1 = sides[0].surface, sides[1].surface
    size = np.zeros(len(surface1.x))
    for corner in surface1.facets.T:
        np.maximum.at(size, corner, surface1.size)
    ends0, found = _ends(surface0), []
    for v in _ends(surface1).tolist():
        distance = np.linalg.norm(surface0.x[ends0] - surface1.x[v], axis=1)
        near = len(ends0) > 0 and distance.min() <= NEAR_ENDS * size[v]
        found.append((v, int(ends0[distance.argmin()]) if near else None))
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
            if abs(n @ normal) > PARALLEL_ENDS and other not in seen
        ]
        seen.update(front)
    return False


def _neighbours(surface: Surface, lost: Sequence[int]) -> npt.NDArray[np.intp]:
    """Nearest vertex along the surface that isn't lost, for each that is; -1 for none."""
    result = np.arange(len(surface.x))
    if not lost:
        return result
    result[list(lost)] = -1
    beside: dict[int, set[int]] = {v: set() for v in lost}
    for facet in surface.facets[np.isin(surface.facets, lost).any(axis=1)].tolist():
        for v in beside.keys() & set(facet):
            beside[v].update(facet)
    left, before = list(lost), -1
    while left and len(left) != before:
        before, given = len(left), {}
        for v in left:
            around = [b for b in sorted(beside[v]) if result[b] >= 0]
            if around:
                away = np.linalg.norm(surface.x[around] - surface.x[v], axis=1)
                given[v] = result[around[int(away.argmin())]]
        result[list(given)] = list(given.values())
        left = [v for v in left if v not in given]
    return result
