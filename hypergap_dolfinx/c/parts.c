// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Weighted gaps and slips of parts of Γ1's facets that see Γ0 in part (contact_geometry/sheets.py),
// and their derivatives by dofs: those of sums over points of polygons that move.
//
// With ω_k of sheets k, ω_k h_k Π_{j<k} (1 − ω_j), summed over k, is the sum over all sets S of sheets
// of −(−1)^|S| Π ω h, with the h of the one in front; each is integrated over the polygon that all of
// S has.

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "depths.h"
#include "heights.h"
#include "jets.h"
#include "polygons.h"
#include "space.h"
#include "vectors.h"

#define MOST_SIDES 4     // of a facet
#define PARALLEL 1e-9    // sine of the angle between edges whose crossing stays where it is on one
// 1e-9 to 1e-6: 32 structured blocks take 104 Newton steps; −1: three of test_blocks_edge_on_edge fail
#define ALONG 1e-7       // distance of an edge's ends from a line that it is on, in its length
#define STEPS_OF_RAY 10  // to where it meets Γ0, at most

typedef struct {
  Jet x[3];
} Vec;

// A point of a polygon, and where its ray meets the sheets.
typedef struct {
  int number; // of the point in the rule
  double X[2], xi[MOST_STACKED][2], up[MOST_STACKED]; // heights over M
  int leans, leaves, fades; // bits of the sheets whose weights depend on the cosine, on how far the
                            // ray passes a facet, on the depth
  Nearest foot;
} Spot;

// A set of sheets over a part: the polygon that all of them have.
typedef struct {
  const Parts *of;
  const Facets *below, *above;
  const Body *body;
  int facet, part, row;
  int num, sheets[MOST_STACKED];
  int count, edge[MOST_CUT];
  double X[MOST_CUT][2], y[MOST_CUT][2], at[MOST_CUT][2]; // corners; in the plane; in the part
  int looks; // whether it isn't known yet what points see
  int num_spots;
  Spot *spots; // (num_points)
  const double *origin;
  int num_dofs, *dofs; // that it depends on, and numbers of facets' among them
  int *own, *of_sheet[MOST_STACKED], *of_foot; // of a facet beside each spot
} Set;

// Points of a set as jets.
typedef struct {
  Jet weight, visible;  // of the quadrature, with the sign; Π ω
  Jet up, slope;        // height over M; N₁ · M
  Jet xi[2], X[2];      // of the sheet in front
  int front;
} Seen;

static Jet dotted(Tape *tape, const Vec *a, const Vec *b)
{
  Jet sum = product(tape, a->x[0], b->x[0]);
  for (int i = 1; i < 3; ++i)
    sum = combined(tape, 1, sum, 1, product(tape, a->x[i], b->x[i]));
  return sum;
}

static Vec crossed(Tape *tape, const Vec *a, const Vec *b)
{
  Vec c;
  for (int i = 0; i < 3; ++i)
  {
    int j = (i + 1) % 3, k = (i + 2) % 3;
    c.x[i] = combined(tape, 1, product(tape, a->x[j], b->x[k]), -1, product(tape, a->x[k], b->x[j]));
  }
  return c;
}

static Vec less(Tape *tape, const Vec *a, const Vec *b)
{
  Vec c;
  for (int i = 0; i < 3; ++i)
    c.x[i] = combined(tape, 1, a->x[i], -1, b->x[i]);
  return c;
}

static double derivative(int power, int k, double x)
{
  double f = k > power ? 0 : 1;
  for (int i = 0; i < k; ++i)
    f *= power - i;
  for (int i = k; i < power; ++i)
    f *= x;
  return f;
}

// Derivatives of a facet's terms and functions by both coordinates.
static void functions_at(const Facets *facets, const double *X, int i, int j, double *terms,
                         double *N)
{
  int n = facets->num_dofs;
  memset(N, 0, n * sizeof(double));
  for (int t = 0; t < facets->num_terms; ++t)
  {
    const int *powers = facets->powers + 2 * t;
    terms[t] = derivative(powers[0], i, X[0] - facets->middle[0])
               * derivative(powers[1], j, X[1] - facets->middle[1]);
    for (int a = 0; a < n; ++a)
      N[a] += terms[t] * facets->functions[n * t + a];
  }
}

// A point of a facet, or its derivative by a coordinate, or displacements there.
//
// numbers  of its dofs in jets; NULL if they are none
// X, moves its coordinates and these as jets; NULL if they stay
// d        0, or number of the coordinate from 1
// moved    displacements of dofs instead of positions, (num_dofs₀ + num_dofs₁, 3), or NULL
static Vec point_on(Tape *tape, const Set *set, int side, int f, const int *numbers,
                    const double *X, Jet const *moves, int d, const double *moved)
{
  static const int rows[6][2] = {{0, 0}, {1, 0}, {0, 1}, {2, 0}, {1, 1}, {0, 2}};
  const Facets *facets = set->of->sides + side;
  const int *dofs = set->of->dofs[side] + (size_t)facets->num_dofs * f;
  int num = facets->num_terms, n = facets->num_dofs, order = tape->order;
  int num_s = moves && order ? 2 : 0, num_rows = !num_s ? 1 : order < 2 ? 3 : 6;
  double N[6][n], x[3][6] = {{0}};
  for (int r = 0; r < num_rows; ++r)
  {
    double terms[num];
    functions_at(facets, X, rows[r][0] + (d == 1), rows[r][1] + (d == 2), terms, N[r]);
    const double *factors = facets->factors + (size_t)3 * num * f;
    for (int t = 0; !moved && t < num; ++t)
      for (int c = 0; c < 3; ++c)
        x[c][r] += terms[t] * factors[3 * t + c];
    for (int a = 0; moved && a < n; ++a)
      for (int c = 0; c < 3; ++c)
        x[c][r] += N[r][a] * moved[3 * dofs[a] + c];
  }
  Vec found;
  for (int c = 0; c < 3; ++c)
  {
    if (!d && !moved)
      x[c][0] += facets->origins[3 * f + c] - set->origin[c];
    found.x[c] = placed(tape, num_s, moves, x[c], numbers ? n : 0, numbers, 3, c,
                        (const double *[]){N[0], N[1], N[2]});
  }
  return found;
}

