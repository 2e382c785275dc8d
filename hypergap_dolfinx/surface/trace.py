# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Trace of a function space on the facets of an interface, gathered over the ranks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix
from dolfinx import fem
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.core.collective import gathered, raise_on_all
from hypergap_dolfinx.core.compiled import doubles, ints
from hypergap_dolfinx.core.graph import row_codes
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.surface.projection import terms
from hypergap_dolfinx.surface.tolerances import (
    CORNER_ASSEMBLY,
    FILE_DIGITS,
    NOISE,
    SAME_NODE,
    STRAIGHT,
)


@dataclass(frozen=True)
class Surface:
    """One side Γ_i of an interface: the same arrays on every rank.

    The vertices of a facet are ordered such that its normal points out of the body: in 2D the
    body is on the left, in 3D triangles turn counterclockwise seen from outside, and so do the
    reference coordinates (0, 0), (1, 0), (0, 1), (1, 1) of quadrilaterals, in this order.
    """

    name: str
    """Name for messages, Γ0 or Γ1."""
    x: npt.NDArray[np.float64]
    """Vertex coordinates, ``(num_vertices, n)``."""
    facets: npt.NDArray[np.int32]
    """Vertices of each facet, ``(num_facets, n)``; of quadrilaterals ``(num_facets, 4)``."""
    own_nodes: npt.NDArray[np.float64] | None
    """Coordinates of the geometry nodes of each facet, ``(num_facets, num_nodes, n)``; None of
    straight facets: the vertices."""
    dofs: npt.NDArray[np.int64]
    """Global dofs (blocks) of each facet, ordered as ``element``'s, ``(num_facets, num_dofs)``."""
    owner: npt.NDArray[np.int32]
    """Rank that owns the body's cell behind each facet, ``(num_facets,)``."""
    geometry: basix.finite_element.FiniteElement
    """Lagrange element of the facets' geometry."""
    element: basix.finite_element.FiniteElement
    """Lagrange element of the trace."""
    dof_range: npt.NDArray[np.int64]
    """Offsets of the ranks' owned dofs (blocks) of the space, ``(num_ranks + 1,)``."""
    num_parts: int = 1
    """Parts of a facet of the mesh: facet f is part f % num_parts of one, with the dofs of all."""
    turned: npt.NDArray[np.complex128] | None = None
    """What of :attr:`nodes` turns with the chord of the mesh's edge, over that, as complex numbers,
    and 0 at the ends, ``(num_facets, num_nodes)``; None: nothing (see :attr:`arcs`)."""
    angle: float = 0.0
    """Angle by which a body of revolution is swept about x[0] = 0, 2π or 1; 0 for others."""

    def arc(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Factor of areas at points ``(..., n)``: r times the angle of a body of revolution, or 1.

        Returns:
            ``(...)``.
        """
        return self.angle * x[..., 0] if self.angle else np.ones(x.shape[:-1])

    @property
    def gdim(self) -> int:
        """Geometric dimension n."""
        return self.x.shape[1]

    @property
    def nodes(self) -> npt.NDArray[np.float64]:
        """Coordinates of the geometry nodes of each facet, ``(num_facets, num_nodes, n)``."""
        return self.nodes_of(slice(None))

    def nodes_of(self, facets) -> npt.NDArray[np.float64]:
        """The same of some facets."""
        return self.x[self.facets[facets]] if self.own_nodes is None else self.own_nodes[facets]

    @property
    def polygons(self) -> npt.NDArray[np.int32]:
        """Vertices of each facet in cyclic order: edge k goes from k to k + 1."""
        return around(self.facets)

    @cached_property
    def size(self) -> npt.NDArray[np.float64]:
        """Longest edge of each facet, ``(num_facets,)``."""
        v = self.x[self.polygons]
        edges = np.stack([lengths(v[:, k] - v[:, k - 1]) for k in range(v.shape[1])])
        return edges.max(axis=0)

    @cached_property
    def vertex_sizes(self) -> npt.NDArray[np.float64]:
        """Size of the largest facet at each vertex, ``(num_vertices,)``."""
        found = np.zeros(len(self.x))
        np.maximum.at(found, self.facets, self.size[:, None])
        return found

    @cached_property
    def normals(self) -> npt.NDArray[np.float64]:
        """Unit outward normals of the facets' vertices, ``(num_facets, n)``."""
        return unit_normals(self.x[self.facets])

    @cached_property
    def vertex_normals(self) -> npt.NDArray[np.float64]:
        """Mean of the facets' unit normals at the vertices, normalised, ``(num_vertices, n)``."""
        total = np.zeros_like(self.x)
        np.add.at(total, self.facets, self.normals[:, None])
        return total / np.maximum(lengths(total), np.finfo(float).tiny)[:, None]

    @cached_property
    def straight_nodes(self) -> npt.NDArray[np.float64]:
        """Geometry nodes interpolated from the vertices, shaped as ``nodes``."""
        if len(self.geometry.points) == self.facets.shape[1]:
            return self.nodes
        linear = basix.create_element(basix.ElementFamily.P, self.geometry.cell_type, 1)
        return tabulate(linear, self.geometry.points) @ self.x[self.facets]

    @cached_property
    def curved(self) -> npt.NDArray[np.bool_]:
        """Mask of facets with geometry nodes off ``straight_nodes``, ``(num_facets,)``.

        A bilinear quadrilateral isn't curved, though it may be warped.
        """
        if len(self.geometry.points) == self.facets.shape[1]:
            return np.zeros(len(self.facets), dtype=bool)
        return self._is_off(np.abs(self.nodes - self.straight_nodes).max(axis=(1, 2)))

    @cached_property
    def folded(self) -> npt.NDArray[np.bool_]:
        """Mask of curved facets that face back somewhere, ``(num_facets,)``."""
        points, _ = basix.make_quadrature(self.geometry.cell_type, 2 * self.geometry.degree)
        dX = self.geometry.tabulate(1, points)[1:, :, :, 0]  # (X_j, point, node)
        on = np.flatnonzero(self.curved)
        d = [np.einsum("pa,fai->fpi", derivative, self.nodes[on]) for derivative in dX]
        if self.gdim == 2:
            ends = self.x[self.facets[on]]
            ahead = np.einsum("fpi,fi->fp", d[0], ends[:, 1] - ends[:, 0])
        else:
            ahead = np.einsum("fpi,fi->fp", np.cross(*d), self.normals[on])
        found = np.zeros(len(self.facets), dtype=bool)
        found[on] = (ahead <= 0).any(axis=1)
        return found

    @cached_property
    def affine(self) -> npt.NDArray[np.bool_]:
        """Mask of facets that are affine images of the reference facet, ``(num_facets,)``."""
        v = self.x[self.facets]
        if v.shape[1] < 4:
            return ~self.curved
        twist = np.abs(v[:, 0] - v[:, 1] - v[:, 2] + v[:, 3]).max(axis=1)
        return ~(self.curved | self._is_off(twist))

    def _is_off(self, deviation) -> npt.NDArray[np.bool_]:
        """Mask of facets where a distance is more than round-off."""
        # Coordinates carry a rounding error of their own, which grows away from the origin
        return deviation > STRAIGHT * self.size + NOISE * np.abs(self.x).max()

    @cached_property
    def edge_numbers(self) -> npt.NDArray[np.intp]:
        """Number from 0 of each facet's edges (2D: vertices), ``(num_facets, num_edges)``."""
        key = start = self.polygons.astype(np.int64)
        if self.gdim == 3:
            end = np.roll(start, -1, axis=1)
            key = np.minimum(start, end) * len(self.x) + np.maximum(start, end)
        _, where = np.unique(key, return_inverse=True)
        return where.reshape(key.shape)

    @cached_property
    def is_outline(self) -> npt.NDArray[np.bool_]:
        """Mask of edges (2D: vertices) of one facet only, ``(num_facets, num_edges)``."""
        return np.bincount(self.edge_numbers.ravel())[self.edge_numbers] == 1

    @cached_property
    def outline(self) -> npt.NDArray[np.int32]:
        """Ends of the boundary's edges, ``(num_edges, 2)``; in the plane vertices, twice each."""
        start = self.polygons
        end = start if self.gdim == 2 else np.roll(start, -1, axis=1)
        return np.column_stack((start[self.is_outline], end[self.is_outline]))

    @cached_property
    def at_end(self) -> npt.NDArray[np.bool_]:
        """Mask of vertices where the surface ends, ``(num_vertices,)``."""
        found = np.zeros(len(self.x), dtype=bool)
        found[self.outline] = True
        return found

    @cached_property
    def polynomials(self) -> dict[str, Any]:
        """Fields of ``Facets`` in ``c/space.h``: facets in space and their basis functions."""
        corners = basix.geometry(self.geometry.cell_type)
        middle, origins = corners.mean(axis=0), self.nodes[:, :1]
        powers, to_terms = terms(self.geometry, middle)
        return {
            "num_facets": len(self.facets),
            "num_corners": len(corners),
            "vertices": ints(self.polygons),
            "x": doubles(self.x),
            "middle": middle.tolist(),
            "num_terms": len(powers),
            "powers": ints(powers),
            "origins": doubles(origins),
            "factors": doubles(to_terms @ (self.nodes - origins)),
            "num_dofs": self.element.dim,
            "functions": doubles(to_terms @ self.functions(self.geometry.points)),
        }

    def functions(self, X) -> npt.NDArray[np.float64]:
        """Values of the dofs' functions at points of parts, ``(num_parts, num_points, num_dofs)``.

        Args:
            X: Reference coordinates on a part, ``(num_points, dim)``.
        """
        at = self.on_whole(X).reshape(-1, X.shape[1])
        return tabulate(self.element, at).reshape(self.num_parts, len(X), -1)

    def on_whole(self, X) -> npt.NDArray[np.float64]:
        """Points of parts on their facet of the mesh, ``(num_parts, num_points, dim)``."""
        if self.num_parts == 1:
            return X[None]
        factors, origins = _parts(self.geometry.cell_type)
        return origins[:, None] + factors[:, None, None] * X

    @property
    def arcs(self) -> "Surface":
        r"""In the plane: edges of degree 2 as arcs of the circles through their three nodes.

        A parabola through nodes of a circle is off it by h⁴/R³ between them, and by far more where
        the middle one isn't half-way. The arc has degree 4,

        .. math:: x(t) = x_2(t) + d_0\,t (1 - t)^2 (1 - 2t) + d_1\,t^2 (1 - t) (1 - 2t),

        with the parabola x₂, and d that turn its tangents at both ends to the circle's. What is
        added turns and stretches with the edge's chord as the edge moves: a body that turns keeps
        its shape, and moments of pressures balance. Straight edges stay as they are.
        """
        if self.gdim != 2 or len(self.geometry.points) != 3 or not self.curved.any():
            return self
        ends = self.geometry.tabulate(1, basix.geometry(self.geometry.cell_type))[1, :, :, 0]
        start, end, middle = self.nodes.swapaxes(0, 1)
        chords = (middle - start, end - start, end - middle)
        first, whole, last = (chord @ (1, 1j) / lengths(chord) for chord in chords)
        circle = np.stack((first * whole / last, last * whole / first), axis=1)
        tangents = np.einsum("em,fmi->fei", ends, self.nodes) @ (1, 1j)  # (facet, end)
        ratio = circle * tangents.conj()
        known = self.curved[:, None] & (ratio.real > np.abs(ratio.imag))  # not by 45° and more
        tilt = np.divide(ratio.imag, ratio.real, out=np.zeros(known.shape), where=known)
        d = 1j * tangents * tilt
        kind = self.geometry.family, self.geometry.cell_type, 4, self.geometry.lagrange_variant
        finer = basix.create_element(*kind)
        t, every = finer.points, np.arange(len(self.facets))
        bumps = np.hstack((t * (1 - t) ** 2, t**2 * (1 - t))) * (1 - 2 * t)
        nodes = self.points(np.repeat(every, len(t)), np.tile(t, (len(every), 1)))
        added = d @ bumps.T
        nodes = nodes.reshape(len(every), -1, 2) + np.stack((added.real, added.imag), axis=-1)
        turned = added / ((end - start) @ (1, 1j))[:, None]
        return replace(self, own_nodes=nodes, geometry=finer, turned=turned)

    @property
    def split(self) -> "Surface":
        """The surface with facets cut at the nodes of degree 2: edges in two, others in four.

        Parts have the shape of their facet, curved ones too, its dofs and its owner; vertices in
        the middle are behind all others.
        """
        whole = basix.create_element(basix.ElementFamily.P, self.geometry.cell_type, 2)
        corners = basix.geometry(self.geometry.cell_type)
        factors, _ = _parts(self.geometry.cell_type)
        parts, every = replace(self, num_parts=len(factors)), np.arange(len(self.facets))
        X = parts.on_whole(corners).reshape(-1, corners.shape[1])
        nodes = self._numbers_of_nodes(whole)
        x = np.empty((nodes.max() + 1, self.gdim))
        points = self.points(np.repeat(every, whole.dim), np.tile(whole.points, (len(every), 1)))
        x[nodes] = points.reshape(*nodes.shape, -1)
        x[: len(self.x)] = self.x
        at = _match(X, whole.points)
        assert at is not None
        facets = nodes[:, at].reshape(-1, len(corners)).astype(np.int32)
        X = parts.on_whole(self.geometry.points).reshape(-1, corners.shape[1])
        points = self.points(np.repeat(every, len(X)), np.tile(X, (len(every), 1)))
        dofs, owner = (
            np.repeat(self.dofs, len(factors), axis=0),
            np.repeat(self.owner, len(factors)),
        )
        points = points.reshape(len(facets), -1, self.gdim)
        turned = self.turned
        if turned is not None:
            turned = (turned @ tabulate(self.geometry, X).T).reshape(len(facets), -1)
        return replace(
            parts, x=x, facets=facets, own_nodes=points, dofs=dofs, owner=owner, turned=turned
        )

    def _numbers_of_nodes(self, element: basix.finite_element.FiniteElement):
        """Numbers of nodes of degree 2 of facets, vertices' first, ``(num_facets, num_nodes)``."""
        edges, count = basix.topology(self.geometry.cell_type)[1], len(self.x)
        ends = np.sort(self.facets[:, edges], axis=2).astype(np.int64)
        _, number = np.unique(ends @ [count, 1], return_inverse=True)
        number = number.reshape(len(self.facets), -1)
        inside = number.max() + 1 + np.arange(len(self.facets))[:, None]
        numbers = np.hstack((self.facets, count + number, count + inside))
        at = [dofs for of in element.entity_dofs for dof in of for dofs in dof]
        result = np.empty((len(self.facets), element.dim), dtype=np.int64)
        result[:, at] = numbers[:, : element.dim]
        return result

    def points(self, facet, X) -> npt.NDArray[np.float64]:
        """Coordinates of points at reference coordinates X in facets, ``(num_points, n)``."""
        nodes = self.nodes_of(facet)
        # Sums of steps from the first node keep a coordinate that all nodes share to its last digit
        steps = nodes[:, 1:] - nodes[:, :1]
        return nodes[:, 0] + np.einsum("pa,pai->pi", tabulate(self.geometry, X)[:, 1:], steps)


def geometry_nodes(surfaces, degree: int) -> tuple[int, basix.LagrangeVariant]:
    """Degree and variant of Σ's coordinates: linear unless a surface is curved.

    On triangles the bilinear map of a quadrilateral is of degree 2. Geometry is then taken at the
    nodes of the φ_a, as displacements are, so that linear ones are exact; with φ_a of degree 1
    these are the vertices.

    Args:
        surfaces: Γ0 and Γ1.
        degree: Degree of the φ_a.
    """
    g = max(surface.geometry.degree if surface.curved.any() else 1 for surface in surfaces)
    if degree > 1 and not all(s.affine.all() for s in surfaces if s.facets.shape[1] == 4):
        return max(g, degree), basix.LagrangeVariant.gll_warped
    return g, basix.LagrangeVariant.equispaced


def tabulate(element: basix.finite_element.FiniteElement, X) -> npt.NDArray[np.float64]:
    """Values of a scalar element's basis at reference points, ``(num_points, num_dofs)``."""
    X = np.ascontiguousarray(X)
    if not len(X):  # basix 0.9 ends the process here
        return np.empty((0, element.dim))
    return element.tabulate(0, X)[0, :, :, 0]


@cache
def _parts(cell_type: basix.CellType) -> tuple[npt.NDArray, npt.NDArray]:
    """Factors, ``(num_parts,)``, and origins, ``(num_parts, dim)``, of a facet's parts.

    One at each vertex, and the one in the middle of a triangle, which is turned by 180°.
    """
    corners = basix.geometry(cell_type)
    factors, origins = np.full(len(corners), 0.5), corners / 2
    if cell_type == basix.CellType.triangle:
        return np.append(factors, -0.5), np.vstack((origins, (0.5, 0.5)))
    return factors, origins


def _barycentric(X: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Weights of the vertices of a simplex, ``(num_points, dim + 1)``."""
    return np.column_stack((1 - X.sum(axis=1), X))


def lengths(vectors) -> npt.NDArray[np.float64]:
    """Lengths of vectors, ``(num, n)``; NumPy's norm is slow over a short axis."""
    return np.sqrt(np.einsum("vi,vi->v", vectors, vectors))


def extents(points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Largest extents along an axis of groups of points, ``(num, num_points, n)``.

    A point at a time: NumPy's reductions are slow over a short axis.
    """
    low = high = points[:, 0]
    for k in range(1, points.shape[1]):
        low, high = np.minimum(low, points[:, k]), np.maximum(high, points[:, k])
    return (high - low).max(axis=1)


def unit_normals(v: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Unit normals of facets with the given vertices, ``(num, num_vertices, n)``.

    They point to the right of an edge, and up from a counterclockwise triangle.
    """
    normal = normals_by_area(v)
    length = lengths(normal)[:, None]
    return normal / np.where(length > 0, length, 1)


def normals_by_area(v: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Normals as long as an edge, or as twice the area of a triangle or a quadrilateral."""
    if v.shape[2] == 2:
        t = v[:, 1] - v[:, 0]
        return np.column_stack((t[:, 1], -t[:, 0]))
    if v.shape[1] == 3:
        return np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    return np.cross(v[:, 3] - v[:, 0], v[:, 2] - v[:, 1])  # its diagonals


def around(facets: npt.NDArray) -> npt.NDArray:
    """Vertices of facets, ``(num_facets, num_vertices)``, in cyclic order."""
    return facets[:, [0, 1, 3, 2]] if facets.shape[1] == 4 else facets


def _match(points, reference) -> npt.NDArray[np.intp] | None:
    """Index in ``reference`` of each of ``points``, or None if one is missing."""
    distance = np.linalg.norm(points[:, None] - reference[None], axis=2)
    index = distance.argmin(axis=1)
    return index if distance[np.arange(len(points)), index].max() < SAME_NODE else None


@cache
def _facet_tables(cell_type, element, facet_element):
    """Cell nodes at facet nodes for both orientations, ``(num_local_facets, 2, num_nodes)``."""
    fdim = len(basix.topology(cell_type)) - 2
    vertices = basix.geometry(cell_type)
    tables = []
    for facet in basix.topology(cell_type)[fdim]:
        for turned in (facet, [facet[0], facet[2], facet[1]] if fdim == 2 else facet[::-1]):
            v = vertices[turned[: fdim + 1]]  # facets of reference cells are affine
            tables.append(_match(_barycentric(facet_element.points) @ v, element.points))
            assert tables[-1] is not None
    return np.reshape(tables, (-1, 2, len(facet_element.points)))


def is_mixed(V: fem.FunctionSpace) -> bool:
    """True if a space has components of different elements."""
    return V.num_sub_spaces > 0 and V.num_sub_spaces > V.ufl_element().block_size


def lagrange_element(V: fem.FunctionSpace) -> tuple[basix.finite_element.FiniteElement, str | None]:
    """The scalar Lagrange element of a space and None, or None and the reason as a message."""
    if V.component():
        return None, "is a subspace, which only sides of ties and contacts may be"
    if is_mixed(V):
        return None, "is mixed; a tie takes its components one by one, W.sub(0) for example"
    try:
        element = V.ufl_element().basix_element
    except (NotImplementedError, AttributeError):  # of quadrature points, or of real numbers
        element = None
    if (
        element is None
        or element.family != basix.ElementFamily.P
        or element.discontinuous
        or element.degree < 1
        or V.value_size != V.dofmap.index_map_bs
    ):
        return None, f"({V.ufl_element()!r}) is not a continuous Lagrange space of degree ≥ 1"
    return element, None


def check_sides(kind: str, *sides):
    """Raise if they are no pairs of a space and facets, or of numbers that PETSc doesn't have.

    Args:
        kind: ``"tie"`` or ``"contact"``.
        sides: What a user gave.

    Raises:
        ValueError: Something else.
    """
    for side in sides:
        if not isinstance(side, Sequence) or len(side) != 2:
            raise ValueError(f"each side of a {kind} is a pair: a function space and facets.")
        if not isinstance(side[0], fem.FunctionSpace):
            raise ValueError(
                f"a {kind}'s side is (function space, facets), not ({type(side[0]).__name__}, …)."
            )
        dtype = side[0].mesh.geometry.x.dtype
        if dtype != PETSc.RealType:
            raise ValueError(
                f"the mesh of a {kind}'s side has coordinates of {dtype.name}, and PETSc's real "
                f"numbers here are {np.dtype(PETSc.RealType).name}; make it with "
                "dtype=dolfinx.default_real_type."
            )


def as_facets(given: npt.ArrayLike) -> npt.NDArray:
    """An array of what a user gave for facets; of two dimensions if it is a list of lists."""
    try:
        facets = np.asarray(given)
    except ValueError:  # of several lengths
        return np.empty((1, 1))
    if facets.size == 0:  # an empty list is an array of floats
        facets = np.empty(0, dtype=np.int32)
    return facets


def create_surface(V: fem.FunctionSpace, facets: npt.ArrayLike, name: str) -> Surface:
    """Gather the trace of a Lagrange space on facets of its mesh. Collective.

    Args:
        V: Lagrange space of degree k ≥ 1, scalar or blocked.
        facets: Exterior facets (indices local to this rank); a facet that several ranks know may
            be given on any of them.
        name: Name of the surface for messages.

    Returns:
        The surface, the same on every rank.

    Raises:
        InterfaceError: Not a Lagrange space; no, interior, duplicate or out-of-range facets; NaN
            coordinates.
    """
    mesh = V.mesh
    comm, n, fdim = mesh.comm, mesh.geometry.dim, mesh.topology.dim - 1
    element, reason = lagrange_element(V)
    raise_on_all(comm, reason and f"the space of {name} {reason}.")
    if mesh.topology.dim != n or n not in (2, 3):
        raise InterfaceError(
            f"{name} lies on a {mesh.topology.dim}-dimensional mesh in {n} dimensions; "
            "bodies must be 2D in the plane or 3D in space."
        )
    topology = mesh.topology
    raise_on_all(comm, _cell_error(topology, name))
    topology.create_entities(fdim)
    topology.create_connectivity(fdim, fdim + 1)
    topology.create_connectivity(fdim + 1, fdim)
    facets = as_facets(facets)
    raise_on_all(comm, _facet_error(mesh, facets, name))
    facets = facets.astype(np.int32)
    if comm.allreduce(len(facets)) == 0:
        raise InterfaceError(
            f"{name} has no facets on any rank; does the tag exist (ft.find(tag), ft.values)?"
        )

    # Local facet number of each facet in its one cell
    offsets = topology.connectivity(fdim, fdim + 1).offsets
    cells = topology.connectivity(fdim, fdim + 1).array[offsets[facets]]
    cell_type = getattr(basix.CellType, topology.cell_name())
    num_facets = len(basix.topology(cell_type)[fdim])
    cell_facets = topology.connectivity(fdim + 1, fdim).array.reshape(-1, num_facets)
    local = np.argmax(cell_facets[cells] == facets[:, None], axis=1)

    # Order the vertices of each facet such that its normal points out of the cell
    facet_type = basix.cell.subentity_types(cell_type)[fdim][0]
    P = basix.ElementFamily.P
    cell_geometry = compat.geometry_element(mesh, cell_type)
    geometry = compat.geometry_element(mesh, facet_type)
    trace = basix.create_element(P, facet_type, element.degree, element.lagrange_variant)
    cell_nodes = compat.geometry_dofmap(mesh)[cells]
    x = mesh.geometry.x[:, :n]
    finite = np.isfinite(x[cell_nodes]).all()
    raise_on_all(comm, None if finite else f"{name} has NaN or infinite coordinates.")
    tables = _facet_tables(cell_type, cell_geometry, geometry)[local]  # (facet, turn, node)
    nodes = np.take_along_axis(cell_nodes[:, None, :], tables, axis=2)
    vertex_nodes = [dofs[0] for dofs in geometry.entity_dofs[0]]
    # Mean of the vertices: in a thin cell, nodes of curved edges may lie beyond the facet's plane
    corners = [dofs[0] for dofs in cell_geometry.entity_dofs[0]]
    centre = x[cell_nodes[:, corners]].mean(axis=1)
    v = x[nodes[:, 0][:, vertex_nodes]]
    turn = (np.einsum("fi,fi->f", unit_normals(v), v.mean(axis=1) - centre) < 0).astype(np.intp)
    each = np.arange(len(facets))
    nodes = nodes[each, turn]
    tables = _facet_tables(cell_type, element, trace)[local, turn]
    dofs = np.take_along_axis(V.dofmap.list[cells], tables, axis=1)

    # Gather: vertices are identified by their global nodes, and facets by their vertices
    own = np.flatnonzero(np.bincount(nodes.ravel(), minlength=1)).astype(np.int32)
    nodes = np.searchsorted(own, nodes).astype(np.int32)
    before = sum(comm.allgather(len(own))[: comm.rank])
    of_own = mesh.geometry.index_map().local_to_global(own)
    found, first, number = np.unique(gathered(comm, of_own), return_index=True, return_inverse=True)
    nodes = number.astype(np.int32)[gathered(comm, nodes + np.int32(before))]
    nodes_x = gathered(comm, x[own])[first]
    index_map, cell_map = V.dofmap.index_map, topology.index_map(fdim + 1)
    dofs = gathered(comm, index_map.local_to_global(dofs.ravel()).reshape(dofs.shape))
    ranges = np.append(0, np.cumsum(comm.allgather(cell_map.size_local)))
    owner = np.searchsorted(ranges, cell_map.local_to_global(cells), side="right") - 1
    owner = gathered(comm, owner.astype(np.int32))

    # Number by position: node numbers depend on the number of ranks, coordinates don't
    vertices = np.flatnonzero(np.bincount(nodes[:, vertex_nodes].ravel(), minlength=len(found)))
    order = vertices[np.lexsort(nodes_x[vertices].T[::-1])]
    rank_of = np.empty(len(found), dtype=np.int32)
    rank_of[order] = np.arange(len(order), dtype=np.int32)
    vertices = rank_of[nodes[:, vertex_nodes]]
    code = row_codes(np.sort(vertices, axis=1))
    facet_order = np.argsort(code, kind="stable")
    once = np.diff(code[facet_order], prepend=-1) > 0  # several ranks may have been given one
    facet_order = facet_order[once]
    return Surface(
        name=name,
        x=nodes_x[order],
        facets=vertices[facet_order],
        own_nodes=None if geometry.degree == 1 else nodes_x[nodes[facet_order]],
        dofs=dofs[facet_order],
        owner=owner[facet_order],
        geometry=geometry,
        element=trace,
        dof_range=np.append(0, np.cumsum(comm.allgather(index_map.size_local))),
    )


def thinness(V: fem.FunctionSpace, facets: npt.ArrayLike) -> float:
    """Median ratio of the height of cells behind facets of V's mesh to the facets' length.

    Collective; :func:`create_surface` has been called for V.
    """
    mesh, n = V.mesh, V.mesh.geometry.dim
    facets = np.asarray(facets, dtype=np.int32)
    to_cells = mesh.topology.connectivity(n - 1, n)
    cells = to_cells.array[to_cells.offsets[facets]]
    x = mesh.geometry.x[:, :n]
    v = x[compat.entities_to_geometry(mesh, n - 1, facets)[:, : 2 ** (n - 1)]]
    height = np.einsum(
        "fmi,fi->fm", x[compat.geometry_dofmap(mesh)[cells]] - v[:, :1], unit_normals(v)
    )
    polygon = v[:, around(np.arange(v.shape[1])[None])[0]]
    length = np.linalg.norm(polygon - np.roll(polygon, 1, axis=1), axis=2).max(axis=1, initial=0)
    ratios = np.abs(height).max(axis=1, initial=0) / np.where(length > 0, length, 1)
    return float(np.median(gathered(mesh.comm, ratios)))


def gap_of_chords(surface0: Surface, surface1: Surface) -> float:
    """Mean gap between straight facets around one round surface, by the turns of both sides.

    0 if one side is flat, or both are curved.
    """
    gap = 0.0
    for surface in (surface0, surface1):
        if surface.curved.any():
            continue
        off = _off_chords(surface)
        if np.abs(off).max() <= FILE_DIGITS * surface.size.max():
            return 0.0
        gap += np.average(off, weights=surface.size ** (surface.gdim - 1))
    return abs(float(gap))


def _off_chords(surface: Surface) -> npt.NDArray[np.float64]:
    """Mean distance of each straight facet from a smooth surface through its vertices.

    By the normals there, of which an edge of length h leans from its own by a and b: h/8 (a + b) is
    a circle's sag. A surface that doesn't turn at both ends, or turns by a corner, is a polygon.

    Returns:
        Positive where the surface is convex, ``(num_facets,)``.
    """
    facets, x = surface.polygons, surface.x
    normal, share = np.zeros_like(x), surface.normals / surface.size[:, None]
    for column in facets.T:
        np.add.at(normal, column, share)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), NOISE)
    if surface.gdim == 2:
        ends, pairs = surface.at_end, [(0, 1)]  # where normals are unknown
    else:
        ends, pairs = np.zeros(len(x), dtype=bool), [*pairwise([*range(facets.shape[1]), 0])]
    total = np.zeros(len(facets))
    for i, j in pairs:
        t = x[facets[:, j]] - x[facets[:, i]]
        h = np.linalg.norm(t, axis=1)
        a = -np.einsum("fi,fi->f", normal[facets[:, i]], t) / h
        b = np.einsum("fi,fi->f", normal[facets[:, j]], t) / h
        a, b = np.where(ends[facets[:, i]], b, a), np.where(ends[facets[:, j]], a, b)
        least = np.where(np.abs(a) < np.abs(b), a, b)
        turns = (a * b > 0) & (np.maximum(np.abs(a), np.abs(b)) < np.sin(CORNER_ASSEMBLY / 2))
        total += np.where(turns, h / 4 * least, 0)
    return total * (2 / 3 if surface.gdim == 2 else 1 / 3)


def _cell_error(topology, name: str) -> str | None:
    """Message if a mesh's cells are of an unsupported type, or None."""
    cells = topology.cell_name()
    if cells in ("triangle", "quadrilateral", "tetrahedron", "hexahedron"):
        return None
    return f"{name} lies on {cells} cells; bodies in space are made of tetrahedra or hexahedra."


def _facet_error(mesh, facets: npt.NDArray, name: str) -> str | None:
    """Message if this rank's facets are invalid, or None."""
    fdim = mesh.topology.dim - 1
    if facets.ndim != 1 or (len(facets) and not np.issubdtype(facets.dtype, np.integer)):
        return f"the facets of {name} must be a flat array of local facet indices (ft.find(tag))."
    facet_map = mesh.topology.index_map(fdim)
    num_facets = facet_map.size_local + facet_map.num_ghosts
    bad = facets[(facets < 0) | (facets >= num_facets)]
    if len(bad):
        return (
            f"facet {bad[0]} of {name} is out of range (rank {mesh.comm.rank} has {num_facets} "
            "facets); give local facet indices, as ft.find(tag) does."
        )
    unique, count = np.unique(facets, return_counts=True)
    if (count > 1).any():
        return f"facet {unique[count > 1][0]} of {name} is given twice; pass each facet once."
    num_cells = np.diff(mesh.topology.connectivity(fdim, fdim + 1).offsets)[facets]
    interior = (num_cells != 1) | np.isin(facets, mesh.topology.interprocess_facets())
    if interior.any():
        return (
            f"facet {facets[interior][0]} of {name} has a cell on both sides; an interface lies "
            "on the boundary of its body (split the mesh along it)."
        )
    return None


def facet_pairs(surface: Surface) -> npt.NDArray[np.intp]:
    """Pairs of facets that share an edge (2D: a vertex), ``(num_pairs, 2)``."""
    key = surface.edge_numbers
    facet = np.repeat(np.arange(len(key)), key.shape[1])
    key = key.ravel()
    order = np.argsort(key, kind="stable")
    _, start, count = np.unique(key[order], return_index=True, return_counts=True)
    start = start[count == 2]
    return np.column_stack((facet[order[start]], facet[order[start + 1]]))
