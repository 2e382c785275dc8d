# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The constraint ∫∫ ∂u/∂α · λ dΓ_α dα = 0 (eq. 4) as matrices on the bodies' own dofs.

Its multipliers lie at dofs of Γ1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix
from dolfinx import fem
from hypergap_dolfinx.core import collective
from hypergap_dolfinx.core.graph import components
from hypergap_dolfinx.core.sparse import coo_matrix, triplets
from hypergap_dolfinx.gap_mesh.strip import turns
from hypergap_dolfinx.gap_mesh.tolerances import COINCIDE
from hypergap_dolfinx.mortar.domain import GapDomain, interpolation_weights, places_of_dofs
from hypergap_dolfinx.mortar.tolerances import (
    AROUND_FOLLOWED,
    INDEPENDENT_NEIGHBOURS,
    ON_SURFACE,
)
from hypergap_dolfinx.surface.trace import Surface
from hypergap_dolfinx.surface.triangulation import kinks, neighbours


@dataclass(frozen=True)
class Constraint(collective.Owner):
    """One constraint for each multiplier: Σ_i B_i u_i = 0, for each component of u.

    The matrices act on one component (a block of dofs counts as one); see :func:`expand`.
    """

    B: tuple[PETSc.Mat, ...]
    """B₀ and B₁; with free interior nodes also B_Σ. ``(num_multipliers, num_dofs_i)``."""
    R: tuple[PETSc.Mat, ...]
    """R₀ and R₁, the pull-backs to the nodes of Σ: x_a = R₀ u₀ + R₁ u₁, interior nodes
    interpolated. ``(num_nodes, num_dofs_i)``."""
    R_A: PETSc.Mat
    """Pull-back of the multipliers: λ_a = R_A λ. ``(num_nodes, num_multipliers)``."""
    dofs: npt.NDArray[np.int64]
    """Global dof (block) of V₁ under each multiplier, the same on every rank. A dof that several
    patches of Γ1 share has a multiplier in each. They are numbered by their places, so that what is
    chosen in this order depends neither on the meshes' numbering nor on the number of ranks."""
    patch: npt.NDArray[np.int64]
    """Patch of Γ1 under each multiplier."""
    rows: npt.NDArray[np.int64]
    """Row of B of each multiplier."""

    _ticket: collective.Ticket | None = None

    def _release(self) -> list:
        return [*self.B, *self.R, self.R_A]


def create_constraint(
    domain: GapDomain, spaces: tuple[fem.FunctionSpace, fem.FunctionSpace], free_interior: bool
) -> Constraint:
    """Assemble G_ab = ∫∫ ∂φ_a/∂α ∂φ_b/∂α dΓ_α dα and pull it back to the bodies. Collective.

    Args:
        domain: Σ.
        spaces: V₀ and V₁.
        free_interior: True if interior nodes (0 < α < 1) are unknowns with rows of their own, as
            in eq. (22); else they take (1 − α) u₀ + α u₁.

    Returns:
        B_i = R_Aᵀ G R_i. In narrow cells large entries of G would cancel each other in the
        product: there the factors of G = Dᵀ w D are multiplied first, (D R_A)ᵀ w (D R_i).
    """
    comm = domain.comm
    hosts, owned = domain.hosts, domain.owned[1] - domain.owned[0]
    row, first = domain.first_of_nodes()
    alpha = hosts.alpha.ravel()[first]
    interior = (alpha > ON_SURFACE) & (alpha < 1 - ON_SURFACE)
    free = interior & free_interior
    entries: list[tuple] = []
    for surface, facets, X, weight in zip(
        domain.surfaces, hosts.facets, hosts.X, (1 - alpha, alpha), strict=True
    ):
        X = X.reshape(-1, X.shape[-1])[first]
        use = weight > ON_SURFACE
        point, dof, value = interpolation_weights(
            surface, facets.ravel()[first[use]], X[use], weight[use], domain.element
        )
        entries.append((row[use][point], dof, value))
    sizes = [V.dofmap.index_map.size_local for V in spaces]
    R = tuple(coo_matrix(comm, (owned, n), *entry) for n, entry in zip(sizes, entries))
    R_B = list(R)
    if free_interior:
        bound = [np.isin(i, row[~free]) for i, _, _ in entries]
        entries = [tuple(part[keep] for part in e) for e, keep in zip(entries, bound)]
        R_B = [coo_matrix(comm, (owned, n), *entry) for n, entry in zip(sizes, entries)]

    # Multipliers: the dofs of Γ1 that Σ touches, one in each patch of the dof; on each rank, its
    # free interior nodes come after them
    i1, dof1, value1 = entries[1]
    num_patches = int(domain.patch.max()) + 1
    patch_of = domain.patch[hosts.facets[1].ravel()[first]]  # of each owned node
    key = dof1 * num_patches + patch_of[np.searchsorted(row, i1)]
    keys = np.unique(collective.gathered(comm, np.unique(key)))
    dofs, patch = keys // num_patches, keys % num_patches
    ends = np.searchsorted(dofs, domain.surfaces[1].dof_range)
    num_free = np.array(comm.allgather(int(free.sum())))
    offset = np.append(0, np.cumsum(num_free))  # free interior nodes of lower ranks
    rank_of = np.searchsorted(ends[1:], np.arange(len(dofs)), side="right")
    rows = np.arange(len(dofs)) + offset[rank_of]
    r = comm.rank
    num_rows = int(ends[r + 1] - ends[r] + num_free[r])
    own = np.arange(num_free[r])
    i = np.concatenate((i1, row[free]))
    j = np.concatenate((rows[np.searchsorted(keys, key)], ends[r + 1] + offset[r] + own))
    value = np.concatenate((value1, np.ones(num_free[r])))
    R_A = coo_matrix(comm, (owned, num_rows), i, j, value)
    if free_interior:
        entry = (row[free], offset[r] + own, np.ones(num_free[r]))
        R_B.append(coo_matrix(comm, (owned, num_free[r]), *entry))

    G_e, narrow = domain.summable_gap_matrices()
    G = coo_matrix(comm, (owned, owned), *domain.entries(G_e))
    B = []
    for R_i in R_B:
        GR = G.matMult(R_i)
        B.append(R_A.transposeMatMult(GR))
        GR.destroy()
    G.destroy()
    if comm.allreduce(len(narrow)):
        _add_factored(B, R_A, R_B, *domain.gap_factors(narrow), domain.nodes[narrow])
    for R_i in R_B:
        if R_i not in R:
            R_i.destroy()
    order = _by_place(domain.surfaces[1], dofs, patch)
    parts = dofs[order], patch[order], rows[order]
    return Constraint(tuple(B), R, R_A, *parts, collective.enter(comm))


