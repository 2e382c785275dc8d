# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contacts among several bodies: with ties, one mesh with itself, rigid and symmetric ones."""

from mpi4py import MPI

import numpy as np
import pytest
from assembly import Body, Elastic, lame_constants, rectangle
from helpers import close, two_ranks

import dolfinx
import meshes
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import (
    CellType,
    GhostMode,
    compute_midpoints,
    create_box,
    locate_entities_boundary,
)
from hypergap_dolfinx import Contact, ContactProblem, Tie
from hypergap_dolfinx.contact_solver.tangent import Tangent

comm = MPI.COMM_WORLD
UNIAXIAL = (1 - 0.3) / (1.3 * 0.4)
"""Stress over strain between walls, for E = 1 and ν = 0.3."""


class Assembly:
    """Bodies, of which components are held or moved where they have tags."""

    def __init__(self, bodies):
        self.bodies, self.bcs, self.sides = bodies, [], []
        self._elastic = [self._loaded(body, ()) for body in bodies]

    @staticmethod
    def _loaded(body, facets):
        return Elastic.on(body.V, lame_constants(body.E, body.nu), loaded=facets)

    @property
    def u(self):
        return [elastic.u for elastic in self._elastic]

    @property
    def F(self):
        return [elastic.F for elastic in self._elastic]

    def hold(self, i, component, *tags):
        """Returns the value, for the user to change."""
        body = self.bodies[i]
        value = fem.Constant(body.mesh, default_scalar_type(0))
        V = body.V.sub(component)
        dofs = fem.locate_dofs_topological(V, 1, np.sort(body.facets(tags)))
        self.bcs.append(fem.dirichletbc(value, dofs, V))
        return value

    def hold_at(self, i, component, inside):
        """Where nodes fulfil a condition."""
        V = self.bodies[i].V
        dofs = fem.locate_dofs_geometrical(
            (V.sub(component), V.sub(component).collapse()[0]), inside
        )
        self.bcs.append(
            fem.dirichletbc(fem.Function(V.sub(component).collapse()[0]), dofs, V.sub(component))
        )

    def load(self, i, tag):
        """Returns the traction downwards, for the user to change."""
        self._elastic[i] = self._loaded(self.bodies[i], self.bodies[i].facets(tag))
        return self._elastic[i].load

    def weigh(self, i, value):
        self._elastic[i].weight.value = value

    def side(self, i, tag):
        return self.bodies[i].V, self.bodies[i].facets(tag)

    def problem(self, contacts, ties=(), **options):
        return ContactProblem(self.F, self.u, bcs=self.bcs, contacts=contacts, ties=ties, **options)


@two_ranks()
def test_contact_beside_tie_in_space():
    """The upper block moves along the tie's edge, at which Γ1 has nodes between those of Γ0."""
    F, u, bcs, sides = [], [], [], []
    for low, n in ((-0.5, (6, 5, 1)), (0.0, (4, 3, 1))):
        far = low if low < 0 else 0.5
        mesh = create_box(comm, [(-1, -1, low), (1, 1, low + 0.5)], n, CellType.hexahedron)
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        ends = [
            locate_entities_boundary(mesh, 2, lambda x, z=z: np.isclose(x[2], z)) for z in (0, far)
        ]
        moved = fem.Constant(mesh, np.zeros(3, dtype=default_scalar_type))
        bcs.append(fem.dirichletbc(moved, fem.locate_dofs_topological(V, 2, ends[1]), V))
        x = compute_midpoints(mesh, 2, ends[0])[:, 0]
        sides.append([(V, ends[0][x < 0]), (V, ends[0][x > 0])])
        body = Elastic.on(V, (1.0, 1.0))
        F.append(body.F)
        u.append(body.u)
    tie, contact = Tie(sides[1][0], sides[0][0]), Contact(sides[1][1], sides[0][1])
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact], ties=[tie])
    for value in ((0, 0, -0.02), (0.004, 0.002, -0.02)):
        moved.value[:] = value
        problem.solve()
    assert abs(contact.force(problem)[2]) == pytest.approx(0.1126, rel=0.015)  # Γ1 the coarser side
    assert contact.pressures(problem).max() <= 0.062


