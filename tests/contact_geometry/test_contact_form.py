# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The weighted gap: its value, derivatives against finite differences, balance; active sets."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from helpers import close, raises, skew, two_blocks, two_rings
from outlines import side as outline_side

import basix
import meshes
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices
from hypergap_dolfinx import Contact
from hypergap_dolfinx.contact_geometry import rays
from hypergap_dolfinx.contact_geometry.plane import PlaneSegments
from hypergap_dolfinx.contact_solver import complementarity
from hypergap_dolfinx.errors import InterfaceError, SolveError
from hypergap_dolfinx.surface.moving import MovingSurface
from hypergap_dolfinx.surface.trace import create_surface

comm = MPI.COMM_WORLD
STEP = 2e-5  # of differences of the fourth order
DIFFERENCE = 1e-9

SCENES = (
    {"k": (1, 1)},
    {"k": (2, 2), "spans": ((0, 2), (0.33, 1.27))},
    {"k": (1, 2), "spans": ((0.31, 1.2), (0, 2))},
    {"k": (2, 1), "spans": ((0, 1.3), (0.4, 2))},
)
REVOLVED = (  # about x = 0
    {"angle": 2 * np.pi},
    {"k": (1, 2), "spans": ((0.31, 1.2), (0, 2)), "angle": 1.0},
)


RARE = (  # for derivatives: Γ0 much finer; loops that are curved at first; surfaces with corners
    {"n": (60, 3), "amplitude": 0.005},
    {"rings": True, "k": (1, 2)},
    {"whole": True, "k": (2, 1), "spans": ((0, 2), (0.33, 1.27))},
)
ARCS = {"rings": True, "arcs": True, "k": (2, 2)}


def scene(gap=0.1, amplitude=0.02, *, whole=False, rings=False, arcs=False, angle=0.0, **options):
    """Two sides, and displacements that part them and make both surfaces rough."""
    if rings:
        blocks = two_rings(**{"n": (10, 12), "g": 2, "angle": 2 * np.pi, **options})
    else:
        blocks = two_blocks(**{"n": (5, 7), "mapping": skew, **options})
    if whole:
        blocks = [(V, exterior_facet_indices(V.mesh.topology)) for V, _ in blocks]
    below, above = (replace(side.reference, angle=angle) for side in sides_of(blocks))
    if arcs:
        below, above = below.arcs, above.arcs.split
    sides = MovingSurface(below), MovingSurface(above)
    rng = np.random.default_rng(1)
    u = [amplitude * rng.standard_normal((len(side.dofs), 2)) for side in sides]
    u[1] += gap * skew(np.array([[0.0, 1.0]])) - gap * skew(np.zeros((1, 2)))
    return sides, tuple(u), rng


def sides_of(blocks):
    """Γ0 and Γ1 of blocks."""
    return tuple(
        MovingSurface(create_surface(*block, name))
        for block, name in zip(blocks, ("Γ0", "Γ1"), strict=True)
    )


def free(sides):
    """No dof is prescribed."""
    return [np.zeros((len(side.dofs), 2), dtype=bool) for side in sides]


def dense(sparse, shape):
    A = np.zeros(shape)
    np.add.at(A, (sparse.i, sparse.j), sparse.values)
    return A


@pytest.mark.parametrize("options", (*SCENES, *REVOLVED, *RARE, ARCS))
def test_derivatives(options):
    """C is ∂g/∂u and H is ∂(pᵀC)/∂u, with all that moves: feet, rays and cut ends."""
    sides, u, rng = scene(**options)
    opening = PlaneSegments.between(sides, u)
    g, _, C = opening.gap(u)
    size = 2 * sum(len(part) for part in u)
    shape = len(g), size
    direction = [rng.standard_normal(part.shape) for part in u]
    flat = np.concatenate([part.ravel() for part in direction])
    p = rng.random(len(g))
    H = dense(opening.curvature(u, p), (size, size))

    def at(t):
        g, _, C = opening.gap(tuple(a + t * d for a, d in zip(u, direction, strict=True)))
        return np.concatenate((g, p @ dense(C, shape)))

    difference = (8 * (at(STEP) - at(-STEP)) - at(2 * STEP) + at(-2 * STEP)) / (12 * STEP)
    close(difference[: len(g)], dense(C, shape) @ flat, DIFFERENCE)
    close(difference[len(g) :], H @ flat, DIFFERENCE)
    close(H, H.T, 1e-13)


