# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The front of flips: valid cells between surfaces of every kind, cavities, matching surfaces."""

import os
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import basix
from hypergap_dolfinx.core.compiled import MORE_FLAGS
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.gap_mesh import front, prisms, repair, slab
from hypergap_dolfinx.gap_mesh.cavity import is_whole, linear_program
from hypergap_dolfinx.gap_mesh.tetrahedra import FACES, areas, single_faces
from hypergap_dolfinx.gap_mesh.walls import in_walls, rims
from hypergap_dolfinx.surface.pieces import Side
from hypergap_dolfinx.surface.trace import Surface

P1 = basix.create_element(basix.ElementFamily.P, basix.CellType.triangle, 1)
pytestmark = pytest.mark.serial


def side(name, x, t):
    """A surface from its arrays; triangles turn counterclockwise seen from outside."""
    order = np.lexsort(x.T[::-1])
    x, t = x[order], np.argsort(order)[t]
    owner, dofs = np.zeros(len(t), dtype=np.int32), t.astype(np.int64)
    surface = Surface(name, x, t.astype(np.int32), x[t], dofs, owner, P1, P1, np.array([0, len(x)]))
    return Side.of(surface, np.arange(len(t)))


def check_cells(made):
    """None is flat, and they fill what lies between the sides of a slab."""
    D, scale = areas(made.x[made.cells], made.alpha[made.cells], made.normal)
    assert (D > 1e-9 * scale).all()
    # Every face has one cell on each side, or is a facet or on a wall
    faces = np.sort(made.cells[:, FACES].reshape(-1, 3), axis=1)
    faces, count = np.unique(faces, axis=0, return_counts=True)
    assert count.max() == 2
    outer = faces[count == 1]
    on = (made.alpha[outer] == 1).sum(axis=1)
    for i, number in ((0, 0), (1, 3)):
        facets = np.sort(made.sides[i].triangles + made.offsets[i], axis=1)
        np.testing.assert_array_equal(outer[on == number], np.unique(facets, axis=0))
    assert all((s.behind >= 0).all() == ((on == 0) | (on == 3)).all() for s in made.sides)


def filled(one, other):
    """The slab between two triangulations, both counterclockwise seen from Γ1; checked."""
    made = slab.fill((side("Γ0", *one), side("Γ1", other[0], other[1][:, ::-1])))
    check_cells(made)
    return made


def grid(n, mapping, *, turned="right", jitter=0.0, seed=0, around=False):
    """Triangles between the points of a grid in the unit square, mapped."""
    rng = np.random.default_rng(seed)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n + (not around)), np.arange(n + 1)))
    u, v = i / n, j / n
    for a in (u, v):
        inner = (a > 0) & (a < 1)
        a[inner] += jitter / n * rng.uniform(-1, 1, inner.sum())
    index = np.full((n + 1, n + 1), -1)
    index[i, j] = np.arange(len(i))
    if around:
        index[n] = index[0]
    a, b, c, d = (
        part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    )
    left = {"right": np.zeros(len(a), bool), "left": np.ones(len(a), bool)}.get(
        turned, rng.random(len(a)) < 0.5
    )
    one = np.where(left, (a, b, d), (a, b, c)).T
    two = np.where(left, (b, c, d), (a, c, d)).T
    return mapping(u, v), np.vstack((one, two))


def graph(f):
    return lambda u, v: np.column_stack((u, v, f(u, v)))


def ball(num, mapping=lambda x: x, seed=0):
    """The convex hull of points spread over a sphere, mapped."""
    hull = pytest.importorskip("scipy.spatial").ConvexHull
    rng = np.random.default_rng(seed)
    i = np.arange(num) + 0.5
    z, angle = 1 - 2 * i / num, 2 * np.pi * (i * 0.618034 + rng.uniform())
    r = np.sqrt(1 - z**2)
    x = np.column_stack((r * np.cos(angle), r * np.sin(angle), z))
    x += 0.5 / np.sqrt(num) * rng.uniform(-1, 1, x.shape)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    t = hull(x).simplices
    inwards = np.linalg.det(x[t]) < 0
    t[inwards] = t[inwards][:, ::-1]
    return mapping(x), t


