# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""Tractions on both bodies' surfaces, recovered from the forces that λ makes at their nodes.

λ is spanned by ∂φ_a/∂α (eq. 20): on a straight linear cell it is a constant, its error of order
h^k. The forces Bᵀλ know more: tractions t₀ and t₁ in the traces of V₀ and V₁, of degree k, have

.. math:: \int_{\Gamma_i} t_i \cdot v = \pm (B_i^T \lambda)(v) \quad \text{for all } v

up to what scatters from node to node: of unstructured meshes that is as large as λ's error, and
where one side is far finer than the other it has steps as long as the coarse side's facets. So t₀
and t₁ are asked for together, as those that make

.. math:: \sum_i \|t_i\|^2_{\Gamma_i} / 2 \mp (B_i^T \lambda)(t_i)
   + \tfrac\kappa 2 \Bigl( \iint |\partial t/\partial\alpha|^2 d\Gamma_\alpha d\alpha
   + \gamma \sum_{pairs} \|t_i - \Pi_k t_i\|^2 \Bigr)

smallest. t is t₀ on Γ0, t₁ on Γ1 and linear in α between them: the second term wants the two sides
to be one traction, as the tie wants of displacements, and what both traces have in common is
smooth. In the last one Π_k t_i is the nearest polynomial of degree k over two facets that are
neighbours: it also says what t_i is where a facet is covered by a sliver. Both terms vanish for
polynomials of degree k (of planes), so t keeps the order k + 1, and the sum of its forces.

