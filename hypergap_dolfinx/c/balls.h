// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Balls around runs of facets, halved and halved again.

#ifndef HYPERGAP_BALLS_H
#define HYPERGAP_BALLS_H

#include <math.h>

#include "vectors.h"

// Make the ball around a run of facets, and behind it those of both halves.
//
// num       corners of a facet
// vertices  of each, (num_facets, num)
// x         (num_vertices, 3)
// order     facets along a curve that fills space
static inline void put_balls(int num, const int *vertices, const double *x, const int *order,
                             int start, int end, Ball *ball)
{
  double e[3];
  int half = (start + end) / 2;
  *ball = (Ball){{0}, 0};
  if (half == start)
  {
    const int *v = vertices + num * order[start];
    for (int k = 0; k < num; ++k)
      for (int i = 0; i < 3; ++i)
        ball->middle[i] += x[3 * v[k] + i] / num;
    for (int k = 0; k < num; ++k)
    {
      minus(x + 3 * v[k], ball->middle, e);
      ball->radius = larger(ball->radius, sqrt(dot(e, e)));
    }
    return;
  }
  Ball *halves[2] = {ball + 1, ball + 2 * (half - start)};
  put_balls(num, vertices, x, order, start, half, halves[0]);
  put_balls(num, vertices, x, order, half, end, halves[1]);
  for (int i = 0; i < 3; ++i)
    ball->middle[i] = (halves[0]->middle[i] + halves[1]->middle[i]) / 2;
  for (int k = 0; k < 2; ++k)
  {
    minus(halves[k]->middle, ball->middle, e);
    ball->radius = larger(ball->radius, sqrt(dot(e, e)) + halves[k]->radius);
  }
}

#endif
