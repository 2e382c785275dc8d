# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Ties across a distance: periodic cells, whose faces share edges and corners, and sectors."""

import numpy as np
import pytest
from assembly import NU, SOLVED, Body, comm, dense, is_regular, rectangle
from helpers import interpolated, raises, residual, two_ranks

import dolfinx
import meshes
import ufl
from basix.ufl import mixed_element
from dolfinx import default_scalar_type, fem
from dolfinx.fem import petsc
from hypergap_dolfinx import InterfaceError, SolveError, Tie, TiedProblem
from hypergap_dolfinx.algebra.rigid_motions import free_motions
from meshes import BACK, BOTTOM, END, FRONT, LEFT, RIGHT, START, TOP

FACES = (LEFT, RIGHT), (BOTTOM, TOP), (BACK, FRONT)
LAME, MU = NU / ((1 + NU) * (1 - 2 * NU)), 1 / (2 * (1 + NU))


def apart(x):
    """Nodes of opposite faces of a unit cell to differing places."""
    y = x.copy()
    for i in range(x.shape[1]):
        y[:, i] += 0.3 * x[:, i] * (1 - x[:, i]) * (x[:, (i + 1) % x.shape[1]] - 0.4)
    return y


def held_at(V, *point):
    """A condition that holds the node at a point."""
    n = len(point)
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[:n].T, point).all(axis=1))
    value = np.zeros(V.value_shape, default_scalar_type) if V.value_shape else 0.0
    return fem.dirichletbc(value, dofs, V)


def opposite(V, ft, pairs=FACES, ways=None):
    """A tie for each direction of a unit cell, or of another one."""
    ways = np.eye(V.mesh.geometry.dim) if ways is None else ways
    return [
        Tie.periodic((V, ft.find(a)), (V, ft.find(b)), translation=way)
        for (a, b), way in zip(pairs, ways, strict=False)
    ]


def load(V, f):
    """∫ f · v with f interpolated."""
    shape = V.value_shape
    W = fem.functionspace(V.mesh, ("Lagrange", 4, shape))
    return ufl.inner(interpolated(W, f), ufl.TestFunction(V)) * ufl.dx


def error(u, exact):
    """Of the gradient, L²."""
    W = fem.functionspace(u.function_space.mesh, ("Lagrange", 4, u.function_space.value_shape))
    e = ufl.grad(u - interpolated(W, exact))
    return comm.allreduce(fem.assemble_scalar(fem.form(ufl.inner(e, e) * ufl.dx))) ** 0.5


def surrounded(body, L, exact, facets):
    """The solution with exact values on facets, and no tie."""
    dofs = fem.locate_dofs_topological(body.V, 1, facets)
    bcs = [fem.dirichletbc(interpolated(body.V, exact), dofs)]
    return TiedProblem([body.a], [L], bcs=bcs, ties=[]).solve()[0]


@two_ranks(cell=["triangle"], degree=[2])
@pytest.mark.parametrize(
    "cell, degree, mapping",
    (
        ("triangle", 2, apart),
        ("quadrilateral", 1, None),  # matching: constraints that are equal, at the corners
        ("quadrilateral", 2, apart),
        ("triangle", 3, apart),
    ),
)
def test_mean_strain(cell, degree, mapping):
    """An even body takes any mean strain evenly; the matrix serves all of them, and is regular."""
    body = rectangle((4, 5), (0, 0), (1, 1), cell=cell, degree=degree, mapping=mapping)
    strain, ties = np.zeros((2, 2)), []
    for (a, b), way in zip(FACES, np.eye(2), strict=False):
        sides = (body.V, body.facets(a)), (body.V, body.facets(b))
        ties.append(Tie.periodic(*sides, translation=way, jump=lambda x, t=way: strain @ t))
    L = ufl.inner(fem.Constant(body.mesh, np.zeros(2)), ufl.TestFunction(body.V)) * ufl.dx
    problem = TiedProblem([body.a], [L], bcs=[held_at(body.V, 0, 0)], ties=ties)
    problem.assemble_matrix()
    for strain[:] in np.random.default_rng(0).standard_normal((2, 2, 2)):
        problem.assemble_vector()
        (u,) = problem.solve_system()
        exact = interpolated(body.V, lambda x: strain @ x[:2])
        np.testing.assert_allclose(u.x.array, exact.x.array, atol=SOLVED)
    assert is_regular(problem)


