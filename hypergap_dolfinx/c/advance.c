// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// The front's way from one surface to the other: where vertices wait at first, and the order of moves.

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "front.h"
#include "gap_mesh.h"

#define PI 3.14159265358979323846

static int sort_edges(Edges *edges, int n, int num, const int *triangles)
{
  edges->offset = calloc(n + 2, sizeof(int));
  edges->to = malloc((3 * num + 1) * sizeof(int));
  edges->opposite = malloc((3 * num + 1) * sizeof(int));
  edges->triangle = malloc((3 * num + 1) * sizeof(int));
  if (!edges->offset || !edges->to || !edges->opposite || !edges->triangle)
    return 0;
  for (int i = 0; i < 3 * num; ++i)
    ++edges->offset[triangles[i] + 2];
  for (int i = 2; i < n + 2; ++i)
    edges->offset[i] += edges->offset[i - 1];
  for (int t = 0; t < num; ++t)
    for (int k = 0; k < 3; ++k)
    {
      int at = edges->offset[triangles[3 * t + k] + 1]++;
      edges->to[at] = triangles[3 * t + (k + 1) % 3];
      edges->opposite[at] = triangles[3 * t + (k + 2) % 3];
      edges->triangle[at] = t;
    }
  return 1;
}

static void free_edges(Edges *edges)
{
  free(edges->offset), free(edges->to), free(edges->opposite), free(edges->triangle);
}

// The start's vertex nearest to w whose normal agrees.
static int nearest(const Front *f, const Edges *start, int w)
{
  double least = INFINITY;
  int best = 0;
  for (int i = 0; i < f->points.n0; ++i)
  {
    double e[3];
    minus(f->points.vertex[i].y, f->points.vertex[w].y, e);
    double square = dot(e, e) * (dot(f->points.vertex[i].n, f->points.vertex[w].n) > 0.3 ? 1 : 1e6);
    if (square < least && start->offset[i] < start->offset[i + 1])
    {
      least = square;
      best = i;
    }
  }
  return start->triangle[start->offset[best]];
}

// Find the triangle of the front that each vertex of the end waits in. Neighbours are near each
// other, so each walk begins where one has ended.
static int locate(Front *f, const Edges *start)
{
  int *queue = malloc((f->points.n + 1) * sizeof(int)), *near = malloc((f->points.n + 1) * sizeof(int));
  if (!queue || !near)
  {
    free(queue), free(near);
    return 0;
  }
  int first = 0, last = 0;
  for (int i = 0; i < f->points.n; ++i)
    near[i] = -1;
  for (int i = f->points.n0; i < f->points.n; ++i) // those at the upper rim of the walls
    if (start->offset[i] < start->offset[i + 1])
    {
      near[i] = start->triangle[start->offset[i]];
      queue[last++] = i;
    }
  for (int i = f->points.n0; i < f->points.n; ++i)
  {
    if (near[i] < 0 && first == last && f->end.offset[i] < f->end.offset[i + 1])
    {
      near[i] = walk(f, nearest(f, start, i), i, f->num_triangles);
      put(f, i, near[i]);
      queue[last++] = i;
    }
    while (first < last)
    {
      int a = queue[first++];
      for (int j = f->end.offset[a]; j < f->end.offset[a + 1]; ++j)
      {
        int b = f->end.to[j];
        if (near[b] >= 0)
          continue;
        int t = walk(f, near[a], b, f->num_triangles);
        if (!is_inside(f, t, b))
        {
          int other = walk(f, nearest(f, start, b), b, f->num_triangles);
          t = is_inside(f, other, b) ? other : t;
        }
        near[b] = t;
        put(f, b, t);
        queue[last++] = b;
      }
    }
  }
  free(queue), free(near);
  return 1;
}

// The triangle behind the edge from a to b of t, −1 at the boundary. Where rooms touch, several go
// over one edge between twins: the room is on the left of its walls, seen from the end.
static int beyond(const Front *f, const Edges *start, int t, int a, int b)
{
  int best = -1, num = 0;
  double least = INFINITY;
  for (int i = start->offset[b]; i < start->offset[b + 1]; ++i)
    if (start->to[i] == a)
    {
      best = start->triangle[i];
      ++num;
    }
  if (num < 2)
    return best;
  const Vertex *v = f->points.vertex;
  double e[3], g[3];
  const int *own = f->triangle[t].v;
  int from = a < b ? a : b, side = a < b ? 1 : -1; // the start's vertex
  minus(v[own[0] + own[1] + own[2] - a - b].x, v[from].x, e);
  for (int i = start->offset[b]; i < start->offset[b + 1]; ++i)
    if (start->to[i] == a)
    {
      minus(v[start->opposite[i]].x, v[from].x, g);
      double angle = side * atan2(triple(e, g, v[from].n), dot(e, g));
      if (angle <= 0)
        angle += 2 * PI;
      if (angle < least)
      {
        least = angle;
        best = start->triangle[i];
      }
    }
  return best;
}

