// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Neighbours and corners of a surface's facets; points and edges nearest to points.

#include "surface.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "adjacency.h"
#include "vectors.h"

// The facet behind each edge.
//
// n           number of vertices
// num, size   facets, and corners of each
// facets      (num, size), around the facets: edge k goes from corner k to the next one
// behind      (num, size): −1 at the boundary
// Returns BAD_INPUT where facets have an edge in the same direction.
int find_neighbours(int n, int num, int size, const int *facets, int *behind)
{
  int *offset = calloc(n + 2, sizeof(int)), *at = malloc(((size_t)size * num + 1) * sizeof(int));
  int status = offset && at ? DONE : NO_MEMORY;
  if (status == DONE)
    sort_at_vertices(n, size, num, facets, offset, at);
  for (int f = 0; f < num && status == DONE; ++f)
    for (int k = 0; k < size; ++k)
    {
      int a = facets[size * f + k], b = facets[size * f + (k + 1) % size], found = -1;
      for (int i = offset[a]; i < offset[a + 1]; ++i)
      {
        const int *other = facets + size * at[i];
        for (int m = 0; m < size && at[i] != f; ++m)
        {
          int next = other[m + 1 < size ? m + 1 : 0];
          if (other[m] == a && next == b)
            status = BAD_INPUT;
          else if (other[m] == b && next == a)
            found = at[i];
        }
      }
      behind[size * f + k] = found;
    }
  free(offset), free(at);
  return status;
}

// The inner edges of triangles: ends q and r, the vertex p on the left, s on the right.
//
// behind      as of find_neighbours
// number      of each vertex
// edges       (num_edges, 4), in these numbers
void inner_edges(int num, const int *triangles, const int *behind, const int *number, int *edges)
{
  for (int f = 0; f < num; ++f)
    for (int k = 0; k < 3; ++k)
    {
      int g = behind[3 * f + k];
      if (g <= f)
        continue;
      const int *t = triangles + 3 * f, *u = triangles + 3 * g;
      int q = t[k], r = t[(k + 1) % 3];
      edges[0] = number[q], edges[1] = number[r];
      edges[2] = number[t[(k + 2) % 3]], edges[3] = number[u[0] + u[1] + u[2] - q - r];
      edges += 4;
    }
}

// True if a surface has an edge with a smaller cosine between normals.
int has_corner(int num, int size, const int *behind, const double *normals, double cosine)
{
  for (int f = 0; f < num; ++f)
    for (int k = 0; k < size; ++k)
    {
      int g = behind[size * f + k];
      if (g > f && dot(normals + 3 * f, normals + 3 * g) < cosine)
        return 1;
    }
  return 0;
}

typedef struct {
  double t[3], turn; // unit vector along it, and by what the surface turns there
  int a, b;          // its ends
  int beyond[4];     // the next vertices of the facet on one side and on the other
  int is_kink;
} Turn;

// The turns at inner edges, of facets with lower numbers than those behind them. Returns the largest.
//
// angles      by what the surface turns at each
// shortest    of the longest edges of all facets
static double find_turns(int num, int size, const int *facets, const int *behind, const double *x,
                         const double *angles, Turn *turns, int *num_turns, double *shortest)
{
  double most = 0, least = INFINITY;
  *num_turns = 0;
  for (int f = 0; f < num; ++f)
  {
    double longest = 0;
    for (int k = 0; k < size; ++k)
    {
      double e[3];
      minus(x + 3 * facets[size * f + (k + 1) % size], x + 3 * facets[size * f + k], e);
      longest = larger(longest, dot(e, e));
    }
    least = smaller(least, longest);
    for (int k = 0; k < size; ++k)
    {
      int g = behind[size * f + k];
      if (g <= f)
        continue;
      Turn *own = turns + (*num_turns)++;
      own->a = facets[size * f + k], own->b = facets[size * f + (k + 1) % size];
      own->is_kink = 0;
      int l = 0;
      while (l < size - 1 && behind[size * g + l] != f)
        ++l;
      for (int i = 0; i < 2; ++i)
      {
        own->beyond[i] = facets[size * f + (k + (i ? size - 1 : 2)) % size];
        own->beyond[2 + i] = facets[size * g + (l + (i ? size - 1 : 2)) % size];
      }
      own->turn = angles[*num_turns - 1];
      minus(x + 3 * own->b, x + 3 * own->a, own->t);
      double length = sqrt(dot(own->t, own->t));
      for (int i = 0; i < 3; ++i)
        own->t[i] /= length;
      most = larger(most, own->turn);
    }
  }
  *shortest = sqrt(least);
  return most;
}

