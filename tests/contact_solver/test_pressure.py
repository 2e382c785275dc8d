# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Where pressures live: multipliers at the nodes of degree 2, and pressures below facets."""

from dataclasses import replace

from mpi4py import MPI

import hertz
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from assembly import Elastic, rectangle
from helpers import sweep
from scipy.sparse.linalg import splu
from test_contact import Blocks
from test_contact_scenes import press_punch

import meshes
import ufl
from dolfinx import default_scalar_type, fem, la
from dolfinx.mesh import CellType, create_box, create_rectangle, locate_entities_boundary
from hypergap_dolfinx import Contact, ContactProblem
from hypergap_dolfinx.contact_geometry.plane import PlaneSegments
from hypergap_dolfinx.mortar.free_edges import (
    ContactState,
    SurfacePressure,
    _near_free_edges,
    _normals,
    _Opening,
    _parts,
    _RootFit,
    _solved,
    edges_by_gaps,
    hats,
    simplices,
)
from hypergap_dolfinx.mortar.tolerances import MISSED_ROOT
from hypergap_dolfinx.surface.moving import MovingSurface
from hypergap_dolfinx.surface.trace import create_surface

comm = MPI.COMM_WORLD
RATIOS = ((1, 3), (1, 2), (2, 3), (1, 1), (3, 2), (2, 1), (3, 1))


@pytest.mark.ranks(2, ratio=[(3, 1)], swap=[True])
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("ratio", RATIOS)
def test_patch_of_degree_2(ratio, swap):
    """A uniform pressure, at each of the nodes of degree 2."""
    scene = Blocks(degree=2, n=tuple(3 * n for n in ratio), held=False, walls=True, swap=swap)
    scene.load.value = 0.05
    scene.problem.solve()
    p = scene.problem.rows(scene.contact).state.p
    assert len(p) == 6 * ratio[0 if swap else 1] + 1
    assert np.abs(p / 0.05 - 1).max() <= 1e-11


@pytest.mark.parametrize("geometry", (1, 2))
def test_derivatives_of_halves(geometry):
    """Gaps of halved edges, displaced at random: ∂g/∂u, and no moment in a rotation."""
    rng, sides, places = np.random.default_rng(1), [], []
    for i, (n, tag) in enumerate(((5, meshes.TOP), (4, meshes.BOTTOM))):

        def place(x, i=i):
            low = np.column_stack((1.4 * x[:, 0] - 0.2, x[:, 1] - 1))
            return low if i == 0 else x + np.outer((x[:, 0] - 0.5) ** 2, (0, 0.1))

        mesh, ft = meshes.block(MPI.COMM_SELF, (n, 2), place, degree=geometry)
        V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
        surface = create_surface(V, ft.find(tag), f"Γ{i}")
        sides.append(MovingSurface(surface.split if i else surface))
        places.append(V.tabulate_dof_coordinates()[sides[i].dofs, :2])
    u = [0.02 * rng.standard_normal(x.shape) for x in places]
    segments = PlaneSegments.between((sides[0], sides[1]), (u[0], u[1]))
    g, _, C = segments.gap((u[0], u[1]))
    turned = [np.column_stack((-(x + v)[:, 1], (x + v)[:, 0])) for x, v in zip(places, u)]
    assert np.abs(C.times(turned, len(g))).max() <= 1e-13
    w, step = [rng.standard_normal(x.shape) for x in places], 1e-6
    ends = [segments.gap((u[0] + t * w[0], u[1] + t * w[1]))[0] / (2 * step) for t in (-step, step)]
    assert np.abs(ends[1] - ends[0] - C.times(w, len(g))).max() <= 1e-8


