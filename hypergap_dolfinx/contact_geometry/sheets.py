# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which sheets of Γ0 the facets of Γ1 meet in space, where several lie one behind the other.

What lies behind a point of Γ1 is that of a body in which the point isn't, unless it is nearly as
deep in Γ0's body by what of Γ0 is nearest: far sides and side walls of closed bodies aren't met.
Of what is left the sheet that is farthest behind hides those in front of it.
"""

from functools import cache

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.contact_geometry.moments import rule
from hypergap_dolfinx.contact_geometry.opposite import FacetPieces, Frames, Label, find_pieces
from hypergap_dolfinx.contact_geometry.tolerances import COSINES, FACING, NEAREST, SLACK
from hypergap_dolfinx.core.compiled import call, doubles, ints
from hypergap_dolfinx.core.graph import components
from hypergap_dolfinx.surface.search import along_curve
from hypergap_dolfinx.surface.trace import Surface, lengths, tabulate


def find_met(frames: Frames) -> tuple[FacetPieces, npt.NDArray[np.bool_]]:
    """The pieces that are met, and a mask of their edges beyond which Γ0 isn't, by corners."""
    pieces = find_pieces(frames)
    met = _visible(frames, pieces)
    return pieces.some(met), _ends(frames, pieces, met)


def _visible(frames: Frames, pieces: FacetPieces) -> npt.NDArray[np.bool_]:
    """Mask of the pieces that are met, ``(num_pieces,)``."""
    below, above = frames.surfaces
    f0, f1 = pieces.facets
    if not len(f0):
        return np.ones(0, dtype=bool)
    x = above.points(f1, rule(pieces.X, 1)[0])
    other, normal = below.normals[f0], frames.normal[f1]
    cos = -np.einsum("pi,pi->p", other, normal) / lengths(normal)
    deep = np.einsum("pi,pi->p", other, below.x[below.facets[f0, 0]] - x)
    met = _ramp(cos, COSINES)
    slack = SLACK * above.size[f1]
    # As deep as that by the nearest facet, for it isn't farther away than the sheet
    near = deep <= slack / (NEAREST[1] + 1 / cos)
    far = np.flatnonzero(~near)
    depth = find_depths(below, x[far]) + slack[far]
    met[far] *= _ramp(depth / deep[far], NEAREST)
    on = np.flatnonzero(met >= 0.5)
    on = on[_farthest_behind(frames, pieces.some(on), -deep[on] / cos[on])]
    mask = np.zeros(len(f0), dtype=bool)
    mask[on] = True
    return mask


def _ramp(values, ends: tuple[float, float]) -> npt.NDArray[np.float64]:
    """A smooth step from 0 to 1 between two values."""
    t = np.clip((values - ends[0]) / (ends[1] - ends[0]), 0, 1)
    return t * t * (3 - 2 * t)


def find_depths(surface: Surface, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Depths of points in a body by its nearest facet, negative outside.

    Args:
        surface: The body's surface; curved facets are taken as triangles between their nodes.
        x: Points, ``(num, 3)``.

    Returns:
        ``(num,)``.
    """
    points, triangles = _lattice(surface.geometry.cell_type, surface.geometry.degree)
    corners = (tabulate(surface.geometry, points) @ surface.nodes)[:, triangles].reshape(-1, 3, 3)
    depths = np.empty(len(x))
    order = ints(along_curve(corners.mean(axis=1)))
    if call("find_depths", len(corners), doubles(corners), order, len(x), doubles(x), depths):
        raise MemoryError("no memory for the depths of points")
    return depths


@cache
def _lattice(cell_type: basix.CellType, degree: int) -> tuple[npt.NDArray, npt.NDArray]:
    """Points that divide a reference facet, and triangles between them.

    Returns:
        ``(num_points, 2)`` and ``(num_triangles, 3)``, counterclockwise.
    """
    quad = cell_type == basix.CellType.quadrilateral
    rows = range(degree + 1)
    places = [(i, j) for i in rows for j in range(degree + 1 - (0 if quad else i))]
    number = {at: n for n, at in enumerate(places)}
    triangles = []
    for i, j in number:
        ring = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
        if quad and ring[2] in number:
            triangles += [ring[:3], [ring[0], *ring[2:]]]
        elif not quad and ring[1] in number:
            triangles += [[ring[0], ring[1], ring[3]]]
            if ring[2] in number:
                triangles += [ring[1:]]
    at = np.array(list(number), dtype=float) / degree
    return at, np.array([[number[point] for point in triangle] for triangle in triangles])


def _farthest_behind(frames: Frames, pieces: FacetPieces, height) -> npt.NDArray[np.bool_]:
    """Mask of the connected part of Γ0 that lies farthest behind, on each facet of Γ1."""
    below, above = frames.surfaces
    (f0, f1), num = pieces.facets, below.facets.shape[1]
    keys = (f1[:, None] * len(below.x) + below.facets[f0]).ravel()
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    piece = order // num
    sheet = components(len(f0), piece[same], piece[same + 1])
    if sheet.max(initial=-1) + 1 == len(np.unique(f1)):
        return np.ones(len(f0), dtype=bool)
    area = pieces.area
    mean = np.bincount(sheet, height * area) / np.bincount(sheet, area)
    facet = np.zeros(len(mean), dtype=np.intp)
    facet[sheet] = f1
    least = np.full(len(above.facets), np.inf)
    np.minimum.at(least, facet, mean)
    first = np.full(len(above.facets), len(mean))
    lowest = np.flatnonzero(mean <= least[facet])
    np.minimum.at(first, facet[lowest], lowest)
    return first[f1] == sheet


def _ends(frames: Frames, pieces: FacetPieces, mask) -> npt.NDArray[np.bool_]:
    """Mask of edges beyond which Γ0 isn't met.

    Args:
        frames: Γ0 and Γ1 where they are.
        pieces: All pieces.
        mask: Those that are met, ``(num_pieces,)``.

    Returns:
        Of the pieces that are met, by their labels, ``(num, num_corners)``.
    """
    below = frames.surfaces[0]
    f0, f1 = pieces.facets
    numbers = below.edge_numbers
    pairs = np.full((int(numbers.max()) + 1, 2), -1)
    sides = numbers.shape[1]
    order = np.argsort(numbers.ravel(), kind="stable")
    at = numbers.ravel()[order]
    first = np.flatnonzero(np.append(True, at[1:] != at[:-1]))
    pairs[at[first], 0] = order[first] // sides
    last = np.append(first[1:], len(at)) - 1
    pairs[at[last], 1] = order[last] // sides
    behind = np.unique(f1[~mask] * len(below.facets) + f0[~mask])
    f0, f1, label = f0[mask], f1[mask], pieces.label[mask]
    both = pairs[numbers[f0[:, None], label]]
    other = np.where(both[..., 0] == f0[:, None], both[..., 1], both[..., 0])
    axis = frames.normal[f1] / lengths(frames.normal[f1])[:, None]
    away = np.einsum("pki,pi->pk", below.normals[other], axis) >= -FACING
    hidden = np.isin(f1[:, None] * len(below.facets) + other, behind)
    end = below.is_outline[f0[:, None], label] | away | hidden
    return end & (label != Label.INNER)
