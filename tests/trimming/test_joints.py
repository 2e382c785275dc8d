# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""T-joints on curved interfaces, collars on rods: parts of outlines that are one curve."""

from importlib import import_module
from itertools import pairwise, product

import any_assemblies
import numpy as np
import pytest
from helpers import comm, sweep

import meshes
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints, exterior_facet_indices, meshtags
from hypergap_dolfinx import Tie, TiedProblem, find_touching
from hypergap_dolfinx.core import compat

pytestmark = pytest.mark.serial


def waves(x, m=np):
    return m.sin(1.3 * x[0] + 0.4 * x[1]) + m.cos(0.7 * x[1] - 1.1 * x[2])


def along(x, m=np):
    """No flux through what is parallel to the last axis."""
    return m.sin(2.2 * x[2])


@pytest.mark.parametrize(("seed", "pair", "most"), ((17, (5, 6), 1e-12), (210, (4, 9), 0.01)))
def test_area(seed, pair, most):
    """Ties of random assemblies: where halves of planar facets are bent, where middle nodes are
    off the middles of curved edges.

    The first is exact; 8.7 % of the second were missing.
    """
    scene = any_assemblies.Scene(seed, 3)
    spaces = [fem.functionspace(scene.mesh(i)[0], ("Lagrange", scene.degree)) for i in pair]
    (sides,) = find_touching(spaces)
    q = Tie(*sides).quadrature(2 * scene.degree + 2)
    axis, area = scene.faces()[pair]
    flux = scene.area(axis, q.x.reshape(-1, 3), q.weights.ravel(), q.normal.reshape(-1, 3))
    assert abs(abs(flux) / area - 1) < most


def solved(parts, degree, field=waves):
    """Areas of ties, and the gradient's error over the interpolant's, u given at the outside."""
    spaces, forms, loads, bcs, exacts = [], [], [], [], []
    for mesh in parts:
        V = fem.functionspace(mesh, ("Lagrange", degree))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        exact = field(ufl.SpatialCoordinate(mesh), ufl)
        forms.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 2})
        loads.append(-ufl.div(ufl.grad(exact)) * v * dx)
        spaces.append(V)
        exacts.append(fem.Function(V))
        exacts[-1].interpolate(field)
    pairs = find_touching(spaces)
    ties = [Tie.between(*sides) for sides in pairs]
    for i, V in enumerate(spaces):
        tied = [f for sides in pairs for W, f in sides if W is V]
        outer = np.setdiff1d(exterior_facet_indices(V.mesh.topology), np.concatenate(tied))
        bcs.append(fem.dirichletbc(exacts[i], fem.locate_dofs_topological(V, 2, outer)))
    us = TiedProblem(forms, loads, bcs=bcs, ties=ties).solve()
    squares = np.zeros(2)
    for pair in zip(us, exacts, strict=True):
        for k, f in enumerate(pair):
            e = ufl.grad(f - field(ufl.SpatialCoordinate(f.function_space.mesh), ufl))
            dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 2})
            squares[k] += fem.assemble_scalar(fem.form(ufl.inner(e, e) * dx))
    rules = [tie.quadrature(2 * degree) for tie in ties]
    areas = [float(q.integrate(np.ones_like(q.weights))) for q in rules]
    return areas, float(np.sqrt(squares[0] / squares[1]))


def blocks_on_a_plate(seed, num):
    """A bent plate under two or four bent blocks that are beside each other."""
    rng = np.random.default_rng(seed)
    degree = 1 + seed % 2
    at, (a, b), phase = rng.uniform(0.35, 0.65, 2), rng.uniform(0.05, 0.2, 2), rng.uniform(0, 6, 2)

    def bent(x):
        height = a * np.sin(2.2 * x[:, 0] + phase[0]) + b * np.cos(1.8 * x[:, 1] + phase[1])
        return np.column_stack((x[:, :2], x[:, 2] + height))

    def part(low, high, n):
        cell = str(rng.choice(("tetrahedron", "hexahedron")))

        def place(x):
            return bent(np.array(low) + x * (np.array(high) - low))

        return meshes.block(comm, n, place, cell=cell, degree=degree)[0]

    def count(least=3, most=7):
        return (*rng.integers(least, most, 2).tolist(), 2)

    xs, ys = (0, at[0], 1), ((0, 1) if num == 2 else (0, at[1], 1))
    parts = [part((0, 0, -0.3), (1, 1, 0), count(4, 8))]
    where = []
    for i, j in product(range(2), range(len(ys) - 1)):
        low, high = (xs[i], ys[j], 0), (xs[i + 1], ys[j + 1], 0.4)
        parts.append(part(low, high, count()))
        x, y = np.meshgrid(
            *(a0 + (a1 - a0) * (np.arange(60) + 0.5) / 60 for a0, a1 in zip(low[:2], high))
        )
        slopes = a * 2.2 * np.cos(2.2 * x + phase[0]), b * 1.8 * np.sin(1.8 * y + phase[1])
        mean = np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2).mean()
        where.append(float(mean * (high[0] - low[0]) * (high[1] - low[1])))
    return parts, degree, where


