# # Eight CAD assemblies
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# A flange with gasket and bolts, a shaft with key and hub, a sandwich with an insert, a pipe
# through a wall, a hinge, a dovetail, three tubes, a ball in a socket: each is built with Gmsh's
# OpenCASCADE kernel, meshed part by part, and tied where `find_touching` finds that parts touch.
# Their displacements are compared with those on one mesh of all parts, with cells of the same
# sizes: both against a finer mesh of all parts, of degree 2.
#
#     python demos/cad_assemblies.py --degree 2 --only hinge

# +
import argparse
import json
import sys
import traceback
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
from demos.assembly import integral, stress
from hypergap_dolfinx import Tie, TiedProblem, find_touching, progress
from meshes.assemblies import ASSEMBLIES
from meshes.cad import fused_assembly, parts_of_assembly

# -

comm = MPI.COMM_WORLD
SOFT = {"gasket": 0.1, "core": 0.02}
"""Young's modulus of soft parts over that of the others."""
FORCE = (0.3, 0.5, -1.0)

# The first part is held where x is smallest. The last one is loaded by a volume force.


def held(V, cells=slice(None)):
    """The face of the first part, some cells of a mesh, where x is least."""
    own = np.unique(V.dofmap.list[cells])
    low = comm.allreduce(V.tabulate_dof_coordinates()[own, 0].min(initial=np.inf), MPI.MIN)
    dofs = np.intersect1d(own, fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], low)))
    return fem.dirichletbc(np.zeros(3, dtype=default_scalar_type), dofs, V)


def forms(V, E, dx_loaded):
    """Both forms of a body; without a load if it has no loaded part."""
    E = fem.Constant(V.mesh, default_scalar_type(E)) if isinstance(E, float) else E
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = ufl.inner(stress(u, E, 0.3), ufl.sym(ufl.grad(v))) * ufl.dx
    if dx_loaded is None:
        return a, None
    one = fem.Constant(V.mesh, default_scalar_type(1))
    density = np.array(FORCE, dtype=default_scalar_type) / integral(one * dx_loaded)
    return a, ufl.inner(fem.Constant(V.mesh, density), v) * dx_loaded


def means(us, measures):
    """Volume and mean displacement of each part, ``(num_parts, 4)``."""
    rows = []
    for u, dx in zip(us, measures, strict=True):
        volume = integral(fem.Constant(u.function_space.mesh, default_scalar_type(1)) * dx)
        rows.append([volume, *(integral(u[i] * dx) / volume for i in range(3))])
    return np.array(rows)


def tied(build, factor, degree, imprinted):
    """Mean displacements of parts that are tied, and numbers of displacements and of ties."""
    parts = parts_of_assembly(comm, build, factor, degree=degree, imprinted=imprinted)
    V = [fem.functionspace(mesh, ("Lagrange", degree, (3,))) for _, mesh in parts]
    E = [SOFT.get(name, 1.0) for name, _ in parts]
    measures = [ufl.Measure("dx", W.mesh) for W in V]
    loaded = [None] * (len(V) - 1) + measures[-1:]
    a, L = zip(*(forms(*given) for given in zip(V, E, loaded, strict=True)), strict=True)
    ties = [
        Tie.between(*sides, stiffness=tuple(E[V.index(W)] for W, _ in sides))
        for sides in find_touching(V)
    ]
    us = TiedProblem(a, L, bcs=[held(V[0])], ties=ties).solve()
    num = 3 * sum(W.dofmap.index_map.size_global for W in V)
    return means(us, measures), num, len(ties)


def fused(build, factor, degree):
    """Mean displacements of parts on one mesh, and the number of displacements."""
    names, mesh, part = fused_assembly(comm, build, factor, degree=degree)
    V, Q = (fem.functionspace(mesh, e) for e in (("Lagrange", degree, (3,)), ("DG", 0)))
    E = fem.Function(Q)
    for i, name in enumerate(names):
        E.x.array[part.find(i)] = SOFT.get(name, 1.0)
    dx = ufl.Measure("dx", mesh, subdomain_data=part)
    measures = [dx(i) for i in range(len(names))]
    a, L = forms(V, E, measures[-1])
    (u,) = TiedProblem([a], [L], bcs=[held(V, part.find(0))]).solve()
    return means([u] * len(names), measures), 3 * V.dofmap.index_map.size_global


