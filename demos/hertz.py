# # Hertz: a cylinder on a half-plane, a sphere on a half-space
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
# A sphere touches a half-space on a disc of radius a, where (`--dim 3`)
#
# $$a = \sqrt[3]{3PR / (4 E^*)}, \quad p = p_0 \sqrt{1 - r^2/a^2}, \quad p_0 = 3P / (2\pi a^2).$$
#
# The upper body is held by nothing but symmetry and contact; the force is the load. The meshes
# don't match; `h` is the size of the cells of the coarser side where the bodies touch.

# +
import argparse
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import basix
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import compute_midpoints

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Contact, ContactProblem, progress

# -

R, a = 1.0, 0.0025  # radius, half-width of the contact
E, nu = 1.0, 0.3  # of both bodies, plane strain
L = {2: 200 * a, 3: 12 * a}  # width and height of what is meshed of both bodies

E_star = E / (2 * (1 - nu**2))
P = {2: np.pi * E_star * a**2 / (4 * R), 3: 4 * E_star * a**3 / (3 * R)}
p0 = {2: 2 * P[2] / (np.pi * a), 3: 3 * P[3] / (2 * np.pi * a**2)}


def exact(x, dim=2):
    """Hertz's pressure at a distance from the middle."""
    return p0[dim] * np.sqrt(np.maximum(1 - (x / a) ** 2, 0))


# ## Meshes
#
# In the plane cells of one size up to 1.5 a, from there on each is a seventh longer than the one
# before. In space unstructured tetrahedra, which grow from 1.2 a on.


def grading(h):
    """Positions of nodes from 0 to L."""
    x = np.arange(0, int(np.ceil(1.5 * a / h)) + 1) * h
    while x[-1] < L[2]:
        x = np.append(x, x[-1] + 8 / 7 * (x[-1] - x[-2]))
    return np.append(x[:-2], L[2])


def body(comm, upper, h, degree, dim):
    """Half (a quarter) of the round body's lower part, or of the block, beside planes of symmetry.

    Returns:
        Mesh and facet tags: the last axis is vertical.
    """
    if dim == 3:

        def size(x, y, z):
            off = np.linalg.norm((x, y, z if upper else 1 - z)) * L[3]
            return (h + 0.35 * max(off - 1.2 * a, 0)) / L[3]

        def place(s):
            return curved(s * L[3] - (0 if upper else (0, 0, L[3])), upper, L[3])

        return meshes.solid_block(comm, size, place, degree=degree)
    nodes = grading(h)
    n = len(nodes) - 1

    def place(s):
        x = np.interp(s[:, 0], np.linspace(0, 1, n + 1), nodes)
        y = s[:, 1] if upper else 1 - s[:, 1]
        depth = np.interp(y, np.linspace(0, 1, n + 1), nodes)
        return curved(np.column_stack((x, depth if upper else -depth)), upper, L[2])

    return meshes.block(comm, (n, n), place, cell="quadrilateral", degree=degree)


def curved(x, upper, height):
    """Make the upper body's bottom round."""
    if upper:
        bottom = R - np.sqrt(R**2 - (x[:, :-1] ** 2).sum(axis=1))
        x[:, -1] = bottom + x[:, -1] * (1 - bottom / height)
    return x


def press(comm, h, degree, ratio, swap, dim=2):
    """Press the cylinder on.

    Args:
        comm: Communicator.
        h: Size of the coarser side's cells.
        degree: Of displacements and geometry.
        ratio: Size of the round body's cells over that of the block's.
        swap: Whether Γ1 is the side that isn't chosen.
        dim: Number of dimensions.
    """
    sizes = h * min(1, 1 / ratio), h * min(1, ratio)
    u, F, bcs, sides = [], [], [], []
    for i, size in enumerate(sizes):
        mesh, ft = body(comm, i == 1, size, degree, dim)
        V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
        w, v = fem.Function(V), ufl.TestFunction(V)
        eps = ufl.sym(ufl.grad(w))
        sigma = E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(dim))
        dx = ufl.dx(metadata={"quadrature_degree": 4 * degree - 2})
        form = ufl.inner(sigma, ufl.sym(ufl.grad(v))) * dx
        low, high = 2 * dim - 1, 2 * dim  # tags of the bottom and the top
        held = [(axis, 2 * axis + 1) for axis in range(dim - 1)]
        if i == 0:
            held.append((dim - 1, low))
        else:
            ds = ufl.Measure("ds", mesh, subdomain_data=ft)
            load = fem.Constant(mesh, default_scalar_type(P[dim] / (2 * L[dim]) ** (dim - 1)))
            form += load * v[dim - 1] * ds(high)
        for component, tag in held:
            dofs = fem.locate_dofs_topological(V.sub(component), dim - 1, ft.find(tag))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(component)))
        u.append(w)
        F.append(form)
        facets = ft.find(high if i == 0 else low)
        middle = compute_midpoints(mesh, dim - 1, facets)
        near = np.linalg.norm(middle[:, : dim - 1], axis=1) < 5 * a
        sides.append((V, facets[near]))
    contact = Contact.between(*sides)
    if swap:
        contact = Contact(*(sides if contact.swapped else sides[::-1]))
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    problem.solve()
    return problem, contact


