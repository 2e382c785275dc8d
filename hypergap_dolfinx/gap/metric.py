# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tetrahedra between two surfaces: their areas, their faces, and whether they are valid."""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.surface import lengths, normals_by_area

FLAT = 1e-9  # D of a cell over the product of its two edges on the surfaces that is none
FACES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])
"""Vertices of a cell's faces, counterclockwise seen from outside."""


def areas(x, alpha, normal):
    """D = Σ_k dα_k (e_{k+1} × e_{k+2}) · n, positive for a cell that is not inverted.

    Args:
        x: Vertex coordinates, ``(num_cells, 4, 3)``.
        alpha: α at the vertices, ``(num_cells, 4)``.
        normal: Normals n of any length, ``(num_cells, 3)``.

    Returns:
        D, and what it is compared with, ``(num_cells,)`` each: the area of a base on a surface
        (doubled), the product of two edges on the surfaces' lengths, or the square of the longest
        edge from the first vertex.
    """
    n = normal / np.maximum(lengths(normal), 1e-300)[:, None]
    e, d = x[:, 1:] - x[:, :1], alpha[:, 1:] - alpha[:, :1]
    N = np.einsum("ck,cki->ci", d, np.cross(e[:, [1, 2, 0]], e[:, [2, 0, 1]]))
    scale = np.einsum("cki,cki->ck", e, e).max(axis=1)
    for face, corner in zip(FACES, range(4), strict=True):
        base = np.flatnonzero((alpha[:, face] == alpha[:, face[:1]]).all(axis=1))
        if not len(base):
            continue
        v = x[base][:, face]
        twice = lengths(normals_by_area(v))
        scale[base] = twice * np.abs(alpha[base, corner] - alpha[base, face[0]])
    for a, b, c, d in ((0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2)):
        pairs = (alpha[:, a] == alpha[:, b]) & (alpha[:, c] == alpha[:, d])
        pairs = np.flatnonzero(pairs & (alpha[:, a] != alpha[:, c]))
        scale[pairs] = lengths(x[pairs, a] - x[pairs, b]) * lengths(x[pairs, c] - x[pairs, d])
    return np.einsum("ci,ci->c", N, n), scale


def face_keys(faces: npt.NDArray[np.integer]) -> npt.NDArray:
    """A number for each face that depends on its vertices only, less than 2²¹ of them."""
    a, b, c = np.sort(faces, axis=1).astype(np.int64).T
    return (a << 42) + (b << 21) + c
