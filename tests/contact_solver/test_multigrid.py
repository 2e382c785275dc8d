# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact by multigrid: the state that factors give, few iterations; told where it isn't for."""

import logging
import re
import runpy
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import hertz
import numpy as np
import pytest
from assembly import Elastic, lame_constants
from helpers import ranks_at_last, sweep, thorough

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import Contact, ContactProblem, SolveError, Tie
from hypergap_dolfinx.contact_solver import (
    contact_system,
    multigrid_tangent,
    tangent,
)
from hypergap_dolfinx.contact_solver.linearised import LinearisedContact
from hypergap_dolfinx.contact_solver.multigrid_tangent import IterationFailed, MultigridTangent
from hypergap_dolfinx.contact_solver.tangent import Tangent
from hypergap_dolfinx.solvers.multigrid import Multigrid
from hypergap_dolfinx.solvers.system import TiedSystem

comm = MPI.COMM_WORLD


def block(n, low, high, E=1.0, *, degree=1, large=False, bulge=0.0, loaded=False):
    """A block between two corners, of which the bottom may be round; its body and facet tags."""
    low, high = np.array(low), np.array(high)

    def place(x):
        at = low + x * (high - low)
        off = ((x[:, :2] - 0.5) ** 2).sum(axis=1)
        at[:, 2] += bulge * off * (1 - x[:, 2])
        return at

    mesh, ft = meshes.block(comm, n, place, cell="hexahedron", degree=degree)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    facets = ft.find(meshes.FRONT) if loaded else ()
    return Elastic.on(V, lame_constants(E), large=large, loaded=facets), ft


