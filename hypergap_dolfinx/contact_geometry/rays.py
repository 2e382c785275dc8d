# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Weighted gaps and slips in the plane, by rays from Γ1 to Γ0. No MPI, no PETSc.

From each point of an edge of Γ1 a line goes along the normal of the edge's chord c. It meets
sheets k of Γ0, at heights h_k over the edge. The gap and the covered part of each half of the edge,
which belongs to the vertex at its end, are

.. math:: g = \int |c| \sum_k \omega_k h_k \prod_{j<k} (1 - \omega_j) \,d\xi, \qquad
   2 \int \sum_k \omega_k \prod_{j<k} (1 - \omega_j) \,d\xi

over ξ, the place along the chord from 0 to 1, with the sheets in order from behind Γ1 to the front.
By its edge's normal a sheet has the weight

.. math:: \omega_e = W\Bigl(\frac{\cos - C_0}{C_1 - C_0}\Bigr)\,
   W\Bigl(\frac{D / (-h) - N_0}{N_1 - N_0}\Bigr), \qquad
   D = W\Bigl(\frac{d + s}{-h\cos}\Bigr)\,(-h\cos + s)

with a smooth step W, the cosine between the normals that face each other, C (:data:`COSINES`) and N
(:data:`NEAREST`). The first factor fades where Γ0 turns away. The second one acts where h < 0: it
compares the point's depth in Γ0's body with the overlap −h along the ray. The depth D is that by
the sheet's plane, −h cos, as long as the one by the nearest edge, d, isn't less, both with a slack
s (:data:`SLACK`). So a sheet fades if it is deep and leans, or far from the point's nearest edge,
or behind Γ1's own body: there it belongs to a body in which the point isn't (d < 0). D is flat
where a sheet's own edge becomes the nearest one, and d has a kink; else forces would jump as kinks
pass points of the quadrature. Of a curved edge d and cos are here those of straight ones, between
its nodes and between its ends.

These weights alone would jump at Γ0's vertices, and forces would jump as one of them passes an end
of Γ1's edge. So what an edge's weight lacks of 1 is filled from the edges before and behind it,
e ∓ 1, with the weights that these have by their normals at the common vertex. At r between 0 and 1
along the edge it becomes

.. math:: \omega = \omega_e + (1 - \omega_e)\,\Bigl(s\,\bigl((1 - r)\,\omega_{e-1}
   + r\,\omega_{e+1}\bigr) + (1 - s)\,\lambda_-\lambda_+\Bigr), \qquad
   s = W\Bigl(\frac{2 \cos}{C_0} - 1\Bigr).

That is continuous at a vertex, 1 on edges that face Γ1 fully, and 0 on sides at a right angle,
which lead to nothing that faces Γ1. A *riser*, as the step of a stair, leads from one edge that
faces Γ1 to another. It has the weights λ of what it leads to before and behind it: the largest
:math:`\omega_e` of the edges that follow, as long as those between don't turn away, times κ, a
smooth step of their cosine from 0 at −C0 to 1 at 0. Where a riser turns away itself, what is in
front of it is hidden by what is behind it. Forces don't jump as it comes to do so, since it takes
back κ λ of what is seen behind it, and uncovers what is in front of it by κ. This is done for
straight edges: on curved ones pairs of hits come and go where they turn.

The product is the share of the ray that sheets farther behind leave. A sheet that fades leaves what
it loses to those in front of it. So gaps and areas are continuous functions of the displacements,
whatever ends, corners and far sides pass; with one sheet of weight 1 they are volumes and lengths.

A motion Δu of both sides has the slip :math:`\int \mathbf c\cdot(\Delta\mathbf u_0 -
\Delta\mathbf u_1)\,d\xi` of opposite points, with the same weights. For an infinitesimal rotation
it is the gap times the angle. If Δu is the position, it is zero. So with Δu = x − x_n a rotation of
closed bodies, however large, is no slip.

Of bodies of revolution gaps and slips have one more factor, the arc :math:`\varphi\,(r_0 + r_1)/2`
with the distances from the axis of both ends of the ray (φ is 2π or 1): then a gap is the volume
that a ray's column sweeps, exactly, and pressures act on what they are on in space.

Where ends of both sides slide along one wall, as one of symmetry, Γ0 goes on beyond it.

