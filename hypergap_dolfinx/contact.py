# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact between two surfaces: gaps, pressures and forces."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from dolfinx.mesh import Mesh
from hypergap_dolfinx.algebra import revolution
from hypergap_dolfinx.algebra.checks import label
from hypergap_dolfinx.algebra.rigid_motions import moment
from hypergap_dolfinx.coefficient import Coefficient, Friction, Value, friction_of
from hypergap_dolfinx.contact_geometry.opened import on_sigma, on_surface
from hypergap_dolfinx.contact_geometry.plane import PlaneSegments
from hypergap_dolfinx.contact_geometry.protocol import Segments
from hypergap_dolfinx.contact_geometry.space import SpaceSegments
from hypergap_dolfinx.contact_geometry.status import ContactStatus, table
from hypergap_dolfinx.contact_geometry.tolerances import COSINES, COSINES_SPACE
from hypergap_dolfinx.contact_solver.contact_rows import (
    ContactPair,
    ContactRows,
    rows_of,
)
from hypergap_dolfinx.contact_solver.friction_rows import FrictionRows
from hypergap_dolfinx.core.collective import raise_on_all, spot
from hypergap_dolfinx.core.forms import thickness
from hypergap_dolfinx.core.graph import parts_with
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.gap_mesh.strip import turns
from hypergap_dolfinx.interface_laws.given_values import Settable, as_moduli, as_numbers
from hypergap_dolfinx.mortar.fields import owned_values
from hypergap_dolfinx.mortar.free_edges import (
    ContactState,
    SurfacePressure,
    SurfaceShear,
    directions,
)
from hypergap_dolfinx.mortar.tolerances import MISSED_ROOT
from hypergap_dolfinx.surface.boundary import Places
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.moving import Displacements, MovingSurface, displaced
from hypergap_dolfinx.surface.nearest import nearest
from hypergap_dolfinx.surface.tolerances import FILE_DIGITS, KINK
from hypergap_dolfinx.surface.trace import (
    Surface,
    as_facets,
    check_sides,
    create_surface,
    facet_pairs,
    is_mixed,
    lengths,
)
from hypergap_dolfinx.surface.triangulation import edge_ends, kinks, neighbours
from hypergap_dolfinx.tolerances import ALIKE, BEHIND_BODY, CLOSED_NORMAL, FINER, STIFF, TILT

LOG = logging.getLogger("hypergap_dolfinx")


Side = tuple[fem.FunctionSpace, npt.ArrayLike]


