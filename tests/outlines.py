# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Outlines of bodies in the plane without meshes: surfaces, distances, paths on which they pass."""

from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from helpers import sweep

import basix
from hypergap_dolfinx.surface.moving import MovingSurface
from hypergap_dolfinx.surface.trace import Surface

SIZE = 0.25  # of facets
DEPTH = 0.1  # largest overlap on a path


# Outlines: points around a body, which is on their left; each `degree`-th one is a vertex.


def polygon(*corners, size=SIZE, degree=1):
    """A polygon's outline, ``(num_points, 2)``."""
    corners, parts = np.asarray(corners, dtype=float), []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        num = degree * int(np.ceil(np.linalg.norm(b - a) / size))
        parts.append(a + (b - a) * (np.arange(num) / num)[:, None])
    return np.concatenate(parts)


def box(width, height, **options):
    """A box around the origin."""
    x, y = width / 2, height / 2
    return polygon((-x, -y), (x, -y), (x, y), (-x, y), **options)


def bracket(width, height, thick, **options):
    """An L with its inner corner on the upper right."""
    x, y, inner = width / 2, height / 2, (thick - width / 2, thick - height / 2)
    corners = ((-x, -y), (x, -y), (x, inner[1]), inner, (inner[0], y), (-x, y))
    return polygon(*corners, **options)


def comb(teeth, width, **options):
    """Teeth as high as wide, as far apart, on a beam as thick."""
    x = (2 * np.arange(teeth)[::-1, None] - teeth + 0.5) * width
    x = np.ravel(x + np.array((width, width, 0, 0)))
    y = np.tile([0, width, width, 0], teeth)
    corners = np.column_stack((x, y))[1:-1]
    ends = [(x[-1], -width), (x[0], -width)]
    return polygon(*corners, *ends, **options)


def ellipse(a, b, size=SIZE, degree=1):
    """Facets of much the same length."""
    s = np.linspace(0, 2 * np.pi, 2000)
    x = np.column_stack((a * np.cos(s), b * np.sin(s)))
    length = np.append(0, np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1)))
    num = degree * int(np.ceil(length[-1] / size))
    s = np.interp(np.arange(num) / num * length[-1], length, s)
    return np.column_stack((a * np.cos(s), b * np.sin(s)))


def turned(x, angle):
    """Points turned about the origin."""
    c, s = np.cos(angle), np.sin(angle)
    return x @ [[c, s], [-s, c]]


def side(x, degree, name, part=None):
    """A surface along an outline; its dofs are the outline's points.

    Args:
        x: Points, ``(num_points, 2)``.
        degree: Number of facets from point to point, and degree of facets and displacements.
        name: Γ0 or Γ1.
        part: Function of facets' middles, ``(num_facets, 2)``: mask of those on the surface.
    """
    dofs = np.arange(0, len(x), degree)[:, None] + np.arange(degree + 1)
    dofs = dofs[:, [0, degree, *range(1, degree)]] % len(x)
    if part is not None:
        dofs = dofs[part(x[dofs[:, :2]].mean(axis=1))]
    vertices, facets = np.unique(dofs[:, :2], return_inverse=True)
    element = basix.create_element(
        basix.ElementFamily.P,
        basix.CellType.interval,
        degree,
    )
    return MovingSurface(
        Surface(
            name=name,
            x=x[vertices],
            facets=facets.reshape(-1, 2).astype(np.int32),
            own_nodes=x[dofs],
            dofs=dofs.astype(np.int64),
            owner=np.zeros(len(dofs), dtype=np.int32),
            geometry=element,
            element=element,
            dof_range=np.array((0, len(x))),
        )
    )


def is_inside(points, x):
    """Mask of points inside of an outline's polygon, ``(num_points,)``."""
    a, b = x, np.roll(x, -1, axis=0)
    above = a[:, 1] > points[:, 1, None]
    i, j = np.nonzero(above != np.roll(above, -1, axis=1))
    a, along = a[j], (b - a)[j]
    at = a[:, 0] + (points[i, 1] - a[:, 1]) / along[:, 1] * along[:, 0]
    return np.bincount(i[points[i, 0] < at], minlength=len(points)) % 2 == 1


