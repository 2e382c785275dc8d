# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Equilibria at kinks of gaps, to which the forces on both sides lead back."""

import runpy
from pathlib import Path
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem, la
from hypergap_dolfinx.contact_solver.continuation import Kink

comm = MPI.COMM_WORLD


@pytest.mark.ranks(2)
def test_corner_held_by_a_node():
    """A die's corner stays where an edge of Γ1 begins to see it: no step from a side ends there."""
    demo = runpy.run_path(str(Path(__file__).parents[2] / "demos" / "ironing.py"))
    scene = demo["Ironing"](comm, degree=2, flat=True, friction=0.3)
    problem = scene.problem
    evaluate, hook = problem._evaluate, []  # displacements that data of forms are of

    def with_data_of_there(*args):
        np.testing.assert_array_equal(hook, np.concatenate([u.x.array for u in problem.u]))
        evaluate(*args)

    def before_step():
        hook[:] = np.concatenate([u.x.array for u in problem.u])

    problem._hooks._hooks["before_step"], problem._evaluate = before_step, with_data_of_there
    for down in (0.55, 0.575):
        scene.goal.value[1] = -down * demo["H"]
        force = scene.solve()
        assert problem.halvings == 0
    assert problem._kink.is_held
    rows = problem.rows(scene.contact)
    assert (rows.state.p >= 0).all()
    assert (np.abs(rows.state.q) <= 0.3 * rows.pressed + 1e-12).all()
    bodies = problem.F[::-1], problem.u[::-1]  # Γ0 is the die
    every = zip(*bodies, rows.sides, rows.contact_forces(), strict=True)
    for F, u, side, of_contact in every:  # forces are what the bodies resist
        b = fem.assemble_vector(fem.form(F))
        b.scatter_reverse(la.InsertMode.add)
        start, end = u.function_space.dofmap.index_map.local_range
        mine = (side.dofs >= start) & (side.dofs < end)
        left = b.array.reshape(-1, 2)[side.dofs[mine] - start] - of_contact[mine]
        assert np.abs(left).max(initial=0) <= 1e-11 * np.linalg.norm(force)


def test_forces_at_a_kink_are_of_a_solution():
    """Where no share of both sides' forces leads to the kink, the last one that was solved with."""
    kink, shares = Kink([SimpleNamespace(u=[np.zeros(1)])], lambda values: None), []
    kink.is_held, kink._share, kink._slope, kink._least = True, 0.5, 1.0, 0.0
    kink._at, kink._jump, kink._mix = np.zeros(1), np.ones(1), shares.append
    place = kink.solved(
        lambda: 1.0 if shares[-1] < 0.3 else -1.0,  # solutions jump over it
        lambda place: [(np.array([place]),)],
    )
    assert kink.is_held and kink._share == shares[-1] and len(shares) > 2
    assert abs(place) == 1
