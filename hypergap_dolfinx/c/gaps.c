// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Weighted gaps and slips in the plane (contact_geometry/rays.py), and their derivatives by dofs.

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "jets.h"
#include "rays.h"
#include "vectors.h"

#define MOST_LOCAL (MOST_DOFS * (7 * MOST_SHEETS + 4) + 2)

// The dofs with which a point moves: those of its edge, of its sheets, and of its piece's ends.
typedef struct {
  int num, dofs[MOST_LOCAL];
  // Numbers among them
  int own[MOST_DOFS], of_sheet[MOST_SHEETS][MOST_DOFS], of_foot[MOST_DOFS], of_end[2];
  int of_beside[MOST_SHEETS][2][MOST_DOFS], of_fade[2][MOST_DOFS];
  int of_goes_on[MOST_SHEETS][2][MOST_DOFS], of_dip[MOST_SHEETS][2][MOST_DOFS];
} Local;

// A point where it is, as jets. Lengths are in chords |c| of its edge, or times them.
typedef struct {
  const Point *point;
  Jet c[2], square;        // the chord, and c · c
  Jet width;               // weight of the quadrature times the piece's length
  Curve curve, curves[MOST_SHEETS];
  Jet s, r[MOST_SHEETS];   // reference coordinates
  Jet share;               // of the edge's end; NULL: 0 or 1
  Jet volume;              // width · Σ visible height
  Jet covered;             // width · Σ visible
  double heights[MOST_SHEETS]; // of sheets, times the length of the chord
  Jet visible[MOST_SHEETS]; // weight of a sheet times what others leave of it; NULL: 1
  Jet arcs[MOST_SHEETS];   // of bodies of revolution, in the middle of the ray; NULL: 1
  double arc;              // the same on Γ1
} Ray;

static void add(Entries *entries, int row, int column, double value)
{
  int k = entries->last + 1; // as at the last point
  if (k < 0 || k >= entries->num || k >= entries->max || entries->rows[k] != row ||
      entries->columns[k] != column)
    k = entries->first[row];
  while (k >= 0 && entries->columns[k] != column)
    k = entries->next[k];
  entries->last = k >= 0 ? k : entries->num;
  if (k >= 0)
  {
    entries->values[k] += value;
    return;
  }
  k = entries->num++;
  if (k >= entries->max)
    return;
  entries->rows[k] = row, entries->columns[k] = column, entries->values[k] = value;
  entries->next[k] = entries->first[row], entries->first[row] = k;
}

// Number of a dof among a point's; it gets one if it has none.
static int number_of(Local *local, int dof)
{
  int k = 0;
  while (k < local->num && local->dofs[k] != dof)
    ++k;
  if (k == local->num)
    local->dofs[local->num++] = dof;
  return k;
}

static void number_edge(Local *local, const Side *side, int edge, int *numbers)
{
  for (int a = 0; a < side->num_dofs; ++a)
    numbers[a] = number_of(local, side->dofs[edge * side->num_dofs + a]);
}

static void gather(const Sigma *sigma, const Point *point, Local *local)
{
  const Side *below = sigma->sides;
  local->num = 0;
  number_edge(local, sigma->sides + 1, point->edge, local->own);
  for (int k = 0; k < point->num; ++k)
  {
    const Sheet *sheet = sigma->sheets + point->first + k;
    number_edge(local, below, sheet->edge, local->of_sheet[k]);
    for (int e = 0; e < 2; ++e)
    {
      if (sheet->beside[e] >= 0)
        number_edge(local, below, sheet->beside[e], local->of_beside[k][e]);
      if (sheet->goes_on[e] < 0)
        continue;
      number_edge(local, below, sheet->goes_on[e], local->of_goes_on[k][e]);
      if (sheet->dips[e] >= 0)
        number_edge(local, below, sheet->dips[e], local->of_dip[k][e]);
    }
  }
  if (point->foot >= 0)
    number_edge(local, below, point->foot, local->of_foot);
  for (int e = 0; e < 2; ++e)
  {
    int v = point->ends[e];
    if (point->fades[e] >= 0)
      number_edge(local, below, point->fades[e], local->of_fade[e]);
    if (v < 0)
      continue;
    int end, edge = edge_at(below, v, &end);
    local->of_end[e] = number_of(local, below->dofs[edge * below->num_dofs + end]);
  }
}

