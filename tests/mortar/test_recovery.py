# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tractions on the bodies' surfaces: exact ones, errors beside λ's, kinks, cuts, ranks."""

from mpi4py import MPI

import numpy as np
import pytest
from helpers import comm, interpolated, raises, skew, two_blocks

import basix
import dolfinx
import meshes
import ufl
from dolfinx import fem
from hypergap_dolfinx import Tie, TiedProblem
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.surface.trace import tabulate

EXACT = 2e-11  # ε times the condition of the system, 1e4; what is seen is up to 1e-12


class Given:
    """Stands for a solved problem: its multipliers are those of a traction."""

    def __init__(self, traction):
        self._traction = traction

    def multipliers(self, tie):
        """Values at the dofs of Γ1, of this rank's rows."""
        constraint, surface = tie.constraint, tie.surfaces[1]
        dofs, first = np.unique(surface.dofs, return_index=True)
        facet, local = np.divmod(first, surface.dofs.shape[1])
        x = surface.points(facet, surface.element.points[local])
        values = self._traction(x[np.searchsorted(dofs, constraint.dofs)], constraint.patch)
        start, end = constraint.R_A.getOwnershipRangeColumn()
        mine = (start <= constraint.rows) & (constraint.rows < end)
        rows = np.zeros((end - start, values.shape[1]))
        rows[constraint.rows[mine] - start] = values[mine]
        return rows


def at_points(t, degree):
    """Places, values, unit normals and weights at Gauss points, on this rank."""
    V, n = t.function_space, t.function_space.mesh.geometry.dim
    element, cmap = V.ufl_element().basix_element, compat.coordinate_element(V.mesh)
    cell = element.cell_type
    geometry = basix.create_element(
        basix.ElementFamily.P, cell, cmap.degree, basix.LagrangeVariant(int(cmap.variant))
    )
    X, weights = basix.make_quadrature(cell, degree)
    nodes = V.mesh.geometry.x[compat.geometry_dofmap(V.mesh)][..., :n]
    x, *d = (np.einsum("pm,cmi->cpi", v, nodes) for v in geometry.tabulate(1, X)[..., 0])
    N = np.cross(*d) if n == 3 else np.stack((-d[0][..., 1], d[0][..., 0]), axis=-1)
    measure = np.linalg.norm(N, axis=-1)
    nodal = t.x.array.reshape(-1, V.dofmap.index_map_bs)[V.dofmap.list]
    values = tabulate(element, X) @ nodal
    return x, values, N / measure[..., None], measure * weights


def l2_error(t, exact, degree=6):
    """Relative to the exact traction, a function of places and normals."""
    x, values, normal, weights = at_points(t, degree)
    e = exact(x, normal)
    parts = [comm.allreduce(np.einsum("cp,cpi->", weights, f**2)) for f in (values - e, e)]
    return np.sqrt(parts[0] / parts[1])


def lambda_error(tie, problem, exact, degree=6):
    """The same of λ on Σ."""
    q = tie.quadrature(degree)
    e = exact(q.x, q.normal)
    error = q.evaluate(tie.traction(problem)) - e
    return np.sqrt(q.integrate((error**2).sum(-1)) / q.integrate((e**2).sum(-1)))


def largest_error(tie, traction):
    """Of both sides' recovered tractions from an exact λ, ``traction(x, patch)`` of one patch."""
    problem, worst = Given(traction), 0.0
    for side in (0, 1):
        t = tie.traction(problem, on=f"side{side}")
        x, values, *_ = at_points(t, 2)
        exact = traction(x.reshape(-1, x.shape[-1]), 0).reshape(values.shape)
        exact *= 1 - 2 * side
        size = comm.allreduce(np.abs(exact).max(initial=0), MPI.MAX)
        worst = max(worst, comm.allreduce(np.abs(values - exact).max(initial=0), MPI.MAX) / size)
    return worst


def polynomial(degree):
    """A traction with two components, of a degree up to 2."""

    def traction(x, patch):
        s = x.sum(axis=1) if degree else np.ones(len(x))
        return np.column_stack((1 + 0.7 * s, 2 - 0.4 * s**degree))

    return traction


# What λ carries exactly


@pytest.mark.ranks(2, k=[(2, 2)], span=[(0.3, 1.43)])
@pytest.mark.parametrize("span", ((0, 2), (0.3, 1.43), (-0.3, 1.1), (0.4999999, 1.51)))
@pytest.mark.parametrize("k", ((1, 1), (2, 2), (3, 3), (1, 2), (3, 1)))
def test_polynomials(k, span):
    """Those of degree k − 1 are recovered, of mixed degrees and where facets are cut too."""
    sides = two_blocks((3, 5), k, mapping=skew, spans=((0, 2), span))
    for pair in (sides, sides[::-1]):
        assert largest_error(Tie(*pair), polynomial(min(k) - 1)) <= EXACT


