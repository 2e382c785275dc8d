# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Ctrl-C in a solve, on all ranks or on one: the last state remains. Log and records of steps."""

import logging
import signal

from mpi4py import MPI

import numpy as np
import pytest
from assembly import rectangle
from helpers import close

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import Contact, ContactProblem, NonlinearTiedProblem, Tie

comm = MPI.COMM_WORLD
pytestmark = pytest.mark.ranks(2)


def residual(u):
    """Bodies that harden."""
    v, strain = ufl.TestFunction(u.function_space), ufl.sym(ufl.grad(u))
    hardening = 1 + 50 * ufl.inner(strain, strain)
    return hardening * ufl.inner(strain, ufl.sym(ufl.grad(v))) * ufl.dx


def scene(kind, friction=None):
    """A block pressed or pulled on a wider one: the problem, the load, and the bodies."""
    bodies = [
        rectangle((5, 3), (-1, -1), (1, 0)),
        rectangle((4, 3), (-0.6, 0), (0.6, 1)),
    ]
    u = [fem.Function(body.V) for body in bodies]
    bcs = []
    for body, tag in zip(bodies, (meshes.BOTTOM, meshes.TOP), strict=True):
        value = fem.Constant(body.mesh, default_scalar_type((0, 0)))
        dofs = fem.locate_dofs_topological(body.V, 1, body.facets(tag))
        bcs.append(fem.dirichletbc(value, dofs, body.V))
    sides = [(b.V, b.facets(t)) for b, t in zip(bodies, (meshes.TOP, meshes.BOTTOM), strict=True)]
    F = [residual(f) for f in u]
    if kind == "tie":
        return NonlinearTiedProblem(F, u, bcs=bcs, ties=[Tie(*sides)]), value
    return ContactProblem(F, u, bcs=bcs, contacts=[Contact(*sides, friction=friction)]), value


@pytest.fixture
def interrupt():
    """Interrupts a problem once at a Newton step, on all ranks or on one; as Ctrl-C in a script."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)

    def at(problem, step, ranks):
        note = problem._records.note

        def noted(*args, **kwargs):
            note(*args, **kwargs)
            if kwargs["step"] == step and comm.rank in ranks:
                signal.raise_signal(signal.SIGINT)
                problem._records.note = note

        problem._records.note = noted

    yield at
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(
    "ranks", ([0], [comm.size - 1], list(range(comm.size)))[: 1 if comm.size == 1 else 3], ids=str
)
@pytest.mark.parametrize("kind", ("contact", "friction", "tie"))
def test_goes_on(kind, ranks, interrupt):
    """The state is the one before; then the solve has the same result, and the next one."""
    friction = 0.3 if kind == "friction" else None
    for number, step in enumerate((None, 1, 2)):
        problem, load = scene(kind, friction)
        load.value[:] = 0.0, -0.05
        problem.solve()
        before = [u.x.array.copy() for u in problem.u]
        load.value[:] = 0.02, -0.1
        if number:
            interrupt(problem, step, ranks)
            with pytest.raises(KeyboardInterrupt):
                problem.solve()
            assert not problem.history[-1].solved and problem.history[-1].message == "interrupted"
            assert all(np.array_equal(u.x.array, b) for u, b in zip(problem.u, before))
            assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        problem.solve()
        load.value[0] = 0.03
        problem.solve()
        found = np.concatenate([u.x.array for u in problem.u])
        assert [step.number for step in problem.history if step.solved] == [1, 2, 3]
        if not number:
            expected = found
        close(found, expected, 1e-12)


def test_second_signal(interrupt):
    """A second one is raised where it arrives; the problem can be solved then."""
    problem, load = scene("contact")
    load.value[1] = -0.1

    def twice(*args, **kwargs):
        for _ in range(2):
            signal.raise_signal(signal.SIGINT)

    note, problem._records.note = problem._records.note, twice
    with pytest.raises(KeyboardInterrupt):
        problem.solve()
    assert not any(u.x.array.any() for u in problem.u)
    problem._records.note = note
    problem.solve()


@pytest.mark.parametrize("kind", ("contact", "tie"))
def test_log(kind, caplog):
    """A line each step on rank 0, and the same as records on all ranks."""
    caplog.set_level(logging.DEBUG, "hypergap_dolfinx")
    problem, load = scene(kind)
    load.value[1] = -0.05
    problem.solve()
    (record,) = problem.history
    assert record.solved and record.number == 1 and not record.halvings
    newton = record.steps
    assert newton[-1].residual < 1e-8 < newton[0].residual
    assert sum(step.iterations for step in newton) >= len(newton) - 1
    came = sum(step.came - step.went for step in newton)
    assert came == (problem.contacts[0].active.sum() if kind == "contact" else 0)
    lines = [(r.levelno, r.getMessage()) for r in caplog.records]
    lines = [(level, text) for level, text in lines if text.startswith("load step")]
    if comm.rank:
        assert not lines
        return
    assert [level for level, _ in lines] == [logging.DEBUG] * len(newton) + [logging.INFO]
    assert all(str(step) in text for step, (_, text) in zip(newton, lines))
    assert record.message in lines[-1][1]


def test_bounded():
    """Only the last load steps are kept."""
    problem, load = scene("tie")
    problem._records.__init__(comm, 2)
    for shift in (0.01, 0.02, 0.03):
        load.value[1] = shift
        problem.solve()
    assert [step.number for step in problem.history] == [2, 3]
