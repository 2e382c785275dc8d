# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The bodies' meshes as arrays, for other codes."""

from dataclasses import dataclass, field

import hertz
import numpy as np
import numpy.typing as npt

from hypergap_dolfinx import compat


@dataclass
class Copy:
    """A body's mesh."""

    x: npt.NDArray[np.float64]
    """Places of vertices, ``(num_vertices, dim)``."""
    cells: npt.NDArray[np.int32]
    """Vertices of quadrilaterals, one after the other, or tetrahedra."""
    facets: dict[str, npt.NDArray[np.int32]]
    """Vertices of facets: where it is held (``"x"``, ``"y"``, ``"z"``), pressed (``"load"``) and
    where it may touch (``"touch"``). The body is on the left of an edge, and behind a triangle."""
    edges: npt.NDArray[np.int32]
    """Vertices of edges, none if all are straight, ``(num_edges, 2)``."""
    middles: npt.NDArray[np.float64]
    """Places of their middles, ``(num_edges, dim)``."""
    centres: npt.NDArray[np.float64]
    """Places of the quadrilaterals' middle nodes, none if edges are straight."""
    size: float = field(init=False)
    """Of the facets that may touch: the shortest edge."""

    def __post_init__(self):
        """Measure the facets."""
        corners = self.x[self.facets["touch"]]
        self.size = float(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).min())


def copies(bodies) -> list[Copy]:
    """Copy the meshes.

    Args:
        bodies: What ``hertz.pair`` gives.
    """
    return [_copied(i == 1, *body) for i, body in enumerate(bodies)]


def _copied(upper, mesh, ft, touching) -> Copy:
    dim, place = mesh.geometry.dim, mesh.geometry.x[:, : mesh.geometry.dim]
    for d in (1, dim - 1):
        mesh.topology.create_connectivity(d, dim)

    def nodes(d, entities=None):
        if entities is None:
            entities = np.arange(mesh.topology.index_map(d).size_local)
        return compat.entities_to_geometry(mesh, d, np.asarray(entities, dtype=np.int32))

    at = nodes(0).ravel()
    vertex = np.full(len(place), -1, dtype=np.int32)
    vertex[at] = np.arange(len(at))
    cells = nodes(dim)
    corners = vertex[cells[:, [0, 1, 3, 2] if dim == 2 else [0, 1, 2, 3]]]
    held = {"x": 1, "y": 3} if dim == 3 else {"x": 1}
    if not upper:
        held["yz"[dim - 2]] = 2 * dim - 1
    found = {axis: ft.find(tag) for axis, tag in held.items()} | {"touch": touching}
    if upper:
        found["load"] = ft.find(2 * dim)
    cell_of = mesh.topology.connectivity(dim - 1, dim)
    facets = {}
    for name, those in found.items():
        inside = corners[[cell_of.links(f)[0] for f in those]]
        facets[name] = _outward(place[at], inside, vertex[nodes(dim - 1, those)[:, :dim]])
    edges = nodes(1) if mesh.geometry.cmaps[0].degree == 2 else np.zeros((0, 3), dtype=np.int32)
    quadratic = dim == 2 and len(edges) > 0
    return Copy(
        place[at],
        corners,
        facets,
        vertex[edges[:, :2]],
        place[edges[:, 2]],
        place[cells[:, 8]] if quadratic else np.zeros((0, dim)),
    )


def _outward(x, cells, facets):
    """Facets of cells, turned."""
    edges = x[facets[:, 1:]] - x[facets[:, :1]]
    inward = x[cells].mean(axis=1) - x[facets].mean(axis=1)
    left = np.linalg.det(np.concatenate((edges, inward[:, None]), axis=1)) > 0
    turn = left if x.shape[1] == 3 else ~left
    facets = facets.copy()
    facets[turn] = facets[turn][:, ::-1]
    return facets


def row(method, dim, degree, at, p, dx, **others):
    """What a code found, beside Hertz's solution.

    Args:
        method: Its name.
        dim: Number of dimensions.
        degree: Of displacements.
        at: Distances from the middle at the points of a rule on the block's surface.
        p: Its pressures there.
        dx: The points' weights.
        others: More of the row.
    """
    return {
        "scene": "contact",
        "dim": dim,
        "degree": degree,
        "method": method,
        "l2_pressure": float(hertz.l2_error(at, p, dx, dim)),
        "p0": float(abs(p.max() / hertz.p0[dim] - 1)),
        "force": float(abs(2 ** (dim - 1) * (p * dx).sum() / hertz.P[dim] - 1)),
        **others,
    }
