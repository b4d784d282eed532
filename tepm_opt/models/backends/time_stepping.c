/* Steps in time around the kernels that CasADi generates above this text in the same unit: Crouzeix's two-stage SDIRK with a
   block-tridiagonal elimination, classical RK4, forward sensitivities. time_stepping.py is the reference twin.

   Sizes are macros: NB coordinates a level, NLEV free levels, NPROP rows of P (MASS the one of the mass), NU inputs, NEXT external
   force components, NTHETA parameters, NOBS observations, NIN internal states of the inputs, NEDGE those of a segment's edges,
   SZ_W, SZ_IW work of the kernels. For every sparse Jacobian `f` there are f_nnz, f_row and f_col. Level 0 is fixed.
   Statuses, schemes and limits are macros too: interface.py has them. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define PARTS ((NB + LANES - 1) / LANES)          /* vectors that hold a column of a block */
#define NINPUT (NU + NEXT)
#define BATCHES ((NLEV + LANES - 1) / LANES)      /* of segments that go through a kernel together */
#define AT_LEAST_1(n) ((n) ? (n) : 1)
#define BY_ROWS (2 * NB + NEDGE)

typedef double levels[NLEV + 1][NB];
typedef vector lanes[NLEV + 2][NB];
typedef double panel[NB][PARTS * LANES]; /* a block, column by column, padded to whole vectors */
typedef int kernel(const casadi_real **, casadi_real **, casadi_int *, casadi_real *, int);

typedef struct { /* what is carried from sample to sample; the order is time_stepping.py's */
  levels x, v, acceleration;
  double u[NU], y_inputs[AT_LEAST_1(NIN)], y_edges[NLEV][AT_LEAST_1(NEDGE)];
  double depth; /* halvings the last step took */
} state;

typedef struct { /* the same, differentiated in LANES directions */
  lanes x, v;
  vector u[NU], a[NU], y_inputs[AT_LEAST_1(NIN)], y_edges[NLEV][AT_LEAST_1(NEDGE)];
} tangent;

typedef struct { /* levels and edge states of a stage, or their rates */
  lanes x, v;
  vector y[NLEV][AT_LEAST_1(NEDGE)];
} lane_rates;

typedef struct { /* entries of segment_by that the directions need, row by row, those of velocities behind the others of their row */
  int start[BY_ROWS + 1], moving[BY_ROWS], entry[segment_by_nnz], column[segment_by_nnz];
} selection;

typedef struct {
  levels x, v, force;
  double y[NLEV][AT_LEAST_1(NEDGE)], rate[NLEV][AT_LEAST_1(NEDGE)]; /* edge states before a stage, their rates at its end */
  double P[NLEV][NPROP], level_0[NB], a[NU], external[NEXT];
  panel diagonal[NLEV + 1], below[NLEV + 1], above[NLEV + 1]; /* blocks of rows l by columns l, l - 1; rows l - 1 by columns l */
  double step[NLEV + 2][NB];
  vector packed_P[BATCHES][NPROP], packed_theta[NTHETA]; /* a segment is a lane of a batch */
  double by[NLEV][segment_by_nnz]; /* segment_by of every segment, as the selection orders it */
  selection chosen;
  double block[4 * NB * NB], by_properties[properties_by_nnz], by_inputs[input_motion_by_nnz + 1];
  double kernel_work[SZ_W + 1];
  casadi_int kernel_iwork[SZ_IW + 1];
  const double *theta;
  int factored;
} work;

typedef struct { /* inputs over time */
  const double *time, *rows;
  const vector *d_rows; /* [sample][group][NINPUT], or null */
  long samples, at;
  int hold, groups;
  double delay;
  const vector *d_theta;
  double by_delay[AT_LEAST_1(delay_by_nnz)];
} history;

typedef struct {
  int scheme, groups;
  double tolerance, max_correction; /* N, and m that a stage may correct its extrapolation by */
  history *inputs;
  tangent *d;
  lane_rates *stage[2];
  double steps, iterations, factors, halvings;
} stepper;

static void run(kernel *f, work *w, const double **arg, double **res) { f(arg, res, w->kernel_iwork, w->kernel_work, 0); }

/* Finds the sample at or before a time and returns the part of the way to the next one: inputs change linearly, or hold until it;
   `left` is just before a jump. */
static double place(history *h, double t, int left) {
  if (h->hold) t += left ? -JUMP_TIME : JUMP_TIME; /* a sample's time may come with rounding */
  while (h->at + 2 < h->samples && h->time[h->at + 1] <= t) h->at++;
  while (h->at > 0 && h->time[h->at] > t) h->at--;
  double part = (t - h->time[h->at]) / (h->time[h->at + 1] - h->time[h->at]);
  if (h->hold) return part >= 1;
  return part < 0 ? 0 : part > 1 ? 1 : part;
}

