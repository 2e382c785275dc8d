# # Hertz: a cylinder on a half-plane
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# A cylinder of radius R is pressed against a half-plane, both elastic, by a force P per depth. They
# touch on a strip of half-width a, with a pressure that is half an ellipse (Hertz, 1881):
#
# $$a = \sqrt{4PR / (\pi E^*)}, \quad p = p_0 \sqrt{1 - x^2/a^2}, \quad p_0 = 2P / (\pi a).$$
#
# The cylinder is held by nothing but symmetry and contact; the force is the load. The meshes don't
# match; `h` is the size of the cells of the coarser side where the bodies touch.

# +
import argparse
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import compute_midpoints

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Contact, ContactProblem, progress

# -

R, a = 1.0, 0.0025  # radius, half-width of the contact
E, nu = 1.0, 0.3  # of both bodies, plane strain
L = 200 * a  # width and height of what is meshed of the half-plane, and of the cylinder

E_star = E / (2 * (1 - nu**2))
P = np.pi * E_star * a**2 / (4 * R)
p0 = 2 * P / (np.pi * a)


def exact(x):
    """Hertz's pressure."""
    return p0 * np.sqrt(np.maximum(1 - (x / a) ** 2, 0))


# ## Meshes
#
# Cells of one size up to 1.5 a, from there on each is a seventh longer than the one before.


def grading(h):
    """Positions of nodes from 0 to L."""
    x = np.arange(0, int(np.ceil(1.5 * a / h)) + 1) * h
    while x[-1] < L:
        x = np.append(x, x[-1] + 8 / 7 * (x[-1] - x[-2]))
    return np.append(x[:-2], L)


def body(comm, upper, h, degree):
    """Half of the cylinder's lower part, or of the block, to the right of the symmetry plane."""
    nodes = grading(h)
    n = len(nodes) - 1

    def place(s):
        x, y = (np.interp(s[:, i], np.linspace(0, 1, n + 1), nodes) for i in (0, 1))
        if not upper:
            depth = np.interp(1 - s[:, 1], np.linspace(0, 1, n + 1), nodes)
            return np.column_stack((x, -depth))
        bottom = R - np.sqrt(R**2 - x**2)
        return np.column_stack((x, bottom + y * (1 - bottom / L)))

    return meshes.block(comm, (n, n), place, cell="quadrilateral", degree=degree)


def press(comm, h, degree, ratio, swap):
    """Press the cylinder on.

    Args:
        comm: Communicator.
        h: Size of the coarser side's cells.
        degree: Of displacements and geometry.
        ratio: Size of the cylinder's cells over that of the block's.
        swap: Whether Γ1 is the side that isn't chosen.
    """
    sizes = h * min(1, 1 / ratio), h * min(1, ratio)
    u, F, bcs, sides = [], [], [], []
    for i, size in enumerate(sizes):
        mesh, ft = body(comm, i == 1, size, degree)
        V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
        w, v = fem.Function(V), ufl.TestFunction(V)
        eps = ufl.sym(ufl.grad(w))
        sigma = E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(2))
        form = ufl.inner(sigma, ufl.sym(ufl.grad(v))) * ufl.dx
        held = [(0, meshes.LEFT)]
        if i == 0:
            held.append((1, meshes.BOTTOM))
        else:
            ds = ufl.Measure("ds", mesh, subdomain_data=ft)
            load = fem.Constant(mesh, default_scalar_type(P / 2 / L))
            form += load * v[1] * ds(meshes.TOP)
        for component, tag in held:
            dofs = fem.locate_dofs_topological(V.sub(component), 1, ft.find(tag))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(component)))
        u.append(w)
        F.append(form)
        facets = ft.find(meshes.TOP if i == 0 else meshes.BOTTOM)
        near = compute_midpoints(mesh, 1, facets)[:, 0] < 5 * a
        sides.append((V, facets[near]))
    contact = Contact.between(*sides)
    if swap:
        contact = Contact(*(sides if contact.swapped else sides[::-1]))
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    problem.solve()
    return problem, contact


def errors(problem, contact):
    """Relative errors of what Hertz's solution says."""
    p, x = contact.pressures(problem), contact.surfaces[1].x[:, 0]
    order = np.argsort(x)
    p, x = p[order], x[order]
    points, weights = np.polynomial.legendre.leggauss(8)
    t = (points + 1) / 2
    at = x[:-1, None] + t * np.diff(x)[:, None]
    p_h = p[:-1, None] + t * np.diff(p)[:, None]
    dx = weights / 2 * np.diff(x)[:, None]
    l2 = np.sqrt(((p_h - exact(at)) ** 2 * dx).sum() / (exact(at) ** 2 * dx).sum())
    force = 2 * abs(contact.force(problem)[1])
    return {
        "p0": abs(p.max() / p0 - 1),
        "force": abs(force / P - 1),
        "half_width": abs(contact.surfaces[1].x[contact.active, 0].max() / a - 1),
        "l2_pressure": l2,
        "steps": problem.iterations,
    }


def main():
    """Press on finer and finer meshes."""
    parser = argparse.ArgumentParser(description="Hertz's contact of a cylinder and a half-plane.")
    parser.add_argument("--dim", type=int, choices=(2,), default=2)
    parser.add_argument("--degree", type=int, choices=(1, 2), default=1)
    parser.add_argument("--swap", action="store_true", help="Γ1 on the other side")
    parser.add_argument("--ratio", type=float, default=2 / 3, help="cylinder's cells over block's")
    parser.add_argument("--levels", type=int, default=3, help="of h = a/10, a/20, ...")
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args()
    comm, rows = MPI.COMM_WORLD, []
    for level in range(args.levels):
        division = 10 * 2**level
        progress.show(comm, f"h = a/{division}")
        result = errors(*press(comm, a / division, args.degree, args.ratio, args.swap))
        rows.append(
            {
                "dim": args.dim,
                "degree": args.degree,
                "h_over_a": 1 / division,
                "ratio": args.ratio,
                "swap": args.swap,
                **result,
            }
        )
    progress.show(comm)
    if comm.rank == 0:
        print("  h/a     p0        force     half-width  L² of p   steps")
        for row in rows:
            print(
                f"  1/{round(1 / row['h_over_a']):<4}  {row['p0']:.2e}  {row['force']:.2e}  "
                f"{row['half_width']:.2e}    {row['l2_pressure']:.2e}  {row['steps']:3d}"
            )
        if args.json:
            args.json.write_text(json.dumps({"rows": rows}, indent=1))


if __name__ == "__main__":
    main()
