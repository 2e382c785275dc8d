// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Facets that cells and edges belong to.

#include <stdlib.h>

#include "adjacency.h"
#include "gap_mesh.h"
#include "vectors.h"

// The facets around each vertex: those of v are facet[offset[v]] to facet[offset[v + 1] − 1].
typedef struct {
  int *offset, *facet;
} Around;

static int gather(Around *around, int n, int num, const int *facets)
{
  around->offset = calloc(n + 2, sizeof(int));
  around->facet = malloc((3 * num + 1) * sizeof(int));
  if (!around->offset || !around->facet)
    return 0;
  sort_at_vertices(n, 3, num, facets, around->offset, around->facet);
  return 1;
}

// The cells at each vertex v: at[offset[v]] to at[offset[v + 1] − 1].
//
// offset      (n + 2), 0 at first
// at          (4 num)
int cells_at_vertices(int n, int num, const int *cells, int *offset, int *at)
{
  sort_at_vertices(n, 4, num, cells, offset, at);
  return DONE;
}

static int has(const int *facet, int v)
{
  return facet[0] == v || facet[1] == v || facet[2] == v;
}

// The first facet that has all of some vertices, −1 if none has.
static int facet_of(const Around *around, const int *facets, int size, const int *corners)
{
  for (int i = around->offset[corners[0]]; i < around->offset[corners[0] + 1]; ++i)
  {
    int facet = around->facet[i], all = 1;
    for (int k = 1; k < size; ++k)
      all &= has(facets + 3 * facet, corners[k]);
    if (all)
      return facet;
  }
  return -1;
}

// Find a facet with given vertices.
//
// n, facets   number of vertices; three of each facet
// size        1, 2 or 3 vertices are given
// corners     (num, size)
// found       (num): the first facet that has them, −1 where there is none
int find_facets(int n, int num_facets, const int *facets, int size, int num, const int *corners,
                int *found)
{
  Around around = {0};
  int done = gather(&around, n, num_facets, facets);
  for (int i = 0; done && i < num; ++i)
    found[i] = facet_of(&around, facets, size, corners + size * i);
  free(around.offset), free(around.facet);
  return done ? DONE : NO_MEMORY;
}

// Find the facets of both sides that are faces of cells.
//
// n0, n1      vertices of Γ0, then of Γ1; the others are between them
// facets      (num_facets, 3): one side's, in numbers of its own
// bases       (2, num_cells): the facet of each side, −1 of cells that have none
int find_bases(int n0, int n1, int num0, const int *facets0, int num1, const int *facets1,
               int num_cells, const int *cells, int *bases)
{
  Around around[2] = {{0}, {0}};
  int done = gather(around, n0, num0, facets0) && gather(around + 1, n1, num1, facets1);
  for (int i = 0; done && i < num_cells; ++i)
  {
    int corners[2][4], num[2] = {0, 0};
    for (int k = 0; k < 4; ++k)
    {
      int v = cells[4 * i + k];
      if (v < n0)
        corners[0][num[0]++] = v;
      else if (v < n0 + n1)
        corners[1][num[1]++] = v - n0;
    }
    bases[i] = num[0] == 3 ? facet_of(around, facets0, 3, corners[0]) : -1;
    bases[num_cells + i] = num[1] == 3 ? facet_of(around + 1, facets1, 3, corners[1]) : -1;
  }
  for (int side = 0; side < 2; ++side)
    free(around[side].offset), free(around[side].facet);
  return done ? DONE : NO_MEMORY;
}

// A facet of a side at each cell: at a vertex on it, else at an interior one.
//
// first, last the side's vertices; others have one if they are interior
// seeds       (n): a facet at each vertex, −1 where there is none
// beside      (num)
void facets_beside(int first, int last, const int *seeds, int num, const int *cells, int *beside)
{
  for (int i = 0; i < num; ++i)
  {
    int own = -1, other = -1;
    for (int k = 3; k >= 0; --k)
    {
      int v = cells[4 * i + k], facet = seeds[v];
      if (facet >= 0 && first <= v && v < last)
        own = facet;
      else if (facet >= 0)
        other = facet;
    }
    beside[i] = own >= 0 ? own : other;
  }
}

// Unit normals of cells: the mean at their vertices, or a base's.
//
// at_vertices (n, 3)
// bases       (2, num), as of find_bases
// normals0, 1 of both sides' facets, out of the bodies
// normals     (num, 3), from Γ0 to Γ1
void cell_normals(int num, const int *cells, const double *at_vertices, const int *bases,
                  const double *normals0, const double *normals1, double *normals)
{
  for (int i = 0; i < num; ++i)
  {
    const int *v = cells + 4 * i, base0 = bases[i], base1 = bases[num + i];
    double n[3];
    for (int j = 0; j < 3; ++j)
      n[j] = base1 >= 0   ? -normals1[3 * base1 + j]
             : base0 >= 0 ? normals0[3 * base0 + j]
                          : at_vertices[3 * v[0] + j] + at_vertices[3 * v[1] + j]
                                + at_vertices[3 * v[2] + j] + at_vertices[3 * v[3] + j];
    double length = sqrt(dot(n, n));
    for (int j = 0; j < 3; ++j)
      normals[3 * i + j] = n[j] / length;
  }
}

// Where some of the cells' points lie on a side: those that are vertices.
//
// num, which  some cells, and which
// points      of each cell, of which some are vertices of it: num_local of them,
// local, at   which, and which of the points that is
// on, X       (n): facet at each vertex, −1 of the other side's, (n, 2): place in it
// beside      (num_cells): a facet at each cell
// facets, places (num, points), (num, points, 2): what is filled in
void vertex_hosts(int num, const int64_t *which, const int *cells, int points, int num_local,
                  const int *local, const int *at, const int *on, const double *X,
                  const int *beside, int64_t *facets, double *places)
{
  for (int i = 0; i < num; ++i)
    for (int k = 0; k < num_local; ++k)
    {
      int v = cells[4 * which[i] + local[k]];
      size_t to = (size_t)points * i + at[k];
      facets[to] = on[v] >= 0 ? on[v] : beside[which[i]];
      places[2 * to] = X[2 * v], places[2 * to + 1] = X[2 * v + 1];
    }
}
