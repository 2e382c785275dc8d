# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later

# # Any assemblies
#
# A square or a cube is cut into 3 to 12 boxes. Each cut goes through a whole piece, so faces meet
# in Ts and crosses. Each box has its own mesh of triangles, quadrilaterals, tetrahedra or
# hexahedra, with sizes of up to 1 : 4 and with nodes moved along its faces. The assembly is
# straight, sheared or bent. If it is bent, the two polygons of an interface lie apart by the sag of
# both. `find_touching` finds the interfaces, `Tie.between` ties them.
#
# The exact solution is a smooth field, for Poisson's or the elastic operator, degrees 1 and 2, and
# a material of its own for each box, up to 1 : 10⁴. With the flux λ of the softest material through
# all interfaces,
#
#     a_i(u_i, v) = a_i(u, v) + ∫ λ(v) over what is tied or free,
#
# with λ as the volume integral of a divergence, so that no form depends on where the interfaces
# are. On some outer sides the field is prescribed, on the others λ.
#
# Each scene has a line: the H¹ error over that of the interpolant, the L² error of λ on Σ, and the
# largest error of a tie's area; with `--conforming` also the H¹ error on one conforming mesh of
# simplices, with cells of the same sizes, over that of its own interpolant.
#
#     python demos/any_assemblies.py --dim 3 --scenes 20 --seed 1 --json rows.json
#     python demos/any_assemblies.py --dim 3 --only 7

# +
import argparse
import json
import sys
import time
from collections import Counter
from itertools import combinations
from pathlib import Path

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from dolfinx import default_scalar_type, fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import InterfaceError, SolveError, Tie, TiedProblem, find_touching
from meshes.cad import fused_boxes

GOOD, WORST = 1.1, 1.3  # H¹ error over the interpolant's: in 95 % of the scenes, in all
AREA = {2: 0.01, 3: 1}  # relative error of tied areas is less than this; 1: a tie is missing
NU = 0.3
# -

# ## Scenes


# +
def partition(rng, dim, num):
    """Boxes of the unit square or cube, ``(num, 2, dim)``.

    None is thinner than 0.16, no step from box to box is lower than 0.05: what is lower than a
    coarse facet's sag is not in the meshes.
    """
    boxes = [np.array((np.zeros(dim), np.ones(dim)))]
    while len(boxes) < num:
        sizes = np.array([np.ptp(box, axis=0) for box in boxes])
        which = int(rng.choice(len(boxes), p=sizes.prod(axis=1)))
        axis = int(rng.choice(dim, p=sizes[which] / sizes[which].sum()))
        if sizes[which, axis] < 0.34:
            continue
        at = boxes[which][0, axis] + rng.uniform(0.16, sizes[which, axis] - 0.16)
        if np.abs(np.array(boxes)[:, :, axis] - at).min() < 0.05:
            continue
        low, high = boxes.pop(which)
        for start, end in ((low[axis], at), (at, high[axis])):
            a, b = low.copy(), high.copy()
            a[axis], b[axis] = start, end
            boxes.append(np.array((a, b)))
    return np.array(boxes)


