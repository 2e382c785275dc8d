# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Σ in three dimensions: the slab of tetrahedra between two triangulated surfaces.

Γ1 is pushed off Γ0 along its vertex normals by about half a cell, which makes the slab an ordinary
solid. Its sides are closed like the strip in 2D, Gmsh fills it, and of the result only the
connectivity is kept: the vertices go back to where they belong.
"""

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.errors import InterfaceError, raise_on_all
from hypergap_dolfinx.gap import tetrahedra
from hypergap_dolfinx.gap.cells import GapCells, Hosts
from hypergap_dolfinx.gap.flat_cells import error_of, without_flat_cells
from hypergap_dolfinx.gap.pieces import Side, side_walls
from hypergap_dolfinx.gap.slab_cells import Slab, find
from hypergap_dolfinx.gap.surface import Surface
from hypergap_dolfinx.gap.triangulation import facing_pieces, project

ATTEMPTS = (
    *[(offset, True, tetrahedra.HXT) for offset in (0.5, 0.25, 1.0)],
    *[(offset, True, tetrahedra.DELAUNAY) for offset in (0.5, 0.25)],
    *[(offset, False, tetrahedra.HXT) for offset in (0.5, 1.0, 2.0)],
    *[(offset, False, tetrahedra.DELAUNAY) for offset in (1.0, 2.0)],
    *[(offset, True, tetrahedra.HXT) for offset in (0.1, 2.0)],
)
"""Offsets in cell sizes, whether along each vertex's own normal or the mean one, and algorithms.

