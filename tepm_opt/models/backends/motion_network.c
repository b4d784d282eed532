/* turned[lane][i] = rows[i][lane] */
static inline void turn(const vector *rows, vector *turned) {
#if LANES == 4 && defined __has_builtin
#if __has_builtin(__builtin_shufflevector)
#define TURNED
  vector a = __builtin_shufflevector(rows[0], rows[1], 0, 4, 2, 6), b = __builtin_shufflevector(rows[0], rows[1], 1, 5, 3, 7);
  vector c = __builtin_shufflevector(rows[2], rows[3], 0, 4, 2, 6), d = __builtin_shufflevector(rows[2], rows[3], 1, 5, 3, 7);
  turned[0] = __builtin_shufflevector(a, c, 0, 1, 4, 5);
  turned[1] = __builtin_shufflevector(b, d, 0, 1, 4, 5);
  turned[2] = __builtin_shufflevector(a, c, 2, 3, 6, 7);
  turned[3] = __builtin_shufflevector(b, d, 2, 3, 6, 7);
#endif
#endif
#ifndef TURNED
  for (int lane = 0; lane < LANES; lane++) for (int i = 0; i < LANES; i++) turned[lane][i] = rows[i][lane];
#endif
}

/* Add the matrices of a batch of segments, (lower, upper level)² column by column and a segment a lane, to the blocks: rows in groups of
   LANES, turned so that a segment has them side by side. */
static void scatter(work *w, int first, int count, const vector *matrix) {
  for (int k = 0; k < 2 * NB; k++)
    for (int half = 0; half < 2; half++)
      for (int part = 0; part < PARTS; part++) {
        int c = (k + NB) % (2 * NB); /* columns of the upper level first: they begin its block */
        vector rows[LANES] = {{0}}, turned[LANES];
        for (int i = 0; i < LANES && part * LANES + i < NB; i++) rows[i] = matrix[c * 2 * NB + half * NB + part * LANES + i];
        turn(rows, turned);
        for (int lane = 0; lane < count; lane++) {
          int s = first + lane;
          vector *lower = (vector *)(half ? w->below[s + 1] : w->diagonal[s])[c % NB] + part;
          vector *upper = (vector *)(half ? w->diagonal[s + 1] : w->above[s + 1])[c % NB] + part;
          if (c >= NB) *upper = turned[lane];
          else if (half) *lower = turned[lane];
          else *lower += turned[lane];
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

/* sum = start + sign * (block times x); columns in two sums that do not wait for each other */
static void multiply(panel a, const double *x, double sign, const double *start, double *sum) {
  vector total[2][PARTS] = {{{0}}};
  memcpy(total[0], start, NB * sizeof(double));
  for (int c = 0; c < NB; c++)
    for (int v = 0; v < PARTS; v++) total[c % 2][v] += ((vector *)a[c])[v] * (sign * x[c]);
  for (int v = 0; v < PARTS; v++) total[0][v] += total[1][v];
  memcpy(sum, total[0], NB * sizeof(double));
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

/* Velocities of a stage that began at x_0. */
static void velocities(work *w, double step, levels x_0) {
  for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) w->v[l][i] = (w->x[l][i] - x_0[l][i]) / step;
}

/* Forces of all segments at w->x, w->v (w->force), rates of the edge states and, with `with_tangent`, the stage's matrix in the blocks. */
static void forces(work *w, double step, int with_tangent) {
  vector time = (vector){0} + step, force[2 * NB], rate[AT_LEAST_1(NEDGE)], matrix[4 * NB * NB];
  memset(w->force, 0, sizeof w->force);
  for (int first = 0; first < NLEV; first += LANES) {
    batch b;
    int count = gather(w, first, &b);
    const vector *arg[] = {b.x[0], b.x[1], b.v[0], b.v[1], b.y, &time, w->packed_P[first / LANES], w->packed_theta, w->trusted[first / LANES]};
    vector *res[] = {force, rate, w->pull[first / LANES], matrix};
    if (with_tangent) segment_tangent_lanes(arg, res);
    else segment_motion_lanes(arg, res);
    for (int lane = 0; lane < count; lane++) {
      int s = first + lane;
      for (int i = 0; i < NB; i++) { w->force[s][i] += force[i][lane]; w->force[s + 1][i] += force[NB + i][lane]; }
      for (int k = 0; k < NEDGE; k++) w->rate[s][k] = rate[k][lane];
    }
    if (with_tangent) scatter(w, first, count, matrix);
  }
  for (int l = 1; l <= NLEV && with_tangent; l++)
    for (int i = 0; i < NB; i++) w->diagonal[l][i][i] += w->P[l - 1][MASS] / step / step;
}

/* Forces, and the factored tangent M / step^2 + d force / d positions of a stage. */
static int assemble(stepper *m, work *w, double step) {
  forces(w, step, 1);
  m->factors++;
  return factor(w);
}

/* Solve M (v - v_0) / step + force = 0 with v = (x - x_0) / step for w->x and w->v, from w->x. The matrix, written where the solution
   is expected but with the edges' pulls of the last stage that was solved, serves while it contracts. */
static int newton(stepper *m, work *w, double step, levels x_0, levels v_0, int last_try) {
  double contraction = INFINITY, before = INFINITY;
  levels guess, from;
  memcpy(guess, w->x, sizeof guess);
  w->factored = 0;
  for (int iteration = 0; iteration < STAGE_ITERATIONS; iteration++) {
    velocities(w, step, x_0);
    if (w->factored) forces(w, step, 0);
    else if (assemble(m, w, step)) return STUCK;
    double largest = 0, size = 0, corrected = 0;
    for (int l = 1; l <= NLEV; l++) {
      double mass = w->P[l - 1][MASS] / step;
      for (int i = 0; i < NB; i++) {
        double r = w->step[l][i] = w->force[l][i] + mass * (w->v[l][i] - v_0[l][i]);
        if (!(fabs(r) <= largest)) largest = fabs(r);
      }
    }
    if (largest < m->tolerance) return SOLVED;
    if (!(largest < 1e12)) return STUCK;
    solve(w, w->step);
    memcpy(from, w->x, sizeof from);
    move(from, w->step, -1, w->x);
    for (int l = 1; l <= NLEV; l++)
      for (int i = 0; i < NB; i++) {
        double far = fabs(w->x[l][i] - guess[l][i]), long_ = fabs(w->step[l][i]); /* fmax would be a call */
        corrected = far > corrected ? far : corrected;
        size = long_ > size ? long_ : size;
      }
    if (corrected > m->max_correction && !last_try) return STUCK; /* too far to trust that this is the solution nearby */
    m->iterations++;
    contraction = iteration ? size / before : 1;
    before = size;
    if (contraction > SLOW && iteration) { /* the next iteration has a matrix of its own */
      w->factored = 0;
      memcpy(w->trusted, w->pull, sizeof w->pull);
    }
    if (size * contraction < m->close || (iteration && largest * contraction < m->tolerance)) { /* the step just taken has done it */ velocities(w, step, x_0); if (NEDGE) forces(w, step, 0); return SOLVED; }
  }
  return STUCK;
}