// The plane across the normal of Γ1's facet as jets.
typedef struct {
  Vec middle, normal, by[2];
  Jet square;   // of the normal
  Jet ends[PART + MOST_SIDES * MOST_STACKED][2]; // corners of the part and of sheets there; NULL: not yet
} Plane;

static Plane plane_of(Tape *tape, const Set *set)
{
  const double *X = set->above->middle;
  Plane plane = {0};
  Vec t[2];
  plane.middle = point_on(tape, set, 1, set->facet, set->own, X, NULL, 0, NULL);
  for (int k = 0; k < 2; ++k)
    t[k] = point_on(tape, set, 1, set->facet, set->own, X, NULL, k + 1, NULL);
  plane.normal = crossed(tape, t, t + 1);
  plane.square = dotted(tape, &plane.normal, &plane.normal);
  plane.by[0] = crossed(tape, t + 1, &plane.normal);
  plane.by[1] = crossed(tape, &plane.normal, t);
  Jet inverse = power(tape, plane.square, -1);
  for (int k = 0; k < 2; ++k)
    for (int i = 0; i < 3; ++i)
      plane.by[k].x[i] = product(tape, plane.by[k].x[i], inverse);
  return plane;
}

static void seen_in(Tape *tape, const Plane *plane, const Vec *x, Jet *y)
{
  Vec d = less(tape, x, &plane->middle);
  for (int k = 0; k < 2; ++k)
    y[k] = dotted(tape, plane->by + k, &d);
}

// Corner k of the part (s < 0) or of a sheet as it is seen.
static const Jet *seen_at(Tape *tape, const Set *set, Plane *plane, int s, int k)
{
  Jet *y = plane->ends[s < 0 ? k : PART + MOST_SIDES * s + k];
  if (y[0])
    return y;
  const double *X = set->of->parts + 2 * (PART * set->part + k);
  if (s < 0 && set->above->num_terms == 3)
  { // an affine facet in its own plane
    for (int i = 0; i < 2; ++i)
      y[i] = constant(tape, X[i] - set->above->middle[i]);
    return y;
  }
  Vec x = s < 0 ? point_on(tape, set, 1, set->facet, set->own, X, NULL, 0, NULL)
                : point_on(tape, set, 0, set->sheets[s], set->of_sheet[s],
                           set->of->corners + 2 * k, NULL, 0, NULL);
  seen_in(tape, plane, &x, y);
  return y;
}

// The ends of a polygon's edge as they are seen.
static void ends_of(Tape *tape, const Set *set, Plane *plane, int edge, Jet (*y)[2])
{
  int num = set->below->num_corners;
  for (int e = 0; e < 2; ++e)
  { // a sheet's are seen from the other side
    int s = edge < PART ? -1 : (edge - PART) / MOST_SIDES;
    int k = edge < PART ? (edge + e) % PART
                        : num - 1 - ((edge - PART) % MOST_SIDES + e) % num;
    memcpy(y[e], seen_at(tape, set, plane, s, k), sizeof(y[e]));
  }
}

// Corner k of a polygon in the plane, where an edge ends and the next one starts.
static void corner_in_plane(Tape *tape, const Set *set, Plane *plane, int k, Jet *y)
{
  int e = set->edge[(k + set->count - 1) % set->count], f = set->edge[k];
  int num = set->below->num_corners;
  Jet a[2][2], b[2][2], c[2], d[2], from[2];
  ends_of(tape, set, plane, f, b);
  if (e >= PART && f >= PART && (e - PART) / MOST_SIDES == (f - PART) / MOST_SIDES
      && (f - e + num) % num == 1)
  {
    memcpy(y, b[0], sizeof(b[0]));
    return;
  }
  ends_of(tape, set, plane, e, a);
  for (int i = 0; i < 2; ++i)
  {
    c[i] = combined(tape, 1, a[1][i], -1, a[0][i]);
    d[i] = combined(tape, 1, b[1][i], -1, b[0][i]);
    from[i] = combined(tape, 1, b[0][i], -1, a[0][i]);
  }
  Jet det = wedge(tape, c, d);
  double size = hypot(c[0][0], c[1][0]) * hypot(d[0][0], d[1][0]);
  Jet t;
  if (fabs(det[0]) > PARALLEL * size)
    t = quotient(tape, wedge(tape, from, d), det);
  else
  { // where it was cut: the quotient is anything
    const double *at = set->y[k], by[2] = {c[0][0], c[1][0]};
    double along = (at[0] - a[0][0][0]) * by[0] + (at[1] - a[0][1][0]) * by[1];
    t = constant(tape, along / (by[0] * by[0] + by[1] * by[1] + 1e-300));
  }
  for (int i = 0; i < 2; ++i)
    y[i] = combined(tape, 1, a[0][i], 1, product(tape, t, c[i]));
}

