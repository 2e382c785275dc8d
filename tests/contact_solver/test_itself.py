# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One surface against itself in the plane: the same as two that were told apart."""

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
from assembly import Elastic
from helpers import close, raises, two_ranks

import meshes
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import compute_midpoints
from hypergap_dolfinx import Contact, ContactProblem, InterfaceError

comm = MPI.COMM_WORLD
SAME = 1e-11  # of displacements: the same equations, up to 2e-15 apart


def pressed(mesh, V, sides, held, moved, ways, **options):
    """A body with facets that are held, and others that are moved step by step."""
    body = Elastic.on(V, large=True)
    value, zero = (fem.Constant(mesh, default_scalar_type((0.0, 0.0))) for _ in range(2))
    bcs = [
        fem.dirichletbc(g, fem.locate_dofs_topological(V, 1, facets), V)
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
    return np.column_stack((x - off * np.sin(angle), -off * np.cos(angle)))


@two_ranks()
@pytest.mark.parametrize("degree", [1, 2])
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
        assert one.contact.itself and one.contact.active.sum() == told.contact.active.sum()
        close(one.u.x.array, told.u.x.array, SAME)
        close(one.contact.force(one.problem), told.contact.force(told.problem), 1e-9)


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
        np.abs(found.contact.force(found.problem)), np.abs(told.contact.force(told.problem)), 0.02
    )


@two_ranks()
def test_refused():
    """Sides that share some facets, and a surface in space."""
    mesh, tags = meshes.block(comm, (3, 3))
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    left, right = tags.find(meshes.LEFT), tags.find(meshes.RIGHT)
    both = np.sort(np.concatenate((left, right)))
    with raises(InterfaceError, "share facets; give each side its own, or all of them to both"):
        Contact((V, both), (V, left))
    mesh, tags = meshes.block(comm, (2, 2, 2), cell="hexahedron")
    W = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    side = W, tags.find(meshes.LEFT)
    with raises(InterfaceError, "in space a surface can't meet itself; give"):
        Contact(side, side)
