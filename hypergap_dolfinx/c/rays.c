// Copyright (C) 2026 The hypergap_dolfinx developers
//
// This file is part of hypergap_dolfinx
//
// SPDX-License-Identifier:    LGPL-3.0-or-later

// What the edges of Γ1 see of Γ0 in the plane (contact_geometry/rays.py).
//
// From each point of an edge of Γ1 a line goes along the normal of the edge's chord. It may meet
// several sheets of Γ0, in front or behind; a sheet's weight fades where it turns away and where it
// lies as deep as what is behind the body, and a sheet hides those in front of it by its weight.

#include "rays.h"

#include <stdlib.h>
#include <string.h>

#include "vectors.h"

#define STEPS 60 // to where a ray meets a curved edge: by bisection at most
#define LAST_STEP 1e-15
#define TINY 1e-15 // part of a chord that is round-off
#define NUM_FADES 3 // cosines at which weights begin or end to fade

// The chord of an edge of Γ1.
typedef struct {
  const double *a;
  double c[2], size;
} Frame;

// A part of an edge of Γ0 that runs against a chord of Γ1, and so faces it, or hardly turns away.
typedef struct {
  int edge, turns_away;
  double from, to;  // reference coordinates between which it does
  double low, high; // places there along Γ1's chord
} Facing;

// A place along a chord: that of a vertex of Γ0, or of a point of its edge where its weight begins
// or ends to fade; or −1 each.
typedef struct {
  double xi;
  int vertex, edge;
  double r;
} Break;

// A sheet where a ray meets it.
typedef struct {
  Sheet sheet;
  double height, weight;
} Hit;

typedef struct {
  const Sigma *sigma;
  const Side *below, *above; // Γ0 and Γ1
  Facing *facing;
  Break *breaks;
  int num_facing, num_breaks, edge;
  int lost; // whether a ray saw more sheets than there is room for
  int order[MOST_DOFS]; // of the nodes of Γ0's edges, from start to end
  Frame frame;
} Cast;

// Lagrange's functions of n nodes on an edge, and three derivatives.
static void lagrange(int n, const double *at, double s, double N[4][MOST_DOFS])
{
  if (n == 2)
  {
    double slope = 1 / (at[0] - at[1]);
    N[0][0] = (s - at[1]) * slope, N[0][1] = (at[0] - s) * slope;
    N[1][0] = slope, N[1][1] = -slope;
    N[2][0] = N[2][1] = N[3][0] = N[3][1] = 0;
    return;
  }
  for (int a = 0; a < n; ++a)
  {
    double d[4] = {1, 0, 0, 0};
    for (int b = 0; b < n; ++b)
    {
      if (b == a)
        continue;
      double slope = 1 / (at[a] - at[b]), factor = (s - at[b]) * slope;
      for (int k = 3; k > 0; --k)
        d[k] = d[k] * factor + k * d[k - 1] * slope;
      d[0] *= factor;
    }
    for (int k = 0; k < 4; ++k)
      N[k][a] = d[k];
  }
}

Curve curve_at(const Side *side, int edge, double s, const double *origin)
{
  Curve curve;
  double N[4][MOST_DOFS];
  memset(curve.x, 0, sizeof(curve.x)), memset(curve.across, 0, sizeof(curve.across));
  const double *nodes = node(side, edge, 0);
  lagrange(side->num_nodes, side->node_at, s, N);
  lagrange(side->num_dofs, side->dof_at + edge % side->num_parts * side->num_dofs, s, curve.N);
  for (int k = 0; k < 4; ++k)
    for (int a = 0; a < side->num_nodes; ++a)
      for (int i = 0; i < 2; ++i)
        curve.x[k][i] += N[k][a] * (nodes[2 * a + i] - origin[i]);
  curve.turns = side->turned != NULL;
  for (int k = 0; curve.turns && k < 4; ++k)
    for (int a = 0; a < side->num_nodes; ++a)
    {
      const double *turned = side->turned + 2 * (edge * side->num_nodes + a);
      curve.N[k][0] -= N[k][a] * turned[0], curve.N[k][1] += N[k][a] * turned[0];
      curve.across[k] += N[k][a] * turned[1];
    }
  return curve;
}

const double *position(const Side *side, int vertex)
{
  int end, edge = edge_at(side, vertex, &end);
  return node(side, edge, end);
}

