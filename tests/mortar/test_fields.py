# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Gap, slip and traction on Σ, and integrals over it."""

from mpi4py import MPI

import numpy as np
import pytest
from helpers import (
    close,
    comm,
    elasticity,
    interpolated,
    residual,
    skew,
    two_blocks,
    two_rings,
)

import dolfinx
import meshes
from dolfinx import fem
from hypergap_dolfinx import Tie, TiedProblem
from hypergap_dolfinx.mortar import fields, kernel

DEGREES = ((1, 1), (2, 2), (3, 3), (1, 2), (3, 1))
NORMAL = np.array((-np.sin(np.radians(25)), np.cos(np.radians(25))))  # of the skew interface
TANGENT = np.array((NORMAL[1], -NORMAL[0]))


def largest(values):
    """Over all ranks."""
    return comm.allreduce(np.abs(values).max(initial=0), MPI.MAX)


def moved(tie, f0, f1):
    """Gap and slip at Gauss points of displacements that are functions of x."""
    u = [interpolated(V, f) for V, f in zip(tie.spaces, (f0, f1), strict=True)]
    q = tie.quadrature(4)
    return q, *(q.evaluate(f) for f in tie.gap(*u))


def rigid(vector):
    return lambda x: np.outer(vector, np.ones(x.shape[1]))


def bulk(x):
    """A displacement that both bodies share."""
    return np.array((0.3 * x[0] - 0.2 * x[1] + 1, 0.1 * x[0] + 0.4 * x[1]))


@pytest.mark.ranks(k=[(1, 2)])
@pytest.mark.parametrize("mode", ("interpolated", "free"))
@pytest.mark.parametrize("k", DEGREES)
def test_rigid_opening(k, mode):
    """Γ1 leaves along the normal: the gap is how far, there is no slip."""
    tie = Tie(*two_blocks((3, 5), k, mapping=skew), interior=mode)
    _, gap, slip = moved(tie, bulk, lambda x: bulk(x) + 0.25 * rigid(NORMAL)(x))
    np.testing.assert_allclose(gap, 0.25, atol=1e-12)
    np.testing.assert_allclose(slip, 0, atol=1e-12)


@pytest.mark.parametrize("k", DEGREES)
def test_rigid_slide(k):
    """Γ1 moves along the interface: that is the slip, the gap stays shut."""
    tie = Tie(*two_blocks((3, 5), k, mapping=skew))
    _, gap, slip = moved(tie, bulk, lambda x: bulk(x) - 0.25 * rigid(TANGENT)(x))
    np.testing.assert_allclose(gap, 0, atol=1e-12)
    np.testing.assert_allclose(slip, np.broadcast_to(-0.25 * TANGENT, slip.shape), atol=1e-12)


def test_gap_is_positive_where_the_surfaces_part():
    """Whichever side is Γ1."""
    sides = two_blocks((3, 5))
    for pair, up in ((sides, (0, 1)), (sides[::-1], (0, -1))):
        _, gap, _ = moved(Tie(*pair), rigid((0, 0)), rigid(up))
        np.testing.assert_allclose(gap, 1, atol=1e-12)


@pytest.mark.ranks
def test_linear_jump():
    """Of an opening that grows along the interface, ∂u/∂α is the jump (k = 2: α times it)."""
    tie = Tie(*two_blocks((3, 5), (2, 2)))
    q, gap, slip = moved(tie, rigid((0, 0)), lambda x: np.array((0 * x[0], 1 + x[0])))
    np.testing.assert_allclose(gap[..., 0], 1 + q.x[..., 0], atol=1e-12)
    np.testing.assert_allclose(slip, 0, atol=1e-12)


@pytest.mark.ranks(k=[2], g=[2], angle=[2 * np.pi])
@pytest.mark.parametrize("angle", (np.pi / 2, 2 * np.pi))
@pytest.mark.parametrize("g", (1, 2))
@pytest.mark.parametrize("k", (1, 2, 3))
def test_translation_on_a_ring(k, g, angle):
    """∂u/∂α is the jump d on any interface (eq. 21): gap d · n, slip the rest."""
    tie = Tie(*two_rings((6, 9), (k, k), g=g, angle=angle))
    d = np.array((0.3, -0.2))
    u = [interpolated(V, rigid(i * d)) for i, V in enumerate(tie.spaces)]
    gap, slip = tie.gap(*u)
    nodes = gap.function_space.tabulate_dof_coordinates()[gap.function_space.dofmap.list]
    jump = gap.x.array[gap.function_space.dofmap.list]
    q = tie.quadrature(2 * (k + g))
    exact = q.normal @ d
    integral = np.concatenate([q.integrate(q.evaluate(f)) for f in (gap, slip)])
    slide = d - exact[..., None] * q.normal
    desired = np.append(q.integrate(exact), q.integrate(slide))
    np.testing.assert_allclose(integral, desired, rtol=0, atol=1e-11)
    if g == 1:
        close(np.einsum("cpi->cp", q.evaluate(slip) ** 2) + q.evaluate(gap)[..., 0] ** 2, d @ d)
    # n is the radius to half an edge's angle
    radial = nodes[..., :2] / np.linalg.norm(nodes[..., :2], axis=-1, keepdims=True)
    half = angle / 6 / 2
    assert largest(jump - radial @ d) <= (1.01 * half if g == 1 else half**2) * np.linalg.norm(d)


