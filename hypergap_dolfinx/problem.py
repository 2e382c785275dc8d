# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Linear problems on tied bodies: the counterpart of ``dolfinx.fem.petsc.LinearProblem``."""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from hypergap_dolfinx.algebra import checks, revolution
from hypergap_dolfinx.core.forms import create_forms
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.interface_laws.coupling import Coupling, motions_of
from hypergap_dolfinx.joining import Joined
from hypergap_dolfinx.solvers import choice
from hypergap_dolfinx.solvers.system import TiedSystem
from hypergap_dolfinx.tie import Tie


def _load(i: int, a: ufl.Form, L: ufl.Form | None) -> ufl.Form:
    """Linear form of a body, zero if None; raises if it doesn't match the bilinear form."""
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


def _space(L: ufl.Form) -> fem.FunctionSpace:
    """Space of a linear form."""
    return L.arguments()[0].ufl_function_space()


class TiedProblem(TiedSystem):
    """Linear problem a_i(u_i, v_i) = L_i(v_i) on several tied bodies.

    Solves the saddle-point system [K Bᵀ; B −C] [u; λ] = [f; g]. K and f come from the forms, B from
    the ties, g from jumps and prescribed displacements, C from compliances.

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
        couplings: Sequence[Coupling] = (),
        u: Sequence[fem.Function] | None = None,
        solver: str | None = None,
        petsc_options_prefix: str = "hypergap_",
        petsc_options: dict | None = None,
        form_compiler_options: dict | None = None,
        jit_options: dict | None = None,
    ):
        """Compile the forms and set up the saddle-point system. Collective.

        Args:
            a: Bilinear form of each body.
            L: Linear form of each body; None without a load.
            bcs: Dirichlet conditions of all bodies, in any order.
            ties: The ties. They find their bodies by the function spaces: neither the order of the
                bodies nor the sides of a tie matter here.
            couplings: Couplings of surfaces with points that are loaded by forces and torques, or
                held.
            u: Solution function of each body; created by default.
            solver: ``"direct"`` factorises the whole system. ``"bodies"`` factorises each body and
                iterates over the ties. ``"iterative"`` is conjugate gradients with algebraic
                multigrid, for symmetric positive definite forms on large meshes, best of degree 1.
                The default for large bodies in 3D is ``"bodies"``, or ``"iterative"`` where ties
                don't let bodies be solved one after the other, or a body is held by Γ0 alone, else
                it is ``"direct"``. It falls back to ``"direct"`` if it fails or takes more
                iterations with one matrix (40 and 100) than its factors are worth;
                :attr:`solver_name` says which one is in use. Mixed spaces, free interior nodes,
                compliances, conductances and couplings need ``"direct"``.
            petsc_options_prefix: Prefix of PETSc options, ending with ``_``.
            petsc_options: Options of the KSP, in addition to those of the solver. They replace
                those of ``"direct"`` if they name a ``ksp_type`` or ``pc_type``. Its matrix is a
                MatNest, which MUMPS and fieldsplit accept, but most preconditioners don't. PETSc's
                default tolerance is 1e-5.
            form_compiler_options: Options of FFCx.
            jit_options: Options of the JIT compiler.

        Raises:
            ValueError: Different numbers of forms; a tie or boundary condition on a space of no
                body; a solver that can't solve this problem.
            InterfaceError: Γ1 of a tie is prescribed on whole facets where Γ0 can move, and no
                multiplier is left to tie it there, see :class:`Tie`.
        """
        if isinstance(a, ufl.Form) or isinstance(L, ufl.Form):
            raise ValueError("a and L are lists, with one form for each body.")
        if len(a) != len(L) or not a:
            raise ValueError(
                f"{len(a)} bilinear and {len(L)} linear forms: give one of each for every body."
            )
        ties = [ties] if isinstance(ties, Tie) else ties
        self._watch(bcs)
        bcs = [bcs] if isinstance(bcs, fem.DirichletBC) else bcs
        if any(isinstance(tie, Tie) and tie.law and not tie.law.linear for tie in ties):
            raise ValueError("a tie with a law of its jump is for a NonlinearTiedProblem.")
        for i, bilinear in enumerate(a):
            if bilinear is None:
                raise ValueError(
                    f"a[{i}] is None: give each body a bilinear form. Rigid bodies are for a "
                    "ContactProblem."
                )
        for form in (*a, *L):
            if form is not None and not isinstance(form, ufl.Form):
                raise ValueError(
                    f"a and L are UFL forms, not {type(form).__name__}; they are compiled here."
                )
        coupled = motions_of(couplings)
        loads = [_load(i, *forms) for i, forms in enumerate(zip(a, L, strict=True))]

        checks.check_scalars((*a, *loads), u or ())
        if u is not None and len(u) != len(a):
            raise ValueError(f"{len(u)} functions u for {len(a)} bodies: give one for each.")
        solutions = list(u) if u is not None else [fem.Function(_space(L)) for L in loads]
        for i, (f, L_i) in enumerate(zip(solutions, loads, strict=True)):
            if f.function_space != _space(L_i):
                raise ValueError(
                    f"u[{i}] and a[{i}] are on different function spaces; same order in both?"
                )
        revolution.tell_couplings(a, coupled)
        loads += [one.L for one in coupled]
        self._L = create_forms(loads, form_compiler_options, jit_options)
        compiled = create_forms([*a, *(c.a for c in coupled)], form_compiler_options, jit_options)
        bcs = [*(bcs or ()), *(bc for one in coupled for bc in one.bcs)]
        solutions += [one.q for one in coupled]
        super().__init__(compiled, bcs, Joined(ties), solutions, coupled)
        self._solver = choice.create(self._system, solver, petsc_options_prefix, petsc_options)
        revolution.tell(a, self._pieces.ties, "tie")
        self._made = True

    def assemble_matrix(self):
        """Assemble stiffness, springs and compliances into A. Collective."""
        self._warn_of_moved()
        self._read_couplings(linear=True)
        super().assemble_matrix()

    def assemble_vector(self):
        """Assemble loads and prescribed displacements into b. Collective."""
        self._check_bcs()
        prescribed = []
        self._read_couplings(linear=True)
        bodies = zip(self._b_bodies, self._a, self._L, self._bcs, strict=True)
        for i, (b, a, L, bcs) in enumerate(bodies):
            g = b.duplicate()
            g.set(0.0)
            petsc.set_bc(g, bcs)
            prescribed.append(g)
            with b.localForm() as local:
                local.set(0.0)
            petsc.assemble_vector(b, L)
            if bcs and g.norm(PETSc.NormType.INFINITY) != 0:  # NaN is told below
                petsc.apply_lifting(b, [a], bcs=[bcs])
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            held = self._constraints.prescribed[i]
            b.array[held] = self._scales[i] * g.array_r[held]
        checks.check_finite(self._b_bodies, "the load", self._system.spaces)
        self._constraints.check_coupled([part.array_r for part in prescribed], linear=True)
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
            SolveError: The solver failed; the message says how.
        """
        self._check_usable()
        self.assemble_matrix()
        self.assemble_vector()
        return self.solve_system()

    def solve_system(self) -> list[fem.Function]:
        """Solve with the present A and b, with the factors of A if it hasn't changed. Collective.

        In a time loop assemble A once; assemble b and call this in each step.

        Returns:
            The solution of each body, the same functions as in ``u``.

        Raises:
            ValueError: The matrix was never assembled.
            SolveError: The solver failed; the message says how.
        """
        if not self._A.isAssembled():
            raise ValueError("A isn't assembled: call assemble_matrix() before solve_system().")
        self._check_motions()
        self._solved = False
        self._solver.update()
        self._solver.solve(self._b, self._x)
        self._solver.options.tell_unused(self._A.comm)
        failure = self._solver.failure()
        if failure:
            raise SolveError(failure)
        self._check_constants()
        self._check_regular(self._x)
        self._assign(self._x)
        self._take_couplings(linear=True)
        self._solved = True
        return self.u

    @property
    def a(self) -> list[fem.Form]:
        """The compiled bilinear forms."""
        return self._a[: self._num_own]

    @property
    def L(self) -> list[fem.Form]:
        """The compiled linear forms."""
        return self._L[: self._num_own]

    @property
    def solver(self) -> PETSc.KSP:
        """The KSP."""
        return self._solver.ksp

    @property
    def iterations(self) -> int:
        """Number of iterations of the linear solver in the last solve."""
        return self._solver.iterations
