# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cells of the gap domain Σ: a strip of triangles in the plane, a slab of tetrahedra in space."""
