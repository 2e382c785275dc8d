# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Couplings of a surface with a reference point: rigid (RBE2) or distributing (RBE3)."""

from collections.abc import Sequence
from typing import ClassVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx.mesh
import ufl
from dolfinx import default_scalar_type, fem, la
from hypergap_dolfinx.core.collective import raise_on_all, spot
from hypergap_dolfinx.interface_laws.reference_point import PointMotion, ReferencePoint, in_space
from hypergap_dolfinx.interface_laws.tolerances import FAR_POINT
from hypergap_dolfinx.surface.component import Component
from hypergap_dolfinx.surface.tolerances import FILE_DIGITS
from hypergap_dolfinx.surface.trace import as_facets, check_sides, create_surface

Array = npt.NDArray[np.float64]


Side = tuple[fem.FunctionSpace, npt.ArrayLike]


class CoupledMotion(PointMotion):
    """Motion of a surface's nodes with a reference point, or of the point with the surface."""

    NAME: ClassVar[str] = "a coupling"

    def __init__(
        self,
        side: Side | Sequence[Side],
        point: npt.ArrayLike,
        kind: str,
        held: Sequence[str] | str,
    ):
        """Find the nodes, as for :class:`Coupling`. Collective."""
        if kind not in ("distributing", "rigid"):
            raise ValueError(f'kind is {kind!r}: give "distributing" or "rigid".')
        V, facets = _joined(side)
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
        self.surface = create_surface(V, facets, "the surface of a coupling")
        """The surface."""
        start, end = V.dofmap.index_map.local_range
        dofs = np.unique(self.surface.dofs)
        self._nodes = dofs[(start <= dofs) & (dofs < end)] - start  # owned ones
        self._x = V.tabulate_dof_coordinates()[self._nodes, :n]
        self._arms = in_space(self._x - self.point)
        sums = np.array([(self._arms**2).sum(), *self._arms.sum(axis=0), len(self._arms)])
        *sums, num = self._comm.allreduce(sums)
        square, centre = sums[0] / num, np.array(sums[1:]) / num
        self._make_unknowns(float(np.sqrt(square)))
        if square - centre @ centre < square / FAR_POINT**2:
            at = spot(self.point[None] + centre[:n])
            raise ValueError(
                f"the point of a coupling, {spot(self.point[None])}, is farther from its surface, "
                f"at {at}, than {FAR_POINT:.0e} times the root mean square radius of this: give "
                f"one nearer, and the torque about that."
            )
        if not self.is_rigid:
            self._weigh(facets)

    @property
    def is_rigid(self) -> bool:
        """True if the surface moves as a rigid body."""
        return self.kind == "rigid"

    @property
    def own_arms(self) -> Array:
        """X − X₀ of this rank's owned nodes of the surface, ``(num_nodes, 3)``."""
        return self._arms

    def _weigh(self, facets: npt.ArrayLike):
        """Integrals of the shape functions φ of the owned nodes. Collective."""
        V, n = self.component.space, self._n
        mesh, v = V.mesh, ufl.TestFunction(V)
        mark = la.vector(mesh.topology.index_map(n - 1))  # any rank may have been given a facet
        mark.array[np.asarray(facets, dtype=np.int32)] = 1.0
        mark.scatter_reverse(la.InsertMode.add)
        mark.scatter_forward()
        some = np.flatnonzero(mark.array).astype(np.int32)
        tags = dolfinx.mesh.meshtags(mesh, n - 1, some, np.ones_like(some))
        f = fem.Function(V)
        ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
        form, found = fem.form(ufl.inner(f, v) * ds, default_scalar_type), []
        # Not X itself, on curved facets: with its nodes' values motions v of nodes are exact
        for values in (np.ones(n), V.tabulate_dof_coordinates()[:, :n] - self.point):
            f.x.array.reshape(-1, n)[:] = values
            b = fem.assemble_vector(form)
            b.scatter_reverse(la.InsertMode.add)
            found.append(b.array.reshape(-1, n)[self._nodes].real)
        self.weights: Array = found[0][:, 0]
        """∫ φ dΓ, ``(num_nodes,)``."""
        self.arm_weights: Array = in_space(found[1])
        """∫ φ (X − X₀) dΓ, ``(num_nodes, 3)``."""

    def bend(self, bends: Array):
        """Set what its equations add to the derivative of its residual, of free components."""
        self._bends = bends * np.outer(~self.held, ~self.held)
        self.read()

    def check_prescribed_nodes(self, kept: npt.NDArray[np.bool_]):
        """Raise if prescribed displacements of a rigid surface depend on free unknowns. Collective.

        Args:
            kept: Mask of the nodes' displacements that aren't prescribed, ``(num_nodes, n)``.
        """
        n, at, free = self._n, self._rotates, ~self.held
        second = self._turned(self._arms, None)[2][:, :n]
        moves = np.abs(self.slopes(self._arms, None)) > FILE_DIGITS
        # By rotations of any size about the free axes
        bent = (np.abs(second[:, :, at, at]) > FILE_DIGITS * self.length)[..., free[n:]]
        moves[:, :, n:] |= bent.any(axis=3)
        loose = (moves & free).any(axis=2) & ~kept
        message = None
        if loose.any():
            a, i = (int(k[0]) for k in np.nonzero(loose))
            names = [name for name, by in zip(self.components, moves[a, i] & free) if by]
            message = (
                f"a boundary condition prescribes {'xyz'[i]} of a rigid coupling's surface at "
                f"{spot(self._x[a : a + 1])}, where its {' and '.join(names)} "
                f"{'are' if len(names) > 1 else 'is'} free: take the facets out of one of them, or "
                f"name these in held=."
            )
        raise_on_all(self._comm, message, ValueError)

    def contradiction(
        self, values: npt.NDArray, prescribed: npt.NDArray[np.bool_], *, linear: bool
    ) -> str | None:
        """Message if prescribed displacements aren't those of what is held, or None. Collective.

        Args:
            values: Prescribed values of the field's owned dofs; others don't matter.
            prescribed: Mask of those.
            linear: True for small rotations.
        """
        if not self.is_rigid:
            return None
        n = self._n
        both = prescribed.reshape(-1, n)[self._nodes]
        given = np.where(both, values.reshape(-1, n)[self._nodes], 0.0)
        q = np.where(self.held, self.prescribed / self._units, 0.0 if linear else self._values)
        moved = self.slopes(self._arms, None) @ q if linear else self.moved(self._arms, q)
        carried = np.where(both, moved, 0.0)
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


