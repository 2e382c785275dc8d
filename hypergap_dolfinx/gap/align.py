# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Matching surfaces that are shifted, turned or stretched by next to nothing: outlines made one.

Cut at their outlines they would have triangles as narrow as that, which no front gets past. Their
triangulations match, so the outlines' nodes are moved to what both have in common, by less than
1e-5 of a facet, and stay hosted in their facets.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.outlines import OFF, Beside
from hypergap_dolfinx.gap.pieces import Side
from hypergap_dolfinx.gap.surface import lengths

CORNER = 0.1
"""Sine of an outline's turn from which it is a corner, where both its edges tell a node's place."""
NEWTON = 4  # steps to a place in a bilinear facet


def are_moved(side0: Side, side1: Side, loops: Beside) -> bool:
    """Whether one affine map takes a loop's nodes to those beside them: noise does not.

    Curved pieces stay as they are: their outlines would also have to be bent alike.

    Args:
        side0: A piece of Γ0.
        side1: The one of Γ1 that faces it.
        loops: A loop of both.
    """
    if any(side.surface.curved[side.facets].any() for side in (side0, side1)):
        return False
    x, y = side0.x[loops[0]], side1.x[loops[1]]
    limit = OFF * lengths(np.roll(x, -1, axis=0) - x)
    apart, normal = y - x, side0.vertex_normals[loops[0]]
    if (lengths(_across(apart, normal)) <= limit).all():
        return False
    terms = np.ones((len(x), 1))
    if len(x) > 4:  # or an affine map could do whatever it is
        middle = x - x.mean(axis=0)
        terms = np.column_stack((terms, middle / np.abs(middle).max()))
    left = apart - terms @ np.linalg.lstsq(terms, apart)[0]
    return bool((lengths(_across(left, normal)) <= limit).all())


def aligned(side0: Side, side1: Side, loops: list[Beside]) -> tuple[Side, Side]:
    """Both pieces with the nodes of some loops at the same places.

    Args:
        side0: A piece of Γ0.
        side1: The one of Γ1 that faces it.
        loops: Loops of both.
    """
    sides = side0.in_halves(), side1.in_halves()
    places = [side.x.copy() for side in sides]
    for loop in loops:
        x = [side.x[nodes] for side, nodes in zip(sides, loop, strict=True)]
        normal = side0.vertex_normals[loop[0]] - side1.vertex_normals[loop[1]]
        normal /= lengths(normal)[:, None]
        common = _common(x[0], x[1], normal)
        for place, own, nodes in zip(places, x, loop, strict=True):
            place[nodes] = own + _across(common - own, normal)
    vertices = zip(*loops, strict=True)
    moved = [
        _with(*part) for part in zip(sides, map(np.concatenate, vertices), places, strict=True)
    ]
    return moved[0], moved[1]


def _common(x0, x1, normal) -> npt.NDArray[np.float64]:
    """Nodes of what lies inside of both of two loops.

    Each edge is where it is farther inside; where the outline goes straight on, its nodes are moved
    to it from the middle between both.

    Args:
        x0: Nodes of a loop, counterclockwise seen against the normals, ``(num_nodes, 3)``.
        x1: The nodes beside them.
        normal: Unit normals.
    """
    middle, half = (x0 + x1) / 2, (x1 - x0) / 2
    edge = np.roll(x0, -1, axis=0) - x0
    inwards = [np.cross(normal, t) for t in (np.roll(edge, 1, axis=0), edge)]
    before, after = (c / lengths(c)[:, None] for c in inwards)
    mean = before + after
    mean /= np.maximum(lengths(mean), 1e-300)[:, None]
    c = np.stack((before, after), axis=1)
    depth = np.abs(np.einsum("nki,ni->nk", c, half))  # of the deeper one of both
    turns = np.abs(np.einsum("ni,ni->n", np.cross(before, after), normal)) > CORNER
    gram = np.einsum("nki,nli->nkl", c, c)
    gram[~turns] = np.eye(2)
    corner = np.einsum("nk,nki->ni", np.linalg.solve(gram, depth[:, :, None])[:, :, 0], c)
    straight = np.abs(np.einsum("ni,ni->n", mean, half))[:, None] * mean
    return middle + np.where(turns[:, None], corner, straight)


def _across(vectors, normal) -> npt.NDArray[np.float64]:
    """What of vectors is across unit normals."""
    return vectors - np.einsum("ni,ni->n", vectors, normal)[:, None] * normal


def _with(side: Side, vertices, places) -> Side:
    """A piece with some vertices elsewhere, and still hosted in the facets that they were in."""
    triangle, corner = np.nonzero(np.isin(side.triangles, vertices))
    xi = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])[corner]
    wanted, geometry = places[side.triangles[triangle, corner]], side.geometry(triangle)
    for _ in range(NEWTON):
        x, dx = geometry(xi)
        metric = dx @ dx.transpose(0, 2, 1)
        off = np.einsum("pji,pi->pj", dx, wanted - x)
        xi = xi + np.linalg.solve(metric, off[:, :, None])[:, :, 0]
    X = side.X.copy()
    X[triangle, corner] = side.in_facets(triangle, xi)
    moved = replace(side, x=places, X=X)
    moved.__dict__["behind"] = side.behind  # who is whose neighbour doesn't change
    return moved
