# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The gap domain Σ as a distributed DOLFINx mesh with the field α, and warnings about it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial

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
from hypergap_dolfinx.core.graph import lots, row_codes
from hypergap_dolfinx.errors import InvertedCellError
from hypergap_dolfinx.gap_mesh.cells import Hosts, Overhang, geometry_element
from hypergap_dolfinx.gap_mesh.slab import mesh_slab
from hypergap_dolfinx.gap_mesh.strip import mesh_strip
from hypergap_dolfinx.mortar import kernel
from hypergap_dolfinx.mortar.tolerances import ACROSS, NARROW_CELL, NOUGHT, SAG_CURVED, UNEVEN
from hypergap_dolfinx.surface.boundary import arc_height
from hypergap_dolfinx.surface.quadrilaterals import on_triangles
from hypergap_dolfinx.surface.tolerances import (
    CORNER_ASSEMBLY,
    NOISE,
    OWN_GAP,
    SAME_NODE,
    STRAIGHT,
)
from hypergap_dolfinx.surface.trace import (
    Surface,
    facet_pairs,
    gap_of_chords,
    tabulate,
    thinness,
)

Side = tuple[fem.FunctionSpace, npt.ArrayLike]


@dataclass(frozen=True)
class GapDomain:
    """Σ: simplices with nodes (x, α), and the nodes' places on the bodies' surfaces.

    The rows of the arrays are the cells of this rank. A DOLFINx mesh of them is made for results on
    Σ only, and orders them anew.
    """

    surfaces: tuple[Surface, Surface]
    """Γ0 and Γ1."""
    comm: MPI.Comm
    """Communicator of the bodies."""
    geometry: basix.finite_element.FiniteElement
    """Basix element of the cells' geometry."""
    element: basix.finite_element.FiniteElement
    """Basix element of the φ_a."""
    nodes: npt.NDArray[np.int64]
    """Global nodes of the φ_a of this rank's cells, ``(num_cells, num_nodes)``."""
    owned: tuple[int, int]
    """The first of this rank's own nodes, and the one after the last."""
    x: npt.NDArray[np.float64]
    """Geometry nodes, ``(num_cells, num_geometry_nodes, n)``."""
    alpha_vertices: npt.NDArray[np.float64]
    """α at the vertices, ``(num_cells, n + 1)``."""
    normal: npt.NDArray[np.float64]
    """Reference normals from Γ0 to Γ1, ``(num_cells, n)``."""
    curved: npt.NDArray[np.bool_]
    """Mask of cells with a curved edge, ``(num_cells,)``."""
    hosts: Hosts
    """Hosts of the nodes of ``space``."""
    patch: npt.NDArray[np.int32]
    """Smooth piece that each facet of Γ1 belongs to, ``(num_facets1,)``."""
    covered: npt.NDArray[np.float64]
    """Part of each facet of Γ1 that Γ0 covers, ``(num_facets1,)``."""
    least: npt.NDArray[np.float64]
    """Least share of a function's square that this part has, ``(num_facets1,)``; see
    :mod:`~hypergap_dolfinx.gap_mesh.cells`."""
    create_mesh: Callable[[], tuple[Mesh, npt.NDArray[np.intp]]]
    """Makes the mesh and tells the order of its cells, as :func:`distributed` does."""
    excess: float = 0.0
    """Area by which edges that are straight, lest cells be inverted, enlarge Σ."""
    overhang: Overhang | None = None
    """Parts of cells beyond what both sides have in common, to be subtracted from integrals; None
    without any. See :mod:`~hypergap_dolfinx.gap_mesh.overhang`."""

    @cached_property
    def _made(self) -> tuple[Mesh, npt.NDArray[np.intp]]:
        """The mesh, and this rank's cells in its order. Collective."""
        return self.create_mesh()

    @property
    def mesh(self) -> Mesh:
        """n-dimensional mesh with coordinates x; its cells have no volume where Γ0 and Γ1 coincide.

        Made when it is asked for first, as what lies on it is. Collective.
        """
        return self._made[0]

    @property
    def order(self) -> npt.NDArray[np.intp]:
        """This rank's cells in the order of the mesh. Collective."""
        return self._made[1]

    @cached_property
    def in_mesh(self) -> npt.NDArray[np.intp]:
        """Number in the mesh of each of this rank's cells. Collective."""
        return np.argsort(self.order)

    @cached_property
    def alpha(self) -> fem.Function:
        """α, linear on each cell. Collective."""
        alpha = fem.Function(fem.functionspace(self.mesh, ("Lagrange", 1)), name="alpha")
        alpha.x.array[alpha.function_space.dofmap.list] = self.alpha_vertices[self.order]
        return alpha

    def first_of_nodes(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.intp]]:
        """This rank's own nodes, each with its first place in the flattened ``nodes``."""
        node, first = np.unique(self.nodes, return_index=True)
        mine = slice(*np.searchsorted(node, self.owned))
        return node[mine], first[mine]

    def entries(self, W: npt.NDArray) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """Rows and columns (nodes), and values, of a sum of element matrices."""
        i, j = self.nodes[:, :, None], self.nodes[:, None, :]
        return np.broadcast_to(i, W.shape), np.broadcast_to(j, W.shape), W

    @property
    def is_revolved(self) -> bool:
        """True if the bodies are axisymmetric."""
        return self.surfaces[1].angle > 0

    def areas(self, element: kernel.GapElement, N, cells=slice(None)) -> npt.NDArray[np.float64]:
        """Areas |N| at the points of an element, of bodies of revolution times their arcs.

        Args:
            element: Tables of the gap element.
            N: n dΓ_α dα there, ``(num_cells, num_points, n)``.
            cells: The cells.

        Returns:
            ``(num_cells, num_points)``.
        """
        length = np.linalg.norm(N, axis=2)
        return length * self._arcs(element, cells) if self.is_revolved else length

    def _arcs(self, element: kernel.GapElement, cells=slice(None)) -> npt.NDArray[np.float64]:
        """Factor of areas of bodies of revolution, ``(num_cells, num_points)``."""
        return self.surfaces[1].arc(np.einsum("pm,cmi->cpi", element.psi, self.x[cells]))

    def distance(self) -> float:
        """Mean distance of Γ0 and Γ1: the volume between them over their area. Collective."""
        area, volume = self._extent()
        return volume / area

    def _extent(self) -> tuple[float, float]:
        """Area and volume. Collective."""
        n, element, total = self.x.shape[2], self.quadrature(1), np.zeros(2)
        for some in lots(len(self.x)):
            x = self.x[some]
            volumes = np.linalg.det(x[:, 1 : n + 1] - x[:, :1])
            N, _ = kernel.geometry_at_points(element, x, self.alpha_vertices[some])
            total += (element.weights * np.linalg.norm(N, axis=2)).sum(), np.abs(volumes).sum()
        area, volume = self.comm.allreduce(total)
        return float(area), float(volume / math.factorial(n))

    def quadrature(self, degree: int) -> kernel.GapElement:
        """Tables of the gap element at the points of a Gauss rule."""
        return kernel.GapElement.with_quadrature(self.geometry, self.element, degree)

    def gap_matrices(self) -> npt.NDArray[np.float64]:
        """Element matrices G_ab = ∫∫ ∂φ_a/∂α ∂φ_b/∂α dΓ_α dα. Collective.

        Returns:
            ``(num_cells, num_nodes, num_nodes)``.

        Raises:
            InvertedCellError: A cell is inverted.
        """
        k, nodes = self.element.degree, self.element.dim
        G = np.empty((len(self.x), nodes, nodes))
        curved = self.curved | self.is_revolved
        straight, error = ~curved, None
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
                element = self.quadrature(self.curved_rule)
                G[curved] = kernel.curved_gap_matrices(
                    element,
                    self.x[curved],
                    self.alpha_vertices[curved],
                    self.normal[curved],
                    self._arcs(element, curved) if self.is_revolved else None,
                )
        except InvertedCellError as e:
            error = str(e)
        raise_on_all(self.comm, error, InvertedCellError)
        return G

    def summable_gap_matrices(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.intp]]:
        """Element matrices to be added up as they are, and the narrow cells, where they are 0.

        Without the overhang. Collective.
        """
        G, narrow = self.gap_matrices(), self.narrow_cells()
        G[narrow] = 0
        if self.overhang is not None:
            subtract_squares(G, self.overhang, self.overhang_derivatives()[0])
        return G, narrow

    def narrow_cells(self) -> npt.NDArray[np.intp]:
        """Cells whose matrices have large entries that cancel each other, ``(num_narrow,)``."""
        _, v = kernel.geometry_at_points(self.quadrature(0), self.x, self.alpha_vertices)
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
        size = np.sqrt(np.abs(element.weights) * self.areas(element, N, cells))
        D = size[..., None] * kernel.alpha_derivatives(element, v)
        return D, np.sign(element.weights)

    def overhang_derivatives(self) -> tuple[npt.NDArray[np.float64], ...]:
        """∂φ_a/∂α, unit normals and ∂x/∂α at the points of the overhang, without its weights.

        Returns:
            ``(num_points, num_nodes)``, and twice ``(num_points, n)``.
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
        n, gap = N / np.linalg.norm(N, axis=1, keepdims=True), np.einsum("pij,pj->pi", X, v)
        return np.einsum("paj,pj->pa", dphi, v), n, gap


def subtract_squares(W: npt.NDArray[np.float64], points: Overhang, f: npt.NDArray[np.float64]):
    """Subtract Σ w f_a f_b over points from element matrices; f is ``(num_points, num_nodes)``."""
    outer = points.weights[:, None, None] * f[:, :, None] * f[:, None]
    np.subtract.at(W, points.cells, outer)


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
    element = _nodal_element(tdim, gap.degree)
    nodes = (
        gap.cells if gap.degree == 1 else _number_nodes(gap.cells, _lattice(element), gap.degree)[0]
    )
    mine = np.flatnonzero(gap.rank == comm.rank)
    nodes, owned = _by_owner(comm, nodes, gap.rank)
    x_cells = x[cells[mine]]
    return GapDomain(
        surfaces=surfaces,
        comm=comm,
        geometry=coordinates.basix_element,
        element=element,
        nodes=nodes,
        owned=owned,
        x=x_cells,
        alpha_vertices=gap.alpha[gap.cells[mine]],
        normal=gap.normals(mine),
        curved=_curved(x_cells, points, np.abs(x).max()),
        hosts=gap.hosts(element.points, mine),
        patch=gap.patch,
        covered=gap.covered,
        least=gap.least,
        create_mesh=partial(distributed, comm, cells[mine], share(comm, x), coordinates),
        excess=gap.excess,
        overhang=gap.overhang and gap.overhang.at(mine, len(gap.cells)),
    )


@cache
def _nodal_element(n: int, degree: int) -> basix.finite_element.FiniteElement:
    """Element of the φ_a, as DOLFINx makes it."""
    cell = {2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}[n]
    variant = basix.LagrangeVariant.gll_warped
    return basix.create_element(basix.ElementFamily.P, cell, degree, variant)


def _by_owner(
    comm: MPI.Comm, nodes: npt.NDArray, rank: npt.NDArray
) -> tuple[npt.NDArray[np.int64], tuple[int, int]]:
    """Nodes renumbered such that each rank's own ones follow each other.

    The lowest rank with a node owns it.

    Args:
        comm: Communicator.
        nodes: Nodes of the cells, ``(num_cells, num_nodes)``, the same on every rank.
        rank: Rank of each cell.

    Returns:
        The new numbers in this rank's cells, and its range of them.
    """
    owner = np.full(int(nodes.max(initial=-1)) + 1, comm.size, dtype=np.int32)
    last = np.argsort(-rank, kind="stable")  # lower ranks overwrite higher ones
    for some in lots(len(last)):
        owner[nodes[last[some]]] = rank[last[some], None]
    order = np.argsort(owner, kind="stable")
    number = np.empty(len(owner), dtype=np.int64)
    number[order] = np.arange(len(owner))
    start, end = np.searchsorted(owner[order], (comm.rank, comm.rank + 1))
    return number[nodes[rank == comm.rank]], (int(start), int(end))


def share(comm: MPI.Comm, x: npt.NDArray) -> npt.NDArray:
    """This rank's share of an array that every rank has, as large as others', in their order."""
    first, last = (len(x) * rank // comm.size for rank in (comm.rank, comm.rank + 1))
    return x[first:last].copy()


def distributed(
    comm: MPI.Comm, cells, x, element: basix.ufl._ElementBase
) -> tuple[Mesh, npt.NDArray[np.intp]]:
    """A distributed mesh of this rank's cells. Collective.

    Args:
        comm: Communicator.
        cells: Global nodes of this rank's cells, ``(num_cells, num_cell_nodes)``.
        x: The first nodes on rank 0, those behind them on rank 1, and so on, ``(num_nodes, n)``.
        element: Element of the coordinates.

    Returns:
        The mesh, and the numbers of this rank's cells in its order.
    """

    def stay(comm, num_parts, cell_types, cells_of_type):
        return compat.destinations(np.full(len(cells), comm.rank, dtype=np.int32))

    given = cells.astype(np.int64)
    mesh = dolfinx.mesh.create_mesh(comm, given, e=element, x=x, partitioner=stay)
    start = sum(comm.allgather(len(cells))[: comm.rank])
    return mesh, mesh.topology.original_cell_index - start


def _curved(x, points, magnitude) -> npt.NDArray[np.bool_]:
    """Mask of cells with geometry nodes off the simplex of their vertices, ``(num_cells,)``."""
    n = x.shape[2]
    if x.shape[1] == n + 1:
        return np.zeros(len(x), dtype=bool)
    weights = np.column_stack((1 - points.sum(axis=1), points))
    deviation = np.abs(weights @ x[:, : n + 1] - x).max(axis=(1, 2))
    size = np.ptp(x, axis=1).max(axis=1)
    return deviation > STRAIGHT * size + NOISE * magnitude


def _lattice(element: basix.finite_element.FiniteElement) -> npt.NDArray[np.int64]:
    """Nodes of a simplex times the degree, as if they were equispaced, ``(num_nodes, n)``."""
    equispaced = basix.create_element(
        element.family, element.cell_type, element.degree, basix.LagrangeVariant.equispaced
    )
    return np.rint(equispaced.points * element.degree).astype(np.int64)


def _number_nodes(cells, lattice, degree: int):
    """Number the Lagrange nodes of a mesh, shared ones once; ``lattice`` is from :func:`_lattice`.

    A node is identified by its vertices and their barycentric weights; coordinates aren't compared.

    Returns:
        Nodes of each cell, ``(num_cells, num_nodes)``, and the first position of each number in
        the flattened cells.
    """
    weights = np.column_stack((degree - lattice.sum(axis=1), lattice))  # (node, vertex)
    key = cells[:, None, :] * (degree + 1) + weights
    key = np.sort(np.where(weights > 0, key, -1), axis=2).reshape(-1, cells.shape[1])
    _, first, number = np.unique(row_codes(key + 1), return_index=True, return_inverse=True)
    return number.reshape(len(cells), -1).astype(np.int64), first


def places_of_dofs(surface: Surface) -> tuple[npt.NDArray, npt.NDArray[np.float64]]:
    """Dofs (blocks) of a surface, sorted, and their positions."""
    dofs, first = np.unique(surface.dofs, return_index=True)
    facet, local = np.divmod(first, surface.dofs.shape[1])
    return dofs, surface.points(facet, surface.element.points[local])


def interpolation_weights(surface: Surface, facet, X, weight, nodes):
    """Rows of a pull-back R_i: values of the trace's basis, times a weight.

    Args:
        surface: Γ_i.
        facet: Host facet of each point, ``(num_points,)``.
        X: Reference coordinates, ``(num_points, n - 1)``.
        weight: 1 − α on Γ0, α on Γ1; ``(num_points,)``.
        nodes: Element of the φ_a; points of weight one are its nodes on Γ_i.

    Returns:
        Point, global dof (block) and value of each nonzero entry.
    """
    if surface.facets.shape[1] == 4:
        face = basix.create_element(
            nodes.family, basix.CellType.triangle, nodes.degree, nodes.lagrange_variant
        )
        values = on_triangles(surface.element, face, X)
    else:
        values = tabulate(surface.element, X)
    values *= weight[:, None]
    # A node of Σ that is a dof of the body has a single 1 in its row, and round-off beside it
    point, local = np.nonzero(np.abs(values) > NOUGHT)
    return point, surface.dofs[facet[point], local], values[point, local]


def doubts(
    domain: GapDomain, sides: Sequence[Side], moments: bool, closes_gap: bool = False
) -> list[str]:
    """Doubts about an interface, to be settled before results are trusted. Collective.

    Args:
        domain: Σ.
        sides: Spaces and this rank's facets of Γ0 and Γ1.
        moments: True for displacements that are tied where the surfaces are.
        closes_gap: True if positions are tied.

    Returns:
        A line for each doubt, the same on every rank.
    """
    found = (
        _far_apart(domain, moments, closes_gap),
        _made_straight(domain),
        _straight_facets(domain.surfaces),
        _uneven_facets(domain, sides),
    )
    return [line for line in found if line]


def _far_apart(domain: GapDomain, moments: bool, closes_gap: bool) -> str | None:
    """Surfaces apart: a wrong tag, moments that don't balance, or chords of a curved surface."""
    apart = domain.distance()
    length = max(surface.size.max(initial=0.0) for surface in domain.surfaces)
    if apart > length:
        return (
            f"Γ0 and Γ1 are {apart:.3g} apart on average, but their longest facet is {length:.3g}: "
            "are tags and units right? They are tied across the gap."
        )
    if closes_gap:
        return _gap_of_polygons(domain, apart)
    if apart <= ACROSS * length:
        return None
    if apart <= ACROSS * length + sum(_sag(surface) for surface in domain.surfaces):
        if any(s.curved.any() or s.element.degree == 1 for s in domain.surfaces):
            return None  # of their order, or told by _straight_facets
        return (
            f"Γ0 and Γ1 are {apart:.3g} apart on average, {apart / length:.1%} of a facet: chords "
            "of a curved surface. Strains (gradients) beside it are off by up to about that "
            "share, whatever the spaces' degree; refine, or curve both meshes (in Gmsh "
            "gmsh.model.mesh.setOrder(2))."
        )
    if not moments:
        return None
    return (
        f"Γ0 and Γ1 are {apart:.3g} apart on average: forces through the tie balance, moments "
        "don't, by the force times that distance. adjust=True moves Γ1's nodes to Γ0; or mend the "
        "meshes."
    )


