# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bad input that test_errors doesn't have: one line on every rank, and nothing left behind."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from assembly import Body, comm, linear, problem, rectangle, tie
from helpers import two_ranks

import basix
import dolfinx
import meshes
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import create_rectangle, locate_entities_boundary
from hypergap_dolfinx import (
    Contact,
    InterfaceError,
    NonlinearTiedProblem,
    SolveError,
    Tie,
    TiedProblem,
)
from hypergap_dolfinx.algebra import checks
from hypergap_dolfinx.core import compat
from meshes import BOTTOM, LEFT, RIGHT, TOP

TIED = [(0, TOP), (1, BOTTOM)]
HELD = [(0, BOTTOM, (0, 1))]


def raises(error, match, call):
    """The same line on every rank."""
    with pytest.raises(error, match=match) as info:
        call()
    message = str(info.value)
    assert "\n" not in message and len(message) > 20
    assert len(set(comm.allgather(message))) == 1


def blocks(**options):
    return [rectangle((n, 2), (0, i), (1, i + 1), **options) for i, n in enumerate((2, 3))]


def forms(bodies, E=(1.0, 1.0), load=(0.0, 0.0)):
    """Forms with coefficients."""
    a, L = [], []
    for body, e, f in zip(bodies, E, load, strict=True):
        modulus = fem.Constant(body.mesh, default_scalar_type(e))
        force = fem.Constant(body.mesh, default_scalar_type((f, 0)))
        a.append(modulus * body.a)
        L.append(ufl.inner(force, ufl.TestFunction(body.V)) * ufl.dx)
    return a, L


def held(body, tag, value=(0.0, 0.0)):
    dofs = fem.locate_dofs_topological(body.V, 1, body.facets(tag))
    return fem.dirichletbc(np.array(value, dtype=default_scalar_type), dofs, body.V)


@pytest.mark.ranks(2, number=[np.inf])
@pytest.mark.parametrize("number", (np.nan, np.inf, -np.inf))
@pytest.mark.parametrize("body", (0, 1))
def test_stiffness_that_is_no_number(body, number):
    bodies = blocks()
    E = [1.0, 1.0]
    E[body] = number
    a, L = forms(bodies, E=E)
    p = TiedProblem(a, L, bcs=[held(bodies[0], BOTTOM)], ties=[tie(bodies, *TIED)])
    raises(ValueError, f"^the stiffness of body {body} has NaN or infinite", p.solve)


@pytest.mark.ranks(2, number=[np.inf], body=[1])
@pytest.mark.parametrize("number", (np.nan, np.inf))
@pytest.mark.parametrize("body", (0, 1))
def test_load_that_is_no_number(body, number):
    bodies = blocks()
    load = [0.0, 0.0]
    load[body] = number
    a, L = forms(bodies, load=load)
    p = TiedProblem(a, L, bcs=[held(bodies[0], BOTTOM)], ties=[tie(bodies, *TIED)])
    raises(ValueError, f"^the load of body {body} has NaN or infinite", p.solve)


@pytest.mark.ranks(2, number=[np.inf])
@pytest.mark.parametrize("number", (np.nan, np.inf))
def test_prescribed_displacement_that_is_no_number(number):
    bodies = blocks()
    a, L = forms(bodies)
    bcs = [held(bodies[0], BOTTOM, (0.0, number))]
    p = TiedProblem(a, L, bcs=bcs, ties=[tie(bodies, *TIED)])
    raises(ValueError, "^the load of body 0 has NaN or infinite", p.solve)


@two_ranks(cell=["triangle"])
@pytest.mark.parametrize("cell", ("triangle", "quadrilateral"))
@pytest.mark.parametrize("body", (0, 1))
def test_cells_without_volume(body, cell):
    bodies = blocks(cell=cell)
    ties = [tie(bodies, *TIED)]
    x = bodies[body].mesh.geometry.x
    x[np.isclose(x[:, 1], body + 0.5), 1] = body + (0 if body else 1)
    a, L = forms(bodies)
    raises(
        ValueError,
        f"^body {body} has a cell without volume or turned over in part, at",
        lambda: TiedProblem(a, L, bcs=[held(bodies[0], BOTTOM)], ties=ties),
    )