class Pressed:
    """Blocks of a degree, one on the other, with multipliers at nodes of degree 2."""

    def __init__(self, n, degree):
        """Make both, with n facets on Γ0 and on Γ1."""
        self.bodies, parts = [], []
        for i, low in enumerate((-0.25, 0)):
            given = (n[i], n[i] // 4), (0, low), (1, low + 0.25)
            body = rectangle(*given, degree=degree)
            surface = create_surface(body.V, body.facets((meshes.TOP, meshes.BOTTOM)[i]), f"Γ{i}")
            parts.append(MovingSurface(surface.split if i else surface))
            self.bodies.append((body, body.facets((meshes.BOTTOM, meshes.TOP)[i])))
        self.sides = parts[0], parts[1]

    def schur(self):
        """C K⁻¹ Cᵀ of the bodies, which are held far away."""
        u = [np.zeros((len(side.dofs), 2)) for side in self.sides]
        g, _, C = PlaneSegments.between(self.sides, (u[0], u[1])).gap((u[0], u[1]))
        found, first = 0, 0
        for (body, far), side in zip(self.bodies, self.sides, strict=True):
            elastic = Elastic.on(body.V)
            K = fem.assemble_matrix(fem.form(ufl.derivative(elastic.F, elastic.u)))
            K = K.to_scipy().tocsc()
            held = fem.locate_dofs_topological(body.V, 1, far)
            free = np.setdiff1d(np.arange(K.shape[0]), (2 * held[:, None] + np.arange(2)).ravel())
            own = (C.j >= first) & (C.j < first + 2 * len(side.dofs))
            node, component = np.divmod(C.j[own] - first, 2)
            columns = 2 * side.dofs[node] + component
            shape = len(g), K.shape[0]
            B = scipy.sparse.csr_matrix((C.values[own], (C.i[own], columns)), shape)[:, free]
            found = found + B @ splu(K[free][:, free]).solve(B.T.toarray())
            first += 2 * len(side.dofs)
        return found


@pytest.mark.parametrize("num", sweep((8, 16, 32), 3))
@pytest.mark.parametrize("ratio", RATIOS)
def test_stable(ratio, num):
    """The least work of a pressure, over what displacements of degree 4 would give it: β²."""
    n = tuple(num * part // min(ratio) for part in ratio[::-1])
    coarse, fine = (Pressed(n, degree).schur() for degree in (2, 4))
    assert np.sqrt(scipy.linalg.eigvalsh(coarse, fine)[0]) >= 0.6


def quarter_cylinders(cell, around=(6, 4), along=(6, 4), sliding="small", friction=None):
    """Two thick cylinders, a quarter of each, of which the inner one is larger by 1e-3."""
    u, F, bcs, sides = [], [], [], []
    for i, (inside, outside) in enumerate(((0.5, 1.001), (1.0, 1.5))):

        def bent(x, inside=inside, outside=outside):
            r, angle = inside + (outside - inside) * x[:, 2], np.pi / 2 * x[:, 0]
            return np.column_stack((r * np.cos(angle), r * np.sin(angle), x[:, 1]))

        mesh, ft = meshes.block(comm, (around[i], along[i], 2), bent, cell=cell, degree=2)
        V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
        body = Elastic.on(V, (1.0, 1.0))
        for axis, tag in ((1, 1), (0, 2), (2, 3), (2, 4)):
            dofs = fem.locate_dofs_topological(V.sub(axis), 2, ft.find(tag))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(axis)))
        u.append(body.u)
        F.append(body.F)
        sides.append((V, ft.find(6 - i)))
    contact = Contact(*sides, sliding=sliding, friction=friction)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    problem.solve()
    return problem, contact.pressures(problem)


@pytest.mark.parametrize("cell", ("hexahedron", "tetrahedron"))
def test_surfaces_that_fit(cell):
    """Curved on both sides; pressures at the nodes of degree 2 would be .3 to 1.6 of the mean."""
    _, p = quarter_cylinders(cell)
    assert np.abs(p / p.mean() - 1).max() <= 0.06


