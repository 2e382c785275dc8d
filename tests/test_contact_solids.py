# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Contact in space: a block on a wider one, a sphere on a block; what lies opposite, far apart."""

from mpi4py import MPI

import numpy as np
import pytest
from assembly import Elastic
from helpers import raises

import basix
import meshes
from dolfinx import default_scalar_type, fem
from dolfinx import mesh as meshing
from hypergap_dolfinx import Contact, ContactProblem, InterfaceError
from hypergap_dolfinx.gap import weighted
from hypergap_dolfinx.gap.chart import axis_between
from hypergap_dolfinx.gap.moving import MovingSurface
from hypergap_dolfinx.gap.opening import Opening
from hypergap_dolfinx.gap.surface import create_surface

comm = MPI.COMM_WORLD
SPANS = (((0, 0, -0.5), (2, 2, 0)), ((0.5, 0.5, 0), (1.5, 1.5, 0.5)))


def boundary(mesh, axis, *places):
    """Facets in planes across an axis."""
    return meshing.locate_entities_boundary(
        mesh, 2, lambda x: np.isclose(x[axis][:, None], places).any(axis=1)
    )


def pressure_error(degree, n, swap, strain, cell=meshing.CellType.tetrahedron):
    """Blocks between walls, of which the lower one is loaded where it is free."""
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
    return max(error, abs(force / p - 1))


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


def sides(heights, h=(0.25, 0.17), degree=1, offset=0.0):
    """A plane from 0 to 1, and a rougher surface over it; heights tell both."""
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


@pytest.mark.parametrize("degree", (1, 2))
@pytest.mark.parametrize("gap", (0.0, 3.0))
def test_opposite_at_any_distance(gap, degree):
    """Surfaces that are curved otherwise and overlap in part: Σ's volume is that between them."""

    def round_one(x, y):
        return gap + 0.3 * (x - 0.4) ** 2 + 0.2 * y**2

    two = sides((lambda x, y: 0 * x, round_one), degree=degree, offset=0.31)
    u = tuple(np.zeros((len(side.dofs), 3)) for side in two)
    opening = Opening.between(comm, two, u)
    np.testing.assert_allclose(opening.axis, (0, 0, 1), atol=1e-12)
    X = weighted.jacobians(opening.table, opening.positions(u))
    dalpha = (opening.alpha[:, 1:] - opening.alpha[:, :1])[:, None, :, None]
    N = (weighted.cofactor(X) @ dalpha)[..., 0] @ opening.axis
    assert N.min() > -1e-12  # no cell is turned over
    assert abs((N @ opening.table.weights).sum() - 0.69**2) <= 1e-12
    g, m, _ = opening.gap(u)
    points, weights = basix.make_quadrature(basix.CellType.quadrilateral, 4)
    exact = 0.69**2 * weights @ round_one(*(0.31 + 0.69 * points).T)
    assert abs(g.sum() - exact) <= (1e-2, 1e-12)[degree - 1] * max(exact, 0.1)
    assert m.min() >= 0


def test_opposite_where_they_slide():
    """Whatever the offset, and however near outlines are to each other: there is a Σ."""
    two = sides((lambda x, y: 0 * x, lambda x, y: 0.1 + 0.2 * (x**2 + y**2)))
    u0 = np.zeros((len(two[0].dofs), 3))
    rng = np.random.default_rng(3)
    before = None
    for size in (0, 1e-12, 1e-9, 1e-8, 1e-7, 1e-5, 1e-3, 0.1, 0.5, 0.9):
        move = size * rng.standard_normal(3) * (1, 1, 0.2)
        move = np.clip(move, -0.9, 0.9)
        u1 = np.tile(move, (len(two[1].dofs), 1))
        before = Opening.between(comm, two, (u0, u1), before)
        area = np.prod(1 - np.abs(move[:2]))
        assert abs(before.gap((u0, u1))[1].sum() / area - 1) <= 0.1


def test_axis():
    """Of the flatter side, exactly; none between a ball and its socket; no facets that face."""
    two = sides((lambda x, y: 0.3 * x, lambda x, y: 1 + (x**2 + y**2)))
    surfaces = two[0].reference, two[1].reference
    normal = np.array((-0.3, 0, 1)) / np.hypot(0.3, 1)
    np.testing.assert_allclose(axis_between(surfaces), normal, atol=1e-12)
    tilted = np.array((0.1, 0, 1)) / np.hypot(0.1, 1)
    assert (axis_between(surfaces, normal) == normal).all()
    assert not (axis_between(surfaces, tilted) == tilted).all()
    with raises(InterfaceError, "no facets face each other"):
        axis_between((surfaces[0], surfaces[0]))
    shells = []
    for i, radii in enumerate(((0.5, 1), (0.0, 0.5))):
        mesh, ft = meshes.spherical_shell(comm, 0.35, *radii, octant=False)
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        facets = ft.find((meshes.INNER, meshes.OUTER)[i])
        shells.append(create_surface(V, facets, f"Γ{i}"))
    assert axis_between((shells[0], shells[1])) is None
