// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Products of sparse matrices (surface/moving.py), row by row.

#include "sparse.h"

#include <stdlib.h>

static int64_t end_of(int64_t num, const int64_t *numbers, int64_t least)
{
  for (int64_t k = 0; k < num; ++k)
    least = numbers[k] < least ? least : numbers[k] + 1;
  return least;
}

// Sort entries by their rows.
//
// first  of each row in the order, and the end, (num_rows + 1), 0 before
static void sort(int64_t num, const int64_t *rows, int64_t num_rows, int64_t *first, int64_t *order)
{
  for (int64_t k = 0; k < num; ++k)
    ++first[rows[k]];
  for (int64_t r = 1; r <= num_rows; ++r)
    first[r] += first[r - 1];
  for (int64_t k = num; k-- > 0;)
    order[--first[rows[k]]] = k;
}

// A B; entries at one place are added.
//
// rows, columns, values  of the product, with room for that of each two entries
// Returns their number, −1 without memory.
int64_t multiply(int64_t num_a, const int64_t *rows_a, const int64_t *columns_a, const double *a,
                 int64_t num_b, const int64_t *rows_b, const int64_t *columns_b, const double *b,
                 int64_t *rows, int64_t *columns, double *values)
{
  int64_t num_rows = end_of(num_a, rows_a, 0), num = 0;
  int64_t inner = end_of(num_b, rows_b, end_of(num_a, columns_a, 0));
  int64_t num_columns = end_of(num_b, columns_b, 0);
  int64_t *first_a = calloc(num_rows + inner + 2 + num_columns + num_a + num_b, sizeof(int64_t));
  if (!first_a)
    return -1;
  int64_t *first_b = first_a + num_rows + 1, *behind = first_b + inner + 1; // place + 1 of a column
  int64_t *order_a = behind + num_columns, *order_b = order_a + num_a;
  sort(num_a, rows_a, num_rows, first_a, order_a);
  sort(num_b, rows_b, inner, first_b, order_b);
  for (int64_t r = 0; r < num_rows; ++r)
  {
    int64_t start = num;
    for (int64_t k = first_a[r]; k < first_a[r + 1]; ++k)
    {
      int64_t by = order_a[k], row = columns_a[by];
      for (int64_t l = first_b[row]; a[by] != 0 && l < first_b[row + 1]; ++l)
      {
        int64_t at = order_b[l], column = columns_b[at];
        if (behind[column] <= start)
        {
          rows[num] = r, columns[num] = column, values[num] = 0;
          behind[column] = ++num;
        }
        values[behind[column] - 1] += a[by] * b[at];
      }
    }
  }
  free(first_a);
  return num;
}

// Products with several vectors, added.
//
// x, y  (num_x, num_columns) and (num_x, num_rows)
void apply(int64_t num, const int64_t *rows, const int64_t *columns, const double *values,
           int64_t num_x, int64_t num_columns, const double *x, int64_t num_rows, double *y)
{
  for (int64_t n = 0; n < num_x; ++n, x += num_columns, y += num_rows)
    for (int64_t k = 0; k < num; ++k)
      y[rows[k]] += values[k] * x[columns[k]];
}
