# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The demo of stiff and extreme scenes: the ends of its axes, and what a change of units does."""

from mpi4py import MPI

import numpy as np
import pytest
import stability as demo
from helpers import sweep

comm = MPI.COMM_WORLD
FINER = "thin layer, finer"  # Γ0 thin and finer than Γ1: its own conditioning, see the demo


@pytest.mark.parametrize("dim, degree", ((2, 1), (2, 2), (3, 1)))
def test_patch(dim, degree):
    """The ends of each axis, as far as they are quick."""
    for axis, value, scene, bounds in sweep(demo.patch_rows(quick=True), 5):
        if bounds[dim - 2] is None or axis == FINER:
            continue
        if max(scene.get("cells", (1,))) > 1000:
            continue
        common = {"dim": dim, "degree": degree}
        errors = [demo.patch(scene | common | {"swap": swap})[0] for swap in (False, True)]
        if max(errors) > bounds[dim - 2]:
            fused = demo.patch(common | scene, fused=True)[0]
            assert fused >= max(errors) / 10, (axis, value, errors, fused)


def test_contact():
    """A block that contact alone holds: the ends of each axis in the plane."""
    for axis, value, scene, bound in sweep(demo.contact_scenes(quick=True), 2):
        errors = [demo.pressed(scene | {"swap": swap})[0] for swap in (False, True)]
        assert max(errors) <= bound, (axis, value, errors)


@pytest.mark.ranks(2, degree=[1])
@pytest.mark.parametrize("degree", (1, 2))
def test_units(degree):
    """All results are the same in other units."""
    scenes = [{}, *({"unit": u} for u in (1e-9, 1e9)), *({"E": (e, e)} for e in (1e-12, 1e12))]
    displacements = []
    for scene in scenes:
        _, problem = demo.patch(scene | {"degree": degree})
        displacements.append(
            np.concatenate([u.x.array for u in problem.u]) / scene.get("unit", 1.0)
        )
    for other in displacements[1:]:
        size = comm.allreduce(np.abs(displacements[0]).max(initial=0), MPI.MAX)
        assert np.abs(other - displacements[0]).max(initial=0) <= 1e-12 * size


@pytest.mark.parametrize("E", (1e-10, 1.0, 1e10))
def test_two_materials(E):
    """The cylinder, as good as one fused mesh of the coarser side's cells."""
    fused, _ = demo.cylinder((6, 9), 2, (1.0, E), 0.3, fused=True)
    for swap in (False, True):
        assert demo.cylinder((6, 9), 2, (1.0, E), 0.3, swap)[0] <= 1.05 * fused


@pytest.mark.parametrize("nu", (0.49, 0.49999))
def test_nearly_incompressible(nu):
    fused, _ = demo.cylinder((6, 9), 2, (1.0, 1.0), nu, fused=True)
    for swap in (False, True):
        assert demo.cylinder((6, 9), 2, (1.0, 1.0), nu, swap)[0] <= 1.05 * fused


@pytest.mark.parametrize("n", ((3, 5), (6, 9), (12, 17)))
def test_coarse(n):
    for degree in (1, 2):
        fused, _ = demo.cylinder(n, degree, (1.0, 1.0), 0.3, fused=True)
        for swap in (False, True):
            assert demo.cylinder(n, degree, (1.0, 1.0), 0.3, swap)[0] <= 1.05 * fused
            assert demo.turned(n, degree, swap)[0] <= 1e-10


@pytest.mark.slow
def test_all():
    """Every row, but for a thin layer that is Γ0 and finer than Γ1."""
    for row in demo.rows(quick=False):
        assert row["ok"] or row["axis"] == FINER, row
