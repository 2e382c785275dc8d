# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Friction: slip and its derivatives, what sticks and what slips, exact solutions."""

import runpy
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
import test_contact_form as plane
import test_contact_solids as space
from assembly import Elastic, lame_constants, rectangle
from helpers import close, raises, sweep, two_ranks

import meshes
import ufl
from dolfinx import default_scalar_type, fem, la
from hypergap_dolfinx import Contact, ContactProblem, SolveError
from hypergap_dolfinx.contact_geometry import blending
from hypergap_dolfinx.contact_geometry import space as columns
from hypergap_dolfinx.contact_geometry.plane import PlaneSegments
from hypergap_dolfinx.contact_geometry.space import SpaceSegments
from hypergap_dolfinx.contact_solver import complementarity, contact_system, linearised, tangent
from hypergap_dolfinx.contact_solver.continuation import Continuation
from hypergap_dolfinx.contact_solver.friction_rows import FrictionRows

comm = MPI.COMM_WORLD
STEP = 1e-5  # of differences of the fourth order


def slip_of(opening, sides, u, rng, positions):
    """T and S against differences; what translations, rotations and positions are for T.

    Returns:
        What rotations are, ``(num_rotations, num_rows)``.
    """
    since = tuple(part + 0.1 * rng.standard_normal(part.shape) for part in u)
    direction = [rng.standard_normal(part.shape) for part in u]
    flat = np.concatenate([part.ravel() for part in direction])
    n = u[0].shape[1]
    num = (n - 1) * opening.num_multipliers
    q = rng.random((n - 1, opening.num_multipliers))
    own = np.arange(opening.num_multipliers)
    T, S, some = (
        plane.dense(part, (num, len(flat)))
        for part in (
            opening.slip(u, own),
            *(opening.slip_slopes(u, since, own, on) for on in (own >= 0, own % 2 == 0)),
        )
    )
    asked = np.tile(own % 2 == 0, n - 1)
    close(some[asked], S[asked], 1e-14)

    def at(t):
        moved = tuple(a + t * d for a, d in zip(u, direction, strict=True))
        T = plane.dense(opening.slip(moved, own), (num, len(flat)))
        way = np.concatenate([(a - b).ravel() for a, b in zip(moved, since, strict=True)])
        return np.concatenate((T @ way, q.ravel() @ T))

    difference = (8 * (at(STEP) - at(-STEP)) - at(2 * STEP) + at(-2 * STEP)) / (12 * STEP)
    close(difference[:num], S @ flat, plane.DIFFERENCE)
    H = plane.dense(opening.slip_curvature(u, q, own), (len(flat), len(flat)))
    close(difference[num:], H @ flat, plane.DIFFERENCE)
    x = np.concatenate([positions(side, part) for side, part in zip(sides, u, strict=True)])
    for motion in (x.ravel(), np.tile(np.arange(1.0, n + 1), len(x))):
        assert np.abs(T @ motion).max() <= 1e-13 * (np.abs(T) @ np.abs(motion)).max()
    pairs = [(i, j) for i in range(n) for j in range(i)]
    turns = [np.eye(n)[[i]].T * np.eye(n)[j] for i, j in pairs]
    return np.array([T @ (x @ (turn - turn.T)).ravel() for turn in turns])


@pytest.mark.parametrize(
    "options", (*plane.SCENES[1:3], *plane.REVOLVED, *plane.RARE[::2], plane.ARCS)
)
def test_slip(options):
    """A rotation's slip is the vertex' own gap: moments of friction balance where it is closed."""
    sides, u, rng = plane.scene(**options)
    opening = PlaneSegments.between(sides, u)
    turned = slip_of(opening, sides, u, rng, plane._positions)
    close(turned[0], -opening._at(u)._g, 1e-12)


def test_slip_in_space(monkeypatch):
    """Vertices have two directions, which are taken as they are."""
    sides, u, rng = space.rough()
    opening = SpaceSegments.between(sides, u)
    fixed = columns.directions(opening._at(u).rays.frames)
    monkeypatch.setattr(columns, "directions", lambda *_: fixed)
    slip_of(opening, sides, u, rng, space._positions)
    close(np.einsum("aki,ali->akl", fixed, fixed), np.tile(np.eye(2), (len(fixed), 1, 1)))


def on_an_end(part, sliver):
    """A block that is turned and slid; an end of Γ0 covers so much of some vertices."""
    u, F, bcs, sides = [], [], [], []
    for i in (0, 1):

        def place(x, i=i):
            x = x / [1, 1, 2] + [0, 0, (i - 1) / 2]
            return x if i else x * [1.25 + part, 1.6, 1] - [0.5, 0.3, 0]

        mesh, ft = meshes.block(comm, (3 - i, 3 - i, 2), place, cell="hexahedron")
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        body, goal = Elastic.on(V, (1.0, 1.0)), fem.Function(V)
        if i:
            goal.interpolate(
                lambda x: [0.02 - 0.15 * (x[1] - 0.5), 0.01 + 0.15 * (x[0] - 0.5), 0 * x[0] - 0.05]
            )
        bcs.append(fem.dirichletbc(goal, fem.locate_dofs_topological(V, 2, ft.find(5 + i))))
        u.append(body.u)
        F.append(body.F)
        sides.append((V, ft.find(6 - i)))
    contact = Contact(*sides, friction=0.3, sliding="small")
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact], rtol=1e-11)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blending, "SLIVER", sliver)
        problem.solve()
    return contact, problem.rows(contact)


def test_end_of_the_other_side():
    """As less and less of a vertex is covered, forces become those without its row.

    Its neighbours slip in different directions, and its row takes pressure from them.
    """
    part = 1e-5
    forces, without = (on_an_end(part, least)[1].contact_forces()[1] for least in (1e-14, 0.5))
    assert np.abs(forces - without).max() <= 2 * part * np.abs(without).max()


