# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Σ between two surfaces in space: identities, validity, and what it refuses."""

import subprocess
import sys
from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from helpers import assembled, close, comm, dense, interpolated, parts, raises, residual

import basix
import dolfinx.mesh
import meshes
from dolfinx import fem
from hypergap_dolfinx import InterfaceError, Tie
from hypergap_dolfinx.gap_mesh import front
from hypergap_dolfinx.mortar import domain
from hypergap_dolfinx.surface.projection import Triangles
from hypergap_dolfinx.surface.trace import create_surface
from hypergap_dolfinx.surface.triangulation import components, kinks, neighbours

pytest.importorskip("gmsh")  # for the unstructured meshes


def bars(n=(2, 3), k=(1, 1), mapping=lambda x: x, *, unstructured=False, shape=(), g=1, c=comm):
    """Blocks on both sides of x = 0, mapped together."""
    sides = []
    for i, tag in enumerate((meshes.RIGHT, meshes.LEFT)):

        def place(x, i=i):
            return mapping(x + np.array((i - 1, 0, 0)))

        if unstructured:
            mesh, ft = meshes.solid_block(c, 1 / n[i], place)
        else:
            mesh, ft = meshes.block(c, (1, n[i], n[i]), place, cell="tetrahedron", degree=g)
        sides.append((fem.functionspace(mesh, ("Lagrange", k[i], shape)), ft.find(tag)))
    return sides


def graph(f):
    """Bend the plane x = 0 into x = f(y, z)."""
    return lambda x: np.column_stack((x[:, 0] + f(x[:, 1], x[:, 2]), x[:, 1:]))


SHAPES = {
    "flat": lambda x: x,
    "skew": graph(lambda y, z: np.tan(np.radians(25)) * (y + z)),
    "saddle": graph(lambda y, z: 0.6 * ((y - 0.5) ** 2 - (z - 0.5) ** 2)),
    "cylinder": graph(lambda y, z: 0.5 - np.sqrt(1 - (y - 0.5) ** 2)),
    "waves": graph(lambda y, z: 0.1 * np.sin(2 * np.pi * y) * np.sin(2 * np.pi * z)),
    "paraboloid": graph(lambda y, z: -1.5 * ((y - 0.5) ** 2 + (z - 0.5) ** 2)),
    "ramp": graph(lambda y, z: 0.3 * np.sin(2 * np.pi * y)),
}


def base_integrals(domain, side):
    """∫ φ_a over Γ_i from the cells' own faces, ``(cell, node)``."""
    points, weights = basix.make_quadrature(basix.CellType.triangle, 6)
    result = np.zeros(domain.nodes.shape)
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
    for face in ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)):
        a, b, c = corners[list(face)]
        at = a + points[:, :1] * (b - a) + points[:, 1:] * (c - a)
        moments = weights @ domain.element.tabulate(0, at)[0, :, :, 0]
        on = (domain.alpha_vertices[:, face] == side).all(axis=1)
        x = domain.x[:, face]
        area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
        result[on] += area[on, None] * moments
    return result


@pytest.mark.ranks(k=[2], shape=["skew"], unstructured=[True])
@pytest.mark.parametrize("unstructured", (False, True))
@pytest.mark.parametrize("shape", ("flat", "skew"))
@pytest.mark.parametrize("k", (1, 2, 3))
def test_integrals_of_alpha_derivatives(k, shape, unstructured):
    """∫∫ ∂φ_a/∂α dΓ_α dα is ∫φ_a on Γ1, −∫φ_a on Γ0 and 0 inside (flat)."""
    domain = Tie(*bars((3, 4), (k, k), SHAPES[shape], unstructured=unstructured)).domain
    dphi, weights = parts(domain)
    actual = assembled(domain, np.einsum("cp,cpa->ca", weights, dphi))
    exact = assembled(domain, base_integrals(domain, 1) - base_integrals(domain, 0))
    np.testing.assert_allclose(actual, exact, rtol=0, atol=2e-14)


