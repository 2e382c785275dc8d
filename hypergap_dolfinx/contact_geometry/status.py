# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Table of contacts before a solve: facing facets, their distances, and facets without any."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.surface.moving import Displacements, MovingSurface
from hypergap_dolfinx.surface.trace import Surface

HEADER = (
    *("contact", "facets Γ0 / Γ1", "size Γ0 / Γ1", "ratio", "Γ1 faces Γ0", "nearest gap", "at"),
    *("largest overlap", "at", "Γ1 is"),
)


class GapRows(Protocol):
    """A contact's gaps as arrays."""

    sides: tuple[MovingSurface, MovingSurface]
    u: Displacements
    g: npt.NDArray[np.float64]
    m: npt.NDArray[np.float64]

    @property
    def closed(self) -> float:
        """Length of gaps treated as closed."""

    def update_geometry(self) -> None:
        """Find the gaps."""

    def spread(self, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Values of vertices from those of multipliers."""


@dataclass(frozen=True)
class ContactStatus:
    """Where the two sides of a contact are, before a solve; the same on every rank."""

    num_facets: tuple[int, int]
    """Numbers of facets of Γ0 and of Γ1."""
    sizes: tuple[float, float]
    """Median sizes of their facets."""
    facing: npt.NDArray[np.bool_]
    """Mask of Γ1's vertices that have Γ0 opposite, ``(num_vertices,)``."""
    gaps: npt.NDArray[np.float64]
    """Their gaps, negative where they overlap, 0 elsewhere, ``(num_vertices,)``."""
    x: npt.NDArray[np.float64]
    """Places of Γ1's vertices, ``(num_vertices, n)``."""
    closed: float
    """Length of gaps that count as closed."""
    sides: str
    """Which side is Γ1, and why."""
    error: str
    """Reason why there are no gaps, or nothing."""

    @classmethod
    def of(cls, rows: GapRows, surfaces: tuple[Surface, Surface], sides: str):
        """The status where the bodies are. Collective.

        Args:
            rows: A contact's rows; their geometry is found here.
            surfaces: Γ0 and Γ1 before any displacement.
            sides: Which side is Γ1, and why.
        """
        error, num = "", len(rows.sides[1].reference.x)
        facing, gaps = np.zeros(num, dtype=bool), np.zeros(num)
        try:
            rows.update_geometry()
        except InterfaceError as e:
            error = str(e)
        else:
            facing = rows.spread(rows.m) > 0
            gaps = rows.spread(np.divide(rows.g, rows.m, out=np.zeros(num), where=rows.m > 0))
        return cls(
            (len(surfaces[0].facets), len(surfaces[1].facets)),
            (float(np.median(surfaces[0].size)), float(np.median(surfaces[1].size))),
            facing,
            gaps,
            rows.sides[1].displaced(rows.u[1]).x,
            rows.closed,
            sides,
            error,
        )

    def row(self, number: int) -> list[str]:
        """Cells of the table, under :data:`HEADER`."""
        cells = [
            f"{number}",
            f"{self.num_facets[0]} / {self.num_facets[1]}",
            f"{self.sizes[0]:.3g} / {self.sizes[1]:.3g}",
            f"{self.sizes[0] / self.sizes[1]:.3g}",
            f"{self.facing.sum()} of {len(self.facing)}",
        ]
        overlaps = self.gaps < -self.closed
        for on in (self.facing & ~overlaps, self.facing & overlaps):
            gaps = np.where(on, self.gaps, np.inf)
            least = np.flatnonzero(gaps <= gaps.min() + self.closed)  # equal but for round-off
            k = least[np.lexsort(self.x[least].T[::-1])[0]]
            far = abs(self.gaps[k])
            length = "closed" if far <= self.closed else f"{far:.3g}"
            cells += [length, spot(self.x[[k]])] if on[k] else ["–", ""]
        return [*cells, self.sides]

    def doubts(self, number: int) -> list[str]:
        """Sentences about vertices that face nothing."""
        name, away = f"contact {number}", ~self.facing
        if self.error:
            return [f"{name}: {self.error}"]
        if away.all():
            return [f"{name}: nothing of Γ1, around {spot(self.x)}, faces Γ0 yet."]
        if away.any():
            return [
                f"{name}: {away.sum()} of {len(away)} vertices of Γ1 face nothing, from "
                f"{spot(self.x[away].min(axis=0)[None])} to {spot(self.x[away].max(axis=0)[None])}."
            ]
        return []


def table(rows: Sequence[ContactStatus], more: Sequence[str] = ()) -> str:
    """Rows under their header, and sentences below them."""
    cells = [list(HEADER), *(row.row(c) for c, row in enumerate(rows))]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in cells]
    return "\n".join([*lines, *(s for c, row in enumerate(rows) for s in row.doubts(c)), *more])
