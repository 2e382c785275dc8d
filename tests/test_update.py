# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Σ between surfaces that slide: valid as if it were new, and cheaper."""

import time

from mpi4py import MPI

import numpy as np
import pytest
from test_front import check_cells, side

import basix
from hypergap_dolfinx.gap import update
from hypergap_dolfinx.gap.kernel import GapElement, alpha_derivatives, geometry_at_points
from hypergap_dolfinx.gap.slab import fill, mesh_slab
from hypergap_dolfinx.gap.update import moved, update_slab

pytestmark = pytest.mark.serial
ALONE = MPI.COMM_SELF
SLIPS = (0.1, 0.3, 1.0, 3.0)  # in edges


def ball(n, seed):
    """A triangulated unit sphere, and the length of its edges."""
    scipy_spatial = pytest.importorskip("scipy.spatial")
    i = np.arange(n) + 0.5
    z, angle = 1 - 2 * i / n, 2 * np.pi * i * 0.618034 + seed
    x = np.column_stack((np.cos(angle), np.sin(angle), z))
    x[:, :2] *= np.sqrt(1 - z**2)[:, None]
    x += 0.1 * np.random.default_rng(seed).uniform(-1, 1, x.shape) * np.sqrt(14 / n)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    t = scipy_spatial.ConvexHull(x).simplices
    inwards = np.linalg.det(x[t]) < 0
    t[inwards] = t[inwards][:, ::-1]
    return x, t, np.sqrt(14 / n)


def plane(n, seed, height=0.0, size=1.0, at=(0.0, 0.0)):
    """A triangulated square."""
    rng = np.random.default_rng(seed)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
    x = np.column_stack((i / n, j / n, 0 * i + height))
    inner = (i % n > 0) & (j % n > 0)
    x[inner, :2] += 0.15 / n * rng.uniform(-1, 1, (inner.sum(), 2))
    x[:, :2] = size * x[:, :2] + at
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    turned = rng.random(len(a)) < 0.3
    one = np.where(turned, (a, a + n + 1, a + 1), (a, a + n + 1, a + n + 2)).T
    two = np.where(turned, (a + n + 1, a + n + 2, a + 1), (a, a + n + 2, a + 1)).T
    return x, np.vstack((one, two)), size / n


def surfaces(one, other):
    """Γ0, and Γ1 turned to it."""
    turned = other[1][:, ::-1]
    return side("Γ0", *one[:2]).surface, side("Γ1", other[0], turned).surface


def check(gap):
    """All that makes a Σ of one piece valid."""
    (slab,) = gap.slabs
    check_cells(slab)
    for name in ("x", "alpha", "cells", "normal"):
        np.testing.assert_array_equal(getattr(gap, name), getattr(slab, name))
    # Hosts are where the vertices are
    points = np.vstack((np.zeros(3), np.eye(3)))
    hosts = gap.hosts(points, np.arange(len(gap.cells)))
    x = gap.x[gap.cells]
    for i, weight in enumerate((1 - hosts.alpha, hosts.alpha)):
        surface = slab.sides[i].surface
        at = surface.points(hosts.facets[i].ravel(), hosts.X[i].reshape(-1, 2)).reshape(x.shape)
        assert np.abs((at - x)[weight == 1]).max() < 1e-14


def differences(gap):
    """∫∫ ∂φ_a/∂α dΓ_α dα at the vertices, and ∫φ_a over Γ1 less that over Γ0."""
    P1 = basix.create_element(basix.ElementFamily.P, basix.CellType.tetrahedron, 1)
    tables = GapElement.with_quadrature(P1, P1, 4)
    N, v = geometry_at_points(tables, gap.x[gap.cells], gap.alpha[gap.cells])
    weights = tables.weights * np.linalg.norm(N, axis=2)
    each = np.einsum("cp,cpa->ca", weights, alpha_derivatives(tables, v))
    actual = np.bincount(gap.cells.ravel(), each.ravel(), minlength=len(gap.x))
    exact = np.zeros(len(gap.x))
    for i, own in enumerate(gap.slabs[0].sides):
        x = own.x[own.triangles]
        area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1) / 2
        corner = gap.slabs[0].offsets[i] + own.triangles.ravel()
        exact += (2 * i - 1) * np.bincount(corner, np.repeat(area / 3, 3), minlength=len(exact))
    return actual, exact


