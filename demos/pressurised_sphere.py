# # A pressurised sphere in two shells
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# The pressurised cylinder of Giffin (2024), section 3.2, in three dimensions. A hollow sphere under
# inner pressure is made of two shells with unstructured tetrahedra (or hexahedra in layers) that
# don't match, tied to each other where they meet. An eighth of it is modelled. The exact solution
# (Lamé) is known, so this demo shows
#
# - that a tie in three dimensions is written like one in the plane,
# - that displacements, stresses and the traction of the tie converge with the expected rates,
# - with `--fused`, what the tie costs in accuracy: nothing visible.

# +
import argparse
import json
import sys
import time
from contextlib import contextmanager
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Tie, TiedProblem, progress

# -

a, c, b = 1.0, 1.5, 2.0
E, nu, p = 1000.0, 0.3, 1.0
mu, lmbda = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def sigma(u):
    """Stress of a displacement."""
    eps = ufl.sym(ufl.grad(u))
    return 2 * mu * eps + lmbda * ufl.tr(eps) * ufl.Identity(3)


# The exact displacement is radial, $u = \frac{1}{E}\left[(1-2\nu) A r + (1+\nu) B/r^2\right]$, and
# the stress on a face with normal $e_r$ is $\sigma_{rr} = A - 2B/r^3$.

A = p * a**3 / (b**3 - a**3)
B = p * a**3 * b**3 / (2 * (b**3 - a**3))


def exact_displacement(x):
    """Lamé's solution at a UFL coordinate."""
    r = ufl.sqrt(ufl.dot(x, x))
    return ((1 - 2 * nu) * A + (1 + nu) * B / r**3) / E * x


# ## One level
#
# Two shells, a space and an elastic form on each. Cells have the size h in the inner shell and
# 1.25 h in the outer one; of hexahedra there are 4 along the interface on 3 of the outer shell.


def create_shells(comm, cell, h, degree, refinements):
    """The inner and the outer shell, and their facet tags."""
    if cell == "hexahedron":
        layers = hexahedra(h)
        return [meshes.spherical_layers(comm, n, radii, degree=degree) for n, radii in layers]
    options = {"degree": degree, "refinements": refinements}
    h *= 2**refinements
    return [
        meshes.spherical_shell(comm, h, a, c, **options),
        meshes.spherical_shell(comm, 1.25 * h, c, b, **options),
    ]


def hexahedra(h):
    """Of both shells, cells along the edges of an eighth's three patches, and the layers' radii."""
    m = max(round(0.4 / h), 1)
    return [(4 * m, np.linspace(a, c, 2 * m + 1)), (3 * m, np.linspace(c, b, 2 * m + 1))]


def elastic_body(mesh, ft, degree, pressure):
    """Space, forms and symmetry conditions of a shell under inner pressure."""
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    n, ds = ufl.FacetNormal(mesh), ufl.Measure("ds", mesh, subdomain_data=ft)
    form = ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx
    load = -fem.Constant(mesh, default_scalar_type(pressure)) * ufl.dot(n, v) * ds(meshes.INNER)
    bcs = []
    for component, tag in enumerate((meshes.PLANE_X, meshes.PLANE_Y, meshes.PLANE_Z)):
        dofs = fem.locate_dofs_topological(V.sub(component), 2, ft.find(tag))
        bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(component)))
    return V, form, load, bcs


def solve(shells, degree, swap, adjust, seconds):
    """Solve the tied problem; returns it, its tie and what took how long."""
    (inner, inner_tags), (outer, outer_tags) = shells
    V0, a0, L0, bcs0 = elastic_body(inner, inner_tags, degree, p)
    V1, a1, L1, bcs1 = elastic_body(outer, outer_tags, degree, 0.0)

    # The tie: the inner shell's outer facets with the outer shell's inner facets. The second one
    # carries the multipliers. Flat facets of different size gape and overlap on a sphere: moving
    # the nodes of Γ1 to where Γ0 is takes 3 % off the displacement's error for degree 1.
    sides = [(V0, inner_tags.find(meshes.OUTER)), (V1, outer_tags.find(meshes.INNER))]
    with stopwatch(seconds, "sigma"):
        tie = Tie(*(sides[::-1] if swap else sides), adjust=adjust)
    with stopwatch(seconds, "gap"):
        tie.blocks()
    with stopwatch(seconds, "assemble"):
        problem = TiedProblem([a0, a1], [L0, L1], bcs=bcs0 + bcs1, ties=[tie])
        problem.assemble_matrix()
        problem.assemble_vector()
    with stopwatch(seconds, "solve"):
        problem.solve_system()
    return problem, tie


