// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Cells of Σ in space. Python reads this file too (core/compiled.py).

#ifndef HYPERGAP_GAP_MESH_H
#define HYPERGAP_GAP_MESH_H

#include <stdint.h>

int front_fill(int n0, int n1, const double *vertices, double flat, int num_start, const int *start,
               int num_end, const int *end, int max_cells, int *cells, int *left, int *counts);
int front_weights(int n, double *vertices, int num, const int *edges, int sweeps, double visits);
int front_swap(int n0, int n, const double *vertices, const int *rank, double flat, double least,
               int num, int max, int *cells);
int front_check(int n0, int n, const double *vertices, int num_cells, const int *cells,
                int num_outer, const int *outer, int *counts);
int single_faces(int n, int num_cells, const int *cells, int num_outer, const int *outer,
                 int *faces, int *counts);
void cell_areas(int num, const int *cells, const double *x, const double *alpha,
                const double *normals, double *areas, double *scales);
int cells_at_vertices(int n, int num, const int *cells, int *offset, int *at);
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
int linear_program(int n, int num, const double *A, const double *b, const double *c, double bound,
                   double *z);

#endif
