# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Tractions on both bodies' surfaces, recovered from the forces that λ makes at their nodes.

λ is spanned by ∂φ_a/∂α (eq. 20): on a straight linear cell it is a constant, its error of order
h^k. The forces Bᵀλ know more: tractions t₀ and t₁ in the traces of V₀ and V₁, of degree k, have

.. math:: \int_{\Gamma_i} t_i \cdot v = \pm (B_i^T \lambda)(v) \quad \text{for all } v

up to node-to-node scatter: on unstructured meshes that is as large as λ's error, and where one side
is far finer than the other it has steps as long as the coarse side's facets. So t₀ and t₁ together
minimise

.. math:: \sum_i \|t_i\|^2_{\Gamma_i} / 2 \mp (B_i^T \lambda)(t_i)
   + \tfrac\kappa 2 \Bigl( \iint |\partial t/\partial\alpha|^2 d\Gamma_\alpha d\alpha
   + \gamma \sum_{pairs} \|t_i - \Pi_k t_i\|^2 \Bigr)

t is t₀ on Γ0, t₁ on Γ1 and linear in α between them: the second term makes the two sides one
traction, as the tie does with displacements; only smooth fields are in both traces. In the last
term Π_k t_i is the nearest polynomial of degree k over two neighbouring facets: it also determines
t_i where a facet is covered by a sliver. Both terms vanish for polynomials of degree k (of planes),
so t keeps the order k + 1, and the sum of its forces.

Fields that change within a few facets are damped. With the system A t = f and the mass matrix M of
both sides, passes t + A⁻¹(f − M t) restore them, first what is smooth, then scatter too; Nesterov's
extrapolation accelerates the passes. t itself tells the best number: from many passes to fewer and
fewer it changes by its scatter, less each time, until the change grows, which is then that of the
field. So t is not linear in λ, but within its own error.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import basix
import basix.ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from hypergap_dolfinx.core import collective, compat
from hypergap_dolfinx.core.sparse import coo_matrix, of_columns, product, triplets
from hypergap_dolfinx.mortar.constraint import Constraint
from hypergap_dolfinx.mortar.domain import GapDomain, distributed, share, subtract_squares
from hypergap_dolfinx.mortar.fields import nodal_values
from hypergap_dolfinx.mortar.tolerances import ON_SURFACE, PASSES, SMOOTH, WEIGHT
from hypergap_dolfinx.surface.tolerances import SAME_NODE
from hypergap_dolfinx.surface.trace import Surface, facet_pairs, tabulate


