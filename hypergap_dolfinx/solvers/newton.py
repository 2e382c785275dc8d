# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Residual and tangent of nonlinear tied bodies, assembled when their data change."""

import logging
from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from hypergap_dolfinx.algebra import checks
from hypergap_dolfinx.algebra.input_order import orders_of_multipliers
from hypergap_dolfinx.algebra.load_path import Value, values_of
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.core.forms import create_forms
from hypergap_dolfinx.core.interrupt import Interrupts
from hypergap_dolfinx.interface_laws.coupling import CoupledMotion
from hypergap_dolfinx.multipliers.interface import TiedInterfaces
from hypergap_dolfinx.solvers.checkpoint import Checkpoint, Part, State
from hypergap_dolfinx.solvers.hooks import Hooks
from hypergap_dolfinx.solvers.records import Recorder, StepRecord
from hypergap_dolfinx.solvers.system import TiedSystem
from hypergap_dolfinx.solvers.tolerances import TURNED

LOG = logging.getLogger("hypergap_dolfinx")


class Dependence:
    """Coefficients, constants and coordinates of a form, and their last values."""

    def __init__(self, form: ufl.Form, compiled: fem.Form, u: fem.Function):
        """Find those that remain after differentiation.

        Args:
            form: The form.
            compiled: The form compiled by FFCx.
            u: The solution function.
        """
        of_ufl, ufcx = form.coefficients(), compiled.ufcx_form
        used = [ufcx.original_coefficient_positions[i] for i in range(ufcx.num_coefficients)]
        self._functions = [of_ufl[k] for k in used if of_ufl[k] is not u]
        self._u = [u] if any(of_ufl[k] is u for k in used) else []
        self._constants = list(form.constants())
        self._geometry = compiled.mesh.geometry
        self._before: tuple[list[npt.NDArray], list[npt.NDArray]] | None = None

    @property
    def on_u(self) -> bool:
        """True if the form depends on the solution."""
        return bool(self._u)

    def forget(self):
        """Forget the last values."""
        self._before = None

    def changed(self, slack: float = 0.0) -> bool:
        """True if something on this rank has changed since the last call that returned True.

        Args:
            slack: Largest change of the solution that counts as no change.
        """
        now = [np.asarray(constant.value) for constant in self._constants]
        now += [f.x.array for f in self._functions]
        now.append(self._geometry.x)
        at = [f.x.array for f in self._u]
        if self._before is not None:
            before, place = self._before
            near = all(abs(a - b).max(initial=0) <= slack for a, b in zip(at, place, strict=True))
            if near and all(map(np.array_equal, before, now)):
                return False
        copies = [[array.copy() for array in arrays] for arrays in (now, at)]
        self._before = copies[0], copies[1]
        return True


def _check_ranks(forms: Sequence[ufl.Form], rank: int, name: str, wanted: str):
    """Raise if a form isn't a UFL form of this rank."""
    for i, form in enumerate(forms):
        found = len(form.arguments()) if isinstance(form, ufl.Form) else None
        if found != rank:
            kind = type(form).__name__ if found is None else f"a form of rank {found}"
            raise ValueError(f"the {name} of body {i} is {kind}, {wanted}")