// Corner k of a polygon on Γ1's reference facet.
static void corner_on_facet(Tape *tape, const Set *set, Plane *plane, int k, Jet *X)
{
  const double *parts = set->of->parts + 2 * PART * set->part;
  int e = set->edge[(k + set->count - 1) % set->count], f = set->edge[k];
  for (int i = 0; i < 2; ++i)
    X[i] = constant(tape, set->X[k][i]);
  if (tape->order < 1 || (e < PART && f < PART))
    return;
  Jet y[2];
  corner_in_plane(tape, set, plane, k, y);
  if (set->above->num_terms == 3)
  {
    for (int i = 0; i < 2; ++i)
    {
      X[i] = scaled(tape, 1, y[i]); // the other one may be kept
      X[i][0] = set->X[k][i];
    }
    return;
  }
  // Where a bilinear map has that point, by Newton's method from its value
  Jet own[PART][2], c[PART][2], s[2];
  double with[4][2];
  bilinear((const Point *)parts, with);
  for (int v = 0; v < PART; ++v)
    memcpy(own[v], seen_at(tape, set, plane, -1, v), sizeof(own[v]));
  for (int i = 0; i < 2; ++i)
  {
    s[i] = constant(tape, set->at[k][i]);
    c[0][i] = own[0][i];
    c[1][i] = combined(tape, 1, own[1][i], -1, own[0][i]);
    c[2][i] = combined(tape, 1, own[3][i], -1, own[0][i]);
    c[3][i] = combined(tape, -1, c[1][i], 1, combined(tape, 1, own[2][i], -1, own[3][i]));
  }
  for (int it = 0; it < tape->order; ++it)
  {
    Jet rest[2], both = product(tape, s[0], s[1]);
    double p[2], q[2];
    for (int i = 0; i < 2; ++i)
    {
      Jet at = combined(tape, 1, c[0][i], 1, product(tape, c[1][i], s[0]));
      at = combined(tape, 1, at, 1, product(tape, c[2][i], s[1]));
      at = combined(tape, 1, at, 1, product(tape, c[3][i], both));
      rest[i] = combined(tape, 1, y[i], -1, at);
      p[i] = c[1][i][0] + c[3][i][0] * s[1][0];
      q[i] = c[2][i][0] + c[3][i][0] * s[0][0];
    }
    double det = p[0] * q[1] - p[1] * q[0];
    Jet moves[2] = {combined(tape, q[1] / det, rest[0], -q[0] / det, rest[1]),
                    combined(tape, p[0] / det, rest[1], -p[1] / det, rest[0])};
    for (int i = 0; i < 2; ++i)
    {
      s[i] = combined(tape, 1, s[i], 1, moves[i]);
      s[i][0] = set->at[k][i];
    }
  }
  Jet both = product(tape, s[0], s[1]);
  for (int i = 0; i < 2; ++i)
  {
    X[i] = combined(tape, with[1][i], s[0], with[2][i], s[1]);
    X[i] = combined(tape, 1, X[i], with[3][i], both);
    X[i][0] = set->X[k][i];
  }
}

// Middle from the first corner, and the lower square root of the matrix of second moments.
typedef struct {
  Jet middle[2], c, d, e;
} Spread;

// Weights of points on a polygon by its moments, as moments.c has them.
//
// n        number of corners
// X        corners from the first one, (n, 2)
// twice    areas of the triangles with the first corner, doubled, (n - 1), from 1 on
static void weights_of(Tape *tape, const Parts *parts, int n, Jet (*X)[2], Jet *twice,
                       const Spread *by, Jet *weights)
{
  int degree = parts->powers[2 * parts->num_terms - 2];
  Jet moments[parts->num_terms];
  for (int m = 0; m < parts->num_terms; ++m)
    moments[m] = constant(tape, 0);
  for (int t = 1; t + 1 < n; ++t)
    for (int k = 0; k < parts->num_inner; ++k)
    {
      const double *in = parts->inner + 3 * k;
      Jet y[2], powers[2][degree + 1];
      for (int i = 0; i < 2; ++i)
      {
        y[i] = combined(tape, in[0], X[t][i], in[1], X[t + 1][i]);
        y[i] = combined(tape, 1, y[i], -1, by->middle[i]);
      }
      y[0] = quotient(tape, y[0], by->c);
      y[1] = quotient(tape, combined(tape, 1, y[1], -1, product(tape, by->d, y[0])), by->e);
      powers[0][0] = scaled(tape, in[2], twice[t]), powers[1][0] = constant(tape, 1);
      for (int i = 0; i < 2; ++i)
        for (int d = 0; d < degree; ++d)
          powers[i][d + 1] = product(tape, powers[i][d], y[i]);
      for (int m = 0; m < parts->num_terms; ++m)
      {
        const int *power = parts->powers + 2 * m;
        Jet value = product(tape, powers[0][power[0]], powers[1][power[1]]);
        moments[m] = combined(tape, 1, moments[m], 1, value);
      }
    }
  for (int k = 0; k < parts->num_points; ++k)
  {
    weights[k] = scaled(tape, parts->inverse[k], moments[0]);
    for (int m = 1; m < parts->num_terms; ++m)
      weights[k] = combined(tape, 1, weights[k], parts->inverse[parts->num_points * m + k], moments[m]);
  }
}