@pytest.mark.parametrize("m", range(1, 9))
def test_skew_structured_meshes(m):
    """64 pairs, edges that are not Delaunay on both sides: no interior node is needed."""
    skew = graph(lambda u, v: np.tan(np.radians(25)) * (u + v))
    for n in range(1, 9):
        assert filled(grid(n, skew), grid(m, skew)).inner.alpha.size == 0


@pytest.mark.parametrize("turned", ("right", "left", "random"))
@pytest.mark.parametrize("n", ((1, 7), (7, 1), (1, 20), (20, 1), (2, 3), (12, 13), (20, 20)))
def test_flat(n, turned):
    flat = graph(lambda u, v: 0 * u)
    filled(grid(n[0], flat, turned=turned), grid(n[1], flat, turned="random", seed=1))


SHAPES = {
    "saddle": lambda u, v: 0.6 * ((u - 0.5) ** 2 - (v - 0.5) ** 2),
    "waves": lambda u, v: 0.1 * np.sin(2 * np.pi * u) * np.sin(2 * np.pi * v),
    "paraboloid": lambda u, v: -1.5 * ((u - 0.5) ** 2 + (v - 0.5) ** 2),
    "ramp": lambda u, v: 0.3 * np.sin(2 * np.pi * u),
}


@pytest.mark.parametrize("jitter", (0, 0.3))
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("n", ((7, 10), (10, 7), (4, 17), (15, 15)))
def test_curved(n, shape, jitter):
    filled(*(grid(k, graph(SHAPES[shape]), jitter=jitter, seed=k + i) for i, k in enumerate(n)))


BALLS = {
    "sphere": lambda x: x,
    "ellipsoid": lambda x: x * (1.4, 1.0, 0.6),
    "bumpy": lambda x: x * (1 + 0.12 * np.sin(3 * x[:, :1]) * np.sin(4 * x[:, 1:2] + 1)),
}


@pytest.mark.parametrize("shape", BALLS)
def test_closed(shape):
    for seed, (n, m) in enumerate(((30, 20), (30, 200), (300, 40), (150, 170), (14, 15))):
        filled(ball(n, BALLS[shape], seed), ball(m, BALLS[shape], seed + 10))


@pytest.mark.parametrize("n", ((5, 6), (5, 30), (24, 7), (16, 17)))
def test_tube(n):
    """The hole for a bush: two rims."""

    def tube(u, v):
        return np.column_stack((np.cos(2 * np.pi * u), np.sin(2 * np.pi * u), 1.5 * v))

    filled(*(grid(k, tube, around=True) for k in n))


def test_hole():
    """A frame: the walls of its hole lean outwards too."""

    def frame(n):
        x, t = grid(3 * n, graph(lambda u, v: 0 * u))
        middle = np.abs(x[t].mean(axis=1)[:, :2] - 0.5).max(axis=1) < 1 / 6
        used, t = np.unique(t[~middle], return_inverse=True)
        return x[used], t.reshape(-1, 3)

    for n, m in ((1, 1), (1, 2), (2, 3), (4, 3), (2, 7)):
        assert filled(frame(n), frame(m)).inner.alpha.size == 0


@pytest.mark.parametrize("n", ((12, 9), (5, 14)))
def test_corners_of_outlines_face_each_other(n):
    """Where outlines are apart and of different length: walls cut off none."""
    arch = graph(lambda u, v: 0.05 + 0.5 * np.sin(np.pi * u) * (1 - v))
    made = filled(grid(n[0], graph(lambda u, v: 0 * u)), grid(n[1], arch))
    up = np.tile((0.0, 0.0, 1.0), (len(made.cells), 1))
    seen, _ = areas(made.x[made.cells], made.alpha[made.cells], up)
    assert abs(seen.sum() / 6 - 1) <= 1e-12  # from above, at each α in the mean


@pytest.mark.parametrize("noise", (0, 1e-12, 1e-6, 1e-3))
def test_matching(noise):
    """Three cells for each facet and its twin."""
    x, t = ball(400, BALLS["ellipsoid"])
    y = x + noise / 20 * np.random.default_rng(0).uniform(-1, 1, x.shape)
    made = filled((x, t), (y, t))
    assert len(made.cells) == 3 * len(t)
    assert len(prisms.twins(x, t, y, t, 0.1)) == len(t)
    assert not len(prisms.twins(x, t, y, t[:, ::-1], 0.1))


