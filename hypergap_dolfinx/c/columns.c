// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Second derivatives of volumes of columns by the dofs of both their facets.

#include <string.h>

#include "heights.h"

// A_uv += factor [a]×, with [a]× b = a × b.
static void add_cross(double A[SIZE][SIZE], int u, int v, double factor, const double *a)
{
  for (int i = 0; i < 3; ++i)
  {
    int j = (i + 1) % 3, k = (i + 2) % 3;
    A[3 * u + i][3 * v + j] -= factor * a[k];
    A[3 * u + j][3 * v + i] += factor * a[k];
  }
}

// A_uv += factor [a]× [b]×.
static void add_cross_twice(double A[SIZE][SIZE], int u, int v, double factor, const double *a,
                            const double *b)
{
  for (int i = 0; i < 3; ++i)
  {
    for (int j = 0; j < 3; ++j)
      A[3 * u + i][3 * v + j] += factor * b[i] * a[j];
    A[3 * u + i][3 * v + i] -= factor * dot(a, b);
  }
}

static void add_product(double A[SIZE][SIZE], const double *a, const double *b)
{
  for (int i = 0; i < SIZE; ++i)
    for (int j = 0; a[i] != 0 && j < SIZE; ++j)
      A[i][j] += a[i] * b[j];
}

// A with A + Aᵀ = ∂²f/∂q², f = (N₀ · r) (N₁ · M) / (N₀ · M), with what moves on Γ0.
//
// bends   second derivatives of Γ0, (3, 3); NULL where it is flat
static void half_hessian(const double *q, const double *bends, double A[SIZE][SIZE])
{
  double w[3], left[SIZE] = {0}, right[SIZE] = {0}, by_b[SIZE] = {0};
  Normals n = normals_of(q);
  double h = n.h, slope = n.slope;
  memset(A, 0, SIZE * sizeof(A[0]));
  for (int i = 0; i < 3; ++i)
    w[i] = n.n1[i] - slope * n.n0[i];
  // Of N₀ · r, times the rest; then of N₁ · M and of N₀ · M
  add_cross(A, R, Z1, -slope, q + 3 * Z2);
  add_cross(A, R, Z2, slope, q + 3 * Z1);
  add_cross(A, Z1, Z2, -slope, q + 3 * R);
  add_cross(A, C1, C2, -h, w);
  for (int k = 0; k < 2; ++k)
  {
    int u = k ? Z1 : T1, v = k ? Z2 : T2;
    double factor = k ? -h * slope : h;
    add_cross(A, u, v, -factor, n.m);
    add_cross_twice(A, u, C1, -factor, q + 3 * v, q + 3 * C2);
    add_cross_twice(A, u, C2, factor, q + 3 * v, q + 3 * C1);
    add_cross_twice(A, v, C1, factor, q + 3 * u, q + 3 * C2);
    add_cross_twice(A, v, C2, -factor, q + 3 * u, q + 3 * C1);
  }
  // First derivatives of two factors: half of what both orders have
  add_normal(q, Z1, Z2, n.m, by_b);
  add_normal(q, C1, C2, n.n0, by_b);
  for (int i = 0; i < 3; ++i)
    left[3 * R + i] = n.n0[i];
  add_normal(q, Z1, Z2, q + 3 * R, left);
  add_normal(q, T1, T2, n.m, right);
  add_normal(q, C1, C2, n.n1, right);
  for (int i = 0; i < SIZE; ++i)
  {
    left[i] -= h * by_b[i];
    right[i] = (right[i] - slope * by_b[i]) / n.b;
  }
  add_product(A, left, right);
  if (!bends)
    return;
  double feet[2][SIZE], curve[3];
  find_feet(q, &n, feet);
  for (int k = 0; k < 3; ++k)
    curve[k] = slope * dot(n.n0, bends + 3 * k);
  for (int i = 0; i < SIZE; ++i)
  {
    left[i] = 0.5 * curve[0] * feet[0][i] + curve[1] * feet[1][i];
    right[i] = 0.5 * curve[2] * feet[1][i];
  }
  add_product(A, feet[0], left);
  add_product(A, feet[1], right);
}

