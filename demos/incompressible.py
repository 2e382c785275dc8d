# # Incompressible rubber and viscous flow: ties between mixed elements
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Incompressible bodies need a pressure besides the displacement, as in Taylor–Hood elements. A tie
# takes one component of such a space: `Tie((W.sub(0), facets), …)` ties the displacements. The
# pressures may jump, as between different materials, and need no tie. This demo shows
#
# - a thick pipe under inner pressure: two rubber rings ($\nu = 0.5$), tied to each other and to a
#   ring with $\nu = 0.3$ that has no pressure; errors and rates against Lamé's exact solution,
# - flow through a channel of two meshes. Its parabolic profile is in the space of the velocities.

# +
import argparse
import json
import sys
from itertools import pairwise
from pathlib import Path

from mpi4py import MPI

import numpy as np

import basix.ufl
import ufl
from dolfinx import default_scalar_type, fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Tie, TiedProblem

parser = argparse.ArgumentParser(description="Rubber rings and a viscous flow, tied.")
parser.add_argument("--levels", type=int, default=3, help="of refinement of the rings")
parser.add_argument("--json", type=Path, metavar="FILE")
parser.add_argument("--plot", type=Path, metavar="DIR")
args = parser.parse_args()
comm = MPI.COMM_WORLD
# -


def taylor_hood(mesh):
    """Quadratic displacements (or velocities) and linear pressures."""
    cell = mesh.basix_cell()
    u = basix.ufl.element("Lagrange", cell, 2, shape=(2,))
    return fem.functionspace(
        mesh, basix.ufl.mixed_element([u, basix.ufl.element("Lagrange", cell, 1)])
    )


def strain(u):
    """Symmetric part of the gradient."""
    return ufl.sym(ufl.grad(u))


def stress(u, p, mu):
    """Of what keeps its volume."""
    return 2 * mu * strain(u) - p * ufl.Identity(2)


def incompressible(W, mu):
    """Bilinear form: equilibrium, and no change of volume."""
    (u, p), (v, q) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
    return (ufl.inner(stress(u, p, mu), strain(v)) - q * ufl.div(u)) * ufl.dx


# ## A pipe
#
# The radii of the rings are 2 : 2.5 : 3 : 3.5. In rubber the displacement is $C/r$ and the pressure
# constant; in the outer ring it is $\frac{1+\nu}{E}\left[(1-2\nu) A r + B/r\right]$ with
# $\sigma_{rr} = A - B/r^2$. The displacement is continuous at $r = 3$, and so is $\sigma_{rr}$.

radii = [2.0, 2.5, 3.0, 3.5]
a, c, b = radii[0], radii[2], radii[3]
E, nu, inside = 1.0, 0.3, 1.0  # of the outer ring, and the pressure inside
mu, shear = E / 3, E / (2 * (1 + nu))  # of the rubber, of the outer ring
ratio = E / (1 + nu) / ((1 - 2 * nu) * c**2 / b**2 + 1)  # B over C
C = inside / (2 * mu * (1 / a**2 - 1 / c**2) + ratio * (1 / c**2 - 1 / b**2))
A, B = ratio * C / b**2, ratio * C


def exact_displacement(x, ring):
    """Lamé's solution at UFL coordinates."""
    outer = (1 + nu) / E * ((1 - 2 * nu) * A + B / ufl.dot(x, x))
    return x * (outer if ring == 2 else C / ufl.dot(x, x))


def solve_pipe(n):
    """Displacements, pressures (of the outer ring None) and the tie between unlike spaces."""
    forms, loads, bcs, sides = [], [], [], []
    for ring, cells in enumerate((4 * n, 6 * n, 5 * n)):
        mesh, ft = meshes.ring_sector(comm, cells, n, *radii[ring : ring + 2], degree=2)
        if ring < 2:
            W = taylor_hood(mesh)
            displacements, v = W.sub(0), ufl.TestFunctions(W)[0]
            forms.append(incompressible(W, mu))
        else:
            W = displacements = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
            u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
            sigma = 2 * shear * (strain(u) + nu / (1 - 2 * nu) * ufl.div(u) * ufl.Identity(2))
            forms.append(ufl.inner(sigma, strain(v)) * ufl.dx)
        ds = ufl.Measure("ds", mesh, subdomain_data=ft)
        normal = ufl.FacetNormal(mesh)
        loads.append(-inside * ufl.dot(normal, v) * ds(meshes.INNER) if ring == 0 else None)
        for tag, component in ((meshes.START, 1), (meshes.END, 0)):  # the symmetry planes
            V = displacements.sub(component)
            dofs = fem.locate_dofs_topological(V, 1, ft.find(tag))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V))
        sides.append((displacements, ft))
    ties = [
        Tie((V0, ft0.find(meshes.OUTER)), (V1, ft1.find(meshes.INNER)))
        for (V0, ft0), (V1, ft1) in pairwise(sides)
    ]
    problem = TiedProblem(forms, loads, bcs=bcs, ties=ties)
    *rubber, u2 = problem.solve()
    return [w.sub(0) for w in rubber] + [u2], [w.sub(1) for w in rubber] + [None], problem