@dataclass(frozen=True)
class Faces:
    """Faces of this rank's cells of Σ on one side, oriented out of the body.

    Pieces of Σ that meet at a kink share no vertex, so their faces don't either.
    """

    domain: GapDomain
    """Σ."""
    side: int
    """0 on Γ0, 1 on Γ1."""
    cells: npt.NDArray[np.intp]
    """Cell of each face, ``(num_faces,)``."""
    vertices: npt.NDArray[np.intp]
    """Vertices of each face among the cell's, ``(num_faces, n)``."""

    @classmethod
    def of(cls, domain: GapDomain, side: int) -> "Faces":
        """The faces of Σ on a side."""
        n = domain.x.shape[2]
        on = np.abs(domain.alpha_vertices - side) < ON_SURFACE
        cells = np.flatnonzero(on.sum(axis=1) == n)
        vertices = np.argsort(~on[cells], axis=1, kind="stable")[:, :n]
        x = np.take_along_axis(domain.x[cells], vertices[:, :, None], axis=1)
        # UFL's CellNormal makes a right-handed frame with a face's edges
        frame = np.concatenate((x[:, 1:] - x[:, :1], domain.normal[cells, None]), axis=1)
        turned = np.linalg.det(frame) * (1 - 2 * side) < 0
        vertices[turned, :2] = vertices[turned, 1::-1]
        return cls(domain, side, cells, vertices)

    @property
    def cell_type(self) -> basix.CellType:
        """Interval or triangle."""
        return {2: basix.CellType.interval, 3: basix.CellType.triangle}[self.vertices.shape[1]]

    def _alike(self, X) -> Iterator[tuple[npt.NDArray, npt.NDArray, npt.NDArray]]:
        """Groups of faces with the same vertices of their cells, and points on them.

        Args:
            X: Reference points of a face, ``(num_points, n - 1)``.

        Yields:
            Faces, points in the reference cell ``(num_points, n)``, edges there ``(n - 1, n)``.
        """
        corners = basix.geometry(self.domain.element.cell_type)
        for vertices in np.unique(self.vertices, axis=0):
            v = corners[vertices]
            edges = v[1:] - v[0]
            yield np.flatnonzero((self.vertices == vertices).all(axis=1)), v[0] + X @ edges, edges

    def mass_matrices(self) -> npt.NDArray[np.float64]:
        """∫ φ_a φ_b over each face, ``(num_faces, num_nodes, num_nodes)``, of the cell's nodes."""
        element, geometry = self.domain.element, self.domain.geometry
        rule = 2 * (element.degree + geometry.degree - 1)
        X, weights = basix.make_quadrature(self.cell_type, rule)
        M = np.empty((len(self.cells), element.dim, element.dim))
        for some, points, edges in self._alike(X):
            phi = element.tabulate(0, points)[0, :, :, 0]
            dpsi = geometry.tabulate(1, points)[1:, :, :, 0]
            x = self.domain.x[self.cells[some]]
            t = np.einsum("jpm,cmi,kj->cpki", dpsi, x - x[:, :1], edges, optimize=True)
            measure = np.sqrt(np.linalg.det(np.einsum("cpki,cpli->cpkl", t, t)))
            psi = geometry.tabulate(0, points)[0, :, :, 0]
            measure *= self.domain.surfaces[1].arc(np.einsum("pm,cmi->cpi", psi, x))
            M[some] = np.einsum("cp,pa,pb->cab", measure * weights, phi, phi, optimize=True)
        return M

    @cached_property
    def _mesh(self) -> tuple[Mesh, npt.NDArray[np.intp]]:
        """Mesh of the faces, and this rank's faces in its order. Collective."""
        mesh, geometry = self.domain.mesh, self.domain.geometry
        comm, variant = mesh.comm, geometry.lagrange_variant
        element = basix.ufl.element(
            "Lagrange",
            self.cell_type.name,
            geometry.degree,
            lagrange_variant=variant,
            shape=(mesh.geometry.dim,),
        )
        local = np.empty((len(self.cells), element.basix_element.dim), dtype=np.intp)
        for some, points, _ in self._alike(element.basix_element.points):
            distance = np.linalg.norm(points[:, None] - geometry.points, axis=2)
            assert (distance.min(axis=1) < SAME_NODE).all()
            local[some] = distance.argmin(axis=1)
        each = self.cells[:, None]
        nodes = compat.geometry_dofmap(mesh)[self.domain.in_mesh[each], local]
        nodes = mesh.geometry.index_map().local_to_global(nodes.ravel()).reshape(nodes.shape)
        gathered = comm.allgather((nodes, self.domain.x[each, local]))
        nodes, x = [np.concatenate(parts) for parts in zip(*gathered, strict=True)]
        _, first, number = np.unique(nodes, return_index=True, return_inverse=True)
        sizes = np.cumsum([0] + [len(part) for part, _ in gathered])
        own = number.reshape(nodes.shape)[slice(*sizes[comm.rank :][:2])]
        return distributed(comm, own, share(comm, x.reshape(-1, x.shape[2])[first]), element)

    def function(self, nodal: npt.NDArray, shape: tuple[int, ...], name: str) -> fem.Function:
        """A function on the mesh of the faces. Collective.

        Args:
            nodal: Values at the nodes of the cells of Σ, ``(num_cells, num_nodes, block_size)``.
            shape: Shape of a value.
            name: Name of the function.

        Returns:
            A Lagrange function of the degree of the φ_a.
        """
        mesh, order = self._mesh
        element = basix.ufl.element(
            "Lagrange", self.cell_type.name, self.domain.element.degree, shape=shape or None
        )
        f = fem.Function(fem.functionspace(mesh, element), name=name)
        V = f.function_space
        points = V.ufl_element().basix_element.points
        values = np.empty((len(self.cells), len(points), nodal.shape[2]), dtype=nodal.dtype)
        for some, at, _ in self._alike(points):
            phi = self.domain.element.tabulate(0, at)[0, :, :, 0]
            values[some] = phi @ nodal[self.cells[some]]
        f.x.array.reshape(-1, nodal.shape[2])[V.dofmap.list] = values[order]
        f.x.scatter_forward()
        return f


