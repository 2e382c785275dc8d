# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Exceptions of the package."""


class InterfaceError(ValueError):
    """The given facets or spaces can't form an interface; the message is the same on every rank."""


class PrescribedSideError(InterfaceError):
    """Γ1 of an interface is prescribed where Γ0 can move: the other side would have to be Γ1."""

    def __init__(self, message: str, interface: int):
        """The message, and the interface's number."""
        super().__init__(message)
        self.interface = interface


class NotFacingError(InterfaceError):
    """No part of one surface lies opposite the other: an error for ties, but not for contact."""


class InvertedCellError(RuntimeError):
    """A gap element is inverted: the normal of Γ_α points back to Γ0."""


class SolveError(RuntimeError):
    """A solve failed; the message says how far it came, and results beyond that are invalid."""


class UnsolvableError(SolveError):
    """An iterative solver fails, for which a smaller load step is no easier."""
