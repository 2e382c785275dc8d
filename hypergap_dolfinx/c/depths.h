// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// What of a body's surface is nearest to a point (depths.c).

#ifndef HYPERGAP_DEPTHS_H
#define HYPERGAP_DEPTHS_H

#include "balls.h"
#include "space.h"

// The surface of a body.
typedef struct {
  int num_triangles;
  const double *x;  // corners, counterclockwise from outside, (num_triangles, 3, 3)
  const int *order; // the triangles along a curve that fills space
  int triangles_a_facet;
  const Own *own;   // NULL: of another surface than the points
  Ball *balls;      // around runs of them
} Body;

// What is nearest to a point as far as is known.
typedef struct {
  const Body *body;
  const double *point;
  int facet;               // of Γ1, where the point is
  double nearest, inside;  // distance, and that from the triangle's plane, positive inside
  int triangle;
  int corners[2]; // ends of the edge that is nearest, the same ones of a corner; −1: all of it
} Nearest;

static inline double depth_by(Nearest found)
{
  return found.inside < 0 ? -found.nearest : found.nearest;
}

int open_body(Body *body); // 0 without memory
Nearest nearest_of(const Body *body, const double *point, int facet);

#endif