@pytest.mark.ranks(sliding=["finite"])
@pytest.mark.parametrize("sliding", ("finite", "small"))
def test_column_of_contacts_and_ties(sliding):
    """Four bodies between walls, two of which only contact holds: one pressure, exact.

    The tie gives way under it, and opens by a load step.
    """
    moduli, n, starts = (1.0, 3.0, 0.5, 2.0), (3, 5, 4, 3), (0.0, 1.0, 2.01, 3.03)
    scene = Assembly(
        [
            rectangle((k, 2), (0, y), (2, y + 1), E=E)
            for k, y, E in zip(n, starts, moduli, strict=True)
        ]
    )
    for i in range(4):
        scene.hold(i, 0, meshes.LEFT, meshes.RIGHT)
    scene.hold(0, 1, meshes.BOTTOM)
    top = scene.hold(3, 1, meshes.TOP)
    pairs = [(scene.side(i, meshes.TOP), scene.side(i + 1, meshes.BOTTOM)) for i in range(3)]
    jump = fem.Constant(scene.bodies[0].mesh, default_scalar_type((0, 0)))
    tie = Tie(*pairs[0], jump=jump, compliance=(0.5, 0))
    contacts = [Contact.between(*pair, sliding=sliding) for pair in pairs[1:]]
    problem = scene.problem(contacts, [tie], rtol=1e-13)
    for path, opening in ((-0.04, 0.0), (-0.06, 0.02)):
        top.value, jump.value[1] = path, opening
        problem.solve()
        p = (opening - 0.03 - path) * UNIAXIAL / (sum(1 / E for E in moduli) + 0.5 * UNIAXIAL)
        for contact in contacts:
            sign = 1 - 2 * contact.swapped
            np.testing.assert_allclose(contact.pressures(problem), p, atol=1e-11)
            assert abs(sign * contact.force(problem)[1] - 2 * p) <= 1e-11
    traction = comm.allreduce(np.abs(tie.traction(problem).x.array).max(initial=0), MPI.MAX)
    assert abs(traction / p - 1) <= 1e-9


SLOT = 0.02


def clamp():
    """A C in one mesh, open on the right; INNER and OUTER are its slot below and above."""
    whole = dolfinx.mesh.create_rectangle(
        comm, [(0, 0), (4, 5)], (8, 5), CellType.quadrilateral, ghost_mode=GhostMode.none
    )
    cells = np.arange(whole.topology.index_map(2).size_local, dtype=np.int32)
    x, y = dolfinx.mesh.compute_midpoints(whole, 2, cells)[:, :2].T
    mesh = dolfinx.mesh.create_submesh(whole, 2, cells[(x < 1) | (np.abs(y - 2.5) > 0.5)])[0]
    z = mesh.geometry.x
    z[:, 1] = np.interp(z[:, 1], (0, 2, 3, 5), (0, 2, 2 + SLOT, 4 + SLOT))
    tags = []
    for tag, inside in (
        (meshes.BOTTOM, lambda x: np.isclose(x[1], 0)),
        (meshes.TOP, lambda x: np.isclose(x[1], 4 + SLOT)),
        (meshes.INNER, lambda x: np.isclose(x[1], 2) & (x[0] > 1 - 1e-6)),
        (meshes.OUTER, lambda x: np.isclose(x[1], 2 + SLOT) & (x[0] > 1 - 1e-6)),
    ):
        facets = dolfinx.mesh.locate_entities_boundary(mesh, 1, inside)
        tags += [(facet, tag) for facet in facets]
    indices, values = np.array(sorted(tags), dtype=np.int32).reshape(-1, 2).T
    ft = dolfinx.mesh.meshtags(mesh, 1, indices, values)
    return Body(mesh, ft, fem.functionspace(mesh, ("Lagrange", 1, (2,))))


