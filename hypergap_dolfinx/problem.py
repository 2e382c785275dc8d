# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Problems of several bodies, tied: the counterpart of ``dolfinx.fem.petsc.LinearProblem``."""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from hypergap_dolfinx.algebra import checks, revolution
from hypergap_dolfinx.core.forms import create_forms
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.joining import Joined
from hypergap_dolfinx.solvers import choice
from hypergap_dolfinx.solvers.system import TiedSystem
from hypergap_dolfinx.tie import Tie


def _load(i: int, a: ufl.Form, L: ufl.Form | None) -> ufl.Form:
    """The linear form of a body, zero if there is none; checks that it matches the bilinear one."""
    if len(a.arguments()) != 2:
        raise ValueError(
            f"a[{i}] has {len(a.arguments())} arguments, not a trial and a test function; "
            "residuals go into NonlinearTiedProblem."
        )
    v = a.arguments()[0]
    V = v.ufl_function_space()
    if L is None:
        return (
            ufl.inner(fem.Constant(V.mesh, np.zeros(V.value_shape, PETSc.ScalarType)), v) * ufl.dx
        )
    if [argument.ufl_function_space() for argument in L.arguments()] != [V]:
        raise ValueError(f"a[{i}] and L[{i}] are on different function spaces; same order in both?")
    return L


