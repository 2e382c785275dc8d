# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Ties that give way: u₁ − u₀ = c λ, from tied to free; stresses are those of a tie."""

from mpi4py import MPI

import numpy as np
import pytest
from assembly import (
    SOLVED,
    Body,
    comm,
    exact_stress,
    held_outside,
    in_halves,
    is_regular,
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
from hypergap_dolfinx import SolveError, Tie, TiedProblem
from meshes import BOTTOM, LEFT, RIGHT, TOP

# Two layers that conduct: the flux and the temperatures are known


class Slab:
    """Temperatures 0 and 1 (or a flux of 1) on two layers of thickness 1 with a resistance."""

    def __init__(self, dim=2, unit=1.0, *, flux=False, how="compliance"):
        self.dim, self.unit, self.flux, self.k = dim, unit, flux, []
        sides, a, bcs, loads = [], [], [], []
        tags = (meshes.TOP, meshes.BOTTOM) if dim == 2 else (meshes.FRONT, meshes.BACK)
        for i, n in enumerate((4, 3)):
            mesh, ft = meshes.block(
                comm,
                (n,) * (dim - 1) + (2,),
                lambda x, i=i: unit * (x + i * np.eye(dim)[-1]),
                cell="triangle" if dim == 2 else "tetrahedron",
            )
            V = fem.functionspace(mesh, ("Lagrange", 1))
            k = fem.Constant(mesh, default_scalar_type(1.0))
            u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
            a.append(k * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
            ends = fem.locate_dofs_geometrical(
                V, lambda x, i=i: np.isclose(x[dim - 1], 2 * i * unit, atol=1e-6 * unit)
            )
            loads.append(None)
            if i and flux:
                loads[1] = ufl.conj(v) * ufl.Measure("ds", mesh, subdomain_data=ft)(meshes.TOP)
            else:
                bcs.append(fem.dirichletbc(default_scalar_type(i), ends, V))
            self.k.append(k)
            sides.append((V, ft.find(tags[i])))
        self.c = fem.Constant(mesh, default_scalar_type(0.0))
        self.how = how
        self.tie = Tie(*sides, **{how: self.c})
        self.problem = TiedProblem(a, loads, bcs=bcs, ties=[self.tie])

    def errors(self, k=(1.0, 1.0), c=0.0):
        """Errors of the flux, and of temperatures over the largest; c in units of Γ0's layer."""
        for constant, value in zip(self.k, k, strict=True):
            constant.value = value
        c = c * self.unit / k[0]
        self.c.value = c if self.how == "compliance" else 1 / c
        us = self.problem.solve()
        q = 1 / (self.unit / k[0] + c + self.unit / k[1])
        if self.flux:
            q = 1.0
        top = self.unit * q / k[0] + c * q
        wrong = size = 0.0
        for u, start, height, conductivity in zip(us, (0, top), (0, 1), k, strict=True):
            exact = interpolated(
                u.function_space,
                lambda x, start=start, height=height, k=conductivity: (
                    start + q / k * (x[self.dim - 1] - height * self.unit)
                ),
            )
            wrong = max(wrong, np.abs(u.x.array - exact.x.array).max(initial=0))
            size = max(size, np.abs(exact.x.array).max(initial=0))
        flux = np.abs(self.tie.traction(self.problem).x.array / q - 1).max(initial=0)
        flux, wrong, size = (comm.allreduce(e, MPI.MAX) for e in (flux, wrong, size))
        return flux, wrong / size


@two_ranks(unit=[1.0])
@pytest.mark.parametrize("unit", (1e-9, 1.0, 1e9))
def test_thermal_resistance(unit):
    """From tied to free in one problem; Γ1 is the side that conducts less, as advised."""
    slab = Slab(unit=unit)
    for k in ((1.0, 1.0), (1.0, 1e-6), (1e6, 1.0), *([(1e-9, 1e-9)] if unit == 1 else ())):
        for c in (0, 1e-12, 1.0, 1e12):
            errors = slab.errors(k, c)
            assert max(errors) <= 1e-12, (k, c, errors)


def test_in_space():
    slab = Slab(3)
    for c in (0, 0.5, 1e12):
        assert max(slab.errors((1.0, 3.0), c)) <= 1e-12


def test_held_by_the_compliance():
    """A body that nothing else holds; its digits go as a motion's stiffness in K's round-off."""
    slab = Slab(flux=True)
    for c in (1e-12, 1.0, 1e3, 1e6):
        assert max(slab.errors(c=c)) <= 1e-12 + 1e-14 * c
    slab.c.value = 1e20
    with raises(SolveError, "singular"):
        slab.problem.solve()


# Blocks under constant stress: the second one moves by C σn


def stretched(x):
    """A displacement without shear."""
    return 0.3 * x[0], 0.5 * x[1]


TIED = [(0, TOP), (1, BOTTOM)]
HELD = [(0, BOTTOM, (0, 1))]


def blocks(**options):
    return [
        rectangle((5, 2), (0, 0), (2, 1), **options),
        rectangle((3, 2), (0, 1), (2, 2), cell="triangle", **options),
    ]


def traction_of(body, exact):
    """σn at the interface y = 1."""
    return exact_stress(body, np.array([0.5, 0.5]), exact)[:, 1]


def error(p, exact, jump):
    """Largest deviation from a field, on top of which all bodies but the first have a jump."""
    wrong = size = 0.0
    for i, u in enumerate(p.u):
        f = interpolated(
            u.function_space, lambda x, i=i: np.array(exact(x)) + (jump(x) if i else 0)
        )
        wrong = max(wrong, np.abs(u.x.array - f.x.array).max(initial=0))
        size = max(size, np.abs(f.x.array).max(initial=0))
    return comm.allreduce(wrong, MPI.MAX) / comm.allreduce(size, MPI.MAX)


@two_ranks(c=[(0.5, 2.0)], interior=["free"])
@pytest.mark.parametrize("interior", ("interpolated", "free"))
@pytest.mark.parametrize("c", (0.7, (0.5, 2.0), (0, 3.0), (1.5, 0)))
def test_springs(c, interior):
    """Along the normal and across it; with a jump on top."""
    bodies = blocks(degree=2)
    t = tie(bodies, *TIED, compliance=c, interior=interior, jump=(0.1, 0.2))
    p = problem(bodies, [t], TIED, HELD)
    p.solve()
    normal, tangential = (c, c) if np.isscalar(c) else c
    opening = np.array((tangential, normal)) * traction_of(bodies[0], linear) + (0.1, 0.2)
    assert error(p, linear, lambda x: opening[:, None]) <= SOLVED
    assert traction_error(p, t, bodies) <= 10 * SOLVED


@two_ranks()
def test_both_sides_prescribed():
    """λ is what makes the interface give way so; it can't be without a compliance."""
    bodies = blocks(degree=2)
    c = fem.Constant(bodies[0].mesh, default_scalar_type(2.0))
    t = tie(bodies, *TIED, compliance=(0.5, c), jump=(0.1, 0.2))
    p = problem(bodies, [t], TIED, [(0, TOP, (0, 1)), (1, BOTTOM, (0, 1))])
    p.solve()
    q = t.quadrature(2)
    exact = np.broadcast_to((-0.1 / 2.0, -0.2 / 0.5), q.x.shape)
    np.testing.assert_allclose(q.evaluate(t.traction(p)), exact, atol=SOLVED)
    c.value = 0.0
    with raises(SolveError, "singular"):
        p.solve()
    with raises(ValueError, "the compliance is 0 across the normal at .* prescribed"):
        problem(bodies, [t], TIED, [(0, TOP, (0, 1)), (1, BOTTOM, (0, 1))])


@pytest.mark.ranks(2)
def test_both_sides_prescribed_and_zero_in_places():
    """λ is read where the interface gives way."""
    bodies = blocks(degree=2)
    ends = [(0, TOP, (0, 1)), (1, BOTTOM, (0, 1))]
    linear = fem.functionspace(bodies[1].mesh, ("Lagrange", 1))
    c, g = interpolated(linear, lambda x: np.maximum(x[0] - 1, 0)), fem.Function(bodies[1].V)
    for i, opening in enumerate((0.1, -0.2)):
        g.sub(i).interpolate(c)
        g.x.array[i::2] *= opening
    t = tie(bodies, *TIED, compliance=c, jump=g)
    p = problem(bodies, [t], TIED, ends)
    p.solve()
    q = t.quadrature(2)
    exact = np.broadcast_to((-0.1, 0.2), q.x.shape)
    # c has a kink within cells of Σ
    np.testing.assert_allclose(q.evaluate(t.traction(p)), exact, atol=0.02)
    c.x.array[:] = 1.0
    for _ in range(2):  # each time
        with raises(ValueError, r"the compliance of tie 0 \(.*\) was 0 when the problem was made"):
            p.solve()


@two_ranks(how=["pair"], swap=[True])
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("how", ("function", "callable", "pair"))
def test_fields(how, swap):
    """Linear along the interface under a normal stress: the second block turns."""
    bodies = blocks()
    sides = TIED[::-1] if swap else TIED
    c = lambda x: 0.4 + 0.3 * x[0]  # noqa: E731
    if how == "function":
        c = interpolated(fem.functionspace(bodies[sides[1][0]].mesh, ("Lagrange", 1)), c)
    t = tie(bodies, *sides, compliance=(c, 1.0) if how == "pair" else c)
    p = problem(bodies, [t], TIED, HELD, stretched)
    p.solve()
    pull = traction_of(bodies[0], stretched)[1]

    def turn(x):
        return pull * np.array((0.3 * (1 - x[1]), 0.4 + 0.3 * x[0]))

    assert error(p, stretched, turn) <= SOLVED


@two_ranks(same=[False])
@pytest.mark.parametrize("same", (True, False))
@pytest.mark.parametrize("how", ("compliance", "conductance"))
def test_pieces(how, same):
    """One interface in two pieces, and bodies that are tied to each other where these meet."""
    halves = [rectangle((2, 2), (x, 1), (x + 1, 2)) for x in (0, 1)]
    bodies = [rectangle((6, 2), (0, 0), (2, 1)), *halves]
    c = [0.7, 0.7 if same else fem.Constant(bodies[0].mesh, default_scalar_type(0.7))]
    upper = [(1, BOTTOM), (2, BOTTOM)]
    ties = [
        tie(bodies, (0, TOP), side, **{how: value}) for side, value in zip(upper, c, strict=True)
    ]
    ties.append(tie(bodies, (1, RIGHT), (2, LEFT)))
    tied = [(0, TOP), *upper, (1, RIGHT), (2, LEFT)]
    p = problem(bodies, ties, tied, HELD)
    p.solve()
    opening = traction_of(bodies[0], linear) * (0.7 if how == "compliance" else 1 / 0.7)
    assert error(p, linear, lambda x: opening[:, None]) <= SOLVED
    assert max(traction_error(p, t, bodies) for t in ties) <= 10 * SOLVED

    block = rectangle((4, 2), (0, 1), (2, 2), cell="triangle")
    bodies = [bodies[0], block]
    pieces = zip(in_halves(bodies, TIED, 1), c, strict=True)
    ties = [Tie(*sides, **{how: value}) for sides, value in pieces]
    p = problem(bodies, ties, TIED, HELD)
    p.solve()
    assert error(p, linear, lambda x: opening[:, None]) <= SOLVED
    assert is_regular(p)


def shrunk(n, degree, c):
    """A ring shrunk on another one, on a bed of springs: errors of displacement and pressure."""
    E, nu, radii, delta = 1000.0, 0.3, (1.0, 2.0, 3.0), 0.01
    middle = radii[1]
    # σ_rr = A − B / r², one ring after the other with a unit pressure between them
    A, B = np.linalg.solve(
        [[[1, -1 / r**2], [1, -1 / middle**2]] for r in radii[::2]], [[[0.0], [-1.0]]] * 2
    )[..., 0].T

    def radial(i, r):
        """Displacement, plane strain."""
        return (1 + nu) / E * ((1 - 2 * nu) * A[i] * r + B[i] / r)

    q = delta / (radial(1, middle) - radial(0, middle) + c)
    if c == 0:
        assert abs(q - 1.28777472527) <= 1e-11
    bodies, wrong = [], np.zeros(2)
    for i, cells in enumerate((3 * n, 2 * n)):
        mesh, ft = meshes.ring_sector(comm, cells, n, *radii[i : i + 2], degree=degree)
        V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
        bodies.append(Body(mesh, ft, V, E, nu))
    t = tie(
        bodies,
        (0, meshes.OUTER),
        (1, meshes.INNER),
        jump=lambda x: delta * x[:2] / np.hypot(x[0], x[1]),
        compliance=c,
    )
    held = [(i, *side) for i in (0, 1) for side in ((meshes.START, (1,)), (meshes.END, (0,)))]
    bcs = []
    for i, tag, (component,) in held:
        V = bodies[i].V.sub(component)
        dofs = fem.locate_dofs_topological(V, 1, bodies[i].facets(tag))
        bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V))
    p = TiedProblem([body.a for body in bodies], [None, None], bcs=bcs, ties=[t])
    for i, u in enumerate(p.solve()):
        x = ufl.SpatialCoordinate(bodies[i].mesh)
        exact = q * radial(i, ufl.sqrt(ufl.dot(x, x))) / ufl.sqrt(ufl.dot(x, x)) * x
        for k, f in enumerate((u - exact, exact)):
            wrong[k] += fem.assemble_scalar(fem.form(ufl.inner(f, f) * ufl.dx(degree=8))).real
    wrong = np.sqrt(comm.allreduce(wrong))
    rule = t.quadrature(4)
    pressure = np.linalg.norm(rule.evaluate(t.traction(p)), axis=-1, keepdims=True)
    off = rule.integrate((pressure / q - 1) ** 2) / rule.integrate(np.ones_like(pressure))
    return wrong[0] / wrong[1], float(off[0]) ** 0.5


