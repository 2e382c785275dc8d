# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""States: a run that goes on from one has the same digits, on any number of ranks."""

import subprocess
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
from helpers import close, raises, thorough, two_ranks

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import CellType, create_box, locate_entities_boundary
from hypergap_dolfinx import Contact, ContactProblem, NonlinearTiedProblem, SolveError, State, Tie
from hypergap_dolfinx.algebra.input_order import InputOrder

comm = MPI.COMM_WORLD


class Scene:
    """Blocks on each other, of which the top one is moved or pressed."""

    def __init__(self, comm, *, n=((5, 3), (4, 3)), degree=1, cell="quadrilateral", loaded=False):
        self.comm, self.degree = comm, degree
        self.V, self.F, self.u, self.bcs, self.sides = [], [], [], [], []
        for i, cells in enumerate(n):
            low, high = np.array((-1 + 0.4 * i, i - 1.0)), np.array((1 - 0.4 * i, i))
            mesh, ft = meshes.block(
                comm, cells, lambda x, a=low, b=high: a + x * (b - a), cell=cell
            )
            self._add(mesh, ft)
        top = self.V[-1].mesh
        self.load = fem.Constant(top, default_scalar_type((0, 0)))
        if loaded:
            v = ufl.TestFunction(self.V[-1])
            self.F[-1] -= ufl.inner(self.load, v) * ufl.dx
        else:
            self._hold(-1, meshes.TOP, self.load)
        self._hold(0, meshes.BOTTOM, fem.Constant(self.V[0].mesh, default_scalar_type((0, 0))))

    def _add(self, mesh, ft):
        V = fem.functionspace(mesh, ("Lagrange", self.degree, (2,)))
        u, v = fem.Function(V), ufl.TestFunction(V)
        strain = ufl.sym(ufl.grad(u))
        hardening = 1 + 50 * ufl.inner(strain, strain)
        self.F.append(hardening * ufl.inner(strain, ufl.sym(ufl.grad(v))) * ufl.dx)
        self.V.append(V)
        self.u.append(u)
        self.sides.append([(V, ft.find(tag)) for tag in (meshes.BOTTOM, meshes.TOP)])
        self.ft = ft

    def _hold(self, i, tag, value):
        V, facets = self.sides[i][tag == meshes.TOP]
        self.bcs.append(fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, facets), V))

    def between(self, i):
        return self.sides[i][1], self.sides[i + 1][0]

    def move(self, step):
        self.load.value[:] = 0.004 * step**2, (-0.03, -0.05, -0.04, -0.06)[step]

    def moved(self):
        """After a load step."""


def contact(comm, sliding="finite", friction=0.3, *, scene=None, **options):
    scene = scene or Scene(comm)
    made = Contact(*scene.between(0), sliding=sliding, friction=friction, **options)
    scene.problem = ContactProblem(scene.F, scene.u, bcs=scene.bcs, contacts=[made])
    return scene


def tied(comm, *, scene=None, **options):
    scene = scene or Scene(comm)
    ties = [Tie(*scene.between(0), **options)]
    scene.problem = NonlinearTiedProblem(scene.F, scene.u, bcs=scene.bcs, ties=ties)
    return scene


def three(comm):
    """A tie that gives way below a contact with friction; a body that nothing else holds."""
    scene = Scene(comm, n=((5, 2), (4, 2), (3, 2)))
    law = fem.Constant(scene.V[0].mesh, default_scalar_type(2.0))
    tie = Tie(*scene.between(0), law=lambda jump, n: law * (1 + jump[0] ** 2) * jump)
    made = Contact(*scene.between(1), friction=0.3)
    problem = ContactProblem(scene.F, scene.u, bcs=scene.bcs, contacts=[made], ties=[tie])
    scene.problem, scene.moved = problem, lambda: law.value.__imul__(0.9)
    return scene


def obstacle(comm):
    """The lower block is rigid, and moved."""
    scene = Scene(comm)
    made = Contact(*scene.between(0), friction=0.3)
    F = [None, scene.F[1]]
    scene.problem = ContactProblem(F, scene.u, bcs=scene.bcs[:1], contacts=[made])
    rigid = scene.u[0].x.array
    scene.moved = lambda: rigid.reshape(-1, 2).__iadd__((0.003, 0.002))
    return scene


