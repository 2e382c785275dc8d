# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Hooks around Newton steps, and internal variables: bodies whose stress the user computes."""

from mpi4py import MPI

import numpy as np
import pytest
from helpers import close, raises
from test_state import Scene

import basix.ufl
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import Contact, ContactProblem, NonlinearTiedProblem, SolveError, Tie

comm = MPI.COMM_WORLD
pytestmark = pytest.mark.ranks(2)


def stress(u):
    strain = ufl.sym(ufl.grad(u))
    return (1 + 50 * ufl.inner(strain, strain)) * strain


class OfUser:
    """Stress of the scene's bodies as functions at quadrature points, which a hook computes."""

    def __init__(self, scene):
        metadata = {"quadrature_degree": 2, "quadrature_scheme": "default"}
        dx = ufl.dx(metadata=metadata)
        self.sigma, self._expressions, self.F, self.J, self.by_ufl = [], [], [], [], []
        for u in scene.u:
            V = u.function_space
            cell, v = V.mesh.basix_cell(), ufl.TestFunction(V)
            element = basix.ufl.quadrature_element(cell, value_shape=(2, 2), degree=2)
            sigma = fem.Function(fem.functionspace(V.mesh, element))
            points = basix.make_quadrature(getattr(basix.CellType, cell.name), 2)[0]
            self._expressions.append(fem.Expression(stress(u), points))
            self.sigma.append(sigma)
            self.F.append(ufl.inner(sigma, ufl.sym(ufl.grad(v))) * dx)
            full = ufl.inner(stress(u), ufl.sym(ufl.grad(v))) * dx
            self.by_ufl.append(full)
            self.J.append(ufl.derivative(full, u))

    def update(self):
        for sigma, expression in zip(self.sigma, self._expressions, strict=True):
            sigma.interpolate(expression)


def made(kind, scene, F, **options):
    options |= {"bcs": scene.bcs}
    if kind == "tie":
        return NonlinearTiedProblem(F, scene.u, ties=[Tie(*scene.between(0))], **options)
    return ContactProblem(F, scene.u, contacts=[Contact(*scene.between(0))], **options)


@pytest.mark.parametrize("kind", ("contact", "tie"))
def test_before_step(kind):
    """Stresses of a hook, with their Jacobian, give what UFL alone does, in as many steps."""
    ends, steps = [], []
    for by_hook in (False, True):
        scene = Scene(comm)
        mine = OfUser(scene)
        options = {"J": mine.J, "before_step": mine.update, "internal_variables": mine.sigma}
        problem = made(
            kind, scene, mine.F if by_hook else mine.by_ufl, **(options if by_hook else {})
        )
        for step in (0, 2):
            scene.move(step)
            problem.solve()
        ends.append(np.concatenate([u.x.array for u in scene.u]))
        steps.append([len(record.steps) for record in problem.history])
    close(ends[1], ends[0], 1e-10)
    assert steps[0] == steps[1]


@pytest.mark.parametrize("kind", ("contact", "tie"))
def test_history(kind):
    """Order of the calls; internal variables go back with the state, and aren't interpolated."""
    scene, calls = Scene(comm), []
    known = fem.Constant(scene.V[0].mesh, default_scalar_type(1.0))
    F = [(1 + 1e-14 * known) * scene.F[0], scene.F[1]]

    def before():
        known.value += 1e-3
        if fails and scene.load.value[1] < -0.04:
            known.value = 7.0
            raise SolveError("no stress")

    problem = made(
        kind,
        scene,
        F,
        before_step=before,
        accepted=lambda share: calls.append((share, float(known.value))),
        taken_back=lambda: calls.append((None, float(known.value))),
        internal_variables=known,
    )
    fails = False
    scene.load.value[1] = -0.02
    problem.solve()
    ((share, first),) = calls
    assert share == 1 and 1 < first < 1.1
    state, calls[:], fails = problem.state(), [], True
    scene.load.value[1] = -0.05
    if kind == "tie":
        with raises(SolveError, "no stress"):
            problem.solve()
        assert calls == [(None, first)]
        fails = False
        problem.solve()  # nothing is locked
        assert [share for share, _ in calls] == [None, 1]
    else:
        with raises(SolveError, "no solution beyond 65.6 % of the load step; no stress"):
            problem.solve()
        done = [share for share, _ in calls if share is not None]
        assert done[0] == 0.5 and done[-1] < 2 / 3 and calls[0] == (None, first)
        values = [value for share, value in calls if share is not None]
        assert values == sorted(values) and values[-1] < 1.1
        calls[:], fails = [], False
        problem.solve()
        assert calls[-1][0] == 1
    problem.restore(state)
    assert known.value == first and scene.load.value[1] == -0.02


@pytest.mark.parametrize("kind", ("contact", "tie"))
def test_wrong(kind):
    """Errors in hooks on one rank are errors on all; wrong ones are told in a line."""
    scene = Scene(comm)
    for name in ("before_step", "accepted", "taken_back"):
        with raises(ValueError, f"{name} is a str; give a function"):
            made(kind, scene, scene.F, **{name: "update"})
    if kind == "contact":
        problem = made(kind, scene, scene.F, accepted=lambda _: scene.load.value.__imul__(2))
        scene.load.value[1] = -0.01
        with raises(ValueError, "accepted changed a prescribed.*as internal_variables"):
            problem.solve()
    with raises(ValueError, "internal_variables has a ndarray; give functions and constants that"):
        made(kind, scene, scene.F, internal_variables=[np.zeros(3)])

    def fails():
        if comm.rank == comm.size - 1:
            raise ZeroDivisionError("by zero")

    problem = made(kind, scene, scene.F, before_step=fails)
    scene.load.value[1] = -0.02
    last = comm.rank == comm.size - 1
    error, message = (
        (ZeroDivisionError, "^by zero$")
        if last
        else (RuntimeError, "before_step failed on rank .: ZeroDivisionError: by zero")
    )
    for _ in range(2):
        with pytest.raises(error, match=message):
            problem.solve()
        assert not any(u.x.array.any() for u in scene.u)
