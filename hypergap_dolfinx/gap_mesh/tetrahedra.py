# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tetrahedra between two surfaces: their areas, their faces, and whether they are valid."""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.compiled import as_ints, library
from hypergap_dolfinx.surface.trace import lengths, normals_by_area

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


def find(triangles: npt.NDArray, corners: npt.NDArray) -> npt.NDArray[np.intp]:
    """The first triangle that has the given vertices, −1 where there is none.

    Args:
        triangles: ``(num_triangles, 3)``.
        corners: ``(num, 2)`` or ``(num, 3)``; if more none has them.

    Returns:
        ``(num,)``.
    """
    num, size = corners.shape
    found = np.full(num, -1, dtype=np.int32)
    if num and size < 4 and len(triangles):
        status = library().lib.find_facets(
            int(max(triangles.max(), corners.max())) + 1,
            len(triangles),
            as_ints(triangles),
            size,
            num,
            as_ints(corners),
            as_ints(found),
        )
        if status:
            raise MemoryError("no memory for the cells of the gap domain")
    return found.astype(np.intp)


def single_faces(cells, outer) -> tuple[npt.NDArray[np.intp], bool]:
    """Faces around what is missing: of cells without a neighbour, and of the boundary without cell.

    Args:
        cells: ``(num_cells, 4)``.
        outer: The boundary's triangles, counterclockwise seen from inside, ``(num_triangles, 3)``.

    Returns:
        Triangles, counterclockwise seen from the cavity, ``(num_faces, 3)``; and whether each face
        has a cell on each side, or one cell and a triangle of the boundary.
    """
    faces = np.empty((4 * len(cells) + len(outer), 3), dtype=np.int32)
    counts = np.zeros(2, dtype=np.int32)
    num = int(max(cells.max(initial=-1), outer.max(initial=-1))) + 1
    data = (len(cells), as_ints(cells), len(outer), as_ints(outer), as_ints(faces), as_ints(counts))
    if library().lib.single_faces(num, *data):
        raise MemoryError("no memory for the cells of the gap domain")
    return faces[: counts[1]].astype(np.intp), counts[0] == 0
