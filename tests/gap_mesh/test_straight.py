# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cells of Σ that curved facets would turn over: some of their edges are straight."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import close, comm, interpolated, raises, residual

import meshes
from dolfinx import fem
from hypergap_dolfinx import InvertedCellError, Tie
from hypergap_dolfinx.gap_mesh import repair, tetrahedra
from hypergap_dolfinx.gap_mesh.cells import geometry_element
from hypergap_dolfinx.gap_mesh.slab import mesh_slab
from hypergap_dolfinx.surface.pieces import Side
from hypergap_dolfinx.surface.trace import create_surface
from hypergap_dolfinx.surface.triangulation import kinks, neighbours

CELLS = np.array([(0, 1, 2, 4), (1, 3, 2, 5), (1, 2, 4, 5)])  # vertices 0–3 on Γ0, 4 and 5 on Γ1
ALPHA = np.array([0, 0, 0, 0, 1, 1.0])


def curved_sides(degree, bend, n=(3, 4)):
    """Blocks on both sides of the plane x = 0, in which their facets' edges are curved."""
    sides = []
    for i, tag in enumerate((meshes.RIGHT, meshes.LEFT)):

        def place(x, i=i):
            y, z = x[:, 1], x[:, 2]
            inside = 16 * y * (1 - y) * z * (1 - z)
            wave = bend / n[i] * inside * np.sin((2 + i) * n[i] * (y + 0.3) + 5 * z)
            return np.column_stack((x[:, 0] + i - 1, y + wave, z - 0.7 * wave))

        mesh, ft = meshes.block(comm, (1, n[i], n[i]), place, cell="tetrahedron", degree=2)
        sides.append((fem.functionspace(mesh, ("Lagrange", degree)), ft.find(tag)))
    return sides


def num_straight(domain):
    """Number of Σ's edges on Γ0 or Γ1 whose middle nodes aren't those of a facet."""
    nodes = np.vstack([surface.nodes.reshape(-1, 3) for surface in domain.surfaces])
    number = 0
    for x, alpha in zip(domain.x, domain.alpha_vertices, strict=True):
        for node, (i, j) in enumerate(((2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1)), 4):
            if alpha[i] == alpha[j] in (0, 1):
                number += np.linalg.norm(nodes - x[node], axis=1).min() > 1e-10
    return number


@pytest.mark.ranks(2)
def test_linear_fields(monkeypatch):
    """Nodes on straight edges have hosts where they are: linear fields have no gap."""
    monkeypatch.setattr(repair, "improve", lambda cells, *_: cells)
    tie = Tie(*curved_sides(2, 0.25))
    assert comm.allreduce(num_straight(tie.domain)) > 0

    def f(x):
        return 1 + x[0] - 2 * x[1] + 0.5 * x[2]

    assert residual(tie, *(interpolated(V, f) for V in tie.spaces)) < 1e-13


def test_no_cell_is_turned_over(monkeypatch):
    """Nor with edges so curved that facets hardly aren't."""
    monkeypatch.setattr(repair, "improve", lambda cells, *_: cells)
    domain = Tie(*curved_sides(2, 0.3)).domain
    domain.gap_matrices()
    monkeypatch.setattr(tetrahedra, "straighten", lambda *_: tetrahedra.NONE)
    monkeypatch.setattr(repair, "straighten", lambda *_: tetrahedra.NONE)
    with raises(InvertedCellError, "inverted"):
        Tie(*curved_sides(2, 0.3)).domain.gap_matrices()


