# # A bolted assembly: contact, friction and tightened bolts
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# In `assembly` the 18 parts of AS1 are tied wherever they touch. Here they are bolted: nuts are
# tied to their threads, and faces that touch are in contact with friction. The CAD file draws bolts
# and rod as wide as their holes, but here they have clearance. So friction alone holds the
# brackets, and the rod between them. This demo shows
#
# - how `find_touching` and the names of the parts tell contacts, ties and free surfaces apart,
# - how to tighten a bolt: it is cut in two, and a tie with a jump pulls the halves together,
# - 16 contacts with friction between 18 parts, 17 of which only contact holds,
# - where brackets part from the plate and where they slip.

# +
import argparse
import json
import sys
import time
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem, la
from dolfinx import mesh as dmesh
from dolfinx.plot import vtk_mesh

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
from demos.assembly import FILE, MATERIALS, held, integral, stiffness, stress
from hypergap_dolfinx import Contact, ContactProblem, Tie, files, find_touching, progress
from meshes.cad import parts_of_assembly

# -

# Units are newtons and millimetres, as in `assembly`. Bolts and the rod are cut at half their
# length, and a slice is removed there. The load acts on the rod, which friction alone holds.

AXIS = {"bolt": 2, "rod": 0}
SLICE = {"bolt": 0.05, "rod": 0.4}
FORCE = np.array((0.0, 600.0, -1500.0))
TOP = 30.0  # of the brackets' feet
GRIP, SHANK, HEAD = 30.0, 10.0, 15.0  # of a bolt: what it holds, and its diameters
comm = MPI.COMM_WORLD


class Part:
    """A part of the assembly, or half of one."""

    def __init__(self, name, mesh):
        """Make its form; with constants it is the same for all parts, and compiled once."""
        self.name, self.V = name, fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        self.constants = [fem.Constant(mesh, default_scalar_type(c)) for c in MATERIALS[name]]
        self.load = fem.Constant(mesh, np.zeros(3, dtype=default_scalar_type))
        self.u, v = fem.Function(self.V), ufl.TestFunction(self.V)
        self.a = stiffness(self.V, *self.constants)
        self.F = ufl.action(self.a, self.u) - ufl.inner(self.load, v) * ufl.dx


# ## What touches
#
# The names of two parts decide. The halves of a bolt are tied with a jump: the displacement of the
# upper half minus that of the lower one. Between a bolt and a bracket, the face under the head is
# in contact. All other pairs are shanks in holes, and free.

CONTACTS = {
    frozenset(("l-bracket", "plate")): "foot",
    frozenset(("bolt", "l-bracket")): "head",
    frozenset(("nut", "plate")): "nut",
    frozenset(("nut", "l-bracket")): "rod's nut",
}


def interfaces(parts, friction, jumps):
    """Contacts by their kind, and ties."""
    contacts = {kind: [] for kind in CONTACTS.values()}
    ties = []
    for sides in find_touching([part.V for part in parts]):
        names = [next(part.name for part in parts if part.V is V) for V, _ in sides]
        moduli = {"stiffness": tuple(MATERIALS[name][0] for name in names)}
        kind = CONTACTS.get(frozenset(names))
        if names[0] == names[1]:
            ties.append(Tie.between(*sides, jump=jumps[names[0]]))
        elif "nut" in names and not kind:
            ties.append(Tie.between(*sides, **moduli))
        elif kind:
            if kind == "head":
                sides = [(V, facets[at_top(V.mesh, facets)]) for V, facets in sides]
            friction_of = {"friction": friction, "sliding": "small"}
            contacts[kind].append(Contact.between(*sides, **moduli, **friction_of))
    return contacts, ties


def at_top(mesh, facets):
    """Which facets are in the plane of the feet's top."""
    return np.isclose(dmesh.compute_midpoints(mesh, 2, facets)[:, 2], TOP)


# ## Load steps
#
# First everything is tightened, then the rod is loaded. Friction depends on the path, so both at
# once would give another result. A part that only contact holds must be pressed in the first load
# step: a loose rod without weight has no definite place.


