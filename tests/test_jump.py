# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Prescribed jumps: rigid ones leave stresses alone, a dislocation's are known."""

from mpi4py import MPI

import numpy as np
import pytest
from assembly import (
    NU,
    SOLVED,
    Body,
    comm,
    displacement_error,
    linear,
    problem,
    rectangle,
    tie,
    traction_error,
)
from helpers import interpolated, raises, two_ranks

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import InterfaceError, Tie, TiedProblem
from meshes import BOTTOM, END, INNER, LEFT, OUTER, RIGHT, START, TOP

TIED = [(0, TOP), (1, BOTTOM)]
HELD = [(0, BOTTOM, (0, 1))]
SLIP = (0.3, -0.1)


def slipped(x):
    """A rigid displacement, of arrays: a slip and a turn."""
    return np.array((SLIP[0] - 0.2 * x[1], SLIP[1] + 0.2 * x[0]))


def blocks(**options):
    return [
        rectangle((3, 2), (0, 0), (2, 1), **options),
        rectangle((5, 2), (0, 1), (2, 2), cell="triangle", **options),
    ]


def error(p, jump, tied=True):
    """Largest deviation from the linear field, which the second body has with a jump on top."""
    wrong = 0.0
    for u, added in zip(p.u, (lambda x: 0 * x[:2], jump), strict=True):
        exact = interpolated(u.function_space, lambda x: np.array(linear(x)) + added(x))  # noqa: B023
        wrong = max(wrong, np.abs(u.x.array - exact.x.array).max(initial=0))
    return comm.allreduce(wrong, MPI.MAX)


@two_ranks(how=["callable", "below"])
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("how", ("array", "constant", "function", "below", "callable"))
def test_slip(how, swap):
    """The second block is held by nothing but the tie, and moves by what is given."""
    bodies = blocks(degree=2)
    exact = slipped if how in ("function", "below", "callable") else lambda x: constant(x, SLIP)
    sign = -1 if swap else 1
    sides = TIED[::-1] if swap else TIED
    if how == "array":
        jump = np.multiply(sign, SLIP)
    elif how == "constant":
        jump = fem.Constant(bodies[0].mesh, default_scalar_type(np.multiply(sign, SLIP)))
    elif how == "callable":
        jump = lambda x: sign * slipped(x)
    else:
        side = 1 if how == "function" else 0
        V = bodies[sides[side][0]].V
        jump = interpolated(V, lambda x: sign * slipped(x))
    t = tie(bodies, *sides, jump=jump, interior="free" if how == "below" else "interpolated")
    p = problem(bodies, [t], TIED, HELD)
    p.solve()
    assert error(p, exact) <= SOLVED
    assert traction_error(p, t, bodies) <= 10 * SOLVED
    gap, slip = t.gap(*(p.u[::-1] if swap else p.u))
    if how == "array":
        q = t.quadrature(2)
        np.testing.assert_allclose(q.evaluate(gap), SLIP[1], atol=1e-11)
        np.testing.assert_allclose(q.evaluate(slip)[..., 0], sign * SLIP[0], atol=1e-11)


def constant(x, values):
    return np.array([np.full(x.shape[1], value) for value in values])
