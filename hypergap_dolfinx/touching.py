# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Search for bodies that touch and their facets: the sides of an assembly's ties."""

from collections.abc import Sequence
from dataclasses import dataclass
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
    NEAR_FLAT,
    TILT,
    TURNS_EXPLAINED,
)

# A facet that is a quadrilateral, as two triangles; its vertices as DOLFINx orders them
_SIMPLICES = {2: [[0, 1]], 3: [[0, 1, 2]], 4: [[0, 1, 3], [0, 3, 2]]}


class Touching(NamedTuple):
    """Facets of two bodies that lie on each other: the two sides of a tie."""

    side0: tuple[fem.FunctionSpace, npt.NDArray[np.int32]]
    """The first body's space, and this rank's facets of it."""
    side1: tuple[fem.FunctionSpace, npt.NDArray[np.int32]]
    """The same of the second one."""


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
    bulge: npt.NDArray[np.float64]
    """Distance of the geometry's nodes from the flat facet, ``(num_facets,)``."""
    part: npt.NDArray[np.int32]
    """Connected part of the mesh, ``(num_facets,)``."""


@dataclass(frozen=True)
class _Boundary:
    """The boundary of a body, in simplices."""

    x: npt.NDArray[np.float64]
    """Vertices in the order in which the normal points out of the body, ``(num, n, n)``."""
    facet: npt.NDArray[np.intp]
    """Number among all ranks' facets of the space, ``(num,)``."""
    bulge: npt.NDArray[np.float64]
    """Largest distance of the curved surface from the simplex, ``(num,)``."""
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

    def boxes(self, distance: float | None) -> npt.NDArray[np.float64]:
        """Lower and upper corners of boxes that meet if simplices may touch, ``(num, 2, n)``."""
        reach = self.bulge + NEAR_FLAT * self.size if distance is None else distance
        reach = np.broadcast_to(reach, len(self.x))[:, None]
        return np.stack((self.x.min(axis=1) - reach, self.x.max(axis=1) + reach), axis=1)

    def __getitem__(self, chosen) -> "_Boundary":
        return _Boundary(self.x[chosen], self.facet[chosen], self.bulge[chosen], self.turn[chosen])


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
            (up to 65°), is allowed. Parts with a smaller clearance, or thinner layers, need a
            distance. With one, normals may deviate from opposite ones by 60°, without by 5° plus
            the surface's turn between facets.

    Returns:
        A pair of sides for :class:`Tie` for each two bodies that touch, each a space and this
        rank's facets (possibly none); in the order of ``spaces``, and of the positions of a mesh's
        parts.

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

    return [Touching(side(*a), side(*b)) for a, b in found]


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
    return _Facets(
        index=index,
        x=x,
        nodes=mesh.geometry.index_map().local_to_global(nodes.ravel()).reshape(nodes.shape),
        inside=all_x[compat.geometry_dofmap(mesh)[cells]].mean(axis=1),
        bulge=np.abs(height).max(axis=1, initial=0),
        part=graph.connected(V)[0][V.dofmap.list[cells, 0]],
    )


def _bodies(facets: _Facets) -> list[_Boundary]:
    """The boundary of each connected part of a mesh, in the order of their positions."""
    split = _SIMPLICES[facets.x.shape[1]]
    x, nodes = (np.concatenate([a[:, s] for s in split]) for a in (facets.x, facets.nodes))
    facet = np.tile(np.arange(len(facets.x)), len(split))
    inwards = np.einsum("fi,fi->f", unit_normals(x), x.mean(axis=1) - facets.inside[facet]) < 0
    x[inwards], nodes[inwards] = x[inwards, ::-1], nodes[inwards, ::-1]
    bulge, turn = _curvature(x, nodes)
    # Known for facets that are curved themselves
    known = facets.bulge[facet]
    size = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)
    turn = np.maximum(turn, 8 * known / np.where(size > 0, size, 1))
    boundary = _Boundary(x, facet, np.maximum(BULGES * bulge, known), turn)
    part = facets.part[facet]
    lowest = []
    for p in range(int(part.max(initial=-1)) + 1):
        vertices = x[part == p].reshape(-1, x.shape[2])
        lowest.append(vertices[np.lexsort(vertices.T[::-1])[0]])
    return [boundary[part == p] for p in np.lexsort(np.reshape(lowest, (-1, x.shape[2])).T[::-1])]


