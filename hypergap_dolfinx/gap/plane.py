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
from hypergap_dolfinx.gap.rays import END, POSITIONS, Fans, cast
from hypergap_dolfinx.gap.strip import mesh_strip
from hypergap_dolfinx.gap.surface import Surface, lengths


@dataclass(frozen=True)
class _Cells:
    """Cells of which all bases have one element, and all apexes."""

    numbers: npt.NDArray[np.intp]
    """Of the variables of each: base's nodes, apex' nodes, parameters, ``(num, num_variables)``."""
    gap: fans.Volumes
    m: npt.NDArray[np.float64]
    """Areas, ``(num,)``."""
    vertices: npt.NDArray[np.intp]
    """Vertices of Γ1 with one half each, ``(num, 2)``."""
    which: npt.NDArray[np.bool_]
    """Of all cells, ``(num_cells,)``."""
    places: tuple
    """Elements, nodes of bases and of apexes, parameters: what :mod:`fans` is asked about."""

    @property
    def x(self) -> npt.NDArray[np.float64]:
        """Both ends of the base and the apex, ``(num, 3, 2)``."""
        elements, X, Q, s = self.places
        ends = np.einsum("cea,cai->cei", fans.shapes(elements[0], s[:, :2])[0], X)
        apex = np.einsum("cea,cai->cei", fans.shapes(elements[1], s[:, 2:])[0], Q)
        return np.concatenate((ends, apex), axis=1)


