# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Sparsity patterns of a contact's equations, with room for entries that sliding brings.

Rows and columns are unknowns of both sides' dofs, then multipliers. An analysis holds for all steps
whose entries lie in one pattern.
"""

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.surface.moving import Sparse

Ints = npt.NDArray[np.int64]


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

    def coupled_with(self, num: int) -> "Pattern":
        """The pattern with unknowns behind its own that are coupled with all others in it."""
        i, j = self.places
        size, more = self.size + num, self.size + np.arange(num)
        every = _sorted(np.concatenate((i, j, more)))
        blocks = every[:, None] * size + more, more[:, None] * size + every
        keys = [i * size + j, *(block.ravel() for block in blocks)]
        return Pattern(size, _sorted(np.concatenate(keys)))

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
    num, num_nodes = shape
    if facets is not None:
        facet, nodes = np.repeat(np.arange(len(facets)), facets.shape[1]), facets.ravel()
        around = _product((a, node), (nodes, facet), len(facets))
        more = _product(around, (facet, nodes), num_nodes)
        a, node = np.append(a, more[0]), np.append(node, more[1])
    a, node = np.divmod(_sorted(a * num_nodes + node), num_nodes)
    left, right = _product((node, a), (a, node), num_nodes)
    start, size = num_nodes * n, num_nodes * n + num * across
    dofs, own = np.arange(n), start + num * np.arange(across)
    every, forces = _sorted(a)[:, None] + own, (a[:, None] + own, node[:, None] * n + dofs)
    blocks = [(left[:, None] * n + dofs, right[:, None] * n + dofs), forces, forces[::-1]]
    blocks.append((every, every))
    keys = [(i[:, :, None] * size + j[:, None]).ravel() for i, j in blocks]
    keys.append(np.arange(start, size) * (size + 1))
    return Pattern(size, _sorted(np.concatenate(keys)))


def _product(a: tuple[Ints, Ints], b: tuple[Ints, Ints], num: int) -> tuple[Ints, Ints]:
    """Distinct rows and columns of a product of matrices, sorted; b has ``num`` columns."""
    order = np.argsort(b[0], kind="stable")
    start, end = (np.searchsorted(b[0][order], a[1], side) for side in ("left", "right"))
    count = end - start
    at = np.arange(count.sum()) + np.repeat(start - (np.cumsum(count) - count), count)
    return np.divmod(_sorted(np.repeat(a[0], count) * num + b[1][order[at]]), num)


def _sorted(values: Ints) -> Ints:
    """Distinct values, sorted; ``np.unique`` (by hashing) takes ten times as long.

    Often they are two sorted parts: merging these takes an eighth of the time of sorting.
    """
    values = np.sort(values, axis=None, kind="stable")
    return values[np.append(True, values[1:] != values[:-1])[: len(values)]]