def test_shared_rows():
    """Vertices that only share the gap of one in contact have friction: they stick or slip, too."""
    contact, rows = on_an_end(0.1, blending.SLIVER)
    rubs = np.linalg.norm(rows.shears, axis=1) > 0
    assert (rubs & ~contact.active).any()
    assert ((contact.sticking ^ contact.slipping) == rubs).all()


@pytest.mark.ranks(2)
@pytest.mark.parametrize("num, told", [(2, True), (12, False)])
def test_moments_of_shared_rows(num, told, caplog):
    """A punch within coarse facets drags at them across gaps: its moments differ, which is told."""
    u, F, bcs, sides = [], [], [], []
    places = lambda x: x * [0.33, 1] - [0, 1], lambda x: x * [1, 0.5] - [0.5, 0]
    for i, place in enumerate(places):
        mesh, ft = meshes.block(comm, (num if i else max(num // 3, 1), 2), place)
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body, goal = Elastic.on(V, (1.0, 1.0), large=True), fem.Function(V)
        goal.x.array.reshape(-1, 2)[:] = -0.3 * i, -0.17 * i
        away = ft.find((meshes.BOTTOM, meshes.TOP)[i])
        bcs.append(fem.dirichletbc(goal, fem.locate_dofs_topological(V, 1, away)))
        u.append(body.u)
        F.append(body.F)
        sides.append((V, ft.find((meshes.TOP, meshes.BOTTOM)[i])))
    contact = Contact(*sides, friction=0.9)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    with caplog.at_level("WARNING", logger="hypergap_dolfinx"):
        problem.solve()
    moments = sum(contact.moment(problem, (0, 0), on=body) for body in u)
    lever = np.abs(moments).max() / np.linalg.norm(contact.force(problem)) * num
    assert (lever > 0.02) == told
    found = [r for r in caplog.records if "friction acts across gaps" in r.message]
    assert len(found) == (told and comm.rank == 0)


@pytest.mark.ranks(2)
def test_moment_at_positions_of_the_mesh():
    """With small strains reactions balance it there, wherever the forces have moved to."""
    u, F, bcs, sides = [], [], [], []
    for i in (0, 1):
        mesh, ft = meshes.block(comm, (3 + i, 2), lambda x, i=i: x - [0.5, 1 - i])
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body, goal = Elastic.on(V), fem.Function(V)
        if i:
            goal.interpolate(lambda x: np.array((-0.02 * x[1] - 0.3, 0.02 * x[0] - 0.05)))
        away = fem.locate_dofs_topological(V, 1, ft.find((meshes.BOTTOM, meshes.TOP)[i]))
        bcs.append(fem.dirichletbc(goal, away))
        u.append(body.u)
        F.append(body.F)
        sides.append((V, ft.find((meshes.TOP, meshes.BOTTOM)[i])))
    contact = Contact(*sides, friction=0.3)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact], rtol=1e-12)
    problem.solve()
    for body, form in zip(u, F, strict=True):
        left = fem.assemble_vector(fem.form(form))
        left.scatter_reverse(la.InsertMode.add)
        V = body.function_space
        num = V.dofmap.index_map.size_local
        x, f = V.tabulate_dof_coordinates()[:num, :2], left.array[: 2 * num].reshape(-1, 2)
        held = np.isclose(np.abs(x[:, 1]), 1)
        x, f = x[held], f[held]
        reaction = comm.allreduce(float((x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0]).sum()))
        still = contact.moment(problem, (0, 0), on=body, displaced=False)
        now = contact.moment(problem, (0, 0), on=body)
        assert abs(reaction + still[0]) < 1e-11 * abs(reaction) < 1e-9 * abs(now - still)[0]
    with raises(ValueError, "displaced is None: give True or False."):  # Tie.moment's default
        contact.moment(problem, (0, 0), displaced=None)


def rotating(dim, swap=False, rigid=False, solver=None, **options):
    """A block on another one, far ends of which a rigid motion takes along, or all of the lower."""
    u, F, bcs, sides, goals = [], [], [], [], []
    low, high = 2 * dim - 1, 2 * dim
    for i in (0, 1):

        def place(x, i=i):
            x = x.copy()
            x[:, -1] += i - 1
            x[:, :-1] = 0.2 * i + (1 - 0.4 * i) * x[:, :-1]
            return x

        cell = "quadrilateral" if dim == 2 else "hexahedron"
        mesh, ft = meshes.block(comm, (*[2 + i] * (dim - 1), 2), place, cell=cell)
        V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
        body = Elastic.on(V, (1.0, 1.0), large=True)
        fixed = rigid and i == 0
        goals.append(body.u if fixed else fem.Function(V))
        dofs = fem.locate_dofs_topological(V, dim - 1, ft.find(high if i else low))
        bcs += [] if fixed else [fem.dirichletbc(goals[i], dofs)]
        u.append(body.u)
        F.append(None if fixed else body.F)
        sides.append((V, ft.find((high, low)[i])))
    contact = Contact(*sides[:: -1 if swap else 1], **options)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact], rtol=1e-11, petsc_options=solver)

    def go(angle, *shift):
        turn = np.eye(dim)
        turn[0, [0, -1]] = np.cos(angle), -np.sin(angle)
        turn[-1, [0, -1]] = np.sin(angle), np.cos(angle)
        for i, goal in enumerate(goals):
            goal.interpolate(
                lambda x, i=i: turn @ (x[:dim] + i * np.reshape(shift, (-1, 1))) - x[:dim]
            )
        problem.solve()

    return contact, problem, go


