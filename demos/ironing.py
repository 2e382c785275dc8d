# # Ironing: a die is pressed into a foundation and drawn along it
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Large deformation and finite sliding, without friction by default. The die is ten times as stiff
# as the foundation; both are neo-Hookean. It is pressed down in a few load steps, then drawn along.
# Without friction its reaction should be vertical, except near the ends of the foundation. Its
# oscillation as nodes pass each other is the *ripple* of the method.
#
# Without friction the scene is conservative: the reaction is the derivative of the stored energy.
# To check this, each load step is followed by one of a ten-thousandth of a cell. (Over a whole load
# step, a third of a cell, the mean of two forces gives the work to two or three digits only, and
# the reaction has kinks where a corner's pressure passes from facet to facet.)
#
# With friction (`--friction 0.3`) work is dissipated. `--back` draws the die back at the end. When
# the whole surface slips, shear over pressure is the coefficient of friction to round-off.
# Horizontal over vertical force is not, since the dented surface is tilted: it is within 1 % of it
# (`--friction 0.5`).

# +
import argparse
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Contact, ContactProblem, progress

# -

H = 0.12  # size of the foundation's cells
LENGTH, DEPTH = 50 * H, 10 * H  # of the foundation
WIDTH, HEIGHT, R = 16 * H, 8 * H, 20 * H  # of the die, radius of its curved bottom
DOWN, PRESSING = H, 4  # how far the die goes down, in how many load steps
SMALL = 1e-4 * H  # a step over which the mean of two forces is their work
RTOL = 1e-12  # so small a work asks for exact gaps
# In space: half of a spherical die and its foundation, with a disc of about ten cells in contact
SOLID = (26 * H, 9 * H, 5 * H), (14 * H, 7 * H, 5 * H)  # foundation, die
SOLID_CELLS = (26, 9, 5), (17, 9, 4)


def energy(u, E, nu=0.32):
    """Compressible neo-Hookean material."""
    mu, lame = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    dim = len(u)
    F = ufl.Identity(dim) + ufl.grad(u)
    J = ufl.det(F)
    return mu / 2 * (ufl.inner(F, F) - dim - 2 * ufl.ln(J)) + lame / 2 * ufl.ln(J) ** 2


def mises(u, E, nu=0.32):
    """Its equivalent stress (Cauchy), in plane strain or in space."""
    mu, lame = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    F = ufl.Identity(len(u)) + ufl.grad(u)
    J = ufl.det(F)
    b = ufl.as_tensor([[(F * F.T)[i, j] if max(i, j) < len(u) else float(i == j)
                        for j in range(3)] for i in range(3)])  # fmt: skip
    stress = (mu * (b - ufl.Identity(3)) + lame * ufl.ln(J) * ufl.Identity(3)) / J
    return ufl.sqrt(1.5 * ufl.inner(ufl.dev(stress), ufl.dev(stress)))