def _curvature(x: npt.NDArray, nodes: npt.NDArray):
    """Distance of the curved surface from each of its simplices, and the largest turn at it.

    An edge h of a circle turns by θ = h / R to the next one, and is up to hθ / 8 away from it.
    Beside a chamfer the smaller of two simplices counts.
    """
    num, n = len(x), x.shape[2]
    normals = unit_normals(x)
    edges = np.linalg.norm(np.roll(x, 1, axis=1) - np.roll(x, 2, axis=1), axis=2)  # (num, n)
    if n == 2:
        height = np.linalg.norm(x[:, 1] - x[:, 0], axis=1)[:, None].repeat(2, axis=1)
    else:
        area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
        height = area[:, None] / np.where(edges > 0, edges, 1)
    # Opposite to vertex k: the edge between the others, or in 2D the other vertex
    ridges = np.sort(np.stack([np.delete(nodes, k, axis=1) for k in range(n)], axis=1), axis=2)
    order = np.lexsort(ridges.reshape(-1, n - 1).T)
    same = (np.diff(ridges.reshape(-1, n - 1)[order], axis=0) == 0).all(axis=1)
    a, b = order[:-1][same], order[1:][same]
    f, g = a // n, b // n
    cosine = np.einsum("ei,ei->e", normals[f], normals[g])
    theta = np.arccos(np.clip(cosine, -1, 1))
    theta[theta > CORNER_ASSEMBLY] = 0
    sag = np.minimum(height.ravel()[a], height.ravel()[b]) * theta / 8
    bulge, turn = np.zeros(num), np.zeros(num)
    for at in (f, g):
        np.maximum.at(turn, at, theta)
        # A triangle of a sphere is as far from it as its three edges' turns add up to
        (np.maximum if n == 2 else np.add).at(bulge, at, sag)
    # Triangles turn unevenly, narrow ones hardly: take the largest distance around
    smooth, around = theta > 0, bulge.copy()
    np.maximum.at(around, f[smooth], bulge[g[smooth]])
    np.maximum.at(around, g[smooth], bulge[f[smooth]])
    return around, turn


def _all_pairs(bodies: list[tuple[int, _Boundary]], distance: float | None):
    """Facets that touch: a list of ((space, facets), (space, facets))."""
    boxes = [body.boxes(distance) for _, body in bodies]
    hulls = np.array([(b[:, 0].min(axis=0), b[:, 1].max(axis=0)) for b in boxes])
    found = []
    for i, j in _meeting(hulls, hulls):
        if i >= j:
            continue
        (space0, body0), (space1, body1) = bodies[i], bodies[j]
        f, g = _meeting(boxes[i], boxes[j]).T
        touch = _touch(body0[f], body1[g], distance)
        if touch.any():
            sides = np.unique(body0.facet[f[touch]]), np.unique(body1.facet[g[touch]])
            found.append(((space0, sides[0]), (space1, sides[1])))
    return found


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


def _touch(a: _Boundary, b: _Boundary, distance: float | None) -> npt.NDArray[np.bool_]:
    """Mask of pairs of simplices that touch."""
    n0, n1 = a.normals, b.normals
    if distance is None:
        limit = np.minimum(TILT + TURNS_EXPLAINED * (a.turn + b.turn), FACING_ANGLE)
        reach = np.maximum(a.bulge, b.bulge) + NEAR_FLAT * np.minimum(a.size, b.size)
    else:
        limit, reach = np.full(len(n0), FACING_ANGLE), np.full(len(n0), distance)
    touch = np.einsum("pi,pi->p", n0, n1) < -np.cos(limit)
    f = np.flatnonzero(touch)
    n0, n1, x0, x1 = n0[f], n1[f], a.x[f], b.x[f]
    normal = n0 - n1
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    axes = axes_across(normal)  # (pair, axis, n)
    origin = x0[:, :1]
    flat0, flat1 = (np.einsum("pvi,pai->pva", x - origin, axes) for x in (x0, x1))
    middle, common, smaller = common_part(flat0, flat1[:, ::-1])
    point = origin[:, 0] + np.einsum("pa,pai->pi", middle, axes)
    heights = [
        np.einsum("pi,pi->p", x[:, 0] - point, n) / np.einsum("pi,pi->p", normal, n)
        for x, n in ((x0, n0), (x1, n1))
    ]
    near = np.abs(heights[1] - heights[0]) <= reach[f]
    touch[f] = near & (common > FILE_DIGITS * smaller)
    return touch
