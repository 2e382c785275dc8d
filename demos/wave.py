# # A plane wave through an oblique tie
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# With complex numbers (DOLFINx's complex build) a tie couples fields that oscillate
# in time: the Helmholtz equation $-\Delta u - k^2 u = 0$ on a parallelogram, four wavelengths wide
# and high. An oblique line cuts it in two, with 10 cells a wavelength on its left and 11 on its
# right. A plane wave $e^{ik d \cdot x}$ comes in and goes out, by impedance conditions all around;
# the line is no boundary to it, so whatever comes back from there is the method's error.
#
# This demo shows the error beside that of one fused mesh, whose cells are as wide as those on the
# left and then on the right, and as high as their mean; and how much of the wave is reflected.
# Where the two differ it is by their cells: the fused mesh has the mean number of rows, so it is
# finer on the left.

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
from hypergap_dolfinx import Tie, TiedProblem

parser = argparse.ArgumentParser(description="A plane wave through an oblique tie.")
parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2, 3], metavar="K")
parser.add_argument("--json", type=Path, metavar="FILE")
parser.add_argument("--plot", type=Path, metavar="DIR")
args = parser.parse_args()
if not np.issubdtype(default_scalar_type, np.complexfloating):
    sys.exit("wave.py needs DOLFINx with complex numbers: see docs/how-to/complex-numbers.md.")
comm = MPI.COMM_WORLD
# -

# In wavelengths; angles from the x axis (the wave) and from the y axis (the line).

SIZE, k = 4.0, 2 * np.pi
WAVE, LINE = np.deg2rad(20), np.deg2rad(25)
direction = np.array((np.cos(WAVE), np.sin(WAVE)))
normal = np.array((np.cos(LINE), -np.sin(LINE)))
mirrored = direction - 2 * (direction @ normal) * normal


def line(y):
    """Where the line is at a height."""
    return SIZE / 2 + np.tan(LINE) * (y - SIZE / 2)


def placed(start, end):
    """The unit square mapped to what is between two such lines, that far from the middle."""

    def mapping(x):
        y = SIZE * x[:, 1]
        return np.column_stack((line(y) + start + (end - start) * x[:, 0], y))

    return mapping


def wave(x, d=direction):
    """A plane wave, 1 in the middle."""
    return ufl.exp(1j * k * (d[0] * (x[0] - SIZE / 2) + d[1] * (x[1] - SIZE / 2)))


# In complex forms `ufl.inner` conjugates its second argument, which the test function has to be.


def forms(mesh, tags, degree, outer):
    """Space, bilinear and linear form of a body, with its tags that are not on the line."""
    V = fem.functionspace(mesh, ("Lagrange", degree))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    x, n = ufl.SpatialCoordinate(mesh), ufl.FacetNormal(mesh)
    ds = ufl.Measure("ds", mesh, subdomain_data=tags, metadata={"quadrature_degree": 12})(outer)
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx - k**2 * ufl.inner(u, v) * ufl.dx
    a -= 1j * k * ufl.inner(u, v) * ds
    incoming = 1j * k * (direction[0] * n[0] + direction[1] * n[1] - 1) * wave(x)
    return V, a, ufl.inner(incoming, v) * ds


CELLS = (40, 44)  # on four wavelengths


def tied(degree, n=CELLS):
    """Solve on two meshes with n cells along the line."""
    left, tags0 = meshes.block(comm, (n[0] // 2, n[0]), placed(-SIZE / 2, 0))
    right, tags1 = meshes.block(comm, (n[1] // 2, n[1]), placed(0, SIZE / 2))
    outer = (meshes.BOTTOM, meshes.TOP)
    V0, a0, L0 = forms(left, tags0, degree, (meshes.LEFT, *outer))
    V1, a1, L1 = forms(right, tags1, degree, (meshes.RIGHT, *outer))
    tie = Tie.between((V0, tags0.find(meshes.RIGHT)), (V1, tags1.find(meshes.LEFT)))
    return TiedProblem([a0, a1], [L0, L1], ties=[tie]).solve()


def fused(degree, n=CELLS):
    """Solve on one mesh with the columns of both, and a line of edges where the tie is."""
    columns, whole = n[0] // 2 + n[1] // 2, placed(-SIZE / 2, SIZE / 2)

    def mapping(x):
        across = np.interp(x[:, 0], (0, n[0] // 2 / columns, 1), (0, 0.5, 1))
        return whole(np.column_stack((across, x[:, 1])))

    mesh, tags = meshes.block(comm, (columns, sum(n) // 2), mapping)
    outer = (meshes.LEFT, meshes.RIGHT, meshes.BOTTOM, meshes.TOP)
    _, a, L = forms(mesh, tags, degree, outer)
    return TiedProblem([a], [L]).solve()


# The reflected wave is the one that the line would mirror. On its left, least squares tell how
# much of it there is beside the incoming one.


def measure(us):
    """L² error, relative to the wave, and the amplitude that is reflected."""
    square, gram, loads = 0.0, np.zeros((2, 2), complex), np.zeros(2, complex)
    for u in us:
        mesh = u.function_space.mesh
        x, dx = ufl.SpatialCoordinate(mesh), ufl.dx(metadata={"quadrature_degree": 12})
        left = ufl.conditional(ufl.lt(ufl.real(x[0] - line(x[1])), 0), 1.0, 0.0)
        first, second = (fem.Constant(mesh, np.zeros(2, default_scalar_type)) for _ in range(2))
        e = u - wave(x)
        error = fem.form(ufl.inner(e, e) * dx)
        product = fem.form(left * ufl.inner(wave(x, first), wave(x, second)) * dx)
        share = fem.form(left * ufl.inner(u, wave(x, second)) * dx)
        square += fem.assemble_scalar(error).real
        for i, d in enumerate((direction, mirrored)):
            second.value[:] = d
            loads[i] += fem.assemble_scalar(share)
            for j, other in enumerate((direction, mirrored)):
                first.value[:] = other
                gram[i, j] += fem.assemble_scalar(product)
    amplitudes = np.linalg.solve(comm.allreduce(gram), comm.allreduce(loads))
    return float(np.sqrt(comm.allreduce(square)) / SIZE), float(np.abs(amplitudes[1]))


rows = []
for degree in args.degrees:
    us = tied(degree)
    error, reflected = measure(us)
    alone, reflected_alone = measure(fused(degree))
    rows.append(
        {
            "degree": degree,
            "error": error,
            "fused": alone,
            "ratio": error / alone,
            "reflected": reflected,
            "reflected_fused": reflected_alone,
        }
    )
if comm.rank == 0:
    print("relative L² error and reflected amplitude, tied and on a fused mesh")
    print("degree     tied     fused  ratio   reflected: tied     fused")
    for row in rows:
        print(
            "{degree:6d} {error:8.2e}  {fused:8.2e}  {ratio:5.3f}          {reflected:8.1e}  "
            "{reflected_fused:8.1e}".format(**row)
        )
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))
if args.plot:
    from hypergap_dolfinx import plot

    plot.field(us, args.plot / "wave.png", title="real part of u")
