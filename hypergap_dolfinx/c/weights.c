// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// Weights of vertices, with which a triangulation that isn't Delaunay is regular.

#include <stdlib.h>
#include <string.h>

#include "gap_mesh.h"
#include "predicates.h"

#define STEPS_OF_QUADRATICS 5
#define RIDGE 1e-3      // of their coefficients' squares, beside those of what edges lack
#define SOME_EDGES 4000 // that quadratics are sought with
#define SLIVER 0.02     // what quadratics must change of an edge's height, over what they may leave
#define FEW 0.01        // share of irregular edges below which quadratics aren't sought
#define MARGIN 1e-3     // by how much (in the longest edge to the fourth) weights make edges regular

// One constraint on the weights: the sum of c[k] times them is at least bound.
typedef struct {
  double c[4], bound, tolerance;
} Constraint;

// The edge from q to r must be regular, H(q,r,p,s) ≥ MARGIN m⁴.
static Constraint inner_edge(const Vertex *vertex, const int *edge)
{
  const Vertex *v[4];
  double n[3], e[3][3], longest = 0;
  Constraint g = {0};
  for (int k = 0; k < 4; ++k)
    v[k] = vertex + edge[k];
  unit_sum(v[0]->n, v[1]->n, v[2]->n, v[3]->n, n);
  for (int k = 0; k < 3; ++k)
  {
    minus(v[k + 1]->y, v[0]->y, e[k]);
    longest = larger(longest, dot(e[k], e[k]));
  }
  for (int k = 0; k < 3; ++k)
  {
    g.c[k + 1] = triple(e[(k + 1) % 3], e[(k + 2) % 3], n);
    g.c[0] -= g.c[k + 1];
  }
  double height = H(v, n), margin = MARGIN * longest * longest;
  g.bound = margin - height;
  g.tolerance = 0.5 * margin;
  return g;
}

// Two edges of the boundary, from a to b and on to c, must be regular for the wall:
// (h_c − h_b) / |c − b| − (h_b − h_a) / |b − a| ≥ MARGIN m, with h = s² + w along them.
static Constraint rim(const Vertex *vertex, const int *v)
{
  double e[3], g[3];
  Constraint constraint = {0};
  minus(vertex[v[1]].y, vertex[v[0]].y, e);
  minus(vertex[v[2]].y, vertex[v[1]].y, g);
  double a = sqrt(dot(e, e)), b = sqrt(dot(g, g)), margin = MARGIN * (a + b);
  constraint.c[0] = 1 / a;
  constraint.c[1] = -1 / a - 1 / b;
  constraint.c[2] = 1 / b;
  constraint.bound = margin - (a + b);
  constraint.tolerance = 0.5 * margin;
  return constraint;
}

static int num_terms(const int *edge)
{
  return edge[3] < 0 ? 3 : 4;
}

// The six products of two coordinates
static void products(const double *y, double *q)
{
  q[0] = y[0] * y[0], q[1] = y[1] * y[1], q[2] = y[2] * y[2];
  q[3] = y[0] * y[1], q[4] = y[1] * y[2], q[5] = y[2] * y[0];
}

// A constraint on quadratic weights: the sum of c[j] times their coefficients, a unit vector, is at
// least bound.
typedef struct {
  double c[6], bound, tolerance;
} Quadratic;

// Solve A x = b with a symmetric A, of which the upper part is given; both are lost.
static void solve(double A[6][6], double *b, double *x)
{
  for (int j = 0; j < 6; ++j)
    for (int k = j + 1; k < 6; ++k)
    {
      double factor = A[j][k] / A[j][j];
      for (int l = k; l < 6; ++l)
        A[k][l] -= factor * A[j][l];
      b[k] -= factor * b[j];
    }
  for (int j = 5; j >= 0; --j)
  {
    x[j] = b[j];
    for (int k = j + 1; k < 6; ++k)
      x[j] -= A[j][k] * x[k];
    x[j] /= A[j][j];
  }
}

// One of Newton's steps to the coefficients Q with the least sum of squares of what constraints lack.
// Returns how many lack more than their tolerance.
static int least_squares_step(int num, const Quadratic *constraints, double *Q)
{
  double A[6][6] = {{0}}, b[6] = {0}, trace = 0;
  int violated = 0;
  for (int i = 0; i < num; ++i)
  {
    const Quadratic *g = constraints + i;
    double lacks = g->bound;
    for (int j = 0; j < 6; ++j)
      lacks -= g->c[j] * Q[j];
    violated += lacks > g->tolerance;
    if (lacks <= 0)
      continue;
    for (int j = 0; j < 6; ++j)
    {
      for (int k = j; k < 6; ++k)
        A[j][k] += g->c[j] * g->c[k];
      b[j] += g->c[j] * g->bound;
    }
    ++trace;
  }
  for (int j = 0; j < 6; ++j)
    A[j][j] += RIDGE * trace;
  if (trace > 0)
    solve(A, b, Q);
  return violated;
}

