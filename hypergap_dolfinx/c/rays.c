// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Cells of contact's Σ in the plane (contact_geometry/rays.py): fans between Γ1's vertices and what Γ1's rays
// cut from Γ0.

#include <math.h>
#include <stdlib.h>

#include "fans.h"
#include "plane.h"
#include "vectors.h"

typedef struct {
  int edge, parameter;
} Place;

// What Γ0 has opposite of an edge of Γ1.
typedef struct {
  // Of the start, of the end (of what is covered) and of the middle, if both vertices have a weight
  Place places[3];
  double t[3];    // where on Γ0 they are, if edges were straight
  int cut[2];     // edges of Γ0 that end opposite of it: of what starts, and of what ends there
  double foot[2]; // where
  int limits[2];  // parameters of what is covered
  int owner;      // number (0 or 1) of the vertex that has all, or most, if not both have the same
  int beyond;     // whether the other one, beyond Γ0's end, has a share
} Opposite;

typedef struct {
  Sigma *sigma;
  const Side *below, *above; // Γ0 and Γ1
  const Chains *chains;      // Γ0's
  Opposite *opposite;        // of Γ1's edges
  double end, faces, farther;
} Cast;

// Vertices at which a side turns too far to go on.
//
// kink     cosine of the turn
// kinks    whether they are some, (num_vertices)
void kinks_of(const Side *side, double kink, int *kinks)
{
  for (int v = 0; v < side->num_vertices; ++v)
  {
    const int *beside = side->beside + 2 * v;
    double a[2], b[2], sizes;
    kinks[v] = 0;
    if (beside[0] < 0 || beside[1] < 0)
      continue;
    sizes = chord(side, beside[0], a) * chord(side, beside[1], b);
    kinks[v] = !(sizes > 0 && a[0] * b[0] + a[1] * b[1] >= kink * sizes);
  }
}

// Whether an edge of Γ0 is the first or last one (k = 0, 1) of a chain that is no loop.
static int is_end(const Chains *chains, int edge, int k)
{
  int c = chains->chain[edge];
  return !chains->closed[c] && chains->position[edge] == (k ? chains->count[c] - 1 : 0);
}

// Where both ends of an edge of Γ0 are along one of Γ1, in lengths of it; whether they face each
// other. Γ0 runs against Γ1.
static int along(const Cast *cast, int f, int g, double *s)
{
  const double *a = node(cast->above, f, 0);
  double c[2], size = chord(cast->above, f, c), own[2];
  for (int k = 0; k < 2; ++k)
  {
    const double *x = node(cast->below, g, k);
    s[k] = ((x[0] - a[0]) * c[0] + (x[1] - a[1]) * c[1]) / (size * size);
  }
  if (s[0] <= -cast->end || s[1] > 1 + cast->end)
    return 0; // beside it
  return (s[0] - s[1]) * size > cast->faces * chord(cast->below, g, own);
}

// From a position on an edge of Γ1 to one on an edge of Γ0.
static double distance(const Cast *cast, int f, double s, int g, double t)
{
  const double *a = node(cast->above, f, 0), *b = node(cast->below, g, 0);
  double c[2], d[2], square = 0;
  chord(cast->above, f, c), chord(cast->below, g, d);
  for (int i = 0; i < 2; ++i)
  {
    double way = b[i] + t * d[i] - a[i] - s * c[i];
    square += way * way;
  }
  return sqrt(square);
}

