# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The saddle-point system [K Bᵀ; B −C] as a PETSc MatNest, its solution by a KSP, and its errors.

A compliance enters as the block −C in place of the zero; without one a stored diagonal of zeros
stands there, since factorisations need the entries.
"""

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.tolerances import BACKWARD, RESIDUAL_ACCEPTED
from hypergap_dolfinx.core.sparse import row_length

LOG = logging.getLogger("hypergap_dolfinx")
LOSSES = (
    "as of slender, nearly incompressible or very unequal bodies; cells that are neither long nor "
    "tiny lose fewer digits"
)


def saddle_matrix(
    K: Sequence[PETSc.Mat],
    B: Sequence[Sequence[PETSc.Mat | None]],
    C: Sequence[Sequence[PETSc.Mat | None]] = (),
    mixed: Mapping[tuple[int, int], PETSc.Mat] | None = None,
) -> tuple[PETSc.Mat, list[PETSc.Mat]]:
    """The nested matrix of several bodies and ties. Collective.

    Args:
        K: Stiffness of each body.
        B: For each tie, its block on each body, or None.
        C: Blocks −C for each pair of ties; None, or nothing given, for zero.
        mixed: Blocks of pairs of bodies.

    Returns:
        [K Bᵀ; B −C], and the transposes that it is made of.
    """
    transposes = [[b and b.transpose(PETSc.Mat()) for b in row] for row in B]
    of_bodies = {**(mixed or {}), **{(i, i): block for i, block in enumerate(K)}}
    blocks: list[list[PETSc.Mat | None]] = [
        [of_bodies.get((i, j)) for j in range(len(K))] + [Bt[i] for Bt in transposes]
        for i in range(len(K))
    ]
    for t, row in enumerate(B):
        last = list(C[t]) if C else [None] * len(B)
        last[t] = last[t] or zero_matrix(next(b for b in row if b).getSizes()[0], K[0].comm)
        blocks.append([*row, *last])
    # Not assembled here: that would drop the entries that K has room for but no values yet
    A = PETSc.Mat().createNest(blocks, comm=K[0].comm)
    return A, [b for row in transposes for b in row if b]


def zero_matrix(size: tuple[int, int], comm) -> PETSc.Mat:
    """A square matrix with a stored diagonal of zeros. Collective.

    Args:
        size: Local and global number of rows.
        comm: Communicator.
    """
    return PETSc.Mat().createConstantDiagonal((size, size), 0.0, comm=comm).convert("aij")


def destroy_parts(parts: Iterable[PETSc.Vec]):
    """Destroy a nested vector's parts before it is destroyed itself. Collective.

    On several ranks Python's garbage collection destroys no PETSc object: a part that is only
    referenced here would remain, with its communicator, of which there are 2000.

    Args:
        parts: From ``getNestSubVecs()``.
    """
    for part in parts:
        part.destroy()


def solve(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec):
    """Solve; with more workspace if MUMPS runs out of it, as with many pivots. Collective."""
    ksp.solve(b, x)
    if not _is_short(ksp):
        return
    pc, database = ksp.getPC(), PETSc.Options()
    key = f"{ksp.getOptionsPrefix() or ''}mat_mumps_icntl_14"
    before = database.getAll().get(key)
    for _ in range(4):  # three times the workspace each time: 100 % to 8100 %
        database[key] = max(100, pc.getFactorMatrix().getMumpsIcntl(14)) * 3
        operators = ksp.getOperators()
        pc.reset()
        ksp.setOperators(*operators)
        ksp.solve(b, x)
        if not _is_short(ksp):
            break
    del database[key]
    if before is not None:
        database[key] = before
        database.getString(key)  # so that it counts as used, as it was


def _is_short(ksp: PETSc.KSP) -> bool:
    """True if factors of MUMPS have run out of workspace."""
    pc = ksp.getPC()
    if pc.getType() not in ("lu", "cholesky") or pc.getFactorSolverType() != "mumps":
        return False
    return pc.getFactorMatrix().getMumpsInfog(1) in (-8, -9)


class Errors:
    """Errors of solutions with a nested matrix, whose blocks are measured when it has changed."""

    def __init__(self, A: PETSc.Mat, num_ties: int):
        """Start without measurements.

        Args:
            A: The matrix.
            num_ties: Number of the last rows of blocks, which are ties'.
        """
        self._A, self._num_ties = A, num_ties
        self._state: int | None = None
        self._is_told = False
        self._sizes: npt.NDArray[np.float64] = np.zeros((0, 0))
        self._beside: npt.NDArray[np.bool_] = np.zeros((0, 0), dtype=bool)
        self._units: list[float] = []
        self.norms: tuple[list[float], list[float]] | None = None
        """|b − Ax| and |b| of each row of blocks for the KSP's solution, if they are known."""

    def _measure(self):
        """Sizes of the blocks, fields that share a row with each, and units. Collective."""
        state = self._A.stateGet()
        if state == self._state:
            return
        self._state, sizes = state, block_sizes(self._A)
        self._units = scales(sizes, self._num_ties)
        self._sizes = np.zeros((len(sizes), len(sizes)))
        for i, row in enumerate(sizes):
            self._sizes[i, list(row)] = list(row.values())
        has = np.array([[j in row for j in range(len(sizes))] for row in sizes])
        self._beside = has @ has

    def backward(self, x: PETSc.Vec, b: PETSc.Vec) -> float:
        """Largest residual of the rows of blocks, each relative to the size of its terms.

        Forces that :data:`BACKWARD` times the displacements beside a body make in it are round-off,
        and so are displacements that :data:`BACKWARD` times its forces make. Collective.

        Args:
            x: The solution.
            b: The right-hand side.
        """
        self._measure()
        self.norms = self._residuals(x, b)
        lengths = np.array([part.norm() for part in x.getNestSubVecs()])
        if not np.isfinite(lengths).all():
            return np.inf
        beside = np.where(self._beside, lengths, 0).max(axis=1)
        stiffness, forces = self._sizes.diagonal().copy(), self.norms[1] + self._sizes @ lengths
        stiffness[len(stiffness) - self._num_ties :] = 0
        moved = np.divide(forces, stiffness, out=np.zeros(len(forces)), where=stiffness > 0)
        size = forces + BACKWARD * (stiffness * beside + self._sizes @ moved)
        found = np.divide(self.norms[0], size, out=np.zeros(len(size)), where=size != 0)
        return float(found.max(initial=0.0))

    def residual(self, x: PETSc.Vec, b: PETSc.Vec) -> tuple[float, float]:
        """|b − Ax| and |b|, with rows of ties in units of K (forces). Collective."""
        self._measure()
        norms = self.norms or self._residuals(x, b)
        r, size = (np.linalg.norm(np.multiply(self._units, part)) for part in norms)
        return float(r), float(size)

    def tell(self, error: float):
        """Warn, once, that a solution has lost digits."""
        if not self._is_told and self._A.comm.rank == 0:
            LOG.warning("digits are lost: the error is about %.0e of u, %s.", error, LOSSES)
        self._is_told = True

    def units_of_rows(self, x: PETSc.Vec) -> npt.NDArray:
        """Units of this rank's rows, where :meth:`residual` was asked for."""
        return np.repeat(self._units, local_sizes(x))

    def _residuals(self, x: PETSc.Vec, b: PETSc.Vec) -> tuple[list[float], list[float]]:
        """|b − Ax| and |b| of each row of blocks. Collective."""
        r = b.duplicate()
        self._A.mult(x, r)
        r.aypx(-1.0, b)
        of_r = r.getNestSubVecs()
        norms = [part.norm() for part in of_r], [part.norm() for part in b.getNestSubVecs()]
        destroy_parts(of_r)
        r.destroy()
        return norms