static Frame frame_of(const Side *side, int edge)
{
  Frame frame = {.a = node(side, edge, 0)};
  frame.size = chord(side, edge, frame.c);
  return frame;
}

// Place of a point along a chord, and its height above it, outside of the body.
static double along(const Frame *frame, const double *x)
{
  const double *c = frame->c, *a = frame->a;
  return ((x[0] - a[0]) * c[0] + (x[1] - a[1]) * c[1]) / (frame->size * frame->size);
}

static double above(const Frame *frame, const double *x)
{
  const double *c = frame->c, *a = frame->a;
  return ((x[0] - a[0]) * c[1] - (x[1] - a[1]) * c[0]) / frame->size;
}

// Place along a chord of a point of an edge, and its derivative.
static double place(const Frame *frame, const Side *side, int edge, double r, double *slope)
{
  const double *c = frame->c;
  if (side->num_nodes == 2)
  {
    double own[2];
    chord(side, edge, own);
    *slope = (own[0] * c[0] + own[1] * c[1]) / (frame->size * frame->size);
    return along(frame, node(side, edge, 0)) + r * *slope;
  }
  Curve x = curve_at(side, edge, r, frame->a);
  *slope = (x.x[1][0] * c[0] + x.x[1][1] * c[1]) / (frame->size * frame->size);
  return (x.x[0][0] * c[0] + x.x[0][1] * c[1]) / (frame->size * frame->size);
}

// Reference coordinate between two where an edge, which goes one way there, has a place.
static double meet(const Frame *frame, const Side *side, int edge, double from, double to, double xi)
{
  double slope, lo = from, hi = to, first = place(frame, side, edge, lo, &slope);
  if (side->num_nodes == 2)
    return smaller(larger(from + (xi - first) / slope, from), to);
  double last = place(frame, side, edge, hi, &slope), r;
  int falls = last < first;
  r = lo + (hi - lo) * smaller(larger((xi - first) / (last - first), 0), 1);
  for (int it = 0; it < STEPS; ++it)
  {
    double error = place(frame, side, edge, r, &slope) - xi, next = r - error / slope;
    if ((error > 0) == falls)
      lo = r;
    else
      hi = r;
    if (!(next >= lo && next <= hi))
      next = 0.5 * (lo + hi);
    double step = next - r;
    r = next;
    if (fabs(step) < LAST_STEP)
      break;
  }
  return r;
}

// Cosine between a chord's normal and the one against that of an edge's own chord.
static double chord_cosine(const Frame *frame, const Side *side, int edge)
{
  double t[2], length = chord(side, edge, t);
  return -(t[0] * frame->c[0] + t[1] * frame->c[1]) / (length * frame->size);
}

// Cosine between a chord's normal and the one against an edge's, at a point.
static double cosine(const Frame *frame, const Side *side, int edge, double r)
{
  if (side->num_nodes == 2)
    return chord_cosine(frame, side, edge);
  Curve x = curve_at(side, edge, r, frame->a);
  const double *t = x.x[1];
  double length = sqrt(t[0] * t[0] + t[1] * t[1]);
  return -(t[0] * frame->c[0] + t[1] * frame->c[1]) / (length * frame->size);
}

// Whether there are risers: of straight edges only. On curved ones hits come in pairs where they turn,
// with infinite slopes.
static int has_risers(const Sigma *sigma)
{
  return sigma->sides[0].num_nodes == 2 && !sigma->turn;
}

// Add a part of an edge of Γ0 to what lines from an edge of Γ1 can meet.
static void add_part(Cast *cast, int g, double from, double to)
{
  double slope, ends[2];
  for (int k = 0; k < 2; ++k)
  { // of a vertex the same number as that of its break
    double r = k ? to : from;
    ends[k] = r == k ? along(&cast->frame, node(cast->below, g, k))
                     : place(&cast->frame, cast->below, g, r, &slope);
  }
  double first = ends[0], last = ends[1];
  double low = smaller(first, last), high = larger(first, last);
  int turns_away = first < last;
  if (turns_away && (!has_risers(cast->sigma) || cosine(&cast->frame, cast->below, g, from) <=
                                                     -cast->sigma->cosines[0]))
    return;
  if (first != last && low < 1 && high > 0)
    cast->facing[cast->num_facing++] = (Facing){g, turns_away, from, to, low, high};
}