static void look(history *h, double t, int left, int from, int count, double *values) {
  double part = place(h, t, left);
  const double *row = h->rows + h->at * NINPUT + from;
  for (int k = 0; k < count; k++) values[k] = row[k] + part * (row[NINPUT + k] - row[k]);
}

/* How the inputs at that time change in the directions of a group; `late` where the delay moves the time. */
static void look_along(history *h, double t, int left, int from, int count, int late, int group, vector *values) {
  double part = place(h, t, left), slope = part > 0 && part < 1 ? 1 / (h->time[h->at + 1] - h->time[h->at]) : 0;
  const double *row = h->rows + h->at * NINPUT + from;
  const vector *d = h->d_rows ? h->d_rows + (h->at * h->groups + group) * NINPUT + from : 0;
  vector sooner = {0};
  if (late) for (int k = 0; k < delay_by_nnz; k++) sooner -= h->by_delay[k] * h->d_theta[group * NTHETA + delay_by_col[k]];
  for (int k = 0; k < count; k++) {
    values[k] = sooner * slope * (row[NINPUT + k] - row[k]);
    if (d) values[k] += d[k] + part * (d[h->groups * NINPUT + k] - d[k]);
  }
}

/* Move the inputs and their internal states on to a time; sets w->a. */
static void move_inputs(stepper *m, work *w, state *s, double until, double duration, int left) {
  double u[NU], rate[NU], y[AT_LEAST_1(NIN)];
  look(m->inputs, until - m->inputs->delay, left, 0, NU, u);
  for (int k = 0; k < NU; k++) rate[k] = (u[k] - s->u[k]) / duration;
  const double *arg[] = {u, rate, s->y_inputs, &duration, w->theta};
  double *res[] = {w->a, y};
  run(input_motion, w, arg, res);
  if (m->groups) {
    double *by[] = {w->by_inputs};
    run(input_motion_by, w, arg, by);
    for (int g = 0; g < m->groups; g++) {
      tangent *d = m->d + g;
      vector in[2 * NU + NIN + NTHETA], out[NU + NIN];
      look_along(m->inputs, until - m->inputs->delay, left, 0, NU, 1, g, in);
      for (int k = 0; k < NU; k++) { in[NU + k] = (in[k] - d->u[k]) / duration; d->u[k] = in[k]; }
      memcpy(in + 2 * NU, d->y_inputs, NIN * sizeof(vector));
      memcpy(in + 2 * NU + NIN, m->inputs->d_theta + g * NTHETA, NTHETA * sizeof(vector));
      memset(out, 0, sizeof out);
      for (int k = 0; k < input_motion_by_nnz; k++) out[input_motion_by_row[k]] += w->by_inputs[k] * in[input_motion_by_col[k]];
      memcpy(d->a, out, sizeof d->a);
      memcpy(d->y_inputs, out + NU, NIN * sizeof(vector));
    }
  }
  memcpy(s->u, u, sizeof u);
  memcpy(s->y_inputs, y, NIN * sizeof(double));
}

/* P and level 0 under the actuation a and the external forces at a time. */
static void set_properties(stepper *m, work *w, const double *a, double t) {
  look(m->inputs, t, 0, NU, NEXT, w->external);
  const double *arg[] = {a, w->external, w->theta};
  double *res[] = {w->P[0], w->level_0};
  run(properties, w, arg, res);
  for (int s = 0; s < BATCHES * LANES; s++)
    for (int k = 0; k < NPROP; k++) w->packed_P[s / LANES][k][s % LANES] = w->P[s < NLEV ? s : NLEV - 1][k];
}

/* Add a segment's matrix, (lower, upper level)² column by column, to the blocks. */
static void scatter(work *w, int s, const double *block) {
  for (int c = 0; c < NB; c++) {
    const double *lower = block + c * 2 * NB, *upper = block + (NB + c) * 2 * NB;
    for (int r = 0; r < NB; r++) {
      w->diagonal[s][c][r] += lower[r];
      w->below[s + 1][c][r] = lower[NB + r];
      w->above[s + 1][c][r] = upper[r];
      w->diagonal[s + 1][c][r] = upper[NB + r];
    }
  }
}

/* Inverse of a block in place by Gauss-Jordan without pivoting (matrices here are positive definite up to the small asymmetry of
   damping on turning edges). Returns 1 where a pivot is 0 or not a number. */
