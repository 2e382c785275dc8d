# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Σ between surfaces that have moved a little: its cells are kept where they can be."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.cells import Hosts
from hypergap_dolfinx.gap.coverage import WHOLE
from hypergap_dolfinx.gap.metric import FLAT, areas
from hypergap_dolfinx.gap.outlines import differing
from hypergap_dolfinx.gap.pieces import Side
from hypergap_dolfinx.gap.slab import SlabCells, curved_margins, fill, mesh_slab, share
from hypergap_dolfinx.gap.slab_cells import Slab
from hypergap_dolfinx.gap.surface import Surface


def moved(surface: Surface, nodes: npt.NDArray[np.float64]) -> Surface:
    """A surface whose facets are elsewhere, in the same order.

    Args:
        surface: Γ_i.
        nodes: Where its geometry nodes are now, ``(num_facets, num_nodes, n)``.
    """
    corners = [dofs[0] for dofs in surface.geometry.entity_dofs[0]]
    x = np.empty_like(surface.x)
    x[surface.facets] = nodes[:, corners]
    return replace(surface, x=x, nodes=nodes)


def update_slab(
    comm: MPI.Comm, gap: SlabCells, surface0: Surface, surface1: Surface
) -> tuple[SlabCells, bool]:
    """Σ between surfaces in space that have moved since it was made. Collective.

    Its cells are kept as long as all of them stay positive; a piece where one turns over is filled
    anew, which takes less than to swap single cells for others. Where outlines no longer match, or
    were cut to match before, all of Σ is made anew. Cells get longer the farther the surfaces
    slide: that is fine within Newton's iterations, but a step that went several facets far should
    end with :func:`~hypergap_dolfinx.gap.slab.mesh_slab`.

    Args:
        comm: Communicator.
        gap: What was made before, by :func:`mesh_slab` or here.
        surface0: Γ0 where it is now, see :func:`moved`.
        surface1: Γ1.

    Returns:
        Σ, and whether any of its cells are others than before.

    Raises:
        InterfaceError: The surfaces no longer face each other, or there is no valid mesh.
        ValueError: They aren't the surfaces that there were.
    """
    surfaces = surface0, surface1
    for slab in gap.slabs:
        for side, surface in zip(slab.sides, surfaces, strict=True):
            if not np.array_equal(side.surface.facets, surface.facets):
                raise ValueError(f"{surface.name} has other facets than when Σ was made.")
    slabs: list[Slab] | None = []
    if comm.rank == 0:
        slabs = _follow(gap.slabs, surfaces)
    if comm.bcast(slabs is None):
        return mesh_slab(comm, *surfaces), True
    assert slabs is not None
    kept = [_is_valid(slab) for slab in slabs]

    def make() -> list[Slab]:
        return [s if good else fill(s.sides) for s, good in zip(slabs, kept, strict=True)]

    rebuilt = comm.bcast(not all(kept))
    return share(comm, surfaces, gap.patch, make), rebuilt


def _follow(slabs, surfaces) -> list[Slab] | None:
    """The same cells between moved pieces; None if the pieces' outlines don't match."""
    found = []
    for slab in slabs:
        sides = []
        for side, surface in zip(slab.sides, surfaces, strict=True):
            whole = np.bincount(side.facets, side.shares)
            if (whole[side.facets] < WHOLE).any():
                return None
            sides.append(_moved_side(side, surface))
        if any(differing(*sides)):
            return None
        hosts = _hosted(slab, sides)
        found.append(Slab((sides[0], sides[1]), slab.cells, hosts, slab.straight, slab.walls))
    return found


def _moved_side(side: Side, surface: Surface) -> Side:
    """A piece of whole facets, where they are now."""
    x = np.empty_like(side.x)
    if side.is_whole:
        x[side.triangles] = surface.x[surface.facets[side.facets]]
    else:
        facets = np.repeat(side.facets, 3)
        x[side.triangles.ravel()] = surface.points(facets, side.X.reshape(-1, 2))
    new = replace(side, surface=surface, x=x)
    new.__dict__["behind"] = side.behind  # who is whose neighbour doesn't change
    return new


def _hosted(slab: Slab, sides) -> Hosts:
    """Hosts of interior vertices: what moved away from one side meets other facets of it."""
    alpha = slab.inner.alpha
    if not alpha.size:
        return slab.inner
    x = replace(slab, sides=tuple(sides)).x[-alpha.size :]
    facets, X = [], []
    for i, side in enumerate(sides):
        triangle, xi = side.project(x, slab.inner.facets[i][0])
        facets.append(triangle[None])
        X.append(xi[None])
    return Hosts(alpha, (facets[0], facets[1]), (X[0], X[1]))


def _is_valid(slab: Slab) -> bool:
    """Whether no cell is flat or turned over, be it somewhere on its curved faces."""
    D, scale = areas(slab.x[slab.cells], slab.alpha[slab.cells], slab.normal)
    if not (D > FLAT * scale).all():
        return False
    curved = any(side.surface.curved[side.facets].any() for side in slab.sides)
    return not curved or bool((curved_margins(slab) > 0).all())
