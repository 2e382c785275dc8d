# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The gap domain Σ as a distributed DOLFINx mesh with the field α."""

import math
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix
import basix.ufl
import dolfinx
from dolfinx import fem
from dolfinx.mesh import Mesh
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.core.collective import raise_on_all
from hypergap_dolfinx.errors import InvertedCellError
from hypergap_dolfinx.gap_mesh.cells import Hosts, Overhang, geometry_element
from hypergap_dolfinx.gap_mesh.slab import mesh_slab
from hypergap_dolfinx.gap_mesh.strip import mesh_strip
from hypergap_dolfinx.mortar import kernel
from hypergap_dolfinx.mortar.tolerances import NARROW_CELL, NOUGHT
from hypergap_dolfinx.surface.quadrilaterals import middle_rows
from hypergap_dolfinx.surface.tolerances import LAST_DIGITS, SAME_NODE, STRAIGHT
from hypergap_dolfinx.surface.trace import Surface, tabulate


@dataclass(frozen=True)
class GapDomain:
    """Σ: simplices with nodes (x, α), and where its nodes lie on the bodies' surfaces.

    The rows of the arrays are the cells of this rank, in the order of ``mesh``.
    """

    surfaces: tuple[Surface, Surface]
    """Γ0 and Γ1."""
    mesh: Mesh
    """n-dimensional mesh with coordinates x; its cells have no volume where Γ0 and Γ1 coincide."""
    alpha: fem.Function
    """α, linear on each cell."""
    space: fem.FunctionSpace
    """The scalar Lagrange space of the φ_a."""
    x: npt.NDArray[np.float64]
    """Geometry nodes, ``(num_cells, num_geometry_nodes, n)``."""
    alpha_vertices: npt.NDArray[np.float64]
    """α at the vertices, ``(num_cells, n + 1)``."""
    normal: npt.NDArray[np.float64]
    """Reference normals from Γ0 to Γ1, ``(num_cells, n)``."""
    curved: npt.NDArray[np.bool_]
    """Which cells have a curved edge, ``(num_cells,)``."""
    hosts: Hosts
    """Hosts of the nodes of ``space``."""
    patch: npt.NDArray[np.int32]
    """Smooth piece that each facet of Γ1 belongs to, ``(num_facets1,)``."""
    covered: npt.NDArray[np.float64]
    """Part of each facet of Γ1 that Γ0 covers, ``(num_facets1,)``."""
    least: npt.NDArray[np.float64]
    """Least share of a function's square that this part has, ``(num_facets1,)``; see
    :mod:`~hypergap_dolfinx.gap_mesh.cells`."""
    overhang: Overhang | None = None
    """What is beyond what both sides have in common, to be taken out of integrals; None if nothing.
    See :mod:`~hypergap_dolfinx.gap_mesh.overhang`."""

    @property
    def geometry(self) -> basix.finite_element.FiniteElement:
        """Basix element of the cells' geometry."""
        return self.mesh.ufl_domain().ufl_coordinate_element().basix_element  # type: ignore[union-attr]

    @property
    def element(self) -> basix.finite_element.FiniteElement:
        """Basix element of the φ_a."""
        return self.space.ufl_element().basix_element

    def distance(self) -> float:
        """Mean distance of Γ0 and Γ1: the volume between them over their area. Collective."""
        n = self.x.shape[2]
        vertices = self.x[:, : n + 1]
        volume = np.abs(np.linalg.det(vertices[:, 1:] - vertices[:, :1])).sum()
        element = self.quadrature(1)
        N, _ = kernel.geometry_at_points(element, self.x, self.alpha_vertices)
        area = (element.weights * np.linalg.norm(N, axis=2)).sum()
        total = self.mesh.comm.allreduce(np.array((volume / math.factorial(n), area)))
        return float(total[0] / total[1])

    def quadrature(self, degree: int) -> kernel.GapElement:
        """Tables of the gap element at the points of a Gauss rule."""
        return kernel.GapElement.with_quadrature(self.geometry, self.element, degree)

    def gap_matrices(self) -> npt.NDArray[np.float64]:
        """Element matrices G_ab = ∫∫ ∂φ_a/∂α ∂φ_b/∂α dΓ_α dα. Collective.

        Returns:
            ``(num_cells, num_nodes, num_nodes)``.

        Raises:
            InvertedCellError: A cell is turned over.
        """
        k, nodes = self.element.degree, self.element.dim
        G = np.empty((len(self.x), nodes, nodes))
        straight, curved = ~self.curved, self.curved
        error = None
        try:
            if straight.any():
                vertices = self.x[straight][:, : self.x.shape[2] + 1]
                G[straight] = kernel.affine_gap_matrices(
                    self.quadrature(2 * k - 2),
                    vertices,
                    self.alpha_vertices[straight],
                    self.normal[straight],
                )
            if curved.any():
                G[curved] = kernel.curved_gap_matrices(
                    self.quadrature(self.curved_rule),
                    self.x[curved],
                    self.alpha_vertices[curved],
                    self.normal[curved],
                )
        except InvertedCellError as e:
            error = str(e)
        raise_on_all(self.mesh.comm, error, InvertedCellError)
        return G

    def narrow_cells(self) -> npt.NDArray[np.intp]:
        """Cells whose matrices have large entries that cancel each other, ``(num_narrow,)``."""
        middle = kernel.GapElement.with_quadrature(self.geometry, self.element, 0)
        _, v = kernel.geometry_at_points(middle, self.x, self.alpha_vertices)
        return np.flatnonzero((np.abs(v) > NARROW_CELL).any(axis=(1, 2)))

    @property
    def curved_rule(self) -> int:
        """Degree of the Gauss rule for curved cells."""
        return kernel.curved_rule(self.x.shape[2], self.element.degree, self.geometry.degree)

    def gap_factors(self, cells: npt.NDArray[np.intp]) -> tuple[npt.NDArray, npt.NDArray]:
        """Factors of the element matrices: G_ab = Σ_p w_p D_pa D_pb.

        Args:
            cells: Some of the cells, ``(num,)``.

        Returns:
            D, ``(num, num_points, num_nodes)``, and w_p = ±1 (a Gauss rule's weight may be
            negative), ``(num_points,)``.
        """
        element = self.quadrature(self.curved_rule)
        N, v = kernel.geometry_at_points(element, self.x[cells], self.alpha_vertices[cells])
        size = np.sqrt(np.abs(element.weights) * np.linalg.norm(N, axis=2))
        D = size[..., None] * kernel.alpha_derivatives(element, v)
        return D, np.sign(element.weights)

    def overhang_derivatives(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """∂φ_a/∂α and unit normals at the points of the overhang, whose weights are not in them.

        Returns:
            ``(num_points, num_nodes)`` and ``(num_points, n)``.
        """
        assert self.overhang is not None
        cells, points = self.overhang.cells, self.overhang.X
        dpsi, dphi = (
            np.moveaxis(e.tabulate(1, points)[1:, :, :, 0], 0, 2)
            for e in (self.geometry, self.element)
        )  # (point, node, ξ_j)
        x, alpha = self.x[cells], self.alpha_vertices[cells]
        X = np.einsum("pmi,pmj->pij", x - x[:, :1], dpsi)
        N, v = kernel.normal_and_direction(X, alpha[:, 1:] - alpha[:, :1])
        return np.einsum("paj,pj->pa", dphi, v), N / np.linalg.norm(N, axis=1, keepdims=True)


def create_gap_domain(comm: MPI.Comm, surface0: Surface, surface1: Surface) -> GapDomain:
    """Mesh Σ between two surfaces and distribute it. Collective.

    Raises:
        InterfaceError: The surfaces don't form an interface.
    """
    tdim = surface0.gdim
    gap = mesh_strip(surface0, surface1) if tdim == 2 else mesh_slab(comm, surface0, surface1)

    # Geometry: vertices are enough unless a surface is curved
    surfaces = (surface0, surface1)
    coordinates = geometry_element(surfaces, gap.degree)
    g, points = coordinates.degree, coordinates.basix_element.points
    cells, x = gap.cells, gap.x
    if g > 1:
        cells, first = _number_nodes(gap.cells, _lattice(coordinates.basix_element), g)
        x = gap.geometry_nodes(surfaces, points).reshape(-1, tdim)[first]
    mesh, order = distributed(comm, cells, x, gap.rank, coordinates)

    alpha_vertices = gap.alpha[gap.cells[order]]
    linear = fem.functionspace(mesh, ("Lagrange", 1))
    alpha = fem.Function(linear, name="alpha")
    alpha.x.array[linear.dofmap.list] = alpha_vertices
    space = fem.functionspace(mesh, ("Lagrange", gap.degree)) if gap.degree > 1 else linear
    x_cells = x[cells[order]]
    return GapDomain(
        surfaces=surfaces,
        mesh=mesh,
        alpha=alpha,
        space=space,
        x=x_cells,
        alpha_vertices=alpha_vertices,
        normal=gap.normal[order],
        curved=_curved(x_cells, points, np.abs(x).max()),
        hosts=gap.hosts(space.ufl_element().basix_element.points, order),
        patch=gap.patch,
        covered=gap.covered,
        least=gap.least,
        overhang=gap.overhang and gap.overhang.at(order, len(gap.cells)),
    )


def distributed(
    comm: MPI.Comm, cells, x, rank, element: basix.ufl._ElementBase
) -> tuple[Mesh, npt.NDArray[np.intp]]:
    """A mesh of cells that every rank knows, each on the rank that it is for. Collective.

    Args:
        comm: Communicator.
        cells: Nodes of the cells, ``(num_cells, num_cell_nodes)``.
        x: Nodes, ``(num_nodes, n)``.
        rank: Where each cell is to be, ``(num_cells,)``.
        element: Of the coordinates.

    Returns:
        The mesh, and the numbers of this rank's cells in its order.
    """
    mine = np.flatnonzero(rank == comm.rank)
    nodes = x if comm.rank == 0 else x[:0]

    def stay(comm, num_parts, cell_types, cells):
        return compat.destinations(np.full(len(mine), comm.rank, dtype=np.int32))

    mesh = dolfinx.mesh.create_mesh(comm, cells[mine], e=element, x=nodes, partitioner=stay)
    start = sum(comm.allgather(len(mine))[: comm.rank])
    return mesh, mine[mesh.topology.original_cell_index - start]


def _curved(x, points, magnitude) -> npt.NDArray[np.bool_]:
    """Which cells' geometry nodes leave the vertex simplex, ``(num_cells,)``."""
    n = x.shape[2]
    if x.shape[1] == n + 1:
        return np.zeros(len(x), dtype=bool)
    weights = np.column_stack((1 - points.sum(axis=1), points))
    deviation = np.abs(weights @ x[:, : n + 1] - x).max(axis=(1, 2))
    size = np.ptp(x, axis=1).max(axis=1)
    return deviation > STRAIGHT * size + LAST_DIGITS * magnitude


def _lattice(element: basix.finite_element.FiniteElement) -> npt.NDArray[np.int64]:
    """Nodes of a simplex times the degree, as if they were equispaced, ``(num_nodes, n)``."""
    equispaced = basix.create_element(
        element.family, element.cell_type, element.degree, basix.LagrangeVariant.equispaced
    )
    return np.rint(equispaced.points * element.degree).astype(np.int64)


def _number_nodes(cells, lattice, degree: int):
    """Number the Lagrange nodes of a mesh; a shared node gets one number.

    A node is told by its vertices and their barycentric weights, so no coordinates are compared.

    Args:
        cells: Vertices, ``(num_cells, n + 1)``.
        lattice: Nodes of the reference simplex times the degree, ``(num_nodes, n)``.
        degree: Degree of the nodes.

    Returns:
        Nodes of each cell, ``(num_cells, num_nodes)``, and for each number the first place (in
        the flattened cells) that has it.
    """
    weights = np.column_stack((degree - lattice.sum(axis=1), lattice))  # (node, vertex)
    key = cells[:, None, :] * (degree + 1) + weights
    key = np.sort(np.where(weights > 0, key, -1), axis=2).reshape(-1, cells.shape[1])
    code, size = np.zeros(len(key), dtype=np.int64), int(key.max()) + 2
    for column in key.T:  # into one number: whole rows take much longer to sort
        if int(code.max()) * size >= 2**62:
            code = np.unique(code, return_inverse=True)[1]
        code = code * size + column + 1
    _, first, number = np.unique(code, return_index=True, return_inverse=True)
    return number.reshape(len(cells), -1).astype(np.int64), first


def interpolation_weights(surface: Surface, facet, X, weight, nodes):
    """Rows of a pull-back R_i: values of the trace's basis, times a weight.

    Args:
        surface: Γ_i.
        facet: Host facet of each point, ``(num_points,)``.
        X: Reference coordinates, ``(num_points, n - 1)``.
        weight: 1 − α on Γ0, α on Γ1; ``(num_points,)``.
        nodes: Element of the φ_a, whose nodes on Γ_i the points are where the weight is one.

    Returns:
        The point, the global dof (block) and the value of each nonzero entry.
    """
    values = tabulate(surface.element, X)
    if surface.facets.shape[1] == 4:
        face = basix.create_element(
            nodes.family, basix.CellType.triangle, nodes.degree, nodes.lagrange_variant
        )
        for place, row in zip(*middle_rows(surface.element, face), strict=True):
            values[(weight > 1 - NOUGHT) & (np.abs(X - place).max(axis=1) < SAME_NODE)] = row
    values *= weight[:, None]
    # A node of Σ that is a dof of the body has a single 1 in its row, and round-off beside it
    point, local = np.nonzero(np.abs(values) > NOUGHT)
    return point, surface.dofs[facet[point], local], values[point, local]
