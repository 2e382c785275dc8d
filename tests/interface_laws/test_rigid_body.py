# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Rigid bodies under forces and torques: balance, finite rotations, springs, states, messages."""

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
from assembly import Elastic
from helpers import close, raises, two_ranks

import meshes
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import Contact, ContactProblem, RigidBody, SolveError, Tie

comm = MPI.COMM_WORLD
BALANCED = 1e-10  # of the load: round-off of a residual with rtol 1e-13, up to 3e-13
UP = {2: (meshes.BOTTOM, meshes.TOP), 3: (meshes.BACK, meshes.FRONT)}


def bed_and_block(
    dim=2,
    *,
    rigid_bed=False,
    obstacle=False,
    held=(),
    height=0.0,
    more=(),
    fine=1,
    rtol=1e-13,
    **options,
):
    """A rigid block, from 1 to 3, on a bed from 0 to 4 that is held at its bottom."""
    n = [(8 * fine, 3), (3 * fine, 2 * fine)] if dim == 2 else [(6, 6, 2), (3, 3, 1)]
    low = np.array([(0.0,) * (dim - 1) + (-1.0,), (1.0,) * (dim - 1) + (height,)])
    size = np.array([(4.0,) * (dim - 1) + (1.0,), (2.0,) * (dim - 1) + (1.0,)])
    cell = "quadrilateral" if dim == 2 else "hexahedron"
    made = [
        meshes.block(comm, n[i], lambda s, i=i: low[i] + size[i] * s, cell=cell) for i in range(2)
    ]
    V0, V1 = (fem.functionspace(mesh, ("Lagrange", 1, (dim,))) for mesh, _ in made)
    bottom, top = UP[dim]
    facets = np.sort(np.concatenate([made[1][1].find(tag) for tag in (bottom, *more)]))
    contact = Contact((V0, made[0][1].find(top)), (V1, facets), **options)
    u1 = fem.Function(V1)
    body = RigidBody(u1, point=(2.0,) * (dim - 1) + (height + 0.5,), held=held)
    bed = Elastic.on(V0)
    fixed = fem.locate_dofs_topological(V0, dim - 1, made[0][1].find(bottom))
    zero = fem.Constant(made[0][0], default_scalar_type((0.0,) * dim))
    problem = ContactProblem(
        [None if rigid_bed else bed.F, None if obstacle else body],
        [bed.u, u1],
        bcs=[] if rigid_bed else [fem.dirichletbc(zero, fixed, V0)],
        contacts=[contact],
        rtol=rtol,
    )
    return SimpleNamespace(problem=problem, body=body, contact=contact, bed=bed, u=u1)


def unbalanced(scene):
    """Force and torque about the point that contact, loads, springs and supports leave."""
    body, n = scene.body, len(scene.body.point)
    rows = scene.problem.rows(scene.contact)
    i = rows.fields.index(body.u)
    side, forces = rows.sides[i], rows.contact_forces()[i]
    V = body.u.function_space
    x = np.zeros((V.dofmap.index_map.size_global, n))
    start, end = V.dofmap.index_map.local_range
    u = body.u.x.array.reshape(-1, n)
    x[start:end] = (V.tabulate_dof_coordinates()[:, :n] + u)[: end - start]
    x = comm.allreduce(x)[side.dofs] - body.point - body.displacement
    moment = np.cross(*(np.pad(part, ((0, 0), (0, 3 - n))) for part in (x, forces))).sum(axis=0)
    values = np.append(body.displacement, body.angles)
    loads = np.append(body.force, body.torque) + body.springs * (body.anchors - values)
    return np.append(forces.sum(axis=0), moment[2:] if n == 2 else moment) + loads + body.reaction


