# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact in the plane: closed surfaces, cut ends, sides swapped, units; exact or known results."""

from mpi4py import MPI

import numpy as np
import pytest
from assembly import Elastic, lame_constants
from helpers import sweep

import meshes
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import Contact, ContactProblem, contact_problem

comm = MPI.COMM_WORLD


def held(V, component, where, value=0.0):
    """A condition on one component: at tagged facets, or where a function of places says so."""
    W = V.sub(component)
    if callable(where):
        zero = fem.Function(W.collapse()[0])
        return fem.dirichletbc(
            zero, fem.locate_dofs_geometrical((W, zero.function_space), where), W
        )
    dofs = fem.locate_dofs_topological(W, 1, where)
    return fem.dirichletbc(default_scalar_type(value), dofs, W)


def solve(F, u, bcs, sides, swap, **options):
    contact = Contact(*(sides[::-1] if swap else sides), **options)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    problem.solve()
    return contact, problem


@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("angle", (np.pi / 2, 2 * np.pi))
def test_shrink_fit(angle, swap):
    """Rings that overlap, linear at small strain: the exact pressure."""
    inner, fit, outer, over = 0.5, 1.0, 2.0, 1e-4
    u, F, bcs, sides = [], [], [], []
    around = round(2 * angle / np.pi)
    for i, (r0, r1) in enumerate(((inner, fit + over), (fit, outer))):
        n = (24, 32)[i] * around
        mesh, ft = meshes.ring_sector(comm, n, 4, r0, r1, angle=angle, degree=2)
        V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
        body = Elastic.on(V)
        u.append(body.u)
        F.append(body.F)
        for c in (0, 1):
            bcs.append(held(V, c, lambda x, c=c: np.isclose(x[c], 0, atol=1e-8)))
        sides.append((V, ft.find((meshes.OUTER, meshes.INNER)[i])))
    contact, problem = solve(F, u, bcs, sides, swap)
    assert contact.geometry.depth <= 0.2501  # half a wall of the thinner ring
    E, nu, a, b = 1 / 0.91, 0.3 / 0.7, inner, outer
    stiff = (b**2 + fit**2) / (b**2 - fit**2) + nu, (fit**2 + a**2) / (fit**2 - a**2) - nu
    p = contact.pressures(problem) / (over * E / (fit * sum(stiff))) - 1
    # Parabolas are off circles by 1e-7, of an overlap of 1e-4, and pressures by 4 %: arcs aren't
    assert np.abs(p).max() <= 1e-3 and abs(p.mean()) <= 5e-4 and problem.iterations <= 2


@pytest.mark.parametrize("swap", (False, True))
def test_ball_in_socket(swap):
    """Closed and nearly conforming; all around is as near, the load says where it falls."""
    u, F, bcs, sides = [], [], [], []
    load, gap = 0.02, 0.02
    for i, (r0, r1, n) in enumerate(((0.3, 1 - gap, 48), (1.0, 1.5, 36))):
        mesh, ft = meshes.ring_sector(comm, n, 5 - 2 * i, r0, r1, angle=2 * np.pi)
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body = Elastic.on(V, large=True)
        u.append(body.u)
        F.append(body.F)
        if i == 0:
            body.weight.value = load
            area = n * r1**2 / 2 * np.sin(2 * np.pi / n)  # of the polygon
            area -= n * r0**2 / 2 * np.sin(2 * np.pi / n)
            bcs.append(held(V, 0, lambda x: np.isclose(x[0], 0)))
        else:
            bcs += [held(V, c, ft.find(meshes.OUTER)) for c in (0, 1)]
        sides.append((V, ft.find((meshes.OUTER, meshes.INNER)[i])))
    contact, problem = solve(F, u, bcs, sides, swap)
    assert abs(abs(contact.force(problem)[1]) / (load * area) - 1) <= 1e-7
    assert problem.iterations <= 9 and problem.halvings == 0
    assert abs(contact.pressures(problem).max() / 0.0339 - 1) <= 0.12


