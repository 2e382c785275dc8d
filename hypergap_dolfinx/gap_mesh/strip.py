# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Σ in two dimensions: the strip of triangles between two chains of edges.

**The apex rule** picks each triangle's apex: for an edge of one chain it is the node of the other
chain that is nearest to the edge's midpoint, in a common parameter (arc length) of both chains.
This is the Delaunay rule for a strip, and :func:`merge` applies it: sorting the edge midpoints of
both chains together gives all triangles.

**Ends.** Chains are cut to the parts that face each other (:func:`facing`), so the part of Γ1
beyond the end of Γ0 gets no cell of Σ. The facet of Γ1 at which Γ0 ends is covered in part, facets
beyond it are not covered (``GapCells.covered``). A vertex of Γ1 beyond the end has a multiplier
only if enough of a facet beside it is covered; otherwise λ there follows its neighbours
(:mod:`~hypergap_dolfinx.multipliers.existence`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.errors import InterfaceError, NotFacingError
from hypergap_dolfinx.gap_mesh.cells import GapCells, Hosts, covered_parts
from hypergap_dolfinx.gap_mesh.tolerances import ALIGNED, COINCIDE, END, NEWTON_RIM, SAME_TURN
from hypergap_dolfinx.surface.tolerances import KINK, NOISE, STANDS_OUT, TURN
from hypergap_dolfinx.surface.trace import Surface

PLANE_DIRECTION = np.array((np.cos(1), np.sin(1)))  # edges of meshes are hardly ever across it


def _length(v: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Lengths of vectors in the plane, ``(num,)``: ``np.linalg.norm`` is slow on short axes."""
    return np.sqrt(v[:, 0] ** 2 + v[:, 1] ** 2)


@dataclass(frozen=True)
class Chain:
    """Consecutive edges of a surface in the direction of travel along Γ0."""

    facets: npt.NDArray[np.int32]
    """Facet of each edge, ``(num_edges,)``."""
    X: npt.NDArray[np.float64]
    """Start and end of each edge in its facet's reference coordinate, ``(num_edges, 2)``."""
    x: npt.NDArray[np.float64]
    """Node coordinates, ``(num_edges + 1, 2)``; a closed chain's last node is its first."""
    closed: bool

    @cached_property
    def tangents(self) -> npt.NDArray[np.float64]:
        """From each edge's start to its end, ``(num_edges, 2)``."""
        return np.diff(self.x, axis=0)

    @cached_property
    def lengths(self) -> npt.NDArray[np.float64]:
        """Length of each edge, ``(num_edges,)``."""
        return _length(self.tangents)

    @cached_property
    def arc(self) -> npt.NDArray[np.float64]:
        """Arc length at the nodes, from 0 to 1, ``(num_edges + 1,)``."""
        s = np.append(0, np.cumsum(self.lengths))
        return s / s[-1]

    @cached_property
    def box(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Smallest and largest coordinates."""
        x = np.ascontiguousarray(self.x.T)
        return x.min(axis=1), x.max(axis=1)

    @property
    def reversed(self) -> "Chain":
        """The chain with the direction of travel reversed."""
        return replace(self, facets=self.facets[::-1], X=self.X[::-1, ::-1], x=self.x[::-1])

    def rolled(self, node: int) -> "Chain":
        """The closed chain, starting at another node."""
        x = np.roll(self.x[:-1], -node, axis=0)
        return replace(
            self,
            facets=np.roll(self.facets, -node),
            X=np.roll(self.X, -node, axis=0),
            x=np.vstack((x, x[:1])),
        )

    def project(self, point: npt.NDArray[np.float64]) -> tuple[int, float, float]:
        """Nearest place to a point: its edge, the position on it (0 to 1) and the distance."""
        a, t = self.x[:-1], self.tangents
        position = np.clip(np.einsum("ei,ei->e", point - a, t) / (t**2).sum(axis=1), 0, 1)
        distance = _length(a + position[:, None] * t - point)
        edge = int(distance.argmin())
        return edge, float(position[edge]), float(distance[edge])

    def nearest(
        self, edge: int, position: float, point: npt.NDArray[np.float64], surface: Surface
    ) -> float:
        """Position on an edge that is nearest to a point, from that on its chord.

        Gauss-Newton steps on a curved edge as long as they come nearer; the same position on a
        straight one.
        """
        facet = self.facets[edge]
        if not surface.curved[facet]:
            return position
        start, end = self.X[edge]
        nodes = surface.nodes_of(facet) - point
        found, least = position, np.inf
        for _ in range(NEWTON_RIM):
            X = np.array(((start + position * (end - start),),))
            x, slope = surface.geometry.tabulate(1, X)[:, 0, :, 0] @ nodes
            if x @ x >= least:
                break
            found, least = position, x @ x
            tangent = (end - start) * slope
            step = (x @ tangent) / max(tangent @ tangent, 1e-300)
            position = float(np.clip(position - step, 0, 1))
        return found

    def clipped(self, cuts: Sequence[tuple[int, float]], surface: Surface) -> "Chain":
        """The part between two points, each an edge and a position on it (0 to 1)."""
        (first, a), (last, b) = cuts
        facets, X = self.facets[first : last + 1], self.X[first : last + 1].copy()
        x = self.x[first : last + 2].copy()
        ends = X[0, 0] + a * (X[0, 1] - X[0, 0]), X[-1, 0] + b * (X[-1, 1] - X[-1, 0])
        X[0, 0], X[-1, 1] = ends
        if a > 0:
            x[:1] = surface.points(facets[:1], np.reshape(ends[0], (1, 1)))
        if b < 1:
            x[-1:] = surface.points(facets[-1:], np.reshape(ends[1], (1, 1)))
        return Chain(facets, X, x, closed=False)


def check_chains(surface: Surface, kind: str):
    """Check that edges form chains.

    Args:
        surface: The surface.
        kind: What it is a side of, a tie or a contact.

    Raises:
        InterfaceError: They branch.
    """
    for ends in surface.facets.T:
        count = np.bincount(ends, minlength=len(surface.x))
        if (count > 1).any():
            raise InterfaceError(
                f"{surface.name} branches at {spot(surface.x[count.argmax()])}: its facets must "
                f"form chains (make one {kind} for each branch)."
            )


def chains(surface: Surface, breaks: npt.NDArray[np.bool_] | None = None) -> list[Chain]:
    """Order the edges of a surface into chains, the body on the left.

    Args:
        surface: The surface.
        breaks: Mask of vertices at which a chain ends and the next begins, ``(num_vertices,)``.

    Raises:
        InterfaceError: The edges branch.
    """
    check_chains(surface, "tie")
    start, end = surface.facets.T
    edge_to = np.full(len(surface.x), -1)
    edge_to[end] = np.arange(len(end))
    previous = edge_to[start]
    if breaks is not None:
        previous[breaks[start]] = -1
    first, place, smallest = _trace(previous)
    # A chain whose edges all have one before them is a loop; it starts at its smallest edge
    loop = previous[first] >= 0
    if loop.any():
        previous[smallest[loop]] = -1
        first, place, _ = _trace(previous)
    order = np.lexsort((place, np.where(loop, first, start[first]), loop))
    found = []
    for chain in np.split(order, np.flatnonzero(place[order] == 0)[1:]):
        nodes = np.append(start[chain], end[chain[-1]])
        X = np.tile((0.0, 1.0), (len(chain), 1))
        closed = bool(loop[chain[0]])
        found.append(Chain(chain.astype(np.int32), X, surface.x[nodes], closed))
    return found


def _trace(previous: npt.NDArray[np.intp]):
    """Go back along all chains at once, in steps of 1, 2, 4, ...; −1 is previous to a first edge.

    Returns:
        For each edge, the first one of its chain (meaningless in a loop), its place in the chain,
        and the smallest number of an edge in reach.
    """
    edges = np.arange(len(previous), dtype=np.int32)  # with int32 each step reads half as much
    back = np.where(previous >= 0, previous, edges).astype(np.int32)
    place, smallest = (previous >= 0).astype(np.int32), edges
    for _ in range(len(previous).bit_length()):
        place = place + place[back]
        smallest = np.minimum(smallest, smallest[back])
        back = back[back]
    return back, place, smallest


def turns(surface: Surface) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Angles by which a surface turns at its vertices, and mask of its corners.

    At a corner there is a turn with hardly any beside it; a polygon that approximates a smooth
    curve turns at all of its vertices about as much.

    Returns:
        Angles (0 where they are round-off) and corners, ``(num_vertices,)`` each.
    """
    start, end = surface.facets.T
    before, after = (np.full(len(surface.x), -1) for _ in range(2))
    before[end] = after[start] = np.arange(len(start))
    inner = np.flatnonzero((before >= 0) & (after >= 0))
    n0, n1 = surface.normals[before[inner]], surface.normals[after[inner]]
    turn = np.zeros(len(surface.x))
    cross = n0[:, 0] * n1[:, 1] - n0[:, 1] * n1[:, 0]
    turn[inner] = np.arctan2(np.abs(cross), np.einsum("vi,vi->v", n0, n1))
    beside = np.zeros(len(surface.x))
    beside[inner] = np.maximum(turn[start[before[inner]]], turn[end[after[inner]]])
    noise = NOISE * np.abs(surface.x).max() / surface.size.min()
    turn[turn <= TURN + noise] = 0
    return turn, (turn > KINK) | (turn > STANDS_OUT * beside)


def pieces(surface0: Surface, surface1: Surface) -> tuple[list[Chain], list[Chain]]:
    """The smooth pieces of both surfaces, all travelled in the direction of Γ0.

    Pieces meet where both surfaces have a node at a kink: a corner of both, or a corner of one
    where the other turns by the same angle. (With one edge a side, a polygon's own corners look
    like a curve; nodes on a curve turn by different angles if edges differ.)

    Raises:
        InterfaceError: The edges branch.
    """
    surfaces = (surface0, surface1)
    breaks = [np.zeros(len(surface.x), dtype=bool) for surface in surfaces]
    (turn0, corner0), (turn1, corner1) = (turns(surface) for surface in surfaces)
    at = [np.flatnonzero(turn) for turn in (turn0, turn1)]
    if len(at[0]) and len(at[1]) and (corner0.any() or corner1.any()):
        i, j = _coincident(surface0.x[at[0]], surface1.x[at[1]])
        i, j = at[0][i], at[1][j]
        same = np.abs(turn0[i] - turn1[j]) <= SAME_TURN * turn0[i] + TURN
        kink = (corner0[i] & corner1[j]) | (same & (corner0[i] | corner1[j]))
        breaks[0][i[kink]] = breaks[1][j[kink]] = True
    c0, c1 = (chains(surface, b) for surface, b in zip(surfaces, breaks, strict=True))
    return c0, [chain.reversed for chain in c1]


def facing(surface0: Surface, surface1: Surface, chains0: list[Chain], chains1: list[Chain]):
    """Pairs of chains, cut to the parts that face each other.

    A chain that goes on beyond the end of the other one is cut at the projection of this end, or at
    its own node if that is within `END` of it; vertices beyond belong to no pair. All chains are in
    Γ0's direction of travel.

    Raises:
        NotFacingError: Nothing of Γ1 faces Γ0.
    """
    # Single chains face each other even if they are as far apart as they are long. Of several,
    # those within a facet's length of each other do
    alone = len(chains0) == len(chains1) == 1
    h = max(surface0.size.max(), surface1.size.max())
    pairs = []
    for c0 in chains0:
        for c1 in chains1:
            (low0, high0), (low1, high1) = c0.box, c1.box
            reach = (high0 - low0).max() if alone else h
            apart = np.maximum(low0 - high1, low1 - high0)
            if apart.max() <= reach and (pair := _overlap(c0, c1, surface0, surface1, reach)):
                pairs.append(pair)
    if not pairs:
        raise _not_facing(surface0, surface1, chains0, chains1)
    return pairs


def _overlap(c0: Chain, c1: Chain, surface0: Surface, surface1: Surface, reach: float):
    """The parts of two chains that face each other, or None."""
    if c0.closed and c1.closed:
        # Start where the chains share a node, else at the node nearest to Γ0's first
        shared0, shared1 = _shared_nodes(c0.x[:-1], c1.x[:-1])
        if len(shared0):
            c0, c1 = c0.rolled(int(shared0[0])), c1.rolled(int(shared1[0]))
        else:
            c1 = c1.rolled(int(np.linalg.norm(c1.x[:-1] - c0.x[0], axis=1).argmin()))
        return (c0, c1) if _aligned(c0, c1) and c0.project(c1.x[0])[2] <= reach else None
    # A closed chain facing an open one is opened at the node farthest from it
    if c0.closed:
        middle = c1.x[len(c1.x) // 2]
        c0 = c0.rolled(int(np.linalg.norm(c0.x[:-1] - middle, axis=1).argmax()))
    if c1.closed:
        middle = c0.x[len(c0.x) // 2]
        c1 = c1.rolled(int(np.linalg.norm(c1.x[:-1] - middle, axis=1).argmax()))

    cuts: list[list[tuple[int, float]]] = [[], []]  # [chain][start, end]
    for end in (0, -1):
        hits = [c0.project(c1.x[end]), c1.project(c0.x[end])]
        inside = []
        for chain, (edge, position, distance) in zip((c0, c1), hits):
            length = chain.lengths[edge]
            arc = chain.arc * chain.lengths.sum()
            s = arc[edge] + position * length
            inset = s if end == 0 else arc[-1] - s
            # Across a gap an end may project to a place beside the other end: no overlap
            inside.append(inset > max(END * length, distance) and distance <= reach)
        for i, chain in enumerate((c0, c1)):
            edge, position, _ = hits[i]
            cut = inside[i] and not inside[1 - i]
            if cut:
                point, surface = ((c1.x[end], surface0), (c0.x[end], surface1))[i]
                position = chain.nearest(edge, position, point, surface)
            whole = (0, 0.0) if end == 0 else (len(chain.facets) - 1, 1.0)
            cuts[i].append(_snapped(edge, position, end) if cut else whole)
        if not any(inside) and min(hit[2] for hit in hits) > reach:
            return None
        if not any(inside) and np.linalg.norm(c0.x[end] - c1.x[end]) > reach + END * reach:
            return None
    if any(start[0] + start[1] >= end[0] + end[1] for start, end in cuts):
        return None
    c0, c1 = c0.clipped(cuts[0], surface0), c1.clipped(cuts[1], surface1)
    return (c0, c1) if _aligned(c0, c1) else None


def _snapped(edge: int, position: float, end: int) -> tuple[int, float]:
    """A cut moved to a node that is close to it, so that it leaves no sliver."""
    if end == 0 and position > 1 - END:
        return edge + 1, 0.0
    if end == -1 and position < END:
        return edge - 1, 1.0
    return edge, position if END < position < 1 - END else round(position)


def _aligned(c0: Chain, c1: Chain) -> bool:
    """True if two chains run side by side in the same direction, in the mean."""
    num = 64  # samples of the cosine between both directions
    s = (np.arange(num) + 0.5) / num
    edges = [np.searchsorted(c.arc[1:-1], s) for c in (c0, c1)]
    tangents = [c.tangents[e] / c.lengths[e, None] for c, e in zip((c0, c1), edges, strict=True)]
    return bool(np.einsum("si,si->s", *tangents).mean() > ALIGNED)


def _not_facing(surface0, surface1, chains0, chains1) -> InterfaceError:
    """The error to raise if nothing of two surfaces faces each other, with the likely cause."""
    c0, c1 = chains0[0], chains1[0]
    distance = min(c0.project(x)[2] for x in c1.x)
    for i, j in ((i, j) for i in chains0 for j in chains1):
        if _overlap(i, j.reversed, surface0, surface1, np.ptp(i.x, axis=0).max()):
            return InterfaceError(
                "Γ0 and Γ1 don't face each other: their outward normals agree; is one of them the "
                "wrong side of its body, or the same surface given twice?"
            )
    across = any(_overlap(i, j, surface0, surface1, np.inf) for i in chains0 for j in chains1)
    return NotFacingError(
        f"Γ0 and Γ1 don't face each other: no part of Γ1 (around {spot(surface1.x)}, "
        f"{distance:.3g} away) lies opposite Γ0 (around {spot(surface0.x)}); check the tags"
        + " (faces to be tied across a distance want one tie, not one for each tag)" * across
        + "."
    )


def _coincident(x0, x1) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Indices of coincident points of two sets."""
    origin = np.array([min(a.min(), b.min()) for a, b in zip(x0.T, x1.T, strict=True)])
    size = max(max(a.max(), b.max()) - o for a, b, o in zip(x0.T, x1.T, origin, strict=True))
    cell = COINCIDE * size + NOISE * np.abs(x0).max()
    # Positions along one line rule out most points: few have one of the other set near them there
    near = _near(x0 @ PLANE_DIRECTION, x1 @ PLANE_DIRECTION, 2 * cell)
    x0, x1 = x0[near[0]], x1[near[1]]
    found: set[tuple[int, int]] = set()
    # Points in one cell of a grid coincide. A border may lie between two that do, so there are
    # four grids: a point at a border of one is well inside a cell of another
    for shift in ((0, 0), (0, 0.5), (0.5, 0), (0.5, 0.5)):
        grid = (np.rint((x - origin) / cell + shift).astype(np.int64) for x in (x0, x1))
        z0, z1 = ((z[:, 0] << 31) + z[:, 1] for z in grid)  # less than 2³⁰ each
        _, i, j = np.intersect1d(z0, z1, return_indices=True)
        found.update(zip(near[0][i].tolist(), near[1][j].tolist(), strict=True))
    i, j = np.array(sorted(found), dtype=np.intp).reshape(-1, 2).T
    return i, j


def _near(a, b, distance: float) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Numbers of those in a that have one of b within a distance, on a line, and the reverse."""
    orders = np.argsort(a), np.argsort(b)
    a, b = a[orders[0]], b[orders[1]]
    low = np.searchsorted(b, a - distance)  # a search for sorted values stays in the cache
    high = np.searchsorted(b, a + distance, side="right")
    near_a = low < high
    change = np.zeros(len(b) + 1, dtype=np.intp)
    np.add.at(change, low[near_a], 1)
    np.add.at(change, high[near_a], -1)
    near_b = np.cumsum(change[:-1]) > 0
    return np.sort(orders[0][near_a]), np.sort(orders[1][near_b])


def _shared_nodes(x0, x1) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Indices of coincident nodes of two chains, increasing in both."""
    i, j = _coincident(x0, x1)
    forward = j == np.maximum.accumulate(j) if len(j) else j
    return i[forward], j[forward]


def parametrise(c0: Chain, c1: Chain) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Common parameters (0 to 1) of the nodes of two facing chains, equal where nodes coincide."""
    s0, s1 = c0.arc, c1.arc
    i = j = np.empty(0, dtype=np.intp)
    if len(s0) > 2 and len(s1) > 2:
        i, j = _shared_nodes(c0.x[1:-1], c1.x[1:-1])
    at0 = np.concatenate(([0.0], s0[1:-1][i], [1.0]))
    at1 = np.concatenate(([0.0], s1[1:-1][j], [1.0]))
    s1 = np.interp(s1, at1, at0)
    if c0.closed and not len(i) and not np.allclose(c0.x[0], c1.x[0]):
        # No shared node: Γ1's first node sits where it projects on Γ0, a little off 0
        edge, position, _ = c0.project(c1.x[0])
        shift = s0[edge] + position * (s0[edge + 1] - s0[edge])
        s1 = s1 + (shift if shift < 0.5 else shift - 1)
    return s0, s1


def triangulate(s0, s1):
    """Triangles between two chains with known parameters of their nodes; see :func:`merge`."""
    return merge((s0[1:] + s0[:-1]) / 2, (s1[1:] + s1[:-1]) / 2)


def merge(m0, m1):
    """Triangles between two chains by the apex rule, from their edges' midpoints.

    The apex of an edge is the node of the other chain nearest to its midpoint m, that is, the node
    between the last edge whose midpoint is before m and the first one behind it. If midpoints are
    equal, Γ0's comes first.

    Args:
        m0: Increasing parameters of the midpoints of Γ0's edges, ``(num_edges0,)``.
        m1: The same for Γ1.

    Returns:
        For each triangle, in the order of travel: the side of its base edge (0 or 1), the index
        of this edge, and the index of its apex on the other chain; ``(num_edges0 + num_edges1,)``
        each.
    """
    m1 = m1 + COINCIDE
    side = np.repeat((0, 1), (len(m0), len(m1)))
    edge = np.concatenate((np.arange(len(m0)), np.arange(len(m1))))
    apex = np.concatenate((np.searchsorted(m1, m0), np.searchsorted(m0, m1)))
    order = np.argsort(np.concatenate((m0, m1)), kind="stable")
    return side[order], edge[order], apex[order]


@dataclass(frozen=True)
class Strip:
    """The triangles between two chains, and the hosts of their points on both."""

    chains: tuple[Chain, Chain]
    s: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
    """Parameters of the chains' nodes."""
    side: npt.NDArray[np.intp]
    edge: npt.NDArray[np.intp]
    apex: npt.NDArray[np.intp]

    @classmethod
    def between(cls, c0: Chain, c1: Chain) -> "Strip":
        """Mesh the strip between two facing chains."""
        s = parametrise(c0, c1)
        return cls((c0, c1), s, *triangulate(*s))

    @property
    def cell_nodes(self) -> npt.NDArray[np.intp]:
        """Chain nodes of each triangle: a base's two, then the apex, ``(num_cells, 3)``.

        Γ1 lies to the right of the direction of travel, so a base on Γ0 is turned round for
        counterclockwise triangles.
        """
        a = self.edge + (self.side == 0)
        return np.column_stack((a, 2 * self.edge + 1 - a, self.apex))

    @property
    def cells(self) -> npt.NDArray[np.int64]:
        """Vertices of each triangle: Γ0's nodes first, then Γ1's, ``(num_cells, 3)``."""
        c0, c1 = self.chains
        n0, n1 = (len(c.facets) + (not c.closed) for c in (c0, c1))
        on1 = np.column_stack((self.side, self.side, 1 - self.side)).astype(bool)
        return np.where(on1, n0 + self.cell_nodes % n1, self.cell_nodes % n0)

    @property
    def x(self) -> npt.NDArray[np.float64]:
        """Vertex coordinates, ``(num_vertices, 2)``."""
        return np.vstack([c.x[:-1] if c.closed else c.x for c in self.chains])

    @property
    def alpha(self) -> npt.NDArray[np.float64]:
        """α at the vertices, ``(num_vertices,)``."""
        return np.repeat((0.0, 1.0), [len(c.facets) + (not c.closed) for c in self.chains])

    @property
    def base(self) -> npt.NDArray[np.int32]:
        """Facet (on its side) of each triangle's base, ``(num_cells,)``."""
        base = np.empty(len(self.side), dtype=np.int32)
        for i, chain in enumerate(self.chains):
            base[self.side == i] = chain.facets[self.edge[self.side == i]]
        return base

    def hosts(self, points: npt.NDArray[np.float64]) -> Hosts:
        """Positions of points of the reference triangle on both surfaces.

        Nodes of Γ0 and Γ1 are found through their edge, points between them through the common
        parameter of the chains, without projection or search.

        Args:
            points: Reference points, ``(num_points, 2)``.
        """
        weights = np.column_stack((1 - points.sum(axis=1), points))
        on_base = np.isclose(weights[:, 2], 0)
        at_apex = np.isclose(weights[:, 2], 1)
        # Base nodes are (end, start) on Γ0 and (start, end) on Γ1
        along = np.where(self.side[:, None] == 0, weights[:, 0], weights[:, 1])  # (cell, point)
        s_nodes = np.empty((len(self.side), 3))
        for i in (0, 1):
            mine = self.side == i
            s_nodes[mine, :2] = self.s[i][self.cell_nodes[mine, :2]]
            s_nodes[mine, 2] = self.s[1 - i][self.apex[mine]]
        s_points = s_nodes @ weights.T
        if self.chains[0].closed:
            s_points %= 1
        facets, X = [], []
        for i in (0, 1):
            c, s = self.chains[i], self.s[i]
            at = np.mod(s_points - s[0], 1) + s[0] if c.closed else s_points
            edge = np.searchsorted(s[1:-1], at, side="right")
            position = (at - s[edge]) / (s[edge + 1] - s[edge])
            mine = self.side == i
            exact = mine[:, None] & on_base
            edge[exact] = np.broadcast_to(self.edge[:, None], edge.shape)[exact]
            position[exact] = along[exact]
            exact = ~mine[:, None] & at_apex
            last = np.minimum(self.apex, len(c.facets) - 1)
            edge[exact] = np.broadcast_to(last[:, None], edge.shape)[exact]
            position[exact] = np.broadcast_to((self.apex - last)[:, None], edge.shape)[exact]
            facets.append(c.facets[edge])
            X.append((c.X[edge, 0] + position * (c.X[edge, 1] - c.X[edge, 0]))[..., None])
        alpha_nodes = np.where(self.side[:, None] == 0, (0.0, 0.0, 1.0), (1.0, 1.0, 0.0))
        return Hosts(alpha_nodes @ weights.T, (facets[0], facets[1]), (X[0], X[1]))


def mesh_strip(surface0: Surface, surface1: Surface) -> GapCells:
    """Mesh Σ between two surfaces in the plane: see the module's docstring.

    Raises:
        InterfaceError: Edges that don't form chains, or don't face each other.
    """
    chains0, chains1 = pieces(surface0, surface1)
    pairs = facing(surface0, surface1, chains0, chains1)
    strips = [Strip.between(*pair) for pair in pairs]
    patch = np.empty(len(surface1.facets), dtype=np.int32)
    for i, chain in enumerate(chains1):
        patch[chain.facets] = i
    X = np.vstack([chain.X for _, chain in pairs])
    facets = np.concatenate([chain.facets for _, chain in pairs])
    shares = np.abs(np.diff(X)[:, 0])
    covered, least = covered_parts(surface1, facets, X[:, :, None], shares)
    offsets = np.cumsum([0] + [len(strip.x) for strip in strips])
    side = np.concatenate([strip.side for strip in strips])
    base = np.concatenate([strip.base for strip in strips])
    normal = np.empty((len(base), 2))
    rank = np.empty(len(base), dtype=np.int32)
    for i, surface in enumerate((surface0, surface1)):
        mine = side == i
        normal[mine] = (1 - 2 * i) * surface.normals[base[mine]]
        rank[mine] = surface.owner[base[mine]]
    return GapCells(
        x=np.vstack([strip.x for strip in strips]),
        alpha=np.concatenate([strip.alpha for strip in strips]),
        cells=np.vstack([strip.cells + offset for strip, offset in zip(strips, offsets)]),
        normals=lambda cells: normal[cells],
        rank=rank,
        patch=patch,
        covered=covered,
        least=least,
        degree=max(surface0.element.degree, surface1.element.degree),
        hosts=lambda X, cells: Hosts.concatenate([strip.hosts(X) for strip in strips])[cells],
    )
