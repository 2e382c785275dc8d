# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Weighted gaps and slips of contact with their derivatives, in the plane and in space."""
