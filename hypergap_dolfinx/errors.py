# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What is raised, and how all ranks raise it together."""


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