@pytest.mark.parametrize(("seed", "num"), sweep(list(product(range(40), (2, 4))), 53))
def test_blocks_on_a_bent_plate(seed, num):
    parts, degree, exact = blocks_on_a_plate(seed, num)
    areas, error = solved(parts, degree)
    assert len(areas) == num + (1 if num == 2 else 4)
    np.testing.assert_allclose(areas[:num], exact, rtol=0.03)
    assert error < 1.3


COLLARS = list(product((False, True), (1, 2), (0.09, 0.12, 0.15, 0.2), (0.0, 0.3, 1.0)))


def collar_on_a_rod(imprinted, degree, size, turn):
    """A short thick ring around a longer rod, by Gmsh; with its edges on the rod or without."""
    pytest.importorskip("gmsh")
    io = import_module("dolfinx.io." + ("gmshio" if compat.VERSION < (0, 10) else "gmsh"))
    parts = []
    for name in ("rod", "collar"):
        with meshes.session.gmsh_session() as gmsh:
            gmsh.model.add(name)
            occ = gmsh.model.occ
            if name == "rod":
                heights = (0, 0.4, 0.7, 1.2) if imprinted else (0, 1.2)
                body = [
                    (3, occ.addCylinder(0, 0, low, 0, 0, high - low, 0.3))
                    for low, high in pairwise(heights)
                ]
                if imprinted:
                    occ.fragment(body[:1], body[1:])
            else:
                outer, inner = ((3, occ.addCylinder(0, 0, 0.4, 0, 0, 0.3, r)) for r in (0.55, 0.3))
                body, _ = occ.cut([outer], [inner])
                occ.rotate(body, 0, 0, 0, 0, 0, 1, turn)
            occ.synchronize()
            gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], 1)
            h = size if name == "rod" else 0.8 * size
            gmsh.option.setNumber("Mesh.MeshSizeMin", h)
            gmsh.option.setNumber("Mesh.MeshSizeMax", h)
            gmsh.model.mesh.generate(3)
            gmsh.model.mesh.setOrder(degree)
            parts.append(io.model_to_mesh(gmsh.model, comm, 0)[0])
    return parts


@pytest.mark.parametrize("scene", sweep(COLLARS, 13))
def test_collar(scene):
    """The whole cylinder's part is tied, and as exactly with imprinted edges."""
    field = waves if scene[0] else along  # beside the collar parts of facets are free
    areas, error = solved(collar_on_a_rod(*scene), scene[1], field)
    assert len(areas) == 1
    exact = 2 * np.pi * 0.3 * 0.3
    assert abs(areas[0] / exact - 1) < (scene[2] / 0.3) ** 2 / 6
    assert error < 1.3


def distorted(low, high, phase):
    """A map of the unit cube to a box, whose nodes move along its faces: facets aren't affine."""

    def place(x):
        y = x.copy()
        for i in range(3):
            others = np.cos(3 * x[:, np.arange(3) != i] + phase + (0, i)).prod(axis=1)
            y[:, i] += 0.15 * np.sin(2 * np.pi * x[:, i]) * others
        return np.array(low) + y * np.subtract(high, low)

    return place


