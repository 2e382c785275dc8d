// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Whether cells are what they should be, whoever made them.

// A face by its vertices in rising order, and whether it is their even permutation.
typedef struct {
  int v[3];
  int seen[2]; // how often it was met: as an even and as an odd permutation
} Face;

static void meet(Face *table, unsigned size, int a, int b, int c)
{
  int odd = 0, swap;
  if (a > b)
    swap = a, a = b, b = swap, odd ^= 1;
  if (b > c)
    swap = b, b = c, c = swap, odd ^= 1;
  if (a > b)
    swap = a, a = b, b = swap, odd ^= 1;
  unsigned long long key = (unsigned)a * 0x9e3779b97f4a7c15ULL + (unsigned)b;
  key = (key ^ (key >> 29)) * 0xbf58476d1ce4e5b9ULL + (unsigned)c;
  key = (key ^ (key >> 32)) * 0x94d049bb133111ebULL;
  unsigned at = (unsigned)(key >> 33) & (size - 1);
  for (;; at = (at + 1) & (size - 1))
  {
    Face *face = table + at;
    int empty = !face->seen[0] && !face->seen[1];
    if (empty)
      face->v[0] = a, face->v[1] = b, face->v[2] = c;
    if (empty || (face->v[0] == a && face->v[1] == b && face->v[2] == c))
    {
      ++face->seen[odd];
      return;
    }
  }
}

// Count the cells that are flat or inverted, and the faces that don't have exactly one cell, or
// triangle of the boundary, on each side.
//
// outer       the boundary, counterclockwise seen from inside
// counts      cells, faces
int front_check(int n0, int n, const double *vertices, int num_cells, const int *cells,
                int num_outer, const int *outer, int *counts)
{
  const int sides[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
  Points points = {n0, n, (const Vertex *)vertices, FLAT};
  counts[0] = counts[1] = 0;
  // Nearly all faces are met twice, so the table is half full at most
  unsigned size = 64;
  while (size < 4u * (unsigned)num_cells + 2u * (unsigned)num_outer)
    size *= 2;
  Face *table = calloc(size, sizeof(Face));
  if (!table)
    return NO_MEMORY;
  for (int i = 0; i < num_cells; ++i)
  {
    const int *v = cells + 4 * i;
    double normal[3], scale;
    unit_sum(points.vertex[v[0]].n, points.vertex[v[1]].n, points.vertex[v[2]].n,
             points.vertex[v[3]].n, normal);
    counts[0] += !(D(&points, v[0], v[1], v[2], v[3], normal, &scale) > FLAT * scale);
    for (int k = 0; k < 4; ++k)
      meet(table, size, v[sides[k][0]], v[sides[k][1]], v[sides[k][2]]);
  }
  for (int i = 0; i < num_outer; ++i)
    meet(table, size, outer[3 * i], outer[3 * i + 1], outer[3 * i + 2]);
  for (unsigned i = 0; i < size; ++i)
    counts[1] += (table[i].seen[0] || table[i].seen[1])
                 && !(table[i].seen[0] == 1 && table[i].seen[1] == 1);
  free(table);
  return DONE;
}