class Contact(Settable):
    """Contact between two surfaces that can touch, part and slide, with or without friction.

    The gap domain Σ lies between Γ0 and Γ1 in their present positions. Each vertex a of Γ1 has a
    weighted gap g_a and a pressure p_a with p_a ≥ 0, g_a ≥ 0, p_a g_a = 0. The gap is a volume of
    Σ: in the plane that with the weight w_a = ∂ψ_a/∂α, in space that over the vertex's part of Γ1's
    facets, along their normals. The forces Σ_a p_a ∂g_a/∂u balance. In the plane bodies of degree 2
    have a gap and a pressure at each node of Γ1: its edges are halved, and nodes count as vertices.
    There edges with geometry of degree 2 are arcs of circles.

    With friction there are tractions q_a opposite to the slip s_a since the last load step:
    |q_a| ≤ μ p_a, and q_a = −μ p_a s_a / |s_a| where s_a isn't zero. Where vertices share their
    neighbours' gaps, p_a is the sum of the pressures that act on a's part of Γ1.

    Compliant surfaces (a coating, a gasket, asperities) overlap by c p_a: g_a = −c m_a p_a in
    contact, where m_a is the area of vertex a.

    Γ1 should be the side that slides with a corner or an edge, of two such sides the finer one,
    else the coarser one, or the softer one if one side is far softer: :meth:`between` chooses it.
    Bodies of degree 2 with round surfaces need curved cells.

    Example:
        A block on a wider one, a little above it:

        >>> from dolfinx.mesh import CellType, create_rectangle, locate_entities_boundary
        >>> from hypergap_dolfinx import Contact, ContactProblem
        >>> corners = [(0, -1), (4, 0)], [(1, 0.1), (3, 1.1)]
        >>> cells = CellType.quadrilateral
        >>> below, above = (
        ...     create_rectangle(MPI.COMM_SELF, c, (n, 3), cells)
        ...     for c, n in zip(corners, (8, 5))
        ... )
        >>> V0, V1 = (fem.functionspace(m, ("Lagrange", 1, (2,))) for m in (below, above))
        >>> def at(mesh, y):
        ...     return locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], y))
        >>> contact = Contact.between((V0, at(below, 0)), (V1, at(above, 0.1)))
        >>> contact.swapped  # the first is coarser
        True
    """

    def __init__(
        self,
        side0: Side,
        side1: Side,
        *,
        sliding: str = "finite",
        friction: Value | None = None,
        elastic_slip: float = 0.0,
        shear_limit: float = np.inf,
        compliance: Value | None = None,
        axisymmetric: revolution.Given = False,
    ):
        """Set up the two surfaces. Collective.

        Args:
            side0: Γ0: a pair ``(V, facets)`` of a Lagrange space of displacements and local indices
                of exterior facets of its mesh, as given by ``facet_tags.find(tag)``; in a mixed
                space (Taylor–Hood) ``(W.sub(0), facets)``.
            side1: Γ1, which carries the pressures: the same. Both sides may be one surface, with
                the same facets, which meets itself.
            sliding: ``"finite"``: Σ follows the bodies. ``"small"``: Σ and the derivatives of the
                gaps are those of the start, so that the constraints are linear.
            friction: Coulomb's coefficient μ ≥ 0: a number, a ``fem.Constant``, or a scalar
                Lagrange function on the mesh of Γ1, evaluated at its vertices. It may change
                between load steps. None: no friction.
            elastic_slip: Reversible slip, a length, at which friction reaches μ p. With 0 there is
                no slip below μ p.
            shear_limit: Upper bound τ of the friction traction, min(μ p, τ). With a large μ it
                approximates Tresca friction.
            compliance: Compliance c ≥ 0 of the surfaces, a length over a pressure: they overlap by
                c p. Given like ``friction``. For a thin layer of thickness t it is t / E or,
                without lateral expansion, t (1 + ν) (1 − 2ν) / (E (1 − ν)). None: no compliance.
            axisymmetric: True for bodies of revolution about the axis r = x[0] = 0 whose forms have
                the factor 2πr. Gaps are then volumes of revolution, pressures are forces per area,
                and the second component of :meth:`force` is the axial force on the whole
                circumference. ``"radian"`` if the forms have the factor r. Friction acts in the
                plane (r, z), not around the axis.

        Raises:
            ValueError: A side that isn't a pair of a space and facets; an unknown ``sliding``; a
                friction or compliance that is negative, not finite or on another mesh; an elastic
                slip or a shear limit without friction.
            InterfaceError: Facets or spaces that can't be in contact; the message says why.
        """
        if sliding not in ("finite", "small"):
            raise ValueError(f'sliding is "finite" or "small", not {sliding!r}.')
        if np.issubdtype(PETSc.ScalarType, np.complexfloating):
            raise ValueError("contact is an inequality: it needs a PETSc with real scalars.")
        check_sides("contact", side0, side1)
        self._components = Component.of(side0[0]), Component.of(side1[0])
        self._spaces = self._components[0].space, self._components[1].space
        side0, side1 = (
            (V, facets) for V, (_, facets) in zip(self._spaces, (side0, side1), strict=True)
        )
        self._facets = (as_facets(side0[1]), as_facets(side1[1]))
        self._sliding, self._swapped = sliding, False
        self._comm = comm = side0[0].mesh.comm
        if MPI.Comm.Compare(comm, side1[0].mesh.comm) not in (MPI.IDENT, MPI.CONGRUENT):
            raise InterfaceError(
                "the meshes of Γ0 and Γ1 live on different communicators; make both on one."
            )
        for i, V in enumerate(self._spaces):
            if V.value_shape != (V.mesh.geometry.dim,):
                advice = ": give its displacements, W.sub(0) for example"
                part = self._components[i]
                advice = advice if is_mixed(V) or part.dofs is not None else ""
                raise InterfaceError(
                    f"contact is between displacements; the space of Γ{i} has the value shape "
                    f"{V.value_shape} in {V.mesh.geometry.dim} dimensions{advice}."
                )
        if side0[0].mesh.geometry.dim != side1[0].mesh.geometry.dim:
            raise InterfaceError(
                f"the mesh of Γ0 has {side0[0].mesh.geometry.dim} coordinates, that of Γ1 "
                f"{side1[0].mesh.geometry.dim}; they must be equal."
            )
        self.axisymmetric = axisymmetric
        """Factor of the forms. True for 2πr, "radian" for r, False for plane bodies."""
        angle = revolution.angle_of(axisymmetric)
        below, above = (
            revolution.swept(create_surface(*side, name), angle)
            for side, name in ((side0, "Γ0"), (side1, "Γ1"))
        )
        self._split = below.gdim == 2 and below.element.degree == above.element.degree == 2
        self._surfaces = (below.arcs, above.arcs.split) if self._split else (below, above)
        itself = self._is_itself(side0, side1)
        thickness = min(
            _thickness(parts_with(V, facets), surface)
            for V, facets, surface in zip(self._spaces, self._facets, self._surfaces, strict=True)
        )
        self._friction = friction_of(friction, elastic_slip, shear_limit, *side1, self._split)
        self._compliance = (
            None
            if compliance is None
            else Coefficient(compliance, "compliance", "the compliance", *side1, self._split)
        )
        self._geometry = ContactGeometry(
            (below, above),
            (MovingSurface(self._surfaces[0]), MovingSurface(self._surfaces[1])),
            follows=sliding == "finite",
            itself=itself,
            depth=BEHIND_BODY * thickness,
            gives=self._compliance is not None,
        )
        self._places = tuple(Places(V.mesh, f) for V, f in zip(self._spaces, self._facets))
        for doubt in self._doubts(below, above):
            if comm.rank == 0:
                LOG.warning(doubt)
        self._made = True

    def _is_itself(self, side0: Side, side1: Side) -> bool:
        """True if both sides are one surface. Collective.

        Raises:
            InterfaceError: They share some facets.
        """
        together = side0[0].mesh is side1[0].mesh
        shared = together and bool(np.isin(side0[1], side1[1]).any())
        differ = not together or not np.array_equal(np.unique(side0[1]), np.unique(side1[1]))
        if not self._comm.allreduce(shared, MPI.LOR):
            return False
        why = None
        if self._comm.allreduce(differ, MPI.LOR):
            why = "Γ0 and Γ1 share facets; give each side its own, or all of them to both."
        raise_on_all(self._comm, why)
        return True

    @classmethod
    def between(
        cls, a: Side, b: Side, *, stiffness: tuple[float, float] | None = None, **options
    ) -> "Contact":
        """A contact that chooses its sides. Collective.

        Γ1 becomes the softer side if the other is at least a hundred times as stiff; otherwise the
        side with corners (in space edges that turn by 60° or more) that face the other, if both
        have corners the finer one; otherwise the coarser side; if facet sizes differ by less than a
        tenth, the softer one. :attr:`swapped` and the log of ``hypergap_dolfinx`` tell the outcome.

        Args:
            a: One side: a space and facets, as for the constructor.
            b: The other side.
            stiffness: Young's moduli of the bodies of a and b. Without them b is Γ1 if facet sizes
                are alike.
            options: Options of the constructor.

        Returns:
            The contact.

        Raises:
            ValueError: A side that isn't a pair of a space and facets; moduli that aren't positive.
            InterfaceError: As the constructor.
        """
        check_sides("contact", a, b)
        sides = [create_surface(Component.of(V).space, facets, "a side") for V, facets in (a, b)]
        ratio, contrast = _size(sides[0]) / _size(sides[1]), 1.0
        if stiffness is not None:
            moduli = as_moduli(stiffness)
            contrast = moduli[1] / moduli[0]
        corners = [_has_corners(*pair) for pair in (sides, sides[::-1])]
        if max(contrast, 1 / contrast) >= STIFF:
            swapped, why = contrast > 1, ", the far softer one"
        elif corners[0] != corners[1]:
            swapped, why = corners[0], ", the cornered one"
        elif max(ratio, 1 / ratio) > ALIKE:  # corners of Γ0 slide best over small facets
            swapped, why = ratio > 1, ", the coarser one"
            if all(corners):
                swapped, why = ratio < 1, ", the finer one of two with corners"
        else:
            swapped, why = contrast > 1, ", the softer one" if contrast != 1 else ""
        contact = cls(*((b, a) if swapped else (a, b)), **options)
        contact._swapped = swapped
        name = label((a if swapped else b)[0].mesh)
        chosen = f"the {'first' if swapped else 'second'} side{name}{why}"
        contact._geometry.chosen = chosen
        if a[0].mesh.comm.rank == 0:
            LOG.info("Γ1 is %s", chosen)
        return contact

    def _doubts(self, *surfaces: Surface):
        """Warnings about the surfaces of the meshes, one line each."""
        doubt = self._geometry.doubt_of_sizes
        if doubt and not self._geometry.is_wall:  # of a wall a problem knows if it is rigid
            yield doubt
        for surface in surfaces:
            if surface.folded.any():
                yield (
                    f"{surface.name}: {surface.folded.sum()} curved facets are folded, the first "
                    f"at {spot(surface.nodes[surface.folded.argmax()])}: their middle nodes are "
                    "too far off, and contact stops there; refine the mesh or straighten them."
                )
            if surface.element.degree > 1 and not surface.curved.any() and _is_round(surface):
                yield (
                    f"{surface.name} is round with straight facets, of degree "
                    f"{surface.element.degree}: pressures will scatter; use curved cells."
                )

    @property
    def components(self) -> tuple[Component, Component]:
        """Displacements of Γ0 and Γ1 among the dofs of their bodies."""
        return self._components

    @property
    def spaces(self) -> tuple[fem.FunctionSpace, fem.FunctionSpace]:
        """V₀ and V₁; for a component of a mixed space its collapsed space."""
        return self._spaces

    @property
    def facets(self) -> tuple[npt.NDArray, npt.NDArray]:
        """This rank's facets on Γ0 and on Γ1."""
        return self._facets

    def moved(self) -> float:
        """Largest distance of this rank's nodes on both sides from where they were when made."""
        return max(places.moved() for places in self._places)

    @property
    def surfaces(self) -> tuple[Surface, Surface]:
        """Γ0 and Γ1 in their initial positions, gathered on every rank."""
        return self._surfaces

    @property
    def geometry(self) -> "ContactGeometry":
        """Moving sides and Σ between them, for problems."""
        return self._geometry

    @property
    def sliding(self) -> str:
        """``"finite"`` or ``"small"``."""
        return self._sliding

    @property
    def friction(self) -> Friction | None:
        """Coulomb friction; None without friction."""
        return self._friction

    @property
    def compliance(self) -> Coefficient | None:
        """Compliance of the surfaces; None without compliance."""
        return self._compliance

    @property
    def swapped(self) -> bool:
        """True if :meth:`between` made its first side Γ1."""
        return self._swapped

    @property
    def rows(self) -> ContactRows | None:
        """Gaps and pressures of the problem solved last; ``problem.rows(contact)`` for a given one.

        None before the contact is in a problem.
        """
        return self._geometry.shown

    @property
    def active(self) -> npt.NDArray[np.bool_]:
        """Mask of Γ1's vertices in contact, ``(num_vertices,)``, in the order of ``surfaces[1].x``.

        It is the same on every rank and belongs to the problem solved last; for a given problem
        take ``problem.rows(contact).state.active``.

        Raises:
            ValueError: The contact is in no problem.
        """
        return self._shown.state.active.copy()

    @property
    def sticking(self) -> npt.NDArray[np.bool_]:
        """Mask of Γ1's vertices that stick, as :attr:`active`.

        Vertices that only share the gap of a neighbour in contact count, too: friction acts there.
        """
        return self._friction_rows(self._shown).stuck

    @property
    def slipping(self) -> npt.NDArray[np.bool_]:
        """Mask of Γ1's vertices that slip, as :attr:`sticking`."""
        rows = self._friction_rows(self._shown)
        return rows.rubs & ~rows.state.sticks

    @property
    def _shown(self) -> ContactRows:
        if self.rows is None:
            raise ValueError("the contact is in no problem: make one, and call solve() first.")
        return self.rows

    def pressures(self, problem) -> npt.NDArray[np.float64]:
        """Pressures at the vertices of Γ1, for plots and comparisons. Collective.

        They are averages of the multipliers over Σ's cells, with the same total force. In the plane
        with degree 2 they are the multipliers at Γ1's nodes.

        Args:
            problem: A solved problem with this contact.

        Returns:
            Pressures, ``(num_vertices,)``, in the order of ``surfaces[1].x``, the same on every
            rank.
        """
        rows = self._solved_rows(problem)
        if rows.state.opening is None:
            return np.zeros(len(rows.g))
        return self._opening(rows).smoothed(rows.at, rows.pressures)

    def pressure(self, problem, *, on: str = "sigma") -> fem.Function:
        """Contact pressure as a function. Collective.

        Args:
            problem: A solved problem with this contact.
            on: ``"sigma"``: constant on each cell of the displaced Σ.
                ``"body"``: :meth:`pressures` as a function on Γ1's body, 0 off Γ1, of degree 1 (of
                degree 2 in the plane between bodies of degree 2).
                ``"surface"``: on a mesh of the displaced Γ1 with finer cells near free edges of
                contact, where the pressure goes to zero as a square root, within facets.
                This is the most accurate one. Its force equals :meth:`force` to about 1e-3 with
                ``sliding="finite"`` (with ``"small"`` pressures are per initial area), in space
                with four vertices in contact to 8 %, with twelve to 1.4 %, of coarse bodies of
                revolution to .6 %. Where Γ0 ends within facets of Γ1 it ends there.

        Returns:
            Force per area of the displaced Γ1. Where bodies touch, cells of Σ have no volume; take
            :meth:`force` instead of an integral over Σ.

        Raises:
            ValueError: A contact that isn't one of the problem's, a problem that isn't solved, or
                an unknown ``on``.
            InterfaceError: No part of Γ1 lies opposite Γ0, so that there is no Σ; ``"body"`` is 0
                then.
        """
        rows = self._solved_rows(problem)
        if self._where(on, "surface") == "surface":
            found = SurfacePressure.of(self._state(problem, rows))
            return self._on_surface(rows, found, "pressure")
        if on == "body":
            return self._at_vertices(self.pressures(problem), "pressure")
        return self._on_sigma(rows, rows.pressures, "pressure")

    def shears(self, problem) -> npt.NDArray[np.float64]:
        """Friction tractions on Γ1's body at its vertices, averaged as :meth:`pressures`.

        Args:
            problem: A solved problem with this contact.

        Returns:
            Tractions, ``(num_vertices, n)``, in the order of ``surfaces[1].x``, the same on every
            rank.

        Raises:
            ValueError: A contact without friction.
        """
        rows = self._friction_rows(self._solved_rows(problem))
        if rows.state.opening is None:
            return np.zeros((len(rows.g), self.spaces[1].mesh.geometry.dim))
        opening = self._opening(rows)
        return np.stack([opening.smoothed(rows.at, part) for part in rows.shears.T], axis=1)

    def shear(self, problem, *, on: str = "sigma") -> fem.Function:
        """Friction traction on Γ1's body as a vector function. Collective.

        Args:
            problem: A solved problem with this contact.
            on: ``"sigma"``, ``"body"`` or ``"surface"`` as for :meth:`pressure`. On the surface,
                near free edges, it is proportional to the pressure. Edges between what sticks and
                what slips may lie within facets there, too: what friction could still give goes to
                zero as a square root (in the plane, without an elastic slip, and unless it misses
                the computed forces by 3.5 %, a root mean square).

        Returns:
            Force per area of the displaced Γ1.

        Raises:
            ValueError: As :meth:`pressure`; a contact without friction.
            InterfaceError: As :meth:`pressure`.
        """
        rows = self._friction_rows(self._solved_rows(problem))
        if self._where(on, "surface") == "surface":
            return self._on_surface(rows, self._surface_shear(problem, rows), "shear")
        if on == "body":
            return self._at_vertices(self.shears(problem), "shear")
        return self._on_sigma(rows, rows.shears, "shear")

    def slips(self, problem) -> npt.NDArray[np.float64]:
        """Slip of Γ1 on Γ0 in the last :meth:`ContactProblem.solve`, at Γ1's vertices.

        Args:
            problem: A solved problem with this contact.

        Returns:
            Slip, ``(num_vertices, n)``, the same on every rank; 0 where there is no contact.

        Raises:
            ValueError: A contact without friction.
        """
        return self._friction_rows(self._solved_rows(problem)).slipped.copy()

    def slip(self, problem) -> fem.Function:
        """:meth:`slips` as a function on Γ1's body, 0 off Γ1. Collective.

        Args:
            problem: A solved problem with this contact.
        """
        return self._at_vertices(self.slips(problem), "slip")

    def dissipation(self, problem) -> float:
        """Energy dissipated by friction in the last :meth:`ContactProblem.solve`; 0 without it.

        With an elastic slip it lacks what vertices that leave contact had stored in that.
        Slip is straight within a load step: one that turns a body by θ against the other has sin θ.

        Args:
            problem: A solved problem with this contact.
        """
        rows = self._solved_rows(problem)
        return rows.dissipated if isinstance(rows, FrictionRows) else 0.0

    def _solved_rows(self, problem) -> ContactRows:
        if not hasattr(problem, "rows"):
            raise ValueError(
                f"give the ContactProblem with this contact, not a {type(problem).__name__}."
            )
        return problem.rows(self)

    def _friction_rows(self, rows: ContactRows) -> FrictionRows:
        if not isinstance(rows, FrictionRows):
            raise ValueError("the contact has no friction: give it a coefficient.")
        return rows

    def gap(self, u0: fem.Function, u1: fem.Function, *, on: str = "sigma") -> fem.Function:
        """Gap between the bodies at given displacements, negative in an overlap. Collective.

        Args:
            u0: Displacement of one body, that of Γ0 if both sides are on one body; for a mixed
                space the function of the body with all components.
            u1: Displacement of the other body.
            on: ``"sigma"``: constant on each cell of Σ at these displacements. ``"body"``: g_a over
                the area m_a, as a function on Γ1's body; 0 where nothing lies opposite.

        Returns:
            The gap, a length.

        Raises:
            ValueError: A function that is on the space of no side, or an unknown ``on``.
            InterfaceError: No part of Γ1 lies opposite Γ0.
        """
        if not all(isinstance(u, fem.Function) for u in (u0, u1)):
            raise ValueError("gap(u0, u1) takes the displacements of both bodies, as functions.")
        if self._components[0].own_function(u0) is None:  # `between` may have swapped them
            u0, u1 = u1, u0
        own = [part.own_function(u) for part, u in zip(self._components, (u0, u1), strict=True)]
        if own[0] is None or own[1] is None:
            i = own.index(None)
            raise ValueError(f"u{i} is not on the space of Γ{i} (contact.spaces[{i}]).")
        on_body = self._where(on) == "body"
        rows = self._solved_at(u0, u1)
        if rows is None:
            rows = self._rows_at(own[0], own[1])
            rows.update_geometry()
        opening = self._opening(rows)
        if on_body:
            distance = np.divide(rows.g, rows.m, out=np.zeros_like(rows.g), where=rows.m > 0)
            return self._at_vertices(rows.spread(distance), "gap")
        columns, owner = opening.columns(rows.u), rows.sides[1].reference.owner
        return on_sigma(self._comm, columns, owner, columns.gap, "gap")

    def _rows_at(self, u0: fem.Function, u1: fem.Function) -> ContactRows:
        """Rows outside of a problem. Collective."""
        free = [np.zeros(owned_values(u).shape, dtype=bool) for u in (u0, u1)]
        parts = Component.of(u0.function_space), Component.of(u1.function_space)
        return ContactRows(ContactPair(self, (u0, u1), (0, 1), parts), free)

    def status(self) -> str:
        """Table to print before a solve: surfaces, facet sizes, gaps and overlaps. Collective.

        It is for undisplaced bodies. ``problem.status()`` is for present displacements and all
        contacts, and names bodies that nothing holds.
        """
        u0, u1 = (fem.Function(V) for V in self._spaces)
        return table([self._geometry.status(self._rows_at(u0, u1))])

    def _solved_at(self, u0: fem.Function, u1: fem.Function) -> ContactRows | None:
        """Rows of a solved problem if these are its displacements, else None. Collective."""
        found = (rows for rows in rows_of(self) if rows.fields == (u0, u1) and rows.state.opening)
        rows = next(found, None)
        # Only if the ranks find the same one: Python forgets problems on each at its own time
        numbers = set(self._comm.allgather(-1 if rows is None else rows.number))
        if rows is None or len(numbers) > 1:
            return None
        now = rows.displacements([u.x.array for u in (u0, u1)])
        return rows if all(map(np.array_equal, now, rows.u)) else None

    def _where(self, on: str, *more: str) -> str:
        if on not in ("sigma", "body", *more):
            if more:
                raise ValueError(f'on is "sigma", "body" or "surface", not {on!r}.')
            raise ValueError(f'on is "sigma" or "body", not {on!r}.')
        return on

    def _surface_shear(self, problem, rows: FrictionRows) -> SurfaceShear:
        """Traction of friction on Γ1's facets, with roots at edges between stick and slip."""
        state, slips = self._state(problem, rows), rows.spread(rows.slips.astype(float)) > 0
        if self.axisymmetric or self._surfaces[1].gdim > 2:  # where slips turn r isn't smooth
            slips[:] = False
        ways = directions(state.surface, rows.shears, slips)
        left, alone = rows.margins(ways), rows.is_alone
        sticks = rows.stuck & alone & left.any()
        exists = rows.spread((rows.rubs & alone).astype(float)) > 0
        none = np.zeros(len(rows.g))  # slips don't tell edges: they are those of the last step
        margin = self._state_of(rows, left, sticks, exists, none)
        p, r = SurfacePressure.of(state), SurfacePressure.of(margin, MISSED_ROOT)
        return SurfaceShear(p, self.shears(problem), ways, r)

    def _state(self, problem, rows: ContactRows) -> ContactState:
        """Pressures at vertices."""
        now, exists = rows.state, rows.spread(rows.valid.astype(float)) > 0
        gaps = rows.spread(rows.distance)
        state = self._state_of(rows, now.p * now.active, now.active, exists, gaps)
        hard = self._compliance is None
        return replace(state, compliance=problem.half_space_compliance(rows) if hard else 0.0)

    def _state_of(self, rows: ContactRows, p, active, exists, gaps) -> ContactState:
        """State at vertices; arguments: pressures of multipliers, and those that are active."""
        side, n = rows.sides[1], self._surfaces[1].gdim
        forces = np.zeros(sum(len(part.dofs) for part in rows.sides) * n)
        np.add.at(forces, rows.C.j, rows.C.values * p[rows.C.i])
        smoothed, opening = np.zeros(len(p)), rows.state.opening
        covered: npt.NDArray[np.bool_] | bool = True
        if opening is not None:
            smoothed = opening.smoothed(rows.at, opening.pressures(rows.at, rows.spread(p)))
            covered = opening.columns(rows.at).cover(self._surfaces[1])
        return ContactState(
            side,
            side.displaced(rows.at[1]),
            smoothed,
            rows.spread(active.astype(float)) > 0,
            exists,
            gaps,
            forces.reshape(-1, n)[len(rows.sides[0].dofs) :],
            covered=covered,
        )

    def _on_sigma(self, rows: ContactRows, values, name: str) -> fem.Function:
        """Pressures or tractions of vertices as a function on Σ."""
        columns = self._opening(rows).columns(rows.at)
        owner = rows.sides[1].reference.owner
        return on_sigma(self._comm, columns, owner, columns.of(values).mean(axis=1), name)

    def _on_surface(self, rows: ContactRows, found, name: str) -> fem.Function:
        """Pressure or shear as a function on cells of the displaced Γ1.

        Away from free edges those of facets that Γ0 covers in part are on that part.
        """
        surface = rows.sides[1].displaced(rows.u[1])
        n, on = surface.gdim, np.zeros(len(surface.facets), dtype=bool)
        parts, values = [], found.at_vertices
        if rows.state.opening is not None:
            columns = rows.state.opening.columns(rows.at)
            loaded = values.astype(bool).reshape(len(values), -1).any(axis=1)
            on = loaded[surface.facets].any(axis=1) & ~found.near & ~columns.cover(surface)
            columns = columns.on_some(on)
            parts.append((columns.facets, columns.X, columns.of(values)))
            facets, X = columns.left(surface, np.flatnonzero(on))
            parts.append((facets, X, np.zeros((len(facets), n, *values.shape[1:]))))
        for facets, corners in found.cells():
            facets, num = facets[~on[facets]], len(corners)
            drawn = found.on(facets, corners.reshape(-1, n - 1))
            X = np.tile(corners, (len(facets), 1, 1))
            drawn = drawn.reshape(-1, n, *values.shape[1:])
            parts.append((np.repeat(facets, num), X, drawn))
        facets, X, drawn = (np.concatenate(part) for part in zip(*parts, strict=True))
        return on_surface(self._comm, surface, facets, X, drawn, name)

    def _opening(self, rows: ContactRows) -> Segments:
        if rows.state.opening is None:
            raise InterfaceError("nothing of Γ1 lies opposite Γ0 where the bodies are.")
        return rows.state.opening

    def displaced(self, problem) -> tuple[Surface, Surface]:
        """Γ0 and Γ1 in their displaced positions, gathered on every rank.

        Args:
            problem: A solved problem with this contact.
        """
        return displaced(self._geometry.sides, self._solved_rows(problem).u)

    def force(
        self,
        problem,
        *,
        on: fem.Function | None = None,
        facets: npt.ArrayLike | None = None,
    ) -> npt.NDArray[np.float64]:
        """Force of pressure and friction on a body. Collective if facets are given.

        Args:
            problem: A solved problem with this contact.
            on: Displacement of the body, one of the problem's. By default the body of the second
                side as given to the constructor or to :meth:`between`, whichever became Γ1. The
                opposite force acts on the other body.
            facets: Some facets of that body, for the force at their nodes alone; those that aren't
                on the contact's surface don't count. Needed where both sides are one surface, on
                which all forces together cancel.

        Returns:
            Force, ``(n,)``, the same on every rank, in 2D per unit depth. For bodies of revolution
            the second component is the axial force on the whole circumference (or on a radian);
            the first is a sum of radial forces over all directions.

        Raises:
            ValueError: A contact that isn't one of the problem's, a problem that isn't solved, a
                function of neither body, or one of both sides; no facets, where they are needed.
        """
        rows = self._solved_rows(problem)
        forces = rows.contact_forces()
        return np.sum([forces[i][at].sum(axis=0) for i, at in self._acting(rows, on, facets)], 0)

    def moment(
        self,
        problem,
        about: npt.ArrayLike,
        *,
        on: fem.Function | None = None,
        facets: npt.ArrayLike | None = None,
        displaced: bool = True,
    ) -> npt.NDArray[np.float64]:
        """Moment of pressure and friction on a body about a point, Σ (x − x₀) × f. Collective.

        Positions are displaced ones; with small sliding, where Σ is that of the start, they are
        those of the start. The moments on both bodies about one point are opposite: to round-off,
        with friction up to the gaps within facets, in the plane only where Γ0 ends within these.
        With forms of small strains, loads and reactions on a body balance the moment at the
        mesh's positions, ``displaced=False``: such forms don't see that forces move. There the
        moments on both bodies differ, by the force times what they have moved against each other.

        Args:
            problem: A solved problem with this contact.
            about: The point x₀, ``(n,)``; any point of an axis for the torque about it.
            on: Displacement of the body, as in :meth:`force`.
            facets: Some facets, as there.
            displaced: False for positions of the mesh, whatever the forms (there is no default by
                the problem, as :meth:`Tie.moment` has).

        Returns:
            Moment, ``(3,)`` in space, ``(1,)`` in the plane, the same on every rank.

        Raises:
            ValueError: As :meth:`force`; bodies of revolution; a point of the wrong shape; another
                ``displaced``.
        """
        if displaced not in (False, True):
            raise ValueError(f"displaced is {displaced!r}: give True or False.")
        rows, n = self._solved_rows(problem), self._spaces[0].mesh.geometry.dim
        if self.axisymmetric:
            raise ValueError("a body of revolution has no moment; take force().")
        point = as_numbers(about, (n,), "about")
        forces, found = rows.contact_forces(), np.zeros(n * (n - 1) // 2)
        for i, at in self._acting(rows, on, facets):
            arms = rows.places[i] - point + (rows.at[i] if displaced else 0)
            found += moment(arms[at], forces[i][at])
        return found

    def _acting(
        self, rows: ContactRows, on: fem.Function | None, facets: npt.ArrayLike | None
    ) -> list[tuple[int, npt.NDArray[np.bool_]]]:
        """Sides of a body, and the dofs there whose forces count. Collective."""
        second = 0 if self._swapped else 1
        body = rows.fields[second] if on is None else on
        sides = [i for i, u in enumerate(rows.fields) if u is body]
        if not sides:
            raise ValueError(
                "force takes on=u, the displacement of one of its bodies, and so does moment."
            )
        if facets is None:
            if self.geometry.itself:
                raise ValueError(
                    "both sides of the contact are one surface, on which all forces cancel: give "
                    "facets=, those on which you want the force."
                )
            if on is not None and len(sides) == 2:
                raise ValueError(
                    "both sides are on this body: give facets= of one, or leave out on= for the "
                    "second side."
                )
            side = second if on is None else sides[0]
            return [(side, np.ones(len(rows.sides[side].dofs), dtype=bool))]
        part = np.sort(
            create_surface(self._spaces[sides[0]], facets, "the surface in facets=").dofs
        )
        found = []
        for i in sides:  # a facet beside the surface shares nodes with it, and has no force
            both = np.vstack((part, np.sort(rows.sides[i].reference.dofs)))
            _, at, times = np.unique(both, axis=0, return_inverse=True, return_counts=True)
            on_both = part[times[at.ravel()[: len(part)]] > 1]
            found.append((i, np.isin(rows.sides[i].dofs, on_both)))
        if not any(at.any() for _, at in found):
            raise ValueError("no facet in facets= is on the contact's surface; give some that are.")
        return found

    def _at_vertices(self, values: npt.NDArray[np.float64], name: str) -> fem.Function:
        """Values at Γ1's vertices as a function on its body."""
        mesh = self._spaces[1].mesh
        shape = values.shape[1:]
        degree = 2 if self._split else 1
        V = fem.functionspace(mesh, ("Lagrange", degree, shape) if shape else ("Lagrange", degree))
        f = fem.Function(V, name=name)
        surface = create_surface(V, self._facets[1], "Γ1")
        at = MovingSurface(surface.split if self._split else surface).vertex_dofs
        start, end = V.dofmap.index_map.local_range
        mine = (at >= start) & (at < end)
        f.x.array.reshape(-1, *shape)[at[mine] - start] = values[mine]
        f.x.scatter_forward()
        return f


@dataclass
class ContactGeometry:
    """Sides of a contact as problems with it take them: moving surfaces, and Σ between these."""

    surfaces: tuple[Surface, Surface]
    """Γ0 and Γ1 on the meshes, with whole edges."""
    sides: tuple[MovingSurface, MovingSurface]
    """Γ0 and Γ1 as moving surfaces."""
    follows: bool
    """True for finite sliding."""
    itself: bool
    """True if both sides are one surface, which can meet itself."""
    depth: float
    """Overlap beyond which a vertex of Γ1 counts as on the far side of Γ0's body, a length."""
    gives: bool
    """True if pressures act where surfaces overlap."""
    chosen: str = "as given"
    """How the sides were chosen, in words."""
    shown: ContactRows | None = None
    """Rows of the problem solved last."""

    @cached_property
    def finer(self) -> float:
        """Median facet size of Γ0 over that of Γ1."""
        below, above = map(_size, self.surfaces)
        return below / above

    @property
    def doubt_of_sizes(self) -> str | None:
        """Warning about a Γ1 that is finer than Γ0, or None."""
        if self.finer <= FINER * (1 + 1e-9):
            return None
        below, above = self.surfaces
        if _has_corners(above, below):
            return None
        return (
            f"Γ1 is {self.finer:.1f} times finer than Γ0: pressures are less exact than with the "
            "sides swapped; Contact.between swaps them unless Γ0 is far stiffer."
        )

    @cached_property
    def is_wall(self) -> bool:
        """True if Γ0 is flat. If its body is also rigid, facets of any size are exact."""
        wall = self.sides[0].reference
        off = np.abs(wall.normals - wall.normals[0]).max()
        return bool(off <= FILE_DIGITS and not wall.curved.any())

    def gaps(self, u: Displacements, held: Sequence[npt.NDArray[np.bool_]]) -> Segments:
        """Find the contact segments at given displacements. Collective.

        Args:
            u: Displacements at the dofs of both :attr:`sides`, ``(num_dofs_i, n)`` each, the same
                on every rank.
            held: Masks of prescribed displacements, of the same shapes.

        Raises:
            InterfaceError: No part of Γ1 lies opposite Γ0, or Σ can't be meshed.
        """
        options = {"gives": self.gives, "itself": self.itself}
        if self.surfaces[0].gdim == 3:
            return SpaceSegments.between(self.sides, u, **options)
        return PlaneSegments.between(self.sides, u, held, **options)

    def status(self, rows: ContactRows) -> ContactStatus:
        """Status of given rows of this contact, as arrays; updates their gaps. Collective."""
        return ContactStatus.of(rows, self.surfaces, self.chosen)


def _size(surface: Surface) -> float:
    """Median size of the facets."""
    return float(np.median(surface.size))


def _thickness(body: Mesh, surface: Surface) -> float:
    """Extent of a body along the mean normal of its surface, at most its thickness. Collective.

    For closed surfaces, without a mean normal, the smallest extent along the axes.
    """
    n = surface.gdim
    size = surface.size ** (n - 1)
    mean = (size[:, None] * surface.normals).sum(axis=0) / size.sum()
    along = mean[None] if np.linalg.norm(mean) > CLOSED_NORMAL else np.eye(n)
    along /= np.linalg.norm(along, axis=1)[:, None]
    x = body.geometry.x[:, :n] @ along.T
    ends = body.comm.allgather((x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)))
    low, high = (np.array(part) for part in zip(*ends, strict=True))
    return float(min((high.max(axis=0) - low.min(axis=0)).min(), thickness(body)))


