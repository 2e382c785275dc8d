# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Random bodies that can touch: round ones, ones with corners, slender ones; front upwards."""

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import dolfinx
from meshes.session import gmsh_session
from meshes.structured import block, coordinate_element

# Gmsh's nodes of a triangle and of a tetrahedron, by degree, in DOLFINx's order
_NODES = {
    ("triangle", 1): [0, 1, 2],
    ("triangle", 2): [0, 1, 2, 4, 5, 3],
    ("tetrahedron", 1): [0, 1, 2, 3],
    ("tetrahedron", 2): [0, 1, 2, 3, 8, 9, 5, 7, 6, 4],
}


@dataclass
class Body:
    """A body before it is meshed, around the origin, with its front upwards."""

    kind: str
    volume: float
    """Area in the plane."""
    thickness: float
    """Least one: of a beam or a plate across."""
    curved: bool
    cells: tuple[str, ...]
    """Kinds of cells that it can be meshed with."""
    build: Callable | None = None
    """Adds the body to Gmsh's CAD kernel."""
    place: Callable | None = None
    """Places of points of the unit square or cube, for a structured mesh."""
    lengths: tuple[float, ...] = ()
    """Lengths along the axes of the unit square or cube."""
    ends: tuple[tuple[int, int], ...] = ()
    """Faces of the unit square or cube (axis, end) by which it is held; else at its back."""

    def mesh(
        self, comm: MPI.Comm, h: float, cell: str, degree: int
    ) -> tuple[dolfinx.mesh.Mesh, np.ndarray]:
        """A mesh with cells of size h.

        Args:
            comm: Communicator.
            h: Cell size.
            cell: One of :attr:`cells`.
            degree: Degree of the geometry.

        Returns:
            The mesh, and its facets at :attr:`ends`.
        """
        if self.build is not None:
            mesh = _mesh(comm, cell, degree, *_gmsh(self.build, h, cell, degree))
            return mesh, np.empty(0, dtype=np.int32)
        # Along a slender body cells are up to three times as long as it is thick
        least = np.minimum(h, np.maximum(self.thickness, np.array(self.lengths) / 60))
        slender = np.array(self.lengths) > 3 * self.thickness
        size = np.where(slender, np.clip(h, least, 3 * self.thickness), h)
        n = [max(1, round(length / s)) for length, s in zip(self.lengths, size, strict=True)]
        mesh, tags = block(comm, n, self.place, cell=cell, degree=degree)
        held = [tags.find(2 * axis + end + 1) for axis, end in self.ends]
        return mesh, np.concatenate([*held, np.empty(0, dtype=np.int32)])


# ## In the plane


def _polygon(corners) -> Callable:
    def build(cad):
        points = [cad.addPoint(x, y, 0) for x, y in corners]
        ends = zip(points, points[1:] + points[:1], strict=True)
        cad.addPlaneSurface([cad.addCurveLoop([cad.addLine(*pair) for pair in ends])])

    return build


def _area(corners) -> float:
    x, y = np.transpose(corners)
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)


def _with_corners(kind: str, corners) -> Body:
    """A polygon around its middle."""
    corners = np.asarray(corners, dtype=float)
    corners = corners - (corners.max(axis=0) + corners.min(axis=0)) / 2
    size = float(np.ptp(corners, axis=0).min())
    return Body(kind, _area(corners), size, False, ("triangle",), _polygon(corners.tolist()))


def ellipse(rng, w: float) -> Body:
    """An ellipse of width w."""
    a, b = w / 2, w / 2 * rng.uniform(0.4, 1)

    def build(cad):
        cad.addDisk(0, 0, 0, a, b)

    return Body("ellipse", np.pi * a * b, 2 * b, True, ("triangle",), build)


def rounded_box(rng, w: float) -> Body:
    """A rectangle with round corners."""
    height = w * rng.uniform(0.4, 1)
    radius = height * rng.uniform(0.1, 0.45)

    def build(cad):
        cad.addRectangle(-w / 2, -height / 2, 0, w, height, roundedRadius=radius)

    return Body("rounded box", w * height, height, True, ("triangle",), build)


