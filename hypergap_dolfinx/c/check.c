// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Checks of cells: flat or inverted ones, and faces without a neighbour.

#include <stdlib.h>
#include <string.h>

#include "gap_mesh.h"
#include "predicates.h"

// A face of a, b and c in rising order, at the vertex a: the other two, and as the last bit whether
// the face turns the other way.
static unsigned long long face(int b, int c, int odd)
{
  return (unsigned long long)b << 32 | (unsigned)c << 1 | (unsigned)odd;
}

// Put vertices into rising order. Returns whether that is an odd permutation.
static int sort_corners(int num, int *v)
{
  int odd = 0;
  for (int last = num - 1; last > 0; --last)
    for (int k = 0; k < last; ++k)
    {
      int low = v[k] < v[k + 1] ? v[k] : v[k + 1], high = v[k] ^ v[k + 1] ^ low;
      odd ^= v[k] != low;
      v[k] = low, v[k + 1] = high;
    }
  return odd;
}

static int compare(const void *a, const void *b)
{
  unsigned long long u = *(const unsigned long long *)a, v = *(const unsigned long long *)b;
  return (u > v) - (u < v);
}

#define MANY 32 // faces from which insertion is no way to sort them

static void sort_faces(unsigned long long *faces, int num)
{
  if (num > MANY)
  {
    qsort(faces, num, sizeof(*faces), compare);
    return;
  }
  for (int i = 1; i < num; ++i)
  {
    unsigned long long own = faces[i];
    int j = i;
    for (; j > 0 && faces[j - 1] > own; --j)
      faces[j] = faces[j - 1];
    faces[j] = own;
  }
}

// Number of faces that aren't there exactly once in each direction, −1: no memory. Faces are
// gathered at their lowest vertices: what is near in the numbering stays near in memory.
//
// single      room for those that are there once, as they are there; NULL if nobody asks
// num_single  how many
static int num_unpaired(int n, int num_cells, const int *cells, int num_outer, const int *outer,
                        int *single, int *num_single)
{
  int num = 4 * num_cells + num_outer, unpaired = 0, v[4];
  int *offset = calloc(n + 2, sizeof(int));
  unsigned long long *faces = malloc((num + 1) * sizeof(*faces));
  if (!offset || !faces)
    unpaired = -1;
  for (int i = 0; i < num_cells && !unpaired; ++i)
  {
    memcpy(v, cells + 4 * i, sizeof(v));
    sort_corners(4, v);
    offset[v[0] + 2] += 3;
    ++offset[v[1] + 2];
  }
  for (int i = 0; i < num_outer && !unpaired; ++i)
  {
    memcpy(v, outer + 3 * i, 3 * sizeof(int));
    sort_corners(3, v);
    ++offset[v[0] + 2];
  }
  for (int i = 2; i < n + 2 && !unpaired; ++i)
    offset[i] += offset[i - 1];
  for (int i = 0; i < num_cells && !unpaired; ++i)
  {
    memcpy(v, cells + 4 * i, sizeof(v));
    int odd = sort_corners(4, v), *at = offset + v[0] + 1;
    faces[(*at)++] = face(v[2], v[3], !odd); // of an even cell (0, 3, 2), (0, 1, 3), (0, 2, 1), (1, 2, 3)
    faces[(*at)++] = face(v[1], v[3], odd);
    faces[(*at)++] = face(v[1], v[2], !odd);
    faces[offset[v[1] + 1]++] = face(v[2], v[3], odd);
  }
  for (int i = 0; i < num_outer && !unpaired; ++i)
  {
    memcpy(v, outer + 3 * i, 3 * sizeof(int));
    int odd = sort_corners(3, v);
    faces[offset[v[0] + 1]++] = face(v[1], v[2], odd);
  }
  for (int i = 0; i < n && unpaired >= 0; ++i)
  {
    unsigned long long *own = faces + offset[i];
    int count = offset[i + 1] - offset[i];
    sort_faces(own, count);
    for (int j = 0, next; j < count; j = next)
    {
      for (next = j + 1; next < count && own[next] >> 1 == own[j] >> 1; ++next)
        ;
      unpaired += !(next == j + 2 && own[j] != own[j + 1]);
      if (single && next == j + 1)
      {
        int b = (int)(own[j] >> 32), c = (int)((unsigned)own[j] >> 1), odd = own[j] & 1;
        const int given[3] = {i, odd ? c : b, odd ? b : c};
        memcpy(single + 3 * (*num_single)++, given, sizeof(given));
      }
    }
  }
  free(offset), free(faces);
  return unpaired;
}

