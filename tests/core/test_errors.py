# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What goes wrong says so: in one line, which is the same on every rank."""

import time

from mpi4py import MPI

import numpy as np
import pytest
from helpers import comm, elasticity, interpolated, raises, two_blocks, two_ranks

import basix.ufl
import dolfinx
import meshes
import ufl
from dolfinx import fem
from hypergap_dolfinx import (
    InterfaceError,
    InvertedCellError,
    SolveError,
    Tie,
    TiedProblem,
    find_touching,
)
from hypergap_dolfinx.core.collective import spot, wait_idly

pytestmark = pytest.mark.ranks(2)  # the same line on each
NOTHING = np.empty(0, dtype=np.int32)


# Facets


@pytest.mark.ranks(side=[1])
@pytest.mark.parametrize("nothing", (NOTHING, [], np.empty((0, 1))))
@pytest.mark.parametrize("side", (0, 1))
def test_no_facets_on_any_rank(side, nothing):
    sides = two_blocks()
    sides[side] = (sides[side][0], nothing)
    with raises(InterfaceError, rf"^Γ{side} has no facets on any rank; does the tag exist"):
        Tie(*sides)


def on_rank(r, facets, others):
    """Facets of a rank that has some; for most of a test's mistakes one rank is enough."""
    return facets if comm.rank == r else others


def rank_with_facets(facets):
    """The last rank that has any."""
    return max(r for r, n in enumerate(comm.allgather(len(facets))) if n)


@pytest.mark.ranks
def test_facets_out_of_range():
    (V, facets), other = two_blocks()
    num = V.mesh.topology.index_map(1).size_local + V.mesh.topology.index_map(1).num_ghosts
    last = comm.size - 1
    for bad in (-1, num + 7):
        wrong = on_rank(last, np.append(facets, np.int32(bad)), facets)
        number = comm.bcast(bad, last)
        with raises(InterfaceError, rf"^facet {number} of Γ1 is out of range \(rank {last} has"):
            Tie(other, (V, wrong))


@two_ranks()
def test_duplicate_facets():
    (V, facets), other = two_blocks()
    r = rank_with_facets(facets)
    wrong = on_rank(r, np.append(facets, facets[:1]), facets)
    with raises(InterfaceError, r"^facet \d+ of Γ0 is given twice; pass each facet once"):
        Tie((V, wrong), other)


@two_ranks()
def test_interior_facets():
    (V, facets), other = two_blocks()
    topology = V.mesh.topology
    topology.create_connectivity(1, 2)
    count = np.diff(topology.connectivity(1, 2).offsets)
    inner = np.flatnonzero(count == 2).astype(np.int32)
    r = rank_with_facets(inner)
    wrong = on_rank(r, np.append(facets, inner[:1]), facets)
    with raises(InterfaceError, r"^facet \d+ of Γ0 has a cell on both sides; .*split the mesh"):
        Tie((V, wrong), other)


@pytest.mark.parametrize("make", (lambda f: f.astype(float) + 0.5, lambda f: f.reshape(-1, 1)))
def test_facets_that_are_no_indices(make):
    (V, facets), other = two_blocks()
    with raises(InterfaceError, "^the facets of Γ0 must be a flat array of local facet indices"):
        Tie((V, make(facets)), other)


def test_lists_of_facets():
    """Also empty ones, on ranks that have none."""
    (V, facets), other = two_blocks()
    tie = Tie((V, facets.tolist()), other)
    assert len(tie.surfaces[0].facets) == 3


def test_places_in_messages():
    """Round-off isn't printed, nor more digits than anybody reads."""
    assert spot(np.array([1e-17, 1 / 3, -2])) == "(0, 0.33333, -2)"
    assert spot(np.array([(0, 1e6 / 3, -1e-12), (2, 1e6 / 3, 0)])) == "(1, 333333, 0)"
    assert spot(np.array([(0.0, 0), (0, 0)])) == "(0, 0)"
    assert spot(np.array((1e-9, -2e-9 / 3))) == "(1e-09, -6.6667e-10)"
    assert spot(np.array((np.nan, 1.0))) == "(nan, 1)"


@two_ranks()
def test_branching_facets():
    """Two squares that touch at a corner, with both their edges there."""
    x = np.array([(0, 0), (1, 0), (0, 1), (1, 1), (2, 1), (1, 2), (2, 2)], dtype=float)
    cells = np.array([(0, 1, 2, 3), (3, 4, 5, 6)], dtype=np.int64)
    if comm.rank > 0:
        x, cells = x[:0], cells[:0]
    element = basix.ufl.element("Lagrange", "quadrilateral", 1, shape=(2,))
    mesh = dolfinx.mesh.create_mesh(comm, cells, e=element, x=x)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    facets = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.ones(x.shape[1], bool))
    with raises(InterfaceError, r"^Γ0 branches at \(1, 1\): its facets must form chains .* tie"):
        Tie((V, facets), two_blocks()[1])