def _gap_of_polygons(domain: GapDomain, apart: float) -> str | None:
    """Chords of a curved surface, whose own gap is closed too."""
    own = gap_of_chords(*domain.surfaces)
    if own <= OWN_GAP * apart:
        return None
    return (
        f"Γ0 and Γ1 are {apart:.3g} apart on average, of which about {own:.2g} is the gap between "
        "chords of a curved surface, and no interference: close_gap closes both, and forces are "
        "off by that share; curve both meshes (in Gmsh gmsh.model.mesh.setOrder(2)), or give the "
        "interference as a jump."
    )


def _made_straight(domain: GapDomain) -> str | None:
    """Curved cells at the outlines, straight lest they be inverted, that change the tied area."""
    share = domain.excess / domain._extent()[0] if domain.excess else 0.0
    percent = f"{100 * abs(share):.1f}"
    if percent == "0.0":
        return None
    way = "large" if share > 0 else "small"
    return (
        f"the tied area is {percent} % too {way}: facets at its outline are too "
        "coarse for their curvature, and cells of Σ are straight there; refine the coarser side."
    )


def _sag(surface: Surface) -> float:
    """Largest distance of an arc from its chord, by the turns between facets."""
    one, other = facet_pairs(surface).T
    cosine = np.einsum("pi,pi->p", surface.normals[one], surface.normals[other])
    turn = np.arccos(np.clip(cosine, -1, 1))
    bends = turn < CORNER_ASSEMBLY
    size = np.maximum(surface.size[one], surface.size[other])[bends]
    return float(arc_height(size, turn[bends]).max(initial=0.0))


