# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Interpolation of the loads, values of forms and boundary conditions, within a load step."""

from collections.abc import Iterable, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem

Value = Any
"""A function, a constant, a compiled one as boundary conditions have, or an array."""
PRESCRIBED = "a prescribed displacement"
LOAD = "a load or another value in a form"
OF_RIGID = "the force", "the torque", "what is prescribed", "a spring", "an anchor"
OF_TIE = "a jump, a compliance or another value of tie {}"


def array_of(value: Value) -> npt.NDArray:
    """Array of a value that a user may change."""
    if isinstance(value, np.ndarray):
        return value
    return value.x.array if hasattr(value, "x") else value.value


def _same(value: Value) -> int:
    """Key that is equal for one object, compiled or not."""
    return id(getattr(value, "_cpp_object", value))


def _num_owned(value: Value, comm: MPI.Comm) -> int | None:
    """Number of a value's numbers that this rank owns; constants are the first rank's."""
    if hasattr(value, "x"):
        dofmap = value.function_space.dofmap
        return dofmap.index_map.size_local * dofmap.index_map_bs
    return None if comm.rank == 0 else 0


def values_of(
    F: Sequence[ufl.Form],
    bcs: Sequence[fem.DirichletBC],
    moved: Sequence[fem.Function] = (),
    given: Sequence[tuple[str, Value]] = (),
    *,
    without: Iterable[Value] = (),
) -> list[tuple[str, Value]]:
    """Values that a user may change, each once, with their kinds.

    Args:
        F: Residual forms.
        bcs: Boundary conditions.
        moved: Displacements that the user prescribes as a whole.
        given: Values of ties, contacts and rigid bodies, with their kinds.
        without: Values in forms that are none of these, as the solution.
    """
    found = [(PRESCRIBED, value) for value in (*moved, *(bc.g for bc in bcs))]
    for form in F:
        parts = (*form.constants(), *form.coefficients())
        found += [(LOAD, f) for f in parts if isinstance(f, fem.Constant | fem.Function)]
    found += given
    known = {_same(f) for f in without}
    each = {_same(value): (kind, value) for kind, value in reversed(found)}  # its first kind
    return [pair for same, pair in reversed(each.items()) if same not in known]


class LoadPath:
    """Linear path from the values of the last load step to those that a user has set since."""

    def __init__(self, comm: MPI.Comm, values: Sequence[tuple[str, Value]]):
        """Start at the present values.

        Args:
            comm: Communicator of the bodies.
            values: The values with their kinds, as :func:`values_of` gives them.
        """
        self._comm = comm
        self._kinds = [kind for kind, _ in values]
        self.values = [value for _, value in values]
        """Objects in which the user changes values."""
        self._arrays = [array_of(value) for value in self.values]
        self._owned = [_num_owned(value, comm) for value in self.values]
        self.start = [np.array(a) for a in self._arrays]
        """Values at the end of the last load step."""
        self._end = self.start

    def start_step(self):
        """Set the end of the path to the present values."""
        self._end = [np.array(a) for a in self._arrays]

    def interpolate(self, s: float):
        """Set all values between start and end.

        Args:
            s: 0 at the start, 1 at the end.
        """
        for a, start, end in zip(self._arrays, self.start, self._end, strict=True):
            a[...] = end if s == 1 else start + s * (end - start)

    def increments(self, start: float, end: float) -> list[npt.NDArray]:
        """Increments of values along a part of the path, of those that this rank owns.

        Args:
            start: Part of the path where it begins.
            end: Where it ends.
        """
        return [
            (end - start) * (b.ravel() - a.ravel())[:num]
            for num, a, b in zip(self._owned, self.start, self._end, strict=True)
        ]

    def copies(self) -> list[npt.NDArray]:
        """Copies of this rank's present values."""
        return [np.array(a) for a in self._arrays]

    def changed_since(self, copies: Sequence[npt.NDArray]) -> str | None:
        """Kind of this rank's values that aren't what they were, or None."""
        each = zip(self._kinds, self._arrays, copies, strict=True)
        return next((kind for kind, a, before in each if not np.array_equal(a, before)), None)

    def commit(self, s: float = 1.0):
        """Start the next path here, and set the values of the end.

        Args:
            s: Part of this path that was reached.
        """
        self.interpolate(s)
        self.start = [np.array(a) for a in self._arrays]
        self.interpolate(1)

    @property
    def changes(self) -> bool:
        """True if any of this rank's values changes on the path."""
        return not all(map(np.array_equal, self.start, self._end))

    @property
    def wrong(self) -> str | None:
        """Kind of this rank's values at the end that aren't finite, or None."""
        ends = zip(self._kinds, self._end, strict=True)
        return next((kind for kind, a in ends if not np.isfinite(a).all()), None)
