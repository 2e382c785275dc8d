# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What contact can't do anything with gets one line that says what and how, on every rank."""

import logging
import re
from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from assembly import rectangle
from helpers import raises, two_ranks
from test_contact_bodies import Assembly

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import CellType, create_box, locate_entities_boundary
from hypergap_dolfinx import (
    Contact,
    ContactProblem,
    InterfaceError,
    SolveError,
    Tie,
    contact_problem,
)
from hypergap_dolfinx.algebra.floating import in_words

comm = MPI.COMM_WORLD


def two(gap=0.0, across=0.0, n=(4, 3), **options):
    """A block on a wider one; the lower one is held, the upper one moved."""
    low = (-0.5 + across, gap)
    scene = Assembly(
        [
            rectangle((n[0], 2), (-1, -1), (1, 0), **options),
            rectangle((n[1], 2), low, (low[0] + 1, gap + 1), **options),
        ]
    )
    for component in (0, 1):
        scene.hold(0, component, meshes.BOTTOM)
    scene.across, scene.down = (scene.hold(1, component, meshes.TOP) for component in (0, 1))
    return scene


def free_to_rise():
    """The blocks, the upper one held sideways alone; and a load on it."""
    free = Assembly(two().bodies)
    for component in (0, 1):
        free.hold(0, component, meshes.BOTTOM)
    free.hold(1, 0, meshes.RIGHT)
    return free, free.load(1, meshes.TOP)


def faces(scene):
    return scene.side(0, meshes.TOP), scene.side(1, meshes.BOTTOM)


@pytest.mark.ranks(2)
def test_sides():
    scene = two()
    side0, side1 = faces(scene)
    scalar = fem.functionspace(scene.bodies[0].mesh, ("Lagrange", 1))
    with raises(InterfaceError, r"contact is between displacements; the space of Γ0 has .* \(\)"):
        Contact((scalar, side0[1]), side1)
    with raises(InterfaceError, "Γ1 has no facets on any rank"):
        Contact(side0, (side1[0], side1[1][:0]))
    with raises(InterfaceError, "share facets"):
        Contact(side0, (side0[0], side0[1][1:]))
    with raises(ValueError, 'sliding is "finite" or "small", not \'large\''):
        Contact(side0, side1, sliding="large")
    with raises(ValueError, r"a contact's side is \(function space, facets\), not \(Mesh"):
        Contact((scene.bodies[0].mesh, side0[1]), side1)
    for wrong in (side0[0], scene.bodies[0].mesh, None):
        with raises(ValueError, "is a pair"):
            Contact(wrong, side1)
        with raises(ValueError, "is a pair"):
            Contact.between(wrong, side1)
    for stiffness in (10.0, (0.0, 1.0), (np.nan, 1.0), (1.0, -1.0)):
        with raises(ValueError, "stiffness is a pair of moduli > 0, not"):
            Contact.between(side0, side1, stiffness=stiffness)
    arrays = [u.x.array for u in scene.u]
    with raises(ValueError, "takes the displacements of both bodies, as functions"):
        Contact(side0, side1).gap(*arrays)


@pytest.mark.ranks(2)
def test_wrong_sides(caplog):
    """Sides that look the same way are told: bodies may turn; bodies behind each other refused."""
    scene = two()
    sides = scene.side(0, meshes.TOP), scene.side(1, meshes.TOP)
    scene.problem([Contact(*sides)]).solve()
    if comm.rank == 0:
        assert "yet; are these the right facets, on the right sides of their bodies?" in caplog.text
    with raises(InterfaceError, "along its normals; check the tags: is one of them the wrong side"):
        scene.problem([Contact(*sides, sliding="small")]).solve()
    scene = two(gap=-1.2)  # below, not on top
    with raises(InterfaceError, "Γ1 is 1.2 and more behind Γ0: the bodies are on the wrong sides"):
        scene.problem([Contact(*faces(scene))]).solve()


