// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Jets: values with their derivatives by n variables, and their arithmetic.
//
// Second derivatives are found backwards: steps are recorded, and each passes the derivatives of the
// result by what it made, with those of these by the variables, on to what it made it of.

#ifndef HYPERGAP_JETS_H
#define HYPERGAP_JETS_H

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "vectors.h"

#define JETS_OF_BLOCK 64

// A value and n derivatives; behind them, for second ones, its adjoint: the same of the derivative
// of the result by it.
typedef double *Jet;

enum { COMBINED, PRODUCT, COMPOSED, PLACED };

// A step from jets a and b, or NULL, to another one.
typedef struct {
  int kind;
  Jet to;
  const double *a, *b;
  double alpha, beta; // factors, or derivatives of a function
  // PLACED: see placed()
  int num, stride, component;
  const int *numbers;
  const double *given;
} Step;

// Memory for jets; they are all given back at once. It grows in blocks, so jets stay where they are.
typedef struct {
  int n, order; // of variables, and of the derivatives that are computed: 0, 1 or 2
  size_t size;  // of a jet without its adjoint
  size_t used;  // number of jets
  size_t room;  // of a jet in the blocks, at least what it needs
  size_t num_blocks;
  double **blocks;
  size_t num_steps, most_steps;
  Step *steps;
  double *second; // derivatives, (n, n)
  int failed; // whether there was no memory for a jet: the values of all are invalid
} Tape;

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
  free(tape->blocks), free(tape->steps), free(tape->second);
  *tape = (Tape){0};
}

// A square of zeros for sums of second derivatives; 0 without memory.
static int clear_square(Tape *tape)
{
  free(tape->second);
  tape->second = calloc((size_t)tape->n * tape->n, sizeof(double));
  tape->failed = !tape->second;
  return !tape->failed;
}

// Give all jets back, for others in n variables. Returns 0 without memory, now or before.
static int start_tape(Tape *tape, int n, int order)
{
  size_t size = order > 0 ? 1 + n : 1, room = order > 1 ? 2 * size : size;
  if (tape->failed)
    return 0;
  if (room > tape->room)
  {
    close_tape(tape);
    tape->room = room;
  }
  tape->n = n, tape->order = order, tape->size = size, tape->used = tape->num_steps = 0;
  if (order > 1 && !clear_square(tape))
    return 0;
  return tape->num_blocks || add_block(tape);
}

// Without memory it is any jet of the tape, which has ``failed`` then.
static inline Jet new_jet(Tape *tape)
{
  size_t block = tape->used / JETS_OF_BLOCK;
  if (block == tape->num_blocks && !add_block(tape))
    tape->failed = 1, tape->used = block = 0;
  Jet jet = tape->blocks[block] + tape->room * (tape->used++ % JETS_OF_BLOCK);
  if (tape->order > 1)
    memset(jet + tape->size, 0, tape->size * sizeof(double));
  return jet;
}

static inline double *adjoint(const Tape *tape, const double *jet)
{
  return (double *)jet + tape->size;
}

static void record(Tape *tape, Step step)
{
  if (tape->num_steps == tape->most_steps)
  {
    Step *steps = realloc(tape->steps, (2 * tape->most_steps + 256) * sizeof(Step));
    tape->failed |= !steps;
    if (!steps)
      return;
    tape->steps = steps, tape->most_steps = 2 * tape->most_steps + 256;
  }
  tape->steps[tape->num_steps++] = step;
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
  if (tape->order > 1)
    record(tape, (Step){.kind = COMBINED, .to = jet, .a = a, .b = b, .alpha = alpha, .beta = beta});
  return jet;
}

static inline Jet scaled(Tape *tape, double alpha, const double *a)
{
  Jet jet = new_jet(tape);
  for (size_t k = 0; k < tape->size; ++k)
    jet[k] = alpha * a[k];
  if (tape->order > 1)
    record(tape, (Step){.kind = COMBINED, .to = jet, .a = a, .alpha = alpha});
  return jet;
}

static inline Jet product(Tape *tape, const double *a, const double *b)
{
  Jet jet = new_jet(tape);
  jet[0] = a[0] * b[0];
  for (size_t k = 1; k < tape->size; ++k)
    jet[k] = a[0] * b[k] + b[0] * a[k];
  if (tape->order > 1)
    record(tape, (Step){.kind = PRODUCT, .to = jet, .a = a, .b = b});
  return jet;
}

// f(a), from the value of f and its two derivatives
static inline Jet composed(Tape *tape, const double *a, const double *f)
{
  Jet jet = new_jet(tape);
  jet[0] = f[0];
  for (size_t k = 1; k < tape->size; ++k)
    jet[k] = f[1] * a[k];
  if (tape->order > 1)
    record(tape, (Step){.kind = COMPOSED, .to = jet, .a = a, .alpha = f[1], .beta = f[2]});
  return jet;
}

