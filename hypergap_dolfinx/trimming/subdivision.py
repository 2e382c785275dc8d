# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A piece of a surface with the other one's outline drawn on it, and its cut triangles."""

from collections import defaultdict
from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.surface.nearest import on_loop
from hypergap_dolfinx.surface.pieces import Side
from hypergap_dolfinx.surface.trace import lengths
from hypergap_dolfinx.trimming.curved_outlines import Arcs, Edge, OutlineCurves
from hypergap_dolfinx.trimming.delaunay import Cutting
from hypergap_dolfinx.trimming.insertion import Nodes
from hypergap_dolfinx.trimming.outlines import Edges, Rim, locate
from hypergap_dolfinx.trimming.tolerances import BLUNT, CHORDS, ROUNDS_BLUNT

Place = tuple[int, int, float]
"""Vertices of an edge, and a parameter on it."""
Node = tuple[Place | None, Place | None]
"""A corner of one outline on the other one, by its places on either; or a node of one of them."""
IsRun = Callable[[npt.ArrayLike], npt.NDArray[np.bool_]]


def _chains(loop: list[tuple], twins: dict[int, int]) -> list[list[tuple[int, int]]]:
    """Pairs of nodes of an outline, turned round, between twins and runs."""
    first = next((k for k, edge in enumerate(loop) if edge[6] or edge[5] in twins), 0)
    chains: list[list[tuple[int, int]]] = [[]]
    for edge in (*loop[first:], *loop[:first]):
        if edge[6] or edge[5] in twins:
            chains.append([])
        if not edge[6]:
            chains[-1].append((edge[5], edge[4]))
    return [chain for chain in chains if chain]


