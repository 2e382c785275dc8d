# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Hexahedra: quadrilateral facets as triangles of Σ, patch tests, smooth fields, a sphere."""

from itertools import product

import numpy as np
import patch_test_3d
import pressurised_sphere as sphere
import pytest
from helpers import close, comm, interpolated, residual, sweep
from test_solids_interfaces import NOTHING, NU, linear, stress, tied

import basix
import dolfinx
import meshes
import ufl
from dolfinx import fem
from hypergap_dolfinx import Tie, TiedProblem
from hypergap_dolfinx.gap_mesh import slab
from hypergap_dolfinx.mortar.domain import unevenness
from hypergap_dolfinx.surface.pieces import Side
from hypergap_dolfinx.surface.quadrilaterals import HALVES, QUARTERS, on_triangles
from hypergap_dolfinx.surface.tolerances import SAME_NODE
from hypergap_dolfinx.surface.trace import create_surface, tabulate

VARIANTS = basix.LagrangeVariant.gll_warped, basix.LagrangeVariant.equispaced


def elements(k, m, variant=VARIANTS[0]):
    """Those of a facet and of the triangles on it."""
    P, cell = basix.ElementFamily.P, basix.CellType
    return (
        basix.create_element(P, cell.quadrilateral, k, variant),
        basix.create_element(P, cell.triangle, m, VARIANTS[0]),
    )


def on_pieces(element, nodes, pieces, rule):
    """The functions of a facet as its triangles have them, at the points of a rule on these.

    Returns:
        Points, weights, and values ``(num_points, num_dofs)``.
    """
    points, weights, values = [], [], []
    X, w = basix.make_quadrature(basix.CellType.triangle, rule)
    for v in pieces[0][pieces[1]]:
        J = v[1:] - v[0]
        nodal = on_triangles(element, nodes, v[0] + nodes.points @ J)
        points.append(v[0] + X @ J)
        weights.append(w * np.linalg.det(J))
        values.append(tabulate(nodes, X) @ nodal)
    return np.vstack(points), np.concatenate(weights), np.vstack(values)


CASES = [(k, m) for k in (1, 2, 3, 4) for m in range(k, 2 * k + 1)]


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(("k", "m"), CASES)
def test_moments(k, m, variant):
    """With polynomials of degree max(1, k − 1) they are those on the facet."""
    element, nodes = elements(k, m, variant)
    degree = max(1, k - 1)
    points, weights, values = on_pieces(element, nodes, QUARTERS, m + degree)
    X, w = basix.make_quadrature(basix.CellType.quadrilateral, 2 * k)
    for i, j in product(range(degree + 1), repeat=2):
        if i + j <= degree:
            exact = (w * X[:, 0] ** i * X[:, 1] ** j) @ tabulate(element, X)
            close((weights * points[:, 0] ** i * points[:, 1] ** j) @ values, exact, 1e-12)


@pytest.mark.parametrize(("k", "m"), CASES)
def test_what_triangles_have_stays(k, m):
    """Terms sⁱtʲ up to i + j = m, and everything on the halves and on quarters with degree 2k."""
    element, nodes = elements(k, m)
    at = element.points
    points, _, values = on_pieces(element, nodes, QUARTERS, 4)
    for i, j in product(range(k + 1), repeat=2):
        if i + j <= m:
            nodal = at[:, 0] ** i * at[:, 1] ** j
            close(values @ nodal, points[:, 0] ** i * points[:, 1] ** j, 1e-12)
    if m == 2 * k:
        for pieces in HALVES[1]:
            points, _, values = on_pieces(element, nodes, (HALVES[0], pieces), 4)
            close(values, tabulate(element, points), 1e-12)


def test_values_at_dofs_stay():
    """If they are nodes of the triangles; and the mean of the corners in the middle."""
    for k, m in CASES:
        element, nodes = elements(k, m)
        at = [v[0] + nodes.points @ (v[1:] - v[0]) for v in QUARTERS[0][QUARTERS[1]]]
        at = np.concatenate(at)
        apart = np.abs(at[:, None] - element.points).max(axis=2)
        found = on_triangles(element, nodes, at)
        node, dof = np.nonzero(apart < SAME_NODE)
        close(found[node], np.eye(element.dim)[dof], 1e-12)
        if k == 1:
            close(found[(at == 0.5).all(axis=1)], 0.25)


