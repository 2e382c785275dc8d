# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Projection of points on triangulated surfaces in space, straight or curved."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.core.compiled import call, doubles, ints, struct
from hypergap_dolfinx.surface.tolerances import FURTHER_WALK, NEWTON_PROJECTION


@dataclass(frozen=True)
class Curves:
    """Triangles in curved facets."""

    element: basix.finite_element.FiniteElement
    """Lagrange element of the facets' geometry."""
    nodes: npt.NDArray[np.float64]
    """Its nodes in the facet of each triangle, ``(num_triangles, num_nodes, 3)``."""
    X: npt.NDArray[np.float64]
    """Reference coordinates of the triangles' corners in it, ``(num_triangles, 3, 2)``."""
    bends: npt.NDArray[np.float64] | None
    """Deviation of edges from straight lines, as in
    :class:`~hypergap_dolfinx.surface.pieces.Side`."""
    normals: npt.NDArray[np.float64]
    """Unit normals at the vertices, ``(num_vertices, 3)``."""

    @cached_property
    def pointer(self):
        """Struct ``Curves`` of ``c/surface.h``."""
        powers, to_terms = terms(self.element)
        first = self.nodes[:, :1]
        factors = to_terms @ (self.nodes - first)
        bends = np.empty((0, 3, 0, 2)) if self.bends is None else self.bends
        return struct(
            "Curves",
            num_terms=len(powers),
            num_bends=bends.shape[2],
            powers=ints(powers),
            nodes=doubles(np.concatenate((first, factors), axis=1)),
            corners=doubles(self.X),
            bends=doubles(bends),
            normals=doubles(self.normals),
            steps=NEWTON_PROJECTION,
            further=FURTHER_WALK,
        )


class Triangles:
    """Triangles of a surface with their neighbours, to find points in them."""

    def __init__(self, x: npt.NDArray, triangles: npt.NDArray, behind: npt.NDArray):
        """By vertex coordinates, vertices of each triangle, and its neighbours."""
        self._x, self._triangles, self._behind = doubles(x), ints(triangles), ints(behind)

    def project(self, points, seed, curves: Curves | None = None):
        """Walk from a triangle to the one that each point projects into.

        Beyond a boundary the last triangle is extrapolated. A second walk over curved triangles
        starts where the one over straight triangles ends.

        Args:
            points: Points, ``(num_points, 3)``.
            seed: Triangle where the walk starts, ``(num_points,)``.
            curves: Geometry of curved triangles.

        Returns:
            Triangle and reference coordinates in it, ``(num_points,)`` and ``(num_points, 2)``.
        """
        found, X = np.array(seed, dtype=np.int32), np.zeros((len(points), 2))
        given = len(points), doubles(points), self._x, self._triangles, self._behind
        call("project", *given, curves.pointer if curves else None, found, X)
        return found.astype(np.intp), X

    def on_curved(self, triangle, points, X, curves: Curves) -> npt.NDArray[np.float64]:
        """Projection on curved triangles along interpolated vertex normals, by Newton's method.

        Unlike the facets' normals these are continuous, and so is the projection. Starting values
        X, ``(num_points, 2)``, are kept where it doesn't converge.
        """
        X = np.array(X, dtype=float, order="C")
        given = len(points), doubles(points), self._x, self._triangles, curves.pointer
        call("project_on_curved", *given, ints(triangle), X)
        return X


def terms(
    element: basix.finite_element.FiniteElement, origin=(0.0, 0.0)
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Monomials of an element around an origin, and coefficients of its basis functions.

    Returns:
        Powers of both coordinates, ``(num_terms, 2)``, and ``(num_terms, num_nodes)``.
    """
    degree = element.degree
    powers = np.array([(i, j) for i in range(degree + 1) for j in range(degree + 1)])
    if element.cell_type == basix.CellType.triangle:
        powers = powers[powers.sum(axis=1) <= degree]
    values = ((element.points - origin)[:, None] ** powers).prod(axis=2)  # (node, term)
    return powers, np.linalg.inv(values)
