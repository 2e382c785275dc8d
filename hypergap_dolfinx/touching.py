# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Search for bodies that touch and their facets: the sides of an assembly's ties."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices
from hypergap_dolfinx.core import compat, graph
from hypergap_dolfinx.core.collective import raise_on_all
from hypergap_dolfinx.core.intersection import axes_across, common_part
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.trace import lagrange_element, unit_normals
from hypergap_dolfinx.tolerances import (
    BULGES,
    CORNER_ASSEMBLY,
    FACING_ANGLE,
    FILE_DIGITS,
    GOES_ON,
    NEAR_FLAT,
    SEEN,
    TILT,
    TURNS_EXPLAINED,
)

LOG = logging.getLogger("hypergap_dolfinx")
EXPLANATIONS = "flat", "curved", "distance"
"""Explanations of the distance of facets that touch."""

# A facet that is a quadrilateral, as two triangles; its vertices as DOLFINx orders them
_SIMPLICES = {2: [[0, 1]], 3: [[0, 1, 2]], 4: [[0, 1, 3], [0, 3, 2]]}


class _Sides(NamedTuple):
    side0: tuple[fem.FunctionSpace, npt.NDArray[np.int32]]
    """The first body's space, and this rank's facets of it."""
    side1: tuple[fem.FunctionSpace, npt.NDArray[np.int32]]
    """The same of the second one."""


class Touching(_Sides):
    """Facets of two bodies that lie on each other: the two sides of a tie."""

    apart: float
    """Largest distance of flat facets that were found to touch, negative if they overlap."""
    explained: str
    """Explanation of that distance: ``"flat"`` if it is 1e-3 of a facet's size and less,
    ``"curved"`` if the surfaces turn as much from facet to facet, ``"distance"`` if it is only less
    than the given distance."""

    @classmethod
    def of(cls, side0, side1, apart: float, explained: str) -> "Touching":
        """Two sides, and how far they are apart."""
        pair = cls(side0, side1)
        pair.apart, pair.explained = apart, explained
        return pair


@dataclass(frozen=True)
class _Facets:
    """Exterior facets of a space's mesh: of this rank, or of all of them."""

    index: npt.NDArray[np.int32]
    """Local index on the rank that owns it, ``(num_facets,)``."""
    x: npt.NDArray[np.float64]
    """Vertices, ``(num_facets, num_vertices, n)``."""
    nodes: npt.NDArray[np.int64]
    """Global geometry nodes of the vertices, ``(num_facets, num_vertices)``."""
    inside: npt.NDArray[np.float64]
    """A point on the body's side of each, ``(num_facets, n)``."""
    heights: npt.NDArray[np.float64]
    """Largest distances of the geometry's nodes from the flat facet, out of the body and into it,
    ``(num_facets, 2)``."""
    part: npt.NDArray[np.int32]
    """Connected part of the mesh, ``(num_facets,)``."""