// The turn about an edge's direction at others at a vertex that aren't kinks and have no end in common.
static double turn_at(const Turn *turns, const int *offset, const int *at, int vertex,
                      const Turn *own)
{
  double sum = 0;
  for (int i = offset[vertex]; i < offset[vertex + 1]; ++i)
  {
    const Turn *other = turns + at[i];
    double cosine = dot(own->t, other->t);
    if (!other->is_kink && other->a != own->a && other->a != own->b && other->b != own->a
        && other->b != own->b)
      sum += other->turn * cosine * cosine;
  }
  return sum;
}

// True if a surface turns beside an edge too: on both sides, or far more on one. What lies at its
// boundary tells little: it counts where nothing else is known.
static int goes_on(const Turn *turns, const int *offset, const int *at, const char *boundary,
                   const Turn *own, double stands_out)
{
  double beside[2] = {INFINITY, INFINITY}, outside = 0;
  for (int i = 0; i < 4; ++i)
  {
    double turn = turn_at(turns, offset, at, own->beyond[i], own);
    if (boundary[own->beyond[i]])
      outside = larger(outside, turn);
    else
      beside[i / 2] = smaller(beside[i / 2], turn);
  }
  double least = smaller(beside[0], beside[1]), most = larger(beside[0], beside[1]);
  if (least == INFINITY)
    least = outside;
  if (most == INFINITY)
    most = least;
  return stands_out * least >= own->turn || most >= stands_out * own->turn;
}

// Find the edges at which a surface turns by more than a corner does, or by much more than beside.
// Other such edges, which run up to a corner of the body, don't count as beside.
//
// n, x        vertices
// num, size   facets, and corners of each
// facets      (num, size), around the facets
// behind      (num, size): the facet behind each edge, −1 at the boundary
// angles      (num_edges): by what the surface turns at inner edges, in the order of their first facets
// limit       turn that is treated as zero
// noise       error of coordinates' differences, which adds to that
// corner      turn that is a corner whatever is beside it
// stands_out  times the turn beside it from which a turn is one
// kinks       (num_edges): 1 for these edges
int find_kinks(int n, const double *x, int num, int size, const int *facets, const int *behind,
               const double *angles, double limit, double noise, double corner,
               double stands_out, int *kinks)
{
  int num_turns, status = NO_MEMORY;
  Turn *turns = malloc((size_t)(num * size + 1) * sizeof(Turn));
  int *ends = NULL, *at = NULL, *offset = calloc(n + 2, sizeof(int));
  char *boundary = calloc(n + 1, 1);
  if (!turns || !offset || !boundary)
    goto finish;
  double shortest;
  double most = find_turns(num, size, facets, behind, x, angles, turns, &num_turns, &shortest);
  limit += noise / shortest;
  if (most <= limit)
  {
    memset(kinks, 0, (size_t)num_turns * sizeof(int));
    status = DONE;
    goto finish;
  }
  ends = malloc((2 * (size_t)num_turns + 1) * sizeof(int));
  at = malloc((2 * (size_t)num_turns + 1) * sizeof(int));
  if (!ends || !at)
    goto finish;
  for (int i = 0; i < num_turns; ++i)
    ends[2 * i] = turns[i].a, ends[2 * i + 1] = turns[i].b;
  sort_at_vertices(n, 2, num_turns, ends, offset, at);
  for (int i = 0; i < num * size; ++i)
    if (behind[i] < 0)
      boundary[facets[i]] = boundary[facets[i % size + 1 < size ? i + 1 : i + 1 - size]] = 1;
  for (int again = 1; again;)
  {
    again = 0;
    for (int i = 0; i < num_turns; ++i)
      if (turns[i].turn > limit && !turns[i].is_kink
          && (turns[i].turn > corner || !goes_on(turns, offset, at, boundary, turns + i, stands_out)))
        turns[i].is_kink = again = 1;
  }
  for (int i = 0; i < num_turns; ++i)
    kinks[i] = turns[i].is_kink;
  status = DONE;
finish:
  free(turns), free(ends), free(at), free(offset), free(boundary);
  return status;
}

