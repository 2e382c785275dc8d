# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Interfaces that are given in pieces, or that meet: judged by a field that is in no space.

Beside tied bodies stand the bodies alone with exact data, and one tie over all.
"""

from itertools import product

import numpy as np
import pytest
from assembly import (
    SOLVED,
    Body,
    comm,
    displacement_error,
    inertia,
    linear,
    problem,
    rectangle,
    smooth_errors,
    smooth_problem,
    smooth_traction_error,
    tie,
)
from helpers import elasticity, sweep, two_ranks, two_rings

import basix.ufl
import dolfinx
import ufl
from dolfinx import fem
from hypergap_dolfinx import Tie, TiedProblem
from meshes import BOTTOM, LEFT, RIGHT, TOP

ELEMENTS = {"Q1": ("quadrilateral", 1), "P2": ("triangle", 2), "Q3": ("quadrilateral", 3)}


def alone(bodies, tied):
    """Errors of the bodies by themselves: the worse of exact displacements and tractions."""
    found = [smooth_errors(smooth_problem(bodies, (), tied, how)) for how in ("held", "loaded")]
    return np.max(found, axis=0)


def wall(cell, degree, num=10, plate_cells=7):
    """Bricks of one cell each on a plate: bodies, pairs of the plate's ties, pairs between them."""
    bodies = [rectangle((plate_cells, 4), (0, 0), (1, 0.5), cell=cell, degree=degree)]
    for i in range(num):
        corners = (i / num, 0.5), ((i + 1) / num, 0.7)
        bodies.append(rectangle((1, 1), *corners, cell=cell, degree=degree))
    on_plate = [((0, TOP), (i, BOTTOM)) for i in range(1, num + 1)]
    between = [((i, RIGHT), (i + 1, LEFT)) for i in range(1, num)]
    return bodies, on_plate, between


@pytest.mark.ranks(2, swap=[True], name=["Q1"])
@pytest.mark.parametrize(
    "name, swap, swap_between", sweep(product(("Q1", "P2"), (False, True), (False, True)), 3)
)
def test_bricks_on_a_plate(name, swap, swap_between):
    """Displacements as good as the bodies alone, tractions as those of one tie over all."""
    bodies, on_plate, between = wall(*ELEMENTS[name])
    tied = [side for pair in on_plate + between for side in pair]
    ties = [tie(bodies, *(pair[::-1] if swap else pair)) for pair in on_plate]
    ties += [tie(bodies, *(pair[::-1] if swap_between else pair)) for pair in between]
    p = smooth_problem(bodies, ties, tied)
    ratios = smooth_errors(p) / alone(bodies, tied)
    cell, degree = ELEMENTS[name]
    one = [bodies[0], rectangle((10, 1), (0, 0.5), (1, 0.7), cell=cell, degree=degree)]
    sides = ((1, BOTTOM), (0, TOP)) if swap else ((0, TOP), (1, BOTTOM))
    over_all = tie(one, *sides)
    reference = smooth_traction_error(smooth_problem(one, [over_all], sides), [over_all], one)
    errors = [smooth_traction_error(p, some, bodies) for some in (ties[:10], ties)]
    print(ratios, errors, reference)
    assert ratios[0] <= 1.3
    assert ratios[1] <= 1.1
    assert max(errors) <= 2 * reference
    if comm.size == 1:
        negative, zero, multipliers = inertia(p)
        assert (negative, zero) == (multipliers, 0)


@pytest.mark.ranks(2, name=["Q1"])
@pytest.mark.parametrize("name", ("Q1", "P2"))
def test_bricks_that_nothing_else_holds(name):
    """The same patch as everywhere: of bricks with loads instead of prescribed displacements."""
    for tied_to_each_other in (False, True):
        bodies, on_plate, between = wall(*ELEMENTS[name], num=4, plate_cells=3)
        pairs = on_plate + between * tied_to_each_other
        for swap in (False, True):
            ties = [tie(bodies, *(pair[::-1] if swap else pair)) for pair in pairs]
            tied = [side for pair in pairs for side in pair]
            p = problem(bodies, ties, tied, [(0, BOTTOM, (0, 1))])
            p.solve()
            assert displacement_error(p) <= SOLVED
            assert inertia(p)[1] == 0