def quarters(x, t):
    """Triangles cut into four, with new points where their edges' middles are."""
    edges, which = np.unique(
        np.sort(t[:, [(1, 2), (2, 0), (0, 1)]].reshape(-1, 2), axis=1), axis=0, return_inverse=True
    )
    (a, b, c), (bc, ca, ab) = t.T, len(x) + which.reshape(-1, 3).T
    parts = ((a, ab, ca), (b, bc, ab), (c, ca, bc), (bc, ca, ab))
    return np.vstack((x, x[edges].mean(axis=1))), np.vstack([np.column_stack(p) for p in parts])


@pytest.mark.parametrize("swap", (False, True))
def test_quartered(monkeypatch, swap):
    """Where no front gets through, facets and their quarters have cells between them."""
    coarse = grid(4, graph(lambda u, v: 3 * u), turned="random", jitter=0.3)
    fine = quarters(*coarse)
    monkeypatch.setattr(front, "VARIANTS", ())
    made = filled(*((fine, coarse) if swap else (coarse, fine)))
    assert len(made.cells) == 7 * len(coarse[1])
    closed = ball(30)
    made = filled(*((quarters(*closed), closed) if swap else (closed, quarters(*closed))))
    assert len(made.cells) == 7 * len(closed[1])


def test_not_quartered():
    """Other triangulations with four times as many facets, and no others with their middles."""
    x, t = grid(4, lambda u, v: np.column_stack((u, v, 0 * u)))
    for other in (grid(8, lambda u, v: np.column_stack((u, v, 0 * u)), turned="left"),
                  (np.roll(x, 1, axis=0), np.vstack((t, t, t, t)))):  # fmt: skip
        assert prisms.middles(x, t, *other, 0.125) is None
    y, s = quarters(x, t)
    assert prisms.middles(x, t, y, s, 0.125) is not None
    assert prisms.middles(x, t, y, s[:, ::-1], 0.125) is None
    assert prisms.middles(x, t, y + 0.1, s, 0.125) is None


def test_swaps():
    """A sliver in a pile of cells goes; cells that are wanted stay."""
    made = filled(ball(200), ball(150, seed=1))
    n0 = len(made.sides[0].x)
    alpha = (np.arange(len(made.x)) >= n0).astype(float)
    normals = np.vstack((made.sides[0].vertex_normals, -made.sides[1].vertex_normals))

    def quality(cells):
        D, scale = areas(made.x[cells], alpha[cells], normals[cells].sum(axis=1))
        return D / scale

    bound = np.quantile(quality(made.cells), 0.02)
    cells = repair.improve(made.cells, alpha, lambda c: quality(c) - bound)
    before, after = quality(made.cells), quality(cells)
    assert (after <= bound).sum() < 0.7 * (before <= bound).sum() and after.min() >= before.min()
    outer = np.vstack((made.sides[0].triangles, n0 + made.sides[1].triangles))
    assert is_whole(cells, outer)
    np.testing.assert_array_equal(repair.improve(cells, alpha, quality), cells)


def derivatives(made):
    """Largest ∂λ/∂α of each cell: A of its faces, seen along n, over D."""
    x = made.x[made.cells]
    D, _ = areas(x, made.alpha[made.cells], made.normal)
    a, b, c = (x[:, FACES][:, :, k] for k in range(3))
    return np.abs(np.einsum("cfi,ci->cf", np.cross(b - a, c - a), made.normal)).max(axis=1) / D


def test_cells_that_extrapolate_are_swapped(monkeypatch):
    """Such cells decide about the condition of G: hardly any are left."""
    sides = ball(200), ball(1000, seed=1)
    swapped = derivatives(filled(*sides))
    monkeypatch.setattr(front, "EXTRAPOLATE", 1e300)
    before = derivatives(filled(*sides))
    print((before > 2).sum(), before.max(), (swapped > 2).sum(), swapped.max())
    assert (swapped > 2).sum() < 0.2 * (before > 2).sum() and swapped.max() < 0.5 * before.max()


