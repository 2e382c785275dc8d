# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact segments in the plane: fans of cells between both sides."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, override

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_geometry import fans, rays
from hypergap_dolfinx.contact_geometry.opened import OpenCells
from hypergap_dolfinx.contact_geometry.protocol import Found, Segments
from hypergap_dolfinx.contact_geometry.tolerances import END
from hypergap_dolfinx.errors import NotFacingError
from hypergap_dolfinx.gap_mesh.strip import mesh_strip
from hypergap_dolfinx.surface.moving import Displacements, Sparse, displaced
from hypergap_dolfinx.surface.trace import Surface


@dataclass
class _Fans(Found):
    """Fans, and their gaps once these are needed."""

    found: rays.Fans

    @cached_property
    def gaps(self) -> fans.PlaneGaps:
        """Weighted gaps."""
        return fans.find_gaps(self.found)


@dataclass(frozen=True)
class _Wall:
    """Ends of Γ0 and Γ1 that slide along one wall, as those of symmetry are."""

    vertices: tuple[int, int]
    """Vertices of Γ1 and of Γ0."""
    ends: tuple[int, int, int, int]
    """Edge and end of Γ1, edge and end of Γ0."""
    axis: int
    """Coordinate in which both are prescribed."""
    size: float
    """Size of Γ1's facet there."""

    def is_between(self, surfaces: tuple[Surface, Surface]) -> bool:
        """True if it is one wall where the surfaces are."""
        a, b = self.vertices
        apart = surfaces[0].x[b, self.axis] - surfaces[1].x[a, self.axis]
        return abs(apart) <= END * self.size


@dataclass
class PlaneSegments(Segments[_Fans]):
    """Contact segments in the plane: fans of cells."""

    held: Sequence[npt.NDArray[np.bool_]]
    """Masks of the prescribed dofs of both sides, ``(num_dofs_i, 2)`` each."""
    shares: bool = False
    """True if vertices of Γ1 beyond an end of Γ0 may have a share
    (:mod:`~hypergap_dolfinx.contact_geometry.rays`): not where laws need the pressures themselves,
    as friction and compliance do."""

    @cached_property
    def _walls(self) -> list[_Wall]:
        """Ends of both sides whose displacements along their surfaces are prescribed."""
        side0, side1 = self.sides
        surfaces = side0.reference, side1.reference
        (starts0, ends0), (starts1, ends1) = (
            (np.setdiff1d(*s.facets.T), np.setdiff1d(*s.facets.T[::-1])) for s in surfaces
        )
        found = []
        # Γ0 runs against Γ1
        for mine, others in ((starts1, ends0), (ends1, starts0)):
            for a in mine.tolist() if len(others) else ():
                own = _end_at(surfaces[1], a)
                edge = np.abs(np.diff(surfaces[1].x[surfaces[1].facets[own[0]]], axis=0)[0])
                axis = int(edge.argmax())
                if not self._held_at(1, a)[axis]:
                    continue
                apart = np.abs(surfaces[0].x[others] - surfaces[1].x[a])
                can = self._held_at(0, others)[:, axis] & (apart[:, axis] <= END * edge[axis])
                if can.any():
                    b = int(others[np.where(can, apart.sum(axis=1), np.inf).argmin()])
                    ends = *own, *_end_at(surfaces[0], b)
                    found.append(_Wall((a, b), ends, axis, float(edge[axis])))
        return found

    def _held_at(self, i: int, vertex) -> npt.NDArray[np.bool_]:
        """Mask of prescribed components at vertices of a side, ``(..., 2)``."""
        side = self.sides[i]
        return self.held[i][np.searchsorted(side.dofs, side.vertex_dofs[vertex])]

    @cached_property
    def _in_c(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Both sides for C, without their positions."""
        below, above = self.sides
        return rays.side_of(below, 0), rays.side_of(above, len(below.dofs))

    @override
    def _find(self, u: Displacements) -> _Fans:
        surfaces = displaced(self.sides, u)
        walls = [wall.ends for wall in self._walls if wall.is_between(surfaces)]
        before = self._last.found if self._last else None
        found = rays.cast(self._in_c, surfaces, before, walls, shares=self.shares)
        if not len(found.cells):
            mesh_strip(*surfaces)  # raises an error that says why
            raise NotFacingError("Γ0 and Γ1 don't face each other: no normal of Γ1 meets Γ0.")
        return _Fans(u, found)

    @override
    def gap(self, u: Displacements) -> tuple[npt.NDArray, npt.NDArray, Sparse]:
        gaps = self._at(u).gaps
        return gaps.g, gaps.m, gaps.C

    @override
    def curvature(self, u: Displacements, p: npt.NDArray[np.float64]) -> Sparse:
        return fans.gap_curvature(self._at(u).found, p)

    @override
    def slip(self, u: Displacements, target: npt.NDArray[np.intp]) -> Sparse:
        return fans.find_slips(self._at(u).found)

    @override
    def slip_slopes(
        self,
        u: Displacements,
        since: Displacements,
        target: npt.NDArray[np.intp],
        on: npt.NDArray[np.bool_],
    ) -> Sparse:
        moved = np.concatenate([a - b for a, b in zip(u, since, strict=True)])
        return fans.find_slips(self._at(u).found, moved)

    @override
    def slip_curvature(
        self, u: Displacements, q: npt.NDArray[np.float64], target: npt.NDArray[np.intp]
    ) -> Sparse:
        return fans.slip_curvature(self._at(u).found, q[0])

    @override
    def smoothed(self, u: Displacements, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        # (SᵀDSp) / (SᵀD1): S the cells' weights, D their areas
        state = self._at(u)
        gaps, vertices = state.gaps, state.found.cells["vertices"]
        halves = gaps.areas * state.found.pressures(p)[vertices].mean(axis=1) / 2
        total = np.bincount(vertices.ravel(), np.repeat(halves, 2), self.num_multipliers)
        return np.divide(total, gaps.sizes, out=np.zeros_like(total), where=gaps.sizes > 0)

    @override
    def cells(self, u: Displacements, p: npt.NDArray[np.float64]) -> OpenCells:
        state = self._at(u)
        gaps, cells, p = state.gaps, state.found.cells, state.found.pressures(p)
        rank = np.empty(len(cells), dtype=np.int32)
        for i, moving in enumerate(self.sides):
            on = cells["side"] == i
            rank[on] = moving.reference.owner[cells["base"][on]]
        zero = np.zeros_like(gaps.areas)
        return OpenCells(
            x=gaps.x,
            rank=rank,
            gap=np.divide(gaps.volumes, gaps.areas, out=zero, where=gaps.areas > 0),
            pressure=p[cells["vertices"]].mean(axis=1),
        )


def _end_at(surface: Surface, vertex: int) -> tuple[int, int]:
    """The edge of a surface at an end, and the number of its end there."""
    f, k = np.argwhere(surface.facets == vertex)[0].tolist()
    return f, k