class Ironing:
    """The scene."""

    def __init__(self, comm, degree=1, flat=False, swap=False, dim=2, friction=None, coarse=False):
        """Make it.

        Args:
            comm: Communicator.
            degree: Of displacements and geometry.
            flat: Whether the die is flat, with corners.
            swap: Whether Γ1 is the die instead of the foundation.
            dim: Number of dimensions.
            friction: Its coefficient.
            coarse: Whether cells are twice as long.
        """
        sizes = ((LENGTH, DEPTH), (WIDTH, HEIGHT)) if dim == 2 else SOLID
        cells = ((50, 10), (11, 6)) if dim == 2 else SOLID_CELLS
        if coarse:
            cells = [[(n + 1) // 2 for n in numbers] for numbers in cells]
        start = np.zeros(dim)  # of the die's middle
        start[0] = 0.25 * LENGTH if dim == 2 else 10 * H

        def foundation(x):
            x = x * sizes[0]
            x[:, -1] -= sizes[0][-1]
            return x

        def die(x):
            x = x * sizes[1]
            x[:, 0] -= sizes[1][0] / 2
            square = (x[:, :-1] ** 2).sum(axis=1)
            bottom = 0 * square if flat else R - np.sqrt(R**2 - square)
            x[:, -1] = bottom + x[:, -1] * (1 - bottom / sizes[1][-1])
            return start + x

        self.u, self.energies, self.mises, F, bcs, sides = [], [], [], [], [], []
        self.goal = None
        low, high = 2 * dim - 1, 2 * dim  # tags of the bottom and the top
        for place, n, E, tags in (
            (foundation, cells[0], 1.0, (high, low)),
            (die, cells[1], 10.0, (low, high)),
        ):
            cell = "quadrilateral" if dim == 2 else "hexahedron"
            mesh, ft = meshes.block(comm, n, place, cell=cell, degree=degree)
            V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
            u = fem.Function(V)
            dx = ufl.dx(metadata={"quadrature_degree": (6 - dim) * degree})
            W = energy(u, fem.Constant(mesh, default_scalar_type(E))) * dx
            self.goal = fem.Constant(mesh, default_scalar_type((0,) * dim))
            dofs = fem.locate_dofs_topological(V, dim - 1, ft.find(tags[1]))
            bcs.append(fem.dirichletbc(self.goal, dofs, V))
            if dim == 3:
                dofs = fem.locate_dofs_topological(V.sub(1), 2, ft.find(meshes.BOTTOM))
                bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(1)))
            self.u.append(u)
            self.energies.append(fem.form(W))
            self.mises.append(mises(u, E))
            F.append(ufl.derivative(W, u))
            sides.append((V, ft.find(tags[0])))
        self.comm = comm
        self.contact = Contact(*(sides if swap else sides[::-1]), friction=friction)
        self.problem = ContactProblem(F, self.u, bcs=bcs, contacts=[self.contact], rtol=RTOL)
        self.swap, self.friction = swap, friction

    def energy(self):
        """The energy that is stored in both bodies."""
        return self.comm.allreduce(sum(fem.assemble_scalar(form) for form in self.energies))

    def solve(self):
        """Move the die to where it is to go; the force on the foundation."""
        self.problem.solve()
        return self.contact.force(self.problem) * (-1 if self.swap else 1)

    def dissipated(self):
        """The energy that the last step took for good."""
        return self.contact.dissipation(self.problem) if self.friction else 0.0

    def along_surfaces(self):
        """Shear over pressure along the surfaces, which needn't be level."""
        rows = self.contact.rows
        p, q = (
            rows.state.p * rows.state.active,
            np.linalg.norm(rows.state.q * rows.state.active, axis=0),
        )
        return (q @ rows.m) / (p @ rows.m)

    def go(self, steps, size, back=0, film=None):
        """Press and iron.

        Args:
            steps: Number of load steps along.
            size: Their size, in cells of the foundation.
            back: Number of load steps back, behind them.
            film: Takes a picture of each step along, if there is one.
        """
        rows = []
        for step in range(1, PRESSING + steps + back + 1):
            down = DOWN * min(step / PRESSING, 1)
            along = (steps - abs(max(step - PRESSING, 0) - steps)) * size * H
            self.goal.value[0], self.goal.value[-1] = along, -down
            force = self.solve()
            rows.append(
                {
                    "step": step,
                    "fx": float(force[0]),
                    "fy": float(force[-1]),
                    "iterations": self.problem.iterations,
                    "halvings": self.problem.halvings,
                }
            )
            if self.friction:
                rows[-1]["along_surfaces"] = float(self.along_surfaces())
            if film and step > PRESSING:
                film.add(along / H, force)
            energy, move = self.energy(), np.zeros(len(force))
            move[0] = SMALL * (1 if step <= PRESSING + steps else -1)
            self.goal.value[:] += move
            work = 0.5 * (force + self.solve()) @ move
            stored = self.energy() - energy
            error = abs(stored + self.dissipated() - work) / (np.linalg.norm(force) * SMALL)
            rows[-1]["energy_error"] = float(error)
            progress.show(self.comm, f"step {step}: {rows[-1]['iterations']} Newton steps")
        return rows


# ## A moving picture


