# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""TiedProblem: its door, one mesh with several bodies, several ties, repeated solves."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from helpers import two_ranks

import basix.ufl
import dolfinx
import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import (
    Contact,
    ContactProblem,
    InterfaceError,
    NonlinearTiedProblem,
    Tie,
    TiedProblem,
)

pytestmark = two_ranks()
needs_real = pytest.mark.skipif(
    np.issubdtype(default_scalar_type, np.complexfloating), reason="needs real scalars"
)

comm = MPI.COMM_WORLD


def field(x):
    """A linear displacement."""
    return np.array((0.1 + 0.2 * x[0] - 0.3 * x[1], 0.4 * x[0] + 0.1 * x[1]))


def elasticity(V):
    """Forms of plane elasticity without loads."""
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)

    def sigma(u):
        eps = ufl.sym(ufl.grad(u))
        return eps + 0.5 * ufl.tr(eps) * ufl.Identity(2)

    zero = fem.Constant(V.mesh, default_scalar_type((0, 0)))
    return ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx, ufl.inner(zero, v) * ufl.dx


def held(V, where):
    """The linear displacement, prescribed on a part of the boundary."""
    u = fem.Function(V)
    u.interpolate(field)
    facets = dolfinx.mesh.locate_entities_boundary(V.mesh, 1, where)
    return fem.dirichletbc(u, fem.locate_dofs_topological(V, 1, facets))


def largest_error(us):
    """Largest difference from the linear displacement at the nodes."""
    worst = 0.0
    for u in us:
        exact = fem.Function(u.function_space)
        exact.interpolate(field)
        worst = max(worst, np.abs(u.x.array - exact.x.array).max(initial=0))
    return comm.allreduce(worst, MPI.MAX)


def two_blocks():
    """A block on another one, both held on the outside."""
    lower, ft0 = meshes.block(comm, (4, 3), lambda x: x - (0, 1))
    upper, ft1 = meshes.block(comm, (6, 2), cell="triangle")
    V = [fem.functionspace(mesh, ("Lagrange", 2, (2,))) for mesh in (lower, upper)]
    tie = Tie((V[0], ft0.find(meshes.TOP)), (V[1], ft1.find(meshes.BOTTOM)))
    bcs = [held(V[0], lambda x: np.isclose(x[1], -1)), held(V[1], lambda x: np.isclose(x[1], 1))]
    bcs += [held(W, lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 1)) for W in V]
    a, L = zip(*(elasticity(W) for W in V), strict=True)
    return V, a, L, bcs, tie


def one_mesh():
    """The same two blocks as one mesh: two parts that share no node."""
    x, cells = [], []
    for n, shift in ((4, -1.0), (7, 0.0)):
        i, j = np.meshgrid(np.arange(n), np.arange(3), indexing="ij")
        start = sum(map(len, x))
        corner = start + (i * 4 + j).ravel()
        cells.append(np.column_stack((corner, corner + 4, corner + 1, corner + 5)))
        i, j = np.meshgrid(np.arange(n + 1), np.arange(4), indexing="ij")
        x.append(np.column_stack((i.ravel() / n, j.ravel() / 3 + shift)))
    element = basix.ufl.element("Lagrange", "quadrilateral", 1, shape=(2,))
    cells, x = np.vstack(cells).astype(np.int64), np.vstack(x)
    if comm.rank > 0:
        cells, x = cells[:0], x[:0]
    return dolfinx.mesh.create_mesh(comm, cells, e=element, x=x)


@pytest.mark.ranks
@pytest.mark.parametrize("degree", (1, 2))
def test_one_mesh_with_several_bodies(degree):
    mesh = one_mesh()
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    # Both sides of the interface lie at y = 0: tell them by their cells
    facets = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 0))
    mesh.topology.create_connectivity(1, 2)
    to_cell = mesh.topology.connectivity(1, 2)
    cells = np.array([to_cell.links(f)[0] for f in facets], dtype=np.int32)
    above = dolfinx.mesh.compute_midpoints(mesh, 2, cells)[:, 1] > 0
    tie = Tie((V, facets[~above]), (V, facets[above]))
    bcs = [held(V, lambda x: np.isclose(np.abs(x[1]), 1))]
    a, L = elasticity(V)
    (u,) = TiedProblem([a], [L], bcs=bcs, ties=[tie]).solve()
    # Free sides would bend under this field: hold what the tie doesn't
    bcs.append(held(V, lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 1)))
    (u,) = TiedProblem([a], [L], bcs=bcs, ties=[tie]).solve()
    assert largest_error([u]) <= 1e-12