@two_ranks(swap=[True], solver=["iterative"])
@pytest.mark.parametrize("solver", ("direct", "iterative"))
@pytest.mark.parametrize("swap", (False, True))
def test_one_mesh_with_itself(swap, solver):
    """A clamp that closes, as one mesh, and as three bodies with matching meshes that are tied."""
    found = []
    for whole in (True, False):
        if whole:
            scene = Assembly([clamp()])
            sides = [scene.side(0, meshes.INNER), scene.side(0, meshes.OUTER)]
            ties, top = [], 0
        else:
            spans = ((0, 4, 0, 2), (0, 1, 2, 2 + SLOT), (0, 4, 2 + SLOT, 4 + SLOT))
            bodies = [
                rectangle(n, (a, c), (b, d))
                for n, (a, b, c, d) in zip(((8, 2), (2, 1), (8, 2)), spans, strict=True)
            ]
            scene, top = Assembly(bodies), 2
            edges = [scene.side(0, meshes.TOP), scene.side(2, meshes.BOTTOM)]
            sides, tied = [], []
            for V, facets in edges:
                x = dolfinx.mesh.compute_midpoints(V.mesh, 1, facets)[:, 0]
                sides.append((V, facets[x > 1]))
                tied.append((V, facets[x < 1]))
            ties = [Tie(tied[0], scene.side(1, meshes.BOTTOM))]
            ties.append(Tie(tied[1], scene.side(1, meshes.TOP)))
        for component in (0, 1):
            scene.hold(0, component, meshes.BOTTOM)
        scene.load(top, meshes.TOP).value = 0.001
        contact = Contact(*(sides[::-1] if swap else sides))
        problem = scene.problem([contact], ties, solver=solver if whole else "direct")
        problem.solve()
        assert isinstance(problem._tangent, Tangent) == (not whole or solver == "direct")
        order = np.argsort(contact.surfaces[1].x[:, 0])
        found.append((contact.pressures(problem)[order], contact.force(problem)))
        assert 2 <= contact.active.sum() < len(order) - 1
        assert abs(contact.force(problem)[1]) > 1e-4
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-10)


def half_disc(x, start=0.0):
    """A block with a round bottom at y = 0, of radius 4, from ``start`` to 1 across."""
    across = start + (1 - start) * x[:, 0]
    bottom = 4 - np.sqrt(16 - across**2)
    return np.column_stack((across, bottom + x[:, 1] * (1 - bottom)))


