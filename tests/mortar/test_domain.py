# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Σ as a DOLFINx mesh, and the identities that make the patch test pass."""

import logging

from mpi4py import MPI

import numpy as np
import pytest
from helpers import assembled, close, comm, nodal_space, parts, skew, two_blocks, two_rings

import dolfinx.mesh
import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import Tie, TiedProblem
from hypergap_dolfinx.core import compat

LENGTH = 2  # of the blocks' interface


def base_integrals(domain, side):
    """∫ φ_a over Γ_i from its own edges, ``(cell, node)``."""
    t, w = np.polynomial.legendre.leggauss(6)
    along, result = (1 + t) / 2, np.zeros(domain.nodes.shape)
    corners = np.array([(0, 0), (1, 0), (0, 1)])
    for a, b in ((0, 1), (1, 2), (2, 0)):
        points = corners[a] + along[:, None] * (corners[b] - corners[a])
        moments = w / 2 @ domain.element.tabulate(0, points)[0, :, :, 0]
        on = (domain.alpha_vertices[:, [a, b]] == side).all(axis=1)
        length = np.linalg.norm(domain.x[:, a] - domain.x[:, b], axis=1)
        result[on] += length[on, None] * moments
    return result


@pytest.mark.ranks(n=[(3, 5)], k=[2])
@pytest.mark.parametrize("n", ((3, 5), (5, 5), (1, 4)))
@pytest.mark.parametrize("k", (1, 2, 3))
def test_integrals_of_alpha_derivatives(n, k):
    """∫∫ ∂φ_a/∂α dΓ_α dα is ∫φ_a on Γ1, −∫φ_a on Γ0 and 0 inside."""
    domain = Tie(*two_blocks(n, (k, k), mapping=skew)).domain
    dphi, weights = parts(domain)
    actual = assembled(domain, np.einsum("cp,cpa->ca", weights, dphi))
    exact = assembled(domain, base_integrals(domain, 1) - base_integrals(domain, 0))
    scale = LENGTH / max(n)
    np.testing.assert_allclose(actual, exact, rtol=0, atol=1e-14 * LENGTH)
    assert comm.allreduce(np.abs(exact).max(initial=0), MPI.MAX) > 0.05 * scale


@pytest.mark.parametrize("rings", (False, True))
@pytest.mark.parametrize("k", (1, 2, 3))
def test_partition_of_unity(k, rings):
    """Eq. (21) at every point, on flat and on curved interfaces."""
    sides = two_rings((4, 6), (k, k), g=2) if rings else two_blocks((3, 5), (k, k), mapping=skew)
    domain = Tie(*sides).domain
    V, dofs = nodal_space(domain)
    alpha = fem.Function(V)
    alpha.interpolate(domain.alpha)
    dphi, _ = parts(domain)
    sums = np.einsum("cpa,ca->cp", dphi, alpha.x.array[dofs])
    np.testing.assert_allclose(sums, 1, rtol=0, atol=1e-13)


@pytest.mark.parametrize("k", (1, 2, 3))
def test_smooth_fields_have_no_gap_on_a_flat_interface(k):
    """∂f/∂α = 0 for polynomials of degree k; a linear field among them."""
    domain = Tie(*two_blocks((3, 5), (k, k), mapping=skew)).domain
    dphi, _ = parts(domain)
    V, dofs = nodal_space(domain)
    for degree in range(1, k + 1):
        f = fem.Function(V)
        f.interpolate(lambda x, p=degree: (1 + 2 * x[0] - 3 * x[1]) ** p)
        nodal = f.x.array[dofs]
        values = np.einsum("cpa,ca->cp", dphi, nodal)
        scale = np.abs(dphi).max(initial=0) * np.abs(nodal).max(initial=0)
        np.testing.assert_allclose(values, 0, rtol=0, atol=1e-13 * scale)


# ∫∫ dΓ_α dα


