# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The constraint ∫∫ ∂u/∂α · λ dΓ_α dα = 0 (eq. 4) as matrices on the bodies' own dofs."""

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.core import collective
from hypergap_dolfinx.core.sparse import coo_matrix, triplets
from hypergap_dolfinx.mortar.domain import GapDomain, interpolation_weights
from hypergap_dolfinx.mortar.tolerances import ON_SURFACE


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
    """Global dof (block) of V₁ under each multiplier, sorted, the same on every rank. A dof that
    several patches of Γ1 share has a multiplier in each."""
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
    return Constraint(tuple(B), R, R_A, dofs, patch, rows, collective.enter(comm))


def _add_factored(B, R_A: PETSc.Mat, R, D_e, sign, dofs):
    """Add (D R_A)ᵀ w (D R_i) to each B_i. Collective.

    Args:
        B: The B_i.
        R_A: Pull-back of the multipliers.
        R: Pull-backs R_i of the nodes of Σ.
        D_e: Factors of element matrices, ``(num_cells, num_points, num_nodes)``.
        sign: Signs w of the points, ``(num_points,)``.
        dofs: The cells' nodes, ``(num_cells, num_nodes)``.
    """
    comm = R_A.comm.tompi4py()
    num_points = D_e.shape[0] * D_e.shape[1]
    start = sum(comm.allgather(num_points)[: comm.rank])
    sizes = num_points, R_A.getLocalSize()[0]
    point = np.repeat(start + np.arange(num_points), D_e.shape[2])
    columns = np.repeat(dofs, D_e.shape[1], axis=0)
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