@pytest.mark.ranks(2, swap=[False])
@pytest.mark.parametrize("swap", (False, True))
def test_symmetry_plane(swap):
    """A half with a symmetry plane has the pressures of the whole, and half of its force."""
    found = []
    for start, n in ((0.0, 4), (-1.0, 8)):
        bodies = [
            rectangle((n + n // 2, 3), (2 * start, -1), (2, 0)),
            rectangle((n, 3), None, None, mapping=lambda x, start=start: half_disc(x, start)),
        ]
        scene = Assembly(bodies)
        scene.hold(0, 1, meshes.BOTTOM)
        for i in (0, 1):
            scene.hold_at(i, 0, lambda x: np.isclose(x[0], 0))
        scene.load(1, meshes.TOP).value = 0.01
        sides = [scene.side(0, meshes.TOP), scene.side(1, meshes.BOTTOM)]
        contact = Contact(*(sides[::-1] if swap else sides))
        problem = scene.problem([contact])
        problem.solve()
        x, p = contact.surfaces[1].x[:, 0], contact.pressures(problem)
        right = x > -1e-9
        found.append((p[right][np.argsort(x[right])], contact.force(problem)[1] * (1 - start) / 1))
        assert contact.active[right].sum() < right.sum()
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-10)
    assert abs(abs(found[0][1]) - 0.01) <= 1e-9


@pytest.mark.ranks(2, swap=[False])
@pytest.mark.parametrize("swap", (False, True))
def test_rigid_obstacle(swap):
    """A round one without a form acts as an elastic one of which all is prescribed."""
    found = []
    for rigid in (True, False):
        scene = Assembly(
            [
                rectangle((9, 3), (-2, -1), (2, 0)),
                rectangle((4, 2), None, None, mapping=lambda x: half_disc(x, -1.0)),
            ]
        )
        for component in (0, 1):
            scene.hold(0, component, meshes.BOTTOM)
        sides = [scene.side(0, meshes.TOP), scene.side(1, meshes.BOTTOM)]
        contact = Contact(*(sides[::-1] if swap else sides))
        move = fem.Constant(scene.bodies[1].mesh, default_scalar_type((0, 0)))
        if rigid:
            problem = ContactProblem([scene.F[0], None], scene.u, bcs=scene.bcs, contacts=[contact])
        else:
            V = scene.bodies[1].V
            dofs = fem.locate_dofs_geometrical(V, lambda x: x[0] > -9)
            scene.bcs.append(fem.dirichletbc(move, dofs, V))
            problem = scene.problem([contact])
        for place in ((0, -0.1), (0.7, -0.15)):
            move.value[:] = place
            if rigid:
                scene.u[1].interpolate(lambda x, place=place: np.outer(place, np.ones(x.shape[1])))
            problem.solve()
        found.append(np.append(contact.pressures(problem), contact.force(problem)))
    np.testing.assert_allclose(*found, atol=1e-10)
    assert abs(found[0][-1]) > 0.05


def round_at(x):
    """Height of a round surface."""
    return 0.5 + 0.4 * np.sin(np.pi * x[:, 0])


@pytest.mark.ranks(2)
def test_tied_bodies_that_only_contact_holds():
    """Tied across a round surface, where a rotation of both strains the tie a little."""
    found = []
    for gap in (0.0, 0.05):

        def lower(x, gap=gap):
            return np.column_stack((2 * x[:, 0] - 1, gap + x[:, 1] * round_at(x)))

        def upper(x, gap=gap):
            return np.column_stack(
                (2 * x[:, 0] - 1, gap + round_at(x) + x[:, 1] * (1.5 - round_at(x)))
            )

        scene = Assembly(
            [
                rectangle((5, 2), (-2, -1), (2, 0)),
                rectangle((4, 2), None, None, mapping=lower),
                rectangle((7, 2), None, None, mapping=upper),
            ]
        )
        scene.hold(0, 1, meshes.BOTTOM)
        for i in (0, 2):
            scene.hold_at(
                i,
                0,
                lambda x: (
                    np.isclose(x[0], -1 if i else -2) & np.isclose(x[1], gap + 1.5 if i else -1)
                ),
            )
        scene.load(2, meshes.TOP).value = 0.02
        tie = Tie(scene.side(2, meshes.BOTTOM), scene.side(1, meshes.TOP))
        contact = Contact(scene.side(0, meshes.TOP), scene.side(1, meshes.BOTTOM))
        problem = scene.problem([contact], [tie])
        problem.solve()
        assert problem.iterations <= 8 and contact.active.sum() > 2
        assert abs(contact.force(problem)[1] - 0.04) <= 1e-9
        found.append(contact.pressures(problem))
    np.testing.assert_allclose(*found, atol=1e-9)


def test_egg_in_a_shell():
    """Where two ellipses touch only the weight keeps the inner one from rolling."""

    def ellipse(inside, width):
        def mapping(x):
            r, t = inside + width * x[:, 0], 2 * np.pi * x[:, 1]
            return np.column_stack((r * np.cos(t), 0.6 * r * np.sin(t)))

        return mapping

    scene = Assembly(
        [
            rectangle((3, n), 0, 0, mapping=ellipse(*radii), periodic=True)
            for n, radii in ((37, (1.0, 0.4)), (24, (0.4, 0.5)))
        ]
    )
    for component in range(2):
        scene.hold(0, component, meshes.RIGHT)
    scene.weigh(1, 0.01)
    contact = Contact(scene.side(0, meshes.LEFT), scene.side(1, meshes.RIGHT))
    problem = scene.problem([contact])
    problem.solve()
    weight = 0.01 * 12 * np.sin(np.pi / 12) * 0.6 * (0.9**2 - 0.4**2)
    assert contact.force(problem) == pytest.approx((0, weight), abs=1e-9 * weight)
    assert problem.iterations <= 10
    assert problem.halvings == 0


@pytest.mark.ranks(2, turn=[70])
@pytest.mark.parametrize("turn, slopes, above", ((70, (42, 30), 0.0), (83, (60, 58), 0.01)))
def test_box_turns_in_a_groove(turn, slopes, above):
    """Where a vertex opens, the box turns until another one, not overlapping yet, hits the groove.

    Of the vertices with wrong signs alone the small problem has no solution.
    """
    left, right = np.tan(np.radians(slopes))
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))

    def groove(x):
        a = 4 * x[:, 0] - 2
        return np.column_stack((a, np.maximum(-left * a, right * a) + x[:, 1] - 1))

    def box(x):
        return (x - 0.5) * (1.4, 1) @ np.array([[c, s], [-s, c]])

    def placed(x):
        n = np.array(((left, 1), (-right, 1))) / np.hypot((left, right), 1)[:, None]
        corners = box(np.array([[0, 0], [1, 0], [0, 1], [1, 1]]))
        return box(x) + np.linalg.solve(n, above - (corners @ n.T).min(axis=0))

    scene = Assembly(
        [rectangle((8, 1), 0, 0, mapping=groove), rectangle((7, 5), 0, 0, mapping=placed)]
    )
    for component in range(2):
        scene.hold(0, component, meshes.BOTTOM)
    scene.weigh(1, 0.01)
    contact = Contact(scene.side(0, meshes.TOP), (scene.bodies[1].V, scene.bodies[1].boundary))
    problem = scene.problem([contact])
    problem.solve()
    assert contact.force(problem) == pytest.approx((0, 0.014), abs=1e-8)
    assert problem.iterations <= 7 and problem.halvings == 0


