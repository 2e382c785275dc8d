// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Jets: values with their derivatives by n variables, up to the second ones, and their arithmetic.

#ifndef HYPERGAP_JETS_H
#define HYPERGAP_JETS_H

#include <stddef.h>
#include <string.h>

// A value, n first derivatives, and the lower triangle of the second ones, row by row.
typedef double *Jet;

// Memory for jets; they are all given back at once.
typedef struct {
  int n, order; // of variables, and of the derivatives that are computed: 0, 1 or 2
  size_t size;  // of a jet
  double *memory;
  size_t used;
} Tape;

static inline size_t jet_size(int n, int order)
{
  return 1 + (order > 0 ? n : 0) + (order > 1 ? n * (n + 1) / 2 : 0);
}

static inline Jet new_jet(Tape *tape)
{
  Jet jet = tape->memory + tape->used;
  tape->used += tape->size;
  return jet;
}

static inline Jet constant(Tape *tape, double value)
{
  Jet jet = new_jet(tape);
  memset(jet, 0, tape->size * sizeof(double));
  jet[0] = value;
  return jet;
}

// α a + β b
static inline Jet combined(Tape *tape, double alpha, const double *a, double beta, const double *b)
{
  Jet jet = new_jet(tape);
  for (size_t k = 0; k < tape->size; ++k)
    jet[k] = alpha * a[k] + beta * b[k];
  return jet;
}

static inline Jet product(Tape *tape, const double *a, const double *b)
{
  int n = tape->n;
  Jet jet = new_jet(tape);
  for (size_t k = 1; k < tape->size; ++k)
    jet[k] = a[0] * b[k] + b[0] * a[k];
  jet[0] = a[0] * b[0];
  if (tape->order > 1)
  {
    double *second = jet + 1 + n;
    for (int i = 1; i <= n; ++i)
      for (int j = 1; j <= i; ++j)
        *second++ += a[i] * b[j] + b[i] * a[j];
  }
  return jet;
}

// f(a), from the value of f and its two derivatives
static inline Jet composed(Tape *tape, const double *a, const double *f)
{
  int n = tape->n;
  Jet jet = new_jet(tape);
  for (size_t k = 1; k < tape->size; ++k)
    jet[k] = f[1] * a[k];
  jet[0] = f[0];
  if (tape->order > 1)
  {
    double *second = jet + 1 + n;
    for (int i = 1; i <= n; ++i)
      for (int j = 1; j <= i; ++j)
        *second++ += f[2] * a[i] * a[j];
  }
  return jet;
}

static inline Jet quotient(Tape *tape, const double *a, const double *b)
{
  double inverse = 1 / b[0], square = inverse * inverse;
  return product(tape, a, composed(tape, b, (double[]){inverse, -square, 2 * square * inverse}));
}

#endif
