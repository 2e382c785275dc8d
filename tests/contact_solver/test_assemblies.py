# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contacts that end at ties, supports or other contacts, chains, one mesh with several contacts."""

from mpi4py import MPI

import numpy as np
import pytest
from assembly import Body, dense, rectangle
from test_contact_bodies import UNIAXIAL, Assembly

import dolfinx
import meshes
from dolfinx import fem
from dolfinx.mesh import CellType, GhostMode
from hypergap_dolfinx import Contact, ContactProblem, SolveError, Tie

comm = MPI.COMM_WORLD
PRESSURE = 0.05


def left(x):
    return x[:, 0] < 1


def right(x):
    return x[:, 0] > 1


def piece(scene, i, tag, inside):
    """A part of a face of a body."""
    body = scene.bodies[i]
    facets = body.facets(tag)
    return body.V, facets[inside(dolfinx.mesh.compute_midpoints(body.mesh, 1, facets))]


def two(n):
    """A block on another one between walls, pressed."""
    scene = Assembly([rectangle((k, 2), (0, y), (2, y + 1)) for k, y in zip(n, (-1, 0))])
    scene.hold(0, 1, meshes.BOTTOM)
    for i in (0, 1):
        scene.hold(i, 0, meshes.LEFT, meshes.RIGHT)
    scene.load(1, meshes.TOP).value = PRESSURE
    return scene


def three(n):
    """Two blocks side by side on another one, between walls, pressed."""
    low, high = ((0, -1), (0, 0), (1, 0)), ((2, 0), (1, 1), (2, 1))
    cells = (2 * n[0], 2), (n[1], 2), (n[1], 2)
    scene = Assembly([rectangle(*body) for body in zip(cells, low, high, strict=True)])
    scene.hold(0, 1, meshes.BOTTOM)
    for i, tags in enumerate(((meshes.LEFT, meshes.RIGHT), (meshes.LEFT,), (meshes.RIGHT,))):
        scene.hold(i, 0, *tags)
    for i in (1, 2):
        scene.load(i, meshes.TOP).value = PRESSURE
    return scene


def sides(scene, inside):
    return piece(scene, 0, meshes.TOP, inside), piece(scene, 1, meshes.BOTTOM, inside)


def beside_a_tie(n, swap):
    scene, order = two(n), slice(None, None, -1 if swap else 1)
    return scene, [Contact(*sides(scene, right)[order])], [Tie(*sides(scene, left)[order])]


def in_pieces(n, swap):
    scene, order = two(n), slice(None, None, -1 if swap else 1)
    return scene, [Contact(*sides(scene, half)[order]) for half in (left, right)], []


def above_two(n, swap, tied):
    """Contact of one body with two that are tied or in contact with each other."""
    scene = three(n)
    faces = scene.side(1, meshes.RIGHT), scene.side(2, meshes.LEFT)
    top = scene.side(0, meshes.TOP)
    halves = piece(scene, 0, meshes.TOP, left), piece(scene, 0, meshes.TOP, right)
    above = [scene.side(i, meshes.BOTTOM) for i in (1, 2)]
    pairs = zip(above, halves, strict=True) if swap else ((top, side) for side in above)
    contacts = [Contact(*pair) for pair in pairs]
    return (scene, contacts, [Tie(*faces)]) if tied else (scene, [*contacts, Contact(*faces)], [])


SCENES = {
    "tie": beside_a_tie,
    "pieces": in_pieces,
    "two tied bodies": lambda n, swap: above_two(n, swap, True),
    "three bodies": lambda n, swap: above_two(n, swap, False),
}


