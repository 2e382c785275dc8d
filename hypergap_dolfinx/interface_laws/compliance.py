# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A compliant interface: a compliance, u₁ − u₀ = c λ, or a conductance, λ = h (u₁ − u₀).

Both are matrices C_AB = ∫∫ c ∂φ_A/∂α ∂φ_B/∂α dΓ_α dα. That of a compliance replaces the zero block,
Σ_i B_i u_i − C λ = g: c is averaged over cells of Σ, so a nearly infinite c at one node blocks all
cells around. A conductance is a law (:mod:`hypergap_dolfinx.interface_laws.law`) with F(w) = H w,
and h is averaged: one node conducts.
"""

from collections.abc import Callable, Hashable, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.core.collective import raise_on_all, spot, values_at
from hypergap_dolfinx.core.sparse import triplets
from hypergap_dolfinx.interface_laws import given_values
from hypergap_dolfinx.mortar import kernel
from hypergap_dolfinx.mortar.constraint import Constraint
from hypergap_dolfinx.mortar.domain import GapDomain, interpolation_weights, places_of_dofs
from hypergap_dolfinx.mortar.quadrature import Samples
from hypergap_dolfinx.surface.tolerances import NOISE
from hypergap_dolfinx.surface.trace import Surface, create_surface, lagrange_element

Part = float | fem.Constant | fem.Function | Callable[[npt.NDArray], Any]
Given = Part | Sequence[Part]
"""One value for all components, or a normal and a tangential one."""


def parts(value: Any, name: str) -> tuple[Part, ...]:
    """One value, or the normal and the tangential one; a ValueError for anything else."""
    several = isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim)
    found = tuple(value) if several else (value,)
    if several and len(found) != 2:
        raise ValueError(f"{name} is one value, or a pair: the normal and the tangential one.")
    for part in found:
        given_values.check(part, f"a {name}")
    return found


def _mesh(V: fem.FunctionSpace) -> str:
    """Name and middle of a space's mesh. Collective."""
    mesh = V.mesh
    x = mesh.geometry.x[: mesh.geometry.index_map().size_local, : mesh.geometry.dim]
    total, num = mesh.comm.allreduce(x.sum(axis=0)), mesh.comm.allreduce(len(x))
    return f"{mesh.name!r} around {spot(total / num)}"