@dataclass
class _State:
    """Σ at displacements."""

    u: Displacements
    cells: list[_Cells]
    """All of them, or those with bases on Γ0 and those with bases on Γ1."""
    crossings: fans.Crossings
    numbers: npt.NDArray[np.intp]
    """Of the nodes at each crossing, ``(num_crossings, num_nodes0 + num_nodes1)``."""
    num: int
    """Number of variables: the nodes' and the parameters."""
    fans: Fans
    to_dofs: PETSc.Mat | None = None
    """Derivatives of all variables by both sides' dofs, all components, once they are asked for."""
    slopes: list[npt.NDArray[np.float64]] | None = None
    """Derivatives of cells' slips by their variables, likewise."""
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
            self._last = last = _place(self.sides, u, self._walls, last)
        return last

    @cached_property
    def _nodes_by_dofs(self) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """Rows, columns and values of the geometry's nodes' derivatives by dofs."""
        i, j, values = [], [], []
        offset, start = 0, 0
        for side in self.sides:
            facets = np.arange(len(side.at_facets))[:, None]
            node, dof = np.nonzero(side.nodes_by_dofs)
            i.append(offset + facets * len(side.nodes_by_dofs) + node)
            j.append(start + side.at_facets[:, dof])
            values.append(np.broadcast_to(side.nodes_by_dofs[node, dof], i[-1].shape))
            offset += len(facets) * len(side.nodes_by_dofs)
            start += len(side.dofs)
        rows, columns, entries = (
            np.concatenate([part.ravel() for part in parts]) for parts in (i, j, values)
        )
        component = np.arange(2)[:, None]
        every = (2 * rows + component).ravel(), (2 * columns + component).ravel()
        return *every, np.tile(entries, 2)

    def _to_dofs(self, state: _State) -> PETSc.Mat:
        """Derivatives of all variables by both sides' dofs, all components."""
        if state.to_dofs is not None:
            return state.to_dofs
        first = state.crossings.first.reshape(len(state.numbers), -1, 2)
        by = np.split(first, [len(self.sides[0].nodes_by_dofs)], axis=1)
        facets = state.fans.crossings.facets.T
        i, j, values = ([part] for part in self._nodes_by_dofs)
        number, start = state.num - len(first) + np.arange(len(first)), 0
        for side, part, facet in zip(self.sides, by, facets, strict=True):
            dofs = 2 * (start + side.at_facets[facet])[..., None] + np.arange(2)
            i.append(np.broadcast_to(number[:, None, None], dofs.shape).ravel())
            j.append(dofs.ravel())
            values.append(np.einsum("kmi,ma->kai", part, side.nodes_by_dofs).ravel())
            start += len(side.dofs)
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
        if state.gap is not None:
            return state.gap
        vertices = np.concatenate([cells.vertices for cells in state.cells])
        g, m = (
            np.bincount(vertices.ravel(), np.repeat(0.5 * part, 2), self.num_multipliers)
            for part in (
                np.concatenate([cells.gap.value for cells in state.cells]),
                np.concatenate([cells.m for cells in state.cells]),
            )
        )
        C = self._rows_by_dofs(state, [cells.gap.first for cells in state.cells])
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
            first = pressure[:, None] * cells.gap.first[on]
            slope += np.bincount(numbers.ravel(), first.ravel(), state.num)
        if len(state.numbers):
            nodes = (2 * state.numbers[..., None] + np.arange(2)).reshape(len(state.numbers), -1)
            moves = slope[len(slope) - len(nodes) :]
            on = np.flatnonzero(moves)
            add(nodes[on], moves[on, None, None] * state.crossings.second[on])
        return self._by_dofs_twice(state, i, j, values)

    def slip(self, u: Displacements, lender: npt.NDArray[np.intp]) -> Sparse:
        """What the weighted slip of Γ1 on Γ0, along Γ0's edges from start to end, is made of.

        Args:
            u: Displacements.
            lender: Not asked for: all slips are along Γ0.

        Returns:
            T with s = T (u − u_since), of the size of C.
        """
        state = self._at(u)
        return self._rows_by_dofs(state, [self._slips(cells) for cells in state.cells])

    def slip_slopes(
        self,
        u: Displacements,
        since: Displacements,
        lender: npt.NDArray[np.intp],
        on: npt.NDArray[np.bool_],
    ) -> Sparse:
        """∂s/∂u, of the size of C.

        Args:
            u: Displacements.
            since: Those from which slip is counted.
            lender: Not asked for.
            on: Not asked for: all rows are there.
        """
        state = self._at(u)
        moves = [a - b for a, b in zip(u, since, strict=True)]
        nodes = np.concatenate([self._at_nodes(i, part).ravel() for i, part in enumerate(moves)])
        S = [
            self._slips(cells) + np.einsum("cij,ci->cj", slopes, nodes[cells.numbers[:, :-3]])
            for cells, slopes in zip(state.cells, self._slopes(state), strict=True)
        ]
        return self._rows_by_dofs(state, S)

    @staticmethod
    def _slips(cells: _Cells) -> npt.NDArray[np.float64]:
        """What cells make of motions of their variables; those of parameters count for nothing."""
        return np.pad(slip_fans.slips(*cells.places), ((0, 0), (0, 3)))

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

    def _rows_by_dofs(self, state: _State, values: Sequence[npt.NDArray[np.float64]]) -> Sparse:
        """Cells' derivatives, of which both vertices have one half, as rows by the dofs."""
        i, j, entries = [], [], []
        for cells, part in zip(state.cells, values, strict=True):
            shape = len(part), 2, part.shape[1]
            i.append(np.broadcast_to(cells.vertices[:, :, None], shape).ravel())
            j.append(np.broadcast_to(cells.numbers[:, None], shape).ravel())
            entries.append(np.broadcast_to(0.5 * part[:, None], shape).ravel())
        parts = (np.concatenate(part) for part in (i, j, entries))
        C = coo_matrix(MPI.COMM_SELF, (self.num_multipliers, state.num), *parts)
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

    def _slopes(self, state: _State) -> list[npt.NDArray[np.float64]]:
        if state.slopes is None:
            state.slopes = [slip_fans.slopes(*cells.places) for cells in state.cells]
        return state.slopes

    def _at_nodes(self, i: int, u) -> npt.NDArray[np.float64]:
        """Displacements of a side's dofs at its facets' nodes, ``(num_nodes, 2)``."""
        side = self.sides[i]
        return (side.nodes_by_dofs @ u[side.at_facets]).reshape(-1, 2)

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
            for part, values in ((total, mean), (size, cells.m)):
                part += np.bincount(cells.vertices.ravel(), np.repeat(values, 2), len(part))
        return np.divide(total, size, out=np.zeros_like(total), where=size > 0)

    def cells(self, u: Displacements, p: npt.NDArray[np.float64]) -> OpenCells:
        """The cells where the bodies are, to look at.

        Args:
            u: Displacements.
            p: Pressures, ``(num_multipliers,)``, or tractions, ``(num_multipliers, 2)``.
        """
        state = self._at(u)
        every, side, base = state.cells, state.fans.side, state.fans.base
        rank = np.empty(len(base), dtype=np.int32)
        for i, moving in enumerate(self.sides):
            rank[side == i] = moving.reference.owner[base[side == i]]
        m, volume = (np.concatenate(part) for part in zip(*((c.m, c.gap.value) for c in every)))
        return OpenCells(
            x=np.concatenate([cells.x for cells in every]),
            rank=np.concatenate([rank[cells.which] for cells in every]),
            gap=np.divide(volume, m, out=np.zeros_like(m), where=m > 0),
            pressure=np.concatenate([p[cells.vertices].mean(axis=1) for cells in every]),
        )


