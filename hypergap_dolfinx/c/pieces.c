// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Pieces of Γ1's facets in space opposite facets of Γ0 (contact_geometry/opposite.py).

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "balls.h"
#include "heights.h"
#include "space.h"
#include "vectors.h"

#define PART 4        // corners of a part of a facet
#define QUAD_STEPS 20 // of Newton's method in a quadrilateral
#define ROUND 1.001   // squares of distances over those at which balls meet: round-off
#define BEYOND 0.01   // how far beyond it the map between quadrilaterals still has an inverse

typedef double Point[2];

static double area_of(int num, const Point *y)
{
  double sum = 0;
  for (int k = 1; k + 1 < num; ++k)
    sum += (y[k][0] - y[0][0]) * (y[k + 1][1] - y[0][1])
           - (y[k][1] - y[0][1]) * (y[k + 1][0] - y[0][0]);
  return 0.5 * sum;
}

// Cut a part with a convex polygon, both counterclockwise.
//
// y       corners of the part, then of what is left
// edge    which edge each edge is on, the polygon's numbered behind the part's own
// Returns the number of corners that are left.
static int clip(Point *y, int *edge, int num, const Point *by)
{
  int count = PART;
  for (int k = 0; k < PART; ++k)
    edge[k] = k;
  for (int k = 0; k < num && count; ++k)
  {
    const double *start = by[k], *end = by[(k + 1) % num];
    double d[MOST_CORNERS];
    Point old[MOST_CORNERS];
    int labels[MOST_CORNERS], left = 0;
    memcpy(old, y, count * sizeof(Point));
    memcpy(labels, edge, count * sizeof(int));
    for (int i = 0; i < count; ++i)
      d[i] = (end[0] - start[0]) * (y[i][1] - start[1]) - (end[1] - start[1]) * (y[i][0] - start[0]);
    for (int i = 0; i < count; ++i)
    {
      int after = (i + 1) % count, inside = d[i] >= 0;
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
      edge[left++] = inside ? PART + k : labels[i];
    }
    count = left;
  }
  return count;
}

// Coefficients of the bilinear map to a quadrilateral.
static void bilinear(const Point *v, double c[4][2])
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
static void map_to(const Point *quad, const Point *other, double last, const double *y, double *X)
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
  bilinear(other, c);
  for (int i = 0; i < 2; ++i)
    X[i] = c[0][i] + c[1][i] * s[0] + c[2][i] * s[1] + c[3][i] * s[0] * s[1];
}

// A point in the plane across the normal of a facet of Γ1.
static void project_to(const double *dual, const double *x, double *y)
{
  y[0] = dot(dual, x), y[1] = dot(dual + 3, x);
}

// True if the boxes around a polygon and a part overlap by more than a side.
static int boxes_meet(int num, const Point *a, const Point *part)
{
  for (int i = 0; i < 2; ++i)
  {
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (int k = 0; k < num; ++k)
      low[0] = smaller(low[0], a[k][i]), high[0] = larger(high[0], a[k][i]);
    for (int k = 0; k < PART; ++k)
      low[1] = smaller(low[1], part[k][i]), high[1] = larger(high[1], part[k][i]);
    if (high[0] <= low[1] || low[0] >= high[1])
      return 0;
  }
  return 1;
}

// A facet of Γ1 that looks along its normal at Γ0.
typedef struct {
  const Facets *below, *above;
  const int *order;             // Γ0's facets along a curve that fills space
  const double *normals;        // unit normals of Γ0's facets
  const Ball *balls;            // around runs of them, halved and halved again
  const Point *parts;           // of Γ1's reference facet, one for each vertex, (num_corners, PART)
  double leans, sliver, last;   // as for find_pieces
  int facet;
  const double *origin, *dual;  // of its plane
  double axis[3], reach, whole; // its unit normal, the radius around it, and its area there
  Point (*own)[PART];           // the parts as they are seen
  Pieces *pieces;
} Look;