@pytest.mark.parametrize(
    ("below", "above", "degree"),
    (((16, 4), (10, 5), 1), ((16, 4), (9, 5), 1), ((16, 4), (9, 5), 2)),
)
def test_block_that_bulges(below, above, degree):
    """Its corners pass vertices of the wider one, Γ1, which have a row from there on.

    While that needed 1 % of a vertex to be covered there was no equilibrium: with the row less is
    covered than without it.
    """
    u, F, bcs, sides = [], [], [], []
    for i, n in enumerate((below, above)):
        low, size = np.array((i, 1.1 * i - 1)), np.array((4 - 2 * i, 1))
        place = lambda x, low=low, size=size: low + x * size  # noqa: E731
        mesh, ft = meshes.block(comm, n, place, cell="quadrilateral")
        V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
        body = Elastic.on(V, (1.0, 1.0), large=True)
        u.append(body.u)
        F.append(body.F)
        sides.append((V, ft.find((meshes.TOP, meshes.BOTTOM)[i])))
        away = ft.find((meshes.BOTTOM, meshes.TOP)[i])
        bcs += [held(V, c, away) for c in (0, 1)]
    problem = ContactProblem(F, u, bcs=bcs, contacts=[Contact.between(*sides)])
    for down in (0.05, 0.2, 0.4):
        bcs[3].g.value[()] = -down
        problem.solve()
    # 22 to 266 Newton steps for loads that differ by 1 %: corners pass vertices with each other
    assert problem.iterations <= 55 and problem.halvings <= 1


def end_between_vertices(cut, stiffness, swap, across=0.0, **options):
    """Press a block, 1 wide, on a wider one by .01, its ends somewhere between vertices."""
    u, F, bcs, sides = [], [], [], []
    for i, (low, size, n) in enumerate((((0, -1), (4, 1), (16, 2)), ((1.5, 0), (1, 1), (8, 2)))):
        low, size = np.add(low, (i * cut / 4, 0)), np.array(size)
        place = lambda x, low=low, size=size: low + x * size  # noqa: E731
        mesh, ft = meshes.block(comm, n, place, cell="quadrilateral")
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body = Elastic.on(V, lame_constants(stiffness))
        u.append(body.u)
        F.append(body.F)
        sides.append((V, ft.find((meshes.TOP, meshes.BOTTOM)[i])))
        away = ft.find((meshes.BOTTOM, meshes.TOP)[i])
        bcs += [held(V, 0, away, across * i), held(V, 1, away, -0.01 * i)]
    contact, problem = solve(F, u, bcs, sides, swap, **options)
    return contact.force(problem)


@pytest.mark.parametrize("cut", (0.05, 0.5))
def test_layer_that_ends_between_vertices(cut):
    """Stiff blocks on springs: each of them has its force once."""
    force = end_between_vertices(cut, 1e6, True, compliance=1.0)
    assert abs(abs(force[1]) / 0.01 - 1) <= 1e-5


@pytest.mark.parametrize("cut, swap", ((0.05, True), (0.5, True), (0.5, False)))
def test_limit_of_shear_that_ends_between_vertices(cut, swap):
    """Shear at its limit has the area of contact."""
    options = {"friction": 1.0, "shear_limit": 1e-4, "sliding": "small"}
    force = end_between_vertices(cut, 1.0, swap, across=0.02, **options)
    assert abs(abs(force[0]) / 1e-4 - 1) <= 1e-9


def press_punch(cut, wide):
    """A flat punch of width 1 on a block of which the nodes are anywhere."""
    h = 0.1
    x = np.linspace(-2, 2, 41) + (1 - cut) * h
    u, F, bcs, sides = [], [], [], []
    for i, (low, high, n, E) in enumerate(
        (((x[0], -2), (x[-1], 0), (40, 20), 1.0), ((-0.5, 0), (0.5, 0.5), (8, 4), 1e3))
    ):

        def place(x, low=np.array(low), high=np.array(high)):
            return low + x * (high - low)

        mesh, ft = meshes.block(comm, n, place, cell="quadrilateral")
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body = Elastic.on(V, lame_constants(E))
        u.append(body.u)
        F.append(body.F)
        away = ft.find((meshes.BOTTOM, meshes.TOP)[i])
        bcs += [held(V, 0, away), held(V, 1, away, -1e-3 * i)]
        sides.append((V, ft.find((meshes.TOP, meshes.BOTTOM)[i])))
    contact, problem = solve(F, u, bcs, sides, wide)
    return contact, problem, abs(contact.force(problem)[1])


