# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The saddle-point system [K Bᵀ; B −C]: blocks, input checks, rigid motions."""