@pytest.mark.ranks(2)
@pytest.mark.parametrize(("gap", "told"), ((-0.02, False), (-0.2, True)))
def test_overlap_before_the_first_load_step(gap, told, caplog):
    """Contact pushes it out; one that may be an error of positions or units is told, once."""
    scene = two(gap=gap)
    contact = Contact(*faces(scene))
    problem = scene.problem([contact])
    for down in (0.0, -0.01):
        scene.down.value = down
        problem.solve()
    assert contact.force(problem)[1] > 0
    said = "the bodies overlap by 0.2 before the first load step, 40% of the thinner one's"
    assert caplog.text.count(said) == (told and comm.rank == 0)
    assert told or not caplog.records


@pytest.mark.ranks(2)
def test_out_of_reach(caplog):
    """Apart for ever is told once; what comes into reach later is found."""
    scene = two(gap=0.1, across=4.0)
    contact = Contact(*faces(scene))
    with raises(InterfaceError, "nothing of Γ1 lies opposite Γ0"):
        contact.gap(*scene.u)
    problem = scene.problem([contact])
    caplog.clear()
    problem.solve()
    problem.solve()
    if comm.rank == 0:
        assert [r.levelno for r in caplog.records] == [logging.WARNING]
        assert "contact 0: nothing of Γ1 (around (4, 0.1)) lies opposite Γ0" in caplog.text
    assert not contact.active.any() and not contact.pressures(problem).any()
    scene.across.value, scene.down.value = -4.0, -0.12
    problem.solve()
    assert contact.force(problem)[1] > 0.01


@pytest.mark.ranks(2)
def test_nodes_moved_after_the_contact_was_made(caplog):
    scene = two()
    problem = scene.problem([Contact(*faces(scene))])
    scene.u[1].function_space.mesh.geometry.x[:, 1] += 0.1
    problem.solve()
    told = [line for line in caplog.messages if "were moved by up to 0.1 after" in line]
    assert len(told) == (comm.rank == 0)


@pytest.mark.ranks(2)
def test_given_twice():
    scene = two()
    side0, side1 = faces(scene)
    contact = Contact(side0, side1)
    with raises(InterfaceError, "contact 0 and tie 0 have facets of Γ0 and of Γ1 in common"):
        scene.problem([contact], [Tie(side1, side0)])
    with raises(InterfaceError, "contact 0 and contact 1 have facets"):
        scene.problem([contact, Contact(side0, side1)])


