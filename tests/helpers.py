# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the unit tests share: comparisons, surfaces by hand, two bodies and how they meet."""

from contextlib import contextmanager

from mpi4py import MPI

import numpy as np
import pytest

import basix
import meshes
import ufl
from dolfinx import default_scalar_type, fem, la
from hypergap_dolfinx import Tie
from hypergap_dolfinx.mortar.kernel import alpha_derivatives, geometry_at_points
from hypergap_dolfinx.surface.trace import Surface

comm = MPI.COMM_WORLD
thorough = False  # whether slow tests run too, set in conftest


def sweep(cases, step):
    """All cases of a sweep with ``make test-all``, each step-th with ``make test``."""
    return list(cases)[:: 1 if thorough else step]


def two_ranks(**parameters):
    """Marks what two ranks show as well as three; with ``make test-all`` it runs on three too."""
    return pytest.mark.ranks(*() if thorough else (2,), **parameters)


def ranks_at_last(**parameters):
    """Marks what others show on ranks, too: with ``make test-all`` it runs there itself."""
    return pytest.mark.ranks(3 if thorough else 1, **parameters)


def close(actual, desired, tolerance=2e-13):
    """Assert that arrays agree, relative to the largest of what is desired.

    The tolerance is for sums of some hundred terms, in any order.
    """
    desired = 1.0 * np.asarray(desired)
    scale = np.abs(desired).max(initial=0)
    np.testing.assert_allclose(actual, desired, rtol=0, atol=tolerance * scale)


@contextmanager
def raises(error: type[Exception], match: str):
    """An error with one and the same line on every rank. Collective."""
    caught = None
    try:
        yield
    except Exception as e:
        caught = e
    said = comm.allgather(caught and f"{type(caught).__name__}: {caught}")
    assert all(message == said[0] for message in said), said
    with pytest.raises(error, match=match):
        if caught is not None:
            raise caught
    assert "\n" not in said[0]


def dense(A):
    """All of a PETSc matrix on every rank. Collective."""
    start, end = A.getOwnershipRange()
    rows = np.zeros((end - start, A.getSize()[1]), dtype=default_scalar_type)
    indptr, j, values = A.getValuesCSR()
    rows[np.repeat(np.arange(end - start), np.diff(indptr)), j] = values
    return np.concatenate(comm.allgather(rows))


def polyline(x, name="Γ0", *, closed=False, seed=0) -> Surface:
    """A surface of straight edges along points, its body on the left; facets are shuffled."""
    x = np.asarray(x, dtype=float)
    order = np.lexsort(x.T[::-1])
    number = np.argsort(order)
    facets = np.column_stack((number, np.roll(number, -1)))[: None if closed else -1]
    facets = np.random.default_rng(seed).permutation(facets)
    element = basix.create_element(basix.ElementFamily.P, basix.CellType.interval, 1)
    return Surface(
        name=name,
        x=x[order],
        facets=facets.astype(np.int32),
        own_nodes=x[order][facets],
        dofs=facets.astype(np.int64),
        owner=np.zeros(len(facets), dtype=np.int32),
        geometry=element,
        element=element,
        dof_range=np.array((0, len(x))),
    )


# Two bodies each: a space and the facets of the interface.


def two_blocks(
    n=(3, 5),
    k=(1, 1),
    cells=("triangle", "quadrilateral"),
    shape=(2,),
    *,
    mapping=lambda x: x,
    spans=((0, 2), (0, 2)),
    g=1,
    c=comm,
):
    """A block below and one above of y = 0, mapped together."""
    sides = []
    for i, tag in enumerate((meshes.TOP, meshes.BOTTOM)):
        a, b = spans[i]

        def place(x, a=a, b=b, below=1 - i):
            return mapping(np.column_stack((a + (b - a) * x[:, 0], x[:, 1] - below)))

        mesh, ft = meshes.block(c, (n[i], 2), place, cell=cells[i], degree=g)
        sides.append((fem.functionspace(mesh, ("Lagrange", k[i], shape)), ft.find(tag)))
    return sides


def two_rings(n=(8, 12), k=(1, 1), shape=(2,), *, g=1, angle=np.pi / 2, cell="quadrilateral"):
    """Sectors of rings with radii 2 : 2.5 : 3."""
    sides = []
    for i, tag in enumerate((meshes.OUTER, meshes.INNER)):
        r = 2 + i / 2, 2.5 + i / 2
        mesh, ft = meshes.ring_sector(comm, n[i], 1, *r, angle=angle, cell=cell, degree=g)
        sides.append((fem.functionspace(mesh, ("Lagrange", k[i], shape)), ft.find(tag)))
    return sides


def skew(x):
    """Turn by 25° and move off the origin."""
    c, s = np.cos(np.radians(25)), np.sin(np.radians(25))
    return x @ np.array([[c, s], [-s, c]]) + (0.3, -0.7)


def interpolated(V, f) -> fem.Function:
    """A function with the values of ``f(x)``."""
    u = fem.Function(V)
    u.interpolate(f)
    return u


def residual(tie: Tie, *fields):
    """Largest entry of Σ_i B_i u_i, relative to that of the terms. Collective."""
    c = tie.blocks()[0].createVecLeft()
    term, scale = c.duplicate(), 0.0
    c.set(0.0)
    for B, u in zip(tie.blocks(), fields, strict=True):
        x = B.createVecRight()  # u.x.petsc_vec would go when Python collects u: not collectively
        x.array[:] = u.x.array[: x.getLocalSize()] if isinstance(u, fem.Function) else u.array_r
        B.mult(x, term)
        x.destroy()
        scale = max(scale, term.norm(3))
        c.axpy(1.0, term)
    return c.norm(3) / scale


def elasticity(V):
    """Forms of plane elasticity (λ = μ = 1) without loads."""
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    zero = fem.Constant(V.mesh, default_scalar_type((0, 0)))
    return ufl.inner(stress(u), ufl.sym(ufl.grad(v))) * ufl.dx, ufl.inner(zero, v) * ufl.dx


def stress(u):
    """σ with λ = μ = 1."""
    return 2 * ufl.sym(ufl.grad(u)) + ufl.div(u) * ufl.Identity(2)


def nodal_space(domain):
    """The space of the φ_a on Σ's mesh, and its dofs of the domain's cells."""
    V = fem.functionspace(domain.mesh, ("Lagrange", domain.element.degree))
    return V, V.dofmap.list[domain.in_mesh]


def parts(domain, degree=8):
    """∂φ_a/∂α at Gauss points ``(cell, point, node)``, and their weights ``(cell, point)``."""
    tables = domain.quadrature(degree)
    N, v = geometry_at_points(tables, domain.x, domain.alpha_vertices)
    return alpha_derivatives(tables, v), tables.weights * np.linalg.norm(N, axis=2)


def assembled(domain, values):
    """Sums of ``(cell, node)`` at the nodes of this rank's cells."""
    V, dofs = nodal_space(domain)
    f = fem.Function(V)
    np.add.at(f.x.array, dofs, values)
    f.x.scatter_reverse(la.InsertMode.add)
    f.x.scatter_forward()
    return f.x.array


def at_own_nodes(domain, values):
    """Values at the nodes of this rank's cells, ``(num_cells, num_nodes, …)``, at its own ones."""
    return values.reshape(-1, *values.shape[2:])[domain.first_of_nodes()[1]]