@pytest.mark.parametrize("options", (*SCENES, ARCS))
@pytest.mark.parametrize("gap", (0.1, -0.05))
def test_balance(options, gap):
    """Forces and moments of any pressures, at any gap."""
    sides, u, rng = scene(gap, **options)
    opening = PlaneSegments.between(sides, u)
    g, m, C = opening.gap(u)
    assert (m >= 0).all() and m.sum() > 0.5
    p = rng.random(len(g))
    forces = (p @ dense(C, (len(g), 2 * sum(map(len, u))))).reshape(-1, 2)
    x = np.concatenate([_positions(side, part) for side, part in zip(sides, u, strict=True)])
    size = np.abs(forces).sum()
    assert np.abs(forces.sum(axis=0)).max() <= 1e-13 * size
    moment = x[:, 0] * forces[:, 1] - x[:, 1] * forces[:, 0]
    assert abs(moment.sum()) <= 1e-13 * np.abs(moment).sum()


def _positions(side, u):
    """Where the dofs of a surface are now."""
    surface = side.displaced(u)
    x = np.empty((len(side.dofs), 2))
    facets, X = np.arange(len(surface.facets)), surface.element.points
    if surface.num_parts > 1:  # the first half of each edge, as a polynomial, is all of it
        facets, X = facets[::2], 2 * X
    points = surface.points(np.repeat(facets, len(X)), np.tile(X, (len(facets), 1)))
    x[side.at_facets[facets]] = points.reshape(len(facets), len(X), 2)
    return x


@pytest.mark.parametrize("options", SCENES)
def test_value(options):
    """A gap of constant width has it everywhere, seen by any weight; it is the volume."""
    sides, u, _ = scene(0.07, 0.0, **options)
    segments = PlaneSegments.between(sides, u)
    g, m, _ = segments.gap(u)
    close(g[m > 0] / m[m > 0], np.full((m > 0).sum(), 0.07), 1e-11)
    spans = options.get("spans", ((0, 2), (0, 2)))
    width = min(b for _, b in spans) - max(a for a, _ in spans)
    covered = segments._at(u).sizes.sum()
    assert abs(covered - width) <= 0.1  # ends that don't match are cut at their feet


@pytest.mark.parametrize("options", SCENES)
def test_columns(options):
    """Their integrals over Γ1 of values at vertices are those over the parts of these."""
    sides, u, rng = scene(amplitude=0.0, **options)
    opening = PlaneSegments.between(sides, u)
    columns, (m, _) = opening.columns(u), opening.bears(u)
    values = rng.random(len(m))
    sizes = np.linalg.norm(columns.x[:, 0, 1] - columns.x[:, 0, 0], axis=1)
    close(sizes @ columns.of(values).mean(axis=1), m @ values, 1e-13)


@pytest.mark.parametrize("options", SCENES)
def test_reaches(options):
    """Distances are the largest of columns that have a share of a vertex."""
    sides, u, _ = scene(**options)
    opening = PlaneSegments.between(sides, u)
    columns, least = opening.columns(u), np.zeros(len(sides[1].reference.x))
    apart = np.linalg.norm(columns.x[:, 1] - columns.x[:, 0], axis=2).max(axis=1)
    expected = np.zeros_like(least)
    column, of = np.nonzero(columns.shares.any(axis=1))
    np.maximum.at(expected, columns.vertices[column, of], apart[column])
    close(opening.reaches(u, least, least)[0], expected, 1e-13)