Of fields that change within a few facets they take something away. With the system A t = f and the
mass matrix M of both sides, passes t + A⁻¹(f − M t) give it back, first what is smooth, then what
scatters too; Nesterov's extrapolation makes do with few. How many are best is told by t itself:
from many to fewer and fewer it changes by what scatters, less each time, until the change grows,
which is then of the field. So t is not linear in λ, but for what lies within its own error.
"""

from collections.abc import Callable, Iterator

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix
from dolfinx import fem
from hypergap_dolfinx.core import collective
from hypergap_dolfinx.core.sparse import coo_matrix, triplets
from hypergap_dolfinx.mortar.constraint import Constraint
from hypergap_dolfinx.mortar.domain import GapDomain
from hypergap_dolfinx.mortar.faces import Faces
from hypergap_dolfinx.mortar.fields import nodal_values
from hypergap_dolfinx.mortar.tolerances import FEWER, PASSES, SMOOTH, WEIGHT
from hypergap_dolfinx.surface.trace import Surface, facet_pairs, tabulate


class Recovery(collective.Owner):
    """The system for the tractions on Γ0 and Γ1 of one tie."""

    def __init__(self, domain: GapDomain, constraint: Constraint):
        """Assemble and factorise it. Collective.

        Args:
            domain: Σ.
            constraint: The constraint on it.
        """
        self._ticket = collective.enter(domain.mesh.comm)
        self._domain, self._constraint = domain, constraint
        self._faces = Faces.of(domain, 0), Faces.of(domain, 1)
        self._unknowns = Unknowns(domain, constraint)
        comm, unknowns = domain.mesh.comm, self._unknowns
        owned, num = domain.space.dofmap.index_map.size_local, unknowns.num_local
        self._R = coo_matrix(comm, (owned, num), *unknowns.pulled_back(constraint.R))
        rows = constraint.R_A.getLocalSize()[1]
        self._forces = coo_matrix(comm, (rows, num), *unknowns.forces(constraint))
        self._mass, A = self._matrices()
        self._solver = PETSc.KSP().create(comm)
        self._solver.setOperators(A)
        A.destroy()  # the solver keeps it
        self._solver.setType("preonly")
        self._solver.getPC().setType("lu")
        self._solver.getPC().setFactorSolverType("mumps")
        self._last = np.empty(0), np.empty(0)  # forces and their tractions

    def _release(self) -> list:
        names = ("_R", "_forces", "_mass", "_solver")
        return [self.__dict__.pop(name, None) for name in names]

    def _matrices(self) -> tuple[PETSc.Mat, PETSc.Mat]:
        """M of Σ_i ∫ t_i · v_i, and A. Collective."""
        domain = self._domain
        difference = domain.gap_matrices()
        difference[domain.narrow_cells()] = 0  # cancelling entries: round-off, and no area
        mass = np.zeros_like(difference)
        for faces in self._faces:
            np.add.at(mass, faces.cells, faces.mass_matrices())
        if (beyond := domain.overhang) is not None:  # λ's forces have none of it
            dphi, _ = domain.overhang_derivatives()
            parts = [(difference, beyond, dphi)]
            if (rims := beyond.rims) is not None:
                parts.append((mass, rims, tabulate(domain.element, rims.X)))
            for W, points, f in parts:
                outer = points.weights[:, None, None] * f[:, :, None] * f[:, None]
                np.subtract.at(W, points.cells, outer)
        M, A = self._pulled_back(mass), self._pulled_back(difference)
        num = self._unknowns.num_local
        S = coo_matrix(domain.mesh.comm, (num, num), *self._unknowns.smoothing())
        A.axpy(SMOOTH, S)
        S.destroy()
        A.scale(WEIGHT)
        A.axpy(1.0, M)
        return M, A

    def _pulled_back(self, W: npt.NDArray) -> PETSc.Mat:
        """RᵀWR of element matrices of Σ's nodes, a new matrix. Collective."""
        dofmap = self._domain.space.dofmap
        dofs = dofmap.index_map.local_to_global(dofmap.list.ravel()).reshape(dofmap.list.shape)
        sizes = (dofmap.index_map.size_local,) * 2
        i, j = (np.broadcast_to(d, W.shape) for d in (dofs[:, :, None], dofs[:, None, :]))
        matrix = coo_matrix(self._domain.mesh.comm, sizes, i, j, W)
        product = matrix.matMult(self._R)
        found = self._R.transposeMatMult(product)
        for obj in (matrix, product):
            obj.destroy()
        return found

    def _after_passes(self, forces: npt.NDArray) -> list[npt.NDArray]:
        """Tractions after 1, 3, 9 … passes, shaped as the forces. Collective."""
        t = before = np.zeros_like(forces)
        found: list[npt.NDArray] = []
        for n in range(1, PASSES + 1):
            y = t + (n - 2) / (n + 1) * (t - before)
            missing = forces - of_columns(self._mass.mult, self._mass.createVecs(), y)
            given = of_columns(self._solver.solve, self._mass.createVecs(), missing)
            before, t = t, y + given
            if n == FEWER ** len(found):
                found.append(t)
        return found

    def _size(self, t: npt.NDArray) -> float:
        """‖t‖ on both sides. Collective."""
        product = of_columns(self._mass.mult, self._mass.createVecs(), t)
        squares = self._domain.mesh.comm.allreduce(np.vdot(t, product))
        return float(np.sqrt(abs(squares)))

    def _recovered(self, forces: npt.NDArray) -> npt.NDArray:
        """Tractions after as many passes as fit; found once for both sides. Collective."""
        comm = self._domain.mesh.comm
        if comm.allreduce(np.array_equal(forces, self._last[0])) == comm.size:
            return self._last[1]
        *fewer, t = self._after_passes(forces)
        last = np.inf
        for smoother in reversed(fewer):
            change = self._size(smoother - t)
            if change >= last:
                break
            t, last = smoother, change
        self._last = forces, t
        return t

    def traction(self, side: int, shape: tuple[int, ...], multipliers: npt.NDArray) -> fem.Function:
        """The traction on a body's surface. Collective.

        Args:
            side: 0 or 1.
            shape: Of the values.
            multipliers: This rank's multipliers, ``(num_multipliers, block_size)``.

        Returns:
            σ_i n_i with the outward normal n_i, on a mesh of the part of Γ_i that is tied.
        """
        t, force = self._forces.createVecs()
        forces = of_columns(self._forces.multTranspose, (force, t), multipliers)
        values = self._recovered(forces)
        nodal = nodal_values(self._domain, self._R, values)
        return self._faces[side].function((1 - 2 * side) * nodal, shape, "traction")


