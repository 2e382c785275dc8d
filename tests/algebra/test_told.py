# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bad input about what bodies bring: each is told in one line that names it and says what to do."""

from functools import cache, partial

from mpi4py import MPI

import numpy as np
import pytest
from assembly import rectangle
from helpers import raises
from test_contact_bodies import Assembly

import basix.ufl
import meshes
from dolfinx import fem, mesh
from hypergap_dolfinx import (
    Contact,
    ContactProblem,
    InterfaceError,
    NonlinearTiedProblem,
    RigidBody,
    SolveError,
    State,
    Tie,
    find_touching,
)

comm = MPI.COMM_WORLD


class Scene(Assembly):
    """A block on a wider one, held below, and moved above."""

    def __init__(self):
        super().__init__(
            [rectangle((8, 2), (0, -1), (2, 0)), rectangle((3, 2), (0.5, 0), (1.5, 1))]
        )
        for component in (0, 1):
            self.hold(0, component, meshes.BOTTOM)
        self.held = list(self.bcs)
        self.down = [self.hold(1, component, meshes.TOP) for component in (0, 1)][1]
        self.sides = self.side(0, meshes.TOP), self.side(1, meshes.BOTTOM)

    def contact(self, **options):
        return Contact(*self.sides, **options)

    def number(self, value=0.3):
        return fem.Constant(self.bodies[1].mesh, value)

    def pressed(self, **options):
        """A problem in which the upper block is moved down."""
        problem = self.problem(self.contact(), **options)
        self.down.value = -0.01
        problem.solve()

    def tied(self, **options):
        """The blocks tied, not solved yet."""
        tie = Tie(*self.sides, **options)
        return tie, NonlinearTiedProblem(self.F, self.u, bcs=self.bcs, ties=[tie])


@cache
def solved(friction=None):
    """A scene with its contact and its solved problem."""
    scene = Scene()
    contact = scene.contact(friction=friction)
    problem = scene.problem(contact)
    problem.solve()
    return scene, contact, problem


@cache
def tied():
    """The same, tied."""
    scene = Scene()
    tie, problem = scene.tied()
    problem.solve()
    return scene, tie, problem


@cache
def mixed():
    """A Taylor–Hood space and its upper facets."""
    square = mesh.create_unit_square(comm, 3, 3)
    cell = square.basix_cell()
    parts = [
        basix.ufl.element("Lagrange", cell, 2, shape=(2,)),
        basix.ufl.element("Lagrange", cell, 1),
    ]
    W = fem.functionspace(square, basix.ufl.mixed_element(parts))
    return W, mesh.locate_entities_boundary(square, 1, lambda x: np.isclose(x[1], 1))


def side():
    return solved()[0].sides[1]


def coefficient(name, value):
    """It becomes a value after the first load step."""
    scene = Scene()
    given = scene.number()
    problem = scene.problem(scene.contact(**{name: given}))
    problem.solve()
    given.value = value
    problem.solve()


def pushed(name, value, **options):
    """The upper block is rigid, and one of its values is set in place."""
    scene = Scene()
    body = RigidBody(scene.u[1], **{"point": (1, 0.5), "held": ("x", "rotation"), **options})
    forms, contacts = [scene.F[0], body], [scene.contact()]
    problem = ContactProblem(forms, scene.u, bcs=scene.held, contacts=contacts)
    getattr(body, name)[:] = value
    problem.solve()


def rigid(**options):
    return RigidBody(fem.Function(side()[0]), **{"point": (0, 0), **options})


def moved():
    u = fem.Function(side()[0])
    u.x.array[:] = 0.1
    return RigidBody(u, point=(0, 0))


def jumping(jump):
    Scene().tied(jump=jump)[1].solve()


def in_space(**options):
    cube = mesh.create_unit_cube(comm, 1, 1, 1)
    V = fem.functionspace(cube, ("Lagrange", 1, (3,)))
    sides = [
        (V, mesh.locate_entities_boundary(cube, 2, lambda x, z=z: np.isclose(x[2], z)))
        for z in (0, 1)
    ]
    return Contact(*sides, **options)


def destroyed(use):
    scene = Scene()
    problem = scene.problem(scene.contact())
    problem.destroy()
    use(problem)


def hook(name, function):
    return lambda: Scene().pressed(**{name: function})


def of(call):
    """A call with a solved contact problem."""
    return lambda: call(*solved())


def of_tie(call):
    return lambda: call(*tied())


