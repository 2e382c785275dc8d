# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checks of input that no solver would refuse: tangled cells, NaN, contradicting conditions.

Every check is collective and raises the same exception on every rank.
"""

import logging
from collections.abc import Sequence
from itertools import combinations
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from hypergap_dolfinx.algebra.tolerances import CONTRADICT, INVERTED_CORNER, NOTHING
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.core.collective import raise_on_all, spot
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.multipliers.interface import Interface
from hypergap_dolfinx.multipliers.tolerances import SAME_PLACE
from hypergap_dolfinx.surface.tolerances import NOISE, STRAIGHT
from hypergap_dolfinx.surface.trace import extents, lagrange_element

LOG = logging.getLogger("hypergap_dolfinx")
UNNAMED = "", "mesh"
"""Names of meshes that nobody named."""
_chunk = 100_000  # cells that are checked at a time, to bound the memory


def label(mesh: Mesh) -> str:
    """A mesh's name in messages, in brackets after a space; nothing if it has none."""
    return "" if mesh.name in UNNAMED else f" ({mesh.name})"


def name_of_body(i: int, V: fem.FunctionSpace) -> str:
    """A body's name in messages: its number, and its mesh's name if this has one."""
    return f"body {i}{label(V.mesh)}"


def name_of_tie(number: str, tie: Interface) -> str:
    """A tie's name in messages: its number, names of its bodies' meshes, and its facets."""
    names = [V.mesh.name for V in tie.spaces]
    bodies = "" if all(name in UNNAMED for name in names) else f"{' and '.join(names)}, "
    counts = " and ".join(str(len(surface.facets)) for surface in tie.surfaces)
    return f"{number} ({bodies}{counts} facets around {spot(tie.surfaces[1].nodes)})"


def check_cells(mesh: Mesh, name: str, facets: Sequence[npt.ArrayLike]):
    """Raise if a cell has no volume or is turned over somewhere. Collective.

    DOLFINx takes |det J|, so a cell may be mirrored as a whole, but not in part. Away from
    interfaces a cell may be turned over at its corners and edges, where no Gauss point is: coarse
    meshes of Gmsh have such curved cells. That is told in the log.

    Args:
        mesh: Mesh of a body.
        name: Its name in the message.
        facets: This rank's facets on each interface.

    Raises:
        ValueError: With the place of the first such cell.
    """
    on_interface = _cells_at(mesh, facets)
    turned: list[str] = []  # places of cells that are turned over at a corner
    num = 0
    n = mesh.geometry.dim
    cmap = compat.coordinate_element(mesh)
    cell_type = getattr(basix.CellType, mesh.topology.cell_name())
    element = compat.geometry_element(mesh, cell_type)
    cells = compat.geometry_dofmap(mesh)
    simplex = cell_type in (basix.CellType.triangle, basix.CellType.tetrahedron)
    if simplex:
        straight = _straight(mesh.geometry.x[:, :n], cells, element.points)
        middle, _ = basix.make_quadrature(cell_type, 1)
        lots = [(cells[straight], middle, middle[:0])]
        cells, on_interface = cells[~straight], on_interface[~straight]
        num -= int(straight.sum())
    else:
        lots = []
    # On simplices det J is a polynomial of this degree. It is evaluated in as many points as it has
    # coefficients: if it is negative anywhere, it mostly is in one of these too
    degree = n * (cmap.degree - 1) if simplex else 2 * cmap.degree
    inside, _ = basix.make_quadrature(cell_type, 2 * cmap.degree)
    lattice = basix.create_lattice(cell_type, max(degree, 1), basix.LatticeType.equispaced, True)
    lots.append((cells, inside, lattice))
    message = None
    for x, det, num_inside in (
        (*part, len(inside))
        for cells, inside, more in lots
        for part in _determinants(
            mesh.geometry.x[:, :n], _slopes(element, np.vstack((inside, more))), cells
        )
    ):
        size = extents(x) ** n
        sign = np.sign(det[:, :1])
        bad = ~(sign * det[:, :num_inside] > NOISE * size[:, None]).all(axis=1)
        # At a corner of 180° det J is zero, which is allowed; a corner beyond 180° is turned over
        over = ~bad & (sign * det < -INVERTED_CORNER * size[:, None]).any(axis=1)
        if over.any():  # none of the straight simplices, which come first
            over_here = on_interface[num : num + len(x)]
            bad |= over & over_here
            turned += [spot(nodes) for nodes in x[over & ~over_here]]
        num += len(x)
        # NaN and infinity in coordinates are left to checks that name the surface or body
        bad &= np.isfinite(det).all(axis=1)
        if bad.any():
            i = int(bad.argmax())
            message = (
                f"{name} has a cell without volume or turned over in part, at {spot(x[i])} "
                f"(det J from {det[i].min():.3g} to {det[i].max():.3g}); mend its mesh."
            )
            break
    raise_on_all(mesh.comm, message, ValueError)
    places = [place for part in mesh.comm.allgather(turned) for place in part]
    if places and mesh.comm.rank == 0:
        LOG.warning(
            "%s has %d cell%s turned over at a corner or an edge, away from interfaces, the first "
            "at %s: stresses beside it are wrong; mend its mesh.",
            *(name, len(places), "s"[: len(places) > 1], places[0]),
        )