@pytest.mark.ranks(2)
@pytest.mark.parametrize("friction", (None, 0.2))
def test_equilibrium_at_kinks(friction):
    """Gaps have kinks where both outlines are one: forces between those of both sides balance."""
    problem, p = quarter_cylinders("hexahedron", (4, 9), (2, 3), "finite", friction)
    assert problem.iterations <= 6
    assert problem.halvings == 0
    assert (p > 0).all()
    contact = problem.contacts[0]
    rows = problem.rows(contact)
    every = zip(problem.F, contact.spaces, rows.sides, rows.contact_forces(), strict=True)
    for F, V, side, force in every:  # what contact does to a body is what the body resists
        b = fem.assemble_vector(F)
        b.scatter_reverse(la.InsertMode.add)
        start, end = V.dofmap.index_map.local_range
        mine = (side.dofs >= start) & (side.dofs < end)
        left, x = b.array.reshape(-1, 3)[: end - start], V.tabulate_dof_coordinates()[: end - start]
        size = np.abs(left).max()
        left[side.dofs[mine] - start] -= force[mine]
        held = np.isclose(x, 0)  # planes of symmetry, and z = 1
        held[:, 2] |= np.isclose(x[:, 2], 1)
        assert np.abs(left[~held]).max(initial=0) <= 1e-7 * size


def integral(f):
    """Over all ranks."""
    return comm.allreduce(fem.assemble_scalar(fem.form(f * ufl.dx)), MPI.SUM)


def top_of(kind, degree, n=(7, 6)):
    """The top of a square or cube, with multipliers at the nodes of the degree."""
    if kind == "edges":
        body = rectangle((9, 2), (0, 0), (1, 1), degree=degree)
        V, facets = body.V, body.facets(meshes.TOP)
    else:
        cell = CellType.tetrahedron if kind == "triangles" else CellType.hexahedron
        mesh = create_box(comm, [(0, 0, 0), (1, 1, 1)], (*n, 1), cell)
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        facets = locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[2], 1))
    surface = create_surface(V, facets, "Γ1")
    return MovingSurface(surface.split if degree == 2 else surface)


def moments(side, s, root):
    """Forces at the side's dofs of the pressure √s, s linear on facets, or of a linear one."""
    surface, found = side.reference, np.zeros((len(side.dofs), side.reference.gdim))
    corners = simplices(surface.geometry.cell_type, 96 if surface.gdim == 2 else 40)
    X, every = corners.mean(axis=1), np.arange(len(surface.facets))
    N = hats(surface, X).T
    linear = np.sqrt(np.maximum(s, 0))[surface.facets] @ N
    p = np.where(root[:, None], np.sqrt(np.maximum(s[surface.facets] @ N, 0)), linear)
    parts = surface.functions(X)[every % surface.num_parts]
    weight = 0.5 if surface.geometry.cell_type.name == "triangle" else 1.0
    normals = _normals(surface, every, X) * weight / len(X)
    np.add.at(found, side.at_facets, -np.einsum("fq,fqd,fqi->fdi", p, parts, normals))
    return found


def mean_gaps(x, edge):
    """Means of gaps like d^1.5 over hat functions, in the plane."""
    t, order, found = np.linspace(x.min(), x.max(), 200_001), np.argsort(x), np.empty(len(x))
    for v in order:
        hat = np.interp(t, x[order], order == v)
        found[v] = (hat * np.maximum(t - edge, 0) ** 1.5).sum() / hat.sum()
    return found


