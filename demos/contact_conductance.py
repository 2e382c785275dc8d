# # Heat that flows where bodies touch
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Two bars stand on each other and are pressed together. The higher the load, the larger the contact
# area and the heat flow. First contact is solved, load step by load step. Then heat is solved on
# the same meshes, with a tie whose conductance comes from the pressure. (If temperature strains the
# bodies, alternate between the two.) Between flat ends the result is exact. If an end is crowned,
# heat is constricted to the middle; the resistance of that is known if the contact itself has none.

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
from hypergap_dolfinx import Contact, ContactProblem, Tie, TiedProblem

parser = argparse.ArgumentParser(description="Heat through bars that are pressed together.")
parser.add_argument("--cells", type=int, default=40, help="of the lower bar across")
parser.add_argument("--json", type=Path, metavar="FILE")
parser.add_argument("--plot", type=Path, metavar="DIR", help="save a picture")
args = parser.parse_args()
comm = MPI.COMM_WORLD
# -

# One half of each bar, 1 wide and 1.5 long, between walls without friction; E, ν and the
# conductivity k. The end of the upper bar is crowned by up to a thousandth.

B, L, CROWN = 1.0, 1.5, 1e-3
E, NU, K = 1.0, 0.3, 1.0
HOT, COLD = 1.0, 0.0


def bars(crown):
    """Meshes, and tags of their sides."""
    for i in (0, 1):
        n = args.cells * (4 - i) // 4

        def place(x, i=i):
            y = (x[:, 1] + i - 1) * L
            bottom = crown * x[:, 0] ** 2 * (i == 1)
            return np.column_stack((B * x[:, 0], y + bottom * (1 - y / L)))

        yield meshes.block(comm, (n, 3 * n // 2), place, cell="quadrilateral")


class Pressed:
    """The bars in contact."""

    def __init__(self, crown):
        """Make them."""
        mu, lame = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
        self.meshes, self.tags = zip(*bars(crown), strict=True)
        u, F, bcs, sides = [], [], [], []
        for i, (mesh, tags) in enumerate(zip(self.meshes, self.tags, strict=True)):
            V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
            w, v = fem.Function(V), ufl.TestFunction(V)
            eps = ufl.sym(ufl.grad(w))
            sigma = 2 * mu * eps + lame * ufl.tr(eps) * ufl.Identity(2)
            F.append(ufl.inner(sigma, ufl.grad(v)) * ufl.dx)
            far, near = (meshes.BOTTOM, meshes.TOP)[:: 1 - 2 * i]
            self.end = fem.Constant(mesh, default_scalar_type(0))
            walls = np.sort(np.hstack((tags.find(meshes.LEFT), tags.find(meshes.RIGHT))))
            for k, facets, value in (
                (0, walls, default_scalar_type(0)),
                (1, tags.find(far), self.end),
            ):
                dofs = fem.locate_dofs_topological(V.sub(k), 1, facets)
                bcs.append(fem.dirichletbc(value, dofs, V.sub(k)))
            u.append(w)
            sides.append((V, tags.find(near)))
        self.contact = Contact(*sides)
        self.problem = ContactProblem(F, u, bcs=bcs, contacts=[self.contact])

    def press(self, down):
        """Move the upper end down; pressure on the upper bar, and where it touches, at its dofs."""
        self.end.value = -down
        u = self.problem.solve()
        p = self.contact.pressure(self.problem, on="body").x.array
        gap = self.contact.gap(*u, on="body").x.array  # 0 far from the contact too
        return p, (p > 0) & (gap < 1e-9 * CROWN)


# Heat: the same facets, tied with a conductance that is read at each solve. It is 0 where nothing
# touches.


class Heat:
    """Temperatures in the bars."""

    def __init__(self, pressed):
        """Tie them."""
        self.V = [fem.functionspace(mesh, ("Lagrange", 1)) for mesh in pressed.meshes]
        self.conductance = fem.Function(self.V[1])
        a, bcs = [], []
        for i, V in enumerate(self.V):
            T, v = ufl.TrialFunction(V), ufl.TestFunction(V)
            a.append(K * ufl.inner(ufl.grad(T), ufl.grad(v)) * ufl.dx)
            far = pressed.tags[i].find((meshes.BOTTOM, meshes.TOP)[i])
            dofs = fem.locate_dofs_topological(V, 1, far)
            bcs.append(fem.dirichletbc(default_scalar_type((HOT, COLD)[i]), dofs, V))
        sides = zip(self.V, pressed.contact.facets, strict=True)
        self.tie = Tie(*sides, conductance=self.conductance)
        self.problem = TiedProblem(a, [None, None], bcs=bcs, ties=[self.tie])

    def solve(self, conductance):
        """Heat that gets across, for conductances at the dofs of the upper bar."""
        self.conductance.x.array[:] = conductance
        self.T = self.problem.solve()
        q = self.tie.quadrature(2)
        return abs(q.integrate(q.evaluate(self.tie.traction(self.problem))[..., 0]))


# Flat ends: pressure, conductance and heat flux are constant and exact. The conductance is β p, a
# model of rough surfaces.

strain_modulus = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))
pressed, even = Pressed(0.0), []
heat = Heat(pressed)
for down in (1e-3, 4e-3):
    p, _ = pressed.press(down)
    for beta in (100.0, 1e4):
        exact = B * (HOT - COLD) / (2 * L / K + 2 * L / (beta * strain_modulus * down))
        error = abs(heat.solve(beta * p) / exact - 1)
        even.append({"down": down, "beta": beta, "heat": exact, "error": float(error)})