// Reference coordinate where an edge turns, which goes opposite ways at its ends.
static double turning(const Frame *frame, const Side *side, int edge, const double *slopes)
{
  double lo = 0, hi = 1, r = slopes[0] / (slopes[0] - slopes[1]), slope; // a parabola's
  for (int it = 0; side->num_nodes > 3 && it < STEPS; ++it, r = 0.5 * (lo + hi))
  {
    place(frame, side, edge, r, &slope);
    *((slope > 0) == (slopes[0] > 0) ? &lo : &hi) = r;
  }
  return r;
}

// Add the parts of an edge of Γ0.
static void add_parts(Cast *cast, int g)
{
  const Side *side = cast->below;
  const Frame *frame = &cast->frame;
  double slopes[2], low = INFINITY, high = -INFINITY;
  for (int k = 0; k < side->num_nodes; ++k)
  {
    double at = along(frame, node(side, g, k));
    low = smaller(low, at), high = larger(high, at);
  }
  double more = side->num_nodes > 2 ? 0.25 * (high - low) : 0; // a parabola's beyond its nodes
  if (low - more >= 1 || high + more <= 0)
    return;
  for (int k = 0; k < 2; ++k)
    place(frame, side, g, k, slopes + k);
  if (side->num_nodes > 2 && slopes[0] * slopes[1] < 0)
  {
    double turn = turning(frame, side, g, slopes);
    add_part(cast, g, 0, turn);
    add_part(cast, g, turn, 1);
  }
  else
    add_part(cast, g, 0, 1);
}

static int by_place(const void *a, const void *b)
{
  const Break *one = a, *two = b;
  if (one->xi != two->xi)
    return one->xi < two->xi ? -1 : 1;
  return (one->vertex > two->vertex) - (one->vertex < two->vertex);
}

static void add_break(Cast *cast, double xi, int vertex, int edge, double r)
{
  if (xi > 0 && xi < 1)
    cast->breaks[cast->num_breaks++] = (Break){xi, vertex, edge, r};
}

// Add the places where the weight of what faces an edge of Γ1 begins or ends to fade as it turns.
static void add_fades(Cast *cast, const Facing *facing)
{
  const Side *below = cast->below;
  const double *levels = cast->sigma->cosines;
  for (int k = 0; below->num_nodes > 2 && k < NUM_FADES; ++k)
  {
    double level = k == 0 ? 0.5 * levels[0] : levels[k - 1], slope;
    double lo = facing->from, hi = facing->to;
    int rises = cosine(&cast->frame, below, facing->edge, lo) < level;
    if ((cosine(&cast->frame, below, facing->edge, hi) < level) == rises)
      continue;
    for (int it = 0; it < STEPS; ++it)
    {
      double middle = 0.5 * (lo + hi);
      *((cosine(&cast->frame, below, facing->edge, middle) < level) == rises ? &lo : &hi) = middle;
    }
    add_break(cast, place(&cast->frame, below, facing->edge, lo, &slope), -1, facing->edge, lo);
  }
}

// Whether an edge g of Γ0 can meet the edge f of Γ1: on one surface those before it, but for its
// neighbours, so that each pair of places counts once.
static int can_meet(const Cast *cast, int g)
{
  const Sigma *sigma = cast->sigma;
  if (!sigma->turn)
    return 1;
  int f = cast->edge / cast->above->num_parts;
  for (int k = 0; k < NUM_OWN; ++k)
    if (sigma->own[NUM_OWN * f + k] == g)
      return 0;
  return sigma->turn[g] < sigma->turn[f];
}

// Find what faces an edge of Γ1, and the places along it where something may change: the ends of all
// that faces it, of what weight ever. Quadrature isn't exact: gaps would jump as a weight comes.
static void look(Cast *cast, int f)
{
  const Side *below = cast->below;
  cast->edge = f, cast->frame = frame_of(cast->above, f);
  cast->num_facing = cast->num_breaks = 0;
  for (int g = 0; g < below->num_edges; ++g)
  {
    int before = cast->num_facing;
    if (can_meet(cast, g))
      add_parts(cast, g);
    for (int k = before; k < cast->num_facing; ++k)
      add_fades(cast, cast->facing + k);
    for (int k = 0; before < cast->num_facing && k < 2; ++k)
      if (!cast->sigma->goes_on[2 * g + k])
        add_break(cast, along(&cast->frame, node(below, g, k)), below->vertices[2 * g + k], -1, 0);
  }
  const double fixed[] = {0, cast->sigma->shared[0], cast->sigma->shared[1], 1};
  for (int k = 0; k < 4; ++k)
    cast->breaks[cast->num_breaks++] = (Break){fixed[k], -1, -1, 0};
  qsort(cast->breaks, cast->num_breaks, sizeof(Break), by_place);
}