@dataclass(frozen=True)
class _Boundary:
    """The boundary of a body, in simplices."""

    x: npt.NDArray[np.float64]
    """Vertices in the order in which the normal points out of the body, ``(num, n, n)``."""
    nodes: npt.NDArray[np.int64]
    """Global geometry nodes of the vertices, ``(num, n)``."""
    facet: npt.NDArray[np.intp]
    """Number among all ranks' facets of the space, ``(num,)``."""
    curvature: npt.NDArray[np.float64]
    """Curvature tensors, of the part that bulges out of the body and of the part that bulges into
    it, ``(num, 2, n, n)``."""
    heights: npt.NDArray[np.float64]
    """Largest distances of a curved facet's nodes from the simplex, as of :class:`_Facets`."""
    turn: npt.NDArray[np.float64]
    """Turn of the curved surface from simplex to simplex, ``(num,)``."""

    @property
    def normals(self) -> npt.NDArray[np.float64]:
        """Unit normals out of the body, ``(num, n)``."""
        return unit_normals(self.x)

    @property
    def size(self) -> npt.NDArray[np.float64]:
        """Longest edges, ``(num,)``."""
        return np.linalg.norm(self.x - np.roll(self.x, 1, axis=1), axis=2).max(axis=1)

    def bulges(self, shares: npt.NDArray) -> npt.NDArray[np.float64]:
        """Largest distances of the curved surface from points of the simplices.

        A surface with curvature tensor K through the vertices is Σ λ_i λ_j e_ij·K e_ij / 2 away
        from the point with barycentric coordinates λ, with e_ij from vertex i to vertex j.

        Args:
            shares: λ, ``(num, num_points, n)``.

        Returns:
            Out of the body and into it, ``(num, num_points, 2)``.
        """
        found, products = np.zeros((*shares.shape[:2], 2)), np.zeros(shares.shape[:2])
        for i, j in combinations(range(shares.shape[2]), 2):
            e, both = self.x[:, j] - self.x[:, i], shares[..., i] * shares[..., j]
            squares = np.einsum("pi,psij,pj->ps", e, self.curvature, e)
            found += BULGES / 2 * both[..., None] * squares[:, None]
            products += both
        return np.maximum(
            found, np.minimum(BULGES * 4 * products, 1)[..., None] * self.heights[:, None]
        )

    def boxes(self, distance: float | None) -> npt.NDArray[np.float64]:
        """Lower and upper corners of boxes that meet if simplices may touch, ``(num, 2, n)``."""
        if distance is None:
            n = self.x.shape[2]
            middle = np.full((len(self.x), 1, n), 1 / n)
            # Nowhere more than the sum of the edges', which is n times what the middle has
            reach = n * self.bulges(middle).max(axis=(1, 2)) + NEAR_FLAT * self.size
        else:
            reach = np.full(len(self.x), distance)
        return np.stack(
            (self.x.min(axis=1) - reach[:, None], self.x.max(axis=1) + reach[:, None]), axis=1
        )

    def __getitem__(self, chosen) -> "_Boundary":
        return _Boundary(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def find_touching(
    spaces: Sequence[fem.FunctionSpace], distance: float | None = None
) -> list[Touching]:
    """Find bodies that touch, and their exterior facets there. Collective.

    Two facets touch if their normals are opposite and a part of one, seen along the normals, lies
    on the other, whatever their sizes. Facets with only an edge or a point in common don't. Each
    connected part of a mesh is a body; a body isn't compared with itself.

    Args:
        spaces: A Lagrange space on each mesh, or a component of a mixed one, ``W.sub(0)``; all
            meshes in 2D, or all in 3D, of triangles, quadrilaterals, tetrahedra or hexahedra.
        distance: Largest gap or overlap of facets that touch. If not given, it is 1e-3 of the
            smaller one's size for flat facets; flat facets of curved surfaces are up to h²/8R apart
            (edges h on a radius R): twice that distance, estimated from the turns between facets
            (up to 65°), is allowed where it is: at their middles, not at their vertices; a gap
            where a surface bulges out, an overlap where it bulges in. A turn is a corner, not
            curvature, if the surface doesn't go on turning beyond the facets on both sides. Parts
            with a smaller clearance, or thinner layers, need a distance. Normals may deviate from
            opposite ones by 5° plus ¾ of the surfaces' turns between facets.

    Returns:
        A pair of sides for :class:`Tie` for each two bodies that touch, each a space and this
        rank's facets (possibly none); in the order of ``spaces``, and of the positions of a mesh's
        parts. ``apart`` of a pair is the largest distance in it, ``explained`` is what explains it:
        ``"flat"``, ``"curved"`` or ``"distance"``. The log of ``hypergap_dolfinx`` has them too.

    Raises:
        InterfaceError: A space that isn't Lagrange, two on one mesh, meshes of different dimension
            or on different communicators, coordinates that aren't finite.
        ValueError: A distance that isn't positive.

    Example:
        Three blocks on a plate:

        >>> from mpi4py import MPI  # before dolfinx
        >>> from dolfinx import fem, mesh
        >>> from hypergap_dolfinx import Tie, find_touching
        >>> corners = [[(0, 0), (6, 1)], [(0, 1), (1, 2)], [(2, 1), (3, 2)], [(4, 1), (5, 2)]]
        >>> n = [(6, 1), (2, 2), (3, 3), (4, 4)]
        >>> V = []
        >>> for ends, cells in zip(corners, n):
        ...     body = mesh.create_rectangle(MPI.COMM_WORLD, ends, cells)
        ...     V.append(fem.functionspace(body, ("Lagrange", 1)))
        >>> ties = [Tie.between(*sides) for sides in find_touching(V)]
        >>> len(ties)
        3
    """
    spaces = list(spaces)
    comm = _check(spaces, distance)
    if not spaces:
        return []
    here, bodies, starts = [], [], []
    for i, V in enumerate(spaces):
        facets = _exterior_facets(Component.of(V).space, f"spaces[{i}]")
        here.append(facets.index)
        starts.append(sum(comm.allgather(len(facets.index))[: comm.rank]))
        every = comm.gather(facets)
        if every is not None:
            names = _Facets.__dataclass_fields__
            joined = {name: np.concatenate([getattr(f, name) for f in every]) for name in names}
            bodies += [(i, body) for body in _bodies(_Facets(**joined))]
    # On one rank, which sees all: a surface is small beside its body
    found = comm.bcast(_all_pairs(bodies, distance) if comm.rank == 0 else None)

    def side(i, facets):
        mine = facets - starts[i]
        mine = mine[(mine >= 0) & (mine < len(here[i]))]
        return spaces[i], np.sort(here[i][mine])

    pairs = []
    for (i, f), (j, g), apart, explained in found:
        pairs.append(Touching.of(side(i, f), side(j, g), apart, explained))
        if comm.rank == 0:
            LOG.info(
                "spaces[%d] and spaces[%d] touch with %d and %d facets, up to %.3g apart (%s)",
                *(i, j, len(f), len(g), apart, explained),
            )
    return pairs


def _check(spaces: list[fem.FunctionSpace], distance: float | None) -> MPI.Comm:
    """Check the arguments; returns the communicator."""
    if distance is not None and not 0 < distance < np.inf:
        raise ValueError(f"distance must be a positive length, not {distance}.")
    for i, V in enumerate(spaces):
        if not isinstance(V, fem.FunctionSpace):
            raise ValueError(f"spaces[{i}] is a {type(V).__name__}, not a function space.")
    if not spaces:
        return MPI.COMM_SELF
    first = spaces[0].mesh
    for i, V in enumerate(spaces):
        mesh = V.mesh
        n = mesh.geometry.dim
        if MPI.Comm.Compare(first.comm, mesh.comm) not in (MPI.IDENT, MPI.CONGRUENT):
            raise InterfaceError(
                f"the meshes of spaces[0] and spaces[{i}] live on different communicators; make "
                "all on one."
            )
        if mesh.topology.dim != n or n != first.geometry.dim or n not in (2, 3):
            raise InterfaceError(
                f"spaces[{i}] lies on a {mesh.topology.dim}-dimensional mesh in {n} dimensions; "
                "bodies must be all 2D in the plane or all 3D in space."
            )
        same = next((j for j in range(i) if spaces[j].mesh is mesh), None)
        if same is not None:
            raise InterfaceError(
                f"spaces[{same}] and spaces[{i}] are on one mesh; give each mesh once (its parts "
                "are told apart)."
            )
        _, reason = lagrange_element(Component.of(V).space)
        raise_on_all(first.comm, reason and f"the space spaces[{i}] {reason}.")
    return first.comm


def _exterior_facets(V: fem.FunctionSpace, name: str) -> _Facets:
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
    height = np.einsum("fmi,fi->fm", all_x[facet_nodes] - x[:, :1], unit_normals(x[:, :n]))
    # The last vertex of a quadrilateral may be out of the plane of the others, on both sides alike
    height[:, : num_vertices[cell]] = 0
    centres = all_x[compat.geometry_dofmap(mesh)[cells]].mean(axis=1)
    outwards = np.einsum("fi,fi->f", unit_normals(x[:, :n]), x.mean(axis=1) - centres)
    height *= np.sign(outwards)[:, None]
    return _Facets(
        index=index,
        x=x,
        nodes=mesh.geometry.index_map().local_to_global(nodes.ravel()).reshape(nodes.shape),
        inside=centres,
        heights=np.column_stack([(sign * height).max(axis=1, initial=0) for sign in (1, -1)]),
        part=graph.connected(V)[0][V.dofmap.list[cells, 0]],
    )


def _bodies(facets: _Facets) -> list[_Boundary]:
    """The boundary of each connected part of a mesh, in the order of their positions."""
    split = _SIMPLICES[facets.x.shape[1]]
    x, nodes = (np.concatenate([a[:, s] for s in split]) for a in (facets.x, facets.nodes))
    facet = np.tile(np.arange(len(facets.x)), len(split))
    inwards = np.einsum("fi,fi->f", unit_normals(x), x.mean(axis=1) - facets.inside[facet]) < 0
    x[inwards], nodes[inwards] = x[inwards, ::-1], nodes[inwards, ::-1]
    curvature, turn = _curvature(x, nodes)
    # Known for facets that are curved themselves
    heights = facets.heights[facet]
    size = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)
    turn = np.maximum(turn, 8 * heights.max(axis=1) / np.where(size > 0, size, 1))
    boundary = _Boundary(x, nodes, facet, curvature, heights, turn)
    part = facets.part[facet]
    lowest = []
    for p in range(int(part.max(initial=-1)) + 1):
        vertices = x[part == p].reshape(-1, x.shape[2])
        lowest.append(vertices[np.lexsort(vertices.T[::-1])[0]])
    return [boundary[part == p] for p in np.lexsort(np.reshape(lowest, (-1, x.shape[2])).T[::-1])]