@pytest.mark.ranks(2, dim=[2])
@pytest.mark.parametrize("dim", [2, 3])
def test_rotation(dim):
    """What is pressed and sheared turns by 4.5° eight times, then far: no slip, no change.

    Some of it has slipped before. The law of friction holds, forces and work balance.
    """
    contact, problem, go = rotating(dim, friction=0.1)
    shift = (0.04, 0.02)[: dim - 1]
    go(0, *(0 * np.array(shift)), -0.1)
    go(0, *shift, -0.1)
    rows = contact.rows
    assert contact.sticking.any() and contact.slipping.any() and contact.dissipation(problem) > 1e-6
    p, q = rows.state.p.copy(), np.linalg.norm(rows.state.q, axis=0)
    np.testing.assert_array_less(q, 0.1 * p * (1 + 1e-12) + 1e-300)
    close(q[contact.slipping], 0.1 * p[contact.slipping], 1e-12)
    work = (rows.state.q * rows.s).sum()
    assert work == pytest.approx(-contact.dissipation(problem), rel=1e-9)
    far = 8 * np.pi / 40 + np.pi / (2, 4)[dim - 2]  # farther than facets are long
    for angle in (*np.arange(1, 9) * np.pi / 40, far):
        go(angle, *shift, -0.1)
        assert problem.iterations <= 1 and problem.halvings == 0  # none if it is in equilibrium
        assert np.abs(contact.slips(problem)).max() <= 1e-13  # what the equilibrium before left
        close(rows.state.p, p, 1e-10)
        close(np.linalg.norm(rows.state.q, axis=0), q, 1e-10)
    below, above = (part.sum(axis=0) for part in rows.contact_forces())
    assert np.abs(below + above).max() <= 1e-14


@pytest.mark.parametrize("swap", [False, True])
def test_rotation_with_an_obstacle(swap):
    """A quarter turn in one load step, of an obstacle and of what is pressed on it."""
    contact, problem, go = rotating(2, swap, rigid=True, friction=0.1)
    go(0, 0, -0.1)
    p = contact.rows.state.p.copy()
    go(np.pi / 2, 0, -0.1)
    assert problem.iterations <= 1 and np.abs(contact.slips(problem)).max() <= 1e-12
    close(contact.rows.state.p, p, 1e-9)


@two_ranks()
def test_obstacle_in_the_first_load_step():
    """What users move slips in the first load step too, as a body of which all is prescribed."""
    found = []
    for rigid in (False, True):
        parts = rectangle((8, 3), (-1, -1), (1, 0)), rectangle((3, 2), (-0.5, 0.02), (0.5, 0.5))
        bodies = [Elastic.on(part.V, large=True) for part in parts]
        sides = [(part.V, part.facets(t)) for part, t in zip(parts, (meshes.TOP, meshes.BOTTOM))]
        moved = bodies[1].u if rigid else fem.Function(parts[1].V)
        every = fem.locate_dofs_geometrical(parts[1].V, lambda x: x[1] > 0)
        below = fem.locate_dofs_geometrical(parts[0].V, lambda x: x[1] < -0.9)
        bcs = [fem.dirichletbc(fem.Function(parts[0].V), below)]
        bcs += [] if rigid else [fem.dirichletbc(moved, every)]
        contact = Contact(*sides, friction=0.3)
        F, u = [bodies[0].F, None if rigid else bodies[1].F], [body.u for body in bodies]
        problem = ContactProblem(F, u, bcs=bcs, contacts=[contact], rtol=1e-10)
        moved.interpolate(lambda x: np.outer((0.1, -0.1), np.ones(x.shape[1])))
        problem.solve()
        found.append([*contact.force(problem, on=u[0]), contact.dissipation(problem)])
    assert found[0][0] > 0.1 * -found[0][1]  # the force was -3e-3 for 4e-2
    np.testing.assert_allclose(*found, rtol=1e-6)


@pytest.mark.parametrize("first", (False, True))
def test_rotation_with_small_sliding(first, caplog):
    """Normals don't turn with the bodies, or with Γ0's alone: that is told."""
    _, problem, go = rotating(2, rigid=first, friction=0.1, sliding="small")
    go(0, 0, -0.1)
    if first:
        problem.every_u[0].interpolate(lambda x: 0.1 * np.stack((-x[1], x[0])))
        problem.solve()
    else:
        go(0.1, 0, -0.1)
    told = ["its surfaces have turned by" in line for line in caplog.messages]
    assert told[-1] and sum(told) == 1


def test_squeezed_by_plates():
    """A ring that friction alone holds, without a load on it where a load step starts.

    The share of the diagonal that may hold it then isn't that load's round-off.
    """
    ring, tags = meshes.ring_sector(comm, 32, 2, 0.8, 1.0, angle=2 * np.pi)
    body = Elastic.on(fem.functionspace(ring, ("Lagrange", 1, (2,))), large=True)
    plates = [rectangle((20, 1), (-2, y), (2, y + 0.2)) for y in (1.0, -1.2)]
    u = [fem.Function(plate.V) for plate in plates]
    outer = (body.u.function_space, tags.find(meshes.OUTER))
    contacts = [
        Contact((plate.V, plate.facets(tag)), outer, friction=0.2)
        for plate, tag in zip(plates, (meshes.BOTTOM, meshes.TOP), strict=True)
    ]
    problem = ContactProblem([None, None, body.F], [*u, body.u], contacts=contacts)
    for k in (1, 2):
        for one, sign in zip(u, (-1, 1), strict=True):
            one.interpolate(lambda x, way=sign * 0.1 * k: (0 * x[0], way + 0 * x[0]))
        problem.solve()
        assert problem._nearness() == contact_system.AT_REST  # 1e-19 for the load
    below, above = (one.force(problem, on=body.u) for one in contacts)
    assert np.abs(below + above).max() <= 1e-9 * np.abs(below).max()