// A coordinate of a point of a surface, or of its derivative: a function of up to two jets s, and
// linear in the coordinate's variables, each with a function of s.
//
// f        value, derivatives by s, second ones by s₁, s₁ and s₂, s₂
// numbers  of the variables, each ``stride`` of which ``component`` is the coordinate's, (num)
// N        values of their functions, derivatives by s, (1 + num_s, num)
static Jet placed(Tape *tape, int num_s, Jet const *s, const double *f, int num,
                  const int *numbers, int stride, int component, const double *const *N)
{
  Jet jet = constant(tape, f[0]);
  if (tape->order < 1)
    return jet;
  for (int k = 0; k < num_s; ++k)
    for (size_t v = 1; v < tape->size; ++v)
      jet[v] += f[1 + k] * s[k][v];
  for (int a = 0; a < num; ++a)
    jet[1 + stride * numbers[a] + component] += N[0][a];
  if (tape->order > 1)
  { // a jet has room for that: there are at least as many variables as functions
    double *given = new_jet(tape);
    memcpy(given, f + 1, (num_s > 1 ? 5 : 2) * (num_s > 0) * sizeof(double));
    for (int k = 0; k <= num_s; ++k)
      memcpy(given + 5 + k * num, N[k], num * sizeof(double));
    record(tape, (Step){PLACED, jet, num_s > 0 ? s[0] : NULL, num_s > 1 ? s[1] : NULL, 0, 0, num,
                        stride, component, numbers, given});
  }
  return jet;
}

static void sweep_placed(Tape *tape, const Step *step, const double *t)
{
  const double *s[2] = {step->a, step->b}, *f = step->given;
  int n = tape->n, num_s = (s[0] != NULL) + (s[1] != NULL);
  const double second[2][2] = {{f[num_s > 1 ? 2 : 1], f[3]}, {f[3], f[4]}};
  for (int k = 0; k < num_s; ++k)
  {
    double *by = adjoint(tape, s[k]);
    for (int v = 0; v <= n; ++v)
      by[v] += f[k] * t[v];
    for (int l = 0; l < num_s; ++l)
      for (int v = 1; v <= n; ++v)
        by[v] += t[0] * second[k][l] * s[l][v];
  }
  for (int a = 0; a < step->num; ++a)
  {
    int v = step->stride * step->numbers[a] + step->component;
    const double *N = f + 5 + a;
    double *row = tape->second + (size_t)n * v;
    for (int w = 0; w < n; ++w)
      row[w] += N[0] * t[1 + w];
    for (int k = 0; k < num_s; ++k)
    {
      double slope = t[0] * N[(1 + k) * step->num];
      adjoint(tape, s[k])[1 + v] += slope;
      for (int w = 0; w < n; ++w)
        row[w] += slope * s[k][1 + w];
    }
  }
}

// Go back over steps to one of them: adjoints of what they made are known. Second derivatives of
// the result are complete when that is the first one; they are symmetric to round-off.
static void sweep(Tape *tape, size_t first)
{
  size_t size = tape->size;
  while (tape->num_steps > first)
  {
    const Step *step = tape->steps + --tape->num_steps;
    const double *x = step->a, *y = step->b, *t = adjoint(tape, step->to);
    double *a = x ? adjoint(tape, x) : NULL, *b = y ? adjoint(tape, y) : NULL;
    if (step->kind == PLACED)
      sweep_placed(tape, step, t);
    else if (step->kind == PRODUCT)
    {
      a[0] += y[0] * t[0], b[0] += x[0] * t[0];
      for (size_t k = 1; k < size; ++k)
        a[k] += y[k] * t[0] + y[0] * t[k], b[k] += x[k] * t[0] + x[0] * t[k];
    }
    else if (step->kind == COMPOSED)
    {
      a[0] += step->alpha * t[0];
      for (size_t k = 1; k < size; ++k)
        a[k] += step->alpha * t[k] + step->beta * t[0] * x[k];
    }
    else
    {
      for (size_t k = 0; k < size; ++k)
        a[k] += step->alpha * t[k];
      for (size_t k = 0; y && k < size; ++k)
        b[k] += step->beta * t[k];
    }
  }
}

static inline Jet quotient(Tape *tape, const double *a, const double *b)
{
  double inverse = 1 / b[0], square = inverse * inverse;
  return product(tape, a, composed(tape, b, (double[]){inverse, -square, 2 * square * inverse}));
}

static inline Jet power(Tape *tape, const double *a, double n)
{
  double f = n == 0.5 ? sqrt(a[0]) : n == -0.5 ? 1 / sqrt(a[0]) : pow(a[0], n);
  return composed(tape, a, (double[]){f, n * f / a[0], n * (n - 1) * f / (a[0] * a[0])});
}

// a × b
static inline Jet wedge(Tape *tape, Jet const *a, Jet const *b)
{
  return combined(tape, 1, product(tape, a[0], b[1]), -1, product(tape, a[1], b[0]));
}

// A smooth step from 0 to 1 between two values
static inline Jet step_of(Tape *tape, const double *a, const double *ends)
{
  double f[3];
  smooth_step(a[0], ends, f);
  return composed(tape, a, f);
}

#endif
