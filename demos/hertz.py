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
# Only symmetry and contact hold the upper body, and the force is the load. The meshes don't match;
# `h` is the cell size of the coarser side in the contact.

# +
import argparse
import json
import sys
from dataclasses import dataclass
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
# In the plane cells have one size up to 1.5 a, and grow by a seventh from cell to cell beyond. In
# space, tetrahedra are unstructured and grow outside a ball of radius 1.2 a. With degree 2 they
# grow outside a disc, since longer cells suffice below the surface.


def grading(h, a=a, end=L[2]):
    """Positions of nodes from 0 to the end."""
    x = np.arange(0, int(np.ceil(1.5 * a / h)) + 1) * h
    while x[-1] < end:
        x = np.append(x, x[-1] + 8 / 7 * (x[-1] - x[-2]))
    return np.append(x[:-2], end)


def body(comm, upper, h, degree, dim):
    """Half (a quarter) of the round body's lower part, or of the block, beside planes of symmetry.

    Returns:
        Mesh and facet tags: the last axis is vertical.
    """
    if dim == 3:

        def size(x, y, z):
            x, y, z = (s * L[3] for s in (x, y, z if upper else 1 - z))
            if degree == 1:
                off = max(np.linalg.norm((x, y, z)) - 1.2 * a, 0)
            else:
                off = np.hypot(max(np.hypot(x, y) - 1.2 * a, 0), z)
            return (h + 0.35 * off) / L[3]

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


def pair(comm, h, degree, ratio, dim):
    """Both bodies' meshes, the block first.

    Args:
        comm: Communicator.
        h: Size of the coarser side's cells.
        degree: Of the geometry.
        ratio: Size of the round body's cells over that of the block's.
        dim: Number of dimensions.

    Returns:
        Of each body mesh, facet tags, and facets that may touch.
    """
    bodies = []
    for upper, size in enumerate((h * min(1, 1 / ratio), h * min(1, ratio))):
        mesh, ft = body(comm, upper == 1, size, degree, dim)
        facets = ft.find(2 * dim - 1 if upper else 2 * dim)
        middle = compute_midpoints(mesh, dim - 1, facets)
        near = np.linalg.norm(middle[:, : dim - 1], axis=1) < 5 * a
        bodies.append((mesh, ft, facets[near]))
    return bodies


def load(dim):
    """What presses on the upper body's top."""
    return P[dim] / (2 * L[dim]) ** (dim - 1)


def lame():
    """Lamé's constants."""
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def forms(bodies, degree):
    """Residuals, displacements, boundary conditions, and what may touch."""
    u, F, bcs, sides = [], [], [], []
    for i, (mesh, ft, facets) in enumerate(bodies):
        dim = mesh.geometry.dim
        V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
        w, v = fem.Function(V), ufl.TestFunction(V)
        eps = ufl.sym(ufl.grad(w))
        sigma = E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(dim))
        dx = ufl.dx(metadata={"quadrature_degree": 4 * degree - 2})
        form = ufl.inner(sigma, ufl.sym(ufl.grad(v))) * dx
        held = [(axis, 2 * axis + 1) for axis in range(dim - 1)]
        if i == 0:
            held.append((dim - 1, 2 * dim - 1))  # the bottom
        else:
            ds = ufl.Measure("ds", mesh, subdomain_data=ft)
            pressure = fem.Constant(mesh, default_scalar_type(load(dim)))
            form += pressure * v[dim - 1] * ds(2 * dim)
        for component, tag in held:
            dofs = fem.locate_dofs_topological(V.sub(component), dim - 1, ft.find(tag))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(component)))
        u.append(w)
        F.append(form)
        sides.append((V, facets))
    return F, u, bcs, sides


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
    F, u, bcs, sides = forms(pair(comm, h, degree, ratio, dim), degree)
    contact = Contact.between(*sides)
    if swap:
        contact = Contact(*(sides if contact.swapped else sides[::-1]))
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    problem.solve()
    return problem, contact


def quadrature(x):
    """A rule on a surface.

    Args:
        x: Places of the facets' vertices, ``(num_facets, dim, dim)``.

    Returns:
        Shares of the vertices at its points, ``(num_points, dim)``, and of all points distances
        from the middle and weights, ``(num_facets, num_points)``.
    """
    dim = x.shape[2]
    cell = {2: basix.CellType.interval, 3: basix.CellType.triangle}[dim]
    points, weights = basix.make_quadrature(cell, 15 if dim == 2 else 8)
    shares = np.column_stack((1 - points.sum(axis=1), points))
    at = np.linalg.norm(np.einsum("qv,fvi->fqi", shares, x)[..., :-1], axis=2)
    edges = (x[:, 1:] - x[:, :1])[..., :-1]
    return shares, at, np.abs(np.linalg.det(edges))[:, None] * weights


