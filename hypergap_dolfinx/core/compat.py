# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Differences between DOLFINx 0.9, 0.10 and 0.11, and between their versions of PETSc.

Those that keyword arguments bridge (``create_mesh(comm, cells, e=..., x=...)``) are not here.
"""

from importlib import import_module

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix
import dolfinx
from dolfinx import fem, graph
from dolfinx.cpp import mesh as cpp_mesh
from dolfinx.mesh import Mesh

VERSION = tuple(int(v) for v in dolfinx.__version__.split(".")[:2])


def coordinate_element(mesh: Mesh):
    """The coordinate element of a mesh with one cell type."""
    return mesh.geometry.cmaps[0] if VERSION >= (0, 11) else mesh.geometry.cmap


def geometry_element(mesh: Mesh, cell_type: basix.CellType) -> basix.finite_element.FiniteElement:
    """The coordinate element of a mesh with one cell type, on its cells or facets."""
    cmap = coordinate_element(mesh)
    variant = basix.LagrangeVariant(int(cmap.variant))
    return basix.create_element(basix.ElementFamily.P, cell_type, cmap.degree, variant)


def geometry_dofmap(mesh: Mesh) -> npt.NDArray[np.int32]:
    """Geometry nodes of each cell, ``(num_cells, num_nodes)``."""
    return mesh.geometry.dofmaps[0] if VERSION >= (0, 11) else mesh.geometry.dofmap


def entities_to_geometry(
    mesh: Mesh, dim: int, entities: npt.NDArray[np.int32]
) -> npt.NDArray[np.int32]:
    """Geometry nodes of the vertices of entities, ``(num_entities, num_vertices)``.

    DOLFINx 0.9 divides by the number of entities: on a rank without any, the process would end with
    a floating-point exception.
    """
    if len(entities) == 0:
        kind = cpp_mesh.cell_entity_type(mesh.topology.cell_type, dim, 0)
        return np.empty((0, cpp_mesh.cell_num_vertices(kind)), dtype=np.int32)
    return dolfinx.mesh.entities_to_geometry(mesh, dim, entities)


def destinations(rank: npt.NDArray[np.int32]):
    """Destination ranks of cells, as a partitioner returns them."""
    lists = graph.adjacencylist(np.ascontiguousarray(rank, dtype=np.int32).reshape(-1, 1))
    return getattr(lists, "_cpp_object", lists)  # 0.9 has no class around it


def create_vector(V: fem.FunctionSpace) -> PETSc.Vec:
    """A ghosted PETSc vector for a function space."""
    index_map, bs = V.dofmap.index_map, V.dofmap.index_map_bs
    size = (index_map.size_local * bs, index_map.size_global * bs)
    ghosts = index_map.ghosts.astype(PETSc.IntType)
    return PETSc.Vec().createGhost(ghosts, size=size, bsize=bs, comm=index_map.comm)


class Triplets:
    """Triplets (row, column, value) that fill a new matrix, once or several times."""

    def __init__(self, A: PETSc.Mat, i: npt.NDArray, j: npt.NDArray):
        """Preallocate the matrix. Collective.

        Args:
            A: The matrix; its sizes and type are set.
            i: Global rows, on any rank.
            j: Global columns.
        """
        self._A = A
        i, j = i.astype(PETSc.IntType), j.astype(PETSc.IntType)
        self._at_once = hasattr(A, "setPreallocationCOO")
        if self._at_once:
            A.setPreallocationCOO(i, j)
            return
        A.setUp()  # petsc4py 3.22: into a hash table, which takes three times as long
        self._order = np.argsort(i, kind="stable")
        self._rows, start = np.unique(i[self._order], return_index=True)
        self._indptr = np.append(start, len(i)).astype(PETSc.IntType)
        self._columns = j[self._order]

    def set(self, values: npt.NDArray):
        """Set the values; those with equal row and column are added. Collective."""
        if self._at_once:
            self._A.setValuesCOO(values)
        else:
            if self._A.assembled:
                self._A.zeroEntries()
            add, values = PETSc.InsertMode.ADD, values[self._order]
            self._A.setValuesIJV(self._indptr, self._columns, values, add, self._rows)
        self._A.assemble()


def set_triplets(A: PETSc.Mat, i: npt.NDArray, j: npt.NDArray, values: npt.NDArray):
    """Fill a new matrix from (row, column, value) triplets; duplicates are added. Collective."""
    Triplets(A, i, j).set(values)


def interpolation_points(V: fem.FunctionSpace) -> npt.NDArray[np.float64]:
    """Interpolation points in the reference cell."""
    points = V.element.interpolation_points
    return points() if VERSION < (0, 10) else points  # type: ignore[operator]


def read_from_msh(filename, comm: MPI.Comm, gdim: int = 3):
    """A mesh, its cell tags and its facet tags from a Gmsh file. Collective."""
    module = import_module("dolfinx.io." + ("gmshio" if VERSION < (0, 10) else "gmsh"))
    return module.read_from_msh(filename, comm, gdim=gdim)[:3]


def is_used(options: PETSc.Options, name: str) -> bool:
    """True if PETSc has asked for an option, or petsc4py is too old to say."""
    return options.used(name) if hasattr(options, "used") else True
