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
            arrays: Others, of ties and contacts.
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
    def wrong(self) -> str | None:
        """What kind of this rank's values at the end are no numbers."""
        ends = zip(self._kinds, self._end, strict=True)
        return next((kind for kind, a in ends if not np.isfinite(a).all()), None)