def tags(body: Body, tag: int, num: int):
    """Facets of a side by tags of equal length, without empty ones."""
    facets = body.facets(tag)
    x = dolfinx.mesh.compute_midpoints(body.mesh, 1, facets)[:, 0]
    parts = [facets[np.floor(x * num).astype(int) == i] for i in range(num)]
    return [part for part in parts if comm.allreduce(len(part))]


@two_ranks(cells=[(10, 7)], name=["Q1"])
@pytest.mark.parametrize(
    ("name", "swap", "cells"),
    sweep(product(("Q1", "P2"), (False, True), ((10, 4), (10, 7), (40, 7))), 2),
)
def test_one_interface_as_many_ties(name, cells, swap):
    """Tags on one side, the whole other side in each tie; or tags on both where they fit."""
    cell, degree = ELEMENTS[name]
    bodies = [
        rectangle((cells[0], 3), (0, 0), (1, 0.5), cell=cell, degree=degree),
        rectangle((cells[1], 3), (0, 0.5), (1, 1), cell=cell, degree=degree),
    ]
    tied = [(0, TOP), (1, BOTTOM)]
    whole = [bodies[0].facets(TOP), bodies[1].facets(BOTTOM)]

    def solve(facets):
        ties = []
        for pair in facets:
            sides = [(body.V, f) for body, f in zip(bodies, pair, strict=True)]
            ties.append(Tie(*(sides[::-1] if swap else sides)))
        p = smooth_problem(bodies, ties, tied)
        return np.array([*smooth_errors(p), smooth_traction_error(p, ties, bodies)])

    one = solve([whole])
    for num in sweep((10, 5, 20), 3):
        for facets in (
            [(part, whole[1]) for part in tags(bodies[0], TOP, num)],
            [(whole[0], part) for part in tags(bodies[1], BOTTOM, num)],
        ):
            ratios = solve(facets) / one
            print(num, len(facets), ratios)
            assert ratios.max() <= 1.1


FOUR = [((0, RIGHT), (1, LEFT)), ((2, RIGHT), (3, LEFT)), ((0, TOP), (2, BOTTOM))]
FOUR += [((1, TOP), (3, BOTTOM))]
THREE = [((0, RIGHT), (1, LEFT)), ((0, TOP), (2, BOTTOM)), ((1, TOP), (2, BOTTOM))]


def check_choices(bodies, pairs, choices, bound):
    """Whichever sides are Γ1: as good as the bodies alone, and λ's error below a bound."""
    tied = [side for pair in pairs for side in pair]
    reference = alone(bodies, tied)
    for swaps in choices:
        ties = [tie(bodies, *(p[::-1] if s else p)) for p, s in zip(pairs, swaps, strict=True)]
        p = smooth_problem(bodies, ties, tied)
        ratios = smooth_errors(p) / reference
        error = smooth_traction_error(p, ties, bodies)
        print(swaps, ratios, error)
        assert ratios.max() <= 1.1
        assert error <= bound


@pytest.mark.ranks(2, cells=[(4, 6, 3, 5)], name=["P2"])
@pytest.mark.parametrize(
    ("cells", "name"), sweep(product(((2, 3, 4, 5), (4, 6, 3, 5)), ELEMENTS), 2)
)
def test_four_blocks(name, cells):
    cell, degree = ELEMENTS[name]
    corners = ((0, 0), (0.5, 0), (0, 0.5), (0.5, 0.5))
    bodies = [
        rectangle((n, n), (x, y), (x + 0.5, y + 0.5), cell=cell, degree=degree)
        for n, (x, y) in zip(cells, corners, strict=True)
    ]
    choices = (0, 0, 0, 0), (1, 1, 0, 0), (0, 1, 0, 1)
    check_choices(bodies, FOUR, choices, (0.1, 5e-3, 2e-4)[degree - 1])


