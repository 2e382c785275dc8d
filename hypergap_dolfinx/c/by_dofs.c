// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Weighted gaps and slips in the plane (contact_geometry/plane.py), and their derivatives by both sides' dofs.

#include <math.h>
#include <string.h>

#include "fans.h"
#include "plane.h"

// The dofs with which a cell's variables move: those of the base and of the apex, which are variables
// themselves, then others on which s₁, s₂ and r hang.
typedef struct {
  int num;
  int dofs[8 * MOST_DOFS];
  double motions[3][16 * MOST_DOFS]; // ∂(s₁, s₂, r)/∂u, by components
} Local;

static void add(Entries *entries, int row, int column, double value)
{
  int k = entries->first[row];
  while (k >= 0 && entries->columns[k] != column)
    k = entries->next[k];
  if (k >= 0)
  {
    entries->values[k] += value;
    return;
  }
  k = entries->num++;
  if (k >= entries->max)
    return;
  entries->rows[k] = row, entries->columns[k] = column, entries->values[k] = value;
  entries->next[k] = entries->first[row], entries->first[row] = k;
}

// Number of a dof among a cell's; it gets one if it has none.
static int number_of(Local *local, int dof)
{
  int k = 0;
  while (k < local->num && local->dofs[k] != dof)
    ++k;
  if (k == local->num)
    local->dofs[local->num++] = dof;
  return k;
}

// Let a parameter move with the dofs of an edge.
static void add_motions(Local *local, const Side *side, int edge, const double *by, double *motions)
{
  for (int a = 0; a < side->num_dofs; ++a)
  {
    int k = number_of(local, side->dofs[edge * side->num_dofs + a]);
    for (int i = 0; i < 2; ++i)
      motions[2 * k + i] += by[2 * a + i];
  }
}

// A cell where it is, and its dofs.
static Shape gather_cell(const Sigma *sigma, const Cell *cell, Local *local)
{
  const Side *sides = sigma->sides, *apex = sides + 1 - cell->side;
  Shape c = shape_of(sigma, cell);
  int num = c.num - 3;
  local->num = 0;
  for (int a = 0; a < c.num_base; ++a)
    number_of(local, c.base->dofs[cell->base * c.num_base + a]);
  for (int b = 0; b < c.num_apex; ++b)
    number_of(local, apex->dofs[cell->apex * c.num_apex + b]);
  for (int k = 0; k < 3; ++k)
  {
    int number = cell->parameters[k] - FIXED;
    memset(local->motions[k], 0, 4 * num * sizeof(double));
    if (number < 0)
      continue;
    const int *edges = sigma->crossings[number].edges;
    const double *by = sigma->motions + num * number;
    add_motions(local, sides, edges[0], by, local->motions[k]);
    add_motions(local, sides + 1, edges[1], by + 2 * sides[0].num_dofs, local->motions[k]);
  }
  return c;
}

// Number of a dof's component.
static int component_of(const Local *local, int k)
{
  return 2 * local->dofs[k / 2] + k % 2;
}

// A derivative by component k of the dofs, of those by n variables.
static double total(const Local *local, int n, const double *first, int k)
{
  double value = k < n - 3 ? first[k] : 0;
  for (int i = 0; i < 3; ++i)
    value += first[n - 3 + i] * local->motions[i][k];
  return value;
}

// Add derivatives by a cell's variables to the rows of both its vertices, one half each.
static void add_row(const Cell *cell, int n, const double *first, const Local *local, Entries *rows)
{
  for (int k = 0; k < 2 * local->num; ++k)
    for (int half = 0; half < 2; ++half)
      add(rows, cell->vertices[half], component_of(local, k), 0.5 * total(local, n, first, k));
}

// Add a matrix by a cell's variables, times a factor.
static void add_block(int n, double H[n][n], double factor, const Local *local, Entries *entries)
{
  double column[n];
  for (int k = 0; k < 2 * local->num; ++k)
  {
    for (int v = 0; v < n; ++v)
      column[v] = factor * total(local, n, H[v], k);
    for (int l = 0; l < 2 * local->num; ++l)
      add(entries, component_of(local, l), component_of(local, k), total(local, n, column, l));
  }
}

