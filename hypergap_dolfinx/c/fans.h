// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Cells of contact's Σ in the plane where they are (fans.c).

#ifndef HYPERGAP_FANS_H
#define HYPERGAP_FANS_H

#include <math.h>

#include "plane.h"

enum { NOWHERE = -1, AT_START, AT_END, AT_MIDDLE, FIXED }; // parameters that don't move

static const double positions[FIXED] = {0, 1, 0.5};

// A point of an edge, and two derivatives by its reference coordinate.
typedef struct {
  double N[3][MOST_DOFS]; // functions of the dofs
  double x[3][2];
} Jet;

// A cell where it is.
typedef struct {
  const Side *base;
  int edge, num_base, num_apex; // of dofs
  int num;                      // of variables
  double s[3];                  // s₁, s₂, r
  double origin[2];             // differences keep their digits far from the origin
  Jet ends[2], apex;
  double chord[2];    // x(s₂) − x(s₁)
  double reach[2][2]; // q − x(s₁), q − x(s₂)
} Shape;

// Node k of an edge.
static inline const double *node(const Side *side, int edge, int k)
{
  return side->nodes + 2 * (edge * side->num_nodes + k);
}

// From the start of an edge to its end.
static inline double chord(const Side *side, int edge, double *c)
{
  const double *x = node(side, edge, 0), *y = node(side, edge, 1);
  c[0] = y[0] - x[0], c[1] = y[1] - x[1];
  return sqrt(c[0] * c[0] + c[1] * c[1]);
}

Shape shape_of(const Sigma *sigma, const Cell *cell);
double volume(const Shape *c, double *first);
void volume_hessian(const Shape *c, int n, double H[n][n]);
void slip(const Shape *c, int n, double *T, double (*S)[n]);
void crossing_hessian(const Sigma *sigma, int k, int n, double H[n][n]);

#endif
