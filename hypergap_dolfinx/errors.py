# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Exceptions of the package."""


class InterfaceError(ValueError):
    """Facets or spaces that can't form an interface. The message is the same on every rank."""


class PrescribedSideError(InterfaceError):
    """Γ1 of an interface is prescribed where Γ0 can move: the sides have to be exchanged."""

    def __init__(self, message: str, interface: int):
        """Store the message and the number of the interface.

        Args:
            message: The message.
            interface: Index of the interface.
        """
        super().__init__(message)
        self.interface = interface


class NotFacingError(InterfaceError):
    """No part of one surface lies opposite the other: an error for ties, not for contacts."""


class InvertedCellError(RuntimeError):
    """An inverted cell of Σ: the normal of Γ_α points back to Γ0."""


class SolveError(RuntimeError):
    """A failed solve. The message says how far it came; later results are invalid."""


class UnsolvableError(SolveError):
    """A failed linear solver, which a smaller load step can't help."""