@pytest.mark.parametrize("shape", SHAPES)
def test_partition_of_unity(shape):
    """Eq. (21), and no gap where x is the same on all of Σ's nodes."""
    for k in (1, 2):
        domain = Tie(*bars((6, 8), (k, k), SHAPES[shape])).domain
        dphi, _ = parts(domain)
        close(np.einsum("cpa,ca->cp", dphi, domain.hosts.alpha), 1, 1e-11)
        scale = np.abs(dphi).max(initial=1)
        np.testing.assert_allclose(dphi.sum(axis=2) / scale, 0, atol=1e-13)


@pytest.mark.parametrize("unstructured", (False, True))
def test_smooth_fields_have_no_gap_on_a_flat_interface(unstructured):
    """Polynomials of the spaces' degree satisfy the constraint to round-off."""
    for k in (1, 2, 3):

        def f(x, k=k):
            return (1 + x[0] - 2 * x[1] + 0.5 * x[2]) ** k

        sides = bars((2, 3), (k, k), SHAPES["skew"], unstructured=unstructured)
        for ends in (sides, sides[::-1]):
            assert residual(Tie(*ends), *(interpolated(V, f) for V, _ in ends)) < 1e-11


def test_content():
    """∫∫ dΓ_α dα is the interface's area."""
    q = Tie(*bars((3, 4), (1, 1), SHAPES["skew"])).quadrature(2)
    close(q.integrate(np.ones_like(q.weights)), np.sqrt(1 + 2 * np.tan(np.radians(25)) ** 2), 1e-13)


@pytest.mark.ranks(shape=["saddle"], unstructured=[True])
@pytest.mark.parametrize("unstructured", (False, True))
@pytest.mark.parametrize("shape", SHAPES)
def test_facets_are_faces(shape, unstructured):
    """Each facet of both sides is a face of one cell; hosts of its nodes lie in the facet."""
    sides = bars((7, 10), (2, 2), SHAPES[shape], unstructured=unstructured)
    domain = Tie(*sides).domain
    for i, surface in enumerate(domain.surfaces):
        base = (domain.alpha_vertices == i).sum(axis=1) == 3
        assert comm.allreduce(int(base.sum())) == len(surface.facets)
        on = np.isclose(domain.hosts.alpha, i)
        if shape not in ("flat", "skew"):  # an edge may cross a hollow from rim to rim
            on[:, 4:] = False
        facet, X = domain.hosts.facets[i][on], domain.hosts.X[i][on]
        points = domain.element.points
        weights = np.column_stack((1 - points.sum(axis=1), points))
        x = (weights @ domain.x[:, :4])[on]
        close(surface.points(facet, X), x, 1e-13)
    # What lies between is hosted inside or hardly beyond a facet
    inside = np.concatenate([domain.hosts.X[i].reshape(-1, 2) for i in (0, 1)])
    weights = np.column_stack((1 - inside.sum(axis=1), inside))
    assert weights.min(initial=0) > -0.3


def test_size_ratios():
    """Sides of very different size: still no cell is inverted, and all facets are there."""
    for shape in ("flat", "cylinder", "paraboloid"):
        for n in ((2, 12), (12, 2)):
            domain = Tie(*bars(n, (1, 1), SHAPES[shape])).domain
            G = domain.gap_matrices()
            assert np.isfinite(G).all()


def test_real_gap():
    """Bodies that don't touch: the cells span the gap."""
    sides = [bars((2, 3))[0], bars((2, 3), mapping=lambda x: x + np.array((0.7, 0, 0)))[1]]
    q = Tie(*sides).quadrature(1)
    close(q.integrate(np.ones_like(q.weights)), 1)


