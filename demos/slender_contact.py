# # Contact where it is hard: slender bodies, snaps, corners
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Fourteen scenes in the plane, without friction. In a slender or soft body, closing one vertex
# opens others far away. A clip that snaps has no equilibrium near the last one. A block in a slot
# touches with corners and sides. The table has, for each scene, the load steps, the Newton steps in
# total and in the worst load step, the halved load steps, the largest depth of a vertex in the
# other body at the end of a load step (in facets), and the place where it fails, if it does. All
# bodies are neo-Hookean; the pressing bodies are mostly a hundred times as stiff.
#
# `--scene clip hairpin` runs some of them, `--steps 2` the first load steps only.

# +
import argparse
import json
import sys
import time
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx import mesh as meshing

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Contact, ContactProblem, InterfaceError, SolveError, progress

NU = 0.3
STIFF = 100.0
# -


def energy(u, E, axisymmetric):
    """Compressible neo-Hookean material in plane strain, or around the axis x = 0."""
    mu, lame = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
    F = ufl.Identity(2) + ufl.grad(u)
    r = ufl.SpatialCoordinate(u.function_space.mesh)[0]
    around = 1 + u[0] / r if axisymmetric else 1
    log = ufl.ln(ufl.det(F) * around)
    W = mu / 2 * (ufl.inner(F, F) + around**2 - 3 - 2 * log) + lame / 2 * log**2
    return W * r if axisymmetric else W


