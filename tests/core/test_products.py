# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Products of sparse matrices as triplets, against NumPy's of dense ones."""

import numpy as np
import pytest

from hypergap_dolfinx.surface.moving import Sparse


def dense(A, shape):
    """All of a sparse matrix."""
    found = np.zeros(shape)
    np.add.at(found, (A.i, A.j), A.values)
    return found


@pytest.mark.parametrize("num", [0, 3, 200])
def test_products(num):
    rng = np.random.default_rng(num)
    sizes = (7, 9), (9, 5)
    A, B = (
        Sparse(*(rng.integers(0, size, num) for size in pair), rng.standard_normal(num))
        for pair in sizes
    )
    a, b = dense(A, sizes[0]), dense(B, sizes[1])
    found = A @ B
    np.testing.assert_allclose(dense(found, (7, 5)), a @ b, rtol=0, atol=1e-12)
    np.testing.assert_allclose(dense(A.summed, a.shape), a, rtol=0, atol=1e-13)
    for once in (found, A.summed):
        assert len({*zip(once.i.tolist(), once.j.tolist(), strict=True)}) == len(once.i)
    factors = np.arange(7.0)  # the first one is zero
    np.testing.assert_allclose(dense(A.scaled(factors), a.shape), factors[:, None] * a)
    assert (A.scaled(factors).i > 0).all()
    x = rng.standard_normal((4, 9))
    np.testing.assert_allclose(A.products(x, 7), x @ a.T, rtol=0, atol=1e-12)