@two_ranks(degree=[2])
@pytest.mark.parametrize("c, degree", ((0.0, 1), (5e-3, 2)))
def test_shrink_fit(c, degree):
    """Rates of displacement and pressure; with and without springs between the rings."""
    errors = np.array([shrunk(n, degree, c) for n in (4, 8)])
    print(errors)
    rates = np.log2(errors[0] / errors[1])
    assert rates[0] >= degree + 0.9 and rates[1] >= degree - 0.1


@two_ranks()
def test_nonlinear():
    """Newton's iteration takes one step."""
    bodies = blocks()
    c = fem.Constant(bodies[0].mesh, default_scalar_type(0.7))
    t = tie(bodies, *TIED, compliance=c)
    opening = 0.7 * traction_of(bodies[0], linear)

    def exact(i, x):
        return np.array(linear(x)) + i * opening[:, None]

    p = held_outside(bodies, [t], TIED, exact)
    p.solve()
    assert p.solver.getIterationNumber() == 1
    assert error(p, linear, lambda x: opening[:, None]) <= SOLVED
    c.value = 0.2
    p.solve()
    assert p.solver.getIterationNumber() == 1
    fresh = held_outside(bodies, [tie(bodies, *TIED, compliance=0.2)], TIED, exact)
    for u, other in zip(p.u, fresh.solve(), strict=True):
        np.testing.assert_allclose(u.x.array.copy(), other.x.array, rtol=0, atol=1e-10)


