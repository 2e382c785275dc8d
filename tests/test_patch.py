# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The paper's patch tests in every combination of the demo."""

from mpi4py import MPI

import patch_test as demo
import pytest
from assembly import SOLVED

comm = MPI.COMM_WORLD


@pytest.mark.parametrize("name", demo.ELEMENTS)
def test_patch(name):
    """Both tests, every shape, size ratio and side: to round-off."""
    worst = 0.0
    for test, elements, shape, ratio, swap in demo.cases():
        if elements == name:
            errors = demo.solve(comm, demo.ELEMENTS[name], shape, ratio, swap, test)
            worst = max(worst, *errors)
    print(worst)
    assert worst <= SOLVED
