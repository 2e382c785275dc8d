# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact of displacements of mixed spaces: Taylor–Hood elements, of incompressible bodies too."""

from mpi4py import MPI

import numpy as np
import pytest
from helpers import close, raises, two_ranks

import basix.ufl
import meshes
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx import mesh as meshing
from hypergap_dolfinx import Contact, ContactProblem, InterfaceError, SolveError, Tie

comm = MPI.COMM_WORLD
START, END, STRAIN = 0.5, 1.5, 1e-2  # of the narrow block, on a block from 0 to 2
EXACT = 1e-12  # times the pressure: of round-off, up to 2e-14


def taylor_hood(mesh):
    """Displacements of degree 2, pressures of degree 1."""
    cell, dim = mesh.basix_cell(), mesh.geometry.dim
    parts = [
        basix.ufl.element("Lagrange", cell, 2, shape=(dim,)),
        basix.ufl.element("Lagrange", cell, 1),
    ]
    return fem.functionspace(mesh, basix.ufl.mixed_element(parts))


def held(V, axis, where, value=0.0):
    """A condition on one displacement, at nodes or on facets."""
    part = V.sub(axis)
    space, _ = part.collapse()
    g = fem.Function(space)
    g.x.array[:] = value
    if callable(where):
        dofs = fem.locate_dofs_geometrical((part, space), where)
    else:
        dofs = fem.locate_dofs_topological((part, space), V.mesh.topology.dim - 1, where)
    return fem.dirichletbc(g, dofs, part)


class Blocks:
    """A narrow block on a wider one, compressed: stress is the same everywhere."""

    def __init__(self, *, nu=0.5, E=1.0, mixed=(True, True), cell="triangle", dim=2, tied=False):
        """Blocks are mixed or of displacements alone; a third one may be tied to the wider one."""
        mu, lame = E / (2 * (1 + nu)), np.inf if nu == 0.5 else E * nu / (1 + nu) / (1 - 2 * nu)
        # Sides are free along x, and don't move along others
        across = STRAIN if nu == 0.5 else lame / (2 * mu + lame) * STRAIN
        self.p, self.across = 2 * mu * (STRAIN + across), across
        self.u, self.F, self.bcs, self.sides, self.ties = [], [], [], [], []
        n, last = ((8, 6, 5), (4, 2))[dim - 2], dim - 1
        for i in range(2 + tied):
            start, end, low = ((0, 2, -1), (START, END, 0), (0, 2, -2))[i]
            cells = (n[i], *[2] * (dim - 1))

            def place(x, start=start, end=end, low=low):
                x = x.copy()
                x[:, 0], x[:, last] = start + (end - start) * x[:, 0], x[:, last] + low
                return x

            mesh, ft = meshes.block(comm, cells, place, cell=cell)
            k, soft = (
                fem.Constant(mesh, default_scalar_type(value)) for value in (2 * mu, 1 / lame)
            )
            if mixed[i % 2]:
                W = taylor_hood(mesh)
                w, V = fem.Function(W), W.sub(0)
                (u, p), (v, q) = ufl.split(w), ufl.TestFunctions(W)
                F = -p * ufl.div(v) - q * ufl.div(u) - soft * p * q
            else:
                V = fem.functionspace(mesh, ("Lagrange", 2, (dim,)))
                w, v = fem.Function(V), ufl.TestFunction(V)
                u, F = w, ufl.div(w) * ufl.div(v) / soft
            F += k * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v)))
            F *= ufl.dx
            low, high = (ft.find(2 * last + 1), ft.find(2 * last + 2))
            if i == 0:
                middle = meshing.compute_midpoints(mesh, last, high)[:, 0]
                free = np.sort(high[(middle < START) | (middle > END)])
                tags = meshing.meshtags(mesh, last, free, np.ones(len(free), dtype=np.int32))
                ds = ufl.Measure("ds", mesh, subdomain_data=tags)
                F += default_scalar_type(self.p) * v[last] * ds(1)
            self.bcs.append(held(V, 0, lambda x: np.isclose(x[0], 1)))
            for axis in range(1, last):
                self.bcs += [held(V, axis, ft.find(2 * axis + k)) for k in (1, 2)]
            if i == 1:
                self.bcs.append(held(V, last, high, -STRAIN))
            elif i == 2 * tied:
                self.bcs.append(held(V, last, low, STRAIN * (1 + tied)))
            self.u.append(w)
            self.F.append(F)
            self.sides.append((V, low if i == 1 else high))
            if tied and i == 0:
                self.lower = (V, low)
            if i == 2:
                self.ties.append(Tie((V, high), self.lower))

    def solve(self, swap=False, **options):
        """Contact and problem, solved."""
        solver = {"solver": options.pop("solver")} if "solver" in options else {}
        contact = Contact(*self.sides[:2][:: -1 if swap else 1], **options)
        problem = ContactProblem(
            self.F,
            self.u,
            bcs=self.bcs,
            contacts=[contact],
            ties=self.ties,
            rtol=1e-12,
            **solver,
        )
        problem.solve()
        return contact, problem


