# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Solids that overlap in part: patch tests with all stresses, cuts of any width."""

from itertools import product

import numpy as np
import pytest
from helpers import comm, sweep
from scipy.sparse.linalg import spsolve
from test_clip import SQUARE, common_area, placed
from test_solids_interfaces import NU, errors, linear, stress

import basix
import meshes
import ufl
from dolfinx import fem
from hypergap_dolfinx import Tie, TiedProblem
from hypergap_dolfinx.surface.pieces import Side
from hypergap_dolfinx.trimming.clip import clip

SCENES = {
    "inside": (0, 0.45, (0.51, 0.5)),
    "rotated": (30, 0.45, (0.51, 0.5)),
    "over an edge": (0, 0.5, (0.9, 0.45)),
    "over a corner": (20, 1, (1, 1)),
    "crossing": (40, (2, 0.4), (0.5, 0.5)),
}


def linear_stress():
    gradient = np.array(linear(np.eye(3)))
    strain = (gradient + gradient.T) / 2
    return (strain + NU / (1 - 2 * NU) * np.trace(strain) * np.eye(3)) / (1 + NU)


def free_load(tie, i, V, stress_at=lambda x: linear_stress()):
    """A source whose work is that of a field's traction on the free part of a side."""
    surfaces = tie.domain.surfaces
    whole = [Side.of(s, np.arange(len(s.facets))) for s in surfaces]
    surface, own = surfaces[i], whole[i].in_halves()
    with pytest.MonkeyPatch.context() as patch:
        # Cut also what the tie leaves as it is
        patch.setattr("hypergap_dolfinx.trimming.clip.NEARLY", 0.0)
        parts = [(own, 1.0), *((pair[i], -1.0) for pair in clip(*whole))]
    points, weights = basix.make_quadrature(basix.CellType.triangle, 6)
    load = np.zeros((V.dofmap.index_map.size_local, 3))
    for part, sign in parts:
        each, at = np.repeat(np.arange(len(part.X)), len(points)), np.tile(points, (len(part.X), 1))
        edges = part.slopes(each, at)
        at = part.in_facets(each, at)
        shape = (len(part.X), len(points), -1)
        phi = surface.element.tabulate(0, at)[0, :, :, 0].reshape(shape)
        x, d, e = (
            np.einsum("tqa,tai->tqi", psi.reshape(shape), surface.nodes[part.facets])
            for psi in surface.geometry.tabulate(1, at)[:, :, :, 0]
        )
        N = np.cross(d, e)  # the area with its normal, as to its length
        N *= np.copysign(1.0, np.einsum("tqi,ti->tq", N, part.normals))[..., None]
        dA = sign * np.abs(np.linalg.det(edges)).reshape(N.shape[:2]) * weights
        traction = (stress_at(x) @ N[..., None])[..., 0]
        values = np.einsum("tq,tqa,tqi->tai", dA, phi, traction)
        np.add.at(load, surface.dofs[part.facets], values)
    mass = fem.form(ufl.inner(ufl.TrialFunction(V), ufl.TestFunction(V)) * ufl.dx)
    M = fem.assemble_matrix(mass).to_scipy()
    source = fem.Function(V)
    source.x.array[:] = spsolve(M.tocsc(), load.ravel())
    return source


CELLS = {"tets": ("tetrahedron",) * 2, "hexes": ("hexahedron",) * 2}
CELLS |= {"on tets": ("tetrahedron", "hexahedron"), "on hexes": ("hexahedron", "tetrahedron")}