def turned_over(u: fem.Function, known: dict[str, Any]) -> npt.NDArray[np.float64]:
    """Middles of this rank's cells that displacements turn over at a node, ``(num, n)``.

    There is no Gauss point in nodes: residuals are balanced even so. Places are those before
    displacements; cells that were turned over already aren't among them.

    Args:
        u: The displacements.
        known: What is found for the mesh before, empty at first.
    """
    V, mesh = u.function_space, u.function_space.mesh
    if not known or not np.array_equal(known["nodes"], mesh.geometry.x):  # users may move nodes
        n, num = mesh.geometry.dim, mesh.topology.index_map(mesh.topology.dim).size_local
        element, start = lagrange_element(V)[0], V.tabulate_dof_coordinates()[:, :n]
        points = element.points if element.dim > n + 1 else element.points[:1]  # det J is constant
        dpsi, cells = _slopes(element, points), V.dofmap.list[:num]
        signs = [np.sign(det).astype(np.int8) for _, det in _determinants(start, dpsi, cells)]
        known.update(nodes=mesh.geometry.x.copy(), given=(start, dpsi, cells), signs=signs)
    start, dpsi, cells = known["given"]
    after = _determinants(start + u.x.array.reshape(start.shape), dpsi, cells)
    over = [(s * det < 0).any(axis=1) for s, (_, det) in zip(known["signs"], after, strict=True)]
    return start[cells[np.concatenate([np.zeros(0, dtype=bool), *over])]].mean(axis=1)


def _cells_at(mesh: Mesh, facets: Sequence[npt.ArrayLike]) -> npt.NDArray[np.bool_]:
    """Mask of this rank's cells with one of some exterior facets, ``(num_cells,)``. Collective."""
    n = mesh.topology.dim
    mesh.topology.create_connectivity(n - 1, n)
    to_cells = mesh.topology.connectivity(n - 1, n)
    found = np.zeros(len(compat.geometry_dofmap(mesh)), dtype=bool)
    for some in facets:
        found[to_cells.array[to_cells.offsets[np.asarray(some, dtype=np.int32)]]] = True
    return found


def _straight(x, cells, points) -> npt.NDArray[np.bool_]:
    """Mask of simplices whose geometry nodes are those of straight edges, ``(num_cells,)``."""
    n = x.shape[1]
    straight = np.ones(len(cells), dtype=bool)
    if cells.shape[1] == n + 1:
        return straight
    weights = np.column_stack((1 - points.sum(axis=1), points))
    for start in range(0, len(cells), _chunk):
        nodes = x[cells[start : start + _chunk]]
        deviation = np.abs(weights @ nodes[:, : n + 1] - nodes).max(axis=(1, 2))
        bent = deviation > STRAIGHT * np.abs(nodes).max(axis=(1, 2))
        straight[start : start + _chunk] = ~bent
    return straight


def _slopes(element, points) -> npt.NDArray[np.float64]:
    """Derivatives of an element's functions at points, ``(point, axis, node)``."""
    return element.tabulate(1, points)[1:, :, :, 0].swapaxes(0, 1)


def _determinants(x, dpsi, cells):
    """Yield a chunk's nodes (cell, node, n) and det J (cell, point).

    Args:
        x: Geometry nodes, ``(num_nodes, n)``.
        dpsi: From :func:`_slopes`.
        cells: Nodes of each cell.
    """
    for start in range(0, len(cells), _chunk):
        nodes = x[cells[start : start + _chunk]]
        J = dpsi.reshape(-1, nodes.shape[1]) @ nodes
        J = J.reshape(len(nodes), *dpsi.shape[:2], -1)  # (cell, point, axis, component)
        with np.errstate(invalid="ignore"):  # NaN in coordinates are left to other checks
            det = _det(J)
        yield nodes, det


def _det(J: npt.NDArray) -> npt.NDArray:
    """Determinants ``(...,)`` of small matrices ``(..., n, n)``: LAPACK takes ten times as long."""
    n = J.shape[-1]
    if n < 3:
        return J[..., 0, 0] if n == 1 else J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
    a, b, c = np.moveaxis(J, (-2, -1), (0, 1))
    return sum(a[k] * (b[k - 2] * c[k - 1] - b[k - 1] * c[k - 2]) for k in range(3))


def check_finite(objects: Sequence[PETSc.Object], what: str, spaces: Sequence[fem.FunctionSpace]):
    """Raise if a body's matrix or vector has a NaN or an infinity. Collective.

    Args:
        objects: Matrices or vectors of the bodies.
        what: Their name in the message.
        spaces: The bodies' spaces.

    Raises:
        ValueError: Names the body.
    """
    for i, (obj, V) in enumerate(zip(objects, spaces, strict=True)):
        if not np.isfinite(obj.norm()):
            raise ValueError(
                f"{what} of {name_of_body(i, V)} has NaN or infinite entries; look at its "
                "coefficients, coordinates and prescribed displacements."
            )


