# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The ways to solve the saddle-point system agree, and each says when it can't."""

import logging
import re
from graphlib import CycleError
from itertools import pairwise

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from helpers import raises, sweep, two_ranks

import dolfinx
import meshes
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem import petsc
from hypergap_dolfinx import NonlinearTiedProblem, SolveError, Tie, TiedProblem
from hypergap_dolfinx.algebra import saddle
from hypergap_dolfinx.solvers import choice
from hypergap_dolfinx.solvers.bodywise import Substructures, order_of_bodies

comm = MPI.COMM_WORLD


def pile(
    dim,
    degree=1,
    stiffness=(1.0, 1.0),
    held=(0,),
    kind="vector",
    num=(4, 3),
    flip=False,
    mapping=None,
    dx=ufl.dx,
):
    """Blocks on top of each other, the upper ones (or lower) Γ1 of the ties, all pulled sideways.

    ``num`` cells along the interface, in turn.
    """
    V, a, L, bcs, ends = [], [], [], [], []
    cell = "triangle" if dim == 2 else "tetrahedron"
    for i, E in enumerate(stiffness):
        n = (*[num[i % 2]] * (dim - 1), max(2, num[i % 2] // 2))
        shift = np.eye(dim)[-1] * i

        def placed(x, i=i, shift=shift):
            return mapping(i, x + shift) if mapping else x + shift

        mesh, ft = meshes.block(comm, n, placed, cell=cell)
        lower, upper = (meshes.BOTTOM, meshes.TOP) if dim == 2 else (meshes.BACK, meshes.FRONT)
        shape = (dim,) if kind == "vector" else ()
        W = fem.functionspace(mesh, ("Lagrange", degree, shape))
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        E = fem.Constant(mesh, default_scalar_type(E))  # one kernel for all values
        if kind == "vector":
            a.append(E * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * dx)
            load = default_scalar_type(np.eye(dim)[0] * (i + 1))
        else:
            a.append(E * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
            load = default_scalar_type(i + 1)
        L.append(ufl.inner(fem.Constant(mesh, load), v) * ufl.dx)
        facets = ft.find(lower), ft.find(upper)
        if i in held:
            zero = fem.Function(W)
            where = facets[0] if i == 0 else facets[1]
            bcs.append(fem.dirichletbc(zero, fem.locate_dofs_topological(W, dim - 1, where)))
        V.append(W)
        ends.append(facets)
    pairs = [((V[i], ends[i][1]), (V[i + 1], ends[i + 1][0])) for i in range(len(stiffness) - 1)]
    return a, L, bcs, [Tie(*(pair[::-1] if flip else pair)) for pair in pairs]


def difference(problem, reference):
    """Largest difference of displacements and multipliers, relative to the largest values."""
    worst = 0.0
    pairs = [(u.x.array, v.x.array) for u, v in zip(problem.u, reference.u, strict=True)]
    pairs += [(problem.multipliers(t), reference.multipliers(t)) for t in problem.ties]
    for x, y in pairs:
        size = comm.allreduce(np.abs(y).max(initial=0), MPI.MAX)
        error = comm.allreduce(np.abs(x - y).max(initial=0), MPI.MAX)
        worst = max(worst, error / size)
    return worst


def residual(problem):
    """Of the saddle-point system, relative to its right-hand side."""
    r = problem.b.duplicate()
    problem.A.mult(problem.x, r)
    r.axpy(-1.0, problem.b)
    return r.norm() / problem.b.norm()


@two_ranks(kind=sweep(("vector", "scalar"), 2), dim=sweep((3, 2), 2))
@pytest.mark.parametrize("kind", ("vector", "scalar"))
@pytest.mark.parametrize("dim", (2, 3))
@pytest.mark.parametrize("solver, tolerance", (("bodies", 1e-10), ("iterative", 1e-6)))
def test_solvers_agree(dim, kind, solver, tolerance):
    if dim == 3:
        pytest.importorskip("gmsh")
    a, L, bcs, ties = pile(dim, kind=kind, stiffness=(3.0, 1.0, 1.0))
    direct = TiedProblem(a, L, bcs=bcs, ties=ties, solver="direct")
    direct.solve()
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver=solver)
    problem.solve()
    assert problem.solver.getType() in ("gmres", "cg") and problem.iterations > 1
    assert difference(problem, direct) <= tolerance


@pytest.mark.ranks(held=sweep(((0,), (2,)), 2))
@pytest.mark.parametrize("solver", ("bodies", "iterative"))
@pytest.mark.parametrize("held", ((0,), (2,)))
def test_bodies_held_by_ties_alone(solver, held):
    """Among them one that carries no Γ1: nothing would hold it on its own."""
    a, L, bcs, ties = pile(2, stiffness=(1.0, 1.0, 1.0), held=held)
    direct = TiedProblem(a, L, bcs=bcs, ties=ties, solver="direct")
    direct.solve()
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver=solver)
    problem.solve()
    assert difference(problem, direct) <= (1e-9 if solver == "bodies" else 1e-6)


HOLDS = {
    "floor": lambda V: (None, None),
    "floats": lambda V: ((), None),
    "one component": lambda V: (V.sub(2), None),
    "soft floor": lambda V: ((), 1e-2),
}
"""How the lower body of two is held: the prescribed space (all if None), stiffness of a floor."""


def held_blocks(how, stiffness=(1.0, 1.0), num=(7, 6)):
    """Two blocks in space, of which the upper one, with Γ1, is clamped."""
    a, L, bcs, ties = pile(3, stiffness=stiffness, held=(0, 1), num=num)
    V = ties[0].spaces[0]
    space, floor = HOLDS[how](V)
    low = dolfinx.mesh.locate_entities_boundary(V.mesh, 2, lambda x: np.isclose(x[2], 0))
    if space is not None:
        bcs = bcs[1:]
        if space != ():
            dofs = fem.locate_dofs_topological(space, 2, low)
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, space))
    if floor:
        tags = dolfinx.mesh.meshtags(V.mesh, 2, np.sort(low), np.ones(len(low), dtype=np.int32))
        ds = ufl.Measure("ds", V.mesh, subdomain_data=tags)
        k = fem.Constant(V.mesh, default_scalar_type(floor))
        a[0] += k * ufl.inner(*a[0].arguments()[::-1]) * ds(1)
    return TiedProblem(a, L, bcs=bcs, ties=ties, solver="bodies")