@pytest.mark.ranks(2)
def test_problem(caplog):
    scene = two()
    contact = Contact(*faces(scene))
    with raises(ValueError, "the contact is in no problem"):
        _ = contact.active
    problem = scene.problem(contact)  # one, not in a list
    with raises(ValueError, "not solved yet"):
        contact.force(problem)
    with raises(ValueError, "contacts has a str"):
        scene.problem(["contact"])
    with raises(ValueError, r"ties has a str: make each with Tie\(side0, side1\)"):
        scene.problem([contact], ["tie"])
    with raises(ValueError, "give the ContactProblem with this contact, not a list"):
        contact.pressure([problem])
    with raises(ValueError, "Γ0 of contact 0 is on a space of no body"):
        ContactProblem(scene.F[1:], scene.u[1:], contacts=[contact])
    with raises(ValueError, "contact 0 is between two rigid bodies"):
        ContactProblem([None, None], scene.u, contacts=[contact])
    for F, u in ((scene.F[0], scene.u), (scene.F, None), (scene.F, contact.spaces)):
        with raises(ValueError, "F and u are lists, with one form and one function for each body"):
            ContactProblem(F, u, contacts=[contact])
    heat = fem.Function(fem.functionspace(scene.bodies[0].mesh, ("Lagrange", 1)))
    with raises(ValueError, r"body 2 has values of shape \(\); in contact problems bodies have"):
        ContactProblem([*scene.F, None], [*scene.u, heat], contacts=[contact])
    for none in ([], None):
        with raises(ValueError, "there are no contacts"):
            ContactProblem(scene.F, scene.u, contacts=none)
    for rtol in (-1.0, np.inf, "1e-8"):
        with raises(ValueError, "rtol is a number ≥ 0 and below 1, not"):
            scene.problem([contact], rtol=rtol)
    energy = ufl.inner(scene.u[0], scene.u[0]) * ufl.dx
    for F, kind in (
        (energy, "a form of rank 0"),
        (scene.bodies[0].a, "a form of rank 2"),
        (0, "int"),
    ):
        with raises(ValueError, f"the residual of body 0 is {kind}, not a form with one test"):
            ContactProblem([F, scene.F[1]], scene.u, contacts=[contact])
    with raises(ValueError, "the Jacobian form of body 0 is a form of rank 1, not a UFL form"):
        ContactProblem(scene.F, scene.u, contacts=[contact], J=scene.F)
    finer = two(n=(4, 9))
    with raises(ValueError, "Γ1 of contact 0 is rigid, with smaller facets"):
        ContactProblem([finer.F[0], None], finer.u, contacts=[Contact(*faces(finer))])
    with raises(ValueError, r"u1 is not on the space of Γ1 \(contact.spaces\[1\]\)"):
        contact.gap(scene.u[0], scene.u[0])
    with raises(ValueError, "not one of this problem's"):
        Contact(*faces(scene)).force(problem)
    stiff = Assembly([scene.bodies[0], replace(scene.bodies[1], E=1e4)])
    for i, tag in enumerate((meshes.BOTTOM, meshes.TOP)):
        for component in (0, 1):
            stiff.hold(i, component, tag)
    stiff.problem([contact]).solve()
    assert comm.rank > 0 or "contact 0: Γ1's body is far stiffer than Γ0's" in caplog.text
    alike = two(n=(4, 2))
    one = Contact(*faces(alike))
    ContactProblem([alike.F[0], None], alike.u, bcs=alike.bcs[:2], contacts=[one]).solve()
    assert comm.rank > 0 or "contact 0: Γ1's body is rigid" in caplog.text


@pytest.mark.ranks(2)
def test_loads():
    scene = two(gap=0.1)
    problem = scene.problem([Contact(*faces(scene))])
    scene.down.value = np.nan
    with raises(SolveError, "a prescribed displacement is no number"):
        problem.solve()
    scene.down.value = -0.2
    constant = scene.F[1].constants()[0]
    before, constant.value = constant.value.copy(), np.nan
    with raises(SolveError, "a load or another value in a form is no number"):
        problem.solve()
    constant.value = before
    problem.solve()  # as if nothing had been
    assert problem.iterations <= 8
    free = Assembly(scene.bodies)
    for component in (0, 1):
        free.hold(0, component, meshes.BOTTOM)
    free.load(1, meshes.TOP).value = 0.01
    what = "1 rigid motion of the .* not even by contact, which has no friction"
    zero = fem.Function(fem.functionspace(free.bodies[1].V.mesh, ("Lagrange", 1)))
    for friction in (None, fem.Constant(zero.function_space.mesh, 0.0), zero):
        problem = free.problem([Contact(*faces(free), friction=friction)])
        with raises(SolveError, what + r": body 1, at \(.*\), along \(-?1, 0\);"):
            problem.solve()
        assert "nothing holds body 1" in problem.status()


@pytest.mark.ranks(2)
def test_both_sides_prescribed(caplog):
    """Surfaces that are pushed into each other and can't part: once, and not where they touch."""
    scene = two()
    for i, tag in ((0, meshes.TOP), (1, meshes.BOTTOM)):
        held = [scene.hold(i, component, tag) for component in (0, 1)]
    problem = scene.problem([Contact(*faces(scene))])
    problem.solve()
    assert not caplog.records
    for down in (-0.1, -0.12):
        held[1].value = scene.down.value = down
        problem.solve()
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == (comm.rank == 0)
    for one in told:
        assert one.startswith("contact 0: both surfaces are prescribed around (")
        assert "where they overlap by 0.1: " in one
    scene.u[1].x.array[:] = np.nan
    with raises(SolveError, "a displacement at the start, in u, is no number"):
        problem.solve()


