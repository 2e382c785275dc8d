# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later

# # Any two surfaces
#
# Random pairs of triangulated surfaces are tied: closed and open, coarse and fine, straight and
# curved, with facet sizes between 1 : 7 and 7 : 1. The demo checks the gap domain Σ of each pair:
# the boundary of Σ consists of the facets of both sides, each inner face has a cell on both sides,
# and no cell is inverted at any quadrature point. The bodies are thin layers under the surfaces,
# and nothing is solved.
#
#     python demos/any_surfaces.py --scenes 100 --seed 1 --json rows.json

# +
import argparse
import json
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from scipy.spatial import ConvexHull, Delaunay, cKDTree

import basix.ufl
import dolfinx
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices
from hypergap_dolfinx import InterfaceError, Tie, compat

TAU = 2 * np.pi


@dataclass
class Shape:
    """A triangulated surface that knows where the surface is between its vertices."""

    p: np.ndarray
    """What the vertices are made of."""
    triangles: np.ndarray
    middle: Callable
    """``middle(p, q, at_rim)``: what lies between two of them on the surface."""
    place: Callable
    """``place(p)``: points in space."""

    def edges(self):
        """Vertices of each edge, the number of each triangle's edges, and which are at the rim."""
        t = self.triangles
        pairs = np.sort(np.stack((t, np.roll(t, -1, axis=1)), axis=2).reshape(-1, 2), axis=1)
        edges, which, count = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
        return edges, which.reshape(-1, 3), count == 1

    def quartered(self):
        """Each triangle cut into four."""
        edges, which, at_rim = self.edges()
        ab, bc, ca = which.T + len(self.p)
        a, b, c = self.triangles.T
        parts = ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))
        p = np.vstack((self.p, self.middle(*self.p[edges].swapaxes(0, 1), at_rim)))
        triangles = np.vstack([np.column_stack(part) for part in parts])
        return Shape(p, triangles, self.middle, self.place)

    def nodes(self, degree):
        """Places of the vertices; for degree 2 also those of the edges' middles."""
        if degree == 1:
            return self.place(self.p)
        edges, _, at_rim = self.edges()
        middles = self.middle(*self.p[edges].swapaxes(0, 1), at_rim)
        return self.place(np.vstack((self.p, middles)))


# -

# ## Closed surfaces
#
# The convex hull of points spread over a sphere, deformed by a mapping; a grid around a torus.


# +
def ball(rng, h, mapping):
    """A triangulated unit sphere, mapped."""
    num = max(12, int(14 / h**2))
    i = np.arange(num) + 0.5
    z, angle = 1 - 2 * i / num, TAU * i * 0.618034 + rng.uniform(0, TAU)
    r = np.sqrt(1 - z**2)
    x = np.column_stack((r * np.cos(angle), r * np.sin(angle), z))
    x += rng.uniform(0, 0.3) * h * rng.uniform(-1, 1, x.shape)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    x = x @ rotation(rng)
    triangles = ConvexHull(x).simplices
    inwards = np.linalg.det(x[triangles]) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]

    def middle(p, q, at_rim):
        return (p + q) / np.linalg.norm(p + q, axis=1, keepdims=True)

    return Shape(x, triangles, middle, mapping)


def capsule(x):
    """A cylinder with half balls at its ends: its length goes as the angle from the pole."""
    angle = np.arctan2(np.hypot(x[:, 0], x[:, 1]), x[:, 2])
    s = (angle / np.pi - 0.5) * (np.pi / 2 + 1.4)  # from the equator, with radius ½
    turn = np.sign(s) * np.maximum(np.abs(s) - 0.7, 0) / 0.5
    axis = np.clip(s, -0.7, 0.7) + 0.5 * np.sin(turn)
    unit = x[:, :2] / np.maximum(np.sin(angle), 1e-300)[:, None]
    return np.column_stack((0.5 * np.cos(turn)[:, None] * unit, -axis))


