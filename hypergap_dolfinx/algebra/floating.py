# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Rigid motions of bodies that nothing but contact can hold."""

from collections.abc import Sequence
from itertools import pairwise

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.algebra.blocks import ConstraintBlocks
from hypergap_dolfinx.algebra.rigid_motions import (
    fields_of,
    mean,
    motions,
    places,
    tied_groups,
    unhindered,
)
from hypergap_dolfinx.algebra.tolerances import SAME
from hypergap_dolfinx.core.graph import parts


class FreeMotions:
    """Combinations of rigid motions that neither boundary conditions nor ties hinder."""

    def __init__(
        self, spaces: Sequence[fem.FunctionSpace], K: Sequence[PETSc.Mat], ties: ConstraintBlocks
    ):
        """Find them. Collective.

        Args:
            spaces: Space of each body.
            K: Stiffness of each body without stress, assembled.
            ties: The ties.
        """
        self._spaces, self._parts = spaces, [parts(V) for V in spaces]
        self.places = [places(V) for V in spaces]
        """Where this rank's owned nodes of each body were first, ``(num_nodes, n)`` each."""
        self._centre = mean(spaces[0].mesh.comm, self.places)
        self._sizes: list[npt.NDArray[np.float64] | None] = [None] * len(spaces)
        modes = [self._modes(i, x) for i, x in enumerate(self.places)]
        ends = np.cumsum([0, *(part.shape[1] for part in modes)])
        rows = [np.ones(next(B for B in row if B).getLocalSize()[0], bool) for row in ties.free]
        fields = fields_of(spaces)
        alone = unhindered(fields, K, ties, [{i: part} for i, part in enumerate(modes)], rows)
        # What ties connect moves as one, even if that strains a tie that is no better than its mesh
        groups, apart = tied_groups(fields, self._parts, ties)
        together = np.zeros((0, ends[-1]))
        for g in range(max(int(group.max()) for group in groups) + 1):
            common = self._common(groups, g)
            moved = {i: modes[i] @ common[a:b] for i, (a, b) in enumerate(pairwise(ends))}
            found = unhindered(fields, K, ties, [moved], apart)
            together = np.vstack((together, found @ common.T))
        _, values, found = np.linalg.svd(np.vstack((alone, together)), full_matrices=False)
        found = found[values > SAME]
        self._combinations = [found[:, a:b].T for a, b in pairwise(ends)]

    def _common(self, groups, g: int) -> npt.NDArray[np.float64]:
        """What the parts' modes are in those of a group, of length 1, ``(num_modes, num)``."""
        columns = []
        for group, size in zip(groups, self._sizes, strict=True):
            assert size is not None
            size = size.reshape(len(group), -1, 1) * (group == g)[:, None, None]
            columns.append((size * np.eye(size.shape[1])).reshape(-1, size.shape[1]))
        common = np.vstack(columns)
        return common / np.linalg.norm(common, axis=0)

    @property
    def num(self) -> int:
        """How many there are."""
        return self._combinations[0].shape[1]

    def at(self, i: int, u: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """The motions of a body where it is now. Collective.

        Args:
            i: Number of the body.
            u: This rank's owned displacements, ``(num_dofs,)``.

        Returns:
            This rank's owned rows, ``(num_dofs, num)``.
        """
        x = self.places[i]
        if not self._combinations[i].any():  # it is held
            return np.zeros((x.size, self.num))
        return self._modes(i, x + u.reshape(x.shape)) @ self._combinations[i]

    def _modes(self, i: int, x) -> npt.NDArray[np.float64]:
        """Rigid motions of a body's parts, of length 1 where the body was first. Collective."""
        V, (part, num_parts) = self._spaces[i], self._parts[i]
        comm, part = V.mesh.comm, np.repeat(part, V.dofmap.index_map_bs)[:, None]
        modes = motions(V, self._centre, x)
        modes = np.hstack([np.where(part == p, modes, 0) for p in range(num_parts)])
        size = self._sizes[i]
        if size is None:
            size = np.sqrt(np.maximum(comm.allreduce((modes**2).sum(axis=0)), 1e-300))
            self._sizes[i] = size
        return modes / size
