# # The effective stiffness of a periodic cell
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# The stiffness of a material that repeats itself is that of one cell, whose opposite faces are tied
# to each other across the cell: displacements there differ by the mean strain times the distance.
# Their meshes needn't match. This demo shows
#
# - ties across a distance, in all directions at once: the faces of a cell share edges and corners,
# - a mean strain as the ties' jump: one factorisation serves all load cases,
# - a laminate, whose stiffness is known exactly, its layers bodies with meshes of their own,
# - a square array of fibres, unstructured, against the same cell with matching faces.

# +
import argparse
import json
import sys
from itertools import combinations_with_replacement
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Tie, TiedProblem, progress

parser = argparse.ArgumentParser(description="Effective stiffness of periodic cells.")
parser.add_argument("--dim", type=int, choices=(2, 3), default=2)
parser.add_argument("--degree", type=int, default=1)
parser.add_argument("--fibres", action="store_true", help="a fibre's cell too (2D; needs Gmsh)")
parser.add_argument("--size", type=float, default=0.08, help="of the cells with fibres")
parser.add_argument("--json", type=Path, metavar="FILE")
parser.add_argument("--plot", type=Path, metavar="DIR")
args = parser.parse_args()
comm, dim = MPI.COMM_WORLD, args.dim
if args.fibres and dim == 3:
    parser.error("--fibres is for --dim 2.")
# -

# ## A cell
#
# is made of bodies, each with its facet tags, Young's modulus and Poisson's ratio. `bonds` are
# pairs of (body, tag) that are tied as they are, `pairs` those that are tied across the cell, with
# the way from one to the other.


def lame(E, nu):
    """Lamé's constants, in the plane those of plane strain."""
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


class Cell:
    """A periodic cell under mean strains."""

    def __init__(self, bodies, bonds, pairs, degree):
        """Bodies are (mesh, facet tags, moduli)."""
        self.strain = np.zeros((dim, dim))
        self.V = [fem.functionspace(mesh, ("Lagrange", degree, (dim,))) for mesh, _, _ in bodies]

        def side(body, tag):
            return self.V[body], bodies[body][1].find(tag)

        ties = [Tie.between(side(*one), side(*other)) for one, other in bonds]
        for one, other, way in pairs:
            ties.append(
                Tie.periodic(
                    side(*one), side(*other), translation=way, jump=lambda x, t=way: self.strain @ t
                )
            )
        forms, loads, self.stress = [], [], []
        for W, (mesh, _, moduli) in zip(self.V, bodies, strict=True):
            first, mu = (fem.Constant(mesh, default_scalar_type(c)) for c in lame(*moduli))
            nothing = fem.Constant(mesh, default_scalar_type((0,) * dim))
            u, v = ufl.TrialFunction(W), ufl.TestFunction(W)

            def sigma(u, first=first, mu=mu):
                eps = ufl.sym(ufl.grad(u))
                return 2 * mu * eps + first * ufl.tr(eps) * ufl.Identity(dim)

            forms.append(ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx)
            loads.append(ufl.inner(nothing, v) * ufl.dx)
            self.stress.append(sigma)

        # The ties hold the cell's rotation, a node holds the rest.
        dofs = fem.locate_dofs_geometrical(self.V[0], lambda x: np.isclose(x, 0).all(axis=0))
        held = fem.dirichletbc(np.zeros(dim, dtype=default_scalar_type), dofs, self.V[0])
        self.problem = TiedProblem(forms, loads, bcs=[held], ties=ties)
        self.problem.assemble_matrix()

        # A component of the mean stress is that of a unit stress with it
        self.unit = [
            fem.Constant(W.mesh, np.zeros((dim, dim), default_scalar_type)) for W in self.V
        ]
        self.integrals = [
            fem.form(ufl.inner(sigma(u), unit) * ufl.dx)
            for u, sigma, unit in zip(self.problem.u, self.stress, self.unit, strict=True)
        ]

    def solve(self, strain):
        """Displacements under a mean strain."""
        self.strain[:] = strain
        self.problem.assemble_vector()  # reads the jumps
        return self.problem.solve_system()  # the first one factorises

    def stiffness(self):
        """Mean stresses under unit strains; the cell's volume is 1."""
        stiffness = np.empty((len(UNITS), len(UNITS)))
        for j, strain in enumerate(UNITS):
            self.solve(strain)
            for i, unit in enumerate(UNITS):
                for constant in self.unit:
                    constant.value[:] = unit
                stiffness[i, j] = sum(fem.assemble_scalar(f) for f in self.integrals)
        return comm.allreduce(stiffness)


