# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Elastic bodies, tied and loaded such that a given displacement is exact."""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx
import meshes
import ufl
from dolfinx import default_scalar_type, fem
from hypergap_dolfinx import NonlinearTiedProblem, Tie, TiedProblem

comm = MPI.COMM_WORLD
E, NU = 1.0, 0.3
SOLVED = 1e-11
"""Relative error of a solution that is exact but for round-off: ε times the condition, which is up
to 8e4 for the scaled saddle matrices of these meshes, is 2e-11; what is seen is 4e-13 at most."""


def linear(x):
    """A displacement whose gradient has every component; of UFL coordinates or an array."""
    return 0.3 * x[0] - 0.2 * x[1], 0.5 * x[0] + 0.4 * x[1]


def bending(x):
    """The displacement of pure bending in plane strain."""
    return x[0] * x[1], -(x[0] ** 2 + NU / (1 - NU) * x[1] ** 2) / 2


def quadratic(x):
    """Both of these: exact if and only if each of them is."""
    return tuple(sum(parts) for parts in zip(linear(x), bending(x), strict=True))


def stretching(x):
    """A displacement that vanishes at x = 0."""
    return 0.3 * x[0], 0.5 * x[0]


@dataclass
class Body:
    """A mesh with a space and the forms of plane strain on it."""

    mesh: dolfinx.mesh.Mesh
    ft: dolfinx.mesh.MeshTags
    V: fem.FunctionSpace
    E: float = E
    nu: float = NU

    def stress(self, u):
        eps = ufl.sym(ufl.grad(u))
        lame = self.nu / (1 - 2 * self.nu)
        E = fem.Constant(self.mesh, default_scalar_type(self.E))  # one kernel for all values
        return E / (1 + self.nu) * (eps + lame * ufl.tr(eps) * ufl.Identity(2))

    @property
    def a(self):
        u, v = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        return ufl.inner(self.stress(u), ufl.sym(ufl.grad(v))) * ufl.dx

    @property
    def boundary(self) -> npt.NDArray[np.int32]:
        self.mesh.topology.create_connectivity(1, 2)
        return dolfinx.mesh.exterior_facet_indices(self.mesh.topology)

    def facets(self, tag=None) -> npt.NDArray[np.int32]:
        """Of one tag or several; of an interface on all sides if none is given."""
        tags = [tag] if np.isscalar(tag) else tag
        return self.ft.indices[np.isin(self.ft.values, tags)]


def lame_constants(E: float = E, nu: float = NU) -> tuple[float, float]:
    """Of Young's modulus and Poisson's ratio."""
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


@dataclass
class Elastic:
    """An elastic body's displacement and virtual work.

    Whatever varies is a constant of the form, so that all scenes with one element share kernels.
    """

    u: fem.Function
    F: ufl.Form
    load: fem.Constant
    """Traction downwards where the body is loaded."""
    weight: fem.Constant
    """The same in all of it."""

    @classmethod
    def on(cls, V, constants=None, *, large=False, loaded=()) -> "Elastic":
        """A body.

        Args:
            V: Its space.
            constants: Lamé's, μ and λ.
            large: Whether it is neo-Hookean; else strain is small.
            loaded: Facets with the traction.
        """
        mesh, degree = V.mesh, V.ufl_element().degree
        u, v = fem.Function(V), ufl.TestFunction(V)
        mu, lame, neo, load, weight = (
            fem.Constant(mesh, default_scalar_type(value))
            for value in (*(constants or lame_constants()), float(large), 0, 0)
        )
        G, eps = ufl.Identity(len(u)) + ufl.grad(u), ufl.sym(ufl.grad(u))
        log = ufl.ln(ufl.det(G))
        W = ufl.conditional(
            ufl.gt(neo, 0.5),
            mu / 2 * (ufl.inner(G, G) - len(u) - 2 * log) + lame / 2 * log**2,
            mu * ufl.inner(eps, eps) + lame / 2 * ufl.tr(eps) ** 2,
        )
        facets = np.sort(np.asarray(loaded, dtype=np.int32))
        tags = dolfinx.mesh.meshtags(mesh, len(u) - 1, facets, np.ones_like(facets))
        ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree})
        F = ufl.derivative(W * dx, u) + weight * v[len(u) - 1] * dx + load * v[len(u) - 1] * ds
        return cls(u, F, load, weight)


def rectangle(n, low, high, *, cell="quadrilateral", degree=1, E=E, nu=NU, mapping=None, **options):
    """A block from one corner to the other."""
    low, high = np.asarray(low), np.asarray(high)

    def placed(x):
        return low + x * (high - low)

    mesh, ft = meshes.block(comm, n, mapping or placed, cell=cell, **options)
    return Body(mesh, ft, fem.functionspace(mesh, ("Lagrange", degree, (2,))), E, nu)


