# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The faces of Σ's cells on Γ0 or on Γ1: what is tied of a body's surface, and a mesh of it."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

import basix
import basix.ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.mortar.domain import GapDomain, distributed
from hypergap_dolfinx.mortar.tolerances import ON_SURFACE
from hypergap_dolfinx.surface.tolerances import SAME_NODE
from hypergap_dolfinx.surface.trace import normals_by_area, tabulate


@dataclass(frozen=True)
class Faces:
    """Faces of this rank's cells of Σ on one side, each with a normal out of the body.

    Pieces of Σ that meet at a kink share no vertex, so their faces don't either.
    """

    domain: GapDomain
    """Σ."""
    side: int
    """0 on Γ0, 1 on Γ1."""
    cells: npt.NDArray[np.intp]
    """The cell of each, ``(num_faces,)``."""
    vertices: npt.NDArray[np.intp]
    """Its vertices among the cell's, ``(num_faces, n)``."""

    @classmethod
    def of(cls, domain: GapDomain, side: int) -> "Faces":
        """Those of Σ on a side."""
        n = domain.x.shape[2]
        on = np.abs(domain.alpha_vertices - side) < ON_SURFACE
        cells = np.flatnonzero(on.sum(axis=1) == n)
        vertices = np.argsort(~on[cells], axis=1, kind="stable")[:, :n]
        x = np.take_along_axis(domain.x[cells], vertices[:, :, None], axis=1)
        out = np.einsum("fi,fi->f", normals_by_area(x), domain.normal[cells]) * (1 - 2 * side)
        # UFL's CellNormal is on the left of an edge, ours on the right
        turned = (out > 0) if n == 2 else (out < 0)
        vertices[turned, :2] = vertices[turned, 1::-1]
        return cls(domain, side, cells, vertices)

    @property
    def cell_type(self) -> basix.CellType:
        """Interval or triangle."""
        return {2: basix.CellType.interval, 3: basix.CellType.triangle}[self.vertices.shape[1]]

    def _alike(self, X) -> Iterator[tuple[npt.NDArray, npt.NDArray, npt.NDArray]]:
        """Faces that are at the same place in their cells, and points on them.

        Args:
            X: Reference points of a face, ``(num_points, n - 1)``.

        Returns:
            Of each lot the faces, the points in the reference cell ``(num_points, n)`` and the
            face's edges there, ``(n - 1, n)``.
        """
        corners = basix.geometry(self.domain.element.cell_type)
        for vertices in np.unique(self.vertices, axis=0):
            v = corners[vertices]
            edges = v[1:] - v[0]
            yield np.flatnonzero((self.vertices == vertices).all(axis=1)), v[0] + X @ edges, edges

    def mass_matrices(self) -> npt.NDArray[np.float64]:
        """∫ φ_a φ_b over each face, ``(num_faces, num_nodes, num_nodes)``, of the cell's nodes."""
        element, geometry = self.domain.element, self.domain.geometry
        rule = 2 * (element.degree + geometry.degree - 1)
        X, weights = basix.make_quadrature(self.cell_type, rule)
        M = np.empty((len(self.cells), element.dim, element.dim))
        for some, points, edges in self._alike(X):
            phi = tabulate(element, points)
            dpsi = geometry.tabulate(1, points)[1:, :, :, 0]
            x = self.domain.x[self.cells[some]]
            t = np.einsum("jpm,cmi,kj->cpki", dpsi, x - x[:, :1], edges, optimize=True)
            measure = np.sqrt(np.linalg.det(np.einsum("cpki,cpli->cpkl", t, t)))
            M[some] = np.einsum("cp,pa,pb->cab", measure * weights, phi, phi, optimize=True)
        return M

    @cached_property
    def _mesh(self) -> tuple[Mesh, npt.NDArray[np.intp]]:
        """Their mesh, and this rank's faces in its order. Collective."""
        mesh, geometry = self.domain.mesh, self.domain.geometry
        comm, variant = mesh.comm, geometry.lagrange_variant
        element = basix.ufl.element(
            "Lagrange",
            self.cell_type.name,
            geometry.degree,
            lagrange_variant=variant,
            shape=(mesh.geometry.dim,),
        )
        local = np.empty((len(self.cells), element.basix_element.dim), dtype=np.intp)
        for some, points, _ in self._alike(element.basix_element.points):
            distance = np.linalg.norm(points[:, None] - geometry.points, axis=2)
            assert (distance.min(axis=1) < SAME_NODE).all()
            local[some] = distance.argmin(axis=1)
        each = self.cells[:, None]
        nodes = compat.geometry_dofmap(mesh)[each, local]
        nodes = mesh.geometry.index_map().local_to_global(nodes.ravel()).reshape(nodes.shape)
        gathered = comm.allgather((nodes, self.domain.x[each, local]))
        nodes, x = (np.concatenate(parts) for parts in zip(*gathered, strict=True))
        _, first, number = np.unique(nodes, return_index=True, return_inverse=True)
        sizes = [len(part) for part, _ in gathered]
        rank = np.repeat(np.arange(comm.size), sizes)
        made, order = distributed(
            comm, number.reshape(nodes.shape), x.reshape(-1, x.shape[2])[first], rank, element
        )
        return made, order - sum(sizes[: comm.rank])

    def function(self, nodal: npt.NDArray, shape: tuple[int, ...], name: str) -> fem.Function:
        """A function on the mesh of the faces. Collective.

        Args:
            nodal: Values at the nodes of the cells of Σ, ``(num_cells, num_nodes, block_size)``.
            shape: Of the values.
            name: Its name.

        Returns:
            Lagrange, of the degree of the φ_a.
        """
        mesh, order = self._mesh
        element = basix.ufl.element(
            "Lagrange", self.cell_type.name, self.domain.element.degree, shape=shape or None
        )
        f = fem.Function(fem.functionspace(mesh, element), name=name)
        V = f.function_space
        points = V.ufl_element().basix_element.points
        values = np.empty((len(self.cells), len(points), nodal.shape[2]), dtype=nodal.dtype)
        for some, at, _ in self._alike(points):
            values[some] = tabulate(self.domain.element, at) @ nodal[self.cells[some]]
        f.x.array.reshape(-1, nodal.shape[2])[V.dofmap.list] = values[order]
        f.x.scatter_forward()
        return f
