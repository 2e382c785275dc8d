# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Projection of points on triangulated surfaces in space, straight or curved."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.core.compiled import as_ints, library
from hypergap_dolfinx.surface.polynomials import terms
from hypergap_dolfinx.surface.tolerances import FURTHER_WALK, NEWTON_PROJECTION


def _as_doubles(array: npt.NDArray):
    return library().ffi.from_buffer("double[]", np.ascontiguousarray(array, dtype=float))


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
        """The struct for C, and the arrays that it points to."""
        powers, to_terms = terms(self.element)
        first = self.nodes[:, :1]
        factors = to_terms @ (self.nodes - first)
        bends = np.empty((0, 3, 0, 2)) if self.bends is None else self.bends
        fields = {
            "num_terms": len(powers),
            "num_bends": bends.shape[2],
            "powers": as_ints(powers),
            "nodes": _as_doubles(np.concatenate((first, factors), axis=1)),
            "corners": _as_doubles(self.X),
            "bends": _as_doubles(bends),
            "normals": _as_doubles(self.normals),
            "steps": NEWTON_PROJECTION,
            "further": FURTHER_WALK,
        }
        return library().ffi.new("Curves *", fields), fields


class Triangles:
    """Triangles of a surface with their neighbours, to find points in them."""

    def __init__(self, x: npt.NDArray, triangles: npt.NDArray, behind: npt.NDArray):
        """From vertex coordinates, and the vertices and neighbours of each triangle."""
        self._x, self._triangles = _as_doubles(x), as_ints(triangles)
        self._behind = as_ints(behind)

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
        ffi, lib = library().ffi, library().lib
        found, X = np.array(seed, dtype=np.int32), np.zeros((len(points), 2))
        lib.project(
            len(points),
            _as_doubles(points),
            self._x,
            self._triangles,
            self._behind,
            curves.pointer[0] if curves else ffi.NULL,
            ffi.from_buffer("int[]", found),
            ffi.from_buffer("double[]", X),
        )
        return found.astype(np.intp), X

    def on_curved(self, triangle, points, X, curves: Curves) -> npt.NDArray[np.float64]:
        """Projection on curved triangles along interpolated vertex normals, by Newton's method.

        Unlike the facets' normals these are continuous, and so is the projection. Starting values
        X, ``(num_points, 2)``, are kept where it doesn't converge.
        """
        ffi, X = library().ffi, np.array(X, dtype=float)
        library().lib.project_on_curved(
            len(points),
            _as_doubles(points),
            self._x,
            self._triangles,
            curves.pointer[0],
            as_ints(triangle),
            ffi.from_buffer("double[]", X),
        )
        return X
