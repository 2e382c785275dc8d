# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Mesh repair: inverted cells of a front that got through are replaced.

:class:`MeshRepair` has three means, in this order: swaps of cells that share a face or an edge for
others that fill the same room (:func:`improve`), cones in place of cells, and straight edges.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap_mesh import cavity
from hypergap_dolfinx.gap_mesh.cavity import Place
from hypergap_dolfinx.gap_mesh.tetrahedra import FACES, NONE, straighten
from hypergap_dolfinx.gap_mesh.tolerances import AROUND_SWAPS, PARALLEL_RIMS
from hypergap_dolfinx.gap_mesh.walls import NO_WALLS, in_walls


@dataclass(frozen=True)
class Filling:
    """Cells between two surfaces."""

    mesh: cavity.Cells
    """The cells; interior vertices are numbered behind the others."""
    hosts: list[tuple]
    """Hosts of the interior vertices: α, facets on both sides and coordinates in them."""
    straight: npt.NDArray[np.integer] = field(default_factory=lambda: NONE)
    """Edges that are straight though the surfaces are curved, ``(num_edges, 2)``."""
    walls: npt.NDArray[np.integer] = field(default_factory=lambda: NO_WALLS)
    """Walls along the outlines, if the surfaces are curved, ``(num_walls, 3)``."""

    @property
    def cells(self) -> npt.NDArray[np.integer]:
        """``(num_cells, 4)``."""
        return self.mesh.cells

    def with_cells(self, cells) -> "Filling":
        """Other cells between the same vertices."""
        return replace(self, mesh=replace(self.mesh, cells=cells))


Margins = Callable[[Filling], npt.NDArray[np.float64]]
"""Distance of cells from inversion, not positive where a cell is inverted somewhere."""


@dataclass
class MeshRepair:
    """Repair of cells in a closed room between two surfaces and their walls."""

    outer: npt.NDArray[np.integer]
    """The room's boundary: triangles, counterclockwise seen from inside."""
    place: Place
    margins: Margins | None
    """None if surfaces are straight."""
    along: Callable[[npt.NDArray[np.integer]], npt.NDArray[np.integer]]
    """The function that selects walls along the outlines."""

    def num_bad(self, filling: Filling) -> int:
        """Number of inverted cells."""
        return int((self.margins(filling) <= 0).sum()) if self.margins else 0

    def coned(self, filling: Filling, gone=None) -> Filling | None:
        """The filling with cones where cells are missing or, by a mask, taken away; or None."""
        if gone is not None:
            filling = filling.with_cells(filling.cells[~gone])
        made = cavity.fill(filling.mesh, self.outer, self.place)
        if made is None or not cavity.is_whole(made[0].cells, self.outer):
            return None
        return replace(filling, mesh=made[0], hosts=filling.hosts + made[1])

    def swapped(self, filling: Filling) -> Filling:
        """The filling with inverted cells swapped for others."""
        margins = self.margins
        if margins is None:
            return filling
        mesh = filling.mesh

        def upright(cells):  # simplices of vertices too: else straight edges don't help
            flat = filling.with_cells(cells).mesh.flat()
            values = np.full(len(cells), -np.inf)
            values[~flat] = margins(filling.with_cells(cells[~flat]))
            return values

        cells = improve(mesh.cells, mesh.alpha, upright)
        whole = cells is mesh.cells or cavity.is_whole(cells, self.outer)
        return filling.with_cells(cells) if whole else filling

    def refilled(self, filling: Filling) -> Filling:
        """The filling with cones in place of inverted cells, while that leaves fewer of them.

        (A cell between two edges that are parallel up to their curvature may be inverted though the
        simplex of its vertices isn't.)
        """
        margins = self.margins
        if margins is None:
            return filling
        filling = self.peeled(filling)
        bad = margins(filling) <= 0
        while bad.any() and (made := self.coned(filling, bad)):
            made = self.swapped(made)
            left = margins(made) <= 0
            if left.sum() >= bad.sum():
                break
            filling, bad = made, left
        return filling

    def peeled(self, filling: Filling) -> Filling:
        """The filling without cells that are as thin as walls are bent: walls replace them."""
        assert self.margins
        found = bool(self.num_bad(filling))
        while found:
            found = False
            gone = (self.margins(filling) <= 0) | filling.mesh.flat(PARALLEL_RIMS)
            gone &= (filling.mesh.alpha[filling.cells] == 0).sum(axis=1) == 2
            for i in np.flatnonzero(gone)[::-1]:
                faces = filling.cells[i][FACES]
                on = in_walls(faces, filling.walls)
                fresh = self.along(faces[~on]) if on.sum() == 2 else NO_WALLS
                if len(fresh) == 2:
                    left = [w[~in_walls(w, faces[on])] for w in (filling.walls, self.outer)]
                    walls, self.outer = (np.vstack((w, fresh)) for w in left)
                    filling = filling.with_cells(np.delete(filling.cells, i, axis=0))
                    filling = replace(filling, walls=walls)
                    found = True
        return filling

    def straightened(self, filling: Filling) -> Filling:
        """The filling with straight edges in inverted cells."""
        margins = self.margins
        if margins is None:
            return filling

        def with_straight(cells, edges):
            return margins(replace(filling.with_cells(cells), straight=edges))

        edges = straighten(filling.cells, filling.mesh.alpha, with_straight)
        return replace(filling, straight=edges)


Cell = tuple[int, ...]
Swap = tuple[tuple[int, ...], list[Cell]]
"""Numbers of the old cells, and the new cells."""


