# # Friction: what sticks, what slips
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Scenes whose solution is known (`--scene`):
#
# - `block`: a column is cut by a plane of slope m, and the upper part rests on the lower one. It
#   sticks if the coefficient of friction is larger than m; the stress is then that of the uncut
#   column. If it is smaller, nothing holds the upper part, and an error says so.
# - `wedge`: a block is pushed up a slope. By NAFEMS' benchmark CGS-4 the horizontal force F is the
#   weight G times (m + μ) / (1 - m μ).
# - `cattaneo`: a cylinder is pressed on a half-plane of the same material, by P, then sheared by Q.
#   It sticks where |x| < c only (Cattaneo, 1938; Mindlin, 1949):
#
# $$c = a \sqrt{1 - Q / (\mu P)}, \quad
#   q = \mu p_0 \Bigl(\sqrt{1 - x^2/a^2} - \frac ca \sqrt{1 - x^2/c^2}\Bigr).$$
#
# - `sphere`: a sphere on a half-space, sheared in the same way, then slid. It sticks where r < c
#   only; the formula of c has a cube root in place of the square root (Mindlin, 1949).
# - `roll`: the sphere rolls by one facet in each load step. Both bodies have the same material, so
#   it neither slips nor needs a force.
# - `twist`: a cylinder stands on another one and is turned around its axis. When the whole face
#   slips, the torque is 2/3 μ P R: pressures are the same everywhere, as ν = 0.

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
from hypergap_dolfinx import Contact, ContactProblem, SolveError, progress

# -

E, nu = 1.0, 0.3
SLOPE, PRESSURE = 0.4, 1e-3  # of the block
NEARLY = 1e-6  # how near friction is to what holds it
ANGLE, MU = 0.1, 0.3  # tan α of the wedge
R, a, L = 1.0, 0.0025, 60 * 0.0025  # of Cattaneo's cylinder, and size of both bodies
SHEARED = 0.5  # Q / (μ P), nearly


class Body:
    """A linear elastic body, and the facets with which it touches another one."""

    def __init__(self, mesh, ft, tag, degree, nu=nu):
        """Make its form."""
        dim = mesh.geometry.dim
        self.mesh, self.ft, self.dim = mesh, ft, dim
        self.V = V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
        self.u, self.v = fem.Function(V), ufl.TestFunction(V)
        eps = ufl.sym(ufl.grad(self.u))
        sigma = E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(dim))
        self.F = ufl.inner(sigma, ufl.sym(ufl.grad(self.v))) * ufl.dx
        self.side = V, ft.find(tag)
        self.bcs = []

    def load(self, tag):
        """Add a traction downwards; returns it, for the user to change."""
        load = fem.Constant(self.mesh, default_scalar_type(0))
        ds = ufl.Measure("ds", self.mesh, subdomain_data=self.ft)
        self.F += load * self.v[self.dim - 1] * ds(tag)
        return load

    def hold(self, tag, *components):
        """Hold components, or move them; returns the values."""
        values = []
        for c in components:
            values.append(fem.Constant(self.mesh, default_scalar_type(0)))
            V = self.V.sub(c)
            dofs = fem.locate_dofs_topological(V, self.dim - 1, self.ft.find(tag))
            self.bcs.append(fem.dirichletbc(values[-1], dofs, V))
        return values


def problem(bodies, contact):
    """Both bodies in contact."""
    bcs = [bc for body in bodies for bc in body.bcs]
    forms, u = [body.F for body in bodies], [body.u for body in bodies]
    return ContactProblem(forms, u, bcs=bcs, contacts=[contact], rtol=1e-12)


