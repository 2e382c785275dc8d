# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The multipliers' functions ∂φ_A/∂α at Gauss points of Σ, for compliant interfaces."""

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core import collective
from hypergap_dolfinx.core.sparse import coo_matrix, product
from hypergap_dolfinx.mortar import kernel
from hypergap_dolfinx.mortar.constraint import Constraint, expand
from hypergap_dolfinx.mortar.domain import GapDomain


class Samples(collective.Owner):
    """Matrix D of ∂φ_A/∂α times the root of the weight, a row for each Gauss point."""

    def __init__(self, domain: GapDomain, constraint: Constraint):
        """Tabulate them. Collective.

        Args:
            domain: Σ.
            constraint: The constraint on it.
        """
        self._ticket = collective.enter(domain.comm)
        self.domain = domain
        n = domain.x.shape[2]
        # On straight cells c and both derivatives are polynomials of degree k − 1
        rule = 3 * (domain.element.degree - 1) + domain.is_revolved
        rule = domain.curved_rule if domain.curved.any() else rule
        self.element = domain.quadrature(rule)
        """Tables at the Gauss points, the same in all cells."""
        N, self.v = kernel.geometry_at_points(self.element, domain.x, domain.alpha_vertices)
        length = np.linalg.norm(N, axis=2)
        self.normal: npt.NDArray[np.float64] = (N / length[..., None]).reshape(-1, n)
        """Unit normals from Γ0 to Γ1, ``(num_points, n)``."""
        areas = domain.areas(self.element, N)
        self.root: npt.NDArray[np.float64] = np.sqrt(np.abs(self.element.weights) * areas).ravel()
        """Roots of the weights' magnitudes, ``(num_points,)``."""
        self.sign: npt.NDArray[np.float64] = np.tile(np.sign(self.element.weights), len(N))
        """Signs of the weights."""
        dphi = kernel.alpha_derivatives(self.element, self.v)
        D = self.root[:, None] * dphi.reshape(-1, dphi.shape[2])
        cells = np.repeat(np.arange(len(N)), len(self.element.weights))
        self.beyond: tuple[npt.NDArray, npt.NDArray] | None = None
        """Cells and ∂φ_a/∂α of the overhang's points, which are the last ones."""
        if (beyond := domain.overhang) is not None:
            dphi, normal, _ = domain.overhang_derivatives()
            self.beyond = beyond.cells, dphi
            root = np.sqrt(np.abs(beyond.weights))
            self.normal = np.vstack((self.normal, normal))
            self.root = np.append(self.root, root)
            self.sign = np.append(self.sign, -np.sign(beyond.weights))
            D = np.vstack((D, root[:, None] * dphi))
            cells = np.append(cells, beyond.cells)
        comm = domain.comm
        self._start = sum(comm.allgather(len(self.root))[: comm.rank])
        rows = self._start + np.arange(len(self.root))
        sizes = len(rows), constraint.R_A.getLocalSize()[0]
        matrix = coo_matrix(comm, sizes, np.repeat(rows, D.shape[1]), domain.nodes[cells], D)
        self.D: PETSc.Mat = matrix.matMult(constraint.R_A)
        """``(num_points, num_multipliers)``."""
        matrix.destroy()

    def _release(self) -> list:
        return [self.__dict__.pop("D", None)]

    def __getattr__(self, name: str):
        """Tell of D where it was destroyed."""
        if name == "D":
            raise ValueError(
                "the tie was destroyed: one with a compliance, a conductance or a law is needed as "
                "long as its problem is solved."
            )
        raise AttributeError(name)

    def scaled_mass(self, values: float | npt.NDArray, block_size: int) -> PETSc.Mat:
        """∫∫ c ∂φ_A/∂α ∂φ_B/∂α dΓ_α dα, the same for each component. Collective.

        Args:
            values: c at the points, or a number.
            block_size: Number of components.

        Returns:
            A new matrix, ``(num_multipliers * block_size,)`` twice.
        """
        scaled, weights = self.D.copy(), self.D.createVecLeft()
        weights.array[:] = self.sign * values
        scaled.diagonalScale(L=weights)
        product = self.D.transposeMatMult(scaled)
        M = expand(product, block_size)
        for obj in (scaled, weights, product):
            obj.destroy()
        return M

    def weighted(self, W: npt.NDArray) -> PETSc.Mat:
        """∫∫ ∂φ_A/∂α W ∂φ_B/∂α dΓ_α dα with a matrix W of the components. Collective.

        Args:
            W: ``(num_points, block_size, block_size)``.

        Returns:
            A new matrix, ``(num_multipliers * block_size,)`` twice.
        """
        block_size = W.shape[1]
        W = W * self.sign[:, None, None]
        rows = (self._start + np.arange(len(W)))[:, None] * block_size + np.arange(block_size)
        size = len(W) * block_size
        i = np.broadcast_to(rows[:, :, None], W.shape)
        j = np.broadcast_to(rows[:, None, :], W.shape)
        weights = coo_matrix(self.domain.comm, (size, size), i, j, W)
        D = expand(self.D, block_size)
        scaled = weights.matMult(D)
        product = D.transposeMatMult(scaled)
        for obj in (weights, D, scaled):
            obj.destroy()
        return product

    def openings(self) -> npt.NDArray:
        """∫∫ ∂x/∂α ∂φ_A/∂α dΓ_α dα, ``(num_multipliers, n)`` of this rank. Collective."""
        X = kernel.jacobians(self.element, self.domain.x)
        gap = np.einsum("cpij,cpj->cpi", X, self.v).reshape(-1, X.shape[-1])
        if self.beyond is not None:
            gap = np.vstack((gap, self.domain.overhang_derivatives()[2]))
        return self.forces(gap)

    def values(self, w: npt.NDArray) -> npt.NDArray:
        """Σ_A w_A ∂φ_A/∂α at the points, ``(num_points, block_size)``. Collective.

        Args:
            w: This rank's rows, ``(num_multipliers, block_size)``.
        """
        rooted, root = product(self.D, w), self.root[:, None]
        return np.divide(rooted, root, out=np.zeros_like(rooted), where=root > 0)

    def forces(self, f: npt.NDArray) -> npt.NDArray:
        """∫∫ f ∂φ_A/∂α dΓ_α dα, ``(num_multipliers, block_size)`` of this rank. Collective.

        Args:
            f: Values at the points, ``(num_points, block_size)``.
        """
        x, y = self.D.createVecs()
        found = np.empty((x.getLocalSize(), f.shape[1]), dtype=PETSc.ScalarType)
        for component, column in enumerate(f.T):
            y.array[:] = self.sign * self.root * column
            self.D.multTranspose(y, x)
            found[:, component] = x.array_r
        x.destroy()
        y.destroy()
        return found
