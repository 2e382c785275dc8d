// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// The slip of columns, κ e · P D, and its derivatives (contact_geometry/heights.py).

#include <math.h>
#include <string.h>

#include "heights.h"

// Projection across a facet's normal.
typedef struct {
  Normals normals;
  double m[3], size, kappa; // the normal's direction and length, N₁ · m
} Across;

static Across across_of(const double *q)
{
  Across a = {.normals = normals_of(q)};
  a.size = sqrt(dot(a.normals.m, a.normals.m));
  for (int i = 0; i < 3; ++i)
    a.m[i] = a.normals.m[i] / a.size;
  a.kappa = dot(a.normals.n1, a.m);
  return a;
}

// κ P e
static void flatten(const Across *a, const double *e, double *flat)
{
  double up = dot(e, a->m);
  for (int i = 0; i < 3; ++i)
    flat[i] = a->kappa * (e[i] - up * a->m[i]);
}

// Derivatives of κ e · P D by q while D stays, times a factor.
static void add_slip(const double *q, const Across *a, const double *e, const double *D,
                     double factor, double *by)
{
  double up = dot(e, a->m), down = dot(D, a->m), value = factor * (dot(e, D) - up * down);
  double by_m[3], by_n1[3];
  for (int i = 0; i < 3; ++i)
  {
    by_m[i] = value * a->normals.n1[i] - factor * a->kappa * (down * e[i] + up * D[i]);
    by_n1[i] = value * a->m[i];
  }
  double along = dot(by_m, a->m);
  for (int i = 0; i < 3; ++i)
    by_m[i] = (by_m[i] - along * a->m[i]) / a->size;
  add_normal(q, C1, C2, by_m, by);
  add_normal(q, T1, T2, by_n1, by);
}

// Slips by motions at rays, as vectors that are multiplied with those of q.
//
// block    number of each ray's block, (num)
// e        a direction
// moves    of blocks' dofs, if these are where they have come to: then by q as well,
//          (num_blocks, n, 3); or NULL
// by_q     (num, VECTORS, 3)
void column_slips(const Rays *rays, const int *block, const double *e, const double *moves,
                  double *by_q)
{
  int num0 = rays->num_dofs[0], n = num0 + rays->num_dofs[1];
  memset(by_q, 0, (size_t)SIZE * rays->num * sizeof(double));
  for (int p = 0; p < rays->num; ++p, by_q += SIZE)
  {
    const double *q = rays->q + SIZE * p, *values = rays->functions + (size_t)3 * n * p;
    Across a = across_of(q);
    double flat[3], moved[3][3] = {{0}}, feet[2][SIZE]; // what x₀ − x₁ and Γ0's tangents move by
    flatten(&a, e, flat);
    for (int i = 0; i < 3; ++i)
      by_q[3 * R + i] -= flat[i];
    if (!moves)
      continue;
    const double *by_dofs = moves + (size_t)3 * n * block[p];
    for (int k = 0; k < 3; ++k)
      for (int b = 0; b < (k ? num0 : n); ++b)
        for (int i = 0; i < 3; ++i)
          moved[k][i] += (b < num0 ? 1 : -1) * values[n * k + b] * by_dofs[3 * b + i];
    add_slip(q, &a, e, moved[0], -1, by_q);
    find_feet(q, &a.normals, feet);
    for (int k = 0; k < 2; ++k)
      for (int v = 0; v < SIZE; ++v)
        by_q[v] -= dot(flat, moved[k + 1]) * feet[k][v];
  }
}

// Add derivatives by the dofs of the forces that tractions have.
//
// block      number of each ray's block, (num)
// traction   on Γ1, before they are projected, (num, 3)
// blocks     (num_blocks, n, n, 3, 3), not symmetric
void slip_curvatures(const Rays *rays, const int *block, const double *traction, double *blocks)
{
  int n = rays->num_dofs[0] + rays->num_dofs[1];
  double T[n][MOST_VECTORS], flat[3], feet[2][SIZE];
  Matrix A = {{{0}}};
  for (int p = 0; p < rays->num; ++p, traction += 3)
  {
    const double *q = rays->q + SIZE * p;
    Across a = across_of(q);
    flatten(&a, traction, flat);
    find_feet(q, &a.normals, feet);
    for (int i = 0; i < 3; ++i)
    {
      double by[SIZE] = {0};
      const double unit[3] = {i == 0, i == 1, i == 2};
      add_slip(q, &a, traction, unit, -1, by);
      for (int v = 0; v < SIZE; ++v)
      {
        A[R][v / 3][3 * i + v % 3] = by[v];
        for (int k = 0; k < 2; ++k)
          A[Z1 + k][v / 3][3 * i + v % 3] = -flat[i] * feet[k][v];
      }
    }
    hang_on(rays, p, T);
    add_matrix(rays, T, A, 0, blocks + (size_t)9 * n * n * block[p]);
  }
}