@pytest.mark.parametrize("k", ((1, 1), (2, 2)))
def test_volume_of_revolution(k):
    """Gaps are the volume of a body of revolution, areas those of its surface, on the axis too."""
    blocks, angle = two_blocks(n=(5, 7), k=k, cells=("triangle", "triangle")), 2 * np.pi
    sides = tuple(MovingSurface(replace(s.reference, angle=angle)) for s in sides_of(blocks))
    x = _positions(sides[0], np.zeros((len(sides[0].dofs), 2)))
    u = -0.2 * x[:, :1] * (0, 1), np.tile((0, 0.4), (len(sides[1].dofs), 1))
    g, m, C = PlaneSegments.between(sides, u).gap(u)
    close(m.sum(), np.pi * 2**2)
    close(g.sum(), np.pi * 2**2 * 0.4 + 2 * np.pi * 0.2 * 2**3 / 3)
    close(C.times((0 * u[0], 0 * u[1] + (0, 1)), len(g)), m)
    assert m[sides[1].reference.x[:, 0].argmin()] > 0


@pytest.mark.parametrize("k", ((1, 1), (2, 2), (1, 2)))
def test_volume_between_loops(k):
    """The sum of all gaps is the volume between the bodies but for wedges between its columns.

    They are as thick as the gap over the radius, half of it.
    """
    s, weights = basix.make_quadrature(basix.CellType.interval, 3)
    errors = []
    for apart in (0.1, 0.05):
        sides, u, _ = scene(0.0, 0.0, rings=True, n=(32, 27), k=k)
        u = u[0], apart * _positions(sides[1], u[1])
        g, m, _ = PlaneSegments.between(sides, u).gap(u)
        assert (m > 0).all()
        volume = 0.0
        for surface in (side.displaced(part) for side, part in zip(sides, u, strict=True)):
            N, dN = surface.geometry.tabulate(1, s)[..., 0]
            x, dx = (np.einsum("pa,fai->fpi", table, surface.nodes) for table in (N, dN))
            volume -= 0.5 * (weights * (x[..., 0] * dx[..., 1] - x[..., 1] * dx[..., 0])).sum()
        errors.append(abs(g.sum() / volume - 1))
    assert errors[1] <= 0.53 * errors[0] and errors[0] <= 0.053


@pytest.mark.parametrize("num", (5, 7))
def test_arcs_that_turn(num):
    """A circle of few arcs seen from above: what runs back below is a sheet behind."""

    def volume(num):
        sides = []
        for i in range(2):
            if i == 0:
                given = (num, 1, 0.2, 1), {"angle": 2 * np.pi, "degree": 2}
                mesh, ft = meshes.ring_sector(MPI.COMM_SELF, *given[0], **given[1])
            else:
                low, wide = (-1.6, 1.1), (3.3, 1)
                mesh, ft = meshes.block(MPI.COMM_SELF, (2, 1), lambda x: low + wide * x, degree=2)
            V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
            sides.append((V, ft.find((meshes.OUTER, meshes.BOTTOM)[i])))
        contact = Contact(*sides)
        u = [np.zeros((len(side.dofs), 2)) for side in contact.geometry.sides]
        return contact.geometry.gaps((u[0], u[1]), ()).gap((u[0], u[1]))[0].sum()

    assert abs(volume(num) / volume(48) - 1) <= 0.06


def test_room(monkeypatch):
    """Where there is too little for cells and entries there is more."""
    sides, u, _ = scene()
    found = []
    for room in (rays.entries_a_row, 0):
        monkeypatch.setattr(rays, "entries_a_row", room)
        monkeypatch.setattr(rays, "points_an_edge", room)
        g, _, C = PlaneSegments.between(sides, u).gap(u)
        found.append(np.concatenate((g, dense(C, (len(g), 2 * sum(map(len, u)))).ravel())))
    close(*found, 1e-15)


def test_corner():
    """The edges of a corner see what lies along their normals, whole if they lie at 45°."""
    size, gap, blocks = 0.5, 0.1, []
    turn = np.array(((1, 1), (-1, 1))) / np.sqrt(2)
    for n, place in ((9, lambda x: 2 * x - (1, 2)), (1, lambda x: size * x @ turn + (0, gap))):
        mesh, _ = meshes.block(comm, (n, 1), place)
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        blocks.append((V, exterior_facet_indices(mesh.topology)))
    sides = sides_of(blocks)
    u = tuple(np.zeros((len(side.dofs), 2)) for side in sides)
    _, m, _ = PlaneSegments.between(sides, u).gap(u)
    close(m[sides[1].reference.x[:, 1].argmin()], size)


