# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tetrahedra between two surfaces: their measure D, their faces, and their straight edges.

D (:func:`areas`) is positive for the simplex of each cell's vertices. A curved cell may be inverted
all the same, so :func:`straighten` chooses edges to be straight, as few as it takes: it always
succeeds, since a cell becomes its simplex one edge after the other, together with the cells that
share the edge. Nodes on such an edge are hosted at their projections, so Σ stays consistent along
the surfaces and is off them by the edge's sag.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.compiled import call, doubles, ints

FACES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])
"""Vertices of a cell's faces, counterclockwise seen from outside."""
EDGES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
NONE = np.empty((0, 2), dtype=np.intp)  # no edges

Margins = Callable[[npt.NDArray, npt.NDArray], npt.NDArray[np.float64]]
"""``margins(cells, edges)``: distance of cells from inversion if some edges are straight, not
positive where a cell is inverted somewhere."""


def areas(x, alpha, normal, cells=None):
    """D = Σ_k dα_k (e_{k+1} × e_{k+2}) · n, positive for a cell that is not inverted.

    Args:
        x: Vertex coordinates, ``(num_cells, 4, 3)``; those of all vertices if cells are given.
        alpha: α at the vertices, ``(num_cells, 4)``, or of all.
        normal: Normals n of any length, ``(num_cells, 3)``; or of all vertices, to be added up.
        cells: Vertices of each cell, ``(num_cells, 4)``.

    Returns:
        D, and its scale, ``(num_cells,)`` each: the doubled area of a base on a surface, the
        product of the lengths of two edges on the surfaces, or the square of the longest edge from
        the first vertex.
    """
    D, scale = np.empty((2, len(x) if cells is None else len(cells)))
    of = None if cells is None else ints(cells)
    call("cell_areas", len(D), of, doubles(x), doubles(alpha), doubles(normal), D, scale)
    return D, scale


def find(triangles: npt.NDArray, corners: npt.NDArray) -> npt.NDArray[np.intp]:
    """The first triangle with some vertices, ``(num, 2)`` or more columns; −1 if there is none."""
    num, size = corners.shape
    found = np.full(num, -1, dtype=np.int32)
    if num and size < 4 and len(triangles):
        num_vertices = int(max(triangles.max(), corners.max())) + 1
        given = num_vertices, len(triangles), ints(triangles), size, num, ints(corners)
        if call("find_facets", *given, found):
            raise MemoryError("no memory for the cells of the gap domain")
    return found.astype(np.intp)


def single_faces(cells, outer) -> tuple[npt.NDArray[np.intp], int]:
    """Faces around cavities: of cells without a neighbour, and of the boundary without a cell.

    Args:
        cells: ``(num_cells, 4)``.
        outer: The boundary's triangles, counterclockwise seen from inside, ``(num_triangles, 3)``.

    Returns:
        Triangles, counterclockwise seen from the cavity, ``(num_faces, 3)``; and the number of
        faces that haven't a cell on each side, or one cell and a triangle of the boundary.
    """
    faces = np.empty((4 * len(cells) + len(outer), 3), dtype=np.int32)
    counts = np.zeros(2, dtype=np.int32)
    num = int(max(cells.max(initial=-1), outer.max(initial=-1))) + 1
    given = num, len(cells), ints(cells), len(outer), ints(outer)
    if call("single_faces", *given, faces, counts):
        raise MemoryError("no memory for the cells of the gap domain")
    return faces[: counts[1]].astype(np.intp), int(counts[0])


def have(vertices: npt.NDArray[np.integer], edges: npt.NDArray[np.integer]):
    """Mask of vertex sets, ``(num, num_vertices)``, that contain one of some edges."""
    if not len(edges):
        return np.zeros(len(vertices), dtype=bool)
    i, j = np.triu_indices(vertices.shape[1], 1)
    pairs = np.stack((vertices[:, i], vertices[:, j]), axis=2)
    return np.isin(_keys(pairs), _keys(edges)).any(axis=1)


def marked(cells: npt.NDArray[np.integer], edges: npt.NDArray[np.integer]):
    """Mask of the cells' edges that are among some, ``(num_cells, 6)``."""
    if not len(edges):
        return np.zeros((len(cells), 6), dtype=bool)
    return np.isin(_keys(cells[:, EDGES]), _keys(edges))


def _keys(edges) -> npt.NDArray[np.int64]:
    """A number for each edge, whatever the order of its ends."""
    edges = np.sort(edges, axis=-1).astype(np.int64)
    return (edges[..., 0] << 32) + edges[..., 1]


def straightened(x, points, marks, vertices) -> npt.NDArray[np.float64]:
    """Geometry nodes of cells, moved to where straight edges put them.

    Nodes move that lie on a straight edge, or between it and other vertices.

    Args:
        x: ``(num_cells, num_points, 3)``.
        points: Nodes of the reference cell, ``(num_points, 3)``.
        marks: Mask of the straight edges, ``(num_cells, 6)``.
        vertices: The cells' vertices, ``(num_cells, 4, 3)``.
    """
    weights = np.column_stack((1 - points.sum(axis=1), points))
    between = (np.abs(weights[:, EDGES]) > 1e-12).all(axis=2)  # (point, edge)
    move = (marks[:, None] & between).any(axis=2)
    return np.where(move[..., None], weights @ vertices, x)


def straighten(cells, alpha, margins: Margins) -> npt.NDArray[np.integer]:
    """Edges to be straight so that no cell is inverted, ``(num_edges, 2)``.

    Edges through the gap come first, since no body has them; then edges on the surfaces, for each
    cell the one that helps most.
    """
    edges = NONE
    for _ in range(6 * len(cells) + 1):  # each time another edge at least
        bad = np.flatnonzero(margins(cells, edges) <= 0)
        left = ~marked(cells[bad], edges)
        ends = alpha[cells[bad][:, EDGES]]
        through = left & ((ends[..., 0] != ends[..., 1]) | (ends[..., 0] % 1 != 0))
        if through.any():
            more = cells[bad][:, EDGES][through]
        else:
            more = _best(cells[bad], left, edges, margins)
        if not len(more):
            break
        edges = np.unique(np.sort(np.vstack((edges, more)), axis=1), axis=0)
    return edges


def _best(cells, left, edges, margins: Margins) -> npt.NDArray[np.integer]:
    """Remaining edge of each cell that improves it most."""
    found = []
    for cell, own in zip(cells, left, strict=True):
        tries = cell[EDGES[own]]
        values = [margins(cell[None], np.vstack((edges, more)))[0] for more in tries]
        if values:
            found.append(tries[int(np.argmax(values))])
    return np.array(found, dtype=np.intp).reshape(-1, 2)
