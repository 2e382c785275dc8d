# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pieces of surfaces in space: triangles of Σ's boundary, each hosted in a facet.

A triangular facet is one triangle. A quadrilateral becomes four triangles that meet at its middle,
with functions of the trace's degree (``quadrilaterals``), or two halves, which need twice the
degree to represent the facet's functions, but may be cut further.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.core.compiled import call, ints
from hypergap_dolfinx.surface.projection import Curves, Triangles
from hypergap_dolfinx.surface.quadrilaterals import HALVES, QUARTERS
from hypergap_dolfinx.surface.search import Tree
from hypergap_dolfinx.surface.tolerances import OUTSIDE
from hypergap_dolfinx.surface.trace import Surface, lengths, unit_normals
from hypergap_dolfinx.surface.triangulation import loops, neighbours

Geometry = Callable[
    [npt.NDArray[np.float64]], tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
]
SOMEWHERE = np.array((0.6130, 0.5023, 0.6098))  # a direction that no mesh has
TRIANGLE_CORNERS = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])  # of the reference triangle
GRADIENTS = np.array([(-1.0, -1.0), (1.0, 0.0), (0.0, 1.0)])  # of its corners' weights


@dataclass(frozen=True)
class Side:
    """A piece of Γ_i: triangles that lie in facets."""

    surface: Surface
    x: npt.NDArray[np.float64]
    """Vertex coordinates, ``(num_vertices, 3)``."""
    triangles: npt.NDArray[np.integer]
    """Vertices, counterclockwise seen from outside of the body, ``(num_triangles, 3)``."""
    facets: npt.NDArray[np.intp]
    """The facet of the surface that hosts each triangle, ``(num_triangles,)``."""
    X: npt.NDArray[np.float64]
    """Reference coordinates of the triangles' corners in it, ``(num_triangles, 3, 2)``."""
    bends: npt.NDArray[np.float64] | None = None
    """Deviation of edges from straight lines in it; None if all are straight.

    ``(num_triangles, 3, num_terms, 2)``: edge k from corner k to the next one m is off by
    λ_k λ_m Σ_j b_kj (λ_m − λ_k)^j, with the weights λ of the corners."""

    @classmethod
    def of(
        cls, surface: Surface, facets: npt.NDArray[np.intp], halves: bool = False, behind=None
    ) -> "Side":
        """The piece made of some whole facets of a surface.

        Args:
            surface: Γ_i.
            facets: Numbers of the facets, rising, ``(num_facets,)``.
            halves: True if quadrilaterals are cut into two triangles, to be cut further, instead of
                four.
            behind: Neighbours of all facets of the surface, if they are known.
        """
        used = np.zeros(len(surface.x), dtype=bool)
        used[surface.facets[facets]] = True
        number = np.cumsum(used, dtype=np.int32) - np.int32(1)
        x, corners = surface.x[used], number[surface.facets[facets]]
        if corners.shape[1] == 3:
            X = np.broadcast_to(TRIANGLE_CORNERS, (len(facets), 3, 2))
            side, normals = cls(surface, x, corners, facets, X), surface.normals
            if len(facets) < len(surface.facets):
                normals = normals[facets]
                if behind is not None:
                    own = np.full(len(surface.facets) + 1, -1, dtype=np.int32)  # and −1 of −1
                    own[facets] = np.arange(len(facets))
                    behind = own[behind[facets]]
            known = {"is_whole": True, "normals": normals}
            if behind is not None:
                known["behind"] = behind
            side.__dict__.update(known)  # values of cached properties
            return side
        places, pieces = HALVES if halves else QUARTERS
        if halves:
            pieces = pieces[_diagonals(x[corners], pieces)]
        else:
            middles = len(x) + np.arange(len(facets))
            x = np.vstack((x, surface.points(facets, np.tile(places[4], (len(facets), 1)))))
            corners = np.column_stack((corners, middles))
            pieces = np.broadcast_to(pieces, (len(facets), *pieces.shape))
        flat = pieces.reshape(len(facets), -1)  # (facet, corner of a triangle)
        return cls(
            surface,
            x,
            np.take_along_axis(corners, flat, axis=1).reshape(-1, 3),
            np.repeat(facets, pieces.shape[1]),
            places[flat].reshape(-1, 3, 2),
        )

    @cached_property
    def uncut(self) -> "Side":
        """The whole facets that host the triangles: narrow triangles are no place to walk."""
        halves = self.surface.facets.shape[1] == 4
        if self.is_whole or (halves and self.degree == self.surface.element.degree):
            return self  # quarters aren't cut
        return Side.of(self.surface, np.unique(self.facets), halves)

    @cached_property
    def _first_uncut(self) -> npt.NDArray[np.intp]:
        """For each triangle, the first of :attr:`uncut` in its facet."""
        return np.searchsorted(self.uncut.facets, self.facets)

    def hosts(self, points, seed) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
        """Facets that points project into, whole ones, and the reference coordinates there.

        Args:
            points: ``(num_points, 3)``.
            seed: Triangle where the search starts, ``(num_points,)``.
        """
        seed = seed if self.uncut is self else self._first_uncut[seed]
        triangle, xi = self.uncut.project(points, seed)
        return self.uncut.facets[triangle], self.uncut.in_facets(triangle, xi)

    def in_halves(self) -> "Side":
        """The whole facets as halves, to be cut; vertices of facets keep their numbers."""
        if self.surface.facets.shape[1] == 3:
            return self
        return Side.of(self.surface, np.unique(self.facets), halves=True)

    @property
    def degree(self) -> int:
        """Degree of functions on the triangles that represent those of the facets."""
        degree = self.surface.element.degree
        if self.surface.facets.shape[1] == 3:
            return degree
        places, pieces = QUARTERS
        quarters = (self.X[:, None] == places[pieces]).all(axis=(2, 3)).any(axis=1)
        return degree if quarters.all() else 2 * degree

    @property
    def arrays(self) -> tuple[npt.NDArray | None, ...]:
        """All attributes but the surface."""
        return self.x, self.triangles, self.facets, self.X, self.bends

    @property
    def shares(self) -> npt.NDArray[np.float64]:
        """Area of each triangle over its facet's, with straight edges, ``(num_triangles,)``."""
        e, f = self.X[:, 1] - self.X[:, 0], self.X[:, 2] - self.X[:, 0]
        facet = self.surface.geometry.cell_type
        whole = 1 if facet == basix.CellType.triangle else 2  # twice the reference facet's area
        return np.abs(e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]) / whole

    @cached_property
    def is_affine(self) -> bool:
        """True if triangles are straight in space: halves of bilinear facets aren't either."""
        if self.surface.facets.shape[1] == 3 or self.degree == self.surface.element.degree:
            return not self.surface.curved[self.facets].any()
        return bool(self.surface.affine[self.facets].all())

    @cached_property
    def is_whole(self) -> bool:
        """True if each triangle is a facet with the same reference coordinates."""
        whole = self.surface.facets.shape[1] == 3 and self.bends is None
        return whole and bool((self.X == TRIANGLE_CORNERS).all())

    @cached_property
    def behind(self) -> npt.NDArray[np.int32]:
        """The triangle behind each edge of each triangle, −1 at the rim, ``(num_triangles, 3)``."""
        return neighbours(self.triangles, self.surface.name, self.x)

    @cached_property
    def normals(self) -> npt.NDArray[np.float64]:
        """Unit normals of the triangles, out of the body, ``(num_triangles, 3)``."""
        return unit_normals(self.x[self.triangles])

    @cached_property
    def vertex_normals(self) -> npt.NDArray[np.float64]:
        """Mean of the triangles' unit normals at the vertices, normalised."""
        corner = self.triangles.ravel()
        total = np.empty_like(self.x)
        for i in range(3):
            each = np.repeat(self.normals[:, i], 3)
            total[:, i] = np.bincount(corner, each, minlength=len(total))
        return total / np.maximum(lengths(total), 1e-300)[:, None]

    def inner_edges(self, number: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
        """Inner edges: ends q, r, the vertex p on the left, s on the right, ``(num_edges, 4)``.

        Args:
            number: Numbers of the vertices in the result, ``(num_vertices,)``.
        """
        edges = np.empty((np.count_nonzero(self.behind >= 0) // 2, 4), dtype=np.int32)
        call("inner_edges", len(self.triangles), ints(self.triangles), self.behind, number, edges)
        return edges

    @cached_property
    def tree(self) -> Tree:
        """Search tree of the triangles."""
        return Tree(self.x[self.triangles], self.normals)

    @cached_property
    def _walks(self) -> Triangles:
        return Triangles(self.x, self.triangles, self.behind)

    @cached_property
    def _curves(self) -> Curves:
        nodes = self.surface.nodes_of(self.facets)
        return Curves(self.surface.geometry, nodes, self.X, self.bends, self.vertex_normals)

    def loops(self) -> list[npt.NDArray[np.intp]]:
        """Boundary loops."""
        return list(self._loops)

    @cached_property
    def _loops(self) -> list[npt.NDArray[np.intp]]:
        return loops(self.triangles, self.behind, self.surface.name, self.x)

    def project(self, points, seed) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
        """Triangles that points project into, and the reference coordinates there.

        Args:
            points: ``(num_points, 3)``.
            seed: Triangle where the search starts, ``(num_points,)``.
        """
        curves = None if self.is_affine else self._curves
        triangle, xi = self._walks.project(points, seed, curves)
        out = np.flatnonzero(np.minimum(xi.min(axis=1), 1 - xi.sum(axis=1)) < -OUTSIDE)
        if len(out):  # the walk may have ended at a notch of the outline
            below = self._below(points[out], triangle[out], xi[out])
            other = below != triangle[out]
            out, below = out[other], below[other]
            triangle[out], xi[out] = self._walks.project(points[out], below, curves)
        return triangle, xi

    def _below(self, points, triangle, xi) -> npt.NDArray[np.intp]:
        """Triangles below points if nearer than the given ones, else the given ones."""
        found = triangle.copy()
        weights = np.maximum(np.column_stack((1 - xi.sum(axis=1), xi)), 0)
        weights /= weights.sum(axis=1, keepdims=True)
        away = lengths(np.einsum("pk,pki->pi", weights, self.x[self.triangles[triangle]]) - points)
        p, f = self.tree.beside(points, self.normals[triangle])
        v, n = self.x[self.triangles[f]] - points[p, None], self.normals[f]
        height = np.abs(np.einsum("pi,pi->p", v[:, 0], n))
        sides = [np.einsum("pi,pi->p", np.cross(v[:, k], v[:, k - 2]), n) for k in range(3)]
        size = np.sum(sides, axis=0)  # twice the area
        use = (np.min(sides, axis=0) >= -1e-9 * size) & (height < away[p])
        order = np.flatnonzero(use)[np.argsort(-height[use], kind="stable")]
        found[p[order]] = f[order]  # the nearest comes last
        return found

    def on_curved(self, triangle, points, xi) -> npt.NDArray[np.float64]:
        """Projection of points on the curved facets, continuous from one facet to the next."""
        return self._walks.on_curved(triangle, points, xi, self._curves)

    def geometry(self, triangle: npt.NDArray[np.integer]) -> Geometry:
        """Map of reference coordinates in triangles, ``(num_points, 2)``, to the curved surface.

        It returns places, ``(num_points, 3)``, and derivatives, ``(num_points, 2, 3)``.
        """
        nodes, tabulate = (
            self.surface.nodes_of(self.facets[triangle]),
            self.surface.geometry.tabulate,
        )

        def geometry(xi):
            values = tabulate(1, self.in_facets(triangle, xi))[..., 0]
            x = values.transpose(1, 0, 2) @ nodes  # and its derivatives
            dx = x[:, 1:]
            return x[:, 0], dx if self.is_whole else self.slopes(triangle, xi) @ dx

        return geometry

    def in_facets(self, triangle, xi) -> npt.NDArray[np.float64]:
        """Coordinates in the host facets of points xi of triangles, ``(num_points, 2)``."""
        if self.is_whole:
            return np.array(xi)
        X = self.X[triangle]
        places = X[:, 0] + np.einsum("pj,pji->pi", xi, X[:, 1:] - X[:, :1])
        return places if self.bends is None else places + bent(self.bends[triangle], xi)[0]

    def slopes(self, triangle, xi) -> npt.NDArray[np.float64]:
        """Derivatives of :meth:`in_facets` by both of xi, ``(num_points, 2, 2)``."""
        X = self.X[triangle]
        straight = X[:, 1:] - X[:, :1]  # (point, ξ_j, X_i)
        return straight if self.bends is None else straight + bent(self.bends[triangle], xi)[1]

    def points(self, triangle, xi) -> npt.NDArray[np.float64]:
        """Coordinates of reference points of triangles on the (curved) surface."""
        return self.surface.points(self.facets[triangle], self.in_facets(triangle, xi))


def _diagonals(x: npt.NDArray[np.float64], halves: npt.NDArray) -> npt.NDArray[np.intp]:
    """Diagonals along which quadrilaterals are cut.

    Matching ones are cut along the same diagonal, whatever corner they begin at, and none at a
    corner of 180°, where one half would have no area.

    Args:
        x: Corners, ``(num, 4, 3)``.
        halves: Two triangles for each diagonal, ``(2, 2, 3)``.

    Returns:
        0 or 1, ``(num,)``.
    """
    cut, every = np.isin((x @ SOMEWHERE).argmax(axis=1), (1, 2)).astype(int), np.arange(len(x))
    a, b, c = np.moveaxis(x[:, halves], 3, 0)  # (facet, diagonal, half, 3)
    least = np.linalg.norm(np.cross(b - a, c - a), axis=3).min(axis=2)
    return np.where(2 * least[every, cut] < least[every, 1 - cut], 1 - cut, cut)


def bent(bends, xi) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Offset of points in triangles with bent edges, ``(num_points, 2)``, and its slopes by xi.

    Args:
        bends: As of :class:`Side`, ``(num_points, 3, num_terms, 2)``.
        xi: Reference coordinates, ``(num_points, 2)``.
    """
    off, slopes = np.zeros((len(xi), 2)), np.zeros((len(xi), 2, 2))
    some = np.flatnonzero(bends.any(axis=(1, 2, 3)))
    weights = np.column_stack((1 - xi[some].sum(axis=1), xi[some]))
    for k in range(3):
        m = (k + 1) % 3
        both, apart = weights[:, k] * weights[:, m], weights[:, m] - weights[:, k]
        d_both = weights[:, [k]] * GRADIENTS[m] + weights[:, [m]] * GRADIENTS[k]  # (point, ξ_j)
        d_apart = GRADIENTS[m] - GRADIENTS[k]
        for j in range(bends.shape[2]):
            b, power = bends[some, k, j], apart**j
            off[some] += (both * power)[:, None] * b
            d_power = j * apart ** max(j - 1, 0)
            slope = power[:, None] * d_both + (both * d_power)[:, None] * d_apart
            slopes[some] += slope[:, :, None] * b[:, None]
    return off, slopes