def errors(problem, contact):
    """Relative errors of what Hertz's solution says."""
    surface, p = contact.surfaces[1], contact.pressures(problem)
    dim = surface.gdim
    cell = {2: basix.CellType.interval, 3: basix.CellType.triangle}[dim]
    points, weights = basix.make_quadrature(cell, 15 if dim == 2 else 8)
    values = np.column_stack((1 - points.sum(axis=1), points))
    x = surface.x[surface.facets]
    at = np.linalg.norm(np.einsum("qv,fvi->fqi", values, x)[..., :-1], axis=2)
    edges = (x[:, 1:] - x[:, :1])[..., :-1]
    dx = np.abs(np.linalg.det(edges))[:, None] * weights
    square = ((p[surface.facets] @ values.T - exact(at, dim)) ** 2 * dx).sum()
    reached = np.linalg.norm(surface.x[contact.active][:, :-1], axis=1).max(initial=0)
    force = 2 ** (dim - 1) * abs(contact.force(problem)[dim - 1])
    return {
        "p0": abs(p.max() / p0[dim] - 1),
        "force": abs(force / P[dim] - 1),
        "half_width": abs(reached / a - 1),
        "l2_pressure": np.sqrt(square / (exact(at, dim) ** 2 * dx).sum()),
        "steps": problem.iterations,
    }


def draw(file, profiles, dim):
    """Pressures over the distance from the middle, beside Hertz's.

    Args:
        file: Where to save the picture.
        profiles: Level, distances and pressures of each mesh.
        dim: Dimension.
    """
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    r = np.linspace(0, a, 400)
    axes.plot(r / a, exact(r, dim) / p0[dim], color="black", label="Hertz")
    for (division, at, p), mark in zip(profiles, ("o", "s", "^", "v"), strict=False):
        style = {"marker": mark, "markersize": 4, "linestyle": "-" if dim == 2 else "", "lw": 0.7}
        axes.plot(at / a, p / p0[dim], label=f"h = a/{division}", **style)
    axes.set(xlabel="distance from the middle / a", ylabel="p / p0", xlim=(0, 1.5))
    axes.legend()
    file.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(file, dpi=150)


def main():
    """Press on finer and finer meshes."""
    parser = argparse.ArgumentParser(description="Hertz's contact.")
    parser.add_argument("--dim", type=int, choices=(2, 3), default=2)
    parser.add_argument("--degree", type=int, choices=(1, 2), default=1)
    parser.add_argument("--swap", action="store_true", help="Γ1 on the other side")
    parser.add_argument(
        "--ratio", type=float, default=2 / 3, help="round body's cells over block's"
    )
    parser.add_argument(
        "--levels", type=int, default=3, help="of h = a/10, a/20, ...; in space a/6, ..."
    )
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="save p(x)")
    args = parser.parse_args()
    comm, rows, profiles = MPI.COMM_WORLD, [], []
    for level in range(args.levels):
        division = (10 if args.dim == 2 else 6) * 2**level
        progress.show(comm, f"h = a/{division}")
        scene = press(comm, a / division, args.degree, args.ratio, args.swap, args.dim)
        result, (problem, contact) = errors(*scene), scene
        at = np.linalg.norm(contact.surfaces[1].x[:, :-1], axis=1)
        order = np.argsort(at)
        profiles.append((division, at[order], contact.pressures(problem)[order]))
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
        if args.plot:
            draw(args.plot / "hertz.png", profiles, args.dim)


if __name__ == "__main__":
    main()