def bumpy(x):
    """A ball with bumps."""
    bumps = np.sin(3 * x[:, 0]) * np.sin(4 * x[:, 1] + 1) + np.sin(3 * x[:, 2])
    return x * (1 + 0.12 * bumps)[:, None]


BALLS = {
    "sphere": lambda x: x,
    "ellipsoid": lambda x: x * np.array((1.4, 1.0, 0.6)),
    "capsule": capsule,
    "bumpy": bumpy,
    "stretched": lambda x: x * np.array((1.0, 1.0, 4.0)),
}


def grid(rng, n, m, around, mapping):
    """Triangles between n × m points of a grid, mapped from the unit square.

    Args:
        rng: Random numbers.
        n: Cells in the first direction.
        m: Cells in the second one.
        around: Whether each direction is closed.
        mapping: Takes pairs of numbers between 0 and 1 to places.
    """
    size = [k if closed else k + 1 for k, closed in zip((n, m), around, strict=True)]
    i, j = (a.ravel() for a in np.meshgrid(*(np.arange(k) for k in size), indexing="ij"))
    u, v = i / n, j / m
    jitter = rng.choice((0, 0.2))
    for a, k, closed, other in ((u, n, around[0], 0), (v, m, around[1], 0)):
        free = np.ones(len(a), dtype=bool) if closed else (a > 0) & (a < 1)
        a[free] += jitter / k * rng.uniform(-1, 1, free.sum())
        if closed:
            a += rng.uniform(0, 1)
    first, second = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))

    def number(i, j):
        return (i % size[0]) * size[1] + j % size[1]

    a, b = number(first, second), number(first + 1, second)
    c, d = number(first + 1, second + 1), number(first, second + 1)
    turned = rng.random(len(a)) < rng.choice((0, 0.5))
    one = np.where(turned, (a, b, d), (a, b, c)).T
    two = np.where(turned, (b, c, d), (a, c, d)).T

    def middle(p, q, at_rim):  # the short way round
        return p + (q - p - np.where(around, np.round(q - p), 0)) / 2

    return Shape(np.column_stack((u, v)), np.vstack((one, two)), middle, mapping)


def torus(p, r=0.4):
    """A ring, around itself twice."""
    u, v = TAU * p.T
    return np.column_stack(
        ((1 + r * np.cos(v)) * np.cos(u), (1 + r * np.cos(v)) * np.sin(u), r * np.sin(v))
    )


def tube(p):
    """The hole for a bush."""
    u, v = p.T
    return np.column_stack((np.cos(TAU * u), np.sin(TAU * u), 1.5 * v))


# -

# ## Open surfaces
#
# The triangulation of points on an outline and inside it.


# +
GRAPHS = {
    "plane": lambda x, y: 0 * x,
    "saddle": lambda x, y: 0.4 * (x**2 - y**2),
    "cylinder": lambda x, y: np.sqrt(np.maximum(2.0 - x**2, 0.1)),
    "waves": lambda x, y: 0.15 * np.sin(3 * x) * np.cos(3 * y),
    "slope": lambda x, y: 0.4 * x + 0.7 * y,
}
SQUARE = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=float)
OUTLINES = {
    "square": [SQUARE],
    "L": [np.array([(-1, -1), (1, -1), (1, 0), (0, 0), (0, 1), (-1, 1)], dtype=float)],
    "cross": [
        np.array([(1, 3), (1, 1), (3, 1), (3, -1), (1, -1), (1, -3)], dtype=float)[::-1] / 3,
    ],
    "frame": [SQUARE, 0.4 * SQUARE[::-1]],
    "round hole": [SQUARE, 0.5],
    "disc": [1.0],
}
OUTLINES["cross"][0] = np.vstack((OUTLINES["cross"][0], -OUTLINES["cross"][0]))


def polygon(rng, outline, h):
    """Points along an outline: corners, or the radius of a circle (clockwise if inside)."""
    if np.ndim(outline) == 0:
        num = max(6, int(TAU * outline / h))
        angle = TAU * (np.arange(num) + rng.uniform()) / num
        points = outline * np.column_stack((np.cos(angle), np.sin(angle)))
        return points[::-1] if outline < 1 else points
    points = []
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        num = max(1, round(np.linalg.norm(b - a) / h))
        points.append(a + (b - a) * (np.arange(num) / num)[:, None])
    return np.vstack(points)


