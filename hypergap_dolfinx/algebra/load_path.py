# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Interpolation of the loads, values of forms and boundary conditions, within a load step."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem


class LoadPath:
    """Linear path from the values of the last load step to those that a user has set since."""

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
            u: Solution functions.
            bcs: Boundary conditions.
            moved: Displacements that the user prescribes as a whole.
            arrays: Values of ties and contacts.
        """
        of_forms: list[npt.NDArray] = []
        for form in F:
            of_forms += [c.value for c in form.constants() if isinstance(c, fem.Constant)]
            of_forms += [
                f.x.array
                for f in form.coefficients()
                if isinstance(f, fem.Function) and all(f is not solved for solved in u)
            ]
        held = [bc.g.x.array if hasattr(bc.g, "x") else bc.g.value for bc in bcs]
        kinds = {
            "a prescribed displacement": [*(f.x.array for f in moved), *held],
            "a load or another value in a form": of_forms,
            "a friction, a compliance or another value of a contact or a tie": list(arrays),
        }
        self._arrays = [a for of_kind in kinds.values() for a in of_kind]
        self._kinds = [kind for kind, of_kind in kinds.items() for _ in of_kind]
        self._start = [np.array(a) for a in self._arrays]
        self._end = self._start

    def start_step(self):
        """Take the present values for the end."""
        self._end = [np.array(a) for a in self._arrays]

    def interpolate(self, s: float):
        """Set all values between start and end.

        Args:
            s: 0 at the start, 1 at the end.
        """
        for a, start, end in zip(self._arrays, self._start, self._end, strict=True):
            a[...] = end if s == 1 else start + s * (end - start)

    def commit(self, s: float = 1.0):
        """Start the next path here, and set the values of the end.

        Args:
            s: Part of this path that was reached.
        """
        self.interpolate(s)
        self._start = [np.array(a) for a in self._arrays]
        self.interpolate(1)

    @property
    def changes(self) -> bool:
        """True if any of this rank's values changes on the path."""
        return not all(map(np.array_equal, self._start, self._end))

    @property
    def wrong(self) -> str | None:
        """Kind of this rank's values at the end that aren't finite, or None."""
        ends = zip(self._kinds, self._end, strict=True)
        return next((kind for kind, a in ends if not np.isfinite(a).all()), None)