// Weighted gaps.
//
// volumes  of cells, (num_cells)
// areas    (num_cells)
// x        both ends of bases and apexes, (num_cells, 3, 2)
// g, m     sums of volumes and areas, (num_vertices₁)
// C        ∂g/∂u
void find_gaps(const Sigma *sigma, double *volumes, double *areas, double *x, double *g, double *m,
               Entries *C)
{
  memset(g, 0, sigma->sides[1].num_vertices * sizeof(double));
  memset(m, 0, sigma->sides[1].num_vertices * sizeof(double));
  Local local;
  for (int k = 0; k < sigma->num_cells; ++k)
  {
    const Cell *cell = sigma->cells + k;
    Shape c = gather_cell(sigma, cell, &local);
    double first[c.num];
    volumes[k] = volume(&c, first);
    areas[k] = 0.5 * sqrt(c.chord[0] * c.chord[0] + c.chord[1] * c.chord[1]);
    for (int i = 0; i < 6; ++i)
      x[6 * k + i] = c.origin[i % 2] + (i < 4 ? c.ends + i / 2 : &c.apex)->x[0][i % 2];
    for (int half = 0; half < 2; ++half)
    {
      g[cell->vertices[half]] += 0.5 * volumes[k];
      m[cell->vertices[half]] += 0.5 * areas[k];
    }
    add_row(cell, c.num, first, &local, C);
  }
}

// The mean of values at a cell's vertices.
static double mean(const Cell *cell, const double *values)
{
  return 0.5 * (values[cell->vertices[0]] + values[cell->vertices[1]]);
}

// Σ p ∂²g/∂u².
//
// slopes   zeros, (num_crossings): what Σ p g changes by where they move
void gap_curvature(const Sigma *sigma, const double *p, double *slopes, Entries *H)
{
  const Side *sides = sigma->sides;
  int num0 = 2 * sides[0].num_dofs, n = num0 + 2 * sides[1].num_dofs;
  Local local;
  for (int k = 0; k < sigma->num_cells; ++k)
  {
    const Cell *cell = sigma->cells + k;
    double pressure = mean(cell, p);
    if (pressure == 0)
      continue;
    Shape c = gather_cell(sigma, cell, &local);
    double first[c.num], second[c.num][c.num];
    volume(&c, first);
    volume_hessian(&c, c.num, second);
    add_block(c.num, second, pressure, &local, H);
    for (int i = 0; i < 3; ++i)
      if (cell->parameters[i] >= FIXED)
        slopes[cell->parameters[i] - FIXED] += pressure * first[c.num - 3 + i];
  }
  for (int k = 0; k < sigma->num_crossings; ++k)
  {
    if (slopes[k] == 0)
      continue;
    const int *edges = sigma->crossings[k].edges;
    double second[n][n];
    int dofs[n];
    crossing_hessian(sigma, k, n, second);
    for (int v = 0; v < n; ++v)
    {
      int side = v >= num0, own = v - side * num0;
      dofs[v] = 2 * sides[side].dofs[edges[side] * sides[side].num_dofs + own / 2] + own % 2;
    }
    for (int v = 0; v < n; ++v)
      for (int w = 0; w < n; ++w)
        add(H, dofs[v], dofs[w], slopes[k] * second[v][w]);
  }
}

// Weighted slips s = T Δu: T; if they are given Δu, by dofs, T + ∂T/∂u Δu instead.
void find_slips(const Sigma *sigma, const double *moved, Entries *rows)
{
  Local local;
  for (int k = 0; k < sigma->num_cells; ++k)
  {
    const Cell *cell = sigma->cells + k;
    Shape c = gather_cell(sigma, cell, &local);
    int n = c.num;
    double T[n], S[n][n];
    slip(&c, n, T, moved ? S : NULL);
    for (int u = 0; moved && u < n - 3; ++u)
      for (int v = 0; v < n; ++v)
        T[v] += S[u][v] * moved[component_of(&local, u)];
    add_row(cell, n, T, &local, rows);
  }
}

// Σ q ∂T/∂u; it isn't symmetric.
void slip_curvature(const Sigma *sigma, const double *q, Entries *H)
{
  Local local;
  for (int k = 0; k < sigma->num_cells; ++k)
  {
    const Cell *cell = sigma->cells + k;
    double traction = mean(cell, q);
    if (traction == 0)
      continue;
    Shape c = gather_cell(sigma, cell, &local);
    double T[c.num], S[c.num][c.num];
    slip(&c, c.num, T, S);
    add_block(c.num, S, traction, &local, H);
  }
}
