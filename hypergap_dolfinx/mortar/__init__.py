# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The gap finite element (eqs. 6–22): kernel, the domain Σ, the constraint, fields on Σ."""