// Height over the chord of a point of an edge.
static double height_at(const Frame *frame, const Side *side, int edge, double r)
{
  if (side->num_nodes == 2)
  {
    double first = above(frame, node(side, edge, 0));
    return first + r * (above(frame, node(side, edge, 1)) - first);
  }
  Curve x = curve_at(side, edge, r, (double[]){0, 0});
  return above(frame, x.x[0]);
}

// Depth of a point in Γ0's body by the nearest edge, a chain of straight ones between its nodes;
// negative outside.
static double find_foot(const Cast *cast, const double *x, Point *point)
{
  const Side *side = cast->below;
  const int *order = cast->order;
  double nearest = INFINITY, depth = 0;
  point->foot = -1;
  for (int g = 0; g < side->num_edges; ++g)
    for (int k = 0; can_meet(cast, g) && k + 1 < side->num_nodes; ++k)
    {
      const double *a = node(side, g, order[k]), *b = node(side, g, order[k + 1]);
      double c[2] = {b[0] - a[0], b[1] - a[1]}, d[2] = {x[0] - a[0], x[1] - a[1]};
      double square = c[0] * c[0] + c[1] * c[1], t = (d[0] * c[0] + d[1] * c[1]) / square;
      int at = t <= 0 ? k : t >= 1 ? k + 1 : -1;
      double across = c[0] * d[1] - c[1] * d[0], far = across * across / square;
      if (at >= 0)
      {
        const double *y = node(side, g, order[at]);
        far = (x[0] - y[0]) * (x[0] - y[0]) + (x[1] - y[1]) * (x[1] - y[1]);
      }
      if (!(far < nearest)) // squares
        continue;
      int beyond = at == 0 || at == side->num_nodes - 1 ? beside_of(side, g, at > 0) : -1;
      if (beyond >= 0 && !can_meet(cast, beyond))
        continue; // where the surface goes on to the point itself
      nearest = far;
      far = sqrt(far);
      double inside = across / sqrt(square);
      point->foot = g;
      point->nodes[0] = order[at < 0 ? k : at], point->nodes[1] = order[at < 0 ? k + 1 : at];
      point->sign = 1, depth = inside;
      if (at < 0)
        continue;
      const double *y = node(side, g, order[at]), *next = NULL;
      int to = at == k ? -1 : 1, v = side->vertices[2 * g + (to > 0)];
      int other = side->beside[2 * v + (to > 0)];
      if (at + to >= 0 && at + to < side->num_nodes)
        next = node(side, g, order[at + to]);
      else if (other >= 0)
        next = node(side, other, order[to > 0 ? 1 : side->num_nodes - 2]);
      if (next)
      { // on which side of the node's mean normal
        double e[2], length = hypot(next[0] - y[0], next[1] - y[1]);
        for (int i = 0; i < 2; ++i)
          e[i] = to * (next[i] - y[i]) / length + c[i] / sqrt(square), d[i] = x[i] - y[i];
        point->sign = e[0] * d[1] - e[1] * d[0] < 0 ? -1 : 1;
        depth = point->sign * far;
      }
      else if (inside <= 0)
        point->sign = -1, depth = -far;
      else
      { // beyond an end of Γ0 it falls from what it is at the end: to 0 at .75 of that beside it
        point->nodes[0] = order[k], point->nodes[1] = order[k + 1];
        point->sign = at == k ? 2 : 3, depth = 5 * inside - 4 * far;
      }
    }
  return depth;
}

// Weight by an edge's normal.
//
// cos    there
// depth  by what is nearest, with the slack, used if the height is below zero
static double sheet_weight(const Cast *cast, int edge, double cos, double height, double depth)
{
  const Sigma *sigma = cast->sigma;
  double step[3], near[3], deep[3] = {1};
  smooth_step(cos, sigma->cosines, step);
  if (step[0] > 0 && height < 0)
  {
    double flat = chord_cosine(&cast->frame, cast->below, edge);
    smooth_step(depth / (-height * flat), (double[]){0, 1}, near);
    double across = flat - sigma->slack * cast->frame.size / height;
    smooth_step(near[0] * across, sigma->nearest, deep);
  }
  return step[0] * deep[0];
}

