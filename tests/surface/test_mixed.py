# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bodies with several fields: ties of components of mixed spaces, and of blocked ones."""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import pytest
from assembly import dense, rectangle
from helpers import raises, residual, two_ranks

import basix.ufl
import meshes
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import compute_midpoints, create_unit_cube, locate_entities_boundary
from hypergap_dolfinx import (
    InterfaceError,
    NonlinearTiedProblem,
    SolveError,
    Tie,
    TiedProblem,
    files,
    find_touching,
)
from hypergap_dolfinx.surface.component import Component
from meshes import BOTTOM, LEFT, RIGHT, TOP

comm = MPI.COMM_WORLD


def linear(x):
    """A displacement without a change of volume."""
    return np.array([x[1] + 0.1 * x[0] + 0.2, 0.3 * x[0] - 0.1 * x[1]])


def warm(x):
    """A temperature."""
    return 1 + x[0] / 2 - x[1]


def error(functions, exact):
    """The largest deviation at the nodes."""
    worst = 0.0
    for f in functions:
        f = f.collapse() if f.function_space.component() else f
        expected = fem.Function(f.function_space)
        expected.interpolate(exact)
        worst = max(worst, np.abs(f.x.array - expected.x.array).max(initial=0))
    return comm.allreduce(worst, MPI.MAX)


def mixed_space(mesh, degree=1):
    """Quadratic displacements, and a scalar."""
    cell = mesh.basix_cell()
    u = basix.ufl.element("Lagrange", cell, 2, shape=(2,))
    return fem.functionspace(
        mesh, basix.ufl.mixed_element([u, basix.ufl.element("Lagrange", cell, degree)])
    )


def prescribed(V, facets, value):
    """Values of a component, or of a whole space."""
    own = V.collapse()[0] if V.component() else V
    g = fem.Function(own)
    g.interpolate(value)
    if not V.component():
        return fem.dirichletbc(g, fem.locate_dofs_topological(V, 1, facets))
    return fem.dirichletbc(g, fem.locate_dofs_topological((V, own), 1, facets), V)


@dataclass
class Body:
    """A square, incompressible with Taylor–Hood elements or not."""

    mesh: object
    ft: object
    W: fem.FunctionSpace
    """With all fields."""
    a: ufl.Form

    @property
    def V(self):
        return self.W.sub(0) if self.W.dofmap.index_map_bs == 1 else self.W

    def facets(self, *tags):
        return np.concatenate([np.empty(0, dtype=np.int32), *(self.ft.find(t) for t in tags)])

    def side(self, tag):
        return self.V, self.facets(tag)

    def displacement(self, u):
        return u.sub(0) if self.W.dofmap.index_map_bs == 1 else u


def body(n, corner, *, incompressible=True, slant=0.0, degree=1):
    """A unit square from a corner on; its right (slant > 0) or left side may lean."""

    def place(x):
        lean = np.abs(slant) * (x[:, 1] - 0.5) * (x[:, 0] if slant > 0 else 1 - x[:, 0])
        return np.column_stack((x[:, 0] + lean, x[:, 1])) + corner

    mesh, ft = meshes.block(comm, n, place, cell="triangle")

    def eps(u):
        return ufl.sym(ufl.grad(u))

    if not incompressible:
        W = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        return Body(mesh, ft, W, 2 * ufl.inner(eps(u), eps(v)) * ufl.dx)
    W = mixed_space(mesh, degree)
    (u, p), (v, q) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
    pressure = p * ufl.div(v) + q * ufl.div(u)
    return Body(mesh, ft, W, (2 * ufl.inner(eps(u), eps(v)) - pressure) * ufl.dx)


def channel():
    """Two parts of a channel whose meshes meet in a slanted line."""
    return body((4, 3), (0, 0), slant=0.3), body((3, 5), (1, 0), slant=-0.3)


