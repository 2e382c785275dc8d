# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A contact in a problem: Σ, gaps, pressures and the active set as arrays; its linear equations.

A contact's state belongs to its :class:`ContactRows`: all that changes it is a method there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from weakref import WeakKeyDictionary, ref

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.algebra.pattern import Pattern, coupled
from hypergap_dolfinx.algebra.tolerances import NOTHING
from hypergap_dolfinx.contact_geometry.protocol import Segments
from hypergap_dolfinx.contact_solver.shared_ends import EndingSide, condensations
from hypergap_dolfinx.contact_solver.tolerances import (
    CLOSED_GAP,
    EXACT,
    EXCEEDS,
    HOLDS,
    ROUND_OFF_FORCES,
)
from hypergap_dolfinx.core.collective import look_up
from hypergap_dolfinx.errors import InterfaceError, NotFacingError
from hypergap_dolfinx.interface_laws.rigid_body import RigidBodyMotion, RigidSides
from hypergap_dolfinx.multipliers.interface import ContactInterface, Interface
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.moving import (
    Displacements,
    MovingSurface,
    Sparse,
    joined,
    went_through,
)
from hypergap_dolfinx.surface.trace import lengths, normals_by_area


@dataclass(frozen=True)
class ContactPair:
    """A contact with the displacements of the two bodies of a problem."""

    contact: ContactInterface
    u: tuple[fem.Function, fem.Function]
    bodies: tuple[int | None, int | None]
    """Numbers of the bodies; None for a rigid one."""
    components: tuple[Component, Component]
    """The sides' displacements among the fields of u."""
    rigid: tuple[RigidBodyMotion | None, RigidBodyMotion | None] = (None, None)
    """Rigid bodies that forces move."""


@dataclass
class NormalState:
    """Normal state of a contact: Σ, pressures and the active set.

    Changes replace its arrays, none is written to: copies share them.
    """

    opening: Segments | None
    p: npt.NDArray[np.float64]
    """Pressures, ``(num_multipliers,)``."""
    active: npt.NDArray[np.bool_]
    """Mask of the active set, ``(num_multipliers,)``."""

    def copy(self):
        """A copy that changes don't reach."""
        return type(self)(**vars(self))  # ``copy.copy`` takes several times as long

    @property
    def arrays(self) -> dict[str, npt.NDArray]:
        """All arrays by name, ``(..., num_multipliers)`` each."""
        return {k: v for k, v in vars(self).items() if isinstance(v, np.ndarray)}


@dataclass(frozen=True)
class Linear:
    """Linearised equations of a contact; unknowns are both sides' dofs, then the multipliers."""

    matrix: Sparse
    """Additions to the bodies' matrix: forces, rows of gaps, and p = 0 of inactive multipliers."""
    right: npt.NDArray[np.float64]
    """``(num_multipliers,)``."""
    start: npt.NDArray[np.float64]
    """Unknowns that stand for the present multipliers."""
    springs: Sparse
    """Rows whose squares are the stiffness of tractions that aren't constraints, nearly."""


_ROWS: "WeakKeyDictionary[ContactInterface, dict[int, ref[ContactRows]]]" = WeakKeyDictionary()


def rows_of(contact: ContactInterface) -> "list[ContactRows]":
    """A contact's rows in the problems that exist, those of the problem solved last first.

    Python forgets problems on each rank at its own time: compare :attr:`ContactRows.number`.
    """
    found = [reference() for reference in reversed(_ROWS.get(contact, {}).values())]
    return [rows for rows in found if rows is not None]


