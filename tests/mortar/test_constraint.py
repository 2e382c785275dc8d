# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The constraint Σ_i B_i u_i = 0 on the bodies' dofs."""

from itertools import product

from petsc4py import PETSc

import numpy as np
import pytest
from helpers import (
    at_own_nodes,
    close,
    comm,
    dense,
    interpolated,
    nodal_space,
    residual,
    skew,
    two_blocks,
    two_rings,
)

import dolfinx
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import Tie
from hypergap_dolfinx.algebra.blocks import ConstraintBlocks
from hypergap_dolfinx.mortar.constraint import expand

DEGREES = ((1, 1), (2, 2), (3, 3), (1, 2), (2, 1), (1, 3), (3, 2))
MODES = "interpolated", "free"


def interior_points(domain):
    """Places of this rank's free interior nodes, in the order of B_Σ's columns."""
    alpha = at_own_nodes(domain, domain.hosts.alpha)
    return own_nodes(domain)[(alpha > 1e-10) & (alpha < 1 - 1e-10)].T


def own_nodes(domain):
    """Places of this rank's nodes of Σ, in the order of R's rows."""
    V, dofs = nodal_space(domain)
    return at_own_nodes(domain, V.tabulate_dof_coordinates()[dofs])


def fields(tie, f):
    """A field on both bodies and, if they are free, at Σ's interior nodes."""
    u = [interpolated(V, f) for V in tie.spaces]
    if tie.free_interior:
        vector = tie.blocks()[2].createVecRight()
        vector.array[:] = np.asarray(f(interior_points(tie.domain))).T.ravel()
        u.append(vector)
    return u


def constant(x):
    return np.array((np.full(x.shape[1], 0.7), np.full(x.shape[1], -1.3)))


def polynomial(degree):
    """A vector field with every power of both coordinates."""

    def f(x):
        powers = [(i, j) for i, j in product(range(degree + 1), repeat=2) if i + j <= degree]
        c = np.random.default_rng(7).uniform(-1, 1, size=(2, len(powers)))
        return c @ np.array([x[0] ** i * x[1] ** j for i, j in powers])

    return f


@pytest.mark.ranks(k=[(1, 2)])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("k", DEGREES)
def test_constants_meet_it_everywhere(k, mode):
    """A rigid translation of both bodies, on flat and curved interfaces, open and closed."""
    for sides in (
        two_blocks((3, 5), k, mapping=skew),
        two_rings((4, 6), k, g=2),
        two_rings((8, 5), k, angle=2 * np.pi),
    ):
        tie = Tie(*sides, interior=mode)
        assert residual(tie, *fields(tie, constant)) <= 1e-12


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("k", DEGREES)
@pytest.mark.parametrize("n", ((3, 5), (6, 2)))
def test_polynomials_meet_it_on_a_flat_interface(n, k, mode):
    """Linear fields always; up to the lower of both degrees."""
    tie = Tie(*two_blocks(n, k, mapping=skew), interior=mode)
    for degree in range(1, min(k) + 1):
        assert residual(tie, *fields(tie, polynomial(degree))) <= 1e-12


def test_other_fields_do_not_meet_it():
    """Quadratics with linear elements, and a jump."""
    tie = Tie(*two_blocks((3, 5), mapping=skew))
    assert residual(tie, *fields(tie, polynomial(2))) > 1e-3
    u = [interpolated(V, lambda x, i=i: (1 + i) * constant(x)) for i, V in enumerate(tie.spaces)]
    assert residual(tie, *u) > 0.1


def loads(V, facets, t):
    """∫ t φ_b over facets, for all dofs of a scalar space."""
    tags = dolfinx.mesh.meshtags(
        V.mesh, 1, np.sort(facets), np.full(len(facets), 1, dtype=np.int32)
    )
    ds = ufl.Measure("ds", V.mesh, subdomain_data=tags, metadata={"quadrature_degree": 8})
    x = ufl.SpatialCoordinate(V.mesh)
    b = fem.assemble_vector(fem.form(ufl.inner(t(x), ufl.TestFunction(V)) * ds(1)))
    b.scatter_reverse(dolfinx.la.InsertMode.add)
    return b.array[: V.dofmap.index_map.size_local]


