// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Linear programs with few unknowns.

#include <math.h>
#include <stdlib.h>

#include "gap_mesh.h"
#include "vectors.h"

#define MOST_UNKNOWNS 4

// Maximise c · z where A z ≤ b and |z_i| ≤ bound, by Seidel's method.
//
// Constraints come one after the other. One that the best point so far violates holds with
// equality, which leaves a problem with one unknown less. Where nothing is feasible the point found
// violates some. In random order that takes a time in proportion to their number.
//
// num, A, b   number of constraints, (num, n), (num,)
int linear_program(int n, int num, const double *A, const double *b, const double *c, double bound,
                   double *z)
{
  if (n > MOST_UNKNOWNS)
    return BAD_INPUT;
  if (n == 1)
  {
    double low = -bound, high = bound;
    for (int i = 0; i < num; ++i)
      if (A[i] > 1e-12)
        high = fmin(high, b[i] / A[i]);
      else if (A[i] < -1e-12)
        low = fmax(low, b[i] / A[i]);
    z[0] = c[0] >= 0 ? high : low;
    return DONE;
  }
  double *sub = malloc(((size_t)num + 2) * n * sizeof(double)); // (constraint, unknown), then right
  if (!sub)
    return NO_MEMORY;
  double *right = sub + ((size_t)num + 2) * (n - 1);
  for (int i = 0; i < n; ++i)
    z[i] = c[i] >= 0 ? bound : -bound;
  int status = DONE;
  for (int i = 0; i < num && status == DONE; ++i)
  {
    const double *a = A + n * i;
    double value = 0, objective[MOST_UNKNOWNS], part[MOST_UNKNOWNS];
    int k = 0, rest[MOST_UNKNOWNS];
    for (int j = 0; j < n; ++j)
    {
      value += a[j] * z[j];
      k = fabs(a[j]) > fabs(a[k]) ? j : k;
    }
    if (value <= b[i] + 1e-10 || fabs(a[k]) < 1e-12)
      continue;
    // z_k = (b_i − Σ_j a_j z_j) / a_k, which is between −bound and bound too
    for (int j = 0; j < n - 1; ++j)
    {
      rest[j] = j < k ? j : j + 1;
      objective[j] = c[rest[j]] - c[k] * a[rest[j]] / a[k];
    }
    for (int l = 0; l < i + 2; ++l)
    {
      double factor = (l < i ? A[n * l + k] : l == i ? 1 : -1) / a[k];
      for (int j = 0; j < n - 1; ++j)
        sub[(n - 1) * l + j] = (l < i ? A[n * l + rest[j]] : 0) - factor * a[rest[j]];
      right[l] = (l < i ? b[l] : bound) - factor * b[i];
    }
    status = linear_program(n - 1, i + 2, sub, right, objective, bound, part);
    z[k] = b[i] / a[k];
    for (int j = 0; j < n - 1; ++j)
    {
      z[rest[j]] = part[j];
      z[k] -= part[j] * a[rest[j]] / a[k];
    }
  }
  free(sub);
  return status;
}