// Points and weights on a polygon: as moments.c has them.
//
// points   (num_points, 2)
// weights  (num_points)
static void points_of(Tape *tape, const Set *set, Plane *plane, Jet (*points)[2], Jet *weights)
{
  int n = set->count, num = set->of->num_points;
  Jet X[n][2], twice[n], area = NULL, first[2], second[3];
  for (int k = 0; k < n; ++k)
  {
    corner_on_facet(tape, set, plane, k, X[k]);
    for (int i = 0; k && i < 2; ++i)
      X[k][i] = combined(tape, 1, X[k][i], -1, X[0][i]);
  }
  for (int t = 1; t + 1 < n; ++t)
  {
    Jet *a = X[t], *b = X[t + 1], sum[2];
    twice[t] = wedge(tape, a, b);
    area = area ? combined(tape, 1, area, 0.5, twice[t]) : scaled(tape, 0.5, twice[t]);
    for (int i = 0; i < 2; ++i)
    {
      sum[i] = combined(tape, 1, a[i], 1, b[i]);
      Jet part = scaled(tape, 1. / 6, product(tape, twice[t], sum[i]));
      first[i] = t > 1 ? combined(tape, 1, first[i], 1, part) : part;
    }
    for (int k = 0; num > 1 && k < 3; ++k)
    { // ∫ x xᵀ over a triangle with a corner at 0
      int i = k == 2, j = k > 0;
      Jet part = combined(tape, 1, product(tape, a[i], a[j]), 1, product(tape, b[i], b[j]));
      part = combined(tape, 1, part, 1, product(tape, sum[i], sum[j]));
      part = scaled(tape, 1. / 24, product(tape, twice[t], part));
      second[k] = t > 1 ? combined(tape, 1, second[k], 1, part) : part;
    }
  }
  Jet equal = scaled(tape, 1. / num, area);
  for (int k = 0; k < num; ++k)
    weights[k] = equal;
  Spread by;
  for (int i = 0; i < 2; ++i)
  {
    by.middle[i] = quotient(tape, first[i], area);
    points[0][i] = combined(tape, 1, X[0][i], 1, by.middle[i]);
  }
  if (num > 1)
  {
    for (int k = 0; k < 3; ++k)
      second[k] = combined(tape, 1, quotient(tape, second[k], area), -1,
                           product(tape, by.middle[k == 2], by.middle[k > 0]));
    double least = set->of->least * (second[0][0] + second[2][0]) + 1e-300;
    by.c = second[0][0] > least ? power(tape, second[0], 0.5) : constant(tape, sqrt(least));
    by.d = quotient(tape, second[1], by.c);
    by.e = combined(tape, 1, second[2], -1, product(tape, by.d, by.d));
    by.e = by.e[0] > least ? power(tape, by.e, 0.5) : constant(tape, sqrt(least));
    Jet middle[2] = {points[0][0], points[0][1]};
    for (int p = 0; p < num; ++p)
    {
      const double *y = set->of->points + 2 * p;
      points[p][0] = combined(tape, 1, middle[0], y[0], by.c);
      points[p][1] = combined(tape, 1, middle[1], 1, combined(tape, y[0], by.d, y[1], by.e));
    }
    if (set->of->num_terms)
      weights_of(tape, set->of, n, X, twice, &by, weights);
  }
  for (int k = 0; set->num % 2 == 0 && k < num; ++k) // sign
    weights[k] = scaled(tape, -1, weights[k]);
}

// Where the ray from a point of Γ1 meets a sheet, by Newton's method: each step gives one order of
// derivatives.
//
// xi, up   values to start from
// at       reference coordinates and the height over the normal
// Returns 0 if it looks and doesn't find it.
static int meet(Tape *tape, const Set *set, int s, const Plane *plane, const Vec *x1,
                 const double *xi, double up, Jet *at)
{
  double step = INFINITY, last = set->of->last;
  for (int k = 0; k < 3; ++k)
    at[k] = constant(tape, k < 2 ? xi[k] : up);
  int steps = set->looks ? STEPS_OF_RAY : tape->order;
  for (int it = 0; it < steps && !(step < last); ++it)
  {
    double X[2] = {at[0][0], at[1][0]}, z[3][3], w[3][3], jet[3][3];
    Vec x0 = point_on(tape, set, 0, set->sheets[s], set->of_sheet[s], X, at, 0, NULL), rest;
    jet_on(set->below, set->sheets[s], X, 3, jet);
    memcpy(z, jet + 1, 2 * sizeof(z[0]));
    for (int i = 0; i < 3; ++i)
    {
      z[2][i] = -plane->normal.x[i][0];
      rest.x[i] = combined(tape, 1, x0.x[i], -1, x1->x[i]);
      rest.x[i] = combined(tape, 1, rest.x[i], -1, product(tape, at[2], plane->normal.x[i]));
    }
    for (int k = 0; k < 3; ++k)
      cross(z[(k + 1) % 3], z[(k + 2) % 3], w[k]);
    double det = dot(z[0], w[0]);
    step = 0;
    for (int k = 0; k < 3; ++k)
    {
      Jet sum = combined(tape, w[k][0] / det, rest.x[0], w[k][1] / det, rest.x[1]);
      sum = combined(tape, 1, sum, w[k][2] / det, rest.x[2]);
      at[k] = combined(tape, 1, at[k], -1, sum);
      step = k < 2 ? larger(step, fabs(sum[0])) : step;
    }
    if (!set->looks)
      step = INFINITY;
  }
  return !set->looks || step < last;
}

// How far inside of a facet a point is, in reference coordinates; negative outside.
static Jet inside(Tape *tape, const Facets *facets, Jet const *at)
{
  int num = facets->num_corners, last = 0;
  Jet ends[4] = {at[0], at[1], combined(tape, -1, at[0], num == 3 ? -1 : 0, at[1]), NULL};
  ends[2][0] += 1;
  if (num == 4)
    ends[3] = scaled(tape, -1, at[1]), ends[3][0] += 1;
  for (int k = 1; k < num; ++k)
    last = ends[k][0] < ends[last][0] ? k : last;
  return ends[last];
}

