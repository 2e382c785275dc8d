# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The protocol of contact's geometry, which the plane and space implement."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from itertools import permutations
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_geometry.blending import Blended
from hypergap_dolfinx.contact_geometry.opened import OpenColumns
from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.errors import NotFacingError, SolveError
from hypergap_dolfinx.surface.moving import Displacements, Sides, Sparse, displaced

stuck = 1  # as in c/vectors.h


def check(status: int, most: int = 0):
    """Raise if the C couldn't find gaps or their derivatives; the same on every rank.

    Args:
        status: What its function returned.
        most: Number of sheets for which it has room.

    Raises:
        SolveError: There are more, so that gaps would be wrong. (An :class:`InterfaceError` would
            count as surfaces that don't face each other.)
        MemoryError: There is no memory.
    """
    if status == stuck:
        raise SolveError(
            f"a normal of Γ1 meets more than {most} sheets of Γ0 one behind the other, or facets "
            "are folded: leave out of Γ0 what can't touch."
        )
    if status:
        raise MemoryError("no memory for gaps and their derivatives")


@dataclass
class Segments(ABC):
    """Contact segments: Σ between two surfaces, with weights for each vertex of Γ1.

    A vertex a of Γ1 has the weighted gap g_a, the volume of its part of Σ, and the area m_a. Σ is
    found anew at each displacement. g is a continuous function of it, and derivatives include
    everything that moves. Results are the same on every rank.

    Arrays of displacements are those at the dofs of Γ0 and of Γ1. In derivatives by u Γ1's dofs
    follow those of Γ0, with all components of a dof together. Slips are counted from displacements
    u_since. They have n − 1 components: first the first one of all vertices, then the second one.

    The only state is a cache of the results at the last two displacements: steps come back.
    """

    sides: Sides
    gives: bool = field(default=False, kw_only=True)
    """True if pressures depend on their rows' areas, as those of springs: rows of what is hardly
    covered have nothing of their neighbours', which would count twice."""
    num_multipliers: int = field(init=False)
    """Number of vertices of Γ1, in reach of Γ0 or not."""
    num_dofs: int = field(init=False)
    """Number of dofs of both sides."""
    _last: list[tuple[Displacements, Blended]] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self):
        """Count."""
        self.num_multipliers = len(self.sides[1].reference.x)
        self.num_dofs = sum(len(side.dofs) for side in self.sides)

    @cached_property
    def beside(self) -> npt.NDArray[np.int64]:
        """Vertices of Γ1 and others of their facets, whose rows theirs share, ``(2, num_pairs)``.

        Those across a quadrilateral count: a corner of Γ0 that comes from there covers as little of
        the vertices along the edges as of the vertex itself.
        """
        if self.gives:
            return np.empty((2, 0), dtype=np.int64)
        facets = self.sides[1].reference.facets
        both = list(permutations(range(facets.shape[1]), 2))
        pairs = np.unique(facets[:, both].reshape(-1, 2), axis=0)
        return np.ascontiguousarray(pairs.T, dtype=np.int64)

    @classmethod
    def between(cls, sides: Sides, u: Displacements, *args, **options) -> Self:
        """Segments that are found where the bodies are.

        Args:
            sides: Γ0 and Γ1.
            u: Their displacements.
            *args: Further attributes of the class.
            **options: Likewise.

        Raises:
            NotFacingError: Nothing of Γ1 lies opposite Γ0.
            InterfaceError: There are no segments, for another reason.
        """
        segments = cls(sides, *args, **options)
        segments._at(u)
        return segments

    def _at(self, u: Displacements) -> Blended:
        """Gaps where the bodies are, known ones if they were there before."""
        for (a, b), known in self._last:
            if (a is u[0] or np.array_equal(a, u[0])) and (b is u[1] or np.array_equal(b, u[1])):
                return known
        u0, u1 = (part.copy() if part.flags.writeable else part for part in u)
        u = u0, u1
        found = Blended(self._find(u), self.beside, self.num_multipliers)
        self._last = [(u, found), *self._last[:1]]
        return found

    @abstractmethod
    def _find(self, u: Displacements) -> Any:
        """Find what has gaps of halves, :attr:`Blended.rays`.

        Raises:
            NotFacingError: There is nothing.
        """

    def _faces_nothing(self, u: Displacements) -> NotFacingError:
        """The error to raise if no normal of Γ1 meets Γ0."""
        below, above = displaced(self.sides, u)
        return NotFacingError(
            f"nothing of Γ1 (around {spot(above.x)}) lies opposite Γ0 (around {spot(below.x)}) "
            "along its normals; check the tags: is one of them the wrong side of its body?"
        )

    def gap(self, u: Displacements) -> tuple[npt.NDArray, npt.NDArray, Sparse]:
        """The weighted gap.

        Returns:
            g and m, ``(num_multipliers,)``, and C = ∂g/∂u,
            ``(num_multipliers, n num_dofs)``.
        """
        gaps = self._at(u)
        return gaps.g, gaps.m, gaps.C

    def linear_gap(self, u: Displacements) -> tuple[npt.NDArray, npt.NDArray, Sparse]:
        """The weighted gap for small sliding, as :meth:`gap`.

        C is its derivative if opposite points stay opposite.
        """
        gaps = self._at(u)
        return gaps.g, gaps.m, gaps.parting

    def curvature(self, u: Displacements, p: npt.NDArray[np.float64]) -> Sparse:
        """H = Σ_a p_a ∂²g_a/∂u², of the size of u, from p, ``(num_multipliers,)``."""
        return self._at(u).curvature(p)

    def slip(self, u: Displacements, target: npt.NDArray[np.intp]) -> Sparse:
        """T with the weighted slips of Γ1 on Γ0, s = T (u − u_since).

        In the plane along the chords of Γ1's edges, against their direction, in space in two
        directions at each vertex.

        Args:
            u: Displacements.
            target: Vertex whose directions each one takes, ``(num_multipliers,)``: slips of several
                are added where they share a traction.

        Returns:
            T with n − 1 rows for each vertex of Γ1.
        """
        return self._at(u).slips(target)

    def slip_slopes(
        self,
        u: Displacements,
        since: Displacements,
        target: npt.NDArray[np.intp],
        on: npt.NDArray[np.bool_],
    ) -> Sparse:
        """∂s/∂u, of the size of T.

        Args:
            u: Displacements.
            since: Displacements from which slip is counted.
            target: As for :meth:`slip`.
            on: Mask of the vertices whose rows are needed, ``(num_multipliers,)``; others may be
                there.
        """
        moved = np.concatenate([a - b for a, b in zip(u, since, strict=True)])
        return self._at(u).slip_slopes(target, moved, on)

    def slip_curvature(
        self, u: Displacements, q: npt.NDArray[np.float64], target: npt.NDArray[np.intp]
    ) -> Sparse:
        """∂(Tᵀq)/∂u, of the size of u; it isn't symmetric.

        Args:
            u: Displacements.
            q: Tractions, ``(n - 1, num_multipliers)``.
            target: As for :meth:`slip`.
        """
        return self._at(u).slip_curvature(target, q)

    def pressures(self, u: Displacements, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Pressures of vertices, which share those of their neighbours' rows, from multipliers."""
        return self._at(u).pressures(p)

    def bears(self, u: Displacements) -> tuple[npt.NDArray[np.float64], Sparse]:
        """Areas of vertices; their normal forces per unit of multipliers, ``(num, num)``."""
        gaps = self._at(u)
        return gaps.sizes, gaps.bears()

    def force_slopes(self, u: Displacements, p: npt.NDArray[np.float64]) -> Sparse:
        """Derivatives of vertices' normal forces by u as shares in their neighbours' rows change.

        Areas are kept.

        Args:
            u: Displacements.
            p: Pressures, ``(num_multipliers,)``.
        """
        return self._at(u).force_slopes(p)

    @abstractmethod
    def reaches(
        self, u: Displacements, least: npt.NDArray[np.float64], p: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Largest distance and largest overlap of the sides within each vertex's part of Γ1.

        Third, what of its weighted gap is in front of Γ1, up to edges that lean, under pressure.

        Args:
            u: Displacements.
            least: Lengths from which these are looked for, ``(num_multipliers,)``.
            p: Pressures of vertices, likewise.

        Returns:
            All three, ``(3, num_multipliers)``; 0 where they are shorter, or not known.
        """

    def smoothed(self, u: Displacements, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Pressures for plots: the force of p, with less scatter between nodes.

        Half of what each facet has of a vertex keeps the vertex' pressure, the other half has the
        mean of the facet.

        Args:
            u: Displacements.
            p: Those of vertices, ``(num_multipliers,)``.
        """
        gaps = self._at(u)
        if self.sides[1].reference.num_parts > 1:  # scatters less than means are off
            return p
        p = p[gaps.facets]
        size = gaps.areas.sum(axis=1, keepdims=True)
        force = (gaps.areas * p).sum(axis=1, keepdims=True)
        mean = np.divide(force, size, out=np.zeros_like(size), where=size > 0)
        forces = 0.5 * gaps.areas * (mean + p)
        total = np.bincount(gaps.facets.ravel(), forces.ravel(), self.num_multipliers)
        return np.divide(total, gaps.sizes, out=np.zeros_like(total), where=gaps.sizes > 0)

    def columns(self, u: Displacements) -> OpenColumns:
        """Σ at some displacements, for plots."""
        return self._at(u).rays.columns