def off(rows, reference):
    """Distance of mean displacements from a reference, over these, weighted by volumes."""
    weights, exact = reference[:, :1], reference[:, 1:]
    square = (weights * (rows[:, 1:] - exact) ** 2).sum()
    return float(np.sqrt(square / (weights * exact**2).sum()))


# ## What comes out
#
# Both meshes approximate circles by polygons, so both also have an error of shape.


def run(name, factor, degree, fine, imprinted):
    """One row of the table."""
    row = {"scene": name, "degree": degree, "size": factor}
    build = ASSEMBLIES[name]
    try:
        rows, row["dofs"], row["ties"] = tied(build, factor, degree, imprinted)
    except Exception as error:  # told in the row, the next scene goes on
        return row | {"failed": traceback.format_exception_only(error)[-1].strip()}
    one, row["fused dofs"] = fused(build, factor, degree)
    reference, row["fine dofs"] = fused(build, fine, 2)
    row["error"], row["fused"] = off(rows, reference), off(one, reference)
    return row | {"ratio": row["error"] / row["fused"]}


def picture(names, factor, file):
    """The parts of some assemblies, each in a colour. Collective."""
    drawn = {name: parts_of_assembly(comm, ASSEMBLIES[name], factor) for name in names}
    from hypergap_dolfinx import plot

    cells = {name: [plot.grid(mesh) for _, mesh in parts] for name, parts in drawn.items()}
    if comm.rank > 0:
        return
    import pyvista

    across = min(4, len(names))
    shape = -(-len(names) // across), across
    size = [400 * shape[1], 400 * shape[0]]
    plotter = pyvista.Plotter(off_screen=True, shape=shape, window_size=size, border=False)
    colours = ("#4477aa", "#ee6677", "#ccbb44", "#228833", "#66ccee", "#aa3377", "#bbbbbb")
    for k, parts in enumerate(cells.values()):
        plotter.subplot(*divmod(k, across))
        for i, part in enumerate(parts):
            look = {"color": colours[i % len(colours)], "ambient": 0.35}
            plotter.add_mesh(part, show_edges=True, edge_opacity=0.4, **look)
        plotter.view_vector((1.2, -1, 0.9))
    plotter.background_color = "white"
    file.parent.mkdir(parents=True, exist_ok=True)
    plotter.screenshot(file)


def main():
    """All assemblies, or one."""
    parser = argparse.ArgumentParser(description="Eight CAD assemblies, tied and fused.")
    parser.add_argument("--only", choices=ASSEMBLIES, help="one of them")
    parser.add_argument("--degree", type=int, choices=(1, 2), nargs="+", default=[1, 2])
    parser.add_argument("--size", type=float, default=1.2, help="of cells over a part's thickness")
    parser.add_argument("--fine", type=float, default=0.8, help="that of the reference")
    parser.add_argument(
        "--imprinted", action="store_true", help="facets of each part end where other parts do"
    )
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument(
        "--plot", type=Path, metavar="DIR", help="save a picture of the parts, and do nothing else"
    )
    args = parser.parse_args()
    rows, names = [], [args.only] if args.only else list(ASSEMBLIES)
    if args.plot:
        return picture(names, args.size, args.plot / "cad_assemblies.png")
    for name in names:
        for degree in args.degree:
            progress.show(comm, f"{name}, degree {degree}")
            row = run(name, args.size, degree, args.fine, args.imprinted)
            rows.append(row)
            progress.show(comm)
            if comm.rank == 0:
                text = row.get("failed") or (
                    f"{row['ties']:2} ties, {row['dofs']:6} displacements: {row['error']:.2e} off; "
                    f"fused, {row['fused dofs']:6}: {row['fused']:.2e}; ratio {row['ratio']:.2f}"
                )
                print(f"{name:18} degree {degree}: {text}", flush=True)
    if args.json and comm.rank == 0:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