@pytest.mark.ranks(2, how=["floats"])
@pytest.mark.parametrize("how", HOLDS)
def test_iterations_of_a_body_with_smooth_side_alone(how):
    """As many however the body is held, and whatever the contrast."""
    pytest.importorskip("gmsh")
    its = []
    for stiffness in ((1.0, 1.0), (1.0, 1e-3), (1.0, 1e3)):
        problem = held_blocks(how, stiffness)
        problem.solve()
        its.append(problem.iterations)
    # The order of multipliers makes 51 to 62 of the last one. With springs: 45, 19, over 120
    assert (np.array(its) <= (31, 9, 70)).all(), str(its)


def test_rigid_motions_of_a_soft_body(monkeypatch):
    """Their eigenvalues are amid the others, if these are large."""
    pytest.importorskip("gmsh")
    its = []
    for _ in range(2):
        problem = held_blocks("floor", (1.0, 1e3), (13, 12))
        problem.solve()
        its.append(problem.iterations)
        monkeypatch.setattr(Substructures, "_excess", lambda self, i: 1.0)
    assert its[0] <= 0.8 * its[1], str(its)  # 116 and 161


@pytest.mark.ranks(2)
@pytest.mark.parametrize("kind", ("vector", "scalar"))
def test_what_floats_resists_no_rigid_motion(monkeypatch, kind):
    """Nor if its Γ1 has nodes beyond the other side: these go along, too."""
    found, others = [], Substructures._others

    def recorded(self, i):
        found.append(others(self, i))
        return found[-1]

    monkeypatch.setattr(Substructures, "_others", recorded)
    V, sides, a = [], [], []
    for size, n, low, tag in (((2.4, 1.4, 0.5), 5, -0.5, "FRONT"), ((1, 1, 1), 4, 0, "BACK")):
        shift = (0.2 * (low == 0), 0.2 * (low == 0), low)
        mesh, ft = meshes.block(
            comm, (n, n, 2), lambda x, size=size, shift=shift: x * size + shift, cell="tetrahedron"
        )
        V.append(fem.functionspace(mesh, ("Lagrange", 2, (3,) if kind == "vector" else ())))
        sides.append((V[-1], ft.find(getattr(meshes, tag))))
        u, v = ufl.TrialFunction(V[-1]), ufl.TestFunction(V[-1])
        strain = (lambda w: ufl.sym(ufl.grad(w))) if kind == "vector" else ufl.grad
        a.append(ufl.inner(strain(u), strain(v)) * ufl.dx)
    top = dolfinx.mesh.locate_entities_boundary(V[1].mesh, 2, lambda x: np.isclose(x[2], 1))
    bc = fem.dirichletbc(fem.Function(V[1]), fem.locate_dofs_topological(V[1], 2, top))
    problem = TiedProblem(a, [None, None], bcs=[bc], ties=[Tie(*sides[::-1])], solver="bodies")
    problem.solve()
    assert len(found) == 2
    assert all(np.abs(Y).max(initial=0) <= 1e-5 for Y in found)


@pytest.mark.ranks(2)
@pytest.mark.parametrize("flip", (False, True))
@pytest.mark.parametrize("held", ((0,), (3,), (0, 3)))
def test_iterations_of_bodies_in_a_row(held, flip):
    """However they are held; each takes along those behind it."""
    pytest.importorskip("gmsh")
    a, L, bcs, ties = pile(3, stiffness=(1.0,) * 4, held=held, flip=flip, num=(5, 4))
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver="bodies")
    problem.solve()
    assert problem.iterations <= 50  # 30 to 47: round-off, by processor, changes them by 3


def test_too_many_bodies_in_a_row():
    """Who runs out of iterations is told why."""
    a, L, bcs, ties = pile(2, stiffness=(1.0, 1.0, 1.0))
    options = {"ksp_max_it": 3}
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver="bodies", petsc_options=options)
    with pytest.raises(SolveError, match='in a row, and there are 3; take solver="direct"'):
        problem.solve()


@two_ranks()
def test_residual_of_the_saddle_system():
    a, L, bcs, ties = pile(2, degree=2)
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver="bodies")
    problem.solve()
    assert residual(problem) <= 1e-11  # the iteration ends at 1e-13, of another norm