// Find the nearest edges of Γ0 that face an edge of Γ1 where it starts, ends and has its middle.
static void shoot(const Cast *cast, int f)
{
  Opposite *own = cast->opposite + f;
  double nearest[3] = {INFINITY, INFINITY, INFINITY}, s[2];
  own->cut[0] = own->cut[1] = NOWHERE;
  for (int k = 0; k < 3; ++k)
    own->places[k].edge = NOWHERE, own->t[k] = 0;
  for (int g = 0; g < cast->below->num_edges; ++g)
  {
    if (!along(cast, f, g, s))
      continue;
    double before = is_end(cast->chains, g, 0) ? cast->end : 0;
    double behind = is_end(cast->chains, g, 1) ? cast->end : 0;
    for (int k = 0; k < 3; ++k)
      if (s[0] > positions[k] - before && s[1] <= positions[k] + behind)
      {
        double t = fmin(fmax((s[0] - positions[k]) / (s[0] - s[1]), 0), 1);
        double far = distance(cast, f, positions[k], g, t);
        if (far < nearest[k])
          nearest[k] = far, own->places[k].edge = g, own->t[k] = t;
      }
  }
}

// Find the edge of Γ1 that is the nearest to an end of Γ0.
//
// g       edge that starts or ends there
// k       0: starts, 1: ends
static void find_cut(const Cast *cast, int g, int k)
{
  double nearest = INFINITY, foot = 0, s[2];
  Opposite *found = NULL;
  for (int f = 0; f < cast->above->num_edges; ++f)
  {
    if (!along(cast, f, g, s) || s[k] <= cast->end || s[k] >= 1 - cast->end)
      continue;
    double far = distance(cast, f, s[k], g, k);
    if (far < nearest)
      nearest = far, foot = s[k], found = cast->opposite + f;
  }
  if (found) // where Γ0 starts there is something behind it, where it ends something before
    found->cut[1 - k] = g, found->foot[1 - k] = foot;
}

// A crossing's parameter.
//
// g, f     edges of Γ0 and Γ1
// unknown  side on which it moves
// s, t     positions on both
static int add_crossing(const Cast *cast, int g, int f, int unknown, double s, double t)
{
  Sigma *sigma = cast->sigma;
  sigma->crossings[sigma->num_crossings] = (Crossing){{g, f}, unknown, {s, t}};
  return FIXED + sigma->num_crossings++;
}

// Make up what of an edge of Γ1 is covered from what rays meet.
//
// walls       places that are known, of the start and the end
// least       part of the edge: if more is covered both vertices have a weight
// beyond      the same for a share of a vertex beyond Γ0's end
static void cover(const Cast *cast, int f, const Place *walls, double least, double beyond)
{
  Opposite *own = cast->opposite + f;
  Place *places = own->places;
  double position[2] = {0, 1};
  int cuts[2];
  // Two parts of Γ0 with a hole between them: the larger counts
  if (own->cut[0] >= 0 && own->cut[1] >= 0 && own->foot[0] >= own->foot[1])
    own->cut[own->foot[1] < 1 - own->foot[0]] = NOWHERE;
  for (int k = 0; k < 2; ++k)
  {
    cuts[k] = walls[k].edge < 0 && own->cut[k] >= 0;
    if (walls[k].edge >= 0)
      places[k].edge = walls[k].edge;
    else if (cuts[k])
      places[k].edge = own->cut[k], position[k] = own->foot[k];
  }
  own->owner = position[0] > 1 - position[1];
  if (places[AT_START].edge < 0 || places[AT_END].edge < 0)
    places[AT_START].edge = places[AT_END].edge = places[AT_MIDDLE].edge = NOWHERE;
  if (position[1] - position[0] <= least)
    places[AT_MIDDLE].edge = NOWHERE;
  own->beyond = places[AT_MIDDLE].edge < 0 && places[AT_START].edge >= 0
                && cuts[1 - own->owner] && position[1] - position[0] > beyond;
  for (int k = 0; k < 3; ++k)
  {
    int g = places[k].edge, at = own->t[k] == 1;
    if (k < 2)
      own->limits[k] = k;
    if (g < 0)
      continue;
    if (k < 2 && walls[k].edge >= 0)
      places[k].parameter = walls[k].parameter;
    else if (k < 2 && cuts[k])
    {
      places[k].parameter = 1 - k;
      own->limits[k] = add_crossing(cast, g, f, 1, 1 - k, own->foot[k]);
    }
    else if (k < 2 && own->t[k] == at && is_end(cast->chains, g, at))
      places[k].parameter = at; // a ray meets an end of Γ0
    else
      places[k].parameter = add_crossing(cast, g, f, 0, own->t[k], positions[k]);
  }
}

