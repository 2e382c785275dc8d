// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Contact in space. Python reads this file too (core/compiled.py).

#ifndef HYPERGAP_SPACE_H
#define HYPERGAP_SPACE_H

#define MOST_CORNERS 19 // of a quadrilateral, convex or not, that is cut four times
#define MOST_STACKED 8  // sheets of Γ0 one behind the other, opposite a part of a facet of Γ1

// A side where it is. Facets are polynomials of the reference coordinates from the middle.
typedef struct {
  int num_facets;
  int num_corners;         // of a facet
  const int *vertices;     // around each facet, (num_facets, num_corners)
  const double *x;         // of the vertices, (num_vertices, 3)
  double middle[2];        // of the reference facet
  int num_terms;           // of the polynomials
  const int *powers;       // of both coordinates, (num_terms, 2)
  const double *origins;   // places from which these are counted, (num_facets, 3)
  const double *factors;   // of the terms, (num_facets, num_terms, 3)
  int num_dofs;            // of displacements of a facet
  const double *functions; // factors of the terms in their functions, (num_terms, num_dofs)
} Facets;

// Rays from points of Γ1 along its facets' normals to Γ0 (contact_geometry/heights.py).
typedef struct {
  int num, num_dofs[2];
  double *xi;           // where they meet Γ0, (num, 2)
  double *q;            // what gaps are functions of, (num, 7, 3)
  double *bends;        // second derivatives of Γ0 there, (num, 3, 3); NULL for straight triangles
  double *functions;    // of the dofs, with slopes, Γ1's behind Γ0's, (num, 3, num_dofs0 + num_dofs1)
  const double *middle; // slopes of Γ1's functions in the middle, (2, num_dofs1)
} Rays;

// Pieces of Γ1 opposite Γ0 (contact_geometry/opposite.py). num counts those without room, too.
typedef struct {
  int max, num;
  int *facets[2];
  int *part;  // of Γ1's facet, which has one for each vertex
  int *count; // of corners
  int *edge;  // of the part, then of Γ0's facet, that each edge is on, (max, MOST_CORNERS)
  double *y;  // corners in the plane across the normal, of which the last one is repeated
  double *X;  // on the reference facet, (max, MOST_CORNERS, 2) both
} Pieces;

// Which facets of one surface meet each other (contact_geometry/opposite.py).
typedef struct {
  const int *turn;     // their order: facets of Γ1 meet those of Γ0 that come before them
  const int *first;    // of those around each of Γ1 that don't meet it, (num_facets + 1)
  const int *near;
  const double *walls; // overlap beyond which a sheet is the other side of a facet's own body
} Own;

// Parts of Γ1's facets, one for each vertex, that see Γ0 in part (contact_geometry/sheets.py).
typedef struct {
  const Facets *sides;
  const int *dofs[2];           // of facets, Γ1's behind Γ0's, (num_facets, num_dofs)
  const double *corners;        // of Γ0's reference facet, around it, (num_corners, 2)
  const double *planes;         // as for find_pieces
  const double *parts;          // likewise
  int num;                      // of Γ1's facets
  const int *facets;            // (num)
  const int *first;             // of each one's sheets, (num + 1)
  const int *sheets;            // facets of Γ0
  const int *outline;           // 1 for edges of Γ0's facets beyond which there is none
  int num_points;               // of the rule on polygons
  const double *points;         // these and what makes weights as for polygon_rule
  int num_terms;
  const int *powers;
  const double *inverse;
  int num_inner;
  const double *inner;
  double cosines[2], inside[2], nearest[2], slack, sliver, least, last;
  int num_triangles;            // of Γ0, for depths
  const double *triangles;      // their corners, (num_triangles, 3, 3)
  const int *order;             // them along a curve that fills space
  int triangles_a_facet;
  const double *triangle_at;    // corners on the reference facet, (triangles_a_facet, 3, 2)
  const Own *own;               // NULL: two surfaces
} Parts;

// Entries of a matrix. num counts those without room, too.
typedef struct {
  int max, num;
  int *rows, *columns;
  double *values;
} Triplets;

int find_pieces(const Facets *sides, const int *order, const double *normals, const double *planes,
                const double *reach, const double *parts, double leans, double sliver, double last,
                Pieces *pieces);
int find_depths(int num_triangles, const double *x, const int *order, int triangles_a_facet,
                const Own *own, int num, const double *points, const int *facets, double *depths,
                int *nearest, double *shares);
void cast_columns(const Facets *sides, const double *tangents, int steps, double last,
                  const int *f0, const int *f1, const double *X, Rays *rays);
void polygon_rule(int num, int num_corners, const double *X, int num_points, const double *points,
                  double least, int num_terms, const int *powers, const double *inverse,
                  int num_inner, const double *inner, double *at, double *weights);
void column_heights(const Rays *rays, double *heights, double *areas, double *by_q);
void column_edges(const Rays *rays, const double *normal, double *motion, double *slopes);
void sum_by_dofs(const Rays *rays, const int *block, const double *factor, const double *by_q,
                 double *blocks);
void column_curvatures(const Rays *rays, const int *block, const double *factor, double *blocks);
void add_products(int num, int n, const int *block, const double *a, const double *b,
                  double *blocks);
void complete(int num, int n, double *blocks);
void column_slips(const Rays *rays, const int *block, const double *e, const double *moves,
                  double *by_q);
void slip_curvatures(const Rays *rays, const int *block, const double *traction, double *blocks);
int find_parts(const Parts *parts, double *g, double *covered, double *areas, Triplets *C,
               Triplets *by_covered);
int part_curvature(const Parts *parts, const double *p, const double *by_covered, Triplets *H);
int part_slips(const Parts *parts, const double *moved, int across, Triplets *T);
int part_slip_curvature(const Parts *parts, const double *q, Triplets *H);
int merge_blocks(int num_rows, int num_columns, int num, int a, const int *rows, int b,
                 const int *columns, int size, double *values, int *first);

#endif
