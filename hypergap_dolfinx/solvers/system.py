# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The saddle-point system of tied bodies, shared by linear and nonlinear problems."""

import logging
from collections.abc import Hashable, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from dolfinx.fem import petsc
from hypergap_dolfinx.algebra import checks, saddle
from hypergap_dolfinx.algebra.blocks import ConstraintBlocks
from hypergap_dolfinx.algebra.load_path import OF_RIGID
from hypergap_dolfinx.algebra.rigid_motions import free_motions
from hypergap_dolfinx.core import collective, compat
from hypergap_dolfinx.errors import PrescribedSideError, SolveError
from hypergap_dolfinx.interface_laws.coupling import CoupledMotion
from hypergap_dolfinx.interface_laws.given_values import Settable
from hypergap_dolfinx.multipliers.interface import Interface, TiedInterfaces
from hypergap_dolfinx.solvers.solver import Solver, System
from hypergap_dolfinx.solvers.tolerances import UNKNOWN
from hypergap_dolfinx.surface.component import lagrange_components
from hypergap_dolfinx.surface.tolerances import FILE_DIGITS
from hypergap_dolfinx.surface.trace import is_mixed

LOG = logging.getLogger("hypergap_dolfinx")


def constants(system: System, b: PETSc.Vec) -> PETSc.Vec | None:
    """Constants that neither K nor B shows alone, if the system may have some. Collective.

    They are a pressure (a scalar of a mixed space), free if displacements are prescribed all
    around, and a body that is held only by a tie with a conductance of 0.

    Args:
        system: The system.
        b: A vector of the system's layout.
    """
    conducts = system.constraints.conducts
    if not (conducts or any(map(is_mixed, system.spaces))):
        return None
    x = b.duplicate()
    x.set(0.0)
    of_x, prescribed = x.getNestSubVecs(), system.constraints.prescribed
    for i, (part, V, held) in enumerate(zip(of_x, system.spaces, prescribed)):
        if is_mixed(V):
            for field in lagrange_components(V):
                if field.space.value_shape == ():
                    ones = np.ones(field.space.dofmap.index_map.size_local)
                    part.array[:] += np.where(held, 0, field.into_body(ones))
        elif conducts:  # other ones on each body, such that ties have a jump
            part.array[:] = np.where(held, 0, i + 1)
    saddle.destroy_parts(of_x)
    return x


def error_again(system: System, solver: Solver, x: PETSc.Vec) -> float:
    """Error of the bodies' unknowns found again from loads A x, over x. Collective.

    Args:
        system: The system.
        solver: Its solver, with factors.
        x: A vector of the system's layout.
    """
    if solver.ksp.getPC().getType() != "lu":
        return 0.0  # iterative solvers may be given a null space
    sizes = saddle.local_sizes(x)
    units = saddle.scales(saddle.block_sizes(system.A), len(system.constraints.full))
    num = sum(sizes[: len(system.spaces)])
    return saddle.error_again(system.A, solver.solve, x, num, np.repeat(units, sizes))


