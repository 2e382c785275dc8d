# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Interfaces that end at something: free, on a symmetry plane, clamped on one side or on both."""

from itertools import combinations_with_replacement, product

from mpi4py import MPI

import helpers
import pytest
from assembly import bending, check, in_halves, linear, problem, rectangle, stretching, tie
from helpers import sweep, two_ranks

from hypergap_dolfinx import InterfaceError, InvertedCellError, Tie
from meshes import BOTTOM, LEFT, RIGHT, TOP

comm = MPI.COMM_WORLD
T, Q = "triangle", "quadrilateral"
ELEMENTS = {
    "P1": ((T, 1), (T, 1)),
    "Q1": ((Q, 1), (Q, 1)),
    "P2": ((T, 2), (T, 2)),
    "P1-P2": ((T, 1), (T, 2)),
    "Q3": ((Q, 3), (Q, 3)),
}
# Q1 is as P1 and P2 is between P1 and Q3. The algebra is the same on several ranks: one pair of
# elements shows what ranks change
SOME = [*ELEMENTS] if helpers.thorough else ["P1", "P1-P2", "Q3"]
NAMES = SOME if comm.size == 1 else ["P1-P2"]
ENDS = ("free", "symmetry", "clamp0", "clamp1", "both")
PAIRS = [*combinations_with_replacement(ENDS, 2)]
TIED = [(0, TOP), (1, BOTTOM)]


def prescribed(end, tag):
    """What is prescribed beside one end of the interface: body, tag, components."""
    return {
        "free": [],
        "symmetry": [(0, tag, (0,)), (1, tag, (0,))],
        "clamp0": [(0, tag, (0, 1))],
        "clamp1": [(1, tag, (0, 1))],
        "both": [(0, tag, (0, 1)), (1, tag, (0, 1))],
    }[end]


def blocks(name, ratio):
    """A block on another, with as many cells along the interface as the ratio says."""
    corners = (((0, 0), (1, 0.5)), ((0, 0.5), (1, 1)))
    return [
        rectangle((n, 2), *corner, cell=cell, degree=degree)
        for n, corner, (cell, degree) in zip(ratio, corners, ELEMENTS[name], strict=True)
    ]


@pytest.mark.ranks(2, name=["P1-P2"])
@pytest.mark.parametrize(("name", "ends"), sweep(product(NAMES, PAIRS), 4))
def test_ends(name, ends):
    """Non-zero displacements are prescribed, those of the patch test."""
    ratios = ((1, 1), (2, 3), (5, 1), (1, 5)) if comm.size == 1 else ((2, 3),)
    if name in ("Q1", "Q3"):  # as P1 and P2, with one dof more or less
        ratios = ratios[1::2]
    for ratio in sweep(ratios, 2):
        if ratio == (1, 1) and "1" in name and not {"free", "clamp0", "clamp1"} & {*ends}:
            continue  # both sides of every node are prescribed: nothing is tied
        bodies = blocks(name, ratio)
        fixed = [(0, BOTTOM, (0, 1))] if comm.size == 1 or ends == ("free", "free") else []
        fixed += prescribed(ends[0], LEFT) + prescribed(ends[1], RIGHT)
        if not any(len(components) == 2 for _, _, components in fixed):
            fixed += [(0, BOTTOM, (1,))]
        exact = bending if name in ("P2", "Q3") else linear
        for sides in (TIED, TIED[::-1]):
            check(bodies, [tie(bodies, *sides)], TIED, fixed, exact)


@two_ranks(name=["P1-P2"])
@pytest.mark.parametrize(("swap", "name"), sweep(product((False, True), NAMES), 2))
def test_clamp(name, swap):
    """Held at u = 0 beside the interface's end, by nothing else."""
    for end, ratio in product(("clamp0", "clamp1", "both"), ((1, 1), (2, 3), (4, 4))):
        bodies = blocks(name, ratio)
        ties = [tie(bodies, *(TIED[::-1] if swap else TIED))]
        check(bodies, ties, TIED, prescribed(end, LEFT), stretching)


