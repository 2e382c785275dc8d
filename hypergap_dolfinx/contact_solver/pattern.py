# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Sparsity patterns of a contact's equations, with room for entries that sliding brings.

Rows and columns are unknowns of both sides' dofs, then multipliers. An analysis holds for all steps
whose entries lie in one pattern.
"""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.surface.moving import Sparse

Ints = npt.NDArray[np.integer]


class Pattern:
    """Places of the entries of a matrix ``(size, size)``."""

    def __init__(self, size: int, keys: npt.NDArray[np.int64]):
        """Store the places.

        Args:
            size: Number of rows.
            keys: size · row + column of each entry, sorted, ``(num_entries,)``.
        """
        self.size, self.keys = size, keys

    @classmethod
    def of(cls, size: int, entries: Sparse) -> "Pattern":
        """Pattern of a matrix."""
        return cls(size, _sorted(entries.i * size + entries.j))

    def without(self, gone: npt.NDArray[np.bool_]) -> "Pattern":
        """The pattern without some rows and columns, a mask ``(size,)``."""
        i, j = self.places
        return Pattern(self.size, self.keys[~(gone[i] | gone[j])])

    def joined(self, other: "Pattern") -> "Pattern":
        """Union of two patterns."""
        return Pattern(self.size, _sorted(np.append(self.keys, other.keys)))

    @property
    def places(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Rows and columns of the entries, ``(num_entries,)`` each."""
        return np.divmod(self.keys, self.size)

    def values(self, entries: Sparse) -> npt.NDArray[np.float64] | None:
        """Values at all places, ``(num_entries,)``; None if an entry lies outside the pattern."""
        keys = entries.i * self.size + entries.j
        at = np.searchsorted(self.keys, keys)
        if (np.append(self.keys, -1)[at] != keys).any():
            return None
        found = np.bincount(at, entries.values, len(self.keys))
        return found.astype(float)  # without entries: integers


def coupled(
    a: Ints, node: Ints, shape: tuple[int, int], n: int, across: int, facets=None
) -> Pattern:
    """Pattern of multipliers with all nodes on which they act, and of these nodes with each other.

    Args:
        a: Multipliers.
        node: A node on which each acts.
        shape: Numbers of multipliers and of nodes.
        n: Number of a node's unknowns.
        across: Number of a multiplier's unknowns, which follow those of nodes component by
            component; each has an equation, too, if nothing acts.
        facets: Nodes of facets that may slide past, ``(num_facets, num_facet_nodes)``: multipliers
            act on all nodes of those around their nodes.
    """
    from scipy import sparse  # takes .15 s

    def ones(i, j, shape):
        return sparse.csr_array((np.ones(len(i)), (i, j)), shape=shape)

    acts, size, every = ones(a, node, shape), shape[0] * across, np.unique(a)
    if facets is not None:
        facet = np.repeat(np.arange(len(facets)), facets.shape[1])
        of = ones(facet, facets.ravel(), (len(facets), shape[1]))
        acts = acts + acts @ (of.T @ of)
    nodes = sparse.kron(acts.T @ acts, np.ones((n, n)))
    rows = sparse.kron(np.ones((across, 1)), sparse.kron(acts, np.ones((1, n))))
    laws = sparse.kron(np.ones((across, across)), ones(every, every, 2 * shape[:1]))
    laws = laws + ones(np.arange(size), np.arange(size), (size, size))
    found = sparse.block_array([[nodes, rows.T], [rows, laws]]).tocoo()
    i, j = (part.astype(np.int64) for part in found.coords)
    return Pattern.of(found.shape[0], Sparse(i, j, found.data))


def _sorted(values: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Distinct values, sorted; ``np.unique`` (by hashing) takes ten times as long."""
    values = np.sort(values, axis=None)
    return values[np.append(True, values[1:] != values[:-1])[: len(values)]]
