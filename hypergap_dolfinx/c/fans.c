// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Volumes and slips of cells in the plane (contact_geometry/fans.py), and their derivatives by dofs.
//
// A cell lies between a piece of an edge, x(s) from s₁ to s₂, and an apex q(r) on the other side.
// Its variables are the dofs of the base, those of the apex, both by components, and s₁, s₂, r.

#include "fans.h"

#include <math.h>
#include <string.h>

#define NEWTON 8 // steps to where a ray meets a curved edge: round-off after 3 or 4
#define LAST_STEP 1e-15

// a × b
static double wedge(const double *a, const double *b)
{
  return a[0] * b[1] - a[1] * b[0];
}

// to_i += factor eᵢ × w
static void add_turned(double factor, const double *w, double *to)
{
  to[0] += factor * w[1];
  to[1] -= factor * w[0];
}

// Lagrange's functions of n nodes on an edge, and two derivatives, (3, stride).
static void lagrange(int n, const double *at, double s, int stride, double *N)
{
  for (int a = 0; a < n; ++a)
  {
    double p = 1, d = 0, dd = 0;
    for (int b = 0; b < n; ++b)
    {
      if (b == a)
        continue;
      double slope = 1 / (at[a] - at[b]), factor = (s - at[b]) * slope;
      dd = dd * factor + 2 * d * slope;
      d = d * factor + p * slope;
      p *= factor;
    }
    N[a] = p, N[stride + a] = d, N[2 * stride + a] = dd;
  }
}

static Jet jet_at(const Side *side, int edge, double s, const double *origin)
{
  Jet jet = {.x = {{0}}};
  double N[3][MOST_DOFS];
  const double *nodes = side->nodes + 2 * edge * side->num_nodes;
  lagrange(side->num_nodes, side->node_at, s, MOST_DOFS, N[0]);
  lagrange(side->num_dofs, side->dof_at, s, MOST_DOFS, jet.N[0]);
  for (int k = 0; k < 3; ++k)
    for (int a = 0; a < side->num_nodes; ++a)
      for (int i = 0; i < 2; ++i)
        jet.x[k][i] += N[k][a] * (nodes[2 * a + i] - origin[i]);
  return jet;
}

static double parameter(const Sigma *sigma, int number)
{
  if (number < FIXED)
    return positions[number];
  const Crossing *crossing = sigma->crossings + number - FIXED;
  return crossing->s[crossing->unknown];
}

Shape shape_of(const Sigma *sigma, const Cell *cell)
{
  const Side *base = sigma->sides + cell->side, *apex = sigma->sides + 1 - cell->side;
  Shape c = {.base = base,
             .edge = cell->base,
             .num_base = base->num_dofs,
             .num_apex = apex->num_dofs,
             .num = 2 * (base->num_dofs + apex->num_dofs) + 3};
  memcpy(c.origin, base->nodes + 2 * cell->base * base->num_nodes, sizeof(c.origin));
  for (int k = 0; k < 3; ++k)
    c.s[k] = parameter(sigma, cell->parameters[k]);
  for (int k = 0; k < 2; ++k)
    c.ends[k] = jet_at(base, cell->base, c.s[k], c.origin);
  c.apex = jet_at(apex, cell->apex, c.s[2], c.origin);
  for (int i = 0; i < 2; ++i)
  {
    c.chord[i] = c.ends[1].x[0][i] - c.ends[0].x[0][i];
    for (int e = 0; e < 2; ++e)
      c.reach[e][i] = c.apex.x[0][i] - c.ends[e].x[0][i];
  }
  return c;
}

// A point p of the rule on the base, half its weight, and the way from there to the apex.
static Jet point_of(const Shape *c, int p, double *weight, double *reach)
{
  double width = c->s[1] - c->s[0];
  Jet x = jet_at(c->base, c->edge, c->s[0] + width * c->base->points[p], c->origin);
  *weight = 0.5 * width * c->base->weights[p];
  for (int i = 0; i < 2; ++i)
    reach[i] = c->apex.x[0][i] - x.x[0][i];
  return x;
}

