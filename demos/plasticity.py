# # Plasticity: a rigid sphere pressed into a half-space, and drawn back
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Brinell's test: a rigid sphere of radius R is pressed into a half-space and drawn back. The
# half-space yields at σ_y (J2, without hardening). A body with a history needs three things:
#
# - stresses in UFL, of the displacement and of the internal variables (here the plastic strain, a
#   function at quadrature points), so that their derivative is the consistent tangent;
# - `accepted=`, a function that updates the history when a load step is solved;
# - `internal_variables=`, the functions of the history. When a load step is halved, loads are
#   interpolated, history is not. When one fails, history goes back.
#
# What is known (Johnson, Contact Mechanics, ch. 6): it yields first where Hertz's pressure is
# 1.60 σ_y, below the surface; the mean pressure, 2/3 of that then, grows up to 2.8 to 3 σ_y, with
# E* a / (σ_y R) of 40 or more; and what springs back, from a dent whose curvature differs from the
# sphere's, is a motion of (9 π P p_m / 16 E*²)^½.
#
# A trap: after a load step the trial stress of yielding points lies on the yield surface to
# round-off. There, a condition `gt(f, 0)` is true at random in the first tangent of the next step,
# which is then the tangent of loading, although the body is unloaded. The first step back takes 33
# Newton steps and is halved (`--threshold 0`). With `gt(f, 1e-8 * sigma_y)` it takes 4.
#
# The scene is axisymmetric: residuals have 2πr in their measures, and so has the contact. Forces
# are those of the whole circle, pressures are per area.

# +
import argparse
import json
from pathlib import Path

from mpi4py import MPI

import numpy as np

import basix
import basix.ufl
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, create_rectangle, locate_entities_boundary
from hypergap_dolfinx import Contact, ContactProblem, progress

# -

R, E, nu = 1.0, 1000.0, 0.3
sigma_y = 1.0
E_star = E / (1 - nu**2)
DEGREE = 2  # of quadrature: 2 × 2 points
# ## Meshes
#
# Cells of the half-space have one size up to 1.2 times the radius of the contact, and grow by 15 %
# from cell to cell beyond. The sphere is a rigid arc with smaller facets, since the half-space is
# Γ1.


def graded(fine, h, size):
    """Coordinates of nodes: equal cells up to a length, then growing ones."""
    x = list(np.linspace(0, fine, round(fine / h) + 1))
    while x[-1] < size:
        x.append(x[-1] + 1.15 * (x[-1] - x[-2]))
    return np.array(x)


def mapped(comm, n, place):
    """A mesh of the unit square's n cells, with nodes elsewhere."""
    mesh = create_rectangle(comm, [(0, 0), (1, 1)], n, CellType.quadrilateral)
    mesh.geometry.x[:, :2] = place(*mesh.geometry.x[:, :2].T).T
    return mesh


def half_space(comm, a, cells):
    """Half a section through it, with the axis on the left."""
    nodes = graded(1.2 * a, a / cells, 20 * a)
    num = len(nodes) - 1

    def place(x, y):
        r, z = (nodes[np.rint(part * num).astype(int)] for part in (x, 1 - y))
        return np.stack((r, -z))

    return mapped(comm, (num, num), place)


def sphere(comm, a, cells):
    """An arc, up to 1.5 times the contact's radius."""
    largest, thick = np.arcsin(1.5 * a / R), 0.2 * a

    def place(x, y):
        radius = R - thick * y
        return np.stack((radius * np.sin(largest * x), R - radius * np.cos(largest * x)))

    return mapped(comm, (3 * cells, 1), place)


# ## The material


def strain(w, x):
    """Of an axisymmetric displacement."""
    g = ufl.sym(ufl.grad(w))
    return ufl.as_tensor([[g[0, 0], 0, g[0, 1]], [0, w[0] / x[0], 0], [g[1, 0], 0, g[1, 1]]])


def entries(tensor):
    """Those that aren't zero."""
    return ufl.as_vector([tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 2]])


def tensor(v):
    """The tensor of these."""
    return ufl.as_tensor([[v[0], 0, v[3]], [0, v[1], 0], [v[3], 0, v[2]]])