@pytest.mark.parametrize(("k", "m"), CASES)
def test_pieces_are_polynomials(k, m):
    """Between nodes, too: Σ's inner nodes lie anywhere in a facet."""
    element, nodes = elements(k, m)
    points, _, values = on_pieces(element, nodes, QUARTERS, 5)
    close(on_triangles(element, nodes, points), values, 1e-12)


# Surfaces and pieces


def wavy(x):
    """A plane that isn't one any more: warped facets."""
    return np.column_stack((x[:, 0] + 0.15 * np.sin(4 * x[:, 1]) * np.cos(3 * x[:, 2]), x[:, 1:]))


def side_of_a_block(n=4, mapping=wavy, degree=1, tag=meshes.RIGHT, k=2):
    mesh, ft = meshes.block(comm, (2, n, n), mapping, cell="hexahedron", degree=degree)
    V = fem.functionspace(mesh, ("Lagrange", k, (3,)))
    return create_surface(V, ft.find(tag), "Γ0")


@pytest.mark.parametrize("halves", (False, True))
def test_pieces(halves):
    surface = side_of_a_block()
    facets = np.arange(len(surface.facets))
    side = Side.of(surface, facets, halves)
    assert side.degree == (4 if halves else 2)
    assert len(side.triangles) == len(facets) * (2 if halves else 4)
    # Corners lie where their facet has them, and the pieces' turn is the facets'
    each = np.repeat(np.arange(len(side.triangles)), 3)
    xi = np.tile([(0, 0), (1, 0), (0, 1)], (len(side.triangles), 1))
    close(side.points(each, xi), side.x[side.triangles.ravel()])
    assert (np.einsum("ti,ti->t", side.normals, surface.normals[side.facets]) > 0.9).all()
    (loop,) = side.loops()
    assert len(loop) == 16


def test_affine_and_curved_facets():
    assert side_of_a_block(mapping=None).affine.all()
    warped = side_of_a_block()
    assert not warped.curved.any() and not warped.affine.any()
    assert side_of_a_block(degree=2).curved.all()


def tie_of_blocks(n, mapping, k=(1, 1), tags=(meshes.RIGHT, meshes.LEFT)):
    sides = []
    for i, (cells, degree, tag) in enumerate(zip(n, k, tags, strict=True)):

        def place(x, i=i):
            return mapping(x + i * np.eye(3)[0]) - np.eye(3)[0]

        mesh, ft = meshes.block(comm, (1, cells, cells), place, cell="hexahedron")
        sides.append((fem.functionspace(mesh, ("Lagrange", degree, (3,))), ft.find(tag)))
    return Tie(*sides)


@pytest.mark.ranks(2)
@pytest.mark.parametrize("k", (1, 2))
def test_warped_facets_make_one_smooth_surface(k):
    """Kinks are looked for between facets: a warped one's quarters turn at its diagonals."""
    tie = tie_of_blocks((4, 6), wavy, (k, k))
    assert tie.domain.patch.max() == 0
    assert tie.domain.element.degree == k
    assert tie.domain.geometry.degree == k


@pytest.mark.ranks(k=[2])
@pytest.mark.parametrize("mapping", (lambda x: x, wavy))
@pytest.mark.parametrize("k", (1, 2, 3))
def test_matching_facets_are_fused(k, mapping):
    """All fields of one mesh meet the constraints, not only polynomials of degree k."""
    tie = tie_of_blocks((3, 3), mapping, (k, k))
    u = [interpolated(V, lambda x: np.sin(9 * x[1] + [[5], [4], [3]] * x[2])) for V in tie.spaces]
    assert residual(tie, *u) <= 1e-13