V, E, S = ValueError, InterfaceError, SolveError
CASES = {
    # Bodies on mixed spaces
    "mixed space": (lambda: Contact(mixed(), side()), E, r"Γ0 .* \(3,\) .*W.sub\(0\) for example"),
    "pressures of one": (
        lambda: Contact((mixed()[0].sub(1), mixed()[1]), side()),
        E,
        r"Γ0 has the value shape \(\) .*W.sub\(0\) for example",
    ),
    "body without it": (
        lambda: Scene().problem(Contact((mixed()[0].sub(0), mixed()[1]), side())),
        V,
        "Γ0 of contact 0 is on a space of no body; make",
    ),
    # Histories
    "history without share": (
        hook("accepted", lambda: None),
        V,
        r"accepted takes other arguments .* make it a function accepted\(share\)",
    ),
    "hook with arguments": (
        hook("before_step", lambda step: None),
        V,
        r"before_step takes other arguments .* make it a function before_step\(\)",
    ),
    "hook that is called": (hook("taken_back", 3), V, "taken_back is a int; give a function"),
    "history of arrays": (
        hook("internal_variables", [np.zeros(3)]),
        V,
        "internal_variables has a ndarray; give functions and constants",
    ),
    "history of a number": (
        hook("internal_variables", 3),
        V,
        "internal_variables has a int; give functions and constants",
    ),
    "history of displacements": (
        lambda: (lambda scene: scene.pressed(internal_variables=scene.u))(Scene()),
        V,
        r"internal_variables has u\[0\], .*leave it out",
    ),
    # States
    "state of a file's name": (
        of(lambda scene, contact, problem: problem.restore("state.npz")),
        V,
        r"restore takes a State, of problem.state\(\) or State.load\(…\), not a str",
    ),
    "state of a tie": (
        of(lambda scene, contact, problem: problem.restore(tied()[2].state())),
        V,
        "the state is one of a NonlinearTiedProblem, not of a ContactProblem",
    ),
    "state with friction": (
        of(lambda scene, contact, problem: problem.restore(solved(0.3)[2].state())),
        V,
        "the state has contact 0/dissipated and the problem hasn't: .*another problem",
    ),
    "file without a name": (lambda: State.load(None), V, "load takes the name of a file, not a No"),
    "state without a name": (
        of(lambda scene, contact, problem: problem.state().save(3)),
        V,
        "save takes the name of a file, not a int",
    ),
    "no communicator": (lambda: State.load("a.npz", 3), V, "communicator, not 3: give mesh.comm"),
    # Rigid bodies
    "force that is no number": (
        partial(pushed, "force", np.nan),
        S,
        "the force of body 1, a rigid one, is no number: it is NaN or infinite; set it",
    ),
    "anchor at infinity": (
        partial(pushed, "anchors", np.inf),
        S,
        "an anchor of body 1, a rigid one, is no number",
    ),
    "spring that pushes": (partial(pushed, "springs", -1), V, "stiffness -1; give numbers ≥ 0"),
    "prescribed and free": (
        partial(pushed, "prescribed", (0, 1, 0)),
        V,
        "prescribed for y of a rigid body, which isn't held: make the .* or set 0",
    ),
    "component of space": (lambda: rigid(held="rz"), V, "held has 'rz'; components are x, y, rot"),
    "force with a component too many": (
        lambda: setattr(rigid(), "force", (0, 1, 0)),
        V,
        r"the force of a rigid body: give 2 finite numbers, not \(0, 1, 0\)",
    ),
    "one number for all springs": (
        lambda: setattr(rigid(), "springs", 1.0),
        V,
        "the springs of a rigid body: give 3 finite numbers, not 1.0",
    ),
    "a constant as torque": (
        lambda: setattr(rigid(), "torque", Scene().number()),
        V,
        "the torque of a rigid body: give one finite number, not ",
    ),
    "held by a number": (lambda: rigid(held=2), V, "held has 2; components are x, y, rotation"),
    "displaced before": (moved, V, "isn't 0 at the start, and would be lost: set it"),
    # Bodies of revolution
    "factor of forms": (
        lambda: Scene().contact(axisymmetric="2πr"),
        V,
        r'axisymmetric is True \(2πr in forms\), "radian" .* not \'2πr\'',
    ),
    "in space": (partial(in_space, axisymmetric=True), E, r"meshes in the plane \(r, z\)"),
    # One surface
    "some facets": (
        of(lambda scene, *_: Contact(scene.sides[0], (scene.sides[0][0], scene.sides[0][1][1:]))),
        E,
        "Γ0 and Γ1 share facets; give each side its own, or all of them to both",
    ),
    # Coefficients
    "friction that is true": (
        lambda: Scene().contact(friction=True),
        V,
        "friction is a number, a fem.Constant or a fem.Function on Γ1's mesh, not bool",
    ),
    "friction becomes NaN": (
        partial(coefficient, "friction", np.nan),
        S,
        "the coefficient of friction of contact 0 is no number: .* set it before",
    ),
    "compliance becomes negative": (
        partial(coefficient, "compliance", -1.0),
        V,
        "the compliance is -1 on Γ1; it is a number from 0 on",
    ),
    "stiffness in words": (
        of(lambda scene, *_: Contact.between(*scene.sides, stiffness=("soft", "stiff"))),
        V,
        r"stiffness is a pair of moduli > 0, not \('soft', 'stiff'\)",
    ),
    # What is asked of a solution
    "force on an index": (
        of(lambda scene, contact, problem: contact.force(problem, on=1)),
        V,
        "force takes on=u, the displacement of one of its bodies",
    ),
    "pressure of displacements": (
        of(lambda scene, contact, problem: contact.pressure(scene.u)),
        V,
        "give the ContactProblem with this contact, not a list",
    ),
    "slip without friction": (
        of(lambda scene, contact, problem: contact.slips(problem)),
        V,
        "the contact has no friction: give it a coefficient",
    ),
    "dissipation of a tie's": (
        of(lambda scene, contact, problem: contact.dissipation(tied()[2])),
        V,
        "give the ContactProblem with this contact, not a NonlinearTiedProblem",
    ),
    "rows of a tie": (
        of(lambda scene, contact, problem: problem.rows(tied()[1])),
        V,
        "a Tie is not one of this problem's contacts: give one of problem.contacts",
    ),
    "multipliers of a contact": (
        of(lambda scene, contact, problem: problem.multipliers(contact)),
        V,
        "a Contact is not one of this problem's ties: give one of problem.ties",
    ),
    "gap of arrays": (
        of_tie(lambda scene, tie, problem: tie.gap(*(u.x.array for u in scene.u))),
        V,
        "takes the displacements of both bodies, as functions",
    ),
    "tie's force on a side": (
        of_tie(lambda scene, tie, problem: tie.force(problem, on="side1")),
        V,
        "on= takes the displacement of one of the tie's bodies, a function, not a str",
    ),
    "tie's traction of nothing": (
        of_tie(lambda scene, tie, problem: tie.traction(None)),
        V,
        "give the problem with this tie, not a NoneType",
    ),
    "moment about a word": (
        of_tie(lambda scene, tie, problem: tie.moment(problem, "axis")),
        V,
        "about: give 2 finite numbers, not 'axis'",
    ),
    "moment at displaced places, by a word": (
        of_tie(lambda scene, tie, problem: tie.moment(problem, (0, 0), displaced="yes")),
        V,
        "displaced is 'yes': give True, False or None",
    ),
    "rows of what is destroyed": (
        partial(destroyed, lambda problem: problem.x),
        V,
        "the problem was destroyed",
    ),
    # Small things
    "jump of a number": (
        partial(jumping, lambda x: x[0]),
        V,
        "space has 2 components; give",
    ),
    "jump that is no number": (
        partial(jumping, lambda x: (x[0], np.nan * x[1])),
        V,
        r"the jump is \[.*nan\] at \(.*\); it must be finite",
    ),
    "spaces of touching bodies": (
        lambda: find_touching(side()[0]),
        V,
        "find_touching takes a list of spaces, one for each body, not a FunctionSpace",
    ),
    "a condition that is none": (
        lambda: (lambda s: ContactProblem(s.F, s.u, bcs=[None], contacts=s.contact()))(Scene()),
        V,
        "bcs is one flat list of Dirichlet conditions; it has a NoneType",
    ),
    "a contact that is none": (
        lambda: Scene().problem([None]),
        V,
        r"contacts has a NoneType: make each with Contact\(side0, side1\)",
    ),
    "options in one string": (
        hook("petsc_options", "-ksp_view"),
        V,
        "petsc_options is a dictionary .* not '-ksp_view'",
    ),
}


@pytest.mark.ranks(2)
@pytest.mark.parametrize("case", CASES)
def test_one_line(case):
    call, error, words = CASES[case]
    with raises(error, words):
        call()