@two_ranks()
def test_held_by_jaws(monkeypatch):
    """A cube between two jaws that users move: on each all vertices slip outwards but the middle.

    That one doesn't hold the turn around the normal; what slips does, across its slip.
    """
    parts = []
    for n, low, high in ((2, 0, 0.5), (3, 0.5, 0.8), (3, -0.3, 0)):

        def place(x, n=n, low=low, high=high):
            return (x - (0.5, 0.5, 0)) * (n / 2, n / 2, high - low) + (0, 0, low)

        mesh, tags = meshes.block(comm, (n, n, 2), place, cell="hexahedron")
        parts.append((fem.functionspace(mesh, ("Lagrange", 1, (3,))), tags))
    (V, tags), *others = parts
    body, jaws = Elastic.on(V, large=True), [fem.Function(W) for W, _ in others]
    contacts = [
        Contact((W, of_jaw.find(jaw)), (V, tags.find(face)), friction=0.2)
        for (W, of_jaw), jaw, face in zip(
            others, (meshes.BACK, meshes.FRONT), (meshes.FRONT, meshes.BACK), strict=True
        )
    ]
    problem = ContactProblem([None, None, body.F], [*jaws, body.u], contacts=contacts)
    for x, num in ((0.0, 1), (0.03, 0)):
        for one, sign in zip(jaws, (1, -1), strict=True):
            one.interpolate(lambda y, s=sign: np.outer((s * x, 0, -s * 0.02), np.ones(y.shape[1])))
        problem.solve()
        assert problem.iterations <= 8 and problem.halvings == 0  # no equilibrium, before
        assert [int(one.rows.stuck.sum()) for one in contacts] == [num, num]
        monkeypatch.setattr(FrictionRows, "stick", None)  # nothing needs to stick to hold it now
    below, above = (one.force(problem, on=body.u) for one in contacts)
    assert np.abs(below + above).max() <= 1e-7 * np.abs(below).max()


@two_ranks()
def test_rests_on_a_slope():
    """A soft cube under its weight on a slope that is half as steep as it slides on."""
    parts, turn = [], np.eye(3)
    turn[0, [0, 2]], turn[2, [0, 2]] = (np.cos(0.1), np.sin(0.1)), (-np.sin(0.1), np.cos(0.1))
    for n, low, high in ((2, 0, 1), (3, -0.3, 0)):

        def place(x, n=n, low=low, high=high):
            return ((x - (0.5, 0.5, 0)) * (n - 1, n - 1, high - low) + (0, 0, low)) @ turn

        mesh, tags = meshes.block(comm, (n, n, n), place, cell="hexahedron")
        parts.append((fem.functionspace(mesh, ("Lagrange", 1, (3,))), tags))
    (V, tags), (W, below) = parts
    body = Elastic.on(V, (1.0, 1.0), large=True)
    contact = Contact((W, below.find(meshes.FRONT)), (V, tags.find(meshes.BACK)), friction=0.2)
    problem = ContactProblem([None, body.F], [fem.Function(W), body.u], contacts=[contact])
    body.weight.value = 0.1
    problem.solve()
    assert problem.iterations <= 8 and problem.halvings == 0  # no equilibrium, before
    assert np.abs(contact.force(problem) - (0, 0, 0.1)).max() <= 1e-8


@two_ranks()
@pytest.mark.parametrize("pivot", (complementarity.PIVOT, 0.0))
def test_pushed_at_its_top(pivot, monkeypatch):
    """A block whose weight and friction alone hold it, pushed with nine tenths of what moves it.

    One vertex more or less makes the small problem singular. Where that isn't seen, the block goes
    by 1e9 to where no contact holds it, which is no equilibrium.
    """
    monkeypatch.setattr(complementarity, "PIVOT", pivot)
    wide, high, weight, friction = 0.4, 0.92, 0.005, 0.2
    (W, below), (V, tags) = (
        (fem.functionspace(mesh, ("Lagrange", 1, (2,))), tags)
        for mesh, tags in (
            meshes.block(comm, (2, 1), lambda x: (x[:, :2] - (0.5, 1)) * (4, 0.3)),
            meshes.block(
                comm, (6, 5), lambda x: (x[:, :2] - (0.5, 0)) * (wide, high), cell="triangle"
            ),
        )
    )
    body, push = Elastic.on(V, (1.0, 1.0)), fem.Constant(V.mesh, 0.0)
    at_top = ufl.gt(ufl.SpatialCoordinate(V.mesh)[1], 0.999 * high)
    F = body.F - ufl.conditional(at_top, push, 0) * ufl.TestFunction(V)[0] * ufl.ds
    sides = (W, below.find(meshes.TOP)), (V, tags.find(meshes.BOTTOM))
    contact = Contact(*sides, friction=friction)
    problem = ContactProblem([None, F], [fem.Function(W), body.u], contacts=[contact])
    body.weight.value = weight / (wide * high)
    for share in (0.45, 0.9):
        push.value = share * friction * weight / wide
        try:
            problem.solve()
        except SolveError:
            assert not pivot
        else:
            force = -share * friction * weight, weight
            assert np.abs(contact.force(problem) - force).max() <= 1e-9 * weight


def test_back_and_forth():
    """What is drawn along slips, then sticks when it turns back, then slips the other way."""
    contact, problem, go = rotating(2, friction=0.2)
    found = []
    for x in (0, 0.1, 0.15, 0.149, 0.1, 0, -0.05):
        go(0, x, -0.05)
        rows = contact.rows
        ratio = (rows.state.q * rows.m).sum() / (rows.state.p * rows.m).sum()
        found.append((ratio, contact.slipping.sum() / contact.active.sum()))
        assert problem.iterations <= 9 and problem.halvings == 0
    ratios, slips = zip(*found, strict=True)
    np.testing.assert_allclose(np.abs(ratios)[[0, 1, 2, 6]], (0, 0.2, 0.2, 0.2), atol=1e-12)
    assert ratios[2] * ratios[6] < 0 and slips[2] == slips[6] == 1
    assert 0.15 < ratios[3] / ratios[2] < 1 and slips[3] == 0


