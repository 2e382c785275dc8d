# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Γ1 is shorter than Γ0, longer, shifted, and ends in the middle of edges."""

from itertools import product

import numpy as np
import pytest
from assembly import (
    NU,
    SOLVED,
    displacement_error,
    rectangle,
    smooth_errors,
    smooth_problem,
    smooth_traction_error,
    tie,
    traction_error,
)
from helpers import close, comm, sweep, two_blocks

import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import Tie, TiedProblem
from meshes import BOTTOM, LEFT, RIGHT, TOP

TIED = [(0, TOP), (1, BOTTOM)]
SPANS = ((0.3, 0.71), (-0.2, 0.5), (0.13, 1.4), (-0.3, 1.3), (0.25, 0.75))


def stretching(x):
    """No stress but σ_xx, so that what faces nothing is free of load."""
    return (1 - NU**2) * x[0], -NU * (1 + NU) * x[1]


def bodies_of(span, element):
    cell, degree = element
    return [
        rectangle((4, 2), (0, 0), (1, 1), cell=cell, degree=degree),
        rectangle((3, 2), (span[0], 1), (span[1], 1.5), cell=cell, degree=degree),
    ]


def solve(bodies, swap, load, held):
    """Blocks under a load on the right or upper edges."""
    a, L, bcs = [], [], []
    for i, body in enumerate(bodies):
        v = ufl.TestFunction(body.V)
        ds = ufl.Measure("ds", body.mesh, subdomain_data=body.ft)
        a.append(body.a)
        L.append(load(i, v, ds, ufl.FacetNormal(body.mesh)))
        bcs += held(i, body)
    ties = [tie(bodies, *(TIED[::-1] if swap else TIED))]
    p = TiedProblem(a, L, bcs=bcs, ties=ties)
    p.solve()
    return p


def stretched(i, v, ds, n):
    """The loads of stretching."""
    return n[0] * v[0] * ds((LEFT, RIGHT))


def held_below(i, body):
    """The lower block's lower edge, where stretching has it."""
    if i == 1:
        return []
    g = fem.Function(body.V)
    g.interpolate(lambda x: np.array(stretching(x)))
    return [fem.dirichletbc(g, fem.locate_dofs_topological(body.V, 1, body.facets(BOTTOM)))]


@pytest.mark.ranks(span=[(0.13, 1.4)], swap=[False])
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("element", (("triangle", 1), ("triangle", 2), ("quadrilateral", 2)))
@pytest.mark.parametrize("span", SPANS)
def test_patch(span, element, swap):
    """Both are stretched alike; the part that faces nothing has no load, as is exact."""

    bodies = bodies_of(span, element)
    p = solve(bodies, swap, stretched, held_below)
    assert displacement_error(p, stretching) <= SOLVED
    assert traction_error(p, p.ties[0], bodies, stretching) <= 10 * SOLVED


# How much of Γ1's last facet Σ covers: above 30 % its dofs have multipliers of their own
ELEMENTS = ("triangle", 1), ("triangle", 2), ("quadrilateral", 2), ("quadrilateral", 3)
CUTS = (1e-12, 1e-8, 1.01e-7, 1e-6, 1e-4, 1e-2, 0.1, 0.29, 0.31, 0.5, 0.9)


@pytest.mark.ranks(2, swap=[True], element=[("triangle", 2)])
@pytest.mark.parametrize("element, swap", sweep(product(ELEMENTS, (False, True)), 3))
def test_cut_facets(element, swap):
    """A facet is cut by the other side's end, anywhere: neither u nor λ notices."""
    cell, degree = element

    for cut in CUTS:
        ends = (0, 0.5 + 0.25 * cut)
        bodies = [
            rectangle((4, 2), (0, 0), (1, 1), cell=cell, degree=degree),
            rectangle((3, 2), (ends[0], 1), (ends[1], 1.5), cell=cell, degree=degree),
        ]
        p = solve(bodies, swap, stretched, held_below)
        errors = displacement_error(p, stretching), traction_error(p, p.ties[0], bodies, stretching)
        print(cut, *errors)
        # Round-off of K u grows with the degree: 3e-14, 2e-13, 8e-13 at worst
        assert errors[0] <= (1e-12, 1e-11, 2e-11)[degree - 1]
        assert errors[1] <= 1e-10


