# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Rigid bodies under forces and torques: a body's nodes move with a point and a rotation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem
from hypergap_dolfinx.core.rotation import moment_of, rotated, rotation
from hypergap_dolfinx.interface_laws.reference_point import ReferencePoint, in_space
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.moving import Sparse, joined
from hypergap_dolfinx.surface.trace import lagrange_element

Array = npt.NDArray[np.float64]


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

    NAME: ClassVar[str] = "a rigid body"

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
        self._check(u)
        V = u.function_space
        n = V.mesh.geometry.dim
        super().__init__(V.mesh.comm, n, point, held)
        self.u = u
        self._arms = in_space(V.tabulate_dof_coordinates()[:, :n] - self._point)
        mine = self._arms[: V.dofmap.index_map.size_local]
        sums = self._comm.allreduce(np.array([(mine**2).sum(), len(mine)]))
        self._start, self._turn = np.zeros(len(self.components) - n), np.eye(3)
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

    def _make_unknowns(self, length: float):
        """Its unknowns, and forms at a rotation. Collective."""
        super()._make_unknowns(length)
        V, num = self.q.function_space, len(self.components)
        self._slope = fem.Constant(V.mesh, np.zeros((num, num)))
        dq, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        self.J: ufl.Form = self.a + ufl.inner(self._slope * dq, v) * ufl.dx
        """Derivative of its residual."""

    # What users set and read

    @property
    def rotation(self) -> Array:
        """The rotation R, ``(n, n)``."""
        return (rotation(self._theta) @ self._turn)[: self._n, : self._n]

    @property
    def reaction(self) -> Array:
        """Forces and torques after a solve by which it is held, ``(num_components,)``; 0 if free.

        In space the torque has three components if any rotation is held: those of load steps aren't
        about axes of space alone, but for one axis.
        """
        return self._reaction.copy()

    # What a problem asks for

    @property
    def constants(self) -> list[fem.Constant]:
        """Constants in its forms and conditions, which :meth:`read` sets."""
        return [*self._goals, self._load, self._own, self._slope]

    @property
    def can_turn_freely(self) -> bool:
        """True if its rotation has no fixed axis."""
        return self._n == 3 and int((~self.held[3:]).sum()) > 1

    @property
    def held_axes(self) -> npt.NDArray[np.bool_]:
        """Mask of the axes along which none of its nodes can move, ``(n,)``."""
        return self.held[: self._n] & self.held[self._n :].all()

    @property
    def _theta(self) -> Array:
        """Rotation vector since the last accepted state, ``(3,)``."""
        return self._theta_of(self._values)

    def _theta_of(self, values: Array) -> Array:
        theta = np.zeros(3)
        theta[self._rotates] = values[self._n :] / self._length - self._start
        return theta

    def read(self, *, springs: bool = True):
        """Set the constants of its forms from what the user has set, at the present rotation.

        Args:
            springs: False to leave out the stiffness of springs.
        """
        n = self._n
        M = np.zeros(3)
        M[self._rotates] = self._torque
        moment, slope = moment_of(self._theta, M)
        at = self._rotates
        self._set(moment[at], springs)
        self._slope.value[n:, n:] = -slope[at, at] / self._length**2

    def turn_by(self, change: Array) -> float:
        """Angle of a change of this rank's unknowns, in radians. Collective."""
        return float(np.linalg.norm(self.shared(change)[self._n :])) / self._length

    def assign(self):
        """Set u from the unknowns. Collective."""
        self._values = self.shared(self.q.x.array)
        self.u.x.array[:] = self.moved(self._arms, self._values).ravel()

    def moved(self, arms: Array, values: Array) -> Array:
        """Displacements of points X, from X − X₀, ``(num, n)`` from ``(num, 3)``, by unknowns."""
        n = self._n
        x, _, _ = rotated(self._theta_of(values), arms @ self._turn.T)
        return (x - arms)[:, :n] + values[:n]

    def slopes(self, arms: Array) -> Array:
        """Derivatives of displacements by the unknowns, ``(num, n, num_components)``."""
        n = self._n
        _, first, _ = rotated(self._theta, arms @ self._turn.T)
        found = np.zeros((len(arms), n, len(self.components)))
        found[:, range(n), range(n)] = 1.0
        found[:, :, n:] = first[:, :n, self._rotates] / self._length
        return found

    def curvature(self, arms: Array, forces: Array) -> Array:
        """Forces times second derivatives of displacements, ``(num_components, num_components)``.

        Args:
            arms: X − X₀, ``(num, 3)``.
            forces: ``(num, n)``.
        """
        n, at = self._n, self._rotates
        _, _, second = rotated(self._theta, arms @ self._turn.T)
        found = np.zeros((len(self.components),) * 2)
        both = np.einsum("ak,akij->ij", forces, second[:, :n])
        found[n:, n:] = both[at, at] / self._length**2
        return found

    def react(self, loads: Sequence[tuple[Array, Array]]):
        """Find the reactions to contact forces.

        Args:
            loads: Of each contact X − X₀ of points, ``(num, 3)``, and forces there, ``(num, n)``.
        """
        n, at = self._n, self._rotates
        values = np.append(self.displacement, self.angles)
        total = np.append(self._force, self._torque) + self._springs * (self._anchors - values)
        for arms, forces in loads:
            x, _, _ = rotated(self._theta, arms @ self._turn.T)
            total[:n] += forces.sum(axis=0)
            total[n:] += np.cross(x, in_space(forces)).sum(axis=0)[at]
        some = self.held[n:].any()  # of rotations
        self._reaction = np.where(
            np.append(self.held[:n], np.full(len(total) - n, some)), -total, 0.0
        )

    def commit(self):
        """Accept the state: the next rotation vector starts from it."""
        self._turn = rotation(self._theta) @ self._turn
        self._start = self.angles

    def kept(self) -> Array:
        """What the next load step depends on beside the unknowns, and the reaction, flat."""
        return np.concatenate((self._reaction, self._start, self._turn.ravel()))

    def resume(self, kept: Array):
        """Go on from what was kept, with unknowns that are set already. Collective."""
        num = len(self._reaction)
        self._reaction, self._start, turn = np.split(kept.copy(), [num, num + len(self._start)])
        self._turn = turn.reshape(3, 3)
        self.assign()


