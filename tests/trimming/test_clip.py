# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pieces that overlap in part: what is left has the right area, hosts and slabs."""

from itertools import product

import numpy as np
import pytest
from helpers import sweep
from test_front import check_cells, side

from hypergap_dolfinx import InterfaceError
from hypergap_dolfinx.gap_mesh import slab
from hypergap_dolfinx.gap_mesh.overhang import overhang
from hypergap_dolfinx.surface.projection import Triangles
from hypergap_dolfinx.trimming.clip import clip
from hypergap_dolfinx.trimming.delaunay import Cutting

pytestmark = pytest.mark.serial
SQUARE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)


def square(n, place=lambda x: x):
    """A grid of a square, mapped; counterclockwise seen from above."""
    g = np.linspace(0, 1, n + 1)
    x = np.array([(a, b, 0) for a in g for b in g])
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    b = a + n + 1
    t = np.vstack((np.column_stack((a, b, a + 1)), np.column_stack((b, b + 1, a + 1))))
    return place(x), t


def placed(angle, size, centre):
    """Turned about its centre, scaled and moved."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turn = np.array([(c, s, 0), (-s, c, 0), (0, 0, 1)])
    size = np.append(np.broadcast_to(size, 2), 1)
    return lambda x: ((x - (0.5, 0.5, 0)) * size) @ turn + np.append(centre, 0)


def common_area(p, q):
    """Area that two convex polygons have in common."""
    for a, b in zip(q, np.roll(q, -1, axis=0), strict=True):
        height = (b[0] - a[0]) * (p[:, 1] - a[1]) - (b[1] - a[1]) * (p[:, 0] - a[0])
        found = []
        for i in range(len(p)):
            j = (i + 1) % len(p)
            if height[i] >= 0:
                found.append(p[i])
            if height[i] * height[j] < 0:
                found.append(p[i] + height[i] / (height[i] - height[j]) * (p[j] - p[i]))
        if len(found) < 3:
            return 0.0
        p = np.array(found)
    x, y = p[:, 0], p[:, 1]
    return abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def area(piece):
    v = piece.x[piece.triangles]
    return np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1).sum() / 2


def check(one, other, exact, tolerance=1e-14, parts=1):
    """Both ways round: areas, hosts, shares, and a slab without a gap."""
    for (x0, t0), (x1, t1) in ((one, other), (other, one)):
        pairs = clip(side("Γ0", x0, t0), side("Γ1", x1, t1[:, ::-1]))
        assert len(pairs) == parts
        volume = 0.0
        for pair in pairs:
            for piece in pair:
                each = np.arange(len(piece.triangles))
                for at in ((0, 0), (1, 0), (0, 1), (0.2, 0.3)):
                    weights = np.array((1 - at[0] - at[1], *at))
                    x = np.einsum("v,tvi->ti", weights, piece.x[piece.triangles])
                    here = piece.points(each, np.tile(at, (len(each), 1)).astype(float))
                    np.testing.assert_allclose(here, x, rtol=0, atol=1e-14)
                v = piece.surface.x[piece.surface.facets[piece.facets]]
                whole = np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1) / 2
                assert piece.shares @ whole == pytest.approx(area(piece), rel=1e-12)
            made = slab.fill(pair)
            y = np.dstack((made.x[made.cells][:, :, :2], made.alpha[made.cells]))
            cells = np.linalg.det(y[:, 1:] - y[:, :1]) / 6
            assert cells.min() > -1e-18
            volume += cells.sum()
        for i in (0, 1):
            assert sum(area(pair[i]) for pair in pairs) == pytest.approx(exact, abs=tolerance)
        assert volume == pytest.approx(exact, abs=tolerance)


SCENES = {
    "inside": (placed(0, 0.45, (0.51, 0.5)), 0.45**2),
    "rotated": (placed(30, 0.45, (0.51, 0.5)), 0.45**2),
    "over an edge": (placed(0, 0.5, (0.9, 0.45)), 0.5 * 0.35),
    "over a corner": (placed(20, 1, (1, 1)), 0.25),
    "in a corner": (placed(0, 0.5, (0.25, 0.25)), 0.25),
    "crossing": (placed(0, (1.4, 0.4), (0.5, 0.5)), 0.4),
    "crossing askew": (placed(40, (2, 0.3), (0.5, 0.5)), None),
}


SIZES = (4, 3), (3, 7), (8, 4)


@pytest.mark.parametrize(("scene", "n"), sweep(list(product(SCENES, SIZES)), 4))
def test_kinds(scene, n):
    place, exact = SCENES[scene]
    if exact is None:
        exact = common_area(place(SQUARE)[:, :2], SQUARE[:, :2])
    check(square(n[0]), square(n[1], place), exact)


def test_matching_outlines_are_not_cut():
    one, other = square(4), square(5)
    sides = side("Γ0", *one), side("Γ1", other[0], other[1][:, ::-1])
    assert clip(*sides) == [sides]


MOVED = {
    "along edges": (placed(0, 1, (0.5 + 1e-6, 0.5)), 1 - 1e-6),
    "shifted": (placed(0, 1, (0.5 + 1e-6, 0.5 - 4e-7)), (1 - 1e-6) * (1 - 4e-7)),
    "stretched": (placed(0, (1 + 1e-6, 1 - 1e-6), (0.5, 0.5)), 1 - 1e-6),
    "turned": (placed(np.degrees(1e-6), 1, (0.5, 0.5)), 1 - 5e-7),
}


@pytest.mark.parametrize("scene", MOVED)
def test_matching_meshes_moved_by_next_to_nothing(scene):
    """They aren't cut; Σ without its overhang has the area that both have in common."""
    place, exact = MOVED[scene]
    one, other = square(4), square(4, place)
    sides = side("Γ0", *one), side("Γ1", other[0], other[1][:, ::-1])
    assert clip(*sides) == [sides]
    made = slab.fill(sides)
    assert len(made.cells) == 3 * 32
    y = np.dstack((made.x[made.cells][:, :, :2], made.alpha[made.cells]))
    volume = np.linalg.det(y[:, 1:] - y[:, :1]).sum() / 6
    assert abs(volume - exact) > 1e-8
    beyond = overhang([made], 1)
    assert volume - beyond.weights.sum() == pytest.approx(exact, abs=2e-12)  # of second order


