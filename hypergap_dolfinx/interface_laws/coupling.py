# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Couplings of a surface with a reference point: rigid (RBE2) or distributing (RBE3)."""

from collections.abc import Sequence
from typing import ClassVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx.mesh
import ufl
from dolfinx import default_scalar_type, fem, la
from hypergap_dolfinx.core.collective import raise_on_all, spot
from hypergap_dolfinx.core.sparse import coo_matrix
from hypergap_dolfinx.interface_laws.reference_point import ReferencePoint, in_space
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.tolerances import FILE_DIGITS
from hypergap_dolfinx.surface.trace import check_sides, create_surface

Array = npt.NDArray[np.float64]


class Coupling(ReferencePoint):
    """A surface coupled with a point, which forces and torques load or which is held.

    The point has a displacement and a rotation: x, y and rotation in the plane, x, y, z, rx, ry, rz
    in space, each free, held, or in a spring. Rotations are small: the motion of the surface is
    v = t + θ × (x − X₀), with the point X₀ anywhere. :class:`TiedProblem` and
    :class:`NonlinearTiedProblem` take couplings.

    - ``"distributing"``: t and θ are the surface's mean motion, ``∫ |u − v|² dΓ`` is least. Forces
      and torques act as tractions that vary linearly over the surface, as in a beam's section, and
      don't stiffen it.
    - ``"rigid"``: the surface moves as a rigid body, u = v at its nodes.

    Balance of forces and torques is exact. ``force`` and ``torque`` are fixed in space; arrays may
    be changed between solves.

    Example:
        A bar whose end is twisted by a torque, or by an angle::

            end = Coupling((V, facets), point=(0, 0, 4), kind="distributing")
            problem = TiedProblem([a], [L], bcs=bcs, couplings=[end])
            end.torque = 0, 0, 5.0
            problem.solve()
            print(end.displacement, end.angles)

            end = Coupling((V, facets), point=(0, 0, 4), kind="rigid", held="rz")
            ...
            end.prescribed[5] = 0.01
            problem.solve()
            print(end.reaction[5])
    """

    NAME: ClassVar[str] = "a coupling"

    def __init__(
        self,
        side: tuple[fem.FunctionSpace, npt.ArrayLike],
        *,
        point: npt.ArrayLike,
        kind: str,
        held: Sequence[str] | str = (),
    ):
        """Find the surface's nodes and its mean motion. Collective.

        Args:
            side: A pair ``(V, facets)`` as for a :class:`Tie`: a Lagrange space of displacements,
                or one such as ``W.sub(0)``, and exterior facets of its mesh.
            point: The reference point X₀.
            kind: ``"distributing"`` or ``"rigid"``.
            held: Names of the components that are held, of :attr:`components`, at the values in
                :attr:`prescribed`.

        Raises:
            InterfaceError: Facets or a space that form no surface.
            ValueError: No displacements, another kind, a point or a name that is none.
        """
        if kind not in ("distributing", "rigid"):
            raise ValueError(f'kind is {kind!r}: give "distributing" or "rigid".')
        check_sides("coupling", side)
        V = side[0]
        n = V.mesh.geometry.dim
        if V.value_shape != (n,):
            raise ValueError(
                f"a coupling moves displacements, with {n} components; the value shape of its "
                f"space is {V.value_shape}."
            )
        super().__init__(V.mesh.comm, n, point, held)
        self.kind = kind
        """"distributing" or "rigid"."""
        self.component = Component.of(V)
        """Dofs of the displacements among those of the body."""
        V = self.component.space
        self.surface = create_surface(V, side[1], "the surface of a coupling")
        """The surface."""
        start, end = V.dofmap.index_map.local_range
        dofs = np.unique(self.surface.dofs)
        self._nodes = dofs[(start <= dofs) & (dofs < end)] - start  # owned ones
        self._x = V.tabulate_dof_coordinates()[self._nodes, :n]
        self._arms = in_space(self._x - self._point)
        sums = self._comm.allreduce(np.array([(self._arms**2).sum(), len(self._arms)]))
        self._make_unknowns(float(np.sqrt(sums[0] / sums[1])))
        self._means = self._weights(side[1]) if kind == "distributing" else None

    @property
    def is_rigid(self) -> bool:
        """True if the surface moves as a rigid body."""
        return self.kind == "rigid"

    def _slopes(self) -> Array:
        """Displacements of the owned nodes by the unknowns, ``(num_nodes, n, num_components)``."""
        n = self._n
        found = np.zeros((len(self._arms), n, len(self.components)))
        found[:, range(n), range(n)] = 1.0
        turned = np.stack([np.cross(axis, self._arms) for axis in np.eye(3)], axis=2)
        found[:, :, n:] = turned[:, :n, self._rotates] / self._length
        return found

    def _weights(self, facets: npt.ArrayLike) -> Array:
        """W in q = W u of the owned nodes, ``(num_components, num_nodes, n)``. Collective."""
        V, n, num = self.component.space, self._n, len(self.components)
        mesh, v = V.mesh, ufl.TestFunction(V)
        mark = la.vector(mesh.topology.index_map(n - 1))  # any rank may have been given a facet
        mark.array[np.asarray(facets, dtype=np.int32)] = 1.0
        mark.scatter_reverse(la.InsertMode.add)
        mark.scatter_forward()
        some = np.flatnonzero(mark.array).astype(np.int32)
        tags = dolfinx.mesh.meshtags(mesh, n - 1, some, np.ones_like(some))
        t, axis, point = (
            fem.Constant(mesh, np.zeros(size, dtype=default_scalar_type))
            for size in (n, num - n, n)
        )
        point.value[:] = self._point
        x = ufl.SpatialCoordinate(mesh) - point
        turned = ufl.cross(axis, x) if n == 3 else axis[0] * ufl.as_vector((-x[1], x[0]))
        ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
        form = fem.form(ufl.inner(t + turned / self._length, v) * ds, default_scalar_type)
        loads = []
        for k in range(num):
            t.value[:], axis.value[:] = np.split(np.eye(num)[k], [n])
            b = fem.assemble_vector(form)
            b.scatter_reverse(la.InsertMode.add)
            loads.append(b.array.reshape(-1, n)[self._nodes])
        whole = np.stack(loads)
        # Not ∫ v · v dΓ: with this, motions v of the nodes have means of exactly q = 1
        M = self._comm.allreduce(np.einsum("kai,ail->kl", whole, self._slopes()))
        return np.linalg.solve(M, whole.reshape(num, -1)).reshape(whole.shape)

    def blocks(self, prescribed: npt.NDArray[np.bool_]) -> tuple[PETSc.Mat, PETSc.Mat]:
        """B on the body's dofs and on the unknowns: mean motions, or nodes', less v. Collective.

        Args:
            prescribed: Mask of the field's owned dofs (unrolled) that are prescribed.

        Raises:
            ValueError: A rigid surface is prescribed where its point is free.
        """
        n, num, comm = self._n, len(self.components), self._comm
        V = self.component.space
        dofs = (V.dofmap.index_map.local_range[0] + self._nodes)[:, None] * n + np.arange(n)
        kept = ~prescribed.reshape(-1, n)[self._nodes]
        nothing = not comm.allreduce(int(kept.sum()))
        message = "all displacements of a coupling's surface are prescribed: leave it out."
        raise_on_all(comm, message if nothing else None, ValueError)
        columns, own = V.dofmap.index_map.size_local * n, num if comm.rank == 0 else 0
        if self._means is not None:
            rows, one = own, np.arange(own)
            i, j, values = np.indices(self._means.shape)[0], dofs, self._means
            of_point = one, one, -np.ones(own)
        else:
            slopes = self._slopes()
            self._check_prescribed_nodes(slopes, kept)
            rows = int(kept.sum())
            i = sum(comm.allgather(rows)[: comm.rank]) + np.arange(rows)
            j, values = dofs[kept], np.ones(rows)
            of_point = np.repeat(i, num), np.tile(np.arange(num), rows), -slopes[kept].ravel()
        of_surface = [np.ravel(part) for part in np.broadcast_arrays(i, j, values)]
        B = coo_matrix(comm, (rows, columns), *of_surface)
        return self.component.columns_of_body(B), coo_matrix(comm, (rows, own), *of_point)

    def _check_prescribed_nodes(self, slopes: Array, kept: npt.NDArray[np.bool_]):
        """Raise if prescribed displacements of a rigid surface depend on free unknowns."""
        moves = np.abs(slopes) > FILE_DIGITS
        loose = (moves & ~self.held).any(axis=2) & ~kept
        message = None
        if loose.any():
            a, i = (int(k[0]) for k in np.nonzero(loose))
            names = [name for name, by in zip(self.components, moves[a, i] & ~self.held) if by]
            message = (
                f"a boundary condition prescribes {'xyz'[i]} of a rigid coupling's surface at "
                f"{spot(self._x[a : a + 1])}, where its {' and '.join(names)} "
                f"{'are' if len(names) > 1 else 'is'} free: take the facets out of one of them, or "
                f"name these in held=."
            )
        raise_on_all(self._comm, message, ValueError)

    def contradiction(self, values: npt.NDArray, prescribed: npt.NDArray[np.bool_]) -> str | None:
        """Message if prescribed displacements aren't those of what is held, or None. Collective.

        Args:
            values: Prescribed values of the field's owned dofs; others don't matter.
            prescribed: Mask of those.
        """
        if not self.is_rigid:
            return None
        n = self._n
        both = prescribed.reshape(-1, n)[self._nodes]
        given = np.where(both, values.reshape(-1, n)[self._nodes], 0.0)
        q = np.where(self.held, self._prescribed / self._units, 0.0)
        carried = np.where(both, self._slopes() @ q, 0.0)
        size = max(self._comm.allreduce(np.abs(given).max(initial=0), MPI.MAX), np.abs(q).max())
        wrong = np.abs(given - carried) > FILE_DIGITS * size
        at = None
        if wrong.any():
            a = int(wrong.any(axis=1).argmax())
            at = (
                f"the prescribed displacements at {spot(self._x[a : a + 1])}, {given[a]}, aren't "
                f"those of the rigid coupling there, {carried[a]}; prescribe the same."
            )
        return next((one for one in self._comm.allgather(at) if one), None)

    def take(self, force: npt.NDArray):
        """Take the solution of its unknowns, and find reactions. Collective.

        Args:
            force: Forces of the surface on this rank's unknowns.
        """
        self._values = self.shared(self.q.x.array)
        values = np.append(self.displacement, self.angles)
        loads = np.append(self._force, self._torque) + self._springs * (self._anchors - values)
        loads += self.shared(np.asarray(force, dtype=np.float64)) / self._units
        self._reaction = np.where(self.held, -loads, 0.0)

    def resume(self, reaction: npt.NDArray):
        """Go on from a reaction, with unknowns that are set already. Collective."""
        self._values, self._reaction = self.shared(self.q.x.array), np.array(reaction)

    def turns(self) -> str | None:
        """Message if the point can turn, which is linear here, or None."""
        n = self._n
        names = [name for name, fixed in zip(self.components[n:], self.held[n:]) if not fixed]
        if names:
            return (
                f"its {' and '.join(names)} can turn, and couplings are linear in rotations: in "
                "nonlinear problems hold these by held=."
            )
        if self._prescribed[n:].any():
            return (
                f"its rotation is prescribed as {self._prescribed[n:]}, and couplings are linear "
                "in rotations: in nonlinear problems leave it 0."
            )
        return None


def check_couplings(couplings: Sequence[Coupling]):
    """Raise if they are no couplings, or two rigid ones have nodes in common.

    Raises:
        ValueError: Names them.
    """
    for k, one in enumerate(couplings):
        if not isinstance(one, Coupling):
            raise ValueError(
                f"couplings has a {type(one).__name__}: make each with Coupling(side, point=, "
                "kind=)."
            )
        for j, other in enumerate(couplings[:k]):
            if one is other:
                raise ValueError(f"coupling {k} is given twice; once is enough.")
            if not (one.is_rigid and other.is_rigid and one.component.overlaps(other.component)):
                continue
            shared = np.intersect1d(one.surface.dofs, other.surface.dofs)
            if len(shared):
                raise ValueError(
                    f"the rigid couplings {j} and {k} have {len(shared)} nodes in common: give "
                    "all facets to one of them."
                )


def check_turns(couplings: Sequence[Coupling]):
    """Raise if a coupling of a nonlinear problem can turn.

    Raises:
        ValueError: Names it.
    """
    for k, one in enumerate(couplings):
        wrong = one.turns()
        if wrong:
            raise ValueError(f"coupling {k}: {wrong}")