def l2_error(at, p, dx, dim):
    """Relative L² error of a pressure at the points of a rule."""
    square = ((p - exact(at, dim)) ** 2 * dx).sum()
    return np.sqrt(square / (exact(at, dim) ** 2 * dx).sum())


def surface_error(problem, contact):
    """Relative L² error of the pressure on Γ1's surface."""
    p = contact.pressure(problem, on="surface")
    V, dim = p.function_space, p.function_space.mesh.geometry.dim
    x = V.tabulate_dof_coordinates()[V.dofmap.list][..., :dim]
    shares, at, dx = quadrature(x)
    found, known = p.x.array[V.dofmap.list] @ shares.T, exact(at, dim)
    square = np.array((((found - known) ** 2 * dx).sum(), (known**2 * dx).sum()))
    error, whole = V.mesh.comm.allreduce(square)
    return np.sqrt(error / whole)


def errors(problem, contact):
    """Relative errors of what Hertz's solution says."""
    surface, p = contact.surfaces[1], contact.pressures(problem)
    dim = surface.gdim
    shares, at, dx = quadrature(surface.x[surface.facets])
    reached = np.linalg.norm(surface.x[contact.active][:, :-1], axis=1).max(initial=0)
    force = 2 ** (dim - 1) * abs(contact.force(problem)[dim - 1])
    return {
        "p0": abs(p.max() / p0[dim] - 1),
        "force": abs(force / P[dim] - 1),
        "half_width": abs(reached / a - 1),
        "l2_pressure": l2_error(at, p[surface.facets] @ shares.T, dx, dim),
        "l2_surface": float(surface_error(problem, contact)),
        "steps": problem.iterations,
    }


# ## Published scenes
#
# These bodies have finite sizes and strains, while Hertz's strains are infinitesimal. For an
# agreement within 1 %, two things matter:
#
# - Linear elastic bodies are in equilibrium on their undeformed surfaces. These shrink under
#   pressure, by (1 + ν)(1 - 2ν) p0 / E. So forces per undeformed area are compared; per deformed
#   area they are larger by that in the plane.
# - Prescribing the displacement of a half body's middle plane isn't the same as moving a half-space
#   far away: the force is larger than Hertz's. So the load is his force.
#
# Spheres are axisymmetric: forms have 2πr in their measures, and so has the contact.


@dataclass
class Published:
    """Round bodies (of radius None: a block 20 wide and high), and what is known of them."""

    radii: tuple[float | None, float]
    E: tuple[float, float]
    nu: tuple[float, float]
    force: float  # per depth in the plane
    half_width: float
    p0: float
    approach: float | None = None
    around: bool = False  # an axis
    steps: int = 1  # of load


PUBLISHED = {
    "cylinders": Published((13, 10), (29120, 30000), (0.3, 0.25), 3200, 1.19971, 1698.06, 0.4181),
    "disc-on-block": Published((None, 8), (200, 200), (0.3, 0.3), 10, 0.962766, 6.6124),
    "discs": Published((8, 8), (200, 200), (0.3, 0.3), 10, 0.680778, 9.35135),
    "spheres": Published(
        (50, 50), (2e4, 2e4), (0.3, 0.3), 2 / 3 * np.pi * 100 * 2798.3, 10, 2798.3, None, True, 4
    ),
}


def half_body(comm, radius, upper, h, width, degree):
    """The right half of a block, or of the half of a disc that is nearer to the contact."""
    if radius is None:
        along, up = grading(h, width, 10) / 10, grading(h, width, 20) / 20
    else:  # a square, with one of its corners in the middle of the arc
        along = up = grading(h, width, np.pi / 4 * radius) / (np.pi / 4 * radius)

    def arc(x):
        return radius * np.column_stack((np.sin(np.pi / 4 * x), 1 - np.cos(np.pi / 4 * x)))

    def place(s):
        x, y = (np.interp(s[:, i], np.linspace(0, 1, len(t)), t) for i, t in enumerate((along, up)))
        if radius is None:
            x = np.column_stack((10 * x, 20 * y))
        else:  # between its four sides
            bottom, right, corner = arc(x), arc(1 + y), arc(np.ones(1))
            x, y = x[:, None], y[:, None]
            x = (1 - y) * (bottom - x * corner) + x * right + (1 - x) * y * (0, radius)
        return x * (1, 1 if upper else -1)

    return meshes.block(comm, (len(along) - 1, len(up) - 1), place, degree=degree)


