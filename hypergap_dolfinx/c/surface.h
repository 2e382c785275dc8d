// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Surfaces in space, as triangles or quadrilaterals. Python reads this file too (core/compiled.py).

#ifndef HYPERGAP_SURFACE_H
#define HYPERGAP_SURFACE_H

// Curved triangles: polynomials of places in facets, where each triangle lies in one.
typedef struct {
  int num_terms, num_bends; // of the polynomials, and of each edge
  const int *powers;        // of both coordinates in each term
  const double *nodes;      // of each triangle: a place, and the polynomials' factors from there
  const double *corners;    // of each triangle: its corners' coordinates in the facet
  const double *bends;      // by what each of its edges leaves the straight line there, if any do
  const double *normals;    // of the vertices
  int steps, further;       // of Newton's method; triangles that a point may cross
} Curves;

int find_neighbours(int n, int num, int size, const int *facets, int *behind);
void inner_edges(int num, const int *triangles, const int *behind, const int *number, int *edges);
int has_corner(int num, int size, const int *behind, const double *normals, double cosine);
int find_kinks(int n, const double *x, int num, int size, const int *facets, const int *behind,
               const double *angles, double limit, double noise, double corner,
               double stands_out, int *kinks);
int find_nearest(int num, const double *points, int n, const double *x, int *node, int *edge,
                 double *s);
void project(int num, const double *points, const double *x, const int *triangles,
             const int *behind, const Curves *curves, int *facet, double *X);
void project_on_curved(int num, const double *points, const double *x, const int *triangles,
                       const Curves *curves, const int *facet, double *X);

#endif
