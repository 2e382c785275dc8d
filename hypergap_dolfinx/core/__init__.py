# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tools for all rooms: compiled C, DOLFINx versions, lifetimes of objects, graphs, progress."""