def wave(x):
    """A periodic displacement, the gradient of a potential: −div σ is 8π² (λ + 2μ) times it."""
    a, b = 2 * np.pi * x[0] + 0.3, 2 * np.pi * x[1] - 0.4
    return np.array((np.cos(a) * np.cos(b), -np.sin(a) * np.sin(b)))


def test_smooth():
    """A periodic field, forced by loads: as good as with its values given all around."""
    body = rectangle((6, 7), (0, 0), (1, 1), cell="triangle", degree=2, mapping=apart)
    corner = wave(np.zeros((3, 1)))

    def exact(x):
        return wave(x) - corner

    L = load(body.V, lambda x: (LAME + 2 * MU) * 8 * np.pi**2 * wave(x))
    ties = opposite(body.V, body.ft)
    problem = TiedProblem([body.a], [L], bcs=[held_at(body.V, 0, 0)], ties=ties)
    (u,) = problem.solve()
    tied, alone = error(u, exact), error(surrounded(body, L, exact, body.boundary), exact)
    print(tied, alone)
    assert tied <= 1.05 * alone
    assert is_regular(problem)


@pytest.mark.parametrize("cell, degree, layers", (("tetrahedron", 2, 1), ("hexahedron", 1, 2)))
def test_space(cell, degree, layers):
    """A mean gradient of a scalar in a cube; 12 edges and 8 corners, and layers across x."""
    ends = (1.0,) if layers == 1 else (1 / 3, 1.0)

    def kept(x):
        y = apart(x)
        if layers > 1:  # where layers meet, all faces have nodes
            y[:, 0] = x[:, 0] + (y[:, 0] - x[:, 0]) * (3 * x[:, 0] - 1)
        return y

    mesh, ft = meshes.block(comm, (3, 3, 3), kept, cell=cell)
    V = fem.functionspace(mesh, ("Lagrange", degree))

    def layer(x):
        return np.searchsorted(ends, x - 1e-9)

    gradient, ties = np.array((0.3, -1.0, 0.6)), []
    for (a, b), way in zip(FACES, np.eye(3), strict=True):
        sides = [ft.find(a), ft.find(b)]
        at = [layer(dolfinx.mesh.compute_midpoints(mesh, 2, facets)[:, 0]) for facets in sides]
        for k in range(layers) if a != LEFT else (None,):  # through TOP more heat goes in one layer
            pair = [
                (V, facets if k is None else facets[of == k])
                for facets, of in zip(sides, at, strict=True)
            ]
            options = {"translation": way, "jump": gradient @ way, "discontinuous": k is not None}
            ties.append(Tie.periodic(*pair, **options))
    # In layers u is linear; what flows across them is the same in all
    conductivity = np.array((1.0, 20.0))[:layers]
    slope = 0.3 / conductivity / (np.diff(ends, prepend=0) @ (1 / conductivity))
    k = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    k.x.array[:] = conductivity[layer(k.function_space.tabulate_dof_coordinates()[:, 0])]
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = k * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    problem = TiedProblem([a], [fem.Constant(mesh, 0.0) * v * ufl.dx], ties=ties,
                          bcs=[held_at(V, 0, 0, 0)])  # fmt: skip
    (found,) = problem.solve()

    def exact(x):
        i = layer(x[0])
        start = np.append(0, ends)[i]
        return (slope[0] * ends[0] * (i > 0) + slope[i] * (x[0] - start)) + gradient[1:] @ x[1:]

    np.testing.assert_allclose(found.x.array, interpolated(V, exact).x.array, atol=SOLVED)
    assert is_regular(problem)


def sector(n, angle, degree=2):
    """A sector of a ring of radii 1/2 and 1, whose sides are meshed differently."""

    def polar(x):
        r = 0.5 + 0.5 * (x[:, 0] + 0.6 * x[:, 0] * (1 - x[:, 0]) * (x[:, 1] - 0.4))
        return np.column_stack((r * np.cos(angle * x[:, 1]), r * np.sin(angle * x[:, 1])))

    return rectangle(n, (0, 0), (1, 1), cell="triangle", degree=degree, mapping=polar)


def cyclic(body, angle, **options):
    sides = (body.V, body.facets(BOTTOM)), (body.V, body.facets(TOP))
    return Tie.periodic(*sides, rotation=angle, **options)


def spinning(x):
    """The displacement of a ring of radii 1/2 and 1 that spins, plane strain."""
    a, b, M = 0.5, 1.0, LAME + 2 * MU
    # u = C r + D / r − r³ / 8M, with no traction at both radii
    rows = [[M + LAME, (LAME - M) / r**2] for r in (a, b)]
    C, D = np.linalg.solve(rows, [(3 * M + LAME) * r**2 / (8 * M) for r in (a, b)])
    square = x[0] ** 2 + x[1] ** 2
    return (C + D / square - square / (8 * M)) * x[:2]


