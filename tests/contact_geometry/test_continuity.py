# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Gaps as functions of the displacements: continuous as corners pass, of the distance's sign."""

from dataclasses import dataclass
from functools import cache

from mpi4py import MPI

import helpers
import numpy as np
import pytest
from outlines import (
    CASES,
    DEPTH,
    SIZE,
    apart,
    box,
    distances,
    path_of,
    polygon,
    side,
    turned,
)

from dolfinx import fem
from dolfinx import mesh as meshing
from hypergap_dolfinx.contact_geometry import space as columns
from hypergap_dolfinx.contact_geometry.plane import PlaneSegments
from hypergap_dolfinx.contact_geometry.space import SpaceSegments
from hypergap_dolfinx.errors import NotFacingError
from hypergap_dolfinx.surface.moving import MovingSurface
from hypergap_dolfinx.surface.trace import create_surface

STEPS = (100, 200, 400, 800)[: 4 if helpers.thorough else 3]
TURNS = helpers.sweep([(45, 2), (45, 1), (90, 1), (90, 2), (135, 2), (135, 1)], 2)
NUM_STATES = 12 if helpers.thorough else 8


def segments_of(sides, u):
    """Segments where nothing is prescribed, or None where nothing is opposite."""
    try:
        if u[0].shape[1] == 3:
            return SpaceSegments.between(sides, u)
        return PlaneSegments.between(sides, u, [np.zeros(part.shape, dtype=bool) for part in u])
    except NotFacingError:
        return None


def dense(sparse, shape):
    """All of a sparse matrix."""
    A = np.zeros(shape)
    np.add.at(A, (sparse.i, sparse.j), sparse.values)
    return A


def weights(surface):
    """Reference areas of vertices, ``(num_vertices,)``: equal parts of facets' areas."""
    v = surface.x[surface.facets]
    if surface.gdim == 2:
        size = np.linalg.norm(v[:, 1] - v[:, 0], axis=1)
    else:
        size = np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1)
        size /= 2 if v.shape[1] == 3 else 1
    num = surface.facets.shape[1]
    return np.bincount(surface.facets.ravel(), np.repeat(size / num, num), len(surface.x))


def evaluated(sides, u):
    """Gaps over reference areas, and forces of a penalty of one; zero where nothing is opposite.

    As they are before those of what is covered in part get a share of those beside them: a row that
    comes is a copy of these.
    """
    M, size = weights(sides[1].reference), u[0].shape[1] * sum(map(len, u))
    segments = segments_of(sides, u)
    if segments is None:
        return np.zeros(len(M)), np.zeros(size)
    gaps = segments._at(u)
    halves, _, _, C, _ = gaps.rays.gaps()
    g = np.bincount(gaps.facets.ravel(), halves.ravel(), gaps.num)
    p = np.maximum(0, -g / M)
    return g / M, np.bincount(C.j, C.values * p[C.i], size)


