# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""3D interfaces of every kind: closed, with edges and corners, with holes, in several patches."""

from itertools import product

from mpi4py import MPI

import numpy as np
import pytest
from helpers import sweep

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import exterior_facet_indices, locate_entities_boundary
from hypergap_dolfinx import Tie, TiedProblem

comm = MPI.COMM_WORLD
NU = 0.3


def linear(x):
    """Every component of the gradient."""
    return (
        0.3 * x[0] - 0.2 * x[1] + 0.1 * x[2],
        0.5 * x[0] + 0.4 * x[1] - 0.3 * x[2],
        0.2 * x[0] + 0.1 * x[1] - 0.6 * x[2],
    )


def bending(x):
    return (
        x[0] * x[1],
        -(x[0] ** 2 + NU * (x[1] ** 2 - x[2] ** 2)) / 2,
        -NU * x[1] * x[2],
    )


def quadratic(x):
    """Both of these: exact if and only if each of them is."""
    return tuple(sum(parts) for parts in zip(linear(x), bending(x), strict=True))


def stress(u, E=1.0):
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + NU) * (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(3))


def tied(bodies, exact, degree, *, swap=False, E=(1.0, 1.0)):
    """Solve for an exact displacement: prescribed on some facets, else its traction is the load.

    Args:
        bodies: Of each, the mesh, the interface's facets and the facets to hold.
        exact: The displacement, a function of a UFL coordinate or an array; one for each body or
            one for all.
        degree: Degree of each space.
        swap: Whether the first body, which all others are tied to, is on Γ1.
        E: Young's moduli.

    Returns:
        The relative errors of displacement and stress, the problem and the first tie.
    """
    exacts = exact if isinstance(exact, tuple) else (exact,) * len(bodies)
    forms, loads, bcs, sides = [], [], [], []
    for (mesh, facets, held), e, k, modulus in zip(bodies, exacts, degree, E, strict=True):
        V = fem.functionspace(mesh, ("Lagrange", k, (3,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        x, n = ufl.SpatialCoordinate(mesh), ufl.FacetNormal(mesh)
        modulus = fem.Constant(mesh, default_scalar_type(modulus))  # one kernel for all values
        mesh.topology.create_connectivity(2, 3)
        loaded = exterior_facet_indices(mesh.topology)
        loaded = loaded[~np.isin(loaded, np.concatenate((facets, held)))]
        ds = ufl.Measure("ds", mesh, subdomain_data=[(1, integration_entities(mesh, loaded))])
        t = ufl.dot(stress(ufl.as_vector(e(x)), modulus), n)
        forms.append(ufl.inner(stress(u, modulus), ufl.sym(ufl.grad(v))) * ufl.dx)
        loads.append(ufl.dot(t, v) * ds(1))
        g = fem.Function(V)
        g.interpolate(lambda x, e=e: np.array(e(x)))
        bcs.append(fem.dirichletbc(g, fem.locate_dofs_topological(V, 2, held)))
        sides.append((V, facets))
    ties = [Tie(*((other, sides[0]) if swap else (sides[0], other))) for other in sides[1:]]
    problem = TiedProblem(forms, loads, bcs=bcs, ties=ties)
    return *errors(problem.solve(), exacts, E), problem, ties[0]


def integration_entities(mesh, facets):
    """What ``subdomain_data`` takes: cells and local facet numbers."""
    topology = mesh.topology
    topology.create_connectivity(3, 2)
    owned = facets[facets < topology.index_map(2).size_local]
    to_cells, to_facets = topology.connectivity(2, 3), topology.connectivity(3, 2)
    cells = to_cells.array[to_cells.offsets[owned]]
    num_facets = np.diff(to_facets.offsets)[0]
    facets_of = to_facets.array.reshape(-1, num_facets)[cells]
    local = np.argmax(facets_of == owned[:, None], axis=1)
    return np.column_stack((cells, local)).astype(np.int32).ravel()


def errors(us, exacts, E):
    totals = np.zeros(4)
    for u, e, modulus in zip(us, exacts, E, strict=True):
        u_exact = ufl.as_vector(e(ufl.SpatialCoordinate(u.function_space.mesh)))
        modulus = fem.Constant(u.function_space.mesh, default_scalar_type(modulus))
        dx = ufl.dx(metadata={"quadrature_degree": 6})
        for j, f in enumerate((u, fem.Function(u.function_space))):
            for i, d in enumerate((f - u_exact, stress(f, modulus) - stress(u_exact, modulus))):
                totals[2 * i + j] += fem.assemble_scalar(fem.form(ufl.inner(d, d) * dx))
    totals = comm.allreduce(totals)
    return np.sqrt(totals[0] / totals[1]), np.sqrt(totals[2] / totals[3])


NOTHING = np.empty(0, dtype=np.int32)


# A cube-shaped inclusion: six pieces that meet in edges and corners


def cube_in_cube(n, h):
    """A cube of structured cells in a hollow one."""
    outer, outer_tags = meshes.hollow_cube(comm, h)
    inner, inner_tags = meshes.block(comm, (n,) * 3, lambda x: 0.5 * (x - 0.5), cell="tetrahedron")
    return (
        (inner, inner_tags.indices, NOTHING),
        (outer, outer_tags.find(meshes.INNER), outer_tags.find(meshes.OUTER)),
    )


@pytest.mark.ranks(2, degree=[(1, 2)], swap=[True])
@pytest.mark.parametrize(
    "degree, swap",
    sweep(
        [
            ((2, 2), False),
            ((1, 1), False),
            ((1, 1), True),
            ((1, 2), True),
            ((1, 2), False),
            ((2, 2), True),
        ],
        3,
    ),
)
def test_cube_inclusion(degree, swap):
    exact = quadratic if degree == (2, 2) else linear
    for n, h in sweep(((2, 0.25), (3, 0.4)), 2):
        l2, s, _, tie = tied(cube_in_cube(n, h), exact, degree, swap=swap)
        print(l2, s)
        assert tie.domain.patch.max() == 5
        assert max(l2, s) < 1e-11


# A ball in a thick shell


def ball_in_shell(h, degree):
    """A ball of radius 1/2 in a shell up to radius 1, both isoparametric."""
    ball, ball_tags = meshes.spherical_shell(comm, h, 0.0, 0.5, octant=False, degree=degree)
    options = {"octant": False, "degree": degree}
    shell, shell_tags = meshes.spherical_shell(comm, 1.25 * h, 0.5, 1.0, **options)
    return (
        (ball, ball_tags.find(meshes.OUTER), NOTHING),
        (shell, shell_tags.find(meshes.INNER), shell_tags.find(meshes.OUTER)),
    )


def lame_ball(E_ball):
    """Displacements of a ball, k x, and a shell (E = 1) pressed at radius 1, A x + B x/r³.

    Both agree at r = 1/2, and so do the radial stresses.
    """
    k_ball = E_ball / (1 - 2 * NU)  # σ_rr = k_ball k
    k_shell, mu = 1 / (1 - 2 * NU), 1 / (2 * (1 + NU))  # σ_rr = k_shell A − 4 μ B / r³
    A, r3 = -1.0, 0.125
    B = r3 * A * (k_shell - k_ball) / (k_ball + 4 * mu)
    k = A + B / r3

    def inside(x):
        return tuple(k * x[i] for i in range(3))

    def outside(x):
        r = (x[0] ** 2 + x[1] ** 2 + x[2] ** 2) ** 0.5
        return tuple((A + B / r**3) * x[i] for i in range(3))

    return inside, outside


def shell_alone(h, exact):
    """Errors of the shell without a ball, its inner surface prescribed: what the mesh can do."""
    _, (mesh, facets, held) = ball_in_shell(h, 2)
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    g = fem.Function(V)
    g.interpolate(lambda x: np.array(exact(x)))
    everywhere = np.concatenate((facets, held))
    bc = fem.dirichletbc(g, fem.locate_dofs_topological(V, 2, everywhere))
    form = ufl.inner(stress(u), ufl.sym(ufl.grad(v))) * ufl.dx
    zero = ufl.inner(fem.Constant(mesh, np.zeros(3, dtype=default_scalar_type)), v) * ufl.dx
    return errors(TiedProblem([form], [zero], bcs=[bc]).solve(), (exact,), (1.0,))


@pytest.mark.parametrize(
    ("E_ball", "swap"),
    (
        pytest.param(1.0, False, marks=pytest.mark.slow),  # test_sphere is quicker
        pytest.param(10.0, True, marks=pytest.mark.slow),
        pytest.param(1.0, True, marks=pytest.mark.slow),
        pytest.param(10.0, False, marks=pytest.mark.slow),
    ),
)
def test_ball_in_shell(E_ball, swap):
    """One material: the field is linear. Two: no worse than the shell alone."""
    h, exact = 0.2, lame_ball(E_ball)
    l2, s, _, tie = tied(ball_in_shell(h, 2), exact, (2, 2), swap=swap, E=(E_ball, 1.0))
    print(l2, s)
    assert tie.domain.patch.max() == 0
    if E_ball == 1:
        assert l2 < 5e-5 and s < 2e-4
    else:
        l2_alone, s_alone = shell_alone(h, exact[1])
        assert l2 < 1.02 * l2_alone and s < 1.02 * s_alone


# Plates with a hole: two boundary loops


@pytest.mark.ranks(2, degree=[1])
@pytest.mark.parametrize("degree", sweep((1, 2), 2))
def test_plate_with_square_hole(degree):
    bodies = []
    for h, z, tag, held in (
        (0.2, (-0.3, 0.0), meshes.FRONT, meshes.BACK),
        (0.13, (0.0, 0.2), meshes.BACK, None),
    ):
        mesh, ft = meshes.perforated_plate(comm, h, z, square=True)
        bodies.append((mesh, ft.find(tag), ft.find(held) if held else NOTHING))
    for swap in (False, True):
        l2, s, *_ = tied(bodies, bending if degree == 2 else linear, (degree,) * 2, swap=swap)
        assert max(l2, s) < 1e-11


def test_plate_with_round_hole():
    """Polygons with different corners around the hole: what only one of them has isn't tied."""
    found = []
    for h in (0.2, 0.1):
        bodies = []
        for size, z, tag, held in (
            (h, (-0.3, 0.0), meshes.FRONT, meshes.BACK),
            (1.3 * h, (0.0, 0.2), meshes.BACK, None),
        ):
            mesh, ft = meshes.perforated_plate(comm, size, z)
            bodies.append((mesh, ft.find(tag), ft.find(held) if held else NOTHING))
        found.append(tied(bodies, linear, (1, 1))[:2])
    print(found)
    assert found[0][0] < 5e-3 and found[1][0] < found[0][0] / 1.8
    assert found[0][1] < 8e-3 and found[1][1] < found[0][1] / 1.8


# Several patches that don't touch


@pytest.mark.ranks
def test_two_patches():
    """Blocks that are tied in two strips, with a gap between the strips that nothing crosses."""
    bodies = []
    for n, x_to, tag, held in ((3, 0.5, meshes.RIGHT, meshes.LEFT), (6, 1.0, meshes.LEFT, None)):
        offset = x_to - 0.5

        def mapping(x, offset=offset):
            return np.column_stack((offset + 0.5 * x[:, 0], x[:, 1:]))

        mesh, ft = meshes.block(comm, (2, n, n), mapping, cell="tetrahedron")
        strips = np.concatenate(
            [
                locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 0.5) & inside(x[1]))
                for inside in (lambda y: y < 0.34, lambda y: y > 0.66)
            ]
        )
        rest = np.setdiff1d(ft.find(tag), strips)
        # What is left of the face is an open crack, prescribed on both sides
        bodies.append((mesh, strips, np.concatenate((ft.find(held) if held else NOTHING, rest))))
    l2, s, _, tie = tied(bodies, bending, (2, 2))
    assert tie.domain.patch.max() == 1
    assert max(l2, s) < 1e-11


# Materials, scalars, the mesh's units


def test_two_materials():
    """Oedometric strain across a skew-free interface: exact at any contrast."""
    for E1 in (1e-3, 1e3):
        bodies = []
        for n, tag, held in ((2, meshes.RIGHT, meshes.LEFT), (3, meshes.LEFT, meshes.RIGHT)):
            shift = 0 if tag == meshes.RIGHT else 1
            mesh, ft = meshes.block(
                comm, (2, n, n), lambda x, s=shift: x + np.array((s, 0, 0)), cell="tetrahedron"
            )
            bodies.append((mesh, ft.find(tag), ft.find(held)))
        # σ_xx = M ε, M ∝ E; other stresses differ from body to body and load the other faces
        factor = fem.Constant(bodies[1][0], default_scalar_type(1 / E1))  # one kernel for both

        def exact0(x):
            return x[0] - 1, 0 * x[0], 0 * x[0]

        def exact1(x, f=factor):
            f = f.value if isinstance(x, np.ndarray) else f
            return f * (x[0] - 1), 0 * x[0], 0 * x[0]

        l2, s, *_ = tied(bodies, (exact0, exact1), (1, 1), E=(1.0, E1))
        assert max(l2, s) < 1e-10


@pytest.mark.parametrize("scale", (1e-6, 1e6))
def test_units_of_length(scale):
    bodies = []
    for cells, tag, held in ((2, meshes.RIGHT, meshes.LEFT), (3, meshes.LEFT, None)):
        shift = 0 if held else 1

        def mapping(x, s=shift):
            return scale * (x + np.array((s, 0, 0)))

        mesh, ft = meshes.solid_block(comm, 1 / cells, mapping)
        bodies.append((mesh, ft.find(tag), ft.find(held) if held else NOTHING))
    l2, s, *_ = tied(bodies, linear, (1, 1))
    assert max(l2, s) < 1e-11


@pytest.mark.ranks
def test_scalar():
    """A linear temperature."""
    spaces, forms, loads, bcs, sides = [], [], [], [], []

    def exact(x):
        return 1 + 2 * x[0] - x[1] + 3 * x[2]

    for n, shift, tag in ((2, 0, meshes.RIGHT), (3, 1, meshes.LEFT)):
        mesh, ft = meshes.block(
            comm, (1, n, n), lambda x, s=shift: x + np.array((s, 0, 0)), cell="tetrahedron"
        )
        V = fem.functionspace(mesh, ("Lagrange", 1))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        zero = fem.Constant(mesh, default_scalar_type(0))
        forms.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        loads.append(zero * v * ufl.dx)
        g = fem.Function(V)
        g.interpolate(exact)
        held = np.setdiff1d(ft.indices, ft.find(tag)).astype(np.int32)
        bcs.append(fem.dirichletbc(g, fem.locate_dofs_topological(V, 2, held)))
        spaces.append(V)
        sides.append((V, ft.find(tag)))
    us = TiedProblem(forms, loads, bcs=bcs, ties=[Tie(*sides)]).solve()
    for u in us:
        g = fem.Function(u.function_space)
        g.interpolate(exact)
        assert np.abs(u.x.array - g.x.array).max() < 1e-12


@pytest.mark.ranks(n=[(4, 3)], degree=[1], swap=sweep((True, False), 2))
@pytest.mark.parametrize(
    ("swap", "degree", "n"), sweep(product((False, True), (1, 2), ((4, 3), (3, 4), (7, 3))), 2)
)
def test_sides_prescribed_all_around(n, degree, swap):
    """In corners whole facets are prescribed: λ follows its neighbours there."""
    bodies = []
    for i, tag in enumerate((meshes.FRONT, meshes.BACK)):
        mesh, ft = meshes.block(
            comm, (n[i],) * 3, lambda x, i=i: x + i * np.eye(3)[2], cell="tetrahedron"
        )
        held = [ft.find(other) for other in np.unique(ft.values) if other != tag]
        bodies.append((mesh, ft.find(tag), np.unique(np.concatenate(held))))
    l2, error, *_ = tied(bodies, bending if degree == 2 else linear, (degree,) * 2, swap=swap)
    # 5e-13 of the displacement has been seen; other BLAS libraries may make some times as much
    assert l2 <= 2e-11 and error <= 1e-10


def outside(n, tag, low, high, cell):
    """A block's mesh, its facets with a tag, and all others."""
    mesh, ft = meshes.block(comm, n, lambda x: low + x * np.subtract(high, low), cell=cell)
    return mesh, ft.find(tag), ft.indices[ft.values != tag]


@pytest.mark.ranks(2, cell=["hexahedron"])
@pytest.mark.parametrize("cell", ("tetrahedron", "hexahedron"))
def test_one_cell_wide(cell):
    """Γ1's rim is held, and what is left lies on a line: λ's slope across it was missing."""
    below = outside((1, 3, 2), meshes.RIGHT, (0, 0, 0), (1, 1, 1), cell)
    strip = outside((1, 1, 3), meshes.LEFT, (1, 0, 0), (2, 1, 1), cell)
    l2, error, *_ = tied((below, strip), quadratic, (2, 2))
    assert l2 <= 1e-12 and error <= 1e-11


def test_strips_side_by_side():
    """Their slopes are for the same dofs of Γ0, which has few."""
    bodies = [outside((1, 2, 2), meshes.RIGHT, (0, 0, 0), (1, 1, 1), "hexahedron")]
    for n, y in ((3, 0), (2, 0.5)):
        ends = (1, y, 0), (2, y + 0.5, 1)
        bodies.append(outside((1, 1, n), meshes.LEFT, *ends, "hexahedron"))
    l2, error, *_ = tied(bodies, quadratic, (2,) * 3, E=(1.0,) * 3)
    assert l2 <= 1e-12 and error <= 1e-11
