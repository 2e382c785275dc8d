# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The friction of a contact, as a user gives it."""

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.coefficient import Coefficient, Value, is_number


class Friction(Coefficient):
    """Coulomb's coefficient μ: one number, or one for each place on Γ1."""

    def __init__(
        self,
        value: Value,
        elastic_slip: float,
        shear_limit: float,
        V: fem.FunctionSpace,
        facets: npt.ArrayLike,
    ):
        """Check what is given. Collective.

        Args:
            value: As for :class:`Coefficient`.
            elastic_slip: Slip up to which friction grows to μ p; 0 if nothing slips before.
            shear_limit: Traction beyond which friction doesn't grow with pressure.
            V: The space of Γ1's body.
            facets: This rank's facets of Γ1.

        Raises:
            ValueError: Something else, or values that are negative or no numbers.
        """
        if not (is_number(elastic_slip) and np.isfinite(elastic_slip) and elastic_slip >= 0):
            raise ValueError(f"elastic_slip is a length from 0 on, not {elastic_slip!r}.")
        self.elastic_slip = float(elastic_slip)
        """Slip up to which friction grows to μ p."""
        if not (is_number(shear_limit) and shear_limit > 0):
            raise ValueError(f"shear_limit is a traction above 0, not {shear_limit!r}.")
        self.shear_limit = float(shear_limit)
        """Traction beyond which friction doesn't grow with pressure."""
        super().__init__(value, "friction", "the coefficient of friction", V, facets)


def friction_of(
    value: Value | None,
    elastic_slip: float,
    shear_limit: float,
    V: fem.FunctionSpace,
    facets: npt.ArrayLike,
) -> Friction | None:
    """Friction as given to a contact, or None. Collective.

    Args:
        value: The coefficient, or None.
        elastic_slip: As for :class:`Friction`.
        shear_limit: As for :class:`Friction`.
        V: The space of Γ1's body.
        facets: This rank's facets of Γ1.

    Raises:
        ValueError: As :class:`Friction`; an elastic slip or a limit without friction.
    """
    if value is not None:
        return Friction(value, elastic_slip, shear_limit, V, facets)
    given = (("elastic_slip", elastic_slip, 0), ("shear_limit", shear_limit, np.inf))
    for name, one, none in given:
        if one != none:
            raise ValueError(f"{name} is for contact with friction: give friction too.")
    return None