def _straight_facets(surfaces: tuple[Surface, Surface]) -> str | None:
    """Straight facets opposite curved ones, which cost spaces of degree ≥ 2 their order."""
    if max(surface.element.degree for surface in surfaces) == 1:
        return None
    sags = []
    for surface in surfaces:
        # Along the normals: a plane with a curved outline stays one
        bend = surface.nodes - surface.straight_nodes
        sag = np.abs(np.einsum("fmi,fi->fm", bend, surface.normals)).max(axis=1)
        sags.append(np.where(surface.curved, sag, 0))
    curved = [
        bool((sag > SAG_CURVED * s.size).any()) for sag, s in zip(sags, surfaces, strict=True)
    ]
    if all(curved) or not any(curved):
        return None
    i = curved.index(True)
    # An arc's distance from its chord goes with the square of the length
    curvature = (sags[i] / surfaces[i].size ** 2).max()
    off = curvature * surfaces[1 - i].size.max() ** 2
    return (
        f"the facets of {surfaces[i].name} are curved and those of {surfaces[1 - i].name} are "
        f"straight, about {off:.2g} off: that limits the accuracy whatever the spaces' degree; "
        "curve both meshes (in Gmsh gmsh.model.mesh.setOrder(2))."
    )


def _widths(v, w):
    """Facets with vertices v, ``(num, num_vertices, n)``, beside others with vertices w.

    Returns:
        Largest ratio of the other's width to the facet's own, and the latter, ``(num,)`` each.
    """
    n = v.shape[2]
    plane = np.linalg.qr((v[:, 1:n] - v[:, :1]).transpose(0, 2, 1))[0]  # (facet, n, n - 1)

    def spread(x):
        y = (x - x.mean(axis=1, keepdims=True)) @ plane
        return y.transpose(0, 2, 1) @ y / x.shape[1]

    inverse = np.linalg.inv(np.linalg.cholesky(spread(v)))
    squares, U = np.linalg.eigh(inverse @ spread(w) @ inverse.transpose(0, 2, 1))
    direction = np.einsum("sij,si->sj", inverse, U[:, :, -1])
    # Of an edge, a right triangle or a square of width 1
    unit = {2: 1 / 4, 3: 2 / 9, 4: 1 / 4}[v.shape[1]]
    return np.sqrt(squares[:, -1]), 1 / (np.sqrt(unit) * np.linalg.norm(direction, axis=1))