class Weighting:
    """C of one interface, for values of c ≥ 0 that may change."""

    name: str
    """Name of c in messages."""
    infinite: str
    """Advice against c = ∞."""

    def __init__(
        self,
        value: Given,
        domain: GapDomain,
        constraint: Constraint,
        spaces: tuple[fem.FunctionSpace, fem.FunctionSpace],
        facets1: npt.NDArray,
    ):
        """Tabulate ∂φ_A/∂α of the multipliers at Gauss points of Σ. Collective.

        Args:
            value: c as it was given.
            domain: Σ.
            constraint: The constraint on it.
            spaces: V₀ and V₁.
            facets1: This rank's facets on Γ1.

        Raises:
            ValueError: c doesn't fit the spaces, is negative or not a number.
        """
        self._parts, self._domain, self._spaces = parts(value, self.name), domain, spaces
        n = spaces[1].mesh.geometry.dim
        if len(self._parts) == 2 and spaces[1].value_shape != (n,):
            raise ValueError(
                f"a normal and a tangential {self.name} need displacements, with {n} components; "
                f"the value shape is {spaces[1].value_shape}."
            )
        self._samples = Samples(domain, constraint)
        self._surfaces = [domain.surfaces[1]] * len(self._parts)
        for k, part in enumerate(self._parts):
            if isinstance(part, fem.Function):
                V = part.function_space
                if V.mesh is not spaces[1].mesh or V.value_shape != () or lagrange_element(V)[1]:
                    raise ValueError(
                        f"a {self.name} that is a function is a scalar one, of a Lagrange space of "
                        f"degree ≥ 1 on the mesh of Γ1's body, {_mesh(spaces[1])}; or give a "
                        "callable of x, which serves on either body."
                    )
                self._surfaces[k] = create_surface(V, facets1, "Γ1")
        self.values()

    @property
    def has_directions(self) -> bool:
        """True if c is one along the normal and another one across it."""
        return len(set(self.key)) == 3  # a name and two values

    @property
    def key(self) -> tuple[Hashable, ...]:
        """Key that is equal for values that are and remain the same."""
        return self.name, *(
            id(part) if given_values.is_read(part) else float(np.real(part))  # type: ignore[arg-type]
            for part in self._parts
        )

    def destroy(self):
        """Destroy the PETSc matrix. Collective."""
        self._samples.destroy()

    @property
    def given(self) -> list[fem.Function | fem.Constant]:
        """Functions and constants that define the values."""
        return given_values.changing(*self._parts)

    def values(self) -> npt.NDArray[np.float64]:
        """Current values at this rank's points, ``(num_parts, num_points)``. Collective.

        Raises:
            ValueError: One is negative, or no number.
        """
        found, error = np.zeros((len(self._parts), len(self._samples.root))), None
        for k, (part, surface) in enumerate(zip(self._parts, self._surfaces, strict=True)):
            dofs, x = places_of_dofs(surface)
            nodal = np.zeros(len(dofs))
            try:
                given = self._on_surface(part, surface, dofs, x)
                if np.any(np.imag(given)):
                    raise ValueError(
                        f"it has an imaginary part; a {self.name} is real: with a complex "
                        "stiffness h take law=lambda jump, n: h * jump, in a NonlinearTiedProblem."
                    )
                nodal[:] = np.real(given)
                nodal = given_values.without_round_off(nodal)
            except Exception as e:
                error = error or f"the {self.name} is no number on Γ1: {e}".splitlines()[0]
            wrong = ~(nodal >= 0) | np.isinf(nodal)
            if wrong.any():
                i = int(wrong.argmax())
                advice = f" (infinite: {self.infinite})" if np.isinf(nodal[i]) else ""
                error = error or (
                    f"the {self.name} is {nodal[i]:.6g} at {spot(x[i])}; it must be ≥ 0 and "
                    f"finite{advice}."
                )
            varies = given_values.is_read(part) and not isinstance(part, fem.Constant)
            # Between nodes a polynomial may be negative
            found[k] = np.maximum(self._along_normals(nodal, surface), 0) if varies else nodal[0]
        raise_on_all(self._domain.comm, error, ValueError)
        return found

    def _on_surface(self, part: Any, surface: Surface, dofs, x) -> npt.ArrayLike:
        """Values at Γ1's dofs; collective for a function."""
        if isinstance(part, fem.Function):
            return values_at(part, dofs)[:, 0]
        if isinstance(part, fem.Constant):
            return part.value
        if given_values.is_read(part):
            return given_values.each(given_values.at_points(part, x), len(x))
        return part

    def _along_normals(self, nodal: npt.NDArray, surface: Surface) -> npt.NDArray[np.float64]:
        """Γ1's value along each point's normal: ∂(α c)/∂α of the φ_a's interpolant."""
        hosts = self._domain.hosts
        alpha = hosts.alpha.ravel()
        X = hosts.X[1].reshape(-1, hosts.X[1].shape[-1])
        use = np.flatnonzero(alpha > 0)
        point, dof, value = interpolation_weights(
            surface, hosts.facets[1].ravel()[use], X[use], alpha[use], self._domain.element
        )
        f = np.zeros(len(alpha))
        np.add.at(f, use[point], value * nodal[np.searchsorted(np.unique(surface.dofs), dof)])
        f_nodes = f.reshape(hosts.alpha.shape)
        dphi = kernel.alpha_derivatives(self._samples.element, self._samples.v)
        found = np.einsum("cpa,ca->cp", dphi, f_nodes).ravel()
        if self._samples.beyond is None:
            return found
        cells, dphi = self._samples.beyond
        return np.append(found, (dphi * f_nodes[cells]).sum(axis=1))

    def matrix(self, values: npt.NDArray) -> PETSc.Mat:
        """C for given :meth:`values`, with rows and columns as B's rows. Collective."""
        block_size = self._spaces[1].dofmap.index_map_bs
        if len(values) == 1:
            return self._samples.scaled_mass(values[0], block_size)
        n = self._samples.normal
        W = values[1][:, None, None] * np.eye(block_size)
        W += (values[0] - values[1])[:, None, None] * n[:, :, None] * n[:, None, :]
        return self._samples.weighted(W)


class Compliance(Weighting):
    """c in u₁ − u₀ = c λ."""

    name = "compliance"
    infinite = "leave the tie out"

    def gives_way(self) -> npt.NDArray[np.bool_]:
        """Mask of compliant multipliers: each part is now more than 0 all around. Collective.

        Returns:
            ``(num_parts, num_multipliers)``, in the order of B's rows, on every rank.
        """
        point, multiplier, _ = triplets(self._samples.D)
        point -= self._samples.D.getOwnershipRange()[0]
        comm = self._domain.comm
        none = np.zeros((len(self._parts), self._samples.D.getSize()[1]), dtype=bool)
        for part, values in zip(none, self.values(), strict=True):
            most = comm.allreduce(values.max(initial=0), MPI.MAX)
            part[multiplier[values[point] <= NOISE * most]] = True
        return ~comm.allreduce(none)  # of truth values the sum is "or"


class Conductance(Weighting):
    """h in λ = h (u₁ − u₀), with the interface of :class:`~.law.Response`."""

    name = "conductance"
    infinite = "tie without it"
    linear = True
    """True if a linear problem can have it."""

    def mass(self) -> PETSc.Mat:
        """M, with rows and columns as B's rows; a new matrix. Collective."""
        return self._samples.scaled_mass(1.0, self._spaces[1].dofmap.index_map_bs)

    def at(self, w: npt.NDArray) -> tuple[npt.NDArray, npt.NDArray]:
        """F(w), and :meth:`values` now. Collective.

        Args:
            w: This rank's rows, ``(num_multipliers, block_size)``.

        Returns:
            As w, and ``(num_parts, num_points)`` for :meth:`tangent`.
        """
        h, w = self.values(), self._samples.values(w)
        f = h[-1][:, None] * w
        if len(h) == 2:
            n = self._samples.normal
            f += ((h[0] - h[1]) * (n * w).sum(axis=1))[:, None] * n
        return self._samples.forces(f), h

    tangent = Weighting.matrix  # ∂F/∂w from what `at` gives