def inside(points, loops):
    """Which points lie inside of all loops: how often a ray to the right crosses them."""
    crossings = np.zeros(len(points), dtype=int)
    for loop in loops:
        for (ax, ay), (bx, by) in zip(loop, np.roll(loop, -1, axis=0), strict=True):
            between = (ay > points[:, 1]) != (by > points[:, 1])
            with np.errstate(divide="ignore", invalid="ignore"):
                x = ax + (points[:, 1] - ay) / (by - ay) * (bx - ax)
            crossings += between & (points[:, 0] < x)
    return crossings % 2 == 1


def sheet(rng, h, outlines, graph):
    """A triangulated piece of a graph."""
    loops = [polygon(rng, outline, h) for outline in outlines]
    rim = np.vstack(loops)
    for _ in range(20):
        n = int(2 / h) + 2
        i, j = (a.ravel() for a in np.meshgrid(np.arange(-n, n), np.arange(-n, n)))
        x = np.column_stack(((i + 0.5 * (j % 2)) * h, j * 0.87 * h)) @ rotation(rng)[:2, :2]
        x = x + rng.uniform(0, 0.2) * h * rng.uniform(-1, 1, x.shape)
        x = x[inside(x, loops)]
        near = np.linalg.norm(x[:, None] - rim, axis=2).min(axis=1, initial=9)
        x = np.vstack((rim, x[near > 0.6 * h]))
        t = Delaunay(x, qhull_options="QJ Pp").simplices
        corners = x[t]
        area = np.linalg.det(corners[:, 1:] - corners[:, :1])
        t[area < 0] = t[area < 0][:, ::-1]
        t = t[(np.abs(area) > 1e-3 * h**2) & inside(corners.mean(axis=1), loops)]
        used, t = np.unique(t, return_inverse=True)
        x, t = x[used], t.reshape(-1, 3)
        edges = np.sort(np.vstack((t[:, :2], t[:, 1:], t[:, ::2])), axis=1)
        edges, count = np.unique(edges, axis=0, return_counts=True)
        twice = np.bincount(edges[count == 1].ravel()).max(initial=0) == 2  # no fans at one point
        if (
            twice
            and (count == 1).sum() == len(rim)
            and len(x) - len(count) + len(t) == 2 - len(loops)
        ):
            radii = [outline for outline in outlines if np.ndim(outline) == 0]
            return Shape(
                x,
                t,
                lambda p, q, at_rim: between(p, q, at_rim, radii),
                lambda p: np.column_stack((p, graph(*p.T))),
            )
    return None


def between(p, q, at_rim, radii):
    """Middles of edges in the plane, of circular rims on the circle."""
    middle = (p + q) / 2
    for radius in radii:
        round_ = at_rim & np.isclose(np.hypot(*p.T), radius) & np.isclose(np.hypot(*q.T), radius)
        middle[round_] *= radius / np.linalg.norm(middle[round_], axis=1, keepdims=True)
    return middle


