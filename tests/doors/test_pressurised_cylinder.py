# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's main example: errors, rates, the traction, and the floor for any method."""

import json
import subprocess
import sys
from itertools import product
from pathlib import Path

from mpi4py import MPI

import helpers
import numpy as np
import pressurised_cylinder as demo
import pytest
from helpers import ranks_at_last, sweep

from dolfinx import fem

comm = MPI.COMM_WORLD

# Finest level with quadrilaterals: L² displacement, L² stress, L² traction
BOUNDS = {1: (1.26e-4, 1.02e-2, 6.5e-3), 2: (6.5e-8, 4.6e-5, 7.1e-5)}
RATES = {1: (1.99, 0.99), 2: (2.98, 1.98), 3: (3.9, 2.9)}


def table(degree, cell, swap, levels=(2, 3, 4)):
    """The rows of the demo's table."""
    return [demo.run(comm, level, degree, cell, swap)[0] for level in levels]


def rate(rows, name):
    """Rate of convergence over the sweep."""
    return np.log2(rows[0][name] / rows[-1][name]) / (len(rows) - 1)


@pytest.mark.parametrize(
    "degree, cell, swap",
    sweep(product((1, 2, 3), ("quadrilateral", "triangle"), (False, True)), 3),
)
def test_errors_and_rates(degree, cell, swap):
    # Degree 3 reaches its rates early, and round-off soon
    levels = (2, 3, 4) if degree < 3 or helpers.thorough else (2, 3)
    rows = table(degree, cell, swap, levels)
    print([rate(rows, name) for name in ("l2", "stress", "traction", "gap")])
    for name, expected in zip(("l2", "stress"), RATES[degree], strict=True):
        assert rate(rows, name) >= expected
    assert rate(rows, "traction") >= degree - 0.05
    assert rate(rows, "gap") >= degree + 1 - 0.1
    if cell == "quadrilateral" and degree in BOUNDS:
        for name, bound in zip(("l2", "stress", "traction"), BOUNDS[degree], strict=True):
            assert rows[-1][name] <= bound


@pytest.mark.parametrize("degree", sweep((2, 1, 3), 3))
def test_sides_may_be_swapped(degree):
    one, other = (demo.run(comm, 3, degree, "quadrilateral", swap)[0] for swap in (False, True))
    for name in ("l2", "stress"):
        assert abs(one[name] / other[name] - 1) < 4e-3


@pytest.mark.parametrize(
    "degree, cell", sweep(product((1, 2, 3), ("quadrilateral", "triangle")), 3)
)
def test_stress_errors_of_the_interpolant(degree, cell):
    """The tie adds nothing visible to what the bodies' meshes can do."""
    row, problem, _ = demo.run(comm, 3, degree, cell, False)
    interpolants = []
    for u in problem.u:
        interpolants.append(fem.Function(u.function_space))
        interpolants[-1].interpolate(lambda x: np.array(demo.exact_displacement(x)))
    _, floor = demo.relative_errors(interpolants, degree)
    print(row["stress"] / floor)
    assert row["stress"] <= 1.01 * floor


@ranks_at_last(degree=[2])
@pytest.mark.parametrize("degree", sweep((2, 3), 2))
def test_free_interior_nodes_make_no_difference(degree, monkeypatch):
    """Interior nodes as unknowns, the paper's form: the same errors within 1 %."""
    row = demo.run(comm, 3, degree, "quadrilateral", False)[0]
    tie = demo.Tie
    monkeypatch.setattr(demo, "Tie", lambda *sides: tie(*sides, interior="free"))
    rows = table(degree, "quadrilateral", False, levels=(1, 2, 3))
    for name, expected in zip(("l2", "stress"), RATES[degree], strict=True):
        assert abs(rows[-1][name] / row[name] - 1) < 0.01
        assert rate(rows, name) >= expected - 0.03  # a level coarser than the bounds are for


@pytest.mark.serial
def test_demo_writes_table_and_json(tmp_path):
    """As a program of its own (its pictures: in the tests of demos)."""
    script = Path(demo.__file__)
    file = tmp_path / "rows.json"
    command = [sys.executable, script, "--degree", "2", "--levels", "2", "--json", file]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    rows = json.loads(file.read_text())
    assert [row["level"] for row in rows] == [0, 1]
    names = {"degree", "cell", "swap", "level", "h", "dofs", "l2", "stress", "seconds"}
    assert names <= set(rows[0])
    assert set(rows[0]["seconds"]) == {"mesh", "sigma", "gap", "assemble", "solve"}
    assert f"{rows[1]['l2']:.3e}" in out