@pytest.mark.ranks(2, sliding=["finite"])
@pytest.mark.parametrize("sliding", ("small", "finite"))
def test_floor_turns_back(sliding):
    """A floor that is drawn one way and then the other: all slips, and pressures stay."""
    block, floor = rectangle((4, 3), (1, 0), (2, 1)), rectangle((2, 1), (0, -1), (3, 0))
    body, u = Elastic.on(block.V), fem.Function(floor.V)
    top = fem.Function(block.V)
    top.x.array[1::2] = -0.01
    bcs = [fem.dirichletbc(top, fem.locate_dofs_topological(block.V, 1, block.facets(meshes.TOP)))]
    sides = (floor.V, floor.facets(meshes.TOP)), (block.V, block.facets(meshes.BOTTOM))
    contact = Contact(*sides, friction=0.01, sliding=sliding)
    problem = ContactProblem([None, body.F], [u, body.u], bcs=bcs, contacts=[contact])
    problem.solve()
    for x in (0.2, -0.2, 0.0):
        way = np.sign(x - u.x.array[0])
        u.x.array[::2] = x
        problem.solve()
        force = contact.force(problem)
        close(force[0], 0.01 * way * force[1], 1e-9)
        close(contact.dissipation(problem), 0.01 * force[1] * (0.4 if x < 0 else 0.2), 0.05)


@pytest.mark.parametrize("sliding", ("small", "finite"))
def test_coefficient_falls(sliding):
    """What sticks all over slips where the coefficient of friction becomes smaller."""
    block, floor = rectangle((4, 3), (1, 0), (2, 1)), rectangle((2, 1), (0, -1), (3, 0))
    body, u, top = Elastic.on(block.V), fem.Function(floor.V), fem.Function(block.V)
    bcs = [fem.dirichletbc(top, fem.locate_dofs_topological(block.V, 1, block.facets(meshes.TOP)))]
    sides = (floor.V, floor.facets(meshes.TOP)), (block.V, block.facets(meshes.BOTTOM))
    mu = fem.Constant(block.mesh, 50.0)
    contact = Contact(*sides, friction=mu, sliding=sliding)
    problem = ContactProblem([None, body.F], [u, body.u], bcs=bcs, contacts=[contact])
    top.x.array[1::2] = -0.05
    problem.solve()
    top.x.array[::2] = 0.03
    problem.solve()
    assert contact.sticking.all()
    mu.value = 0.05
    problem.solve()
    force = contact.force(problem)
    close(force[0], -0.05 * force[1], 1e-9)


@pytest.mark.ranks(2, mu=[0.02])
@pytest.mark.parametrize("mu", (0.02, 0.001))
def test_symmetry(mu):
    """Half of a block on a rigid floor: at the plane of symmetry nothing slips, beside it all."""
    block, lid = rectangle((3, 3), (0, -1), (2, 0)), rectangle((1, 1), (-1, 0), (3, 1))
    body, u = Elastic.on(block.V), fem.Function(lid.V)
    u.x.array[1::2] = -0.02
    fixed = fem.locate_dofs_topological(block.V, 1, block.facets(meshes.BOTTOM))
    V = block.V.sub(0)
    left = fem.locate_dofs_topological(V, 1, block.facets(meshes.LEFT))
    bcs = [fem.dirichletbc(fem.Function(block.V), fixed), fem.dirichletbc(0.0, left, V)]
    sides = (lid.V, lid.facets(meshes.BOTTOM)), (block.V, block.facets(meshes.TOP))
    contact = Contact(*sides, friction=mu, sliding="small")
    problem = ContactProblem([None, body.F], [u, body.u], bcs=bcs, contacts=[contact])
    problem.solve()
    force = contact.force(problem)
    close(force[0], mu * force[1], 1e-9)
    assert contact.slipping.all() and problem.iterations <= 2


def test_lent_directions():
    """Vertices in space that share a traction have one direction of it, and all show it."""
    contact, problem, go = rotating(3, friction=0.1)
    rows = contact.rows
    x = contact.surfaces[1].x
    lost = np.flatnonzero(x[:, 0] < x[:, 0].min() + 1e-9)
    others = np.setdiff1d(np.arange(len(x)), lost)
    for v in lost:
        rows.condensed_to[v] = others[np.linalg.norm(x[others] - x[v], axis=1).argmin()]
    go(0, 0, 0, -0.05)
    go(0, 0.1, 0.05, -0.05)
    assert contact.slipping[rows.condensed_to[lost]].all()
    close(np.linalg.norm(rows.tangents[:, contact.active], axis=2), 1, 0.01)
    shears, p = contact.shears(problem), contact.pressures(problem)
    on = rows.spread(contact.slipping)
    close(np.linalg.norm(shears[on], axis=1), 0.1 * p[on], 0.01)
    assert on[lost].all()
    pytest.importorskip("pyvista")
    from hypergap_dolfinx import plot

    drawn = plot.contact(contact, problem)
    assert drawn.actors["shear"].mapper.dataset.n_points > 0
    drawn.close()


