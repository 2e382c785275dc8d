# # How fast Σ is meshed and integrated
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# The cost of a tie before anything is solved, on one core: gap element matrices a second; the strip
# between two chains of 100 000 edges; tetrahedra between two spheres; and everything from facets to
# the blocks $B_0$ and $B_1$, over the number of facets. This should grow linearly: the exponent of
# a fit is printed.

# +
import argparse
import json
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

from mpi4py import MPI

import numpy as np
from scipy.spatial import ConvexHull, Delaunay

import basix
from dolfinx import fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Tie
from hypergap_dolfinx.gap_mesh import slab, strip
from hypergap_dolfinx.mortar import kernel
from hypergap_dolfinx.surface.trace import Surface, create_surface

# -


def fastest(run, repeats=5):
    """Seconds of processor time of the fastest of several runs."""
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        run()
        seconds.append(time.process_time() - start)
    return min(seconds)


# ## Gap element matrices
#
# of tetrahedra with a base on Γ0 and an apex on Γ1. Curved ones have their edge nodes displaced.


def cells_per_second(degree, geometry, num_cells):
    """Speed of the kernel on random cells."""
    cell = basix.CellType.tetrahedron
    psi, phi = (
        basix.create_element(basix.ElementFamily.P, cell, d, basix.LagrangeVariant.equispaced)
        for d in (geometry, degree)
    )
    random = np.random.default_rng(0)
    x = psi.points * (0.5 + random.random((num_cells, 1, 1))) * (1, 1, 0.01)
    alpha, normal = np.zeros((num_cells, 4)), np.zeros((num_cells, 3))
    alpha[:, 3] = normal[:, 2] = 1
    if geometry == 1:
        tables = kernel.GapElement.with_quadrature(psi, phi, 2 * degree - 2)
        matrices = kernel.affine_gap_matrices
    else:
        x += 0.02 * random.random(x.shape) * (1, 1, 0.1)
        tables = kernel.GapElement.with_quadrature(psi, phi, 2 * (degree + geometry))
        matrices = kernel.curved_gap_matrices
    return num_cells / fastest(lambda: matrices(tables, x, alpha, normal))


# ## Σ and its blocks
#
# between rings that are one cell thick.


def rings(n, degree=1):
    """Spaces on two rings and their facets: n and n − 7 edges face each other."""
    inner, ft0 = meshes.ring_sector(MPI.COMM_SELF, n, 1, 1.0, 1.5, degree=degree)
    outer, ft1 = meshes.ring_sector(MPI.COMM_SELF, n - 7, 1, 1.5, 2.0, degree=degree)
    V = [fem.functionspace(mesh, ("Lagrange", degree, (2,))) for mesh in (inner, outer)]
    return (V[0], ft0.find(meshes.OUTER)), (V[1], ft1.find(meshes.INNER))


def strip_seconds(n):
    """Meshing the strip, the surfaces being there."""
    sides = [create_surface(*side, name) for side, name in zip(rings(n), ("Γ0", "Γ1"), strict=True)]
    return fastest(lambda: strip.mesh_strip(*sides))


def tie_seconds(n, degree):
    """From facets to blocks."""
    sides = rings(n, degree)
    return fastest(lambda: Tie(*sides).blocks(), repeats=3)


# ## Σ in space
#
# between a ball and its shell, both triangulated at random, and between plates: flat ones of halved
# squares, and waved ones whose squares have lost their shape. Pieces that face each other, cells,
# checks, and where all vertices of the cells lie. Facets are those of both sides.