@pytest.mark.ranks(2, k=[(2, 1)])
@pytest.mark.parametrize("k", ((1, 1), (2, 2), (3, 3), (2, 1), (1, 2), (3, 2)))
def test_tractions_of_degree_k_less_one_are_carried(k):
    """Bᵀλ is ∫λφ on Γ1 and −∫λφ on Γ0: why the patch test passes."""
    sides = two_blocks((3, 5), k, shape=(), mapping=skew)
    tie = Tie(*sides)
    for degree in range(k[1]):

        def t(x, p=degree):
            return (1 + x[0] + 2 * x[1]) ** p

        u1 = interpolated(sides[1][0], t)
        rows = gathered(u1)[tie.constraint.dofs]
        multipliers = tie.blocks()[0].createVecLeft()
        start, end = multipliers.getOwnershipRange()
        at = np.argsort(tie.constraint.rows)
        multipliers.array[:] = rows[at][start:end]
        for (V, facets), B, sign in zip(sides, tie.blocks(), (-1, 1), strict=True):
            force = B.createVecRight()
            B.multTranspose(multipliers, force)
            exact = sign * loads(V, facets, t)
            scale = comm.allreduce(np.abs(exact).max(initial=0)) + 1e-300
            np.testing.assert_allclose(force.array, exact, rtol=0, atol=1e-12 * scale)


def gathered(u):
    """Owned values of a function on all ranks, as the global dofs are numbered."""
    owned = u.function_space.dofmap.index_map.size_local * u.function_space.dofmap.index_map_bs
    return np.concatenate(comm.allgather(u.x.array[:owned]))


# Eq. (22)


def gap_matrix(domain):
    """G on all nodes of Σ, dense."""
    G = np.zeros((comm.allreduce(np.diff(domain.owned).item()),) * 2)
    for dof, G_e in zip(domain.nodes, domain.gap_matrices(), strict=True):
        G[np.ix_(dof, dof)] += G_e
    return comm.allreduce(G)


def nodal_alpha(domain):
    return np.concatenate(comm.allgather(at_own_nodes(domain, domain.hosts.alpha)))


@pytest.mark.ranks(2, k=[2])
@pytest.mark.parametrize("k", (1, 2, 3))
@pytest.mark.parametrize("interface", ("flat", "ring"))
def test_free_interior_minimises_eq_22(interface, k):
    """For given x₀, Σ_i B_i u_i = 0 has the x_A of min ½ ∫∫ |∂x/∂α|²."""
    if interface == "flat":
        sides = two_blocks((3, 5), (k, k), shape=(), mapping=skew)
    else:
        sides = two_rings((3, 4), (k, k), shape=(), g=k)
    tie = Tie(*sides, interior="free")
    domain, constraint = tie.domain, tie.constraint
    G, alpha = gap_matrix(domain), nodal_alpha(domain)
    A = alpha > 1e-10
    u0 = interpolated(sides[0][0], lambda x: np.sin(3 * x[0] - 2 * x[1]))
    B0, B1, B_sigma = map(dense, tie.blocks())
    x = dense(constraint.R[0]) @ gathered(u0)  # on Γ0
    x[A] = np.linalg.solve(G[np.ix_(A, A)], -G[np.ix_(A, ~A)] @ x[~A])

    # The tie's: its unknowns are Γ1's dofs and the interior nodes
    unknown = np.hstack((B1[:, constraint.dofs], B_sigma))
    assert unknown.shape == (A.sum(), A.sum())
    y = np.linalg.solve(unknown, -B0 @ gathered(u0))
    on1 = np.isclose(alpha, 1)
    close(dense(constraint.R[1])[np.ix_(on1, constraint.dofs)] @ y[: on1.sum()], x[on1], 1e-12)
    close(np.sort(y[on1.sum() :]), np.sort(x[A & ~on1]), 1e-12)

    energy = x @ G @ x
    for i in np.flatnonzero(A):
        for step in (-1e-3, 1e-3):
            other = x.copy()
            other[i] += step
            assert other @ G @ other > energy


