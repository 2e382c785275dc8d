# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Connected parts of graphs and meshes."""

from mpi4py import MPI

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import dolfinx
from dolfinx import fem
from hypergap_dolfinx.core.graph import components, parts

comm = MPI.COMM_WORLD


@pytest.mark.parametrize("num_edges", (0, 1, 30, 90, 400))
def test_components(num_edges):
    """As SciPy's; also chains, whose labels have far to go."""
    rng = np.random.default_rng(num_edges)
    num = 100
    random = rng.integers(num, size=(2, num_edges))
    order = rng.permutation(num)
    chain = np.stack((order[:60], order[1:61]))
    for i, j in (random, chain, np.hstack((random, chain))):
        graph = coo_array((np.ones(len(i)), (i, j)), shape=(num, num))
        count, expected = connected_components(graph, directed=False)
        found = components(num, i, j)
        assert found.max() + 1 == count
        assert len(np.unique(np.stack((found, expected)), axis=1).T) == count


@pytest.mark.ranks
@pytest.mark.parametrize("degree", (1, 2))
def test_parts(degree):
    """Stripes of a square, each of them on several ranks."""
    mesh = dolfinx.mesh.create_unit_square(comm, 12, 10)
    tdim = mesh.topology.dim
    num = mesh.topology.index_map(tdim).size_local
    x = dolfinx.mesh.compute_midpoints(mesh, tdim, np.arange(num, dtype=np.int32))
    for stripes in (1, 3):
        cells = np.flatnonzero(np.floor(x[:, 1] * (2 * stripes - 1)) % 2 == 0)
        submesh = dolfinx.mesh.create_submesh(mesh, tdim, cells.astype(np.int32))[0]
        V = fem.functionspace(submesh, ("Lagrange", degree, (2,)))
        found, num_parts = parts(V)
        assert num_parts == stripes
        y = V.tabulate_dof_coordinates()[: len(found), 1]
        stripe = np.floor(np.clip(y * (2 * stripes - 1), 0, 2 * stripes - 1.001) / 2 + 0.25)
        pairs = np.vstack(comm.allgather(np.stack((found, stripe), axis=1)))
        assert len(np.unique(pairs, axis=0)) == stripes == len(np.unique(pairs[:, 0]))