// A component of a point of an edge (k = 0), or of its derivative by s (k = 1).
static Jet on_curve(Tape *tape, const Curve *curve, int num, const int *numbers, Jet s, int k, int i)
{
  const double f[] = {curve->x[k][i], curve->x[k + 1][i], curve->x[k + 2][i]}, none[3] = {0};
  Jet own = placed(tape, 1, &s, f, num, numbers, 2, i,
                   (const double *[]){curve->N[k], curve->N[k + 1]});
  if (!curve->turns)
    return own;
  double M[2][2];
  for (int d = 0; d < 2; ++d)
    for (int a = 0; a < 2; ++a)
      M[d][a] = a == i ? curve->across[k + d] : -curve->across[k + d];
  Jet other = placed(tape, 1, &s, none, 2, numbers, 2, 1 - i, (const double *[]){M[0], M[1]});
  return combined(tape, 1, own, 1, other);
}

// A vertex, from another point.
static Jet vertex_at(Tape *tape, const double *x, const double *origin, const int *number, int i)
{
  return placed(tape, 0, NULL, (double[]){x[i] - origin[i]}, 1, number, 2, i,
                (const double *[]){(double[]){1}});
}

// a · b of vectors
static Jet dotted(Tape *tape, Jet const *a, Jet const *b)
{
  return combined(tape, 1, product(tape, a[0], b[0]), 1, product(tape, a[1], b[1]));
}

// Reference coordinate of a point of an edge opposite of a place: (x(s) − a) · c = ξ c · c. Newton's
// method from its value: each step gives one order of derivatives.
//
// to   ξ c · c
// a    where the chord starts
static Jet met(Tape *tape, const Curve *curve, int num, const int *numbers, double s, Jet const *a,
               Jet const *c, const double *to)
{
  Jet found = constant(tape, s);
  double slope = curve->x[1][0] * c[0][0] + curve->x[1][1] * c[1][0];
  for (int k = 0; k < tape->order; ++k)
  {
    Jet x[2];
    for (int i = 0; i < 2; ++i)
      x[i] = combined(tape, 1, on_curve(tape, curve, num, numbers, found, 0, i), -1, a[i]);
    Jet error = combined(tape, 1, dotted(tape, x, c), -1, to);
    found = combined(tape, 1, found, -1 / slope, error);
    found[0] = s;
  }
  return found;
}

// Depth of a point in Γ0's body by what is nearest.
static Jet depth_of(Tape *tape, const Sigma *sigma, const Point *point, const Local *local,
                    const double *origin, Jet const *x)
{
  const Side *below = sigma->sides;
  Jet d[2], c[2];
  for (int e = 1; e >= 0; --e)
  {
    double s = below->node_at[point->nodes[e]];
    Curve curve = curve_at(below, point->foot, s, origin);
    Jet at = constant(tape, s);
    for (int i = 0; i < 2; ++i)
    {
      Jet y = on_curve(tape, &curve, below->num_dofs, local->of_foot, at, 0, i);
      if (e)
        c[i] = y;
      else
        c[i] = combined(tape, 1, c[i], -1, y), d[i] = combined(tape, 1, x[i], -1, y);
    }
  }
  if (point->nodes[0] == point->nodes[1])
  {
    Jet square = dotted(tape, d, d);
    if (square[0] == 0)
      return constant(tape, 0); // at the node
    Jet far = power(tape, square, 0.5);
    return scaled(tape, point->sign, far);
  }
  Jet inside = product(tape, wedge(tape, c, d), power(tape, dotted(tape, c, c), -0.5));
  if (point->sign < 2)
    return inside;
  for (int i = 0; i < 2 && point->sign > 2; ++i)
    d[i] = combined(tape, 1, d[i], -1, c[i]);
  return combined(tape, 5, inside, -4, power(tape, dotted(tape, d, d), 0.5));
}

// Cosine between a chord's normal and the one against that of a vector.
static Jet cosine_with(Tape *tape, const Ray *ray, Jet const *t)
{
  Jet both = power(tape, product(tape, dotted(tape, t, t), ray->square), -0.5);
  return product(tape, scaled(tape, -1, dotted(tape, t, ray->c)), both);
}

