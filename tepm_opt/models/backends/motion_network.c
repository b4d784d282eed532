/* Forces and the matrix of a motion, its segments side by side. */

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
          vector *lower = (vector *)(half ? w->matrix.below[s + 1] : w->matrix.diagonal[s])[c % NB] + part;
          vector *upper = (vector *)(half ? w->matrix.diagonal[s + 1] : w->matrix.above[s + 1])[c % NB] + part;
          if (c >= NB) *upper = turned[lane];
          else if (half) *lower = turned[lane];
          else *lower += turned[lane];
        }
      }
}

/* Inverse of a block in place by Gauss-Jordan without pivoting (matrices here are positive definite up to the small asymmetry of
   damping on turning edges), the three coordinates of a point at once. Returns 1 where a pivot is 0 or not a number. */
static int invert(block a) {
#pragma GCC unroll 4
  for (int p = 0; p < NB; p += 3) {
    vector column[3][PARTS];
    double m[3][3], inverse[3][3], determinant = 0; /* column by column, as the block */
    for (int c = 0; c < 3; c++) for (int r = 0; r < 3; r++) m[c][r] = a[p + c][p + r];
    for (int c = 0; c < 3; c++)
      for (int r = 0; r < 3; r++) { /* cofactors */
        const int c_1 = (c + 1) % 3, c_2 = (c + 2) % 3, r_1 = (r + 1) % 3, r_2 = (r + 2) % 3;
        inverse[r][c] = m[c_1][r_1] * m[c_2][r_2] - m[c_1][r_2] * m[c_2][r_1];
      }
    for (int c = 0; c < 3; c++) determinant += m[c][0] * inverse[0][c];
    if (!(fabs(determinant) > 0)) return 1;
    for (int c = 0; c < 3; c++) for (int r = 0; r < 3; r++) inverse[c][r] *= 1 / determinant;
    for (int c = 0; c < 3; c++) {
      for (int r = 0; r < 3; r++) a[p + c][p + r] = 0;
      memcpy(column[c], a[p + c], sizeof column[c]);
    }
    for (int c = 0; c < NB; c++) {
      if (c >= p && c < p + 3) continue;
      const double x = a[c][p], y = a[c][p + 1], z = a[c][p + 2];
      const double s = inverse[0][0] * x + inverse[1][0] * y + inverse[2][0] * z;
      const double t = inverse[0][1] * x + inverse[1][1] * y + inverse[2][1] * z;
      const double u = inverse[0][2] * x + inverse[1][2] * y + inverse[2][2] * z;
      for (int v = 0; v < PARTS; v++) ((vector *)a[c])[v] -= s * column[0][v] + t * column[1][v] + u * column[2][v];
      a[c][p] = s; /* one by one: what is stored together and read apart waits */
      a[c][p + 1] = t;
      a[c][p + 2] = u;
    }
    for (int c = 0; c < 3; c++) {
      for (int v = 0; v < PARTS; v++)
        ((vector *)a[p + c])[v] = -(inverse[c][0] * column[0][v] + inverse[c][1] * column[1][v] + inverse[c][2] * column[2][v]);
      for (int r = 0; r < 3; r++) a[p + c][p + r] = inverse[c][r];
    }
  }
  return 0;
}

/* Block elimination in place: `diagonal` becomes the inverses of the pivot blocks, `below` is multiplied by the one before. */
static int factor(work *w) {
  for (int l = 1; l <= NLEV; l++) {
    if (l > 1) {
      block product ALIGNED;
      for (int c = 0; c < NB; c++) {
        vector sum[PARTS] = {{0}};
        for (int k = 0; k < NB; k++)
          for (int v = 0; v < PARTS; v++) sum[v] += ((vector *)w->matrix.below[l][k])[v] * w->matrix.diagonal[l - 1][c][k];
        memcpy(product[c], sum, sizeof sum);
      }
      for (int c = 0; c < NB; c++)
        for (int k = 0; k < NB; k++)
          for (int v = 0; v < PARTS; v++) ((vector *)w->matrix.diagonal[l][c])[v] -= ((vector *)product[k])[v] * w->matrix.above[l][c][k];
      memcpy(w->matrix.below[l], product, sizeof product);
    }
    if (invert(w->matrix.diagonal[l])) return 1;
  }
  return 0;
}

/* sum = start + sign * (block times x); columns in two sums that do not wait for each other */
static void multiply(block a, const double *x, double sign, const double *start, double *sum) {
  vector total[2][PARTS] = {{{0}}};
  memcpy(total[0], start, NB * sizeof(double));
  for (int c = 0; c < NB; c++)
    for (int v = 0; v < PARTS; v++) total[c % 2][v] += ((vector *)a[c])[v] * (sign * x[c]);
  for (int v = 0; v < PARTS; v++) total[0][v] += total[1][v];
  memcpy(sum, total[0], NB * sizeof(double));
}

static void multiply_lanes(block a, const vector *x, double sign, const vector *start, vector *sum) {
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
    for (int l = 2; l <= NLEV; l++) multiply(w->matrix.below[l], b[l - 1], -1, b[l], b[l]);       \
    for (int l = NLEV; l >= 1; l--) {                                                      \
      if (l < NLEV) multiply(w->matrix.above[l + 1], b[l + 1], -1, b[l], b[l]);                   \
      multiply(w->matrix.diagonal[l], b[l], 1, zero, b[l]);                                       \
    }                                                                                      \
  }
SOLVE(solve, double, multiply)
SOLVE(solve_lanes, vector, multiply_lanes)

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
  double rate = 1 / step;
  vector time = (vector){0} + step, *force = w->in_forces.force, *states = w->in_forces.states, *matrix = w->in_forces.matrix;
  batch *b = &w->in_forces.b;
  memset(w->force, 0, sizeof w->force);
  for (int first = 0; first < NLEV; first += LANES) {
    int count = gather(w, first, b);
    const vector *arg[] = {b->x[0], b->x[1], b->v[0], b->v[1], b->y, &time, w->packed_P[first / LANES], w->packed_theta, w->trusted[first / LANES]};
    vector *res[] = {force, states, w->pull[first / LANES], matrix};
    if (with_tangent) segment_tangent_lanes(arg, res);
    else segment_motion_lanes(arg, res);
    for (int lane = 0; lane < count; lane++) {
      int s = first + lane;
      for (int i = 0; i < NB; i++) { w->force[s][i] += force[i][lane]; w->force[s + 1][i] += force[NB + i][lane]; }
      for (int k = 0; k < NEDGE; k++) w->rate[s][k] = states[k][lane];
    }
    if (with_tangent) scatter(w, first, count, matrix);
  }
  for (int l = 1; l <= NLEV && with_tangent; l++)
    for (int i = 0; i < NB; i++) w->matrix.diagonal[l][i][i] += w->P[l - 1][MASS] * rate * rate;
}

/* Forces, and the factored tangent M / step^2 + d force / d positions of a stage; returns whether that has failed. */
static int assemble(stepper *m, work *w, double step) {
  forces(w, step, 1);
  m->factors++;
  return factor(w) != 0;
}

/* The edges' pulls at the last evaluation are trusted from now on. */
static void trust(work *w) { memcpy(w->trusted, w->pull, sizeof w->pull); }

#if TIMED
static void know_time(work *w) { w->packed_theta[CLOCK] = (vector){0} + w->theta[CLOCK]; }
#endif

static void pack(work *w) {
  for (int s = 0; s < BATCHES * LANES; s++)
    for (int k = 0; k < NPROP; k++) w->packed_P[s / LANES][k][s % LANES] = w->P[s < NLEV ? s : NLEV - 1][k];
}
