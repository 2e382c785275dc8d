# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Gmsh while one mesh is made."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def gmsh_session() -> Iterator:
    """Gmsh's module, quiet and on one thread, without what users or earlier meshes have set."""
    import gmsh  # not where only other meshes are made

    gmsh.initialize(argv=[], readConfigFiles=False, run=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        yield gmsh
    finally:
        gmsh.finalize()