def content(sides, degree=12):
    q = Tie(*sides).quadrature(degree)
    return q.integrate(np.ones(q.weights.shape))


@pytest.mark.parametrize("g", (1, 2, 3))
@pytest.mark.parametrize("n", ((3, 5), (4, 4)))
def test_content_of_a_flat_interface(n, g):
    close(content(two_blocks(n, mapping=skew, g=g)), LENGTH)


@pytest.mark.ranks(n=[(8, 12)])
@pytest.mark.parametrize("n", ((3, 5), (8, 12), (12, 8), (5, 5)))
def test_content_of_polygons(n):
    """The mean of both lengths: each cell counts half of its base."""
    lengths = [2 * 2.5 * m * np.sin(np.pi / 4 / m) for m in n]
    close(content(two_rings(n)), np.mean(lengths))
    lengths = [2 * 2.5 * m * np.sin(np.pi / m) for m in n]
    close(content(two_rings(n, angle=2 * np.pi)), np.mean(lengths))


def curve_length(g, m):
    """Length of a quarter circle's interpolant of degree g in m parts, at equal angles."""
    theta = np.linspace(0, np.pi / 2 / m, g + 1)
    t, w = np.polynomial.legendre.leggauss(20)
    fits = [np.polyfit(np.linspace(-1, 1, g + 1), 2.5 * f(theta), g) for f in (np.cos, np.sin)]
    slope = [np.polyval(np.polyder(fit), t) for fit in fits]
    return m * (w @ np.hypot(*slope))


@pytest.mark.parametrize("g", (2, 3))
def test_content_of_the_same_curve_on_both_sides(g):
    """Where the sides' facets are the same, every Γ_α is that curve."""
    close(content(two_rings((5, 5), (g, g), g=g), 24), curve_length(g, 5), 1e-13)


@pytest.mark.parametrize("g", (1, 2, 3))
def test_content_of_a_circle(g):
    """The length of the arc, with the order of the geometry: 2, 4, 4."""
    errors = [abs(content(two_rings((2 * n, 3 * n), g=g), 10) - 2.5 * np.pi / 2) for n in (2, 4, 8)]
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    print(errors, rates)
    assert rates[-1] > (1.95, 3.9, 3.9)[g - 1]


# The mesh


@pytest.mark.ranks(k=[3])
@pytest.mark.parametrize("interface", ("flat", "ring"))
@pytest.mark.parametrize("k", (1, 2, 3))
def test_numbers_of_cells_and_nodes(k, interface):
    """n₀ + n₁ cells; every node of both sides, and k − 1 on each cross edge, more inside cells."""
    n = (3, 5) if interface == "flat" else (6, 8)
    sides = two_blocks(n, (k, k)) if interface == "flat" else two_rings(n, (k, k), angle=2 * np.pi)
    domain = Tie(*sides).domain
    cells, ends = sum(n), 1 if interface == "flat" else 0
    assert domain.mesh.topology.index_map(2).size_global == cells
    nodes = k * cells + 2 * ends  # on both sides
    nodes += (k - 1) * (cells + ends) + cells * (k - 1) * (k - 2) // 2
    assert comm.allreduce(np.diff(domain.owned).item()) == nodes
    assert nodal_space(domain)[0].dofmap.index_map.size_global == nodes


@pytest.mark.ranks
def test_sigma_without_volume():
    """Γ0 and Γ1 coincide: the cells are flat, and a mesh all the same."""
    tie = Tie(*two_blocks((3, 5), mapping=skew))
    x = tie.domain.x
    np.testing.assert_allclose(np.linalg.det(x[:, 1:] - x[:, :1]), 0, atol=1e-14)
    assert tie.sigma.topology.dim == tie.sigma.geometry.dim == 2
    assert comm.allreduce(tie.sigma.topology.index_map(2).size_local) == 8


