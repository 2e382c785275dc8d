# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Which multipliers of a contact act: the active set of a semi-smooth Newton. NumPy alone.

Where bodies that only contact holds come to rest, as rigid ones. NumPy alone.
"""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import (
    COVERED_AREA,
    DIGITS_SETS,
    GAP_ZERO,
    HOLDS,
    PIVOTS,
    REST,
)


def resting(holds, load, distance) -> npt.NDArray[np.intp]:
    """On what rigid bodies rest to which a load is applied, once they have moved there.

    They go where the load does the most work while no gap closes to less than nothing: a linear
    program. Solved is its dual, by the simplex method: of all pressures that balance the load those
    that do the least work in the gaps.

    Args:
        holds: What a pressure does along each motion, ``(num, num_motions)``.
        load: What balances it there, ``(num_motions,)``.
        distance: Gaps, with the pressures' weights, ``(num,)``; none is negative.

    Returns:
        Which have a pressure; none if no pressures balance the load.
    """
    num, k = holds.shape
    scale = np.abs(holds).max(axis=0, initial=0)
    none = np.empty(0, dtype=np.intp)
    if not num or not load.any() or not scale.all():
        return none
    b = load / scale / np.abs(load / scale).max()
    A = np.hstack(((holds / scale).T, np.diag(np.where(b < 0, -1.0, 1.0))))
    A[:, :num] /= np.abs(A[:, :num]).max()
    cost = np.zeros((2, num + k))  # first that of what balances nothing
    cost[0, num:], cost[1, :num] = 1, distance / max(distance.max(), 1e-300)
    basis = np.arange(num, num + k)
    for _ in range(PIVOTS * k):
        inverse = np.linalg.inv(A[:, basis])
        x = inverse @ b
        lost, work = cost - cost[:, basis] @ inverse @ A
        lost[np.abs(lost) <= GAP_ZERO] = 0
        work = np.where(lost == 0, work, 0)
        enters = lost.argmin() if lost.min() < 0 else work.argmin()
        if lost[enters] >= 0 and work[enters] >= -GAP_ZERO:
            break
        falls = inverse @ A[:, enters]
        ways = np.full(k, np.inf)
        np.divide(x, falls, ways, where=falls > GAP_ZERO)
        if not np.isfinite(ways.min()):
            break
        basis[ways.argmin()] = enters
    acts = basis[x > GAP_ZERO]
    return none if (acts >= num).any() else acts


def covered(m: npt.NDArray, area: npt.NDArray) -> npt.NDArray[np.bool_]:
    """Multipliers with enough of an area to have a pressure.

    Args:
        m: Areas of the weights, ``(num,)``.
        area: Areas of Γ1 that the vertices stand for, ``(num,)``.
    """
    return m > COVERED_AREA * area


def sources(come, lasting, on, facets) -> npt.NDArray[np.intp]:
    """Vertices whose tractions new multipliers begin with, -1 if there are none.

    Args:
        come: The new ones, ``(num,)``.
        lasting: Which others there are, ``(num,)``.
        on: The active set, in which all of these beside a new one must be, ``(num,)``.
        facets: Vertices of Γ1's facets, ``(num_facets, num_facet_vertices)``.
    """
    result = np.full(len(come), -1)
    i, j = _pairs(facets[come[facets].any(axis=1)])
    use = come[i] & lasting[j]
    result[i[use]] = j[use]
    result[i[use & ~on[j]]] = -1
    return result


def beside(come, lasting, facets) -> npt.NDArray[np.bool_]:
    """New multipliers, and those beside them that there were, ``(num,)``.

    Args:
        come: The new ones, ``(num,)``.
        lasting: Which others there are, ``(num,)``.
        facets: As for :func:`sources`.
    """
    result = come.copy()
    i, j = _pairs(facets[come[facets].any(axis=1)])
    result[j[come[i] & lasting[j]]] = True
    return result


def _pairs(facets) -> npt.NDArray[np.intp]:
    """Vertices of the same facets, both ways and also with themselves, ``(2, num_pairs)``."""
    k = facets.shape[1]
    return np.stack((np.repeat(facets, k, 1).ravel(), np.tile(facets, k).ravel()))


def pushing(p, g, m, valid, stiffness, on, none: float) -> npt.NDArray[np.bool_]:
    """P − c g/m > 0: closed or overlapping, and not pulling; what is at both limits stays.

    Args:
        p: Pressures, ``(num,)``.
        g: Weighted gaps, ``(num,)``.
        m: Areas of the weights, ``(num,)``.
        valid: Which multipliers there are, ``(num,)``.
        stiffness: c, of the size of a modulus over the size of a cell; a number or ``(num,)``.
        on: The set so far, ``(num,)``.
        none: Pressure that is none.
    """
    gap = np.divide(g, m, out=np.zeros_like(g), where=valid)
    return valid & (p - stiffness * gap > np.where(on, -none, none))


def without_pull_on_surface(before, now, facets, force) -> npt.NDArray[np.bool_]:
    """As :func:`without_pull`, on a surface: a zone's pull goes inwards ring by ring.

    What each vertex that is lost pulls is shared by its neighbours farther inside; one of which the
    force is less is lost too, and hands on what is left.

    Args:
        before: The last set, ``(num,)``.
        now: Those that remain, and new ones, ``(num,)``.
        facets: Vertices of Γ1's facets, ``(num_facets, num_facet_vertices)``.
        force: Pressures times areas, ``(num,)``.

    Returns:
        ``(num,)``.
    """
    num = len(before)
    pairs = np.unique(
        np.repeat(facets, facets.shape[1], 1) * num + np.tile(facets, facets.shape[1])
    )
    i, j = np.divmod(pairs.astype(np.int64), num)
    lost, zone = before & ~now, ~before
    while True:  # from the edge of the last set: a hole in it is scatter
        grown = zone.copy()
        grown[j[zone[i] & lost[j]]] = True
        if (grown == zone).all():
            break
        zone = grown
    front = lost & zone
    result, done = now.copy(), zone | front
    pull = np.where(front, np.maximum(-force, 0), 0)
    while front.any():
        on = front[i] & before[j] & now[j] & ~done[j]
        share = pull / np.maximum(np.bincount(i[on], minlength=num), 1)
        got = np.bincount(j[on], share[i[on]], num)
        front = np.zeros(num, dtype=bool)
        front[j[on]] = True
        done |= front
        front &= got > force
        result[front] = False
        pull = np.where(front, got - force, 0)
    return result


def as_near(before, now, distance, force, none: float, *, plane: bool) -> npt.NDArray[np.bool_]:
    """As :func:`without_pull`, where bodies come into contact: what was nearest stays.

    A set that is much too large pulls at its edge, and scatters all over. Ordered by how far apart
    things were, what pulls and what balances it are the outer ones; from a level on the rest has
    the whole force. Of two spheres that level is at r² = a³/b, a the radius that is looked for, b
    the set's; hence :data:`REST`. Of two cylinders pressures change their sign at 2x² = a² + b².

    Args:
        before: The last set, ``(num,)``.
        now: Those that remain, and new ones, ``(num,)``.
        distance: Gaps over areas before anything touched, ``(num,)``; infinite where there was
            none.
        force: Pressures times areas, ``(num,)``.
        none: Difference of distances that is none.
        plane: Whether bodies are in the plane.

    Returns:
        ``(num,)``.
    """
    known = np.isfinite(distance)
    order = np.flatnonzero(before & known)
    order = order[np.argsort(-distance[order], kind="stable")]
    outer = np.cumsum(force[order])
    balanced = np.flatnonzero(outer >= 0)
    if not len(balanced) or balanced[0] == 0:
        return now
    nearest = distance[known].min()
    last, rest = distance[order[[0, balanced[0]]]] - nearest
    level = rest**REST * last ** (1 - REST)
    if plane:
        k = outer[: balanced[0]].argmin()  # the innermost that pulls
        pulls, pushes = force[order[[k, k + 1]]]
        far, near = distance[order[[k, k + 1]]] - nearest
        level = max(2 * (near * pulls - far * pushes) / (pulls - pushes) - last, rest)
    near = known & (distance - nearest <= level + none)
    return before & near if (before & ~near).any() else now


def without_pull(before, now, facets, force) -> npt.NDArray[np.bool_]:
    """An active set on chains of edges that loses at an end as much as the end's pull holds.

    Where contact reaches too far, its last vertex pulls, and pressures beside it scatter around
    what they should be: without this it would lose a vertex or two each step. What goes wrongly
    comes back at once, since it overlaps.

    Args:
        before: The last set, ``(num,)``.
        now: Those that remain, and new ones, ``(num,)``.
        facets: Vertices of Γ1's edges, ``(num_facets, 2)``.
        force: Pressures times areas, ``(num,)``.

    Returns:
        ``(num,)``.
    """
    result = now.copy()
    beside = np.full((2, len(before)), -1)
    beside[0, facets[:, 1]], beside[1, facets[:, 0]] = facets[:, 0], facets[:, 1]
    for a in np.flatnonzero(before & ~now).tolist():
        for outwards, inwards in (beside, beside[::-1]):
            if outwards[a] >= 0 and before[outwards[a]]:
                continue
            total, b = 0.0, a
            while b >= 0 and before[b] and (total := total + force[b]) < 0:
                result[b] = False
                b = inwards[b] if inwards[b] != a else -1
    return result


def seeded(
    active, distance, area, valid, holds, load, across=(), *, first=False
) -> tuple[npt.NDArray[np.bool_], int]:
    """An active set that is enlarged until it holds what nothing else does.

    What the shortest way closes comes first, last what would have to pull against the load. If some
    would have to even so, it is that on which rigid bodies would come to rest.

    Args:
        active: The set, ``(num,)``.
        distance: Gaps over areas, ``(num,)``.
        area: Areas, ``(num,)``.
        valid: Which multipliers there are, ``(num,)``.
        holds: What each makes of the motions that are free without contact, ``(num, num_free)``.
        load: Forces on those motions that contact is to balance, ``(num_free,)``.
        across: What friction makes of them where it sticks, ``(num_sticking, num_free)``.
        first: Whether nothing pushes yet: then what holds all can be what would have to pull.

    Returns:
        The set, and how many motions stay free even so.
    """
    num = holds.shape[1]
    size = np.linalg.norm(holds, axis=1)
    rows = _unit(holds)
    basis, _ = _extended(np.empty((0, num)), _unit(np.reshape(across, (-1, num))))
    can = valid & (size > 0)
    way = np.full(len(size), np.inf)
    way[can] = distance[can] * np.where(distance[can] > 0, size[can].max(initial=0) / size[can], 1)
    way[can] = np.round(way[can] / max(np.abs(distance[can]).max(initial=0), 1e-300), DIGITS_SETS)
    pulls = rows @ load < -HOLDS * np.linalg.norm(load)

    def enlarged(leading):
        order = np.lexsort((way, pulls, ~leading))
        order = order[valid[order] & (size[order] > HOLDS * size.max(initial=0))]
        held, taken = _extended(basis, rows[order])
        on = leading.copy()
        on[order[taken]] = True
        return on, num - len(held)

    result, num_free = enlarged(active)
    if first or (result != active).any():
        free = np.linalg.svd(basis)[2][len(basis) :].T if len(basis) else np.eye(num)
        moves, wanted = holds @ free, load @ free
        if not len(resting(moves[result], wanted, np.zeros(result.sum()))):  # some would pull
            rests, closing = active.copy(), np.maximum(distance[can], 0) * area[can]
            rests[np.flatnonzero(can)[resting(moves[can], wanted, closing)]] = True
            result, num_free = enlarged(rests)
    return result, num_free


def stuck(sticks, can, surplus, holds, across) -> tuple[npt.NDArray[np.bool_], int]:
    """What sticks, enlarged until it holds what nothing else does.

    Args:
        sticks: What does, ``(num,)``.
        can: What could, ``(num,)``.
        surplus: By how much traction is beyond what friction can hold, ``(num,)``.
        holds: What gaps that are closed make of free motions, ``(num_active, num_free)``.
        across: What slips make of them, ``(num, n - 1, num_free)``.

    Returns:
        ``(num,)``, and how many motions stay free even so.
    """
    num = across.shape[2]
    basis, _ = _extended(np.empty((0, num)), _unit(holds))
    result, order = sticks.copy(), np.lexsort((surplus, ~sticks))
    for a in order[can[order]].tolist():
        if len(basis) == num:
            break
        basis, taken = _extended(basis, _unit(across[a]))
        result[a] |= bool(taken)
    return result, num - len(basis)


def _unit(rows) -> npt.NDArray[np.float64]:
    size = np.linalg.norm(rows, axis=1)
    return rows / np.where(size > 0, size, 1)[:, None]


def _extended(basis, rows) -> tuple[npt.NDArray[np.float64], list[int]]:
    """An orthonormal basis enlarged by rows of length 1 that aren't in its span, and which."""
    taken = []
    for k, row in enumerate(rows):
        if len(basis) == rows.shape[1]:
            break
        rest = row - (row @ basis.T) @ basis
        length = np.linalg.norm(rest)
        if length > HOLDS:
            basis = np.vstack((basis, rest / length))
            taken.append(k)
    return basis, taken
