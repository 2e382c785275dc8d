// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Projection of points to a triangulated surface with straight or curved triangles.

#include <math.h>
#include <stddef.h>

#include "monomials.h"
#include "surface.h"
#include "vectors.h"

#define STRAIGHT_STEPS 100 // triangles that a point may cross
#define INSIDE 1e-12       // weight below zero of a point that still lies in a triangle
#define SINGULAR 1e-6      // determinant of Newton's matrix, in squares of slopes, that is none

typedef struct {
  const double *x;
  const int *triangles, *behind; // corners, and the triangle behind each edge or −1
  const Curves *curves;          // if there are any
} Patches;

// A point's coordinates in a triangle as if it was straight.
static void on_straight(const Patches *s, int f, const double *point, double *X)
{
  const double *v = s->x + 3 * s->triangles[3 * f];
  double d[3], e[3], N[3], to_d[3], to_e[3], y[3];
  minus(s->x + 3 * s->triangles[3 * f + 1], v, d);
  minus(s->x + 3 * s->triangles[3 * f + 2], v, e);
  cross(d, e, N);
  cross(e, N, to_d);
  cross(N, d, to_e);
  double square = fmax(dot(N, N), 1e-300);
  X[0] = X[1] = 0;
  minus(point, v, y);
  for (int k = 0; k < 2; ++k) // in narrow ones the first time leaves round-off over their width
  {
    X[0] += dot(y, to_d) / square;
    X[1] += dot(y, to_e) / square;
    for (int i = 0; i < 3; ++i)
      y[i] = point[i] - (v[i] + X[0] * d[i] + X[1] * e[i]);
  }
}

// Where a place of a triangle is in its facet, and the derivatives by its coordinates.
static void in_facet(const Curves *c, int f, const double *X, double *at, double slopes[2][2])
{
  const double *v = c->corners + 6 * f;
  for (int i = 0; i < 2; ++i)
  {
    for (int j = 0; j < 2; ++j)
      slopes[j][i] = v[2 * (j + 1) + i] - v[i];
    at[i] = v[i] + X[0] * slopes[0][i] + X[1] * slopes[1][i];
  }
  const double weight[3] = {1 - X[0] - X[1], X[0], X[1]};
  const double gradient[3][2] = {{-1, -1}, {1, 0}, {0, 1}};
  for (int k = 0; k < 3; ++k)
  {
    int m = (k + 1) % 3;
    double power = 1, before = 0, apart = weight[m] - weight[k], both = weight[k] * weight[m];
    for (int n = 0; n < c->num_bends; ++n) // apart to the n, and to the n − 1
    {
      const double *b = c->bends + 2 * ((3 * f + k) * c->num_bends + n);
      for (int i = 0; i < 2; ++i)
      {
        at[i] += both * power * b[i];
        for (int j = 0; j < 2; ++j)
          slopes[j][i] += b[i] * (power * (weight[k] * gradient[m][j] + weight[m] * gradient[k][j])
                                  + n * before * both * (gradient[m][j] - gradient[k][j]));
      }
      before = power;
      power *= apart;
    }
  }
}

// A place of a curved triangle, from its facet's first node, and the derivatives.
static void on_facet(const Curves *c, int f, const double *X, double *x, double dx[2][3])
{
  double at[2], slopes[2][2], by[2][3] = {{0}};
  in_facet(c, f, X, at, slopes);
  x[0] = x[1] = x[2] = 0;
  double table[3][c->num_terms];
  monomials(c->num_terms, c->powers, at, 3, table[0]);
  for (int n = 0; n < c->num_terms; ++n)
  {
    const double *factor = c->nodes + 3 * ((c->num_terms + 1) * f + n + 1);
    for (int i = 0; i < 3; ++i)
    {
      x[i] += table[0][n] * factor[i];
      by[0][i] += table[1][n] * factor[i];
      by[1][i] += table[2][n] * factor[i];
    }
  }
  for (int j = 0; j < 2; ++j)
    for (int i = 0; i < 3; ++i)
      dx[j][i] = slopes[j][0] * by[0][i] + slopes[j][1] * by[1][i];
}

