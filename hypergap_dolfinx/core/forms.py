# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Compiled forms of several bodies; thickness of one."""

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx.fem import IntegralType
from dolfinx.fem.forms import CompiledForm, get_integration_domains
from hypergap_dolfinx.core.compat import VERSION

_COMPILED: dict[tuple[str, str], dict[str, Any]] = {}
"""What this process has compiled or found in DOLFINx's cache, by signature and options of forms."""

_TYPES = {
    "cell": IntegralType.cell,
    "exterior_facet": IntegralType.exterior_facet,
    "interior_facet": IntegralType.interior_facet,
}


def create_forms(
    forms: Sequence[ufl.Form], compiler_options: dict | None, jit_options: dict | None
) -> list[fem.Form]:
    """Compile a form of each body, equal ones on different meshes and in later calls once.

    Collective. Even if it is in DOLFINx's cache, finding it takes as long as a small matrix's
    factors, and longer the more forms are there: Python lists the whole folder.

    Args:
        forms: The forms.
        compiler_options: Options of FFCx.
        jit_options: Options of the JIT compiler.
    """
    options = {**(compiler_options or {}), "scalar_type": PETSc.ScalarType}
    bodies = [form.arguments()[0].ufl_function_space().mesh for form in forms]
    return [_created(*each, options, jit_options) for each in zip(forms, bodies, strict=True)]


def _created(form, body: mesh.Mesh, compiler_options=None, jit_options=None) -> fem.Form:
    """A form, compiled unless an equal one is known. Collective."""
    V = [argument.ufl_function_space() for argument in form.arguments()]
    comm = body.comm
    key = form.signature(), repr((compiler_options, jit_options))
    # Bodies on other communicators may have left some ranks alone with it
    if not comm.allreduce(key in _COMPILED, MPI.LAND):
        found = vars(fem.compile_form(comm, form, compiler_options, jit_options))
        _COMPILED[key] = {name: found[name] for name in found if name != "ufl_form"}  # has a mesh
    compiled = CompiledForm(ufl_form=form, **_COMPILED[key])
    subdomains = _subdomains(form)
    lost = compiled.ufcx_form.num_coefficients < len(form.coefficients())
    if subdomains is None or (lost and VERSION < (0, 11)):
        # DOLFINx 0.9 takes one function for another where a form doesn't need all of them
        return fem.form(form, PETSc.ScalarType, compiler_options, jit_options)
    functions, constants = ({f: f for f in of} for of in (form.coefficients(), form.constants()))
    return fem.create_form(compiled, V, body, subdomains, functions, constants)


def _subdomains(form: ufl.Form) -> dict[IntegralType, list] | None:
    """Cells or facets of each tag of a form's integrals; None if not all of them are such.

    Raises:
        ValueError: Integrals of one type have several tags of the mesh.
    """
    (by_type,) = form.subdomain_data().values()
    if not by_type.keys() <= _TYPES.keys():
        return None
    found = {}
    for name, data in by_type.items():
        given = [integral for integral in form.integrals() if integral.integral_type() == name]
        ids = {i for integral in given for i in np.atleast_1d(integral.subdomain_id()).tolist()}
        tags = next((tags for tags in data if tags is not None), None)
        if any(of is not None and of is not tags for of in data):
            raise ValueError(
                f"the {name.replace('_', ' ')} integrals of a form have several subdomain_data: "
                "put their tags into one."
            )
        numbers = sorted(i for i in ids if not isinstance(i, str))
        found[_TYPES[name]] = get_integration_domains(_TYPES[name], tags, numbers)
    return found


def thickness(body: mesh.Mesh) -> float:
    """Twice a body's volume over its area: a ring's is that of its wall. Collective."""
    options = {"scalar_type": PETSc.ScalarType}
    forms = [_created(1 * dx, body, options) for dx in (ufl.dx(body), ufl.ds(body))]
    here = [fem.assemble_scalar(form).real for form in forms]
    volume, area = body.comm.allreduce(np.array(here))
    return float(2 * volume / area)