def column(comm, slope, n, degree, dim):
    """A column, cut by a plane that leans to the left."""
    low, high = 2 * dim - 1, 2 * dim  # tags of the bottom and the top
    bodies, height = [], max(1.0, 2 * slope)
    for i in (0, 1):

        def place(x, i=i):
            x = x.copy()
            z = x[:, -1].copy()
            x[:, -1] = height * (z + i - 1) + slope * x[:, 0] * (1 - z if i else z)
            return x

        cell = "quadrilateral" if dim == 2 else "hexahedron"
        mesh, ft = meshes.block(comm, (*[n[i]] * (dim - 1), 2), place, cell=cell)
        bodies.append(Body(mesh, ft, (high, low)[i], degree))
    bodies[0].hold(low, dim - 1)
    return bodies, high


def block(comm, degree, dim, swap=False, slope=SLOPE):
    """Errors of pressure and shear just above the slope, and whether sliding is told below."""
    bodies, high = column(comm, slope, (2, 3), degree, dim)
    for c in range(dim - 1):
        bodies[0].hold(2 * c + 1, c)
    load = bodies[1].load(high)
    mu = fem.Constant(bodies[0].mesh, default_scalar_type(slope * (1 + NEARLY)))
    sides = [body.side for body in bodies][:: -1 if swap else 1]
    contact = Contact(*sides, friction=mu, sliding="small")
    pair = problem(bodies, contact)
    load.value = PRESSURE
    pair.solve()
    normal = PRESSURE / (1 + slope**2)
    shear = np.linalg.norm(contact.shears(pair)[contact.active], axis=1)
    errors = contact.pressures(pair)[contact.active] / normal - 1, shear / (slope * normal) - 1
    steps = pair.iterations
    mu.value = slope * (1 - NEARLY)
    try:
        pair.solve()
        told = False
    except SolveError as error:
        told = "more than friction can hold" in str(error)
    return {
        "scene": "block",
        "dim": dim,
        "degree": degree,
        "swap": swap,
        "error": float(max(np.abs(part).max() for part in errors)),
        "told": told,
        "steps": steps,
    }


def wedge(comm):
    """The force that pushes a block up a slope, over its weight."""
    bodies, high = column(comm, ANGLE, (2, 3), 1, 2)
    bodies[0].hold(meshes.LEFT, 0)
    load, (push,) = bodies[1].load(high), bodies[1].hold(meshes.LEFT, 0)
    contact = Contact(*(body.side for body in bodies), friction=MU)
    pair = problem(bodies, contact)
    load.value = 1e-6
    pair.solve()
    push.value = 1e-3
    pair.solve()
    force = contact.force(pair)
    exact = (ANGLE + MU) / (1 - ANGLE * MU)
    ratio = abs(force[0] / force[1])
    return {"scene": "wedge", "ratio": float(ratio), "error": float(abs(ratio / exact - 1))}


def grading(h):
    """Positions of nodes from the middle to the end: from 1.5 a on cells become longer."""
    x = np.arange(0, int(np.ceil(1.5 * a / h)) + 1) * h
    while x[-1] < L:
        x = np.append(x, x[-1] + 8 / 7 * (x[-1] - x[-2]))
    return np.append(x[:-2], L)


