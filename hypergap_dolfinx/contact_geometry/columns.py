# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Second derivatives of what columns hold by the dofs of both their facets, in C.

They are matrices of 21 × 21 at each point: with NumPy these would go through memory five times. So
are sums of what groups of points have.
"""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_geometry.heights import Rays
from hypergap_dolfinx.core.compiled import call, doubles, ints
from hypergap_dolfinx.surface.moving import Sparse


class Blocks:
    """Matrices of pairs of facets, by both facets' dofs, to which points add theirs."""

    def __init__(self, num: int, num_dofs: int):
        """Zero.

        Args:
            num: Number of pairs.
            num_dofs: Of both facets.
        """
        self._below: npt.NDArray[np.float64] = np.zeros((num, num_dofs, num_dofs, 3, 3))

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """``(num, num_dofs, num_dofs, 3, 3)``."""
        num, num_dofs = self._below.shape[:2]
        result = self._below.copy()
        call("complete", num, num_dofs, result)
        return result

    def add_curvatures(self, pair, factor, rays: Rays):
        """Add second derivatives of f (:mod:`~hypergap_dolfinx.contact_geometry.heights`).

        Args:
            pair: Number of each point's pair, ``(num_points,)``.
            factor: What they are multiplied with, ``(num_points,)``.
            rays: The points.
        """
        call("column_curvatures", rays.pointer, ints(pair), doubles(factor), self._below)

    def add_products(self, pair, a, b):
        """Add a bᵀ + b aᵀ.

        Args:
            pair: Number of each product's pair, ``(num_points,)``.
            a: ``(num_points, num_dofs, 3)``.
            b: Likewise.
        """
        given = len(a), a.shape[1], ints(pair), doubles(a), doubles(b)
        call("add_products", *given, self._below)


def merged(rows, columns, values: npt.NDArray[np.float64], size: tuple[int, int]) -> Sparse:
    """A sparse matrix of blocks, of which equal ones are added up.

    Args:
        rows: Of groups of blocks, ``(num, a)``.
        columns: Likewise, ``(num, b)``.
        values: All blocks of each group, ``(num, a, b, r, c)``; is overwritten.
        size: Of the matrix, in blocks.
    """
    num, a, b, r, c = values.shape
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
