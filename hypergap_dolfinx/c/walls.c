// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Vertices that went through a wall of another surface (surface/moving.py).

#include "walls.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "vectors.h"

#define NEARLY_ZERO sqrt(DBL_EPSILON)

typedef struct {
  double low[3], high[3];
} Box;

// Boxes around simplices, in the order in which they begin along an axis.
typedef struct {
  int n, num, axis;
  const Moved *surface;
  struct Place {
    Box box;
    double start;
    int simplex;
  } *places;
  double widest;
} Sorted;

static const double *corner(int n, const Moved *surface, int t, int simplex, int k)
{
  return surface->x + n * (n * ((size_t)surface->num * t + simplex) + k);
}

static Box box_around(int n, const double *x)
{
  Box box;
  for (int i = 0; i < n; ++i)
    box.low[i] = box.high[i] = x[i];
  return box;
}

static void add_to_box(int n, Box *box, const double *x)
{
  for (int i = 0; i < n; ++i)
    box->low[i] = smaller(box->low[i], x[i]), box->high[i] = larger(box->high[i], x[i]);
}

// A box around a point's way and, for three times, as far back.
static void add_way(int n, int num_times, Box *box, const double *x0, const double *x1)
{
  double back[3];
  for (int i = 0; i < n; ++i)
    back[i] = 2 * x0[i] - x1[i];
  const double *x[] = {x0, x1, back};
  for (int t = 0; t < num_times; ++t)
    add_to_box(n, box, x[t]);
}

static Box box_of(int n, int num_times, const Moved *surface, int simplex)
{
  Box box = box_around(n, corner(n, surface, 0, simplex, 0));
  for (int k = 0; k < n; ++k)
    add_way(n, num_times, &box, corner(n, surface, 0, simplex, k), corner(n, surface, 1, simplex, k));
  return box;
}

static int boxes_meet(int n, const Box *a, const Box *b)
{
  for (int i = 0; i < n; ++i)
    if (!(a->low[i] <= b->high[i] && b->low[i] <= a->high[i]))
      return 0;
  return 1;
}

static double product_of(int n, const double *a, const double *b)
{
  double sum = 0;
  for (int i = 0; i < n; ++i)
    sum += a[i] * b[i];
  return sum;
}

// (a − b) · n
static double height_over(int n, const double *a, const double *b, const double *normal)
{
  double sum = 0;
  for (int i = 0; i < n; ++i)
    sum += (a[i] - b[i]) * normal[i];
  return sum;
}

// Normal of a simplex, as long as an edge or as twice the area of a triangle.
static void normal_of(int n, const double *x, double *normal)
{
  if (n == 2)
  {
    normal[0] = x[3] - x[1], normal[1] = x[0] - x[2];
    return;
  }
  double e[2][3];
  for (int k = 0; k < 2; ++k)
    minus(x + 3 * (k + 1), x, e[k]);
  cross(e[0], e[1], normal);
}

static void unit_normal_of(int n, const double *x, double *normal)
{
  normal_of(n, x, normal);
  double size = larger(sqrt(product_of(n, normal, normal)), DBL_MIN);
  for (int i = 0; i < n; ++i)
    normal[i] /= size;
}

// Shares of a simplex' corners in the foot of a point in its plane.
static void find_shares(int n, const double *x, const double *corners, double *shares)
{
  double e[2][3] = {{0}}, d[2] = {0}, G[2][2] = {{0}}, last;
  for (int k = 0; k < n - 1; ++k)
  {
    for (int i = 0; i < n; ++i)
      e[k][i] = corners[n * (k + 1) + i] - corners[i];
    d[k] = height_over(n, x, corners, e[k]);
  }
  for (int k = 0; k < n - 1; ++k)
    for (int l = 0; l < n - 1; ++l)
      G[k][l] = product_of(n, e[k], e[l]);
  double trace = G[0][0] + G[1][1], det = G[0][0] * G[1][1] - G[0][1] * G[1][0];
  if (n == 3 && det > DBL_EPSILON * trace * trace)
  {
    shares[1] = (G[1][1] * d[0] - G[0][1] * d[1]) / det;
    shares[2] = (G[0][0] * d[1] - G[1][0] * d[0]) / det;
  }
  else // an edge, or as narrow as one
    for (int k = 0; k < n - 1; ++k)
      shares[k + 1] = trace > 0 ? (G[k][0] * d[0] + G[k][1] * d[1]) / (trace * trace) : 0;
  last = shares[1] + (n > 2 ? shares[2] : 0);
  shares[0] = 1 - last;
}