class Coupling(ReferencePoint):
    """A surface coupled with a point, which forces and torques load or which is held.

    The point has a displacement and a rotation: x, y and rotation in the plane, x, y, z, rx, ry, rz
    in space, each free, held, or in a spring. The motion that goes with it is
    v = t + (R − 1) (X − X₀), with the point X₀ anywhere, and a rotation R of any size in
    :class:`NonlinearTiedProblem` and :class:`ContactProblem`, where it is made of those of load
    steps as a :class:`RigidBody`'s. In a :class:`TiedProblem` v = t + θ × (X − X₀).

    - ``"distributing"``: t and R are the surface's mean motion, ``∫ |u − v|² dΓ`` is least. Forces
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

    def __init__(
        self,
        side: Side | Sequence[Side],
        *,
        point: npt.ArrayLike,
        kind: str,
        held: Sequence[str] | str = (),
    ):
        """Find the surface's nodes and its mean motion. Collective.

        Args:
            side: A pair ``(V, facets)`` as for a :class:`Tie`: a Lagrange space of displacements,
                or one such as ``W.sub(0)``, and exterior facets of its mesh. Or a list of these, on
                one mesh, whose surfaces are coupled as one.
            point: The reference point X₀.
            kind: ``"distributing"`` or ``"rigid"``.
            held: Names of the components that are held, of :attr:`components`, at the values in
                :attr:`prescribed`.

        Raises:
            InterfaceError: Facets or a space that form no surface.
            ValueError: No displacements, surfaces on several meshes, another kind, a point or a
                name that is none; a point too far from the surface.
        """
        super().__init__(CoupledMotion(side, point, kind, held))
        self.kind = kind
        """"distributing" or "rigid"."""
        self._made = True


def _joined(side: Side | Sequence[Side]) -> Side:
    """A space and all facets of one side or several.

    Raises:
        ValueError: Something else, none, or several spaces.
    """
    if isinstance(side, Sequence) and not side:
        raise ValueError("a coupling needs a surface: give a pair (V, facets), or a list of pairs.")
    several = isinstance(side, Sequence) and side and all(isinstance(s, Sequence) for s in side)
    sides: list = list(side) if several else [side]
    check_sides("coupling", *sides)
    if len(sides) == 1:
        return sides[0]
    parts = [Component.of(V) for V, _ in sides]
    if not all(part.same(parts[0]) for part in parts):
        if all(V.mesh is sides[0][0].mesh for V, _ in sides):
            raise ValueError(
                "the surfaces of a coupling are on several function spaces of one mesh: give all "
                "of them with the same space, that of the body's form."
            )
        raise ValueError(
            "the surfaces of a coupling are on several meshes: put these bodies into one, whose "
            "parts needn't be connected, or couple one body and tie the others to it."
        )
    some = [as_facets(facets) for _, facets in sides]
    strange = [facets for facets in some if facets.ndim != 1]  # told by create_surface
    return sides[0][0], strange[0] if strange else np.concatenate(some)


def motions_of(couplings: Coupling | Sequence[Coupling]) -> list[CoupledMotion]:
    """Motions of couplings that fit to each other.

    Raises:
        ValueError: They are no couplings, or two rigid ones have nodes in common.
    """
    couplings = [couplings] if isinstance(couplings, Coupling) else list(couplings)
    for one in couplings:
        if not isinstance(one, Coupling):
            raise ValueError(
                f"couplings has a {type(one).__name__}: make each with Coupling(side, point=, "
                "kind=)."
            )
    found = [one.motion for one in couplings]
    for k, one in enumerate(found):
        for j, other in enumerate(found[:k]):
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
    return found
