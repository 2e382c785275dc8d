# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Pressures on Γ1's facets, below these where contact has a free edge, and shear of friction.

Where two smooth surfaces part, p has a root: with the distance d from the edge :math:`p \sim
\sqrt d`, so p² is linear there and p isn't, on no mesh. So near free edges

.. math:: p = \sqrt{\max(s, 0)}

with s linear on facets between values at vertices, which may be negative: p ends where s = 0, and
not where a vertex is. s is found by least squares from the moments of the computed forces,

.. math:: \sum_f \Bigl(\frac{\sum_{j \in f} (\int \varphi_j\,p - F_j)}
   {\bar p \sum_{j \in f} \int |\varphi_j|}\Bigr)^2 +
   \mu^2 \sum_e \Bigl(\frac{h\,[\partial s/\partial\nu]_e}{\bar p^2}\Bigr)^2 +
   \sum_r \Bigl(\frac{s(x_r)}{\bar p^2}\Bigr)^2 \to \min,

with the forces F of the multipliers at the dofs j of Γ1's body, along its normals, in sums over
facets f: what goes from a dof to the next is an error of the mesh. The sum over all dofs near one
edge is kept. There are jumps of slopes between facets, and in the plane places :math:`x_r` where
gaps say that contact ends. Beyond an edge they go like :math:`d^{3/2}`, and those of vertices are
means over hat functions: the quotient of the first two has one :math:`x_r`. Where displacements on
facets aren't linear, in the plane and in space, gaps themselves say what s is at the first open
vertices (:class:`_Opening`). Elsewhere p is linear between vertices.

An edge of contact is free where an active vertex has a neighbour that is open, as others beside
that are, and lies opposite Γ0 with all that is between, and where pressure falls towards it. At
corners it rises (it is singular there); where a surface ends nothing is open beside it: neither has
a root. At vertices it may rise towards an edge of a smooth profile, too: where gaps say what s is,
and aren't larger beyond than those of a root that ends at the last active vertex, the edge is free.
Nor has a part a root of which all active vertices are at the edge: two numbers can't be told from
one force.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.core.graph import components
from hypergap_dolfinx.mortar.tolerances import (
    PARTS_ROOT,
    RINGS_ROOT,
    SMOOTH_ROOT,
    STEPS_ROOT,
    TOTAL_ROOT,
)
from hypergap_dolfinx.surface.moving import MovingSurface, Sparse, joined
from hypergap_dolfinx.surface.trace import Surface, lengths, tabulate

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class ContactState:
    """Contact at the vertices of Γ1; all arrays are the same on every rank."""

    side: MovingSurface
    """Γ1."""
    surface: Surface
    """The same where it is."""
    p: Floats
    """Pressures, ``(num_vertices,)``."""
    active: Mask
    """Vertices in contact, ``(num_vertices,)``."""
    exists: Mask
    """Vertices that lie opposite Γ0, ``(num_vertices,)``."""
    gaps: Floats
    """Mean gaps of open vertices, weighted by their hat functions, ``(num_vertices,)``."""
    forces: Floats
    """Forces of the pressures at :attr:`side`'s dofs, ``(num_dofs, n)``."""
    compliance: float = 0.0
    """1/E*: of half-spaces of both bodies' materials in plane strain; 0 if it isn't known."""
    covered: Mask | bool = True
    """Facets that lie opposite Γ0 with all that they have, ``(num_facets,)``; True: all do."""

    @cached_property
    def vertices(self) -> npt.NDArray[np.intp]:
        """Dof of :attr:`side` at each vertex, ``(num_vertices,)``."""
        return np.searchsorted(self.side.dofs, self.side.vertex_dofs)


