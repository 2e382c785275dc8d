# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""PETSc options of a solver."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from petsc4py import PETSc

from hypergap_dolfinx.errors import SolveError

UNKNOWN_TYPE = 86
"""PETSc's code for a type of KSP or PC that it doesn't have."""


def prefixed(prefix: str, options: dict[str, Any]) -> dict[str, Any]:
    """Options of what a solver consists of."""
    return {prefix + key: value for key, value in options.items()}


def names_types(options: dict | None) -> bool:
    """Whether PETSc options say how to solve, and not only how exactly."""
    return bool({"ksp_type", "pc_type"} & set(options or {}))


class Options:
    """PETSc options that are in its database only while they are needed."""

    def __init__(self, prefix: str, options: dict[str, Any], defaults: dict[str, Any], unfit: str):
        """Choose them: given ones, the command line's, defaults, in this order.

        Args:
            prefix: Of PETSc's objects.
            options: The user's.
            defaults: Those of the solver.
            unfit: What is said of options that PETSc can't solve with.

        Raises:
            ValueError: No prefix.
        """
        if not prefix:
            raise ValueError("the PETSc options prefix cannot be empty.")
        given = PETSc.Options().getAll()
        free = {key: value for key, value in defaults.items() if prefix + key not in given}
        self._options = {prefix + key: value for key, value in {**free, **options}.items()}
        self._unfit = unfit

    @contextmanager
    def in_use(self) -> Iterator[None]:
        """Put them into the database: MUMPS reads its own when it is called.

        Raises:
            SolveError: PETSc can't solve with these options.
        """
        database = PETSc.Options()
        before = database.getAll()
        for key, value in self._options.items():
            database[key] = value
        try:
            yield
        except PETSc.Error as error:
            cause = error.__cause__
            if cause is not None and not isinstance(cause, PETSc.Error):
                raise cause from None  # of Python that PETSc called; old PETSc raises it itself
            reason = str(error).strip().splitlines()[-1].removeprefix("[0] ")
            raise SolveError(
                f"PETSc can't solve with these options: {reason} (code {error.ierr})."
                + self._unfit * (error.ierr != UNKNOWN_TYPE)
            ) from error
        finally:
            for key in self._options:
                del database[key]
                if key in before:
                    database[key] = before[key]