def turned(x):
    """A small rotation."""
    return np.array((-x[1], x[0]))


@pytest.mark.parametrize("n", ((6, 6), (6, 9), (12, 8), (16, 24)))
def test_sliding_ring_of_straight_edges(n):
    """A rotation slides by r. Chords open it by as much as their nodes are off their middles."""
    tie = Tie(*two_rings(n))
    q, gap, slip = moved(tie, rigid((0, 0)), turned)
    # The apex is at most half an edge off the middle of its base: gap ≤ r sin(θ/2)
    theta = np.pi / 2 / min(n)
    bound = 2.5 * np.sin(theta / 2)
    assert largest(gap) <= bound * (1 + 1e-12)
    if n[0] == n[1]:  # the apex is at an end of its base
        assert largest(gap) >= bound * (1 - 1e-12)
    tangent = np.stack((-q.normal[..., 1], q.normal[..., 0]), axis=-1)
    speed = np.einsum("cpi,cpi->cp", slip, tangent)
    assert largest(speed - 2.5) <= 2.5 * (1 - np.cos(theta)) * 1.01
    np.testing.assert_allclose(slip, speed[..., None] * tangent, atol=1e-13)


def norm(q, values):
    return np.sqrt(q.integrate((values**2).sum(-1)))


@pytest.mark.parametrize("k", (1, 2, 3))
def test_sliding_ring_converges(k):
    """The gap of a slide is of order k: that of the normals, and of ∂φ/∂α."""
    gaps, slips = [], []
    for m in (1, 2, 4):
        tie = Tie(*two_rings((4 * m, 6 * m), (k, k), g=k))
        q, gap, slip = moved(tie, rigid((0, 0)), turned)
        exact = (
            2.5
            * np.stack((-q.x[..., 1], q.x[..., 0]), axis=-1)
            / np.linalg.norm(q.x, axis=-1, keepdims=True)
        )
        gaps.append(norm(q, gap))
        slips.append(norm(q, slip - exact))
    print(gaps, slips)
    assert np.log2(gaps[1] / gaps[2]) >= k - 0.1
    assert np.log2(slips[1] / slips[2]) >= k - 0.1


@pytest.mark.ranks(2, k=[2])
@pytest.mark.parametrize("k", (1, 2))
def test_scalar_jump(k):
    """One value in place of two."""
    tie = Tie(*two_blocks((3, 5), (k, k), shape=(), mapping=skew))
    u = [interpolated(V, lambda x, i=i: 2 + i + x[0] - x[1]) for i, V in enumerate(tie.spaces)]
    jump, slip = tie.gap(*u)
    assert slip is None
    np.testing.assert_allclose(jump.x.array, 1, atol=1e-12)


# The traction


def strained(x):
    """A linear displacement with every component of stress."""
    return np.array((0.3 * x[0] + 0.2 * x[1], 0.4 * x[0] - 0.1 * x[1] + 0.5))


SIGMA = np.array([(0.8, 0.6), (0.6, 0.0)])  # 2 ε + tr ε I


def patch_problem(sides, tie):
    """The linear displacement on the whole boundary but the interface."""
    bcs = []
    for V, facets in sides:
        mesh = V.mesh
        mesh.topology.create_connectivity(1, 2)
        held = np.setdiff1d(dolfinx.mesh.exterior_facet_indices(mesh.topology), facets)
        dofs = fem.locate_dofs_topological(V, 1, held)
        bcs.append(fem.dirichletbc(interpolated(V, strained), dofs))
    a, L = zip(*(elasticity(V) for V, _ in sides), strict=True)
    return TiedProblem(a, L, bcs=bcs, ties=[tie])


@pytest.mark.ranks(k=[(1, 2)], swap=[True])
@pytest.mark.parametrize("mode", ("interpolated", "free"))
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("k", ((1, 1), (2, 2), (3, 3), (1, 2)))
def test_traction_of_a_patch_test(k, swap, mode):
    """λ = σn₀ at every point; n₀ points out of Γ0's body."""
    sides = two_blocks((3, 5), k, mapping=skew)
    sides = sides[::-1] if swap else sides
    tie = Tie(*sides, interior=mode)
    problem = patch_problem(sides, tie)
    u = problem.solve()
    q = tie.quadrature(4)
    n0 = -NORMAL if swap else NORMAL
    exact = SIGMA @ n0
    values = q.evaluate(tie.traction(problem))
    np.testing.assert_allclose(values, np.broadcast_to(exact, values.shape), atol=1e-11)
    close(q.integrate(values), 2 * exact, 1e-11)
    for side, sign in ((0, 1), (1, -1)):
        t = tie.traction(problem, on=f"side{side}").x.array.reshape(-1, 2)
        np.testing.assert_allclose(t, np.broadcast_to(sign * exact, t.shape), atol=1e-11)
    # The same solution has no gap
    assert max(largest(q.evaluate(f)) for f in tie.gap(*u)) <= 1e-11
    if mode == "interpolated":
        assert residual(tie, *u) <= 1e-12


