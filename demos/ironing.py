# # Ironing: a die is pressed into a foundation and drawn along it
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Large deformation, finite sliding, no friction. The die is ten times as stiff as the foundation,
# both are neo-Hookean. First it goes down in a few load steps, then along. Without friction its
# reaction should be vertical but for the foundation's far ends; what comes and goes as the nodes
# pass each other is the ripple of the method. All is conservative: the work of the reactions is
# the energy that is stored.

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
# In space: half of a spherical die and its foundation, with a disc of about ten cells in contact
SOLID = (26 * H, 9 * H, 5 * H), (14 * H, 7 * H, 5 * H)  # foundation, die
SOLID_CELLS = (26, 9, 5), (17, 9, 4)


def energy(u, E, nu=0.32):
    """Compressible neo-Hookean material."""
    mu, lame = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    dim = len(u)
    F = ufl.Identity(dim) + ufl.grad(u)
    J = ufl.det(F)
    return mu / 2 * (ufl.inner(F, F) - dim - 2 * ufl.ln(J)) + lame / 2 * ufl.ln(J) ** 2


class Ironing:
    """The scene."""

    def __init__(self, comm, degree=1, flat=False, swap=False, dim=2):
        """Make it.

        Args:
            comm: Communicator.
            degree: Of displacements and geometry.
            flat: Whether the die is flat, with corners.
            swap: Whether Γ1 is the die instead of the foundation.
            dim: Number of dimensions.
        """
        sizes = ((LENGTH, DEPTH), (WIDTH, HEIGHT)) if dim == 2 else SOLID
        cells = ((50, 10), (11, 6)) if dim == 2 else SOLID_CELLS
        start = np.zeros(dim)  # of the die's middle
        start[0] = 0.25 * LENGTH if dim == 2 else 10 * H

        def foundation(x):
            x = x * sizes[0]
            x[:, -1] -= sizes[0][-1]
            return x

        def die(x):
            x = x * sizes[1]
            x[:, 0] -= sizes[1][0] / 2
            square = (x[:, :-1] ** 2).sum(axis=1)
            bottom = 0 * square if flat else R - np.sqrt(R**2 - square)
            x[:, -1] = bottom + x[:, -1] * (1 - bottom / sizes[1][-1])
            return start + x

        self.u, self.energies, F, bcs, sides = [], [], [], [], []
        self.goal = None
        low, high = 2 * dim - 1, 2 * dim  # tags of the bottom and the top
        for place, n, E, tags in (
            (foundation, cells[0], 1.0, (high, low)),
            (die, cells[1], 10.0, (low, high)),
        ):
            cell = "quadrilateral" if dim == 2 else "hexahedron"
            mesh, ft = meshes.block(comm, n, place, cell=cell, degree=degree)
            V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
            u = fem.Function(V)
            dx = ufl.dx(metadata={"quadrature_degree": (6 - dim) * degree})
            W = energy(u, fem.Constant(mesh, default_scalar_type(E))) * dx
            self.goal = fem.Constant(mesh, default_scalar_type((0,) * dim))
            dofs = fem.locate_dofs_topological(V, dim - 1, ft.find(tags[1]))
            bcs.append(fem.dirichletbc(self.goal, dofs, V))
            if dim == 3:
                dofs = fem.locate_dofs_topological(V.sub(1), 2, ft.find(meshes.BOTTOM))
                bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(1)))
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

    def go(self, steps, size):
        """Press and iron.

        Args:
            steps: Number of load steps along.
            size: Their size, in cells of the foundation.
        """
        rows, work, start, last = [], 0.0, 0.0, np.zeros(len(self.goal.value))
        for step in range(1, PRESSING + steps + 1):
            down = DOWN * min(step / PRESSING, 1)
            along = max(step - PRESSING, 0) * size * H
            before = self.goal.value.copy()
            self.goal.value[0], self.goal.value[-1] = along, -down
            self.problem.solve()
            force = self.contact.force(self.problem) * (-1 if self.swap else 1)  # on the foundation
            if step > PRESSING:
                work += 0.5 * (force + last) @ (self.goal.value - before)
            else:  # in few large steps: no sum of their forces is their work
                start = self.energy()
            last = force
            rows.append(
                {
                    "step": step,
                    "fx": float(force[0]),
                    "fy": float(force[-1]),
                    "iterations": self.problem.iterations,
                    "halvings": self.problem.halvings,
                    "energy_error": float(abs(self.energy() - start - work) / start),
                }
            )
            progress.show(self.comm, f"step {step}: {self.problem.iterations} Newton steps")
        return rows


def main():
    """Iron, and say what it took."""
    parser = argparse.ArgumentParser(description="A die is drawn along a foundation.")
    parser.add_argument("--dim", type=int, choices=(2, 3), default=2)
    parser.add_argument("--degree", type=int, choices=(1, 2), default=1)
    parser.add_argument("--flat", action="store_true", help="a flat die with corners")
    parser.add_argument("--swap", action="store_true", help="Γ1 is the die")
    parser.add_argument("--step", type=float, default=1 / 3, help="size of load steps, in cells")
    parser.add_argument("--steps", type=int, default=60, help="number of load steps along")
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    die = Ironing(comm, args.degree, args.flat, args.swap, args.dim)
    rows = die.go(args.steps, args.step)
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
        print(f"work against energy: {max(row['energy_error'] for row in rows):.1e}")
        if args.json:
            args.json.write_text(json.dumps({"rows": rows}, indent=1))


if __name__ == "__main__":
    main()
