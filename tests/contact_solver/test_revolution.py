# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Axisymmetric bodies: 2πr or r in every weight of ties and contacts; tractions are per area."""

import logging

from mpi4py import MPI

import numpy as np
import pytest
from helpers import close, raises, two_blocks

import meshes
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import compute_midpoints, meshtags
from hypergap_dolfinx import (
    Contact,
    ContactProblem,
    InterfaceError,
    NonlinearTiedProblem,
    Tie,
    TiedProblem,
)
from hypergap_dolfinx.algebra import revolution

comm = MPI.COMM_WORLD
LARGE = 0.2
EXACT = 1e-12  # times the pressure: of round-off, up to 2e-14


class Swept:
    """A ring on a disc between walls that they slide along, compressed by a strain; λ = μ = 1.

    What the ring leaves free of the disc has the same pressure.
    """

    def __init__(self, n=(8, 6), k=1, cell="triangle", strain=1e-3, **options):
        angle, inner, outer = (
            options.get(name, value)
            for name, value in (("angle", 2 * np.pi), ("inner", 0.5), ("outer", 1.5))
        )
        self.u, self.F, self.bcs, self.sides = [], [], [], []
        large, stretch = strain >= LARGE, 1 - strain
        log = np.log(stretch)
        self.p = -(stretch - 1 / stretch + log / stretch) if large else 3 * strain
        self.force = self.p * angle / 2 * (outer**2 - inner**2)
        for i, (start, end) in enumerate(((0, 2), (inner, outer))):

            def place(x, i=i, start=start, end=end):
                return np.column_stack((start + (end - start) * x[:, 0], x[:, 1] + i - 1))

            mesh, ft = meshes.block(comm, (n[i], 2), place, cell=cell)
            V = fem.functionspace(mesh, ("Lagrange", k, (2,)))
            u, v, r = fem.Function(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)[0]
            G = ufl.Identity(2) + ufl.grad(u)
            J, hoop = ufl.det(G) * (1 + u[0] / r), 1 + u[0] / r
            eps = ufl.sym(G) - ufl.Identity(2)
            if large:
                W = (ufl.inner(G, G) + hoop**2 - 3 - 2 * ufl.ln(J) + ufl.ln(J) ** 2) / 2
            else:
                W = ufl.inner(eps, eps) + (u[0] / r) ** 2 + (ufl.tr(eps) + u[0] / r) ** 2 / 2
            dx = ufl.dx(metadata={"quadrature_degree": 2 * k + 1})
            F = ufl.derivative(angle * r * W * dx, u)
            facets = ft.find((meshes.TOP, meshes.BOTTOM)[i])
            if i == 0:
                middle = compute_midpoints(mesh, 1, facets)[:, 0]
                free = np.sort(facets[(middle < inner) | (middle > outer)])
                tags = meshtags(mesh, 1, free, np.ones(len(free), dtype=np.int32))
                ds = ufl.Measure("ds", mesh, subdomain_data=tags)
                F += angle * r * fem.Constant(mesh, self.p) * v[1] * ds(1)
            far = (meshes.BOTTOM, meshes.TOP)[i]
            held = ((0, meshes.LEFT, 0.0), (0, meshes.RIGHT, 0.0), (1, far, strain * (1 - 2 * i)))
            for axis, tag, value in held:
                dofs = fem.locate_dofs_topological(V.sub(axis), 1, ft.find(tag))
                value = default_scalar_type(value)
                self.bcs.append(fem.dirichletbc(value, dofs, V.sub(axis)))
            self.u.append(u)
            self.F.append(F)
            self.sides.append((V, facets))

    def contact(self, swap=False, **options):
        """The ring in contact, solved."""
        contact = Contact(*self.sides[:: -1 if swap else 1], **options)
        problem = ContactProblem(self.F, self.u, bcs=self.bcs, contacts=[contact], rtol=1e-13)
        problem.solve()
        return contact, problem

    def tie(self, swap=False, **options):
        """The ring tied, solved."""
        tie = Tie(*self.sides[:: -1 if swap else 1], **options)
        tolerances = {"snes_rtol": 1e-13, "snes_atol": 1e-15}
        problem = NonlinearTiedProblem(
            self.F, self.u, bcs=self.bcs, ties=[tie], petsc_options=tolerances
        )
        problem.solve()
        return tie, problem