def run(args):
    """A row for each load step, the parts and the contacts."""
    progress.show(comm, "meshes")
    found = parts_of_assembly(comm, FILE, args.size, cut=AXIS)
    parts = [Part(name, mesh) for name, mesh in found]
    rod = [part for part in parts if part.name == "rod"]
    volume = sum(integral(fem.Constant(p.V.mesh, default_scalar_type(1)) * ufl.dx) for p in rod)
    progress.show(comm, "interfaces")
    jumps = {name: np.zeros(3) for name in AXIS}
    contacts, ties = interfaces(parts, args.friction, jumps)
    plate = next(part for part in parts if part.name == "plate")
    bc, reactions = held(plate.V), fem.form(plate.F)
    problem = ContactProblem(
        [part.F for part in parts],
        [part.u for part in parts],
        J=[part.a for part in parts],
        bcs=[bc],
        contacts=[contact for several in contacts.values() for contact in several],
        ties=ties,
        rtol=1e-10,
    )
    rows = []
    shares = [(k + 1) / args.steps for k in range(args.steps)]
    for name, axis in AXIS.items():  # after the problem was made: it starts with what is there then
        jumps[name][axis] = -SLICE[name]
    for share in (0, *shares):
        force = share * FORCE
        for part in rod:
            part.load.value[:] = force / volume
        start = time.process_time()
        problem.solve()
        spent = time.process_time() - start
        left = np.linalg.norm(reaction(reactions, bc) + force) / np.linalg.norm(FORCE)
        along = {
            kind: [float(abs(contact.force(problem)[axis])) for contact in contacts[kind]]
            for kind, axis in (("head", 2), ("nut", 2), ("rod's nut", 0))
        }
        row = {
            "load": float(np.linalg.norm(force)),
            "newton": problem.iterations,
            "halvings": problem.halvings,
            "balance": float(left),
            "forces": along,
            "over_estimate": float(np.mean(along["head"]) / estimate()),
            "zones": {kind: zones(several) for kind, several in contacts.items()},
            "seconds": spent,
        }
        rows.append(row)
        print_row(row)
    return rows, parts, contacts, problem


def reaction(form, bc):
    """The force of the supports: what the plate's form leaves there."""
    b = fem.assemble_vector(form)
    b.scatter_reverse(la.InsertMode.add)
    dofs, num_owned = bc.dof_indices()
    dofs = dofs[:num_owned]
    return comm.allreduce(np.bincount(dofs % 3, b.array[dofs], 3))


def estimate():
    """Force of a bolt by the textbook: springs for its shank and for a cone of 30° beside it."""
    (soft, _), (hard, _) = MATERIALS["plate"], MATERIALS["bolt"]
    wide = GRIP * np.tan(np.pi / 6)
    ratio = (wide + HEAD - SHANK) * (HEAD + SHANK) / (wide + HEAD + SHANK) / (HEAD - SHANK)
    cone = np.pi * np.tan(np.pi / 6) * soft * SHANK / (2 * np.log(ratio))
    shank = hard * np.pi * SHANK**2 / 4 / GRIP
    return SLICE["bolt"] / (1 / shank + 1 / cone)


def zones(contacts):
    """Shares of the area of contacts that part, slip and stick."""
    area = np.concatenate([contact.rows.m for contact in contacts])
    parts = {
        "parted": np.concatenate([~contact.active for contact in contacts]),
        "slips": np.concatenate([contact.slipping for contact in contacts]),
        "sticks": np.concatenate([contact.sticking for contact in contacts]),
    }
    return {name: float(area[which].sum() / area.sum()) for name, which in parts.items()}


def print_row(row):
    """A line of the table."""
    forces, foot = row["forces"], row["zones"]["foot"]
    bolts = f"{min(forces['head']) / 1e3:5.2f} … {max(forces['head']) / 1e3:5.2f}"
    if comm.rank == 0:
        print(
            f"{row['load']:8.0f} {row['newton']:6}  {row['balance']:8.0e}   {bolts}"
            f"  {np.mean(forces["rod's nut"]) / 1e3:5.2f}     "
            f"{foot['parted']:4.0%} {foot['slips']:5.0%} {foot['sticks']:5.0%}  "
            f"{row['seconds']:7.1f}",
            flush=True,
        )