The first that gives a valid Σ is taken."""


def _volumes(x, cells) -> npt.NDArray[np.float64]:
    return np.linalg.det(x[cells[:, 1:]] - x[cells[:, :1]]) / 6


def _enclosed(x, triangles) -> float:
    """Volume inside a closed triangulation, by the divergence theorem."""
    return float(np.linalg.det(x[triangles] - x.mean(axis=0)).sum() / 6)


def _fill(gmsh, sides: tuple[Side, Side]) -> Slab:
    """Mesh the slab between two pieces; tries several offsets.

    Raises:
        InterfaceError: The loops don't match; no offset gives a valid mesh.
    """
    side0, side1 = sides
    walls = side_walls(side0, side1)
    n0 = len(side0.vertices)
    triangles = np.vstack((side0.triangles[:, ::-1], n0 + side1.triangles[:, ::-1], walls))
    h = max(side.surface.size[side.facets].mean() for side in sides)
    reasons = []
    shells = [triangles]
    if not len(walls):  # closed surfaces: the outer one first
        shells = [triangles[: len(side0.facets)], triangles[len(side0.facets) :]]
        shells.sort(key=lambda part: -_enclosed(np.vstack((side0.x, side1.x)), part))
    normals = side1.vertex_normals
    mean = normals.mean(axis=0) / max(np.linalg.norm(normals.mean(axis=0)), 1e-3)
    for offset, own, algorithm in ATTEMPTS:
        pushed = side1.x - offset * h * (normals if own else mean)
        surface = np.vstack((side0.x, pushed))
        try:
            x, cells = tetrahedra.fill(gmsh, surface, shells, algorithm)
        except tetrahedra.MeshingError as error:
            reasons.append((f"Gmsh: {error}", None))
            continue
        volume = _volumes(x, cells)
        cells[volume < 0] = cells[volume < 0][:, [0, 2, 1, 3]]
        reason = _pushed_off_error(x, cells, triangles, len(side0.facets) + len(side1.facets))
        if reason is None:
            slab = Slab(sides, cells, _interior_hosts(sides, pushed, x[len(surface) :]))
            slab = without_flat_cells(slab)
            reason = error_of(slab)
            if reason is None:
                return slab
        reasons.append(reason)
    reason, place = min(reasons, key=lambda r: r[1] is None)
    place = side1.x.mean(axis=0) if place is None else place
    raise InterfaceError(
        f"no mesh of the gap between Γ0 and Γ1 around {place}, tried with {len(ATTEMPTS)} offsets: "
        f"{reason}. Do the surfaces have the same shape there? Refine the coarser one."
    )


def _pushed_off_error(x, cells, triangles, num_facets: int):
    """What is wrong with the mesh of the pushed-off slab, and where, or None."""
    faces = np.vstack([np.delete(cells, k, axis=1) for k in range(4)])
    missing = find(faces, triangles[:num_facets]) < 0
    if missing.any():
        place = x[triangles[:num_facets][missing.argmax()]].mean(axis=0)
        return f"{missing.sum()} facets are no faces of it", place
    volume = _volumes(x, cells)
    if not volume.min() > 0:
        return "it has cells without volume", x[cells[volume.argmin()]].mean(axis=0)
    enclosed = _enclosed(x, triangles)
    if not np.isclose(volume.sum(), enclosed, rtol=1e-8):
        return f"it has the volume {volume.sum():.6g}, not {enclosed:.6g}", x.mean(axis=0)
    return None


def _interior_hosts(sides: tuple[Side, Side], pushed, x) -> Hosts:
    """Where vertices that the mesher added in the pushed-off slab belong.

    Args:
        sides: The pieces.
        pushed: Vertices of Γ1's piece in the slab.
        x: The vertices added, ``(num_interior, 3)``.
    """
    facets, X, distance = [], [], []
    for vertices, side in zip((sides[0].x, pushed), sides, strict=True):
        centres = vertices[side.triangles].mean(axis=1)
        nearest = [np.linalg.norm(centres - point, axis=1).argmin() for point in x]
        seed = np.array(nearest, dtype=np.intp)
        facet, at = project(vertices, side.triangles, side.behind, x, seed)
        weights = np.column_stack((1 - at.sum(axis=1), at))
        foot = np.einsum("pv,pvi->pi", weights, vertices[side.triangles[facet]])
        facets.append(facet[None])
        X.append(at[None])
        distance.append(np.linalg.norm(x - foot, axis=1))
    total = distance[0] + distance[1]
    alpha = distance[0] / np.where(total > 0, total, 1)
    return Hosts(alpha[None], (facets[0], facets[1]), (X[0], X[1]))


def _mesh(sides: list[tuple[Side, Side]]) -> list[tuple]:
    """Cells and interior vertices of the slabs."""
    with tetrahedra.session() as gmsh:
        slabs = [_fill(gmsh, pair) for pair in sides]
    return [(slab.cells, slab.inner) for slab in slabs]


def mesh_slab(comm: MPI.Comm, surface0: Surface, surface1: Surface) -> GapCells:
    """Mesh Σ between two surfaces in space, on rank 0. Collective.

    Args:
        comm: Communicator.
        surface0: Γ0.
        surface1: Γ1.

    Returns:
        The cells, the same on every rank.

    Raises:
        InterfaceError: Surfaces that don't face each other or don't end at the same place, or
            for which there is no valid mesh.
        ImportError: Gmsh is missing.
    """
    group0, group1 = facing_pieces(surface0, surface1)
    sides = [
        (
            Side.of(surface0, np.flatnonzero(group0 == g)),
            Side.of(surface1, np.flatnonzero(group1 == g)),
        )
        for g in range(int(group1.max()) + 1)
    ]
    result, error = None, None
    if comm.rank == 0:
        try:
            result = _mesh(sides)
        except (InterfaceError, ImportError) as e:
            error = e
    kind = comm.bcast(type(error) if error else InterfaceError)
    raise_on_all(comm, str(error) if error else None, kind)
    slabs = [Slab(pair, *part) for pair, part in zip(sides, comm.bcast(result), strict=True)]

    num_cells = np.cumsum([0] + [len(slab.cells) for slab in slabs])
    offsets = np.cumsum([0] + [len(slab.x) for slab in slabs])

    def hosts(points: npt.NDArray[np.float64], cells: npt.NDArray[np.intp]) -> Hosts:
        order = np.argsort(cells, kind="stable")
        parts = np.split(cells[order], np.searchsorted(cells[order], num_cells[1:-1]))
        found = Hosts.concatenate(
            [
                slab.hosts(points, part - start)
                for slab, part, start in zip(slabs, parts, num_cells[:-1], strict=True)
            ]
        )
        return found[np.argsort(order, kind="stable")]

    return GapCells(
        x=np.vstack([slab.x for slab in slabs]),
        alpha=np.concatenate([slab.alpha for slab in slabs]),
        cells=np.vstack([slab.cells + start for slab, start in zip(slabs, offsets)]),
        normal=np.vstack([slab.normal for slab in slabs]),
        rank=np.concatenate([slab.rank for slab in slabs]),
        patch=group1,
        covered=np.ones(len(group1)),
        hosts=hosts,
    )
