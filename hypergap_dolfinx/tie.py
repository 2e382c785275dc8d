# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The tie between two surfaces."""

import logging
from collections.abc import Callable, Hashable, Sequence
from copy import copy
from functools import cached_property, partial
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from dolfinx.mesh import Mesh
from hypergap_dolfinx.algebra import revolution
from hypergap_dolfinx.algebra.checks import label
from hypergap_dolfinx.algebra.rigid_motions import moment
from hypergap_dolfinx.core import collective
from hypergap_dolfinx.core.collective import raise_on_all, values_at
from hypergap_dolfinx.errors import InterfaceError, InvertedCellError
from hypergap_dolfinx.interface_laws import compliance as soft
from hypergap_dolfinx.interface_laws import law as laws
from hypergap_dolfinx.interface_laws.given_values import Given, Settable, as_moduli, as_numbers
from hypergap_dolfinx.interface_laws.jump import Jump, gaping, right_side
from hypergap_dolfinx.mortar import fields
from hypergap_dolfinx.mortar.adjust import adjust_surface, with_surfaces
from hypergap_dolfinx.mortar.constraint import Constraint, create_constraint, expand
from hypergap_dolfinx.mortar.domain import GapDomain, create_gap_domain, doubts
from hypergap_dolfinx.mortar.recovery import Recovery
from hypergap_dolfinx.solvers.newton import NonlinearSystem
from hypergap_dolfinx.surface import carried
from hypergap_dolfinx.surface.boundary import Places
from hypergap_dolfinx.surface.carried import Motion
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.moving import MovingSurface
from hypergap_dolfinx.surface.trace import (
    Surface,
    as_facets,
    check_sides,
    create_surface,
    thinness,
)
from hypergap_dolfinx.tolerances import ALIKE, FEW_FACETS, THIN_LAYER

LOG = logging.getLogger("hypergap_dolfinx")


