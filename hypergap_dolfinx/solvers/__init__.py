# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Solvers of the saddle-point system, and the linear and nonlinear systems of tied bodies."""
