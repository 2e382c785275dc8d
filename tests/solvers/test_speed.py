# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What must not get slow: shapes of the cost, never seconds (demos/kernel_speed.py tells them)."""

import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from helpers import comm, two_blocks

import hypergap_dolfinx
import meshes
from dolfinx import fem
from hypergap_dolfinx import Tie
from hypergap_dolfinx.gap_mesh import strip

PACKAGE = str(Path(hypergap_dolfinx.__file__).parent)


def test_chains_are_followed_in_a_few_steps():
    """No step an edge: a chain and a loop, whatever the order of their edges."""
    random = np.random.default_rng(0)
    n = 1000
    previous = np.append(np.arange(-1, n - 1), n + np.roll(np.arange(n), 1))
    shuffle = random.permutation(2 * n)
    number = np.argsort(shuffle)  # the new number of an edge
    shuffled = np.where(previous[shuffle] >= 0, number[previous[shuffle]], -1)
    first, place, smallest = strip._trace(shuffled)
    chain = shuffle < n
    assert (first[chain] == number[0]).all() and (place[chain] == shuffle[chain]).all()
    assert (smallest[~chain] == number[n:].min()).all()


def cost(sides):
    """Lines of the package that run to tie two sides, and the largest memory in use, in bytes."""
    lines = 0

    def count(frame, event, _):
        nonlocal lines
        lines += event == "line"
        return count

    def trace(frame, *_):
        return count if frame.f_code.co_filename.startswith(PACKAGE) else None

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        Tie(*sides).blocks()
    finally:
        sys.settrace(before)
    tracemalloc.start()
    Tie(*sides).blocks()
    _, memory = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return lines, memory


def cubes(n):
    """Blocks of tetrahedra on both sides of x = 0."""
    sides = []
    for i, tag in enumerate((meshes.RIGHT, meshes.LEFT)):
        shift = np.array((i - 1, 0, 0))
        cells = (1, n[i], n[i])
        mesh, ft = meshes.block(comm, cells, lambda x, s=shift: x + s, cell="tetrahedron")
        sides.append((fem.functionspace(mesh, ("Lagrange", 1)), ft.find(tag)))
    return sides


@pytest.mark.parametrize("dim", (2, 3))
def test_the_cost_of_a_tie_grows_with_its_facets(dim):
    """The work is NumPy's: 16 times as many facets take hardly more lines, and 16 times the bytes.

    A loop over facets would take ten times the lines, an array of pairs of them 256 times the
    bytes.
    """
    if dim == 3:
        pytest.importorskip("gmsh")
    n = 250 if dim == 2 else 6
    ratio = 16 if dim == 2 else 4
    make = two_blocks if dim == 2 else cubes
    small, large = (cost(make((m, 3 * m // 2))) for m in (n, ratio * n))
    print(small, large)
    assert large[0] <= 2 * small[0]
    assert large[1] <= 1.5 * 16 * small[1]