def test_outlines_that_match_have_no_overhang():
    one, other = square(4), square(4, lambda x: x + 1e-11 * np.sin(40 * x))
    sides = side("Γ0", *one), side("Γ1", other[0], other[1][:, ::-1])
    assert overhang([slab.fill(sides)], 1) is None


def test_noise_is_not_cut_off():
    noise = 1e-6 * np.random.default_rng(0).uniform(-1, 1, (25, 3))
    one, other = square(4), square(4, lambda x: x + noise)
    sides = side("Γ0", *one), side("Γ1", other[0], other[1][:, ::-1])
    assert clip(*sides) == [sides]


def test_two_patches_and_a_hole():
    x, t = square(6)
    low, high = x[t].min(axis=1)[:, :2], x[t].max(axis=1)[:, :2]
    two = t[(high[:, 0] < 0.34) | (low[:, 0] > 0.65)]
    check((x, two), square(5, placed(10, 0.9, (0.5, 0.5))), *two_parts(x, two))
    ring = t[((low < 0.32) | (high > 0.68)).any(axis=1)]
    check((x, ring), square(5, placed(0, 0.9, (0.5, 0.5))), 0.81 - 1 / 9)


def two_parts(x, two):
    """Area that the strips have in common with the turned square, and how many parts it is."""
    turned = placed(10, 0.9, (0.5, 0.5))(SQUARE)[:, :2]
    strips = (SQUARE[:, :2] * (1 / 3, 1) + (shift, 0) for shift in (0, 2 / 3))
    return sum(common_area(turned, strip) for strip in strips), 1e-14, 2


def test_random():
    rng = np.random.default_rng(1)
    for case in sweep(range(200), 10):
        n, m = rng.integers(1, 9, 2)
        angle = rng.choice([0, 30, 45, rng.uniform(0, 360)])
        size, centre = rng.uniform(0.2, 1.6, 2), rng.uniform(0.1, 0.9, 2)
        if case % 2:  # nodes and edges at one place
            size, centre = np.maximum(np.rint(size * n), 1) / n, np.rint(centre * n) / n
        place = placed(angle, size, centre)
        exact = common_area(place(SQUARE)[:, :2], SQUARE[:, :2])
        check(square(n), square(m, place), exact, 1e-7)


