# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Makes the mesh files beside it, which ``demos/read_meshes.py`` reads: ``python make_files.py``.

``plate_with_hole.msh`` (Gmsh, quadratic triangles) is the quarter of a square plate of side 8 with
a hole of radius 2, ``ring.xdmf`` (quadratic quadrilaterals) that of a ring with radii 1 and 2.
"""

import sys
from pathlib import Path

from mpi4py import MPI

import gmsh
import numpy as np

import dolfinx.io

FOLDER = Path(__file__).parent
sys.path.insert(0, str(FOLDER.parent))
import meshes  # noqa: E402


def plate_with_hole():
    """Tags: 10 the plate; 1 the hole's edge, 2 the plane x = 0, 3 y = 0, 4 x = 4 and y = 4."""
    gmsh.initialize(argv=[], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    occ = gmsh.model.occ
    plate, hole = occ.addRectangle(0, 0, 0, 4, 4), occ.addDisk(0, 0, 0, 2, 2)
    (surface,), _ = occ.cut([(2, plate)], [(2, hole)])
    occ.synchronize()
    groups: dict[str, list[int]] = {"hole": [], "x = 0": [], "y = 0": [], "outside": []}
    for _, curve in gmsh.model.getBoundary([surface], oriented=False):
        x, y, _ = gmsh.model.occ.getCenterOfMass(1, curve)
        straight = "x = 0" if np.isclose(x, 0) else "y = 0" if np.isclose(y, 0) else "outside"
        groups["hole" if np.hypot(x, y) < 2 else straight].append(curve)
    gmsh.model.addPhysicalGroup(2, [surface[1]], 10, "plate")
    for tag, (name, curves) in enumerate(groups.items(), 1):
        gmsh.model.addPhysicalGroup(1, curves, tag, name)
    gmsh.option.setNumber("Mesh.MeshSizeMin", 0.35)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.35)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(2)
    gmsh.write(str(FOLDER / "plate_with_hole.msh"))
    gmsh.finalize()


def ring():
    """Tags as of ``meshes.ring_sector``: 1 inside, 2 outside, 3 the plane y = 0, 4 x = 0."""
    mesh, tags = meshes.ring_sector(MPI.COMM_WORLD, 16, 8, 1, 2, degree=2)
    mesh.name, tags.name = "ring", "facets"
    with dolfinx.io.XDMFFile(mesh.comm, FOLDER / "ring.xdmf", "w") as file:
        file.write_mesh(mesh)
        mesh.topology.create_connectivity(1, 2)
        file.write_meshtags(tags, mesh.geometry)


if __name__ == "__main__":
    plate_with_hole()
    ring()
