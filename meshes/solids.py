# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Unstructured tetrahedra, with Gmsh: blocks, spherical shells and balls, bodies with holes."""

from collections.abc import Callable, Sequence
from itertools import pairwise, product

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx
from dolfinx import fem, la
from hypergap_dolfinx.core import compat
from meshes.session import gmsh_session
from meshes.structured import (
    BACK,
    BOTTOM,
    FRONT,
    INNER,
    LEFT,
    OUTER,
    PLANE_X,
    PLANE_Y,
    PLANE_Z,
    RIGHT,
    TOP,
    coordinate_element,
)

HOLE, SIDE = 14, 15

Markers = Sequence[tuple[int, Callable[[npt.NDArray], npt.NDArray]]]


def _tetrahedra(comm: MPI.Comm, h, build: Callable, kernel: str = "occ") -> dolfinx.mesh.Mesh:
    """Mesh what ``build`` adds to Gmsh's CAD kernel.

    Args:
        comm: Communicator.
        h: Cell size, one or one for each volume; or a function of x, y and z.
        build: Takes the kernel.
        kernel: Gmsh's name of it.
    """
    x, cells = np.empty((0, 3)), np.empty((0, 4), dtype=np.int64)
    if comm.rank == 0:
        with gmsh_session() as gmsh:
            if callable(h):
                gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
                gmsh.option.setNumber("Mesh.Algorithm", 6)
                if "Netgen" in gmsh.option.getString("General.BuildOptions"):  # not in Debian's
                    gmsh.option.setNumber("Mesh.OptimizeNetgen", 1)
                gmsh.model.mesh.setSizeCallback(lambda dim, tag, x, y, z, size: h(x, y, z))
            else:
                gmsh.option.setNumber("Mesh.MeshSizeMin", np.min(h))
                gmsh.option.setNumber("Mesh.MeshSizeMax", np.max(h))
            cad = getattr(gmsh.model, kernel)
            build(cad)
            cad.synchronize()
            if np.ndim(h) and not callable(h):
                _set_sizes(gmsh.model, h)
            gmsh.model.mesh.generate(3)
            tags, x, _ = gmsh.model.mesh.getNodes()
            _, cells = gmsh.model.mesh.getElementsByType(4)
        order = np.argsort(tags)
        cells = np.searchsorted(tags[order], cells)
        used, cells = np.unique(cells, return_inverse=True)  # without the centres of arcs
        x, cells = x.reshape(-1, 3)[order][used], cells.reshape(-1, 4).astype(np.int64)
    element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    return dolfinx.mesh.create_mesh(comm, cells, e=element, x=x)


def _set_sizes(model, sizes: Sequence[float]):
    """Cell sizes of concentric volumes, from the innermost on; between them the geometric mean."""
    tags = sorted(
        (tag for _, tag in model.getEntities(3)), key=lambda t: model.getBoundingBox(3, t)[3]
    )
    size_of = dict(zip(tags, sizes, strict=True))
    volumes = {(3, tag): {tag} for tag in tags}
    for dim in (2, 1):
        for _, tag in model.getEntities(dim):
            above = model.getAdjacencies(dim, tag)[0]
            volumes[dim, tag] = set().union(*(volumes[dim + 1, up] for up in above))
    fields = []
    for (dim, tag), around in volumes.items():
        fields.append(model.mesh.field.add("Constant"))
        lists = {1: "CurvesList", 2: "SurfacesList", 3: "VolumesList"}
        model.mesh.field.setNumbers(fields[-1], lists[dim], [tag])
        model.mesh.field.setNumber(fields[-1], "IncludeBoundary", 0)
        size = np.exp(np.mean(np.log([size_of[volume] for volume in around])))
        model.mesh.field.setNumber(fields[-1], "VIn", size)
        model.mesh.field.setNumber(fields[-1], "VOut", 1e22)
    smallest = model.mesh.field.add("Min")
    model.mesh.field.setNumbers(smallest, "FieldsList", fields)
    model.mesh.field.setAsBackgroundMesh(smallest)


