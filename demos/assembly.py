# # An assembly from a CAD file
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# AS1 is the assembly that CAD programs are tested with: a plate, two brackets, a rod, and six bolts
# and eight nuts that hold them together. Its 18 parts come from a STEP file (Gmsh's wheel has it).
# This demo shows
#
# - parts that are meshed one by one, each with its own cell size and material,
# - that you needn't name the interfaces: `find_touching` finds the 32 pairs. Their surfaces overlap
#   in part, have holes, or share a cylinder with a third part,
# - with `--fused`, the same on one conforming mesh of all parts.

# +
import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx import mesh as dmesh

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
from demos.error_against_run_time import forget_peak, memory
from hypergap_dolfinx import Tie, TiedProblem, find_touching, progress
from meshes.cad import fused_assembly, parts_of_assembly

# -

FILE = Path(sys.prefix) / "share/doc/gmsh/examples/boolean/as1-tu-203.stp"
comm = MPI.COMM_WORLD

# Units are newtons and millimetres. The plate and the brackets are aluminium, the other parts
# steel. The plate is held at both sides; the rod is pushed down and sideways.

ALUMINIUM, STEEL = (70e3, 0.33), (210e3, 0.3)
MATERIALS = {"plate": ALUMINIUM, "l-bracket": ALUMINIUM, "rod": STEEL, "bolt": STEEL, "nut": STEEL}
FORCE = (0.0, 400.0, -1000.0)
COLOURS = {
    "plate": "lightsteelblue",
    "l-bracket": "goldenrod",
    "rod": "firebrick",
    "bolt": "dimgray",
    "nut": "mediumseagreen",
}


@dataclass
class Model:
    """The forms of the bodies; the tied assembly has 18, the fused one has one."""

    a: list
    L: list
    bcs: list
    plate: int
    """Number of the plate's body."""
    rod: int
    """Number of the rod's."""
    dx: ufl.Measure
    """Integrates over the rod."""


def stress(u, E, nu):
    """Stress of a displacement."""
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(3))


def stiffness(V, E, nu):
    """Bilinear form of a body."""
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    return ufl.inner(stress(u, E, nu), ufl.sym(ufl.grad(v))) * ufl.dx


def load(V, dx):
    """The force on the rod, spread over its volume."""
    one = fem.Constant(V.mesh, default_scalar_type(1))
    density = np.array(FORCE, dtype=default_scalar_type) / integral(one * dx)
    return ufl.inner(fem.Constant(V.mesh, density), ufl.TestFunction(V)) * dx


def held(V):
    """The plate's sides, of 150 mm distance; no facet that is tied comes near them."""

    def on_side(x):
        return np.isclose(x[1], 0, atol=1e-6) | np.isclose(x[1], 150)

    dofs = fem.locate_dofs_topological(V, 2, dmesh.locate_entities_boundary(V.mesh, 2, on_side))
    return fem.dirichletbc(np.zeros(3, dtype=default_scalar_type), dofs, V)


def integral(form):
    """A number from a form, over all ranks."""
    return comm.allreduce(fem.assemble_scalar(fem.form(form)))


# ## Tied
#
# Each part has a form, and each pair a tie. The side with the larger cells is Γ1; where cells are
# alike, the softer one.


def tied(factor, degree, geometry):
    """The assembly's parts, each with a mesh of its own."""
    parts = parts_of_assembly(comm, FILE, factor, degree=geometry)
    names = [name for name, _ in parts]
    V = [fem.functionspace(mesh, ("Lagrange", degree, (3,))) for _, mesh in parts]
    a = []
    for name, W in zip(names, V, strict=True):
        constants = (fem.Constant(W.mesh, default_scalar_type(c)) for c in MATERIALS[name])
        a.append(stiffness(W, *constants))  # constants: one kernel for all parts
    plate, rod = names.index("plate"), names.index("rod")
    dx = ufl.Measure("dx", V[rod].mesh)
    L = [load(W, dx) if i == rod else None for i, W in enumerate(V)]
    return Model(a, L, [held(V[plate])], plate, rod, dx), V, names


def make_ties(V, names):
    """Ties between all that touch."""
    moduli = [MATERIALS[name][0] for name in names]
    return [
        Tie.between(*sides, stiffness=tuple(moduli[V.index(W)] for W, _ in sides))
        for sides in find_touching(V)
    ]


# ## Fused
#
# For one mesh Gmsh first cuts all faces along each other. Where parts meet, cells have the mean of
# their sizes; with the smaller one the plate would have 2.5 times its own number of nodes. The
# materials are functions on the mesh.


def fused(factor, degree, geometry):
    """The assembly in one mesh."""
    names, mesh, part = fused_assembly(comm, FILE, factor, degree=geometry)
    V, Q = (fem.functionspace(mesh, e) for e in (("Lagrange", degree, (3,)), ("DG", 0)))
    E, nu = fem.Function(Q), fem.Function(Q)
    for i, name in enumerate(names):
        E.x.array[part.find(i)], nu.x.array[part.find(i)] = MATERIALS[name]
    dx = ufl.Measure("dx", mesh, subdomain_data=part)(names.index("rod"))
    return Model([stiffness(V, E, nu)], [load(V, dx)], [held(V)], 0, 0, dx), [V], []


