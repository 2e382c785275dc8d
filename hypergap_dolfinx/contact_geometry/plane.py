# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Contact's Σ in the plane: the weighted gap of fans on the dofs of both sides."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_geometry import fans, rays
from hypergap_dolfinx.contact_geometry.opened import OpenCells
from hypergap_dolfinx.errors import NotFacingError
from hypergap_dolfinx.gap_mesh.strip import mesh_strip
from hypergap_dolfinx.surface.moving import Displacements, Sides, Sparse, displaced
from hypergap_dolfinx.surface.trace import Surface


@dataclass
class _State:
    """Σ at displacements."""

    u: Displacements
    found: rays.Fans
    gaps: fans.Gaps | None = None
    """Once they are asked for."""


@dataclass(frozen=True)
class _Wall:
    """Ends of Γ0 and Γ1 that slide along one wall, as those of symmetry are."""

    vertices: tuple[int, int]
    """Of Γ1 and of Γ0."""
    ends: tuple[int, int, int, int]
    """Edge and end of Γ1, edge and end of Γ0."""
    axis: int
    """Coordinate in which both are held."""
    size: float
    """Of Γ1's facet there."""

    def is_between(self, surfaces: tuple[Surface, Surface]) -> bool:
        """Whether it is one wall where the surfaces are."""
        a, b = self.vertices
        apart = surfaces[0].x[b, self.axis] - surfaces[1].x[a, self.axis]
        return abs(apart) <= rays.END * self.size


