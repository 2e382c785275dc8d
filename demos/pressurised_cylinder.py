# # A pressurised cylinder in two rings
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Section 3.2 of Giffin (2024). A long cylinder under inner pressure is made of two rings whose
# meshes don't match, tied to each other where they meet. A quarter of it is modelled, in plane
# strain. The exact solution (Lamé) is known, so this demo shows
#
# - how a tie is added to a DOLFINx script,
# - that displacements and stresses converge as fast as on a single mesh,
# - how to get the traction that the tie transmits, and that it is one order more accurate on the
#   surfaces.

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

# The radii are 2 : 2.5 : 3 as in the paper, Young's modulus and the pressure are one.

a, c, b = 2.0, 2.5, 3.0
E, nu, p = 1.0, 0.3, 1.0
mu, lmbda = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))

# The paper's errors, read off its Figure 4 (±3 %): L² of the displacement, L² of the stress.

PAPER = {
    1: [(4.1e-2, 2.6e-1), (1.0e-2, 1.3e-1), (2.6e-3, 6.6e-2), (6.5e-4, 3.3e-2), (1.6e-4, 1.65e-2)],
    2: [(1.3e-3, 3.2e-2), (1.5e-4, 9.1e-3), (1.7e-5, 2.5e-3), (2.2e-6, 6.7e-4), (3.6e-7, 1.8e-4)],
}


def sigma(u):
    """Stress of a displacement."""
    eps = ufl.sym(ufl.grad(u))
    return 2 * mu * eps + lmbda * ufl.tr(eps) * ufl.Identity(2)


# The exact displacement is radial, $u = \frac{1+\nu}{E}\left[(1-2\nu) A r + B/r\right]$, and the
# stress on a face with normal $e_r$ is $\sigma_{rr} = A - B/r^2$.

A = p * a**2 / (b**2 - a**2)
B = p * a**2 * b**2 / (b**2 - a**2)


def exact_displacement(x):
    """Lamé's solution; ``x`` is a UFL coordinate or an array ``(3, num_points)``."""
    factor = (1 + nu) / E * ((1 - 2 * nu) * A + B / (x[0] ** 2 + x[1] ** 2))
    return factor * x[0], factor * x[1]


# ## One level
#
# Two rings, a space and an elastic form on each. `meshes.ring_sector` gives a DOLFINx mesh with
# facet tags; any other mesh would do.


def create_rings(comm, n, degree, cell):
    """The inner and the outer ring: 4n and 6n quadrilaterals around, n across.

    Triangles are a quarter of these: with halves, coarse meshes are better than the interpolant of
    the exact solution, which blurs the rates.
    """
    options = {"cell": cell, "degree": degree, "crossed": cell == "triangle"}
    return [
        meshes.ring_sector(comm, n_hoop, n, *radii, **options)
        for n_hoop, radii in ((4 * n, (a, c)), (6 * n, (c, b)))
    ]


def solve(rings, degree, swap, seconds):
    """Solve the tied problem; returns it, its tie and what took how long."""
    V, forms, loads, bcs = [], [], [], []
    for mesh, ft in rings:
        W = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        n, ds = ufl.FacetNormal(mesh), ufl.Measure("ds", mesh, subdomain_data=ft)
        inside = mesh is rings[0][0]
        V.append(W)
        forms.append(ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx)
        pressure = fem.Constant(mesh, default_scalar_type(p if inside else 0.0))
        loads.append(-pressure * ufl.dot(n, v) * ds(meshes.INNER))
        for tag, component in ((meshes.START, 1), (meshes.END, 0)):  # the symmetry planes
            dofs = fem.locate_dofs_topological(W.sub(component), 1, ft.find(tag))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, W.sub(component)))

    # The tie: the inner ring's outer facets with the outer ring's inner facets. The second one
    # carries the multipliers.
    sides = [(V[0], rings[0][1].find(meshes.OUTER)), (V[1], rings[1][1].find(meshes.INNER))]
    with stopwatch(seconds, "sigma"):
        tie = Tie(*(sides[::-1] if swap else sides))
    with stopwatch(seconds, "gap"):
        tie.blocks()
    with stopwatch(seconds, "assemble"):
        problem = TiedProblem(forms, loads, bcs=bcs, ties=[tie])
        problem.assemble_matrix()
        problem.assemble_vector()
    with stopwatch(seconds, "solve"):
        problem.solve_system()
    return problem, tie