def _tag(mesh: dolfinx.mesh.Mesh, markers: Markers) -> dolfinx.mesh.MeshTags:
    """Tags of boundary facets whose vertices all satisfy a marker; the first one counts."""
    facets, tags = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.int32)
    for tag, marker in markers:
        found = dolfinx.mesh.locate_entities_boundary(mesh, 2, marker)
        found = np.setdiff1d(found, facets)
        facets = np.concatenate((facets, found))
        tags = np.concatenate((tags, np.full(len(found), tag, dtype=np.int32)))
    order = np.argsort(facets)
    return dolfinx.mesh.meshtags(mesh, 2, facets[order], tags[order])


def refined(mesh: dolfinx.mesh.Mesh) -> dolfinx.mesh.Mesh:
    """Each tetrahedron cut into eight."""
    mesh.topology.create_entities(1)
    return dolfinx.mesh.refine(mesh)[0]


def of_degree(mesh: dolfinx.mesh.Mesh, degree: int) -> dolfinx.mesh.Mesh:
    """A straight mesh with geometry nodes of a higher degree."""
    if degree == 1:
        return mesh
    element = coordinate_element(mesh.topology.cell_name(), degree, 3)
    V = fem.functionspace(mesh, element)
    index_map = V.dofmap.index_map
    nodes = V.dofmap.list[: mesh.topology.index_map(3).size_local]
    cells = index_map.local_to_global(nodes.ravel()).reshape(nodes.shape)
    x = V.tabulate_dof_coordinates()[: index_map.size_local]
    return dolfinx.mesh.create_mesh(mesh.comm, cells, e=element, x=x)


def solid_block(
    comm: MPI.Comm,
    h: float | Callable[[float, float, float], float],
    mapping: Callable[[npt.NDArray], npt.NDArray] | None = None,
    *,
    halves: bool = False,
    degree: int = 1,
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]:
    """A unit cube of unstructured tetrahedra, mapped.

    Args:
        comm: Communicator.
        h: Cell size in the unit cube, or a function of x, y and z.
        mapping: Takes node coordinates in the unit cube, ``(num_nodes, 3)``, to the nodes'
            places; the identity if not given. Applied to all nodes, as in :func:`meshes.block`.
        halves: Whether cell faces lie on the plane y = 1/2, so that a mapping may have a kink.
        degree: Degree of the geometry.

    Returns:
        The mesh and its facet tags, as of :func:`meshes.block`.
    """

    def build(cad):
        if halves:
            lower, upper = cad.addBox(0, 0, 0, 1, 0.5, 1), cad.addBox(0, 0.5, 0, 1, 0.5, 1)
            cad.fragment([(3, lower)], [(3, upper)])
        else:
            cad.addBox(0, 0, 0, 1, 1, 1)

    mesh = of_degree(_tetrahedra(comm, h, build), degree)
    tags = ((LEFT, RIGHT), (BOTTOM, TOP), (BACK, FRONT))
    markers = [
        (tag, lambda x, axis=axis, end=end: np.isclose(x[axis], end))
        for axis, pair in enumerate(tags)
        for end, tag in enumerate(pair)
    ]
    ft = _tag(mesh, markers)
    if mapping is not None:
        mesh.geometry.x[:] = mapping(mesh.geometry.x.copy())
    return mesh, ft


def spherical_shell(
    comm: MPI.Comm,
    h: float,
    r_inner: float,
    r_outer: float,
    *,
    octant: bool = True,
    degree: int = 1,
    refinements: int = 0,
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]:
    """A spherical shell around the origin, or the part of it in x, y, z ≥ 0.

    Args:
        comm: Communicator.
        h: Cell size.
        r_inner: Inner radius; 0 for a ball.
        r_outer: Outer radius.
        octant: Whether it is an eighth.
        degree: Degree of the geometry; nodes of curved faces lie on the spheres.
        refinements: How often each tetrahedron is then cut into eight.

    Returns:
        The mesh and its facet tags INNER, OUTER and, of an octant, PLANE_X, PLANE_Y and PLANE_Z.
    """
    if octant:
        mesh = _tetrahedra(comm, h, lambda cad: _add_octants(cad, (r_inner, r_outer)))
    else:
        mesh = _tetrahedra(comm, h, lambda cad: _add_sphere(cad, r_inner, r_outer), "geo")
    for _ in range(refinements):
        mesh, _ = _on_spheres(refined(mesh), r_inner, r_outer, octant)
    return _on_spheres(of_degree(mesh, degree), r_inner, r_outer, octant)


