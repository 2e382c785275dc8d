# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What faces what: whole boundaries of bodies, and kinks of both sides beside each other."""

import numpy as np
import pytest
from helpers import comm, interpolated, residual
from test_front import check_cells, side

from dolfinx import fem
from dolfinx.mesh import CellType, create_box, exterior_facet_indices, locate_entities_boundary
from hypergap_dolfinx import Tie
from hypergap_dolfinx.gap_mesh.slab import fill
from hypergap_dolfinx.surface.pieces import Side
from hypergap_dolfinx.trimming.clip import clip
from hypergap_dolfinx.trimming.parting import pairs_of_pieces


def sides(cell, corner, whole):
    """A block on a plate or on another one: all its boundary, or only the face that touches."""
    found = []
    for i, (low, high, n) in enumerate(
        ((corner, (2, 1, 0), (3, 3, 1)), ((0, 0, 0), (1, 1, 1), (2, 2, 2)))
    ):
        mesh = create_box(comm, [low, high], n, cell_type=cell)
        V = fem.functionspace(mesh, ("Lagrange", 1))
        mesh.topology.create_connectivity(2, 3)
        facets = exterior_facet_indices(mesh.topology)
        if not whole[i]:
            facets = locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[2], 0))
        found.append((V, facets))
    return found


@pytest.mark.ranks(2, cell=[CellType.tetrahedron], corner=[(-1, 0, -1)])
@pytest.mark.parametrize("corner", ((0, 0, -0.3), (-1, 0, -1), (-0.4, -0.3, -1)))
@pytest.mark.parametrize("cell", (CellType.tetrahedron, CellType.hexahedron))
def test_whole_boundaries(cell, corner):
    """Σ is that of the faces that touch."""

    def f(x):
        return 1 + x[0] - 2 * x[1] + 0.5 * x[2]

    num = []
    for whole in ((False, False), (True, True), (True, False), (False, True)):
        tie = Tie(*sides(cell, corner, whole))
        num.append(comm.allreduce(len(tie.domain.x)))
        assert residual(tie, *(interpolated(V, f) for V in tie.spaces)) < 1e-13
    assert num[1:] == num[:1] * 3


def ridge(middle, n):
    """A roof whose ridge runs from place to place, with gutters that are straight."""
    y = np.linspace(0, 2, n + 1)
    x = np.column_stack((np.full(n + 1, -1.0), [middle[j % len(middle)] for j in range(n + 1)]))
    x = np.column_stack((x, np.ones(n + 1)))
    points = np.stack((x, np.broadcast_to(y[:, None], x.shape), 0 * x - (0.4, 0, 0.4)), 2)
    a = (3 * np.arange(n)[:, None] + (0, 1)).ravel()
    t = np.vstack((np.column_stack((a, a + 1, a + 4)), np.column_stack((a, a + 4, a + 3))))
    return points.reshape(-1, 3), t


@pytest.mark.serial
@pytest.mark.parametrize(("middle", "num"), (((0.0,), 2), ((0.0, 0.15, 0.15, 0.15), 1)))
def test_kinks_beside_each_other(middle, num):
    """Pieces part at a ridge, but not where the other side has it elsewhere."""
    x, t = ridge((0.0,), 3)
    pair = side("Γ0", *ridge(middle, 4)).surface, side("Γ1", x, t[:, ::-1]).surface
    groups, found, _ = pairs_of_pieces(*pair)
    assert found == num == len(np.unique(groups[0])) == len(np.unique(groups[1]))
    for g in range(num):
        whole = [Side.of(s, np.flatnonzero(own == g)) for s, own in zip(pair, groups, strict=True)]
        (common,) = clip(*whole)
        assert [one.is_whole for one in common] == [True, True]
        check_cells(fill(common))


@pytest.mark.serial
@pytest.mark.parametrize("swap", (False, True))
def test_a_kink_parts_where_the_other_side_has_ended(swap):
    x, t = ridge((0.0,), 7)
    ends = [(x, t), (x * (1, 0.5, 1) + (0, 0.45, 0), t)]
    (x0, t0), (x1, t1) = ends[::-1] if swap else ends
    pair = side("Γ0", x0, t0).surface, side("Γ1", x1, t1[:, ::-1]).surface
    groups, found, _ = pairs_of_pieces(*pair)
    assert found == 2
    for surface, own in zip(pair, groups, strict=True):
        across = surface.x[surface.facets].mean(axis=1)[:, 0] > 0
        assert len(np.unique(own[across])) == len(np.unique(own[~across])) == 1
