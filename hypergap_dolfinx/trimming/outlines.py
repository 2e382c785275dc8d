# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Outlines of two surfaces in space: which differ, and where they cross or touch."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.surface.nearest import on_loop
from hypergap_dolfinx.surface.pieces import Side
from hypergap_dolfinx.surface.tolerances import CORNER, FACING_COSINE
from hypergap_dolfinx.trimming.tolerances import (
    AWAY,
    INSIDE_WEIGHT,
    LEVEL,
    NEARLY,
    NEWTON_OUTLINES,
    OFF_OUTLINES,
)


class Rim:
    """A boundary loop of a piece."""

    def __init__(self, side: Side, loop: npt.NDArray[np.intp]):
        """A piece, and the nodes of a loop in either direction."""
        self.x = side.x[loop]  # (edge, 3)
        self.t = np.roll(self.x, -1, axis=0) - self.x
        self.length = np.linalg.norm(self.t, axis=1)
        self.normal = side.vertex_normals[loop]
        # The sagitta of an arc is an eighth of its length times its turn; larger turns than in a
        # pentagon are corners, where both outlines have a node
        unit = self.t / self.length[:, None]
        turn = _angle(unit, np.roll(unit, -1, axis=0))
        turn[turn > CORNER] = 0
        self.sag = self.length * np.maximum(turn, np.roll(turn, 1)) / 8
        self.bend = np.maximum(
            _angle(self.normal, np.roll(self.normal, 1, axis=0)),
            _angle(self.normal, np.roll(self.normal, -1, axis=0)),
        )

    def off(self, other: "Rim"):
        """Distances of its nodes from another one, less what the bend of the surfaces explains.

        Returns:
            The nearest edge, the parameter on it, from 0 to 1, and the distance; the nearest node
            and its distance; all ``(num_nodes,)``, distances in lengths of edges.
        """
        there = on_loop(self.x, other.x)
        edge = there.edge
        height, distance = _along(there.apart, other.normal[edge])
        # A gap is allowed; its direction is known up to the angle between neighbouring normals
        explained = 2 * np.maximum(self.sag, other.sag[edge])
        bend = np.minimum(other.bend[edge] + self.bend, CORNER)
        explained += height * np.tan(bend)
        length = np.maximum(self.length, other.length[edge])
        explained = np.minimum(explained, AWAY * length)
        apart = self.x - other.x[there.node]
        to_node = _along(apart, other.normal[there.node])[1] / length
        return edge, there.s, (distance - explained) / length, there.node, to_node

    def is_on(self, other: "Rim") -> bool:
        """True if its nodes lie on another one's edges, up to the bend of the surfaces.

        Outlines of facing surfaces run in opposite directions; equal directions mean that the
        surfaces lie beside each other.
        """
        edge, s, off, nearest, to_node = self.off(other)
        if is_along(self.x, other.x, edge, s):
            return False
        paired = len(np.unique(nearest)) == len(self.x) == len(other.x)
        return bool(off.max() <= OFF_OUTLINES) or (paired and bool(to_node.max() <= NEARLY))


def is_along(x, y, edge, s, some=slice(None)) -> bool:
    """True if two loops of nodes x and y, ``(num_nodes, 3)``, run in the same direction.

    Args:
        x: The first one.
        y: The second one.
        edge: Edge of the second one that is nearest to nodes of the first one.
        s: Parameter on it, from 0 to 1.
        some: These nodes of the first one.
    """
    # Chords of two edges: at a node the nearest edge may be the one before or the one behind it
    ways = [np.roll(z, -1, axis=0) - np.roll(z, 1, axis=0) for z in (x, y)]
    other = (1 - s)[:, None] * ways[1][edge] + s[:, None] * ways[1][(edge + 1) % len(y)]
    return bool(np.einsum("ni,ni->", ways[0][some], other) > 0)