PATCHES = (
    {},
    {"swap": True, "cell": "quadrilateral", "E": 1e9},
    {"nu": 0.4, "mixed": (True, False)},
    {"nu": 0.4, "mixed": (False, True), "swap": True, "E": 1e-6},
    {"tied": True},
    {"friction": 0.3},
    {"dim": 3, "cell": "tetrahedron"},
)


@pytest.mark.ranks(options=PATCHES[4:])
@pytest.mark.parametrize("options", PATCHES)
def test_patch(options):
    """One pressure, of incompressible bodies, beside bodies of displacements alone, in any unit."""
    of_contact = {k: options[k] for k in ("swap", "friction") if k in options}
    scene = Blocks(**{k: v for k, v in options.items() if k not in of_contact})
    contact, problem = scene.solve(sliding="small", **of_contact)
    p = contact.pressures(problem)[contact.active]
    close(p, np.full(len(p), scene.p), EXACT)
    assert problem.iterations <= 2
    last = len(contact.force(problem)) - 1
    for body, sign in ((0, -1), (1, 1)):
        force = contact.force(problem, on=problem.u[body])[last]
        close(force, sign * scene.p, EXACT)
    gap = contact.gap(*problem.u[:2])
    assert np.abs(gap.x.array).max(initial=0) <= EXACT


def test_finite():
    """The same where pressures act on what the surface is now: wider by the strain across."""
    scene = Blocks()
    contact, problem = scene.solve()
    p = contact.pressures(problem)[contact.active]
    close(p, np.full(len(p), scene.p / (1 + scene.across)), EXACT)


def test_messages():
    """What isn't possible."""
    scene = Blocks()
    with raises(ValueError, r'solver="iterative" is not possible: a space is mixed'):
        scene.solve(solver="iterative")
    (V, facets), other = scene.sides
    for W, what in ((V.sub(0), r"value shape \(\)"), (scene.u[0].function_space, r"W.sub\(0\)")):
        with raises(InterfaceError, what):
            Contact((W, facets), other)
    contact = Contact(*scene.sides[:2])
    with raises(ValueError, r"u0 is not on the space of Γ0"):
        contact.gap(scene.u[1], scene.u[1])


@two_ranks()
def test_only_contact_holds():
    """A mixed body that nothing else holds rests on a floor; what nothing holds is told."""
    mesh, ft = meshes.block(comm, (4, 4), cell="triangle")
    w = fem.Function(taylor_hood(mesh))
    (u, p), (v, q) = ufl.split(w), ufl.TestFunctions(w.function_space)
    load = fem.Constant(mesh, default_scalar_type(0))
    strain = ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v)))
    F = (2 * strain - p * ufl.div(v) - q * ufl.div(u) - load * v[1]) * ufl.dx
    ground, gt = meshes.block(comm, (3, 1), lambda x: (1.4, 0.2) * x - (0.2, 0.2))
    floor = fem.Function(fem.functionspace(ground, ("Lagrange", 1, (2,))))
    V = w.function_space.sub(0)
    sides = (floor.function_space, gt.find(meshes.TOP)), (V, ft.find(meshes.BOTTOM))
    contact, middle = Contact(*sides), held(V, 0, lambda x: np.isclose(x[0], 0.5))
    problem = ContactProblem([None, F], [floor, w], bcs=[middle], contacts=[contact])
    assert "only contact can hold body 1, at (0.5, 0.5), along (0, 1)" in problem.status()
    load.value = -0.1
    problem.solve()
    close(contact.force(problem), (0, 0.1), 1e-9)
    problem = ContactProblem([None, F], [floor, w], contacts=[contact])
    load.value = -0.2
    with raises(SolveError, r"body 1, at \(0.5, .*\), along \(1, 0\); hold them"):
        problem.solve()


