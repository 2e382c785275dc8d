# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Search for touching bodies and their facets, the sides of an assembly's ties."""

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.algebra.checks import label
from hypergap_dolfinx.core import graph
from hypergap_dolfinx.core.collective import raise_on_all
from hypergap_dolfinx.core.intersection import axes_across, common_part
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.surface.boundary import Boundary, arc_height, equal_rows, gathered
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.search import meeting
from hypergap_dolfinx.surface.tolerances import CORNER_ASSEMBLY, FILE_DIGITS
from hypergap_dolfinx.surface.trace import lagrange_element
from hypergap_dolfinx.tolerances import (
    FACING_ANGLE,
    NEAR_FLAT,
    SEEN,
    TILT,
)

LOG = logging.getLogger("hypergap_dolfinx")
FLAT, CURVED, DISTANCE, CLEARANCE, OVERLAP, EDGE, UNEXPLAINED = (
    "flat", "curved", "distance", "clearance", "overlap", "edge", "unexplained",
)  # fmt: skip


Reach = Callable[[Boundary, Boundary], npt.NDArray[np.float64] | float]
"""Largest distances between simplices of two bodies."""


class _Sides(NamedTuple):
    side0: tuple[fem.FunctionSpace, npt.NDArray[np.int32]]
    """The first body's space, and this rank's facets of it."""
    side1: tuple[fem.FunctionSpace, npt.NDArray[np.int32]]
    """The same of the second one."""


class Touching(_Sides):
    """Facets of two bodies that touch (or face each other): two sides for a tie."""

    apart: float
    """Largest distance between the facets, taken as flat; negative for an overlap."""
    explained: str
    """Explanation of :attr:`apart`.

    ``"flat"``: at most 1e-3 of the facet size. ``"curved"``: no more than the curvature of the
    surfaces explains, or the surfaces cross within each facet.
    ``"distance"``: no more than the given distance. For facets that were left out ``"clearance"``:
    no sign that the surfaces meet; ``"overlap"``: the bodies overlap, by no more than the size of
    the smaller facet; ``"edge"``: the surfaces end on either side of a curve, and overlap by no
    more than its chords explain; ``"unexplained"``: the surfaces may meet."""
    area: float
    """Common area of the facets, in 2D their common length."""
    numbers: tuple[int, int]
    """Indices of both spaces in the list given to :func:`find_touching`."""
    counts: tuple[int, int]
    """Numbers of facets of both sides, summed over all ranks."""
    left_out: "Touching | None" = None
    """Further facets of the same bodies that face each other, but weren't found to touch."""

    @classmethod
    def of(cls, sides, **values) -> "Touching":
        """A pair with given values of the attributes."""
        pair = cls(*sides)
        for name, value in values.items():
            setattr(pair, name, value)
        return pair

    @property
    def names(self) -> list[str]:
        """Names of both spaces in messages."""
        return [f"spaces[{i}]{label(V.mesh)}" for i, (V, _) in zip(self.numbers, self, strict=True)]

    def row(self) -> str:
        """A line of the table."""
        first, second = (
            f"{name}: {count} facets" for name, count in zip(self.names, self.counts, strict=True)
        )
        return f"{first:<28} {second:<28} {self.area:9.3g} {self.apart:10.2e}  {self.explained}"


class TouchingPairs(list[Touching]):
    """List of touching pairs; ``print`` shows them, and facets left out, as a table."""

    left_out: list[Touching]
    """Facets that face each other, but weren't found to touch."""

    def __init__(self, pairs: Sequence[Touching] = (), left_out: Sequence[Touching] = ()):
        """Store the pairs.

        Args:
            pairs: Pairs that touch.
            left_out: Pairs that were left out.
        """
        super().__init__(pairs)
        self.left_out = list(left_out)

    def __str__(self) -> str:
        """Table of facets, common areas, largest distances and their explanations."""
        lines = [f"{'side':<28} {'side':<28} {'area':>9} {'apart':>10}  explained"]
        lines += [pair.row() for pair in self] or ["nothing touches"]
        if self.left_out:
            lines += ["left out:", *(pair.row() for pair in self.left_out)]
        return "\n".join(lines)


