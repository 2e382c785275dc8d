// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Walls of surfaces, edges in the plane or triangles. Python reads this file too (core/compiled.py).

#ifndef HYPERGAP_WALLS_H
#define HYPERGAP_WALLS_H

// A surface before and after it moved.
typedef struct {
  int n, num;
  const int *vertices; // of its simplices, (num, n)
  const double *x;     // where they are, (2, num, n, 3)
} Moved;

int find_passed(const Moved *mine, const Moved *others, int itself, double least, double facing,
                int *found);

#endif