// Depth in Γ0's body of a point from which a ray starts, with the slack; found once.
static double depth_at(Cast *cast, const double *x, Point *point, double *depth)
{
  if (isnan(*depth))
    *depth = find_foot(cast, x, point) + cast->sigma->slack * cast->frame.size;
  return *depth;
}

// What a riser of Γ0 leads to: the largest weight of an edge before (0) or behind it (1), with edges
// between that don't turn away, or hardly.
//
// x  start of the ray
static double find_beyond(Cast *cast, int way, const double *x, Point *point, double *depth,
                            Sheet *sheet)
{
  const Side *side = cast->below;
  const Sigma *sigma = cast->sigma;
  const double faces[] = {-sigma->cosines[0], 0};
  double most = 0, open = 1, step[3];
  int dip = -1, edge = sheet->edge;
  sheet->goes_on[way] = sheet->dips[way] = -1;
  for (int n = 0; n < side->num_edges && open > most; ++n)
  {
    edge = beside_of(side, edge, way);
    if (edge < 0)
      break;
    double cos = cosine(&cast->frame, side, edge, 0);
    double height = above(&cast->frame, node(side, edge, 1 - way)) - above(&cast->frame, x);
    double deep = cos > sigma->cosines[0] && height < 0 ? depth_at(cast, x, point, depth) : 0;
    double weight = open * sheet_weight(cast, edge, cos, height, deep);
    if (weight > most)
    {
      most = weight;
      sheet->goes_on[way] = edge, sheet->dips[way] = dip;
    }
    smooth_step(cos, faces, step);
    if (step[0] < open)
      open = step[0], dip = edge;
  }
  return most;
}

// Find a sheet's weight, and the edges beside it that share theirs with it: what an edge lacks it gets
// from them by its place between both. A riser, between edges that face Γ1, also does as they do.
static void weigh(Cast *cast, double cos, const double *x, Point *point, double *depth, Hit *hit)
{
  const Side *side = cast->below;
  const Sigma *sigma = cast->sigma;
  double deep = hit->height < 0 ? depth_at(cast, x, point, depth) : 0;
  double own = sheet_weight(cast, hit->sheet.edge, cos, hit->height, deep);
  double r = hit->sheet.r, step[3], beside = 0;
  smooth_step(cos, (double[]){0.5 * sigma->cosines[0], sigma->cosines[0]}, step);
  for (int k = 0; k < 2; ++k)
  {
    int next = beside_of(side, hit->sheet.edge, k);
    hit->sheet.beside[k] = -1;
    if (next < 0 || own >= 1)
      continue;
    double other = cosine(&cast->frame, side, next, 1 - k);
    double weight = sheet_weight(cast, next, other, hit->height, deep);
    if (weight > 0)
      hit->sheet.beside[k] = next;
    beside += (k ? r : 1 - r) * weight;
  }
  double beyond = step[0] < 1 && has_risers(sigma);
  for (int k = 0; k < 2; ++k)
    beyond *= beyond > 0 ? find_beyond(cast, k, x, point, depth, &hit->sheet) : 0;
  if (beyond == 0)
    hit->sheet.goes_on[0] = hit->sheet.goes_on[1] = -1;
  hit->weight = 1 - (1 - own) * (step[0] * (1 - beside) + (1 - step[0]) * (1 - beyond));
}

// Find the weight of a riser that turns away a little: of what faces Γ1 in front of it, negative. It
// takes back what is seen behind it.
static void weigh_back(Cast *cast, double cos, const double *x, Point *point, double *depth, Hit *hit)
{
  const Side *side = cast->below;
  double step[3], height[2];
  for (int k = 0; k < 2; ++k)
    height[k] = above(&cast->frame, node(side, hit->sheet.edge, k));
  int way = height[1] > height[0];
  smooth_step(cos, (double[]){-cast->sigma->cosines[0], 0}, step);
  hit->weight = step[0] > 0 ? -step[0] * find_beyond(cast, way, x, point, depth, &hit->sheet) : 0;
  hit->sheet.goes_on[1 - way] = -1;
}