@pytest.mark.parametrize("cut", sweep((0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.94, 0.96, 0.99), 4))
@pytest.mark.parametrize("wide", (False, True))
def test_flat_punch(cut, wide):
    """Its corner falls anywhere on an edge of the wider block.

    The pressure of a rigid punch of width 1 is p = F / (π √(s (1 − s))): over the last δ before
    its corner 2/(π √δ) F in the mean, which is much where a vertex has little of it.
    """
    contact, problem, mean = press_punch(cut, wide)
    rows = problem.rows(contact)
    x, p = contact.surfaces[1].x[:, 0], contact.pressures(problem) / mean
    sizes = rows.state.opening._at(rows.u).sizes
    on = rows.state.active
    bound = 2 * 2 / np.pi / np.sqrt(sizes[on])  # twice that
    assert (rows.state.p[on] <= bound * mean).all() and problem.iterations <= 5
    inside = np.abs(x) < 0.25
    if wide and 0.2 < cut < 0.8:
        np.testing.assert_allclose(p[inside], 2 / np.pi / np.sqrt(1 - 4 * x[inside] ** 2), 0.023)


def test_force_of_flat_punch():
    """It hardly changes as corners pass from node to node: a die that is drawn along ripples."""
    matching, between = (press_punch(cut, True)[2] for cut in (0.0, 0.5))
    assert abs(between / matching - 1) <= 0.012


def test_pressure_far_away(caplog, monkeypatch):
    """A facet that touches a step's edge while the rest of it is far above the ground is told."""
    monkeypatch.setattr(contact_problem, "FAR_PRESSURE", 0.5)

    def stepped(x):
        return np.column_stack((2 * x[:, 0], x[:, 1] * np.where(x[:, 0] < 0.26, 1, 0.2) - 1))

    u, F, bcs, sides = [], [], [], []
    places = stepped, lambda x: np.array([0.35, 0.01]) + x * np.array([0.4, 0.5])
    for i, (n, place) in enumerate(zip(((20, 4), (1, 1)), places, strict=True)):
        mesh, ft = meshes.block(comm, n, place, cell="quadrilateral")
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body = Elastic.on(V)
        u.append(body.u)
        F.append(body.F)
        away = ft.find((meshes.BOTTOM, meshes.TOP)[i])
        bcs += [held(V, 0, away), held(V, 1, away, -0.25 * i)]
        sides.append((V, ft.find((meshes.TOP, meshes.BOTTOM)[i])))
    with caplog.at_level("WARNING", logger="hypergap_dolfinx"):
        contact, _ = solve(F, u, bcs, sides, False)
    told = [record.message for record in caplog.records if "facets apart" in record.message]
    assert contact.active.any() and (told or comm.rank > 0)


def wedge_on_block(cells, slope=0.5, bent=0.0):
    """Bodies and their sides: a block, its top bent, and a wedge, in space a prism, .003 above."""
    dim = len(cells[0])

    def block(x):
        x = 2 * x - 1
        x[:, 1] += -1 - bent * np.abs(x[:, 0]) * (x[:, 1] + 1) / 2
        return x

    def wedge(x):
        x[:, 0], x[:, 2:] = x[:, 0] - 0.5, 2 * x[:, 2:] - 1
        x[:, 1] += (1 - x[:, 1]) * slope * np.abs(x[:, 0])
        x[:, 1] += 0.003
        return x

    bodies = []
    for i, place in enumerate((block, wedge)):
        cell = {2: "quadrilateral", 3: ("hexahedron", "tetrahedron")[i]}[dim]
        mesh, ft = meshes.block(comm, cells[i], place, cell=cell)
        V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
        bodies.append((V, ft, (V, ft.find((meshes.TOP, meshes.BOTTOM)[i]))))
    return bodies