class Tie(Settable, collective.Owner):
    """A tie between two surfaces whose meshes don't match.

    The gap domain Σ between Γ0 and Γ1 has a mesh of its own, with a field α that is 0 on Γ0 and 1
    on Γ1. The tie enforces ∫∫ ∂u/∂α · λ dΓ_α dα = 0 (Giffin 2024, eq. 4) for all multipliers λ in
    the span of the ∂φ_a/∂α (eq. 20).

    The displacements of Γ0 are independent; Γ1 carries the multipliers. Γ1 should be the coarser
    side, or the softer one if the cell sizes are alike: :meth:`between` chooses it. A layer that is
    far thinner than its cells are long should be Γ1, or have the larger cells. At a kink both
    surfaces need a node, and one of them needs two edges on each side of it. All methods are
    collective.

    Displacements should not be prescribed on whole facets of Γ1 where Γ0 can move: a problem
    refuses the tie if no multiplier is left there. λ goes on from the free facets beside the
    prescribed ones; a Γ1 of at most 32 nodes that is prescribed all over keeps its multipliers, and
    Γ0 follows it in the mean only: where Γ0 is finer, it moves between the nodes of Γ1.

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

    _tells = True  # True if doubts about the interface are logged

    def __init__(
        self,
        side0: tuple[fem.FunctionSpace, npt.ArrayLike],
        side1: tuple[fem.FunctionSpace, npt.ArrayLike],
        *,
        interior: str = "interpolated",
        adjust: bool = False,
        close_gap: bool = False,
        jump: Given | Jump | None = None,
        motion: Motion | None = None,
        compliance: soft.Given | None = None,
        conductance: soft.Given | None = None,
        law: laws.Given | laws.Law | None = None,
        discontinuous: bool = False,
        axisymmetric: revolution.Given = False,
    ):
        """Mesh Σ between two surfaces. Collective.

        Args:
            side0: Γ0: a pair ``(V, facets)``. V is a Lagrange space of degree ≥ 1, scalar or
                blocked. ``facets`` are local indices of exterior facets of its mesh, as given by
                ``facet_tags.find(tag)``. V may be a component of a mixed space: ``W.sub(0)`` ties
                the displacements of Taylor–Hood elements (their pressures need no tie).
                ``V.sub(1)`` and ``W.sub(0).sub(1)`` tie a single displacement.
            side1: Γ1: the same, with values of the same shape. Both sides may be on one mesh.
            interior: Treatment of Σ's interior nodes, 0 < α < 1 (degree ≥ 2 only).
                ``"interpolated"``: their displacement is (1 − α) u₀ + α u₁, so that each dof of Γ1
                has one multiplier. ``"free"``: they are unknowns with multipliers, as in eq. (22).
            adjust: True to move the nodes of Γ1 first, to X_A = P X₀ of eq. (22). This changes the
                mesh of Γ1's body. Rigid motions are then exact on curved interfaces and across
                gaps, if the space has the degree of the mesh's geometry. Without it, a rotation
                causes strains of the size of gap over cell size, since the constraint is on
                displacements. Nodes at kinks are not moved. The rim of a curved surface may leave
                the plane of an adjacent face (by 2e-3 at h = 0.2 of the radius): locate the facets
                of that face before. Other ties on the mesh store positions of nodes: make the tie
                that adjusts first.
            close_gap: True for a constraint on positions instead of displacements. It closes gaps
                and overlaps, as in an interference fit. Between curved surfaces with straight edges
                these include the gaps of the two polygons (a warning tells of them): use curved
                cells, with spaces of any degree, or prescribe the interference as a ``jump``.
            jump: Prescribed jump g in u₁ − u₀ = g (a jump of positions with ``close_gap``): a
                number, an array, a ``fem.Constant``, a ``fem.Function`` on V₁ or V₀, or a callable
                of x as for ``Function.interpolate``. A jump along Σ's normal, from Γ0 to Γ1, opens
                the interface. It doesn't turn with the bodies. It is evaluated for each right-hand
                side: a change needs no new factorisation. Where two ties with different jumps meet,
                both surfaces should end at the same place; there the mean of the jumps holds,
                weighted by the multipliers.
            motion: Motion that carries Γ0 to Γ1 in a periodic tie, from :meth:`periodic`.
            compliance: Compliance c ≥ 0 in u₁ − u₀ = c λ (+ g), where λ is :meth:`traction`: the
                thickness of an adhesive layer over its modulus, or a thermal contact resistance.
                One value, or a pair (along Σ's normal, tangential to it, as in the meshes: they
                don't turn with the bodies). Each is a number, a
                ``fem.Constant``, a scalar ``fem.Function`` on the mesh of Γ1's body, or a callable
                of x. 0 is a rigid tie. Any c > 0 supports a body without other supports. A
                tangential compliance far above that of a cell permits sliding; on curved surfaces
                this needs curved cells, since polygons interlock. It is evaluated when the matrix
                is assembled. If both sides are prescribed entirely, λ depends on c alone: values
                that are 0 when the problem is made must stay 0, and of a pair both are 0 or none.
            conductance: Conductance h ≥ 0 in λ = h (u₁ − u₀ − g), instead of a compliance: heat
                flow between touching bodies. 0 is an insulator. It is given like ``compliance``.
                Use it instead of a compliance 1 / h if h varies much: h is averaged over Σ's
                cells, so that a single node with h > 0 conducts.
            law: Interface law λ = f(u₁ − u₀), instead of a compliance: an adhesive that softens
                and fails, or a spring that only pushes. A function of two UFL expressions, the jump
                (minus g) and the meshes' unit normal from Γ0 to Γ1, that returns λ in UFL:
                ``law=lambda jump, n: k * jump``. UFL differentiates it, also through
                ``conditional`` and ``max_value``, so that Newton's method has the exact tangent.
                With a potential ψ return ``ufl.diff(psi, w)``, ``w = ufl.variable(jump)``. It may
                contain a ``fem.Constant`` that changes between solves. It has no memory: unloading
                follows the loading path. Compare complex values with ``ufl.real(…)``. Accepted by
                :class:`NonlinearTiedProblem` and :class:`ContactProblem`.
            discontinuous: True if λ may jump to other ties of the same surfaces. Where both bodies
                consist of several materials the traction jumps between them: make one tie for each
                material, with this option and with both surfaces ending at the same place. Without
                it, λ is continuous across the ties of a smooth surface.
            axisymmetric: True for bodies of revolution about the axis r = x[0] = 0 whose forms have
                the factor 2πr. The integrals of the tie then have it too: λ is a force per area,
                and :meth:`quadrature` integrates it to the force on the whole circumference.
                ``"radian"`` if the forms have the factor r. The number of components is free, as
                with a twist (u_r, u_z, u_θ).

        Raises:
            InterfaceError: The facets or spaces form no interface; the message says why.
            ValueError: A jump, compliance, conductance or law doesn't fit the spaces, isn't finite
                or is negative, or two of the last three are given.
            InvertedCellError: The shapes of the surfaces differ so much that Σ folds.
        """
        if interior not in ("interpolated", "free"):
            raise ValueError(f'interior is "interpolated" or "free", not {interior!r}.')
        check_sides("tie", side0, side1)
        (V0, facets0), (V1, facets1) = side0, side1
        comm = V0.mesh.comm
        self._ticket = collective.enter(comm)
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
        if motion is not None and (adjust or close_gap):
            raise InterfaceError("a periodic tie neither adjusts surfaces nor closes gaps.")
        self.motion = motion
        """Motion that carries Γ0 to Γ1, of a periodic tie."""
        self.turn = motion.of_components(V1.value_shape) if motion else None
        """Rotation R in u₁ = R u₀, ``(block_size, block_size)``."""
        self.free_interior = interior == "free"
        """True if Σ's interior nodes are unknowns."""
        self.closes_gap = close_gap
        """True if the constraint is on positions."""
        self.discontinuous = discontinuous
        """True if λ may jump to other ties of the same surfaces."""
        self._swapped = False
        self._other: Callable[[str], Tie] | None = None  # with the sides exchanged, and why
        self._preference = np.inf  # for its sides, over those of ties on the same faces
        self.components = Component.of(V0), Component.of(V1)
        """Dofs of V₀ and V₁ among those of their bodies."""
        if motion is not None and motion.turns and any(p.of_vector for p in self.components):
            raise InterfaceError(
                "a rotation turns vectors as a whole: tie the vector, not a component such as "
                "V.sub(0)."
            )
        self._spaces = self.components[0].space, self.components[1].space
        self._facets = as_facets(facets0), as_facets(facets1)
        self.axisymmetric = axisymmetric
        """Factor of the forms. True for 2πr, "radian" for r, False for plane bodies."""
        angle = revolution.angle_of(axisymmetric)
        if adjust:
            move, before = adjust_surface(V0.mesh, facets0, V1.mesh, facets1)
        surfaces = (
            revolution.swept(create_surface(self._spaces[0], facets0, "Γ0"), angle, motion),
            revolution.swept(create_surface(self._spaces[1], facets1, "Γ1"), angle, motion),
        )
        shared = V0.mesh is V1.mesh and bool(np.isin(facets0, facets1).any())
        message = "Γ0 and Γ1 share facets; give each side its own."
        raise_on_all(comm, message if shared else None)
        self._surfaces = surfaces
        if motion is not None:
            surfaces = carried.surface(surfaces[0], motion, surfaces[1]), surfaces[1]
        known = with_surfaces(before, surfaces) if adjust else None
        self._domain = known or create_gap_domain(comm, *surfaces)
        self.adjusts = adjust
        """True if Γ1's nodes were moved."""
        moments = V1.value_shape == (V1.mesh.geometry.dim,) and motion is None and not close_gap
        sides = side0, side1
        for doubt in doubts(self._domain, sides, moments, close_gap) if self._tells else ():
            if comm.rank == 0:
                LOG.warning(doubt)
        if adjust:
            move()
        self._places = tuple(Places(V.mesh, f) for V, f in zip(self._spaces, self._facets))
        self._blocks: tuple[PETSc.Mat, ...] = ()
        self._own_blocks: tuple[PETSc.Mat, ...] = ()
        self._jump = jump if jump is None or isinstance(jump, Jump) else Jump(jump)
        self.nodal_jump()
        given = {"compliance": compliance, "conductance": conductance, "law": law}
        self._gives: dict[str, Any] = {k: v for k, v in given.items() if v is not None}
        if len(self._gives) > 1:
            raise ValueError(f"give a {' or a '.join(self._gives)}, not both.")
        _ = self.compliance, self.law  # raises for wrong ones
        self._made = True

    @classmethod
    def between(
        cls,
        a: tuple[fem.FunctionSpace, npt.ArrayLike],
        b: tuple[fem.FunctionSpace, npt.ArrayLike],
        *,
        stiffness: tuple[float, float] | None = None,
        **options,
    ) -> "Tie":
        """A tie that chooses its sides. Collective.

        Γ1 becomes the coarser side; if node distances differ by less than a tenth, the softer one.
        In the plane a coarser side of degree 1 with only two facets becomes Γ0 (λ would be
        constant if it has no multipliers at its ends), unless the finer side is stiffer. A thin
        layer, with cells a hundred times as long as thick, is always Γ1: as a finer Γ0 it would be
        tied at the nodes of the other side only, and lose digits. The first problem with the tie
        may exchange the sides: where it would refuse them, since whole facets of Γ1 are prescribed
        while Γ0 can move (see :class:`Tie`); and where several bodies meet on a smooth face, so
        that it is Γ1 of all its ties or Γ0 of all.
        :attr:`swapped` and the log of ``hypergap_dolfinx`` tell the outcome. λ acts on the body of
        Γ0, that of ``tie.spaces[0]``.

        Args:
            a: One side: a space and facets, as for the constructor.
            b: The other side.
            stiffness: Young's moduli (or conductivities) of the bodies of a and b. Without them b
                is Γ1 if node distances are alike.
            options: Options of the constructor. A jump, also that of a law, is u_b − u_a.

        Returns:
            The tie.
        """
        check_sides("tie", a, b)
        if stiffness is not None:
            stiffness = as_moduli(stiffness)
        size, thin, num = [], [], []
        for side, name in ((a, "the first side"), (b, "the second side")):
            surface = create_surface(Component.of(side[0]).space, side[1], name)
            size.append(float(np.median(surface.size)) / surface.element.degree)
            thin.append(thinness(*side) < THIN_LAYER)
            plain = surface.gdim == 2 and surface.element.degree == 1
            num.append(len(surface.facets) if plain else np.inf)
        ratio = size[0] / size[1]
        if thin[0] != thin[1]:
            swapped, why, preference = thin[0], "thin", np.inf
        elif 1 / ALIKE < ratio < ALIKE:
            swapped = stiffness is not None and stiffness[0] < stiffness[1]
            preference = 0.0 if stiffness is None else abs(np.log(stiffness[0] / stiffness[1]))
            why = "softer" if preference > 0 else "second"
        else:
            swapped, why, preference = ratio > 1, "coarser", abs(np.log(ratio))
            one, other = (0, 1) if swapped else (1, 0)
            softer = stiffness is None or stiffness[other] <= stiffness[one]
            if softer and num[one] <= min(FEW_FACETS, num[other] - 1):
                swapped, why = not swapped, "finer"

        def create(swapped: bool, reason: str) -> "Tie":
            given = dict(options)
            if swapped and given.get("jump") is not None:
                given["jump"] = Jump(given["jump"]).reversed()
            if swapped and given.get("law") is not None:
                given["law"] = laws.Law(given["law"]).reversed()
            tie = cls(*((b, a) if swapped else (a, b)), **given)
            tie._swapped, tie._preference = swapped, preference
            if not tie.adjusts:  # else Γ1 has been moved
                tie._other = partial(create, not swapped)
            if tie.domain.comm.rank == 0:
                which = f"{'first' if swapped else 'second'} side{label(tie.spaces[1].mesh)}"
                LOG.info("Γ1 is the %s%s", which, reason)
            return tie

        return create(swapped, "" if why == "second" else f", the {why} one")

    @property
    def _may_turn_over(self) -> bool:
        """True if :meth:`between` chose the sides and no problem has the tie yet."""
        return self._other is not None

    def _settle(self):
        """Fix the choice of sides."""
        self._other = None

    def _turn_over(self, why: str) -> bool:
        """Exchange Γ0 and Γ1. Collective.

        Args:
            why: The reason, for the log.

        Returns:
            False, with the tie unchanged, if no Σ exists for the exchanged sides, or if the meshes
            have moved since the tie was made.
        """
        assert self._other is not None
        try:
            other = self._other(why)
        except (InterfaceError, InvertedCellError):  # the same on all ranks
            return False
        sides = zip(self.surfaces, other.surfaces[::-1], strict=True)
        if any((mine.nodes != now.nodes).any() for mine, now in sides):
            other.destroy()
            return False
        self.destroy()
        self.__dict__, other.__dict__ = other.__dict__, {}
        return True

    @classmethod
    def periodic(
        cls,
        side0: tuple[fem.FunctionSpace, npt.ArrayLike],
        side1: tuple[fem.FunctionSpace, npt.ArrayLike],
        *,
        translation: npt.ArrayLike | None = None,
        rotation: npt.ArrayLike | None = None,
        centre: npt.ArrayLike | None = None,
        axis: npt.ArrayLike | None = None,
        **options,
    ) -> "Tie":
        """A periodic tie: opposite faces of a unit cell, or of a cyclic sector. Collective.

        A translation or rotation carries Γ0 to Γ1, where the two are tied: u₁ = u₀, or u₁ = u₀ + g
        with a jump g. A rotation also turns the components of vectors: u₁ = R u₀ + g. The faces may
        belong to one mesh or to several, with any cells, but their outlines must fit. Make one tie
        for each pair of faces. Redundant constraints at edges and corners are left out.

        The cell can still translate (a sector can turn about its axis and slide along it): fix a
        node or the mean.

        Args:
            side0: Γ0: a space and facets, as for the constructor.
            side1: Γ1, which carries the multipliers: the side with the larger cells.
            translation: Vector from Γ0 to Γ1, ``(n,)``.
            rotation: Rotation from Γ0 to Γ1: an angle in radians, counterclockwise, or a matrix R,
                ``(n, n)``.
            centre: A point on the axis of rotation, ``(n,)``; the origin by default.
            axis: Direction of the axis of rotation in 3D, ``(3,)``; z by default.
            options: Options of the constructor, except ``adjust`` and ``close_gap``.

        Returns:
            The tie. Its Σ lies on Γ1, and so do λ, gap, slip and the tractions of both sides. Rᵀλ
            acts on the body of Γ0.

        Raises:
            ValueError: Both a translation and a rotation, neither, or the identity.
            InterfaceError: Γ0 isn't carried to Γ1; the message gives the distance.

        Example:
            A square under a mean strain ε: opposite faces move apart by ε times their distance.
            The strain is evaluated at each solve: one factorisation serves all load cases.

            >>> from mpi4py import MPI  # before dolfinx
            >>> import numpy as np
            >>> from dolfinx import fem, mesh
            >>> from hypergap_dolfinx import Tie
            >>> cell = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (1, 1)], (4, 4))
            >>> V = fem.functionspace(cell, ("Lagrange", 1, (2,)))
            >>> strain, ties = np.zeros((2, 2)), []
            >>> for axis, t in enumerate(np.eye(2)):
            ...     faces = [
            ...         mesh.locate_entities_boundary(cell, 1, lambda x: np.isclose(x[axis], end))
            ...         for end in (0, 1)
            ...     ]
            ...     sides = [(V, facets) for facets in faces]
            ...     jump = lambda x, t=t: strain @ t
            ...     ties.append(Tie.periodic(*sides, translation=t, jump=jump))
            >>> strain[0, 0] = 0.01  # then solve, change it, and solve again
        """
        n = side1[0].mesh.geometry.dim
        motion = carried.motion(n, translation, rotation, centre, axis)
        return cls(side0, side1, motion=motion, **options)

    @property
    def swapped(self) -> bool:
        """True if :meth:`between`, or a problem with the tie, made its first side Γ1."""
        return self._swapped

    def destroy(self):
        """Destroy the PETSc objects now. Collective.

        Otherwise they are destroyed automatically; on several ranks, when the next tie or problem
        is made.
        """
        for name in ("_recovery", "compliance", "law", "constraint"):
            part = self.__dict__.pop(name, None)
            if part is not None:
                part.destroy()
        super().destroy()

    def _release(self) -> list:
        """The blocks, removed from the tie."""
        objects = list(getattr(self, "_own_blocks", ()))
        self._blocks = self._own_blocks = ()
        return objects

    @property
    def spaces(self) -> tuple[fem.FunctionSpace, fem.FunctionSpace]:
        """V₀ and V₁; for a component of a mixed space its collapsed space."""
        return self._spaces

    @property
    def facets(self) -> tuple[npt.NDArray, npt.NDArray]:
        """This rank's facets on Γ0 and on Γ1."""
        return self._facets

    @property
    def block_size(self) -> int:
        """Number of components of the displacement."""
        return self._spaces[0].dofmap.index_map_bs

    def moved(self) -> float:
        """Largest distance of this rank's nodes on both sides from where they were when made."""
        return max(places.moved() for places in self._places)

    @property
    def surfaces(self) -> tuple[Surface, Surface]:
        """Γ0 and Γ1, gathered on every rank."""
        return self._surfaces

    @property
    def domain(self) -> GapDomain:
        """The gap domain Σ as arrays."""
        return self._domain

    @property
    def sigma(self) -> Mesh:
        """Mesh of Σ, made on first access. Collective.

        Its cells may have no volume: integrate with :meth:`quadrature`, not with ``ufl.dx``.
        """
        return self._domain.mesh

    @property
    def alpha(self) -> fem.Function:
        """The field α on Σ, from 0 on Γ0 to 1 on Γ1. Collective."""
        return self._domain.alpha

    @property
    def jump(self) -> Jump | None:
        """The prescribed jump, or None."""
        return self._jump

    def nodal_jump(self) -> tuple[int, npt.NDArray] | None:
        """Current jump at the dofs of one side. Collective.

        Returns:
            The side and this rank's owned values, ``(num_dofs, block_size)``; None without a jump.
        """
        if self._jump is None:
            return None
        return self._jump.nodal(self.components, self.surfaces)

    @cached_property
    def constraint(self) -> Constraint:
        """The constraint on one component, assembled on first access."""
        return create_constraint(self._domain, self._spaces, self.free_interior)

    @cached_property
    def _recovery(self) -> Recovery:
        """System for the tractions on the bodies' surfaces."""
        return Recovery(self._domain, self.constraint)

    @property
    def gives_way(self) -> Hashable:
        """Key that is equal for ties with the same compliance, conductance or law; None without."""
        what = self.compliance or self.law
        return what and what.key

    @cached_property
    def compliance(self) -> soft.Compliance | None:
        """Compliance operator C of Σ_i B_i u_i − C λ = c; None without a compliance.

        ``tie.compliance.matrix(tie.compliance.values())`` is C as a new PETSc matrix.
        """
        return self._weighting(soft.Compliance)

    @property
    def given(self) -> list[fem.Function | fem.Constant]:
        """Functions and constants that define the jump, compliance, conductance or law."""
        return [v for one in (self.jump, self.compliance, self.law) if one for v in one.given]

    @cached_property
    def law(self) -> laws.Response | soft.Conductance | None:
        """Operators F(w), ∂F/∂w and M of Σ_i B_i u_i − M w = c, F(w) − M λ = 0; None without a law.

        A conductance is the law F(w) = H w.
        """
        law = self._gives.get("law")
        if law is None:
            return self._weighting(soft.Conductance)
        law = law if isinstance(law, laws.Law) else laws.Law(law)
        return laws.Response(law, self._domain, self.constraint, self._spaces[1])

    def turns(self, u: Sequence[fem.Function]) -> float:
        """Root mean square by which displacements turn a side's facets, in radians. Collective.

        The larger one of both sides. 0 if nothing of the tie has directions: they are those of the
        meshes as they were made.
        """
        law, found = self.compliance or self.law, [0.0]
        if law is None or not law.has_directions or self.block_size != self._surfaces[1].gdim:
            return 0.0
        for part, surface in zip(self.components, self._surfaces, strict=True):
            side = MovingSurface(surface)
            own = [f for f in map(part.own_function, u) if f is not None]
            found += [side.turns(values_at(f, side.dofs).real) for f in own[:1]]
        return max(found)

    def _weighting[T: soft.Weighting](self, kind: type[T]) -> T | None:
        """The compliance or the conductance, if given."""
        value = self._gives.get(kind.name)
        if value is None:
            return None
        return kind(value, self._domain, self.constraint, self._spaces, self._facets[1])

    @cached_property
    def _gaping(self) -> npt.NDArray:
        """This rank's rows of the gaps between the surfaces."""
        return gaping(self.blocks(), self.components, self.domain, self.constraint)

    def offset(self) -> PETSc.Vec | None:
        """Current right-hand side c of Σ_i B_i u_i = c. Collective.

        Returns:
            A new vector; None, for c = 0, without a jump and ``close_gap``.
        """
        jump = self.nodal_jump()
        if jump is None and not self.closes_gap:
            return None
        return right_side(
            self.blocks(), self.components, jump, self._gaping if self.closes_gap else None
        )

    def blocks(self) -> tuple[PETSc.Mat, ...]:
        """Matrices B_i of Σ_i B_i u_i = c, for a system of your own; c is :meth:`offset`.

        Returns:
            B₀ and B₁, ``(num_multipliers, num_dofs_i)``, with the dof numbering of V_i, for a
            component ``W.sub(0)`` that of W. With ``interior="free"`` also B_Σ, for the
            displacements of Σ's interior nodes. There is a row for each dof of Γ1 that lies
            opposite Γ0 (and each free interior dof). Prescribed displacements are not eliminated.
            The matrices may outlive the tie.
        """
        if not self._blocks:
            B0, B1, *interior = self.constraint.B
            B0, B1 = (
                part.columns_of_body(expand(B, self.block_size, turn))
                for part, B, turn in zip(self.components, (B0, B1), (self.turn, None))
            )
            self._own_blocks = (B0, B1, *(expand(B, self.block_size) for B in interior))
            # With references of their own, since these are destroyed with the tie
            self._blocks = tuple(map(copy, self._own_blocks))
        return self._blocks

    def gap(self, u0: fem.Function, u1: fem.Function) -> tuple[fem.Function, fem.Function | None]:
        """Normal gap and tangential slip of given displacements, eq. (17). Collective.

        Args:
            u0: Displacement of one body, that of Γ0 if both sides are on one body. For a tied
                component the function of the body with all components, or ``u.sub(0)``.
            u1: Displacement of the other body.

        Returns:
            The gap n · ∂u/∂α, positive where the surfaces separate, and the slip, ∂u/∂α minus its
            normal part. For scalars ∂u/∂α and None. Both are discontinuous functions on Σ, in
            units of the displacement. On curved cells they are least-squares fits with the exact
            integral over each cell.

        Raises:
            ValueError: A function that is on the space of no side.
        """
        us = []
        if not all(isinstance(u, fem.Function) for u in (u0, u1)):
            raise ValueError("gap(u0, u1) takes the displacements of both bodies, as functions.")
        if all(part.own_function(u) is None for u, part in zip((u0, u1), self.components)):
            u0, u1 = u1, u0
        for i, (u, part) in enumerate(zip((u0, u1), self.components, strict=True)):
            own = part.own_function(u)
            if own is None:
                raise ValueError(f"u{i} is not on the space of Γ{i} (tie.spaces[{i}]).")
            us.append(own)
        return fields.gap(self._domain, self.constraint, us[0], us[1], self.turn)

    def traction(self, problem, *, on: str = "sigma") -> fem.Function:
        """Traction between the bodies of a solved problem. Collective.

        Args:
            problem: A solved problem with this tie.
            on: ``"sigma"``: the multiplier λ = Σ_a λ_a ∂φ_a/∂α of eq. (20), a discontinuous
                function on Σ (on curved cells a least-squares fit with the exact integral over
                each cell). It acts on the body of Γ0: λ = σ₀n₀ with the outward normal n₀; −λ acts
                on the body of Γ1. For a temperature it is k ∂u/∂n₀, the heat that enters the body
                of Γ0. Integrate it with :meth:`quadrature`, since Σ has no volume for ``ufl.dx``.

                ``"side0"``, ``"side1"``: the traction σᵢnᵢ on the body of Γᵢ, recovered from the
                nodal forces of both sides. It is smooth, and one order more accurate than λ, but
                not where fields change within a few facets. The smoothing adapts to λ, so that the
                result is linear in λ up to its error only. It is a Lagrange function on a mesh of
                its own, the tied part of Γᵢ:
                ``fem.assemble_scalar(fem.form(ufl.inner(t, t) * ufl.dx))`` integrates it,
                ``ufl.CellNormal(t.function_space.mesh)`` is nᵢ, and VTX files take it. At kinks it
                has a value on each side. The tractions of the two sides are opposite, and their
                integrals equal the force, up to the error of the recovery.

        Returns:
            A force per area of the side (in the plane a force per length and unit depth). The areas
            of sides that lie apart differ; the integral of λ is the force. :meth:`force` and
            :meth:`moment` are exact; the moment of λ has the error of λ.

        Raises:
            ValueError: A tie that isn't one of the problem's, a problem that isn't solved, or an
                unknown ``on``.
        """
        if on not in ("sigma", "side0", "side1"):
            raise ValueError(f'on is "sigma", "side0" or "side1", not {on!r}.')
        multipliers = self._multipliers(problem)
        shape = self._spaces[0].value_shape
        if on == "sigma":
            return fields.traction(self._domain, self.constraint, shape, multipliers)
        return self._recovery.traction(int(on[-1]), shape, multipliers)

    def force(self, problem, *, on: fem.Function | None = None) -> npt.NDArray:
        """Force on a body, the sum of the nodal forces −Bᵀλ, exact. Collective.

        Args:
            problem: A solved problem with this tie.
            on: Displacement of the body, one that the problem's ``solve()`` returns. By default
                the body of the second side as given to the constructor or to :meth:`between`,
                whichever became Γ1. The opposite force acts on the other body.

        Returns:
            Force, ``(block_size,)``, the same on every rank, in 2D per unit depth; for a
            temperature the heat flow into the body. For bodies of revolution it is the force on
            the whole circumference (or on a radian), and the radial component is a sum over all
            directions.

        Raises:
            ValueError: A tie that isn't one of the problem's, a problem that isn't solved, a
                function of neither body, or one of both sides.
        """
        comm = self._domain.comm
        return comm.allreduce(self._nodal_forces(problem, self._side(on)).sum(axis=0))

    def moment(
        self,
        problem,
        about: npt.ArrayLike,
        *,
        on: fem.Function | None = None,
        displaced: bool | None = None,
    ) -> npt.NDArray:
        """Moment of the nodal forces about a point, Σ (x − x₀) × f, exact. Collective.

        If the surfaces lie apart, the moments on the two bodies differ by the force times the
        distance (see ``adjust``).

        Args:
            problem: A solved problem with this tie.
            about: The point x₀, ``(n,)``.
            on: Displacement of the body, as in :meth:`force`.
            displaced: True for the nodes' displaced positions, with which moments balance if
                strains are finite; False for those of the mesh, with which they do if strains are
                small. By default False in a :class:`TiedProblem`, True in other problems, as in
                :meth:`Contact.moment`.

        Returns:
            Moment, ``(3,)`` in space, ``(1,)`` in the plane, the same on every rank.

        Raises:
            ValueError: As :meth:`force`; values that aren't displacements; bodies of revolution; a
                point of the wrong shape; another ``displaced``.
        """
        side = self._side(on)
        if displaced not in (None, False, True):
            raise ValueError(f"displaced is {displaced!r}: give True, False or None.")
        V, n = self._spaces[side], self.surfaces[0].gdim
        if V.value_shape != (n,):
            raise ValueError(f"a moment needs displacements; the value shape is {V.value_shape}.")
        if self.axisymmetric:
            raise ValueError("a body of revolution has no moment; take force().")
        point = as_numbers(about, (n,), "about")
        forces = self._nodal_forces(problem, side)
        arm = V.tabulate_dof_coordinates()[: len(forces), :n] - point
        if isinstance(problem, NonlinearSystem) if displaced is None else displaced:
            given = map(self.components[side].own_function, problem.u)
            own = next(u for u in given if u is not None)
            arm = arm + own.x.array.real.reshape(-1, n)[: len(forces)]
        return self._domain.comm.allreduce(moment(arm, forces))

    def _side(self, on: fem.Function | None) -> int:
        """The side of a body, by its displacement; the second one as given. Collective."""
        if on is None:
            return 0 if self._swapped else 1
        of_function = isinstance(on, fem.Function)
        parts = self.components if of_function else ()
        found = [i for i, part in enumerate(parts) if part.own_function(on) is not None]
        if not found:
            raise ValueError(
                "on= takes the displacement of one of the tie's bodies"
                f"{'' if of_function else f', a function, not a {type(on).__name__}'}."
            )
        if len(found) == 2:
            raise ValueError("both sides are on this body: leave out on=, for the second side.")
        return found[0]

    def _multipliers(self, problem) -> npt.NDArray:
        """Multipliers of this tie in a solved problem. Collective."""
        if not hasattr(problem, "multipliers"):
            raise ValueError(f"give the problem with this tie, not a {type(problem).__name__}.")
        return problem.multipliers(self)

    def _nodal_forces(self, problem, side: int) -> npt.NDArray:
        """Forces at this rank's dofs of a side's space, ``(num_dofs, block_size)``. Collective."""
        forces = fields.nodal_forces(self.constraint, side, self._multipliers(problem))
        return forces @ self.turn if side == 0 and self.turn is not None else forces

    @cached_property
    def area(self) -> float:
        """Tied area, in 2D tied length, the mean of both sides. Collective."""
        q = self.quadrature(2 * self.domain.geometry.degree)
        return float(q.integrate(np.ones_like(q.weights)))

    def quadrature(self, degree: int) -> fields.GapQuadrature:
        """Gauss points on Σ with the measure dΓ_α dα, for integrals on Σ. Collective.

        Args:
            degree: Degree of polynomials that the rule integrates exactly.

        Raises:
            ValueError: A degree that isn't an integer from 0 on.
        """
        if not isinstance(degree, int | np.integer) or degree < 0:
            raise ValueError(f"the degree is {degree!r}: give an integer from 0 on.")
        return fields.create_quadrature(self._domain, degree)
