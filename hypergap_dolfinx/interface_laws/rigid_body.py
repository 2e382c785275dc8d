# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Rigid bodies under forces and torques: a body's nodes move with a point and a rotation."""

from collections.abc import Sequence
from typing import ClassVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.interface_laws.reference_point import PointMotion, ReferencePoint, in_space
from hypergap_dolfinx.surface.moving import Sparse, joined
from hypergap_dolfinx.surface.trace import lagrange_element

Array = npt.NDArray[np.float64]


class RigidBodyMotion(PointMotion):
    """Motion of a rigid body's nodes with its reference point."""

    NAME: ClassVar[str] = "a rigid body"

    def __init__(self, u: fem.Function, point: npt.ArrayLike, held: Sequence[str] | str):
        """Find the nodes, as for :class:`RigidBody`. Collective."""
        self._check(u)
        V = u.function_space
        n = V.mesh.geometry.dim
        super().__init__(V.mesh.comm, n, point, held)
        self.u = u
        self._arms = in_space(V.tabulate_dof_coordinates()[:, :n] - self.point)
        mine = self._arms[: V.dofmap.index_map.size_local]
        sums = self._comm.allreduce(np.array([(mine**2).sum(), len(mine)]))
        self._make_unknowns(float(np.sqrt(sums[0] / sums[1])) or 1.0)

    @staticmethod
    def _check(u: fem.Function):
        """Raise if a function is no displacement."""
        if not isinstance(u, fem.Function):
            raise ValueError(f"a rigid body takes the displacement u, not a {type(u).__name__}.")
        if u.function_space.mesh.comm.allreduce(bool(u.x.array.any()), MPI.LOR):
            raise ValueError(
                "the displacement of a rigid body isn't 0 at the start, and would be lost: set it "
                "to 0, and move the mesh or hold the body at prescribed values."
            )
        V = u.function_space
        if V.value_shape != (V.mesh.geometry.dim,) or lagrange_element(V)[1] is not None:
            raise ValueError(
                "the displacement of a rigid body is on a Lagrange space of vectors, with as many "
                "components as there are coordinates; this is another one."
            )

    @property
    def held_axes(self) -> npt.NDArray[np.bool_]:
        """Mask of the axes along which none of its nodes can move, ``(n,)``."""
        return self.held[: self._n] & self.held[self._n :].all()

    def assign(self):
        """Set u from the unknowns. Collective."""
        super().assign()
        self.u.x.array[:] = self.moved(self._arms, self._values).ravel()

    def react(self, loads: Sequence[tuple[Array, Array]]):
        """Find the reactions to contact forces.

        Args:
            loads: Of each contact X − X₀ of points, ``(num, 3)``, and forces there, ``(num, n)``.
        """
        total = np.zeros((2, 3))
        for arms, forces in loads:
            force = in_space(forces)
            total += force.sum(axis=0), np.cross(self._turned(arms, self._values)[0], force).sum(0)
        self._react(*total)

    @property
    def own_arms(self) -> Array:
        """X − X₀ of this rank's owned nodes, ``(num_nodes, 3)``."""
        return self._arms[: self.u.function_space.dofmap.index_map.size_local]


class RigidBody(ReferencePoint):
    """A rigid body that contact, forces and torques move; it takes the place of a form.

    Its displacements are u = (R − 1) (X − X₀) + t: t is that of its reference point X₀, R a
    rotation of any size. Components are x, y and the rotation in the plane, x, y, z and rotations
    rx, ry, rz about axes of space in space; each is free or held. The mesh needs no more than the
    cells at its surface.

    Loads are ``force``, at X₀, and ``torque``, both fixed in space. All arrays may be changed
    between load steps, and are ramped where one is halved. In space a rotation is the product of
    those of load steps, each about the sum of the increments of rx, ry and rz.

    Example:
        A wheel on an axle in springs, which a torque turns::

            wheel = RigidBody(u1, point=(0.0, 1.0))
            problem = ContactProblem([F0, wheel], [u0, u1], contacts=[contact])
            wheel.force = 0.0, -100.0
            wheel.torque = 20.0
            wheel.springs[0] = 1e4
            problem.solve()
            print(wheel.displacement, wheel.angles)

        A mass m, by Newmark's method or another one that is linear in accelerations: springs are
        m / (β Δt²), anchors the predicted displacements; of rotations with the moment of inertia
        about their axis (gyroscopic moments aren't in it).
    """

    def __init__(self, u: fem.Function, *, point: npt.ArrayLike, held: Sequence[str] | str = ()):
        """Find its nodes. Collective.

        Args:
            u: Displacement of the body, on a Lagrange space of vectors; it is set by the problem.
            point: The reference point X₀, in the body or elsewhere.
            held: Names of the components that are held, of :attr:`components`, at the values in
                :attr:`prescribed`.

        Raises:
            ValueError: No displacement, a point or a name that is none.
        """
        super().__init__(RigidBodyMotion(u, point, held))
        self.u = u
        """Its displacement."""
        self._made = True


