# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Simplices in the parts of an assembly, with Gmsh: part by part, or in one.

Assemblies come from a CAD file, from a function that builds them with Gmsh's OpenCASCADE kernel, or
are boxes.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
from meshes.session import gmsh_session
from meshes.structured import coordinate_element, tag_faces

AROUND = 12
"""Edges around a cylinder, for cells as large as a part is thick; of 8 the polygon's area, which
differs by an edge from mesh to mesh, made 1.5 % of the rod's stiffness."""
Source = str | Path | Callable[..., Mapping[str, tuple[int, int]]]
"""A STEP file; or a function of ``gmsh.model.occ`` that adds volumes and returns them by name."""
# Gmsh's nodes of a triangle and a tetrahedron in DOLFINx's order
_NODES = {
    (2, 1): [0, 1, 2],
    (2, 2): [0, 1, 2, 4, 5, 3],
    (3, 1): [0, 1, 2, 3],
    (3, 2): [0, 1, 2, 3, 8, 9, 5, 7, 6, 4],
}


def parts_of_assembly(
    comm: MPI.Comm,
    source: Source,
    factor: float,
    *,
    degree: int = 1,
    cut: Mapping[str, int] | None = None,
    imprinted: bool = False,
) -> list[tuple[str, dolfinx.mesh.Mesh]]:
    """A mesh of each part of an assembly.

    Args:
        comm: Communicator.
        source: STEP file, or what builds the parts.
        factor: Cell size in each part over its thickness 2 V / A, volume over half of its surface;
            around cylinders there are at least 12 / factor edges.
        degree: Degree of the geometry, 1 or 2.
        cut: Parts that are cut across at half their length, by name, and along which axis that is.
        imprinted: True for facets that end where other parts do.

    Returns:
        Names and meshes, in the file's order; of what is cut the lower half comes first.
    """
    here = comm.rank == 0
    names, x, parts = comm.bcast(
        _tetrahedra(source, factor, degree, here, joined=imprinted, cut=cut or {})
    )
    return [
        (name, _create(comm, x, cells, degree)) for name, cells in zip(names, parts, strict=True)
    ]


def fused_assembly(
    comm: MPI.Comm, source: Source, factor: float, *, degree: int = 1
) -> tuple[list[str], dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]:
    """One conforming mesh of an assembly, cells of a mean size where parts meet.

    Args:
        comm: Communicator.
        source: As for :func:`parts_of_assembly`.
        factor: The same.
        degree: The same.

    Returns:
        The parts' names, the mesh, and the number of the part that each cell is in.
    """
    names, x, parts = comm.bcast(
        _tetrahedra(source, factor, degree, comm.rank == 0, joined=True, fused=True)
    )
    return names, *_create_fused(comm, x, parts, degree)


def fused_boxes(
    comm: MPI.Comm,
    boxes: npt.NDArray,
    sizes: Sequence[float],
    mapping: Callable[[npt.NDArray], npt.NDArray],
    *,
    degree: int = 1,
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags, dolfinx.mesh.MeshTags]:
    """One conforming mesh of boxes that fill the unit square or cube, mapped.

    Args:
        comm: Communicator.
        boxes: Their lowest and highest corners, ``(num_boxes, 2, dim)``.
        sizes: Cell size in each, where boxes meet the mean.
        mapping: As for :func:`~meshes.block`.
        degree: Degree of the geometry, 1 or 2.

    Returns:
        The mesh, facet tags as of :func:`~meshes.block`, and the number of the box that each cell
        is in.
    """
    dim = boxes.shape[2]
    x, parts = comm.bcast(_simplices(boxes, sizes, degree) if comm.rank == 0 else None)
    mesh, part = _create_fused(comm, x[:, :dim], parts, degree)
    facet_tags = tag_faces(mesh, range(dim))
    mesh.geometry.x[:, :dim] = mapping(mesh.geometry.x[:, :dim].copy())
    return mesh, facet_tags, part


def _create(comm: MPI.Comm, x: npt.NDArray, cells: npt.NDArray, degree: int) -> dolfinx.mesh.Mesh:
    """A mesh of what rank 0 has."""
    dim = x.shape[1]
    if comm.rank == 0:
        used, cells = np.unique(cells, return_inverse=True)
        x, cells = x[used], cells.reshape(-1, len(_NODES[dim, degree]))
    else:
        x, cells = x[:0], cells[:0]
    element = coordinate_element({2: "triangle", 3: "tetrahedron"}[dim], degree, dim)
    return dolfinx.mesh.create_mesh(comm, cells.astype(np.int64), e=element, x=x)


def _create_fused(
    comm: MPI.Comm, x: npt.NDArray, parts: Sequence[npt.NDArray], degree: int
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]:
    """A mesh of the cells of all parts, and the part of each cell."""
    mesh = _create(comm, x, np.concatenate(parts), degree)
    part = np.repeat(np.arange(len(parts), dtype=np.int32), [len(cells) for cells in parts])
    owned = np.arange(len(mesh.topology.original_cell_index), dtype=np.int32)
    of_cell = part[mesh.topology.original_cell_index]
    return mesh, dolfinx.mesh.meshtags(mesh, mesh.topology.dim, owned, of_cell)