def _by_place(surface: Surface, dofs, patch) -> npt.NDArray[np.intp]:
    """Order of multipliers by the positions of their dofs, then by patch."""
    known, x = places_of_dofs(surface)
    places = x[np.searchsorted(known, dofs)] / (COINCIDE * np.ptp(x, axis=0).max())
    places = np.round(places + 1 / 3)  # nodes of grids aren't amid two numbers
    return np.lexsort((patch, *places.T[::-1]))


def _add_factored(B, R_A: PETSc.Mat, R, D_e, sign, nodes):
    """Add (D R_A)ᵀ w (D R_i) to each B_i. Collective.

    With D_e and w from :meth:`GapDomain.gap_factors`, and the cells' nodes.
    """
    comm = R_A.comm.tompi4py()
    num_points = D_e.shape[0] * D_e.shape[1]
    start = sum(comm.allgather(num_points)[: comm.rank])
    sizes = num_points, R_A.getLocalSize()[0]
    point = np.repeat(start + np.arange(num_points), D_e.shape[2])
    columns = np.repeat(nodes, D_e.shape[1], axis=0)
    D = coo_matrix(comm, sizes, point, columns, D_e)
    signed = coo_matrix(comm, sizes, point, columns, sign[:, None] * D_e)
    DR_A = signed.matMult(R_A)
    for B_i, R_i in zip(B, R, strict=True):
        DR = D.matMult(R_i)
        part = DR_A.transposeMatMult(DR)
        B_i.axpy(1.0, part)
        for matrix in (DR, part):
            matrix.destroy()
    for matrix in (D, signed, DR_A):
        matrix.destroy()


def expand(B: PETSc.Mat, block_size: int, turn: npt.NDArray | None = None) -> PETSc.Mat:
    """B ⊗ R, the same constraint for each component of a rotated field. Collective.

    Args:
        B: Matrix on one component.
        block_size: Number of components; they alternate in the result's rows and columns.
        turn: R, ``(block_size, block_size)``; the identity if not given.

    Returns:
        A new matrix.
    """
    if block_size == 1:
        return B.copy()
    i, j, value = triplets(B)
    row, column = np.nonzero(np.eye(block_size) if turn is None else turn)
    factors = np.ones(block_size) if turn is None else turn[row, column]
    (rows, _), (columns, _) = B.getSizes()
    return coo_matrix(
        B.comm.tompi4py(),
        (rows * block_size, columns * block_size),
        i[:, None] * block_size + row,
        j[:, None] * block_size + column,
        value[:, None] * factors,
    )


