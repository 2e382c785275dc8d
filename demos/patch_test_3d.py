# # Two patch tests in three dimensions
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# The patch tests of Giffin (2024), section 3.1, with tetrahedra or, with `--cell hexahedron`, with
# hexahedra on one side or both: two elastic bars, one behind the other, tied across a face whose
# meshes don't match. A traction pulls on the far end,
#
# - a constant one, which stretches the assembly: the exact displacement is linear;
# - one that grows with the height y, which bends it: the exact displacement is quadratic.
#
# A method passes when it reproduces these displacements to round-off, whatever the meshes: elements
# of degree 1 the first, elements of degree 2 both (of hexahedra, where these are parallelepipeds).

# +
import argparse
import itertools
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import locate_entities_boundary

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Tie, TiedProblem, progress

# -

L = 2.0  # length of the assembly; its cross-section is a unit square
E, nu, t = 1.0, 0.3, 0.1
mu, lmbda = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def stretching(x):
    """Displacement under the traction t."""
    return t / E * x[0], -nu * t / E * x[1], -nu * t / E * x[2]


def bending(x):
    """Displacement under the traction t y."""
    return (
        t / E * x[0] * x[1],
        -t / (2 * E) * (x[0] ** 2 + nu * (x[1] ** 2 - x[2] ** 2)),
        -nu * t / E * x[1] * x[2],
    )


def sigma(u):
    """Stress of a displacement."""
    eps = ufl.sym(ufl.grad(u))
    return 2 * mu * eps + lmbda * ufl.tr(eps) * ufl.Identity(3)


# ## The assemblies
#
# The bars meet in a plane, in one that is skew about both axes, or in two that form a kink. A bar
# is the image of the unit cube; both have cell edges along the kink. Hexahedra may also be
# distorted along a flat interface.


def mappings(shape):
    """Mappings of the unit cube to both bars."""

    def cut(x):
        y, z = x[:, 1] - 0.5, x[:, 2] - 0.5
        skew = np.tan(np.deg2rad(25)) * (y + z)
        kinked = 0.2 - 0.4 * np.abs(y)
        return L / 2 + {"skew": skew, "kinked": kinked}.get(shape, 0 * y)

    def across(x):
        y, z = x[:, 1], x[:, 2]
        if shape != "distorted":
            return y, z
        pi = np.pi
        y_bent = y + 0.12 * np.sin(pi * y) * np.cos(2 * pi * z)
        return y_bent, z + 0.1 * np.sin(pi * z) * np.cos(3 * pi * y)

    def near(x):
        return np.column_stack((x[:, 0] * cut(x), *across(x)))

    def far(x):
        return np.column_stack((cut(x) + x[:, 0] * (L - cut(x)), *across(x)))

    return near, far


def create_bar(comm, cells, element, kind, shape, mapping):
    """A bar with a number of cells along the edges of its cross-section, and its facet tags."""
    kinked = shape == "kinked"
    if kind == "unstructured":
        return meshes.solid_block(comm, 1 / cells, mapping, halves=kinked)
    n = (2, 2 * cells if kinked else cells, cells)
    return meshes.block(comm, n, mapping, cell={"P": "tetrahedron", "Q": "hexahedron"}[element[0]])