def of_columns(
    act: Callable[[PETSc.Vec, PETSc.Vec], None],
    vectors: tuple[PETSc.Vec, PETSc.Vec],
    columns: npt.NDArray,
) -> npt.NDArray:
    """What something of PETSc makes of each column of an array. Collective.

    Args:
        act: Takes a vector, and puts what it makes of it into another.
        vectors: For both; they are destroyed.
        columns: This rank's rows.

    Returns:
        The same columns, with the rows of the second vector.
    """
    x, y = vectors
    found = np.empty((y.getLocalSize(), columns.shape[1]), dtype=PETSc.ScalarType)
    for k, column in enumerate(columns.T):
        x.array[:] = column
        act(x, y)
        found[:, k] = y.array_r
    for vector in vectors:
        vector.destroy()
    return found


class Unknowns:
    """Values of t₀ and t₁: a dof of the trace has one in each patch that has it.

    Each rank has those of Γ0's dofs, then of Γ1's, that it owns.
    """

    def __init__(self, domain: GapDomain, constraint: Constraint):
        """Number them. Collective."""
        self._domain = domain
        self._num_patches = int(domain.patch.max()) + 1
        comm, dofmap = domain.mesh.comm, domain.space.dofmap
        owned = dofmap.index_map.size_local
        node, first = np.unique(dofmap.list.ravel(), return_index=True)
        self._patch = np.zeros(owned, dtype=np.int64)  # of each owned node of Σ
        facet = domain.hosts.facets[1].ravel()[first]
        self._patch[node[node < owned]] = domain.patch[facet[node < owned]]
        self._keys, ends = [], []
        for R, surface in zip(constraint.R, domain.surfaces, strict=True):
            node, dof, _ = triplets(R)
            mine = np.unique(dof * self._num_patches + self._patch_of(R, node))
            keys = np.unique(np.concatenate(comm.allgather(mine)))
            self._keys.append(keys)
            ends.append(np.searchsorted(keys, surface.dof_range * self._num_patches))
        num = np.diff(ends).T  # (rank, side)
        self.num_local = int(num[comm.rank].sum())
        before = np.cumsum(np.append(0, num.ravel()))[:-1].reshape(num.shape)
        self._ends, self._shift = ends, before - np.array(ends)[:, :-1].T

    def _patch_of(self, matrix: PETSc.Mat, node) -> npt.NDArray[np.int64]:
        """The patch of each node of Σ, of this rank's rows of a matrix."""
        return self._patch[node - matrix.getOwnershipRange()[0]]

    def _number(self, side: int, dof, patch) -> npt.NDArray[np.int64]:
        """The unknown at a dof in a patch that has it."""
        at = np.searchsorted(self._keys[side], dof * self._num_patches + patch)
        rank = np.searchsorted(self._ends[side][1:], at, side="right")
        return at + self._shift[rank, side]

    def pulled_back(self, R):
        """Rows (nodes of Σ), columns and values of the pull-back of t₀ and t₁."""
        parts = []
        for side, R_i in enumerate(R):
            node, dof, value = triplets(R_i)
            parts.append((node, self._number(side, dof, self._patch_of(R_i, node)), value))
        return [np.concatenate(part) for part in zip(*parts, strict=True)]

    def forces(self, constraint: Constraint):
        """Rows (multipliers), columns and values of ∓B_i: the forces λ has at the unknowns.

        What is a patch's comes from its own multipliers. Collective.
        """
        node, row, _ = triplets(constraint.R_A)
        pairs = np.unique(np.column_stack((row, self._patch_of(constraint.R_A, node))), axis=0)
        pairs = np.vstack(self._domain.mesh.comm.allgather(pairs))
        patch = np.zeros(constraint.R_A.getSize()[1], dtype=np.int64)
        patch[pairs[:, 0]] = pairs[:, 1]
        parts = []
        for side, B in enumerate(constraint.B[:2]):
            row, dof, value = triplets(B)
            # Round-off may have made an entry where Σ's nodes have none
            known = np.isin(dof * self._num_patches + patch[row], self._keys[side])
            row, dof, value = row[known], dof[known], value[known]
            parts.append((row, self._number(side, dof, patch[row]), (2 * side - 1) * value))
        return [np.concatenate(part) for part in zip(*parts, strict=True)]

    def smoothing(self):
        """Rows, columns and values of Σ ∫ (t − Πt) · (v − Πv) over pairs of facets; a share."""
        comm = self._domain.mesh.comm
        parts = [(np.empty(0, np.int64),) * 2 + (np.empty(0),)]
        for side, surface in enumerate(self._domain.surfaces):
            pairs = facet_pairs(surface)
            for patch, some in self._in_patches(side, surface, pairs):
                mine = np.array_split(some, comm.size)[comm.rank]
                if not len(mine):  # fewer pairs than ranks
                    continue
                dofs = self._number(side, surface.dofs[mine].reshape(len(mine), -1), patch)
                S = distances_from_polynomials(surface, mine)
                i, j = (np.broadcast_to(d, S.shape) for d in (dofs[:, :, None], dofs[:, None]))
                parts.append((i.ravel(), j.ravel(), S.ravel()))
        return [np.concatenate(part) for part in zip(*parts, strict=True)]

    def _in_patches(self, side, surface, pairs) -> Iterator[tuple[int, npt.NDArray]]:
        """The patches, and pairs of facets whose dofs all have unknowns there."""
        for patch in range(self._num_patches):
            key = surface.dofs * self._num_patches + patch
            has = np.isin(key, self._keys[side]).all(axis=1)
            yield patch, pairs[has[pairs].all(axis=1)]