def tie(bodies: Sequence[Body], side0, side1, **options) -> Tie:
    """Ties (body, tag) to (body, tag)."""
    return Tie(*((bodies[i].V, bodies[i].facets(tag)) for i, tag in (side0, side1)), **options)


def in_halves(bodies: Sequence[Body], sides: Sequence[tuple[int, object]], x: float) -> list:
    """An interface's sides (body, tag) as those of two ties, with what is left and right of x."""
    pieces: list[list] = [[], []]
    for i, tag in sides:
        facets = bodies[i].facets(tag)
        right = dolfinx.mesh.compute_midpoints(bodies[i].mesh, 1, facets)[:, 0] > x
        for piece, chosen in zip(pieces, (~right, right), strict=True):
            piece.append((bodies[i].V, facets[chosen]))
    return pieces


def problem(
    bodies: Sequence[Body],
    ties: Sequence[Tie],
    tied: Sequence[tuple[int, object]],
    fixed: Sequence[tuple[int, int, tuple[int, ...]]],
    exact=linear,
    **options,
) -> TiedProblem:
    """The tied problem with a given solution.

    Args:
        bodies: The bodies.
        ties: The ties.
        tied: Body and tags of the interfaces: no load there.
        fixed: Body, tag and components of what is prescribed; loads act on all other edges.
        exact: The solution, of UFL coordinates or an array; linear or pure bending.
        options: Of the problem.
    """
    a, L, bcs = [], [], []
    for i, body in enumerate(bodies):
        x, v = ufl.SpatialCoordinate(body.mesh), ufl.TestFunction(body.V)
        inner = [body.facets(tag) for b, tag in tied if b == i]
        loaded = np.setdiff1d(body.boundary, np.concatenate([*inner, np.empty(0, dtype=np.int32)]))
        loaded = np.setdiff1d(loaded, body.mesh.topology.interprocess_facets())
        tags = dolfinx.mesh.meshtags(body.mesh, 1, loaded, np.full(len(loaded), 1, dtype=np.int32))
        ds = ufl.Measure("ds", body.mesh, subdomain_data=tags)(1)
        normal = ufl.FacetNormal(body.mesh)
        load = ufl.inner(ufl.dot(body.stress(ufl.as_vector(exact(x))), normal), v) * ds
        zero = fem.Constant(body.mesh, default_scalar_type((0, 0)))
        a.append(body.a)
        L.append(load + ufl.inner(zero, v) * ufl.dx)
        for tag, components in ((tag, c) for b, tag, c in fixed if b == i):
            for c in components:
                W, _ = body.V.sub(c).collapse()
                value = fem.Function(W)
                value.interpolate(lambda x, c=c: exact(x)[c])
                dofs = fem.locate_dofs_topological((body.V.sub(c), W), 1, body.facets(tag))
                bcs.append(fem.dirichletbc(value, dofs, body.V.sub(c)))
    return TiedProblem(a, L, bcs=bcs, ties=ties, **options)


def held_outside(
    bodies: Sequence[Body],
    ties: Sequence[Tie],
    tied: Sequence[tuple[int, object]],
    exact,
    **options,
) -> NonlinearTiedProblem:
    """Bodies whose displacements are prescribed wherever they aren't tied.

    Args:
        bodies: The bodies.
        ties: The ties.
        tied: Body and tags of the interfaces.
        exact: The displacement of a body by its number, of an array of points.
        options: Of the problem.
    """
    us, F, bcs = [fem.Function(body.V) for body in bodies], [], []
    for i, (body, u) in enumerate(zip(bodies, us, strict=True)):
        F.append(ufl.inner(body.stress(u), ufl.sym(ufl.grad(ufl.TestFunction(body.V)))) * ufl.dx)
        value = fem.Function(body.V)
        value.interpolate(lambda x, i=i: np.array(exact(i, x)))
        inner = [body.facets(tag) for b, tag in tied if b == i]
        outer = np.setdiff1d(body.boundary, np.concatenate([*inner, np.empty(0, dtype=np.int32)]))
        bcs.append(fem.dirichletbc(value, fem.locate_dofs_topological(body.V, 1, outer)))
    return NonlinearTiedProblem(F, us, bcs=bcs, ties=ties, **options)


def displacement_error(problem: TiedProblem, exact=linear) -> float:
    """Largest deviation from the exact displacement, relative to the largest displacement."""
    error = size = 0.0
    for u in problem.u:
        reference = fem.Function(u.function_space)
        reference.interpolate(lambda x: np.array(exact(x)))
        error = max(error, np.abs(u.x.array - reference.x.array).max(initial=0))
        size = max(size, np.abs(reference.x.array).max(initial=0))
    return comm.allreduce(error, MPI.MAX) / comm.allreduce(size, MPI.MAX)


