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
from hypergap_dolfinx.graph import parts
from hypergap_dolfinx.solve.blocks import ConstraintBlocks
from hypergap_dolfinx.solve.modes import motions, places
from hypergap_dolfinx.solve.motions import unhindered


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
        self._spaces, self._held = spaces, ties.prescribed
        self._parts = [parts(V) for V in spaces]
        self._centres = []
        for V in spaces:
            total = V.mesh.comm.allreduce(places(V).sum(axis=0))
            self._centres.append(total / V.dofmap.index_map.size_global)
        self._sizes: list[npt.NDArray[np.float64] | None] = [None] * len(spaces)
        modes = [self._modes(i, places(V)) for i, V in enumerate(spaces)]
        ends = np.cumsum([0, *(part.shape[1] for part in modes)])
        rows = [np.ones(next(B for B in row if B).getLocalSize()[0], bool) for row in ties.free]
        found = unhindered(K, ties, [{i: part} for i, part in enumerate(modes)], rows)
        self._combinations = [found[:, a:b].T for a, b in pairwise(ends)]

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
        x = places(self._spaces[i])
        return self._modes(i, x + u.reshape(x.shape)) @ self._combinations[i]

    def _modes(self, i: int, x) -> npt.NDArray[np.float64]:
        """Rigid motions of a body's parts, of length 1 where the body was first. Collective."""
        V, (part, num_parts) = self._spaces[i], self._parts[i]
        comm, part = V.mesh.comm, np.repeat(part, V.dofmap.index_map_bs)[:, None]
        modes = motions(V, self._centres[i], x)
        modes = np.hstack([np.where(part == p, modes, 0) for p in range(num_parts)])
        size = self._sizes[i]
        if size is None:
            size = np.sqrt(np.maximum(comm.allreduce((modes**2).sum(axis=0)), 1e-300))
            self._sizes[i] = size
        return modes / size