Quadrature is exact on straight edges with one sheet of weight 1. Its degree is higher where weights
aren't 1; else forces would jump as pieces' ends pass each other. Derivatives are those of the
quadrature, to round-off. Computed in C (``c/rays.c``, ``c/gaps.c``).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.contact_geometry.opened import OpenColumns
from hypergap_dolfinx.contact_geometry.protocol import check
from hypergap_dolfinx.contact_geometry.tolerances import (
    COSINES,
    FADING_DEGREE,
    NEAREST,
    SHARED,
    SLACK,
)
from hypergap_dolfinx.core.compiled import call, changed, doubles, dtype, ints, library, struct
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.gap_mesh.strip import check_chains
from hypergap_dolfinx.surface.moving import MovingSurface, Sides, Sparse, joined
from hypergap_dolfinx.surface.trace import Surface, lengths

points_an_edge = 4  # room at first; with more they are found anew
entries_a_row = 32  # likewise


@dataclass
class PlaneRays:
    """Rays from Γ1's edges; values of its halves are ``(num_edges1, 2)``."""

    sigma: Any
    """Struct ``Sigma`` of ``c/plane.h``."""
    points: npt.NDArray
    """``Point`` of ``c/plane.h``, ``(num_points,)``."""
    above: Surface
    """Γ1 where it is."""
    slides: bool = False
    """True if slips are found with gaps."""
    _every_slip: Sparse | None = None

    @property
    def facets(self) -> npt.NDArray[np.int32]:
        """Vertices of Γ1's edges, ``(num_edges1, 2)``."""
        return self.above.facets

    @property
    def num_halves(self) -> int:
        """Number of halves of Γ1's edges."""
        return 2 * self.sigma.sides[1].num_edges

    def gaps(self) -> "tuple[npt.NDArray, npt.NDArray, npt.NDArray, Sparse, Sparse]":
        """Gaps, covered shares and lengths of halves; ∂g/∂u, summed over vertices; ∂covered/∂u."""
        g, covered, areas = np.empty((3, self.num_halves))
        given = self.sigma, g, covered, areas

        def find(C, K, T=None):
            return call("find_gaps", *given, C, K, T)

        C, by_covered, *found = _filled(self.num_halves, 2 + self.slides, find)
        if found:
            (self._every_slip,) = found
        g, covered, areas = (part.reshape(-1, 2) for part in (g, covered, areas))
        return g, covered, areas, C, by_covered

    def curvature(self, p: npt.NDArray, by_covered: npt.NDArray) -> Sparse:
        """Σ p ∂²g/∂u² + Σ by_covered ∂²covered/∂u², with values of halves."""
        given = self.sigma, doubles(p), doubles(by_covered)
        return _filled(self._num_dofs, 1, lambda H: call("gap_curvature", *given, H))[0]

    def slips(self, on=None, moved: npt.NDArray[np.float64] | None = None) -> Sparse:
        """T with the slips s = T Δu of vertices; ∂s/∂u if Δu moves with u.

        Args:
            on: Vertices that count; here all do.
            moved: Δu by both sides' dofs, ``(num_dofs, 2)``, if it moves with u.
        """
        if self._every_slip is None:
            self._every_slip = self._slips(False, None)
        if moved is None:
            return self._every_slip
        return joined(self._every_slip, self._slips(False, doubles(moved)))

    def parting(self) -> Sparse:
        """Change of the gaps by displacements, with pairs of opposite points kept."""
        return self._slips(True, None)

    def _slips(self, across: bool, moved) -> Sparse:
        given = self.sigma, across, moved
        return _filled(len(self.above.x), 1, lambda T: call("find_slips", *given, T))[0]

    def along(self, slips: Sparse, target) -> Sparse:
        """Slips in the directions of vertices' targets: here they are along edges."""
        return slips

    def slip_curvature(self, q: npt.NDArray, target) -> Sparse:
        """Σ q ∂T/∂u, with tractions of vertices, ``(1, num)``; it isn't symmetric."""
        given = self.sigma, doubles(q[0, self.facets])
        return _filled(self._num_dofs, 1, lambda H: call("slip_curvature", *given, H))[0]

    @cached_property
    def columns(self) -> OpenColumns:
        """As :meth:`Segments.columns`."""
        x = np.empty((len(self.points), 2, 2, 2))
        X, shown = np.empty((len(self.points), 2, 1)), np.empty(len(self.points), np.int32)
        call("find_columns", self.sigma, x, X, shown)
        on = shown > 0
        x, edges = x[on], self.points["edge"][on].astype(np.intp)
        width, up = x[:, 0, 1] - x[:, 0, 0], np.diff(x.mean(axis=2), axis=1)[:, 0]
        size = lengths(width)
        height = (up[:, 0] * width[:, 1] - up[:, 1] * width[:, 0]) / np.where(size > 0, size, 1)
        first, last = self.sigma.shared
        share = ((self.points["places"][on] - first) / (last - first)).clip(0, 1)
        shares = np.stack((1 - share, share), axis=2)
        return OpenColumns(x, edges, X[on], self.facets[edges], shares, height)

    def reaches(self, p, least) -> npt.NDArray[np.float64]:
        """As :meth:`Segments.reaches`, from pressures of vertices, and least lengths."""
        found = np.empty((3, len(p)))
        check(call("find_reaches", self.sigma, doubles(p), doubles(least), found))
        return found

    @property
    def _num_dofs(self) -> int:
        """Number of dofs of both sides, all components, at most."""
        return 2 * sum(side.num_edges * side.num_dofs for side in self.sigma.sides)