static int num_left(const Front *f)
{
  int left = 0;
  for (int t = 0; t < f->num_triangles; ++t)
    left += f->triangle[t].v[0] >= 0 && !is_final(f, t);
  return left;
}

// The end's facets that are not in the front, seen from there. Returns how many.
static int add_missing(Front *f, int num_end, const int *end, int *missing)
{
  int num = 0;
  for (int t = 0; t < f->num_triangles; ++t)
    if (f->triangle[t].v[0] >= 0 && is_final(f, t))
    {
      const int *v = f->triangle[t].v;
      for (int i = f->end.offset[v[0]]; i < f->end.offset[v[0] + 1]; ++i)
        if (f->end.to[i] == v[1])
          f->end.opposite[i] = -1; // nobody asks any more
    }
  for (int e = 0; e < num_end; ++e)
  {
    const int *v = end + 3 * e;
    int there = 0;
    for (int k = 0; k < 3; ++k)
      there |= opposite(&f->end, v[k], v[(k + 1) % 3]) < 0;
    const int seen[3] = {v[1], v[0], v[2]};
    if (!there)
      memcpy(missing + 3 * num++, seen, sizeof(seen));
  }
  return num;
}

static void advance(Front *f)
{
  int before = -1;
  // What could not move may be able to when all else has moved
  while (!f->failed && f->num_cells > before && f->num_cells < f->max_cells && num_left(f))
  {
    before = f->num_cells;
    forget_events(f);
    for (int t = 0; t < f->num_triangles; ++t)
      if (f->triangle[t].v[0] >= 0)
        offer_points(f, t);
    for (int t = 0; t < f->num_triangles; ++t)
      if (f->triangle[t].v[0] >= 0)
        for (int k = 0; k < 3; ++k)
          if (f->triangle[t].behind[k] > t)
            offer_edge(f, t, k);
    sort_events(f);
    while (has_events(f) && !f->failed && f->num_cells < f->max_cells)
    {
      Event e = pop(f);
      if (!is_stale(f, &e))
        carry_out(f, &e);
    }
  }
}

// Fill the space between two surfaces.
//
// n0, n1      vertices of the start and of the end (numbered behind the start's)
// vertices    x, y, normal, weight of each
// flat        D of a cell, over its scale, up to which the front does without it
// start       triangles of the start and of the walls, counterclockwise seen from the end
// end         the end's, counterclockwise seen from beyond
// max_cells   space for cells
// cells       what it makes
// left        triangles of the front that are no facets of the end, as many as start and twice n1 at
//             most, and then those of the end that are not in the front, as many as it has at most;
//             counterclockwise seen from between them
// counts      number of cells, of triangles left of the front, of the end
int front_fill(int n0, int n1, const double *vertices, double flat, int num_start, const int *start,
               int num_end, const int *end, int max_cells, int *cells, int *left, int *counts)
{
  int status = NO_MEMORY;
  Front f = {.points = {n0, n0 + n1, (const Vertex *)vertices, flat}, .cells = cells, .max_cells = max_cells};
  Edges first = {0};
  f.max_triangles = num_start + 2 * n1 + 2;
  f.triangle = malloc(f.max_triangles * sizeof(Triangle));
  f.spare = malloc(f.max_triangles * sizeof(int));
  f.home = malloc((f.points.n + 1) * sizeof(int));
  f.next = malloc((f.points.n + 1) * sizeof(int));
  counts[0] = counts[1] = counts[2] = 0;
  if (!f.triangle || !f.spare || !f.home || !f.next || !sort_edges(&f.end, f.points.n, num_end, end)
      || !sort_edges(&first, f.points.n, num_start, start))
    goto finish;
  for (int i = 0; i < f.points.n; ++i)
    f.home[i] = f.next[i] = -1;
  for (int t = 0; t < num_start; ++t)
  {
    f.triangle[t].stamp = 0;
    set(&f, t, start[3 * t], start[3 * t + 1], start[3 * t + 2]);
  }
  f.num_triangles = num_start;
  for (int t = 0; t < num_start; ++t)
    for (int k = 0; k < 3; ++k)
      f.triangle[t].behind[k] = beyond(&f, &first, t, start[3 * t + k], start[3 * t + (k + 1) % 3]);
  if (!locate(&f, &first))
    goto finish;
  advance(&f);
  if (f.failed)
    goto finish;
  status = DONE;
  counts[0] = f.num_cells;
  for (int t = 0; t < f.num_triangles; ++t)
    if (f.triangle[t].v[0] >= 0 && !is_final(&f, t))
    {
      memcpy(left + 3 * counts[1]++, f.triangle[t].v, 3 * sizeof(int));
      status = STUCK;
    }
  if (status == STUCK)
    counts[2] = add_missing(&f, num_end, end, left + 3 * counts[1]);
finish:
  free_edges(&f.end), free_edges(&first);
  free(f.triangle), free(f.spare), free(f.home), free(f.next);
  forget_events(&f);
  return status;
}