def slid(gap, pair, place):
    """Γ1's vertices go elsewhere: Σ after it, whether it is rebuilt, and how much cheaper it is."""
    new = moved(pair[1], place(pair[1].nodes))
    start = time.process_time()
    gap, rebuilt = update_slab(ALONE, gap, pair[0], new)
    middle = time.process_time()
    mesh_slab(ALONE, pair[0], new)
    return gap, rebuilt, (middle - start) / (time.process_time() - middle)


@pytest.mark.parametrize("n", ((150, 260), (700, 400)))
def test_a_ball_turns_in_its_shell(n):
    """Its cells are kept while they can be."""
    one, other = (ball(k, seed) for seed, k in enumerate(n))
    pair = surfaces(one, other)
    first = mesh_slab(ALONE, *pair)
    h = min(one[2], other[2])
    for slip in SLIPS:

        def turn(x, angle=slip * h):
            c, s = np.cos(angle), np.sin(angle)
            return x @ np.array([(1, 0, 0), (0, c, s), (0, -s, c)])

        gap, rebuilt, ratio = slid(first, pair, turn)
        check(gap)
        same = gap.cells.shape == first.cells.shape and (gap.cells == first.cells).all()
        assert rebuilt != same
        assert rebuilt == (slip == 3) or slip == 1
        print(f"slip {slip} h: {'others' if rebuilt else 'kept'}, {ratio:.2f} of the time")


@pytest.mark.parametrize("steps", (1, 6))
def test_a_plane_slides_over_a_plane(steps):
    """Its rim stays: integrals stay exact, from the first cells or from step to step."""
    one, other = plane(8, 0), plane(11, 1, 0.05)
    pair = surfaces(one, other)
    gap = first = mesh_slab(ALONE, *pair)
    for slip in SLIPS if steps == 1 else np.linspace(0, 3, steps + 1)[1:]:

        def slide(x, way=slip * other[2]):
            bump = 16 * x[..., 0] * (1 - x[..., 0]) * x[..., 1] * (1 - x[..., 1])
            return x + 0.7 * way * bump[..., None] * np.array((0.8, 0.6, 0))

        gap, rebuilt, ratio = slid(first if steps == 1 else gap, pair, slide)
        check(gap)
        actual, exact = differences(gap)
        np.testing.assert_allclose(actual, exact, rtol=0, atol=1e-15)
        print(f"slip {slip} h: {'others' if rebuilt else 'kept'}, {ratio:.2f} of the time")


def test_what_was_cut_is_cut_anew():
    """A small plane over a large one: their common outline moves on the large one."""
    pair = surfaces(plane(8, 0), plane(5, 1, 0.0, 0.5, (0.2, 0.3)))
    gap = mesh_slab(ALONE, *pair)
    gap, rebuilt, _ = slid(gap, pair, lambda x: x + np.array((0.03, 0, 0)))
    actual, _ = differences(gap)
    assert rebuilt and abs(actual[gap.alpha == 1].sum() - 0.25) < 1e-14
    gap, _, _ = slid(gap, pair, lambda x: x + np.array((0.5, 0, 0)))  # over the edge
    actual, _ = differences(gap)
    assert abs(actual[gap.alpha == 1].sum() - 0.15) < 1e-14


def test_only_the_piece_is_filled_anew(monkeypatch):
    """What faces what isn't asked again."""
    pair = surfaces(plane(8, 0), plane(9, 1, 0.01))
    gap = mesh_slab(ALONE, *pair)
    made = []
    monkeypatch.setattr(update, "fill", lambda sides: made.append(1) or fill(sides))
    nodes = pair[1].nodes
    new = moved(pair[1], np.stack((nodes[..., 0] ** 3, *nodes.T[1:].swapaxes(1, 2)), axis=-1))
    gap, rebuilt = update_slab(ALONE, gap, pair[0], new)
    check(gap)
    assert rebuilt and made


def test_other_surfaces_are_refused():
    """They aren't the ones that there were."""
    pair = surfaces(plane(4, 0), plane(5, 1))
    gap = mesh_slab(ALONE, *pair)
    with pytest.raises(ValueError, match="Γ1 has other facets"):
        update_slab(ALONE, gap, pair[0], surfaces(plane(4, 0), plane(6, 1))[1])