class Film:
    """The bodies with their stress, the pressure between them and the reaction, step by step."""

    def __init__(self, scene):
        """Nothing taken yet."""
        self.scene, self.largest = scene, None
        self.images, self.path, self.forces = [], [], []

    def add(self, along, force):
        """Take a picture. Collective."""
        from hypergap_dolfinx import files, plot

        contact, problem = self.scene.contact, self.scene.problem
        if self.largest is None:
            self.largest = 1.2 * contact.pressures(problem).max()
        bodies = zip(self.scene.mises, self.scene.u, strict=True)
        stress = [files.interpolated(s, u.function_space.mesh, 1, "stress") for s, u in bodies]
        plotter = plot.contact(contact, problem, largest=self.largest, values=stress)
        self.path.append(along)
        self.forces.append(np.abs(force[[0, -1]]))
        if plotter:
            plotter.remove_scalar_bar()
            if len(force) == 2:  # always the same part of the plane
                plotter.camera.focal_point = LENGTH / 2, 0, 0
                plotter.camera.position = LENGTH / 2, 0, 10
                plotter.camera.parallel_scale = 0.4 * LENGTH
            for text in list(plotter.actors.values()):
                if type(text).__name__ == "CornerAnnotation":
                    plotter.remove_actor(text)
            self.images.append(plotter.screenshot(None, return_img=True)[225:700, 60:980])
            plotter.close()

    def save(self, folder):
        """Save the film, and its last picture."""
        import matplotlib

        matplotlib.use("agg")
        import matplotlib.pyplot as plt
        from matplotlib.animation import FuncAnimation, PillowWriter

        folder.mkdir(parents=True, exist_ok=True)
        fig, (above, below) = plt.subplots(
            2, figsize=(7, 5), height_ratios=(7, 2), layout="compressed"
        )
        image = above.imshow(self.images[0])
        above.axis("off")
        shear = ", green: friction" if self.scene.friction else ""
        above.set_title(f"blue: equivalent stress, red: pressure{shear}", fontsize=10)
        forces = np.array(self.forces)
        lines = [below.plot([], [], label=name)[0] for name in ("horizontal", "vertical")]
        below.set(xlabel="way along, in cells", ylabel="reaction")
        below.set(xlim=(0, max(self.path)), ylim=(-0.05 * forces.max(), 1.15 * forces.max()))
        below.legend(loc="center right", ncols=2)

        def show(k):
            image.set_data(self.images[k])
            for line, values in zip(lines, forces.T, strict=True):
                line.set_data(self.path[: k + 1], values[: k + 1])
            return image, *lines

        film = FuncAnimation(fig, show, frames=len(self.images))
        film.save(folder / "ironing.gif", writer=PillowWriter(fps=10), dpi=100)
        show(len(self.images) - 1)
        fig.savefig(folder / "ironing.png", dpi=100)


def main():
    """Iron, and say what it took."""
    parser = argparse.ArgumentParser(description="A die is drawn along a foundation.")
    parser.add_argument("--dim", type=int, choices=(2, 3), default=2)
    parser.add_argument("--degree", type=int, choices=(1, 2), default=1)
    parser.add_argument("--flat", action="store_true", help="a flat die with corners")
    parser.add_argument("--swap", action="store_true", help="Γ1 is the die")
    parser.add_argument(
        "--coarse", action="store_true", help="cells twice as long, for degree 2 in space"
    )
    parser.add_argument("--step", type=float, default=1 / 3, help="size of load steps, in cells")
    parser.add_argument("--steps", type=int, default=60, help="number of load steps along")
    parser.add_argument("--back", type=int, default=0, help="number of load steps back")
    parser.add_argument("--friction", type=float, metavar="μ")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="save a GIF")
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    scene = Ironing(comm, args.degree, args.flat, args.swap, args.dim, args.friction, args.coarse)
    film = Film(scene) if args.plot else None
    rows = scene.go(args.steps, args.step, args.back, film)
    progress.show(comm)
    along = rows[PRESSING:]
    fy = np.array([row["fy"] for row in along])
    ripple = fy - np.convolve(np.pad(fy, 3, "edge"), np.ones(7) / 7, "valid")
    count = np.array([row["iterations"] for row in along])
    if comm.rank == 0:
        print(f"Newton steps a load step: {count.mean():.1f}, at most {count.max()}")
        print(f"halved load steps: {sum(row['halvings'] for row in rows)}")
        if args.friction:
            slips = along[args.steps // 4 : args.steps]
            ratio = np.abs([row["fx"] / row["fy"] for row in slips])
            print(f"horizontal over vertical force: {ratio.mean():.4f}")
            ratio = np.array([row["along_surfaces"] for row in slips])
            print(f"shear over pressure along the surfaces: {ratio.mean():.10g}")
        largest = np.abs(ripple / fy)[2:-2].max(initial=0)
        print(f"vertical force: {fy.mean():.4f}, ripple {largest:.1e}")
        print(f"reaction against energy: {max(row['energy_error'] for row in rows):.1e}")
        if args.json:
            args.json.write_text(json.dumps({"rows": rows}, indent=1))
        if film:
            film.save(args.plot)


if __name__ == "__main__":
    main()
