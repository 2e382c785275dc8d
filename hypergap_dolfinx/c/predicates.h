// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Predicates: what four vertices of Σ make, seen along the mean of their normals.

#ifndef HYPERGAP_PREDICATES_H
#define HYPERGAP_PREDICATES_H

#include "vectors.h"

#define FLAT 1e-9       // least D of a valid cell, over the product of its edges on the surfaces
#define COLLINEAR 1e-12 // the same for A of a triangle

typedef struct {
  double x[3]; // where it is
  double y[3]; // where predicates of the order see it: off x by what tells ties apart
  double n[3]; // normal, from the start to the end
  double w;    // weight
} Vertex;

// The vertices of both surfaces: the start's first, then the end's.
typedef struct {
  int n0, n; // of the start, and all
  const Vertex *vertex;
  double flat; // D of a cell over that product up to which a front does without it
} Points;

static inline void unit_sum(const double *a, const double *b, const double *c, const double *d,
                            double *n)
{
  for (int i = 0; i < 3; ++i)
    n[i] = a[i] + b[i] + c[i] + d[i];
  double length = sqrt(dot(n, n));
  for (int i = 0; i < 3; ++i)
    n[i] /= length > 0 ? length : 1;
}

// D(a,b,c,d) = Σ_k dα_k (e_{k+1} × e_{k+2}) · n, with edges e_k from a and n the mean normal:
// positive if the cell is not inverted. Relative to the lengths of its two edges on the surfaces; of
// a cell with a base on one, D is the base's area, which may be as small as it is.
static inline double D(const Points *p, int a, int b, int c, int d, const double *n, double *scale)
{
  const Vertex *v[4] = {p->vertex + a, p->vertex + b, p->vertex + c, p->vertex + d};
  const int on[4] = {a >= p->n0, b >= p->n0, c >= p->n0, d >= p->n0};
  double e[3][3], sum = 0;
  for (int k = 0; k < 3; ++k)
    minus(v[k + 1]->x, v[0]->x, e[k]);
  for (int k = 0; k < 3; ++k)
    if (on[k + 1] != on[0])
      sum += (on[k + 1] - on[0]) * triple(e[(k + 1) % 3], e[(k + 2) % 3], n);
  *scale = 0;
  if (on[0] + on[1] + on[2] + on[3] == 2)
    for (int k = 0; k < 3; ++k)
      if (on[k + 1] == on[0])
      {
        double other[3];
        minus(e[(k + 1) % 3], e[(k + 2) % 3], other);
        *scale = sqrt(dot(e[k], e[k]) * dot(other, other));
      }
  return sum;
}

// H(a,b,c,d) = Σ_k dh_k (e_{k+1} × e_{k+2}) · n with h = |y|² − (y · n)² + w: positive if d is above
// the plane through a, b, c, when each vertex is lifted by its h.
static inline double H(const Vertex **v, const double *n)
{
  double e[3][3], sum = 0;
  for (int k = 0; k < 3; ++k)
    minus(v[k + 1]->y, v[0]->y, e[k]);
  for (int k = 0; k < 3; ++k)
  {
    double normal = dot(e[k], n), dh = dot(e[k], e[k]) - normal * normal + v[k + 1]->w - v[0]->w;
    sum += dh * triple(e[(k + 1) % 3], e[(k + 2) % 3], n);
  }
  return sum;
}

// A(a,b,c) = (b − a) × (c − a) · n with the sum n of the vertices' normals: positive if the triangle
// is counterclockwise seen along it. Relative to the square of the longer edge from a.
static inline double A(const Points *p, int a, int b, int c, double *scale)
{
  const Vertex *u = p->vertex + a, *v = p->vertex + b, *w = p->vertex + c;
  double n[3], e[3], g[3];
  for (int i = 0; i < 3; ++i)
    n[i] = u->n[i] + v->n[i] + w->n[i];
  minus(v->y, u->y, e);
  minus(w->y, u->y, g);
  *scale = larger(dot(e, e), dot(g, g));
  return triple(e, g, n);
}

static inline int ccw(const Points *p, int a, int b, int c)
{
  double scale, area = A(p, a, b, c, &scale);
  return area > COLLINEAR * scale;
}

// Time t = H/D at which a cell is due; whether it is a valid one.
static inline int due(const Points *p, int a, int b, int c, int d, double *t)
{
  const Vertex *v[4] = {p->vertex + a, p->vertex + b, p->vertex + c, p->vertex + d};
  double n[3], scale, area;
  unit_sum(v[0]->n, v[1]->n, v[2]->n, v[3]->n, n);
  area = D(p, a, b, c, d, n, &scale);
  if (!(area > p->flat * scale))
    return 0;
  *t = H(v, n) / area;
  return isfinite(*t);
}

#endif