// Sheets that a ray sees, those farthest behind first; their number.
//
// point  its start on Γ1 is known; what of Γ0 is nearest is set
// hits   (MOST_SHEETS)
static int see(Cast *cast, double xi, Point *point, Hit *hits)
{
  const Sigma *sigma = cast->sigma;
  const Frame *frame = &cast->frame;
  Curve x = curve_at(cast->above, cast->edge, point->s, (double[]){0, 0});
  double start = above(frame, x.x[0]), depth = NAN;
  int num = 0, full = 1, lost = 0;
  for (int k = 0; k < cast->num_facing; ++k)
  {
    const Facing *facing = cast->facing + k;
    if (xi < facing->low - TINY || xi > facing->high + TINY)
      continue;
    Hit hit = {.sheet = {facing->edge, .beside = {-1, -1}, .goes_on = {-1, -1},
                         .turns_away = facing->turns_away}};
    hit.sheet.r = meet(frame, cast->below, facing->edge, facing->from, facing->to, xi);
    hit.height = height_at(frame, cast->below, facing->edge, hit.sheet.r) - start;
    double cos = cosine(frame, cast->below, hit.sheet.edge, hit.sheet.r);
    if (facing->turns_away ? cos > 0 : cos <= 0)
      continue;
    if (sigma->turn && hit.height < -sigma->depths[cast->edge / cast->above->num_parts])
      continue;
    (facing->turns_away ? weigh_back : weigh)(cast, cos, x.x[0], point, &depth, &hit);
    if (hit.weight == 0)
      continue;
    int at = num;
    while (at > 0 && hits[at - 1].height > hit.height)
      --at;
    lost |= num == MOST_SHEETS;
    if (at == MOST_SHEETS)
      continue;
    num = num < MOST_SHEETS ? num + 1 : num;
    memmove(hits + at + 1, hits + at, (num - 1 - at) * sizeof(Hit));
    hits[at] = hit;
  }
  int first = 0; // what turns away takes nothing back where nothing is seen
  while (first < num && hits[first].weight < 0)
    ++first;
  num -= first;
  memmove(hits, hits + first, num * sizeof(Hit));
  int last = num - 1; // what hides the others, unless something turns away in front of it
  for (int k = num - 1; k >= 0 && hits[k].weight > 0; --k)
    last = hits[k].weight >= 1 ? k : last;
  num = last + 1;
  // Pieces without a length, between vertices along one ray, add to derivatives at that kink alone
  int has_length = point->places[1] - point->places[0] > TINY;
  cast->lost |= lost && has_length && (num == 0 || hits[num - 1].weight < 1);
  for (int k = 0; k < num; ++k)
    full &= hits[k].weight >= 1;
  if (full || isnan(depth))
    point->foot = -1;
  return num;
}

static void emit(Sigma *sigma, Point point, const Hit *hits, int num)
{
  point.first = sigma->num_sheets, point.num = num;
  if (sigma->num_points < sigma->max_points)
    sigma->points[sigma->num_points] = point;
  ++sigma->num_points;
  for (int k = 0; k < num; ++k, ++sigma->num_sheets)
    if (sigma->num_sheets < sigma->max_sheets)
      sigma->sheets[sigma->num_sheets] = hits[k].sheet;
}

// Add a point of a piece if its ray sees something; the number of sheets.
static int add_point(Cast *cast, Sigma *sigma, Point *point, double xi, Hit *hits)
{
  point->s = meet(&cast->frame, cast->above, cast->edge, 0, 1, xi);
  point->foot = -1;
  int num = see(cast, xi, point, hits);
  if (num)
  {
    emit(sigma, *point, hits, num);
    point->is_first = 0;
  }
  return num;
}

// Points of one piece of an edge: those of the short rule, if it is exact. (Rules that aren't may
// not take turns: forces would jump.)
static void add_piece(Cast *cast, Sigma *sigma, const Break *from, const Break *to)
{
  Hit hits[MOST_SHEETS];
  int part = to->xi <= sigma->shared[0] ? 0 : from->xi >= sigma->shared[1] ? 1 : 2;
  int num_points = sigma->num_points, num_sheets = sigma->num_sheets, one = 1, sheet = -1;
  double width = to->xi - from->xi;
  Point point = {.edge = cast->edge, .part = part, .ends = {from->vertex, to->vertex},
                 .places = {from->xi, to->xi},
                 .fades = {from->edge, to->edge},
                 .at_fades = {from->r, to->r}};
  int straight = cast->below->num_nodes == 2 && cast->above->num_nodes == 2;
  for (int rule = 0, k = 0; rule <= straight && one; ++rule)
  {
    sigma->num_points = num_points, sigma->num_sheets = num_sheets, point.is_first = 1;
    for (; k < sigma->ends_of_rules[rule]; ++k)
    {
      point.at = sigma->rule_at[k], point.width = sigma->rule_weights[k];
      int num = add_point(cast, sigma, &point, from->xi + width * point.at, hits);
      one &= num == 1 && hits[0].weight >= 1 && (sheet < 0 || hits[0].sheet.edge == sheet);
      sheet = num ? hits[0].sheet.edge : -1;
    }
  }
}