@two_ranks(swap=[False])
@pytest.mark.parametrize("swap", (False, True))
def test_flow_through_a_channel(swap):
    """The parabola is in the space of the velocities; pressures aren't tied."""

    def flow(x):
        return np.array([x[1] * (1 - x[1]), 0 * x[0]])

    parts = channel()
    bcs = [
        prescribed(part.V, part.facets(BOTTOM, TOP, *[LEFT] * (i == 0)), flow)
        for i, part in enumerate(parts)
    ]
    out = parts[1].V.sub(1)
    dofs = fem.locate_dofs_topological(out, 1, parts[1].facets(RIGHT))
    bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, out))
    sides = [parts[0].side(RIGHT), parts[1].side(LEFT)]
    tie = Tie(*(sides[::-1] if swap else sides))
    problem = TiedProblem([p.a for p in parts], [None, None], bcs=bcs, ties=[tie])
    ws = problem.solve()
    assert error([w.sub(0) for w in ws], flow) <= 1e-13
    assert error([w.sub(1) for w in ws], lambda x: 2 * (2 - x[0])) <= 1e-12
    q = tie.quadrature(2)
    sign = -1 if swap else 1  # λ is the traction on Γ0's body
    force = q.integrate(q.evaluate(tie.traction(problem)))
    np.testing.assert_allclose(force, (-2 * sign, 0.6 * sign), atol=1e-12)
    # The whole solution, its components, and functions on the tie's own spaces
    ws = ws[::-1] if swap else ws
    own = [fem.Function(V) for V in tie.spaces]
    for f, w in zip(own, ws, strict=True):
        f.interpolate(w.sub(0))
    gaps = [tie.gap(*us) for us in (ws, [w.sub(0) for w in ws], own)]
    for gap, slip in gaps:
        assert max(np.abs(f.x.array).max(initial=0) for f in (gap, slip)) <= 1e-14
    assert [f.name for f in files.on_sigma(tie, problem)] == ["alpha", "traction", "gap", "slip"]


@pytest.mark.ranks(2)
def test_cross_point_of_bodies_with_and_without_pressure():
    """Four bodies meet at a point: no row of B follows from the others there."""
    bodies, bcs, L = [], [], []
    for i, incompressible in enumerate((True, False, False, True)):
        corner = np.divmod(i, 2)
        bodies.append(body((2 + sum(corner), 3), corner, incompressible=incompressible))
        outer = [LEFT, RIGHT][corner[0]], [BOTTOM, TOP][corner[1]]
        tags = outer if i < 3 else outer[1:]  # on the right of the last one the stress is given
        bcs.append(prescribed(bodies[i].V, bodies[i].facets(*tags), linear))
        L.append(None)
    W, ft = bodies[3].W, bodies[3].ft
    stress = fem.Constant(W.mesh, default_scalar_type((0.2, 1.3)))
    ds = ufl.Measure("ds", W.mesh, subdomain_data=ft)(RIGHT)
    L[3] = ufl.dot(stress, ufl.TestFunctions(W)[0]) * ds
    pairs = ((0, RIGHT, 2, LEFT), (1, RIGHT, 3, LEFT), (0, TOP, 1, BOTTOM), (2, TOP, 3, BOTTOM))
    ties = [Tie(bodies[i].side(a), bodies[j].side(b)) for i, a, j, b in pairs]
    problem = TiedProblem([b.a for b in bodies], L, bcs=bcs, ties=ties)
    us = problem.solve()
    assert error([b.displacement(u) for b, u in zip(bodies, us, strict=True)], linear) <= 1e-12
    assert error([us[0].sub(1), us[3].sub(1)], lambda x: 0 * x[0]) <= 1e-11
    assert np.linalg.svd(dense(problem.A), compute_uv=False).min() >= 1e-6


@pytest.mark.parametrize("interior", ("interpolated", "free"))
def test_displacement_and_temperature(interior):
    """A tie for each field of the same bodies, with different degrees and sides."""
    parts, F, us, bcs, sides = [], [], [], [], ([], [])
    for i, n in enumerate(((4, 3), (3, 5))):
        part = body(n, (i, 0))
        w = fem.Function(part.W)
        (u, T), (v, s) = ufl.split(w), ufl.TestFunctions(part.W)
        hot = T - warm(ufl.SpatialCoordinate(part.mesh))
        sigma = 2 * ufl.sym(ufl.grad(u)) - 0.3 * hot * ufl.Identity(2)
        F.append((ufl.inner(sigma, ufl.grad(v)) + ufl.inner(ufl.grad(T), ufl.grad(s))) * ufl.dx)
        us.append(w)
        outer = part.facets(BOTTOM, TOP, (LEFT, RIGHT)[i])
        for k, exact in enumerate((linear, warm)):
            bcs.append(prescribed(part.W.sub(k), outer, exact))
            sides[k].append((part.W.sub(k), part.facets((RIGHT, LEFT)[i])))
        parts.append(part)
    ties = [Tie(*sides[0], interior=interior), Tie(*sides[1][::-1])]
    problem = NonlinearTiedProblem(F, us, bcs=bcs, ties=ties)
    problem.solve()
    for k, exact in enumerate((linear, warm)):
        assert error([w.sub(k) for w in us], exact) <= 1e-12
    q = ties[1].quadrature(2)
    heat = q.integrate(q.evaluate(ties[1].traction(problem)))
    np.testing.assert_allclose(heat, (-0.5,), atol=1e-11)  # leaves the right part, Γ0


