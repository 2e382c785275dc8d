# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact in space: a block on a wider one, a sphere on a block; what lies opposite, far apart."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from assembly import Elastic
from helpers import close, raises, two_ranks

import basix
import meshes
from dolfinx import default_scalar_type, fem
from dolfinx import mesh as meshing
from hypergap_dolfinx import Contact, ContactProblem, InterfaceError
from hypergap_dolfinx.contact_geometry import moments, opposite
from hypergap_dolfinx.contact_geometry.space import SpaceSegments
from hypergap_dolfinx.core import compiled
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.surface.moving import MovingSurface
from hypergap_dolfinx.surface.trace import create_surface

comm = MPI.COMM_WORLD
SPANS = (((0, 0, -0.5), (2, 2, 0)), ((0.5, 0.5, 0), (1.5, 1.5, 0.5)))
NARROWER = ((0.2, 0.2, -0.5), (1.8, 1.8, 0)), SPANS[1]


def boundary(mesh, axis, *places):
    """Facets in planes across an axis."""
    return meshing.locate_entities_boundary(
        mesh, 2, lambda x: np.isclose(x[axis][:, None], places).any(axis=1)
    )


def pressure_error(*args):
    """Error of pressures and force of :func:`pressed`."""
    return pressed(*args)[0]


def pressed(degree, n, swap, strain, cell=meshing.CellType.tetrahedron):
    """Blocks between walls, of which the lower one is loaded where it is free.

    Returns:
        Error of pressures and force, and the number of Newton steps.
    """
    large = strain > 0.1
    stretch = 1 - strain
    p = 3 * strain
    if large:
        p = -(stretch - 1 / stretch + np.log(stretch) / stretch)
    u, F, bcs, sides = [], [], [], []
    for i, (low, high) in enumerate(SPANS):
        cells = (n[i], n[i], 1)
        mesh = meshing.create_box(comm, [low, high], cells, cell)
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        held = [(c, boundary(mesh, c, low[c], high[c]), 0.0) for c in (0, 1)]
        held.append((2, boundary(mesh, 2, (low, high)[i][2]), 0.5 * strain * (1 - 2 * i)))
        for component, facets, value in held:
            dofs = fem.locate_dofs_topological(V.sub(component), 2, facets)
            bcs.append(fem.dirichletbc(default_scalar_type(value), dofs, V.sub(component)))
        facets = boundary(mesh, 2, 0)
        middle = meshing.compute_midpoints(mesh, 2, facets)
        free = (np.abs(middle[:, :2] - 1) > 0.5).any(axis=1)  # none of the upper one
        body = Elastic.on(V, (1.0, 1.0), large=large, loaded=facets[free])
        body.load.value = p
        u.append(body.u)
        F.append(body.F)
        sides.append((V, facets))
    contact = Contact(*(sides[::-1] if swap else sides))
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact], rtol=1e-12)
    problem.solve()
    force = contact.force(problem)[2] * (-1 if swap else 1)
    error = np.abs(contact.pressures(problem)[contact.active] / p - 1).max()
    return max(error, abs(force / p - 1)), problem.iterations


@pytest.mark.ranks(2, swap=[False])
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("strain", (1e-3, 0.2))
def test_patch(strain, swap):
    assert pressure_error(1, (4, 3), swap, strain) <= 1e-11


@pytest.mark.parametrize("swap", (False, True))
def test_patch_of_hexahedra(swap):
    """Facets are quadrilaterals, cut along the narrow block's outline at other places each time."""
    assert pressure_error(1, (4, 3), swap, 0.2, meshing.CellType.hexahedron) <= 1e-11


def test_patch_of_degree_2():
    """Multipliers at vertices: their pressures pass through all nodes."""
    assert pressure_error(2, (4, 2), False, 1e-3) <= 1e-10


def test_patch_of_hexahedra_of_degree_2():
    """Functions of degree 4 on facets that the narrow block's end covers in part, on and off."""
    assert pressure_error(2, (4, 3), True, 0.2, meshing.CellType.hexahedron) <= 1e-10


