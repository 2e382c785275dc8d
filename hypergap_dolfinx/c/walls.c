// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Vertices that went through a wall of another surface (surface/moving.py).

#include "walls.h"

#include <float.h>
#include <stdlib.h>
#include <string.h>

#include "vectors.h"

#define NEARLY_ZERO sqrt(DBL_EPSILON)

typedef struct {
  double low[3], high[3];
} Box;

typedef struct {
  Box box;
  double start; // along the axis
  int simplex;
} Place;

// Boxes around simplices, in the order in which they begin along an axis.
typedef struct {
  const Moved *surface;
  int axis;
  double widest;
  Place *places;
} Sorted;

// Both surfaces before they moved; boxes around the other one's ways, and as far back, too.
typedef struct {
  Sorted mine, others, ways, swept;
  int itself;
  double least, facing;
} Walls;

static const double *corners_of(const Moved *surface, int t, int simplex)
{
  return surface->x + 3 * surface->n * ((size_t)surface->num * t + simplex);
}

static void add_to_box(Box *box, const double *x)
{
  for (int i = 0; i < 3; ++i)
    box->low[i] = smaller(box->low[i], x[i]), box->high[i] = larger(box->high[i], x[i]);
}

// x + α (y − x)
static void between(const double *x, const double *y, double alpha, double *z)
{
  for (int i = 0; i < 3; ++i)
    z[i] = x[i] + alpha * (y[i] - x[i]);
}

// A box around points at the first one, two or three of these times: before, after, and as far back.
static Box box_of(int num_times, int num, const double *before, const double *after)
{
  static const double times[] = {0, 1, -1};
  Box box = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
  double x[3];
  for (int t = 0; t < num_times; ++t)
    for (int k = 0; k < num; ++k)
    {
      between(before + 3 * k, after + 3 * k, times[t], x);
      add_to_box(&box, t == 1 ? after + 3 * k : x);
    }
  return box;
}

static int boxes_meet(const Box *a, const Box *b)
{
  for (int i = 0; i < 3; ++i)
    if (!(a->low[i] <= b->high[i] && b->low[i] <= a->high[i]))
      return 0;
  return 1;
}

// (a − b) · n
static double height_over(const double *a, const double *b, const double *normal)
{
  double d[3];
  minus(a, b, d);
  return dot(d, normal);
}

// Normal of a simplex, as long as an edge or as twice the area of a triangle; of length one.
static void normal_of(int n, const double *x, int unit, double *normal)
{
  double e[3], f[3] = {0, 0, 1};
  minus(x + 3, x, e);
  if (n > 2)
    minus(x + 6, x, f);
  cross(e, f, normal);
  double size = unit ? larger(sqrt(dot(normal, normal)), DBL_MIN) : 1;
  for (int i = 0; i < 3; ++i)
    normal[i] /= size;
}

// Shares of a simplex' corners in the foot of a point in its plane; the least one.
static double find_shares(int n, const double *x, const double *corners, double *shares)
{
  double e[2][3] = {{0}}, d[2] = {0};
  for (int k = 0; k < n - 1; ++k)
  {
    minus(corners + 3 * (k + 1), corners, e[k]);
    d[k] = height_over(x, corners, e[k]);
  }
  double a = dot(e[0], e[0]), b = dot(e[0], e[1]), c = dot(e[1], e[1]), det = a * c - b * b;
  double square = (a + c) * (a + c);
  shares[1] = shares[2] = 0;
  if (det > DBL_EPSILON * square)
    shares[1] = (c * d[0] - b * d[1]) / det, shares[2] = (a * d[1] - b * d[0]) / det;
  else if (square > 0) // an edge, or as narrow as one
    shares[1] = (a * d[0] + b * d[1]) / square, shares[2] = (b * d[0] + c * d[1]) / square;
  shares[0] = 1 - shares[1] - shares[2];
  return smaller(shares[0], smaller(shares[1], n > 2 ? shares[2] : shares[1]));
}

static int is_inside(int n, const double *x, const double *corners)
{
  double shares[3];
  return find_shares(n, x, corners, shares) >= -NEARLY_ZERO;
}

// Place on a simplex that is nearest to a point, by its corners' shares; the distance.
static double find_nearest_on(int n, const double *x, const double *corners, double *shares)
{
  double nearest = INFINITY, at[3], off[3];
  if (find_shares(n, x, corners, shares) >= 0)
  {
    for (int i = 0; i < 3; ++i)
      off[i] = x[i] - shares[0] * corners[i] - shares[1] * corners[3 + i] -
               (n > 2 ? shares[2] * corners[6 + i] : 0);
    return sqrt(dot(off, off));
  }
  for (int k = 0; k < n; ++k)
  {
    const double *a = corners + 3 * k, *b = corners + 3 * ((k + 1) % n);
    double e[3], s;
    minus(b, a, e);
    s = smaller(larger(height_over(x, a, e) / larger(dot(e, e), DBL_MIN), 0), 1);
    between(a, b, s, at);
    minus(x, at, off);
    if (!(sqrt(dot(off, off)) < nearest))
      continue;
    nearest = sqrt(dot(off, off));
    shares[0] = shares[1] = shares[2] = 0, shares[k] = 1 - s, shares[(k + 1) % n] = s;
  }
  return nearest;
}

