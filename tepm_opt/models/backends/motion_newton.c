/* Velocities of a stage that began at x_0. */
static void velocities(work *w, double step, levels x_0) {
  const double rate = 1 / step;
  for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) w->v[l][i] = (w->x[l][i] - x_0[l][i]) * rate;
}

/* Solve M (v - v_0) / step + force = 0 with v = (x - x_0) / step for w->x and w->v, from w->x; returns whether that failed. The matrix,
   written where the solution is expected but with the edges' pulls of the last stage that was solved, serves while it contracts. */
static int newton(stepper *m, work *w, double step, levels x_0, levels v_0, int last_try) {
  const double rate = 1 / step;
  double before = 0;
  int stale = 1;
  double (*guess)[NB] = w->in_newton.guess, (*from)[NB] = w->in_newton.from;
  memcpy(guess, w->x, sizeof w->x);
  for (int iteration = 0; iteration < STAGE_ITERATIONS; iteration++) {
    double largest = 0, size = 0, corrected = 0;
    velocities(w, step, x_0);
    if (!stale) forces(w, step, 0);
    else if (assemble(m, w, step)) return 1;
    for (int l = 1; l <= NLEV; l++) {
      double mass = w->P[l - 1][MASS] * rate;
      for (int i = 0; i < NB; i++) {
        double r = w->step[l][i] = w->force[l][i] + mass * (w->v[l][i] - v_0[l][i]);
        largest = fabs(r) <= largest ? largest : fabs(r); /* and where it is no number */
      }
    }
    if (largest < m->tolerance) {
      trust(w);
      return 0;
    }
    if (!(largest < 1e12)) return 1;
    solve(w, w->step);
    memcpy(from, w->x, sizeof w->x);
    move(&w->turns, from, w->step, -1, w->x);
    for (int l = 1; l <= NLEV; l++)
      for (int i = 0; i < NB; i++) {
        corrected = larger(fabs(w->x[l][i] - guess[l][i]), corrected);
        size = larger(fabs(w->step[l][i]), size);
      }
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
