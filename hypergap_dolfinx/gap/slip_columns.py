# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""The weighted slip of columns in space, and its derivatives. NumPy alone.

At a point of Γ1 and the one opposite (:mod:`~hypergap_dolfinx.gap.heights`) what moves has a slip

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

from hypergap_dolfinx.gap.heights import At, Rays, dot
from hypergap_dolfinx.gap.opposite import Frames, cross
from hypergap_dolfinx.gap.surface import Surface, lengths


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
    first = along - dot(along, normal)[:, None] * normal
    first /= np.maximum(lengths(first), 1e-300)[:, None]
    return np.stack((first, cross(normal, first)), axis=1)


def _across(rays: Rays) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
    """The normals' directions, their lengths, and κ; ``(num, 3)``, ``(num,)``, ``(num,)``."""
    _, n1, m = rays.normals
    size = lengths(m)
    m = m / size[:, None]
    return m, size, dot(n1, m)


def slips(rays: Rays, T, e) -> npt.NDArray[np.float64]:
    """What points make of motions of dofs.

    Args:
        rays: The points.
        T: Derivatives of q by the dofs, ``(num, 7, num_dofs)``.
        e: A direction each, ``(num, 3)``.

    Returns:
        ``(num, num_dofs, 3)``.
    """
    m, _, kappa = _across(rays)
    e = kappa[:, None] * (e - dot(e, m)[:, None] * m)
    return -T[:, At.R, :, None] * e[:, None]


def by_q(rays: Rays, e, D) -> npt.NDArray[np.float64]:
    """Derivatives of κ e · P D by q while D stays, ``(num, 7, 3)``.

    Args:
        rays: The points.
        e: A direction each, ``(num, 3)``.
        D: Another, ``(num, 3)``.
    """
    m, size, kappa = _across(rays)
    _, n1, _ = rays.normals
    up, down = dot(e, m)[:, None], dot(D, m)[:, None]
    value = dot(e, D)[:, None] - up * down
    by_m = value * n1 - kappa[:, None] * (down * e + up * D)
    by_m = (by_m - dot(by_m, m)[:, None] * m) / size[:, None]
    by_n1 = value * m
    q, result = rays.q, np.zeros_like(rays.q)
    result[:, At.C1], result[:, At.C2] = cross(q[:, At.C2], by_m), cross(by_m, q[:, At.C1])
    result[:, At.T1], result[:, At.T2] = cross(q[:, At.T2], by_n1), cross(by_n1, q[:, At.T1])
    return result


def motions(T, moves) -> npt.NDArray[np.float64]:
    """What moves of x₀ − x₁, and of Γ0's tangents, ``(num, 3, 3)``.

    Args:
        T: Derivatives of q by the dofs, ``(num, 7, num_dofs)``.
        moves: Motions of the dofs, ``(num, num_dofs, 3)``.
    """
    return T[:, : At.Z2 + 1] @ moves


def slopes(rays: Rays, T, e, moves) -> npt.NDArray[np.float64]:
    """Derivatives of slips by the dofs, of motions that are those of where the dofs are.

    Args:
        rays: The points.
        T: Derivatives of q by the dofs, ``(num, 7, num_dofs)``.
        e: A direction each, ``(num, 3)``.
        moves: What :func:`motions` makes of them.

    Returns:
        ``(num, num_dofs, 3)``.
    """
    m, _, kappa = _across(rays)
    flat = kappa[:, None] * (e - dot(e, m)[:, None] * m)
    by = by_q(rays, e, -moves[:, At.R])
    drift = np.einsum("pi,pki->pk", flat, moves[:, At.Z1 :])
    by -= np.einsum("pk,pkvi->pvi", drift, rays.feet)
    return T.transpose(0, 2, 1) @ by + slips(rays, T, e)


def curvature(rays: Rays, T, traction) -> npt.NDArray[np.float64]:
    """Derivatives by the dofs of the forces that tractions have there.

    Args:
        rays: The points.
        T: Derivatives of q by the dofs, ``(num, 7, num_dofs)``.
        traction: On Γ1, before it is projected, ``(num, 3)``.

    Returns:
        ``(num, num_dofs, 3, num_dofs, 3)``.
    """
    m, _, kappa = _across(rays)
    flat = kappa[:, None] * (traction - dot(traction, m)[:, None] * m)
    turned = T.transpose(0, 2, 1)
    num, nodes, _ = turned.shape
    by = [by_q(rays, traction, np.tile(unit, (num, 1))) for unit in np.eye(3)]
    by_dofs = turned @ np.concatenate(by, axis=2)  # (point, dof, component of force and dof)
    by_dofs = by_dofs.reshape(num, nodes, 3, 3).transpose(0, 2, 1, 3)
    block = -T[:, At.R, :, None, None, None] * by_dofs[:, None]
    drift = turned[:, None] @ rays.feet  # (point, along, dof, component)
    along = np.einsum("pkj,pkbc->pjbc", T[:, [At.Z1, At.Z2]], drift)
    return block - flat[:, None, :, None, None] * along[:, :, None]
