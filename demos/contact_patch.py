# # The patch test of contact
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# A narrow block stands on a wider one. Both are compressed between walls without friction. The free
# part of the wider block's face is loaded with the same pressure. So the stress is constant, and
# contact transmits it to round-off for any meshes: at small strain, and at 20 % with large
# deformation.

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
from dolfinx.mesh import compute_midpoints, meshtags

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Contact, ContactProblem, progress

# -

ELEMENTS = {
    "P1": (("triangle", "tetrahedron"), 1),
    "P2": (("triangle", "tetrahedron"), 2),
    "Q1": (("quadrilateral", "hexahedron"), 1),
    "Q2": (("quadrilateral", "hexahedron"), 2),
}
RATIOS = ((2, 3), (1, 5), (5, 1))
START, END = 0.5, 1.5  # of the narrow block, on a block from 0 to 2
LARGE = 0.2  # strain from which bodies are neo-Hookean


def energy(u, large):
    """Energy density, and the stress (Piola–Kirchhoff's first) that belongs to it; λ = μ = 1."""
    dim = len(u)
    F = ufl.variable(ufl.Identity(dim) + ufl.grad(u))
    if large:
        J = ufl.det(F)
        psi = 0.5 * (ufl.inner(F, F) - dim - 2 * ufl.ln(J)) + 0.5 * ufl.ln(J) ** 2
    else:
        eps = ufl.sym(F) - ufl.Identity(dim)
        psi = ufl.inner(eps, eps) + 0.5 * ufl.tr(eps) ** 2
    return psi, ufl.diff(psi, F)


def pressure(strain):
    """The exact pressure."""
    stretch = 1 - strain
    if strain < LARGE:
        return 3 * strain
    return -(stretch - 1 / stretch + np.log(stretch) / stretch)


def press(comm, element, ratio, swap, strain, dim=2, picture=None):
    """Compress the blocks.

    Args:
        comm: Communicator.
        element: A name in ELEMENTS.
        ratio: Numbers of cells of both blocks.
        swap: Whether Γ1 is the wider block's.
        strain: How far.
        dim: Dimension.
        picture: Where to save a picture, if anywhere.

    Returns:
        Relative errors of the multipliers and of the stress.
    """
    cells, degree = ELEMENTS[element]
    p, large = pressure(strain), strain >= LARGE
    u, stresses, F, bcs, sides = [], [], [], [], []
    layers = 2 if dim == 2 else 1
    for i, (start, end, n) in enumerate(((0, 2, 4 * ratio[0]), (START, END, 2 * ratio[1]))):
        low, size = np.full(dim, float(start)), np.full(dim, float(end - start))
        low[-1], size[-1] = i - 1, 1

        def place(x, low=low, size=size):
            return low + x * size

        mesh, ft = meshes.block(comm, [n] * (dim - 1) + [layers], place, cell=cells[dim - 2])
        V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
        w = fem.Function(V)
        psi, stress = energy(w, large)
        form = ufl.derivative(psi * ufl.dx(metadata={"quadrature_degree": 2 * degree}), w)
        tags = [2 * axis + end + 1 for axis in range(dim - 1) for end in (0, 1)]  # of the sides
        far, near = (2 * dim - 1, 2 * dim)[:: 1 - 2 * i]  # away from contact, and there
        walls = [(c // 2, tag, 0) for c, tag in enumerate(tags)]
        for component, tag, value in (*walls, (dim - 1, far, strain * (1 - 2 * i))):
            dofs = fem.locate_dofs_topological(V.sub(component), dim - 1, ft.find(tag))
            bcs.append(fem.dirichletbc(default_scalar_type(value), dofs, V.sub(component)))
        facets = ft.find(near)
        if i == 0:
            middle = compute_midpoints(mesh, dim - 1, facets)[:, : dim - 1]
            free = facets[((middle < START) | (middle > END)).any(axis=1)]
            tags = meshtags(mesh, dim - 1, np.sort(free), np.ones(len(free), dtype=np.int32))
            ds = ufl.Measure("ds", mesh, subdomain_data=tags)
            load = fem.Constant(mesh, default_scalar_type(p))
            form += load * ufl.TestFunction(V)[dim - 1] * ds(1)
        u.append(w)
        stresses.append(stress)
        F.append(form)
        sides.append((V, facets))
    contact = Contact(*(sides[::-1] if swap else sides))
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact], rtol=1e-13)
    problem.solve()
    if picture:
        from hypergap_dolfinx import plot

        plot.contact(contact, problem, picture)
    error = abs(contact.pressures(problem)[contact.active] / p - 1).max()
    total = 0.0
    for stress in stresses:
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree})
        local = fem.assemble_scalar(fem.form((stress[dim - 1, dim - 1] + p) ** 2 * dx))
        total += comm.allreduce(local)
    volume = 2 ** (dim - 1) + 1
    return float(error), float(np.sqrt(total / volume) / p)


def main():
    """Run all of them."""
    parser = argparse.ArgumentParser(description="The patch test of contact.")
    parser.add_argument("--dim", type=int, choices=(2, 3), default=2)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--quick", action="store_true", help="one ratio, two elements")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="save a picture")
    args = parser.parse_args()
    comm, rows = MPI.COMM_WORLD, []
    ratios = RATIOS[:1] if args.quick else RATIOS
    elements = ("P2", "Q1") if args.quick else tuple(ELEMENTS)
    for case in itertools.product(elements, ratios, (False, True), (1e-3, LARGE)):
        element, ratio, swap, strain = case
        progress.show(comm, f"{element} {ratio[0]}:{ratio[1]}")
        last = args.plot and case == ("Q1", ratios[0], False, LARGE)
        picture = args.plot / "contact_patch.png" if last else None
        error, stress = press(comm, *case, dim=args.dim, picture=picture)
        rows.append(
            {
                "elements": element,
                "dim": args.dim,
                "ratio": f"{ratio[0]}:{ratio[1]}",
                "swap": swap,
                "strain": strain,
                "pressure": error,
                "stress": stress,
            }
        )
    progress.show(comm)
    if comm.rank == 0:
        print("elements  strain  largest error of pressure, stress")
        for element, strain in itertools.product(elements, (1e-3, LARGE)):
            mine = [r for r in rows if r["elements"] == element and r["strain"] == strain]
            worst = (max(r[name] for r in mine) for name in ("pressure", "stress"))
            print(f"{element:<8}  {strain:<6}  " + "  ".join(f"{e:.1e}" for e in worst))
        if args.json:
            args.json.write_text(json.dumps({"rows": rows}, indent=1))


if __name__ == "__main__":
    main()