@pytest.mark.ranks(2, cells=["hexes"], shift=[0.37])
@pytest.mark.parametrize("shift", (0.0, 0.37))
@pytest.mark.parametrize("cells", ("tets", "hexes", "mixed"))
def test_polynomials_in_space(cells, shift):
    """Tetrahedra and hexahedra of degree 2, faces that are cut."""
    types = {"tets": ("tetrahedron",) * 2, "hexes": ("hexahedron",) * 2}
    types["mixed"] = ("tetrahedron", "hexahedron")
    sides = []
    for i, (cell, tag) in enumerate(zip(types[cells], (meshes.FRONT, meshes.BACK), strict=True)):
        at = np.array((i * shift, i * shift / 2, i - 1))
        mesh, ft = meshes.block(comm, (2 + i, 3 - i, 1), lambda x, at=at: x + at, cell=cell)
        sides.append((fem.functionspace(mesh, ("Lagrange", 2, (2,))), ft.find(tag)))
    assert largest_error(Tie(*sides), polynomial(1)) <= EXACT


@pytest.mark.parametrize("degree", (1, 2))
def test_outlines_off_by_next_to_nothing(degree):
    """What is beyond the part that both sides have feels no traction; with it t is 1.5e-5 off."""
    sides = []
    for i, tag in enumerate((meshes.FRONT, meshes.BACK)):
        at = np.array((2e-6 * i, -1e-6 * i, i - 1))
        mesh, ft = meshes.block(comm, (3, 3, 1), lambda x, at=at: x + at, cell="tetrahedron")
        sides.append((fem.functionspace(mesh, ("Lagrange", degree, (2,))), ft.find(tag)))
    tie = Tie(*sides)
    assert tie.domain.overhang is not None
    assert largest_error(tie, polynomial(degree - 1)) <= 1e-9


def frame_and_block(c=comm):
    """A block in a hole of a plate; four kinks."""
    sides = []
    for n, size in ((12, 1.0), (5, 0.5)):
        mesh, _ = meshes.block(c, (n, n), lambda x, s=size: s * (2 * x - 1), cell="triangle")
        sides.append(mesh)
    mesh, inner = sides
    mid = dolfinx.mesh.compute_midpoints(mesh, 2, np.arange(mesh.topology.index_map(2).size_local))
    outside = np.abs(mid).max(axis=1) > 0.5
    plate = dolfinx.mesh.create_submesh(mesh, 2, np.flatnonzero(outside).astype(np.int32))[0]
    found = []
    for body in (plate, inner):
        V = fem.functionspace(body, ("Lagrange", 1, (2,)))
        body.topology.create_connectivity(1, 2)
        boundary = dolfinx.mesh.exterior_facet_indices(body.topology)
        at = dolfinx.mesh.compute_midpoints(body, 1, boundary)
        found.append((V, boundary[np.abs(np.abs(at).max(axis=1) - 0.5) < 1e-9]))
    return found


@pytest.mark.ranks(2, swap=[True])
@pytest.mark.parametrize("swap", (False, True))
def test_one_sided_at_kinks(swap):
    """A stress is exact up to the corners of a block, where its traction jumps."""
    sides = frame_and_block()
    tie = Tie(*(sides[::-1] if swap else sides))
    sigma = np.array([(0.8, 0.6), (0.6, -0.3)])
    constraint, surface = tie.constraint, tie.surfaces[1]
    normal = np.zeros((int(tie.domain.patch.max()) + 1, 2))
    normal[tie.domain.patch] = -surface.normals  # λ acts on Γ0's body
    problem = Given(lambda x, patch: normal[patch] @ sigma)
    for side in (0, 1):
        t = tie.traction(problem, on=f"side{side}")
        x, values, n, weights = at_points(t, 2)
        assert np.abs(values - n @ sigma).max(initial=0) <= EXACT
        inward = np.einsum("cpi,cpi->cp", n, x) < 0
        assert (inward if (side == 1) == swap else ~inward).all()  # out of plate and block
        assert abs(comm.allreduce(weights.sum()) - 4) <= 1e-12
        num = t.function_space.mesh.topology.index_map(0).size_global
        assert num == len(tie.surfaces[side].facets) + 4
    assert len(constraint.dofs) == len(surface.x) + 4


# Errors of discretisation


