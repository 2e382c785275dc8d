// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Quadrature on polygons (contact_geometry/moments.py).

#include <math.h>
#include <string.h>

#include "monomials.h"
#include "space.h"

// Area, middle from the first corner, and the lower square root of the matrix of second moments.
typedef struct {
  double area, middle[2], c, d, e;
} Moments;

// Of triangles with the first corner: steps to both others, and the area.
static double triangle(const double *X, int t, double *a, double *b)
{
  for (int i = 0; i < 2; ++i)
  {
    a[i] = X[2 * (t + 1) + i] - X[i];
    b[i] = X[2 * (t + 2) + i] - X[i];
  }
  return 0.5 * (a[0] * b[1] - a[1] * b[0]);
}

// Moments of a polygon.
//
// least    standard deviation over that along it, squared, that is none
// flat     whether there may be less across it
static Moments moments_of(int num_corners, const double *X, double least, int flat)
{
  Moments m = {0};
  double a[2], b[2], second[3] = {0};
  for (int t = 0; t < num_corners - 2; ++t)
    m.area += triangle(X, t, a, b);
  for (int t = 0; t < num_corners - 2; ++t)
  {
    double share = triangle(X, t, a, b) / m.area;
    for (int i = 0; i < 2; ++i)
      m.middle[i] += share * (a[i] + b[i]) / 3;
    for (int k = 0; k < 3; ++k) // ∫ x xᵀ over a triangle with a corner at 0
    {
      int i = k == 2, j = k > 0;
      second[k] += share * (2 * (a[i] * a[j] + b[i] * b[j]) + a[i] * b[j] + b[i] * a[j]) / 12;
    }
  }
  for (int k = 0; k < 3; ++k)
    second[k] -= m.middle[k == 2] * m.middle[k > 0];
  // Where points lie is free: any weights that fit are right
  least = least * (second[0] + second[2]) + 1e-300;
  m.c = sqrt(fmax(second[0], least));
  m.d = second[1] / m.c;
  m.e = sqrt(fmax(second[2] - m.d * m.d, flat ? 0 : least));
  return m;
}

// Points and weights on convex polygons.
//
// X          corners, of which the last one may be repeated, (num, num_corners, 2)
// points     where the mean and the standard deviations are 0 and 1, (num_points, 2)
// least      standard deviation over that along a polygon, squared, that is none
// num_terms  of the polynomials; 0: all weights are the same
// powers     of both coordinates, (num_terms, 2)
// inverse    what makes weights of moments, (num_terms, num_points)
// inner      points and weights on the reference triangle, (num_inner, 3)
// at         (num, num_points, 2)
// weights    (num, num_points)
void polygon_rule(int num, int num_corners, const double *X, int num_points, const double *points,
                  double least, int num_terms, const int *powers, const double *inverse,
                  int num_inner, const double *inner, double *at, double *weights)
{
  double moments[num_terms + 1], table[num_terms + 1], a[2], b[2];
  for (int p = 0; p < num; ++p, X += 2 * num_corners, weights += num_points)
  {
    Moments m = moments_of(num_corners, X, least, num_terms == 0);
    for (int k = 0; k < num_points; ++k, at += 2)
    {
      const double *y = points + 2 * k;
      at[0] = X[0] + m.middle[0] + m.c * y[0];
      at[1] = X[1] + m.middle[1] + m.d * y[0] + m.e * y[1];
      weights[k] = num_terms ? 0 : m.area / num_points;
    }
    memset(moments, 0, sizeof moments);
    for (int t = 0; num_terms && t < num_corners - 2; ++t)
    {
      double area = triangle(X, t, a, b);
      for (int k = 0; area != 0 && k < num_inner; ++k)
      {
        const double *in = inner + 3 * k;
        double y[2] = {a[0] * in[0] + b[0] * in[1] - m.middle[0],
                       a[1] * in[0] + b[1] * in[1] - m.middle[1]};
        y[0] /= m.c;
        y[1] = (y[1] - m.d * y[0]) / m.e;
        monomials(num_terms, powers, y, 1, table);
        for (int n = 0; n < num_terms; ++n)
          moments[n] += 2 * area * in[2] * table[n];
      }
    }
    for (int n = 0; n < num_terms; ++n)
      for (int k = 0; k < num_points; ++k)
        weights[k] += moments[n] * inverse[num_points * n + k];
  }
}
