# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cuts of a piece along the other one's curved outline.

The outline is drawn as straight segments on the piece's straight triangles. Their crossings with
edges are then moved to those of the outline itself, and cut triangles get bent edges: polynomials
in the facet's reference coordinates through projected points of the outline.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.surface.pieces import TRIANGLE_CORNERS, Side, bent
from hypergap_dolfinx.surface.trace import geometry_nodes
from hypergap_dolfinx.trimming.tolerances import NEWTON_OUTLINES

P = basix.ElementFamily.P
SAMPLES = basix.create_lattice(basix.CellType.triangle, 4, basix.LatticeType.equispaced, True)

Edge = tuple[int, int, int]
"""A triangle of a piece, and the two vertices of its edge."""


@dataclass(frozen=True)
class Arcs:
    """Curved edges of a piece's triangles."""

    side: Side
    triangle: npt.NDArray[np.intp]
    """``(num_arcs,)``."""
    corners: npt.NDArray[np.intp]
    """Local corners at their start and end, ``(num_arcs, 2)``."""

    @classmethod
    def between(cls, side: Side, triangle, vertices) -> "Arcs":
        """Arcs from triangles, ``(num_arcs,)``, and their edges' vertices, ``(num_arcs, 2)``."""
        triangle = np.asarray(triangle, dtype=np.intp)
        vertices = np.asarray(vertices, dtype=np.intp).reshape(-1, 2)
        match = side.triangles[triangle][:, None] == vertices[:, :, None]
        return cls(side, triangle, match.argmax(axis=2))

    def __getitem__(self, some) -> "Arcs":
        """A selection of arcs."""
        return Arcs(self.side, self.triangle[some], self.corners[some])

    def at(self, s) -> tuple[npt.NDArray[np.float64], ...]:
        """Places at parameters from 0 to 1, the piece's normals there, and derivatives of both."""
        start, end = TRIANGLE_CORNERS[self.corners[:, 0]], TRIANGLE_CORNERS[self.corners[:, 1]]
        x, dx = self.side.geometry(self.triangle)(start + s[:, None] * (end - start))
        n = self.side.vertex_normals[self.side.triangles[self.triangle[:, None], self.corners].T]
        normal = n[0] + s[:, None] * (n[1] - n[0])
        return x, normal, np.einsum("pj,pji->pi", end - start, dx), n[1] - n[0]


def crossings(own: Arcs, other: Arcs, s, r) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
    """Crossings of curved edges of two pieces, along the first one's normals.

    Args:
        own: Edges of one piece.
        other: As many of the other one.
        s: Initial parameters on them, ``(num_arcs,)``.
        r: The same on the other edges.

    Returns:
        Both parameters, and the mask of crossings that were found, of edges or their extensions.
    """
    z = np.zeros(len(s))
    done = np.zeros(len(s), dtype=bool)
    for _ in range(NEWTON_OUTLINES):
        x, n, dx, dn = own.at(s)
        y, _, dy, _ = other.at(r)
        off = x + z[:, None] * n - y
        square = np.einsum("pi,pi->p", dx, dx)
        J = np.stack((dx + z[:, None] * dn, n, -dy), axis=2)
        size = np.sqrt(square * np.einsum("pi,pi->p", dy, dy))
        J[np.abs(np.linalg.det(J)) < 1e-6 * size] = np.eye(3)  # parallel
        step = np.where(done[:, None], 0, np.linalg.solve(J, off[:, :, None])[:, :, 0])
        s, z, r = np.clip(s - step[:, 0], -1, 2), z - step[:, 1], np.clip(r - step[:, 2], -1, 2)
        done |= np.einsum("pi,pi->p", off, off) < 1e-20 * square
        if done.all():
            break
    return s, r, done


