# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Surfaces that go through walls of others."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

import meshes
from dolfinx import fem
from hypergap_dolfinx.surface.moving import MovingSurface, went_through
from hypergap_dolfinx.surface.trace import create_surface

comm = MPI.COMM_WORLD


def moved(n, size, low, ways):
    """All facets of a block under displacements, which are functions of x and y."""
    mesh, ft = meshes.block(comm, n, lambda x: x * size + low, cell="quadrilateral")
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    side = MovingSurface(create_surface(V, np.sort(ft.indices), "Γ"))
    x = np.empty((len(side.dofs), 2))
    x[np.searchsorted(side.dofs, side.vertex_dofs)] = side.reference.x
    found = (np.broadcast_to(np.transpose(way(*x.T)), x.shape) for way in ways)
    return tuple(side.displaced(u) for u in found)


@pytest.mark.parametrize("start", (0.01, -0.009))
def test_starts_behind(start):
    """A strip that snaps up into a block, to whose lower face it was near, on either side."""
    strip = moved((6, 1), (1, 0.04), (0, -0.04), (lambda x, y: (0, 0), lambda x, y: (0, 0.1)))
    block = moved((1, 1), (0.2, 0.2), (0.41, start), (lambda x, y: (0, 0),) * 2)
    passed, _ = went_through((strip, block), 1e-6)[0]
    np.testing.assert_allclose(strip[0].x[passed], [(0.5, 0)], atol=1e-12)


@pytest.mark.parametrize("depth", (0.02, 0.03))
def test_past_an_end(depth):
    """A plate's end goes over a block's upper face, of which the free part rises behind it.

    Not if that is deeper than the plate's middle.
    """
    ends = [lambda x, y, e=e: (0 * x, -depth * (y > 0.4) * (x > e)) for e in (-1, 0.4)]
    block = moved((10, 1), (1, 0.5), (0, 0), ends)
    low = (-0.5, 0.5 - depth)
    plate = moved((12, 1), (2, 0.05), low, (lambda x, y: (0, 0), lambda x, y: (0.9, 0)))
    found = [len(part) for of in went_through((block, plate), 1e-6) for part in of]
    assert (sum(found) > 0) == (depth > 0.025)


def test_tapered_plate():
    """A plate of a single cell, .5 thick at one end, is passed by more than half of the other."""
    ways = [lambda x, y, t=t: (0 * x + t, (0.46 - y) * (x + 1.45) * 0.45) for t in (0, 0.9)]
    block = moved((10, 1), (1, 0.5), (0, 0), (lambda x, y: (0, 0),) * 2)
    plate = moved((1, 1), (2, 0.5), (-1.45, 0.46), ways)
    passed, _ = went_through((block, plate), 1e-6)[0]
    assert len(passed)


def test_thin_end_of_a_wedge():
    """A wedge of a single cell is passed where it is far thinner than in its middle."""
    wedge = moved((1, 1), (1, 0.1), (0, 0), (lambda x, y: (0 * x, (0.1 - y) * x * 0.8),) * 2)
    block = moved((1, 1), (0.1, 0.1), (0.8, 0.11), (lambda x, y: (0, 0), lambda x, y: (0, -0.5)))
    passed, _ = went_through((block, wedge), 1e-6)[0]
    assert len(passed) == 4


@pytest.mark.parametrize("depth", (0.04, 0.06))
def test_end_on(depth):
    """A plate goes through a block end-on, near its upper face, but deeper than it is thick."""
    still = (lambda x, y: (0, 0),) * 2
    block = moved((6, 6), (0.5, 0.5), (0, 0), still)
    low = (-0.81, 0.47 - depth)
    plate = moved((2, 1), (0.8, 0.03), low, (still[0], lambda x, y: (1.5, 0)))
    passed, _ = went_through((plate, block), 1e-6)[0]
    assert len(passed)


def test_slantwise():
    """A plate goes through a block's corner, whatever the last digits: its end is parallel to ways.

    Its end is deeper in the block's corner than the plate is thick.
    """
    still, rng = (lambda x, y: (0, 0),) * 2, np.random.default_rng(0)
    block = moved((1, 1), (0.6, 0.6), (-0.6, -0.6), still)
    plate = moved((4, 1), (1.6, 0.08), (0.02, -0.02), (still[0], lambda x, y: (-2, -0.6)))
    for noise in (0, *([1e-13] * 10)):
        two = [
            tuple(replace(s, x=s.x + noise * rng.standard_normal(s.x.shape)) for s in side)
            for side in (plate, block)
        ]
        passed, _ = went_through(two, 1e-6)[0]
        assert len(passed) == 10


def test_corner():
    """A corner in more than half of a strip isn't through, but named."""
    strip = moved((6, 1), (1, 0.04), (0, -0.04), (lambda x, y: (0, 0),) * 2)
    block = moved(
        (1, 1),
        (0.2, 0.2),
        (0.41, 0.01),
        (lambda x, y: (0, 0), lambda x, y: (0 * x, 0.1 * x - 0.086)),
    )
    passed, corners = went_through((block, strip), 1e-6)[0]
    assert not len(passed)
    np.testing.assert_allclose(block[0].x[corners], [(0.41, 0.01)], atol=1e-12)