// The same with an edge's, at a point.
static Jet cosine_of(Tape *tape, const Ray *ray, const Curve *curve, int num, const int *numbers,
                     Jet r)
{
  Jet t[2];
  for (int i = 0; i < 2; ++i)
    t[i] = on_curve(tape, curve, num, numbers, r, 1, i);
  return cosine_with(tape, ray, t);
}

// The same with an edge's own chord.
static Jet chord_cosine_of(Tape *tape, const Sigma *sigma, const Ray *ray, int edge,
                           const int *numbers)
{
  const Side *below = sigma->sides;
  const double *origin = node(below + 1, ray->point->edge, 0);
  Jet t[2];
  for (int e = 0; e < 2; ++e)
  {
    Curve curve = curve_at(below, edge, e, origin);
    for (int i = 0; i < 2; ++i)
    {
      Jet x = on_curve(tape, &curve, below->num_dofs, numbers, constant(tape, e), 0, i);
      t[i] = e ? combined(tape, 1, x, -1, t[i]) : x;
    }
  }
  return cosine_with(tape, ray, t);
}

// Place along a chord where an edge of Γ0 has the cosine that it has at r. Newton's method, as above.
static Jet fade_at(Tape *tape, const Ray *ray, const Curve *curve, int num, const int *numbers,
                   double r, Jet const *a)
{
  Jet found = constant(tape, r), level = NULL, x[2];
  const double *t = curve->x[1], *bent = curve->x[2], c[2] = {ray->c[0][0], ray->c[1][0]};
  double square = t[0] * t[0] + t[1] * t[1], along = (t[0] * bent[0] + t[1] * bent[1]) / square;
  double slope = (along * t[0] - bent[0]) * c[0] + (along * t[1] - bent[1]) * c[1];
  slope /= sqrt(square * ray->square[0]);
  for (int k = 0; k < tape->order; ++k)
  {
    Jet cos = cosine_of(tape, ray, curve, num, numbers, found);
    level = level ? level : constant(tape, cos[0]);
    found = combined(tape, 1, found, -1 / slope, combined(tape, 1, cos, -1, level));
    found[0] = r;
  }
  for (int i = 0; i < 2; ++i)
    x[i] = combined(tape, 1, on_curve(tape, curve, num, numbers, found, 0, i), -1, a[i]);
  return quotient(tape, dotted(tape, x, ray->c), ray->square);
}

// Weight by an edge's normal.
//
// cos     there
// height  times |c|
// inside  depth by what is nearest, with the slack, times |c|; NULL: it doesn't matter
static Jet weight_with(Tape *tape, const Sigma *sigma, const Ray *ray, int edge, const int *numbers,
                       Jet cos, Jet height, Jet inside)
{
  Jet weight = step_of(tape, cos, sigma->cosines);
  if (!inside || height[0] >= 0 || weight[0] <= 0)
    return weight;
  Jet flat = sigma->sides->num_nodes == 2
                 ? cos
                 : chord_cosine_of(tape, sigma, ray, edge, numbers);
  Jet part = quotient(tape, scaled(tape, -1, inside), product(tape, height, flat));
  Jet near = step_of(tape, part, (double[]){0, 1});
  Jet across = combined(tape, 1, flat, -sigma->slack, quotient(tape, ray->square, height));
  return product(tape, weight, step_of(tape, product(tape, near, across), sigma->nearest));
}

// Weight of what a riser leads to before (0) or behind it (1).
//
// x  start of the ray
static Jet weight_beyond(Tape *tape, const Sigma *sigma, const Ray *ray, int k, int way,
                         const Local *local, Jet const *x, Jet inside)
{
  const Side *below = sigma->sides;
  const Sheet *sheet = sigma->sheets + ray->point->first + k;
  const double *origin = node(below + 1, ray->point->edge, 0);
  const int *numbers = local->of_goes_on[k][way];
  Jet end = constant(tape, 1 - way), d[2];
  Curve curve = curve_at(below, sheet->goes_on[way], 1 - way, origin);
  for (int i = 0; i < 2; ++i)
    d[i] = combined(tape, 1, on_curve(tape, &curve, below->num_dofs, numbers, end, 0, i), -1, x[i]);
  Jet cos = cosine_of(tape, ray, &curve, below->num_dofs, numbers, end);
  Jet height = wedge(tape, d, ray->c);
  Jet weight = weight_with(tape, sigma, ray, sheet->goes_on[way], numbers, cos, height, inside);
  if (sheet->dips[way] < 0)
    return weight;
  curve = curve_at(below, sheet->dips[way], 0, origin);
  cos = cosine_of(tape, ray, &curve, below->num_dofs, local->of_dip[k][way], constant(tape, 0));
  return product(tape, weight, step_of(tape, cos, (double[]){-sigma->cosines[0], 0}));
}