@pytest.mark.ranks(g=[2])
@pytest.mark.parametrize("g", (1, 2))
def test_arrays_are_those_of_the_mesh(g):
    """Coordinates, α and the normals, cell by cell, on each rank; DOLFINx reorders a ring."""
    tie = Tie(*two_rings((24, 32), (2, 2), g=g, angle=2 * np.pi))
    domain, mesh = tie.domain, tie.sigma
    dofmap = compat.geometry_dofmap(mesh)[domain.in_mesh]
    assert len(domain.x) == len(dofmap)
    np.testing.assert_array_equal(domain.x, mesh.geometry.x[dofmap][..., :2])
    dofs = tie.alpha.function_space.dofmap.list[domain.in_mesh]
    np.testing.assert_array_equal(tie.alpha.x.array[dofs], domain.alpha_vertices)
    assert set(np.unique(domain.alpha_vertices)) <= {0.0, 1.0}
    radial = domain.x[:, :3].mean(axis=1) / 2.5
    assert (np.einsum("ci,ci->c", radial, domain.normal) > 0.9).all()
    assert domain.curved.all() if g == 2 else not domain.curved.any()


@pytest.mark.ranks
def test_surfaces_edges_are_cells_edges():
    """Each facet of the bodies is the base of one cell of Σ, with its own two vertices."""
    domain = Tie(*two_rings((6, 8))).domain
    for i, surface in enumerate(domain.surfaces):
        on = (domain.alpha_vertices == i).sum(axis=1) == 2
        bases = [
            sorted(map(tuple, x[a == i]))
            for x, a in zip(domain.x[on], domain.alpha_vertices[on], strict=True)
        ]
        bases = sorted(base for part in comm.allgather(bases) for base in part)
        assert bases == sorted(sorted(map(tuple, surface.x[f])) for f in surface.facets)


@pytest.mark.ranks(k=[2])
@pytest.mark.parametrize("k", (1, 2, 3))
def test_hosts_lie_where_the_nodes_are(k):
    """(1 − α) X₀ + α X₁ is the node, on curved interfaces too."""
    domain = Tie(*two_rings((6, 8), (k, k), g=max(k, 2))).domain
    hosts = domain.hosts
    x = [
        s.points(f.ravel(), X.reshape(-1, 1)).reshape(*f.shape, 2)
        for s, f, X in zip(domain.surfaces, hosts.facets, hosts.X, strict=True)
    ]
    alpha = hosts.alpha[..., None]
    V, dofs = nodal_space(domain)
    nodes = V.tabulate_dof_coordinates()[dofs][..., :2]
    # A node on a side is that side's node; one between is off both curves by h³ at most
    np.testing.assert_allclose((1 - alpha) * x[0] + alpha * x[1], nodes, atol=2e-3)
    for i in (0, 1):
        on = hosts.alpha == i
        np.testing.assert_allclose(x[i][on], nodes[on], rtol=0, atol=2e-13)


@pytest.mark.ranks(k=[(1, 1)], gap=[0.7])
@pytest.mark.parametrize("k", ((1, 1), (2, 2)))
@pytest.mark.parametrize("gap", (0.0, 0.3, 0.7, -0.2))
def test_distance(gap, k, caplog):
    """Surfaces that lie apart are told of, once, and tied."""
    below, above = two_blocks((4, 5), k)
    above[0].mesh.geometry.x[:, 1] += gap
    caplog.clear()
    with caplog.at_level(logging.WARNING, "hypergap_dolfinx"):
        tie = Tie(below, above)
    assert tie.domain.distance() == pytest.approx(abs(gap), abs=1e-14)
    warned = comm.allreduce(len(caplog.records))
    assert warned == (gap != 0)
    if caplog.records:
        assert f"Γ0 and Γ1 are {abs(gap):g} apart on average" in caplog.text
        assert ("adjust=True" in caplog.text) is (abs(gap) < 0.5)  # the facets' length


