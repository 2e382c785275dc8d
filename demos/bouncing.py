# # A bouncing ball: contact in a time loop
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# A neo-Hookean ball, hollow and in plane strain, falls on a rigid floor. The residual contains the
# inertia of Newmark's method (β = 1/4, γ = 1/2: no damping). A time step is one call of `solve()`.
#
# Contact has one requirement: nodes that can touch must have no mass. Otherwise each node that hits
# the floor is stopped within one time step, however short: forces jump, nodes chatter, and
# Newmark's method gains energy (`--mass --time 2.5` shows it). So the density of the cells along
# the surface is moved to the other cells. The surface then follows the floor like a spring, contact
# forces are continuous in time, and the energy is conserved.

# +
import argparse
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem, la

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Contact, ContactProblem, progress

# -

R, HOLE = 1.0, 0.3  # radii of the ball
E, NU = 100.0, 0.3  # with density and gravity 1: from a height of 1 it is flattened by a fifth
CELLS = {1: (32, 4), 2: (20, 3)}  # around and across, for each degree


class Ball:
    """The ball, the floor and the time loop."""

    def __init__(self, comm, degree=1, height=1.0, step=0.01, mass=False, friction=None, length=4):
        """Make them; the ball is at rest.

        Args:
            comm: Communicator.
            degree: Of displacements and geometry.
            height: How far it falls.
            step: Time step.
            mass: Whether the ball's surface keeps its mass.
            friction: The floor's coefficient of friction, if it has one.
            length: Of the floor.
        """
        n = CELLS[degree]
        ball, ft = meshes.ring_sector(comm, *n, HOLE, R, angle=2 * np.pi, degree=degree)
        floor, floor_ft = meshes.block(
            comm,
            (5 * length, 1),
            lambda x: np.array((length, 0.4)) * (x - (0.5, 1)) - (0, R + height),
        )
        V = fem.functionspace(ball, ("Lagrange", degree, (2,)))
        V_floor = fem.functionspace(floor, ("Lagrange", 1, (2,)))
        self.comm, self.height, self.facets = comm, height, ft.find(meshes.OUTER)
        self.u, self.u_n, self.v_n, self.a_n = (fem.Function(V) for _ in range(4))
        self.dt = fem.Constant(ball, default_scalar_type(step))

        # No density in cells that have nodes on the surface
        self.rho = rho = fem.Function(fem.functionspace(ball, ("Discontinuous Lagrange", 0)))
        rho.x.array[:] = 1
        if not mass:
            whole = self.integral(rho * ufl.dx)
            surface = fem.locate_dofs_topological(V, 1, self.facets)
            rho.x.array[np.isin(V.dofmap.list, surface).any(axis=1)] = 0
            rho.x.array[:] *= whole / self.integral(rho * ufl.dx)

        # The residual, with the acceleration at the end of the time step
        u, u_n, v_n, a_n, dt = self.u, self.u_n, self.v_n, self.a_n, self.dt
        gravity = ufl.as_vector((0, -1))
        a = 4 * (u - u_n - dt * v_n) / dt**2 - a_n
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree})
        inertia = rho * ufl.inner(a - gravity, ufl.TestFunction(V)) * dx
        F = inertia + ufl.derivative(self.stored(u) * dx, u)

        sides = (V_floor, floor_ft.find(meshes.TOP)), (V, self.facets)
        self.contact = Contact(*sides, friction=friction)
        u_floor = fem.Function(V_floor)
        self.problem = ContactProblem([None, F], [u_floor, u], contacts=[self.contact])

        self.F = fem.form(F)
        self.kinetic = fem.form(rho / 2 * ufl.inner(v_n, v_n) * dx)
        self.elastic = fem.form(self.stored(u) * dx)
        self.potential = fem.form(-rho * ufl.inner(gravity, u) * dx)
        self.mean = fem.form(rho * u[1] * dx)
        self.weight = self.integral(rho * dx)
        self.a_n.x.array[1::2] = -1  # it falls
        self.time, self.work, self.force = 0.0, 0.0, la.vector(V.dofmap.index_map, 2).array

    @staticmethod
    def stored(u):
        """Energy density."""
        mu, lame = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
        F = ufl.Identity(2) + ufl.grad(u)
        J = ufl.det(F)
        return mu / 2 * (ufl.inner(F, F) - 2 - 2 * ufl.ln(J)) + lame / 2 * ufl.ln(J) ** 2

    def integral(self, form):
        """Over all ranks."""
        return self.comm.allreduce(fem.assemble_scalar(fem.form(form)))

    def advance(self):
        """One time step. Collective.

        Returns:
            Time, energies, height of the ball's middle above where it touches, force of the floor.
        """
        self.problem.solve()
        u, u_n, v_n, a_n = (f.x.array for f in (self.u, self.u_n, self.v_n, self.a_n))
        dt = float(self.dt.value)

        # What the floor did: its forces on the nodes are what is left of the residual
        force = fem.assemble_vector(self.F)
        force.scatter_reverse(la.InsertMode.add)
        force.scatter_forward()
        V = self.u.function_space
        mine = slice(2 * V.dofmap.index_map.size_local)
        mean = (self.force + force.array) / 2
        self.work += self.comm.allreduce(mean[mine] @ (u - u_n)[mine])
        self.force = force.array.copy()

        a = 4 * (u - u_n - dt * v_n) / dt**2 - a_n
        v_n += dt * (a_n + a) / 2
        a_n[:], u_n[:] = a, u
        self.time += dt
        kinetic, elastic, potential = (
            self.integral(form) for form in (self.kinetic, self.elastic, self.potential)
        )
        return {
            "time": self.time,
            "kinetic": kinetic,
            "elastic": elastic,
            "potential": potential + self.weight * self.height,
            "work": self.work,
            "height": self.height + self.integral(self.mean) / self.weight,
            "force": float(self.contact.force(self.problem)[1]),
            "in_contact": int(self.contact.active.sum()),
            "iterations": self.problem.iterations,
            "halvings": self.problem.halvings,
        }


