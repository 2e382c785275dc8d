# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Small complementarity problems: random ones, degenerate ones, and ones without a solution."""

import numpy as np
import pytest

from hypergap_dolfinx.contact_solver import complementarity


def pivoted(rng, num, rank):
    """A principal pivot of a positive (semi-)definite matrix, as that of a Newton step is."""
    C = rng.normal(size=(num, rank))
    W, on = C @ C.T / rank, rng.random(num) < 0.4
    if rank < num:
        on &= np.arange(num) < rank // 2  # what is exchanged is regular
    off, D = np.flatnonzero(~on), np.linalg.inv(W[np.ix_(on, on)])
    M = np.zeros((num, num))
    M[np.ix_(on, on)] = D
    M[np.ix_(off, off)] = W[np.ix_(off, off)] - W[np.ix_(off, on)] @ D @ W[np.ix_(on, off)]
    M[np.ix_(off, on)] = W[np.ix_(off, on)] @ D
    M[np.ix_(on, off)] = -D @ W[np.ix_(on, off)]
    return M


def check(M, b, zero, z):
    w, size = b + M @ z, np.abs(M).max() * np.abs(z).max(initial=0) + np.abs(b).max()
    assert (z >= 0).all() and (w >= -zero - 1e-9 * size).all()
    assert np.abs(z * w).max() <= 1e-8 * size * (1 + np.abs(z).max())


@pytest.mark.parametrize("solve", [complementarity.solved, complementarity._by_lemke])
@pytest.mark.parametrize("num", [1, 2, 5, 20, 60])
def test_positive(num, solve):
    """There is one solution, and both ways find it."""
    rng = np.random.default_rng(num)
    zero = np.full(num, 1e-12)
    for _ in range(20):
        M, b = pivoted(rng, num, num + 3), rng.normal(size=num)
        z, is_solved = solve(M, b, zero)
        assert is_solved
        check(M, b, zero, z)
        on = z > 0
        np.testing.assert_allclose(z[on], np.linalg.solve(M[np.ix_(on, on)], -b[on]), atol=1e-7)


@pytest.mark.parametrize("num", [3, 10, 30])
def test_semidefinite(num):
    """A matrix without full rank: a solution is found, if there is one."""
    rng = np.random.default_rng(num)
    zero, found = np.full(num, 1e-11), 0
    for k in range(40):
        M = pivoted(rng, num, max(num // 2, 1))
        # Half of them certainly have a solution
        feasible = rng.random(num) - M @ np.where(rng.random(num) < 0.5, rng.random(num), 0)
        b = rng.normal(size=num) if k % 2 else feasible
        result, is_solved = complementarity.solved(M, b, zero)
        assert is_solved or k % 2
        if is_solved:
            found += 1
            check(M, b, zero, result)
    assert found >= 20


def test_degenerate():
    """Zeros on both sides, equal rows, and nothing to do."""
    M = np.array([[2.0, 1, 0], [1, 2, 0], [0, 0, 1]])
    zero = np.full(3, 1e-12)
    for b in ([0, 0, 0], [0, -1, 0], [-1, -1, 0], [-1, -0.5, 1]):
        z, _ = complementarity.solved(M, np.array(b, dtype=float), zero)
        check(M, np.array(b), zero, z)
    twice = np.ones((2, 2))  # the same row twice
    z, _ = complementarity.solved(twice, np.array([-1.0, -1.0]), zero[:2])
    assert z.sum() == pytest.approx(1)


def test_ray():
    """What nothing holds: pressures that can't balance a load."""
    M = np.array([[0.0, 1], [-1, 0]])
    ray, is_solved = complementarity.solved(M, np.array([-1.0, -1.0]), np.full(2, 1e-12))
    assert not is_solved and ray.min() >= 0 < ray.max() and (M @ ray)[ray > 0].max() <= 0
    z, _ = complementarity.solved(M, np.array([-1.0, 2.0]), np.full(2, 1e-12))
    np.testing.assert_allclose(z, [2, 1])


@pytest.mark.parametrize("num", (1, 4, 12))
def test_rays_of_indefinite_matrices(num):
    """Multiples of them increase w nowhere where they aren't zero, whatever the rows' sizes are."""
    rng, rays = np.random.default_rng(num), 0
    for _ in range(40):
        part = rng.normal(size=(num, num))
        sizes = 10 ** rng.uniform(-2, 2, num)
        M = sizes[:, None] * (part + part.T) * sizes
        b = rng.normal(size=num) * sizes
        ray, is_solved = complementarity.solved(M, b, 1e-12 * sizes)
        if not is_solved:
            rays += 1
            assert ray.min() >= 0 < ray.max()
            off = (M @ ray)[ray > 0] - 1e-9 * np.abs(M).max() * ray.max()
            assert off.max() <= 0
    assert rays >= 8
