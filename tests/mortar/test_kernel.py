# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The gap finite element against eqs. (6)–(19), followed literally in exact arithmetic."""

from fractions import Fraction
from itertools import product
from math import factorial, prod

import mpmath
import numpy as np
import pytest
import sympy
from helpers import close, sweep

import basix
from hypergap_dolfinx import InvertedCellError
from hypergap_dolfinx.mortar.kernel import (
    GapElement,
    affine_gap_matrices,
    alpha_derivatives,
    cofactor,
    curved_gap_matrices,
    geometry_at_points,
)

pytestmark = pytest.mark.serial

TRIANGLE, TETRAHEDRON = basix.CellType.triangle, basix.CellType.tetrahedron


def lagrange(cell, degree):
    """The basix element with equispaced nodes."""
    variant = basix.LagrangeVariant.equispaced
    return basix.create_element(basix.ElementFamily.P, cell, degree, variant)


# The reference. Arrays hold fractions or mpmath's numbers.


def det(A):
    """Determinant by Laplace expansion."""
    if len(A) == 1:
        return A[0, 0]
    return sum((-1) ** i * A[i, 0] * det(np.delete(A, i, 0)[:, 1:]) for i in range(len(A)))


def inverse(A):
    """Inverse by Cramer's rule."""
    n = len(A)
    adjugate = np.empty((n, n), dtype=object)
    for i, j in product(range(n), repeat=2):
        adjugate[j, i] = (-1) ** (i + j) * det(np.delete(np.delete(A, i, 0), j, 1))
    return adjugate / det(A)


def directed_element(J):
    """dΣ, eqs. (8) and (9): the determinant expanded along its last column."""
    n = J.shape[1]
    return np.array([(-1) ** (i + n) * det(np.delete(J, i, 0)) for i in range(n + 1)])


def paper(J, dphi):
    """The square of √det ḡ (eq. 12) and ∂φ_a/∂α (eq. 19) at a point.

    Args:
        J: Eq. (6), ``(n + 1, n)``; its last row is ∂α/∂ξ.
        dphi: ∂φ_a/∂ξ, ``(num_nodes, n)``.
    """
    d_sigma = directed_element(J)
    N = np.append(d_sigma[:-1], 0)  # eq. (10): n dΓ_α dα
    J_bar = J - np.outer(N, N @ J) / (N @ N)  # eq. (11)
    g_bar = J_bar.T @ J_bar
    return det(g_bar), dphi @ inverse(g_bar) @ J[-1]


def polynomials(element):
    """Exact Lagrange polynomials on an element's nodes, in the symbols ξ."""
    points = [
        [sympy.Rational(Fraction(c).limit_denominator(99)) for c in p] for p in element.points
    ]
    xi = sympy.symbols(f"xi:{len(points[0])}")
    powers = [
        p for p in product(range(element.degree + 1), repeat=len(xi)) if sum(p) <= element.degree
    ]

    def monomials(x):
        return [prod(c**e for c, e in zip(x, p, strict=True)) for p in powers]

    vandermonde = sympy.Matrix([monomials(p) for p in points])
    return xi, list(sympy.Matrix([monomials(xi)]) * vandermonde.inv())


def gradients(f, xi):
    """∂f_a/∂ξ_j as functions of ξ that compute in whatever they are given."""
    table = [[sympy.diff(f_a, x) for x in xi] for f_a in f]
    return sympy.lambdify([xi], table, modules="mpmath")


def integral(f, xi):
    """Integral of a polynomial over the reference simplex."""
    total = Fraction(0)
    for powers, c in sympy.Poly(f, *xi).terms():
        moment = Fraction(prod(map(factorial, powers)), factorial(sum(powers) + len(xi)))
        total += Fraction(int(c.p), int(c.q)) * moment
    return total


# Cells, rational. Their normals from Γ0 to Γ1 point up, more or less.

