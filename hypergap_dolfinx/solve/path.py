# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What a load step changes: values of forms and boundary conditions, and the way between two."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem


class LoadPath:
    """The straight way from the values of the last load step to those that a user has set since."""

    def __init__(
        self,
        F: Sequence[ufl.Form],
        u: Sequence[fem.Function],
        bcs: Sequence[fem.DirichletBC],
        moved: Sequence[fem.Function] = (),
        arrays: Sequence[npt.NDArray] = (),
    ):
        """Find the values.

        Args:
            F: Residual forms.
            u: What is solved for.
            bcs: Boundary conditions.
            moved: Displacements that the user prescribes as a whole.
            arrays: Others, of the ties' jumps.
        """
        self._arrays: list[npt.NDArray] = [*(f.x.array for f in moved), *arrays]
        for form in F:
            self._arrays += [c.value for c in form.constants() if isinstance(c, fem.Constant)]
            self._arrays += [
                f.x.array
                for f in form.coefficients()
                if isinstance(f, fem.Function) and all(f is not solved for solved in u)
            ]
        for bc in bcs:
            g = bc.g
            self._arrays.append(g.x.array if hasattr(g, "x") else g.value)
        self._start = [np.array(a) for a in self._arrays]
        self._end = self._start

    def set_out(self):
        """Take the values as they are now for the end."""
        self._end = [np.array(a) for a in self._arrays]

    def go(self, s: float):
        """Set all values.

        Args:
            s: 0 at the start, 1 at the end.
        """
        for a, start, end in zip(self._arrays, self._start, self._end, strict=True):
            a[...] = end if s == 1 else start + s * (end - start)

    def stop(self, s: float = 1.0):
        """The next way starts here, with the values of the end set.

        Args:
            s: How far it went.
        """
        self.go(s)
        self._start = [np.array(a) for a in self._arrays]
        self.go(1)

    @property
    def changes(self) -> bool:
        """Whether any of this rank's values changes on the way."""
        return not all(map(np.array_equal, self._start, self._end))

    @property
    def is_finite(self) -> bool:
        """Whether this rank's values at the end are numbers."""
        return all(np.isfinite(a).all() for a in self._end)
