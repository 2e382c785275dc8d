# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Finite rotations by rotation vectors, with exact derivatives.

exp(θ) y = b₀ y + b₁ θ × y + b₂ θ (θ · y) by Rodrigues, where b_m(s) = Σ_k (−s)ᵏ / (2k + m)! with
s = |θ|²: b₀ = cos |θ|, b₁ = sin |θ| / |θ|, b₂ = (1 − cos |θ|) / |θ|². These are smooth at θ = 0.
Sums lose digits with |θ|, three at a whole turn: rotations are those of one load step.
"""

from math import factorial

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial

Array = npt.NDArray[np.float64]

_SERIES = [  # the last term is round-off up to three turns
    Polynomial([(-1.0) ** k / factorial(2 * k + m) for k in range(40)]) for m in range(4)
]


def _values(theta: Array, m: int) -> tuple[float, float, float]:
    """b_m and its first two derivatives by s."""
    s, b = float(theta @ theta), _SERIES[m]
    return b(s), b.deriv()(s), b.deriv(2)(s)


def rotation(theta: Array) -> Array:
    """The rotation matrix of a rotation vector, ``(3, 3)``."""
    return rotated(theta, np.eye(3))[0].T


def rotated(theta: Array, y: Array) -> tuple[Array, Array, Array]:
    """Vectors after a rotation, with derivatives.

    Args:
        theta: Rotation vector, ``(3,)``.
        y: Vectors, ``(num, 3)``.

    Returns:
        The rotated vectors, ``(num, 3)``, their derivatives by θ, ``(num, 3, 3)``, and the second
        ones, ``(num, 3, 3, 3)``; the last axes are those of θ.
    """
    one = np.eye(3)
    d, w = y @ theta, np.cross(theta, y)
    parts = [y, w, d[:, None] * theta]
    by_theta = [
        np.zeros((len(y), 3, 3)),
        np.stack([np.cross(e, y) for e in one], axis=2),
        d[:, None, None] * one + theta[:, None] * y[:, None],
    ]
    both = np.zeros((len(y), 3, 3, 3))
    both += one[None, :, :, None] * y[:, None, None, :] + one[None, :, None] * y[:, None, :, None]
    twice = [np.zeros_like(both), np.zeros_like(both), both]
    x, first, second = np.zeros_like(y), np.zeros((len(y), 3, 3)), np.zeros((len(y), 3, 3, 3))
    outer = np.outer(theta, theta)
    for m, (part, slope, bend) in enumerate(zip(parts, by_theta, twice, strict=True)):
        b, db, ddb = _values(theta, m)
        x += b * part
        first += b * slope + 2 * db * part[:, :, None] * theta
        second += b * bend + part[:, :, None, None] * (2 * db * one + 4 * ddb * outer)
        mixed = 2 * db * slope[..., None] * theta
        second += mixed + mixed.swapaxes(2, 3)
    return x, first, second


def moment_of(theta: Array, M: Array) -> tuple[Array, Array]:
    """Generalised force of a moment: its work on θ̇, by the angular velocity ω = H(θ) θ̇.

    Args:
        theta: Rotation vector, ``(3,)``.
        M: The moment, about axes of space, ``(3,)``.

    Returns:
        HᵀM, ``(3,)``, and its derivative by θ, ``(3, 3)``, which isn't symmetric.
    """
    one, d = np.eye(3), float(theta @ M)
    # HᵀM = b₁ M − b₂ θ × M + b₃ θ (θ · M)
    parts = M, -np.cross(theta, M), d * theta
    slopes = (
        np.zeros((3, 3)),
        -np.stack([np.cross(e, M) for e in one], axis=1),
        d * one + np.outer(theta, M),
    )
    force, slope = np.zeros(3), np.zeros((3, 3))
    for m, part, by_theta in zip((1, 2, 3), parts, slopes, strict=True):
        b, db, _ = _values(theta, m)
        force += b * part
        slope += b * by_theta + 2 * db * np.outer(part, theta)
    return force, slope
