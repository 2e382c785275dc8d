# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Hertz's contact by NGSolve's ``ContactBoundary``, as its tutorial on contact has it.

An energy k g² / 2 of the overlap g at points of the block's surface, each paired with the nearest
point of the other body; ``NewtonMinimization`` with the sparse Cholesky solver. The pairs stay what
they are at first. The tutorial starts from bodies that overlap, and so does this.
"""

import hertz
import netgen.meshing as ng
import ngsolve
import numpy as np
from ngsolve import BND, IfPos, Integrate, Variation, ds, dx
from ngsolve.solvers import NewtonMinimization

from run_time.copies import copies, row

NAME = "NGSolve"
DIMS = (2, 3)
AUTHORS = {(2, 1): 0.02, (2, 2): 0.02, (3, 1): 1000.0, (3, 2): 1000.0}
"""k h / E of dimension and degree: the tutorial's for its ball on a block, its rod in a hole."""
POINTS = {2: 20, 3: 10}
"""Degree to which the energy is integrated. The tutorial has 200 for the ball, 10 for the rod."""
STEPS = 40
"""Newton steps at most."""
BODIES = ("block", "round")


def meshed(bodies):
    """Both bodies in one mesh of straight cells.

    Args:
        bodies: Their copies.

    Returns:
        The mesh, and by their ends how far edges' middles are off.
    """
    dim = bodies[0].x.shape[1]
    mesh, first, off = ng.Mesh(dim=dim), 0, {}
    for name, body in zip(BODIES, bodies, strict=True):
        mesh.AddPoints(np.column_stack((body.x, np.zeros((len(body.x), 3 - dim)))))
        facets = {f"{name}_{which}": part for which, part in body.facets.items()}
        for region, d, part in (
            (name, dim, body.cells),
            *((region, dim - 1, part) for region, part in facets.items()),
        ):
            mesh.AddElements(d, mesh.AddRegion(region, d), (first + part).astype(np.int32), 0)
        shifts = body.middles - body.x[body.edges].mean(axis=1)
        ends = np.sort(first + body.edges, axis=1)
        off |= {tuple(pair): shift for pair, shift in zip(ends.tolist(), shifts, strict=True)}
        first += len(body.x)
    return ngsolve.Mesh(mesh), off


def curve(V, off):
    """The displacement that takes edges' middles to where they are."""
    u = ngsolve.GridFunction(V)
    u.vec[:] = 0
    scalar = ngsolve.H1(V.mesh, order=V.globalorder)
    for edge in V.mesh.edges if off else ():
        (dof,) = scalar.GetDofNrs(edge)
        for component, value in zip(
            u.components, off[tuple(sorted(v.nr for v in edge.vertices))], strict=True
        ):
            component.vec[dof] = -8 * value  # the edge's function is -1/8 there
    return u


def solve(bodies, degree, number, stopwatch):
    """Press the round body on the block.

    Args:
        bodies: What ``hertz.pair`` gives.
        degree: Of displacements and geometry.
        number: The penalty, over E / h.
        stopwatch: Called when all meshes are there; what it gives is called at the end.

    Returns:
        A row of results.
    """
    parts = copies(bodies)
    mesh, off = meshed(parts)
    dim = mesh.dim
    k = number * hertz.E / parts[0].size
    V = ngsolve.VectorH1(
        mesh, order=degree, dirichletx=".*_x", dirichlety=".*_y", dirichletz=".*_z"
    )
    curved = curve(V, off)

    stop = stopwatch()
    u = V.TrialFunction()
    mu, lmbda = hertz.lame()
    strain = ngsolve.Sym(ngsolve.Grad(u))
    energy = mu * ngsolve.InnerProduct(strain, strain) + lmbda / 2 * ngsolve.Trace(strain) ** 2
    form = ngsolve.BilinearForm(V)
    form += Variation(energy.Compile() * dx(deformation=curved))
    form += Variation(hertz.load(dim) * u[dim - 1] * ds("round_load"))
    contact = ngsolve.ContactBoundary(
        mesh.Boundaries("block_touch"), mesh.Boundaries("round_touch")
    )
    x = ngsolve.CF((ngsolve.x, ngsolve.y, ngsolve.z)[:dim]) + curved
    normal = ngsolve.specialcf.normal(dim)
    overlap = (x + u - x.Other() - u.Other()) * normal
    contact.AddEnergy(IfPos(overlap, k / 2 * overlap**2, 0))
    moved, now = ngsolve.GridFunction(V), ngsolve.GridFunction(V)
    depth = hertz.a**2 / hertz.R
    moved.Set(ngsolve.CF((*(0,) * (dim - 1), -depth)), definedon=mesh.Materials("round"))
    now.vec.data = moved.vec + curved.vec
    contact.Update(now, form, POINTS[dim], hertz.a)
    small = 1e-9 * (hertz.P[dim] * depth) ** 0.5  # of the root of an energy
    status, steps = NewtonMinimization(
        form, moved, inverse="sparsecholesky", printing=False, maxerr=small, maxit=STEPS
    )
    times = stop()

    now.vec.data = moved.vec + curved.vec
    contact.Update(now, maxdist=hertz.a)
    overlap = -contact.gap * normal
    surface = mesh.Boundaries("block_touch")
    kind = {2: ngsolve.ET.SEGM, 3: ngsolve.ET.TRIG}[dim]
    rule = ngsolve.IntegrationRule(kind, 15)
    points = mesh.MapToAllElements({kind: rule}, surface)
    at = ngsolve.sqrt(sum(c**2 for c in (ngsolve.x, ngsolve.y)[: dim - 1]))
    at, p = (f(points).ravel() for f in (at, IfPos(overlap, k * overlap, 0)))
    areas = np.array(Integrate(ngsolve.CF(1), mesh, BND, element_wise=True))
    areas = areas[[element.nr for element in surface.Elements()]]
    weights = np.array(rule.weights)
    dx_ = np.outer(areas, weights / weights.sum()).ravel()
    return row(
        NAME, dim, degree, at, p, dx_, dofs=V.ndof, steps=steps, number=number,
        converged=status == 0, **times,
    )  # fmt: skip