static int by_start(const void *a, const void *b)
{
  double one = ((const Place *)a)->start, two = ((const Place *)b)->start;
  return (one > two) - (one < two);
}

// Boxes of so many times. Returns 0 without memory.
static int sort_boxes(int num_times, const Moved *surface, Sorted *sorted)
{
  Box all = box_of(1, surface->n * surface->num, surface->x, surface->x);
  *sorted = (Sorted){.surface = surface, .places = malloc((surface->num + 1) * sizeof(Place))};
  for (int i = 1; i < 3; ++i)
    if (all.high[i] - all.low[i] > all.high[sorted->axis] - all.low[sorted->axis])
      sorted->axis = i;
  for (int s = 0; sorted->places && s < surface->num; ++s)
  {
    Box box = box_of(num_times, surface->n, corners_of(surface, 0, s), corners_of(surface, 1, s));
    double size = 0;
    for (int i = 0; i < 3; ++i)
      size = larger(size, box.high[i] - box.low[i]);
    for (int i = 0; i < 3; ++i) // as far as points count as inside
      box.low[i] -= NEARLY_ZERO * size, box.high[i] += NEARLY_ZERO * size;
    sorted->places[s] = (Place){box, box.low[sorted->axis], s};
    sorted->widest = larger(sorted->widest, box.high[sorted->axis] - box.low[sorted->axis]);
  }
  if (sorted->places)
    qsort(sorted->places, surface->num, sizeof(Place), by_start);
  return sorted->places != NULL;
}

// The next place, behind one (NULL: the first), whose box meets another one; NULL: none.
static const Place *next_near(const Sorted *sorted, const Box *box, const Place *place)
{
  const Place *from = sorted->places, *end = from + sorted->surface->num, *to = end;
  while (!place && from < to)
  {
    const Place *middle = from + (to - from) / 2;
    if (middle->start < box->low[sorted->axis] - sorted->widest)
      from = middle + 1;
    else
      to = middle;
  }
  for (place = place ? place + 1 : from; place < end && place->start <= box->high[sorted->axis]; ++place)
    if (boxes_meet(box, &place->box))
      return place;
  return NULL;
}

// Share of a way, from a point, at which it first leaves through a simplex; ∞: nowhere.
//
// beside  simplex whose neighbours don't count; −1: all do, but those on which the point is
static double wall_of(const Sorted *sorted, const double *x, const double *normal, double far,
                      int beside)
{
  const Moved *surface = sorted->surface;
  int n = surface->n;
  double end[3], way[3], at[3], own[3], found = INFINITY;
  for (int i = 0; i < 3; ++i)
    way[i] = far * normal[i], end[i] = x[i] + way[i];
  Box box = box_of(2, 1, x, end);
  for (const Place *place = NULL; (place = next_near(sorted, &box, place));)
  {
    const double *corners = corners_of(surface, 0, place->simplex);
    normal_of(n, corners, 0, own);
    double along = dot(way, own), high = height_over(corners, x, own);
    int counts = along > NEARLY_ZERO * sqrt(dot(way, way) * dot(own, own)) && // else it is parallel
                 high > NEARLY_ZERO * along && high <= along;
    for (int k = 0; beside >= 0 && k < n * n; ++k)
      counts &= surface->vertices[n * place->simplex + k / n] != surface->vertices[n * beside + k % n];
    if (!counts || high / along >= found)
      continue;
    for (int i = 0; i < 3; ++i)
      at[i] = x[i] + high / along * way[i];
    if (is_inside(n, at, corners))
      found = high / along;
  }
  return found;
}

// Whether a point is at a simplex beside that behind whose plane it is, no deeper than half of the
// wall: it slid past an end.
static int is_shallow(const Walls *walls, const double *x0, const double *at, double t, double deep,
                      const double *own_normal, const double *normal)
{
  const Moved *surface = walls->others.surface;
  int n = surface->n;
  Box ball = box_of(1, 1, at, at);
  for (int i = 0; i < 3; ++i)
    ball.low[i] -= deep, ball.high[i] += deep;
  for (const Place *place = NULL; (place = next_near(&walls->ways, &ball, place));)
  {
    const double *before = corners_of(surface, 0, place->simplex);
    double now[9], shares[3], foot[3] = {0}, beside[3];
    for (int k = 0; k < n; ++k)
      between(before + 3 * k, corners_of(surface, 1, place->simplex) + 3 * k, t, now + 3 * k);
    double off = find_nearest_on(n, at, now, shares);
    normal_of(n, before, 1, beside);
    if (!(off < deep && dot(own_normal, beside) < NEARLY_ZERO && dot(normal, beside) > walls->facing))
      continue;
    for (int k = 0; k < 3 * n; ++k)
      foot[k % 3] += shares[k / 3] * before[k];
    if (isinf(wall_of(&walls->mine, x0, beside, 2 * off, -1)) &&
        isinf(wall_of(&walls->others, foot, beside, -2 * off, -1)))
      return 1;
  }
  return 0;
}