def failure(
    ksp: PETSc.KSP,
    advice: str = "",
    errors: Errors | None = None,
    units: npt.NDArray | None = None,
    bound: float = RESIDUAL_ACCEPTED,
    same_units: bool = False,
) -> str | None:
    """Reason why a solve did not converge, or None if it did. Collective.

    A singular matrix makes MUMPS return NaN without an exception; or, if round-off hides a zero
    pivot, a huge multiple of a null vector, far from solving the system.

    Args:
        ksp: The solver.
        advice: End of the message.
        errors: Errors of solutions, if the matrix is nested.
        units: Units of this rank's rows, if it isn't and they differ.
        bound: Largest residual of a direct solve, relative to the right-hand side.
        same_units: True if all unknowns of bodies have one unit. Then a residual that is round-off
            of A x is accepted, if the solution is found again from its loads but for the bound.

    Returns:
        A line with the KSP's reason, if it failed by itself, and MUMPS's INFOG.
    """
    reason = ksp.getConvergedReason()
    residual, error = None, np.inf
    if reason > 0:
        # Solvers that compute their residual have checked it
        if ksp.getNormType() != PETSc.KSP.NormType.NONE:
            return None
        residual, size = (
            errors.residual(ksp.getSolution(), ksp.getRhs()) if errors else _residual(ksp, units)
        )
        if residual <= bound * size:
            return None
        if errors and same_units:
            error = _error_of_solution(ksp, errors)
        if errors and error <= bound:
            errors.tell(error)
            return None
    names = {v: k for k, v in vars(PETSc.KSP.ConvergedReason).items() if isinstance(v, int)}
    # A reason > 0 says that the solve converged, which the residual contradicts
    parts = [] if reason > 0 else [f"KSP reason {reason} ({names.get(reason, 'unknown')})"]
    singular, why = residual is not None, ""
    pc = ksp.getPC()
    if pc.getType() in ("lu", "cholesky") and pc.getFactorSolverType() == "mumps":
        factor = pc.getFactorMatrix()
        infog = factor.getMumpsInfog(1), factor.getMumpsInfog(2)
        parts.append(f"MUMPS INFOG(1) = {infog[0]}, INFOG(2) = {infog[1]}")
        singular |= infog[0] == -10
        if infog[0] in (-8, -9, -11, -13, -14, -19):
            why += "; out of memory: raise mat_mumps_icntl_14 or use more ranks"
    if residual is not None:
        parts.append(f"the residual is {residual:.1e} for a right-hand side of {size:.1e}")
    if error < 1:
        why += f"; the matrix is nearly singular: the error is about {error:.0e} of u, {LOSSES}"
    elif singular:
        why += (
            "; the matrix is singular: a body isn't held, by boundary conditions or by a tie to "
            "one that is, a constraint is given twice, or a form's quadrature degree is too low "
            "for its element"
        )
        why += "" if errors else f"; or it isn't, and digits are lost, {LOSSES}"
    return f"the linear solve failed: {', '.join(parts)}{why}{advice}."


