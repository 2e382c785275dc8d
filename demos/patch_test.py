# # Two patch tests
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Section 3.1 of Giffin (2024). Two elastic blocks in plane stress are tied along an interface
# whose meshes don't match. The left edge of the assembly is held against sliding out, a corner on
# the right against going up or down, and a traction pulls on the right edge:
#
# - a constant one stretches the assembly, the exact displacement is linear;
# - one that grows with the height bends it, the exact displacement is quadratic.
#
# A method passes when it reproduces these displacements to round-off, whatever the meshes: elements
# of degree 1 the first, elements of degree 2 both.

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

L, H = 1.0, 1.0  # length and height of the assembly, the axis at half its height
E, nu, t = 1.0, 0.3, 0.1

# The axis of the bent assembly goes through the origin; both fields are shifted such that the
# corner (L, -H/2) stays at its height.


def stretching(x):
    """Displacement under the traction t."""
    return t / E * x[0], -nu * t / E * (x[1] + H / 2)


def bending(x):
    """Displacement under the traction t y."""
    return (
        t / E * x[0] * x[1],
        -t / (2 * E) * (x[0] ** 2 + nu * x[1] ** 2 - L**2 - nu * (H / 2) ** 2),
    )


def sigma(u):
    """Plane stress."""
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + nu) * (eps + nu / (1 - nu) * ufl.tr(eps) * ufl.Identity(2))


# ## The assemblies
#
# Four ways to cut the rectangle in two. A body is the image of the unit square; where an interface
# has a kink, both sides have a node.


def mappings(shape):
    """Mappings of the unit square to both bodies, and their tags on the interface."""
    if shape in ("vertical", "skew"):
        slope = np.tan(np.deg2rad(25)) if shape == "skew" else 0

        def cut(y):
            return L / 2 + slope * (y - 0.5) * H

        def left(x):
            return np.column_stack((x[:, 0] * cut(x[:, 1]), (x[:, 1] - 0.5) * H))

        def right(x):
            at = cut(x[:, 1])
            return np.column_stack((at + x[:, 0] * (L - at), (x[:, 1] - 0.5) * H))

        return (left, right), (meshes.RIGHT, meshes.LEFT)

    def cut(x):
        return 0.2 * H * (1 - 2 * np.abs(x - 0.5)) if shape == "kinked" else 0 * x

    def upper(x):
        at = cut(x[:, 0])
        return np.column_stack((x[:, 0] * L, at + x[:, 1] * (H / 2 - at)))

    def lower(x):
        at = cut(x[:, 0])
        return np.column_stack((x[:, 0] * L, -H / 2 + x[:, 1] * (at + H / 2)))

    return (upper, lower), (meshes.BOTTOM, meshes.TOP)


def displacements(comm, elements, shape, ratio, swap, exact):
    """Solve a tied assembly."""
    V, forms, loads, bcs, sides = [], [], [], [], []
    for (cell, degree), mapping, tag, cells in zip(elements, *mappings(shape), ratio, strict=True):
        along = 2 * cells if shape == "kinked" else cells  # even: a node at the kink
        n = (2, along) if shape in ("vertical", "skew") else (along, 2)
        mesh, ft = meshes.block(comm, n, mapping, cell=cell)
        W = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        x, ds = ufl.SpatialCoordinate(mesh), ufl.Measure("ds", mesh, subdomain_data=ft)
        traction = t * x[1] if exact is bending else fem.Constant(mesh, default_scalar_type(t))
        V.append(W)
        forms.append(ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx)
        loads.append(ufl.inner(traction, v[0]) * ds(meshes.RIGHT if tag != meshes.RIGHT else 99))
        if tag != meshes.LEFT:
            dofs = fem.locate_dofs_topological(W.sub(0), 1, ft.find(meshes.LEFT))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, W.sub(0)))
        corner = locate_entities_boundary(
            mesh, 0, lambda x: np.isclose(x[0], L) & np.isclose(x[1], -H / 2)
        )
        dofs = fem.locate_dofs_topological(W.sub(1), 0, corner)
        bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, W.sub(1)))
        sides.append((W, ft.find(tag)))
    tie = Tie(*(sides[::-1] if swap else sides))
    return TiedProblem(forms, loads, bcs=bcs, ties=[tie]).solve()