AFFINE = {
    "base on Γ0": ([(0, 0), (3, 1), (1, "1/7")], (0, 0, 1), (0, 1)),
    "base on Γ1": ([(3, 1), (0, "1/5"), (1, "-1/7")], (1, 1, 0), (0, 1)),
    "no volume": ([(0, 0), (3, "3/2"), (1, "1/2")], (0, 0, 1), (0, 1)),
    "inner vertex": ([(0, 0), (3, 1), (1, "1/7")], (0, "1/3", 1), (0, 1)),
    "tetrahedron": (
        [(0, 0, 0), (2, 0, "1/3"), ("1/2", 1, "-1/5"), (1, "1/2", "1/9")],
        (0, 0, 0, 1),
        (0, 0, 1),
    ),
    "two edges": (
        [(0, 0, 0), (2, 0, "1/3"), (1, "3/4", "1/7"), (1, "-1/2", "1/9")],
        (0, 0, 1, 1),
        (0, 0, 1),
    ),
}


def fractions(table):
    return np.vectorize(lambda c: Fraction(str(c)), otypes=[object])(np.array(table, dtype=object))


@pytest.mark.parametrize("degree", (1, 2))
@pytest.mark.parametrize("name", AFFINE)
def test_affine_cell(name, degree):
    """G_ab = √det ḡ ∫ ∂φ_a/∂α ∂φ_b/∂α d□ with an exact integral."""
    x, alpha, up = AFFINE[name]
    x, alpha = fractions(x), fractions(alpha)
    cell = TRIANGLE if len(up) == 2 else TETRAHEDRON
    element = lagrange(cell, degree)
    xi, phi = polynomials(element)
    chi = np.column_stack((x, alpha))
    J = (chi[1:] - chi[0]).T
    # ∂φ/∂α = Σ_j ∂φ/∂ξ_j v_j with constant v: eq. (19) of the functions ξ_j
    g, v = paper(J, fractions(np.eye(len(up), dtype=int)))
    dphi = [
        sum(sympy.diff(f, x) * sympy.Rational(v_j) for x, v_j in zip(xi, v, strict=True))
        for f in phi
    ]
    exact = np.array([[float(integral(sympy.expand(a * b), xi)) for b in dphi] for a in dphi])
    exact *= float(sympy.sqrt(sympy.Rational(g)))

    tables = GapElement.with_quadrature(lagrange(cell, 1), element, 2 * degree - 2)
    arrays = [np.array([a], dtype=float) for a in (x, alpha, up)]
    (G,) = affine_gap_matrices(tables, *arrays)
    close(G, exact)
    (G,) = curved_gap_matrices(tables, *arrays)
    close(G, exact)


def curved_cell(n):
    """A quadratic cell: vertices, then curved edges. Its nodes are rational."""
    cell = TRIANGLE if n == 2 else TETRAHEDRON
    points = np.rint(2 * lagrange(cell, 2).points).astype(int)
    vertices = fractions(AFFINE["base on Γ0" if n == 2 else "tetrahedron"][0])
    x = []
    for i, p in enumerate(points):
        weights = fractions([2 - p.sum(), *p]) / 2
        bump = Fraction(i * (n + 1 - i % 3), (200, 900)[n - 2]) if i > n else Fraction(0)
        x.append(weights @ vertices + bump * np.array([1, -2, 1][:n]))
    return cell, np.array(x), fractions(AFFINE["base on Γ0" if n == 2 else "tetrahedron"][1])


def _mpf(fraction):
    return mpmath.mpf(fraction.numerator) / fraction.denominator


def curved_reference(n, degree):
    """A function of ξ that gives det ḡ and ∂φ_a/∂α on the curved cell."""
    cell, x, alpha = curved_cell(n)
    xi, psi = polynomials(lagrange(cell, 2))
    dpsi, dphi = gradients(psi, xi), gradients(polynomials(lagrange(cell, degree))[1], xi)

    def evaluate(point):
        number = Fraction if isinstance(point[0], Fraction) else _mpf
        nodes, dalpha = (np.vectorize(number)(a) for a in (x, alpha[1:] - alpha[0]))
        J = np.vstack((nodes.T @ np.array(dpsi(point), dtype=object), dalpha))
        return paper(J, np.array(dphi(point), dtype=object))

    return cell, np.array(x, dtype=float), np.array(alpha, dtype=float), evaluate