@pytest.mark.ranks(2)
@pytest.mark.parametrize(
    "options, steps",
    (
        ({}, 2),
        ({"ksp_max_it": 1, "mat_mumps_icntl_14": 50}, 1),  # without refinement
        ({"ksp_max_it": 3}, 2),  # what isn't needed isn't done
        ({"ksp_initial_guess_nonzero": True}, 2),  # which factors don't need
        ({"ksp_norm_type": "unpreconditioned", "ksp_rtol": 1e-6}, 1),  # 1e-9 is round-off here
    ),
)
def test_steps_of_refinement(options, steps, caplog):
    a, L, bcs, ties = pile(3, stiffness=(1e6, 1.0, 1e4))
    options = {"mat_mumps_cntl_1": 1e-4, **options}  # few pivots: 3e-13
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver="direct", petsc_options=options)
    problem.assemble_matrix()
    for _ in range(2):  # with the same factors
        problem.assemble_vector()
        problem.solve_system()
        assert problem.iterations == steps
        assert (saddle.Errors(problem.A, len(ties)).backward(problem.x, problem.b) > 1e-15) == (
            steps == 1
        )
    assert problem.solver.max_it == options.get("ksp_max_it", 5)
    guess = "ksp_initial_guess_nonzero" in options
    assert problem.solver.getInitialGuessNonzero() == guess and "misspelt" not in caplog.text


def iterations(solver, contrasts, **options):
    its = []
    for contrast in contrasts:
        a, L, bcs, ties = pile(stiffness=(1.0, contrast), **options)
        problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver=solver)
        problem.solve()
        its.append(problem.iterations)
    return its


@two_ranks()
def test_contrasts_body_by_body():
    """With Γ1 on the softer side, however much softer, there are about as many iterations."""
    its = iterations("bodies", (1.0, 1e-3, 1e-6), dim=2)
    assert max(its) <= 2 * its[0]


@two_ranks(flip=[False])
@pytest.mark.parametrize("flip", (False, True))
def test_iterations_beside_one_body(flip):
    """A tie of two blocks takes about as many as each block alone: smoothing holds the tie."""
    blocks = [(6, 0.0), (9, 1.0)]
    its, options = [], PETSc.Options().getAll()
    for some in ([blocks[0]], blocks):
        V, sides, a, L, bcs = [], [], [], [], []
        for n, low in some:
            place = np.array((0, 0, low))
            mesh, ft = meshes.block(comm, (n, n, n), lambda x, p=place: x + p, cell="hexahedron")
            V.append(fem.functionspace(mesh, ("Lagrange", 1, (3,))))
            u, v = ufl.TrialFunction(V[-1]), ufl.TestFunction(V[-1])
            strain, x = [ufl.sym(ufl.grad(w)) for w in (u, v)], ufl.SpatialCoordinate(mesh)
            a.append(ufl.inner(strain[0] + ufl.tr(strain[0]) * ufl.Identity(3), strain[1]) * ufl.dx)
            L.append(ufl.inner(ufl.as_vector((ufl.sin(3 * x[1]), x[0], 1 + x[2])), v) * ufl.dx)
            sides.append((V[-1], ft.find(meshes.BACK if low else meshes.FRONT)))
            if not low:
                dofs = fem.locate_dofs_topological(V[-1], 2, ft.find(meshes.BACK))
                bcs.append(fem.dirichletbc(np.zeros(3, dtype=default_scalar_type), dofs, V[-1]))
        ties = [Tie(*(sides[::-1] if flip else sides))] if len(sides) > 1 else []
        problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver="iterative")
        problem.solve()
        its.append(problem.iterations)
    assert its[1] <= its[0] + 4, str(its)  # 17 and 14, 21 with springs
    assert PETSc.Options().getAll() == options


@pytest.mark.ranks(2, num=sweep([(6, 3), (15, 14)], 2), flip=[False])
@pytest.mark.parametrize("dim, num", ((2, (30, 5)), (2, (5, 30)), (2, (15, 14)), (3, (6, 3))))
@pytest.mark.parametrize("flip", (False, True))
def test_contrasts_with_multigrid(dim, num, flip):
    """As many iterations whichever side is stiffer, finer, and Γ1."""
    if dim == 3:
        pytest.importorskip("gmsh")
    its = iterations("iterative", (1.0, 1e-6, 1e-3, 1e3, 1e6), dim=dim, num=num, flip=flip)
    assert max(its) <= 2 * its[0]


@pytest.mark.parametrize("contrast, flip", ((1e6, False), (1e-6, True)))
@pytest.mark.parametrize("num", ((31, 30), (40, 20)))
def test_contrasts_with_graded_cells(num, contrast, flip):
    """Γ1 is the finer side at one end and the coarser one at the other."""

    def graded(i, x):
        s = 2 * (x[:, 0] if i == 0 else 1 - x[:, 0])
        radius, angle = np.exp(s), x[:, 1] - 1
        x_radial = radius * np.cos(angle)
        x = x.copy()
        x[:, 0] = x_radial if i == 0 else 1 + np.exp(2) - x_radial
        x[:, 1] = radius * np.sin(angle)
        return x

    its = iterations("iterative", (1.0, contrast), dim=2, num=num, flip=flip, mapping=graded)
    assert its[1] <= 2 * its[0]


@two_ranks()
@pytest.mark.parametrize("solver", ("bodies", "iterative"))
def test_without_ties(solver):
    """An ordinary problem is solved too: what a tied one is compared with."""
    a, L, bcs, _ = pile(2, stiffness=(1.0,))
    direct = TiedProblem(a, L, bcs=bcs, solver="direct")
    problem = TiedProblem(a, L, bcs=bcs, solver=solver)
    np.testing.assert_allclose(problem.solve()[0].x.array, direct.solve()[0].x.array, atol=1e-8)


