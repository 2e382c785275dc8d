# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Σ in three dimensions: the slab of tetrahedra between two triangulated surfaces.

:func:`mesh_slab` is the entry point: surfaces are split into smooth pieces that face each other
(:mod:`~hypergap_dolfinx.trimming.parting`) and cut to their common part
(:mod:`~hypergap_dolfinx.trimming.clip`); a front of flips (:mod:`.front`) fills the slab between
two pieces.
"""

import logging
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix
import basix.ufl
from hypergap_dolfinx.core.collective import raise_on_all, spot, wait_idly
from hypergap_dolfinx.core.compiled import library
from hypergap_dolfinx.errors import InterfaceError, NotFacingError
from hypergap_dolfinx.gap_mesh import front
from hypergap_dolfinx.gap_mesh.cavity import Place
from hypergap_dolfinx.gap_mesh.cells import (
    GapCells,
    Hosts,
    covered_parts,
    geometry_element,
    interpolate_geometry,
)
from hypergap_dolfinx.gap_mesh.overhang import overhang
from hypergap_dolfinx.gap_mesh.repair import Filling
from hypergap_dolfinx.gap_mesh.slab_cells import Slab, key_of
from hypergap_dolfinx.gap_mesh.tetrahedra import NONE, areas, marked, straightened
from hypergap_dolfinx.gap_mesh.walls import kinds
from hypergap_dolfinx.mortar.kernel import GapElement, curved_rule, geometry_at_points
from hypergap_dolfinx.surface.pieces import Side
from hypergap_dolfinx.surface.trace import Surface
from hypergap_dolfinx.trimming.clip import clip
from hypergap_dolfinx.trimming.parting import pairs_of_pieces
from hypergap_dolfinx.trimming.tolerances import COARSER, SNAP, TRIES

LOG = logging.getLogger("hypergap_dolfinx")


@dataclass(frozen=True)
class SlabCells(GapCells):
    """Σ in space, with the slabs that it consists of."""

    slabs: Sequence[Slab] = ()
    """One for each pair of facing pieces."""


def _place(sides: tuple[Side, Side]) -> Place:
    """The function that puts an interior node between its projections to both sides."""
    seeds = []
    for side in sides:
        seed = np.empty(len(side.x), dtype=np.intp)
        seed[side.triangles.ravel()] = np.repeat(np.arange(len(side.triangles)), 3)
        seeds.append(seed)
    n0 = len(sides[0].x)

    def place(x, alpha: float, vertices):
        facets, X, feet, normal = [], [], [], np.zeros(3)
        for i, side in enumerate(sides):
            own = (vertices - i * n0)[(vertices >= n0) == i]
            own = own[own < len(side.x)]
            own = own if len(own) else np.arange(len(side.x))
            near = own[np.linalg.norm(side.x[own] - x, axis=1).argmin()]
            triangle, at = side.project(x[None], seeds[i][[near]])
            feet.append(side.points(triangle, at)[0])
            normal += (1 - 2 * i) * side.normals[triangle[0]]
            facets.append(int(triangle[0]))
            X.append(at[0])
        normal /= max(np.linalg.norm(normal), 1e-300)
        x = (1 - alpha) * feet[0] + alpha * feet[1]
        return x, alpha, normal, (alpha, facets, X)

    return place


def _slab(sides: tuple[Side, Side], filling: Filling) -> Slab:
    """The cells with their interior vertices' hosts as arrays."""
    alpha = np.array([host[0] for host in filling.hosts]).reshape(1, -1)
    f0, f1 = (np.array([h[1][i] for h in filling.hosts], np.intp).reshape(1, -1) for i in (0, 1))
    X0, X1 = (np.array([h[2][i] for h in filling.hosts]).reshape(1, -1, 2) for i in (0, 1))
    hosts = Hosts(alpha, (f0, f1), (X0, X1))
    return Slab(sides, filling.cells, hosts, filling.straight, filling.walls)


@cache
def _tables(geometry: basix.ufl._ElementBase, degree: int) -> GapElement:
    """The geometry element at the points of a Gauss rule; making it outweighs small scenes."""
    element = geometry.basix_element
    return GapElement.with_quadrature(element, element, degree)


