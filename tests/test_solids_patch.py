# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The linear patch test of structured tetrahedra: few facets against many, skew in space."""

from dataclasses import replace
from itertools import permutations, product

from mpi4py import MPI

import numpy as np
import pytest
from helpers import comm
from test_solids_interfaces import NOTHING, NU, linear, tied

import basix
import meshes
from hypergap_dolfinx.gap import flat_cells
from hypergap_dolfinx.gap.cells import Hosts
from hypergap_dolfinx.gap.pieces import Side
from hypergap_dolfinx.gap.slab_cells import Slab
from hypergap_dolfinx.gap.surface import Surface

pytest.importorskip("gmsh")


def sheared(x):
    """x = tan 25° (y + z) is the interface."""
    return np.column_stack((x[:, 0] + np.tan(np.radians(25)) * (x[:, 1] + x[:, 2]), x[:, 1:]))


def leaning(x):
    """The bodies' sides lean by 25° in both directions; the interface is x = 0."""
    return x + np.tan(np.radians(25)) * x[:, :1] * np.array((0, 1, 1))


def turned(x):
    """25° about two axes."""
    c, s = np.cos(np.radians(25)), np.sin(np.radians(25))
    about_z = np.array([(c, s, 0), (-s, c, 0), (0, 0, 1)])
    about_y = np.array([(c, 0, -s), (0, 1, 0), (s, 0, c)])
    return x @ about_z @ about_y


def sheared_and_turned(x):
    return turned(sheared(x))


SKEWS = (sheared, leaning, turned, sheared_and_turned)


def blocks(n, mapping):
    """Of each block beside x = 0: its mesh and its facets there and at the far end."""
    bodies = []
    for i, ends in enumerate(((meshes.RIGHT, meshes.LEFT), (meshes.LEFT, meshes.RIGHT))):

        def place(x, i=i):
            return mapping(x + np.array((i - 1, 0, 0)))

        mesh, ft = meshes.block(comm, (1, n[i], n[i]), place, cell="tetrahedron")
        bodies.append((mesh, *(ft.find(tag) for tag in ends)))
    return bodies


def patch_errors(n, mapping, degree):
    """Relative errors of displacement, stress (L²) and traction (its largest)."""
    (near, facets0, held), (far, facets1, _) = blocks(n, mapping)
    bodies = ((near, facets0, held), (far, facets1, NOTHING))
    l2, s, problem, tie = tied(bodies, linear, (degree, degree))
    gradient = np.array(linear(np.eye(3)))
    strain = (gradient + gradient.T) / 2
    sigma = (strain + NU / (1 - 2 * NU) * np.trace(strain) * np.eye(3)) / (1 + NU)
    q = tie.quadrature(2 * degree)
    error = q.evaluate(tie.traction(problem)) - q.normal @ sigma
    worst = comm.allreduce(np.abs(error).max(initial=0), MPI.MAX)
    return l2, s, worst / np.abs(sigma).max()


def check(n, mapping, degree):
    l2, s, traction = patch_errors(n, mapping, degree)
    print(n, mapping.__name__, degree, l2, s, traction)
    # Seen: 1e-13 and 6e-13 for degree 1, 7e-13 and 2e-10 for degree 2
    assert max(l2, s) <= 1e-11
    assert traction <= (1e-10, 1e-8)[degree - 1]


@pytest.mark.parametrize(
    "n, mapping, degree",
    (
        *[(n, sheared, 1) for n in ((1, 1), (1, 5), (1, 7), (1, 8), (2, 6))],
        *[(n, sheared_and_turned, 1) for n in ((3, 1), (5, 1), (8, 1))],
        *[(n, sheared, 2) for n in ((1, 1), (1, 5))],
        *[((1, 4), mapping, 1) for mapping in SKEWS],
    ),
)
def test_patch(n, mapping, degree):
    """Each facet of both sides is there: no diagonal is turned, also where cells lie flat on it."""
    check(n, mapping, degree)


