// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Second derivatives of what columns hold by the dofs of both their facets.

// The vectors of q, as gap/heights.py has them.
enum { R, Z1, Z2, T1, T2, C1, C2, VECTORS };
#define SIZE (3 * VECTORS)

static void cross(const double *a, const double *b, double *c)
{
  for (int i = 0; i < 3; ++i)
  {
    int j = (i + 1) % 3, k = (i + 2) % 3;
    c[i] = a[j] * b[k] - a[k] * b[j];
  }
}

// Where q_u × q_v is multiplied with w: derivatives by both.
static void add_normal(const double *q, int u, int v, const double *w, double *by)
{
  double c[3];
  cross(q + 3 * v, w, c);
  for (int i = 0; i < 3; ++i)
    by[3 * u + i] += c[i];
  cross(w, q + 3 * u, c);
  for (int i = 0; i < 3; ++i)
    by[3 * v + i] += c[i];
}

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
  double n0[3], n1[3], m[3], w[3], left[SIZE] = {0}, right[SIZE] = {0}, by_b[SIZE] = {0};
  memset(A, 0, SIZE * sizeof(A[0]));
  cross(q + 3 * Z1, q + 3 * Z2, n0);
  cross(q + 3 * T1, q + 3 * T2, n1);
  cross(q + 3 * C1, q + 3 * C2, m);
  double b = dot(n0, m), h = dot(n0, q + 3 * R) / b, slope = dot(n1, m) / b;
  for (int i = 0; i < 3; ++i)
    w[i] = n1[i] - slope * n0[i];
  // Of N₀ · r, times the rest; then of N₁ · M and of N₀ · M
  add_cross(A, R, Z1, -slope, q + 3 * Z2);
  add_cross(A, R, Z2, slope, q + 3 * Z1);
  add_cross(A, Z1, Z2, -slope, q + 3 * R);
  add_cross(A, C1, C2, -h, w);
  for (int k = 0; k < 2; ++k)
  {
    int u = k ? Z1 : T1, v = k ? Z2 : T2;
    double factor = k ? -h * slope : h;
    add_cross(A, u, v, -factor, m);
    add_cross_twice(A, u, C1, -factor, q + 3 * v, q + 3 * C2);
    add_cross_twice(A, u, C2, factor, q + 3 * v, q + 3 * C1);
    add_cross_twice(A, v, C1, factor, q + 3 * u, q + 3 * C2);
    add_cross_twice(A, v, C2, -factor, q + 3 * u, q + 3 * C1);
  }
  // First derivatives of two factors: half of what both orders have
  add_normal(q, Z1, Z2, m, by_b);
  add_normal(q, C1, C2, n0, by_b);
  for (int i = 0; i < 3; ++i)
    left[3 * R + i] = n0[i];
  add_normal(q, Z1, Z2, q + 3 * R, left);
  add_normal(q, T1, T2, m, right);
  add_normal(q, C1, C2, n1, right);
  for (int i = 0; i < SIZE; ++i)
  {
    left[i] -= h * by_b[i];
    right[i] = (right[i] - slope * by_b[i]) / b;
  }
  add_product(A, left, right);
  if (!bends)
    return;
  // How the ray's end moves on Γ0
  double moves[2][SIZE] = {{0}};
  for (int k = 0; k < 2; ++k)
  {
    cross(k ? m : q + 3 * Z2, k ? q + 3 * Z1 : m, w);
    for (int i = 0; i < 3; ++i)
    {
      moves[k][3 * R + i] = -w[i] / b;
      w[i] *= h / b;
    }
    add_normal(q, C1, C2, w, moves[k]);
  }
  double curve[3];
  for (int k = 0; k < 3; ++k)
    curve[k] = slope * dot(n0, bends + 3 * k);
  for (int i = 0; i < SIZE; ++i)
  {
    left[i] = 0.5 * curve[0] * moves[0][i] + curve[1] * moves[1][i];
    right[i] = 0.5 * curve[2] * moves[1][i];
  }
  add_product(A, moves[0], left);
  add_product(A, moves[1], right);
}

// Add second derivatives at points to blocks: to those of dofs a and b ≤ a, of which the others are
// the transposes.
//
// n        dofs of both facets
// block    number of each point's block, (num)
// factor   what each is multiplied with, (num)
// q        (num, VECTORS, 3)
// bends    (num, 3, 3) or NULL
// T        ∂q/∂u, (num, VECTORS, n)
// blocks   (num_blocks, n, n, 3, 3)
void column_curvatures(int num, int n, const int *block, const double *factor, const double *q,
                       const double *bends, const double *T, double *blocks)
{
  double A[SIZE][SIZE], row[3][SIZE];
  for (int p = 0; p < num; ++p, q += SIZE, T += VECTORS * n)
  {
    double *H = blocks + (size_t)9 * n * n * block[p];
    half_hessian(q, bends ? bends + 9 * p : NULL, A);
    for (int i = 0; i < SIZE; ++i)
      for (int j = 0; j <= i; ++j)
        A[i][j] = A[j][i] = factor[p] * (A[i][j] + A[j][i]);
    for (int a = 0; a < n; ++a)
    {
      memset(row, 0, sizeof row);
      for (int u = 0; u < VECTORS; ++u)
        for (int i = 0; T[n * u + a] != 0 && i < 3; ++i)
          for (int k = 0; k < SIZE; ++k)
            row[i][k] += T[n * u + a] * A[3 * u + i][k];
      for (int b = 0; b <= a; ++b)
      {
        double *part = H + 9 * (n * a + b);
        for (int u = 0; u < VECTORS; ++u)
          for (int i = 0; T[n * u + b] != 0 && i < 3; ++i)
            for (int j = 0; j < 3; ++j)
              part[3 * i + j] += T[n * u + b] * row[i][3 * u + j];
      }
    }
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
