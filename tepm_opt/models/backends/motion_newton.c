/* Velocities of a stage that began at x_0. */
static void velocities(work *w, double step, levels x_0) {
  const double rate = 1 / step;
  for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) w->v[l][i] = (w->x[l][i] - x_0[l][i]) * rate;
}

static inline vector larger_lanes(vector a, vector b) { /* not a number where b is none */
  lanes_mask keep = (lanes_mask)(b <= a);
  return (vector)((keep & (lanes_mask)a) | (~keep & (lanes_mask)b));
}

/* Largest size of what all levels above 0 have. */
static double largest_of(levels values) {
  const lanes_mask size = (lanes_mask){0} + 0x7fffffffffffffff; /* all bits but the sign */
  const double *value = values[1];
  vector most[4] = {{0}}; /* which do not wait for each other */
  double largest = 0;
  int k = 0;
  for (; k + 4 * LANES <= NLEV * NB; k += 4 * LANES)
    for (int i = 0; i < 4; i++) most[i] = larger_lanes(most[i], (vector)((lanes_mask)(*(const vector *)(value + k + i * LANES)) & size));
  most[0] = larger_lanes(larger_lanes(most[0], most[1]), larger_lanes(most[2], most[3]));
  for (int lane = 0; lane < LANES; lane++) largest = most[0][lane] <= largest ? largest : most[0][lane];
  for (; k < NLEV * NB; k++) largest = fabs(value[k]) <= largest ? largest : fabs(value[k]);
  return largest;
}

/* Solve M (v - v_0) / step + force = 0 with v = (x - x_0) / step for w->x and w->v, from w->x; returns whether that failed. The matrix,
   written where the solution is expected but with the edges' pulls of the last stage that was solved, serves while it contracts. */
static int newton(stepper *m, work *w, double step, levels x_0, levels v_0, int last_try) {
  const double rate = 1 / step;
  double before = 0;
  int stale = 1;
  double (*guess)[NB] = w->in_newton.guess, (*from)[NB] = w->in_newton.from, (*correction)[NB] = w->in_newton.correction;
  memcpy(guess, w->x, sizeof w->x);
  for (int iteration = 0; iteration < STAGE_ITERATIONS; iteration++) {
    velocities(w, step, x_0);
    if (!stale) forces(w, step, 0);
    else if (assemble(m, w, step)) return 1;
    for (int l = 1; l <= NLEV; l++) {
      double mass = w->P[l - 1][MASS] * rate;
      for (int i = 0; i < NB; i++) w->step[l][i] = w->force[l][i] + mass * (w->v[l][i] - v_0[l][i]);
    }
    double largest = largest_of(w->step);
    if (largest < m->tolerance) {
      trust(w);
      return 0;
    }
    if (!(largest < 1e12)) return 1;
    solve(w, w->step);
    memcpy(from, w->x, sizeof w->x);
    move(&w->turns, from, w->step, -1, w->x);
    for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) correction[l][i] = w->x[l][i] - guess[l][i];
    double size = largest_of(w->step), corrected = largest_of(correction);
    if (corrected > m->max_correction && !last_try) return 1; /* too far to trust that this is the solution nearby */
    m->iterations++;
    double contraction = iteration ? size / before : 1;
    before = size;
    stale = iteration && contraction > SLOW; /* the next iteration has a matrix of its own */
    if (stale) trust(w);
    if (size * contraction < m->close || (iteration && largest * contraction < m->tolerance)) { /* the step just taken has done it */
      velocities(w, step, x_0);
      if (NEDGE) forces(w, step, 0);
      trust(w);
      return 0;
    }
  }
  return 1;
}
