# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Columns: rays from Γ1 to Γ0, the gaps and slips along them, and their derivatives.

From a point :math:`\mathbf x_1(X)` of Γ1 a ray along its facet's normal in the middle,
:math:`\mathbf M`, meets Γ0 in :math:`\mathbf x_0(\xi)`, where Γ0's normal is :math:`\mathbf N_0`.
Then

.. math:: f = \frac{\mathbf N_0\cdot(\mathbf x_0 - \mathbf x_1)\;\mathbf N_1\cdot\mathbf M}
                   {\mathbf N_0\cdot\mathbf M}

is the distance along the ray times the area of Γ1 as seen along it, for each
:math:`dX`. There :math:`\partial f/\partial\xi = 0`: first derivatives don't need to know how the
ray's end moves along Γ0, and second ones need it to first order.
All this is a function of seven vectors, q: :math:`\mathbf r = \mathbf x_0 - \mathbf x_1`, two
tangents of Γ0 and of Γ1 each, and those of Γ1 in the facet's middle.

Two opposite points that move have the slip

.. math:: \kappa\,\mathbf e_k\cdot\mathbf P\mathbf D, \qquad
   \mathbf D = \Delta\mathbf u_1(X) - \Delta\mathbf u_0(\xi), \qquad
   \kappa = \mathbf N_1\cdot\hat{\mathbf M},

with P across the facet's normal :math:`\hat{\mathbf M}`, and two directions :math:`\mathbf e_k` for
each vertex of Γ1. As :math:`\mathbf x_0 - \mathbf x_1` is along the normal, it is zero if
:math:`\Delta\mathbf u` is the position: with :math:`\Delta\mathbf u = \mathbf x -
\mathbf x_n` a rotation of closed bodies, however large, is no slip.

All that is computed at the many rays, and sums over groups of them, is in C (``c/heights.c``,
``c/columns.c``, ``c/slips.c``): second derivatives are matrices of 21 × 21 at each point, which
NumPy would move through memory five times.
"""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_geometry.opposite import Frames, cross
from hypergap_dolfinx.contact_geometry.tolerances import LAST, NEWTON
from hypergap_dolfinx.core.compiled import call, doubles, ints, struct
from hypergap_dolfinx.surface.moving import Sparse
from hypergap_dolfinx.surface.trace import lengths


class At(IntEnum):
    """Vectors of q."""

    R, Z1, Z2, T1, T2, C1, C2 = range(7)


@dataclass(frozen=True)
class Rays:
    """Points of Γ1 and their opposite points on Γ0."""

    facets: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]
    """Facets of Γ0 and of Γ1, ``(num,)`` each."""
    xi: npt.NDArray[np.float64]
    """Reference coordinates on Γ0, ``(num, 2)``."""
    q: npt.NDArray[np.float64]
    """The seven vectors, ``(num, 7, 3)``."""
    bends: npt.NDArray[np.float64] | None
    """Second derivatives of Γ0 by ξ, ``(num, 3, 3)``: by ξ₁ twice, ξ₁ and ξ₂, ξ₂ twice. None for
    straight triangles."""
    functions: npt.NDArray[np.float64]
    """Basis functions of Γ0's dofs, then of Γ1's, and their slopes,
    ``(num, 3, num_dofs0 + num_dofs1)``."""
    middle: npt.NDArray[np.float64]
    """Slopes of Γ1's functions in the facet's middle, ``(2, num_dofs1)``."""

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
            block: Number of each ray's block, ``(num,)``.
            factor: Factor of each ray, ``(num,)``.
            by_q: Derivatives by q, ``(num, 7, 3)``.
            blocks: ``(num_blocks, num_dofs, 3)``.
        """
        given = ints(block), doubles(factor), doubles(by_q)
        call("sum_by_dofs", self.pointer, *given, blocks)

    def add_curvatures(self, block, factor, blocks):
        """Add second derivatives of f, each transposed pair of blocks once.

        Args:
            block: Number of each ray's block, ``(num,)``.
            factor: Factor of each ray, ``(num,)``.
            blocks: ``(num_blocks, num_dofs, num_dofs, 3, 3)``.
        """
        call("column_curvatures", self.pointer, ints(block), doubles(factor), blocks)

    def slips(self, block, e, moves=None) -> npt.NDArray[np.float64]:
        """Slips by the motions of q, as vectors that are multiplied with these.

        Args:
            block: Number of each ray's pair of facets, ``(num,)``.
            e: A direction, ``(3,)``.
            moves: Motions of the pairs' dofs, ``(num_pairs, num_dofs, 3)``. If given, the result is
                the derivative by q of slips whose motions change with the positions of the dofs.

        Returns:
            ``(num, 7, 3)``.
        """
        result = np.empty_like(self.q)
        given = ints(block), doubles(e), None if moves is None else doubles(moves)
        call("column_slips", self.pointer, *given, result)
        return result

    def add_slip_curvatures(self, block, traction, blocks):
        """Add derivatives by the dofs of the forces of tractions at the points.

        Args:
            block: Number of each ray's block, ``(num,)``.
            traction: On Γ1, before it is projected, ``(num, 3)``.
            blocks: ``(num_blocks, num_dofs, num_dofs, 3, 3)``.
        """
        call("slip_curvatures", self.pointer, ints(block), doubles(traction), blocks)

    def some(self, some) -> "Rays":
        """Subset, by numbers or a mask."""
        f0, f1 = self.facets
        xi, q, functions = (part[some] for part in (self.xi, self.q, self.functions))
        bends = None if self.bends is None else self.bends[some]
        return Rays((f0[some], f1[some]), xi, q, bends, functions, self.middle)


