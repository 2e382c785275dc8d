# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Second derivatives of what columns hold by the dofs of both their facets, in C.

They are matrices of 21 × 21 at each point: with NumPy these would go through memory five times.
"""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.heights import Rays
from hypergap_dolfinx.gap.jit import as_doubles, as_ints, library


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
        i, j = np.tril_indices(self._below.shape[1], -1)
        result = self._below.copy()
        result[:, j, i] = self._below[:, i, j].swapaxes(2, 3)
        return result

    def add_curvatures(self, pair, factor, rays: Rays, T):
        """Add second derivatives of f (:mod:`~hypergap_dolfinx.gap.heights`).

        Args:
            pair: Number of each point's pair, ``(num_points,)``.
            factor: What they are multiplied with, ``(num_points,)``.
            rays: The points.
            T: ∂q/∂u, ``(num_points, 7, num_dofs)``.
        """
        bends = library().ffi.NULL if rays.bends is None else as_doubles(rays.bends)
        library().lib.column_curvatures(
            len(T),
            T.shape[2],
            as_ints(pair),
            as_doubles(factor),
            as_doubles(rays.q),
            bends,
            as_doubles(T),
            as_doubles(self._below),
        )

    def add_products(self, pair, a, b):
        """Add a bᵀ + b aᵀ.

        Args:
            pair: Number of each product's pair, ``(num_points,)``.
            a: ``(num_points, num_dofs, 3)``.
            b: Likewise.
        """
        library().lib.add_products(
            len(a), a.shape[1], as_ints(pair), as_doubles(a), as_doubles(b), as_doubles(self._below)
        )
