// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Σ in three dimensions: an advancing front of bistellar flips.
//
// The front is a triangulation that starts as one surface (with the side walls) and ends as the
// other. Each move, the insertion of a vertex, the flip of an edge or the removal of a vertex, puts
// one tetrahedron on it. So cells fit together and leave no holes, whatever the order of the moves.
//
// The order is that of a regular triangulation whose heights change with time, h − t α: between
// two parallel planes the cells are those of the Delaunay triangulation in space.

#include "front.h"

#include <math.h>
#include <stdlib.h>

#define STEPS 64 // triangles that a waiting point may cross when the front has changed

// The vertex opposite to the edge from a to b in a surface, −1 if it has no such edge.
int opposite(const Edges *edges, int a, int b)
{
  for (int i = edges->offset[a]; i < edges->offset[a + 1]; ++i)
    if (edges->to[i] == b)
      return edges->opposite[i];
  return -1;
}

// Whether the end has an edge, in one direction or the other.
static int is_edge(const Front *f, int a, int b)
{
  return opposite(&f->end, a, b) >= 0 || opposite(&f->end, b, a) >= 0;
}

// Whether a triangle may be in the front: one of three vertices of the end must be its facet.
static int allowed(const Front *f, int a, int b, int c)
{
  return a < f->points.n0 || b < f->points.n0 || c < f->points.n0 || opposite(&f->end, a, b) == c;
}

int is_final(const Front *f, int t)
{
  const int *v = f->triangle[t].v;
  return v[0] >= f->points.n0 && v[1] >= f->points.n0 && v[2] >= f->points.n0;
}

// ---------------------------------------------------------------------------------------------
// Events. Those that are known at first are sorted: what waits for long is out of the way. The others
// are a heap of four children a node.

// Add an event behind the others. Returns its number, −1: no memory.
static int add_event(Front *f, double t, int triangle, int move)
{
  if (f->num_events == f->max_events)
  {
    int size = 2 * f->max_events + 64;
    Event *heap = realloc(f->heap, size * sizeof(Event));
    if (!heap)
    {
      f->failed = 1;
      return -1;
    }
    f->heap = heap;
    f->max_events = size;
  }
  const Triangle *tri = f->triangle + triangle;
  int behind = move < 0 ? triangle : tri->behind[move];
  Event e = {t, triangle, move, tri->stamp, behind, f->triangle[behind].stamp};
  f->heap[f->num_events] = e;
  return f->num_events++;
}

static void push(Front *f, double t, int triangle, int move)
{
  int i = add_event(f, t, triangle, move);
  if (i < 0 || !f->sorted) // all are sorted once they are there
    return;
  Event e = f->heap[i];
  for (; i > 0 && f->heap[(i - 1) / 4].t > t; i = (i - 1) / 4)
    f->heap[i] = f->heap[(i - 1) / 4];
  f->heap[i] = e;
}

static int earlier(const void *a, const void *b)
{
  const Event *e = a, *g = b;
  if (e->t != g->t)
    return e->t < g->t ? -1 : 1;
  return e->triangle != g->triangle ? e->triangle - g->triangle : e->move - g->move;
}

// Sort the events that there are: from now on others come into a heap.
void sort_events(Front *f)
{
  qsort(f->heap, f->num_events, sizeof(Event), earlier);
  f->sorted = f->heap;
  f->num_sorted = f->num_events;
  f->heap = NULL;
  f->num_events = f->max_events = f->next_sorted = 0;
}

void forget_events(Front *f)
{
  free(f->heap), free(f->sorted);
  f->heap = f->sorted = NULL;
  f->num_events = f->max_events = f->num_sorted = f->next_sorted = 0;
}

int has_events(const Front *f)
{
  return f->num_events || f->next_sorted < f->num_sorted;
}

