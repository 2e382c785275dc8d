# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Friction: slip and its derivatives, what sticks and what slips, exact solutions."""

from mpi4py import MPI

import numpy as np
import pytest
import test_contact_form as plane
import test_contact_solids as space
from helpers import close

from dolfinx.mesh import CellType
from hypergap_dolfinx.gap import slip_columns
from hypergap_dolfinx.gap.opening import Opening
from hypergap_dolfinx.gap.plane import PlaneOpening

comm = MPI.COMM_WORLD
STEP = 1e-5  # of differences of the fourth order


def slip_of(opening, sides, u, rng, positions, tolerance=1e-9):
    """T and S against differences; what translations, rotations and positions are for T.

    Returns:
        What rotations are, ``(num_rotations, num_rows)``.
    """
    since = tuple(part + 0.1 * rng.standard_normal(part.shape) for part in u)
    direction = [rng.standard_normal(part.shape) for part in u]
    flat = np.concatenate([part.ravel() for part in direction])
    n = u[0].shape[1]
    num = (n - 1) * opening.num_multipliers
    q = rng.random((n - 1, opening.num_multipliers))
    T, S = (plane.dense(part, (num, len(flat))) for part in opening.slip(u, since))

    def at(t):
        moved = tuple(a + t * d for a, d in zip(u, direction, strict=True))
        T = plane.dense(opening.slip(moved, since)[0], (num, len(flat)))
        way = np.concatenate([(a - b).ravel() for a, b in zip(moved, since, strict=True)])
        return np.concatenate((T @ way, q.ravel() @ T))

    difference = (8 * (at(STEP) - at(-STEP)) - at(2 * STEP) + at(-2 * STEP)) / (12 * STEP)
    close(difference[:num], S @ flat, tolerance)
    H = plane.dense(opening.slip_curvature(u, q), (len(flat), len(flat)))
    close(difference[num:], H @ flat, tolerance)
    x = np.concatenate([positions(side, part) for side, part in zip(sides, u, strict=True)])
    assert np.abs(T @ x.ravel()).max() <= 1e-14
    assert np.abs(T @ np.tile(np.arange(1.0, n + 1), len(x))).max() <= 1e-14
    pairs = [(i, j) for i in range(n) for j in range(i)]
    turns = [np.eye(n)[[i]].T * np.eye(n)[j] for i, j in pairs]
    return np.array([T @ (x @ (turn - turn.T)).ravel() for turn in turns])


@pytest.mark.parametrize("options", plane.SCENES)
def test_slip(options):
    """A rotation's slip is the gap: so moments of friction balance where it is closed."""
    sides, u, rng = plane.scene(**options)
    opening = PlaneOpening.between(comm, sides, u)
    turned = slip_of(opening, sides, u, rng, plane._positions)
    close(turned[0], -opening.gap(u)[0], 1e-12)


@pytest.mark.parametrize("degree", (1, 2))
def test_slip_in_space(degree, monkeypatch):
    """Vertices have two directions, which are taken as they are; none turns around itself."""
    size, tolerance = (0.02, 1e-9) if degree == 1 else (1e-3, 1e-3)
    sides, u, rng = space.rough(degree, size=size)
    opening = Opening.between(comm, sides, u)
    state = opening._at(u)
    fixed = slip_columns.directions(state.surfaces[1], state.frames)
    monkeypatch.setattr(slip_columns, "directions", lambda *_: fixed)
    slip_of(opening, sides, u, rng, space._positions, tolerance)
    close(np.einsum("aki,ali->akl", fixed, fixed), np.tile(np.eye(2), (len(fixed), 1, 1)))
