# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Weighted gaps of parts of Γ1's facets in space where sheets of Γ0 end, turn away or overlap.

This is as in the plane (``rays.py``), with facets for edges and parts for halves: a sheet has the
weight ω at a point, and covers those in front of it by that share. It fades at smaller angles than
there: facets of Γ1 beside what is pressed into it tilt towards its walls, which are far along their
rays, and such gaps in a mean take forces away. Where ω = 1 on all of a facet, since one sheet of Γ0
lies opposite and reaches beyond it, the gap is the volume of columns, whose derivatives are simple
(``heights.py``). Other facets, few in most scenes, are *faded*. There

.. math:: \sum_k \omega_k h_k \prod_{j<k} (1 - \omega_j)
   = \sum_S (-1)^{|S| + 1} \max_{k\in S} h_k \prod_{k\in S} \omega_k

over all sets S of sheets, each integrated over the polygon in which all of S lie opposite the
part, with the rule of ``moments.py``. Its corners move with both surfaces. Values and derivatives
to the second order of all that are computed in C (``c/parts.c``).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.contact_geometry.heights import At, Rays
from hypergap_dolfinx.contact_geometry.moments import degree_of, inner_points, standard_points
from hypergap_dolfinx.contact_geometry.opposite import (
    FacetPieces,
    Frames,
    OwnPairs,
    cross,
    polygon_areas,
    reference_corners,
)
from hypergap_dolfinx.contact_geometry.protocol import check
from hypergap_dolfinx.contact_geometry.tolerances import (
    COSINES_SPACE,
    INSIDE,
    LAST,
    NEAREST,
    ROUND_OFF_FACET,
    SLACK,
    WIDTH,
)
from hypergap_dolfinx.core.compiled import call, doubles, ints, library, struct
from hypergap_dolfinx.core.graph import components
from hypergap_dolfinx.surface.moving import Sparse
from hypergap_dolfinx.surface.search import along_curve
from hypergap_dolfinx.surface.trace import Surface, lengths, tabulate

entries_first = 1_000_000  # of a matrix: memory that isn't written to costs nothing


@dataclass(frozen=True)
class BodyTriangles:
    """Triangles of a surface, for depths in its body."""

    surface: Surface
    corners: npt.NDArray[np.float64]
    """``(num_triangles, 3, 3)``."""
    at: npt.NDArray[np.float64]
    """Corners of a facet's triangles on the reference facet, ``(triangles_a_facet, 3, 2)``."""
    own: OwnPairs | None = None
    """Facets that count for a surface's own points; None: all."""

    @classmethod
    def of(cls, surface: Surface, own: OwnPairs | None = None, cuts: int = 1) -> "BodyTriangles":
        """That of a surface; curved facets are taken as triangles between their nodes.

        Args:
            surface: The surface.
            own: The attribute.
            cuts: Parts into which edges between nodes are cut.
        """
        points, triangles = _lattice(surface.geometry.cell_type, cuts * surface.geometry.degree)
        corners = (tabulate(surface.geometry, points) @ surface.nodes)[:, triangles]
        return cls(surface, corners.reshape(-1, 3, 3), points[triangles], own)

    @cached_property
    def order(self) -> npt.NDArray[np.int32]:
        """Triangles along a curve that fills space."""
        return ints(along_curve(self.corners.mean(axis=1)))

    def depths(self, x: npt.NDArray[np.float64], facet, *feet) -> npt.NDArray[np.float64]:
        """Depths of points by the nearest triangle, negative outside, ``(num,)``.

        Args:
            x: ``(num, 3)``.
            facet: The facet of Γ1 on which each is, ``(num,)``.
            *feet: Where to write the triangles and the shares of their corners in nearest places.
        """
        depths, own = np.empty(len(x)), self.own and self.own.in_c
        given = len(self.corners), doubles(self.corners), self.order, len(self.at), own
        points = len(x), doubles(x), ints(facet), depths
        if call("find_depths", *given, *points, *(feet or (None, None))):
            raise MemoryError("no memory for the depths of points")
        return depths

    def feet(self, x: npt.NDArray[np.float64]) -> "Feet":
        """Places nearest to points of another surface, ``(num, 3)``."""
        found = np.empty(len(x), np.int32), np.empty((len(x), 3))
        return Feet(self, self.depths(x, np.zeros(len(x)), *found), *found)


