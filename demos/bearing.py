# # A shaft turned in a bearing: a rigid body under forces and torques
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# A shaft of radius R lies in a bush with clearance, loaded by W. It is a `RigidBody`: a mesh of its
# surface, a reference point and three unknowns. A torque T turns it. It rolls up the bush until its
# weight has the moment T about the place of contact, which is at the angle α from the bottom then:
#
# $$W R \sin\alpha = T.$$
#
# That goes up to the angle of friction, tan φ = μ. A larger torque makes the shaft slide, and no
# equilibrium is left, which an error says. Turned by a prescribed angle it slides there with
# the torque W R sin φ (the friction circle; but for (a / 4R)², as pressures lie in an arc of a).

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
from hypergap_dolfinx import Contact, ContactProblem, RigidBody, SolveError, progress

# -

R, CLEARANCE, THICK, SECTOR = 1.0, 0.02, 1.0, 1.2  # the last: angle of the bush that is modelled
W, MU, E, NU = 0.1, 0.3, 1000.0, 0.3
DEGREE = 2


class Bearing:
    """The shaft in its bush."""

    def __init__(self, comm, cells, held):
        """Mesh both, and let the weight press them together. Collective.

        Args:
            comm: Communicator.
            cells: Number of cells along the bush.
            held: What is held of the shaft.
        """

        def place(s):
            r = R + CLEARANCE + THICK * s[:, 0] ** 1.5
            angle = SECTOR * (s[:, 1] - 0.5) - np.pi / 2 + np.arctan(MU) / 2
            return np.column_stack((r * np.cos(angle), r * np.sin(angle)))

        bush, of_bush = meshes.block(comm, (cells // 9, cells), place, degree=DEGREE)
        around = round(cells * 2 * np.pi / SECTOR)
        shaft, of_shaft = meshes.ring_sector(
            comm, around, 1, 0.9 * R, R, angle=2 * np.pi, degree=DEGREE
        )
        V0, V1 = (fem.functionspace(mesh, ("Lagrange", DEGREE, (2,))) for mesh in (shaft, bush))
        u0, u1 = fem.Function(V0), fem.Function(V1)
        mu, lame = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
        eps = ufl.sym(ufl.grad(u1))
        energy = mu * ufl.inner(eps, eps) + lame / 2 * ufl.tr(eps) ** 2
        F = ufl.derivative(energy * ufl.dx, u1)
        outside = fem.locate_dofs_topological(V1, 1, of_bush.find(meshes.RIGHT))
        fixed = fem.dirichletbc(np.zeros(2, dtype=default_scalar_type), outside, V1)

        shaft.geometry.x[:, 1] -= CLEARANCE  # it lies in the bush
        self.shaft = RigidBody(u0, point=(0, -CLEARANCE), held=held)
        sides = (V0, of_shaft.find(meshes.OUTER)), (V1, of_bush.find(meshes.LEFT))
        self.contact = Contact(*sides, friction=MU)
        self.problem = ContactProblem(
            [self.shaft, F], [u0, u1], bcs=[fixed], contacts=[self.contact]
        )
        self.shaft.force = 0.0, -W

    def solve(self):
        """One load step. Collective.

        Returns:
            The rotation, the angle α of the shaft's place, the torque and what was needed.
        """
        self.problem.solve()
        shaft, (x, y) = self.shaft, self.shaft.displacement + self.shaft.point
        torque = shaft.torque[0] + shaft.reaction[2]
        return {
            "rotation": float(shaft.angles[0]),
            "alpha": float(np.arctan2(-x, -y)),
            "torque": float(torque),
            "newton_steps": self.problem.iterations,
            "slipping": int(self.contact.slipping.sum()),
            "sticking": int(self.contact.sticking.sum()),
        }


def picture(rows, folder):
    """Torque over rotation.

    Args:
        rows: Load steps by torque and by rotation.
        folder: Where to save it.
    """
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots(figsize=(6, 4), layout="constrained")
    for name, style in (("rotation", "C0-"), ("torque", "C3o")):
        x = [np.degrees(row["rotation"]) for row in rows[name]]
        y = [row["torque"] / (W * R) for row in rows[name]]
        ax.plot(x, y, style, label=f"by a {name}")
    ax.axhline(np.sin(np.arctan(MU)), color="k", lw=0.8, ls="--", label="sin φ")
    ax.set(xlabel="rotation (degrees)", ylabel="T / (W R)")
    ax.legend(frameon=False)
    folder.mkdir(parents=True, exist_ok=True)
    fig.savefig(folder / "bearing.png", dpi=100)
    plt.close(fig)


def main():
    """Turn it by torques, then by angles."""
    parser = argparse.ArgumentParser(description="A shaft is turned in a bearing.")
    parser.add_argument("--cells", type=int, default=54, help="along the bush")
    parser.add_argument("--steps", type=int, default=4, help="load steps to and in sliding")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="save a picture")
    args = parser.parse_args()
    comm, rows = MPI.COMM_WORLD, {"torque": [], "rotation": []}
    friction_circle = W * R * np.sin(np.arctan(MU))

    bearing = Bearing(comm, args.cells, held=())
    slides = None
    for share in (0.0, 0.5, 0.95, 1.05):
        progress.show(comm, f"torque {share:.2f} W R sin φ")
        bearing.shaft.torque = share * friction_circle
        try:
            rows["torque"].append(bearing.solve())
        except SolveError as error:
            slides = str(error)
    by_angle = Bearing(comm, args.cells, held="rotation")
    climb = CLEARANCE / R * np.arctan(MU)  # rotation that it rolls until it slides
    for step in range(args.steps + 1):
        progress.show(comm, f"rotation, step {step}")
        by_angle.shaft.prescribed[2] = 1.5 * climb * step / args.steps
        rows["rotation"].append(by_angle.solve())
    progress.show(comm)

    expected = [np.sin(row["alpha"]) * W * R for row in rows["torque"][1:]]
    rolls = max(
        abs(torque / row["torque"] - 1)
        for torque, row in zip(expected, rows["torque"][1:], strict=True)
    )
    error = rows["rotation"][-1]["torque"] / friction_circle - 1
    result = {
        **rows,
        "rolling_error": float(rolls),
        "friction_error": float(error),
        "slides": slides,
        "newton": [row["newton_steps"] for of in rows.values() for row in of],
    }
    if comm.rank == 0:
        print("    torque / (W R)   sin α   rotation   sticking  slipping")
        for row in (*rows["torque"], *rows["rotation"]):
            print(
                f"{row['torque'] / (W * R):14.4f}  {np.sin(row['alpha']):9.4f}"
                f"  {row['rotation']:9.5f}  {row['sticking']:8}  {row['slipping']:8}"
            )
        print(f"rolling: W R sin α is off by {rolls:.1e} of the torque")
        print(f"sliding: the torque is off by {error:.1e} of W R sin φ")
        print(f"5 % more: {slides}")
        if args.json:
            args.json.write_text(json.dumps(result))
        if args.plot:
            picture(rows, args.plot)


if __name__ == "__main__":
    main()
