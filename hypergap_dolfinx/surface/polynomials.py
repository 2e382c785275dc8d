# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Monomials and coefficients of facets' Lagrange elements, for ``c/monomials.h``."""

import numpy as np
import numpy.typing as npt

import basix


def terms(
    element: basix.finite_element.FiniteElement, origin=(0.0, 0.0)
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Monomials of an element around an origin, and coefficients of its basis functions.

    Returns:
        Powers of both coordinates, ``(num_terms, 2)``, and ``(num_terms, num_nodes)``.
    """
    degree = element.degree
    powers = np.array([(i, j) for i in range(degree + 1) for j in range(degree + 1)])
    if element.cell_type == basix.CellType.triangle:
        powers = powers[powers.sum(axis=1) <= degree]
    values = ((element.points - origin)[:, None] ** powers).prod(axis=2)  # (node, term)
    return powers, np.linalg.inv(values)