def distances(points, x):
    """Signed distances of points from an outline's polygon, and the nearest edge's number."""
    along = np.roll(x, -1, axis=0) - x
    u, v = points[:, :1] - x[:, 0], points[:, 1:] - x[:, 1]
    s = np.clip((u * along[:, 0] + v * along[:, 1]) / (along**2).sum(axis=1), 0, 1)
    squares = (u - s * along[:, 0]) ** 2 + (v - s * along[:, 1]) ** 2
    sign = np.where(is_inside(points, x), -1, 1)
    return sign * np.sqrt(squares.min(axis=1)), squares.argmin(axis=1)


def apart(x0, x1):
    """Signed distance of two outlines, negative where a vertex of one is in the other."""
    return min(distances(x0, x1)[0].min(), distances(x1, x0)[0].min())


@dataclass
class Path:
    """Two bodies, of which one passes above the other; both turn or bend slowly."""

    outlines: list
    """Points around both, ``(num_points_i, 2)`` each."""
    sides: tuple
    moves: int
    """Number of the body that passes."""
    seed: int

    def __post_init__(self):
        """Choose a path at random whose overlap is as large as it may be."""
        rng = np.random.default_rng(self.seed)
        self.turn, self.turns = rng.uniform(-0.6, 0.6), rng.uniform(-1, 1)
        self.wave, self.phase = rng.uniform(-2, 2, (2, 2)), rng.uniform(0, 6, 3)
        self.height, step = 4.0, 0.5
        while step > 1e-3:
            self.height -= step
            if any(apart(*self.at(t)) < -DEPTH for t in np.linspace(0, 1, 80)):
                self.height += step
                step /= 2

    def at(self, t):
        """Both outlines at t from 0 to 1."""
        found = []
        for i, x in enumerate(self.outlines):
            sway = np.sin(x @ self.wave[i] + self.phase[i] + 3 * t)[:, None]
            x = x + 0.03 * sway * (self.wave[i][::-1])
            if i == self.moves:
                x = turned(x, self.turn + self.turns * t)
                x += (5 * t - 2.5, self.height + 0.1 * np.sin(6 * t + self.phase[2]))
            found.append(x)
        return found

    def u(self, t):
        """Displacements of both sides."""
        return tuple(
            (now - x)[s.dofs]
            for now, x, s in zip(self.at(t), self.outlines, self.sides, strict=True)
        )


def upside_down(shape, *args, **options):
    """A shape's outline, turned by half a circle."""
    return turned(shape(*args, **options), np.pi)


def leaning(shape, *args, **options):
    """A shape's outline, turned by 45°: the inner corner of a bracket looks up."""
    return turned(shape(*args, **options), np.pi / 4)


def on_top(middles):
    """Facets on the upper face of a box."""
    return np.isclose(middles[:, 1], middles[:, 1].max())


SCENES = {
    "boxes": (partial(box, 2, 1), partial(box, 0.8, 0.6), {}),
    "narrow Γ0": (partial(box, 0.8, 0.6), partial(box, 2, 1), {"moves": 0}),
    "box and bracket": (partial(box, 1.9, 0.8), partial(upside_down, bracket, 1.3, 1.1, 0.5), {}),
    "bracket as Γ1": (
        partial(box, 0.7, 0.7),
        partial(leaning, bracket, 1.9, 1.4, 0.55),
        {"moves": 0},
    ),
    "ellipse and comb": (partial(comb, 3, 0.5), partial(ellipse, 0.8, 0.5), {}),
    "comb and ellipse": (partial(ellipse, 1.1, 0.6), partial(upside_down, comb, 2, 0.45), {}),
    "combs": (partial(comb, 3, 0.4), partial(upside_down, comb, 2, 0.5), {}),
    "top of a box as Γ0": (partial(box, 2, 1), partial(box, 0.8, 0.6), {"parts": (on_top, None)}),
    "top of a box as Γ1": (
        partial(ellipse, 0.7, 0.4),
        partial(box, 2.1, 0.8),
        {"parts": (None, on_top), "moves": 0},
    ),
}
CASES = sweep([(name, 1 + (k + j) % 2) for k, name in enumerate(SCENES) for j in (0, 1)], 2)
"""Paths and degrees."""


@cache
def path_of(name, degree):
    """The path of a scene."""
    *shapes, options = SCENES[name]
    parts = options.get("parts", (None, None))
    sizes = 0.8 * SIZE, SIZE
    outlines = [shape(size=h, degree=degree) for shape, h in zip(shapes, sizes, strict=True)]
    found = tuple(side(outlines[i], degree, f"Γ{i}", parts[i]) for i in (0, 1))
    return Path(outlines, found, options.get("moves", 1), 100 * degree + list(SCENES).index(name))
