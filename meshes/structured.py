# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Structured meshes: a mapped unit square or cube, sectors of a ring, octants of a sphere."""

from collections.abc import Callable, Iterable, Sequence
from itertools import permutations, product

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx

LEFT, RIGHT, BOTTOM, TOP, BACK, FRONT = 1, 2, 3, 4, 5, 6
INNER, OUTER, START, END = 1, 2, 3, 4
PLANE_X, PLANE_Y, PLANE_Z = 11, 12, 13

# Corners of the cells that a unit square or cube is cut into, all of positive orientation
_CELLS = {
    "triangle": [[(0, 0), (1, 0), (1, 1)], [(0, 0), (1, 1), (0, 1)]],
    "crossed": [  # four triangles that meet in the middle
        [(0, 0), (1, 0), (0.5, 0.5)],
        [(1, 0), (1, 1), (0.5, 0.5)],
        [(1, 1), (0, 1), (0.5, 0.5)],
        [(0, 1), (0, 0), (0.5, 0.5)],
    ],
    "quadrilateral": [[(0, 0), (1, 0), (0, 1), (1, 1)]],
    "hexahedron": [[corner[::-1] for corner in product((0, 1), repeat=3)]],
    "tetrahedron": [  # from one end of the diagonal to the other, an axis at a time (Kuhn)
        [(0, 0, 0), *np.cumsum(np.eye(3, dtype=int)[list(axes)], axis=0).tolist()]
        for axes in permutations(range(3))
    ],
}


def coordinate_element(cell: str, degree: int, dim: int):
    """Element of geometry with equispaced nodes, as Gmsh has them."""
    return basix.ufl.element(
        "Lagrange", cell, degree, lagrange_variant=basix.LagrangeVariant.equispaced, shape=(dim,)
    )


def block(
    comm: MPI.Comm,
    n: Sequence[int],
    mapping: Callable[[npt.NDArray], npt.NDArray] | None = None,
    *,
    cell: str = "quadrilateral",
    degree: int = 1,
    crossed: bool = False,
    periodic: bool = False,
    partitioner: Callable | None = None,
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]:
    """A unit square or cube of equal cells, mapped.

    Args:
        comm: Communicator.
        n: Number of cells along each axis, ``(2,)`` or ``(3,)``.
        mapping: Takes node coordinates in the unit square or cube, ``(num_nodes, dim)``, to the
            nodes' places; the identity if not given. Applied to all nodes, so cells of degree 2
            and more are curved.
        cell: ``"triangle"``, ``"quadrilateral"``, ``"tetrahedron"`` or ``"hexahedron"``.
        degree: Degree of the geometry.
        crossed: Whether each square is cut into four triangles instead of two.
        periodic: Whether the end of the second axis is its start, as in a ring.
        partitioner: As in ``dolfinx.mesh.create_mesh``.

    Returns:
        The mesh and its facet tags: LEFT and RIGHT where the first coordinate of the unit square
        or cube is 0 and 1, BOTTOM and TOP for the second, BACK and FRONT for the third.
    """
    dim = len(n)
    element = coordinate_element(cell, degree, dim)
    points = element.basix_element.points
    linear = basix.create_element(basix.ElementFamily.P, getattr(basix.CellType, cell), 1)
    weights = linear.tabulate(0, points)[0, :, :, 0]
    steps = 2 * degree if crossed else degree  # of the lattice of nodes, in a cell
    shape = steps * np.asarray(n) + 1
    if comm.rank == 0:
        corners = np.array(_CELLS["crossed" if crossed else cell])
        if cell == "tetrahedron":
            odd = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
            corners[odd] = corners[odd][:, [0, 2, 1, 3]]
        inside = np.rint(steps * (weights @ corners)).astype(np.int64)  # (cell, node, dim)
        origins = np.indices(n).reshape(dim, -1).T * steps
        lattice = origins[:, None, None] + inside
        if periodic:
            lattice[..., 1] %= shape[1] - 1
        cells = np.ravel_multi_index(np.moveaxis(lattice, -1, 0), shape).reshape(-1, len(points))
        x = np.indices(shape).reshape(dim, -1).T / (shape - 1)
        used, cells = np.unique(cells, return_inverse=True)
        x, cells = x[used], cells.reshape(-1, len(points))
    else:
        x, cells = np.empty((0, dim)), np.empty((0, len(points)), dtype=np.int64)
    mesh = dolfinx.mesh.create_mesh(comm, cells, e=element, x=x, partitioner=partitioner)

    facet_tags = tag_faces(mesh, [axis for axis in range(dim) if not (periodic and axis == 1)])
    if mapping is not None:
        mesh.geometry.x[:, :dim] = mapping(mesh.geometry.x[:, :dim].copy())
    return mesh, facet_tags