static inline void add_scaled(double factor, const double *restrict a, double *restrict to)
{
  for (int c = 0; c < PADDED; ++c)
    to[c] += factor * a[c];
}

// Add Tᵀ A T to a block, with T as hang_on has it; those of dofs a and b ≤ a alone where it is
// symmetric.
void add_matrix(const Rays *rays, const double (*T)[MOST_VECTORS], const Matrix A,
                int symmetric, double *block)
{
  int num0 = rays->num_dofs[0], n = num0 + rays->num_dofs[1];
  for (int a = 0; a < n; ++a)
  {
    int side = a >= num0, end = symmetric ? a + 1 : n;
    double row[VECTORS][PADDED] = {{0}};
    for (int k = 0; k < num_vectors[side]; ++k)
      for (int v = 0; v < (end > num0 ? VECTORS : Z2 + 1); ++v) // Γ0's vectors come first
        add_scaled(T[a][k], A[vectors[side][k]][v], row[v]);
    for (int b = 0; b < end; ++b)
    {
      double part[PADDED] = {0};
      for (int k = 0; k < num_vectors[b >= num0]; ++k)
        add_scaled(T[b][k], row[vectors[b >= num0][k]], part);
      for (int c = 0; c < 9; ++c)
        block[9 * (n * a + b) + c] += part[c];
    }
  }
}

// Add second derivatives of heights to blocks: to those of dofs a and b ≤ a, of which the others are
// the transposes.
//
// block    number of each ray's block, (num)
// factor   what each is multiplied with, (num)
// blocks   (num_blocks, n, n, 3, 3)
void column_curvatures(const Rays *rays, const int *block, const double *factor, double *blocks)
{
  int n = rays->num_dofs[0] + rays->num_dofs[1];
  double half[SIZE][SIZE], T[n][MOST_VECTORS];
  Matrix A = {{{0}}};
  for (int p = 0; p < rays->num; ++p)
  {
    half_hessian(rays->q + SIZE * p, rays->bends ? rays->bends + 9 * p : NULL, half);
    for (int i = 0; i < SIZE; ++i)
      for (int j = 0; j < SIZE; ++j)
        A[i / 3][j / 3][3 * (i % 3) + j % 3] = factor[p] * (half[i][j] + half[j][i]);
    hang_on(rays, p, T);
    add_matrix(rays, T, A, 1, blocks + (size_t)9 * n * n * block[p]);
  }
}

// Add a bᵀ + b aᵀ to the same blocks.
//
// block    number of each product's block, (num)
// a, b     (num, n, 3)
// blocks   (num_blocks, n, n, 3, 3)
void add_products(int num, int n, const int *block, const double *a, const double *b,
                  double *blocks)
{
  for (int p = 0; p < num; ++p, a += 3 * n, b += 3 * n)
  {
    double *H = blocks + (size_t)9 * n * n * block[p];
    for (int i = 0; i < 3 * n; ++i)
      for (int j = 0; j < 3 * (i / 3 + 1); ++j)
        H[9 * (n * (i / 3) + j / 3) + 3 * (i % 3) + j % 3] += a[i] * b[j] + b[i] * a[j];
  }
}

// Make the other blocks of those of dofs a and b ≤ a.
void complete(int num, int n, double *blocks)
{
  for (int p = 0; p < num; ++p, blocks += (size_t)9 * n * n)
    for (int a = 0; a < n; ++a)
      for (int b = 0; b < a; ++b)
        for (int i = 0; i < 9; ++i)
          blocks[9 * (n * b + a) + 3 * (i % 3) + i / 3] = blocks[9 * (n * a + b) + i];
}
