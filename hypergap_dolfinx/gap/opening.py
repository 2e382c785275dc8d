# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Contact's Σ in space, as plain arrays, and the weighted gap on the dofs of both sides."""

from dataclasses import dataclass, replace
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix
from hypergap_dolfinx.gap import weighted
from hypergap_dolfinx.gap.cells import GapCells, Hosts, interpolate_geometry
from hypergap_dolfinx.gap.chart import axis_between, mesh_chart
from hypergap_dolfinx.gap.constraint import coo_matrix, expand
from hypergap_dolfinx.gap.domain import interpolation_weights
from hypergap_dolfinx.gap.kernel import GapElement
from hypergap_dolfinx.gap.moving import COVERED, Displacements, Sides, Sparse, displaced
from hypergap_dolfinx.gap.opened import OpenCells
from hypergap_dolfinx.gap.slab import mesh_slab
from hypergap_dolfinx.gap.surface import Surface, tabulate

ON_VERTEX = 1e-9
"""Distance from a facet's corner, in its reference coordinates, of a node of Σ that is there."""


@dataclass(frozen=True)
class Opening:
    """Σ between two surfaces in space, with weights w_a for each vertex of Γ1.

    The same on every rank.

    Which cells there are, where their nodes are hosted and how they are weighted was found at one
    place of the bodies; where they are now is an argument.
    """

    sides: Sides
    hosts: Hosts
    """Hosts of the cells' geometry nodes."""
    alpha: npt.NDArray[np.float64]
    """α at the vertices, ``(num_cells, n + 1)``."""
    element: basix.finite_element.FiniteElement
    """Of the cells' geometry."""
    table: GapElement
    """Gauss points."""
    points: npt.NDArray[np.float64]
    """Where they are in the reference cell, ``(num_points, n)``."""
    vertices: npt.NDArray[np.intp]
    """Vertices of Γ1 that each of a cell's vertices stands for: those of a facet,
    ``(num_cells, n + 1, num_facet_vertices)``."""
    shares: npt.NDArray[np.float64]
    """By what part, ``(num_cells, n + 1, num_facet_vertices)``."""
    x: npt.NDArray[np.float64]
    """Where the cells' nodes are without displacements, ``(num_cells, num_geometry_nodes, n)``."""
    w: npt.NDArray[np.float64]
    """Weights of the cells' vertices at the points, ``(num_cells, num_points, n + 1)``."""
    rank: npt.NDArray[np.int32]
    """Rank of a body's cell beside each cell, ``(num_cells,)``."""
    axis: npt.NDArray[np.float64] | None = None
    """Along what the surfaces were seen; None if they surround each other."""

    @classmethod
    def between(
        cls, comm: MPI.Comm, sides: Sides, u: Displacements, before: "Opening | None" = None
    ) -> "Opening":
        """Mesh Σ where the bodies are. Collective.

        Args:
            comm: Communicator.
            sides: Γ0 and Γ1.
            u: Their displacements.
            before: What was between them before.

        Raises:
            InterfaceError: They don't face each other.
        """
        surfaces = displaced(sides, u)
        axis = axis_between(surfaces, before.axis if before else None)
        if axis is None:
            gap: GapCells = mesh_slab(comm, *surfaces)
        else:
            gap = mesh_chart(comm, surfaces, axis)
        k = max(gap.degree, *(surface.geometry.degree for surface in surfaces))
        cell = basix.CellType.tetrahedron
        element = basix.create_element(
            basix.ElementFamily.P, cell, k, basix.LagrangeVariant.equispaced
        )
        every = np.arange(len(gap.cells))
        points, weights = basix.make_quadrature(cell, max(min(6 * (k - 1), 6), 3 * (k - 1)))
        vertices, shares = _multipliers(surfaces[1], gap)
        hosts = gap.hosts(element.points, every)
        alpha = gap.alpha[gap.cells]
        table = GapElement.at(element, element, points, weights)
        rest = tuple(side.reference for side in sides)
        x = interpolate_geometry(rest, hosts)
        opening = cls(
            sides, hosts, alpha, element, table, points, vertices, shares, x, x, gap.rank, axis
        )
        w = weighted.vertex_weights(table, opening.positions(u), alpha)
        weighed = replace(opening, w=w)
        weighed.__dict__["_R"] = opening._R  # which doesn't depend on them
        return weighed

    def positions(self, u: Displacements) -> npt.NDArray[np.float64]:
        """Geometry nodes of the cells, ``(num_cells, num_geometry_nodes, n)``."""
        moved = self._R.createVecLeft()
        at_dofs = self._R.createVecRight()
        at_dofs.array[:] = np.concatenate([part.ravel() for part in u])
        self._R.mult(at_dofs, moved)
        x = self.x + moved.array_r.reshape(self.x.shape)
        moved.destroy()
        at_dofs.destroy()
        return x

    @cached_property
    def _R(self) -> PETSc.Mat:
        """Positions of the cells' nodes from those of both surfaces' dofs, all components."""
        entries = []
        offset = 0
        alpha = self.hosts.alpha.ravel()
        for side_number, side in enumerate(self.sides):
            weight = alpha if side_number else 1 - alpha
            use = np.flatnonzero(weight != 0)
            X = self.hosts.X[side_number].reshape(len(alpha), -1)[use]
            facets = self.hosts.facets[side_number].ravel()[use]
            point, dof, value = interpolation_weights(
                side.reference, facets, X, weight[use], self.element
            )
            entries.append((use[point], np.searchsorted(side.dofs, dof) + offset, value))
            offset += len(side.dofs)
        i, j, value = (np.concatenate(part) for part in zip(*entries, strict=True))
        R = coo_matrix(MPI.COMM_SELF, (len(alpha), offset), i, j, value)
        expanded = expand(R, self.sides[0].reference.gdim)
        R.destroy()
        return expanded

    @property
    def num_multipliers(self) -> int:
        """One for each vertex of Γ1, in reach of Γ0 or not."""
        return len(self.sides[1].reference.x)

    def gap(self, u: Displacements) -> tuple[npt.NDArray, npt.NDArray, Sparse]:
        """The weighted gap.

        Args:
            u: Displacements.

        Returns:
            g and m, ``(num_multipliers,)``, and C = ∂g/∂u,
            ``(num_multipliers, n (num_dofs0 + num_dofs1))``.
        """
        cells = weighted.weigh(self.table, self.positions(u), self.alpha, self.w)
        g, m = (self._sum(part) for part in (cells.g, cells.m))
        num_cells, _, num_nodes, n = cells.dg.shape
        # (cell, vertex, share, node, component)
        values = self.shares[..., None, None] * cells.dg[:, :, None]
        rows = np.broadcast_to(self.vertices[..., None, None], values.shape)
        columns = np.arange(num_cells * num_nodes * n).reshape(num_cells, 1, 1, num_nodes, n)
        columns = np.broadcast_to(columns, values.shape)
        use = values != 0
        sizes = self.num_multipliers, num_cells * num_nodes * n
        C = coo_matrix(MPI.COMM_SELF, sizes, rows[use], columns[use], values[use])
        product = C.matMult(self._R)
        C.destroy()
        return g, m, Sparse.of(product)

    def curvature(self, u: Displacements, p: npt.NDArray[np.float64]) -> Sparse:
        """H = Σ_a p_a ∂²g_a/∂u², of the size of u.

        Args:
            u: Displacements.
            p: ``(num_multipliers,)``.
        """
        pressure = np.einsum("cpb,cb->cp", self.w, self._at_cells(p))
        on = np.flatnonzero(pressure.any(axis=1))
        x = self.positions(u)[on]
        h = weighted.second_derivatives(self.table, x, pressure[on])
        size = x.shape[1] * x.shape[2]
        h = h.reshape(-1, size, size)
        at = on[:, None] * size + np.arange(size)
        rows = np.broadcast_to(at[:, :, None], h.shape)
        columns = np.broadcast_to(at[:, None, :], h.shape)
        num = len(self.alpha) * size
        H = coo_matrix(MPI.COMM_SELF, (num, num), rows, columns, h)
        product = H.ptap(self._R)
        H.destroy()
        return Sparse.of(product)

    def smoothed(self, u: Displacements, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Pressures for people, (SᵀDSp) / (SᵀD1): S the cells' weights, D their areas.

        They have the force of p, and less of its scatter from node to node.

        Args:
            u: Displacements.
            p: ``(num_multipliers,)``.
        """
        S = self._means
        _, area = self._volume_and_area(u)
        mean = np.einsum("cb,cb->c", S, self._at_cells(p)) * area
        total, size = self._sum(S * mean[:, None]), self._sum(S * area[:, None])
        return np.divide(total, size, out=np.zeros_like(total), where=size > 0)

    def cells(self, u: Displacements, p: npt.NDArray[np.float64]) -> OpenCells:
        """The cells where the bodies are, to look at.

        Args:
            u: Displacements.
            p: ``(num_multipliers,)``.
        """
        volume, area = self._volume_and_area(u)
        return OpenCells(
            x=self.positions(u)[:, : self.alpha.shape[1]],
            rank=self.rank,
            gap=np.divide(volume, area, out=np.zeros_like(area), where=area > 0),
            pressure=np.einsum("cb,cb->c", self._means, self._at_cells(p)),
        )

    @property
    def _means(self) -> npt.NDArray[np.float64]:
        """Mean weights of the cells' vertices, ``(num_cells, n + 1)``."""
        return np.einsum("p,cpb->cb", self.table.weights, self.w) / self.table.weights.sum()

    def _volume_and_area(self, u: Displacements):
        """Of each cell, ``(num_cells,)`` each."""
        ones = np.ones((*self.w.shape[:2], 1))
        cells = weighted.weigh(self.table, self.positions(u), self.alpha, ones)
        return cells.g[:, 0], cells.m[:, 0]

    def _at_cells(self, p) -> npt.NDArray[np.float64]:
        """Values at the cells' vertices, ``(num_cells, n + 1)``."""
        return (self.shares * p[self.vertices]).sum(axis=2)

    def _sum(self, values) -> npt.NDArray[np.float64]:
        """Sums over the cells of values at their vertices, ``(num_multipliers,)``."""
        values = self.shares * values[..., None]
        return np.bincount(self.vertices.ravel(), values.ravel(), self.num_multipliers)


def _multipliers(
    surface: Surface, gap: GapCells
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
    """The vertices of Γ1 that the cells' vertices stand for, and their shares.

    A vertex of Γ1 of which no facet is covered by more than :data:`COVERED` has no multiplier: what
    it would have goes to the nearest vertex that has one.
    """
    n = surface.gdim
    corners = np.vstack((np.zeros(n), np.eye(n)))
    hosts = gap.hosts(corners, np.arange(len(gap.cells)))
    corners_of = basix.create_element(basix.ElementFamily.P, surface.geometry.cell_type, 1)
    shares = tabulate(corners_of, hosts.X[1].reshape(-1, n - 1))
    shares = shares.reshape(*hosts.alpha.shape, -1)  # (cell, vertex, facet vertex)
    shares[(np.abs(shares) < ON_VERTEX) | (hosts.alpha < ON_VERTEX)[..., None]] = 0
    vertices = surface.facets[hosts.facets[1]].astype(np.intp)
    has = np.zeros(len(surface.x), dtype=bool)
    has[surface.facets[gap.covered > COVERED]] = True
    stand_in = np.arange(len(surface.x))
    for v in np.setdiff1d(vertices[shares != 0], np.flatnonzero(has)).tolist():
        facets = (surface.facets == v).any(axis=1)
        near = np.setdiff1d(surface.facets[facets][has[surface.facets[facets]]], v)
        if not len(near):
            near = np.flatnonzero(has)
        if not len(near):  # nothing but a part of one facet
            near, has[v] = np.array([v]), True
        stand_in[v] = near[np.linalg.norm(surface.x[near] - surface.x[v], axis=1).argmin()]
    return stand_in[vertices], shares