@dataclass(frozen=True)
class Feet:
    """Places of a surface that are nearest to points."""

    body: BodyTriangles
    depths: npt.NDArray[np.float64]
    """Depths of the points in the body, ``(num,)``."""
    triangle: npt.NDArray[np.int32]
    """``(num,)``."""
    shares: npt.NDArray[np.float64]
    """Shares of its corners, ``(num, 3)``."""

    def some(self, some) -> "Feet":
        """Subset, by numbers or a mask."""
        return Feet(self.body, self.depths[some], self.triangle[some], self.shares[some])

    @property
    def facet(self) -> npt.NDArray[np.intp]:
        """Facet of each, ``(num,)``."""
        return (self.triangle // len(self.body.at)).astype(np.intp)

    @property
    def x(self) -> npt.NDArray[np.float64]:
        """The places, ``(num, 3)``."""
        return np.einsum("pc,pci->pi", self.shares, self.body.corners[self.triangle])

    @property
    def X(self) -> npt.NDArray[np.float64]:
        """Their reference coordinates, ``(num, 2)``."""
        at = self.body.at[self.triangle % len(self.body.at)]
        return np.einsum("pc,pci->pi", self.shares, at)

    @property
    def at_end(self) -> npt.NDArray[np.bool_]:
        """Mask of those where the surface ends: nothing is known of points there, ``(num,)``."""
        surface = self.body.surface
        corners = reference_corners(surface.geometry.cell_type)
        along = np.roll(corners, -1, axis=0) - corners
        apart = self.X[:, None] - corners
        across = along[:, 0] * apart[..., 1] - along[:, 1] * apart[..., 0]
        on = across <= ROUND_OFF_FACET
        corner = on & np.roll(on, 1, axis=1)
        facet = self.facet
        return (
            on & surface.is_outline[facet] | corner & surface.at_end[surface.polygons[facet]]
        ).any(axis=1)


def weights_of(frames: Frames, rays: Rays, body: BodyTriangles) -> npt.NDArray[np.float64]:
    """Weights ω of sheets at rays.

    Args:
        frames: Γ0 and Γ1.
        rays: Rays.
        body: Γ0's.

    Returns:
        ``(num,)``.
    """
    q = rays.q
    below, normal = cross(q[:, At.Z1], q[:, At.Z2]), cross(q[:, At.C1], q[:, At.C2])
    size, length = np.maximum(lengths(below), 1e-300), lengths(normal)
    cos = -np.einsum("pi,pi->p", below, normal) / (size * length)
    deep = np.einsum("pi,pi->p", below, q[:, At.R]) / size
    result = _ramp(cos, COSINES_SPACE)
    if body.own:
        result[deep > cos * body.own.walls[rays.facets[1]]] = 0
    if rays.bends is not None:
        xi, triangles = rays.xi, frames.surfaces[0].polygons.shape[1] == 3
        beyond = 1 - xi.sum(axis=1, keepdims=True) if triangles else 1 - xi
        result *= _ramp(np.column_stack((xi, beyond)).min(axis=1), INSIDE)
    slack = SLACK * np.sqrt(length)
    # As deep as that by the nearest facet, for it isn't farther away than the sheet
    near = deep * (NEAREST[1] + 1 / np.where(result > 0, cos, 1)) <= slack
    far = np.flatnonzero((result > 0) & ~near)
    x = frames.surfaces[0].points(rays.facets[0][far], rays.xi[far]) - q[far, At.R]
    result[far] *= _ramp((body.depths(x, rays.facets[1][far]) + slack[far]) / deep[far], NEAREST)
    return np.nan_to_num(result)  # rays that miss a folded facet may be nowhere


def sort_out(
    frames: Frames, pieces: FacetPieces, least, most, height
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Separate pieces into columns and parts of faded facets.

    Args:
        frames: Γ0 and Γ1.
        pieces: All pieces.
        least: Least weight on each, ``(num_pieces,)``.
        most: Largest one.
        height: Height of each.

    Returns:
        Masks, ``(num_pieces,)`` each.
    """
    f1, seen = pieces.facets[1], most > 0
    some = np.flatnonzero(seen)
    first = np.zeros(len(f1), dtype=bool)
    first[some[_farthest_behind(frames, pieces.some(some), height[some])]] = True
    num = len(frames.middle)
    whole = polygon_areas(reference_corners(frames.surfaces[1].geometry.cell_type)[None])[0]
    area = np.bincount(f1[first], pieces.area[first], num)
    faded = area < (1 - ROUND_OFF_FACET) * whole
    faded[f1[first & (least < 1)]] = True
    return first & ~faded[f1], seen & faded[f1]


class Faded:
    """Parts of faded facets; all arrays of parts are ``(num_facets1 * num_corners,)``."""

    def __init__(self, frames: Frames, pieces: FacetPieces, dofs, body: BodyTriangles, parts):
        """Store the facets that have some of the pieces.

        Args:
            frames: Γ0 and Γ1.
            pieces: What these facets see.
            dofs: Both sides' dofs by facet, Γ1's behind all of Γ0's.
            body: Γ0's.
            parts: Of Γ1's reference facet, ``(num_corners, 4, 2)``.
        """
        below, above = frames.surfaces
        f0, f1 = pieces.facets
        pairs = np.unique(f1 * len(below.facets) + f0)
        self.facets, first = np.unique(pairs // len(below.facets), return_index=True)
        corners = reference_corners(below.geometry.cell_type)
        degree = degree_of(frames.surfaces)
        points, powers, inverse = standard_points(degree)
        inner = inner_points(degree)
        self.num = parts.shape[0] * len(above.facets)
        self._pointer = struct(
            "Parts",
            sides=frames.in_c,
            dofs=[ints(part) for part in dofs],
            corners=doubles(corners),
            planes=frames.planes,
            parts=doubles(parts),
            num=len(self.facets),
            facets=ints(self.facets),
            first=ints(np.append(first, len(pairs))),
            sheets=ints(pairs % len(below.facets)),
            outline=ints(below.is_outline),
            num_points=len(points),
            points=points,
            num_terms=len(powers),
            powers=ints(powers),
            inverse=doubles(inverse),
            num_inner=len(inner),
            inner=inner,
            cosines=list(COSINES_SPACE),
            inside=list(INSIDE),
            nearest=list(NEAREST),
            slack=SLACK,
            sliver=ROUND_OFF_FACET,
            least=WIDTH**2,
            last=LAST,
            num_triangles=len(body.corners),
            triangles=doubles(body.corners),
            order=body.order,
            triangles_a_facet=len(body.at),
            triangle_at=doubles(body.at),
            own=body.own and body.own.in_c,
        )

    def gaps(self, *values: npt.NDArray[np.float64]) -> tuple[Sparse, Sparse]:
        """Add gaps, covered shares and covered areas of parts; derivatives of the first two."""
        new = np.empty((3, self.num))

        def find(*slopes):
            new[:] = 0
            return call("find_parts", self._pointer, *new, *slopes)

        slopes = _filled(2, find)
        for value, more in zip(values, new, strict=True):
            value += more
        return slopes[0], slopes[1]

    def curvature(self, p, by_covered) -> Sparse:
        """Σ p ∂²g/∂u² + Σ by_covered ∂²covered/∂u², with values of parts."""
        given = self._pointer, doubles(p), doubles(by_covered)
        return _filled(1, lambda H: call("part_curvature", *given, H))[0]

    def slips(self, moved=None) -> Sparse:
        """T with the slips s = T Δu of parts, three components each; ∂s/∂u if Δu moves with u.

        Args:
            moved: Δu by both sides' dofs, ``(num_dofs, 3)``, if it moves with u.
        """
        given = self._pointer, None if moved is None else doubles(moved), False
        return _filled(1, lambda T: call("part_slips", *given, T))[0]

    def parting(self) -> Sparse:
        """Change of the gaps by displacements, with pairs of opposite points kept."""
        return _filled(1, lambda C: call("part_slips", self._pointer, None, True, C))[0]

    def slip_curvature(self, q) -> Sparse:
        """Σ q ∂T/∂u, with tractions of parts, ``(num, 3)``; it isn't symmetric."""
        given = self._pointer, doubles(q)
        return _filled(1, lambda H: call("part_slip_curvature", *given, H))[0]


def _filled(num: int, add: Callable) -> Sequence[Sparse]:
    """Matrices to which a function of C adds entries, with as much room as they need."""
    room = [entries_first] * num
    while True:
        arrays = [(*np.empty((2, size), np.int32), np.empty(size)) for size in room]
        names = "rows", "columns", "values"
        made: list[Any] = [
            struct("Triplets", max=size, **dict(zip(names, part, strict=True)))
            for size, part in zip(room, arrays, strict=True)
        ]
        check(add(*made), library("space").lib.MOST_STACKED)
        if all(each.num <= size for each, size in zip(made, room, strict=True)):
            break
        room = [max(each.num, size) for each, size in zip(made, room, strict=True)]
    return [
        Sparse(i[: each.num].astype(np.int64), j[: each.num].astype(np.int64), v[: each.num]).summed
        for each, (i, j, v) in zip(made, arrays, strict=True)
    ]


def _ramp(values, ends: tuple[float, float]) -> npt.NDArray[np.float64]:
    """A smooth step from 0 to 1 between two values."""
    t = np.clip((values - ends[0]) / (ends[1] - ends[0]), 0, 1)
    return t * t * (3 - 2 * t)


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