@pytest.mark.parametrize("value", (np.nan, np.inf))
def test_coordinates_that_are_no_numbers(value):
    (V, facets), other = two_blocks()
    x = V.mesh.geometry.x
    x[np.isclose(x[:, 1], 0) & np.isclose(x[:, 0], 0), 1] = value
    with raises(InterfaceError, "^Γ0 has NaN or infinite coordinates"):
        Tie((V, facets), other)


# Spaces


def space_on(mesh, kind):
    cell = mesh.basix_cell()
    P2 = basix.ufl.element("Lagrange", cell, 2, shape=(2,))
    P1 = basix.ufl.element("Lagrange", cell, 1)
    return {
        "DG": lambda: fem.functionspace(mesh, ("Discontinuous Lagrange", 1, (2,))),
        "DG of degree 0": lambda: fem.functionspace(mesh, ("Discontinuous Lagrange", 0, (2,))),
        "Nédélec": lambda: fem.functionspace(mesh, ("N1curl", 1)),
        "Crouzeix-Raviart": lambda: fem.functionspace(mesh, ("CR", 1, (2,))),
        "bubble": lambda: fem.functionspace(
            mesh,
            basix.ufl.blocked_element(
                basix.ufl.enriched_element([P1, basix.ufl.element("Bubble", cell, 3)]), shape=(2,)
            ),
        ),
        "quadrature": lambda: fem.functionspace(
            mesh, basix.ufl.quadrature_element(cell, value_shape=(2,), degree=2)
        ),
        "mixed": lambda: fem.functionspace(mesh, basix.ufl.mixed_element([P2, P1])),
        "mixed bubble": lambda: fem.functionspace(
            mesh, basix.ufl.mixed_element([space_on(mesh, "bubble").ufl_element(), P1])
        ).sub(0),
    }[kind]()


SPACES = {
    "DG": "is not a continuous Lagrange space",
    "DG of degree 0": "is not a continuous Lagrange space",
    "Nédélec": "is not a continuous Lagrange space",
    "Crouzeix-Raviart": "is not a continuous Lagrange space",
    "bubble": "is not a continuous Lagrange space",
    "quadrature": "is not a continuous Lagrange space",
    "mixed": r"is mixed; a tie takes its components one by one, W.sub\(0\) for example",
    "mixed bubble": "is not a continuous Lagrange space",
}


@pytest.mark.ranks(2, side=[1], kind=["DG", "mixed", "mixed bubble"])
@pytest.mark.parametrize("side", (0, 1))
@pytest.mark.parametrize("kind", SPACES)
def test_spaces_that_are_not_lagrange(kind, side):
    sides = two_blocks(cells=("triangle", "triangle"))
    V, facets = sides[side]
    W = space_on(V.mesh, kind)
    sides[side] = (W, facets)
    if W.value_shape != (2,):  # the other side alike, for this mistake alone to be left
        V1, facets1 = sides[1 - side]
        shape = W.value_shape
        sides[1 - side] = (fem.functionspace(V1.mesh, ("Lagrange", 1, shape)), facets1)
    with raises(InterfaceError, f"^the space of Γ{side} .*{SPACES[kind]}"):
        Tie(*sides)


def test_different_value_shapes():
    scalar, vector = two_blocks(shape=()), two_blocks()
    with raises(InterfaceError, r"different value shapes, \(\) and \(2,\)"):
        Tie(scalar[0], vector[1])


@pytest.mark.ranks
def test_different_communicators():
    """The same ranks in another order are not the same."""
    if comm.size == 1:
        pytest.skip("one rank has one order")
    other = comm.Split(0, comm.size - comm.rank)
    with raises(InterfaceError, "^the meshes of Γ0 and Γ1 live on different communicators"):
        Tie(two_blocks()[0], two_blocks(c=other)[1])
    with raises(InterfaceError, "^the meshes of Γ0 and Γ1 live on different communicators"):
        Tie(two_blocks()[0], two_blocks(c=MPI.COMM_SELF)[1])
    other.Free()


def test_different_dimensions():
    mesh, ft = meshes.block(comm, (2, 2, 2), cell="tetrahedron")
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    with raises(InterfaceError, "^the mesh of Γ0 has 2 coordinates, that of Γ1 3"):
        Tie(two_blocks()[0], (V, ft.find(meshes.TOP)))


