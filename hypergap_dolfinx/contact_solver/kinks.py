# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Equilibria at kinks of gaps.

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

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.contact_rows import ContactRows
from hypergap_dolfinx.contact_solver.tolerances import OSCILLATES, SHORTENED, TRIALS
from hypergap_dolfinx.surface.moving import Displacements, Sparse, joined

Array = npt.NDArray[np.float64]
T = TypeVar("T")
GoTo = Callable[[float], None]
"""Goes to a place on a way across the kink, and finds the gaps there."""


class Kink:
    """A kink of gaps that is held. All is collective, values are the same on every rank."""

    def __init__(
        self, rows: Sequence[ContactRows], way: Sequence[Array], size: float, closed: float
    ):
        """Look for one on a way.

        Args:
            rows: The contacts.
            way: This rank's changes of the unknowns.
            size: The largest one.
            closed: Displacement treated as zero.
        """
        self._rows, self.way = rows, way
        self._closed, self._least = closed, closed / size
        self._share = 0.0

    def find(self, go_to: GoTo, start: float, end: float) -> bool:
        """Go to the kink that reverses the forces on the way; false if there is none.

        Args:
            go_to: For places from 0 to 1.
            start: Residual along the way at its start, negative.
            end: The same at its end, positive.
        """
        go_to(0.0)
        first, since = self._forces, self._moves
        go_to(1.0)
        last, d = self._forces, self._moves - since
        of_bodies = end - start + float((last - first) @ d)  # taken as linear
        low, high = (0.0, start), (1.0, end)
        while high[0] - low[0] > self._least:
            place = (low[0] + high[0]) / 2
            go_to(place)
            along = start + place * of_bodies - float((self._forces - first) @ d)
            low, high = ((place, along), high) if along < 0 else (low, (place, along))
        if not high[1] - low[1] > -OSCILLATES * (end - start):
            return False
        self._share = low[1] / (low[1] - high[1])
        self._hold(go_to, low[0], high[0])
        self._slope = float(self._jump @ d)
        self._start()
        return True

    def is_near(self, go_to: GoTo) -> bool:
        """Find the forces on both sides after a step; false if the kink isn't near.

        Args:
            go_to: For places along its way, 0 where the step ended.
        """
        change = self._moves - self._at
        if np.abs(change).max() > self._closed:
            ends = self._around(go_to, -float(self._jump @ change) / self._slope)
            if ends is not None:
                self._hold(go_to, *ends)
            go_to(0.0)
            if ends is None:
                return False
        self._start()
        return True

    def solved(self, solve: Callable[[], tuple[T, list[Displacements]]]) -> tuple[T, bool]:
        """Solution of the linearised problem that ends at the kink, and whether there is one.

        Else the one with the forces of the side to which it leads.

        Args:
            solve: Solves it with the present forces; gives the solution, and its displacements of
                each contact's sides.
        """
        start, share, side = self._moves - self._at, self._share, -1
        ends: list[tuple[float, float]] = [(0.0, np.nan), (1.0, np.nan)]
        for _ in range(2 * TRIALS):
            self._mix(share)
            found, moves = solve()
            d = np.concatenate([u.ravel() for part in moves for u in part])
            place = float(self._jump @ (start + d)) / self._slope
            if abs(place) <= self._least:
                break
            last, side = side, int(place < 0)
            if share == 1 - side:
                return found, False
            ends[side] = share, place
            if side == last:  # the other end stays: regula falsi of the kind Illinois
                ends[1 - side] = ends[1 - side][0], ends[1 - side][1] / 2
            (a, before), (b, behind) = ends
            known = np.isfinite(before - behind)
            share = (a * behind - b * before) / (behind - before) if known else 1.0 - side
        self._share = share
        return found, True

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
        while high - low > self._least:
            place = (low + high) / 2
            go_to(place)
            is_behind = (self._forces - (first + last) / 2) @ self._jump > 0
            low, high = (low, place) if is_behind else (place, high)
        return low, high

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
