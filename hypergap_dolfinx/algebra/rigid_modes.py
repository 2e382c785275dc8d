# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Rigid motions of bodies, as columns over their dofs: what a stiffness alone doesn't see."""

from collections.abc import Sequence
from itertools import combinations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem

NOTHING = 1e-12
"""Force or energy of a rigid motion of length 1, over the size of K's rows, that counts as none.
Round-off makes 2e-15 (1000 times a body's size away from the origin 5e-13), 80 000 displacements
held at one node a force of 2.5e-3 and an energy of 2.5e-5."""
DEPENDENT = 1e-10
"""Eigenvalue of the Gram matrix of columns of length 1 that counts as zero: motions that are the
same on what isn't prescribed make 1e-16, a rotation of free dofs within 1e-5 of the body's size
1e-10."""


def places(V: fem.FunctionSpace) -> npt.NDArray[np.float64]:
    """Where this rank's owned nodes are, ``(num_nodes, n)``."""
    return V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local, : V.mesh.geometry.dim]


def motions(
    V: fem.FunctionSpace,
    centre: npt.NDArray[np.float64] | None = None,
    x: npt.NDArray[np.float64] | None = None,
) -> npt.NDArray[np.float64]:
    """Rigid displacements of a body, constants of other fields. Collective.

    Args:
        V: Its space.
        centre: Of the rotations; the mean of the dofs' places if not given.
        x: Where this rank's owned nodes are now; their :func:`places` if not given.

    Returns:
        This rank's owned rows, ``(num_dofs, num_modes)``.
    """
    n, block_size = V.mesh.geometry.dim, V.dofmap.index_map_bs
    x = places(V) if x is None else x
    modes = [np.tile(unit, (len(x), 1)) for unit in np.eye(block_size)]
    if V.value_shape == (n,):
        x = x - (mean(V.mesh.comm, [x]) if centre is None else centre)
        for i, j in combinations(range(n), 2):
            mode = np.zeros((len(x), n))
            mode[:, i], mode[:, j] = x[:, j], -x[:, i]
            modes.append(mode)
    return np.stack([mode.ravel() for mode in modes], axis=1)


def rigid_modes(
    V: fem.FunctionSpace,
    prescribed: npt.NDArray[np.bool_],
    part: npt.NDArray[np.int32],
    num_parts: int,
) -> npt.NDArray[np.float64]:
    """A basis of the :func:`motions` of a body's parts, 0 where it is prescribed. Collective.

    Args:
        V: Its space.
        prescribed: Which owned dofs (unrolled) are prescribed.
        part: The part of each node, from :func:`hypergap_dolfinx.core.graph.parts`.
        num_parts: Number of parts.

    Returns:
        Orthonormal columns, this rank's owned rows, ``(num_dofs, num_modes)``.
    """
    part = np.repeat(part, V.dofmap.index_map_bs)[:, None]
    modes = np.where(prescribed[:, None], 0, motions(V))
    modes = np.hstack([np.where(part == p, modes, 0) for p in range(num_parts)])
    return orthonormal(V.mesh.comm, modes)


def common_modes(
    spaces: Sequence[fem.FunctionSpace], moved: Sequence[npt.NDArray[np.bool_]] | None = None
) -> list[npt.NDArray[np.float64]]:
    """A basis of the motions that several bodies, or parts of them, make as one. Collective.

    Args:
        spaces: Their spaces.
        moved: Which of each body's owned nodes move, ``(num_nodes,)``; all if not given.

    Returns:
        For each body this rank's owned rows, ``(num_dofs, num_modes)``; columns that are
        orthonormal over all bodies.
    """
    comm, x = spaces[0].mesh.comm, [places(V) for V in spaces]
    if moved is None:
        moved = [np.ones(len(part), dtype=bool) for part in x]
    centre = mean(comm, [part[mask] for part, mask in zip(x, moved, strict=True)])
    modes = [
        np.where(np.repeat(mask, V.dofmap.index_map_bs)[:, None], motions(V, centre), 0)
        for V, mask in zip(spaces, moved, strict=True)
    ]
    together = orthonormal(comm, np.vstack(modes))
    return np.split(together, np.cumsum([len(part) for part in modes])[:-1])


def orthonormal(comm: MPI.Comm, R: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Orthonormal columns that span those of R, with rows on all ranks. Collective."""
    R = R / np.sqrt(np.maximum(comm.allreduce((R**2).sum(axis=0)), 1e-300))
    values, vectors = np.linalg.eigh(comm.allreduce(R.T @ R))
    keep = values > DEPENDENT
    return R @ (vectors[:, keep] / np.sqrt(values[keep]))


def mean(comm: MPI.Comm, x: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    """The mean of places on all ranks. Collective."""
    total = sum(part.sum(axis=0) for part in x)
    return comm.allreduce(total) / comm.allreduce(sum(len(part) for part in x))
