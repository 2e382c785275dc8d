# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Laws of an interface: a prescribed jump, a compliance or conductance, a law of the user's own."""
