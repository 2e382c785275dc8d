# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The table before a solve, forces by body, and what is told of ties and walls."""

import re

from mpi4py import MPI

import numpy as np
import pytest
from assembly import rectangle
from helpers import close, raises
from test_contact_bodies import Assembly
from test_contact_input import faces, two

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import CellType, create_box
from hypergap_dolfinx import (
    Contact,
    ContactProblem,
    NonlinearTiedProblem,
    Tie,
    TiedProblem,
    find_touching,
)

comm = MPI.COMM_WORLD
pytestmark = pytest.mark.ranks(2)


def cells(table, line=1):
    """Cells of a line of a table."""
    return re.split(r"\s{2,}", table.split("\n")[line])


def test_table():
    """A gap, an overlap, what is closed, sides and why; where bodies are now."""
    scene = two(gap=0.1, across=0.3)
    contact = Contact(*faces(scene))
    expected = ["0", "4 / 3", "0.5 / 0.333", "1.5", "4 of 4", "0.1", "(-0.2, 0.1)", "–", "as given"]
    assert cells(contact.status()) == expected
    problem = scene.problem(contact)
    assert problem.status() == contact.status()
    assert cells(problem.status(), 0)[4:6] == ["Γ1 faces Γ0", "nearest gap"]
    scene.u[1].x.array[1::2] = -0.12
    line = cells(problem.status())
    assert line[5:7] == ["–", "0.02"] and line[7].startswith("(")
    scene.u[1].x.array[1::2] = -0.1
    assert "closed" in cells(problem.status())
    scene.down.value = -0.11
    problem.solve()
    assert "closed" in cells(problem.status())


def test_what_faces_nothing():
    """Vertices and whole sides that face nothing, bodies on the wrong sides, are named."""
    scene = two()
    text = Contact.between(*faces(scene)).status()
    assert cells(text)[-1] == "the first side, the coarser one"
    assert text.endswith("contact 0: 2 of 5 vertices of Γ1 face nothing, from (-1, 0) to (1, 0).")
    text = Contact(*faces(two(gap=0.1, across=4.0))).status()
    assert text.endswith("contact 0: nothing of Γ1, around (4, 0.1), faces Γ0 yet.")
    text = Contact(*faces(two(gap=-1.2))).status()
    assert "contact 0: Γ1 is 1.2 and more behind Γ0: the bodies are on the wrong sides" in text


@pytest.mark.parametrize("friction", (None, 0.3))
def test_what_nothing_holds(friction):
    """A body that only contact can hold, and one that it can't without friction."""
    scene = two()
    scene.bcs = scene.bcs[:2]
    text = scene.problem(Contact(*faces(scene), friction=friction)).status().split("\n")
    assert text[2].startswith("only contact can hold body 1, at (0, 0.5); otherwise hold it by")
    left = ["nothing holds body 1, at (0, 0.5), "]
    end = "along (1, 0), even if all that faces something touches; hold it by boundary conditions."
    assert text[3:] == ([] if friction else [left[0] + end])


def test_forces_by_body():
    """Signs don't depend on which side became Γ1; without friction nothing is dissipated."""
    found = []
    for swap in (False, True):
        scene = two(gap=-0.02)
        sides = faces(scene)
        contact = Contact(*(sides[::-1] if swap else sides))
        problem = scene.problem(contact)
        problem.solve()
        found.append([contact.force(problem, on=u) for u in scene.u])
        assert contact.dissipation(problem) == 0
        close(contact.force(problem), found[-1][1 - swap])
    (below, above), _ = found
    assert below[1] < 0
    for one in found:
        close(one[0], -one[1], 1e-12)
    close(found[1][1], above, 0.1)  # another discretisation
    for wrong in (fem.Function(scene.bodies[0].V), sides[0][0], "below"):
        with raises(ValueError, "force takes on=u, the displacement of one of its bodies"):
            contact.force(problem, on=wrong)


def test_flat_walls(caplog):
    """A rigid wall may have few facets; an elastic one, or a round one, is told."""
    wall = rectangle((1, 1), (-1, -1), (1, 0))
    block = rectangle((9, 3), (-0.5, 0), (0.5, 1))
    told = {}
    for rigid in (True, False):
        scene = Assembly([wall, block])
        for component in (0, 1):
            scene.hold(1, component, meshes.TOP)
            scene.hold(0, component, meshes.BOTTOM)
        contact = Contact(scene.side(0, meshes.TOP), scene.side(1, meshes.BOTTOM))
        caplog.clear()
        F = [None if rigid else scene.F[0], scene.F[1]]
        ContactProblem(F, scene.u, bcs=scene.bcs[:: 1 + rigid], contacts=[contact])
        told[rigid] = "times finer than Γ0" in caplog.text
    assert told == {True: False, False: comm.rank == 0}