// ½ ∫ (q − x) × x' ds, and its derivatives by the variables.
double volume(const Shape *c, double *first)
{
  int to_apex = 2 * c->num_base, to_s = c->num - 3;
  double value = 0, weight, reach[2];
  memset(first, 0, c->num * sizeof(double));
  for (int p = 0; p < c->base->num_points; ++p)
  {
    Jet x = point_of(c, p, &weight, reach);
    value += weight * wedge(reach, x.x[1]);
    for (int a = 0; a < c->num_base; ++a)
    {
      add_turned(-weight * x.N[0][a], x.x[1], first + 2 * a);
      add_turned(-weight * x.N[1][a], reach, first + 2 * a);
    }
  }
  for (int b = 0; b < c->num_apex; ++b)
    add_turned(0.5 * c->apex.N[0][b], c->chord, first + to_apex + 2 * b);
  for (int e = 0; e < 2; ++e)
    first[to_s + e] = (e ? 0.5 : -0.5) * wedge(c->reach[e], c->ends[e].x[1]);
  first[to_s + 2] = 0.5 * wedge(c->apex.x[1], c->chord);
  return value;
}

// Second derivatives of the volume.
void volume_hessian(const Shape *c, int n, double H[n][n])
{
  int to_apex = 2 * c->num_base, s = n - 3, r = n - 1;
  double weight, reach[2];
  const double *dq = c->apex.x[1];
  memset(H, 0, n * sizeof(H[0]));
  // One of each pair of entries, and half of those that are pairs by themselves
  for (int p = 0; p < c->base->num_points; ++p)
  {
    Jet x = point_of(c, p, &weight, reach);
    for (int a = 0; a < c->num_base; ++a)
      for (int b = 0; b < c->num_base; ++b)
      {
        H[2 * a][2 * b + 1] -= weight * x.N[0][a] * x.N[1][b];
        H[2 * a + 1][2 * b] += weight * x.N[0][a] * x.N[1][b];
      }
  }
  for (int a = 0; a < c->num_base; ++a)
  {
    double half = 0.5 * (c->ends[1].N[0][a] - c->ends[0].N[0][a]);
    add_turned(-half, dq, H[r] + 2 * a);
    for (int b = 0; b < c->num_apex; ++b)
    {
      H[to_apex + 2 * b][2 * a + 1] += half * c->apex.N[0][b];
      H[to_apex + 2 * b + 1][2 * a] -= half * c->apex.N[0][b];
    }
  }
  for (int b = 0; b < c->num_apex; ++b)
    add_turned(0.5 * c->apex.N[1][b], c->chord, H[r] + to_apex + 2 * b);
  for (int e = 0; e < 2; ++e)
  {
    const Jet *end = c->ends + e;
    double half = e ? 0.5 : -0.5;
    for (int a = 0; a < c->num_base; ++a)
    {
      add_turned(-half * end->N[0][a], end->x[1], H[s + e] + 2 * a);
      add_turned(-half * end->N[1][a], c->reach[e], H[s + e] + 2 * a);
    }
    for (int b = 0; b < c->num_apex; ++b)
      add_turned(half * c->apex.N[0][b], end->x[1], H[s + e] + to_apex + 2 * b);
    H[r][s + e] = half * wedge(dq, end->x[1]);
    H[s + e][s + e] = 0.5 * half * wedge(c->reach[e], end->x[2]);
  }
  H[r][r] = 0.25 * wedge(c->apex.x[2], c->chord);
  for (int v = 0; v < n; ++v)
    for (int w = 0; w <= v; ++w)
      H[v][w] = H[w][v] = H[v][w] + H[w][v];
}

