# # Larger contacts: multigrid on three scenes, refined
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Contact solvers with multigrid are compared on scenes like these
# (<https://arxiv.org/abs/2505.18576>): a block on a block, a cylinder that is pressed into a
# foundation and drawn along it (*ironing*), and a ball on a beam that is clamped at both ends. The
# lower body has E = 1 and ν = 0.3 (`--poisson`), the upper one E = 1000 and ν = 0. Both are linear
# elastic, contact is without friction, with finite sliding.
#
# Each level halves all cells. With `solver="iterative"`, neither the iterations in a Newton step
# nor the Newton steps in a load step should grow from level to level. Nearly incompressible bodies
# are hard for algebraic multigrid: iterations grow as $1 / \sqrt{1 - 2\nu}$. With ν = 0.499 it is
# given up for factors, with a warning.

# +
import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from resource import RUSAGE_SELF, getrusage

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Contact, ContactProblem, progress

# -

# ## Scenes


@dataclass
class Box:
    """A box with hexahedra of degree 1, and what holds it."""

    cells: tuple[int, int, int]  # of the coarsest level
    low: tuple[float, float, float]  # its lowest corner
    size: tuple[float, float, float]
    held: tuple[int, ...]  # tags of its facets with prescribed displacements
    radius: float | None = None  # of its bottom, flat if there is none
    axes: int = 0  # along which the bottom is curved: 1 makes it a cylinder, 2 a ball

    def place(self, x):
        """Nodes from the unit cube."""
        x = self.low + x * self.size
        if self.radius:
            middle = np.add(self.low, np.divide(self.size, 2))[: self.axes]
            square = ((x[:, : self.axes] - middle) ** 2).sum(axis=1)
            bottom = self.radius - np.sqrt(self.radius**2 - square)
            x[:, 2] += bottom * (1 - (x[:, 2] - self.low[2]) / self.size[2])
        return x


FLOOR, ENDS, TOP = (meshes.BACK,), (meshes.LEFT, meshes.RIGHT), (meshes.FRONT,)

# Of each: the lower and the upper body, and the places where the upper one's top goes
SCENES = {
    "blocks": (
        Box((8, 8, 4), (-1, -1, -1), (2, 2, 1), FLOOR),
        Box((5, 5, 3), (-0.5, -0.5, 0), (1, 1, 0.6), TOP),
        [(0, 0, -0.025), (0, 0, -0.05)],
    ),
    "ironing": (
        Box((12, 6, 4), (0, 0, -1), (4, 2, 1), FLOOR),
        Box((5, 5, 3), (0.5, 0.4, 0), (1.2, 1.2, 0.8), TOP, radius=1.0, axes=1),
        [(0, 0, -0.05), (0, 0, -0.1), *((0.15 * k, 0, -0.1) for k in range(1, 5))],
    ),
    "ball": (
        Box((18, 4, 2), (-3, -0.5, -0.5), (6, 1, 0.5), ENDS),
        Box((6, 6, 4), (-0.4, -0.4, 0), (0.8, 0.8, 0.6), TOP, radius=0.8, axes=2),
        [(0, 0, -0.1), (0, 0, -0.2), (0, 0, -0.3)],
    ),
}


def make(comm, scene, level, solver, poisson):
    """A scene's problem.

    Returns:
        The problem, its number of displacements, and where its upper body's top goes.
    """
    *boxes, path = SCENES[scene]
    moduli = (1.0, poisson), (1000.0, 0.0)  # E, ν of the lower and the upper body
    goal, u, F, bcs, sides = None, [], [], [], []
    for upper, (box, (E, nu)) in enumerate(zip(boxes, moduli, strict=True)):
        n = [2**level * n for n in box.cells]
        mesh, ft = meshes.block(comm, n, box.place, cell="hexahedron")
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        w, v = fem.Function(V), ufl.TestFunction(V)
        eps = ufl.sym(ufl.grad(w))
        sigma = E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(3))
        goal = fem.Constant(mesh, default_scalar_type((0, 0, 0)))  # the upper body's is kept
        for tag in box.held:
            dofs = fem.locate_dofs_topological(V, 2, ft.find(tag))
            bcs.append(fem.dirichletbc(goal, dofs, V))
        u.append(w)
        F.append(ufl.inner(sigma, ufl.grad(v)) * ufl.dx)
        sides.append((V, ft.find(meshes.BACK if upper else meshes.FRONT)))
    contact = Contact(*sides[::-1])  # Γ1 is the lower body's surface
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact], solver=solver)
    return problem, sum(3 * w.function_space.dofmap.index_map.size_global for w in u), goal, path


def run(comm, scene, level, solver, poisson):
    """Solve a scene's load steps; a row of the table."""
    problem, dofs, goal, path = make(comm, scene, level, solver, poisson)
    start = time.process_time()
    for place in path:
        goal.value[:] = place
        problem.solve()
        progress.show(comm, f"{scene}, {dofs} displacements: {problem.iterations} Newton steps")
    progress.show(comm)
    newton = [len(step.steps) - 1 for step in problem.history]
    iterations = [step.iterations for load in problem.history for step in load.steps[1:]]
    row = {
        "scene": scene,
        "dofs": dofs,
        "load_steps": len(path),
        "newton_mean": float(np.mean(newton)),
        "newton_most": max(newton),
        "halvings": sum(load.halvings for load in problem.history),
        "iterations_mean": float(np.mean(iterations)),
        "iterations_most": max(iterations),
        "seconds": comm.allreduce(time.process_time() - start) / sum(newton),
        "memory": comm.allreduce(getrusage(RUSAGE_SELF).ru_maxrss / 2**20),
    }
    problem.destroy()
    return row


def main():
    """Refine scenes, and say what it takes."""
    parser = argparse.ArgumentParser(description="Larger contacts, by multigrid or factors.")
    parser.add_argument("--scene", choices=(*SCENES, "all"), default="all")
    parser.add_argument("--levels", type=int, default=2, help="number of levels")
    parser.add_argument("--solver", choices=("iterative", "direct"), default="iterative")
    parser.add_argument("--poisson", type=float, default=0.3, help="of the lower body")
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    rows = []
    if comm.rank == 0:
        print(
            "         displacements  load steps  Newton steps: mean, most  halvings  "
            "iterations in each: mean, most  processor s in each  GiB"
        )
    for scene in SCENES if args.scene == "all" else [args.scene]:
        for level in range(args.levels):
            rows.append(row := run(comm, scene, level, args.solver, args.poisson))
            if comm.rank == 0:
                print(
                    f"{scene:<8} {row['dofs']:>13} {row['load_steps']:>11} "
                    f"{row['newton_mean']:>19.1f} {row['newton_most']:>5} {row['halvings']:>9} "
                    f"{row['iterations_mean']:>25.1f} {row['iterations_most']:>5} "
                    f"{row['seconds']:>20.2f} {row['memory']:>4.1f}",
                    flush=True,
                )
    if args.json and comm.rank == 0:
        args.json.write_text(json.dumps({"rows": rows}, indent=1))


if __name__ == "__main__":
    main()
