# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Finite rotations and their derivatives."""

import numpy as np
import pytest

from hypergap_dolfinx.core.rotation import moment_of, rotated, rotation

STEP = 1e-5
NEAR = 1e-8  # error of central differences


def differences(f, theta):
    """Central differences of a function, in the last axis."""
    steps = [(f(theta + e) - f(theta - e)) / (2 * STEP) for e in STEP * np.eye(3)]
    return np.stack(steps, axis=-1)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 0.4, 3.0])
def test_derivatives(angle):
    """Of rotated vectors, twice, and of the generalised force of a moment."""
    rng = np.random.default_rng(1)
    axis, y, M = rng.normal(size=3), rng.normal(size=(2, 3)), rng.normal(size=3)
    theta = angle * axis / np.linalg.norm(axis)
    R = rotation(theta)
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-13) and np.linalg.det(R) > 0
    assert np.isclose(np.trace(R), 1 + 2 * np.cos(angle), atol=1e-13)
    assert np.allclose(R @ axis, axis, atol=1e-13)
    x, first, second = rotated(theta, y)
    assert np.allclose(x, y @ R.T, atol=1e-13)
    assert np.allclose(first, differences(lambda t: rotated(t, y)[0], theta), atol=NEAR)
    assert np.allclose(second, differences(lambda t: rotated(t, y)[1], theta), atol=NEAR)
    force, slope = moment_of(theta, M)
    assert np.allclose(slope, differences(lambda t: moment_of(t, M)[0], theta), atol=NEAR)
    # A pair of forces has the moment M: the same work on θ̇
    arms = np.array([np.cross(M, (1.0, 2.0, 3.0))])
    arms *= np.linalg.norm(M) / np.linalg.norm(arms)
    pair = np.cross(M, arms[0]) / (arms[0] @ arms[0])  # arms × pair = M
    _, slopes, _ = rotated(theta, arms @ R)
    assert np.allclose(np.einsum("i,aij->j", pair, slopes), force, atol=1e-12)