@pytest.mark.parametrize("interior", ("interpolated", "free"))
def test_several_ties_on_a_body(interior):
    """Three blocks on top of each other; the middle one is Γ1 of one tie and Γ0 of the other."""
    V, facets, bcs = [], [], []
    for i, n in enumerate((3, 5, 4)):
        mesh, ft = meshes.block(comm, (n, 2), lambda x, i=i: x + np.array((0, i)))
        V.append(fem.functionspace(mesh, ("Lagrange", 2, (2,))))
        facets.append((ft.find(meshes.BOTTOM), ft.find(meshes.TOP)))
    ties = [
        Tie((V[i], facets[i][1]), (V[i + 1], facets[i + 1][0]), interior=interior) for i in (0, 1)
    ]
    bcs = [held(V[0], lambda x: np.isclose(x[1], 0)), held(V[2], lambda x: np.isclose(x[1], 3))]
    bcs += [held(W, lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 1)) for W in V]
    a, L = zip(*(elasticity(W) for W in V), strict=True)
    problem = TiedProblem(a, L, bcs=bcs, ties=ties)
    assert largest_error(problem.solve()) <= 1e-12
    for tie in ties:
        q = tie.quadrature(2)
        forces = q.integrate(q.evaluate(tie.traction(problem)))
        np.testing.assert_allclose(forces, (0.05, 0.1 + 0.5 * 0.3), atol=1e-11)


def test_solutions_go_into_given_functions():
    V, a, L, bcs, tie = two_blocks()
    u = [fem.Function(W, name="displacement") for W in V]
    problem = TiedProblem(a, L, bcs=bcs, ties=[tie], u=u)
    assert problem.solve()[0] is u[0] and problem.u[1] is u[1]
    assert largest_error(u) <= 1e-12
    assert problem.ties == [tie] and len(problem.a) == len(problem.L) == 2
    residual = problem.b.duplicate()
    problem.A.mult(problem.x, residual)
    residual.axpy(-1.0, problem.b)
    assert residual.norm() <= 1e-12 * problem.x.norm()


def test_an_unchanged_matrix_is_factorised_once():
    _, a, L, bcs, tie = two_blocks()
    problem = TiedProblem(a, L, bcs=bcs, ties=[tie])
    problem.assemble_matrix()
    with PETSc.Log.Event("MatLUFactorNum") as event:
        pass
    PETSc.Log.begin()
    before = event.getPerfInfo()["count"]
    for _ in range(3):
        problem.assemble_vector()
        us = problem.solve_system()
    assert event.getPerfInfo()["count"] == before + 1
    assert largest_error(us) <= 1e-12


def test_own_options_win():
    _, a, L, bcs, tie = two_blocks()
    options = {"ksp_type": "gmres", "ksp_rtol": 1e-13, "pc_type": "lu"}
    options |= {"pc_factor_mat_solver_type": "mumps", "mat_mumps_icntl_14": 321}
    problem = TiedProblem(
        a, L, bcs=bcs, ties=[tie], petsc_options_prefix="mine_", petsc_options=options
    )
    assert largest_error(problem.solve()) <= 1e-12
    assert problem.solver.getType() == "gmres" and problem.solver.getOptionsPrefix() == "mine_"
    assert not any(key.startswith("mine_") for key in PETSc.Options().getAll())
    assert problem.solver.getPC().getFactorMatrix().getMumpsIcntl(14) == 321


def test_no_ties_at_all():
    """The same door for a body alone: what tied results are compared with."""
    mesh, _ = meshes.block(comm, (4, 3))
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    a, L = elasticity(V)
    bcs = [held(V, lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 1))]
    bcs.append(held(V, lambda x: np.isclose(x[1], 0) | np.isclose(x[1], 1)))
    assert largest_error(TiedProblem([a], [L], bcs=bcs).solve()) <= 1e-12


def test_traction_of_another_problem():
    _, a, L, bcs, tie = two_blocks()
    problem = TiedProblem(a, L, bcs=bcs, ties=[])
    with pytest.raises(ValueError, match="not one of this problem's"):
        tie.traction(problem)


def test_traction_before_the_solve():
    _, a, L, bcs, tie = two_blocks()
    problem = TiedProblem(a, L, bcs=bcs, ties=[tie])
    with pytest.raises(ValueError, match="not solved yet"):
        tie.traction(problem)


def test_no_loads_no_lists():
    """A body without a load needs no form; one tie needs no list."""
    _, a, _, bcs, tie = two_blocks()
    assert largest_error(TiedProblem(a, [None, None], bcs=bcs, ties=tie).solve()) <= 1e-12


def test_mistaken_forms():
    V, a, L, bcs, tie = two_blocks()
    with pytest.raises(ValueError, match="are lists"):
        TiedProblem(a[0], L[0])
    with pytest.raises(ValueError, match=r"a\[0\] and L\[0\] are on different function spaces"):
        TiedProblem(a, L[::-1], bcs=bcs, ties=[tie])
    with pytest.raises(ValueError, match=r"a\[0\] has 1 arguments"):
        TiedProblem(L, L, bcs=bcs, ties=[tie])
    with pytest.raises(ValueError, match="u0 is not on the space of Γ0"):
        tie.gap(*(fem.Function(fem.functionspace(W.mesh, ("Lagrange", 2))) for W in V))


