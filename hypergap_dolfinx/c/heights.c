// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Where rays along Γ1's normals meet Γ0, the gap there, and its derivatives (contact_geometry/heights.py).

#include "heights.h"

#include <string.h>

#include "monomials.h"

// Derivatives by q of w · (x₀ − x₁ − h M), with w across M: how the end of a ray that is fixed on Γ0
// moves on Γ1 against the ray.
static void find_motion(const double *q, const Normals *n, const double *w, double *by)
{
  double back[3] = {-n->h * w[0], -n->h * w[1], -n->h * w[2]};
  memset(by, 0, SIZE * sizeof(double));
  memcpy(by + 3 * R, w, 3 * sizeof(double));
  add_normal(q, C1, C2, back, by);
}

// The basis dual to two tangents across M, times the cross product of these over M.
static void find_dual(const double *q, int u, int v, const Normals *n, double dual[2][3])
{
  cross(q + 3 * v, n->m, dual[0]);
  cross(n->m, q + 3 * u, dual[1]);
}

// How the ray's end moves on Γ0, ∂ξ/∂q.
void find_feet(const double *q, const Normals *n, double feet[2][SIZE])
{
  double dual[2][3];
  find_dual(q, Z1, Z2, n, dual);
  for (int k = 0; k < 2; ++k)
  {
    for (int i = 0; i < 3; ++i)
      dual[k][i] /= -n->b; // a foot's motion is that against the ray, seen from Γ1
    find_motion(q, n, dual[k], feet[k]);
  }
}

// Points of a facet from its origin, and derivatives, (rows, 3).
void jet_on(const Facets *side, int f, const double *X, int rows, double (*jet)[3])
{
  int num = side->num_terms;
  double table[rows][num], from[2] = {X[0] - side->middle[0], X[1] - side->middle[1]};
  const double *factors = side->factors + (size_t)3 * num * f;
  monomials(num, side->powers, from, rows, table[0]);
  memset(jet, 0, rows * sizeof(jet[0]));
  for (int k = 0; k < rows; ++k)
    for (int t = 0; t < num; ++t)
      for (int i = 0; i < 3; ++i)
        jet[k][i] += table[k][t] * factors[3 * t + i];
}

// Functions of a facet's dofs and their slopes, (3, stride).
static void functions_on(const Facets *side, const double *X, int stride, double *values)
{
  int num = side->num_terms;
  double table[3][num], from[2] = {X[0] - side->middle[0], X[1] - side->middle[1]};
  monomials(num, side->powers, from, 3, table[0]);
  for (int k = 0; k < 3; ++k)
    for (int a = 0; a < side->num_dofs; ++a)
    {
      values[stride * k + a] = 0;
      for (int t = 0; t < num; ++t)
        values[stride * k + a] += table[k][t] * side->functions[side->num_dofs * t + a];
    }
}

// Find where rays from points of Γ1 meet Γ0, by Newton's method.
//
// tangents    of Γ1's facets in their middles, (num_facets, 2, 3)
// steps       at most
// last        step after which none is needed
// f0, f1      facets, (num)
// X           points of Γ1, (num, 2)
void cast_columns(const Facets *sides, const double *tangents, int steps, double last,
                  const int *f0, const int *f1, const double *X, Rays *rays)
{
  const Facets *below = sides, *above = sides + 1;
  int num0 = below->num_dofs, n = num0 + above->num_dofs;
  for (int p = 0; p < rays->num; ++p)
  {
    double on0[6][3], on1[3][3], between[3], m[3], n0[3], w[3];
    double *q = rays->q + SIZE * p, *xi = rays->xi + 2 * p;
    jet_on(above, f1[p], X + 2 * p, 3, on1);
    memcpy(q + 3 * T1, on1[1], 6 * sizeof(double));
    memcpy(q + 3 * C1, tangents + 6 * f1[p], 6 * sizeof(double));
    cross(q + 3 * C1, q + 3 * C2, m);
    minus(above->origins + 3 * f1[p], below->origins + 3 * f0[p], between);
    memcpy(xi, below->middle, 2 * sizeof(double));
    double step = INFINITY;
    for (int k = 0; k < steps && !(step < last); ++k)
    {
      double rest[3];
      jet_on(below, f0[p], xi, 3, on0);
      cross(on0[1], on0[2], n0);
      for (int i = 0; i < 3; ++i)
        rest[i] = between[i] + on1[0][i] - on0[0][i];
      double up = dot(n0, rest) / dot(n0, m), square = fmax(dot(n0, n0), 1e-300);
      for (int i = 0; i < 3; ++i)
        rest[i] -= up * m[i]; // along Γ0's tangents
      step = 0;
      for (int j = 0; j < 2; ++j)
      {
        cross(j ? n0 : on0[2], j ? on0[1] : n0, w);
        double move = dot(w, rest) / square;
        xi[j] += move;
        step = fmax(step, fabs(move));
      }
    }
    jet_on(below, f0[p], xi, rays->bends ? 6 : 3, on0);
    for (int i = 0; i < 3; ++i)
      q[3 * R + i] = on0[0][i] - on1[0][i] - between[i];
    memcpy(q + 3 * Z1, on0[1], 6 * sizeof(double));
    if (rays->bends)
      memcpy(rays->bends + 9 * p, on0[3], 9 * sizeof(double));
    double *functions = rays->functions + (size_t)3 * n * p;
    functions_on(below, xi, n, functions);
    functions_on(above, X + 2 * p, n, functions + num0);
  }
}

