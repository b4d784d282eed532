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

typedef struct { /* accelerations at the two latest steps' first or second stage, the latest first */
  double known, time[2];
  levels acceleration[2];
} past;

typedef struct { /* what is carried from step to step */
  levels x, v, acceleration; /* the last is that of the latest stage */
  past past[2];
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
  levels step;
  vector packed_P[BATCHES][NPROP], packed_theta[NTHETA]; /* a segment is a lane of a batch */
  double by[NLEV][segment_by_nnz]; /* segment_by of every segment, as the selection orders it */
  selection chosen;
  vector pull[BATCHES][NEDGES], trusted[BATCHES][NEDGES]; /* of the edges: at the last evaluation, and in the last stage that was solved */
  double by_properties[properties_by_nnz], by_inputs[input_motion_by_nnz + 1];
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
  int smooth; /* whether the scheme has its order */
  double divisor; /* from the distance between fine and coarse motion to what is stated as error */
  double close; /* m that a stage may be off; 0 where only the residual counts */
  history *inputs;
  tangent *d, *d_fine, *d_coarse; /* along the directions: of the state that moves, and of the two of adaptive steps */
  lane_rates *stage[2];
  double steps, iterations, factors, halvings, reached, error, longest;
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