@pytest.mark.ranks(2)
@pytest.mark.parametrize("n", ((1, 5), (5, 1)))
def test_unevenness(n):
    """Squares are compared as such, not their quarters."""
    tie = tie_of_blocks(n, lambda x: x)
    sides = list(zip(tie.spaces, tie.facets, strict=True))
    close(unevenness(tie.domain, sides, 1), n[1] / n[0], 1e-12)


# Patch tests


@pytest.mark.parametrize("case", sweep(patch_test_3d.cases("hexahedron"), 71))
def test_patch(case):
    test, names, *rest = case
    errors = patch_test_3d.solve(comm, patch_test_3d.pair(names), *rest, test)
    print(errors)
    assert max(errors) <= 1e-11  # seen: 5e-12


def blocks(n, shape, cells=("hexahedron", "hexahedron")):
    """One behind the other; the far one is prescribed nowhere."""
    bodies = []
    for i, mapping in enumerate(patch_test_3d.mappings(shape)):
        mesh, ft = meshes.block(comm, (1, n[i], n[i]), mapping, cell=cells[i])
        tag = (meshes.RIGHT, meshes.LEFT)[i]
        bodies.append((mesh, ft.find(tag), NOTHING if i else ft.find(meshes.LEFT)))
    return bodies


def check_patch(bodies, degree, swap):
    """Displacement, stress and traction of a constant stress state."""
    l2, s, problem, tie = tied(bodies, linear, degree, swap=swap)
    gradient = np.array(linear(np.eye(3)))
    strain = (gradient + gradient.T) / 2
    sigma = (strain + NU / (1 - 2 * NU) * np.trace(strain) * np.eye(3)) / (1 + NU)
    q = tie.quadrature(4)
    off = np.abs(q.evaluate(tie.traction(problem)) - q.normal @ sigma).max(initial=0)
    worst = max(comm.allgather(off)) / np.abs(sigma).max()
    print(l2, s, worst)
    assert max(l2, s) <= 1e-11
    assert worst <= 1e-10


@pytest.mark.ranks(2, degree=[(2, 2)], swap=[True])
@pytest.mark.parametrize(
    ("swap", "degree"), sweep(product((False, True), ((1, 1), (2, 2), (1, 2))), 2)
)
def test_traction_of_distorted_facets(degree, swap):
    check_patch(blocks((3, 4), "distorted"), degree, swap)


@pytest.mark.slow  # compilers take a minute for such forms
@pytest.mark.parametrize("degree", ((3, 3), (2, 3), (3, 1)))
def test_cubic(degree):
    check_patch(blocks((2, 3), "distorted"), degree, False)


@pytest.mark.parametrize("degree", sweep(((1, 2), (2, 2)), 2))
def test_halves(degree, monkeypatch):
    """What cut facets are made of: exact with twice the degree."""

    class Halved(Side):
        @classmethod
        def of(cls, surface, facets, behind=None):
            return Side.of(surface, facets, halves=True)

    monkeypatch.setattr(slab, "Side", Halved)
    check_patch(blocks((3, 4), "distorted"), degree, False)
    check_patch(blocks((2, 3), "skew", ("hexahedron", "tetrahedron")), degree, True)


# A smooth field that is in no space


def smooth(x, m=np):
    return (
        m.sin(1.3 * x[0] + 0.4) * m.cos(0.9 * x[1] - 0.3 * x[2]),
        0.7 * m.cos(1.1 * x[0]) * m.exp(0.5 * x[1] + 0.2 * x[2]),
        0.6 * m.sin(0.8 * x[2] + 0.7 * x[0]) * m.cos(0.6 * x[1]),
    )


