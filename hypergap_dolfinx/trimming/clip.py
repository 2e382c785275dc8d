# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Facing pieces that overlap in part, cut to their common part."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.core.graph import components
from hypergap_dolfinx.errors import InterfaceError, NotFacingError
from hypergap_dolfinx.surface.pieces import Side
from hypergap_dolfinx.surface.tolerances import CORNER
from hypergap_dolfinx.surface.trace import lengths, normals_by_area
from hypergap_dolfinx.surface.triangulation import neighbours
from hypergap_dolfinx.trimming.curved_outlines import crossings, upright
from hypergap_dolfinx.trimming.outlines import Meetings, Rim, Shared, locate, meetings
from hypergap_dolfinx.trimming.subdivision import Cut, Node
from hypergap_dolfinx.trimming.tolerances import CORNER_OUTLINE, NEARLY, OFF_OUTLINES, SNAP


def _kept(cut: Cut, other: Side) -> Side | None:
    """The part of a piece that lies opposite to the other one, or None."""
    side = cut.side
    cells, origin, weights = cut.triangulation()
    x = np.vstack((side.x, cut.places(range(cut.num_vertices, cut.num_vertices + len(cut.at)))[0]))
    behind = neighbours(cells, side.surface.name, x)
    n = len(x)
    key = cells.astype(np.int64) * n + np.roll(cells, -1, axis=1)
    path = np.array(cut.drawn(), dtype=np.int64).reshape(-1, 2)
    left = np.isin(key, path[:, 0] * n + path[:, 1])
    right = np.isin(key, path[:, 1] * n + path[:, 0])
    f, k = np.nonzero((behind >= 0) & ~left & ~right)
    part = components(len(cells), f, behind[f, k])
    num = int(part.max()) + 1
    votes = np.bincount(part[np.nonzero(left)[0]], minlength=num)
    votes -= np.bincount(part[np.nonzero(right)[0]], minlength=num)
    keep = votes > 0
    undecided = np.flatnonzero(votes == 0)
    sample = np.unique(part, return_index=True)[1][undecided]
    middle = x[cells[sample]].mean(axis=1)
    keep[undecided] = locate(other, middle, side.normals[origin[sample]])[0] >= 0
    mine = keep[part]
    if not mine.any():
        return None
    cells, origin, weights, behind = (a[mine] for a in (cells, origin, weights, behind))
    number = np.full(len(mine), -1)
    number[mine] = np.arange(len(cells))
    behind = np.where(behind >= 0, number[behind], -1)
    kept = sorted_out(side, x, cells, behind, origin, weights)
    if cut.curves:
        f, k = np.nonzero(left[mine])
        bends = np.zeros((len(cells), 3, len(cut.curves.nodes), 2))
        ends = weights[f[:, None], np.column_stack((k, (k + 1) % 3)), 1:]
        pairs = np.column_stack((cells[f, k], cells[f, (k + 1) % 3]))
        bends[f, k] = cut.curves.bends(pairs, origin[f], ends)
        kept = replace(kept, bends=upright(kept.X, bends))
    return kept


def sorted_out(side: Side, x, cells, behind, origin, weights) -> Side:
    """A piece of cut triangles; a vertex at which parts touch is duplicated."""
    f, k = np.nonzero(behind >= 0)
    g = behind[f, k]
    m = (behind[g] == f[:, None]).argmax(axis=1)
    one = np.concatenate((3 * f + k, 3 * f + (k + 1) % 3))
    two = np.concatenate((3 * g + (m + 1) % 3, 3 * g + m))
    corner = components(3 * len(cells), one, two)
    _, first = np.unique(corner, return_index=True)
    X = side.in_facets(np.repeat(origin, 3), weights.reshape(-1, 3)[:, 1:]).reshape(-1, 3, 2)
    return Side(
        side.surface,
        x[cells.ravel()[first]],
        corner.reshape(-1, 3).astype(np.intp),
        side.facets[origin],
        X,
    )


def _meet(
    cuts: list[Cut], shared: Shared, more: Sequence[Node]
) -> tuple[dict[int, int], dict[int, int]]:
    """Make nodes where the outlines meet; for each side, its node at each node of the other.

    Args:
        cuts: The pieces.
        shared: What both outlines have in common.
        more: Corners of either that lie on the other one, and further nodes of either.
    """
    twins: tuple[dict[int, int], dict[int, int]] = {}, {}

    def join(nodes):
        twins[0][nodes[1]], twins[1][nodes[0]] = nodes

    for k in shared.ends:
        join([cut.put(float(at[k])) for cut, at in zip(cuts, shared.at, strict=True)])
    for node in more:
        both = [cut.on_edge(*place) for cut, place in zip(cuts, node, strict=True) if place]
        if len(both) == 2:
            join(both)
    for cut in cuts:
        cut.bend()
    (places0, edges0), (places1, edges1) = (cut.edges() for cut in cuts)
    if not places0 or not places1:
        return twins
    met = meetings(edges0, edges1, cuts[0].snap)
    ends = [[twins[0].get(node, -1) for node in place[4:]] for place in places1]
    apart = [  # from the other's, where edges leave one place
        set(ends[o]).isdisjoint(places0[e][4:])
        for e, o in zip(met.edge.tolist(), met.other.tolist(), strict=True)
    ]
    met = Meetings(*(np.asarray(part)[apart] for part in vars(met).values()))
    edges, at = [], []
    for places, edge, s in ((places0, met.edge, met.s), (places1, met.other, met.r)):
        own = [places[e] for e in edge.tolist()]
        edges.append([place[:2] for place in own])
        at.append(np.array([low + t * (high - low) for (_, _, low, high, *_), t in zip(own, s)]))
    some = np.flatnonzero((met.s > 0) & (met.s < 1) & (met.r > 0) & (met.r < 1))
    if len(some):  # of straight edges too: seen along normals that turn
        arcs = [cut.arcs([own[i] for i in some]) for cut, own in zip(cuts, edges, strict=True)]
        s, r, done = crossings(arcs[0], arcs[1], at[0][some], at[1][some])
        good = done & (np.minimum(s, r) > 0) & (np.maximum(s, r) < 1)
        at[0][some[good]], at[1][some[good]] = s[good], r[good]
    for i in range(len(met.s)):
        join(
            [
                cut.on_edge(a, b, float(t[i]))
                for cut, (a, b), t in zip(cuts, (own[i] for own in edges), at, strict=True)
            ]
        )
    return twins