class NonlinearSystem(TiedSystem):
    """Residuals F_i(u_i) + Σ_t Bᵀ_ti λ_t and Σ_i B_ti u_i − Σ_s C_ts λ_s, with tangent :attr:`A`.

    The jumps w_t of ties with a law are among the u_i, with F(w_t) as F_i(u_i).
    """

    def __init__(
        self,
        F: Sequence[ufl.Form],
        u: Sequence[fem.Function],
        bcs: Sequence[fem.DirichletBC],
        pieces: TiedInterfaces,
        *,
        J: Sequence[ufl.Form] | None = None,
        couplings: Sequence[CoupledMotion] = (),
        hooks: Hooks | None = None,
        form_compiler_options: dict | None = None,
        jit_options: dict | None = None,
    ):
        """Compile the forms. Collective.

        Args:
            F: Residual form of each body.
            u: Solution function of each body.
            bcs: Dirichlet conditions of all bodies, in any order.
            pieces: The ties and their interfaces.
            J: Jacobian form of each body; the derivative of F by default.
            couplings: Couplings of surfaces with points.
            hooks: Callbacks of the user and internal variables.
            form_compiler_options: Options of FFCx.
            jit_options: Options of the JIT compiler.

        Raises:
            ValueError: Different numbers of forms and functions; a residual that isn't linear in a
                test function or doesn't depend on its body's function; a tie or boundary condition
                on a space of no body.
            InterfaceError: Γ1 of a tie is prescribed on whole facets where Γ0 can move, and no
                multiplier is left to tie it there.
        """
        wanted = "not a form with one test function; of an energy it is ufl.derivative(energy, u)."
        _check_ranks(F, 1, "residual", wanted)
        if J is None:
            for i, (form, f) in enumerate(zip(F, u, strict=False)):
                if f not in form.coefficients():
                    raise ValueError(
                        f"the residual form of body {i} has no u[{i}] in it: "
                        "write each form with the function that is given for its body."
                    )
            J = [self._derivative(form, f) for form, f in zip(F, u, strict=False)]
        if not len(F) == len(u) == len(J) or not F:
            raise ValueError(
                f"{len(F)} residual forms, {len(u)} functions and {len(J)} Jacobian forms: give "
                "one of each for every body."
            )

        wanted = (
            "not a UFL form with a trial and a test function; left out, it is the residual's "
            "derivative."
        )
        _check_ranks(J, 2, "Jacobian form", wanted)
        checks.check_scalars((*F, *J), u)
        options = form_compiler_options, jit_options
        self._forms, self._given_bcs = list(F), bcs
        F, J = [*F, *(one.F for one in couplings)], [*J, *(one.J for one in couplings)]
        u = [*u, *(one.q for one in couplings)]
        bcs = [*bcs, *(bc for one in couplings for bc in one.bcs)]
        self._F = create_forms(F, *options)
        super().__init__(create_forms(J, *options), bcs, pieces, u, couplings)
        self._held, self._num_ties = self._constraints.prescribed, len(self._constraints.full)
        self._depends = [Dependence(*of) for of in zip(J, self._a, u, strict=True)]
        self._slack = 0.0  # displacements that change no stiffness to speak of
        self._checkpoint: Checkpoint | None = None
        self._known: list[int | None] = [None] * len(self._a)  # states of K, assembled
        self._forces: list[float] = []  # in each body, of the last residual
        # Not u.x.petsc_vec: that goes when Python collects u, on each rank at its own time, and
        # then PETSc no longer knows of the communicator on some ranks, while others do
        self._now = [compat.create_vector(f.function_space) for f in self._u]
        comm = self._u[0].function_space.mesh.comm
        self._hooks = hooks or Hooks()
        self._hooks.comm = comm
        self._interrupts, self._records, self._num_steps = Interrupts(comm), Recorder(comm), 0

    def _derivative(self, F: ufl.Form, u: fem.Function) -> ufl.Form:
        """Jacobian form of a body. Collective."""
        return ufl.derivative(F, u)

    def _forget(self):
        """Discard stiffness and factors that later load steps would reuse.

        A problem whose state was taken and one that continues from this state then do the same.
        """
        self._known = [None] * len(self._known)
        for depends in self._depends:
            depends.forget()

    def _release(self) -> list:
        return [*super()._release(), *self.__dict__.pop("_now", [])]

    def _mixed(self) -> dict[tuple[int, int], PETSc.Mat]:
        return self._constraints.mixed()

    def _renew_couplings(self) -> bool:
        blocks = [B for row in self._constraints.free for B in row if B is not None]
        num = 2 * len(self._couplings)
        for B, Bt in zip(blocks[len(blocks) - num :], self._Bt[len(self._Bt) - num :], strict=True):
            now = PETSc.Mat()
            B.transpose(now)  # PETSc 3.22 refuses Bt itself, though it has the same pattern
            now.copy(Bt, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            now.destroy()
        return bool(num)

    def _assign(self, x: PETSc.Vec):
        """Copy displacements from a vector into u, and jumps into the laws."""
        super()._assign(x)
        for one in self._couplings:
            one.assign()
        jumps = self._constraints.jump_fields
        parts = x.getNestSubVecs()
        start = len(parts) - self._num_ties - len(jumps)
        for jump, part in zip(jumps, parts[start:], strict=False):
            jump.take(part)

    def _residual(self, x: PETSc.Vec, r: PETSc.Vec):
        self._assign(x)
        self._hooks("before_step")
        self._evaluate(x, r)

    def _evaluate(self, x: PETSc.Vec, r: PETSc.Vec):
        """Evaluate the residual r at x, whose displacements are in u already.

        Prescribed values are lifted: to first order, r is F at displacements that satisfy them.
        """
        x_parts, r_parts = x.getNestSubVecs(), r.getNestSubVecs()
        num_bodies, num_ties = len(self._u), self._num_ties
        multipliers = x_parts[len(x_parts) - num_ties :]
        lifted, tied = self._lifted(), bool(multipliers)
        self._forces = []
        for u, now, b, F, J, bcs, held, scale, wanted in zip(
            self._u,
            self._now,
            r_parts,
            self._F,
            self._a,
            self._bcs,
            self._held,
            self._scales,
            lifted,
        ):
            moves = bool((wanted != u.x.array).any())
            with b.localForm() as local, now.localForm() as values:
                local.set(0.0)
                values.array[:] = u.x.array
            petsc.assemble_vector(b, F)
            if moves:
                petsc.apply_lifting(b, [J], bcs=[bcs], x0=[now], alpha=-1.0)
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            self._forces.append(b.norm())
            num = len(held)
            b.array[held] = scale * (u.x.array[:num] - wanted[:num])[held]
            if tied:
                now.array[:] = wanted[:num]
        of_ties = r_parts[num_bodies : len(r_parts) - num_ties]
        for b in of_ties:
            b.set(0.0)
        jumps = self._constraints.jump_fields
        for jump, b in zip(jumps, of_ties[len(of_ties) - len(jumps) :], strict=True):
            jump.add_force(b)
        fields = [*self._now, *x_parts[num_bodies : len(x_parts) - num_ties]]
        gaps_of = self._constraints.update_couplings(fields, multipliers)
        for t, multiplier in enumerate(multipliers):
            for b, B in zip(r_parts, self._constraints.free[t]):
                if B is not None:
                    B.multTransposeAdd(multiplier, b, b)
            gaps = r_parts[len(r_parts) - num_ties + t]
            k = t - num_ties + len(gaps_of)
            if k >= 0:
                gaps.array[:] = gaps_of[k]
                continue
            self._constraints.apply(t, fields, gaps)
            self._constraints.compliances.apply(t, multipliers, gaps)
        r.assemble()

    def _lifted(self) -> list[npt.NDArray]:
        """Displacements of each body with prescribed values inserted, ghosts included."""
        for one in self._couplings:
            one.read()
        lifted = [u.x.array.copy() for u in self._u]
        for values, bcs in zip(lifted, self._bcs, strict=True):
            for bc in bcs:
                bc.set(values)
        return lifted

    def _check_prescribed(self):
        """Raise if prescribed displacements contradict ties or rigid couplings. Collective."""
        lifted = self._lifted()
        self._constraints.check_coupled(lifted)
        for now, held, wanted in zip(self._now, self._held, lifted, strict=True):
            now.array[:] = np.where(held, wanted[: len(held)], 0)
        self._constraints.check_prescribed(self._now)

    def assemble_matrix(self):
        """Assemble changed blocks into A; the stiffness of a linear body only once. Collective."""
        super().assemble_matrix()
        self._known = [K.stateGet() for K in self._K]

    def _assemble(self, i: int) -> bool:
        K = self._K[i]
        changed = self._depends[i].changed(self._slack) or K.stateGet() != self._known[i]
        changed = K.comm.tompi4py().allreduce(changed, MPI.LOR)
        if changed:
            super()._assemble(i)
        return changed

    def _warn_of_turns(self):
        """Warn, once for each interface, of directions that don't turn with it. Collective."""
        for name, turn, words in self._turning():
            if turn > TURNED:
                text = f"{name}: its surfaces have turned by {np.degrees(turn):.2g}° {words}"
                self._warn_once(name, text)

    def _turning(self) -> list[tuple[str, float, str]]:
        """Interfaces with directions of the meshes: names, turns, advice. Collective."""
        words = (
            "if u is a displacement, but normal and tangential directions of its law are those of "
            "the meshes: tractions are wrong by about that angle; take one compliance or "
            "conductance for all directions, or a law without the normal."
        )
        return [(f"tie {t}", tie.turns(self._u), words) for t, tie in enumerate(self.ties)]

    def state(self) -> State:
        """State between two load steps, for :meth:`restore` and for files. Collective.

        It has displacements, multipliers, contact pressures and tractions, contact and friction
        states, elastic slip, ``internal_variables``, and the values in forms, boundary conditions,
        ties and contacts. It has no other data of the script, and no node positions.

        Returns:
            The state; ``state.save(path)`` writes a file.
        """
        self._check_usable()
        checkpoint = self._prepared_checkpoint()
        self._forget()
        return checkpoint.state(type(self).__name__, self._parts(checkpoint, []))

    def restore(self, state: State):
        """Restore a state of this problem, or of one that the same script made. Collective.

        Values in forms, boundary conditions, ties and contacts are set, too. The number of ranks
        may be another one.

        Args:
            state: State from :meth:`state` or ``State.load``.

        Raises:
            ValueError: A state of another problem or of other meshes; nothing is changed then.
        """
        self._check_usable()
        self._prepare_once()
        lost = list[str]()
        checkpoint = self._prepared_checkpoint()
        checkpoint.restore(type(self).__name__, self._parts(checkpoint, lost), state)
        if lost and checkpoint.comm.rank == 0:
            LOG.warning(
                f"multipliers of {', '.join(lost)} aren't found again in the state: they start "
                "from zero, and the next solve takes other steps to the same solution."
            )
        for u, x in zip(self._u, self._x.getNestSubVecs()):
            x.array[:] = u.x.array[: x.getLocalSize()]
        self._assign(self._x)
        self._forget()

    def _prepare_once(self):
        """Set up what the first solve would set up, before a state is restored. Collective."""

    def _prepared_checkpoint(self) -> Checkpoint:
        """Checkpoint with the orders of the state's entries. Collective."""
        if self._checkpoint is None:
            self._checkpoint = Checkpoint(self._u[0].function_space.mesh.comm)
        return self._checkpoint

    def _values(self) -> Sequence[Value]:
        """Values set by the user."""
        given: list[tuple[str, Value]] = [("", value) for tie in self.ties for value in tie.given]
        given += [("", value) for one in self._couplings for value in one.given]
        without = (*self._u, *self._hooks.internal_variables)
        found = values_of(self._forms, self._given_bcs, (), given, without=without)
        return [value for _, value in found]

    def _parts(self, checkpoint: Checkpoint, lost: list[str]) -> list[Part]:
        """Arrays of the state. Collective.

        Args:
            checkpoint: Orders of their entries.
            lost: Output list for names of ties whose multipliers aren't found again.
        """
        spaces = [u.function_space for u in self._u]
        parts = [checkpoint.mesh(f"body {i}", V) for i, V in enumerate(spaces)]
        parts += [checkpoint.function(f"u{i}", u) for i, u in enumerate(self._u)]
        of_ties = self._x.getNestSubVecs()[len(self._u) :]
        if of_ties:
            self._constraints.reset_couplings()  # the same rows at any rotation
            orders = list(map(checkpoint.order, spaces))
            rows, columns = orders_of_multipliers(self._constraints.full, orders)
            for k, (order, x) in enumerate(zip((*columns, *rows), of_ties, strict=True)):
                parts += checkpoint.rows(f"unknowns {k} of ties", order, x, lost)
        for k, value in enumerate(self._values()):
            parts.append(checkpoint.function(f"value{k}", value))
        for k, value in enumerate(self._hooks.internal_variables):
            parts.append(checkpoint.function(f"internal variable {k}", value))

        for k, one in enumerate(self._couplings):
            parts.append(checkpoint.shared(f"coupling {k}", one.kept, one.resume))

        def count(numbers: npt.NDArray):
            self._num_steps, self._solved = int(numbers[0]), bool(numbers[1])

        def scale(values: npt.NDArray):
            self._scales = [float(value) for value in values]

        counts = checkpoint.shared("counts", lambda: (self._num_steps, self._solved), count)
        return [*parts, counts, checkpoint.shared("scales", lambda: self._scales, scale)]

    @property
    def history(self) -> list[StepRecord]:
        """Records of the last 1000 calls of ``solve()`` with their Newton steps, oldest first."""
        return list(self._records.done)

    @property
    def F(self) -> list[fem.Form]:
        """The compiled residual forms."""
        return self._F[: self._num_own]

    @property
    def J(self) -> list[fem.Form]:
        """The compiled Jacobian forms."""
        return self._a[: self._num_own]
