# # A rolling ball: friction in a time loop
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# The ball of the demo `bouncing` lies on the floor and is thrown along it, without spin. Friction
# brakes it and makes it turn, until it rolls. By conservation of the angular momentum about the
# floor its speed is then v₀ / (1 + k²) for any coefficient of friction, with k² its moment of
# inertia over m R². The energy that friction dissipated is missing in the energies of the ball.
# While the ball rolls, it sticks to the floor, and oscillates elastically about the sticking part.

# +
import argparse
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the package and the meshes
from bouncing import Ball, R, energies

from hypergap_dolfinx import progress

# -


class Thrown(Ball):
    """A ball that lies on the floor, then is thrown along it."""

    def __init__(self, comm, mu, speed, time, degree=1, step=0.01):
        """Lay it down and throw it. Collective.

        Args:
            comm: Communicator.
            mu: Coefficient of friction.
            speed: v₀.
            time: That it is to go on.
            degree: Of displacements and geometry.
            step: Time step.
        """
        super().__init__(comm, degree, 0.0, step, friction=mu, length=int(2 * speed * time) + 2)
        u, v, x = self.u_n, self.v_n, ufl.SpatialCoordinate(self.u.function_space.mesh)
        rho = self.rho
        self.spin = fem.form(rho * ((x + u)[0] * v[1] - (x + u)[1] * v[0]) * ufl.dx)
        self.inertia = fem.form(rho * ufl.inner(x + u, x + u) * ufl.dx)
        self.along = fem.Constant(self.u.function_space.mesh, default_scalar_type((0, 0)))
        self.means = [fem.form(rho * ufl.inner(f, self.along) * ufl.dx) for f in (u, v)]

        # Long time steps, each from rest, lay it down: what is left falls by a factor of 5 or more
        self.dt.value = 1.0
        self.a_n.x.array[:] = 0
        for _ in range(6):
            self.problem.solve()
            self.u_n.x.array[:] = self.u.x.array
        self.dt.value = step
        self.v_n.x.array[0::2] = speed
        self.dissipated = 0.0

    def advance(self):
        """One time step. Collective.

        Returns:
            What :meth:`Ball.advance` does, and speed, spin, forces, dissipation so far.
        """
        row = super().advance()
        self.dissipated += self.contact.dissipation(self.problem)
        means = []
        for axis in np.eye(2):
            self.along.value[:] = axis
            means += [self.integral(form) / self.weight for form in self.means]
        x, vx, y, vy = means
        inertia = self.integral(self.inertia) - self.weight * (x**2 + y**2)
        turning = (self.integral(self.spin) - self.weight * (x * vy - y * vx)) / inertia
        fx, fy = (float(f) for f in self.contact.force(self.problem))
        return row | {
            "x": x,
            "speed": vx,
            "spin": -turning * R,
            "fx": fx,
            "fy": fy,
            "sticking": int(self.contact.sticking.sum()),
            "dissipated": self.dissipated,
        }


def picture(rows, expected, folder):
    """Speeds, forces and energies over time.

    Args:
        rows: The time steps.
        expected: The speed at which it rolls.
        folder: Where to save it.
    """
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    t = np.array([row["time"] for row in rows])
    fig, axes = plt.subplots(3, figsize=(7, 7), sharex=True, layout="constrained")
    for name, label in (("speed", "speed"), ("spin", "spin · R")):
        axes[0].plot(t, [row[name] for row in rows], label=label)
    axes[0].axhline(expected, color="k", lw=0.8, ls="--", label="v₀ / (1 + k²)")
    axes[1].plot(t, [-row["fx"] / row["fy"] for row in rows], "C3", label="friction / pressure")
    lost = np.array([row["dissipated"] for row in rows])
    total = energies(rows)
    axes[2].plot(t, total - total[0], label="energy")
    axes[2].plot(t, -(lost - lost[0]), "k--", lw=0.8, label="− dissipated")
    for ax in axes:
        ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False)
    axes[2].set(xlabel="time", xlim=(0, t[-1]))
    folder.mkdir(parents=True, exist_ok=True)
    fig.savefig(folder / "rolling.png", dpi=100)
    plt.close(fig)


def main():
    """Throw it."""
    parser = argparse.ArgumentParser(description="A ball slides, then rolls.")
    parser.add_argument("--degree", type=int, choices=(1, 2), default=1)
    parser.add_argument("--mu", type=float, default=0.3, help="coefficient of friction")
    parser.add_argument("--speed", type=float, default=1.0, help="at which it is thrown")
    parser.add_argument("--step", type=float, default=0.01, help="time step")
    parser.add_argument("--time", type=float, default=3.0)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="save a picture")
    args = parser.parse_args()
    comm, rows = MPI.COMM_WORLD, []
    ball = Thrown(comm, args.mu, args.speed, args.time, args.degree, args.step)
    k2 = ball.integral(ball.inertia) / ball.weight / R**2
    expected = args.speed / (1 + k2)
    steps = round(args.time / args.step)
    for step in range(1, steps + 1):
        rows.append(ball.advance())
        progress.show(comm, f"step {step} of {steps}")
    progress.show(comm)
    kinetic = args.speed**2 / 2 * ball.weight
    total = energies(rows)
    lost = np.array([row["dissipated"] for row in rows])
    result = {
        "expected": expected,
        "speed": float(np.mean([row["speed"] for row in rows[steps // 2 :]])),
        "spin": float(np.mean([row["spin"] for row in rows[steps // 2 :]])),
        "dissipated": rows[-1]["dissipated"] / kinetic,
        "energy_error": abs(float((total - total[0] + lost - lost[0])[-1] / kinetic)),
        "iterations": float(np.mean([row["iterations"] for row in rows])),
        "halvings": sum(row["halvings"] for row in rows),
    }
    if comm.rank == 0:
        print("mean of the second half: ", end="")
        print(f"speed {result['speed']:.4f}, spin · R {result['spin']:.4f}", end="")
        print(f" (of a rigid ball: {expected:.4f})")
        print(f"friction took {result['dissipated']:.2%} of the energy", end="")
        print(f" (of a rigid ball: {k2 / (1 + k2):.2%}); balance {result['energy_error']:.1e}")
        print(f"Newton steps a time step: {result['iterations']:.1f}", end="")
        print(f", halved {result['halvings']} times")
        if args.json:
            args.json.write_text(json.dumps(result | {"rows": rows}, indent=1))
        if args.plot:
            picture(rows, expected, args.plot)


if __name__ == "__main__":
    main()