@two_ranks(unit=[1e9])
@pytest.mark.parametrize("unit", (1e-6, 1.0, 1e9))
def test_units_do_not_matter(unit):
    """Stiffness in other units: as many iterations, and the same multipliers."""
    its, multipliers = [], []
    for E in (unit, 1.0):
        a, L, bcs, ties = pile(2, stiffness=(E, E))
        problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver="bodies")
        problem.solve()
        multipliers.append(problem.multipliers(ties[0]))
        # Near round-off, where that ends, the number of iterations is chance on several ranks
        problem.solver.setTolerances(rtol=1e-8)
        problem.solve()
        its.append(problem.iterations)
    assert abs(its[0] - its[1]) <= 1
    np.testing.assert_allclose(*multipliers, atol=1e-9)


@two_ranks(E=[1e15])
@pytest.mark.parametrize("E", (1e-15, 1e15))
@pytest.mark.parametrize("solver", choice.SOLVERS)
def test_displacements_in_other_units(solver, E):
    """Round-off of a tie between large displacements is no residual next to small loads."""
    u = []
    for stiffness in (E, 1.0):
        a, L, bcs, ties = pile(2, stiffness=(stiffness, stiffness))
        problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver=solver)
        u.append([stiffness * f.x.array for f in problem.solve()])
    for one, other in zip(*u, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-8)


def pulled(E, solver, dim=2, contrast=1.0, num=(4, 3), **options):
    """Two blocks in units where stiffness is E, the upper one moved by 1 at its top."""
    a, L, bcs, ties = pile(dim, stiffness=(E, E * contrast), num=num)
    V = ties[0].spaces[1]
    g = fem.Function(V)
    g.interpolate(lambda x: np.ones_like(x[:dim]))
    top = dolfinx.mesh.locate_entities_boundary(
        V.mesh, dim - 1, lambda x: np.isclose(x[dim - 1], 2)
    )
    bcs = [*bcs, fem.dirichletbc(g, fem.locate_dofs_topological(V, dim - 1, top))]
    L = [
        fem.Constant(W.mesh, default_scalar_type(E)) * f
        for W, f in zip(ties[0].spaces, L, strict=True)
    ]
    return TiedProblem(a, L, bcs=bcs, ties=ties, solver=solver, **options)


@pytest.mark.ranks(2, E=[1e-14])
@pytest.mark.parametrize("E", (1e-14, 1e-9, 1e9))
@pytest.mark.parametrize("solver, tolerance", (("bodies", 1e-10), ("iterative", 1e-7)))
def test_units_of_prescribed_displacements(solver, tolerance, E):
    """Rows of prescribed dofs don't hide the others' residual, whatever the units."""
    reference = pulled(1.0, "direct")
    problem = pulled(E, solver)
    for u, v in zip(problem.solve(), reference.solve(), strict=True):
        np.testing.assert_allclose(u.x.array, v.x.array, atol=tolerance)


def strain(u):
    """√∫|∇u|² dx."""
    form = fem.form(ufl.inner(ufl.grad(u), ufl.grad(u)) * ufl.dx)
    return np.sqrt(comm.allreduce(fem.assemble_scalar(form)))


@two_ranks(contrast=[1e6])
@pytest.mark.parametrize("contrast", (1e-6, 1e3, 1e6))
def test_small_forces_of_stiff_bodies(contrast):
    """Prescribed displacements are large loads on a stiff body that hardly deforms in the end."""
    reference = pulled(1.0, "direct", contrast=contrast, num=(20, 5))
    problem = pulled(1.0, "iterative", contrast=contrast, num=(20, 5))
    for u, v in zip(problem.solve(), reference.solve(), strict=True):
        exact = strain(v)
        v.x.array[:] -= u.x.array
        assert strain(v) <= 1e-7 * exact


@two_ranks()
@pytest.mark.parametrize("solver", choice.SOLVERS)
def test_without_forces(solver):
    """A body that floats closes its gap to one that rests: round-off is no wrong answer."""
    V, sides, a = [], [], []
    for y, tag, n in ((0, meshes.TOP, (6, 4)), (0.98, meshes.BOTTOM, (4, 3))):
        mesh, ft = meshes.block(comm, n, lambda x, y=y: x + np.array((0, y)), cell="triangle")
        V.append(fem.functionspace(mesh, ("Lagrange", 1, (2,))))
        sides.append((V[-1], ft.find(tag)))
        u, v = ufl.TrialFunction(V[-1]), ufl.TestFunction(V[-1])
        a.append(ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx)
    bc = fem.dirichletbc(
        fem.Function(V[0]), fem.locate_dofs_topological(V[0], 1, facets_at(V[0], 0))
    )
    tie = Tie(*sides, close_gap=True)
    u0, u1 = TiedProblem(a, [None, None], bcs=[bc], ties=[tie], solver=solver).solve()
    np.testing.assert_allclose(u0.x.array, 0, atol=1e-9)
    np.testing.assert_allclose(u1.x.array.reshape(-1, 2) - [[0, 0.02]], 0, atol=1e-9)


@two_ranks()
@pytest.mark.parametrize("solver", ("direct", "bodies", "iterative"))
def test_assembled_in_any_order(solver):
    """The right-hand side knows the scale of the prescribed rows, before the matrix and after."""
    problem, reference = pulled(1e-6, solver), pulled(1e-6, "direct")
    problem.assemble_vector()
    with pytest.raises(ValueError, match=r"call assemble_matrix\(\)"):
        problem.solve_system()
    problem.assemble_matrix()
    problem.solve_system()
    for u, v in zip(problem.u, reference.solve(), strict=True):
        np.testing.assert_allclose(u.x.array, v.x.array, atol=1e-7)