# ## Errors
#
# Relative errors of the displacement and the stress over both shells, and of the traction λ on the
# gap domain Σ, where $\lambda = \sigma_{rr}(c)\, n$.


def relative_errors(us, degree):
    """Relative L² errors of displacement and stress."""
    totals = np.zeros(4)
    for u in us:
        u_exact = exact_displacement(ufl.SpatialCoordinate(u.function_space.mesh))
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 2})
        # The zero function's error is the exact field's norm, by the same form
        for j, f in enumerate((u, fem.Function(u.function_space))):
            for i, g in enumerate((f - u_exact, sigma(f) - sigma(u_exact))):
                totals[2 * i + j] += fem.assemble_scalar(fem.form(ufl.inner(g, g) * dx))
    error_u, norm_u, error_s, norm_s = us[0].function_space.mesh.comm.allreduce(totals)
    return np.sqrt(error_u / norm_u), np.sqrt(error_s / norm_s)


def traction_error(problem, tie, swap):
    """Relative L² error of λ on Σ."""
    q = tie.quadrature(6)
    r = np.linalg.norm(q.x, axis=-1, keepdims=True)
    exact = (A - 2 * B / c**3) * q.x / r * (-1 if swap else 1)
    error = q.evaluate(tie.traction(problem)) - exact
    return np.sqrt(q.integrate((error**2).sum(-1)) / q.integrate((exact**2).sum(-1)))


def surface_traction_errors(problem, tie, swap):
    """The same of the tractions on Γ0 and Γ1, recovered from the forces of λ."""
    errors = []
    for side in (0, 1):
        t = tie.traction(problem, on=f"side{side}")
        mesh = t.function_space.mesh  # of the surface
        x, dx = ufl.SpatialCoordinate(mesh), ufl.dx(metadata={"quadrature_degree": 6})
        outwards = 1 if (side == 0) != swap else -1  # the body's normal
        exact = (A - 2 * B / c**3) * outwards * x / ufl.sqrt(ufl.dot(x, x))
        errors_of = (f - exact for f in (t, fem.Function(t.function_space)))
        squares = [fem.assemble_scalar(fem.form(ufl.dot(e, e) * dx)) for e in errors_of]
        errors.append(np.sqrt(np.divide(*mesh.comm.allreduce(np.array(squares)))))
    return errors


@contextmanager
def stopwatch(seconds, name):
    """Seconds of a block, into a dictionary."""
    start = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - start


def run(comm, h, degree, swap, refinements=0, adjust=True, cell="tetrahedron"):
    """One row of the table, and what was solved."""
    seconds = {}
    with stopwatch(seconds, "mesh"):
        shells = create_shells(comm, cell, h, degree, refinements)
    problem, tie = solve(shells, degree, swap, adjust, seconds)
    l2, stress = relative_errors(problem.u, degree)
    row = {
        "degree": degree,
        "cell": cell,
        "swap": swap,
        "h": h,
        "refinements": refinements,
        "dofs": num_dofs(problem.u),
        "sigma_cells": tie.sigma.topology.index_map(3).size_global,
        "l2": float(l2),
        "stress": float(stress),
        "traction": float(traction_error(problem, tie, swap)),
        "surface_traction": [float(e) for e in surface_traction_errors(problem, tie, swap)],
        "seconds": seconds,
    }
    return row, problem, tie


def num_dofs(us):
    """Number of displacements."""
    dofmaps = [u.function_space.dofmap for u in us]
    return sum(dofmap.index_map.size_global * dofmap.index_map_bs for dofmap in dofmaps)


# ## One fused mesh
#
# For comparison: both shells in one mesh with the same cell sizes, and no tie.


def run_fused(comm, h, degree, cell="tetrahedron"):
    """Errors on the fused mesh; a problem without ties is an ordinary one."""
    if cell == "hexahedron":
        (n, inner), (_, outer) = hexahedra(h)
        mesh, ft = meshes.spherical_layers(comm, n, (*inner, *outer[1:]), degree=degree)
    else:
        mesh, ft = meshes.nested_shells(comm, (h, 1.25 * h), (a, c, b), degree=degree)
    _, form, load, bcs = elastic_body(mesh, ft, degree, p)
    u = TiedProblem([form], [load], bcs=bcs).solve()
    l2, stress = relative_errors(u, degree)
    return {"dofs": num_dofs(u), "l2": float(l2), "stress": float(stress)}


