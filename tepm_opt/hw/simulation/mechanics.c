/* The simulated robot's mechanics: point masses joined by edges that are springs, dampers and motors, stepped by RK4.

   Written from Newton's law alone. Nothing here comes from models/, whose judge it is.

   NODES of a level and ENDS of the EDGES of a segment, verticals first, stand before this text: level (0 lower, 1 upper) and node of one
   end, then of the other.

   Arrays have a row a node and axis, and in a row the levels side by side, LANES of which are one vector. Level 1 is at LANES and the
   others follow; level 0, which is fixed, stands before them; so the lower ends of all segments are the row of their upper ends, one place
   to the left. Rows are filled up to whole vectors with levels that weigh nothing and never move. Every sum has a fixed order, whatever the
   vectors' width, and nothing is contracted: the same numbers on every machine. */

#include <math.h>
#include <stdint.h>
#include <string.h>

typedef int64_t integer;
typedef double vector __attribute__((vector_size(8 * LANES), aligned(8)));
typedef vector doubles __attribute__((may_alias));

static inline vector load(const double *at) { return *(const doubles *)at; }
static inline void store(double *at, vector value) { *(doubles *)at = value; }
static inline vector all(double value) { return (vector){0} + value; }
static inline vector root(vector x) {
  for (int i = 0; i < LANES; i++) x[i] = sqrt(x[i]);
  return x;
}

typedef struct { /* the order is engine.py's */
  integer levels, width;                       /* of the network; levels in a row, filled up */
  const double *stiffness, *damping, *preload; /* (edges, width): of springs, of dampers, spring times rest length */
  const double *inverse_mass;                  /* (nodes, width) in 1/kg, 0 of what fills up */
  const double *fall;                          /* (3,) in m/s2, of what is free */
  const double *rest;                          /* (nodes, 3, row) in m */
  double *x, *v;                               /* (nodes, 3, row): positions in m, velocities in m/s */
  double *push, *slope;                        /* (nodes, width): motors' forces in N, their changes in N/s */
  double *load;                                /* (levels, 3): force on each node of a level in N */
  double *still;                               /* (nodes, 3, width): accelerations in m/s2 that no edge makes */
  double *work;                                /* see work_of: 7 times (nodes, 3, row), and a vector */
  double step, bound;                          /* s; m, the farthest that a node may go */
} mechanics;

static inline integer row_of(const mechanics *m) { return m->width + LANES; }
static inline integer size_of(const mechanics *m) { return 3 * NODES * row_of(m); }
static inline double *work_of(const mechanics *m, integer part) { return m->work + part * size_of(m) + (part > 1 ? LANES : 0); }

/* Accelerations that loads and gravity make. */
static void rest_on(const mechanics *m) {
  for (integer i = 0; i < NODES; i++)
    for (integer k = 0; k < 3; k++)
      for (integer j = 0; j < m->levels; j++)
        m->still[(3 * i + k) * m->width + j] = m->fall[k] + m->load[3 * j + k] * m->inverse_mass[i * m->width + j];
}

/* A node's place or velocity in LANES segments. */
typedef struct { vector x, y, z; } triple;