// ---------------------------------------------------------------------------------------------

#define LOT 16 // points that have a ball around them

// Balls around points and the edges from them to the next ones.
static Ball *make_balls(int n, const double *x)
{
  int num = (n + LOT - 1) / LOT;
  Ball *balls = malloc((num + 1) * sizeof(Ball));
  for (int lot = 0; balls && lot < num; ++lot)
  {
    Ball *own = balls + lot;
    int first = LOT * lot, last = first + LOT < n ? first + LOT : n; // the next lot's first too
    double square = 0, e[3];
    for (int k = 0; k < 3; ++k)
    {
      double low = INFINITY, high = -INFINITY;
      for (int i = first; i <= last; ++i)
      {
        low = smaller(low, x[3 * (i % n) + k]);
        high = larger(high, x[3 * (i % n) + k]);
      }
      own->middle[k] = (low + high) / 2;
    }
    for (int i = first; i <= last; ++i)
    {
      minus(x + 3 * (i % n), own->middle, e);
      square = larger(square, dot(e, e));
    }
    own->radius = (1 + 1e-12) * sqrt(square);
  }
  return balls;
}

// The square of how far a point is off an edge, and the parameter s on it, from 0 to 1.
static double off_edge(const double *point, const double *a, const double *b, double *s)
{
  double t[3], e[3];
  minus(b, a, t);
  minus(point, a, e);
  double square = dot(t, t);
  *s = square > 0 ? dot(e, t) / square : 0;
  *s = smaller(larger(*s, 0), 1);
  for (int k = 0; k < 3; ++k)
    e[k] -= *s * t[k];
  return dot(e, e);
}

// Find what is nearest to points: of other points, or of a loop, where edge i goes from its node i to
// the next one, or from the last one to the first. Of several that are as near it is the first.
//
// num, points
// n, x        the others
// node        (num)
// edge, s     (num): the edge and the parameter on it, from 0 to 1; NULL if nobody asks
int find_nearest(int num, const double *points, int n, const double *x, int *node, int *edge,
                 double *s)
{
  Ball *balls = make_balls(n, x);
  if (!balls)
    return NO_MEMORY;
  for (int p = 0, last = 0; p < num; ++p)
  {
    double e[3], at, to_node = INFINITY, to_edge = INFINITY;
    const double *point = points + 3 * p;
    minus(point, x + 3 * last, e);
    double reach = (1 + 1e-12) * sqrt(dot(e, e)); // the nearest one is not farther than the last
    for (int lot = 0; LOT * lot < n; ++lot)
    {
      minus(point, balls[lot].middle, e);
      double beyond = reach + balls[lot].radius;
      if (dot(e, e) > beyond * beyond)
        continue;
      for (int i = LOT * lot; i < n && i < LOT * (lot + 1); ++i)
      {
        minus(point, x + 3 * i, e);
        double square = dot(e, e);
        if (square < to_node)
        {
          to_node = square;
          node[p] = i;
        }
        if (!edge)
          continue;
        square = off_edge(point, x + 3 * i, x + 3 * ((i + 1) % n), &at);
        if (square < to_edge)
        {
          to_edge = square;
          edge[p] = i;
          s[p] = at;
        }
      }
      reach = smaller(reach, (1 + 1e-12) * sqrt(to_node));
    }
    last = node[p];
  }
  free(balls);
  return DONE;
}