// Weight of a sheet that turns away, without its sign, and what it uncovers of what is behind it.
static Jet weight_of_back(Tape *tape, const Sigma *sigma, const Ray *ray, int k, const Local *local,
                          Jet const *x, Jet inside, Jet *open)
{
  const Side *below = sigma->sides;
  const Sheet *sheet = sigma->sheets + ray->point->first + k;
  Jet cos = cosine_of(tape, ray, ray->curves + k, below->num_dofs, local->of_sheet[k], ray->r[k]);
  *open = step_of(tape, cos, (double[]){-sigma->cosines[0], 0});
  int way = sheet->goes_on[1] >= 0;
  return product(tape, *open, weight_beyond(tape, sigma, ray, k, way, local, x, inside));
}

// Weight of a sheet: NULL if it is 1.
static Jet weight_of(Tape *tape, const Sigma *sigma, const Ray *ray, int k, const Local *local,
                     Jet height, Jet const *x, Jet inside)
{
  const Side *below = sigma->sides;
  const Sheet *sheet = sigma->sheets + ray->point->first + k;
  int num = below->num_dofs;
  const double *origin = node(below + 1, ray->point->edge, 0), *t = ray->curves[k].x[1];
  double facing = -(t[0] * ray->c[0][0] + t[1] * ray->c[1][0]);
  facing /= sqrt((t[0] * t[0] + t[1] * t[1]) * ray->square[0]);
  if (facing >= sigma->cosines[1] && (!inside || height[0] >= 0))
    return NULL;
  Jet cos = cosine_of(tape, ray, ray->curves + k, num, local->of_sheet[k], ray->r[k]);
  Jet own = weight_with(tape, sigma, ray, sheet->edge, local->of_sheet[k], cos, height, inside);
  Jet of_others = NULL;
  if (own[0] >= 1)
    return NULL;
  for (int e = 0; e < 2; ++e)
  {
    if (sheet->beside[e] < 0)
      continue;
    Curve curve = curve_at(below, sheet->beside[e], 1 - e, origin);
    const int *numbers = local->of_beside[k][e];
    Jet other = cosine_of(tape, ray, &curve, num, numbers, constant(tape, 1 - e));
    other = weight_with(tape, sigma, ray, sheet->beside[e], numbers, other, height, inside);
    Jet at = e ? ray->r[k] : combined(tape, -1, ray->r[k], 1, constant(tape, 1));
    other = product(tape, at, other);
    of_others = of_others ? combined(tape, 1, of_others, 1, other) : other;
  }
  Jet faces = step_of(tape, cos, (double[]){0.5 * sigma->cosines[0], sigma->cosines[0]});
  Jet more = constant(tape, 0), lacks = combined(tape, -1, own, 1, constant(tape, 1));
  if (of_others)
    more = product(tape, faces, of_others);
  if (sheet->goes_on[0] >= 0)
  {
    Jet beyond = product(tape, weight_beyond(tape, sigma, ray, k, 0, local, x, inside),
                         weight_beyond(tape, sigma, ray, k, 1, local, x, inside));
    beyond = product(tape, combined(tape, -1, faces, 1, constant(tape, 1)), beyond);
    more = combined(tape, 1, more, 1, beyond);
  }
  return combined(tape, 1, own, 1, product(tape, lacks, more));
}