def solve(scene, degree, swap, cells="tets", shape=lambda x: x, n=((4, 4, 2), (3, 3, 2))):
    """Errors of displacement, stress (L²) and traction (largest)."""
    above = scene if callable(scene) else placed(*scene)
    places = (lambda x: x - (0, 0, 1)), (lambda x: above(x / (1, 1, 2)))
    sides, forms, loads, bodies = [], [], [], []
    for tag, cell, count, place in zip(
        (meshes.FRONT, meshes.BACK), CELLS[cells], n, places, strict=True
    ):
        mesh, ft = meshes.block(comm, count, lambda x, place=place: shape(place(x)), cell=cell)
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        exact = stress(ufl.as_vector(linear(ufl.SpatialCoordinate(mesh))))
        tags = tuple(t for t in range(1, 7) if t != tag)
        ds = ufl.Measure("ds", mesh, subdomain_data=ft)(tags)
        forms.append(ufl.inner(stress(u), ufl.sym(ufl.grad(v))) * ufl.dx)
        loads.append(ufl.dot(ufl.dot(exact, ufl.FacetNormal(mesh)), v) * ds)
        sides.append((V, ft.find(tag)))
        bodies.append((mesh, ft))
    tie = Tie(*(sides[::-1] if swap else sides))
    for i, (V, _) in enumerate(sides):
        source = free_load(tie, 1 - i if swap else i, V)
        loads[i] += ufl.inner(source, ufl.TestFunction(V)) * ufl.dx
    g = fem.Function(sides[0][0])
    g.interpolate(lambda x: np.array(linear(x)))
    held = fem.locate_dofs_topological(sides[0][0], 2, bodies[0][1].find(meshes.BACK))
    problem = TiedProblem(forms, loads, bcs=[fem.dirichletbc(g, held)], ties=[tie])
    us = problem.solve()
    q = tie.quadrature(2 * degree)
    error = np.abs(q.evaluate(tie.traction(problem)) - q.normal @ linear_stress()).max()
    return *errors(us, (linear, linear), (1.0, 1.0)), error / np.abs(linear_stress()).max()


def sheared(x):
    """Facets become parallelograms."""
    return x @ np.array([(1, 0.1, 0), (0.25, 1, 0), (0, 0.1, 1)])


CASES = list(product(CELLS, SCENES, (1, 2), (False, True)))


@pytest.mark.serial
@pytest.mark.parametrize(("cells", "scene", "degree", "swap"), sweep(CASES, 13))
def test_patch(cells, scene, degree, swap):
    l2, s, traction = solve(SCENES[scene], degree, swap, cells, sheared)
    print(l2, s, traction)
    assert max(l2, s) <= 1e-11
    assert traction <= 1e-9  # with multipliers on a corner with 31 % of a Q2 facet .8 to 1.3e-9


CUTS = (1e-12, 1e-9, 5e-9, 1.1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 0.29, 0.31, 0.5, 0.9)
KINDS = {
    "beyond edges": lambda e: ((0, 0.5, (0.25 - e / 4, 0.5)), 3),
    "beyond vertices": lambda e: ((0, 0.5, (0.5 + e / 4,) * 2), 3),
    "beside edges": lambda e: ((0, 0.5, (0.5 + e / 4, 0.5)), 2),
    "over a corner": lambda e: ((0, 0.5, (1 - e / 4,) * 2), 3),
    "turned": lambda e: ((np.degrees(e / 4), 0.5, (0.5, 0.5)), 3),
    "turned on edges": lambda e: ((np.degrees(e / 4), 0.5, (0.5, 0.5)), 2),
}
NARROW = list(product(CUTS, (1, 2), (False, True), KINDS))


@pytest.mark.serial
@pytest.mark.parametrize(("cut", "degree", "swap", "kind"), sweep(NARROW, 41))
def test_narrow_cuts(cut, degree, swap, kind):
    """The block ends a part of a facet beside the plate's edges, or is turned by it."""
    scene, n = KINDS[kind](cut)
    l2, s, traction = solve(scene, degree, swap, n=((4, 4, 1), (n, n, 1)))
    print(cut, l2, s, traction)
    assert l2 <= 5e-10
    assert traction <= 1e-6


MOVED = {
    "shifted": lambda e: placed(0, 1, (0.5 + 0.83 * e, 0.5 - 0.37 * e)),
    "shifted along an axis": lambda e: placed(0, 1, (0.5 + e, 0.5)),
    "turned": lambda e: placed(np.degrees(e), 1, (0.5, 0.5)),
    "stretched": lambda e: placed(0, (1 + e, 1 - 0.6 * e), (0.5, 0.5)),
    "wavy": lambda e: lambda x: x + e * np.sin(25 * x[:, [1, 0, 0]] + (1, 4, 0)) * (1, 1, 0),
}
NEARLY = list(product((1, 2), MOVED, (1e-7, 9e-6), (False, True), CELLS))