@pytest.mark.ranks(2)
def test_a_matrix_of_another_size():
    """Stiffness and load that both grow don't change the displacements, nor their accuracy."""
    a, L, bcs, ties = pile(2)
    factors = [fem.Constant(V.mesh, default_scalar_type(1.0)) for V in ties[0].spaces]
    a = [c * form for c, form in zip(factors, a, strict=True)]
    L = [c * form for c, form in zip(factors, L, strict=True)]
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver="bodies")
    u = [f.x.array.copy() for f in problem.solve()]
    for value in (1e8, 1e-8):
        for c in factors:
            c.value = value
        for f, before in zip(problem.solve(), u, strict=True):
            np.testing.assert_allclose(
                f.x.array, before, atol=1e-11 * np.abs(before).max(initial=1)
            )


def two_parts(solver, num_ties=2):
    """A block tied to one mesh of two blocks, which floats in two parts; its first tie first."""
    V = []
    for z in (0, 1):
        n = (6, 2, 2) if z == 0 else (3, 2, 2)
        mesh, _ = meshes.block(
            comm, n, lambda x, z=z: x * (3, 1, 1) + (0, 0, z), cell="tetrahedron"
        )
        if z == 1:
            tdim = 3
            mesh.topology.create_connectivity(tdim, tdim)
            centres = dolfinx.mesh.compute_midpoints(
                mesh, tdim, np.arange(mesh.topology.index_map(tdim).size_local, dtype=np.int32)
            )
            cells = np.flatnonzero((centres[:, 0] < 1) | (centres[:, 0] > 2)).astype(np.int32)
            mesh = dolfinx.mesh.create_submesh(mesh, tdim, cells)[0]
        V.append(fem.functionspace(mesh, ("Lagrange", 2)))
    a, L = [], []
    for i, W in enumerate(V):
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        x = ufl.SpatialCoordinate(W.mesh)
        a.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        L.append((1.0 + i * x[0]) * v * ufl.dx)
    at = [
        dolfinx.mesh.locate_entities_boundary(W.mesh, 2, lambda x: np.isclose(x[2], 1)) for W in V
    ]
    low = dolfinx.mesh.locate_entities_boundary(V[0].mesh, 2, lambda x: np.isclose(x[2], 0))
    bcs = [fem.dirichletbc(0.0, fem.locate_dofs_topological(V[0], 2, low), V[0])]
    sides = []
    for lower, upper in ((0, 1), (2, 3)):
        pair = []
        for W, facets in zip(V, at, strict=True):
            x = dolfinx.mesh.compute_midpoints(W.mesh, 2, facets)[:, 0]
            pair.append((W, facets[(x > lower) & (x < upper)]))
        sides.append(Tie(*pair[::-1]))
    return TiedProblem(a, L, bcs=bcs, ties=sides[:num_ties], solver=solver)


@pytest.mark.ranks
def test_a_body_in_two_parts():
    """Both parts of a mesh may float."""
    pytest.importorskip("gmsh")
    direct, problem = two_parts("direct"), two_parts("bodies")
    direct.solve()
    problem.solve()
    assert problem.solver.getPC().getType() == "python"
    for u, v in zip(problem.u, direct.u, strict=True):
        np.testing.assert_allclose(u.x.array, v.x.array, atol=1e-10)


@two_ranks()
def test_a_part_that_nothing_holds():
    """It is counted, also if no load moves it: a factor may not notice."""
    pytest.importorskip("gmsh")
    for solver in choice.SOLVERS:
        problem = two_parts(solver, num_ties=1)
        with pytest.raises(SolveError, match="singular: 1 rigid motion of the bodies is free"):
            problem.solve()


@pytest.mark.ranks(2)
def test_options_besides_the_solvers_own():
    """Naming a tolerance keeps the solver; naming a type of PC replaces it."""
    for solver, pc in (("direct", "lu"), ("bodies", "python"), ("iterative", "mg")):
        a, L, bcs, ties = pile(2)
        options = {"ksp_rtol": 1e-7, "ksp_error_if_not_converged": False}
        problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver=solver, petsc_options=options)
        problem.solve()
        assert problem.solver.getPC().getType() == pc
        assert problem.solver.getTolerances()[0] == 1e-7
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, petsc_options={"pc_type": "none"})
    assert problem.solver.getType() == "gmres"


@pytest.mark.parametrize(
    "solver, options",
    (
        ("bodies", {"ksp_type": "fgmres"}),
        ("iterative", {"pc_type": "gamg"}),
        ("iterative", {"ksp_type": "gmres", "ksp_gmres_restart": 50}),
    ),
)
def test_options_of_a_named_solver(solver, options):
    """What a named solver is made of stays, whatever type is named."""
    a, L, bcs, ties = pile(2)
    direct = TiedProblem(a, L, bcs=bcs, ties=ties, solver="direct")
    direct.solve()
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver=solver, petsc_options=options)
    problem.solve()
    assert problem.iterations < 40
    assert difference(problem, direct) <= 1e-7


@two_ranks()
def test_preconditioner_of_bodies():
    """Another one can't take its place: PETSc ended the process."""
    a, L, bcs, ties = pile(2)
    for options in ({"pc_type": "jacobi"}, {"pc_type": "lu"}):
        with pytest.raises(SolveError, match="preconditioner of its own"):
            TiedProblem(a, L, bcs=bcs, ties=ties, solver="bodies", petsc_options=options)