class Body:
    """The half-space: residual, plastic strain, energies."""

    def __init__(self, mesh, threshold):
        """Make the forms.

        Args:
            mesh: Half a section.
            threshold: Part of σ_y by which the trial stress is to exceed it where the step is
                plastic.
        """
        self.V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        self.u, v = fem.Function(self.V, name="u"), ufl.TestFunction(self.V)
        x = ufl.SpatialCoordinate(mesh)
        cell = mesh.basix_cell()
        element = basix.ufl.quadrature_element(cell, value_shape=(4,), degree=DEGREE)
        self.plastic = fem.Function(fem.functionspace(mesh, element))  # strain, of the last step
        self.points = basix.make_quadrature(getattr(basix.CellType, cell.name), DEGREE)[0]
        kappa, mu = E / (3 * (1 - 2 * nu)), E / (2 * (1 + nu))
        eps = strain(self.u, x)
        trial = 2 * mu * ufl.dev(eps - tensor(self.plastic))
        size = ufl.sqrt(1.5 * ufl.inner(trial, trial) + (1e-10 * sigma_y) ** 2)
        over = size - sigma_y
        self.yields = ufl.gt(over, threshold * sigma_y)
        stress = ufl.conditional(self.yields, sigma_y / size, 1) * trial
        increment = ufl.conditional(self.yields, over / size, 0) * trial / (2 * mu)
        # Volume changes are elastic, and taken at the cell's middle: else cells that yield lock.
        # Integrals with two quadrature rules are given on two "subdomains", of all cells each:
        # FFCx 0.11 takes u at the points of one rule for those of the other in one kernel
        num = mesh.topology.index_map(2).size_local
        every = [(tag, np.arange(num, dtype=np.int32)) for tag in (1, 2)]
        measure = ufl.Measure("dx", domain=mesh, subdomain_data=every)
        self.dx, middle = (
            measure(tag, metadata={"quadrature_degree": degree, "quadrature_scheme": "default"})
            for tag, degree in ((1, DEGREE), (2, 1))
        )
        round_ = 2 * np.pi * x[0]
        pressure = kappa * ufl.tr(eps)
        self.F = round_ * ufl.inner(stress, strain(v, x)) * self.dx
        self.F += round_ * pressure * ufl.tr(strain(v, x)) * middle
        total = tensor(self.plastic) + increment
        elastic = ufl.dev(eps) - total
        energy = round_ * mu * ufl.inner(elastic, elastic) * self.dx
        self._energy = fem.form(energy + round_ * pressure * ufl.tr(eps) / 2 * middle)
        self._lost = fem.form(round_ * ufl.inner(stress, increment) * self.dx)
        self._new = fem.Expression(entries(total), self.points)
        self._mises = fem.Expression(size, self.points)
        self.dissipated = 0.0

    def accept(self, share):
        """Move the history on."""
        self.dissipated += self._sum(self._lost)
        self.plastic.interpolate(self._new)

    def energy(self):
        """Elastic energy; after :meth:`accept`, which leaves no increment."""
        return self._sum(self._energy)

    def largest_mises(self):
        """Largest equivalent stress."""
        cells = np.arange(self.V.mesh.topology.index_map(2).size_local, dtype=np.int32)
        return self.V.mesh.comm.allreduce(self._mises.eval(self.V.mesh, cells).max(), MPI.MAX)

    def _sum(self, form):
        return self.V.mesh.comm.allreduce(fem.assemble_scalar(form))


class Scene:
    """Sphere and half-space."""

    def __init__(self, comm, a, cells, threshold):
        """Make the problem; a is the contact's radius in the end."""
        self.a = a
        self.body = Body(half_space(comm, a, cells), threshold)
        arc = sphere(comm, a, cells)
        self.ball = fem.Function(fem.functionspace(arc, ("Lagrange", 1, (2,))))
        V, depth = self.body.V, 20 * a
        bcs = [self._held(0, lambda x: np.isclose(x[0], 0))]
        bcs += [self._held(i, lambda x: x[1] < -depth * (1 - 1e-9)) for i in (0, 1)]
        top = locate_entities_boundary(V.mesh, 1, lambda x: np.isclose(x[1], 0) & (x[0] < 1.5 * a))
        outer = locate_entities_boundary(
            arc, 1, lambda x: np.isclose(np.hypot(x[0], x[1] - R), R, atol=1e-3 * a**2, rtol=0)
        )
        sides = (self.ball.function_space, outer), (V, top)
        self.contact = Contact(*sides, axisymmetric=True)
        self.problem = ContactProblem(
            [None, self.body.F],
            [self.ball, self.body.u],
            bcs=bcs,
            contacts=[self.contact],
            accepted=self.body.accept,
            internal_variables=[self.body.plastic],
        )

    def _held(self, i, where):
        V = self.body.V.sub(i)
        facets = locate_entities_boundary(V.mesh, 1, where)
        return fem.dirichletbc(0.0, fem.locate_dofs_topological(V, 1, facets), V)

    def go(self, depth):
        """Solve with the sphere at a depth; the force."""
        self.ball.x.array[1::2] = -depth
        self.problem.solve()
        return -self.contact.force(self.problem)[1]

    def radius(self):
        """Radius of the contact.

        Of the part of the last vertex as much as its pressure is of the one before: the pressure
        of a plastic contact ends abruptly.
        """
        r = self.contact.surfaces[1].x[:, 0]
        order = np.argsort(r)
        r, p = r[order], self.contact.pressures(self.problem)[order]
        last = np.flatnonzero(p > 0)[-1]
        ends = (r[last - 1] + r[last]) / 2, (r[last] + r[last + 1]) / 2
        return ends[0] + min(p[last] / p[last - 1], 1) * (ends[1] - ends[0])