@pytest.mark.ranks(3, friction=[0.4])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("friction", [None, 0.4])
def test_balance(dim, friction):
    """Forces and torques balance; what friction can't hold is held."""
    held = () if friction else {2: ("x",), 3: ("x", "y", "rz")}[dim]
    scene = bed_and_block(dim, held=held, friction=friction)
    body = scene.body
    body.force = (0.02,) * (dim - 1) + (-0.3,)
    body.torque = 0.03 if dim == 2 else (0.05, 0.02, 0.01)
    for _ in range(2):
        scene.problem.solve()
        assert np.abs(unbalanced(scene)).max() < BALANCED * 0.3
        assert not body.reaction[:dim][~body.held[:dim]].any() and abs(body.angles).any()
        about, given = body.point + body.displacement, (scene.bed.u, scene.u)
        below, above = (scene.contact.moment(scene.problem, about, on=u) for u in given)
        assert np.abs(above + body.torque + body.reaction[dim:]).max() < BALANCED * 0.3
        assert np.abs(below + above).max() < BALANCED * 0.3
        body.force = 1.5 * body.force
    force = scene.contact.force(scene.problem, on=scene.u)
    close(force[-1], 0.45)


def test_same_as_an_obstacle():
    """A rigid body all of which is held is an obstacle that the user moves."""
    pressures = []
    for obstacle in (False, True):
        scene = bed_and_block(obstacle=obstacle, held=("x", "y", "rotation"), friction=0.3)
        scene.problem.solve()  # slip is counted from here
        scene.body.prescribed = 0.01, -0.05, 0.02
        if obstacle:
            turned = np.array([[np.cos(0.02), -np.sin(0.02)], [np.sin(0.02), np.cos(0.02)]])
            x = scene.u.function_space.tabulate_dof_coordinates()[:, :2] - scene.body.point
            u = x @ (turned - np.eye(2)).T + (0.01, -0.05)
            scene.u.x.array[:] = u.ravel()
        scene.problem.solve()
        pressures.append(scene.contact.pressures(scene.problem))
    close(pressures[0], pressures[1], 1e-10)
    assert pressures[0].max() > 0


@pytest.mark.parametrize("eccentric", [0.0, 0.1])
def test_spring_bed(eccentric):
    """A block on a compliant floor sinks by F c / A; with a torque forces balance as it tilts."""
    c = 1e-3
    scene = bed_and_block(rigid_bed=True, held="x", compliance=c)
    scene.body.force, scene.body.torque = (0.0, -2.0), -2.0 * eccentric
    scene.problem.solve()
    assert np.abs(unbalanced(scene)).max() < BALANCED
    close(scene.body.displacement, (0, -2.0 * c / 2), 1e-3 if eccentric else 1e-10)
    if eccentric:  # M c / I, but for the linear fields on three facets
        close(scene.body.angles, [-2.0 * eccentric * c / (2**3 / 12)], 0.2)


def test_axisymmetric():
    """A ring on a compliant floor sinks by F c / A along the axis; other motions are refused."""
    options = {"rigid_bed": True, "compliance": 1e-3, "axisymmetric": True}
    with raises(ValueError, r'can move along the axis only; make it with held=\("x", "rotation"\)'):
        bed_and_block(**options)
    scene = bed_and_block(**options, held=("x", "rotation"))
    scene.body.force = 0.0, -2.0
    scene.problem.solve()
    close(scene.body.displacement, (0, -2.0 * 1e-3 / (np.pi * (3**2 - 1))), 1e-10)


