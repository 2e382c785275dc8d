# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What differs between the versions of DOLFINx and PETSc, and the PETSc that won't do."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

import meshes
from dolfinx import fem
from hypergap_dolfinx.core import compat

pytestmark = pytest.mark.ranks

comm = MPI.COMM_WORLD


@pytest.mark.parametrize("num", (0, 1, 500))
def test_triplets_are_added_up(num):
    """Rows of any rank, in any order, several times; ranks without triplets."""
    rng = np.random.default_rng(comm.rank)
    n = 7 * comm.size
    num = num if comm.rank in (0, comm.size - 1) else 0
    i, j, values = rng.integers(0, n, num), rng.integers(0, n, num), rng.random(num)
    A = PETSc.Mat().create(comm)
    A.setSizes(((7, None), (7, None)))
    A.setType(PETSc.Mat.Type.AIJ)
    compat.set_triplets(A, i, j, values)
    expected = np.zeros((n, n))
    np.add.at(expected, (i, j), values)
    expected = comm.allreduce(expected)[7 * comm.rank :][:7]
    indptr, columns, entries = A.getValuesCSR()
    dense = np.zeros_like(expected)
    dense[np.repeat(np.arange(7), np.diff(indptr)), columns] = entries
    np.testing.assert_allclose(dense, expected, atol=1e-14)
    A.destroy()


@pytest.mark.parametrize("shape", ((), (2,)))
def test_vector_has_ghosts(shape):
    mesh, _ = meshes.block(comm, (5, 4))
    V = fem.functionspace(mesh, ("Lagrange", 2, shape))
    b, u = compat.create_vector(V), fem.Function(V)
    assert b.getSizes() == (
        V.dofmap.index_map.size_local * V.dofmap.index_map_bs,
        V.dofmap.index_map.size_global * V.dofmap.index_map_bs,
    )
    assert b.getBlockSize() == V.dofmap.index_map_bs
    with b.localForm() as local:
        assert local.getSize() == len(u.x.array)
    b.destroy()


@pytest.mark.parametrize("shape, cell", (((3, 2), "triangle"), ((2, 2, 2), "hexahedron")))
def test_facets_of_ranks_that_have_none(shape, cell):
    """DOLFINx 0.9 kills the process where an interface has no facets on a rank."""
    mesh, _ = meshes.block(comm, shape, cell=cell)
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    num = 0 if comm.rank == comm.size - 1 else mesh.topology.index_map(dim - 1).size_local
    nodes = compat.entities_to_geometry(mesh, dim - 1, np.arange(num, dtype=np.int32))
    assert nodes.shape == (num, 2 if dim == 2 else 4)
    assert nodes.dtype == np.int32