@two_ranks()
@pytest.mark.parametrize("which", ((0, 1), (0,), (1,)), ids=("both", "first", "second"))
@pytest.mark.parametrize("given", (0.7, (0.7, 0.7), (7.0, 2.0)), ids=("one", "equal", "two"))
def test_turned(caplog, given, which):
    """Normals don't turn with bodies: that is told if the law has two directions."""
    bodies = blocks()
    t = tie(bodies, *TIED, compliance=given)
    p = held_outside(
        bodies, [t], TIED, lambda i, x: (i in which) * np.array((-0.1 * x[1], 0.1 * x[0]))
    )
    p.solve()
    p.solve()
    told = [line for line in caplog.messages if "have turned by 5" in line]
    assert len(told) == (given == (7.0, 2.0) and comm.rank == 0)


@pytest.mark.parametrize("solver", ("bodies", "iterative"))
def test_solvers(solver):
    bodies = blocks()
    with raises(ValueError, f'"{solver}" is not possible: a tie has a compliance; take "direct"'):
        problem(bodies, [tie(bodies, *TIED, compliance=0.1)], TIED, HELD, solver=solver)


@pytest.mark.ranks(2)
def test_bad_input():
    bodies = blocks()
    mesh = bodies[0].mesh
    bodies[1].mesh.name = "upper"
    elsewhere = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)))
    negative = fem.Function(fem.functionspace(bodies[1].mesh, ("Lagrange", 1)))
    negative.x.array[:] = -2
    for wrong, said in (
        (-1.0, r"the compliance is -1 at \(.*\); it must be ≥ 0 and finite"),
        ((1.0, -2.0), "the compliance is -2"),
        (np.nan, "the compliance is nan"),
        (np.inf, "leave the tie out"),
        ((1, 2, 3), "one value, or a pair"),
        ({"normal": 1.0}, "given as numbers, a fem.Constant, .*, not as dict"),
        ((1.0, None), "not as NoneType"),
        (lambda x: None, "the callable gives NoneType, not numbers"),
        (fem.Constant(mesh, default_scalar_type((1.0, 2.0))), "the compliance is no number on Γ1"),
        (lambda x: 1 / 0, "no number on Γ1: division by zero"),
        (lambda x: 1 + 1j * x[0], "it has an imaginary part; a compliance is real"),
        (lambda x: x[0] - 1, r"the compliance is -1 at \(0, 1\)"),
        (elsewhere, r"on the mesh of Γ1's body, 'upper' around \(.*; or give a callable of x"),
        (negative, "the compliance is -2"),
    ):
        with raises(ValueError, said):
            tie(bodies, *TIED, compliance=wrong)
    assert tie(bodies, *TIED, compliance=lambda x: x[0] - 1e-16).compliance is not None
    scalar = [fem.functionspace(body.mesh, ("Lagrange", 1)) for body in bodies]
    sides = [(V, body.facets(tag)) for V, body, (_, tag) in zip(scalar, bodies, TIED, strict=True)]
    with raises(ValueError, "need displacements, with 2 components"):
        Tie(*sides, compliance=(1.0, 2.0))