@two_ranks(move=[(0.6, 0.0)])
@pytest.mark.parametrize("move", ((0.6, 0.0), (0.0, 0.6), (0.45, 0.45)))
def test_cells_turned_over_in_part(move):
    bodies = blocks()
    ties = [tie(bodies, *TIED)]
    x = bodies[0].mesh.geometry.x
    x[np.isclose(x[:, 0], 0.5) & np.isclose(x[:, 1], 0.5), :2] += move
    a, L = forms(bodies)
    raises(
        ValueError,
        "^body 0 has a cell without volume or turned over in part, at",
        lambda: TiedProblem(a, L, bcs=[held(bodies[0], BOTTOM)], ties=ties),
    )


def test_mirrored_cells_are_none_of_these():
    """DOLFINx takes them, as a whole."""
    bodies = blocks(cell="triangle", mapping=None)
    for body in bodies:
        body.mesh.geometry.x[:, 0] *= -1
    a, L = forms(bodies)
    TiedProblem(a, L, bcs=[held(bodies[0], BOTTOM)], ties=[tie(bodies, *TIED)]).solve()


@pytest.mark.ranks(other=[(0.2, 0.2)])
@pytest.mark.parametrize("other", ((0.1, 0.0), (0.0, -0.1), (0.2, 0.2)))
@pytest.mark.parametrize("swap", (False, True))
def test_contradiction(other, swap):
    """Both sides are prescribed beside the interface's end, differently."""
    bodies = blocks()
    ties = [tie(bodies, *(TIED[::-1] if swap else TIED))]
    bcs = [held(bodies[0], LEFT), held(bodies[1], LEFT, other)]
    a, L = forms(bodies)
    p = TiedProblem(a, L, bcs=bcs, ties=ties)
    raises(
        InterfaceError,
        r"^the prescribed .* contradict tie 0 \(\d and \d facets around \(0.5, 1\)\) at \(",
        p.solve,
    )


@pytest.mark.ranks(2)
def test_no_contradiction():
    bodies = blocks()
    bcs = [held(body, LEFT, (0.1, -0.1)) for body in bodies]
    a, L = forms(bodies)
    us = TiedProblem(a, L, bcs=bcs, ties=[tie(bodies, *TIED)]).solve()
    assert all(np.allclose(u.x.array.reshape(-1, 2), (0.1, -0.1), atol=1e-12) for u in us)


@pytest.mark.ranks(2)
@pytest.mark.parametrize("far, refused", ((5e5, False), (1e-6, True)))
def test_round_off_of_large_values_is_no_contradiction(far, refused):
    """What is prescribed elsewhere says how exact the values beside each other can be."""
    bodies = blocks()
    bcs = [held(bodies[0], LEFT), held(bodies[1], LEFT, (1e-10, 0.0))]
    bcs.append(held(bodies[0], RIGHT, (far, 0.0)))
    a, L = forms(bodies)
    p = TiedProblem([1e-6 * a[0], a[1]], L, bcs=bcs, ties=[tie(bodies, *TIED)])
    if refused:
        raises(InterfaceError, "^the prescribed displacements contradict tie 0", p.solve)
    else:
        p.solve()


@pytest.mark.ranks(2)
def test_contradiction_in_a_later_step():
    bodies = blocks()
    values = [fem.Constant(b.mesh, default_scalar_type((0, 0))) for b in bodies]
    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(b.V, 1, b.facets(LEFT)), b.V)
        for value, b in zip(values, bodies, strict=True)
    ]
    a, L = forms(bodies)
    p = TiedProblem(a, L, bcs=bcs, ties=[tie(bodies, *TIED)])
    p.solve()
    u = [fem.Function(b.V) for b in bodies]
    F = [ufl.action(*pair) for pair in zip(a, u, strict=True)]
    nonlinear = NonlinearTiedProblem(F, u, bcs=bcs, ties=[tie(bodies, *TIED)])
    values[1].value[0] = 1.0
    for one in (p, nonlinear):
        raises(InterfaceError, "^the prescribed displacements contradict tie 0", one.solve)


@two_ranks()
@pytest.mark.parametrize("fixed, count", (((), 3), (((0, BOTTOM, (1,)),), 1)))
@pytest.mark.parametrize("swap", (False, True))
def test_an_assembly_that_can_still_move(fixed, count, swap):
    bodies = blocks()
    p = problem(bodies, [tie(bodies, *(TIED[::-1] if swap else TIED))], TIED, fixed)
    for _ in range(2):  # not the first time alone
        raises(SolveError, f"singular: {count} rigid motion", p.solve)