# ## Errors
#
# Relative errors of the displacement and the stress over both rings; of the traction on the gap
# domain Σ, where $\lambda = \sigma_{rr}(c)\, n$, and on the surfaces of both rings; and the gap and
# the slip on Σ, which should be zero, over the displacement $u(c)$.


def relative_errors(us, degree):
    """Relative L² errors of displacement and stress."""
    totals = np.zeros(4)
    for u in us:
        x = ufl.SpatialCoordinate(u.function_space.mesh)
        u_exact = ufl.as_vector(exact_displacement(x))
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 4})
        # The zero function's error is the exact field's norm, by the same form
        for j, f in enumerate((u, fem.Function(u.function_space))):
            for i, g in enumerate((f - u_exact, sigma(f) - sigma(u_exact))):
                totals[2 * i + j] += fem.assemble_scalar(fem.form(ufl.inner(g, g) * dx))
    error_u, norm_u, error_s, norm_s = us[0].function_space.mesh.comm.allreduce(totals)
    return np.sqrt(error_u / norm_u), np.sqrt(error_s / norm_s)


def traction_error(problem, tie, swap):
    """Relative L² error of λ on Σ."""
    q = tie.quadrature(8)
    r = np.linalg.norm(q.x, axis=-1, keepdims=True)
    exact = (A - B / c**2) * q.x / r * (-1 if swap else 1)
    error = q.evaluate(tie.traction(problem)) - exact
    return np.sqrt(q.integrate((error**2).sum(-1)) / q.integrate((exact**2).sum(-1)))


def surface_traction_errors(problem, tie, swap):
    """The same of the tractions on Γ0 and Γ1, recovered from the forces of λ."""
    errors = []
    for side in (0, 1):
        t = tie.traction(problem, on=f"side{side}")
        mesh = t.function_space.mesh  # of the surface
        x, dx = ufl.SpatialCoordinate(mesh), ufl.dx(metadata={"quadrature_degree": 8})
        outwards = 1 if (side == 0) != swap else -1  # the body's normal
        exact = (A - B / c**2) * outwards * x / ufl.sqrt(ufl.dot(x, x))
        errors_of = (f - exact for f in (t, fem.Function(t.function_space)))
        squares = [fem.assemble_scalar(fem.form(ufl.dot(e, e) * dx)) for e in errors_of]
        errors.append(np.sqrt(np.divide(*mesh.comm.allreduce(np.array(squares)))))
    return errors


def gap_error(problem, tie, swap):
    """L² norm of gap and slip on Σ, relative to the displacement's."""
    q = tie.quadrature(8)
    gap, slip = (q.evaluate(f) for f in tie.gap(*problem.u[:: -1 if swap else 1]))
    u = np.linalg.norm(exact_displacement((c, 0.0)))
    error = q.integrate((gap**2 + slip**2).sum(-1))
    return np.sqrt(error / q.integrate(np.full_like(q.weights, u**2)))


@contextmanager
def stopwatch(seconds, name):
    """Seconds of a block, into a dictionary."""
    start = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - start


def run(comm, level, degree, cell, swap):
    """One row of the table, and what was solved."""
    n = 2**level
    seconds = {}
    with stopwatch(seconds, "mesh"):
        rings = create_rings(comm, n, degree, cell)
    problem, tie = solve(rings, degree, swap, seconds)
    l2, stress = relative_errors(problem.u, degree)
    V = [u.function_space.dofmap for u in problem.u]
    row = {
        "degree": degree,
        "cell": cell,
        "swap": swap,
        "level": level,
        "h": (c - a) / n,
        "dofs": sum(dofmap.index_map.size_global * dofmap.index_map_bs for dofmap in V),
        "l2": float(l2),
        "stress": float(stress),
        "traction": float(traction_error(problem, tie, swap)),
        "surface_traction": [float(e) for e in surface_traction_errors(problem, tie, swap)],
        "gap": float(gap_error(problem, tie, swap)),
        "seconds": seconds,
    }
    return row, problem, tie


# ## The table