@pytest.mark.slow
@pytest.mark.parametrize("degree", (1, 2))
@pytest.mark.parametrize("mapping", SKEWS)
def test_patch_of_all_pairs(mapping, degree):
    for n in product(range(1, 9), repeat=2):
        check(n, mapping, degree)


# What is made of flat cells


def square(z, turn) -> Surface:
    """Two facets on the corners of the unit square at a height, (0, 0) to (1, 1) their diagonal."""
    x = np.array([(0, 0, z), (0, 1, z), (1, 0, z), (1, 1, z)], dtype=float)
    facets = np.array([(0, 2, 3), (0, 3, 1)])[:, ::turn]
    element = basix.create_element(basix.ElementFamily.P, basix.CellType.triangle, 1)
    return Surface(
        name=f"Γ{z}",
        x=x,
        facets=facets.astype(np.int32),
        nodes=x[facets],
        dofs=facets.astype(np.int64),
        owner=np.zeros(2, dtype=np.int32),
        geometry=element,
        element=element,
        dof_range=np.array((0, 4)),
    )


def cube() -> Slab:
    """Six cells around the cube's diagonal, between two squares."""
    sides = [Side.of(square(z, turn), np.arange(2)) for z, turn in ((0, 1), (1, -1))]
    corner = np.array([(0, 4), (1, 5), (2, 6), (3, 7)])  # (2 x + y, z)
    cells = []
    for axes in permutations(range(3)):
        at = np.vstack((np.zeros(3, dtype=int), np.cumsum(np.eye(3, dtype=int)[list(axes)], 0)))
        cells.append(corner[2 * at[:, 0] + at[:, 1], at[:, 2]])
    none = np.empty((1, 0), dtype=np.intp), np.empty((1, 0), dtype=np.intp)
    places = np.empty((1, 0, 2)), np.empty((1, 0, 2))
    return oriented(Slab(tuple(sides), np.array(cells), Hosts(np.empty((1, 0)), none, places)))


def oriented(mesh: Slab) -> Slab:
    """Cells that have a content have it positive."""
    turned = flat_cells.turned_over(mesh)[:, None]
    return replace(mesh, cells=np.where(turned, mesh.cells[:, [0, 2, 1, 3]], mesh.cells))


@pytest.mark.parametrize("side", (0, 1))
def test_flat_cell_on_facets(side):
    """It is no wall: to take it away would turn the facets' diagonal."""
    good = cube()
    assert flat_cells.error_of(good) is None
    a, b, c, d = np.arange(4) + 4 * side
    apex = 7 - 7 * side
    on = np.isin(good.cells, (a, b, c, d)).sum(axis=1) == 3
    cells = np.vstack((good.cells[~on], (a, b, c, apex), (b, c, d, apex), (a, b, c, d)))
    bad = oriented(replace(good, cells=cells))
    peeled = flat_cells._without_flat_walls(bad)
    assert len(peeled.cells) == 7
    assert "1 cells are flat" in flat_cells.error_of(peeled)[0]
    back = flat_cells.without_flat_cells(bad)
    assert len(back.cells) == 6 and flat_cells.error_of(back) is None
    peeled = replace(bad, cells=bad.cells[:-1])
    assert "2 facets are no faces" in flat_cells.error_of(peeled)[0]


def test_flat_cell_in_a_wall():
    """It is taken away, and the wall has its other diagonal."""
    good = cube()
    flat = replace(good, cells=np.vstack((good.cells, (0, 1, 4, 5))))
    assert "1 cells are flat" in flat_cells.error_of(flat)[0]
    np.testing.assert_array_equal(flat_cells._without_flat_walls(flat).cells, good.cells)


def test_cells_that_do_not_fit():
    good = cube()
    inside = ~(flat_cells.faces_of(good)[2]).any(axis=1)
    twice = replace(good, cells=np.vstack((good.cells, good.cells[inside][:1])))
    assert "faces don't fit" in flat_cells.error_of(twice)[0]
