# # How an arch of two layers vibrates
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# An elastic arch, clamped at both feet, is made of two layers whose meshes don't match. Its
# frequencies are eigenvalues of the tied system,
#
# $$\begin{bmatrix} K & B^T \\ B & 0 \end{bmatrix} \begin{bmatrix} u \\ \lambda \end{bmatrix}
# = \omega^2 \begin{bmatrix} M & 0 \\ 0 & 0 \end{bmatrix}
# \begin{bmatrix} u \\ \lambda \end{bmatrix}.$$
#
# SLEPc finds the smallest ones by shift and invert. They are compared with those of one mesh
# without an interface, as fine as the layers' and four times as fine.

# +
import argparse
import json
import sys
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc
from slepc4py import SLEPc

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem import petsc

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Tie, TiedProblem

parser = argparse.ArgumentParser(description="Frequencies of a tied arch.")
parser.add_argument("--n", type=int, default=2, help="cells across each layer")
parser.add_argument("--modes", type=int, default=6)
parser.add_argument("--json", type=Path, metavar="FILE")
parser.add_argument("--plot", type=Path, metavar="DIR")
args = parser.parse_args()
comm, n = MPI.COMM_WORLD, args.n
# -

# Two layers of quadratic quadrilaterals, and the arch in one piece. Young's modulus and the density
# are 1.

options = {"angle": np.pi, "degree": 2}
inner = meshes.ring_sector(comm, 12 * n, n, 0.8, 0.9, **options)
outer = meshes.ring_sector(comm, 16 * n, n, 0.9, 1.0, **options)
fused = meshes.ring_sector(comm, 16 * n, 2 * n, 0.8, 1.0, **options)
fine = meshes.ring_sector(comm, 64 * n, 8 * n, 0.8, 1.0, **options)
E, nu = 1.0, 0.3


def sigma(u):
    """Plane stress."""
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + nu) * (eps + nu / (1 - nu) * ufl.tr(eps) * ufl.Identity(2))


def solve(bodies, tied):
    """Frequencies, and the mode shapes on each body."""
    V, stiffness, masses, loads, bcs = [], [], [], [], []
    for mesh, tags in bodies:
        W = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        feet = np.concatenate((tags.find(meshes.START), tags.find(meshes.END)))
        dofs = fem.locate_dofs_topological(W, 1, feet)
        V.append(W)
        stiffness.append(ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx)
        masses.append(fem.form(ufl.inner(u, v) * ufl.dx))
        loads.append(ufl.inner(fem.Constant(mesh, default_scalar_type((0, 0))), v) * ufl.dx)
        bcs.append(fem.dirichletbc(np.zeros(2, dtype=default_scalar_type), dofs, W))

    # `TiedProblem` assembles the matrix on the left; prescribed dofs have a diagonal alone.
    ties = []
    if tied:
        (_, tags0), (_, tags1) = bodies
        ties = [Tie((V[1], tags1.find(meshes.INNER)), (V[0], tags0.find(meshes.OUTER)))]
    problem = TiedProblem(stiffness, loads, bcs=bcs, ties=ties)
    problem.assemble_matrix()

    # The matrix on the right has zeros there, and for the multipliers, so that these are no modes.
    blocks = [[None] * (len(bodies) + len(ties)) for _ in range(len(bodies) + len(ties))]
    for i, (mass, bc) in enumerate(zip(masses, bcs, strict=True)):
        blocks[i][i] = petsc.assemble_matrix(mass, [bc], 0.0)
        blocks[i][i].assemble()
    for i in range(len(bodies), len(blocks)):
        blocks[i][i] = problem.A.getNestSubMatrix(i, i)
    M = PETSc.Mat().createNest(blocks, comm=comm)
    M.assemble()

    eps = SLEPc.EPS().create(comm)
    eps.setOperators(problem.A, M)
    eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    eps.setDimensions(args.modes)
    eps.setTarget(0)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    eps.getST().setType("sinvert")
    ksp = eps.getST().getKSP()
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    eps.setFromOptions()
    eps.solve()
    assert eps.getConverged() >= args.modes

    omega, shapes, x = [], [], M.createVecLeft()
    for mode in range(args.modes):
        omega.append(float(np.sqrt(eps.getEigenpair(mode, x).real)))
        shapes.append([fem.Function(W) for W in V])
        for u, rows in zip(shapes[-1], problem.A.getNestISs()[0]):
            part = x.getSubVector(rows)
            u.x.array[: part.getLocalSize()] = part.array_r
            u.x.scatter_forward()
            x.restoreSubVector(rows, part)
    return np.array(omega), shapes


tied, shapes = solve([inner, outer], tied=True)
fused, _ = solve([fused], tied=False)
fine, _ = solve([fine], tied=False)

# ## The table

if comm.rank == 0:
    print("mode   ω tied     ω fused    ω fine      errors, tied and fused")
    for mode in range(args.modes):
        w = tied[mode], fused[mode], fine[mode]
        print(f"{mode + 1:3d}", *(f"{value:10.6f}" for value in w), end="    ")
        print(f"{w[0] / w[2] - 1:8.1e} {w[1] / w[2] - 1:8.1e}")
    result = {
        "frequencies": list(tied),
        "error_tied": float((tied / fine - 1).max()),
        "error_fused": float((fused / fine - 1).max()),
    }
    if args.json:
        args.json.write_text(json.dumps(result, indent=1))
if args.plot:
    from hypergap_dolfinx import plot

    for mode, us in enumerate(shapes, 1):
        plot.deformed(us, args.plot / f"mode_{mode}.png")