@pytest.mark.parametrize("degree", (1, 2))
def test_cut_bilinear_facets(degree):
    """Straight outlines aren't straight in their coordinates; areas were 2 %, λ was 80 % off."""
    boxes = ((0, 0, -0.5), (1, 1, 0)), ((0, 0, 0), (0.47, 1, 0.4)), ((0.47, 0, 0), (1, 1, 0.4))
    cells, counts = ("hexahedron", "hexahedron", "tetrahedron"), ((3, 3, 2), (2, 3, 2), (3, 2, 2))
    inner = (meshes.FRONT,), (meshes.BACK, meshes.RIGHT), (meshes.BACK, meshes.LEFT)
    gradient = np.array((0.3, -0.2, 0.9))
    spaces, facets, forms, loads, exacts = [], [], [], [], []
    for i, box in enumerate(boxes):
        mesh, ft = meshes.block(comm, counts[i], distorted(*box, i), cell=cells[i])
        V = fem.functionspace(mesh, ("Lagrange", degree))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        free = np.setdiff1d(ft.indices, np.concatenate([ft.find(tag) for tag in inner[i]]))
        tags = meshtags(mesh, 2, free, np.ones_like(free))
        ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
        flux = ufl.dot(ufl.as_vector(gradient), ufl.FacetNormal(mesh))
        forms.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        loads.append(ufl.inner(flux, v) * ds)
        exacts.append(fem.Function(V))
        exacts[-1].interpolate(lambda x: gradient @ x)
        spaces.append(V)
        facets.append(ft)
    sides = [
        [(spaces[i], facets[i].find(tag)) for i, tag in pair]
        for pair in (
            ((0, meshes.FRONT), (1, meshes.BACK)),
            ((0, meshes.FRONT), (2, meshes.BACK)),
            ((1, meshes.RIGHT), (2, meshes.LEFT)),
        )
    ]
    ties = [Tie(*pair) for pair in sides]
    areas = [float(q.integrate(np.ones_like(q.weights))) for q in (t.quadrature(4) for t in ties)]
    np.testing.assert_allclose(areas, (0.47, 0.53, 0.4), rtol=0, atol=1e-13)
    fixed = fem.locate_dofs_topological(spaces[0], 2, facets[0].find(meshes.BACK))
    problem = TiedProblem(forms, loads, bcs=[fem.dirichletbc(exacts[0], fixed)], ties=ties)
    off = [
        np.abs(u.x.array - exact.x.array).max()
        for u, exact in zip(problem.solve(), exacts, strict=True)
    ]
    for tie in ties:
        q = tie.quadrature(4)
        off.append(np.abs(q.evaluate(tie.traction(problem))[..., 0] - q.normal @ gradient).max())
    print(off)
    assert max(off[:3]) <= 1.5e-4 and max(off[3:]) <= 2e-3  # 8e-3 and .8 before; interpolated


def rim_moved(cell, degree, shift, n=4):
    """Solution of two cubes with matching facets, nodes of one rim off by parts of a facet."""
    rng = np.random.default_rng(3)
    sides, forms, loads = [], [], []
    for i in (0, 1):

        def place(x, i=i):
            y = x.copy()
            rim = np.isclose(x[:, 0], 0) & (np.abs(x[:, 1:] - 0.5).max(axis=1) > 0.49)
            y[rim, 1:] += i * shift / n * rng.uniform(-1, 1, (int(rim.sum()), 2))
            if i and cell == "hexahedron":  # facets begin at other corners
                y[:, 1:] = np.column_stack((y[:, 2], 1 - y[:, 1]))
            return y + np.array((i, 0, 0))

        mesh, ft = meshes.block(comm, (n, n, n), place, cell=cell)
        V = fem.functionspace(mesh, ("Lagrange", degree))
        u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
        forms.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        loads.append(
            ufl.inner(ufl.sin(3 * x[0]) * ufl.cos(4 * x[1]) * ufl.sin(5 * x[2]), v) * ufl.dx
        )
        sides.append((V, ft.find((meshes.RIGHT, meshes.LEFT)[i])))
        if i == 0:
            fixed = fem.locate_dofs_topological(V, 2, ft.find(meshes.LEFT))
            bc = fem.dirichletbc(fem.Function(V), fixed)
    us = TiedProblem(forms, loads, bcs=[bc], ties=[Tie(*sides)]).solve()
    return np.concatenate([u.x.array for u in us])


@pytest.mark.parametrize("cell", ("hexahedron", "tetrahedron"))
def test_nearly_matching_rims(cell):
    """What is cut at the rim changes nothing in the facets that match: 7e-2 without prisms."""
    exact = rim_moved(cell, 1, 0.0)
    for shift in (2e-5, 1e-3):
        off = np.abs(rim_moved(cell, 1, shift) - exact).max() / np.abs(exact).max()
        print(shift, off)
        assert off <= 2 * shift


def area_of_tie(scene, pair, swapped=False):
    """Relative error of a tie's area, from the flux through it."""
    spaces = [fem.functionspace(scene.mesh(i)[0], ("Lagrange", scene.degree)) for i in pair]
    (sides,) = find_touching(spaces)
    tie = Tie(*sides[:: -1 if swapped else 1])
    axis, area = scene.faces()[pair]
    q = tie.quadrature(2 * scene.degree + 2)
    flux = scene.area(axis, q.x.reshape(-1, 3), q.weights.ravel(), q.normal.reshape(-1, 3))
    return abs(abs(flux) / area - 1)


