# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""One contact in a problem: Σ, gaps and pressures as arrays, and their rows as matrices.

Where bodies in contact are, to go back there or on the way to somewhere else.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.contact_solver import active_set
from hypergap_dolfinx.contact_solver.pattern import Pattern, beside, coupled, unique_pairs
from hypergap_dolfinx.contact_solver.shared_ends import EndingSide, lenders
from hypergap_dolfinx.contact_solver.tolerances import CLOSED_GAP, FREE
from hypergap_dolfinx.errors import InterfaceError, NotFacingError
from hypergap_dolfinx.multipliers.interface import ContactInterface, Gaps, Interface
from hypergap_dolfinx.multipliers.numbering import look_up
from hypergap_dolfinx.surface.moving import Displacements, MovingSurface, Sparse, joined
from hypergap_dolfinx.surface.trace import lengths, normals_by_area


@dataclass(frozen=True)
class Touching:
    """A contact among the bodies of a problem."""

    contact: ContactInterface
    u: tuple[fem.Function, fem.Function]
    """Displacements of their bodies."""
    bodies: tuple[int | None, int | None]
    """Numbers of their bodies; None is a rigid one."""


@dataclass
class Pressed:
    """What a load step changes, and gives back if it fails."""

    opening: Gaps | None
    p: npt.NDArray[np.float64]
    """``(num_multipliers,)``."""
    on: npt.NDArray[np.bool_]
    """The active set, ``(num_multipliers,)``."""
    there: npt.NDArray[np.bool_]
    """Which multipliers there were, ``(num_multipliers,)``."""

    def copy(self):
        """One that keeps its arrays, and the Σ that the next one hangs on."""
        arrays = {k: v.copy() for k, v in self.arrays.items()}
        return replace(self, opening=copy(self.opening), **arrays)

    @property
    def arrays(self) -> dict[str, npt.NDArray]:
        """All of them, ``(..., num_multipliers)`` each."""
        return {k: v for k, v in vars(self).items() if isinstance(v, np.ndarray)}


@dataclass(frozen=True)
class Linear:
    """Equations of multipliers, to be solved with those of the bodies.

    Unknowns are those of both sides' dofs, then the multipliers.
    """

    matrix: Sparse
    """What it adds to the bodies' matrix: forces, rows of gaps, and p = 0 of what isn't acting."""
    right: npt.NDArray[np.float64]
    """``(num_multipliers,)``."""
    scale: npt.NDArray[np.float64]
    """Multipliers over unknowns."""
    start: npt.NDArray[np.float64]
    """The unknowns of the multipliers that there are."""

    def stiffened(self, H: Sparse) -> "Linear":
        """With a matrix that is subtracted."""
        return replace(self, matrix=joined(self.matrix, Sparse(H.i, H.j, -H.values)))


