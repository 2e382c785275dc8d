# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Multipliers of several interfaces: which ones exist, their numbering and their blocks."""
