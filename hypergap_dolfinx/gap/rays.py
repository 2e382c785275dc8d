# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Contact's Σ in the plane: fans between Γ1's vertices and what Γ1's rays cut from Γ0.

From the middle of each edge of Γ1 a ray goes along its normal to Γ0. Between two rays Γ0 is the
base of a fan of cells with Γ1's vertex as apex, which has their whole weight; the edge of Γ1 is
the base of a cell with the ray's end as apex, of which the foot is the edge's middle: ∂ψ/∂α is a
half for both its vertices. So weights are never negative, and nothing jumps as nodes pass nodes.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.moving import COVERED
from hypergap_dolfinx.gap.strip import chains
from hypergap_dolfinx.gap.surface import Surface

END = 1e-7
"""Distance along an edge, in its lengths, of ends that are opposite to each other."""
FACES = 0.25
"""Cosine between edges of Γ0 and Γ1 from which they face each other."""
KINK = 0.5
"""Cosine of the turn of a surface from which it goes on beyond a vertex."""
FARTHER = 8.0
"""Longest way on Γ0 between neighbouring rays, in lengths of their edges."""
CHUNK = 256  # edges of Γ1 at a time
REACHED = 0.999
"""Part of an edge of Γ1 that Γ0 must reach for weights of both vertices, if only one had them."""


class Fixed(IntEnum):
    """Parameters that don't depend on displacements: an edge's start, end and middle."""

    START, END, MIDDLE = range(3)


@dataclass
class Fans:
    """Cells of Σ: a base between two parameters of a facet, and an apex on the other side.

    Parameters are reference coordinates in facets: 0, 1 and a half, then those of
    crossings, which move with the bodies.
    """

    side: list[int] = field(default_factory=list)
    """Side of the base."""
    base: list[int] = field(default_factory=list)
    """Its facet."""
    apex: list[int] = field(default_factory=list)
    """The apex' facet."""
    parameters: list[tuple[int, int, int]] = field(default_factory=list)
    """Of the base's start and end, and of the apex."""
    vertices: list[tuple[int, int]] = field(default_factory=list)
    """Vertices of Γ1 that share the cell; each has one half."""
    facets: list[tuple[int, int]] = field(default_factory=list)
    """Facets on Γ0 and on Γ1 of each crossing: their points at one position along Γ1's chord."""
    unknown: list[int] = field(default_factory=list)
    """Side on which a crossing moves along its facet."""
    given: list[float] = field(default_factory=list)
    """Reference coordinate on the other side."""
    guess: list[float] = field(default_factory=list)
    """Reference coordinate of what moves, if facets were straight."""
    whole: set[int] = field(default_factory=set)
    """Edges of Γ1 of which both vertices have a weight."""

    def crossing(self, facets: tuple[int, int], unknown: int, given: float, guess: float) -> int:
        """Add one; returns the number of its parameter."""
        self.facets.append(facets)
        self.unknown.append(unknown)
        self.given.append(given)
        self.guess.append(guess)
        return len(self.given) + Fixed.MIDDLE

    def add(self, side, base, apex, parameters, vertices):
        """Add a cell."""
        self.side.append(side)
        self.base.append(base)
        self.apex.append(apex)
        self.parameters.append(parameters)
        self.vertices.append(vertices)


Place = tuple[int, int]
"""A facet and the number of a parameter on it."""


@dataclass(frozen=True)
class _Path:
    """Order of Γ0's facets."""

    chain: npt.NDArray[np.intp]
    position: npt.NDArray[np.intp]
    facets: list[list[int]]
    closed: list[bool]
    arc: npt.NDArray[np.float64]

    @classmethod
    def on(cls, surface: Surface) -> "_Path":
        found = chains(surface, _kinks(surface))
        num = len(surface.facets)
        chain, position = np.empty(num, dtype=np.intp), np.empty(num, dtype=np.intp)
        arc = np.empty(num)
        for c, part in enumerate(found):
            chain[part.facets], position[part.facets] = c, np.arange(len(part.facets))
            arc[part.facets] = np.cumsum(part.lengths) - part.lengths / 2
        facets = [part.facets.tolist() for part in found]
        return cls(chain, position, facets, [part.closed for part in found], arc)

    def steps(self, a: int, b: int) -> int:
        """How many facets on from one to another of its chain, the shorter way round a loop."""
        c = self.chain[a]
        steps = int(self.position[b] - self.position[a])
        if self.closed[c]:
            half = len(self.facets[c]) // 2
            steps = (steps + half) % len(self.facets[c]) - half
        return steps

    def between(self, a: Place, b: Place) -> list[tuple[int, int, int]]:
        """Facets from one place to another, and the parameters where each starts and ends."""
        steps = self.steps(a[0], b[0])
        if steps == 0:
            return [(a[0], a[1], b[1])]
        if steps < 0:
            return [(facet, end, start) for facet, start, end in self.between(b, a)]
        line, first = self.facets[self.chain[a[0]]], int(self.position[a[0]])
        middle = [(line[(first + k) % len(line)], Fixed.START, Fixed.END) for k in range(1, steps)]
        return [(a[0], a[1], Fixed.END), *middle, (b[0], Fixed.START, b[1])]


