# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tetrahedra between two triangulated surfaces, by an advancing front of flips (``front.c``).

:func:`construct` tries fronts in several orders (`VARIANTS`), and has the best result mended
(:mod:`.repair`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.compiled import call, ints
from hypergap_dolfinx.gap_mesh import cavity
from hypergap_dolfinx.gap_mesh.cavity import Place
from hypergap_dolfinx.gap_mesh.prisms import Prisms, between_quarters, outer_faces, twins
from hypergap_dolfinx.gap_mesh.repair import Filling, Margins, MeshRepair
from hypergap_dolfinx.gap_mesh.tetrahedra import areas, single_faces
from hypergap_dolfinx.gap_mesh.tolerances import (
    CELLS,
    EXTRAPOLATE,
    FLAT_GAP_CELL,
    LEAN,
    LEFT,
    SHIFT,
    SWEEP,
    SWEEPS,
    SWEPT,
    THIN_CELL,
)
from hypergap_dolfinx.gap_mesh.walls import WallRim, along, rims
from hypergap_dolfinx.surface.pieces import Side

GENERIC = np.array((0.5377, 0.6819, 0.4961))  # no mesh has edges or planes in this direction
VARIANTS = (
    *((True, False, 1.0), (True, True, 1.0), (False, False, 1.0), (False, True, 1.0)),
    *((False, False, 1e-8), (False, True, 1e-8)),
)
"""True if with weights, true if from Γ1 to Γ0, and the share of the displacement of each attempt:
the first front that gets through is taken. Cut facets may be narrower than a displacement."""


@dataclass(frozen=True)
class Problem:
    """Two surfaces between which cells are sought; vertices are Γ0's, then Γ1's."""

    x: npt.NDArray[np.float64]
    """Vertex coordinates, ``(num_vertices, 3)``."""
    n0: int
    """Number of Γ0's vertices."""
    facets: tuple[npt.NDArray[np.integer], npt.NDArray[np.integer]]
    """Facets of both sides, counterclockwise seen from Γ1: ``(num_facets, 3)`` each."""
    sides: tuple[Side, Side]
    """The surfaces."""
    normals: npt.NDArray[np.float64]
    """Unit normals of the vertices, from Γ0 to Γ1."""
    rims: list[WallRim]
    """Pairs of facing boundaries; empty for closed surfaces."""
    curved: bool = False
    """True if a side is curved."""

    @classmethod
    def between(cls, side0: Side, side1: Side) -> "Problem":
        """The problem for two facing pieces.

        Raises:
            InterfaceError: Their boundaries don't match.
        """
        n0 = len(side0.x)
        facets = side0.triangles, np.int32(n0) + side1.triangles[:, ::-1]
        normals = np.vstack((side0.vertex_normals, -side1.vertex_normals))
        x = np.vstack((side0.x, side1.x))
        curved = any(side.surface.curved[side.facets].any() for side in (side0, side1))
        return cls(x, n0, facets, (side0, side1), normals, rims(side0, side1), curved)

    def edges(self, number: npt.NDArray[np.int32], reverse: bool) -> npt.NDArray[np.int32]:
        """Inner edges: ends q and r, p on their left and s on their right, ``(num_edges, 4)``.

        And two edges of the boundary: a, b, c, −1. Sorted by the first vertex.

        Args:
            number: Numbers of the vertices in the result.
            reverse: True if they are seen from the other side.
        """
        own = number[: self.n0], number[self.n0 :]
        edges = [side.inner_edges(at) for side, at in zip(self.sides, own, strict=True)]
        turned = edges[0 if reverse else 1]
        turned[:, :2] = turned[:, 1::-1]
        for rim in self.rims:
            for loop, at in zip(rim.nodes, own, strict=True):
                three = (np.roll(at[loop], -k) for k in range(3))
                edges.append(np.column_stack((*three, np.full(len(loop), -1, dtype=np.int32))))
        every = np.vstack(edges)
        return every[np.argsort(every[:, 0], kind="stable")]

    @cached_property
    def size(self) -> float:
        """Length of the finer side's edges, in the mean."""
        means = []
        for facets in self.facets:
            edge = self.x[facets[:, 1]] - self.x[facets[:, 0]]
            means.append(np.sqrt(np.einsum("fi,fi->f", edge, edge)).mean())
        return float(min(means))

    @cached_property
    def order(self) -> npt.NDArray[np.intp]:
        """The vertices of Γ0 and then those of Γ1, each along a curve that fills space.

        Neighbours in space are then neighbours in memory, which decides about the speed of large
        meshes.
        """
        low = self.x.min(axis=0)
        grid = ((self.x - low) * (1023 / max(np.ptp(self.x), 1e-300))).astype(np.int64)
        code = _spread(grid[:, 0]) + (_spread(grid[:, 1]) << 1) + (_spread(grid[:, 2]) << 2)
        code[self.n0 :] += 1 << 30
        return np.argsort(code, kind="stable")

    @cached_property
    def shift(self) -> npt.NDArray[np.float64]:
        """Displacement of Γ1 that makes the order of the front's moves unique.

        Parallel edges stay parallel, which decides about all cells between two edges: the
        displacement is constant on a closed surface and a dilation of an open one, so that its
        walls lean outwards. Where a wall would still lean inwards, as in a hole, its rim is moved.
        """
        shift = np.tile(GENERIC, (len(self.x) - self.n0, 1))
        if not self.rims:
            return SHIFT * self.size * shift
        x, normal = self.x[self.n0 :], self.normals[self.n0 :]
        outwards, reach = self._outwards
        shift = outwards / reach + 0.1 * GENERIC
        for rim in self.rims:
            nodes = rim.nodes[1]
            edge = np.roll(x[nodes], -1, axis=0) - x[nodes]
            edge /= np.maximum(np.linalg.norm(edge, axis=1, keepdims=True), 1e-300)
            conormal = np.cross(edge + np.roll(edge, 1, axis=0), normal[nodes])
            conormal /= np.maximum(np.linalg.norm(conormal, axis=1, keepdims=True), 1e-300)
            leans = np.einsum("vi,vi->v", shift[nodes], conormal)
            shift[nodes] += np.maximum(LEAN - leans, 0)[:, None] * conormal
        return SHIFT * self.size * shift

    @cached_property
    def _outwards(self) -> tuple[npt.NDArray[np.float64], float]:
        """Vectors to Γ1's vertices from their middle, and the length of the longest."""
        outwards = self.x[self.n0 :] - self.x[self.n0 :].mean(axis=0)
        return outwards, float(np.sqrt(np.einsum("vi,vi->v", outwards, outwards).max()))

    @cached_property
    def prisms(self) -> Prisms:
        """Cells between facets and their twins, as valid as those of a front."""
        x0, x1, (facets0, facets1) = self.x[: self.n0], self.x[self.n0 :], self.facets
        pairs = twins(x0, facets0, x1, facets1 - self.n0, self.size)
        height = self.x[self.n0 :] @ GENERIC
        if self.rims:  # what the shift is the gradient of, so that both agree about edges
            outwards, reach = self._outwards
            height = np.einsum("vi,vi->v", outwards, outwards) / (2 * reach) + 0.1 * height
        alpha = (np.arange(len(self.x)) >= self.n0).astype(float)

        def are_valid(cells):
            D, scale = areas(self.x, alpha, self.normals, cells)
            return D > FLAT_GAP_CELL * scale

        return Prisms.between(pairs, self.n0, height, are_valid)

    def walls(self, shift, weights) -> npt.NDArray[np.intp]:
        """Side walls, counterclockwise seen from inside, with Γ1 displaced."""
        found = [rim.walls(self.n0, shift, weights)[:, ::-1] for rim in self.rims]
        return np.vstack(found) if found else np.empty((0, 3), dtype=np.intp)

    def along(self, walls: npt.NDArray[np.integer]) -> npt.NDArray[np.integer]:
        """Those of some walls, ``(num_walls, 3)``, that lie along the outlines."""
        return along(walls, self.x, self.n0, self.rims)


def _spread(a: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Two zeros between the bits of ten-bit numbers."""
    for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
        a = (a | (a << shift)) & mask
    return a


@dataclass(frozen=True)
class Front:
    """Cells that a front has made."""

    cells: npt.NDArray[np.integer]
    """``(num_cells, 4)``."""
    walls: npt.NDArray[np.integer]
    """Side walls, counterclockwise seen from inside, ``(num_walls, 3)``."""
    left: int
    """Number of its last triangles that are no facets of the surface where it ends, but lie at
    cavities."""
    wrong: tuple[int, int]
    """Number of cells that are flat or inverted, and of faces that don't have one cell or a cavity
    on each side; not counted where many triangles are left."""

    @property
    def is_valid(self) -> bool:
        """True if the cells are valid, and nothing is missing."""
        return self.left == 0 and not any(self.wrong)

    @property
    def is_through(self) -> bool:
        """True if the cells are valid, and hardly anything is missing."""
        return self.left <= LEFT * len(self.cells) and not any(self.wrong)


def advance(
    problem: Problem,
    weighted: bool,
    reverse: bool,
    share: float = 1.0,
    flat: float = FLAT_GAP_CELL,
    prisms: Prisms | None = None,
) -> Front:
    """Let a front run from one surface to the other.

    Args:
        problem: The surfaces.
        weighted: True if weights make the surfaces' edges locally regular.
        reverse: True if it goes from Γ1 to Γ0.
        share: Displacement of Γ1 over the problem's shift.
        flat: D over its scale up to which a cell is avoided.
        prisms: Cells between some of the facets; the front runs in the room that they leave.
    """
    x, n, n0, shift = problem.x, len(problem.x), problem.n0, share * problem.shift
    n1, sign = n - n0, -1 if reverse else 1
    order = problem.order
    if reverse:
        order = np.concatenate((order[n0:], order[:n0]))
    number = np.empty(n, dtype=np.int32)  # in the front's order: where it starts, where it ends
    number[order] = np.arange(n, dtype=np.int32)
    vertices = np.zeros((n, 10))
    y = x - x.mean(axis=0)
    vertices[:, :3] = y[order]
    y[n0:] += sign * shift
    vertices[:, 3:6] = y[order]
    del y  # a front takes much memory
    vertices[:, :6] /= problem.size
    vertices[:, 6:9] = sign * problem.normals[order]
    turned = slice(None) if not reverse else [1, 0, 2]
    facets = prisms.left(problem.facets) if prisms else problem.facets
    if prisms and not any(len(part) for part in facets):
        outer = np.vstack((problem.facets[0], problem.facets[1][:, ::-1]))
        faces, num = single_faces(prisms.cells, outer)
        is_whole = num == len(faces) and bool(_are_walls(faces, n0).all())
        return Front(prisms.cells, faces[:, ::-1], 0, (0, int(not is_whole)))
    if weighted:
        edges = problem.edges(number, reverse)
        visits = 30 * max(len(edges), 1_000_000)  # a second or more; 5 to 15 per edge suffice
        call("front_weights", n, vertices, len(edges), edges, SWEEPS, visits)
        del edges
    sides = (n1, n0) if reverse else (n0, n1)
    if not problem.rims or n > SWEPT:
        vertices[sides[0] :, 9] += 2 * share * SWEEP * vertices[sides[0] :, :3] @ GENERIC
    weights = vertices[number, 9] * problem.size**2
    inner = walls = problem.walls(sign * shift, weights)
    if prisms:
        walls, inner = prisms.walls(walls)
    start, end = (number[f][:, turned] for f in facets[::sign])
    start = start[np.argsort(start.min(axis=1), kind="stable")]
    start, end = ints(np.vstack((start, number[inner]))), ints(end)
    max_cells = CELLS * (len(start) + len(end)) + 100
    cells = np.empty((max_cells, 4), dtype=np.int32)
    left = np.empty((len(start) + 2 * n + len(end), 3), dtype=np.int32)
    counts, wrong = np.zeros(3, dtype=np.int32), (0, 0)
    given = *sides, vertices, flat, len(start), start, len(end), end
    status = call("front_fill", *given, max_cells, cells, left, counts)
    made = cells[: counts[0]]
    if status < 2 and counts[1] <= LEFT * len(made):
        outer = np.vstack((start, end[:, [1, 0, 2]], left[: counts[1:].sum(), [1, 0, 2]]))
        front, room = made.copy(), min(2 * len(made), max_cells)
        along = vertices[:, :3] @ GENERIC
        rank = np.empty(n, dtype=np.int32)
        for part in (slice(0, sides[0]), slice(sides[0], n)):
            rank[part][np.argsort(along[part], kind="stable")] = np.arange(n, dtype=np.int32)[part]
        limits = flat, (1 - 1e-9) / EXTRAPOLATE
        num = call("front_swap", sides[0], n, vertices, rank, *limits, len(front), room, cells)
        made, status = cells[:num], status if num > 0 else 2
        wrong = _check(sides[0], vertices, made, outer)
        if any(wrong):
            made, wrong = front, _check(sides[0], vertices, front, outer)
    if status > 1:
        raise MemoryError("no memory for the cells of the gap domain")
    cells = np.vstack((*((prisms.cells,) if prisms else ()), ints(order)[made]))
    return Front(cells, walls, int(counts[1]), wrong)


def _check(n0: int, vertices, cells, outer) -> tuple[int, int]:
    """Number of cells that are flat or inverted, and of faces with no or too many neighbours.

    Args:
        n0: Number of vertices of the surface where the front starts.
        vertices: Place, displaced place, normal and weight of each, ``(num_vertices, 10)``.
        cells: ``(num_cells, 4)``.
        outer: The boundary's triangles, counterclockwise seen from inside, ``(num_triangles, 3)``.
    """
    wrong = np.zeros(2, dtype=np.int32)
    faces = len(cells), ints(cells), len(outer), ints(outer)
    if call("front_check", n0, len(vertices), vertices, *faces, wrong):
        raise MemoryError("no memory for the cells of the gap domain")
    return int(wrong[0]), int(wrong[1])


def _are_walls(faces, n0: int):
    """Mask of the faces of cells that have vertices of both sides, ``(num_faces,)``."""
    return (faces < n0).any(axis=1) & (faces >= n0).any(axis=1)


def quartered(problem: Problem) -> Front | None:
    """Cells between facets and their quarters, or None."""
    (facets0, facets1), x, n0 = problem.facets, problem.x, problem.n0
    cells = between_quarters(x[:n0], facets0, x[n0:], facets1 - n0, problem.size)
    if cells is None:
        return None
    walls = outer_faces(cells)
    walls = walls[_are_walls(walls, n0)]
    vertices = np.zeros((len(x), 10))
    vertices[:, :3] = (x - x.mean(axis=0)) / problem.size
    vertices[:, 6:9] = problem.normals
    outer = np.vstack((facets0, walls, facets1[:, ::-1]))
    return Front(cells, walls, 0, _check(n0, vertices, cells, outer))


def construct(problem: Problem, place: Place, margins: Margins | None = None) -> Filling | None:
    """Cells between two surfaces, by the first front that gets through; None if all attempts fail.

    If none gets through, cavities of the one that gets farthest are filled with cones. Inverted
    curved cells are swapped for others. If some remain in all attempts, the attempt with the fewest
    is taken, and these are replaced with cones, or some of their edges straightened.

    Args:
        problem: The surfaces.
        place: Puts a node between the surfaces.
        margins: Margins of curved cells against inversion; None if surfaces are straight.
    """
    for flat in (THIN_CELL, FLAT_GAP_CELL):
        filling = _construct(problem, place, margins, flat)
        if filling:
            return filling
    return None


def _construct(problem: Problem, place: Place, margins: Margins | None, flat: float):
    """The same by fronts that avoid cells whose D over its scale is ``flat`` or less."""
    alpha = (np.arange(len(problem.x)) >= problem.n0).astype(float)
    fronts, found = [], []
    given = [problem.prisms, None] if len(problem.prisms.cells) else [None]

    def repair_of(front: Front) -> MeshRepair:
        outer = np.vstack((problem.facets[0], front.walls, problem.facets[1][:, ::-1]))
        return MeshRepair(outer, place, margins, problem.along)

    tries: list[Callable[[], Front | None]] = [
        partial(advance, problem, *variant, flat, prisms)
        for prisms, variant in product(given, VARIANTS)
    ]
    tries.append(partial(quartered, problem))
    for attempt in tries:
        front = attempt()
        if front is None:
            continue
        mesh = cavity.Cells(problem.x, alpha, problem.normals, front.cells)
        filling = Filling(mesh, [])
        if problem.curved:
            filling = replace(filling, walls=problem.along(front.walls))
        repair = repair_of(front)
        if front.left and front.is_through:
            made = repair.coned(filling)
            if made is None:
                continue
            filling = made
        elif not front.is_valid:
            fronts.append((front, filling))
            continue
        filling = repair.swapped(filling)
        found.append((repair.num_bad(filling), filling, repair))
        if not found[-1][0]:
            return filling
    for front, filling in sorted(fronts, key=lambda pair: pair[0].left):
        if found:
            break
        repair = repair_of(front)
        made = repair.coned(filling, filling.mesh.flat())
        if made is not None:
            made = repair.swapped(made)
            found.append((repair.num_bad(made), made, repair))
    if not found:
        return None
    _, filling, repair = min(found, key=lambda entry: entry[0])
    return repair.straightened(repair.refilled(filling))