def _angle(a, b) -> npt.NDArray[np.float64]:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ei,ei->e", a, b))


def _along(apart, normal):
    """Lengths of vectors' parts along normals and across them."""
    height = np.einsum("pi,pi->p", apart, normal)
    return np.abs(height), np.linalg.norm(apart - height[:, None] * normal, axis=1)


def differing(side0: Side, side1: Side) -> tuple[list[npt.NDArray[np.intp]], ...]:
    """Loops of each side without a counterpart on the other one."""
    loops = [side.loops() for side in (side0, side1)]
    rims = [
        [Rim(side, loop) for loop in own] for side, own in zip((side0, side1), loops, strict=True)
    ]
    left = list(range(len(rims[1])))
    alone = []
    for i, rim in enumerate(rims[0]):
        twin = next((j for j in left if rim.is_on(rims[1][j]) and rims[1][j].is_on(rim)), None)
        if twin is None:
            alone.append(loops[0][i])
        else:
            left.remove(twin)
    return alone, [loops[1][j] for j in left]


@dataclass(frozen=True)
class Edges:
    """Straight edges of an outline."""

    a: npt.NDArray[np.float64]
    """Starting points, ``(num_edges, 3)``."""
    b: npt.NDArray[np.float64]
    """End points."""
    normal: npt.NDArray[np.float64]
    """Normals of the surface, ``(num_edges, 3)``."""


@dataclass(frozen=True)
class Meetings:
    """Nodes of one outline on edges of the other, and crossings of edges."""

    edge: npt.NDArray[np.intp]
    """Edge of the first outline, ``(num,)``."""
    s: npt.NDArray[np.float64]
    """Parameter on it, from 0 to 1."""
    other: npt.NDArray[np.intp]
    """Edge of the second outline."""
    r: npt.NDArray[np.float64]
    """Parameter on it."""


