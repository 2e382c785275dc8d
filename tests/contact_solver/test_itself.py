# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One surface against itself: the same as two that were told apart."""

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
from assembly import Elastic
from helpers import close, raises, ranks_at_last, sweep, thorough, two_ranks

import meshes
from dolfinx import default_scalar_type, fem
from dolfinx import mesh as meshing
from dolfinx.mesh import compute_midpoints
from hypergap_dolfinx import Contact, ContactProblem, InterfaceError
from hypergap_dolfinx.contact_geometry.rays import own_of
from hypergap_dolfinx.contact_geometry.space import SpaceSegments
from hypergap_dolfinx.surface.moving import MovingSurface
from hypergap_dolfinx.surface.trace import create_surface

comm = MPI.COMM_WORLD
SAME = 1e-11  # of displacements: the same equations, up to 2e-15 apart


def pressed(mesh, V, sides, held, moved, ways, **options):
    """A body with facets that are held, and others that are moved step by step."""
    body, n = Elastic.on(V, large=True), mesh.geometry.dim
    value, zero = (fem.Constant(mesh, default_scalar_type((0.0,) * n)) for _ in range(2))
    bcs = [
        fem.dirichletbc(g, fem.locate_dofs_topological(V, n - 1, facets), V)
        for g, facets in ((zero, held), (value, moved))
    ]
    contact = Contact(*sides, **options)
    problem = ContactProblem([body.F], [body.u], bcs=bcs, contacts=[contact], rtol=1e-12)
    for way in ways:
        value.value[:] = way
        problem.solve()
    return SimpleNamespace(u=body.u, contact=contact, problem=problem)


def hairpin(s):
    """A strip around a bend: legs of length 2 at y = ∓0.5, thickness 0.25."""
    leg, r = 2.0, 0.5
    along, off = (2 * leg + np.pi * r) * s[:, 1], r + 0.25 * (s[:, 0] - 0.5)
    angle = np.clip((along - leg) / r, 0, np.pi)
    x = np.maximum(leg - along, 0) + np.maximum(along - leg - np.pi * r, 0)
    return np.column_stack((x - off * np.sin(angle), -off * np.cos(angle), s[:, 2:]))


@two_ranks(degree=[1, 2] if thorough else [1])
@pytest.mark.parametrize("degree", sweep([1, 2], 2))
def test_hairpin(degree):
    """Legs that meet, friction between them: with the bend, and with all of the outline."""
    mesh, tags = meshes.block(comm, (2, 48), hairpin, degree=degree)
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    inner, outer = tags.find(meshes.LEFT), tags.find(meshes.RIGHT)
    every = np.sort(np.concatenate([tags.find(k) for k in np.unique(tags.values)]))
    x, at = compute_midpoints(mesh, 1, inner), compute_midpoints(mesh, 1, outer)
    legs = [inner[(x[:, 0] > 0) & (x[:, 1] * sign > 0)] for sign in (-1, 1)]
    ends = [outer[(at[:, 0] > 1.2) & (at[:, 1] * sign > 0)] for sign in (-1, 1)]
    ways = [(0.0, -0.6), (0.0, -0.8), (0.02, -0.85)]
    told, *found = (
        pressed(mesh, V, [(V, a), (V, b)], *ends, ways, friction=0.3)
        for a, b in (legs, (inner, inner), (every, every))
    )
    assert told.contact.active.any()
    for one in found:
        assert one.contact.geometry.itself and one.contact.active.sum() == told.contact.active.sum()
        close(one.u.x.array, told.u.x.array, SAME)
        for leg, sign in zip(legs, (-1, 1), strict=True):
            force = one.contact.force(one.problem, facets=leg)
            close(force, sign * told.contact.force(told.problem), 1e-9)
            about = one.contact.moment(one.problem, (0.3, 0.1), facets=leg)
            close(about, sign * told.contact.moment(told.problem, (0.3, 0.1)), 1e-9)
        with raises(ValueError, "one surface, on which all forces cancel: give facets="):
            one.contact.force(one.problem)
    with raises(ValueError, "both sides are on this body: give facets="):
        told.contact.force(told.problem, on=told.u)
    with raises(ValueError, "no facet in facets= is on the contact's surface"):
        told.contact.force(told.problem, facets=np.setdiff1d(every, inner))  # they share nodes