// What a cell makes of motions Δu of its dofs,
//
//   ½ ∫ x' · (Δu(q) − Δu(s) − τ Δu'(s)) ds,   τ = (q − x) · x' / x' · x',
//
// T by the dofs, and S = ∂T by the variables, if S isn't NULL.
void slip(const Shape *c, int n, double *T, double (*S)[n])
{
  int to_apex = 2 * c->num_base, to_s = n - 3;
  double along[2] = {0}, along_by[n][2], weight, d[2];
  const double *M = c->apex.N[0];
  memset(T, 0, n * sizeof(double));
  if (S)
    memset(S, 0, n * sizeof(S[0]));
  memset(along_by, 0, sizeof(along_by));
  for (int p = 0; p < c->base->num_points; ++p)
  {
    Jet x = point_of(c, p, &weight, d);
    const double *t = x.x[1], at = c->base->points[p];
    double square = t[0] * t[0] + t[1] * t[1], tau = (d[0] * t[0] + d[1] * t[1]) / square;
    for (int v = 0; S && v < n; ++v)
    {
      // How d, t, the point and the weight move
      double dd[2] = {0}, dt[2] = {0}, ds = 0, by_weight = 0;
      if (v < to_apex)
        dd[v % 2] = -x.N[0][v / 2], dt[v % 2] = x.N[1][v / 2];
      else if (v < to_s)
        dd[v % 2] = M[(v - to_apex) / 2];
      else if (v == n - 1)
        memcpy(dd, c->apex.x[1], sizeof(dd));
      else
      {
        int e = v - to_s;
        ds = e ? at : 1 - at, by_weight = (e ? 0.5 : -0.5) * c->base->weights[p];
        for (int i = 0; i < 2; ++i)
          dd[i] = -t[i] * ds, dt[i] = x.x[2][i] * ds;
      }
      double by_tau = dd[0] * t[0] + dd[1] * t[1];
      for (int i = 0; i < 2; ++i)
        by_tau += (d[i] - 2 * tau * t[i]) * dt[i];
      by_tau /= square;
      for (int i = 0; i < 2; ++i)
      {
        double by = by_weight * t[i] + weight * dt[i];
        along_by[v][i] += by;
        for (int a = 0; a < c->num_base; ++a)
          S[2 * a + i][v] -= by * (x.N[0][a] + tau * x.N[1][a])
                             + weight * t[i]
                                   * (ds * (x.N[1][a] + tau * x.N[2][a]) + by_tau * x.N[1][a]);
      }
    }
    for (int i = 0; i < 2; ++i)
    {
      along[i] += weight * t[i];
      for (int a = 0; a < c->num_base; ++a)
        T[2 * a + i] -= weight * t[i] * (x.N[0][a] + tau * x.N[1][a]);
    }
  }
  for (int b = 0; b < c->num_apex; ++b)
    for (int i = 0; i < 2; ++i)
    {
      int u = to_apex + 2 * b + i;
      T[u] = M[b] * along[i];
      for (int v = 0; S && v < n; ++v)
        S[u][v] = M[b] * along_by[v][i] + (v == n - 1 ? c->apex.N[1][b] * along[i] : 0);
    }
}

// Where a ray crosses: Φ = (x₀(s₀) − x₁(s₁)) · c = 0, with the chord c of Γ1's edge.
typedef struct {
  int side;     // of what moves
  Jet on[2];    // on both sides
  double c[2], between[2], phi;
  double moves[2], slope, bend; // ∂(x₀ − x₁)/∂s, ∂Φ/∂s, ∂²Φ/∂s²
} Meeting;

static Meeting meeting_at(const Sigma *sigma, const Crossing *crossing)
{
  int k = crossing->unknown, sign = k ? -1 : 1;
  Meeting m = {.side = k};
  const double *origin = node(sigma->sides + 1, crossing->edges[1], 0);
  chord(sigma->sides + 1, crossing->edges[1], m.c);
  for (int side = 0; side < 2; ++side)
    m.on[side] = jet_at(sigma->sides + side, crossing->edges[side], crossing->s[side], origin);
  for (int i = 0; i < 2; ++i)
  {
    m.between[i] = m.on[0].x[0][i] - m.on[1].x[0][i];
    m.moves[i] = sign * m.on[k].x[1][i];
    m.phi += m.between[i] * m.c[i];
    m.slope += m.moves[i] * m.c[i];
    m.bend += sign * m.on[k].x[2][i] * m.c[i];
  }
  return m;
}