// A point's ray as jets.
static void ray_at(Tape *tape, const Sigma *sigma, const Point *point, const Local *local, Ray *ray)
{
  const Side *below = sigma->sides, *above = below + 1;
  const double *origin = node(above, point->edge, 0);
  ray->point = point, ray->arc = 1, ray->share = ray->volume = ray->covered = NULL;
  const int *ends = above->end_dofs + 2 * (point->edge % above->num_parts);
  Jet a[2], x1[2], xi[2], hidden = NULL;
  for (int i = 0; i < 2; ++i)
  {
    a[i] = vertex_at(tape, origin, origin, local->own + ends[0], i);
    Jet b = vertex_at(tape, node(above, point->edge, 1), origin, local->own + ends[1], i);
    ray->c[i] = combined(tape, 1, b, -1, a[i]);
  }
  ray->square = dotted(tape, ray->c, ray->c);
  for (int e = 0; e < 2; ++e)
  {
    int v = point->ends[e];
    if (point->fades[e] >= 0)
    {
      Curve curve = curve_at(below, point->fades[e], point->at_fades[e], origin);
      xi[e] = fade_at(tape, ray, &curve, below->num_dofs, local->of_fade[e], point->at_fades[e], a);
      continue;
    }
    if (v < 0)
    {
      xi[e] = constant(tape, point->places[e]);
      continue;
    }
    Jet d[2];
    for (int i = 0; i < 2; ++i)
    {
      Jet x = vertex_at(tape, position(below, v), origin, local->of_end + e, i);
      d[i] = combined(tape, 1, x, -1, a[i]);
    }
    xi[e] = quotient(tape, dotted(tape, d, ray->c), ray->square);
  }
  ray->width = combined(tape, point->width, xi[1], -point->width, xi[0]);
  Jet at = combined(tape, 1 - point->at, xi[0], point->at, xi[1]);
  Jet to = product(tape, at, ray->square);
  if (point->part == 2)
  {
    double from = sigma->shared[0], size = sigma->shared[1] - from;
    ray->share = combined(tape, 1 / size, at, -from / size, constant(tape, 1));
  }
  ray->curve = curve_at(above, point->edge, point->s, origin);
  ray->s = above->num_nodes == 2
              ? at
              : met(tape, &ray->curve, above->num_dofs, local->own, point->s, a, ray->c, to);
  for (int i = 0; i < 2; ++i)
    x1[i] = on_curve(tape, &ray->curve, above->num_dofs, local->own, ray->s, 0, i);
  if (sigma->angle > 0)
    ray->arc = sigma->angle * (origin[0] + x1[0][0]);
  Jet inside = NULL;
  if (point->foot >= 0)
  {
    Jet chord = power(tape, ray->square, 0.5), depth = depth_of(tape, sigma, point, local, origin, x1);
    inside = product(tape, combined(tape, 1, depth, sigma->slack, chord), chord);
  }
  for (int k = 0; k < point->num; ++k)
  {
    const Sheet *sheet = sigma->sheets + point->first + k;
    const int *numbers = local->of_sheet[k];
    Jet d[2];
    ray->curves[k] = curve_at(below, sheet->edge, sheet->r, origin);
    ray->r[k] = met(tape, ray->curves + k, below->num_dofs, numbers, sheet->r, a, ray->c, to);
    for (int i = 0; i < 2; ++i)
    {
      Jet x0 = on_curve(tape, ray->curves + k, below->num_dofs, numbers, ray->r[k], 0, i);
      d[i] = combined(tape, 1, x0, -1, x1[i]);
    }
    Jet height = wedge(tape, d, ray->c);
    Jet part, open;
    if (sheet->turns_away)
    {
      Jet weight = weight_of_back(tape, sigma, ray, k, local, x1, inside, &open);
      Jet seen = combined(tape, -1, hidden, 1, constant(tape, 1));
      part = scaled(tape, -1, product(tape, weight, seen));
      hidden = combined(tape, 1, hidden, 1, product(tape, open, seen));
    }
    else
    {
      Jet weight = weight_of(tape, sigma, ray, k, local, height, x1, inside);
      part = weight && hidden ? product(tape, weight, hidden) : weight ? weight : hidden;
      Jet left = weight ? combined(tape, -1, weight, 1, constant(tape, 1)) : constant(tape, 0);
      hidden = hidden ? product(tape, hidden, left) : left;
    }
    ray->visible[k] = part;
    part = part ? product(tape, part, ray->width) : ray->width;
    ray->heights[k] = height[0];
    ray->arcs[k] = NULL;
    height = product(tape, part, height);
    if (sigma->angle > 0)
    {
      Jet middle = combined(tape, 1, x1[0], 0.5, d[0]);
      ray->arcs[k] = combined(tape, sigma->angle, middle, sigma->angle * origin[0],
                             constant(tape, 1));
      height = product(tape, ray->arcs[k], height);
    }
    ray->covered = ray->covered ? combined(tape, 1, ray->covered, 1, part) : part;
    ray->volume = ray->volume ? combined(tape, 1, ray->volume, 1, height) : height;
  }
}