def test_ring():
    """A ring that is pinched flat, by which of its halves ever meets the other."""
    mesh, tags = meshes.ring_sector(comm, 64, 2, 0.85, 1.0, angle=2 * np.pi)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    inner, outer = tags.find(meshes.INNER), tags.find(meshes.OUTER)
    x, at = compute_midpoints(mesh, 1, inner), compute_midpoints(mesh, 1, outer)
    halves = [inner[x[:, 1] * sign > 0] for sign in (1, -1)]
    ends = [outer[(np.abs(at[:, 0]) < 0.3) & (at[:, 1] * sign > 0)] for sign in (-1, 1)]
    ways = [(0.0, -down) for down in (0.5, 1.0, 1.4, 1.7, 1.75)]
    told, found = (
        pressed(mesh, V, [(V, a), (V, b)], *ends, ways) for a, b in (halves, (inner, inner))
    )
    assert found.contact.active.any()
    close(found.u.x.array, told.u.x.array, 0.01)
    close(
        found.contact.force(found.problem, facets=halves[1]), told.contact.force(told.problem), 0.02
    )


@ranks_at_last(cell=["hexahedron"], degree=[1])
@pytest.mark.parametrize(
    ("cell", "degree", "cells"),
    [
        ("hexahedron", 1, (1, 24, 2)),
        pytest.param("tetrahedron", 2, (1, 12, 1), marks=pytest.mark.slow),
    ],
)
def test_hairpin_in_space(cell, degree, cells):
    """Legs that meet, friction between them: with the bend, and with the outer face, too."""
    mesh, tags = meshes.block(comm, cells, hairpin, degree=degree, cell=cell)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    inner, outer = tags.find(meshes.LEFT), tags.find(meshes.RIGHT)
    both = np.sort(np.concatenate((inner, outer)))
    x, at = compute_midpoints(mesh, 2, inner), compute_midpoints(mesh, 2, outer)
    legs = [inner[(x[:, 0] > 0) & (x[:, 1] * sign > 0)] for sign in (1, -1)]
    ends = [outer[(at[:, 0] > 1.2) & (at[:, 1] * sign > 0)] for sign in (-1, 1)]
    ways = [(0.0, -0.6, 0.0), (0.0, -0.8, 0.0), (0.02, -0.85, 0.01)][: 4 - degree]
    told, *found = (
        pressed(mesh, V, [(V, a), (V, b)], *ends, ways, friction=0.3)
        for a, b in (legs, (inner, inner), (both, both))
    )
    assert told.contact.active.any()
    for one in found:
        assert one.contact.geometry.itself and one.contact.active.sum() == told.contact.active.sum()
        close(one.u.x.array, told.u.x.array, SAME)
        force = one.contact.force(one.problem, facets=legs[1])
        close(force, told.contact.force(told.problem), 1e-9)


def two_blocks():
    """Two blocks of one mesh with an outline of 2 × 1, of height 1 each; facets don't match."""
    whole = meshing.create_box(
        comm,
        [(0, 0, 0), (6, 1, 1)],
        (6, 3, 2),
        meshing.CellType.hexahedron,
        ghost_mode=meshing.GhostMode.none,
    )
    num = whole.topology.index_map(3).size_local
    cells = np.arange(num, dtype=np.int32)
    x = compute_midpoints(whole, 3, cells)[:, 0]
    mesh = meshing.create_submesh(whole, 3, cells[np.abs(x - 3.5) > 0.6])[0]
    x, y, z = mesh.geometry.x.T
    upper = x > 3.5
    x[:] = np.where(upper, x - 4, 2 * x / 3)
    y[:] = np.where(upper, y + 0.2 * y * (1 - y), y)
    z[upper] += 1
    return mesh


