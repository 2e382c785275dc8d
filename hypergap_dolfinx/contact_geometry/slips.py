# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""The weighted slip of columns in space, and its derivatives.

A point of Γ1 and the one opposite (:mod:`~hypergap_dolfinx.contact_geometry.heights`) that move
have a slip

.. math:: \kappa\,\mathbf e_k\cdot\mathbf P\mathbf D, \qquad
   \mathbf D = \Delta\mathbf u_1(X) - \Delta\mathbf u_0(\xi), \qquad
   \kappa = \mathbf N_1\cdot\hat{\mathbf M},

with P across the facet's normal :math:`\hat{\mathbf M}`, and two directions :math:`\mathbf e_k` for
each vertex of Γ1. As :math:`\mathbf x_0 - \mathbf x_1` is along the normal, it is nothing if
:math:`\Delta\mathbf u` is where the bodies are: with :math:`\Delta\mathbf u = \mathbf x -
\mathbf x_n` a rotation of closed bodies, however large, is no slip.
"""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_geometry.heights import Rays
from hypergap_dolfinx.contact_geometry.opposite import Frames, cross
from hypergap_dolfinx.core.compiled import call, doubles, ints
from hypergap_dolfinx.surface.trace import Surface, lengths


def directions(surface: Surface, frames: Frames) -> npt.NDArray[np.float64]:
    """Two directions at each vertex, across the mean normal, that turn with the surface.

    Args:
        surface: Γ1 where it is.
        frames: Its facets'.

    Returns:
        Of length 1, ``(num_vertices, 2, 3)``.
    """
    normal, along = np.zeros((2, len(surface.x), 3))
    after = np.roll(surface.polygons, -1, axis=1)
    for k in range(surface.polygons.shape[1]):
        np.add.at(normal, surface.polygons[:, k], frames.normal)
        # Of the facets around a vertex the last one's edge
        along[surface.polygons[:, k]] = surface.x[after[:, k]] - surface.x[surface.polygons[:, k]]
    normal /= np.maximum(lengths(normal), 1e-300)[:, None]
    first = along - np.einsum("vi,vi->v", along, normal)[:, None] * normal
    first /= np.maximum(lengths(first), 1e-300)[:, None]
    return np.stack((first, cross(normal, first)), axis=1)


def slips(rays: Rays, block, e, moves=None) -> npt.NDArray[np.float64]:
    """What points make of motions, as vectors that are multiplied with those of q.

    Args:
        rays: The points.
        block: The number of each point's pair of facets, ``(num,)``.
        e: A direction each, ``(num, 3)``.
        moves: Motions of the pairs' dofs, ``(num_pairs, num_dofs, 3)``: then derivatives by q of
            slips, of motions that are those of where the dofs are.

    Returns:
        ``(num, 7, 3)``.
    """
    result = np.empty_like(rays.q)
    given = ints(block), doubles(e), None if moves is None else doubles(moves)
    call("column_slips", rays.pointer, *given, result)
    return result


def add_curvatures(rays: Rays, block, traction, blocks):
    """Add derivatives by the dofs of the forces that tractions have at points.

    Args:
        rays: The points.
        block: The number of each one's block, ``(num,)``.
        traction: On Γ1, before it is projected, ``(num, 3)``.
        blocks: ``(num_blocks, num_dofs, num_dofs, 3, 3)``.
    """
    call("slip_curvatures", rays.pointer, ints(block), doubles(traction), blocks)
