# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""The gap along the normal of Γ1's facet, times area, and its derivatives.

From a point :math:`\mathbf x_1(X)` of Γ1 a ray along its facet's normal in the middle,
:math:`\mathbf M`, meets Γ0 in :math:`\mathbf x_0(\xi)`, where Γ0's normal is :math:`\mathbf N_0`.
Then

.. math:: f = \frac{\mathbf N_0\cdot(\mathbf x_0 - \mathbf x_1)\;\mathbf N_1\cdot\mathbf M}
                   {\mathbf N_0\cdot\mathbf M}

is the distance along the ray times the area of Γ1 as seen along it, for each
:math:`dX`. There :math:`\partial f/\partial\xi = 0`: first derivatives don't need to know how the
ray's end moves along Γ0, and second ones need it to first order.
All this is a function of seven vectors, q: :math:`\mathbf r = \mathbf x_0 - \mathbf x_1`, two
tangents of Γ0 and of Γ1 each, and those of Γ1 in the facet's middle. What there is at each of the
many rays is found in C (``c/heights.c``).
"""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_geometry.opposite import Frames, reference_middle, sides_of
from hypergap_dolfinx.contact_geometry.tolerances import LAST, NEWTON_HEIGHTS
from hypergap_dolfinx.core.compiled import call, doubles, ints, struct
from hypergap_dolfinx.surface.trace import Surface


class At(IntEnum):
    """Vectors of q."""

    R, Z1, Z2, T1, T2, C1, C2 = range(7)


@dataclass(frozen=True)
class Rays:
    """Points of Γ1 and what is opposite of them."""

    facets: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]
    """Of Γ0 and of Γ1, ``(num,)`` each."""
    xi: npt.NDArray[np.float64]
    """Where they meet Γ0, ``(num, 2)``."""
    q: npt.NDArray[np.float64]
    """The seven vectors, ``(num, 7, 3)``."""
    bends: npt.NDArray[np.float64] | None
    """Second derivatives of Γ0 by ξ, ``(num, 3, 3)``: by ξ₁ twice, ξ₁ and ξ₂, ξ₂ twice. None for
    straight triangles."""
    functions: npt.NDArray[np.float64]
    """Those of Γ0's dofs, then of Γ1's, and their slopes, ``(num, 3, num_dofs0 + num_dofs1)``."""
    middle: npt.NDArray[np.float64]
    """Slopes of Γ1's in the facet's middle, ``(2, num_dofs1)``."""

    @cached_property
    def pointer(self) -> Any:
        """Struct ``Rays`` of ``c/space.h``."""
        num1 = self.middle.shape[1]
        return struct(
            "Rays",
            num=len(self.q),
            num_dofs=[self.functions.shape[2] - num1, num1],
            xi=self.xi,
            q=self.q,
            bends=self.bends,
            functions=self.functions,
            middle=doubles(self.middle),
        )

    @cached_property
    def heights(self) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """f, the areas as seen along the rays, and ∂f/∂q; ``(num,)`` twice, ``(num, 7, 3)``."""
        (f, areas), by_q = np.empty((2, len(self.q))), np.empty_like(self.q)
        call("column_heights", self.pointer, f, areas, by_q)
        return f, areas, by_q

    def add_by_dofs(self, block, factor, by_q, blocks):
        """Add derivatives by the dofs of both facets to blocks.

        Args:
            block: The number of each ray's, ``(num,)``.
            factor: What they are multiplied with, ``(num,)``.
            by_q: Derivatives by q, ``(num, 7, 3)``.
            blocks: ``(num_blocks, num_dofs, 3)``.
        """
        given = ints(block), doubles(factor), doubles(by_q)
        call("sum_by_dofs", self.pointer, *given, blocks)

    def edges(self, normal) -> tuple[npt.NDArray, npt.NDArray]:
        """How edges move on which rays are that end on those of Γ0.

        Args:
            normal: Across the edge, in Γ1's reference facet, ``(num, 2)``.

        Returns:
            Derivatives of motions along the normal by q, ``(num, 7, 3)``, and slopes of f along it
            that Γ0 has beyond the edge less those before it if it is one plane, ``(num,)``.
        """
        motion, slopes = np.empty_like(self.q), np.empty(len(self.q))
        call("column_edges", self.pointer, doubles(normal), motion, slopes)
        return motion, slopes

    def some(self, some) -> "Rays":
        """A part of them: numbers, or which."""
        f0, f1 = self.facets
        xi, q, functions = (part[some] for part in (self.xi, self.q, self.functions))
        bends = None if self.bends is None else self.bends[some]
        return Rays((f0[some], f1[some]), xi, q, bends, functions, self.middle)


def cast(surfaces: tuple[Surface, Surface], frames: Frames, facets, X) -> Rays:
    """Rays from points of Γ1 to the facets of Γ0 that they meet.

    Args:
        surfaces: Γ0 and Γ1 where they are.
        frames: Of Γ1.
        facets: Of both, ``(num,)`` each.
        X: Reference coordinates on Γ1, ``(num, 2)``.
    """
    num, (below, above) = len(X), surfaces
    num_dofs = below.element.dim + above.element.dim
    straight = below.geometry.dim == 3
    rays = Rays(
        facets,
        np.empty((num, 2)),
        np.empty((num, len(At), 3)),
        None if straight else np.empty((num, 3, 3)),
        np.empty((num, 3, num_dofs)),
        above.element.tabulate(1, reference_middle(above)[None])[1:, 0, :, 0],
    )
    given = sides_of(surfaces), doubles(frames.tangents), 1 if straight else NEWTON_HEIGHTS, LAST
    call("cast_columns", *given, *map(ints, facets), doubles(X), rays.pointer)
    return rays