def polygon(rng, w: float) -> Body:
    """A polygon with five to eight corners, most of them convex."""
    n = rng.integers(5, 9)
    angle = 2 * np.pi * (np.arange(n) + rng.uniform(-0.3, 0.3, n)) / n
    r = w / 2 * rng.uniform(0.75, 1, n)
    flat = rng.uniform(0.6, 1)
    return _with_corners("polygon", np.column_stack((r * np.cos(angle), flat * r * np.sin(angle))))


def wedge(rng, w: float) -> Body:
    """A block with a ridge of 50° to 140°."""
    tip, half = rng.uniform(-0.2, 0.2), np.radians(rng.uniform(25, 70))
    corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0), (tip, 0.5 / np.tan(half)), (-0.5, 0)]
    return _with_corners("wedge", w * np.array(corners))


def bracket(rng, w: float) -> Body:
    """A body with inner corners: an L, a channel, or a groove."""
    a, c, b = rng.uniform(0.25, 0.5), rng.uniform(0.6, 0.9), rng.uniform(0.18, 0.28)
    s = rng.choice((0.0, rng.uniform(0, 0.2)))
    corners = {
        "L": [(0, 0), (1, 0), (1, a), (b + s, a), (b, c), (0, c)],
        "U": [(0, 0), (1, 0), (1, c), (1 - b, c), (1 - b - s, a), (b + s, a), (b, c), (0, c)],
        "V": [(0, 0), (1, 0), (1, c), (rng.uniform(0.35, 0.65), a), (0, c)],
    }[str(rng.choice(("L", "U", "V")))]
    return _with_corners("bracket", w * np.array(corners))


def tapered(rng, w: float) -> Body:
    """A quadrilateral, of structured cells."""
    corners = np.array([(-0.5, -0.3), (0.5, -0.3), (-0.5, 0.3), (0.5, 0.3)])
    corners = w * (corners + rng.uniform(-0.12, 0.12, corners.shape))

    def place(x):
        s, t = x[:, :1], x[:, 1:2]
        low = (1 - s) * corners[0] + s * corners[1]
        return (1 - t) * low + t * ((1 - s) * corners[2] + s * corners[3])

    height = 0.6 * w
    cells = ("triangle", "quadrilateral")
    area = _area(corners[[0, 1, 3, 2]])
    return Body("tapered", area, height, False, cells, place=place, lengths=(w, height))


def arch(rng, w: float) -> Body:
    """Half a ring, held at its feet."""
    outer = w / 2
    t = outer * rng.uniform(0.12, 0.4)

    def place(x):
        angle, r = np.pi * (1 - x[:, 0]), outer - t * (1 - x[:, 1])
        return np.column_stack((r * np.cos(angle), r * np.sin(angle) - outer / 2))

    return Body(
        "arch",
        np.pi * t * (outer - t / 2),
        t,
        True,
        ("triangle", "quadrilateral"),
        place=place,
        lengths=(np.pi * outer, t),
        ends=((0, 0), (0, 1)),
    )


def beam(rng, w: float) -> Body:
    """A beam 5 to 60 times as long as thick, held at one end or at both, perhaps bent a little."""
    length = 1.5 * w
    t = length / np.exp(rng.uniform(np.log(5), np.log(60)))
    rise = rng.choice((0.0, rng.uniform(-0.1, 0.1))) * length

    def place(x):
        s = x[:, 0] - 0.5
        return np.column_stack((length * s, t * (x[:, 1] - 0.5) + rise * (1 - 4 * s**2)))

    return Body(
        "beam",
        length * t,
        t,
        rise != 0,
        ("triangle", "quadrilateral"),
        place=place,
        lengths=(length, t),
        ends=((0, 0), (0, 1)) if rng.random() < 0.6 else ((0, int(rng.integers(2))),),
    )


PLANE = (ellipse, rounded_box, polygon, wedge, bracket, tapered, arch, beam)


# ## In space