# ## Pictures
#
# One picture shows the pressure of the brackets' feet on the plate, and where they stick and slip.
# The other is a section through two bolts and the rod, with the stress along the bolts and
# magnified displacements.


def section(part, y):
    """A section across y: positions before and after, triangles, and σ_zz; rank 0 gets all."""
    import pyvista

    mesh = part.V.mesh
    owned = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    sigma = files.interpolated(stress(part.u, *part.constants)[2, 2], mesh, 0, "stress")
    grid = pyvista.UnstructuredGrid(*vtk_mesh(part.V, owned))
    grid["u"] = part.u.x.array.reshape(-1, 3)[: grid.n_points]
    grid["stress"] = sigma.x.array[: len(owned)]
    cut = grid.slice(normal="y", origin=(0, y, 0)).triangulate()
    if not cut.n_cells:
        return comm.gather(None)
    return comm.gather((cut.points, cut["u"], cut.faces.reshape(-1, 4)[:, 1:], cut["stress"]))


def draw(parts, contacts, problem, file):
    """Zones of contact, and a section through the bolts."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    pressures = [contact.pressures(problem) for contact in contacts["foot"]]
    sections = [section(part, 75.01) for part in parts]  # where nothing has a node
    if comm.rank:
        return
    fig, (left, right) = plt.subplots(1, 2, figsize=(13, 4.2), layout="constrained")
    for contact, p in zip(contacts["foot"], pressures, strict=True):
        surface = contact.surfaces[1]
        x, y, _ = surface.x.T
        style = {"cmap": "Blues", "vmin": 0, "vmax": max(part.max() for part in pressures)}
        image = left.tripcolor(x, y, surface.facets, p, shading="gouraud", **style)
        for which, colour in ((contact.sticking, "C2"), (contact.slipping, "C3")):
            left.plot(x[which], y[which], "o", color=colour, ms=4)
        parted = ~contact.active & contact.rows.valid
        left.plot(x[parted], y[parted], "o", mfc="none", color="0.6", ms=4)
    for colour, name in (("C2", "sticks"), ("C3", "slips")):
        left.plot([], [], "o", color=colour, label=name)
    left.plot([], [], "o", mfc="none", color="0.6", label="parted")
    left.legend(loc="center")
    fig.colorbar(image, ax=left, label="pressure of the feet [MPa]", shrink=0.6)
    largest = max(np.abs(part.u.x.array).max() for part in parts)
    factor = 8 / largest
    for pieces in sections:
        for x, u, triangles, values in filter(None, pieces):
            now = x + factor * u
            style = {"cmap": "coolwarm", "clim": (-200, 200)}
            image = right.tripcolor(now[:, 0], now[:, 2], triangles, values, **style)
    fig.colorbar(image, ax=right, label="σ_zz [MPa]", shrink=0.6)
    right.set_title(f"y = 75 mm, displacements × {factor:.0f}")
    for axes in (left, right):
        axes.set(aspect="equal", xlabel="x")
    left.set(ylabel="y")
    right.set(ylabel="z")
    file.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(file, dpi=110)
    print(f"\npicture in {file}")


def main():
    """Tighten the bolts and the rod, then load it."""
    parser = argparse.ArgumentParser(description="AS1 with contact, friction and tightened bolts.")
    parser.add_argument("--size", type=float, default=2.0, metavar="FACTOR",
                        help="cell sizes over the parts' thicknesses")  # fmt: skip
    parser.add_argument("--friction", type=float, default=0.2)
    parser.add_argument("--steps", type=int, default=3, help="load steps of the force on the rod")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args()
    if not FILE.exists():
        if comm.rank == 0:
            print(f"left out: {FILE}, which Gmsh's wheel has, is missing")
        return
    if comm.rank == 0:
        print("load [N] Newton   balance   bolts [kN]      rod     feet part, slip, stick  seconds")
    rows, parts, contacts, problem = run(args)
    progress.show(comm)
    if args.json and comm.rank == 0:
        args.json.write_text(json.dumps({"rows": rows}, indent=1))
    if args.plot:
        draw(parts, contacts, problem, args.plot / "bolted_assembly.png")


if __name__ == "__main__":
    main()