@dataclass(frozen=True)
class RigidComponent(Component):
    """The unknowns of a rigid body in the place of a field; its nodes are those of its mesh."""

    remedy: ClassVar[str] = "held="
    body: RigidBody

    @classmethod
    def of_rigid(cls, body: RigidBody) -> "RigidComponent":
        """That of a body."""
        V = body.q.function_space
        return cls(V, V, None, body)

    @property
    def _arms(self) -> Array:
        """X − X₀ of this rank's owned nodes."""
        return self.body._arms[: self.body.u.function_space.dofmap.index_map.size_local]

    def nodes(self, values: npt.NDArray) -> npt.NDArray:
        """Positions of this rank's owned nodes of its mesh, ``(num_nodes, n)``. Collective."""
        n, body = self.body._n, self.body
        return body.point + self._arms[:, :n] + body.moved(self._arms, body.shared(values))

    def at_nodes(self, values: npt.NDArray) -> npt.NDArray:
        """Velocities of this rank's owned nodes, ``(num_nodes, n)``. Collective."""
        return self.body.slopes(self._arms) @ self.body.shared(values)


class RigidSides:
    """Rigid bodies at the sides of a contact: their unknowns in the place of surfaces' dofs."""

    def __init__(self, bodies: Sequence[RigidBody | None], arms: Sequence[Array]):
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
                values = body.slopes(arms).reshape(-1, len(body.held)) * ~body.held
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
                values = body.curvature(arms, force) * np.outer(free, free)
                i, j = np.nonzero(values)
                found.append(Sparse(start + i, start + j, values[i, j]))
                start += len(body.held)
        return joined(*found)

    def moved(self, side: int, values: npt.NDArray) -> Array:
        """Velocities of a side's dofs from this rank's of the unknowns. Collective."""
        body, arms = self._sides[side]
        assert body is not None
        return body.slopes(arms) @ body.shared(values)

    def generalised(self, side: int, force: Array) -> Array:
        """Forces at a side's dofs on the unknowns, ``(num_components,)``."""
        body, arms = self._sides[side]
        assert body is not None
        return np.einsum("aik,ai->k", body.slopes(arms), force)

    def loads(self, body: RigidBody, forces: Sequence[Array]) -> list[tuple[Array, Array]]:
        """X − X₀ and forces on one body, as :meth:`RigidBody.react` takes them."""
        pairs = zip(self._sides, forces, strict=True)
        return [(arms, force) for (other, arms), force in pairs if other is body]
