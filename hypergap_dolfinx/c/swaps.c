// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Swaps of cells for others that fill the same room with smaller derivatives by α.
//
// ∂λ_a/∂α = ±A(face opposite to a)/D, seen along the cell's normal: at most 1 where what faces each
// other lies on each other. A cell with larger ones extrapolates, and a few such cells decide about
// the condition of G.

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "gap_mesh.h"
#include "predicates.h"

#define RING 6 // cells around an edge at most
#define BANDS 4 // of qualities, each half of the last: derivatives above 16, 8, 4, 2
#define MORE (1 + 1e-9) // what is better by less is as good: round-off doesn't choose

typedef struct {
  Points points;
  int *cells, num, max; // cells that are gone have −1 as their first vertex
  double *quality;      // of each cell
  int *first, *next;    // cells at each vertex: 4 c + k, and who comes next
  const int *rank;      // of each vertex
} Cells;

typedef struct {
  int ranks[4], cell;
} Bad;

typedef struct {
  double value;        // the least of the cells that come
  int gone[RING], num_gone;
  int come[2 * RING][4], num_come;
} Swap;

// Vertices of the face opposite to vertex k, such that they and one beyond it are a cell.
static const int opposite_face[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

// D over the largest A of a face: what ∂λ/∂α is at most, to the power −1. Not positive if it is flat.
static double quality(const Points *p, int a, int b, int c, int d)
{
  const int v[4] = {a, b, c, d};
  double n[3], scale, largest = 0;
  unit_sum(p->vertex[a].n, p->vertex[b].n, p->vertex[c].n, p->vertex[d].n, n);
  double area = D(p, a, b, c, d, n, &scale);
  if (!(area > p->flat * scale))
    return 0;
  for (int k = 0; k < 4; ++k)
  {
    const int *f = opposite_face[k];
    double e[3], g[3];
    minus(p->vertex[v[f[1]]].x, p->vertex[v[f[0]]].x, e);
    minus(p->vertex[v[f[2]]].x, p->vertex[v[f[0]]].x, g);
    largest = larger(largest, fabs(triple(e, g, n)));
  }
  return area / largest;
}

static double quality_of(const Points *p, const int *v)
{
  return quality(p, v[0], v[1], v[2], v[3]);
}

// Edges inside of Σ go from one side to the other.
static int may_be_edge(const Cells *all, int a, int b)
{
  return (a < all->points.n0) != (b < all->points.n0);
}

// The vertices by their ranks, and as even as before: which swaps are made mustn't depend on how
// vertices and cells are numbered.
static void sort_vertices(const int *rank, int *v)
{
  int odd = 0;
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3 - i; ++k)
      if (rank[v[k]] > rank[v[k + 1]])
      {
        int w = v[k];
        v[k] = v[k + 1], v[k + 1] = w;
        odd = !odd;
      }
  if (odd)
  {
    int w = v[2];
    v[2] = v[3], v[3] = w;
  }
}

static int by_ranks(const void *a, const void *b)
{
  const int *v = ((const Bad *)a)->ranks, *w = ((const Bad *)b)->ranks;
  for (int k = 0; k < 4; ++k)
    if (v[k] != w[k])
      return v[k] < w[k] ? -1 : 1;
  return 0;
}

static void link_cell(Cells *all, int c)
{
  for (int k = 0; k < 4; ++k)
  {
    int v = all->cells[4 * c + k];
    all->next[4 * c + k] = all->first[v];
    all->first[v] = 4 * c + k;
  }
}

static int place_of(const int *v, int a)
{
  for (int k = 0; k < 4; ++k)
    if (v[k] == a)
      return k;
  return -1;
}