# ## The table


def print_table(rows):
    """Errors, rates and seconds of one degree."""
    row = rows[0]
    fused = "fused" in row
    print(
        f"\ndegree {row['degree']}, Γ1 is the {'inner' if row['swap'] else 'outer'} shell, "
        f"{'uniformly refined' if rows[-1]['refinements'] else 'regenerated'} meshes\n"
        "    h       dofs    L² displ.  rate    L² stress  rate    L² traction rate   "
        "on Γ0, on Γ1         seconds (Σ + gap)"
        + ("   fused: dofs, L² displ., stress" if fused else "")
    )
    for i, row in enumerate(rows):
        text = f"{row['h']:6.3f} {row['dofs']:>9d}"
        for name in ("l2", "stress", "traction"):
            rate = np.log2(rows[i - 1][name] / row[name]) if i else np.nan
            text += f"   {row[name]:.3e}  {rate:4.2f}" if i else f"   {row[name]:.3e}      "
        text += "   {:.2e}, {:.2e}".format(*row["surface_traction"])
        s = row["seconds"]
        text += f"   {sum(s.values()):7.2f}  ({s['sigma'] + s['gap']:.3f})"
        if fused:
            f = row["fused"]
            text += f"   {f['dofs']:>9d}   {f['l2']:.3e}  {f['stress']:.3e}"
        print(text, flush=True)


# ## Pictures
#
# The two shells and, between them, the gap domain Σ, all pulled apart; the traction.


def draw(comm, degree, swap, cell, folder):
    """Draw a coarse level."""
    from hypergap_dolfinx import plot

    _, problem, tie = run(comm, 0.3, degree, swap, cell=cell)
    plot.gap_domain([tie], folder / "gap_domain.png")
    plot.deformed(problem.u, folder / "deformed.png")
    plot.traction(tie, tie.traction(problem), folder / "traction.png")
    if comm.rank == 0:
        print(f"\npictures in {folder}/")


def main():
    """Sweep degrees and levels."""
    parser = argparse.ArgumentParser(description="A pressurised sphere in two tied shells.")
    parser.add_argument("--degree", type=int, choices=(1, 2), help="default: both")
    parser.add_argument("--cell", choices=("tetrahedron", "hexahedron"), default="tetrahedron")
    parser.add_argument("--levels", type=int, default=3)
    parser.add_argument("--swap", action="store_true", help="Γ1 on the inner shell")
    parser.add_argument("--refine", action="store_true", help="refine the coarsest meshes instead")
    parser.add_argument("--no-adjust", action="store_true", help="leave Γ1's nodes on the sphere")
    parser.add_argument("--fused", action="store_true", help="also solve on one mesh without a tie")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args()
    if args.refine and args.cell == "hexahedron":
        parser.error("--refine is for tetrahedra: layers of hexahedra are the same at all levels")
    comm = MPI.COMM_WORLD

    results = []
    for degree in (args.degree,) if args.degree else (1, 2):
        # Coarser than this, cells between faces on a sphere fold when they are refined
        coarsest = (0.15 if args.refine else 0.2) * degree
        run(
            comm, 2 * coarsest, degree, args.swap, cell=args.cell
        )  # compiles the forms, so that no level has to
        rows = []
        for level in range(args.levels):
            progress.show(comm, f"degree {degree}, level {level + 1} of {args.levels}")
            h = coarsest / 2**level
            refinements = level if args.refine else 0
            row, *_ = run(comm, h, degree, args.swap, refinements, not args.no_adjust, args.cell)
            row["level"] = level
            if args.fused:
                row["fused"] = run_fused(comm, h, degree, args.cell)
            rows.append(row)
        progress.show(comm)
        if comm.rank == 0:
            print_table(rows)
        results += rows
    if args.json and comm.rank == 0:
        args.json.write_text(json.dumps(results, indent=1))
    if args.plot:
        draw(comm, args.degree or 2, args.swap, args.cell, args.plot)


if __name__ == "__main__":
    main()