@pytest.mark.serial
def test_hosts_are_found_once(monkeypatch):
    """Those with which cells were judged are what the slab would find, also of swapped cells."""
    improve, swapped = repair.improve, []

    def counted(cells, *args):
        found = improve(cells, *args)
        swapped.append(found is not cells)
        return found

    monkeypatch.setattr(repair, "improve", counted)
    V, facets = zip(*curved_sides(2, 0.25), strict=True)
    surfaces = [create_surface(*side, name) for *side, name in zip(V, facets, ("Γ0", "Γ1"))]
    slab = mesh_slab(comm, *surfaces).slabs[0]
    fresh = replace(slab)
    assert any(swapped) and slab.known and not fresh.known
    points = geometry_element(surfaces, 2).basix_element.points
    own, other = (s.hosts(points, np.arange(len(s.cells))) for s in (slab, fresh))
    close(own.alpha, other.alpha)
    for i, surface in enumerate(surfaces):
        some = own.alpha != 1 - i  # on the other surface none of this one's counts
        places = [surface.points(h.facets[i][some], h.X[i][some]) for h in (own, other)]
        close(*places)


@pytest.mark.serial
def test_which_edges():
    """Those through the gap first, then what helps most; what can't be helped ends all the same."""

    def margins(wanted):
        def least(cells, edges):
            there = {tuple(edge) for edge in edges.tolist()}
            first = (cells == CELLS[0]).all(axis=1)
            return np.where(first, len(there & wanted) - len(wanted) + 0.5, 1.0)

        return least

    through = {(0, 4), (1, 4), (2, 4)}
    for wanted in (set(), through, through | {(1, 2)}):
        found = tetrahedra.straighten(CELLS, ALPHA, margins(wanted))
        assert {tuple(edge) for edge in found.tolist()} == wanted
    found = tetrahedra.straighten(CELLS, ALPHA, margins({(7, 8)}))
    assert len(found) == 6


def test_curved_facets_turn_inside():
    """Straight ones of an eighth of a sphere turn by 90°, curved ones not; a box has corners."""
    for g, number in ((1, 3), (2, 0)):
        shell, tags = meshes.spherical_layers(comm, 1, (0.8, 1.0), degree=g)
        V = fem.functionspace(shell, ("Lagrange", g))
        surface = create_surface(V, tags.find(meshes.OUTER), "Γ0")
        found = kinks(surface, neighbours(surface.polygons, "Γ0", surface.x))
        assert len(found[0]) == number
    box, tags = meshes.block(comm, (1, 1, 1), cell="hexahedron", degree=2)
    surface = create_surface(fem.functionspace(box, ("Lagrange", 2)), tags.indices, "Γ0")
    assert len(kinks(surface, neighbours(surface.polygons, "Γ0", surface.x))[0]) == 12


@pytest.mark.serial
def test_points_beside_narrow_pieces():
    """Their hosts don't depend on how facets are cut: Newton's method goes astray in strips."""
    mesh, ft = meshes.block(
        comm,
        (2, 2, 1),
        lambda x: np.column_stack((x[:, :2], x[:, 2] + 0.3 * np.sin(2.5 * x[:, 0] + x[:, 1]))),
        cell="tetrahedron",
        degree=2,
    )
    V = fem.functionspace(mesh, ("Lagrange", 2))
    surface = create_surface(V, ft.find(meshes.BACK), "Γ0")
    whole = Side.of(surface, np.arange(len(surface.facets)))
    strips = np.array([((0, 0), (1, 0), (1 - y, y)) for y in (1e-4, 1.0)])
    strips[1, 1] = strips[0, 2]  # a strip along an edge, and the rest of the facet
    X = np.tile(strips, (len(surface.facets), 1, 1))
    facets = np.repeat(np.arange(len(surface.facets)), 2)
    x = surface.points(np.repeat(facets, 3), X.reshape(-1, 2))
    x, vertex = np.unique(np.round(x, 12), axis=0, return_inverse=True)
    cut = Side(surface, x, vertex.reshape(-1, 3), facets, X)
    inside = np.full((len(facets), 2), 1 / 3)
    points = cut.points(np.arange(len(facets)), inside) + 0.05 * cut.normals
    found, expected = cut.hosts(points, np.arange(len(facets))), whole.project(points, facets)
    close(surface.points(*found), whole.points(*expected), 1e-10)
    astray = cut.points(*cut.project(points, np.arange(len(facets)))) - whole.points(*expected)
    assert np.abs(astray).max() > 1e-3
