# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The same displacements on any number of ranks, also where ranks own nothing of the interface."""

import gc

from mpi4py import MPI

import numpy as np
import patch_test
import pressurised_cylinder
import pytest
from test_contact import Blocks

import meshes
import ufl
from dolfinx import fem
from hypergap_dolfinx import Tie, TiedProblem
from hypergap_dolfinx.core import compat

pytestmark = pytest.mark.ranks

comm = MPI.COMM_WORLD


def gathered(u):
    """Displacements at all nodes, sorted by the nodes' places; on every rank."""
    V = u.function_space
    owned = V.dofmap.index_map.size_local
    x = V.tabulate_dof_coordinates()[:owned, :2]
    values = u.x.array.reshape(-1, V.dofmap.index_map_bs)[:owned]
    x, values = (np.vstack(V.mesh.comm.allgather(part)) for part in (x, values))
    return values[np.lexsort(np.round(x, 9).T)]


def difference(us, references):
    """Largest relative difference of the displacements."""
    a, b = (np.vstack([gathered(u) for u in functions]) for functions in (us, references))
    return np.abs(a - b).max() / np.abs(b).max()


@pytest.mark.parametrize("degree", (1, 2))
def test_cylinder(degree):
    us, references = (
        pressurised_cylinder.run(c, 2, degree, "quadrilateral", False)[1].u
        for c in (comm, MPI.COMM_SELF)
    )
    assert difference(us, references) <= 3e-11  # ε × condition; up to 1.1e-12 seen


def by_height(downwards):
    """A partitioner for 8 × 6 cells: lots of rows, dealt to the ranks from the top or bottom on."""

    def partition(c, num_parts, cell_types, cells):
        num_cells = len(cells[0]) // 4
        start = sum(c.allgather(num_cells)[: c.rank])
        row = (start + np.arange(num_cells)) % 6
        rank = (5 - row if downwards else row) * c.size // 6
        return compat.destinations(rank)

    return partition


def solve_poisson(c, swap):
    """Two blocks whose interface belongs to the last rank alone."""
    V, forms, loads, bcs, sides = [], [], [], [], []
    for body, (inner, outer) in enumerate(
        ((meshes.BOTTOM, meshes.TOP), (meshes.TOP, meshes.BOTTOM))
    ):

        def mapping(x, body=body):
            return np.column_stack((x[:, 0] ** (1 + 0.3 * body), x[:, 1] - body))

        mesh, ft = meshes.block(c, (8, 6), mapping, partitioner=by_height(body == 0))
        W = fem.functionspace(mesh, ("Lagrange", 2))
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        x = ufl.SpatialCoordinate(mesh)
        V.append(W)
        forms.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        loads.append(ufl.sin(3 * x[0] + x[1]) * v * ufl.dx)
        dofs = fem.locate_dofs_topological(W, 1, ft.find(outer))
        bcs.append(fem.dirichletbc(0.0, dofs, W))
        sides.append((W, ft.find(inner)))
    tie = Tie(*(sides[::-1] if swap else sides))
    return TiedProblem(forms, loads, bcs=bcs, ties=[tie]).solve(), tie


@pytest.mark.parametrize("swap", (False, True))
def test_interface_on_one_rank(swap):
    us, tie = solve_poisson(comm, swap)
    references, _ = solve_poisson(MPI.COMM_SELF, swap)
    assert difference(us, references) <= 1e-12
    for surface in tie.surfaces:
        assert set(surface.owner) == {comm.size - 1}


@pytest.mark.parametrize("shape", ("skew", "kinked"))
def test_patch(shape):
    elements = patch_test.ELEMENTS["P1-P2"]
    for c in (comm, MPI.COMM_SELF):
        errors = patch_test.solve(c, elements, shape, (2, 3), False, patch_test.stretching)
        assert max(errors) <= 1e-12


def communicators(wanted=2100):
    """How many more there can be: MPICH has 2046 in all. Collective."""
    found = []
    try:
        while len(found) < wanted:
            found.append(comm.Dup())
    except MPI.Exception:
        pass
    for c in found:
        c.Free()
    return len(found)


@pytest.mark.ranks(2)
@pytest.mark.parametrize("kind", ("tie", "contact"))
def test_nothing_is_kept(kind):
    """Problems that have gone take their communicators with them."""

    def solve():
        if kind == "tie":
            solve_poisson(comm, False)
        else:
            scene = Blocks(gap=0.02)
            scene.top.value = -0.05
            scene.problem.solve()

    left = []
    for _ in range(3):
        solve()
        gc.collect()
        left.append(communicators())
    assert left[2] >= left[0]