def test_bent_row_along_an_outline():
    """A row of bent facets comes nearer to the other side's outline than their edges are bent."""
    scene = any_assemblies.Scene(5, 3)
    scene.counts *= 2
    assert area_of_tie(scene, (2, 8)) < 1e-4


@pytest.mark.parametrize("swapped", (False, True))
def test_outline_beside_an_inner_corner(swapped):
    """An outline passes the other's inner corner by less than the surfaces are apart: refused."""
    assert area_of_tie(any_assemblies.Scene(122, 3), (4, 6), swapped) < 3e-4


@pytest.mark.parametrize(
    "number, pair, error", ((134, (2, 11), 1e-2), (134, (9, 11), 3e-3), (356, (0, 7), 1e-2))
)
def test_facets_beyond_an_edge(number, pair, error):
    """An edge that turns by 50° on coarse facets: the next face isn't tied, too (12, 6, 4 %)."""
    assert area_of_tie(any_assemblies.Scene(number, 3), pair) < error


@pytest.mark.parametrize(
    "number, pair, error",
    ((177, (1, 2), 1e-4), (177, (1, 3), 1e-2), (206, (4, 8), 2e-3), (295, (3, 8), 2e-3)),
)
def test_edges_of_coarse_curved_facets(number, pair, error):
    """Boxes bent within two facets: beyond an edge of 50° to 65° between curved facets nothing
    touches. Facets were taken there: cuts failed, or the area was 43 % too large (295)."""
    assert area_of_tie(any_assemblies.Scene(number, 3), pair) < error


def test_thin_bent_cells():
    """A curved cell whose middle lies beyond its facet isn't turned over: 47 % were missing."""
    assert area_of_tie(any_assemblies.Scene(284, 3), (0, 4)) < 1e-3


@pytest.mark.parametrize("swapped", (False, True))
def test_outlines_that_meet_at_no_corner(swapped):
    """Where another attempt finds cells, no outline is moved to a vertex: 1e-4 of the area."""
    sides = []
    for i, n in enumerate((8, 6)):

        def bent(x, i=i):
            x = x + i * np.array((1e-4, -1e-4, 0))
            z = 0.3 * np.sin(1.5 * x[:, 0] + 0.4) * np.cos(1.05 * x[:, 1])
            return np.column_stack((x[:, 0], x[:, 1], z + (x[:, 2] - 1 + i) * 0.4))

        mesh, ft = meshes.block(comm, (n, n, 1), bent, cell="tetrahedron")
        facets = ft.find((meshes.FRONT, meshes.BACK)[i])
        if i == 0:
            x, y, _ = compute_midpoints(mesh, 2, facets).T
            facets = facets[(x < 0.5) | (y < 0.5)]
        sides.append((fem.functionspace(mesh, ("Lagrange", 1)), facets))
    q = Tie(*sides[:: -1 if swapped else 1]).quadrature(4)
    assert abs(abs((q.normal[..., 2] * q.weights).sum()) - 0.74985) < 4e-5


@pytest.mark.parametrize("cell", ("tetrahedron", "hexahedron"))
@pytest.mark.parametrize(("counts", "clearance"), (((3, 2), 0.1), ((4, 3), 0.05), ((5, 3), 0.04)))
def test_clearance_of_coarse_circles(counts, clearance, cell):
    """A bolt's head over a wider hole: chords that come near each other aren't one circle's."""
    spaces = []
    for n, radii, z in zip(
        counts, ((1, 2), (1 - clearance, 1.5)), ((0, 0.5), (0.5, 1)), strict=True
    ):

        def place(x, radii=radii, z=z):
            r, angle = radii[0] + x[:, 0] * (radii[1] - radii[0]), np.pi / 2 * x[:, 1]
            across = r[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
            return np.column_stack((across, z[0] + x[:, 2] * (z[1] - z[0])))

        spaces.append(
            fem.functionspace(meshes.block(comm, (3, n, 1), place, cell=cell)[0], ("P", 1))
        )
    area = sum(
        sign * n * r**2 / 2 * np.sin(np.pi / 2 / n)
        for sign, n, r in ((-1, counts[0], 1), (1, counts[1], 1.5))
    )
    (pair,) = find_touching(spaces)
    for sides in (pair, pair[::-1]):
        assert Tie(*sides).area == pytest.approx(area, rel=1e-10)  # else up to 14 % too large
