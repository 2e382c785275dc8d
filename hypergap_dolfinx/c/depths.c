// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Depths of points in a body by what of its surface is nearest (contact_geometry/sheets.py).

#include <math.h>
#include <stdlib.h>

#include "balls.h"
#include "space.h"
#include "vectors.h"

#define SAME 1e-12 // relative difference of distances that are one: round-off

// What is nearest to a point as far as is known.
typedef struct {
  const double *x, *point; // corners of triangles, (num, 3, 3)
  const int *order;
  double nearest, inside;  // distance, and that from the triangle's plane, positive inside
} Nearest;

// Distance from a triangle, and that from its plane.
static double triangle_distance(const double *x, const double *point, double *inside)
{
  double e[3][3], d[3][3], n[3], w[3], least = INFINITY;
  int within = 1;
  for (int k = 0; k < 3; ++k)
  {
    minus(x + 3 * ((k + 1) % 3), x + 3 * k, e[k]);
    minus(point, x + 3 * k, d[k]);
  }
  cross(e[0], e[1], n);
  *inside = -dot(n, d[0]) / fmax(sqrt(dot(n, n)), 1e-300);
  for (int k = 0; k < 3; ++k)
  {
    cross(e[k], d[k], w);
    within &= dot(w, n) >= 0;
    double t = smaller(larger(dot(d[k], e[k]) / fmax(dot(e[k], e[k]), 1e-300), 0), 1), r[3];
    for (int i = 0; i < 3; ++i)
      r[i] = d[k][i] - t * e[k][i];
    least = smaller(least, sqrt(dot(r, r)));
  }
  return within ? fabs(*inside) : least;
}

static void look_for(Nearest *found, int start, int end, const Ball *ball)
{
  double apart[3];
  minus(found->point, ball->middle, apart);
  if (sqrt(dot(apart, apart)) - ball->radius > (1 + SAME) * found->nearest)
    return;
  int half = (start + end) / 2;
  if (half == start)
  {
    double inside, far = triangle_distance(found->x + 9 * found->order[start], found->point, &inside);
    // At edges and corners the side on which the point is is that of the plane farthest away
    if (far < (1 - SAME) * found->nearest
        || (far <= (1 + SAME) * found->nearest && fabs(inside) > fabs(found->inside)))
      found->nearest = far, found->inside = inside;
    return;
  }
  const Ball *halves[2] = {ball + 1, ball + 2 * (half - start)};
  double far[2];
  for (int k = 0; k < 2; ++k)
  {
    minus(found->point, halves[k]->middle, apart);
    far[k] = dot(apart, apart);
  }
  for (int k = 0, second = far[1] < far[0]; k < 2; ++k, second = !second)
    look_for(found, second ? half : start, second ? end : half, halves[second]);
}

// Depths of points in the body whose surface triangles are, negative outside.
//
// x       corners, counterclockwise from outside, (num_triangles, 3, 3)
// order   the triangles along a curve that fills space
// points  (num, 3)
int find_depths(int num_triangles, const double *x, const int *order, int num,
                const double *points, double *depths)
{
  int *vertices = malloc(3 * (size_t)num_triangles * sizeof(int));
  Ball *balls = malloc((2 * (size_t)num_triangles + 1) * sizeof(Ball));
  int can = vertices && balls;
  for (int k = 0; can && k < 3 * num_triangles; ++k)
    vertices[k] = k;
  if (can)
    put_balls(3, vertices, x, order, 0, num_triangles, balls);
  for (int p = 0; can && p < num; ++p)
  {
    Nearest found = {x, points + 3 * p, order, INFINITY, 0};
    look_for(&found, 0, num_triangles, balls);
    depths[p] = found.inside < 0 ? -found.nearest : found.nearest;
  }
  free(vertices), free(balls);
  return can ? DONE : NO_MEMORY;
}
