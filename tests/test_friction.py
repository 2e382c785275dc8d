# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Friction: slip and its derivatives, what sticks and what slips, exact solutions."""

from mpi4py import MPI

import numpy as np
import pytest
from helpers import close
from test_contact_form import DIFFERENCE, SCENES, STEP, _positions, dense, scene

from hypergap_dolfinx.gap.plane import PlaneOpening

comm = MPI.COMM_WORLD


@pytest.mark.parametrize("options", SCENES)
def test_slip(options):
    """T and S against differences; what translations, rotations and positions are for it."""
    sides, u, rng = scene(**options)
    opening = PlaneOpening.between(comm, sides, u)
    since = tuple(part + 0.1 * rng.standard_normal(part.shape) for part in u)
    direction = [rng.standard_normal(part.shape) for part in u]
    flat = np.concatenate([part.ravel() for part in direction])
    g = opening.gap(u)[0]
    shape = len(g), len(flat)
    q = rng.random(len(g))
    T, S = (dense(part, shape) for part in opening.slip(u, since))

    def at(t):
        moved = tuple(a + t * d for a, d in zip(u, direction, strict=True))
        T = dense(opening.slip(moved, since)[0], shape)
        way = np.concatenate([(a - b).ravel() for a, b in zip(moved, since, strict=True)])
        return np.concatenate((T @ way, q @ T))

    difference = (8 * (at(STEP) - at(-STEP)) - at(2 * STEP) + at(-2 * STEP)) / (12 * STEP)
    close(difference[: len(g)], S @ flat, DIFFERENCE)
    H = dense(opening.slip_curvature(u, q[None]), shape[1:] * 2)
    close(difference[len(g) :], H @ flat, DIFFERENCE)
    x = np.concatenate([_positions(side, part) for side, part in zip(sides, u, strict=True)])
    assert np.abs(T @ x.ravel()).max() <= 1e-14
    assert np.abs(T @ np.tile((1.0, 2.0), len(x))).max() <= 1e-14
    close(T @ (x @ [[0, 1], [-1, 0]]).ravel(), g, 1e-12)
