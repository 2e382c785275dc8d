# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which side is Γ1, and ties that close a gap: interference fits."""

import logging

from mpi4py import MPI

import numpy as np
import pytest
from assembly import (
    Body,
    comm,
    rectangle,
    smooth_problem,
    smooth_traction_error,
)
from helpers import sweep

import dolfinx.mesh
import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import InterfaceError, Tie, TiedProblem
from meshes import BOTTOM, END, INNER, LEFT, OUTER, RIGHT, START, TOP


@pytest.mark.ranks(2, cells=[(3, 7)])
@pytest.mark.parametrize(
    "cells, degrees, stiffness, swapped, why",
    (
        ((3, 7), (1, 1), None, True, "coarser"),
        ((7, 3), (1, 1), (1, 100), False, "coarser"),
        ((2, 5), (1, 1), None, False, "finer"),
        ((5, 2), (1, 1), (1, 1), True, "finer"),
        ((2, 5), (1, 1), (1, 2), True, "coarser"),
        ((2, 5), (2, 2), None, True, "coarser"),
        ((3, 3), (1, 2), None, True, "coarser"),
        ((3, 3), (1, 1), (1, 100), True, "softer"),
        ((3, 3), (1, 1), (100, 1), False, "softer"),
        ((3, 3), (1, 1), None, False, "second"),
    ),
)
def test_between(cells, degrees, stiffness, swapped, why, caplog):
    bodies = [
        rectangle((n, 1), (0, y), (1, y + 1), degree=k)
        for n, k, y in zip(cells, degrees, (0, 1), strict=True)
    ]
    sides = [(bodies[0].V, bodies[0].facets(TOP)), (bodies[1].V, bodies[1].facets(BOTTOM))]
    with caplog.at_level(logging.INFO, "hypergap_dolfinx"):
        tie = Tie.between(*sides, stiffness=stiffness)
    assert tie.swapped is swapped
    assert tie.spaces[1] == bodies[0 if swapped else 1].V
    if comm.rank == 0:
        assert f"Γ1 is the {'first' if swapped else 'second'} side" in caplog.text
        assert why in caplog.text


@pytest.mark.ranks(2, cell=["triangle"], thin=[0])
@pytest.mark.parametrize("thin", (0, 1))
@pytest.mark.parametrize("cell", ("triangle", "quadrilateral"))
def test_between_a_thin_layer_and_a_block(cell, thin, caplog):
    """The layer is Γ1, though its cells are shorter than the block's."""
    height = [1.0, 1.0]
    height[thin] = 1e-4
    cells = [3, 3]
    cells[thin] = 7
    bodies = [
        rectangle((cells[0], 1), (0, 1 - height[0]), (1, 1), cell=cell),
        rectangle((cells[1], 1), (0, 1), (1, 1 + height[1]), cell=cell),
    ]
    sides = [(bodies[0].V, bodies[0].facets(TOP)), (bodies[1].V, bodies[1].facets(BOTTOM))]
    with caplog.at_level(logging.INFO, "hypergap_dolfinx"):
        tie = Tie.between(*sides)
    assert tie.spaces[1] == bodies[thin].V
    if comm.rank == 0:
        assert "the thin one" in caplog.text


# A shaft ring pressed into a hub: in theory u1(c), u2(c) and the pressure are linear in
# the interference δ up to O(δ/c)

A, C, B, YOUNG, NU = 1.0, 2.0, 3.0, 1000.0, 0.3
PRESSURE = YOUNG / (1 - NU**2) * (C**2 - A**2) * (B**2 - C**2) / (2 * C**3 * (B**2 - A**2))
EXACT = np.array([-0.290178571429, 0.709821428571, PRESSURE])