@pytest.mark.parametrize("n", (2, 3))
def test_points_of_a_curved_cell(n):
    """√det ḡ and ∂φ_a/∂α at rational points, where they are exact."""
    cell, x, alpha, evaluate = curved_reference(n, 2)
    points = [[Fraction(1 + i, 7 + j) for j in range(n)] for i in range(2)]
    tables = GapElement.at(
        lagrange(cell, 2), lagrange(cell, 2), np.array(points, dtype=float), np.ones(2)
    )
    N, v = geometry_at_points(tables, x[None], alpha[None])
    computed = alpha_derivatives(tables, v)
    for p, point in enumerate(points):
        g, dphi = evaluate(point)
        assert isinstance(g, Fraction)
        close(N[0, p] @ N[0, p], float(g))
        close(computed[0, p], dphi.astype(float))


@pytest.mark.parametrize(
    ("n", "degree", "orders"), sweep(((2, 2, (20, 24)), (2, 1, (20, 24)), (3, 1, (7, 8))), 2)
)
def test_curved_cell(n, degree, orders):
    """G_ab by high-order quadrature of the literal formulas, with 30 digits."""
    cell, x, alpha, evaluate = curved_reference(n, degree)
    with mpmath.workdps(30):
        references = []
        for order in orders:
            gauss = [((1 + r) / 2, w / 2) for r, w in zip(*_gauss_legendre(order), strict=True)]
            total = 0
            for rule in product(gauss, repeat=n):
                # Collapsed coordinates: the cube onto the simplex
                point, weight, left = [], mpmath.mpf(1), mpmath.mpf(1)
                for i, (r, w) in enumerate(rule):
                    point.append(left * r)
                    weight *= w * (1 - r) ** (n - 1 - i)
                    left *= 1 - r
                g, dphi = evaluate(point)
                total = total + weight * mpmath.sqrt(g) * np.outer(dphi, dphi)
            references.append(total)
        converged = np.abs(references[1] - references[0]).max() / np.abs(references[1]).max()
    print(mpmath.nstr(converged))
    assert converged < 1e-14
    exact = references[1].astype(float)
    tables = GapElement.with_quadrature(lagrange(cell, 2), lagrange(cell, degree), 30)
    (G,) = curved_gap_matrices(tables, x[None], alpha[None], np.eye(n)[-1:])
    close(G, exact)


def _gauss_legendre(order):
    """Points and weights on (−1, 1) with the working precision."""
    roots, weights = [], []
    for guess in np.polynomial.legendre.leggauss(order)[0]:
        r = mpmath.findroot(lambda t: mpmath.legendre(order, t), guess)
        slope = order * mpmath.legendre(order - 1, r) / (1 - r * r)
        roots.append(r)
        weights.append(2 / ((1 - r * r) * slope**2))
    return roots, weights


# Hand-made cells and identities.


def test_eq_8_of_a_hand_made_cell():
    """Γ0's edge from (0, 0) to (2, 0), and a node (1/2, 1/3) at α = 1."""
    J = np.array([[2, 0.5], [0, 1 / 3], [0, 1]])
    close(directed_element(J), (0, -2, 2 / 3))
    tables = GapElement.with_quadrature(lagrange(TRIANGLE, 1), lagrange(TRIANGLE, 1), 0)
    x = np.array([[(0, 0), (2, 0), (0.5, 1 / 3)]])
    N, v = geometry_at_points(tables, x, np.array([(0, 0, 1.0)]))
    close(N[0, 0], (0, 2))
    # One up in α and none along the edge: the apex less a quarter of the edge
    close(v[0, 0], (-0.25, 1))
    # ∂φ/∂α: 1 at the apex, and what is above (1/2, 0) is taken from there
    close(alpha_derivatives(tables, v)[0, 0], (-0.75, -0.25, 1))
    (G,) = affine_gap_matrices(tables, x, np.array([(0, 0, 1.0)]), np.array([(0, 1)]))
    close(G, np.outer((-0.75, -0.25, 1), (-0.75, -0.25, 1)))


