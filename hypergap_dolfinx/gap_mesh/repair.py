# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What is between two surfaces once a front got through: cells that are turned over are mended."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap_mesh import cavity, swaps
from hypergap_dolfinx.gap_mesh.cavity import Place
from hypergap_dolfinx.gap_mesh.rim import NO_WALLS, in_walls
from hypergap_dolfinx.gap_mesh.straightening import NONE, straighten
from hypergap_dolfinx.gap_mesh.tetrahedra import FACES

PARALLEL = 1e-2
"""D over its scale of cells between edges of both outlines that are taken away if curved cells are
turned over: they fill nothing but what walls bend by."""


@dataclass(frozen=True)
class Filling:
    """Cells between two surfaces."""

    mesh: cavity.Cells
    """The cells; interior vertices are numbered behind the others."""
    hosts: list[tuple]
    """Where the interior vertices lie: α, facets on both sides and coordinates in them."""
    straight: npt.NDArray[np.integer] = field(default_factory=lambda: NONE)
    """Edges that are straight though the surfaces are curved, ``(num_edges, 2)``."""
    walls: npt.NDArray[np.integer] = field(default_factory=lambda: NO_WALLS)
    """Walls along the outlines, if the surfaces are curved, ``(num_walls, 3)``."""

    @property
    def cells(self) -> npt.NDArray[np.integer]:
        """``(num_cells, 4)``."""
        return self.mesh.cells

    def with_cells(self, cells) -> "Filling":
        """Other cells between the same vertices."""
        return replace(self, mesh=replace(self.mesh, cells=cells))


Margins = Callable[[Filling], npt.NDArray[np.float64]]
"""How far cells are from being turned over: not positive where they are somewhere."""


@dataclass
class Workshop:
    """Between which triangles cells are sought, and how they are mended."""

    outer: npt.NDArray[np.integer]
    """The boundary's, counterclockwise seen from inside."""
    place: Place
    margins: Margins | None
    """None if surfaces are straight."""
    along: Callable[[npt.NDArray[np.integer]], npt.NDArray[np.integer]]
    """Of some walls those that lie along the outlines."""

    def num_bad(self, filling: Filling) -> int:
        """Number of cells that are turned over."""
        return int((self.margins(filling) <= 0).sum()) if self.margins else 0

    def coned(self, filling: Filling, gone=None) -> Filling | None:
        """Cones where cells are missing, or are taken away."""
        if gone is not None:
            filling = filling.with_cells(filling.cells[~gone])
        made = cavity.fill(filling.mesh, self.outer, self.place)
        if made is None or not cavity.is_whole(made[0].cells, self.outer):
            return None
        return replace(filling, mesh=made[0], hosts=filling.hosts + made[1])

    def swapped(self, filling: Filling) -> Filling:
        """Other cells where some are turned over."""
        margins = self.margins
        if margins is None:
            return filling
        mesh = filling.mesh

        def upright(cells):  # so are their vertices' simplices: else no straight edges help
            flat = filling.with_cells(cells).mesh.flat()
            values = np.full(len(cells), -np.inf)
            values[~flat] = margins(filling.with_cells(cells[~flat]))
            return values

        cells = swaps.improve(mesh.cells, mesh.alpha, upright)
        whole = cells is mesh.cells or cavity.is_whole(cells, self.outer)
        return filling.with_cells(cells) if whole else filling

    def mended(self, filling: Filling) -> Filling:
        """Cones where cells stay turned over, as long as that leaves fewer of them.

        A cell between two edges that are parallel but for what they are curved may be turned over
        though its vertices' simplex isn't.
        """
        margins = self.margins
        if margins is None:
            return filling
        filling = self.peeled(filling)
        bad = margins(filling) <= 0
        while bad.any() and (made := self.coned(filling, bad)):
            made = self.swapped(made)
            left = margins(made) <= 0
            if left.sum() >= bad.sum():
                break
            filling, bad = made, left
        return filling

    def peeled(self, filling: Filling) -> Filling:
        """Without cells that are nothing but what walls bend by: walls take their places."""
        assert self.margins
        found = bool(self.num_bad(filling))
        while found:
            found = False
            gone = (self.margins(filling) <= 0) | filling.mesh.flat(PARALLEL)
            gone &= (filling.mesh.alpha[filling.cells] == 0).sum(axis=1) == 2
            for i in np.flatnonzero(gone)[::-1]:
                faces = filling.cells[i][FACES]
                on = in_walls(faces, filling.walls)
                fresh = self.along(faces[~on]) if on.sum() == 2 else NO_WALLS
                if len(fresh) == 2:
                    left = [w[~in_walls(w, faces[on])] for w in (filling.walls, self.outer)]
                    walls, self.outer = (np.vstack((w, fresh)) for w in left)
                    filling = filling.with_cells(np.delete(filling.cells, i, axis=0))
                    filling = replace(filling, walls=walls)
                    found = True
        return filling

    def straightened(self, filling: Filling) -> Filling:
        """Straight edges where cells stay turned over."""
        margins = self.margins
        if margins is None:
            return filling

        def with_straight(cells, edges):
            return margins(replace(filling.with_cells(cells), straight=edges))

        edges = straighten(filling.cells, filling.mesh.alpha, with_straight)
        return replace(filling, straight=edges)