@pytest.mark.ranks(2)
def test_no_residual(monkeypatch):
    """Where cells are inverted, or a form gives no numbers, is told."""
    monkeypatch.setattr(contact_problem, "HALVINGS", 0)
    scene = two()
    V = scene.bodies[1].V
    high = fem.Constant(V.mesh, default_scalar_type(3.0))
    x, v = ufl.SpatialCoordinate(V.mesh), ufl.TestFunction(V)
    F = [scene.F[0], scene.F[1] + 1e-9 * ufl.ln(high - x[1]) * v[0] * ufl.dx]
    problem = ContactProblem(F, scene.u, bcs=scene.bcs, contacts=[Contact(*faces(scene))])
    scene.down.value = -0.02
    problem.solve()
    high.value = 0.9  # the top is at y = 1
    with raises(SolveError, r"cells of body 1 around \(.*, (0.5|1)\) of its mesh are inverted"):
        problem.solve()


def test_motions_in_words():
    """What a message says of rigid motions."""
    x = np.random.default_rng(0).random((20, 3)) + 2
    assert in_words(comm, x, 0 * x + (0, -2, 0)) == "along (0, 1, 0)"
    turned = np.cross((0, 0, 0.3), x - (2, 3, 0))
    words = r"that turns around \(2, 3, 2\.\d+\) on the axis \(0, 0, 1\)"
    assert re.fullmatch(words, in_words(comm, x, turned))
    assert in_words(comm, x[:, :2], turned[:, :2]) == "that turns around (2, 3)"


@pytest.mark.ranks(2, sliding=["small"])
@pytest.mark.parametrize("sliding", ("finite", "small"))
def test_failed_load_step(monkeypatch, sliding):
    """The state before remains, with its forces; what can't be halved is tried once."""
    monkeypatch.setattr(contact_problem, "HALVINGS", 1)
    free, load = free_to_rise()
    contact = Contact(*faces(free), sliding=sliding)
    problem = free.problem([contact])
    load.value = 0.1
    problem.solve()
    before = contact.force(problem), *(u.x.array.copy() for u in free.u)
    load.value = -1.0
    lost = ".* Then body 1 .* had gone by" if sliding == "finite" else ""
    with raises(SolveError, f"no solution beyond 0 % of the load step; .*body 1{lost}"):
        problem.solve()
    after = contact.force(problem), *(u.x.array for u in free.u)
    for a, b in zip(before, after, strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-12, atol=1e-15)
    with raises(SolveError, "can't be halved: no value has changed .* since the problem was made"):
        free.problem([contact]).solve()


@pytest.mark.ranks(2, friction=[0.0])
@pytest.mark.parametrize("friction", (None, 0.0))
def test_drawn_away(monkeypatch, friction):
    """The place is that at the load step's start, not on the way; friction of 0 is no cause."""
    monkeypatch.setattr(contact_problem, "HALVINGS", 1)
    free, load = free_to_rise()
    problem = free.problem([Contact(*faces(free), friction=friction)])
    load.value = -1.0
    what = r"; contact would have to pull at \(-?0\.5, 0\): body 1, that nothing else holds, is"
    with raises(SolveError, what + r" drawn.*Then body 1 at \(0, 0\.5\) had gone by \("):
        problem.solve()


@pytest.mark.ranks(2, sliding=["small"], friction=[None])
@pytest.mark.parametrize("friction", (None, 0.3))
@pytest.mark.parametrize("sliding", ("finite", "small"))
def test_slide_with_small_sliding(caplog, sliding, friction):
    """Told from half a facet of the finer side, 1/3 long, on: pressures act on other places."""
    scene = two()
    contact = Contact(*faces(scene), sliding=sliding, friction=friction)
    problem = scene.problem([contact])
    scene.down.value = -0.01
    for slide in (0.15, 0.2, 0.3):
        scene.across.value = slide
        with caplog.at_level(logging.WARNING):
            problem.solve()
        told = [line for line in caplog.messages if "surfaces slid along each other by 0." in line]
        assert len(told) == (sliding == "small" and slide > 0.15 and comm.rank == 0)