@pytest.mark.ranks(2, slope=[0.5])
@pytest.mark.parametrize("dim", (2, 3))
@pytest.mark.parametrize(
    "slope, bent, stiffness, wedge, why",
    (
        (0.5, 0.0, None, True, "the cornered one"),
        (0.05, 0.0, None, False, "the coarser one"),  # hardly a corner
        (-0.5, 0.0, None, False, "the coarser one"),  # a groove
        (0.5, 0.4, None, True, "the finer one"),  # both have one
        (0.5, 0.0, (1, 100), False, "the far softer one"),
    ),
)
def test_side_with_corners(dim, slope, bent, stiffness, wedge, why, caplog):
    """A side with a corner is Γ1, though it is the finer side; of two with corners the finer."""
    cells = ((4, 2, 2)[:dim], (8, 3, 3)[:dim])
    slope, bent = (dim - 1) * slope, (dim - 1) * bent  # in space edges count from 60° on
    block, cornered = (body[2] for body in wedge_on_block(cells, slope, bent))
    with caplog.at_level("INFO", logger="hypergap_dolfinx"):
        contact = Contact.between(block, cornered, stiffness=stiffness)
        assert Contact.between(cornered, block, stiffness=stiffness and stiffness[::-1])
    assert contact.spaces[1] is (cornered if wedge else block)[0]
    assert caplog.text.count(why) == 2 * (comm.rank == 0)
    assert "finer than Γ0" not in caplog.text


@pytest.mark.ranks(2, dim=[2])
@pytest.mark.parametrize("dim", (2, 3))
def test_corner_slides(dim, caplog):
    """Without friction nothing holds a wedge back: with its corner on Γ0 facets of Γ1 do, told."""
    bodies = wedge_on_block(((8, 3, 2)[:dim], (4, 3, 2)[:dim]))
    u, F, bcs, moves = [], [], [], []
    for i, (V, ft, _) in enumerate(bodies):
        body = Elastic.on(V)
        u.append(body.u)
        F.append(body.F)
        moves.append(fem.Function(V))
        away = fem.locate_dofs_topological(V, dim - 1, ft.find((meshes.BOTTOM, meshes.TOP)[i]))
        bcs.append(fem.dirichletbc(moves[i], away))
    told, largest = [], []
    for choose in (Contact.between, lambda block, wedge: Contact(wedge, block)):
        caplog.clear()
        contact = choose(*(body[2] for body in bodies))
        for w in u:
            w.x.array[:] = 0
        problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
        ratios = []
        for at in (0.02, 0.08, 0.14):
            way = np.zeros(dim)
            way[:2] = at, -0.063
            moves[1].x.array[:] = np.tile(way, len(moves[1].x.array) // dim)
            problem.solve()
            force = contact.force(problem, on=u[1])
            ratios.append(abs(force[0]) / force[1])
        told.append("forces lean by" in caplog.text)
        largest.append(max(ratios))
    assert largest[0] <= 0.03 and largest[1] >= 0.2
    assert told == [False, comm.rank == 0]


def lowered(places, cells, down, shrink=0.0, every=False, swap=False, **elastic):
    """A block lowered onto another one, both mapped; its top shrinks around x = 0."""
    u, F, bcs, sides = [], [], [], []
    for i, (n, place) in enumerate(zip(cells, places, strict=True)):
        mesh, ft = meshes.block(comm, n, place, cell="quadrilateral")
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body, value = Elastic.on(V, **elastic), fem.Function(V)
        u.append(body.u)
        F.append(body.F)
        value.interpolate(lambda x, i=i: i * np.stack((-shrink * x[0], -down + 0 * x[0])))
        away = ft.find((meshes.BOTTOM, meshes.TOP)[i])
        bcs.append(fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, away)))
        free = ft.indices[ft.values != (meshes.BOTTOM, meshes.TOP)[i]]
        sides.append((V, free if every else ft.find((meshes.TOP, meshes.BOTTOM)[i])))
    return solve(F, u, bcs, sides, swap)


@pytest.mark.ranks(2, depth=[0.15])
@pytest.mark.parametrize("depth", (0.1, 0.15))
def test_walls_beside_a_punch(depth, caplog):
    """Forces are those of facets that face each other, until gaps up to walls count: told."""
    places = lambda x: x * [1.5, 0.5] - [0.75, 0.5], lambda x: x * [1, 0.5] - [0.5, 0]
    forces, options = [], {"swap": True, "constants": (1.0, 1.0), "large": True}
    for every in (False, True):
        caplog.clear()
        with caplog.at_level("WARNING", logger="hypergap_dolfinx"):
            contact, problem = lowered(places, ((8, 4), (12, 4)), depth, every=every, **options)
        forces.append(contact.force(problem)[1])
        told = [record.message for record in caplog.records if "facets apart" in record.message]
        assert len(told) == (every and depth > 0.1 and comm.rank == 0)
    assert abs(forces[1] / forces[0] - 1) <= (1e-9 if depth == 0.1 else 0.05)


