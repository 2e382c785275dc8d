# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A smooth field across curved interfaces: the tie costs no more than the bodies' own error."""

import runpy
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pytest
from helpers import comm, sweep

import basix.ufl
import dolfinx
import meshes
import ufl
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices
from hypergap_dolfinx import Tie, TiedProblem
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.mortar.constraint import smooth_pieces
from hypergap_dolfinx.surface.trace import create_surface

DEPTH = 0.35
"""Thickness of both bodies, relative to the distance from the surface's middle."""
EDGES = np.array([(2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1)])
"""Of a tetrahedron, in Basix's order."""


@pytest.fixture(scope="module")
def surfaces():
    """The functions of the demo with random surfaces."""
    pytest.importorskip("scipy")
    return runpy.run_path(str(Path(__file__).parents[2] / "demos" / "any_surfaces.py"))


def field(x, m=np):
    """It is in no space."""
    wave = m.sin(0.9 * x[0] + 0.4) * m.cos(0.7 * x[1] - 0.5 * x[2])
    return wave + 0.5 * m.exp(0.5 * x[1] + 0.2 * x[2])


def thick(shape, h, outwards, degree):
    """Layers of tetrahedra on one side of a surface around the origin, and the facets on it.

    Args:
        shape: The surface.
        h: Size of its facets.
        outwards: Whether the body is outside.
        degree: Of the geometry; of degree 2 all layers are curved.
    """
    n, layers = len(shape.p), max(2, round(DEPTH / h))
    p = np.tile(shape.p, (layers + 1, 1))
    size = np.repeat(np.linspace(1, 1 + DEPTH if outwards else 1 - DEPTH, layers + 1), n)
    a, b, c = np.sort(shape.triangles, axis=1).T
    prisms = ((a, b, c, n + c), (a, b, n + b, n + c), (a, n + a, n + b, n + c))
    layer = np.vstack([np.column_stack(cell) for cell in prisms])
    cells = np.vstack([layer + i * n for i in range(layers)])
    x = size[:, None] * shape.place(p)
    if degree == 2:
        ends = np.sort(cells[:, EDGES].reshape(-1, 2), axis=1)
        edges, which = np.unique(ends, axis=0, return_inverse=True)
        middles = shape.place(shape.middle(*p[edges].swapaxes(0, 1), np.zeros(len(edges), bool)))
        cells = np.hstack((cells, len(x) + which.reshape(-1, 6)))
        x = np.vstack((x, size[edges].mean(axis=1)[:, None] * middles))
    element = basix.ufl.element("Lagrange", "tetrahedron", degree, shape=(3,))
    part = slice(None if comm.rank == 0 else 0)  # one rank has all, and hands them out
    mesh = dolfinx.mesh.create_mesh(comm, cells.astype(np.int64)[part], e=element, x=x[part])
    mesh.topology.create_connectivity(2, 3)
    facets = exterior_facet_indices(mesh.topology)
    corners = mesh.geometry.input_global_indices[
        compat.entities_to_geometry(mesh, 2, facets)[:, :3]
    ]
    return mesh, facets[(corners < n).all(axis=1)]


def relative_errors(us):
    """Relative error of the gradients, and of the values."""
    squares = np.zeros((2, 2))
    for u in us:
        mesh = u.function_space.mesh
        exact, dx = field(ufl.SpatialCoordinate(mesh), ufl), ufl.dx(mesh, {"quadrature_degree": 6})
        for i, f in enumerate((u - exact, fem.Function(u.function_space) - exact)):
            for j, g in enumerate((ufl.grad(f), f)):
                squares[i, j] += fem.assemble_scalar(fem.form(ufl.inner(g, g) * dx))
    squares = comm.allreduce(squares)
    return np.sqrt(squares[0] / squares[1])


def compared(bodies, degree):
    """Error of the gradient relative to the interpolant's, with either side as Γ1."""
    forms, loads, bcs, sides, interpolants = [], [], [], [], []
    for mesh, facets in bodies:
        V = fem.functionspace(mesh, ("Lagrange", degree))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        forms.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        source = -ufl.div(ufl.grad(field(ufl.SpatialCoordinate(mesh), ufl)))
        loads.append(source * v * ufl.dx(metadata={"quadrature_degree": 2 * degree + 2}))
        interpolants.append(fem.Function(V))
        interpolants[-1].interpolate(field)
        held = np.setdiff1d(exterior_facet_indices(mesh.topology), facets)
        bcs.append(fem.dirichletbc(interpolants[-1], fem.locate_dofs_topological(V, 2, held)))
        sides.append((V, facets))
    least = relative_errors(interpolants)[0]
    for ends in (sides, sides[::-1]):
        us = TiedProblem(forms, loads, bcs=bcs, ties=[Tie(*ends)]).solve()
        yield relative_errors(us)[0] / least


@pytest.mark.parametrize("degree, finer", sweep(product((1, 2), ("inside", "outside")), 3))
def test_ellipsoid(surfaces, degree, finer):
    """Facets in the ratio 2 : 3; those of degree 2 are curved (with straight ones: 1.3 … 2.4)."""
    rng = np.random.default_rng(3)
    sizes = np.sqrt(degree) * np.array((0.25, 0.375))
    bodies = []
    for h, outwards in zip(sizes if finer == "inside" else sizes[::-1], (False, True), strict=True):
        shape = surfaces["ball"](rng, h, surfaces["BALLS"]["ellipsoid"])
        bodies.append(thick(shape, h, outwards, degree))
    ratios = list(compared(bodies, degree))
    print(ratios)
    assert max(ratios) <= 1.1


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_faces_of_bent_boxes_are_pieces(cell):
    """Facets that turn inside hide no corner beside them: λ of two faces isn't one."""

    def bend(x):
        x = (0.8, 0, 0) + x * (0.2, 0.4, 1)
        return x + 0.12 * np.sin(2.5 * (x.sum(axis=1, keepdims=True) - x) + (5, 2, 3))

    mesh, tags = meshes.block(comm, (2, 2, 5), bend, cell=cell, degree=2)
    V = fem.functionspace(mesh, ("Lagrange", 1))
    for faces in combinations(range(1, 7), 2):
        facets = np.flatnonzero(np.isin(tags.values, faces))
        surface = create_surface(V, tags.indices[facets], "two faces")
        assert len(np.unique(smooth_pieces([surface])[0])) == 2, faces