def check_scalars(
    forms: Sequence[ufl.Form | None], functions: Sequence[fem.Function], bcs: Sequence = ()
):
    """Raise if an object is real and PETSc's scalars are complex, or the other way round.

    Args:
        forms: UFL forms of the bodies; None for no form.
        functions: Solutions of the bodies.
        bcs: Dirichlet conditions; other objects are ignored.

    Raises:
        ValueError: Names the object.
    """
    found: list[tuple[str, npt.DTypeLike]] = []
    for form in forms:
        for f in (*form.coefficients(), *form.constants()) if form is not None else ():
            if isinstance(f, fem.Function | fem.Constant):
                found.append((f"the {type(f).__name__} {f} of a form", f.dtype))
    found += [(f"the function of body {i}", u.dtype) for i, u in enumerate(functions)]
    for bc in bcs:
        if isinstance(bc, fem.DirichletBC):
            value = bc.g.value if hasattr(bc.g, "value") else bc.g.x.array
            found.append(("the value of a Dirichlet condition", value.dtype))
    for what, dtype in found:
        if dtype != PETSc.ScalarType:
            raise ValueError(
                f"{what} is of {np.dtype(dtype).name}, and PETSc's scalars here are "
                f"{np.dtype(PETSc.ScalarType).name}; make it with "
                "dtype=dolfinx.default_scalar_type."
            )


def check_apart(ties: Sequence[Interface]):
    """Raise if two ties tie the same field on the same facets to each other.

    Args:
        ties: The ties.

    Raises:
        InterfaceError: Names the ties.
    """
    known = [part for tie in ties for part in tie.components]
    sides = []
    for tie in ties:
        fields = [next(f for f, other in enumerate(known) if other.same(p)) for p in tie.components]
        sides.append(
            [
                {(field, row.tobytes()) for row in np.sort(surface.dofs, axis=1)}
                for surface, field in zip(tie.surfaces, fields, strict=True)
            ]
        )
    for t, s in combinations(range(len(ties)), 2):
        others = sides[s][0] | sides[s][1]
        if sides[t][0] & others and sides[t][1] & others:
            raise InterfaceError(
                f"{name_of_tie(f'ties {t} and {s}', ties[t])} tie the same facets to each other; "
                "once is enough."
            )


class Coincidences:
    """Nodes of Γ0 and Γ1 at the same place, where both sides may be prescribed."""

    def __init__(self, tie: Interface):
        """Find the coincident nodes, the same on every rank."""
        x, dofs = [], []
        for surface in tie.domain.surfaces:
            unique, first = np.unique(surface.dofs, return_index=True)
            facet, local = np.divmod(first, surface.dofs.shape[1])
            x.append(surface.points(facet, surface.element.points[local]))
            dofs.append(unique)
        h = min(surface.size.min() for surface in tie.surfaces)
        cell = SAME_PLACE * h + NOISE * np.abs(x[0]).max()
        keys = [np.rint((p - x[0].min(axis=0)) / cell).astype(np.int64) for p in x]
        _, at = np.unique(np.vstack(keys), axis=0, return_inverse=True)
        at0, at1 = np.split(at.ravel(), [len(x[0])])
        _, i, j = np.intersect1d(at0, at1, return_indices=True)
        self.dofs = dofs[0][i], dofs[1][j]
        """Global dofs (blocks) of both sides, ``(num_pairs,)`` each."""
        self.x: npt.NDArray[np.float64] = x[0][i]
        """Their positions, ``(num_pairs, n)``."""
        self.extent = float(np.ptp(x[0], axis=0).max())
        """Size of Γ0."""
        self.lengths = tie.spaces[0].value_shape == (tie.surfaces[0].gdim,)
        """True if the values are displacements."""

    def check(self, name: str, both, values, size: float, jump=None):
        """Raise if both sides are prescribed, and differently.

        Args:
            name: Name of the tie in the message.
            both: Mask of components that are prescribed on both, ``(num_pairs, block_size)``.
            values: The prescribed values.
            size: Largest displacement that is prescribed anywhere on either body.
            jump: Prescribed u₁ − u₀, as the values; zero if not given.

        Raises:
            InterfaceError: With the place and the values.
        """
        noise = NOTHING * self.extent if self.lengths else 0.0
        difference = values[1] - values[0] - (0 if jump is None else jump)
        wrong = both & (np.abs(difference) > CONTRADICT * size + noise)
        if wrong.any():
            i = int(wrong.any(axis=1).argmax())
            raise InterfaceError(
                f"the prescribed displacements contradict {name} at {spot(self.x[i])}: "
                f"{values[0][i]} on Γ0, {values[1][i]} on Γ1"
                + (
                    "; prescribe the same on both, or on one side only."
                    if jump is None
                    else f", with a jump of {jump[i]}; prescribe one side only."
                )
            )
