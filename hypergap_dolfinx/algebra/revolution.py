# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Axisymmetric bodies: the weight 2πr or r that forms have, and doubts about it.

Multipliers are pressures only if ties and contacts have the weight of the bodies' forms. That isn't
computed from these: 2π and a modulus are one factor there. What forms contain tells most mistakes.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Protocol, cast

import numpy as np

import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.surface.carried import Motion
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.tolerances import FILE_DIGITS
from hypergap_dolfinx.surface.trace import Surface
from ufl.classes import (
    Division,
    Expr,
    FixedIndex,
    FormArgument,
    Indexed,
    MultiIndex,
    Power,
    Product,
    ScalarValue,
    SpatialCoordinate,
    Sum,
)
from ufl.corealg.traversal import unique_pre_traversal

LOG = logging.getLogger("hypergap_dolfinx")

Given = bool | str
"""True for 2πr in forms, "radian" for r, False for bodies in the plane."""


class Revolved(Protocol):
    """A tie or a contact."""

    @property
    def spaces(self) -> tuple[fem.FunctionSpace, fem.FunctionSpace]:
        """V₀ and V₁."""

    @property
    def surfaces(self) -> tuple[Surface, Surface]:
        """Γ0 and Γ1."""


class Coupled(Protocol):
    """A coupling with a point."""

    @property
    def component(self) -> Component:
        """Dofs of its displacements among those of the body."""


def angle_of(axisymmetric: Given) -> float:
    """Angle by which bodies are swept, 0 for bodies in the plane.

    Raises:
        ValueError: Something else than a :data:`Given`.
    """
    if isinstance(axisymmetric, bool | np.bool_):
        return 2 * np.pi if axisymmetric else 0.0
    if axisymmetric != "radian":
        raise ValueError(
            'axisymmetric is True (2πr in forms), "radian" (r in forms) or False, not '
            f"{axisymmetric!r}."
        )
    return 1.0


def swept(surface: Surface, angle: float, motion: Motion | None = None) -> Surface:
    """A side of a body that is swept by an angle, if that isn't 0.

    Args:
        surface: The side in the plane.
        angle: From :func:`angle_of`.
        motion: Motion of a periodic tie, or None.

    Raises:
        InterfaceError: A surface in space, or beyond the axis; a motion that isn't along the axis.
    """
    if not angle:
        return surface
    if surface.gdim != 2:
        raise InterfaceError("axisymmetric bodies are meshes in the plane (r, z), not in space.")
    low = float(surface.nodes[..., 0].min())
    if low < -FILE_DIGITS * surface.size.max():
        raise InterfaceError(
            f"{surface.name} reaches to x[0] = {low:.3g}: the axis of axisymmetric bodies is "
            "x[0] = 0, and they lie where x[0] ≥ 0."
        )
    if motion is not None and (motion.turns or abs(motion.shift[0]) > 0):
        raise InterfaceError(
            "a periodic tie of axisymmetric bodies is along their axis, a translation (0, z)."
        )
    return replace(surface, angle=angle)


def tell(forms: Sequence[ufl.Form | None], interfaces: Sequence[Revolved], name: str):
    """Warn of interfaces whose weights don't seem to match those of the forms.

    Args:
        forms: Form of each body, or None.
        interfaces: Ties or contacts.
        name: What each of these is called in messages.
    """
    for k, one in enumerate(interfaces):
        surface = one.surfaces[1]
        for i, form in enumerate(forms if surface.gdim == 2 else ()):
            if form is None or not any(_is_on(form, V.mesh) for V in one.spaces):
                continue
            why = _doubt(form, surface.angle)
            if why and one.spaces[0].mesh.comm.rank == 0:
                LOG.warning(f"{name} {k}: {why.format(f'body {i}')}")


def tell_couplings(forms: Sequence[ufl.Form], couplings: Sequence[Coupled]):
    """Warn of couplings on bodies that seem to be axisymmetric."""
    for k, one in enumerate(couplings):
        mesh = one.component.space.mesh
        why = [_doubt(form, 0.0) for form in forms if mesh.geometry.dim == 2 and _is_on(form, mesh)]
        if any(why) and mesh.comm.rank == 0:
            LOG.warning(
                f"coupling {k} is on a body whose form divides by x[0], as the hoop strain of "
                "axisymmetric bodies: couplings are for bodies in the plane and in space."
            )


def _doubt(form: ufl.Form, angle: float) -> str | None:
    """Warning about the form of a body, with {} in place of its name."""
    parts = list(_parts(form))
    if not angle:
        if not any(_vanishes(e.ufl_operands[1]) for e in parts if isinstance(e, Division)):
            return None
        return (
            "the form of {} divides by x[0], as the hoop strain of axisymmetric bodies: give "
            'axisymmetric=True (2πr in forms) or "radian" (r in forms), else '
            "its multipliers are no tractions."
        )
    if not any(map(_is_radius, parts)):
        return (
            "it is axisymmetric, and the form of {} has no x[0]: the measure of axisymmetric "
            "bodies is 2πr dx, or r dx."
        )
    if (angle == 1) == any(map(_is_pi, parts)):
        has, other = ("a", "True") if angle == 1 else ("no", '"radian"')
        return (
            f"its weight is {'r' if angle == 1 else '2πr'}, and the form of {{}} has {has} 2π in "
            f"it: pressures are 2π times off if that is so (axisymmetric={other})."
        )
    return None


def _is_on(form: ufl.Form, mesh: Mesh) -> bool:
    """True if a form is integrated over a mesh."""
    return mesh.ufl_domain() in form.ufl_domains()


def _parts(form: ufl.Form) -> Iterator[Expr]:
    """All expressions in a form."""
    for integral in form.integrals():
        yield from unique_pre_traversal(integral.integrand())


def _vanishes(e: Expr) -> bool:
    """True for x[0], its powers and products, and sums with displacements or tiny numbers.

    Not for distances from a point, or what has another value on the axis.
    """
    if isinstance(e, Sum):
        found = list(map(_vanishes, e.ufl_operands))
        rest = [part for part, vanishes in zip(e.ufl_operands, found) if not vanishes]
        return any(found) and all(map(_is_tiny, rest))
    if isinstance(e, Product | Power):
        return any(map(_vanishes, e.ufl_operands))
    return _is_radius(e)


def _is_tiny(e: Expr) -> bool:
    """True for a displacement, beside a radius, and for a number that keeps this from zero."""
    if isinstance(e, ScalarValue):
        return abs(e._value) < FILE_DIGITS
    return isinstance(e, Indexed) and isinstance(e.ufl_operands[0], FormArgument)


def _is_radius(e: Expr) -> bool:
    """True for x[0]."""
    if not isinstance(e, Indexed) or not isinstance(e.ufl_operands[0], SpatialCoordinate):
        return False
    index = cast(MultiIndex, e.ufl_operands[1]).indices()[0]
    return not isinstance(index, FixedIndex) or int(index) == 0


def _is_pi(e: Expr) -> bool:
    """True for a number, or a constant of one, that is π or 2π."""
    if isinstance(e, fem.Constant):
        values = np.ravel(e.value)
        value = values[0] if len(values) == 1 else 0.0
    else:
        value = e._value if isinstance(e, ScalarValue) else 0.0
    return bool(np.isclose(np.real(value), (np.pi, 2 * np.pi), rtol=1e-4, atol=0).any())
