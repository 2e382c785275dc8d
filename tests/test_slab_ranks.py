# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Σ in space is the same on any number of ranks, when it is made and when it follows surfaces."""

import runpy
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
from helpers import comm

from dolfinx import fem
from hypergap_dolfinx import Tie
from hypergap_dolfinx.gap.slab import mesh_slab
from hypergap_dolfinx.gap.update import moved, update_slab

pytestmark = pytest.mark.ranks(2)
ANY_SURFACES = Path(__file__).parents[1] / "demos" / "any_surfaces.py"


@pytest.fixture(scope="module")
def demo():
    """The functions of the demo."""
    pytest.importorskip("scipy")
    return runpy.run_path(str(ANY_SURFACES))


def ties(demo, seed, degree, on):
    """A scene of the demo, its bodies distributed."""
    _, shapes = demo["scene"](seed, degree)
    ends = []
    for shape, outwards in zip(shapes, (True, False), strict=True):
        mesh, facets = demo["layer"](*shape, outwards, comm=on)
        ends.append((fem.functionspace(mesh, ("Lagrange", degree)), facets))
    return Tie(*ends)


def moments(x, alpha, scale, on):
    """Number of cells, and sums over them that other cells would not have."""
    middle = x.mean(axis=1) / scale
    wave = np.cos(middle @ (3, 5, 7)) + (alpha * np.sin(middle[:, :1] * (2, 3, 5, 7))).sum(axis=1)
    return on.allreduce(len(x)), on.allreduce(wave.sum())


@pytest.mark.parametrize(("seed", "degree"), ((19, 2), (1069, 2), (180, 1)))
def test_any_surfaces(demo, seed, degree):
    """Σ of a scene is what one rank makes of it, interior nodes and straight edges included."""
    alone, domain = (ties(demo, seed, degree, on).domain for on in (MPI.COMM_SELF, comm))
    scale = np.ptp(alone.x)
    num, wave = moments(alone.x[:, :4], alone.alpha_vertices, scale, MPI.COMM_SELF)
    assert demo["stands_up"](domain)
    each, here = moments(domain.x[:, :4], domain.alpha_vertices, scale, comm)
    assert each == num and abs(here - wave) < 1e-11 * num


def test_update(demo):
    """Cells are kept on all ranks or on none, and are the same."""
    surfaces = ties(demo, 180, 1, comm).domain.surfaces
    first = mesh_slab(comm, *surfaces)
    for way, expected in ((0.01, False), (0.6, True)):
        x = surfaces[1].nodes
        size = way * surfaces[1].size.mean()
        new = moved(surfaces[1], x + size * np.sin(7 * x[..., [1, 2, 0]] / np.ptp(x)))
        made = [update_slab(on, first, surfaces[0], new) for on in (comm, MPI.COMM_SELF)]
        assert [rebuilt for _, rebuilt in made] == [expected] * 2
        gap, alone = (each for each, _ in made)
        np.testing.assert_array_equal(gap.cells, alone.cells)
        np.testing.assert_array_equal(gap.x, alone.x)
        points = np.full((1, 3), 0.25)
        one, other = (each.hosts(points, np.arange(len(gap.cells))) for each in (gap, alone))
        for i in (0, 1):
            np.testing.assert_array_equal(one.facets[i], other.facets[i])
