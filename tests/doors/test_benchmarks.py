# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Problems with exact answers: heat through rings and slabs, the traction on a curved interface."""

from itertools import product

from mpi4py import MPI

import numpy as np
import pytest
from helpers import sweep

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import Tie, TiedProblem

comm = MPI.COMM_WORLD


def conduction(V, conductivity=1.0):
    """Forms of steady heat conduction without sources."""
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    zero = fem.Constant(V.mesh, default_scalar_type(0))
    conductivity = fem.Constant(V.mesh, default_scalar_type(conductivity))
    return conductivity * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, zero * v * ufl.dx


def prescribed(V, facets, value):
    """A constant Dirichlet condition."""
    dofs = fem.locate_dofs_topological(V, V.mesh.topology.dim - 1, facets)
    return fem.dirichletbc(default_scalar_type(value), dofs, V)


def l2_error(us, exact, degree):
    """L² error over all bodies; ``exact`` takes UFL coordinates."""
    total = 0.0
    for u in us:
        e = u - exact(ufl.SpatialCoordinate(u.function_space.mesh))
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 4})
        total += fem.assemble_scalar(fem.form(ufl.inner(e, e) * dx))
    return np.sqrt(comm.allreduce(total))


@pytest.mark.parametrize(("swap", "degree"), sweep(product((False, True), (1, 2, 3)), 2))
def test_thermal_rings(degree, swap):
    """Closed rings .8 / .9 / 1 at T = 1 inside and 2 outside."""
    errors, at_interface = [], []
    for n in (1, 2, 4):
        options = {"angle": 2 * np.pi, "degree": degree}
        inner, ft0 = meshes.ring_sector(comm, 16 * n, n, 0.8, 0.9, **options)
        outer, ft1 = meshes.ring_sector(comm, 28 * n, n, 0.9, 1.0, **options)
        V = [fem.functionspace(mesh, ("Lagrange", degree)) for mesh in (inner, outer)]
        sides = [(V[0], ft0.find(meshes.OUTER)), (V[1], ft1.find(meshes.INNER))]
        tie = Tie(*(sides[::-1] if swap else sides))
        bcs = [prescribed(V[0], ft0.find(meshes.INNER), 1.0)]
        bcs.append(prescribed(V[1], ft1.find(meshes.OUTER), 2.0))
        a, L = zip(*(conduction(W) for W in V), strict=True)
        us = TiedProblem(a, L, bcs=bcs, ties=[tie]).solve()

        def exact(x):
            return 1 + ufl.ln(ufl.sqrt(x[0] ** 2 + x[1] ** 2) / 0.8) / np.log(1 / 0.8)

        errors.append(l2_error(us, exact, degree))
        ds = ufl.Measure("ds", inner, subdomain_data=ft0)(meshes.OUTER)
        one = fem.Constant(inner, default_scalar_type(1))
        T, length = (comm.allreduce(fem.assemble_scalar(fem.form(f * ds))) for f in (us[0], one))
        at_interface.append(T / length)
    print(errors, at_interface)
    assert np.log2(errors[1] / errors[2]) >= degree + 1 - 0.1
    assert abs(at_interface[-1] - 1.52783526552) < 3 * errors[-1]


@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("contrast", (1e-6, 1e6))
@pytest.mark.parametrize("cell", ("triangle", "quadrilateral"))
def test_slab(cell, contrast, swap):
    """Two layers: the exact temperature is piecewise linear, at any contrast."""
    lower, ft0 = meshes.block(comm, (5, 2), lambda x: x * (2, 1), cell=cell)
    upper, ft1 = meshes.block(comm, (7, 3), lambda x: x * (2, 1) + (0, 1), cell=cell)
    V = [fem.functionspace(mesh, ("Lagrange", 1)) for mesh in (lower, upper)]
    sides = [(V[0], ft0.find(meshes.TOP)), (V[1], ft1.find(meshes.BOTTOM))]
    tie = Tie(*(sides[::-1] if swap else sides))
    bcs = [prescribed(V[0], ft0.find(meshes.BOTTOM), 1.0)]
    bcs.append(prescribed(V[1], ft1.find(meshes.TOP), 2.0))
    conductivities = (1.0, contrast)
    a, L = zip(*(conduction(W, k) for W, k in zip(V, conductivities, strict=True)), strict=True)
    problem = TiedProblem(a, L, bcs=bcs, ties=[tie])
    us = problem.solve()
    flux = 1 / (1 + 1 / contrast)
    # Constants: one kernel for all values
    f0, f1 = (
        fem.Constant(u.function_space.mesh, default_scalar_type(f))
        for u, f in zip(us, (flux, flux / contrast), strict=True)
    )
    exact = [lambda x: 1 + f0 * x[1], lambda x: 2 - f1 * (2 - x[1])]
    for u, f in zip(us, exact, strict=True):
        assert l2_error([u], f, 1) <= 1e-12
    q = tie.quadrature(2)
    heat = q.evaluate(tie.traction(problem)) * (-1 if swap else 1)
    # λ is the residual of Γ1's body: round-off in its temperatures, ε times a condition of some
    # hundreds, counts times its conductivity
    noise = 1e4 * np.finfo(float).eps * conductivities[0 if swap else 1]
    assert np.abs(heat - flux).max(initial=0) <= 1e-11 * flux + noise


