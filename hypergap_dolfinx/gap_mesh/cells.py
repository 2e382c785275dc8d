# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Cells of Σ as both meshers (`strip`, `slab`) return them, and how much of Γ1 they cover.

:class:`GapCells` holds simplices between two surfaces, the same on every rank; :class:`Hosts` the
positions of their points on Γ0 and Γ1.

:func:`covered_parts` tells how well functions of a facet are known where Σ reaches only a part p of
the facet f:

.. math:: \min_v \int_p v^2 \, dX \Big/ \int_f v^2 \, dX

over the functions v that the facet carries, in its reference coordinates. If this is small, λ
follows from forces of hardly any size, with as many times their round-off. The area alone isn't
enough: for a corner with 30 % of a quadrilateral the minimum is 4e-3 for degree 1 and 2e-5 for
degree 2, for 30 % in a corner of a triangle 3e-2 and 2e-3.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
import numpy.typing as npt

import basix
import basix.ufl
from hypergap_dolfinx.gap_mesh.tetrahedra import straightened
from hypergap_dolfinx.gap_mesh.tolerances import WHOLE_COVERED
from hypergap_dolfinx.surface.trace import Surface, geometry_nodes, tabulate


@dataclass(frozen=True)
class Hosts:
    """Positions of points of Σ on Γ0 and on Γ1.

    A point at α has the displacement (1 − α) u₀ + α u₁, with u_i taken in its host facet on Γ_i.
    """

    alpha: npt.NDArray[np.float64]
    """``(num_cells, num_points)``."""
    facets: tuple[npt.NDArray[np.integer], npt.NDArray[np.integer]]
    """Host facets on both sides, ``(num_cells, num_points)`` each."""
    X: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
    """Reference coordinates in the host facets, ``(num_cells, num_points, n - 1)`` each."""

    def __getitem__(self, cells) -> "Hosts":
        """Hosts of some of the cells."""
        return Hosts(
            self.alpha[cells],
            (self.facets[0][cells], self.facets[1][cells]),
            (self.X[0][cells], self.X[1][cells]),
        )

    @classmethod
    def concatenate(cls, parts: Sequence["Hosts"]) -> "Hosts":
        """Hosts of several groups of cells, concatenated."""

        def side(i, name):
            return np.concatenate([getattr(part, name)[i] for part in parts])

        return cls(
            np.concatenate([part.alpha for part in parts]),
            (side(0, "facets"), side(1, "facets")),
            (side(0, "X"), side(1, "X")),
        )


@dataclass(frozen=True)
class Overhang:
    """Quadrature points in cells for the excess in integrals dΓ_α dα over Σ."""

    cells: npt.NDArray[np.intp]
    """``(num_points,)``."""
    X: npt.NDArray[np.float64]
    """Reference coordinates, ``(num_points, n)``."""
    weights: npt.NDArray[np.float64]
    """``(num_points,)``; negative where the integrals lack something."""
    rims: "Overhang | None" = None
    """The same for integrals over Γ0 and Γ1: points on cell edges in the outlines."""

    def at(self, cells: npt.NDArray[np.intp], num_cells: int) -> "Overhang":
        """The points in some of all cells, with these cells' new numbers."""
        number = np.full(num_cells, -1)
        number[cells] = np.arange(len(cells))
        some = number[self.cells] >= 0
        rims = self.rims and self.rims.at(cells, num_cells)
        return Overhang(number[self.cells[some]], self.X[some], self.weights[some], rims)