def exact_stress(body: Body, x, exact=linear) -> npt.NDArray[np.float64]:
    """σ at points ``(..., 2)``; central differences are exact for a displacement of degree 2."""
    x = np.moveaxis(x, -1, 0)
    steps = np.eye(2).reshape(2, 2, *[1] * (x.ndim - 1))
    gradient = [np.subtract(exact(x + step), exact(x - step)) / 2 for step in steps]
    gradient = np.moveaxis(np.array(gradient), (0, 1), (-1, -2))  # (..., component, axis)
    eps = (gradient + np.swapaxes(gradient, -1, -2)) / 2
    trace = np.trace(eps, axis1=-2, axis2=-1)[..., None, None]
    return body.E / (1 + body.nu) * (eps + body.nu / (1 - 2 * body.nu) * trace * np.eye(2))


def traction_error(problem: TiedProblem, tie: Tie, bodies: Sequence[Body], exact=linear) -> float:
    """Largest deviation of λ from σn on Σ, relative to the largest stress there."""
    q = tie.quadrature(4)
    body = next(b for b in bodies if b.V == tie.spaces[0])
    sigma = exact_stress(body, q.x, exact)
    traction = np.einsum("cpij,cpj->cpi", sigma, q.normal)
    error = np.abs(q.evaluate(tie.traction(problem)) - traction).max(initial=0)
    size = comm.allreduce(np.abs(sigma).max(initial=0), MPI.MAX)
    return comm.allreduce(error, MPI.MAX) / size


def dense(A: PETSc.Mat) -> npt.NDArray[np.float64]:
    """All of a matrix, on every rank."""
    A = A.convert("aij", PETSc.Mat())  # not in place
    (start, end), (_, columns) = A.getOwnershipRange(), A.getSize()
    rows = np.zeros((end - start, columns), dtype=PETSc.ScalarType)
    indptr, j, values = A.getValuesCSR()
    rows[np.repeat(np.arange(end - start), np.diff(indptr)), j] = values
    A.destroy()
    return np.concatenate(comm.allgather(rows))


def scaled(problem: TiedProblem) -> tuple[npt.NDArray[np.float64], int]:
    """All of the saddle matrix, bodies first, then multipliers, and the size of K.

    It has a unit diagonal of K and unit rows of B, so that zero means zero.
    """
    rows = [part.getIndices() for part in problem.A.getNestISs()[0]]  # of this rank
    num_fields = len(rows) - len(problem._constraints.bodies)
    ties = np.concatenate([np.empty(0, int), *rows[num_fields:]])
    ties = np.concatenate(comm.allgather(ties)).astype(int)
    A = dense(problem.A)
    bodies = np.setdiff1d(np.arange(len(A)), ties)
    order = np.concatenate((bodies, ties))
    A = A[np.ix_(order, order)]
    n = len(bodies)
    diagonal = np.sqrt(np.abs(A.diagonal()))
    diagonal[n:] = 1
    A /= diagonal[:, None] * diagonal
    size = np.linalg.norm(A[n:, :n], axis=1)
    size[size == 0] = 1
    A[n:] /= size[:, None]
    A[:, n:] /= size
    return A, n


def inertia(problem: TiedProblem) -> tuple[int, int, int]:
    """Numbers of negative and zero eigenvalues of the saddle matrix, and of multipliers."""
    A, n = scaled(problem)
    values = np.linalg.eigvalsh(A)
    return int((values < -1e-9).sum()), int((np.abs(values) <= 1e-9).sum()), len(A) - n


def is_regular(problem: TiedProblem) -> bool:
    """Whether B has full rank and K is definite where Bu = 0.

    This is what :func:`inertia` says with as many negative eigenvalues as multipliers and none that
    is zero, in a tenth of the time. A solution alone may hide it.
    """
    A, n = scaled(problem)
    K, B = A[:n, :n], A[n:, :n]
    if np.linalg.svd(B, compute_uv=False).min(initial=1) <= 1e-9:
        return False
    try:
        return np.linalg.cholesky(K + B.T @ B).diagonal().real.min() ** 2 > 1e-9
    except np.linalg.LinAlgError:
        return False


def check(bodies, ties, tied, fixed, exact=linear, *, rank=True, traction=True) -> TiedProblem:
    """Solve; full rank, and exact displacements and tractions."""
    p = problem(bodies, ties, tied, fixed, exact)
    p.solve()
    error = displacement_error(p, exact)
    errors = [traction_error(p, t, bodies, exact) for t in ties] if traction else []
    print(error, errors)
    if rank:
        assert is_regular(p)
    assert error <= SOLVED
    assert max(errors, default=0) <= 10 * SOLVED  # derivatives of the displacements
    return p


