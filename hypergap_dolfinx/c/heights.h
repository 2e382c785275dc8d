// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Rays along Γ1's normals, and derivatives by the vectors that they are functions of (heights.c).

#ifndef HYPERGAP_HEIGHTS_H
#define HYPERGAP_HEIGHTS_H

#include "space.h"
#include "vectors.h"

// The vectors of q, as contact_geometry/heights.py has them.
enum { R, Z1, Z2, T1, T2, C1, C2, VECTORS };
#define SIZE (3 * VECTORS)

// Where q_u × q_v is multiplied with w: derivatives by both.
static inline void add_normal(const double *q, int u, int v, const double *w, double *by)
{
  double c[3];
  cross(q + 3 * v, w, c);
  for (int i = 0; i < 3; ++i)
    by[3 * u + i] += c[i];
  cross(w, q + 3 * u, c);
  for (int i = 0; i < 3; ++i)
    by[3 * v + i] += c[i];
}

// Normals of Γ0 and Γ1, that of Γ1's facet in the middle, N₀ · M, the height over M, and N₁ · M over
// N₀ · M.
typedef struct {
  double n0[3], n1[3], m[3], b, h, slope;
} Normals;

static inline Normals normals_of(const double *q)
{
  Normals n;
  cross(q + 3 * Z1, q + 3 * Z2, n.n0);
  cross(q + 3 * T1, q + 3 * T2, n.n1);
  cross(q + 3 * C1, q + 3 * C2, n.m);
  n.b = dot(n.n0, n.m);
  n.h = dot(n.n0, q + 3 * R) / n.b;
  n.slope = dot(n.n1, n.m) / n.b;
  return n;
}

// Vectors of q that hang on dofs of Γ0 and of Γ1.
#define MOST_VECTORS 5
static const int vectors[2][MOST_VECTORS] = {{R, Z1, Z2}, {R, T1, T2, C1, C2}};
static const int num_vectors[2] = {3, 5};

// Matrices by two vectors of q, (3, 3), and one that is 0: pairs of numbers are added at once.
#define PADDED 10
typedef double Matrix[VECTORS][VECTORS][PADDED];

void find_feet(const double *q, const Normals *n, double feet[2][SIZE]);
void jet_on(const Facets *side, int f, const double *X, int rows, double (*jet)[3]);
void hang_on(const Rays *rays, int p, double (*T)[MOST_VECTORS]);
void add_matrix(const Rays *rays, const double (*T)[MOST_VECTORS], const Matrix A,
                int symmetric, double *block);

#endif