static int is_inside(int n, const double *x, const double *corners)
{
  double shares[3];
  find_shares(n, x, corners, shares);
  for (int k = 0; k < n; ++k)
    if (!(shares[k] >= -NEARLY_ZERO))
      return 0;
  return 1;
}

static void place_at(int n, const double *x, const double *shares, double *place)
{
  for (int i = 0; i < n; ++i)
  {
    place[i] = 0;
    for (int k = 0; k < n; ++k)
      place[i] += shares[k] * x[n * k + i];
  }
}

// Shares of a simplex' corners in the place on it that is nearest to a point; the distance.
static double find_nearest_on(int n, const double *x, const double *corners, double *shares)
{
  double inside[3], nearest = INFINITY, place[3], off[3];
  find_shares(n, x, corners, inside);
  int is_in = 1;
  for (int k = 0; k < n; ++k)
    is_in &= inside[k] >= 0;
  for (int k = 0; k < n && !is_in; ++k)
  {
    const double *a = corners + n * k, *b = corners + n * ((k + 1) % n);
    double e[3], own[3] = {0};
    for (int i = 0; i < n; ++i)
      e[i] = b[i] - a[i];
    double s = height_over(n, x, a, e) / larger(product_of(n, e, e), DBL_MIN);
    s = smaller(larger(s, 0), 1);
    own[k] = 1 - s, own[(k + 1) % n] = s;
    for (int i = 0; i < n; ++i)
      off[i] = x[i] - a[i] - s * e[i];
    double far = sqrt(product_of(n, off, off));
    if (!(far < nearest))
      continue;
    nearest = far;
    memcpy(shares, own, sizeof(own));
  }
  if (is_in)
    memcpy(shares, inside, sizeof(inside));
  place_at(n, corners, shares, place);
  for (int i = 0; i < n; ++i)
    off[i] = x[i] - place[i];
  return sqrt(product_of(n, off, off));
}

static int by_start(const void *a, const void *b)
{
  double one = ((const struct Place *)a)->start, two = ((const struct Place *)b)->start;
  return (one > two) - (one < two);
}

// Boxes of a number of times: before, after, and as far back. Returns 0 without memory.
static int sort_boxes(int n, int num_times, const Moved *surface, Sorted *sorted)
{
  *sorted = (Sorted){.n = n, .num = surface->num, .surface = surface};
  sorted->places = malloc((surface->num + 1) * sizeof(struct Place));
  if (!sorted->places || !surface->num)
    return sorted->places != NULL;
  Box all = box_around(n, surface->x);
  for (int s = 0; s < surface->num; ++s)
  {
    Box box = box_of(n, num_times, surface, s);
    add_to_box(n, &all, box.low), add_to_box(n, &all, box.high);
    sorted->places[s] = (struct Place){.box = box, .simplex = s};
  }
  for (int i = 1; i < n; ++i)
    if (all.high[i] - all.low[i] > all.high[sorted->axis] - all.low[sorted->axis])
      sorted->axis = i;
  for (int s = 0; s < surface->num; ++s)
  {
    struct Place *place = sorted->places + s;
    place->start = place->box.low[sorted->axis];
    sorted->widest = larger(sorted->widest, place->box.high[sorted->axis] - place->start);
  }
  qsort(sorted->places, surface->num, sizeof(struct Place), by_start);
  return 1;
}