@pytest.mark.parametrize(
    ("degree", "n", "cell"),
    (
        (1, (3, 4), meshing.CellType.hexahedron),
        (1, (5, 4), meshing.CellType.tetrahedron),
        (1, (6, 3), meshing.CellType.hexahedron),
        (2, (5, 4), meshing.CellType.hexahedron),
    ),
)
def test_blocks_edge_on_edge(degree, n, cell):
    """Edges of Γ0 lie above middles of facets, or above edges: nothing jumps as they pass."""
    error, num = pressed(degree, n, True, 1e-3, cell)
    assert error < 0.7  # load and block end at other places
    assert num <= 8  # 5 or 6, by the machine's processor; without ALONG no equilibrium


@pytest.mark.parametrize("past", (1e-3, 4e-3))
def test_corner_comes_across_a_quadrilateral(past):
    """The vertex that Γ0's corner reaches presses as those beside it do: forces don't jump."""
    hexahedron = meshing.CellType.hexahedron
    two, u, _ = rough(1, hexahedron, low=(0.4 - past,) * 2, high=(1.6 - past,) * 2, size=1e-4)
    g, m, C = SpaceSegments.between(two, u).gap(u)
    reached = int(np.abs(two[1].reference.x[:, :2] - 1.2).sum(axis=1).argmin())
    assert m[reached] > 0
    others = (m > 0) & (np.arange(len(m)) != reached)
    rows = dense(C, (len(g), 3 * sum(map(len, u)))) / np.where(m > 0, m, 1)[:, None]
    left = rows[reached] - rows[others].T @ np.linalg.lstsq(rows[others].T, rows[reached])[0]
    assert np.linalg.norm(left) <= 10 * past * np.linalg.norm(rows[reached])


@two_ranks(loaded=[True])
@pytest.mark.parametrize(
    ("cells", "spans", "degrees", "friction", "large", "loaded"),
    (
        ((5, 4), (SPANS[0], ((0, 0, 0), (1, 1, 0.5))), 0.0, 0.3, True, False),
        ((4, 6), NARROWER, 20.0, 0.3, True, False),
        ((7, 7), NARROWER, 39.0, 0.1, False, False),
        ((4, 6), NARROWER, 20.0, 0.3, True, True),
    ),
)
def test_blocks_that_touch_exactly(cells, spans, degrees, friction, large, loaded):
    """A block is pressed and slid at once: some rows repeat others at the corners where it ends.

    Or it is loaded, and only contact and friction hold it.
    """
    F, u, bcs, sides = [], [], [], []
    for i, (start, end) in enumerate(spans):
        mesh = meshing.create_box(
            comm, [start, end], (cells[i], cells[i], 1), meshing.CellType.hexahedron
        )
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        moved = default_scalar_type((0.02 * i, 0, -0.02 * i))
        back, face = (boundary(mesh, 2, z) for z in ((start, end)[i][2], 0))
        body = Elastic.on(V, (1.0, 1.0), large=large, loaded=back)
        if loaded and i == 1:
            body.load.value = 0.05
        else:
            bcs.append(fem.dirichletbc(moved, fem.locate_dofs_topological(V, 2, back), V))
        c, s = np.cos(np.radians(i * degrees)), np.sin(np.radians(i * degrees))
        mesh.geometry.x[:, :2] = (mesh.geometry.x[:, :2] - 1) @ [[c, s], [-s, c]] + 1
        F.append(body.F)
        u.append(body.u)
        sides.append((V, face))
    contact = Contact(*sides[::-1], friction=friction)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    problem.solve()
    assert problem.iterations <= 10 and problem.halvings == 0
    if loaded:
        close(np.abs(contact.force(problem)), (0, 0, 0.05), 1e-7)


