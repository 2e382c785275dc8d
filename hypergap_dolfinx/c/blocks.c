// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Sums of sparse matrices' blocks.

#include <stdlib.h>

#include "adjacency.h"
#include "space.h"

// Add each block to the first one of the same place.
//
// num       groups of blocks: of all pairs of a rows and b columns
// rows      (num, a), below num_rows
// columns   (num, b), below num_columns
// size      numbers in a block
// values    (num, a, b, size)
// first     the first of each place, by rows, (num a b)
// Returns the number of places, or −1 without memory.
int merge_blocks(int num_rows, int num_columns, int num, int a, const int *rows, int b,
                 const int *columns, int size, double *values, int *first)
{
  int *offset = calloc(num_rows + 2, sizeof(int)), found = 0;
  int *at = malloc(((size_t)num * a + 1) * sizeof(int));
  int *place = calloc(num_columns + 1, sizeof(int)); // of the last row's block in each column
  if (!offset || !at || !place)
    found = -1;
  else
    sort_at_vertices(num_rows, 1, num * a, rows, offset, at);
  for (int i = 0, start = 1; found >= 0 && i < num_rows; ++i, start = found + 1)
    for (int k = offset[i]; k < offset[i + 1]; ++k)
      for (int j = 0; j < b; ++j)
      {
        int *known = place + columns[b * (at[k] / a) + j], e = b * at[k] + j;
        if (*known < start)
        {
          first[found] = e;
          *known = ++found;
          continue;
        }
        double *sum = values + (size_t)size * first[*known - 1];
        for (int c = 0; c < size; ++c)
          sum[c] += values[(size_t)size * e + c];
      }
  free(offset), free(at), free(place);
  return found;
}