@pytest.mark.parametrize("degrees, n", ((30, 4), (45, 5), (90, 8)))
def test_spinning_ring(degrees, n):
    """A sector of it has the error of its mesh, as with exact values on its sides."""
    angle = np.radians(degrees)
    body = sector((4, n), angle)
    W, _ = body.V.sub(1).collapse()
    dofs = fem.locate_dofs_geometrical(
        (body.V.sub(1), W), lambda x: np.isclose(x[0], 0.5) & np.isclose(x[1], 0)
    )
    bcs = [fem.dirichletbc(fem.Function(W), dofs, body.V.sub(1))]
    L = load(body.V, lambda x: x[:2])
    problem = TiedProblem([body.a], [L], bcs=bcs, ties=[cyclic(body, angle)])
    (u,) = problem.solve()
    # Where one node holds its rotation, this has the error of that node
    turn = interpolated(body.V, lambda x: np.array((-x[1], x[0])))
    e = u - interpolated(fem.functionspace(body.mesh, ("Lagrange", 4, (2,))), spinning)
    forms = fem.form([ufl.inner(e, turn) * ufl.dx, ufl.inner(turn, turn) * ufl.dx])
    rotation = np.divide(*comm.allreduce(np.array([fem.assemble_scalar(f) for f in forms])))
    u.x.array[:] -= rotation * turn.x.array
    tied = error(u, spinning)
    alone = error(surrounded(body, L, spinning, body.facets((BOTTOM, TOP))), spinning)
    print(rotation, tied, alone)
    assert tied <= 1.15 * alone
    assert comm.size > 1 or is_regular(problem)


def test_modes_of_a_ring():
    """A quarter has those of the full ring that look the same from all four quarters."""

    def spectrum(bodies, B=None):
        """Of B[row][body], or without constraints."""
        found = []
        for body in bodies:
            u, v = ufl.TrialFunction(body.V), ufl.TestFunction(body.V)
            forms = fem.form([body.a, ufl.inner(u, v) * ufl.dx])
            matrices = [petsc.assemble_matrix(form) for form in forms]
            for matrix in matrices:
                matrix.assemble()
            found.append([dense(matrix) for matrix in matrices])
            for matrix in matrices:
                matrix.destroy()
        num = range(len(found))
        K, M = (
            np.block([[parts[i] * (i == j) for j in num] for i in num])
            for parts in zip(*found, strict=True)
        )
        if B is not None:
            B = np.block(B)
            Z = np.linalg.svd(B)[2][len(B) :].T
            K, M = Z.T @ K @ Z, Z.T @ M @ Z
        L = np.linalg.inv(np.linalg.cholesky(M))
        return np.sqrt(np.abs(np.linalg.eigvalsh(L @ K @ L.T)))

    def check(found, whole):
        nearest = whole[np.abs(whole - found[:, None]).argmin(axis=1)]
        np.testing.assert_allclose(found, nearest, rtol=1e-9, atol=1e-6)
        assert found[0] < 1e-6 < found[1]  # one rigid motion: it turns

    def ring(n, angle):
        mesh, ft = meshes.ring_sector(comm, n, 2, 0.5, 1, angle=angle)
        return Body(mesh, ft, fem.functionspace(mesh, ("Lagrange", 2, (2,))))

    def turned(body, angle):
        c, s = np.cos(angle), np.sin(angle)
        body.mesh.geometry.x[:, :2] @= np.array(((c, s), (-s, c)))
        return body

    quarter = ring(4, np.pi / 2)
    sides = (quarter.V, quarter.facets(START)), (quarter.V, quarter.facets(END))
    tie = Tie.periodic(*sides, rotation=np.pi / 2)
    B = sum(map(dense, tie.blocks()))
    check(spectrum([quarter], [[B]])[:12], spectrum([ring(16, 2 * np.pi)]))

    # Sides that are meshed differently, and the same sides tied to each other all around
    quarters = [turned(sector((2, 3), np.pi / 2), i * np.pi / 2) for i in range(4)]
    tie = cyclic(quarters[0], np.pi / 2)
    B = sum(map(dense, tie.blocks()))
    found = spectrum(quarters[:1], [[B]])[:8]
    B = []
    for i, j in ((0, 1), (1, 2), (2, 3), (3, 0)):
        sides = (quarters[j], BOTTOM), (quarters[i], TOP)
        tie = Tie(*((body.V, body.facets(tag)) for body, tag in sides))
        blocks = dict(zip((j, i), map(dense, tie.blocks()), strict=True))
        empty = np.zeros_like(blocks[i])
        B.append([blocks.get(k, empty) for k in range(4)])
    check(found, spectrum(quarters, B))


