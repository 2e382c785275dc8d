# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Balance of forces: the residual of bodies beside the forces in them."""

from collections.abc import Sequence
from itertools import accumulate, pairwise

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.displacement import DisplacementField
from hypergap_dolfinx.contact_solver.tolerances import ROUND_OFF_FORCES, SHORTENED
from hypergap_dolfinx.interface_laws.coupling import CoupledMotion
from hypergap_dolfinx.solvers.newton import Dependence

Arrays = Sequence[npt.NDArray]


class ForceBalance:
    """Norms of the residual, of the forces in bodies and of their round-off; what of them is zero.

    Each elastic body has its own round-off: a stiff one's may be more than a soft one's forces.
    The residual of a body adds up to zero along each axis on which nothing is prescribed, but for
    the round-off of the stresses' sum. Fields other than displacements (:class:`DisplacementField`)
    have equations of their own.
    """

    def __init__(
        self,
        fields: Sequence[DisplacementField],
        K: Sequence[PETSc.Mat],
        held: Sequence[npt.NDArray[np.bool_]],
        depends: Sequence[Dependence],
        couplings: Sequence[CoupledMotion],
        finest: float,
        rtol: float,
    ):
        """Find the axes on which bodies are free. Collective.

        Args:
            fields: Displacements of each elastic body, of rigid ones and of couplings.
            K: Their stiffness.
            held: Masks of their prescribed dofs.
            depends: What the stiffness of each elastic body depends on.
            couplings: Couplings of surfaces with points.
            finest: Size of the smallest facet in contact.
            rtol: Residual, over the forces in the bodies, treated as zero.
        """
        self._fields, self._K, self._depends = fields, K, depends
        self._couplings, self._finest, self._rtol, self._held = couplings, finest, rtol, held
        self._num = len(depends)  # elastic bodies
        self._comm = fields[0].part.space.mesh.comm
        self._dim = fields[0].part.space.mesh.topology.dim
        mine = [self._displacements(i, held[i]).sum(axis=0) for i in range(self._num)]
        num_held = self._comm.allreduce(np.reshape(mine, (-1, self._dim)))
        bodies, _ = np.nonzero(num_held == 0)
        self._free_axes = {int(i): np.flatnonzero(num_held[i] == 0).tolist() for i in bodies}
        self._same_body = bodies[:, None] == bodies  # of pairs of free axes
        self.unbalanced = self.last_unbalanced = np.inf
        """Norm of the residual of bodies, and before the last Newton step."""
        self.in_bodies = 0.0
        """Norm of the forces in bodies and contacts."""
        self.left: list[npt.NDArray] = []
        """This rank's residual of displacements."""
        self._translated: dict[int, npt.NDArray[np.float64]] | None = None
        self.stiffness = 0.0
        """Mean diagonal of the softest elastic body; 0 without any."""

    def start_step(self):
        """Forget the largest forces."""
        self._largest, self._largest_terms = np.zeros(1), np.zeros(1)

    def measure_stiffness(self):
        """Measure the stiffness, which has changed. Collective."""
        bodies = list(zip(self._fields, self._K, self._held[: self._num], strict=False))
        found = min((field.stiffness(K, held) for field, K, held in bodies), default=0.0)
        if not np.isfinite(found):  # all is prescribed: the size of those rows
            found = min(field.stiffness(K, np.zeros_like(held)) for field, K, held in bodies)
        self.stiffness = found
        pairs = zip(self._fields, self._K, strict=True)
        self._row_lengths = [field.lengths(K) for field, K in pairs]
        self._translated = None

    def measure(
        self,
        left: Arrays,
        num_ties: int,
        owned: Arrays,
        forces: Sequence[float],
        of_contacts: Sequence[Arrays],
    ):
        """Measure the residual, and the forces beside it. Collective.

        Args:
            left: This rank's residual of bodies, jumps and ties, with contact forces.
            num_ties: Number of ties, the last ones.
            owned: This rank's displacements of each body.
            forces: Norm of each body's internal and external forces.
            of_contacts: Contact forces on both sides of each contact.
        """
        bodies, num = len(self._fields), len(left) - num_ties
        self.left = [
            field.part.of_body(values)
            for field, values in zip(self._fields, left[:bodies], strict=True)
        ]
        found = [
            field.squares(values)
            for of in (left[:bodies], owned)
            for field, values in zip(self._fields, of, strict=True)
        ]
        found.append(np.array([np.vdot(part, part).real for part in left[bodies:num]]))  # at jumps
        sums = np.concatenate(found)
        self._comm.Allreduce(MPI.IN_PLACE, sums)
        ends = accumulate(map(len, found), initial=0)
        *found, jumps = [sums[a:b] for a, b in pairwise(ends)]
        self._owned = owned
        errors, values = found[:bodies], found[bodies:]
        apart, extent = self._of_couplings(left)
        rest = jumps.sum() + apart + sum(error[0] for error in errors[self._num :])
        self._errors = np.sqrt([*(error[0] for error in errors[: self._num]), rest])
        self.unbalanced = float(np.linalg.norm(self._errors))
        sizes = [L**2 @ part for L, part in zip(self._row_lengths, values, strict=True)]
        of_bodies = [float(size[0]) for size in sizes]
        size_of = np.sqrt([*of_bodies[: self._num], sum(of_bodies) + extent])
        self._largest = np.maximum(self._largest, size_of)  # its digits are lost when forces fall
        error, terms = (
            np.sqrt(np.concatenate([of[1:] for of in each])) for each in (errors, sizes)
        )
        self._largest_terms = np.maximum(self._largest_terms, terms)
        accepted = np.maximum(self._rtol * terms, ROUND_OFF_FORCES * self._largest_terms)
        self.satisfies_others = bool((error <= accepted).all())
        """True if the equations of other fields than displacements are satisfied."""
        size = sum([force**2 for force in forces])
        for parts in of_contacts:
            size += sum([(force**2).sum() for force in parts])
        self.in_bodies = float(np.sqrt(size))

    def unexplained(self) -> float:
        """Norm of what of the residual isn't round-off; if little, its largest sum. Collective."""
        known = self._largest.copy()
        for i, depends in enumerate(self._depends):
            known[i] += self._at_rest(i) * (depends.on_u and not self.converges)
        beyond = float(np.linalg.norm(np.maximum(self._errors - ROUND_OFF_FORCES * known, 0)))
        if not beyond <= self._rtol * self.in_bodies:
            return beyond
        force, terms = np.abs(self._along_axes())
        terms = (self._same_body * terms).sum(axis=1)  # stresses along all axes are found together
        force = force - ROUND_OFF_FORCES * (self.in_bodies + terms)
        return max(beyond, float(force.max(initial=0)))

    @property
    def converges(self) -> bool:
        """True if the residual is less than before the last Newton step, or the load step."""
        return bool(self.unbalanced < SHORTENED * self.last_unbalanced)

    @property
    def round_off(self) -> float:
        """Round-off of the forces of the softest body."""
        return ROUND_OFF_FORCES * float(self._largest.min())

    @property
    def nothing(self) -> float:
        """Force of contact that is round-off: gaps have that of places, as bodies at rest."""
        softest = min(map(self._at_rest, range(self._num)), default=0.0)
        return ROUND_OFF_FORCES * float(self._largest[-1] + softest)

    def _at_rest(self, i: int) -> float:
        """Forces that add up to zero in a body at rest, if its form isn't linear.

        Its gradient is 1 + ∂u/∂X, with the round-off of 1: displacements have that of a facet.
        """
        return float(self._row_lengths[i][0, 0] * self._K[i].getSize()[0] ** 0.5 * self._finest)

    def _displacements(self, i: int, values: npt.NDArray) -> npt.NDArray:
        """This rank's displacements among values of a body, by axes."""
        return self._fields[i].part.of_body(values).reshape(-1, self._dim)

    def _along_axes(self) -> npt.NDArray[np.float64]:
        """Sums of the residual along free axes. Collective.

        Returns:
            Sums for each body and axis, and those of the terms in them, ``(2, num)``: stresses have
            none, springs and masses have.
        """
        if self._translated is None:
            each = self._free_axes.items()
            self._translated = {i: np.abs([self._forces_of(i, a) for a in of]) for i, of in each}
        parts = [np.zeros((2, 0))]
        for i, columns in self._translated.items():
            along = self.left[i].real.reshape(-1, self._dim).sum(axis=0)[self._free_axes[i]]
            terms = columns @ np.abs(self._fields[i].part.of_body(self._owned[i]))
            parts.append(np.stack((along, terms)))
        sums = np.hstack(parts)
        self._comm.Allreduce(MPI.IN_PLACE, sums)
        return sums

    def _of_couplings(self, left: Arrays) -> tuple[float, float]:
        """Squares of couplings' residuals and of their extents, as forces. Collective."""
        if not self._couplings:
            return 0.0, 0.0
        found, start = np.zeros(2), len(left) - len(self._couplings)
        for one, part in zip(self._couplings, left[start:], strict=True):
            found += part @ part, len(part) * one.length**2
        found = self._comm.allreduce(found) * self.stiffness**2
        return float(found[0]), float(found[1])

    def _forces_of(self, i: int, a: int) -> npt.NDArray[np.float64]:
        """Derivatives of the sum of a body's forces along an axis, on this rank. Collective."""
        K, part = self._K[i], self._fields[i].part
        unit, forces = K.createVecs()
        one = np.zeros(part.space.dofmap.index_map.size_local * self._dim)
        one[a :: self._dim] = 1
        unit.array[:] = part.into_body(one)
        K.multTranspose(unit, forces)
        found = part.of_body(forces.array_r.real.copy())
        for vector in (unit, forces):
            vector.destroy()
        return found