@two_ranks()
def test_quarter_turns():
    """Turned by 90° by a torque in one load step; in space about x after z. Nodes move rigidly."""
    scene = bed_and_block(height=3.0, held=("x", "y"))
    body = scene.body
    body.springs[2], body.torque = 0.4, 0.4 * np.pi / 2
    scene.problem.solve()
    close(body.angles, [np.pi / 2], 1e-12)
    close(body.rotation, [[0, -1], [1, 0]], 1e-12)
    scene = bed_and_block(3, height=3.0, held=("x", "y", "z", "rx", "ry", "rz"))
    body = scene.body
    for angles in ((0, 0, np.pi / 2), (np.pi / 2, 0, np.pi / 2)):
        body.prescribed[3:] = angles
        scene.problem.solve()
    about_x, about_z = [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    R = np.array(about_x) @ np.array(about_z)
    close(body.rotation, R, 1e-12)
    x = body.u.function_space.tabulate_dof_coordinates() - body.point
    close(body.u.x.array.reshape(-1, 3), x @ (R - np.eye(3)).T, 1e-12)


def test_turned_against_a_block():
    """A bar that a torque turns by 90° and more against a block, in load steps of 30°."""
    scene = bed_and_block(height=0.5, held=("x", "y"), more=(meshes.LEFT,), fine=4)
    body = scene.body
    body.springs[2] = 0.4
    for angle in (30, 45, 60):
        body.torque = 0.4 * np.radians(angle)
        scene.problem.solve()
        assert np.abs(unbalanced(scene)).max() < BALANCED
    assert scene.contact.active.any() and body.angles < np.pi / 3


@pytest.mark.ranks
def test_state():
    """A problem that goes on from a state does the same as the one that it is of."""
    found, state = [], None
    for again in (False, True):
        scene = bed_and_block(3, friction=0.4)
        body = scene.body
        body.force, body.torque = (0.02, 0.01, -0.3), (0.05, 0.02, 0.01)
        if again:
            scene.problem.restore(state)
        else:
            scene.problem.solve()
            state = scene.problem.state()
        body.force = 0.05, 0.03, -0.4
        body.torque = 0.08, -0.05, 0.03
        scene.problem.solve()
        found.append(np.concatenate((body.displacement, body.angles, body.rotation.ravel())))
    close(found[1], found[0], 1e-12)


def test_mass():
    """Springs and anchors of Newmark's method are a mass: free fall, then landing."""
    scene = bed_and_block(height=0.5, held=("x", "rotation"))
    body, dt, m = scene.body, 0.2, 0.05
    v, a, u, touched = 0.0, -1.0, 0.0, False
    body.force[1], body.springs[1] = -m, 4 * m / dt**2
    for k in range(1, 9):
        predicted = u + dt * v + dt**2 / 4 * a
        body.anchors[1] = predicted
        scene.problem.solve()
        assert np.abs(unbalanced(scene)).max() < BALANCED * 4 * m / dt**2
        before, u = u, body.displacement[1]
        a_new = 4 * (u - predicted) / dt**2
        v, a = v + dt / 2 * (a + a_new), a_new
        if k < 5:
            close(u, -((k * dt) ** 2) / 2, 1e-11)
        touched |= scene.contact.active.any()
    assert touched and u > before  # it goes up again


def test_restored_after_failure():
    """A block drawn away is told; the state before remains."""
    scene = bed_and_block(held=("x", "rotation"), rtol=1e-8)
    body = scene.body
    body.force = 0.0, -0.3
    scene.problem.solve()
    before, u = body.displacement, body.u.x.array.copy()
    body.force = 0.0, 0.2
    with raises(SolveError, "body 1.*drawn away|contact would have to pull"):
        scene.problem.solve()
    body.force = 0.0, -0.3
    scene.problem.solve()
    close(body.displacement, before, 1e-6)
    close(body.u.x.array, u, 1e-6)


def test_bodies_that_nothing_holds():
    """They are named, in the status and in the error."""
    scene = bed_and_block()
    status = scene.problem.status()
    assert "nothing holds body 1" in status and "something touches; hold it by held=." in status
    scene.body.force = 0.1, -0.3
    with raises(SolveError, r"body 1, at \(2, 0.5\), along \(1, 0\); hold them by held=\."):
        scene.problem.solve()
    scene.body.springs[0] = 1.0
    assert "nothing holds" not in scene.problem.status()
    scene.problem.solve()
    close(scene.body.displacement[0], 0.1, 0.1)


def test_bad_input():
    """One line each."""
    mesh, _ = meshes.block(comm, (2, 2))
    V, W = (fem.functionspace(mesh, ("Lagrange", 1, shape)) for shape in ((2,), ()))
    u = fem.Function(V)
    for given, options, match in (
        (V, {"point": (0, 0)}, "takes the displacement u, not a FunctionSpace"),
        (fem.Function(W), {"point": (0, 0)}, "on a Lagrange space of vectors"),
        (u, {"point": (0, 0, 0)}, "the point of a rigid body: give 2 finite numbers, not"),
        (u, {"point": (0, np.nan)}, "the point of a rigid body: give 2 finite numbers, not"),
        (u, {"point": "middle"}, "the point of a rigid body: give 2 finite numbers, not"),
        (u, {"point": (0, 0), "held": ("x", "rx")}, "held has 'rx'; components are x, y, rotation"),
    ):
        with raises(ValueError, match):
            RigidBody(given, **options)
    scene = bed_and_block()
    body, contact = scene.body, scene.contact
    F, u = scene.bed.F, [scene.bed.u, scene.u]
    other = fem.Function(u[1].function_space)
    fixed = RigidBody(scene.bed.u, point=(0, 0))
    for forms, functions, options, match in (
        ([F, body], [u[0], other], {}, "isn't the u of the rigid body"),
        ([body, body], [u[1], u[1]], {}, "given twice"),
        ([fixed, body], u, {}, "between two rigid bodies, where pressures are undetermined"),
        ([None, body], u, {}, "between two rigid bodies"),
        ([F, body], u, {"solver": "iterative"}, "a rigid body moves"),
    ):
        with raises(ValueError, match):
            ContactProblem(forms, functions, contacts=[contact], **options)
    zero = fem.Constant(u[1].function_space.mesh, default_scalar_type((0.0, 0.0)))
    fixed = fem.dirichletbc(zero, np.array([0], dtype=np.int32), u[1].function_space)
    with raises(ValueError, "a boundary condition is on body 1, a rigid one: hold it by held="):
        ContactProblem([F, body], u, bcs=[fixed], contacts=[contact])
    sides = zip(contact.spaces, contact.facets, strict=True)
    with raises(ValueError, "tie 0 is on body 1, a rigid one, which can't be tied: give"):
        ContactProblem([F, body], u, contacts=[contact], ties=[Tie(*sides)])
    body.prescribed[2] = 0.1
    with raises(ValueError, "prescribed for rotation of a rigid body, which isn't held"):
        scene.problem.solve()
    body.prescribed[2], body.springs[0] = 0.0, -1.0
    with raises(ValueError, "stiffness -1; give numbers ≥ 0"):
        scene.problem.solve()
    body.springs[0], body.force[1] = 0.0, np.nan
    with raises(SolveError, "is no number"):
        scene.problem.solve()


def test_names():
    """``help`` shows what users need; names that can't be set are told, as misspelt ones."""
    names = {name for name in dir(RigidBody) if not name.startswith("_")}
    results = {"angles", "components", "displacement", "point", "reaction", "rotation"}
    given = {"anchors", "force", "held", "prescribed", "springs", "torque"}
    assert names == results | given
    scene = bed_and_block(2)
    for one, name in ((scene.body, "moment"), (scene.body, "u"), (scene.contact, "force")):
        with raises(AttributeError, f"^{name} of a .* can't be set; .* can"):
            setattr(one, name, 5.0)
    with raises(AttributeError, "bcs of a ContactProblem can't be set; nothing can: make another"):
        scene.problem.bcs = []
    with raises(AttributeError, "can't be set; anchors, force, prescribed, springs, torque can"):
        scene.body.hold = "x"
    with raises(ValueError, "held can't be changed later: make a rigid body with held='x'"):
        scene.body.held = "x"

    class Wheel(RigidBody):
        def __init__(self, u, radius):
            super().__init__(u, point=(0, radius))
            self.radius = radius

    assert Wheel(fem.Function(scene.body.u.function_space), 2.0).radius == 2.0