static int invert(panel a) {
#pragma GCC unroll 12
  for (int p = 0; p < NB; p++) {
    vector column[PARTS];
    if (!(fabs(a[p][p]) > 0)) return 1;
    double inverse = 1 / a[p][p];
    a[p][p] = 0;
    memcpy(column, a[p], sizeof column);
    for (int c = 0; c < NB; c++) {
      if (c == p) continue;
      double scale = a[c][p] * inverse;
      for (int v = 0; v < PARTS; v++) ((vector *)a[c])[v] -= scale * column[v];
      a[c][p] = scale;
    }
    for (int v = 0; v < PARTS; v++) ((vector *)a[p])[v] = -inverse * column[v];
    a[p][p] = inverse;
  }
  return 0;
}

/* Block elimination in place: `diagonal` becomes the inverses of the pivot blocks, `below` is multiplied by the one before. */
static int factor(work *w) {
  for (int l = 1; l <= NLEV; l++) {
    if (l > 1) {
      panel product;
      for (int c = 0; c < NB; c++) {
        vector sum[PARTS] = {{0}};
        for (int k = 0; k < NB; k++)
          for (int v = 0; v < PARTS; v++) sum[v] += ((vector *)w->below[l][k])[v] * w->diagonal[l - 1][c][k];
        memcpy(product[c], sum, sizeof sum);
      }
      for (int c = 0; c < NB; c++)
        for (int k = 0; k < NB; k++)
          for (int v = 0; v < PARTS; v++) ((vector *)w->diagonal[l][c])[v] -= ((vector *)product[k])[v] * w->above[l][c][k];
      memcpy(w->below[l], product, sizeof product);
    }
    if (invert(w->diagonal[l])) return 1;
  }
  w->factored = 1;
  return 0;
}

/* sum = start + sign * (block times x) */
static void multiply(panel a, const double *x, double sign, const double *start, double *sum) {
  vector total[PARTS] = {{0}};
  memcpy(total, start, NB * sizeof(double));
  for (int c = 0; c < NB; c++)
    for (int v = 0; v < PARTS; v++) total[v] += ((vector *)a[c])[v] * (sign * x[c]);
  memcpy(sum, total, NB * sizeof(double));
}

static void multiply_lanes(panel a, const vector *x, double sign, const vector *start, vector *sum) {
  vector total[NB];
  memcpy(total, start, sizeof total);
  for (int c = 0; c < NB; c++) {
    vector scaled = sign * x[c];
    for (int r = 0; r < NB; r++) total[r] += a[c][r] * scaled;
  }
  memcpy(sum, total, sizeof total);
}

/* Solve with the factor, in place; b has the levels 0 (left alone) … NLEV. */
#define SOLVE(name, type, multiply)                                                        \
  static void name(work *w, type (*b)[NB]) {                                               \
    static const type zero[NB];                                                            \
    for (int l = 2; l <= NLEV; l++) multiply(w->below[l], b[l - 1], -1, b[l], b[l]);       \
    for (int l = NLEV; l >= 1; l--) {                                                      \
      if (l < NLEV) multiply(w->above[l + 1], b[l + 1], -1, b[l], b[l]);                   \
      multiply(w->diagonal[l], b[l], 1, zero, b[l]);                                       \
    }                                                                                      \
  }
SOLVE(solve, double, multiply)
SOLVE(solve_lanes, vector, multiply_lanes)

typedef struct { vector x[2][NB], v[2][NB], y[AT_LEAST_1(NEDGE)]; } batch; /* LANES segments side by side */

/* Gathers a batch and returns how many of its lanes are segments of their own: spare ones repeat the last. */
static int gather(const work *w, int first, batch *b) {
  int count = NLEV - first < LANES ? NLEV - first : LANES;
  for (int lane = 0; lane < LANES; lane++) {
    int s = lane < count ? first + lane : NLEV - 1;
    for (int i = 0; i < NB; i++) {
      b->x[0][i][lane] = w->x[s][i]; b->x[1][i][lane] = w->x[s + 1][i];
      b->v[0][i][lane] = w->v[s][i]; b->v[1][i][lane] = w->v[s + 1][i];
    }
    for (int k = 0; k < NEDGE; k++) b->y[k][lane] = w->y[s][k];
  }
  return count;
}

