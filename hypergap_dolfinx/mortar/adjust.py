# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Moves Γ1 onto X_A = P X₀ of eq. (22), which makes rigid motions exact."""

from dataclasses import replace

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix
import basix.ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from hypergap_dolfinx.core import compat
from hypergap_dolfinx.core.sparse import coo_matrix
from hypergap_dolfinx.errors import InterfaceError, InvertedCellError
from hypergap_dolfinx.mortar.constraint import Constraint, Multipliers, create_constraint
from hypergap_dolfinx.mortar.domain import GapDomain, create_gap_domain
from hypergap_dolfinx.mortar.tolerances import ROUNDS_ADJUST
from hypergap_dolfinx.surface.trace import Surface, create_surface


def adjust_surface(mesh0: Mesh, facets0, mesh1: Mesh, facets1):
    """Solve Σ_i B_i X_i = 0 for the geometry nodes on Γ1. Collective.

    B depends on the nodes' positions, which is why they are moved a few times. The last move is
    left to the caller: the B from before it and the nodes from after it satisfy the equation to
    round-off, however far the move. Nodes where two smooth pieces of Γ1 meet (both surfaces have a
    node there) stay.

    Args:
        mesh0: Mesh of Γ0's body.
        facets0: Its local facets on Γ0.
        mesh1: Mesh of Γ1's body; its nodes are moved.
        facets1: Its local facets on Γ1.

    Returns:
        A function that makes the last move, collective; and Σ with the nodes from before it, of the
        spaces of both meshes' coordinates.

    Raises:
        InterfaceError: The surfaces form no interface, or no longer do once nodes were moved; these
            are put back.
        InvertedCellError: The surfaces differ too much in shape.
    """
    W = [_coordinate_space(mesh) for mesh in (mesh0, mesh1)]
    start = _positions(W[1])
    for k in range(ROUNDS_ADJUST):
        try:
            surfaces = create_surface(W[0], facets0, "Γ0"), create_surface(W[1], facets1, "Γ1")
            domain = create_gap_domain(mesh1.comm, *surfaces)
        except (InterfaceError, InvertedCellError) as error:
            if k == 0:
                raise
            _set_positions(W[1], start)
            raise InterfaceError(
                f"adjust moves the nodes on Γ1 too far for its facets: {error} Refine both sides "
                "there, or tie without adjust; the nodes are where they were."
            ) from error
        constraint = create_constraint(domain, (W[0], W[1]), free_interior=False)
        origin = surfaces[0].x[0]  # far from the origin digits are few
        X = [_positions(V) - origin for V in W]
        moved = _solve(constraint, domain, X) + origin
        constraint.destroy()
        if k < ROUNDS_ADJUST - 1:
            _set_positions(W[1], moved)
    return (lambda: _set_positions(W[1], moved)), domain


def with_surfaces(domain: GapDomain, surfaces: tuple[Surface, Surface]) -> GapDomain | None:
    """Σ of other spaces on the same facets, None if their elements differ.

    Args:
        domain: Σ.
        surfaces: Γ0 and Γ1 of the other spaces.
    """
    pairs = zip(surfaces, domain.surfaces, strict=True)
    same = all(new.element == old.element for new, old in pairs)
    return replace(domain, surfaces=surfaces) if same else None


def _coordinate_space(mesh: Mesh) -> fem.FunctionSpace:
    """The scalar Lagrange space of a mesh's geometry."""
    cmap = compat.coordinate_element(mesh)
    element = basix.ufl.element(
        "Lagrange",
        mesh.topology.cell_name(),
        cmap.degree,
        lagrange_variant=basix.LagrangeVariant(int(cmap.variant)),
    )
    return fem.functionspace(mesh, element)


def _positions(W: fem.FunctionSpace) -> npt.NDArray[np.float64]:
    """Coordinates of the geometry nodes, in the order of the owned dofs, ``(num_owned, n)``."""
    mesh = W.mesh
    x = np.empty((W.dofmap.index_map.size_local + W.dofmap.index_map.num_ghosts, 3))
    x[W.dofmap.list] = mesh.geometry.x[compat.geometry_dofmap(mesh)]
    return x[: W.dofmap.index_map.size_local, : mesh.geometry.dim]


def _set_positions(W: fem.FunctionSpace, x: npt.NDArray[np.float64]):
    """Move the geometry nodes on all ranks that share them. Collective."""
    mesh = W.mesh
    f = fem.Function(W)
    for axis in range(x.shape[1]):
        f.x.array[: len(x)] = x[:, axis]
        f.x.scatter_forward()
        mesh.geometry.x[compat.geometry_dofmap(mesh), axis] = f.x.array[W.dofmap.list].real


def _without(constraint: Constraint, domain, drop: npt.NDArray[np.bool_]) -> PETSc.Mat:
    """Matrix E of λ = E λ': dropped multipliers follow from the others λ'. Collective."""
    multipliers = Multipliers.of(constraint, domain)
    start, end = constraint.R_A.getOwnershipRangeColumn()
    gone = np.sort(constraint.rows[drop])
    here = (start <= constraint.rows) & (constraint.rows < end)
    i, j, value = [], [], []
    for m in np.flatnonzero(here).tolist():
        weights, others = np.ones(1), np.array([m])
        if drop[m]:
            weights, others, _ = multipliers.follow(m, drop)
        i.append(np.full(len(others), constraint.rows[m]))
        j.append(constraint.rows[others])
        value.append(weights)
    entries = [np.concatenate([*parts, np.empty(0)]) for parts in (i, j, value)]
    entries[1] -= np.searchsorted(gone, entries[1])
    num_kept = int((here & ~drop).sum())
    return coo_matrix(domain.comm, (end - start, num_kept), *entries)


def _solve(constraint: Constraint, domain, X) -> npt.NDArray[np.float64]:
    """Positions of Γ1's body with Σ_i B_i X_i = 0; only nodes under multipliers move."""
    _, at, count = np.unique(constraint.dofs, return_inverse=True, return_counts=True)
    drop = count[at] > 1
    E = _without(constraint, domain, drop) if drop.any() else None
    B = [E.transposeMatMult(B_i) if E else B_i.copy() for B_i in constraint.B]
    start, end = B[1].getOwnershipRangeColumn()
    free = np.setdiff1d(constraint.dofs, constraint.dofs[drop])
    free = free[(free >= start) & (free < end)]
    columns = PETSc.IS().createGeneral(free.astype(PETSc.IntType), comm=B[1].comm)
    first, last = B[1].getOwnershipRange()
    rows = PETSc.IS().createStride(last - first, first, 1, comm=B[1].comm)
    B_free = B[1].createSubMatrix(rows, columns)
    moved = X[1].copy()
    if B_free.getSize()[0] > 0:
        solver = PETSc.KSP().create(B[1].comm)
        solver.setOperators(B_free)
        solver.setType("preonly")
        solver.getPC().setType("lu")
        solver.getPC().setFactorSolverType("mumps")
        residual, step = B_free.createVecLeft(), B_free.createVecRight()
        x0, x1 = (B_i.createVecRight() for B_i in B)
        for axis in range(X[1].shape[1]):
            for _ in range(2):  # a step, and one of refinement
                x0.array[:], x1.array[:] = X[0][:, axis], moved[:, axis]
                B[0].mult(x0, residual)
                B[1].multAdd(x1, residual, residual)
                solver.solve(residual, step)
                moved[free - start, axis] -= step.array_r.real
        for obj in (solver, residual, step, x0, x1):
            obj.destroy()
    for obj in (*B, B_free, rows, columns, *([E] if E else [])):
        obj.destroy()
    return moved
