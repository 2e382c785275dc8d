# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Σ in space is the same on any number of ranks, interior nodes included."""

import runpy
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
from helpers import comm

import dolfinx
from dolfinx import fem
from hypergap_dolfinx import Tie

pytestmark = pytest.mark.ranks(2)
ANY_SURFACES = Path(__file__).parents[2] / "demos" / "any_surfaces.py"


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


def test_cells_stay_together():
    """A rank has the cells at its facets of Γ1, wherever Γ0's are: Σ isn't cut into pieces."""
    ends = []
    for i, swaps in enumerate((slice(None), slice(None, None, -1))):
        low, high = (0, 0, i), (2, 1, i + 1)
        whole = dolfinx.mesh.create_box(comm, (low, high), (12 - i, 6, 1))
        whole.geometry.x[:, :2] = (whole.geometry.x[:, :2] / (2, 1))[:, swaps]
        at = dolfinx.mesh.locate_entities_boundary(whole, 2, lambda x: np.isclose(x[2], 1))
        ends.append((fem.functionspace(whole, ("Lagrange", 1)), at))
    domain = Tie(*ends).domain
    facets = domain.hosts.facets[1][domain.alpha_vertices == 1]
    beside = domain.surfaces[1].owner[facets] == comm.rank
    num = (domain.alpha_vertices == 1).sum(axis=1)
    assert np.logical_or.reduceat(beside, np.cumsum(num) - num).all()
