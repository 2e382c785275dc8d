# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The properties of ties and contacts that solvers use, as protocols."""

from collections.abc import Hashable, Sequence
from typing import Any, Protocol

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from dolfinx.mesh import Mesh
from hypergap_dolfinx.contact_geometry.protocol import Segments
from hypergap_dolfinx.interface_laws.compliance import Compliance, Conductance
from hypergap_dolfinx.interface_laws.law import Response
from hypergap_dolfinx.mortar.constraint import Constraint
from hypergap_dolfinx.mortar.domain import GapDomain
from hypergap_dolfinx.surface.carried import Motion
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.moving import Displacements, MovingSurface
from hypergap_dolfinx.surface.trace import Surface


class Interface(Protocol):
    """Two sides with a constraint between them, such as a tie."""

    @property
    def spaces(self) -> tuple[fem.FunctionSpace, fem.FunctionSpace]:
        """V₀ and V₁."""

    @property
    def facets(self) -> tuple[npt.NDArray, npt.NDArray]:
        """This rank's facets on Γ0 and on Γ1."""

    @property
    def components(self) -> tuple[Component, Component]:
        """V₀ and V₁ among the dofs of their bodies."""

    @property
    def sigma(self) -> Mesh:
        """Σ's mesh."""

    @property
    def domain(self) -> GapDomain:
        """Σ with its arrays."""

    @property
    def surfaces(self) -> tuple[Surface, Surface]:
        """Γ0 and Γ1, where they are on the bodies."""

    def moved(self) -> float:
        """Largest distance of this rank's nodes on both sides from where they were when made."""

    @property
    def block_size(self) -> int:
        """Number of components of the displacement."""

    @property
    def constraint(self) -> Constraint:
        """The constraint on one component."""

    @property
    def free_interior(self) -> bool:
        """True if Σ's interior nodes are unknowns."""

    @property
    def closes_gap(self) -> bool:
        """True if the constraint is on positions."""

    @property
    def discontinuous(self) -> bool:
        """True if λ ends at the ends of Γ1, though other ties go on there."""

    @property
    def motion(self) -> Motion | None:
        """Motion that carries Γ0 to Γ1, of a tie across a distance."""

    @property
    def turn(self) -> npt.NDArray | None:
        """Rotation R in u₁ = R u₀, ``(block_size, block_size)``; None for the identity."""

    def turns(self, u: Sequence[fem.Function]) -> float:
        """Root mean square by which u turn a side's facets; 0 if nothing has directions."""

    def blocks(self) -> tuple[PETSc.Mat, ...]:
        """B₀ and B₁, with free interior nodes also B_Σ."""

    @property
    def compliance(self) -> Compliance | None:
        """Compliance of the interface: the matrix C of Σ_i B_i u_i − C λ = c."""

    @property
    def law(self) -> Response | Conductance | None:
        """Law λ = f(w) of the jump w: F(w) − M λ = 0 and Σ_i B_i u_i − M w = c."""

    @property
    def given(self) -> Sequence[fem.Function | fem.Constant]:
        """Objects in which a user changes its values."""

    @property
    def gives_way(self) -> Hashable:
        """Equal for interfaces with the same compliance, conductance or law; None without."""

    def offset(self) -> PETSc.Vec | None:
        """A new vector c with Σ_i B_i u_i = c now; None if it is 0. Collective."""

    def nodal_jump(self) -> tuple[int, npt.NDArray] | None:
        """A side, and u₁ − u₀ now at its dofs, this rank's owned rows; None if 0. Collective."""


class TiedInterfaces(Protocol):
    """The ties that users give, and the interfaces that these are pieces of."""

    @property
    def ties(self) -> Sequence[Interface]:
        """The ties as given by the user."""

    @property
    def interfaces(self) -> Sequence[Interface]:
        """The interfaces that are solved for."""

    @property
    def names(self) -> Sequence[str]:
        """Names of the interfaces in messages."""

    def find(self, tie) -> int:
        """Number of the interface that contains a tie."""

    def of_piece(self, tie, multipliers: npt.NDArray) -> npt.NDArray:
        """Multipliers of a tie among those of its interface."""

    def turned_over(self, interface: int) -> "TiedInterfaces | None":
        """The interfaces with Γ0 and Γ1 of one exchanged, None where users chose. Collective."""

    def settle(self):
        """Fix the sides of all ties."""

    def destroy(self):
        """Destroy the PETSc objects of interfaces that no user has. Collective."""


class AtVertices(Protocol):
    """A coefficient of a contact that may vary along Γ1."""

    def at_vertices(self) -> npt.NDArray[np.float64]:
        """Numbers ≥ 0 at Γ1's vertices now, the same on every rank. Collective."""


class Coulomb(AtVertices, Protocol):
    """Friction of a contact: its coefficient."""

    @property
    def elastic_slip(self) -> float:
        """Reversible slip at which friction reaches μ p, a length."""

    @property
    def shear_limit(self) -> float:
        """Upper bound of the friction traction."""


class ContactSides(Protocol):
    """Moving sides of a contact, and Σ between them."""

    shown: Any
    """Rows of the problem solved last."""

    @property
    def sides(self) -> tuple[MovingSurface, MovingSurface]:
        """Γ0 and Γ1."""

    @property
    def itself(self) -> bool:
        """True if both sides are one surface."""

    @property
    def follows(self) -> bool:
        """True if gaps are found anew where the bodies are, False if Σ keeps its first place."""

    @property
    def depth(self) -> float:
        """Overlap beyond which a vertex of Γ1 counts as on the far side of Γ0's body, a length."""

    def gaps(self, u: Displacements, held: Sequence[npt.NDArray]) -> Segments:
        """Find the gaps where the bodies are, of which some displacements are prescribed."""


class ContactInterface(Protocol):
    """Two sides that can touch, with a multiplier for each vertex of Γ1."""

    @property
    def components(self) -> tuple[Component, Component]:
        """V₀ and V₁ among the dofs of their bodies."""

    @property
    def spaces(self) -> tuple[fem.FunctionSpace, fem.FunctionSpace]:
        """V₀ and V₁."""

    @property
    def facets(self) -> tuple[npt.NDArray, npt.NDArray]:
        """This rank's facets on Γ0 and on Γ1."""

    @property
    def geometry(self) -> ContactSides:
        """Moving sides and Σ between them."""

    @property
    def friction(self) -> Coulomb | None:
        """Friction, if there is any."""

    @property
    def compliance(self) -> AtVertices | None:
        """Overlap of the surfaces under a pressure of 1; None if they are hard."""