@pytest.mark.parametrize("depth", (0.1, 0.2))
def test_walls_beside_a_punch(depth):
    """Facets of Γ1 beside a punch tilt towards its walls: these are far, and take no force away."""
    spans = ((-0.3, -0.3, -0.5), (1.3, 1.3, 0)), ((0, 0, 0), (1, 1, 0.5))
    found = []
    for every in (False, True):
        F, u, bcs, sides = [], [], [], []
        for i, (low, high) in enumerate(spans):
            cells = (4 + 2 * i, 4 + 2 * i, 2)
            mesh = meshing.create_box(comm, [low, high], cells, meshing.CellType.hexahedron)
            V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
            body = Elastic.on(V, (1.0, 1.0), large=True)
            held = boundary(mesh, 2, (low, high)[i][2])
            dofs = fem.locate_dofs_topological(V, 2, held)
            bcs.append(fem.dirichletbc(default_scalar_type((0, 0, -depth * i)), dofs, V))
            F.append(body.F)
            u.append(body.u)
            mesh.topology.create_connectivity(2, 3)
            free = np.setdiff1d(meshing.exterior_facet_indices(mesh.topology), held)
            sides.append((V, free if every else boundary(mesh, 2, 0)))
        contact = Contact(*sides[::-1])
        problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
        problem.solve()
        assert problem.iterations <= 6
        found.append(contact.force(problem)[2])
    close(found[1], found[0], 1e-9)


@pytest.mark.ranks(2)
def test_overlap_of_a_corner(caplog):
    """A pyramid inside a facet, whose vertices have positive mean gaps: told without a pressure."""
    F, u, bcs, sides = [], [], [], []
    for i, n in enumerate(((4, 4, 2), (3, 3, 1))):

        def place(s, i=i):
            x = 3 * s - (1.5, 1.5, 0)
            peak = 2.5 - np.abs(x[:, :2]).max(axis=1)
            x[:, 2] = s[:, 2] + 0.01 if i else s[:, 2] * peak - 2.5
            return x

        mesh, ft = meshes.block(comm, n, place, cell="hexahedron")
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        body = Elastic.on(V)
        away = fem.locate_dofs_topological(V, 2, ft.find((meshes.BACK, meshes.FRONT)[i]))
        bcs.append(fem.dirichletbc(default_scalar_type((0, 0, -0.61 * i)), away, V))
        F.append(body.F)
        u.append(body.u)
        sides.append((V, ft.find((meshes.FRONT, meshes.BACK)[i])))
    contact = Contact(*sides)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    with caplog.at_level("WARNING", logger="hypergap_dolfinx"):
        problem.solve()
        problem.solve()
    assert not contact.active.any()
    told = [record.message for record in caplog.records if "overlap" in record.message]
    assert len(told) == (comm.rank == 0)
    assert all("surfaces overlap by 0.6 facets" in message for message in told), told


@pytest.mark.ranks(2)
def test_depths_and_distances():
    """Where surfaces overlap, are apart, and where one ends: nothing is known beyond."""
    for gap in (-0.04, 0.03):
        two = sides((lambda x, y: 0 * x, lambda x, y, gap=gap: gap + 0 * x), offset=0.4)
        u = at_rest(two)
        segments = SpaceSegments.between(two, u)
        x = two[1].reference.x
        far, deep, _ = segments.reaches(u, np.full(len(x), 1e-3), np.ones(len(x)))
        inside, outside = (x[:, :2] < 0.95).all(axis=1), (x[:, :2] > 1.2).any(axis=1)
        close(np.maximum(far, deep)[inside], np.full(inside.sum(), abs(gap)), 1e-12)
        assert not far[outside].any() and not deep[outside].any()
        assert not (deep if gap > 0 else far).any()


def sides(heights, h=(0.25, 0.17), degree=1, offset=0.0):
    """Two surfaces, each from 0 to 1 but for the second one's offset; heights tell both."""
    found = []
    for i, height in enumerate(heights):

        def place(x, i=i, height=height):
            x[:, :2] += offset * i
            x[:, 2] = height(*x[:, :2].T) + (x[:, 2] - (1 - i)) * 0.5
            return x

        mesh, ft = meshes.solid_block(comm, h[i], place, degree=degree)
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        facets = ft.find((meshes.FRONT, meshes.BACK)[i])
        found.append(MovingSurface(create_surface(V, facets, f"Γ{i}")))
    return tuple(found)