def ellipsoid(rng, w: float) -> Body:
    """An ellipsoid of tetrahedra."""
    a = w / 2 * np.array((1, rng.uniform(0.6, 1), rng.uniform(0.5, 1)))

    def build(cad):
        ball = cad.addSphere(0, 0, 0, 1)
        cad.dilate([(3, ball)], 0, 0, 0, *a)

    volume = 4 / 3 * np.pi * float(np.prod(a))
    return Body("ellipsoid", volume, 2 * float(a.min()), True, ("tetrahedron",), build)


def rounded_block(rng, w: float) -> Body:
    """A block of which edges and corners are round: what is between a cube and a ball."""
    a = w * np.array((1, rng.uniform(0.6, 1), rng.uniform(0.5, 0.9)))
    power = rng.uniform(4, 10)

    def place(x):
        x = 2 * x - 1
        largest, length = np.abs(x).max(axis=1), (np.abs(x) ** power).sum(axis=1) ** (1 / power)
        scale = np.divide(largest, length, out=np.ones(len(x)), where=length > 0)
        return a / 2 * x * scale[:, None]

    cells = ("tetrahedron", "hexahedron")
    volume = float(np.prod(a))
    return Body("rounded block", volume, float(a.min()), True, cells, place=place, lengths=tuple(a))


def plate(rng, w: float, waves: float = 0.0) -> Body:
    """A plate 4 to 12 times as wide as thick, held at its back, or at two ends."""
    a = 1.4 * w * np.array((1, rng.uniform(0.6, 1), 0))
    a[2] = a[0] / rng.uniform(4, 12)
    shift, ways = rng.uniform(0, 1, 2), rng.uniform(0.5, 1.2, 2)

    def place(x):
        moved = (x - 0.5) * a
        moved[:, 2] += waves * a[0] * np.sin(2 * np.pi * (ways * x[:, :2] + shift)).prod(axis=1)
        return moved

    return Body(
        "wavy plate" if waves else "plate",
        float(np.prod(a)),
        float(a[2]),
        waves != 0,
        ("tetrahedron", "hexahedron"),
        place=place,
        lengths=tuple(a),
        ends=((0, 0), (0, 1)) if rng.random() < 0.5 else ((2, 0),),
    )


def wavy_plate(rng, w: float) -> Body:
    """A plate with waves in both directions."""
    return plate(rng, w, rng.uniform(0.02, 0.05))


SPACE = (ellipsoid, rounded_block, plate, wavy_plate)


# ## Meshes


def _gmsh(build: Callable, h: float, cell: str, degree: int):
    """Nodes and cells of what is added to Gmsh's CAD kernel."""
    dim = 2 if cell == "triangle" else 3
    with gmsh_session() as gmsh:
        gmsh.option.setNumber("Mesh.MeshSizeMin", h)
        gmsh.option.setNumber("Mesh.MeshSizeMax", h)
        gmsh.option.setNumber("Mesh.ElementOrder", degree)
        # Else curved cells may be folded; in space Gmsh's optimiser may abort the process instead
        gmsh.option.setNumber("Mesh.HighOrderOptimize", int(dim == 2))
        build(gmsh.model.occ)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(dim)
        tags, x, _ = gmsh.model.mesh.getNodes()
        kind = gmsh.model.mesh.getElementType(cell.capitalize(), degree)
        _, cells = gmsh.model.mesh.getElementsByType(kind)
    order, nodes = np.argsort(tags), _NODES[cell, degree]
    cells = np.searchsorted(tags, cells, sorter=order).reshape(-1, len(nodes))[:, nodes]
    return x.reshape(-1, 3)[order][:, :dim], cells


def _mesh(comm: MPI.Comm, cell: str, degree: int, x, cells) -> dolfinx.mesh.Mesh:
    """A mesh of what each rank has made for itself; rank 0 hands it out."""
    used, cells = np.unique(cells, return_inverse=True)
    x, cells = x[used], cells.reshape(-1, len(_NODES[cell, degree])).astype(np.int64)
    part = slice(None if comm.rank == 0 else 0)
    element = coordinate_element(cell, degree, x.shape[1])
    return dolfinx.mesh.create_mesh(comm, cells[part], e=element, x=x[part])