static void emit(const Cast *cast, Cell cell)
{
  Sigma *sigma = cast->sigma;
  if (sigma->num_cells < sigma->max_cells)
    sigma->cells[sigma->num_cells] = cell;
  ++sigma->num_cells;
}

// Whether a vertex beyond Γ0's end has a share: not if it is opposite of something else.
static int has_share(const Cast *cast, int f)
{
  const Opposite *own = cast->opposite + f;
  int k = 1 - own->owner, vertex = cast->above->vertices[2 * f + k];
  int other = cast->above->beside[2 * vertex + k];
  return own->beyond && (other < 0 || cast->opposite[other].places[AT_START].edge < 0);
}

// Cells with their bases on Γ1.
static void add_base(const Cast *cast, int f)
{
  const Opposite *own = cast->opposite + f;
  const int *vertices = cast->above->vertices + 2 * f;
  int whole = own->places[AT_MIDDLE].edge >= 0;
  Place apex = own->places[whole ? AT_MIDDLE : 1 - own->owner];
  Cell cell = {1, f, apex.edge, {own->limits[0], own->limits[1], apex.parameter}, {0}};
  for (int k = 0; k < 2; ++k)
    cell.vertices[k] = vertices[whole || own->beyond ? k : own->owner];
  if (apex.edge >= 0)
    emit(cast, cell);
}

// Steps from one edge of Γ0 to another of the same chain, the shorter way round loops.
static int steps(const Chains *chains, int from, int to)
{
  int chain = chains->chain[from], count = chains->count[chain], half = count / 2;
  int num = chains->position[to] - chains->position[from];
  return chains->closed[chain] ? ((num + half) % count + count) % count - half : num;
}

// The edge of Γ0 that comes some steps after another one.
static int edge_behind(const Chains *chains, int edge, int num)
{
  int chain = chains->chain[edge], place = chains->position[edge] + num;
  return chains->edges[chains->start[chain] + place % chains->count[chain]];
}

// Length of the way between the middles of two edges of Γ0.
static double way(const Cast *cast, int from, int to)
{
  int num = steps(cast->chains, from, to), first = num < 0 ? to : from;
  double c[2], length = -0.5 * (chord(cast->below, from, c) + chord(cast->below, to, c));
  for (int k = 0; k <= abs(num); ++k)
    length += chord(cast->below, edge_behind(cast->chains, first, k), c);
  return length;
}

// Add cells between an apex and Γ0 from one place to another of the same chain.
static void add_fan(const Cast *cast, int vertex, Place from, Place to, Place apex)
{
  int num = steps(cast->chains, from.edge, to.edge), back = num < 0;
  Place first = back ? to : from, last = back ? from : to;
  num = abs(num);
  for (int k = 0; k <= num; ++k)
  {
    int base = edge_behind(cast->chains, first.edge, k);
    int limits[2] = {k ? AT_START : first.parameter, k < num ? AT_END : last.parameter};
    emit(cast, (Cell){0, base, apex.edge, {limits[back], limits[!back], apex.parameter},
                      {vertex, vertex}});
  }
}

