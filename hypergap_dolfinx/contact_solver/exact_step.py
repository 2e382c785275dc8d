# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One linearised contact problem, solved exactly: its factors, and a small dense problem of changes.

Without friction it is min ½ dᵀHd + rᵀd subject to g + Cd ≥ 0. With a working set A it is the linear
system S = [H C_Aᵀ; C_A −c]. Where a pressure in A comes out negative, or a gap outside, such rows
get another unknown: a slack z_a of a row of A, a pressure z_b outside. As all depends linearly on z,
with right-hand sides of S alone, that is a linear complementarity problem of a few rows
(:mod:`~hypergap_dolfinx.contact_solver.complementarity`): nothing is factorised again. Rows whose
sign becomes wrong by that join, until there are none. The matrix is a principal pivot of
C H⁻¹ Cᵀ, so the solution is unique if H is positive where the rows that push stay closed.

With friction a multiplier has n equations, of the gap and of slip, that stick or slip; those that
change get n unknowns each. Then the small problem has Coulomb's law, which a semi-smooth Newton
iteration solves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver import complementarity
from hypergap_dolfinx.contact_solver.contact_rows import ContactRows, Linear
from hypergap_dolfinx.contact_solver.tangent import Tangent
from hypergap_dolfinx.contact_solver.tolerances import DENSE, ENOUGH, SHORTEST