@pytest.mark.ranks
def test_patch_in_space():
    """Two blocks, pressed by a fifth of their height, whose whole outline is one surface."""
    mesh = two_blocks()
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body, bcs = Elastic.on(V, large=True), []
    for axis, place, value in ((0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 2, -0.4)):
        facets = meshing.locate_entities_boundary(
            mesh, 2, lambda x, a=axis, at=place: np.isclose(x[a], at)
        )
        dofs = fem.locate_dofs_topological(V.sub(axis), 2, facets)
        bcs.append(fem.dirichletbc(default_scalar_type(value), dofs, V.sub(axis)))
    every = meshing.exterior_facet_indices(mesh.topology)
    contact = Contact((V, every), (V, every))
    problem = ContactProblem([body.F], [body.u], bcs=bcs, contacts=[contact], rtol=1e-12)
    problem.solve()
    x = V.tabulate_dof_coordinates()
    u = body.u.x.array.reshape(-1, 3)[: len(x)]
    side = comm.allreduce(u[:, 0].max(initial=0), MPI.MAX) / 2
    close(u, x * (side, side, -0.2), 1e-11)
    between = meshing.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[2], 1))
    cells = mesh.topology.connectivity(2, 3).array[
        mesh.topology.connectivity(2, 3).offsets[between]
    ]
    top = between[compute_midpoints(mesh, 3, cells)[:, 2] > 1]
    p = contact.pressures(problem)[contact.active]
    close(p, np.full(len(p), contact.force(problem, facets=top)[2] / (2 * (1 + side) ** 2)), 1e-10)


def outline_of(mesh):
    """The whole outline of a body as two sides of a contact."""
    mesh.topology.create_connectivity(2, 3)
    every = meshing.exterior_facet_indices(mesh.topology)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    return MovingSurface(create_surface(V, every, "Γ0")), MovingSurface(
        create_surface(V, every, "Γ1")
    )


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_pairs_in_space(cell):
    """Each pair once, no neighbours whatever edges become, forces in balance, derivatives."""
    mesh, _ = meshes.block(comm, (1, 20, 2), hairpin, cell=cell)
    sides = outline_of(mesh)
    x = sides[0].displaced(np.zeros((len(sides[0].dofs), 3)))
    at = np.empty((len(sides[0].dofs), 3))
    at[np.searchsorted(sides[0].dofs, sides[0].vertex_dofs)] = x.x
    rng = np.random.default_rng(0)
    for noise in (0.15, 0.02):
        u = noise * rng.standard_normal(at.shape)
        u[:, 1] -= 0.76 * np.clip(at[:, 1] + 0.375, 0, 0.75) / 0.75
        segments = SpaceSegments.between(sides, (u, u), itself=True)
        pieces, _ = segments._at((u, u)).rays.shown
        f0, f1 = pieces.facets
        pairs = {tuple(pair) for pair in np.unique(np.stack((f0, f1), axis=1), axis=0).tolist()}
        facets = [set(facet) for facet in x.facets.tolist()]
        assert pairs and not any(facets[f] & facets[g] for f, g in pairs)
        assert not any(pair[::-1] in pairs for pair in pairs)
    g, _, C = segments.gap((u, u))
    p = rng.random(len(g))
    force = np.zeros(2 * u.size)
    np.add.at(force, C.j, p[C.i] * C.values)
    force = force.reshape(2, -1, 3)
    size = np.abs(force).sum()
    assert np.abs(force.sum(axis=(0, 1))).max() <= 1e-13 * size
    assert np.abs(np.cross(at + u, force).sum(axis=(0, 1))).max() <= 1e-12 * size
    if cell == "hexahedron":
        return  # warped facets: quadrature isn't exact
    way = rng.standard_normal(u.shape)
    ends = [p @ segments.gap((u + h * way, u + h * way))[0] for h in (1e-6, -1e-6)]
    assert abs((ends[0] - ends[1]) / 2e-6 - (force.sum(axis=0) * way).sum()) <= 1e-8 * size


@pytest.mark.parametrize("gap", [-3e-16, -1e-6])
def test_touching(gap):
    """Legs that overlap a little at first aren't the other side of their own walls."""
    mesh, tags = meshes.block(comm, (2, 48), hairpin)
    x = mesh.geometry.x
    x[:, 1] += np.where(x[:, 1] > 0, -0.375 + gap, 0.375) * (x[:, 0] > -1e-9)
    inner = tags.find(meshes.LEFT)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    own = own_of(create_surface(V, inner, "Γ0"))
    middle = compute_midpoints(mesh, 1, inner)
    assert np.isinf(own["depths"]).sum() >= (middle[:, 0] > 0.2).sum()


@two_ranks()
def test_refused():
    """Sides that share some facets."""
    mesh, tags = meshes.block(comm, (3, 3))
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    left, right = tags.find(meshes.LEFT), tags.find(meshes.RIGHT)
    both = np.sort(np.concatenate((left, right)))
    with raises(InterfaceError, "share facets; give each side its own, or all of them to both"):
        Contact((V, both), (V, left))