def nested_shells(
    comm: MPI.Comm, sizes: Sequence[float], radii: Sequence[float], *, degree: int = 1
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]:
    """Octants of concentric shells in one mesh: what a tie of shells is compared with.

    Args:
        comm: Communicator.
        sizes: Cell size in each shell, from the innermost on.
        radii: Inner radius of each shell, and the outer one of the last.
        degree: Degree of the geometry; nodes of the innermost and the outermost sphere lie on
            them, and so do those of the spheres between.

    Returns:
        The mesh and its facet tags, as of :func:`spherical_shell`.
    """
    mesh = _tetrahedra(comm, sizes, lambda cad: _add_octants(cad, radii))
    mesh = of_degree(mesh, degree)
    for r in radii[1:-1]:
        _snap(mesh, _facets_on(mesh, r, 1e-6 * r), r)
    return _on_spheres(mesh, radii[0], radii[-1], True)


def _facets_on(mesh: dolfinx.mesh.Mesh, r: float, tolerance: float) -> npt.NDArray[np.int32]:
    """Facets whose vertices lie on a sphere."""
    return dolfinx.mesh.locate_entities(
        mesh, 2, lambda x: np.abs(np.linalg.norm(x, axis=0) - r) < tolerance
    )


def _snap(mesh: dolfinx.mesh.Mesh, facets: npt.NDArray[np.int32], r: float):
    """Move all nodes on facets to a sphere."""
    on = _nodes_on(mesh, facets)
    mesh.geometry.x[on] *= r / np.linalg.norm(mesh.geometry.x[on], axis=1, keepdims=True)


def _on_spheres(mesh: dolfinx.mesh.Mesh, r_inner: float, r_outer: float, octant: bool):
    """Move the nodes of both curved boundaries to their spheres, and tag the boundary."""
    middle = (r_inner + r_outer) / 2
    markers: list = []
    if octant:
        markers += [
            (tag, lambda x, axis=axis: np.abs(x[axis]) < 1e-8 * r_outer)
            for axis, tag in enumerate((PLANE_X, PLANE_Y, PLANE_Z))
        ]
    markers.append((OUTER, lambda x: np.linalg.norm(x, axis=0) > middle))
    if r_inner > 0:
        markers.append((INNER, lambda x: np.linalg.norm(x, axis=0) < middle))
    ft = _tag(mesh, markers)
    for tag, r in ((INNER, r_inner), (OUTER, r_outer)):
        _snap(mesh, ft.find(tag), r)
    return mesh, ft


def _add_octants(cad, radii: Sequence[float]):
    """Eighths of concentric shells that share their spheres."""
    angles = {"angle1": 0, "angle2": np.pi / 2, "angle3": np.pi / 2}
    shells = []
    for r_inner, r_outer in pairwise(radii):
        outer = cad.addSphere(0, 0, 0, r_outer, **angles)
        if r_inner > 0:
            cad.cut([(3, outer)], [(3, cad.addSphere(0, 0, 0, r_inner, **angles))])
        shells.append((3, outer))
    if len(shells) > 1:
        cad.fragment(shells[:1], shells[1:])