// Two cells at a face become three around a new edge.
static void try_face(const Cells *all, int cell, int k, Swap *best)
{
  const int *v = all->cells + 4 * cell, *f = opposite_face[k];
  int a = v[k], c = v[f[0]], d = v[f[1]], e = v[f[2]], other = -1, b = -1;
  for (int i = all->first[c]; i >= 0; i = all->next[i])
  {
    const int *w = all->cells + 4 * (i / 4);
    if (w[0] >= 0 && i / 4 != cell && place_of(w, d) >= 0 && place_of(w, e) >= 0)
    {
      other = i / 4;
      b = w[0] ^ w[1] ^ w[2] ^ w[3] ^ c ^ d ^ e;
    }
  }
  if (other < 0 || a == b || !may_be_edge(all, a, b))
    return;
  const int come[3][4] = {{a, b, c, d}, {a, b, d, e}, {a, b, e, c}};
  double value = INFINITY, before = smaller(all->quality[cell], all->quality[other]);
  double bound = MORE * larger(best->value, before);
  for (int i = 0; i < 3 && value > bound; ++i)
    value = smaller(value, quality_of(&all->points, come[i]));
  if (!(value > bound))
    return;
  best->value = value;
  best->num_gone = 2, best->num_come = 3;
  best->gone[0] = cell, best->gone[1] = other;
  memcpy(best->come, come, sizeof(come));
}

// The cells around the edge from a to b, and the polygon of their other vertices, counterclockwise
// seen from b. Returns its number of corners, 0 at the boundary and where there are too many.
static int ring(const Cells *all, int a, int b, int *cells, int *polygon)
{
  int num = 0, from[RING], to[RING];
  for (int i = all->first[a]; i >= 0; i = all->next[i])
  {
    const int *v = all->cells + i - i % 4;
    int l = v[0] < 0 ? -1 : place_of(v, b);
    if (l < 0)
      continue;
    if (num == RING)
      return 0;
    int k = i % 4, m = 0, rest[2];
    for (int j = 0; j < 4; ++j)
      if (j != k && j != l)
        rest[m++] = j;
    // v is even: so is (a, b, c, d) if k, l and the rest are
    int odd = (k > l) + (k > rest[0]) + (k > rest[1]) + (l > rest[0]) + (l > rest[1]);
    from[num] = v[rest[odd % 2]];
    to[num] = v[rest[1 - odd % 2]];
    cells[num++] = i / 4;
  }
  int start = 0;
  for (int j = 1; j < num; ++j)
    if (all->rank[from[j]] < all->rank[from[start]])
      start = j;
  for (int i = 0, at = start; i < num; ++i)
  {
    polygon[i] = from[at];
    int next = -1;
    for (int j = 0; j < num; ++j)
      if (from[j] == to[at])
        next = j;
    if (next < 0 || (next == start) != (i == num - 1))
      return 0;
    at = next;
  }
  return num < 3 ? 0 : num;
}

// The n cells around an edge become 2 (n − 2) without it: the polygon is cut such that the worst of
// them is as good as can be.
static void try_edge(const Cells *all, int a, int b, Swap *best)
{
  int cells[RING], p[RING], cut[RING][RING], n = ring(all, a, b, cells, p);
  double value[RING][RING], before = INFINITY;
  if (!n)
    return;
  for (int i = 0; i < n; ++i)
    before = smaller(before, all->quality[cells[i]]);
  before = larger(best->value, before);
  for (int reach = 1; reach < n; ++reach)
    for (int i = 0; i + reach < n; ++i)
    {
      int j = i + reach;
      value[i][j] = reach == 1 ? INFINITY : 0;
      if (reach > 1 && (reach == n - 1 || may_be_edge(all, p[i], p[j])))
        for (int k = i + 1; k < j; ++k)
        {
          double least = smaller(value[i][k], value[k][j]);
          if (least > MORE * larger(before, value[i][j]))
            least = smaller(least, quality(&all->points, p[i], p[k], p[j], b));
          if (least > MORE * larger(before, value[i][j]))
            least = smaller(least, quality(&all->points, p[k], p[i], p[j], a));
          if (least > MORE * value[i][j])
          {
            value[i][j] = least;
            cut[i][j] = k;
          }
        }
    }
  if (!(value[0][n - 1] > MORE * before))
    return;
  best->value = value[0][n - 1];
  best->num_gone = n, best->num_come = 0;
  memcpy(best->gone, cells, n * sizeof(int));
  int from[RING] = {0}, to[RING] = {n - 1};
  for (int left = 1; left;)
  {
    int i = from[--left], j = to[left], k = cut[i][j];
    const int come[2][4] = {{p[i], p[k], p[j], b}, {p[k], p[i], p[j], a}};
    memcpy(best->come[best->num_come], come, sizeof(come));
    best->num_come += 2;
    if (k > i + 1)
      from[left] = i, to[left++] = k;
    if (j > k + 1)
      from[left] = k, to[left++] = j;
  }
}

