# # Two rubber strips, bent by half a turn
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# A soft strip is tied to a stiff one whose mesh doesn't match. One end is held, the other is turned
# by 180°. The tie is linear in the displacements, so it follows any rotation as it is. This demo
# shows
#
# - `NonlinearTiedProblem` with an energy of your own, in UFL,
# - that Newton's method converges quadratically through the tie,
# - that energy and displacement are those of one mesh without an interface.

# +
import argparse
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import NonlinearTiedProblem, Tie, progress

parser = argparse.ArgumentParser(description="Large bending of two tied strips.")
parser.add_argument("--n", type=int, default=1, help="refines the meshes")
parser.add_argument("--steps", type=int, default=6, help="steps of the load")
parser.add_argument("--json", type=Path, metavar="FILE")
parser.add_argument("--plot", type=Path, metavar="DIR")
args = parser.parse_args()
comm, n = MPI.COMM_WORLD, args.n
L, H = 10.0, 1.0
# -

# Two strips, and one fused strip to compare with: meshes and their facet tags.

lower = meshes.block(comm, (24 * n, 2 * n), lambda x: x * (L, H / 2))
upper = meshes.block(comm, (16 * n, 2 * n), lambda x: x * (L, H / 2) + (0, H / 2))
fused = meshes.block(comm, (24 * n, 4 * n), lambda x: x * (L, H))


# A neo-Hookean material, five times as stiff below as above:


def energy(u):
    """Strain energy per undeformed volume."""
    x = ufl.SpatialCoordinate(u.function_space.mesh)
    mu = ufl.conditional(ufl.lt(x[1], H / 2), 5.0, 1.0)
    F = ufl.Identity(2) + ufl.grad(u)
    J = ufl.det(F)
    return mu / 2 * (ufl.inner(F, F) - 2 - 2 * ufl.ln(J)) + mu * ufl.ln(J) ** 2


# The right end is turned by θ and put where a circular arc of length L ends.


def bent(theta):
    """Displacement of the right end."""
    R = L / theta

    def u(x):
        y = x[1] - H / 2
        end = (R - y) * np.sin(theta), R - (R - y) * np.cos(theta) + H / 2
        return np.array([end[0] - x[0], end[1] - x[1]])

    return u


def solve(bodies, tied):
    """Bend bodies; returns a row for each step of the load, the residuals of the last, and u."""
    us = [fem.Function(fem.functionspace(mesh, ("Lagrange", 2, (2,)))) for mesh, _ in bodies]
    F = [ufl.derivative(energy(u) * ufl.dx, u) for u in us]
    ends, bcs = [fem.Function(u.function_space) for u in us], []
    for u, end, (_, tags) in zip(us, ends, bodies, strict=True):
        V = u.function_space
        for tag, g in ((meshes.LEFT, fem.Function(V)), (meshes.RIGHT, end)):
            dofs = fem.locate_dofs_topological(V, 1, tags.find(tag))
            bcs.append(fem.dirichletbc(g, dofs))

    # The lower strip is the stiffer one, with the smaller cells: Γ0. The upper one is Γ1.
    ties = []
    if tied:
        (_, tags0), (_, tags1) = bodies
        side0 = us[0].function_space, tags0.find(meshes.TOP)
        ties = [Tie(side0, (us[1].function_space, tags1.find(meshes.BOTTOM)))]
    problem = NonlinearTiedProblem(F, us, bcs=bcs, ties=ties, petsc_options={"snes_rtol": 1e-12})
    problem.solver.setMonitor(progress.monitor)
    problem.solver.setConvergenceHistory()

    rows = []
    forms = [fem.form(f * ufl.dx) for u in us for f in (energy(u), u[0] / (L * H), u[1] / (L * H))]
    for theta in np.linspace(0, np.pi, args.steps + 1)[1:]:
        for end in ends:
            end.interpolate(bent(theta))
        problem.solve()
        values = comm.allreduce(np.array([fem.assemble_scalar(form) for form in forms]))
        residuals = problem.solver.getConvergenceHistory()[0]
        newton = problem.solver.getIterationNumber()
        rows.append((theta, newton, *values.reshape(-1, 3).sum(axis=0)))
    progress.show(comm)
    return rows, [float(r) for r in residuals[-newton - 1 :]], us


rows, residuals, us = solve([lower, upper], tied=True)
reference, _, _ = solve([fused], tied=False)

# ## The table
#
# of strain energy and mean displacement, tied and fused:

if comm.rank == 0:
    print("angle  Newton steps   energy, tied and fused   mean displacement, tied and fused")
    for (theta, newton, e, x, y), (_, newton_f, e_f, x_f, y_f) in zip(rows, reference, strict=True):
        print(
            f"{np.degrees(theta):4.0f}°   {newton:4d} {newton_f:4d}      {e:.6f} {e_f:.6f}"
            f"      ({x:.5f}, {y:.5f}) ({x_f:.5f}, {y_f:.5f})"
        )
    print("residuals of the last step:", *(f"{r:.1e}" for r in residuals))
    u, u_f = np.array(rows[-1][3:]), np.array(reference[-1][3:])
    result = {
        "energy": rows[-1][2],
        "energy_difference": abs(rows[-1][2] / reference[-1][2] - 1),
        "displacement_difference": float(np.linalg.norm(u - u_f) / np.linalg.norm(u_f)),
        "newton_steps": [row[1] for row in rows],
        "newton_steps_fused": [row[1] for row in reference],
        "residuals": residuals,
    }
    print(
        "relative differences to the fused mesh at 180°: energy {energy_difference:.1e}, "
        "mean displacement {displacement_difference:.1e}".format(**result)
    )
    if args.json:
        args.json.write_text(json.dumps(result, indent=1))
if args.plot:
    from hypergap_dolfinx import plot

    plot.deformed(us, args.plot / "hyperelasticity.png", factor=1)