@dataclass(frozen=True)
class SurfacePressure:
    """A pressure on Γ1's facets."""

    surface: Surface
    p: Floats
    """At vertices, ``(num_vertices,)``; linear between these, but near free edges."""
    s: Floats
    """p² there at vertices, negative beyond the edge, ``(num_vertices,)``."""
    near: Mask
    """Facets near free edges, ``(num_facets,)``."""
    steep: Mask
    """These, and facets of parts without a root, which are drawn as finely, ``(num_facets,)``."""

    @classmethod
    def of(cls, state: ContactState, missed: float = np.inf) -> "SurfacePressure":
        """The pressure of a contact.

        Args:
            state: The contact.
            missed: Root mean square error of facets' forces, relative, of a root that isn't drawn.
        """
        s = np.where(state.p > 0, state.p, 0) ** 2
        rising, steep, fit = _prepared(state)
        if state.compliance and rising.any():
            rising, _, trial = _prepared(state, rising)
            if trial:
                _, steep, fit = _prepared(state, rising & trial.opens_smoothly(s))
        near = np.zeros(len(steep), dtype=bool)
        if fit:
            s = fit.solve(s)
            near[fit.facets] = fit.is_met(s, missed)
        return cls(state.surface, state.p, s, near, steep)

    @property
    def at_vertices(self) -> Floats:
        """At vertices, but for what free edges change, ``(num_vertices,)``."""
        return self.p

    def on(self, facets: npt.NDArray[np.intp], X: Floats) -> Floats:
        """Pressures at the same reference points X of some facets, ``(num_facets, num_points)``."""
        corners, N = self.surface.facets[facets], hats(self.surface, X)
        root = np.sqrt(np.maximum(self.s[corners] @ N.T, 0))
        return np.where(self.near[facets, None], root, self.p[corners] @ N.T)

    def ratios(self, q: Floats) -> Floats:
        """Tractions of friction over pressures at vertices, ``(num_vertices, n)``.

        Those of open vertices are means of their neighbours'.

        Args:
            q: Tractions at vertices, likewise.
        """
        known = self.p > 0
        ratio = np.divide(q, self.p[:, None], out=np.zeros_like(q), where=known[:, None])
        return continued(self.surface, ratio, known, _rings(self.surface) + 1)

    def times(self, q: Floats, ratios: Floats, facets: npt.NDArray[np.intp], X: Floats) -> Floats:
        """Tractions of friction, as :meth:`on`, ``(num_facets, num_points, n)``.

        Args:
            q: Tractions at vertices, ``(num_vertices, n)``, linear between these.
            ratios: What they are near free edges over the pressure, from :meth:`ratios`.
            facets: Facets, ``(num_facets,)``.
            X: Reference points, ``(num_points, dim)``.
        """
        corners, N = self.surface.facets[facets], hats(self.surface, X)
        root = self.on(facets, X)[..., None] * (N @ ratios[corners])
        return np.where(self.near[facets, None, None], root, N @ q[corners])

    def cells(self) -> "list[tuple[npt.NDArray[np.intp], Floats]]":
        """Facets and simplices on them, between whose corners values are linear to draw.

        Returns:
            Facets, ``(num,)``, and reference coordinates of the corners of each one's simplices,
            ``(num_simplices, dim + 1, dim)``: facets as they are, and steep ones.
        """
        return _cells(self.surface, self.steep)


@dataclass(frozen=True)
class SurfaceShear:
    r"""A traction of friction on Γ1's facets.

    Where surfaces slip in a direction t, :math:`q = \mu p\,t`. Where they stick beside that,
    :math:`r = \mu p - q \cdot t` is what friction could still give. It goes to zero at the edge
    between stick and slip as a pressure does at a free edge of contact (Cattaneo 1938, Mindlin
    1949: it is the pressure of a smaller contact). Beside these edges :math:`q + r\,t` and r are
    interpolated apart, r with its root.
    """

    pressure: SurfacePressure
    q: Floats
    """At vertices, ``(num_vertices, n)``."""
    way: Floats
    """Unit direction t of slip, ``(num_vertices, n)``, 0 far from what slips."""
    margin: SurfacePressure
    """r."""

    @property
    def at_vertices(self) -> Floats:
        """At vertices, but for what free edges change, ``(num_vertices, n)``."""
        return self.q

    @property
    def near(self) -> Mask:
        """Facets near free edges, ``(num_facets,)``."""
        return self.pressure.near | self.margin.near

    def on(self, facets: npt.NDArray[np.intp], X: Floats) -> Floats:
        """Tractions at the same reference points X, ``(num_facets, num_points, n)``."""
        p, r = self.pressure, self.margin
        full = self.q + r.p[:, None] * self.way
        ways = hats(r.surface, X) @ self.way[r.surface.facets[facets]]
        beside = p.times(full, p.ratios(full), facets, X) - r.on(facets, X)[..., None] * ways
        away = p.times(self.q, p.ratios(self.q), facets, X)
        return np.where(r.near[facets, None, None], beside, away)

    def cells(self) -> "list[tuple[npt.NDArray[np.intp], Floats]]":
        """Facets and simplices on them, as those of a pressure."""
        return _cells(self.pressure.surface, self.pressure.steep | self.margin.steep)


def directions(surface: Surface, q: Floats, slips: Mask) -> Floats:
    """Unit directions of slip, also beside what slips, ``(num_vertices, n)``; 0 far from it.

    All are 0 if some meet opposite ones: μp − q·t isn't smooth there.

    Args:
        surface: The surface.
        q: Tractions of friction, likewise.
        slips: Vertices that slip, ``(num_vertices,)``.
    """
    ways = continued(surface, q, slips, 2 * (_rings(surface) + 2))
    first, last = ways[surface.facets[:, 0]], ways[surface.facets[:, -1]]
    if ((first * last).sum(axis=1) < 0).any():
        return 0 * ways
    return ways / np.maximum(lengths(ways), 1e-300)[:, None]


def continued(surface: Surface, values: Floats, known: Mask, rings: int) -> Floats:
    """Values at vertices in some rings of facets around known ones: means of neighbours'.

    Args:
        surface: The surface.
        values: Values, ``(num_vertices, num)``.
        known: Where they are known, ``(num_vertices,)``.
        rings: Number of rings.
    """
    values, facets = np.where(known[:, None], values, 0), surface.facets
    for _ in range(rings):
        count, total = np.zeros(len(values)), np.zeros_like(values)
        on = known[facets]
        np.add.at(count, facets, on.sum(axis=1)[:, None])
        np.add.at(total, facets, (values[facets] * on[..., None]).sum(axis=1)[:, None])
        new = ~known & (count > 0)
        values[new] = total[new] / count[new, None]
        known = known | new
    return values