def _error_of_solution(ksp: PETSc.KSP, errors: Errors) -> float:
    """Error of a solution by factors, found again from its loads; infinite by other solvers."""
    x = ksp.getSolution()
    if ksp.getPC().getType() not in ("lu", "cholesky") or not 0 < x.norm() < np.inf:
        return np.inf
    # The KSP keeps its solution for those who ask later
    units, apply = errors.units_of_rows(x), ksp.getPC().apply
    return error_again(ksp.getOperators()[0], apply, x, len(units), units)


def local_sizes(x: PETSc.Vec) -> list[int]:
    """Numbers of this rank's entries in the parts of a nested vector."""
    parts = x.getNestSubVecs()
    sizes = [part.getLocalSize() for part in parts]
    destroy_parts(parts)
    return sizes


def _residual(ksp: PETSc.KSP, units: npt.NDArray | None) -> tuple[float, float]:
    """|b − Ax| and |b|, in units of this rank's rows."""
    A, b = ksp.getOperators()[0], ksp.getRhs()
    r = b.duplicate()
    A.mult(ksp.getSolution(), r)
    r.aypx(-1.0, b)
    parts = (part.array_r if units is None else units * part.array_r for part in (r, b))
    own = np.array([np.linalg.norm(part) ** 2 for part in parts])
    r.destroy()
    A.comm.tompi4py().Allreduce(MPI.IN_PLACE, own)
    length, size = np.sqrt(own)
    return float(length), float(size)


def error_again(
    A: PETSc.Mat,
    solve: Callable[[PETSc.Vec, PETSc.Vec], None],
    x: PETSc.Vec,
    num: int,
    units: npt.NDArray | float,
) -> float:
    """Error of unknowns solved for again from their loads A x, relative to x. Collective.

    A matrix with a null vector gives any multiple of it besides. If there is no load along it, the
    residual is round-off all the same.

    Args:
        A: The matrix.
        solve: Solves with its factors for a vector, into another one.
        x: The solution, not zero.
        num: Number of this rank's first unknowns whose error counts: its displacements, or all.
        units: Units of this rank's rows, as for :func:`failure`.
    """
    loads, found = x.duplicate(), x.duplicate()
    A.mult(x, loads)
    solve(loads, found)
    found.axpy(-1.0, x)
    error, size = np.abs(_local(found) / units)[:num], np.abs(_local(x) / units)
    for vector in (loads, found):
        vector.destroy()
    most = np.array((error.max(initial=0.0), size.max(initial=0.0)))
    A.comm.tompi4py().Allreduce(MPI.IN_PLACE, most, MPI.MAX)
    return float(most[0] / most[1])


def not_unique(error: float) -> str:
    """Message on a solution that isn't found again, but for this error relative to it."""
    if error < 1:
        return f"the matrix is nearly singular: the error is about {error:.0e} of u, {LOSSES}."
    return (
        "the matrix is singular: the solution isn't found again from its loads; a body isn't held, "
        "or a form's quadrature degree is too low for its element."
    )


def _local(x: PETSc.Vec) -> npt.NDArray:
    """This rank's entries of a vector, which may be nested."""
    if x.getType() != PETSc.Vec.Type.NEST:
        return x.array_r.copy()
    parts = x.getNestSubVecs()
    values = np.concatenate([part.array_r for part in parts])
    destroy_parts(parts)
    return values


def block_sizes(A: PETSc.Mat) -> list[dict[int, float]]:
    """Mean length of a row in each block of a nested matrix, by row and column. Collective."""
    num = A.getNestSize()[0]
    rows = [[A.getNestSubMatrix(i, j) for j in range(num)] for i in range(num)]
    return [{j: row_length(block) for j, block in enumerate(row) if block} for row in rows]


def scales(sizes: Sequence[dict[int, float]], num_ties: int) -> list[float]:
    """Units of the rows of blocks: 1 for bodies, for ties the size of the softest K over B's.

    Args:
        sizes: The :func:`block_sizes`.
        num_ties: Number of the last rows of blocks, which are ties'.
    """
    tie = len(sizes) - num_ties
    stiffness = [row.get(i, 0.0) if i < tie else 0.0 for i, row in enumerate(sizes)]
    scales = []
    for i, row in enumerate(sizes):
        ratios = [stiffness[j] / s for j, s in row.items() if stiffness[j] and s and i != j]
        scales.append(1.0 if stiffness[i] or not ratios else min(ratios))
    return scales
