# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Parametric meshes that the demos and the tests share."""

from meshes.solids import (
    HOLE,
    SIDE,
    hollow_cube,
    nested_shells,
    perforated_plate,
    solid_block,
    spherical_shell,
)
from meshes.structured import (
    BACK,
    BOTTOM,
    END,
    FRONT,
    INNER,
    LEFT,
    OUTER,
    PLANE_X,
    PLANE_Y,
    PLANE_Z,
    RIGHT,
    START,
    TOP,
    block,
    ring_sector,
    spherical_layers,
)

__all__ = [
    "BACK",
    "BOTTOM",
    "END",
    "FRONT",
    "HOLE",
    "INNER",
    "LEFT",
    "OUTER",
    "PLANE_X",
    "PLANE_Y",
    "PLANE_Z",
    "RIGHT",
    "SIDE",
    "START",
    "TOP",
    "block",
    "hollow_cube",
    "nested_shells",
    "perforated_plate",
    "ring_sector",
    "solid_block",
    "spherical_layers",
    "spherical_shell",
]