def _areas(slab: Slab, nodes) -> tuple[npt.NDArray[np.float64], ...]:
    """Least N · n of each cell with curved geometry, over its longest edge²; ∫ N · n and ∫ |N|.

    Its nodes, ``(num_cells, num_nodes, 3)``, are given as if no edges were straight.
    """
    surfaces = [side.surface for side in slab.sides]
    k = max(side.degree for side in slab.sides)
    element = geometry_element(surfaces, k)
    points = element.basix_element.points
    v = slab.x[slab.cells]
    x = straightened(nodes, points, marked(slab.cells, slab.straight), v)
    tables = _tables(element, curved_rule(3, k, element.degree))
    N, _ = geometry_at_points(tables, x, slab.alpha[slab.cells])
    scale = ((v[:, 1:] - v[:, :1]) ** 2).sum(axis=2).max(axis=1)
    along = np.einsum("cpi,ci->cp", N, slab.normal)
    whole = np.linalg.norm(N, axis=2) @ tables.weights
    return along.min(axis=1) / scale, along @ tables.weights, whole


class _Margins:
    """Margins of cells against inversion, :data:`~.repair.Margins`; hosts of nodes are cached."""

    def __init__(self, sides: tuple[Side, Side], points: npt.NDArray[np.float64]):
        """Margins between two pieces, for a geometry with nodes at some reference points."""
        self.sides, self.points = sides, points
        self._num_vertices = sum(len(side.x) for side in sides)
        self._number: dict[bytes, int] = {}
        self._hosts: list[Hosts] = []
        self._nodes = np.empty((0, len(points), 3))
        self._values = np.empty(0)
        self._inner: dict[int, tuple[int, tuple]] = {}  # interior vertices, by their hosts

    def __call__(self, filling: Filling) -> npt.NDArray[np.float64]:
        at = self._find(filling)
        values = self._values[at]
        moved = np.flatnonzero(marked(filling.cells, filling.straight).any(axis=1))
        if len(moved):
            slab = _slab(self.sides, filling.with_cells(filling.cells[moved]))
            values[moved] = _areas(slab, self._nodes[at[moved]])[0]
        return values

    def excess(self, filling: Filling) -> float:
        """Area by which straight edges enlarge the cells: they may lean, where others may fold."""
        moved = np.flatnonzero(marked(filling.cells, filling.straight).any(axis=1))
        if not len(moved):
            return 0.0
        some = filling.with_cells(filling.cells[moved])
        nodes = self._nodes[self._find(some)]
        _, curved, _ = _areas(_slab(self.sides, replace(some, straight=NONE)), nodes)
        _, _, straight = _areas(_slab(self.sides, some), nodes)
        return float(straight.sum() - curved.sum())

    def _find(self, filling: Filling) -> npt.NDArray[np.intp]:
        """Numbers of cells in the cache; cells that aren't there yet are added."""
        # Interior vertices have other numbers in another filling
        lot = [self._inner.setdefault(id(h), (len(self._inner), h))[0] for h in filling.hosts]
        number = np.append(np.arange(self._num_vertices), self._num_vertices + np.array(lot, int))
        cells = filling.cells
        each = np.column_stack((number[cells], kinds(cells, filling.walls)))
        data = each.astype(np.int64).tobytes()
        keys = [data[i : i + 40] for i in range(0, len(data), 40)]
        at = np.array([self._number.get(key, -1) for key in keys], dtype=np.intp)
        new = np.flatnonzero(at < 0)
        if len(new):
            slab = _slab(self.sides, replace(filling.with_cells(cells[new]), straight=NONE))
            self._hosts.append(slab.hosts(self.points, np.arange(len(new))))
            nodes = interpolate_geometry([side.surface for side in self.sides], self._hosts[-1])
            at[new] = len(self._nodes) + np.arange(len(new))  # a cell may be among them twice
            self._nodes = np.concatenate((self._nodes, nodes))
            self._values = np.concatenate((self._values, _areas(slab, nodes)[0]))
            self._number.update((keys[i], at[i]) for i in new)
        return at

    def hand_over(self, slab: Slab, filling: Filling):
        """Give the cached hosts to the slab of a filling's cells."""
        if self._hosts:
            each = self._find(filling)
            moved = np.flatnonzero(marked(filling.cells, filling.straight).any(axis=1))
            each[moved] = len(self._nodes) + np.arange(len(moved))  # nodes of straight edges
            found = [*self._hosts, slab.hosts(self.points, moved)]
            slab.known[key_of(self.points)] = Hosts.concatenate(found)[each]


def _check_folded(side: Side):
    """Refuse curved facets that are folded: straight edges would hide them."""
    surface, facets = side.surface, np.unique(side.facets)
    folded = facets[surface.folded[facets]]  # whole ones: parts may be slivers facing anywhere
    if len(folded):
        raise InterfaceError(
            f"a curved facet of {surface.name} at {spot(surface.nodes[folded[0]])} is "
            "folded: its middle nodes are too far off; refine the mesh there or straighten it."
        )