// Where a line along the normals between a triangle's vertices meets it, by Newton's method: other
// than along its own normal, points near each other get to places near each other across edges. X
// stays where it doesn't converge.
static void on_curved(const Patches *s, int f, const double *point, double *X)
{
  const Curves *c = s->curves;
  const int *v = s->triangles + 3 * f;
  double z[3] = {X[0], X[1], 0}, p[3], n[3], dn[2][3]; // z: coordinates, and how far off
  minus(point, c->nodes + 3 * (c->num_terms + 1) * f, p);
  for (int j = 0; j < 2; ++j)
    minus(c->normals + 3 * v[j + 1], c->normals + 3 * v[0], dn[j]);
  for (int k = 0; k < c->steps; ++k)
  {
    double off[3], J[3][3], dx[2][3];
    on_facet(c, f, z, off, dx);
    for (int i = 0; i < 3; ++i)
    {
      n[i] = c->normals[3 * v[0] + i] + z[0] * dn[0][i] + z[1] * dn[1][i];
      off[i] += z[2] * n[i] - p[i];
      J[0][i] = dx[0][i] + z[2] * dn[0][i];
      J[1][i] = dx[1][i] + z[2] * dn[1][i];
      J[2][i] = n[i];
    }
    double square = dot(dx[0], dx[0]) + dot(dx[1], dx[1]), det = triple(J[0], J[1], J[2]);
    if (fabs(det) < SINGULAR * square)
      for (int i = 0; i < 3; ++i)
        z[i] -= off[i];
    else
      for (int i = 0; i < 3; ++i)
        z[i] -= triple(off, J[(i + 1) % 3], J[(i + 2) % 3]) / det;
    for (int i = 0; i < 2; ++i)
      z[i] = fmin(fmax(z[i], X[i] - 1), X[i] + 1);
    if (dot(off, off) < 1e-20 * square) // before this step, the last one
    {
      X[0] = z[0];
      X[1] = z[1];
      return;
    }
  }
}

// Go over edges that a point lies beyond, the farthest first, up to a number of triangles. The one
// that it lies in best, and where.
static void walk_over(const Patches *s, const double *point, int curved, int *facet, double *X)
{
  int way[STRAIGHT_STEPS], f = *facet;
  int steps = curved ? s->curves->further : STRAIGHT_STEPS;
  double best = -INFINITY;
  X[0] = X[1] = 0;
  for (int step = 0; step < steps && step < STRAIGHT_STEPS; ++step)
  {
    double at[2];
    way[step] = f;
    on_straight(s, f, point, at);
    if (curved)
      on_curved(s, f, point, at);
    const double weight[3] = {1 - at[0] - at[1], at[0], at[1]};
    double inside = fmin(fmin(weight[0], weight[1]), weight[2]), least = -INSIDE;
    if (inside > best)
    {
      best = inside;
      *facet = f;
      X[0] = at[0];
      X[1] = at[1];
    }
    int next = -1;
    for (int k = 0; k < 3; ++k)
    {
      int behind = s->behind[3 * f + (k + 1) % 3]; // opposite to the vertex
      if (behind >= 0 && weight[k] < least)
      {
        least = weight[k];
        next = behind;
      }
    }
    for (int k = 0; k <= step && next >= 0; ++k)
      if (way[k] == next) // in a circle
        next = -1;
    if (next < 0)
      return;
    f = next;
  }
}

// Walk from a triangle to the one that each point projects into: over straight ones, then over
// curved ones, if they are. Beyond a boundary the last one is extrapolated.
void project(int num, const double *points, const double *x, const int *triangles,
             const int *behind, const Curves *curves, int *facet, double *X)
{
  const Patches surface = {x, triangles, behind, curves};
  for (int i = 0; i < num; ++i)
  {
    walk_over(&surface, points + 3 * i, 0, facet + i, X + 2 * i);
    if (curves)
      walk_over(&surface, points + 3 * i, 1, facet + i, X + 2 * i);
  }
}

// Where points project to on a triangle each, from coordinates in it.
void project_on_curved(int num, const double *points, const double *x, const int *triangles,
                       const Curves *curves, const int *facet, double *X)
{
  const Patches surface = {x, triangles, NULL, curves};
  for (int i = 0; i < num; ++i)
    on_curved(&surface, facet[i], points + 3 * i, X + 2 * i);
}
