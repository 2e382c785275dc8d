# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact problems: bodies that touch, part, are held by contact alone; the same on any ranks."""

import gc
import logging

from mpi4py import MPI

import numpy as np
import pytest
from assembly import Elastic, lame_constants
from helpers import raises, two_ranks

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import Contact, ContactProblem, InterfaceError, SolveError
from hypergap_dolfinx.algebra import checks

comm = MPI.COMM_WORLD


class Blocks:
    """A block on another one, with a gap between them."""

    def __init__(
        self,
        gap=0.0,
        held=True,
        degree=1,
        n=(4, 5),
        E=1.0,
        swap=False,
        walls=False,
        large=False,
        **options,
    ):
        spans = (((0, -1), (2, 0)), ((0.5, gap), (1.5, 1 + gap)))
        if walls:  # strain is uniform
            spans = spans[0], ((0, gap), (2, 1 + gap))
        self.u, F, self.bcs, self.sides = [], [], [], []
        for i, (low, high) in enumerate(spans):

            def place(x, low=np.array(low), high=np.array(high)):
                return low + x * (high - low)

            mesh, ft = meshes.block(comm, (n[i], 2), place, cell="quadrilateral")
            V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
            loaded, moduli = ft.find(meshes.TOP) if i else (), [np.resize(E, 2)[i]] * 2
            body = Elastic.on(V, moduli, large=large, loaded=loaded)
            if i == 1:
                self.load = body.load
                self.top = fem.Constant(mesh, default_scalar_type(0))
            if i == 0 or held:
                tag = (meshes.BOTTOM, meshes.TOP)[i]
                dofs = fem.locate_dofs_topological(V.sub(1), 1, ft.find(tag))
                value = self.top if i == 1 else fem.Constant(mesh, default_scalar_type(0))
                self.bcs.append(fem.dirichletbc(value, dofs, V.sub(1)))
            held_across = [meshes.LEFT, *[meshes.RIGHT] * walls]
            facets = np.concatenate([ft.find(tag) for tag in held_across])
            dofs = fem.locate_dofs_topological(V.sub(0), 1, facets)
            self.bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(0)))
            self.u.append(body.u)
            F.append(body.F)
            self.sides.append((V, ft.find((meshes.TOP, meshes.BOTTOM)[i])))
        self.contact = Contact(*(self.sides[::-1] if swap else self.sides), **options)
        self.F = F
        self.problem = ContactProblem(F, self.u, bcs=self.bcs, contacts=[self.contact])


def test_prescribed_finer_side():
    """Five prescribed facets that touch one elastic cell: their rows say the same."""
    scene = Blocks(n=(1, 5), walls=True)
    V = scene.u[1].function_space
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 0))
    down = fem.dirichletbc(default_scalar_type((0, -0.01)), dofs, V)
    problem = ContactProblem(scene.F, scene.u, bcs=[*scene.bcs, down], contacts=[scene.contact])
    problem.solve()
    lowest = comm.allreduce(scene.u[0].x.array.real.min(initial=0), MPI.MIN)
    assert problem.iterations <= 2 and problem.halvings == 0
    assert abs(lowest + 0.01) < 1e-12


def test_inverted_cells(monkeypatch):
    """Where a Newton step leads to a stiffness that is no number, the load step is halved."""
    scene, calls = Blocks(), []

    def check(*_):
        calls.append(1)
        if len(calls) == 3:
            raise ValueError("no number")

    monkeypatch.setattr(checks, "check_finite", check)
    scene.top.value = -0.05
    scene.problem.solve()
    assert scene.problem.halvings == 1


def test_given_back():
    """Σ hangs on where bodies came from: where a load step fails, that is forgotten with it."""
    scene = Blocks(swap=True)
    problem, rows, x = scene.problem, scene.contact.rows, scene.u[1].x.array
    x[::2] = 0.05
    problem._prepare()
    rows.update_geometry()
    before, m = problem._state(), rows.m
    x[::2] = 0.2
    rows.update_geometry()
    problem._restore(before)
    rows.update_geometry()
    np.testing.assert_array_equal(rows.m, m)