// Depth of a point in Γ0's body by what is nearest.
static Jet depth_of(Tape *tape, const Set *set, const Spot *spot, const Vec *x1)
{
  const Parts *parts = set->of;
  const Nearest *foot = &spot->foot;
  if (set->looks)
    return constant(tape, depth_by(*foot));
  int facet = foot->triangle / parts->triangles_a_facet;
  const double *at = parts->triangle_at + 6 * (foot->triangle % parts->triangles_a_facet);
  const int *numbers = set->of_foot + set->below->num_dofs * (spot - set->spots);
  Vec corners[3], e[2], d;
  int whole = foot->corners[0] < 0;
  for (int k = 0; k < 3; ++k)
    corners[k] = point_on(tape, set, 0, facet, numbers, at + 2 * k, NULL, 0, NULL);
  if (whole)
  {
    for (int k = 0; k < 2; ++k)
      e[k] = less(tape, corners + k + 1, corners);
    Vec n = crossed(tape, e, e + 1);
    d = less(tape, corners, x1);
    return product(tape, dotted(tape, &n, &d), power(tape, dotted(tape, &n, &n), -0.5));
  }
  d = less(tape, x1, corners + foot->corners[0]);
  Jet square = dotted(tape, &d, &d);
  if (foot->corners[0] != foot->corners[1])
  {
    e[0] = less(tape, corners + foot->corners[1], corners + foot->corners[0]);
    Jet along = dotted(tape, &d, e);
    along = quotient(tape, product(tape, along, along), dotted(tape, e, e));
    square = combined(tape, 1, square, -1, along);
  }
  if (!(square[0] > 0))
    return constant(tape, 0);
  return scaled(tape, foot->inside < 0 ? -1 : 1, power(tape, square, 0.5));
}

// What the set's sheets weigh at a point of Γ1, and where its ray meets them. If it looks it finds
// out what these depend on; NULL for ``visible`` if a weight is zero then.
static Seen ray_at(Tape *tape, const Set *set, const Plane *plane, Spot *spot, Jet weight,
                   Jet const *X)
{
  const Parts *parts = set->of;
  int looks = set->looks;
  Seen seen = {.weight = weight, .X = {X[0], X[1]}};
  const double at_X[2] = {X[0][0], X[1][0]};
  Vec t[2], x1 = point_on(tape, set, 1, set->facet, set->own, at_X, X, 0, NULL);
  for (int k = 0; k < 2; ++k)
    t[k] = point_on(tape, set, 1, set->facet, set->own, at_X, X, k + 1, NULL);
  Vec n1 = crossed(tape, t, t + 1);
  seen.slope = dotted(tape, &n1, &plane->normal);
  Jet depth = NULL, visible = constant(tape, 1);
  for (int s = 0; s < set->num; ++s)
  {
    Jet at[3], part;
    if (!meet(tape, set, s, plane, &x1, spot->xi[s], spot->up[s], at))
      return seen;
    double xi[2] = {at[0][0], at[1][0]};
    memcpy(spot->xi[s], xi, sizeof(xi));
    spot->up[s] = at[2][0];
    double deep = -at[2][0] * sqrt(plane->square[0]);
    if (looks && parts->own && deep > parts->own->walls[set->facet])
      return seen;
    if (!seen.up || at[2][0] > seen.up[0])
    {
      seen.up = at[2], seen.front = s;
      memcpy(seen.xi, at, sizeof(seen.xi));
    }
    if (set->below->num_terms > 3 && (looks || spot->leaves >> s & 1))
    {
      part = step_of(tape, inside(tape, set->below, at), parts->inside);
      spot->leaves |= (part[0] < 1) << s;
      visible = product(tape, visible, part);
    }
    if (!looks && !((spot->leans | spot->fades) >> s & 1))
      continue;
    for (int k = 0; k < 2; ++k)
      t[k] = point_on(tape, set, 0, set->sheets[s], set->of_sheet[s], xi, at, k + 1, NULL);
    Vec n0 = crossed(tape, t, t + 1);
    // − cos times the length of M
    Jet lean = product(tape, dotted(tape, &n0, &plane->normal),
                       power(tape, dotted(tape, &n0, &n0), -0.5));
    if (looks || spot->leans >> s & 1)
    {
      Jet cos = product(tape, lean, power(tape, plane->square, -0.5));
      part = step_of(tape, scaled(tape, -1, cos), parts->cosines);
      spot->leans |= (part[0] < 1) << s;
      visible = product(tape, visible, part);
    }
    if (looks ? at[2][0] < 0 && visible[0] > 0 : spot->fades >> s & 1)
    {
      if (!depth)
      {
        if (looks)
        {
          double x[3];
          for (int i = 0; i < 3; ++i)
            x[i] = x1.x[i][0] + set->origin[i];
          spot->foot = nearest_of(set->body, x, set->facet);
        }
        depth = depth_of(tape, set, spot, &x1);
        depth = combined(tape, 1, depth, parts->slack, power(tape, plane->square, 0.25));
      }
      Jet ratio = quotient(tape, depth, product(tape, at[2], lean));
      part = step_of(tape, ratio, parts->nearest);
      spot->fades |= (part[0] < 1) << s;
      visible = product(tape, visible, part);
    }
    if (looks && !(visible[0] > 0))
      return seen;
  }
  seen.visible = visible;
  return seen;
}

// What is made of the points.
typedef struct {
  int order;
  double *g, *covered, *areas;
  Triplets *C, *by_covered;
  const double *p, *by; // or Σ p ∂²g + Σ by ∂²covered
  Triplets *H;
  const double *moved; // or slips, if T isn't NULL
  int across;
  Triplets *T;
  const double *q; // or forces of tractions
} Work;

