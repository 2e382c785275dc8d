# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A contact with Coulomb friction in a problem: stick, slip, and their linear equations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.rigid_motions import moment, places
from hypergap_dolfinx.algebra.tolerances import NOTHING
from hypergap_dolfinx.contact_solver.contact_rows import (
    ContactPair,
    ContactRows,
    NormalState,
    joined,
)
from hypergap_dolfinx.contact_solver.predictor import RigidMotion
from hypergap_dolfinx.contact_solver.tolerances import EXACT, EXCEEDS, HOLDS
from hypergap_dolfinx.surface.moving import Displacements, Sparse
from hypergap_dolfinx.surface.trace import lengths


@dataclass
class FrictionState(NormalState):
    """State of a contact with friction."""

    q: npt.NDArray[np.float64]
    """Tractions on Γ1's body along its tangents, ``(n - 1, num_multipliers)``."""
    sticks: npt.NDArray[np.bool_]
    """Mask of multipliers that stick if they are active, ``(num_multipliers,)``."""
    way: npt.NDArray[np.float64]
    """Unit direction of q where the surfaces slip, ``(n - 1, num_multipliers)``."""


class FrictionRows(ContactRows):
    """Contact with friction: tractions q with |q| ≤ min(μ P, τ), against the slip s of a load step.

    P and s are those of vertices. Where Γ1 is covered in part, rows of gaps share neighbours', and
    P = Lᵀp (:mod:`~hypergap_dolfinx.contact_geometry.blending`). So a vertex whose own row is open
    has traction, too, if it has a part in a closed one.

    Multiplier a has the unknowns and rows k num_multipliers + a: of p for k = 0, then of q_k.
    """

    state: FrictionState

    def __init__(self, pair: ContactPair, held: Sequence[npt.NDArray[np.bool_]]):
        """As for a contact without friction. Collective."""
        super().__init__(pair, held)
        num, across = len(self.state.p), self._n - 1
        self._per_vertex = self._n
        assert pair.contact.friction is not None
        self._friction = pair.contact.friction
        self._soft, self._limit = self._friction.elastic_slip, self._friction.shear_limit
        self.state = FrictionState(
            **vars(self.state),
            q=np.zeros((across, num)),
            sticks=np.ones(num, dtype=bool),
            way=np.zeros((across, num)),
        )
        self._since: Displacements | None = None
        self.T = self._bears = Sparse.empty()
        self._sizes = np.zeros(num)  # own areas of vertices
        self._shares = np.zeros(num, dtype=bool)  # that have a part in others' rows
        self._elastic = np.zeros((across, num))  # elastic part of the slip
        self._all_slopes: Sparse | None = None
        none = np.zeros(num, dtype=bool)
        self._rubs: tuple[npt.NDArray, ...] = none, none, none  # found, behind what it is found of

    @property
    def has_friction(self) -> bool:
        """The same, where a coefficient isn't zero."""
        return bool(self._friction.at_vertices().any())

    def start_solve(self):
        """Start a solve: count its dissipation and its slip from zero."""
        super().start_solve()
        self.dissipated = 0.0
        self.slipped = np.zeros((len(self.state.p), self._n))

    @property
    def kept(self) -> dict[str, npt.NDArray]:
        """The same arrays, with the elastic slip, the dissipation and the slip."""
        own = {"elastic": self._elastic, "slipped": self.slipped}
        return {**super().kept, **own, "dissipated": np.array(self.dissipated)}

    def resume(self, kept: dict[str, npt.NDArray], start: Displacements | None):
        """Go on from arrays that were kept. Collective."""
        super().resume(kept, start)
        self._elastic, self.slipped = kept["elastic"].copy(), kept["slipped"].copy()
        self.dissipated = float(kept["dissipated"])

    def start_step(self):
        """Start a load step: read the coefficient of friction too. Collective."""
        super().start_step()
        self.mu = self._friction.at_vertices()
        self._since = self.start

    def turn(self, motion: RigidMotion):
        """Let a rigid motion of both bodies carry the origin of slip along. Collective."""
        assert self._since is not None
        x = self.displacements([f.into_body(places(f.space).ravel()) for f in self.components])
        u0, u1 = (u + motion.shift(at + u) for at, u in zip(x, self._since, strict=True))
        self._since = u0, u1

    def update_geometry(self):
        """Compute gaps and slips at the present displacements. Collective."""
        super().update_geometry()
        if self._since is None:
            self._since = self.start
        opening = self.state.opening
        if opening is None:
            self.T, self._bears, self._sizes = Sparse.empty(), Sparse.empty(), 0 * self.m
        elif self._follows or not len(self.T.i):
            self.T = self._slips()
            sizes, bears = opening.bears(self.at)
            self._sizes = self._of_carriers(sizes)
            self._bears = self._condensed(self._condensed(bears).T).T
            beside = self._bears.some(self._bears.i != self._bears.j)
            self._shares = np.bincount(beside.i, minlength=len(self.g)) > 0
        # Areas on which friction acts, without neighbours', and these over the rows' own
        self._own_areas = np.where(self.valid, self._sizes, 0)
        self._own_share = self._own_areas / np.where(self.valid, self.m, 1)
        moves = self.u[0] - self._since[0], self.u[1] - self._since[1]
        self.s = self.T.times(moves, (self._n - 1) * len(self.g)).reshape(-1, len(self.g))
        self._lengths, self._all_slopes = np.concatenate((self.g, self.s.ravel(), 0 * self.g)), None
        self._acting = joined(self.C, Sparse(len(self.g) + self.T.i, self.T.j, self.T.values))

    @property
    def num_lengths(self) -> int:
        """Number of gaps, slips, and normal forces that bound friction."""
        return self.num_unknowns + len(self.g)

    def _found_areas(self) -> npt.NDArray[np.float64]:
        own = self._own_areas
        forces = np.where(own > 0, self._stiffness, 0)  # these are no lengths
        return np.vstack((super()._found_areas(), *[own] * (self._n - 1), forces))

    def _over_own(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Values of vertices over their own areas, 0 where there is no friction."""
        own = self._own_areas
        return np.divide(values, own, out=np.zeros(values.shape), where=own > 0)

    def _borne(self, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Normal forces of vertices from pressures of multipliers, ``(num_multipliers,)`` each."""
        return np.bincount(self._bears.i, self._bears.values * p[self._bears.j], len(p))

    @property
    def pressed(self) -> npt.NDArray[np.float64]:
        """Pressures P that bound friction, ``(num_multipliers,)``."""
        return self._over_own(self._borne(self.state.p * self.state.active))

    @property
    def rubs(self) -> npt.NDArray[np.bool_]:
        """Mask of the vertices that have a part in an active row."""
        active, areas, found = self._rubs
        if active is not self.state.active or areas is not self._own_areas:
            active, areas = self.state.active, self._own_areas
            found = (self._borne(active.astype(float)) > 0) & (areas > 0)
            self._rubs = active, areas, found
        return found

    @property
    def is_in(self) -> npt.NDArray[np.bool_]:
        """Mask of the unknowns in the working set: pressures, and tractions of what they press."""
        return np.concatenate((self.state.active, *[self.rubs] * (self._n - 1)))

    @property
    def slip(self) -> npt.NDArray[np.float64]:
        """Slip of the load step, a length, 0 without a multiplier, ``(n - 1, num_multipliers)``."""
        return self._over_own(self.s)

    def commit(self):
        """Accept the state, and add up the dissipation and slip of the load step."""
        super().commit()
        now, lost = self.state, self.slip
        if self._soft:
            before, self._elastic = self._elastic, self._shortened() * self.rubs
            lost = lost + before - self._elastic
        self.dissipated -= float((now.q * self.rubs * self._sizes * lost).sum())
        self.slipped += np.einsum("ka,kai->ai", self.slip * self.rubs, self.tangents)
        now.sticks = now.sticks | ~self.rubs

    @property
    def _reach(self) -> npt.NDArray[np.float64]:
        """Trial elastic slip: all slip taken as elastic, ``(n - 1, num_multipliers)``."""
        return self._elastic + self.slip

    def _shortened(self) -> npt.NDArray[np.float64]:
        """Elastic slip: the trial one, no longer than friction allows."""
        size = lengths(self._reach.T)
        return self._reach * np.minimum(1, self._soft / np.maximum(size, 1e-300))

    @property
    def tangents(self) -> npt.NDArray[np.float64]:
        """Mean directions in which q acts on Γ1's body, ``(n - 1, num_multipliers, n)``."""
        num, start = len(self.g), len(self.sides[0].dofs) * self._n
        T = self.T.some(self.T.j >= start)
        number = T.i * self._n + (T.j - start) % self._n
        total = np.bincount(number, T.values, (self._n - 1) * num * self._n)
        return total.reshape(-1, num, self._n) * self._over_own(np.ones(num))[:, None]

    @property
    def shears(self) -> npt.NDArray[np.float64]:
        """Tractions on Γ1's body, of all vertices, ``(num_vertices, n)``."""
        q = np.einsum("ka,kai->ai", self.state.q * self.rubs, self.tangents)
        return np.stack([self.spread(part) for part in q.T], axis=1)

    def _bounds(self, p, at=slice(None), unit=1.0):
        """Friction's bound min(μ P, τ) at pressures, and its derivative by them.

        Args:
            p: Pressures of vertices, times ``unit``.
            at: Numbers of the multipliers.
            unit: Unit of the pressures.
        """
        bound, limit = self.mu[at] * np.maximum(p, 0), self._limit * unit
        return np.minimum(bound, limit), np.where((bound < limit) & (p > 0), self.mu[at], 0)

    # Sets

    @property
    def stuck(self) -> npt.NDArray[np.bool_]:
        """Mask of vertices that stick under pressure."""
        return self.rubs & self.state.sticks

    @property
    def slips(self) -> npt.NDArray[np.bool_]:
        """Mask of vertices that slip under pressure."""
        return self.rubs & ~self.state.sticks & (self._bounds(self.pressed)[0] > 0)

    @property
    def is_alone(self) -> npt.NDArray[np.bool_]:
        """Mask of vertices that share no row with others, ``(num_multipliers,)``."""
        shared = self._bears.some(self._bears.i != self._bears.j)
        result = np.ones(len(self.g), dtype=bool)
        result[shared.i] = result[shared.j] = False
        return result

    def margins(self, ways: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """What friction could still give along directions where it sticks, ``(num_multipliers,)``.

        Nothing sticks with an elastic slip, which has no edge. Vertices that share rows have 0.

        Args:
            ways: Unit directions at vertices, 0 where none is asked for, ``(num_vertices, n)``.
        """
        q = np.einsum("ka,kai->ai", self.state.q, self.tangents)
        left = self._bounds(self.pressed)[0] - (q * ways).sum(axis=1)
        asked = self.stuck & self.is_alone & (lengths(ways) > 0) & (self._soft == 0)
        return np.where(asked, np.maximum(left, 0), 0)

    def stick(self) -> bool:
        """Make all multipliers stick where nothing else would hold a body; true if one slipped."""
        before, self.state.sticks = self.stuck, self.mu > 0
        return bool((self.stuck & ~before).any())

    def slide(self) -> bool:
        """Make all multipliers of the working set slip, without traction; true if one stuck."""
        stuck = bool(self.stuck.any())
        self.state.sticks, self.state.way = np.zeros_like(self.state.sticks), 0 * self.state.way
        return stuck

    def resists(self, moves: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Slips by motions that the equations resist, over areas, ``(n - 1, ..., num)``.

        These are slips of what sticks, and slips across the tractions of what slips under pressure.
        """
        rows, now = self.holds_across(moves), self.state
        along = np.einsum("ka,akm->am", now.way, rows)
        rows -= np.where(now.sticks, 0, now.way).T[:, :, None] * along[:, None]
        bound, _ = self._bounds(self.pressed)
        return rows[self.rubs & (now.sticks | (bound > 0))]

    def holds_across(self, moves: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """T applied to motions, over areas, ``(num_multipliers, n - 1, num)``."""
        rows = self.T.products(moves, (self._n - 1) * len(self.g))
        return self._over_own(rows.reshape(len(moves), -1, len(self.g))).T

    def pushes(self, moves, motion):
        """The same."""
        across = self.holds_across(moves)
        slips = across @ motion
        ways = slips / np.maximum(lengths(slips), np.finfo(float).tiny)[:, None]
        friction = np.einsum("a,ak,akm->ma", self.mu, ways, across)
        of_pressures = self._bears.T.products(np.ascontiguousarray(friction), len(self.g)).T
        return super().pushes(moves, motion) + of_pressures * self.valid[:, None]

    # The linearised contact problem

    def start_set(self, stiffness: float, zero: float, *, touches: bool = True):
        """Choose the working set; what sticks is kept, also of vertices without pressure."""
        super().start_set(stiffness, zero, touches=touches)
        now, bears, unit = self.state, self._bears, self._per_unit[0] / self._root
        bears = replace(bears, values=bears.values * unit[bears.j])  # in the units of laws
        self._bears_of_units = bears.some(self._own_areas[bears.i] > 0)
        now.q = np.where(self.rubs, now.q, 0)
        if self._soft or self._n > 2:
            every = np.arange(len(self.g))
            *_, sticks, way = self._states(self._now, self._forces, every)
            now.sticks = sticks if self._soft else now.sticks
            now.way = np.where(self.rubs & ~now.sticks, way, now.way)
        now.sticks = now.sticks & (self.mu > 0)

    @property
    def _slopes(self) -> Sparse:
        """Derivatives of weighted gaps, slips and normal forces by displacements."""
        if self._all_slopes is None:
            opening, S, N = self.state.opening, self.T, Sparse.empty()
            if opening is not None and self._follows:
                assert self._since is not None
                on = self.spread(self.valid.astype(float)) > 0
                S = self._condensed(opening.slip_slopes(self.u, self._since, self.condensed_to, on))
                p = self.spread(np.maximum(self.state.p, 0) * self.state.active)
                N = self._condensed(opening.force_slopes(self.u, p))
            S, N = replace(S, i=len(self.g) + S.i), replace(N, i=self.num_unknowns + N.i)
            self._all_slopes = joined(self.C, S, N)
        return self._all_slopes

    def given(self, f: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """The same; slips get nothing, and normal forces are sums of pressures."""
        num, p = len(self.g), f[: len(self.g)]
        bears = self._bears_of_units
        if p.ndim == 1:
            forces = np.bincount(bears.i, bears.values * p[bears.j], num)
        else:
            forces = bears.products(np.ascontiguousarray(p.T), num).T
        return np.concatenate((super().given(p), 0 * f[num:], forces))

    def wrong(self, y, f, *, exactly: bool = True) -> npt.NDArray[np.bool_]:
        """The same; of laws that aren't linear in a state the error counts, too.

        Tractions turn where they slip, and are products of pressure and elastic slip.
        """
        every, now = np.arange(len(self.g)), self.state
        y, f = (v.reshape(-1, len(self.g)) for v in (y, f))
        closed, rubs, sticks, way = states = self._states(y, f, every)
        other = (closed != now.active) | (rubs != self.rubs) | (rubs & (sticks != now.sticks))
        turns = rubs & (~sticks | (self._soft > 0))
        other |= turns & (exactly | (~sticks & ((way * now.way).sum(axis=0) <= 0)))
        other &= self.valid
        if other.any():
            error, _, _, least = self.law(y, f, every, states)
            other &= (np.abs(error) > least).any(axis=0)
        return self._of_all(other)

    def _pressed_by(self, by_y) -> Sparse:
        bears, rows = self._bears_of_units, np.arange(1, self._n)[:, None]
        values = by_y[1:, self._n][:, bears.i] * bears.values
        i, j = len(self.g) * rows + bears.i, np.concatenate([bears.j] * len(rows))
        return Sparse(i.ravel(), j, values.ravel())

    def _springs(self, by_y, by_f):
        """The same, in series with springs as stiff as nodes: multigrid follows no stiffer ones."""
        slips = np.flatnonzero(self.rubs & (np.einsum("kka->a", by_f[1:, 1:]) > HOLDS))
        by_f, by_y = (of[1:, 1 : self._n, slips].transpose(2, 0, 1) for of in (by_f, by_y))
        values, vectors = np.linalg.eigh(np.linalg.solve(by_f + by_y, by_y))
        roots = np.sqrt(np.maximum(values, 0))[:, None] * vectors  # (slip, tangent, spring)
        a, k, row = np.nonzero(roots)
        num = len(self.g)
        shares = Sparse(num * row + slips[a], num * (1 + k) + slips[a], roots[a, k, row])
        return shares @ self._watched(self._acting)

    def _states(self, y, f, at):
        """What is closed, has pressure, sticks, directions of slip; arguments as :meth:`law`."""
        root = self._root
        closed = f[0] > y[0]
        rubs = closed | (self._shares[at] & (y[-1] > 0))
        if self._soft:
            reach = root * self._elastic[:, at] + y[1:-1]
            size = lengths(reach.T)
            way = -reach / np.where(size > 0, size, 1)
            return closed, rubs, size <= root * self._soft, way
        trial = f[1:] - y[1:-1]
        size = lengths(trial.T)
        bound, _ = self._scaled_bounds(y[-1] - self._own_share[at] * np.minimum(y[0], 0), at)
        least, _ = self._least
        none = np.maximum(EXCEEDS * bound, least[at])
        sticks = (size <= bound + np.where(self.state.sticks[at], none, -none)) & (self.mu[at] > 0)
        return closed, rubs, sticks, trial / np.where(size > 0, size, 1)

    def _scaled_bounds(self, p, at):
        """The same in the units of :meth:`law`."""
        sizes = self._own_areas[at]
        return self._bounds(p, at, np.where(sizes > 0, sizes, 1) / self._root)

    def _first_order(self, y, f):
        """Errors of the laws in the states of the working set, their derivatives by y and f.

        A small weight of sticking tractions' increments keeps the system regular where these are
        redundant.
        """
        now = self.state
        states = now.active, self.rubs, now.sticks, now.way
        every = np.arange(len(self.g))
        error, by_y, by_f, _ = self.law(y, f, every, states)
        sticks = now.sticks
        if self._soft:  # without pressure before it sticks at first, else it could hold nothing
            sticks = sticks & (self._scaled_bounds(y[-1], every)[0] == 0)
            error[1:] = np.where(sticks, y[1:-1], error[1:])
            by_y[1:, 1:-1] = np.where(sticks, np.eye(self._n - 1)[..., None], by_y[1:, 1:-1])
            by_y[1:, -1] = np.where(sticks, 0, by_y[1:, -1])
            by_f[1:] = np.where(sticks, 0, by_f[1:])
        for k in range(1, self._n):
            by_f[k, k] += NOTHING * sticks
        return error, by_y, by_f

    def law(self, y, f, at, states=None):
        """Residual of the laws of contact and friction, as for a contact without friction.

        ``states`` are those of :meth:`_states`, if they are given.
        """
        n, num, root = self._n, len(at), self._root
        error, least = np.zeros((2, n, num))
        by_y, by_f = np.zeros((n, n + 1, num)), np.zeros((n, n, num))
        closed, rubs, sticks, way = self._states(y, f, at) if states is None else states
        error[:1], by_y[:1, :1], by_f[:1, :1], least[:1] = super().law(y, f, at, (closed,))
        force, length = self._least
        one = np.eye(n - 1)[..., None]
        bound, slope = self._scaled_bounds(y[-1], at)
        none = np.maximum(EXCEEDS * bound, force[at])
        across = one - way[:, None] * way
        if self._soft:
            reach, soft = root * self._elastic[:, at] + y[1:-1], root * self._soft
            size = np.where(sticks, soft, np.maximum(lengths(reach.T), soft))
            error[1:] = f[1:] + bound * reach / size
            by_y[1:, 1:-1] = bound / size * np.where(sticks, one, across)
            by_f[1:, 1:] = one
            by_y[1:, -1] = slope * reach / size
            least[1:] = none
        else:
            size = lengths((f[1:] - y[1:-1]).T)
            turn = np.minimum(bound / np.maximum(size, 1e-300), 1) * across
            error[1:] = np.where(sticks, y[1:-1], f[1:] - bound * way)
            by_y[1:, 1:-1] = np.where(sticks, one, turn)
            by_f[1:, 1:] = np.where(sticks, 0, one - turn)
            by_y[1:, -1] = np.where(sticks, 0, -slope * way)
            least[1:] = np.where(sticks, length, none)
        error[1:] = np.where(rubs, error[1:], f[1:])
        by_y[1:] = np.where(rubs, by_y[1:], 0)
        by_f[1:, 1:] = np.where(rubs, by_f[1:, 1:], one)
        least[1:] = np.where(rubs, least[1:], force[at])
        return error, by_y, by_f, least

    def accept(self, y, f, changed):
        """Take the multipliers and sets of a solution; arguments as :meth:`law`, flat."""
        num, now = len(self.g), self.state
        super().accept(y[:num], f[:num], changed[:num])
        y, f, changed = (v.reshape(-1, num) for v in (y, f, changed))
        if changed.any():
            *_, sticks, way = self._states(y, f, np.arange(num))
            now.sticks = np.where(changed[0], sticks, now.sticks)
            now.way = np.where(changed[0], way, now.way)
        now.q = np.where(self.rubs, f[1:], 0) * self._per_unit[1:]

    def guess(self, y, f, changed):
        """Take a solution as a guess, with its directions of slip."""
        num, now = len(self.g), self.state
        sticks = self._goes_along(y) & changed[:num] & (self.mu > 0)
        super().guess(y, f, changed)
        y, f = (v.reshape(-1, num) for v in (y, f))
        now.way = self._states(y, f, np.arange(num))[3]
        now.sticks = now.sticks | sticks

    def _goes_along(self, y) -> npt.NDArray[np.bool_]:
        """Mask of multipliers that slip along their tractions, ``(num_multipliers,)``.

        They stick next. If they slipped the other way, they could turn back again, and so on.
        """
        now, slip = self.state, y.reshape(-1, len(self.g))[1:-1]
        along = ((self._root * self._elastic + slip) * now.way).sum(axis=0) > 0
        return along & self.rubs & ~now.sticks

    @property
    def _values(self) -> npt.NDArray[np.float64]:
        return np.concatenate((self.state.p, self.state.q.ravel()))

    def _take(self, values: npt.NDArray[np.float64]):
        """Take multipliers, and what acts along their rows."""
        super()._take(values)
        num, at = len(self.g), self._acting.some(self._acting.i >= len(self.g))
        self.state.q, self.T = values[num:].reshape(-1, num), replace(at, i=at.i - num)

    def forget(self):
        """Set all pressures and tractions to zero."""
        super().forget()
        self.state.q = np.zeros_like(self.state.q)

    def _curvature(self) -> Sparse:
        assert self.state.opening is not None
        acts = self.rubs & (self.pressed > 0)
        q = np.stack([self.spread(q * acts) for q in self.state.q])
        H = self.state.opening.slip_curvature(self.u, q, self.condensed_to)
        return joined(super()._curvature(), H)

    def reaches(self, least: float) -> list[tuple[float, int]]:
        """The same; fifth, the mean by force of gaps across which friction acts. Collective.

        It is what is left of the moments on both bodies, over forces. Rows that vertices share may
        have gaps of their own there. With a compliance surfaces are to overlap.
        """
        found = super().reaches(least)
        if not found or self.has_compliance or self.sides[1].reference.angle:
            return found
        forces = self.contact_forces()
        left = np.sum([moment(x + u, f) for x, u, f in zip(self.places, self.u, forces)], axis=0)
        total = float(lengths(forces[1]).sum()) * self._size
        mean = float(np.linalg.norm(left)) / total if total else 0.0
        return [*found, (mean, int((lengths(self.state.q.T) * ~self.is_alone).argmax()))]

    # Convergence

    def is_closed(self, nothing: float) -> bool:
        """True if active gaps are closed, sticking vertices don't slip, and |q| is μ p at others.

        Slip must oppose q there. It is along q where a body has turned back. Where μ p is no force,
        all slips are right.
        """
        now, rubs = self.state, self.rubs
        bound, _ = self._bounds(self.pressed)
        presses = bound * self._sizes > nothing
        rigid, target = rubs & now.sticks, bound * now.way
        if self._soft:
            rigid = np.zeros_like(rubs)
            target = -bound * self._shortened() / self._soft
        slip = np.abs(self.slip[:, rigid & presses]).max(initial=0)
        if not self._soft:
            along = (self.slip * now.way).sum(axis=0)
            slip = max(slip, along[rubs & ~rigid & presses].max(initial=0))
        error = np.abs(now.q - target)
        none = max(EXCEEDS * bound.max(initial=0), self._zero)
        wrong = rubs & ~rigid & (error > none) & (error * self._sizes > nothing)
        return super().is_closed(nothing) and slip <= self.closed and not wrong.any()

    @property
    def is_exact(self) -> bool:
        """True if gaps are small enough for the moments of friction to balance."""
        return self.largest_gap <= EXACT * self._size

    def holds_too_much(self, nothing: float) -> bool:
        """True if tractions exceed friction's bound where sticking alone holds a body.

        Args:
            nothing: Force treated as zero.
        """
        size = lengths(self.state.q.T)
        bound, _ = self._bounds(self.pressed)
        excess = np.where(self.stuck, size - bound - EXCEEDS * bound.max(initial=0), 0)
        return bool((excess * self._sizes > nothing).any())