class ContactRows:
    """Contact between two bodies; arrays are the same on every rank, matrices distributed."""

    def __init__(self, pair: ContactPair, held: Sequence[npt.NDArray[np.bool_]]):
        """Locate the surfaces in the bodies. Collective.

        Args:
            pair: The contact and its bodies.
            held: Mask of each body's prescribed owned dofs.
        """
        self._contact, self.fields, self.bodies = pair.contact, pair.u, pair.bodies
        self.sides, self.spaces = self._contact.geometry.sides, self._contact.spaces
        self.components = pair.components
        self._comm, self._follows = self.spaces[0].mesh.comm, self._contact.geometry.follows
        self.number = -1
        """Number among the contact's rows of all problems, the same on every rank."""
        self.start: Displacements | None = None
        """Displacements at the start of the load step; None before the first geometry."""
        self._checked = False  # that the bodies don't start behind each other
        self.overlap = 0.0
        """Largest overlap before the first load step."""
        self._diagonal = 0.0  # of p = 0, the same in all steps: factors are kept while K is
        surface = self.sides[1].reference
        self._n, num = surface.gdim, len(surface.x)
        self._per_vertex = 1
        """Number of a multiplier's unknowns."""
        self._size = float(surface.size.max())
        """Size of the largest facet."""
        self.state = NormalState(None, np.zeros(num), np.zeros(num, dtype=bool))
        self._rigid = self._rigid_sides(pair)
        each = zip(self.components, self.sides, self.bodies, pair.rigid, strict=True)
        self._held = [self._held_at(held, *of_side) for of_side in each]
        self._moves = ~np.concatenate([part.ravel() for part in self._held])
        own = [rigid is None for rigid in pair.rigid]  # dofs that are unknowns themselves
        self._is_free = self._moves & np.repeat(own, [part.size for part in self._held])
        self._compliance = np.zeros(num)
        self._bends: Sparse | None = None  # derivative of a step's forces at its multipliers
        self._guess: npt.NDArray[np.float64] | None = None  # gaps where laws are linearised
        self._beside = Sparse.empty()  # derivatives of laws by other vertices' multipliers
        corners = surface.facets.shape[1]
        x = surface.x[surface.facets]
        areas = lengths(normals_by_area(x)) / (corners * (self._n - 1))
        arcs = surface.arc(0.75 * x + 0.25 * x[:, ::-1])  # in the middle of halves
        areas = (areas[:, None] * arcs).ravel()
        self._area = np.bincount(surface.facets.ravel(), areas, num)
        self._rank = np.searchsorted(surface.dof_range[1:], self.sides[1].vertex_dofs, side="right")
        now = self.displacements([f.x.array for f in self.fields])
        self._first = self.u = _unless_same(now, now)
        self.condensed_to = np.arange(num)
        """Vertex that carries each vertex's pressure, -1 for none, ``(num_multipliers,)``."""

    def _rigid_sides(self, pair: ContactPair) -> RigidSides | None:
        """The sides on rigid bodies that forces move; None without any. Collective."""
        if not any(pair.rigid):
            return None
        points = [body.point if body else 0.0 for body in pair.rigid]
        arms = [x - point for x, point in zip(self.places, points, strict=True)]
        return RigidSides(pair.rigid, arms)

    @cached_property
    def places(self) -> list[npt.NDArray[np.float64]]:
        """Initial positions of both sides' dofs, ``(num_dofs_i, n)`` each. Collective."""
        found = []
        for side, V in zip(self.sides, self.spaces, strict=True):
            at = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local, : self._n]
            start = V.dofmap.index_map.local_range[0]
            found.append(look_up(self._comm, np.ascontiguousarray(at), start, side.dofs))
        return found

    @property
    def has_friction(self) -> bool:
        """True if there is friction somewhere at present. Collective."""
        return False

    @property
    def has_compliance(self) -> bool:
        """True if gaps of closed contact grow with pressures."""
        return self._contact.compliance is not None

    def _held_at(self, held, part: Component, side: MovingSurface, body, rigid):
        """Mask of a side's prescribed displacements, ``(num_dofs, n)``. Collective."""
        if body is None:
            return np.ones((len(side.dofs), self._n), dtype=bool)
        if rigid:
            return np.tile(rigid.held_axes, (len(side.dofs), 1))
        mask = part.of_body(held[body]).reshape(-1, self._n).astype(np.int8)
        start = part.space.dofmap.index_map.local_range[0]
        return look_up(self._comm, mask, start, side.dofs).astype(bool)

    @property
    def meets_itself(self) -> bool:
        """True if both sides are one surface."""
        return self._contact.geometry.itself

    @property
    def on_rigid_body(self) -> bool:
        """True if a side is on a rigid body that forces move."""
        return self._rigid is not None

    @property
    def springs(self) -> float:
        """Mean stiffness of a compliance at vertices; 0 without one. Collective."""
        if self._contact.compliance is None:
            return 0.0
        c = self._contact.compliance.at_vertices()
        return float((self._area[c > 0] / c[c > 0]).mean()) if c.any() else 0.0

    def displacements(self, u: Sequence[npt.NDArray[np.float64] | None], more=()) -> Displacements:
        """Displacements at both sides' dofs. Collective.

        Args:
            u: This rank's values of Γ0's and Γ1's body, the owned ones first; None for zero.
            more: Shape of further axes, of values and of what is found.
        """
        u0, u1 = (np.zeros((len(side.dofs), self._n, *more)) for side in self.sides)
        for values, part, (mine, dofs) in zip((u0, u1), u, self._owned_dofs, strict=True):
            if part is not None:
                values[mine] = part[dofs].reshape(-1, self._n, *more)
                self._comm.Allreduce(MPI.IN_PLACE, values)
        return u0, u1

    def from_bodies(self, values: Sequence[npt.NDArray[np.float64]]) -> Displacements:
        """Values of each body at both sides' dofs, 0 on an obstacle. Collective."""
        moves = self._rigid.moves if self._rigid else (False, False)
        of_bodies = [
            None if b is None or on else values[b] for b, on in zip(self.bodies, moves, strict=True)
        ]
        found = self.displacements(of_bodies, values[0].shape[1:])
        for side, body in enumerate(self.bodies):
            if moves[side] and self._rigid and body is not None:
                found[side][:] = self._rigid.moved(side, values[body])
        return found

    # Changes of the state

    def start_solve(self):
        """Start a solve: :func:`rows_of` names these rows first, the contact shows their state."""
        known = _ROWS.setdefault(self._contact, {})
        if self.number < 0:
            self.number = len(known)
        known.pop(self.number, None)
        known[self.number] = ref(self)
        self._contact.geometry.shown = self

    def start_step(self):
        """Start a load step: read values that the user may have changed. Collective."""
        if self._contact.compliance is not None:
            self._compliance = self._contact.compliance.at_vertices()

    def update_geometry(self):
        """Compute the gaps at the present displacements. Collective.

        Raises:
            InterfaceError: There is no Σ, though the sides face each other.
        """
        self.u = _unless_same(self.u, self.displacements([f.x.array for f in self.fields]))
        if self.start is None:
            self.start = self.before()
        g, m, C = self._find()
        self.g, self.m = self._of_carriers(g), self._of_carriers(m)
        self.C = self._condensed(C)
        self._refuse_behind()
        every, free = (
            np.bincount(self.C.i, weights * self.C.values**2, len(g))
            for weights in (1.0, self._moves[self.C.j])
        )
        self.valid = (self.m > 0) & (free > HOLDS**2 * every)
        self._apart = self._over_areas(self.g, np.inf)
        self._lengths, self._acting = self.g, self.C

    def activate(self, active: npt.NDArray[np.bool_]):
        """Set the active set, ``(num_multipliers,)``."""
        self.state.active = active

    def commit(self):
        """Accept the state: the next load step starts from it."""
        self.start = self.u
        for side, u in zip(self.sides, self.u, strict=True) if self._follows else ():
            side.keep(u)

    def restore(self, state: NormalState):
        """Go back to a state that was copied before, where laws are linearised at it."""
        self.state, self._guess = state.copy(), None

    @property
    def kept(self) -> dict[str, npt.NDArray]:
        """Arrays on which the next load step depends, by name; the same on every rank.

        It also depends on ``start``, whose order differs with the number of ranks.
        """
        return {**self.state.arrays, "diagonal": np.array(self._diagonal)}

    def resume(self, kept: dict[str, npt.NDArray], start: Displacements | None):
        """Go on from arrays that were kept, in this process or in another one. Collective.

        Args:
            kept: The arrays.
            start: Displacements at both sides' dofs; None before the first load step.
        """
        self.start_solve()
        for name, array in kept.items():
            if name in self.state.arrays:
                setattr(self.state, name, array.copy())
        self.state.opening, self._diagonal = None, float(kept["diagonal"])
        self.start, self._checked = start, start is not None
        self.start_step()
        if start is not None:
            self.update_geometry()

    def forget(self):
        """Set all pressures to zero."""
        self.state.p = np.zeros_like(self.g)

    # The linearised contact problem: gaps over areas times √stiffness, multipliers in these units

    @property
    def num_unknowns(self) -> int:
        """Number of multipliers' unknowns."""
        return self._per_vertex * len(self._rank)

    @property
    def num_lengths(self) -> int:
        """Number of gaps, and with friction of slips and of the normal forces that bound it."""
        return self.num_unknowns

    @property
    def is_in(self) -> npt.NDArray[np.bool_]:
        """Mask of the unknowns in the working set, ``(num_unknowns,)``."""
        return self._of_all(self.state.active)

    def _of_all(self, mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """A mask of multipliers for all unknowns of each; ``np.tile`` takes ten times as long."""
        return np.concatenate([mask] * self._per_vertex)

    def new_gaps(self, changes: Sequence[npt.NDArray]) -> npt.NDArray[np.float64]:
        """Gaps after a step, without those of a compliance. Collective.

        Args:
            changes: What is subtracted from this rank's displacements of each body.
        """
        return self._scaled(self._lengths - self._product(self.from_bodies(changes))).ravel()

    @property
    def overlaps(self) -> bool:
        """True if a gap outside of the active set is negative."""
        return bool((self.g < 0)[self.valid & ~self.state.active].any())

    def before(self) -> Displacements:
        """Both sides' displacements as a load step starts, before users moved. Collective."""
        last = self._first if self.start is None else self.start
        now = _unless_same(last, self.displacements([f.x.array for f in self.fields]))
        pairs = zip(self.bodies, last, now, strict=True)
        before, after = (a if body is None else b for body, a, b in pairs)
        return before, after

    def passed(self, since: Displacements) -> list[npt.NDArray[np.float64]]:
        """Places of vertices that went through a wall of the other side, and of corners that did.

        ``(num, n)`` each.

        Args:
            since: Displacements from which they went straight to where they are.
        """
        if not self._follows:
            return [np.empty((0, self._n))] * 2
        ways = [
            (side.displaced(a), side.displaced(b))
            for side, a, b in zip(self.sides, since, self.u, strict=True)
        ]
        ways = ways[: 1 if self.meets_itself else 2]
        found = [
            [side[1].x[at] for at in of]
            for side, of in zip(ways, went_through(ways, self.closed), strict=True)
        ]
        return [np.concatenate(part) for part in zip(*found, strict=True)]

    @property
    def _slopes(self) -> Sparse:
        """Derivatives of weighted gaps and slips by displacements."""
        return self.C

    def _product(self, values: Displacements) -> npt.NDArray[np.float64]:
        """The derivatives times values at both sides' dofs, ``(num_lengths,)``."""
        return self._slopes.times(values, self.num_lengths)

    def _found_areas(self) -> npt.NDArray[np.float64]:
        """Areas of rows, 0 without one, ``(num_lengths / num_multipliers, num_multipliers)``."""
        return np.where(self.valid, self.m, 0)[None]

    def _over_areas(self, values: npt.NDArray, none=0.0) -> npt.NDArray[np.float64]:
        """Values of multipliers, the last axis, over areas; ``none`` without a multiplier."""
        result = np.full(values.shape, none)
        return np.divide(values, self.m, out=result, where=self.valid)

    def _scaled(self, values: npt.NDArray) -> npt.NDArray[np.float64]:
        """Weighted lengths as lengths times √stiffness, of the shape of the areas."""
        areas = self._areas
        values = values.reshape(areas.shape)
        return self._root * np.divide(values, areas, out=0 * values, where=areas > 0)

    def least(self) -> npt.NDArray[np.float64]:
        """Sizes treated as zero, of multipliers in the working set or of gaps outside."""
        return np.where(self.state.active, *self._least)

    def wrong(self, y, f, *, exactly: bool = True) -> npt.NDArray[np.bool_]:
        """Mask of multipliers whose laws don't hold, ``(num_unknowns,)``.

        Args:
            y: Gaps, ``(num_unknowns,)``.
            f: Multipliers, ``(num_unknowns,)``.
            exactly: False if laws, linearised in the working set, needn't hold where the state is
                the same as in that.
        """
        return self.valid & (np.where(self.state.active, f, y) < -self.least())

    def pulled(self, f) -> npt.NDArray[np.bool_]:
        """Mask of closed multipliers where neighbours pull more than they press.

        A surface that is held too far outside pulls in a wide ring. But pressures at nodes change
        signs there, so that from one solution to the next only its outermost nodes open. If no
        pressure is negative, nothing is in the mask.

        Args:
            f: Multipliers, ``(num_unknowns,)``, as the mask.
        """
        if self.has_friction:
            return np.zeros(self.num_unknowns, dtype=bool)
        num, size = len(f), len(self._is_free)
        near = replace(self._slopes, values=np.abs(self._slopes.values))
        p = np.where(self.state.active, f * self._per_unit[0], 0)
        for _ in range(2):  # averages over neighbours of neighbours
            p, every = (near.times((near.T.times((of,), size),), num) for of in (p, np.ones(num)))
            p = np.divide(p, every, out=0 * p, where=every > 0)
        return self.valid & self.state.active & (p < 0)

    def law(self, y, f, at, states=None):
        """Residual of the laws of contact and friction, zero where they hold.

        Args:
            y: Gaps, slips and normal forces, ``(n + 1, num)``, or gaps alone, ``(1, num)``.
            f: Pressures and tractions, ``(n, num)``, or pressures alone.
            at: Numbers of the multipliers, ``(num,)``.
            states: States of the multipliers, first the mask of closed ones, ``(num,)``; by default
                those that y and f have.

        Returns:
            The errors, ``(n, num)``; their derivatives by y and f, with as many columns as these
            have rows; and the sizes treated as zero, ``(n, num)``.
        """
        closed = f[0] > y[0] if states is None else states[0]
        force, length = self._least
        return (
            np.where(closed, y[0], f[0])[None],
            closed[None, None].astype(float),
            (~closed)[None, None].astype(float),
            np.where(closed, length, force[at])[None],
        )

    def watched_gaps(self) -> Sparse:
        """Gaps in terms of the unknowns of the equations."""
        return self._watched(self._slopes)

    def _watched(self, matrix: Sparse) -> Sparse:
        """Rows over areas times √stiffness, of what isn't prescribed."""
        areas = self._areas.ravel()
        use = areas[matrix.i] > 0
        found = matrix.some(use & self._is_free[matrix.j])
        if self._rigid:
            found = joined(found, matrix.some(use) @ self._by_rigid)
        return replace(found, values=self._root * found.values / areas[found.i])

    def watched_forces(self) -> Sparse:
        """Multipliers of the working set in terms of the unknowns of the equations."""
        on = np.flatnonzero(self.is_in)
        return Sparse(on, len(self._is_free) + on, np.full(len(on), self._root))

    def loads(self) -> Sparse:
        """Right-hand sides of new unknowns: forces, or slack in rows of the working set."""
        rows, beside, on = self._watched(self._acting), self._beside, self.is_in
        place = len(self._is_free) + beside.i
        rows = joined(rows, Sparse(beside.j, place, -self._root * beside.values))
        return joined(rows.some(~on[rows.i]), self.watched_forces())

    def _pressed_by(self, by_y) -> Sparse:
        """Derivatives of the working set's laws of friction by pressures of multipliers.

        Args:
            by_y: As of :meth:`law`.
        """
        return Sparse.empty()

    def given(self, f: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """What multipliers add to gaps, ``(num_lengths, ...)`` from ``(num_unknowns, ...)``."""
        return (self._give * f.T).T

    def accept(self, y, f, changed):
        """Take the multipliers and sets of a solution; arguments as :meth:`law`, flat."""
        now = self.state
        now.active = self.valid & np.where(changed, f > y, now.active)
        now.p = np.where(now.active, f, 0) * self._per_unit[0]

    def guess(self, y, f, changed):
        """Take a solution as a guess: laws are linearised there; arguments as :meth:`accept`."""
        self.accept(y, f, changed)
        self._guess = y.reshape(self._areas.shape)

    @property
    def _now(self) -> npt.NDArray[np.float64]:
        """Gaps, slips and normal forces as they are, in the units of :meth:`law`."""
        lengths = self._scaled(self._lengths)
        return lengths + self.given(self._forces.ravel()).reshape(lengths.shape)

    def slide(self) -> bool:
        """Make all multipliers of the working set slip; false without friction."""
        return False

    def start_set(self, stiffness: float, zero: float, *, touches: bool = True):
        """Choose the working set: the last active multipliers, and those that touch or overlap.

        Args:
            stiffness: Stiffness of the bodies' nodes, which makes forces of lengths.
            zero: Pressure treated as zero.
            touches: False to start again, with the last active multipliers alone.
        """
        self._stiffness, self._root, self._zero = stiffness, float(np.sqrt(stiffness)), zero
        self._diagonal, self._bends, self._guess = self._diagonal or stiffness, None, None
        force = np.maximum(zero * self.m / stiffness, ROUND_OFF_FORCES * self._size)
        self._least = self._root * force, self._root * EXACT * self._size  # multipliers and gaps
        self._areas = self._found_areas()
        own = self._areas[: self._per_vertex]
        self._per_unit = np.divide(self._root, own, out=0 * own, where=own > 0)  # of multipliers
        self._give = self._over_areas(stiffness * self._compliance)  # gaps by a unit of pressures
        now = self.state
        if touches:
            self._last = now.active
            now.active = now.active | (self.distance <= EXACT * self._size)
        else:
            now.active = self._last
        now.active = self.valid & now.active
        now.p = np.where(now.active, now.p, 0)

    @property
    def pressures(self) -> npt.NDArray[np.float64]:
        """Pressures of vertices, ``(num_vertices,)``."""
        p = self.spread(self.state.p * self.state.active)
        return p if self.state.opening is None else self.state.opening.pressures(self.at, p)

    # Geometry

    def _find(self) -> tuple[npt.NDArray, npt.NDArray, Sparse]:
        """Gaps, areas and derivatives of vertices; all zero if the sides stop facing each other."""
        state, at = self.state, self.at
        try:  # the same on all ranks
            if state.opening is None:
                state.opening = self._contact.geometry.gaps(at, self._held)
            if self._follows:
                return state.opening.gap(at)
            g, m, C = state.opening.linear_gap(at)
            return g + C.times(self.u, len(g)), m, C
        except InterfaceError as error:
            expected = isinstance(error, NotFacingError) or self._checked
            if not (self._follows and expected):
                raise
        state.opening, none = None, np.zeros(len(self._area))
        return none, none, Sparse.empty()

    def _of_carriers(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Sums of vertices' values with the same condensation."""
        if self._carries_own:
            return values
        has = self.condensed_to >= 0
        return np.bincount(self.condensed_to[has], values[has], len(values)).astype(float)

    def _condensed(self, matrix: Sparse) -> Sparse:
        """A matrix with the same condensation, of one component or several."""
        if self._carries_own:
            return matrix
        component, a = np.divmod(matrix.i, len(self.condensed_to))
        a = self.condensed_to[a]
        return replace(matrix, i=component * len(self.condensed_to) + a).some(a >= 0)

    @cached_property
    def _carries_own(self) -> bool:
        """True if each vertex carries its own pressure."""
        return bool((self.condensed_to == np.arange(len(self.condensed_to))).all())

    def spread(self, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Pressures of all vertices from those of multipliers, ``(num_multipliers,)`` each."""
        return np.where(self.condensed_to >= 0, p[self.condensed_to], 0)

    @property
    def at(self) -> Displacements:
        """Displacements at which Σ is made."""
        u0, u1 = self.u
        return (u0, u1) if self._follows else (np.zeros_like(u0), np.zeros_like(u1))

    def _refuse_behind(self):
        """Refuse bodies that start behind each other.

        Raises:
            InterfaceError: All of Γ1 that sees Γ0 does so from behind.
        """
        if self._checked:
            return
        self._checked, opposite = True, self.m > 0
        height = self.g[opposite] / self.m[opposite]
        if opposite.any() and (height < -self._contact.geometry.depth).all():
            raise InterfaceError(
                f"Γ1 is {-height.max():.3g} and more behind Γ0: the bodies are on the wrong sides "
                "of each other, or facets are on the far side of one; check positions and tags."
            )
        self.overlap = float(-height.min(initial=0))

    def reaches(self, least: float) -> list[tuple[float, int]]:
        """Largest distance over which a pressure acts, and largest overlap; and Γ1's vertex there.

        A gap is a mean over the facets around a vertex. There a corner may touch or overlap while
        the rest is far away. Third, the mean by force of gaps up to edges that lean; fourth, that
        of angles by which forces lean.

        Args:
            least: Length below which neither is searched for. Overlaps are in facet sizes of the
                finer side, all else is in those of Γ1.
        """
        if self.state.opening is None or not self._follows:
            return []
        (size, finer), facets = self._facet_sizes(), self.sides[1].reference.facets
        p = self.spread(np.where(self.state.active, self.state.p, 0)).clip(min=0)
        far, deep, leaning = self.state.opening.reaches(self.u, least * finer, p)
        if self.has_compliance:  # surfaces are to overlap, up to the neighbouring vertices
            given = self.spread(self._compliance * np.where(self.state.active, self.state.p, 0))
            around = given.copy()
            np.maximum.at(around, facets, given[facets].max(axis=1)[:, None])
            far, deep = (np.maximum(part - around, 0) for part in (far, deep))
        found = [
            np.divide(part, of, out=np.zeros_like(part), where=of > 0)
            for part, of in ((np.where(p > 0, far, 0), size), (deep, finer))
        ]
        told = [(float(part.max(initial=0)), int(part.argmax())) for part in found]
        pressed = float((p * self.m * size).sum())
        mean = float((p * leaning).sum()) / pressed if pressed else 0.0
        return [*told, (mean, int((p * leaning).argmax())), self._lean()]

    def slid(self) -> tuple[float, int]:
        """Largest slide since the meshes under a pressure, over facets of the finer side; a vertex.

        0 with finite sliding: Σ follows, and places that press on each other face each other.
        """
        on = self.state.active & (self.state.p > 0)
        if self.state.opening is None or self._follows or not on.any():
            return 0.0, 0
        num = len(self.g)
        s = self._slips().times(self.u, (self._n - 1) * num).reshape(-1, num)
        slide = np.where(on, self._over_areas(lengths(s.T), 0.0) / self._facet_sizes()[1], 0)
        return float(slide.max()), int(slide.argmax())

    def _slips(self) -> Sparse:
        """T with the weighted slips s = T Δu, of multipliers."""
        assert self.state.opening is not None
        return self._condensed(self.state.opening.slip(self.at, self.condensed_to))

    def _facet_sizes(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Sizes of the largest facets of Γ1 around vertices, and of the finer side's."""
        size = self.sides[1].reference.vertex_sizes
        return size, np.minimum(size, self.sides[0].reference.size.max(initial=0))

    def _lean(self) -> tuple[float, int]:
        """Mean by force of degrees between Γ1's normals and frictionless forces; a vertex.

        A corner of Γ0 that slides between vertices of Γ1 comes nearer to one, which holds it back.
        Forces may have any direction between the normals of the facets around a vertex, and at
        Γ1's ends.
        """
        p = np.where(self.state.active, self.state.p, 0).clip(min=0)
        if not p.any():
            return 0.0, 0
        on = (self.C.j >= len(self.sides[0].dofs) * self._n) & (p[self.C.i] > 0)
        i, j = self.C.i[on], self.C.j[on] % self._n
        forces = -np.bincount(i * self._n + j, self.C.values[on] * p[i], len(p) * self._n)
        forces = forces.reshape(-1, self._n)
        surface = self.sides[1].displaced(self.at[1])
        rows = self.condensed_to[surface.facets]
        facet, k = np.nonzero((rows >= 0) & (p[rows] > 0))
        rows, normals = rows[facet, k], surface.normals[facet]
        axes, widest = np.zeros_like(forces), np.ones(len(p))
        np.add.at(axes, rows, normals)
        axes /= np.maximum(lengths(axes), np.finfo(float).tiny)[:, None]
        cosines = np.einsum("fi,fi->f", normals, axes[rows])
        ends = self.sides[1].reference.at_end[surface.facets[facet, k]]
        np.minimum.at(widest, rows, np.where(ends, -1, cosines))
        size, along = lengths(forces), np.einsum("ai,ai->a", forces, axes)
        cosines = np.divide(along, size, out=np.ones_like(size), where=size > 0)
        lean = np.maximum(np.arccos(cosines.clip(-1, 1)) - np.arccos(widest.clip(-1, 1)), 0) * size
        mean = lean.sum() / max(size.sum(), np.finfo(float).tiny)
        return float(np.degrees(mean)), int(lean.argmax())

    @property
    def clearance(self) -> npt.NDArray[np.float64]:
        """G + c m p, zero in contact (c is the compliance), ``(num_multipliers,)``."""
        return self.g + self._compliance * self.m * self.state.p

    @property
    def distance(self) -> npt.NDArray[np.float64]:
        """Clearance over area, infinite where there is no multiplier, ``(num_multipliers,)``."""
        return self._over_areas(self.clearance, np.inf) if self.has_compliance else self._apart

    @property
    def closed(self) -> float:
        """Length of gaps treated as closed."""
        return CLOSED_GAP * self._size

    def subtract_forces(
        self, residual: Sequence[npt.NDArray], prescribed: Sequence[npt.NDArray[np.bool_]]
    ) -> list[npt.NDArray[np.float64]]:
        """Subtract the contact forces from this rank's residual of each body, and return them.

        Prescribed dofs have no residual.
        """
        forces = self.contact_forces()
        rigid = self._rigid.bodies if self._rigid else (None, None)
        each = zip(self.bodies, forces, self._owned_dofs, rigid, strict=True)
        for side, (body, force, (mine, dofs), moves) in enumerate(each):
            if body is None:
                continue
            if self._rigid and moves:
                on = ~prescribed[body]  # of this rank
                residual[body] -= (self._rigid.generalised(side, force)[: len(on)]) * on
            else:
                residual[body][dofs] -= force[mine].ravel() * ~prescribed[body][dofs]
        return forces

    def loads_on(self, body: RigidBodyMotion) -> list[tuple[npt.NDArray, npt.NDArray]]:
        """Contact forces on a rigid body, as :meth:`RigidBodyMotion.react` takes them."""
        return self._rigid.loads(body, self.contact_forces()) if self._rigid else []

    @cached_property
    def _owned_dofs(self) -> list[tuple[npt.NDArray, npt.NDArray]]:
        """Mask of this rank's dofs on each side, and those dofs in the body, unrolled and local."""
        found = []
        for side, part in zip(self.sides, self.components, strict=True):
            start, end = part.space.dofmap.index_map.local_range
            mine = (side.dofs >= start) & (side.dofs < end)
            dofs = (side.dofs[mine] - start)[:, None] * self._n + np.arange(self._n)
            dofs = dofs.ravel()
            found.append((mine, dofs if part.dofs is None else part.dofs[dofs]))
        return found

    @cached_property
    def _order(self) -> npt.NDArray[np.intp]:
        """Multipliers in the order of their ranks."""
        return np.argsort(np.tile(self._rank, self._per_vertex), kind="stable")

    @cached_property
    def ranges(self) -> npt.NDArray[np.intp]:
        """First multiplier of each rank in that order, and the end."""
        num = np.bincount(self._rank, minlength=self._comm.size)
        return np.append(0, np.cumsum(num)) * self._per_vertex

    @property
    def mine(self) -> npt.NDArray[np.intp]:
        """This rank's multipliers."""
        start, end = self.ranges[self._comm.rank : self._comm.rank + 2]
        return self._order[start:end]

    def gathered(self, values: npt.NDArray) -> npt.NDArray:
        """Values of all multipliers from those of each rank's. Collective."""
        found = np.empty(len(self._order), dtype=values.dtype)
        self._comm.Allgatherv(values, (found, np.diff(self.ranges)))
        result = np.empty_like(found)
        result[self._order] = found
        return result

    @cached_property
    def unknowns(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.int64]]:
        """Body of each unknown (-1: multipliers, -2: prescribed), and its number there."""
        own = np.empty_like(self._order)
        own[self._order] = np.arange(len(own))
        bodies, numbers = [], []
        are_free = np.split(self._is_free, [self._held[0].size])
        each = zip(self.sides, self.components, self.bodies, are_free, strict=True)
        for side, part, body, free in each:
            bodies.append(np.where(free, -2 if body is None else body, -2))
            of_body = part.global_dofs().reshape(-1, self._n)
            start = part.space.dofmap.index_map.local_range[0]
            numbers.append(look_up(self._comm, of_body, start, side.dofs).ravel())
        bodies, numbers = [*bodies, np.full(len(own), -1)], [*numbers, own]
        if self._rigid:
            of_rigid, mine = self._rigid.numbers(self.bodies)
            bodies.append(of_rigid)
            numbers.append(mine)
        return np.concatenate(bodies), np.concatenate(numbers)

    @property
    def _by_rigid(self) -> Sparse:
        """Derivatives of dofs by the unknowns of rigid bodies, which are behind all others."""
        assert self._rigid is not None
        return self._rigid.slopes(len(self._is_free) + self.num_unknowns)

    def pattern(self) -> Pattern:
        """Pattern of the equations; in the plane with entries that sliding may bring next.

        In the plane these hardly add to the fill of the factors. In space they would add half as
        many operations again.
        """
        at, num, n = self._acting, len(self.g), self._n
        a, node = at.i % num, at.j // n
        near = (self.valid if n == 2 else self.state.active)[a]
        facets = self.sides[0].at_facets if n == 2 else None
        shape = num, len(self._is_free) // n
        found = coupled(a[near], node[near], shape, n, self._per_vertex, facets)
        gone = self.unknowns[0] == -2
        if self._rigid:
            found = found.coupled_with(len(gone) - found.size)
        return found.without(gone)

    def equations(self, increments: Sequence[npt.NDArray] | None) -> Linear:
        """Laws of the working set to first order, and p = 0 of other multipliers. Collective.

        Args:
            increments: Increments that prescribed displacements of each body have to make, if any.
        """
        if not self.state.active.any():
            return self.without_forces()
        num, k, f, y0 = len(self.g), self._stiffness, self._forces, self._scaled(self._lengths)
        y = self._now if self._guess is None else self._guess
        error, by_y, by_f = self._first_order(y, f)
        # by_y (y_new − y) + by_f (f_new − f) = −error, y_new = y0 − G dx + give f_new
        right = error - np.einsum("kla,la->ka", by_f, f)
        right += np.einsum("kla,la->ka", by_y, y0 - y)
        by_f[:, 0] += by_y[:, 0] * self._give
        if increments is not None:
            moves = self._scaled(self._product(self.from_bodies(increments)))
            right += np.einsum("kla,la->ka", by_y, moves)
        on, start = self.is_in, len(self._is_free)
        acting, rows = (self._watched(part) for part in (self._acting, self._slopes))
        acting = acting.some(on[acting.i])
        found = [Sparse(acting.j, start + acting.i, self._root * acting.values)]
        part, a = np.divmod(rows.i, num)
        values = self._root * rows.values * by_y[:, part, a]
        i, e = np.nonzero((values != 0) & on.reshape(-1, num)[:, a])
        found.append(Sparse(start + num * i + a[e], rows.j[e], values[i, e]))
        i, j, a = np.nonzero((by_f != 0) & on.reshape(-1, 1, num))
        found.append(Sparse(start + num * i + a, start + num * j + a, -k * by_f[i, j, a]))
        beside = self._pressed_by(by_y)
        self._beside = beside = beside.some(on[beside.i])
        beside = beside.some(on[beside.j])
        found.append(Sparse(start + beside.i, start + beside.j, -k * beside.values))
        off = start + np.flatnonzero(~on)
        found.append(Sparse(off, off, np.full(len(off), self._diagonal)))
        if self._bends is None:  # else that of the step's first working set
            H = self._stress_stiffness()
            self._bends = replace(H, values=-H.values)
        found.append(self._bends)
        return Linear(
            joined(*found),
            np.where(on, self._root * right.ravel(), 0),
            f.ravel() / self._root * on,
            self._springs(by_y, by_f),
        )

    def _springs(self, by_y, by_f) -> Sparse:
        """Slips against which tractions grow, times the root of that stiffness.

        Args:
            by_y: As of :meth:`law`, to first order.
            by_f: Likewise.
        """
        return Sparse.empty()

    def _stress_stiffness(self) -> Sparse:
        """Derivative of the forces at fixed multipliers, by the unknowns of the equations."""
        bends = self._follows and self.state.opening is not None
        H = self._curvature() if bends else Sparse.empty()
        if not self._rigid:
            return H.some(self._is_free[H.i] & self._is_free[H.j])
        free, start = np.flatnonzero(self._is_free), len(self._is_free) + self.num_unknowns
        P = joined(Sparse(free, free, np.ones(len(free))), self._by_rigid)
        return joined(P.T @ (H @ P), self._rigid.curvature(start, self.contact_forces()))

    def _first_order(self, y, f):
        """Errors of the laws in the states of the working set, their derivatives by y and f.

        A small weight of increments of pressures keeps the system regular where rows are redundant.
        """
        active = self.state.active
        error, by_y, by_f, _ = self.law(y, f, np.arange(len(self.g)), (active,))
        by_f[0, 0] += NOTHING * active
        return error, by_y, by_f

    @property
    def _forces(self) -> npt.NDArray[np.float64]:
        """The multipliers in the units of the linearised problem, ``(n, num_multipliers)``."""
        values = self._values.reshape(self._per_vertex, -1)
        return values * self._areas[: self._per_vertex] / self._root

    @property
    def _values(self) -> npt.NDArray[np.float64]:
        """The multipliers."""
        return self.state.p

    def without_forces(self) -> Linear:
        """Equations of multipliers that are all zero."""
        none = np.zeros(len(self._order))
        every = len(self._is_free) + np.arange(len(none))
        return Linear(Sparse(every, every, none + self._diagonal), none, none, Sparse.empty())

    def moved(self, modes: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
        """Motions at both sides' dofs, ``(num, num_dofs)``. Collective.

        Args:
            modes: This rank's motions of each body, ``(num_owned, num)``.
        """
        parts = [part.reshape(-1, part.shape[2]) for part in self.from_bodies(modes)]
        return np.ascontiguousarray(np.vstack(parts).T)

    def holds(self, moves: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """C applied to what :meth:`moved` gives, over areas, ``(num_multipliers, num)``."""
        return self._over_areas(self.C.products(moves, len(self.m))).T

    def pushes(self, moves: npt.NDArray[np.float64], motion: npt.NDArray[np.float64]):
        """Forces on motions by pressures, and by friction that does most work on one of them.

        Args:
            moves: What :meth:`moved` gives.
            motion: ``(num,)``.

        Returns:
            ``(num_multipliers, num)``, zero without a multiplier.
        """
        return self.C.products(moves, len(self.m)).T * self.valid[:, None]

    @property
    def acting(self) -> tuple[Sparse, npt.NDArray[np.float64]]:
        """Forces at both sides' dofs by multipliers, and the multipliers, 0 where inactive."""
        return self._acting, self._values * self.is_in

    def act_between(self, other: tuple[Sparse, npt.NDArray[np.float64]], share: float):
        """Take multipliers and directions whose forces lie between these and others.

        Args:
            other: Those of another state, as :attr:`acting`.
            share: Share of the others.
        """
        f = np.stack((self.acting[1], other[1]))
        parts = np.array((1 - share, share))[:, None] * f
        total = parts.sum(axis=0)
        weights = np.divide(parts, total, out=np.zeros_like(parts), where=total != 0)
        self._acting = joined(*(a.scaled(w) for a, w in zip((self._acting, other[0]), weights)))
        self._take(total)

    def act_along(self, acting: Sparse):
        """Take other forces by the multipliers."""
        values, self._acting = self.acting[1], acting
        self._take(values)

    def _take(self, values: npt.NDArray[np.float64]):
        """Take multipliers, and what acts along their rows."""
        num = len(self.g)
        self.state.p, self.C = values[:num], self._acting.some(self._acting.i < num)
        self.state.active = self.state.active | (values[:num] != 0)

    def contact_forces(self) -> list[npt.NDArray[np.float64]]:
        """Forces of active multipliers at both sides' dofs, ``(num_dofs_i, n)`` each."""
        f, at = self._values * self.is_in, self._acting
        flat = np.bincount(at.j, at.values * f[at.i], len(self._is_free)).astype(float)
        forces, num = flat.reshape(-1, self._n), len(self.sides[0].dofs)
        return [forces[:num], forces[num:]]

    def unsatisfied(self) -> npt.NDArray[np.float64]:
        """Residual gaps and pressures as lengths, ``(num_multipliers,)``."""
        left = np.minimum(self.state.p * self.m / self._stiffness, self.distance)
        return np.where(self.valid, left, 0)

    def is_closed(self, nothing: float) -> bool:
        """True if active gaps are closed without tension, and no inactive one is negative.

        Args:
            nothing: Force treated as zero.
        """
        p, m = self.state.p[self.state.active], self.m[self.state.active]
        if (np.minimum(p + EXCEEDS * np.abs(p).max(initial=0), 0) * m < -nothing).any():
            return False
        apart = self.distance[self.valid & ~self.state.active]
        return self.largest_gap <= self.closed and bool((apart >= -self.closed).all())

    @property
    def largest_gap(self) -> float:
        """Largest gap, or overlap, of the active set, a length."""
        if not self.state.active.any():
            return 0.0
        return float(np.abs(self.distance[self.state.active]).max(initial=0))

    @property
    def is_exact(self) -> bool:
        """True if closed gaps need no further Newton step."""
        return True

    def _curvature(self) -> Sparse:
        """Derivative of the forces at fixed multipliers."""
        assert self.state.opening is not None
        p = self.spread(np.maximum(self.state.p, 0) * self.state.active)
        return self.state.opening.curvature(self.u, p)


def _unless_same(known: Displacements, u: Displacements) -> Displacements:
    """Displacements that can't be written to: known ones, by identity, where they are the same."""
    for part in u:
        part.flags.writeable = False
    u0, u1 = (a if np.array_equal(a, b) else b for a, b in zip(known, u, strict=True))
    return u0, u1


def share_ends(contacts: Sequence[ContactRows], interfaces: Sequence[Interface]):
    """Condense pressures of vertices of Γ1 whose gaps ties, supports or other contacts hold.

    Args:
        contacts: The contacts of a problem; their ``condensed_to`` is set.
        interfaces: Its ties.
    """
    known: list[Component] = []

    def ending(part: Component, side: MovingSurface, held=None) -> EndingSide:
        at = next((k for k, other in enumerate(known) if other.same(part)), len(known))
        if at == len(known):
            known.append(part)
        return EndingSide(at, side, held)

    sides = [list(map(ending, rows.components, rows.sides, rows._held)) for rows in contacts]
    tied = [
        list(map(ending, tie.components, map(MovingSurface, tie.surfaces))) for tie in interfaces
    ]
    for rows, found in zip(contacts, condensations(sides, tied), strict=True):
        if not rows.meets_itself:  # else each end lies opposite of itself
            rows.condensed_to = found


@dataclass(frozen=True)
class SystemState:
    """State of a problem at one point of a load step, to restore if the step fails."""

    values: Sequence[npt.NDArray[np.float64]]
    """This rank's unknowns of bodies and ties."""
    contacts: Sequence[NormalState]
    """State of each contact."""

    def towards(self, other: "SystemState", share: float) -> "SystemState":
        """A state between this one and another one, or before this one at a negative share.

        Between them, multipliers and sets are those of the other state. Before this one,
        multipliers are extrapolated, and sets are those of this state.

        Args:
            other: The other state.
            share: Share of the way: 0 is this state, 1 the other one.
        """
        values = [a + share * (b - a) for a, b in zip(self.values, other.values, strict=True)]
        contacts = []
        for one, two in zip(self.contacts, other.contacts, strict=True):
            if share >= 0:
                contacts.append(replace(two, opening=one.opening))
                continue
            ends = {k: (a, two.arrays[k]) for k, a in one.arrays.items() if a.dtype != bool}
            contacts.append(replace(one, **{k: a + share * (b - a) for k, (a, b) in ends.items()}))
        return SystemState(values, contacts)