@pytest.mark.ranks
@pytest.mark.parametrize("degree", (1, 2))
def test_same_on_any_number_of_ranks(degree):
    """Cells, α and hosts don't depend on how the bodies are distributed."""
    found = []
    for c in (comm, MPI.COMM_SELF):
        domain = Tie(*bars((3, 4), (degree,) * 2, SHAPES["saddle"], c=c, unstructured=True)).domain
        x = np.concatenate((domain.x[:, :4], domain.alpha_vertices[..., None]), axis=2)
        G = domain.gap_matrices()
        rows = np.column_stack((x.mean(axis=1), np.linalg.norm(G, axis=(1, 2))))
        rows = np.concatenate(c.allgather(rows))
        found.append(rows[np.lexsort(np.round(rows, 9).T)])
    close(found[0], found[1], 1e-11)


# What is refused


@pytest.mark.ranks(2)
def test_wrong_side():
    near, _ = bars()
    mesh, ft = meshes.block(comm, (1, 3, 3), lambda x: x - np.array((1, 0, 0)), cell="tetrahedron")
    V = fem.functionspace(mesh, ("Lagrange", 1))
    with raises(InterfaceError, "outward normals agree"):
        Tie(near, (V, ft.find(meshes.RIGHT)))


@pytest.mark.ranks(2)
def test_far_apart():
    sides = [bars()[0], bars(mapping=lambda x: x + np.array((9.0, 0, 0)))[1]]
    with raises(InterfaceError, "don't face each other"):
        Tie(*sides)


def test_faces_at_a_right_angle():
    """They have an edge in common, and nothing else."""
    (V0, _), (V1, facets1) = bars()
    V0.mesh.topology.create_connectivity(2, 3)
    top = dolfinx.mesh.locate_entities_boundary(V0.mesh, 2, lambda x: np.isclose(x[1], 1))
    with raises(InterfaceError, "don't face each other: everywhere .* from parallel"):
        Tie((V0, top), (V1, facets1))


@pytest.mark.parametrize("k", (1, 2, 3))
def test_factors_of_narrow_cells(monkeypatch, k):
    """Pulled back by their factors, all cells give what their matrices give."""
    sides = bars((2, 3), (k, k), SHAPES["saddle"], g=min(k, 2))
    tie = Tie(*sides)
    first = [dense(matrix) for matrix in tie.blocks()]
    monkeypatch.setattr(domain, "NARROW_CELL", 0.0)
    tie = Tie(*sides)
    for matrix, other in zip(tie.blocks(), first, strict=True):
        assert np.abs(dense(matrix) - other).max() < 1e-13 * np.abs(other).max()


@pytest.mark.ranks
def test_no_valid_mesh(monkeypatch):
    """Fronts that get nowhere: an error that names the place, on every rank."""
    monkeypatch.setattr(front, "construct", lambda *_: None)
    with raises(InterfaceError, "no mesh of the gap .* around"):
        Tie(*bars())


@pytest.mark.ranks(k=[1])
@pytest.mark.parametrize("k", (1, 2))
def test_interior_vertices(monkeypatch, k):
    """Cones' vertices are hosted on both sides, and the patch test's identities hold."""
    advance = front.advance

    def lossy(*args):
        made = advance(*args)
        return replace(made, cells=np.delete(made.cells, slice(5, None, 40), axis=0), left=1)

    monkeypatch.setattr(front, "advance", lossy)
    sides = bars((5, 8), (k, k), SHAPES["skew"])
    tie = Tie(*sides)
    extra = (tie.domain.alpha_vertices > 0) & (tie.domain.alpha_vertices < 1)
    assert comm.allreduce(int(extra.sum())) > 0

    def f(x):
        return (1 + x[0] - 2 * x[1] + 0.5 * x[2]) ** k

    assert residual(tie, *(interpolated(V, f) for V, _ in sides)) < 1e-11