Event pop(Front *f)
{
  const Event *known = f->sorted + f->next_sorted;
  if (f->next_sorted < f->num_sorted && (!f->num_events || known->t <= f->heap[0].t))
  {
    ++f->next_sorted;
    return *known;
  }
  Event first = f->heap[0], last = f->heap[--f->num_events];
  int i = 0, n = f->num_events;
  for (;;)
  {
    int child = 4 * i + 1, least = child;
    if (child >= n)
      break;
    for (int k = child + 1; k < child + 4 && k < n; ++k)
      if (f->heap[k].t < f->heap[least].t)
        least = k;
    if (f->heap[least].t >= last.t)
      break;
    f->heap[i] = f->heap[least];
    i = least;
  }
  f->heap[i] = last;
  return first;
}

int is_stale(const Front *f, const Event *e)
{
  const Triangle *tri = f->triangle + e->triangle;
  if (tri->stamp != e->stamp)
    return 1;
  if (e->move < 0)
    return f->home[-1 - e->move] != e->triangle;
  return tri->behind[e->move] != e->behind || f->triangle[e->behind].stamp != e->stamp_behind;
}

// ---------------------------------------------------------------------------------------------
// The front's triangles

static int edge_from(const Triangle *tri, int a)
{
  return tri->v[0] == a ? 0 : tri->v[1] == a ? 1 : 2;
}

// Make t the triangle (a,b,c); what is behind it comes later.
void set(Front *f, int t, int a, int b, int c)
{
  Triangle *tri = f->triangle + t;
  tri->v[0] = a, tri->v[1] = b, tri->v[2] = c;
  tri->behind[0] = tri->behind[1] = tri->behind[2] = -1;
  tri->head = -1;
  ++tri->stamp;
}

// Join t, which has the edge from a to b, to u (−1: none) behind it.
static void join(Front *f, int t, int u, int a, int b)
{
  f->triangle[t].behind[edge_from(f->triangle + t, a)] = u;
  if (u >= 0)
    f->triangle[u].behind[edge_from(f->triangle + u, b)] = t;
}

static int new_triangle(Front *f)
{
  if (f->num_spare)
    return f->spare[--f->num_spare];
  f->triangle[f->num_triangles].stamp = 0;
  return f->num_triangles++;
}

static void add_cell(Front *f, int a, int b, int c, int d)
{
  int *cell = f->cells + 4 * f->num_cells++;
  cell[0] = a, cell[1] = b, cell[2] = c, cell[3] = d;
}

// Whether the front has an edge between p, a vertex of t, and s: looks at all triangles around p.
static int in_front(const Front *f, int t, int p, int s)
{
  for (int turn = 0; turn < 2; ++turn)
  {
    int at = t;
    for (int steps = 0; steps <= f->num_triangles; ++steps)
    {
      const Triangle *tri = f->triangle + at;
      int k = edge_from(tri, p);
      if (tri->v[(k + 1) % 3] == s || tri->v[(k + 2) % 3] == s)
        return 1;
      at = tri->behind[turn ? k : (k + 2) % 3];
      if (at == t)
        return 0;
      if (at < 0)
        break;
    }
  }
  return 0;
}

// ---------------------------------------------------------------------------------------------
// Points of the end that wait in triangles

void put(Front *f, int w, int t)
{
  f->home[w] = t;
  f->next[w] = f->triangle[t].head;
  f->triangle[t].head = w;
}

// Walk from t over the edge that w is farthest beyond, till it is in a triangle. Where there is
// none, the one that it is the least outside of.
int walk(const Front *f, int t, int w, int steps)
{
  int best = t, previous = -1;
  double least = -INFINITY, scale;
  for (; steps > 0; --steps)
  {
    const Triangle *tri = f->triangle + t;
    double inside = INFINITY, beyond = 0;
    int edge = -1;
    for (int k = 0; k < 3; ++k)
    {
      double area = A(&f->points, tri->v[k], tri->v[(k + 1) % 3], w, &scale);
      inside = smaller(inside, area);
      if (area < beyond && tri->behind[k] >= 0 && tri->behind[k] != previous)
      {
        beyond = area;
        edge = k;
      }
    }
    if (inside > least)
    {
      least = inside;
      best = t;
    }
    if (edge < 0 || inside >= 0)
      break;
    previous = t;
    t = tri->behind[edge];
  }
  return best;
}

