// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Which facets cells and edges belong to.

// The facets around each vertex: those of v are facet[offset[v]] to facet[offset[v + 1] − 1].
typedef struct {
  int *offset, *facet;
} Around;

// Of things with some vertices each; offset is 0 at first.
static void sort_at_vertices(int n, int size, int num, const int *vertices, int *offset, int *at)
{
  for (int i = 0; i < size * num; ++i)
    ++offset[vertices[i] + 2];
  for (int i = 2; i < n + 2; ++i)
    offset[i] += offset[i - 1];
  for (int i = 0; i < size * num; ++i)
    at[offset[vertices[i] + 1]++] = i / size;
}

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

// Find the facets of a surface that are faces of cells.
//
// on          whether each vertex is on the surface, (n)
// bases       (num_cells): the facet, −1 of cells that have none
int find_bases(int n, const int *on, int num_facets, const int *facets, int num_cells,
               const int *cells, int *bases)
{
  Around around = {0};
  int done = gather(&around, n, num_facets, facets);
  for (int i = 0; done && i < num_cells; ++i)
  {
    int corners[4], num = 0;
    for (int k = 0; k < 4; ++k)
      if (on[cells[4 * i + k]])
        corners[num++] = cells[4 * i + k];
    bases[i] = num == 3 ? facet_of(&around, facets, 3, corners) : -1;
  }
  free(around.offset), free(around.facet);
  return done ? DONE : NO_MEMORY;
}
