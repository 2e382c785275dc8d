# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The constraint ∫∫ ∂u/∂α · λ dΓ_α dα = 0 (eq. 4) as matrices on the bodies' own dofs."""

from dataclasses import dataclass
from functools import lru_cache

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix
from dolfinx import fem
from hypergap_dolfinx import compat
from hypergap_dolfinx.gap.domain import GapDomain, interpolation_weights
from hypergap_dolfinx.gap.surface import Surface


@dataclass(frozen=True)
class Constraint:
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
    """Global dof (block) of V₁ under each multiplier, sorted, the same on every rank. A dof that
    several patches of Γ1 share has a multiplier in each."""
    patch: npt.NDArray[np.int64]
    """Patch of Γ1 that each multiplier belongs to."""
    rows: npt.NDArray[np.int64]
    """Row of B of each multiplier."""

    def destroy(self):
        """Destroy the PETSc matrices. Collective."""
        for matrix in (*self.B, *self.R, self.R_A):
            matrix.destroy()


def coo_matrix(comm: MPI.Comm, sizes, i, j, values) -> PETSc.Mat:
    """An AIJ matrix from (row, column, value) triplets, which are added up. Collective.

    Args:
        comm: Communicator.
        sizes: Local numbers of rows and columns.
        i: Global rows, on any rank.
        j: Global columns.
        values: Values.

    Returns:
        The assembled matrix.
    """
    rows, columns = sizes
    A = PETSc.Mat().create(comm)
    A.setSizes(((rows, None), (columns, None)))
    A.setType(PETSc.Mat.Type.AIJ)
    values = np.ascontiguousarray(values, dtype=PETSc.ScalarType)
    compat.set_triplets(A, np.ravel(i), np.ravel(j), values.ravel())
    return A


def create_constraint(
    domain: GapDomain, spaces: tuple[fem.FunctionSpace, fem.FunctionSpace], free_interior: bool
) -> Constraint:
    """Assemble G_ab = ∫∫ ∂φ_a/∂α ∂φ_b/∂α dΓ_α dα and pull it back to the bodies. Collective.

    Args:
        domain: Σ.
        spaces: V₀ and V₁.
        free_interior: Whether interior nodes (0 < α < 1) are unknowns with rows of their own, as
            in eq. (22), or take (1 − α) u₀ + α u₁.

    Returns:
        B_i = R_Aᵀ G R_i.
    """
    comm = domain.mesh.comm
    dofmap, hosts = domain.space.dofmap, domain.hosts
    index_map = dofmap.index_map
    cell_dofs = dofmap.list
    owned = index_map.size_local

    # Each node of Σ once, on the rank that owns it
    node, first = np.unique(cell_dofs.ravel(), return_index=True)
    node, first = node[node < owned], first[node < owned]
    row = node + index_map.local_range[0]
    alpha = hosts.alpha.ravel()[first]
    interior = (alpha > 1e-10) & (alpha < 1 - 1e-10)
    free = interior & free_interior
    entries: list[tuple] = []
    for surface, facets, X, weight in zip(
        domain.surfaces, hosts.facets, hosts.X, (1 - alpha, alpha), strict=True
    ):
        X = X.reshape(-1, X.shape[-1])[first]
        use = weight > 1e-10
        point, dof, value = interpolation_weights(
            surface, facets.ravel()[first[use]], X[use], weight[use]
        )
        entries.append((row[use][point], dof, value))
    sizes = [V.dofmap.index_map.size_local for V in spaces]
    R = tuple(coo_matrix(comm, (owned, n), *entry) for n, entry in zip(sizes, entries))
    R_B = list(R)
    if free_interior:
        bound = [np.isin(i, row[~free]) for i, _, _ in entries]
        entries = [tuple(part[keep] for part in e) for e, keep in zip(entries, bound)]
        R_B = [coo_matrix(comm, (owned, n), *entry) for n, entry in zip(sizes, entries)]

    # Multipliers: the dofs of Γ1 that Σ touches, in each patch; then the rank's free interior nodes
    i1, dof1, value1 = entries[1]
    num_patches = int(domain.patch.max()) + 1
    patch_of = domain.patch[hosts.facets[1].ravel()[first]]  # of each owned node
    key = dof1 * num_patches + patch_of[np.searchsorted(row, i1)]
    keys = np.unique(np.concatenate(comm.allgather(np.unique(key))))
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

    global_dofs = index_map.local_to_global(cell_dofs.ravel()).reshape(cell_dofs.shape)
    G_e = domain.gap_matrices()
    rows_e = np.broadcast_to(global_dofs[:, :, None], G_e.shape)
    columns_e = np.broadcast_to(global_dofs[:, None, :], G_e.shape)
    G = coo_matrix(comm, (owned, owned), rows_e, columns_e, G_e)
    B = []
    for R_i in R_B:
        GR = G.matMult(R_i)
        B.append(R_A.transposeMatMult(GR))
        GR.destroy()
        if R_i not in R:
            R_i.destroy()
    G.destroy()
    return Constraint(tuple(B), R, R_A, dofs, patch, rows)


