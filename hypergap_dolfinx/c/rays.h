// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Edges in the plane, and rays between them (rays.c).

#ifndef HYPERGAP_RAYS_H
#define HYPERGAP_RAYS_H

#include <math.h>

#include "plane.h"

// A point of an edge: functions of its dofs, and its position, with three derivatives each by the
// reference coordinate. Where edges turn, a component of the position also depends on the other
// components at the ends of the mesh's edge.
typedef struct {
  double N[4][MOST_DOFS];
  int turns;
  double across[4]; // the first component falls by it times the second one of the chord, and so on
  double x[4][2];
} Curve;

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

// An edge at a vertex, and the number of its end there.
static inline int edge_at(const Side *side, int vertex, int *end)
{
  const int *beside = side->beside + 2 * vertex;
  *end = beside[0] >= 0;
  return *end ? beside[0] : beside[1];
}

// The edge before the start (0) or behind the end (1) of an edge, or −1.
static inline int beside_of(const Side *side, int edge, int end)
{
  return side->beside[2 * side->vertices[2 * edge + end] + end];
}

Curve curve_at(const Side *side, int edge, double s, const double *origin);
const double *position(const Side *side, int vertex);
void find_column(const Sigma *sigma, const Point *point, double *x, double *at);
double depth_in(const Sigma *sigma, int side, const double *x);

#endif