def test_mesh_of_a_surface_in_space():
    """A shell is no body."""
    element = basix.ufl.element("Lagrange", "quadrilateral", 1, shape=(3,))
    x = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], dtype=float)
    cells = np.array([(0, 1, 2, 3)], dtype=np.int64)
    if comm.rank > 0:
        x, cells = x[:0], cells[:0]
    shell = dolfinx.mesh.create_mesh(comm, cells, e=element, x=x)
    V = fem.functionspace(shell, ("Lagrange", 1))
    shell.topology.create_connectivity(1, 2)
    facets = dolfinx.mesh.exterior_facet_indices(shell.topology)
    with raises(InterfaceError, "^Γ0 lies on a 2-dimensional mesh in 3 dimensions; bodies must"):
        Tie((V, facets), (V, facets))


def test_prisms():
    """Their facets are of two kinds."""
    element = basix.ufl.element("Lagrange", "prism", 1, shape=(3,))
    triangle = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], dtype=float)
    x, cells = np.vstack((triangle, triangle + np.eye(3)[2])), np.arange(6)[None]
    if comm.rank > 0:
        x, cells = x[:0], cells[:0]
    mesh = dolfinx.mesh.create_mesh(comm, cells, e=element, x=x)
    V = fem.functionspace(mesh, ("Lagrange", 1))
    facets = np.arange(1 - min(comm.rank, 1), dtype=np.int32)
    with raises(InterfaceError, "^Γ0 lies on prism cells; bodies in space are made of"):
        Tie((V, facets), (V, facets))
    with raises(InterfaceError, "prism cells"):
        find_touching([V])


# Interfaces


@two_ranks()
def test_surfaces_that_lie_elsewhere():
    sides = two_blocks(spans=((0, 2), (7, 9)))
    with raises(InterfaceError, "^Γ0 and Γ1 don't face each other: .* 5 away.* check the tags"):
        Tie(*sides)


def test_the_same_surface_twice():
    side, _ = two_blocks()
    with raises(InterfaceError, "Γ0 and Γ1 share facets; give each side its own"):
        Tie(side, side)


@two_ranks()
def test_surfaces_that_fold_over():
    """Γ1 turns back on itself where Γ0 is straight: dΣ changes its sign."""

    def lift(x):
        """The bottom's middle nodes go past its vertices."""
        y = x.copy()
        bottom = np.isclose(x[:, 1], 0)
        y[bottom, 0] += 0.3 * np.sin(3 * np.pi * x[bottom, 0])
        return y

    lower, _ = two_blocks()
    mesh, ft = meshes.block(comm, (3, 2), lambda x: lift(x) * (2, 1), degree=2)
    upper = fem.functionspace(mesh, ("Lagrange", 1, (2,))), ft.find(meshes.BOTTOM)
    with raises(InvertedCellError, r"^\d+ gap elements are inverted .* refine the coarser side"):
        Tie(lower, upper).blocks()


def test_unknown_treatment_of_interior_nodes():
    with raises(ValueError, r'^interior is "interpolated" or "free", not \'both\'\.'):
        Tie(*two_blocks(), interior="both")


# Problems


def held(V, below):
    """A body held at its outer edge."""
    facets = dolfinx.mesh.locate_entities_boundary(
        V.mesh, 1, lambda x: np.isclose(x[1], -1 if below else 1)
    )
    dofs = fem.locate_dofs_topological(V, 1, facets)
    return fem.dirichletbc(interpolated(V, lambda x: 0 * x[:2]), dofs)


def arguments():
    sides = two_blocks()
    a, L = zip(*(elasticity(V) for V, _ in sides), strict=True)
    return sides, a, L, Tie(*sides)


SINGULAR = (
    r"^the matrix is singular: 3 rigid motions of the bodies are free; hold every body, by "
    r"boundary conditions or by a tie to one that is held\. "
)


def loaded(L, V):
    """With a load that nothing balances."""
    v = ufl.TestFunction(V)
    return L + (v[0] + 2 * v[1]) * ufl.dx


@two_ranks(k=[2])
@pytest.mark.parametrize("k", (1, 2))
@pytest.mark.parametrize("n", ((3, 5), (8, 6)))
def test_free_bodies(n, k):
    """Nothing holds them; a load turns what MUMPS takes for a solution into nonsense."""
    sides = two_blocks(n, (k, k))
    a, L = zip(*(elasticity(V) for V, _ in sides), strict=True)
    L = [loaded(form, V) for form, (V, _) in zip(L, sides, strict=True)]
    problem = TiedProblem(a, L, ties=[Tie(*sides)])
    with raises(SolveError, SINGULAR + r"These move: body 0, body 1\.$"):
        problem.solve()