def relative_errors(us, ps):
    """L² errors of displacement, stress and pressure over all rings."""
    totals = np.zeros((3, 2))
    for ring, (u, p) in enumerate(zip(us, ps, strict=True)):
        x, dx = ufl.SpatialCoordinate(u.function_space.mesh), ufl.dx(degree=8)
        u_exact = exact_displacement(x, ring)
        if p is None:
            volume = 2 * shear * nu / (1 - 2 * nu)
            p, p_exact, modulus = -volume * ufl.div(u), -volume * ufl.div(u_exact), shear
        else:
            p_exact, modulus = inside - 2 * mu * C / a**2, mu
        pairs = (
            (u, u_exact),
            (stress(u, p, modulus), stress(u_exact, p_exact, modulus)),
            (p, p_exact),
        )
        for sums, (f, exact) in zip(totals, pairs, strict=True):
            for k, g in enumerate((f - exact, exact)):
                sums[k] += fem.assemble_scalar(
                    fem.form(ufl.inner(g, g) * dx(u.function_space.mesh))
                )
    return np.sqrt(np.divide(*comm.allreduce(totals).T))


rows = []
for level in range(args.levels):
    us, ps, problem = solve_pipe(2**level)
    names = ("error", "stress", "pressure")
    errors = dict(zip(names, relative_errors(us, ps).tolist(), strict=True))
    rows.append({"scene": "pipe", "n": 2**level} | errors)

# ## A channel
#
# Two meshes of triangles and quadrilaterals meet in a slanted line. The velocity is given on the
# left and at the walls, on the right the flow leaves straight and without a normal stress:
# $u = (y(1-y), 0)$, $p = 2(2-x)$. The traction that the tie transmits is read as ever.


def solve_channel():
    """The largest error of velocities and pressures, and the force on the first part."""
    forms, bcs, sides = [], [], []
    for i, (n, cell) in enumerate((((4, 3), "triangle"), ((3, 5), "quadrilateral"))):

        def place(x, i=i):
            slant = 0.3 * (x[:, 1] - 0.5) * (x[:, 0] if i == 0 else 1 - x[:, 0])
            return np.column_stack((x[:, 0] + i + slant, x[:, 1]))

        mesh, ft = meshes.block(comm, n, place, cell=cell)
        W = taylor_hood(mesh)
        forms.append(incompressible(W, 1.0))
        V, _ = W.sub(0).collapse()
        given = fem.Function(V)
        given.interpolate(lambda x: np.array((x[1] * (1 - x[1]), 0 * x[0])))
        tags = (meshes.TOP, meshes.BOTTOM, *[meshes.LEFT] * (i == 0))
        facets = np.concatenate([ft.find(tag) for tag in tags])
        dofs = fem.locate_dofs_topological((W.sub(0), V), 1, facets)
        bcs.append(fem.dirichletbc(given, dofs, W.sub(0)))
        if i == 1:
            dofs = fem.locate_dofs_topological(W.sub(0).sub(1), 1, ft.find(meshes.RIGHT))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, W.sub(0).sub(1)))
        sides.append((W.sub(0), ft.find((meshes.RIGHT, meshes.LEFT)[i])))
    tie = Tie(*sides)
    problem = TiedProblem(forms, [None, None], bcs=bcs, ties=[tie])
    error = 0.0
    for w in problem.solve():
        u, p = (w.sub(k).collapse() for k in (0, 1))
        exact = [fem.Function(f.function_space) for f in (u, p)]
        exact[0].interpolate(lambda x: np.array((x[1] * (1 - x[1]), 0 * x[0])))
        exact[1].interpolate(lambda x: 2 * (2 - x[0]))
        for f, g in zip((u, p), exact, strict=True):
            error = max(error, np.abs(f.x.array - g.x.array).max(initial=0))
    q = tie.quadrature(2)
    force = q.integrate(q.evaluate(tie.traction(problem)))
    return comm.allreduce(error, MPI.MAX), force.tolist()


error, force = solve_channel()
rows.append({"scene": "channel", "error": error, "force": force})

if comm.rank == 0:
    print("pipe, relative L² errors and their rates:")
    for row, before in zip(rows[:-1], [None, *rows], strict=False):
        rates = [f" ({np.log2(before[k] / row[k]):.2f})" if before else "" for k in names]
        text = ", ".join(f"{k} {row[k]:.2e}{rate}" for k, rate in zip(names, rates, strict=True))
        print(f"  n = {row['n']}: {text.replace('error', 'displacement')}")
    print(f"channel: largest error of velocity and pressure {error:.1e}")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))
if args.plot:
    from hypergap_dolfinx import plot

    plot.deformed(us, args.plot / "incompressible.png", factor=0.1)
