# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact segments in the plane: Γ0 as seen from the edges of Γ1."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, override

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_geometry import rays
from hypergap_dolfinx.contact_geometry.protocol import Segments
from hypergap_dolfinx.gap_mesh.tolerances import END
from hypergap_dolfinx.surface.moving import Displacements, Sparse, displaced
from hypergap_dolfinx.surface.trace import Surface


@dataclass(frozen=True)
class _Wall:
    """Ends of Γ0 and Γ1 that slide along one wall, as those of symmetry are."""

    vertices: tuple[int, int]
    """Vertices of Γ1 and of Γ0."""
    end: tuple[int, int]
    """Edge and end of Γ0."""
    axis: int
    """Coordinate in which both are prescribed."""
    size: float
    """Size of Γ1's facet there."""

    def is_between(self, surfaces: tuple[Surface, Surface]) -> bool:
        """True if a single wall lies between the surfaces."""
        a, b = self.vertices
        apart = surfaces[0].x[b, self.axis] - surfaces[1].x[a, self.axis]
        return abs(apart) <= END * self.size


@dataclass
class PlaneSegments(Segments):
    """Contact segments in the plane."""

    held: Sequence[npt.NDArray[np.bool_]] = ()
    """Masks of the prescribed dofs of both sides, ``(num_dofs_i, 2)`` each; none without it."""
    itself: bool = field(default=False, kw_only=True)
    """True if both sides are one surface, which meets itself."""
    _slides: bool = field(default=False, init=False)  # slips were asked for: found with gaps

    @cached_property
    def _in_c(self) -> Any:
        """Both sides for C, without their positions."""
        return rays.sigma_of(self.sides, self.itself)

    @cached_property
    def _walls(self) -> list[_Wall]:
        """Ends of both sides whose displacements along their surfaces are prescribed."""
        side0, side1 = self.sides
        surfaces = side0.reference, side1.reference
        (starts0, ends0), (starts1, ends1) = (
            (np.setdiff1d(*s.facets.T), np.setdiff1d(*s.facets.T[::-1])) for s in surfaces
        )
        found: list[_Wall] = []
        # Γ0 runs against Γ1
        for mine, others in ((starts1, ends0), (ends1, starts0)):
            for a in mine.tolist() if len(others) and len(self.held) else ():
                own, _ = _end_at(surfaces[1], a)
                edge = np.abs(np.diff(surfaces[1].x[surfaces[1].facets[own]], axis=0)[0])
                axis = int(edge.argmax())
                if not self._held_at(1, a)[axis]:
                    continue
                apart = np.abs(surfaces[0].x[others] - surfaces[1].x[a])
                can = self._held_at(0, others)[:, axis] & (apart[:, axis] <= END * edge[axis])
                if can.any():
                    b = int(others[np.where(can, apart.sum(axis=1), np.inf).argmin()])
                    found.append(_Wall((a, b), _end_at(surfaces[0], b), axis, float(edge[axis])))
        return found

    def _held_at(self, i: int, vertex) -> npt.NDArray[np.bool_]:
        """Mask of prescribed components at vertices of a side, ``(..., 2)``."""
        side = self.sides[i]
        return self.held[i][np.searchsorted(side.dofs, side.vertex_dofs[vertex])]

    @override
    def _find(self, u: Displacements) -> rays.PlaneRays:
        surfaces = displaced(self.sides, u)
        walls = [] if self.itself else self._walls
        goes_on = [wall.end for wall in walls if wall.is_between(surfaces)]
        found = rays.cast(self._in_c, surfaces, goes_on, self._slides)
        if not len(found.points):
            raise self._faces_nothing(u)
        return found

    @override
    def reaches(self, u: Displacements, least, p) -> npt.NDArray[np.float64]:
        return self._at(u).rays.reaches(p, least)

    @override
    def slip(self, u: Displacements, target) -> Sparse:
        self._slides = True
        return super().slip(u, target)


def _end_at(surface: Surface, vertex: int) -> tuple[int, int]:
    """The edge of a surface at an end, and the number of its end there."""
    f, k = np.argwhere(surface.facets == vertex)[0].tolist()
    return f, k
