# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Surfaces in space that overlap in part: outlines, and facets cut to what both sides share."""
