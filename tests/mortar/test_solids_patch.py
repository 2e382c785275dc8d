# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The linear patch test of structured tetrahedra: few facets against many, skew in space."""

from itertools import product

from mpi4py import MPI

import numpy as np
import pytest
from helpers import comm
from test_solids_interfaces import NOTHING, NU, linear, tied

import meshes

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