class Pressed:
    """A round block pressed on a flat one, from apart; the upper one is free or moved."""

    def __init__(
        self,
        n=4,
        contrast=1.0,
        *,
        free=False,
        tied=False,
        degree=1,
        large=False,
        repelled=0.0,
        **more,
    ):
        options = {"degree": degree, "large": large}
        low, low_tags = block((n, n, n), (-1, -1, -1), (1, 1, 0), contrast, **options)
        size = (n - 1,) * 2 + (max(n // 2, 2),)
        top = 1.0 if not tied else 0.5
        high, tags = block(
            size, (-0.77, -0.75, 0), (0.83, 0.85, top), bulge=0.2, loaded=not tied, **options
        )
        bodies, self.load = [low, high], high.load
        V, W = low.u.function_space, high.u.function_space
        self.u, ties = [low.u, high.u], []
        last, last_tags = high, tags
        if tied:
            last, last_tags = block(
                (n, n, 2), (-0.77, -0.75, top), (0.83, 0.85, 1), loaded=True, **options
            )
            bodies.append(last)
            self.u.append(last.u)
            self.load = last.load
            ties = [
                Tie(
                    (W, tags.find(meshes.FRONT)),
                    (last.u.function_space, last_tags.find(meshes.BACK)),
                )
            ]
        self.bcs, self.move = [], fem.Constant(V.mesh, default_scalar_type((0, 0, 0)))
        self.hold(V, low_tags.find(meshes.BACK), range(3))
        self.values = []
        if free:  # but for what contact can't hold without friction
            for body, ft in zip(bodies[1:], (tags, last_tags), strict=False):
                sides = np.concatenate([ft.find(t) for t in (meshes.LEFT, meshes.RIGHT)])
                self.hold(body.u.function_space, sides, (0,))
                sides = np.concatenate([ft.find(t) for t in (meshes.BOTTOM, meshes.TOP)])
                self.hold(body.u.function_space, sides, (1,))
        else:
            self.values = self.hold(last.u.function_space, last_tags.find(meshes.FRONT), range(3))
        self.sides = (V, low_tags.find(meshes.FRONT)), (W, tags.find(meshes.BACK))
        names = ("friction", "elastic_slip", "sliding", "compliance")
        self.contact = Contact(*self.sides, **{k: more.pop(k) for k in names if k in more})
        if repelled:
            repelled = fem.Constant(V.mesh, default_scalar_type(repelled))
            low.F -= repelled * ufl.inner(low.u, ufl.TestFunction(V)) * ufl.dx(V.mesh)
        self.F = [body.F for body in bodies]
        self.problem = ContactProblem(
            self.F,
            self.u,
            bcs=self.bcs,
            contacts=[self.contact],
            ties=ties,
            **more,
        )

    def hold(self, V, facets, components):
        """Hold components where facets are; the values, for the user to change."""
        values = []
        for k in components:
            values.append(fem.Constant(V.mesh, default_scalar_type(0)))
            dofs = fem.locate_dofs_topological(V.sub(k), 2, np.sort(facets))
            self.bcs.append(fem.dirichletbc(values[-1], dofs, V.sub(k)))
        return values

    def solve(self, path):
        """Go to places of the top, or loads on it; Newton steps."""
        steps = []
        for goal in path:
            if self.values:
                for value, x in zip(self.values, goal, strict=True):
                    value.value = x
            else:
                self.load.value = goal
            self.problem.solve()
            steps.append(self.problem.iterations)
        return steps


DOWN = ((0, 0, -0.03), (0, 0, -0.08))
ACROSS = ((0, 0, -0.08), (0.05, 0.02, -0.08))
SCENES = {
    "finite": ({}, DOWN),
    "small": ({"sliding": "small"}, DOWN),
    "free": ({"free": True}, (0.01, 0.02)),
    "free with a tie": ({"free": True, "tied": True}, (0.01, 0.02)),
    "soft above": ({"contrast": 1e4}, DOWN),
    "stiff above": ({"contrast": 1e-3}, DOWN),
    "far stiffer above": ({"contrast": 1e-6, "tied": True}, DOWN),
    "friction": ({"friction": 0.3}, ACROSS),
    "friction, free": ({"friction": 0.3, "free": True}, (0.01, 0.02)),
    "elastic slip": ({"friction": 0.3, "elastic_slip": 0.01}, ACROSS),
    "large strain": ({"large": True, "friction": 0.3, "n": 3}, ACROSS),
    "degree 2": ({"degree": 2, "n": 3}, DOWN[1:]),
}


ON_RANKS = "free with a tie", *["friction"] * (comm.size == 2), *["finite"] * thorough
"""On three ranks the scene with rows of contact and of a tie."""


@pytest.mark.ranks(3, name=ON_RANKS)
@pytest.mark.parametrize("name", SCENES)
def test_as_with_factors(name):
    """Sets, pressures and displacements; Newton steps: at most one more."""
    options, path = SCENES[name]
    scenes = [Pressed(**options, solver=solver) for solver in ("direct", "iterative")]
    steps = [scene.solve(path) for scene in scenes]
    assert scenes[1].problem.halvings == 0
    assert (np.array(steps[1]) <= np.array(steps[0]) + 1).all(), str(steps)
    assert not isinstance(scenes[1].problem._tangent, Tangent)
    rows = [scene.problem.rows(scene.contact) for scene in scenes]
    assert rows[0].state.active.any()
    assert (rows[0].state.active == rows[1].state.active).all()
    pressures = [part.state.p for part in rows]
    np.testing.assert_allclose(*pressures, atol=1e-7 * pressures[0].max())
    for u, v in zip(*(scene.u for scene in scenes), strict=True):
        size = comm.allreduce(np.abs(u.x.array).max(initial=0), MPI.MAX)
        np.testing.assert_allclose(u.x.array, v.x.array, atol=1e-7 * size)


@pytest.fixture
def counted(monkeypatch):
    """Numbers of iterations of accurate solves, by the residual's fall."""
    found = []
    solve = contact_system.MultigridTangent._solved

    def solved(self, *args, **options):
        before = self.iterations
        result = solve(self, *args, **options)
        found.append(self.iterations - before)
        return result

    monkeypatch.setattr(contact_system.MultigridTangent, "_solved", solved)
    return found


def test_iterations(counted):
    """As few on a finer mesh, with any contrast, and of a body that only contact holds.

    Guesses of sets take few of them.
    """
    most, sums = [], []
    for n, contrast, free in ((4, 1, False), (7, 1, False), (7, 1e4, False), (7, 1e-4, True)):
        counted.clear()
        Pressed(n, contrast, free=free, solver="iterative").solve((1e-6,) if free else DOWN[1:])
        most.append(max(counted))
        sums.append(sum(counted))
    assert max(most) <= 22, str(most)
    assert sums[1] <= 64, str(sums)  # 55; with a thousandth of the residual for each guess 76


ROUGH = (0.1, 0.5), (0.1, 0.9), (0.1, 0.3), (0.3, 0.5), (0.3, 0.9), (0.3, 0.3)


@ranks_at_last(friction=[0.3], rough=[0.5])
@pytest.mark.parametrize(("friction", "rough"), sweep(ROUGH, 3))
def test_rough_guesses_with_friction(monkeypatch, friction, rough):
    """Laws of friction are linearised at each guess: how rough guesses are doesn't matter."""
    monkeypatch.setattr(multigrid_tangent, "ROUGH", rough)
    scene = Pressed(7, friction=friction, large=True, solver="iterative")
    steps = scene.solve(ACROSS)
    assert max(steps) <= 5 and scene.problem.halvings == 0, str(steps)  # with factors 4 and 4
    assert scene.problem._tangent.iterations <= 300


def test_few_iterations_for_each_set(monkeypatch):
    """Of many working sets that differ little each needs about one iteration for its signs."""
    pytest.importorskip("gmsh")
    monkeypatch.setattr(contact_system, "LARGE_CONTACT", 0)
    problem, _ = hertz.press(comm, hertz.a / 6, 1, 2 / 3, False, dim=3)
    assert problem._tangent.iterations <= 50  # 41; 62 if springs are renewed for a quarter of rows


@pytest.mark.ranks(2)
def test_neighbours_of_what_pulls():
    """A ring around what pulls opens with it in guesses; nothing does where all presses."""
    scene = Pressed(6, solver="iterative")
    scene.solve(DOWN[1:])
    rows = scene.problem.rows(scene.contact)
    closed = np.flatnonzero(rows.state.active)
    f = np.where(rows.state.active, 1.0, 0.0)
    assert not rows.pulled(f).any() and len(closed) > 9
    x = rows.sides[1].reference.x
    place = closed[np.linalg.norm(x[closed] - x[closed].mean(axis=0), axis=1).argmin()]
    f[place] = -100.0
    found = np.flatnonzero(rows.pulled(f))
    assert 4 < len(found) <= len(closed) and place in found
    f[place] = -0.01
    assert not rows.pulled(f).any()


def test_linear_bodies_are_assembled_once(monkeypatch):
    """Multigrid changes no stiffness."""
    numbers, assemble = [], TiedSystem._assemble

    def assembled(self, i):
        numbers.append(i)
        return assemble(self, i)

    pytest.importorskip("gmsh")
    monkeypatch.setattr(TiedSystem, "_assemble", assembled)
    monkeypatch.setattr(contact_system, "LARGE_CONTACT", 0)
    problem, _ = hertz.press(comm, hertz.a / 2, 1, 2 / 3, False, dim=3)
    assert isinstance(problem._tangent, MultigridTangent)
    assert sorted(numbers) == [0, 1]


@pytest.mark.ranks(2)
def test_linear_problems_take_one_step():
    """Multigrid solves as accurately as rtol asks for, as factors do."""
    scene = Pressed(4, sliding="small", rtol=1e-12, solver="iterative")
    assert scene.solve(DOWN[1:2]) == [1]


TURNS = (*DOWN[1:], (0.05, 0.02, -0.08), (0.05, -0.05, -0.08))


@pytest.mark.parametrize("solver", ["direct", "iterative"])
@pytest.mark.parametrize("soft", [0, 0.01])
def test_linear_problems_with_friction_take_one_step(solver, soft):
    """Tractions that turn where they slip, or grow with elastic slip, are found in it."""
    options = {"sliding": "small", "friction": 0.3, "elastic_slip": soft}
    scene = Pressed(3, rtol=1e-12, solver=solver, **options)
    assert scene.solve(TURNS) == [1, 1, 1]
    assert scene.contact.slipping.any()


@pytest.mark.parametrize("degree", [1, 2])
def test_prescribed_displacements_take_one_step(degree):
    """Also where prescribed displacements are far larger loads than contact's forces."""
    scene, forms = Pressed(3, 1e-3, degree=degree), []
    for u, stiffness in zip(scene.u, (1e-3, 1), strict=True):
        v = ufl.TestFunction(u.function_space)
        strain, of_v = (ufl.sym(ufl.grad(w)) for w in (u, v))
        forms.append(stiffness * (ufl.inner(strain, of_v) + ufl.div(u) * ufl.div(v)) * ufl.dx)
    given = {"bcs": scene.bcs, "contacts": [Contact(*scene.sides, sliding="small")]}
    scene.problem = ContactProblem(forms, scene.u, **given, solver="iterative")
    assert scene.solve(DOWN) == [1, 1]


ELASTIC = (0, 0, -0.06), (0.02, 0.01, -0.06)


def test_guesses_with_elastic_slip():
    """They end: what slips along its traction, beyond the elastic slip, sticks next."""
    scene = Pressed(4, friction=0.1, elastic_slip=1e-3, solver="iterative")
    scene.solve(ELASTIC)
    assert scene.problem.solver_name == "iterative"


def test_held_by_slip():
    """Multigrid knows what turning tractions hold, beside what slips against them."""
    scene = Pressed(free=True)
    contact = Contact(*scene.sides, friction=0.02)
    held = scene.bcs[:3]  # the lower block
    given = {"bcs": held, "contacts": [contact], "solver": "iterative"}
    scene.problem = ContactProblem(scene.F, scene.u, **given)
    assert max(scene.solve((0.05,))) <= 5 and scene.problem.solver_name == "iterative"
    assert contact.slipping.sum() > contact.sticking.sum()


def test_many_laws_in_several_steps(monkeypatch):
    """Many laws are linearised in their states, with the same result."""
    scenes = []
    for least in (0, tangent.GUESSED):
        monkeypatch.setattr(tangent, "GUESSED", least)
        scenes.append(Pressed(3, sliding="small", friction=0.3, solver="direct"))
        scenes[-1].steps = scenes[-1].solve(TURNS)
    assert max(scenes[0].steps) > 1 == max(scenes[1].steps)
    p, q = (scene.contact.rows.state.p for scene in scenes)
    np.testing.assert_allclose(p, q, atol=1e-7 * q.max())


def test_work_of_a_step():
    """It is that of the stiffness, without what friction that is eliminated adds."""
    found = []
    for solver in ("direct", "iterative"):
        scene = Pressed(3, friction=0.8, solver=solver)
        scene.solve(ACROSS[1:])
        rng, problem = np.random.default_rng(0), scene.problem
        changes = [~held * rng.standard_normal(len(held)) for held in problem._held]
        found.append(problem._tangent.work(changes))
    np.testing.assert_allclose(*found, rtol=1e-6)


@pytest.mark.ranks(2)
def test_symmetric_with_any_set():
    """Conjugate gradients need a symmetric preconditioner of projected residuals with any set."""
    scene = Pressed(7, solver="iterative")
    scene.solve(DOWN)
    ksp, projection = scene.problem._tangent._ksp, scene.problem._tangent._projection
    x, y, z = (ksp.getOperators()[0].createVecRight() for _ in range(3))
    rng = np.random.default_rng(comm.rank)
    for vector in (x, y):
        vector.array[:] = rng.standard_normal(len(vector.array_r))
        projection.project_transpose(vector)
    products = []
    for a, b in ((x, y), (y, x), (x, x)):
        ksp.getPC().apply(a, z)
        products.append(z.dot(b))
    assert abs(products[0] - products[1]) <= 1e-13 * products[2]  # 4e-3 with old residuals


@pytest.mark.ranks(2)
def test_gives_up(caplog, monkeypatch):
    """What multigrid doesn't solve is solved with factors from then on, and told."""
    monkeypatch.setattr(Multigrid, "OPTIONS", {**Multigrid.OPTIONS, "ksp_rtol": 1e-10})
    scene = Pressed(3, solver="iterative", petsc_options={"ksp_max_it": 2})
    reference = Pressed(3, solver="direct")
    with caplog.at_level(logging.WARNING):
        scene.solve(DOWN)
    reference.solve(DOWN)
    assert isinstance(scene.problem._tangent, Tangent)
    told = [r.getMessage() for r in caplog.records if "given up" in r.getMessage()]
    assert len(told) == (comm.rank == 0)
    assert all(re.search("DIVERGED_MAX_IT.*mixed spaces", message) for message in told)
    for u, v in zip(scene.u, reference.u, strict=True):
        np.testing.assert_allclose(u.x.array, v.x.array, atol=1e-9)


@pytest.mark.ranks(2)
def test_why_it_is_given_up(caplog, monkeypatch):
    """What is known: bodies' stiffness isn't to blame once it has led to a solution."""
    scene = Pressed(3, solver="iterative")
    scene.solve(DOWN[:1])

    def fails(*args, **options):
        raise IterationFailed("it fails.")

    monkeypatch.setattr(MultigridTangent, "solve", fails)
    with caplog.at_level(logging.WARNING):
        scene.solve(DOWN[1:])
    told = [r.getMessage() for r in caplog.records if "given up" in r.getMessage()]
    text = 'contact: solver="iterative" is given up for "direct": it fails; name solver="direct" to'
    assert told == [f"{text} save its iterations."] * (comm.rank == 0)


@pytest.mark.ranks(2)
@pytest.mark.parametrize("friction", (0.1, 1.0))
def test_held_by_friction_that_slips(friction):
    """A block that is pressed on a stiffer one, and that nothing else holds."""
    low, low_tags = block((5, 5, 3), (-1, -1, -1), (1, 1, 0))
    high, tags = block((3, 3, 2), (-0.6, -0.6, 0), (0.5, 0.5, 0.5), 0.01, loaded=True)
    V = low.u.function_space
    dofs = fem.locate_dofs_topological(V, 2, low_tags.find(meshes.BACK))
    bcs = [fem.dirichletbc(np.zeros(3, dtype=default_scalar_type), dofs, V)]
    upper = high.u.function_space, tags.find(meshes.BACK)
    contact = Contact((V, low_tags.find(meshes.FRONT)), upper, friction=friction)
    problem = ContactProblem([low.F, high.F], [low.u, high.u], bcs=bcs, contacts=[contact])
    high.load.value = 1e-6
    problem.solve()
    told = problem._held_by_slip()
    assert told.startswith("body 1, at (-0.05, -0.05, 0.25)") if friction < 1 else not told
    assert contact.sticking.any() == (friction == 1)


@pytest.mark.ranks(2)
def test_factors_start_from_the_sets_of_the_step(monkeypatch):
    """Not from those that multigrid guessed in vain, and without its many guesses."""
    found, solve = [], LinearisedContact._solve

    def solved(self, right, num, shift, guesses):
        found.append((type(self._tangent), guesses.least, self._on.copy()))
        if len(found) == 3:
            raise IterationFailed("it is given up")
        return solve(self, right, num, shift, guesses)

    monkeypatch.setattr(LinearisedContact, "_solve", solved)
    Pressed(4, free=True, solver="iterative").solve((0.01,))
    (_, _, first), (_, _, guess), _, (kind, least, again) = found[:4]
    assert (first != guess).any() and kind is Tangent
    assert (first == again).all() and least == tangent.GUESSED


@pytest.mark.ranks(2)
def test_few_columns(monkeypatch):
    """Those of a Newton step take no more iterations than a solve may; that they would is seen."""
    scene = Pressed(4, solver="iterative", petsc_options={"ksp_max_it": 60})
    scene.solve(DOWN)
    tangent, rows = scene.problem._tangent, scene.problem.rows(scene.contact)
    loads = tangent.watch([rows.loads()], [rows.num_unknowns])
    every = np.flatnonzero(rows.valid)

    def taken(numbers):
        before = tangent.iterations
        tangent.responses(loads, numbers)
        return tangent.iterations - before

    tangent.guesses()
    of_one, total = taken(every[:1]), 0
    with pytest.raises(IterationFailed, match=r"more than 60 iterations \(ksp_max_it\)"):
        for number in every[1:]:
            total += taken(np.array([number]))
    assert 60 - 3 * of_one <= total <= 60
    tangent.guesses()
    before = tangent.iterations
    with pytest.raises(IterationFailed, match="would take more"):
        tangent.responses(loads, every)
    assert tangent.iterations - before <= 3 * of_one < 60


@pytest.mark.ranks(2)
def test_no_equilibrium_with_multigrid(caplog, monkeypatch):
    """A load step that multigrid doesn't solve, halved or not, is solved with factors, told."""
    newton = ContactProblem._newton

    def fails(self, ahead=None):
        if isinstance(self._tangent, MultigridTangent):
            raise SolveError("no equilibrium")
        return newton(self, ahead)

    monkeypatch.setattr(ContactProblem, "_newton", fails)
    scenes = [Pressed(3, solver=s) for s in ("direct", "iterative")]
    for scene in scenes:
        scene.solve(DOWN)
    told = [r.getMessage() for r in caplog.records if "no equilibrium is found" in r.getMessage()]
    assert len(told) == (comm.rank == 0) and scenes[1].problem.solver_name == "direct"
    for u, v in zip(*(scene.u for scene in scenes), strict=True):
        np.testing.assert_allclose(u.x.array, v.x.array, atol=1e-9)


def test_guess_that_isnt_positive():
    """A die is drawn on: the matrix of a guessed set isn't positive, and a share of K is added."""
    demo = runpy.run_path(str(Path(__file__).parents[2] / "demos" / "large_contact.py"))
    problem, _, goal, path = demo["make"](comm, "ironing", 0, "iterative", 0.3)
    for at in path[:5]:
        goal.value[:] = at
        problem.solve()
        assert problem.iterations <= 12 and not problem.halvings
    assert isinstance(problem._tangent, MultigridTangent)


@pytest.mark.ranks(2, repelled=[2.0])
@pytest.mark.parametrize("repelled", (1.0, 2.0, 400.0))
def test_stiffness_that_isnt_definite(caplog, repelled):
    """A body on springs that push it on, also with a negative diagonal: factors solve, told."""
    scenes = [Pressed(3, repelled=repelled, solver=s) for s in ("direct", "iterative")]
    with caplog.at_level(logging.WARNING):
        steps = [scene.solve(DOWN) for scene in scenes]
    told = [r.getMessage() for r in caplog.records if "given up" in r.getMessage()]
    assert len(told) == (comm.rank == 0) and scenes[1].problem.halvings == 0
    assert steps[0] == steps[1] and isinstance(scenes[1].problem._tangent, Tangent)
    for u, v in zip(*(scene.u for scene in scenes), strict=True):
        np.testing.assert_allclose(u.x.array, v.x.array, atol=1e-9)


@pytest.mark.ranks(2)
def test_the_default(monkeypatch):
    """Multigrid from some size on, in space, if possible, without friction or types in options."""
    small = Pressed(3)
    assert isinstance(small.problem._tangent, Tangent)
    monkeypatch.setattr(contact_system, "LARGE_CONTACT", 100)
    assert not isinstance(Pressed(3).problem._tangent, Tangent)
    for options in ({"compliance": 0.1}, {"friction": 0.3}, {"petsc_options": {"pc_type": "lu"}}):
        assert isinstance(Pressed(3, **options).problem._tangent, Tangent)
    with pytest.raises(ValueError, match='"iterative" is not possible: a contact has a compl'):
        Pressed(3, solver="iterative", compliance=0.1)
    with pytest.raises(ValueError, match="solver is one of direct, iterative, not 'lu'"):
        Pressed(3, solver="lu")


@pytest.mark.ranks(2)
def test_misspelt_options(caplog):
    """PETSc doesn't know of them, and says nothing; petsc4py of Debian 13 can't tell."""
    options = {"ksp_mintor": None, "pc_mg_cycle_type": "v"}
    with caplog.at_level(logging.WARNING):
        Pressed(3, solver="iterative", petsc_options=options).solve(DOWN[:1])
    told = [r.getMessage() for r in caplog.records if "misspelt" in r.getMessage()]
    assert len(told) == (comm.rank == 0 and hasattr(PETSc.Options, "used"))
    assert all("hypergap_ksp_mintor;" in message for message in told)


@pytest.mark.ranks(2)
def test_a_solver_that_fails():
    """It ends at once, without MUMPS's settings; no smaller load step is tried."""
    scene = Pressed(3, petsc_options={"ksp_type": "gmres", "pc_type": "none", "ksp_max_it": 20})
    with pytest.raises(SolveError, match="DIVERGED_MAX_IT"):
        scene.solve(DOWN)
    assert scene.problem.halvings == 0
    assert not any("mumps" in key for key in scene.problem._tangent._ways[0].options._options)
