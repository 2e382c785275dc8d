# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""The saddle system without multipliers, for multigrid: :math:`T^T K T \hat u = T^T (f - K u_c)`.

T takes Γ1's own dofs from the tie, :math:`u_{own} = -B_{own}^{-1} (B u)_{rest}`, and leaves the
other dofs alone, so that all ties hold for :math:`u = T \hat u + u_c`. What comes of it is positive
definite if K is, also where bodies are held by ties alone. T is applied with factors of the B_own,
which live on Γ1; multigrid needs a matrix, and gets :math:`\tilde T^T K \tilde T`, made with a
sparse approximation of T.
"""

import weakref
from collections.abc import Sequence
from itertools import pairwise

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.constraint import coo_matrix, triplets
from hypergap_dolfinx.substructures import create_solver, mean_diagonal, square_part

SMALL = 0.2  # entries of T below this part of the largest in their row are left out
SWEEPS = 2  # Jacobi iterations for the approximation of T
DAMPING = 0.7  # of these


class _Projection:
    """T of one tie."""

    def __init__(self, blocks: dict[int, PETSc.Mat], body: int, own, prefix: str):
        """Take the blocks on each body; Γ1's body; its dofs under the rows."""
        self.blocks, self.body = blocks, body
        self.own = own - blocks[body].getOwnershipRangeColumn()[0]
        self.square = square_part(blocks[body], own)
        self.solver = create_solver(f"{prefix}square_", self.square.comm)
        self.solver.setOperators(self.square)
        self.x, self.c = self.square.createVecs()

    def destroy(self):
        for obj in (self.square, self.solver, self.x, self.c):
            obj.destroy()

    def apply(self, u: Sequence[PETSc.Vec], given: npt.NDArray | None = None):
        """Set Γ1's own dofs, such that B u is what is given."""
        u[self.body].array[self.own] = 0
        self.c.set(0.0)
        for i, B in self.blocks.items():
            B.multAdd(u[i], self.c, self.c)
        self.c.scale(-1.0)
        if given is not None:
            self.c.array[:] += given
        self.solver.solve(self.c, self.x)
        u[self.body].array[self.own] = self.x.array_r

    def apply_transpose(self, r: Sequence[PETSc.Vec]) -> npt.NDArray[np.float64]:
        """Pass the loads on Γ1's own dofs to the others; returns the multipliers."""
        self.x.array[:] = r[self.body].array_r[self.own]
        self.solver.solveTranspose(self.x, self.c)
        multipliers = self.c.array_r.copy()
        self.c.scale(-1.0)
        for i, B in self.blocks.items():
            B.multTransposeAdd(self.c, r[i], r[i])
        r[self.body].array[self.own] = 0
        return multipliers

    def approximate(self) -> dict[int, PETSc.Mat]:
        """Sparse blocks of T's rows: a few Jacobi iterations, small entries left out. Collective.

        Each row is scaled such that T moves Γ1 with a Γ0 that is shifted.
        """
        start = self.square.getOwnershipRange()[0]
        diagonal = self.square.getDiagonal()
        inverse = 1.0 / diagonal.array_r
        found = {}
        for body, B in self.blocks.items():
            first = B.getOwnershipRangeColumn()[0]
            held = self.own + first if body == self.body else np.empty(0, dtype=np.int64)
            rows, columns, values = triplets(B)
            keep = (values != 0) & ~self._is_held(held, columns, B)
            sizes = B.getLocalSize()
            load = (rows[keep], columns[keep], -values[keep] * inverse[rows[keep] - start])
            if not self.square.comm.tompi4py().allreduce(len(load[0])):
                continue
            comm = B.comm.tompi4py()
            P = coo_matrix(comm, sizes, *load)
            for _ in range(SWEEPS):
                i, j, value = triplets(P)
                BP = self.square.matMult(P)
                k, m, change = triplets(BP)
                change = -DAMPING * change * inverse[k - start]
                parts = (i, k, load[0]), (j, m, load[1]), (value, change, DAMPING * load[2])
                for obj in (BP, P):
                    obj.destroy()
                P = coo_matrix(comm, sizes, *_without_small(*map(np.concatenate, parts)))
            found[body] = P
        # As many as B says
        exact, rough = (self.c.duplicate() for _ in range(2))
        exact.set(0.0)
        rough.set(0.0)
        for body, P in found.items():
            ones = P.createVecRight()
            ones.set(1.0)
            P.multAdd(ones, rough, rough)
            if body == self.body:
                ones.array[self.own] = 0
            self.blocks[body].multAdd(ones, exact, exact)
            ones.destroy()
        exact.scale(-1.0)
        self.solver.solve(exact, self.x)
        scale = np.ones(len(self.own))
        good = np.abs(rough.array_r) > 0.3
        scale[good] = self.x.array_r[good] / rough.array_r[good]
        rough.array[:] = scale
        for P in found.values():
            P.diagonalScale(L=rough)
        for obj in (exact, rough, diagonal):
            obj.destroy()
        return found

    @staticmethod
    def _is_held(held, columns, B: PETSc.Mat) -> npt.NDArray[np.bool_]:
        """Whether columns are Γ1's own dofs, of any rank."""
        return np.isin(columns, np.concatenate(B.comm.tompi4py().allgather(held)))