def test_beam_on_rollers():
    """Under a punch, all of them apart at first: it rests on what can push."""

    def roller(middle, top):
        def mapping(x):
            across = 0.7 * (2 * x[:, 0] - 1)
            height = np.sqrt(1 - across**2) - 1
            return np.column_stack((middle + across, top - 0.6 + x[:, 1] * (0.6 + height)))

        return mapping

    punch = roller(0, -1.1)  # upside down
    scene = Assembly(
        [
            rectangle((24, 3), (-2.5, 0), (2.5, 1)),
            rectangle((9, 4), None, None, mapping=roller(-1.5, 0)),
            rectangle((9, 4), None, None, mapping=roller(1.5, -0.2)),
            rectangle((9, 4), None, None, mapping=lambda x: punch(x) * (1, -1)),
        ]
    )
    for i in (1, 2):
        for component in (0, 1):
            scene.hold(i, component, meshes.BOTTOM)
    scene.hold_at(0, 0, lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0))
    scene.hold_at(3, 0, lambda x: x[1] > 0)
    load = scene.load(3, meshes.BOTTOM)
    beam = [scene.side(0, tag) for tag in (meshes.BOTTOM, meshes.BOTTOM, meshes.TOP)]
    others = [scene.side(i, meshes.TOP) for i in (1, 2, 3)]
    contacts = [Contact(*pair) for pair in zip(beam, others, strict=True)]
    problem = scene.problem(contacts)
    load.value = 0.008
    problem.solve()
    assert problem.iterations <= 6 and problem.halvings == 0
    left, right, _ = (contact.force(problem)[1] for contact in contacts)
    assert min(abs(left), abs(right)) > 1e-3
    assert abs(left + right - 1.4 * 0.008 * np.sign(left)) <= 1e-9