def displacements(comm, elements, kind, shape, ratio, swap, exact):
    """Solve a tied assembly."""
    forms, loads, bcs, sides = [], [], [], []
    near_and_far = zip(elements, ratio, mappings(shape), (True, False), strict=True)
    for element, cells, mapping, near in near_and_far:
        mesh, ft = create_bar(comm, cells, element, kind, shape, mapping)
        V = fem.functionspace(mesh, ("Lagrange", int(element[1]), (3,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        x, ds = ufl.SpatialCoordinate(mesh), ufl.Measure("ds", mesh, subdomain_data=ft)
        forms.append(ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx)
        traction = t * x[1] if exact is bending else t
        pulled = fem.Constant(mesh, default_scalar_type(0 if near else 1))
        loads.append(pulled * traction * v[0] * ds(meshes.RIGHT))
        # The face z = 0 doesn't leave its plane, nor does x = 0; the corner between doesn't rise
        held = [(2, 2, ft.find(meshes.BACK))]
        if near:
            corner = locate_entities_boundary(mesh, 0, lambda x: np.isclose(x, 0).all(axis=0))
            held += [(0, 2, ft.find(meshes.LEFT)), (1, 0, corner)]
        for component, dim, entities in held:
            dofs = fem.locate_dofs_topological(V.sub(component), dim, entities)
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(component)))
        sides.append((V, ft.find(meshes.RIGHT if near else meshes.LEFT)))
    tie = Tie(*(sides[::-1] if swap else sides))
    return TiedProblem(forms, loads, bcs=bcs, ties=[tie]).solve()


def solve(comm, elements, kind, shape, ratio, swap, exact):
    """Relative errors of a tied assembly: L² of the displacement, L² of the stress."""
    return relative_errors(displacements(comm, elements, kind, shape, ratio, swap, exact), exact)


def relative_errors(us, exact):
    """Relative L² errors of displacement and stress."""
    totals = np.zeros(4)
    for u in us:
        u_exact = ufl.as_vector(exact(ufl.SpatialCoordinate(u.function_space.mesh)))
        dx = ufl.dx(metadata={"quadrature_degree": 4})
        # The zero function's error is the exact field's norm, by the same form
        for j, f in enumerate((u, fem.Function(u.function_space))):
            for i, e in enumerate((f - u_exact, sigma(f) - sigma(u_exact))):
                totals[2 * i + j] += fem.assemble_scalar(fem.form(ufl.inner(e, e) * dx))
    error_u, norm_u, error_s, norm_s = us[0].function_space.mesh.comm.allreduce(totals)
    return float(np.sqrt(error_u / norm_u)), float(np.sqrt(error_s / norm_s))


# ## All of them

ELEMENTS = {
    "tetrahedron": ("P1", "P2", "P1-P2"),
    "hexahedron": ("Q1", "Q2", "Q1-Q2", "Q1-P1", "Q1-P2", "Q2-P1", "Q2-P2"),
}
KINDS = {"tetrahedron": ("structured", "unstructured"), "hexahedron": ("structured",)}
SHAPES = {
    "tetrahedron": ("flat", "skew", "kinked"),
    "hexahedron": ("flat", "skew", "kinked", "distorted"),
}
RATIOS = ((2, 3), (1, 5), (5, 1))


def pair(elements):
    """The elements of both bars: "P1-P2" has two."""
    return (elements.split("-") * 2)[:2]


def cases(cell="tetrahedron"):
    """Every combination: test, elements, kind, shape, ratio, swap."""
    for test, *case in itertools.product(
        (stretching, bending), ELEMENTS[cell], KINDS[cell], SHAPES[cell], RATIOS, (False, True)
    ):
        quadratic = all(element[1] == "2" for element in pair(case[0]))
        if test is stretching or (quadratic and case[2] != "distorted"):
            yield test, *case


def main():
    """Run every case and print the largest errors."""
    parser = argparse.ArgumentParser(description="Two patch tests of tied bars.")
    parser.add_argument("--cell", choices=tuple(ELEMENTS), default="tetrahedron")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    if args.plot:
        from hypergap_dolfinx import plot

        element = "P2" if args.cell == "tetrahedron" else "Q2"
        kind = KINDS[args.cell][-1]
        us = displacements(comm, pair(element), kind, "skew", (2, 3), False, bending)
        plot.deformed(us, args.plot / "patch_test_3d.png")

    rows = []
    todo = list(cases(args.cell))
    for i, (test, elements, kind, shape, ratio, swap) in enumerate(todo):
        progress.show(comm, f"case {i + 1} of {len(todo)}")
        l2, stress = solve(comm, pair(elements), kind, shape, ratio, swap, test)
        rows.append(
            {
                "test": "linear" if test is stretching else "bending",
                "elements": elements,
                "mesh": kind,
                "shape": shape,
                "ratio": f"{ratio[0]}:{ratio[1]}",
                "swap": swap,
                "l2": l2,
                "stress": stress,
            }
        )
    progress.show(comm)
    if comm.rank > 0:
        return
    print("largest of the relative errors of displacement and stress,")
    print("over the size ratios 2:3, 1:5, 5:1 and both sides as Γ1")
    print(
        "test     elements  mesh        " + "".join(f"{shape:>11s}" for shape in SHAPES[args.cell])
    )
    keys = ("test", "elements", "mesh")
    for names in dict.fromkeys(tuple(row[key] for key in keys) for row in rows):
        text = "{:9s}{:10s}{:12s}".format(*names)
        for shape in SHAPES[args.cell]:
            found = [
                max(row["l2"], row["stress"])
                for row in rows
                if (*(row[key] for key in keys), row["shape"]) == (*names, shape)
            ]
            text += f"{max(found):11.1e}" if found else f"{'–':>11s}"
        print(text)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