// Find the order of an edge's nodes, from start to end.
static void sort_nodes(const Side *side, int *order)
{
  for (int k = 0; k < side->num_nodes; ++k)
  {
    int at = 0;
    for (int other = 0; other < side->num_nodes; ++other)
      at += side->node_at[other] < side->node_at[k];
    order[at] = k;
  }
}

static int start(Cast *cast, const Sigma *sigma)
{
  int num = sigma->sides[0].num_edges;
  *cast = (Cast){.sigma = sigma, .below = sigma->sides, .above = sigma->sides + 1};
  sort_nodes(cast->below, cast->order);
  cast->facing = malloc((2 * num + 1) * sizeof(Facing));
  cast->breaks = malloc(((2 + 2 * NUM_FADES) * num + 4) * sizeof(Break));
  return cast->facing && cast->breaks;
}

static void end(Cast *cast)
{
  free(cast->facing);
  free(cast->breaks);
}

// Find points and sheets. If there are more than there is room for, their numbers are larger.
// Returns STUCK where a ray sees more than MOST_SHEETS.
int cast_rays(Sigma *sigma)
{
  Cast cast;
  sigma->num_points = sigma->num_sheets = 0;
  int can = start(&cast, sigma);
  for (int f = 0; can && f < cast.above->num_edges; ++f)
  {
    look(&cast, f);
    const Break *last = cast.breaks;
    for (int k = 1; k < cast.num_breaks; ++k)
    {
      const Break *next = cast.breaks + k;
      if (next->xi > last->xi || next->vertex < 0 || next->vertex != last->vertex)
        add_piece(&cast, sigma, last, next); // of length 0 too: derivatives aren't zero
      last = next;
    }
  }
  end(&cast);
  return !can ? NO_MEMORY : cast.lost ? STUCK : DONE;
}

// The column between both sides of a point's piece of an edge of Γ1.
//
// x   ends of the piece, and of what lies opposite, (2, 2, 2)
// at  places of the ends along the edge, (2,)
void find_column(const Sigma *sigma, const Point *point, double *x, double *at)
{
  const Side *sides = sigma->sides;
  const Sheet *sheet = sigma->sheets + point->first + point->num - 1;
  Frame frame = frame_of(sides + 1, point->edge);
  for (int e = 0; e < 2; ++e)
  {
    double xi = point->places[e], slope, other;
    double s = meet(&frame, sides + 1, point->edge, 0, 1, xi), r = sheet->r;
    // From where it was met to the piece's end
    for (int it = 0; it < 4; ++it)
    {
      other = place(&frame, sides, sheet->edge, r, &slope);
      r = slope != 0 ? smaller(larger(r - (other - xi) / slope, 0), 1) : r;
    }
    Curve x1 = curve_at(sides + 1, point->edge, s, (double[]){0, 0});
    Curve x0 = curve_at(sides, sheet->edge, r, (double[]){0, 0});
    memcpy(x + 2 * e, x1.x[0], sizeof(x1.x[0]));
    memcpy(x + 4 + 2 * e, x0.x[0], sizeof(x0.x[0]));
    at[e] = s;
  }
}

// Columns of all points, to look at.
//
// x       (num_points, 2, 2, 2)
// at      (num_points, 2)
// shown   whether a point has one, (num_points)
void find_columns(const Sigma *sigma, double *x, double *at, int *shown)
{
  for (int p = 0; p < sigma->num_points; ++p)
  {
    shown[p] = sigma->points[p].is_first;
    find_column(sigma, sigma->points + p, x + 8 * p, at + 2 * p);
  }
}

// Depth of a point in the body of Γ0 (side 0) or of Γ1, negative outside.
double depth_in(const Sigma *sigma, int side, const double *x)
{
  Point point;
  Sigma every = *sigma;
  every.turn = NULL; // of one surface all edges count, also those that a point is on
  Cast cast = {.sigma = &every, .below = sigma->sides + side};
  sort_nodes(cast.below, cast.order);
  return find_foot(&cast, x, &point);
}
