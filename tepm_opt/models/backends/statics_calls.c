/* What is called from outside of the loops of statics.c, which stand above in the same unit: each call takes its `work` from the heap. */

static work *take(const double *theta) {
  work *w = aligned_alloc(64, (sizeof(work) + 63) / 64 * 64);
  if (w) w->theta = theta;
  return w;
}

static work *prepare(const double *u, int mapped, const double *external, const double *theta) {
  work *w = take(theta);
  if (!w) return 0;
  if (mapped) memcpy(w->a, u, sizeof w->a);
  else map_inputs(w, u, w->a);
  set_properties(w, external);
  return w;
}

/* Effective actuation a under the commanded u. Returns a status. */
int actuation(const double *u, const double *theta, double *a) {
  work *w = take(theta);
  if (!w) return STALLED;
  map_inputs(w, u, a);
  free(w);
  return SOLVED;
}

/* Equilibrium from the start x, levels 0 … NLEV, in place; `mapped`: u is the effective actuation.
   observed: points in G, lengths. info: iterations, residual in N, energy in J. Returns a status. */
int statics(double *x, const double *u, int mapped, const double *external, const double *theta, double tolerance, int max_iterations,
            double *observed, double *info) {
  work *w = prepare(u, mapped, external, theta);
  if (!w) return STALLED;
  memcpy(w->x, x, sizeof w->x);
  int status = settle(w, tolerance, max_iterations, info);
  memcpy(x, w->x, sizeof w->x);
  look(w, observed);
  free(w);
  return status;
}

/* Gradients of `rows` weighted sums of the observations (points in G, then lengths) at an equilibrium x, with respect to
   u (the effective actuation if `mapped`), external forces and, unless by_theta is null, parameters. Returns a status. */
int sensitivity(const double *x, const double *u, int mapped, const double *external, const double *theta, int rows,
                const double *weights, double *by_u, double *by_external, double *by_theta) {
  work *w = prepare(u, mapped, external, theta);
  if (!w) return STALLED;
  memcpy(w->x, x, sizeof w->x);
  memcpy(w->x[0], w->level_0, sizeof w->level_0);
  assemble(w, 0);
  if (factor(w)) { free(w); return INDEFINITE; }
  for (int row = 0; row < rows; row += ROWS)
    adjoint(w, u, mapped, external, rows - row < ROWS ? rows - row : ROWS, weights + row * (NPOINT + NLEN), by_u + row * NU,
            by_external + row * NEXT, by_theta ? by_theta + row * NTHETA : 0, 0);
  free(w);
  return SOLVED;
}

/* The matrix of the free levels in the panels in lower banded storage, column by column: (NLEV * NB, 2 * NB). */
static void store_band(work *w, double *band) {
  for (int l = 1; l <= NLEV; l++)
    for (int c = 0; c < NB; c++) for (int r = 0; r < 2 * NB; r++) *band++ = c + r < 2 * NB ? w->panel[l][c][c + r] : 0;
}

/* Stiffness and damping matrices of the free levels at x in lower banded storage; `mapped`: u is the effective actuation.
   Returns a status. */
int matrices(const double *x, const double *u, int mapped, const double *external, const double *theta, double *stiffness,
             double *damping) {
  work *w = prepare(u, mapped, external, theta);
  if (!w) return STALLED;
  memcpy(w->x, x, sizeof w->x);
  memcpy(w->x[0], w->level_0, sizeof w->level_0);
  assemble(w, 0);
  store_band(w, stiffness);
  for (int s = 0; s < NLEV; s++) {
    const double *arg[] = {w->x[s], w->x[s + 1], w->P[s], theta};
    double *res[] = {w->first, w->second};
    segment_damping(arg, res);
    place(w, s);
  }
  store_band(w, damping);
  free(w);
  return SOLVED;
}
