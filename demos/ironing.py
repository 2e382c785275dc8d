# # Ironing: a die is pressed into a foundation and drawn along it
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Large deformation, finite sliding, no friction. The die is ten times as stiff as the foundation,
# both are neo-Hookean. First it goes down in a few load steps, then along. Without friction its
# reaction should be vertical but for the foundation's far ends; what comes and goes as the nodes
# pass each other is the ripple of the method. All is conservative: the reaction is the derivative
# of the energy that is stored. Each step is followed by one of a thousandth of a cell to see that:
# over a third of a cell the mean of two forces isn't their work to more than two or three digits.

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
from hypergap_dolfinx import Contact, ContactProblem, progress

# -

H = 0.12  # size of the foundation's cells
LENGTH, DEPTH = 50 * H, 10 * H  # of the foundation
WIDTH, HEIGHT, R = 16 * H, 8 * H, 20 * H  # of the die, radius of its curved bottom
DOWN, PRESSING = H, 4  # how far the die goes down, in how many load steps
SMALL = 1e-3 * H  # a step over which the mean of two forces is their work


def energy(u, E, nu=0.32):
    """Compressible neo-Hookean material."""
    mu, lame = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    F = ufl.Identity(2) + ufl.grad(u)
    J = ufl.det(F)
    return mu / 2 * (ufl.inner(F, F) - 2 - 2 * ufl.ln(J)) + lame / 2 * ufl.ln(J) ** 2


class Ironing:
    """The scene."""

    def __init__(self, comm, degree=1, flat=False, swap=False):
        """Make it.

        Args:
            comm: Communicator.
            degree: Of displacements and geometry.
            flat: Whether the die is flat, with corners.
            swap: Whether Γ1 is the die instead of the foundation.
        """

        def foundation(x):
            return x * (LENGTH, DEPTH) - (0, DEPTH)

        def die(x):
            across = (x[:, 0] - 0.5) * WIDTH
            bottom = 0 * across if flat else R - np.sqrt(R**2 - across**2)
            place = bottom + x[:, 1] * (HEIGHT - bottom)
            return np.column_stack((0.25 * LENGTH + across, place))

        self.u, self.energies, F, bcs, sides = [], [], [], [], []
        self.goal = None
        for place, n, E, tags in (
            (foundation, (50, 10), 1.0, (meshes.TOP, meshes.BOTTOM)),
            (die, (11, 6), 10.0, (meshes.BOTTOM, meshes.TOP)),
        ):
            mesh, ft = meshes.block(comm, n, place, cell="quadrilateral", degree=degree)
            V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
            u = fem.Function(V)
            dx = ufl.dx(metadata={"quadrature_degree": 4 * degree})
            W = energy(u, fem.Constant(mesh, default_scalar_type(E))) * dx
            self.goal = fem.Constant(mesh, default_scalar_type((0, 0)))
            dofs = fem.locate_dofs_topological(V, 1, ft.find(tags[1]))
            bcs.append(fem.dirichletbc(self.goal, dofs, V))
            self.u.append(u)
            self.energies.append(fem.form(W))
            F.append(ufl.derivative(W, u))
            sides.append((V, ft.find(tags[0])))
        self.comm = comm
        self.contact = Contact(*(sides if swap else sides[::-1]))
        self.problem = ContactProblem(F, self.u, bcs=bcs, contacts=[self.contact])
        self.swap = swap

    def energy(self):
        """The energy that is stored in both bodies."""
        return self.comm.allreduce(sum(fem.assemble_scalar(form) for form in self.energies))

    def solve(self):
        """Move the die to where it is to go; the force on the foundation."""
        self.problem.solve()
        return self.contact.force(self.problem) * (-1 if self.swap else 1)

    def go(self, steps, size):
        """Press and iron.

        Args:
            steps: Number of load steps along.
            size: Their size, in cells of the foundation.
        """
        rows = []
        for step in range(1, PRESSING + steps + 1):
            down = DOWN * min(step / PRESSING, 1)
            along = max(step - PRESSING, 0) * size * H
            self.goal.value[:] = along, -down
            force = self.solve()
            rows.append(
                {
                    "step": step,
                    "fx": float(force[0]),
                    "fy": float(force[1]),
                    "iterations": self.problem.iterations,
                    "halvings": self.problem.halvings,
                }
            )
            energy, move = self.energy(), np.array((SMALL, 0))
            self.goal.value[:] += move
            work = 0.5 * (force + self.solve()) @ move
            error = abs(self.energy() - energy - work) / (np.linalg.norm(force) * SMALL)
            rows[-1]["energy_error"] = float(error)
            progress.show(self.comm, f"step {step}: {rows[-1]['iterations']} Newton steps")
        return rows


def main():
    """Iron, and say what it took."""
    parser = argparse.ArgumentParser(description="A die is drawn along a foundation.")
    parser.add_argument("--degree", type=int, choices=(1, 2), default=1)
    parser.add_argument("--flat", action="store_true", help="a flat die with corners")
    parser.add_argument("--swap", action="store_true", help="Γ1 is the die")
    parser.add_argument("--step", type=float, default=1 / 3, help="size of load steps, in cells")
    parser.add_argument("--steps", type=int, default=60, help="number of load steps along")
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    rows = Ironing(comm, args.degree, args.flat, args.swap).go(args.steps, args.step)
    progress.show(comm)
    along = rows[PRESSING:]
    fy = np.array([row["fy"] for row in along])
    ripple = fy - np.convolve(np.pad(fy, 3, "edge"), np.ones(7) / 7, "valid")
    count = np.array([row["iterations"] for row in along])
    if comm.rank == 0:
        print(f"Newton steps a load step: {count.mean():.1f}, at most {count.max()}")
        print(f"halved load steps: {sum(row['halvings'] for row in rows)}")
        largest = np.abs(ripple / fy)[2:-2].max(initial=0)
        print(f"vertical force: {fy.mean():.4f}, ripple {largest:.1e}")
        print(f"reaction against energy: {max(row['energy_error'] for row in rows):.1e}")
        if args.json:
            args.json.write_text(json.dumps({"rows": rows}, indent=1))


if __name__ == "__main__":
    main()