class Cut(Nodes):
    """A piece with inserted nodes and edges; its own triangles stay until the end."""

    def __init__(self, side: Side, rims: list[Rim], is_run: IsRun, snap: float):
        """A piece.

        Args:
            side: The piece.
            rims: Loops of its outline, but for those that coincide with the other piece's.
            is_run: Tells which places on them are on the other's outline.
            snap: Distance below which two nodes are one.
        """
        super().__init__(side, snap)
        self.rims, self.is_run = rims, is_run
        self.starts = np.cumsum([0] + [len(rim.x) for rim in rims])
        self.segments: dict[int, list[tuple[int, int]]] = defaultdict(list)  # in each triangle
        self.runs: list[tuple[int, int]] = []  # edges along the other's outline
        self.path: list[tuple[int, int]] = []  # the other's outline, its inside on the left
        self.curves: OutlineCurves | None = None  # of it, if it is curved

    # The piece's own outline

    def put(self, place: float) -> int:
        """The node at a place on the outline (of :class:`Shared`), which may be new."""
        i = int(np.searchsorted(self.starts, place, side="right")) - 1
        return self.on_edge(*self.rims[i].place(place - self.starts[i]))

    def bend(self):
        """Put nodes on curved edges, except in runs."""
        num = CHORDS * self.side.surface.geometry.degree
        for rim, start in zip(self.rims, self.starts):
            for e in np.flatnonzero(rim.num > 1):
                places = start + rim.base[e] + rim.num[e] * np.arange(1, num) / num
                for place in places[~self.is_run(places)]:
                    self.put(place)

    def outline(self) -> list[list[tuple]]:
        """Loops of edges.

        Each has the vertices of the edge that it is part of, parameters on it and nodes at its
        start and end, and True if it is in a run.
        """
        loops: list[list[tuple]] = []
        for rim, start in zip(self.rims, self.starts):
            loops.append([])
            middles = []
            for e, (a, b) in enumerate(rim.ends.tolist()):
                s = [0.0, *(r for r, _ in self.on.get((min(a, b), max(a, b)), [])), 1.0]
                s = s if a < b else [1 - r for r in s[::-1]]
                nodes = self.between(a, b)
                loops[-1] += zip(*([c] * (len(s) - 1) for c in (a, b)), s, s[1:], nodes, nodes[1:])
                middles += [start + rim.base[e] + rim.num[e] * (r + t) / 2 for r, t in pairwise(s)]
            runs = self.is_run(middles).tolist()
            loops[-1] = [(*edge, run) for edge, run in zip(loops[-1], runs, strict=True)]
        return loops

    def edges(self) -> tuple[list[tuple], Edges]:
        """The outline's edges that aren't in runs, and their places in space."""
        places = [edge[:6] for loop in self.outline() for edge in loop if not edge[6]]
        start, normal0 = self.places([place[4] for place in places])
        end, normal1 = self.places([place[5] for place in places])
        normal = normal0 + normal1
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        return places, Edges(start, end, normal)

    # The other piece's outline

    def draw(self, u: int, v: int) -> list[tuple[int, float]]:
        """Put a segment between two nodes into the triangles that it crosses.

        Returns:
            The nodes along it, and their parameters on it, from 0 to 1. Those up to where it leaves
            the piece, if it does; nothing is drawn then.
        """
        passed, triangles, done = [(u, 0.0)], [], 0.0
        start, target = self.flat(u), self.flat(v)
        along = target - start
        square, across = float(along @ along), self._across(u, v)
        while u != v:
            near = self.triangles_at(u)
            common = set(near).intersection(self.triangles_at(v))
            steps: list[tuple] = [(1.0, min(common), (v,))] if common else []
            for triangle in near if not common else ():
                exits = self._exits(u, triangle, start, along / square, across)
                steps += [(progress, triangle, step) for progress, step in exits if progress > done]
            if not steps:
                return passed
            done, triangle, step = min(steps, key=lambda step: step[0])
            w = self.on_edge(*step) if len(step) == 3 else step[0]
            if w != u:
                passed.append((w, done))
                triangles.append(triangle)
            u = w
        for ((a, _), (b, _)), triangle in zip(pairwise(passed), triangles, strict=True):
            self._join(a, b, triangle)
        return passed

    def _across(self, u: int, v: int) -> npt.NDArray[np.float64]:
        """Unit normal of the plane in which a segment between two nodes is drawn."""
        ends = np.array([self.triangles_at(node)[0] for node in (u, v)])
        across = np.cross(self.flat(v) - self.flat(u), self.side.normals[ends].sum(axis=0))
        return across / max(float(np.linalg.norm(across)), 1e-300)

    def _exits(self, u: int, triangle: int, start, along, across) -> Iterator[tuple]:
        """Exits of a plane from a triangle: progress, and a vertex or an edge with a parameter."""
        v = self.side.triangles[triangle].tolist()
        x = self.side.x[v] - start
        d = [0.0 if abs(s) <= self.snap else s for s in (x @ across).tolist()]
        t = (x @ along).tolist()
        at = () if u < self.num_vertices else self.at[u - self.num_vertices]
        own = set(at[:2]) if len(at) == 3 else {u}
        for k in range(3):
            m = (k + 1) % 3
            if d[k] == 0 and v[k] != u:
                yield t[k], (v[k],)
            if d[k] * d[m] < 0 and not (own <= {v[k], v[m]}):
                s = d[k] / (d[k] - d[m])
                yield t[k] + s * (t[m] - t[k]), (v[k], v[m], s)

    def _join(self, u: int, v: int, triangle: int):
        if self.edge_of((u, v)):
            self.runs.append((u, v))
        elif u != v:
            self.segments[triangle].append((u, v))
            self.path.append((u, v))

    def follow(
        self, other: "Cut", outline, others, twins: dict[int, int], at_corners: bool
    ) -> list[Node]:
        """Draw the parts of the other piece's outline that lie inside.

        Args:
            other: The other piece.
            outline: The own outline's loops of edges.
            others: The other piece's.
            twins: Nodes of the own outline at the same place as nodes of the other one.
            at_corners: True if outlines may meet at corners that they pass nearby.

        Returns:
            Nodes without which it can't be drawn: a corner at which a part leaves the piece, where
            outlines meet; nodes of the other one in curved parts that aren't where they are drawn.

        Raises:
            InterfaceError: A part leaves the piece, and not at a corner.
        """
        every = [edge for loop in outline for edge in loop]
        self.runs += [edge[4:6] for edge in every if edge[6]]
        own = {edge[4:6] for edge in every}
        chains = [chain for loop in others for chain in _chains(loop[::-1], twins)]
        parts = [pair for chain in chains for pair in chain]
        if not parts:
            return []
        (x, n), (y, m) = (other.places([pair[i] for pair in parts]) for i in (0, 1))
        length = np.linalg.norm(x - y, axis=1)
        length[locate(self.side, (x + y) / 2, n + m)[0] < 0] *= -1
        starts = np.cumsum([0] + [len(chain) for chain in chains])[:-1]
        inside = np.add.reduceat(length, starts) > 0
        crossing = []
        for chain, within in zip(chains, inside.tolist(), strict=True):
            here = twins.get(chain[0][0], -1), twins.get(chain[0][1], -1)
            if len(chain) == 1 and (here in own or here[::-1] in own):
                self.runs.append(here)
            elif within:
                crossing += chain
        free = sorted({node for pair in crossing for node in pair if node not in twins})
        place, normal = other.places(free)
        triangle, weights = locate(self.side, place, normal)
        nodes = dict(twins)
        for node, t, w, x in zip(free, triangle.tolist(), weights, place, strict=True):
            nodes[node] = self.in_triangle(t, w) if t >= 0 else self._beside(x)
        drawn = []
        for u, v in crossing:
            if nodes[u] != nodes[v]:
                edge, r0, r1 = other.part(u, v)
                passed = self.draw(nodes[u], nodes[v])
                if passed[-1][0] != nodes[v]:
                    apart = [np.linalg.norm(other.flat(k) - self.flat(nodes[k])) for k in (u, v)]
                    reach = float(max(apart)) if at_corners else 0.0
                    ends, taken = (nodes[u], nodes[v]), set(twins.values())
                    corner, s = self._corner(passed[-1][0], *ends, taken, reach)
                    return [(corner, (*edge[1:], r0 + s * (r1 - r0)))]
                drawn.append(((edge, r0, r1), passed))
        if all(cut.side.is_affine for cut in (self, other)):
            return []
        lost = self._settle(OutlineCurves(self.side, other.side), drawn, set(nodes.values()))
        return [(None, place) for place in lost if other.is_free(*place)]

    def _corner(
        self, node: int, u: int, v: int, taken: set[int], reach: float
    ) -> tuple[Place, float]:
        """The outline's vertex at which a segment from u to v leaves the piece at a node.

        Where two surfaces are a distance apart, seeing one along the other's normals moves outlines
        by less than that distance: by so much a segment may pass a vertex on the wrong side.

        Args:
            node: The node.
            u: The segment's first node.
            v: Its last node.
            taken: Nodes that aren't taken.
            reach: Distance of the vertex from the plane in which the segment is drawn that isn't
                reached: the surfaces' distance at u or v, the larger one.

        Returns:
            Place of the vertex nearest to the plane, of the edge or the two edges that the node
            lies at, and its parameter on the segment.

        Raises:
            InterfaceError: There is none.
        """
        start, target, across = self.flat(u), self.flat(v), self._across(u, v)
        along = target - start
        at = (node,) if node < self.num_vertices else self.at[node - self.num_vertices]
        found = None
        for a, b in (pair for rim in self.rims for pair in rim.ends.tolist()):
            if len(at) == 2 or len({a, b}.intersection(at)) < min(len(at), 2):
                continue
            for c, d in ((a, b), (b, a)):
                way = self.side.x[c] - start
                s = float(way @ along / (along @ along))
                apart = abs(float(way @ across))
                if 0 < s < 1 and c not in taken and apart < reach:
                    reach, found = apart, ((c, d, 0.0), s)
        if found:
            return found
        raise InterfaceError(
            f"the outline of the other side can't be drawn on {self.side.surface.name} from "
            f"{spot(start)} to {spot(target)}: do the surfaces have the same shape there?"
        )

    def _beside(self, place) -> int:
        """The node of the own outline that is nearest to a place, which may be new."""
        found = []
        for rim, start in zip(self.rims, self.starts):
            there = on_loop(place[None], rim.x)
            found.append((float(lengths(there.apart)[0]), rim, there.edge[0] + there.s[0]))
        _, rim, at = min(found, key=lambda entry: entry[0])
        return self.on_edge(*rim.place(min(at, np.nextafter(len(rim.x), 0))))

    def part(self, u: int, v: int) -> tuple[Edge, float, float]:
        """The edge that two nodes of the own outline lie on, and their parameters on it."""
        edge = self.edge_of((u, v))
        assert edge
        return (self.around(*edge)[0], *edge), self.parameter(u, edge), self.parameter(v, edge)

    def arcs(self, edges: list[tuple[int, int]]) -> Arcs:
        """Edges by their vertices."""
        return Arcs.between(self.side, [self.around(*edge)[0] for edge in edges], edges)

    def _settle(self, curves: OutlineCurves, drawn, located: set[int]) -> list[Place]:
        """Move nodes to crossings of the other's curved outline with edges.

        Args:
            curves: The outline.
            drawn: Its parts, and the nodes along each.
            located: Nodes at ends of parts.

        Returns:
            Middles of parts that don't cross the edges that they are drawn across.
        """
        for (edge, r0, r1), passed in drawn:
            curves.add(edge, [n for n, _ in passed], [r0 + s * (r1 - r0) for _, s in passed])
        at = {
            node: self.at[node - self.num_vertices]
            for node in curves.between_ends()
            if node >= self.num_vertices and node not in located
        }
        at = {node: place for node, place in at.items() if len(place) == 3}  # on edges
        arcs = self.arcs([place[:2] for place in at.values()])
        new, beyond = curves.settled(list(at), arcs, np.array([place[2] for place in at.values()]))
        settled = set(located)
        for edge in dict.fromkeys(at[node][:2] for node in new):
            if self.slide(edge, new):
                settled.update(node for _, node in self.on[edge] if node in new)
        curves.close(settled)
        self.curves = curves
        lost = set(at) - settled - beyond
        return [
            (*edge[1:], (r0 + r1) / 2)
            for (edge, r0, r1), passed in drawn
            if not lost.isdisjoint(node for node, _ in passed[1:-1])
        ]

    # The triangles

    def triangulation(self) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """Nodes of all triangles of the cut piece, the triangle each is cut from, and weights."""
        t = self.side.triangles
        made: dict[int, tuple] = {}
        for rest in range(ROUNDS_BLUNT, -1, -1):
            touched = set(self.inside) | set(self.segments)
            touched.update(triangle for edge in self.on for triangle in self.around(*edge))
            fresh = sorted(touched.difference(made))
            made.update((triangle, self._cut(triangle)) for triangle in fresh)
            changed: set[int] = set()
            for triangle in fresh if rest else ():
                if triangle not in changed:
                    changed |= self._widen(triangle, *made[triangle])
            if not changed:
                break
            made = {triangle: cut for triangle, cut in made.items() if triangle not in changed}
        new, origin, weights = [], [], []
        for triangle in sorted(touched):
            nodes, w, parts = made[triangle]
            new += [[nodes[i] for i in part] for part in parts]
            weights += [w[list(part)] for part in parts]
            origin += [triangle] * len(parts)
        whole = np.setdiff1d(np.arange(len(t)), sorted(touched))
        cells = np.vstack((t[whole], np.array(new, dtype=np.intp).reshape(-1, 3)))
        hosts = np.concatenate((whole, np.array(origin, dtype=np.intp)))
        unit = np.broadcast_to(np.eye(3), (len(whole), 3, 3))
        return cells, hosts, np.vstack((unit, np.array(weights).reshape(-1, 3, 3)))

    def _widen(self, triangle: int, nodes, weights, cells) -> set[int]:
        """Put nodes into edges opposite to blunt angles of a cut triangle's parts.

        In a triangle with an angle near 180° functions of degree 2 can have gradients of any size:
        the vertex of that angle lies nearly on the line between the others, but its value needn't.

        Returns:
            The triangles that have to be cut again.
        """
        x = weights @ self._plane(triangle)
        changed: set[int] = set()
        feet: set[tuple[int, int]] = set()  # edges with a new node
        for a, b, c in ((*cell[k:], *cell[:k]) for cell in cells for k in range(3)):
            d, e, along = x[b] - x[a], x[c] - x[a], x[c] - x[b]
            lengths = float(np.sqrt((d @ d) * (e @ e)))
            if d @ e < BLUNT * lengths and (min(b, c), max(b, c)) not in feet:
                feet.add((min(b, c), max(b, c)))
                s = -float(d @ along) / float(along @ along)
                place = (1 - s) * weights[b] + s * weights[c]
                changed |= self._put(triangle, nodes[b], nodes[c], s, place)
        return changed

    def _put(self, triangle: int, u: int, v: int, s: float, weights) -> set[int]:
        """Put a node between nodes u and v of a triangle, at s from 0 to 1.

        Arguments include its barycentric coordinates there. Returns the changed triangles.
        """
        if edge := self.edge_of((u, v)):
            self.on_edge(*edge, (1 - s) * self.parameter(u, edge) + s * self.parameter(v, edge))
            return set(self.around(*edge))
        r = np.nan
        if self.curves:
            weights, r = self.curves.foot(u, v, s, triangle, weights)
        node = self.in_triangle(triangle, weights)
        if self.curves:
            self.curves.split(u, v, node, r)
        for segments in (self.segments[triangle], self.path):
            for i, pair in enumerate(segments):
                if set(pair) == {u, v}:
                    segments[i : i + 1] = [(pair[0], node), (node, pair[1])]
                    break
        return {triangle}

    def _plane(self, triangle: int) -> npt.NDArray[np.float64]:
        """Corners of a triangle in its plane, scaled to a first edge of length one, ``(3, 2)``."""
        x = self.side.x[self.side.triangles[triangle]]
        e, f = x[1] - x[0], x[2] - x[0]
        length = np.linalg.norm(e)
        return np.array(
            [(0, 0), (1, 0), ((e @ f) / length**2, np.linalg.norm(np.cross(e, f)) / length**2)]
        )

    def _cut(self, triangle: int):
        """Nodes of a cut triangle, their weights, and the triangles between them."""
        corners = self.side.triangles[triangle].tolist()
        nodes: list[int] = list(corners)
        edges: list[range] = []
        for k in range(3):
            inner = self.between(corners[k], corners[(k + 1) % 3])[1:-1]
            edges.append(range(len(nodes), len(nodes) + len(inner)))
            nodes += inner
        first = len(nodes)
        nodes += self.inside.get(triangle, [])
        w = np.zeros((len(nodes), 3))
        w[:3] = np.eye(3)
        for i, node in enumerate(nodes[3:], 3):
            at = self.at[node - self.num_vertices]
            if len(at) == 2:
                w[i] = at[1]
            else:
                w[i, corners.index(at[0])], w[i, corners.index(at[1])] = 1 - at[2], at[2]
        cutting = Cutting((w @ self._plane(triangle)).tolist())
        for k, between in enumerate(edges):
            last = k
            for point in between:
                cutting.split_edge(last, (k + 1) % 3, point)
                last = point
        for point in range(first, len(nodes)):
            cutting.insert(point)
        number = {node: i for i, node in enumerate(nodes)}
        for u, v in self.segments.get(triangle, []):
            if not cutting.fix(number[u], number[v]):
                raise InterfaceError(
                    f"{self.side.surface.name} can't be cut along the other side's outline at "
                    f"{spot(self.side.x[corners])}"
                )
        cutting.relax()
        return nodes, w, cutting.triangles()

    def drawn(self) -> list[tuple[int, int]]:
        """Edges along the other's outline, from node to node."""
        found = list(self.path)
        for u, v in self.runs:
            a, b = self.edge_of((u, v)) or (u, v)
            nodes = self.between(a, b)
            i, j = nodes.index(u), nodes.index(v)
            run = nodes[i : j + 1] if i < j else nodes[j : i + 1][::-1]
            found += pairwise(run)
        return found
