# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Load steps that start from displacements that go on as in the last one."""

from mpi4py import MPI

import numpy as np
import pytest
from assembly import Elastic, lame_constants
from helpers import two_ranks

import basix.ufl
import dolfinx
import meshes
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem import petsc
from hypergap_dolfinx import Contact, ContactProblem, InterfaceError
from hypergap_dolfinx.algebra.displacement import DisplacementField
from hypergap_dolfinx.contact_solver.contact_rows import ContactRows
from hypergap_dolfinx.contact_solver.predictor import Extrapolation
from hypergap_dolfinx.surface.component import Component

comm = MPI.COMM_WORLD


@pytest.mark.ranks(3)
@pytest.mark.parametrize(
    ("load", "share"),
    (
        ((1, 2, 3e9), 1),
        ((2, 4, 6e9), 1),  # as far as the last one at most
        ((0.5, 1, 1.5e9), 0.5),
        ((1, 2, 0), 0.5),  # one of two goes on, in whatever units
        ((-1, -2, -3e9), 0),
        ((2, -1, 0), 0),  # across
        ((0, 0, 0), 0),
    ),
)
def test_share(load, share):
    """The share is the projection on the last load, the same on any number of ranks."""
    last, mine = Extrapolation(comm), slice(None) if comm.rank == 0 else slice(0)

    def values(load):
        """A vector whose numbers all ranks have, and a constant, which the first rank has."""
        load = np.array(load, dtype=float)
        return [load[:2] / (comm.rank + 1), load[2:][mine]]

    start, end = [np.ones(3)], [np.array((1, 3, comm.rank))]
    assert last.changes(values(load), start) is None
    last.remember(values((1, 2, 3e9)), start, end, in_contact=False)
    found = last.changes(values(load), end)
    if share:
        np.testing.assert_allclose(found[0], share * (end[0] - start[0]), 1e-14)
    else:
        assert found is None
    # One rank's unknowns were set by a user
    assert last.changes(values(load), [end[0] + (comm.rank == comm.size - 1)]) is None
    last.forget()
    assert last.changes(values(load), end) is None


def blocks(thickness=0.5):
    """Meshes of a block and of a slender beam above it, with tags of facets."""
    low = (1, -thickness), (1, thickness)
    return [
        meshes.block(comm, n, lambda x, at=at, size=size: x * size + at, cell="quadrilateral")
        for n, at, size in (((6, 3), *low), ((60, 2), (0, 0.35), (2, 0.05)))
    ]


def lower(num, thickness=0.5, *, halvings=0):
    """Lower a clamped beam onto a block in even load steps: Newton steps of each, and the force."""
    u, F, bcs, sides, counts = [], [], [], [], []
    parts = blocks(thickness)
    goal = fem.Constant(parts[1][0], default_scalar_type((0, 0)))
    for i, (mesh, ft) in enumerate(parts):
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body = Elastic.on(V, lame_constants(1.0), large=True)
        u.append(body.u)
        F.append(body.F)
        away = fem.locate_dofs_topological(V, 1, ft.find(meshes.LEFT))
        value = goal if i else default_scalar_type((0, 0))
        bcs.append(fem.dirichletbc(value, away, V))
        faces = [ft.find(tag) for tag in (meshes.BOTTOM, meshes.TOP)]
        sides.append((V, np.sort(np.concatenate(faces))))
    contact = Contact.between(*sides)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    for down in np.linspace(0, 0.5, num + 1)[1:]:
        goal.value[:] = 0.2 * down, -down
        problem.solve()
        counts.append(problem.iterations)
        assert problem.halvings <= halvings
    return counts, contact.force(problem)


@pytest.mark.ranks(2)
def test_no_steps_before_contact(monkeypatch):
    """A slender body that is moved without contact needs no Newton steps but in the first step."""
    counts, force = lower(5)
    monkeypatch.setattr(Extrapolation, "changes", lambda *args: None)
    without, same = lower(5)
    assert counts[1:3] == [0, 0] and min(without) >= 1 and counts[3:] == without[3:]
    np.testing.assert_allclose(force, same, 1e-6 * np.linalg.norm(same))


@pytest.mark.ranks(2)
@pytest.mark.parametrize("num", (2, 3, 4))
def test_not_through_a_thin_body(num):
    """A start beyond a strip that is as thick as the beam, without an overlap there, isn't one."""
    counts, force = lower(num, 0.05)
    assert counts[-1] >= 2 and force[1] > 1e-6


@pytest.mark.ranks(2)
def test_not_through_a_thin_body_in_one_load_step():
    """Nothing overlaps after the load step, but it led through the strip: it is halved."""
    _, force = lower(1, 0.05, halvings=6)
    _, slow = lower(20, 0.05, halvings=6)
    np.testing.assert_allclose(force, slow, 0.05)