PATCHES = (
    {"k": 1},
    {"k": 2, "strain": LARGE, "n": (4, 10)},
    {"k": 1, "cell": "quadrilateral", "strain": LARGE, "n": (20, 2), "inner": 0.0},
    {"k": 2, "cell": "quadrilateral", "inner": 0.0},
    {"k": 2, "angle": 1.0, "n": (8, 3)},
)


@pytest.mark.ranks(options=PATCHES[1:3])
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("options", PATCHES)
def test_contact_patch(options, swap):
    """A constant pressure is passed on exactly, per area, and the force is that of the ring."""
    scene = Swept(**options)
    axisymmetric = "radian" if "angle" in options else True
    contact, problem = scene.contact(swap, axisymmetric=axisymmetric)
    close(
        contact.pressures(problem)[contact.active], scene.p * contact.active[contact.active], EXACT
    )
    close(abs(contact.force(problem)[1]), scene.force, EXACT)
    sigma = contact.pressure(problem).x.array
    close(sigma, np.full(len(sigma), scene.p), EXACT)
    across = max(np.abs(u.x.array[::2]).max(initial=0) for u in scene.u)
    assert comm.allreduce(across, MPI.MAX) <= EXACT


@pytest.mark.ranks(options=[PATCHES[1]])
@pytest.mark.parametrize("options", PATCHES)
def test_tie_patch(options):
    """λ, its integral and the recovered tractions, per area."""
    scene, axisymmetric = Swept(**options), "radian" if "angle" in options else True
    for swap in (False, True):
        tie, problem = scene.tie(swap, axisymmetric=axisymmetric)
        q = tie.quadrature(4)
        values = q.evaluate(tie.traction(problem))
        close(np.abs(values[..., 1]), np.full(values.shape[:2], scene.p), EXACT)
        close(abs(q.integrate(values)[1]), scene.force, EXACT)
        for on in ("side0", "side1"):
            t = np.abs(tie.traction(problem, on=on).x.array[1::2])
            close(t, np.full(len(t), scene.p), EXACT)


SOFT = 0.3
WAYS = (
    {"compliance": SOFT},
    {"conductance": 1 / SOFT},
    {"law": lambda jump, n: jump / SOFT},
)


@pytest.mark.parametrize("way", WAYS)
def test_soft_ties(way):
    """u₁ − u₀ = c λ everywhere, with one λ: the bodies' strain e has 2 e + 3 c e = 2 strain."""
    scene = Swept(inner=0.0, outer=2.0, k=2, n=(6, 4))
    tie, problem = scene.tie(axisymmetric=True, **way)
    q = tie.quadrature(4)
    found = q.evaluate(tie.traction(problem))[..., 1]
    close(found, np.full(found.shape, -scene.p * 2 / (2 + 3 * SOFT)), EXACT)


def test_several_ties():
    """Ties that continue each other are one interface, with r as well."""
    scene = Swept(k=2)
    (V0, facets0), (V1, facets1) = scene.sides
    right = compute_midpoints(V1.mesh, 1, facets1)[:, 0] > 1
    parts = facets1[~right], facets1[right]
    ties = [Tie((V0, facets0), (V1, part), axisymmetric=True) for part in parts]
    problem = NonlinearTiedProblem(
        scene.F, scene.u, bcs=scene.bcs, ties=ties, petsc_options={"snes_rtol": 1e-13}
    )
    problem.solve()
    for tie in ties:
        q = tie.quadrature(4)
        found = q.evaluate(tie.traction(problem))[..., 1]
        close(found, np.full(found.shape, -scene.p), EXACT)


def test_compliance():
    """Compliant surfaces overlap by c p where they are in contact, with small sliding."""
    scene = Swept(inner=0.0, outer=2.0, strain=1e-3)
    contact, problem = scene.contact(compliance=SOFT, sliding="small", axisymmetric=True)
    p = contact.pressures(problem)
    close(p, np.full(len(p), scene.p * 2 / (2 + 3 * SOFT)), EXACT)


def test_friction_sticks():
    """What would slide together sticks; nothing is dissipated."""
    contact, problem = Swept(k=2).contact(friction=0.3, axisymmetric=True)
    assert contact.sticking[contact.active].all() and abs(contact.dissipation(problem)) <= 1e-15