@pytest.mark.parametrize("k", DEGREES)
def test_gap_matrix_is_a_gram_matrix(k):
    """Symmetric, without energy for constants alone, and G_AA is positive definite."""
    domain = Tie(*two_blocks((3, 5), k, mapping=skew)).domain
    G, A = gap_matrix(domain), nodal_alpha(domain) > 1e-10
    close(G, G.T)
    np.testing.assert_allclose(G.sum(axis=1), 0, atol=1e-12 * np.abs(G).max())
    assert np.linalg.eigvalsh(G).min() > -1e-12 * np.abs(G).max()
    assert np.linalg.eigvalsh(G[np.ix_(A, A)]).min() > 1e-4 * G[A, A].min()


# Shapes


@pytest.mark.ranks(k=[(3, 2)])
@pytest.mark.parametrize("shape", ((), (2,)))
@pytest.mark.parametrize("k", DEGREES)
def test_rows_and_columns(k, shape):
    """A row for each component of each dof of Γ1; free: and of each interior node."""
    n, bs = (3, 5), 2 if shape else 1
    sides = two_blocks(n, k, shape=shape)
    num_dofs = [V.dofmap.index_map.size_global * bs for V, _ in sides]
    rows = (k[1] * n[1] + 1) * bs
    tie = Tie(*sides)
    assert [B.getSize() for B in tie.blocks()] == [(rows, m) for m in num_dofs]
    free = Tie(*sides, interior="free")
    p, cells = max(k), sum(n)
    inside = ((p - 1) * (cells + 1) + cells * (p - 1) * (p - 2) // 2) * bs
    expected = [*num_dofs, inside]
    assert [B.getSize() for B in free.blocks()] == [(rows + inside, m) for m in expected]


@pytest.mark.ranks
def test_rows_where_the_sides_overlap_in_part():
    """Dofs of Γ1's facets that Γ0 doesn't reach have none."""
    for spans, rows in ((((0, 1), (0, 2)), 4), (((0, 2), (0, 1)), 6), (((0.5, 2), (0, 1)), 4)):
        tie = Tie(*two_blocks((3, 5), shape=(), spans=spans))
        assert tie.blocks()[1].getSize()[0] == rows
        assert tie.constraint.R_A.getSize()[1] == rows


@pytest.mark.ranks(k=[(1, 3)])
@pytest.mark.parametrize("k", DEGREES)
def test_pull_back_of_polynomials(k):
    """R₀u₀ + R₁u₁ are the field's values at Σ's nodes, and interior nodes get (1 − α)u₀ + αu₁."""
    sides = two_blocks((3, 5), k, shape=(), mapping=skew)
    tie = Tie(*sides)
    R0, R1 = map(dense, tie.constraint.R)
    x, alpha = np.vstack(comm.allgather(own_nodes(tie.domain))).T, nodal_alpha(tie.domain)

    def f(x):
        return (1 + x[0] - 2 * x[1]) ** min(k)

    u0, u1 = (gathered(interpolated(V, f)) for V, _ in sides)
    close(R0 @ u0, (1 - alpha) * f(x), 1e-13)
    close(R1 @ u1, alpha * f(x), 1e-13)
    # The multipliers of both ends' dofs are not spread by round-off
    own = k[1] == max(k)
    assert not own or (np.count_nonzero(R1[np.isclose(alpha, 1)], axis=1) == 1).all()


@pytest.mark.ranks(2)
def test_expand_repeats_each_component():
    """B ⊗ I."""
    tie = Tie(*two_blocks((3, 5)))
    for B, blocked in zip(tie.constraint.B, tie.blocks(), strict=True):
        close(dense(blocked), np.kron(dense(B), np.eye(2)))
        close(dense(expand(B, 3)), np.kron(dense(B), np.eye(3)))
        close(dense(expand(B, 1)), dense(B))


def test_swapped_sides():
    """Γ0 and Γ1 may change places; a linear field meets both."""
    sides = two_blocks((3, 5), (2, 1), mapping=skew)
    for pair in (sides, sides[::-1]):
        tie = Tie(*pair)
        assert residual(tie, *fields(tie, polynomial(1))) <= 1e-12


@pytest.mark.ranks(2)
def test_own_system():
    """B holds without a TiedProblem: the user's matrices are PETSc's AIJ."""
    tie = Tie(*two_blocks((3, 5)))
    assert [B.getType() in ("seqaij", "mpiaij") for B in tie.blocks()] == [True, True]
    assert tie.blocks()[0] is tie.blocks()[0]
    assert isinstance(tie.blocks()[0], PETSc.Mat)


# Multipliers of prescribed dofs


def multiplier_points(tie):
    """Places of the multipliers' dofs, ``(num_multipliers, 2)``."""
    V = tie.spaces[1]
    owned = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local, :2]
    return np.vstack(comm.allgather(owned))[tie.constraint.dofs]