def sphere(num, name, seed):
    """A triangulated unit sphere of about as many facets; Γ1 is seen from inside."""
    i = np.arange(num // 2) + 0.5
    z, angle = 1 - 4 * i / num, 2 * np.pi * i * 0.618034 + seed
    x = np.column_stack((np.cos(angle), np.sin(angle), z))
    x[:, :2] *= np.sqrt(1 - z**2)[:, None]
    x += 0.5 * np.random.default_rng(seed).uniform(-1, 1, x.shape) / np.sqrt(num)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    x = x[np.lexsort(x.T[::-1])]
    t = ConvexHull(x).simplices
    outwards = np.linalg.det(x[t]) > 0
    t[outwards == (name == "Γ1")] = t[outwards == (name == "Γ1")][:, ::-1]
    return surface(name, x, t)


def plate(num, name, seed, jitter=0.0, wave=0.0):
    """A triangulated square of about as many facets; Γ1 is seen from below."""
    n = round(np.sqrt(num / 2))
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
    p = np.column_stack((i, j)) / n
    inner = (p > 0) & (p < 1)
    p[inner] += jitter / n * np.random.default_rng(seed).uniform(-1, 1, inner.sum())
    t = Delaunay(p).simplices.astype(np.int64)
    if not jitter:
        a = ((n + 1) * np.arange(n)[:, None] + np.arange(n)).ravel()
        b, c, d = a + n + 1, a + n + 2, a + 1
        t = np.vstack((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
    e, g = p[t[:, 1]] - p[t[:, 0]], p[t[:, 2]] - p[t[:, 0]]
    area = e[:, 0] * g[:, 1] - e[:, 1] * g[:, 0]
    t, up = t[abs(area) > 1e-9 / n**2], area[abs(area) > 1e-9 / n**2] > 0  # none in straight edges
    t[up == (name == "Γ1")] = t[up == (name == "Γ1")][:, ::-1]
    z = wave * np.sin(4 * np.pi * p[:, 0]) * np.sin(4 * np.pi * p[:, 1] + 0.3)
    return surface(name, np.column_stack((p, z)), t)


def surface(name, x, t):
    """A surface from its arrays."""
    P1 = basix.create_element(basix.ElementFamily.P, basix.CellType.triangle, 1)
    owner, dofs = np.zeros(len(t), dtype=np.int32), t.astype(np.int64)
    return Surface(name, x, t.astype(np.int32), x[t], dofs, owner, P1, P1, np.array((0, len(x))))


SCENES = {
    "spheres": sphere,
    "flat plates": plate,
    "rough plates": partial(plate, jitter=0.45, wave=0.1),
}


def slab_seconds(scene, num):
    """Filling the gap of two surfaces; facets there are, and seconds."""
    sides = SCENES[scene](9 * num // 20, "Γ0", 0), SCENES[scene](11 * num // 20, "Γ1", 1)
    vertices = basix.geometry(basix.CellType.tetrahedron)

    def run():
        new = [replace(side) for side in sides]  # that know nothing yet
        gap = slab.mesh_slab(MPI.COMM_SELF, *new)
        gap.hosts(vertices, np.arange(len(gap.cells)))

    return sum(len(side.facets) for side in sides), fastest(run, repeats=3)


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description="How fast Σ is meshed and integrated.")
    parser.add_argument("--quick", action="store_true", help="a hundredth of the cells")
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args()
    scale = 100 if args.quick else 1

    result = {
        "affine P1 tetrahedra, cells/s": cells_per_second(1, 1, 200000 // scale),
        "affine P2 tetrahedra, cells/s": cells_per_second(2, 1, 100000 // scale),
        "curved P2 tetrahedra, cells/s": cells_per_second(2, 2, 50000 // scale),
        f"strip of 2 × {100000 // scale} edges, s": strip_seconds(100000 // scale),
    }
    slab_seconds("spheres", 100)  # compiles what isn't
    for scene in SCENES:
        slabs = [slab_seconds(scene, n // scale) for n in (10000, 200000)]
        for num, seconds in slabs:
            result[f"Σ between {scene} of {num} facets, facets/s"] = num / seconds
        (few, short), (many, long) = slabs
        result[f"Σ between {scene}, exponent"] = np.log(long / short) / np.log(many / few)
    for degree in (1, 2):
        num = [n // scale for n in (4000, 8000, 16000, 32000)]
        seconds = [tie_seconds(n, degree) for n in num]
        slope, constant = np.polyfit(num, seconds, 1)
        result[f"tie of degree {degree}, s per facet of Γ0"] = slope
        result[f"tie of degree {degree}, s at no facets"] = constant
        result[f"tie of degree {degree}, exponent"] = np.polyfit(np.log(num), np.log(seconds), 1)[0]
    if MPI.COMM_WORLD.rank == 0:
        for name, value in result.items():
            print(f"{name:52s} {value:12.4g}")
        if args.json:
            args.json.write_text(json.dumps({k: float(v) for k, v in result.items()}, indent=1))


if __name__ == "__main__":
    main()