@two_ranks(sliding=["finite"])
@pytest.mark.parametrize("sliding", ("finite", "small"))
def test_touches_and_parts(sliding):
    """Nothing, then a force, then nothing again."""
    scene = Blocks(gap=0.02, sliding=sliding)
    found = []
    for top in (-0.01, -0.05, -0.1, 0.03):
        scene.top.value = top
        scene.problem.solve()
        found.append((scene.contact.force(scene.problem)[1], int(scene.contact.active.sum())))
    forces, numbers = zip(*found, strict=True)
    assert forces[0] == 0 and numbers[0] == 0
    assert 0 < forces[1] < forces[2] and 2 <= numbers[1] and 2 <= numbers[2]
    assert abs(forces[2] / forces[1] - 8 / 3) < (0.1 if sliding == "finite" else 1e-2)
    assert forces[3] == 0 and numbers[3] == 0
    assert max(np.abs(u.x.array).max(initial=0) for u in scene.u[:1]) <= 1e-12


@pytest.mark.ranks(2, gap=[0.05])
@pytest.mark.parametrize("gap", (-0.05, 0.0, 0.05, 0.5, 1.5))  # 1.5: three cells
@pytest.mark.parametrize("swap", (False, True))
def test_held_by_contact_alone(gap, swap):
    """A block that a load presses on: from apart and from overlapping to the same state."""
    scene = Blocks(gap=gap, held=False, swap=swap)
    scene.load.value = 0.05
    scene.problem.solve()
    force = scene.contact.force(scene.problem) * (-1 if swap else 1)
    assert abs(force[1] - 0.05) <= 1e-7 * 0.05
    reference = Blocks(gap=0.0, held=False, swap=swap)
    reference.load.value = 0.05
    reference.problem.solve()
    p = scene.contact.pressures(scene.problem)
    np.testing.assert_allclose(p, reference.contact.pressures(reference.problem), atol=1e-7)
    assert scene.problem.iterations <= (10 if gap < 1 else 20)


@pytest.mark.ranks(2)
def test_two_problems():
    """A contact in two problems has in each what that one solved, whichever was solved last."""
    scene = Blocks(gap=0.02)
    contact, first, u = scene.contact, scene.problem, [f.copy() for f in scene.u]
    F = [ufl.replace(form, {f: g}) for form, f, g in zip(scene.F, scene.u, u, strict=True)]
    second = ContactProblem(F, u, bcs=scene.bcs, contacts=[contact])

    def found(problem, displacements):
        rows = problem.rows(contact)
        gap = contact.gap(*displacements, on="body").x.array
        return (
            *(contact.force(problem), contact.pressures(problem), gap),
            contact.pressure(problem, on="body").x.array,
            contact.displaced(problem)[1].x,
            np.array((rows.state.active.sum(), (rows.g < 1e-3).sum(), problem.iterations)),
        )

    expected = {}
    for top in (-0.05, 0.05):  # pressed, and apart
        alone = Blocks(gap=0.02)
        alone.top.value = top
        alone.problem.solve()
        contact = alone.contact
        expected[top] = found(alone.problem, alone.u)
    contact = scene.contact
    for problem, at, top in ((first, scene.u, -0.05), (second, u, 0.05)):
        scene.top.value = top
        problem.solve()
        assert contact.active.any() == (top < 0)
    for problem, at, top in ((first, scene.u, -0.05), (second, u, 0.05)) * 2:
        for one, other in zip(found(problem, at)[:-1], expected[top][:-1], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-9)
        assert (found(problem, at)[-1] == expected[top][-1])[:2].all()
        scene.top.value = top
        problem.solve()
        assert contact.active.sum() == expected[top][-1][0] and (top < 0) == contact.active.any()


def test_contact_outlives_its_problem():
    """What a contact tells without a problem is that of the last one, though nobody keeps that."""
    scene = Blocks(gap=0.02)
    contact, num = scene.contact, len(scene.contact.surfaces[1].x)
    scene.top.value = -0.05
    scene.problem.solve()
    pressed = contact.active
    del scene
    gc.collect()
    np.testing.assert_array_equal(contact.active, pressed)
    assert pressed.any() and len(pressed) == num