def test_unloaded():
    """Bodies that part are at rest at once: pressures have the digits that they lost before."""
    scene = Blocks()
    contact = Contact(*scene.sides)
    problem = ContactProblem(scene.F, scene.u, bcs=scene.bcs, contacts=[contact])
    problem.solve()
    for condition in scene.bcs:
        condition.g.x.array[:] = 0
    problem.solve()
    assert problem.iterations <= 4  # 13 without what was the largest
    assert np.abs(contact.force(problem)).max() <= EXACT


def heated(expands, sources):
    """Forms, functions, conditions, and sides of displacements and temperatures of two blocks."""
    u, F, bcs, sides, heat = [], [], [], [], []
    for i, source in enumerate(sources):
        mesh, ft = meshes.block(comm, (5 - i, 3), lambda x, i=i: np.add(x, (0, i - 1)))
        cell = mesh.basix_cell()
        parts = [basix.ufl.element("Lagrange", cell, 1, shape=shape) for shape in (None, (2,))]
        W = fem.functionspace(mesh, basix.ufl.mixed_element(parts))
        w, V, far = fem.Function(W), W.sub(1), ft.find((meshes.BOTTOM, meshes.TOP)[i])
        (T, d), (s, v) = ufl.split(w), ufl.TestFunctions(W)
        load, rate = (fem.Constant(mesh, default_scalar_type(x)) for x in (source, expands))
        stress = 2 * ufl.sym(ufl.grad(d)) - rate * T * ufl.Identity(2)
        flow = ufl.inner(ufl.grad(T), ufl.grad(s)) - load * s
        F.append((ufl.inner(stress, ufl.sym(ufl.grad(v))) + flow) * ufl.dx)
        bcs.append(held(V, 0, lambda x: np.isclose(x[1], 2 * i - 1)))
        bcs += [held(V, 1, far, -0.01 * i), held(W, 0, far)]
        u.append(w)
        near = ft.find((meshes.TOP, meshes.BOTTOM)[i])
        sides.append((V, near))
        heat.append((W.sub(0), near))
    return F, u, bcs, sides, heat


@two_ranks(expands=[1e-6])
@pytest.mark.parametrize("expands", (0.0, 1e-6))
def test_temperatures(expands):
    """A field whose equation has no displacements in it: one-way coupled temperatures."""
    source = 1e6
    F, u, bcs, sides, _ = heated(expands, (source, source))
    problem = ContactProblem(F, u, bcs=bcs, contacts=[Contact(*sides)])
    problem.solve()
    assert problem.iterations <= 4
    for w in u:
        T = w.sub(0).collapse().x.array
        assert comm.allreduce(T.max(), MPI.MAX) == pytest.approx(source / 2, rel=1e-12)


@two_ranks()
def test_contact_that_conducts():
    """Displacements in contact, temperatures tied by a conductance: on the same facets."""
    source, h = 2.0, 0.5
    F, u, bcs, sides, heat = heated(1e-3, (source, -source))
    tie = Tie(*heat, conductance=h)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[Contact(*sides)], ties=[tie])
    problem.solve()
    flow = 2 * h * source / 2 / (1 + 2 * h)  # jump of ±T at the interface, from −T″ = source
    np.testing.assert_allclose(tie.force(problem, on=u[1]), flow, rtol=1e-10)


# Rubber: a rigid sphere is pressed into a disc, by 30 % of its height


def rubber(w, mu):
    """Residual of incompressible neo-Hookean rubber, axisymmetric, and its change of volume."""
    mesh = w.function_space.mesh
    (u, p), r = ufl.split(w), ufl.SpatialCoordinate(mesh)[0]
    G, hoop = ufl.Identity(2) + ufl.grad(u), 1 + u[0] / r
    J = ufl.det(G) * hoop
    k = fem.Constant(mesh, default_scalar_type(mu))
    W = k * (ufl.inner(G, G) + hoop**2 - 3 - 2 * ufl.ln(J)) / 2 - p * (J - 1)
    dx, arc = ufl.dx(metadata={"quadrature_degree": 6}), 2 * np.pi * r
    return ufl.derivative(arc * W * dx, w), fem.form(arc * (J - 1) * dx)


