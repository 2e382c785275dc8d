# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact segments in the plane: fans between Γ1's vertices and the parts that rays cut from Γ0.

From the middle of each edge of Γ1 a ray goes along its normal to Γ0. The part of Γ0 between two
neighbouring rays is the base of a fan of cells; their apex is the vertex of Γ1 between the rays,
which gets their whole weight. Each edge of Γ1 is also the base of a cell whose apex is the ray's
end on Γ0; half its weight goes to each vertex of the edge, since the ray starts at the middle. So
weights are never negative, and they are continuous as nodes pass nodes.

**A vertex of Γ1 beyond the end of Γ0.** Where Γ0 ends opposite an edge of Γ1, the fan of the vertex
before the end reaches as far as the end. The weight of the vertex beyond the end depends on the
part of the edge that Γ0 covers. Each limit has two values, so that a vertex doesn't come and go at
one place:

1. Whole: the covered part exceeds :data:`REACHED`; if the edge was whole at the last displacements,
   :data:`COVERED_SIDE` (degree 1) or :data:`KEPT` (degree 2) suffices. Both vertices have a half of
   its cell and fans of their own.
2. Share: the covered part exceeds :data:`COMES` (:data:`GOES` if the vertex had a share); only for
   degree 1 with ``shares``, and if the vertex is opposite nothing else. The vertex beyond has half
   of the edge's cell, and its pressure is at most :data:`STEEPER` times that of the vertex before.
   The matrix L expresses this limit: with multipliers p ≥ 0 the vertices' pressures are Lᵀp and the
   gaps conjugate to p are L g. As the end passes from edge to edge the possible pressures change
   continuously.
3. Otherwise nothing: its weight is zero, and the vertex before has all of the edge's cell.

Ends of both sides at a wall, such as one of symmetry, count as opposite, whatever the rays meet.

The cells are computed in C (``c/rays.c``): NumPy calls on short arrays would take as long as a
Newton step of a small problem.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.contact_geometry.tolerances import (
    COMES,
    END,
    FACING,
    FARTHER,
    GOES,
    KEPT,
    KINK_ORDER,
    REACHED,
    STEEPER,
)
from hypergap_dolfinx.core.compiled import call, doubles, dtype, ints, library, struct
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.gap_mesh.strip import chains
from hypergap_dolfinx.surface.moving import MovingSurface, Sparse, joined
from hypergap_dolfinx.surface.tolerances import COVERED_SIDE
from hypergap_dolfinx.surface.trace import Surface

cells_an_edge = 3  # room at first: mostly 1; with more they are found anew


@dataclass(frozen=True)
class Order:
    """A surface's facets one after the other, in chains that end at kinks.

    They are the same until kinks change.
    """

    kinks: npt.NDArray[np.bool_]
    """Mask of the vertices at kinks, ``(num_vertices,)``."""
    chains: Any
    """Struct ``Chains`` of ``c/plane.h``."""

    @classmethod
    def of(
        cls, surface: Surface, kinks: npt.NDArray[np.bool_], last: "Order | None" = None
    ) -> "Order":
        """The order of a surface where it is, the last one if that still holds.

        Raises:
            InterfaceError: It branches.
        """
        if last is not None and np.array_equal(kinks, last.kinks):
            return last
        found = chains(surface, kinks)
        edges = np.concatenate([part.facets for part in found])
        count = np.array([len(part.facets) for part in found])
        start = np.cumsum(count) - count
        chain, position = np.empty_like(edges), np.empty_like(edges)
        chain[edges] = np.repeat(np.arange(len(found)), count)
        position[edges] = np.arange(len(edges)) - np.repeat(start, count)
        arrays = {
            "edges": edges,
            "start": start,
            "count": count,
            "closed": np.array([part.closed for part in found]),
            "chain": chain,
            "position": position,
        }
        arrays = {name: ints(array) for name, array in arrays.items()}
        return cls(kinks, struct("Chains", num=len(found), **arrays))


def _find_kinks(side: dict[str, Any]) -> npt.NDArray[np.bool_]:
    """Mask of vertices where a side turns too far to go on, ``(num_vertices,)``."""
    kinks = np.empty(side["num_vertices"], np.int32)
    call("kinks_of", struct("Side", **side), KINK_ORDER, kinks)
    return kinks > 0


