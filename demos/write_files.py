# # Results for ParaView
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# A block is pressed on another one whose mesh doesn't match. DOLFINx's writers write displacements,
# stresses, and the functions on the gap domain Σ (α, the traction λ, gap and slip) for ParaView, in
# parallel.

# +
import argparse
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem, io

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Tie, TiedProblem, files

parser = argparse.ArgumentParser(description="Write the results of two tied blocks.")
parser.add_argument("folder", type=Path, nargs="?", default="results/write_files")
parser.add_argument("--vtk", action="store_true", help="VTK files instead of VTX")
parser.add_argument("--json", type=Path, metavar="FILE")
parser.add_argument("--plot", type=Path, metavar="DIR")
args = parser.parse_args()
comm = MPI.COMM_WORLD
# -

# Two blocks of degree 2. A pressure acts on the middle of the upper one; the lower one is held.

lower = meshes.block(comm, (10, 5), lambda x: x * (2, 1), degree=2)
upper = meshes.block(comm, (7, 3), lambda x: x * (1, 0.5) + (0.5, 1), cell="triangle", degree=2)
E, nu = 1.0, 0.3


def sigma(u):
    """Plane strain."""
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(2))


V, forms, loads = [], [], []
for mesh, tags in (lower, upper):
    W = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)
    pressure = fem.Constant(mesh, default_scalar_type(0.1 if mesh is upper[0] else 0.0))
    V.append(W)
    forms.append(ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx)
    loads.append(-pressure * v[1] * ds(meshes.TOP))
dofs = fem.locate_dofs_topological(V[0], 1, lower[1].find(meshes.BOTTOM))
bcs = [fem.dirichletbc(np.zeros(2, dtype=default_scalar_type), dofs, V[0])]
tie = Tie((V[0], lower[1].find(meshes.TOP)), (V[1], upper[1].find(meshes.BOTTOM)))
problem = TiedProblem(forms, loads, bcs=bcs, ties=[tie])
us = problem.solve()


# A file holds functions with one mesh and one element. `files.interpolated` makes a function of any
# UFL expression, `files.on_sigma` puts α, λ, gap and slip on one element.


def write(name, functions):
    """VTX, or VTK where DOLFINx was built without ADIOS2."""
    if hasattr(io, "VTXWriter") and not args.vtk:
        with io.VTXWriter(comm, args.folder / f"{name}.bp", functions, engine="BP4") as file:
            file.write(0.0)
    else:
        with io.VTKFile(comm, args.folder / f"{name}.pvd", "w") as file:
            file.write_function(functions, 0.0)


for name, u in zip(("lower", "upper"), us, strict=True):
    u.name = "displacement"
    stress = files.interpolated(sigma(u), u.function_space.mesh, 1, "stress")
    write(f"{name}_displacement", [u])
    write(f"{name}_stress", [stress])
write("sigma", files.on_sigma(tie, problem))

# The tie transmits the load:

q = tie.quadrature(4)
force = q.integrate(q.evaluate(tie.traction(problem)))
if comm.rank == 0:
    print(f"force through the interface: ({force[0]:.1e}, {force[1]:.6f})")
    print(f"files in {args.folder}/")
    if args.json:
        args.json.write_text(json.dumps({"force": list(force)}, indent=1))
if args.plot:
    from hypergap_dolfinx import plot

    plot.deformed(us, args.plot / "write_files.png")