def unit_strains():
    """Symmetric tensors with one component, and its mirror, of length one."""
    units = []
    for i, j in combinations_with_replacement(range(dim), 2):
        unit = np.zeros((dim, dim))
        unit[i, j] = unit[j, i] = 1 if i == j else np.sqrt(0.5)
        units.append(unit)
    return units


UNITS = unit_strains()
WAYS = np.eye(dim)

# ## A laminate
#
# of two layers across x. The faces that meet, and those at the ends, have 7 and 10 or 3 and 11
# cells along y; those at the sides are bent out of shape, so that they don't match either.

MODULI = (1.0, 0.3), (20.0, 0.2)
SHARE = 0.4  # of the first layer


def laminate(ratio, cell, degree):
    """The cell."""
    bodies = []
    ends = (0, SHARE), (SHARE, 1)
    for n, (start, end), moduli in zip(ratio, ends, MODULI, strict=True):

        def placed(x, start=start, end=end):
            """Inner nodes of the faces to differing places."""
            y = x.copy()
            for i in range(dim):
                y[:, i] += 0.3 * x[:, i] * (1 - x[:, i]) * (x[:, (i + 1) % dim] - 0.4)
            y[:, 0] = start + (end - start) * y[:, 0]
            return y

        mesh, tags = meshes.block(comm, (2, n, 3)[:dim], placed, cell=cell)
        bodies.append((mesh, tags, moduli))
    bonds = [((0, meshes.RIGHT), (1, meshes.LEFT))]
    pairs = [((1, meshes.RIGHT), (0, meshes.LEFT), -WAYS[0])]
    for i in (0, 1):
        pairs.append(((i, meshes.BOTTOM), (i, meshes.TOP), WAYS[1]))
        if dim == 3:
            pairs.append(((i, meshes.BACK), (i, meshes.FRONT), WAYS[2]))
    return Cell(bodies, bonds, pairs, degree)


# Stresses on the layers' faces and strains along them are the same in both.


def exact_laminate():
    """Its stiffness."""
    out = [k for k, unit in enumerate(UNITS) if unit[0].any()]
    along = [k for k in range(len(UNITS)) if k not in out]
    sums = [0.0] * 4
    for share, moduli in zip((SHARE, 1 - SHARE), MODULI, strict=True):
        first, mu = lame(*moduli)
        trace = np.array([np.trace(unit) for unit in UNITS])
        C = first * np.outer(trace, trace) + 2 * mu * np.eye(len(UNITS))
        inverse = np.linalg.inv(C[np.ix_(out, out)])
        coupling = inverse @ C[np.ix_(out, along)]
        rest = C[np.ix_(along, along)] - C[np.ix_(along, out)] @ coupling
        for k, part in enumerate((inverse, coupling, rest)):
            sums[k] = sums[k] + share * part
    inverse, coupling, rest, _ = sums
    stiffness = np.empty((len(UNITS), len(UNITS)))
    across = np.linalg.inv(inverse)
    stiffness[np.ix_(out, out)] = across
    stiffness[np.ix_(out, along)] = across @ coupling
    stiffness[np.ix_(along, out)] = (across @ coupling).T
    stiffness[np.ix_(along, along)] = rest + coupling.T @ across @ coupling
    return stiffness


def relative(found, exact):
    """Largest error, over the largest entry."""
    return float(np.abs(found - exact).max() / np.abs(exact).max())


cells = ("triangle", "quadrilateral") if dim == 2 else ("tetrahedron", "hexahedron")
exact, rows = exact_laminate(), []
for cell in cells:
    for ratio in ((7, 10), (3, 11)):
        progress.show(comm, f"laminate of {cell} cells, {ratio[0]} : {ratio[1]}")
        drawn = laminate(ratio, cell, args.degree)
        row = {"cell": cell, "dim": dim, "degree": args.degree, "ratio": list(ratio)}
        rows.append({**row, "error": relative(drawn.stiffness(), exact)})