def test_cut_ends():
    """Where Γ0 ends, weights of vertices are what it covers; they and gaps come and go with it."""
    sides, u, _ = scene(0.05, 0.0, k=(1, 1), spans=((0.1, 2), (0, 2)))
    opening = PlaneSegments.between(sides, u)
    way = skew(np.array([[1.0, 0.0]])) - skew(np.zeros((1, 2)))
    found = []
    for along in np.linspace(0, 0.35, 71):
        u0 = u[0] + along * way
        g, m, _ = opening.gap((u0, u[1]))
        assert (g >= 0).all()
        assert np.abs(g[m > 0] / m[m > 0] - 0.05).max() <= 1e-12
        found.append(opening._at((u0, u[1])).sizes)
    sizes = np.array(found)
    assert np.abs(np.diff(sizes.sum(axis=1))).max() <= 0.006
    assert np.abs(np.diff(sizes, axis=0)).max() <= 0.006 and sizes.min() == 0


def test_branches():
    """Two facets that start at one vertex are no chain."""
    sides, u, _ = scene(n=(3, 2))
    surface = sides[1].reference
    facets = surface.facets.copy()
    facets[-1, 0] = facets[0, 0]
    wrong = sides[0], MovingSurface(replace(surface, facets=facets))
    with raises(InterfaceError, "Γ1 branches at .* one contact for each branch"):
        PlaneSegments.between(wrong, u)


@pytest.mark.parametrize("num", (6, 7))
def test_too_many_sheets(num):
    """More sheets that turn away than there is room for are an error, no wrong gaps."""
    ends = np.array([(0.25, 0.0), (0.0, -1.0)])  # cosine between normals .24: weight .43
    x = np.concatenate([ends - (0, 1.2 * k) for k in range(num)])
    below = outline_side(x, 1, "Γ0", lambda middles: np.arange(len(middles)) % 2 == 0)
    first = np.array([(-0.5, 1.0), (0.75, 1.0), (0.1, 2.0)])
    two = below, outline_side(first, 1, "Γ1", lambda middles: middles[:, 1] == 1)
    u = tuple(np.zeros((len(each.dofs), 2)) for each in two)
    if num == 6:
        assert PlaneSegments.between(two, u).gap(u)[0].sum() > 0
        return
    with raises(SolveError, "more than 6 sheets"):
        PlaneSegments.between(two, u)


def test_side_along_a_normal():
    """The facets of a side along one ray, by round-off, aren't sheets one behind the other."""
    leg, side, tip = [(0.0, -0.1)], [(0.1 * k, 0.0) for k in range(9)], [(0.8, 0.1)]
    x0 = np.array(leg + side + tip + [(-0.5, 1.0)])
    x1 = np.array([(0.85, 0.11), (0.85, -0.04), (1.5, 0.0)])
    found = []
    for turn in (0, 0.07, 0.15, 0.19):
        turned = np.array([(np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))])
        below = outline_side(x0 @ turned, 1, "Γ0", lambda middles: np.arange(len(middles)) < 10)
        above = outline_side(x1 @ turned, 1, "Γ1", lambda middles: np.arange(len(middles)) == 0)
        u = tuple(np.zeros((len(each.dofs), 2)) for each in (below, above))
        found.append(PlaneSegments.between((below, above), u).gap(u)[:2])
    assert min(found[0][0]) > 0
    close(found, [found[0]] * len(found))


def jump(at, where, width):
    """Largest jump of gaps as a parameter passes a value.

    Args:
        at: Points of Γ0's outline, and a facet of Γ1 with a point of its body, by the parameter.
        where: The value.
        width: How near to it gaps are compared.
    """
    found = []
    for value in (where - width, where + width):
        x0, x1 = at(value)
        degree = 2 if len(x0) == 8 else 1  # every second facet is of Γ0
        below = outline_side(x0, degree, "Γ0", lambda middles: np.arange(len(middles)) % 2 == 0)
        sides = below, outline_side(x1, 1, "Γ1", lambda middles: np.arange(len(middles)) == 0)
        u = tuple(np.zeros((len(each.dofs), 2)) for each in sides)
        found.append(PlaneSegments.between(sides, u).gap(u)[0])
    return np.abs(found[1] - found[0]).max()