@two_ranks()
def test_bending_between_clearances():
    """A beam that nothing touches stays where it is; then four edges bend it there."""
    beam = rectangle((24, 3), (-3, -0.25), (3, 0.25))
    elastic = Elastic.on(beam.V, (1.0, 1.0), large=True)
    edges, contacts = [], []
    for x, up in ((-2.5, -1), (2.5, -1), (-1, 1), (1, 1)):
        y = up * 0.36
        edge = rectangle((2, 1), (x - 0.15, y - 0.1), (x + 0.15, y + 0.1))
        edges.append(fem.Function(edge.V))
        tags = (meshes.TOP, meshes.BOTTOM)[::-up]
        contacts.append(Contact((edge.V, edge.facets(tags[0])), (beam.V, beam.facets(tags[1]))))
    u = [*edges, elastic.u]
    problem = ContactProblem([None] * 4 + [elastic.F], u, contacts=contacts)
    for down in (0.001, 0.01, 0.03):
        for edge in edges[2:]:
            edge.x.array[1::2] = -down
        problem.solve()
        along = elastic.u.x.array[::2]
        assert np.abs(along).max(initial=0) <= (1e-12 if down < 0.02 else 0.005), down
    forces = [contact.force(problem, on=elastic.u)[1] for contact in contacts]
    np.testing.assert_allclose(forces, np.array((1, 1, -1, -1)) * forces[0], rtol=1e-6)
    assert forces[0] == pytest.approx(1.009e-4, rel=0.01)


@pytest.mark.parametrize("whole", (0, 1))
def test_finds_what_faces(whole):
    """All of a body's boundary given, what faces away or beside has no part in it."""
    found = []
    for every in (False, True):
        scene = Assembly(
            [rectangle((8, 4), (-2, -1), (2, 0)), rectangle((5, 3), (-1, 0.05), (1, 1.05))]
        )
        for component in (0, 1):
            scene.hold(0, component, meshes.BOTTOM)
        scene.hold(1, 0, meshes.LEFT)
        scene.load(1, meshes.TOP).value = 0.01
        tags = [[meshes.TOP], [meshes.BOTTOM]]
        if every:
            tags[whole] = [meshes.LEFT, meshes.RIGHT, meshes.TOP, meshes.BOTTOM]
        contact = Contact(*(scene.side(i, tags[i]) for i in (0, 1)))
        problem = scene.problem([contact])
        problem.solve()
        p = contact.pressures(problem)
        found.append(np.append(np.sort(p[contact.active]), contact.force(problem)))
    np.testing.assert_allclose(*found, atol=1e-9)


@pytest.mark.parametrize("start", (0.0, 0.1))
def test_small_sliding_is_cheap(start):
    """Linear constraints: an elastic body costs a handful of solves."""

    def above(x):
        return half_disc(x, -1.0) + np.array((0, start))

    scene = Assembly(
        [rectangle((20, 6), (-2, -1), (2, 0)), rectangle((16, 6), None, None, mapping=above)]
    )
    scene.hold(0, 1, meshes.BOTTOM)
    for i in (0, 1):
        scene.hold_at(i, 0, lambda x: np.isclose(x[0], 0))
    load = scene.load(1, meshes.TOP)
    contact = Contact(scene.side(0, meshes.TOP), scene.side(1, meshes.BOTTOM), sliding="small")
    problem = scene.problem([contact])
    for value in (0.01, 0.02):
        load.value = value
        problem.solve()
        assert problem.iterations <= 6
        assert abs(contact.force(problem)[1] / (2 * value) - 1) <= 1e-9