// Of a dof of Γ1 in c.
static double in_chord(int dof)
{
  return dof == 0 ? -1 : dof == 1;
}

// Derivatives of Φ by Γ0's dofs and Γ1's at the parameters (k = 0), or those of ∂Φ/∂s (k = 1).
static void phi_by_dofs(const Sigma *sigma, const Meeting *m, int k, double *by)
{
  int num0 = sigma->sides[0].num_dofs, num1 = sigma->sides[1].num_dofs;
  const double *between = k ? m->moves : m->between;
  for (int i = 0; i < 2; ++i)
  {
    for (int a = 0; a < num0; ++a)
      by[2 * a + i] = k && m->side ? 0 : m->on[0].N[k][a] * m->c[i];
    for (int b = 0; b < num1; ++b)
      by[2 * (num0 + b) + i]
          = in_chord(b) * between[i] - (k && !m->side ? 0 : m->on[1].N[k][b] * m->c[i]);
  }
}

// Find where rays cross edges, and how they move with the dofs, ∂s/∂u = −∂Φ/∂u / ∂Φ/∂s.
void find_crossings(Sigma *sigma)
{
  const Side *sides = sigma->sides;
  int n = 2 * (sides[0].num_dofs + sides[1].num_dofs);
  int straight = sides[0].num_nodes == 2 && sides[1].num_nodes == 2;
  for (int k = 0; k < sigma->num_crossings; ++k)
  {
    Crossing *crossing = sigma->crossings + k;
    double step = 1, *motions = sigma->motions + n * k;
    for (int it = 0; it < (straight ? 2 : NEWTON) && fabs(step) >= LAST_STEP; ++it)
    {
      Meeting m = meeting_at(sigma, crossing);
      step = m.phi / m.slope;
      crossing->s[crossing->unknown] -= step;
    }
    Meeting m = meeting_at(sigma, crossing);
    phi_by_dofs(sigma, &m, 0, motions);
    for (int v = 0; v < n; ++v)
      motions[v] /= -m.slope;
  }
}

// Second derivatives of a crossing by the dofs, with those of s (t = ∂s/∂u),
//
//   −(Φ_uu + Φ_us tᵀ + t Φ_usᵀ + Φ_ss t tᵀ) / Φ_s.
void crossing_hessian(const Sigma *sigma, int k, int n, double H[n][n])
{
  int num0 = sigma->sides[0].num_dofs, num1 = sigma->sides[1].num_dofs;
  const double *t = sigma->motions + n * k;
  Meeting m = meeting_at(sigma, sigma->crossings + k);
  double mixed[n];
  phi_by_dofs(sigma, &m, 1, mixed);
  for (int v = 0; v < n; ++v)
    for (int w = 0; w < n; ++w)
      H[v][w] = mixed[v] * t[w] + t[v] * mixed[w] + m.bend * t[v] * t[w];
  for (int b = 0; b < num1; ++b)
    for (int i = 0; i < 2; ++i)
    {
      int v = 2 * (num0 + b) + i;
      for (int a = 0; a < num0; ++a)
      {
        H[2 * a + i][v] += m.on[0].N[0][a] * in_chord(b);
        H[v][2 * a + i] += m.on[0].N[0][a] * in_chord(b);
      }
      for (int a = 0; a < num1; ++a)
        H[v][2 * (num0 + a) + i]
            -= m.on[1].N[0][a] * in_chord(b) + m.on[1].N[0][b] * in_chord(a);
    }
  for (int v = 0; v < n; ++v)
    for (int w = 0; w < n; ++w)
      H[v][w] /= -m.slope;
}