class TiedSystem(collective.Owner, Settable):
    """Saddle-point system [K Bᵀ; B −C] [u; λ] = b, with K from forms, B and C from ties."""

    _solver: Solver

    def __init__(
        self,
        a: Sequence[fem.Form],
        bcs: Sequence[fem.DirichletBC],
        pieces: TiedInterfaces,
        u: Sequence[fem.Function],
        couplings: Sequence[CoupledMotion] = (),
    ):
        """Make the matrix and the vectors, without values in K and b. Collective.

        Args:
            a: Compiled bilinear form of each body.
            bcs: Dirichlet conditions of all bodies, in any order.
            pieces: The ties and their interfaces.
            u: Solution function of each body.
            couplings: Couplings of surfaces with points; their forms, unknowns and conditions are
                the last of those above.

        Raises:
            ValueError: A tie, coupling or condition on a space of no body; a tie given twice.
            InterfaceError: Γ1 of a tie is prescribed on whole facets where Γ0 can move, and no
                multiplier is left to tie it there.
        """
        self._a, self._u, self._pieces = list(a), list(u), pieces
        self._couplings, self._num_own = list(couplings), len(a) - len(couplings)
        ties = pieces.ties
        self._solved = False
        self._told = set[Hashable]()  # what is said only once
        self._motions_known = self._constants_known = self._is_regular = False
        self._scales = [1.0] * len(self._a)
        self._scales_fixed = False
        self._ticket = collective.enter(self._u[0].function_space.mesh.comm)
        if len({id(f) for f in u}) < len(u):
            raise ValueError("u has one function twice; give each body one of its own.")
        wrong = [bc for bc in bcs if not isinstance(bc, fem.DirichletBC)]
        if wrong:
            raise ValueError(
                f"bcs is one flat list of Dirichlet conditions; it has a {type(wrong[0]).__name__}."
            )
        checks.check_scalars((), self._u, bcs)
        # DOLFINx compares compiled spaces here
        self._bcs = fem.bcs_by_block([form.function_spaces[0] for form in self._a], bcs)
        orphans = len(bcs) - sum(len(block) for block in self._bcs)
        if orphans:
            raise ValueError(
                f"{orphans} of {len(bcs)} boundary conditions are on a space that is in no body; "
                "make them on the spaces of the forms."
            )
        if len({id(tie) for tie in ties}) < len(ties):
            raise ValueError("a tie is given twice; that would make the matrix singular.")
        spaces = [f.function_space for f in self._u]
        for i, V in enumerate(spaces):
            on_interfaces = [facets for W, facets in self._sides() if W.mesh is V.mesh]
            checks.check_cells(V.mesh, checks.name_of_body(i, V), on_interfaces)
        self._constraints = self._create_constraints(spaces)
        self._pieces.settle()
        checks.check_apart(ties)
        self._K = [petsc.create_matrix(form) for form in self._a]
        # Free interior nodes are unknowns without a stiffness, behind those of the bodies
        sizes = self._constraints.interior_sizes
        self._zeros = [saddle.zero_matrix(size, self._K[0].comm) for size in sizes]
        of_ties = [*self._zeros, *(jump.K for jump in self._constraints.jump_fields)]
        B, C = self._constraints.free, self._constraints.compliances.blocks
        self._A, self._Bt = saddle.saddle_matrix([*self._K, *of_ties], B, C, self._mixed())
        self._b_bodies = [compat.create_vector(V) for V in spaces]
        self._b_interiors = [K.createVecLeft() for K in of_ties]
        self._b_ties = [next(b for b in row if b).createVecLeft() for row in self._constraints.free]
        self._b = PETSc.Vec().createNest(
            [*self._b_bodies, *self._b_interiors, *self._b_ties], comm=self._A.comm
        )
        self._x = self._b.duplicate()
        self._system = System(self._A, self._K, self._constraints, spaces)

    def _sides(self) -> list[tuple[fem.FunctionSpace, npt.NDArray]]:
        """Spaces and this rank's facets of the interfaces' sides."""
        return [
            side for tie in self._pieces.ties for side in zip(tie.spaces, tie.facets, strict=True)
        ]

    def _mixed(self) -> dict[tuple[int, int], PETSc.Mat]:
        """Blocks of pairs of bodies, in the matrix of nonlinear problems."""
        return {}

    def _create_constraints(self, spaces: Sequence[fem.FunctionSpace]) -> ConstraintBlocks:
        """B and C; exchanges the sides of ties that may be exchanged if necessary. Collective."""
        while True:
            pieces = self._pieces
            try:
                return ConstraintBlocks(
                    spaces, self._bcs, pieces.interfaces, pieces.names, self._couplings
                )
            except PrescribedSideError as error:
                other = pieces.turned_over(error.interface)
                if other is None:
                    raise
                self._pieces = other

    def _check_motions(self):
        """Raise if the assembly can move rigidly; checked once. Collective."""
        if self._motions_known:
            return
        free, moving = free_motions(self._system.spaces, self._K, self._constraints)
        if free:
            pressures = " (a pressure at a node, where displacements are prescribed all around)"
            raise SolveError(
                f"the matrix is singular: {free} rigid motion{'s'[: free > 1]} of the bodies "
                f"{'are' if free > 1 else 'is'} free; hold every "
                "body, by boundary conditions or by a tie to one that is held"
                f"{', or a coupling by held=' if self._couplings else ''}"
                f"{pressures if any(map(is_mixed, self._system.spaces)) else ''}. "
                f"{'These move' if len(moving) > 1 else 'This one moves'}: "
                f"{', '.join(checks.name_of_body(i, self._system.spaces[i]) for i in moving)}."
                f"{self._constraints.too_few(moving)}"
            )
        self._motions_known = True

    def _check_constants(self):
        """Raise if the last solve left a constant undetermined. Collective."""
        if not self._constants_known and (x := constants(self._system, self._b)) is not None:
            free = not error_again(self._system, self._solver, x) <= UNKNOWN
            x.destroy()
            if free:
                raise SolveError(f"the matrix is singular: {', or '.join(self._free_constants())}.")
        self._constants_known = True

    def _check_regular(self, x: PETSc.Vec):
        """Raise if a solution isn't the only one; the first that isn't zero tells. Collective."""
        if not self._is_regular and x.norm():
            error = error_again(self._system, self._solver, x)
            if not error <= UNKNOWN:
                raise SolveError(saddle.not_unique(error))
            self._is_regular = True

    def _free_constants(self) -> list[str]:
        """What may be undetermined."""
        why = []
        if any(map(is_mixed, self._system.spaces)):
            why.append(
                "a pressure (or another scalar of a mixed space) is known up to a constant only; "
                "hold it at a node (or take more cells across, where there is one between "
                "prescribed walls)"
            )
        if self._constraints.conducts:
            why.append("a body is free that would be held by a conductance if that weren't 0")
        return why

    def _release(self) -> list:
        """The PETSc objects, removed from the problem."""
        single = ("_solver", "_A", "_b", "_x", "_constraints", "_pieces")
        several = ("_K", "_Bt", "_zeros", "_b_bodies", "_b_interiors", "_b_ties")
        objects = [self.__dict__.pop(name, None) for name in single]
        return objects + [obj for name in several for obj in self.__dict__.pop(name, [])]

    def __getattr__(self, name: str):
        """Raise a ValueError for PETSc objects that were destroyed."""
        if name in ("_A", "_b", "_x", "_solver", "_snes", "_constraints", "_K"):
            self._check_usable()
        raise AttributeError(f"{type(self).__name__} has no attribute {name}")

    def assemble_matrix(self):
        """Assemble stiffness, compliances and laws into A. Collective.

        The diagonal entry of a prescribed dof is the mean of the others, so that all residuals have
        the same unit.
        """
        changed = [self._assemble(i) for i in range(len(self._K))]
        checks.check_finite(self._K, "the stiffness", self._system.spaces)
        soft = [
            part for part in (self._constraints.compliances, *self._constraints.jump_fields) if part
        ]
        for part in soft:
            part.update()
        self._constants_known &= not self._constraints.conducts
        if self._renew_couplings() or any(changed) or soft:  # else factors can be kept
            self._A.assemble()

    def _renew_couplings(self) -> bool:
        """Renew transposed blocks of couplings; True if there are any. Collective."""
        return False

    def _assemble(self, i: int) -> bool:
        """Assemble a body's stiffness; True if it changed. Collective."""
        K, bcs = self._K[i], self._bcs[i]
        K.zeroEntries()
        # The diagonal's keyword is another one in 0.9
        petsc.assemble_matrix(K, self._a[i], bcs, self._scales[i])  # type: ignore[arg-type]
        K.assemble()
        if not self._scales_fixed:
            self._scale_prescribed(i)
        return True

    def _scale_prescribed(self, i: int):
        """Set the diagonal of prescribed dofs and scale their right-hand side. Collective."""
        K, held = self._K[i], self._constraints.prescribed[i]
        diagonal = K.getDiagonal()
        values = np.abs(diagonal.array_r[~held])
        local = np.array((values.sum(), len(values), held.sum()))
        total, num, num_held = K.comm.tompi4py().allreduce(local)
        if num_held:
            scale = total / max(num, 1) or 1.0
            diagonal.array[held] = scale
            K.setDiagonal(diagonal)
            self._b_bodies[i].array[held] *= scale / self._scales[i]
            self._scales[i] = scale
        diagonal.destroy()

    def _assign(self, x: PETSc.Vec):
        """Copy displacements from a solution vector into u."""
        for u, part in zip(self._u, x.getNestSubVecs()):
            u.x.array[: part.getLocalSize()] = part.array_r
            u.x.scatter_forward()

    def _read_couplings(self, *, linear: bool = False):
        """Set the constants of couplings' forms from what the user has set. Collective.

        Args:
            linear: True for small rotations.
        """
        comm = self._u[0].function_space.mesh.comm
        for k, one in enumerate(self._couplings):
            wrong = one.wrong()
            for what, values in zip(OF_RIGID, one.given, strict=True):
                if not np.isfinite(values).all():
                    wrong = f"{what} is no number: it is NaN or infinite; set it before solve()."
            collective.raise_on_all(comm, wrong and f"coupling {k}: {wrong}", ValueError)
            one.read(linear=linear)

    def _take_couplings(self, *, linear: bool = False):
        """Give couplings their solution and reactions. Collective.

        Args:
            linear: True for small rotations.
        """
        parts = self._x.getNestSubVecs()
        multipliers = parts[len(parts) - len(self._couplings) :]
        for (rows, i, _), part in zip(self._constraints.coupled, multipliers, strict=True):
            rows.take(parts[i].array_r, part.array_r, linear=linear)

    def _warn_of_moved(self, contacts: Sequence[Interface] = ()):
        """Warn, once for each tie and contact, of nodes moved since it was made. Collective."""
        comm = self._u[0].function_space.mesh.comm
        ties = [(f"tie {t}", tie) for t, tie in enumerate(self._pieces.ties)]
        every = ties + [(f"contact {c}", one) for c, one in enumerate(contacts)]
        far = np.array([one.moved() for _, one in every])
        comm.Allreduce(MPI.IN_PLACE, far, MPI.MAX)
        for (name, one), distance in zip(every, far, strict=True):
            size = min(surface.size.min() for surface in one.surfaces)
            if distance > FILE_DIGITS * size:
                self._warn_once(
                    ("moved", name),
                    f"{checks.name_of_tie(name, one)}: nodes of its surfaces were moved by up to "
                    f"{distance:.3g} after it was made, and it still is that of their old places: "
                    "gaps are wrong by that unless both sides were moved together. Make it and the "
                    "problem anew after meshes were moved, also by a tie with adjust=True.",
                )

    def _warn_once(self, key: Hashable, message: str):
        """Log a warning on one rank, unless it was logged with this key."""
        told = key in self._told
        self._told.add(key)
        if not told and self._u[0].function_space.mesh.comm.rank == 0:
            LOG.warning(message)

    def _check_usable(self):
        """Raise if the problem was destroyed."""
        if "_x" not in self.__dict__:
            raise ValueError("the problem was destroyed.")

    def _watch(self, bcs):
        """Remember the user's boundary conditions, which are read once."""
        self._bcs_read = (bcs, list(bcs)) if isinstance(bcs, list) else ([], [])

    def _check_bcs(self):
        """Raise if the user's list has other boundary conditions than when it was read."""
        now, then = self._bcs_read
        if len(now) != len(then) or any(a is not b for a, b in zip(now, then, strict=True)):
            raise ValueError(
                "bcs has other boundary conditions than when the problem was made, and the problem "
                "doesn't read them again: change the values of those that it has (a fem.Constant, "
                "a fem.Function), or make a new problem."
            )

    def multipliers(self, tie: Interface) -> npt.NDArray:
        """Multipliers of a tie after a solve. Collective.

        Args:
            tie: One of the problem's ties.

        Returns:
            This rank's multipliers, ``(num_multipliers, block_size)``.

        Raises:
            ValueError: A tie that isn't one of the problem's, or a problem that isn't solved.
        """
        self._check_usable()
        t = self._pieces.find(tie)
        if not self._solved:
            raise ValueError("the problem is not solved yet: call solve() first.")
        x = self._x.getNestSubVecs()[len(self._b_bodies) + len(self._b_interiors) :]
        return self._pieces.of_piece(tie, self._constraints.multipliers(t, x))

    @property
    def solver_name(self) -> str:
        """Name of the solver in use, also of one that the default chose or fell back to."""
        return self._solver.name

    @property
    def A(self) -> PETSc.Mat:
        """The saddle-point matrix, a MatNest."""
        return self._A

    @property
    def b(self) -> PETSc.Vec:
        """The right-hand side, in nonlinear problems the residual."""
        return self._b

    @property
    def x(self) -> PETSc.Vec:
        """The solution vector with displacements, then multipliers."""
        return self._x

    @property
    def u(self) -> list[fem.Function]:
        """The solution of each body."""
        return self._u[: self._num_own]

    @property
    def ties(self) -> list[Interface]:
        """The ties."""
        return list(self._pieces.ties)