/* Forces of all segments at w->x, w->v (w->force), rates of the edge states and, with `with_tangent`, the stage's matrix in the blocks. */
static void forces(work *w, double step, int with_tangent) {
  vector time = (vector){0} + step, force[2 * NB], rate[AT_LEAST_1(NEDGE)], matrix[4 * NB * NB];
  memset(w->force, 0, sizeof w->force);
  for (int first = 0; first < NLEV; first += LANES) {
    batch b;
    int count = gather(w, first, &b);
    const vector *arg[] = {b.x[0], b.x[1], b.v[0], b.v[1], b.y, &time, w->packed_P[first / LANES], w->packed_theta};
    vector *res[] = {force, rate, matrix};
    if (with_tangent) segment_tangent_lanes(arg, res);
    else segment_motion_lanes(arg, res);
    for (int lane = 0; lane < count; lane++) {
      int s = first + lane;
      for (int i = 0; i < NB; i++) { w->force[s][i] += force[i][lane]; w->force[s + 1][i] += force[NB + i][lane]; }
      for (int k = 0; k < NEDGE; k++) w->rate[s][k] = rate[k][lane];
      if (!with_tangent) continue;
      for (int k = 0; k < 4 * NB * NB; k++) w->block[k] = matrix[k][lane];
      for (int i = NB; i < 2 * NB; i++) w->block[i * (2 * NB + 1)] += w->P[s][MASS] / step / step;
      scatter(w, s, w->block);
    }
  }
}

/* Forces, and the factored tangent M / step^2 + d force / d positions of a stage. */
static int assemble(stepper *m, work *w, double step) {
  forces(w, step, 1);
  m->factors++;
  return factor(w);
}

/* Solve M (v - v_0) / step + force = 0 with v = (x - x_0) / step for w->x and w->v, from w->x; the matrix of an earlier stage
   is kept while it serves. */
static int newton(stepper *m, work *w, double step, levels x_0, levels v_0, int last_try) {
  double before = INFINITY, rate = 1;
  levels guess;
  memcpy(guess, w->x, sizeof guess);
  for (int iteration = 0; iteration < STAGE_ITERATIONS; iteration++) {
    for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) w->v[l][i] = (w->x[l][i] - x_0[l][i]) / step;
    if (w->factored) forces(w, step, 0);
    else if (assemble(m, w, step)) return STUCK;
    double largest = 0;
    for (int l = 1; l <= NLEV; l++) {
      double mass = w->P[l - 1][MASS] / step;
      for (int i = 0; i < NB; i++) {
        double r = w->step[l][i] = w->force[l][i] + mass * (w->v[l][i] - v_0[l][i]);
        if (!(fabs(r) <= largest)) largest = fabs(r);
      }
    }
    if (largest < m->tolerance) return SOLVED;
    if (!(largest < 1e12)) return STUCK;
    if (iteration) rate = largest / before;
    if (rate > 0.3 && iteration) w->factored = 0; /* the next iteration has a matrix of its own */
    solve(w, w->step);
    double corrected = 0;
    for (int l = 1; l <= NLEV; l++)
      for (int i = 0; i < NB; i++) {
        w->x[l][i] -= w->step[l][i];
        double d = fabs(w->x[l][i] - guess[l][i]);
        if (d > corrected) corrected = d;
      }
    if (corrected > m->max_correction && !last_try) return STUCK; /* too far to trust that this is the solution nearby */
    m->iterations++;
    before = largest;
    if (!NEDGE && iteration && largest * rate < m->tolerance) { /* the step just taken has done it */
      for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) w->v[l][i] = (w->x[l][i] - x_0[l][i]) / step;
      return SOLVED;
    }
  }
  return STUCK;
}

/* Parts of a direction that enter a segment: levels, velocities, edge states, properties, parameters. */
enum { AT_V = 2 * NB, AT_Y = 4 * NB, AT_P = AT_Y + NEDGE, AT_THETA = AT_P + NPROP, SEGMENT = AT_THETA + NTHETA };

static void properties_along(stepper *m, work *w, double t, const vector *a, int group, vector *P_level_0) {
  vector in[NU + NEXT + NTHETA];
  memcpy(in, a, NU * sizeof(vector));
  look_along(m->inputs, t, 0, NU, NEXT, 0, group, in + NU);
  memcpy(in + NU + NEXT, m->inputs->d_theta + group * NTHETA, NTHETA * sizeof(vector));
  memset(P_level_0, 0, (NLEV * NPROP + NB) * sizeof(vector));
  for (int k = 0; k < properties_by_nnz; k++) P_level_0[properties_by_row[k]] += w->by_properties[k] * in[properties_by_col[k]];
}

