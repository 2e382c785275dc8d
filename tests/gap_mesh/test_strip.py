# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Σ in two dimensions: the strip between two chains, on surfaces made by hand."""

import hypothesis.strategies as st
import numpy as np
import pytest
from helpers import close, polyline, skew
from hypothesis import given, settings

from hypergap_dolfinx import InterfaceError
from hypergap_dolfinx.gap_mesh.strip import chains, mesh_strip, triangulate

pytestmark = pytest.mark.serial


def on_line(s, name, y=0.0, mapping=lambda x: x, seed=0):
    """Edges along y = const; the body of Γ0 is below it, that of Γ1 above."""
    x = np.column_stack((s, np.full(len(s), y)))
    return polyline(mapping(x[::-1] if name == "Γ0" else x), name, seed=seed)


def on_circle(theta, name, r=1.0, seed=0):
    """A closed polygon; the body of Γ0 is inside, that of Γ1 outside."""
    theta = theta if name == "Γ0" else theta[::-1]
    x = r * np.column_stack((np.cos(theta), np.sin(theta)))
    return polyline(x, name, closed=True, seed=seed)


def measure(gap):
    """∫∫ dΓ_α dα of each cell: half of its base's length, with the sign of its turn."""
    x = gap.x[gap.cells]
    dalpha = gap.alpha[gap.cells][:, 1:] - gap.alpha[gap.cells][:, :1]
    X = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
    N = np.column_stack(
        (
            X[:, 1, 1] * dalpha[:, 0] - X[:, 1, 0] * dalpha[:, 1],
            X[:, 0, 0] * dalpha[:, 1] - X[:, 0, 1] * dalpha[:, 0],
        )
    )
    return np.einsum("ci,ci->c", N, gap.normals(np.arange(len(gap.cells)))) / 2


def edges(gap):
    """Edges of all cells as vertex pairs."""
    pairs = gap.cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    return np.sort(pairs, axis=1)


def check_strip(gap, surface0, surface1):
    """Facts of every strip between whole chains: counts, conformity, orientation, content."""
    n0, n1 = len(surface0.facets), len(surface1.facets)
    assert len(gap.cells) == n0 + n1
    assert (measure(gap) > 0).all()
    close(measure(gap).sum(), (surface0.size.sum() + surface1.size.sum()) / 2)
    _, count = np.unique(edges(gap), axis=0, return_counts=True)
    assert count.max() <= 2
    # The edges in one cell alone: those of Γ0, those of Γ1 and the ends
    alpha = gap.alpha[np.unique(edges(gap), axis=0)[count == 1]]
    assert [(alpha.sum(axis=1) == i).sum() for i in (0, 2)] == [n0, n1]
    assert (alpha.sum(axis=1) == 1).sum() in (0, 2)


def check_delaunay(gap):
    """The apex of each cell is a node nearest to its base's middle, found by brute force."""
    for cell in gap.cells:
        side = int(gap.alpha[cell].sum() > 1.5)
        base, (apex,) = cell[gap.alpha[cell] == side], cell[gap.alpha[cell] != side]
        middle = gap.x[base].mean(axis=0)
        others = gap.x[gap.alpha != side]
        nearest = np.linalg.norm(others - middle, axis=1).min()
        assert np.linalg.norm(gap.x[apex] - middle) <= nearest + 1e-8


def check_coincident_nodes(gap):
    """Where Γ0 and Γ1 have nodes at one place, an edge joins them."""
    x = gap.x[edges(gap)]
    joins = (np.ptp(gap.alpha[edges(gap)], axis=1) == 1) & (np.ptp(x, axis=1).max(axis=1) < 1e-9)
    at = x[joins, 0]
    for x0 in gap.x[gap.alpha == 0]:
        if np.linalg.norm(gap.x[gap.alpha == 1] - x0, axis=1).min() < 1e-9:
            assert np.linalg.norm(at - x0, axis=1).min(initial=np.inf) < 1e-9