def side_of(side: MovingSurface, first: int) -> dict[str, Any]:
    """A side in the form that the C code takes, without its position.

    Args:
        side: Γ0 or Γ1.
        first: Number of its first dof.

    Raises:
        InterfaceError: Its degree is too high, or it branches.
    """
    surface, element = side.rest, side.reference.element
    num_nodes, num = surface.geometry.dim, len(surface.facets)
    most = library("plane").lib.MOST_DOFS
    if max(num_nodes, element.dim) > most:
        raise InterfaceError(
            f"{surface.name} has degree {max(num_nodes, element.dim) - 1}: contact in the plane "
            f"takes degrees up to {most - 1}."
        )
    check_chains(surface, "contact")
    beside = np.full((len(surface.x), 2), -1)
    beside[surface.facets[:, 1], 0] = beside[surface.facets[:, 0], 1] = np.arange(num)
    return {
        "num_edges": num,
        "num_vertices": len(surface.x),
        "vertices": ints(surface.facets),
        "beside": ints(beside),
        "num_nodes": num_nodes,
        "node_at": doubles(surface.geometry.points),
        "num_dofs": element.dim,
        "num_parts": surface.num_parts,
        "dof_at": doubles(_dofs_on_parts(surface)),
        "turned": None if surface.turned is None else doubles(surface.turned.view(float)),
        "end_dofs": ints(surface.functions(np.array([[0.0], [1.0]])).argmax(axis=2)),
        "dofs": ints(first + side.at_facets),
    }


def own_of(surface: Surface) -> dict[str, Any]:
    """Fields of ``Sigma`` of a surface against itself, undeformed.

    Edges meet those that come before them along their chain, or in a chain before, but for two
    neighbours on either side. Each pair of places counts once, whichever edges slide past. What
    lies behind an edge by more than half of the wall there is the other side of its own body.
    """
    facets, num = surface.facets, len(surface.facets)
    starts, ends = np.full((2, len(surface.x)), -1)
    starts[facets[:, 0]] = ends[facets[:, 1]] = np.arange(num)
    before, behind = ends[facets[:, 0]], starts[facets[:, 1]]
    turn, count = np.full(num, -1), 0
    for first in (*np.flatnonzero(before < 0).tolist(), *range(num)):  # open chains, then rings
        edge = first
        while edge >= 0 and turn[edge] < 0:
            turn[edge], count = count, count + 1
            edge = int(behind[edge])
    own = [np.arange(num)]
    for step in (before, behind):
        own.append(step)
        own.append(np.where(step >= 0, step[step], -1))
    near = np.stack(own, axis=1)
    x = surface.x[facets]
    chord, middle = x[:, 1] - x[:, 0], x.mean(axis=1)
    inward = np.stack((-chord[:, 1], chord[:, 0]), axis=1) / lengths(chord)[:, None]
    to = x[None, :, 0] - middle[:, None]  # (edge, other, 2)
    det = _cross(inward[:, None], chord[None])
    with np.errstate(divide="ignore", invalid="ignore"):
        far, at = _cross(to, chord[None]) / det, _cross(to, inward[:, None]) / det
    behind = far > SLACK * lengths(chord)[:, None]  # nearer it is what touches or overlaps
    walls = np.where(behind & (at >= 0) & (at <= 1), far, np.inf)
    for column in near.T:
        is_one = column >= 0
        walls[is_one, column[is_one]] = np.inf
    return {"turn": ints(turn), "own": ints(near), "depths": doubles(walls.min(axis=1) / 2)}


def _cross(a: npt.NDArray, b: npt.NDArray) -> npt.NDArray:
    """Cross products in the plane."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _dofs_on_parts(surface: Surface) -> npt.NDArray[np.float64]:
    """Reference coordinates of an edge's dofs as seen from its parts, ``(num_parts, num_dofs)``."""
    start, end = surface.on_whole(np.array([[0.0], [1.0]])).swapaxes(0, 1)
    return (surface.element.points[:, 0] - start) / (end - start)


