# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Unknowns of a point that moves and turns, under forces, torques and springs, or held."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial
from typing import Any, ClassVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx.mesh
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.core.rotation import moment_of, rotated, rotation
from hypergap_dolfinx.interface_laws.given_values import Settable, as_numbers
from hypergap_dolfinx.surface.component import Component

Array = npt.NDArray[np.float64]
COMPONENTS = {2: ("x", "y", "rotation"), 3: ("x", "y", "z", "rx", "ry", "rz")}


class PointMotion:
    """Unknowns of a reference point, their forms, and the motion that goes with them."""

    NAME: ClassVar[str]
    """Its owner's name in messages."""

    def __init__(self, comm: MPI.Comm, n: int, point: npt.ArrayLike, held: Sequence[str] | str):
        """Check and store what a user gives.

        Args:
            comm: Communicator.
            n: Dimension of space.
            point: The reference point X₀.
            held: Names of the components that are held.

        Raises:
            ValueError: A point or a name that is none.
        """
        if np.issubdtype(default_scalar_type, np.complexfloating):
            raise ValueError(f"{self.NAME} needs a PETSc with real scalars.")
        self._comm, self._n = comm, n
        self.components = COMPONENTS[n]
        """Names of its unknowns."""
        given = as_numbers(point, (n,), f"the point of {self.NAME}")
        held = [held] if isinstance(held, str) or not isinstance(held, Sequence) else list(held)
        for name in held:
            if name not in self.components:
                raise ValueError(f"held has {name!r}; components are {', '.join(self.components)}.")
        self.point = given
        """The reference point X₀, ``(n,)``."""
        self.held = np.array([name in held for name in self.components])
        """Mask of the components that are held, ``(num_components,)``."""
        num, across = len(self.components), len(self.components) - n
        self._rotates = slice(0, 3) if n == 3 else slice(2, 3)  # of a rotation vector
        self.force, self.torque = np.zeros(n), np.zeros(across)
        self.prescribed, self.springs, self.anchors = np.zeros((3, num))
        self._values, self.reaction = np.zeros((2, num))
        self._start, self._turn, self._bends = np.zeros(across), np.eye(3), np.zeros((num, num))

    def _make_unknowns(self, length: float):
        """Function of the unknowns, on one cell of volume 1, and its forms. Collective.

        Args:
            length: Unit of rotations, which are unknowns times a length.
        """
        self.length = length
        """Unit of rotations."""
        across = len(self.components) - self._n
        self._units = np.append(np.ones(self._n), np.full(across, 1 / length))
        n, num, comm = self._n, len(self.components), self._comm
        x = factorial(n) ** (1 / n) * np.vstack((np.zeros(n), np.eye(n)))
        mine = np.arange(n + 1)[None] if comm.rank == 0 else np.empty((0, n + 1), dtype=np.int64)
        name = {2: "triangle", 3: "tetrahedron"}[n]

        def stay(comm, num_parts, cell_types, cells):
            return compat.destinations(np.zeros(len(mine), dtype=np.int32))

        mesh = dolfinx.mesh.create_mesh(
            comm,
            mine,
            e=basix.ufl.element("Lagrange", name, 1, shape=(n,)),
            x=x if comm.rank == 0 else x[:0],
            partitioner=stay,
        )
        V = fem.functionspace(mesh, ("DG", 0, (num,)))
        self.q = fem.Function(V)
        """Its unknowns: translations, and rotations times a length."""
        self._goals = [fem.Constant(mesh, 0.0) for _ in range(num)]
        self._load, self._own = (fem.Constant(mesh, np.zeros(num)) for _ in range(2))
        dq, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        own = ufl.as_vector([self._own[k] * dq[k] for k in range(num)])
        self.a: ufl.Form = ufl.inner(own, v) * ufl.dx
        """Bilinear form of its springs."""
        self._slope = fem.Constant(mesh, np.zeros((num, num)))
        self.J: ufl.Form = self.a + ufl.inner(self._slope * dq, v) * ufl.dx
        """Derivative of its residual at a rotation."""
        self.L: ufl.Form = ufl.inner(self._load, v) * ufl.dx
        """Linear form of its loads."""
        self.F: ufl.Form = ufl.action(self.a, self.q) - self.L
        """Residual form of both."""
        self.bcs = [
            fem.dirichletbc(goal, np.full(len(mine), k, dtype=np.int32), V.sub(k))
            for k, goal in enumerate(self._goals)
            if self.held[k]
        ]
        """Conditions of what is held."""

    @property
    def displacement(self) -> Array:
        """Displacement t of the reference point, ``(n,)``, the same on every rank."""
        return self._values[: self._n].copy()

    @property
    def angles(self) -> Array:
        """Rotations added up, in radians, ``(num_rotations,)``."""
        return self._values[self._n :] / self.length

    @property
    def rotation(self) -> Array:
        """The rotation R, ``(n, n)``."""
        return (rotation(self._theta) @ self._turn)[: self._n, : self._n]

    @property
    def given(self) -> list[Array]:
        """Arrays in which a user changes its values."""
        return [self.force, self.torque, self.prescribed, self.springs, self.anchors]

    def wrong(self) -> str | None:
        """Message about values that are contradictory, or None."""
        at = np.flatnonzero((self.prescribed != 0) & ~self.held)
        if len(at):
            name = self.components[at[0]]
            return (
                f"a value is prescribed for {name} of {self.NAME}, which isn't held: make the "
                f"{self.NAME.removeprefix('a ')} with held={name!r}, or set 0."
            )
        if (self.springs < 0).any():
            return (
                f"a spring of {self.NAME} has the stiffness {self.springs.min():.3g}; give "
                "numbers ≥ 0."
            )
        return None

    @property
    def own_arms(self) -> Array:
        """X − X₀ of this rank's owned nodes that move with it, ``(num_nodes, 3)``."""
        raise NotImplementedError

    @property
    def can_turn(self) -> bool:
        """True if a rotation is free."""
        return not self.held[self._n :].all()

    @property
    def can_turn_freely(self) -> bool:
        """True if its rotation has no fixed axis."""
        return self._n == 3 and int((~self.held[3:]).sum()) > 1

    @property
    def _theta(self) -> Array:
        """Rotation vector since the last accepted state, ``(3,)``."""
        return self._theta_of(self._values)

    def _theta_of(self, values: Array) -> Array:
        theta = np.zeros(3)
        theta[self._rotates] = values[self._n :] / self.length - self._start
        return theta

    def read(self, *, springs: bool = True, linear: bool = False):
        """Set the constants of its forms from what the user has set, at the present rotation.

        Args:
            springs: False to leave out the stiffness of springs.
            linear: True for small rotations.
        """
        n, at, M = self._n, self._rotates, np.zeros(3)
        M[at] = self.torque
        moment, slope = moment_of(0 * M if linear else self._theta, M)
        load = np.append(self.force, moment[at]) + self.springs * self.anchors
        self._load.value[:] = load * self._units
        self._own.value[:] = springs * self.springs * self._units**2
        self._slope.value[:] = self._bends
        self._slope.value[n:, n:] -= slope[at, at] / self.length**2
        for goal, value in zip(self._goals, self.prescribed / self._units, strict=True):
            goal.value = value

    def turn_by(self, change: Array) -> float:
        """Angle of a change of this rank's unknowns, in radians. Collective."""
        return float(np.linalg.norm(self.shared(change)[self._n :])) / self.length

    def assign(self):
        """Take the values of the unknowns. Collective."""
        self._values = self.shared(self.q.x.array)

    def _turned(self, arms: Array, values: Array | None) -> tuple[Array, Array, Array]:
        """R (X − X₀) with derivatives by the rotation vector; at R = 1 without values."""
        if values is None:
            return rotated(np.zeros(3), arms)
        return rotated(self._theta_of(values), arms @ self._turn.T)

    def moved(self, arms: Array, values: Array) -> Array:
        """Displacements of points X, from X − X₀, ``(num, n)`` from ``(num, 3)``, by unknowns."""
        n = self._n
        return (self._turned(arms, values)[0] - arms)[:, :n] + values[:n]

    def slopes(self, arms: Array, values: Array | None) -> Array:
        """Derivatives of displacements by the unknowns, ``(num, n, num_components)``."""
        n = self._n
        found = np.zeros((len(arms), n, len(self.components)))
        found[:, range(n), range(n)] = 1.0
        found[:, :, n:] = self._turned(arms, values)[1][:, :n, self._rotates] / self.length
        return found

    def curvature(self, arms: Array, forces: Array, values: Array) -> Array:
        """Forces times second derivatives of displacements, ``(num_components, num_components)``.

        Args:
            arms: X − X₀, ``(num, 3)``.
            forces: ``(num, n)``.
            values: The unknowns.
        """
        n, at = self._n, self._rotates
        found = np.zeros((len(self.components),) * 2)
        both = np.einsum("ak,akij->ij", forces, self._turned(arms, values)[2][:, :n])
        found[n:, n:] = both[at, at] / self.length**2
        return found

    def _react(self, force: Array, torque: Array):
        """Find the reactions to a force and a torque about the point, ``(3,)`` each."""
        n, held = self._n, self.held.copy()
        held[n:] = held[n:].any()
        values = np.append(self.displacement, self.angles)
        total = np.append(self.force, self.torque) + self.springs * (self.anchors - values)
        total += np.append(force[:n], torque[self._rotates])
        self.reaction = np.where(held, -total, 0.0)

    def commit(self):
        """Accept the state: the next rotation vector starts from it."""
        self._turn = rotation(self._theta) @ self._turn
        self._start = self.angles

    def kept(self) -> Array:
        """What the next load step depends on beside the unknowns, and the reaction, flat."""
        return np.concatenate((self.reaction, self._start, self._turn.ravel()))

    def resume(self, kept: Array):
        """Go on from what was kept, with unknowns that are set already. Collective."""
        num = len(self.reaction)
        self.reaction, self._start, turn = np.split(kept.copy(), [num, num + len(self._start)])
        self._turn = turn.reshape(3, 3)
        self.assign()

    def shared(self, values: npt.NDArray) -> Array:
        """Values of its unknowns on every rank, from this rank's. Collective."""
        return self._comm.bcast(np.array(values[: len(self.components)]))  # rank 0 has the cell