def heat(conductance):
    """Two blocks with a conductance between them."""
    bodies = rectangle((3, 3), (0, 0), (1, 1)), rectangle((4, 3), (0, 1), (1, 2))
    V = [fem.functionspace(body.mesh, ("Lagrange", 1)) for body in bodies]
    ends = (meshes.BOTTOM, meshes.TOP)
    tie = Tie(
        (V[0], bodies[0].facets(meshes.TOP)),
        (V[1], bodies[1].facets(meshes.BOTTOM)),
        conductance=conductance,
    )
    a = [ufl.inner(ufl.grad(ufl.TrialFunction(W)), ufl.grad(ufl.TestFunction(W))) for W in V]
    bcs = [
        fem.dirichletbc(
            default_scalar_type(t), fem.locate_dofs_topological(W, 1, body.facets(tag)), W
        )
        for t, (W, body, tag) in enumerate(zip(V, bodies, ends, strict=True))
    ]
    return TiedProblem([form * ufl.dx for form in a], [None, None], bcs=bcs, ties=[tie]), tie


def test_destroyed():
    """Objects of a problem that was destroyed are told; those that the user kept go on."""
    problem, tie = heat(1.0)
    problem.solve()
    x, norm = problem.x, problem.x.norm()
    problem.destroy()
    assert x.norm() == norm
    for name in ("x", "b", "A", "solver"):
        with raises(ValueError, "the problem was destroyed"):
            getattr(problem, name)
    with raises(ValueError, "the problem was destroyed"):
        tie.traction(problem)
    problem, tie = heat(1.0)
    tie.destroy()
    with raises(ValueError, "the tie was destroyed: one with a compliance, a conductance or a law"):
        problem.solve()


def test_gap_of_ties_in_any_order():
    """As a contact's gap: bodies are found by their spaces."""
    problem, tie = heat(1.0)
    u = problem.solve()
    gaps = [tie.gap(*order)[0].x.array for order in (u, u[::-1])]
    assert np.array_equal(*gaps) and comm.allreduce(abs(gaps[0]).max(initial=0), MPI.MAX) > 0.1


def test_jumps_of_one_number():
    """One number at each point is no vector, for two points either."""
    for n in (1, 2, 4):
        bodies = rectangle((2, 2), (0, 0), (1, 1)), rectangle((n, 2), (0, 1), (1, 2))
        sides = (
            (bodies[0].V, bodies[0].facets(meshes.TOP)),
            (
                bodies[1].V,
                bodies[1].facets(meshes.BOTTOM),
            ),
        )
        with raises(ValueError, "one number at each point, the space has 2 components; give an ar"):
            Tie(*sides, jump=lambda x: x[0]).offset()
        for jump in (
            lambda x: (0.1, 0.0),
            lambda x: np.array([0.1, 0]),
            lambda x: (x[0], 0 * x[0]),
        ):
            Tie(*sides, jump=jump).offset().destroy()


def test_floats_without_conductance(caplog):
    """A body whose only tie conducts nothing is told, in a contact problem too."""
    scene = Assembly(
        [
            rectangle((3, 2), (-1, -1), (1, 0)),
            rectangle((4, 2), (-0.5, 0), (0.5, 1)),
            rectangle((3, 2), (-1, -2), (1, -1)),
        ]
    )
    for component in (0, 1):
        scene.hold(1, component, meshes.TOP)
        scene.hold(2, component, meshes.BOTTOM)
    h = fem.Constant(scene.bodies[0].mesh, 1.0)
    tie = Tie(scene.side(2, meshes.TOP), scene.side(0, meshes.BOTTOM), conductance=h)
    contact = Contact(scene.side(0, meshes.TOP), scene.side(1, meshes.BOTTOM))
    problem = scene.problem([contact], [tie])
    message = "nothing but contact and ties whose conductance is 0 holds body 0, at (0, -0.5)"
    problem.solve()
    assert message not in caplog.text
    h.value = 0.0
    problem.solve()
    assert comm.rank > 0 or message in caplog.text


def test_cells_of_other_kinds():
    """Prisms are told, by ties, contacts and find_touching."""
    V = [
        fem.functionspace(create_box(comm, low, (2, 2, 2), CellType.prism), ("Lagrange", 1, (3,)))
        for low in (((0, 0, 0), (1, 1, 1)), ((0, 0, 1), (1, 1, 2)))
    ]
    facet = np.zeros(1, dtype=np.int32)
    for kind in (Tie, Contact):
        with raises(ValueError, "lies on prism cells; bodies in space are made of tetrahedra or"):
            kind((V[0], facet), (V[1], facet))
    with raises(ValueError, r"spaces\[0\] has prism cells; facets of one kind are needed"):
        find_touching(V)


def test_status_of_destroyed():
    """Neither a status nor a state of a problem that was destroyed."""
    scene = two()
    problem = scene.problem(Contact(*faces(scene)))
    problem.destroy()
    for call in (problem.status, problem.state, problem.solve):
        with raises(ValueError, "the problem was destroyed"):
            call()
    tied = NonlinearTiedProblem(scene.F, scene.u, bcs=scene.bcs, ties=[Tie(*faces(scene))])
    tied.destroy()
    for call in (tied.state, tied.solve, lambda: tied.solver):
        with raises(ValueError, "the problem was destroyed"):
            call()
