# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""``Tie(adjust=True)``: Γ1 moves to where the tie knows rigid motions exactly."""

from itertools import product

from mpi4py import MPI

import numpy as np
import pytest
from assembly import Body, check, comm, inertia, problem, rectangle, tie
from helpers import sweep, two_ranks

import meshes
import meshes.solids
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import InterfaceError, SolveError, Tie, TiedProblem
from hypergap_dolfinx.mortar import adjust
from meshes import BOTTOM, INNER, LEFT, OUTER, RIGHT, TOP

FULL = 2 * np.pi


def ring(n, r0, r1, degree, cell="quadrilateral", angle=FULL):
    mesh, ft = meshes.ring_sector(comm, n, 1, r0, r1, degree=degree, cell=cell, angle=angle)
    return Body(mesh, ft, fem.functionspace(mesh, ("Lagrange", degree, (2,))))


def rotation(x):
    """A rotation by 1e-3 and a shift."""
    return -1e-3 * x[1] + 0.2, 1e-3 * x[0] - 0.1


def largest_stress(p, bodies):
    """Of a solution, over E."""
    largest = 0.0
    for body, u in zip(bodies, p.u, strict=True):
        W = fem.functionspace(body.mesh, ("Discontinuous Lagrange", 2, (2, 2)))
        points = W.element.interpolation_points
        f = fem.Function(W)
        f.interpolate(fem.Expression(body.stress(u), points() if callable(points) else points))
        largest = max(largest, np.abs(f.x.array).max(initial=0) / body.E)
    return comm.allreduce(largest, MPI.MAX)


PAIR = [(0, OUTER), (1, INNER)]


@pytest.mark.ranks(cells=[(12, 20)], degree=[3])
@pytest.mark.parametrize(
    "cells, degree, swap",
    sweep(product(((12, 20), (13, 48), (20, 20)), (1, 2, 3), (False, True)), 5),
)
def test_nested_rings(cells, degree, swap):
    """Held by nothing they have three zero modes, and a prescribed rotation strains nothing."""
    bodies = [ring(n, r, r + 0.5, degree) for n, r in zip(cells, (1, 1.5), strict=True)]
    ties = [tie(bodies, *(PAIR[::-1] if swap else PAIR), adjust=True)]
    p = problem(bodies, ties, PAIR, [], rotation)
    p.assemble_matrix()
    negative, zero, multipliers = inertia(p)
    held = problem(bodies, ties, PAIR, [(1, OUTER, (0, 1))], rotation)
    held.solve()
    stress = largest_stress(held, bodies)
    print(zero, stress)
    assert (negative, zero) == (multipliers, 3)
    assert stress <= 1e-10


@pytest.mark.parametrize("degree, expected", ((1, 1.2e-4), (2, 8e-7)))
def test_without(degree, expected):
    """What the docstring says of a rotation: it strains."""
    bodies = [ring(n, r, r + 0.5, degree) for n, r in zip((12, 20), (1, 1.5), strict=True)]
    ties = [tie(bodies, *PAIR)]
    if degree == 1:
        p = problem(bodies, ties, PAIR, [], rotation)
        p.assemble_matrix()
        assert inertia(p)[1] == 2
    held = problem(bodies, ties, PAIR, [(1, OUTER, (0, 1))], rotation)
    held.solve()
    stress = largest_stress(held, bodies)
    print(stress)
    assert expected / 3 < stress < 3 * expected


@two_ranks(adjust=[True])
@pytest.mark.parametrize("solver", ("direct", "bodies", "iterative"))
@pytest.mark.parametrize("adjust", (True, False))
def test_free_rings_are_told(adjust, solver):
    """What strains the tie in a rotation of both rings does not hold them."""
    bodies = [ring(n, r, r + 0.5, 1) for n, r in zip((12, 20), (1, 1.5), strict=True)]
    p = problem(bodies, [tie(bodies, *PAIR, adjust=adjust)], PAIR, [], rotation, solver=solver)
    with pytest.raises(SolveError, match="singular: 3 rigid motions of the bodies are free"):
        p.solve()