class RigidSides:
    """Rigid bodies at the sides of a contact: their unknowns in the place of surfaces' dofs."""

    def __init__(self, bodies: Sequence[RigidBodyMotion | None], arms: Sequence[Array]):
        """Store them.

        Args:
            bodies: Γ0's and Γ1's, None for another body.
            arms: X − X₀ at the dofs of both sides, ``(num_dofs_i, n)``.
        """
        self.bodies = list(bodies)
        """Γ0's and Γ1's, None for another body."""
        self._sides = [(b, in_space(x)) for b, x in zip(bodies, arms, strict=True)]
        self._n = arms[0].shape[1]
        self.moves = [body is not None for body in bodies]
        """True for sides on a rigid body."""

    def numbers(self, of: Sequence[int | None]) -> tuple[npt.NDArray, npt.NDArray]:
        """Body of each unknown, -2 for those that are held, and its number there.

        Args:
            of: Numbers of both sides' bodies.
        """
        pairs = [(b, k) for b, k in zip(self.bodies, of, strict=True) if b and k is not None]
        bodies = [np.where(body.held, -2, k) for body, k in pairs]
        return np.concatenate(bodies), np.concatenate([np.arange(len(b.held)) for b, _ in pairs])

    def slopes(self, start: int) -> Sparse:
        """Derivatives of dofs by the unknowns that are free, of which ``start`` is the first."""
        found, before = [Sparse.empty()], 0
        for body, arms in self._sides:
            if body:
                values = body.slopes(arms, body._values).reshape(-1, len(body.held)) * ~body.held
                i, j = np.nonzero(values)
                found.append(Sparse(before + i, start + j, values[i, j]))
                start += len(body.held)
            before += len(arms) * self._n
        return joined(*found)

    def curvature(self, start: int, forces: Sequence[Array]) -> Sparse:
        """Forces at both sides' dofs times second derivatives of these by the unknowns."""
        found = [Sparse.empty()]
        for (body, arms), force in zip(self._sides, forces, strict=True):
            if body:
                free = np.where(body.held, 0.0, 1.0)
                values = body.curvature(arms, force, body._values) * np.outer(free, free)
                i, j = np.nonzero(values)
                found.append(Sparse(start + i, start + j, values[i, j]))
                start += len(body.held)
        return joined(*found)

    def moved(self, side: int, values: npt.NDArray) -> Array:
        """Velocities of a side's dofs from this rank's of the unknowns. Collective."""
        body, arms = self._sides[side]
        assert body is not None
        return body.slopes(arms, body._values) @ body.shared(values)

    def generalised(self, side: int, force: Array) -> Array:
        """Forces at a side's dofs on the unknowns, ``(num_components,)``."""
        body, arms = self._sides[side]
        assert body is not None
        return np.einsum("aik,ai->k", body.slopes(arms, body._values), force)

    def loads(self, body: RigidBodyMotion, forces: Sequence[Array]) -> list[tuple[Array, Array]]:
        """X − X₀ and forces on one body, as :meth:`RigidBodyMotion.react` takes them."""
        pairs = zip(self._sides, forces, strict=True)
        return [(arms, force) for (other, arms), force in pairs if other is body]