CUTS = (1e-12, 1e-9, 3e-9, 1.1e-8, 1e-7, 1e-6, 1e-4, 1e-2, 0.1, 0.5, 0.9)


@pytest.mark.parametrize("cut", sweep(CUTS, 3))
def test_narrow_cuts(cut):
    for place in (
        placed(0, (0.5 + cut / 4, 0.5), (0.25 + cut / 8, 0.5)),
        placed(0, 0.5, (0.5 + cut / 4, 0.5 + cut / 4)),
        placed(0, 0.5, (0.75 + cut / 4, 0.55)),
        placed(0, 0.5, (0.25 - cut / 4, 0.25 - cut / 4)),
    ):
        exact = common_area(place(SQUARE)[:, :2], SQUARE[:, :2])
        check(square(4), square(3, place), exact, 1e-8)


def test_corners_of_parallelograms():
    """They turn by 70° and 110°: no coarse polygons of one curve."""
    shear = np.array([(1, 0, 0), (0.36, 1, 0), (0, 0, 1)])
    one, other = (
        square(1, lambda x, size=size: (x * size) @ shear)
        for size in ((0.3, 0.34, 1), (0.34, 0.27, 1))
    )
    check(one, other, 0.3 * 0.27)


@pytest.mark.parametrize("angle", [1e-7, 1e-5, 1e-3, 0.1])
def test_no_blunt_angles(angle):
    """Where an outline all but follows edges, what is cut is narrow, but no triangle is flat."""
    one, other = square(4), square(3, placed(angle, 0.5, (0.5, 0.5)))
    pairs = clip(side("Γ0", *one), side("Γ1", other[0], other[1][:, ::-1]))
    narrow = 1.0
    for piece in (piece for pair in pairs for piece in pair):
        v = piece.x[piece.triangles]
        for k in range(3):
            e, f = v[:, (k + 1) % 3] - v[:, k], v[:, (k + 2) % 3] - v[:, k]
            lengths = np.linalg.norm(e, axis=1) * np.linalg.norm(f, axis=1)
            assert (np.einsum("ti,ti->t", e, f) / lengths).min() > -0.981
            narrow = min(narrow, (np.linalg.norm(np.cross(e, f), axis=1) / lengths).min())
    assert narrow < np.radians(angle) * 10


@pytest.mark.parametrize("width", [1e-4, 1e-6, 1e-8])
def test_narrow_triangles(width):
    """A walk gives coordinates in them that are right in the facet, as far as it is wide."""
    rng = np.random.default_rng(0)
    x = np.array([(0, 0, 0), (1, 0, 0), (0.9, width, 0), (0, width, 0), (1, 1, 0), (0, 1, 0.0)])
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    t = np.array([(0, 1, 2), (0, 2, 3), (3, 2, 4), (3, 4, 5), (1, 4, 2)])
    at = rng.dirichlet((1, 1, 1), (len(t), 20))
    piece = side("Γ0", x @ turn, t)
    t = piece.triangles
    points = np.einsum("tpv,tvi->tpi", at, piece.x[t]).reshape(-1, 3)
    triangles = Triangles(piece.x, t, piece.behind)
    triangle, xi = triangles.project(points, np.zeros(len(points), dtype=np.intp))
    weights = np.column_stack((1 - xi.sum(axis=1), xi))
    found = np.einsum("pv,pvi->pi", weights, piece.x[t[triangle]])
    np.testing.assert_allclose(found, points, rtol=0, atol=1e-15)
    assert weights.min() > -1e-14 / width