def smooth_errors(bodies, degree, swap=False, alone=False):
    """Relative H¹ error over the bodies, and the traction's in L², of the field's loads.

    Values are prescribed on all that isn't tied; ``alone`` without a tie, on all.
    """
    forms, loads, bcs, sides = [], [], [], []
    for (mesh, facets, _), k in zip(bodies, degree, strict=True):
        V = fem.functionspace(mesh, ("Lagrange", k, (3,)))
        u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
        sigma = stress(ufl.as_vector(smooth(x, ufl)))
        dx = ufl.dx(metadata={"quadrature_degree": 2 * k + 2})
        forms.append(ufl.inner(stress(u), ufl.sym(ufl.grad(v))) * ufl.dx)
        loads.append(-ufl.dot(ufl.div(sigma), v) * dx)
        g = fem.Function(V)
        g.interpolate(lambda x: np.array(smooth(x)))
        mesh.topology.create_connectivity(2, 3)
        held = dolfinx.mesh.exterior_facet_indices(mesh.topology)
        held = held if alone else np.setdiff1d(held, facets)
        bcs.append(fem.dirichletbc(g, fem.locate_dofs_topological(V, 2, held)))
        sides.append((V, facets))
    ties = [] if alone else [Tie(*(sides[::-1] if swap else sides))]
    problem = TiedProblem(forms, loads, bcs=bcs, ties=ties)
    squares = np.zeros(2)
    for u in problem.solve():
        exact = ufl.as_vector(smooth(ufl.SpatialCoordinate(u.function_space.mesh), ufl))
        dx = ufl.dx(metadata={"quadrature_degree": 6})
        for i, f in enumerate((u, fem.Function(u.function_space))):
            e = ufl.grad(f - exact)
            squares[i] += fem.assemble_scalar(fem.form(ufl.inner(e, e) * dx))
    squares = comm.allreduce(squares)
    h1 = np.sqrt(squares[0] / squares[1])
    if alone:
        return h1, None
    q = ties[0].quadrature(6)
    h = 1e-5
    x = np.moveaxis(q.x, -1, 0)
    steps = h * np.eye(3)[:, :, None, None]
    gradient = [np.subtract(smooth(x + d), smooth(x - d)) / (2 * h) for d in steps]
    gradient = np.moveaxis(np.array(gradient), (0, 1), (-1, -2))
    strain = (gradient + np.swapaxes(gradient, -1, -2)) / 2
    trace = np.trace(strain, axis1=-2, axis2=-1)[..., None, None]
    sigma = (strain + NU / (1 - 2 * NU) * trace * np.eye(3)) / (1 + NU)
    exact = np.einsum("cpij,cpj->cpi", sigma, q.normal)
    off = q.evaluate(ties[0].traction(problem)) - exact
    return h1, np.sqrt(q.integrate((off**2).sum(-1)) / q.integrate((exact**2).sum(-1)))


# The traction's error: 0.155 and 0.0130 with the finer side as Γ1, less with the coarser one
SMOOTH = list(product(((1, (6, 8), 0.17), (2, (3, 4), 0.0135)), (False, True)))


@pytest.mark.parametrize(("case", "swap"), sweep(SMOOTH, 3))
def test_smooth_field(case, swap):
    """Distorted facets cost nothing: the error is that of the bodies with prescribed values."""
    k, n, bound = case
    bodies = blocks(n, "distorted")
    h1, traction = smooth_errors(bodies, (k, k), swap)
    h1_alone, _ = smooth_errors(bodies, (k, k), alone=True)
    print(h1 / h1_alone, traction)
    assert h1 <= 1.001 * h1_alone
    assert traction <= bound


# A sphere, adjusted


@pytest.mark.parametrize("swap", (False, True))
def test_sphere(swap):
    """As good as one mesh."""
    row, *_ = sphere.run(comm, 0.4, 1, swap, cell="hexahedron")
    fused = sphere.run_fused(comm, 0.4, 1, "hexahedron")
    print(row, fused)
    for name in ("l2", "stress"):
        assert row[name] <= 1.05 * fused[name]


@pytest.mark.slow
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("degree", (1, 2))
def test_rates(degree, swap):
    hs = (0.2 * degree, 0.1 * degree)
    rows = [sphere.run(comm, h, degree, swap, cell="hexahedron")[0] for h in hs]
    rates = [np.log2(rows[0][name] / rows[1][name]) for name in ("l2", "stress", "traction")]
    print(rates)
    bounds = {1: (1.95, 0.97, 1.0), 2: (2.9, 1.9, 1.9)}[degree]
    assert all(rate >= bound for rate, bound in zip(rates, bounds, strict=True))