def heat(mesh_of, degree, u, swap, **options):
    """Two shells with a harmonic temperature, prescribed inside and outside; solved.

    No heat goes through their ends.
    """
    a, bcs, sides = [], [], []
    for i in (0, 1):
        mesh, ft = mesh_of(i)
        V, facets = (
            fem.functionspace(mesh, ("Lagrange", degree)),
            ft.find((meshes.OUTER, meshes.INNER)[i]),
        )
        dim = mesh.topology.dim
        w, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        a.append(ufl.inner(ufl.grad(w), ufl.grad(v)) * ufl.dx)
        dofs = fem.locate_dofs_topological(V, dim - 1, ft.find((meshes.INNER, meshes.OUTER)[i]))
        bcs.append(fem.dirichletbc(interpolated(V, u), dofs))
        sides.append((V, facets))
    tie = Tie(*(sides[::-1] if swap else sides), **options)
    problem = TiedProblem(a, [None, None], bcs=bcs, ties=[tie])
    problem.solve()
    return tie, problem


def rings(c, n, degree, swap, **options):
    """Rings 2 : 2.5 : 3 with cells of n[0] and n[1] around."""

    def mesh_of(i):
        r = (2.0, 2.5, 3.0)[i : i + 2]
        return meshes.ring_sector(c, n[i], max(n[i] // 6, 1), *r, degree=degree)

    return heat(mesh_of, degree, quartic, swap, **options)


def flux_of(u, degree):
    """∂u/∂n on circles and spheres of a homogeneous polynomial."""

    def flux(x, n):
        r = np.linalg.norm(x, axis=-1)
        value = degree * u(np.moveaxis(x, -1, 0)) / r
        return (np.copysign(1, (x * n).sum(-1)) * value)[..., None]

    return flux


def quartic(x):
    return x[0] ** 4 - 6 * (x[0] * x[1]) ** 2 + x[1] ** 4


def quadratic(x):
    return 2 * x[2] ** 2 - x[0] ** 2 - x[1] ** 2


def errors(tie, problem, flux):
    """λ's error, and those of both sides' tractions over it."""
    e = lambda_error(tie, problem, flux)
    return e, [l2_error(tie.traction(problem, on=f"side{i}"), flux) / e for i in (0, 1)]


@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("n", ((8, 64), (24, 36), (36, 24), (64, 8)))
@pytest.mark.parametrize("degree", (1, 2))
def test_errors_on_a_circle(degree, n, swap):
    """At 2:3 far below λ's, at 1:8 never above."""
    e, ratios = errors(*rings(comm, n, degree, swap), flux_of(quartic, 4))
    print(e, ratios)
    bound = 0.65 if max(n) == 64 else (0.3, 0.15)[degree - 1]
    assert max(ratios) <= bound


def test_rates_on_a_circle():
    """An order more than λ's."""
    found = []
    for m in (1, 4):
        e, ratios = errors(*rings(comm, (16 * m, 24 * m), 2, False), flux_of(quartic, 4))
        found.append([e * r for r in ratios])
    assert (np.log2(np.divide(*found)) / 2 >= 2.9).all()


@pytest.mark.parametrize(
    "degree, n, swap, bound",
    (
        (1, (4, 6), False, 0.3),
        (1, (4, 6), True, 0.35),
        (1, (2, 3), True, 0.5),
        pytest.param(2, (4, 6), True, 0.25, marks=pytest.mark.slow),
        (2, (2, 3), True, 0.4),
        (2, (1, 8), True, 1.0),
    ),
)
def test_errors_on_a_sphere(degree, n, swap, bound):
    """Hexahedra in layers; with two facets on an edge, and with one facet against 64."""
    radii = ((1, 1.25, 1.5), (1.5, 1.75, 2)) if degree == 1 else ((1.25, 1.5), (1.5, 1.75))

    def mesh_of(i):
        return meshes.spherical_layers(comm, n[i], radii[i], degree=degree)

    tie, problem = heat(mesh_of, degree, quadratic, swap)
    e, ratios = errors(tie, problem, flux_of(quadratic, 2))
    print(e, ratios)
    assert max(ratios) <= bound


@pytest.mark.ranks
def test_ranks():
    """As on one rank, and as DOLFINx integrates it; with a jump and a compliance that vary."""
    options = {"jump": lambda x: x[0] * x[1], "compliance": lambda x: 2 + np.sin(x[0])}
    found = []
    for c in (MPI.COMM_SELF, comm):
        tie, problem = rings(c, (16, 24), 2, False, **options)
        for i in (0, 1):
            t = tie.traction(problem, on=f"side{i}")
            form = fem.form(t**2 * ufl.dx)
            found.append(c.allreduce(fem.assemble_scalar(form)))
    np.testing.assert_allclose(found[:2], found[2:], rtol=1e-11)


def test_unknown_place():
    tie = Tie(*two_blocks())
    with raises(ValueError, "side0"):
        tie.traction(None, on="body")