// Whether a point that moves, halfway between a simplex i and a corner of it, goes through the middle
// of the wall at a simplex.
static int passes(const Walls *walls, int i, int k, const Place *place)
{
  const Moved *own = walls->mine.surface, *others = walls->others.surface;
  int n = own->n, f = place->simplex;
  double x[2][3] = {{0}}, normal[2][3], own_normal[3], h[2], foot[3] = {0}, middle[2][9], facet[9], at[3];
  for (int t = 0; t < 2; ++t)
  {
    const double *mine = corners_of(own, t, i);
    for (int c = 0; c < 3 * n; ++c)
      x[t][c % 3] += (mine[c] / n + (c / 3 == k ? mine[c] : 0)) / 2;
    normal_of(n, corners_of(others, t, f), 1, normal[t]);
    h[t] = height_over(x[t], corners_of(others, t, f), normal[t]);
  }
  if (!(h[1] < smaller(2 * h[0], -walls->least))) // else it doesn't come nearer by what it ends behind
    return 0;
  Box swept = box_of(3, 1, x[0], x[1]), way = box_of(2, 1, x[0], x[1]);
  Box other = box_of(2, n, corners_of(others, 0, f), corners_of(others, 1, f));
  if (!boxes_meet(&swept, &place->box) || !(h[0] < 0 || boxes_meet(&way, &other)))
    return 0;
  for (int c = 0; walls->itself && c < n * n; ++c)
    if (own->vertices[n * i + c / n] == others->vertices[n * f + c % n])
      return 0;
  for (int c = 0; c < 3 * n; ++c)
    foot[c % 3] += corners_of(others, 0, f)[c] / n;
  double far = 2 * smaller(h[0] - h[1], -h[1]);
  double deep = smaller(wall_of(&walls->mine, x[0], normal[0], far, i),
                        wall_of(&walls->others, foot, normal[0], -far, f)) * far / 2;
  if (!(h[0] > -deep) || isinf(deep))
    return 0;
  for (int t = 0; t < 2; ++t)
    for (int c = 0; c < 3 * n; ++c)
      middle[t][c] = corners_of(others, t, f)[c] - deep * normal[t][c % 3];
  double low = 0, high = 1, t = 0, now[3];
  for (int it = 1; it < DBL_MANT_DIG; ++it) // halving: in space it is a cubic
  {
    t = (low + high) / 2;
    for (int c = 0; c < n; ++c)
      between(middle[0] + 3 * c, middle[1] + 3 * c, t, facet + 3 * c);
    between(x[0], x[1], t, at);
    normal_of(n, facet, 0, now);
    *(height_over(at, facet, now) > 0 ? &low : &high) = t;
  }
  normal_of(n, corners_of(own, 0, i), 1, own_normal);
  return is_inside(n, at, facet) &&
         (walls->itself || !is_shallow(walls, x[0], at, t, deep / 2, own_normal, normal[0]));
}

// Find corners of simplices that went through a wall of another surface.
//
// itself  whether both are one surface
// least   depth treated as zero
// facing  cosine from which on facets face the same way
// found   whether the point halfway from the middle to each corner did, (num, n)
int find_passed(const Moved *mine, const Moved *others, int itself, double least, double facing,
                int *found)
{
  Walls walls = {.itself = itself, .least = least, .facing = facing};
  int n = mine->n, can = sort_boxes(1, mine, &walls.mine) & sort_boxes(1, others, &walls.others) &
                         sort_boxes(2, others, &walls.ways) & sort_boxes(3, others, &walls.swept);
  memset(found, 0, (size_t)mine->num * n * sizeof(int));
  for (int i = 0; can && i < mine->num; ++i)
  {
    Box box = box_of(3, n, corners_of(mine, 0, i), corners_of(mine, 1, i));
    for (const Place *place = NULL; (place = next_near(&walls.swept, &box, place));)
      for (int k = 0; k < n; ++k)
        found[n * i + k] = found[n * i + k] || passes(&walls, i, k, place);
  }
  free(walls.mine.places), free(walls.others.places);
  free(walls.ways.places), free(walls.swept.places);
  return can ? DONE : NO_MEMORY;
}
