# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Parametric meshes that the demos and the tests share."""

from meshes.structured import (
    BACK,
    BOTTOM,
    END,
    FRONT,
    INNER,
    LEFT,
    OUTER,
    RIGHT,
    START,
    TOP,
    block,
    ring_sector,
)

__all__ = [
    "BACK",
    "BOTTOM",
    "END",
    "FRONT",
    "INNER",
    "LEFT",
    "OUTER",
    "RIGHT",
    "START",
    "TOP",
    "block",
    "ring_sector",
]
