# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Equations c(u, q) = 0 of a coupling, with r = u − v(q) at the surface's nodes.

- rigid: c = r at the nodes;
- distributing: ``∫ r dΓ`` and ``∫ R (X − X₀) × r dΓ``, those of the least ``∫ |r|² dΓ``, times a
  constant matrix such that they are mean motions less q at R = 1.

Multipliers μ put forces ∂(μ · c)/∂u on the nodes. These and their torque balance those at the point
wherever c = 0, as equations that don't change if all turns together.
"""

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.collective import raise_on_all
from hypergap_dolfinx.core.compat import Triplets
from hypergap_dolfinx.interface_laws.coupling import CoupledMotion
from hypergap_dolfinx.interface_laws.reference_point import in_space

Array = npt.NDArray[np.float64]
CROSS = np.cross(np.eye(3)[:, None], np.eye(3))  # (e_k × e_j)_i


class _Block:
    """A matrix of entries at fixed places, whose values may be set again."""

    def __init__(self, comm, sizes: tuple[int, int], i: npt.NDArray, j: npt.NDArray):
        self.matrix = PETSc.Mat().create(comm)
        self.matrix.setSizes(tuple((size, None) for size in sizes))
        self.matrix.setType(PETSc.Mat.Type.AIJ)
        self._entries = Triplets(self.matrix, np.ravel(i), np.ravel(j))

    def set(self, values: npt.NDArray):
        """Set the values. Collective."""
        self._entries.set(np.ascontiguousarray(np.ravel(values), dtype=PETSc.ScalarType))


class CouplingRows:
    """The equations of a coupling in one problem, with their derivatives. All is collective."""

    def __init__(self, one: CoupledMotion, prescribed: npt.NDArray[np.bool_]):
        """Set up the derivatives at R = 1.

        Args:
            one: The coupling.
            prescribed: Mask of the field's owned dofs (unrolled) that are prescribed.

        Raises:
            ValueError: A rigid surface is prescribed where its point is free.
        """
        self._one, self._comm = one, one._comm
        n, num, comm, part = one._n, len(one.components), one._comm, one.component
        self._own, self._unit = num if comm.rank == 0 else 0, np.eye(num)  # rank 0 has the point
        self._kept = ~prescribed.reshape(-1, n)[one._nodes]
        nothing = not comm.allreduce(int(self._kept.sum()))
        message = "all displacements of a coupling's surface are prescribed: leave it out."
        raise_on_all(comm, message if nothing else None, ValueError)
        dofs = part.global_dofs().reshape(-1, n)[one._nodes]
        index_map, block_size = part.given.dofmap.index_map, part.given.dofmap.index_map_bs
        columns = index_map.size_local * block_size
        self._dofs = dofs - index_map.local_range[0] * block_size
        place = np.broadcast_to(dofs[..., None], (*dofs.shape, num))
        of = np.broadcast_to(np.arange(num), place.shape)
        if one.is_rigid:
            one.check_prescribed_nodes(self._kept)
            size, place = int(self._kept.sum()), dofs[self._kept]
            of = rows = sum(comm.allgather(size)[: comm.rank]) + np.arange(size)
        else:
            size, rows = self._own, np.arange(self._own)
            loads = self._loads(None)
            M = np.einsum("aik,ail->kl", loads, one.slopes(one.own_arms, None))
            self._G = np.linalg.inv(comm.allreduce(M))
        self._B = _Block(comm, (size, columns), of, place)
        pairs = np.repeat(rows, num), np.tile(np.arange(num), size)
        self._B_point = _Block(comm, (size, self._own), *pairs)
        self._mixed: tuple[_Block, ...] = ()
        if not one.is_rigid and one.can_turn:
            self._mixed = (
                _Block(comm, (columns, self._own), place, of),
                _Block(comm, (self._own, columns), of, place),
            )
        self.reset()

    def add_means(self, found: Array, first: int):
        """Add the equations of a distributing coupling to columns of owned dofs of the body.

        Args:
            found: ``(num_dofs, num_columns)``.
            first: First of its columns.
        """
        values = (self._loads(None) @ self._G.T)[self._kept]
        found[self._dofs[self._kept], first : first + len(self._unit)] += values

    def drop_rigid(self, found: Array) -> Array:
        """Take a rigid coupling's dofs out of such columns. Collective.

        Returns:
            What they contribute by the point's free unknowns, ``(num_columns, num_components)``.
        """
        one, at = self._one, self._dofs[self._kept]
        slopes = one.slopes(one.own_arms, None)[self._kept] * ~one.held
        moved = self._comm.allreduce(found[at].T @ slopes)
        found[at] = 0.0
        return moved

    @property
    def blocks(self) -> tuple[PETSc.Mat, PETSc.Mat]:
        """∂c/∂u on the body's dofs, and ∂c/∂q."""
        return self._B.matrix, self._B_point.matrix

    @property
    def mixed(self) -> list[PETSc.Mat]:
        """∂²(μ · c)/∂u∂q and its transpose, of free dofs; none if they are zero."""
        return [block.matrix for block in self._mixed]

    def destroy(self):
        """Destroy the matrices beside :attr:`blocks`."""
        for matrix in self.mixed:
            matrix.destroy()

    def reset(self):
        """Set the derivatives to those at R = 1, with μ = 0."""
        one = self._one
        by_point = -one.slopes(one.own_arms, None)[self._kept] if one.is_rigid else -self._unit
        self._set(self._loads(None), by_point)
        for block in self._mixed:
            block.set(np.zeros((*self._kept.shape, len(self._unit))))

    def update(self, u: npt.NDArray, q: npt.NDArray, multipliers: npt.NDArray) -> npt.NDArray:
        """Set the derivatives at a state, and second ones by q in the point's form.

        Args:
            u: The body's owned displacements.
            q: This rank's unknowns.
            multipliers: This rank's multipliers.

        Returns:
            This rank's c.
        """
        one, n = self._one, self._one._n
        q, arms = one.shared(q), one.own_arms
        forces, loads = self._forces(q, multipliers), self._loads(q)
        r = one.component.of_body(u).reshape(-1, n)[one._nodes] - one.moved(arms, q)
        S = one.slopes(arms, q)
        bends = -one.curvature(arms, forces, q)
        if one.is_rigid:
            self._set(loads, -S[self._kept])
            gap = r[self._kept]
        else:
            at, scale = one._rotates, one.length**2
            _, first, second = one._turned(one.arm_weights, q)
            spin = np.einsum("kji,k->ij", CROSS[at], self._common(multipliers)[n:] / one.length)
            by_point = -np.einsum("aik,ail->kl", loads, S)
            twist = np.einsum("kji,ajl,ai->kl", CROSS[at], first[:, :, at], in_space(r))
            by_point[n:, n:] += twist / scale
            D = np.zeros(S.shape)
            D[:, :, n:] = (spin @ first)[:, :n, at] / one.length
            mixed = np.einsum("aik,ail->kl", D, S)
            bends -= mixed + mixed.T
            both = np.einsum("ij,ajkl,ai->kl", spin, second, in_space(r))
            bends[n:, n:] += both[at, at] / scale
            gap, by_point = (
                self._G @ self._comm.allreduce(part)
                for part in (np.einsum("aik,ai->k", loads, r), by_point)
            )
            self._set(loads, by_point)
            gap = gap[: self._own]
            if self._mixed:
                D *= self._kept[..., None] & ~one.held
                for block in self._mixed:
                    block.set(D)
        one.bend(self._comm.allreduce(bends))
        return gap

    def take(self, u: npt.NDArray, multipliers: npt.NDArray, *, linear: bool):
        """Give the coupling its solution and the reactions.

        Args:
            u: The body's owned displacements.
            multipliers: This rank's multipliers.
            linear: True for small rotations.
        """
        one, n = self._one, self._one._n
        one.assign()
        forces = in_space(self._forces(None if linear else one._values, multipliers))
        x = one.own_arms
        if not linear:
            moved = one.component.of_body(u).reshape(-1, n)[one._nodes] - one.displacement
            x = x + in_space(moved)
        sums = np.stack((forces.sum(axis=0), np.cross(x, forces).sum(axis=0)))
        one._react(*self._comm.allreduce(sums))

    def _set(self, loads: Array, by_point: Array):
        """Set both blocks."""
        if self._one.is_rigid:
            self._B.set(np.ones(int(self._kept.sum())))
        else:
            self._B.set(loads @ self._G.T)
        self._B_point.set(by_point if self._one.is_rigid else by_point[: self._own])

    def _loads(self, values: Array | None) -> Array:
        """Forces of equations before G on nodes, ``(num_nodes, n, num_components)``."""
        one, n = self._one, self._one._n
        found = np.zeros((*self._kept.shape, len(one.components)))
        if not one.is_rigid:
            found[:, range(n), range(n)] = one.weights[:, None]
            y = one._turned(one.arm_weights, values)[0]
            found[:, :, n:] = np.einsum("kji,aj->aik", CROSS[one._rotates], y)[:, :n] / one.length
        return found

    def _common(self, multipliers: npt.NDArray) -> Array:
        """Gᵀ μ on every rank."""
        return self._G.T @ self._one.shared(np.real(multipliers))

    def _forces(self, values: Array | None, multipliers: npt.NDArray) -> Array:
        """Forces μ · ∂c/∂u on this rank's nodes, ``(num_nodes, n)``."""
        if not self._one.is_rigid:
            return self._loads(values) @ self._common(multipliers)
        found = np.zeros(self._kept.shape)
        found[self._kept] = np.real(multipliers)
        return found