@pytest.mark.ranks(2, cut=[0.37], name=["P2"])
@pytest.mark.parametrize(("cut", "name"), sweep(product((0.5, 0.37), ELEMENTS), 2))
def test_t_junction(name, cut):
    cell, degree = ELEMENTS[name]
    corners = (((0, 0), (cut, 0.5)), ((cut, 0), (1, 0.5)), ((0, 0.5), (1, 1)))
    bodies = [
        rectangle((n, 3), *corner, cell=cell, degree=degree)
        for n, corner in zip((6, 9, 10), corners, strict=True)
    ]
    choices = ((0, 0, 0), (0, 0, 1), (0, 1, 0), (0, 1, 1)) if comm.size == 1 else ((0, 0, 1),)
    check_choices(bodies, THREE, choices, (0.08, 4e-3, 2e-4)[degree - 1])


def one_mesh(blocks) -> fem.FunctionSpace:
    """Blocks of quadrilaterals that share no node, as one mesh."""
    x, cells, start = [], [], 0
    for n, low, high in blocks:
        axes = (np.linspace(a, b, m + 1) for m, a, b in zip(n, low, high, strict=True))
        x.append(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2))
        at = start + np.arange(len(x[-1])).reshape(n[0] + 1, n[1] + 1)
        corners = at[:-1, :-1], at[1:, :-1], at[:-1, 1:], at[1:, 1:]
        cells.append(np.stack(corners, axis=-1).reshape(-1, 4))
        start += len(x[-1])
    element = basix.ufl.element("Lagrange", "quadrilateral", 1, shape=(2,))
    x, cells = np.vstack(x), np.vstack(cells)
    if comm.rank:
        x, cells = x[:0], cells[:0]
    return fem.functionspace(
        dolfinx.mesh.create_mesh(comm, cells, e=element, x=x), ("Lagrange", 1, (2,))
    )


@pytest.mark.ranks(2, swap=[False])
@pytest.mark.parametrize("tied_to_each_other", (False, True))
@pytest.mark.parametrize("swap", (False, True))
def test_bricks_of_one_mesh(swap, tied_to_each_other):
    """Parts of one mesh are bodies: bricks that aren't tied to each other keep their own λ."""
    num = 4
    blocks = [((3, 3), (0, 0), (1, 0.5))]
    blocks += [((1, 1), (i / num, 0.5), ((i + 1) / num, 0.7)) for i in range(num)]
    V = one_mesh(blocks)
    mesh = V.mesh
    mesh.topology.create_connectivity(1, 2)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    x = dolfinx.mesh.compute_midpoints(mesh, 1, facets)
    to_cell = mesh.topology.connectivity(1, 2)
    cells = to_cell.array[to_cell.offsets[facets]]
    inwards = dolfinx.mesh.compute_midpoints(mesh, 2, cells) - x
    on_plate = np.isclose(x[:, 1], 0.5) & (inwards[:, 1] < 0)
    pairs = []
    for i in range(num):
        on_brick = np.isclose(x[:, 1], 0.5) & (inwards[:, 1] > 0) & (np.floor(num * x[:, 0]) == i)
        pairs.append((on_plate, on_brick)[:: -1 if swap else 1])
    for i in range(1, num * tied_to_each_other):
        here = np.isclose(x[:, 0], i / num) & (x[:, 1] > 0.5)
        pairs.append((here & (inwards[:, 0] < 0), here & (inwards[:, 0] > 0)))
    ties = [Tie(*((V, facets[side]) for side in pair)) for pair in pairs]
    free = ~np.any([side for pair in pairs for side in pair], axis=0) & (x[:, 1] > 1e-9)
    loaded = np.sort(facets[free])
    marks = dolfinx.mesh.meshtags(mesh, 1, loaded, np.full(len(loaded), 1, dtype=np.int32))
    ds = ufl.Measure("ds", mesh, subdomain_data=marks)(1)
    body = Body(mesh, marks, V)
    stress = body.stress(ufl.as_vector(linear(ufl.SpatialCoordinate(mesh))))
    load = ufl.dot(ufl.dot(stress, ufl.FacetNormal(mesh)), ufl.TestFunction(V)) * ds
    value = fem.Function(V)
    value.interpolate(lambda x: np.array(linear(x)))
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 0))
    p = TiedProblem([body.a], [load], bcs=[fem.dirichletbc(value, dofs)], ties=ties)
    p.solve()
    assert displacement_error(p) <= SOLVED


