# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What every room uses: compiled C, DOLFINx versions, lifetimes of PETSc objects, graphs, progress."""
