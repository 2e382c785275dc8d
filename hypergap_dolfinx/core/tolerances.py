# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tolerances of this room: one value, one meaning, and the measurement behind each."""

DIGITS_MESSAGES = 6
"""Digits of coordinates in messages.

Measured: –"""

MANY = 20
"""Parts of a mesh beyond which it is one body.

Measured: memory of rigid motions."""