class Recovery(collective.Owner):
    """The system for the tractions on Γ0 and Γ1 of one tie."""

    def __init__(self, domain: GapDomain, constraint: Constraint):
        """Assemble and factorise it. Collective.

        Args:
            domain: Σ.
            constraint: The constraint on it.
        """
        self._ticket = collective.enter(domain.comm)
        self._domain, self._constraint = domain, constraint
        self._faces = Faces.of(domain, 0), Faces.of(domain, 1)
        comm, owned = domain.comm, domain.owned[1] - domain.owned[0]
        unknowns = Unknowns(domain, constraint)
        num, rows = unknowns.num_local, constraint.R_A.getLocalSize()[1]
        mass, difference = self._entries()
        parts = [
            ((owned, num), unknowns.pull_back()),
            ((rows, num), unknowns.forces()),
            ((owned, owned), mass),
            ((owned, owned), difference),
            ((num, num), unknowns.smoothing()),
        ]
        self._R, self._forces, M, G, A = [
            coo_matrix(comm, sizes, *entries) for sizes, entries in parts
        ]
        self._mass, jumps = M.ptap(self._R), G.ptap(self._R)
        A.scale(SMOOTH)
        A.axpy(1.0, jumps)
        A.scale(WEIGHT)
        A.axpy(1.0, self._mass)
        for matrix in (M, G, jumps):
            matrix.destroy()
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

    def _entries(self):
        """Entries of Σ_i ∫ t_i · v_i, and of ∫∫ ∂t/∂α · ∂v/∂α dΓ_α dα, of Σ's nodes. Collective."""
        domain = self._domain
        mass = np.zeros((len(domain.x), domain.element.dim, domain.element.dim))
        for faces in self._faces:
            np.add.at(mass, faces.cells, faces.mass_matrices())
        if domain.overhang is not None and (rims := domain.overhang.rims) is not None:
            subtract_squares(mass, rims, tabulate(domain.element, rims.X))
        difference, _ = domain.summable_gap_matrices()  # narrow cells have no area
        return domain.entries(mass), domain.entries(difference)

    def _after_passes(self, forces: npt.NDArray) -> list[npt.NDArray]:
        """Tractions after each of ``PASSES``, shaped as the forces. Collective."""
        t = before = np.zeros_like(forces)
        found: list[npt.NDArray] = []
        for n in range(1, PASSES[-1] + 1):
            y = t + (n - 2) / (n + 1) * (t - before)
            missing = forces - product(self._mass, y)
            given = of_columns(self._solver.solve, self._mass.createVecs(), missing)
            before, t = t, y + given
            if n in PASSES:
                found.append(t)
        return found

    def _size(self, t: npt.NDArray) -> float:
        """‖t‖ on both sides. Collective."""
        weighted = product(self._mass, t)
        squares = self._domain.comm.allreduce(np.vdot(t, weighted))
        return float(np.sqrt(abs(squares)))

    def _recovered(self, forces: npt.NDArray) -> npt.NDArray:
        """Tractions after the best number of passes, computed once for both sides. Collective."""
        comm = self._domain.comm
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
            shape: Shape of a value.
            multipliers: This rank's multipliers, ``(num_multipliers, block_size)``.

        Returns:
            σ_i n_i with the outward normal n_i, on a mesh of the part of Γ_i that is tied.
        """
        t, force = self._forces.createVecs()
        forces = of_columns(self._forces.multTranspose, (force, t), multipliers)
        values = self._recovered(forces)
        nodal = nodal_values(self._domain, self._R, values)
        return self._faces[side].function((1 - 2 * side) * nodal, shape, "traction")


class Unknowns:
    """Values of t₀ and t₁: a dof of the trace has one in each of its patches.

    Each rank has those of Γ0's dofs, then of Γ1's, that it owns.
    """

    def __init__(self, domain: GapDomain, constraint: Constraint):
        """Number them. Collective."""
        self._domain = domain
        self._num_patches = int(domain.patch.max()) + 1
        comm, (_, first) = domain.comm, domain.first_of_nodes()
        patch = domain.patch[domain.hosts.facets[1].ravel()[first]]  # of each owned node of Σ
        self._num_multipliers = constraint.R_A.getSize()[1]
        matrices = (*constraint.R, constraint.R_A, *constraint.B[:2])
        *R, self._R_A, B0, B1 = [triplets(matrix) for matrix in matrices]
        self._pairs = [facet_pairs(surface) for surface in domain.surfaces]
        self._R, self._B = R, (B0, B1)
        self._patch = [patch[nodes - domain.owned[0]] for nodes, _, _ in (*R, self._R_A)]
        self._keys, ends = [], []
        for (_, dof, _), of_dof, surface in zip(R, self._patch[:2], domain.surfaces, strict=True):
            mine = np.unique(dof * self._num_patches + of_dof)
            keys = np.unique(np.concatenate(comm.allgather(mine)))
            self._keys.append(keys)
            ends.append(np.searchsorted(keys, surface.dof_range * self._num_patches))
        num = np.diff(ends).T  # (rank, side)
        self.num_local = int(num[comm.rank].sum())
        before = np.cumsum(np.append(0, num.ravel()))[:-1].reshape(num.shape)
        self._ends, self._shift = ends, before - np.array(ends)[:, :-1].T

    def _number(self, side: int, dof, patch) -> npt.NDArray[np.int64]:
        """The unknown at a dof in a patch that has it."""
        at = np.searchsorted(self._keys[side], dof * self._num_patches + patch)
        rank = np.searchsorted(self._ends[side][1:], at, side="right")
        return at + self._shift[rank, side]

    def pull_back(self):
        """Rows (nodes of Σ), columns and values of the pull-back of t₀ and t₁."""
        parts = []
        for side, (node, dof, value) in enumerate(self._R):
            parts.append((node, self._number(side, dof, self._patch[side]), value))
        return [np.concatenate(part) for part in zip(*parts, strict=True)]

    def forces(self):
        """Rows (multipliers), columns and values of ∓B_i: the forces λ has at the unknowns.

        A patch's unknowns get those of its own multipliers. Collective.
        """
        pairs = np.unique(np.column_stack((self._R_A[1], self._patch[2])), axis=0)
        pairs = np.vstack(self._domain.comm.allgather(pairs))
        patch = np.zeros(self._num_multipliers, dtype=np.int64)
        patch[pairs[:, 0]] = pairs[:, 1]
        parts = []
        for side, (row, dof, value) in enumerate(self._B):
            # Round-off may have made an entry where Σ's nodes have none
            known = np.isin(dof * self._num_patches + patch[row], self._keys[side])
            row, dof, value = row[known], dof[known], value[known]
            parts.append((row, self._number(side, dof, patch[row]), (2 * side - 1) * value))
        return [np.concatenate(part) for part in zip(*parts, strict=True)]

    def smoothing(self):
        """Rows, columns and values of Σ ∫ (t − Πt) · (v − Πv) over this rank's pairs of facets."""
        comm = self._domain.comm
        parts = [(np.empty(0, np.int64),) * 2 + (np.empty(0),)]
        sides = zip(self._domain.surfaces, self._pairs, strict=True)
        for side, (surface, pairs) in enumerate(sides):
            for patch in range(self._num_patches):
                key = surface.dofs * self._num_patches + patch
                has = np.isin(key, self._keys[side]).all(axis=1)
                some = pairs[has[pairs].all(axis=1)]  # all their dofs have unknowns there
                mine = np.array_split(some, comm.size)[comm.rank]
                if not len(mine):  # fewer pairs than ranks
                    continue
                dofs = self._number(side, surface.dofs[mine].reshape(len(mine), -1), patch)
                S = distances_from_polynomials(surface, mine)
                i, j = (np.broadcast_to(d, S.shape) for d in (dofs[:, :, None], dofs[:, None]))
                parts.append((i.ravel(), j.ravel(), S.ravel()))
        return [np.concatenate(part) for part in zip(*parts, strict=True)]


def distances_from_polynomials(surface: Surface, pairs) -> npt.NDArray[np.float64]:
    """Matrices of ∫ (u − Πu)(v − Πv) over pairs of facets, ``(num_pairs, 2)``.

    Πu is the nearest polynomial of the trace's degree, in coordinates of the plane between them.

    Returns:
        ``(num_pairs, 2 num_dofs, 2 num_dofs)``.
    """
    element, n = surface.element, surface.x.shape[1]
    k = element.degree
    X, weights = basix.make_quadrature(element.cell_type, 2 * k + 2)
    phi = element.tabulate(0, X)[0, :, :, 0]
    psi = surface.geometry.tabulate(1, X)[..., 0]  # (1 + j, point, node)
    x, *tangents = (np.einsum("pm,fsmi->fspi", values, surface.nodes_of(pairs)) for values in psi)
    t = np.stack(tangents, axis=3)  # (pair, facet, point, j, i)
    measure = np.sqrt(np.linalg.det(np.einsum("fspji,fspki->fspjk", t, t))) * surface.arc(x)
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