def cattaneo(comm, cells, degree=1, ratio=0.75, picture=None):
    """Press and shear a cylinder.

    Args:
        comm: Communicator.
        cells: Number of cells of Γ1 in a.
        degree: Of displacements and geometry.
        ratio: Size of the block's cells over the cylinder's, which is Γ1.
        picture: Where to save one, if anywhere.
    """
    h, bodies = a / cells, []
    for i, size in enumerate((ratio * h, h)):
        half = grading(size)
        across, n = np.append(-half[:0:-1], half), len(half) - 1

        def place(s, i=i, half=half, across=across, n=n):
            x = np.interp(s[:, 0], np.linspace(0, 1, 2 * n + 1), across)
            y = np.interp(s[:, 1] if i else 1 - s[:, 1], np.linspace(0, 1, n + 1), half)
            bottom = R - np.sqrt(R**2 - x**2)
            return np.column_stack((x, bottom + y * (1 - bottom / L) if i else -y))

        mesh, ft = meshes.block(comm, (2 * n, n), place, degree=degree)
        bodies.append(Body(mesh, ft, meshes.BOTTOM if i else meshes.TOP, degree))
    bodies[0].hold(meshes.BOTTOM, 0, 1)
    along, down = bodies[1].hold(meshes.TOP, 0, 1)
    contact = Contact(bodies[0].side, bodies[1].side, friction=MU)
    pair = problem(bodies, contact)
    modulus = E / (2 * (1 - nu**2))
    goal = np.pi * modulus * a**2 / (4 * R)
    steps, force = [], 0.0
    down.value = -goal / modulus * 4
    while abs(force / goal - 1) > 1e-3:  # the load that makes the contact as wide
        if force:
            down.value *= goal / force
        pair.solve()
        steps.append(pair.iterations)
        force = contact.force(pair)[1]
    # Tangentially as stiff as normally, nearly
    along.value = SHEARED * MU * abs(down.value) * 0.9
    pair.solve()
    steps.append(pair.iterations)
    shear, force = contact.force(pair)
    half = np.sqrt(4 * force * R / (np.pi * modulus))
    inner = half * np.sqrt(1 - abs(shear) / (MU * force))
    x = contact.surfaces[1].x[:, 0]

    def exact(x):
        p0 = 2 * force / (np.pi * half)
        outer, sticks = (np.sqrt(np.maximum(1 - (x / b) ** 2, 0)) for b in (half, inner))
        return MU * p0 * (outer - inner / half * sticks)

    q = np.abs(contact.shears(pair)[:, 0])
    order = np.argsort(x)
    at = np.linspace(-1.2 * half, 1.2 * half, 20001)
    error = np.interp(at, x[order], q[order]) - exact(at)
    shears = contact.shear(pair, on="surface")  # with edges between nodes
    V = shears.function_space
    ends = V.tabulate_dof_coordinates()[V.dofmap.list][..., 0]  # (cell, end)
    values = np.abs(shears.x.array.reshape(-1, 2)[V.dofmap.list][..., 0])
    ends, values = (np.concatenate(comm.allgather(part)) for part in (ends, values))
    share = (1 + np.polynomial.legendre.leggauss(2)[0]) / 2
    share = np.stack((1 - share, share))
    known = exact(ends @ share)
    square = (np.stack((values @ share - known, known)) ** 2).sum(axis=2)
    on_surface = (square * np.abs(np.diff(ends, axis=1))[:, 0]).sum(axis=1)
    if picture:
        draw(x, contact, pair, exact, inner, (ends, values), picture)
    stuck = np.abs(x[contact.sticking]).max(initial=0)
    return {
        "scene": "cattaneo",
        "cells": cells,
        "l2_shear": float(np.sqrt((error**2).sum() / (exact(at) ** 2).sum())),
        "l2_surface": float(np.sqrt(on_surface[0] / on_surface[1])),
        "off": float((stuck - inner) / h),
        "q_over_mu_p": float(abs(shear) / (MU * force)),
        "steps": steps,
    }