@pytest.mark.parametrize(
    "kind", (TiedProblem, NonlinearTiedProblem, pytest.param(ContactProblem, marks=needs_real))
)
def test_a_changed_list_of_boundary_conditions(kind):
    """It is read once: other conditions in it are told at the next solve, results remain."""
    V, a, L, bcs, tie = two_blocks()
    if kind is TiedProblem:
        problem = kind(a, L, bcs=bcs, ties=[tie])
    else:
        u = [fem.Function(W) for W in V]
        F = [ufl.action(form, f) for form, f in zip(a, u, strict=True)]
        interfaces = {"ties": [tie]}
        if kind is ContactProblem:
            interfaces = {"contacts": [Contact(*zip(V, tie.facets, strict=True))]}
        problem = kind(F, u, bcs=bcs, **interfaces)
    problem.solve()
    first = bcs[0]
    bcs[0] = held(V[0], lambda x: np.isclose(x[1], -1))
    with pytest.raises(ValueError, match="bcs has other boundary conditions than when"):
        problem.solve()
    if kind is not ContactProblem:
        assert tie.force(problem).shape == (2,)
    bcs[0] = first
    problem.solve()
    bcs.append(first)
    with pytest.raises(ValueError, match="or make a new problem"):
        problem.solve()


def test_an_interface_tied_twice():
    V, a, L, bcs, tie = two_blocks()
    facets = [
        dolfinx.mesh.locate_entities_boundary(W.mesh, 1, lambda x: np.isclose(x[1], 0)) for W in V
    ]
    again = Tie((V[1], facets[1]), (V[0], facets[0]))
    with pytest.raises(InterfaceError, match=r"ties 0 and 1 \(.*\) tie the same facets"):
        TiedProblem(a, L, bcs=bcs, ties=[tie, again])
    with pytest.raises(InterfaceError, match="Γ0 and Γ1 share"):
        Tie((V[0], facets[0]), (V[0], facets[0]))
    with pytest.raises(ValueError, match="is a pair"):
        Tie(*V)


@pytest.mark.ranks
def test_nodes_moved_after_the_tie_was_made(caplog):
    """A mesh that is moved leaves its ties behind: that is told, once."""
    V, a, L, bcs, tie = two_blocks()
    problem = TiedProblem(a, L, bcs=bcs, ties=[tie])
    x = V[1].mesh.geometry.x
    problem.solve()
    x[:, 0] += 0.3
    x[:, 0] -= 0.3  # off by round-off
    problem.solve()
    assert not caplog.messages
    x[x[:, 0] < 0.3, 0] += 0.01
    problem.solve()
    problem.solve()
    told = [line for line in caplog.messages if "were moved by up to 0.01 after" in line]
    assert len(told) == (comm.rank == 0)


@pytest.mark.ranks
def test_ranks_may_forget_problems_in_any_order():
    """Destruction is collective in PETSc, garbage collection is not."""
    _, a, L, bcs, tie = two_blocks()
    problems = [TiedProblem(a, L, bcs=bcs, ties=[tie]) for _ in range(2)]
    for problem in problems:
        problem.solve()
    del problem
    problems.pop(comm.rank % 2)
    problems.pop()
    other = TiedProblem(a, L, bcs=bcs, ties=[tie])
    assert largest_error(other.solve()) <= 1e-12
    other.destroy()
    with pytest.raises(ValueError, match="the problem was destroyed"):
        other.solve()
    B1 = tie.blocks()[1]
    tie.destroy()
    assert B1.norm() == tie.blocks()[1].norm() > 0  # its own; and made anew


@pytest.mark.ranks
def test_what_outlives_its_owner():
    """PETSc's objects stay as long as someone has them, also parts of what is gone."""
    _, a, L, bcs, tie = two_blocks()
    sides = list(zip(tie.spaces, tie.facets, strict=True))

    def parts():
        soft, stiff = Tie(*sides, compliance=1.0), Tie(*sides, conductance=2.0)
        problem = TiedProblem(a, L, bcs=bcs, ties=[soft])
        problem.solve()
        return soft.compliance, stiff.law, soft.constraint.B[0], problem.A, problem.x, problem.b

    compliance, law, B, A, x, b = parts()
    Tie(*sides)  # here the ranks meet, and destroy what all have let go
    assert compliance.matrix(compliance.values()).norm() == law.mass().norm() > 0
    assert B.norm() > 0
    r = b.duplicate()
    A.mult(x, r)
    assert (r - b).norm() <= 1e-12