@pytest.mark.parametrize("shape", ((), (2,)))
@pytest.mark.parametrize(
    ("n", "k", "g", "share"),
    (
        *[((7, 5), 1, 1, ""), ((60, 40), 1, 1, ""), ((60, 40), 2, 1, ""), ((7, 5), 2, 2, "")],
        *[((7, 5), 2, 1, "2.2%"), ((3, 2), 3, 1, "5.1%")],
    ),
)
def test_chords_of_an_arc_are_not_apart(n, k, g, share, shape, caplog):
    """Two polygons around one circle: told where they limit spaces of a higher degree."""
    sides = []
    for i, radii in enumerate(((0.5, 1), (1, 1.5))):
        mesh, ft = meshes.ring_sector(comm, n[i], 2, *radii, degree=g)
        V = fem.functionspace(mesh, ("Lagrange", k, shape) if shape else ("Lagrange", k))
        sides.append((V, ft.find(meshes.INNER if i else meshes.OUTER)))
    with caplog.at_level(logging.WARNING, "hypergap_dolfinx"):
        assert Tie(*sides).domain.distance() > (1e-5 if g == 1 else 0)
    assert len(caplog.records) == bool(share)
    if share:
        assert f"{share} of a facet: chords of a curved surface" in caplog.text


def test_polygons_have_no_chords(caplog):
    """Surfaces that turn at one vertex alone are no chords of a round one: their gap is theirs."""
    sides = []
    for n, shift, tag in ((4, 0.0, meshes.TOP), (6, 0.99, meshes.BOTTOM)):

        def kinked(x, shift=shift):
            return x + [0, shift] + np.abs(x[:, :1] - 0.5) * [0, 0.3]

        mesh, ft = meshes.block(comm, (n, 2), kinked, cell="triangle")
        sides.append((fem.functionspace(mesh, ("Lagrange", 1, (2,))), ft.find(tag)))
    with caplog.at_level(logging.WARNING, "hypergap_dolfinx"):
        assert Tie(*sides, close_gap=True).domain.distance() == pytest.approx(
            0.01 / np.hypot(1, 0.3)
        )
    assert not caplog.records


@pytest.mark.ranks
def test_distance_in_space(caplog):
    pytest.importorskip("gmsh")
    sides = []
    for i, tag in enumerate((meshes.FRONT, meshes.BACK)):
        mesh, ft = meshes.block(
            comm, (3 + i, 3, 2), lambda x, i=i: x + 1.5 * i * np.eye(3)[2], cell="tetrahedron"
        )
        sides.append((fem.functionspace(mesh, ("Lagrange", 1)), ft.find(tag)))
    with caplog.at_level(logging.WARNING, "hypergap_dolfinx"):
        tie = Tie(*sides)
    assert tie.domain.distance() == pytest.approx(0.5, abs=1e-14)
    assert comm.allreduce(len(caplog.records)) == 1


@pytest.mark.ranks(2)
def test_a_mesh_for_results_only(monkeypatch):
    """Neither the constraint nor a problem needs Σ's mesh; it is made once, when asked for."""
    made, create = [], dolfinx.mesh.create_mesh
    sides = two_blocks((3, 5), shape=())
    monkeypatch.setattr(
        dolfinx.mesh,
        "create_mesh",
        lambda *args, **of: made.append(create(*args, **of)) or made[-1],
    )
    tie = Tie(*sides)
    a, L, bcs = [], [], []
    for i, (V, _) in enumerate(sides):
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        a.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        L.append(None)
        dofs = fem.locate_dofs_geometrical(V, lambda x, at=(-1, 1)[i]: np.isclose(x[1], at))
        bcs.append(fem.dirichletbc(default_scalar_type(i), dofs, V))
    problem = TiedProblem(a, L, bcs=bcs, ties=[tie])
    problem.solve()
    assert not made
    tie.traction(problem)
    assert made == [tie.sigma] and tie.alpha.function_space.mesh is tie.sigma