class Scene:
    """A partition, its meshes, a field and materials."""

    def __init__(self, seed, dim):
        """Draw one."""
        rng = np.random.default_rng((seed, dim))
        self.seed, self.dim = seed, dim
        self.shape = str(rng.choice(("straight", "sheared", "curved", "curved")))
        self.degree = int(rng.integers(1, 3))
        self.vector = bool(rng.random() < 0.5)
        self.boxes = partition(rng, dim, int(rng.integers(3, 13)))
        num = len(self.boxes)
        kinds = ("triangle", "quadrilateral") if dim == 2 else ("tetrahedron", "hexahedron")
        self.cells = [str(rng.choice(kinds)) for _ in range(num)]
        finest = (0.04 if dim == 2 else 0.09) * self.degree
        sizes = finest * np.exp(rng.uniform(0, np.log(4), num))
        counts = np.ptp(self.boxes, axis=1) / sizes[:, None]
        self.counts = np.clip(np.rint(counts), 2, 30 if dim == 2 else 8).astype(int)
        contrast = 10 ** rng.uniform(0, 4) if rng.random() < 0.5 else 1
        moduli = np.exp(rng.uniform(0, 1, num) * np.log(contrast))
        self.moduli = moduli / moduli.min()
        self.free = int(rng.integers(0, 2 * dim + 1))  # this face of the whole; none
        self.shear = np.eye(dim) + rng.uniform(-0.3, 0.3, (dim, dim))
        self.bend = rng.uniform(0.03, 0.12, dim), rng.uniform(0, 2 * np.pi, dim)
        self.move = [
            (rng.uniform(-0.15, 0.15, dim), rng.uniform(0, 2 * np.pi, (dim, dim)))
            for _ in range(num)
        ]
        size = dim if self.vector else 1
        self.wave = rng.uniform(-2.5, 2.5, (size, dim)), rng.uniform(0, 2 * np.pi, size)

    def place(self, x):
        """Places in the unit square or cube to those in the scene."""
        if self.shape == "sheared":
            return x @ self.shear
        if self.shape == "straight":
            return x
        size, phase = self.bend
        others = sum(np.roll(x, -k, axis=1) for k in range(1, self.dim))
        return x + size * np.sin(2.5 * others + phase)

    def gradient(self, x):
        """Derivatives of the places, ``(num, dim, dim)``, at places in the unit square or cube."""
        if self.shape == "sheared":
            return np.tile(self.shear.T, (len(x), 1, 1))
        F = np.tile(np.eye(self.dim), (len(x), 1, 1))
        if self.shape == "curved":
            size, phase = self.bend
            others = x.sum(axis=1, keepdims=True) - x
            slope = 2.5 * size * np.cos(2.5 * others + phase)
            F += slope[:, :, None] * (1 - np.eye(self.dim))
        return F

    def faces(self):
        """Pairs of boxes with a common face: its axis and area in the unit square or cube."""
        found = {}
        for i, j in combinations(range(len(self.boxes)), 2):
            a, b = self.boxes[i], self.boxes[j]
            sizes = np.minimum(a[1], b[1]) - np.maximum(a[0], b[0])
            axis = int(sizes.argmin())
            extents = np.delete(sizes, axis)
            if abs(sizes[axis]) < 1e-9 < extents.min():
                found[i, j] = axis, extents.prod()
        return found

    def area(self, axis, x, weights, normals):
        """Area in the unit square or cube of a surface there: a flux, whatever its chords.

        The field e/det F with e the axis' direction and F the gradient, carried by F, has no
        divergence.
        """
        X = x.copy()
        for _ in range(20):  # Newton's method
            X -= np.linalg.solve(self.gradient(X), (self.place(X) - x)[..., None])[..., 0]
        F = self.gradient(X)
        flux = F[:, :, axis] / np.linalg.det(F)[:, None]
        return weights @ np.einsum("pi,pi->p", flux, normals)

    @property
    def order(self):
        """Degree of the meshes' geometry."""
        return self.degree if self.shape == "curved" else 1

    def conforming(self):
        """One mesh of all boxes, with tags of its facets and of the boxes' cells."""
        sizes = (np.ptp(self.boxes, axis=1) / self.counts).prod(axis=1) ** (1 / self.dim)
        return fused_boxes(MPI.COMM_WORLD, self.boxes, sizes, self.place, degree=self.order)

    def mesh(self, i):
        """The mesh of a box."""
        low, high = self.boxes[i]
        size, phase = self.move[i]

        def mapping(x):
            for axis in range(self.dim):  # nodes move along faces
                other = np.cos(3 * x + phase[axis])[:, np.arange(self.dim) != axis].prod(axis=1)
                x[:, axis] += size[axis] * np.sin(2 * np.pi * x[:, axis]) / 2 * other
            return self.place(low + x * (high - low))

        options = {"cell": self.cells[i], "degree": self.order}
        return meshes.block(MPI.COMM_WORLD, tuple(self.counts[i]), mapping, **options)