def at_rest(two):
    return tuple(np.zeros((len(side.dofs), 3)) for side in two)


def test_pieces_are_found_once(monkeypatch):
    """Where surfaces' facets are of one size, there is room for their pieces at first."""
    found = []

    def call(name, *given):
        found.append(name)
        return compiled.call(name, *given)

    monkeypatch.setattr(opposite, "call", call)
    two = sides((lambda x, y: 0 * x, lambda x, y: 0 * x + 0.01), (0.11, 0.1))
    SpaceSegments(two).gap(at_rest(two))
    assert found.count("find_pieces") == 1


def rough(
    degree=1,
    cell=meshing.CellType.tetrahedron,
    low=(0.23, 0.31),
    high=(0.7, 0.8),
    gap=0.1,
    size=0.02,
    cells=(4, 3),
):
    """Two planes, and displacements that part them and make both rough."""
    found, rng = [], np.random.default_rng(1)
    for i, (start, end) in enumerate((((0, 0, -0.5), (1, 1, 0)), ((*low, 0), (*high, 0.5)))):
        mesh = meshing.create_box(comm, [start, end], (cells[i], cells[i], 1), cell)
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        found.append(MovingSurface(create_surface(V, boundary(mesh, 2, 0), f"Γ{i}")))
    u = [size * rng.standard_normal((len(side.dofs), 3)) for side in found]
    u[1] += (0, 0, gap)
    return tuple(found), tuple(u), rng


def dense(sparse, shape):
    A = np.zeros(shape)
    np.add.at(A, (sparse.i, sparse.j), sparse.values)
    return A


STEP = 1e-5  # of differences of the fourth order


@pytest.mark.parametrize(
    ("options", "gradient", "curvature"),
    (
        ({}, 1e-9, 1e-9),
        ({"gap": -0.05}, 1e-9, 1e-9),
        ({"low": (-0.3, 0.31)}, 1e-9, 1e-9),  # Γ0 ends
        ({"cell": meshing.CellType.hexahedron, "size": 1e-3}, 1e-6, 1e-4),
        ({"cell": meshing.CellType.hexahedron, "cells": (1, 2)}, 1e-9, 1e-9),  # none of Γ0's edges
        ({"cell": meshing.CellType.hexahedron, "degree": 2, "cells": (1, 2)}, 1e-9, 1e-9),
        ({"degree": 2, "size": 1e-3}, 1e-5, 1e-3),  # curved edges, cut as if they were straight
        ({"cell": meshing.CellType.hexahedron, "degree": 2, "size": 1e-3}, 1e-5, 1e-3),
    ),
)
def test_derivatives(options, gradient, curvature):
    """C is ∂g/∂u and H is ∂(pᵀC)/∂u, with pieces and directions that move; all balance."""
    two, u, rng = rough(**options)
    opening = SpaceSegments.between(two, u)
    g, m, C = opening.gap(u)
    size = 3 * sum(map(len, u))
    C = dense(C, (len(g), size))
    p = rng.random(len(g))
    H = dense(opening.curvature(u, p), (size, size))
    close(H, H.T, 1e-13)
    direction = [rng.standard_normal(part.shape) for part in u]
    flat = np.concatenate([part.ravel() for part in direction])

    def at(t):
        g, _, C = opening.gap(tuple(a + t * d for a, d in zip(u, direction, strict=True)))
        return np.concatenate((g, p @ dense(C, (len(g), size))))

    difference = (8 * (at(STEP) - at(-STEP)) - at(2 * STEP) + at(-2 * STEP)) / (12 * STEP)
    close(difference[: len(g)], C @ flat, gradient)
    close(difference[len(g) :], H @ flat, curvature)
    assert (m >= 0).all() and m.sum() > 0.1
    forces = (p @ C).reshape(-1, 3)
    assert np.abs(forces.sum(axis=0)).max() <= 1e-13 * np.abs(forces).sum()
    moved = [_positions(side, part) for side, part in zip(two, u, strict=True)]
    moments = np.cross(np.concatenate(moved), forces)
    assert np.abs(moments.sum(axis=0)).max() <= 1e-13 * np.abs(moments).sum()


