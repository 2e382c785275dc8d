# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cavities that a front leaves: each becomes a cone to one node between the surfaces."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.compiled import call, doubles, ints
from hypergap_dolfinx.core.graph import components
from hypergap_dolfinx.gap_mesh.tetrahedra import FACES, areas, single_faces
from hypergap_dolfinx.gap_mesh.tolerances import (
    FLAT_GAP_CELL,
    INSET,
    LARGE_CAVITY,
    SEES,
)

Place = Callable[[npt.NDArray[np.float64], float, npt.NDArray[np.intp]], tuple]
"""``place(x, alpha, vertices)``: coordinates, α and normal of a node near x that is hosted on both
sides, and its hosts; vertices are those around it."""


@dataclass
class Cells:
    """Cells between two surfaces, with α and normals at their vertices."""

    x: npt.NDArray[np.float64]
    """Vertex coordinates, ``(num_vertices, 3)``."""
    alpha: npt.NDArray[np.float64]
    """α at the vertices."""
    normals: npt.NDArray[np.float64]
    """Unit normals at the vertices, from Γ0 to Γ1."""
    cells: npt.NDArray[np.integer]
    """``(num_cells, 4)``."""

    def flat(self, limit: float = FLAT_GAP_CELL) -> npt.NDArray[np.bool_]:
        """Mask of flat or inverted cells: D over its scale up to a limit, ``(num_cells,)``."""
        D, scale = areas(self.x, self.alpha, self.normals, self.cells)
        return ~(D > limit * scale)


def is_whole(cells, outer) -> bool:
    """True if each face has a cell on each side, or one cell and a triangle of the boundary."""
    return single_faces(cells, outer)[1] == 0


def fill(mesh: Cells, outer, place: Place):
    """Fill cavities with cones.

    Args:
        mesh: The cells around them.
        outer: The boundary's triangles, counterclockwise seen from inside.
        place: Puts a node between the surfaces.

    Returns:
        The mesh, with nodes added behind the others, and their hosts; None if a cavity remains.
    """
    faces, _ = single_faces(mesh.cells, outer)
    if not len(faces):
        return mesh, []
    behind = _Behind(mesh.cells, len(mesh.x))
    nodes: list[tuple] = []
    cones = []
    for cavity in _parts(faces):
        found = _cone(mesh, cavity, behind, place)
        if found is None:
            return None
        cavity, node = found
        number = len(mesh.x) + len(nodes)
        cones.append(np.column_stack((cavity, np.full(len(cavity), number))))
        nodes.append(node)
    x, alpha, normals, hosts = zip(*nodes, strict=True)
    return Cells(
        np.vstack((mesh.x, *x)),
        np.append(mesh.alpha, alpha),
        np.vstack((mesh.normals, *normals)),
        np.vstack((mesh.cells[behind.left], *cones)),
    ), list(hosts)


def _parts(faces) -> list[npt.NDArray[np.integer]]:
    """Cavities: groups of faces connected by edges."""
    edge = np.sort(np.stack((faces, np.roll(faces, -1, axis=1)), axis=2).reshape(-1, 2), axis=1)
    _, which = np.unique(edge, axis=0, return_inverse=True)
    order = np.argsort(which, kind="stable")
    same = which[order[1:]] == which[order[:-1]]
    f, g = order[:-1][same] // 3, order[1:][same] // 3
    part = components(len(faces), f, g)
    order = np.argsort(part, kind="stable")
    return np.split(faces[order], np.flatnonzero(np.diff(part[order])) + 1)


class _Behind:
    """Map from faces of a cavity to the cells behind them; cells can be removed."""

    def __init__(self, cells, num_vertices: int):
        self.cells = cells
        self.left = np.ones(len(cells), dtype=bool)
        self._offset = np.zeros(num_vertices + 2, dtype=np.int32)
        self._at = np.empty(cells.size, dtype=np.int32)
        call("cells_at_vertices", num_vertices, len(cells), ints(cells), self._offset, self._at)

    def of(self, faces) -> npt.NDArray[np.intp]:
        """Remaining cells that have the faces, −1 where there is none."""
        found = np.full(len(faces), -1)
        for i, (a, b, c) in enumerate(faces.tolist()):
            near = self._at[self._offset[a] : self._offset[a + 1]]
            near = near[self.left[near]]
            corners = self.cells[near]
            near = near[(corners == b).any(axis=1) & (corners == c).any(axis=1)]
            if len(near):
                found[i] = near[-1]
        return found


