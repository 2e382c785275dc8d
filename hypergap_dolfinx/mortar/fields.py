# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Fields on Σ: the traction λ, the gap and the slip, and integrals over Σ."""

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix
from dolfinx import fem
from dolfinx.mesh import Mesh
from hypergap_dolfinx.core.sparse import of_columns, product
from hypergap_dolfinx.mortar import kernel
from hypergap_dolfinx.mortar.constraint import Constraint
from hypergap_dolfinx.mortar.domain import GapDomain
from hypergap_dolfinx.surface.trace import tabulate


@dataclass(frozen=True)
class GapQuadrature:
    """Gauss points on this rank's cells of Σ, from :meth:`Tie.quadrature`."""

    mesh: Mesh
    """Mesh of Σ, ``tie.sigma``."""
    X: npt.NDArray[np.float64]
    """Reference points, ``(num_points, n)``."""
    x: npt.NDArray[np.float64]
    """Positions, ``(num_cells, num_points, n)``."""
    normal: npt.NDArray[np.float64]
    """Unit normals of Γ_α, from Γ0 to Γ1, ``(num_cells, num_points, n)``."""
    weights: npt.NDArray[np.float64]
    """Weights of the rule times dΓ_α dα, ``(num_cells, num_points)``; times 2πr or r for
    axisymmetric ties, as in the forms."""

    def evaluate(self, f: fem.Function) -> npt.NDArray:
        """Values of a function on Σ at the points.

        Args:
            f: Function on :attr:`mesh`, as ``tie.traction`` and ``tie.gap`` return them.

        Returns:
            Values, ``(num_cells, num_points, block_size)``.

        Raises:
            ValueError: A function on another mesh.
        """
        V = f.function_space
        if V.mesh is not self.mesh:
            raise ValueError("evaluate takes functions on tie.sigma, as tie.traction gives them.")
        nodal = f.x.array.reshape(-1, V.dofmap.index_map_bs)[V.dofmap.list]
        return np.einsum("pa,cai->cpi", tabulate(V.ufl_element().basix_element, self.X), nodal)

    def integrate(self, values: npt.NDArray) -> npt.NDArray:
        """Integral ∫∫ f dΓ_α dα. Collective.

        Args:
            values: Values of f at the points, ``(num_cells, num_points, ...)``.

        Returns:
            The integral, ``(...)``, the same on every rank.
        """
        local = np.einsum("cp,cp...->...", self.weights, values)
        return self.mesh.comm.allreduce(local)


def create_quadrature(domain: GapDomain, degree: int) -> GapQuadrature:
    """Gauss points on Σ (eqs. 10–13). Collective."""
    points, _ = basix.make_quadrature(domain.element.cell_type, degree)
    element = domain.quadrature(degree)
    N, _ = kernel.geometry_at_points(element, domain.x, domain.alpha_vertices)
    length = np.linalg.norm(N, axis=2)
    x = np.einsum("pm,cmi->cpi", element.psi, domain.x)
    weights = element.weights * domain.areas(element, N) - _beyond(domain, points, degree)
    arrays = (array[domain.order] for array in (x, N / length[..., None], weights))
    return GapQuadrature(domain.mesh, points, *arrays)


def _beyond(domain: GapDomain, points: npt.NDArray, degree: int) -> npt.NDArray[np.float64]:
    """Parts of the weights that belong to the overhang, which the constraint doesn't integrate.

    Returns:
        Weights of least norm at the points of the Gauss rule, ``(num_cells, num_points)``, that
        give the integrals of polynomials of half the degree over the overhang.
    """
    beyond = domain.overhang
    if beyond is None:
        return np.zeros((len(domain.x), len(points)))
    basis = basix.create_element(
        basix.ElementFamily.P,
        domain.element.cell_type,
        degree // 2,
        basix.LagrangeVariant.legendre,
        discontinuous=True,
    )
    moments = np.zeros((len(domain.x), basis.dim))
    np.add.at(moments, beyond.cells, beyond.weights[:, None] * tabulate(basis, beyond.X))
    return moments @ np.linalg.pinv(tabulate(basis, points))


def nodal_forces(constraint: Constraint, side: int, multipliers: npt.NDArray) -> npt.NDArray:
    """Forces −B_iᵀ λ on a body at its nodes. Collective.

    Args:
        constraint: The constraint.
        side: 0 or 1.
        multipliers: This rank's multipliers, ``(num_multipliers, block_size)``.

    Returns:
        Forces at this rank's owned dofs of V_i, ``(num_dofs, block_size)``.
    """
    B = constraint.B[side]
    dofs, rows = B.createVecs()
    return -of_columns(B.multTranspose, (rows, dofs), multipliers)


def nodal_values(domain: GapDomain, R: PETSc.Mat, values: npt.NDArray) -> npt.NDArray:
    """R applied to each component, at the nodes of this rank's cells. Collective.

    Args:
        domain: Σ.
        R: Pull-back with a row for each node.
        values: This rank's owned values, ``(num_columns, block_size)``.

    Returns:
        ``(num_cells, num_nodes, block_size)``.
    """
    return np.concatenate(domain.comm.allgather(product(R, values)))[domain.nodes]