# ## First yield: an elastic load


def first_yield(comm, cells):
    """Hertz's largest pressure over the largest equivalent stress."""
    a = 1e-3 * R  # small: nothing yields yet
    scene = Scene(comm, 1.2 * a, round(1.2 * cells), 1e9)
    force = scene.go(a**2 / R)
    p0 = (6 * force * E_star**2 / (np.pi**3 * R**2)) ** (1 / 3)
    return p0 / scene.body.largest_mises()


# ## Brinell's test


def indent(comm, cells, steps, threshold, a=0.1 * R):
    """Press and draw back; rows of depth, force, radius, mean pressure, and the sums."""
    scene = Scene(comm, a, cells, threshold)
    depth = 0.38 * a**2 / R  # of a plastic half-space, whose surface rises beside the sphere
    rows, work, last = [], 0.0, (0.0, 0.0)
    path = [depth * (k / steps) for k in range(1, steps + 1)]
    newton = []
    for at in path:
        force = scene.go(at)
        radius = scene.radius()
        work += (at - last[0]) * (force + last[1]) / 2
        rows.append((at, force, radius, force / (np.pi * radius**2)))
        newton.append(scene.problem.iterations)
        last = at, force
        progress.show(comm, f"depth {at:.2e}: {newton[-1]} Newton steps")
    _, force, radius, mean = rows[-1]
    sprung = np.sqrt(9 * np.pi * force * mean / (16 * E_star**2))
    forces, back = [force], []
    while forces[-1] > 0:
        forces.append(scene.go(depth - len(forces) * sprung / 10))
        work -= sprung / 10 * (forces[-1] + forces[-2]) / 2
        back.append(scene.problem.iterations)
        progress.show(comm, f"back by {len(back)} steps of ten: {back[-1]} Newton steps")
    # It grows as the depth to the power of 3/2, from where the sphere leaves the dent
    few, more = np.array(forces[-2:-4:-1]) ** (2 / 3)
    back_by = (len(forces) - 2 + few / (more - few)) / 10
    u = np.concatenate(comm.allgather(scene.body.u.x.array[1::2]))
    stored, lost = scene.body.energy(), scene.body.dissipated
    return {
        "mean_pressure": float(mean / sigma_y),
        "radius": float(radius / a),
        "E*a/(σ_y R)": float(E_star * radius / (sigma_y * R)),
        "imprint": float(-u.min() / depth),
        "springs_back": float(back_by),
        "energy": float((stored + lost) / work - 1),
        "dissipated": float(lost / work),
        "newton": newton,
        "newton_back": back,
        "halvings": int(scene.problem.halvings),
        "rows": [[float(value) for value in row] for row in rows],
    }


def picture(rows, file):
    """Mean pressure over the radius of the contact."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    _, _, radius, mean = np.array(rows).T
    x = E_star * radius / (sigma_y * R)
    fig, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
    axes.axhspan(2.8, 3, color="0.9", label="fully plastic (textbook)")
    axes.axhline(2 / 3 * 1.60, color="0.4", lw=1, ls="--", label="first yield (textbook)")
    axes.plot(x, mean / sigma_y, "C0o-", ms=3, label="mean pressure")
    axes.set(xlabel="E* a / (σ_y R)", ylabel="mean pressure / σ_y", xlim=(0, None), ylim=(0, 3.2))
    axes.legend(loc="lower right")
    file.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(file, dpi=150)


def main():
    """Print a table."""
    parser = argparse.ArgumentParser(description="A rigid sphere is pressed into a half-space.")
    parser.add_argument("--cells", type=int, default=24, help="cells across the contact's radius")
    parser.add_argument("--steps", type=int, default=24, help="load steps down")
    parser.add_argument("--threshold", type=float, default=1e-8, help="of the trial stress, in σ_y")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="save a picture")
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    result = {"first_yield": float(first_yield(comm, args.cells))}
    result |= indent(comm, args.cells, args.steps, args.threshold)
    if comm.rank > 0:
        return
    print(f"it yields first at p0 = {result['first_yield']:.3f} σ_y (1.60)")
    print("depth/R    a/R     E*a/(σ_y R)  mean pressure/σ_y")
    for at, _, radius, mean in result["rows"]:
        print(f"{at:.2e}  {radius:.4f}  {E_star * radius:9.1f}  {mean:12.3f}")
    print(f"springs back by {result['springs_back']:.3f} of (9 π P p_m / 16 E*²)^½")
    print(f"imprint {result['imprint']:.3f} of the depth; dissipated {result['dissipated']:.3f}")
    print(f"stored and dissipated energy over work − 1: {result['energy']:.1e}")
    print(f"Newton steps: {result['newton']}; back: {result['newton_back']}")
    if args.json:
        args.json.write_text(json.dumps(result, indent=1))
    if args.plot:
        picture(result["rows"], args.plot / "plasticity.png")


if __name__ == "__main__":
    main()