def parts(side: Side) -> list[Side]:
    """The connected parts of a piece."""
    f, k = np.nonzero(side.behind >= 0)
    part = components(len(side.triangles), f, side.behind[f, k])
    found = []
    for p in range(int(part.max()) + 1):
        mine = part == p
        vertices, triangles = np.unique(side.triangles[mine], return_inverse=True)
        triangles = triangles.reshape(-1, 3)
        bends = None if side.bends is None else side.bends[mine]
        found.append(
            Side(side.surface, side.x[vertices], triangles, side.facets[mine], side.X[mine], bends)
        )
    return found


def clip(
    side0: Side,
    side1: Side,
    snap: float = SNAP,
    of_one_curve: bool = True,
    at_corners: bool = False,
) -> list[tuple[Side, Side]]:
    """The common part of two facing pieces: pairs with the same outlines.

    Args:
        side0: A piece of Γ0.
        side1: The piece of Γ1 that faces it.
        snap: Distance treated as zero, in lengths of the outlines' edges.
        of_one_curve: True if outlines count as equal that are polygons of one curve, within the
            uncertainty of the meshes. If False they are cut as they are, which holes with different
            corners may need.
        at_corners: True if an outline may meet the other one's vertex that it passes by less than
            the surfaces are apart there.

    Returns:
        Pairs of connected pieces; the two themselves if their outlines match.

    Raises:
        NotFacingError: They have nothing in common.
        InterfaceError: The parts that are left of both don't correspond.
    """
    sides = side0, side1
    rims = tuple([Rim(side, loop) for loop in side.loops()] for side in sides)
    # Whole loops may be coarse polygons of a curve
    whole = Shared(rims, OFF_OUTLINES, NEARLY, CORNER).whole()
    rims = tuple([r for r, w in zip(*both, strict=True) if not w] for both in zip(rims, whole))
    if not any(rims):
        return [sides]
    length = np.array([[f(rim.length) for f in (np.mean, np.max)] for own in rims for rim in own])
    snap *= float(length[:, 0].min())
    corner = CORNER_OUTLINE if of_one_curve else 0.0
    shared = Shared(rims, snap / length[:, 1].max(), 0.0, corner)
    sides = side0.in_halves(), side1.in_halves()
    more: list[Node] = []
    is_drawn = False
    while not is_drawn:
        cuts = [Cut(sides[i], rims[i], partial(shared.is_run, i), snap) for i in (0, 1)]
        twins = _meet(cuts, shared, more)
        outlines = [cut.outline() for cut in cuts]
        for i in (0, 1):
            outline, other = outlines[i], outlines[1 - i]
            missing = cuts[i].follow(cuts[1 - i], outline, other, twins[i], at_corners)
            if missing:
                more += missing if i == 0 else [(own, place) for place, own in missing]
                break
        is_drawn = not missing
    kept = [part for i in (0, 1) if (part := _kept(cuts[i], sides[1 - i]))]
    if len(kept) < 2:
        raise NotFacingError(
            f"Γ0 around {spot(side0.x)} and Γ1 around {spot(side1.x)} have nothing "
            "in common: neither lies opposite to the other; check the tags."
        )
    return _matched(*(parts(side) for side in kept))


def _matched(parts0: list[Side], parts1: list[Side]) -> list[tuple[Side, Side]]:
    """Pairs of parts that lie opposite to each other."""
    if len(parts0) == len(parts1) == 1:  # tubes of five facets: a place on one may miss the other
        return [(parts0[0], parts1[0])]
    pairs = []
    left = list(range(len(parts1)))
    for part in parts0:
        largest = lengths(normals_by_area(part.x[part.triangles])).argmax()
        middle = part.x[part.triangles[largest]].mean(axis=0)[None]
        normal = part.normals[[largest]]
        found = [j for j in left if locate(parts1[j], middle, normal)[0][0] >= 0]
        if len(found) != 1:
            break
        left.remove(found[0])
        pairs.append((part, parts1[found[0]]))
    if left or len(pairs) < len(parts0):
        raise InterfaceError(
            f"Γ0 and Γ1 have {len(parts0)} and {len(parts1)} parts in common, around "
            f"{spot(parts0[len(pairs) - 1].x)}: do the surfaces have the same shape there?"
        )
    return pairs
