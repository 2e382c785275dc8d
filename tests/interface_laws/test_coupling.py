# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Couplings of a surface with a point: exact solutions, balance, rigid sections, messages."""

from contextlib import nullcontext
from itertools import product, zip_longest

from mpi4py import MPI

import numpy as np
import pytest
from assembly import NU, SOLVED, E, Elastic
from helpers import close, interpolated, raises, sweep

import meshes
import ufl
from dolfinx import fem, mesh
from hypergap_dolfinx import (
    Contact,
    ContactProblem,
    Coupling,
    InterfaceError,
    NonlinearTiedProblem,
    RigidBody,
    SolveError,
    Tie,
    TiedProblem,
)
from hypergap_dolfinx.core.rotation import rotation

comm = MPI.COMM_WORLD
BALANCED = 1e-10  # of the loads
pytestmark = pytest.mark.ranks(2)  # three: a linear, a nonlinear and a contact problem
KINDS = "distributing", "rigid"
CELLS = "triangle", "hexahedron", "tetrahedron"
EACH = sweep([(2, "rigid"), (2, "distributing"), (3, "distributing"), (3, "rigid")], 2)
"""Dimensions and kinds."""
FIRST = {2: (meshes.LEFT, meshes.RIGHT), 3: (meshes.BACK, meshes.FRONT)}


def elastic(V, nu=NU):
    """Bilinear form, of plane strain in the plane."""
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    eps, n = ufl.sym(ufl.grad(u)), V.mesh.geometry.dim
    stress = E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(n))
    return ufl.inner(stress, ufl.sym(ufl.grad(v))) * ufl.dx


def bar(dim, degree=1, low=None, cell=None, across=3):
    """A bar of length 2 along x (in space z), 1 × 1 across, as (space, tags)."""
    low = np.zeros(dim) if low is None else np.asarray(low, dtype=float)
    size = np.ones(dim)
    size[0 if dim == 2 else 2] = 2.0
    cell = cell or {2: "triangle", 3: "hexahedron"}[dim]
    n = (4, across) if dim == 2 else (2, across, 3)
    made, tags = meshes.block(comm, n, lambda s: low + size * s, cell=cell)
    return fem.functionspace(made, ("Lagrange", degree, (dim,))), tags


def held(V, facets, value=None, component=None):
    """Condition on facets: a displacement, or one component of 0."""
    fdim = V.mesh.topology.dim - 1
    if component is not None:
        dofs = fem.locate_dofs_topological(V.sub(component), fdim, facets)
        return fem.dirichletbc(0.0, dofs, V.sub(component))
    dofs = fem.locate_dofs_topological(V, fdim, facets)
    return fem.dirichletbc(value or fem.Function(V), dofs)


@pytest.mark.parametrize(("kind", "cell"), sweep(product(KINDS, CELLS), 2))
def test_pulled(kind, cell):
    """A bar with the same stress all along, by a force at any point and its torque."""
    dim = 2 if cell == "triangle" else 3
    nu = NU if kind == "distributing" else 0.0  # a rigid section doesn't contract
    V, tags = bar(dim, cell=cell)
    along = 0 if dim == 2 else 2
    sides = {along: FIRST[dim][0], 1: meshes.BOTTOM}
    if dim == 3:
        sides[0] = meshes.LEFT
    symmetric = [held(V, tags.find(tag), component=k) for k, tag in sides.items()]
    if kind == "rigid":  # conditions beside it hold what it can't follow
        symmetric = [held(V, tags.find(FIRST[dim][0]))]
    centre = np.full(dim, 0.5)
    centre[along] = 2.0
    point = centre + np.array([3.0, -2.0, 0.7])[:dim]
    end = Coupling((V, tags.find(FIRST[dim][1])), point=point, kind=kind)
    problem = TiedProblem([elastic(V, nu)], [None], bcs=symmetric, couplings=[end])
    end.force[along] = 0.3
    pad = np.zeros(3 - dim)
    moment = np.cross(np.append(centre - point, pad), np.append(end.force, pad))
    end.torque = moment[2:] if dim == 2 else moment
    (u,) = problem.solve()
    stiff, across = (E / (1 - nu**2), nu / (1 - nu)) if dim == 2 else (E, nu)

    def exact(x):
        found = -across * 0.3 / stiff * x[:dim]
        found[along] = 0.3 / stiff * x[along]
        return found

    close(u.x.array, interpolated(V, exact).x.array, SOLVED)
    at = exact(np.append(centre, pad))
    close(end.displacement, at, SOLVED)
    assert np.abs(end.angles).max() < SOLVED and not end.reaction.any()