@pytest.mark.serial
@pytest.mark.parametrize(("degree", "kind", "shift", "swap", "cells"), sweep(NEARLY, 37))
def test_matching_meshes_moved_by_next_to_nothing(degree, kind, shift, swap, cells):
    """By parts of a facet. What is tied is what both have in common, to second order."""
    place = MOVED[kind](shift / 4)
    l2, s, traction = solve(place, degree, swap, cells, n=((4, 4, 1), (4, 4, 1)))
    print(l2, s, traction)
    assert max(l2, s) <= 1e-10  # hexahedra and waves 4e-12
    assert traction <= 25 * shift**2 + 1e-11


def on_cylinder(x):
    """Angle, length and radius."""
    return np.column_stack((x[:, 2] * np.sin(x[:, 0]), x[:, 1], x[:, 2] * np.cos(x[:, 0])))


def on_sphere(x):
    """Two angles and the radius."""
    c, s = np.cos(x), np.sin(x)
    return x[:, 2:] * np.column_stack((s[:, 0] * c[:, 1], s[:, 1], c[:, 0] * c[:, 1]))


def smooth(x, m=np):
    """A field that is in no finite element space."""
    return (
        m.sin(1.3 * x[0] + 0.4) * m.cos(0.9 * x[1]),
        0.7 * m.cos(1.1 * x[0]) * m.exp(0.5 * x[2]),
        m.sin(x[0] + 0.5 * x[1] - 0.7 * x[2]),
    )


def smooth_stress(x):
    """Its stress at points, ``(..., 3, 3)``, by a complex step."""
    x = np.moveaxis(x, -1, 0)
    steps = 1e-30j * np.eye(3).reshape(3, 3, *(1,) * (x.ndim - 1))
    gradient = np.stack([np.imag(smooth(x + step)) / 1e-30 for step in steps])  # (j, i, ...)
    gradient = np.moveaxis(gradient, (0, 1), (-1, -2))
    strain = (gradient + np.swapaxes(gradient, -1, -2)) / 2
    trace = np.trace(strain, axis1=-2, axis2=-1)[..., None, None]
    return (strain + NU / (1 - 2 * NU) * trace * np.eye(3)) / (1 + NU)


PAD = 17, (0.62, 0.55), (0, 0)


def curved(surface, degree, swap, level, cell="tetrahedron", pad=PAD, n=(6, 4)):
    """Relative errors of displacement and its gradient: a pad on a plate, both of a surface."""
    places = (
        lambda x: surface((x - (0.5, 0.5, 0)) * (1.2, 1.2, 0.3) + (0, 0, 0.7)),
        lambda x: surface(placed(*pad)(x * (1, 1, 0.25)) + np.array((0, 0, 1))),
    )
    ends = (meshes.FRONT, meshes.BACK)
    sides, forms, loads, bcs = [], [], [], []
    for count, tag, place in zip(n, ends, places, strict=True):
        count = count * level, count * level, (2 if degree < 3 else 1) * level
        mesh, ft = meshes.block(comm, count, place, cell=cell, degree=degree)
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        exact = stress(ufl.as_vector(smooth(ufl.SpatialCoordinate(mesh), ufl)))
        rule = {"quadrature_degree": 2 * degree + 2}
        dx = ufl.Measure("dx", mesh, metadata=rule)
        ds = ufl.Measure("ds", mesh, subdomain_data=ft, metadata=rule)
        around = (meshes.LEFT, meshes.RIGHT, meshes.BOTTOM, meshes.TOP)
        forms.append(ufl.inner(stress(u), ufl.sym(ufl.grad(v))) * dx)
        loads.append(-ufl.dot(ufl.div(exact), v) * dx)
        loads[-1] += ufl.dot(ufl.dot(exact, ufl.FacetNormal(mesh)), v) * ds(around)
        g = fem.Function(V)
        g.interpolate(lambda x: np.array(smooth(x)))
        far = ft.find(ends[1] if tag == ends[0] else ends[0])
        bcs.append(fem.dirichletbc(g, fem.locate_dofs_topological(V, 2, far)))
        sides.append((V, ft.find(tag)))
    tie = Tie(*(sides[::-1] if swap else sides))
    for i, (V, _) in enumerate(sides):
        source = free_load(tie, 1 - i if swap else i, V, smooth_stress)
        loads[i] += ufl.inner(source, ufl.TestFunction(V)) * ufl.dx
    us = TiedProblem(forms, loads, bcs=bcs, ties=[tie]).solve()
    totals = np.zeros(4)
    for u in us:
        exact = ufl.as_vector(smooth(ufl.SpatialCoordinate(u.function_space.mesh), ufl))
        dx = ufl.dx(metadata={"quadrature_degree": max(6, 2 * degree + 2)})
        for j, f in enumerate((u, fem.Function(u.function_space))):
            for i, e in enumerate((f - exact, ufl.grad(f) - ufl.grad(exact))):
                totals[2 * i + j] += fem.assemble_scalar(fem.form(ufl.inner(e, e) * dx))
    return np.sqrt(totals[0::2] / totals[1::2])


