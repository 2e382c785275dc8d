# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Interfaces that can be tied but are told: what they lack, with the numbers, and who isn't."""

import logging

import any_assemblies
import numpy as np
import pytest
from helpers import comm, ranks_at_last, two_blocks, two_rings

import meshes
from dolfinx import fem
from hypergap_dolfinx import Tie, find_touching
from meshes import BACK, FRONT, INNER, LEFT, OUTER, RIGHT


def warnings(caplog, *sides):
    """What the tie says, the same on every rank; rank 0 alone says it."""
    caplog.clear()
    with caplog.at_level(logging.WARNING, "hypergap_dolfinx"):
        Tie(*sides)
    said = comm.allgather([record.getMessage() for record in caplog.records])
    assert not any(said[1:])
    assert not any("\n" in line for line in said[0])
    return said[0]


# One side's facets are curved, the other's straight


def rings(n, g, k=(2, 2)):
    sides = []
    for i, tag in enumerate((OUTER, INNER)):
        mesh, ft = meshes.ring_sector(comm, n[i], 1, 2 + i / 2, 2.5 + i / 2, degree=g[i])
        sides.append((fem.functionspace(mesh, ("Lagrange", k[i])), ft.find(tag)))
    return sides


@pytest.mark.ranks(2)
@pytest.mark.parametrize("straight", (0, 1))
def test_straight_against_curved(straight, caplog):
    g = [2, 2]
    g[straight] = 1
    (said,) = warnings(caplog, *rings((4, 6), g))
    assert f"those of Γ{straight} are straight" in said and "setOrder(2)" in said
    r, n = 2.5, (4, 6)[straight]
    off = float(said.split("about ")[1].split(" off")[0])
    assert abs(off / (r * (1 - np.cos(np.pi / 4 / n))) - 1) < 0.05


@pytest.mark.parametrize("g, k", (((2, 2), (2, 2)), ((2, 1), (1, 1))))
def test_curved_alike_or_linear(g, k, caplog):
    """Both; and linear spaces are no more exact on curved facets. Neither: test_domain has it."""
    assert not warnings(caplog, *rings((4, 6), g, k))


def test_curved_elsewhere(caplog):
    """Bodies with curved sides and a straight interface."""
    sides = []
    for i, tag in enumerate((RIGHT, LEFT)):

        def place(x, i=i):
            y = x[:, 1] + (0.2 * np.sin(3 * x[:, 0]) * (x[:, 0] - 1) if i == 0 else 0)
            return np.column_stack((x[:, 0] + i, y))

        mesh, ft = meshes.block(comm, (2, 3 + i), place, degree=2 - i)
        sides.append((fem.functionspace(mesh, ("Lagrange", 2)), ft.find(tag)))
    assert not warnings(caplog, *sides)


@pytest.mark.ranks(2, g=[(2, 1)])
@pytest.mark.parametrize("g", ((2, 1), (1, 2), (2, 2)))
def test_straight_against_curved_in_space(g, caplog):
    pytest.importorskip("gmsh")
    sides = []
    for i, tag in enumerate((OUTER, INNER)):
        mesh, ft = meshes.spherical_shell(comm, 0.4 + 0.1 * i, 1 + i / 2, 1.5 + i / 2, degree=g[i])
        sides.append((fem.functionspace(mesh, ("Lagrange", 2)), ft.find(tag)))
    said = warnings(caplog, *sides)
    if g == (2, 2):
        assert not said
    else:
        (said,) = said
        assert f"those of Γ{g.index(1)} are straight" in said


# Facets of very different width


def crossed(n0, n1, layers, k=1):
    """Blocks on both sides of x = 0."""
    sides = []
    for i, (n, tag) in enumerate(((n0, RIGHT), (n1, LEFT))):

        def place(x, i=i):
            return x + np.array((i - 1, 0, 0))

        mesh, ft = meshes.block(comm, (layers[i], *n), place, cell="tetrahedron")
        sides.append((fem.functionspace(mesh, ("Lagrange", k)), ft.find(tag)))
    return sides


@pytest.mark.ranks(swap=[1])
@pytest.mark.parametrize("swap", (1, -1))
def test_long_crossed_facets(swap, caplog):
    """Ten times narrower one way, whichever side is Γ1."""
    pytest.importorskip("gmsh")
    (said,) = warnings(caplog, *crossed((20, 2), (2, 20), (2, 2))[::swap])
    assert "12 times narrower one way" in said and "refine Γ0 that way" in said


def test_fine_and_deep(caplog):
    """Fine facets with deep cells are better on Γ0, and with flat cells on either side."""
    pytest.importorskip("gmsh")
    sides = crossed((1, 1), (8, 8), (1, 1))
    (said,) = warnings(caplog, *sides)
    assert "8 times narrower" in said and "swap the tie's sides" in said
    assert not warnings(caplog, *sides[::-1])
    assert not warnings(caplog, *crossed((1, 1), (8, 8), (1, 4)))
    assert not warnings(caplog, *crossed((8, 2), (2, 8), (2, 2)))
    assert not warnings(caplog, *crossed((1, 1), (8, 8), (1, 1), k=2))