def test_pieces_that_adjust():
    """One interface, one adjustment: rigid rotations are exact through all of its pieces."""
    for num in (1, 2):
        sides = two_rings((8, 12))
        parts = []
        for V, facets in sides:
            x = dolfinx.mesh.compute_midpoints(V.mesh, 1, facets)
            first = np.arctan2(x[:, 1], x[:, 0]) < np.pi / 4
            parts.append([facets] if num == 1 else [facets[first], facets[~first]])
        ties = [
            Tie(*((V, f) for (V, _), f in zip(sides, pair, strict=True)), adjust=True)
            for pair in zip(*parts, strict=True)
        ]
        V0 = sides[0][0]
        value = fem.Function(V0)
        value.interpolate(lambda x: np.array((-x[1], x[0])))
        every = fem.locate_dofs_geometrical(V0, lambda x: x[0] > -1)
        forms = [elasticity(V) for V, _ in sides]
        p = TiedProblem(*zip(*forms, strict=True), bcs=[fem.dirichletbc(value, every)], ties=ties)
        _, u1 = p.solve()
        exact = fem.Function(u1.function_space)
        exact.interpolate(lambda x: np.array((-x[1], x[0])))
        assert np.abs(u1.x.array - exact.x.array).max() <= SOLVED


def test_pieces_of_a_mesh_that_moved():
    """Ties hold what was there when they were made, in pieces as in one."""
    found = []
    for num in (1, 2):
        bodies = [rectangle((4, 2), (0, i), (1, i + 1)) for i in range(2)]
        parts = [tags(bodies[i], tag, num) for i, tag in enumerate((TOP, BOTTOM))]
        ties = [
            Tie(*((body.V, f) for body, f in zip(bodies, pair, strict=True)))
            for pair in zip(*parts, strict=True)
        ]
        for body in bodies:
            body.mesh.geometry.x[:, 1] += 0.6 * body.mesh.geometry.x[:, 0] ** 2
        p = problem(bodies, ties, [(0, TOP), (1, BOTTOM)], [(0, BOTTOM, (0, 1))])
        p.solve()
        assert len(p._pieces.interfaces) == num
        found.append(np.concatenate([u.x.array for u in p.u]))
    assert np.abs(found[0] - found[1]).max() <= 0.05


def test_messages_name_the_users_ties():
    bodies = [rectangle((4, 2), (0, i), (1, i + 1)) for i in range(3)]
    halves = [tags(bodies[i], tag, 2) for i, tag in enumerate((TOP, BOTTOM))]
    ties = [Tie((bodies[0].V, a), (bodies[1].V, b)) for a, b in zip(*halves, strict=True)]
    other = rectangle((3, 2), (0, 2), (1, 3))
    ties.append(tie([bodies[1], other], (0, TOP), (1, BOTTOM)))
    with pytest.raises(
        ValueError,
        match=r"^Γ1 of tie 2 \(4 and 3 facets around \(0.5, 2\)\) is on a space that is in no form",
    ):
        problem(bodies, ties, [], [])
    with pytest.raises(ValueError, match="ties has a tuple: make each with Tie"):
        problem(bodies, [(bodies[0].V, bodies[1].V)], [], [])