// Count the cells that are flat or inverted, and the faces that don't have exactly one cell, or
// triangle of the boundary, on each side.
//
// outer       the boundary, counterclockwise seen from inside
// counts      cells, faces
int front_check(int n0, int n, const double *vertices, int num_cells, const int *cells,
                int num_outer, const int *outer, int *counts)
{
  Points points = {n0, n, (const Vertex *)vertices, FLAT};
  counts[0] = 0;
  for (int i = 0; i < num_cells; ++i)
  {
    const int *v = cells + 4 * i;
    double normal[3], scale;
    unit_sum(points.vertex[v[0]].n, points.vertex[v[1]].n, points.vertex[v[2]].n,
             points.vertex[v[3]].n, normal);
    counts[0] += !(D(&points, v[0], v[1], v[2], v[3], normal, &scale) > FLAT * scale);
  }
  counts[1] = num_unpaired(n, num_cells, cells, num_outer, outer, NULL, NULL);
  return counts[1] < 0 ? NO_MEMORY : DONE;
}

// D of cells, and its scale (gap_mesh/tetrahedra.py).
//
// x, alpha    of the vertices, (n, 3) and (n)
// normals     of the vertices, to be added up, (n, 3)
// cells       (num, 4); NULL: the first four vertices are the first one's, and normals are the cells'
void cell_areas(int num, const int *cells, const double *x, const double *alpha,
                const double *normals, double *areas, double *scales)
{
  static const int face[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
  static const int pair[3][4] = {{0, 1, 2, 3}, {0, 2, 1, 3}, {0, 3, 1, 2}};
  for (int i = 0; i < num; ++i)
  {
    const double *p[4];
    double a[4], e[3][3], f[3], g[3], n[3] = {0}, D = 0, scale = 0;
    for (int k = 0; k < 4; ++k)
    {
      size_t v = cells ? (size_t)cells[4 * i + k] : 4 * (size_t)i + k;
      p[k] = x + 3 * v, a[k] = alpha[v];
      for (int j = 0; j < 3; ++j)
        n[j] += cells ? normals[3 * v + j] : k ? 0 : normals[3 * (size_t)i + j];
    }
    for (int k = 0; k < 3; ++k)
    {
      minus(p[k + 1], p[0], e[k]);
      scale = larger(scale, dot(e[k], e[k]));
    }
    for (int k = 0; k < 3; ++k)
      D += (a[k + 1] - a[0]) * triple(e[(k + 1) % 3], e[(k + 2) % 3], n);
    for (int k = 0; k < 4; ++k)
    {
      const int *v = face[k];
      if (a[v[0]] != a[v[1]] || a[v[0]] != a[v[2]])
        continue;
      double normal[3];
      minus(p[v[1]], p[v[0]], f), minus(p[v[2]], p[v[0]], g);
      cross(f, g, normal);
      scale = sqrt(dot(normal, normal)) * fabs(a[k] - a[v[0]]);
    }
    for (int k = 0; k < 3; ++k)
    {
      const int *v = pair[k];
      if (a[v[0]] != a[v[1]] || a[v[2]] != a[v[3]] || a[v[0]] == a[v[2]])
        continue;
      minus(p[v[0]], p[v[1]], f), minus(p[v[2]], p[v[3]], g);
      scale = sqrt(dot(f, f) * dot(g, g));
    }
    areas[i] = D / larger(sqrt(dot(n, n)), 1e-300), scales[i] = scale;
  }
}

// Find the faces around what is missing.
//
// faces       those that one cell, or triangle of the boundary, has alone, as it has them
// counts      faces that don't have exactly one on each side; faces found
int single_faces(int n, int num_cells, const int *cells, int num_outer, const int *outer, int *faces,
                 int *counts)
{
  counts[1] = 0;
  counts[0] = num_unpaired(n, num_cells, cells, num_outer, outer, faces, counts + 1);
  return counts[0] < 0 ? NO_MEMORY : DONE;
}
