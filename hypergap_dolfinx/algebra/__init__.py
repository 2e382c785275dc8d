# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The saddle system [K Bᵀ; B −C]: blocks, input checks, rigid motions."""
