# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Active set of a semi-smooth Newton iteration: its changes, and how it holds rigid bodies."""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_solver.tolerances import CLOSED_GAP, HOLDS, REST


def supports(holds, load, distance) -> npt.NDArray[np.intp]:
    """Support set of rigid bodies under the applied load, once they have moved there.

    They go where the load does the most work while no gap becomes negative: a linear program.
    Solved is its dual: of all pressures that balance the load, those that do the least work in the
    gaps.

    Args:
        holds: Work of a unit pressure along each motion, ``(num, num_motions)``.
        load: Load along each motion, ``(num_motions,)``.
        distance: Gaps, with the pressures' weights, ``(num,)``; none is negative.

    Returns:
        The multipliers with a pressure; empty if no pressures balance the load.
    """
    from scipy.optimize import linprog

    scale = np.abs(holds).max(axis=0, initial=0)
    finite = np.isfinite(load).all() and np.isfinite(scale).all() and np.isfinite(distance).all()
    if not len(holds) or not finite or not load.any() or not scale.all():
        return np.empty(0, dtype=np.intp)
    b, A = load / scale, (holds / scale).T
    b, A = b / np.abs(b).max(), A / np.abs(A).max()
    work = distance / max(distance.max(), 1e-300)
    exact = dict.fromkeys(("primal_feasibility_tolerance", "dual_feasibility_tolerance"), 1e-10)
    found = linprog(work, A_eq=A, b_eq=b, method="highs-ds", options=exact)
    acts = found.x > CLOSED_GAP if found.success else np.zeros(len(holds), dtype=bool)
    return np.flatnonzero(acts)


def sources(new, lasting, active, facets) -> npt.NDArray[np.intp]:
    """Vertices from which new multipliers take their tractions, -1 for none, ``(num,)``.

    Args:
        new: Mask of the new multipliers, ``(num,)``.
        lasting: Mask of those that existed before, ``(num,)``.
        active: The active set, in which all of these beside a new one must be, ``(num,)``.
        facets: Vertices of Γ1's facets, ``(num_facets, num_facet_vertices)``.
    """
    result = np.full(len(new), -1)
    i, j = _pairs(facets[new[facets].any(axis=1)])
    use = new[i] & lasting[j]
    result[i[use]] = j[use]
    result[i[use & ~active[j]]] = -1
    return result


def beside(new, lasting, facets) -> npt.NDArray[np.bool_]:
    """Mask of new multipliers, and of their lasting neighbours; arguments as :func:`sources`."""
    result = new.copy()
    i, j = _pairs(facets[new[facets].any(axis=1)])
    result[j[new[i] & lasting[j]]] = True
    return result


def _pairs(facets) -> npt.NDArray[np.intp]:
    """Vertices of the same facets, both ways and also with themselves, ``(2, num_pairs)``."""
    k = facets.shape[1]
    return np.stack((np.repeat(facets, k, 1).ravel(), np.tile(facets, k).ravel()))


def pushing(p, g, m, valid, stiffness, active, zero: float) -> npt.NDArray[np.bool_]:
    """Mask p − c g/m > 0: closed or overlapping, without a pull; at both limits nothing changes.

    Args:
        p: Pressures, ``(num,)``.
        g: Weighted gaps, ``(num,)``.
        m: Areas of the weights, ``(num,)``.
        valid: Mask of the existing multipliers, ``(num,)``.
        stiffness: c, of the size of a modulus over the size of a cell; a number or ``(num,)``.
        active: The set so far, ``(num,)``.
        zero: Pressure treated as zero.
    """
    gap = np.divide(g, m, out=np.zeros_like(g), where=valid)
    return valid & (p - stiffness * gap > np.where(active, -zero, zero))


def shrunk(before, now, facets, force, distance, closed: float) -> npt.NDArray[np.bool_]:
    """An active set that loses at once all that pulls, and what balances it.

    Args:
        before: The last set, ``(num,)``.
        now: Its part that doesn't pull, and new multipliers, ``(num,)``.
        facets: Vertices of Γ1's facets, ``(num_facets, num_facet_vertices)``.
        force: Pressures times areas, ``(num,)``.
        distance: As for :func:`as_near`; None if pressures acted at the start of the load step.
        closed: Difference of distances treated as zero.
    """
    plane = facets.shape[1] == 2
    if distance is not None:
        near = as_near(before, now, distance, force, closed, plane=plane)
        if not np.array_equal(near, now):
            return near
    return (without_pull if plane else without_pull_on_surface)(before, now, facets, force)


