// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Convex polygons in the plane across a facet's normal.

#ifndef HYPERGAP_POLYGONS_H
#define HYPERGAP_POLYGONS_H

#include <math.h>
#include <string.h>

#include "space.h"
#include "vectors.h"

#define MOST_CUT 96   // corners of a part that is cut: with two facets of any form, or many convex ones
#define PART 4        // corners of a part of a facet
#define QUAD_STEPS 20 // of Newton's method in a quadrilateral
#define BEYOND 0.01   // how far beyond it the map between quadrilaterals still has an inverse

typedef double Point[2];

static inline double area_of(int num, const Point *y)
{
  double sum = 0;
  for (int k = 1; k + 1 < num; ++k)
    sum += (y[k][0] - y[0][0]) * (y[k + 1][1] - y[0][1])
           - (y[k][1] - y[0][1]) * (y[k + 1][0] - y[0][0]);
  return 0.5 * sum;
}

// Number the edges of a part; their number.
static inline int start_part(int *edge)
{
  for (int k = 0; k < PART; ++k)
    edge[k] = k;
  return PART;
}

// Cut a polygon with a convex one, both counterclockwise.
//
// y       corners, then of what is left, (MOST_CUT)
// edge    which edge each edge is on, likewise
// by      corners of the convex one, (num)
// first   number of its first edge
// skip    bits of its edges that don't cut
// Returns the number of corners that are left, MOST_CUT + 1 if there is no room for them.
static inline int clip(Point *y, int *edge, int count, int num, const Point *by, int first, int skip)
{
  for (int k = 0; k < num && count; ++k)
  {
    if (skip >> k & 1)
      continue;
    const double *start = by[k], *end = by[(k + 1) % num];
    double d[MOST_CUT];
    Point old[MOST_CUT];
    int labels[MOST_CUT], left = 0;
    memcpy(old, y, count * sizeof(Point));
    memcpy(labels, edge, count * sizeof(int));
    for (int i = 0; i < count; ++i)
      d[i] = (end[0] - start[0]) * (y[i][1] - start[1]) - (end[1] - start[1]) * (y[i][0] - start[0]);
    for (int i = 0; i < count; ++i)
    {
      int after = (i + 1) % count, inside = d[i] >= 0;
      if (left + 2 > MOST_CUT)
        return MOST_CUT + 1;
      if (inside)
      {
        memcpy(y[left], old[i], sizeof(Point));
        edge[left++] = labels[i];
      }
      if (inside == (d[after] >= 0))
        continue;
      double share = d[i] / (d[i] - d[after]);
      for (int j = 0; j < 2; ++j)
        y[left][j] = old[i][j] + share * (old[after][j] - old[i][j]);
      edge[left++] = inside ? first + k : labels[i];
    }
    count = left;
  }
  return count;
}

// True if a polygon turns left at all corners.
static inline int is_convex(int num, const Point *y)
{
  for (int k = 0; k < num; ++k)
  {
    const double *a = y[k], *b = y[(k + 1) % num], *c = y[(k + 2) % num];
    if ((b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]) < 0)
      return 0;
  }
  return 1;
}

// What a polygon and a facet have in common, as clip: facets that are warped need not look convex.
static inline int intersect(Point *y, int *edge, int count, int num, const Point *by, int first,
                            int skip)
{
  if (num == 3 || is_convex(num, by) || !is_convex(count, y))
    return clip(y, edge, count, num, by, first, skip);
  Point own[MOST_CUT];
  int labels[MOST_CUT], left;
  memcpy(own, y, count * sizeof(Point));
  memcpy(labels, edge, count * sizeof(int));
  memcpy(y, by, num * sizeof(Point));
  for (int k = 0; k < num; ++k)
    edge[k] = MOST_CUT + k;
  left = clip(y, edge, num, count, own, 0, 0);
  for (int k = 0; k < left && left <= MOST_CUT; ++k)
    edge[k] = edge[k] < MOST_CUT ? labels[edge[k]] : first + edge[k] - MOST_CUT;
  return left;
}

// Coefficients of the bilinear map to a quadrilateral.
static inline void bilinear(const Point *v, double c[4][2])
{
  for (int i = 0; i < 2; ++i)
  {
    c[0][i] = v[0][i];
    c[1][i] = v[1][i] - v[0][i];
    c[2][i] = v[3][i] - v[0][i];
    c[3][i] = v[0][i] - v[1][i] + v[2][i] - v[3][i];
  }
}

// A point of a quadrilateral in another one, by the bilinear map between them.
//
// at   its place in the unit square, if it isn't NULL
static inline void map_to(const Point *quad, const Point *other, double last, const double *y,
                          double *at, double *X)
{
  double c[4][2], s[2] = {0.5, 0.5}, step = INFINITY;
  bilinear(quad, c);
  for (int k = 0; k < QUAD_STEPS && !(step < last); ++k)
  {
    double rest[2], p[2], q[2];
    for (int i = 0; i < 2; ++i)
    {
      rest[i] = y[i] - (c[0][i] + c[1][i] * s[0] + c[2][i] * s[1] + c[3][i] * s[0] * s[1]);
      p[i] = c[1][i] + c[3][i] * s[1];
      q[i] = c[2][i] + c[3][i] * s[0];
    }
    double det = p[0] * q[1] - p[1] * q[0];
    double moves[2] = {(rest[0] * q[1] - rest[1] * q[0]) / det,
                       (p[0] * rest[1] - p[1] * rest[0]) / det};
    for (int i = 0; i < 2; ++i)
      s[i] = fmin(fmax(s[i] + moves[i], -BEYOND), 1 + BEYOND);
    step = fmax(fabs(moves[0]), fabs(moves[1]));
  }
  if (at)
    memcpy(at, s, sizeof(s));
  bilinear(other, c);
  for (int i = 0; i < 2; ++i)
    X[i] = c[0][i] + c[1][i] * s[0] + c[2][i] * s[1] + c[3][i] * s[0] * s[1];
}

// A point in the plane across the normal of a facet of Γ1.
static inline void see(const double *dual, const double *x, double *y)
{
  y[0] = dot(dual, x), y[1] = dot(dual + 3, x);
}

// True if the boxes around two polygons overlap by more than a side.
static inline int boxes_meet(int num, const Point *a, int others, const Point *b)
{
  for (int i = 0; i < 2; ++i)
  {
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (int k = 0; k < num; ++k)
      low[0] = smaller(low[0], a[k][i]), high[0] = larger(high[0], a[k][i]);
    for (int k = 0; k < others; ++k)
      low[1] = smaller(low[1], b[k][i]), high[1] = larger(high[1], b[k][i]);
    if (high[0] <= low[1] || low[0] >= high[1])
      return 0;
  }
  return 1;
}

#endif