class Body:
    """A box with its space, and its forms, whose numbers are constants: they share kernels.

    Without a number it is all boxes on one conforming mesh.
    """

    def __init__(self, scene, i=None):
        """Mesh it."""
        dim = scene.dim
        self.mesh, tags, *cells = scene.conforming() if i is None else scene.mesh(i)
        shape = ((dim,),) if scene.vector else ()
        self.V = fem.functionspace(self.mesh, ("Lagrange", scene.degree, *shape))
        outer = [  # faces of the whole
            2 * axis + end + 1
            for axis in range(dim)
            for end in (0, 1)
            if i is None or scene.boxes[i][end, axis] == end
        ]
        free = scene.free + 1
        facets = tags.indices[np.isin(tags.values, [tag for tag in outer if tag != free])]
        self.exact = fem.Function(self.V)
        k, phase = scene.wave
        self.exact.interpolate(
            lambda x: np.squeeze(
                np.sin(k @ x[:dim] + phase[:, None]), axis=() if scene.vector else 0
            )
        )
        dofs = fem.locate_dofs_topological(self.V, dim - 1, facets)
        self.bcs = [fem.dirichletbc(self.exact, dofs)]
        if i is None:
            modulus = fem.Function(fem.functionspace(self.mesh, ("DG", 0)))
            modulus.x.array[cells[0].indices] = scene.moduli[cells[0].values]
        else:
            modulus = fem.Constant(self.mesh, default_scalar_type(scene.moduli[i]))
        self._forms(scene, modulus, tags.find(free) if free in outer else [])

    def _forms(self, scene, E, free):
        mesh, dim, vector = self.mesh, scene.dim, scene.vector
        K, phase = (
            fem.Constant(mesh, np.asarray(value, dtype=default_scalar_type)) for value in scene.wave
        )
        u, v = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        angle = ufl.dot(K, ufl.SpatialCoordinate(mesh)) + phase
        exact = ufl.as_vector([ufl.sin(angle[i]) for i in range(len(scene.wave[1]))])
        self.field = exact if vector else exact[0]

        def flux(w):
            if not vector:
                return ufl.grad(w)
            eps = ufl.sym(ufl.grad(w))
            return (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(dim)) / (1 + NU)

        self.flux = flux(self.field)
        strain = (lambda w: ufl.sym(ufl.grad(w))) if vector else ufl.grad
        rule = {"quadrature_degree": 2 * scene.degree + 2}
        dx = ufl.Measure("dx", mesh, metadata=rule)
        facets = np.sort(np.asarray(free, dtype=np.int32))
        tags = dolfinx.mesh.meshtags(mesh, dim - 1, facets, np.ones_like(facets))
        ds = ufl.Measure("ds", mesh, subdomain_data=tags, metadata=rule)(1)
        self.a = E * ufl.inner(flux(u), strain(v)) * ufl.dx
        self.L = (E - 1) * ufl.inner(self.flux, strain(v)) * dx
        self.L += -ufl.inner(ufl.div(self.flux), v) * dx
        self.L += ufl.inner(ufl.dot(self.flux, ufl.FacetNormal(mesh)), v) * ds

    def error(self, u):
        """Square of the gradient's error."""
        e = ufl.grad(u) - ufl.grad(self.field)
        dx = ufl.dx(metadata={"quadrature_degree": 2 * self.V.ufl_element().degree + 2})
        value = fem.assemble_scalar(fem.form(ufl.inner(e, e) * dx))
        return self.mesh.comm.allreduce(value.real)


def traction_error(scene, problem, ties):
    """Relative L² error of λ on Σ: normals of the whole's smooth interfaces are the sides' own."""
    errors = np.zeros(2)
    K, phase = scene.wave
    for tie in ties:
        q = tie.quadrature(2 * scene.degree)
        values = q.evaluate(tie.traction(problem))
        x, n, values = (a.reshape(-1, a.shape[-1]) for a in (q.x, q.normal, values))
        gradient = np.cos(x @ K.T + phase)[..., None] * K  # (point, component, axis)
        if scene.vector:
            eps = (gradient + gradient.transpose(0, 2, 1)) / 2
            trace = np.einsum("pii->p", eps)[:, None, None]
            gradient = (eps + NU / (1 - 2 * NU) * trace * np.eye(scene.dim)) / (1 + NU)
        exact = np.einsum("pci,pi->pc", gradient, n)
        for k, f in enumerate((values - exact, exact)):
            errors[k] += q.weights.ravel() @ (np.abs(f) ** 2).sum(axis=1)
    errors = MPI.COMM_WORLD.allreduce(errors)
    return float(np.sqrt(errors[0] / errors[1]))


def area_error(scene, ties, pairs):
    """Largest difference of tied areas and exact ones, over these; 1 where a tie is missing."""
    faces, errors = scene.faces(), [0.0]
    for tie, pair in zip(ties, pairs, strict=True):
        axis, area = faces.pop(pair, (0, np.inf))
        q = tie.quadrature(2 * scene.degree + 2)
        points = (
            q.x.reshape(-1, scene.dim),
            q.weights.ravel(),
            q.normal.reshape(-1, scene.dim),
        )
        tied = MPI.COMM_WORLD.allreduce(scene.area(axis, *points))
        errors.append(abs(1 - abs(tied) / area))
    return 1.0 if faces else float(max(errors))


def conforming_error(scene):
    """H¹ error on one conforming mesh over that of its own interpolant."""
    body = Body(scene)
    (u,) = TiedProblem([body.a], [body.L], bcs=body.bcs).solve()
    return float(np.sqrt(body.error(u) / body.error(body.exact)))