def _curvature(x: npt.NDArray, nodes: npt.NDArray):
    """Curvature tensors of the surface at each of its simplices, and the largest turn there.

    A circle of radius R turns by θ = h / R from one edge h to the next one. Of a ridge between two
    simplices, θ / h is the curvature across it, h being the height of the smaller one over the
    ridge; a triangle has the sum of its ridges' tensors.

    Returns:
        ``(num, 2, n, n)``, as of :class:`_Boundary`, and ``(num,)``.
    """
    num, n = len(x), x.shape[2]
    normals = unit_normals(x)
    # Opposite to vertex k: the ridge between the others, or in 2D the other vertex
    others = np.stack([np.delete(np.arange(n), k) for k in range(n)])
    ridges = np.sort(nodes[:, others], axis=2).reshape(-1, n - 1)
    order = np.lexsort(ridges.T)
    same = (np.diff(ridges[order], axis=0) == 0).all(axis=1)
    a, b = order[:-1][same], order[1:][same]
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
    cosine = np.einsum("ei,ei->e", normals[f], normals[g])
    theta = np.arccos(np.clip(cosine, -1, 1))
    inwards = (np.einsum("ei,ei->e", ways[1], normals[f]) > 0).astype(np.intp)
    corner = theta > CORNER_ASSEMBLY
    # Ridges at the vertices beyond
    going = np.zeros((2, len(f)))  # (side, ridge)
    touching = ridges[a]
    at = np.argsort(touching.ravel(), kind="stable")
    first = np.searchsorted(touching.ravel()[at], np.arange(nodes.max(initial=-1) + 2))
    for side, (vertex, way) in enumerate(zip((nodes[f, k], nodes[g, m]), ways, strict=True)):
        count = first[vertex + 1] - first[vertex]
        ridge = np.repeat(np.arange(len(f)), count)
        beyond = at[
            np.arange(len(ridge))
            - np.repeat(np.cumsum(count) - count, count)
            + np.repeat(first[vertex], count)
        ] // (n - 1)
        turns = theta[beyond] * (1 - np.einsum("ei,ei->e", along[beyond], way[ridge]) ** 2)
        np.maximum.at(going[side], ridge, turns)
    curved = np.where(corner, 0, np.minimum(theta, GOES_ON * going.min(axis=0)))
    smooth = theta <= curved + FILE_DIGITS
    height = height.min(axis=0)
    size = curved / np.where(height > 0, height, 1)
    K, turn = np.zeros((num, 2, n, n)), np.zeros(num)
    for simplex, way in zip((f, g), ways, strict=True):
        np.maximum.at(turn, simplex, curved)
        tensors = size[:, None, None] * way[:, :, None] * way[:, None]
        np.add.at(K, (simplex, inwards), tensors)
    if n == 2:
        K /= 2
    return _around(K, turn, normals, f[smooth], g[smooth])