/* Columns of parameters that no direction changes are left out. */
static void choose(work *w, int groups, const vector *d_theta) {
  char changes[NTHETA] = {0};
  for (int k = 0; k < groups * NTHETA; k++) for (int lane = 0; lane < LANES; lane++) changes[k % NTHETA] |= d_theta[k][lane] != 0;
  selection *c = &w->chosen;
  int count = 0;
  for (int row = 0; row < BY_ROWS; row++) {
    c->start[row] = count;
    for (int of_velocities = 0; of_velocities < 2; of_velocities++) {
      if (of_velocities) c->moving[row] = count;
      for (int k = 0; k < segment_by_nnz; k++) {
        int column = segment_by_col[k];
        if (segment_by_row[k] != row || (column >= AT_V && column < AT_Y) != of_velocities) continue;
        if (column >= AT_THETA && !changes[column - AT_THETA]) continue;
        c->entry[count] = k;
        c->column[count++] = column;
      }
    }
  }
  c->start[BY_ROWS] = count;
}

/* Some of the chosen entries of a segment times a direction; sums of their own that do not wait for each other. */
static inline vector product(const work *w, int s, int from, int until, const vector *in) {
  const double *by = w->by[s];
  const int *column = w->chosen.column;
  vector sum[4] = {{0}};
  int k = from;
  for (; k + 4 <= until; k += 4) for (int i = 0; i < 4; i++) sum[i] += by[k + i] * in[column[k + i]];
  for (; k < until; k++) sum[0] += by[k] * in[column[k]];
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* Jacobians of a stage: segments (and, if `resting`, the factored stiffness of the network at rest), properties. */
static int linearise(work *w, double step, const double *a, int resting) {
  const double *arg_P[] = {a, w->external, w->theta};
  double *res_P[] = {w->by_properties};
  run(properties_by, w, arg_P, res_P);
  vector time = (vector){0} + step, by[segment_by_nnz];
  for (int first = 0; first < NLEV; first += LANES) {
    batch b;
    int count = gather(w, first, &b);
    const vector *arg[] = {b.x[0], b.x[1], b.v[0], b.v[1], b.y, &time, w->packed_P[first / LANES], w->packed_theta};
    vector *res[] = {by};
    segment_by_lanes(arg, res);
    for (int k = 0; k < w->chosen.start[BY_ROWS]; k++)
      for (int lane = 0; lane < count; lane++) w->by[first + lane][k] = by[w->chosen.entry[k]][lane];
    for (int lane = 0; lane < count && resting; lane++) {
      memset(w->block, 0, sizeof w->block);
      for (int k = 0; k < segment_by_nnz; k++)
        if (segment_by_row[k] < 2 * NB && segment_by_col[k] < 2 * NB) w->block[segment_by_col[k] * 2 * NB + segment_by_row[k]] = by[k][lane];
      scatter(w, first + lane, w->block);
    }
  }
  return resting ? factor(w) : 0;
}

/* One group of directions through a stage: from *d at its start (x_0, v_0, y_0) to the rates at its end, with the matrix at hand.
   Without `step` the network rests and d->x becomes how its equilibrium moves. */
static void differentiate(stepper *m, work *w, int group, double t, double step, const vector *a, lane_rates *d, levels v_0) {
  vector P[NLEV * NPROP + NB], rhs[NLEV + 2][NB] = {{{0}}}, in[SEGMENT];
  const selection *c = &w->chosen;
  properties_along(m, w, t, a, group, P);
  memcpy(d->x[0], P + NLEV * NPROP, sizeof d->x[0]);
  memset(d->v[0], 0, sizeof d->v[0]);
  memcpy(in + AT_THETA, m->inputs->d_theta + group * NTHETA, NTHETA * sizeof(vector));
  for (int s = 0; s < NLEV; s++) {
    memcpy(in, d->x[s], 2 * NB * sizeof(vector));
    memcpy(in + AT_Y, d->y[s], NEDGE * sizeof(vector));
    memcpy(in + AT_P, P + s * NPROP, NPROP * sizeof(vector));
    for (int i = 0; i < 2 * NB; i++) rhs[s + i / NB][i % NB] -= product(w, s, c->start[i], c->moving[i], in);
    if (step > 0)
      for (int i = 0; i < NB; i++)
        rhs[s + 1][i] += (w->P[s][MASS] * d->v[s + 1][i] - P[s * NPROP + MASS] * (w->v[s + 1][i] - v_0[s + 1][i])) / step;
  }
  solve_lanes(w, rhs);
  memset(rhs[0], 0, sizeof rhs[0]);
  for (int l = 1; l <= NLEV; l++)
    for (int i = 0; i < NB; i++) {
      d->x[l][i] += rhs[l][i];
      if (step > 0) { vector v = rhs[l][i] / step; d->v[l][i] = (v - d->v[l][i]) / step; rhs[l][i] = v; }
    }
  if (!(step > 0)) return;
  for (int s = 0; s < NLEV && NEDGE; s++) {
    memcpy(in, d->x[s], 2 * NB * sizeof(vector));
    memcpy(in + AT_V, rhs[s], 2 * NB * sizeof(vector));
    memcpy(in + AT_Y, d->y[s], NEDGE * sizeof(vector));
    memcpy(in + AT_P, P + s * NPROP, NPROP * sizeof(vector));
    for (int i = 0; i < NEDGE; i++) d->y[s][i] = product(w, s, c->start[2 * NB + i], c->start[2 * NB + i + 1], in);
  }
  memcpy(d->x[1], rhs[1], NLEV * sizeof rhs[0]); /* rates: velocity, acceleration, dy/dt */
}

/* Crouzeix's two-stage SDIRK of order 3 (Hairer and Wanner, vol. II, IV.6): one step of length h from t; s is left alone on failure. */
static int implicit_step(stepper *m, work *w, state *s, double t, double h, int last_try) {
  const double gamma = 0.5 + sqrt(3) / 6, step = gamma * h, c[3] = {1 - gamma, gamma, 1};
  double a[2][NU];
  state start = *s;
  levels x_0, v_0, V[2], A[2];
  double Y[2][NLEV][AT_LEAST_1(NEDGE)];
  tangent *kept = 0;
  vector (*d_a)[2][NU] = 0;
  if (m->groups) {
    kept = malloc(m->groups * sizeof *kept);
    d_a = malloc(m->groups * sizeof *d_a);
    memcpy(kept, m->d, m->groups * sizeof *kept);
  }
  for (int k = 0; k < 3; k++) { /* the second stage's time comes first */
    move_inputs(m, w, s, t + c[k] * h, (c[k] - (k ? c[k - 1] : 0)) * h, k == 2);
    if (k == 2) break;
    memcpy(a[1 - k], w->a, sizeof w->a);
    for (int g = 0; g < m->groups; g++) memcpy(d_a[g][1 - k], m->d[g].a, sizeof m->d[g].a);
  }
  int status = SOLVED;
  w->factored = 0;
  for (int i = 0; i < 2 && !status; i++) {
    double before = i ? (1 - 2 * gamma) * h : 0;
    set_properties(m, w, a[i], t + c[1 - i] * h);
    memcpy(w->x[0], w->level_0, sizeof w->level_0);
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) {
        x_0[l][k] = s->x[l][k] + before * (i ? V[0][l][k] : 0);
        v_0[l][k] = s->v[l][k] + before * (i ? A[0][l][k] : 0);
        w->x[l][k] = x_0[l][k] + step * (v_0[l][k] + step * s->acceleration[l][k]);
      }
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) w->y[e][k] = s->y_edges[e][k] + before * (i ? Y[0][e][k] : 0);
    status = newton(m, w, step, x_0, v_0, last_try);
    if (status) break;
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) { V[i][l][k] = w->v[l][k]; s->acceleration[l][k] = A[i][l][k] = (w->v[l][k] - v_0[l][k]) / step; }
    memcpy(Y[i], w->rate, sizeof Y[i]);
    if (!m->groups) continue;
    if (assemble(m, w, step) || linearise(w, step, a[i], 0)) { status = STUCK; break; }
    for (int g = 0; g < m->groups; g++) {
      lane_rates *d = m->stage[i] + g;
      tangent *d_s = m->d + g;
      for (int l = 1; l <= NLEV; l++)
        for (int k = 0; k < NB; k++) {
          d->x[l][k] = d_s->x[l][k] + (i ? before * m->stage[0][g].x[l][k] : (vector){0});
          d->v[l][k] = d_s->v[l][k] + (i ? before * m->stage[0][g].v[l][k] : (vector){0});
        }
      for (int e = 0; e < NLEV; e++)
        for (int k = 0; k < NEDGE; k++) d->y[e][k] = d_s->y_edges[e][k] + (i ? before * m->stage[0][g].y[e][k] : (vector){0});
      differentiate(m, w, g, t + c[1 - i] * h, step, d_a[g][i], d, v_0);
    }
  }
  if (status) {
    *s = start;
    if (kept) memcpy(m->d, kept, m->groups * sizeof *kept);
  } else {
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) { s->x[l][k] += h / 2 * (V[0][l][k] + V[1][l][k]); s->v[l][k] += h / 2 * (A[0][l][k] + A[1][l][k]); }
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) s->y_edges[e][k] += h / 2 * (Y[0][e][k] + Y[1][e][k]);
    for (int g = 0; g < m->groups; g++) {
      lane_rates *first = m->stage[0] + g, *second = m->stage[1] + g;
      tangent *d = m->d + g;
      for (int l = 1; l <= NLEV; l++)
        for (int k = 0; k < NB; k++) { d->x[l][k] += h / 2 * (first->x[l][k] + second->x[l][k]); d->v[l][k] += h / 2 * (first->v[l][k] + second->v[l][k]); }
      for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) d->y_edges[e][k] += h / 2 * (first->y[e][k] + second->y[e][k]);
    }
  }
  free(kept);
  free(d_a);
  return status;
}