def _positions(side, u):
    """Where the dofs of a surface are now."""
    surface = side.displaced(u)
    x = np.empty((len(side.dofs), 3))
    x[side.at_facets] = surface.nodes  # of the dofs' element
    return x


def seen(two, u):
    """Segments, and gaps and areas of all parts, before rows of rims are blended."""
    segments = SpaceSegments.between(two, u)
    gaps = segments._at(u)
    return segments, gaps.rays.gaps()[0], gaps.areas


@pytest.mark.parametrize("degree", (1, 2))
@pytest.mark.parametrize("gap", (0.0, 3.0))
def test_opposite_at_any_distance(gap, degree):
    """From a plane to what is curved and overlaps in part: the volume between them."""

    def round_one(x, y):
        return -gap - 0.3 * (x - 0.4) ** 2 - 0.2 * y**2

    two = sides((round_one, lambda x, y: 0 * x), degree=degree, offset=0.31)
    u = at_rest(two)
    _, g, areas = seen(two, u)
    assert abs(areas.sum() - 0.69**2) <= 1e-12 and areas.min() >= 0
    points, weights = basix.make_quadrature(basix.CellType.quadrilateral, 4)
    exact = -(0.69**2) * weights @ round_one(*(0.31 + 0.69 * points).T)
    assert abs(g.sum() - exact) <= (3e-3, 1e-12)[degree - 1] * (1 + exact)


def test_opposite_where_they_slide():
    """Whatever the offset, and however near edges are to each other: nothing is lost, or jumps."""
    two = sides((lambda x, y: -0.1 - 0.2 * (x**2 + y**2), lambda x, y: 0 * x))
    matching = sides((lambda x, y: 0 * x, lambda x, y: 0.1 + 0 * x), h=(0.25, 0.25))
    rng = np.random.default_rng(3)
    for size in (0, 1e-12, 1e-9, 1e-8, 1e-7, 1e-5, 1e-3, 0.1, 0.5, 0.9):
        move = size * rng.standard_normal(3) * (1, 1, 0.2)
        move = np.clip(move, -0.9, 0.9)
        area = np.prod(1 - np.abs(move[:2]))
        for pair in (two, matching):
            u0, u1 = at_rest(pair)
            moved = u0, u1 + move
            segments, _, areas = seen(pair, moved)
            g, m, _ = segments.gap(moved)
            assert abs(areas.sum() / area - 1) <= 1e-11
            if pair is matching and size < 1e-2:
                g0, m0, _ = SpaceSegments.between(pair, (u0, u1)).gap((u0, u1))
                assert np.abs(m - m0).max() <= 3 * size and np.abs(g - g0).max() <= 3 * size


@pytest.mark.parametrize("cell", (meshing.CellType.tetrahedron, meshing.CellType.hexahedron))
@pytest.mark.parametrize("degree", (1, 2))
def test_straight_outlines_that_are_one(degree, cell):
    """What crosses at angles of round-off: forces on nodes inside don't hang on these."""
    found, u, rng = rough(degree, cell, low=(0, 0), gap=0, size=0)
    x, y = np.vstack([_positions(*each) for each in zip(found, u, strict=True)])[:, :2].T
    u[1][:, 2] = 1e-6 * x[-len(u[1]) :]
    two, u, y, forces = found[::-1], u[::-1], np.roll(y, len(u[1])), []
    for k in range(8):  # in the last ones a diagonal passes the middle of a facet
        noise = (1e-14, 1e-15)[k > 3]
        moved = tuple(part + noise * rng.standard_normal(part.shape) for part in u)
        g, _, C = SpaceSegments.between(two, moved).gap(moved)
        forces.append(dense(C, (len(g), 3 * len(y)))[:, np.repeat(y > 1e-9, 3)])
    assert np.ptp(forces, axis=0).max() <= 1e-11  # the square of gaps, and round-off


