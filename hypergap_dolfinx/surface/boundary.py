# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Boundaries of bodies in flat simplices, with estimates of how the surfaces bend between them."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

import basix
from dolfinx import fem
from dolfinx.mesh import Mesh, exterior_facet_indices
from hypergap_dolfinx.core import compat, graph
from hypergap_dolfinx.core.collective import raise_on_all
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.surface.tolerances import (
    CORNER_ASSEMBLY,
    CURVES,
    FILE_DIGITS,
    GOES_ON,
)
from hypergap_dolfinx.surface.trace import lengths, unit_normals

# A facet that is a quadrilateral, as two triangles; its vertices as DOLFINx orders them
_SIMPLICES = {2: [[0, 1]], 3: [[0, 1, 2]], 4: [[0, 1, 3], [0, 3, 2]]}


def arc_height(chord: npt.NDArray, turn: npt.NDArray | float) -> npt.NDArray[np.float64]:
    """Height of an arc that turns by θ over its chord h: h/2 tan θ/4."""
    return chord / 2 * np.tan(turn / 4)


def equal_rows(rows: npt.NDArray) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Numbers of both rows of each pair of equal ones, as of edges of two triangles."""
    order = np.lexsort(rows.T)
    same = (np.diff(rows[order], axis=0) == 0).all(axis=1)
    return order[:-1][same], order[1:][same]


@dataclass(frozen=True)
class ExteriorFacets:
    """Exterior facets of a space's mesh: of this rank, or of all of them."""

    index: npt.NDArray[np.int32]
    """Local index on the rank that owns it, ``(num_facets,)``."""
    x: npt.NDArray[np.float64]
    """Vertices, ``(num_facets, num_vertices, n)``."""
    nodes: npt.NDArray[np.int64]
    """Global geometry nodes of the vertices, ``(num_facets, num_vertices)``."""
    inside: npt.NDArray[np.float64]
    """Mean of the cell's vertices, ``(num_facets, n)``: nodes of curved edges of thin cells may lie
    beyond the facet."""
    height: npt.NDArray[np.float64]
    """Largest distance of the geometry's nodes from the flat facet, ``(num_facets,)``."""
    normals: npt.NDArray[np.float64]
    """Normals of curved facets at their vertices, 0 of others, ``(num_facets, num_vertices, n)``.
    Their signs are arbitrary."""
    part: npt.NDArray[np.int32]
    """Connected part of the mesh, ``(num_facets,)``."""

    @classmethod
    def joined(cls, every: list["ExteriorFacets"]) -> "ExteriorFacets":
        """Exterior facets of all ranks."""
        names = cls.__dataclass_fields__
        return cls(*(np.concatenate([getattr(f, name) for f in every]) for name in names))


class Places:
    """Places of the nodes of facets, to tell if a user moves them later."""

    def __init__(self, mesh: Mesh, facets: npt.NDArray[np.integer]):
        """Keep the places of this rank's nodes."""
        every = np.asarray(facets, dtype=np.int32)
        nodes = compat.entities_to_geometry(mesh, mesh.geometry.dim - 1, every)
        self._nodes, self._geometry = np.unique(nodes), mesh.geometry
        self._x = mesh.geometry.x[self._nodes]

    def moved(self) -> float:
        """Largest distance of a node on this rank from where it was."""
        return float(lengths(self._geometry.x[self._nodes] - self._x).max(initial=0))