def test_cells_that_extrapolate_most_are_swapped_first():
    """Where others are swapped first, one with 12 can't be any more."""
    assert derivatives(filled(ball(40), ball(1000, seed=2))).max() < 6


def test_closed_surfaces_are_swept():
    """What comes after a cell is beside it: not somewhere on the surface, and in no cache."""
    made = filled(ball(1000), ball(800, seed=1))
    place = made.x[made.cells].mean(axis=1) @ front.GENERIC
    assert np.corrcoef(place, np.arange(len(place)))[0, 1] > 0.8


@pytest.mark.parametrize("step", (10, 20, 60))
def test_cavities(monkeypatch, step):
    """Cells taken away from a front that got through are replaced with cones."""
    advance = front.advance

    def lossy(*args):
        made = advance(*args)
        return replace(made, cells=np.delete(made.cells, slice(5, None, step), axis=0), left=1)

    monkeypatch.setattr(front, "advance", lossy)
    made = filled(ball(200), ball(150, seed=1))
    assert made.inner.alpha.size > 0
    assert (made.inner.alpha > 0).all() and (made.inner.alpha < 1).all()


@pytest.mark.parametrize("swept", (False, True))
def test_cavities_are_filled_before_another_front_is_tried(monkeypatch, swept):
    """Large rough surfaces: a front leaves a few triangles somewhere, and need not run again."""
    tried, advance = [], front.advance

    def one(*args):
        tried.append(advance(*args))
        return tried[-1]

    monkeypatch.setattr(front, "advance", one)
    monkeypatch.setattr(front, "SWEPT", 0 if swept else front.SWEPT)
    monkeypatch.setattr(front, "LEFT", 1e-2)
    waves = graph(lambda u, v: 0.05 * np.sin(13 * u) * np.sin(13 * v))
    sides = [grid(n, waves, jitter=0.3, seed=n + 1) for n in (30, 33)]
    made = filled(*sides)
    assert len(tried) == 1 and tried[0].left > 0 and made.inner.alpha.size > 0


def test_walls_keep_their_order():
    """Weights that are linear displace both sides alike, by more than edges are long."""
    flat = graph(lambda u, v: 0 * u)
    (x0, t0), (x1, t1) = (grid(n, flat) for n in (5, 7))
    sides = side("Γ0", x0, t0), side("Γ1", x1, t1[:, ::-1])
    (rim,) = rims(*sides)
    shift, weights = np.zeros(x1.shape), np.vstack([side.x for side in sides]) @ (0.9, 0.6, 0)
    walls = [rim.walls(len(x0), shift, w) for w in (0 * weights, weights, -weights)]
    np.testing.assert_array_equal(walls[1], walls[0])
    np.testing.assert_array_equal(walls[2], walls[0])


def test_many_vertices():
    """No two faces or edges are taken for one where vertices have large numbers."""
    n = 1 << 21
    walls = np.array([(0, n + 6, n + 7)])
    faces = np.array([(n, n + 5, n + 7), (n + 7, 0, n + 6)])
    np.testing.assert_array_equal(in_walls(faces, walls), (False, True))
    np.testing.assert_array_equal(in_walls(faces[:, :2], walls), (False, True))
    cells = np.array([(0, n + 5, n + 6, n + 7), (n, n + 4, n + 6, n + 7)])
    assert len(single_faces(cells, walls[:0])[0]) == 8
    n = 1 << 22
    one = prisms.Prisms(
        np.array([[(n - 3, n - 2, n - 1)] * 2]), np.array([(0, n - 3, n - 2, n - 1)])
    )
    walls = np.array([(1 << 20, n - 3, n - 2)])
    assert len(one.walls(walls)[1]) == 4


def test_no_cells(monkeypatch):
    """A front that made nothing, of large surfaces: given up, not tried for ever."""
    monkeypatch.setattr(front, "CELLS", 0)
    sides = side("Γ0", *ball(500)), side("Γ1", ball(400)[0], ball(400)[1][:, ::-1])
    assert front.construct(front.Problem.between(*sides), slab._place(sides)) is None