def run(seed, dim, beside):
    """A scene's row; with one conforming mesh beside it if the error is more than ``beside``."""
    scene = Scene(seed, dim)
    row = {
        "seed": seed, "dim": dim, "shape": scene.shape, "boxes": len(scene.boxes),
        "cells": "+".join(sorted(set(scene.cells))), "degree": scene.degree,
        "operator": "elastic" if scene.vector else "Poisson", "contrast": scene.moduli.max(),
        "ties": 0, "dofs": 0, "h1": None, "traction": None, "area": None, "conforming": None,
        "error": "",
    }  # fmt: skip
    start = time.process_time()
    try:
        bodies = [Body(scene, i) for i in range(len(scene.boxes))]
        row["dofs"] = sum(b.V.dofmap.index_map.size_global * b.V.dofmap.bs for b in bodies)
        spaces = [body.V for body in bodies]
        ties, pairs = [], find_touching(spaces)
        for sides in pairs:
            stiffness = (scene.moduli[spaces.index(V)] for V, _ in sides)
            ties.append(Tie.between(*sides, stiffness=tuple(stiffness)))
        row["ties"] = len(ties)
        row["area"] = area_error(scene, ties, [pair.numbers for pair in pairs])
        parts = {"a": [b.a for b in bodies], "L": [b.L for b in bodies]}
        problem = TiedProblem(**parts, bcs=[bc for b in bodies for bc in b.bcs], ties=ties)
        us = problem.solve()
        errors = [(b.error(u), b.error(b.exact)) for b, u in zip(bodies, us, strict=True)]
        row["h1"] = float(np.sqrt(np.divide(*np.sum(errors, axis=0))))
        row["traction"] = traction_error(scene, problem, ties)
        if row["h1"] > beside:
            row["conforming"] = conforming_error(scene)
    except (InterfaceError, SolveError, RuntimeError) as error:
        row["error"] = f"{type(error).__name__}: {error}"
    row["seconds"] = time.process_time() - start
    row["solved"] = row["h1"] is not None and row["area"] < AREA[dim]
    row["ok"] = row["solved"] and row["h1"] <= WORST
    return row


# -


def line(row):
    """A scene's line."""
    said = (
        row["error"]
        or f"H¹ {row['h1']:.3f} of the interpolant's, λ {row['traction']:.3f}, "
        f"area {row['area']:.0e}"
    )
    if row["conforming"] is not None:
        said += f"; one conforming mesh {row['conforming']:.3f}"
    return (
        f"{row['seed']:4} {row['shape']:8} {row['boxes']:2} boxes, {row['cells']}, degree "
        f"{row['degree']}, {row['operator']}, 1 : {row['contrast']:.0f}: {row['ties']:2} ties, "
        f"{row['dofs']} dofs, {row['seconds']:.1f} s: {said}"
    )


def summary(rows):
    """A table of what was solved, and of errors."""
    print()
    for name in ("shape", "degree", "operator", "cells"):
        for value, number in sorted(Counter(row[name] for row in rows).items()):
            h1 = [row["h1"] for row in rows if row[name] == value and row["h1"] is not None]
            worst = f"H¹ {np.median(h1):.3f} (median), {max(h1):.3f} (worst)" if h1 else ""
            print(f"{name} {value}: {len(h1)} of {number}; {worst}")
    h1 = np.array([row["h1"] for row in rows if row["h1"] is not None])
    print(
        f"{sum(row['solved'] for row in rows)} of {len(rows)} solved, "
        f"{(h1 <= GOOD).sum()} with H¹ ≤ {GOOD}, "
        f"{(h1 <= WORST).sum()} with H¹ ≤ {WORST} of the interpolant's"
    )


def main():
    """Solve scenes, and say what came of them."""
    parser = argparse.ArgumentParser(description="Boxes of random partitions are tied.")
    parser.add_argument("--dim", type=int, choices=(2, 3), default=2)
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="of the first scene")
    parser.add_argument("--only", type=int, nargs="+", help="these scenes")
    parser.add_argument(
        "--conforming", type=float, nargs="?", const=WORST, default=np.inf, metavar="H1",
        help="with one conforming mesh beside scenes with a larger error than this (1.3)",
    )  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args()
    rows = []
    for seed in args.only or range(args.seed, args.seed + args.scenes):
        rows.append(run(seed, args.dim, args.conforming))
        if MPI.COMM_WORLD.rank == 0:
            print(line(rows[-1]), flush=True)
    if MPI.COMM_WORLD.rank == 0:
        summary(rows)
        if args.json:
            args.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