@two_ranks()
def test_cells_that_deform_without_a_stress():
    """Triangles of degree 2 with one quadrature point, on which no load acts that shows it."""
    scene = two(cell="triangle", degree=2)
    low = [
        [part.reconstruct(metadata={"quadrature_degree": 1}) for part in form.integrals()]
        for form in scene.F
    ]
    contact = Contact(*faces(scene))
    problem = ContactProblem(list(map(ufl.Form, low)), scene.u, bcs=scene.bcs, contacts=[contact])
    scene.down.value = -0.03
    with raises(SolveError, "found again from its loads; .* quadrature degree is too low"):
        problem.solve()


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron", "tetrahedron"])
def test_folded_facets(cell, caplog):
    """Middle nodes that are too far along their edges."""
    n, dim = ((2, 1), 2) if cell == "quadrilateral" else ((2, 1, 1), 3)
    for shift in (0.1, 0.2):  # a facet is 0.5 long

        def moved(s, shift=shift):
            return s + shift * np.isclose(s[:, :1] % 0.5, 0.25) * np.eye(dim)[0]

        (above, tags), (below, under) = (
            meshes.block(comm, n, mapping, cell=cell, degree=degree)
            for mapping, degree in ((moved, 2), (lambda s: s - np.eye(dim)[-1], 1))
        )
        bottom, top = (meshes.BOTTOM, meshes.TOP) if dim == 2 else (meshes.BACK, meshes.FRONT)
        V, W = (fem.functionspace(mesh, ("Lagrange", 2, (dim,))) for mesh in (above, below))
        caplog.clear()
        Contact((W, under.find(top)), (V, tags.find(bottom)))
        if comm.rank == 0:
            assert ("Γ1: 2 curved facets are folded" in caplog.text) == (
                shift == 0.2 and cell != "tetrahedron"
            )
            assert ("curved facets are folded, the first at" in caplog.text) == (shift == 0.2)


def test_round_with_straight_facets(caplog):
    """Of degree 2, in the plane and in space; a corner is not round."""

    def bent(x):
        return np.column_stack((2 * x[:, 0] - 1, x[:, 1] + 0.3 * (2 * x[:, 0] - 1) ** 2))

    flat, round_ = (
        rectangle((4, 2), (-1, -1), (1, 0), degree=2),
        rectangle((4, 2), None, None, degree=2, mapping=bent),
    )
    box = create_box(comm, [(0, 0, 0), (1, 1, 1)], (3, 3, 1), CellType.tetrahedron)
    below = create_box(comm, [(0, 0, -1), (1, 1, 0)], (3, 3, 1), CellType.tetrahedron)
    facets = locate_entities_boundary(box, 2, lambda x: np.isclose(x[2], 0))
    facets_below = locate_entities_boundary(below, 2, lambda x: np.isclose(x[2], 0))
    cornered = locate_entities_boundary(box, 2, lambda x: x[2] < 1)
    V, W = (fem.functionspace(mesh, ("Lagrange", 2, (3,))) for mesh in (box, below))
    for bodies in ("plane", "flat", "corners", "space"):
        caplog.clear()
        if bodies == "plane":
            Contact((flat.V, flat.facets(meshes.TOP)), (round_.V, round_.facets(meshes.BOTTOM)))
        else:
            if bodies == "space":
                box.geometry.x[:, 2] += 0.3 * box.geometry.x[:, 0] ** 2
            side = cornered if bodies == "corners" else facets
            Contact((W, facets_below), (V, side))
        if comm.rank == 0:
            said = "Γ1 is round with straight facets, of degree 2" in caplog.text
            assert said == (bodies in ("plane", "space")), bodies