def draw(x, contact, pair, exact, inner, drawn, picture):
    """Shear beside pressure, and where it sticks."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    p, q = contact.pressures(pair), np.abs(contact.shears(pair)[:, 0])
    if contact.spaces[0].mesh.comm.rank:
        return
    scale = MU * p.max()
    fig, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
    axes.axvspan(-inner / a, inner / a, color="0.92")
    axes.text(0, 0.05, "sticks", ha="center")
    order = np.argsort(x)
    at = np.linspace(-1.3 * a, 1.3 * a, 1000)
    axes.plot(at / a, exact(at) / scale, color="0.4", lw=1, label="exact shear")
    axes.plot(x[order] / a, MU * p[order] / scale, "C0", lw=1, label="μ times pressure")
    ends, values = drawn
    order = np.argsort(ends.mean(axis=1))
    axes.plot(ends[order].ravel() / a, values[order].ravel() / scale, "C1", label="on the surface")
    for which, name, marker in (
        (contact.sticking, "shear, sticks", "C2o"),
        (contact.slipping, "shear, slips", "C3o"),
    ):
        axes.plot(x[which] / a, q[which] / scale, marker, ms=3, label=name)
    axes.set(xlim=(-1.3, 1.3), xlabel="x / a", ylabel="traction over μ p₀")
    axes.legend(fontsize=8, loc="center")
    picture.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(picture, dpi=150)


def ball(comm, cells, sliding):
    """A sphere on a half-space, of tetrahedra that grow from 1.2 a on.

    Args:
        comm: Communicator.
        cells: Number of cells of Γ1, the sphere, in a.
        sliding: Of the contact.

    Returns:
        The problem, its contact, and what moves the sphere: down and along, and rolls it.
    """
    bodies, sides, size = [], [], 12 * a
    for i, h in enumerate((0.75 * a / cells, a / cells)):

        def grown(x, y, z, i=i, h=h):
            off = np.linalg.norm((x - 0.5, y - 0.5, z if i else 1 - z)) * size
            return (h + 0.5 * max(off - 1.2 * a, 0)) / size

        def place(s, i=i):
            x = (s - (0.5, 0.5, 1 - i)) * size
            bottom = R - np.sqrt(R**2 - i * (x[:, :2] ** 2).sum(axis=1))
            x[:, 2] = bottom + x[:, 2] * (1 - bottom / size)
            return x

        mesh, ft = meshes.solid_block(comm, grown, place)
        bodies.append(Body(mesh, ft, meshes.BACK if i else meshes.FRONT, 1))
        V, facets = bodies[i].side
        middle = compute_midpoints(mesh, 2, facets)
        sides.append((V, facets[np.linalg.norm(middle[:, :2], axis=1) < 2.5 * a]))
    bodies[0].hold(meshes.BACK, 0, 1, 2)
    goal = fem.Function(bodies[1].V)
    dofs = fem.locate_dofs_topological(bodies[1].V, 2, bodies[1].ft.find(meshes.FRONT))
    bodies[1].bcs.append(fem.dirichletbc(goal, dofs))
    contact = Contact(*sides, friction=MU, sliding=sliding)
    pair = problem(bodies, contact)

    def go(down, along=0.0, turn=0.0):
        def move(x):
            X, Z = x[0], x[2] - R
            cos, sin = np.cos(turn), np.sin(turn)
            xs = cos * X + sin * Z - X + turn * R + along
            return np.array((xs, 0 * X, cos * Z - sin * X - Z - down))

        goal.interpolate(move)
        pair.solve()
        return pair.iterations

    return pair, contact, go


def sphere(comm, cells=6):
    """Press and shear a sphere, then let it slide."""
    pair, contact, go = ball(comm, cells, "small")
    down = 0.95 * a**2 / R
    steps = [go(down), go(down, 0.75 * MU * down)]
    across, _, force = np.abs(contact.force(pair))
    modulus = E / (2 * (1 - nu**2))
    half = (3 * force * R / (4 * modulus)) ** (1 / 3)
    inner = half * (1 - across / (MU * force)) ** (1 / 3)
    r, area = np.linalg.norm(contact.surfaces[1].x[:, :2], axis=1), contact.rows.m
    p0 = 3 * force / (2 * np.pi * half**2)
    outer, sticks = (np.sqrt(np.maximum(1 - (r / b) ** 2, 0)) for b in (half, inner))
    exact = MU * p0 * (outer - inner / half * sticks)
    error = np.linalg.norm(contact.shears(pair), axis=1) - exact
    stuck = r[contact.sticking].max(initial=0)
    steps.append(go(down, 3 * MU * down))
    slid = contact.force(pair)
    return {
        "scene": "sphere",
        "cells": cells,
        "l2_shear": float(np.sqrt((area * error**2).sum() / (area * exact**2).sum())),
        "off": float(abs(stuck - inner) * cells / a),
        "q_over_mu_p": float(across / (MU * force)),
        "slid": float(np.linalg.norm(slid[:2]) / (MU * slid[2])),
        "steps": steps,
    }


def roll(comm, cells=6, num=4):
    """Roll a sphere: forces along over μ times the pressure, and slips over the way."""
    pair, contact, go = ball(comm, cells, "finite")
    down, steps, forces, slips = 0.95 * a**2 / R, [], [], []
    for step in range(num + 1):
        steps.append(go(down, 0.0, step / (cells * R) * a))
        force = contact.force(pair)
        forces.append(np.linalg.norm(force[:2]) / (MU * force[2]))
        slips.append(np.linalg.norm(contact.slips(pair), axis=1).max() * cells / a)
    return {
        "scene": "roll",
        "cells": cells,
        "q_over_mu_p": float(max(forces)),
        "slips": float(max(slips[1:])),
        "steps": steps,
    }


def twist(comm, n=6):
    """The torque of a cylinder that is turned on another one."""
    bodies = []
    for i in (0, 1):

        def place(s, i=i):
            x, y = 2 * s[:, 0] - 1, 2 * s[:, 1] - 1
            disc = x * np.sqrt(1 - y**2 / 2), y * np.sqrt(1 - x**2 / 2)
            return np.column_stack((*disc, i - 1 + s[:, 2]))

        mesh, ft = meshes.block(comm, (n + i, n + i, 1), place, cell="hexahedron", degree=2)
        bodies.append(Body(mesh, ft, meshes.BACK if i else meshes.FRONT, 2, nu=0.0))
    bodies[0].hold(meshes.BACK, 0, 1, 2)
    goal = fem.Function(bodies[1].V)
    dofs = fem.locate_dofs_topological(bodies[1].V, 2, bodies[1].ft.find(meshes.FRONT))
    bodies[1].bcs.append(fem.dirichletbc(goal, dofs))
    contact = Contact(*(body.side for body in bodies), friction=MU)
    pair = problem(bodies, contact)
    steps = []
    for turn in (0, 0.002, 0.01):

        def move(x, turn=turn):
            return np.array((-turn * x[1], turn * x[0], 0 * x[0] - 1e-3))

        goal.interpolate(move)
        pair.solve()
        steps.append(pair.iterations)
    torque = abs(contact.moment(pair, (0.0, 0.0, 0.0))[2])
    force = contact.force(pair)[2]
    return {
        "scene": "twist",
        "torque": float(torque / (MU * force)),
        "error": float(abs(torque / (2 / 3 * MU * force) - 1)),
        "steps": steps,
        "sticking": int(contact.sticking.sum()),
    }


def main():
    """Run the scenes."""
    parser = argparse.ArgumentParser(description="What sticks and what slips.")
    others = {"wedge": wedge, "twist": twist, "sphere": sphere, "roll": roll}
    scenes = ("block", "cattaneo", *others)
    parser.add_argument("--scene", choices=scenes, action="append", help="some, instead of all")
    parser.add_argument("--cells", type=int, default=20, help="cells in Cattaneo's half-width")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="save a picture")
    args = parser.parse_args()
    comm, rows = MPI.COMM_WORLD, []
    for scene in args.scene or scenes:
        if scene == "block":
            rows += [block(comm, degree, dim) for dim in (2, 3) for degree in (1, 2)]
        elif scene == "cattaneo":
            picture = args.plot / "friction.png" if args.plot else None
            rows.append(cattaneo(comm, args.cells, picture=picture))
        else:
            rows.append(others[scene](comm))
    progress.show(comm)
    if comm.rank == 0:
        for row in rows:
            print(", ".join(f"{key} {show(value)}" for key, value in row.items()))
        if args.json:
            args.json.write_text(json.dumps({"rows": rows}, indent=1))


def show(value):
    """A number in few digits."""
    return f"{value:.3g}" if isinstance(value, float) else value


if __name__ == "__main__":
    main()
