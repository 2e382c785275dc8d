# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The gap finite element (eqs. 6–22): kernel, the domain Σ, the constraint, fields on Σ."""