def _create(
    domain: GapDomain, nodal: npt.NDArray, shapes: dict[str, tuple[int, ...]], parts
) -> list[fem.Function]:
    """Discontinuous functions on Σ, of the degree of the φ_a, made from ∂u/∂α of eq. (19).

    On straight cells ∂u/∂α is a polynomial, which is interpolated. On curved ones it is a rational
    function with |N| in its denominator, and N may vanish at a node: where edges of Γ0 and Γ1 are
    parallel, or a quadrilateral has a corner of 180°. There it is the polynomial f of the least
    ∫∫ |f − ∂u/∂α|² dΓ_α dα, which has the integral of ∂u/∂α.

    Args:
        domain: Σ.
        nodal: u at the nodes, ``(num_cells, num_nodes, block_size)``.
        shapes: Shape of each function's values, by its name.
        parts: The functions' values, ``(num, num_points, size)`` each, of ∂u/∂α,
            ``(num, num_points, block_size)``, and unit normals, ``(num, num_points, n)``.
    """
    element = "Discontinuous Lagrange", domain.element.degree
    found = [
        fem.Function(fem.functionspace(domain.mesh, (*element, shape)), name=name)
        for name, shape in shapes.items()
    ]
    basis = found[0].function_space.ufl_element().basix_element
    positive = basix.QuadratureType.gauss_jacobi  # weights
    gauss, weights = basix.make_quadrature(basis.cell_type, domain.curved_rule, positive)
    at_nodes, at_gauss = (
        kernel.GapElement.at(domain.geometry, domain.element, X, np.ones(len(X)))
        for X in (basis.points, gauss)
    )
    table = tabulate(basis, gauss)
    squares = (weights[:, None, None] * table[:, :, None] * table[:, None]).reshape(len(gauss), -1)
    straight, curved = np.flatnonzero(~domain.curved), np.flatnonzero(domain.curved)
    chunks = [(straight, at_nodes)]
    chunks += [(c, at_gauss) for c in np.array_split(curved, 1 + len(curved) // 1000)]
    for cells, tables in chunks:
        N, v = kernel.geometry_at_points(tables, domain.x[cells], domain.alpha_vertices[cells])
        length = np.linalg.norm(N, axis=2)
        dx = kernel.alpha_derivatives(tables, v) @ nodal[cells]
        for f, values in zip(found, parts(dx, N / length[..., None]), strict=True):
            if tables is at_gauss:
                areas = domain.areas(tables, N, cells)
                mass = (areas @ squares).reshape(-1, basis.dim, basis.dim)
                load = table.T @ ((weights * areas)[..., None] * values)
                values = np.linalg.solve(mass, load)
            V = f.function_space
            f.x.array.reshape(-1, V.dofmap.index_map_bs)[V.dofmap.list[domain.in_mesh[cells]]] = (
                values
            )
    return found


def traction(
    domain: GapDomain, constraint: Constraint, shape: tuple[int, ...], multipliers: npt.NDArray
) -> fem.Function:
    """λ = Σ_a λ_a ∂φ_a/∂α (eq. 20) on Σ; see :func:`_create` for curved cells. Collective.

    Args:
        domain: Σ.
        constraint: The constraint on it.
        shape: Shape of a value.
        multipliers: This rank's multipliers, ``(num_multipliers, block_size)``.
    """
    nodal = nodal_values(domain, constraint.R_A, multipliers)
    # Less a mean, the derivative of α times itself: else narrow cells lose its digits
    alpha = domain.hosts.alpha[..., None]
    mean = (alpha * nodal).sum(axis=1, keepdims=True) / (alpha**2).sum(axis=1, keepdims=True)
    (f,) = _create(domain, nodal - alpha * mean, {"traction": shape}, lambda dx, n: (dx,))
    V = f.function_space
    f.x.array.reshape(-1, V.dofmap.index_map_bs)[V.dofmap.list[domain.in_mesh]] += mean
    return f


def gap(
    domain: GapDomain,
    constraint: Constraint,
    u0: fem.Function,
    u1: fem.Function,
    turn: npt.NDArray | None = None,
) -> tuple[fem.Function, fem.Function | None]:
    """Normal gap and tangential slip (eq. 17) on Σ. Collective.

    Args:
        domain: Σ.
        constraint: The constraint on it.
        u0: Displacement of Γ0's body.
        u1: Displacement of Γ1's body.
        turn: Rotation R if u₁ is compared with R u₀.
    """
    shape = u0.function_space.value_shape
    nodal, other = (
        nodal_values(domain, R, owned_values(u)) for R, u in zip(constraint.R, (u0, u1))
    )
    nodal = other + (nodal if turn is None else nodal @ turn.T)
    if shape == ():
        return _create(domain, nodal, {"gap": ()}, lambda dx, n: (dx,))[0], None

    def parts(dx, n):
        opening = np.einsum("cpi,cpi->cp", dx, n)[..., None]
        return opening, dx - opening * n

    normal_gap, slip = _create(domain, nodal, {"gap": (), "slip": shape}, parts)
    return normal_gap, slip


def owned_values(u: fem.Function) -> npt.NDArray:
    """This rank's owned values, ``(num_dofs, block_size)``."""
    dofmap = u.function_space.dofmap
    return u.x.array.reshape(-1, dofmap.index_map_bs)[: dofmap.index_map.size_local]