@two_ranks()
def test_all_of_one_side_is_prescribed():
    """As Γ0 it ties; as Γ1, the side to be constrained, it can't, and the message says so."""
    bodies, fixed = blocks("P2", (20, 30)), [(0, TOP, (0, 1))]
    check(bodies, [tie(bodies, *TIED)], TIED, fixed, bending)
    ties = [tie(bodies, *TIED[::-1])]
    with pytest.raises(InterfaceError, match=r"prescribed on whole facets.*swap the sides"):
        problem(bodies, ties, TIED, fixed, bending)


def test_how_small_a_side_that_is_prescribed_may_be():
    """With at most 32 nodes Γ1 keeps its multipliers; the docstring of Tie says so."""
    for num in (31, 32):
        bodies = blocks("P1", (num, 40))
        ties, fixed = [tie(bodies, *TIED[::-1])], [(0, TOP, (0, 1))]
        if num == 31:
            problem(bodies, ties, TIED, fixed, linear)
            continue
        with pytest.raises(InterfaceError, match=r"66 displacements .* prescribed on whole facets"):
            problem(bodies, ties, TIED, fixed, linear)


@two_ranks(pieces=[2])
@pytest.mark.parametrize("pieces", (1, 2))
def test_between_leaves_sides_to_the_problem(pieces):
    """The coarser side can't be Γ1 if all of it is prescribed: the other one is, jump and all."""
    bodies, fixed = blocks("P2", (20, 30)), [(0, TOP, (0, 1))]
    sides = (
        in_halves(bodies, TIED, 0.5)
        if pieces == 2
        else [[(bodies[i].V, bodies[i].facets(tag)) for i, tag in TIED]]
    )
    ties = [Tie.between(*pair, jump=(0.0, 0.0)) for pair in sides]
    assert all(t.swapped for t in ties)
    check(bodies, ties, TIED, fixed, bending)
    assert not any(t.swapped for t in ties)
    assert [t.spaces for t in ties] == [(bodies[0].V, bodies[1].V)] * pieces
    # Settled: another problem doesn't take the tie from this one
    with pytest.raises(InterfaceError, match=r"prescribed on whole facets.*swap the sides"):
        problem(bodies, ties, TIED, [(1, BOTTOM, (0, 1))], bending)


def test_both_sides_of_between_are_refused():
    """All of Γ1 is prescribed, and Γ0 as Γ1 gives no Σ."""
    bodies, fixed = blocks("P2", (20, 30)), [(0, TOP, (0, 1))]
    t = Tie.between(*((bodies[i].V, bodies[i].facets(tag)) for i, tag in TIED))

    def fails(why):
        raise InvertedCellError("no Σ")

    t._other = fails
    with pytest.raises(InterfaceError, match=r"prescribed on whole facets.*swap the sides"):
        problem(bodies, [t], TIED, fixed, bending)
    assert t.swapped


@pytest.mark.ranks(ratio=[(1, 5)])
@pytest.mark.parametrize("ratio", ((1, 5), (3, 2), (3, 3), (5, 1)))
def test_all_of_a_small_side_is_prescribed(ratio):
    bodies, fixed = blocks("P2", ratio), [(0, TOP, (0, 1))]
    check(bodies, [tie(bodies, *TIED[::-1])], TIED, fixed, bending)


@two_ranks(components=[(0, 1)])
@pytest.mark.parametrize("components", ((0,), (1,), (0, 1)))
@pytest.mark.parametrize("swap", (False, True))
def test_free_interior(swap, components):
    """The paper's form: interior nodes are unknowns with rows of their own."""
    bodies = blocks("P2", (2, 3))
    fixed = [(0, BOTTOM, (0, 1))] + [(i, LEFT, components) for i in (0, 1)]
    ties = [tie(bodies, *(TIED[::-1] if swap else TIED), interior="free")]
    p = problem(bodies, ties, TIED, fixed, bending)
    p.solve()
    check(bodies, ties, TIED, fixed, bending, rank=False)