// Find a point's ray; 0 without memory.
static int next_ray(Tape *tape, int order, const Sigma *sigma, const Point *point, Local *local,
                    Ray *ray)
{
  gather(sigma, point, local);
  if (!start_tape(tape, 2 * local->num, order))
    return 0;
  ray_at(tape, sigma, point, local, ray);
  return !tape->failed;
}

static int component_of(const Local *local, int k)
{
  return 2 * local->dofs[k / 2] + k % 2;
}

static void add_row(const Local *local, int row, const double *jet, Entries *rows)
{
  for (int k = 0; k < 2 * local->num; ++k)
    if (jet[1 + k] != 0)
      add(rows, row, component_of(local, k), jet[1 + k]);
}

// What of a jet belongs to the start (0) or to the end (1) of its edge.
static Jet shared(Tape *tape, const Ray *ray, Jet jet, int end)
{
  if (!ray->share)
    return jet;
  Jet of_end = product(tape, ray->share, jet);
  return end ? of_end : combined(tape, 1, jet, -1, of_end);
}

// Slip of Γ1 on Γ0 along a point's chord, against its direction, or what parts them across it: by
// a component of a motion of Γ0 there.
static Jet slip_by(Tape *tape, const Ray *ray, int i, int sheet, int across)
{
  Jet slip = product(tape, ray->c[across ? 1 - i : i], ray->width);
  if (ray->visible[sheet])
    slip = product(tape, slip, ray->visible[sheet]);
  if (ray->arcs[sheet])
    slip = product(tape, slip, ray->arcs[sheet]);
  return across && i == 1 ? scaled(tape, -1, slip) : slip;
}

// Times a function of the reference coordinate, with two derivatives.
static Jet times(Tape *tape, double sign, const double *f, const double *s, const double *jet)
{
  const double signed_f[] = {sign * f[0], sign * f[1], sign * f[2]};
  return product(tape, composed(tape, s, signed_f), jet);
}

// What is done with the jets that multiply components of dofs in the slips of points.
typedef struct {
  const Local *local;
  Tape *tape;
  const Ray *ray;
  int across;
  const int *vertices; // of halves
  const double *moved, *q;
  Jet by_moved; // the slip by Δu, if that is given
  Entries *entries;
} Slip;

static void take(const Slip *slip, int number, int i, Jet jet)
{
  const Local *local = slip->local;
  int dof = 2 * local->dofs[number] + i, edge = slip->ray->point->edge;
  for (int e = 0; e < 2; ++e)
  {
    int half = 2 * edge + e;
    if (slip->ray->point->part == 1 - e)
      continue;
    Jet part = shared(slip->tape, slip->ray, jet, e);
    if (!slip->q)
      add(slip->entries, slip->vertices[half], dof, part[0]);
    for (int k = 0; slip->q && slip->q[half] != 0 && k < 2 * local->num; ++k)
      add(slip->entries, dof, component_of(local, k), slip->q[half] * part[1 + k]);
  }
}

// What a component of the motion of a point of an edge is made of: components of dofs.
static void take_point(const Slip *slip, const Side *side, const Curve *curve, const double *s,
                       const int *numbers, int i, double sign, const double *by)
{
  size_t used = slip->tape->used;
  if (slip->moved)
  {
    double f[3] = {0};
    for (int k = 0; k < 3; ++k)
    {
      for (int a = 0; a < side->num_dofs; ++a)
        f[k] += slip->moved[2 * slip->local->dofs[numbers[a]] + i] * curve->N[k][a];
      for (int a = 0; curve->turns && a < 2; ++a)
        f[k] += slip->moved[2 * slip->local->dofs[numbers[a]] + 1 - i] *
                (a == i ? curve->across[k] : -curve->across[k]);
    }
    Jet jet = times(slip->tape, sign, f, s, by);
    for (size_t k = 0; k < slip->tape->size; ++k)
      slip->by_moved[k] += jet[k];
    slip->tape->used = used;
    return;
  }
  for (int a = 0; a < side->num_dofs; ++a, slip->tape->used = used)
  {
    const double f[] = {curve->N[0][a], curve->N[1][a], curve->N[2][a]};
    take(slip, numbers[a], i, times(slip->tape, sign, f, s, by));
  }
  for (int a = 0; curve->turns && a < 2; ++a, slip->tape->used = used)
    take(slip, numbers[a], 1 - i, times(slip->tape, a == i ? sign : -sign, curve->across, s, by));
}