def test_steps_backwards():
    """Where an equilibrium ends at a kink Newton's steps go to and fro; back from it they don't."""

    def force(x):
        return (x - 0.05, 1.0) if x < 0 else (-0.05 - 0.5 * x, -0.5) if x < 1 else (x - 1.55, 1.0)

    for tells in (False, True):
        x, continuation, found = -0.1, Continuation(MPI.COMM_SELF, 1e-9), []
        for _ in range(30):
            F, slope = force(x)
            dx = F / slope
            x -= dx * continuation.share([np.array([dx])], slope * dx**2 if tells else 1.0)
            found.append(x)
        assert (abs(found[-1] - 1.55) <= 1e-12) == tells
    assert sum(np.abs(np.array(found) - 1.55) > 1e-12) <= 4


def searched(continuation, x, step, force):
    """Place after a step, and after its line search."""
    at = x + step
    while (factor := continuation.factor(lambda: [force(at)])) != 1:
        step = factor * step
        at = x + step
    return at


@pytest.mark.parametrize("is_stiffened", (True, False))
def test_steps_lengthened(is_stiffened):
    """From an unstable equilibrium, steps with added stiffness are lengthened."""
    x, num, continuation = np.array([1e-4]), 0, Continuation(MPI.COMM_SELF, 1e-12)
    continuation.share([np.ones(1)], 1.0)  # the load step's own one, the longest
    while abs(force := x**3 - x) > 1e-12:
        slope, num = 3 * x**2 - 1, num + 1
        added = 4.0 if slope < 0 else 0.0
        step = -force / (slope + added)
        assert continuation.share([step], 1.0, lambda F=force: [F], is_stiffened and added > 0) == 1
        x = searched(continuation, x, step, lambda at: at**3 - at)
    assert abs(x - 1) <= 1e-10
    assert num <= 8 if is_stiffened else num > 20


def test_lengthened_too_far():
    """A search ends where a lengthened step has led to no number."""
    continuation, share = Continuation(MPI.COMM_SELF, 1e-12), 1.0
    continuation.share([np.array([100.0])], 1.0)
    continuation.share([np.ones(1)], 1.0, lambda: [-np.ones(1)], True)
    for factor in (continuation.factor(lambda: [-0.8 * np.ones(1)]), continuation.shorten()):
        share *= factor
    assert 0 < share < 2
    assert continuation.factor(lambda: [-0.9 * np.ones(1)]) == 1


def test_steps_in_cycles(monkeypatch):
    """Around kinks steps can go in cycles; a line search after the first ones ends them."""
    n = np.array([[-0.6, 0.6], [-0.3, -0.7], [0.8, 0.5]])
    m = np.array([[-0.7, 1.1], [-1.4, -0.4], [1.4, -0.2]])
    limits, k = np.array([-0.41, -0.01, -0.4]), np.array([8.5, 16.9, 16.1])
    K = np.array([[1.0, -2.8], [2.8, 1.0]])

    def force(x):
        return K @ x + (k * np.maximum(n @ x - limits, 0)) @ m

    def after(num):
        x, continuation = np.array([2.0, 1.0]), Continuation(MPI.COMM_SELF, 1e-12)
        for _ in range(num):
            F = force(x)
            step = -np.linalg.solve(K + (m.T * (k * (n @ x > limits))) @ n, F)
            step *= continuation.share([step], 1.0, lambda F=F: [F])
            x = searched(continuation, x, step, force)
        return np.linalg.norm(force(x))

    assert after(8) <= 1e-12
    monkeypatch.setattr(Continuation, "factor", lambda self, forces: 1.0)
    assert after(60) > 0.1


def test_steps_that_converge_go_on(monkeypatch):
    """A load step whose residual still falls isn't given up after STEPS Newton steps."""
    found = []
    for most in (contact_system.STEPS, 3):
        monkeypatch.setattr(contact_system, "STEPS", most)
        _, problem, go = rotating(2, friction=0.1)
        go(0, 0.1, -0.1)
        found.append((problem.iterations, problem.halvings))
    assert found[0] == found[1] and found[0][0] > 3


def test_sliding_is_told_soon(monkeypatch):
    """Where no forces balance a load, no small problem and no further step searches for any."""
    counts, solution = [], complementarity.solution
    monkeypatch.setattr(complementarity, "solution", lambda *M: counts.append(0) or solution(*M))
    demo = runpy.run_path(str(Path(__file__).parents[2] / "demos" / "friction.py"))
    assert demo["block"](comm, 1, 2)["told"]
    assert len(counts) < 300


def test_slides_off():
    """What has nothing opposite any more slips by nothing, and is no error of NumPy's."""
    contact, problem, go = rotating(2, friction=0.1)
    go(0, 3.0, 0.5)
    assert not contact.active.any() and contact.slips(problem).max() == 0


@pytest.mark.parametrize("limit", [np.inf, 0.01])
def test_elastic_slip(limit):
    """Friction grows with slip up to μ p or a limit, and goes back when it is released."""
    mu, length = 0.2, 0.01
    contact, problem, go = rotating(2, friction=mu, elastic_slip=length, shear_limit=limit)
    rows, total = contact.rows, 0.0
    for x in (0, 0.02, 0.06, 0.12, 0.11):
        before = rows._elastic.copy()
        go(0, x, -0.05)
        assert problem.iterations <= 7 and problem.halvings == 0
        e = before + rows.slip
        e *= np.minimum(1, length / np.maximum(np.abs(e), 1e-300))
        bound = np.minimum(mu * rows.state.p, limit)
        close(rows.state.q * contact.active, -bound * e / length, 1e-6)
        total += contact.dissipation(problem)
        assert (total > 1e-9) == (x > (0.06 if limit == np.inf else 0.02))
    assert contact.sticking.any()