def _around(
    K: npt.NDArray, turn: npt.NDArray, normals: npt.NDArray, f: npt.NDArray, g: npt.NDArray
):
    """Largest tensors and turns of simplices and their neighbours: narrow ones hardly turn.

    Tensors of neighbours are turned with the normals. The triangle at the end of a curved surface
    has no ridge that turns.
    """
    near, trace = K.copy(), np.einsum("psii->ps", K)
    own, other = np.concatenate((f, g)), np.concatenate((g, f))
    largest_turn = turn.copy()
    np.maximum.at(largest_turn, own, turn[other])
    for s in range(2):
        order = np.argsort(trace[other, s], kind="stable")  # the largest comes last
        mine, largest = own[order], other[order]
        larger = trace[largest, s] > trace[mine, s]
        mine, largest = mine[larger], largest[larger]
        a, b = normals[largest], normals[mine]
        both = a + b
        R = 2 * b[:, :, None] * a[:, None] + np.eye(a.shape[1])
        R -= both[:, :, None] * both[:, None] / (1 + np.einsum("pi,pi->p", a, b))[:, None, None]
        near[mine, s] = R @ K[largest, s] @ R.transpose(0, 2, 1)
    return near, largest_turn


def _all_pairs(bodies: list[tuple[int, _Boundary]], distance: float | None):
    """Facets that touch: a list of ((space, facets), (space, facets), apart, explained)."""
    boxes = [body.boxes(distance) for _, body in bodies]
    hulls = np.array([(b[:, 0].min(axis=0), b[:, 1].max(axis=0)) for b in boxes])
    found = []
    for i, j in _meeting(hulls, hulls):
        if i >= j:
            continue
        (space0, body0), (space1, body1) = bodies[i], bodies[j]
        f, g = _meeting(boxes[i], boxes[j]).T
        touch, apart, why = _touch(body0[f], body1[g], distance)
        if len(touch):
            sides = [_with_fans(*part) for part in ((body0, f[touch]), (body1, g[touch]))]
            k = int(np.abs(apart).argmax())
            pair = (space0, sides[0]), (space1, sides[1]), float(apart[k]), EXPLANATIONS[why[k]]
            found.append(pair)
    return found