class Body:
    """A block of cells in any shape."""

    def __init__(self, comm, n, place, E=1.0, ring=False, rigid=False, axisymmetric=False):
        """Mesh it.

        Args:
            comm: Communicator.
            n: Number of cells along both axes of the unit square.
            place: Where points of the unit square are, ``(num_points, 2)``.
            E: Young's modulus.
            ring: Whether the second axis goes around, and its end is its start.
            rigid: Whether it is an obstacle.
            axisymmetric: Whether its section is that of a solid of revolution.
        """
        self.mesh, self.tags = meshes.block(comm, n, place, periodic=ring)
        self.V = fem.functionspace(self.mesh, ("Lagrange", 1, (2,)))
        self.u, self.F, self.bcs, self.paths = fem.Function(self.V), None, [], []
        if not rigid:
            self.weight = fem.Constant(self.mesh, default_scalar_type(0))
            dx = ufl.dx(metadata={"quadrature_degree": 2})
            stiffness = fem.Constant(self.mesh, default_scalar_type(E))
            W = energy(self.u, stiffness, axisymmetric) + self.weight * self.u[1]
            self.F = ufl.derivative(W * dx, self.u)

    def side(self, *tags):
        """The body's facets with tags, for a contact."""
        return self.V, np.sort(np.concatenate([self.tags.find(tag) for tag in tags]))

    def hold(self, where, path=lambda s, x: (0, 0)):
        """Prescribe displacements.

        Args:
            where: A tag, or a function of places for vertices.
            path: Displacement at a time from 0 to 1, of places ``(2, num_points)``.
        """
        value = fem.Function(self.V)
        self.bcs.append(fem.dirichletbc(value, self._dofs(self.V, where)))

        def go(s):
            value.interpolate(lambda x: np.array([0 * x[0] + part for part in path(s, x[:2])]))

        self.paths.append(go)

    def hold_along(self, axis, where, path=lambda s: 0):
        """Prescribe one component; as :meth:`hold`, the same everywhere."""
        value, V = fem.Constant(self.mesh, default_scalar_type(0)), self.V.sub(axis)
        self.bcs.append(fem.dirichletbc(value, self._dofs(V, where), V))
        self.paths.append(lambda s: setattr(value, "value", path(s)))

    def _dofs(self, V, where):
        if callable(where):
            return fem.locate_dofs_topological(V, 0, meshing.locate_entities(self.mesh, 0, where))
        return fem.locate_dofs_topological(V, 1, self.tags.find(where))

    def weigh(self, path):
        """Give it a weight per area, over time."""
        self.paths.append(lambda s: setattr(self.weight, "value", path(s)))

    def move(self, path):
        """Move an obstacle, over time."""

        def go(s):
            self.u.x.array[:] = np.tile(path(s), len(self.u.x.array) // 2)

        self.paths.append(go)

    def cells(self):
        """Corners of its cells where they are, ``(num_cells, 4, 2)``, on rank 0. Collective."""
        nodes = self.V.dofmap.list[: self.mesh.topology.index_map(2).size_local]
        x = self.V.tabulate_dof_coordinates()[nodes, :2] + self.u.x.array.reshape(-1, 2)[nodes]
        parts = self.mesh.comm.gather(x[:, [0, 1, 3, 2]])
        return parts and np.concatenate(parts)


class Scene:
    """Bodies in contact, and their load steps."""

    def __init__(self, num, bodies, contacts):
        """Set up the problem.

        Args:
            num: Number of load steps.
            bodies: The bodies.
            contacts: The contacts between them.
        """
        self.num, self.bodies, self.contacts = num, bodies, contacts
        bcs = [bc for body in bodies for bc in body.bcs]
        F, u = [body.F for body in bodies], [body.u for body in bodies]
        self.problem = ContactProblem(F, u, bcs=bcs, contacts=contacts)

    def go(self, most, name):
        """Solve the load steps; one that fails is the last one.

        Args:
            most: Number of load steps to do at most.
            name: Name to show.
        """
        start, count, overlaps, error = time.perf_counter(), [], [], None
        halvings, comm = 0, self.bodies[0].mesh.comm
        for step in range(1, min(self.num, most) + 1):
            for go in (go for body in self.bodies for go in body.paths):
                go(step / self.num)
            progress.show(comm, f"{name}, load step {step}: {sum(count)} Newton steps so far")
            try:
                self.problem.solve()
            except (SolveError, InterfaceError) as failed:
                error = str(failed)
            count.append(self.problem.iterations)
            halvings += self.problem.halvings
            if error:
                break
            overlaps.append(self.overlap())
        row = {"scene": name, "load_steps": len(count), "newton_steps": sum(count)}
        row |= {"most": max(count), "each": count, "halvings": halvings}
        row |= {"failed_at": len(count) if error else None, "error": error}
        row["overlap"] = max(overlaps, default=None)
        if not error:
            row["touching"] = [int(contact.active.sum()) for contact in self.contacts]
            row["forces"] = [contact.force(self.problem).tolist() for contact in self.contacts]
        return row | {"seconds": time.perf_counter() - start}

    def overlap(self):
        """Largest depth of a side's vertex in the other body, in Γ1's mean facet. Collective."""
        found = 0.0
        for contact in self.contacts:
            sides = contact.displaced(self.problem)
            size = sides[1].size.mean()
            for i, points in enumerate(side.x for side in sides):
                body = next(b for b in self.bodies if b.V == contact.spaces[1 - i])
                cells = body.mesh.comm.bcast(body.cells())
                edges = sides[1 - i].x[sides[1 - i].facets]
                depth = distances(points[are_inside(points, cells, 1e-9 * size)], edges)
                found = max(found, depth.max(initial=0) / size)
        return float(found)


def are_inside(points, cells, tolerance):
    """Mask of the points in any of convex cells, ``(num_cells, 4, 2)``."""
    along = np.roll(cells, -1, axis=1) - cells
    normal = np.stack((-along[..., 1], along[..., 0]), axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    turn = np.sign(np.einsum("cki,cki->c", normal, cells.mean(axis=1, keepdims=True) - cells))
    inside = [
        (np.einsum("cki,cki->ck", normal, x - cells) * turn[:, None] > tolerance).all(axis=1).any()
        for x in points
    ]
    return np.array(inside, dtype=bool)


def distances(points, edges):
    """Distances of points to the nearest of edges, ``(num_edges, 2, 2)``."""
    along, away = edges[:, 1] - edges[:, 0], points[:, None] - edges[:, 0]
    s = np.einsum("pei,ei->pe", away, along) / np.einsum("ei,ei->e", along, along)
    feet = edges[:, 0] + np.clip(s, 0, 1)[..., None] * along
    return np.linalg.norm(points[:, None] - feet, axis=2).min(axis=1, initial=np.inf)


# ## Shapes: maps of the unit square


def slab(low, high):
    """A rectangle."""
    return lambda s: np.array(low) + s * np.subtract(high, low)


def rounded(middle, level, radius, width, height, up=1):
    """A block with a round top (or bottom, if `up` is -1), which reaches to a level."""

    def place(s):
        across = width * (s[:, 0] - 0.5)
        part = s[:, 1] if up == 1 else 1 - s[:, 1]
        bulge = np.sqrt(radius**2 - across**2) - radius
        return np.column_stack((middle + across, level + up * (part * bulge - (1 - part) * height)))

    return place


def ring(inner, outer, start=0.0, angle=2 * np.pi, centre=(0, 0)):
    """A ring or a sector of one; its inside is LEFT, its outside RIGHT."""

    def place(s):
        r, theta = inner + (outer - inner) * s[:, 0], start + angle * s[:, 1]
        return centre + r[:, None] * np.column_stack((np.cos(theta), np.sin(theta)))

    return place


def straight(*path):
    """Moves along a line in equal steps."""
    return lambda s, x: (s * path[0], s * path[1])


# ## Stocky bodies


def hertz(comm):
    """A round block comes down from a distance."""
    below = Body(comm, (32, 16), slab((-1, -1), (1, 0)))
    above = Body(comm, (16, 8), rounded(0, 0.02, 1, 1, 0.5, -1))
    below.hold(meshes.BOTTOM)
    above.hold(meshes.TOP, straight(0, -0.1))
    contact = Contact(below.side(meshes.TOP), above.side(meshes.BOTTOM))
    return Scene(3, [below, above], [contact])


def punch(comm):
    """A stiff one with sharp corners."""
    below = Body(comm, (40, 20), slab((-2, -2), (2, 0)))
    above = Body(comm, (8, 4), slab((-0.53, 0), (0.53, 0.5)), STIFF)
    below.hold(meshes.BOTTOM)
    above.hold(meshes.TOP, straight(0, -0.1))
    contact = Contact(above.side(meshes.BOTTOM), below.side(meshes.TOP))
    return Scene(3, [below, above], [contact])


def saw(comm):
    """A rigid one of four teeth, pressed until its notches are nearly full."""

    def place(s):
        notch = np.abs((4 * s[:, 0] + 0.5) % 1 - 0.5) * 0.3
        return np.column_stack((2 * s[:, 0] - 1, 0.16 - notch * (1 - s[:, 1]) + 0.2 * s[:, 1]))

    below = Body(comm, (40, 16), slab((-1.2, -1), (1.2, 0)))
    above = Body(comm, (40, 1), place, rigid=True)
    below.hold(meshes.BOTTOM)
    above.move(lambda s: (0, -0.01 - 0.13 * s))
    contact = Contact(above.side(meshes.BOTTOM), below.side(meshes.TOP))
    return Scene(4, [below, above], [contact])


def ironing(comm, cells):
    """A die is pressed down in 3 load steps, and drawn along by a number of cells in each of 10."""
    size, num = 0.1, 13

    def path(s, x):
        return cells * size * max(num * s - 3, 0), -0.1 * min(num * s / 3, 1)

    below = Body(comm, (70, 10), slab((0, -1), (7, 0)))
    above = Body(comm, (11, 6), rounded(1, 0, 2, 1.6, 0.8, -1), 10.0)
    below.hold(meshes.BOTTOM)
    above.hold(meshes.TOP, path)
    contact = Contact(above.side(meshes.BOTTOM), below.side(meshes.TOP))
    return Scene(num, [below, above], [contact])


def ellipse(comm):
    """A hollow ellipse, tilted, that nothing but a cup holds finds its place."""
    turn = np.array(((np.cos(0.3), np.sin(0.3)), (-np.sin(0.3), np.cos(0.3))))

    def place(s):
        x = ring(0.5, 1)(s) * (0.9, 0.55) @ turn
        rim = ring(1, 1)(np.linspace((0, 0), (0, 1), 400)) * (0.9, 0.55) @ turn
        down = next(d for d in np.linspace(1.3, 0, 1301) if _reach(rim - (0, d)) < 1.28)
        return x - (0, down)

    cup = Body(comm, (3, 40), ring(1.3, 1.7, np.pi, np.pi))
    free = Body(comm, (3, 40), place, ring=True)
    cup.hold(meshes.RIGHT)
    free.weigh(lambda s: 0.02 * s)
    contact = Contact(cup.side(meshes.LEFT), free.side(meshes.RIGHT))
    return Scene(3, [cup, free], [contact])


def _reach(x):
    """Largest distance from the origin."""
    return np.linalg.norm(x, axis=1).max()


def slot(comm):
    """A block pressed into a slot: its corners in the slot's, its sides at the walls."""
    inner = np.array(((-0.51, 1), (-0.51, 0), (0.51, 0), (0.51, 1)))
    outer = np.array(((-1, 1), (-1, -0.5), (1, -0.5), (1, 1)))
    knots = np.array((0, 10, 20, 30)) / 30

    def place(s):
        sides = [[np.interp(s[:, 0], knots, x) for x in side.T] for side in (outer, inner)]
        return ((1 - s[:, 1]) * sides[0] + s[:, 1] * sides[1]).T

    below = Body(comm, (30, 4), place)
    above = Body(comm, (11, 9), slab((-0.5, 0.01), (0.5, 0.91)))
    below.hold(meshes.BOTTOM)
    above.hold(meshes.TOP, straight(0, -0.15))
    touching = above.side(meshes.LEFT, meshes.BOTTOM, meshes.RIGHT)
    return Scene(3, [below, above], [Contact(below.side(meshes.TOP), touching)])


# ## Slender bodies


def rollers(comm):
    """A beam 40 times as long as thick, on two rollers, under a third one."""
    beam = Body(comm, (120, 2), slab((-2, 0), (2, 0.1)))
    low = [Body(comm, (12, 4), rounded(x, -0.01, 0.3, 0.5, 0.3), STIFF) for x in (-1.5, 1.5)]
    high = Body(comm, (12, 4), rounded(0, 0.11, 0.3, 0.5, 0.3, -1), STIFF)
    beam.hold_along(0, lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0))
    for roller in low:
        roller.hold(meshes.BOTTOM)
    high.hold(meshes.TOP, straight(0, -0.6))
    contacts = [Contact(b.side(meshes.TOP), beam.side(meshes.BOTTOM)) for b in low]
    contacts.append(Contact(high.side(meshes.BOTTOM), beam.side(meshes.TOP)))
    return Scene(5, [beam, *low, high], contacts)


def clip(comm, thickness):
    """A clip of length 2 is pushed along until its nose snaps over a pin."""

    def place(s):
        x = 2 * s[:, 0]
        nose = 0.18 * np.sin(np.pi * np.clip((x - 1.6) / 0.4, 0, 1)) ** 2
        return np.column_stack((x, thickness * s[:, 1] - nose * (1 - s[:, 1])))

    pin = Body(comm, (2, 32), ring(0.05, 0.15, centre=(2.25, -0.2)), STIFF, ring=True)
    strip = Body(comm, (100, 2), place)
    pin.hold(meshes.LEFT)
    strip.hold(meshes.LEFT, straight(1, 0))
    contact = Contact(pin.side(meshes.RIGHT), strip.side(meshes.BOTTOM))
    return Scene(12, [pin, strip], [contact])


def hairpin(comm):
    """A bent strip, 130 times as long as thick, whose ends turn until its legs touch."""
    leg, gap, thickness = 1.8, 0.2, 0.03
    bend = np.pi * gap / 2

    def place(s):
        along = (2 * leg + bend) * s[:, 0]
        angle = np.clip((along - leg) / (gap / 2), 0, np.pi)
        x = np.minimum(along, leg) - np.maximum(along - leg - bend, 0)
        centre = np.column_stack((x, 0 * x))
        r = gap / 2 + thickness * (0.5 - s[:, 1])
        return centre + r[:, None] * np.column_stack((np.sin(angle), -np.cos(angle)))

    def turned(sign):
        def path(s, x):
            angle, y = -sign * 0.6 * s, x[1] - sign * gap / 2
            return -np.sin(angle) * y, (np.cos(angle) - 1) * y

        return path

    strip = Body(comm, (130, 2), place)
    strip.hold(meshes.LEFT, turned(-1))
    strip.hold(meshes.RIGHT, turned(1))
    V, inside = strip.side(meshes.TOP)
    x = meshing.compute_midpoints(strip.mesh, 1, inside)
    legs = [(V, inside[(x[:, 0] < leg) & (sign * x[:, 1] > 0)]) for sign in (-1, 1)]
    return Scene(6, [strip], [Contact(*legs)])


def squeezed(comm):
    """A thin ring between plates that come together by 60 % of its diameter."""
    hoop = Body(comm, (2, 120), ring(0.97, 1.03), ring=True)
    low = Body(comm, (70, 1), slab((-1.8, -1.2), (1.8, -1.04)), STIFF)
    high = Body(comm, (70, 1), slab((-1.8, 1.04), (1.8, 1.2)), STIFF)
    hoop.hold_along(0, lambda x: np.isclose(x[0], 0) & np.isclose(np.abs(x[1]), 0.97))
    low.hold(meshes.BOTTOM)
    high.hold(meshes.TOP, straight(0, -0.6 * 2.06))
    contacts = [
        Contact(low.side(meshes.TOP), hoop.side(meshes.RIGHT)),
        Contact(high.side(meshes.BOTTOM), hoop.side(meshes.RIGHT)),
    ]
    return Scene(7, [hoop, low, high], contacts)


def wrap(comm):
    """A strip, 150 times as long as thick, is wrapped around half of a cylinder."""
    radius, half, thickness, gap = 0.5, 1.5, 0.02, 0.002
    middle = radius + gap + thickness / 2

    def path(sign):
        def move(s, x):
            angle = 1.5 * s
            left = half - middle * angle
            across = middle * np.sin(angle) + left * np.cos(angle) - half
            down = middle * (1 - np.cos(angle)) + left * np.sin(angle)
            return sign * across, -down

        return move

    cylinder = Body(comm, (2, 120), ring(0.3, radius), STIFF, ring=True)
    strip = Body(comm, (120, 2), slab((-half, radius + gap), (half, radius + gap + thickness)))
    cylinder.hold(meshes.LEFT)
    for sign in (-1, 1):  # the middles of its ends, which are free to turn
        strip.hold(
            lambda x, sign=sign: np.isclose(x[0], sign * half) & np.isclose(x[1], middle),
            path(sign),
        )
    contact = Contact(cylinder.side(meshes.RIGHT), strip.side(meshes.BOTTOM))
    return Scene(8, [cylinder, strip], [contact])


def arch(comm):
    """A clamped arch under a die that isn't in its middle snaps through."""
    rise, thickness = 0.3, 0.04
    radius = (1 + rise**2) / (2 * rise)
    angle = 2 * np.arcsin(1 / radius)

    def place(s):
        theta = (np.pi + angle) / 2 - angle * s[:, 0]
        r = radius + thickness * (s[:, 1] - 0.5)
        return np.column_stack((r * np.cos(theta), r * np.sin(theta) - radius + rise))

    bow = Body(comm, (60, 2), place)
    die = Body(comm, (12, 4), rounded(0.1, rise + thickness / 2, 0.3, 0.4, 0.2, -1), STIFF)
    for end in (meshes.LEFT, meshes.RIGHT):
        bow.hold(end)
    die.hold(meshes.TOP, straight(0, -0.7))
    contact = Contact(die.side(meshes.BOTTOM), bow.side(meshes.TOP))
    return Scene(6, [bow, die], [contact])


SCENES = {
    "hertz": hertz,
    "punch": punch,
    "saw": saw,
    "ironing": lambda comm: ironing(comm, 1 / 3),
    "ironing_far": lambda comm: ironing(comm, 5),
    "ellipse": ellipse,
    "rollers": rollers,
    "clip": lambda comm: clip(comm, 0.06),
    "hairpin": hairpin,
    "squeezed": squeezed,
    "wrap": wrap,
    "clip_thin": lambda comm: clip(comm, 0.03),
    "arch": arch,
    "slot": slot,
}


def picture(scenes, file):
    """Draw bodies where they are in the end.

    Args:
        scenes: Corners of the cells of each scene's bodies.
        file: Where to save it.
    """
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt
    from matplotlib.collections import PolyCollection

    across = min(5, len(scenes))
    down = -(-len(scenes) // across)
    size = 3.5 * across, 3 * down
    fig, axes = plt.subplots(down, across, figsize=size, layout="constrained", squeeze=False)
    for ax in axes.ravel():
        ax.axis("off")
    for ax, (name, cells) in zip(axes.ravel(), scenes.items(), strict=False):
        for k, body in enumerate(cells):
            colour = ("#c6dbef", "#fdae61", "#c7e9c0")[k % 3]
            ax.add_collection(PolyCollection(body, fc=colour, ec="0.3", lw=0.3))
        ax.set_title(name.replace("_", " "))
        ax.axis("equal")
    file.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(file, dpi=100)
    plt.close(fig)


def main():
    """Run the scenes, and say what they took."""
    parser = argparse.ArgumentParser(description="Slender bodies, snaps and corners in contact.")
    parser.add_argument("--scene", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--steps", type=int, default=1000, help="load steps to do at most, in each")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="save a picture")
    args = parser.parse_args()
    comm, rows, drawn = MPI.COMM_WORLD, [], {}
    if comm.rank == 0:
        print("scene        load steps  Newton steps  most  halvings  overlap  failed at  seconds")
    for name in args.scene:
        scene = SCENES[name](comm)
        rows.append(scene.go(args.steps, name))
        progress.show(comm)
        row = rows[-1]
        if args.plot:
            drawn[name] = [body.cells() for body in scene.bodies]
        if comm.rank == 0:
            print(f"{name:12s} {row['load_steps']:10d}  {row['newton_steps']:12d}", end="")
            print(f"  {row['most']:4d}  {row['halvings']:8d}", end="")
            print("        -" if row["overlap"] is None else f"  {row['overlap']:7.3f}", end="")
            print(f"  {row['failed_at'] or '-':>9}  {row['seconds']:7.1f}", flush=True)
            if row["error"]:
                print(f"    {row['error']}", flush=True)
            if args.json:
                args.json.write_text(json.dumps({"rows": rows}, indent=1))
    total, halved = (sum(row[key] for row in rows) for key in ("newton_steps", "halvings"))
    failed = sum(row["failed_at"] is not None for row in rows)
    if comm.rank == 0:
        print(f"{len(rows)} scenes: {total} Newton steps, {halved} halvings, {failed} fail")
        if args.plot:
            picture(drawn, args.plot / "slender_contact.png")


if __name__ == "__main__":
    main()