def time_loop(comm):
    """A block with mass that falls, is held by contact alone, and has a velocity."""
    scene = Scene(comm, loaded=True)
    u, v = scene.u[1], ufl.TestFunction(scene.V[1])
    last, velocity = fem.Function(scene.V[1]), fem.Function(scene.V[1])
    scene.F[1] += 2 * ufl.inner(u - last - velocity, v) * ufl.dx

    def moved():
        velocity.x.array[:] = u.x.array - last.x.array
        last.x.array[:] = u.x.array

    scene = contact(comm, scene=scene)
    scene.moved = moved
    return scene


def space(comm):
    scene = Scene.__new__(Scene)
    scene.V, scene.F, scene.u, scene.bcs, scene.sides = [], [], [], [], []
    for n, low, high in (
        ((3, 3, 2), (-1, -1, -1), (1, 1, 0)),
        ((2, 2, 2), (-0.6, -0.6, 0), (0.6, 0.6, 1)),
    ):
        mesh = create_box(comm, (low, high), n, CellType.tetrahedron)
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        u, v = fem.Function(V), ufl.TestFunction(V)
        strain = ufl.sym(ufl.grad(u))
        scene.F.append(ufl.inner((1 + ufl.tr(strain) ** 2) * strain, ufl.sym(ufl.grad(v))) * ufl.dx)
        at = [
            locate_entities_boundary(mesh, 2, lambda x, z=z: np.isclose(x[2], z))
            for z in (low[2], high[2])
        ]
        scene.sides.append([(V, facets) for facets in at])
        scene.V.append(V)
        scene.u.append(u)
    scene.load = fem.Constant(scene.V[1].mesh, (0.0, 0.0, 0.0))
    held = fem.Constant(scene.V[0].mesh, (0.0, 0.0, 0.0))
    for (V, facets), value in ((scene.sides[0][0], held), (scene.sides[1][1], scene.load)):
        scene.bcs.append(fem.dirichletbc(value, fem.locate_dofs_topological(V, 2, facets), V))

    def move(step):
        scene.load.value[:] = 0.01 * step, 0.004 * step**2, (-0.03, -0.05, -0.04, -0.06)[step]

    scene.move, scene.moved = move, lambda: None
    return contact(comm, scene=scene, elastic_slip=2e-3)


SCENES = {
    "no friction": lambda comm: contact(comm, friction=None),
    "friction": contact,
    "elastic slip": lambda comm: contact(comm, elastic_slip=3e-3),
    "small sliding": lambda comm: contact(comm, "small"),
    "compliance": lambda comm: contact(comm, compliance=0.1),
    "degree 2": lambda comm: contact(comm, scene=Scene(comm, degree=2, cell="triangle")),
    "three bodies": three,
    "obstacle": obstacle,
    "time loop": time_loop,
    "space": space,
    "tie": tied,
    "tie with a law": lambda comm: tied(comm, law=lambda jump, n: (2 + jump[1] ** 2) * jump),
    "tie, degree 3": lambda comm: tied(
        comm, scene=Scene(comm, degree=3, cell="triangle"), interior="free"
    ),
}


def run(comm, name, file, *, goes_on=False):
    """Displacements after four load steps, on rank 0: in one go, or the last two from a file."""
    scene = SCENES[name](comm)
    problem = scene.problem
    if goes_on:
        problem.restore(State.load(file, comm))
    for step in range(2 * goes_on, 4):
        scene.move(step)
        problem.solve()
        scene.moved()
        if step == 1:
            problem.state().save(file)
    found = [InputOrder(u.function_space).gathered(u.x.array) for u in scene.u]
    return None if comm.rank else np.concatenate([part.ravel() for part in found])


