# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Newton steps taken backwards, shortened or lengthened.

Forces between bodies are continuous functions of the displacements, with kinks where nodes pass. A
branch of equilibria can end at a kink, for example where a corner ploughs with friction. The bodies
then snap to another branch, which Newton steps from both sides of the kink never find. Beyond such
an end the Newton step leads back to it, and the tangent does negative work on the step. Then a step
of the same length is taken backwards.

Along other steps d there is a line search for the place where the forces along them, dᵀR, vanish.
R has the step's own pressures. It goes by secants, and ends where less than half of the forces is
left, or reversed.

- Where stiffness was added to a tangent that isn't positive, steps are too short, and at their ends
  the forces may even have grown: a body snaps. Such a step is lengthened, up to the longest step of
  the load step.
- Where a step turns back, and the forces along it are reversed by a jump, it ends at that kink
  (:class:`Kink`).
- Newton's method converges in a few steps, or its steps can go on without an end. So the first ones
  are taken whole also where forces along them are reversed: a slender body that turns is stretched,
  and the next step takes that back. Later ones are shortened.

Gaps are continuous functions of the displacements, with kinks, for example where a corner of Γ0
comes into sight of an edge of Γ1. Contact forces jump there. Where the forces on both sides lead
back to the kink, equilibrium is at it, with forces between these (Clarke's generalised derivative),

.. math:: (1 - \theta)\,C_-^T p + \theta\,C_+^T p , \qquad 0 \le \theta \le 1 .

Newton steps from either side lead across it, and the next ones lead back. Where such a step finds
the forces along it reversed, and most of their change is one jump, the kink is held. As gaps are
continuous, the jump of the forces is normal to the kink. So θ is found such that the solution of
the linearised problem, with its inequalities, ends at the kink, as measured along the jump. If it
ends beyond it with θ = 1, or before it with θ = 0, the kink is left.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.contact_rows import ContactRows
from hypergap_dolfinx.contact_solver.tolerances import OSCILLATES, PATIENCE, SHORTENED, TRIALS
from hypergap_dolfinx.surface.moving import Displacements, Sparse, joined

Array = npt.NDArray[np.float64]
T = TypeVar("T")
Moves = Sequence[Array]
GoTo = Callable[[float], None]
"""Goes to a place on a way across the kink, and finds the gaps there."""


class Continuation:
    """Observer of Newton's iteration in one load step: decides on the lengths of steps."""

    def __init__(self, comm: MPI.Comm, least: float):
        """Start.

        Args:
            comm: Communicator of the bodies.
            least: Displacement treated as zero: shorter steps have no direction.
        """
        self._comm, self._least = comm, least
        self._num_steps, self._num_back, self._is_stiffened = 0, 0, False
        self._square, self._longest, self._along = 0.0, 0.0, 0.0
        self._last_place, self._place = 0.0, 1.0
        self._turns_back = False
        self._last: Moves | None = None

    def share(
        self,
        moves: Moves,
        work: float,
        forces: Callable[[], Moves] | None = None,
        is_stiffened: bool = False,
    ) -> float:
        """Share of the step to take first: 1, or -1 if backwards. Collective.

        Args:
            moves: This rank's increments of each body's displacements.
            work: Second-order work of the step.
            forces: Gives this rank's residual of each body at the step's start, with its pressures;
                None for a step without a line search.
            is_stiffened: True if stiffness was added for this step.
        """
        last = moves if self._last is None else self._last
        self._num_steps, self._is_stiffened = self._num_steps + 1, is_stiffened
        product, square = self._products(moves, last, moves)
        before = self._square
        self._last, self._square, self._along = moves, square, 0.0
        self._last_place, self._place = 0.0, 1.0
        self._longest = max(self._longest, square)
        largest = max((float(np.abs(part).max(initial=0)) for part in moves), default=0.0)
        if self._comm.allreduce(largest, MPI.MAX) <= self._least:
            return 1.0
        self._turns_back = product < OSCILLATES * before
        if self._turns_back and work < 0 and self._num_back < PATIENCE:
            self._num_back, self._last = self._num_back + 1, [-part for part in moves]
            return -1.0
        if forces and (is_stiffened or self._turns_back or self._num_steps > PATIENCE):
            (self._along,) = self._products(moves, forces())
        return 1.0

    def _products(self, moves: Moves, *others: Moves) -> npt.NDArray[np.float64]:
        """Products of increments with others or with forces. Collective."""
        sums = np.array([sum(map(np.dot, moves, other)) for other in others], dtype=float)
        self._comm.Allreduce(MPI.IN_PLACE, sums)
        return sums

    def factor(
        self,
        forces: Callable[[], Moves],
        reaches_kink: Callable[[float, float], bool] = lambda start, end: False,
    ) -> float:
        """Factor by which the line search changes the last step; 1 where it ends. Collective.

        Args:
            forces: Gives this rank's residual of each body at the step's end, with its pressures.
            reaches_kink: Goes to a kink that reverses the forces along the step, from those at its
                start and at its end; false if there is none.
        """
        if self._along >= 0:
            return 1.0
        assert self._last is not None
        place, last_place, start, self._along = self._place, self._last_place, self._along, 0.0
        along = self._comm.allreduce(sum(map(np.dot, self._last, forces()))) / place
        left = along / start
        if self._is_stiffened and left > -OSCILLATES:
            if self._square > SHORTENED**2 * self._longest:
                return 1.0
            self._along = along
        elif left > OSCILLATES or (self._turns_back and reaches_kink(start, along)):
            return 1.0
        elif not self._is_stiffened and self._num_steps <= PATIENCE:
            return 1.0
        zero = last_place + (place - last_place) / max(1 - left, SHORTENED**2)
        factor = float(np.clip(zero / place, SHORTENED, 1 / SHORTENED))
        self._last_place = place
        self._scale(factor)
        return factor

    def shorten(self) -> float:
        """Factor that shortens a step at whose end there is no residual; its search ends."""
        self._along = 0.0
        self._scale(SHORTENED)
        return SHORTENED

    def _scale(self, factor: float):
        """Take another length of the last step, by this factor."""
        self._last = [factor * part for part in self._last or []]
        self._square, self._place = factor**2 * self._square, factor * self._place


class Kink:
    """A kink of gaps at which displacements stay. All is collective, values are on every rank."""

    def __init__(
        self,
        rows: Sequence[ContactRows],
        move: Callable[[Sequence[Array]], None],
    ):
        """Start without one.

        Args:
            rows: The contacts.
            move: Moves bodies to these unknowns of this rank, and finds the gaps there.
        """
        self._rows, self._move = rows, move
        self.is_held = False
        """True if displacements stay at one."""

    def leave(self):
        """Leave it."""
        self.is_held = False

    def find(
        self,
        values: Sequence[Array],
        way: Sequence[Array],
        size: float,
        start: float,
        end: float,
    ):
        """Go to the kink that reverses the forces on a way, and hold it; to its end without one.

        Args:
            values: This rank's unknowns where the way starts.
            way: Their changes along it.
            size: The largest change of a displacement.
            start: Residual along the way at its start, negative.
            end: The same at its end, positive.
        """
        self._closed = min(rows.closed for rows in self._rows)
        self._least = self._closed / size
        self._way, self._share = way, 0.0
        go_to = self._mover(values)
        go_to(0.0)
        first, since = self._forces, self._moves
        go_to(1.0)
        last, d = self._forces, self._moves - since
        of_bodies = end - start + float((last - first) @ d)  # taken as linear
        low, high = (0.0, start), (1.0, end)
        while (place := self._between(low[0], high[0])) is not None:
            go_to(place)
            along = start + place * of_bodies - float((self._forces - first) @ d)
            low, high = ((place, along), high) if along < 0 else (low, (place, along))
        self.is_held = high[1] - low[1] > -OSCILLATES * (end - start)
        if not self.is_held:
            go_to(1.0)
            return
        self._share = low[1] / (low[1] - high[1])
        self._hold(go_to, low[0], high[0])
        self._slope = float(self._jump @ d)
        self._start()

    def stay(self, values: Sequence[Array]):
        """Take the forces on both sides after a step, or leave the kink if it isn't near.

        Args:
            values: This rank's unknowns.
        """
        change = self._moves - self._at
        if np.abs(change).max() > self._closed:
            go_to = self._mover(values)
            ends = self._around(go_to, -float(self._jump @ change) / self._slope)
            if ends is not None:
                self._hold(go_to, *ends)
            go_to(0.0)
            if ends is None:
                self.leave()
                return
        self._start()

    def solved(self, solve: Callable[[], T], moves: Callable[[T], list[Displacements]]) -> T:
        """Solution of the linearised problem that ends at the kink, if one is held.

        Without one there, it has the forces of the side to which it leads, and the kink is left.

        Args:
            solve: Solves it with the present forces.
            moves: Gives a solution's displacements of each contact's sides.
        """
        if not self.is_held:
            return solve()
        start, share, side = self._moves - self._at, self._share, -1
        ends: list[tuple[float, float]] = [(0.0, np.nan), (1.0, np.nan)]
        for _ in range(2 * TRIALS):
            self._share = share
            self._mix(share)
            found = solve()
            d = np.concatenate([u.ravel() for part in moves(found) for u in part])
            place = float(self._jump @ (start + d)) / self._slope
            if abs(place) <= self._least:
                break
            last, side = side, int(place < 0)
            if share == 1 - side:
                self.leave()
                break
            ends[side] = share, place
            if side == last:  # the other end stays: regula falsi of the kind Illinois
                ends[1 - side] = ends[1 - side][0], ends[1 - side][1] / 2
            (a, before), (b, behind) = ends
            known = np.isfinite(before - behind)
            share = (a * behind - b * before) / (behind - before) if known else 1.0 - side
        return found

    def _mover(self, values: Sequence[Array]) -> GoTo:
        """Function that goes to a place on the way, from these unknowns of this rank."""
        return lambda place: self._move(
            [a + place * more for a, more in zip(values, self._way, strict=True)]
        )

    def _around(self, go_to: GoTo, place: float) -> tuple[float, float] | None:
        """Places on both sides of the kink, near to a place; None if it isn't there."""
        square, width = float(self._jump @ self._jump), SHORTENED * abs(place) + self._least
        for _ in range(TRIALS):
            low, high = place - width, place + width
            go_to(low)
            first = self._forces
            go_to(high)
            last = self._forces
            if (last - first) @ self._jump > -OSCILLATES * square:
                break
            width /= SHORTENED
        else:
            return None
        while (middle := self._between(low, high)) is not None:
            go_to(middle)
            is_behind = (self._forces - (first + last) / 2) @ self._jump > 0
            low, high = (low, middle) if is_behind else (middle, high)
        return low, high

    def _between(self, low: float, high: float) -> float | None:
        """The place in the middle; None if these are as near as is treated as zero."""
        place = (low + high) / 2
        return place if high - low > self._least and low < place < high else None

    def _hold(self, go_to: GoTo, low: float, high: float):
        """Find the jump between two places."""
        ends = []
        for place in (low, high):
            go_to(place)
            ends.append(([rows.acting[0] for rows in self._rows], self._forces, self._moves))
        (before, first, self._at), (behind, last, _) = ends
        self._jump, self._middle = last - first, (first + last) / 2
        pairs = zip(before, behind, strict=True)
        self._jumps = [joined(b, _times(-1, a)).summed for a, b in pairs]

    def _start(self):
        """Start from the present displacements, on one of both sides."""
        self._is_behind = bool((self._forces - self._middle) @ self._jump > 0)
        self._own = [rows.acting[0] for rows in self._rows]
        self._mix(self._share)

    def _mix(self, share: float):
        """Take forces between those on both sides."""
        for rows, own, jump in zip(self._rows, self._own, self._jumps, strict=True):
            rows.act_along(joined(own, _times(share - self._is_behind, jump)))

    @property
    def _forces(self) -> Array:
        """Contact forces on both sides of all contacts."""
        return np.concatenate([f.ravel() for rows in self._rows for f in rows.contact_forces()])

    @property
    def _moves(self) -> Array:
        """Displacements there."""
        return np.concatenate([u.ravel() for rows in self._rows for u in rows.u])


def _times(factor: float, matrix: Sparse) -> Sparse:
    return replace(matrix, values=factor * matrix.values)
