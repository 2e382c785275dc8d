# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A component of a body's mixed space as a Lagrange space of its own.

Geometry, multipliers and most of the solvers work on that space, with its own numbering of dofs;
this module maps it to the body's.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.core.sparse import coo_matrix
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.surface.trace import is_mixed, lagrange_element


@dataclass(frozen=True)
class Component:
    """Space of one side of a tie, whole or a component such as ``W.sub(0)``."""

    remedy: ClassVar[str] = "boundary conditions"
    """How users hold it, in messages."""
    given: fem.FunctionSpace
    """The space as given by the user."""
    space: fem.FunctionSpace
    """``given`` itself, or its collapsed space; DOLFINx numbers the dofs alike each time."""
    dofs: npt.NDArray[np.int32] | None
    """Owned dofs of the space in the body's (unrolled), ``(num_dofs,)``; None if the same."""

    @classmethod
    def of(cls, V: fem.FunctionSpace) -> "Component":
        """The component for a space or a subspace. Collective.

        Raises:
            InterfaceError: DOLFINx collapses the subspace wrongly.
        """
        if not V.component():
            return cls(V, V, None)
        space, dofs = V.collapse()
        kept = np.array_equal(np.ravel(dofs)[unrolled(space)], unrolled(V))
        if not space.mesh.comm.allreduce(kept, MPI.LAND):
            raise InterfaceError(
                "DOLFINx mixes up the nodes of this component of a mixed space when it collapses "
                "it, as on tetrahedra of degree 3 and more; make a tie for each of its own "
                "components (W.sub(0).sub(1) for example), or take degree 2, or hexahedra."
            )
        owned = space.dofmap.index_map.size_local * space.dofmap.index_map_bs
        return cls(V, space, np.ravel(dofs)[:owned].astype(np.int32))

    def same(self, other: "Component") -> bool:
        """True if another component has the same dofs of the same body."""
        return self.given.contains(other.given) and other.given.contains(self.given)

    def overlaps(self, other: "Component") -> bool:
        """True if one component contains the other."""
        return self.given.contains(other.given) or other.given.contains(self.given)

    def among(self, spaces: Iterable[fem.FunctionSpace]) -> int | None:
        """Index of the body's space that contains it, or None."""
        return next((i for i, V in enumerate(spaces) if V.contains(self.given)), None)

    @property
    def of_vector(self) -> bool:
        """True for a single component of a vector."""
        of_blocks = self.given.dofmap.index_map_bs > self.space.dofmap.index_map_bs
        return of_blocks or (len(self.given.component()) > 1 and self.given.value_shape == ())

    def of_body(self, values: npt.NDArray) -> npt.NDArray:
        """Values of the field, taken from a body's owned ones, ``(num_dofs_of_body, ...)``."""
        return values if self.dofs is None else values[self.dofs]

    def into_body(self, values: npt.NDArray) -> npt.NDArray:
        """A body's owned values from the field's, ``(num_dofs, ...)``, with 0 for other fields."""
        if self.dofs is None:
            return values
        index_map, block_size = self.given.dofmap.index_map, self.given.dofmap.index_map_bs
        result = np.zeros((index_map.size_local * block_size, *values.shape[1:]), values.dtype)
        result[self.dofs] = values
        return result

    def nodes(self, values: npt.NDArray) -> npt.NDArray:
        """Positions of this rank's owned nodes, displaced by a body's owned values.

        Args:
            values: ``(num_dofs_of_body,)``.

        Returns:
            ``(num_nodes, n)``.
        """
        V = self.space
        num, n = V.dofmap.index_map.size_local, V.mesh.geometry.dim
        return V.tabulate_dof_coordinates()[:num, :n] + self.at_nodes(values)

    def at_nodes(self, values: npt.NDArray) -> npt.NDArray:
        """A body's owned values at this rank's owned nodes, ``(num_nodes, n)``."""
        return self.of_body(values).reshape(-1, self.space.mesh.geometry.dim)

    def own_function(self, u: fem.Function) -> fem.Function | None:
        """The field of a function, on its own space. Collective.

        Args:
            u: Function on this space, or on one that contains it: the whole, or ``u.sub(0)``.

        Returns:
            The function itself if it is on this space; None if it doesn't contain the field.
        """
        V = u.function_space
        if V == self.space or (
            self.dofs is not None  # collapsed by a user
            and V.mesh is self.space.mesh
            and V.ufl_element() == self.space.ufl_element()
            and not V.component()
            and self._numbered_as(V)
        ):
            return u
        if not V.contains(self.given):
            return None
        f = fem.Function(self.space, dtype=u.dtype, name=u.name)
        values = self.of_body(u.x.array)
        f.x.array[: len(values)] = values
        f.x.scatter_forward()
        return f

    def _numbered_as(self, V: fem.FunctionSpace) -> bool:
        """True if a space with the same element has the same dofs. Collective."""
        alike = np.array_equal(V.dofmap.list, self.space.dofmap.list)
        return self.space.mesh.comm.allreduce(alike, MPI.LAND)

    def global_dofs(self) -> npt.NDArray[np.int64]:
        """Global dofs (unrolled) of this rank's owned dofs in the body, ``(num_dofs,)``."""
        start, end = self.given.dofmap.index_map.local_range
        block_size = self.given.dofmap.index_map_bs
        return self.of_body(np.arange(start * block_size, end * block_size))

    def columns_of_body(self, B: PETSc.Mat) -> PETSc.Mat:
        """Matrix on the body's dofs from one on the field's, which is destroyed. Collective."""
        if self.dofs is None:
            return B
        dofmap, comm = self.given.dofmap, self.space.mesh.comm
        columns = dofmap.index_map.size_local * dofmap.index_map_bs
        start = B.getOwnershipRangeColumn()[0]
        rows = start + np.arange(len(self.dofs))
        sizes = len(self.dofs), columns
        P = coo_matrix(comm, sizes, rows, self.global_dofs(), np.ones(len(rows)))
        result = B.matMult(P)
        for matrix in (P, B):
            matrix.destroy()
        return result


def unrolled(V: fem.FunctionSpace) -> npt.NDArray[np.intp]:
    """Dofs of each cell, without blocks, ``(num_cells, num_cell_dofs)``."""
    dofs, block_size = V.dofmap.list, V.dofmap.bs
    unblocked = dofs[:, :, None].astype(np.intp) * block_size + np.arange(block_size)
    return unblocked.reshape(len(dofs), -1)


def lagrange_components(V: fem.FunctionSpace) -> list[Component]:
    """Fields of a body with known rigid motions: V, or the Lagrange components. Collective."""
    if not is_mixed(V):
        return [Component.of(V)]
    found = []
    for i in range(V.num_sub_spaces):
        try:
            component = Component.of(V.sub(i))
        except InterfaceError:
            continue  # no tie takes it either
        if is_mixed(component.space):
            found += lagrange_components(V.sub(i))
        elif lagrange_element(component.space)[1] is None:
            found.append(component)
    return found
