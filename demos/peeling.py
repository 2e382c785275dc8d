# # Two glued strips, peeled from each other
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# The arms of a double cantilever beam are meshed separately and held together by an adhesive that
# softens and fails. The ends of the arms are turned away from each other, and the bond opens from
# there. The law has no memory, and needs none here, since nothing closes. This demo shows
#
# - `Tie(..., law=...)`: λ as a UFL expression of the jump, here the derivative of a potential,
# - that the moment at which the bond keeps opening is exact: by the J-integral, the energy $G$ of
#   the adhesive is $M^2/(E'I)$ for each crack length.

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
from hypergap_dolfinx import NonlinearTiedProblem, Tie

parser = argparse.ArgumentParser(description="Peeling of two glued strips.")
parser.add_argument("--n", type=int, default=1, help="refines the meshes")
parser.add_argument("--degree", type=int, default=2)
parser.add_argument("--steps", type=int, default=24, help="steps of the load")
parser.add_argument("--json", type=Path, metavar="FILE")
parser.add_argument("--plot", type=Path, metavar="DIR")
args = parser.parse_args()
comm, n = MPI.COMM_WORLD, args.n
# -

# Length and height of an arm, plane strain:

L, H = 16.0, 1.0
E, nu = 1000.0, 0.3
mu, lame = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
stiffness = E / (1 - nu**2)  # E'

# The adhesive: Xu's and Needleman's potential, with the energy $G$ and its strongest pull, $G / (e
# \delta)$, at an opening of $\delta$.

G, delta = 0.04, 0.015


def adhesive(jump, n):
    """λ of the jump and of the unit normal from Γ0 to Γ1."""
    w = ufl.variable(jump)
    opening = ufl.dot(w, n)
    slip = w - opening * n
    opened = ufl.exp(-opening / delta - ufl.dot(slip, slip) / delta**2)
    return ufl.diff(-G * (1 + opening / delta) * opened, w)


# Two arms. Their left ends turn by θ, without axial force:


def turned(theta, middle):
    """Axial displacement of an arm's end."""
    return lambda x: -theta * (x[1] - middle)


def stress(u):
    """σ."""
    strain = ufl.sym(ufl.grad(u))
    return 2 * mu * strain + lame * ufl.tr(strain) * ufl.Identity(2)


us, F, bcs, ends, sides, moments = [], [], [], [], [], []
for i, cells in enumerate((48, 32)):
    middle = (i - 0.5) * H
    mesh, tags = meshes.block(
        comm, (cells * n, 2 * n), lambda x, i=i: x * (L, H) - (0, H * (1 - i))
    )
    V = fem.functionspace(mesh, ("Lagrange", args.degree, (2,)))
    u, v = fem.Function(V), ufl.TestFunction(V)
    F.append(ufl.inner(stress(u), ufl.grad(v)) * ufl.dx)
    W, _ = V.sub(0).collapse()
    end = fem.Function(W)
    dofs = fem.locate_dofs_topological((V.sub(0), W), 1, tags.find(meshes.LEFT))
    bcs.append(fem.dirichletbc(end, dofs, V.sub(0)))
    # The moment is the work on a unit turn of the end's nodes
    end.interpolate(turned(1.0, middle))
    turn = fem.Function(V)
    turn.x.array[dofs[0]] = end.x.array[dofs[1]]
    moments.append(fem.form(ufl.inner(stress(u), ufl.grad(turn)) * ufl.dx))
    # The other end keeps its height
    dofs = fem.locate_dofs_topological(V.sub(1), 1, tags.find(meshes.RIGHT))
    bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(1)))
    sides.append((V, tags.find((meshes.TOP, meshes.BOTTOM)[i])))
    us.append(u)
    ends.append((end, middle))

tie = Tie(*sides, law=adhesive)
problem = NonlinearTiedProblem(F, us, bcs=bcs, ties=[tie])
exact = np.sqrt(G * stiffness * H**3 / 12)

# Where the jump is δ, the traction of the adhesive is largest. The part behind that has opened.

q = tie.quadrature(2)
rows = []
for theta in np.linspace(0, 0.16, args.steps + 1)[1:]:
    for (end, middle), sign in zip(ends, (1, -1), strict=True):
        end.interpolate(turned(sign * theta, middle))
    problem.solve()
    M = comm.allreduce(np.array([fem.assemble_scalar(form).real for form in moments]))
    gap = q.evaluate(tie.gap(*us)[0])[..., 0]
    crack = float(q.integrate((gap > delta).astype(float)))
    rows.append(
        {
            "theta": float(theta),
            "moment": float(np.abs(M).mean() / exact),
            "crack": crack,
            "newton": problem.solver.getIterationNumber(),
        }
    )

if args.plot:
    from hypergap_dolfinx import plot

    plot.deformed(us, args.plot / "peeling.png", factor=2.0)

if comm.rank == 0:
    print("angle   moment / exact   opened   Newton steps")
    for row in rows:
        print("{theta:.4f}   {moment:.5f}        {crack:6.3f}   {newton:3d}".format(**row))
    if args.json:
        args.json.write_text(json.dumps({"degree": args.degree, "rows": rows}, indent=1))
