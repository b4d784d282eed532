/* Velocities of a stage that began at x_0. */
static void velocities(work *w, real step, levels x_0) {
  const real rate = 1 / step;
  for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) w->v[l][i] = (w->x[l][i] - x_0[l][i]) * rate;
}

/* Solve M (v - v_0) / step + force = 0 with v = (x - x_0) / step for w->x and w->v, from w->x; returns where that failed. The matrix,
   written where the solution is expected but with the edges' pulls of the last stage that was solved, serves while it contracts. */
static mask newton(stepper *m, work *w, real step, levels x_0, levels v_0, mask last_try, mask on) {
  const real rate = 1 / step;
  real before = ZERO, contraction;
  mask going = on, stale = on, failed = NONE;
  real (*guess)[NB] = w->in_newton.guess, (*from)[NB] = w->in_newton.from;
  memcpy(guess, w->x, sizeof w->x);
  for (int iteration = 0; iteration < STAGE_ITERATIONS && any(going); iteration++) {
    velocities(w, step, x_0);
    if (any(stale)) failed |= assemble(m, w, step, stale, !iteration) & stale;
    else forces(w, step, 0);
    real largest = ZERO, size = ZERO, corrected = ZERO;
    for (int l = 1; l <= NLEV; l++) {
      real mass = w->P[l - 1][MASS] * rate;
      for (int i = 0; i < NB; i++) {
        real r = w->step[l][i] = w->force[l][i] + mass * (w->v[l][i] - v_0[l][i]);
        largest = pick(WHERE(absolute(r) <= largest), largest, absolute(r)); /* and where it is no number */
      }
    }
    mask solved = going & ~failed & WHERE(largest < m->tolerance);
    trust(w, solved);
    failed |= going & ~WHERE(largest < 1e12);
    going &= ~failed & ~solved;
    if (!any(going)) break;
    solve(w, w->step);
    memcpy(from, w->x, sizeof w->x);
    move(&w->turns, from, w->step, -1, w->x);
    for (int l = 1; l <= NLEV; l++)
      for (int i = 0; i < NB; i++) {
        corrected = larger(absolute(w->x[l][i] - guess[l][i]), corrected);
        size = larger(absolute(w->step[l][i]), size);
      }
    blend(w->x, from, sizeof w->x, ~going);
    failed |= going & WHERE(corrected > m->max_correction) & ~last_try; /* too far to trust that this is the solution nearby */
    going &= ~failed;
    m->iterations += pick(going, each(1), ZERO);
    contraction = iteration ? size / before : each(1);
    before = size;
    stale = iteration ? going & WHERE(contraction > SLOW) : NONE; /* the next iteration has a matrix of its own */
    trust(w, stale);
    solved = going & WHERE(size * contraction < m->close);
    if (iteration) solved |= going & WHERE(largest * contraction < m->tolerance);
    if (any(solved)) { /* the step just taken has done it */
      velocities(w, step, x_0);
      if (NEDGE) forces(w, step, 0);
      trust(w, solved);
      going &= ~solved;
      stale &= going;
    }
  }
  return failed | going;
}