@pytest.mark.parametrize("degree", (3, 4))
def test_rule_where_facets_come_to_be_covered(degree):
    """The same before and after: forces change as little as gaps."""
    cell = meshing.CellType.hexahedron
    two, u, _ = rough(degree, cell, low=(0, 0.31), size=0, gap=1e-6)
    num, found = 3 * sum(map(len, u)), []
    for side, part in zip(two, u, strict=True):
        x, y, _ = _positions(side, 0 * part).T
        part[:, 2] += 0.1 * x**2 - 0.2 * x * y
    for move in (-2e-6, 2e-6):
        moved = u[0], u[1] + (move, 0, 0)
        g, _, C = SpaceSegments.between(two, moved).gap(moved)
        found.append(dense(C, (len(g), num)))
    close(*found, 1e-4)  # .1 and 1 % with degree 4 where they are covered in part


def test_curved_outlines_that_are_one():
    """But for gaps seen along normals that lean they cross anywhere: forces don't jump."""
    two, u, rng = rough(2, meshing.CellType.hexahedron, low=(0, 0), gap=0, size=0)
    for part, side, gap in zip(u, two, (0, 2e-3), strict=True):
        x, y, _ = _positions(side, 0 * part).T
        part[:] = 0.03 * np.stack((np.sin(3 * x + y**2), y * np.cos(2 * x + y), 0 * x), axis=1)
        part[:, 2] = 0.03 * np.cos(3 * x) * np.cos(2 * y) + gap * np.cos(9 * x + 4 * y)
    num = 3 * sum(map(len, u))
    g, _, C = SpaceSegments.between(two, u).gap(u)
    for _ in range(3):
        moved = tuple(part + 1e-9 * rng.standard_normal(part.shape) for part in u)
        for part, side in zip(moved, two, strict=True):
            part[_positions(side, 0 * part)[:, 1] < 1e-9, 1] = 0  # a plane of symmetry
        after, _, other = SpaceSegments.between(two, moved).gap(moved)
        change = (dense(other, (len(g), num)) - dense(C, (len(g), num))).sum(axis=0)
        assert np.abs(after - g).max() <= 1e-9 and np.abs(change).max() <= 5e-9


@pytest.mark.parametrize("degree", [2, 4, 6])
def test_rule(degree):
    """Polynomials are integrated exactly; another first corner, or one on an edge, is no change."""
    corners = np.array(((0, 0), (2, 0.3), (1.6, 1), (0.2, 0.9)))
    many = np.insert(corners, 1, (1.2, 0.18), axis=0)
    polygons = [np.vstack((corners, corners[-1:])), many, np.roll(many, 2, axis=0)]
    points, _, weights = moments.rule(np.array(polygons), degree)
    points, weights = points.reshape(3, -1, 2), weights.reshape(3, -1)
    for other in (1, 2):
        close(points[other], points[0], 1e-12)
        close(weights[other], weights[0], 1e-12)
    inner, whole = basix.make_quadrature(basix.CellType.quadrilateral, degree + 1)
    x, y = inner.T[..., None]
    at = (1 - x) * (1 - y) * corners[0] + x * (1 - y) * corners[1]
    at = at + x * y * corners[2] + (1 - x) * y * corners[3]
    edges = (1 - y) * (corners[1] - corners[0]) + y * (corners[2] - corners[3])
    others = (1 - x) * (corners[3] - corners[0]) + x * (corners[2] - corners[1])
    whole = whole * (edges[:, 0] * others[:, 1] - edges[:, 1] * others[:, 0])
    for i in range(degree + 1):
        exact = whole @ (at[:, 0] ** i * at[:, 1] ** (degree - i))
        found = weights[0] @ (points[0, :, 0] ** i * points[0, :, 1] ** (degree - i))
        assert found == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("degree", [2, 4, 6])