@two_ranks()
@pytest.mark.parametrize("moved", (0, 1))
def test_not_through_a_plate(moved):
    """In space, a block that users move through a clamped plate, with all of their facets."""
    u, F, bcs, sides = [], [], [], []
    for i, (n, size, low) in enumerate(
        (((4, 2, 1), (2, 1, 0.1), (0, 0, 0)), ((1, 1, 1), (0.6, 1.2, 0.1), (0.7, -0.1, 0.12)))
    ):
        mesh, ft = meshes.block(comm, n, lambda x, s=size, a=low: x * s + a, cell="hexahedron")
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        body = Elastic.on(V, lame_constants(1.0), large=True)
        u.append(body.u)
        F.append(None if i else body.F)
        sides.append((V, np.sort(ft.indices)))
        if not i:
            ends = np.concatenate([ft.find(tag) for tag in (meshes.LEFT, meshes.RIGHT)])
            clamped = fem.locate_dofs_topological(V, 2, np.sort(ends))
            bcs.append(fem.dirichletbc(default_scalar_type((0, 0, 0)), clamped, V))
    contact = Contact(*sides[:: 1 - 2 * moved])
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    u[1].interpolate(lambda x: np.outer((0, 0, -0.25), np.ones(x.shape[1])))
    problem.solve()
    force = contact.force(problem, on=u[0])[2]
    assert problem.halvings and force == pytest.approx(-8.1e-3, rel=0.02)  # 0 if it went through


def flat(sizes, moves, held, *, rigid=False):
    """Two blocks with all of their facets in contact; the second one is moved in load steps.

    Args:
        sizes: Cells, size, lower corner and stiffness of each.
        moves: Displacements of the second one's upper end, or of all of it if it is rigid.
        held: Tags of the first one's fixed ends.
    """
    u, F, bcs, sides = [], [], [], []
    for i, (n, size, low, stiffness) in enumerate(sizes):
        mesh, ft = meshes.block(comm, n, lambda x, s=size, a=low: x * s + a, cell="quadrilateral")
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body = Elastic.on(V, lame_constants(stiffness), large=True)
        tags = (meshes.TOP,) if i else held
        ends = fem.locate_dofs_topological(V, 1, np.sort(np.concatenate(list(map(ft.find, tags)))))
        goal = body.u if rigid and i else fem.Function(V)
        bcs += [] if rigid and i else [fem.dirichletbc(goal, ends)]
        u.append(body.u)
        F.append(None if rigid and i else body.F)
        sides.append((V, np.sort(ft.indices)))
    contact = Contact(*sides)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    for move in moves:
        goal.interpolate(lambda x, move=move: np.outer(move, np.ones(x.shape[1])))
        problem.solve()
        yield problem


@pytest.mark.ranks(2)
def test_slides_past_an_end():
    """The end of a plate sweeps over what was pressed down, or will be: nothing is passed."""
    sizes = ((10, 6), (1, 0.5), (0, 0), 1.0), ((12, 1), (2, 0.05), (-0.5, 0.51), 1.0)
    moves = (0, -0.02), (0.9, -0.02), (-0.9, -0.02)
    solved = flat(sizes, moves, (meshes.BOTTOM,), rigid=True)
    assert [problem.halvings for problem in solved] == [0, 0, 0]


@pytest.mark.ranks(2)
def test_corners_in_a_strip_are_told(caplog):
    """A single cell presses its corners deep into a strip, though its mean gaps are 0."""
    sizes = ((6, 1), (1, 0.04), (0, -0.04), 20.0), ((1, 1), (0.2, 0.2), (0.33, 0.01), 3.0)
    told = [
        sum("more than half of the way through" in line for line in caplog.messages)
        for _ in flat(sizes, ((0, -0.02), (0, -0.1), (0, -0.1)), (meshes.LEFT, meshes.RIGHT))
    ]
    assert told == ([0, 1, 1] if comm.rank == 0 else [0, 0, 0])


@pytest.mark.ranks(2)
def test_way_without_gaps(monkeypatch):
    """Where the way of a start has no gaps to look at, load steps start where the bodies are."""

    def refused(self):
        raise InterfaceError("no Σ here")

    monkeypatch.setattr(ContactRows, "overlaps", property(refused))
    counts, force = lower(5)
    monkeypatch.setattr(Extrapolation, "changes", lambda *args: None)
    without, same = lower(5)
    assert counts == without
    np.testing.assert_allclose(force, same, 1e-9)