def _cells(surface: Surface, steep: Mask) -> "list[tuple[npt.NDArray[np.intp], Floats]]":
    """Facets and simplices on them; arguments: the surface, and the facets drawn finely."""
    kind = surface.geometry.cell_type
    parts = PARTS_ROOT[surface.gdim - 2]
    given = ((~steep, 1), (steep, parts))
    return [(np.flatnonzero(on), simplices(kind, num)) for on, num in given]


def hats(surface: Surface, X: Floats) -> Floats:
    """Linear functions of a facet's vertices at reference points, ``(num_points, num_corners)``."""
    return tabulate(basix.create_element(basix.ElementFamily.P, surface.geometry.cell_type, 1), X)


@cache
def simplices(cell_type: basix.CellType, num: int) -> Floats:
    """Simplices that fill a reference facet, ``num`` along an edge, ``(…, dim + 1, dim)``."""
    if cell_type == basix.CellType.interval:
        x = np.linspace(0, 1, num + 1)
        return np.stack((x[:-1], x[1:]), axis=1)[..., None]
    i, j = np.indices((num, num)).reshape(2, -1)
    lower = np.stack(((i, j), (i + 1, j), (i, j + 1)))
    upper = np.stack(((i + 1, j), (i + 1, j + 1), (i, j + 1)))
    found = np.concatenate((lower, upper), axis=2)  # (corner, coordinate, triangle)
    if cell_type == basix.CellType.triangle:
        found = found[:, :, found.sum(axis=1).max(axis=0) <= num]
    return np.moveaxis(found, 2, 0) / num


def _rings(surface: Surface) -> int:
    """Facets beside those with a free edge on which pressure has a root, as Γ1 is split."""
    return RINGS_ROOT[surface.gdim - 2] * surface.num_parts


def _prepared(
    state: ContactState, smooth: Mask | None = None
) -> "tuple[Mask, Mask, _RootFit | None]":
    """What there is to fit.

    Args:
        state: The contact.
        smooth: Facets with an edge to which gaps say that pressure falls, ``(num_facets,)``; None:
            none is known.

    Returns:
        Facets with an edge to which pressures at vertices rise, facets near free edges,
        ``(num_facets,)`` each, and the fit of a root, if there is one.
    """
    rooted, inner, rising = _near_free_edges(state, smooth)
    steep = rooted[state.surface.facets].any(axis=1)
    mean, part = _parts(state, steep)
    falls = np.isin(part, part[state.vertices[inner]])
    cut = steep & ~np.asarray(state.covered) & (state.p[state.surface.facets] > 0).any(axis=1)
    falls &= ~np.isin(part, part[state.side.at_facets[cut]])  # forces are no integrals over facets
    rooted &= (falls & (mean > 0))[state.vertices]  # not in a part that touches without load
    near = rooted[state.surface.facets].any(axis=1)
    return rising, steep, _RootFit(state, rooted, near, mean, part) if rooted.any() else None


def _near_free_edges(state: ContactState, smooth: Mask | None = None) -> tuple[Mask, Mask, Mask]:
    """Vertices near free edges of contact.

    Args:
        state: The contact.
        smooth: As that of :func:`_prepared`.

    Returns:
        Those where pressure has a root, and active vertices that aren't at an edge,
        ``(num_vertices,)`` each; facets with an edge to which pressures rise, ``(num_facets,)``.
    """
    facets, active = state.surface.facets, state.active
    on = active[facets]
    apart = np.zeros(len(active), dtype=bool)  # not only a hole of one vertex in the contact
    apart[facets[~on.any(axis=1)]] = True
    ends = on.any(axis=1) & (state.exists & apart)[facets].any(axis=1) & state.covered
    last = np.zeros(len(active), dtype=bool)
    last[facets[ends]] = True
    last &= active
    # Mean pressure of the active vertices beside the last ones, 0 where there are none
    inner = (active & ~last)[facets]
    count, total = np.zeros((2, len(active)))
    np.add.at(count, facets, inner.sum(axis=1)[:, None])
    np.add.at(total, facets, (state.p[facets] * inner).sum(axis=1)[:, None])
    some = (last & (count > 0))[facets] & ends[:, None]
    beside = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    rising = ends & ((np.where(some, state.p[facets] - beside[facets], 0)).sum(axis=1) > 0)
    corners = rising if smooth is None else rising & ~smooth
    near, singular = np.zeros((2, len(active)), dtype=bool)
    near[facets[ends & ~corners]] = True
    singular[facets[corners]] = True
    for _ in range(_rings(state.surface)):
        near[facets[near[facets].any(axis=1)]] = True
    return near & ~singular, active & ~last, rising