// The next place, behind one (NULL: the first), whose box meets another one; NULL: none.
static const struct Place *next_near(const Sorted *sorted, const Box *box, const struct Place *place)
{
  int from = 0, to = sorted->num;
  double least = box->low[sorted->axis] - sorted->widest;
  while (!place && from < to)
  {
    int middle = (from + to) / 2;
    *(sorted->places[middle].start < least ? &from : &to) =
        sorted->places[middle].start < least ? middle + 1 : middle;
  }
  place = place ? place + 1 : sorted->places + from;
  for (; place < sorted->places + sorted->num && place->start <= box->high[sorted->axis]; ++place)
    if (boxes_meet(sorted->n, box, &place->box))
      return place;
  return NULL;
}

// Share of a way, from a point, at which it first leaves through a simplex; ∞: nowhere.
//
// beside  simplex whose neighbours don't count; −1: all do, but those on which the point is
static double wall_of(const Sorted *sorted, const double *x, const double *way, int beside)
{
  const Moved *surface = sorted->surface;
  int n = sorted->n;
  double end[3], normal[3], found = INFINITY;
  Box box = box_around(n, x);
  for (int i = 0; i < n; ++i)
    end[i] = x[i] + way[i];
  add_to_box(n, &box, end);
  for (const struct Place *place = NULL; (place = next_near(sorted, &box, place));)
  {
    int s = place->simplex, counts = 1;
    for (int k = 0; beside >= 0 && k < n; ++k)
      for (int l = 0; l < n; ++l)
        counts &= surface->vertices[n * s + k] != surface->vertices[n * beside + l];
    const double *corners = corner(n, surface, 0, s, 0);
    normal_of(n, corners, normal);
    double along = product_of(n, way, normal), high = height_over(n, corners, x, normal);
    if (!counts || !(along > 0 && high > NEARLY_ZERO * along && high <= along))
      continue;
    for (int i = 0; i < n; ++i)
      end[i] = x[i] + high / along * way[i];
    if (high / along < found && is_inside(n, end, corners))
      found = high / along;
  }
  return found;
}

// Both surfaces before they moved; boxes around the other one's ways, and as far back, too.
typedef struct {
  Sorted mine, others, ways, swept;
  int itself;
  double least, facing;
} Walls;

// Whether a point is at a simplex beside that behind whose plane it is, no deeper than half of the
// wall: it slid past an end.
static int is_shallow(const Walls *walls, const double *x0, const double *at, double t, double deep,
                      const double *own_normal, const double *normal)
{
  const Moved *surface = walls->others.surface;
  int n = walls->mine.n;
  Box ball = box_around(n, at);
  for (int i = 0; i < n; ++i)
    ball.low[i] -= deep, ball.high[i] += deep;
  for (const struct Place *place = NULL; (place = next_near(&walls->ways, &ball, place));)
  {
    int s = place->simplex;
    double now[9], shares[3], foot[3], beside[3], way[3], back[3];
    for (int k = 0; k < n * n; ++k)
    {
      double before = corner(n, surface, 0, s, 0)[k];
      now[k] = before + t * (corner(n, surface, 1, s, 0)[k] - before);
    }
    double off = find_nearest_on(n, at, now, shares);
    unit_normal_of(n, corner(n, surface, 0, s, 0), beside);
    if (!(off < deep && product_of(n, own_normal, beside) < NEARLY_ZERO &&
          product_of(n, normal, beside) > walls->facing))
      continue;
    place_at(n, corner(n, surface, 0, s, 0), shares, foot);
    for (int i = 0; i < n; ++i)
      way[i] = 2 * off * beside[i], back[i] = -way[i];
    if (isinf(wall_of(&walls->mine, x0, way, -1)) &&
        isinf(wall_of(&walls->others, foot, back, -1)))
      return 1;
  }
  return 0;
}