static void add_triplet(Triplets *to, int row, int column, double value)
{
  int k = to->num++;
  if (k < to->max)
    to->rows[k] = row, to->columns[k] = column, to->values[k] = value;
}

static void put_row(const Set *set, int row, double factor, const double *jet, Triplets *to)
{
  for (int k = 0; k < 3 * set->num_dofs; ++k)
    if (jet[1 + k] != 0)
      add_triplet(to, row, 3 * set->dofs[k / 3] + k % 3, factor * jet[1 + k]);
}

static void put_square(const Set *set, const double *second, int is_symmetric, Triplets *to)
{
  int n = 3 * set->num_dofs;
  for (int v = 0; v < n; ++v)
    for (int w = 0; w < (is_symmetric ? v + 1 : n); ++w)
    {
      int i = 3 * set->dofs[v / 3] + v % 3, j = 3 * set->dofs[w / 3] + w % 3;
      double value = second[n * v + w];
      if (value == 0)
        continue;
      add_triplet(to, i, j, value);
      if (is_symmetric && v != w)
        add_triplet(to, j, i, value);
    }
}

// Slips of a point: components of κ P D, and their derivatives; those of forces into the square.
static void add_slips(Tape *tape, const Set *set, const Plane *plane, const Seen *seen,
                     const Work *work)
{
  const double *X[2] = {(double[]){seen->xi[0][0], seen->xi[1][0]},
                        (double[]){seen->X[0][0], seen->X[1][0]}};
  int f[2] = {set->sheets[seen->front], set->facet};
  const int *numbers[2] = {set->of_sheet[seen->front], set->own};
  Jet const *moves[2] = {seen->xi, seen->X};
  Jet size = product(tape, seen->slope, power(tape, plane->square, -0.5));
  size = product(tape, size, product(tape, seen->weight, seen->visible));
  Vec D;
  if (work->moved)
  {
    Vec ends[2];
    for (int side = 0; side < 2; ++side)
      ends[side] = point_on(tape, set, side, f[side], numbers[side], X[side], moves[side], 0,
                            work->moved);
    D = less(tape, ends + 1, ends);
  }
  else
    for (int i = 0; i < 3; ++i)
      D.x[i] = constant(tape, work->q ? work->q[3 * set->row + i] : 0);
  if (work->moved || work->q)
  {
    Jet up = quotient(tape, dotted(tape, &plane->normal, &D), plane->square);
    for (int i = 0; i < 3; ++i)
    {
      D.x[i] = combined(tape, 1, D.x[i], -1, product(tape, up, plane->normal.x[i]));
      D.x[i] = product(tape, D.x[i], size);
      if (work->moved)
        put_row(set, 3 * set->row + i, 1, D.x[i], work->T);
    }
  }
  for (int side = 0; !work->moved && side < 2; ++side)
  {
    const Facets *facets = set->of->sides + side;
    int n = facets->num_dofs;
    const int *dofs = set->of->dofs[side] + (size_t)n * f[side];
    double terms[facets->num_terms], N[3][n], sign = side ? 1 : -1;
    for (int r = 0; r < 3; ++r)
      functions_at(facets, X[side], r == 1, r == 2, terms, N[r]);
    for (int a = 0; a < n; ++a)
      for (int i = 0; i < 3; ++i)
      {
        for (int j = 0; work->across && i == 0 && j < 3; ++j)
        {
          double up = plane->normal.x[j][0] / sqrt(plane->square[0]);
          add_triplet(work->T, set->row, 3 * dofs[a] + j, -sign * N[0][a] * size[0] * up);
        }
        for (int j = 0; !work->across && !work->q && j < 3; ++j)
        {
          double flat = (i == j) - plane->normal.x[i][0] * plane->normal.x[j][0] / plane->square[0];
          add_triplet(work->T, 3 * set->row + i, 3 * dofs[a] + j, sign * N[0][a] * size[0] * flat);
        }
        if (!work->q)
          continue;
        Jet by = combined(tape, N[1][a], moves[side][0], N[2][a], moves[side][1]);
        by[0] = N[0][a];
        Jet force = product(tape, by, D.x[i]);
        double *row = tape->second + tape->n * (3 * numbers[side][a] + i);
        for (int v = 0; v < tape->n; ++v)
          row[v] += sign * force[1 + v];
      }
  }
}

// Number of a dof among a set's; it gets one if it has none.
static void number_facet(Set *set, int side, int f, int *numbers)
{
  int n = set->of->sides[side].num_dofs;
  const int *dofs = set->of->dofs[side] + (size_t)n * f;
  for (int a = 0; a < n; ++a)
  {
    int k = 0;
    while (k < set->num_dofs && set->dofs[k] != dofs[a])
      ++k;
    if (k == set->num_dofs)
      set->dofs[set->num_dofs++] = dofs[a];
    numbers[a] = k;
  }
}

// Area of a part of a reference facet.
static double part_area(const Facets *facets)
{
  return 1. / (facets->num_corners == 3 ? 6 : 4);
}