def distances_from_polynomials(surface: Surface, pairs) -> npt.NDArray[np.float64]:
    """Matrices of ∫ (u − Πu)(v − Πv) over two facets each.

    Πu is the nearest polynomial of the trace's degree, in coordinates of the plane between them.

    Args:
        surface: Γ_i.
        pairs: Facets, ``(num_pairs, 2)``.

    Returns:
        ``(num_pairs, 2 num_dofs, 2 num_dofs)``.
    """
    element, n = surface.element, surface.gdim
    k = element.degree
    X, weights = basix.make_quadrature(element.cell_type, 2 * k + 2)
    phi = tabulate(element, X)
    psi = surface.geometry.tabulate(1, X)[..., 0]  # (1 + j, point, node)
    x, *tangents = (np.einsum("pm,fsmi->fspi", values, surface.nodes[pairs]) for values in psi)
    t = np.stack(tangents, axis=3)  # (pair, facet, point, j, i)
    measure = np.sqrt(np.linalg.det(np.einsum("fspji,fspki->fspjk", t, t)))
    root = np.sqrt(measure * weights).reshape(len(pairs), -1)
    x = x.reshape(len(pairs), -1, n)
    x = x - np.einsum("fp,fpi->fi", root**2, x)[:, None] / (root**2).sum(axis=1)[:, None, None]
    # The plane: across the mean of the normals
    mean = surface.normals[pairs].sum(axis=1)
    plane = np.linalg.svd(mean[:, None])[2][:, 1:]  # (pair, n − 1, n)
    z = np.einsum("fpi,fji->fpj", x, plane)
    z /= np.abs(z).max(axis=(1, 2), initial=1e-300)[:, None, None]
    exponents = np.indices((k + 1,) * (n - 1)).reshape(n - 1, -1)
    exponents = exponents[:, exponents.sum(axis=0) <= k]
    P = np.prod(z[..., None] ** exponents, axis=2)  # (pair, point, monomial)
    Q = np.linalg.qr(root[..., None] * P)[0]
    u = np.zeros((2, *phi.shape[:1], 2, phi.shape[1]))  # (facet, point, facet, dof)
    u[0, :, 0], u[1, :, 1] = phi, phi
    u = root[..., None] * u.reshape(1, root.shape[1], -1)
    u = u - Q @ (Q.swapaxes(1, 2) @ u)
    return u.swapaxes(1, 2) @ u
