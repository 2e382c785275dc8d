# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Where a contact's equations have entries, now and while bodies slide on a little. NumPy alone.

Rows and columns are unknowns of both sides' dofs, then multipliers. What is analysed once holds for
all steps whose entries lie in one pattern.
"""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.surface.moving import Sparse


class Pattern:
    """Entries that there are, of a matrix ``(size, size)``."""

    def __init__(self, size: int, keys: npt.NDArray[np.int64]):
        """Keep them.

        Args:
            size: Number of rows.
            keys: size · row + column of each entry, sorted, ``(num_entries,)``.
        """
        self.size, self.keys = size, keys

    @classmethod
    def of(cls, size: int, entries: Sparse) -> "Pattern":
        """That of a matrix."""
        return cls(size, _sorted(entries.i * size + entries.j))

    def without(self, gone: npt.NDArray[np.bool_]) -> "Pattern":
        """Without some of the rows and columns, ``(size,)``."""
        i, j = self.places
        return Pattern(self.size, self.keys[~(gone[i] | gone[j])])

    def joined(self, other: "Pattern") -> "Pattern":
        """What one of two patterns has."""
        return Pattern(self.size, _sorted(np.append(self.keys, other.keys)))

    @property
    def places(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Rows and columns, ``(num_entries,)`` each."""
        return np.divmod(self.keys, self.size)

    def values(self, entries: Sparse) -> npt.NDArray[np.float64] | None:
        """The values at all places, ``(num_entries,)``; None if some are at others."""
        keys = entries.i * self.size + entries.j
        at = np.searchsorted(self.keys, keys)
        if (np.append(self.keys, -1)[at] != keys).any():
            return None
        return np.bincount(at, entries.values, len(self.keys)).astype(float)  # of none: integers


def unique_pairs(a: npt.NDArray, node: npt.NDArray, num: int) -> tuple[npt.NDArray, npt.NDArray]:
    """Pairs of multipliers and nodes, sorted, once each; ``num`` is the number of nodes."""
    a, node = np.divmod(_sorted(a * num + node), num)
    return a, node


def beside(
    a: npt.NDArray, node: npt.NDArray, facets: npt.NDArray, num: int
) -> tuple[npt.NDArray, npt.NDArray]:
    """Multipliers with their nodes, and with those of facets that these belong to.

    Args:
        a: Multipliers.
        node: A node on which each acts.
        facets: Nodes of the facets that may go by, ``(num_facets, num_facet_nodes)``.
        num: Number of nodes.

    Returns:
        The same of all pairs, sorted, once each.
    """
    of_node = np.argsort(facets.ravel(), kind="stable")
    start = np.searchsorted(facets.ravel()[of_node], np.arange(num + 1))
    count = (start[1:] - start[:-1])[node]
    facet = of_node[_ranges(start[node], count)] // facets.shape[1]
    more = np.repeat(a, count * facets.shape[1]), facets[facet].ravel()
    return unique_pairs(np.append(a, more[0]), np.append(node, more[1]), num)


def coupled(
    a: npt.NDArray[np.intp],
    node: npt.NDArray[np.intp],
    num_nodes: int,
    num: int,
    n: int,
    across: int,
) -> Pattern:
    """Multipliers with all nodes that they act on, and these with each other.

    Args:
        a: Multipliers, sorted.
        node: A node on which each acts.
        num_nodes: Number of nodes, of n unknowns each.
        num: Number of multipliers, of ``across`` unknowns each: first all of the first ones.
        n: Number of dimensions.
        across: Number of unknowns of a multiplier.
    """
    start, size = num_nodes * n, num_nodes * n + num * across
    count = np.bincount(a, minlength=num)
    first = np.cumsum(count) - count
    left = np.repeat(node, count[a])
    right = node[_ranges(first[a], count[a])]
    left, right = np.divmod(_sorted(left * num_nodes + right), num_nodes)
    dofs, own = np.arange(n), start + num * np.arange(across)
    blocks = [(left[:, None] * n + dofs, right[:, None] * n + dofs)]
    blocks.append((a[:, None] + own, node[:, None] * n + dofs))
    blocks.append(blocks[-1][::-1])
    every = _sorted(a)[:, None] + own
    blocks.append((every, every))
    keys = [(i[:, :, None] * size + j[:, None]).ravel() for i, j in blocks]
    keys.append(np.arange(start, size) * (size + 1))  # what isn't in contact has an equation too
    return Pattern(size, _sorted(np.concatenate(keys)))


def _ranges(start: npt.NDArray[np.intp], count: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """start, start + 1, … of each, count of them."""
    before = np.cumsum(count) - count
    return np.arange(count.sum()) + np.repeat(start - before, count)


def _sorted(values: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Sorted, once each; NumPy's own way by hashing takes ten times as long."""
    values = np.sort(values, axis=None)
    return values[np.append(True, values[1:] != values[:-1])[: len(values)]]