def largest(f):
    return comm.allreduce(np.abs(f.x.array).max(initial=0), MPI.MAX)


@pytest.mark.ranks(sliding=["finite"], degree=[2])
@pytest.mark.parametrize("sliding", ("finite", "small"))
@pytest.mark.parametrize("degree", (1, 2))
def test_gap_and_pressure(degree, sliding):
    """As functions on Σ and on Γ1's body; of one pressure, where strain is uniform."""
    scene = Blocks(gap=0.02, degree=degree, sliding=sliding, walls=True)
    for on in ("sigma", "body"):
        gap = scene.contact.gap(*scene.u, on=on)
        assert abs(largest(gap) - 0.02) <= 1e-14
    scene.top.value = -0.05
    scene.problem.solve()
    p = scene.contact.pressure(scene.problem)
    exact = 0.03 / (1 / 3 + 1 / 3)
    assert comm.allreduce(len(p.x.array)) > 5
    np.testing.assert_allclose(p.x.array, exact, rtol=1e-10)
    assert abs(largest(scene.contact.pressure(scene.problem, on="body")) / exact - 1) <= 1e-10
    for on in ("sigma", "body"):
        assert largest(scene.contact.gap(*scene.u, on=on)) <= 1e-12
    with raises(ValueError, 'on is "sigma"'):
        scene.contact.pressure(scene.problem, on="Γ1")


@pytest.mark.ranks(2)
@two_ranks(sliding=["finite"])
@pytest.mark.parametrize("sliding", ("finite", "small"))
def test_gives_way(sliding):
    """A layer that is as springs between blocks, of a stiffness that changes and that varies."""
    scene = Blocks(gap=0.02, walls=True)
    c = fem.Function(fem.functionspace(scene.contact.spaces[1].mesh, ("Lagrange", 1)))
    sides = zip(scene.contact.spaces, scene.contact.facets, strict=True)
    contact = Contact(*sides, sliding=sliding, compliance=c)
    problem = ContactProblem(scene.F, scene.u, bcs=scene.bcs, contacts=[contact])
    for top, given in ((-0.05, 0.0), (-0.05, 0.2), (0.0, 0.2), (-0.1, 1e6), (-0.2, 0.1)):
        scene.top.value, c.x.array[:] = top, given
        problem.solve()
        exact = max(-top - 0.02, 0) / (2 / 3 + given)
        np.testing.assert_allclose(contact.pressures(problem), exact, rtol=1e-10)
        assert problem.halvings == 0 and problem.iterations <= 4
        g, m = contact.rows.g, contact.rows.m
        np.testing.assert_allclose(g / m, max(top + 0.02, -given * exact), atol=1e-12)
    stiff = Blocks(walls=True, E=1e9)
    V = fem.functionspace(stiff.contact.spaces[1].mesh, ("Lagrange", 2))
    c = fem.Function(V)
    c.interpolate(lambda x: 1 + x[0] ** 2)
    sides = zip(stiff.contact.spaces, stiff.contact.facets, strict=True)
    contact = Contact(*sides, sliding=sliding, compliance=c)
    problem = ContactProblem(stiff.F, stiff.u, bcs=stiff.bcs, contacts=[contact])
    stiff.top.value = -0.01
    problem.solve()
    x = contact.surfaces[1].x[:, 0]
    np.testing.assert_allclose(contact.rows.state.p, 0.01 / (1 + x**2), rtol=1e-6)


@pytest.mark.parametrize("n", ((40, 5), (5, 40)))
def test_overlaps_of_compliant_surfaces(n, caplog):
    """Overlaps by c p are what a compliance is for, though longer than a facet."""
    scene = Blocks(n=n, compliance=10.0)
    scene.top.value = -0.15
    with caplog.at_level("WARNING", logger="hypergap_dolfinx"):
        scene.problem.solve()
    assert 10 * scene.contact.pressures(scene.problem).max() > 0.1
    assert not [r for r in caplog.records if "facets apart" in r.message or "overlap" in r.message]


