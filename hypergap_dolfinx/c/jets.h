// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Jets: values with their derivatives by n variables, up to the second ones, and their arithmetic.

#ifndef HYPERGAP_JETS_H
#define HYPERGAP_JETS_H

#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#define JETS_OF_BLOCK 64

// A value, n first derivatives, and the lower triangle of the second ones, row by row.
typedef double *Jet;

// Memory for jets; they are all given back at once. It grows in blocks, so jets stay where they are.
typedef struct {
  int n, order; // of variables, and of the derivatives that are computed: 0, 1 or 2
  size_t size;  // of a jet
  size_t used;  // number of jets
  size_t room;  // of a jet in the blocks, at least ``size``
  size_t num_blocks;
  double **blocks;
  int failed; // whether there was no memory for a jet: the values of all are invalid
} Tape;

static inline size_t jet_size(int n, int order)
{
  return 1 + (order > 0 ? n : 0) + (order > 1 ? n * (n + 1) / 2 : 0);
}

static int add_block(Tape *tape)
{
  double **blocks = realloc(tape->blocks, (tape->num_blocks + 1) * sizeof(double *));
  if (!blocks)
    return 0;
  tape->blocks = blocks;
  blocks[tape->num_blocks] = malloc(JETS_OF_BLOCK * tape->room * sizeof(double));
  return blocks[tape->num_blocks] && ++tape->num_blocks;
}

static void close_tape(Tape *tape)
{
  for (size_t k = 0; k < tape->num_blocks; ++k)
    free(tape->blocks[k]);
  free(tape->blocks);
  *tape = (Tape){0};
}

// Give all jets back, for others in n variables. Returns 0 without memory, now or before.
static int start_tape(Tape *tape, int n, int order)
{
  size_t size = jet_size(n, order);
  if (tape->failed)
    return 0;
  if (size > tape->room)
  {
    close_tape(tape);
    tape->room = size;
  }
  tape->n = n, tape->order = order, tape->size = size, tape->used = 0;
  return tape->num_blocks || add_block(tape);
}

// Without memory it is any jet of the tape, which has ``failed`` then.
static inline Jet new_jet(Tape *tape)
{
  size_t block = tape->used / JETS_OF_BLOCK;
  if (block == tape->num_blocks && !add_block(tape))
    tape->failed = 1, tape->used = block = 0;
  return tape->blocks[block] + tape->size * (tape->used++ % JETS_OF_BLOCK);
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

static inline Jet scaled(Tape *tape, double alpha, const double *a)
{
  Jet jet = new_jet(tape);
  for (size_t k = 0; k < tape->size; ++k)
    jet[k] = alpha * a[k];
  return jet;
}

// Add factor (∂a ⊗ ∂b + ∂b ⊗ ∂a) to second derivatives.
static inline void add_outer(const Tape *tape, double factor, const double *a, const double *b,
                             Jet jet)
{
  double *second = jet + 1 + tape->n;
  for (int i = 1; tape->order > 1 && i <= tape->n; ++i)
    for (int j = 1; j <= i; ++j)
      *second++ += factor * (a[i] * b[j] + b[i] * a[j]);
}

static inline Jet product(Tape *tape, const double *a, const double *b)
{
  Jet jet = combined(tape, a[0], b, b[0], a);
  jet[0] = a[0] * b[0];
  add_outer(tape, 1, a, b, jet);
  return jet;
}

// f(a), from the value of f and its two derivatives
static inline Jet composed(Tape *tape, const double *a, const double *f)
{
  Jet jet = scaled(tape, f[1], a);
  jet[0] = f[0];
  add_outer(tape, 0.5 * f[2], a, a, jet);
  return jet;
}

static inline Jet quotient(Tape *tape, const double *a, const double *b)
{
  double inverse = 1 / b[0], square = inverse * inverse;
  return product(tape, a, composed(tape, b, (double[]){inverse, -square, 2 * square * inverse}));
}

#endif