@cache
def _rules(num_nodes: int) -> dict[str, Any]:
    """Fields of ``Sigma`` with the quadrature rules; cached, as Basix is slow here.

    Args:
        num_nodes: Of an edge, an arc's as a parabola's.
    """
    degrees = max(FADING_DEGREE, 3 * num_nodes - 1), 3
    rules = [basix.make_quadrature(basix.CellType.interval, degree) for degree in degrees]
    ends = np.cumsum([len(weights) for _, weights in rules]).tolist()
    points, weights = map(np.concatenate, zip(*rules, strict=True))
    return {"ends_of_rules": ends, "rule_at": doubles(points), "rule_weights": doubles(weights)}


def sigma_of(sides: Sides, itself: bool = False) -> Any:
    """Struct ``Sigma`` without positions, and without room for rays.

    Args:
        sides: Γ0 and Γ1.
        itself: True if both are one surface.
    """
    below, above = sides
    in_c = [side_of(below, 0), side_of(above, len(below.dofs))]
    rules = _rules(max(min(s["num_nodes"], max(s["num_dofs"], 3)) for s in in_c))
    own = own_of(below.reference) if itself else {"turn": None, "own": None, "depths": None}
    shared = [0.5 - SHARED / 2, 0.5 + SHARED / 2]
    factors = {"cosines": list(COSINES), "nearest": list(NEAREST), "slack": SLACK}
    given = {"sides": in_c, "shared": shared, "angle": above.reference.angle}
    return struct("Sigma", **factors, **given, **rules, **own)


def cast(
    unplaced: Any,
    surfaces: tuple[Surface, Surface],
    goes_on: Sequence[tuple[int, int]] = (),
    slides: bool = False,
) -> PlaneRays:
    """Find the rays between two surfaces where they are.

    Args:
        unplaced: From :func:`sigma_of`.
        surfaces: Both where they are.
        goes_on: Edges and ends (0 or 1) of Γ0 beyond which it goes on, as mirrored at a wall.
        slides: True if slips are found with gaps.
    """
    room = points_an_edge * sum(len(surface.facets) for surface in surfaces)
    on = np.zeros((len(surfaces[0].facets), 2), np.int32)
    for edge, end in goes_on:
        on[edge, end] = True
    fields = {"sides": [{"nodes": doubles(s.nodes)} for s in surfaces], "goes_on": on}
    while True:
        points, sheets = np.empty(room, dtype("Point")), np.empty(room, dtype("Sheet"))
        given = {"points": points, "sheets": sheets, "max_points": room, "max_sheets": room}
        sigma = changed(unplaced, "Sigma", **fields, **given)
        check(call("cast_rays", sigma), library("plane").lib.MOST_SHEETS)
        most = max(sigma.num_points, sigma.num_sheets)
        if most <= room:
            return PlaneRays(sigma, points[: sigma.num_points], surfaces[1], slides)
        room = most


class _Entries:
    """A matrix to which C adds entries."""

    def __init__(self, num_rows: int):
        self.first = np.empty(num_rows, np.int32)
        self.enlarge(entries_a_row * num_rows)

    def enlarge(self, room: int):
        """Make room."""
        self.places, self.values = np.empty((3, room), np.int32), np.empty(room)
        rows, columns, following = self.places
        fields = {"rows": rows, "columns": columns, "next": following, "first": self.first}
        self.struct = struct("Entries", max=room, values=self.values, **fields)


@lru_cache(16)
def _entries(num_rows: int, number: int) -> _Entries:
    """Room for a matrix, that of others before: what needs it copies what it found there."""
    return _Entries(num_rows)


def _filled(num_rows: int, num: int, add: Callable) -> list[Sparse]:
    """Matrices to which a function of C added entries, with as much room as they need."""
    matrices = [_entries(num_rows, number) for number in range(num)]
    while True:
        for matrix in matrices:
            matrix.struct.num, matrix.first[:] = 0, -1
        check(add(*(matrix.struct for matrix in matrices)))
        lacking = [each for each in matrices if each.struct.num > each.struct.max]
        if not lacking:
            break
        for matrix in lacking:
            matrix.enlarge(matrix.struct.num)
    found = []
    for matrix in matrices:
        num = matrix.struct.num
        i, j = matrix.places[:2, :num].astype(np.int64)
        found.append(Sparse(i, j, matrix.values[:num].copy()))
    return found