def tag_faces(mesh: dolfinx.mesh.Mesh, axes: Iterable[int]) -> dolfinx.mesh.MeshTags:
    """Tags of a unit square's or cube's faces.

    Args:
        mesh: The mesh.
        axes: Axes whose faces get tags: 2 axis + 1 where the coordinate is 0, + 2 where it is 1.
    """
    dim, facets, tags = mesh.topology.dim - 1, [], []
    for axis, end in product(axes, (0, 1)):
        found = dolfinx.mesh.locate_entities_boundary(mesh, dim, lambda x: np.isclose(x[axis], end))
        facets.append(found)
        tags.append(np.full(len(found), 2 * axis + end + 1, dtype=np.int32))
    order = np.argsort(np.concatenate(facets))
    return dolfinx.mesh.meshtags(
        mesh, dim, np.concatenate(facets)[order], np.concatenate(tags)[order]
    )


def ring_sector(
    comm: MPI.Comm,
    n_hoop: int,
    n_radial: int,
    r_inner: float,
    r_outer: float,
    *,
    angle: float = np.pi / 2,
    cell: str = "quadrilateral",
    degree: int = 1,
    crossed: bool = False,
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]:
    """A sector of a ring around the origin, from the x axis on; closed if ``angle`` is 2π.

    Args:
        comm: Communicator.
        n_hoop: Number of cells around.
        n_radial: Number of cells across.
        r_inner: Inner radius.
        r_outer: Outer radius.
        angle: Angle of the sector.
        cell: ``"triangle"`` or ``"quadrilateral"``.
        degree: Degree of the geometry.
        crossed: Whether each square is cut into four triangles instead of two.

    Returns:
        The mesh and its facet tags INNER, OUTER and, of an open ring, START and END.
    """

    def polar(x):
        r = r_inner + (r_outer - r_inner) * x[:, 0]
        theta = angle * x[:, 1]
        return np.column_stack((r * np.cos(theta), r * np.sin(theta)))

    closed = np.isclose(angle, 2 * np.pi)
    n = (n_radial, n_hoop)
    options = {"cell": cell, "degree": degree, "crossed": crossed}
    return block(comm, n, polar, **options, periodic=closed)


def spherical_layers(
    comm: MPI.Comm, n: int, radii: Sequence[float], *, degree: int = 1
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]:
    """An eighth of a hollow sphere around the origin, x, y, z ≥ 0, in layers of hexahedra.

    Three faces of a cube, n × n squares each, are thrown onto the spheres.

    Args:
        comm: Communicator.
        n: Number of cells along the edges of the cube's faces.
        radii: Where layers begin and end, from the inside to the outside.
        degree: Degree of the geometry; all nodes lie on spheres.

    Returns:
        The mesh and its facet tags INNER, OUTER, PLANE_X, PLANE_Y and PLANE_Z.
    """
    element = coordinate_element("hexahedron", degree, 3)
    inside = np.rint(degree * element.basix_element.points).astype(np.int64)
    x, cells = np.empty((0, 3)), np.empty((0, len(inside)), dtype=np.int64)
    if comm.rank == 0:
        origins = degree * np.indices((n, n, len(radii) - 1)).reshape(3, -1).T
        along = origins[:, None] + inside  # two steps on a face of the cube, one outwards
        across = np.full(along.shape[:2], degree * n)
        faces = [np.dstack((across, along[..., 0], along[..., 1]))]  # (cell, node, axis)
        faces += [np.roll(faces[0], axis, axis=2) for axis in (1, 2)]
        lattice = np.vstack([np.dstack((face, along[..., 2])) for face in faces])
        nodes, cells = np.unique(lattice.reshape(-1, 4), axis=0, return_inverse=True)
        cells = cells.reshape(-1, len(inside))
        direction = np.tan(np.pi / 4 * nodes[:, :3] / (degree * n))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        r = np.interp(nodes[:, 3] / degree, np.arange(len(radii)), radii)
        x = r[:, None] * direction
    mesh = dolfinx.mesh.create_mesh(comm, cells, e=element, x=x)
    markers = [
        (INNER, lambda x: np.isclose(np.linalg.norm(x, axis=0), radii[0])),
        (OUTER, lambda x: np.isclose(np.linalg.norm(x, axis=0), radii[-1])),
        *[
            (tag, lambda x, axis=axis: np.abs(x[axis]) < 1e-8 * radii[-1])
            for axis, tag in enumerate((PLANE_X, PLANE_Y, PLANE_Z))
        ],
    ]
    found = [dolfinx.mesh.locate_entities_boundary(mesh, 2, marker) for _, marker in markers]
    tags = np.repeat([tag for tag, _ in markers], [len(facets) for facets in found])
    facets = np.concatenate(found)
    order = np.argsort(facets)
    return mesh, dolfinx.mesh.meshtags(mesh, 2, facets[order], tags[order].astype(np.int32))
