/* Steps in time around the kernels (see kernels.py) above this text in the same unit: Crouzeix's two-stage SDIRK with a
   block-tridiagonal elimination, classical RK4, forward sensitivities. time_stepping.py is the reference twin.

   Segments go through a kernel side by side, each in a lane of vectors (motion_network.c, motion_tangents.c).

   Sizes are macros: NB coordinates a level, NLEV free levels, NPROP rows of P (MASS the one of the mass), NU inputs, NEXT external
   force components, NOBS observations, NIN internal states of the inputs, NEDGE those of a segment's edges.
   TIMED says whether an effect asks what time it is, of which CLOCK and BEGAN are the places in theta: of the time in the session and of
   when the motion began. For every sparse Jacobian `f` there are f_nnz, f_row and f_col. These and NTHETA, the number of parameters, are
   constants beside the kernels, and NTHETA_ROOM, f_nnz_ROOM no less. Level 0 is fixed. Statuses, schemes and limits are macros too:
   interface.py has them. */
#define NINPUT (NU + NEXT)
#define ALIGNED __attribute__((aligned(64))) /* what crosses lines of the cache takes a seventh more time */
#define AT_LEAST_1(n) ((n) ? (n) : 1)

typedef double levels[NLEV + 1][NB];
typedef double edge_states[NLEV][AT_LEAST_1(NEDGE)];
typedef void kernel(const double *const *, double *const *);

typedef struct { /* accelerations at the two latest steps' first or second stage, the latest first */
  double known, time[2];
  levels acceleration[2];
} past;

typedef struct { /* what is carried from step to step */
  levels x, v, acceleration; /* the last is that of the latest stage */
  past past[2];
  double u[NU], y_inputs[AT_LEAST_1(NIN)];
  edge_states y_edges;
  double depth; /* halvings the last step took */
} state;

typedef struct { /* what is carried from call to call; steps that do not adapt only have `fine` */
  state fine, coarse;
  double step, ratio, error, moved; /* s to try next, what the last pair added over what it may, largest error and way of a pair in m */
} carried;

#define PARTS ((NB + LANES - 1) / LANES)          /* vectors that hold a column of a block */
#define BATCHES ((NLEV + LANES - 1) / LANES)      /* of segments that go through a kernel together */
#define BY_ROWS (2 * NB + NEDGE)
typedef vector lanes[NLEV + 2][NB];
typedef struct { vector x[2][NB], v[2][NB], y[AT_LEAST_1(NEDGE)]; } batch; /* LANES segments side by side */
typedef double block[NB][PARTS * LANES]; /* column by column, padded to whole vectors */
typedef struct { block diagonal[NLEV + 1], below[NLEV + 1], above[NLEV + 1]; } blocks; /* rows l by columns l, l - 1; rows l - 1 by columns l */

typedef struct { /* a state, differentiated in LANES directions */
  lanes x, v;
  vector u[NU], a[NU], y_inputs[AT_LEAST_1(NIN)], y_edges[NLEV][AT_LEAST_1(NEDGE)];
} tangent;

typedef struct { /* levels and edge states of a stage, or their rates */
  lanes x, v;
  vector y[NLEV][AT_LEAST_1(NEDGE)];
} lane_rates;

typedef struct { /* entries of segment_by by levels and edge states, row by row, those of velocities behind the others of their row */
  int start[BY_ROWS + 1], moving[BY_ROWS], entry[segment_by_nnz_ROOM], column[segment_by_nnz_ROOM];
  int count; /* of all entries that any direction needs: those by properties and parameters behind the others */
} selection;

typedef struct { int row, at, column; } term; /* an entry of a sparse Jacobian, and where it is */

typedef struct { /* what a group of directions needs of the Jacobians; of a segment's, terms of forces, then of edge states */
  int inputs, properties, forces, edges, observed;
  term by_inputs[input_motion_by_nnz_ROOM], by_properties[properties_by_nnz_ROOM];
  term by_segment[segment_by_nnz_ROOM], by_observed[observe_by_nnz_ROOM];
} changes;

