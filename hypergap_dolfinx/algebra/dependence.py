# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Dependence of a compiled form on data: whether a stiffness is to be assembled anew."""

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem


class Dependence:
    """Coefficients, constants and coordinates of a form, and their last values."""

    def __init__(self, form: ufl.Form, compiled: fem.Form, u: fem.Function):
        """Find those that are left once derivatives are taken.

        Args:
            form: The form.
            compiled: The form compiled by FFCx.
            u: The solution function.
        """
        of_ufl, ufcx = form.coefficients(), compiled.ufcx_form
        used = [ufcx.original_coefficient_positions[i] for i in range(ufcx.num_coefficients)]
        self._functions = [of_ufl[k] for k in used if of_ufl[k] is not u]
        self._u = [u] if any(of_ufl[k] is u for k in used) else []
        self._constants = list(form.constants())
        self._geometry = compiled.mesh.geometry
        self._before: tuple[list[npt.NDArray], list[npt.NDArray]] | None = None

    def changed(self, slack: float = 0.0) -> bool:
        """True if something on this rank has changed since the last call that returned True.

        Args:
            slack: Largest change of the solution that counts as no change.
        """
        now = [np.asarray(constant.value) for constant in self._constants]
        now += [f.x.array for f in self._functions]
        now.append(self._geometry.x)
        at = [f.x.array for f in self._u]
        if self._before is not None:
            before, place = self._before
            near = all(abs(a - b).max(initial=0) <= slack for a, b in zip(at, place, strict=True))
            if near and all(map(np.array_equal, before, now)):
                return False
        copies = [[array.copy() for array in arrays] for arrays in (now, at)]
        self._before = copies[0], copies[1]
        return True