@pytest.mark.ranks
def test_blocks_have_the_numbering_of_the_whole():
    """On both sides, with a component of a component, and with a plain space opposite."""
    blocks, ((_, f0), (_, f1)) = two_blocks()
    W = [mixed_space(b.mesh) for b in blocks]
    plain = fem.functionspace(W[1].mesh, ("Lagrange", 1, (2,)))
    ws = [fem.Function(V) for V in W]
    for w in ws:
        w.x.array[:] = 7.0  # what isn't tied doesn't matter
        w.sub(0).interpolate(linear)
    for side0, side1, u1 in (
        (W[0].sub(0), W[1].sub(0), ws[1]),
        (W[0].sub(0).sub(1), W[1].sub(0).sub(1), ws[1]),
        (W[0].sub(0), plain, fem.Function(plain)),
    ):
        if u1 is not ws[1]:
            u1.interpolate(linear)
        tie = Tie((side0, f0), (side1, f1))
        assert tie.blocks()[0].getSize()[1] == W[0].dofmap.index_map.size_global
        assert residual(tie, ws[0], u1) <= 1e-13
        tie.destroy()


@pytest.mark.ranks
def test_components_are_numbered_alike_and_owned_by_the_same_ranks():
    """What ties and problems rely on: each collapses a component by itself."""
    W = mixed_space(meshes.block(comm, (4, 5), cell="triangle")[0])
    one, other = Component.of(W.sub(0)), Component.of(W.sub(0))
    assert one.same(other) and not one.same(Component.of(W.sub(1)))
    assert np.array_equal(one.dofs, other.dofs)
    assert np.array_equal(one.space.dofmap.list, other.space.dofmap.list)
    assert (one.dofs < W.dofmap.index_map.size_local).all()
    every = np.concatenate(comm.allgather(one.global_dofs()))
    assert len(np.unique(every)) == one.space.dofmap.index_map.size_global * 2


@pytest.mark.ranks
def test_functions_with_another_numbering():
    """A new space of the same kind has other numbers than a collapsed one."""
    blocks, ((_, f0), (_, f1)) = two_blocks()
    W = [mixed_space(b.mesh) for b in blocks]
    sides = [(V.sub(0), f) for V, f in zip(W, (f0, f1), strict=True)]
    collapsed = fem.Function(W[1].sub(0).collapse()[0])
    collapsed.interpolate(linear)
    expected, found = (Tie(*sides, jump=jump).offset() for jump in (linear, collapsed))
    np.testing.assert_allclose(found.array, expected.array, rtol=0, atol=1e-14)
    new = fem.Function(fem.functionspace(W[1].mesh, ("Lagrange", 2, (2,))))
    new.interpolate(linear)
    with raises(ValueError, "a function on a space of neither side"):
        Tie(*sides, jump=new)
    with raises(ValueError, "u1 is not on the space of Γ1"):
        Tie(*sides).gap(fem.Function(W[0]), new)


@two_ranks()
def test_components_that_dolfinx_mixes_up():
    """Of degree 3 on tetrahedra: a patch test was off by 5e-3."""
    cube = create_unit_cube(comm, 2, 2, 2)
    cubic = basix.ufl.element("Lagrange", "tetrahedron", 3, shape=(3,))
    pressure = basix.ufl.element("Lagrange", "tetrahedron", 2)
    W = fem.functionspace(cube, basix.ufl.mixed_element([cubic, pressure]))
    f0, f1 = (
        locate_entities_boundary(cube, 2, lambda x, z=z: np.isclose(x[2], z)) for z in (0.0, 1.0)
    )
    with raises(InterfaceError, "DOLFINx mixes up the nodes"):
        Tie((W.sub(0), f0), (W.sub(0), f1))
    Component.of(W.sub(1)), Component.of(W.sub(0).sub(2))
    V = fem.functionspace(cube, ("Lagrange", 3, (3,)))
    Component.of(V.sub(1))  # not of a mixed space


def two_blocks():
    blocks = [rectangle((n, 2), (0, i), (1, i + 1), degree=2) for i, n in enumerate((2, 3))]
    return blocks, [(blocks[0].V, blocks[0].facets(TOP)), (blocks[1].V, blocks[1].facets(BOTTOM))]


