# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Where points in the walls of Σ lie on both sides: on the curved edges at which pieces end.

An edge through the gap between nodes of both outlines is a chord of these. What lies between its
ends belongs on the outlines, or Σ is as much smaller or larger as chords are off.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap_mesh.tetrahedra import EDGES, find
from hypergap_dolfinx.gap_mesh.walls import Rim
from hypergap_dolfinx.surface.pieces import CORNERS, Side
from hypergap_dolfinx.surface.trace import lengths
from hypergap_dolfinx.trimming.outlines import CORNER

NO_WALLS = np.empty((0, 3), dtype=np.intp)
NEWTON = 8  # steps to the nearest point of a curved edge
CONVERGED = 1e-13  # a step, in edges, that is the last one
WITHIN = 0.95  # of an edge's length along the outline, where a corner is not at its end
FURTHER = 100  # edges that a point may be away along an outline


def along(walls: npt.NDArray[np.integer], x, n0: int, rims: Sequence[Rim]):
    """Walls that lie along the outlines: those that don't cut off a corner.

    Args:
        walls: Triangles, ``(num_walls, 3)``.
        x: Vertex coordinates of both sides.
        n0: Number of vertices of Γ0, which come first.
        rims: The loops that walls are between.

    Returns:
        Some of them.
    """
    edges = walls[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2)
    keep = np.ones(len(edges), dtype=bool)
    for rim in rims:
        s = np.full(len(x), np.nan)
        s[rim.nodes[0]], s[n0 + rim.nodes[1]] = rim.s[0][:-1], rim.s[1][:-1]
        t = np.roll(x[rim.nodes[0]], -1, axis=0) - x[rim.nodes[0]]
        t /= np.maximum(lengths(t), 1e-300)[:, None]
        corners = rim.s[0][:-1][np.einsum("ei,ei->e", t, np.roll(t, 1, axis=0)) < np.cos(CORNER)]
        middle, half = s[edges].mean(axis=1), np.ptp(s[edges], axis=1) / 2
        far = half > 0.25  # the other way round
        middle, half = (np.where(far, 0.5 + y, z) for y, z in ((middle, middle), (-half, half)))
        apart = (corners[:, None] - middle + 0.5) % 1 - 0.5
        keep &= ~(np.abs(apart) < WITHIN * half).any(axis=0)
    return walls[keep.reshape(-1, 3).all(axis=1)]


def in_walls(vertices: npt.NDArray[np.integer], walls: npt.NDArray[np.integer]):
    """Whether edges or triangles are some walls' or edges of these.

    Args:
        vertices: ``(num, 2)`` or ``(num, 3)``; if more none is.
        walls: Triangles, ``(num_walls, 3)``.

    Returns:
        ``(num,)``.
    """
    return find(walls, vertices) >= 0


def kinds(cells: npt.NDArray[np.integer], walls: npt.NDArray[np.integer]):
    """A number for each cell that tells which of its faces and edges are in walls, ``(num,)``."""
    parts = [cells[:, [i for i in range(4) if i != k]] for k in range(4)]
    parts += [cells[:, edge] for edge in EDGES]
    return sum(in_walls(part, walls).astype(int) << i for i, part in enumerate(parts))


class Outline:
    """The (curved) edges at which a piece ends."""

    def __init__(self, side: Side):
        """All loops of a piece."""
        self.side = side
        self.triangle, self.corner = np.nonzero(side.behind < 0)
        start = side.triangles[self.triangle, self.corner]
        end = side.triangles[self.triangle, (self.corner + 1) % 3]
        self.first = np.full(len(side.x), -1)  # the edge that starts at each vertex
        self.first[start] = np.arange(len(start))
        last = np.full(len(side.x), -1)
        last[end] = np.arange(len(end))
        self.after, self.before = self.first[end], last[start]

    def project(self, points, vertex) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
        """Where the outline is nearest to points.

        Args:
            points: ``(num_points, 3)``.
            vertex: Vertices of the outline near which it is looked for, ``(num_points,)``.

        Returns:
            The piece's triangle and reference coordinates in it, ``(num_points,)`` and
            ``(num_points, 2)``.
        """
        start = self.first[vertex]  # at a corner both edges have a nearest place
        both = np.concatenate((start, self.before[start]))
        edge, s = self._walk(both, np.tile(points, (2, 1)))
        triangle, places = self.triangle[edge], self._places(edge, s)
        away = lengths(
            (self.side.points(triangle, places).reshape(2, -1, 3) - points).reshape(-1, 3)
        )
        n = len(points)
        nearer = np.arange(n) + np.where(away[n:] < away[:n], n, 0)
        return triangle[nearer], places[nearer]

    def _walk(self, edge, points) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
        """Edges and parameters on them at which a walk from some edges ends."""
        edge, s = edge.copy(), np.zeros(len(points))
        way = np.zeros(len(points))  # which way along the outline each came
        active = np.arange(len(points))
        for _ in range(FURTHER):
            found = self._nearest(edge[active], points[active])
            go = np.sign(np.where(found > 1, 1, np.minimum(found, 0)))
            s[active] = np.clip(found, 0, 1)
            on = (go != 0) & (go != -way[active])  # who would turn round is at a corner
            active, go = active[on], go[on]
            if not len(active):
                break
            way[active] = go
            edge[active] = np.where(go > 0, self.after[edge[active]], self.before[edge[active]])
        return edge, s

    def _places(self, edge, s) -> npt.NDArray[np.float64]:
        start, end = CORNERS[self.corner[edge]], CORNERS[(self.corner[edge] + 1) % 3]
        return start + s[:, None] * (end - start)

    def _nearest(self, edge, points) -> npt.NDArray[np.float64]:
        """Parameters on edges at which these are nearest to points, by Gauss-Newton steps."""
        start = CORNERS[self.corner[edge]]
        along = CORNERS[(self.corner[edge] + 1) % 3] - start
        geometry = self.side.geometry(self.triangle[edge])
        s = np.full(len(edge), 0.5)
        for _ in range(NEWTON):
            x, dx = geometry(start + s[:, None] * along)
            tangent = np.einsum("pj,pji->pi", along, dx)
            square = np.maximum(np.einsum("pi,pi->p", tangent, tangent), 1e-300)
            before, s = s, s - np.einsum("pi,pi->p", x - points, tangent) / square
            s = np.clip(s, -1, 2)
            if np.abs(s - before).max() < CONVERGED:
                break
        return s
