# # Press-fit: a ring is pushed over a shaft's conical lead
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Large deformation, friction and finite sliding. The shaft is slightly thicker than the hole of the
# ring. Its end is a cone, the lead, which is slightly thinner than the hole. Both are bodies of
# revolution: forms are integrated with r dr dz in the plane (r, z), and the contact is
# `axisymmetric`. In the middle of the ring the pressure is nearly Lamé's for two long cylinders. It
# differs by the effect of the ends, by finite strain, and by friction, which shortens the ring and
# the shaft. When the whole surface slips, the pushing force is the coefficient of friction times
# the force of the pressures, apart from the slope of the bulged surface.

# +
import argparse
import json
from pathlib import Path

from mpi4py import MPI

import numpy as np
from slender_contact import NU, Body, Scene, slab

import meshes
from hypergap_dolfinx import Contact

# -

INNER, FIT, OUTER = 0.5, 1.0, 1.6  # radii of the shaft's hole, of the ring's, of the ring
LEAD = 0.25  # length of the shaft's lead
LONGER = 2.0  # by how much the shaft is longer than the ring
APART = 0.1  # distance of the ring from the shaft's end at first


def press_fit(comm, friction, over, length, steps, fine=1):
    """The scene.

    Args:
        comm: Communicator.
        friction: Its coefficient.
        over: By how much the shaft's radius is larger than the ring's.
        length: Of the ring.
        steps: Number of load steps.
        fine: Number of cells where there is one else.
    """
    top = length + LONGER

    def place(s):
        z = top * s[:, 1]
        r = FIT + over * (1 - 2 * np.clip((z - top + LEAD) / LEAD, 0, 1))
        return np.column_stack((INNER + (r - INNER) * s[:, 0], z))

    low, travel = top + APART, length + 1.0 + APART
    cells = (5 * fine, round(10 * top * fine)), (5 * fine, round(9 * length * fine))
    shaft = Body(comm, cells[0], place, axisymmetric=True)
    ring = Body(comm, cells[1], slab((FIT, low), (OUTER, low + length)), axisymmetric=True)
    shaft.hold_along(1, meshes.BOTTOM)
    ring.hold_along(1, meshes.TOP, lambda s: -travel * s)
    sides = shaft.side(meshes.RIGHT), ring.side(meshes.LEFT)
    contact = Contact(*sides, friction=friction or None, axisymmetric="radian")
    return Scene(steps, [shaft, ring], [contact])


def lame(over):
    """Lamé's pressure of two long cylinders, E = 1."""
    a, b, c = INNER, OUTER, FIT
    stiff = (b**2 + c**2) / (b**2 - c**2) + NU, (c**2 + a**2) / (c**2 - a**2) - NU
    return over / (c * sum(stiff))


def in_the_middle(scene):
    """Pressure in the ring's middle fifth."""
    contact = scene.contacts[0]
    z = contact.displaced(scene.problem)[1].x[:, 1]
    middle = np.abs(z - (z.max() + z.min()) / 2) < 0.1 * np.ptp(z)
    return contact.pressures(scene.problem)[middle].mean()


def main():
    """Push it."""
    parser = argparse.ArgumentParser(description="A ring is pushed over a shaft.")
    parser.add_argument("--friction", type=float, default=0.2, metavar="μ")
    parser.add_argument("--over", type=float, default=0.02, help="half the difference of diameters")
    parser.add_argument("--length", type=float, default=3.0, help="of the ring")
    parser.add_argument("--steps", type=int, default=12, help="load steps")
    parser.add_argument("--fine", type=int, default=2, help="cells where there is one else")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="save a picture")
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    scene = press_fit(comm, args.friction, args.over, args.length, args.steps, args.fine)
    result = scene.go(args.steps, "press_fit")
    if not result["error"]:
        across, along = scene.contacts[0].force(scene.problem)
        result["pressure"] = float(in_the_middle(scene) / lame(args.over))
        result["friction"] = float(abs(along / across))
    if comm.rank == 0:
        print(f"Newton steps: {' '.join(map(str, result['each']))}, halvings {result['halvings']}")
        if result["error"]:
            print(result["error"])
        else:
            print(f"pressure in the middle over Lamé's: {result['pressure']:.4f}")
            print(f"force over that of the pressures: {result['friction']:.5f}")
        if args.json:
            args.json.write_text(json.dumps(result, indent=1))
    if args.plot:
        from hypergap_dolfinx import plot

        plot.contact(scene.contacts[0], scene.problem, args.plot / "press_fit.png")


if __name__ == "__main__":
    main()
