// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// The advancing front: its triangles, its events and its moves (front.c).

#ifndef HYPERGAP_FRONT_H
#define HYPERGAP_FRONT_H

#include "predicates.h"

typedef struct {
  int v[3];      // vertices, counterclockwise seen from the end
  int behind[3]; // triangle behind the edge from v[k] to v[k + 1], −1 at the boundary
  int head;      // first of the end's vertices that wait here, −1 if none
  int stamp;     // how often it has changed; −1 if it is no part of the front any more
} Triangle;

typedef struct {
  double t;
  int triangle, move; // move: an edge 0, 1, 2, or −1 − vertex
  int stamp, behind, stamp_behind; // of the triangle, and of the one behind the edge
} Event;

typedef struct {
  int *offset, *to, *opposite, *triangle; // directed edges by the vertex where they start
} Edges;

typedef struct {
  Points points;
  Triangle *triangle;
  int num_triangles, max_triangles;
  int *spare, num_spare; // triangles to use again
  int *home, *next;      // of each vertex: where it waits (−1: nowhere), and who waits next
  Edges end;             // edges of the surface where the front ends
  Event *heap, *sorted; // those to come, and of these the ones known at first
  int num_events, max_events, num_sorted, next_sorted;
  int *cells, num_cells, max_cells;
  int failed; // no memory
} Front;

int opposite(const Edges *edges, int a, int b);
int is_final(const Front *f, int t);
void sort_events(Front *f);
void forget_events(Front *f);
int has_events(const Front *f);
Event pop(Front *f);
int is_stale(const Front *f, const Event *e);
void set(Front *f, int t, int a, int b, int c);
void put(Front *f, int w, int t);
int walk(const Front *f, int t, int w, int steps);
int is_inside(const Front *f, int t, int w);
void offer_points(Front *f, int triangle);
void offer_edge(Front *f, int t, int k);
void carry_out(Front *f, const Event *e);

#endif
