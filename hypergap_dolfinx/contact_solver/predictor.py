# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Predictor: displacements from which Newton's iteration of a load step starts.

Bodies in contact that are prescribed to move far, or to turn together, are moved as rigid ones:
linear steps would distort rotations. Without contact displacements go on as in the last load step.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.algebra.floating import FreeMotions
from hypergap_dolfinx.contact_solver.contact_rows import ContactRows
from hypergap_dolfinx.contact_solver.tolerances import HOLDS
from hypergap_dolfinx.core.graph import parts_at


@dataclass(frozen=True)
class RigidMotion:
    """A rotation around a point, and a translation of this point."""

    turn: npt.NDArray[np.float64]
    """``(n, n)``."""
    start: npt.NDArray[np.float64]
    end: npt.NDArray[np.float64]

    @property
    def turns(self) -> bool:
        """True if it has a rotation."""
        return bool(np.linalg.norm(self.turn - np.eye(len(self.end))) > HOLDS)

    def shift(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Displacements of points, ``(num, n)`` each."""
        return (x - self.start) @ self.turn.T + self.end - x


@dataclass(frozen=True)
class PartsMotion:
    """A rigid motion of each connected part of a body's mesh."""

    part: npt.NDArray[np.int32]
    """Part of each of this rank's owned nodes, ``(num_nodes,)``."""
    of_parts: list[RigidMotion]

    @property
    def turns(self) -> bool:
        """True if a part turns."""
        return any(motion.turns for motion in self.of_parts)

    def shift(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Displacements of this rank's owned nodes at x, ``(num_nodes, n)`` each."""
        each = [motion.shift(x) for motion in self.of_parts]
        return np.stack(each)[self.part, np.arange(len(x))]

    def of_nodes(self, V: fem.FunctionSpace, nodes: npt.NDArray[np.int64]) -> RigidMotion | None:
        """Motion of some of the body's nodes, None if they are of several parts. Collective.

        Args:
            V: The body's space.
            nodes: Their global numbers, the same on every rank.
        """
        found = parts_at(V, self.part, nodes)
        return self.of_parts[min(found)] if len(found) == 1 else None


def leading(
    comm: MPI.Comm, x: npt.NDArray[np.float64], moves: npt.NDArray[np.float64]
) -> RigidMotion | None:
    """Rigid motion nearest to the displacements of points; None if undetermined. Collective.

    Args:
        comm: Communicator.
        x: This rank's points, ``(num, n)``.
        moves: Their displacements, ``(num, n)``.
    """
    n, ends = x.shape[1], np.stack((x, x + moves))
    num = comm.allreduce(len(x))
    if not num:
        return None
    if not comm.allreduce(bool(moves.any()), MPI.LOR):
        return RigidMotion(np.eye(n), np.zeros(n), np.zeros(n))
    middles = ends.sum(axis=1)
    comm.Allreduce(MPI.IN_PLACE, middles)
    middles /= num
    before, after = ends - middles[:, None]
    products = np.array((before.T @ before, after.T @ before))
    comm.Allreduce(MPI.IN_PLACE, products)
    square, product = products
    extents = np.linalg.eigvalsh(square)
    if extents[1 - n] <= HOLDS**2 * extents[-1]:
        return None
    left, _, right = np.linalg.svd(product)
    left[:, -1] *= np.linalg.det(left @ right)  # no reflection
    return RigidMotion(left @ right, *middles)


def prescribed_motions(
    comm: MPI.Comm,
    bodies: FreeMotions,
    u: Sequence[npt.NDArray[np.float64]],
    moves: Sequence[npt.NDArray[np.float64]],
    held: Sequence[npt.NDArray[np.bool_]],
) -> list[PartsMotion | None]:
    """Rigid motions of each body by its prescribed increments; None if undetermined. Collective.

    Args:
        comm: Communicator.
        bodies: The bodies' nodes.
        u: Their displacements, ``(num_dofs,)`` each.
        moves: Increments that prescribed ones still have to make, likewise.
        held: Mask of prescribed ones, likewise.
    """
    found: list[PartsMotion | None] = []
    each = zip(bodies.places, bodies.parts, u, moves, held, strict=True)
    for x, (part, num_parts), now, way, on in each:
        whole = on.reshape(x.shape).all(axis=1)
        x, way = x + now.reshape(x.shape), way.reshape(x.shape)
        of_parts = [leading(comm, x[at], way[at]) for at in whole & (part == np.c_[:num_parts])]
        known = [motion for motion in of_parts if motion is not None]
        found.append(PartsMotion(part, known) if len(known) == num_parts else None)
    return found


def motions_of(
    rows: ContactRows, motions: Sequence[PartsMotion]
) -> tuple[list[RigidMotion | None], float]:
    """Rigid motions of a contact's sides, and how far they separate these. Collective.

    Args:
        rows: The contact.
        motions: Motion of each body; those of rigid bodies are found here.

    Returns:
        Both motions, and the distance in facet sizes, infinite if one is undetermined.
    """
    assert rows.start is not None
    now = rows.displacements([f.x.array for f in rows.fields])
    x0, x1 = (side.displaced(u).x for side, u in zip(rows.sides, rows.start, strict=True))
    found: list[RigidMotion | None] = []
    each = zip(rows.bodies, rows.components, rows.sides, (x0, x1), now, strict=True)
    for body, part, side, x, u in each:
        if body is None:
            found.append(leading(MPI.COMM_SELF, x, side.displaced(u).x - x))
        else:
            found.append(motions[body].of_nodes(part.space, side.dofs))
    motion0, motion1 = found
    if motion0 is None or motion1 is None:
        return found, np.inf
    shift0, shift1 = motion0.shift(x1), motion1.shift(x1)
    return found, np.abs(shift1 - shift0).max() / rows.sides[1].reference.size.max()


def turns_together(a: RigidMotion, b: RigidMotion) -> bool:
    """True if both rotate, and differ by less than either of them does from rest."""
    least = min(float(np.linalg.norm(motion.turn - np.eye(len(a.end)))) for motion in (a, b))
    return least > HOLDS and float(np.linalg.norm(a.turn - b.turn)) < least


class Extrapolation:
    """Displacements that go on as in the last load step, as far as the load does.

    With increments Δℓ of all values that a user changes, each over its size, and those of the last
    load step, Δℓ' and Δu', displacements change by s Δu', where s = Δℓ·Δℓ' / Δℓ'·Δℓ' is between 0
    (a load that turns back, or another one) and 1.
    """

    def __init__(self, comm: MPI.Comm):
        """Start without a last load step.

        Args:
            comm: Communicator of the bodies.
        """
        self._comm = comm
        self.forget()

    def forget(self):
        """Forget the last load step."""
        self.remember((), (), (), in_contact=True)

    def remember(
        self,
        load: Sequence[npt.NDArray],
        start: Sequence[npt.NDArray],
        end: Sequence[npt.NDArray],
        *,
        in_contact: bool,
    ):
        """Remember a solved load step.

        Args:
            load: Increments of the values that this rank owns.
            start: This rank's unknowns before it.
            end: The same after it.
            in_contact: True if a pressure acted before or after it.
        """
        self._load, self._start, self._end = list(load), list(start), list(end)
        self.in_contact = in_contact
        """True if a pressure acted before or after the last load step."""

    def changes(
        self, load: Sequence[npt.NDArray], now: Sequence[npt.NDArray]
    ) -> list[npt.NDArray] | None:
        """Changes of this rank's unknowns; None if they are zero. Collective.

        Args:
            load: Increments of the values that this rank owns.
            now: This rank's unknowns; where a user has set them, nothing goes on.
        """
        goes_on = bool(self._end) and all(map(np.array_equal, now, self._end))
        if not self._comm.allreduce(goes_on, MPI.LAND):
            return None
        pairs = zip(load, self._load, strict=True)
        found = [[np.vdot(x, y).real for x, y in ((a, a), (b, b), (a, b))] for a, b in pairs]
        products = np.array(found, dtype=float).reshape(-1, 3)
        self._comm.Allreduce(MPI.IN_PLACE, products)
        sizes = products[:, :2].max(axis=1, initial=np.finfo(float).tiny)
        _, last, along = (products / sizes[:, None]).sum(axis=0)
        if not along > np.finfo(float).eps * last:
            return None
        share = min(along / last, 1.0)
        return [share * (b - a) for a, b in zip(self._start, self._end, strict=True)]