def prescribed(V, components, where):
    """Zero at the dofs of some components on some edges."""
    facets = dolfinx.mesh.locate_entities_boundary(V.mesh, 1, where)
    return [
        fem.dirichletbc(
            default_scalar_type(0), fem.locate_dofs_topological(V.sub(c), 1, facets), V.sub(c)
        )
        for c in components
    ]


@pytest.mark.ranks(k=[(2, 2)])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("k", DEGREES)
def test_tractions_are_carried_where_ends_are_prescribed(k, mode):
    """λ = E λ' holds all polynomials of degree k − 1, with a multiplier less for each component
    of Γ1's ends that is prescribed."""
    sides = two_blocks((3, 5), k)
    V = sides[1][0]
    tie = Tie(*sides, interior=mode)
    bcs = prescribed(V, (0, 1), lambda x: np.isclose(x[0], 0))
    bcs += prescribed(V, (0,), lambda x: np.isclose(x[0], 2))  # it can move in y
    blocks = ConstraintBlocks([V for V, _ in sides], [[], bcs], [tie])
    (extension,) = blocks._rows[0].values()
    matrix = extension.matrix
    rows, columns = matrix.getSize()
    assert rows == tie.blocks()[0].getSize()[0] and rows - columns == 3
    assert all(B.getSize()[0] == columns for B in blocks.free[0])
    E, x = dense(matrix), multiplier_points(tie)[:, 0]
    for component, dropped in enumerate((np.isclose(x, 0) | np.isclose(x, 2), np.isclose(x, 0))):
        row = 2 * tie.constraint.rows + component
        kept = E[row][~dropped]  # what remains keeps its value
        assert set(np.unique(kept)) == {0.0, 1.0} and (kept.sum(axis=1) == 1).all()
        column = kept.argmax(axis=1)
        for degree in range(k[1]):
            t = (1 + x) ** degree
            values = np.zeros(columns)
            values[column] = t[~dropped]
            close(E[row] @ values, t, 1e-12)
        assert not np.delete(E, row, axis=0)[:, column].any()  # components do not mix
    blocks.destroy()


@pytest.mark.ranks
def test_columns_of_prescribed_dofs():
    """They move to the right-hand side: gone from what is solved, kept for what is known."""
    sides = two_blocks((3, 5))
    spaces, tie = [V for V, _ in sides], Tie(*sides)
    bcs = prescribed(spaces[0], (0, 1), lambda x: np.isclose(x[0], 0))
    blocks = ConstraintBlocks(spaces, [bcs, []], [tie])
    full, free = dense(blocks.full[0][0]), dense(blocks.free[0][0])
    close(full, dense(tie.blocks()[0]))
    marker = fem.Function(spaces[0])
    marker.x.array[:] = 1
    for bc in bcs:
        bc.set(marker.x.array)
    close(free, full * gathered(marker))
    blocks.destroy()


@pytest.mark.ranks
def test_nothing_prescribed():
    """No E: all multipliers remain."""
    sides = two_blocks((3, 5))
    tie = Tie(*sides)
    blocks = ConstraintBlocks([V for V, _ in sides], [[], []], [tie])
    assert [E.matrix for rows in blocks._rows for E in rows.values()] == [None]
    close(dense(blocks.free[0][1]), dense(tie.blocks()[1]))
    blocks.destroy()