def test_blocks_that_slide():
    """A tie of the normal displacements alone, between blocks that are pressed together."""
    blocks, ((V0, f0), (V1, f1)) = two_blocks()
    tie = Tie((V0.sub(1), f0), (V1.sub(1), f1))

    def slid(by):
        return lambda x: np.array([0.2 * x[0] + by, -0.3 * x[1]])

    bcs = [
        prescribed(block.V, block.facets((tag, LEFT, RIGHT)), slid(by))
        for block, tag, by in zip(blocks, (BOTTOM, TOP), (0, 0.05), strict=True)
    ]
    problem = TiedProblem([b.a for b in blocks], [None, None], bcs=bcs, ties=[tie])
    u0, u1 = problem.solve()
    assert error([u0], slid(0)) <= 1e-12 and error([u1], slid(0.05)) <= 1e-12
    problem = TiedProblem([b.a for b in blocks], [None, None], bcs=bcs[:1], ties=[tie])
    with raises(SolveError, "singular: 1 rigid motion of the bodies is free"):
        problem.solve()


@pytest.mark.ranks(2)
def test_what_can_still_move():
    """Rigid motions are of displacements; a pressure is free where all around is prescribed."""
    left, right = channel()
    tie = Tie(left.side(RIGHT), right.side(LEFT))
    problem = TiedProblem([left.a, right.a], [None, None], ties=[tie])
    with raises(SolveError, "singular: 3 rigid motions of the bodies are free; .*pressure"):
        problem.solve()
    bcs = [prescribed(left.V, left.facets(BOTTOM, TOP, LEFT, RIGHT), linear)]
    with raises(SolveError, r"singular: 1 rigid motion of .* \(a pressure at a node, where"):
        TiedProblem([left.a], [None], bcs=bcs).solve()
    bcs = [
        prescribed(part.V, part.facets(BOTTOM, TOP, tag), linear)
        for part, tag in ((left, LEFT), (right, RIGHT))
    ]
    # Where MUMPS meets a pivot that is zero to all digits, it fails before that is found out
    with raises(SolveError, "singular.* a pressure .*known up to a constant only.* hold it at a"):
        TiedProblem([left.a, right.a], [None, None], bcs=bcs, ties=[tie]).solve()
    Q = left.W.sub(1)
    corner = fem.locate_dofs_geometrical(
        (Q, Q.collapse()[0]), lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0)
    )
    bcs.append(fem.dirichletbc(fem.Function(Q.collapse()[0]), corner, Q))
    ws = TiedProblem([left.a, right.a], [None, None], bcs=bcs, ties=[tie]).solve()
    assert error([w.sub(1) for w in ws], lambda x: 0 * x[0]) <= 1e-11


@pytest.mark.ranks(2)
def test_pieces_of_one_interface_and_what_touches():
    """Ties of the same components are joined, though each has a space of its own."""
    left, right = body((4, 4), (0, 0)), body((3, 6), (1, 0))
    ((V0, f0), (V1, f1)) = find_touching([left.V, right.V])[0]
    halves = []
    for V, facets in ((V0, f0), (V1, f1)):
        above = compute_midpoints(V.mesh, 1, facets)[:, 1] > 0.5
        halves.append((facets[above], facets[~above]))
    ties = [Tie((V0, halves[0][k]), (V1, halves[1][k])) for k in (0, 1)]
    bcs = [
        prescribed(left.V, left.facets(LEFT, BOTTOM, TOP), linear),
        prescribed(right.V, right.facets(BOTTOM, TOP), linear),
    ]
    problem = TiedProblem([left.a, right.a], [None, None], bcs=bcs, ties=ties)
    assert len(problem._constraints.bodies) == 1
    assert [name[:14] for name in problem._pieces.names] == ["ties 0 and 1 ("]


def test_bad_input():
    left, right = channel()
    tie = Tie(left.side(RIGHT), right.side(LEFT))
    a, L = [left.a, right.a], [None, None]
    f0, f1 = left.facets(RIGHT), right.facets(LEFT)
    with raises(InterfaceError, r"^the space of Γ0 is mixed; .* one by one, W.sub\(0\) for"):
        Tie((left.W, f0), (right.W, f1))
    with raises(InterfaceError, r"different value shapes, \(2,\) and \(\)"):
        Tie((left.V, f0), (right.W.sub(1), f1))
    for solver in ("bodies", "iterative"):
        with raises(ValueError, f'^solver="{solver}" is not possible: .* mixed'):
            TiedProblem(a, L, ties=[tie], solver=solver)
    part = Tie((left.V.sub(0), f0), (right.V.sub(0), f1))
    with raises(
        ValueError, r"^Γ0 of tie 1 \(.*\) and another tie's side are on a field and on a compo"
    ):
        TiedProblem(a, L, ties=[tie, part])
    again = Tie(right.side(LEFT), left.side(RIGHT))
    with raises(InterfaceError, r"^ties 0 and 1 \(.*\) tie the same facets to each other"):
        TiedProblem(a, L, ties=[tie, again])
    other = fem.Function(mixed_space(left.mesh))
    with raises(ValueError, "^u0 is not on the space of Γ0"):
        tie.gap(other, fem.Function(right.W))