def fill(sides: tuple[Side, Side]) -> Slab:
    """Cells between two facing pieces.

    Raises:
        InterfaceError: Their boundaries don't match; curved facets are folded; there is no valid
            mesh.
    """
    problem = front.Problem.between(*sides)
    degree = max(side.degree for side in sides)
    geometry = geometry_element([side.surface for side in sides], degree).basix_element

    margins = _Margins(sides, geometry.points)
    filling = front.construct(problem, _place(sides), margins if geometry.degree > 1 else None)
    if filling is None:
        raise InterfaceError(
            f"no mesh of the gap between Γ0 and Γ1 around {spot(sides[1].x)}. Do the "
            "surfaces have the same shape there? Refine the coarser one."
        )
    if len(filling.straight):
        for side in sides:
            _check_folded(side)
    slab = replace(_slab(sides, filling), excess=margins.excess(filling))
    margins.hand_over(slab, filling)
    return slab


def _are_same(pairs: list[tuple[Side, Side]], others: list[tuple[Side, Side]]) -> bool:
    """True if two cuts of the same pieces have the same triangles."""
    arrays = [[a for pair in cut for side in pair for a in side.arrays] for cut in (pairs, others)]
    return len(arrays[0]) == len(arrays[1]) and all(map(np.array_equal, *arrays))


def fill_common(side0: Side, side1: Side) -> list[Slab]:
    """Cells between the common parts of two facing pieces, of Γ0 and of Γ1.

    Outlines that are hardly further apart than the tolerance leave edges as short as that, beside
    which the other side's nodes may lie anywhere. If no mesh is found for that reason, such
    outlines are taken for one: the tolerance grows. At last outlines may meet at vertices that they
    pass nearby. The same cuts aren't tried twice.

    Raises:
        NotFacingError: The pieces have no common part.
        InterfaceError: There is no valid mesh.
    """
    first: InterfaceError | None = None
    tried: list[list[tuple[Side, Side]]] = []
    for at_corners, of_one_curve, k in product((False, True), (True, False), range(TRIES)):
        whole = False
        try:
            pairs = clip(side0, side1, SNAP * COARSER**k, of_one_curve, at_corners)
            whole = pairs[0][0] is side0
            if any(_are_same(pairs, before) for before in tried):
                continue
            tried.append(pairs)
            return [fill(pair) for pair in pairs]
        except InterfaceError as error:
            first = first or error
            if whole or isinstance(error, NotFacingError):
                break
    assert first
    raise first


def summary(slabs: Sequence[Slab]) -> str:
    """Number, kinds and quality of the cells made, in a line for the log.

    A cell's quality is its D over its scale (:func:`~.tetrahedra.areas`): the cosine between a base
    and n, or the sine between an edge on Γ0 and one on Γ1; 0 if it is flat. Kinds are the numbers
    of vertices on Γ0 and on Γ1; others are between them.
    """
    D: list[npt.NDArray[np.float64]] = []
    kinds: Counter[tuple[int, int]] = Counter()
    for slab in slabs:
        value, scale = areas(slab.x[slab.cells], slab.alpha[slab.cells], slab.normal)
        D.append(value / scale)
        alpha = slab.alpha[slab.cells]
        number = np.column_stack([part.sum(axis=1) for part in (alpha == 0, alpha == 1)])
        kind, count = np.unique(number, axis=0, return_counts=True)
        kinds.update(dict(zip(map(tuple, kind.tolist()), count.tolist(), strict=True)))
    quality = np.concatenate(D)
    each = [f"{count} ({a}, {b})" for (a, b), count in sorted(kinds.items(), reverse=True)]
    inner = sum(slab.inner.alpha.size for slab in slabs)
    straight = sum(len(slab.straight) for slab in slabs)
    return (
        f"{len(quality)} cells: {', '.join(each)}; {inner} interior nodes; "
        f"{straight} edges made straight; {len(slabs)} pieces; "
        f"quality {quality.min():.2g} at worst, {quality.mean():.2g} in the mean"
    )


