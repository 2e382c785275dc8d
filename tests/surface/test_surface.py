# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The trace of a space on its interface facets."""

from mpi4py import MPI

import numpy as np
import pytest
from helpers import close, comm

import basix
import dolfinx
import meshes
from dolfinx import fem
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.surface.trace import create_surface, tabulate

CELLS = "triangle", "quadrilateral", "tetrahedron", "hexahedron"
DIM = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}


def bend(x):
    """A quadratic mapping without symmetry, one to one on the unit square and cube."""
    y = x.copy()
    y[:, 0] += 0.2 * x[:, 1] * (1 + x[:, 0])
    y[:, 1] += 0.3 * x[:, 0] ** 2 - 0.1 * x[:, 0] * x[:, -1]
    return y


def body(cell, k, g, shape=(), c=comm, n=None):
    """A bent block with facets of its whole boundary but one side."""
    dim = DIM[cell]
    mesh, ft = meshes.block(c, n or (3, 2, 2)[:dim], bend, cell=cell, degree=g)
    facets = ft.indices[ft.values != meshes.RIGHT]
    return fem.functionspace(mesh, ("Lagrange", k, shape)), facets


def gathered(V, owned):
    """Owned rows of an array of all ranks, numbered as the global dofs (blocks)."""
    owned = owned[: V.dofmap.index_map.size_local]
    return np.concatenate(V.mesh.comm.allgather(owned))


def inner_points(cell):
    return basix.create_lattice(cell, 6, basix.LatticeType.equispaced, True)


@pytest.mark.ranks(k=[2], g=[2], shape=[()])
@pytest.mark.parametrize("shape", ((), (2,)))
@pytest.mark.parametrize("g", (1, 2, 3))
@pytest.mark.parametrize("k", (1, 2, 3))
@pytest.mark.parametrize("cell", CELLS)
def test_dofs_lie_where_the_trace_has_its_nodes(cell, k, g, shape):
    V, facets = body(cell, k, g, shape)
    surface = create_surface(V, facets, "Γ0")
    X = surface.element.points
    each = np.repeat(np.arange(len(surface.facets)), len(X))
    x = surface.points(each, np.tile(X, (len(surface.facets), 1)))
    nodes = gathered(V, V.tabulate_dof_coordinates())[:, : x.shape[1]]
    close(x, nodes[surface.dofs.ravel()])


@pytest.mark.parametrize(
    ("k", "g", "degree"), ((1, 1, 1), (2, 1, 2), (3, 1, 3), (2, 2, 1), (3, 3, 1))
)
@pytest.mark.parametrize("cell", CELLS)
def test_trace_of_a_polynomial(cell, k, g, degree):
    """Between the nodes too: exact up to degree k, on curved facets up to k / g."""

    def polynomial(x):
        return 1 + sum((i + 1) * c**degree for i, c in enumerate(x)) + x[0] * x[1] ** (degree - 1)

    V, facets = body(cell, k, g)
    surface = create_surface(V, facets, "Γ0")
    u = fem.Function(V)
    u.interpolate(lambda x: polynomial(x[: surface.gdim]))
    values = gathered(V, u.x.array)[surface.dofs]
    points = inner_points(surface.element.cell_type)
    for X in points:
        Xs = np.tile(X, (len(values), 1))
        x = surface.points(np.arange(len(values)), Xs)
        close(np.einsum("pa,pa->p", tabulate(surface.element, Xs), values), polynomial(x.T), 1e-13)