def unevenness(domain: GapDomain, sides: Sequence[Side], i: int) -> float:
    """Ratio by which Γ_i's facets are narrower than the other side's, and than its cells are deep.

    The lesser of both, in the direction in which the facets differ most; a tenth of Γ_i's area has
    a larger one. Collective.
    """
    n = domain.x.shape[2]
    other = domain.surfaces[1 - i]
    depth = thinness(*sides[i]) * float(np.median(domain.surfaces[i].size))
    on = domain.alpha_vertices == i
    apex = domain.alpha_vertices == 1 - i
    base = np.flatnonzero((on.sum(axis=1) == n) & (apex.sum(axis=1) == 1))
    base = base[:: max(1, len(base) // 5000)]  # as many on each rank are enough
    on, apex = on[base], apex[base]
    v = domain.x[base, : n + 1][on].reshape(-1, n, n)
    facet = domain.hosts.facets[1 - i][base, : n + 1][apex]
    E = v[:, 1:] - v[:, :1]
    area = np.sqrt(np.maximum(np.linalg.det(E @ E.transpose(0, 2, 1)), 0))  # times a constant
    # Facets of Γ_i are cut where the sides overlap in part
    surface = domain.surfaces[i]
    X = domain.hosts.X[i][base, : n + 1][on].reshape(-1, n, n - 1)
    whole = np.abs(X - np.rint(X)).max(axis=2) < SAME_NODE  # corners of their facets
    if surface.facets.shape[1] == 4:
        middle = np.abs(X - 0.5).max(axis=2) < SAME_NODE
        whole |= middle
        if middle.any(axis=1).all():  # quarters of quadrilaterals
            own = domain.hosts.facets[i][base, :4][on].reshape(-1, 3)
            v = surface.x[surface.facets[own[np.arange(len(own)), middle.argmax(axis=1)]]]
    some = (area > 0) & whole.all(axis=1)
    v, facet, area = v[some], facet[some], area[some]
    ratio, width = _widths(v, other.x[other.facets[facet]])
    mine = np.column_stack((np.minimum(ratio, depth / width), area))
    value, area = np.concatenate(domain.comm.allgather(mine)).T
    order = np.argsort(value)
    total = np.cumsum(area[order])
    if not len(total):
        return 0.0
    return float(value[order][np.searchsorted(total, 0.9 * total[-1])])


def _uneven_facets(domain: GapDomain, sides: Sequence[Side]) -> str | None:
    """Γ1's nodes between Γ0's are constrained: deep cells respond with large tractions."""
    below, above = domain.surfaces
    bound = UNEVEN * above.element.degree
    if above.gdim == 2 and below.size.max() <= bound * above.size.min():
        return None  # an edge's width is its length
    value = unevenness(domain, sides, 1)
    degrees = [surface.element.degree for surface in domain.surfaces]
    if value <= bound:
        return None
    swap = unevenness(domain, sides, 0) <= UNEVEN * degrees[0]
    advice = "swap the tie's sides" if swap else "refine Γ0 that way, or Γ1's cells across Γ1"
    return (
        f"Γ1's facets are {value:.2g} times narrower one way than those of Γ0 and than its own "
        f"cells are deep: λ oscillates, displacements hardly do. To trust λ, {advice}."
    )