def print_table(rows):
    """Errors, rates and seconds of one degree, beside the paper's."""
    row = rows[0]
    print(
        f"\ndegree {row['degree']}, {row['cell']}s, "
        f"Γ1 is the {'inner' if row['swap'] else 'outer'} ring\n"
        "   h      dofs     L² displ.  rate    L² stress  rate    L² traction rate   "
        "on Γ0, on Γ1         seconds (Σ + gap)    the paper's"
    )
    for i, row in enumerate(rows):
        text = f"1/{round(1 / row['h']):<3d} {row['dofs']:>8d}"
        for name in ("l2", "stress", "traction"):
            rate = np.log2(rows[i - 1][name] / row[name]) if i else np.nan
            text += f"   {row[name]:.3e}  {rate:4.2f}" if i else f"   {row[name]:.3e}      "
        text += "   {:.2e}, {:.2e}".format(*row["surface_traction"])
        s = row["seconds"]
        text += f"   {sum(s.values()):7.2f}  ({s['sigma'] + s['gap']:.3f})"
        paper = PAPER.get(row["degree"], [])
        if row["cell"] == "quadrilateral" and row["level"] < len(paper):
            text += "     {:.1e} / {:.1e}".format(*paper[row["level"]])
        print(text, flush=True)


# ## Pictures
#
# As the paper's Figures 3 and 4: the gap domain Σ between the rings, drawn pulled apart; the rings
# before and after deformation; errors over the cell size.


def draw(comm, degree, cell, swap, folder):
    """Figure 3."""
    from hypergap_dolfinx import plot

    _, problem, tie = run(comm, 1, degree, cell, swap)
    plot.gap_domain([tie], folder / "gap_domain.png")
    plot.deformed(problem.u, folder / "deformed.png", factor=0.05)
    plot.traction(tie, tie.traction(problem), folder / "traction.png")
    us = problem.u[::-1] if swap else problem.u
    plot.interface(tie, tie.gap(*us)[0], folder / "gap.png", title="normal gap")


def draw_errors(results, folder):
    """Figure 4, with the paper's own errors."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 4.5), constrained_layout=True)
    for ax, name, paper, title in zip(
        axes, ("l2", "stress"), (0, 1), ("L² displacement", "L² stress"), strict=True
    ):
        for degree in sorted({row["degree"] for row in results}):
            rows = [row for row in results if row["degree"] == degree]
            h, error = [row["h"] for row in rows], [row[name] for row in rows]
            (line,) = ax.loglog(h, error, "o-", label=f"degree {degree}")
            order = degree + 1 - paper
            slope = [0.7 * error[-1] * (x / h[-1]) ** order for x in h]
            ax.loglog(h, slope, ":", color=line.get_color(), label=f"slope {order}")
            if degree in PAPER and rows[0]["cell"] == "quadrilateral":
                values = [PAPER[degree][row["level"]][paper] for row in rows if row["level"] < 5]
                ax.loglog(
                    h[: len(values)], values, "x--", color=line.get_color(), alpha=0.5,
                    label=f"degree {degree}, Giffin (2024)",
                )  # fmt: skip
        ax.set(xlabel="h", ylabel="relative error", title=title)
        ax.set_xticks(h, [f"1/{round(1 / x)}" for x in h])
        ax.minorticks_off()
        ax.grid(which="both", alpha=0.3)
        ax.legend(fontsize=8)
    figure.savefig(folder / "errors.png", dpi=150)
    plt.close(figure)


def main():
    """Sweep degrees and levels."""
    parser = argparse.ArgumentParser(description="A pressurised cylinder in two tied rings.")
    parser.add_argument("--degree", type=int, choices=(1, 2, 3), help="default: 1 and 2")
    parser.add_argument("--cell", choices=("quadrilateral", "triangle"), default="quadrilateral")
    parser.add_argument("--levels", type=int, default=5)
    parser.add_argument("--swap", action="store_true", help="Γ1 on the inner ring")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument(
        "--plot", type=Path, metavar="DIR", help="default: results/, if no degree is given"
    )
    args = parser.parse_args()
    comm = MPI.COMM_WORLD

    results = []
    for degree in (args.degree,) if args.degree else (1, 2):
        run(comm, 0, degree, args.cell, args.swap)  # compiles the forms, so that no level has to
        rows = []
        for level in range(args.levels):
            progress.show(comm, f"degree {degree}, level {level + 1} of {args.levels}")
            rows.append(run(comm, level, degree, args.cell, args.swap)[0])
        progress.show(comm)
        if comm.rank == 0:
            print_table(rows)
        results += rows
    if args.json and comm.rank == 0:
        args.json.write_text(json.dumps(results, indent=1))
    folder = args.plot or (None if args.degree else Path("results/pressurised_cylinder"))
    if folder:
        draw(comm, args.degree or 2, args.cell, args.swap, folder)
        if comm.rank == 0:
            draw_errors(results, folder)
            print(f"\npictures in {folder}/")


if __name__ == "__main__":
    main()
