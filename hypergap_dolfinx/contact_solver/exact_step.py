# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One linearised contact problem, solved exactly: its factors, and a small dense problem of changes.

The problem is min ½ dᵀHd + rᵀd subject to g + Cd ≥ 0. With a working set A it is the linear system
S = [H C_Aᵀ; C_A −c]. Where a pressure in A comes out negative, or a gap outside, such rows get
another unknown: a slack z_a of a row of A, a pressure z_b outside. As all depends linearly on z,
with right-hand sides of S alone, that is a linear complementarity problem of a few rows
(:mod:`~hypergap_dolfinx.contact_solver.complementarity`): nothing is factorised again. Rows whose
sign becomes wrong by that join, until there are none. The matrix is a principal pivot of
C H⁻¹ Cᵀ, so the solution is unique if H is positive where the rows that push stay closed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver import complementarity
from hypergap_dolfinx.contact_solver.contact_rows import ContactRows, Linear
from hypergap_dolfinx.contact_solver.tangent import Tangent


@dataclass(frozen=True)
class Found:
    """Solution of a linearised contact problem."""

    changes: list[npt.NDArray[np.float64]]
    """This rank's solution of bodies and ties."""
    unknowns: list[npt.NDArray[np.float64]]
    """Multipliers of each contact, in the matrix's units, ``(num_multipliers,)``."""
    active: list[npt.NDArray[np.bool_]]
    """Active set of each contact, ``(num_multipliers,)``."""
    is_solved: bool
    """False if there is none: then it is that of the working set, some of which pulls."""
    num: int
    """Number of right-hand sides beside the first."""
    base: list[npt.NDArray[np.float64]]
    """Multipliers of the working set, in the matrix's units."""


class LinearisedContact:
    """A linearised contact problem of several contacts. All is collective."""

    def __init__(
        self,
        tangent: Tangent,
        rows: Sequence[ContactRows],
        equations: Sequence[Linear],
        stiffness: float,
        zero: float,
    ):
        """Store what it consists of.

        Args:
            tangent: The matrix.
            rows: The contacts, with their working sets.
            equations: Their equations with these.
            stiffness: Stiffness of the bodies' nodes, by which rows are scaled.
            zero: Pressure treated as zero.
        """
        self._tangent, self._rows, self._equations = tangent, rows, equations
        self._stiffness = stiffness
        self._on = np.concatenate([part.state.active for part in rows])
        self._least = np.concatenate([part.least(stiffness, zero) for part in rows])
        self._comm = rows[0].spaces[0].mesh.comm

    def solve(self, right: Sequence[npt.NDArray], shift: tuple[float, float]) -> Found:
        """Solve it.

        Args:
            right: This rank's right-hand side of bodies and ties.
            shift: As for :meth:`Tangent.solve`.

        Raises:
            SolveError: The linear solver failed.
        """
        changes, unknowns = self._tangent.solve(right, self._equations, shift=shift)
        self._base = unknowns
        w = self._signs(changes, unknowns)
        if not (w < -self._least).any():
            return self._found(changes, unknowns, self._on, solved=True, num=0)
        if self._tangent.has_old_factors:
            changes, unknowns = self._tangent.solve(right, self._equations, shift=shift, anew=True)
            w = self._signs(changes, unknowns)
        start, of = w, np.empty(0, dtype=np.intp)
        watch = self._tangent.watch([part.watched(self._stiffness) for part in self._rows])
        side = np.where(self._on, -1.0, 1.0)
        soft = np.concatenate([part.give(self._stiffness) for part in self._rows])
        M, z = np.empty((len(w), 0)), np.empty(0)
        while True:
            more = np.flatnonzero(w < -self._least)
            more = more[~np.isin(more, of)]
            if not len(more):
                break
            loads = watch[more]
            columns = watch @ self._tangent.responses(loads)
            self._comm.Allreduce(MPI.IN_PLACE, columns)
            columns *= side[:, None]
            columns[more, np.arange(len(more))] += soft[more]
            M, of = np.hstack((M, columns)), np.append(of, more)
            found = complementarity.solved(M[of], start[of], self._least[of])
            if found is None:
                return self._found(changes, unknowns, self._on, solved=False, num=len(of))
            z, closed = found
            w = start + M @ z
        active, every = self._on.copy(), np.zeros(len(w))
        every[of] = z
        active[of] = np.where(self._on[of], ~closed, closed)
        changes, unknowns = self._tangent.solve(
            right, self._equations, shift=shift, beside=watch.T @ every, anew=True
        )
        unknowns = [
            np.where(part.state.active, values, new / np.sqrt(self._stiffness))
            for part, values, new in zip(self._rows, unknowns, self._split(every), strict=True)
        ]
        return self._found(changes, unknowns, active, solved=True, num=len(of))

    def _signs(self, changes, unknowns) -> npt.NDArray[np.float64]:
        """What mustn't be negative: new gaps outside of the working set, multipliers in it."""
        return np.concatenate(
            [
                part.signs(changes, values, self._stiffness)
                for part, values in zip(self._rows, unknowns, strict=True)
            ]
        )

    def _split(self, values: npt.NDArray) -> list[npt.NDArray]:
        """Values by contact."""
        return np.split(values, np.cumsum([len(part.g) for part in self._rows])[:-1])

    def _found(self, changes, unknowns, active, *, solved: bool, num: int) -> Found:
        unknowns = [
            np.where(on, values, 0)
            for on, values in zip(self._split(active), unknowns, strict=True)
        ]
        return Found(changes, unknowns, self._split(active), solved, num, self._base)
