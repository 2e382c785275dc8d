// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Things by their vertices.

#ifndef HYPERGAP_ADJACENCY_H
#define HYPERGAP_ADJACENCY_H

// Sort things by their vertices: those at v are at[offset[v]] to at[offset[v + 1] − 1].
//
// size, num   vertices of each thing, number of things
// vertices    (num, size)
// offset      (n + 2), 0 at first
// at          (size num)
static inline void sort_at_vertices(int n, int size, int num, const int *vertices, int *offset, int *at)
{
  for (int i = 0; i < size * num; ++i)
    ++offset[vertices[i] + 2];
  for (int i = 2; i < n + 2; ++i)
    offset[i] += offset[i - 1];
  for (int i = 0; i < size * num; ++i)
    at[offset[vertices[i] + 1]++] = i / size;
}

#endif