# GapQuadrature


@pytest.mark.ranks(2, k=[2])
@pytest.mark.parametrize("k", (1, 2))
def test_quadrature_of_polynomials(k):
    """∫ x² over the interface, of values, vectors and functions."""
    tie = Tie(*two_blocks((3, 5), (k, k)))
    q = tie.quadrature(4)
    x = q.x[..., 0]
    close(q.integrate(x**2), 8 / 3)
    close(q.integrate(q.x), (2, 0))
    close(q.integrate(np.ones(x.shape)), 2)
    f = interpolated(tie.alpha.function_space, lambda x: 3 + x[0])
    assert q.evaluate(f).shape == (*x.shape, 1)
    close(q.integrate(q.evaluate(f)), [8])
    close(q.integrate(q.evaluate(tie.alpha)), [1])  # ∫ α dα = 1/2 of the length


def test_normals_at_gauss_points():
    """Unit, from Γ0 to Γ1; radial on curved facets to the order of the geometry."""
    for g, error in ((1, 0.14), (2, 6e-3), (3, 3e-4)):
        q = Tie(*two_rings((6, 9), g=g)).quadrature(4)
        np.testing.assert_allclose(np.linalg.norm(q.normal, axis=-1), 1, atol=1e-14)
        radial = q.x / np.linalg.norm(q.x, axis=-1, keepdims=True)
        assert largest(q.normal - radial) <= error
    q = Tie(*two_rings((6, 9))[::-1]).quadrature(4)
    assert (np.einsum("cpi,cpi->cp", q.normal, q.x) < 0).all()


class Given:
    """A problem that is solved: multipliers by hand."""

    def __init__(self, values):
        self.multipliers = lambda tie: values


@pytest.mark.ranks(2)
def test_cells_with_a_node_without_area():
    """A hexahedron's corner of 180° over the edge of a plate: |N| = 0 at nodes of Σ.

    λ and gaps are bounded there, and their integrals are those of ∂u/∂α, by the kernel's functions.
    """
    places = (
        lambda x: x - (0, 0, 1),
        lambda x: np.column_stack(
            (x[:, 0] - x[:, 1] / 2, x[:, 1] - (1 + x[:, 1]) * x[:, 0] / 2 + 0.25, x[:, 2])
        ),
    )
    sides = []
    for n, tag, place in zip(
        ((1, 4, 1), (2, 2, 1)), (meshes.FRONT, meshes.BACK), places, strict=True
    ):
        mesh, ft = meshes.block(comm, n, place, cell="hexahedron")
        sides.append((fem.functionspace(mesh, ("Lagrange", 2)), ft.find(tag)))
    tie = Tie(*sides[::-1])
    domain, R = tie.domain, tie.constraint.R_A
    element = kernel.GapElement.at(
        domain.geometry, domain.element, domain.element.points, np.ones(domain.element.dim)
    )
    length = np.linalg.norm(
        kernel.geometry_at_points(element, domain.x, domain.alpha_vertices)[0], axis=2
    )
    least = (length.min(axis=1) / length.max(axis=1)).min(initial=1)
    assert comm.allreduce(least, MPI.MIN) < 1e-13
    here = slice(*R.getOwnershipRangeColumn())
    values = np.random.default_rng(1).random(R.getSize()[1])[here, None]
    λ = tie.traction(Given(values))
    u = [interpolated(V, lambda x: x[0] * (1 + x[1])) for V in tie.spaces]
    u[1].x.array[:] *= 2
    gap, _ = tie.gap(*u)
    nodal = fields.nodal_values(domain, R, values)
    opened = [
        fields.nodal_values(domain, P, fields.owned_values(v))
        for P, v in zip(tie.constraint.R, u, strict=True)
    ]
    degree = 20
    q, tables = tie.quadrature(degree), domain.quadrature(degree)
    _, v = kernel.geometry_at_points(tables, domain.x, domain.alpha_vertices)
    dphi = kernel.alpha_derivatives(tables, v)
    for f, a, bound in ((λ, nodal, 100), (gap, sum(opened), 10)):
        assert largest(f.x.array) < bound
        close(q.integrate(q.evaluate(f)), q.integrate((dphi @ a)[domain.order]), 1e-10)
