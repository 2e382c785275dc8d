# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What must not get slow: shapes of the cost, never seconds."""

import kernel_speed
import numpy as np
import pytest

from hypergap_dolfinx.gap import strip


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


@pytest.mark.slow
@pytest.mark.serial
def test_the_cost_of_a_tie_grows_with_its_facets():
    num = np.array((4000, 8000, 16000, 32000))
    seconds = [kernel_speed.tie_seconds(n, 2) for n in num]
    assert np.polyfit(np.log(num), np.log(seconds), 1)[0] < 1.3