@pytest.mark.ranks(2)
def test_start_with_inverted_cells(monkeypatch):
    """A start that leads too far is shortened, not the load step."""
    changes, called = Extrapolation.changes, []

    def too_far(self, load, now):
        found = changes(self, load, now)
        if found:  # the block is turned over along y
            V = fem.functionspace(blocks()[0][0], ("Lagrange", 1, (2,)))
            y = V.tabulate_dof_coordinates()[: len(now[0]) // 2, 1]
            found[0] = np.column_stack((0 * y, -1.2 * (y + 0.5))).ravel()
            called.append(True)
        return found

    monkeypatch.setattr(Extrapolation, "changes", too_far)
    counts, _ = lower(5)
    assert called and max(counts) <= 8


def boxes(together):
    """A box above a wider one: one mesh of two parts, or two meshes."""
    corners, cells, num = [], [], 0
    for low, high, n in (
        ((0, 0, 0), (3, 1.5, 1), (5, 2, 1)),
        ((0.7, 0.3, 1.05), (1.7, 1.1, 1.85), (3, 2, 1)),
    ):
        lines = [np.linspace(*ends) for ends in zip(low, high, np.add(n, 1), strict=True)]
        corners.append(np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3))
        number = np.arange(len(corners[-1])).reshape(np.add(n, 1)) + num * together
        of_cells = [
            number[i : n[0] + i, j : n[1] + j, k : n[2] + k].ravel()
            for k, j, i in np.ndindex(2, 2, 2)
        ]
        cells.append(np.column_stack(of_cells).astype(np.int64))
        num += len(corners[-1])
    if together:
        corners, cells = [np.vstack(corners)], [np.vstack(cells)]
    mine = slice(None) if comm.rank == 0 else slice(0)
    element = basix.ufl.element("Lagrange", "hexahedron", 1, shape=(3,))
    return [
        dolfinx.mesh.create_mesh(comm, part[mine], e=element, x=x[mine])
        for x, part in zip(corners, cells, strict=True)
    ]


@pytest.mark.ranks(2)
@pytest.mark.parametrize(
    ("upper", "solver"), ((1.0, "direct"), (1e7, "direct"), (1e4, "iterative"))
)
def test_parts_of_one_mesh(upper, solver):
    """Two parts of one mesh press, stick and slip as two meshes do."""
    found = []
    for together in (False, True):
        parts = boxes(together)
        V = [fem.functionspace(mesh, ("Lagrange", 1, (3,))) for mesh in parts]
        u, F = [fem.Function(W) for W in V], []
        for w in u:
            v = ufl.TestFunction(w.function_space)
            z = ufl.SpatialCoordinate(w.function_space.mesh)[2]
            eps = ufl.sym(ufl.grad(w))
            sigma = ufl.conditional(z < 1.02, 1.0, upper) * (eps + ufl.tr(eps) * ufl.Identity(3))
            F.append(ufl.inner(sigma, ufl.grad(v)) * ufl.dx)

        def side(i, z):
            i = min(i, len(V) - 1)
            at = dolfinx.mesh.locate_entities_boundary(V[i].mesh, 2, lambda x: np.isclose(x[2], z))
            return V[i], at

        moved = fem.Constant(parts[-1], default_scalar_type((0, 0, 0)))
        bcs = [
            fem.dirichletbc(value, fem.locate_dofs_topological(W, 2, at), W)
            for (W, at), value in (
                (side(0, 0), np.zeros(3, dtype=default_scalar_type)),
                (side(1, 1.85), moved),
            )
        ]
        contact = Contact(side(1, 1.05), side(0, 1), friction=0.3)
        problem = ContactProblem(F, u, bcs=bcs, contacts=[contact], solver=solver)
        for goal in ((0, 0, -0.08), (0.08, 0.03, -0.1)):
            moved.value[:] = goal
            problem.solve()
            assert problem.solver_name == solver
        order = np.lexsort(contact.surfaces[1].x.round(6).T)
        slips = contact.slips(problem)[order]
        pressures, depth = contact.pressures(problem)[order], contact.geometry.depth
        found.append((slips, pressures, problem.iterations, depth))
    slips, pressures, num, depth = zip(*found, strict=True)
    assert abs(slips[0]).max() > 0.01
    np.testing.assert_allclose(slips[1], slips[0], atol=1e-8)
    np.testing.assert_allclose(pressures[1], pressures[0], atol=1e-6 * pressures[0].max())
    assert num[1] <= num[0] + 1
    np.testing.assert_allclose(depth[1], depth[0])


@pytest.mark.ranks(2)
def test_stiffness_of_parts():
    """Mean diagonal of the softest part, without prescribed rows; a rank may have no node of it."""
    (mesh,) = boxes(True)
    for V in (
        fem.functionspace(mesh, ("Lagrange", 1, (3,))),
        fem.functionspace(meshes.block(comm, (1, 1))[0], ("Lagrange", 1, (2,))),  # on one rank
    ):
        field = DisplacementField(Component.of(V), V)
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        last = ufl.SpatialCoordinate(V.mesh)[V.mesh.geometry.dim - 1]
        form = ufl.conditional(last < 1.02, 7.0, 2.0) * ufl.inner(u, v) * ufl.dx
        K = petsc.assemble_matrix(fem.form(form))
        K.assemble()
        diagonal = K.getDiagonal().array.real.reshape(-1, V.mesh.geometry.dim)
        height = V.tabulate_dof_coordinates()[: len(diagonal), V.mesh.geometry.dim - 1]
        held = height > 1.8
        soft = (height > 1.02) if V.mesh is mesh else np.ones(len(height), dtype=bool)
        mine = diagonal[soft & ~held]
        mean = comm.allreduce(mine.sum()) / comm.allreduce(mine.size)
        found = field.stiffness(K, np.repeat(held, V.mesh.geometry.dim))
        np.testing.assert_allclose(found, mean, 1e-12)
        K.destroy()