@dataclass(frozen=True)
class _Facing:
    """Pairs of simplices of two bodies that face each other."""

    pair: npt.NDArray[np.intp]
    """Indices among the compared pairs, ``(num_pairs,)``."""
    low: npt.NDArray[np.float64]
    """Smallest distance, negative where they overlap, ``(num_pairs,)``."""
    high: npt.NDArray[np.float64]
    """Largest distance."""
    near: npt.NDArray[np.float64]
    """Tolerance of the distance for flat facets."""
    curved: npt.NDArray[np.bool_]
    """Mask of pairs whose distance is explained by curvature."""
    bends: npt.NDArray[np.bool_]
    """Mask of pairs where at least one surface is curved."""
    area: npt.NDArray[np.float64]
    """Common area."""
    points: npt.NDArray[np.float64]
    """Vertices of the common part, some of them repeated, ``(num_pairs, num_points, n)``."""

    @property
    def apart(self) -> npt.NDArray[np.float64]:
        """Distance of the largest magnitude."""
        return np.where(self.high > -self.low, self.high, self.low)

    def touch(self, facets: Sequence[npt.NDArray], bent: bool):
        """Masks of pairs that touch, and of pairs that may touch.

        Nodes of two meshes of one curved surface lie on it, but their facets don't: the distance
        vanishes or changes its sign within each facet, whether the surface is convex, concave or
        both. Across a clearance it has one sign. Curved facets touch if the distance vanishes on
        both of them. If curvature explains the distance, they also touch if it vanishes somewhere
        in the connected region, or if curvature explains all distances there (a small block on the
        middle of a large facet). If the distance vanishes on one facet only, they may touch.

        Args:
            facets: Facet numbers of both sides, ``(num_pairs,)`` each.
            bent: True if no distance is given.
        """
        if not bent:
            return np.ones(len(self.pair), dtype=bool), np.zeros(len(self.pair), dtype=bool)
        region = self.regions(facets)
        whole = np.ones(region.max(initial=-1) + 1, dtype=bool)
        np.logical_and.at(whole, region, self.curved)
        one, other = (self.vanishes(side) for side in facets)
        touch = self.curved & (self.vanishes(region) | whole[region])
        return touch | (self.bends & one & other), one | other

    def regions(self, facets: Sequence[npt.NDArray]) -> npt.NDArray[np.intp]:
        """Number of the connected region of each pair; pairs are adjacent if they share a facet."""
        num = facets[0].max(initial=-1) + 1
        both = num + facets[1].max(initial=-1) + 1
        return graph.components(both, facets[0], num + facets[1])[facets[0]]

    def __getitem__(self, chosen) -> "_Facing":
        """Subset of the pairs."""
        return _Facing(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    def vanishes(self, group: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
        """Mask of pairs in groups where the distance vanishes or changes its sign."""
        low = np.full(group.max(initial=-1) + 1, np.inf)
        high = -low
        np.minimum.at(low, group, self.low - self.near)
        np.maximum.at(high, group, self.high + self.near)
        return ((low <= 0) & (high >= 0))[group]


def find_touching(
    spaces: Sequence[fem.FunctionSpace], distance: float | None = None
) -> TouchingPairs:
    """Find touching bodies and their exterior facets there. Collective.

    Two facets touch if their normals are opposite and their projections along the normals overlap;
    facet sizes don't matter. Facets that share only an edge or a point don't touch, nor do those
    on either side of a curve that overlap by no more than its chords' sag. Each connected part of a
    mesh is a body. A body isn't compared with itself.

    Args:
        spaces: A Lagrange space on each mesh, or a component of a mixed space, ``W.sub(0)``. All
            meshes are 2D, or all are 3D.
        distance: Largest gap or overlap of touching facets, a length. By default it is 1e-3 of the
            smaller facet for flat surfaces, and h²/8R for curved ones with edges h and radius R.
            R follows from the angles between adjacent facets. One of more than 65° is a corner,
            between curved facets one of half as much where they meet; distances at facet centres
            count, not those at vertices. Curved surfaces that cross within each facet also touch. A
            smaller one is a corner, too, if the surface doesn't continue to turn on both sides; a
            distance that vanishes nowhere in the region is a clearance. Clearances and layers
            thinner than h²/8R, and larger gaps, need a distance. Normals may deviate from opposite
            ones by 5° plus half of the angles between adjacent facets.

    Returns:
        A list with one :class:`Touching` for each two bodies that touch, in the order of
        ``spaces``: the two sides for a :class:`Tie` or :class:`Contact`, each a space and this
        rank's facets (possibly none), with ``area``, ``apart`` (the largest distance) and
        ``explained``. ``left_out`` of the list and of each pair holds facets that face each other
        but weren't found to touch; where they may touch, or bodies overlap by up to the size of a
        facet, the log of ``hypergap_dolfinx`` has a warning. ``print`` shows everything as a table.

    Raises:
        InterfaceError: A space that isn't Lagrange, two spaces on one mesh, meshes of different
            dimensions or on different communicators, or coordinates that aren't finite.
        ValueError: A distance that isn't positive, or something that isn't a space.

    Example:
        Three blocks on a plate:

        >>> from mpi4py import MPI  # before dolfinx
        >>> from dolfinx import fem, mesh
        >>> from hypergap_dolfinx import Tie, find_touching
        >>> corners = [[(0, 0), (6, 1)], [(0, 1), (1, 2)], [(2, 1), (3, 2)], [(4, 1), (5, 2)]]
        >>> n = [(6, 1), (2, 2), (3, 3), (4, 4)]
        >>> V = []
        >>> for ends, cells in zip(corners, n):
        ...     body = mesh.create_rectangle(MPI.COMM_WORLD, ends, cells)
        ...     V.append(fem.functionspace(body, ("Lagrange", 1)))
        >>> ties = [Tie.between(*sides) for sides in find_touching(V)]
        >>> len(ties)
        3
    """
    if isinstance(spaces, fem.FunctionSpace) or not isinstance(spaces, Iterable):
        raise ValueError(
            "find_touching takes a list of spaces, one for each body, not a "
            f"{type(spaces).__name__}."
        )
    spaces = list(spaces)
    comm = _check(spaces, distance)
    here, bodies, starts = [], [], []
    for i, V in enumerate(spaces):
        parts, index, start = gathered(Component.of(V).space, f"spaces[{i}]")
        here.append(index)
        starts.append(start)
        bodies += [(i, body) for body in parts]
    # On one rank, which sees all: a surface is small beside its body
    found = comm.bcast(_all_pairs(bodies, distance) if comm.rank == 0 else None)

    def side(i, facets):
        mine = facets - starts[i]
        mine = mine[(mine >= 0) & (mine < len(here[i]))]
        return spaces[i], np.sort(here[i][mine])

    pairs = TouchingPairs()
    for two in found:
        touching, left = (
            values and Touching.of([side(*each) for each in facets], **values)
            for facets, values in two
        )
        if touching:
            touching.left_out = left
            pairs.append(touching)
        if left:
            pairs.left_out.append(left)
    if comm.rank == 0:
        _tell(pairs)
    return pairs


def _tell(pairs: TouchingPairs) -> None:
    """Log touching pairs; warn of facets left out that may touch."""
    for pair in pairs:
        LOG.info(
            "%s and %s touch with %d and %d facets, up to %.3g apart (%s)",
            *(*pair.names, *pair.counts, pair.apart, pair.explained),
        )
    for left in pairs.left_out:
        if left.explained == UNEXPLAINED:
            LOG.warning(
                "find_touching leaves out %d facets of %s and %d of %s that face each other, up to "
                "%.3g apart: more than the surfaces' curvature explains. If they touch, make them "
                "finer or give a distance.",
                *(left.counts[0], left.names[0], left.counts[1], left.names[1], left.apart),
            )
        if left.explained == OVERLAP:
            LOG.warning(
                "%s and %s overlap by up to %.3g: find_touching leaves out their %d and %d facets "
                "there. Mend the geometry, or give a distance of more than that to take them.",
                *(*left.names, -left.apart, *left.counts),
            )


def _check(spaces: list[fem.FunctionSpace], distance: float | None) -> MPI.Comm:
    """Check the arguments; returns the communicator."""
    if distance is not None and not 0 < distance < np.inf:
        raise ValueError(f"distance must be a positive length, not {distance}.")
    for i, V in enumerate(spaces):
        if not isinstance(V, fem.FunctionSpace):
            raise ValueError(f"spaces[{i}] is a {type(V).__name__}, not a function space.")
    if not spaces:
        return MPI.COMM_SELF
    first = spaces[0].mesh
    for i, V in enumerate(spaces):
        mesh = V.mesh
        n = mesh.geometry.dim
        if MPI.Comm.Compare(first.comm, mesh.comm) not in (MPI.IDENT, MPI.CONGRUENT):
            raise InterfaceError(
                f"the meshes of spaces[0] and spaces[{i}] live on different communicators; make "
                "all on one."
            )
        if mesh.topology.dim != n or n != first.geometry.dim or n not in (2, 3):
            raise InterfaceError(
                f"spaces[{i}] lies on a {mesh.topology.dim}-dimensional mesh in {n} dimensions; "
                "bodies must be all 2D in the plane or all 3D in space."
            )
        same = next((j for j in range(i) if spaces[j].mesh is mesh), None)
        if same is not None:
            raise InterfaceError(
                f"spaces[{same}] and spaces[{i}] are on one mesh; give each mesh once (its parts "
                "are told apart)."
            )
        _, reason = lagrange_element(Component.of(V).space)
        raise_on_all(first.comm, reason and f"the space spaces[{i}] {reason}.")
    return first.comm


def _flat(a: Boundary, b: Boundary) -> npt.NDArray[np.float64]:
    """Distances treated as zero between flat facets, ``(num_pairs,)``."""
    return NEAR_FLAT * np.minimum(a.size, b.size)


def _all_pairs(bodies: list[tuple[int, Boundary]], distance: float | None):
    """Facets of all touching pairs of bodies, and facing facets that were left out.

    Returns:
        A list with two entries for each pair of bodies, facets that touch and facets left out:
        (((space, facets), (space, facets)), values of :class:`Touching`). The values are None
        without such facets.
    """

    def reach(a, b):
        return a.most + b.most + _flat(a, b) if distance is None else distance

    boxes = [body.boxes(body.most if distance is None else distance) for _, body in bodies]
    hulls = np.array([(b[:, 0].min(axis=0), b[:, 1].max(axis=0)) for b in boxes])
    rims = [_Rims.of(body) for _, body in bodies]
    found = []
    for i, j in meeting(hulls, hulls):
        if i >= j:
            continue
        parts = [bodies[i], bodies[j]]
        simplices, facing = _near(parts, (boxes[i], boxes[j]), reach)
        facets = [body.facet[s] for (_, body), s in zip(parts, simplices, strict=True)]
        mask, may = facing.touch(facets, distance is None)
        overlap = None if (mask | may).any() else _overlap(parts)
        if overlap:
            found.append(((overlap[0], None), overlap))
            continue
        if not len(facing.pair):
            continue
        normals = [body[s].normals for (_, body), s in zip(parts, simplices, strict=True)]
        edge = mask & _at_edges((rims[i], rims[j]), normals, facing, facets)
        mask, may = mask & ~edge, may & ~edge
        known = [np.isin(numbers, numbers[mask]) for numbers in facets]
        left = ~(known[0] & known[1])
        sides = [
            (k, _with_fans(body, s[mask])) for (k, body), s in zip(parts, simplices, strict=True)
        ]
        beside = [
            (k, np.unique(numbers[left])) for (k, _), numbers in zip(parts, facets, strict=True)
        ]
        why = UNEXPLAINED if (may | known[0] | known[1])[left].any() else CLEARANCE
        why = EDGE if edge[left].all() else why
        found.append((_pair(sides, facing[mask]), _pair(beside, facing[left], why)))
    return found


def _overlap(parts: list[tuple[int, Boundary]]):
    """Sides of two bodies that overlap by up to a facet's size, as :func:`_pair`; None if not.

    Bodies with facets that face each other across a clearance don't: others that are behind each
    other are sides of thin layers. So are regions more than twice as deep as the least one.
    """
    wider = [body.boxes(body.size / 2) for _, body in parts]
    simplices, facing = _near(parts, wider, lambda a, b: np.minimum(a.size, b.size))
    if not len(facing.pair) or (facing.high >= -facing.near).any():
        return None
    facets = [body.facet[s] for (_, body), s in zip(parts, simplices, strict=True)]
    region = facing.regions(facets)
    depth = np.zeros(region.max() + 1)
    np.maximum.at(depth, region, -facing.low)
    some = depth[region] <= 2 * depth[region].min()
    sides = [(k, np.unique(own[some])) for (k, _), own in zip(parts, facets, strict=True)]
    return _pair(sides, facing[some], OVERLAP)


def _near(parts, boxes, reach: Reach):
    """Simplices of two bodies that face each other, ``(2, num_pairs)``, and their distances."""
    simplices = meeting(*boxes).T
    a, b = (body[s] for (_, body), s in zip(parts, simplices, strict=True))
    facing = _facing(a, b, reach)
    return simplices[:, facing.pair], facing


def _pair(sides, facing: "_Facing", explained: str | None = None):
    """Sides, and values of a :class:`Touching`; None without facets."""
    if not len(facing.pair):
        return sides, None
    k = np.abs(facing.apart).argmax()
    if explained is None:
        flat, curved = (
            abs(facing.apart[k]) <= facing.near[k],
            facing.curved[k] or facing.bends[k],
        )
        explained = FLAT if flat else CURVED if curved else DISTANCE
    return sides, {
        "apart": float(facing.apart[k]) + 0.0,  # not -0
        "explained": explained,
        "area": float(facing.area.sum()),
        "numbers": tuple(i for i, _ in sides),
        "counts": tuple(len(facets) for _, facets in sides),
    }


def _with_fans(body: Boundary, simplices: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Facets of simplices, and those at vertices where the facets alone would touch each other."""
    facets = np.unique(body.facet[simplices])
    if body.x.shape[2] == 2:
        return facets
    while True:
        own = np.flatnonzero(np.isin(body.facet, facets))
        fan, node = _fans(body, own, np.pi)
        _, first = np.unique(fan, return_index=True)  # a corner of each fan
        of, number = np.unique(node[first], return_counts=True)
        touching = of[number > 1]
        near = np.flatnonzero(np.isin(body.nodes, touching).any(axis=1))
        fan, node = _fans(body, near, CORNER_ASSEMBLY)
        mine = np.isin(node, touching) & np.isin(fan, fan[np.isin(np.repeat(near, 3), own)])
        more = np.union1d(facets, body.facet[np.repeat(near, 3)[mine]])
        if len(more) == len(facets):
            return facets
        facets = more


def _at_edges(rims: Sequence["_Rims"], normals, facing: "_Facing", facets):
    """Mask of pairs in regions between two edges of faces that the meshes' chords explain.

    Chords of a hole lie in the hole: a face around it overlaps with one that fills it by up to
    their sag, though both share but a curve. In such a region each point is that near to edges of
    both faces, and the faces lie on opposite sides of these.

    Args:
        rims: Edges of faces of both bodies.
        normals: Normals of the simplices of both bodies, ``(num_pairs, n)`` each.
        facing: Pairs that face each other.
        facets: Facet numbers of both sides, ``(num_pairs,)`` each.

    Returns:
        ``(num_pairs,)``.
    """
    if not all(len(rim.sag) for rim in rims) or not len(facing.pair):
        return np.zeros(len(facing.pair), dtype=bool)
    near = facing.near[:, None]
    most = max(rim.sag.max() for rim in rims) + near.max()
    found = [rim.nearest(facing.points, n, most) for rim, n in zip(rims, normals, strict=True)]
    (apart0, edge0), (apart1, edge1) = found
    sag = np.maximum(rims[0].sag[edge0], rims[1].sag[edge1])
    away = np.einsum("pqi,pqi->pq", rims[0].outwards[edge0], rims[1].outwards[edge1]) < 0
    within = (away & (np.maximum(apart0, apart1) <= sag + near)).all(axis=1)
    region = facing.regions(facets)
    every = np.ones(region.max() + 1, dtype=bool)
    np.logical_and.at(every, region, within)
    return every[region]


@dataclass(frozen=True)
class _Rims:
    """Curved edges between the faces of a body, once for each face."""

    ends: npt.NDArray[np.float64]
    """``(num, 2, 3)``."""
    normals: npt.NDArray[np.float64]
    """Normals of the face, ``(num, 3)``."""
    sag: npt.NDArray[np.float64]
    """Distances of the curve from the edges, ``(num,)``."""

    @classmethod
    def of(cls, body: Boundary) -> "_Rims":
        """Curved edges of a body; none in 2D."""
        if body.x.shape[2] == 2:
            return cls(np.zeros((0, 2, 3)), np.zeros((0, 3)), np.zeros(0))
        normals, (a, b) = body.normals, _common_edges(body.nodes)
        corner = np.einsum("ei,ei->e", normals[a // 3], normals[b // 3]) < np.cos(CORNER_ASSEMBLY)
        own, wall = (
            np.concatenate(two) for two in ((a[corner], b[corner]), (b[corner], a[corner]))
        )
        ends = np.stack((body.x, np.roll(body.x, -1, axis=1)), axis=2).reshape(-1, 2, 3)[own]
        t = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(t, axis=1)
        theta = np.einsum("ei,eij,ej->e", t, body.curvature[wall // 3], t) / length
        sag = arc_height(length, np.minimum(theta, CORNER_ASSEMBLY))
        curved = theta > FILE_DIGITS
        return cls(ends[curved], normals[own // 3][curved], sag[curved])

    @property
    def outwards(self) -> npt.NDArray[np.float64]:
        """Vectors out of the faces, across the edges, ``(num, 3)``."""
        return np.cross(self.ends[:, 1] - self.ends[:, 0], self.normals)

    def nearest(self, points, normals, most: float):
        """Distances across normals to the nearest edge of the same face, and its number.

        Args:
            points: ``(num, num_points, 3)``.
            normals: Normals of their face, ``(num, 3)``.
            most: Distance up to which edges are found.
        """
        boxes = [np.stack((x.min(axis=1), x.max(axis=1)), axis=1) for x in (points, self.ends)]
        boxes[0] += [[-most], [most]]
        k, e = meeting(*boxes).T
        face = np.einsum("mi,mi->m", normals[k], self.normals[e]) >= np.cos(CORNER_ASSEMBLY)
        k, e = k[face], e[face]
        start, t = self.ends[e, 0], self.ends[e, 1] - self.ends[e, 0]
        apart = points[k] - start[:, None]
        s = np.einsum("mqi,mi->mq", apart, t) / np.einsum("mi,mi->m", t, t)[:, None]
        apart -= np.clip(s, 0, 1)[..., None] * t[:, None]
        apart -= np.einsum("mqi,mi->mq", apart, normals[k])[..., None] * normals[k, None]
        distance = np.linalg.norm(apart, axis=2)
        least, edge = np.full(points.shape[:2], np.inf), np.zeros(points.shape[:2], dtype=np.intp)
        np.minimum.at(least, k, distance)
        m, q = np.nonzero(distance <= least[k])
        edge[k[m], q] = e[m]
        return least, edge


def _common_edges(nodes: npt.NDArray):
    """Edges of two triangles: 3 · triangle + vertex at which each starts in the one, the other."""
    edges = np.stack((nodes, np.roll(nodes, -1, axis=1)), axis=2)
    return equal_rows(np.sort(edges, axis=2).reshape(-1, 2))


def _fans(body: Boundary, simplices: npt.NDArray[np.intp], most: float):
    """Fan numbers of the corners of triangles, and their nodes.

    A fan is a set of triangles around a vertex that are connected by edges. Edges where the surface
    turns by more than ``most`` don't connect.
    """
    nodes, normals = body.nodes[simplices], body.normals[simplices]
    a, b = _common_edges(nodes)
    smooth = np.einsum("ei,ei->e", normals[a // 3], normals[b // 3]) >= np.cos(most)
    a, b = a[smooth], b[smooth]
    # Boundaries have one direction of travel: an edge starts where the other one's ends
    ends = [3 * (e // 3) + (e + 1) % 3 for e in (a, b)]
    corner = graph.components(3 * len(simplices), np.append(a, ends[0]), np.append(ends[1], b))
    return corner, nodes.ravel()


def _facing(a: Boundary, b: Boundary, reach: Reach) -> _Facing:
    """Pairs of simplices that face each other, up to a distance."""
    # At its ends a facet deviates from the surface by half of its turn there
    limit = np.minimum(TILT + (a.turn + b.turn) / 2, FACING_ANGLE)
    facing = np.flatnonzero(np.einsum("pi,pi->p", a.normals, b.normals) < -np.cos(limit))
    a, b = a[facing], b[facing]
    n0, n1 = a.normals, b.normals
    normal = n0 - n1
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    axes = axes_across(normal)  # (pair, axis, n)
    origin = a.x[:, :1]
    flat0, flat1 = (np.einsum("pvi,pai->pva", x - origin, axes) for x in (a.x, b.x))
    vertices, middle, common, smaller = common_part(flat0, flat1[:, ::-1])
    at = np.concatenate((vertices, middle[:, None]), axis=1)  # (pair, point, axis)
    points = origin + at @ axes
    heights = [
        np.einsum("pqi,pi->pq", x[:, :1] - points, n) / np.einsum("pi,pi->p", normal, n)[:, None]
        for x, n in ((a.x, n0), (b.x, n1))
    ]
    # Of points on one simplex from the other's plane
    apart = (heights[1] - heights[0]) * np.einsum("pi,pi->p", normal, n0)[:, None]
    far = np.abs(apart).max(axis=1)
    # Beside each other they are seen by their distance, as far as the normal is uncertain
    low, high = vertices.min(axis=1), vertices.max(axis=1)
    extent = np.linalg.norm(high - low, axis=1) if a.x.shape[2] == 3 else 1.0
    seen = np.minimum(far * np.tan((a.turn + b.turn) / 4), SEEN * np.minimum(a.size, b.size))
    near = _flat(a, b)
    wide = common > np.maximum(FILE_DIGITS * smaller, seen * extent)
    keep = np.flatnonzero(wide & (far <= reach(a, b)))
    a, b = a[keep], b[keep]
    apart, at, flat0, flat1 = (v[keep] for v in (apart, at, flat0, flat1))
    both = a.curvature + b.curvature
    sags = a.sags(_shares(flat0, at), both) + b.sags(_shares(flat1, at), both)
    return _Facing(
        pair=facing[keep],
        low=apart.min(axis=1),
        high=apart.max(axis=1),
        near=near[keep],
        curved=(np.abs(apart) <= sags + near[keep, None]).all(axis=1),
        bends=a.turn + b.turn > FILE_DIGITS,
        area=common[keep] / (a.x.shape[2] - 1),
        points=points[keep, :-1],
    )


def _shares(simplices: npt.NDArray, points: npt.NDArray) -> npt.NDArray[np.float64]:
    """Barycentric coordinates of points, ``(num, num_points, n)``."""
    edges = simplices[:, 1:] - simplices[:, :1]
    last = (points - simplices[:, :1]) @ np.linalg.pinv(edges)
    return np.clip(np.concatenate((1 - last.sum(axis=2, keepdims=True), last), axis=2), 0, 1)