def press_published(comm, scene, cells, degree):
    """Press two bodies on each other, ``cells`` of the coarser one across the half-width.

    Returns:
        Relative errors of p0 and the half-width, and of the approach if it is known.
    """
    width, u, F, bcs, sides = scene.half_width, [], [], [], []
    for i, (radius, E, nu) in enumerate(zip(scene.radii, scene.E, scene.nu, strict=True)):
        h = width / cells * (1 if i else 2 / 3)
        mesh, ft = half_body(comm, radius, i == 1, h, width, degree)
        V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
        w, v = fem.Function(V), ufl.TestFunction(V)
        r = ufl.SpatialCoordinate(mesh)[0]

        def strain(w, r=r):
            e, hoop = ufl.sym(ufl.grad(w)), w[0] / r if scene.around else 0
            return ufl.as_tensor(((e[0, 0], e[0, 1], 0), (e[1, 0], e[1, 1], 0), (0, 0, hoop)))

        weight = 2 * np.pi * r if scene.around else 1
        eps = strain(w)
        sigma = E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(3))
        dx = ufl.dx(metadata={"quadrature_degree": 4 * degree})
        F.append(weight * ufl.inner(sigma, strain(v)) * dx)
        held = [(0, meshes.LEFT)]
        if i == 0:
            held.append((1, meshes.TOP))
        else:
            plane = ufl.Measure("ds", mesh, subdomain_data=ft)(meshes.TOP)
            load = fem.Constant(mesh, default_scalar_type(0))
            F[1] += weight * load * v[1] * plane
        for component, tag in held:
            dofs = fem.locate_dofs_topological(V.sub(component), 1, ft.find(tag))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(component)))
        u.append(w)
        facets = ft.find(meshes.BOTTOM)
        near = compute_midpoints(mesh, 1, facets)[:, 0] < 2 * width
        sides.append((V, facets[near]))
    contact = Contact.between(*sides, axisymmetric=scene.around)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    area = scene.radii[1] * (np.pi * scene.radii[1] if scene.around else 2)
    for step in range(scene.steps):
        load.value = (step + 1) / scene.steps * scene.force / area
        problem.solve()

    order = np.argsort(contact.surfaces[1].x[:, 0])
    x, now = (s.x[order, 0] for s in (contact.surfaces[1], contact.displaced(problem)[1]))
    stretch = np.gradient(now, x)
    if scene.around:  # of the radius too
        stretch *= np.divide(now, x, out=stretch.copy(), where=x > 0)
    p = contact.pressures(problem)[order] * stretch
    inside = (x > (0.15 * width if scene.around else -1)) & (x < 0.8 * width)
    x, p = x[inside], p[inside]
    slope, square = np.polyfit(x**2, p**2, 1)  # p² = p0² (1 - x²/a²)
    row = {
        "p0": abs(np.sqrt(square) / scene.p0 - 1),
        "half_width": abs(np.sqrt(-square / slope) / width - 1),
    }
    if scene.approach:
        moved = comm.allreduce(fem.assemble_scalar(fem.form(w[1] * plane))) / scene.radii[1]
        row["approach"] = abs(-moved / scene.approach - 1)
    return row


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
    parser.add_argument(
        "--published", nargs="*", choices=PUBLISHED, help="these published scenes, or all"
    )
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="save p(x)")
    args = parser.parse_args()
    comm, rows, profiles = MPI.COMM_WORLD, [], []
    if args.published is not None:
        for name in args.published or PUBLISHED:
            scene = PUBLISHED[name]
            found = press_published(comm, scene, 10, args.degree)
            rows.append({"scene": name, "exact_p0": scene.p0, **found})
            if comm.rank == 0:
                found = ", ".join(f"{key} {value:.2e}" for key, value in found.items())
                print(f"{name:<14} {found}")
        if comm.rank == 0 and args.json:
            args.json.write_text(json.dumps({"rows": rows}, indent=1))
        return
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