// Whether a point that moves, halfway between a simplex i and a corner of it, goes through the middle
// of the wall at a simplex f.
static int passes(const Walls *walls, int i, int k, int f, const Box *swept)
{
  int n = walls->mine.n;
  const Moved *own = walls->mine.surface, *surface = walls->others.surface;
  double x[2][3], normal[2][3], h[2], way[3], back[3], middle[2][9], foot[3] = {0}, at[3], facet[9];
  for (int t = 0; t < 2; ++t)
  {
    for (int a = 0; a < n; ++a)
    {
      double sum = 0;
      for (int c = 0; c < n; ++c)
        sum += corner(n, own, t, i, c)[a];
      x[t][a] = (corner(n, own, t, i, k)[a] + sum / n) / 2;
    }
    unit_normal_of(n, corner(n, surface, t, f, 0), normal[t]);
    h[t] = height_over(n, x[t], corner(n, surface, t, f, 0), normal[t]);
  }
  if (!(h[1] < smaller(2 * h[0], -walls->least))) // else it doesn't come nearer by what it ends behind
    return 0;
  Box ways = box_of(n, 2, surface, f);
  for (int times = 3; times > 1; --times)
  {
    Box box = box_around(n, x[0]);
    add_way(n, times, &box, x[0], x[1]);
    if (!boxes_meet(n, &box, times > 2 ? swept : &ways) && (times > 2 || !(h[0] < 0)))
      return 0;
  }
  for (int a = 0; walls->itself && a < n; ++a)
    for (int b = 0; b < n; ++b)
      if (own->vertices[n * i + a] == surface->vertices[n * f + b])
        return 0;
  double far = 2 * smaller(h[0] - h[1], -h[1]);
  for (int a = 0; a < n; ++a)
  {
    way[a] = far * normal[0][a], back[a] = -way[a];
    for (int c = 0; c < n; ++c)
      foot[a] += corner(n, surface, 0, f, c)[a] / n;
  }
  double deep = smaller(wall_of(&walls->mine, x[0], way, i), wall_of(&walls->others, foot, back, f));
  deep *= far / 2;
  if (!(h[0] > -deep) || isinf(deep))
    return 0;
  for (int t = 0; t < 2; ++t)
    for (int c = 0; c < n * n; ++c)
      middle[t][c] = corner(n, surface, t, f, 0)[c] - deep * normal[t][c % n];
  double low = 0, high = 1, t = 0;
  for (int it = 1; it < DBL_MANT_DIG; ++it) // halving: in space it is a cubic
  {
    t = (low + high) / 2;
    for (int c = 0; c < n * n; ++c)
      facet[c] = middle[0][c] + t * (middle[1][c] - middle[0][c]);
    for (int a = 0; a < n; ++a)
      at[a] = x[0][a] + t * (x[1][a] - x[0][a]);
    double now[3];
    normal_of(n, facet, now);
    *(height_over(n, at, facet, now) > 0 ? &low : &high) = t;
  }
  if (!is_inside(n, at, facet))
    return 0;
  double own_normal[3];
  unit_normal_of(n, corner(n, own, 0, i, 0), own_normal);
  return walls->itself || !is_shallow(walls, x[0], at, t, deep / 2, own_normal, normal[0]);
}

// Find corners of simplices that went through a wall of another surface.
//
// itself  whether both are one surface
// least   depth treated as zero
// facing  cosine from which on facets face the same way
// found   whether the point halfway from the middle to each corner did, (num, n)
int find_passed(int n, const Moved *mine, const Moved *others, int itself, double least,
                double facing, int *found)
{
  Walls walls = {.itself = itself, .least = least, .facing = facing};
  int can = sort_boxes(n, 1, mine, &walls.mine) & sort_boxes(n, 1, others, &walls.others) &
            sort_boxes(n, 2, others, &walls.ways) & sort_boxes(n, 3, others, &walls.swept);
  memset(found, 0, (size_t)mine->num * n * sizeof(int));
  for (int i = 0; can && i < mine->num; ++i)
  {
    Box box = box_of(n, 3, mine, i);
    for (const struct Place *place = NULL; (place = next_near(&walls.swept, &box, place));)
      for (int k = 0; k < n; ++k)
        found[n * i + k] = found[n * i + k] || passes(&walls, i, k, place->simplex, &place->box);
  }
  free(walls.mine.places), free(walls.others.places);
  free(walls.ways.places), free(walls.swept.places);
  return can ? DONE : NO_MEMORY;
}