@pytest.mark.ranks(2, kind=["rigid"], by=["angle"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("by", ["torque", "angle"])
def test_bent(kind, by):
    """Pure bending with elements of degree 2."""
    nu = NU if kind == "distributing" else 0.0
    V, tags = bar(2, 2, low=(0, -0.5))

    def exact(x):
        return np.vstack((x[0] * x[1], -(x[0] ** 2 + nu / (1 - nu) * x[1] ** 2) / 2))

    fixed = held(V, tags.find(meshes.LEFT), interpolated(V, exact))
    options = {"held": "rotation"} if by == "angle" else {}
    end = Coupling((V, tags.find(meshes.RIGHT)), point=(2, 0), kind=kind, **options)
    problem = TiedProblem([elastic(V, nu)], [None], bcs=[fixed], couplings=end)
    torque = -E / (1 - nu**2) / 12
    if by == "torque":
        end.torque = torque
    else:
        end.prescribed[2] = -2.0
    (u,) = problem.solve()
    close(u.x.array, interpolated(V, exact).x.array, SOLVED)
    close(end.angles, [-2.0], SOLVED)
    close(end.displacement, (0, -2 - nu / (1 - nu) / 24), SOLVED)
    close(end.reaction, (0, 0, torque if by == "angle" else 0), SOLVED)


def test_twisted():
    """A torque acts as the tractions of a round shaft: twist, with the walls of one."""
    V, tags = bar(3, low=(-0.5, -0.5, 0))

    def exact(x):
        return 0.3 * x[2] * np.stack((-x[1], x[0], 0 * x[2]))

    walls = meshes.LEFT, meshes.RIGHT, meshes.BOTTOM, meshes.TOP, meshes.BACK
    facets = np.sort(np.concatenate([tags.find(tag) for tag in walls]))
    end = Coupling((V, tags.find(meshes.FRONT)), point=(0, 0, 2), kind="distributing")
    fixed = held(V, facets, interpolated(V, exact))
    problem = TiedProblem([elastic(V)], [None], bcs=[fixed], couplings=[end])
    end.torque[2] = 0.3 * E / (2 * (1 + NU)) / 6
    (u,) = problem.solve()
    close(u.x.array, interpolated(V, exact).x.array, SOLVED)
    close(end.angles, (0, 0, 0.6), SOLVED)


def two_bars(dim, kind, held_parts=(), degree=1):
    """A bar that is clamped at its beginning, another one tied to it, coupled at its end."""
    far = np.zeros(dim)
    far[0 if dim == 2 else 2] = 2.0
    (V0, tags0), (V1, tags1) = bar(dim, degree), bar(dim, degree, low=far, across=2)
    first, last = FIRST[dim]
    tie = Tie((V0, tags0.find(last)), (V1, tags1.find(first)))
    point = 1.5 * far + 0.3
    end = Coupling((V1, tags1.find(last)), point=point, kind=kind, held=held_parts)
    problem = TiedProblem(
        [elastic(V0), elastic(V1)],
        [None, None],
        bcs=[held(V0, tags0.find(first))],
        ties=[tie],
        couplings=[end],
    )
    return problem, tie, end, tags1.find(last)


@pytest.mark.ranks
@pytest.mark.parametrize(("dim", "kind"), EACH)
def test_balance(kind, dim):
    """Forces and torques, reactions and springs are those of the tie below; work is symmetric."""
    names = {2: ("y", "rotation"), 3: ("y", "rx", "rz")}[dim]
    works = []
    for parts in ((), names):
        problem, tie, end, _ = two_bars(dim, kind, parts, degree=3 - (dim == 3))
        end.force = (0.01, 0.02, -0.03)[:dim]
        end.torque = 0.01 if dim == 2 else (0.03, -0.01, 0.02)
        end.springs[0], end.anchors[0] = 0.02, 0.3
        if parts:
            end.prescribed[end.held] = works[0][end.held]
        _, u1 = problem.solve()
        values = np.append(end.displacement, end.angles)
        loads = np.append(end.force, end.torque) + end.springs * (end.anchors - values)
        loads += end.reaction
        found = np.append(tie.force(problem, on=u1), tie.moment(problem, end.point, on=u1))
        assert np.abs(found + loads).max() < BALANCED * np.abs(loads).max()
        works.append(values)
    close(works[1], works[0], 1e-9)  # held where it went by itself: without reactions
    assert np.abs(end.reaction).max() < 1e-9


@pytest.mark.ranks(2, kind=["distributing"])
@pytest.mark.parametrize("kind", KINDS)
def test_held_by_a_coupling(kind):
    """All of it held, rigid: as a condition at each node; distributing: mean motions only."""
    problem, _, end, last = two_bars(2, kind, ("x", "y", "rotation"))
    end.prescribed = 0.01, -0.02, 0.03
    u0, u1 = problem.solve()
    close(np.append(end.displacement, end.angles), end.prescribed, 1e-12)
    V = u1.function_space

    def motion(x):
        a, b = x[0] - end.point[0], x[1] - end.point[1]
        return np.stack((0.01 - 0.03 * b, -0.02 + 0.03 * a))

    dofs = fem.locate_dofs_topological(V, 1, last)
    off = np.abs((u1.x.array - interpolated(V, motion).x.array).reshape(-1, 2)[dofs])
    off = comm.allreduce(off.max(initial=0), MPI.MAX)
    if kind == "distributing":
        assert off > 1e-4
        return
    assert off < SOLVED
    V0 = u0.function_space
    left = mesh.locate_entities_boundary(V0.mesh, 1, lambda x: np.isclose(x[0], 0))
    fixed = [held(V0, left), fem.dirichletbc(interpolated(V, motion), dofs)]
    again = TiedProblem([elastic(V0), elastic(V)], [None] * 2, bcs=fixed, ties=problem.ties)
    close(again.solve()[1].x.array, u1.x.array, SOLVED)


@pytest.mark.parametrize("kind", KINDS)
def test_several_surfaces(kind):
    """A list of surfaces is one; parts of a mesh that nothing connects move together."""
    V, tags = bar(2)
    right, top = tags.find(meshes.RIGHT), tags.find(meshes.TOP)
    top = top[mesh.compute_midpoints(V.mesh, 1, top)[:, 0] > 0.6]
    fixed, found = [held(V, tags.find(meshes.LEFT))], []
    for side in ([(V, right), (V, top)], (V, np.sort(np.append(right, top)))):
        end = Coupling(side, point=(3, 1), kind=kind)
        problem = TiedProblem([elastic(V)], [None], bcs=fixed, couplings=end)
        end.force[1], end.torque[0] = 1e-3, 1e-3
        problem.solve()
        found.append(np.append(end.displacement, end.angles))
    np.testing.assert_allclose(*found, rtol=1e-12)
    with raises(ValueError, "on several meshes: put these bodies into one"):
        Coupling([(V, right), (bar(2)[0], right)], point=(2, 0), kind=kind)
    again = fem.functionspace(V.mesh, ("Lagrange", 1, (2,)))
    with raises(ValueError, "on several function spaces of one mesh: give all .* the same space"):
        Coupling([(V, right), (again, top)], point=(2, 0), kind=kind)
    for facets in 3, None, "left", top[None], [[1], [1, 2]]:
        with raises(InterfaceError, "the facets of the surface of a coupling must be a flat array"):
            Coupling([(V, right), (V, facets)], point=(2, 0), kind=kind)
    with raises(InterfaceError, "the surface of a coupling.* twice"):
        Coupling([(V, right), (V, right)], point=(2, 0), kind=kind)


def test_nothing_else_holds():
    """A bar that only a coupling holds; what isn't held is told."""
    V, tags = bar(2)
    sides = [(V, tags.find(tag)) for tag in FIRST[2]]
    for parts, free in (("x", "y", "rotation"), 0), (("x", "y"), 1), ((), 3):
        first = Coupling(sides[0], point=(0, 0.5), kind="distributing", held=parts)
        last = Coupling(sides[1], point=(2, 0.5), kind="rigid")
        problem = TiedProblem([elastic(V)], [None], couplings=[first, last])
        last.force[1] = 1.0
        if free:
            with raises(SolveError, f"{free} rigid motion.*or a coupling by held="):
                problem.solve()
            continue
        problem.solve()
        close(first.reaction, (0, -1, -2), 1e-9)


def test_symmetry():
    """A rigid surface meets a plane of symmetry where the point's motion keeps to it."""
    V, tags = bar(2)
    plane, right = held(V, tags.find(meshes.BOTTOM), component=1), tags.find(meshes.RIGHT)
    left = held(V, tags.find(meshes.LEFT), component=0)
    options = {"point": (2, 0), "kind": "rigid"}
    with raises(ValueError, "prescribes y .* where its y is free.*name these in held="):
        TiedProblem(
            [elastic(V)], [None], bcs=[plane, left], couplings=Coupling((V, right), **options)
        )
    end = Coupling((V, right), held=("y", "rotation"), **options)
    problem = TiedProblem([elastic(V)], [None], bcs=[plane, left], couplings=end)
    end.force[0] = 1.0
    (u,) = problem.solve()
    dofs = fem.locate_dofs_topological(V, 1, right)
    x = u.x.array.reshape(-1, 2)[dofs, 0]
    assert comm.allreduce(np.abs(x - end.displacement[0]).max(initial=0)) < SOLVED
    body = Elastic.on(V)
    again = NonlinearTiedProblem([body.F], [body.u], bcs=[plane, left], couplings=end)
    again.solve()
    close(body.u.x.array, u.x.array, 1e-7)
    end.prescribed[1] = 0.1
    for one in (problem, again):
        with raises(InterfaceError, r"coupling 0: the prescribed displacements at \(2, 0\)"):
            one.solve()


def test_bad_input():
    """One line each."""
    V, tags = bar(2)
    W = fem.functionspace(V.mesh, ("Lagrange", 1))
    right = tags.find(meshes.RIGHT)
    good = {"point": (2, 0), "kind": "rigid"}
    for side, options, match in (
        ((V, right), {**good, "kind": "RBE2"}, "kind is 'RBE2': give"),
        (V, good, "each side of a coupling is a pair"),
        ((W, right), good, "a coupling moves displacements, with 2 components"),
        ((V, right), {**good, "point": (0, 0, 0)}, "point of a coupling: give 2 finite numbers"),
        ((V, right), {**good, "held": "z"}, "held has 'z'; components are x, y, rotation"),
        ((V, right[:0]), good, "has no facets on any rank"),
        ([], good, "a coupling needs a surface: give a pair"),
        *(
            (
                (V, right),
                {"point": (1e5, 0), "kind": kind},
                r"\(100000, 0\), is farther from its "
                r"surface, at \(2, 0.5\), than 1e\+04 times the root mean square radius of this",
            )
            for kind in KINDS
        ),
    ):
        with raises((ValueError, InterfaceError), match):
            Coupling(side, **options)
    end, both = Coupling((V, right), **good), [elastic(V)]
    other = Coupling((V, np.sort(np.append(right, tags.find(meshes.TOP)))), **good)
    elsewhere = Coupling((bar(2)[0], right), **good)
    fixed = [held(V, tags.find(meshes.LEFT))]
    turn = {"point": (2, 0), "kind": "distributing", "held": "rotation"}
    means, again = (Coupling((V, right), **turn) for _ in range(2))
    grip = Coupling((V, right), **good, held=("x", "y", "rotation"))
    for couplings, options, match in (
        ([V], {}, "couplings has a FunctionSpace"),
        ([end, end], {}, "coupling 1 is given twice"),
        ([end, other], {}, "rigid couplings 0 and 1 have 4 nodes in common"),
        ([elsewhere], {}, "coupling 0 is on a space that is in no form"),
        ([end], {"u": []}, "0 functions u for 1 bodies"),
        ([end], {"solver": "bodies"}, "a coupling's point has no stiffness"),
        ([means, again], {}, "coupling 1 holds what others .*its rotation.: leave that out"),
        ([end, means], {}, None),
        ([grip, means], {}, "coupling 1 holds what others or boundary conditions hold already"),
    ):
        with raises(ValueError, match) if match else nullcontext():
            TiedProblem(both, [None], bcs=fixed, couplings=couplings, **options)
    problem = TiedProblem(both, [None], bcs=fixed, couplings=[end])
    end.prescribed[0] = 1.0
    with raises(ValueError, "coupling 0: a value is prescribed for x of a coupling"):
        problem.solve()
    end.prescribed[0], end.springs[2] = 0.0, -1.0
    with raises(ValueError, "stiffness -1; give numbers ≥ 0"):
        problem.solve()
    end.springs[2], end.force[0] = 0.0, np.nan
    with raises(ValueError, "coupling 0: the force is no number: it is NaN"):
        problem.solve()


def nonlinear_bars(kind):
    """Two neo-Hookean bars in the plane whose end doesn't turn."""
    (V0, tags0), (V1, tags1) = bar(2), bar(2, low=(2, 0), across=2)
    left, right = FIRST[2]
    tie = Tie((V0, tags0.find(right)), (V1, tags1.find(left)))
    bodies = [Elastic.on(V, large=True) for V in (V0, V1)]
    end = Coupling((V1, tags1.find(right)), point=(4, 0.5), kind=kind, held="rotation")
    problem = NonlinearTiedProblem(
        [body.F for body in bodies],
        [body.u for body in bodies],
        bcs=[held(V0, tags0.find(left))],
        ties=[tie],
        couplings=end,
        petsc_options={"snes_rtol": 1e-13, "snes_atol": 1e-14},
    )
    return problem, tie, end


@pytest.mark.ranks
@pytest.mark.parametrize("kind", KINDS)
def test_nonlinear(kind):
    """Finite strains: balance, and a state that goes on."""
    problem, tie, end = nonlinear_bars(kind)
    for share in (1, 2):
        end.force = 0.1 * share, 0.01 * share
        _, u1 = problem.solve()
        close(tie.force(problem, on=u1), -end.force, BALANCED)
        if share == 1:
            state = problem.state()
    assert end.displacement[0] > 0.5 and len(problem.u) == 2
    again, _, other = nonlinear_bars(kind)
    again.restore(state)
    close(other.force, end.force / 2)
    assert other.reaction[2] != 0 and other.displacement[0] > 0
    other.force = end.force
    again.solve()
    close(other.displacement, end.displacement, SOLVED)
    close(other.reaction, end.reaction, SOLVED)


def derivative_is_exact(problem, size=0.05):
    """The tangent is the derivative of the residual, by differences, at a random state."""
    rng = np.random.default_rng(comm.rank)
    free = [~mask for mask in problem._held]

    def random(vector, size):
        for part, mask in zip_longest(vector.getNestSubVecs(), free, fillvalue=True):
            part.array[:] += size * mask * rng.standard_normal(part.getLocalSize())

    x, (d, r) = problem.x, (problem.x.duplicate() for _ in range(2))
    random(x, size)
    d.set(0.0)
    random(d, 1.0)
    found = []
    for step in (1e-5, -1e-5, 0.0):
        y = x.duplicate()
        x.copy(y)
        y.axpy(step, d)
        problem._residual(y, r)
        found.append([part.array_r.copy() for part in r.getNestSubVecs()])
    problem.assemble_matrix()
    problem.A.mult(d, r)
    for after, before, part, mask in zip_longest(
        *found[:2], r.getNestSubVecs(), free, fillvalue=True
    ):
        off = np.abs((after - before) / 2e-5 - part.array_r)[np.broadcast_to(mask, after.shape)]
        assert comm.allreduce(off.max(initial=0.0), MPI.MAX) < 1e-7 * (1 + part.norm())


def turning(axis, angle, dim):
    """Rotation matrix and the angles of a coupling."""
    found = rotation(angle * np.asarray(axis, dtype=float))[:dim, :dim]
    return found, (angle * np.asarray(axis, dtype=float))[2 if dim == 2 else slice(0, 3)]


@pytest.mark.parametrize(("dim", "kind"), EACH)
def test_turned(kind, dim):
    """A bar that its coupling turns by 60° has no stress; then loads, balance, the tangent."""
    V, tags = bar(dim)
    body, point = Elastic.on(V, large=True), np.full(dim, 0.7)
    names = ("x", "y", "rotation") if dim == 2 else ("x", "y", "z", "rx", "ry", "rz")
    first, last = FIRST[dim]
    grip = Coupling((V, tags.find(first)), point=point, kind=kind, held=names)
    end = Coupling((V, tags.find(last)), point=point + 1, kind=kind)
    options = {"snes_rtol": 1e-13, "snes_atol": 1e-14}
    problem = NonlinearTiedProblem([body.F], [body.u], couplings=[grip, end], petsc_options=options)
    axis = (0, 0, 1) if dim == 2 else np.ones(3) / np.sqrt(3)
    for angle in np.radians((20, 40, 60)):
        R, angles = turning(axis, angle, dim)
        grip.prescribed[dim:] = angles
        problem.solve()
    x = V.tabulate_dof_coordinates()[:, :dim] - point
    close(body.u.x.array.reshape(-1, dim), x @ R.T - x, 1e-12)
    close(end.rotation, R, 1e-12)
    assert np.abs(grip.reaction).max() < 1e-13
    end.force[:] = (0.01 if dim == 2 else 0.003) * np.arange(1, dim + 1)
    end.torque[:] = 0.02 if dim == 2 else 0.004
    problem.solve()
    balances(grip, end)
    assert np.abs(end.angles - angles).max() > 0.05
    derivative_is_exact(problem)


def balances(grip, end):
    """What holds one point balances the loads at another one, where both are now."""
    n = len(grip.point)
    arm, force = (
        np.pad(v, (0, 3 - n))
        for v in (end.point + end.displacement - grip.point - grip.displacement, end.force)
    )
    torque = np.cross(arm, force)[2 if n == 2 else slice(0, 3)] + end.torque
    found, loads = grip.reaction, np.append(end.force, torque)
    assert np.abs(found + loads).max() < BALANCED * np.abs(loads).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_moment_of_a_tie_that_turns(dim):
    """It balances the coupling's loads where nodes are now, not where they were."""
    (V0, tags0), (V1, tags1) = bar(dim), bar(dim, low=np.eye(3)[0 if dim == 2 else 2][:dim] * 2)
    first, last = FIRST[dim]
    names = ("x", "y", "rotation") if dim == 2 else ("x", "y", "z", "rx", "ry", "rz")
    grip = Coupling((V0, tags0.find(first)), point=np.zeros(dim), kind="rigid", held=names)
    end = Coupling((V1, tags1.find(last)), point=np.full(dim, 4.0), kind="rigid")
    tie = Tie((V0, tags0.find(last)), (V1, tags1.find(first)))
    bodies = [Elastic.on(V, large=True) for V in (V0, V1)]
    u, options = [body.u for body in bodies], {"snes_rtol": 1e-13, "snes_atol": 1e-14}
    given = {"ties": [tie], "couplings": [grip, end], "petsc_options": options}
    problem = NonlinearTiedProblem([body.F for body in bodies], u, **given)
    axis = (0, 0, 1) if dim == 2 else np.ones(3) / np.sqrt(3)
    grip.prescribed[dim:] = turning(axis, 0.6, dim)[1]
    problem.solve()
    end.force[0] = end.torque[0] = 1e-3
    problem.solve()
    at = end.point + end.displacement
    for on, sign in ((u[0], 1), (u[1], -1), (None, -1)):
        moment = tie.moment(problem, at, on=on)
        assert np.abs(sign * moment - end.torque).max() < BALANCED * 1e-3
    still = tie.moment(problem, at, displaced=False)
    assert np.abs(still + end.torque).max() > 0.5e-3


def pressed(dim, kind, friction=None, free=False):
    """A narrow block on a base, each with a coupling; that of the base is held."""
    up, low = (1, np.array([0.5, 1.0])) if dim == 2 else (2, np.array([0.5, 0.1, 1.0]))
    size, cell = np.ones(dim), "triangle" if dim == 2 else "hexahedron"
    base, tags0 = meshes.block(
        comm, (4, 2, 2)[:dim], lambda s: np.append(2.0, size[1:]) * s, cell=cell
    )
    size[1] = 0.8 if dim == 3 else 1.0
    block, tags1 = meshes.block(comm, (3,) * dim, lambda s: low + size * s, cell=cell)
    V0, V1 = (fem.functionspace(body, ("Lagrange", 1, (dim,))) for body in (base, block))
    bodies = [Elastic.on(V, large=True) for V in (V0, V1)]
    bottom, top = (meshes.BOTTOM, meshes.TOP) if dim == 2 else (meshes.BACK, meshes.FRONT)
    contact = Contact((V0, tags0.find(top)), (V1, tags1.find(bottom)), friction=friction)
    names = ("x", "y", "rotation") if dim == 2 else ("x", "y", "z", "rx", "ry", "rz")
    grip = Coupling((V0, tags0.find(bottom)), point=np.full(dim, 0.3), kind=kind, held=names)
    point = (1.0, 2.2) if dim == 2 else (1.0, 0.5, 2.2)
    lid = Coupling((V1, tags1.find(top)), point=point, kind=kind, held=() if free else names)
    problem = ContactProblem(
        [body.F for body in bodies],
        [body.u for body in bodies],
        contacts=[contact],
        couplings=[grip, lid],
        rtol=1e-12,
    )
    return problem, contact, grip, lid, up


@pytest.mark.ranks(2, dim=[2])
@pytest.mark.parametrize(("dim", "kind"), EACH)
def test_turned_in_contact(kind, dim):
    """Bodies in contact whose couplings turn them by 60°: forces turn along."""
    problem, contact, grip, lid, up = pressed(dim, kind)
    shift = np.zeros(dim)
    shift[up] = -0.1
    lid.prescribed[up] = -0.1
    problem.solve()
    before = contact.force(problem, on=problem.u[1])
    nodes = problem.u[1].function_space.tabulate_dof_coordinates()[:, :dim] - grip.point
    pressed_nodes = nodes + problem.u[1].x.array.reshape(-1, dim)
    axis = (0, 0, 1) if dim == 2 else (1, 0, 0)
    for angle in np.radians((30, 60)):
        R, angles = turning(axis, angle, dim)
        grip.prescribed[dim:] = lid.prescribed[dim:] = angles
        lid.prescribed[:dim] = R @ (lid.point + shift - grip.point) + grip.point - lid.point
        problem.solve()
    close(nodes + problem.u[1].x.array.reshape(-1, dim), pressed_nodes @ R.T, 1e-9)
    close(contact.force(problem, on=problem.u[1]), R @ before, 1e-9)
    close(lid.reaction[:dim], -R @ before, 1e-9)
    close(grip.reaction[:dim], R @ before, 1e-9)
    assert np.abs(before).max() > 0.03


@pytest.mark.parametrize(("dim", "kind"), EACH)
def test_loaded_in_contact(kind, dim):
    """A block that friction and a lever hold: balance; a state goes on to the same digits."""
    problem, contact, grip, lid, up = pressed(dim, kind, friction=0.4, free=True)
    for share in (1, 2):
        lid.force[[0, up]] = 0.002 * share, -0.02 * share
        lid.torque[-1 if dim == 2 else 1] = 0.0005 * share
        problem.solve()
        for end, u, loads in (
            (lid, problem.u[1], np.append(lid.force, lid.torque)),
            (grip, problem.u[0], grip.reaction),
        ):
            at = end.point + end.displacement
            found = contact.force(problem, on=u), contact.moment(problem, at, on=u)
            assert np.abs(loads + np.concatenate(found)).max() < BALANCED * np.abs(loads).max()
        if share == 1:
            state = problem.state()
    again, _, other_grip, other, _ = pressed(dim, kind, friction=0.4, free=True)
    again.restore(state)
    other.force, other.torque = lid.force, lid.torque
    again.solve()
    close(other.displacement, lid.displacement, 1e-12)
    close(other_grip.reaction, grip.reaction, 1e-12)
    assert "coupling 1, at" in problem.status() and lid.angles.any()


def screw(held, spring=0.0):
    """A rigid blade with rounded ends in a slot between two jaws, which couplings hold."""

    def jaw(sign, s):
        return np.column_stack((3 * s[:, 0] - 1.5, sign * 0.2 + s[:, 1] - (sign < 0)))

    def blade(s):
        x = 2 * s[:, 0] - 1
        half = 0.19 * np.sqrt(1 - 0.75 * (np.maximum(np.abs(x) - 0.6, 0) / 0.4) ** 2)
        return np.column_stack((x, (2 * s[:, 1] - 1) * half))

    made = [meshes.block(comm, (24, 8), lambda s, k=k: jaw(k, s)) for k in (1, -1)]
    made.append(meshes.block(comm, (16, 2), blade))
    V = [fem.functionspace(body, ("Lagrange", 1, (2,))) for body, _ in made]
    jaws, u = [Elastic.on(W, large=True) for W in V[:2]], fem.Function(V[2])
    driver, sides = RigidBody(u, point=(0, 0), held=("x", "y")), (meshes.TOP, meshes.BOTTOM)
    grips, contacts = [], []
    for W, (_, tags), outer, inner in zip(V, made, sides, sides[::-1], strict=False):
        facets = made[2][1].find(outer)
        grips.append(Coupling((W, tags.find(outer)), point=(0, 0), kind="rigid", held=held))
        grips[-1].springs[2] = spring
        contacts.append(Contact((V[2], facets), (W, tags.find(inner))))
    problem = ContactProblem(
        [*(one.F for one in jaws), driver],
        [*(one.u for one in jaws), u],
        contacts=contacts,
        couplings=grips,
        rtol=1e-11,
    )
    return problem, driver, grips


@pytest.mark.ranks
def test_screwdriver():
    """A blade turns its slot by a radian against springs: balance, and the play as in a vice."""
    torque, angles = 0.04, []
    for held_parts, spring in ((("x", "y", "rotation"), 0.0), (("x", "y"), 0.02)):
        problem, driver, grips = screw(held_parts, spring)
        for share in (0.5, 1.0):
            driver.torque = torque * share
            problem.solve()
        angles.append(np.concatenate([one.angles for one in (driver, *grips)]))
        resisting = sum(one.springs[2] * one.angles[0] - one.reaction[2] for one in grips)
        assert abs(resisting - torque) < BALANCED * torque
        assert np.abs(sum(one.reaction[:2] for one in grips)).max() < BALANCED * torque
    close(angles[1][1:], [1.0, 1.0], 1e-2)
    close(angles[1] - angles[1][1], angles[0], 1e-9)
    assert angles[0][0] > 0.07
