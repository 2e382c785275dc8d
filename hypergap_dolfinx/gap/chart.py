# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Σ between surfaces in space that may be far apart, as bodies in contact are.

Which facets lie opposite to each other, and which cells there are between them, is found in a plane
into which both surfaces are projected along one axis: there they coincide, whatever their distance.
A cell's N · axis is the same in the plane and in space, so that no cell is turned over.
"""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.errors import NotFacingError, spot
from hypergap_dolfinx.gap.cells import Hosts
from hypergap_dolfinx.gap.clip import parts, sorted_out
from hypergap_dolfinx.gap.pieces import Side
from hypergap_dolfinx.gap.slab import SlabCells, fill_common, share
from hypergap_dolfinx.gap.slab_cells import Slab
from hypergap_dolfinx.gap.surface import Surface, normals_by_area
from hypergap_dolfinx.gap.triangulation import FACES, neighbours

LEANS = 0.25
"""Cosine between a facet's normal and the axis from which it is in the plane."""
KEEPS = 0.966
"""Cosine between the axis that was and what it would be now, from which the old one stays (15°)."""
AROUND = 0.5
"""Length of the mean of normals from which they have an axis: around a ball it is 0."""
PAIRS = 1_000_000
"""Pairs of facets that are looked at in one go."""


def axis_between(
    surfaces: tuple[Surface, Surface], before: npt.NDArray[np.float64] | None = None
) -> npt.NDArray[np.float64] | None:
    """The normal, from Γ0 to Γ1, of where surfaces are nearest to each other.

    It is that of the flatter side, which is exact if one is a plane.

    Args:
        surfaces: Γ0 and Γ1.
        before: What it was before: it stays as long as it will do.

    Returns:
        A unit vector; None if there they surround each other.

    Raises:
        NotFacingError: No facets face each other.
    """
    middles = [s.x[s.facets].mean(axis=1) for s in surfaces]
    nearest, distance = _nearest(surfaces, middles)
    if not np.isfinite(distance).any():
        raise NotFacingError(
            f"Γ0 around {spot(middles[0])} and Γ1 around {spot(middles[1])} can't "
            "come into contact: no facets face each other; check the tags."
        )
    near = distance <= distance.min() + max(s.size.max() for s in surfaces)
    means = []
    for i, facets in enumerate((np.unique(nearest[near]), np.flatnonzero(near))):
        normals = normals_by_area(surfaces[i].x[surfaces[i].facets[facets]])
        size = np.linalg.norm(normals, axis=1).sum()
        means.append((1 - 2 * i) * normals.sum(axis=0) / max(size, 1e-300))
    length = [np.linalg.norm(mean) for mean in means]
    flatter = int(length[1] > length[0])
    if length[flatter] < AROUND:
        return None
    axis = means[flatter] / length[flatter]
    return before if before is not None and before @ axis > KEEPS else axis