@pytest.mark.parametrize("reaction, match", ((-5.0, "symmetric and positive"), (-1e4, "diagonal")))
def test_multigrid_is_for_definite_stiffness(reaction, match):
    """The message says so."""
    a, L, bcs, ties = pile(2, num=(12, 8))
    a = [form + reaction * ufl.inner(*form.arguments()[::-1]) * ufl.dx for form in a]
    TiedProblem(a, L, bcs=bcs, ties=ties, solver="direct").solve()
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver="iterative")
    for _ in range(2):  # not the first time alone
        with pytest.raises(SolveError, match=f'{match}.* take solver="direct"'):
            problem.solve()


@pytest.mark.ranks(2)
@pytest.mark.parametrize("pc", ("gamg", "ilu", "no such"))
def test_options_that_dont_fit(pc):
    """What PETSc says of them comes in one line, with what does fit."""
    a, L, bcs, ties = pile(2)
    match = "Unable to find" if pc == "no such" else "MatNest"
    with pytest.raises(SolveError, match=rf"^PETSc can't solve with these options: .*{match}"):
        TiedProblem(a, L, bcs=bcs, ties=ties, petsc_options={"pc_type": pc}).solve()
    split = {"ksp_type": "gmres", "pc_type": "fieldsplit"}
    with pytest.raises(SolveError, match="give each split a solver of its own"):
        TiedProblem(a, L, bcs=bcs, ties=ties, petsc_options=split).solve()


@two_ranks()
def test_a_changed_matrix_is_factorised_anew():
    a, L, bcs, ties = pile(2)
    modulus = fem.Constant(ties[0].spaces[0].mesh, default_scalar_type(1.0))
    a = [modulus * a[0], a[1]]
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver="bodies")
    direct = TiedProblem(a, L, bcs=bcs, ties=ties, solver="direct")
    for value in (1.0, 0.5):
        modulus.value = value
        problem.solve()
        direct.solve()
        assert difference(problem, direct) <= 1e-10
    problem.assemble_vector()
    with PETSc.Log.Event("MatLUFactorNum") as event:
        pass
    PETSc.Log.begin()
    count = event.getPerfInfo()["count"]
    problem.solve_system()
    assert event.getPerfInfo()["count"] == count


@two_ranks()
def test_multigrid_of_a_changed_matrix():
    """Iterations are those of a new problem."""
    a, L, bcs, ties = pile(3, num=(10, 8))
    modulus = fem.Constant(ties[0].spaces[0].mesh, default_scalar_type(1.0))
    a = [modulus * a[0], a[1]]
    problem, its = TiedProblem(a, L, bcs=bcs, ties=ties, solver="iterative"), []
    for value in (1.0, 1e-3, 1e3, 1.0):
        modulus.value = value
        problem.solve()
        its.append(problem.iterations)
    assert max(its) <= 27 and its[3] == its[0], str(its)


@two_ranks()
def test_cells_that_deform_without_a_stress():
    """Triangles of degree 2 with one quadrature point: no load shows what is undetermined."""
    a, _, bcs, ties = pile(2, degree=2, dx=ufl.dx(metadata={"quadrature_degree": 1}))
    words = "found again from its loads; .* quadrature degree is too low for its element"
    problem = TiedProblem(a, [None] * 2, bcs=bcs, ties=ties, solver="direct")
    problem.solve()  # zero, which tells nothing
    bcs[0].g.x.array[:] = 0.1
    with pytest.raises(SolveError, match=words):
        problem.solve()
    us = [fem.Function(space) for space in ties[0].spaces]
    F = [ufl.action(form, u) for form, u in zip(a, us, strict=True)]
    for lag in ({}, {"snes_lag_preconditioner": -2, "snes_lag_preconditioner_persists": True}):
        with pytest.raises(SolveError, match=words):
            NonlinearTiedProblem(F, us, bcs=bcs, ties=ties, petsc_options=lag).solve()


def cantilever(length, num=20):
    """Two tied halves of height 1 under their weight: forms, conditions, ties; a deflection."""
    a, L, bcs, sides = [], [], [], []
    for i, tags in enumerate(((meshes.LEFT, meshes.RIGHT), (meshes.RIGHT, meshes.LEFT))):

        def placed(x, i=i):
            return np.column_stack(((x[:, 0] + i) * length / 2, x[:, 1]))

        mesh, ft = meshes.block(comm, (num + i, 2), placed, cell="triangle")
        V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        e, stretch = (ufl.sym(ufl.grad(w)) for w in (u, v)), ufl.inner(ufl.div(u), ufl.div(v))
        a.append((2 * ufl.inner(*e) + stretch) * ufl.dx)
        L.append(-ufl.inner(fem.Constant(mesh, default_scalar_type(1)), v[1]) * ufl.dx)
        sides.append((V, ft.find(tags[1])))
        if i == 0:
            held = fem.locate_dofs_topological(V, 1, ft.find(tags[0]))
            bcs = [fem.dirichletbc(np.zeros(2, dtype=default_scalar_type), held, V)]
    return (a, L, bcs, [Tie(*sides)]), length**4 / 8 / (8 / 3 / 12)


@two_ranks()
def test_slender_bodies_lose_digits(caplog):
    """Residuals are round-off of stiffness times displacement, far above the loads' bound."""
    (a, L, bcs, ties), deflection = cantilever(700)
    u = TiedProblem(a, L, bcs=bcs, ties=ties).solve()[1].x.array
    assert comm.allreduce(abs(u).max(initial=0), MPI.MAX) == pytest.approx(deflection, rel=5e-3)
    assert comm.rank or "digits are lost: the error is about" in caplog.text
    (a, L, bcs, ties), _ = cantilever(3000)
    u = [fem.Function(V) for V in ties[0].spaces]
    F = [ufl.action(form, f) - load for form, f, load in zip(a, u, L, strict=True)]
    for problem in (
        TiedProblem(a, L, bcs=bcs, ties=ties),
        NonlinearTiedProblem(F, u, bcs=bcs, ties=ties),
    ):
        with raises(SolveError, "nearly singular: the error is about .* of u, as of slender"):
            problem.solve()