def least(problem):
    """The smallest singular value of the rows of contacts and ties, of length 1."""
    spaces = [u.function_space for u in problem.u]
    sizes = [V.dofmap.index_map.size_global * V.dofmap.index_map_bs for V in spaces]
    starts = np.cumsum([0, *sizes])
    every = []
    for rows in problem._rows:
        body, number = rows.unknowns
        use = rows.state.active[rows.C.i] & (body[rows.C.j] >= 0)
        i, j, values = rows.C.i[use], rows.C.j[use], rows.C.values[use]
        every.append(np.zeros((len(rows.g), starts[-1])))
        np.add.at(every[-1], (i, starts[body[j]] + number[j]), values)
    for line in problem._constraints.free:
        parts = [B and dense(B) for B in line]
        num = next(len(B) for B in parts if B is not None)
        parts = [np.zeros((num, k)) if B is None else B for k, B in zip(sizes, parts, strict=True)]
        every.append(np.hstack(parts))
    rows = np.vstack(every)
    rows = rows[np.linalg.norm(rows, axis=1) > 0]
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    return np.linalg.svd(rows, compute_uv=False).min()


@pytest.mark.ranks(2, name=["two tied bodies"], swap=[True])
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("name", SCENES)
def test_full_rank(name, swap):
    """One pressure, with no constraint too many where contact ends at another interface.

    Meshes match: others hide it.
    """
    scene, contacts, ties = SCENES[name]((4, 4), swap)
    problem = scene.problem(contacts, ties, rtol=1e-12)
    problem.solve()
    assert problem.iterations <= 2
    for contact in contacts[:2]:  # the third one is between the upper ones
        np.testing.assert_allclose(contact.pressures(problem), PRESSURE, rtol=1e-10)
    if comm.size == 1:
        assert least(problem) >= 0.2


@pytest.mark.parametrize(
    "kind, force, sinks", (("held", 0.0340176, 0.0292282), ("tie", 0.0111444, None))
)
def test_against_fine_mesh(kind, force, sinks):
    """Contact up to a support of both bodies, and up to a tie beside which the bodies part.

    Values are those of cells a quarter as large; beside the tie displacements are those of a crack.
    """
    scene = Assembly([rectangle((16, 8), (0, -1), (2, 0)), rectangle((20, 8), (0, 0), (2, 0.5))])
    for component in (0, 1):
        scene.hold(0, component, meshes.BOTTOM)
        for i in (0, 1) if kind == "held" else ():
            scene.hold(i, component, meshes.LEFT)
    scene.load(1, meshes.TOP if kind == "held" else meshes.RIGHT).value = 0.02
    contact = Contact(*sides(scene, right if kind == "tie" else lambda x: x[:, 0] < 9))
    problem = scene.problem([contact], [Tie(*sides(scene, left))] if kind == "tie" else [])
    problem.solve()
    assert abs(contact.force(problem)[1] / force - 1) <= 2e-3
    assert 2 < contact.active.sum() < len(contact.active)
    if sinks:
        u = scene.u[1]
        assert abs(u.x.array.min() / -sinks - 1) <= 2e-3


@pytest.mark.ranks(2)
def test_rigid_floor_in_pieces():
    """Two contacts with one rigid body, that share a vertex of Γ1."""
    scene = two((4, 4))
    contacts = [Contact(*sides(scene, half)) for half in (left, right)]
    problem = ContactProblem([None, scene.F[1]], scene.u, bcs=scene.bcs[2:], contacts=contacts)
    problem.solve()
    for contact in contacts:
        np.testing.assert_allclose(contact.pressures(problem), PRESSURE, rtol=1e-10)


@pytest.mark.ranks(2)
def test_chain():
    """Ten bodies on each other, of which contact alone holds nine: one pressure."""
    moduli = np.resize((1.0, 3.0, 0.5), 10)
    scene = Assembly(
        [
            rectangle((3 + i % 3, 1), (0, i), (2, i + 1 - 1e-3), E=E)
            for i, E in enumerate(moduli.tolist())
        ]
    )
    for i in range(10):
        scene.hold(i, 0, meshes.LEFT, meshes.RIGHT)
    scene.hold(0, 1, meshes.BOTTOM)
    scene.load(9, meshes.TOP).value = PRESSURE
    pairs = [(scene.side(i, meshes.TOP), scene.side(i + 1, meshes.BOTTOM)) for i in range(9)]
    contacts = [Contact.between(*pair) for pair in pairs]
    problem = scene.problem(contacts, rtol=1e-12)
    problem.solve()
    assert problem.iterations <= 8 and problem.halvings == 0
    for contact in contacts:
        np.testing.assert_allclose(contact.pressures(problem), PRESSURE, rtol=1e-9)
    top = comm.allreduce(scene.u[9].x.array.min(initial=0), MPI.MIN)
    sinks = 9e-3 + (1 - 1e-3) * PRESSURE / UNIAXIAL * (1 / moduli).sum()
    assert abs(top + sinks) <= 1e-9


