// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Vectors in space, and what functions return.

#ifndef HYPERGAP_VECTORS_H
#define HYPERGAP_VECTORS_H

#include <math.h>

enum { DONE = 0, STUCK = 1, NO_MEMORY = 2, BAD_INPUT = 3 };

// A ball around points.
typedef struct {
  double middle[3], radius;
} Ball;

static inline double larger(double a, double b) { return a > b ? a : b; }

static inline double smaller(double a, double b) { return a < b ? a : b; }

// A step from 0 to 1, once smooth, and its two derivatives.
static inline void smooth_step(double a, const double *ends, double *f)
{
  double width = ends[1] - ends[0], t = (a - ends[0]) / width;
  f[0] = t >= 1, f[1] = f[2] = 0;
  if (t > 0 && t < 1)
    f[0] = t * t * (3 - 2 * t), f[1] = 6 * t * (1 - t) / width, f[2] = (6 - 12 * t) / (width * width);
}

static inline double dot(const double *a, const double *b)
{
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline void cross(const double *a, const double *b, double *c)
{
  for (int i = 0; i < 3; ++i)
  {
    int j = (i + 1) % 3, k = (i + 2) % 3;
    c[i] = a[j] * b[k] - a[k] * b[j];
  }
}

// a · (b × c)
static inline double triple(const double *a, const double *b, const double *c)
{
  return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2])
         + a[2] * (b[0] * c[1] - b[1] * c[0]);
}

static inline void minus(const double *a, const double *b, double *c)
{
  for (int i = 0; i < 3; ++i)
    c[i] = a[i] - b[i];
}

#endif