@two_ranks()
def test_a_step_solves_once(monkeypatch):
    """All steps have one factorisation; a residual that isn't round-off is solved for too."""
    a, L, bcs, ties = pile(2)
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver="direct")
    problem.assemble_matrix()
    events = [PETSc.Log.Event(name) for name in ("MatLUFactorNum", "MatSolve")]
    for event in events:
        with event:
            pass
    PETSc.Log.begin()

    def counts():
        problem.assemble_vector()
        problem.solve_system()
        return np.array([event.getPerfInfo()["count"] for event in events])

    first = counts()
    assert (counts() - first).tolist() == [0, 1]
    exact = [u.x.array.copy() for u in problem.u]
    monkeypatch.setattr("hypergap_dolfinx.solvers.solver.REFINED", 0.0)
    factors, solves = counts() - first
    assert factors == 0 and solves > 2
    for u, values in zip(problem.u, exact, strict=True):
        np.testing.assert_allclose(u.x.array, values, atol=1e-13 * np.abs(values).max(initial=0))


@two_ranks()
def test_a_step_has_no_idle_work(monkeypatch):
    """One residual, and no lifting of prescribed displacements that are all zero."""
    a, L, bcs, ties = pile(2)
    problem = TiedProblem(a, L, bcs=bcs, ties=ties, solver="direct")
    problem.solve()
    done = []

    def counted(owner, name):
        function = getattr(owner, name)

        def call(*args, **options):
            done.append(name)
            return function(*args, **options)

        monkeypatch.setattr(owner, name, call)

    counted(petsc, "apply_lifting")
    counted(saddle.Errors, "_residuals")
    for value, wanted in ((0.0, 1), (0.1, 2), (0.0, 1)):
        bcs[0].g.x.array[:] = default_scalar_type(value)
        done.clear()
        problem.assemble_vector()
        problem.solve_system()
        assert len(done) == wanted
        again = TiedProblem(a, L, bcs=bcs, ties=ties, solver="direct")
        again.solve()
        assert difference(problem, again) <= 1e-13


@two_ranks()
def test_the_default(monkeypatch):
    """The whole system is factorised in the plane and for small bodies; one name overrules that."""
    a, L, bcs, ties = pile(2)
    problem = TiedProblem(a, L, bcs=bcs, ties=ties)
    problem.solve()
    assert problem.solver.getPC().getType() == "lu"
    pytest.importorskip("gmsh")
    a, L, bcs, ties = pile(3)
    problem = TiedProblem(a, L, bcs=bcs, ties=ties)
    problem.solve()
    assert problem.solver.getPC().getType() == "lu"
    monkeypatch.setattr(choice, "LARGE_SYSTEM", 100)
    large = TiedProblem(a, L, bcs=bcs, ties=ties)
    large.solve()
    assert large.solver.getPC().getType() == "python"
    assert difference(large, problem) <= 1e-10
    alone = TiedProblem(a[:1], L[:1], bcs=bcs)
    alone.solve()
    assert alone.solver.getPC().getType() == "lu"


@pytest.mark.ranks(2)
def test_the_default_of_bodies_that_ties_hold(monkeypatch, caplog):
    """As many iterations with Γ0 alone; multigrid is the default then, and takes less time."""
    monkeypatch.setattr(choice, "LARGE_SYSTEM", 100)
    iterations = []
    for flip in (False, True):
        a, L, bcs, ties = pile(3, flip=flip, stiffness=(1.0, 1.0, 1.0))
        named = TiedProblem(a, L, bcs=bcs, ties=ties, solver="bodies")
        named.solve()
        iterations.append(named.iterations)
        with caplog.at_level(logging.INFO):
            problem = TiedProblem(a, L, bcs=bcs, ties=ties)
        problem.solve()
        assert problem.solver_name == ("iterative" if flip else "bodies")
        assert difference(problem, named) <= 1e-8
    assert iterations[1] <= 1.4 * iterations[0], str(iterations)  # 36 and 28; with springs 74
    assert comm.rank or 'not "bodies", body 2 has neither Γ1 nor' in caplog.text


@pytest.mark.ranks(2)
def test_the_default_falls_back(monkeypatch):
    """A much stiffer Γ1 would take hundreds of iterations."""
    monkeypatch.setattr(choice, "LARGE_SYSTEM", 100)
    pytest.importorskip("gmsh")
    a, L, bcs, ties = pile(3, stiffness=(1.0, 1e3))
    options = dict(choice.BudgetedBodies.OPTIONS, ksp_max_it=5)
    monkeypatch.setattr(choice.BudgetedBodies, "OPTIONS", options)
    problem = TiedProblem(a, L, bcs=bcs, ties=ties)
    given_up = problem.solver
    problem.solve()
    assert problem.solver.getPC().getType() == "lu" and problem.iterations <= 2
    assert (
        given_up.getType() == "gmres" and given_up.getIterationNumber() == 5
    )  # who holds it, has it
    direct = TiedProblem(a, L, bcs=bcs, ties=ties, solver="direct")
    direct.solve()
    assert difference(problem, direct) <= 1e-8
    problem.solve()


