# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Hertz's contact by scikit-fem: Nitsche's method on a supermesh, as its example 4 has it.

The example solves the first iteration, with a contact zone that is given; this goes on until the
zone stays the same, as the paper that it cites (Gustafsson, Stenberg and Videman, 2019) does.
"""

import hertz
import numpy as np
import scipy.sparse as sp
import skfem
from skfem.helpers import ddot, sym_grad, trace
from skfem.supermeshing import elementwise_quadrature, intersect

from run_time.copies import copies, row

NAME = "scikit-fem"
DIMS = (2,)
AUTHORS = {(2, 1): 100.0, (2, 2): 1000.0}
"""γ h / E of dimension and degree, as scripts of scikit-fem's author have it."""
STEPS = 40
"""Iterations at most."""


def meshed(body):
    """A body's mesh."""
    mesh = skfem.MeshQuad(body.x.T.copy(), body.cells.T.copy(), sort_t=False)
    if not len(body.edges):
        return mesh
    middle = {tuple(e): m for e, m in zip(np.sort(body.edges).tolist(), body.middles, strict=True)}
    facets = [middle[tuple(e)] for e in np.sort(mesh.facets.T).tolist()]
    places = np.vstack((body.x, facets, body.centres))
    return skfem.MeshQuad2(places.T.copy(), mesh.t)


def found(mesh, vertices):
    """Numbers of facets, by their vertices."""
    number = {tuple(e): i for i, e in enumerate(np.sort(mesh.facets.T).tolist())}
    return np.array([number[tuple(e)] for e in np.sort(vertices).tolist()])


def solve(bodies, degree, number, stopwatch):
    """Press the round body on the block.

    Args:
        bodies: What ``hertz.pair`` gives.
        degree: Of displacements and geometry.
        number: Nitsche's γ, over E / h.
        stopwatch: Called when all meshes are there; what it gives is called at the end.

    Returns:
        A row of results.
    """
    parts = copies(bodies)
    element = skfem.ElementVector({1: skfem.ElementQuad1, 2: skfem.ElementQuad2}[degree]())
    bases = [skfem.Basis(meshed(part), element, intorder=4 * degree - 2) for part in parts]
    facets = [
        {name: found(basis.mesh, those) for name, those in part.facets.items()}
        for basis, part in zip(bases, parts, strict=True)
    ]
    gamma = number * hertz.E / parts[0].size
    mu, lmbda = hertz.lame()

    stop = stopwatch()

    def stress_across(u):
        """Of a horizontal plane."""
        e = sym_grad(u)
        return 2 * mu * e[1, 1] + lmbda * trace(e)

    @skfem.BilinearForm
    def stiffness(u, v, w):
        e, d = sym_grad(u), sym_grad(v)
        return 2 * mu * ddot(e, d) + lmbda * trace(e) * trace(d)

    # Where it pushes p = γ overlap - mean stress; elsewhere the mean stress is to be zero
    @skfem.BilinearForm
    def nitsche(u0, u1, v0, v1, w):
        overlap, change = u0[1] - u1[1], v0[1] - v1[1]
        s, t = ((stress_across(f0) + stress_across(f1)) / 2 for f0, f1 in ((u0, u1), (v0, v1)))
        return np.where(w.on, gamma * overlap * change - s * change - t * overlap, -s * t / gamma)

    @skfem.LinearForm
    def apart(v0, v1, w):
        change, t = v0[1] - v1[1], (stress_across(v0) + stress_across(v1)) / 2
        return np.where(w.on, w.gap * (gamma * change - t), 0)

    lines = [
        basis.mesh.trace(part["touch"], mtype=skfem.MeshLine, project=lambda x: x[:1] / hertz.a)
        for basis, part in zip(bases, facets, strict=True)
    ]
    supermesh, *hosts = intersect(lines[0][0], lines[1][0])
    sides = [
        skfem.FacetBasis(
            basis.mesh,
            element,
            quadrature=elementwise_quadrature(line, supermesh, host, intorder=4 * degree),
            facets=those[host],
        )
        for basis, (line, those), host in zip(bases, lines, hosts, strict=True)
    ]
    both = sides[0] * sides[1]
    x = [np.array(side.global_coordinates()) for side in sides]
    gap = x[1][1] - x[0][1]
    K = sp.block_diag([stiffness.assemble(basis) for basis in bases], format="csr")
    top = skfem.FacetBasis(bases[1].mesh, element, facets=facets[1]["load"])
    pressing = skfem.LinearForm(lambda v, w: -hertz.load(2) * v[1]).assemble(top)
    f = np.concatenate((np.zeros(bases[0].N), pressing))
    held = np.concatenate(
        [
            first + basis.get_dofs(part[axis]).all(f"u^{1 + k}")
            for first, basis, part in zip((0, bases[0].N), bases, facets, strict=True)
            for k, axis in enumerate("xy")
            if axis in part
        ]
    )
    u = np.zeros(len(f))
    u[bases[0].N :][bases[1].get_dofs(elements=True).all("u^2")] = -(hertz.a**2) / hertz.R

    def pressure():
        """At the points of both sides."""
        u0, u1 = (
            side.interpolate(part)
            for side, part in zip(sides, np.split(u, [bases[0].N]), strict=True)
        )
        mean = (stress_across(u0) + stress_across(u1)) / 2
        return gamma * (u0[1] - u1[1] - gap) - mean

    on, steps, settled = gap < -u.min(), 0, False
    while steps < STEPS and not settled:
        A = K + nitsche.assemble(both, on=on)
        u = skfem.solve(*skfem.condense(A, f + apart.assemble(both, on=on, gap=gap), D=held))
        now, steps = pressure() > 0, steps + 1
        on, settled = now, bool((now == on).all())
    times = stop()

    p = np.maximum(pressure(), 0)
    return row(
        NAME, 2, degree, np.abs(x[0][0]), p, sides[0].dx, dofs=len(f), steps=steps,
        number=number, converged=settled, **times,
    )  # fmt: skip