def _sizes_at(model, volumes: list[tuple[int, int]], sizes: Sequence[float]):
    """Cell size at each volume, face, edge and point: the mean of the parts that meet there."""
    at = defaultdict(list)
    for volume, size in zip(volumes, sizes, strict=True):
        found = {volume}
        while found:
            for entity in found:
                at[entity].append(size)
            around = [model.getBoundary([e], combined=False, oriented=False) for e in found]
            found = {entity for entities in around for entity in entities}
    return {entity: sum(met) / len(met) for entity, met in at.items()}


def _cut_across(cad, volume: tuple[int, int], axis: int) -> list[tuple[int, int]]:
    """Both halves of a volume, the lower one first."""
    box = np.array(cad.getBoundingBox(*volume)).reshape(2, 3)
    corner, size = box[0] - 1, np.ptp(box, axis=0) + 2
    size[axis] /= 2
    (lower,), _ = cad.intersect([volume], [(3, cad.addBox(*corner, *size))], removeObject=False)
    (upper,), _ = cad.cut([volume], [lower], removeTool=False)
    return [lower, upper]


def _tetrahedra(
    source: Source,
    factor: float,
    degree: int,
    here: bool,
    *,
    joined: bool = False,
    fused: bool = False,
    cut: Mapping[str, int] | None = None,
):
    """Names of the parts, all nodes, and each part's cells; None where Gmsh isn't to run.

    Parts that are joined have common faces. If they aren't fused, each is meshed by itself.
    """
    if not here:
        return None
    with gmsh_session() as gmsh:
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", AROUND / factor)
        gmsh.option.setNumber("Mesh.ElementOrder", degree)
        gmsh.option.setNumber("Mesh.HighOrderOptimize", 1)  # else curved cells may be folded
        cad, model = gmsh.model.occ, gmsh.model
        if callable(source):
            parts = source(cad)
            names, volumes = list(parts), list(parts.values())
            cad.synchronize()
        else:
            volumes = cad.importShapes(str(source))
            cad.synchronize()
            # "Shapes/…/BOLT/bolt & & 256"
            names = [model.getEntityName(*v).split("&")[0].split("/")[-1].strip() for v in volumes]
        sizes = []
        for volume in volumes:
            area = sum(cad.getMass(*face) for face in model.getBoundary([volume], oriented=False))
            sizes.append(factor * 2 * cad.getMass(*volume) / area)
        if cut:
            pieces = [
                _cut_across(cad, volume, cut[name]) if name in cut else [volume]
                for name, volume in zip(names, volumes, strict=True)
            ]
            num = [len(part) for part in pieces]
            names, sizes = (np.repeat(part, num).tolist() for part in (names, sizes))
            volumes = [volume for part in pieces for volume in part]
            cad.synchronize()
        if joined:
            _, pieces = cad.fragment(volumes[:1], volumes[1:])
            volumes = [piece for (piece,) in pieces]
            cad.synchronize()
        if fused or not joined:
            return names, *_generate(model, volumes, sizes, degree)
        gmsh.option.setNumber("Mesh.MeshOnlyVisible", 1)
        nodes, parts = [], []
        for volume, size in zip(volumes, sizes, strict=True):
            model.mesh.clear()
            model.setVisibility(model.getEntities(), 0)
            model.setVisibility([volume], 1, recursive=True)
            x, (cells,) = _generate(model, [volume], [size], degree)
            parts.append(cells + sum(map(len, nodes)))
            nodes.append(x)
        return names, np.concatenate(nodes), parts


def _simplices(boxes: npt.NDArray, sizes: Sequence[float], degree: int):
    """Nodes and each box's cells of a conforming mesh."""
    dim = boxes.shape[2]
    with gmsh_session() as gmsh:
        gmsh.option.setNumber("Mesh.ElementOrder", degree)
        cad, volumes = gmsh.model.occ, []
        for low, high in boxes:
            place = *low, *np.zeros(3 - dim), *(high - low)
            volumes.append((dim, (cad.addRectangle if dim == 2 else cad.addBox)(*place)))
        _, pieces = cad.fragment(volumes[:1], volumes[1:])
        cad.synchronize()
        return _generate(gmsh.model, [piece for (piece,) in pieces], sizes, degree)


def _generate(model, volumes: list[tuple[int, int]], sizes: Sequence[float], degree: int):
    """Nodes and each volume's cells of a mesh with these sizes."""
    dim = volumes[0][0]
    wanted = _sizes_at(model, volumes, sizes)
    model.mesh.setSizeCallback(lambda dim, tag, x, y, z, size: min(size, wanted[dim, tag]))
    model.mesh.generate(dim)
    tags, x, _ = model.mesh.getNodes()
    kind = model.mesh.getElementType({2: "Triangle", 3: "Tetrahedron"}[dim], degree)
    cells = [model.mesh.getElementsByType(kind, tag)[1] for _, tag in volumes]
    order, nodes = np.argsort(tags), _NODES[dim, degree]
    cells = [
        np.searchsorted(tags, c, sorter=order).reshape(-1, len(nodes))[:, nodes] for c in cells
    ]
    return x.reshape(-1, 3)[order], cells