progress.show(comm)
result: dict = {"rows": rows}
if comm.rank == 0:
    print("error of a laminate's effective stiffness:")
    for row in rows:
        print("{cell:13} faces {ratio[0]} : {ratio[1]:2}  {error:.1e}".format(**row))

# ## Fibres
#
# of boron in aluminium, 47 % of the volume, in a square array (moduli in GPa). The shear modulus
# across the fibres converges to 45.82433 (matching faces: so with `--size 0.01 --degree 2` and
# with `--size 0.02 --degree 3`). The cell's left and lower faces have a third less cells than those
# opposite, and are Γ1; the fibre is a body of its own.

BORON, ALUMINIUM = (379.3, 0.1), (68.3, 0.3)
SHEAR = 45.82433


def fibres(h, degree, matching):
    """The cell."""
    radius = np.sqrt(0.47 / np.pi)
    parts = fibre_cell(comm, h, radius, degree=min(degree, 2), matching=matching)
    bodies = [(*part, moduli) for part, moduli in zip(parts, (ALUMINIUM, BORON), strict=True)]
    bonds = [((1, meshes.HOLE), (0, meshes.HOLE))]
    faces = (meshes.RIGHT, meshes.LEFT), (meshes.TOP, meshes.BOTTOM)
    pairs = [((0, a), (0, b), -way) for (a, b), way in zip(faces, WAYS, strict=True)]
    return Cell(bodies, bonds, pairs, degree)


if args.fibres:
    from meshes.fibres import fibre_cell  # needs Gmsh

    drawn = fibres(args.size, args.degree, False)
    found, matching = drawn.stiffness(), fibres(args.size, args.degree, True).stiffness()
    shear = found[1, 1] / 2
    result["fibres"] = {
        "shear": float(shear),
        "error": float(abs(shear / SHEAR - 1)),
        "matching": relative(found, matching),
    }
    if comm.rank == 0:
        print(
            "fibres: shear modulus {shear:.2f}, error {error:.1e}; stiffness {matching:.1e} off "
            "that with matching faces".format(**result["fibres"])
        )
if comm.rank == 0 and args.json:
    args.json.write_text(json.dumps(result, indent=1))

# ## A picture
#
# of 3 cells along each axis, deformed: a cell's copies move apart by the mean strain times their
# distance, and fit.


def grids(us):
    """Each body's cells with the displacements, on rank 0."""
    found = []
    for u in us:
        V = u.function_space
        owned = np.arange(V.mesh.topology.index_map(dim).size_local)
        mesh_of_rank = dolfinx.plot.vtk_mesh(V, owned)
        moved = np.zeros((len(mesh_of_rank[2]), 3))
        moved[:, :dim] = u.x.array.reshape(-1, dim)[: len(moved)]
        parts = comm.gather((*mesh_of_rank, moved))
        for part in (part for part in parts or () if len(part[1])):
            grid = pyvista.UnstructuredGrid(*part[:3])
            grid["u"] = part[3]
            found.append((grid, V.mesh is us[0].function_space.mesh))
    return found


if args.plot:
    import pyvista

    import dolfinx.plot
    from hypergap_dolfinx.core import display

    strain = 0.12 * (np.eye(dim, k=1) + np.eye(dim, k=-1)) + 0.1 * np.diag((1, -1, 0)[:dim])
    bodies = grids(drawn.solve(strain))
    if comm.rank == 0:
        display.prepare()
        plotter = pyvista.Plotter(off_screen=True, window_size=(1100, 960))
        plotter.background_color = "white"
        for place in np.ndindex((3,) * dim):
            shift = np.zeros(3)
            shift[:dim] = place + strain @ place
            for grid, first in bodies:
                copy = grid.copy()
                copy.points = grid.points + grid["u"] + shift
                plotter.add_mesh(
                    copy,
                    color="#b9cfe4" if first else "#e0913a",
                    show_edges=args.degree == 1,
                    edge_color="#4a5a6a",
                    ambient=0.35,
                )
        if dim == 2:
            plotter.view_xy()
        plotter.camera.zoom(1.2)
        args.plot.mkdir(parents=True, exist_ok=True)
        plotter.screenshot(args.plot / "periodic_cell.png")
        plotter.close()
