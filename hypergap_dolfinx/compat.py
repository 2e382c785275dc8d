# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The differences between DOLFINx 0.9, 0.10 and 0.11, all of them, and nothing else."""

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx
import dolfinx.fem.petsc
from dolfinx import fem, la
from dolfinx.mesh import Mesh

VERSION = tuple(int(v) for v in dolfinx.__version__.split(".")[:2])


def coordinate_element(mesh: Mesh):
    """The coordinate element of a mesh with one cell type."""
    return mesh.geometry.cmaps[0] if VERSION >= (0, 11) else mesh.geometry.cmap


def geometry_dofmap(mesh: Mesh) -> npt.NDArray[np.int32]:
    """Geometry nodes of each cell, ``(num_cells, num_nodes)``."""
    return mesh.geometry.dofmaps[0] if VERSION >= (0, 11) else mesh.geometry.dofmap


def create_vector(V: fem.FunctionSpace) -> PETSc.Vec:
    """A ghosted PETSc vector for a function space."""
    if VERSION < (0, 10):
        return la.create_petsc_vector(  # type: ignore[attr-defined]
            V.dofmap.index_map, V.dofmap.index_map_bs
        )
    return dolfinx.fem.petsc.create_vector(V)