def _with_fans(body: _Boundary, simplices: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Facets of some simplices; with those around vertices in which they would only touch."""
    facets = np.unique(body.facet[simplices])
    if body.x.shape[2] == 2:
        return facets
    while True:
        own = np.flatnonzero(np.isin(body.facet, facets))
        fan, node = _fans(body, own, np.pi)
        _, first = np.unique(fan, return_index=True)  # a corner of each fan
        of, number = np.unique(node[first], return_counts=True)
        touching = of[number > 1]
        near = np.flatnonzero(np.isin(body.nodes, touching).any(axis=1))
        fan, node = _fans(body, near, CORNER_ASSEMBLY)
        mine = np.isin(node, touching) & np.isin(fan, fan[np.isin(np.repeat(near, 3), own)])
        more = np.union1d(facets, body.facet[np.repeat(near, 3)[mine]])
        if len(more) == len(facets):
            return facets
        facets = more


def _fans(body: _Boundary, simplices: npt.NDArray[np.intp], most: float):
    """Numbers of triangles' corners, one for those around a vertex that edges connect, and nodes.

    Edges at which the surface turns by more than ``most`` don't connect.
    """
    nodes, normals = body.nodes[simplices], body.normals[simplices]
    edges = np.sort(np.stack((nodes, np.roll(nodes, -1, axis=1)), axis=2), axis=2).reshape(-1, 2)
    order = np.lexsort(edges.T)
    same = (np.diff(edges[order], axis=0) == 0).all(axis=1)
    a, b = order[:-1][same], order[1:][same]
    smooth = np.einsum("ei,ei->e", normals[a // 3], normals[b // 3]) >= np.cos(most)
    a, b = a[smooth], b[smooth]
    # Boundaries have one direction of travel: an edge starts where the other one's ends
    ends = [3 * (e // 3) + (e + 1) % 3 for e in (a, b)]
    corner = graph.components(3 * len(simplices), np.append(a, ends[0]), np.append(ends[1], b))
    return corner, nodes.ravel()


def _meeting(boxes0: npt.NDArray, boxes1: npt.NDArray) -> npt.NDArray[np.intp]:
    """Pairs of boxes ``(num, 2, n)`` that meet, sorted, by bisection of the larger set."""
    boxes, found = (boxes0, boxes1), [np.empty((0, 2), dtype=np.intp)]
    todo = [(np.arange(len(boxes0)), np.arange(len(boxes1)))]
    while todo:
        sets = list(todo.pop())
        for k in (0, 1):
            if len(sets[1 - k]):
                others = boxes[1 - k][sets[1 - k]]
                hull = np.stack((others[:, 0].min(axis=0), others[:, 1].max(axis=0)))
                sets[k] = sets[k][_meet(boxes[k][sets[k]], hull)]
        i, j = sets
        if not len(i) or not len(j):
            continue
        if len(i) * len(j) <= 4096:  # compared pair by pair
            at0, at1 = np.nonzero(_meet(boxes0[i][:, None], boxes1[j][None]))
            found.append(np.column_stack((i[at0], j[at1])))
            continue
        k = int(len(j) > len(i))
        centres = boxes[k][sets[k]].sum(axis=1)
        order = np.argsort(centres[:, np.ptp(centres, axis=0).argmax()], kind="stable")
        for half in np.array_split(sets[k][order], 2):
            todo.append((half, j) if k == 0 else (i, half))
    pairs = np.concatenate(found)
    return pairs[np.lexsort(pairs.T[::-1])]


def _meet(a: npt.NDArray, b: npt.NDArray) -> npt.NDArray[np.bool_]:
    """Mask of boxes ``(..., 2, n)`` that meet."""
    return (a[..., 0, :] <= b[..., 1, :]).all(axis=-1) & (b[..., 0, :] <= a[..., 1, :]).all(axis=-1)


def _touch(a: _Boundary, b: _Boundary, distance: float | None):
    """Pairs of simplices that touch.

    Returns:
        Their numbers, their largest distances (negative if they overlap), and the numbers of what
        explains these, among :data:`EXPLANATIONS`.
    """
    limit = np.minimum(TILT + TURNS_EXPLAINED * (a.turn + b.turn), FACING_ANGLE)
    facing = np.flatnonzero(np.einsum("pi,pi->p", a.normals, b.normals) < -np.cos(limit))
    a, b = a[facing], b[facing]
    n0, n1 = a.normals, b.normals
    normal = n0 - n1
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    axes = axes_across(normal)  # (pair, axis, n)
    origin = a.x[:, :1]
    flat0, flat1 = (np.einsum("pvi,pai->pva", x - origin, axes) for x in (a.x, b.x))
    vertices, middle, common, smaller = common_part(flat0, flat1[:, ::-1])
    some = common > FILE_DIGITS * smaller
    a, b = a[some], b[some]
    n0, n1, normal, axes, origin, flat0, flat1 = (
        v[some] for v in (n0, n1, normal, axes, origin, flat0, flat1)
    )
    at = np.concatenate((vertices[some], middle[some, None]), axis=1)  # (pair, point, axis)
    points = origin + at @ axes
    heights = [
        np.einsum("pqi,pi->pq", x[:, :1] - points, n) / np.einsum("pi,pi->p", normal, n)[:, None]
        for x, n in ((a.x, n0), (b.x, n1))
    ]
    # Of points on one simplex from the other's plane
    apart = (heights[1] - heights[0]) * np.einsum("pi,pi->p", normal, n0)[:, None]
    flat = np.broadcast_to(NEAR_FLAT * np.minimum(a.size, b.size)[:, None], apart.shape)
    bulges = a.bulges(_shares(flat0, at)) + b.bulges(_shares(flat1, at))
    curved = np.where(apart > 0, bulges[..., 0], bulges[..., 1]) + flat
    reach = curved if distance is None else np.full(apart.shape, distance)
    # Beside each other they are seen by their distance, as far as the normal is uncertain
    low, high = vertices[some].min(axis=1), vertices[some].max(axis=1)
    extent = np.linalg.norm(high - low, axis=1) if a.x.shape[2] == 3 else 1.0
    seen = np.abs(apart).max(axis=1) * np.tan((a.turn + b.turn) / 4)
    seen = np.minimum(seen, SEEN * np.minimum(a.size, b.size))
    wide = common[some] > seen * extent
    touch = np.flatnonzero((np.abs(apart) <= reach).all(axis=1) & wide)
    largest = touch, np.abs(apart[touch]).argmax(axis=1)
    far = np.abs(apart[largest])
    why = np.where(far <= flat[largest], 0, np.where(far <= curved[largest], 1, 2))
    return facing[some][touch], apart[largest], why


def _shares(simplices: npt.NDArray, points: npt.NDArray) -> npt.NDArray[np.float64]:
    """Barycentric coordinates of points, ``(num, num_points, n)``."""
    edges = simplices[:, 1:] - simplices[:, :1]
    last = (points - simplices[:, :1]) @ np.linalg.pinv(edges)
    return np.clip(np.concatenate((1 - last.sum(axis=2, keepdims=True), last), axis=2), 0, 1)