@pytest.mark.serial
def test_gmsh_is_not_imported():
    code = (
        "from mpi4py import MPI\nfrom dolfinx import fem\n"
        "import sys, meshes, hypergap_dolfinx as h\n"
        "def side(n, tag, x):\n"
        "    m, f = meshes.block(MPI.COMM_SELF, n, lambda y: y + x, cell='tetrahedron')\n"
        "    return fem.functionspace(m, ('Lagrange', 1)), f.find(tag)\n"
        "h.Tie(side((1, 2, 2), meshes.RIGHT, (0, 0, 0)),"
        " side((1, 3, 3), meshes.LEFT, (1, 0, 0))).blocks()\n"
        "assert 'gmsh' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=meshes.__path__[0] + "/..")


# Triangulations


def test_neighbours_and_projection():
    x = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)], dtype=float)
    facets = np.array([(0, 1, 2), (0, 2, 3), (1, 4, 2)])
    behind = neighbours(facets, "Γ0", x)
    np.testing.assert_array_equal(behind, [(-1, 2, 1), (0, -1, -1), (-1, -1, 0)])
    points = np.array([(0.2, 0.8, 0.3), (1.4, 0.1, -0.2), (1.8, 0.6, 0.0)])
    facet, X = Triangles(x, facets, behind).project(points, np.array([2, 1, 1]))
    np.testing.assert_array_equal(facet, [1, 2, 2])
    weights = np.column_stack((1 - X.sum(axis=1), X))
    close(np.einsum("pv,pvi->pi", weights, x[facets[facet]])[:, :2], points[:, :2])


def test_who_goes_in_a_circle_stops():
    """Above a ridge both facets send a point to the other one: it ends where it lies best."""
    x = np.array([(0, 0, 1), (1, 0, 1), (0.5, 1, 0), (0.5, -1, 0)], dtype=float)
    facets = np.array([(0, 1, 2), (1, 0, 3)])
    triangles = Triangles(x, facets, neighbours(facets, "Γ0", x))
    points = np.array([(0.5, 0.1, 2.0), (0.5, -0.1, 2.0)])
    for seed in (0, 0), (1, 1):
        facet, X = triangles.project(points, np.array(seed))
        assert facet.tolist() == [0, 1]
        close(X[0], (0.725, -0.45))


def test_branching_surface():
    x = np.zeros((5, 3))
    with pytest.raises(InterfaceError, match=r"branches at \(0, 0, 0\)"):
        neighbours(np.array([(0, 1, 2), (0, 1, 3), (1, 0, 4)]), "Γ0", x)
    with pytest.raises(InterfaceError, match=r"folded at .* turned over"):
        neighbours(np.array([(0, 1, 2), (0, 1, 3)]), "Γ0", x)


def test_components():
    np.testing.assert_array_equal(
        components(6, np.array([4, 1, 3]), np.array([1, 0, 5])), [0, 0, 1, 2, 0, 2]
    )


@pytest.mark.ranks(2)
def test_kinks():
    """A cube has twelve edges; a faceted cylinder and sphere have none."""
    V = {}
    for name, (mesh, ft) in {
        "cube": meshes.block(comm, (4, 4, 4), cell="tetrahedron"),
        "ball": meshes.spherical_shell(comm, 0.2, 0.0, 0.5, octant=False),
    }.items():
        V[name] = fem.functionspace(mesh, ("Lagrange", 1)), ft.indices
    cylinder = bars((8, 8), (1, 1), SHAPES["cylinder"])[0]
    for (space, facets), number in ((V["cube"], 48), (V["ball"], 0), (cylinder, 0)):
        surface = create_surface(space, facets, "Γ0")
        found = kinks(surface, neighbours(surface.facets, "Γ0", surface.x))
        assert len(found[0]) == number


@pytest.mark.serial
@pytest.mark.parametrize("cell", ("hexahedron", "tetrahedron"))
def test_kinks_of_skew_blocks(cell):
    """All twelve edges, and nothing else: at corners other edges don't explain a turn."""
    rng = np.random.default_rng(0)
    for _ in range(12):
        A = np.eye(3) + rng.uniform(-0.35, 0.35, (3, 3))
        n = rng.integers(2, 6, 3)
        mesh, ft = meshes.block(comm, tuple(n), lambda x, A=A: x @ A, cell=cell)
        surface = create_surface(fem.functionspace(mesh, ("Lagrange", 1)), ft.indices, "Γ0")
        found = kinks(surface, neighbours(surface.polygons, "Γ0", surface.x))
        assert len(found[0]) == 4 * n.sum()