def press(delta, degree, swap, n=8, *, jump=False, geometry=None, **options):
    """Radial displacements at the interface and the pressure there, over δ.

    The rings overlap by δ, or fit and have a jump of δ. Their cells have the spaces' degree, or
    another one.
    """
    bodies, overlap = [], 0 if jump else delta / 2
    for n_hoop, radii in ((2 * n, (A, C + overlap)), (3 * n, (C - overlap, B))):
        mesh, ft = meshes.ring_sector(comm, n_hoop, n, *radii, degree=geometry or degree)
        V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
        bodies.append(Body(mesh, ft, V, YOUNG, NU))
    sides = [(bodies[0].V, bodies[0].facets(OUTER)), (bodies[1].V, bodies[1].facets(INNER))]
    outward = -delta if swap else delta
    how = {"jump": lambda x: outward * x[:2] / np.hypot(*x[:2])} if jump else {"close_gap": True}
    tie = Tie(*(sides[::-1] if swap else sides), **how, **options)
    L, bcs = [], []
    for body in bodies:
        zero = fem.Constant(body.mesh, default_scalar_type((0, 0)))
        L.append(ufl.inner(zero, ufl.TestFunction(body.V)) * ufl.dx)
        for tag, component in ((START, 1), (END, 0)):
            W = body.V.sub(component)
            dofs = fem.locate_dofs_topological(W, 1, body.facets(tag))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, W))
    problem = TiedProblem([body.a for body in bodies], L, bcs=bcs, ties=[tie])
    us = problem.solve()
    radial = []
    for body, u, tag in zip(bodies, us, (OUTER, INNER), strict=True):
        x = ufl.SpatialCoordinate(body.mesh)
        ds = ufl.Measure("ds", body.mesh, subdomain_data=body.ft)(tag)
        r = ufl.sqrt(ufl.dot(x, x))
        forms = (ufl.dot(u, x) / r * ds, fem.Constant(body.mesh, default_scalar_type(1)) * ds)
        total, length = (comm.allreduce(fem.assemble_scalar(fem.form(f))) for f in forms)
        radial.append(total / length / delta)
    q = tie.quadrature(4)
    normal = np.einsum("cpi,cpi->cp", q.evaluate(tie.traction(problem)), q.normal)
    pressure = -q.integrate(normal) / q.integrate(np.ones_like(normal)) / delta
    return np.array([*radial, pressure])


@pytest.mark.ranks(2, degree=[1], swap=[True])
@pytest.mark.parametrize(
    ("degree", "swap"), sweep(((2, False), (2, True), (1, True), (1, False)), 2)
)
def test_interference_fit(degree, swap):
    assert abs(PRESSURE * 0.01 - 1.28777472527) < 1e-9
    if degree == 1:  # the gap between two polygons is closed too: h² / (8 c) of δ
        assert np.abs(press(0.08, degree, swap, 16) / EXACT - 1).max() < 0.05
        return
    errors = [np.abs(press(d, degree, swap) / EXACT - 1).max() for d in (0.08, 0.04, 0.02, 0.01)]
    print(errors)
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert errors[-1] < 1.0 * 0.01 / C
    assert np.abs(rates - 1).max() < 0.05


@pytest.mark.ranks(2, swap=[True])
@pytest.mark.parametrize("swap", (False, True))
def test_interference_of_curved_cells(swap):
    """Spaces of degree 1 on curved cells: the surfaces' gap counts, not that between the chords."""
    error = np.abs(press(0.004, 1, swap, geometry=2) / EXACT - 1).max()
    print(error)
    assert error < 0.01  # 0.25 with chords


@pytest.mark.parametrize(
    ("delta", "geometry", "told"), ((0.004, 1, True), (0.1, 1, False), (0.004, 2, False))
)
def test_gap_between_chords_is_told(delta, geometry, told, caplog):
    """It is closed like an interference."""
    with caplog.at_level(logging.WARNING, "hypergap_dolfinx"):
        press(delta, 1, False, geometry=geometry)
    assert len(caplog.records) == told
    assert ("about 0.00089 is the gap between chords" in caplog.text) == told