@pytest.mark.ranks(2)
@pytest.mark.parametrize("cell", CELLS)
def test_normals_point_outwards(cell):
    dim = DIM[cell]
    tags = (meshes.LEFT, meshes.RIGHT, meshes.BOTTOM, meshes.TOP, meshes.BACK, meshes.FRONT)
    mesh, ft = meshes.block(comm, (3, 2, 2)[:dim], cell=cell)
    V = fem.functionspace(mesh, ("Lagrange", 1))
    for i, tag in enumerate(tags[: 2 * dim]):
        surface = create_surface(V, ft.find(tag), "Γ0")
        outward = (2 * (i % 2) - 1) * np.eye(dim)[i // 2]
        close(surface.normals, np.tile(outward, (len(surface.facets), 1)))


@pytest.mark.parametrize("cell", CELLS)
def test_turn_of_the_vertices(cell):
    """2D: the body is on the left of an edge. 3D: counterclockwise, seen from outside."""
    V, facets = body(cell, 1, 1)
    dim = DIM[cell]
    surface = create_surface(V, facets, "Γ0")
    v = surface.x[surface.facets][:, :dim]
    centre = bend(np.full((1, surface.gdim), 0.5))[0]
    edges = np.concatenate((v[:, 1:] - v[:, :1], (centre - v[:, 0])[:, None]), axis=1)
    sign = 1 if surface.gdim == 2 else -1
    assert (sign * np.linalg.det(edges) > 0).all()


def test_normals_of_rings():
    """Away from the centre outside, towards it inside."""
    for tag, sign in ((meshes.OUTER, 1), (meshes.INNER, -1)):
        mesh, ft = meshes.ring_sector(comm, 12, 2, 1, 2, angle=2 * np.pi, degree=2)
        surface = create_surface(fem.functionspace(mesh, ("Lagrange", 1)), ft.find(tag), "Γ0")
        middle = surface.x[surface.facets].mean(axis=1)
        radial = middle / np.linalg.norm(middle, axis=1)[:, None]
        close(surface.normals, sign * radial, 1e-13)


@pytest.mark.ranks
@pytest.mark.parametrize("cell", CELLS)
def test_the_same_arrays_on_every_rank(cell):
    """And the same as one rank alone has, sorted by place; dofs have numbers of their own."""
    surfaces, nodes = [], []
    for c in (comm, MPI.COMM_SELF):
        V, facets = body(cell, 2, 2, c=c)
        surfaces.append(create_surface(V, facets, "Γ0"))
        nodes.append(gathered(V, V.tabulate_dof_coordinates())[surfaces[-1].dofs])
    one = surfaces[1]
    for name in ("x", "facets", "nodes"):
        for other in comm.allgather(getattr(surfaces[0], name)):
            np.testing.assert_array_equal(other, getattr(one, name))
    close(nodes[0], nodes[1])
    for name in ("dofs", "owner", "dof_range"):
        mine = getattr(surfaces[0], name)
        for other in comm.allgather(mine):
            np.testing.assert_array_equal(other, mine)
    assert (np.lexsort(one.x.T[::-1]) == np.arange(len(one.x))).all()
    assert (surfaces[0].owner < comm.size).all() and surfaces[0].dof_range[-1] > surfaces[
        0
    ].dofs.max()


@pytest.mark.ranks
def test_facets_that_several_ranks_know_count_once():
    """The facets of ghost cells may be given by all who know them, or by their owners alone."""
    links = (2,) if compat.VERSION >= (0, 11) else ()  # at most two cells at a facet
    ghosts = dolfinx.mesh.GhostMode.shared_facet
    partitioner = dolfinx.mesh.create_cell_partitioner(ghosts, *links)
    mesh, _ = meshes.block(comm, (7, 5), cell="triangle", partitioner=partitioner)
    V = fem.functionspace(mesh, ("Lagrange", 1))
    known = dolfinx.mesh.locate_entities(mesh, 1, lambda x: np.isclose(x[1], 1))
    own = known[known < mesh.topology.index_map(1).size_local]
    assert comm.allreduce(len(own)) == 7
    assert comm.size == 1 or comm.allreduce(len(known)) > 7
    surfaces = [create_surface(V, facets, "Γ0") for facets in (known, own)]
    for surface in surfaces:
        assert len(surface.facets) == 7
        close(surface.size.sum(), 1)
        np.testing.assert_array_equal(surface.dofs, surfaces[0].dofs)


@pytest.mark.ranks
def test_facets_on_some_ranks_only():
    """Ranks that own nothing of the interface."""
    mesh, ft = meshes.block(comm, (4, 16))
    V = fem.functionspace(mesh, ("Lagrange", 2))
    surface = create_surface(V, ft.find(meshes.TOP), "Γ0")
    assert len(surface.facets) == 4
    close(surface.x, [(i / 4, 1) for i in range(5)])


@pytest.mark.parametrize("off", (0.0, 0.1))
def test_arcs(off):
    """Edges of a circle lie on it, with nodes off the middle too; straight ones stay."""
    mesh, ft = meshes.ring_sector(comm, 16, 2, 0.5, 1, angle=2 * np.pi, degree=2)
    x = mesh.geometry.x
    turn = np.exp(1j * off * np.sin(np.angle(x[:, 0] + 1j * x[:, 1])))
    x[:, :2] = np.stack(
        (x[:, 0] * turn.real - x[:, 1] * turn.imag, x[:, 0] * turn.imag + x[:, 1] * turn.real),
        axis=1,
    )
    V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    outer = create_surface(V, ft.find(meshes.OUTER), "Γ1")
    t = np.linspace(0, 1, 9)[:, None]
    for surface, bound in ((outer, 0.02), (outer.arcs, 5e-6), (outer.arcs.split, 5e-6)):
        at = np.repeat(np.arange(len(surface.facets)), len(t))
        distance = np.linalg.norm(surface.points(at, np.tile(t, (len(surface.facets), 1))), axis=1)
        assert np.abs(distance - 1).max() <= bound
    mesh, ft = meshes.block(comm, (5, 2), degree=2)
    flat = create_surface(fem.functionspace(mesh, ("Lagrange", 2, (2,))), ft.indices, "Γ1")
    assert flat.arcs is flat


@pytest.mark.parametrize("shift", (0, 1e6))
def test_curved_facets(shift):
    """Told from straight ones by their nodes, also far from the origin."""

    def lift(x):
        return np.column_stack((x[:, 0], x[:, 1] + 0.1 * np.maximum(0, x[:, 0] - 0.5) ** 2)) + shift

    mesh, ft = meshes.block(comm, (6, 2), lift, degree=2)
    V = fem.functionspace(mesh, ("Lagrange", 2))
    surface = create_surface(V, ft.find(meshes.TOP), "Γ0")
    middle = surface.x[surface.facets].mean(axis=1)[:, 0] - shift
    np.testing.assert_array_equal(surface.curved, middle > 0.5)
