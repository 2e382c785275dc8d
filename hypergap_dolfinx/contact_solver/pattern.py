# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Sparsity patterns of a contact's equations, with room for entries that sliding brings.

Rows and columns are unknowns of both sides' dofs, then multipliers. An analysis holds for all steps
whose entries lie in one pattern.
"""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.surface.moving import Sparse


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
        return np.bincount(at, entries.values, len(self.keys)).astype(
            float
        )  # without entries: integers


def unique_pairs(a: npt.NDArray, node: npt.NDArray, num: int) -> tuple[npt.NDArray, npt.NDArray]:
    """Distinct pairs of multipliers and nodes, sorted; ``num`` is the number of nodes."""
    a, node = np.divmod(_sorted(a * num + node), num)
    return a, node


def beside(
    a: npt.NDArray, node: npt.NDArray, facets: npt.NDArray, num: int
) -> tuple[npt.NDArray, npt.NDArray]:
    """Multipliers with their nodes, and with all nodes of the facets around these.

    Args:
        a: Multipliers.
        node: A node on which each acts.
        facets: Nodes of the facets that may slide past, ``(num_facets, num_facet_nodes)``.
        num: Number of nodes.

    Returns:
        All distinct pairs of multipliers and nodes, sorted.
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
    """Pattern of multipliers with all nodes on which they act, and of these nodes with each other.

    Args:
        a: Multipliers, sorted.
        node: A node on which each acts.
        num_nodes: Number of nodes, of n unknowns each.
        num: Number of multipliers, of ``across`` unknowns each, component by component.
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
    keys.append(np.arange(start, size) * (size + 1))  # inactive multipliers have an equation too
    return Pattern(size, _sorted(np.concatenate(keys)))


def _ranges(start: npt.NDArray[np.intp], count: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Concatenated ranges start, …, start + count − 1."""
    before = np.cumsum(count) - count
    return np.arange(count.sum()) + np.repeat(start - before, count)


def _sorted(values: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Distinct values, sorted; ``np.unique`` (by hashing) takes ten times as long."""
    values = np.sort(values, axis=None)
    return values[np.append(True, values[1:] != values[:-1])[: len(values)]]