def rotation(rng):
    """A random one."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


# -

# ## Scenes
#
# Both surfaces of a scene are triangulations of one shape. Some are the same triangulation, exactly
# or nearly. In others one is a refinement of the other and shares its nodes.


# +
def scene(seed, degree, finest=0.1):
    """A random scene; the first one's body is inside.

    Args:
        seed: Tells which.
        degree: Of the facets.
        finest: Their least size, of both sides.

    Returns:
        Name, and nodes and triangles of both sides.
    """
    rng = np.random.default_rng(seed)
    kind = rng.choice(("ball", "torus", "tube", "sheet", "sheet"))
    h = np.exp(rng.uniform(np.log(finest), np.log(0.7)))
    ratio = np.exp(rng.uniform(np.log(1 / 7), np.log(7)))
    sizes = h, np.clip(h * ratio, 0.7 * finest, 0.9)
    if kind == "ball":
        name = str(rng.choice(list(BALLS)))
        sides = [ball(rng, 0.8 * s, BALLS[name]) for s in sizes]
    elif kind == "torus":
        name = "torus"
        sides = [
            grid(rng, max(7, int(TAU / s)), max(5, int(2.5 / s)), (True, True), torus)
            for s in sizes
        ]
    elif kind == "tube":
        name = "tube"
        sides = [
            grid(rng, max(5, int(TAU / s)), max(1, int(1.5 / s)), (True, False), tube)
            for s in sizes
        ]
    else:
        graph, outline = str(rng.choice(list(GRAPHS))), str(rng.choice(list(OUTLINES)))
        name = f"{graph}, {outline}"
        sizes = tuple(min(s, 0.5) for s in sizes)
        sides = [sheet(rng, s, OUTLINES[outline], GRAPHS[graph]) for s in sizes]
        if None in sides:
            return scene(seed + 1_000_003, degree, finest)
    same = rng.choice(("no", "no", "no", "no", "no", "exactly", "1e-12", "1e-6", "nodes"))
    if same != "no":
        sides[1] = sides[0].quartered() if same == "nodes" else sides[0]
        name += {"nodes": ", shared nodes", "exactly": ", matching"}.get(same, f", within {same}")
    meshes = [(side.nodes(degree), side.triangles) for side in sides]
    if degree == 2 and any(folded(side, nodes) for side, (nodes, _) in zip(sides, meshes)):
        return scene(seed + 1_000_003, degree, finest)
    if same in ("1e-6", "1e-12"):
        x, t = meshes[1]
        meshes[1] = x + float(same) * h * rng.uniform(-1, 1, x.shape), t
    if rng.random() < 0.5:  # which of them is Γ0
        meshes.reverse()
    turn, size = rotation(rng), 10 ** rng.uniform(-3, 3)
    return name, [(size * x @ turn.T, t) for x, t in meshes]


def folded(side, nodes):
    """Whether curved facets are turned over at a vertex: meshes of too few for their surface."""
    _, which, _ = side.edges()
    a, m = nodes[side.triangles], nodes[len(side.p) + which]  # middles behind each vertex
    ahead = 4 * m - 3 * a - np.roll(a, -1, axis=1)  # how the edges start at a vertex
    back = 4 * np.roll(m, 1, axis=1) - 3 * a - np.roll(a, 1, axis=1)
    straight = np.cross(a[:, 1] - a[:, 0], a[:, 2] - a[:, 0])[:, None]
    return ((np.cross(ahead, back) * straight).sum(axis=2) <= 0).any()


def layer(nodes, t, outwards, thickness=0.02, comm=MPI.COMM_SELF):
    """A thin layer of tetrahedra behind a surface, and the facets on the surface."""
    n = t.max() + 1
    x, middles = nodes[:n], nodes[n:]
    if not outwards:
        t = t[:, ::-1]
    normal = np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]])
    total = np.zeros_like(x)
    twice = np.linalg.norm(normal, axis=1, keepdims=True)
    for k in range(3):  # unit normals: a large facet would hide small ones at a tip
        np.add.at(total, t[:, k], normal / twice)
    total /= np.linalg.norm(total, axis=1, keepdims=True)
    for _ in range(50):  # inwards of all facets at a vertex, also of five around a tube
        unseen = np.einsum("ti,tki->tk", normal / twice, total[t]) < 0.1
        for k in range(3):
            np.add.at(total, t[unseen[:, k], k], 0.2 * (normal / twice)[unseen[:, k]])
        total /= np.linalg.norm(total, axis=1, keepdims=True)
    h = np.sqrt(twice.mean())
    # Prisms, cut by the order of their vertices, so that neighbours agree
    a, b, c = np.sort(t, axis=1).T
    cells = np.vstack([np.column_stack(v) for v in (
        (a, b, c, n + c), (a, b, n + b, n + c), (a, n + a, n + b, n + c))])  # fmt: skip
    x = np.vstack((x, x - thickness * h * total))
    degree = 2 if len(middles) else 1
    if degree == 2:
        pairs = np.array([(2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1)])  # as Basix has them
        edges, which = np.unique(
            np.sort(cells[:, pairs].reshape(-1, 2), axis=1), axis=0, return_inverse=True
        )
        straight = x[edges].mean(axis=1)
        straight[(edges < n).all(axis=1)] = middles  # both are in the order of their vertices
        cells = np.hstack((cells, len(x) + which.reshape(-1, 6)))
        x = np.vstack((x, straight))
    element = basix.ufl.element("Lagrange", "tetrahedron", degree, shape=(3,))
    part = slice(None if comm.rank == 0 else 0)  # one rank has all, and hands them out
    cells, x = cells.astype(np.int64)[part], x[part]
    mesh = dolfinx.mesh.create_mesh(comm, cells, e=element, x=x)
    mesh.topology.create_connectivity(2, 3)
    facets = exterior_facet_indices(mesh.topology)
    corners = mesh.geometry.input_global_indices[
        compat.entities_to_geometry(mesh, 2, facets)[:, :3]
    ]
    return mesh, facets[(corners < n).all(axis=1)]


# -

# ## What a valid Σ is


# +
def sorted_edges(triangles):
    """Their edges, each once, and how many triangles have it."""
    pairs = np.sort(triangles[:, [(0, 1), (1, 2), (0, 2)]].reshape(-1, 2), axis=1)
    return np.unique(pairs, axis=0, return_counts=True)


def fits(domain):
    """Whether Σ has the facets of both sides and walls between their rims as its boundary.

    And whether each face inside of it has two cells.
    """
    topology = domain.mesh.topology
    cells = topology.connectivity(3, 0).array.reshape(-1, 4)[domain.in_mesh]
    faces = np.sort(cells[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3), axis=1)
    faces, count = np.unique(faces, axis=0, return_counts=True)
    if count.max() > 2:
        return False
    outer = faces[count == 1]
    on, vertex = np.full((2, cells.max() + 1), -1)  # the side that a vertex is on, its number there
    for i, surface in enumerate(domain.surfaces):
        part = domain.alpha_vertices == i
        on[cells[part]] = i
        vertex[cells[part]] = cKDTree(surface.x).query(domain.x[:, :4][part])[1]
    walls = outer[(on[outer] != on[outer[:, :1]]).any(axis=1)]
    along, once = sorted_edges(walls)
    if (on[walls] < 0).any() or once[on[along[:, 0]] == on[along[:, 1]]].max(initial=1) > 1:
        return False
    for i, surface in enumerate(domain.surfaces):
        found = np.sort(vertex[outer[(on[outer] == i).all(axis=1)]], axis=1)
        facets = np.sort(surface.facets, axis=1)
        if not np.array_equal(found[np.lexsort(found.T[::-1])], np.unique(facets, axis=0)):
            return False
        edges, twice = sorted_edges(facets)
        walled = np.sort(vertex[along[(on[along] == i).all(axis=1)]], axis=1)
        walled, times = np.unique(walled, axis=0, return_counts=True)
        # Where both sides have a kink, Σ ends and starts anew
        if not np.array_equal(walled[times == 1], edges[twice == 1]):
            return False
        if (times > 1).any() and len(np.unique(domain.patch)) == 1:
            return False
    return True


def stands_up(domain):
    """Whether N · n > 0 in all cells at all points of the rule with which Σ is integrated."""
    degree = 2 * (domain.element.degree + domain.geometry.degree)
    points, _ = basix.make_quadrature(basix.CellType.tetrahedron, degree)
    dpsi = domain.geometry.tabulate(1, points)[1:, :, :, 0]  # (j, point, node)
    X = np.einsum("cmi,jpm->jcpi", domain.x, dpsi)
    alpha = domain.alpha_vertices
    d = (alpha[:, 1:] - alpha[:, :1]).T[:, :, None, None]
    N = sum(d[k] * np.cross(X[k - 2], X[k - 1]) for k in range(3))
    return bool((np.einsum("cpi,ci->cp", N, domain.normal) > 0).all())


def quality(domain):
    """The least area Σ_k dα_k e_{k+1} × e_{k+2} of a cell over its longest edge's square."""
    x, alpha = domain.x[:, :4], domain.alpha_vertices
    e, d = x[:, 1:] - x[:, :1], alpha[:, 1:] - alpha[:, :1]
    N = sum(d[:, k, None] * np.cross(e[:, k - 2], e[:, k - 1]) for k in range(3))
    return float((np.linalg.norm(N, axis=1) / (e**2).sum(axis=2).max(axis=1)).min())


