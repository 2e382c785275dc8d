# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The weighted gap and slip of fans in the plane, and their derivatives. No MPI, no PETSc.

A cell between a piece of an edge, :math:`\mathbf x(s)` from :math:`s_1` to :math:`s_2`, and an apex
:math:`\mathbf q(r)` on the other side has the volume

.. math:: g = \tfrac12 \int_{s_1}^{s_2} (\mathbf q - \mathbf x) \times \mathbf x' \,ds,

which is a polynomial of the edge's nodes, the apex' nodes and the parameters. Those move with the
bodies where rays cross edges; their derivatives follow from :math:`\Phi = 0` there. A motion of
points on both, :math:`\Delta\mathbf u`, has in the cell the slip

.. math:: \tfrac12 \int_{s_1}^{s_2} \mathbf x'\cdot\Bigl(\Delta\mathbf u(\mathbf q)
   - \Delta\mathbf u(s) - \tau\,\Delta\mathbf u'(s)\Bigr) ds, \qquad
   \tau = \frac{(\mathbf q - \mathbf x)\cdot\mathbf x'}{\mathbf x'\cdot\mathbf x'},

the motion of the apex along the edge's tangent against that of the edge below it. It is zero for
a translation, the cell's volume for a rotation, and zero if :math:`\Delta\mathbf u` is the
position: with :math:`\Delta\mathbf u = \mathbf x - \mathbf x_n` slip is that of material points
that are opposite to each other now, and a rotation of closed bodies, however large, is none.

It is all computed in C (``c/fans.c``, ``c/by_dofs.c``).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_geometry.rays import Fans
from hypergap_dolfinx.core.compiled import call, doubles, struct
from hypergap_dolfinx.surface.moving import Sparse

entries_a_row = 32  # room at first: 6 to 30; with more they are found anew


@dataclass(frozen=True)
class PlaneGaps:
    """Weighted gaps, and the cells they are sums of."""

    volumes: npt.NDArray[np.float64]
    """Volumes of cells, ``(num_cells,)``."""
    areas: npt.NDArray[np.float64]
    """Areas of cells, likewise."""
    x: npt.NDArray[np.float64]
    """Both ends of cells' bases and their apexes, ``(num_cells, 3, 2)``."""
    sizes: npt.NDArray[np.float64]
    """Sums of areas at vertices, ``(num_vertices1,)``."""
    g: npt.NDArray[np.float64]
    """L of sums of volumes, likewise."""
    m: npt.NDArray[np.float64]
    """L of the sizes."""
    C: Sparse
    """∂g/∂u, by both sides' dofs, Γ1's behind all of Γ0's."""


def find_gaps(fans: Fans) -> PlaneGaps:
    """Weighted gaps where the sides are."""
    num, num_vertices = len(fans.cells), fans.sigma.sides[1].num_vertices
    volumes, areas = np.empty((2, num))
    x, (g, sizes) = np.empty((num, 3, 2)), np.empty((2, num_vertices))
    given = fans.sigma, volumes, areas, x, g, sizes
    C = _entries(fans, False, lambda C: call("find_gaps", *given, C))
    limited = fans.limited(g), fans.limited(sizes), fans.limited_rows(C)
    return PlaneGaps(volumes, areas, x, sizes, *limited)


def gap_curvature(fans: Fans, p: npt.NDArray[np.float64]) -> Sparse:
    """Σ_a p_a ∂²g_a/∂u².

    Args:
        fans: Cells where the sides are.
        p: ``(num_vertices1,)``.
    """
    given = fans.sigma, doubles(fans.pressures(p))

    def add(H):
        slopes = np.zeros(fans.sigma.num_crossings)
        call("gap_curvature", *given, slopes, H)

    return _entries(fans, True, add)


def find_slips(fans: Fans, moved: npt.NDArray[np.float64] | None = None) -> Sparse:
    """T with the weighted slips s = T Δu, as C; ∂s/∂u if Δu moves with u.

    Args:
        fans: Cells where the sides are.
        moved: Δu by both sides' dofs, all components, if it moves with u.
    """
    given = fans.sigma, None if moved is None else doubles(moved)
    return _entries(fans, False, lambda T: call("find_slips", *given, T))


def slip_curvature(fans: Fans, q: npt.NDArray[np.float64]) -> Sparse:
    """Σ_a ∂(q_a T_a)/∂u; it isn't symmetric.

    Args:
        fans: Cells where the sides are.
        q: ``(num_vertices1,)``.
    """
    given = fans.sigma, doubles(q)
    return _entries(fans, True, lambda H: call("slip_curvature", *given, H))


def _entries(fans: Fans, square: bool, add: Callable) -> Sparse:
    """A matrix to which C adds entries.

    Args:
        fans: Cells where the sides are.
        square: True if rows are those of dofs instead of Γ1's vertices.
        add: Function that adds them.
    """
    sides = fans.sigma.sides
    num_rows = sides[1].num_vertices
    if square:
        num_rows = 2 * sum(side.num_edges * side.num_dofs for side in sides)
    room = entries_a_row * num_rows
    while True:
        rows, columns, following = places = np.empty((3, room), np.int32)
        values, first = np.empty(room), np.full(num_rows, -1, np.int32)
        fields = {"rows": rows, "columns": columns, "next": following, "first": first}
        entries = struct("Entries", max=room, values=values, **fields)
        add(entries)
        if entries.num <= room:
            i, j, _ = places[:, : entries.num].astype(np.int64)
            return Sparse(i, j, values[: entries.num])
        room = entries.num
