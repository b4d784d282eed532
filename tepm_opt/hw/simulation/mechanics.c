/* The simulated robot's mechanics: point masses joined by edges that are springs, dampers and motors, stepped by RK4.

   Written from Newton's law alone. Nothing here comes from models/, whose judge it is.

   Arrays have a row a node and axis, and in a row the levels side by side, LANES of which are one vector. The levels 1 ... are at LANES,
   LANES + 1, ...; level 0, which is fixed, stands before them; so the lower ends of all segments are the row of their upper ends, one place to
   the left. Rows are filled up to whole vectors with levels that weigh nothing and never move. Every sum has a fixed order, whatever the
   vectors' width, and nothing is contracted: the same numbers on every machine. */

#include <math.h>
#include <stdint.h>
#include <string.h>

typedef int64_t integer;
typedef double vector __attribute__((vector_size(8 * LANES), aligned(8)));

static inline vector load(const double *at) { return *(const vector *)at; }
static inline void store(double *at, vector value) { *(vector *)at = value; }
static inline vector all(double value) { return (vector){0} + value; }
static inline vector root(vector x) {
  for (int i = 0; i < LANES; i++) x[i] = sqrt(x[i]);
  return x;
}

typedef struct { /* the order is engine.py's */
  integer levels, nodes, edges, width; /* of the network; levels in a row, filled up */
  const integer *ends;                 /* (edges, 4): level (0 lower, 1 upper) and node of one end, of the other; verticals come first */
  const double *stiffness, *damping, *preload; /* (edges, width): of springs, of dampers, spring times rest length */
  const double *inverse_mass;                  /* (nodes, width) in 1/kg, 0 of what fills up */
  const double *fall;                          /* (3,) in m/s2, of what is free */
  const double *rest;                          /* (nodes, 3, row) in m */
  double *x, *v;                               /* (nodes, 3, row): positions in m, velocities in m/s */
  double *push, *slope;                        /* (nodes, width): motors' forces in N, their changes in N/s */
  double *load;                                /* (levels, 3): force on each node of a level in N */
  double *still;                               /* (nodes, 3, width): accelerations in m/s2 that no edge makes */
  double *work;                                /* WORK times (nodes, 3, row), and a vector */
  double step, bound;                          /* s; m, the farthest that a node may go */
} mechanics;

enum { WORK = 7 };

static inline integer row_of(const mechanics *m) { return m->width + LANES; }
static inline integer size_of(const mechanics *m) { return 3 * m->nodes * row_of(m); }
static inline double *work_of(const mechanics *m, integer part) { return m->work + part * size_of(m) + (part > 1 ? LANES : 0); }

/* Accelerations that loads and gravity make. */
static void rest_on(const mechanics *m) {
  for (integer i = 0; i < m->nodes; i++)
    for (integer k = 0; k < 3; k++)
      for (integer j = 0; j < m->levels; j++)
        m->still[(3 * i + k) * m->width + j] = m->fall[k] + m->load[3 * j + k] * m->inverse_mass[i * m->width + j];
}

/* Forces of the edges on their upper and their lower ends, (nodes, 3, row) each, at LANES ... as everything. */
static void pull(const mechanics *m, const double *x, const double *v, double since, double *upper, double *lower) {
  const integer row = row_of(m), width = m->width;
  memset(upper, 0, sizeof(double) * size_of(m));
  memset(lower, 0, sizeof(double) * (size_of(m) + LANES)); /* above the last level there is nothing */
  for (integer e = 0; e < m->edges; e++) {
    const integer *end = m->ends + 4 * e;
    const integer from = 3 * end[1] * row + LANES - 1 + end[0], to = 3 * end[3] * row + LANES - 1 + end[2];
    const double *k = m->stiffness + e * width, *c = m->damping + e * width, *p = m->preload + e * width;
    double *one = (end[0] ? upper : lower) + 3 * end[1] * row + LANES, *other = (end[2] ? upper : lower) + 3 * end[3] * row + LANES;
    for (integer j = 0; j < width; j += LANES) {
      const double *a = x + from + j, *b = x + to + j, *va = v + from + j, *vb = v + to + j;
      const vector d0 = load(b) - load(a), d1 = load(b + row) - load(a + row), d2 = load(b + 2 * row) - load(a + 2 * row);
      const vector w0 = load(vb) - load(va), w1 = load(vb + row) - load(va + row), w2 = load(vb + 2 * row) - load(va + 2 * row);
      const vector inverse = all(1.0) / root(d0 * d0 + d1 * d1 + d2 * d2);
      const vector rate = (d0 * w0 + d1 * w1 + d2 * w2) * inverse;
      vector back = load(c + j) * rate - load(p + j);
      if (e < m->nodes) back -= load(m->push + e * width + j) + all(since) * load(m->slope + e * width + j);
      const vector share = load(k + j) + back * inverse, f0 = share * d0, f1 = share * d1, f2 = share * d2;
      store(one + j, load(one + j) + f0), store(one + row + j, load(one + row + j) + f1);
      store(one + 2 * row + j, load(one + 2 * row + j) + f2);
      store(other + j, load(other + j) - f0), store(other + row + j, load(other + row + j) - f1);
      store(other + 2 * row + j, load(other + 2 * row + j) - f2);
    }
  }
}

/* Accelerations (nodes, 3, row) `since` s after the motors' forces were set; those of level 0 are not touched. */
static void accelerate(const mechanics *m, const double *x, const double *v, double since, double *a) {
  const integer row = row_of(m), width = m->width;
  double *upper = work_of(m, 0), *lower = work_of(m, 1);
  pull(m, x, v, since, upper, lower);
  for (integer r = 0; r < 3 * m->nodes; r++)
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