static inline triple take(const double *row_x, integer row) { return (triple){load(row_x), load(row_x + row), load(row_x + 2 * row)}; }
static inline triple minus(triple a, triple b) { return (triple){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline vector dot(triple a, triple b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline void add(triple *to, vector share, triple of) { to->x += share * of.x, to->y += share * of.y, to->z += share * of.z; }

/* Forces of the edges of all segments on their upper and on their lower ends, (nodes, 3, row) each, at LANES ... as everything. */
static void pull(const mechanics *m, const double *x, const double *v, double since, double *upper, double *lower) {
  const integer row = row_of(m), width = m->width;
  for (integer j = 0; j < width; j += LANES) {
    triple place[2][NODES], motion[2][NODES], force[2][NODES] = {0}; /* of the lower and the upper ends */
    for (int i = 0; i < NODES; i++)
      for (int end = 0; end < 2; end++) {
        place[end][i] = take(x + 3 * i * row + LANES - 1 + end + j, row);
        motion[end][i] = take(v + 3 * i * row + LANES - 1 + end + j, row);
      }
#pragma GCC unroll 64
    for (int e = 0; e < EDGES; e++) {
      const int a = ENDS[e][0], i = ENDS[e][1], b = ENDS[e][2], k = ENDS[e][3];
      const integer at = e * width + j;
      const triple span = minus(place[b][k], place[a][i]), drift = minus(motion[b][k], motion[a][i]);
      const vector inverse = all(1.0) / root(dot(span, span));
      vector back = load(m->damping + at) * (dot(span, drift) * inverse) - load(m->preload + at);
      if (e < NODES) back -= load(m->push + at) + all(since) * load(m->slope + at);
      const vector share = load(m->stiffness + at) + back * inverse;
      add(&force[a][i], share, span), add(&force[b][k], -share, span);
    }
    for (int i = 0; i < NODES; i++) {
      double *on[2] = {lower + 3 * i * row + LANES + j, upper + 3 * i * row + LANES + j};
      for (int end = 0; end < 2; end++)
        store(on[end], force[end][i].x), store(on[end] + row, force[end][i].y), store(on[end] + 2 * row, force[end][i].z);
    }
  }
}

/* Accelerations (nodes, 3, row) `since` s after the motors' forces were set; those of level 0 are not touched. */
static void accelerate(const mechanics *m, const double *x, const double *v, double since, double *a) {
  const integer row = row_of(m), width = m->width;
  double *upper = work_of(m, 0), *lower = work_of(m, 1);
  pull(m, x, v, since, upper, lower);
  for (integer r = 0; r < 3 * NODES; r++)
    for (integer j = 0; j < width; j += LANES) {
      const integer at = r * row + LANES + j;
      const vector force = load(upper + at) + load(lower + at + 1); /* the lower ends of the next segment */
      store(a + at, load(m->still + r * width + j) + force * load(m->inverse_mass + r / 3 * width + j));
    }
}

/* Some steps of RK4 from when the motors' forces were set. */
static void move(const mechanics *m, integer steps) {
  const integer size = size_of(m);
  const double h = m->step;
  double *x = m->x, *v = m->v, *xs = work_of(m, 2), *vs = work_of(m, 3), *a = work_of(m, 4), *sum_v = work_of(m, 5), *sum_a = work_of(m, 6);
  for (integer step = 0; step < steps; step++) {
    const double t = step * h;
    accelerate(m, x, v, t, a);
    for (integer i = 0; i < size; i += LANES) {
      const vector vi = load(v + i), ai = load(a + i);
      store(sum_v + i, vi), store(sum_a + i, ai);
      store(xs + i, load(x + i) + all(h / 2) * vi), store(vs + i, vi + all(h / 2) * ai);
    }
    for (int stage = 2; stage < 4; stage++) {
      const double next = stage == 2 ? h / 2 : h;
      accelerate(m, xs, vs, t + h / 2, a);
      for (integer i = 0; i < size; i += LANES) {
        const vector vi = load(vs + i), ai = load(a + i);
        store(sum_v + i, load(sum_v + i) + all(2.0) * vi), store(sum_a + i, load(sum_a + i) + all(2.0) * ai);
        store(xs + i, load(x + i) + all(next) * vi), store(vs + i, load(v + i) + all(next) * ai);
      }
    }
    accelerate(m, xs, vs, t + h, a);
    for (integer i = 0; i < size; i += LANES) {
      store(x + i, load(x + i) + all(h / 6) * (load(sum_v + i) + load(vs + i)));
      store(v + i, load(v + i) + all(h / 6) * (load(sum_a + i) + load(a + i)));
    }
  }
}