@dataclass(frozen=True)
class Boundary:
    """The boundary of a body, in simplices."""

    x: npt.NDArray[np.float64]
    """Vertices in the order in which the normal points out of the body, ``(num, n, n)``."""
    nodes: npt.NDArray[np.int64]
    """Global geometry nodes of the vertices, ``(num, n)``."""
    facet: npt.NDArray[np.intp]
    """Number among all ranks' facets of the space, ``(num,)``."""
    curvature: npt.NDArray[np.float64]
    """Curvature tensors without their signs: the largest among neighbours, ``(num, n, n)``."""
    height: npt.NDArray[np.float64]
    """Largest distance of a curved facet's nodes from the simplex, ``(num,)``."""
    turn: npt.NDArray[np.float64]
    """Turn of the curved surface from simplex to simplex, ``(num,)``."""

    @property
    def normals(self) -> npt.NDArray[np.float64]:
        """Unit normals out of the body, ``(num, n)``."""
        return unit_normals(self.x)

    @property
    def size(self) -> npt.NDArray[np.float64]:
        """Longest edges, ``(num,)``."""
        return _sizes(self.x)

    @property
    def most(self) -> npt.NDArray[np.float64]:
        """Distances from the simplices that no curved surface exceeds, ``(num,)``."""
        return arc_height(self.size, CORNER_ASSEMBLY) + self.height

    def sags(self, shares: npt.NDArray, curvature: npt.NDArray) -> npt.NDArray[np.float64]:
        """Distances of a curved surface from points of the simplices.

        A surface with curvature tensor K through the vertices is Σ λ_i λ_j e_ij·K e_ij / 2 away
        from the point with barycentric coordinates λ, with e_ij from vertex i to vertex j.

        Args:
            shares: λ, ``(num, num_points, n)``.
            curvature: K, ``(num, n, n)``.

        Returns:
            ``(num, num_points)``.
        """
        found, products = np.zeros(shares.shape[:2]), np.zeros(shares.shape[:2])
        for i, j in combinations(range(shares.shape[2]), 2):
            e, both = self.x[:, j] - self.x[:, i], shares[..., i] * shares[..., j]
            twice = np.minimum(np.einsum("pi,pij,pj->p", e, curvature, e) / 8, self.most)
            found += 4 * both * twice[:, None]
            products += both
        return np.maximum(found, np.minimum(8 * products, 1) * self.height[:, None])

    def boxes(self, reach: npt.NDArray | float) -> npt.NDArray[np.float64]:
        """Lower and upper corners of boxes around the simplices, ``(num, 2, n)``."""
        reach = np.broadcast_to(reach, len(self.x))[:, None]
        return np.stack((self.x.min(axis=1) - reach, self.x.max(axis=1) + reach), axis=1)

    def __getitem__(self, chosen) -> "Boundary":
        """Subset of the simplices."""
        return Boundary(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def exterior_facets(V: fem.FunctionSpace, name: str) -> ExteriorFacets:
    """This rank's exterior facets. Collective."""
    mesh, n = V.mesh, V.mesh.geometry.dim
    topology = mesh.topology
    num_vertices = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 4}
    cell = topology.cell_name()
    if cell not in num_vertices:
        raise InterfaceError(f"{name} has {cell} cells; facets of one kind are needed.")
    topology.create_entities(n - 1)
    topology.create_connectivity(n - 1, n)
    topology.create_connectivity(n, n - 1)
    index = exterior_facet_indices(topology)
    facet_nodes = compat.entities_to_geometry(mesh, n - 1, index)
    to_cells = topology.connectivity(n - 1, n)
    cells = to_cells.array[to_cells.offsets[index]]
    all_x = mesh.geometry.x[:, :n]
    finite = np.isfinite(all_x[facet_nodes]).all()
    raise_on_all(mesh.comm, None if finite else f"{name} has NaN or infinite coordinates.")
    nodes = facet_nodes[:, : num_vertices[cell]]
    x = all_x[nodes]
    # The last vertex of a quadrilateral may be out of the plane of the others, on both sides alike
    others = all_x[facet_nodes[:, num_vertices[cell] :]] - x[:, :1]
    num_corners = len(basix.geometry(getattr(basix.CellType, cell)))
    height = np.abs(np.einsum("fmi,fi->fm", others, unit_normals(x[:, :n]))).max(1, initial=0)
    curved = height > FILE_DIGITS * _sizes(x)
    return ExteriorFacets(
        index=index,
        x=x,
        nodes=mesh.geometry.index_map().local_to_global(nodes.ravel()).reshape(nodes.shape),
        inside=all_x[compat.geometry_dofmap(mesh)[cells, :num_corners]].mean(axis=1),
        height=height,
        normals=_normals(mesh, all_x[facet_nodes]) * curved[:, None, None],
        part=graph.connected(V)[0][V.dofmap.list[cells, 0]],
    )