class _RootFit:
    """Least squares for s at the vertices near free edges."""

    def __init__(self, state: ContactState, free: Mask, near: Mask, mean: Floats, part: Integers):
        """Set up quadrature, moments and jumps.

        Args:
            state: The contact.
            free: Vertices at which s is sought, ``(num_vertices,)``.
            near: Facets with any of these, ``(num_facets,)``.
            mean: Largest pressure on a dof's part of these facets, ``(num_dofs,)``.
            part: Number of the part, ``(num_dofs,)``.
        """
        self.state, self.free = state, free
        surface, side = state.surface, state.side
        self.facets = np.flatnonzero(near)
        dofs = np.zeros(len(side.dofs), dtype=bool)
        dofs[side.at_facets[self.facets]] = True
        around = np.flatnonzero(dofs[side.at_facets].any(axis=1))
        corners = simplices(surface.geometry.cell_type, PARTS_ROOT[surface.gdim - 2])
        X = corners.mean(axis=1)
        self.hats = hats(surface, X)
        functions = surface.functions(X)[around % surface.num_parts]  # (facet, point, dof)
        normals = _normals(surface, around, X) / len(X)
        normals *= surface.arc(_points(surface, around, X))[..., None]
        if surface.geometry.cell_type == basix.CellType.triangle:
            normals *= 0.5
        at, sizes = side.at_facets[around], lengths(normals.reshape(-1, surface.gdim))
        sizes = sizes.reshape(normals.shape[:2])
        along, scale = np.zeros_like(state.forces), np.zeros(len(side.dofs))
        np.add.at(along, at, np.einsum("fqd,fqi->fdi", np.abs(functions), normals))
        np.add.at(scale, at, np.einsum("fqd,fq->fd", np.abs(functions), sizes))
        along /= np.maximum(lengths(along), 1e-300)[:, None]
        # ∫ φ_j p over facets, of p at their points
        self.moments = np.einsum("fqd,fqi,fdi->fqd", functions, normals, along[at])
        self.mean = np.where(free, mean[state.vertices], 1)
        rest = -np.einsum("ji,ji->j", state.forces, along)
        own = near[around]
        linear = state.p[surface.facets[around[~own]]] @ self.hats.T
        np.add.at(rest, at[~own], -np.einsum("fqd,fq->fd", self.moments[~own], linear))
        self.moments, self.at, self.rest = self.moments[own], at[own], rest
        self.totals = len(self.facets) + part  # rows of sums, for each dof
        self.sums = self._sums(scale * mean)
        jumps = self._jumps()
        roots = self._roots() if surface.gdim == 2 else Sparse.empty()
        first = self.sums.i.max() + 1
        after = first + jumps.i.max(initial=-1) + 1
        i = np.append(first + jumps.i, after + roots.i)
        self.jumps = replace(joined(jumps, roots), i=i).summed
        self.opening, self.target = Sparse.empty(), np.zeros(len(free))  # rows of s - target

    def _sums(self, scale: Floats) -> Sparse:
        """Sums of forces over facets and over parts of the region, over their sizes.

        Args:
            scale: Sizes of forces, zero where no pressure is sought, ``(num_dofs,)``.
        """
        surface, every, at = self.state.surface, np.flatnonzero(scale), self.at
        if surface.num_parts > 1:  # a facet with two of an edge's three dofs
            at = self.state.vertices[surface.facets[self.facets]]
        i = np.append(np.repeat(np.arange(len(at)), at.shape[1]), self.totals[every])
        j = np.append(at.ravel(), every)
        weight = np.where(i < len(at), 1, TOTAL_ROOT) / np.bincount(i, scale[j])[i]
        return Sparse(i, j, weight)

    def _roots(self) -> Sparse:
        """Values of s where gaps say that contact ends, in the plane."""
        vertices, share = edges_by_gaps(self.state)
        v, w = vertices[:, self.free[vertices[0]]]
        share = share[self.free[vertices[0]]]
        values = np.append(1 - share, share) / np.tile(self.mean[v] ** 2, 2)
        return Sparse(np.tile(np.arange(len(v)), 2), np.append(v, w), values)

    def _jumps(self) -> Sparse:
        """Jumps of slopes of s over edges at free vertices, times sizes and factors."""
        surface, free = self.state.surface, self.free
        D = slope_jumps(surface, self.facets)
        touched, unknown = np.zeros((2, D.i.max(initial=-1) + 1), dtype=bool)
        touched[D.i[free[D.j]]] = True
        unknown[D.i[~free[D.j] & ~self.state.active[D.j]]] = True  # s isn't known there
        touched &= ~unknown
        mean = np.zeros(len(touched))
        np.maximum.at(mean, D.i, np.where(free, self.mean, 0)[D.j])
        use, (smooth, _) = touched[D.i], SMOOTH_ROOT[surface.gdim - 2]
        return Sparse(
            D.i[use],
            D.j[use],
            smooth * D.values[use] / mean[D.i[use]] ** 2,
        )

    def is_met(self, s: Floats, missed: float) -> Mask:
        """Mask of facets with roots in whose part the forces are met, ``(num_facets,)``.

        Args:
            s: Found at vertices.
            missed: Error that is too large.
        """
        error, _ = self._errors(s)
        num = len(self.facets)
        part = self.totals[self.at[:, 0]] - num
        square, count = np.bincount(part, error[:num] ** 2), np.maximum(np.bincount(part), 1)
        return (square / count <= missed**2)[part]

    def _errors(self, s: Floats) -> tuple[Floats, Sparse]:
        """Weighted errors, and their derivatives by s over squares of mean pressures."""
        corners = self.state.surface.facets[self.facets]
        values = s[corners] @ self.hats.T  # (facet, point)
        p = np.sqrt(np.maximum(values, 0))
        error, at = -self.rest, self.at
        np.add.at(error, at, np.einsum("fqd,fq->fd", self.moments, p))
        slope = np.divide(0.5, p, out=np.zeros_like(p), where=p > 0)
        by = np.einsum("fqd,fq,qv->fdv", self.moments, slope, self.hats)
        i = np.broadcast_to(at[:, :, None], by.shape).ravel()
        j = np.broadcast_to(corners[:, None], by.shape).ravel()
        J = self.sums @ Sparse(i, j.astype(np.int64), by.ravel())
        linear = joined(self.jumps, self.opening)
        every = joined(J, linear).some(self.free[np.append(J.j, linear.j)])
        of_s = np.append(s[self.jumps.j], (s - self.target)[self.opening.j])
        values = np.append(self.sums.values * error[self.sums.j], linear.values * of_s)
        error = np.bincount(np.append(self.sums.i, linear.i), values)
        return error, replace(every, values=every.values * self.mean[every.j] ** 2)

    def _continued(self, s: Floats) -> Floats:
        """Values of s with slopes that go on beyond the edge: from s = 0 no step finds its sign."""
        jumps, size = self.jumps, self.mean**2
        left = np.bincount(jumps.i, jumps.values * s[jumps.j])
        scaled = replace(jumps, values=jumps.values * size[jumps.j])
        return s - size * self._least(scaled, left, self.free & ~self.state.active, 0.0)

    def _least(self, J: Sparse, error: Floats, free: Mask, damping: float) -> Floats:
        """Solve for x with (JᵀJ + damping · its diagonal) x = Jᵀ error, on each rank by itself.

        The row of a part's total force makes its JᵀJ dense. It is left out, and added to the
        solution by the formula of Sherman and Morrison, for all parts at once.

        Args:
            J: Without duplicates, ``(num_errors, num_vertices)``.
            error: ``(num_errors,)``.
            free: Where x may differ from zero, ``(num_vertices,)``.
            damping: Factor of the diagonal.
        """
        every, number = np.arange(free.sum()), np.cumsum(free) - 1
        J = J.some(free[J.j])
        J, num, result = replace(J, j=number[J.j]), len(every), np.zeros(len(free))
        if not num:
            return result
        diagonal = np.bincount(J.j, J.values**2, num)
        b = np.bincount(J.j, J.values * error[J.i], num)
        row = self.totals[self.state.vertices[free]]
        long = J.i == row[J.j]
        total, J = J.some(long), J.some(~long)
        more = Sparse(every, every, damping * diagonal + 1e-12 * diagonal.max(initial=1))
        v = np.bincount(total.j, total.values, num)
        y, w = _solved(joined(J.T @ J, more), np.stack((b, v)))
        of_y, of_w = (np.bincount(row, v * x)[row] for x in (y, w))
        result[free] = y - w * of_y / (1 + of_w)
        return result

    def solve(self, s: Floats) -> Floats:
        """Find s at all vertices, first without gaps' law, of which slopes of s are a part.

        Beside corners p may be zero where there is contact: s isn't linear there, as the law has
        it, and is found without it.

        Args:
            s: p² at vertices, ``(num_vertices,)``.
        """
        s, active = self._best(self._continued(s)), self.state.active & self.free
        if not self.state.compliance:
            return s
        opening = _Opening(self.state, self.free & ~self._parts_with(active & (s <= 0)))
        w = opening.w
        if len(w):
            alone, first = s, 1 + max(part.i.max(initial=-1) for part in (self.sums, self.jumps))
            self.opening = Sparse(first + np.arange(len(w)), w, opening.share / self.mean[w] ** 2)
            smooth, less = SMOOTH_ROOT[self.state.surface.gdim - 2]
            self.jumps = replace(self.jumps, values=less / smooth * self.jumps.values)
            for _ in range(3):  # steeper slopes give steeper targets: until they stay is too steep
                self.target[w] = opening.values(s)
                s = self._best(s)
            with_law = self._parts_with(w) & ~self._parts_with(active & (s <= 0))
            s = np.where(with_law, s, alone)
        return s

    def opens_smoothly(self, s: Floats) -> Mask:
        """Mask of facets beyond whose edges gaps are as small as beside a root, ``(num_facets,)``.

        Where displacements on facets are linear, gaps don't tell.

        Args:
            s: p² at vertices.
        """
        opening = _Opening(self.state, self.free)
        known, steeper = np.zeros((2, len(s)), dtype=bool)
        known[opening.w] = True
        steeper[opening.w] = opening.is_steeper(self._best(self._continued(s)))
        facets = self.state.surface.facets
        return known[facets].any(axis=1) & ~steeper[facets].any(axis=1)

    def _parts_with(self, some: Mask | npt.NDArray[np.intp]) -> Mask:
        """Mask of the vertices in parts with any of some vertices, ``(num_vertices,)``."""
        part = self.totals[self.state.vertices]
        return np.isin(part, part[some])

    def _best(self, s: Floats) -> Floats:
        """Find s at all vertices from one, by the method of Levenberg and Marquardt."""
        error, J = self._errors(s)
        damping, least = 1e-3, error @ error
        for _ in range(STEPS_ROOT):
            step = self.mean**2 * self._least(J, error, self.free, damping)
            new, new_J = self._errors(s - step)
            if new @ new < least:
                done = least - new @ new < 1e-6 * least
                s, error, J, least = s - step, new, new_J, new @ new
                damping /= 5
                if done:
                    break
            else:
                damping *= 5
        return s


