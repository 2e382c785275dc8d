# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""A periodic cell with a fibre in its middle, unstructured, with Gmsh."""

from mpi4py import MPI

import numpy as np

import dolfinx
from meshes.session import gmsh_session
from meshes.solids import HOLE
from meshes.structured import BOTTOM, LEFT, RIGHT, TOP, coordinate_element

# Gmsh's nodes of a triangle in DOLFINx's order
_NODES = {1: [0, 1, 2], 2: [0, 1, 2, 4, 5, 3]}


def fibre_cell(
    comm: MPI.Comm, h: float, radius: float, *, degree: int = 1, matching: bool = False
) -> list[tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]]:
    """The unit square with a fibre in its middle, in triangles.

    Args:
        comm: Communicator.
        h: Cell size.
        radius: The fibre's.
        degree: Degree of the geometry, 1 or 2.
        matching: Whether opposite faces have the same nodes; otherwise LEFT and BOTTOM have a
            third less cells.

    Returns:
        Meshes of the matrix and of the fibre, which match, each with facet tags: LEFT, RIGHT,
        BOTTOM and TOP, and HOLE where they meet.
    """
    x, parts = comm.bcast(_triangles(h, radius, degree, matching, comm.rank == 0))
    return [_create(comm, x, cells, degree) for cells in parts]


def _create(comm: MPI.Comm, x, cells, degree: int):
    """A mesh of what every rank has, and its facet tags."""
    used, cells = np.unique(cells, return_inverse=True)
    x, cells = x[used, :2], cells.reshape(-1, len(_NODES[degree])).astype(np.int64)
    if comm.rank:
        x, cells = x[:0], cells[:0]
    element = coordinate_element("triangle", degree, 2)
    mesh = dolfinx.mesh.create_mesh(comm, cells, e=element, x=x)

    def inside(x):
        return (np.abs(x[:2] - 0.5) < 0.49).all(axis=0)

    markers = [(HOLE, inside)] + [
        (tag, lambda x, axis=axis, end=end: np.isclose(x[axis], end))
        for tag, axis, end in ((LEFT, 0, 0), (RIGHT, 0, 1), (BOTTOM, 1, 0), (TOP, 1, 1))
    ]
    found = [dolfinx.mesh.locate_entities_boundary(mesh, 1, marker) for _, marker in markers]
    tags = np.repeat([tag for tag, _ in markers], [len(facets) for facets in found])
    facets = np.concatenate(found)
    order = np.argsort(facets)
    return mesh, dolfinx.mesh.meshtags(mesh, 1, facets[order], tags[order].astype(np.int32))


def _triangles(h: float, radius: float, degree: int, matching: bool, here: bool):
    """Nodes, and the cells of the matrix and of the fibre; None elsewhere."""
    if not here:
        return None
    with gmsh_session() as gmsh:
        gmsh.option.setNumber("Mesh.MeshSizeMin", h)
        gmsh.option.setNumber("Mesh.MeshSizeMax", h)
        gmsh.option.setNumber("Mesh.ElementOrder", degree)
        cad, model = gmsh.model.occ, gmsh.model
        square, disc = cad.addRectangle(0, 0, 0, 1, 1), cad.addDisk(0.5, 0.5, 0, radius, radius)
        cad.fragment([(2, square)], [(2, disc)])
        cad.synchronize()
        n = round(1 / h)
        for _, curve in model.getEntities(1):
            low, high = np.reshape(model.getBoundingBox(1, curve), (2, 3))[:, :2]
            across = (high - low).argmin()
            if high[across] - low[across] < 1e-3:  # not the fibre's outline
                coarse = not matching and low[across] < 0.5
                model.mesh.setTransfiniteCurve(curve, (2 * n // 3 if coarse else n) + 1)
        model.mesh.generate(2)
        tags, x, _ = model.mesh.getNodes()
        kind = model.mesh.getElementType("Triangle", degree)
        parts = {}
        for _, face in model.getEntities(2):
            around = model.getBoundary([(2, face)], combined=False, oriented=False)
            parts[len(around)] = model.mesh.getElementsByType(kind, face)[1]
    order, nodes = np.argsort(tags), _NODES[degree]
    return x.reshape(-1, 3)[order], [
        np.searchsorted(tags, parts[k], sorter=order).reshape(-1, len(nodes))[:, nodes]
        for k in (5, 1)
    ]