def test_linear_program():
    linprog = pytest.importorskip("scipy.optimize").linprog
    rng = np.random.default_rng(0)
    for n, m in ((1, 5), (2, 9), (3, 40), (4, 60)):
        A, b, c = rng.normal(size=(m, n)), rng.uniform(0, 1, m), rng.normal(size=n)
        z = linear_program(A, b, c, 10.0)
        exact = linprog(-c, A_ub=A, b_ub=b, bounds=[(-10, 10)] * n)
        assert (A @ z - b).max() < 1e-12 and abs(c @ z + exact.fun) < 1e-10


def test_same_each_time():
    sides = [ball(300), ball(200, seed=1)]
    first, second = (filled(*sides).cells for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_compiled_by_many_at_once(tmp_path):
    """Processes that start together with an empty cache all get the library, and leave one file."""
    code = (
        "from mpi4py import MPI\nfrom hypergap_dolfinx.core.compiled import library\n"
        'assert library("space").lib.front_fill\n'
    )
    env = os.environ | {"XDG_CACHE_HOME": str(tmp_path), MORE_FLAGS: "-O0"}  # a tenth of the time
    runs = [subprocess.Popen([sys.executable, "-c", code], env=env) for _ in range(2)]
    assert [run.wait() for run in runs] == [0, 0]
    assert len(list((tmp_path / "fenics").iterdir())) == 1


@pytest.mark.slow
def test_speed(capsys):
    """Cells for 100,000 facets a second."""
    sides = [ball(5000), ball(4600, seed=1)]
    sides = side("Γ0", *sides[0]), side("Γ1", sides[1][0], sides[1][1][:, ::-1])
    start = time.process_time()
    assert front.construct(front.Problem.between(*sides), slab._place(sides)) is not None
    speed = sum(len(s.triangles) for s in sides) / (time.process_time() - start)
    with capsys.disabled():
        print(f"\n{speed:.0f} facets a second")
    assert speed > 50_000


def test_folded_facets():
    """No cells fit on a curved facet that is folded: told with the place."""
    P2 = basix.create_element(
        basix.ElementFamily.P,
        basix.CellType.triangle,
        2,
        basix.LagrangeVariant.equispaced,
    )
    flat = graph(lambda u, v: 0 * u)
    sides = [side("Γ0", *grid(2, flat)), side("Γ1", *grid(3, flat))]
    X = np.column_stack((1 - P2.points.sum(axis=1), P2.points))
    for i, one in enumerate(sides):
        nodes = X @ one.surface.nodes
        if i == 0:
            inner = one.behind[0].argmax()  # an edge that has a facet behind it
            k, away = (5, 3, 4)[inner], one.x[one.triangles[0, inner]]
            nodes[0, k] = away + 0.05 * (nodes[0, k] - away)
        t = one.surface.facets if i == 0 else one.surface.facets[:, ::-1]
        nodes = nodes if i == 0 else nodes[:, [2, 1, 0, 5, 4, 3]]
        surface = replace(one.surface, facets=t, own_nodes=nodes, geometry=P2)
        sides[i] = Side.of(surface, np.arange(len(t)))
    with pytest.raises(InterfaceError, match=r"a curved facet of Γ0 at .* is folded"):
        slab.fill(tuple(sides))


def test_cut_facets_are_not_folded():
    """A sliver along a facet's curved edge faces elsewhere than the facet."""
    P1, P2 = (
        basix.create_element(basix.ElementFamily.P, basix.CellType.triangle, k) for k in (1, 2)
    )
    x = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], dtype=float)
    nodes = P1.tabulate(0, P2.points)[0, :, :, 0] @ x
    nodes[5, 2] += 0.1  # in the middle of the edge from 0 to 1
    t = np.array([(0, 1, 2)], dtype=np.int32)
    one = side("Γ0", x, t).surface
    surface = replace(one, x=x, facets=t, own_nodes=nodes[None], geometry=P2)
    for X in (((0.0, 0.0), (0.5, 0.0), (1.0, 0.0)), ((0.0, 0.0), (1.0, 0.0), (0.5, 0.0))):
        corners = np.array(X)
        piece = Side(surface, surface.points([0, 0, 0], corners), t, np.array([0]), corners[None])
        slab._check_folded(piece)