# A crowned end: the heat flow through a contact without resistance, beside the closed form for
# strips of width B (from the symmetry plane on) that touch on the width a and are insulated
# elsewhere. The constriction adds a resistance of 2 / (π k) ln(1 / sin(π a / 2B)) to each strip. A
# conductance that is huge at a touching vertex decreases linearly to 0 at the next vertex, and is
# still huge nearly up to it. So a reaches up to that vertex, and is at most one cell too large. (A
# conductance proportional to the pressure fades by itself.)


def squeezed(a):
    """The heat through a contact of half-width a without resistance."""
    middle = np.log(1 / np.sin(np.pi * a / (2 * B))) if a else np.inf
    return float((HOT - COLD) * K / (2 * L / B + 4 / np.pi * middle))


pressed, crowned = Pressed(CROWN), []
heat = Heat(pressed)
for down in (0.0, 5e-5, 1.5e-4, 3e-4, 6e-4, 1e-3, 1.5e-3, 3e-3):
    p, touching = pressed.press(down)
    x, touches = pressed.contact.surfaces[1].x[:, 0], pressed.contact.active
    conducts = x[~touches].min(initial=B) if touches.any() else 0.0
    rough = heat.solve(2000 * p)
    perfect = heat.solve(1e6 * touching)
    crowned.append(
        {
            "down": down,
            "touches": float(x[touches].max(initial=0)),
            "conducts": float(conducts),
            "heat": float(perfect),
            "known": squeezed(conducts),
            "rough": float(rough),
            "newton": pressed.problem.iterations,
        }
    )
    if args.plot and down == 3e-4:
        from hypergap_dolfinx import plot

        plot.field(heat.T, args.plot / "contact_conductance.png", title="temperature")

if comm.rank == 0:
    print("even ends, conductance β p\n  down       β    heat    error")
    for row in even:
        print(f"{row['down']:6g} {row['beta']:7g}  {row['heat']:.4f}  {row['error']:.1e}")
    print(
        "a crowned end\n   down  touches  conducts  heat: perfect contact, known   with 2000 p"
        "   Newton steps"
    )
    for row in crowned:
        print(
            f"{row['down']:7g}  {row['touches']:7.3f}  {row['conducts']:8.3f}  {row['heat']:21.4f}"
            f" {row['known']:7.4f}  {row['rough']:12.4f}  {row['newton']:13d}"
        )
    if args.json:
        args.json.write_text(json.dumps({"even": even, "crowned": crowned}, indent=1))