def test_triangulate_by_hand():
    """Two edges against three."""
    side, edge, apex = triangulate(np.array([0, 0.5, 1]), np.array([0, 0.2, 0.6, 1]))
    # Middles: Γ0 at .25 and .75, Γ1 at .1, .4 and .8
    assert list(zip(side.tolist(), edge.tolist(), apex.tolist(), strict=True)) == [
        (1, 0, 0),
        (0, 0, 1),
        (1, 1, 1),
        (0, 1, 2),
        (1, 2, 2),
    ]


@pytest.mark.parametrize("n", ((1, 1), (1, 7), (7, 1), (2, 3), (5, 5), (6, 4), (13, 8)))
@pytest.mark.parametrize("mapping", (lambda x: x, lambda x: -x, skew))
def test_straight_interface(n, mapping):
    """Equal edges on each side, in three directions of travel."""
    sides = [
        on_line(np.linspace(0, 3, m + 1), name, mapping=mapping)
        for m, name in zip(n, ("Γ0", "Γ1"), strict=True)
    ]
    gap = mesh_strip(*sides)
    check_strip(gap, *sides)
    check_delaunay(gap)
    check_coincident_nodes(gap)
    close(measure(gap).sum(), 3)


partitions = st.lists(st.integers(1, 99), unique=True, max_size=12).map(
    lambda inner: np.array([0, *sorted(inner), 100]) / 100
)


@settings(derandomize=True, max_examples=60, deadline=None, database=None)
@given(s0=partitions, s1=partitions, seed=st.integers(0, 9))
def test_any_partition(s0, s1, seed):
    sides = [on_line(s, name, mapping=skew, seed=seed) for s, name in ((s0, "Γ0"), (s1, "Γ1"))]
    gap = mesh_strip(*sides)
    check_strip(gap, *sides)
    check_delaunay(gap)
    check_coincident_nodes(gap)


@pytest.mark.parametrize("unit", (1e-9, 1e9))
def test_unit_of_length(unit):
    """The same cells, whatever the unit."""
    s = np.sort(np.random.default_rng(0).uniform(size=(2, 9)))
    cells = []
    for scale in (1.0, unit):
        sides = [
            on_line(np.concatenate(([0], t, [1])), name, mapping=lambda x: skew(x) * scale)
            for t, name in zip(s, ("Γ0", "Γ1"), strict=True)
        ]
        cells.append(mesh_strip(*sides).cells)
    assert (cells[0] == cells[1]).all()


def test_order_of_facets_does_not_matter():
    s = np.sort(np.random.default_rng(0).uniform(size=9))
    gaps = []
    for seed in (0, 1):
        sides = on_line(np.linspace(0, 1, 6), "Γ0", seed=seed), on_line(s, "Γ1", seed=seed)
        gaps.append(mesh_strip(*sides))
    for name in ("x", "alpha", "cells"):
        assert (getattr(gaps[0], name) == getattr(gaps[1], name)).all()
    one, other = (gap.normals(np.arange(len(gap.cells))) for gap in gaps)
    assert (one == other).all()


def test_open_gap():
    """The surfaces need not touch: Σ is then the strip between them."""
    sides = on_line(np.linspace(0, 1, 4), "Γ0"), on_line(np.linspace(0, 1, 6), "Γ1", y=0.2)
    gap = mesh_strip(*sides)
    check_strip(gap, *sides)
    x = gap.x[gap.cells]
    area = np.linalg.det(x[:, 1:] - x[:, :1]) / 2
    assert (area > 0).all()
    close(area.sum(), 0.2)


def test_chords_of_different_lengths():
    """Two polygons in one arc, coarse where the other is fine: a shared node has one parameter."""
    coarse, fine = np.linspace(0, 1, 5), np.linspace(0, 1, 401)
    theta = np.concatenate((coarse, 1 + fine[1:])), np.concatenate((fine, 1 + coarse[1:]))
    sides = []
    for name, t in zip(("Γ0", "Γ1"), theta, strict=True):
        x = np.column_stack((np.cos(t), np.sin(t)))
        sides.append(polyline(x if name == "Γ0" else x[::-1], name))
    gap = mesh_strip(*sides)
    check_strip(gap, *sides)
    check_coincident_nodes(gap)


