# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Coefficients of a contact on Γ1: friction and compliance."""

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.core.collective import raise_on_all, values_at
from hypergap_dolfinx.interface_laws.given_values import without_round_off
from hypergap_dolfinx.surface.moving import MovingSurface
from hypergap_dolfinx.surface.trace import create_surface, lagrange_element

Value = float | fem.Constant | fem.Function


class Coefficient:
    """Non-negative coefficient on Γ1, constant or with a value at each vertex."""

    def __init__(
        self,
        value: Value,
        name: str,
        what: str,
        V: fem.FunctionSpace,
        facets: npt.ArrayLike,
        split: bool = False,
    ):
        """Check the value. Collective.

        Args:
            value: A number, a scalar constant, or a scalar Lagrange function on the mesh of Γ1,
                evaluated at its vertices.
            name: Name of the argument, for messages.
            what: Name of the coefficient, for messages.
            V: The space of Γ1's body.
            facets: This rank's facets of Γ1.
            split: True for values at the nodes of degree 2 too.

        Raises:
            ValueError: A value of another type, on another mesh, negative or not finite.
        """

        def surface(V: fem.FunctionSpace):
            whole = create_surface(V, facets, "Γ1")
            return whole.split if split else whole

        self._comm = V.mesh.comm
        self.what = what
        """Its name in messages."""
        self._at: MovingSurface | None = None
        self._value: npt.NDArray | fem.Constant | fem.Function
        if isinstance(value, fem.Function):
            raise_on_all(self._comm, _unfit(value, name, what, V), ValueError)
            self._at = MovingSurface(surface(value.function_space))
            self._value = value
        elif isinstance(value, fem.Constant):
            if value.value.shape:
                raise ValueError(f"{what} is a scalar, not of shape {value.value.shape}.")
            self._value = value
        elif is_number(value):
            self._value = np.array(float(value))
        else:
            raise ValueError(
                f"{name} is a number, a fem.Constant or a fem.Function on Γ1's mesh, not "
                f"{type(value).__name__}."
            )
        self._num = len(surface(V).x)
        self.at_vertices()

    @property
    def given(self) -> npt.NDArray | fem.Constant | fem.Function:
        """The value as given, which a user may change."""
        return self._value

    def at_vertices(self) -> npt.NDArray[np.float64]:
        """Values at Γ1's vertices, ``(num_vertices,)``, the same on every rank. Collective.

        Raises:
            ValueError: A value that is negative or not finite.
        """
        if not isinstance(self._value, fem.Function):
            now = self._value.value if isinstance(self._value, fem.Constant) else self._value
            found = np.full(self._num, float(now))
        else:
            assert self._at is not None
            found = self._at.at_vertices(values_at(self._value, self._at.dofs))[:, 0]
            found = without_round_off(found)
        wrong = found[~(np.isfinite(found) & (found >= 0))]
        bad = None
        if len(wrong):
            bad = f"{self.what} is {wrong[0]:.6g} on Γ1; it is a number from 0 on."
        raise_on_all(self._comm, bad, ValueError)
        return found


def is_number(value) -> bool:
    """True for a real number or a 0-dimensional array of one; truth values are none."""
    kinds = int | float | np.number | np.ndarray
    return isinstance(value, kinds) and not np.ndim(value) and np.asarray(value).dtype.kind in "iuf"


def _unfit(f: fem.Function, name: str, what: str, V: fem.FunctionSpace) -> str | None:
    """Reason why a function can't be a coefficient, or None."""
    if f.function_space.mesh is not V.mesh:
        return (
            f"{name} is a function on another mesh than Γ1's; make it on that of "
            "contact.spaces[1] (Contact.between chooses which side that is)."
        )
    if f.function_space.value_shape:
        return f"{what} is a scalar, not of shape {f.function_space.value_shape}."
    _, why = lagrange_element(f.function_space)
    return why and f"the space of {what} {why}; interpolate it to one."


class Friction(Coefficient):
    """Coulomb's coefficient of friction μ with its elastic slip and shear limit."""

    def __init__(
        self,
        value: Value,
        elastic_slip: float,
        shear_limit: float,
        V: fem.FunctionSpace,
        facets: npt.ArrayLike,
        split: bool = False,
    ):
        """Check the values. Collective.

        Args:
            value: As for :class:`Coefficient`.
            elastic_slip: Reversible slip at which friction reaches μ p, a length; 0 for none.
            shear_limit: Upper bound of the friction traction.
            V: The space of Γ1's body.
            facets: This rank's facets of Γ1.
            split: As for :class:`Coefficient`.

        Raises:
            ValueError: As :class:`Coefficient`; a negative elastic slip or a shear limit ≤ 0.
        """
        if not (is_number(elastic_slip) and np.isfinite(elastic_slip) and elastic_slip >= 0):
            raise ValueError(f"elastic_slip is a length from 0 on, not {elastic_slip!r}.")
        self.elastic_slip = float(elastic_slip)
        """Reversible slip at which friction reaches μ p, a length."""
        if not (is_number(shear_limit) and shear_limit > 0):
            raise ValueError(f"shear_limit is a traction above 0, not {shear_limit!r}.")
        self.shear_limit = float(shear_limit)
        """Upper bound of the friction traction."""
        super().__init__(value, "friction", "the coefficient of friction", V, facets, split)


def friction_of(
    value: Value | None,
    elastic_slip: float,
    shear_limit: float,
    V: fem.FunctionSpace,
    facets: npt.ArrayLike,
    split: bool = False,
) -> Friction | None:
    """Friction of a contact, or None. Collective.

    Args:
        value: The coefficient; None for no friction.
        elastic_slip: As for :class:`Friction`.
        shear_limit: As for :class:`Friction`.
        V: The space of Γ1's body.
        facets: This rank's facets of Γ1.
        split: As for :class:`Coefficient`.

    Raises:
        ValueError: As :class:`Friction`; an elastic slip or a shear limit without friction.
    """
    if value is not None:
        return Friction(value, elastic_slip, shear_limit, V, facets, split)
    given = (("elastic_slip", elastic_slip, 0), ("shear_limit", shear_limit, np.inf))
    for name, one, none in given:
        if one != none:
            raise ValueError(f"{name} is for contact with friction: give friction too.")
    return None
