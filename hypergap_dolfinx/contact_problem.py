# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Bodies in contact: the user's door, load step by load step."""

from collections.abc import Sequence

import ufl
from dolfinx import fem
from hypergap_dolfinx import progress
from hypergap_dolfinx.contact import Contact
from hypergap_dolfinx.errors import SolveError
from hypergap_dolfinx.joining import Joined
from hypergap_dolfinx.solve.contact_system import ContactSystem
from hypergap_dolfinx.solve.contacts import ContactRows, Touching
from hypergap_dolfinx.solve.path import LoadPath
from hypergap_dolfinx.tie import Tie

HALVINGS = 6
"""Times that a load step is halved."""


class ContactProblem(ContactSystem):
    """Nonlinear bodies F_i(u_i; v_i) = 0 in contact with each other, and tied where ties are given.

    Solves F_i(u_i) − Σ_c Cᵀ_ci p_c + Σ_t Bᵀ_ti λ_t = 0 with p_c ≥ 0, g_c ≥ 0, p_c g_c = 0 and
    C = ∂g/∂u, one load step a call of :meth:`solve`.
    """

    def __init__(
        self,
        F: Sequence[ufl.Form | None],
        u: Sequence[fem.Function],
        *,
        bcs: Sequence[fem.DirichletBC] = (),
        contacts: Sequence[Contact],
        ties: Sequence[Tie] = (),
        J: Sequence[ufl.Form] | None = None,
        rtol: float = 1e-8,
        petsc_options_prefix: str = "hypergap_",
        petsc_options: dict | None = None,
        form_compiler_options: dict | None = None,
        jit_options: dict | None = None,
    ):
        """Compile the forms. Collective.

        Args:
            F: Residual form of each body; None is a rigid obstacle, of which the user sets u.
            u: Displacement of each body, as used in F; what it holds is where the bodies start.
            bcs: Dirichlet conditions of any of the bodies.
            contacts: The contacts between them.
            ties: The ties between them.
            J: Jacobian form of each body that has a form; F's derivative if not given.
            rtol: Residual, over the forces in the bodies, that is none.
            petsc_options_prefix: Prefix of the PETSc objects' options, with ``_`` at its end.
            petsc_options: Options of the KSP of Newton's steps; MUMPS if they name no type.
            form_compiler_options: Options of FFCx.
            jit_options: Options of the JIT compiler.

        Raises:
            ValueError: Numbers of forms and functions that differ; a contact, tie or boundary
                condition on a space that belongs to no body.
        """
        if any(isinstance(given, ufl.Form | fem.Function) for given in (F, u)):
            raise ValueError("F and u are lists, with one form and one function for each body.")
        if len(F) != len(u):
            raise ValueError(f"{len(F)} residual forms and {len(u)} functions: give one of each.")
        contacts = [contacts] if isinstance(contacts, Contact) else contacts
        ties = [ties] if isinstance(ties, Tie) else ties
        bcs = [bcs] if isinstance(bcs, fem.DirichletBC) else bcs or ()
        wrong = next((c for c in contacts if not isinstance(c, Contact)), None)
        if wrong is not None:
            raise ValueError(
                f"contacts has a {type(wrong).__name__}: make each with Contact(side0, side1)."
            )
        elastic = [i for i, form in enumerate(F) if form is not None]
        forms = [form for form in F if form is not None]
        self._every = list(u)
        touching = []
        for c, contact in enumerate(contacts):
            bodies = [self._body(c, i, V) for i, V in enumerate(contact.spaces)]
            numbers = [elastic.index(b) if b in elastic else None for b in bodies]
            if numbers == [None, None]:
                raise ValueError(f"contact {c} is between two rigid bodies.")
            fields = u[bodies[0]], u[bodies[1]]
            touching.append(Touching(contact, fields, (numbers[0], numbers[1])))
        super().__init__(
            forms,
            [u[i] for i in elastic],
            bcs,
            Joined(ties),
            touching,
            rtol=rtol,
            petsc_options_prefix=petsc_options_prefix,
            petsc_options=petsc_options,
            J=J,
            form_compiler_options=form_compiler_options,
            jit_options=jit_options,
        )
        self._contacts = list(contacts)
        for contact, rows in zip(self._contacts, self._rows, strict=True):
            contact.rows = rows
        moved = [f for f, form in zip(u, F, strict=True) if form is None]
        self._path = LoadPath(forms, self._u, bcs, moved)
        self._halvings = 0

    def _body(self, c: int, side: int, V: fem.FunctionSpace) -> int:
        """The body on one side of a contact."""
        body = next((i for i, f in enumerate(self._every) if f.function_space == V), None)
        if body is None:
            raise ValueError(
                f"Γ{side} of contact {c} is on a space of no body; make the contact and the forms "
                "on the same function spaces."
            )
        return body

    @property
    def contacts(self) -> list[Contact]:
        """The contacts."""
        return list(self._contacts)

    @property
    def iterations(self) -> int:
        """Newton steps of the last :meth:`solve`, those of failed load steps too."""
        return self._iterations

    @property
    def halvings(self) -> int:
        """Times that the last :meth:`solve` halved its load step."""
        return self._halvings

    def rows(self, contact: Contact) -> ContactRows:
        """Gaps and pressures of a contact after a solve, as arrays.

        Raises:
            ValueError: Not one of the problem's contacts, or not solved yet.
        """
        c = next((c for c, other in enumerate(self._contacts) if other is contact), None)
        if c is None:
            raise ValueError("the contact is not one of this problem's.")
        if not self._solved:
            raise ValueError("the problem is not solved yet: call solve() first.")
        return self._rows[c]

    def solve(self) -> list[fem.Function]:
        """Go from the last state to the values that are set now, and accept that. Collective.

        Where Newton's iteration fails, the load step is halved: all constants and functions in the
        forms and boundary conditions are set to values between. If that fails too, the last state
        that was found remains.

        Returns:
            The displacement of each body, the same functions as in ``u``.

        Raises:
            SolveError: No load step, however small, was solved; says why.
        """
        self._path.set_out()
        self._iterations = self._halvings = 0
        comm = self._u[0].function_space.mesh.comm
        self._prepare()
        done, size = 0.0, 1.0
        while done < 1:
            before = self._state()
            s = min(done + size, 1.0)
            self._path.go(s)
            try:
                steps = self._newton()
            except SolveError as error:
                self._restore(before)
                size /= 2
                self._halvings += 1
                if size < 0.5**HALVINGS:
                    self._path.go(1)
                    raise SolveError(
                        f"contact: no solution beyond {done:.3g} of the load step; {error}"
                    ) from error
                progress.show(comm, f"load {s:.3g}: {error}")
            else:
                done, size = s, min(2 * size, 1.0)
                num = sum(int(rows.now.on.sum()) for rows in self._rows)
                progress.show(comm, f"load {s:.3g}: {steps} Newton steps, {num} in contact")
        self._path.arrive()
        self._solved = True
        return self._every