@pytest.mark.ranks(2)
def test_walls_beside_coarse_facets(caplog):
    """Gaps up to a punch's walls that are shorter than a facet: a tenth of the force, told."""
    places = lambda x: x * [1.5, 0.5] - [0.75, 0.5], lambda x: x * [1, 0.5] - [0.5, 0]
    for every in (False, True):
        caplog.clear()
        with caplog.at_level("WARNING", logger="hypergap_dolfinx"):
            lowered(
                places, ((4, 2), (6, 2)), 0.1, every=every, swap=True, constants=(1, 1), large=True
            )
        told = [record.message for record in caplog.records if "tilt towards" in record.message]
        assert len(told) == (every and comm.rank == 0)


@pytest.mark.ranks(2)
@pytest.mark.parametrize(("num", "down", "overlap"), ((16, 0.81, 1.4), (64, 0.16, 1.1)))
def test_overlap_of_a_corner(num, down, overlap, caplog):
    """A ridge inside a facet, whose vertices have positive mean gaps: told without a pressure.

    With a finer ridge from a smaller overlap on: there is nothing where forces should be.
    """
    places = (
        lambda x: np.column_stack((4 * x[:, 0] - 2, x[:, 1] * (5 - 2 * abs(4 * x[:, 0] - 2)) - 5)),
        lambda x: np.column_stack((3 * x[:, 0] - 1.5, x[:, 1] + 0.01)),
    )
    with caplog.at_level("WARNING", logger="hypergap_dolfinx"):
        contact, problem = lowered(places, ((num, 4), (3, 1)), down)
    assert not contact.active.any() and (problem.rows(contact).g > 0).all()
    told = [record.message for record in caplog.records if "overlap" in record.message]
    assert len(told) == (comm.rank == 0)
    assert all(f"surfaces overlap by {overlap} facets" in message for message in told), told


@pytest.mark.ranks(2)
def test_cells_turned_over(caplog):
    """A block whose top is turned over: its forces balance, as they are linear."""
    places = (lambda x: x - [0.5, 1]), lambda x: x - [0.5, 0]
    for shrink in (0.5, 1.5):
        caplog.clear()
        with caplog.at_level("WARNING", logger="hypergap_dolfinx"):
            lowered(places, ((3, 3), (2, 2)), 0.01, shrink)
        told = [record.message for record in caplog.records if "cells over" in record.message]
        assert len(told) == (shrink > 1 and comm.rank == 0)
        assert all("body 1: the displacements turn cells over" in message for message in told)


def test_slender_body():
    """A beam forty times as long as thick, bent far by a stiff round one: one or two nodes touch.

    Without predicted stress in the beam's geometric stiffness it takes eight Newton steps.
    """
    u, F, bcs, sides, rise = [], [], [], [], 0.75

    def place(i, s):
        if i == 0:
            return np.column_stack((2 * s[:, 0], 0.05 * (s[:, 1] - 1) + s[:, 0]))
        x = np.column_stack((1.5 + 0.4 * (s[:, 0] - 0.5), rise + 0.02 + 0.3 * s[:, 1]))
        x[:, 1] += (1 - s[:, 1]) * (s[:, 0] - 0.5) ** 2 / 5
        return x

    for i, n in enumerate(((60, 2), (20, 6))):
        mesh, ft = meshes.block(comm, n, lambda s, i=i: place(i, s), cell="quadrilateral")
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body = Elastic.on(V, lame_constants((1.0, 100.0)[i]), large=True)
        u.append(body.u)
        F.append(body.F)
        away = ft.find((meshes.LEFT, meshes.TOP)[i])
        bcs += [held(V, 0, away), held(V, 1, away, -0.2 * i)]
        sides.append((V, ft.find((meshes.TOP, meshes.BOTTOM)[i])))
    contact, problem = solve(F, u, bcs, sides, swap=True)
    assert problem.iterations <= 5 and problem.halvings == 0 and contact.active.any()