class ReferencePoint(Settable):
    """Displacement and rotation of a point: free, in springs, or held, under force and torque."""

    def __init__(self, motion: PointMotion):
        """Store its motion."""
        self.motion: Any = motion
        """What problems ask for."""

    def __setattr__(self, name: str, value: Any):
        """Set what can be set.

        Raises:
            ValueError: ``held``, which is for good.
            AttributeError: A name that can't be set.
        """
        if name == "held":
            raise ValueError(
                f"held can't be changed later: make {self.motion.NAME} with held={value!r}."
            )
        super().__setattr__(name, value)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of its unknowns."""
        return self.motion.components

    def _assign(self, name: str, value: npt.ArrayLike):
        array = getattr(self.motion, name)
        array[:] = as_numbers(value, array.shape, f"the {name} of {self.motion.NAME}")

    @property
    def held(self) -> npt.NDArray[np.bool_]:
        """Mask of the components that are held, ``(num_components,)``; not to be changed."""
        return self.motion.held

    @property
    def point(self) -> Array:
        """The reference point X₀, ``(n,)``."""
        return self.motion.point.copy()

    @property
    def force(self) -> Array:
        """Force at the reference point, ``(n,)``."""
        return self.motion.force

    @force.setter
    def force(self, value: npt.ArrayLike):
        self._assign("force", value)

    @property
    def torque(self) -> Array:
        """Torque about the reference point, ``(1,)`` in the plane, ``(3,)`` about axes of space."""
        return self.motion.torque

    @torque.setter
    def torque(self, value: npt.ArrayLike):
        self._assign("torque", value)

    @property
    def prescribed(self) -> Array:
        """Values of what is held: displacements of the point, and angles, ``(num_components,)``."""
        return self.motion.prescribed

    @prescribed.setter
    def prescribed(self, value: npt.ArrayLike):
        self._assign("prescribed", value)

    @property
    def springs(self) -> Array:
        """Stiffness of springs to the anchors, ``(num_components,)``; 0 for none."""
        return self.motion.springs

    @springs.setter
    def springs(self, value: npt.ArrayLike):
        self._assign("springs", value)

    @property
    def anchors(self) -> Array:
        """Values of the components at which springs have no force, ``(num_components,)``."""
        return self.motion.anchors

    @anchors.setter
    def anchors(self, value: npt.ArrayLike):
        self._assign("anchors", value)

    @property
    def displacement(self) -> Array:
        """Displacement t of the reference point, ``(n,)``, the same on every rank."""
        return self.motion.displacement

    @property
    def angles(self) -> Array:
        """Rotations added up, in radians, ``(1,)`` in the plane, ``(3,)`` in space."""
        return self.motion.angles

    @property
    def rotation(self) -> Array:
        """The rotation R, ``(n, n)``; of linear problems that by the small angles."""
        return self.motion.rotation

    @property
    def reaction(self) -> Array:
        """Forces and torques after a solve by which it is held, ``(num_components,)``; 0 if free.

        In space the torque has three components if any rotation is held: those of load steps aren't
        about axes of space alone, but for one axis.
        """
        return self.motion.reaction.copy()


@dataclass(frozen=True)
class PointComponent(Component):
    """The unknowns of a point in the place of a field; its nodes are those that move with it."""

    remedy: ClassVar[str] = "held="
    point: PointMotion

    @classmethod
    def of_point(cls, point: PointMotion) -> "PointComponent":
        """That of a point."""
        V = point.q.function_space
        return cls(V, V, None, point)

    def nodes(self, values: npt.NDArray) -> npt.NDArray:
        """Positions of this rank's owned ones of these nodes, ``(num_nodes, n)``. Collective."""
        arms, point = self.point.own_arms, self.point
        return point.point + arms[:, : point._n] + point.moved(arms, point.shared(values))

    def at_nodes(self, values: npt.NDArray) -> npt.NDArray:
        """Velocities of this rank's owned ones, ``(num_nodes, n)``. Collective."""
        point = self.point
        return point.slopes(point.own_arms, point._values) @ point.shared(values)


def in_space(x: Array) -> Array:
    """Vectors with three components."""
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1])))
