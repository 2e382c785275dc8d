# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Compiled C, built once with the compiler that FFCx uses, and kept in the cache that it uses."""

import hashlib
import importlib.machinery
import importlib.util
import os
import sys
import tempfile
from functools import cache
from pathlib import Path

import cffi
import numpy as np
import numpy.typing as npt

from dolfinx.jit import get_options

NAMES = (
    "predicates.h weights.c front.c advance.c swaps.c check.c bases.c surface.c "
    "program.c monomials.c project.c plane.h rays.c fans.c by_dofs.c "
    "space.h blocks.c heights.c columns.c slips.c moments.c pieces.c"
).split()
HEADERS = "plane.h", "space.h"  # what Python reads, too
FOLDER = Path(__file__).parents[1] / "c"
DECLARATIONS = """
typedef struct {
  int num_terms, num_bends;
  const int *powers;
  const double *nodes, *corners, *bends, *normals;
  int steps, further;
} Curves;
int front_fill(int n0, int n1, const double *vertices, double flat, int num_start, const int *start,
               int num_end, const int *end, int max_cells, int *cells, int *left, int *counts);
int front_weights(int n, double *vertices, int num, const int *edges, int sweeps, double visits);
int front_check(int n0, int n, const double *vertices, int num_cells, const int *cells,
                int num_outer, const int *outer, int *counts);
int front_swap(int n0, int n, const double *vertices, const int *rank, double flat, double least,
               int num, int max, int *cells);
int find_facets(int n, int num_facets, const int *facets, int size, int num, const int *corners,
                int *found);
int find_bases(int n0, int n1, int num0, const int *facets0, int num1, const int *facets1,
               int num_cells, const int *cells, int *bases);
void facets_beside(int first, int last, const int *seeds, int num, const int *cells, int *beside);
void cell_normals(int num, const int *cells, const double *at_vertices, const int *bases,
                  const double *normals0, const double *normals1, double *normals);
void vertex_hosts(int num, const int64_t *which, const int *cells, int points, int num_local,
                  const int *local, const int *at, const int *on, const double *X,
                  const int *beside, int64_t *facets, double *places);
int cells_at_vertices(int n, int num, const int *cells, int *offset, int *at);
int single_faces(int n, int num_cells, const int *cells, int num_outer, const int *outer,
                 int *faces, int *counts);
int find_kinks(int n, const double *x, int num, int size, const int *facets, const int *behind,
               const double *normals, double limit, double noise, double corner,
               double stands_out, int *kinks);
int find_neighbours(int n, int num, int size, const int *facets, int *behind);
int has_corner(int num, int size, const int *behind, const double *normals, double cosine);
int find_nearest(int num, const double *points, int n, const double *x, int *node, int *edge,
                 double *s);
int linear_program(int n, int num, const double *A, const double *b, const double *c, double bound,
                   double *z);
void project(int num, const double *points, const double *x, const int *triangles,
             const int *behind, const Curves *curves, int *facet, double *X);
void project_on_curved(int num, const double *points, const double *x, const int *triangles,
                       const Curves *curves, const int *facet, double *X);
"""
FLAGS = ["-O2", "-g0", "-fno-math-errno", "-fno-trapping-math"]


@cache
def library():
    """The C in ``c/`` as a module: ``lib`` has its functions, ``ffi`` makes their arguments.

    Any number of processes may come here at once: each that finds nothing compiles in a folder of
    its own, and the file appears under its final name as a whole.

    Raises:
        RuntimeError: There is no C compiler that works.
    """
    source = "".join((FOLDER / name).read_text() for name in NAMES)
    declarations = DECLARATIONS + "".join((FOLDER / name).read_text() for name in HEADERS)
    version = f"{cffi.__version__} {sys.version} {FLAGS}"
    digest = hashlib.sha256("\n".join((source, declarations, version)).encode()).hexdigest()
    name = f"hypergap_front_{digest[:16]}"
    folder = Path(get_options()["cache_dir"])
    path = folder / (name + importlib.machinery.EXTENSION_SUFFIXES[0])
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        _compile(name, source, declarations, path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def as_ints(array: npt.NDArray):
    """An array as C's ``int *``; what it points to lives as long as it does."""
    array = np.ascontiguousarray(array, dtype=np.int32)
    return library().ffi.from_buffer("int[]", array)


def as_doubles(array: npt.NDArray):
    """An array as C's ``double *``, likewise."""
    return library().ffi.from_buffer("double[]", np.ascontiguousarray(array, dtype=float))


def _compile(name: str, source: str, declarations: str, path: Path):
    builder = cffi.FFI()
    builder.set_source(name, source, extra_compile_args=FLAGS)
    builder.cdef(declarations)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=name) as folder:
        try:
            built = builder.compile(tmpdir=folder)
        except Exception as error:  # setuptools' errors have no class in common
            raise RuntimeError(
                "3D interfaces and contact need a C compiler, as DOLFINx does, and it failed: "
                f"{error}"
            ) from error
        os.replace(built, path)