def oblique(n, degree, shape=(3,)):
    """A sector of 50° around an oblique axis in space, and what turns it."""
    axis, centre, angle = np.array((1.0, 2.0, -1.0)), np.array((0.3, -0.2, 0.1)), np.radians(50)
    frame, _ = np.linalg.qr(np.column_stack((axis, np.eye(3)[:, :2])))
    frame = np.roll(frame * np.sign(frame[:, 0] @ axis), 2, axis=1)
    frame[:, 0] *= np.linalg.det(frame)

    def placed(x):
        r, t = 1 + x[:, 0], angle * x[:, 1]
        z = x[:, 2] + 0.4 * x[:, 2] * (1 - x[:, 2]) * (x[:, 1] - 0.3)
        return centre + np.column_stack((r * np.cos(t), r * np.sin(t), z)) @ frame.T

    mesh, ft = meshes.block(comm, n, placed, cell="hexahedron")
    V = fem.functionspace(mesh, ("Lagrange", degree, shape))
    sides = (V, ft.find(BOTTOM)), (V, ft.find(TOP))
    tie = Tie.periodic(*sides, rotation=angle, axis=axis, centre=centre)
    return V, tie, axis / np.linalg.norm(axis), centre


@two_ranks()
def test_an_oblique_axis():
    """Fields that a rotation of 50° carries to themselves fulfil the tie, and others don't."""
    V, tie, axis, centre = oblique((2, 3, 4), 2)

    def even(x):
        """Swells, twists around the axis and is drawn along it; a torsion is no rotation."""
        r = x.T - centre
        along = (r @ axis)[:, None]
        return (0.3 * r + (0.7 + 0.4 * along) * np.cross(axis, r) + (0.2 - along) * axis).T

    u = interpolated(V, even)
    assert residual(tie, u, u) <= 1e-13
    gap, slip = tie.gap(u, u)
    q = tie.quadrature(2)
    assert max(np.abs(q.evaluate(f)).max(initial=0) for f in (gap, slip)) <= 1e-11
    other = interpolated(V, lambda x: np.outer((1, 0, 0), np.ones(x.shape[1])))
    assert residual(tie, other, other) > 0.1


def test_a_scalar_stays():
    V, tie, axis, centre = oblique((2, 2, 3), 1, shape=())
    T = interpolated(V, lambda x: (x.T - centre) @ axis)
    assert tie.turn is None
    assert residual(tie, T, T) <= 1e-13


def test_components_turn_together():
    body = sector((2, 3), 1.0, degree=1)
    for V in (
        body.V,
        fem.functionspace(body.mesh, mixed_element([body.V.ufl_element()] * 2)).sub(0),
    ):
        sides = (V.sub(0), body.facets(BOTTOM)), (V.sub(0), body.facets(TOP))
        with raises(InterfaceError, "a rotation turns vectors as a whole"):
            Tie.periodic(*sides, rotation=1.0)


def num_free(body, ties):
    zero = ufl.inner(fem.Constant(body.mesh, np.zeros(2)), ufl.TestFunction(body.V)) * ufl.dx
    problem = TiedProblem([body.a], [zero], ties=ties)
    problem.assemble_matrix()
    with raises(SolveError, "rigid motion"):
        problem.solve()
    return free_motions([body.V], problem._K, problem._constraints)[0]


@two_ranks()
def test_free_motions():
    """A cell is free to move, a sector to turn; with both it is neither."""
    body = rectangle((3, 4), (0, 0), (1, 1), mapping=apart)
    ties = opposite(body.V, body.ft)
    assert num_free(body, ties) == 2
    assert num_free(body, ties[1:]) == 2
    body = sector((3, 4), np.pi / 3)
    assert num_free(body, [cyclic(body, np.pi / 3)]) == 1
    # Faces that are nearer to each other than cells are long are across a distance too
    body = sector((2, 1), np.radians(5))
    assert num_free(body, [cyclic(body, np.radians(5))]) == 1
    body = rectangle((2, 3), (0, 0), (10, 1))
    (tie,) = opposite(body.V, body.ft, pairs=FACES[1:2], ways=[(0, 1)])
    assert num_free(body, [tie]) == 2


