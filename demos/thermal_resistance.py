# # A pipe with a coat that doesn't quite touch it
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Heat flows through a pipe and its coat, whose meshes don't match. Between them is a thermal
# contact resistance c: the temperature jumps by c times the heat flux λ. This demo shows
#
# - `Tie(..., compliance=c)` with c ≥ 0, changed from solve to solve; with c = 0 the bodies are
#   tied,
# - rates of convergence against the exact temperature and flux.

# +
import argparse
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Tie, TiedProblem

parser = argparse.ArgumentParser(description="Heat through an interface with a resistance.")
parser.add_argument("--degree", type=int, default=2, help="of elements and meshes")
parser.add_argument("--levels", type=int, default=3, help="number of meshes")
parser.add_argument("--json", type=Path, metavar="FILE")
parser.add_argument("--plot", type=Path, metavar="DIR")
args = parser.parse_args()
comm, degree = MPI.COMM_WORLD, args.degree
# -

# Radii, conductivities, and the temperatures inside and outside:

a, m, b = 1.0, 1.5, 2.0
k = 1.0, 0.2
inside, outside = 1.0, 0.0

# A quarter of the pipe has 3n quadrilaterals around, its coat 2n. The coat is coarser and conducts
# less: it is Γ1. The tie reads the resistance each time the matrix is assembled.


def bodies(n):
    """Spaces, bilinear forms and boundary conditions of pipe and coat, and the tie's resistance."""
    V, forms, bcs, sides = [], [], [], []
    for i, (n_hoop, radii) in enumerate(((3 * n, (a, m)), (2 * n, (m, b)))):
        mesh, tags = meshes.ring_sector(comm, n_hoop, n, *radii, degree=degree)
        W = fem.functionspace(mesh, ("Lagrange", degree))
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        conductivity = fem.Constant(mesh, default_scalar_type(k[i]))
        forms.append(conductivity * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        held, tied = (meshes.INNER, meshes.OUTER)[:: 1 - 2 * i]
        dofs = fem.locate_dofs_topological(W, 1, tags.find(held))
        bcs.append(fem.dirichletbc(default_scalar_type((inside, outside)[i]), dofs, W))
        sides.append((W, tags.find(tied)))
        V.append(W)
    resistance = fem.Constant(V[0].mesh, default_scalar_type(0))
    return V, forms, bcs, sides, resistance


# The heat flow is the same through each radius, $2\pi Q$:


def heat(c):
    """Q."""
    return (inside - outside) / (np.log(m / a) / k[0] + c / m + np.log(b / m) / k[1])


def relative_error(T, c):
    """L² error over both bodies."""
    sums = np.zeros(2)
    for T_i, k_i, T_end, r_end in zip(T, k, (inside, outside), (a, b), strict=True):
        mesh = T_i.function_space.mesh
        x = ufl.SpatialCoordinate(mesh)
        factor = fem.Constant(mesh, default_scalar_type(heat(c) / k_i))
        end, r = (fem.Constant(mesh, default_scalar_type(v)) for v in (T_end, r_end))
        e = end - factor * ufl.ln(ufl.sqrt(ufl.inner(x, x)) / r)
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 4})
        # The zero function's error is the exact field's norm, by the same form
        both = (T_i, fem.Function(T_i.function_space))
        sums += [fem.assemble_scalar(fem.form((f - e) ** 2 * dx)).real for f in both]
    return float(np.sqrt(np.divide(*comm.allreduce(sums))))


rows = []
for n in (4 * 2**level for level in range(args.levels)):
    V, forms, bcs, sides, resistance = bodies(n)
    tie = Tie(*sides, compliance=resistance)
    problem = TiedProblem(forms, [None, None], bcs=bcs, ties=[tie])
    for c in (0.0, 0.01, 1.0, 100.0):
        resistance.value = c
        T = problem.solve()
        # λ is the heat that enters the pipe, which it leaves: -Q / m
        q = tie.quadrature(2 * degree)
        flux = q.evaluate(tie.traction(problem))[..., 0] * m / heat(c) + 1
        error = float(
            np.sqrt(q.integrate(np.abs(flux) ** 2) / q.integrate(np.ones_like(flux)).real)
        )
        rows.append({"c": c, "n": n, "error": relative_error(T, c), "flux": error})
        if args.plot and c == 1.0 and n == 8:
            from hypergap_dolfinx import plot

            plot.field(T, args.plot / "thermal_resistance.png", title="temperature")

if comm.rank == 0:
    print(f"degree {degree}: relative L² errors and their rates")
    print("     c    n  temperature         flux")
    before = {}
    for row in sorted(rows, key=lambda row: row["c"]):
        line = f"{row['c']:6g} {row['n']:4d}"
        for name in ("error", "flux"):
            line += f"  {row[name]:.2e}"
            last = before.get((row["c"], name))
            line += f" {np.log2(last / row[name]):4.2f}" if last else "     "
            before[row["c"], name] = row[name]
        print(line)
    if args.json:
        args.json.write_text(json.dumps({"degree": degree, "rows": rows}, indent=1))
