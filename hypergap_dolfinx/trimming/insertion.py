# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Nodes inserted into a piece of a surface, and their places."""

from collections import defaultdict

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.surface.pieces import Side


class Nodes:
    """Vertices of a piece, and new nodes on its edges or in its triangles.

    Places are given by weights of vertices, in the triangulation of straight triangles.
    """

    def __init__(self, side: Side, snap: float):
        """A piece, and the distance below which two nodes are one."""
        self.side, self.snap = side, snap
        self.num_vertices = len(side.x)
        # For each new node: the edge's vertices and a parameter, or a triangle and weights
        self.at: list[tuple] = []
        self.on: dict[tuple[int, int], list[tuple[float, int]]] = {}  # nodes on each edge
        self.inside: dict[int, list[int]] = defaultdict(list)  # nodes in each triangle
        corner = side.triangles.ravel()
        self._fans = np.argsort(corner, kind="stable") // 3
        self._starts = np.searchsorted(np.sort(corner), np.arange(self.num_vertices + 1))

    def around(self, a: int, b: int | None = None) -> list[int]:
        """The triangles at a vertex, or at an edge."""
        fan = self._fans[self._starts[a] : self._starts[a + 1]]
        if b is not None:
            fan = fan[(self.side.triangles[fan] == b).any(axis=1)]
        return fan.tolist()

    def on_edge(self, a: int, b: int, s: float) -> int:
        """The node at a parameter on an edge: a new one unless one is within ``snap``."""
        if a > b:
            a, b, s = b, a, 1 - s
        if (near := self._near(a, b, s)) is not None:
            return near
        node = self.num_vertices + len(self.at)
        self.at.append((a, b, s))
        self.on[a, b] = sorted([*self.on.get((a, b), []), (s, node)])
        return node

    def is_free(self, a: int, b: int, s: float) -> bool:
        """True if a node would be a new one there."""
        return self._near(a, b, s) is None if a < b else self.is_free(b, a, 1 - s)

    def _near(self, a: int, b: int, s: float) -> int | None:
        near = self.snap / float(np.linalg.norm(self.side.x[b] - self.side.x[a]))
        on = [(0.0, a), (1.0, b), *self.on.get((a, b), [])]
        return next((node for r, node in on if abs(s - r) <= near), None)

    def in_triangle(self, triangle: int, weights) -> int:
        """The node at a place in a triangle; on its edge or vertex if within ``snap`` of it."""
        v = self.side.triangles[triangle].tolist()
        x = self.side.x[v]
        twice = float(np.linalg.norm(np.cross(x[1] - x[0], x[2] - x[0])))
        for k in range(3):
            a, b = v[k], v[(k + 1) % 3]
            length = float(np.linalg.norm(x[(k + 1) % 3] - x[k]))
            if weights[(k + 2) % 3] * twice <= self.snap * length:
                wa, wb = max(weights[k], 0.0), max(weights[(k + 1) % 3], 0.0)
                return self.on_edge(a, b, wb / (wa + wb))
        node = self.num_vertices + len(self.at)
        self.at.append((triangle, np.asarray(weights)))
        self.inside[triangle].append(node)
        return node

    def host(self, node: int) -> tuple[int, npt.NDArray[np.float64]]:
        """A triangle that a node lies in, and the weights of its vertices."""
        weights = np.zeros(3)
        if node >= self.num_vertices and len(at := self.at[node - self.num_vertices]) == 2:
            return at
        a, b, s = (
            (node, None, 0.0) if node < self.num_vertices else self.at[node - self.num_vertices]
        )
        triangle = self.around(a, b)[0]
        v = self.side.triangles[triangle].tolist()
        weights[v.index(a)] = 1 - s
        if b is not None:
            weights[v.index(b)] = s
        return triangle, weights

    def places(self, nodes) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Places of nodes on the (curved) surface, and its normals there."""
        hosts = [self.host(node) for node in nodes]
        triangle = np.array([t for t, _ in hosts], dtype=np.intp)
        weights = np.array([w for _, w in hosts]).reshape(-1, 3)
        x = self.side.points(triangle, weights[:, 1:])
        n = self.side.vertex_normals[self.side.triangles[triangle]]
        return x, np.einsum("pv,pvi->pi", weights, n)

    def flat(self, node: int) -> npt.NDArray[np.float64]:
        """Place of a node in the triangulation of straight triangles."""
        if node < self.num_vertices:
            return self.side.x[node]
        triangle, weights = self.host(node)
        return weights @ self.side.x[self.side.triangles[triangle]]

    def triangles_at(self, node: int) -> list[int]:
        """The triangles that a node lies in or at."""
        if node < self.num_vertices:
            return self.around(node)
        at = self.at[node - self.num_vertices]
        return [at[0]] if len(at) == 2 else self.around(at[0], at[1])

    def edge_of(self, nodes) -> tuple[int, int] | None:
        """The edge that two nodes both lie on."""
        ends: list[set[int]] = []
        for node in nodes:
            if node < self.num_vertices:
                ends.append({node})
            elif len(at := self.at[node - self.num_vertices]) == 3:
                ends.append({at[0], at[1]})
            else:
                return None
        edge = ends[0] | ends[1]
        if len(edge) > 2:
            return None
        a, b = sorted(edge)
        return (a, b) if self.around(a, b) else None

    def parameter(self, node: int, edge: tuple[int, int]) -> float:
        """Parameter of a node on an edge that it lies on or ends."""
        new = node >= self.num_vertices
        return self.at[node - self.num_vertices][2] if new else float(node == edge[1])

    def between(self, a: int, b: int) -> list[int]:
        """The nodes on an edge from one of its vertices to the other, both included."""
        if a > b:
            return self.between(b, a)[::-1]
        return [a, *(node for _, node in self.on.get((a, b), [])), b]

    def slide(self, edge: tuple[int, int], new: dict[int, float]) -> bool:
        """Move nodes on an edge to new parameters; False if their order would change."""
        on = [(new.get(node, s), node) for s, node in self.on[edge]]
        near = self.snap / float(np.linalg.norm(self.side.x[edge[1]] - self.side.x[edge[0]]))
        if np.diff([0.0, *(s for s, _ in on), 1.0]).min() <= near:
            return False
        self.on[edge] = on
        for s, node in on:
            self.at[node - self.num_vertices] = (*edge, s)
        return True