def _normals(mesh: Mesh, nodes: npt.NDArray) -> npt.NDArray[np.float64]:
    """Unit normals at facets' vertices, from their nodes; 0 if the geometry has degree 1."""
    cmap, n = compat.coordinate_element(mesh), nodes.shape[2]
    cell_type = getattr(basix.CellType, mesh.topology.cell_name())
    facet_type = basix.cell.subentity_types(cell_type)[n - 1][0]
    vertices = basix.geometry(facet_type)
    if cmap.degree == 1 or not len(nodes):
        return np.zeros((len(nodes), len(vertices), n))
    derivatives = compat.geometry_element(mesh, facet_type).tabulate(1, vertices)[1:, :, :, 0]
    t = np.einsum("jva,fai->jfvi", derivatives, nodes)
    normals = np.cross(*t) if n == 3 else t[0, :, :, ::-1] * (1, -1)
    return normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)


def gathered(V: fem.FunctionSpace, name: str):
    """Boundaries of the connected parts of a mesh, in the order of their positions. Collective.

    Returns:
        The boundaries on rank 0 (none on others), this rank's exterior facets, and the number of
        the first one among all ranks'.
    """
    facets, comm = exterior_facets(V, name), V.mesh.comm
    start = sum(comm.allgather(len(facets.index))[: comm.rank])
    every = comm.gather(facets)
    bodies = [] if every is None else _parts(ExteriorFacets.joined(every))
    return bodies, facets.index, start


def _parts(facets: ExteriorFacets) -> list[Boundary]:
    """The boundary of each connected part of a mesh, in the order of their positions."""
    split = _SIMPLICES[facets.x.shape[1]]
    x, nodes, normals = (
        np.concatenate([a[:, s] for s in split]) for a in (facets.x, facets.nodes, facets.normals)
    )
    facet = np.tile(np.arange(len(facets.x)), len(split))
    outwards = facets.x.mean(axis=1) - facets.inside
    inwards = np.einsum("fi,fi->f", unit_normals(facets.x), outwards)[facet] < 0
    for a in (x, nodes, normals):
        a[inwards] = a[inwards, ::-1]
    normals *= np.sign(np.einsum("fvi,fi->fv", normals, unit_normals(x)))[..., None]
    curvature, turn = _curvature(x, nodes, normals)
    height = facets.height[facet]  # known for facets that are curved themselves
    size = _sizes(x)
    turn = np.maximum(turn, 8 * height / np.where(size > 0, size, 1))
    boundary = Boundary(x, nodes, facet, curvature, height, turn)
    part = facets.part[facet]
    lowest = []
    for p in range(int(part.max(initial=-1)) + 1):
        vertices = x[part == p].reshape(-1, x.shape[2])
        lowest.append(vertices[np.lexsort(vertices.T[::-1])[0]])
    return [boundary[part == p] for p in np.lexsort(np.reshape(lowest, (-1, x.shape[2])).T[::-1])]


def _angles(n0: npt.NDArray, n1: npt.NDArray) -> npt.NDArray[np.float64]:
    """Angles between vectors, ``(num,)``."""
    product = np.linalg.norm(n0, axis=1) * np.linalg.norm(n1, axis=1)
    return np.arccos(np.clip(np.einsum("ei,ei->e", n0, n1) / np.maximum(product, 1e-300), -1, 1))


def _sizes(x: npt.NDArray) -> npt.NDArray[np.float64]:
    """Longest edges of simplices ``(num, n, n)``, ``(num,)``."""
    return np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)