def changes(path):
    """Largest changes along a path.

    Returns:
        Of gaps over reference areas, and of nodal forces over ``DEPTH SIZE^(n - 1)``: the changes
        for each number of steps, and what is left of the largest ones if their steps are halved
        until it is 1e-5, at most 30 times, ``(len(STEPS) + 1,)`` each.
    """
    scale = 1.0, DEPTH * SIZE ** (path.sides[0].reference.gdim - 1)
    at = cache(lambda t: evaluated(path.sides, path.u(t)))
    times = np.linspace(0, 1, STEPS[-1] + 1)
    values, result = [np.array(part) for part in zip(*map(at, times), strict=True)], []
    for k, array in enumerate(values):
        found = [
            np.abs(np.diff(array[:: STEPS[-1] // steps], axis=0)).max() / scale[k]
            for steps in STEPS
        ]
        size = np.abs(np.diff(array, axis=0)).max(axis=1)
        left = [
            _halved(lambda t, k=k: at(t)[k], times[i : i + 2], array[i : i + 2], 1e-5 * scale[k])
            for i in np.argsort(size)[-4:]
        ]
        result.append(np.array([*found, max(left) / scale[k]]))
    return result


def _halved(f, times, values, enough):
    """Change of a function where it is most, its step halved until it is small, or 30 times."""
    (a, b), (fa, fb) = times, values
    for _ in range(30):
        if np.abs(fb - fa).max() <= enough:
            break
        middle = (a + b) / 2
        fm = f(middle)
        if np.abs(fm - fa).max() > np.abs(fb - fm).max():
            b, fb = middle, fm
        else:
            a, fa = middle, fm
    return np.abs(fb - fa).max()


def goes_to_zero(change):
    """Assert that changes do so with the step; weights that come and go may be steep before."""
    assert change[-1] <= 1e-4, change
    assert change[-2] <= change[0], change


@cache
def changes_in_the_plane(name, degree):
    """Changes of gaps and forces on a path."""
    return changes(path_of(name, degree))


@pytest.mark.parametrize(("name", "degree"), CASES)
def test_gaps_are_continuous(name, degree):
    """Nothing jumps as corners, ends, teeth pass each other."""
    goes_to_zero(changes_in_the_plane(name, degree)[0])


KINKS = {  # jumps of forces that are left, over those of a facet at the largest overlap
    ("combs", 1): 0.5,
    ("top of a box as Γ0", 1): 0.8,
    ("top of a box as Γ0", 2): 1.2,
}


@pytest.mark.parametrize(("name", "degree"), CASES)
def test_forces_are_continuous(name, degree):
    """Nor do forces, but for kinks of gaps where an end of Γ0 passes a corner of Γ1 deep inside."""
    change = changes_in_the_plane(name, degree)[1]
    assert change[-1] <= KINKS.get((name, degree), 1e-4), change


@dataclass
class Blocks:
    """A block that passes above another one and turns, all of their surfaces given."""

    seed: int
    cell: meshing.CellType = meshing.CellType.tetrahedron

    def __post_init__(self):
        """Choose a path at random."""
        rng = np.random.default_rng(self.seed)
        found, self.x = [], []
        extents = (1.2, 1.0, 0.5), (0.6, 0.7, 0.5)
        for i, (extent, cells) in enumerate(zip(extents, ((4, 3, 1), (2, 2, 1)), strict=True)):
            corners = [-0.5 * np.array(extent), 0.5 * np.array(extent)]
            mesh = meshing.create_box(MPI.COMM_SELF, corners, cells, self.cell)
            mesh.topology.create_connectivity(2, 3)
            V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
            facets = meshing.exterior_facet_indices(mesh.topology)
            found.append(MovingSurface(create_surface(V, facets, f"Γ{i}")))
            self.x.append(V.tabulate_dof_coordinates()[found[-1].dofs])
        self.sides = tuple(found)
        self.axis, self.turn = rng.standard_normal(3), rng.uniform(-0.3, 0.3, 2)
        self.axis /= np.linalg.norm(self.axis)
        self.across = rng.uniform(-0.3, 0.3)
        self.height = 0.0
        path = [self.at(t) for t in np.linspace(0, 1, 200)]
        self.height = max(0.25 - DEPTH - x[_over(x)].min(initial=np.inf, axis=0)[2] for x in path)

    def at(self, t):
        """Points of the block that passes."""
        angle = self.turn[0] + self.turn[1] * t
        K = np.cross(np.eye(3), self.axis)
        R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
        return self.x[1] @ R + (2.4 * t - 1.2, self.across, self.height)

    def u(self, t):
        """Displacements of both sides."""
        return 0 * self.x[0], self.at(t) - self.x[1]


def _over(x):
    """Mask of points above or below the lower block."""
    return (np.abs(x[:, 0]) < 0.6) & (np.abs(x[:, 1]) < 0.5)


CELLS = meshing.CellType.tetrahedron, meshing.CellType.hexahedron
SOLIDS = helpers.sweep([(CELLS[i], seed) for i, seed in ((0, 0), (0, 1), (1, 1), (1, 0))], 2)


@cache
def changes_in_space(cell, seed):
    """Changes of gaps and forces of blocks."""
    return changes(Blocks(seed, cell))


@pytest.mark.parametrize(("cell", "seed"), SOLIDS)
def test_solids_are_continuous(cell, seed):
    """As corners and edges of blocks pass: neither gaps nor forces jump."""
    for change in changes_in_space(cell, seed):
        assert change[-1] <= 1e-4, change


@pytest.mark.parametrize(("name", "degree"), CASES)
def test_no_memory(name, degree):
    """Gaps depend on the displacements alone, not on those before."""
    path = path_of(name, degree)
    kept = None
    for t in np.linspace(0, 1, 100 if helpers.thorough else 50):
        u = path.u(t)
        fresh = segments_of(path.sides, u)
        if fresh is None:
            kept = None
            continue
        kept = kept or fresh
        for ours, theirs in zip(kept.gap(u)[:2], fresh.gap(u)[:2], strict=True):
            assert np.abs(ours - theirs).max() <= 1e-12, t


def corner_states(turn, degree):
    """A base with an inner corner as Γ1, and a flat block as Γ0 at many places above it.

    Args:
        turn: Angle by which the base's surface turns up, in degrees.
        degree: Degree of both.

    Yields:
        Block's and base's outlines, Γ1, g and m.
    """
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    end = max(c, 0) + 0.9
    corners = (-1.5, -0.6), (end, -0.6), (end, s), (c, s), (0, 0), (-1.5, 0)
    base, block = polygon(*corners, degree=degree), box(1.3, 0.7, size=0.8 * SIZE, degree=degree)
    sides = side(block, degree, "Γ0"), side(base, degree, "Γ1")
    rng = np.random.default_rng(turn + degree)
    for number in range(400):
        x = turned(block, rng.uniform(-0.5, 0.5)) + rng.uniform((-1.8, 0.3), (1.5, 2.0))
        if number % 2:  # about to touch from above
            x[:, 1] += 2.0 - x[:, 1].min()
            wanted = rng.uniform(-1.5 * DEPTH, 0.5)
            while (above := apart(x, base) - wanted) > 0 and x[:, 1].min() > -0.5:
                x[:, 1] -= max(0.03, above)
        u = x - block, 0 * base
        segments = segments_of(sides, u)
        if segments is not None:
            yield x, base, sides[1].reference, *segments.gap(u)[:2]


def covered(x0, surface):
    """Mask of Γ1's vertices both of whose straight facets are in Γ0's body, face to face."""
    a, b = surface.x[surface.facets].swapaxes(0, 1)
    s = np.linspace(0, 1, 7)[:, None, None]
    points = ((1 - s) * a + s * b).reshape(-1, 2)
    distance, nearest = distances(points, x0)
    along = np.roll(x0, -1, axis=0) - x0
    along /= np.linalg.norm(along, axis=1)[:, None]
    own = np.tile((b - a) / np.linalg.norm(b - a, axis=1)[:, None], (len(s), 1))
    inside = (distance < -0.01) & ((along[nearest] * own).sum(axis=1) < -0.7)
    outside = ~inside.reshape(len(s), -1).all(axis=0)
    return np.bincount(surface.facets[outside].ravel(), minlength=len(surface.x)) == 0


@pytest.mark.parametrize(("turn", "degree"), TURNS)
def test_sign_at_inner_corners(turn, degree):
    """Bodies that are apart have no gap below zero; vertices inside of the other body have one."""
    wrong, counted = [], np.zeros(2, dtype=int)
    for x, base, surface, g, m in corner_states(turn, degree):
        distance = apart(x, base)
        if distance > 0:
            counted[0] += 1
            bad = np.where(m > 1e-9, g <= 0, g < -1e-12)
        elif distance > -2 * DEPTH:
            within = covered(x, surface)
            counted[1] += within.sum()
            bad = within & (g >= 0)
        else:
            continue
        wrong += [(distance, *surface.x[a], g[a], m[a]) for a in np.flatnonzero(bad)]
    assert (counted >= 10).all(), counted
    assert not wrong, (len(wrong), min(wrong, key=lambda row: row[3]), max(wrong))


def states(name, degree):
    """Random states of a path near to contact, rough, and the random numbers' generator."""
    path = path_of(name, degree)
    rng = np.random.default_rng(5)
    times = np.linspace(0, 1, 200)
    near = [t for t in times if apart(*path.at(t)) < 0.5 * SIZE]
    for t in rng.choice(near, NUM_STATES):
        yield path.sides, tuple(u + 0.02 * rng.standard_normal(u.shape) for u in path.u(t)), rng


def differences(f, step):
    """Derivative at 0 by differences of the fourth order.

    Returns:
        The derivative, and by how much it changes with half the step, relative to the largest
        entry: much near to kinks.
    """
    found = []
    for h in (step, step / 2):
        found.append((8 * (f(h) - f(-h)) - f(2 * h) + f(-2 * h)) / (12 * h))
    return found[0], np.abs(found[1] - found[0]).max() / np.abs(found[0]).max()


def errors_of_derivatives(sides, u, rng, step=1e-5):
    """Errors of C, Σ p ∂²g, ∂s/∂u and ∂(Tᵀq)/∂u along a direction, relative to the largest entry.

    Returns:
        Those, ``(4,)``; None near to a kink, or if nothing is opposite.
    """
    segments = segments_of(sides, u)
    if segments is None:
        return None
    n, num = u[0].shape[1], len(sides[1].reference.x)
    size, slips = n * sum(map(len, u)), (n - 1) * num
    d = [rng.standard_normal(part.shape) for part in u]
    flat = np.concatenate([part.ravel() for part in d])
    p, q = rng.random(num), rng.standard_normal((n - 1, num))
    since = tuple(part - 0.1 * rng.standard_normal(part.shape) for part in u)
    target, on = np.arange(num), np.ones(num, dtype=bool)

    @cache  # for all four, and both steps
    def at(t):
        x = tuple(a + t * b for a, b in zip(u, d, strict=True))
        g, _, C = segments.gap(x)
        T = dense(segments.slip(x, target), (slips, size))
        moved = np.concatenate([(a - b).ravel() for a, b in zip(x, since, strict=True)])
        return np.split(
            np.concatenate((g, p @ dense(C, (num, size)), T @ moved, q.ravel() @ T)),
            np.cumsum((num, size, slips)),
        )

    given = (
        dense(segments.gap(u)[2], (num, size)),
        dense(segments.curvature(u, p), (size, size)),
        dense(segments.slip_slopes(u, since, target, on), (slips, size)),
        dense(segments.slip_curvature(u, q, target), (size, size)),
    )
    found = [differences(lambda t, k=k: at(t)[k], step) for k in range(4)]
    if max(change for _, change in found) > 1e-7:
        return None
    return np.array(
        [
            np.abs(A @ flat - slope).max() / np.abs(slope).max()
            for A, (slope, _) in zip(given, found, strict=True)
        ]
    )


def right_derivatives(some):
    """Assert that derivatives agree with differences, but near to kinks."""
    found = [errors_of_derivatives(*state) for state in some]
    smooth = [errors for errors in found if errors is not None]
    assert len(smooth) >= len(found) // 2
    assert np.max(smooth) <= 1e-6, np.max(smooth, axis=0)


@pytest.mark.parametrize(("name", "degree"), CASES)
def test_derivatives_on_paths(name, degree):
    """Wherever corners pass: C, Σ p ∂²g and those of slips."""
    right_derivatives(states(name, degree))


@pytest.mark.parametrize("cell", CELLS)
def test_derivatives_in_space(cell, monkeypatch):
    """Of blocks all around: C, Σ p ∂²g and those of slips in directions that are given.

    Where hexahedra's warped facets lie opposite as a whole, edges of their columns are taken as
    straight on the reference facet.
    """
    path, rng = Blocks(2, cell), np.random.default_rng(5)
    found = []
    for t in np.linspace(0.2, 0.8, 6):
        u = tuple(u + 0.01 * rng.standard_normal(u.shape) for u in path.u(t))
        with monkeypatch.context() as patch:
            fixed = columns.directions(segments_of(path.sides, u)._at(u).rays.frames)
            patch.setattr(columns, "directions", lambda *_, fixed=fixed: fixed)
            found.append(errors_of_derivatives(path.sides, u, rng))
    smooth = [errors for errors in found if errors is not None]
    bound = 1e-7 if cell == meshing.CellType.tetrahedron else 1e-3
    assert len(smooth) >= 4 and np.max(smooth) <= bound, smooth


def test_beside_the_end_of_a_surface():
    """What lies beside a body, beyond an end of the facets that are given, isn't in it."""
    tip = (-0.3, -1.2), (1.35, -1.2), (0.75, 0.1)
    outlines = box(1, 0.4), polygon(*tip)
    assert apart(*outlines) > 0
    sides = side(outlines[0], 1, "Γ0", lambda x: x[:, 1] < -0.19), side(outlines[1], 1, "Γ1")
    gaps, _ = evaluated(sides, tuple(0 * x for x in outlines))
    assert (gaps >= 0).all(), gaps.min()


def stair():
    """A stair as Γ0, with a step of two edges, and a block above it with longer ones, as Γ1."""
    corners = (-1.5, -0.6), (1.5, -0.6), (1.5, 0), (0, 0), (0, 0.2), (-1.5, 0.2)
    outlines = polygon(*corners, size=0.12), box(1.3, 0.5, size=0.5)
    return outlines, (side(outlines[0], 1, "Γ0"), side(outlines[1], 1, "Γ1"))


def above(outlines, angle):
    """Displacements of both sides with the block turned, over the step."""
    return 0 * outlines[0], turned(outlines[1], angle) + np.array((0.1, 0.42)) - outlines[1]


def test_risers_turn_through_the_perpendicular():
    """The step of a stair comes to turn away from Γ1: derivatives of gaps don't jump."""
    outlines, sides = stair()
    shape = len(sides[1].reference.x), 2 * sum(map(len, outlines))
    found = [
        dense(segments_of(sides, above(outlines, angle)).gap(above(outlines, angle))[2], shape)
        for angle in (-1e-7, 1e-7)
    ]
    assert np.abs(found[0]).max() > 0.1
    assert np.abs(found[1] - found[0]).max() <= 1e-5


def test_derivatives_at_risers():
    """Those of steps that face Γ1 or turn away a little agree with differences."""
    (outlines, sides), rng = stair(), np.random.default_rng(0)
    right_derivatives(
        (sides, tuple(u + 0.004 * rng.standard_normal(u.shape) for u in above(outlines, a)), rng)
        for a in (-0.05, -0.03, -0.01, 0.01, 0.02, 0.04)
    )