@two_ranks(gap=[0.5], degree=[1])
@pytest.mark.parametrize("gap", (0.5, 0.1, -0.1, -0.5))
@pytest.mark.parametrize("degree", (1, 2))
def test_initial_gap(degree, gap):
    """Blocks that gape or overlap by a part of the cell size: patch test after adjusting."""
    h = 0.25
    for swap in (False, True):
        bodies = [
            rectangle((3, 3), (0, 0), (1, 1), degree=degree),
            rectangle((4, 4), (0, 1 + gap * h), (1, 2), degree=degree),
        ]
        tied = [(0, TOP), (1, BOTTOM)]
        ties = [tie(bodies, *(tied[::-1] if swap else tied), adjust=True)]
        body, height = (0, 1 + gap * h) if swap else (1, 1)
        moved = bodies[body].mesh.geometry.x[:, 1]
        assert comm.allreduce(np.abs(moved - height).min(), MPI.MIN) <= 1e-14
        check(bodies, ties, tied, [(0, BOTTOM, (0, 1))])


@two_ranks()
def test_nodes_at_kinks_stay():
    """A kink that both sides have a node at stays where it is."""

    def mapping(low, high):
        def placed(x):
            y = np.where(x[:, 0] < 0.5, x[:, 0], 1 - x[:, 0])
            return np.column_stack((x[:, 0], low + y + x[:, 1] * (high - low)))

        return placed

    bodies = [rectangle((n, 1), 0, 0, mapping=mapping(*at)) for n, at in ((4, (0, 1)), (6, (1, 2)))]
    tied = [(0, TOP), (1, BOTTOM)]
    ties = [tie(bodies, *tied, adjust=True)]
    distance = np.abs(bodies[1].mesh.geometry.x - (0.5, 1.5, 0)).sum(axis=1).min(initial=9)
    assert comm.allreduce(distance, MPI.MIN) <= 1e-15
    check(bodies, ties, tied, [(0, LEFT, (0, 1)), (0, RIGHT, (0, 1))])


@pytest.mark.ranks(2)
@pytest.mark.parametrize("adjust, zero_modes", ((True, 6), (False, 3)))
def test_nested_shells(adjust, zero_modes):
    """Closed shells, free: six zero modes, three of which are lost without adjusting."""
    pytest.importorskip("gmsh")
    a, L, sides = [], [], []
    for h, radii, tag in ((0.9, (1, 1.5), OUTER), (0.7, (1.5, 2), INNER)):
        mesh, ft = meshes.solids.spherical_shell(comm, h, *radii, octant=False)
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        a.append(ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx)
        L.append(ufl.inner(fem.Constant(mesh, default_scalar_type((0, 0, 0))), v) * ufl.dx)
        sides.append((V, ft.find(tag)))
    p = TiedProblem(a, L, ties=[Tie(*sides, adjust=adjust)], solver="direct")
    p.assemble_matrix()
    negative, zero, multipliers = inertia(p)
    assert (negative, zero) == (multipliers, zero_modes)


def test_moves_that_no_mesh_of_the_gap_follows(monkeypatch):
    """They are undone, and the message says that it was the moving."""
    bodies = [ring(n, r, r + 0.5, 1) for n, r in zip((12, 20), (1, 1.5), strict=True)]
    start = bodies[1].mesh.geometry.x.copy()
    create, moved = adjust.create_gap_domain, []

    def fail_later(c, *surfaces):
        moved.append(np.abs(bodies[1].mesh.geometry.x - start).max())
        if len(moved) > 1:
            raise InterfaceError("Γ1 is folded.")
        return create(c, *surfaces)

    monkeypatch.setattr(adjust, "create_gap_domain", fail_later)
    with pytest.raises(InterfaceError, match=r"adjust moves the nodes on Γ1 too far.*folded"):
        tie(bodies, *PAIR, adjust=True)
    assert moved[1] > 1e-3
    assert (bodies[1].mesh.geometry.x == start).all()