// Whether w is inside of t, and may be inserted there at time t.
static int insertable(const Front *f, int triangle, int w, double *t)
{
  const int *v = f->triangle[triangle].v;
  for (int k = 0; k < 3; ++k)
  {
    if (v[k] >= f->points.n0 && !is_edge(f, v[k], w))
      return 0;
    if (!allowed(f, v[k], v[(k + 1) % 3], w))
      return 0;
  }
  return due(&f->points, v[0], v[1], v[2], w, t);
}

int is_inside(const Front *f, int t, int w)
{
  const int *v = f->triangle[t].v;
  return ccw(&f->points, v[0], v[1], w) && ccw(&f->points, v[1], v[2], w) && ccw(&f->points, v[2], v[0], w);
}

// The earliest insertion into a triangle. Points that are no longer inside of it move on.
void offer_points(Front *f, int triangle)
{
  double earliest = INFINITY, t;
  int first = -1, w = f->triangle[triangle].head;
  f->triangle[triangle].head = -1;
  while (w >= 0)
  {
    int next = f->next[w], at = triangle, inside = is_inside(f, at, w);
    if (!inside)
    {
      at = walk(f, triangle, w, STEPS);
      inside = at != triangle && is_inside(f, at, w);
    }
    put(f, w, at);
    if (inside && insertable(f, at, w, &t))
    {
      if (at != triangle)
        push(f, t, at, -1 - w);
      else if (t < earliest)
      {
        earliest = t;
        first = w;
      }
    }
    w = next;
  }
  if (first >= 0)
    push(f, earliest, triangle, -1 - first);
}

// ---------------------------------------------------------------------------------------------
// Moves

// What the edge from q to r of a triangle can do: p is opposite to it, s is beyond.
// Returns 0: nothing; 1: flip; 2: remove q; 3: remove r.
static int move_of(const Front *f, int triangle, int k, int *v)
{
  const Triangle *tri = f->triangle + triangle;
  int u = tri->behind[k];
  if (u < 0)
    return 0;
  int q = tri->v[k], r = tri->v[(k + 1) % 3], p = tri->v[(k + 2) % 3];
  int s = f->triangle[u].v[(edge_from(f->triangle + u, r) + 2) % 3];
  v[0] = q, v[1] = r, v[2] = p, v[3] = s;
  int n0 = f->points.n0;
  if ((q >= n0 && r >= n0) || (p < n0 && s < n0) || p == s)
    return 0;
  int near = ccw(&f->points, p, q, s), far = ccw(&f->points, p, s, r);
  if (near && far)
  {
    if (p >= n0 && s >= n0 && !is_edge(f, p, s))
      return 0;
    return allowed(f, p, q, s) && allowed(f, p, s, r);
  }
  if (far && q < n0)
    return allowed(f, p, s, r) ? 2 : 0;
  if (near && r < n0)
    return allowed(f, p, q, s) ? 3 : 0;
  return 0;
}

void offer_edge(Front *f, int t, int k)
{
  int v[4];
  double time;
  if (move_of(f, t, k, v) && due(&f->points, v[0], v[1], v[2], v[3], &time))
    push(f, time, t, k);
}

static void insert(Front *f, int t, int w)
{
  Triangle old = f->triangle[t];
  int *v = old.v, new[3] = {t, new_triangle(f), new_triangle(f)};
  add_cell(f, v[0], v[1], v[2], w);
  for (int k = 0; k < 3; ++k)
    set(f, new[k], v[k], v[(k + 1) % 3], w);
  for (int k = 0; k < 3; ++k)
  {
    join(f, new[k], old.behind[k], v[k], v[(k + 1) % 3]);
    join(f, new[k], new[(k + 1) % 3], v[(k + 1) % 3], w);
  }
  f->home[w] = -1;
  for (int next, i = old.head; i >= 0; i = next)
  {
    next = f->next[i];
    if (i != w)
      put(f, i, walk(f, t, i, STEPS));
  }
  for (int k = 0; k < 3; ++k)
  {
    offer_points(f, new[k]);
    offer_edge(f, new[k], 0);
    offer_edge(f, new[k], 1);
  }
}

