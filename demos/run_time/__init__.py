# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The contact scene of ``error_against_run_time.py``, by this package and by others."""