def num_straight(domain):
    """Number of edges that lie on no curved facet, not to turn over cells."""
    if domain.geometry.degree == 1:
        return 0
    facets = np.vstack([surface.nodes.reshape(-1, 3) for surface in domain.surfaces])
    pairs = np.array([(2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1)])  # as Basix has them
    ends = domain.alpha_vertices[:, pairs]
    on_side = (ends[..., 0] == ends[..., 1]) & (ends[..., 0] % 1 == 0)
    middles = np.unique(domain.x[:, 4:][on_side], axis=0)
    return int((cKDTree(facets).query(middles)[0] > 1e-9 * np.ptp(facets)).sum())


def run(seed, degree, finest=0.1):
    """Tie a scene, and tell what came of it."""
    name, sides = scene(seed, degree, finest)
    ends = []
    for (nodes, t), outwards in zip(sides, (True, False), strict=True):
        mesh, facets = layer(nodes, t, outwards)
        ends.append((fem.functionspace(mesh, ("Lagrange", degree)), facets))
    num = sum(len(facets) for _, facets in ends)
    row = {"scene": name, "seed": seed, "degree": degree, "facets": num}
    start = time.perf_counter()
    try:
        domain = Tie(*ends).domain
    except InterfaceError as error:
        seconds = time.perf_counter() - start
        bad = {"cells": 0, "valid": False, "quality": 0.0, "seconds": seconds, "error": str(error)}
        return row | bad
    row |= {"seconds": time.perf_counter() - start, "cells": len(domain.x)}
    inner = domain.x[:, :4][(domain.alpha_vertices > 0) & (domain.alpha_vertices < 1)]
    valid = bool(fits(domain)) and stands_up(domain)
    row |= {"valid": valid, "quality": quality(domain)}
    return row | {"interior": len(np.unique(inner, axis=0)), "straight": num_straight(domain)}