def test_kink_with_a_node_of_each_side():
    """Both sides have a node at the kink: no cell reaches round it."""

    def bent(x):
        return np.column_stack((x[:, 0], np.maximum(0, x[:, 0] - 1)))

    s = np.linspace(0, 2, 5), np.array((0, 0.9, 1, 1.05, 1.1, 2))
    sides = [on_line(t, name, mapping=bent) for t, name in zip(s, ("Γ0", "Γ1"), strict=True)]
    gap = mesh_strip(*sides)
    assert len(gap.cells) == 9
    check_coincident_nodes(gap)
    x = gap.x[gap.cells, 0]
    assert ((x.max(axis=1) <= 1) | (x.min(axis=1) >= 1)).all()


@pytest.mark.parametrize("roll", (0, 1, 5))
@pytest.mark.parametrize("shift", (0, 0.13, -0.13))
@pytest.mark.parametrize("n", ((7, 11), (11, 7), (8, 8), (6, 9)))
def test_closed_loop(n, shift, roll):
    """A ring in a ring, wherever the two chains start."""
    theta = [2 * np.pi * np.arange(m) / m for m in n]
    sides = [on_circle(theta[0], "Γ0"), on_circle(np.roll(theta[1], roll) + shift, "Γ1")]
    gap = mesh_strip(*sides)
    check_strip(gap, *sides)
    check_coincident_nodes(gap)
    # Delaunay by arc length, which is the angle here
    theta = np.arctan2(gap.x[:, 1], gap.x[:, 0])
    for cell in gap.cells:
        side = int(gap.alpha[cell].sum() > 1.5)
        base, (apex,) = cell[gap.alpha[cell] == side], cell[gap.alpha[cell] != side]
        middle = np.arctan2(*gap.x[base].sum(axis=0)[::-1])
        distance = np.abs((theta - middle + np.pi) % (2 * np.pi) - np.pi)
        assert distance[apex] <= distance[gap.alpha != side].min() + 1e-8


def together(*surfaces):
    """Several surfaces as one."""
    x = np.vstack([s.x[s.facets] for s in surfaces]).reshape(-1, 2)
    x, facets = np.unique(x, axis=0, return_inverse=True)
    facets = facets.reshape(-1, 2).astype(np.int32)
    owner = np.zeros(len(facets), dtype=np.int32)
    first = surfaces[0]
    return type(first)(
        first.name,
        x,
        facets,
        x[facets],
        facets.astype(np.int64),
        owner,
        first.geometry,
        first.element,
        np.array((0, len(x))),
    )


def test_several_chains():
    """Three pieces of one interface with holes between, and a loop elsewhere."""
    spans = (0, 1), (2, 3), (3.5, 4)
    sides = []
    for name, m in (("Γ0", 3), ("Γ1", 4)):
        pieces = [on_line(np.linspace(a, b, m + 1), name) for a, b in spans]
        sides.append(together(*pieces, on_circle(2 * np.pi * np.arange(m) / m + 0.1, name, 0.2)))
    assert [len(chains(side)) for side in sides] == [4, 4]
    gap = mesh_strip(*sides)
    assert len(gap.cells) == 4 * (3 + 4)
    assert (measure(gap) > 0).all()
    close(measure(gap).sum(), sum(side.size.sum() for side in sides) / 2)
    check_coincident_nodes(gap)


def test_one_side_in_pieces():
    """Γ0 goes through, Γ1 covers two parts of it."""
    side0 = on_line(np.linspace(0, 3, 8), "Γ0")
    side1 = together(*(on_line(np.linspace(*span, 4), "Γ1") for span in ((0.1, 1), (1.7, 2.8))))
    gap = mesh_strip(side0, side1)
    close(measure(gap).sum(), 0.9 + 1.1)


# Partial overlap: the part that one side has alone stays free.

SPANS = {
    "Γ1 shorter": ((0, 2), (0.3, 1.55)),
    "Γ1 longer": ((0.3, 1.55), (0, 2)),
    "shifted": ((0, 2), (0.7, 2.9)),
    "shifted back": ((0.7, 2.9), (0, 2)),
    "one end": ((0, 2), (0, 1.1)),
    "within an edge": ((0, 2), (0.45, 0.6)),
}


