# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Forms of several bodies, compiled together."""

from mpi4py import MPI

import numpy as np
import pytest
from helpers import raises

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import meshtags
from hypergap_dolfinx.core.compat import VERSION
from hypergap_dolfinx.core.forms import create_forms

comm = MPI.COMM_WORLD


@pytest.mark.ranks(2)
def test_equal_forms_are_looked_up_once(monkeypatch):
    """Each has its own mesh, values and tags."""
    looked_up, compile_form = [], fem.compile_form

    def counted(comm, form, *options):
        looked_up.append(form)
        return compile_form(comm, form, *options)

    monkeypatch.setattr(fem, "compile_form", counted)
    monkeypatch.setattr("hypergap_dolfinx.core.forms._COMPILED", {})
    bodies = [meshes.block(comm, n, lambda x: x, cell="triangle") for n in ((2, 3), (5, 4))]
    forms, tagged = [], []
    for i, (mesh, tags) in enumerate(bodies):
        V = fem.functionspace(mesh, ("Lagrange", 1))
        f, c = fem.Function(V), fem.Constant(mesh, default_scalar_type(2 + i))
        f.interpolate(lambda x, i=i: x[0] + i * x[1])
        v = ufl.TestFunction(V)
        forms.append(ufl.inner(c * f, v) * ufl.dx + ufl.inner(f, v) * ufl.ds)
        ds = ufl.Measure("ds", mesh, subdomain_data=tags)
        tagged.append(ufl.inner(f, v) * ds(meshes.TOP))
        tagged[i] += ufl.inner(2 * f, v) * ds((meshes.LEFT, meshes.TOP)) + ufl.inner(f, v) * ufl.dx
    for _ in range(2):
        values = [create_forms(some, None, None) for some in (forms, tagged)]
        assert looked_up == [forms[0], tagged[0]]
    for some, ufl_forms in zip(values, (forms, tagged), strict=True):
        for form, ufl_form in zip(some, ufl_forms, strict=True):
            b, exact = (fem.assemble_vector(each).array for each in (form, fem.form(ufl_form)))
            np.testing.assert_allclose(b, exact, atol=1e-15)
            assert comm.allreduce(np.abs(b).sum()) > 0.1


def test_several_tags_of_one_type():
    """They are refused: one's numbers would be looked for in the other; of each type is fine."""
    mesh, tags = meshes.block(comm, (2, 2), lambda x: x, cell="triangle")
    v = ufl.TestFunction(fem.functionspace(mesh, ("Lagrange", 1)))
    facets, cells = tags.find(meshes.TOP), np.arange(1, dtype=np.int32)
    again, inside = (
        meshtags(mesh, dim, on, np.full(len(on), meshes.TOP, dtype=np.int32))
        for dim, on in ((1, facets), (2, cells))
    )
    ds, other = (ufl.Measure("ds", mesh, subdomain_data=each) for each in (tags, again))
    dx = ufl.Measure("dx", mesh, subdomain_data=inside)
    L = ufl.conj(v) * ds(meshes.LEFT)
    create_forms([L + ufl.conj(v) * dx(meshes.TOP) + ufl.conj(v) * ufl.ds], None, None)
    with raises(ValueError, "exterior facet integrals of a form have several subdomain_data: put"):
        create_forms([L + ufl.conj(v) * other(meshes.TOP)], None, None)


def test_functions_that_a_derivative_loses(monkeypatch):
    """Those that are left are the right ones; DOLFINx 0.9's errors cost later versions nothing."""
    if VERSION >= (0, 11):
        monkeypatch.setattr(fem, "form", None)
    forms = []
    for n in (2, 3):
        mesh = meshes.block(comm, (n, n), cell="triangle")[0]
        V = fem.functionspace(mesh, ("Lagrange", 1))
        u, f, g = (fem.Function(V) for _ in range(3))
        f.x.array[:], g.x.array[:] = 3, 5
        v = ufl.TestFunction(V)
        F = ufl.inner(f, v) * ufl.dx + ufl.inner(g * u, v) * ufl.dx
        forms.append(ufl.derivative(F, u))
    for form in create_forms(forms, None, None):
        total = fem.assemble_matrix(form).data.sum()
        np.testing.assert_allclose(comm.allreduce(total), 5)