# ## What comes out
#
# The difference between tied and fused decreases with the cell size: displacement and energy differ
# by 1.1 % and 0.4 % with `--fused --size 1 0.7`, by 0.6 % with `--fused --degree 2 --size 1.4`.
#
# The ties form closed loops of parts, which the solver `"bodies"` doesn't take. With 40 851
# displacements of degree 1, `--solver iterative` takes 0.2 GB instead of a factorisation's 0.4 GB.
#
# The reactions are the residuals at the plate's sides. They balance the load if each tie transmits
# its force exactly.


def balance(model, us):
    """What is left of all forces, over the load."""
    u, a, L = us[model.plate], model.a[model.plate], model.L[model.plate]
    dofs, _ = model.bcs[0].dof_indices()
    moved, reaction = fem.Function(u.function_space), []
    for i in range(3):
        moved.x.array[:] = 0
        moved.x.array[dofs[dofs % 3 == i]] = 1
        work = integral(ufl.action(ufl.action(a, u), moved))
        reaction.append(work if L is None else work - integral(ufl.action(L, moved)))
    return float(np.linalg.norm(np.add(reaction, FORCE)) / np.linalg.norm(FORCE))


def run(make, factor, degree, geometry, solver):
    """One row of the table, the displacements, and the parts' names."""
    times = [time.perf_counter()]
    model, V, names = make(factor, degree, geometry)
    times.append(time.perf_counter())
    forget_peak()
    before = memory("VmRSS")
    ties = make_ties(V, names) if names else []
    times.append(time.perf_counter())
    us = TiedProblem(model.a, model.L, bcs=model.bcs, ties=ties, solver=solver).solve()
    times.append(time.perf_counter())
    peak = comm.allreduce(max(memory("VmHWM") - before, 0))

    work = sum(integral(ufl.action(ufl.action(a, u), u)) for a, u in zip(model.a, us, strict=True))
    one = fem.Constant(V[model.rod].mesh, default_scalar_type(1))
    mean = [integral(us[model.rod][i] * model.dx) / integral(one * model.dx) for i in range(3)]
    row = {
        "degree": degree,
        "size": factor,
        "dofs": 3 * sum(W.dofmap.index_map.size_global for W in V),
        "ties": len(ties),
        "balance": balance(model, us),
        "displacement": float(np.linalg.norm(mean)),
        "energy": work / 2,
        "seconds": dict(zip(("mesh", "ties", "solve"), np.diff(times).tolist(), strict=True)),
        "memory": peak,
    }
    return row, us, names


def print_row(row, name):
    """A line of the table."""
    s = row["seconds"]
    print(
        f"{row['degree']}  {row['size']:5.2f}  {name:5} {row['dofs']:>8}  {row['ties']:>4}   "
        f"{row['balance']:.0e}    {row['displacement']:.5e}   {row['energy']:.5e}   "
        f"{s['mesh']:5.1f} {s['ties']:5.1f} {s['solve']:6.1f}   {row['memory'] / 1e6:6.0f}",
        flush=True,
    )


def draw(us, names, folder):
    """The assembly as it is, in a colour for each kind of part, and deformed."""
    import pyvista

    from hypergap_dolfinx import plot

    plot.deformed(us, folder / "deformed.png")
    grids = [plot.grid(u.function_space.mesh) for u in us]
    if comm.rank == 0:
        plotter = pyvista.Plotter(off_screen=True, window_size=[1200, 900])
        plotter.background_color = "white"
        for cells, name in zip(grids, names, strict=True):
            edges = {"show_edges": True, "edge_color": "black", "edge_opacity": 0.35}
            plotter.add_mesh(cells, color=COLOURS[name], ambient=0.35, **edges)
        legend = {"bcolor": None, "face": "rectangle", "size": (0.15, 0.2), "loc": "upper left"}
        plotter.add_legend([*COLOURS.items()], **legend)
        plotter.view_vector((1.2, 0.7, 0.7))
        plotter.camera.zoom(1.15)
        plotter.screenshot(folder / "assembly.png")
    if comm.rank == 0:
        print(f"\npictures in {folder}/")


def main():
    """Levels of cell sizes, tied and fused."""
    parser = argparse.ArgumentParser(description="The AS1 assembly, 18 parts tied to each other.")
    parser.add_argument("--degree", type=int, choices=(1, 2), default=1)
    parser.add_argument("--size", type=float, nargs="+", default=[1.0], metavar="FACTOR",
                        help="cell sizes over the parts' thicknesses")  # fmt: skip
    parser.add_argument("--fused", action="store_true", help="also on one mesh of all parts")
    parser.add_argument("--curved", action="store_true", help="cells of degree 2 are curved")
    parser.add_argument("--solver", choices=("direct", "iterative"), default="direct")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args()
    if not FILE.exists():
        if comm.rank == 0:
            print(f"left out: {FILE}, which Gmsh's wheel has, is missing")
        return

    geometry = args.degree if args.curved else 1
    rows = []
    if comm.rank == 0:
        print(
            "degree, size           dofs  ties  balance  displacement  strain energy   "
            "seconds: mesh, ties, solve   MB"
        )
    for factor in args.size:
        progress.show(comm, f"size {factor}")
        row, us, names = run(tied, factor, args.degree, geometry, args.solver)
        progress.show(comm)
        if comm.rank == 0:
            print_row(row, "tied")
        if args.fused:
            row["fused"], *_ = run(fused, factor, args.degree, geometry, None)
            if comm.rank == 0:
                print_row(row["fused"], "fused")
        rows.append(row)
    if args.json and comm.rank == 0:
        args.json.write_text(json.dumps(rows, indent=1))
    if args.plot:
        draw(us, names, args.plot)


if __name__ == "__main__":
    main()
