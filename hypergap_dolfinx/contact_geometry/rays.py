# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Contact's Σ in the plane: fans between Γ1's vertices and what Γ1's rays cut from Γ0.

From the middle of each edge of Γ1 a ray goes along its normal to Γ0. Between two rays Γ0 is the
base of a fan of cells with Γ1's vertex as apex, which has their whole weight; the edge of Γ1 is
the base of a cell with the ray's end as apex, of which the foot is the edge's middle: ∂ψ/∂α is a
half for both its vertices. So weights are never negative, and nothing jumps as nodes pass nodes.

Where Γ0 ends opposite of an edge, the vertex before the end has the fan up to there. That beyond it
has half of the edge's cell, but its pressure is at most :data:`STEEPER` times the other one's: with
L of that limit, multipliers p ≥ 0 stand for the vertices' pressures Lᵀp and the gaps L g. As the
end passes from edge to edge the pressures that are possible change continuously.

It is found in C (``c/rays.c``): what Newton's step of a small problem takes is soon spent on calls
of NumPy with short arrays.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.contact_geometry.order import Order, find_kinks
from hypergap_dolfinx.contact_geometry.tolerances import (
    COMES,
    END,
    FACING_EDGES,
    FARTHER,
    GOES,
    KEPT,
    REACHED,
    ROOM_CELLS,
    STEEPER,
)
from hypergap_dolfinx.core.compiled import call, doubles, dtype, ints, library, struct
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.surface.moving import MovingSurface, Sparse, joined
from hypergap_dolfinx.surface.tolerances import COVERED_SIDE
from hypergap_dolfinx.surface.trace import Surface


@dataclass(frozen=True)
class Fans:
    """Cells of Σ: a base between two places on an edge, and an apex on the other side."""

    cells: npt.NDArray
    """``Cell`` of ``c/plane.h``, ``(num_cells,)``: side of the base, edges of base and apex,
    parameters of the base's start and end and of the apex, and vertices of Γ1 that share the cell,
    half each."""
    whole: npt.NDArray[np.bool_]
    """Edges of Γ1 of which both vertices have a weight, ``(num_edges1,)``."""
    ends: npt.NDArray[np.int32]
    """Vertices of Γ1 beyond an end of Γ0 that have a share, and those before it,
    ``(num_ends, 2)``."""
    cut: npt.NDArray[np.intp]
    """The edges between them, ``(num_ends,)``."""
    order: Order
    """Γ0's."""
    sigma: Any
    """Struct ``Sigma`` of ``c/plane.h``: all this and the sides."""

    def pressures(self, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Lᵀp, pressures of vertices from multipliers, ``(num_vertices1,)`` each."""
        beyond, before = self.ends.T
        result = p.copy()
        np.add.at(result, before, p[beyond] / STEEPER)
        return result

    def limited(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """L of what vertices have, ``(num_vertices1,)``."""
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
    """A side as C sees it, but for where it is.

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
        sides: Γ0 and Γ1, as :func:`side_of` has them.
        surfaces: Where they are.
        last: Those where they were. With a vertex' weight the bodies move a little: that one comes
            and another goes at one place would leave places where neither is right.
        walls: Edges and ends (0 or 1) of Γ1 and of Γ0 that are opposite whatever the rays say: the
            ends at a wall.
        shares: Whether vertices beyond an end of Γ0 have a share.

    Raises:
        InterfaceError: A surface branches.
    """
    num = len(surfaces[1].facets)
    room = ROOM_CELLS * (num + len(surfaces[0].facets))
    crossings = np.empty(3 * num, dtype("Crossing"))
    motions = np.empty((len(crossings), 2 * sum(side["num_dofs"] for side in sides)))
    placed = [
        {**side, "nodes": doubles(surface.nodes)}
        for side, surface in zip(sides, surfaces, strict=True)
    ]
    fields = {"sides": placed, "crossings": crossings, "motions": motions}
    kinks0, kinks1 = (find_kinks(side) for side in placed)
    order = Order.of(surfaces[0], kinks0, last.order if last else None)
    linear = surfaces[1].element.degree == 1
    kept = COVERED_SIDE if linear else KEPT
    beyond = np.full(num, COMES if linear and shares else 1.0)
    if last:
        beyond[last.cut] = GOES
    least = np.where(last.whole, kept, REACHED) if last else np.full(num, REACHED)
    whole, owners = np.empty((2, num), np.int32)
    given = order.chains, ints(kinks1), least, len(walls), ints(walls), END, FACING_EDGES, FARTHER
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