if __name__ == "__main__" and MPI.COMM_WORLD.rank == 0:
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--degree", type=int, choices=(1, 2), help="of all; by default of each other"
    )
    parser.add_argument("--finest", type=float, default=0.1, help="least size of facets")
    parser.add_argument("--json", help="write the rows to this file")
    args = parser.parse_args()
    run(args.seed, 1)  # compiles what isn't
    rows = []
    for seed in range(args.seed, args.seed + args.scenes):
        degree = args.degree or 1 + seed % 2
        rows.append(run(seed, degree, args.finest))
        if not (row := rows[-1])["valid"]:
            print(seed, row["scene"], row["facets"], row.get("error", "")[:150])
    total = Counter(row["scene"].split(",")[0] for row in rows)
    valid = Counter(row["scene"].split(",")[0] for row in rows if row["valid"])
    for name, number in sorted(total.items()):
        print(f"{name:12} {valid[name]} of {number}")
    each = np.array([row["seconds"] / row["facets"] for row in rows])
    print(f"all          {sum(valid.values())} of {len(rows)}, "
          f"{sum(row.get('interior', 0) > 0 for row in rows)} with interior nodes, "
          f"{sum(row.get('straight', 0) > 0 for row in rows)} with straight edges; "
          f"{np.median(each):.1e} s a facet in the median, {each.max():.1e} at most")  # fmt: skip
    if args.json:
        with open(args.json, "w") as file:
            json.dump(rows, file, indent=1)
