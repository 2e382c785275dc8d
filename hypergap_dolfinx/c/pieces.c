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
#include "polygons.h"
#include "space.h"
#include "vectors.h"

#define ROUND 1.001 // squares of distances over those at which balls meet: round-off

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
  Point y[MOST_CUT], X[MOST_CORNERS];
  int edge[MOST_CUT];
  memcpy(y, look->own[part], PART * sizeof(Point));
  int count = intersect(y, edge, start_part(edge), look->below->num_corners, by, PART, 0);
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
      map_to(look->own[part], look->parts + PART * part, look->last, y[k], NULL, X[k]);
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
    see(look->dual, x, by[k]);
  }
  for (int k = 0; k < look->above->num_corners; ++k)
    if (boxes_meet(num, by, PART, look->own[k]))
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
        see(look.dual, x, own[k][c]);
      }
      look.whole += fabs(area_of(PART, own[k]));
    }
    look_at(&look, 0, below->num_facets, balls);
  }
  free(balls);
  return DONE;
}
