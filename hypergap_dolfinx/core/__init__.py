# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Tools of every room: compiled C, DOLFINx versions, PETSc objects' lifetimes, graphs, progress."""