@pytest.mark.parametrize(
    "element, swap", sweep(product((ELEMENTS[0], ELEMENTS[1], ELEMENTS[3]), (False, True)), 6)
)
def test_cut_facets_of_a_smooth_field(element, swap):
    """What a cut takes from λ costs no accuracy: both ends meet on the lower block."""
    cell, degree = element
    for cut in (1e-6, 0.01, 0.29, 0.31, 0.7):
        lower = [rectangle((8, 4), (0, 0), (1, 1), cell=cell, degree=degree)]
        tops = [
            rectangle((6, 4), (0, 1), (0.5 + 0.125 * cut, 1.5), cell=cell, degree=degree),
            rectangle((5, 4), (0.5 + 0.125 * cut, 1), (1, 1.5), cell=cell, degree=degree),
        ]
        bodies = lower + tops
        pairs = [((0, TOP), (i, BOTTOM)) for i in (1, 2)]
        tied = [side for pair in pairs for side in pair]
        ties = [tie(bodies, *(pair[::-1] if swap else pair)) for pair in pairs]
        p = smooth_problem(bodies, ties, tied)
        ratios = smooth_errors(p) / smooth_errors(smooth_problem(bodies, (), tied, "held"))
        error = smooth_traction_error(p, ties, bodies)
        print(cut, ratios, error)
        assert ratios.max() <= 1.3
        assert error <= (0.1, 4e-3, 2e-4)[degree - 1]


@pytest.mark.ranks(2, span=[(-0.3, 1.3)])
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("element", (("triangle", 1), ("quadrilateral", 2)))
@pytest.mark.parametrize("span", SPANS)
def test_resultants(span, element, swap):
    """The tie's force and moment balance the loads on the upper block."""
    force = np.array((0.3, -1.0))

    def load(i, v, ds, n):
        return (force[0] * v[0] + force[1] * v[1]) * ds(TOP if i == 1 else 99)

    def held(i, body):
        zero = np.zeros(2, dtype=default_scalar_type)
        dofs = fem.locate_dofs_topological(body.V, 1, body.facets(BOTTOM))
        return [fem.dirichletbc(zero, dofs, body.V)] if i == 0 else []

    p = solve(bodies_of(span, element), swap, load, held)
    q = p.ties[0].quadrature(6)
    traction = q.evaluate(p.ties[0].traction(p)) * (-1 if swap else 1)  # on the lower block
    length, middle = span[1] - span[0], (span[0] + span[1]) / 2
    moment = q.x[..., 0] * traction[..., 1] - q.x[..., 1] * traction[..., 0]
    assert np.abs(q.integrate(traction) - length * force).max() <= 1e-12
    if element[1] > 1:  # of degree 1, λ is constant on each edge and has its moment from Bᵀλ alone
        assert abs(q.integrate(moment) - length * (middle * force[1] - 1.5 * force[0])) <= 1e-12


@pytest.mark.ranks(span=[(0.3, 1.5)], swap=[False])
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("span", ((0.3, 1.5), (-0.4, 0.9), (0.13, 2.4)))
def test_ends_on_curved_edges(span, swap):
    """Nodes of edges off the middle, on one parabola: ∫ n dΓ is that between the tie's ends."""

    def parabola(x):
        return np.column_stack((x[:, 0] + 0.2 * x[:, 0] ** 2, x[:, 1] + 0.1 * x[:, 0] ** 2))

    spans = ((0, 2), span)
    sides = two_blocks((2, 3), (2, 2), shape=(), mapping=parabola, spans=spans, g=2)
    q = Tie(*(sides[::-1] if swap else sides)).quadrature(4)
    area = comm.allreduce(q.weights.ravel() @ q.normal.reshape(-1, 2))
    ends = np.array(((max(0, span[0]), 0), (min(2, span[1]), 0)))
    x, y = np.diff(parabola(ends), axis=0)[0]
    print(span, swap, np.abs(area) - (y, x))
    close(np.abs(area), (y, x))
