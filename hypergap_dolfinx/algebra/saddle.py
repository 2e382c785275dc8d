# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The saddle system [K Bᵀ; B −C] as a PETSc MatNest, its solution by a KSP, and its errors.

A compliance enters as the block −C in place of the zero; without one a stored diagonal of zeros
stands there, since factorisations need the entries.
"""

from collections.abc import Iterable, Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.algebra.tolerances import BACKWARD, RESIDUAL_ACCEPTED
from hypergap_dolfinx.core.sparse import row_length


def saddle_matrix(
    K: Sequence[PETSc.Mat],
    B: Sequence[Sequence[PETSc.Mat | None]],
    C: Sequence[Sequence[PETSc.Mat | None]] = (),
) -> tuple[PETSc.Mat, list[PETSc.Mat]]:
    """The nested matrix of several bodies and ties. Collective.

    Args:
        K: Stiffness of each body.
        B: For each tie, its block on each body, or None.
        C: Blocks −C for each pair of ties; None, or nothing given, for zero.

    Returns:
        [K Bᵀ; B −C], and the transposes that it is made of.
    """
    transposes = [[b and b.copy().transpose() for b in row] for row in B]
    blocks: list[list[PETSc.Mat | None]] = [
        [K[i] if i == j else None for j in range(len(K))] + [Bt[i] for Bt in transposes]
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
    pc = ksp.getPC()
    if pc.getType() not in ("lu", "cholesky") or pc.getFactorSolverType() != "mumps":
        return
    database, key = PETSc.Options(), f"{ksp.getOptionsPrefix() or ''}mat_mumps_icntl_14"
    before = database.getAll().get(key)
    for _ in range(4):  # three times the workspace each time: 100 % to 8100 %
        factor = pc.getFactorMatrix()
        if factor.getMumpsInfog(1) not in (-8, -9):
            break
        database[key] = max(100, factor.getMumpsIcntl(14)) * 3
        operators = ksp.getOperators()
        pc.reset()
        ksp.setOperators(*operators)
        ksp.solve(b, x)
    if database.hasName(key):
        del database[key]
    if before is not None:
        database[key] = before


def backward_error(A: PETSc.Mat, x: PETSc.Vec, b: PETSc.Vec) -> float:
    """Largest residual of the rows of blocks, each relative to the size of its terms. Collective.

    Forces that :data:`BACKWARD` times the displacements beside a body make in it are round-off.

    Args:
        A: The nested matrix.
        x: The solution.
        b: The right-hand side.
    """
    worst = 0.0
    num, lengths = len(x.getNestSubVecs()), [part.norm() for part in x.getNestSubVecs()]
    blocks: list[dict[int, PETSc.Mat]] = [
        {j: block for j in range(num) if (block := A.getNestSubMatrix(i, j))} for i in range(num)
    ]
    for i, (row, b_i) in enumerate(zip(blocks, b.getNestSubVecs(), strict=True)):
        r, product = b_i.copy(), b_i.duplicate()
        scale = {j: row_length(block) for j, block in row.items()}
        beside = max(lengths[k] for j in row for k in blocks[j])
        size = b_i.norm() + BACKWARD * scale.get(i, 0.0) * beside
        for j, block in row.items():
            block.mult(x.getNestSubVecs()[j], product)
            r.axpy(-1.0, product)
            size += scale[j] * lengths[j]
        if size:
            worst = max(worst, r.norm() / size)
        for obj in (r, product):
            obj.destroy()
    return worst


def failure(
    ksp: PETSc.KSP,
    advice: str = "",
    units: npt.NDArray | None = None,
    bound: float = RESIDUAL_ACCEPTED,
) -> str | None:
    """Reason why a solve did not converge, or None if it did. Collective.

    A singular matrix makes MUMPS return NaN without an exception; or, if round-off hides a zero
    pivot, a huge multiple of a null vector, far from solving the system.

    Args:
        ksp: The solver.
        advice: End of the message.
        units: Units of this rank's rows, if the matrix isn't nested and they differ.
        bound: Largest residual of a direct solve, relative to the right-hand side.

    Returns:
        A line with the KSP's reason and MUMPS's INFOG.
    """
    reason = ksp.getConvergedReason()
    residual = None
    if reason > 0:
        # Solvers that compute their residual have checked it
        if ksp.getNormType() != PETSc.KSP.NormType.NONE:
            return None
        residual, size = _residual(ksp, units)
        if residual <= bound * size:
            return None
    names = {v: k for k, v in vars(PETSc.KSP.ConvergedReason).items() if isinstance(v, int)}
    message = f"the linear solve failed: KSP reason {reason} ({names.get(reason, 'unknown')})"
    singular = residual is not None
    pc = ksp.getPC()
    if pc.getType() in ("lu", "cholesky") and pc.getFactorSolverType() == "mumps":
        factor = pc.getFactorMatrix()
        infog = factor.getMumpsInfog(1), factor.getMumpsInfog(2)
        message += f", MUMPS INFOG(1) = {infog[0]}, INFOG(2) = {infog[1]}"
        singular |= infog[0] == -10
        if infog[0] in (-8, -9, -11, -13, -14, -19):
            message += "; out of memory: raise mat_mumps_icntl_14 or use more ranks"
    if residual is not None:
        message += f", the residual is {residual:.1e} for a right-hand side of {size:.1e}"
    if singular:
        message += (
            "; the matrix is singular: is every body held, by boundary conditions or by a tie "
            "to one that is, and is each constraint given once?"
        )
    return message + advice + "."


def _residual(ksp: PETSc.KSP, units: npt.NDArray | None) -> tuple[float, float]:
    """|b − Ax| and |b|, with rows of ties in units of K (forces)."""
    A, b = ksp.getOperators()[0], ksp.getRhs()
    r = b.duplicate()
    A.mult(ksp.getSolution(), r)
    r.aypx(-1.0, b)
    if units is not None:
        own = np.array([np.linalg.norm(units * part.array_r) ** 2 for part in (r, b)])
        lengths = tuple(np.sqrt(A.comm.tompi4py().allreduce(own)))
    elif A.getType() != PETSc.Mat.Type.NEST:
        lengths = r.norm(), b.norm()
    else:
        squares = np.zeros(2)
        of_r = r.getNestSubVecs()
        for scale, *parts in zip(scales(A), of_r, b.getNestSubVecs(), strict=True):
            squares += [(scale * part.norm()) ** 2 for part in parts]
        lengths = tuple(np.sqrt(squares))
        destroy_parts(of_r)
    r.destroy()
    return lengths


def scales(A: PETSc.Mat) -> list[float]:
    """Units of the rows of blocks: 1 for bodies, for ties the size of the softest K over B's."""
    num = A.getNestSize()[0]

    def size(i: int, j: int) -> float:
        block = A.getNestSubMatrix(i, j)
        return row_length(block) if block else 0.0

    # The first tie is the first with blocks on the left of its own
    tie = next((i for i in range(num) if any(A.getNestSubMatrix(i, j) for j in range(i))), num)
    stiffness = [size(i, i) if i < tie else 0.0 for i in range(num)]
    scales = []
    for i in range(num):
        ratios = [
            stiffness[j] / size(i, j) for j in range(num) if stiffness[j] and size(i, j) and i != j
        ]
        scales.append(1.0 if stiffness[i] or not ratios else min(ratios))
    return scales
