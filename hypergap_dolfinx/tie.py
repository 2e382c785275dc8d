# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The tie between two surfaces: the user's door to Σ and the constraint."""

import logging
from collections.abc import Hashable
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from dolfinx.mesh import Mesh
from hypergap_dolfinx import disposal
from hypergap_dolfinx.errors import InterfaceError, raise_on_all
from hypergap_dolfinx.gap import compliance as soft
from hypergap_dolfinx.gap import fields, quality
from hypergap_dolfinx.gap.adjust import adjust_surface, with_surfaces
from hypergap_dolfinx.gap.component import Component
from hypergap_dolfinx.gap.constraint import Constraint, create_constraint, expand
from hypergap_dolfinx.gap.domain import GapDomain, create_gap_domain
from hypergap_dolfinx.gap.jump import Given, Jump, gaping, right_side
from hypergap_dolfinx.gap.surface import Surface, create_surface, thinness

LOG = logging.getLogger("hypergap_dolfinx")

ALIKE = 1.1  # ratio of the sides' distances between nodes up to which stiffness decides
THIN = 0.01  # thickness of cells, over their length, of a layer that is Γ1 even if it is finer


class Tie(disposal.Owner):
    """Ties two surfaces whose meshes don't match.

    Between Γ0 and Γ1 lies the gap domain Σ, a mesh of its own with the field α, 0 on Γ0 and 1 on
    Γ1. The tie asks that ∫∫ ∂u/∂α · λ dΓ_α dα = 0 (Giffin 2024, eq. 4) for all λ spanned by the
    ∂φ_a/∂α (eq. 20).

    Γ0's displacements are independent, Γ1 carries the multipliers: put Γ1 on the coarser (and
    softer) side, or leave that to :meth:`between`; but a layer far thinner than its cells are long
    wants to be Γ1, or to have the larger cells. Where surfaces have a kink, both need a node there
    and one of them two edges on each side. Everything here is collective.

    Example:
        Two squares, one on top of the other:

        >>> from mpi4py import MPI  # before dolfinx
        >>> import numpy as np
        >>> from dolfinx import fem, mesh
        >>> from hypergap_dolfinx import Tie
        >>> lower = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (1, 1)], (4, 4))
        >>> upper = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 1), (1, 2)], (3, 3))
        >>> V, facets = [], []
        >>> for body in (lower, upper):
        ...     V.append(fem.functionspace(body, ("Lagrange", 1)))
        ...     on_interface = lambda x: np.isclose(x[1], 1)
        ...     facets.append(mesh.locate_entities_boundary(body, 1, on_interface))
        >>> tie = Tie((V[0], facets[0]), (V[1], facets[1]))
        >>> tie.sigma.topology.index_map(2).size_global  # triangles: one for each edge
        7
    """

    _tells = True  # whether doubts about the interface are logged

    def __init__(
        self,
        side0: tuple[fem.FunctionSpace, npt.ArrayLike],
        side1: tuple[fem.FunctionSpace, npt.ArrayLike],
        *,
        interior: str = "interpolated",
        adjust: bool = False,
        close_gap: bool = False,
        jump: Given | Jump | None = None,
        compliance: soft.Given | None = None,
    ):
        """Mesh Σ between two surfaces. Collective.

        Args:
            side0: Γ0: a Lagrange space of degree k ≥ 1, scalar or blocked, and local indices of
                exterior facets of its mesh, as ``facet_tags.find(tag)`` gives them. Of a mixed
                space, a component of that kind: ``(W.sub(0), facets)`` ties the displacements of
                Taylor–Hood elements; their pressures may jump, and need no tie. ``V.sub(1)`` or
                ``W.sub(0).sub(1)`` ties one displacement of several.
            side1: Γ1: the same; the mesh may be the same one too. Either side may be a component,
                and any other space with the same values on the other side.
            interior: What nodes between the surfaces do (0 < α < 1; the middles of cross edges for
                k ≥ 2). ``"interpolated"``: they take (1 − α) u₀ + α u₁, which leaves one multiplier
                a dof of Γ1. ``"free"``: they are unknowns with multipliers of their own, as in
                eq. (22).
            adjust: Whether to move the nodes on Γ1 first, to where eq. (22) puts them: X_A = P X₀.
                This changes the mesh of Γ1's body. Rigid motions are then exact on curved or gaping
                interfaces too, if the space has the degree of the mesh's geometry; without, a
                rotation strains them by the distance between the surfaces over the cell size: the
                constraint is on displacements, and a gap does not rotate. Nodes at kinks stay. A
                curved surface's rim may leave the plane of the face beside it (2e-3 at h = 0.2 of
                its radius): locate that face's facets before. Make a tie that adjusts before others
                on the same mesh: they know where nodes are.
            close_gap: Whether the constraint is on positions instead of displacements: what gapes
                or overlaps is pulled together, as in an interference fit. Needs displacements.
            jump: g in u₁ − u₀ = g (of positions with ``close_gap``): a number or array, a
                ``fem.Constant``, a ``fem.Function`` on V₁ or V₀, or a callable of x as for
                ``Function.interpolate``. Along Σ's normal, from Γ0 to Γ1, it opens the interface.
                What it is then is read for each right-hand side, so that it may change without
                factorising again. Of pieces of one interface that have different jumps, let both
                surfaces end at one place; there their mean holds, weighted with the multipliers.
            compliance: c in u₁ − u₀ = c λ (+ g), λ being :meth:`traction`: an adhesive layer's
                thickness over its modulus, a thermal contact's resistance. 0 ties, and what isn't 0
                gives way, however little; a body that nothing else holds is held by it. One value,
                or a pair: along Σ's normal and across it (0 ties across). Each is ≥ 0: a number, a
                ``fem.Constant``, a scalar ``fem.Function`` on the mesh of Γ1's body, or a callable
                of x. Read anew when the matrix is assembled; so a law c(u₁ − u₀) of your own is a
                loop that sets it and solves again.

        Raises:
            InterfaceError: Facets or spaces that form no interface; the message says which and why.
            ValueError: A jump or a compliance that doesn't fit the spaces, that isn't finite, or a
                negative compliance.
            InvertedCellError: The surfaces differ so much in shape that Σ folds over.
        """
        if interior not in ("interpolated", "free"):
            raise ValueError(f'interior is "interpolated" or "free", not {interior!r}.')
        for side in (side0, side1):
            if isinstance(side, fem.FunctionSpace) or len(side) != 2:
                raise ValueError("each side of a tie is a pair: a function space and facets.")
            if not isinstance(side[0], fem.FunctionSpace):
                raise ValueError(
                    f"a tie's side is (function space, facets), not ({type(side[0]).__name__}, …)."
                )
        (V0, facets0), (V1, facets1) = side0, side1
        comm = V0.mesh.comm
        self._ticket = disposal.enter(comm)
        if MPI.Comm.Compare(comm, V1.mesh.comm) not in (MPI.IDENT, MPI.CONGRUENT):
            raise InterfaceError(
                "the meshes of Γ0 and Γ1 live on different communicators; make both on one."
            )
        if V0.value_shape != V1.value_shape:
            raise InterfaceError(
                f"the spaces of Γ0 and Γ1 have different value shapes, {V0.value_shape} and "
                f"{V1.value_shape}; tie like with like."
            )
        if V0.mesh.geometry.dim != V1.mesh.geometry.dim:
            raise InterfaceError(
                f"the mesh of Γ0 has {V0.mesh.geometry.dim} coordinates, that of Γ1 "
                f"{V1.mesh.geometry.dim}; they must be equal."
            )
        if close_gap and V1.value_shape != (V1.mesh.geometry.dim,):
            raise InterfaceError(
                f"close_gap needs displacements, with {V1.mesh.geometry.dim} components; the value "
                f"shape is {V1.value_shape}."
            )
        self._interior = interior
        self._close_gap = close_gap
        self._swapped = False
        self._components = Component.of(V0), Component.of(V1)
        self._spaces = self._components[0].space, self._components[1].space
        self._facets = np.asarray(facets0), np.asarray(facets1)
        if adjust:
            move, before = adjust_surface(V0.mesh, facets0, V1.mesh, facets1)
        surfaces = (
            create_surface(self._spaces[0], facets0, "Γ0"),
            create_surface(self._spaces[1], facets1, "Γ1"),
        )
        shared = V0.mesh is V1.mesh and bool(np.isin(facets0, facets1).any())
        message = "Γ0 and Γ1 share facets; give each side its own."
        raise_on_all(comm, message if shared else None)
        known = with_surfaces(before, surfaces) if adjust else None
        self._domain = known or create_gap_domain(comm, *surfaces)
        self._adjusts = adjust
        for doubt in quality.doubts(self._domain, (side0, side1)) if self._tells else ():
            if comm.rank == 0:
                LOG.warning(doubt)
        if adjust:
            move()
        self._blocks: tuple[PETSc.Mat, ...] = ()
        self._jump = jump if jump is None or isinstance(jump, Jump) else Jump(jump)
        self.nodal_jump()
        self._compliance = compliance
        _ = self.compliance  # what is wrong with it is told here

    @classmethod
    def between(
        cls,
        a: tuple[fem.FunctionSpace, npt.ArrayLike],
        b: tuple[fem.FunctionSpace, npt.ArrayLike],
        *,
        stiffness: tuple[float, float] | None = None,
        **options,
    ) -> "Tie":
        """A tie that chooses its sides: Γ1 is the coarser one, then the softer one. Collective.

        But a thin layer, whose cells are a hundred times longer than thick, is Γ1 in any case: as
        Γ0 with smaller cells it would be held at the other side's nodes only, and lose digits. Look
        at :attr:`swapped` (or the log of ``hypergap_dolfinx``): λ acts on Γ0's body, that of
        ``tie.spaces[0]``.

        Args:
            a: A space and facets, as for the constructor.
            b: The same of the other side.
            stiffness: Young's moduli (or conductivities) of a's and b's bodies; they decide where
                the distances between nodes differ by less than a tenth, and without them b is Γ1.
            options: Of the constructor; a jump is that of b over a, u_b − u_a.

        Returns:
            The tie.
        """
        size, thin = [], []
        for side, name in ((a, "the first side"), (b, "the second side")):
            surface = create_surface(Component.of(side[0]).space, side[1], name)
            size.append(float(np.median(surface.size)) / surface.element.degree)
            thin.append(thinness(*side) < THIN)
        ratio = size[0] / size[1]
        if thin[0] != thin[1]:
            swapped, why = thin[0], "thin"
        elif 1 / ALIKE < ratio < ALIKE:
            swapped = stiffness is not None and stiffness[0] < stiffness[1]
            why = "softer" if stiffness is not None and stiffness[0] != stiffness[1] else "second"
        else:
            swapped, why = ratio > 1, "coarser"
        if swapped and options.get("jump") is not None:
            options["jump"] = Jump(options["jump"]).reversed()
        tie = cls(*((b, a) if swapped else (a, b)), **options)
        tie._swapped = swapped
        if tie.sigma.comm.rank == 0:
            reason = "" if why == "second" else f", the {why} one"
            LOG.info("Γ1 is the %s side%s", "first" if swapped else "second", reason)
        return tie

    @property
    def swapped(self) -> bool:
        """Whether :meth:`between` made its first side Γ1."""
        return self._swapped

    def _release(self) -> list:
        """The PETSc matrices, which the tie forgets."""
        objects = [*getattr(self, "_blocks", ()), self.__dict__.pop("compliance", None)]
        objects.append(self.__dict__.pop("constraint", None))
        self._blocks = ()
        return [obj for obj in objects if obj is not None]

    @property
    def spaces(self) -> tuple[fem.FunctionSpace, fem.FunctionSpace]:
        """V₀ and V₁; of a component, its own (collapsed) space."""
        return self._spaces

    @property
    def components(self) -> tuple[Component, Component]:
        """What V₀ and V₁ are among the dofs of their bodies."""
        return self._components

    @property
    def facets(self) -> tuple[npt.NDArray, npt.NDArray]:
        """This rank's facets on Γ0 and on Γ1."""
        return self._facets

    @property
    def block_size(self) -> int:
        """Number of components of the displacement."""
        return self._spaces[0].dofmap.index_map_bs

    @property
    def surfaces(self) -> tuple[Surface, Surface]:
        """Γ0 and Γ1, gathered on every rank."""
        return self._domain.surfaces

    @property
    def domain(self) -> GapDomain:
        """Σ with its arrays."""
        return self._domain

    @property
    def sigma(self) -> Mesh:
        """Σ's mesh. Its cells may have no volume: never integrate over it with ``ufl.dx``."""
        return self._domain.mesh

    @property
    def alpha(self) -> fem.Function:
        """The field α on Σ, from 0 on Γ0 to 1 on Γ1."""
        return self._domain.alpha

    @property
    def free_interior(self) -> bool:
        """Whether Σ's interior nodes are unknowns."""
        return self._interior == "free"

    @property
    def adjusts(self) -> bool:
        """Whether Γ1's nodes were moved."""
        return self._adjusts

    @property
    def closes_gap(self) -> bool:
        """Whether the constraint is on positions."""
        return self._close_gap

    @property
    def jump(self) -> Jump | None:
        """The prescribed jump, if there is one."""
        return self._jump

    def nodal_jump(self) -> tuple[int, npt.NDArray] | None:
        """The jump as it is now, at the dofs of one side. Collective.

        Returns:
            The side and this rank's owned values, ``(num_dofs, block_size)``; None without a jump.
        """
        if self._jump is None:
            return None
        return self._jump.nodal(self._components, self.surfaces)

    @cached_property
    def constraint(self) -> Constraint:
        """The constraint on one component, assembled when it is first asked for."""
        return create_constraint(self._domain, self._spaces, self.free_interior)

    @property
    def gives_way(self) -> Hashable:
        """Equal for ties with the same compliance; None without."""
        return None if self._compliance is None else soft.key(self._compliance)

    @cached_property
    def compliance(self) -> soft.Compliance | None:
        """The matrix C of Σ_i B_i u_i − C λ = c, if there is a compliance."""
        if self._compliance is None:
            return None
        given = self._compliance, self._domain, self.constraint, self._spaces, self._facets[1]
        return soft.Compliance(*given)

    @cached_property
    def _gaping(self) -> npt.NDArray:
        """This rank's rows of Σ_i B_i x_i with the positions x_i of the dofs."""
        return gaping(self.blocks(), self._components, self.surfaces[0].x[0])

    def offset(self) -> PETSc.Vec | None:
        """The right-hand side c of Σ_i B_i u_i = c as it is now. Collective.

        Returns:
            A new vector; None if it is 0, without a jump and without ``close_gap``.
        """
        jump = self.nodal_jump()
        if jump is None and not self._close_gap:
            return None
        return right_side(
            self.blocks(), self._components, jump, self._gaping if self._close_gap else None
        )

    def blocks(self) -> tuple[PETSc.Mat, ...]:
        """The matrices of Σ_i B_i u_i = c, for systems of your own; c is :meth:`offset`.

        Returns:
            B₀ and B₁, ``(num_multipliers, num_dofs_i)``, with V_i's own numbering of dofs, of a
            component ``W.sub(0)`` with W's; with ``interior="free"`` also B_Σ for the displacements
            of Σ's interior nodes. A row for each dof of Γ1 in reach of Γ0 (and each free interior
            one); prescribed displacements are not taken into account. The tie owns them.
        """
        if not self._blocks:
            B0, B1, *interior = (expand(B, self.block_size) for B in self.constraint.B)
            B0, B1 = (part.columns_of_body(B) for part, B in zip(self._components, (B0, B1)))
            self._blocks = (B0, B1, *interior)
        return self._blocks

    def gap(self, u0: fem.Function, u1: fem.Function) -> tuple[fem.Function, fem.Function | None]:
        """Normal gap and tangential slip, eq. (17), of the displacements.

        Args:
            u0: Displacement of Γ0's body: in the order of the tie's sides, not of the problem's
                bodies. Where a component is tied, the body's function with all components, or
                ``u.sub(0)``.
            u1: Displacement of Γ1's body.

        Returns:
            n · ∂u/∂α, positive where the surfaces part, and ∂u/∂α without its normal part; both on
            Σ, discontinuous, in units of the displacement. For scalars ∂u/∂α takes the place of
            the first, and the second is None.

        Raises:
            ValueError: A displacement that is not on its side's space.
        """
        us = []
        for i, (u, part) in enumerate(zip((u0, u1), self._components, strict=True)):
            own = part.own_function(u)
            if own is None:
                raise ValueError(f"u{i} is not on the space of Γ{i} (tie.spaces[{i}]).")
            us.append(own)
        return fields.gap(self._domain, self.constraint, us[0], us[1])

    def traction(self, problem) -> fem.Function:
        """The multiplier λ = Σ_a λ_a ∂φ_a/∂α, eq. (20), of a solved problem.

        Args:
            problem: A solved :class:`TiedProblem` or :class:`NonlinearTiedProblem` with this tie.

        Returns:
            λ on Σ, discontinuous; force per area (2D: per length and unit depth). It is the
            traction on Γ0's body, λ = σ₀n₀ with its outward normal n₀; Γ1's body feels −λ. (Of a
            temperature: +k ∂u/∂n₀, the heat that enters Γ0's body.) To integrate it use
            :meth:`quadrature`: Σ has no volume for ``ufl.dx``.
        """
        multipliers = problem.multipliers(self)
        shape = self._spaces[0].value_shape
        return fields.traction(self._domain, self.constraint, shape, multipliers)

    def quadrature(self, degree: int) -> fields.GapQuadrature:
        """Gauss points on Σ with the measure dΓ_α dα, to integrate there.

        Args:
            degree: Degree of the Gauss rule.
        """
        return fields.create_quadrature(self._domain, degree)
