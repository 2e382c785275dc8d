# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Bodies with several fields: what stands in for mixed elements, which no tie takes yet."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

import meshes
import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from hypergap_dolfinx import Tie, TiedProblem

pytestmark = pytest.mark.ranks(2)
comm = MPI.COMM_WORLD


def two_blocks():
    return [
        (meshes.block(comm, (4, 4), cell="triangle"), meshes.BOTTOM, meshes.TOP),
        (meshes.block(comm, (3, 3), lambda x: np.add(x, (0, 1))), meshes.TOP, meshes.BOTTOM),
    ]


def error(u, exact):
    expected = fem.Function(u.function_space)
    expected.interpolate(exact)
    return comm.allreduce(np.abs(u.x.array - expected.x.array).max(initial=0), MPI.MAX)


def test_fields_of_one_degree():
    """Three temperatures in one blocked space, coupled in the form; the tie holds for each."""
    V, a, L, bcs, sides = [], [], [], [], []
    coupling = ufl.as_matrix([[2, 1, 0], [1, 2, 0.5], [0, 0.5, 1]])

    def exact(x):
        return np.array([x[1], x[0] - 2 * x[1], x[1] / 2])

    for (mesh, tags), outer, inner in two_blocks():
        W = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        u, v, g = ufl.TrialFunction(W), ufl.TestFunction(W), fem.Function(W)
        g.interpolate(exact)
        facets = np.concatenate([tags.find(t) for t in (outer, meshes.LEFT, meshes.RIGHT)])
        V.append(W)
        a.append(ufl.inner(coupling * ufl.grad(u), ufl.grad(v)) * ufl.dx)
        L.append(None)
        bcs.append(fem.dirichletbc(g, fem.locate_dofs_topological(W, 1, facets)))
        sides.append((W, tags.find(inner)))
    for u in TiedProblem(a, L, bcs=bcs, ties=[Tie(*sides)]).solve():
        assert error(u, exact) <= 1e-13


def test_displacement_and_pressure():
    """Taylor-Hood elements, nearly incompressible: a system of the user's own."""
    mu, compliance = 1.0, 1e-4

    def exact(x):
        return np.array([x[1] + 0.1 * x[0], 0.3 * x[0] - 0.1 * x[1]])

    K, f, bcs, sides = [], [], [], []
    for (mesh, tags), outer, inner in two_blocks():
        V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
        Q = fem.functionspace(mesh, ("Lagrange", 1))
        u, p, v, q = (g(W) for g in (ufl.TrialFunction, ufl.TestFunction) for W in (V, Q))
        strain, zero = lambda w: ufl.sym(ufl.grad(w)), fem.Constant(mesh, PETSc.ScalarType(0))
        a = [
            [2 * mu * ufl.inner(strain(u), strain(v)) * ufl.dx, p * ufl.div(v) * ufl.dx],
            [q * ufl.div(u) * ufl.dx, -compliance * p * q * ufl.dx],
        ]
        loads = [zero * v[0] * ufl.dx, zero * q * ufl.dx]
        g = fem.Function(V)
        g.interpolate(exact)
        facets = np.concatenate([tags.find(t) for t in (outer, meshes.LEFT, meshes.RIGHT)])
        bc = fem.dirichletbc(g, fem.locate_dofs_topological(V, 1, facets))
        K.append([[petsc.assemble_matrix(fem.form(form), [bc]) for form in row] for row in a])
        for row, load in zip(a, loads, strict=True):
            b = petsc.assemble_vector(fem.form(load))
            petsc.apply_lifting(b, [fem.form(row[0])], [[bc]])
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            f.append(b)
        petsc.set_bc(f[-2], [bc])
        for block in (block for row in K[-1] for block in row):
            block.assemble()
        bcs.append(bc)
        sides.append((V, tags.find(inner)))
    tie = Tie(*sides)

    # Prescribed displacements go to the right-hand side, and their columns out of B
    B = [block.copy() for block in tie.blocks()]
    c = B[0].createVecLeft()
    c.set(0.0)
    for block, bc in zip(B, bcs, strict=True):
        given, free = block.createVecRight(), block.createVecRight()
        given.set(0.0)
        petsc.set_bc(given, [bc])
        block.multAdd(-given, c, c)
        free.set(1.0)
        held = bc.dof_indices()[0]
        free.array[held[held < free.local_size]] = 0
        block.diagonalScale(R=free)
    BT = [block.copy().transpose() for block in B]
    A = PETSc.Mat().createNest(
        [
            [*K[0][0], None, None, BT[0]],
            [*K[0][1], None, None, None],
            [None, None, *K[1][0], BT[1]],
            [None, None, *K[1][1], None],
            [B[0], None, B[1], None, None],
        ]
    )
    A.assemble()
    b = PETSc.Vec().createNest([*f, c])
    solver = PETSc.KSP().create(comm)
    solver.setOperators(A)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    x = b.duplicate()
    solver.solve(b, x)
    for i, (V, _) in enumerate(sides):
        u = fem.Function(V)
        u.x.array[: x.getNestSubVecs()[2 * i].local_size] = x.getNestSubVecs()[2 * i].array_r
        u.x.scatter_forward()
        assert error(u, exact) <= 1e-11