@pytest.mark.parametrize("degree", (1, 2))
@pytest.mark.parametrize("kind", ("edges", "triangles", "quadrilaterals"))
def test_root_at_a_free_edge(kind, degree):
    """A root that ends within facets is found from its moments and from vertices inside.

    In other units of stress it is the same.
    """
    side = top_of(kind, degree)
    surface = side.reference
    x = surface.x[:, 0] + (0.3 * surface.x[:, 1] if kind != "edges" else 0)
    s = 0.73 - x
    active = s > 0
    p = np.sqrt(np.maximum(s, 0))
    forces = np.zeros((len(side.dofs), surface.gdim))
    gaps = mean_gaps(x, 0.73) if kind == "edges" else 0 * x
    state = ContactState(side, surface, p, active, np.ones_like(active), gaps, forces)
    near = _near_free_edges(state)[0][surface.facets].any(axis=1)
    state = replace(state, forces=moments(side, s, near))
    found, unit = SurfacePressure.of(state), 2.0**30
    scaled = SurfacePressure.of(replace(state, p=unit * p, forces=unit * state.forces))
    np.testing.assert_allclose(scaled.s / unit**2, found.s, rtol=0, atol=1e-12)
    inside = np.zeros_like(active)
    inside[surface.facets[active[surface.facets].any(axis=1)]] = True
    assert near.any() and np.abs(found.s - s)[inside].max() <= 5e-3
    noise = np.random.default_rng(0).uniform(0, 2, forces.shape)
    rough = replace(state, forces=noise * state.forces)  # what no root has
    drawn = [SurfacePressure.of(given, MISSED_ROOT).near.any() for given in (state, rough)]
    assert drawn == [True, False]


@pytest.mark.parametrize("kind", ("edges", "triangles"))
def test_no_root(kind):
    """Where pressure rises towards its edge, or where a surface ends, there is none."""
    side = top_of(kind, 1)
    x = side.reference.x[:, 0]
    active, none = x < 0.6, np.zeros((len(side.dofs), side.reference.gdim))
    for p, exists in ((1 + x, x < 2), (1 - x, active)):
        given = ContactState(side, side.reference, p * active, active, exists, 0 * x, none)
        found = SurfacePressure.of(given)
        assert not found.near.any()


@pytest.mark.ranks(2, cell=["tetrahedron"])
@pytest.mark.parametrize("degree", (1, 2))
@pytest.mark.parametrize("cell", ("hexahedron", "tetrahedron"))
def test_first_touch(cell, degree):
    """Of a round surface, at one vertex: its pressure is as it is, and its force isn't lost."""
    u, F, bcs, sides = [], [], [], []
    kind = CellType.hexahedron if cell == "hexahedron" else CellType.tetrahedron
    for i, (low, n) in enumerate((((-2, -2, 0), (6, 6, 1)), ((-1, -1, 1), (4, 4, 2)))):
        mesh = create_box(comm, [low, (-low[0], -low[1], i + 1)], n, kind)
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        touching, away = (
            locate_entities_boundary(mesh, 2, lambda x, z=z: np.isclose(x[2], z))
            for z in (1, 2 * i)
        )
        x = mesh.geometry.x
        x[:, 2] += 0.08 * i * (x[:, :2] ** 2).sum(axis=1) * (2 - x[:, 2])
        body = Elastic.on(V)
        u.append(body.u)
        F.append(body.F)
        at = fem.locate_dofs_topological(V, 2, away)
        bcs.append(fem.dirichletbc(default_scalar_type((0, 0, -0.03 * i)), at, V))
        sides.append((V, touching))
    contact = Contact(*sides)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    problem.solve()
    p = contact.pressure(problem, on="surface")
    largest = comm.allreduce(p.x.array.max(initial=0), MPI.MAX)
    assert contact.active.sum() == 1, contact.active.sum()
    assert abs(largest / contact.pressures(problem).max() - 1) <= 1e-9
    assert abs(integral(p) / contact.force(problem)[2] - 1) <= 0.01


@pytest.mark.parametrize("kind", ("edges", "triangles"))
def test_touching_without_load(kind):
    """A second region whose pressures are all zero has none, and the first one's stay numbers."""
    side = top_of(kind, 2)
    x = side.reference.x[:, 0]
    active, none = (x < 0.3) | (x > 0.8), np.zeros((len(side.dofs), side.reference.gdim))
    exists = np.ones_like(active)
    given = ContactState(
        side, side.reference, 1.0 * (x < 0.3), active, exists, np.where(active, 0, x), none
    )
    found = SurfacePressure.of(given)
    assert found.near.any() and np.isfinite(found.s).all()
    assert not found.s[x > 0.8].any()