def test_held_by_friction_again():
    """A body that only friction holds, and all of whose vertices slip at a start, sticks."""
    scene = Assembly([rectangle((4, 2), (0, y), (1, y + 1)) for y in (0, 1)])
    for component in (0, 1):
        scene.hold(0, component, meshes.BOTTOM)
    load = scene.load(1, meshes.TOP)
    sides = [scene.side(i, tag) for i, tag in enumerate((meshes.TOP, meshes.BOTTOM))]
    contact = Contact(*sides, friction=0.3, sliding="small")
    problem = scene.problem([contact])
    load.value = 0.01
    problem.solve()
    expected = contact.pressures(problem)
    load.value = 0.02
    problem.rows(contact).state.sticks[:] = False
    problem.solve()
    assert contact.sticking.any() and problem.halvings == 0
    np.testing.assert_allclose(contact.pressures(problem), 2 * expected, rtol=0.05)


@pytest.mark.parametrize("sliding", ("finite", "small"))
@pytest.mark.parametrize("swap", (False, True))
def test_end_of_compliant_surfaces(swap, sliding):
    """A block that stands over an edge is pushed off by p times the overlap (docs/limits.md)."""
    scene = Assembly(
        [rectangle((8, 1), (0, -1), (2, 0), nu=0), rectangle((7, 1), (1.3, 0), (2.3, 1), nu=0)]
    )
    for component in (0, 1):
        scene.hold(0, component, meshes.BOTTOM)
    down = [scene.hold(1, component, meshes.TOP) for component in (0, 1)][1]
    sides = [scene.side(i, tag) for i, tag in enumerate((meshes.TOP, meshes.BOTTOM))]
    compliance = 1e6  # the bodies are as good as rigid
    contact = Contact(*sides[:: -1 if swap else 1], compliance=compliance, sliding=sliding)
    problem = scene.problem([contact])
    down.value = -0.01
    problem.solve()
    across, up = contact.force(problem, on=scene.u[1])
    assert up == pytest.approx(0.7 * 0.01 / compliance, rel=1e-4)
    expected = 0.01**2 / compliance if sliding == "finite" else 0.0
    assert across == pytest.approx(expected, rel=1e-4, abs=1e-9 * up)


@two_ranks()
@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("glued", [False, True])
def test_two_bodies_on_one_face(swap, glued):
    """Facets of the face that reach from one to the other are in the contacts of both: exact."""
    corners = ((0, 0), (2, 1)), ((0, 1), (0.9, 2)), ((0.9, 1), (2, 2))
    cells = (5, 3), (3, 4), (4, 3)
    scene = Assembly([rectangle(n, *ends) for n, ends in zip(cells, corners, strict=True)])
    across = [scene.hold(i, 0, meshes.RIGHT) for i in (0, 2)]
    for i in (0, 1):
        scene.hold(i, 0, meshes.LEFT)
    scene.hold(0, 1, meshes.BOTTOM)
    down = [scene.hold(i, 1, meshes.TOP) for i in (1, 2)]
    pairs = [
        (scene.side(0, meshes.TOP), scene.side(1, meshes.BOTTOM)),
        (scene.side(0, meshes.TOP), scene.side(2, meshes.BOTTOM)),
        (scene.side(1, meshes.RIGHT), scene.side(2, meshes.LEFT)),
    ]
    pairs = [pair[::-1] if swap else pair for pair in pairs]
    contacts = [Contact(*pair, friction=0.3) for pair in pairs[glued:]]
    problem = scene.problem(contacts, [Tie(*pairs[0])] if glued else ())
    for value in across:
        value.value = -0.02
    for value in down:
        value.value = -0.04
    for u in problem.solve():
        x = u.function_space.tabulate_dof_coordinates()[:, :2]
        exact = x * (-0.01, -0.02)
        close(u.x.array.reshape(-1, 2), exact, 1e-12)