class _Opening:
    r"""What gaps of open vertices beside an edge say of s.

    Where :math:`p = \sqrt{k d}`, bodies open beyond the edge by :math:`g = \frac{4}{3 E^*}
    \sqrt{k}\,d^{3/2}` (the same root of s < 0 is E*/2 times g's slope), with d the distance
    from it. So a mean gap gives d, and s there is -k d.
    """

    def __init__(self, state: ContactState, free: Mask):
        """Set up means over hat functions; arguments as those of :class:`_RootFit`."""
        self.state, surface = state, state.surface
        facets, active = surface.facets, state.active
        on = active[facets]
        beside = np.zeros(len(active), dtype=bool)
        beside[facets[on.any(axis=1)]] = True
        self.w = np.flatnonzero(beside & ~active & state.exists & free & (state.gaps > 0))
        """The vertices."""
        number = np.full(len(active), -1)
        number[self.w] = np.arange(len(self.w))
        num = len(self.w)
        # Means of points of facets
        at, corner = np.nonzero(number[facets] >= 0)
        self.i = number[facets[at, corner]]
        X = simplices(surface.geometry.cell_type, PARTS_ROOT[surface.gdim - 2]).mean(axis=1)
        N = hats(surface, X)
        weight = N[:, corner].T * np.linalg.norm(_normals(surface, at, X), axis=2)
        weight *= surface.arc(_points(surface, at, X))
        self.weight = weight / np.bincount(self.i, weight.sum(axis=1), num)[self.i, None]
        edge = on.any(axis=1)
        self.share = np.bincount(self.i, self.weight.sum(axis=1) * edge[at], num)
        """Of a mean, that of facets with an edge."""
        x = np.einsum("qv,fvi->fqi", N, surface.x[facets[at]])
        self.x = x - surface.x[facets[at, corner], None]
        # Gradients of facets with an edge, and ways to active vertices
        edge &= (number[facets] >= 0).any(axis=1)
        self.edge, self.gradients = facets[edge], _gradients(surface, np.flatnonzero(edge))
        at, corner = np.nonzero(number[self.edge] >= 0)
        self.at, self.of = at, number[self.edge[at, corner]]
        self.ways = surface.x[self.edge[at, corner], None] - surface.x[self.edge[at]]
        self.inside = active[self.edge[at]]

    def _line(self, s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """The line by which s goes on beyond an edge.

        Args:
            s: At vertices, for its slopes.

        Returns:
            Slopes k and distances of the farthest active vertices, ``(num,)``, distances of the
            means' points from the open vertices, along the line, ``(num_facets, num_points)``, and
            the means of d^1.5 that gaps have, ``(num,)``.
        """
        num = len(self.w)
        slope = np.zeros((num, self.state.surface.gdim))
        np.add.at(slope, self.of, np.einsum("fv,fvi->fi", s[self.edge], self.gradients)[self.at])
        slope /= np.bincount(self.of, minlength=num)[:, None]
        k = np.maximum(lengths(slope), 1e-300)
        out = -slope / k[:, None]
        reach = np.where(self.inside, np.einsum("fvi,fi->fv", self.ways, out[self.of]), 0)
        farthest = np.zeros(num)
        np.maximum.at(farthest, self.of, reach.max(axis=1))
        along = np.einsum("fqi,fi->fq", self.x, out[self.i])
        root = self.state.gaps[self.w] / (4 / 3 * self.state.compliance * np.sqrt(k))
        return k, farthest, along, root

    def _means(self, d: Floats, along: Floats) -> Floats:
        """Means of d^1.5 over hat functions, of open vertices' distances d from the edge."""
        powers = np.maximum(d[self.i, None] + along, 0) ** 1.5
        return np.bincount(self.i, (self.weight * powers).sum(axis=1), len(d))

    def is_steeper(self, s: Floats) -> Mask:
        """Mask of open vertices whose gaps are larger than the law's from the last active one.

        They are beside a corner, unless pressures are as large as E* times its angle.

        Args:
            s: As that of :meth:`values`.
        """
        _, farthest, along, root = self._line(s)
        return self._means(farthest, along) < root

    def values(self, s: Floats) -> Floats:
        """Find s at the vertices; arguments: s, ``(num_vertices,)``, for its slopes."""
        k, high, along, root = self._line(s)
        low = np.zeros_like(high)
        for _ in range(40):
            middle = (low + high) / 2
            nearer = self._means(middle, along) > root
            low, high = np.where(nearer, low, middle), np.where(nearer, middle, high)
        return -k * low


def bends(side: MovingSurface) -> bool:
    """Whether displacements on facets aren't linear: these can't follow gaps like d^1.5."""
    return side.at_facets.shape[1] > side.reference.gdim


def compliance(side: MovingSurface, forces: Floats) -> float:
    """1/E* of a half-space of a body's material in plane strain, 0 if there is none.

    A uniform displacement gradient gives at each dof the traction that belongs to it, times the
    integral of the dof's function. Most dofs have no neighbour that is prescribed.

    Args:
        side: The body's surface.
        forces: At its dofs by e_b x_a, ``(num_dofs, n, b, a)``.
    """
    surface = side.rest
    X, weights = basix.make_quadrature(surface.geometry.cell_type, 4)
    every = np.arange(len(surface.facets))
    area = _normals(surface, every, X) * weights[:, None]
    area *= surface.arc(_points(surface, every, X))[..., None]
    functions = surface.functions(X)[every % surface.num_parts]
    normals, whole = np.zeros((2, len(side.dofs), surface.gdim))
    np.add.at(normals, side.at_facets, np.einsum("fqd,fqi->fdi", functions, area))
    np.add.at(whole, side.at_facets, np.einsum("fqd,fqi->fdi", np.abs(functions), area))
    size = lengths(normals)
    use = size > 0.1 * lengths(whole)  # vertices of triangles of degree 2 have none
    n, forces = normals[use] / size[use, None], forces[use] / size[use, None, None, None]
    along = np.einsum("jiba,ji,jb,ja->j", forces, n, n, n)  # λ + 2μ
    across = (np.einsum("jiia,ja->j", forces, n) - along) / (surface.gdim - 1)
    P, mu = np.median(along), np.median(across)
    return float(P / (4 * mu * (P - mu))) if 0 < mu < P else 0.0


def edges_by_gaps(state: ContactState) -> tuple[npt.NDArray[np.intp], Floats]:
    """Where contact ends by the first two gaps beyond, in the plane.

    Returns:
        Active vertices and the open ones beside them, ``(2, num)``, and how far from the first to
        the second contact ends, ``(num,)``.
    """
    surface, active, gaps = state.surface, state.active, state.gaps
    vertices, shares = [], []
    for ends in (surface.facets, surface.facets[:, ::-1]):
        after = np.full(len(active) + 1, -1)  # the last one for those that have none
        after[ends[:, 0]] = ends[:, 1]
        chain = [np.flatnonzero(active)]
        for _ in range(3):
            chain.append(after[chain[-1]])
        v, w, x, y = chain
        use = (y >= 0) & ~active[w] & ~active[x] & state.exists[w] & state.exists[x]
        use &= gaps[x] > 0  # else nothing is known
        v, w, x, y = np.stack(chain)[:, use]
        steps = [lengths(surface.x[b] - surface.x[a]) for a, b in ((v, w), (w, x), (x, y))]
        at = np.cumsum([np.zeros(len(v)), *steps], axis=0)
        low, high = at[0], at[1]
        for _ in range(40):
            middle = (low + high) / 2
            of_w, of_x = _mean_gaps(at, middle)
            before = of_w * gaps[x] > gaps[w] * of_x
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        vertices.append(np.stack((v, w)))
        shares.append(low / at[1])
    return np.concatenate(vertices, axis=1), np.concatenate(shares)


def _mean_gaps(at: Floats, edge: Floats) -> Floats:
    """Means over hat functions of gaps like d^1.5, but for a factor, ``(num_nodes - 2, num)``.

    Args:
        at: Nodes in the order of distance, ``(num_nodes, num)``.
        edge: Where gaps begin, ``(num,)``.
    """
    slopes = np.diff(np.maximum(at - edge, 0) ** 3.5, axis=0) / np.diff(at, axis=0)
    return np.diff(slopes, axis=0) / (at[2:] - at[:-2])


def _parts(state: ContactState, near: Mask) -> tuple[Floats, Integers]:
    """Parts of a region of facets, which have no dofs in common.

    Args:
        state: The contact.
        near: Facets of the region, ``(num_facets,)``.

    Returns:
        Largest pressure on a dof's part, 0 outside of the region, and its number, ``(num_dofs,)``.
    """
    at, p = state.side.at_facets[near], state.p[state.surface.facets[near]]
    first = np.repeat(at[:, 0], at.shape[1] - 1)
    part = components(len(state.side.dofs), first, at[:, 1:].ravel())
    most = np.zeros(part.max() + 1)
    np.maximum.at(most, part[at[:, 0]], p.max(axis=1))
    return most[part], part.astype(np.int64)


def _normals(surface: Surface, facets, X: Floats) -> Floats:
    """Normals as long as areas for the reference coordinates, ``(num_facets, num_points, n)``."""
    T = _tangents(surface, facets, X)
    if surface.gdim == 2:
        return np.stack((T[0, ..., 1], -T[0, ..., 0]), axis=-1)
    return np.cross(T[0], T[1])


def _points(surface: Surface, facets, X: Floats) -> Floats:
    """Points at the same reference points X of some facets, ``(num_facets, num_points, n)``."""
    return np.einsum("qm,fmi->fqi", tabulate(surface.geometry, X), surface.nodes_of(facets))


def _tangents(surface: Surface, facets, X: Floats) -> Floats:
    """Derivatives of points by reference coordinates, ``(dim, num_facets, num_points, n)``."""
    table = surface.geometry.tabulate(1, X)[1:, :, :, 0]
    return np.einsum("kqm,fmi->kfqi", table, surface.nodes_of(facets))


def _gradients(surface: Surface, facets: npt.NDArray[np.intp]) -> Floats:
    """Slopes of facets' linear functions in their middles, ``(num_facets, num_corners, n)``."""
    kind = surface.geometry.cell_type
    middle = basix.geometry(kind).mean(axis=0)[None]
    T = _tangents(surface, facets, middle)[:, :, 0]  # (dim, facet, n)
    metric = np.einsum("kfi,lfi->fkl", T, T)
    first = basix.create_element(basix.ElementFamily.P, kind, 1)
    slopes = first.tabulate(1, middle)[1:, 0, :, 0]  # (dim, corner)
    slopes = np.linalg.solve(metric, np.broadcast_to(slopes, (len(facets), *slopes.shape)))
    return np.einsum("kfi,fkv->fvi", T, slopes)


def slope_jumps(surface: Surface, facets: npt.NDArray[np.intp]) -> Sparse:
    """Jumps of slopes across edges between facets, times the distance of their middles.

    Edges are vertices in the plane. On quadrilaterals also a row of each one's twist: slopes in the
    middle of edges don't see it.

    Args:
        surface: The surface.
        facets: Its facets of which edges count if both beside them are among these.

    Returns:
        Jumps by values at vertices, ``(num_jumps, num_vertices)``.
    """
    kind = surface.geometry.cell_type
    corners = basix.geometry(kind)
    first = basix.create_element(basix.ElementFamily.P, kind, 1)
    edges = surface.edge_numbers[facets]
    number, count = np.unique(edges, return_inverse=True, return_counts=True)[1:]
    number = number.reshape(edges.shape)
    ring = around_corners(len(corners))
    sides = len(ring) if surface.gdim == 3 else 2
    middle = surface.points(facets, np.tile(corners.mean(axis=0), (len(facets), 1)))
    rows, columns, values = [], [], []
    for k in range(sides):
        pair = [ring[k], ring[(k + 1) % sides]] if surface.gdim == 3 else [k]
        at = corners[pair].mean(axis=0)[None]
        T = _tangents(surface, facets, at)[:, :, 0]  # (dim, facet, n)
        metric = np.einsum("kfi,lfi->fkl", T, T)
        away = surface.points(facets, np.tile(at, (len(facets), 1))) - middle
        out = np.linalg.solve(metric, np.einsum("kfi,fi->fk", T, away)[..., None])[..., 0]
        if surface.gdim == 3:  # across the edge
            along = corners[pair[1]] - corners[pair[0]]
            part = np.einsum("fk,fkl,l->f", out, metric, along)
            out = out - (part / np.einsum("k,fkl,l->f", along, metric, along))[:, None] * along
        size = np.sqrt(np.einsum("fk,fkl,fl->f", out, metric, out))[:, None]
        slopes = out @ first.tabulate(1, at)[1:, 0, :, 0] / size  # (facet, corner)
        distance = np.bincount(number[:, k], size[:, 0], len(count))
        rows.append(np.repeat(number[:, k], len(corners)))
        columns.append(surface.facets[facets].ravel())
        values.append((slopes, distance))
    size = np.sum([distance for _, distance in values], axis=0)
    shared = count[np.concatenate(rows)] == 2
    flat = np.concatenate([slopes.ravel() for slopes, _ in values])
    i, j = np.concatenate(rows), np.concatenate(columns).astype(np.int64)
    found = Sparse(i[shared], j[shared], (flat * size[i])[shared])
    if kind != basix.CellType.quadrilateral:
        return found
    twist = np.broadcast_to([1.0, -1.0, -1.0, 1.0], (len(facets), 4))
    i = np.repeat(len(count) + np.arange(len(facets)), 4)
    return joined(found, Sparse(i, surface.facets[facets].ravel().astype(np.int64), twist.ravel()))


def around_corners(num: int) -> Sequence[int]:
    """Vertices of a reference facet in cyclic order."""
    return [0, 1, 3, 2] if num == 4 else list(range(num))


def _solved(A: Sparse, b: Floats) -> Floats:
    """Solutions of A x = b for some b, ``(num_b, num)``, on each rank by itself."""
    A = A.summed
    order = np.lexsort((A.j, A.i))
    starts = np.searchsorted(A.i[order], np.arange(b.shape[1] + 1)).astype(PETSc.IntType)
    csr = starts, A.j[order].astype(PETSc.IntType), A.values[order]
    matrix = PETSc.Mat().createAIJ((b.shape[1],) * 2, csr=csr, comm=PETSc.COMM_SELF)
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.setOperators(matrix)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    right, x = matrix.createVecs()
    found = np.empty(b.shape)
    for k, given in enumerate(b):
        right.array[:] = given
        ksp.solve(right, x)
        found[k] = x.array.real
    for part in (ksp, matrix, right, x):
        part.destroy()
    return found