def comb():
    """One mesh that is open on the right at two heights; its slots' sides have tags 11 to 14."""
    whole = dolfinx.mesh.create_rectangle(
        comm, [(0, 0), (4, 5)], (8, 10), CellType.quadrilateral, ghost_mode=GhostMode.none
    )
    cells = np.arange(whole.topology.index_map(2).size_local, dtype=np.int32)
    x, y = dolfinx.mesh.compute_midpoints(whole, 2, cells)[:, :2].T
    slot = (np.abs(y - 1.75) < 0.25) | (np.abs(y - 3.25) < 0.25)
    mesh = dolfinx.mesh.create_submesh(whole, 2, cells[(x < 1) | ~slot])[0]
    z = mesh.geometry.x
    heights = (0, 1.5, 2.0, 3.0, 3.5, 5)
    now = (0, 1.5, 1.52, 2.52, 2.54, 4.04)
    z[:, 1] = np.interp(z[:, 1], heights, now)
    tags = []
    for tag, inside in (
        (meshes.BOTTOM, lambda x: np.isclose(x[1], 0)),
        (meshes.TOP, lambda x: np.isclose(x[1], now[-1])),
        *(
            (11 + k, lambda x, y=y: np.isclose(x[1], y) & (x[0] > 1 - 1e-6))
            for k, y in enumerate(now[1:5])
        ),
    ):
        facets = dolfinx.mesh.locate_entities_boundary(mesh, 1, inside)
        tags += [(facet, tag) for facet in facets]
    indices, values = np.array(sorted(tags), dtype=np.int32).reshape(-1, 2).T
    ft = dolfinx.mesh.meshtags(mesh, 1, indices, values)
    return Body(mesh, ft, fem.functionspace(mesh, ("Lagrange", 1, (2,))))


@pytest.mark.ranks(2)
def test_one_mesh_with_several_contacts():
    """A symmetric comb that is pressed from both sides: both slots close alike."""
    scene = Assembly([comb()])
    for component in (0, 1):
        scene.hold_at(0, component, lambda x: np.isclose(x[0], 0) & (np.abs(x[1] - 2.02) < 0.1))
    down, up = scene.hold(0, 1, meshes.TOP), scene.hold(0, 1, meshes.BOTTOM)
    down.value, up.value = -0.03, 0.03
    contacts = [Contact(scene.side(0, a), scene.side(0, b)) for a, b in ((11, 12), (14, 13))]
    problem = scene.problem(contacts)
    problem.solve()
    found = []
    for contact in contacts:
        order = np.argsort(contact.surfaces[1].x[:, 0])
        found.append(contact.pressures(problem)[order])
        assert 2 <= contact.active.sum() < len(order)
    np.testing.assert_allclose(*found, atol=1e-10)
    assert abs(contacts[0].force(problem)[1]) > 1e-3


def test_jumps_that_change_unseen(monkeypatch):
    """Without a value that is known to change, a message names jumps that may have changed."""

    def fails(*_):
        raise SolveError("it fails.")

    monkeypatch.setattr(ContactProblem, "_newton", fails)
    for jump, words in ((lambda x: 0 * x[:2], "functions of x aren't seen"), (None, "")):
        scene = two((2, 3))
        tie = Tie(*sides(scene, left), jump=jump)
        problem = scene.problem([Contact(*sides(scene, right))], [tie])
        with pytest.raises(SolveError, match="no value has changed") as told:
            problem.solve()
        assert words in str(told.value) and ("jumps" in str(told.value)) == bool(words)
