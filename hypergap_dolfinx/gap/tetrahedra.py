# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Gmsh: fill a closed triangulation with tetrahedra, and leave its triangles as they are."""

import ctypes
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import numpy.typing as npt

HXT, DELAUNAY = 10, 1  # Gmsh's numbers of its algorithms

_OPTIONS = {
    "General.Terminal": 0,
    "General.AbortOnError": 0,  # an exception would leave Gmsh locked
    "General.NumThreads": 1,  # the same mesh each time
    "Mesh.MaxNumThreads3D": 1,
    "Mesh.ElementOrder": 1,
    "Mesh.MeshOnlyEmpty": 0,
    "Mesh.MeshOnlyVisible": 0,
    "Mesh.SaveAll": 0,
    # No nodes between the surfaces unless the mesher can't do without
    "Mesh.MeshSizeExtendFromBoundary": 0,
    "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.MeshSizeFromParametricPoints": 0,
    "Mesh.MeshSizeFactor": 1,
    "Mesh.MeshSizeMin": 0,
    "Mesh.MeshSizeMax": 1e22,
    # Swaps of edges and faces make flat tetrahedra rare, and leave the surface alone
    "Mesh.Optimize": 1,
    "Mesh.OptimizeThreshold": 0.1,
    "Mesh.OptimizeNetgen": 0,
    "Mesh.HighOrderOptimize": 0,
    "Mesh.SecondOrderLinear": 0,
}


class MeshingError(RuntimeError):
    """Gmsh found no mesh."""


@contextmanager
def session() -> Iterator:
    """Gmsh with our options: a session of its own, or a guest in the user's.

    Yields:
        The ``gmsh`` module.

    Raises:
        ImportError: Gmsh is not installed.
    """
    try:
        import gmsh
    except (ImportError, OSError) as error:  # OSError: one of Gmsh's libraries is missing
        raise ImportError(
            "3D interfaces are meshed with Gmsh, which can't be imported here "
            f"({error}): pip install gmsh, or pip install hypergap-dolfinx[gmsh]."
        ) from error
    guest = bool(gmsh.isInitialized())
    if not guest:
        gmsh.initialize(argv=[], readConfigFiles=False, run=False, interruptible=False)
    saved = {name: gmsh.option.getNumber(name) for name in _OPTIONS}
    saved["Mesh.Algorithm3D"] = gmsh.option.getNumber("Mesh.Algorithm3D")
    model = gmsh.model.getCurrent() if guest else None
    try:
        for name, value in _OPTIONS.items():
            gmsh.option.setNumber(name, value)
        yield gmsh
    finally:
        if guest:
            for name, value in saved.items():
                gmsh.option.setNumber(name, value)
            gmsh.model.setCurrent(model)
        else:
            gmsh.finalize()


@contextmanager
def _nothing_printed() -> Iterator[None]:
    """Keep from the terminal what Gmsh's mesher prints of attempts that fail, unasked."""
    try:
        stdout = os.dup(1)
    except OSError:  # a process without one
        yield
        return
    flush = ctypes.CDLL(None).fflush
    sys.stdout.flush()
    flush(None)
    with open(os.devnull, "w") as null:
        os.dup2(null.fileno(), 1)
    try:
        yield
    finally:
        flush(None)  # what C's library still holds
        os.dup2(stdout, 1)
        os.close(stdout)


def fill(gmsh, x: npt.NDArray[np.float64], shells: Sequence[npt.NDArray], algorithm: int = HXT):
    """Tetrahedra inside a closed triangulation.

    Args:
        gmsh: The module, in a :func:`session`.
        x: Vertices, ``(num_vertices, 3)``.
        shells: Triangles of each connected part of the surface, the outermost first,
            ``(num_triangles, 3)`` each.
        algorithm: Gmsh's number of the algorithm.

    Returns:
        Vertices, those given first, and the tetrahedra in them, ``(num_cells, 4)``.

    Raises:
        MeshingError: Gmsh gave up; says why.
    """
    gmsh.model.add("hypergap_dolfinx")
    gmsh.option.setNumber("Mesh.Algorithm3D", algorithm)
    try:
        tags = np.arange(1, len(x) + 1)
        loops: list[int] = []
        for triangles in shells:
            surface = gmsh.model.addDiscreteEntity(2)
            if not loops:
                gmsh.model.mesh.addNodes(2, surface, tags, np.ascontiguousarray(x).ravel())
            gmsh.model.mesh.addElementsByType(surface, 2, [], (triangles + 1).ravel())
            loops.append(gmsh.model.geo.addSurfaceLoop([surface]))
        gmsh.model.geo.addVolume(loops)
        gmsh.model.geo.synchronize()
        with _nothing_printed():
            gmsh.model.mesh.generate(3)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        _, cells = gmsh.model.mesh.getElementsByType(4)
        reason = gmsh.logger.getLastError()
    except Exception as error:  # gmsh raises nothing more specific
        raise MeshingError(str(error)) from error
    finally:
        gmsh.model.remove()
    if not len(cells):
        raise MeshingError(reason or "no tetrahedra")
    order = np.argsort(tags)
    number = np.searchsorted(tags[order], cells).reshape(-1, 4)
    vertices = coordinates.reshape(-1, 3)[order]
    vertices[: len(x)] = x
    return vertices, number.astype(np.int64)