@pytest.mark.ranks(2, swap=[False])
@pytest.mark.parametrize("swap", (False, True))
def test_a_tie_with_one_multiplier(swap):
    """A body that is tied over 2 % of a facet can turn: it isn't told to be tied."""
    bodies = [rectangle((2, 2), (0, 0), (1, 1)), rectangle((2, 2), (0.99, 1), (1.99, 2))]
    p = problem(bodies, [tie(bodies, *(TIED[::-1] if swap else TIED))], TIED, HELD)
    said = r"tie 0 .* has too few multipliers to hold it: it covers 0\.02 facets of Γ1; tie more"
    raises(SolveError, f"singular: 1 rigid motion .*body 1\\. {said}", p.solve)


@pytest.mark.ranks(2)
def test_lists_that_dont_fit():
    bodies = blocks()
    a, L = forms(bodies)
    one = tie(bodies, *TIED)
    sides = [(bodies[i].V, bodies[i].facets(tag)) for i, tag in TIED]
    u = [fem.Function(body.V) for body in bodies]
    for error, said, call in (
        (ValueError, r"^a\[0\] is None", lambda: TiedProblem([None, a[1]], L, ties=[one])),
        (ValueError, r"^u\[0\] and a\[0\] are", lambda: TiedProblem(a, L, ties=[one], u=u[::-1])),
        (
            ValueError,
            "^u has one function twice",
            lambda: NonlinearTiedProblem([ufl.action(a[0], u[0])] * 2, [u[0]] * 2, ties=[one]),
        ),
        (
            ValueError,
            "^petsc_options_prefix is 'my'; let it end with _",
            lambda: TiedProblem(a, L, ties=[one], petsc_options_prefix="my"),
        ),
        (ValueError, "^the degree is -1: give", lambda: one.quadrature(-1)),
        (ValueError, "^the degree is .2.: give", lambda: one.quadrature("2")),
        (
            ValueError,
            "^stiffness is a pair of moduli > 0, not",
            lambda: Tie.between(*sides, stiffness=("steel", "rubber")),
        ),
    ):
        raises(error, said, call)


@pytest.mark.ranks(num=[3])
@pytest.mark.parametrize("num", (2, 3))
def test_bodies_without_ties(num):
    """Each of the others has its three."""
    bodies = [rectangle((2, 2), (0, i), (1, i + 1)) for i in range(num)]
    p = problem(bodies, [], [], HELD)
    raises(SolveError, f"singular: {3 * (num - 1)} rigid motion", p.solve)


@pytest.mark.ranks(2)
def test_a_scalar_that_nothing_holds():
    mesh = rectangle((2, 2), (0, 0), (1, 1)).mesh
    V = fem.functionspace(mesh, ("Lagrange", 1))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    zero = fem.Constant(mesh, default_scalar_type(0))
    p = TiedProblem([ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx], [zero * v * ufl.dx])
    raises(SolveError, "singular: 1 rigid motion", p.solve)
    # With a reaction it is held
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + 1e-8 * u * v * ufl.dx
    TiedProblem([a], [zero * v * ufl.dx]).solve()


@pytest.mark.ranks(2)
def test_a_quadrature_degree_too_low():
    """Each body is held, yet cells deform without a stress: the message knows that cause, too."""
    bodies = blocks(cell="quadrilateral", degree=2)
    _, L = forms(bodies)
    a, dx = [], ufl.dx(metadata={"quadrature_degree": 1})
    for body in bodies:
        u, v = ufl.TrialFunction(body.V), ufl.TestFunction(body.V)
        a.append(ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * dx)
    bcs = [held(bodies[0], BOTTOM), held(bodies[1], TOP, (0.1, 0.0))]
    p = TiedProblem(a, L, bcs=bcs, ties=[tie(bodies, *TIED)])
    words = r"failed: (?!KSP)[^?]*singular: [^?]* quadrature degree is too low [^?]*\.$"
    raises(SolveError, words, p.solve)


@pytest.mark.ranks(2, pair=[((0, TOP), (1, TOP))])
@pytest.mark.parametrize(
    "pair, match",
    (
        (((0, TOP), (1, TOP)), "don't face each other"),
        (((0, BOTTOM), (1, TOP)), "don't face each other"),
        (((0, LEFT), (1, RIGHT)), "don't face each other"),
        (((0, RIGHT), (1, RIGHT)), "don't face each other"),
    ),
)
def test_wrong_sides(pair, match):
    bodies = blocks()
    raises(InterfaceError, match, lambda: tie(bodies, *pair))