def test_scattered_pressures():
    """Parts of an edge beyond which nothing says how slopes go on: s stays there as it is."""
    rng, side = np.random.default_rng(0), top_of("quadrilaterals", 1)
    x, none = side.reference.x[:, 0], np.zeros((len(side.dofs), 3))
    active = x < 0.6
    for _ in range(20):
        p = rng.uniform(0.1, 1, len(x)) * active
        found = SurfacePressure.of(
            ContactState(side, side.reference, p, active, x < 2, np.where(active, 0, x), none)
        )
        assert np.isfinite(found.s).all()


@pytest.mark.parametrize("apart", (False, True))
@pytest.mark.parametrize("degree", (1, 2))
def test_steps_are_sparse(monkeypatch, degree, apart):
    """Rough contact, in one or many parts: steps with total forces as those of a dense matrix."""
    side = top_of("quadrilaterals", degree, (24, 24))
    x, entries = side.reference.x, []
    s = np.cos(13 * x[:, 0]) * np.cos(13 * x[:, 1]) + (-0.7 if apart else 0.1)
    active, forces = s > 0, np.zeros((len(side.dofs), 3))
    p = np.sqrt(np.maximum(s, 0))
    state = ContactState(side, side.reference, p, active, s < 9, 0 * s, forces)
    free = _near_free_edges(state)[0]
    near = free[side.reference.facets].any(axis=1)
    mean, part = _parts(state, near)
    assert (len(np.unique(part[mean > 0])) > 1) == apart
    fit = _RootFit(state, free, near, mean, part)
    error, J = fit._errors(s)

    def solved(A, b):
        entries.append(len(A.summed.i))
        return _solved(A, b)

    monkeypatch.setattr("hypergap_dolfinx.mortar.free_edges._solved", solved)
    found = fit._least(J, error, free, 1e-3)
    dense = np.zeros((len(error), len(s)))
    dense[J.i, J.j] = J.values
    A = (dense.T @ dense)[np.ix_(free, free)]
    A += np.diag(1e-3 * A.diagonal() + 1e-12 * A.diagonal().max())
    step = np.linalg.solve(A, error @ dense[:, free])
    assert np.abs(found[free] - step).max() <= 1e-12 * np.abs(step).max()
    assert entries[0] <= 30 * free.sum() <= 0.2 * free.sum() ** 2


@pytest.mark.parametrize("degree", (1, 2))
@pytest.mark.parametrize("kind", ("edges", "triangles", "quadrilaterals"))
def test_opening_beyond_an_edge(kind, degree):
    """Gaps that are means over hat functions of 4/3E* k^.5 d^1.5 give s = -k d at open vertices."""
    side = top_of(kind, degree)
    surface = side.reference
    s = 0.69 - surface.x[:, 0] - (0.3 * surface.x[:, 1] if kind != "edges" else 0)
    active, k = s > 0, 1.0 if kind == "edges" else np.hypot(1, 0.3)
    X = simplices(surface.geometry.cell_type, 30).mean(axis=1)
    N, (gaps, areas) = hats(surface, X), np.zeros((2, len(s)))
    d = np.maximum(-s[surface.facets] @ N.T, 0) / k
    size = np.linalg.norm(_normals(surface, np.arange(len(d)), X), axis=2)
    np.add.at(gaps, surface.facets, (2.5 * 4 / 3 * np.sqrt(k) * d**1.5 * size) @ N)
    np.add.at(areas, surface.facets, size @ N)
    gaps, none = np.where(active, 0, gaps / areas), np.zeros((len(side.dofs), surface.gdim))
    p = np.sqrt(np.maximum(s, 0))
    state = ContactState(side, surface, p, active, s < 9, gaps, none, 2.5)
    opening = _Opening(state, np.ones_like(active))
    assert len(opening.w) and np.abs(opening.values(s) - s[opening.w]).max() <= 2e-3
    # Forces that are off, and a vertex in contact without pressure: no law
    near = _near_free_edges(state)[0]
    noise = np.random.default_rng(0).uniform(0.9, 1.1, (len(none), 1))
    forces = moments(side, s, near[surface.facets].any(axis=1)) * noise
    known = replace(state, forces=forces)
    alone, found = (SurfacePressure.of(replace(known, compliance=c)).s for c in (0, 2.5))
    before, after = (np.abs(x - s)[opening.w].mean() for x in (alone, found))
    assert after <= 0.7 * before
    some = np.flatnonzero(active & near)[0]
    forces[side.at_facets[(surface.facets == some).any(axis=1)]] = 0
    alone, found = (SurfacePressure.of(replace(known, compliance=c)).s for c in (0, 2.5))
    assert alone[some] <= 0 and (found == alone).all()


