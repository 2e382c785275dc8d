# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tetrahedra between two triangulated surfaces, by an advancing front of flips (``front.c``)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap import cavity
from hypergap_dolfinx.gap.cavity import Place
from hypergap_dolfinx.gap.jit import library
from hypergap_dolfinx.gap.walls import Rim, Side, rims

SHIFT = 0.1  # by how much of an edge's length ties are told apart
GENERIC = np.array((0.5377, 0.6819, 0.4961))  # no mesh has edges or planes in this direction
SWEEPS = 3000  # of the search for weights, before it is given up; fewer if there are many edges
VISITS = 5_000_000  # the same, times edges


@dataclass(frozen=True)
class Problem:
    """Two surfaces between which cells are sought; vertices are Γ0's, then Γ1's."""

    x: npt.NDArray[np.float64]
    """Vertex coordinates, ``(num_vertices, 3)``."""
    n0: int
    """Number of Γ0's vertices."""
    facets: tuple[npt.NDArray[np.integer], npt.NDArray[np.integer]]
    """Facets of both sides, counterclockwise seen from Γ1: ``(num_facets, 3)`` each."""
    rims: list[Rim]
    """Boundaries that face each other; none of closed surfaces."""

    @classmethod
    def between(cls, side0: Side, side1: Side) -> "Problem":
        """The problem of two facing pieces.

        Raises:
            InterfaceError: Their boundaries don't match.
        """
        n0 = len(side0.vertices)
        facets = side0.triangles, n0 + side1.triangles[:, ::-1]
        return cls(np.vstack((side0.x, side1.x)), n0, facets, rims(side0, side1))

    def walls(self, shift, weights) -> npt.NDArray[np.intp]:
        """Side walls, counterclockwise seen from outside, with Γ1 displaced."""
        empty = np.empty((0, 3), dtype=np.intp)
        return np.vstack([empty, *(rim.walls(self.n0, shift, weights) for rim in self.rims)])

    @property
    def normals(self) -> npt.NDArray[np.float64]:
        """Unit normals of the vertices, from Γ0 to Γ1."""
        total = np.zeros_like(self.x)
        for facets in self.facets:
            unit = facet_normals(self.x, facets)
            for i in range(3):
                total[:, i] += np.bincount(
                    facets.ravel(), np.repeat(unit[:, i], 3), minlength=len(total)
                )
        return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)


def facet_normals(x, facets) -> npt.NDArray[np.float64]:
    """Unit normals of triangles, ``(num_triangles, 3)``."""
    normal = np.cross(x[facets[:, 1]] - x[facets[:, 0]], x[facets[:, 2]] - x[facets[:, 0]])
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)


