// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Terms of polynomials on a reference facet.

#ifndef HYPERGAP_MONOMIALS_H
#define HYPERGAP_MONOMIALS_H

// Powers of x up to the n-th, and two derivatives, (n + 1, 3).
static inline void powers_of(double x, int n, double (*p)[3])
{
  p[0][0] = 1, p[0][1] = p[0][2] = 0;
  for (int k = 1; k <= n; ++k)
  {
    p[k][0] = x * p[k - 1][0];
    p[k][1] = k * p[k - 1][0];
    p[k][2] = k * p[k - 1][1];
  }
}

// Products of powers of both coordinates, and derivatives by the first, by the second, by the first
// twice, by both, and by the second twice.
//
// powers   (num, 2): that of the first coordinate in the last product is the highest of all
// rows     1, 3 or 6
// table    (rows, num)
static inline void monomials(int num, const int *powers, const double *X, int rows, double *table)
{
  static const int order[6][2] = {{0, 0}, {1, 0}, {0, 1}, {2, 0}, {1, 1}, {0, 2}};
  int highest = powers[2 * num - 2];
  double a[highest + 1][3], b[highest + 1][3];
  powers_of(X[0], highest, a);
  powers_of(X[1], highest, b);
  for (int k = 0; k < rows; ++k)
    for (int t = 0; t < num; ++t)
      table[num * k + t] = a[powers[2 * t]][order[k][0]] * b[powers[2 * t + 1]][order[k][1]];
}

#endif
