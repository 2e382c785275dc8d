# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's patch tests in every combination of the demo."""

from mpi4py import MPI

import patch_test as demo
import pytest
from assembly import SOLVED
from helpers import sweep

comm = MPI.COMM_WORLD


@pytest.mark.parametrize("name", demo.ELEMENTS)
def test_patch(name):
    """Both tests, shapes, size ratios and sides, to round-off (all of them with the demo)."""
    worst = 0.0
    cases = [case for case in demo.cases() if case[1] == name]
    for test, _, shape, ratio, swap in sweep(cases, 9):
        errors = demo.solve(comm, demo.ELEMENTS[name], shape, ratio, swap, test)
        worst = max(worst, *errors)
    print(worst)
    assert worst <= SOLVED