def test_nothing_holds():
    """A motion that contact can't hold is told, not solved; so is one that it is pulled from."""
    scene = Blocks(held=False)
    scene.load.value = -0.05
    with raises(
        SolveError, "no solution beyond 0 % of the .*would have to pull at .*: body 1, that"
    ):
        scene.problem.solve()


@pytest.mark.ranks(2)
@two_ranks()
def test_round_off_of_large_strain():
    """Gradients of 1 + ∂u/∂X have the round-off of 1: bodies at rest, and stiff ones on soft."""
    scene = Blocks(gap=0.1, large=True)
    for scene.top.value, most in ((-0.2, 5), (0.0, 5), (0.0, 3), (0.0, 3)):
        scene.problem.solve()
        assert scene.problem.iterations <= most
    assert scene.problem.halvings == 0
    for stiff in ((1, 0), (0, 1)):
        forces = []
        for ratio in (8, 10):
            scene = Blocks(large=True, E=10.0 ** (ratio * np.array(stiff)))
            scene.top.value = -1e-3
            scene.problem.solve()
            forces.append(scene.contact.force(scene.problem)[1])
        assert abs(forces[1] / forces[0] - 1) <= 1e-6


@two_ranks()
def test_small_loads_of_stiff_bodies():
    """A stiff block's round-off adds up to zero: on a soft one the smallest load is balanced."""
    scene = Blocks(n=(5, 4), held=False, large=True, E=(1.0, 1e6))
    for load in (1e-6, 1.01e-6, 0.5e-6):
        scene.load.value = load
        scene.problem.solve()
        assert abs(scene.contact.force(scene.problem)[1]) == pytest.approx(load, rel=1e-6)


@two_ranks()
def test_all_is_prescribed():
    """Also then contact's equations have a unit of stiffness."""
    scene = Blocks(gap=0.1)
    bcs = []
    for u, down in zip(scene.u, (0, -0.05), strict=True):
        V = u.function_space
        dofs = fem.locate_dofs_geometrical(V, lambda x: x[0] < 3)
        bcs.append(fem.dirichletbc(np.array((0, down), dtype=default_scalar_type), dofs, V))
    contact = Contact(*scene.sides)
    problem = ContactProblem(scene.F, scene.u, bcs=bcs, contacts=[contact])
    problem.solve()
    assert not contact.active.any()


@two_ranks()
def test_free_fall():
    """Stresses along both axes have one round-off: a ring that falls takes one Newton step."""
    ring, ft = meshes.ring_sector(comm, 16, 2, 0.3, 1.0, angle=2 * np.pi)
    floor, floor_ft = meshes.block(comm, (8, 1), lambda x: np.array((4, 1)) * (x - (0.5, 4)))
    V, V_floor = (fem.functionspace(mesh, ("Lagrange", 1, (2,))) for mesh in (ring, floor))
    body, place = Elastic.on(V, lame_constants(100.0), large=True), fem.Constant(ring, (0.0, 0.0))
    F = body.F + 4e4 * ufl.inner(body.u - place, ufl.TestFunction(V)) * ufl.dx
    contact = Contact((V_floor, floor_ft.find(meshes.TOP)), (V, ft.find(meshes.OUTER)))
    problem = ContactProblem([None, F], [fem.Function(V_floor), body.u], contacts=[contact])
    for time in range(1, 7):
        place.value = 0, -(time**2) / 50
        problem.solve()
        assert problem.iterations <= 1


@pytest.mark.parametrize("E", (1e-12, 1e11))
def test_units(E):
    found = []
    for modulus in (1.0, E):
        scene = Blocks(E=modulus, held=False, gap=0.02)
        scene.load.value = 0.05 * modulus
        scene.problem.solve()
        found.append(scene.contact.pressures(scene.problem) / modulus)
        found.append(scene.problem.iterations)
    np.testing.assert_allclose(found[0], found[2], rtol=1e-9, atol=1e-12)
    assert found[1] == found[3]