def circle(turned=()):
    """Two boxes on a third one, each Γ1 of one tie and Γ0 of another; parts of a problem.

    Those of ``turned`` have exchanged their sides.
    """
    boxes = ((0, 0), (2, 1), 4), ((0, 1), (1, 2), 3), ((1, 1), (2, 2), 5)  # x, z; cells across
    V, a, L, bcs = [], [], [], []
    for i, ((x0, z0), (x1, z1), n) in enumerate(boxes):
        size, at = np.array((x1 - x0, 1, z1 - z0)), np.array((x0, 0, z0))
        mesh, ft = meshes.block(
            comm, (n, n, 2), lambda x, size=size, at=at: at + x * size, cell="hexahedron"
        )
        V.append(fem.functionspace(mesh, ("Lagrange", 1)))
        u, v = ufl.TrialFunction(V[-1]), ufl.TestFunction(V[-1])
        modulus, load = (fem.Constant(mesh, default_scalar_type(k)) for k in (1, i))
        a.append(modulus * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        L.append(ufl.inner(load, v) * ufl.dx)
        if i == 0:
            dofs = fem.locate_dofs_topological(V[0], 2, ft.find(meshes.BACK))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V[0]))

    def side(i, axis):
        return V[i], dolfinx.mesh.locate_entities_boundary(
            V[i].mesh, 2, lambda x: np.isclose(x[axis], 1)
        )

    pairs = [(side(i, axis), side(j, axis)) for i, j, axis in ((0, 1, 2), (1, 2, 0), (2, 0, 2))]
    ties = [Tie(*(pair[::-1] if t in turned else pair)) for t, pair in enumerate(pairs)]
    return modulus, (a, L), {"bcs": bcs, "ties": ties}


@two_ranks()
def test_the_default_in_circles(monkeypatch, caplog):
    """Multigrid for large bodies, as long as its iterations are cheaper than factors."""
    modulus, forms, parts = circle()
    direct = TiedProblem(*forms, **parts)
    direct.solve()
    assert direct.solver_name == "direct"
    monkeypatch.setattr(choice, "LARGE_SYSTEM", 100)
    with caplog.at_level(logging.INFO):
        problem = TiedProblem(*forms, **parts)
    assert comm.rank or re.search('"iterative": .* not "bodies", tie 0 .* a circle', caplog.text)
    problem.solve()
    assert problem.solver_name == "iterative" and problem.iterations > 5
    assert difference(problem, direct) <= 1e-8
    problem.solver.max_it = 2 * problem.iterations
    for value in (1.0, 2.0, 3.0):  # other matrices: none is solved with often
        modulus.value = value
        problem.solve()
    problem.solve_system()
    assert problem.solver_name == "iterative"
    problem.solve_system()
    assert problem.solver_name == "direct" and problem.iterations <= 2
    direct.solve()
    assert difference(problem, direct) <= 1e-10


@pytest.mark.ranks(2)
def test_the_default_gives_up(monkeypatch, caplog):
    """Of an iteration that converges slowly it says what to do."""
    monkeypatch.setattr(choice, "LARGE_SYSTEM", 100)
    options = dict(choice.BudgetedMultigrid.OPTIONS, ksp_max_it=3)
    monkeypatch.setattr(choice.BudgetedMultigrid, "OPTIONS", options)
    _, forms, parts = circle()
    problem = TiedProblem(*forms, **parts)
    problem.solve()
    assert problem.solver_name == "direct"
    assert comm.rank or 'is given up for "direct"' in caplog.text


@pytest.mark.ranks(2)
def test_what_is_not_possible():
    a, L, bcs, ties = pile(2)
    with pytest.raises(ValueError, match="solver is one of"):
        TiedProblem(a, L, bcs=bcs, ties=ties, solver="cholesky")
    V = ties[0].spaces
    sides = [(V[0], facets_at(V[0], 1.0)), (V[1], facets_at(V[1], 1.0))]
    free = Tie(*sides, interior="free")
    with pytest.raises(ValueError, match="free interior"):
        TiedProblem(a, L, bcs=bcs, ties=[free], solver="bodies")


def facets_at(V, y):
    """Boundary facets at a height."""
    return dolfinx.mesh.locate_entities_boundary(V.mesh, 1, lambda x: np.isclose(x[1], y))


def test_order_of_bodies():
    assert order_of_bodies(3, [(0, 1), (1, 2)]) == [2, 1, 0]
    assert order_of_bodies(2, []) == [0, 1]
    assert order_of_bodies(3, [(0, 1), (1, 2), (0, 2)]) == [2, 1, 0]
    with pytest.raises(CycleError) as caught:
        order_of_bodies(5, [(3, 0), (0, 1), (1, 2), (2, 0), (2, 4)])
    circle = caught.value.args[1]
    assert sorted(circle[1:]) == [0, 1, 2] and circle[0] == circle[-1]
    assert all(pair in [(1, 0), (2, 1), (0, 2)] for pair in pairwise(circle))
    with pytest.raises(CycleError):
        order_of_bodies(1, [(0, 0)])


@pytest.mark.ranks(2, turned=[(2,)])
@pytest.mark.parametrize(
    "turned, says",
    (
        ((), "tie 0 .* tie 1 .* and tie 2 .* lead round in a circle"),
        ((2,), "tie 0 .* moves body 2, .* Γ0 of body 0 .* with body 1 and body 2"),
        ((0,), None),
    ),
)
def test_bodies_without_an_order(turned, says):
    """The ties are named, and what helps: the last case is what the second is told to do."""
    _, forms, parts = circle(turned)
    if says is None:
        TiedProblem(*forms, **parts, solver="bodies").solve()
        return
    with pytest.raises(ValueError, match=says):
        TiedProblem(*forms, **parts, solver="bodies")