@pytest.mark.ranks(2, swap=[True], bed=[5e-3])
@pytest.mark.parametrize("swap, bed", ((False, 0), (True, 0), (False, 5e-3), (True, 5e-3)))
def test_interference_as_a_jump(swap, bed):
    """First order in δ without a limit, also on a bed of springs: what is left is the meshes'."""
    pressure = 1 / (1 / PRESSURE + bed)
    exact = EXACT * pressure / PRESSURE
    options = {"jump": True, "compliance": (bed, 0) if bed else None}
    errors = [np.abs(press(0.01, 2, swap, n, **options) / exact - 1).max() for n in (4, 8)]
    print(errors)
    assert errors[1] < 1.6e-6
    assert np.log2(errors[0] / errors[1]) > 3.7


@pytest.mark.ranks
def test_close_gap_needs_displacements():
    bodies = [rectangle((2, 1), (0, y), (1, y + 1)) for y in (0, 1)]
    V = [fem.functionspace(body.mesh, ("Lagrange", 1)) for body in bodies]
    sides = [(V[0], bodies[0].facets(TOP)), (V[1], bodies[1].facets(BOTTOM))]
    with pytest.raises(InterfaceError, match="close_gap needs displacements"):
        Tie(*sides, close_gap=True)
    assert comm.allreduce(1, MPI.SUM) == comm.size


@pytest.mark.ranks(2, given=[None])
@pytest.mark.parametrize(
    "given, below", ((None, (True, True)), (1, (False, False)), ("moved", (True, False)))
)
def test_ties_on_one_surface(given, below):
    """Γ1 is below in all of them or above; of both ways the one with fewer, finer Γ1s that are new.

    Else the node at the T-joint has no multiplier on either Γ1, and λ's error is 0.083.
    """
    bodies = [
        rectangle((8, 3), (0, 0), (1, 1)),
        rectangle((6, 4), (0, 1), (0.5, 2)),
        rectangle((3, 4), (0.5, 1), (1, 2)),
    ]
    tied = [((0, TOP), (1, BOTTOM)), ((0, TOP), (2, BOTTOM)), ((1, RIGHT), (2, LEFT))]
    ties = []
    for t, pair in enumerate(tied):
        make = Tie if t == given else Tie.between
        ties.append(make(*((bodies[i].V, bodies[i].facets(tag)) for i, tag in pair)))
    assert [t.spaces[1] == bodies[0].V for t in ties] == [True, False, False]
    if given == "moved":  # ties are of the old positions
        for body in bodies:
            body.mesh.geometry.x[:, 0] += 1e-3
    problem = smooth_problem(bodies, ties, [side for pair in tied for side in pair])
    assert [t.spaces[1] == bodies[0].V for t in ties] == [*below, False]
    assert ties[1].swapped is below[1]
    if given is None:
        assert smooth_traction_error(problem, ties, bodies) < 0.07


@pytest.mark.ranks(3)
def test_ties_on_one_surface_that_cost_the_same():
    """Cells twice and half as long: fewer facets in Γ1, and not what round-off makes less."""
    below = rectangle((28, 3), (0, 0), (2, 1))
    above = [rectangle((7, 3), (0, 1), (1, 2)), rectangle((28, 5), (1, 1), (2, 2))]
    x = dolfinx.mesh.compute_midpoints(below.mesh, 1, below.facets(TOP))[:, 0]
    pairs = [
        ((below.V, below.facets(TOP)[here]), (body.V, body.facets(BOTTOM)))
        for here, body in zip((x < 1, x > 1), above, strict=True)
    ]
    for order in (1, -1):
        ties = [Tie.between(*pair) for pair in pairs[::order]]
        assert [tie.spaces[1] == below.V for tie in ties] == [order < 0, order > 0]
        TiedProblem([body.a for body in (below, *above)], [None] * 3, ties=ties)
        assert all(tie.spaces[1] == below.V for tie in ties)
