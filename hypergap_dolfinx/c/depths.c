// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Depths of points in a body by what of its surface is nearest (contact_geometry/sheets.py).

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "depths.h"
#include "vectors.h"

#define SAME 1e-12 // relative difference of distances that are one: round-off

// Distance from a triangle; that from its plane; and what of it is nearest.
static double triangle_distance(const double *x, const double *point, double *inside, int *corners)
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
    double far = sqrt(dot(r, r));
    if (!(far < least))
      continue;
    least = far;
    corners[0] = t < 1 ? k : (k + 1) % 3, corners[1] = t > 0 ? (k + 1) % 3 : k;
  }
  if (within)
    corners[0] = -1;
  return within ? fabs(*inside) : least;
}

// Whether a facet g of Γ0 can meet a facet f of Γ1.
static int can_meet(const Own *own, int f, int g)
{
  if (!own)
    return 1;
  for (int k = own->first[f]; k < own->first[f + 1]; ++k)
    if (own->near[k] == g)
      return 0;
  return own->turn[g] < own->turn[f];
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
    const Body *body = found->body;
    int corners[2], triangle = body->order[start];
    if (!can_meet(body->own, found->facet, triangle / body->triangles_a_facet))
      return;
    double inside, far = triangle_distance(body->x + 9 * triangle, found->point, &inside, corners);
    // At edges and corners the side on which the point is is that of the plane farthest away
    if (far < (1 - SAME) * found->nearest
        || (far <= (1 + SAME) * found->nearest && fabs(inside) > fabs(found->inside)))
    {
      found->nearest = far, found->inside = inside, found->triangle = triangle;
      memcpy(found->corners, corners, sizeof(corners));
    }
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

int open_body(Body *body)
{
  int num = body->num_triangles;
  int *vertices = malloc(3 * (size_t)num * sizeof(int));
  body->balls = malloc((2 * (size_t)num + 1) * sizeof(Ball));
  int can = vertices && body->balls;
  for (int k = 0; can && k < 3 * num; ++k)
    vertices[k] = k;
  if (can)
    put_balls(3, vertices, body->x, body->order, 0, num, body->balls);
  free(vertices);
  return can;
}

Nearest nearest_of(const Body *body, const double *point, int facet)
{
  Nearest found = {.body = body, .point = point, .facet = facet, .nearest = INFINITY};
  look_for(&found, 0, body->num_triangles, body->balls);
  return found;
}

// Shares of the corners of the nearest triangle in the place that is nearest.
static void find_shares(const Nearest *found, double *shares)
{
  const double *x = found->body->x + 9 * found->triangle;
  double e[3][3], d[3][3], n[3], w[3];
  for (int k = 0; k < 3; ++k)
  {
    minus(x + 3 * ((k + 1) % 3), x + 3 * k, e[k]);
    minus(found->point, x + 3 * k, d[k]);
    shares[k] = 0;
  }
  cross(e[0], e[1], n);
  int a = found->corners[0], b = found->corners[1];
  for (int k = 0; k < 3 && a < 0; ++k)
  {
    cross(e[k], d[k], w);
    shares[(k + 2) % 3] = dot(w, n) / dot(n, n);
  }
  if (a >= 0)
  { // the ends of an edge, or one corner twice
    shares[b] = a == b ? 1 : dot(d[a], e[a]) / dot(e[a], e[a]);
    shares[a] = 1 - (a == b ? 0 : shares[b]);
  }
}

// Depths of points in the body whose surface triangles are, negative outside.
//
// x       corners, counterclockwise from outside, (num_triangles, 3, 3)
// order   the triangles along a curve that fills space
// own     which facets of Γ0 count, NULL: all
// points  (num, 3)
// facets  of Γ1, on which they are, (num)
// nearest the triangle nearest to each, (num), or NULL
// shares  of its corners in the nearest place, (num, 3)
int find_depths(int num_triangles, const double *x, const int *order, int triangles_a_facet,
                const Own *own, int num, const double *points, const int *facets, double *depths,
                int *nearest, double *shares)
{
  Body body = {num_triangles, x, order, triangles_a_facet, own, NULL};
  int can = open_body(&body);
  for (int p = 0; can && p < num; ++p)
  {
    Nearest found = nearest_of(&body, points + 3 * p, facets[p]);
    depths[p] = depth_by(found);
    if (!nearest)
      continue;
    nearest[p] = found.triangle;
    find_shares(&found, shares + 3 * p);
  }
  free(body.balls);
  return can ? DONE : NO_MEMORY;
}