@dataclass(frozen=True)
class GapCells:
    """Σ before it is distributed.

    The cells are oriented such that pulling Γ1 away from Γ0 gives them a positive volume.
    """

    x: npt.NDArray[np.float64]
    """Vertex coordinates, ``(num_vertices, n)``."""
    alpha: npt.NDArray[np.float64]
    """α at the vertices, ``(num_vertices,)``."""
    cells: npt.NDArray[np.integer]
    """Vertices of each cell, ``(num_cells, n + 1)``."""
    normals: Callable[[npt.NDArray[np.intp]], npt.NDArray[np.float64]]
    """``normals(cells)``: reference normals from Γ0 to Γ1, ``(num, n)``."""
    rank: npt.NDArray[np.int32]
    """Rank of each cell: the owner of a body's cell beside it, ``(num_cells,)``."""
    patch: npt.NDArray[np.int32]
    """Smooth piece that each facet of Γ1 belongs to, ``(num_facets1,)``.

    λ jumps where two pieces meet, as the traction does at a kink. So the pieces' parts of Σ share
    no vertex there: each has its own, at the same place, and nodes on Γ1 have hosts in their own
    piece."""
    covered: npt.NDArray[np.float64]
    """Part of each facet of Γ1 that Γ0 covers, ``(num_facets1,)``: 1, or less where the facet is
    cut at an end of Γ0, or 0 where it lies beyond."""
    least: npt.NDArray[np.float64]
    """Least share of a function's square in this part, ``(num_facets1,)``; see
    :func:`covered_parts`."""
    degree: int
    """Degree of the φ_a: on simplices they span what both sides have in their facets."""
    hosts: Callable[[npt.NDArray[np.float64], npt.NDArray[np.intp]], Hosts]
    """``hosts(points, cells)``: positions of points of the reference simplex on both surfaces."""
    straight: npt.NDArray[np.bool_] | None = None
    """Mask of the tetrahedra's edges that stay straight, ``(num_cells, 6)``; None if there are
    none."""
    excess: float = 0.0
    """Area by which edges that stay straight enlarge Σ."""
    overhang: Overhang | None = None
    """Excess of Σ over the common part of both sides; None if there is none."""

    def geometry_nodes(
        self, surfaces: Sequence[Surface], points: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Coordinates of the cells' geometry nodes, ``(num_cells, num_points, n)``.

        Args:
            surfaces: Γ0 and Γ1.
            points: Nodes of the reference simplex, ``(num_points, n)``.
        """
        x = interpolate_geometry(surfaces, self.hosts(points, np.arange(len(self.cells))))
        if self.straight is None:
            return x
        return straightened(x, points, self.straight, self.x[self.cells])


def interpolate_geometry(surfaces: Sequence[Surface], hosts: Hosts) -> npt.NDArray[np.float64]:
    """(1 − α) X₀ + α X₁ at each point, ``(num_cells, num_points, n)``."""
    shape = hosts.alpha.shape
    x0, x1 = (
        surface.points(f.ravel(), X.reshape(-1, X.shape[-1])).reshape(*shape, -1)
        for surface, f, X in zip(surfaces, hosts.facets, hosts.X)
    )
    alpha = hosts.alpha[..., None]
    return (1 - alpha) * x0 + alpha * x1


def geometry_element(surfaces: Sequence[Surface], degree: int):
    """Basix' UFL element of Σ's coordinates.

    Args:
        surfaces: Γ0 and Γ1.
        degree: Degree of the φ_a.
    """
    n = surfaces[0].gdim
    cell = {2: "triangle", 3: "tetrahedron"}[n]
    return _lagrange(cell, *geometry_nodes(surfaces, degree), n)


@cache
def _lagrange(cell: str, degree: int, variant: basix.LagrangeVariant, n: int):
    return basix.ufl.element("Lagrange", cell, degree, lagrange_variant=variant, shape=(n,))


def covered_parts(
    surface: Surface,
    facets: npt.NDArray,
    X: npt.NDArray[np.float64],
    shares: npt.NDArray[np.float64],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Cover of a surface's facets by pieces of them.

    Args:
        surface: Γ1.
        facets: Facet of each piece, ``(num_pieces,)``.
        X: Reference coordinates of the pieces' corners in it, ``(num_pieces, n, n - 1)``; edges
            are taken straight.
        shares: Size of each piece over its facet's, ``(num_pieces,)``.

    Returns:
        The covered share of each facet's size, and the least share of the square of a function on
        it, ``(num_facets,)`` each.
    """
    num, dim = len(surface.facets), X.shape[2]
    covered = np.bincount(facets, shares, minlength=num)
    least = np.where(covered < WHOLE_COVERED, 0.0, 1.0)
    cut = np.flatnonzero((covered > 0) & (covered < WHOLE_COVERED))
    number = np.full(num, -1)
    number[cut] = np.arange(len(cut))
    use = np.flatnonzero(number[facets] >= 0)
    if not len(use):
        return covered, least
    element = surface.element
    points, weights, inverse = _rule(element)
    corners = X[use]
    at = corners[:, None, 0] + points @ (corners[:, 1:] - corners[:, :1])
    phi = tabulate(element, at.reshape(-1, dim)).reshape(*at.shape[:2], -1) @ inverse.T
    weighted = (shares[use, None] * weights)[..., None] * phi
    squares = weighted.transpose(0, 2, 1) @ phi
    total = np.zeros((len(cut), *squares.shape[1:]))
    np.add.at(total, number[facets[use]], squares)
    least[cut] = np.maximum(np.linalg.eigvalsh(total)[:, 0], 0.0)
    return covered, least


@lru_cache(maxsize=32)
def _rule(element: basix.finite_element.FiniteElement) -> tuple[npt.NDArray, ...]:
    """Quadrature for squares of functions on a simplex, and their orthonormalisation on the facet.

    Returns:
        Points, weights whose sum is one, and L⁻¹ with L Lᵀ the mean of φ φᵀ over the facet.
    """
    simplices = {1: basix.CellType.interval, 2: basix.CellType.triangle}
    simplex = simplices[element.points.shape[1]]
    # On a triangle, functions of a quadrilateral have twice the degree
    degree = 2 * element.degree * (1 if element.cell_type == simplex else 2)
    points, weights = basix.make_quadrature(simplex, degree)
    x, w = basix.make_quadrature(element.cell_type, 2 * element.degree)
    phi = tabulate(element, x)
    mass = (phi * w[:, None]).T @ phi / w.sum()
    return points, weights / weights.sum(), np.linalg.inv(np.linalg.cholesky(mass))