// Swap one cell and those beside it, if that makes the worst of these better. Returns whether it did.
static int swap(Cells *all, int cell)
{
  Swap best = {.value = 1e-12};
  const int *v = all->cells + 4 * cell;
  for (int k = 0; k < 4; ++k)
    try_face(all, cell, k, &best);
  for (int k = 0; k < 4; ++k)
    for (int l = 0; l < k; ++l)
      try_edge(all, v[k], v[l], &best);
  if (!best.num_come || all->num + best.num_come > all->max)
    return 0;
  for (int i = 0; i < best.num_gone; ++i)
    all->cells[4 * best.gone[i]] = -1;
  for (int i = 0; i < best.num_come; ++i)
  {
    memcpy(all->cells + 4 * all->num, best.come[i], 4 * sizeof(int));
    sort_vertices(all->rank, all->cells + 4 * all->num);
    all->quality[all->num] = quality_of(&all->points, all->cells + 4 * all->num);
    link_cell(all, all->num++);
  }
  return 1;
}

// Swap cells whose derivatives by α are large for others with smaller ones.
//
// flat        D of a cell, over its scale, up to which there is to be none
// least       cells of lower quality are swapped
// rank        of each vertex, the same however they are numbered
// num, cells  the cells, with room for max
// Returns the number of cells, −1: no memory.
int front_swap(int n0, int n, const double *vertices, const int *rank, double flat, double least,
               int num, int max, int *cells)
{
  Cells all = {.points = {n0, n, (const Vertex *)vertices, flat},
               .cells = cells,
               .num = num,
               .max = max,
               .rank = rank};
  all.first = malloc((n + 1) * sizeof(int));
  all.next = malloc((4 * (size_t)max + 1) * sizeof(int));
  all.quality = malloc(((size_t)max + 1) * sizeof(double));
  Bad *bad = NULL;
  int kept = -1, num_bad = 0;
  if (!all.first || !all.next || !all.quality)
    goto finish;
  for (int c = 0; c < num; ++c)
  {
    sort_vertices(rank, cells + 4 * c);
    all.quality[c] = quality_of(&all.points, cells + 4 * c);
    num_bad += all.quality[c] < least;
  }
  bad = malloc((num_bad + 1) * sizeof(Bad));
  if (!bad)
    goto finish;
  if (num_bad) // most fronts have none
  {
    memset(all.first, -1, n * sizeof(int));
    for (int c = 0, i = 0; c < num; ++c)
    {
      link_cell(&all, c);
      if (all.quality[c] < least)
      {
        for (int k = 0; k < 4; ++k)
          bad[i].ranks[k] = rank[cells[4 * c + k]];
        bad[i++].cell = c;
      }
    }
    qsort(bad, num_bad, sizeof(Bad), by_ranks);
  }
  // the worst first, which others may be in the way of; and again, when others have made way
  for (int band = num_bad > 0 ? BANDS : 0; band--;)
  {
    double limit = ldexp(least, -band);
    for (int i = 0; i < num_bad; ++i)
      if (cells[4 * bad[i].cell] >= 0 && all.quality[bad[i].cell] < limit)
        swap(&all, bad[i].cell);
    for (int c = num; c < all.num; ++c) // those that came
      if (cells[4 * c] >= 0 && all.quality[c] < limit)
        swap(&all, c);
  }
  kept = 0;
  for (int c = 0; c < all.num; ++c)
    if (cells[4 * c] >= 0)
    {
      if (kept < c)
        memcpy(cells + 4 * kept, cells + 4 * c, 4 * sizeof(int));
      ++kept;
    }
finish:
  free(bad), free(all.first), free(all.next), free(all.quality);
  return kept;
}
