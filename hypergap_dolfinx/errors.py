# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Exceptions of the package."""


class InterfaceError(ValueError):
    """The given facets or spaces can't form an interface; the message is the same on every rank."""


class NotFacingError(InterfaceError):
    """No part of one surface lies opposite the other: an error for ties, but not for contact."""


class InvertedCellError(RuntimeError):
    """A gap element is inverted: the normal of Γ_α points back to Γ0."""


class SolveError(RuntimeError):
    """A solve failed; the message says how far it came, and results beyond that are invalid."""
