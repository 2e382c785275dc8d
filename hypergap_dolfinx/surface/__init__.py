# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One side of an interface: the trace of a space on its facets, and its geometry. No solving."""