def without_pull_on_surface(before, now, facets, force) -> npt.NDArray[np.bool_]:
    """An active set on a surface without the pull at its edge, ring by ring inwards.

    The neighbours of a lost vertex farther inside share its pull; those whose force is smaller are
    lost too, and pass on the rest. Arguments as :func:`shrunk`.
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
    """An active set of which the nearest vertices remain, where bodies come into contact.

    A set that is much too large pulls at its edge, and pressures scatter all over. Ordered by their
    distance before contact, the outer vertices pull or balance a pull; from some distance on the
    inner ones carry the whole force. For two spheres that is r² = a³/b, a the unknown radius, b
    the set's; hence :data:`REST`. For two cylinders pressures change their sign at 2x² = a² + b².

    Args:
        before: The last set, ``(num,)``.
        now: Its part that doesn't pull, and new multipliers, ``(num,)``.
        distance: Gaps over areas before contact, ``(num,)``; infinite without a multiplier.
        force: Pressures times areas, ``(num,)``.
        none: Difference of distances treated as zero.
        plane: True for bodies in the plane.
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
    """An active set on a chain of edges without the pull at its ends, and what balances it.

    If contact reaches too far, its last vertex pulls, and pressures beside it scatter: without
    this the set would lose a vertex or two each step. Vertices lost wrongly overlap, and come back
    at once. Arguments as :func:`shrunk`.
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
    """An active set enlarged until it holds the bodies that nothing else holds.

    Multipliers that close soonest come first, those that would have to pull against the load last.
    If some would have to pull even so, the set is the support set of the rigid bodies.

    Args:
        active: The set, ``(num,)``.
        distance: Gaps over areas, ``(num,)``.
        area: Areas, ``(num,)``.
        valid: Mask of the existing multipliers, ``(num,)``.
        holds: Rows of the gaps on motions that are free without contact, ``(num, num_free)``.
        load: Forces on those motions that contact is to balance, ``(num_free,)``.
        across: Rows of friction where it sticks, ``(num_sticking, num_free)``.
        first: True if no pressure acts yet: then a set that holds all may have to pull.

    Returns:
        The set, and the number of motions that stay free even so.
    """
    num = holds.shape[1]
    size = np.linalg.norm(holds, axis=1)
    rows = _unit(holds)
    basis, _ = _extended(np.empty((0, num)), _unit(np.reshape(across, (-1, num))))
    can = valid & (size > 0)
    way = np.full(len(size), np.inf)
    way[can] = distance[can] * np.where(distance[can] > 0, size[can].max(initial=0) / size[can], 1)
    way[can] = np.round(way[can] / max(CLOSED_GAP * np.abs(distance[can]).max(initial=0), 1e-300))
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
        if not len(supports(moves[result], wanted, np.zeros(result.sum()))):  # some would pull
            rests, closing = active.copy(), np.maximum(distance[can], 0) * area[can]
            rests[np.flatnonzero(can)[supports(moves[can], wanted, closing)]] = True
            result, num_free = enlarged(rests)
    return result, num_free


def stuck(sticks, can, surplus, holds, across) -> tuple[npt.NDArray[np.bool_], int]:
    """A sticking set enlarged until it holds the bodies that nothing else holds.

    Args:
        sticks: The set, ``(num,)``.
        can: Mask of multipliers that could stick, ``(num,)``.
        surplus: Traction beyond friction's bound, ``(num,)``.
        holds: Rows of the closed gaps on free motions, ``(num_active, num_free)``.
        across: Rows of the slips on them, ``(num, n - 1, num_free)``.

    Returns:
        ``(num,)``, and the number of motions that stay free even so.
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
    """An orthonormal basis enlarged by unit rows outside its span, and the numbers of these."""
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