@dataclass(frozen=True)
class EdgeRays:
    """Rays that end on edges of Γ0's facets, and how these move on Γ1."""

    rays: Rays
    piece: npt.NDArray[np.intp]
    """Piece of each ray, ``(num,)``."""
    weights: npt.NDArray[np.float64]
    normal: npt.NDArray[np.float64]
    """Out of the piece, of the length of the edge, in Γ1's reference facet, ``(num, 2)``."""

    def add_kinks(self, block, factor, blocks):
        """Add what moving edges contribute to ∂²∫f/∂u²: jumps of f's derivatives.

        Args:
            block: As for :meth:`Rays.add_curvatures`.
            factor: Likewise.
            blocks: Likewise.
        """
        # Motions along normals, and slopes of f along them that Γ0 has beyond the edge less those
        # before it if it is one plane
        motion, slope = np.empty_like(self.rays.q), np.empty(len(self.rays.q))
        call("column_edges", self.rays.pointer, doubles(self.normal), motion, slope)
        half = (-0.5 * slope * factor)[:, None, None] * motion
        a, b = by_dofs = np.zeros((2, len(half), blocks.shape[1], 3))
        each = ints(np.arange(len(half))), np.ones(len(half))
        # a ⊗ b + b ⊗ a
        for by_q, by_dof in zip((half, motion), by_dofs, strict=True):
            call("sum_by_dofs", self.rays.pointer, *each, by_q, by_dof)
        call("add_products", len(a), a.shape[1], ints(block), a, b, blocks)


def cast(frames: Frames, facets, X) -> Rays:
    """Rays from points of Γ1 to the facets of Γ0 that they meet.

    Args:
        frames: Γ0 and Γ1 where they are.
        facets: Facets of both, ``(num,)`` each.
        X: Reference coordinates on Γ1, ``(num, 2)``.
    """
    num, (below, above) = len(X), frames.surfaces
    num_dofs = below.element.dim + above.element.dim
    straight = below.geometry.dim == 3
    rays = Rays(
        facets,
        np.empty((num, 2)),
        np.empty((num, len(At), 3)),
        None if straight else np.empty((num, 3, 3)),
        np.empty((num, 3, num_dofs)),
        frames.slopes,
    )
    sides, pointer = frames.in_c, rays.pointer
    given = doubles(frames.tangents), 1 if straight else NEWTON, LAST, *map(ints, facets)
    call("cast_columns", sides, *given, doubles(X), pointer)
    return rays


def directions(frames: Frames) -> npt.NDArray[np.float64]:
    """Two directions at each vertex of Γ1, across the mean normal, that turn with the surface.

    Returns:
        Unit vectors, ``(num_vertices, 2, 3)``.
    """
    surface = frames.surfaces[1]
    polygons = surface.polygons
    normal, along = np.zeros((2, len(surface.x), 3))
    after = np.roll(polygons, -1, axis=1)
    for k in range(polygons.shape[1]):
        np.add.at(normal, polygons[:, k], frames.normal)
        # Of the facets around a vertex the last one's edge
        along[polygons[:, k]] = surface.x[after[:, k]] - surface.x[polygons[:, k]]
    normal /= np.maximum(lengths(normal), 1e-300)[:, None]
    first = along - np.einsum("vi,vi->v", along, normal)[:, None] * normal
    first /= np.maximum(lengths(first), 1e-300)[:, None]
    return np.stack((first, cross(normal, first)), axis=1)


def merged(
    rows,
    columns,
    values: npt.NDArray[np.float64],
    size: tuple[int, int],
    *,
    symmetric: bool = False,
) -> Sparse:
    """The sum of blocks at the same place, as a sparse matrix.

    Args:
        rows: Rows of groups of blocks, ``(num, a)``.
        columns: Columns of groups of blocks, ``(num, b)``.
        values: Blocks of each group, ``(num, a, b, r, c)``; overwritten.
        size: Size of the matrix, in blocks.
        symmetric: True if each transposed pair of blocks of a group is given only once.
    """
    num, a, b, r, c = values.shape
    if symmetric:
        call("complete", num, a, values)
    first = np.empty(num * a * b, dtype=np.int32)
    places = num, a, ints(rows), b, ints(columns), r * c
    found = call("merge_blocks", *size, *places, values, first)
    if found < 0:
        raise MemoryError("no memory for the derivatives of gaps")
    first = first[:found]
    group, at = np.divmod(first, a * b)
    i = r * rows[group, at // b, None, None] + np.arange(r)[:, None]
    j = c * columns[group, at % b, None, None] + np.arange(c)
    i, j = np.broadcast_arrays(i, j)
    return Sparse(i.ravel(), j.ravel(), values.reshape(-1, r * c)[first].ravel())
