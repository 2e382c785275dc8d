# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Rigid motions of bodies that only contact can hold, and messages about bodies that it doesn't."""

from collections.abc import Sequence
from itertools import pairwise

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.blocks import ConstraintBlocks
from hypergap_dolfinx.algebra.displacement import DisplacementField
from hypergap_dolfinx.algebra.rigid_motions import (
    Hindrance,
    mean,
    motions,
    places,
    rotates,
    tied_groups,
)
from hypergap_dolfinx.algebra.tolerances import ASTRAY, DEPENDENT, MOVES, ROTATES
from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.surface.component import Component


class FreeMotions:
    """Combinations of rigid motions that neither boundary conditions nor ties hinder."""

    def __init__(
        self,
        fields: Sequence[DisplacementField],
        K: Sequence[PETSc.Mat],
        ties: ConstraintBlocks,
        without: Sequence[int] = (),
    ):
        """Find them. Collective.

        Args:
            fields: Displacements of each body.
            K: Stiffness of each body without stress, assembled.
            ties: The ties.
            without: Numbers of interfaces that hinder nothing.
        """
        self._fields = [field.part for field in fields]
        spaces = self._spaces = [part.space for part in self._fields]
        self.parts = [field.parts for field in fields]
        """:func:`~hypergap_dolfinx.core.graph.parts` of each body."""
        self.places = [places(V) for V in spaces]
        """Initial positions of this rank's owned nodes of each body, ``(num_nodes, n)`` each."""
        bodies = [x for V, x in zip(spaces, self.places, strict=True) if rotates(V)]
        self._centre = mean(spaces[0].mesh.comm, bodies or self.places)
        self._sizes: list[npt.NDArray[np.float64] | None] = [None] * len(spaces)
        modes = [self._modes(i, x) for i, x in enumerate(self.places)]
        ends = np.cumsum([0, *(part.shape[1] for part in modes)])
        rows = [np.ones(next(B for B in row if B).getLocalSize()[0], bool) for row in ties.free]
        for g in without:
            rows[g][:] = False
        numbered = list(enumerate(self._fields))
        hindrance = Hindrance(numbered, K, ties, modes)
        alone = hindrance.unhindered(rows)
        # Tied bodies move as one, even if that strains a tie by an error of its mesh
        groups, apart = tied_groups(numbered, self.parts, self.places, ties)
        together = np.zeros((0, ends[-1]))
        for g in range(max(int(group.max()) for group in groups) + 1):
            common = self._common(groups, g)
            found = hindrance.unhindered(apart, common)
            together = np.vstack((together, found @ common.T))
        _, values, found = np.linalg.svd(np.vstack((alone, together)), full_matrices=False)
        found = found[values > DEPENDENT]
        self._combinations = [found[:, a:b].T for a, b in pairwise(ends)]

    def _common(self, groups, g: int) -> npt.NDArray[np.float64]:
        """A group's modes as combinations of its parts' ones, of length 1, ``(num_modes, num)``."""
        columns = []
        for group, size in zip(groups, self._sizes, strict=True):
            assert size is not None
            size = size.reshape(len(group), -1, 1) * (group == g)[:, None, None]
            columns.append((size * np.eye(size.shape[1])).reshape(-1, size.shape[1]))
        common = np.vstack(columns)
        return common / np.linalg.norm(common, axis=0)

    @property
    def num(self) -> int:
        """Number of free motions."""
        return self._combinations[0].shape[1]

    def at(self, i: int, u: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """The motions of a body at its present position. Collective.

        Args:
            i: Number of the body.
            u: This rank's owned dofs of the body, ``(num_dofs,)``.

        Returns:
            This rank's owned rows, ``(num_dofs, num)``.
        """
        x = self.places[i]
        if not self._combinations[i].any():  # it is held
            return np.zeros((len(u), self.num))
        u = self._fields[i].of_body(u)
        if rotates(self._spaces[i]):  # not unknowns of a rigid body
            x = x + u.reshape(x.shape)
        modes = self._modes(i, x) @ self._combinations[i]
        return self._fields[i].into_body(modes)

    def _modes(self, i: int, x) -> npt.NDArray[np.float64]:
        """Rigid motions of a body's parts, of length 1 in its initial position. Collective."""
        V, (part, num_parts) = self._spaces[i], self.parts[i]
        comm, part = V.mesh.comm, np.repeat(part, V.dofmap.index_map_bs)[:, None]
        modes = motions(V, self._centre, x)
        modes = np.hstack([np.where(part == p, modes, 0) for p in range(num_parts)])
        size = self._sizes[i]
        if size is None:
            size = np.sqrt(np.maximum(comm.allreduce((modes**2).sum(axis=0)), 1e-300))
            self._sizes[i] = size
        return modes / size


class RigidBodyDiagnostics:
    """Messages about bodies that only contact holds: which ones move, and how."""

    def __init__(self, parts_of: Sequence[Component], free: FreeMotions, names: Sequence[str]):
        """Find the bodies that can move.

        Args:
            parts_of: Displacements of each body among its fields.
            free: The motions that nothing but contact holds.
            names: Names of the bodies in messages.
        """
        self._fields, self._free, self._names = parts_of, free, names
        self._comm = parts_of[0].space.mesh.comm
        none = [part.into_body(0 * places(part.space).ravel()) for part in parts_of]
        sizes = [(free.at(i, u) ** 2).sum() for i, u in enumerate(none)]
        sizes = np.sqrt(self._comm.allreduce(np.array(sizes)))
        self._moves = sizes > MOVES * sizes.max()

    @property
    def remedy(self) -> str:
        """How users hold the bodies that can move."""
        moving = [part.remedy for part, moves in zip(self._fields, self._moves) if moves]
        return " or ".join(dict.fromkeys(moving))

    def unheld(
        self,
        before: Sequence[npt.NDArray[np.float64]],
        u: Sequence[npt.NDArray[np.float64]],
        holds: npt.NDArray[np.float64],
        num: int,
        friction: bool,
    ) -> str:
        """Message about motions that not even contact holds. Collective.

        Args:
            before: As of :meth:`moving`.
            u: This rank's owned displacements of each body, ``(num_dofs,)``.
            holds: Active rows of contact times the free motions, ``(num_rows, num_free)``.
            num: Number of motions that nothing holds.
            friction: True if there is friction.
        """
        slid = ": it fell or slid away, its load may be more than friction can hold"
        return (
            f"{num} rigid motion{'s'[: num > 1]} of the bodies {'are' if num > 1 else 'is'} held "
            f"by nothing, not even by contact{slid if friction else ', which has no friction'}: "
            f"{self.moving(u, holds, before)}; hold them by {self.remedy}."
        )

    def _combinations(self, holds) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Combinations of free motions, and how much rows hold each of them."""
        size = np.maximum(np.linalg.norm(holds, axis=1), 1e-300)
        rows = np.vstack((holds / size[:, None], np.zeros((self._free.num,) * 2)))
        _, values, combinations = np.linalg.svd(rows)
        return combinations, values

    def num_left(self, holds: npt.NDArray[np.float64]) -> int:
        """Number of free motions that rows of contact leave, ``(num_rows, num_free)``."""
        return int((self._combinations(holds)[1] <= MOVES).sum())

    def moving(
        self,
        u: Sequence[npt.NDArray[np.float64]],
        holds: npt.NDArray[np.float64],
        before: Sequence[npt.NDArray[np.float64]] | None = None,
    ) -> str:
        """The bodies that nothing holds, and how each moves if that is one motion. Collective.

        Args:
            u: This rank's owned displacements of each body, ``(num_dofs,)``.
            holds: Rows of contact times the free motions, ``(num_rows, num_free)``.
            before: Displacements of the bodies where they are said to be; those by default.
        """
        combinations, values = self._combinations(holds)
        left = combinations[values <= max(MOVES, values[-1])].T
        moving = [self._free.at(i, part) @ left for i, part in enumerate(u)]
        sizes = np.sqrt(self._comm.allreduce(np.array([(v**2).sum(axis=0) for v in moving])))
        messages = []
        for i, (f, some) in enumerate(zip(self._fields, sizes > MOVES * sizes.max(), strict=True)):
            if not some.any():
                continue
            v = f.at_nodes(moving[i][:, some.argmax()])
            on = self._moving_nodes(v)
            x, v = f.nodes(u[i])[on], v[on]
            if before is not None:
                x = x - mean(self._comm, [x - f.nodes(before[i])[on]])
            how = f", {in_words(self._comm, x, v)}" if some.sum() == 1 else ""
            messages.append(f"{self._names[i]}, at {spot(mean(self._comm, [x]))}{how}")
        return "; ".join(messages)

    def _moving_nodes(self, v) -> npt.NDArray[np.bool_]:
        """Mask of a body's nodes in the parts that move, by their velocities. Collective."""
        speed = np.linalg.norm(v, axis=1)
        return speed > MOVES * self._comm.allreduce(speed.max(initial=0), MPI.MAX)

    def lost(
        self,
        before: Sequence[npt.NDArray[np.float64]],
        now: Sequence[npt.NDArray[np.float64]],
        message: str,
    ) -> str:
        """Sentence about where a failed load step led bodies that only contact holds. Collective.

        Args:
            before: This rank's owned displacements of each body at its start.
            now: Those where it failed.
            message: Message about the failure.
        """
        only, off = [], []
        for i, (f, start, end) in enumerate(zip(self._fields, before, now, strict=True)):
            if not self._moves[i]:
                continue
            x = f.nodes(start)
            way = f.nodes(end) - x
            middle, shift = mean(self._comm, [x]), mean(self._comm, [way])
            extent = 2 * np.sqrt(mean(self._comm, [(x - middle) ** 2]).sum())
            only.append(f"{self._names[i]} at {spot(middle)}")
            if np.isfinite(shift).all() and np.linalg.norm(shift) > ASTRAY * extent:
                off.append(
                    f"{only[-1]} had gone by {spot(shift)}: it falls, slides off or is ejected"
                )
        if off:
            return f" Then {'; '.join(off)}."
        known = not only or any(f"{one.split(' at ')[0]}," in message for one in only)
        return "" if known else f" Only contact holds {', '.join(only)}."

    def of(self, bodies: Sequence[int | None]) -> str:
        """Names of the bodies, among given ones, that only contact holds."""
        some = [self._names[i] for i in bodies if i is not None and self._moves[i]]
        return " or ".join(some) or "a body"


def in_words(comm: MPI.Comm, x: npt.NDArray[np.float64], v: npt.NDArray[np.float64]) -> str:
    """A rigid motion in words. Collective.

    Args:
        comm: Communicator.
        x: This rank's places, ``(num, n)``.
        v: Their velocities, ``(num, n)``.
    """
    n, middle, shift = x.shape[1], mean(comm, [x]), mean(comm, [v])
    r, w = (np.pad(part, ((0, 0), (0, 3 - n))) for part in (x - middle, v - shift))
    square, num = comm.allreduce((r**2).sum()), comm.allreduce(len(x))
    inertia = square * np.eye(3) - comm.allreduce(r.T @ r)
    spin = np.linalg.pinv(inertia) @ comm.allreduce(np.cross(r, w).sum(axis=0))
    rate = np.linalg.norm(spin)
    if rate * np.sqrt(square / num) <= ROTATES * np.linalg.norm(shift):
        return f"along {_direction(shift)}"
    around = middle + (np.cross(spin, np.pad(shift, (0, 3 - n))) / rate**2)[:n]
    axis = f" on the axis {_direction(spin)}" if n == 3 else ""
    return f"that turns around {spot(around)}{axis}"


def _direction(v: npt.NDArray[np.float64]) -> str:
    """A unit vector to three digits, with a fixed sign: that of a motion is arbitrary."""
    v = np.round(v / np.linalg.norm(v), 3)
    return spot(v * np.sign(v[v != 0][0]))