# A disc of radius 1 under the pressure α₀ + α₁ cos 2θ: the stress function
# -α₀ r²/2 + α₁ (r²/2 - r⁴/6) cos 2θ gives the traction on circles.

ALPHA, RADIUS, E, NU = (1e7, 1e6), 0.6, 1e9, 0.2


def quarter_disc(n, degree):
    """A quarter of a disc, of triangles: squares around the corner become circles."""

    def mapping(x):
        r = x.max(axis=1)
        part = np.divide(x.min(axis=1), r, out=np.zeros(len(x)), where=r > 0)
        theta = np.where(x[:, 0] >= x[:, 1], part, 2 - part) * np.pi / 4
        return RADIUS * r[:, None] * np.column_stack((np.cos(theta), np.sin(theta)))

    return meshes.block(comm, (n, n), mapping, cell="triangle", degree=degree)


def stress(u):
    """Plane strain."""
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + NU) * (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(2))


def multiplier_error(n, degree, swap):
    """Relative L² error of λ on Σ."""
    disc, ft0 = quarter_disc(n, degree)
    ring, ft1 = meshes.ring_sector(comm, 3 * n, n, RADIUS, 1.0, degree=degree)
    V = [fem.functionspace(mesh, ("Lagrange", degree, (2,))) for mesh in (disc, ring)]
    planes = ((meshes.BOTTOM, meshes.LEFT), (meshes.START, meshes.END))
    a, L, bcs = [], [], []
    for W, ft, tags in zip(V, (ft0, ft1), planes, strict=True):
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        a.append(ufl.inner(stress(u), ufl.sym(ufl.grad(v))) * ufl.dx)
        x, normal = ufl.SpatialCoordinate(W.mesh), ufl.FacetNormal(W.mesh)
        cos = (x[0] ** 2 - x[1] ** 2) / ufl.dot(x, x)
        ds = ufl.Measure("ds", W.mesh, subdomain_data=ft)
        tag = 99 if W is V[0] else meshes.OUTER
        L.append(-(ALPHA[0] + ALPHA[1] * cos) * ufl.dot(normal, v) * ds(tag))
        for tag, component in zip(tags, (1, 0), strict=True):
            dofs = fem.locate_dofs_topological(W.sub(component), 1, ft.find(tag))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, W.sub(component)))
    facets = np.sort(np.append(ft0.find(meshes.RIGHT), ft0.find(meshes.TOP)))
    sides = [(V[0], facets), (V[1], ft1.find(meshes.INNER))]
    tie = Tie(*(sides[::-1] if swap else sides))
    problem = TiedProblem(a, L, bcs=bcs, ties=[tie])
    problem.solve()
    q = tie.quadrature(8)
    theta = np.arctan2(q.x[..., 1], q.x[..., 0])[..., None]
    radial = np.concatenate((np.cos(theta), np.sin(theta)), axis=-1)
    hoop = np.concatenate((-np.sin(theta), np.cos(theta)), axis=-1)
    exact = -(ALPHA[0] + ALPHA[1] * np.cos(2 * theta)) * radial
    exact += ALPHA[1] * (1 - RADIUS**2) * np.sin(2 * theta) * hoop
    exact *= -1 if swap else 1
    error = q.evaluate(tie.traction(problem)) - exact
    return np.sqrt(q.integrate((error**2).sum(-1)) / q.integrate((exact**2).sum(-1)))


@pytest.mark.parametrize(("swap", "degree"), sweep(product((False, True), (1, 2, 3)), 2))
def test_multiplier_on_a_curved_interface(degree, swap):
    errors = [multiplier_error(n, degree, swap) for n in (4, 8, 16)]
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    print(errors, rates)
    assert rates[-1] >= degree - 0.05