def inner_edges(facets: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
    """Inner edges of a triangulation: their ends q and r, p on their left and s on their right."""
    a, b, c = (np.roll(facets, -k, axis=1).ravel().astype(np.int64) for k in range(3))
    n = int(facets.max()) + 1
    key, back = a * n + b, b * n + a
    order = np.argsort(key)
    at = order[np.minimum(np.searchsorted(key[order], back), len(order) - 1)]
    inner = (key[at] == back) & (a < b)
    return np.column_stack((a, b, c, c[at]))[inner].astype(np.int32)


def fill(problem: Problem, weighted: bool, reverse: bool):
    """Let the front run.

    Args:
        problem: The surfaces.
        weighted: Whether weights make the surfaces' edges locally regular.
        reverse: Whether it goes from Γ1 to Γ0.

    Returns:
        Cells ``(num_cells, 4)``, triangles that are left of the front ``(num_left, 3)``, seen from
        where it was going, and the walls; None if there are no such weights.
    """
    module = library()
    ffi = module.ffi
    x, n0, n1 = problem.x, problem.n0, len(problem.x) - problem.n0
    start, end = problem.facets[::-1] if reverse else problem.facets
    number = np.arange(len(x))  # in the order of the front: where it starts, where it ends
    if reverse:
        number = np.concatenate((np.arange(n0) + n1, np.arange(n1)))
        start, end = start[:, ::-1], end[:, ::-1]
    sign = -1 if reverse else 1
    size = np.linalg.norm(x[start[:, 0]] - x[start[:, 1]], axis=1).mean()
    vertices = np.zeros((len(x), 10))  # x, y, normal, weight
    vertices[number, :3] = vertices[number, 3:6] = (x - x.mean(axis=0)) / size
    vertices[number, 6:9] = sign * problem.normals

    def pointer(kind, array):
        return ffi.from_buffer(f"{kind}[]", array, require_writable=True)

    shift = sign * displacement(problem)
    vertices[number[n0:], 3:6] += shift / size
    if weighted:
        corners = [np.empty((0, 4), dtype=np.intp)]
        for rim in problem.rims:
            for loop in (rim.nodes[0], n0 + rim.nodes[1]):
                three = (number[np.roll(loop, -k)] for k in range(3))
                corners.append(np.column_stack((*three, np.full(len(loop), -1))))
        edges = number[np.vstack((inner_edges(start), inner_edges(end)))]
        edges = np.vstack((edges, *corners)).astype(np.int32)
        sweeps = module.lib.front_weights(
            len(x), pointer("double", vertices), len(edges), pointer("int", edges),
            min(SWEEPS, VISITS // max(len(edges), 1)),
        )
    walls = problem.walls(shift, vertices[number, 9] * size**2)[:, ::-1]
    start = np.ascontiguousarray(number[np.vstack((start, walls))], dtype=np.int32)
    end = np.ascontiguousarray(number[end], dtype=np.int32)
    max_cells = 30 * (len(start) + len(end)) + 100
    cells = np.empty((max_cells, 4), dtype=np.int32)
    left = np.empty((len(start) + 2 * len(x), 3), dtype=np.int32)
    counts = np.zeros(3, dtype=np.int32)
    sides = (n1, n0) if reverse else (n0, n1)
    status = module.lib.front_fill(
        *sides,
        pointer("double", vertices),
        len(start),
        pointer("int", start),
        len(end),
        pointer("int", end),
        max_cells,
        pointer("int", cells),
        pointer("int", left),
        pointer("int", counts),
    )
    if status > 1:
        raise MemoryError("no memory for the cells of the gap domain")
    back = np.argsort(number)
    return back[cells[: counts[0]]], back[left[: counts[1]]], walls


def displacement(problem: Problem) -> npt.NDArray[np.float64]:
    """By what Γ1 is displaced for the predicates that order the moves, so that no two are tied.

    A closed surface slides along itself. An open one is stretched, so that its walls lean outwards.
    """
    x, normal = problem.x[problem.n0 :], problem.normals[problem.n0 :]
    edges = [
        np.linalg.norm(problem.x[f] - problem.x[np.roll(f, 1, axis=1)], axis=2).mean()
        for f in problem.facets
    ]
    shift = np.broadcast_to(GENERIC, x.shape)
    if problem.rims:
        from_centre = x - x.mean(axis=0)
        shift = from_centre / np.linalg.norm(from_centre, axis=1).max() + 0.1 * shift
    shift = shift - np.einsum("vi,vi->v", shift, normal)[:, None] * normal
    return SHIFT * min(edges) * shift


@dataclass(frozen=True)
class Filling:
    """Cells between two surfaces."""

    cells: npt.NDArray[np.intp]
    """``(num_cells, 4)``; interior vertices are numbered behind the others."""
    hosts: list[tuple]
    """Where the interior vertices lie: α, facets on both sides and coordinates in them."""


def construct(problem: Problem, place: Place) -> Filling | None:
    """Cells between two surfaces, by the first front that gets through.

    Else what the one leaves that gets farthest is filled with cones.

    Args:
        problem: The surfaces.
        place: Puts a node between the surfaces.

    Returns:
        The cells, None if there are none.
    """
    normals, alpha = problem.normals, (np.arange(len(problem.x)) >= problem.n0).astype(float)
    attempts = []
    for weighted, reverse in ((True, False), (True, True), (False, False), (False, True)):
        cells, left, walls = fill(problem, weighted, reverse)
        if not len(left) and error(problem, cells, walls) is None:
            return Filling(cells, [])
        attempts.append((len(left), cells, walls))
    for _, cells, walls in sorted(attempts, key=lambda attempt: attempt[0]):
        outer = np.vstack((problem.facets[0], walls, problem.facets[1][:, ::-1]))
        mesh = cavity.Cells(problem.x, alpha, normals, cells)
        found = cavity.fill(mesh, outer, place)
        if found is not None:
            mesh, hosts = found
            return Filling(mesh.cells, hosts)
    return None


def is_valid(problem: Problem, cells, walls) -> bool:
    return error(problem, cells, walls) is None


def cell_areas(problem: Problem, cells):
    x, normal = problem.x[cells], problem.normals[cells].sum(axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    alpha = (cells >= problem.n0).astype(float)
    e = x[:, 1:] - x[:, :1]
    da = alpha[:, 1:] - alpha[:, :1]
    N = sum(da[:, k, None] * np.cross(e[:, (k + 1) % 3], e[:, (k + 2) % 3]) for k in range(3))
    return np.einsum("ci,ci->c", N, normal), (e**2).sum(axis=2).max(axis=1)


def error(problem: Problem, cells, walls) -> str | None:
    D, scale = cell_areas(problem, cells)
    if not (D > 1e-9 * scale).all():
        return f"{(D <= 1e-9 * scale).sum()} cells are flat or inverted"
    n = len(problem.x)
    faces = np.vstack([cells[:, f] for f in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))])
    outer = np.vstack((problem.facets[0][:, ::-1], walls[:, ::-1], problem.facets[1]))
    def key(f):
        s = np.sort(f, axis=1).astype(np.int64)
        return (s[:, 0] * n + s[:, 1]) * n + s[:, 2]
    k, c = np.unique(key(faces), return_counts=True)
    if c.max(initial=0) > 2:
        return "face shared by more than two"
    b = np.sort(key(outer))
    if not np.array_equal(k[c == 1], b):
        return f"boundary differs {len(np.setdiff1d(b,k[c==1]))} missing, {len(np.setdiff1d(k[c==1],b))} too many"
    return None
