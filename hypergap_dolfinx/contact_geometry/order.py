# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The order of a surface's facets in the plane."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.contact_geometry.tolerances import KINK_ORDER
from hypergap_dolfinx.core.compiled import call, ints, struct
from hypergap_dolfinx.gap_mesh.strip import chains
from hypergap_dolfinx.surface.trace import Surface


@dataclass(frozen=True)
class Order:
    """A surface's facets one after the other, in chains that end where it turns too far to go on.

    They are the same until another vertex turns too far.
    """

    kinks: npt.NDArray[np.bool_]
    """Where it does, ``(num_vertices,)``."""
    chains: Any
    """Struct ``Chains`` of ``c/plane.h``."""

    @classmethod
    def of(
        cls, surface: Surface, kinks: npt.NDArray[np.bool_], last: "Order | None" = None
    ) -> "Order":
        """That of a surface where it is; the last one, where it was, if it still holds.

        Args:
            surface: Where it is.
            kinks: Where it turns too far to go on, ``(num_vertices,)``.
            last: The order where it was.

        Raises:
            InterfaceError: It branches.
        """
        if last is not None and np.array_equal(kinks, last.kinks):
            return last
        found = chains(surface, kinks)
        edges = np.concatenate([part.facets for part in found])
        count = np.array([len(part.facets) for part in found])
        start = np.cumsum(count) - count
        chain, position = np.empty_like(edges), np.empty_like(edges)
        chain[edges] = np.repeat(np.arange(len(found)), count)
        position[edges] = np.arange(len(edges)) - np.repeat(start, count)
        arrays = {
            "edges": edges,
            "start": start,
            "count": count,
            "closed": np.array([part.closed for part in found]),
            "chain": chain,
            "position": position,
        }
        arrays = {name: ints(array) for name, array in arrays.items()}
        return cls(kinks, struct("Chains", num=len(found), **arrays))


def find_kinks(side: dict[str, Any]) -> npt.NDArray[np.bool_]:
    """Vertices at which a side turns too far to go on, ``(num_vertices,)``.

    Args:
        side: Fields of ``Side`` of ``c/plane.h``.
    """
    kinks = np.empty(side["num_vertices"], np.int32)
    call("kinks_of", struct("Side", **side), KINK_ORDER, kinks)
    return kinks > 0