// Add what a set has; 0 without memory.
static int add_set(Set *set, Tape *tape, const Work *work)
{
  int num = set->of->num_points;
  Jet points[num][2], weights[num];
  if (!start_tape(tape, 0, 0))
    return 0;
  Plane plane = plane_of(tape, set);
  points_of(tape, set, &plane, points, weights);
  set->looks = 1, set->num_spots = 0;
  size_t used = tape->used;
  for (int k = 0; k < num; ++k, tape->used = used)
  {
    Spot *spot = set->spots + set->num_spots;
    *spot = (Spot){.number = k};
    for (int s = 0; s < set->num; ++s)
      memcpy(spot->xi[s], set->below->middle, sizeof(spot->xi[s]));
    set->num_spots += ray_at(tape, set, &plane, spot, weights[k], points[k]).visible != NULL;
  }
  if (tape->failed || !set->num_spots)
    return !tape->failed;
  set->looks = set->num_dofs = 0;
  number_facet(set, 1, set->facet, set->own);
  for (int s = 0; s < set->num; ++s)
    number_facet(set, 0, set->sheets[s], set->of_sheet[s]);
  for (int k = 0; k < set->num_spots; ++k)
    if (set->spots[k].fades)
      number_facet(set, 0, set->spots[k].foot.triangle / set->of->triangles_a_facet,
                   set->of_foot + set->below->num_dofs * k);
  if (!start_tape(tape, 3 * set->num_dofs, work->order) || (work->q && !clear_square(tape)))
    return 0;
  plane = plane_of(tape, set);
  points_of(tape, set, &plane, points, weights);
  double whole = part_area(set->above);
  Jet sum = constant(tape, 0), covered = constant(tape, 0);
  double area = 0;
  used = tape->used;
  size_t num_steps = tape->num_steps;
  for (int k = 0; k < set->num_spots; ++k, tape->used = used)
  {
    Spot *spot = set->spots + k;
    Seen seen = ray_at(tape, set, &plane, spot, weights[spot->number], points[spot->number]);
    if (work->T || work->q)
    {
      add_slips(tape, set, &plane, &seen, work);
      continue;
    }
    Jet part = product(tape, seen.weight, seen.visible);
    Jet volume = product(tape, part, product(tape, seen.up, seen.slope));
    if (work->p)
    {
      *adjoint(tape, volume) += work->p[set->row];
      *adjoint(tape, part) += work->by[set->row] / whole;
      sweep(tape, num_steps);
      continue;
    }
    area += part[0] * seen.slope[0] / sqrt(plane.square[0]);
    for (size_t v = 0; v < tape->size; ++v)
      sum[v] += volume[v], covered[v] += part[v] / whole;
  }
  if (work->g)
  {
    work->g[set->row] += sum[0], work->covered[set->row] += covered[0];
    work->areas[set->row] += area;
    put_row(set, set->row, 1, sum, work->C);
    put_row(set, set->row, 1, covered, work->by_covered);
  }
  else if (work->p)
    sweep(tape, 0);
  if (work->H)
    put_square(set, tape->second, work->p != NULL, work->H);
  return !tape->failed;
}

// Sets of sheets over a part that a polygon has, with those behind a sheet in their list.
typedef struct {
  int num;              // of sheets
  const int *sheets;
  const Point *seen;    // their corners, (num, MOST_SIDES)
  Point own[PART];
  double area;          // of the part
  Tape *tape;
  const Work *work;
} Stack;

// Bits of a sheet's edges that lie on edges of the part, with another facet beyond them; −1 if the
// sheet lies on the other side. Such edges don't cut. Where surfaces are edge on edge, angles between
// edges and so slopes of their crossings are round-off; the heights of both facets on an edge, times
// its motion, would no longer cancel. Without a cut gaps change by the square of ALONG.
static int edges_along(const Stack *stack, const Set *set, int k)
{
  int num = set->below->num_corners, found = 0;
  const int *outline = set->of->outline + num * stack->sheets[k];
  const int *vertices = set->below->vertices + num * stack->sheets[k];
  const Point *seen = stack->seen + MOST_SIDES * k;
  if (!is_convex(num, seen) || !is_convex(PART, stack->own))
    return 0;
  for (int e = 0; e < num; ++e)
  {
    int ends[2] = {e, (e + 1) % num};
    if (outline[(2 * num - 2 - e) % num])
      continue;
    // The same numbers in the same order for both facets
    int turned = vertices[num - 1 - ends[0]] > vertices[num - 1 - ends[1]];
    const double *a = seen[ends[turned]], *b = seen[ends[!turned]];
    double d[2] = {b[0] - a[0], b[1] - a[1]};
    for (int p = 0; p < PART; ++p)
    {
      const double *from = stack->own[p], *to = stack->own[(p + 1) % PART];
      double c[2] = {to[0] - from[0], to[1] - from[1]};
      double far = fabs(c[0] * (a[1] - from[1]) - c[1] * (a[0] - from[0]));
      far = larger(far, fabs(c[0] * (b[1] - from[1]) - c[1] * (b[0] - from[0])));
      if (far > ALONG * hypot(c[0], c[1]) * hypot(d[0], d[1]))
        continue;
      if ((c[0] * d[0] + c[1] * d[1] < 0) != turned)
        return -1;
      found |= 1 << e;
    }
  }
  return found;
}

// Returns STUCK where there are too many, or too many corners.
static int add_sets(const Stack *stack, Set *set, int from, int count, const Point *polygon,
                    const int *edges)
{
  const Parts *parts = set->of;
  int num = set->below->num_corners, level = set->num;
  for (int k = from; k < stack->num; ++k)
  {
    Point y[MOST_CUT];
    int edge[MOST_CUT];
    memcpy(y, polygon, count * sizeof(Point));
    memcpy(edge, edges, count * sizeof(int));
    const Point *by = stack->seen + MOST_SIDES * k;
    if (!boxes_meet(num, by, count, y))
      continue;
    int along = edges_along(stack, set, k), status;
    if (along < 0)
      continue;
    int left = intersect(y, edge, count, num, by, PART + MOST_SIDES * level, along);
    if (left > MOST_CUT)
      return STUCK;
    if (left < 3 || !(area_of(left, y) > parts->sliver * stack->area))
      continue;
    if (level == MOST_STACKED)
      return STUCK;
    set->sheets[level] = stack->sheets[k], set->num = level + 1, set->count = left;
    memcpy(set->edge, edge, left * sizeof(int));
    memcpy(set->y, y, left * sizeof(Point));
    for (int c = 0; c < left; ++c)
      if (set->above->num_terms == 3)
        for (int i = 0; i < 2; ++i)
          set->X[c][i] = set->above->middle[i] + y[c][i];
      else
        map_to(stack->own, (const Point *)parts->parts + PART * set->part, parts->last, y[c],
               set->at[c], set->X[c]);
    // On a curved facet's reference slivers may have none
    if (!(area_of(left, set->X) > parts->sliver * part_area(set->above)))
      continue;
    if (!add_set(set, stack->tape, stack->work))
      return NO_MEMORY;
    set->num = level + 1;
    // A weight of zero at all points is one for all sets with this sheet
    if (set->num_spots && (status = add_sets(stack, set, k + 1, left, y, edge)) != DONE)
      return status;
  }
  set->num = level;
  return DONE;
}