def test_refused():
    """What isn't axisymmetric."""
    sides = two_blocks()
    for kind in (Tie, Contact):
        with raises(ValueError, r"axisymmetric is True .* not 'rad'"):
            kind(*sides, axisymmetric="rad")
        left = two_blocks(mapping=lambda x: x - (0.5, 0))
        with raises(InterfaceError, r"Γ0 reaches to x\[0\] = -0.5: the axis .* x\[0\] = 0"):
            kind(*left, axisymmetric=True)
        solids = []
        for i, tag in enumerate((meshes.BACK, meshes.FRONT)):
            mesh, ft = meshes.block(
                comm, (1, 1, 1), lambda x, i=i: x + i * np.eye(3)[2], cell="hexahedron"
            )
            solids.append((fem.functionspace(mesh, ("Lagrange", 1, (3,))), ft.find(tag)))
        with raises(InterfaceError, "axisymmetric bodies are meshes in the plane"):
            kind(*solids, axisymmetric=True)
    mesh, ft = meshes.block(comm, (3, 3))
    V = fem.functionspace(mesh, ("Lagrange", 1))
    left, right, top, bottom = (
        (V, ft.find(tag)) for tag in (meshes.LEFT, meshes.RIGHT, meshes.TOP, meshes.BOTTOM)
    )
    with raises(InterfaceError, r"periodic tie of axisymmetric bodies is along their axis"):
        Tie.periodic(left, right, translation=(1, 0), axisymmetric=True)
    Tie.periodic(bottom, top, translation=(0, 1), axisymmetric=True)


@pytest.mark.parametrize(
    ("axisymmetric", "told"),
    (
        (True, ""),
        (False, "divides by x[0]"),
        ("radian", "weight is r, and the form of body 1 has a 2π"),
    ),
)
def test_weights_are_told(axisymmetric, told, caplog):
    """Where the weights don't seem to be those of the forms the log says so, once for each body."""
    scene, tied = Swept(), two_blocks()
    with caplog.at_level(logging.WARNING):
        contact = Contact(*scene.sides, axisymmetric=axisymmetric)
        ContactProblem(scene.F, scene.u, bcs=scene.bcs, contacts=[contact])
    found = [record.getMessage() for record in caplog.records]
    assert len(found) == 2 * bool(told) and all(line.startswith("contact 0: ") for line in found)
    assert not told or told in found[1]
    caplog.clear()
    if axisymmetric is not True:
        return
    V = [V for V, _ in tied]
    a = [ufl.inner(ufl.grad(ufl.TrialFunction(W)), ufl.grad(ufl.TestFunction(W))) for W in V]
    with caplog.at_level(logging.WARNING):
        TiedProblem([f * ufl.dx for f in a], [None] * 2, ties=[Tie(*tied, axisymmetric=True)])
        r = [ufl.SpatialCoordinate(W.mesh)[0] for W in V]
        forms = [x * f * ufl.dx for x, f in zip(r, a, strict=True)]
        TiedProblem(forms, [None] * 2, ties=[Tie(*tied, axisymmetric=True)])
        TiedProblem(forms, [None] * 2, ties=[Tie(*tied, axisymmetric="radian")])
    found = [record.getMessage() for record in caplog.records]
    assert len(found) == 4 and all("has no x[0]" in line for line in found[:2])
    assert all("weight is 2πr, and the form of body" in line for line in found[2:])


def test_plane_forms_are_not_told(caplog):
    """What divides by other functions of x[0] than hoop strains do: distances, moduli."""
    sides = two_blocks()
    forms = []
    for divides in (
        lambda x: 1 + x[0],
        lambda x: ufl.sqrt(x[0] ** 2 + x[1] ** 2),
        lambda x: x[0] + 1e-12,
    ):
        parts = []
        for V, _ in sides:
            u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(V.mesh)
            parts.append(ufl.inner(ufl.grad(u), ufl.grad(v)) / divides(x) * ufl.dx)
        forms.append(parts)
    for a, told in zip(forms, (0, 0, 2), strict=True):
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            revolution.tell(a, [Tie(*sides)], "tie")
        assert len(caplog.records) == told
