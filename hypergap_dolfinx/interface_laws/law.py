# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A law of the user's own, λ = f(w), between the traction and the jump of an interface.

The jump that the law sees is spanned by the multipliers' functions, w = Σ_A w_A ∂φ_A/∂α, and is the
nearest of these to ∂u/∂α (less a prescribed jump g); λ is the nearest to f(w):

.. math:: \iint (\partial u/\partial\alpha - g - w)\,\partial\phi_A/\partial\alpha
   \,d\Gamma_\alpha d\alpha = 0, \qquad
   \iint (f(w) - \lambda)\,\partial\phi_A/\partial\alpha\,d\Gamma_\alpha d\alpha = 0.

With M = ∫∫ ∂φ_A/∂α ∂φ_B/∂α that is Σ_i B_i u_i − M w = c and F(w) − M λ = 0: if f = ψ' has a
potential, u and w make the energy stationary, with λ as the multiplier. f = w/c gives
Σ_i B_i u_i − c M λ = c, a compliance; and a law, however stiff, never constrains more than the tie.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import default_scalar_type, fem, mesh
from hypergap_dolfinx.core.collective import raise_on_all
from hypergap_dolfinx.mortar.constraint import Constraint
from hypergap_dolfinx.mortar.domain import GapDomain
from hypergap_dolfinx.mortar.quadrature import Samples
from ufl.algorithms.analysis import extract_constants, extract_type
from ufl.algorithms.comparison_checker import ComplexComparisonError, do_comparison_check
from ufl.classes import FormArgument, GeometricQuantity
from ufl.core.expr import Expr

Given = Callable[[Expr, Expr], Any]
"""λ of the jump and the normal, in UFL."""


@dataclass(frozen=True)
class Law:
    """An interface law as given by the user."""

    value: Given
    """λ of the second side's jump over the first, with the normal from the first to the second."""
    turned: bool = False
    """True if the first side became Γ1."""

    def __post_init__(self):
        """Raise a ValueError unless it is a function."""
        if not callable(self.value) or isinstance(self.value, Expr | type):
            raise ValueError(
                "a law is a function of the jump and the normal that gives λ in UFL, as in "
                f"law=lambda jump, n: k * jump; not a {type(self.value).__name__}."
            )

    def reversed(self) -> "Law":
        """The law with the sides swapped."""
        return replace(self, turned=not self.turned)

    @property
    def key(self) -> Hashable:
        """Key that is equal for equal laws."""
        return self.turned, id(self.value)

    def traction(self, jump: Expr, normal: Expr) -> Expr:
        """λ in UFL.

        Raises:
            ValueError: No UFL expression of the jump, one of other functions, or a comparison of
                complex values.
        """
        sign = -1 if self.turned else 1
        try:
            found = self.value(sign * jump, sign * normal)
            found = ufl.as_tensor(found) if isinstance(found, list | tuple) else ufl.as_ufl(found)
        except Exception as e:
            raise ValueError(
                f"the law is no UFL expression of the jump: {e}".splitlines()[0]
            ) from e
        if found.ufl_shape != jump.ufl_shape or found.ufl_free_indices:
            raise ValueError(
                f"the law gives values of shape {found.ufl_shape}, the jump has {jump.ufl_shape}."
            )
        if np.issubdtype(default_scalar_type, np.complexfloating):
            try:
                found = do_comparison_check(found)
            except ComplexComparisonError:
                raise ValueError(
                    "the law compares what may be complex; take ufl.real of it first."
                ) from None
        has, may = (extract_type(e, (FormArgument, GeometricQuantity)) for e in (found, jump))
        if others := [f for f in has if f not in {*may, normal}]:
            raise ValueError(
                f"the law has {others[0]} in it: it may have the jump, the normal and constants."
            )
        return sign * found


def _entries(expression: Expr) -> list[Expr]:
    """Components of a tensor, row by row."""
    return [expression[i] if i else expression for i in np.ndindex(expression.ufl_shape)]


class Response:
    """F(w) and its derivative of one interface, and M."""

    linear = False
    """True if a linear problem can have it."""

    def __init__(self, law: Law, domain: GapDomain, constraint: Constraint, V: fem.FunctionSpace):
        """Compile the law and its derivative. Collective.

        Args:
            law: The law.
            domain: Σ.
            constraint: The constraint on it.
            V: V₁.

        Raises:
            ValueError: The law doesn't fit, or isn't finite at w = 0.
        """
        self.key = law.key
        self._block_size = V.dofmap.index_map_bs
        self._samples = Samples(domain, constraint)
        num, n = self._samples.normal.shape
        # UFL's expressions are evaluated on cells: a mesh with a cell for each point
        points = mesh.create_interval(MPI.COMM_SELF, max(num, 1), (0.0, 1.0))
        self._jump, normal = (
            fem.Function(fem.functionspace(points, ("DG", 0, shape)))
            for shape in (V.value_shape, (n,))
        )
        normal.x.array[: num * n] = self._samples.normal.ravel()
        w = ufl.variable(self._jump)
        traction = law.traction(w, normal)
        self.has_directions = normal in extract_type(traction, FormArgument)
        # The last entry is for laws without anything of the mesh
        both = [*_entries(traction), *_entries(ufl.diff(traction, w)), _entries(self._jump)[0]]
        both = ufl.as_vector(both)
        self._constants = {
            c: fem.Constant(points, np.asarray(c.value)) for c in extract_constants(both)
        }
        self._law = fem.Expression(
            ufl.replace(both, self._constants), np.array([[0.5]]), comm=domain.comm
        )
        self._mesh = points
        f, df = self._at_points(np.zeros((num, self._block_size)))
        error = None
        for values, what in ((f, "it"), (df, "its derivative")):
            if not np.isfinite(values).all():
                error = error or (
                    f"the law fails where nothing has opened: {what} is "
                    f"{values[~np.isfinite(values)][0]}; the root of a square, as in a norm, wants "
                    "a small number added below it."
                )
        raise_on_all(domain.comm, error, ValueError)

    def destroy(self):
        """Destroy the PETSc matrix. Collective."""
        self._samples.destroy()

    @property
    def given(self) -> list[fem.Constant]:
        """Functions and constants that define the law."""
        return list(self._constants)

    def _at_points(self, w: npt.NDArray) -> tuple[npt.NDArray, npt.NDArray]:
        """F and ∂f/∂w for values of w at this rank's points."""
        num, block_size = w.shape
        self._jump.x.array[: w.size] = w.ravel()
        for given, mine in self._constants.items():
            mine.value = given.value
        found = self._law.eval(self._mesh, np.arange(num, dtype=np.int32))
        found = found.reshape(num, block_size * (1 + block_size) + 1)  # of no points too
        df = found[:, block_size:-1].reshape(num, block_size, block_size)
        return found[:, :block_size], df

    def mass(self) -> PETSc.Mat:
        """M, with rows and columns as B's rows; a new matrix. Collective."""
        return self._samples.scaled_mass(1.0, self._block_size)

    def at(self, w: npt.NDArray) -> tuple[npt.NDArray, npt.NDArray]:
        """F(w), and ∂f/∂w at the points. Collective.

        Args:
            w: This rank's rows, ``(num_multipliers, block_size)``.

        Returns:
            As w, and ``(num_points, block_size, block_size)`` for :meth:`tangent`.
        """
        f, df = self._at_points(self._samples.values(w))
        return self._samples.forces(f), df

    def tangent(self, df: npt.NDArray) -> PETSc.Mat:
        """∂F/∂w from :meth:`at`; a new matrix. Collective."""
        return self._samples.weighted(df)
