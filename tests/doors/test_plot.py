# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pictures: curved cells are drawn curved, with the edges that they have."""

from mpi4py import MPI

import numpy as np
import pytest

import meshes

pytest.importorskip("pyvista")


@pytest.mark.parametrize(
    "cell, num_edges", (("hexahedron", 2 * 12 + 8), ("tetrahedron", 2 * 16 + 16))
)
def test_curved_cells(cell, num_edges):
    """Points of the skin lie on the spheres, where flat faces would be .06 off."""
    from hypergap_dolfinx import plot

    def shell(s):
        azimuth, polar = (s[:, i] * np.pi / 3 for i in (0, 1))
        r = 1 + s[:, 2]
        x = np.column_stack((np.cos(azimuth) * np.cos(polar), np.sin(azimuth) * np.cos(polar)))
        return r[:, None] * np.column_stack((x, np.sin(polar)))

    mesh, _ = meshes.block(MPI.COMM_SELF, (2, 2, 1), shell, cell=cell, degree=2)
    skin = plot._skin(plot.grid(mesh))
    r = np.linalg.norm(skin.points, axis=1)
    outer = r > 1.9
    assert outer.sum() >= 3 * 8
    assert np.abs(r[outer] - 2).max() <= 0.01
    lines = plot._outlines(skin)
    assert lines.n_cells == num_edges * 8
