# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Contact's Σ in the plane: the weighted gap of fans on the dofs of both sides."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.errors import NotFacingError
from hypergap_dolfinx.gap import fans, slip_fans
from hypergap_dolfinx.gap.constraint import coo_matrix
from hypergap_dolfinx.gap.moving import Displacements, Sides, Sparse, displaced
from hypergap_dolfinx.gap.opened import OpenCells
from hypergap_dolfinx.gap.rays import END, Fixed, cast
from hypergap_dolfinx.gap.strip import mesh_strip
from hypergap_dolfinx.gap.surface import Surface, tabulate


@dataclass(frozen=True)
class _Cells:
    """Cells with their bases on one side."""

    numbers: npt.NDArray[np.intp]
    """Of the variables of each: base's nodes, apex' nodes, parameters, ``(num, num_variables)``."""
    gap: fans.Derivatives
    m: npt.NDArray[np.float64]
    """Areas, ``(num,)``."""
    vertices: npt.NDArray[np.intp]
    """Vertices of Γ1 with one half each, ``(num, 2)``."""
    x: npt.NDArray[np.float64]
    """Both ends of the base and the apex, ``(num, 3, 2)``."""
    rank: npt.NDArray[np.int32]
    """Rank of the body's cell at the base, ``(num,)``."""
    places: tuple
    """Elements, nodes of bases and of apexes, parameters: what :mod:`fans` is asked about."""


@dataclass
class _State:
    """Σ at displacements."""

    u: Displacements
    cells: tuple[_Cells, _Cells]
    """With bases on Γ0 and on Γ1."""
    crossings: fans.Derivatives
    numbers: npt.NDArray[np.intp]
    """Of the nodes at each crossing, ``(num_crossings, num_nodes0 + num_nodes1)``."""
    num: int
    """Number of variables: the nodes' and the parameters."""
    whole: frozenset[int]
    """Edges of Γ1 of which both vertices have a weight."""
    to_dofs: PETSc.Mat | None = None
    """Derivatives of all variables by both sides' dofs, all components, once they are asked for."""
    slopes: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None = None
    """Derivatives of slips by both sides' variables, likewise."""
    gap: tuple[npt.NDArray, npt.NDArray, Sparse] | None = None
    """g, m and C, likewise."""


@dataclass(frozen=True)
class _Wall:
    """Ends of Γ0 and Γ1 that slide along one wall, as those of symmetry are."""

    ends: tuple[int, int]
    """Vertices of Γ1 and of Γ0."""
    axis: int
    """Coordinate in which both are held."""
    size: float
    """Of Γ1's facet there."""

    def is_between(self, surfaces: tuple[Surface, Surface]) -> bool:
        """Whether it is one wall where the surfaces are."""
        a, b = self.ends
        apart = surfaces[0].x[b, self.axis] - surfaces[1].x[a, self.axis]
        return abs(apart) <= END * self.size