def test_rigid_obstacle():
    """A body without a form, which the user moves."""
    rigid = Blocks(gap=0.0)
    problem = ContactProblem(
        [None, rigid.F[1]], rigid.u, bcs=rigid.bcs[2:], contacts=[rigid.contact]
    )
    rigid.u[0].interpolate(lambda x: np.stack((0 * x[0], 0 * x[0] + 0.02)))
    problem.solve()
    # In a column that is held below by a frictionless plane strain is uniform
    stress = 0.02 * (2 + 1 - 1 / 3)
    np.testing.assert_allclose(rigid.contact.pressures(problem), stress, rtol=0.02)


def test_sides_are_chosen(caplog):
    blocks = Blocks(n=(4, 9)).contact
    a, b = zip(blocks.spaces, blocks.facets, strict=True)
    with caplog.at_level(logging.INFO, "hypergap_dolfinx"):
        assert Contact.between(a, b).swapped  # a has larger facets
        assert not Contact.between(a, b, stiffness=(1e6, 1.0)).swapped
        assert Contact.between(b, a, stiffness=(1.0, 1.0)).swapped is False
    if comm.rank == 0:
        assert "far softer" in caplog.text and "finer than Γ0" in caplog.text


@pytest.mark.ranks(2)
def test_bad_input():
    blocks = Blocks()
    (V0, V1), (f0, f1) = blocks.contact.spaces, blocks.contact.facets
    scalar = fem.functionspace(V0.mesh, ("Lagrange", 1))
    with raises(ValueError, 'sliding is "finite" or "small"'):
        Contact((V0, f0), (V1, f1), sliding="large")
    with raises(InterfaceError, "contact is between displacements"):
        Contact((scalar, f0), (V1, f1))
    with raises(InterfaceError, "share facets"):
        Contact((V0, f0), (V0, f0[1:]))
    with raises(InterfaceError, "the facets of Γ0 must be a flat array"):
        Contact((V0, [[0], [0, 1]]), (V1, f1))
    with raises(ValueError, "not solved yet"):
        blocks.contact.force(blocks.problem)
    with raises(ValueError, "contacts has a str"):
        ContactProblem([], [], contacts=["contact"])
    with raises(ValueError, r"the residual form of body 0 has no u\[0\] in it"):
        ContactProblem(blocks.F, blocks.u[::-1], contacts=[blocks.contact])
    with raises(ValueError, "is on a space of no body"):
        other = Elastic.on(fem.functionspace(V0.mesh, V0.ufl_element()))
        ContactProblem([other.F], [other.u], contacts=[blocks.contact])


@pytest.mark.ranks(2, geometry=[1], delta=[0.004])
@pytest.mark.parametrize(
    ("delta", "geometry", "told"),
    ((0.004, 1, True), (0.1, 1, False), (0.004, 2, False), (-0.004, 1, True), (-0.1, 1, False)),
)
def test_gap_between_chords_is_told(delta, geometry, told, caplog):
    """A ring in another one: chords add to the overlap or clearance, and so to the pressure."""
    u, F, bcs, sides = [], [], [], []
    for n, radii, tag in ((16, (1, 2 + delta / 2), meshes.OUTER), (24, (2, 3), meshes.INNER)):
        mesh, ft = meshes.ring_sector(comm, n, 4, *radii, degree=geometry)
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body = Elastic.on(V)
        u.append(body.u)
        F.append(body.F)
        sides.append((V, ft.find(tag)))
        for edge, component in ((meshes.START, 1), (meshes.END, 0)):
            W = V.sub(component)
            dofs = fem.locate_dofs_topological(W, 1, ft.find(edge))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, W))
    problem = ContactProblem(F, u, bcs=bcs, contacts=[Contact(*sides[::-1])])
    with caplog.at_level(logging.WARNING, "hypergap_dolfinx"):
        problem.solve()
    assert len(caplog.records) == (told and comm.rank == 0)
    if caplog.records:
        assert "about 0.00089 is the gap between chords" in caplog.text