class TiedProblem(TiedSystem):
    """Linear problem a_i(u_i, v_i) = L_i(v_i) on several bodies, tied to each other.

    Solves the saddle system [K Bᵀ; B −C] [u; λ] = [f; g] with K and f from the forms and B from
    the ties; g is 0 without jumps and prescribed displacements, C without compliances.

    Example:
        Temperatures 0 at y = 0 and 2 at y = 2, around the tie of :class:`Tie`'s example:

        >>> import ufl
        >>> from hypergap_dolfinx import TiedProblem
        >>> a, L, bcs = [], [], []
        >>> for W, y in zip(V, (0.0, 2.0)):
        ...     u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        ...     a.append(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        ...     L.append(fem.Constant(W.mesh, 0.0) * v * ufl.dx)
        ...     dofs = fem.locate_dofs_geometrical(W, lambda x: np.isclose(x[1], y))
        ...     bcs.append(fem.dirichletbc(y, dofs, W))
        >>> problem = TiedProblem(a, L, bcs=bcs, ties=[tie])
        >>> u0, u1 = problem.solve()
        >>> q = tie.quadrature(2)
        >>> q.integrate(q.evaluate(tie.traction(problem))).round(10)  # heat through the interface
        array([1.])
    """

    def __init__(
        self,
        a: Sequence[ufl.Form],
        L: Sequence[ufl.Form | None],
        *,
        bcs: Sequence[fem.DirichletBC] | None = None,
        ties: Sequence[Tie] = (),
        u: Sequence[fem.Function] | None = None,
        solver: str | None = None,
        petsc_options_prefix: str = "hypergap_",
        petsc_options: dict | None = None,
        form_compiler_options: dict | None = None,
        jit_options: dict | None = None,
    ):
        """Compile the forms and set up the saddle system. Collective.

        Args:
            a: Bilinear form of each body.
            L: Linear form of each body; None where there is no load.
            bcs: Dirichlet conditions of any of the bodies.
            ties: The ties between them. They find their bodies by their spaces, so neither the
                order of the bodies nor the sides of a tie matter here.
            u: Solution functions; made if not given.
            solver: ``"direct"`` factorises the whole system, ``"bodies"`` one body at a time and
                iterates over the ties, ``"iterative"`` takes conjugate gradients and algebraic
                multigrid: for symmetric, positive definite forms and large bodies, best of degree
                1. If not given, ``"direct"`` or, for large bodies in 3D, ``"bodies"``. Mixed
                spaces, free interior nodes and ties with a compliance or a conductance are for
                ``"direct"``.
            petsc_options_prefix: Prefix of the PETSc objects' options, with ``_`` at its end.
            petsc_options: Options of the KSP, besides those of the solver above; instead of those
                of ``"direct"`` if they name a ``ksp_type`` or ``pc_type``. Its matrix is a MatNest:
                MUMPS and fieldsplit take it, most preconditioners don't. PETSc's own tolerance is
                1e-5.
            form_compiler_options: Options of FFCx.
            jit_options: Options of the JIT compiler.

        Raises:
            ValueError: Numbers of forms that differ; a tie or boundary condition on a space that
                belongs to no body; a solver that isn't possible.
            InterfaceError: Γ1 is prescribed on whole facets that Γ0 is to be tied to.
        """
        if isinstance(a, ufl.Form) or isinstance(L, ufl.Form):
            raise ValueError("a and L are lists, with one form for each body.")
        if len(a) != len(L) or not a:
            raise ValueError(
                f"{len(a)} bilinear and {len(L)} linear forms: give one of each for every body."
            )
        ties = [ties] if isinstance(ties, Tie) else ties
        bcs = [bcs] if isinstance(bcs, fem.DirichletBC) else bcs
        if any(isinstance(tie, Tie) and tie.law and not tie.law.linear for tie in ties):
            raise ValueError("a tie with a law of its jump is for a NonlinearTiedProblem.")
        for form in (*a, *L):
            if form is not None and not isinstance(form, ufl.Form):
                raise ValueError(
                    f"a and L are UFL forms, not {type(form).__name__}; they are compiled here."
                )
        loads = [_load(i, *forms) for i, forms in enumerate(zip(a, L, strict=True))]

        checks.check_scalars((*a, *loads), u or ())
        self._L = create_forms(loads, form_compiler_options, jit_options)
        spaces = [form.arguments()[0].ufl_function_space() for form in loads]
        solutions = u if u is not None else [fem.Function(V) for V in spaces]
        compiled = create_forms(a, form_compiler_options, jit_options)
        super().__init__(compiled, bcs or (), Joined(ties), solutions)
        self._solver = choice.create(self._system, solver, petsc_options_prefix, petsc_options)
        revolution.tell(a, self._pieces.ties, "tie")

    def assemble_vector(self):
        """Assemble the loads and lift the prescribed displacements into b. Collective."""
        prescribed = []
        bodies = zip(self._b_bodies, self._a, self._L, self._bcs, strict=True)
        for i, (b, a, L, bcs) in enumerate(bodies):
            with b.localForm() as local:
                local.set(0.0)
            petsc.assemble_vector(b, L)
            if bcs:
                petsc.apply_lifting(b, [a], bcs=[bcs])
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            petsc.set_bc(b, bcs)
            b.array[self._constraints.prescribed[i]] *= self._scales[i]
            g = b.duplicate()
            g.set(0.0)
            petsc.set_bc(g, bcs)
            prescribed.append(g)
        checks.check_finite(self._b_bodies, "the load", self._system.spaces)
        self._constraints.check_prescribed(prescribed)
        self._constraints.read_jumps()
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
        self._check_usable()
        self.assemble_matrix()
        self.assemble_vector()
        return self.solve_system()

    def solve_system(self) -> list[fem.Function]:
        """Solve with the present A and b; an A that didn't change is not factorised again.

        For time loops: assemble A once, then assemble b and solve in each step. Collective.

        Returns:
            The solution of each body, the same functions as in ``u``.

        Raises:
            SolveError: The solver failed; says how.
        """
        self._check_motions()
        self._solved = False
        self._solver.update()
        self._solver.solve(self._b, self._x)
        self._solver.options.tell_unused(self._A.comm)
        failure = self._solver.failure()
        if failure:
            raise SolveError(failure)
        self._check_constants()
        self._assign(self._x)
        self._solved = True
        return self._u

    @property
    def a(self) -> list[fem.Form]:
        """The compiled bilinear forms."""
        return self._a

    @property
    def L(self) -> list[fem.Form]:
        """The compiled linear forms."""
        return self._L

    @property
    def solver(self) -> PETSc.KSP:
        """The KSP."""
        return self._solver.ksp

    @property
    def iterations(self) -> int:
        """Number of iterations of the last solve."""
        return self._solver.iterations