def test_tree():
    """It finds what a look at all triangles finds, on a surface that is steep and folded."""
    rng = np.random.default_rng(0)
    for n, steep in ((1, 0), (7, 0.5), (20, 1.5)):
        x, t = square(n)
        x[:, 2] = steep * np.sin(3 * x[:, 0]) * np.cos(4 * x[:, 1])
        piece = side("Γ0", x, t)
        points, normals = rng.uniform(-0.5, 1.5, (100, 3)), rng.normal(size=(100, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        v = piece.x[piece.triangles]
        middle = v.mean(axis=1)
        radius = np.linalg.norm(v - middle[:, None], axis=2).max(axis=1)
        apart = points[:, None] - middle
        height = np.einsum("pfi,fi->pf", apart, piece.normals)
        near = (apart**2).sum(axis=2) - height**2 <= (1.01 * radius + 0.5 * np.abs(height)) ** 2
        near &= normals @ piece.normals.T < -0.3
        found = np.zeros_like(near)
        found[piece.tree.candidates(points, normals)] = True
        np.testing.assert_array_equal(found, near)


def test_nothing_in_common():
    sides = square(3), square(3, placed(0, 1, (2.5, 0.5)))
    with pytest.raises(InterfaceError, match="nothing in common"):
        clip(side("Γ0", *sides[0]), side("Γ1", sides[1][0], sides[1][1][:, ::-1]))


def test_the_same_cuts_are_tried_once(monkeypatch):
    """No tolerance changes cuts across facets: a refusal took six times as long."""
    tried = []

    def fill(pair):
        tried.append(pair)
        raise InterfaceError("no mesh")

    monkeypatch.setattr(slab, "fill", fill)
    one, other = square(3), square(4, placed(0, 1, (0.9, 0.6)))
    with pytest.raises(InterfaceError, match="no mesh"):
        slab.fill_common(side("Γ0", *one), side("Γ1", other[0], other[1][:, ::-1]))
    assert len(tried) == 1


def test_cutting():
    """Points on edges and inside, and segments between them, all at their places."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        inner = rng.dirichlet((1, 1, 1), 6)[:, 1:]
        points = [(0, 0), (1, 0), (0, 1), (0.4, 0), (0.4 + 1e-8, 0), *inner[inner[:, 0].argsort()]]
        cutting = Cutting(points)
        cutting.split_edge(0, 1, 3)
        cutting.split_edge(3, 1, 4)
        for point in range(5, len(points)):
            cutting.insert(point)
        for u in range(5, len(points) - 1):  # from left to right: they don't cross
            assert cutting.fix(u, u + 1)
        cutting.relax()
        v = np.array(points)[cutting.triangles()]
        twice = np.linalg.det(v[:, 1:] - v[:, :1])
        assert twice.min() > 0
        assert twice.sum() == pytest.approx(1, rel=1e-14)


@pytest.mark.parametrize("depth", (0.01, 0.05))
@pytest.mark.parametrize(("n", "m"), ((16, 18), (20, 33)))
def test_a_bush_engaged_by_less_than_a_facet(n, m, depth):
    """Both rims of the band are near each other: they are told apart by which way round they go."""

    def tube(num, low, high, turn):
        angle = 2 * np.pi * np.arange(num) / num + turn
        x = np.column_stack((np.cos(angle), np.sin(angle)))
        x = np.vstack([np.column_stack((x, np.full(num, z))) for z in (low, high)])
        a, b = np.arange(num), np.roll(np.arange(num), -1)
        one, two = np.column_stack((a, b, num + b)), np.column_stack((a, num + b, num + a))
        return x, np.vstack((one, two))

    hole, bush = tube(n, 0, 0.3, 0), tube(m, 0.3 - depth, 1, 0.1)
    pair = side("Γ0", *hole), side("Γ1", bush[0], bush[1][:, ::-1])
    (common,) = clip(*pair)
    for one in common:
        x = one.x[one.triangles]
        area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum() / 2
        assert abs(area / (2 * np.pi * depth) - 1) < 0.03
    check_cells(slab.fill(common))


def test_projection_past_notches():
    """Whatever facet the way starts from: it may end at an outline that turns inwards."""
    x, t = square(4)
    middle = x[t].mean(axis=1)
    part = side("Γ0", x, t[(middle[:, :2] < 0.5).any(axis=1)])
    middle = part.x[part.triangles].mean(axis=1)
    seed, wanted = np.indices((len(middle),) * 2).reshape(2, -1)
    found, xi = part.project(middle[wanted], seed)
    np.testing.assert_array_equal(found, wanted)
    np.testing.assert_allclose(xi, 1 / 3)
