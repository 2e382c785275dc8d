# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Compiled forms of several bodies; thickness of one."""

from collections.abc import Sequence
from dataclasses import replace

from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem, mesh
from dolfinx.fem.forms import CompiledForm


def create_forms(
    forms: Sequence[ufl.Form], compiler_options: dict | None, jit_options: dict | None
) -> list[fem.Form]:
    """Compile a form of each body, equal ones on different meshes once. Collective.

    Even if it is in DOLFINx's cache, finding it takes as long as a small matrix's factors.

    Args:
        forms: The forms.
        compiler_options: Options of FFCx.
        jit_options: Options of the JIT compiler.
    """
    options = {**(compiler_options or {}), "scalar_type": PETSc.ScalarType}
    known: dict[str, CompiledForm] = {}
    return [_created(form, known, options, jit_options) for form in forms]


def _created(form, known, compiler_options, jit_options) -> fem.Form:
    """A form, compiled unless an equal one is known. Collective."""
    by_domain = form.subdomain_data().values()
    if any(data is not None for by_type in by_domain for of in by_type.values() for data in of):
        # Only this reads the tags of integrals
        return fem.form(form, PETSc.ScalarType, compiler_options, jit_options)
    V = [argument.ufl_function_space() for argument in form.arguments()]
    key = form.signature()
    if key not in known:
        known[key] = fem.compile_form(V[0].mesh.comm, form, compiler_options, jit_options)
    if known[key].ufcx_form.num_coefficients < len(form.coefficients()):
        # DOLFINx 0.9 takes one function for another where a form doesn't need all of them
        return fem.form(form, PETSc.ScalarType, compiler_options, jit_options)
    functions, constants = ({f: f for f in of} for of in (form.coefficients(), form.constants()))
    compiled = replace(known[key], ufl_form=form)
    return fem.create_form(compiled, V, V[0].mesh, {}, functions, constants)


def thickness(body: mesh.Mesh) -> float:
    """Twice a body's volume over its area: a ring's is that of its wall. Collective."""
    one = fem.Constant(body, default_scalar_type(1))
    here = [fem.assemble_scalar(fem.form(one * dx)).real for dx in (ufl.dx, ufl.ds)]
    volume, area = body.comm.allreduce(np.array(here))
    return float(2 * volume / area)