@two_ranks()
def test_pieces():
    """A face given in parts is one interface, with the motion that all have."""
    angle = np.radians(40)

    def polar(x):
        r = 0.5 + 0.5 * x[:, 0]
        return np.column_stack((r * np.cos(angle * x[:, 1]), r * np.sin(angle * x[:, 1])))

    body = rectangle((4, 3), (0, 0), (1, 1), cell="triangle", mapping=polar)
    L = load(body.V, lambda x: np.array((np.sin(7 * x[1]), x[0] * x[1])))
    pieces, solutions = [], []
    for sign in (-1, 1):
        faces = []
        for tag in (BOTTOM, TOP):
            facets = body.facets(tag)
            r = np.linalg.norm(dolfinx.mesh.compute_midpoints(body.mesh, 1, facets), axis=1)
            faces.append((body.V, facets[sign * (r - 0.75) > 0]))
        pieces.append(Tie.periodic(*faces, rotation=angle))
    for ties in ([cyclic(body, angle)], pieces):
        problem = TiedProblem([body.a], [L], bcs=[held_at(body.V, 0.5, 0)], ties=ties)
        solutions.append(problem.solve()[0].x.array.copy())
        assert len(problem._pieces.interfaces) == 1
    np.testing.assert_allclose(*solutions, atol=SOLVED)


@pytest.mark.ranks(2, given=[{"translation": (1.01, 0)}])
@pytest.mark.parametrize(
    "error, message, given",
    (
        (ValueError, "takes a translation or a rotation", {}),
        (ValueError, "takes a translation or", {"translation": (1, 0), "rotation": 1}),
        (ValueError, "2 numbers", {"translation": (1, 0, 0)}),
        (ValueError, "centre and axis", {"translation": (1, 0), "centre": (0, 0)}),
        (ValueError, "centre of a rotation is 2 numbers", {"rotation": 1, "centre": (0, 0, 0)}),
        (ValueError, "radians", {"rotation": 90}),
        (ValueError, "reflection", {"rotation": [[1, 0], [0, -1]]}),
        (ValueError, "no rotation", {"rotation": [[1, 0.1], [0, 1]]}),
        (ValueError, "in space", {"rotation": 1, "axis": (0, 0, 1)}),
        (InterfaceError, "misses by .-0.01, 0.; .1, 0. would not", {"translation": (1.01, 0)}),
        (InterfaceError, "misses by .2, 0.; .1, 0. would not", {"translation": (-1, 0)}),
        (InterfaceError, "the rotation carries Γ0 from", {"rotation": 1.5}),
        (InterfaceError, "neither adjusts", {"translation": (1, 0), "adjust": True}),
    ),
)
def test_bad_input(error, message, given):
    body = rectangle((2, 3), (0, 0), (1, 1), mapping=apart)
    with raises(error, message):
        Tie.periodic((body.V, body.facets(LEFT)), (body.V, body.facets(RIGHT)), **given)


def test_part_of_a_face():
    body = rectangle((2, 4), (0, 0), (1, 1))
    facets = body.facets(LEFT)[1:]
    with raises(InterfaceError, r"carries Γ0 from .* misses by 0.25"):
        Tie.periodic((body.V, facets), (body.V, body.facets(RIGHT)), translation=(1, 0))


def test_contradiction():
    """Prescribed displacements of both sides are compared as the tie compares them."""
    body = sector((2, 3), np.pi / 2, degree=1)
    zero = ufl.inner(fem.Constant(body.mesh, np.zeros(2)), ufl.TestFunction(body.V)) * ufl.dx

    def held(tag, component, value):
        W, _ = body.V.sub(component).collapse()
        dofs = fem.locate_dofs_topological((body.V.sub(component), W), 1, body.facets(tag))
        f = interpolated(W, lambda x: np.full(x.shape[1], value))
        return fem.dirichletbc(f, dofs, body.V.sub(component))

    # Γ1 is held in both directions, Γ0 along itself: what the other one is there, the tie says
    bcs = [held(BOTTOM, 0, 1.0), held(TOP, 1, 1.0), held(TOP, 0, 0.3)]
    TiedProblem([body.a], [zero], bcs=bcs, ties=[cyclic(body, np.pi / 2)]).solve()
    with raises(InterfaceError, "contradict"):
        ties = [cyclic(body, np.pi / 2, jump=(0, 0.1))]
        TiedProblem([body.a], [zero], bcs=bcs, ties=ties).solve()
