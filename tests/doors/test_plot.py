# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pictures: curved cells are drawn curved, with the edges that they have."""

from mpi4py import MPI

import numpy as np
import pytest

import meshes
from dolfinx import fem

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


def test_no_more_triangles_than_pixels(monkeypatch):
    """Cells of degree 2 are cut into fewer where they are many."""
    from hypergap_dolfinx import plot

    mesh, _ = meshes.block(MPI.COMM_SELF, (4, 4), lambda s: s, cell="triangle", degree=2)
    for pixels, level in ((40, 2), (45, 2), (46, 3), (4, 0)):
        monkeypatch.setattr(plot, "_SIZE", [pixels, pixels])
        skin = plot._skin(plot.grid(mesh))
        assert skin.n_cells == 32 * 4**level
        assert plot._outlines(skin).n_cells == (2 * 4 * 5 + 16) * 2**level


def test_values_of_cells():
    """A function that is constant in cells."""
    from dolfinx.mesh import create_unit_square
    from hypergap_dolfinx import plot

    f = fem.Function(fem.functionspace(create_unit_square(MPI.COMM_SELF, 2, 2), ("DG", 0)))
    f.x.array[:] = np.arange(len(f.x.array))
    (actor, *_) = (a for a in plot.field(f).actors.values() if hasattr(a, "mapper"))
    assert set(np.unique(actor.mapper.dataset["value"]).round(9)) <= set(f.x.array)


def test_fine_cells():
    """Edges of fine cells don't hide colours, those of a body not the values on its side."""
    from dolfinx.mesh import create_submesh, create_unit_square, locate_entities_boundary
    from hypergap_dolfinx import plot

    pictures = []
    for n in (4, 100):
        mesh = create_unit_square(MPI.COMM_SELF, n, n)
        top = locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 1))
        side = create_submesh(mesh, 1, top)[0]
        fs = [fem.Function(fem.functionspace(m, ("Lagrange", 1))) for m in (mesh, side)]
        fs[0].interpolate(lambda x: 1 - x[0])
        fs[1].interpolate(lambda x: x[0])
        pictures.append(np.asarray(plot.field(fs).screenshot(None, return_img=True), dtype=float))
    rows, columns = (np.flatnonzero((pictures[0] < 255).any(axis=(i, 2))) for i in (1, 0))
    apart = np.abs(pictures[0] - pictures[1])[rows][:, columns[:700]].mean(axis=(1, 2))
    assert apart[8:].mean() < 22  # of 255; 34 with edges as dark as those of large cells
    assert apart[:8].max() < 2  # the side's line of eight pixels; 28 behind the body's edges