@pytest.mark.parametrize("name", SPANS)
def test_partial_overlap(name):
    """Σ ends where either side does, at a virtual node of the other."""
    sides = [
        on_line(np.linspace(*span, m + 1), side, mapping=skew)
        for span, m, side in zip(SPANS[name], (5, 7), ("Γ0", "Γ1"), strict=True)
    ]
    gap = mesh_strip(*sides)
    a, b = np.max(SPANS[name], axis=0)[0], np.min(SPANS[name], axis=0)[1]
    close(measure(gap).sum(), b - a)
    ends = skew(np.array([(a, 0), (b, 0)]))
    for alpha in (0, 1):
        x = gap.x[gap.alpha == alpha]
        distance = np.linalg.norm(x[:, None] - ends, axis=2).min(axis=0)
        np.testing.assert_allclose(distance, 0, atol=1e-14)
    check_delaunay(gap)
    # A virtual node lies where its host says
    X = np.array([(0, 0), (1, 0), (0, 1.0)])
    hosts = gap.hosts(X, np.arange(len(gap.cells)))
    close(hosts.alpha, gap.alpha[gap.cells])
    for i in (0, 1):
        on = hosts.alpha == i
        x = sides[i].points(hosts.facets[i][on], hosts.X[i][on])
        close(x, gap.x[gap.cells][on])


def test_ends_that_agree_to_rounding_are_not_cut():
    """No sliver, no virtual node."""
    side0 = on_line(np.linspace(0, 1, 4), "Γ0")
    side1 = on_line(np.linspace(1e-10, 1 - 1e-10, 6), "Γ1")
    gap = mesh_strip(side0, side1)
    assert len(gap.cells) == 3 + 5 and len(gap.x) == 4 + 6


@pytest.mark.parametrize("degree", (2, 3))
def test_hosts_of_points_between_the_surfaces(degree):
    """At α between, the hosts on both sides lie at one place of a flat interface."""
    sides = (
        on_line(np.linspace(0, 1, 4), "Γ0", mapping=skew),
        on_line(np.linspace(0, 1, 6), "Γ1", mapping=skew),
    )
    gap = mesh_strip(*sides)
    lattice = np.array([(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]) / degree
    hosts = gap.hosts(lattice, np.arange(len(gap.cells)))
    weights = np.column_stack((1 - lattice.sum(axis=1), lattice))
    x = np.einsum("pv,cvi->cpi", weights, gap.x[gap.cells])
    close(hosts.alpha, gap.alpha[gap.cells] @ weights.T)
    for i in (0, 1):
        X = hosts.X[i].reshape(-1, 1)
        close(sides[i].points(hosts.facets[i].ravel(), X).reshape(x.shape), x, 1e-13)


# What is no interface.


def test_branching_edges():
    """Two edges that leave one node, or that enter it."""
    good = on_line(np.linspace(0, 1, 4), "Γ1")
    for facets in ([(0, 1), (0, 2)], [(1, 0), (2, 0)]):
        bad = polyline([(0, 0), (1, 0), (0, 1)])
        object.__setattr__(bad, "facets", np.array(facets, dtype=np.int32))
        with pytest.raises(InterfaceError, match=r"^Γ0 branches at \(0, 0\): .* one tie"):
            mesh_strip(bad, good)


def test_surfaces_that_lie_elsewhere():
    side0, side1 = on_line(np.linspace(0, 1, 4), "Γ0"), on_line(np.linspace(5, 6, 4), "Γ1")
    with pytest.raises(InterfaceError, match=r"don't face each other: .*\(5\.5, 0\).*4 away"):
        mesh_strip(side0, side1)


def test_same_side_twice():
    """The normals agree: the user took the wrong side of a body."""
    side0, side1 = (on_line(np.linspace(0, 1, 4), "Γ0") for _ in range(2))
    with pytest.raises(InterfaceError, match="their outward normals agree"):
        mesh_strip(side0, side1)
