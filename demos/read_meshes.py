# # Meshes from files: a plate with a hole
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# A quarter of a plate comes from Gmsh, as a `.msh` file with tags. Around its hole stresses change
# fast: a ring of finer cells there comes from XDMF. A tie joins the two. Under tension the stress
# at the edge of the hole is three times the stress far away. Kirsch's solution for an infinite
# plate gives the loads on the outer edges, so it is exact here.

# +
import argparse
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem, io

sys.path.insert(0, str(Path(__file__).parents[1]))  # for a package that isn't installed
from hypergap_dolfinx import Tie, TiedProblem, compat, files

parser = argparse.ArgumentParser(description="Tie meshes that are read from files.")
parser.add_argument("--json", type=Path, metavar="FILE")
parser.add_argument("--plot", type=Path, metavar="DIR")
args = parser.parse_args()
comm = MPI.COMM_WORLD
folder = Path(__file__).parents[1] / "meshes"  # made by make_files.py
# -

# Gmsh's physical groups become tags: the hole (of the plate without the ring), the symmetry planes,
# and the outer edges.

plate, _, plate_tags = compat.read_from_msh(folder / "plate_with_hole.msh", comm, gdim=2)
HOLE, PLANE_X, PLANE_Y, OUTSIDE = 1, 2, 3, 4

# XDMF holds tags beside the mesh.

with io.XDMFFile(comm, folder / "ring.xdmf", "r") as file:
    ring = file.read_mesh(name="ring")
    ring.topology.create_connectivity(1, 2)
    ring_tags = file.read_meshtags(ring, name="facets")
OUTER, RING_PLANE_Y, RING_PLANE_X = 2, 3, 4

# Kirsch's displacement under unit tension in x, around a hole of radius one, in plane stress

E, nu = 1.0, 0.3
mu, kappa = E / (2 * (1 + nu)), (3 - nu) / (1 + nu)


def exact(x):
    """The displacement in UFL."""
    r, t = ufl.sqrt(x[0] ** 2 + x[1] ** 2), ufl.atan2(x[1], x[0])
    c, s, c3, s3 = ufl.cos(t), ufl.sin(t), ufl.cos(3 * t), ufl.sin(3 * t)
    ux = r * (kappa + 1) * c + 2 / r * ((1 + kappa) * c + c3) - 2 / r**3 * c3
    uy = r * (kappa - 3) * s + 2 / r * ((1 - kappa) * s + s3) - 2 / r**3 * s3
    return ufl.as_vector((ux, uy)) / (8 * mu)


def sigma(u):
    """Plane stress."""
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + nu) * (eps + nu / (1 - nu) * ufl.tr(eps) * ufl.Identity(2))


# The rest is as in any script. The plate has the larger cells: it is Γ1.

V, forms, loads, bcs = [], [], [], []
for mesh, tags, planes in (
    (ring, ring_tags, (RING_PLANE_X, RING_PLANE_Y)),
    (plate, plate_tags, (PLANE_X, PLANE_Y)),
):
    W = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)
    load = sigma(exact(ufl.SpatialCoordinate(mesh))) * ufl.FacetNormal(mesh)
    V.append(W)
    forms.append(ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx)
    loads.append(ufl.inner(load, v) * ds(OUTSIDE if mesh is plate else 99))
    for component, plane in enumerate(planes):
        dofs = fem.locate_dofs_topological(W.sub(component), 1, tags.find(plane))
        bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, W.sub(component)))

tie = Tie((V[0], ring_tags.find(OUTER)), (V[1], plate_tags.find(HOLE)))
us = TiedProblem(forms, loads, bcs=bcs, ties=[tie]).solve()

# Errors, and the largest stress

sums = np.zeros(4)
for u in us:
    e = exact(ufl.SpatialCoordinate(u.function_space.mesh))
    # The zero function's error is the exact field's norm, by the same form
    both = (u - e, fem.Function(u.function_space) - e)
    fields = (*both, *(sigma(f) for f in both))
    dx = ufl.dx(metadata={"quadrature_degree": 6})
    sums += [fem.assemble_scalar(fem.form(ufl.inner(f, f) * dx)) for f in fields]
sums = comm.allreduce(sums)
stress = [files.interpolated(sigma(u)[0, 0], u.function_space.mesh, 1, "stress") for u in us]
result = {
    "l2": float(np.sqrt(sums[0] / sums[1])),
    "stress": float(np.sqrt(sums[2] / sums[3])),
    "concentration": max(comm.allgather(stress[0].x.array.max(initial=0))),
}
if comm.rank == 0:
    print(
        "relative L² errors: displacement {l2:.2e}, stress {stress:.2e}; "
        "stress concentration {concentration:.3f} (exact: 3)".format(**result)
    )
    if args.json:
        args.json.write_text(json.dumps(result, indent=1))
if args.plot:
    from hypergap_dolfinx import plot

    plot.field(stress, args.plot / "read_meshes.png", title="stress")
