# # Heat through two plates, steady and in time
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# The unit square is cut in two along a wave; the plates' meshes don't match there. This demo shows
#
# - a tie between scalar fields, along a curved interface,
# - the steady temperature, and the heat flux that the tie transmits, against the exact ones,
# - a time loop that assembles and factorises its matrix once, against the exact decay.

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
from hypergap_dolfinx import Tie, TiedProblem, progress

parser = argparse.ArgumentParser(description="Heat conduction through two tied plates.")
parser.add_argument("--n", type=int, default=8, help="refines the meshes")
parser.add_argument("--steps", type=int, default=100, help="steps in time")
parser.add_argument("--json", type=Path, metavar="FILE")
parser.add_argument("--plot", type=Path, metavar="DIR")
args = parser.parse_args()
comm, n = MPI.COMM_WORLD, args.n
# -

# Quadratic quadrilaterals, 2n of them along the interface below and 3n above:


def wavy(start, end):
    """The unit square mapped to heights from start to end, each a height or the wave."""

    def mapping(x):
        wave = 0.5 + 0.1 * np.sin(2 * np.pi * x[:, 0])
        low, high = (wave if y == "wave" else y for y in (start, end))
        return np.column_stack((x[:, 0], low + (high - low) * x[:, 1]))

    return mapping


lower, lower_tags = meshes.block(comm, (2 * n, n), wavy(0, "wave"), degree=2)
upper, upper_tags = meshes.block(comm, (3 * n, n), wavy("wave", 1), degree=2)
V = [fem.functionspace(mesh, ("Lagrange", 2)) for mesh in (lower, upper)]
tie = Tie((V[1], upper_tags.find(meshes.BOTTOM)), (V[0], lower_tags.find(meshes.TOP)))

# Around the square the temperature is zero.

bcs = []
for W, tags, tag in ((V[0], lower_tags, meshes.BOTTOM), (V[1], upper_tags, meshes.TOP)):
    facets = np.concatenate([tags.find(t) for t in (meshes.LEFT, meshes.RIGHT, tag)])
    dofs = fem.locate_dofs_topological(W, 1, facets)
    bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, W))

# With the source $2\pi^2 \sin\pi x \sin\pi y$, the steady temperature is $\sin\pi x \sin\pi y$;
# without it, this decays as $e^{-2\pi^2 t}$.


def exact(x, sin=ufl.sin):
    """The temperature."""
    return sin(np.pi * x[0]) * sin(np.pi * x[1])


def relative_error(T, factor=1.0):
    """L² error over both plates."""
    sums = np.zeros(2)
    for T_i in T:
        e = factor * exact(ufl.SpatialCoordinate(T_i.function_space.mesh))
        dx = ufl.dx(metadata={"quadrature_degree": 8})
        # The zero function's error is the exact field's norm, by the same form
        both = (T_i, fem.Function(T_i.function_space))
        sums += [fem.assemble_scalar(fem.form((f - e) ** 2 * dx)) for f in both]
    return float(np.sqrt(np.divide(*comm.allreduce(sums))))


# ## Steady

mass, conduction, source = [], [], []
for W in V:
    u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
    mass.append(u * v * ufl.dx)
    conduction.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
    source.append(2 * np.pi**2 * exact(ufl.SpatialCoordinate(W.mesh)) * v * ufl.dx)
problem = TiedProblem(conduction, source, bcs=bcs, ties=[tie])
result = {"steady": relative_error(problem.solve())}

# λ is $\nabla T \cdot n_0$, the heat that flows into the upper plate (Γ0) through the interface.

q = tie.quadrature(8)
x, y = np.pi * np.moveaxis(q.x, -1, 0)
gradient = np.pi * np.stack((np.cos(x) * np.sin(y), np.sin(x) * np.cos(y)), axis=-1)
flux = (gradient * q.normal).sum(axis=-1)
error = q.evaluate(tie.traction(problem))[..., 0] - flux
result["flux"] = float(np.sqrt(q.integrate(error**2) / q.integrate(flux**2)))

# ## In time
#
# Crank–Nicolson: $(T - T_{old})/\tau = \frac12 \Delta (T + T_{old})$, until $e^{-1}$ is left. `T`
# holds both: the loads are assembled from it, then it takes the solution.

T = [fem.Function(W) for W in V]
for T_i in T:
    T_i.interpolate(lambda x: exact(x, np.sin))
tau = 1 / (2 * np.pi**2) / args.steps
forms = [m + tau / 2 * c for m, c in zip(mass, conduction, strict=True)]
loads = [ufl.action(m - tau / 2 * c, T_i) for m, c, T_i in zip(mass, conduction, T, strict=True)]
problem = TiedProblem(forms, loads, bcs=bcs, ties=[tie], u=T)
problem.assemble_matrix()
for step in range(args.steps):
    progress.show(comm, f"step {step} of {args.steps}")
    problem.assemble_vector()
    problem.solve_system()  # the first one factorises
progress.show(comm)
result["transient"] = relative_error(T, np.exp(-1))

if comm.rank == 0:
    print(
        "relative L² errors: steady temperature {steady:.2e}, heat flux {flux:.2e}, temperature "
        "after {} steps in time {transient:.2e}".format(args.steps, **result)
    )
    if args.json:
        args.json.write_text(json.dumps(result, indent=1))
if args.plot:
    from hypergap_dolfinx import plot

    plot.field(T, args.plot / "heat.png", title="temperature")