def _place(sides: Sides, u: Displacements, walls: list[_Wall], last: _State | None) -> _State:
    """Find Σ at displacements, and its derivatives; where it was last has a say.

    Raises:
        InterfaceError: There is none.
    """
    surfaces = displaced(sides, u)
    at_walls = [wall.ends for wall in walls if wall.is_between(surfaces)]
    found = cast(*surfaces, last.fans if last else None, at_walls)
    if not len(found.base):
        mesh_strip(*surfaces)  # says why
        raise NotFacingError("Γ0 and Γ1 don't face each other: no normal of Γ1 meets Γ0.")
    elements = surfaces[0].geometry, surfaces[1].geometry
    nodes = np.concatenate([surface.nodes.reshape(-1, 2) for surface in surfaces])
    offsets = np.array((0, surfaces[0].nodes[..., 0].size))

    def numbers(side, facets, element):
        """Numbers of the nodes of facets, each on its side, of one element."""
        return (offsets[side] + facets * element.dim)[..., None] + np.arange(element.dim)

    facets, unknown = found.crossings.facets, found.crossings.unknown
    each, s = np.arange(len(unknown)), np.empty((len(unknown), 2))
    s[each, unknown], s[each, 1 - unknown] = found.crossings.guess, found.crossings.given
    at0, at1 = (numbers(i, facets[:, i], elements[i]) for i in (0, 1))
    crossings = fans.Crossings(elements, nodes[at0], nodes[at1], unknown, s)
    at = np.concatenate((POSITIONS, crossings.value))
    cells = []
    alike = elements[0] == elements[1]
    for i, mine in enumerate([found.side >= 0] if alike else [found.side == i for i in (0, 1)]):
        side, parameters = found.side[mine], found.parameters[mine]
        base = numbers(side, found.base[mine], elements[i])
        apex = numbers(1 - side, found.apex[mine], elements[1 - i])
        places = (elements[i], elements[1 - i]), nodes[base], nodes[apex], at[parameters]
        gap = fans.Volumes(*places)
        variables = 2 * np.hstack((base, apex))[..., None] + np.arange(2)
        variables = np.hstack((variables.reshape(len(base), -1), 2 * len(nodes) + parameters))
        m = 0.5 * lengths(gap.chord)
        cells.append(_Cells(variables, gap, m, found.vertices[mine], mine, places))
    copy = u[0].copy(), u[1].copy()
    num = 2 * len(nodes) + len(at)
    return _State(copy, cells, crossings, np.hstack((at0, at1)), num, found)