// Add a piece, unless its area is zero.
//
// by    corners of Γ0's facet as they are seen
static void add_piece(const Look *look, int f0, int part, const Point *by)
{
  Pieces *pieces = look->pieces;
  Point y[MOST_CORNERS], X[MOST_CORNERS];
  int edge[MOST_CORNERS];
  memcpy(y, look->own[part], PART * sizeof(Point));
  int count = clip(y, edge, look->below->num_corners, by);
  if (count < 3 || !(area_of(count, y) > look->sliver * look->whole))
    return;
  int n = pieces->num++;
  if (n >= pieces->max)
    return;
  for (int k = 0; k < count; ++k)
    if (look->above->num_terms == 3) // the map is affine
      for (int i = 0; i < 2; ++i)
        X[k][i] = look->above->middle[i] + y[k][i];
    else
      map_to(look->own[part], look->parts + PART * part, look->last, y[k], X[k]);
  pieces->facets[0][n] = f0, pieces->facets[1][n] = look->facet;
  pieces->part[n] = part, pieces->count[n] = count;
  for (int k = 0; k < MOST_CORNERS; ++k)
  {
    int i = k < count ? k : count - 1, at = MOST_CORNERS * n + k;
    pieces->edge[at] = edge[i];
    memcpy(pieces->y + 2 * at, y[i], sizeof(Point));
    memcpy(pieces->X + 2 * at, X[i], sizeof(Point));
  }
}

// Find the pieces opposite a facet of Γ0.
static void look_at_facet(const Look *look, int f0)
{
  int num = look->below->num_corners;
  const int *vertices = look->below->vertices + num * f0;
  Point by[num];
  double x[3];
  if (!(dot(look->axis, look->normals + 3 * f0) < -look->leans))
    return;
  for (int k = 0; k < num; ++k) // seen from the other side
  {
    minus(look->below->x + 3 * vertices[num - 1 - k], look->origin, x);
    project_to(look->dual, x, by[k]);
  }
  for (int k = 0; k < look->above->num_corners; ++k)
    if (boxes_meet(num, by, look->own[k]))
      add_piece(look, f0, k, by);
}

// Find the pieces opposite a run of facets of Γ0: its ball comes first, then those of both halves.
static void look_at(const Look *look, int start, int end, const Ball *ball)
{
  double apart[3];
  minus(ball->middle, look->origin, apart);
  double along = dot(apart, look->axis), beyond = look->reach + ball->radius;
  if (dot(apart, apart) - along * along > ROUND * beyond * beyond)
    return;
  int half = (start + end) / 2;
  if (half == start)
    look_at_facet(look, look->order[start]);
  else
  {
    look_at(look, start, half, ball + 1);
    look_at(look, half, end, ball + 2 * (half - start));
  }
}

// Find the pieces.
//
// order     Γ0's facets along a curve that fills space
// normals   unit normals of Γ0's facets, (num_facets0, 3)
// planes    across the normals of Γ1's facets: origins, dual bases and unit normals,
//           (num_facets1, 4, 3)
// reach     how far these facets reach from there, (num_facets1)
// parts     of Γ1's reference facet, one for each vertex, (num_corners, 4, 2)
// leans     cosine between normals from which facets face each other
// sliver    area over the facet's, treated as zero up to this
// last      step of Newton's method after which none is needed
int find_pieces(const Facets *sides, const int *order, const double *normals, const double *planes,
                const double *reach, const double *parts, double leans, double sliver, double last,
                Pieces *pieces)
{
  const Facets *below = sides, *above = sides + 1;
  int num_parts = above->num_corners;
  Point own[num_parts][PART];
  Ball *balls = malloc((2 * (size_t)below->num_facets + 1) * sizeof(Ball));
  if (!balls)
    return NO_MEMORY;
  put_balls(below->num_corners, below->vertices, below->x, order, 0, below->num_facets, balls);
  Look look = {.below = below,
               .above = above,
               .order = order,
               .normals = normals,
               .balls = balls,
               .parts = (const Point *)parts,
               .leans = leans,
               .sliver = sliver,
               .last = last,
               .own = own,
               .pieces = pieces};
  pieces->num = 0;
  for (int f = 0; f < above->num_facets; ++f, planes += 12)
  {
    double x[3], away[3];
    look.facet = f, look.origin = planes, look.dual = planes + 3, look.reach = reach[f];
    look.whole = 0;
    memcpy(look.axis, planes + 9, sizeof(look.axis));
    minus(above->origins + 3 * f, look.origin, away);
    for (int k = 0; k < num_parts; ++k)
    {
      for (int c = 0; c < PART; ++c)
      {
        jet_on(above, f, parts + 2 * (PART * k + c), 1, &x);
        for (int i = 0; i < 3; ++i)
          x[i] += away[i];
        project_to(look.dual, x, own[k][c]);
      }
      look.whole += fabs(area_of(PART, own[k]));
    }
    look_at(&look, 0, below->num_facets, balls);
  }
  free(balls);
  return DONE;
}