def test_fine_and_deep_in_the_plane(caplog):
    (said,) = warnings(caplog, *two_blocks((2, 24)))
    assert "swap the tie's sides" in said
    assert not warnings(caplog, *two_blocks((24, 2)))
    assert not warnings(caplog, *two_blocks((4, 16)))


# Outlines that differ


def plates(outline, h=(3, 4), shift=0.0):
    """Blocks above and below z = 0; the upper one is scaled and shifted."""
    sides = []
    for i, tag in enumerate((FRONT, BACK)):

        def place(x, i=i):
            x = x - np.array((0.5, 0.5, 1 - i))
            return x * np.array((outline, outline, 1)) + np.array((shift, 0, 0)) if i else x

        mesh, ft = meshes.block(comm, (h[i], h[i], 1), place, cell="tetrahedron")
        sides.append((fem.functionspace(mesh, ("Lagrange", 1)), ft.find(tag)))
    return sides


def area(sides):
    q = Tie(*sides).quadrature(2)
    return q.integrate(np.ones_like(q.weights))


@pytest.mark.ranks(2, outline=[0.93], swap=[1])
@pytest.mark.parametrize("swap", (1, -1))
@pytest.mark.parametrize("outline", (0.93, 1.08, 1.01))
def test_outlines_apart(outline, swap, caplog):
    """What one side has alone isn't tied, and nothing to warn of."""
    sides = plates(outline)[::swap]
    assert not warnings(caplog, *sides)
    assert area(sides) == pytest.approx(min(outline, 1) ** 2, rel=1e-12)


def test_outlines_shifted(caplog):
    sides = plates(1.0, shift=0.1)
    assert not warnings(caplog, *sides)
    assert area(sides) == pytest.approx(0.9, rel=1e-12)


def holes(h, radius):
    sides = []
    for size, z, tag, r in ((h, (-0.3, 0.0), FRONT, 0.25), (1.3 * h, (0.0, 0.2), BACK, radius)):
        mesh, ft = meshes.perforated_plate(comm, size, z, r)
        sides.append((fem.functionspace(mesh, ("Lagrange", 1)), ft.find(tag)))
    return sides


@pytest.mark.parametrize("h", (0.2, 0.1))
def test_rims_of_holes(h, caplog):
    """Polygons with different corners stay whole; a hole of another radius is cut out."""
    pytest.importorskip("gmsh")
    assert not warnings(caplog, *holes(h, 0.25))
    radius = 0.25 + 0.4 * h
    sides = holes(h, radius)
    assert not warnings(caplog, *sides)
    v = Tie(*sides).domain.surfaces[1]
    v = v.x[v.facets]
    own = np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1).sum() / 2
    assert area(sides) == pytest.approx(own, rel=1e-12)


def test_same_outline(caplog):
    assert not warnings(caplog, *plates(1.0))
    assert not warnings(caplog, *two_rings())


@ranks_at_last()
def test_cells_made_straight_at_the_outline(caplog):
    """Two boxes of a bent cube, a coarse one and a narrow one: the tied area is off, and told."""
    scene = any_assemblies.Scene(49, 3)
    low, high = (4, 6)
    spaces = [fem.functionspace(scene.mesh(i)[0], ("Lagrange", scene.degree)) for i in (low, high)]
    (sides,) = find_touching(spaces)
    with caplog.at_level(logging.WARNING, "hypergap_dolfinx"):
        tie = Tie(*sides)
    (said,) = comm.bcast([record.getMessage() for record in caplog.records])
    percent = float(said.split("tied area is ")[1].split(" %")[0])
    axis, area = scene.faces()[low, high]
    q = tie.quadrature(2 * scene.degree + 2)
    flux = scene.area(axis, q.x.reshape(-1, 3), q.weights.ravel(), q.normal.reshape(-1, 3))
    off = abs(comm.allreduce(flux)) / area - 1
    assert "too large" in said and abs(100 * off - percent) < 0.2 * percent


@pytest.mark.serial
def test_cells_that_lean(caplog):
    """Straight cells across a bent surface lean: the area counts, not that along the normals."""
    scene = any_assemblies.Scene(298, 3)
    spaces = [fem.functionspace(scene.mesh(i)[0], ("Lagrange", scene.degree)) for i in (4, 5)]
    (sides,) = find_touching(spaces)
    (said,) = [line for line in warnings(caplog, *sides) if "too large" in line]
    percent = float(said.split("tied area is ")[1].split(" %")[0])
    q = Tie(*sides).quadrature(2 * scene.degree + 2)
    exact = 0.27043  # of the map, by 40 000 points
    assert abs(100 * (q.weights.sum() / exact - 1) - percent) < 0.3 * percent