def _kinks(surface: Surface) -> npt.NDArray[np.bool_]:
    """Vertices at which a surface turns too far to go on, ``(num_vertices,)``."""
    start, end = surface.facets.T
    before = np.full(len(surface.x), -1)
    before[end] = np.arange(len(end))
    with_one = np.flatnonzero(before[start] >= 0)
    turn = np.einsum(
        "fi,fi->f", surface.normals[with_one], surface.normals[before[start[with_one]]]
    )
    kinks = np.zeros(len(surface.x), dtype=bool)
    kinks[start[with_one[turn < KINK]]] = True
    return kinks


class _Rays:
    """Where the rays of Γ1's edges meet Γ0, and where Γ0's ends are opposite of Γ1."""

    def __init__(self, surface0: Surface, surface1: Surface, path: _Path):
        """Look for the nearest facet that faces each ray."""
        self.path = path
        v0, v1 = surface0.x[surface0.facets], surface1.x[surface1.facets]
        self.length = np.linalg.norm(v1[:, 1] - v1[:, 0], axis=1)
        num, line = len(v1), [(part[0], part[-1]) for part in path.facets]
        open_ends = [e for e, closed in zip(line, path.closed, strict=True) if not closed]
        self.first = np.array([e[0] for e in open_ends], dtype=np.intp)
        self.last = np.array([e[1] for e in open_ends], dtype=np.intp)
        t0 = v0[:, 1] - v0[:, 0]
        size0 = np.linalg.norm(t0, axis=1)
        hit = np.full((num, 3), -1)  # facet of Γ0 at the start, the end and the middle
        at_hit = np.zeros((num, 3))  # where on it
        best = [np.full((num, len(ends)), np.inf) for ends in (self.first, self.last)]
        foot = [np.zeros((num, len(ends))) for ends in (self.first, self.last)]
        for start in range(0, num, CHUNK):
            some = slice(start, min(start + CHUNK, num))
            a, c = v1[some, 0], v1[some, 1] - v1[some, 0]
            length = self.length[some, None]
            # Positions along Γ1's edges, in lengths of them, of both ends of Γ0's
            s = [
                ((v0[None, :, k] - a[:, None]) * c[:, None]).sum(axis=2) / length**2 for k in (0, 1)
            ]
            faces = (s[0] - s[1]) * length > FACES * size0
            for k, tau in ((Fixed.START, 0.0), (Fixed.END, 1.0), (Fixed.MIDDLE, 0.5)):
                before, behind = s[0] > tau, s[1] <= tau
                before[:, self.first] = s[0][:, self.first] > tau - END
                behind[:, self.last] = s[1][:, self.last] <= tau + END
                row, facet = np.nonzero(faces & before & behind)
                t = np.clip((s[0][row, facet] - tau) / (s[0] - s[1])[row, facet], 0, 1)
                x = v0[facet, 0] + t[:, None] * t0[facet]
                far = np.linalg.norm(x - a[row] - tau * c[row], axis=1)
                order = np.lexsort((far, row))
                rows, index = np.unique(row[order], return_index=True)
                hit[start + rows, k] = facet[order[index]]
                at_hit[start + rows, k] = t[order[index]]
            for i, ends in enumerate((self.first, self.last)):
                at = s[i][:, ends]
                x = v0[ends, i][None] - a[:, None] - at[..., None] * c[:, None]
                far = np.linalg.norm(x, axis=2)
                far[~faces[:, ends] | (at <= END) | (at >= 1 - END)] = np.inf
                best[i][some], foot[i][some] = far, at
        self.hit, self.t = hit.tolist(), at_hit.tolist()
        # What is opposite of both ends of a facet of Γ1, where that is known
        self.walls: dict[tuple[int, int], Place] = {}
        # The facet of Γ1 that is nearest to each end of Γ0, and where its foot is
        self.cut: list[dict[int, tuple[int, float]]] = [{}, {}]
        for i, ends in enumerate((self.first, self.last)):
            for j, end in enumerate(ends.tolist()):
                f = int(best[i][:, j].argmin())
                if np.isfinite(best[i][f, j]):
                    self.cut[i][f] = end, float(foot[i][f, j])

    def at_end(self, facet: int, k: int) -> int:
        """Whether Γ0 ends where a ray meets it, and how: the parameter, or −1."""
        e, t = self.hit[facet][k], self.t[facet][k]
        if t == 0 and (self.first == e).any():
            return Fixed.START
        return Fixed.END if t == 1 and (self.last == e).any() else -1


@dataclass
class _Covered:
    """The part of an edge of Γ1 that Γ0 is opposite of."""

    limits: tuple[int, int]
    """Parameters of its start and its end."""
    places: tuple[Place, Place]
    """What is opposite of both, on Γ0."""
    middle: Place | None
    """What is opposite of the middle, if both vertices have multipliers."""
    owner: int
    """Number of the vertex (0 or 1) that has all, if only one has."""


