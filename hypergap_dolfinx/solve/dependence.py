# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What the values of a compiled form depend on: a linear body's stiffness not on where it is."""

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem


class Dependence:
    """Coefficients, constants and coordinates of a form, and what they were."""

    def __init__(self, form: ufl.Form, compiled: fem.Form):
        """Find those that are left once derivatives are taken.

        Args:
            form: The form.
            compiled: What FFCx made of it.
        """
        of_ufl, ufcx = form.coefficients(), compiled.ufcx_form
        used = [ufcx.original_coefficient_positions[i] for i in range(ufcx.num_coefficients)]
        self._functions = [of_ufl[k] for k in used]
        self._constants = list(form.constants())
        self._geometry = compiled.mesh.geometry
        self._before: list[npt.NDArray] | None = None

    def changed(self) -> bool:
        """Whether something on this rank isn't what it was at the last call."""
        now = [np.asarray(constant.value) for constant in self._constants]
        now += [f.x.array for f in self._functions]
        now.append(self._geometry.x)
        before = self._before
        if before is not None and all(map(np.array_equal, before, now)):
            return False
        self._before = [array.copy() for array in now]
        return True
