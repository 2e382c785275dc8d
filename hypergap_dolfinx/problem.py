# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Problems of several bodies, tied: the counterpart of ``dolfinx.fem.petsc.LinearProblem``."""

from collections.abc import Sequence
from itertools import chain

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from hypergap_dolfinx import compat, saddle
from hypergap_dolfinx.blocks import ConstraintBlocks
from hypergap_dolfinx.tie import Tie


class TiedProblem:
    """Linear problem a_i(u_i, v_i) = L_i(v_i) on several bodies, tied to each other.

    Solves the saddle system [K Bᵀ; B 0] [u; λ] = [f; 0] with K and f from the forms and B from
    the ties.

    Example::

        problem = TiedProblem([a0, a1], [L0, L1], bcs=bcs, ties=[tie])
        u0, u1 = problem.solve()
    """

    def __init__(
        self,
        a: Sequence[ufl.Form],
        L: Sequence[ufl.Form],
        *,
        bcs: Sequence[fem.DirichletBC] = (),
        ties: Sequence[Tie] = (),
        u: Sequence[fem.Function] | None = None,
        petsc_options_prefix: str = "hypergap_",
        petsc_options: dict | None = None,
        form_compiler_options: dict | None = None,
        jit_options: dict | None = None,
    ):
        """Compile the forms and set up the saddle system. Collective.

        Args:
            a: Bilinear form of each body.
            L: Linear form of each body.
            bcs: Dirichlet conditions of any of the bodies.
            ties: The ties between them.
            u: Solution functions; made if not given.
            petsc_options_prefix: Prefix of the PETSc objects' options; ends with ``_``.
            petsc_options: Options of the KSP; MUMPS's LU if not given.
            form_compiler_options: Options of FFCx.
            jit_options: Options of the JIT compiler.

        Raises:
            ValueError: Numbers of forms that differ; a tie or boundary condition on a space that
                belongs to no body.
            InterfaceError: Γ1 is prescribed on whole facets that Γ0 is to be tied to.
        """
        if len(a) != len(L) or not a:
            raise ValueError(
                f"{len(a)} bilinear and {len(L)} linear forms: give one of each for every body."
            )

        def compiled(form):
            return fem.form(
                form,
                dtype=PETSc.ScalarType,
                form_compiler_options=form_compiler_options,
                jit_options=jit_options,
            )

        self._a, self._L = [compiled(form) for form in a], [compiled(form) for form in L]
        spaces = [form.arguments()[0].ufl_function_space() for form in L]
        self._spaces = spaces
        # DOLFINx compares compiled spaces here
        self._bcs = fem.bcs_by_block([form.function_spaces[0] for form in self._L], bcs)
        self._ties = list(ties)
        self._u = list(u) if u is not None else [fem.Function(V) for V in spaces]
        orphans = len(bcs) - sum(len(block) for block in self._bcs)
        if orphans:
            raise ValueError(
                f"{orphans} of {len(bcs)} boundary conditions are on a space that is in no body; "
                "make them on the spaces of the forms."
            )

        self._constraints = ConstraintBlocks(spaces, self._bcs, self._ties)
        self._K = [petsc.create_matrix(form) for form in self._a]
        # Free interior nodes are unknowns without a stiffness, behind those of the bodies
        sizes = self._constraints.interior_sizes
        self._zeros = [saddle.zero_matrix(size, self._K[0].comm) for size in sizes]
        self._A, self._Bt = saddle.saddle_matrix([*self._K, *self._zeros], self._constraints.free)
        self._b_bodies = [compat.create_vector(V) for V in spaces]
        self._b_interiors = [zero.createVecLeft() for zero in self._zeros]
        self._b_ties = [next(b for b in row if b).createVecLeft() for row in self._constraints.free]
        self._b = PETSc.Vec().createNest(
            [*self._b_bodies, *self._b_interiors, *self._b_ties], comm=self._A.comm
        )
        self._x = self._b.duplicate()
        self._solver = PETSc.KSP().create(self._A.comm)
        self._solver.setOperators(self._A)
        self._set_options(petsc_options_prefix, petsc_options)

    def _set_options(self, prefix: str, options: dict | None):
        if not prefix:
            raise ValueError("the PETSc options prefix cannot be empty.")
        self._solver.setOptionsPrefix(prefix)
        self._A.setOptionsPrefix(f"{prefix}A_")
        database = PETSc.Options()
        database.prefixPush(prefix)
        if options is None:  # the defaults, where the command line doesn't say otherwise
            options = {k: v for k, v in saddle.DIRECT.items() if not database.hasName(prefix + k)}
        for key, value in options.items():
            database[key] = value
        self._solver.setFromOptions()
        for key in options:
            del database[key]
        database.prefixPop()

    def __del__(self):
        """Destroy the PETSc objects."""
        single = ("_solver", "_A", "_b", "_x", "_constraints")
        several = ("_K", "_Bt", "_zeros", "_b_bodies", "_b_interiors", "_b_ties")
        objects = [getattr(self, name, None) for name in single]
        for obj in chain(objects, *(getattr(self, name, []) for name in several)):
            if obj is not None:
                obj.destroy()

    def assemble_matrix(self):
        """Assemble the bodies' stiffness into A. Collective."""
        for K, form, bcs in zip(self._K, self._a, self._bcs, strict=True):
            K.zeroEntries()
            petsc.assemble_matrix(K, form, bcs=bcs)
            K.assemble()
        self._A.assemble()

    def assemble_vector(self):
        """Assemble the loads and lift the prescribed displacements into b. Collective."""
        prescribed = []
        for b, a, L, bcs in zip(self._b_bodies, self._a, self._L, self._bcs, strict=True):
            with b.localForm() as local:
                local.set(0.0)
            petsc.assemble_vector(b, L)
            petsc.apply_lifting(b, [a], bcs=[bcs])
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            petsc.set_bc(b, bcs)
            g = b.duplicate()
            g.set(0.0)
            petsc.set_bc(g, bcs)
            prescribed.append(g)
        for t, c in enumerate(self._b_ties):
            self._constraints.apply(t, prescribed, c)
            c.scale(-1.0)
        for g in prescribed:
            g.destroy()

    def solve(self) -> list[fem.Function]:
        """Assemble, factorise and solve. Collective.

        Returns:
            The solution of each body, the same functions as in ``u``.

        Raises:
            SolveError: The solver failed; says how.
        """
        self.assemble_matrix()
        self.assemble_vector()
        return self.solve_system()

    def solve_system(self) -> list[fem.Function]:
        """Solve with A and b as they are; an A that didn't change is not factorised again.

        For time loops: assemble A once, then assemble b and solve in each step. Collective.

        Returns:
            The solution of each body, the same functions as in ``u``.

        Raises:
            SolveError: The solver failed; says how.
        """
        self._solver.solve(self._b, self._x)
        saddle.check_solved(self._solver)
        for u, x in zip(self._u, self._x.getNestSubVecs()):
            u.x.array[: x.getLocalSize()] = x.array_r
            u.x.scatter_forward()
        return self._u

    def multipliers(self, tie: Tie) -> npt.NDArray[np.float64]:
        """The multipliers of a tie after a solve.

        Args:
            tie: One of the problem's ties.

        Returns:
            This rank's rows, ``(num_multipliers, block_size)``.
        """
        t = next((t for t, other in enumerate(self._ties) if other is tie), None)
        if t is None:
            raise ValueError("the tie is not one of this problem's.")
        x = self._x.getNestSubVecs()[len(self._b_bodies) + len(self._b_interiors) + t]
        return self._constraints.multipliers(t, x)

    @property
    def a(self) -> list[fem.Form]:
        """The compiled bilinear forms."""
        return self._a

    @property
    def L(self) -> list[fem.Form]:
        """The compiled linear forms."""
        return self._L

    @property
    def A(self) -> PETSc.Mat:
        """The saddle matrix, a MatNest."""
        return self._A

    @property
    def b(self) -> PETSc.Vec:
        """The right-hand side."""
        return self._b

    @property
    def x(self) -> PETSc.Vec:
        """The solution vector: displacements, then multipliers."""
        return self._x

    @property
    def solver(self) -> PETSc.KSP:
        """The KSP."""
        return self._solver

    @property
    def u(self) -> list[fem.Function]:
        """The solution of each body."""
        return self._u

    @property
    def ties(self) -> list[Tie]:
        """The ties."""
        return self._ties
