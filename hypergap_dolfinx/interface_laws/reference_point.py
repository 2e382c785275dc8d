# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Unknowns of a point that moves and turns, under forces, torques and springs, or held."""

from collections.abc import Sequence
from math import factorial
from typing import ClassVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx.mesh
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.interface_laws.given_values import as_numbers

Array = npt.NDArray[np.float64]
COMPONENTS = {2: ("x", "y", "rotation"), 3: ("x", "y", "z", "rx", "ry", "rz")}


class ReferencePoint:
    """Displacement and rotation of a point: free, in springs, or held, under force and torque."""

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
        self._point = given
        self._held = np.array([name in held for name in self.components])
        num, across = len(self.components), len(self.components) - n
        self._rotates = slice(0, 3) if n == 3 else slice(2, 3)  # of a rotation vector
        self._force, self._torque = np.zeros(n), np.zeros(across)
        self._prescribed, self._springs, self._anchors = np.zeros((3, num))
        self._values, self._reaction = np.zeros((2, num))

    def _make_unknowns(self, length: float):
        """Function of the unknowns, on one cell of volume 1, and its forms. Collective.

        Args:
            length: Unit of rotations, which are unknowns times a length.
        """
        self._length = length
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

    # What users set and read

    def _assign(self, name: str, value: npt.ArrayLike):
        """Set one of the arrays in which users change values."""
        array = getattr(self, name)
        array[:] = as_numbers(value, array.shape, f"the {name} of {self.NAME}")

    @property
    def held(self) -> npt.NDArray[np.bool_]:
        """Mask of the components that are held, ``(num_components,)``; not to be changed."""
        return self._held

    @held.setter
    def held(self, value):
        raise ValueError(f"held is for good: make {self.NAME} with held={value!r}.")

    @property
    def point(self) -> Array:
        """The reference point X₀, ``(n,)``."""
        return self._point.copy()

    @property
    def force(self) -> Array:
        """Force at the reference point, ``(n,)``."""
        return self._force

    @force.setter
    def force(self, value: npt.ArrayLike):
        self._assign("force", value)

    @property
    def torque(self) -> Array:
        """Torque about the reference point, ``(1,)`` in the plane, ``(3,)`` about axes of space."""
        return self._torque

    @torque.setter
    def torque(self, value: npt.ArrayLike):
        self._assign("torque", value)

    @property
    def prescribed(self) -> Array:
        """Values of what is held: displacements of the point, and angles, ``(num_components,)``."""
        return self._prescribed

    @prescribed.setter
    def prescribed(self, value: npt.ArrayLike):
        self._assign("prescribed", value)

    @property
    def springs(self) -> Array:
        """Stiffness of springs to the anchors, ``(num_components,)``; 0 for none."""
        return self._springs

    @springs.setter
    def springs(self, value: npt.ArrayLike):
        self._assign("springs", value)

    @property
    def anchors(self) -> Array:
        """Values of the components at which springs have no force, ``(num_components,)``."""
        return self._anchors

    @anchors.setter
    def anchors(self, value: npt.ArrayLike):
        self._assign("anchors", value)

    @property
    def displacement(self) -> Array:
        """Displacement t of the reference point, ``(n,)``, the same on every rank."""
        return self._values[: self._n].copy()

    @property
    def angles(self) -> Array:
        """Rotations added up, in radians, ``(1,)`` in the plane, ``(3,)`` in space."""
        return self._values[self._n :] / self._length

    @property
    def reaction(self) -> Array:
        """Forces and torques that hold it, after a solve, ``(num_components,)``; 0 if free."""
        return self._reaction.copy()

    # What a problem asks for

    @property
    def given(self) -> list[Array]:
        """Arrays in which a user changes its values."""
        return [self._force, self._torque, self._prescribed, self._springs, self._anchors]

    def wrong(self) -> str | None:
        """Message about values that are contradictory, or None."""
        at = np.flatnonzero((self._prescribed != 0) & ~self.held)
        if len(at):
            name = self.components[at[0]]
            return (
                f"a value is prescribed for {name} of {self.NAME}, which isn't held: make the "
                f"{self.NAME.removeprefix('a ')} with held={name!r}, or set 0."
            )
        if (self._springs < 0).any():
            return (
                f"a spring of {self.NAME} has the stiffness {self._springs.min():.3g}; give "
                "numbers ≥ 0."
            )
        return None

    def read(self, *, springs: bool = True):
        """Set the constants of its forms from what the user has set.

        Args:
            springs: False to leave out the stiffness of springs.
        """
        self._set(self._torque, springs)

    def _set(self, torque: Array, springs: bool):
        """The same, with generalised forces of a rotation in place of the torque."""
        load = np.append(self._force, torque) + self._springs * self._anchors
        self._load.value[:] = load * self._units
        self._own.value[:] = springs * self._springs * self._units**2
        for goal, value in zip(self._goals, self._prescribed / self._units, strict=True):
            goal.value = value

    def shared(self, values: npt.NDArray) -> Array:
        """Values of its unknowns on every rank, from this rank's. Collective."""
        return self._comm.bcast(np.array(values[: len(self.components)]))  # rank 0 has the cell


def in_space(x: Array) -> Array:
    """Vectors with three components."""
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1])))