/* Classical RK4; inputs and their states at the start, the middle and the end. */
static int explicit_step(stepper *m, work *w, state *s, double t, double h) {
  static const double at[4] = {0, 0.5, 0.5, 1}, weight[4] = {1. / 6, 1. / 3, 1. / 3, 1. / 6};
  state start = *s;
  levels V, A;
  double Y[NLEV][AT_LEAST_1(NEDGE)];
  for (int i = 0; i < 4; i++) {
    if (i == 1) move_inputs(m, w, s, t + h / 2, h / 2, 0);
    if (i == 3) move_inputs(m, w, s, t + h, h / 2, 1);
    if (i != 2) set_properties(m, w, w->a, t + at[i] * h);
    memcpy(w->x[0], w->level_0, sizeof w->level_0);
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) {
        w->x[l][k] = start.x[l][k] + (i ? at[i] * h * V[l][k] : 0);
        w->v[l][k] = start.v[l][k] + (i ? at[i] * h * A[l][k] : 0);
      }
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) w->y[e][k] = start.y_edges[e][k] + (i ? at[i] * h * Y[e][k] : 0);
    forces(w, 0, 0);
    for (int l = 1; l <= NLEV; l++) {
      double compliance = -1 / w->P[l - 1][MASS];
      for (int k = 0; k < NB; k++) {
        V[l][k] = w->v[l][k];
        A[l][k] = compliance * w->force[l][k];
        s->x[l][k] += weight[i] * h * V[l][k];
        s->v[l][k] += weight[i] * h * A[l][k];
      }
    }
    memcpy(Y, w->rate, sizeof Y);
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) s->y_edges[e][k] += weight[i] * h * Y[e][k];
  }
  return SOLVED;
}

