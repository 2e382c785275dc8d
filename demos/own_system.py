# # A system and a solver of your own
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# `tie.blocks()` gives the matrices of the constraint $B_0 u_0 + B_1 u_1 = 0$ for a system of your
# own, without `TiedProblem`. Here, Poisson's equation on two plates becomes
#
# $$\begin{bmatrix} K_0 & & B_0^T \\ & K_1 & B_1^T \\ B_0 & B_1 & \end{bmatrix}
# \begin{bmatrix} u_0 \\ u_1 \\ \lambda \end{bmatrix}
# = \begin{bmatrix} f_0 \\ f_1 \\ 0 \end{bmatrix}$$
#
# It is solved by MINRES with algebraic multigrid for each body, in parallel, without a
# factorisation of the whole.

# +
import argparse
import json
import sys
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem import petsc

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Tie

parser = argparse.ArgumentParser(description="A MatNest and a solver of one's own.")
parser.add_argument("--levels", type=int, default=3)
parser.add_argument("--json", type=Path, metavar="FILE")
args = parser.parse_args()
comm = MPI.COMM_WORLD
# -

# Options of the solver: multigrid for the bodies, a factorisation for the few multipliers.

OPTIONS = {
    "ksp_type": "minres",
    "ksp_rtol": 1e-10,
    "ksp_error_if_not_converged": True,
    "pc_type": "fieldsplit",
    "pc_fieldsplit_type": "additive",
    "fieldsplit_u0_pc_type": "gamg",
    "fieldsplit_u1_pc_type": "gamg",
    "fieldsplit_multiplier_pc_type": "cholesky",
    "fieldsplit_multiplier_pc_factor_mat_solver_type": "mumps",
}
for name in ("u0", "u1", "multiplier"):
    OPTIONS[f"fieldsplit_{name}_ksp_type"] = "preonly"


def exact(x, sin=ufl.sin, cos=ufl.cos):
    """The solution; the plates are insulated at x = 0 and 1."""
    return cos(np.pi * x[0]) * sin(np.pi * x[1])


def run(n):
    """Solve with 2n and 3n cells along the interface."""
    lower, tags0 = meshes.block(comm, (2 * n, n), lambda x: x * (1, 0.5))
    upper, tags1 = meshes.block(comm, (3 * n, n), lambda x: x * (1, 0.5) + (0, 0.5))

    # The bodies' matrices and vectors, in DOLFINx's usual way

    V, K, f, bcs = [], [], [], []
    for mesh, facets in ((lower, tags0.find(meshes.BOTTOM)), (upper, tags1.find(meshes.TOP))):
        W = fem.functionspace(mesh, ("Lagrange", 2))
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        bc = fem.dirichletbc(default_scalar_type(0), fem.locate_dofs_topological(W, 1, facets), W)
        a = fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        L = fem.form(2 * np.pi**2 * exact(ufl.SpatialCoordinate(mesh)) * v * ufl.dx)
        V.append(W)
        bcs.append(bc)
        K.append(petsc.assemble_matrix(a, [bc]))
        K[-1].assemble()
        f.append(petsc.assemble_vector(L))
        f[-1].ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        petsc.set_bc(f[-1], [bc])

    # The constraint. The tie owns its matrices, so they are copied; columns of prescribed dofs are
    # zero here, and would go to the right-hand side were these not.

    tie = Tie((V[1], tags1.find(meshes.BOTTOM)), (V[0], tags0.find(meshes.TOP)))
    B = [block.copy() for block in tie.blocks()[::-1]]  # of the lower and the upper plate
    for block, bc in zip(B, bcs, strict=True):
        free = block.createVecRight()
        free.set(1.0)
        dofs, num_owned = bc.dof_indices()
        free.array[dofs[:num_owned]] = 0.0
        block.diagonalScale(R=free)
    Bt = [block.copy().transpose() for block in B]

    # The system, and for the preconditioner its diagonal with $\sum_i B_i D_i^{-1} B_i^T$ at the
    # end, $D_i$ the diagonal of $K_i$: cheap, and the iterations grow like $h^{-1/2}$ only.

    A = PETSc.Mat().createNest([[K[0], None, Bt[0]], [None, K[1], Bt[1]], [*B, None]], comm=comm)
    A.assemble()
    S = None
    for block, K_i in zip(B, K, strict=True):
        scaled = block.copy()
        d = K_i.getDiagonal()
        d.reciprocal()
        scaled.diagonalScale(R=d)
        product = scaled.matTransposeMult(block)
        S = product if S is None else S + product
    P = PETSc.Mat().createNest([[K[0], None, None], [None, K[1], None], [None, None, S]], comm=comm)
    P.assemble()

    # The solver

    b = PETSc.Vec().createNest([*f, B[0].createVecLeft()], comm=comm)
    x = b.duplicate()
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix("own_")  # before the splits: they take it over
    ksp.setOperators(A, P)
    ksp.getPC().setType("fieldsplit")
    rows = A.getNestISs()[0]
    ksp.getPC().setFieldSplitIS(*zip(("u0", "u1", "multiplier"), rows, strict=True))
    for key, value in OPTIONS.items():
        PETSc.Options()["own_" + key] = value
    ksp.setFromOptions()
    ksp.solve(b, x)

    sums = np.zeros(2)
    for W, part in zip(V, x.getNestSubVecs()):
        u = fem.Function(W)
        u.x.array[: part.getLocalSize()] = part.array_r
        u.x.scatter_forward()
        e = exact(ufl.SpatialCoordinate(W.mesh))
        # The zero function's error is the exact field's norm, by the same form
        sums += [fem.assemble_scalar(fem.form((f - e) ** 2 * ufl.dx)) for f in (u, fem.Function(W))]
    error = np.sqrt(np.divide(*comm.allreduce(sums)))
    return {"n": n, "dofs": A.getSize()[0], "iterations": ksp.its, "l2": float(error)}


rows = [run(8 * 2**level) for level in range(args.levels)]
if comm.rank == 0:
    print("  n     dofs  iterations  relative L² error")
    for row in rows:
        print("{n:3d} {dofs:8d} {iterations:6d}       {l2:.2e}".format(**row))
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))