def energies(rows):
    """What the ball has at each time step, of all kinds."""
    return np.array([row["kinetic"] + row["elastic"] + row["potential"] for row in rows])


def bounces(rows, energy):
    """What each bounce took: the first and the last time with contact, and the energy.

    Args:
        rows: The time steps.
        energy: Of the ball when it was dropped.
    """
    total = energies(rows)
    on = np.array([row["in_contact"] > 0 for row in rows])
    starts, ends = (np.flatnonzero(np.diff(on.astype(int)) == sign) + 1 for sign in (1, -1))
    return [
        {
            "touches": rows[a]["time"],
            "leaves": rows[b]["time"],
            "drift": float(total[b] - total[a - 1]) / energy,
            "gained": float((total[a : b + 1] - total[a - 1]).max()) / energy,
            "force": max(row["force"] for row in rows[a:b]),
        }
        for a, b in zip(starts, ends, strict=False)
    ]


def picture(rows, outlines, folder):
    """The ball's path, as if it were thrown to the right, and its energies.

    Args:
        rows: The time steps.
        outlines: Time and edges, ``(num_edges, 2, 2)``, of the ball.
        folder: Where to save it.
    """
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt
    from matplotlib.collections import LineCollection

    t = np.array([row["time"] for row in rows])
    fig, (above, below) = plt.subplots(
        2, figsize=(9, 5), height_ratios=(5, 4), layout="constrained"
    )
    along = 3.0  # speed to the right
    for time, edges in outlines:
        shifted = edges + np.array((along * time, 0))
        above.add_collection(LineCollection(shifted, colors="C0", lw=0.8))
    above.plot(along * t, [R + row["height"] for row in rows], "C3", lw=1)
    above.axhline(0, color="k")
    above.axis("equal")
    above.axis("off")
    for name in ("kinetic", "elastic", "potential"):
        below.plot(t, [row[name] for row in rows], label=name)
    below.plot(t, energies(rows), "k", label="all")
    below.set(xlabel="time", ylabel="energy", xlim=(0, t[-1]))
    below.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1))
    folder.mkdir(parents=True, exist_ok=True)
    fig.savefig(folder / "bouncing.png", dpi=100)
    plt.close(fig)


def main():
    """Let it fall."""
    parser = argparse.ArgumentParser(description="An elastic ball bounces.")
    parser.add_argument("--degree", type=int, choices=(1, 2), default=1)
    parser.add_argument("--height", type=float, default=1.0, help="from which it falls")
    parser.add_argument("--step", type=float, default=0.01, help="time step")
    parser.add_argument("--time", type=float, default=6.0)
    parser.add_argument("--mass", action="store_true", help="the surface keeps its mass")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="save a picture")
    args = parser.parse_args()
    comm, rows, outlines = MPI.COMM_WORLD, [], []
    ball = Ball(comm, args.degree, args.height, args.step, args.mass)
    steps = round(args.time / args.step)
    for step in range(1, steps + 1):
        rows.append(ball.advance())
        progress.show(comm, f"step {step} of {steps}")
        if args.plot and step % max(round(0.24 / args.step), 1) == 1:
            surface = ball.contact.displaced(ball.problem)[1]
            edges = surface.x[surface.facets] + np.array((0, R + args.height))
            outlines.append((ball.time, edges))
    progress.show(comm)
    energy = ball.weight * args.height
    found = bounces(rows, energy)
    count = [row["iterations"] for row in rows]
    if comm.rank == 0:
        print("bounce  from    to      largest force  energy: drift, gained at most")
        for i, row in enumerate(found, 1):
            line = f"{i:<6}  {row['touches']:<6.2f}  {row['leaves']:<6.2f}  {row['force']:<13.2f}"
            print(f"{line}  {row['drift']:+.2%}, {row['gained']:+.2%}")
        print(f"Newton steps a time step: {np.mean(count):.1f}, at most {max(count)}")
        print(f"work of the floor: {rows[-1]['work'] / energy:+.2%} of the energy")
        if args.json:
            args.json.write_text(json.dumps({"bounces": found, "rows": rows}, indent=1))
        if args.plot:
            picture(rows, outlines, args.plot)


if __name__ == "__main__":
    main()