static int bounded(state *s) {
  double sum = 0;
  for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) sum += fabs(s->x[l][i]);
  return sum < 1e3 * NLEV * NB;
}

/* A step, or two halves of it where Newton fails or the step before had to be halved twice. */
static int advance(stepper *m, work *w, state *s, double t, double h, int depth) {
  if (m->scheme == EXPLICIT) { m->steps++; return explicit_step(m, w, s, t, h); }
  if (s->depth <= depth + 1) {
    int status = implicit_step(m, w, s, t, h, depth == MAX_HALVINGS);
    if (!status) { m->steps++; s->depth = depth; return SOLVED; }
    if (depth == MAX_HALVINGS) return status;
    m->halvings++;
  }
  int status = advance(m, w, s, t, h / 2, depth + 1);
  return status ? status : advance(m, w, s, t + h / 2, h / 2, depth + 1);
}

/* Row k of what is observed: points in G and lengths, levels and velocities, directions. */
static void record(stepper *m, work *w, state *s, long k, double *observed, double *trajectory, vector *d_observed) {
  const double *arg[] = {s->x[0], w->theta};
  double *res[] = {observed + k * NOBS, observed + k * NOBS + NOBS - NU / 2};
  run(observe, w, arg, res);
  if (trajectory) {
    memcpy(trajectory + k * 2 * sizeof(levels) / sizeof(double), s->x, sizeof(levels));
    memcpy(trajectory + (k * 2 + 1) * sizeof(levels) / sizeof(double), s->v, sizeof(levels));
  }
  if (!m->groups) return;
  double by[observe_by_nnz], *res_by[] = {by};
  run(observe_by, w, arg, res_by);
  for (int g = 0; g < m->groups; g++) {
    vector *out = d_observed + (k * m->groups + g) * NOBS, in[(NLEV + 1) * NB + NTHETA];
    memcpy(in, m->d[g].x, (NLEV + 1) * NB * sizeof(vector));
    memcpy(in + (NLEV + 1) * NB, m->inputs->d_theta + g * NTHETA, NTHETA * sizeof(vector));
    memset(out, 0, NOBS * sizeof(vector));
    for (int i = 0; i < observe_by_nnz; i++) out[observe_by_row[i]] += by[i] * in[observe_by_col[i]];
  }
}