def _add_sphere(cad, r_inner: float, r_outer: float):
    """A shell or a ball with spheres of eight patches: one patch has poles, with bad cells."""
    centre = cad.addPoint(0, 0, 0)
    loops = []
    for r in (r_outer, r_inner)[: 1 if r_inner == 0 else 2]:
        ends = [[cad.addPoint(*(sign * r * e)) for sign in (1, -1)] for e in np.eye(3)]
        arcs = {
            (p, q): cad.addCircleArc(p, centre, q)
            for i in range(3)
            for p, q in product(ends[i], ends[(i + 1) % 3])
        }
        patches = [
            cad.addSurfaceFilling(
                [cad.addCurveLoop([arcs[p, q], arcs[q, s], arcs[s, p]])], sphereCenterTag=centre
            )
            for p, q, s in product(*ends)
        ]
        loops.append(cad.addSurfaceLoop(patches))
    cad.addVolume(loops)


def _nodes_on(mesh: dolfinx.mesh.Mesh, facets) -> npt.NDArray[np.intp]:
    """Geometry nodes (of any rank's cells) that lie on facets."""
    topology = mesh.topology
    topology.create_connectivity(2, 3)
    topology.create_connectivity(3, 2)
    to_cells = topology.connectivity(2, 3)
    cells = to_cells.array[to_cells.offsets[facets]]
    local = np.argmax(
        topology.connectivity(3, 2).array.reshape(-1, 4)[cells] == facets[:, None], axis=1
    )
    closure = np.array(
        mesh.ufl_domain().ufl_coordinate_element().basix_element.entity_closure_dofs[2]
    )
    nodes = compat.geometry_dofmap(mesh)[cells[:, None], closure[local]]
    marker = la.vector(mesh.geometry.index_map())
    marker.array[:] = 0
    marker.array[nodes] = 1
    marker.scatter_reverse(la.InsertMode.add)
    marker.scatter_forward()
    return np.flatnonzero(marker.array)


def hollow_cube(
    comm: MPI.Comm, h: float, hole: float = 0.5
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]:
    """A unit cube around the origin with a cube-shaped hole in the middle.

    Args:
        comm: Communicator.
        h: Cell size.
        hole: Edge length of the hole.

    Returns:
        The mesh and its facet tags INNER and OUTER.
    """

    def build(cad):
        outer = cad.addBox(-0.5, -0.5, -0.5, 1, 1, 1)
        cad.cut([(3, outer)], [(3, cad.addBox(*[-hole / 2] * 3, *[hole] * 3))])

    mesh = _tetrahedra(comm, h, build)
    inside = (hole / 2 + 0.5) / 2
    return mesh, _tag(
        mesh,
        (
            (INNER, lambda x: np.abs(x).max(axis=0) < inside),
            (OUTER, lambda x: np.abs(x).max(axis=0) > inside),
        ),
    )


def perforated_plate(
    comm: MPI.Comm,
    h: float,
    z: tuple[float, float],
    radius: float = 0.25,
    *,
    square: bool = False,
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]:
    """A square plate of unit size around the z axis, with a hole.

    Args:
        comm: Communicator.
        h: Cell size.
        z: Where it begins and ends.
        radius: Radius of the hole, or half the length of its sides.
        square: Whether the hole is square, not round.

    Returns:
        The mesh and its facet tags BACK and FRONT (where z begins and ends), HOLE and SIDE.
    """

    def build(cad):
        plate = cad.addBox(-0.5, -0.5, z[0], 1, 1, z[1] - z[0])
        if square:
            hole = cad.addBox(-radius, -radius, z[0], 2 * radius, 2 * radius, z[1] - z[0])
        else:
            hole = cad.addCylinder(0, 0, z[0], 0, 0, z[1] - z[0], radius)
        cad.cut([(3, plate)], [(3, hole)])

    mesh = _tetrahedra(comm, h, build)
    return mesh, _tag(
        mesh,
        (
            (BACK, lambda x: np.isclose(x[2], z[0])),
            (FRONT, lambda x: np.isclose(x[2], z[1])),
            (HOLE, lambda x: np.abs(x[:2]).max(axis=0) < 1.1 * radius),
            (SIDE, lambda x: np.abs(x[:2]).max(axis=0) > 0.49),
        ),
    )