def improve(
    cells: npt.NDArray[np.integer],
    alpha: npt.NDArray[np.float64],
    margins: Callable[[npt.NDArray[np.integer]], npt.NDArray[np.float64]],
) -> npt.NDArray[np.integer]:
    """Swap cells whose margin isn't positive for others, as long as the worst get better.

    Returns:
        The cells, of which none is worse than the worst that it replaces.
    """
    value = margins(cells)
    while True:  # it ends: each round replaces cells with better ones
        bad = np.flatnonzero(value <= 0)
        swaps = list(_swaps(cells, alpha, bad)) if len(bad) else []
        if not swaps:
            break
        num = np.array([len(new) for _, new in swaps])
        made = margins(np.array([cell for _, new in swaps for cell in new]))
        least = np.minimum.reduceat(made, np.cumsum(num) - num)
        before = np.array([value[list(old)].min() for old, _ in swaps])
        gone, come = np.zeros(len(cells), dtype=bool), []
        # Whole cures first, then what helps most
        for i in np.lexsort((before - least, least <= 0)):
            old, new = swaps[i]
            if least[i] > before[i] and not gone[list(old)].any():
                gone[list(old)] = True
                start = num[:i].sum()
                come.append((new, made[start : start + num[i]]))
        if not come:
            break
        cells = np.vstack((cells[~gone], *(new for new, _ in come)))
        value = np.concatenate((value[~gone], *(each for _, each in come)))
    return cells


def _swaps(cells, alpha, bad) -> Iterator[Swap]:
    """All swaps of some cells with their neighbours."""
    near = np.flatnonzero(np.isin(cells, cells[bad]).sum(axis=1) >= 2)
    around: dict[frozenset, list[int]] = defaultdict(list)  # cells at an edge or a face
    corners = {int(c): cells[c].tolist() for c in near}
    for c, v in corners.items():
        for i in range(4):
            around[frozenset(v[:i] + v[i + 1 :])].append(c)
            for j in range(i):
                around[frozenset((v[i], v[j]))].append(c)
    seen = set()
    for c in bad.tolist():
        v = corners[c]
        for i in range(4):
            face = frozenset(v[:i] + v[i + 1 :])
            if face not in seen and len(around[face]) == 2:
                seen.add(face)
                yield from _of_face(face, around[face], corners, alpha)
            for j in range(i):
                edge = frozenset((v[i], v[j]))
                if edge not in seen and 3 <= len(around[edge]) <= AROUND_SWAPS:
                    seen.add(edge)
                    yield from _of_edge(v[i], v[j], around[edge], corners, alpha)


def _may_be_edge(a: int, b: int, alpha) -> bool:
    """True if an inner edge of Σ is admissible: between both sides, or to a vertex between them."""
    return alpha[a] != alpha[b] or 0 < alpha[a] < 1


def _of_face(face, pair, corners, alpha) -> Iterator[Swap]:
    """Two cells become three around a new edge."""
    a, b = (sum(corners[c]) - sum(face) for c in pair)
    if a == b or not _may_be_edge(a, b, alpha):
        return
    c, d, e = face
    if _is_odd((c, d, e, b), corners[pair[1]]):
        c, d = d, c
    yield tuple(pair), [(a, b, c, d), (a, b, d, e), (a, b, e, c)]


def _of_edge(a, b, ring, corners, alpha) -> Iterator[Swap]:
    """The n cells around an edge become 2 (n − 2) without it, for each way to cut the polygon."""
    following = {}
    for cell in ring:
        c, d = (v for v in corners[cell] if v not in (a, b))
        if _is_odd((a, b, c, d), corners[cell]):
            c, d = d, c
        following[c] = d
    polygon = [c]
    while (d := following.get(polygon[-1])) is not None and d != polygon[0]:
        if len(polygon) == len(ring):
            return
        polygon.append(d)
    if d is None or len(polygon) < len(ring):  # at the boundary
        return
    n = len(polygon)
    may = {(i, j): _may_be_edge(polygon[i], polygon[j], alpha) for j in range(n) for i in range(j)}
    for numbers, diagonals in _triangulations(n):
        if all(may[ends] for ends in diagonals):
            triangles = [(polygon[i], polygon[j], polygon[k]) for i, j, k in numbers]
            above = [(c, d, e, b) for c, d, e in triangles]
            yield tuple(ring), above + [(d, c, e, a) for c, d, e in triangles]


@cache
def _triangulations(n: int) -> list[tuple[list[Cell], list[tuple[int, int]]]]:
    """All triangulations of a polygon, each triangle oriented like it, and their inner edges."""

    def cuts(first: int, last: int) -> Iterator[list[Cell]]:
        if last - first < 2:
            yield []
        for k in range(first + 1, last):  # the triangle at the edge from the last to the first
            for left in cuts(first, k):
                for right in cuts(k, last):
                    yield [(first, k, last), *left, *right]

    found = []
    for triangles in cuts(0, n - 1):
        edges = {ends for i, j, k in triangles for ends in ((i, j), (j, k), (i, k))}
        found.append((triangles, sorted((i, j) for i, j in edges if 1 < j - i < n - 1)))
    return found


def _is_odd(v, w) -> bool:
    """True if an odd permutation makes one cell of another with the same vertices."""
    at = [w.index(i) for i in v]
    return sum(at[i] > at[j] for i in range(4) for j in range(i + 1, 4)) % 2 == 1