def expand(B: PETSc.Mat, block_size: int) -> PETSc.Mat:
    """B ⊗ I: the same constraint for each component. Collective.

    Args:
        B: Matrix on one component.
        block_size: Number of components; they alternate in the result's rows and columns.

    Returns:
        A new matrix.
    """
    if block_size == 1:
        return B.copy()
    i, j, value = triplets(B)
    component = np.arange(block_size)
    (rows, _), (columns, _) = B.getSizes()
    return coo_matrix(
        B.comm.tompi4py(),
        (rows * block_size, columns * block_size),
        i[:, None] * block_size + component,
        j[:, None] * block_size + component,
        np.repeat(value, block_size),
    )


def triplets(B: PETSc.Mat) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
    """Global rows, global columns and values of this rank's rows."""
    start, end = B.getOwnershipRange()
    indptr, columns, values = B.getValuesCSR()
    return np.repeat(np.arange(start, end), np.diff(indptr)), columns, values


@dataclass(frozen=True)
class Replaced:
    """Multipliers of a patch that others take the place of."""

    component: int
    """Component of the displacement."""
    multipliers: npt.NDArray[np.intp]
    """Numbers of the patch's multipliers, ``(num_multipliers,)``; the first ``num_new`` of them
    lend their rows to the new ones."""
    weights: npt.NDArray[np.float64]
    """λ at the patch's dofs for each new multiplier, ``(num_multipliers, num_new)``."""
    complete: bool
    """Whether the new ones constrain all that the patch's own would."""


@dataclass(frozen=True)
class Dropped:
    """The multipliers of a tie that are dropped."""

    dropped: npt.NDArray[np.bool_]
    """Which components, ``(num_multipliers, block_size)``, the same on every rank."""
    prescribed: npt.NDArray[np.bool_]
    """Which components of their dofs are prescribed, of the same shape."""
    replaced: list[Replaced]
    """Patches that have other multipliers instead."""


def independent_rows(
    constraint: Constraint, domain: GapDomain, what: Dropped
) -> tuple[PETSc.Mat | None, npt.NDArray[np.int64]]:
    """The multipliers that remain when some are dropped, and what λ is at those. Collective.

    There λ follows its neighbours: in its facet it becomes a polynomial of degree k − 1, so that
    tractions up to that degree are still carried, and may jump from patch to patch.

    Args:
        constraint: The constraint.
        domain: Σ.
        what: What is dropped.

    Returns:
        E with λ = E λ', λ' the multipliers that remain, or None if all do; and the rows (of the
        blocked B) that have no multiplier in reach, because everything there is prescribed.
    """
    drop, prescribed = what.dropped, what.prescribed
    surface = domain.surfaces[1]
    nothing = np.empty(0, dtype=np.int64)
    if not drop.any():
        return None, nothing
    comm = constraint.R_A.comm.tompi4py()
    block_size = prescribed.shape[1]
    start, end = (block_size * r for r in constraint.R_A.getOwnershipRangeColumn())
    row = constraint.rows[:, None] * block_size + np.arange(block_size)  # (multiplier, component)

    # Multiplier at each dof of each facet, −1 where Σ doesn't reach
    num_patches = int(domain.patch.max()) + 1
    keys = constraint.dofs * num_patches + constraint.patch
    wanted = surface.dofs * num_patches + domain.patch[:, None]
    multiplier = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)  # (facet, dof)
    multiplier[keys[multiplier] != wanted] = -1

    dropped = np.sort(row[drop])

    def kept(rows):
        """Number of a row among those that remain."""
        return rows - np.searchsorted(dropped, rows)

    # Patches with other multipliers instead
    i, j, value = [], [], []
    elsewhere, complete = np.zeros_like(drop), np.zeros_like(drop)
    for patch in what.replaced:
        at = row[patch.multipliers, patch.component]
        elsewhere[patch.multipliers, patch.component] = True
        complete[patch.multipliers, patch.component] = patch.complete
        own = np.flatnonzero((start <= at) & (at < end))
        new = patch.weights.shape[1]
        i.append(np.repeat(at[own], new))
        j.append(np.tile(kept(at[:new]), len(own)))
        value.append(patch.weights[own].ravel())

    mine = np.arange(start, end)
    num_kept = len(mine) - np.isin(mine, dropped).sum()
    mine = np.setdiff1d(mine, np.concatenate((dropped, row[elsewhere])))
    i.append(mine)
    j.append(kept(mine))
    value.append(np.ones(len(mine)))
    lost = []
    facets_of = _inverse(multiplier, len(keys))
    here = (start <= row) & (row < end)
    for m, component in np.argwhere(elsewhere & ~complete & here):
        facets, _ = facets_of(m)
        if prescribed[multiplier[facets], component].all():
            lost.append(row[m, component])
    for m, component in np.argwhere(drop & ~elsewhere & here):
        facets, local = facets_of(m)
        free = (multiplier[facets] >= 0) & ~drop[multiplier[facets], component]  # (facet, dof)
        best = free.sum(axis=1).argmax()
        around = None
        if not _determined(surface.element, tuple(free[best])):
            around = _from_around(surface, multiplier, drop[:, component], facets, local)
        if around is not None:  # a corner: most of the facet's dofs are dropped
            weights, neighbours = around
        elif free[best].any():
            weights = _extension(surface.element, int(local[best]), tuple(free[best]))
            neighbours = multiplier[facets[best]][free[best]]
        else:
            weights, neighbours = _nearest(surface, domain, multiplier, drop[:, component], m)
            if prescribed[multiplier[facets], component].all():
                lost.append(row[m, component])
        i.append(np.full(len(neighbours), row[m, component]))
        j.append(kept(row[neighbours, component]))
        value.append(weights)
    sizes = (end - start, num_kept)
    E = coo_matrix(comm, sizes, *(np.concatenate(part) for part in (i, j, value)))
    return E, np.array(lost, dtype=np.int64)