import os
DEBUG = int(os.environ.get("DEBUGC", 0))
Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Found:
    """Solution of a linearised contact problem."""

    changes: list[Array]
    """What is subtracted from this rank's unknowns of bodies and ties."""
    y: list[Array]
    """Gaps and slips of each contact over areas times √stiffness, flat."""
    f: list[Array]
    """Pressures and tractions, times areas over √stiffness, likewise."""
    changed: list[npt.NDArray[np.bool_]]
    """Those that were unknowns of the small problem, likewise."""
    is_solved: bool
    """False if it has no solution: then it is that of the working set."""
    num: int
    """Number of right-hand sides beside the first."""


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
        self._stiffness, self._zero = stiffness, zero
        self._comm = rows[0].spaces[0].mesh.comm
        self._ends = np.cumsum([part.num_unknowns for part in rows])[:-1]

    def solve(self, right: Sequence[npt.NDArray], shift: tuple[float, float]) -> Found:
        """Solve it.

        Args:
            right: This rank's right-hand side of bodies and ties.
            shift: As for :meth:`Tangent.solve`.

        Raises:
            SolveError: The linear solver failed.
        """
        changes, y, f = self._base(right, shift)
        more = self._wrong(y, f)
        if not len(more):
            return self._found(changes, y, f, more, solved=True)
        if self._tangent.has_old_factors:
            changes, y, f = self._base(right, shift, anew=True)
            more = self._wrong(y, f)
        self.base = f
        y0, f0, of, z = y, f, np.empty(0, dtype=np.intp), np.empty(0)
        active = np.concatenate([part.is_in for part in self._rows])
        gaps, forces, loads = (
            self._tangent.watch(
                [getattr(part, name)(self._stiffness) for part in self._rows],
                [part.num_unknowns for part in self._rows],
            )
            for name in ("watched_gaps", "watched_forces", "loads")
        )
        soft = np.concatenate([part.give(self._stiffness) for part in self._rows])
        A, B = np.empty((len(y), 0)), np.empty((len(y), 0))
        while len(more):
            X = self._tangent.responses(loads[more])
            both = np.stack((gaps @ X, forces @ X))
            self._comm.Allreduce(MPI.IN_PLACE, both)
            by_gap, by_force = both[0], -both[1]
            k = np.arange(len(more))
            by_force[more, k] += ~active[more]
            by_gap += soft[:, None] * by_force
            A, B, of = np.hstack((A, by_force)), np.hstack((B, by_gap)), np.append(of, more)
            z = np.append(z, np.zeros(len(more)))
            found = self._small(A, B, f0, y0, of, z, active)
            if found is None:
                return self._found(changes, y0, f0, of, solved=False)
            z = found
            y, f = y0 + B @ z, f0 + A @ z
            more = self._wrong(y, f)
            more = more[~np.isin(more, of)]
        beside = loads[of].T @ z
        changes, y_now, f_now = self._base(right, shift, beside=beside, anew=True)
        f = np.where(active, f_now, f)
        return self._found(changes, y, f, of, solved=True)

    def _base(self, right, shift, **options) -> tuple[list[Array], Array, Array]:
        """Solution of the linear system: displacements, gaps and slips, pressures and tractions."""
        changes, unknowns = self._tangent.solve(right, self._equations, shift=shift, **options)
        root = np.sqrt(self._stiffness)
        f = [
            root * np.where(part.is_in, values, 0)
            for part, values in zip(self._rows, unknowns, strict=True)
        ]
        y = [
            part.new_gaps(changes, self._stiffness) + part.give(self._stiffness) * force
            for part, force in zip(self._rows, f, strict=True)
        ]
        return changes, np.concatenate(y), np.concatenate(f)

    def _wrong(self, y: Array, f: Array) -> npt.NDArray[np.intp]:
        """Numbers of the unknowns whose state is another one than in the working set."""
        parts = zip(self._rows, self._split(y), self._split(f), strict=True)
        return np.flatnonzero(
            np.concatenate([part.wrong(*of, self._stiffness, self._zero) for part, *of in parts])
        )

    def _small(self, A, B, f0, y0, of, z, active) -> Array | None:
        """The unknowns of the small problem; None if it has no solution."""
        frictional = any(part.num_unknowns > len(part.g) for part in self._rows)
        if not frictional:
            least = np.concatenate([p.least(self._stiffness, self._zero) for p in self._rows])
            on = active[of]
            M = np.where(on[:, None], A[of], B[of])
            found = complementarity.solved(M, np.where(on, f0[of], y0[of]), least[of])
            return None if found is None else found[0]
        error, slope, close = self._laws(y0 + B @ z, f0 + A @ z, of, A, B)
        for k in range(DENSE):
            if DEBUG > 1:
                print(f"       dense {k} {np.linalg.norm(error):.2e}")
            if close:
                return z
            try:
                way = np.linalg.solve(slope, -error)
            except np.linalg.LinAlgError:
                way = np.linalg.lstsq(slope, -error)[0]
            size, share = np.linalg.norm(error), 1.0
            while True:
                trial = z + share * way
                error, slope, close = self._laws(y0 + B @ trial, f0 + A @ trial, of, A, B)
                if np.linalg.norm(error) < (1 - ENOUGH * share) * size or close or share < SHORTEST:
                    break
                share /= 2
            z = trial
        return None

    def _laws(self, y, f, of, A, B):
        """Errors of the laws of some unknowns, their derivatives, and if they are zero."""
        errors, slopes, zero = [], np.zeros((len(of), len(of))), True
        place = np.full(len(y), -1)
        place[of] = np.arange(len(of))
        start, error = 0, np.zeros(len(of))
        for part, *at in zip(self._rows, self._split(y), self._split(f), strict=True):
            num, across = len(part.g), part.num_unknowns // len(part.g)
            mine = of[(of >= start) & (of < start + num)] - start  # vertices
            if len(mine):
                law = part.law(*(v.reshape(across, num)[:, mine] for v in at), mine, self._stiffness, self._zero)
                value, by_y, by_f, least = law
                rows = place[start + np.arange(across)[:, None] * num + mine]
                error[rows] = value
                zero &= bool((np.abs(value) <= least).all())
                for k in range(across):
                    for other in range(across):
                        at_row = of[rows[other]]
                        slopes[rows[k]] += by_y[k, other][:, None] * B[at_row] + by_f[k, other][:, None] * A[at_row]
            start += part.num_unknowns
        return error, slopes, zero

    def _split(self, values: npt.NDArray) -> list[npt.NDArray]:
        """Values by contact."""
        return np.split(values, self._ends)

    def _found(self, changes, y, f, of, *, solved: bool) -> Found:
        changed = np.zeros(len(y), dtype=bool)
        changed[of] = True
        return Found(
            changes, self._split(y), self._split(f), self._split(changed), solved, len(of)
        )
