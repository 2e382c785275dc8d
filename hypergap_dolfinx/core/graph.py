# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Connected parts of graphs and meshes; numbers of rows; lots of many things."""

from collections.abc import Iterator

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem, la, mesh
from hypergap_dolfinx.core.tolerances import MANY_PARTS


def components(num: int, i: npt.NDArray, j: npt.NDArray) -> npt.NDArray[np.int32]:
    """Connected components of a graph, numbered by their lowest vertex.

    Args:
        num: Number of vertices.
        i: One end of each edge.
        j: The other end.

    Returns:
        Number of the component of each vertex, ``(num,)``.
    """
    label = np.arange(num)
    while len(i):
        a, b = label[i], label[j]
        np.minimum.at(label, np.maximum(a, b), np.minimum(a, b))
        while (label[label] != label).any():
            label = label[label]
        apart = label[i] != label[j]
        i, j = i[apart], j[apart]
    return (np.cumsum(label == np.arange(num)) - 1).astype(np.int32)[label]


def connected(V: fem.FunctionSpace) -> tuple[npt.NDArray[np.int32], int]:
    """Connected parts of a mesh, by nodes. Collective.

    Args:
        V: A Lagrange space on it: parts without a common dof can move apart.

    Returns:
        Part of each of this rank's nodes (blocks of dofs) and ghosts; number of parts.
    """
    nodes, comm, dofs = V.dofmap.index_map, V.mesh.comm, V.dofmap.list
    num = nodes.size_local + nodes.num_ghosts
    first = np.repeat(dofs[:, 0], dofs.shape[1] - 1)
    label = components(num, first, dofs[:, 1:].ravel()).astype(np.int64)
    found = comm.allgather(label.max(initial=-1) + 1)
    label += sum(found[: comm.rank])
    owners = la.vector(nodes)
    owners.array[:] = label
    owners.scatter_forward()
    ghosts = slice(nodes.size_local, None)
    pairs = np.stack((label[ghosts], owners.array[ghosts].astype(np.int64)), axis=1)
    i, j = np.vstack(comm.allgather(np.unique(pairs, axis=0))).T
    part = components(sum(found), i, j)[label]
    return part, comm.allreduce(part.max(initial=0), MPI.MAX) + 1


def parts(V: fem.FunctionSpace) -> tuple[npt.NDArray[np.int32], int]:
    """Connected parts of a mesh, by nodes; one part if they are very many. Collective.

    Args:
        V: A Lagrange space on it.

    Returns:
        Part of each of this rank's nodes (blocks of dofs), ``(num_owned,)``; number of parts.
    """
    part, num_parts = connected(V)
    part = part[: V.dofmap.index_map.size_local]
    return (part, num_parts) if num_parts <= MANY_PARTS else (np.zeros_like(part), 1)


def parts_at(
    V: fem.FunctionSpace, part: npt.NDArray[np.int32], dofs: npt.NDArray[np.int64]
) -> frozenset[int]:
    """The :func:`parts` that have some dofs. Collective.

    Args:
        V: A Lagrange space.
        part: Part of each of this rank's nodes, ``(num_owned,)``.
        dofs: Global dofs (blocks), the same on every rank.
    """
    start, end = V.dofmap.index_map.local_range
    mine = np.unique(part[dofs[(dofs >= start) & (dofs < end)] - start])
    return frozenset(np.concatenate(V.mesh.comm.allgather(mine)).tolist())


def parts_with(V: fem.FunctionSpace, facets: npt.NDArray[np.int32]) -> mesh.Mesh:
    """The connected parts of a mesh that have some facets, as a mesh. Collective.

    Args:
        V: A Lagrange space on it.
        facets: Local indices of the facets.
    """
    whole, (part, num_parts) = V.mesh, connected(V)
    if num_parts == 1:
        return whole
    tdim = whole.topology.dim
    whole.topology.create_connectivity(tdim - 1, tdim)
    of_cell = part[V.dofmap.list[: whole.topology.index_map(tdim).size_local, 0]]
    cells = mesh.compute_incident_entities(whole.topology, facets, tdim - 1, tdim)
    mine = np.unique(part[V.dofmap.list[cells, 0]])
    meant = np.concatenate(whole.comm.allgather(mine))
    meant = np.flatnonzero(np.isin(of_cell, meant)).astype(np.int32)
    return mesh.create_submesh(whole, tdim, meant)[0]


class PartsOf:
    """Connected parts that sides of ties belong to, found once for each space."""

    def __init__(self):
        """No space is known yet."""
        self._known: dict[int, tuple[fem.FunctionSpace, npt.NDArray[np.int32], int]] = {}

    def __call__(self, V: fem.FunctionSpace, dofs: npt.NDArray[np.int64]) -> frozenset[int]:
        """The :func:`parts` that have some dofs. Collective.

        Args:
            V: A Lagrange space.
            dofs: Global dofs (blocks), the same on every rank.
        """
        if id(V) not in self._known:
            self._known[id(V)] = V, *parts(V)  # V is kept, so that no other space gets its id
        _, part, num_parts = self._known[id(V)]
        if num_parts == 1:
            return frozenset({0})
        return parts_at(V, part, dofs)


def row_codes(rows: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """A number for each row of numbers from 0 on, ``(num, …)``: rows in order have rising ones.

    NumPy's ``unique`` takes ten times as long for rows.
    """
    code, size = np.zeros(len(rows), dtype=np.int64), int(rows.max(initial=0)) + 1
    for column in rows.T:
        if int(code.max(initial=0)) * size >= 2**62:
            code = np.unique(code, return_inverse=True)[1]
        code = code * size + column
    return code


def lots(num: int, size: int = 20_000) -> Iterator[slice]:
    """Lots of many things: one at a time fits into the processor's cache."""
    for start in range(0, num, size):
        yield slice(start, min(start + size, num))