class Pressed:
    """The scene."""

    def __init__(self, mu=1.0, n=6):
        def disc(x):
            return np.column_stack((1.5 * x[:, 0], x[:, 1] - 1))

        def ball(x):
            angle, radius = np.pi / 2 * x[:, 0], 1 - 0.2 * x[:, 1]
            return np.column_stack((radius * np.sin(angle), 1 - radius * np.cos(angle)))

        mesh, ft = meshes.block(comm, (3 * n // 2, n), disc)
        self.w = fem.Function(taylor_hood(mesh))
        V = self.w.function_space.sub(0)
        F, self.volume = rubber(self.w, mu)
        sphere, st = meshes.block(comm, (2 * n, 1), ball, degree=2)
        self.ball = fem.Function(fem.functionspace(sphere, ("Lagrange", 2, (2,))))
        bcs = [held(V, 0, ft.find(tag)) for tag in (meshes.LEFT, meshes.BOTTOM)]
        bcs.append(held(V, 1, ft.find(meshes.BOTTOM)))
        sides = (self.ball.function_space, st.find(meshes.BOTTOM)), (V, ft.find(meshes.TOP))
        self.contact = Contact(*sides, axisymmetric=True)
        self.problem = ContactProblem(
            [None, F], [self.ball, self.w], bcs=bcs, contacts=[self.contact]
        )

    def go(self, depth):
        """Press; the force."""
        self.ball.x.array[1::2] = -depth
        self.problem.solve()
        assert self.problem.halvings == 0
        return -self.contact.force(self.problem)[1]


@two_ranks()
def test_rubber():
    """By 30 % of its height, without a halved load step; the volume stays, a state goes on."""
    scene, hard = Pressed(), Pressed(mu=1e9)
    for depth in np.linspace(0, 0.3, 7)[1:]:
        force = scene.go(depth)
        assert abs(comm.allreduce(fem.assemble_scalar(scene.volume))) <= 1e-10
    assert force == pytest.approx(1.64713, rel=1e-3)  # finer meshes: 1.6477, 1.6484
    # Pressures in other units: the volume stays as exactly
    assert hard.go(0.05) == pytest.approx(1e9 * Pressed().go(0.05), rel=1e-8)
    assert abs(comm.allreduce(fem.assemble_scalar(hard.volume))) <= 1e-10
    before = scene.w.x.array.copy()
    state = scene.problem.state()
    scene.go(0.31)
    scene.problem.restore(state)
    close(scene.w.x.array, before, 1e-15)
    again = Pressed()
    again.problem.restore(state)
    close(again.go(0.31), scene.go(0.31), 1e-12)


@pytest.mark.slow
@two_ranks()
def test_rubber_in_space():
    """A quarter of a block, pressed by a rigid sphere by 30 % of its height, without friction."""

    def block(x):
        return np.column_stack((1.5 * x[:, :2], x[:, 2] - 1))

    def ball(x):
        way = np.column_stack((np.tan(1.05 * x[:, :2] - 0.1), -np.ones(len(x))))
        way /= np.linalg.norm(way, axis=1)[:, None]
        return way * (1 - 0.2 * x[:, 2:]) + (0, 0, 1)

    mesh, ft = meshes.block(comm, (4, 4, 3), block, cell="hexahedron")
    sphere, st = meshes.block(comm, (6, 6, 1), ball, cell="hexahedron", degree=2)
    w = fem.Function(taylor_hood(mesh))
    V, (u, p) = w.function_space.sub(0), ufl.split(w)
    G = ufl.Identity(3) + ufl.grad(u)
    J, dx = ufl.det(G), ufl.dx(metadata={"quadrature_degree": 4})
    F = ufl.derivative(((ufl.inner(G, G) - 3 - 2 * ufl.ln(J)) / 2 - p * (J - 1)) * dx, w)
    # Sides 2 a + 1 and 2 a + 2 are across axis a
    bcs = [held(V, 0, ft.find(1)), held(V, 1, ft.find(3))]
    bcs += [held(V, axis, ft.find(5)) for axis in range(3)]
    moved = fem.Function(fem.functionspace(sphere, ("Lagrange", 2, (3,))))
    contact = Contact((moved.function_space, st.find(5)), (V, ft.find(6)))
    problem = ContactProblem([None, F], [moved, w], bcs=bcs, contacts=[contact])
    for depth in (0.15, 0.3):
        moved.x.array[2::3] = -depth
        problem.solve()
    assert problem.halvings == 0
    assert abs(comm.allreduce(fem.assemble_scalar(fem.form((J - 1) * dx)))) <= 1e-10
    assert -contact.force(problem)[2] == pytest.approx(0.42320, rel=1e-3)  # finer: .4204, .4188