def _inverse(multiplier, num_multipliers: int):
    """A lookup of the facets that have a multiplier, and its place in them."""
    facet, local = np.nonzero(multiplier >= 0)
    value = multiplier[facet, local]
    order = np.argsort(value, kind="stable")
    offsets = np.searchsorted(value[order], np.arange(num_multipliers + 1))

    def facets_of(m):
        part = order[offsets[m] : offsets[m + 1]]
        return facet[part], local[part]

    return facets_of


def _nearest(surface: Surface, domain: GapDomain, multiplier, drop, m: int):
    """The remaining multiplier of the same patch in the facet nearest to a dropped one's."""
    patch_facets = domain.patch == domain.patch[np.nonzero((multiplier == m).any(axis=1))[0][0]]
    free = (multiplier >= 0) & ~drop[multiplier] & patch_facets[:, None]
    facets = np.flatnonzero(free.any(axis=1))
    if not len(facets):
        return np.empty(0), np.empty(0, dtype=np.int64)
    centres = surface.nodes.mean(axis=1)
    own = centres[(multiplier == m).any(axis=1)].mean(axis=0)
    facet = facets[np.linalg.norm(centres[facets] - own, axis=1).argmin()]
    return np.ones(1), multiplier[facet][free[facet]][:1]


def _from_around(surface: Surface, multiplier, drop, facets, local):
    """Multipliers that remain around a dropped one and extend a polynomial of degree k − 1 to it.

    Args:
        surface: Γ1.
        multiplier: Multiplier at each dof of each facet.
        drop: Which multipliers are dropped.
        facets: Facets at the dropped one.
        local: Its number in them.

    Returns:
        Weights and multipliers, or None if there are too few in reach.
    """
    points, v = surface.element.points, surface.x[surface.facets[facets[0]]]
    own = surface.points(facets[:1], points[local[:1]])
    inverse = np.linalg.pinv(v[1:] - v[0])
    exponents, reach = _exponents(surface.element), facets
    for _ in range(3):
        known = multiplier[reach]
        reach = np.flatnonzero(np.isin(multiplier, known[known >= 0]).any(axis=1))
        known = multiplier[reach]
        facet, dof = np.nonzero((known >= 0) & ~drop[known])
        found, first = np.unique(known[facet, dof], return_index=True)
        x = surface.points(reach[facet[first]], points[dof[first]])
        P = np.prod(((x - own) @ inverse)[:, :, None] ** exponents, axis=1)  # (dof, monomial)
        if np.linalg.matrix_rank(P, tol=1e-6) == P.shape[1]:
            return np.linalg.pinv(P)[0], found
    return None


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
    points, where = element.points, np.asarray(free)
    exponents = np.indices((element.degree,) * points.shape[1]).reshape(points.shape[1], -1)
    total = exponents.sum(axis=0)
    for degree in range(element.degree - 1, -1, -1):
        powers = exponents[:, total <= degree]
        P = np.prod(points[:, :, None] ** powers, axis=1)  # (dof, monomial)
        if np.linalg.matrix_rank(P[where]) == powers.shape[1]:
            break
    return P[local] @ np.linalg.pinv(P[where])