def mesh_slab(comm: MPI.Comm, surface0: Surface, surface1: Surface) -> SlabCells:
    """Mesh Σ between two surfaces in space, on rank 0. Collective.

    Returns:
        The cells, the same on every rank.

    Raises:
        InterfaceError: Surfaces that don't face each other, or for which there is no valid mesh.
        RuntimeError: There is no C compiler.
    """
    start = time.perf_counter()
    reason = None
    try:
        library("space")  # every rank needs the compiled C
    except RuntimeError as error:
        reason = str(error)
    raise_on_all(comm, reason, RuntimeError)
    surfaces = surface0, surface1
    groups, num, behind = pairs_of_pieces(*surfaces)

    of_sides = (
        [Side.of(surface, np.flatnonzero(group == g), behind=neighbours) for g in range(num)]
        for surface, group, neighbours in zip(surfaces, groups, behind, strict=True)
    )
    pieces = list(zip(*of_sides, strict=True))
    gap = _joined(surfaces, groups[1], _on_all_ranks(comm, pieces))
    if comm.rank == 0 and LOG.isEnabledFor(logging.INFO):
        LOG.info("Σ has %s; %.2g s", summary(gap.slabs), time.perf_counter() - start)
    return gap


def _on_all_ranks(comm: MPI.Comm, pieces: Sequence[tuple[Side, Side]]) -> list[Slab]:
    """The slabs between facing pieces, or the error that rank 0 raises making them. Collective."""
    result: list[tuple] = []
    slabs: list[Slab] = []
    error = None
    if comm.rank == 0:
        try:
            for g, pair in enumerate(pieces):
                for slab in fill_common(*pair):
                    is_cut = any(side is not own for side, own in zip(slab.sides, pair))
                    cut = [side.arrays for side in slab.sides] if is_cut else None
                    made = slab.cells, slab.inner, slab.straight, slab.walls, slab.excess
                    slabs.append(slab)
                    result.append((g, cut, made))
        except (InterfaceError, RuntimeError) as e:
            error = e
    wait_idly(comm)
    kind = comm.bcast(type(error) if error else InterfaceError)
    raise_on_all(comm, str(error) if error else None, kind)
    if comm.size > 1:
        result = comm.bcast(result)
    if comm.rank > 0:
        for g, cut, made in result:
            own, other = pieces[g]
            sides = own, other
            if cut:
                sides = Side(own.surface, *cut[0]), Side(other.surface, *cut[1])
            slabs.append(Slab(sides, *made))
    return slabs


def _stacked(arrays: list[npt.NDArray]) -> npt.NDArray:
    """Arrays in one; the only one itself."""
    return np.concatenate(arrays) if len(arrays) > 1 else arrays[0]


def _joined(surfaces: tuple[Surface, Surface], patch, slabs: list[Slab]) -> SlabCells:
    """Σ from its slabs, numbered consecutively; patch is as in :class:`GapCells`."""
    covered, least = covered_parts(
        surfaces[1],
        np.concatenate([slab.sides[1].facets for slab in slabs]),
        np.vstack([slab.sides[1].X for slab in slabs]),
        np.concatenate([slab.sides[1].shares for slab in slabs]),
    )
    num_cells = np.cumsum([0] + [len(slab.cells) for slab in slabs])
    offsets = np.cumsum([0] + [len(slab.x) for slab in slabs])

    def of_slabs(cells):
        """Slabs with their own numbers of some cells, and the order of what they give."""
        order = np.argsort(cells, kind="stable")
        parts = np.split(cells[order], np.searchsorted(cells[order], num_cells[1:-1]))
        own = [part - n for part, n in zip(parts, num_cells[:-1], strict=True)]
        return zip(slabs, own, strict=True), np.argsort(order, kind="stable")

    def hosts(points: npt.NDArray[np.float64], cells: npt.NDArray[np.intp]) -> Hosts:
        if len(slabs) == 1:
            return slabs[0].hosts(points, cells)
        each, order = of_slabs(cells)
        return Hosts.concatenate([slab.hosts(points, own) for slab, own in each])[order]

    def normals(cells: npt.NDArray[np.intp]) -> npt.NDArray[np.float64]:
        each, order = of_slabs(cells)
        return _stacked([slab.normals(own) for slab, own in each])[order]

    straight = np.vstack([marked(slab.cells, slab.straight) for slab in slabs])
    degree = max(side.degree for slab in slabs for side in slab.sides)
    return SlabCells(
        x=_stacked([slab.x for slab in slabs]),
        alpha=_stacked([slab.alpha for slab in slabs]),
        cells=_stacked([slab.cells + n if n else slab.cells for slab, n in zip(slabs, offsets)]),
        normals=normals,
        rank=_stacked([slab.rank for slab in slabs]),
        patch=patch,
        covered=covered,
        least=least,
        degree=degree,
        hosts=hosts,
        straight=straight if straight.any() else None,
        excess=sum(slab.excess for slab in slabs),
        overhang=overhang(slabs, degree),
        slabs=slabs,
    )