@dataclass(frozen=True)
class Fans:
    """Cells of Σ: a base between two places on an edge, and an apex on the other side."""

    cells: npt.NDArray
    """``Cell`` of ``c/plane.h``, ``(num_cells,)``: side of the base, edges of base and apex,
    parameters of the base's start and end and of the apex, and vertices of Γ1 that share the cell,
    half each."""
    whole: npt.NDArray[np.bool_]
    """Mask of edges of Γ1 both of whose vertices have a weight, ``(num_edges1,)``."""
    ends: npt.NDArray[np.int32]
    """Vertices of Γ1 beyond an end of Γ0 that have a share, and those before it,
    ``(num_ends, 2)``."""
    cut: npt.NDArray[np.intp]
    """The edges between them, ``(num_ends,)``."""
    order: Order
    """Order of Γ0's facets."""
    sigma: Any
    """Struct ``Sigma`` of ``c/plane.h``: all this and both sides."""

    def pressures(self, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Lᵀp, pressures of vertices from multipliers, ``(num_vertices1,)`` each."""
        beyond, before = self.ends.T
        result = p.copy()
        np.add.at(result, before, p[beyond] / STEEPER)
        return result

    def limited(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """L of values at vertices, ``(num_vertices1,)``."""
        beyond, before = self.ends.T
        result = values.copy()
        np.add.at(result, beyond, values[before] / STEEPER)
        return result

    def limited_rows(self, rows: Sparse) -> Sparse:
        """L of vertices' rows."""
        parts = [rows]
        for beyond, before in self.ends.tolist():
            on = np.flatnonzero(rows.i == before)
            i = np.full_like(on, beyond)
            parts.append(Sparse(i, rows.j[on], rows.values[on] / STEEPER))
        return joined(*parts)


def side_of(side: MovingSurface, first: int) -> dict[str, Any]:
    """A side as C sees it, without its position.

    Args:
        side: Γ0 or Γ1.
        first: Number of its first dof.

    Raises:
        InterfaceError: Its degree is too high.
    """
    surface, element = side.rest, side.reference.element
    num_nodes, num = surface.geometry.dim, len(surface.facets)
    most = library("plane").lib.MOST_DOFS
    if max(num_nodes, element.dim) > most:
        raise InterfaceError(
            f"{surface.name} has degree {max(num_nodes, element.dim) - 1}: contact in the plane "
            f"takes degrees up to {most - 1}."
        )
    beside = np.full((len(surface.x), 2), -1)
    beside[surface.facets[:, 1], 0] = beside[surface.facets[:, 0], 1] = np.arange(num)
    # Exact for volumes, and for slips along straight edges
    points, weights = basix.make_quadrature(
        basix.CellType.interval, max(2 * num_nodes - 2, 3 * num_nodes - 5)
    )
    return {
        "num_edges": num,
        "num_vertices": len(surface.x),
        "vertices": ints(surface.facets),
        "beside": ints(beside),
        "num_nodes": num_nodes,
        "node_at": doubles(surface.geometry.points),
        "num_dofs": element.dim,
        "dof_at": doubles(element.points),
        "dofs": ints(first + side.at_facets),
        "num_points": len(weights),
        "points": doubles(points),
        "weights": doubles(weights),
    }


def cast(
    sides: Sequence[dict[str, Any]],
    surfaces: tuple[Surface, Surface],
    last: Fans | None = None,
    walls: Sequence[tuple[int, int, int, int]] = (),
    *,
    shares: bool = False,
) -> Fans:
    """Find Σ's cells between two surfaces where they are.

    Args:
        sides: Γ0 and Γ1, from :func:`side_of`.
        surfaces: The same where they are.
        last: Cells at the last displacements, for which vertices had a weight.
        walls: Edges and ends (0 or 1) of Γ1 and of Γ0 that are opposite at a wall, whatever rays
            meet.
        shares: True if vertices beyond an end of Γ0 may have a share.

    Raises:
        InterfaceError: A surface branches.
    """
    num = len(surfaces[1].facets)
    room = cells_an_edge * (num + len(surfaces[0].facets))
    crossings = np.empty(3 * num, dtype("Crossing"))
    motions = np.empty((len(crossings), 2 * sum(side["num_dofs"] for side in sides)))
    placed = [
        {**side, "nodes": doubles(surface.nodes)}
        for side, surface in zip(sides, surfaces, strict=True)
    ]
    fields = {"sides": placed, "crossings": crossings, "motions": motions}
    kinks0, kinks1 = (_find_kinks(side) for side in placed)
    order = Order.of(surfaces[0], kinks0, last.order if last else None)
    linear = surfaces[1].element.degree == 1
    kept = COVERED_SIDE if linear else KEPT
    beyond = np.full(num, COMES if linear and shares else 1.0)
    if last:
        beyond[last.cut] = GOES
    least = np.where(last.whole, kept, REACHED) if last else np.full(num, REACHED)
    whole, owners = np.empty((2, num), np.int32)
    given = order.chains, ints(kinks1), least, len(walls), ints(walls), END, FACING, FARTHER
    while True:
        cells = np.empty(room, dtype("Cell"))
        sigma = struct("Sigma", **fields, cells=cells, max_cells=room)
        if call("cast_rays", sigma, *given, beyond, whole, owners):
            raise MemoryError("no memory for the cells of the gap domain")
        if sigma.num_cells <= room:
            break
        room = sigma.num_cells
    call("find_crossings", sigma)
    cut = np.flatnonzero(owners >= 0)
    before = surfaces[1].facets[cut, owners[cut]]
    ends = np.stack((surfaces[1].facets[cut, 1 - owners[cut]], before), axis=1)
    return Fans(cells[: sigma.num_cells], whole > 0, ends, cut, order, sigma)