def _curvature(x: npt.NDArray, nodes: npt.NDArray, at_vertices: npt.NDArray):
    """Curvature tensors of the surface at each of its simplices, and the largest turn there.

    A circle of radius R turns by θ = h / R from one edge h to the next one. Of a ridge between two
    simplices, θ / h is the curvature across it, h being the height of the smaller one over the
    ridge; a triangle has the sum of its ridges' tensors, an edge the larger of its vertices'.
    Curved facets turn inside: their angle where they meet tells whether that is a corner.

    Args:
        x: Vertices of the simplices, ``(num, n, n)``.
        nodes: Their numbers, ``(num, n)``.
        at_vertices: Normals of curved facets there, 0 of others, ``(num, n, n)``.

    Returns:
        ``(num, n, n)``, as of :class:`Boundary`, and ``(num,)``.
    """
    num, n = len(x), x.shape[2]
    normals = unit_normals(x)
    # Opposite to vertex k: the ridge between the others, or in 2D the other vertex
    others = np.stack([np.delete(np.arange(n), k) for k in range(n)])
    ridges = np.sort(nodes[:, others], axis=2).reshape(-1, n - 1)
    a, b = equal_rows(ridges)
    (f, k), (g, m) = np.divmod(a, n), np.divmod(b, n)
    start, end = x[f, others[k, 0]], x[f, others[k, -1]]
    along = end - start  # zero in 2D
    length = np.linalg.norm(along, axis=1)
    along /= np.where(length > 0, length, 1)[:, None]
    # Within each simplex, from the ridge to the vertex beyond
    ways = [x[f, k] - start, x[g, m] - start]
    ways = [way - np.einsum("ei,ei->e", way, along)[:, None] * along for way in ways]
    height = np.array([np.linalg.norm(way, axis=1) for way in ways])
    ways = [way / np.where(h > 0, h, 1)[:, None] for way, h in zip(ways, height, strict=True)]
    theta = _angles(normals[f], normals[g])
    own = [at_vertices[s[:, None], others[v]].sum(axis=1) for s, v in ((f, k), (g, m))]
    bent = [n.any(axis=1, keepdims=True) for n in own]
    met = _angles(*(np.where(b, n, normals[s]) for b, n, s in zip(bent, own, (f, g), strict=True)))
    either = np.any(bent, axis=(0, 2))
    corner = np.where(either, met / CURVES, theta) > CORNER_ASSEMBLY
    going = [
        _turns_beyond(nodes, ridges[a], along, theta, beyond, way)
        for beyond, way in zip((nodes[f, k], nodes[g, m]), ways, strict=True)
    ]
    curved = np.where(corner, 0, np.minimum(theta, GOES_ON * np.min(going, 0)))
    smooth = theta <= curved + FILE_DIGITS
    height = height.min(axis=0)
    size = (curved / np.where(height > 0, height, 1))[:, None, None]
    K, turn = np.zeros((num, n, n)), np.zeros(num)
    for simplex, way in zip((f, g), ways, strict=True):
        np.maximum.at(turn, simplex, curved)
        tensors = size * way[:, :, None] * way[:, None]
        if n == 2:
            more = np.einsum("eii->e", tensors) > np.einsum("eii->e", K[simplex])
            K[simplex[more]] = tensors[more]
        else:
            np.add.at(K, simplex, tensors)
    return _around(K, turn, normals, f[smooth], g[smooth])


def _turns_beyond(nodes, ridges, along, theta, vertex, way) -> npt.NDArray[np.float64]:
    """Largest turns across each ridge among the ridges at a vertex beyond, ``(num_ridges,)``."""
    at = np.argsort(ridges.ravel(), kind="stable")
    first = np.searchsorted(ridges.ravel()[at], np.arange(nodes.max(initial=-1) + 2))
    count = first[vertex + 1] - first[vertex]
    ridge = np.repeat(np.arange(len(vertex)), count)
    place = np.arange(len(ridge)) - np.repeat(np.cumsum(count) - count - first[vertex], count)
    beyond = at[place] // ridges.shape[1]
    found = np.zeros(len(vertex))
    turns = theta[beyond] * (1 - np.einsum("ei,ei->e", along[beyond], way[ridge]) ** 2)
    np.maximum.at(found, ridge, turns)
    return found


def _around(K: npt.NDArray, turn: npt.NDArray, normals: npt.NDArray, f, g):
    """Largest tensors and turns of simplices and their neighbours: narrow ones hardly turn.

    Tensors of neighbours are turned with the normals. The triangle at the end of a curved surface
    has no ridge that turns.
    """
    near, trace = K.copy(), np.einsum("pii->p", K)
    own, other = np.concatenate((f, g)), np.concatenate((g, f))
    largest_turn = turn.copy()
    np.maximum.at(largest_turn, own, turn[other])
    order = np.argsort(trace[other], kind="stable")  # the largest comes last
    mine, largest = own[order], other[order]
    larger = trace[largest] > trace[mine]
    mine, largest = mine[larger], largest[larger]
    a, b = normals[largest], normals[mine]
    both = a + b
    R = 2 * b[:, :, None] * a[:, None] + np.eye(a.shape[1])
    R -= both[:, :, None] * both[:, None] / (1 + np.einsum("pi,pi->p", a, b))[:, None, None]
    near[mine] = R @ K[largest] @ R.transpose(0, 2, 1)
    return near, largest_turn
