# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Geometric stiffness with predicted stress: its form, and which bodies are slender."""

from mpi4py import MPI

import numpy as np
import pytest
from helpers import interpolated

import meshes
import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from hypergap_dolfinx.solvers import predicted_stress
from hypergap_dolfinx.solvers.predicted_stress import PredictedStress

comm = MPI.COMM_WORLD


def matrix(form):
    A = petsc.assemble_matrix(fem.form(form))
    A.assemble()
    return A


@pytest.mark.ranks(2)
def test_stiffness():
    """That of stresses written by hand, from a residual with forces, on two kinds of integrals."""
    mesh, _ = meshes.block(comm, (5, 2), lambda s: s * (2, 0.3) + 0.1 * s[:, ::-1] ** 2)
    V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = interpolated(V, lambda x: (0.2 * x[0] * x[1], 0.1 * x[0] ** 2))
    x, v, du = ufl.SpatialCoordinate(mesh), ufl.TestFunction(V), ufl.TrialFunction(V)
    dx = ufl.dx(metadata={"quadrature_degree": 4})

    def S(w):
        strain = (ufl.grad(w) + ufl.grad(w).T + ufl.grad(w).T * ufl.grad(w)) / 2
        return (1 + x[0]) * (2 * strain + ufl.tr(strain) * ufl.Identity(2))

    energy = ufl.inner(S(u), ufl.grad(u) + ufl.grad(u).T + ufl.grad(u).T * ufl.grad(u)) / 4 * dx
    F = ufl.derivative(energy, u, v) - x[1] * v[0] * dx(degree=3) - v[1] * ufl.ds
    stress = PredictedStress(u)
    form = stress.stiffness(F)
    assert matrix(form).norm() < 1e-14
    start = u.copy()
    step = interpolated(V, lambda x: (0.1 * x[1] ** 2, -0.2 * x[0]))
    u.x.array[:] += step.x.array
    stress.update()
    change = S(start) + ufl.derivative(S(start), start, step) - S(u)
    wanted = matrix(ufl.inner(ufl.grad(du) * change, ufl.grad(v)) * dx)
    size = wanted.norm()
    wanted.axpy(-1.0, matrix(form))
    assert size > 0.01 and wanted.norm() < 1e-13 * size


@pytest.mark.parametrize("degree", (None, 5))
def test_quadrature_degree(degree):
    """As many points as the plain derivative has: by UFL's estimate there were 27 times as many."""
    mesh, _ = meshes.block(comm, (2, 1, 1), lambda s: s * (2, 1, 0.1), cell="hexahedron")
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u = fem.Function(V)
    strain = (ufl.grad(u) + ufl.grad(u).T + ufl.grad(u).T * ufl.grad(u)) / 2
    F = ufl.derivative(ufl.inner(strain, strain) * ufl.dx(degree=degree), u)
    added = PredictedStress(u).stiffness(F)
    data = [
        ufl.algorithms.compute_form_data(form, do_apply_integral_scaling=True).integral_data
        for form in (ufl.algorithms.expand_derivatives(ufl.derivative(F, u)), added)
    ]
    own, ours = ([i.metadata() for one in of for i in one.integrals] for of in data)
    wanted = degree or int(np.max(own[0]["estimated_polynomial_degree"]))
    assert [part["quadrature_degree"] for part in ours] == [wanted]
    assert degree or wanted < np.max(ours[0]["estimated_polynomial_degree"]) / 2


def test_stress_without_displacement():
    """A prestress, whose derivative is zero: its own degree, that of the law stays."""
    mesh, _ = meshes.block(comm, (2, 1), lambda s: s * (2, 0.1))
    V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = fem.Function(V)
    F = ufl.derivative(ufl.inner(ufl.grad(u), ufl.grad(u)) ** 2 * ufl.dx(degree=5), u)
    F += fem.Constant(mesh, 1.0) * ufl.div(ufl.TestFunction(V)) * ufl.dx
    added = PredictedStress(u).stiffness(F)
    degrees = [part.metadata()["quadrature_degree"] for part in added.integrals()]
    assert degrees[0] == 5 and 0 < degrees[1] < 5


@pytest.mark.ranks(2)
def test_is_slender():
    """Extent over twice volume over area: strips and rings, each thin and thick."""

    def ring(s, wall):
        angle, r = 2 * np.pi * s[:, 1:], 1 - wall * s[:, :1]
        return np.hstack((r * np.cos(angle), r * np.sin(angle)))

    for thin, place in ((1 / 12, lambda s, w: s * (1, w)), (0.2, ring)):
        for wall in (thin, 2 * thin):
            mesh, _ = meshes.block(
                comm, (2, 24), lambda s, w=wall, at=place: at(s, w), periodic=place is ring
            )
            u = fem.Function(fem.functionspace(mesh, ("Lagrange", 1, (2,))))
            assert predicted_stress.is_slender(u) == (wall == thin)