def test_unseen_vertices():
    """The quadrature on a curved facet isn't another one where a facet behind it is seen or not."""

    def at(slope):  # the cosine of the straight facet goes through .1
        curved = (0.9, 0.0), (0.6, -0.35), (0.2, -1.2)
        straight = (0.5, -3), (0.5 - slope / 2, -3.5), (0.5 - slope, -4)
        x0 = np.array([*curved, (0.3, -2), *straight, (0.8, -2)])
        return x0, np.array([(0.0, 1.0), (1.0, 1.0), (0.5, 2.0)])

    assert jump(at, 0.1 / np.sqrt(0.99), 1e-9) <= 1e-7


def test_beside_an_end():
    """Beside an end of Γ0 what lies behind Γ1 doesn't come at once as Γ1 goes through its line."""

    def at(y):
        x0 = np.array([(1, 0), (0, 0), (-0.1, 0.4), (-0.9, 0.4)])
        return x0, np.array([(-0.39, y), (0.1, y), (-0.2, y + 1)])

    assert jump(at, 0.0, 1e-9) <= 1e-7


def test_degree():
    """One that is too high is told."""
    sides, u, _ = scene(n=(1, 1), k=(1, 12))
    with raises(InterfaceError, r"Γ1 has degree 12: contact .* up to 11"):
        PlaneSegments.between(sides, u)


def test_holding():
    """Vertices are added, the nearest first, until what is free is held."""
    x = np.linspace(-1, 1, 5)
    holds = np.column_stack((np.ones(5), x))
    distance = np.array([0.5, 0.2, 0.1, 0.3, 0.4])
    valid, none = np.ones(5, dtype=bool), np.zeros(5, dtype=bool)
    on, free = complementarity.holding(none, distance, valid, holds)
    assert np.flatnonzero(on).tolist() == [1, 2] and free == 0
    on, free = complementarity.holding(np.arange(5) == 4, distance, valid, holds)
    assert np.flatnonzero(on).tolist() == [2, 4] and free == 0
    on, free = complementarity.holding(none, distance, valid, holds, [[1.0, 0.0]])
    assert np.flatnonzero(on).tolist() == [1] and free == 0
    on, free = complementarity.holding(none, distance, np.arange(5) == 3, holds)
    assert np.flatnonzero(on).tolist() == [3] and free == 1


def test_is_too_much():
    """Loads in the cones of friction of several points, just outside, and away from all forces."""
    rng = np.random.default_rng(0)
    for _ in range(6):
        x, mu = rng.normal(size=(6, 3)) * (1, 1, 0), 0.2 + rng.random(6)
        # Forces on a flat body's six motions, along each axis at each point
        rows = np.stack([np.hstack((0 * x + e, np.cross(x, e))) for e in np.eye(3)[[2, 0, 1]]])

        def pushes(motion, rows=rows, mu=mu):
            slips = rows[1:] @ motion
            ways = mu * slips / np.maximum(np.linalg.norm(slips, axis=0), 1e-300)
            return rows[0] + np.einsum("ka,kam->am", ways, rows[1:])

        p, q = rng.random(6), rng.normal(size=(2, 6))
        q *= 0.9 * mu * p / np.linalg.norm(q, axis=0)
        assert not complementarity.is_too_much(
            p @ rows[0] + np.einsum("ka,kam->m", q, rows[1:]), pushes
        )
        assert complementarity.is_too_much(-p @ rows[0], pushes)
        mu[:] = mu[0]  # all of it slides along the first axis
        for share in (1 - 1e-6, 1 + 1e-6):
            push = np.einsum("a,am->m", share * mu * p, rows[1])
            assert complementarity.is_too_much(p @ rows[0] + push, pushes) == (share > 1)
    assert not complementarity.is_too_much(np.zeros(6), pushes)