def _has_corners(surface: Surface, other: Surface) -> bool:
    """True if a corner of a surface, in space an edge, faces another one on both of its sides.

    On Γ0 it slides between vertices of Γ1, whose gaps are means, and forces lean to either side.
    """
    x, n0, n1 = _corners(surface)
    if not len(x):
        return False
    order = np.lexsort(other.x.T)  # of equally near vertices the same one on any number of ranks
    points = [np.pad(a, ((0, 0), (0, 3 - surface.gdim))) for a in (x, other.x[order])]
    near = order[nearest(*points)]
    n = other.vertex_normals[near]
    least = (COSINES if surface.gdim == 2 else COSINES_SPACE)[0]
    facing = [np.einsum("ci,ci->c", n, own) < -least for own in (n0, n1)]
    half = np.arctan2(lengths(n0 - n1), lengths(n0 + n1))
    least_half = TILT if surface.gdim == 2 else KINK / 2  # coarse smooth surfaces turn by 50°
    return bool((facing[0] & facing[1] & (half > least_half)).any())


def _corners(surface: Surface) -> tuple[npt.NDArray[np.float64], ...]:
    """Places of convex corners, in space of middles of edges, and normals on either side.

    None of a side at whose edges more than two facets meet, which contact takes all the same.
    """
    if surface.gdim == 2:
        pairs = facet_pairs(surface)
        start, end = np.moveaxis(surface.facets[pairs], 2, 0)
        vertex = np.where(end[:, 0] == start[:, 1], end[:, 0], start[:, 0])
        on = turns(surface)[1][vertex]
        x, (f, g) = surface.x[vertex[on]], pairs[on].T
    else:
        try:
            behind = neighbours(surface.polygons, surface.name, surface.x)
        except InterfaceError:
            behind = np.full(surface.facets.shape, -1)
        f, k = kinks(surface, behind)
        g, x = behind[f, k], surface.x[np.stack(edge_ends(surface, f, k))].mean(axis=0)
    middle = surface.x[surface.facets].mean(axis=1)
    convex = np.einsum("ci,ci->c", middle[g] - middle[f], surface.normals[f]) < 0
    return x[convex], surface.normals[f[convex]], surface.normals[g[convex]]


def _is_round(surface: Surface) -> bool:
    """True if normals of straight facets turn by small angles, as on a curved surface."""
    if surface.gdim == 2:
        turn, corner = turns(surface)
        return bool(((turn > 0) & ~corner).any())
    n0, n1 = surface.normals[facet_pairs(surface).T]
    turn = np.linalg.norm(n0 - n1, axis=1)
    return bool(((turn > FILE_DIGITS) & (turn < KINK)).any())