def test_body_without_a_tie():
    """One body is held, the other one is not tied to it."""
    sides, a, L, _ = arguments()
    problem = TiedProblem(a, [L[0], loaded(L[1], sides[1][0])], bcs=[held(sides[0][0], True)])
    with raises(SolveError, SINGULAR + r"This one moves: body 1\.$"):
        problem.solve()


def test_tie_given_twice():
    _, a, L, tie = arguments()
    with raises(ValueError, "^a tie is given twice; that would make the matrix singular"):
        TiedProblem(a, L, ties=[tie, tie])


@two_ranks()
def test_solver_that_does_not_converge():
    sides, a, L, tie = arguments()
    options = {"ksp_type": "gmres", "ksp_max_it": 2, "pc_type": "none", "ksp_rtol": 1e-14}
    bcs = [held(sides[0][0], True)]
    moved = interpolated(sides[1][0], lambda x: 1 + 0 * x[:2])
    bcs.append(fem.dirichletbc(moved, held(sides[1][0], False).dof_indices()[0][::2] // 2))
    problem = TiedProblem(a, L, bcs=bcs, ties=[tie], petsc_options=options)
    with raises(SolveError, r"KSP reason -3 \(\w*MAX_IT\w*\)\.$"):
        problem.solve()


@pytest.mark.parametrize(("num_a", "num_L"), ((2, 1), (1, 2), (0, 0)))
def test_numbers_of_forms(num_a, num_L):
    _, a, L, tie = arguments()
    with raises(ValueError, f"^{num_a} bilinear and {num_L} linear forms: give one of each"):
        TiedProblem(a[:num_a], L[:num_L], ties=[tie])


def test_tie_on_a_foreign_space():
    sides, a, L, _ = arguments()
    V, facets = sides[1]
    foreign = fem.functionspace(V.mesh, ("Lagrange", 1, (2,)))
    tie = Tie(sides[0], (foreign, facets))
    with raises(
        ValueError, r"^Γ1 of tie 0 \(.*\) is on a space that is in no form; make .* the same"
    ):
        TiedProblem(a, L, bcs=[held(sides[0][0], True)], ties=[tie])


def test_boundary_condition_on_a_foreign_space():
    sides, a, L, tie = arguments()
    foreign = fem.functionspace(sides[0][0].mesh, ("Lagrange", 2, (2,)))
    bcs = [held(sides[0][0], True), held(foreign, True)]
    with raises(ValueError, "^1 of 2 boundary conditions are on a space that is in no body"):
        TiedProblem(a, L, bcs=bcs, ties=[tie])


@two_ranks()
def test_prescribed_side_1():
    """All of a long Γ1 is held while Γ0 can move: no multiplier is left to tie it."""
    sides = two_blocks((20, 40))
    a, L = zip(*(elasticity(V) for V, _ in sides), strict=True)
    V, facets = sides[1]
    dofs = fem.locate_dofs_topological(V, 1, facets)
    bcs = [fem.dirichletbc(interpolated(V, lambda x: 0 * x[:2]), dofs)]
    with raises(InterfaceError, r"^\d+ displacements of Γ1 of tie 0 \(.*\) are prescribed .* swap"):
        TiedProblem(a, L, bcs=bcs, ties=[Tie(*sides)])
    sides[0][0].mesh.name, V.mesh.name = "plate", "block"
    with raises(InterfaceError, r"Γ1 of tie 0 \(plate and block, 20 and 40 facets around \(1, "):
        TiedProblem(a, L, bcs=bcs, ties=[Tie(*sides)])


def test_empty_prefix():
    _, a, L, tie = arguments()
    with raises(ValueError, "petsc_options_prefix is ''; let it end with _"):
        TiedProblem(a, L, ties=[tie], petsc_options_prefix="")


def test_waiting_takes_no_processor(monkeypatch):
    """Who waits for a rank asks about a thousand times in all, not as often as the machine can."""
    pauses, sleep = [], time.sleep
    comm.barrier()
    if comm.rank == 0:
        sleep(0.3)
    monkeypatch.setattr(time, "sleep", lambda pause: (pauses.append(pause), sleep(pause)))
    wait_idly(comm)
    assert len(pauses) < 3000
    assert comm.rank == 0 or sum(pauses) > 0.1
