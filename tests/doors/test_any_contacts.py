# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Random contacts: each of the demo's checks notices what it is for; the whole sweep if slow."""

from mpi4py import MPI

import any_contacts
import numpy as np
import pytest
from any_contacts import wrong

import meshes
from dolfinx import fem
from meshes.boundary import Boundary

pytest.importorskip("gmsh")
comm = MPI.COMM_SELF
PLANE = 65
"""A scene of two bodies with friction."""


def shift(scene, by):
    """Move the second body, against the direction in which it was pressed."""
    part = scene.parts[1]
    way = part.motion / np.linalg.norm(part.motion)
    size = max(np.median(p.boundary.size) for p in scene.parts)
    part.values[:] += by * size * way


def deeper(scene, problem):
    shift(scene, 2.5)


def away(scene, problem):
    shift(scene, -0.4)


def one_node(scene, problem):
    """A node inside is off by a thousandth of a facet."""
    part = scene.parts[0]
    outside = fem.locate_dofs_topological(part.V, 1, part.boundary.facets)
    part.values[np.setdiff1d(np.arange(len(part.values)), outside)[0]] += (
        1e-3 * part.boundary.size.min()
    )


def folded(scene, problem):
    """A node inside is off by two facets."""
    for _ in range(2000):
        one_node(scene, problem)


def in_contact(scene, problem):
    """The same of a node in contact."""
    part = scene.parts[0]
    dofs = fem.locate_dofs_topological(part.V, 1, part.boundary.facets[part.given])
    at = part.V.tabulate_dof_coordinates()[dofs, :2]
    x = problem.contacts[0].surfaces[1].x[problem.contacts[0].active][0]
    part.values[dofs[np.linalg.norm(at - x, axis=1).argmin()]] += 1e-3 * part.boundary.size.min()


def heavier(scene, problem):
    problem.rows(problem.contacts[0]).state.p *= 1.01


def pulls(scene, problem):
    state = problem.rows(problem.contacts[0]).state
    state.p[np.flatnonzero(state.active)[0]] *= -0.1


def rubs(scene, problem):
    state = problem.rows(problem.contacts[0]).state
    state.q[:, np.flatnonzero(state.active)[0]] = 1.1 * scene.friction * state.p.max()


@pytest.mark.parametrize(
    ("spoil", "said"),
    (
        (None, ()),
        (deeper, ("overlap",)),
        (away, ("apart",)),
        (one_node, ("left",)),
        (folded, ("det F",)),
        (in_contact, ("balance", "force")),
        (heavier, ("force",)),
        (pulls, ("pull",)),
        (rubs, ("cone",)),
    ),
)
def test_checks(spoil, said):
    row = any_contacts.run(PLANE, 2, spoil)
    assert row["friction"] and row["kind"] == "two" and row["steps"][0]["active"], row
    if spoil is None:
        assert row["ok"], row["wrong"]
    else:
        assert row["status"] != "solved" and row["wrong"]  # the next load step starts spoiled
        first = " ".join(wrong(row["steps"][0]))
        assert all(word in first for word in said), first


def test_boxes():
    """Inside, and how far from the boundary, in the plane and in space."""
    rng = np.random.default_rng(0)
    for dim, cell in ((2, "triangle"), (2, "quadrilateral"), (3, "tetrahedron"), (3, "hexahedron")):
        mesh, _ = meshes.block(comm, (3, 2, 2)[:dim], cell=cell, degree=2)
        b = Boundary(fem.functionspace(mesh, ("Lagrange", 2, (dim,))))
        np.testing.assert_allclose(np.abs(b.normals).max(axis=1), 1)
        assert (b.normals * (b.X.mean(axis=1) - 0.5)).sum(axis=1).min() > 0.4
        if dim == 2:
            edge = np.isclose(np.abs(b.X - 0.5), 0.5).all(axis=2)
            np.testing.assert_array_equal(b.sharp, edge)
        pieces, p = b.pieces(b.X), rng.uniform(-0.5, 1.5, (300, dim))
        out = np.maximum(np.abs(p - 0.5) - 0.5, 0)
        inside = (out == 0).all(axis=1)
        np.testing.assert_array_equal(pieces.contains(p), inside)
        depth = (0.5 - np.abs(p - 0.5)).min(axis=1)
        distance = np.where(inside, depth, np.linalg.norm(out, axis=1))
        np.testing.assert_allclose(pieces.nearest(p)[0], distance, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize(("dim", "scenes", "least"), ((2, 300, 280), (3, 30, 24)))
def test_sweep(dim, scenes, least):
    """As many solved as when the demo was written, but for a few; none that ends a process."""
    rows = [any_contacts.run(seed, dim) for seed in range(scenes)]
    assert not [row["error"] for row in rows if row["status"] == "crashed"]
    assert sum(row["ok"] for row in rows) >= least, [
        any_contacts.failed(row) for row in rows if not row["ok"]
    ]
