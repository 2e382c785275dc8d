# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Levels of multigrid: Galerkin products, with springs beside them."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from assembly import rectangle

import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from hypergap_dolfinx.algebra import hierarchy as hierarchy_module
from hypergap_dolfinx.algebra.hierarchy import Hierarchy, block_diagonal
from hypergap_dolfinx.algebra.rigid_motions import motions, orthonormal
from hypergap_dolfinx.core.sparse import coo_matrix
from hypergap_dolfinx.solvers.multigrid import Multigrid
from hypergap_dolfinx.solvers.solver import Options

comm = MPI.COMM_WORLD


def springs_on(A, num=3):
    """Some rows on each rank, across all of a matrix's columns."""
    rng = np.random.default_rng(comm.rank)
    i = np.repeat(np.arange(num) + comm.rank * num, 4)
    j = rng.integers(0, A.size[1], len(i))
    return coo_matrix(comm, (num, A.getLocalSize()[1]), i, j, rng.random(len(i)))


@pytest.mark.ranks(options=[{}])
@pytest.mark.parametrize(
    ("options", "convection"),
    (
        ({}, False),
        ({}, True),
        *(
            ({f"mg_{name}": value}, False)
            for name, value in (
                ("levels_pc_type", "sor"),
                ("fine_pc_type", "sor"),
                ("levels_pc_jacobi_type", "rowl1"),
            )
        ),
    ),
)
def test_levels(options, convection):
    """Pᵀ(K + BᵀWB)P of three stiffnesses, symmetric or not; the finest level may project."""
    bodies = [rectangle((24, 20), (0, 0), (1, 1)), rectangle((3, 2), (0, 1), (1, 2))]
    K = []
    for body in bodies:
        v, u = body.a.arguments()
        more = (ufl.inner(u.dx(0), v) * ufl.dx,) if convection else ()
        K.append(petsc.assemble_matrix(fem.form(sum(more, body.a))))
    for of in K:
        of.assemble()
        of.shift(1.0)  # nothing else holds the bodies
    modes = [orthonormal(comm, motions(body.V)) for body in bodies]
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix("levels_")
    with Options("levels_", options, Multigrid.OPTIONS, "").in_use():
        ksp.setFromOptions()
        hierarchy = Hierarchy(K, modes, "levels_aggregates_")
        nested = block_diagonal(K)
        for factor in (1.0, 2.0, 3.0):
            K[0].scale(factor)
            A = nested.convert("aij", PETSc.Mat())
            springs = springs_on(A)
            hierarchy.set_stiffness(A.copy(), ksp)
            hierarchy.attach(ksp, A, springs, Half())
            assert hierarchy.projects == (not options)
            ksp.setUp()
            check_levels(ksp.getPC(), A, springs, hierarchy.projects)
            for obj in (A, springs):
                obj.destroy()
    hierarchy.destroy()
    for obj in (ksp, nested, *K):
        obj.destroy()


class Half:
    """A projector that gives half of a vector."""

    has_diagonal = is_symmetric = True

    def project(self, u):
        u.scale(0.5)

    project_transpose = project


def test_eigenvalues_are_kept(monkeypatch):
    """For fewer springs, no level's largest eigenvalue is estimated again; for others all are."""
    body, calls = rectangle((40, 40), (0, 0), (1, 1)), []
    K = petsc.assemble_matrix(fem.form(body.a))
    K.assemble()
    K.shift(1.0)
    find = hierarchy_module._largest_eigenvalue

    def found(matrix, prefix):
        calls.append(matrix)
        return find(matrix, prefix)

    monkeypatch.setattr(hierarchy_module, "_largest_eigenvalue", found)
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix("kept_")
    with Options("kept_", {}, Multigrid.OPTIONS, "").in_use():
        ksp.setFromOptions()
        hierarchy = Hierarchy([K], [orthonormal(comm, motions(body.V))], "kept_aggregates_")
        hierarchy.set_stiffness(K.copy(), ksp)
        springs = springs_on(K)
        for fewer, left_out in ((False, 1), (True, None), (False, 2)):  # the finest has no springs
            calls.clear()
            hierarchy.attach(ksp, K, springs, Half(), fewer=fewer)
            ksp.setUp()
            num = ksp.getPC().getMGLevels()
            assert num > 2
            assert len(calls) == (num - left_out if left_out else 0)
    hierarchy.destroy()
    for obj in (ksp, springs, K):
        obj.destroy()


def with_springs(A, springs):
    """A + BᵀB."""
    transposed, found = springs.copy().transpose(), A.copy()
    found.axpy(1.0, transposed.matMult(springs), PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    return found


def check_levels(pc, A, springs, projects):
    """Compare a PC's levels with products of what they are made of."""
    num, scale = pc.getMGLevels(), None
    assert num > 2
    for level in range(num - 1, -1, -1):
        found = pc.getMGSmoother(level).getOperators()[1]
        at_finest = projects and level == num - 1
        matrix = A if at_finest else with_springs(A, springs)
        x, y = matrix.createVecs()
        z, diagonal = y.duplicate(), found.getDiagonal()
        x.setRandom()
        matrix.mult(x, y)
        found.mult(x, z)
        if at_finest:  # Πᵀ K
            z.scale(2.0)
        scale = scale or z.norm() / y.norm()
        y.scale(scale)
        assert (y - z).norm() <= 1e-13 * y.norm()
        wanted = matrix.getDiagonal()
        wanted.scale(scale)
        assert (diagonal - wanted).norm() <= 1e-13 * wanted.norm()
        if level:
            P = pc.getMGInterpolation(level)
            if at_finest:
                check_projected(P)
                P = P.getPythonContext()._P
            A, springs = A.ptap(P), springs.matMult(P)


def check_projected(interpolation):
    """ΠP of a projector that halves, and Pᵀ."""
    P = interpolation.getPythonContext()._P
    (x, u), (y, v) = interpolation.createVecs(), P.createVecs()
    x.setRandom()
    interpolation.mult(x, u)
    P.mult(x, v)
    v.scale(0.5)
    assert (u - v).norm() <= 1e-15 * v.norm()
    interpolation.multAdd(x, v, u)
    assert (u - 2 * v).norm() <= 1e-15 * v.norm()
    interpolation.multTranspose(u, x)
    P.multTranspose(u, y)
    assert (x - y).norm() <= 1e-15 * y.norm()