def test_rule_on_slivers(degree):
    """As narrow as round-off, in any direction: weights are no larger than areas."""
    x = np.random.default_rng(0).uniform(size=(200, 3, 2))
    x[:, 1:] -= x[:, :1]
    x[:, 2] = x[:, 1] * x[:, 2, :1] + np.logspace(-14, -2, 200)[:, None] * x[:, 2]
    turned = np.linalg.det(x[:, 1:]) < 0
    x[turned, 1:] = x[turned, :0:-1]
    x[:, 0], area = 0, np.linalg.det(x[:, 1:]) / 2
    points, each, weights = moments.rule(np.concatenate((x, x[:, -1:]), axis=1)[area > 0], degree)
    assert np.isfinite(points).all()
    some = area[area > 0]
    assert (np.bincount(each, np.abs(weights)) <= 3 * some).all()


def stacked(num):
    """Sheets of Γ0 one behind the other, of which Γ1 reaches over two ends, and the first alone."""
    below, above = (side.reference for side in sides((lambda x, y: 0 * x,) * 2, offset=0.31))
    down = np.array([(0, 0, -0.4 * k) for k in range(num)])
    dofs = below.dofs.max() + 1
    all_of_them = replace(
        below,
        x=np.concatenate([below.x + part for part in down]),
        facets=np.vstack([below.facets + len(below.x) * k for k in range(num)]),
        own_nodes=np.concatenate([below.nodes + part for part in down]),
        dofs=np.vstack([below.dofs + dofs * k for k in range(num)]),
    )
    return [(MovingSurface(each), MovingSurface(above)) for each in (all_of_them, below)]


@pytest.mark.parametrize("num", (2, 4, 8))
def test_nearest_sheet(num):
    """Of sheets one behind the other only the nearest one counts, also where it ends."""
    found = [seen(two, at_rest(two)) for two in stacked(num)]
    assert abs(found[0][2].sum() - 0.69**2) <= 1e-12
    assert np.abs(found[0][1] - found[1][1]).max() <= 1e-13
    close(found[0][2], found[1][2], 1e-12)


def test_too_many_sheets():
    """More sheets than there is room for are an error, no wrong gaps."""
    two = stacked(9)[0]
    with raises(SolveError, "more than 8 sheets"):
        seen(two, at_rest(two))


def test_not_facing():
    two = sides((lambda x, y: 0 * x, lambda x, y: 0.1 + 0 * x))
    with raises(InterfaceError, r"nothing of Γ1 \(around .*\) lies opposite Γ0"):
        SpaceSegments.between((two[0], two[0]), at_rest((two[0], two[0])))


def on_top(degree, middle=(0.5, 0.5)):
    """A square of four facets, and 0.1 above it a smaller one of nine.

    Args:
        degree: That of displacements.
        middle: Where the vertex in the larger one's middle is.
    """
    found = []
    for i in (0, 1):

        def place(x, i=i):
            x[np.isclose(x[:, :2], 0.5).all(axis=1), :2] = middle
            return x / 2 - (0, 0, 0.5) if i == 0 else x * (0.4, 0.4, 1) + (0.05, 0.05, 0.1)

        mesh, ft = meshes.block(comm, (2 + i, 2 + i, 1), place, cell="hexahedron")
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        facets = ft.find((meshes.FRONT, meshes.BACK)[i])
        found.append(MovingSurface(create_surface(V, facets, f"Γ{i}")))
    return tuple(found)


def test_facets_with_inner_corners():
    """Warped facets may look like that: what a facet loses its neighbours must not."""
    two = on_top(1, middle=(0.24, 0.24))
    _, g, areas = seen(two, at_rest(two))
    close(areas.sum(), 0.4**2, 1e-13)
    close(g.sum(), 0.1 * 0.4**2, 1e-13)


@pytest.mark.parametrize("seed", (274, 113, 235))
def test_rays_that_meet_no_folded_facet(seed):
    """They saw what is far beyond the facet: gaps of up to a million times the size."""
    two = on_top(2)
    rng = np.random.default_rng(seed)
    u = at_rest(two)
    u[0][:] = rng.uniform(-1, 1, u[0].shape) * (0.08, 0.08, 0.024)
    _, g, areas = seen(two, u)
    assert np.abs(g).max() <= 0.2 * 0.4**2 / 9 and areas.sum() >= 0.3**2