@pytest.mark.ranks(2)
def test_inside_out():
    """Both bodies lie below the interface."""
    bodies = [rectangle((n, 1), (0, 0), (1, 1)) for n in (2, 3)]
    raises(InterfaceError, "their outward normals agree", lambda: tie(bodies, (0, TOP), (1, TOP)))


@pytest.mark.ranks(2)
def test_far_apart():
    bodies = [rectangle((2, 1), (0, y), (1, y + 1)) for y in (0, 50)]
    raises(InterfaceError, "don't face each other: no part of Γ1", lambda: tie(bodies, *TIED))


@pytest.mark.ranks(2, kind=["DG"])
@pytest.mark.parametrize("kind", ("DG", "Bubble"))
def test_families(kind):
    bodies = blocks(cell="triangle")
    element = ("Discontinuous Lagrange", 1, (2,)) if kind == "DG" else ("Bubble", 3, (2,))
    V = fem.functionspace(bodies[1].mesh, element)
    sides = [(bodies[0].V, bodies[0].facets(TOP)), (V, bodies[1].facets(BOTTOM))]
    raises(InterfaceError, "the space of Γ1 .* is not a continuous Lagrange", lambda: Tie(*sides))


@pytest.mark.ranks(2, facets=[3.5])
@pytest.mark.parametrize("facets", ([[0, 1]], [[0], [0, 1]], 3.5, "TOP", None))
def test_facets_of_strange_kinds(facets):
    bodies = blocks()
    sides = [(bodies[0].V, facets), (bodies[1].V, bodies[1].facets(BOTTOM))]
    raises(InterfaceError, "the facets of Γ0 must be a flat array", lambda: Tie(*sides))


@pytest.mark.serial
def test_workspace(monkeypatch):
    """MUMPS runs out of workspace, gets more, and all is well."""
    from hypergap_dolfinx.algebra import saddle

    bodies = [
        rectangle((n, 12), (0, i), (1, i + 1), degree=2, E=E)
        for i, (n, E) in enumerate(((1, 1.0), (100, 1e-10)))
    ]
    p = problem(bodies, [tie(bodies, *TIED[::-1])], TIED, HELD, solver="direct")
    p.solve()
    reference = [u.x.array.copy() for u in p.u]
    solves = []

    class Factor:
        def getMumpsInfog(self, i):
            return -9 if len(solves) < 3 else 0

        def getMumpsIcntl(self, i):
            return 100

    class PC:
        def getType(self):
            return "lu"

        def getFactorSolverType(self):
            return "mumps"

        def getFactorMatrix(self):
            return Factor()

        def reset(self):
            pass

    class KSP:
        def solve(self, b, x):
            solves.append(1)

        def getPC(self):
            return PC()

        def getOptionsPrefix(self):
            return "x_"

        def getOperators(self):
            return ()

        def setOperators(self):
            pass

    saddle.solve(KSP(), None, None)
    assert len(solves) == 3
    assert not PETSc.Options().hasName("x_mat_mumps_icntl_14")
    p.solve()
    assert all(np.allclose(u.x.array, r) for u, r in zip(p.u, reference, strict=True))
    assert linear((1, 0)) == (0.3, 0.5) and MPI.COMM_WORLD.size == 1


@pytest.mark.ranks(2, shift=[0.2])
@pytest.mark.parametrize("shift", np.linspace(0.02, 0.2, 10))
def test_curved_cells_turned_over_at_their_edge(shift):
    """A node of a cubic edge pushed along it: det J < 0 at a fine lattice's points is found."""
    mesh, _ = meshes.block(comm, (1, 1), cell="triangle", degree=3)
    x = mesh.geometry.x
    x[np.isclose(x[:, 0], 1 / 3) & np.isclose(x[:, 1], 0), 0] += shift
    element = basix.create_element(
        basix.ElementFamily.P, basix.CellType.triangle, 3, basix.LagrangeVariant.gll_warped
    )
    points = basix.create_lattice(basix.CellType.triangle, 60, basix.LatticeType.equispaced, True)
    nodes = x[compat.geometry_dofmap(mesh)][..., :2]
    J = np.einsum("cmi,jpm->cpij", nodes, element.tabulate(1, points)[1:, :, :, 0])
    det = np.linalg.det(J)
    turned = comm.allreduce(bool((det * np.sign(det[:, :1]) < -1e-2).any()), MPI.LOR)
    sound = comm.allreduce(bool((det * np.sign(det[:, :1]) > 0).all()), MPI.LAND)
    facets = [dolfinx.mesh.exterior_facet_indices(mesh.topology)]
    if turned:
        raises(
            ValueError,
            "^it has a cell without volume",
            lambda: checks.check_cells(mesh, "it", facets),
        )
    elif sound:
        checks.check_cells(mesh, "it", facets)