@pytest.mark.parametrize("kind", ("edges", "triangles", "quadrilaterals"))
def test_root_where_pressures_rise(kind):
    """Towards a smooth edge, with gaps of its root; where they open as beside a corner, none."""
    side = top_of(kind, 2)
    surface, x = side.reference, side.reference.x[:, 0]
    s = 0.69 - x
    p, active = np.sqrt(np.maximum(s, 0)), s > 0
    gaps = 4 / 3 * (mean_gaps(x, 0.69) if kind == "edges" else np.maximum(-s, 0) ** 1.5)
    forces = np.zeros((len(side.dofs), surface.gdim))
    state = ContactState(side, surface, p, active, s < 9, gaps, forces, 1.0)
    near = _near_free_edges(state)[0][surface.facets].any(axis=1)
    rises = np.where(x > x[active].max() - 1e-6, active, p)
    state = replace(state, p=rises, forces=moments(side, s, near))
    corner = replace(state, gaps=30 * gaps)
    unknown = replace(state, compliance=0.0)
    drawn = [SurfacePressure.of(part).near.any() for part in (state, corner, unknown)]
    assert drawn == [True, False, False]


@pytest.mark.parametrize("edge", (0.5, 0.55, 0.66, 0.7))
def test_edge_by_gaps(edge):
    """Gaps that are means over hat functions of d^1.5 give the edge, between nodes as on them."""
    side = top_of("edges", 1)
    nodes = np.concatenate(([0, 0.1, 0.2, 0.5, 0.7, 0.85, 0.98], np.linspace(1.1, 2, 3)))
    x = np.zeros_like(side.reference.x)
    x[np.argsort(side.reference.x[:, 0]), 0] = nodes
    active, surface = x[:, 0] < 0.6, replace(side.reference, x=x)
    gaps = np.where(active, 0, 3 * mean_gaps(x[:, 0], edge))
    state = ContactState(side, surface, 1 - x[:, 0], active, x[:, 0] < 3, gaps, x)
    (v, w), share = edges_by_gaps(state)
    assert x[v, 0] == 0.5 and x[w, 0] == 0.7
    assert np.abs(0.5 + share * 0.2 - edge).max() <= 1e-6
    nearly = replace(state, gaps=gaps * np.where(x[:, 0] > 0.8, 1, 1e-9))  # an edge beyond its node
    assert np.abs(edges_by_gaps(nearly)[1] - 1).max() <= 1e-9
    ends = replace(state, exists=x[:, 0] < 0.8)
    assert not edges_by_gaps(ends)[1].size


@pytest.mark.ranks(2, degree=[2])
@pytest.mark.parametrize(("degree", "bound"), ((1, 0.029), (2, 0.006)))
def test_hertz(degree, bound):
    """Edges on a node and within facets; without the sums and the edge by gaps 3.9e-2, 2.0e-2."""
    found = []
    for division in (3, 3.375, 3.625):
        problem, contact = hertz.press(comm, hertz.a / division, degree, 2 / 3, False)
        found.append(hertz.surface_error(problem, contact))
        p = contact.pressure(problem, on="surface")
        assert p.x.array.min(initial=0) >= 0
        assert abs(2 * integral(p) / hertz.P[2] - 1) <= 0.006
        compliance = problem.half_space_compliance(problem.rows(contact))
        assert abs(compliance * hertz.E_star - (degree > 1)) <= 1e-9
        edge = ufl.conditional(ufl.gt(p, 1e-9), 1, 0)
        assert abs(integral(edge) / hertz.a - 1) <= 0.06
        problem.destroy()
    assert np.mean(found) <= bound


