# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Newton's method for bodies in contact: rows, active sets, friction, predictor, matrix."""
