# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Warnings about a doubtful interface, a line each, with what to do."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.mortar.domain import GapDomain
from hypergap_dolfinx.mortar.tolerances import SAG_CURVED, UNEVEN
from hypergap_dolfinx.surface.tolerances import SAME_NODE
from hypergap_dolfinx.surface.trace import Surface, thinness

Side = tuple[fem.FunctionSpace, npt.ArrayLike]


def doubts(domain: GapDomain, sides: Sequence[Side]) -> list[str]:
    """Doubts about an interface, to be settled before results are trusted. Collective.

    Args:
        domain: Σ.
        sides: Spaces and this rank's facets of Γ0 and Γ1.

    Returns:
        A line for each doubt, the same on every rank.
    """
    found = distance(domain), straight_facets(domain.surfaces), uneven_facets(domain, sides)
    return [line for line in found if line]


def distance(domain: GapDomain) -> str | None:
    """Surfaces far apart: sometimes intended, mostly a wrong tag or a mesh in other units."""
    apart = domain.distance()
    length = max(surface.size.max(initial=0.0) for surface in domain.surfaces)
    if apart <= length:
        return None
    return (
        f"Γ0 and Γ1 are {apart:.3g} apart on average, but their longest facet is {length:.3g}: are "
        "tags and units right? They are tied across the gap."
    )


def straight_facets(surfaces: tuple[Surface, Surface]) -> str | None:
    """Straight facets opposite curved ones, which cost spaces of degree ≥ 2 their order."""
    if max(surface.element.degree for surface in surfaces) == 1:
        return None
    sags = []
    for surface in surfaces:
        # Along the normals: a plane with a curved outline stays one
        bend = surface.nodes - surface.straight_nodes
        sag = np.abs(np.einsum("fmi,fi->fm", bend, surface.normals)).max(axis=1)
        sags.append(np.where(surface.curved, sag, 0))
    curved = [
        bool((sag > SAG_CURVED * s.size).any()) for sag, s in zip(sags, surfaces, strict=True)
    ]
    if all(curved) or not any(curved):
        return None
    i = curved.index(True)
    # An arc's distance from its chord goes with the square of the length
    curvature = (sags[i] / surfaces[i].size ** 2).max()
    off = curvature * surfaces[1 - i].size.max() ** 2
    return (
        f"the facets of {surfaces[i].name} are curved and those of {surfaces[1 - i].name} are "
        f"straight, about {off:.2g} off: that limits the accuracy whatever the spaces' degree; "
        "curve both meshes (in Gmsh gmsh.model.mesh.setOrder(2))."
    )


def _widths(v, w):
    """Facets with vertices v, ``(num, num_vertices, n)``, beside others with vertices w.

    Returns:
        Largest ratio of the other's width to the facet's own, and the latter, ``(num,)`` each.
    """
    n = v.shape[2]
    plane = np.linalg.qr((v[:, 1:n] - v[:, :1]).transpose(0, 2, 1))[0]  # (facet, n, n - 1)

    def spread(x):
        y = (x - x.mean(axis=1, keepdims=True)) @ plane
        return y.transpose(0, 2, 1) @ y / x.shape[1]

    inverse = np.linalg.inv(np.linalg.cholesky(spread(v)))
    squares, U = np.linalg.eigh(inverse @ spread(w) @ inverse.transpose(0, 2, 1))
    direction = np.einsum("sij,si->sj", inverse, U[:, :, -1])
    # Of an edge, a right triangle or a square of width 1
    unit = {2: 1 / 4, 3: 2 / 9, 4: 1 / 4}[v.shape[1]]
    return np.sqrt(squares[:, -1]), 1 / (np.sqrt(unit) * np.linalg.norm(direction, axis=1))


def unevenness(domain: GapDomain, sides: Sequence[Side], i: int) -> float:
    """Ratio by which Γ_i's facets are narrower than the other side's, and than its cells are deep.

    The lesser of both, in the direction in which the facets differ most; a tenth of Γ_i's area has
    a larger one. Collective.
    """
    n = domain.x.shape[2]
    other = domain.surfaces[1 - i]
    depth = thinness(*sides[i]) * float(np.median(domain.surfaces[i].size))
    on = domain.alpha_vertices == i
    apex = domain.alpha_vertices == 1 - i
    base = np.flatnonzero((on.sum(axis=1) == n) & (apex.sum(axis=1) == 1))
    base = base[:: max(1, len(base) // 5000)]  # as many on each rank are enough
    on, apex = on[base], apex[base]
    v = domain.x[base, : n + 1][on].reshape(-1, n, n)
    facet = domain.hosts.facets[1 - i][base, : n + 1][apex]
    E = v[:, 1:] - v[:, :1]
    area = np.sqrt(np.maximum(np.linalg.det(E @ E.transpose(0, 2, 1)), 0))  # times a constant
    # Facets of Γ_i are cut where the sides overlap in part
    surface = domain.surfaces[i]
    X = domain.hosts.X[i][base, : n + 1][on].reshape(-1, n, n - 1)
    whole = np.abs(X - np.rint(X)).max(axis=2) < SAME_NODE  # corners of their facets
    if surface.facets.shape[1] == 4:
        middle = np.abs(X - 0.5).max(axis=2) < SAME_NODE
        whole |= middle
        if middle.any(axis=1).all():  # quarters of quadrilaterals
            own = domain.hosts.facets[i][base, :4][on].reshape(-1, 3)
            v = surface.x[surface.facets[own[np.arange(len(own)), middle.argmax(axis=1)]]]
    some = (area > 0) & whole.all(axis=1)
    v, facet, area = v[some], facet[some], area[some]
    ratio, width = _widths(v, other.x[other.facets[facet]])
    mine = np.column_stack((np.minimum(ratio, depth / width), area))
    value, area = np.concatenate(domain.mesh.comm.allgather(mine)).T
    order = np.argsort(value)
    total = np.cumsum(area[order])
    if not len(total):
        return 0.0
    return float(value[order][np.searchsorted(total, 0.9 * total[-1])])


def uneven_facets(domain: GapDomain, sides: Sequence[Side]) -> str | None:
    """Γ1's nodes between Γ0's are constrained: deep cells respond with large tractions."""
    value = unevenness(domain, sides, 1)
    degrees = [surface.element.degree for surface in domain.surfaces]
    if value <= UNEVEN * degrees[1]:
        return None
    swap = unevenness(domain, sides, 0) <= UNEVEN * degrees[0]
    advice = "swap the tie's sides" if swap else "refine Γ0 that way, or Γ1's cells across Γ1"
    return (
        f"Γ1's facets are {value:.2g} times narrower one way than those of Γ0 and than its own "
        f"cells are deep: λ oscillates, displacements hardly do. To trust λ, {advice}."
    )