class ContactRows:
    """Contact between two bodies; arrays are the same on every rank, matrices distributed."""

    def __init__(self, touching: Touching, held: Sequence[npt.NDArray[np.bool_]]):
        """Find out where the surfaces are in the bodies. Collective.

        Args:
            touching: What touches.
            held: Which owned dofs of each body are prescribed.
        """
        self._contact, self.fields, self.bodies = touching.contact, touching.u, touching.bodies
        self.sides, self.spaces = self._contact.sides, self._contact.spaces
        self._comm, self._follows = self.spaces[0].mesh.comm, self._contact.follows
        self._first: tuple[Gaps, npt.NDArray, npt.NDArray, Sparse] | None = None
        self.apart: npt.NDArray[np.float64] | None = None
        """:attr:`distance` where the load step starts, if nothing pushes there."""
        self.start: Displacements | None = None
        """Where the load step starts; None before anything was looked at."""
        self._accepted: tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]] | None = None
        sides, bodies = self.sides, self.bodies
        self._n = sides[0].reference.gdim
        num = len(sides[1].reference.x)
        self.now = Pressed(None, np.zeros(num), *np.zeros((2, num), dtype=bool))
        self._held = [
            np.ones((len(side.dofs), self._n), dtype=bool)
            if body is None
            else look_up(
                self._comm,
                held[body].reshape(-1, self._n).astype(np.int8),
                V.dofmap.index_map.local_range[0],
                side.dofs,
            ).astype(bool)
            for V, side, body in zip(self.spaces, sides, bodies, strict=True)
        ]
        surface = sides[1].reference
        size = lengths(normals_by_area(surface.x[surface.facets]))
        self._gives = np.zeros(num)
        self._area = np.zeros(num)
        for corner in surface.facets.T:
            self._area += np.bincount(corner, size, num)
        self._area /= surface.facets.shape[1] * (self._n - 1)
        self._rank = np.searchsorted(surface.dof_range[1:], sides[1].vertex_dofs, side="right")
        self.lender = np.arange(num)
        """The vertex whose pressure each has, -1 if none, ``(num_multipliers,)``."""

    def ending(self, i: int, space: int) -> EndingSide:
        """A side, as far as its ends go."""
        side = self.sides[i]
        held = self._held[i][np.searchsorted(side.dofs, side.vertex_dofs)]
        return EndingSide(space, side.reference, side.vertex_dofs, held)

    def displacements(self, u: Sequence[npt.NDArray[np.float64]]) -> Displacements:
        """Displacements at both sides' dofs. Collective.

        Args:
            u: This rank's owned values on Γ0's and Γ1's space, ``(num_dofs,)``.
        """
        u0, u1 = (np.zeros((len(side.dofs), self._n)) for side in self.sides)
        for values, part, (mine, dofs) in zip((u0, u1), u, self._owned_dofs, strict=True):
            values[mine] = part[dofs].reshape(-1, self._n)
            self._comm.Allreduce(MPI.IN_PLACE, values)
        return u0, u1

    def begin(self):
        """A solve begins."""

    def set_out(self):
        """Read what a user may have changed. Collective."""
        if self._contact.compliance is not None:
            self._gives = self._contact.compliance.at_vertices()

    def look(self):
        """Find the gaps where the bodies are. Collective.

        Raises:
            InterfaceError: There is no Σ, though the sides face each other.
        """
        self.u = self.displacements([owned_values(f) for f in self.fields])
        if self.start is None:
            self.start = self.u
        if self._follows:
            self._follow()
        else:
            if self._first is None:
                opening = self._contact.gaps(self.at, self._held)
                self._first = opening, *opening.gap(self.at)
            # A first load step that failed gave back that there was none
            self.now.opening, start, self.m, self.C = self._first
            self.g = start + self.times(self.u)
        self._lend()
        self._look_behind()
        held = np.concatenate([part.ravel() for part in self._held])
        every, free = (
            np.bincount(self.C.i, weights * self.C.values**2, len(self.g))
            for weights in (1.0, ~held[self.C.j])
        )
        self.valid = (
            active_set.covered(self.m, self._area) & (free > FREE**2 * every) & ~self._behind
        )
        self._hand_on()

    def _hand_on(self):
        """Let multipliers that come among those in contact begin as these are.

        Their weights were part of these before: so forces stay, and nothing tells yet what parts.
        """
        now = self.now
        self.lasting = now.there & self.valid
        facets = self.sides[1].reference.facets
        come = self.valid & ~now.there
        source = active_set.sources(come, self.lasting, now.on, facets)
        come = source >= 0
        for values in now.arrays.values():
            values[..., come] = values[..., source[come]]
        now.there = self.valid
        self.split = active_set.beside(come, self.lasting, facets)

    def _follow(self):
        """Find the gaps of a Σ that follows the bodies; none where they don't face each other."""
        now = self.now
        try:  # the same on all ranks
            if now.opening is None:
                now.opening = self._contact.gaps(self.u, self._held)
            self.g, self.m, self.C = now.opening.gap(self.u)
        except NotFacingError:
            none = np.zeros(len(self._area))
            now.opening, self.g, self.m, self.C = None, none, none, Sparse.empty()

    def _lend(self):
        """Add rows without a pressure of their own to those whose pressure they have."""
        if (self.lender == np.arange(len(self.lender))).all():
            return
        has = self.lender >= 0
        self.g, self.m = (
            np.bincount(self.lender[has], part[has], len(part)) for part in (self.g, self.m)
        )
        self.C = self._lent(self.C)

    def _lent(self, matrix: Sparse) -> Sparse:
        """Rows without a pressure of their own added to others, of one component or several."""
        component, a = np.divmod(matrix.i, len(self.lender))
        has, i = self.lender[a] >= 0, component * len(self.lender) + self.lender[a]
        return Sparse(i[has], matrix.j[has], matrix.values[has])

    def spread(self, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Pressures of all vertices from those of multipliers, ``(num_multipliers,)`` each."""
        return np.where(self.lender >= 0, p[self.lender], 0)

    @property
    def at(self) -> Displacements:
        """The displacements at which Σ is."""
        u0, u1 = self.u
        return (u0, u1) if self._follows else (np.zeros_like(u0), np.zeros_like(u1))

    def _look_behind(self):
        """Find out which vertices are opposite to Γ0 at its body's other side.

        What came there in the present load step overlaps: it is to be pushed out.

        Raises:
            InterfaceError: All of them are, at first.
        """
        opposite, deep = self.m > 0, self.g < -self._contact.depth * self.m
        if self._accepted is None:
            if opposite.any() and deep[opposite].all():
                raise InterfaceError(
                    f"Γ1 is {(-self.g[opposite] / self.m[opposite]).min():.3g} and more behind Γ0: "
                    "the bodies are on the wrong sides of each other, or the facets on those of "
                    "the bodies."
                )
            self._accepted = deep, opposite
        before, there = self._accepted
        self._behind = (before & (self.g < 0)) | (deep & ~there)

    def accept(self):
        """The state is that from which the next load step starts."""
        self.start = self.u
        if self.now.opening is not None:
            self._accepted = self._behind, self.m > 0

    @property
    def clearance(self) -> npt.NDArray[np.float64]:
        """What is 0 in contact: g + c m p, just g if nothing gives way; ``(num_multipliers,)``."""
        return self.g + self._gives * self.m * self.now.p

    @property
    def distance(self) -> npt.NDArray[np.float64]:
        """Clearance over area, infinite where there is no multiplier, ``(num_multipliers,)``."""
        return np.divide(self.clearance, self.m, np.full_like(self.g, np.inf), where=self.valid)

    def in_series(self, stiffness: float) -> npt.NDArray[np.float64]:
        """A stiffness as what gives way lets feel of it, ``(num_multipliers,)``."""
        return stiffness / (1 + stiffness * self._gives)

    @property
    def closed(self) -> float:
        """The length of gaps that are none."""
        return CLOSED_GAP * float(self.sides[1].reference.size.max())

    @property
    def typical_area(self) -> float:
        """Median of the areas of multipliers."""
        areas = np.sort(self.m[self.valid])  # np.median takes ten times as long
        num = len(areas)
        return float(areas[(num - 1) // 2] + areas[num // 2]) / 2 if num else 1.0

    def times(self, values: Displacements) -> npt.NDArray[np.float64]:
        """C applied to values at both sides' dofs, ``(num_multipliers,)``."""
        flat = np.concatenate([part.ravel() for part in values])
        products = self.C.values * flat[self.C.j]
        return np.bincount(self.C.i, products, len(self.m)).astype(float)  # without any: integers

    def forces(self, p: npt.NDArray[np.float64]) -> list[npt.NDArray[np.float64]]:
        """Cᵀp at both sides' dofs, ``(num_dofs_i, n)`` each."""
        num = [len(side.dofs) for side in self.sides]
        flat = np.bincount(self.C.j, self.C.values * p[self.C.i], sum(num) * self._n)
        return np.split(flat.astype(float).reshape(-1, self._n), num[:1])

    def owned(self, i: int, values: npt.NDArray) -> tuple[npt.NDArray, npt.NDArray]:
        """This rank's owned dofs (unrolled, local) of a side, and the values that are there."""
        mine, dofs = self._owned_dofs[i]
        return dofs, values[mine].ravel()

    @cached_property
    def _owned_dofs(self) -> list[tuple[npt.NDArray, npt.NDArray]]:
        """Which of each side's dofs are this rank's, and these, unrolled and local."""
        found = []
        for side, V in zip(self.sides, self.spaces, strict=True):
            start, end = V.dofmap.index_map.local_range
            mine = (side.dofs >= start) & (side.dofs < end)
            dofs = (side.dofs[mine] - start)[:, None] * self._n + np.arange(self._n)
            found.append((mine, dofs.ravel()))
        return found

    @property
    def _acting(self) -> npt.NDArray[np.bool_]:
        """Which multipliers there are an equation of."""
        return self.now.on

    @cached_property
    def _order(self) -> npt.NDArray[np.intp]:
        """Multipliers, those of lower ranks first."""
        return np.argsort(np.tile(self._rank, self._per_vertex), kind="stable")

    @property
    def _per_vertex(self) -> int:
        return len(self._acting) // len(self._rank)

    @cached_property
    def ranges(self) -> npt.NDArray[np.intp]:
        """Where the multipliers of each rank begin in that order, and their number."""
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
        """Body of each unknown, -1 of multipliers, and its number there; -2 if there is none."""
        own = np.empty_like(self._order)
        own[self._order] = np.arange(len(own))
        bodies, numbers = [], []
        for side, body, held in zip(self.sides, self.bodies, self._held, strict=True):
            bodies.append(np.where(held.ravel(), -2, -2 if body is None else body))
            numbers.append((side.dofs[:, None] * self._n + np.arange(self._n)).ravel())
        return np.concatenate([*bodies, np.full(len(own), -1)]), np.concatenate([*numbers, own])

    @property
    def _num_dofs(self) -> int:
        """Number of unknowns of both sides' dofs."""
        return len(self.unknowns[0]) - len(self._order)

    def pattern(self) -> Pattern:
        """Where equations have entries; in the plane also where they may soon have some.

        There room for all that is opposite, and what lies beside, hardly fills factors more; in
        space it takes half as many operations again.
        """
        at, num, n = self._support(), len(self.g), self._n
        a, node, num_nodes = at.i % num, at.j // n, self._num_dofs // n
        near = self.valid if n == 2 else self.now.on
        a, node = unique_pairs(a[near[a]], node[near[a]], num_nodes)
        if n == 2:
            a, node = beside(a, node, self.sides[0].at_facets, num_nodes)
        found = coupled(a, node, num_nodes, num, n, self._per_vertex)
        return found.without(self.unknowns[0] == -2)

    def _support(self) -> Sparse:
        """Entries at all that multipliers act on."""
        return self.C

    def linearised(self, stiffness: float, moves: Displacements | None) -> Linear:
        """Equations of gaps.

        Args:
            stiffness: Of the bodies' nodes, which rows are scaled by.
            moves: What prescribed displacements have to move yet, if anything.
        """
        scale = np.divide(stiffness, self.m, out=np.zeros_like(self.m), where=self.valid)
        rows = Sparse(self.C.i, self.C.j, self.C.values * scale[self.C.i])
        right = scale * (self.g if moves is None else self.g + self.times(moves))
        give = self._giving(stiffness * scale)
        return self._linear(stiffness, rows, rows, give, right, scale)

    def _giving(self, scale: npt.NDArray[np.float64]) -> Sparse:
        """−c of what is in contact, times a scale, if it gives way anywhere."""
        on = np.flatnonzero(self.now.on)
        return Sparse(on, on, -(scale * self._gives)[on]) if self._gives.any() else Sparse.empty()

    def _linear(
        self, stiffness: float, rows: Sparse, forces: Sparse, corner: Sparse, right, scale
    ) -> Linear:
        """Equations of the acting multipliers, and those of the others.

        Args:
            stiffness: Of the bodies' nodes.
            rows: By dofs, scaled.
            forces: Transposed as rows.
            corner: By the multipliers themselves.
            right: Right-hand side.
            scale: Factors that make multipliers of unknowns.
        """
        on, start = self._acting, self._num_dofs
        there = self.unknowns[0] != -2
        parts = []
        for by_row, matrix in ((True, rows), (False, forces)):
            use = on[matrix.i] & there[matrix.j]
            i, j = start + matrix.i[use], matrix.j[use]
            parts.append(Sparse(*((i, j) if by_row else (j, i)), matrix.values[use]))
        parts.append(Sparse(start + corner.i, start + corner.j, corner.values))
        off = start + np.flatnonzero(~on)
        parts.append(Sparse(off, off, np.full(len(off), stiffness)))
        start = np.divide(self._values, scale, out=np.zeros(len(on)), where=on & (scale != 0))
        return Linear(joined(*parts), np.where(on, right, 0), scale, start)

    @property
    def _values(self) -> npt.NDArray[np.float64]:
        """What :meth:`_take` takes."""
        return self.now.p

    def without_forces(self, stiffness: float) -> Linear:
        """Equations of multipliers that are all zero."""
        none = np.zeros(len(self._order))
        every = self._num_dofs + np.arange(len(none))
        return Linear(Sparse(every, every, none + stiffness), none, none, none)

    def take(self, linear: Linear, solution: npt.NDArray[np.float64]):
        """The solution's multipliers.

        Args:
            linear: What was solved.
            solution: The unknowns, ``(num_multipliers,)``.
        """
        self._take(solution * linear.scale)

    def _take(self, values: npt.NDArray[np.float64]):
        self.now.p = values

    def forget(self):
        """No pressures."""
        self.now.p = np.zeros_like(self.g)

    @property
    def sets(self) -> npt.NDArray:
        """Where it is in contact; equal ones need no new tangent."""
        return self.now.on.copy()

    def as_before(self, last: npt.NDArray, sets: npt.NDArray) -> bool:
        """Whether sets are the last ones but for multipliers that came or went."""
        changed = (last != sets).reshape(-1, len(self.g))
        return not changed[:, self.lasting].any()

    def holds(self, moves: Sequence[Displacements]) -> npt.NDArray[np.float64]:
        """What multipliers make of motions, over areas, ``(num_multipliers, num)``."""
        result = np.zeros((len(self.g), len(moves)))
        for k, move in enumerate(moves):
            result[:, k] = self.times(move) / np.where(self.valid, self.m, 1)
        return np.where(self.valid[:, None], result, 0)

    def acting(self) -> list[npt.NDArray[np.float64]]:
        """Forces of what is in contact at both sides' dofs, ``(num_dofs_i, n)`` each."""
        return self.forces(self.now.p * self.now.on)

    def is_closed(self, tolerance: float) -> bool:
        """Whether what is in contact is closed.

        Args:
            tolerance: Length that is none.
        """
        return bool(np.abs(self.distance[self.now.on]).max(initial=0) <= tolerance)

    @property
    def is_exact(self) -> bool:
        """Whether what is closed needs no further step."""
        return True

    def curvature(self) -> Sparse:
        """How forces change where bodies move, in the same unknowns as the equations."""
        if not self._follows or self.now.opening is None:
            return Sparse.empty()
        H, there = self._curvature(), self.unknowns[0] != -2
        use = there[H.i] & there[H.j]
        return Sparse(H.i[use], H.j[use], H.values[use])

    def _curvature(self) -> Sparse:
        """How forces change where multipliers stay."""
        assert self.now.opening is not None
        p = self.spread(np.maximum(self.now.p, 0) * self.now.on)
        return self.now.opening.curvature(self.u, p)


def share_ends(contacts: Sequence[ContactRows], interfaces: Sequence[Interface]):
    """Find vertices of Γ1 whose gap ties, supports or other contacts hold already.

    Args:
        contacts: The contacts of a problem; what they lend is set.
        interfaces: Its ties.
    """
    spaces: list[fem.FunctionSpace] = []

    def number(V: fem.FunctionSpace) -> int:
        if V not in spaces:
            spaces.append(V)
        return spaces.index(V)

    sides, tied = [], []
    for rows in contacts:
        side0, side1 = (rows.ending(i, number(V)) for i, V in enumerate(rows.spaces))
        sides.append((side0, side1))
    for tie in interfaces:
        side0, side1 = (
            EndingSide(number(V), surface, MovingSurface(surface).vertex_dofs)
            for V, surface in zip(tie.spaces, tie.surfaces, strict=True)
        )
        tied.append((side0, side1))
    for rows, lender in zip(contacts, lenders(sides, tied), strict=True):
        rows.lender = lender


def owned_values(u: fem.Function) -> npt.NDArray[np.float64]:
    """This rank's owned values, ``(num_dofs,)``."""
    dofmap = u.function_space.dofmap
    return u.x.array[: dofmap.index_map.size_local * dofmap.index_map_bs]


@dataclass(frozen=True)
class State:
    """What a load step changes, and gives back if it fails."""

    values: Sequence[npt.NDArray[np.float64]]
    """This rank's unknowns of bodies and ties."""
    pressed: Sequence[Pressed]
    """Of each contact."""

    def towards(self, other: "State", share: float) -> "State":
        """One on the way to another or beyond, with its own sets.

        Args:
            other: The other one.
            share: Of the way: 0 is here, 1 there.
        """
        values = [a + share * (b - a) for a, b in zip(self.values, other.values, strict=True)]
        pressed = []
        for one, two in zip(self.pressed, other.pressed, strict=True):
            ends = {k: (a, two.arrays[k]) for k, a in one.arrays.items() if a.dtype != bool}
            pressed.append(replace(one, **{k: a + share * (b - a) for k, (a, b) in ends.items()}))
        return State(values, pressed)