// Triangles t = (q,r,p) and u = (r,q,s) become (p,q,s) and (p,s,r).
static void flip(Front *f, int t, int k, const int *v)
{
  int q = v[0], r = v[1], p = v[2], s = v[3], u = f->triangle[t].behind[k];
  const Triangle *a = f->triangle + t, *b = f->triangle + u;
  int m = edge_from(b, r), heads[2] = {a->head, b->head};
  int rp = a->behind[(k + 1) % 3], pq = a->behind[(k + 2) % 3];
  int qs = b->behind[(m + 1) % 3], sr = b->behind[(m + 2) % 3];
  add_cell(f, q, r, p, s);
  set(f, t, p, q, s);
  set(f, u, p, s, r);
  join(f, t, pq, p, q);
  join(f, t, qs, q, s);
  join(f, t, u, s, p);
  join(f, u, sr, s, r);
  join(f, u, rp, r, p);
  double scale;
  for (int i = 0; i < 2; ++i)
    for (int next, w = heads[i]; w >= 0; w = next)
    {
      next = f->next[w];
      put(f, w, A(&f->points, p, s, w, &scale) > 0 ? u : t);
    }
  offer_points(f, t);
  offer_points(f, u);
  for (int i = 0; i < 3; ++i)
    offer_edge(f, t, i);
  offer_edge(f, u, 1);
  offer_edge(f, u, 2);
}

// The three triangles around q become one. The triangle t has the edge from q to r or from r to q.
// Returns 0 where more than three meet at q.
static int remove_vertex(Front *f, int t, int q, const int *v)
{
  int around[3], corner[3], behind[3], at = t;
  for (int i = 0; i < 3; ++i)
  {
    const Triangle *tri = f->triangle + at;
    int k = edge_from(tri, q);
    around[i] = at;
    corner[i] = tri->v[(k + 1) % 3];
    behind[i] = tri->behind[(k + 1) % 3];
    at = tri->behind[(k + 2) % 3];
    if (at < 0)
      return 0;
  }
  if (at != t)
    return 0;
  add_cell(f, v[0], v[1], v[2], v[3]);
  int heads[3];
  for (int i = 0; i < 3; ++i)
    heads[i] = f->triangle[around[i]].head;
  set(f, t, corner[0], corner[1], corner[2]);
  for (int i = 0; i < 3; ++i)
    join(f, t, behind[i], corner[i], corner[(i + 1) % 3]);
  for (int i = 1; i < 3; ++i)
  {
    f->triangle[around[i]].head = -1;
    ++f->triangle[around[i]].stamp;
    f->triangle[around[i]].v[0] = -1;
    f->spare[f->num_spare++] = around[i];
  }
  for (int i = 0; i < 3; ++i)
    for (int next, w = heads[i]; w >= 0; w = next)
    {
      next = f->next[w];
      put(f, w, t);
    }
  offer_points(f, t);
  for (int i = 0; i < 3; ++i)
    offer_edge(f, t, i);
  return 1;
}

void carry_out(Front *f, const Event *e)
{
  int v[4];
  if (e->move < 0)
  {
    insert(f, e->triangle, -1 - e->move);
    return;
  }
  int move = move_of(f, e->triangle, e->move, v);
  if (move == 1 && !in_front(f, e->triangle, v[2], v[3]))
    flip(f, e->triangle, e->move, v);
  else if (move > 1)
    remove_vertex(f, e->triangle, v[move - 2], v);
}