// Heights of rays times Γ1's areas as seen along them, f = (N₀ · r) (N₁ · M) / (N₀ · M).
//
// heights     (num)
// areas       (num)
// by_q        ∂f/∂q, (num, VECTORS, 3); nothing by Γ0's tangents, along which r and M are one
void column_heights(const Rays *rays, double *heights, double *areas, double *by_q)
{
  memset(by_q, 0, (size_t)SIZE * rays->num * sizeof(double));
  for (int p = 0; p < rays->num; ++p, by_q += SIZE)
  {
    const double *q = rays->q + SIZE * p;
    Normals n = normals_of(q);
    double w[3], by_m[3];
    heights[p] = n.h * n.slope * n.b;
    areas[p] = n.slope * n.b / sqrt(dot(n.m, n.m));
    for (int i = 0; i < 3; ++i)
    {
      by_q[3 * R + i] = n.slope * n.n0[i];
      w[i] = n.h * n.m[i];
      by_m[i] = n.h * (n.n1[i] - n.slope * n.n0[i]);
    }
    add_normal(q, T1, T2, w, by_q);
    add_normal(q, C1, C2, by_m, by_q);
  }
}

// How those edges of pieces that are Γ0's move on Γ1, at the rays from there.
//
// normal   out of the piece, of any length, in Γ1's reference facet, (num, 2)
// motion   along the normal, by q, (num, VECTORS, 3)
// slopes   of f beyond the edge less that before it, over the normal, (num)
void column_edges(const Rays *rays, const double *normal, double *motion, double *slopes)
{
  for (int p = 0; p < rays->num; ++p, normal += 2)
  {
    const double *q = rays->q + SIZE * p;
    Normals n = normals_of(q);
    double dual[2][3], w[3], rise = 0, square = 0;
    find_dual(q, T1, T2, &n, dual);
    for (int i = 0; i < 3; ++i)
      w[i] = (normal[0] * dual[0][i] + normal[1] * dual[1][i]) / (n.slope * n.b);
    find_motion(q, &n, w, motion + SIZE * p);
    for (int k = 0; k < 2; ++k)
    {
      rise += normal[k] * dot(q + 3 * (T1 + k), n.n0);
      square += normal[k] * normal[k];
    }
    slopes[p] = -n.slope * rise / fmax(square, 1e-300);
  }
}

// ∂q/∂u at a ray: of each dof by the vectors that hang on it, (n, MOST_VECTORS).
void hang_on(const Rays *rays, int p, double (*T)[MOST_VECTORS])
{
  int num0 = rays->num_dofs[0], num1 = rays->num_dofs[1], n = num0 + num1;
  const double *values = rays->functions + (size_t)3 * n * p;
  for (int a = 0; a < n; ++a)
  {
    T[a][0] = a < num0 ? values[a] : -values[a];
    for (int k = 0; k < 2; ++k)
    {
      T[a][k + 1] = values[n * (k + 1) + a];
      if (a >= num0)
        T[a][k + 3] = rays->middle[num1 * k + a - num0];
    }
  }
}

// Add derivatives by the dofs of what vectors say by q.
//
// block    number of each ray's block, (num)
// factor   of each, (num)
// by_q     (num, VECTORS, 3)
// blocks   (num_blocks, n, 3)
void sum_by_dofs(const Rays *rays, const int *block, const double *factor, const double *by_q,
                 double *blocks)
{
  int num0 = rays->num_dofs[0], n = num0 + rays->num_dofs[1];
  double T[n][MOST_VECTORS];
  for (int p = 0; p < rays->num; ++p, by_q += SIZE)
  {
    double *to = blocks + (size_t)3 * n * block[p];
    hang_on(rays, p, T);
    for (int a = 0; a < n; ++a)
      for (int k = 0; k < num_vectors[a >= num0]; ++k)
        for (int i = 0; i < 3; ++i)
          to[3 * a + i] += factor[p] * T[a][k] * by_q[3 * vectors[a >= num0][k] + i];
  }
}