def _nearest(surfaces, middles) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
    """The nearest facet of Γ0 that faces each one of Γ1, and how far it is; infinite if none."""
    (x, y), (n, m) = middles, (s.normals for s in surfaces)
    nearest, distance = np.zeros(len(y), dtype=np.intp), np.empty(len(y))
    origin = x.mean(axis=0)
    x, y = x - origin, y - origin
    own = (x**2).sum(axis=1)
    chunk = max(1, PAIRS // len(x))
    for c in range(0, len(y), chunk):
        part = slice(c, c + chunk)
        square = own - 2 * y[part] @ x.T
        square[m[part] @ n.T > FACES] = np.inf
        nearest[part] = square.argmin(axis=1)
        square = square.min(axis=1) + (y[part] ** 2).sum(axis=1)
        distance[part] = np.sqrt(np.maximum(square, 0))
    return nearest, distance


def flattened(surface: Surface, axis: npt.NDArray[np.float64]) -> Surface:
    """A surface with straight facets, projected along an axis."""
    x = surface.x - (surface.x @ axis)[:, None] * axis
    linear = basix.create_element(basix.ElementFamily.P, surface.geometry.cell_type, 1)
    return replace(surface, x=x, nodes=x[surface.facets], geometry=linear)


def _pieces(surface: Surface, flat: Surface, towards: npt.NDArray[np.float64]) -> list[Side]:
    """Connected pieces of a surface that can be seen along an axis."""
    facets = np.flatnonzero(surface.normals @ towards > LEANS)
    if not len(facets):
        return []
    behind = neighbours(surface.polygons, surface.name, surface.x)
    side = Side.of(flat, facets, behind=behind)
    t = side.triangles
    if np.bincount(t[side.behind < 0], minlength=1).max() > 1:  # parts that touch in a vertex
        unit = np.broadcast_to(np.eye(3), (len(t), 3, 3))
        side = sorted_out(side, side.x, t, side.behind, np.arange(len(t)), unit)
    return parts(side)


def mesh_chart(
    comm: MPI.Comm, surfaces: tuple[Surface, Surface], axis: npt.NDArray[np.float64]
) -> SlabCells:
    """Mesh Σ between what two surfaces have in common as seen along an axis, on rank 0. Collective.

    Args:
        comm: Communicator.
        surfaces: Γ0 and Γ1.
        axis: A unit vector from Γ0 to Γ1.

    Returns:
        The cells, the same on every rank; their coordinates are those in the plane.

    Raises:
        NotFacingError: They have nothing in common.
        InterfaceError: There is no valid mesh.
        RuntimeError: There is no C compiler.
    """
    flat = flattened(surfaces[0], axis), flattened(surfaces[1], axis)

    def make() -> list[Slab]:
        sides = [
            _pieces(surface, planar, (1 - 2 * i) * axis)
            for i, (surface, planar) in enumerate(zip(surfaces, flat, strict=True))
        ]
        slabs = []
        for one in sides[0]:
            for other in sides[1]:
                try:
                    slabs += fill_common(one, other)
                except NotFacingError:
                    continue
        if not slabs:
            raise NotFacingError(
                f"Γ0 around {spot(surfaces[0].x)} and Γ1 around "
                f"{spot(surfaces[1].x)} have nothing in common: neither lies opposite to "
                "the other; check the tags."
            )
        return slabs

    gap = share(comm, flat, np.zeros(len(surfaces[1].facets), dtype=np.int32), make)
    return replace(gap, hosts=_Hosting(gap, surfaces, flat, axis))


class _Hosting:
    """Where points of cells lie on whole facets: what is left of cut ones may be too narrow."""

    def __init__(self, gap: SlabCells, surfaces, flat, axis):
        self._gap, self._sides, self._first = gap, [], []
        for i, (surface, planar) in enumerate(zip(surfaces, flat, strict=True)):
            facets = np.flatnonzero(surface.normals @ axis * (1 - 2 * i) > LEANS)
            side = Side.of(planar, facets, halves=True)
            first = np.full(len(surface.facets), -1)
            first[side.facets[::-1]] = np.arange(len(side.facets))[::-1]
            self._sides.append(side)
            self._first.append(first)

    def __call__(self, points: npt.NDArray[np.float64], cells: npt.NDArray[np.intp]) -> Hosts:
        """As ``GapCells.hosts``."""
        weights = np.column_stack((1 - points.sum(axis=1), points))
        weights[np.abs(weights) < 1e-12] = 0
        corners = self._gap.hosts(np.vstack((np.zeros(3), np.eye(3))), cells)
        found = corners[:, weights.argmax(axis=1)]
        between = np.flatnonzero((weights > 0).sum(axis=1) > 1)
        w = weights[between]
        x = np.einsum("qv,cvi->cqi", w, self._gap.x[self._gap.cells[cells]])
        alpha = corners.alpha @ w.T
        found.alpha[:, between] = alpha
        each = np.arange(len(cells))
        for i, side in enumerate(self._sides):
            nearest = np.abs(corners.alpha - i).argmin(axis=1)
            seed = self._first[i][corners.facets[i][each, nearest]]
            cell, point = np.nonzero(alpha != 1 - i)
            triangle, xi = side.project(x[cell, point], seed[cell])
            found.facets[i][cell, between[point]] = side.facets[triangle]
            found.X[i][cell, between[point]] = side.in_facets(triangle, xi)
        return found