def _cover(fans: Fans, rays: _Rays, f: int, least: float) -> _Covered | None:
    """What of an edge of Γ1 is covered; by more than the least both vertices have a weight."""
    position, cut = [0.0, 1.0], [rays.cut[1].get(f), rays.cut[0].get(f)]
    if cut[0] is not None and cut[1] is not None and cut[0][1] >= cut[1][1]:
        # Two parts of Γ0 with a hole between them: the larger counts
        cut[int(cut[1][1] < 1 - cut[0][1])] = None
    limits: list[int] = [Fixed.START, Fixed.END]
    places: list[Place] = []
    for k in (0, 1):
        if (f, k) in rays.walls:
            position[k] = float(k)
            places.append(rays.walls[f, k])
        elif (there := cut[k]) is not None:
            position[k] = there[1]
            limits[k] = fans.crossing((there[0], f), 1, 1.0 - k, there[1])
            places.append((there[0], (Fixed.END, Fixed.START)[k]))
        elif rays.hit[f][k] < 0:
            return None
        else:
            e = rays.hit[f][k]
            parameter = rays.at_end(f, k)
            if parameter < 0:
                parameter = fans.crossing((e, f), 0, float(k), rays.t[f][k])
            places.append((e, parameter))
    middle, e = None, rays.hit[f][Fixed.MIDDLE]
    if position[1] - position[0] > least and e >= 0:
        fans.whole.add(f)
        middle = e, fans.crossing((e, f), 0, 0.5, rays.t[f][Fixed.MIDDLE])
    owner = int(position[0] > 1 - position[1])
    return _Covered((limits[0], limits[1]), (places[0], places[1]), middle, owner)


def cast(
    surface0: Surface,
    surface1: Surface,
    whole: Collection[int] = (),
    walls: Sequence[tuple[int, int]] = (),
) -> Fans:
    """Find Σ's cells between two surfaces where they are.

    With a vertex' weight the bodies move a little: that one comes and another goes at one place
    would leave places where neither is right.

    Args:
        surface0: Γ0.
        surface1: Γ1.
        whole: Edges of Γ1 of which both vertices had a weight.
        walls: Vertices of Γ1 and of Γ0 that are opposite whatever the rays say: the ends at a wall.

    Raises:
        InterfaceError: A surface branches.
    """
    fans, path = Fans(), _Path.on(surface0)
    rays = _Rays(surface0, surface1, path)
    for a, b in walls:
        (f,), (k,) = np.nonzero(surface1.facets == a)
        (e,), (i,) = np.nonzero(surface0.facets == b)
        rays.walls[int(f), int(k)] = int(e), int(i)
    start, end = surface1.facets.T
    least = np.where(np.isin(np.arange(len(start)), list(whole)), COVERED, REACHED).tolist()
    covered = [_cover(fans, rays, f, least[f]) for f in range(len(start))]
    for f, part in enumerate(covered):
        if part is None:
            continue
        both = int(start[f]), int(end[f])
        if part.middle is not None:
            place, vertices = part.middle, both
        else:
            place = part.places[1 - part.owner]
            vertices = both[part.owner], both[part.owner]
        fans.add(1, f, place[0], (*part.limits, place[1]), vertices)
    before, behind = (np.full(len(surface1.x), -1) for _ in range(2))
    before[end], behind[start] = np.arange(len(end)), np.arange(len(start))
    kinks = _kinks(surface1).tolist()
    for a, beside in enumerate(zip(before.tolist(), behind.tolist(), strict=True)):
        # Γ0 runs against Γ1: a fan goes from what is behind the vertex to what is before it
        ends: list[Place | None] = [None, None]
        for i, f in enumerate(beside):
            part = covered[f] if f >= 0 else None
            if part is not None and part.middle is not None:
                ends[i] = part.middle
            elif part is not None and part.owner == 1 - i:
                ends[i] = part.places[i]
        _fan(fans, rays, covered, a, beside, ends, kinks[a])
    return fans


def _fan(fans: Fans, rays: _Rays, covered, a: int, edges: Place, ends, kink: bool):
    """Add the fan of a vertex, or one on each side of it."""
    path, (left, right) = rays.path, ends
    vertices = a, a

    def fan(begin: Place, end: Place, apex: Place):
        for facet, s1, s2 in path.between(begin, end):
            fans.add(0, facet, apex[0], (s1, s2, apex[1]), vertices)

    if left and right and not kink and path.chain[left[0]] == path.chain[right[0]]:
        c, way = path.chain[left[0]], abs(path.arc[left[0]] - path.arc[right[0]])
        if path.closed[c]:
            way = min(way, path.arc[path.facets[c][-1]] - way)
        if way <= FARTHER * (rays.length[edges[0]] + rays.length[edges[1]]):
            fan(right, left, (edges[1], Fixed.START))
            return
    for i, place in enumerate((left, right)):
        if place is None:
            continue
        part, f = covered[edges[i]], edges[i]
        # On the vertex' own side its edge ends, or what is covered of it
        own = part.places[1 - i]
        if path.chain[own[0]] != path.chain[place[0]]:
            continue
        apex = f, part.limits[1 - i]
        fan(*((own, place) if i == 0 else (place, own)), apex)