def test_displacements_that_turn_over_the_middle_of_an_edge():
    """At all corners of the cell det J is positive."""
    mesh = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 2, (2,))))
    nodes = u.function_space.dofmap.cell_dofs(0)
    x = u.function_space.tabulate_dof_coordinates()[nodes, :2]
    corners, middle = x[:3], (x[[1, 0, 0]] + x[[2, 2, 1]]) / 2
    assert np.allclose(x[3:], middle)
    moved = np.array([[-0.2, -0.3], [0, 0], [0.3, -0.1]])  # of the reference cell
    away = moved @ (corners[1:] - corners[0])
    known = {}
    for share, num in ((0, 0), (1, 1)):
        u.x.array.reshape(-1, 2)[nodes[3:]] = share * away
        assert len(checks.turned_over(u, known)) == num


@two_ranks()
def test_curved_cells_turned_over_at_a_corner(caplog):
    """On the interface they are refused, elsewhere told: no Gauss point is there."""
    bodies = []
    for i in (0, 1):
        mesh, ft = meshes.block(
            comm, (2, 2), lambda x, i=i: x + np.array((0, i)), cell="triangle", degree=2
        )
        bodies.append(Body(mesh, ft, fem.functionspace(mesh, ("Lagrange", 1, (2,)))))
    ties = [tie(bodies, *TIED)]
    a, L = forms(bodies)
    p = TiedProblem(a, L, bcs=[held(bodies[0], BOTTOM)], ties=ties)
    assert not caplog.records
    x = bodies[0].mesh.geometry.x

    def move(y, away):
        middle = np.isclose(np.abs(x[:, 0] - 0.25), 0.0) & np.isclose(x[:, 1], y)
        x[middle, 0] += away

    move(0, -0.135)
    p = TiedProblem(a, L, bcs=[held(bodies[0], BOTTOM)], ties=ties)
    p.solve()
    said = "body 0 has 1 cell turned over at a corner or an edge, away from interfaces"
    assert [r.message[: len(said)] for r in caplog.records] == [said] * (comm.rank == 0)
    move(1, -0.135)
    raises(
        ValueError,
        "^body 0 has a cell without volume or turned over in part, at",
        lambda: TiedProblem(a, L, bcs=[held(bodies[0], BOTTOM)], ties=ties),
    )


@pytest.mark.ranks(2, single=[(1,)])
@pytest.mark.parametrize("single", ((0,), (1,), (0, 1)))
def test_meshes_of_single_precision(single):
    """PETSc has one kind of numbers: no form of such a mesh can be assembled."""
    sides = []
    for i in range(2):
        dtype = np.float32 if i in single else np.float64
        square = create_rectangle(comm, ((0, i), (1, i + 1)), (2, 2), dtype=dtype)
        facets = locate_entities_boundary(square, 1, lambda x: np.isclose(x[1], 1))
        sides.append((fem.functionspace(square, ("Lagrange", 1, (2,))), facets))
    for door in (Tie, Tie.between, Contact, Contact.between):
        words = "of float32, and .* float64; make it with dtype=dolfinx.default_real_type"
        raises(ValueError, words, lambda door=door: door(*sides))


@pytest.mark.ranks(2)
def test_things_of_the_wrong_kind():
    bodies = blocks()
    a, L = forms(bodies)
    ties, bc = [tie(bodies, *TIED)], held(bodies[0], BOTTOM)
    side = bodies[1].V, bodies[1].facets(BOTTOM)
    mesh = bodies[0].mesh
    for match, call in (
        ("not [(]Mesh", lambda: Tie((mesh, bodies[0].facets(TOP)), side)),
        ("one flat list", lambda: TiedProblem(a, L, bcs=[[bc]], ties=ties)),
        ("UFL forms", lambda: TiedProblem([fem.form(f) for f in a], L, bcs=[bc], ties=ties)),
        ("functions on tie.sigma", lambda: ties[0].quadrature(2).evaluate(fem.Function(side[0]))),
    ):
        raises(ValueError, match, call)
    TiedProblem(a, L, bcs=bc, ties=ties).solve()  # one condition, not in a list