// Cells with their bases on Γ0: a fan at a vertex of Γ1, or one on each side of it.
static void add_fans(const Cast *cast, int vertex, int kink)
{
  const int *edges = cast->above->beside + 2 * vertex, *chain = cast->chains->chain;
  Place places[2] = {{NOWHERE, NOWHERE}, {NOWHERE, NOWHERE}};
  for (int i = 0; i < 2; ++i)
  {
    const Opposite *own = edges[i] < 0 ? NULL : cast->opposite + edges[i];
    if (!own || own->places[AT_START].edge < 0)
      continue;
    if (own->places[AT_MIDDLE].edge >= 0)
      places[i] = own->places[AT_MIDDLE];
    else if (own->owner == 1 - i)
      places[i] = own->places[i];
  }
  // Γ0 runs against Γ1: a fan goes from what is behind the vertex to what is before it
  int from = places[1].edge, to = places[0].edge;
  if (!kink && from >= 0 && to >= 0 && chain[from] == chain[to])
  {
    double c[2], reach = chord(cast->above, edges[0], c) + chord(cast->above, edges[1], c);
    if (way(cast, from, to) <= cast->farther * reach)
    {
      add_fan(cast, vertex, places[1], places[0], (Place){edges[1], AT_START});
      return;
    }
  }
  // On the vertex' own side its edge ends, or what is covered of it
  for (int i = 0; i < 2; ++i)
  {
    if (places[i].edge < 0)
      continue;
    const Opposite *opposite = cast->opposite + edges[i];
    Place own = opposite->places[1 - i], apex = {edges[i], opposite->limits[1 - i]};
    if (chain[own.edge] == chain[places[i].edge])
      add_fan(cast, vertex, i ? places[i] : own, i ? own : places[i], apex);
  }
}

// Find cells, and crossings without their motions.
//
// sigma    the sides; room for crossings, three for each edge of Γ1, and for cells: if there are
//          more of these num_cells is larger than max_cells
// chains   Γ0's
// kinks    of Γ1, (num_vertices)
// least    parts of Γ1's edges: where more is covered both vertices have a weight
// walls    known places: edge and end of Γ1, edge and end of Γ0, (num_walls, 4)
// end      distance along an edge, in its lengths, of ends that are opposite to each other
// faces    cosine between edges from which they face each other
// farther  longest way on Γ0 between neighbouring rays, in lengths of their edges
// beyond   parts of Γ1's edges: where more is covered a vertex beyond Γ0's end has a share
// whole    edges of Γ1 of which both vertices have a weight
// owners   number of the vertex before Γ0's end where that beyond it has a share, −1 elsewhere
int cast_rays(Sigma *sigma, const Chains *chains, const int *kinks, const double *least,
              int num_walls, const int *walls, double end, double faces, double farther,
              const double *beyond, int *whole, int *owners)
{
  const Side *below = sigma->sides, *above = below + 1;
  Opposite *opposite = malloc((above->num_edges + 1) * sizeof(Opposite));
  const Cast cast = {sigma, below, above, chains, opposite, end, faces, farther};
  if (!opposite)
    return NO_MEMORY;
  sigma->num_cells = sigma->num_crossings = 0;
  for (int f = 0; f < above->num_edges; ++f)
    shoot(&cast, f);
  for (int c = 0; c < chains->num; ++c)
    for (int k = 0; k < 2 && !chains->closed[c]; ++k)
      find_cut(&cast, chains->edges[chains->start[c] + (k ? chains->count[c] - 1 : 0)], k);
  for (int f = 0; f < above->num_edges; ++f)
  {
    Place known[2] = {{NOWHERE, NOWHERE}, {NOWHERE, NOWHERE}};
    for (const int *wall = walls; wall < walls + 4 * num_walls; wall += 4)
      if (wall[0] == f)
        known[wall[1]] = (Place){wall[2], wall[3]};
    cover(&cast, f, known, least[f], beyond[f]);
    whole[f] = opposite[f].places[AT_MIDDLE].edge >= 0;
  }
  for (int f = 0; f < above->num_edges; ++f)
  {
    opposite[f].beyond = has_share(&cast, f);
    owners[f] = opposite[f].beyond ? opposite[f].owner : NOWHERE;
    add_base(&cast, f);
  }
  for (int v = 0; v < above->num_vertices; ++v)
    add_fans(&cast, v, kinks[v]);
  free(opposite);
  return DONE;
}
