# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Contact's Σ in the plane: the weighted gap of fans on the dofs of both sides."""

from dataclasses import dataclass, field

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.errors import NotFacingError
from hypergap_dolfinx.gap import fans
from hypergap_dolfinx.gap.constraint import coo_matrix
from hypergap_dolfinx.gap.moving import Displacements, Sides, Sparse, displaced
from hypergap_dolfinx.gap.opened import OpenCells
from hypergap_dolfinx.gap.rays import Fixed, cast
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
    to_dofs: PETSc.Mat | None = None
    """Derivatives of all variables by both sides' dofs, all components, once they are asked for."""


@dataclass
class PlaneOpening:
    """Σ between two surfaces in the plane, with weights for each vertex of Γ1.

    It is found anew wherever the bodies are: g is continuous, and its derivatives are those of
    everything that moves. The same on every rank.
    """

    sides: Sides
    _last: _State | None = field(default=None, repr=False)

    @classmethod
    def between(cls, comm: MPI.Comm, sides: Sides, u: Displacements) -> "PlaneOpening":
        """Σ where the bodies are.

        Args:
            comm: Communicator.
            sides: Γ0 and Γ1.
            u: Their displacements.

        Raises:
            InterfaceError: They don't face each other.
        """
        opening = cls(sides)
        opening._at(u)
        return opening

    @property
    def num_multipliers(self) -> int:
        """One for each vertex of Γ1, in reach of Γ0 or not."""
        return len(self.sides[1].reference.x)

    def _at(self, u: Displacements) -> _State:
        """Σ where the bodies are, the last one if they haven't moved."""
        last = self._last
        if last is None or any(not np.array_equal(*pair) for pair in zip(u, last.u, strict=True)):
            self._last = last = _place(self.sides, u)
        return last

    def _to_dofs(self, state: _State) -> PETSc.Mat:
        """Derivatives of all variables by both sides' dofs, all components."""
        if state.to_dofs is not None:
            return state.to_dofs
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
        values = [entries, entries]
        first = state.crossings.first.reshape(len(state.numbers), -1, 2)
        at = 0
        number = 2 * offset + len(Fixed) + np.arange(len(first))
        for begin, table, dofs in locals_:
            some = slice(at, at + len(table))
            by = np.einsum("kmi,ma->kai", first[:, some], table)  # (crossing, dof, component)
            facet = (state.numbers[:, at] - begin) // len(table)
            for component in (0, 1):
                i.append(np.broadcast_to(number[:, None], by.shape[:2]).ravel())
                j.append((2 * dofs[facet] + component).ravel())
                values.append(by[..., component].ravel())
            at += len(table)
        sizes = state.num, 2 * start
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
        sizes = self.num_multipliers, state.num
        C = coo_matrix(MPI.COMM_SELF, sizes, *(np.concatenate(p) for p in (i, j, values)))
        product = C.matMult(self._to_dofs(state))
        C.destroy()
        return g, m, Sparse.of(product)

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
        H = coo_matrix(
            MPI.COMM_SELF, (state.num, state.num), *(np.concatenate(p) for p in (i, j, values))
        )
        product = H.ptap(self._to_dofs(state))
        H.destroy()
        return Sparse.of(product)

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
            p: ``(num_multipliers,)``.
        """
        every = self._at(u).cells
        m, volume = (np.concatenate(part) for part in zip(*((c.m, c.gap.value) for c in every)))
        return OpenCells(
            x=np.concatenate([cells.x for cells in every]),
            rank=np.concatenate([cells.rank for cells in every]),
            gap=np.divide(volume, m, out=np.zeros_like(m), where=m > 0),
            pressure=np.concatenate([p[cells.vertices].mean(axis=1) for cells in every]),
        )


def _place(sides: Sides, u: Displacements) -> _State:
    """Find Σ at displacements, and its derivatives.

    Raises:
        InterfaceError: There is none.
    """
    surfaces = displaced(sides, u)
    found = cast(*surfaces)
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
        gap = fans.volumes(of, X, Q, at[parameters[mine]])
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
        cells.append(_Cells(index, gap, m, vertices[mine], x, rank))
    at_crossings = np.hstack((numbers(0, facets[:, 0]), numbers(1, facets[:, 1])))
    copy = u[0].copy(), u[1].copy()
    return _State(copy, (cells[0], cells[1]), crossings, at_crossings, 2 * num_nodes + len(at))


def _points(surface: Surface, facet, t) -> npt.NDArray[np.float64]:
    return surface.points(facet, t[:, None])