def test_stiff_and_fine_on_soft_and_coarse(caplog):
    """A round bottom 1e6 times as stiff, three times as fine: told, and `between` avoids it."""
    u, F, bcs, sides, stiff = [], [], [], [], (1.0, 1e6)

    def place(i, s):
        x = np.column_stack((2 * s[:, 0] - 1, s[:, 1] - 1 + i))
        if i == 1:
            x[:, 1] += (1 - s[:, 1]) * x[:, 0] ** 2 / 4
        return x

    for i, n in enumerate(((40, 20), (120, 30))):
        mesh, ft = meshes.block(comm, n, lambda s, i=i: place(i, s), cell="quadrilateral")
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body = Elastic.on(V, lame_constants(stiff[i]))
        u.append(body.u)
        F.append(body.F)
        away = ft.find((meshes.BOTTOM, meshes.TOP)[i])
        bcs += [held(V, 0, away), held(V, 1, away, -0.02 * i)]
        sides.append((V, ft.find((meshes.TOP, meshes.BOTTOM)[i])))
    contact = Contact.between(*sides, stiffness=stiff)
    assert contact.swapped and not caplog.records
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    problem.solve()
    half_width = np.abs(contact.surfaces[1].x[contact.active, 0]).max()
    p0 = half_width / 2 / (2 * 0.91)  # Hertz, R = 2
    assert problem.iterations <= 12 and 0.8 <= contact.pressures(problem).max() / p0 <= 1.4
    ContactProblem(F, u, bcs=bcs, contacts=[Contact(*sides)])
    assert comm.rank > 0 or "times finer than Γ0" in caplog.text


def test_beam_of_two_layers():
    """Layers slide on each other as they bend: the sides hardly matter."""
    largest = []
    for swap in (False, True):
        u, F, bcs, sides = [], [], [], []
        for i, n in enumerate(((20, 2), (30, 3))):
            mesh, ft = meshes.block(
                comm, n, lambda x, i=i: x * (10, 1) + (0, i - 1), cell="quadrilateral"
            )
            V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
            body = Elastic.on(V, large=True, loaded=ft.find(meshes.TOP) if i else ())
            u.append(body.u)
            F.append(body.F)
            bcs.append(held(V, 0, ft.find(meshes.LEFT)))
            sides.append((V, ft.find((meshes.TOP, meshes.BOTTOM)[i])))
        body.load.value = 1e-4
        corner = held(sides[0][0], 1, lambda x: np.isclose(x[0], 10) & np.isclose(x[1], -1))
        _, problem = solve(F, u, [*bcs, corner], sides, swap)
        assert problem.iterations <= 9
        largest.append(max(np.hypot(*w.x.array.reshape(-1, 2).T).max() for w in u))
    assert largest[0] > 1 and abs(largest[0] / largest[1] - 1) <= 1e-4


@pytest.mark.parametrize(
    ("size", "E", "angle", "move"),
    ((1e-9, 2e11, 0.7, (3, -5)), (1e9, 1e-12, 0.3, (1, 2)), (1.0, 1.0, 2.5, (100, -50))),
)
def test_same_in_any_units(size, E, angle, move):
    """Scaled, turned and moved, after finite sliding."""

    def displacements(size, E, angle, move):
        turn = np.array(((np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))))
        u, F, bcs, sides = [], [], [], []
        for i, (low, high, n) in enumerate(
            (((0, -1), (2, 0), (8, 3)), ((0.5, 0.02), (1.5, 1.02), (5, 4)))
        ):

            def place(x, low=np.array(low), high=np.array(high)):
                return size * ((low + x * (high - low)) @ turn.T + move)

            mesh, ft = meshes.block(comm, n, place, cell="quadrilateral")
            V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
            body = Elastic.on(V, lame_constants(E), large=True)
            u.append(body.u)
            F.append(body.F)
            dofs = fem.locate_dofs_topological(V, 1, ft.find((meshes.BOTTOM, meshes.TOP)[i]))
            goal = size * turn @ np.array((0.13, -0.1)) * i
            bcs.append(fem.dirichletbc(default_scalar_type(goal), dofs, V))
            sides.append((V, ft.find((meshes.TOP, meshes.BOTTOM)[i])))
        _, problem = solve(F, u, bcs, sides, False)
        found = [(w.x.array.reshape(-1, 2) @ turn).ravel() / size for w in u]
        return np.concatenate(found), problem.iterations

    reference, steps = displacements(1.0, 1.0, 0.0, (0, 0))
    found, now = displacements(size, E, angle, move)
    assert np.abs(found - reference).max() <= 1e-9 * np.abs(reference).max() and now == steps
