# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A prescribed jump, u₁ − u₀ = g: values at the dofs of a side, and the right-hand side."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.core.collective import raise_on_all, spot
from hypergap_dolfinx.core.compat import coordinate_element
from hypergap_dolfinx.interface_laws import given_values
from hypergap_dolfinx.mortar.constraint import Constraint
from hypergap_dolfinx.mortar.domain import GapDomain, places_of_dofs
from hypergap_dolfinx.mortar.quadrature import Samples
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.trace import Surface


@dataclass(frozen=True)
class Jump:
    """A prescribed jump as given by the user."""

    value: given_values.Given
    """Jump of the second side over the first."""
    sign: float = 1.0
    """−1 where the first side became Γ1."""

    def __post_init__(self):
        """Raise a ValueError unless it can be a jump."""
        given_values.check(self.value, "the jump")

    def reversed(self) -> "Jump":
        """The jump with the sides swapped."""
        return replace(self, sign=-self.sign)

    @property
    def key(self) -> Hashable:
        """Key that is equal for jumps that are and remain the same."""
        if given_values.is_read(self.value):
            return self.sign, id(self.value)
        return self.sign, tuple(np.ravel(np.asarray(self.value)).tolist())

    @property
    def given(self) -> list[fem.Function | fem.Constant]:
        """Functions and constants that define the jump."""
        return given_values.changing(self.value)

    def nodal(
        self, sides: Sequence[Component], surfaces: tuple[Surface, Surface]
    ) -> tuple[int, npt.NDArray]:
        """Current values at the dofs of one side. Collective.

        Args:
            sides: V₀ and V₁.
            surfaces: Γ0 and Γ1.

        Returns:
            The side, and this rank's owned values of its space, ``(num_dofs, block_size)``; 0 where
            the surface has no dofs.

        Raises:
            ValueError: The jump doesn't fit the spaces, or isn't finite somewhere.
        """
        value: Any = self.value
        side, error = 1, None
        if isinstance(value, fem.Function):
            functions = [part.own_function(value) for part in sides]
            side = next((i for i in (1, 0) if functions[i] is not None), -1)
            if side < 0:
                raise ValueError(
                    "the jump is a function on a space of neither side; interpolate it into one on "
                    "tie.spaces[1] first."
                )
            value = functions[side]
        V, surface = sides[side].space, surfaces[side]
        start, end = surface.dof_range[V.mesh.comm.rank : V.mesh.comm.rank + 2]
        dofs, x = places_of_dofs(surface)
        mine = (start <= dofs) & (dofs < end)
        x = x[mine]
        nodal = np.zeros((end - start, V.dofmap.index_map_bs), dtype=PETSc.ScalarType)
        own = dofs[mine] - start
        try:
            values = self._at(value, x, own, V)
            if np.iscomplexobj(values) and not np.iscomplexobj(nodal):
                raise ValueError("it is complex, and PETSc's scalars are real here.")
            nodal[own] = self.sign * values
        except Exception as e:
            error = f"the jump is no value on V₁: {e}".splitlines()[0]
        wrong = ~np.isfinite(nodal[own]).all(axis=1)
        if error is None and wrong.any():
            i = int(wrong.argmax())
            error = f"the jump is {nodal[own][i]} at {spot(x[i])}; it must be finite."
        raise_on_all(V.mesh.comm, error, ValueError)
        return side, nodal

    @staticmethod
    def _at(value, x, own, V: fem.FunctionSpace) -> npt.NDArray:
        """Values at owned dofs of a space with positions x, ``(num, block_size)``."""
        block_size = V.dofmap.index_map_bs
        if isinstance(value, fem.Function):
            return value.x.array.reshape(-1, block_size)[own]
        if isinstance(value, fem.Constant):
            value = value.value
        elif given_values.is_read(value):
            if not len(x):
                return np.zeros((0, block_size))
            function, value = value, given_values.at_points(value, x)
            if block_size > 1 and _is_one_each(function, value, x):
                raise ValueError(
                    f"the callable gives one number at each point, the space has {block_size} "
                    "components; give an array of each, as lambda x: (x[0], 0 * x[0])."
                )
            if len(V.value_shape) == 2:
                value = [component for row in value for component in row]
            scalar = V.value_shape == () and np.ndim(value) < 2
            parts = [value] if scalar else list(value)
            _check_number(len(parts), block_size)
            return np.stack([given_values.each(part, len(x)) for part in parts], axis=1)
        flat = np.ravel(np.asarray(value))
        _check_number(len(flat), block_size)
        return np.broadcast_to(flat, (len(x), block_size))


def _is_one_each(function, value, x: npt.NDArray) -> bool:
    """True if a callable gives one number at each point."""
    if not isinstance(value, np.ndarray) or value.shape != (len(x),):
        return False
    return np.shape(given_values.at_points(function, np.vstack((x, x)))) != np.shape(value)


def _check_number(num: int, wanted: int):
    if num != wanted:
        raise ValueError(f"{num} component{'s'[: num > 1]} given, the space has {wanted}.")


def gaping(
    B: Sequence[PETSc.Mat], sides: Sequence[Component], domain: GapDomain, constraint: Constraint
) -> npt.NDArray:
    """This rank's rows of ∫∫ ∂x/∂α · λ dΓ_α dα, the gaps of the surfaces. Collective.

    They are Σ_i B_i x_i with the positions x_i of the dofs, unless a space has a lower degree than
    its mesh's geometry: then its dofs don't know the surface.

    Args:
        B: B₀ and B₁; others are ignored.
        sides: Dofs of V₀ and V₁ among those of their bodies.
        domain: Σ.
        constraint: The constraint on it.
    """
    spaces = [part.space for part in sides]
    if any(coordinate_element(V.mesh).degree > V.element.basix_element.degree for V in spaces):
        samples = Samples(domain, constraint)
        rows = samples.openings().ravel()
        samples.destroy()
        return rows
    origin = domain.surfaces[0].x[0]  # a point nearby, to keep digits far from the origin
    c = B[0].createVecLeft()
    c.set(0.0)
    for part, B_i in zip(sides, B, strict=False):
        x, V = B_i.createVecRight(), part.space
        n, owned = V.mesh.geometry.dim, V.dofmap.index_map.size_local
        positions = (V.tabulate_dof_coordinates()[:owned, :n] - origin).ravel()
        x.array[:] = part.into_body(positions)
        B_i.multAdd(x, c, c)
        x.destroy()
    rows = c.array_r.copy()
    c.destroy()
    return rows


def right_side(
    B: Sequence[PETSc.Mat],
    sides: Sequence[Component],
    jump: tuple[int, npt.NDArray] | None,
    gaping: npt.NDArray | None,
) -> PETSc.Vec:
    """The right-hand side c of Σ_i B_i u_i = c. Collective.

    With α g interpolated between the surfaces ∂(α g)/∂α is g; so c = B₁ g, or −B₀ g.

    Args:
        B: B₀ and B₁.
        sides: Dofs of V₀ and V₁ among those of their bodies.
        jump: From :meth:`Jump.nodal`, or None.
        gaping: From :func:`gaping` if positions are to be equal, or None.
    """
    c = B[0].createVecLeft()
    c.set(0.0)
    if gaping is not None:
        c.array[:] = -gaping
    if jump is not None:
        side, values = jump
        g = B[side].createVecRight()
        g.array[:] = sides[side].into_body(values.ravel()) * (1 if side else -1)
        B[side].multAdd(g, c, c)
        g.destroy()
    return c