def _without_small(i, j, value):
    """Add up triplets, and leave out what is small in its row."""
    order = np.lexsort((j, i))
    i, j, value = i[order], j[order], value[order]
    first = np.flatnonzero(np.append(True, (np.diff(i) != 0) | (np.diff(j) != 0))[: len(i)])
    value = np.add.reduceat(value, first) if len(first) else value
    i, j = i[first], j[first]
    rows, at = np.unique(i, return_inverse=True)
    largest = np.zeros(len(rows))
    np.maximum.at(largest, at, np.abs(value))
    keep = np.abs(value) >= SMALL * largest[at]
    return i[keep], j[keep], value[keep]


class _Operator:
    """TᵀKT as the context of a Python matrix."""

    def __init__(self, system: "ProjectedSystem"):
        self._system = weakref.proxy(system)  # PETSc's references are no garbage that Python finds

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec):
        """Apply it. Collective."""
        self._system.mult(x, y)


class ProjectedSystem:
    """The projected system for a KSP, and the way back to displacements and multipliers."""

    def __init__(
        self,
        K: Sequence[PETSc.Mat],
        B: Sequence[Sequence[PETSc.Mat | None]],
        bodies: Sequence[tuple[int, int]],
        own: Sequence[npt.NDArray],
        order: Sequence[int],
        spaces: Sequence[fem.FunctionSpace],
        prefix: str,
    ):
        """Factorise the ties' square parts. Collective.

        Args:
            K: Stiffness of each body, with its values.
            B: For each tie, its block on each body, or None.
            bodies: Γ0's and Γ1's body of each tie.
            own: Global dofs under this rank's multipliers of each tie, in B₁'s order of rows.
            order: Of the bodies, those with Γ1 of a tie before those with its Γ0.
            spaces: Space of each body.
            prefix: Of the solvers' options.
        """
        self._K = K
        self.iterations = 0
        comm = K[0].comm
        ties = [t for i in order for t, pair in enumerate(bodies) if pair[1] == i]
        self._ties = {
            t: _Projection({i: b for i, b in enumerate(B[t]) if b}, bodies[t][1], own[t], prefix)
            for t in ties
        }
        self._u = [k.createVecRight() for k in K]
        self._r = [k.createVecLeft() for k in K]
        ends = np.cumsum([0, *(k.getLocalSize()[0] for k in K)])
        self._parts = [slice(*pair) for pair in pairwise(ends)]
        size = ((ends[-1], None), (ends[-1], None))
        self.matrix = PETSc.Mat().createPython(size, _Operator(self), comm=comm)
        self.matrix.setUp()
        self.x, self.b = self.matrix.createVecs()
        own = [p.own + self._parts[p.body].start for p in self._ties.values()]
        self._own = np.concatenate([[], *own]).astype(np.intp)
        self._coordinates = self.matrix.createVecRight()
        self._coordinates.setBlockSize(K[0].getBlockSize())
        if K[0].getBlockSize() > 1:
            x = [V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local] for V in spaces]
            self._coordinates.array[:] = np.vstack(x)[:, : K[0].getBlockSize()].ravel()
        self._diagonal = 1.0
        self._T: PETSc.Mat | None = None
        self.preconditioner: PETSc.Mat | None = None

    def destroy(self):
        """Destroy the PETSc objects. Collective."""
        objects = [*self._ties.values(), *self._u, *self._r, self.matrix, self.x, self.b]
        objects += [self._coordinates]
        for obj in (*objects, self._T, self.preconditioner):
            if obj is not None:
                obj.destroy()

    def mult(self, x: PETSc.Vec, y: PETSc.Vec):
        """Apply TᵀKT; own dofs, which it doesn't see, stay. Collective."""
        values = x.array_r
        for u, part in zip(self._u, self._parts, strict=True):
            u.array[:] = values[part]
        for projection in reversed(self._ties.values()):
            projection.apply(self._u)
        for K, u, r in zip(self._K, self._u, self._r, strict=True):
            K.mult(u, r)
        for projection in self._ties.values():
            projection.apply_transpose(self._r)
        result = np.concatenate([r.array_r for r in self._r])
        result[self._own] = self._diagonal * values[self._own]
        y.array[:] = result

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec):
        """Solve for nested vectors of the saddle system. Collective."""
        num, bs, xs = len(self._K), b.getNestSubVecs(), x.getNestSubVecs()
        given = [part.array_r.copy() for part in bs[num:]]
        for u in self._u:
            u.set(0.0)
        self._project(given)
        self._load(bs)
        for projection in self._ties.values():
            projection.apply_transpose(self._r)
        self.b.array[:] = np.concatenate([r.array_r for r in self._r])
        ksp.solve(self.b, self.x)
        self.iterations = ksp.getIterationNumber()
        for u, part in zip(self._u, self._parts, strict=True):
            u.array[:] = self.x.array_r[part]
        self._project(given)
        self._load(bs)
        for t, projection in self._ties.items():
            xs[num + t].array[:] = projection.apply_transpose(self._r)
        for part, u in zip(xs, self._u):
            part.array[:] = u.array_r

    def _project(self, given):
        for t in reversed(self._ties):
            self._ties[t].apply(self._u, given[t])

    def _load(self, bs):
        """Set r = f − K u."""
        for K, u, r, b in zip(self._K, self._u, self._r, bs):
            K.mult(u, r)
            r.aypx(-1.0, b)

    def attach(self, ksp: PETSc.KSP):
        """Give a KSP what it is to solve. Collective."""
        self.update(ksp)

    def update(self, ksp: PETSc.KSP) -> bool:
        """Take the stiffness as it is now, for the preconditioner. Collective."""
        num = len(self._K)
        nest = PETSc.Mat().createNest(
            [[k if i == j else None for j in range(num)] for i, k in enumerate(self._K)],
            comm=self._K[0].comm,
        )
        nest.assemble()
        K = nest.convert("aij", PETSc.Mat())
        nest.destroy()
        self._diagonal = mean_diagonal(K)
        if self.preconditioner is not None:
            self.preconditioner.destroy()
        if self._ties:
            if self._T is None:
                self._T = self._approximate()
            self.preconditioner = K.PtAP(self._T)
            diagonal = self.preconditioner.getDiagonal()
            diagonal.array[self._own] = self._diagonal
            self.preconditioner.setDiagonal(diagonal)
            diagonal.destroy()
        else:
            self.preconditioner = K.copy()
        dim = self._K[0].getBlockSize()
        self.preconditioner.setBlockSize(dim)
        if dim > 1:
            rigid = PETSc.NullSpace().createRigidBody(self._coordinates)
            self.preconditioner.setNearNullSpace(rigid)
            rigid.destroy()
        K.destroy()
        ksp.setOperators(self.matrix, self.preconditioner)
        return True

    def _approximate(self) -> PETSc.Mat:
        """A sparse approximation of T, if there are ties. Collective."""
        comm = self._K[0].comm.tompi4py()
        ranges = np.array([k.getOwnershipRanges() for k in self._K])  # (body, rank)
        sizes = np.diff(ranges, axis=1)
        starts = np.cumsum(np.append(0, sizes.sum(axis=0)[:-1]))  # of each rank
        before = np.cumsum(np.vstack((np.zeros_like(sizes[:1]), sizes[:-1])), axis=0)
        T = None
        size = int(sizes[:, comm.rank].sum())

        def everywhere(body, dofs):
            """Numbers among all bodies' dofs."""
            rank = np.searchsorted(ranges[body], dofs, side="right") - 1
            return starts[rank] + before[body, rank] + dofs - ranges[body, rank]

        for projection in self._ties.values():
            own = everywhere(projection.body, projection.own + ranges[projection.body, comm.rank])
            kept = np.setdiff1d(np.arange(size) + starts[comm.rank], own)
            # Zeros where own dofs are: so that there is a place for their diagonal
            i, j = [kept, own], [kept, own]
            value = [np.ones(len(kept)), np.zeros(len(own))]
            for body, P in projection.approximate().items():
                rows, columns, values = triplets(P)
                i.append(own[rows - P.getOwnershipRange()[0]])
                j.append(everywhere(body, columns))
                value.append(values)
                P.destroy()
            one = coo_matrix(comm, (size, size), *(np.concatenate(v) for v in (i, j, value)))
            if T is None:
                T = one
            else:
                product = T.matMult(one)
                for obj in (T, one):
                    obj.destroy()
                T = product
        return T