// Quadratic weights, if they make at least half of the irregular edges regular, of some in large
// surfaces: where a whole triangulation is sheared, or was made in a projection, that is all it
// takes, and what follows would take long. Returns whether all edges are regular without weights.
static int quadratic_weights(int n, Vertex *vertex, int num, const int *edges,
                             const Constraint *constraints, Quadratic *some)
{
  double Q[6] = {0}, best[6] = {0}, q[6];
  int at_first = 0, least = num + 1, skip = num / SOME_EDGES * 64, num_some = 0;
  for (int i = 0; i < num; i += (i + 1) % 64 ? 1 : 1 + skip) // neighbours of some in each part
  {
    const Constraint *g = constraints + i;
    Quadratic *own = some + num_some;
    double square = 0;
    memset(own, 0, sizeof(Quadratic));
    for (int k = 0; k < num_terms(edges + 4 * i); ++k)
    {
      products(vertex[edges[4 * i + k]].y, q);
      for (int j = 0; j < 6; ++j)
        own->c[j] += g->c[k] * q[j];
    }
    for (int j = 0; j < 6; ++j)
      square += own->c[j] * own->c[j];
    double size = sqrt(square);
    if (!(SLIVER * size > g->tolerance)) // slivers at a cut would need any weights
      continue;
    for (int j = 0; j < 6; ++j)
      own->c[j] /= size;
    own->bound = g->bound / size;
    own->tolerance = g->tolerance / size;
    ++num_some;
  }
  for (int step = 0; step <= STEPS_OF_QUADRATICS; ++step)
  {
    double before[6];
    memcpy(before, Q, sizeof(Q));
    int violated = least_squares_step(num_some, some, Q);
    if (step == 0)
      at_first = violated;
    if (violated < least)
    {
      least = violated;
      memcpy(best, before, sizeof(Q));
    }
    if (!violated || at_first < FEW * num_some)
      break;
  }
  for (int i = 0; i < n && 2 * least <= at_first; ++i)
  {
    products(vertex[i].y, q);
    for (int j = 0; j < 6; ++j)
      vertex[i].w += best[j] * q[j];
  }
  return at_first == 0 && skip == 0;
}

// Constraints at each vertex, in the order of their numbers, and which have yet to be looked at.
typedef struct {
  int *offset, *at;
  char *waits;
} Queue;

static int sort_constraints(Queue *queue, int n, int num, const int *edges)
{
  queue->offset = calloc(n + 2, sizeof(int));
  queue->at = malloc(((size_t)4 * num + 1) * sizeof(int));
  queue->waits = malloc((size_t)num + 1);
  if (!queue->offset || !queue->at || !queue->waits)
    return 0;
  for (int i = 0; i < num; ++i)
    for (int k = 0; k < num_terms(edges + 4 * i); ++k)
      ++queue->offset[edges[4 * i + k] + 2];
  for (int i = 2; i < n + 2; ++i)
    queue->offset[i] += queue->offset[i - 1];
  for (int i = 0; i < num; ++i)
    for (int k = 0; k < num_terms(edges + 4 * i); ++k)
      queue->at[queue->offset[edges[4 * i + k] + 1]++] = i;
  for (int i = 0; i < num; ++i)
    queue->waits[i] = 1;
  return 1;
}

// Let all constraints at a vertex wait.
static void wake(Queue *queue, int vertex)
{
  for (int i = queue->offset[vertex]; i < queue->offset[vertex + 1]; ++i)
    queue->waits[queue->at[i]] = 1;
}

// Weights that make a triangulation locally regular: reflected at one violated constraint after the
// other (Motzkin and Schoenberg), they end where none is. A sweep goes over those whose weights have
// changed since they were found to hold.
//
// vertices    as of front_fill; their weights are set
// num, edges  q, r, p, s of each inner edge; a, b, c, −1 for two edges on the boundary
// sweeps      at most
// visits      of constraints in all sweeps, at most; returned is how many sweeps were needed, −1 if
//             these were too few (weights are then better than none)
int front_weights(int n, double *vertices, int num, const int *edges, int sweeps, double visits)
{
  Vertex *vertex = (Vertex *)vertices;
  Queue queue = {0};
  Constraint *constraints = malloc((num + 1) * sizeof(Constraint));
  Quadratic *some = malloc((num + 1) * sizeof(Quadratic));
  double *w = malloc((n + 1) * sizeof(double)); // side by side
  int sweep = 0, violated = -1;
  if (!constraints || !some || !w || !sort_constraints(&queue, n, num, edges))
    goto finish;
  for (int i = 0; i < n; ++i)
    vertex[i].w = 0;
  for (int i = 0; i < num; ++i)
    constraints[i] = (edges[4 * i + 3] < 0 ? rim : inner_edge)(vertex, edges + 4 * i);
  violated = !quadratic_weights(n, vertex, num, edges, constraints, some);
  for (int i = 0; i < n; ++i)
    w[i] = vertex[i].w;
  for (; violated && sweep <= sweeps && visits > 0; ++sweep)
  {
    violated = 0;
    for (char *at = queue.waits; (at = memchr(at, 1, queue.waits + num - at)); ++at)
    {
      int i = (int)(at - queue.waits);
      *at = 0;
      const Constraint *g = constraints + i;
      const int *v = edges + 4 * i, terms = num_terms(v);
      double value = 0, square = 0;
      --visits;
      for (int k = 0; k < terms; ++k)
        value += g->c[k] * w[v[k]];
      if (g->bound - value <= g->tolerance)
        continue;
      for (int k = 0; k < terms; ++k)
        square += g->c[k] * g->c[k];
      if (!(square > 0))
        continue;
      violated = 1;
      double step = 2 * (g->bound - value) / square;
      for (int k = 0; k < terms; ++k)
      {
        w[v[k]] += step * g->c[k];
        wake(&queue, v[k]);
      }
    }
  }
  for (int i = 0; i < n; ++i)
    vertex[i].w = w[i];
finish:
  free(constraints), free(some), free(w), free(queue.offset), free(queue.at), free(queue.waits);
  return violated ? -1 : sweep;
}