@dataclass
class PlaneOpening:
    """Σ between two surfaces in the plane, with weights for each vertex of Γ1.

    It is found anew wherever the bodies are: g is continuous, and its derivatives are those of
    everything that moves. The same on every rank.
    """

    sides: Sides
    held: Sequence[npt.NDArray[np.bool_]]
    """Which dofs of both sides are prescribed, ``(num_dofs_i, 2)`` each."""
    _last: _State | None = field(default=None, repr=False)

    @classmethod
    def between(
        cls, sides: Sides, u: Displacements, held: Sequence[npt.NDArray[np.bool_]]
    ) -> "PlaneOpening":
        """Σ where the bodies are.

        Args:
            sides: Γ0 and Γ1.
            u: Their displacements.
            held: Which of them are prescribed.

        Raises:
            InterfaceError: They don't face each other.
        """
        opening = cls(sides, held)
        opening._at(u)
        return opening

    @cached_property
    def _walls(self) -> list[_Wall]:
        """Where ends of both sides are held in the coordinate along which their surfaces go."""
        side0, side1 = self.sides
        surfaces = side0.reference, side1.reference
        (starts0, ends0), (starts1, ends1) = (
            (np.setdiff1d(*s.facets.T), np.setdiff1d(*s.facets.T[::-1])) for s in surfaces
        )
        found = []
        # Γ0 runs against Γ1
        for mine, others in ((starts1, ends0), (ends1, starts0)):
            for a in mine.tolist() if len(others) else ():
                (f,) = np.nonzero((surfaces[1].facets == a).any(axis=1))[0]
                edge = np.abs(np.diff(surfaces[1].x[surfaces[1].facets[f]], axis=0)[0])
                axis = int(edge.argmax())
                if not self._held_at(1, a)[axis]:
                    continue
                apart = np.abs(surfaces[0].x[others] - surfaces[1].x[a])
                can = self._held_at(0, others)[:, axis] & (apart[:, axis] <= END * edge[axis])
                if can.any():
                    b = int(others[np.where(can, apart.sum(axis=1), np.inf).argmin()])
                    found.append(_Wall((a, b), axis, float(edge[axis])))
        return found

    def _held_at(self, i: int, vertex) -> npt.NDArray[np.bool_]:
        """Which components are prescribed at vertices of a side, ``(..., 2)``."""
        side = self.sides[i]
        return self.held[i][np.searchsorted(side.dofs, side.vertex_dofs[vertex])]

    @property
    def num_multipliers(self) -> int:
        """One for each vertex of Γ1, in reach of Γ0 or not."""
        return len(self.sides[1].reference.x)

    def _at(self, u: Displacements) -> _State:
        """Σ where the bodies are, the last one if they haven't moved."""
        last = self._last
        if last is None or any(not np.array_equal(*pair) for pair in zip(u, last.u, strict=True)):
            whole = last.whole if last else frozenset()
            self._last = last = _place(self.sides, u, self._walls, whole)
        return last

    @cached_property
    def _nodes_by_dofs(self):
        """Derivatives of the geometry's nodes by dofs, which stay the same.

        Returns:
            Rows, columns and values for each component; for each side the number of its first
            node, values at a facet's nodes ``(node, dof)`` and its facets' dofs.
        """
        i, j, values = [], [], []
        offset, start = 0, 0
        locals_ = []
        for side in self.sides:
            rest = side.displaced(np.zeros((len(side.dofs), 2)))
            table = tabulate(rest.element, rest.geometry.points)  # (node, dof)
            num = len(rest.facets) * len(table)
            node, dof = np.nonzero(table)
            facets = np.arange(len(rest.facets))[:, None]
            rows = offset + facets * len(table) + node
            columns = start + side.at_facets[:, dof]
            entries = np.broadcast_to(table[node, dof], rows.shape)
            i.append(rows.ravel())
            j.append(columns.ravel())
            values.append(entries.ravel())
            locals_.append((offset, table, start + side.at_facets))
            offset, start = offset + num, start + len(side.dofs)
        rows, columns, entries = (np.concatenate(part) for part in (i, j, values))
        i = [(2 * rows + component) for component in (0, 1)]
        j = [(2 * columns + component) for component in (0, 1)]
        return i, j, [entries, entries], locals_

    def _to_dofs(self, state: _State) -> PETSc.Mat:
        """Derivatives of all variables by both sides' dofs, all components."""
        if state.to_dofs is not None:
            return state.to_dofs
        i, j, values, locals_ = ([*part] for part in self._nodes_by_dofs)
        first = state.crossings.first.reshape(len(state.numbers), -1, 2)
        at = 0
        number = state.num - len(first) + np.arange(len(first))
        for begin, table, dofs in locals_:
            some = slice(at, at + len(table))
            by = np.einsum("kmi,ma->kai", first[:, some], table)  # (crossing, dof, component)
            facet = (state.numbers[:, at] - begin) // len(table)
            for component in (0, 1):
                i.append(np.broadcast_to(number[:, None], by.shape[:2]).ravel())
                j.append((2 * dofs[facet] + component).ravel())
                values.append(by[..., component].ravel())
            at += len(table)
        sizes = state.num, 2 * sum(len(side.dofs) for side in self.sides)
        parts = (np.concatenate(part) for part in (i, j, values))
        state.to_dofs = coo_matrix(MPI.COMM_SELF, sizes, *parts)
        return state.to_dofs

    def gap(self, u: Displacements) -> tuple[npt.NDArray, npt.NDArray, Sparse]:
        """The weighted gap.

        Args:
            u: Displacements.

        Returns:
            g and m, ``(num_multipliers,)``, and C = ∂g/∂u,
            ``(num_multipliers, 2 (num_dofs0 + num_dofs1))``.
        """
        state = self._at(u)
        if state.gap is not None:
            return state.gap
        g, m = np.zeros(self.num_multipliers), np.zeros(self.num_multipliers)
        i, j, values = [], [], []
        for cells in state.cells:
            for k in (0, 1):
                np.add.at(g, cells.vertices[:, k], 0.5 * cells.gap.value)
                np.add.at(m, cells.vertices[:, k], 0.5 * cells.m)
                rows = np.broadcast_to(cells.vertices[:, k, None], cells.numbers.shape)
                i.append(rows.ravel())
                j.append(cells.numbers.ravel())
                values.append(0.5 * cells.gap.first.ravel())
        C = self._rows_by_dofs(state, *(np.concatenate(part) for part in (i, j, values)))
        state.gap = g, m, C
        return state.gap

    def curvature(self, u: Displacements, p: npt.NDArray[np.float64]) -> Sparse:
        """H = Σ_a p_a ∂²g_a/∂u², of the size of u.

        Args:
            u: Displacements.
            p: ``(num_multipliers,)``.
        """
        state = self._at(u)
        slope = np.zeros(state.num)
        i, j, values = [], [], []

        def add(numbers, blocks):
            i.append(np.broadcast_to(numbers[:, :, None], blocks.shape).ravel())
            j.append(np.broadcast_to(numbers[:, None, :], blocks.shape).ravel())
            values.append(blocks.ravel())

        for cells in state.cells:
            pressure = 0.5 * p[cells.vertices].sum(axis=1)
            on = np.flatnonzero(pressure)
            numbers, pressure = cells.numbers[on], pressure[on]
            add(numbers, pressure[:, None, None] * cells.gap.second[on])
            np.add.at(slope, numbers, pressure[:, None] * cells.gap.first[on])
        if len(state.numbers):
            nodes = (2 * state.numbers[..., None] + np.arange(2)).reshape(len(state.numbers), -1)
            moves = slope[len(slope) - len(nodes) :]
            on = np.flatnonzero(moves)
            add(nodes[on], moves[on, None, None] * state.crossings.second[on])
        return self._by_dofs_twice(state, i, j, values)

    def slip(
        self, u: Displacements, since: Displacements, lender: npt.NDArray[np.intp]
    ) -> tuple[Sparse, Sparse]:
        """What the weighted slip of Γ1 on Γ0, along Γ0's edges from start to end, is made of.

        Args:
            u: Displacements.
            since: Those from which slip is counted.
            lender: Not asked for: all slips are along Γ0.

        Returns:
            T with s = T (u − u_since), and S = ∂s/∂u, of the size of C.
        """
        state = self._at(u)
        moves = [a - b for a, b in zip(u, since, strict=True)]
        nodes = np.concatenate([self._at_nodes(i, part).ravel() for i, part in enumerate(moves)])
        i, j, values = [], [], []
        for cells, slopes in zip(state.cells, self._slopes(state), strict=True):
            T = slip_fans.slips(*cells.places)
            num = T.shape[1]
            S = np.einsum("cij,ci->cj", slopes, nodes[cells.numbers[:, :num]])
            S[:, :num] += T
            both = np.stack((np.pad(T, ((0, 0), (0, 3))), S), axis=-1)
            for k in (0, 1):
                i.append(np.broadcast_to(cells.vertices[:, k, None], cells.numbers.shape).ravel())
                j.append(cells.numbers.ravel())
                values.append(0.5 * both.reshape(-1, 2))
        rows, columns, entries = (np.concatenate(part) for part in (i, j, values))
        parts = [self._rows_by_dofs(state, rows, columns, part.copy()) for part in entries.T]
        return parts[0], parts[1]

    def slip_curvature(
        self, u: Displacements, q: npt.NDArray[np.float64], lender: npt.NDArray[np.intp]
    ) -> Sparse:
        """Σ_a ∂(q_a T_a)/∂u, of the size of u; it isn't symmetric.

        Args:
            u: Displacements.
            q: ``(1, num_multipliers)``.
            lender: Not asked for.
        """
        state = self._at(u)
        i, j, values = [], [], []
        for cells, slopes in zip(state.cells, self._slopes(state), strict=True):
            traction = 0.5 * q[0, cells.vertices].sum(axis=1)
            on = np.flatnonzero(traction)
            block, numbers = slopes[on], cells.numbers[on]
            i.append(np.broadcast_to(numbers[:, : block.shape[1], None], block.shape).ravel())
            j.append(np.broadcast_to(numbers[:, None], block.shape).ravel())
            values.append((traction[on, None, None] * block).ravel())
        return self._by_dofs_twice(state, i, j, values)

    def _rows_by_dofs(self, state: _State, i, j, values) -> Sparse:
        """Rows of multipliers by all variables as those by the dofs."""
        C = coo_matrix(MPI.COMM_SELF, (self.num_multipliers, state.num), i, j, values)
        product = C.matMult(self._to_dofs(state))
        C.destroy()
        return Sparse.of(product)

    def _by_dofs_twice(self, state: _State, i, j, values) -> Sparse:
        """Second derivatives by all variables, in parts, as those by the dofs."""
        parts = (np.concatenate(part) for part in (i, j, values))
        H = coo_matrix(MPI.COMM_SELF, (state.num, state.num), *parts)
        product = H.ptap(self._to_dofs(state))
        H.destroy()
        return Sparse.of(product)

    def _slopes(self, state: _State) -> tuple[npt.NDArray, npt.NDArray]:
        if state.slopes is None:
            below, above = state.cells
            state.slopes = slip_fans.slopes(*below.places), slip_fans.slopes(*above.places)
        return state.slopes

    def _at_nodes(self, i: int, u) -> npt.NDArray[np.float64]:
        """Displacements of a side's dofs at its facets' nodes, ``(num_nodes, 2)``."""
        side = self.sides[i]
        rest = side.displaced(np.zeros_like(u))
        table = tabulate(rest.element, rest.geometry.points)  # (node, dof)
        return (table @ u[side.at_facets]).reshape(-1, 2)

    def smoothed(self, u: Displacements, p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Pressures for people, (SᵀDSp) / (SᵀD1): S the cells' weights, D their areas.

        They have the force of p, and less of its scatter from node to node.

        Args:
            u: Displacements.
            p: ``(num_multipliers,)``.
        """
        total, size = (np.zeros(self.num_multipliers) for _ in range(2))
        for cells in self._at(u).cells:
            mean = p[cells.vertices].mean(axis=1) * cells.m
            for k in (0, 1):
                np.add.at(total, cells.vertices[:, k], mean)
                np.add.at(size, cells.vertices[:, k], cells.m)
        return np.divide(total, size, out=np.zeros_like(total), where=size > 0)

    def cells(self, u: Displacements, p: npt.NDArray[np.float64]) -> OpenCells:
        """The cells where the bodies are, to look at.

        Args:
            u: Displacements.
            p: Pressures, ``(num_multipliers,)``, or tractions, ``(num_multipliers, 2)``.
        """
        every = self._at(u).cells
        m, volume = (np.concatenate(part) for part in zip(*((c.m, c.gap.value) for c in every)))
        return OpenCells(
            x=np.concatenate([cells.x for cells in every]),
            rank=np.concatenate([cells.rank for cells in every]),
            gap=np.divide(volume, m, out=np.zeros_like(m), where=m > 0),
            pressure=np.concatenate([p[cells.vertices].mean(axis=1) for cells in every]),
        )


def _place(sides: Sides, u: Displacements, walls: list[_Wall], whole: frozenset[int]) -> _State:
    """Find Σ at displacements, and its derivatives; the last one's whole edges have a say.

    Raises:
        InterfaceError: There is none.
    """
    surfaces = displaced(sides, u)
    at_walls = [wall.ends for wall in walls if wall.is_between(surfaces)]
    found = cast(*surfaces, whole, at_walls)
    if not found.base:
        mesh_strip(*surfaces)  # says why
        raise NotFacingError("Γ0 and Γ1 don't face each other: no normal of Γ1 meets Γ0.")
    elements = surfaces[0].geometry, surfaces[1].geometry
    count = [surface.nodes.shape[1] for surface in surfaces]
    offsets = 0, len(surfaces[0].facets) * count[0]
    num_nodes = offsets[1] + len(surfaces[1].facets) * count[1]

    def numbers(i: int, facets):
        """Numbers of the nodes of facets of a side."""
        return offsets[i] + facets[:, None] * count[i] + np.arange(count[i])

    facets = np.array(found.facets, dtype=np.intp).reshape(-1, 2)
    unknown = np.array(found.unknown, dtype=np.intp)
    each, s = np.arange(len(unknown)), np.zeros((len(unknown), 2))
    s[each, unknown], s[each, 1 - unknown] = found.guess, found.given
    X0, X1 = (surfaces[i].nodes[facets[:, i]] for i in (0, 1))
    crossings = fans.crossings(elements, X0, X1, unknown, s)
    at = np.concatenate((np.zeros(len(Fixed)), crossings.value))
    at[[Fixed.START, Fixed.END, Fixed.MIDDLE]] = 0, 1, 0.5
    side, parameters = np.array(found.side), np.array(found.parameters).reshape(-1, 3)
    base, apex = np.array(found.base, dtype=np.intp), np.array(found.apex, dtype=np.intp)
    vertices = np.array(found.vertices, dtype=np.intp).reshape(-1, 2)
    cells = []
    for i in (0, 1):
        mine = np.flatnonzero(side == i)
        X, Q = surfaces[i].nodes[base[mine]], surfaces[1 - i].nodes[apex[mine]]
        of = elements[i], elements[1 - i]
        places = of, X, Q, at[parameters[mine]]
        gap = fans.volumes(*places)
        nodes = np.hstack((numbers(i, base[mine]), numbers(1 - i, apex[mine])))
        nodes = (2 * nodes[..., None] + np.arange(2)).reshape(len(mine), 2 * nodes.shape[1])
        ends = at[parameters[mine, :2]]
        chord = [_points(surfaces[i], base[mine], ends[:, k]) for k in (0, 1)]
        m = 0.5 * np.linalg.norm(chord[1] - chord[0], axis=1)
        index = np.hstack((nodes, 2 * num_nodes + parameters[mine]))
        x = np.stack(
            (*chord, _points(surfaces[1 - i], apex[mine], at[parameters[mine, 2]])), axis=1
        )
        rank = surfaces[i].owner[base[mine]]
        cells.append(_Cells(index, gap, m, vertices[mine], x, rank, places))
    at_crossings = np.hstack((numbers(0, facets[:, 0]), numbers(1, facets[:, 1])))
    copy = u[0].copy(), u[1].copy()
    num, both = 2 * num_nodes + len(at), (cells[0], cells[1])
    return _State(copy, both, crossings, at_crossings, num, frozenset(found.whole))


def _points(surface: Surface, facet, t) -> npt.NDArray[np.float64]:
    return surface.points(facet, t[:, None])