@pytest.mark.parametrize("dim", [2, 3])
def test_shear_limit(dim):
    """Friction is μ p up to a limit, and the limit from there on, however it is pressed."""
    mu, limit = 0.5, 0.03
    contact, problem, go = rotating(dim, friction=mu, shear_limit=limit)
    rows = contact.rows
    for x, y in ((0, -0.05), (0.1, -0.05), (0.2, -0.1)):
        go(0, *(x, 0.1)[: dim - 1], y)
        assert problem.iterations <= 12 and problem.halvings == 0
        slips, q = contact.slipping, np.linalg.norm(rows.state.q, axis=0)
        close(q[slips], np.minimum(mu * rows.state.p, limit)[slips], 1e-7)
        assert (q <= limit * (1 + 1e-9)).all()
    assert (mu * rows.state.p[slips] > 1.1 * limit).sum() >= 2 and contact.dissipation(problem) > 0


@pytest.mark.parametrize("dim", [2, 3])
def test_gives_way(dim):
    """Where surfaces overlap by c p they rub as others do, and forces balance."""
    contact, problem, go = rotating(dim, friction=0.1, compliance=0.5)
    rows = contact.rows
    go(0, *(0.04, 0.02)[: dim - 1], -0.1)
    assert problem.iterations <= 12 and problem.halvings == 0
    on, p, q = contact.active, rows.state.p, np.linalg.norm(rows.state.q, axis=0)
    close(rows.g[on], -0.5 * (rows.m * p)[on], 1e-10)
    close(q[contact.slipping], 0.1 * p[contact.slipping], 1e-9)
    assert on.any() and contact.slipping.any() and (q <= 0.1 * p * (1 + 1e-9)).all()
    below, above = (part.sum(axis=0) for part in rows.contact_forces())
    assert np.abs(below + above).max() <= 1e-14


@pytest.mark.ranks(2)
def test_input():
    """Each thing that is wrong with friction is told in one line, on every rank."""
    bodies = [rectangle((2, 2), (0, i - 1), (1, i)) for i in (0, 1)]
    sides = [(body.V, body.facets(tag)) for body, tag in zip(bodies, (meshes.TOP, meshes.BOTTOM))]
    scalars = [fem.functionspace(body.mesh, ("Lagrange", 2)) for body in bodies]
    constant = fem.functionspace(bodies[1].mesh, ("Discontinuous Lagrange", 0))
    for value, why in (
        (-0.1, "coefficient of friction is -0.1 on Γ1; it is a number from 0 on"),
        (np.nan, "is nan on Γ1"),
        ("0.3", "a number, a fem.Constant or a fem.Function on Γ1's mesh, not str"),
        ((0.1, 0.2), "not tuple"),
        (fem.Constant(bodies[1].mesh, (0.1, 0.2)), r"a scalar, not of shape \(2,\)"),
        (fem.Function(scalars[0]), "on another mesh than Γ1's"),
        (fem.Function(bodies[1].V), r"a scalar, not of shape \(2,\)"),
        (fem.Function(constant), "not a continuous Lagrange space"),
    ):
        with raises(ValueError, why):
            Contact(*sides, friction=value)
    for options, why in (
        ({"elastic_slip": 0.1}, "give friction too"),
        ({"elastic_slip": -0.1, "friction": 0.3}, "a length from 0 on, not -0.1"),
        ({"elastic_slip": None, "friction": 0.3}, "a length from 0 on, not None"),
        ({"shear_limit": 0.1}, "shear_limit is for contact with friction"),
        ({"shear_limit": 0, "friction": 0.3}, "a traction above 0, not 0"),
        ({"compliance": -1e-3}, "the compliance is -0.001 on Γ1; it is a number from 0 on"),
        ({"compliance": (0.1, 0)}, "compliance is a number, a fem.Constant or a fem.Function"),
    ):
        with raises(ValueError, why):
            Contact(*sides, **options)
    mu = fem.Function(scalars[1])
    mu.interpolate(lambda x: 0.3 * x[0])
    contact = Contact(*sides, friction=mu)
    close(contact.friction.at_vertices(), 0.3 * contact.surfaces[1].x[:, 0])
    mu.interpolate(lambda x: x[0] - 1e-16)  # round-off where it is 0
    assert (contact.friction.at_vertices() >= 0).all()
    mu.x.array[:] = -1.0
    with raises(ValueError, "is -1 on Γ1"):
        contact.friction.at_vertices()
    number = Contact(*sides, friction=np.array(0.3), elastic_slip=np.array(0.1)).friction
    assert (number.at_vertices() == 0.3).all() and number.elastic_slip == 0.1
    plain = Contact(*sides)
    with raises(ValueError, "is in no problem"):
        _ = plain.sticking
    body = [Elastic.on(body.V, large=True) for body in bodies]
    problem = ContactProblem([b.F for b in body], [b.u for b in body], contacts=[plain])
    with raises(ValueError, "the contact has no friction"):
        _ = plain.sticking
    problem.destroy()


@pytest.mark.parametrize("dim", [2, 3])
def test_guessed_sets(monkeypatch, dim):
    """Working sets that are guessed anew, however few change, lead to the same equilibrium."""
    found, counts = [], []
    count = linearised.LinearisedContact._solve

    def counted(*args):
        solution = count(*args)
        counts[-1] += solution.is_guess
        return solution

    monkeypatch.setattr(linearised.LinearisedContact, "_solve", counted)
    for least in (tangent.GUESSED, 0):
        monkeypatch.setattr(tangent, "GUESSED", least)
        counts.append(0)
        contact, _, go = rotating(dim, friction=0.1)
        go(0, *(0.04, 0.02)[: dim - 1], -0.1)
        found.append(contact.rows.state.p)
    assert counts[0] == 0 < counts[1] and contact.slipping.any()
    close(found[1], found[0], 1e-9)