static void take_ray(const Slip *slip, const Sigma *sigma)
{
  const Ray *ray = slip->ray;
  for (int k = 0; k < ray->point->num; ++k)
    for (int i = 0; i < 2; ++i)
    {
      Jet by = slip_by(slip->tape, ray, i, k, slip->across);
      take_point(slip, sigma->sides, ray->curves + k, ray->r[k], slip->local->of_sheet[k], i, 1, by);
      take_point(slip, sigma->sides + 1, &ray->curve, ray->s, slip->local->own, i, -1, by);
    }
}

// Weighted gaps of the halves of Γ1's edges.
//
// g           (num_edges₁, 2)
// covered     parts of the halves that see Γ0, likewise
// areas       of these parts, likewise
// C           ∂g/∂u, summed over the halves of each vertex
// by_covered  ∂covered/∂u
// T           weighted slips of vertices by motions, s = T Δu; NULL: not asked for
int find_gaps(const Sigma *sigma, double *g, double *covered, double *areas, Entries *C,
              Entries *by_covered, Entries *T)
{
  Local local;
  Tape tape = {0};
  int can = 1;
  Ray ray;
  Slip slip = {.local = &local, .tape = &tape, .ray = &ray, .entries = T,
               .vertices = sigma->sides[1].vertices};
  memset(g, 0, 2 * sigma->sides[1].num_edges * sizeof(double));
  memset(covered, 0, 2 * sigma->sides[1].num_edges * sizeof(double));
  memset(areas, 0, 2 * sigma->sides[1].num_edges * sizeof(double));
  for (int p = 0; can && p < sigma->num_points; ++p)
  {
    const Point *point = sigma->points + p;
    can = next_ray(&tape, 1, sigma, point, &local, &ray);
    for (int e = 0; can && e < 2; ++e)
    {
      if (point->part == 1 - e)
        continue;
      int half = 2 * point->edge + e;
      Jet volume = shared(&tape, &ray, ray.volume, e), part = shared(&tape, &ray, ray.covered, e);
      g[half] += volume[0], covered[half] += 2 * part[0];
      areas[half] += part[0] * sqrt(ray.square[0]) * ray.arc;
      add_row(&local, sigma->sides[1].vertices[half], volume, C);
      add_row(&local, half, scaled(&tape, 2, part), by_covered);
    }
    tape.size = 1; // of slips values alone
    if (can && T)
      take_ray(&slip, sigma);
  }
  can = can && !tape.failed;
  close_tape(&tape);
  return can ? DONE : NO_MEMORY;
}

// Largest distance and overlap of the sides in parts of Γ1, and what of its gaps is in front, up to
// edges that lean, where there are pressures.
//
// p      pressures of vertices, (num_vertices₁)
// least  lengths from which distances and overlaps are looked for, likewise
// found  all three of vertices, (3, num_vertices₁)
int find_reaches(const Sigma *sigma, const double *p, const double *least, double *found)
{
  const double range[] = {sigma->cosines[1], 2 * sigma->cosines[1]};
  int num = sigma->sides[1].num_vertices, can = 1;
  double *far = found, *deep = far + num, *leaning = deep + num;
  Local local;
  Tape tape = {0};
  Ray ray;
  memset(found, 0, 3 * num * sizeof(double));
  for (int n = 0; can && n < sigma->num_points; ++n)
  {
    const Point *point = sigma->points + n;
    const int *vertices = sigma->sides[1].vertices + 2 * point->edge;
    double x[4][2], at[2];
    if (point->is_first)
    {
      find_column(sigma, point, x[0], at);
      double apart = larger(hypot(x[2][0] - x[0][0], x[2][1] - x[0][1]),
                            hypot(x[3][0] - x[1][0], x[3][1] - x[1][1]));
      for (int e = point->part == 1; e <= (point->part > 0); ++e)
      {
        int v = vertices[e];
        if (apart <= least[v])
          continue;
        far[v] = larger(apart, far[v]);
        for (int k = 0; k < 4; ++k)
          deep[v] = larger(depth_in(sigma, k > 1, x[k]), deep[v]);
      }
    }
    if (p[vertices[0]] == 0 && p[vertices[1]] == 0)
      continue;
    can = next_ray(&tape, 0, sigma, point, &local, &ray);
    for (int k = 0; can && k < point->num; ++k)
    {
      Jet cos = cosine_of(&tape, &ray, ray.curves + k, sigma->sides->num_dofs, local.of_sheet[k],
                          ray.r[k]);
      Jet volume = constant(&tape, (1 - *step_of(&tape, cos, range)) * larger(ray.heights[k], 0));
      volume = product(&tape, ray.width, volume);
      if (ray.visible[k])
        volume = product(&tape, ray.visible[k], volume);
      if (sigma->angle > 0)
        volume = product(&tape, ray.arcs[k], volume);
      for (int e = 0; e < 2; ++e)
        if (point->part != 1 - e)
          leaning[vertices[e]] += *shared(&tape, &ray, volume, e);
    }
  }
  can = can && !tape.failed;
  close_tape(&tape);
  return can ? DONE : NO_MEMORY;
}