def _without(faces, cells) -> npt.NDArray[np.integer]:
    """The faces around a cavity after some cells behind them are removed."""
    kept = {tuple(sorted(face)): tuple(face) for face in faces.tolist()}
    for face in cells[:, FACES].reshape(-1, 3).tolist():
        key = tuple(sorted(face))
        if key in kept:
            del kept[key]
        else:
            kept[key] = tuple(face[::-1])
    return np.array(list(kept.values()), dtype=np.intp).reshape(-1, 3)


def _cone(mesh: Cells, faces, behind: _Behind, place: Place):
    """Grow a cavity until there is a point from which all of its faces are seen.

    Returns:
        Its faces, and the node: place, α, normal and hosts; None if there is none.
    """
    while 0 < len(faces) <= LARGE_CAVITY:  # each time a cell is removed
        x, alpha, slack = _sees_best(mesh, faces)
        if slack.min() > SEES:
            node = place(x, alpha, np.unique(faces))
            D, scale = _seen(mesh, faces, node[0][None], np.array([node[1]]), node[2])
            D, scale = D[:, 0], scale[:, 0]
            if (D > 1e-6 * scale).all():
                return faces, node
            slack = D / scale
        in_the_way = slack <= slack.min() + 1e-6
        gone = behind.of(faces[in_the_way])
        if not (gone >= 0).any():  # facets of the surfaces: make room beside them
            ends = np.isin(faces, faces[in_the_way]).sum(axis=1)
            for shared in (2, 1, 0):
                gone = behind.of(faces[ends >= shared])
                if (gone >= 0).any():
                    break
        gone = np.unique(gone[gone >= 0])
        if not len(gone):
            return None
        behind.left[gone] = False
        faces = _without(faces, behind.cells[gone])
    return None


def _seen(mesh: Cells, faces, x, alpha, normal):
    """D of the cells between faces and points, and their scale, ``(num_faces, num_points)``."""
    shape = len(faces), len(x)

    def with_points(values, at):
        values = np.repeat(values, len(x), axis=0)
        own = np.tile(at, (len(faces), *(1,) * (at.ndim - 1)))
        return np.concatenate((values, own[:, None]), axis=1)

    normals = np.repeat(mesh.normals[faces].sum(axis=1) + normal, len(x), axis=0)
    found = areas(with_points(mesh.x[faces], x), with_points(mesh.alpha[faces], alpha), normals)
    return tuple(values.reshape(shape) for values in found)


def _sees_best(mesh: Cells, faces):
    """The point farthest inside of all faces, in the plane of the mean normal and in α.

    Returns:
        Its place, its α, and its distance inside of each face.
    """
    v = mesh.x[faces]
    centre = v.mean(axis=(0, 1))
    h = np.linalg.norm(v - np.roll(v, 1, axis=1), axis=2).mean()
    normal = mesh.normals[faces].mean(axis=(0, 1))
    normal /= max(np.linalg.norm(normal), 1e-300)
    tangents = np.linalg.svd(normal[None])[2][1:]
    # D is affine in the point: its values at four points give it
    points = np.array([(0, 0, 0.5), (1, 0, 0.5), (0, 1, 0.5), (0, 0, 1.5)])
    D = _seen(mesh, faces, centre + h * points[:, :2] @ tangents, points[:, 2], normal)[0]
    gradient = D[:, 1:] - D[:, :1]
    offset = D[:, 0] - gradient[:, 2] / 2
    length = np.maximum(np.linalg.norm(gradient, axis=1), 1e-12 * h**2)
    gradient, offset = gradient / length[:, None], offset / length
    # Maximise r: gradient · z + offset ≥ r, and r away from both surfaces
    A = np.column_stack((-gradient, np.ones(len(faces))))
    A = np.vstack((A, (0, 0, -1, 1), (0, 0, 1, 1)))
    b = np.concatenate((offset, (-INSET, 1 - INSET)))
    z = linear_program(A, b, np.array((0.0, 0.0, 0.0, 1.0)), 100.0)
    slack = gradient @ z[:3] + offset
    return centre + h * z[:2] @ tangents, float(np.clip(z[2], INSET, 1 - INSET)), slack


def linear_program(A, b, c, bound: float) -> npt.NDArray[np.float64]:
    """Maximise c · z where A z ≤ b and |z_i| ≤ bound; four unknowns at most."""
    order = np.random.default_rng(0).permutation(len(b))  # any order, but the same on every rank
    z = np.empty(len(c))
    given = doubles(A[order]), doubles(b[order]), doubles(c), bound
    status = call("linear_program", len(c), len(b), *given, z)
    assert status == 0
    return z