/* Rest under the first row: actuation, level 0, directions; s holds the equilibrium's levels. */
static int begin(stepper *m, work *w, state *s) {
  look(m->inputs, m->inputs->time[0], 0, 0, NU, s->u);
  for (int g = 0; g < m->groups; g++) {
    memset(m->d + g, 0, sizeof m->d[g]);
    look_along(m->inputs, m->inputs->time[0], 0, 0, NU, 0, g, m->d[g].u);
  }
  move_inputs(m, w, s, m->inputs->time[0] + m->inputs->delay, JUMP_TIME, 0);
  set_properties(m, w, w->a, m->inputs->time[0]);
  memcpy(s->x[0], w->level_0, sizeof w->level_0);
  if (!m->groups) return SOLVED;
  memcpy(w->x, s->x, sizeof w->x);
  memcpy(w->v, s->v, sizeof w->v);
  memcpy(w->y, s->y_edges, sizeof w->y);
  if (linearise(w, 0, w->a, 1)) return STUCK;
  for (int g = 0; g < m->groups; g++) {
    lane_rates *d = m->stage[0] + g;
    memset(d, 0, sizeof *d);
    differentiate(m, w, g, m->inputs->time[0], 0, m->d[g].a, d, w->v);
    memcpy(m->d[g].x, d->x, sizeof d->x);
  }
  return SOLVED;
}

int state_size(void) { return sizeof(state) / sizeof(double); }
int tangent_size(void) { return sizeof(tangent) / sizeof(double); }

/* Moves on from sample `first` to sample `last` of `samples` with steps of at most `step`; rows first + 1 … last are recorded, and row 0
   where `first` is 0. s carries the state, d (groups) its directions. info: steps, iterations, factorisations, halvings, time reached. */
int integrate(int scheme, int hold, long first, long last, long samples, const double *time, const double *rows, double step, double tolerance,
          double max_correction, const double *theta, double *carried, double *observed, double *trajectory, int groups, const double *d_theta,
          const double *d_rows, double *d, double *d_observed, double *info) {
  work *w = aligned_alloc(64, (sizeof(work) + 63) / 64 * 64);
  if (!w) return STUCK;
  memset(w, 0, sizeof *w);
  w->theta = theta;
  for (int k = 0; k < NTHETA; k++) w->packed_theta[k] = (vector){0} + theta[k];
  state *s = (state *)carried;
  history inputs = {.time = time, .rows = rows, .d_rows = (const vector *)d_rows, .samples = samples, .hold = hold, .groups = groups,
                    .d_theta = (const vector *)d_theta};
  if (groups) choose(w, groups, inputs.d_theta);
  const double *arg[] = {theta};
  double *res[] = {&inputs.delay}, *res_by[] = {inputs.by_delay};
  run(delay, w, arg, res);
  run(delay_by, w, arg, res_by);
  stepper m = {.scheme = scheme, .groups = groups, .tolerance = tolerance, .max_correction = max_correction, .inputs = &inputs, .d = (tangent *)d};
  int status = SOLVED;
  for (int i = 0; i < 2 && groups; i++) m.stage[i] = malloc(groups * sizeof(lane_rates));
  if (!first && !(status = begin(&m, w, s))) record(&m, w, s, 0, observed, trajectory, (vector *)d_observed);
  if (first) { /* w->a is where the inputs are */
    state same = *s;
    const double zero[NU] = {0}, moment = JUMP_TIME, *now[] = {same.u, zero, same.y_inputs, &moment, theta};
    double *a[] = {w->a, same.y_inputs};
    run(input_motion, w, now, a);
  }
  info[4] = time[first];
  for (long k = first; k < last && !status; k++) {
    double span = time[k + 1] - time[k];
    int count = (int)ceil(span / step * (1 - 1e-9));
    if (hold) move_inputs(&m, w, s, time[k], JUMP_TIME, 0);
    for (int i = 0; i < count && !status; i++) {
      status = advance(&m, w, s, time[k] + i * span / count, span / count, 0);
      if (!status && !bounded(s)) status = DIVERGED;
      if (!status) info[4] = time[k] + (i + 1) * span / count;
    }
    if (!status) record(&m, w, s, k + 1, observed, trajectory, (vector *)d_observed);
  }
  info[0] = m.steps; info[1] = m.iterations; info[2] = m.factors; info[3] = m.halvings;
  for (int i = 0; i < 2; i++) free(m.stage[i]);
  free(w);
  return status;
}