class OutlineCurves:
    """Parts of the other piece's outline that are drawn on a piece."""

    def __init__(self, side: Side, other: Side):
        """Store the piece, without any parts yet, and the other piece."""
        self.side, self.other = side, other
        degree, variant = geometry_nodes(
            [side.surface, other.surface], max(side.degree, other.degree)
        )
        edge = basix.create_element(P, basix.CellType.interval, degree, variant)
        self.nodes = np.sort(edge.points[:, 0])[1:-1]  # of Σ's edges
        self._tracks: list[tuple[Edge, list[int], list[float]]] = []
        self._ends: dict[tuple[int, int], tuple[Edge, float, float]] = {}

    def add(self, edge: Edge, nodes: list[int], r: list[float]):
        """Add a part by its edge, the nodes along it, and their parameters on the edge."""
        self._tracks.append((edge, nodes, r))

    def between_ends(self) -> list[int]:
        """Nodes along the parts except at their ends."""
        return list(dict.fromkeys(node for _, nodes, _ in self._tracks for node in nodes[1:-1]))

    def settled(self, nodes: list[int], arcs: Arcs, s) -> tuple[dict[int, float], set[int]]:
        """Crossings of the outline with the piece's edges.

        Args:
            nodes: Nodes at crossings of the straight segments.
            arcs: The edges.
            s: The nodes' parameters, ``(num_nodes,)``.

        Returns:
            New parameters of nodes for which a crossing was found, and nodes that belong where they
            are: they lie between the outline and a node that both outlines share within the
            meshes' uncertainty.
        """
        if not nodes:
            return {}, set()
        at: dict[int, tuple[int, int]] = {}
        for i, (_, along, _) in enumerate(self._tracks):
            for k, node in enumerate(along[1:-1], 1):
                at.setdefault(node, (i, k))
        places = [at[node] for node in nodes]
        others = self._arcs([self._tracks[i][0] for i, _ in places])
        r = np.array([self._tracks[i][2][k] for i, k in places])
        s, r, done = crossings(arcs, others, s, r)
        ends = np.sort([[self._tracks[i][2][k] for k in (0, -1)] for i, _ in places])
        crossed = done & (s > 0) & (s < 1)
        inside = (r > ends[:, 0]) & (r < ends[:, 1])
        beyond = {node for node, there in zip(nodes, crossed & ~inside, strict=True) if there}
        given = zip(s.tolist(), r.tolist(), (crossed & inside).tolist(), strict=True)
        new = {n: values for n, values in zip(nodes, given, strict=True) if n not in beyond}
        found: dict[int, float] = {}
        for i, (edge, along, before) in enumerate(self._tracks):
            own = [node for node in along[1:-1] if at[node][0] == i and node in new]
            after = [new[n][1] if n in own else b for n, b in zip(along, before, strict=True)]
            steps = np.diff(after) * (before[-1] - before[0])
            if own and all(new[node][2] for node in own) and steps.min() > 0:
                self._tracks[i] = edge, along, after
                found.update((node, new[node][0]) for node in own)
        return found, beyond

    def close(self, nodes: set[int]):
        """End the drawing, given the nodes that lie on the curved outline."""
        for edge, along, r in self._tracks:
            for k in range(len(along) - 1):
                u, v = along[k : k + 2]
                if u in nodes and v in nodes:
                    self._ends[u, v] = edge, r[k], r[k + 1]

    def foot(self, u: int, v: int, s: float, triangle: int, weights):
        """Place on the outline at s from 0 to 1 between nodes u and v in a triangle.

        Returns:
            Barycentric coordinates, and the parameter on the other's edge; ``weights``, those on
            the straight segment, and NaN if it is off the outline.
        """
        if (v, u) in self._ends:
            u, v, s = v, u, 1 - s
        if (u, v) not in self._ends:
            return weights, np.nan
        edge, r0, r1 = self._ends[u, v]
        r = (1 - s) * r0 + s * r1
        place = self._arcs([edge]).at(np.array([r]))[0]
        (xi,) = self.side.on_curved(np.array([triangle]), place, weights[None, 1:])
        found = np.array((1 - xi.sum(), *xi))
        return (found, r) if found.min() > 0 else (weights, np.nan)

    def split(self, u: int, v: int, node: int, r: float):
        """Put a node between two others, with its parameter; NaN if it is off the outline."""
        if (v, u) in self._ends:
            u, v = v, u
        if (u, v) in self._ends:
            edge, r0, r1 = self._ends.pop((u, v))
            if np.isfinite(r):
                self._ends[u, node], self._ends[node, v] = (edge, r0, r), (edge, r, r1)

    def bends(self, pairs, triangle, ends) -> npt.NDArray[np.float64]:
        """Deviation of the outline from straight edges of cut triangles.

        Args:
            pairs: The edges' nodes, ``(num_edges, 2)``.
            triangle: The piece's triangle that each lies in, ``(num_edges,)``.
            ends: Reference coordinates of the nodes in it, ``(num_edges, 2, 2)``.

        Returns:
            As of :class:`Side`, in the host facets, ``(num_edges, num_terms, 2)``.
        """
        num = len(self.nodes)
        found = np.zeros((len(pairs), num, 2))
        parts = [self._ends.get(tuple(pair)) for pair in pairs.tolist()]
        some = np.array([i for i, part in enumerate(parts) if part], dtype=np.intp)
        if not len(some) or not num:
            return found
        arcs = self._arcs([part[0] for part in parts if part])
        r0, r1 = (np.array([part[i] for part in parts if part]) for i in (1, 2))
        own, t = triangle[some], self.nodes
        off = np.empty((len(some), num, 2))
        for j in range(num):
            x = arcs.at((1 - t[j]) * r0 + t[j] * r1)[0]
            xi = (1 - t[j]) * ends[some, 0] + t[j] * ends[some, 1]
            off[:, j] = (self.side.on_curved(own, x, xi) - xi) / (t[j] * (1 - t[j]))
        off = np.linalg.inv(np.vander(2 * t - 1, increasing=True)) @ off
        found[some] = off @ (self.side.X[own, 1:] - self.side.X[own, :1])
        return found

    def _arcs(self, edges: Sequence[Edge]) -> Arcs:
        each = np.array(edges, dtype=np.intp).reshape(-1, 3)
        return Arcs.between(self.other, each[:, 0], each[:, 1:])


def upright(X, bends) -> npt.NDArray[np.float64] | None:
    """Bends of triangles with corners X, ``(num_triangles, 3, 2)``, but zero where they would fold.

    None if none is left.
    """
    some = np.flatnonzero(bends.any(axis=(1, 2, 3)))
    straight = X[some, 1:] - X[some, :1]
    twice = np.linalg.det(straight)
    good = np.ones(len(some), dtype=bool)
    for point in SAMPLES:
        slopes = straight + bent(bends[some], np.tile(point, (len(some), 1)))[1]
        good &= np.linalg.det(slopes) / twice > 0
    bends = bends.copy()
    bends[some[~good]] = 0
    return bends if bends.any() else None
