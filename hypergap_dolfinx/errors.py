# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What is raised, and how all ranks raise it together."""

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

DIGITS = 6  # of coordinates in messages


class InterfaceError(ValueError):
    """The facets or spaces that are given can't form an interface.

    Raised with the same message on every rank.
    """


class NotFacingError(InterfaceError):
    """Nothing of one surface lies opposite the other: there is no gap between them.

    A tie can't do without; bodies in contact can be apart.
    """


class InvertedCellError(RuntimeError):
    """A gap element is turned over: the normal of Γ_α points back to Γ0."""


class SolveError(RuntimeError):
    """A solve failed; the message says how far it came, and nothing beyond that may be used."""


def spot(x: npt.NDArray[np.floating]) -> str:
    """A place for a message, without what is round-off in its coordinates.

    Args:
        x: Its coordinates, or those of points of which it is the middle, ``(…, n)``.
    """
    middle = x.reshape(-1, x.shape[-1]).mean(axis=0)
    size = np.abs(x[np.isfinite(x)]).max(initial=0)
    decimals = DIGITS - 1 - int(np.floor(np.log10(size))) if size > 0 else 0
    rounded = (round(float(value), decimals) + 0.0 for value in middle)
    return f"({', '.join(f'{value:.{DIGITS}g}' for value in rounded)})"


def raise_on_all(comm: MPI.Comm, message: str | None, error: type[Exception] = InterfaceError):
    """Raise the lowest rank's message on every rank, if any rank has one. Collective."""
    first = next((m for m in comm.allgather(message) if m), None)
    if first:
        raise error(first)