typedef struct {
  levels x, v, force;
  edge_states y, rate; /* edge states before a stage, their rates at its end */
  double P[NLEV][NPROP], level_0[NB], a[NU];
  double acting[NU], external[AT_LEAST_1(NEXT)]; /* what P and level_0 belong to, once they are there */
  int has_properties;
  levels step;
  vector pull[BATCHES][NEDGES], trusted[BATCHES][NEDGES]; /* of the edges: at the last evaluation, and in the last stage that was solved */
  double theta[NTHETA_ROOM];
  blocks matrix ALIGNED;
  vector packed_P[BATCHES][NPROP] ALIGNED, packed_theta[NTHETA_ROOM]; /* a segment is a lane of a batch */
  double by[NLEV][segment_by_nnz_ROOM]; /* segment_by of every segment, as the selection orders it */
  selection chosen;
  double by_properties[properties_by_nnz_ROOM], by_inputs[input_motion_by_nnz_ROOM];
  turns turns; /* from here on what functions need for themselves: stacks are small in threads */
  struct { levels guess, from, correction; } in_newton;
  struct { double a[2][NU]; levels x_0, v_0, V[2], A[2]; edge_states Y[2]; state start; } in_step;
  struct { double u[NU], rate[NU], y[AT_LEAST_1(NIN)], a[NU]; } in_inputs;
  struct { levels x, v; double observed[NOBS]; } in_record;
  struct { batch b ALIGNED; vector force[2 * NB], states[AT_LEAST_1(NEDGE)], matrix[4 * NB * NB] ALIGNED; } in_forces;
  struct {
    vector in[2 * NU + NIN + NEXT + 4 * NB + NEDGE + NPROP + NTHETA_ROOM], out[NU + NIN], P[NLEV * NPROP + NB], rhs[NLEV + 2][NB];
    vector x[(NLEV + 1) * NB + NTHETA_ROOM], by[segment_by_nnz_ROOM];
    double observed_by[observe_by_nnz_ROOM];
  } in_directions;
} work;

typedef struct { /* inputs over time */
  const double *time, *rows;
  long samples, at;
  int hold;
  double delay[2]; /* s, of commands and of known forces */
  const vector *d_rows; /* [sample][group][NINPUT], or null */
  int groups;
  const vector *d_theta;
  double by_delay[delay_by_nnz_ROOM];
} history;

typedef struct { double *observed, *trajectory; vector *d_observed; } records; /* what is left at the samples, row by row */

enum { COMMANDS, FORCES, NOTHING }; /* what is delayed */
enum { OVER, TO_BEGIN, TO_TAKE_STOCK, MOVING };

typedef struct { /* one motion: what drives it, how far it is, what it leaves */
  history inputs;
  records records;
  const double *knots; /* times at which adaptive steps end */
  const long *ends;    /* samples at which its parts end */
  long knots_left, ends_left, sample; /* the next to be recorded */
  int phase, status;
  double t, stop;      /* s: adaptive steps are at, and end at the latest */
  double span;         /* s: equal steps are not longer */
  long count, step, part, depth; /* equal steps to the next sample, those done, which of the 2^depth parts of the next one is to come */
} motion;

typedef struct {
  int scheme, adaptive;
  double tolerance, max_correction; /* N, and m that a stage may correct its extrapolation by */
  int smooth; /* whether the scheme has its order */
  double divisor; /* from the distance between fine and coarse motion to what is stated as error */
  double goal, close; /* m at which adaptive steps aim, and that a stage may be off; 0 where only the residual counts */
  double steps, iterations, factors, halvings, reached, longest;
  motion motion;
  tangent *d, *d_fine, *d_coarse; /* along the directions: of the state that moves, and of the two of adaptive steps */
  int groups;
  lane_rates *stage[2];
  vector (*d_a)[2][NU]; /* effective actuation at the stages of a step */
  changes *changes;
  int inputs_change;
} stepper;

static double larger(double a, double b) { return a > b ? a : b; }

/* Calls a kernel. What vectors have left in the upper halves of registers slows the mathematical library's code down by far: cleared before. */
static void run(kernel *f, const double **arg, double **res) {
#ifdef __AVX__
  __builtin_ia32_vzeroupper();
#endif
  f(arg, res);
}

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