@two_ranks(name=["elastic slip", "tie with a law", *["three bodies", "time loop"] * thorough])
@pytest.mark.parametrize("name", SCENES)
def test_goes_on(name, tmp_path):
    """Another problem goes on; on two ranks also what one rank began, and the reverse."""
    file = Path(comm.bcast(tmp_path)) / "state.npz"
    expected = run(comm, name, file)
    found = run(comm, name, file, goes_on=True)
    if comm.rank == 0:
        close(found, expected, 1e-12)
    if comm.size == 1:
        return
    # On each rank the same, though rank 0's would do: names in messages are numbers of objects
    found = run(MPI.COMM_SELF, name, file, goes_on=True)
    if comm.rank == 0:
        close(found, expected, 1e-12)
    expected = run(MPI.COMM_SELF, name, file.with_name(f"state{comm.rank}.npz"))
    comm.barrier()
    found = run(comm, name, file.with_name("state0.npz"), goes_on=True)
    if comm.rank == 0:
        close(found, expected, 1e-12)


def test_another_process(tmp_path):
    """The next day."""
    file = tmp_path / "state.npz"
    expected = run(MPI.COMM_SELF, "elastic slip", file)
    script = (
        "from test_state import *\n"
        f"found = run(comm, 'elastic slip', {str(file)!r}, goes_on=True)\n"
        f"np.save({str(tmp_path / 'found.npy')!r}, found)\n"
    )
    folder = Path(__file__).parent
    paths = [str(folder), str(folder.parent), str(folder.parents[1]), *sys.path]
    code = f"import sys; sys.path[:0] = {paths!r}\n{script}"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=200)
    close(np.load(tmp_path / "found.npy"), expected, 1e-12)
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["found.npy", "state.npz"]


@pytest.mark.ranks(2)
def test_back():
    """A problem goes back, and then the same way; also where the load step is halved."""
    scene = contact(comm, elastic_slip=3e-3)
    problem, (made,) = scene.problem, scene.problem.contacts
    scene.move(0)
    problem.solve()
    state = problem.state()
    force, energy = made.force(problem), made.dissipation(problem)
    newton, ends = problem._newton, []

    def fails_once(*args, **options):
        if len(ends) % 2 == 0:
            ends.append(None)
            raise SolveError("not yet")
        return newton(*args, **options)

    for _ in range(2):
        scene.move(2)
        problem._newton = fails_once
        problem.solve()
        assert problem.halvings == 1
        ends.append([u.x.array.copy() for u in scene.u])
        problem.restore(state)
        close(made.force(problem), force, 1e-12)
        assert made.dissipation(problem) == energy
        assert np.array_equal(scene.load.value, (0, -0.03))
    for one, two in zip(ends[1], ends[3], strict=True):
        close(two, one, 1e-12)


@pytest.mark.ranks(2)
def test_wrong_states(tmp_path):
    """States that don't fit are told in one line, and nothing has changed."""
    file = Path(comm.bcast(tmp_path)) / "state.npz"
    scene = contact(comm)
    problem = scene.problem
    scene.move(0)
    problem.solve()
    before = [u.x.array.copy() for u in scene.u]
    with raises(
        ValueError, r"restore takes a State, of problem.state\(\) or State.load.*, not a str"
    ):
        problem.restore(str(file))
    with raises(OSError, "no state is read from .*state.npz: No such file"):
        State.load(file, comm)
    if comm.rank == 0:
        file.write_bytes(b"nothing")
    comm.barrier()
    with raises(OSError, "state.npz is no state of a problem"):
        State.load(file, comm)
    if comm.rank == 0:
        np.savez(file, a=1)
    with raises(OSError, "state.npz is no state of a problem"):
        State.load(file, comm)
    with raises(OSError, "no state is written to .*nowhere/state.npz: No such file"):
        problem.state().save(file.parent / "nowhere" / "state.npz")
    others = (
        (tied(comm), "is one of a NonlinearTiedProblem, not of a ContactProblem"),
        (contact(comm, friction=None), "the problem has contact 0/dissipated"),
        (contact(comm, scene=Scene(comm, n=((5, 3), (5, 3)))), "of another problem"),
    )
    for other, message in others:
        with raises(ValueError, message):
            problem.restore(other.problem.state())
    moved = Scene(comm)
    moved.V[0].mesh.geometry.x[:, 0] += 1e-3
    with raises(ValueError, "is of another mesh than body 0, or .* in another order"):
        problem.restore(contact(comm, scene=moved).problem.state())
    assert all(np.array_equal(u.x.array, b) for u, b in zip(scene.u, before))
    problem.destroy()
    for call in (problem.state, lambda: problem.restore(None)):
        with raises(ValueError, "the problem was destroyed"):
            call()
