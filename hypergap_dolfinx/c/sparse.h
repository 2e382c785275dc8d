// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Sparse matrices as triplets. Python reads this file too (core/compiled.py).

#ifndef HYPERGAP_SPARSE_H
#define HYPERGAP_SPARSE_H

#include <stdint.h>

int64_t multiply(int64_t num_a, const int64_t *rows_a, const int64_t *columns_a, const double *a,
                 int64_t num_b, const int64_t *rows_b, const int64_t *columns_b, const double *b,
                 int64_t *rows, int64_t *columns, double *values);
void apply(int64_t num, const int64_t *rows, const int64_t *columns, const double *values,
           int64_t num_x, int64_t num_columns, const double *x, int64_t num_rows, double *y);

#endif
