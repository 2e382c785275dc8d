// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Contact in the plane. Python reads this file too (core/compiled.py).

#ifndef HYPERGAP_PLANE_H
#define HYPERGAP_PLANE_H

#define MOST_DOFS 12  // of an edge
#define MOST_SHEETS 6 // of Γ0 that one ray sees
#define NUM_OWN 5     // edges of one surface that don't meet: an edge and two on either side

// A side where it is: edges with the body on the left, their reference coordinates from 0 to 1.
typedef struct {
  int num_edges, num_vertices;
  const int *vertices;    // of each edge, (num_edges, 2)
  const int *beside;      // edges that end and start at each vertex, or −1, (num_vertices, 2)
  int num_nodes;          // of an edge's geometry, its ends first
  const double *node_at;  // their reference coordinates
  const double *nodes;    // (num_edges, num_nodes, 2)
  int num_dofs;           // of displacements of an edge, its ends first if it isn't a part
  int num_parts;          // of an edge of the mesh: edge e is part e % num_parts of one
  const double *dof_at;   // reference coordinates of its dofs, as seen from each part, (…, num_dofs)
  const int *end_dofs;    // which of them are at the ends of each part, (num_parts, 2)
  const double *turned;   // what of the nodes turns with the chord of the mesh's edge, over that, as
                          // complex numbers, (num_edges, num_nodes, 2); NULL: nothing
  const int *dofs;        // their numbers, Γ1's behind all of Γ0's, (num_edges, num_dofs)
} Side;

// A point of an edge of Γ1 from which a ray goes along the normal of the edge's chord. Its place ξ
// along the chord, from 0 to 1, lies between those of both ends of a piece of the edge.
typedef struct {
  int edge, part;   // of Γ1; that of its start (0), of its end (1), or the middle, shared by both (2)
  int ends[2];      // vertices of Γ0 opposite of the piece's ends, or −1
  double places[2]; // of these ends along the chord
  int fades[2];     // edges of Γ0 whose weights begin or end to fade there, or −1
  double at_fades[2]; // and where on them
  double at, width; // where on the piece, from 0 to 1, and the weight of the quadrature there
  double s;         // reference coordinate
  int foot;         // edge of Γ0 that is nearest; −1 where that needn't be known
  int nodes[2];     // those of the edge between which it is; the same one: there
  double sign;      // −1 if the nearest node is convex, or the body isn't on its side, else 1;
                    // 2 and 3 beyond an end of Γ0, which is the first or the second of the nodes
  int first, num;   // of its sheets
  int is_first;     // whether it is the piece's first point
} Point;

// An edge of Γ0 that a ray meets, and where.
typedef struct {
  int edge;
  double r;         // reference coordinate
  int beside[2];    // edges before and behind it that share their weight with it, or −1
  int goes_on[2];   // of a riser: edges before and behind it that it leads to, or −1
  int dips[2];      // those that turn away most on the way to them, or −1
  int turns_away;   // whether it does itself: then it takes back what is seen behind it
} Sheet;

// Σ where the sides are.
typedef struct {
  Side sides[2];
  const int *goes_on;    // whether Γ0's edges do beyond their ends, at a wall, (num_edges₀, 2)
  double cosines[2];     // between normals: from which on edges face each other, and do so fully
  double nearest[2];     // depth by the nearest edge over that by a sheet, from which on it counts
  double slack;          // length that is added to that depth, over a chord of Γ1
  const int *turn;       // order of Γ0's edges, of which Γ1 is the same surface: Γ1's edges meet those
                         // that come before them, (num_edges₀); NULL: another surface
  const int *own;        // those around each of Γ0's edges that don't meet it, or −1, (…, NUM_OWN)
  const double *depths;  // overlap beyond which a sheet is the other side of Γ1's own body, (…)
  double angle;          // by which bodies of revolution are swept about x = 0; 0 for others
  double shared[2];      // places along chords between which ends share what is there
  int ends_of_rules[2];  // of quadrature, one behind the other: any, and for straight edges that
                         // face each other fully
  const double *rule_at, *rule_weights;
  int max_points, num_points, max_sheets, num_sheets;
  Point *points;
  Sheet *sheets;
} Sigma;

// Entries of a sparse matrix. If there is no room for all, num is at least what they need.
typedef struct {
  int max, num, last; // last: the entry that was added to last
  int *rows, *columns;
  double *values;
  int *next;  // entry of the same row, −1: none
  int *first; // of each row
} Entries;

int cast_rays(Sigma *sigma);
void find_columns(const Sigma *sigma, double *x, double *at, int *shown);
int find_gaps(const Sigma *sigma, double *g, double *covered, double *areas, Entries *C,
              Entries *by_covered, Entries *T);
int find_reaches(const Sigma *sigma, const double *p, const double *least, double *found);
int gap_curvature(const Sigma *sigma, const double *p, const double *by_covered, Entries *H);
int find_slips(const Sigma *sigma, int across, const double *moved, Entries *rows);
int slip_curvature(const Sigma *sigma, const double *q, Entries *H);

#endif