@dataclass
class PlaneOpening:
    """Σ between two surfaces in the plane, with weights for each vertex of Γ1.

    It is found anew wherever the bodies are: g is continuous, and its derivatives are those of
    everything that moves. The same on every rank.
    """

    sides: Sides
    held: Sequence[npt.NDArray[np.bool_]]
    """Which dofs of both sides are prescribed, ``(num_dofs_i, 2)`` each."""
    shares: bool = False
    """Whether vertices of Γ1 beyond an end of Γ0 have a share."""
    _last: _State | None = field(default=None, repr=False)

    @classmethod
    def between(
        cls,
        sides: Sides,
        u: Displacements,
        held: Sequence[npt.NDArray[np.bool_]],
        *,
        shares: bool = False,
    ) -> "PlaneOpening":
        """Σ where the bodies are.

        Args:
            sides: Γ0 and Γ1.
            u: Their displacements.
            held: Which of them are prescribed.
            shares: Whether vertices of Γ1 beyond an end of Γ0 have a share: they mustn't where
                laws ask for the pressures themselves, as friction and what gives way do.

        Raises:
            InterfaceError: They don't face each other.
        """
        opening = cls(sides, held, shares)
        opening._at(u)
        return opening

    @cached_property
    def _walls(self) -> list[_Wall]:
        """Where ends of both sides are held in the coordinate along which their surfaces go."""
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
                can = self._held_at(0, others)[:, axis] & (apart[:, axis] <= rays.END * edge[axis])
                if can.any():
                    b = int(others[np.where(can, apart.sum(axis=1), np.inf).argmin()])
                    ends = *own, *_end_at(surfaces[0], b)
                    found.append(_Wall((a, b), ends, axis, float(edge[axis])))
        return found

    def _held_at(self, i: int, vertex) -> npt.NDArray[np.bool_]:
        """Which components are prescribed at vertices of a side, ``(..., 2)``."""
        side = self.sides[i]
        return self.held[i][np.searchsorted(side.dofs, side.vertex_dofs[vertex])]

    @property
    def num_multipliers(self) -> int:
        """One for each vertex of Γ1, in reach of Γ0 or not."""
        return len(self.sides[1].reference.x)

    @cached_property
    def _in_c(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """What C knows of both sides wherever they are."""
        below, above = self.sides
        return rays.side_of(below, 0), rays.side_of(above, len(below.dofs))

    def _at(self, u: Displacements) -> _State:
        """Σ where the bodies are, the last one if they haven't moved."""
        last = self._last
        if last is None or any(not np.array_equal(*pair) for pair in zip(u, last.u, strict=True)):
            surfaces = displaced(self.sides, u)
            walls = [wall.ends for wall in self._walls if wall.is_between(surfaces)]
            before = last.found if last else None
            found = rays.cast(self._in_c, surfaces, before, walls, shares=self.shares)
            if not len(found.cells):
                mesh_strip(*surfaces)  # says why
                raise NotFacingError("Γ0 and Γ1 don't face each other: no normal of Γ1 meets Γ0.")
            self._last = last = _State((u[0].copy(), u[1].copy()), found)
        return last

    def _gaps(self, u: Displacements) -> fans.Gaps:
        state = self._at(u)
        if state.gaps is None:
            state.gaps = fans.find_gaps(state.found)
        return state.gaps

    def gap(self, u: Displacements) -> tuple[npt.NDArray, npt.NDArray, Sparse]:
        """The weighted gap.

        Args:
            u: Displacements.

        Returns:
            g and m, ``(num_multipliers,)``, and C = ∂g/∂u,
            ``(num_multipliers, 2 (num_dofs0 + num_dofs1))``.
        """
        gaps = self._gaps(u)
        return gaps.g, gaps.m, gaps.C

    def curvature(self, u: Displacements, p: npt.NDArray[np.float64]) -> Sparse:
        """H = Σ_a p_a ∂²g_a/∂u², of the size of u.

        Args:
            u: Displacements.
            p: ``(num_multipliers,)``.
        """
        return fans.gap_curvature(self._at(u).found, p)

    def slip(self, u: Displacements, lender: npt.NDArray[np.intp]) -> Sparse:
        """What the weighted slip of Γ1 on Γ0, along Γ0's edges from start to end, is made of.

        Args:
            u: Displacements.
            lender: Not asked for: all slips are along Γ0.

        Returns:
            T with s = T (u − u_since), of the size of C.
        """
        return fans.find_slips(self._at(u).found)

    def slip_slopes(
        self,
        u: Displacements,
        since: Displacements,
        lender: npt.NDArray[np.intp],
        on: npt.NDArray[np.bool_],
    ) -> Sparse:
        """∂s/∂u, of the size of C.

        Args:
            u: Displacements.
            since: Those from which slip is counted.
            lender: Not asked for.
            on: Not asked for: all rows are there.
        """
        moved = np.concatenate([a - b for a, b in zip(u, since, strict=True)])
        return fans.find_slips(self._at(u).found, moved)

    def slip_curvature(
        self, u: Displacements, q: npt.NDArray[np.float64], lender: npt.NDArray[np.intp]
    ) -> Sparse:
        """Σ_a ∂(q_a T_a)/∂u, of the size of u; it isn't symmetric.

        Args:
            u: Displacements.
            q: ``(1, num_multipliers)``.
            lender: Not asked for.
        """
        return fans.slip_curvature(self._at(u).found, q[0])

    def smoothed(self, u: Displacements, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Pressures for people, (SᵀDSp) / (SᵀD1): S the cells' weights, D their areas.

        They have the force of p, and less of its scatter from node to node.

        Args:
            u: Displacements.
            p: ``(num_multipliers,)``.
        """
        gaps, found = self._gaps(u), self._at(u).found
        vertices = found.cells["vertices"]
        halves = gaps.areas * found.pressures(p)[vertices].mean(axis=1) / 2
        total = np.bincount(vertices.ravel(), np.repeat(halves, 2), self.num_multipliers)
        return np.divide(total, gaps.sizes, out=np.zeros_like(total), where=gaps.sizes > 0)

    def cells(self, u: Displacements, p: npt.NDArray[np.float64]) -> OpenCells:
        """The cells where the bodies are, to look at.

        Args:
            u: Displacements.
            p: Pressures, ``(num_multipliers,)``, or tractions, ``(num_multipliers, 2)``.
        """
        gaps, found = self._gaps(u), self._at(u).found
        cells, p = found.cells, found.pressures(p)
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
    """The edge that a surface has at an end, and which of its ends that is."""
    f, k = np.argwhere(surface.facets == vertex)[0].tolist()
    return f, k