def equal_area(x):
    """On a sphere of radius one, with the areas of the plane at x₂ = 1."""
    c = np.sqrt(1 - x[:, 1] ** 2)
    return x[:, 2:] * np.column_stack((c * np.sin(x[:, 0]), x[:, 1], c * np.cos(x[:, 0])))


OUTLINES = {  # cells, degree, levels, and how the pad is placed
    "inside": ("tetrahedron", 2, (1, 2), (17, (0.62, 0.55), (0, 0))),
    "over a corner": ("tetrahedron", 2, (1, 2), (17, (0.62, 0.55), (0.45, 0.38))),
    "quadrilaterals": ("hexahedron", 2, (1, 2), (17, (0.62, 0.55), (0, 0))),
    "slivers": ("hexahedron", 2, (1,), (49, (0.51, 0.6), (-0.47, -0.38))),
    "degree 3": ("tetrahedron", 3, (1,), (49, (0.51, 0.6), (-0.47, -0.38))),
}


@pytest.mark.serial
@pytest.mark.parametrize("scene", OUTLINES)
def test_curved_outline(scene):
    """Γ0, Γ1 and Σ have the area that both have in common, to the order of the geometry."""
    cell, degree, levels, pad = OUTLINES[scene]
    pad = placed(*pad)
    plate = (SQUARE - (0.5, 0.5, 0)) * 1.2
    exact = common_area(pad(SQUARE)[:, :2], plate[:, :2])
    places = (
        lambda x: equal_area((x - (0.5, 0.5, 0)) * (1.2, 1.2, 0.3) + (0, 0, 0.7)),
        lambda x: equal_area(pad(x * (1, 1, 0.25)) + np.array((0, 0, 1))),
    )
    points, weights = basix.make_quadrature(basix.CellType.triangle, 6)
    errors = []
    for level in levels:
        sides = []
        for n, tag, place in zip((6, 4), (meshes.FRONT, meshes.BACK), places, strict=True):
            n = n * level, n * level, 1
            mesh, ft = meshes.block(comm, n, place, cell=cell, degree=degree)
            sides.append((fem.functionspace(mesh, ("Lagrange", degree)), ft.find(tag)))
        tie = Tie(*sides)
        q = tie.quadrature(2 * degree)
        areas = [q.integrate(np.ones_like(q.weights))]
        ((pair),) = clip(*(Side.of(s, np.arange(len(s.facets))) for s in tie.domain.surfaces))
        for part in pair:
            each = np.repeat(np.arange(len(part.X)), len(points))
            tangents = part.geometry(each)(np.tile(points, (len(part.X), 1)))[1]
            areas.append(
                np.linalg.norm(np.cross(*np.moveaxis(tangents, 1, 0)), axis=1)
                @ np.tile(weights, len(part.X))
            )
        errors.append(np.abs(np.array(areas) / exact - 1))
    print(errors)
    assert errors[0].max() < (4e-5 if degree == 2 else 4e-6)
    assert all(fine.max() < 3e-6 for fine in errors[1:])