def meetings(edges: Edges, others: Edges, snap: float) -> Meetings:
    """All places where two outlines with opposite normals meet, along the first one's normals.

    Distances up to ``snap`` are treated as zero.
    """
    found = []
    length = np.linalg.norm(edges.b - edges.a, axis=1)
    others_length = np.linalg.norm(others.b - others.a, axis=1)
    middle, others_middle = (edges.a + edges.b) / 2, (others.a + others.b) / 2
    chunk = max(1, 1_000_000 // max(len(others.a), 1))  # pairs at a time, to bound memory
    for c in range(0, len(length), chunk):
        part = slice(c, c + chunk)
        apart = others_middle - middle[part, None]
        height = np.einsum("eoi,ei->eo", apart, edges.normal[part])
        square = np.einsum("eoi,eoi->eo", apart, apart) - height**2
        reach = 0.6 * (length[part, None] + others_length)
        facing = edges.normal[part] @ others.normal.T < FACING_COSINE
        e, o = np.nonzero((square < (reach + snap) ** 2) & facing)
        found.append(_meetings(edges, others, e + c, o, snap))
    e, s, o, r = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return Meetings(e, s, o, r)


def _meetings(edges: Edges, others: Edges, e, o, snap: float) -> tuple[npt.NDArray, ...]:
    """The meetings of some pairs of edges."""
    t = edges.b[e] - edges.a[e]
    length = np.linalg.norm(t, axis=1)
    t /= length[:, None]
    m = np.cross(edges.normal[e], t)
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    # In the plane of the edge: along it, and to its left
    p, q = (
        np.column_stack([_dot(y[o] - edges.a[e], v) for v in (t, m)]) for y in (others.a, others.b)
    )
    d = q - p
    size = np.maximum(np.linalg.norm(d, axis=1), 1e-300)

    def on_edge(y):
        return (np.abs(y[:, 1]) <= snap) & (y[:, 0] >= -snap) & (y[:, 0] <= length + snap)

    def on_other(y0):
        """Parameter of the point (y0, 0) on the other edge, and True if it lies on it."""
        along = ((y0 - p[:, 0]) * d[:, 0] - p[:, 1] * d[:, 1]) / size
        across = np.abs(-p[:, 1] * d[:, 0] - (y0 - p[:, 0]) * d[:, 1]) / size
        return along, (across <= snap) & (along >= -snap) & (along <= size + snap)

    p_on, q_on = on_edge(p), on_edge(q)
    (a_at, a_on), (b_at, b_on) = on_other(0 * length), on_other(length)
    parts = []
    for on, y, r in ((p_on, p, 0.0), (q_on, q, 1.0)):
        parts.append((on, np.clip(y[:, 0] / length, 0, 1), np.full(len(e), r)))
    for on, at, s in ((a_on, a_at, 0.0), (b_on, b_at, 1.0)):
        parts.append((on, np.full(len(e), s), np.clip(at / size, 0, 1)))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = p[:, 1] / (p[:, 1] - q[:, 1])
        where = (p[:, 0] + share * d[:, 0]) / length
        cross = (p[:, 1] * q[:, 1] < 0) & (where > 0) & (where < 1)
    parts.append((cross & ~(p_on | q_on | a_on | b_on), where, share))
    return tuple(
        np.concatenate(arrays)
        for arrays in zip(*((e[on], s[on], o[on], r[on]) for on, s, r in parts), strict=True)
    )


def _dot(a, b) -> npt.NDArray[np.float64]:
    return np.einsum("pi,pi->p", a, b)


def locate(side: Side, points, normals) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
    """The triangles of a piece that points lie above or below, along the piece's normals.

    Points have normals of their own surface, which faces the piece, ``(num_points, 3)``.

    Returns:
        The nearest such triangle, or −1, and the weights of its vertices,
        ``(num_points,)`` and ``(num_points, 3)``.
    """
    host, weights = np.full(len(points), -1), np.zeros((len(points), 3))
    p, f = side.tree.candidates(points, normals)
    at, t = _feet(side, f, points[p])
    curved = bool(side.surface.curved[side.facets].any())
    least = at.min(axis=1, initial=np.inf)
    near = (curved & np.isfinite(least)) | (
        least >= -INSIDE_WEIGHT
    )  # a curved triangle may contain points beside it
    p, f, at, t, least = p[near], f[near], at[near], np.abs(t[near]), least[near]
    order = np.lexsort((t, np.maximum(-INSIDE_WEIGHT - least, 0), p))
    first = order[np.unique(p[order], return_index=True)[1]]
    p, f, at = p[first], f[first], at[first]
    if curved and len(p):
        f, xi = side.project(points[p], f)
        at = np.column_stack((1 - xi.sum(axis=1), xi))
        inside = at.min(axis=1, initial=np.inf) >= -INSIDE_WEIGHT
        p, f, at = p[inside], f[inside], np.maximum(at[inside], 0)
        at /= at.sum(axis=1)[:, None]
    host[p], weights[p] = f, at
    return host, weights


def _feet(side: Side, triangle, points):
    """Weights of the vertices and height of points along interpolated vertex normals."""
    x, n = side.x[side.triangles[triangle]], side.vertex_normals[side.triangles[triangle]]
    height = np.zeros(len(points))
    for _ in range(NEWTON_OUTLINES):
        y = x + height[:, None, None] * n
        e, f, d = y[:, 1] - y[:, 0], y[:, 2] - y[:, 0], points - y[:, 0]
        N = np.cross(e, f)
        square = np.maximum(_dot(N, N), 1e-300)
        a, b = _dot(np.cross(d, f), N) / square, _dot(np.cross(e, d), N) / square
        lifts = _dot(np.einsum("pk,pki->pi", np.column_stack((1 - a - b, a, b)), n), N)
        height = height + _dot(d, N) / np.maximum(lifts, LEVEL * np.sqrt(square))
    return np.column_stack((1 - a - b, a, b)), height
