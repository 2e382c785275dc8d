// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Terms of polynomials on a reference facet.

// x to the n, and two derivatives.
static void power(double x, int n, double *p)
{
  p[0] = 1, p[1] = p[2] = 0;
  for (int k = 0; k < n; ++k)
  {
    p[2] = x * p[2] + 2 * p[1];
    p[1] = x * p[1] + p[0];
    p[0] *= x;
  }
}

// Products of powers of both coordinates, and derivatives by the first, by the second, by the first
// twice, by both, and by the second twice.
//
// powers   (num, 2)
// rows     1, 3 or 6
// table    (rows, num)
static void monomials(int num, const int *powers, const double *X, int rows, double *table)
{
  static const int order[6][2] = {{0, 0}, {1, 0}, {0, 1}, {2, 0}, {1, 1}, {0, 2}};
  for (int t = 0; t < num; ++t)
  {
    double a[3], b[3];
    power(X[0], powers[2 * t], a);
    power(X[1], powers[2 * t + 1], b);
    for (int k = 0; k < rows; ++k)
      table[num * k + t] = a[order[k][0]] * b[order[k][1]];
  }
}