SURFACES = {"cylinder": on_cylinder, "sphere": on_sphere}
CURVED = [
    pytest.param(*case, marks=() if case[:3] == ("sphere", 1, True) else pytest.mark.slow)
    for case in (
        *product(SURFACES, (1, 2), (False, True), ["tetrahedron"]),
        *product(SURFACES, (2,), (False, True), ["hexahedron"]),
        ("sphere", 3, False, "tetrahedron"),
    )
]


@pytest.mark.serial
@pytest.mark.parametrize(("surface", "degree", "swap", "cell"), CURVED)
def test_curved(surface, degree, swap, cell):
    """A pad within a curved plate is as exact as one on all of it, and converges as fast."""
    n, m = (6, 4) if degree < 3 else (4, 3)
    where = SURFACES[surface], degree, swap
    coarse, fine = (curved(*where, level, cell, n=(n, m)) for level in (1, 2))
    whole = curved(*where, 2, cell, (0, (1.2, 1.2), (0, 0)), (n, 2 * m))
    print(coarse, fine, np.log2(coarse / fine), fine / whole)
    # Degree 1: 1.77 to 1.83 whichever side is Γ1, flat ones too, 1.86 on the next level. It is the
    # scene: where pad and plate match, both are tied to the digits of one mesh of them, which has
    # 1.87 to 1.90, then 1.91 to 1.93
    assert np.log2(coarse / fine)[0] >= (1.75, 2.8, 3.7)[degree - 1]
    assert np.log2(coarse / fine)[1] >= (0.95, 1.8, 2.8)[degree - 1]
    assert (fine <= 1.5 * whole).all()


@pytest.mark.ranks(2)
def test_ranks():
    """The same Σ on any number of ranks: the area, and the part of each facet."""
    sides = []
    for n, tag, place in (
        ((4, 4, 1), meshes.FRONT, lambda x: x - (0, 0, 1)),
        ((3, 3, 1), meshes.BACK, placed(20, 1, (1, 1))),
    ):
        mesh, ft = meshes.block(comm, n, place, cell="tetrahedron")
        sides.append((fem.functionspace(mesh, ("Lagrange", 1)), ft.find(tag)))
    for ends in (sides, sides[::-1]):
        tie = Tie(*ends)
        q = tie.quadrature(2)
        assert q.integrate(np.ones_like(q.weights)) == pytest.approx(0.25, rel=1e-13)
        surface = tie.domain.surfaces[1]
        v = surface.x[surface.facets]
        area = np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1) / 2
        assert tie.domain.covered @ area == pytest.approx(0.25, rel=1e-13)


@pytest.mark.ranks(2)
def test_ranks_of_an_overhang():
    """Entries of B and C add up to the area that both sides have in common."""
    sides = []
    for tag, place in (
        (meshes.FRONT, lambda x: x - (0, 0, 1)),
        (meshes.BACK, placed(0, 1, (0.5 + 2e-6, 0.5 - 1e-6))),
    ):
        mesh, ft = meshes.block(comm, (4, 4, 1), place, cell="tetrahedron")
        sides.append((fem.functionspace(mesh, ("Lagrange", 1)), ft.find(tag)))
    area = (1 - 2e-6) * (1 - 1e-6)
    tie = Tie(*sides, compliance=lambda x: 1 + 0 * x[0])
    C = tie.compliance.matrix(tie.compliance.values())
    for A, sign in zip((*tie.blocks(), C), (-1, 1, 1), strict=True):
        x, y = A.createVecs()
        x.set(1.0)
        A.mult(x, y)
        assert y.sum().real == pytest.approx(sign * area, abs=1e-11)
    C.destroy()
    for degree in (0, 2):
        q = tie.quadrature(degree)
        assert q.integrate(np.ones_like(q.weights)) == pytest.approx(area, abs=1e-11)
