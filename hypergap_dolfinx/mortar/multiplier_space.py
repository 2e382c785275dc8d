# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Where the multipliers of an interface lie on Γ1, and what λ is where some have to go.

A dof without a multiplier has the λ that its neighbours have there: in its facet λ becomes a
polynomial of degree k − 1, so that tractions up to that degree are still carried.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.core.graph import components
from hypergap_dolfinx.gap_mesh.strip import turns
from hypergap_dolfinx.mortar.constraint import Constraint
from hypergap_dolfinx.mortar.domain import GapDomain
from hypergap_dolfinx.mortar.tolerances import AROUND_FOLLOWED, INDEPENDENT_NEIGHBOURS
from hypergap_dolfinx.surface.trace import Surface
from hypergap_dolfinx.surface.triangulation import kinks, neighbours


@dataclass(frozen=True)
class Multipliers:
    """The multipliers of an interface, the same arrays on every rank."""

    dofs: npt.NDArray[np.int64]
    """Global dof (block) of V₁ under each, ``(num_multipliers,)``."""
    patch: npt.NDArray[np.int64]
    """Smooth piece of Γ1 that each belongs to, ``(num_multipliers,)``."""
    surface: Surface
    """Γ1."""
    on_facets: npt.NDArray[np.intp]
    """Multiplier at each dof of each facet of Γ1, −1 where Σ doesn't reach,
    ``(num_facets, num_dofs)``."""
    covered: npt.NDArray[np.float64]
    """Part of each facet of Γ1 that Γ0 covers, ``(num_facets,)``."""
    least: npt.NDArray[np.float64]
    """Least share of a function's square that this part has, ``(num_facets,)``."""

    @classmethod
    def of(cls, constraint: Constraint, domain: GapDomain) -> "Multipliers":
        """Those of a constraint on Σ."""
        surface = domain.surfaces[1]
        num_patches = int(domain.patch.max()) + 1
        keys = constraint.dofs * num_patches + constraint.patch
        wanted = surface.dofs * num_patches + domain.patch[:, None]
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)  # (facet, dof)
        at[keys[at] != wanted] = -1
        return cls(constraint.dofs, constraint.patch, surface, at, domain.covered, domain.least)

    @cached_property
    def x(self) -> npt.NDArray[np.float64]:
        """Where their dofs lie, ``(num_multipliers, n)``."""
        dofs, first = np.unique(self.surface.dofs, return_index=True)
        facet, local = np.divmod(first, self.surface.dofs.shape[1])
        x = self.surface.points(facet, self.surface.element.points[local])
        return x[np.searchsorted(dofs, self.dofs)]

    def on_any(self, facets: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Which of them lie on any of some facets, ``(num_multipliers,)``."""
        on = np.zeros(len(self.dofs), dtype=bool)
        some = self.on_facets[facets]
        on[some[some >= 0]] = True
        return on

    @cached_property
    def _inverse(self):
        facet, local = np.nonzero(self.on_facets >= 0)
        value = self.on_facets[facet, local]
        order = np.argsort(value, kind="stable")
        offsets = np.searchsorted(value[order], np.arange(len(self.dofs) + 1))
        return facet[order], local[order], offsets

    def facets_of(self, m: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """The facets that have a multiplier, and its place in them."""
        facet, local, offsets = self._inverse
        part = slice(offsets[m], offsets[m + 1])
        return facet[part], local[part]

    def follow(
        self, m: int, drop: npt.NDArray[np.bool_]
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.intp], bool]:
        """What λ is at a dropped multiplier: Σ weights · λ at others of its patch.

        Args:
            m: The dropped one.
            drop: Which are dropped, ``(num_multipliers,)``.

        Returns:
            Weights and multipliers, both empty if the patch has none left; and whether they are
            in one of its own facets, or around these.
        """
        facets, local = self.facets_of(m)
        at = self.on_facets[facets]
        free = (at >= 0) & ~drop[at]  # (facet, dof)
        best = int(free.sum(axis=1).argmax())
        element = self.surface.element
        if _determined(element, tuple(free[best])):
            weights = _extension(element, int(local[best]), tuple(free[best]))
            return weights, at[best][free[best]], True
        fit = self._fit(drop, facets)  # a corner: most of the facet's dofs are dropped
        if fit is None:
            return *self._nearest(drop, m), False
        return fit.weights(self.x[m]), fit.found, True

    def lacking(self, drop: npt.NDArray[np.bool_]) -> list[tuple[npt.NDArray, npt.NDArray]]:
        """What λ lacks at dropped ones where a piece is narrow: those that remain lie on lines.

        Args:
            drop: Which are dropped, ``(num_multipliers,)``.

        Returns:
            For each facet there, multipliers and the values of a polynomial of degree k − 1 at
            them that vanishes at all that remain around.
        """
        found, exist = [], self.on_facets >= 0
        gone, left = exist & drop[self.on_facets], exist & ~drop[self.on_facets]
        beside = (exist & self.on_any(left.any(axis=1))[self.on_facets]).any(axis=1)
        for facet in np.flatnonzero(gone.any(axis=1) & beside):
            if _determined(self.surface.element, tuple(left[facet])):
                continue
            fit = self._fit(drop, np.array([facet]))
            if fit is not None:
                at = self.on_facets[facet][gone[facet]]
                found += [(at, values) for values in fit.vanishing(self.x[at])]
        return found

    def _nearest(self, drop, m: int):
        """The remaining multiplier of the same patch in the facet nearest to a dropped one's."""
        mine = np.where(self.on_facets >= 0, self.patch[self.on_facets] == self.patch[m], False)
        free = mine & ~drop[self.on_facets]
        facets = np.flatnonzero(free.any(axis=1))
        if not len(facets):
            return np.empty(0), np.empty(0, dtype=np.intp)
        centres = self.surface.nodes.mean(axis=1)
        own = centres[self.facets_of(m)[0]].mean(axis=0)
        facet = facets[np.linalg.norm(centres[facets] - own, axis=1).argmin()]
        return np.ones(1), self.on_facets[facet][free[facet]][:1]

    def _fit(self, drop, facets) -> "_Fit | None":
        """Polynomials of degree k − 1 through the multipliers that remain around some facets.

        In as few rings as determine them, if any do; None without any beside the facets.
        """
        v = self.surface.x[self.surface.facets[facets[0]]]
        exponents, fits = _exponents(self.surface.element), []
        for _ in range(AROUND_FOLLOWED):
            known = self.on_facets[facets]
            facets = np.flatnonzero(np.isin(self.on_facets, known[known >= 0]).any(axis=1))
            known = self.on_facets[facets]
            known = np.unique(known[(known >= 0) & ~drop[known]])
            fits.append(_Fit(known, self.x[known], v[1:3] - v[0], exponents))
            if fits[-1].rank == exponents.shape[1]:
                return fits[-1]
        return max(fits, key=lambda fit: fit.rank) if fits[0].rank else None


class _Fit:
    """Polynomials of degree k − 1 through the values at some multipliers."""

    def __init__(self, found, x, edges, exponents):
        """Set up.

        Args:
            found: The multipliers.
            x: Where they lie, ``(num_found, n)``.
            edges: Two of a facet, or the one there is, ``(n - 1, n)``.
            exponents: Of the monomials, ``(n - 1, num_monomials)``.
        """
        self.found, self._exponents = found, exponents
        self._origin = x.sum(axis=0) / max(len(x), 1)
        # Along a line that they lie on, and across it, with the facet's lengths
        plane = np.linalg.svd(edges, full_matrices=False)[2].T
        axes = plane @ np.linalg.svd((x - self._origin) @ plane)[2].T
        self._axes = axes / np.abs(edges @ axes).max(axis=0)
        U, size, V = np.linalg.svd(self._monomials(x))
        self.rank = int((size > INDEPENDENT_NEIGHBOURS).sum())
        """As many polynomials are determined."""
        self._pinv = V[: self.rank].T / size[: self.rank] @ U[:, : self.rank].T
        self._null = V[self.rank :].T

    def _monomials(self, x) -> npt.NDArray[np.float64]:
        along = (x - self._origin) @ self._axes
        return np.prod(along[..., None] ** self._exponents, axis=-2)

    def weights(self, x) -> npt.NDArray[np.float64]:
        """Of the values, for that at a point of the polynomial that is even across their line."""
        return self._monomials(x) @ self._pinv

    def vanishing(self, x) -> npt.NDArray[np.float64]:
        """Values at points of the polynomials that vanish where they lie, ``(num, num_points)``."""
        return (self._monomials(x) @ self._null).T


def _exponents(element: basix.finite_element.FiniteElement) -> npt.NDArray[np.intp]:
    """Exponents of the monomials of degree k − 1, the constant first, ``(dim, num_monomials)``."""
    dim = element.points.shape[1]
    exponents = np.indices((element.degree,) * dim).reshape(dim, -1)
    return exponents[:, exponents.sum(axis=0) < element.degree]


@lru_cache(maxsize=1024)
def _determined(element: basix.finite_element.FiniteElement, free: tuple[bool, ...]) -> bool:
    """Whether a polynomial of degree k − 1 follows from the dofs that are free."""
    P = np.prod(element.points[:, :, None] ** _exponents(element), axis=1)
    where = np.asarray(free)
    return bool(where.any() and np.linalg.matrix_rank(P[where]) == P.shape[1])


@lru_cache(maxsize=1024)
def _extension(
    element: basix.finite_element.FiniteElement, local: int, free: tuple[bool, ...]
) -> npt.NDArray[np.float64]:
    """Weights of a facet's free dofs that extend a polynomial of degree k − 1 to another dof."""
    P = np.prod(element.points[:, :, None] ** _exponents(element), axis=1)  # (dof, monomial)
    return P[local] @ np.linalg.pinv(P[np.asarray(free)])


def smooth_pieces(surfaces: Sequence[Surface]) -> list[npt.NDArray[np.int32]]:
    """The smooth piece that facets belong to, of surfaces that are parts of one body's boundary.

    Args:
        surfaces: Parts that may touch or share facets; their dofs are one space's.

    Returns:
        For each surface, the piece of each facet: the same number where one piece goes on.
    """
    first = surfaces[0]
    starts = np.cumsum([0, *(len(s.facets) for s in surfaces)])
    dofs = np.vstack([s.dofs for s in surfaces])
    corner = [d[0] for d in first.element.entity_dofs[0]]
    _, at, facet = np.unique(np.sort(dofs, axis=1), axis=0, return_index=True, return_inverse=True)
    vertices = np.vstack([s.x[s.facets] for s in surfaces])[at]  # (facet, vertex, n)
    dofs = dofs[at]
    key, where, number = np.unique(dofs[:, corner], return_index=True, return_inverse=True)
    union = replace(
        first,
        x=vertices.reshape(-1, first.gdim)[where],
        facets=number.reshape(-1, len(corner)).astype(np.int32),
        nodes=np.vstack([s.nodes for s in surfaces])[at],
        dofs=dofs,
        owner=np.concatenate([s.owner for s in surfaces])[at],
    )
    if first.gdim == 2:
        corners = turns(union)[1]
        before = np.full(len(key), -1)
        before[union.facets[:, 1]] = np.arange(len(union.facets))
        start = union.facets[:, 0]
        joined = (before[start] >= 0) & ~corners[start]
        i, j = np.flatnonzero(joined), before[start[joined]]
    else:
        behind = neighbours(union.polygons, union.name, union.x)
        apart = np.zeros(behind.shape, dtype=bool)
        apart[kinks(union, behind)] = True
        f, k = np.nonzero((behind > np.arange(len(behind))[:, None]) & ~apart)
        i, j = f, behind[f, k]
    piece = components(len(union.facets), i, j)[facet.ravel()]
    return np.split(piece, starts[1:-1])