def solve(comm, elements, shape, ratio, swap, exact):
    """Relative errors of a tied assembly: L² of the displacement, L² of the stress."""
    return relative_errors(displacements(comm, elements, shape, ratio, swap, exact), exact)


def relative_errors(us, exact):
    """Relative L² errors of displacement and stress."""
    totals = np.zeros(4)
    for u in us:
        u_exact = ufl.as_vector(exact(ufl.SpatialCoordinate(u.function_space.mesh)))
        dx = ufl.dx(metadata={"quadrature_degree": 6})
        # The zero function's error is the exact field's norm, by the same form
        for j, f in enumerate((u, fem.Function(u.function_space))):
            for i, e in enumerate((f - u_exact, sigma(f) - sigma(u_exact))):
                totals[2 * i + j] += np.real(fem.assemble_scalar(fem.form(ufl.inner(e, e) * dx)))
    error_u, norm_u, error_s, norm_s = us[0].function_space.mesh.comm.allreduce(totals)
    return float(np.sqrt(error_u / norm_u)), float(np.sqrt(error_s / norm_s))


# ## All of them

T, Q = "triangle", "quadrilateral"
ELEMENTS = {
    "P1": ((T, 1), (T, 1)),
    "P2": ((T, 2), (T, 2)),
    "Q1": ((Q, 1), (Q, 1)),
    "Q2": ((Q, 2), (Q, 2)),
    "P1-Q1": ((T, 1), (Q, 1)),
    "P2-Q2": ((T, 2), (Q, 2)),
    "P1-P2": ((T, 1), (T, 2)),
}
SHAPES = ("horizontal", "vertical", "skew", "kinked")
RATIOS = ((1, 1), (2, 3), (1, 7), (7, 1))


def cases():
    """Every combination: test, elements, shape, ratio, swap."""
    for test, name, shape, ratio, swap in itertools.product(
        (stretching, bending), ELEMENTS, SHAPES, RATIOS, (False, True)
    ):
        quadratic = all(degree == 2 for _, degree in ELEMENTS[name])
        if test is stretching or (quadratic and shape != "kinked"):
            yield test, name, shape, ratio, swap


def main():
    """Run every case and print the largest errors."""
    parser = argparse.ArgumentParser(description="Two patch tests of tied blocks.")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    if args.plot:
        from hypergap_dolfinx import plot

        us = displacements(comm, ELEMENTS["P2-Q2"], "skew", (2, 3), False, bending)
        plot.deformed(us, args.plot / "patch_test.png")

    rows = []
    todo = list(cases())
    for i, (test, name, shape, ratio, swap) in enumerate(todo):
        progress.show(comm, f"case {i + 1} of {len(todo)}")
        l2, stress = solve(comm, ELEMENTS[name], shape, ratio, swap, test)
        rows.append(
            {
                "test": "linear" if test is stretching else "bending",
                "elements": name,
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
    for test in ("linear", "bending"):
        print(f"\n{test} patch test: largest of the relative errors of displacement and stress,")
        print("over the size ratios 1:1, 2:3, 1:7, 7:1 and both sides as Γ1")
        print("          " + "".join(f"{shape:>12s}" for shape in SHAPES))
        for name in ELEMENTS:
            text = ""
            for shape in SHAPES:
                mine = [
                    max(row["l2"], row["stress"])
                    for row in rows
                    if (row["test"], row["elements"], row["shape"]) == (test, name, shape)
                ]
                text += f"{max(mine):12.1e}" if mine else f"{'–':>12s}"
            print(f"{name:10s}{text}")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