# A smooth field that is in no finite element space. An over-constraint costs it accuracy, which
# linear fields don't notice.


def smooth(x, m=np):
    """A displacement; of coordinates (arrays, or with ``m=ufl`` UFL's)."""
    return (
        m.sin(1.3 * x[0] + 0.4) * m.cos(0.9 * x[1]),
        0.7 * m.cos(1.1 * x[0]) * m.exp(0.5 * x[1]),
    )


def smooth_stress(body: Body, x) -> npt.NDArray[np.float64]:
    """σ of the smooth field at points ``(..., 2)``."""
    a, b = 1.3 * x[..., 0] + 0.4, 0.9 * x[..., 1]
    c, e = 1.1 * x[..., 0], np.exp(0.5 * x[..., 1])
    gradient = np.array(
        [
            [1.3 * np.cos(a) * np.cos(b), -0.9 * np.sin(a) * np.sin(b)],
            [-0.77 * np.sin(c) * e, 0.35 * np.cos(c) * e],
        ]
    )
    gradient = np.moveaxis(gradient, (0, 1), (-2, -1))
    eps = (gradient + np.swapaxes(gradient, -1, -2)) / 2
    trace = np.trace(eps, axis1=-2, axis2=-1)[..., None, None]
    return body.E / (1 + body.nu) * (eps + body.nu / (1 - 2 * body.nu) * trace * np.eye(2))


def smooth_problem(
    bodies: Sequence[Body], ties: Sequence[Tie], tied: Sequence[tuple[int, object]], alone=None
) -> TiedProblem:
    """The smooth field's loads, and its values on all that is not tied; solved.

    Args:
        bodies: The bodies.
        ties: The ties.
        tied: Body and tags of the interfaces.
        alone: Instead of the ties, exact displacements (``"held"``) or tractions (``"loaded"``).
    """
    a, L, bcs = [], [], []
    for i, body in enumerate(bodies):
        x, v = ufl.SpatialCoordinate(body.mesh), ufl.TestFunction(body.V)
        sigma = body.stress(ufl.as_vector(smooth(x, ufl)))
        rule = {"quadrature_degree": 2 * body.V.ufl_element().degree + 2}
        load = -ufl.inner(ufl.div(sigma), v) * ufl.dx(metadata=rule)
        facets = [body.facets(tag) for b, tag in tied if b == i]
        inner = np.unique(np.concatenate([*facets, np.empty(0, dtype=np.int32)])).astype(np.int32)
        if alone == "loaded":
            ones = np.full(len(inner), 1, dtype=np.int32)
            tags = dolfinx.mesh.meshtags(body.mesh, 1, inner, ones)
            ds = ufl.Measure("ds", body.mesh, subdomain_data=tags, metadata=rule)(1)
            load += ufl.inner(ufl.dot(sigma, ufl.FacetNormal(body.mesh)), v) * ds
        rest = body.boundary if alone == "held" else np.setdiff1d(body.boundary, inner)
        value = fem.Function(body.V)
        value.interpolate(lambda x: np.array(smooth(x)))
        bcs.append(fem.dirichletbc(value, fem.locate_dofs_topological(body.V, 1, rest)))
        a.append(body.a)
        L.append(load)
    p = TiedProblem(a, L, bcs=bcs, ties=() if alone else ties)
    p.solve()
    return p


def smooth_errors(problem: TiedProblem) -> npt.NDArray[np.float64]:
    """L² and H¹ errors over all bodies."""
    squares = np.zeros(2)
    for u in problem.u:
        mesh, V = u.function_space.mesh, u.function_space
        e = u - ufl.as_vector(smooth(ufl.SpatialCoordinate(mesh), ufl))
        dx = ufl.dx(metadata={"quadrature_degree": 2 * V.ufl_element().degree + 4})
        forms = (ufl.inner(e, e) * dx, ufl.inner(ufl.grad(e), ufl.grad(e)) * dx)
        squares += [fem.assemble_scalar(fem.form(form)) for form in forms]
    return np.sqrt(comm.allreduce(squares))


def smooth_traction_error(problem: TiedProblem, ties: Sequence[Tie], bodies) -> float:
    """L² error of λ on all of some ties, relative to the traction."""
    error = size = 0.0
    for tie in ties:
        q = tie.quadrature(2 * tie.domain.element.degree + 2)
        body = next(b for b in bodies if b.V == tie.spaces[0])
        exact = np.einsum("cpij,cpj->cpi", smooth_stress(body, q.x), q.normal)
        deviation = q.evaluate(tie.traction(problem)) - exact
        error += float(q.integrate((deviation**2).sum(axis=-1)))
        size += float(q.integrate((exact**2).sum(axis=-1)))
    return (error / size) ** 0.5