// Σ p ∂²g/∂u² + Σ by_covered ∂²covered/∂u², with values of the halves.
int gap_curvature(const Sigma *sigma, const double *p, const double *by_covered, Entries *H)
{
  Local local;
  Tape tape = {0};
  int can = 1;
  Ray ray;
  for (int k = 0; can && k < sigma->num_points; ++k)
  {
    const Point *point = sigma->points + k;
    const double *own = p + 2 * point->edge, *by = by_covered + 2 * point->edge;
    if (own[0] == 0 && own[1] == 0 && by[0] == 0 && by[1] == 0)
      continue;
    can = next_ray(&tape, 2, sigma, point, &local, &ray);
    if (!can)
      break;
    Jet sum = constant(&tape, 0);
    for (int e = 0; e < 2; ++e)
      if (point->part != 1 - e)
      {
        Jet both = combined(&tape, own[e], ray.volume, 2 * by[e], ray.covered);
        sum = combined(&tape, 1, sum, 1, shared(&tape, &ray, both, e));
      }
    *adjoint(&tape, sum) = 1;
    sweep(&tape, 0);
    for (int v = 0; v < tape.n; ++v)
      for (int w = 0; w <= v; ++w)
      {
        int i = component_of(&local, v), j = component_of(&local, w);
        double value = tape.second[tape.n * v + w];
        if (value == 0)
          continue;
        add(H, i, j, value);
        if (v != w)
          add(H, j, i, value);
      }
  }
  can = can && !tape.failed;
  close_tape(&tape);
  return can ? DONE : NO_MEMORY;
}

static int for_slips(const Sigma *sigma, int order, Slip slip)
{
  Local local;
  Tape tape = {0};
  int can = 1;
  Ray ray;
  slip.local = &local, slip.tape = &tape, slip.vertices = sigma->sides[1].vertices;
  for (int p = 0; can && p < sigma->num_points; ++p)
  {
    const Point *point = sigma->points + p;
    if (slip.q && slip.q[2 * point->edge] == 0 && slip.q[2 * point->edge + 1] == 0)
      continue;
    can = next_ray(&tape, order, sigma, point, &local, &ray);
    if (!can)
      break;
    slip.ray = &ray, slip.by_moved = constant(&tape, 0);
    take_ray(&slip, sigma);
    for (int e = 0; slip.moved && e < 2; ++e)
      if (point->part != 1 - e)
        add_row(&local, slip.vertices[2 * point->edge + e],
                shared(&tape, &ray, slip.by_moved, e), slip.entries);
  }
  can = can && !tape.failed;
  close_tape(&tape);
  return can ? DONE : NO_MEMORY;
}

// Weighted slips of vertices s = T Δu: T; if they are given Δu, by dofs, ∂T/∂u Δu instead.
//
// across  whether what parts the sides across Γ1's edges is asked for, not along them
int find_slips(const Sigma *sigma, int across, const double *moved, Entries *rows)
{
  return for_slips(sigma, moved != NULL,
                   (Slip){.across = across, .moved = moved, .entries = rows});
}

// Σ q ∂T/∂u, with values of the halves; it isn't symmetric.
int slip_curvature(const Sigma *sigma, const double *q, Entries *H)
{
  return for_slips(sigma, 1, (Slip){.q = q, .entries = H});
}