@pytest.mark.ranks(2)
def test_other_direct_solver(monkeypatch):
    """States that are wrong at first are found without MUMPS as with it."""
    found, sizes, responses = [], [], tangent.Tangent.responses

    def counted(self, loads, of):
        sizes.append(len(of))
        return responses(self, loads, of)

    monkeypatch.setattr(tangent.Tangent, "responses", counted)
    other = {
        "pc_type": "lu",
        "pc_factor_mat_solver_type": "superlu_dist",
        # Debian's, with DOLFINx 0.9, fails at saddle points with its own order, and says so
        "mat_superlu_dist_colperm": "NATURAL",
    }
    for solver in (None, other):
        contact, problem, go = rotating(2, friction=0.1, solver=solver)
        go(0, 0.04, -0.1)
        found.append(contact.rows.state.p)
        problem.destroy()
    half = len(sizes) // 2
    assert sizes[:half] == sizes[half:] and half > 0 and contact.slipping.any()
    close(found[1], found[0], 1e-9)


def test_falling_compliances(monkeypatch):
    """A small problem where Newton's method finds no descent is solved along a path."""
    paths, newton = [], linearised.LinearisedContact._newton

    def tried(*args):
        paths.append(newton(*args))
        return paths[-1]

    monkeypatch.setattr(linearised.LinearisedContact, "_newton", tried)
    _, problem, go = rotating(2, friction=0.1)
    go(0, 0, -0.1)
    paths.clear()
    go(0, 0.04, -0.1)
    assert paths[0] is None and paths[-1] is not None
    assert problem.iterations <= 4


@pytest.mark.parametrize(
    ("mu", "swap"), sweep([(0.3, False), (0.3, True), (1.0, True), (1.0, False)], 4)
)
def test_ironing_in_space(mu, swap):
    """A stiff die is drawn there and back, friction falls, it is lifted: few steps, no halving."""
    demo = runpy.run_path(str(Path(__file__).parents[2] / "demos" / "ironing.py"))
    demo["Ironing"].__init__.__globals__["RTOL"] = 1e-8
    friction, size = fem.Constant(meshes.block(comm, (1, 1))[0], mu), demo["H"]
    scene = demo["Ironing"](comm, dim=3, friction=friction, swap=swap, coarse=True)
    counts = []

    def go(along, down):
        scene.goal.value[0], scene.goal.value[-1] = along * size, -down * size
        scene.solve()
        counts.append(scene.problem.iterations)
        assert scene.problem.halvings == 0

    for down in (0.25, 0.5, 0.75, 1):
        go(0, down)
    for along in (0.5, 1, 1.5, 1):
        go(along, 1)
    friction.value = mu / 3
    go(1, 1)
    for down in (0.5, 0, -0.1):
        go(1, down)
    assert max(counts) <= (8 if mu < 1 else 10), str(counts)
    assert not scene.contact.active.any()


def test_touching_without_force():
    """Blocks turned by 240° that meet in the end: slips are free where forces are round-off."""
    u, F, bcs, sides, moves, gap = [], [], [], [], [], 0.1
    for i, n in enumerate(((5, 3), (4, 3))):
        low, size = np.array((0.3 * i, i * (1 + gap) - 1)), np.array((2 - 0.6 * i, 1))
        body = rectangle(n, low, low + size)
        elastic = Elastic.on(body.V, (10.0, 10.0), large=True)
        u.append(elastic.u)
        F.append(elastic.F)
        away = body.facets((meshes.BOTTOM, meshes.TOP)[i])
        moves.append(fem.Function(body.V))
        dofs = fem.locate_dofs_topological(body.V, 1, away)
        bcs.append(fem.dirichletbc(moves[i], dofs))
        sides.append((body.V, body.facets((meshes.TOP, meshes.BOTTOM)[i])))
    contact = Contact.between(*sides, friction=0.2)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    for k in range(1, 5):
        angle = np.pi * k / 3
        turn = np.array(((np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))))
        for i, move in enumerate(moves):
            down = np.array([[0], [i * gap * k / 4]])
            move.interpolate(lambda x, down=down, turn=turn: turn @ (x[:2] - down) - x[:2])
        problem.solve()
        assert problem.halvings == 0 and problem.iterations <= 20
    assert np.linalg.norm(contact.force(problem)) <= 1e-11


@pytest.mark.ranks(2)
def test_slides_without_force():
    """What has slipped and has no pressure isn't guessed to stick when it touches again."""
    bodies = []
    for n, low, high in (((12, 6), (-1, -1), (1, 0)), ((10, 5), (-0.6, 0), (0.6, 0.6))):
        body = rectangle(n, low, high)
        bodies.append((body, Elastic.on(body.V, lame_constants(1.0), large=True)))
    across = fem.Constant(bodies[1][0].V.mesh, default_scalar_type((0, 0)))
    none, bcs = np.zeros(2, dtype=default_scalar_type), []
    for (body, _), tag, value in zip(bodies, (meshes.BOTTOM, meshes.TOP), (none, across)):
        dofs = fem.locate_dofs_topological(body.V, 1, body.facets(tag))
        bcs.append(fem.dirichletbc(value, dofs, body.V))
    tags = meshes.BOTTOM, meshes.TOP
    sides = [(body.V, body.facets(tag)) for (body, _), tag in zip(bodies[::-1], tags)]
    contact, u = Contact(*sides, friction=0.8), [elastic.u for _, elastic in bodies]
    problem = ContactProblem([one.F for _, one in bodies], u, bcs=bcs, contacts=[contact])
    across.value[0] = 0.1
    problem.solve()
    assert problem.halvings == 0 and problem.iterations <= 5  # 3; 15 if it sticks
    assert np.abs(u[1].x.array.reshape(-1, 2) - (0.1, 0)).max(initial=0) <= 1e-12
    assert np.abs(u[0].x.array).max(initial=0) <= 1e-12