static int for_sets(const Parts *parts, const Work *work)
{
  const Facets *below = parts->sides, *above = below + 1;
  int most = 0, n0 = below->num_dofs, n1 = above->num_dofs, status;
  for (int k = 0; k < parts->num; ++k)
    most = parts->first[k + 1] - parts->first[k] > most ? parts->first[k + 1] - parts->first[k] : most;
  Point *seen = malloc((most + 1) * MOST_SIDES * sizeof(Point));
  int groups = MOST_STACKED + parts->num_points;
  int *numbers = malloc(2 * (n1 + groups * n0) * sizeof(int));
  Spot *spots = malloc(parts->num_points * sizeof(Spot));
  Body body = {parts->num_triangles, parts->triangles, parts->order, parts->triangles_a_facet,
               parts->own, NULL};
  Tape tape = {0};
  status = open_body(&body) && seen && numbers && spots ? DONE : NO_MEMORY;
  Set set = {.of = parts, .below = below, .above = above, .body = &body};
  set.spots = spots, set.dofs = numbers, set.own = numbers + n1 + groups * n0;
  for (int k = 0; k < MOST_STACKED; ++k)
    set.of_sheet[k] = set.own + n1 + k * n0;
  set.of_foot = set.own + n1 + MOST_STACKED * n0;
  for (int k = 0; status == DONE && k < parts->num; ++k)
  {
    int f = parts->facets[k], edge[PART];
    const double *plane = parts->planes + 12 * f, *origin = above->origins + 3 * f;
    Stack stack = {.num = parts->first[k + 1] - parts->first[k],
                   .sheets = parts->sheets + parts->first[k],
                   .seen = seen,
                   .tape = &tape,
                   .work = work};
    for (int s = 0; s < stack.num; ++s)
      for (int c = 0; c < below->num_corners; ++c)
      {
        double x[3];
        int v = below->vertices[below->num_corners * (stack.sheets[s] + 1) - 1 - c];
        minus(below->x + 3 * v, plane, x);
        see(plane + 3, x, seen[MOST_SIDES * s + c]);
      }
    set.facet = f, set.origin = origin;
    for (int part = 0; status == DONE && part < above->num_corners; ++part)
    {
      set.part = part, set.row = above->num_corners * f + part, set.num = 0;
      const double *p = work->p, *by = work->by, *q = work->q + 3 * set.row;
      if ((p && p[set.row] == 0 && by[set.row] == 0) || (work->q && !q[0] && !q[1] && !q[2]))
        continue;
      for (int c = 0; c < PART; ++c)
      {
        double x[3];
        jet_on(above, f, parts->parts + 2 * (PART * part + c), 1, &x);
        for (int i = 0; i < 3; ++i)
          x[i] += origin[i] - plane[i];
        see(plane + 3, x, stack.own[c]);
      }
      stack.area = fabs(area_of(PART, stack.own));
      status = add_sets(&stack, &set, 0, start_part(edge), stack.own, edge);
    }
  }
  free(seen), free(numbers), free(spots), free(body.balls), close_tape(&tape);
  return status;
}

// Weighted gaps of parts.
//
// g, covered      of parts, added, (num_facets₁, num_corners); covered as a part of the reference's
// areas           covered, as seen along the normal, added
// C, by_covered   ∂g/∂u, ∂covered/∂u
int find_parts(const Parts *parts, double *g, double *covered, double *areas, Triplets *C,
               Triplets *by_covered)
{
  C->num = by_covered->num = 0;
  return for_sets(parts, &(Work){.order = 1, .g = g, .covered = covered, .areas = areas,
                                 .C = C, .by_covered = by_covered});
}

// Σ p ∂²g/∂u² + Σ by_covered ∂²covered/∂u², with values of parts.
int part_curvature(const Parts *parts, const double *p, const double *by_covered, Triplets *H)
{
  H->num = 0;
  return for_sets(parts, &(Work){.order = 2, .p = p, .by = by_covered, .H = H});
}

// Weighted slips of parts s = T Δu, three components each: T; if they are given Δu, by dofs,
// T + ∂T/∂u Δu instead. Across: what Δu adds to gaps of points that stay opposite to each other.
int part_slips(const Parts *parts, const double *moved, int across, Triplets *T)
{
  T->num = 0;
  return for_sets(parts,
                  &(Work){.order = moved != NULL, .moved = moved, .across = across, .T = T});
}

// Σ q ∂T/∂u, with tractions of parts, (num_facets₁, num_corners, 3); it isn't symmetric.
int part_slip_curvature(const Parts *parts, const double *q, Triplets *H)
{
  H->num = 0;
  return for_sets(parts, &(Work){.order = 1, .q = q, .H = H});
}