@pytest.mark.parametrize("wide", (False, True))
def test_punch_without_root(wide):
    """Pressure is singular at its corners: as at vertices, linear between; it ends with Γ0."""
    contact, problem, force = press_punch(0.3, wide)
    p = contact.pressure(problem, on="surface")
    assert abs(integral(p) / force - 1) <= 1e-5
    mesh, found = p.function_space.mesh, contact.pressures(problem)
    cells = mesh.topology.index_map(1).size_global
    assert (cells == len(contact.surfaces[1].facets)) is not wide
    assert wide or abs(p.x.array.max(initial=0) / found.max() - 1) <= 1e-14


@pytest.mark.ranks(2, kinds=[("triangle", "quadrilateral"), ("tetrahedron", "hexahedron")])
@pytest.mark.parametrize("degree", (1, 2))
@pytest.mark.parametrize(
    "kinds",
    (("triangle", "quadrilateral"), ("tetrahedron", "hexahedron"), ("hexahedron", "tetrahedron")),
)
def test_surface_that_ends_within_facets(kinds, degree):
    """Integrals of pressure and shear are the force: Γ0 covers facets in part, none of some."""
    n = 2 + (kinds[0] not in ("triangle", "quadrilateral"))
    u, F, bcs, sides = [], [], [], []
    for i, (low, high, num) in enumerate(
        (((0, 0, 0), (3, 3, 1), 4), ((0.9, 0.9, 1), (2, 2, 2), 2))
    ):
        corners = [np.array(x)[-n:] for x in (low, high)]
        create = create_rectangle if n == 2 else create_box
        kind = CellType[kinds[i]]
        mesh = create(comm, corners, [num] * (n - 1) + [2 if i else 1], kind)
        V = fem.functionspace(mesh, ("Lagrange", degree, (n,)))
        body = Elastic.on(V)
        u.append(body.u)
        F.append(body.F)
        touching, away = (
            locate_entities_boundary(mesh, n - 1, lambda x, z=z: np.isclose(x[n - 1], z))
            for z in (1, 2 * i)
        )
        moved = fem.Constant(mesh, default_scalar_type((0,) * n))
        bcs.append(fem.dirichletbc(moved, fem.locate_dofs_topological(V, n - 1, away), V))
        sides.append((V, touching))
    contact = Contact(*sides[::-1], friction=0.2, sliding="small")
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    moved.value[-1], moved.value[0] = -2e-6, 1e-6  # so that displaced areas are as they were
    problem.solve()
    force = contact.force(problem, on=u[1])
    p, q = (get(problem, on="surface") for get in (contact.pressure, contact.shear))
    assert abs(integral(p) / force[-1] - 1) <= 1e-6
    assert abs(integral(q[0]) / force[0] + 1) <= 1e-6
    area = integral(fem.Constant(p.function_space.mesh, default_scalar_type(1)))
    assert abs(area / 3 ** (n - 1) - 1) <= 1e-6


def test_flat_surfaces():
    """A uniform pressure is the same everywhere; shear is in proportion to it."""
    scene = Blocks(degree=2, n=(3, 4), held=False, walls=True, friction=0.3)
    scene.load.value = 0.05
    scene.problem.solve()
    for on in ("surface", "body"):
        p = scene.contact.pressure(scene.problem, on=on)
        most = p.x.array.max(initial=0)
        assert abs(most / 0.05 - 1) <= 1e-11
    q = scene.contact.shear(scene.problem, on="surface")
    assert np.abs(q.x.array).max(initial=0) <= 1e-10
    with pytest.raises(ValueError, match='"surface"'):
        scene.contact.pressure(scene.problem, on="facets")