@dataclass(frozen=True)
class Multipliers:
    """The multipliers of an interface, the same arrays on every rank."""

    dofs: npt.NDArray[np.int64]
    """Global dof (block) of V₁ under each multiplier, ``(num_multipliers,)``."""
    patch: npt.NDArray[np.int64]
    """Smooth piece of Γ1 under each multiplier, ``(num_multipliers,)``."""
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
        """The multipliers of a constraint on Σ."""
        surface = domain.surfaces[1]
        num_patches = int(domain.patch.max()) + 1
        keys = constraint.dofs * num_patches + constraint.patch
        wanted = surface.dofs * num_patches + domain.patch[:, None]
        order = np.argsort(keys)
        found = np.searchsorted(keys, wanted, sorter=order)
        at = order[np.minimum(found, len(keys) - 1)]  # (facet, dof)
        at[keys[at] != wanted] = -1
        return cls(constraint.dofs, constraint.patch, surface, at, domain.covered, domain.least)

    @cached_property
    def x(self) -> npt.NDArray[np.float64]:
        """Positions of their dofs, ``(num_multipliers, n)``."""
        dofs, x = places_of_dofs(self.surface)
        return x[np.searchsorted(dofs, self.dofs)]

    def on_any(self, facets: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Mask of multipliers on any of some facets, ``(num_multipliers,)``."""
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
        """Facets with a multiplier, and its local index in them."""
        facet, local, offsets = self._inverse
        part = slice(offsets[m], offsets[m + 1])
        return facet[part], local[part]

    def follow(
        self, m: int, drop: npt.NDArray[np.bool_]
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.intp], bool]:
        """λ at a dropped multiplier as Σ weights · λ at others of its patch.

        In its facet λ becomes a polynomial of degree k − 1 through those that remain, so that
        tractions up to that degree are still carried.

        Args:
            m: The dropped multiplier.
            drop: Mask of dropped multipliers, ``(num_multipliers,)``.

        Returns:
            Weights and multipliers, both empty if the patch has none left; and True if these are
            in one of its own facets, or around it.
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
        """Polynomials that λ lacks on narrow pieces, where the remaining multipliers lie on lines.

        Args:
            drop: Mask of dropped multipliers, ``(num_multipliers,)``.

        Returns:
            For each facet there, dropped multipliers and the values at them of a polynomial of
            degree k − 1 that vanishes at all that remain around.
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
        """A remaining multiplier of the same patch, in the facet nearest to a dropped one's."""
        mine = np.where(self.on_facets >= 0, self.patch[self.on_facets] == self.patch[m], False)
        free = mine & ~drop[self.on_facets]
        facets = np.flatnonzero(free.any(axis=1))
        if not len(facets):
            return np.empty(0), np.empty(0, dtype=np.intp)
        centres = self.surface.nodes.mean(axis=1)
        own = centres[self.facets_of(m)[0]].mean(axis=0)
        facet = facets[np.linalg.norm(centres[facets] - own, axis=1).argmin()]
        return np.ones(1), np.sort(self.on_facets[facet][free[facet]])[:1]

    def _fit(self, drop, facets) -> "_Fit | None":
        """Polynomials of degree k − 1 through the multipliers that remain around some facets.

        From as few rings of facets as determine them; None without any multiplier beside these.
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
        """Fit to multipliers at x, ``(num_found, n)``, on the scale of a facet's n − 1 edges."""
        self.found, self._exponents = found, exponents
        self._origin = x.sum(axis=0) / max(len(x), 1)
        # Axes along their line and across it, with the facet's lengths
        plane = np.linalg.svd(edges, full_matrices=False)[2].T
        axes = plane @ np.linalg.svd((x - self._origin) @ plane)[2].T
        self._axes = axes / np.abs(edges @ axes).max(axis=0)
        U, size, V = np.linalg.svd(self._monomials(x))
        self.rank = int((size > INDEPENDENT_NEIGHBOURS).sum())
        """Number of determined polynomials."""
        self._pinv = V[: self.rank].T / size[: self.rank] @ U[:, : self.rank].T
        self._null = V[self.rank :].T

    def _monomials(self, x) -> npt.NDArray[np.float64]:
        along = (x - self._origin) @ self._axes
        return np.prod(along[..., None] ** self._exponents, axis=-2)

    def weights(self, x) -> npt.NDArray[np.float64]:
        """Weights of the values for the polynomial, constant across their line, at a point."""
        return self._monomials(x) @ self._pinv

    def vanishing(self, x) -> npt.NDArray[np.float64]:
        """Values at points of the polynomials that vanish at all of them, ``(num, num_points)``."""
        return (self._monomials(x) @ self._null).T


def _exponents(element: basix.finite_element.FiniteElement) -> npt.NDArray[np.intp]:
    """Exponents of the monomials of degree k − 1, the constant first, ``(dim, num_monomials)``."""
    dim = element.points.shape[1]
    exponents = np.indices((element.degree,) * dim).reshape(dim, -1)
    return exponents[:, exponents.sum(axis=0) < element.degree]


@lru_cache(maxsize=1024)
def _determined(element: basix.finite_element.FiniteElement, free: tuple[bool, ...]) -> bool:
    """True if the free dofs determine a polynomial of degree k − 1."""
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
    """Smooth pieces of surfaces that are parts of one body's boundary.

    Args:
        surfaces: Parts that may touch or share facets; their dofs are one space's.

    Returns:
        For each surface, the piece of each facet, numbered across all surfaces.
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
        own_nodes=np.vstack([s.nodes for s in surfaces])[at],
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