@pytest.mark.parametrize("n", (2, 3))
def test_cofactors_of_singular_matrices(n, rng):
    """cof(X) = det(X) X⁻ᵀ has a limit: minors, whatever the rank."""
    X = rng.normal(size=(5, n, n))
    np.testing.assert_allclose(
        cofactor(X), np.linalg.det(X)[:, None, None] * np.linalg.inv(X).transpose(0, 2, 1)
    )
    X[..., -1] = X[..., 0]
    minors = np.empty_like(X)
    for i, j in product(range(n), repeat=2):
        rest = np.delete(np.delete(X, i, 1), j, 2)
        minors[:, i, j] = (-1) ** (i + j) * np.linalg.det(rest)
    np.testing.assert_allclose(cofactor(X), minors, atol=1e-14)


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def random_cells(rng, n, geometry, num=20):
    """Cells around the reference simplex, with one vertex or more on each side, and inner ones."""
    x = geometry.points + 0.1 * rng.normal(size=(num, len(geometry.points), n))
    alpha = rng.uniform(size=(num, n + 1))
    alpha[:, 0], alpha[:, n] = 0, 1
    alpha[: num // 2] = np.rint(alpha[: num // 2])
    return x, alpha


@pytest.mark.parametrize("n", (2, 3))
@pytest.mark.parametrize("g", (1, 2))
@pytest.mark.parametrize("degree", (1, 2, 3))
def test_eq_21(n, g, degree, rng):
    """Σ_a α_a ∂φ_a/∂α = 1 and Σ_a ∂φ_a/∂α = 0, also on curved cells."""
    cell = TRIANGLE if n == 2 else TETRAHEDRON
    geometry, element = lagrange(cell, g), lagrange(cell, degree)
    x, alpha = random_cells(rng, n, geometry)
    tables = GapElement.with_quadrature(geometry, element, 4)
    dphi = alpha_derivatives(tables, geometry_at_points(tables, x, alpha)[1])
    linear = lagrange(cell, 1).tabulate(0, element.points)[0, :, :, 0]
    np.testing.assert_allclose(np.einsum("cpa,ca->cp", dphi, alpha @ linear.T), 1, atol=1e-11)
    np.testing.assert_allclose(dphi.sum(axis=2), 0, atol=1e-11)


@pytest.mark.parametrize("n", (2, 3))
@pytest.mark.parametrize("g", (1, 2))
def test_position_along_alpha(n, g, rng):
    """∂x/∂α (eq. 17) is normal to Γ_α: its tangential part vanishes."""
    geometry = lagrange(TRIANGLE if n == 2 else TETRAHEDRON, g)
    x, alpha = random_cells(rng, n, geometry)
    tables = GapElement.with_quadrature(geometry, geometry, 3)
    N, v = geometry_at_points(tables, x, alpha)
    dx = alpha_derivatives(tables, v) @ x
    normal = N / np.linalg.norm(N, axis=2, keepdims=True)
    tangential = dx - np.einsum("cpi,cpi->cp", dx, normal)[..., None] * normal
    np.testing.assert_allclose(tangential, 0, atol=1e-11)


@pytest.mark.parametrize("n", (2, 3))
def test_normal_points_from_side_0_to_side_1(n, rng):
    """Where the surfaces are apart, n is ∇α / |∇α|; and it stays when the gap closes."""
    geometry = lagrange(TRIANGLE if n == 2 else TETRAHEDRON, 1)
    x, alpha = random_cells(rng, n, geometry)
    tables = GapElement.with_quadrature(geometry, geometry, 0)
    N = geometry_at_points(tables, x, alpha)[0][:, 0]
    X = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
    gradient = np.linalg.solve(X.transpose(0, 2, 1), (alpha[:, 1:] - alpha[:, :1])[..., None])
    gradient = gradient[..., 0] / np.linalg.norm(gradient, axis=1)
    normal = N / np.linalg.norm(N, axis=1, keepdims=True)
    np.testing.assert_allclose(normal, gradient, atol=1e-12)
    # Onto the plane of the nodes with α = 0 and 1 alone: move along n until the gap is nil
    for shift in (1e-3, 0):
        flat = geometry.points * np.append(np.ones(n - 1), shift)
        N = geometry_at_points(tables, flat[None], np.eye(n + 1)[-1:])[0][0, 0]
        close(N, np.eye(n)[-1])


@pytest.mark.parametrize("unit", 10.0 ** np.array((-9, -5, -1, 3, 9)))
@pytest.mark.parametrize("g", (1, 2))
@pytest.mark.parametrize("n", (2, 3))
def test_unit_of_length(n, g, unit):
    """∂φ/∂α has no unit of length, so G scales as dΓ does."""
    cell, x, alpha = curved_cell(n)
    x, alpha = x.astype(float)[None, : None if g == 2 else n + 1], alpha.astype(float)[None]
    tables = GapElement.with_quadrature(lagrange(cell, g), lagrange(cell, 2), 8)
    matrices = affine_gap_matrices if g == 1 else curved_gap_matrices
    up = np.eye(n)[-1:]
    G = matrices(tables, x, alpha, up)
    scaled = matrices(tables, x * unit, alpha, up) / unit ** (n - 1)
    close(scaled, G, 1e-13)


def test_chunks(rng):
    """Many cells, more than a chunk, one by one."""
    geometry = lagrange(TRIANGLE, 1)
    x = geometry.points + 0.1 * rng.normal(size=(9000, 3, 2))
    alpha, up = np.tile((0, 0, 1.0), (len(x), 1)), np.tile((0, 1.0), (len(x), 1))
    tables = GapElement.with_quadrature(geometry, lagrange(TRIANGLE, 2), 2)
    for matrices in (affine_gap_matrices, curved_gap_matrices):
        G = matrices(tables, x, alpha, up)
        for c in (0, 8191, 8192, 8999):
            part = slice(c, c + 1)
            close(G[part], matrices(tables, x[part], alpha[part], up[part]))


# Cells that eq. (12) would accept: the root hides the sign.


@pytest.mark.parametrize("matrices", (affine_gap_matrices, curved_gap_matrices))
@pytest.mark.parametrize("apex", ((0.5, 0.0), (0.5, 0.1)))
def test_inverted_cell(matrices, apex):
    tables = GapElement.with_quadrature(lagrange(TRIANGLE, 1), lagrange(TRIANGLE, 1), 1)
    good, bad = [(0, 0), (1, 0), apex], [(1, 0), (0, 0), apex]
    alpha, up = np.tile((0, 0, 1.0), (2, 1)), np.tile((0, 1.0), (2, 1))
    matrices(tables, np.array([good, good], dtype=float), alpha, up)
    with pytest.raises(InvertedCellError, match=r"^1 gap elements are inverted .* at \(0\.5"):
        matrices(tables, np.array([good, bad], dtype=float), alpha, up)


@pytest.mark.parametrize("matrices", (affine_gap_matrices, curved_gap_matrices))
def test_empty_cell(matrices):
    """A base without length, and NaN."""
    tables = GapElement.with_quadrature(lagrange(TRIANGLE, 1), lagrange(TRIANGLE, 1), 1)
    for x in ([(0, 0), (0, 0), (0.5, 0)], [(0, 0), (1, 0), (np.nan, 0)]):
        with pytest.raises(InvertedCellError):
            matrices(tables, np.array([x], dtype=float), np.eye(3)[-1:], np.array([(0, 1.0)]))


def test_cell_inverted_at_one_end():
    """A curved base that turns back near its end, with upright vertices."""
    quadratic = lagrange(TRIANGLE, 2)
    tables = GapElement.with_quadrature(quadratic, quadratic, 8)
    x = quadratic.points * (1, 0.1)
    up, alpha = np.array([(0, 1.0)]), np.eye(3)[-1:]
    curved_gap_matrices(tables, x[None], alpha, up)
    x[5, 0] = 0.9  # the base's middle: past 3/4 the map is not one to one
    with pytest.raises(InvertedCellError, match="1 gap elements"):
        curved_gap_matrices(tables, x[None], alpha, up)
