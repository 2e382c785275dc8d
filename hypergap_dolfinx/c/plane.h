// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Contact in the plane. Python reads this file too (core/compiled.py).

#ifndef HYPERGAP_PLANE_H
#define HYPERGAP_PLANE_H

#define MOST_DOFS 12 // of an edge

// A side where it is: edges with the body on the left, their reference coordinates from 0 to 1.
typedef struct {
  int num_edges, num_vertices;
  const int *vertices;    // of each edge, (num_edges, 2)
  const int *beside;      // edges that end and start at each vertex, or −1, (num_vertices, 2)
  int num_nodes;          // of an edge's geometry, its ends first
  const double *node_at;  // their reference coordinates
  const double *nodes;    // (num_edges, num_nodes, 2)
  int num_dofs;           // of displacements of an edge, its ends first
  const double *dof_at;   // their reference coordinates
  const int *dofs;        // their numbers, Γ1's behind all of Γ0's, (num_edges, num_dofs)
  int num_points;         // of the quadrature rule
  const double *points, *weights;
} Side;

// A surface's edges one after the other.
typedef struct {
  int num;                   // of chains
  const int *edges;          // chain by chain, (num_edges)
  const int *start, *count;  // of chains: where they start there, their numbers of edges
  const int *closed;         // whether they are loops
  const int *chain;          // of edges
  const int *position;       // of edges in their chains
} Chains;

// Points of Γ0 and Γ1 at one position along the chord of Γ1's edge.
typedef struct {
  int edges[2]; // on Γ0 and Γ1
  int unknown;  // side on which it moves along its edge
  double s[2];  // reference coordinates on both
} Crossing;

// A cell of Σ. Parameters are reference coordinates: those of an edge's start, end and middle, and
// from FIXED on those of crossings.
typedef struct {
  int side;          // of the base
  int base, apex;    // edges
  int parameters[3]; // of the base's start and end, and of the apex
  int vertices[2];   // of Γ1 that share the cell; each has one half
} Cell;

// Σ where the sides are.
typedef struct {
  Side sides[2];
  int num_cells, max_cells, num_crossings;
  Cell *cells;
  Crossing *crossings;
  double *motions; // ∂s/∂u of crossings by the dofs of both their edges, (num_crossings, num)
} Sigma;

// Entries of a sparse matrix. If there is no room for all, num is at least what they need.
typedef struct {
  int max, num;
  int *rows, *columns;
  double *values;
  int *next;  // entry of the same row, −1: none
  int *first; // of each row
} Entries;

void kinks_of(const Side *side, double kink, int *kinks);
int cast_rays(Sigma *sigma, const Chains *chains, const int *kinks, const double *least,
              int num_walls, const int *walls, double end, double faces, double farther,
              const double *beyond, int *whole, int *owners);
void find_crossings(Sigma *sigma);
void find_gaps(const Sigma *sigma, double *volumes, double *areas, double *x, double *g, double *m,
               Entries *C);
void gap_curvature(const Sigma *sigma, const double *p, double *slopes, Entries *H);
void find_slips(const Sigma *sigma, const double *moved, Entries *rows);
void slip_curvature(const Sigma *sigma, const double *q, Entries *H);

#endif
