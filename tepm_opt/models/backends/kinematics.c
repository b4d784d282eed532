/* Inverse kinematics on the network of statics.c, which stands above in the same unit: levels and forces that have wanted
   observations, and the inputs that make the forces. kinematics.py is the reference twin.

   Macros as there, and ALLOCATION_STEPS, ALLOCATION_PRECISION (N), SEED_STEPS, SEED_TOLERANCE (N), LIMIT_SLACK (parts of a range). */

enum { HALF = NU / 2, NOBS = NPOINT + NLEN };

/* Solve the square system of n equations, matrix[row][column] row by row, in place of the right-hand side b. Returns 1 if singular. */
static int solve_dense(int n, double *matrix, double *b) {
  for (int k = 0; k < n; k++) {
    int pivot = k;
    for (int r = k + 1; r < n; r++) if (fabs(matrix[r * n + k]) > fabs(matrix[pivot * n + k])) pivot = r;
    if (!(fabs(matrix[pivot * n + k]) > 0)) return 1;
    for (int c = 0; c < n; c++) { double t = matrix[k * n + c]; matrix[k * n + c] = matrix[pivot * n + c]; matrix[pivot * n + c] = t; }
    double t = b[k]; b[k] = b[pivot]; b[pivot] = t;
    for (int r = k + 1; r < n; r++) {
      double scale = matrix[r * n + k] / matrix[k * n + k];
      for (int c = k; c < n; c++) matrix[r * n + c] -= scale * matrix[k * n + c];
      b[r] -= scale * b[k];
    }
  }
  for (int k = n - 1; k >= 0; k--) {
    for (int c = k + 1; c < n; c++) b[k] -= matrix[k * n + c] * b[c];
    b[k] /= matrix[k * n + k];
  }
  return 0;
}

/* Newton on the levels w->x and the effective pressures in w->a together, until the HALF weighted sums of the observations have
   their targets in equilibrium; leaves the observations there. `max_step`: largest change of a pressure in a step. Returns a status. */
static int solve_together(work *w, const double *external, const double *weights, const double *targets, double max_step,
                          double target_tolerance, double tolerance, int max_iterations, double *observed, double *info) {
  int status = EXHAUSTED, iteration;
  memcpy(w->x[0], w->level_0, sizeof w->level_0);
  for (iteration = 0; iteration < max_iterations; iteration++) {
    double (*by_a)[NU] = w->inverse.by_a, (*shift)[NLEV + 1][NB] = w->inverse.shift, *matrix = w->inverse.matrix;
    double by_external[ROWS * NEXT], change[HALF], step = 0, away = 0;
    assemble(w, 0);
    if (factor(w)) { status = INDEFINITE; break; }
    look(w, observed);
    for (int row = 0; row < HALF; row++) {
      double error = -targets[row];
      for (int k = 0; k < NOBS; k++) error += weights[row * NOBS + k] * observed[k];
      change[row] = -error;
      if (!(fabs(error) <= away)) away = fabs(error);
    }
    info[1] = residual(w);
    if (away < target_tolerance && info[1] < tolerance) { status = SOLVED; break; }
    if (!(away < 1e3)) { status = STALLED; break; }
    for (int row = 0; row < HALF; row += ROWS)
      adjoint(w, w->a, 1, external, HALF - row < ROWS ? HALF - row : ROWS, weights + row * NOBS, by_a[row], by_external, 0, shift[row][0]);
    for (int row = 0; row < HALF; row++) {
      for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) change[row] -= shift[row][l][i] * w->force[l][i]; /* what settling does */
      for (int k = 0; k < HALF; k++) matrix[row * HALF + k] = by_a[row][k];
    }
    if (solve_dense(HALF, matrix, change)) { status = STALLED; break; }
    for (int k = 0; k < HALF; k++) if (fabs(change[k]) > step) step = fabs(change[k]);
    for (int k = 0; k < HALF; k++) w->a[k] += change[k] * (step > max_step ? max_step / step : 1);
    set_properties(w, external);
    gradient(w);
    newton_step(w);
    move(&w->turns, w->x, w->step, 1, w->trial);
    memcpy(w->x, w->trial, sizeof w->x);
  }
  info[0] = iteration;
  return status;
}

/* Effective pressures a[0 … HALF) and levels x, in place, at which HALF weighted sums of the observations have their targets in
   equilibrium. Meant for starts nearby; returns SOLVED, or another status and leaves the rest to a safeguarded method. */
int inverse(double *x, double *a, const double *external, const double *theta, const double *weights, const double *targets,
            double max_step, double target_tolerance, double tolerance, int max_iterations, double *info) {
  double observed[NOBS];
  work *w = prepare(a, 1, external, theta);
  if (!w) return STALLED;
  memcpy(w->x, x, sizeof w->x);
  int status = solve_together(w, external, weights, targets, max_step, target_tolerance, tolerance, max_iterations, observed, info);
  memcpy(x, w->x, sizeof w->x);
  memcpy(a, w->a, HALF * sizeof(double));
  free(w);
  return status;
}

/* Equilibrium under the effective actuation a from levels x, in place, and derivatives of `rows` weighted sums of the observations
   by a, (rows, NU). info: as of `statics`. Returns a status. */
int response(double *x, const double *a, const double *external, const double *theta, int rows, const double *weights,
             double tolerance, int max_iterations, double *observed, double *by_a, double *info) {
  double by_external[ROWS * NEXT];
  work *w = prepare(a, 1, external, theta);
  if (!w) return STALLED;
  memcpy(w->x, x, sizeof w->x);
  int status = settle(w, tolerance, max_iterations, info);
  memcpy(x, w->x, sizeof w->x);
  look(w, observed);
  if (status == SOLVED) {
    assemble(w, 0); /* settling may leave the factor of a step before */
    if (factor(w)) status = INDEFINITE;
    for (int row = 0; status == SOLVED && row < rows; row += ROWS)
      adjoint(w, a, 1, external, rows - row < ROWS ? rows - row : ROWS, weights + row * NOBS, by_a + row * NU, by_external, 0, 0);
  }
  free(w);
  return status;
}

/* How axial forces become inputs: interface.py, `Allotment`. */
typedef struct { work *w; const double *start, *limit, *grid; double area; int fine; } allotment;

/* Axial forces that the inputs miss; returns the largest. */
static double missing_forces(const allotment *by, const double *inputs, const double *forces, double *missing) {
  double a[NU], largest = 0;
  map_inputs(by->w, inputs, a);
  for (int k = 0; k < HALF; k++) {
    missing[k] = forces[k] - (by->area * a[k] - a[HALF + k]);
    if (!(fabs(missing[k]) <= largest)) largest = fabs(missing[k]);
  }
  return largest;
}

/* Change the pressures (first = 0) or the tensions (first = HALF), within limits, until the forces are met or nothing moves.
   Where an input does not answer (a dead zone), its steps double until it does. */
static void correct(const allotment *by, double *inputs, const double *forces, int first) {
  double boost[HALF], before[HALF], missing[HALF], gain = first ? -1 : 1 / by->area;
  for (int k = 0; k < HALF; k++) { boost[k] = 1; before[k] = INFINITY; }
  for (int step = 0; step < ALLOCATION_STEPS; step++) {
    double moved = 0;
    if (missing_forces(by, inputs, forces, missing) < ALLOCATION_PRECISION) return;
    for (int k = 0; k < HALF; k++) {
      int same_side = (missing[k] > 0) == (before[k] > 0) && (missing[k] < 0) == (before[k] < 0); /* what was overshot did answer */
      double *input = inputs + first + k, limit = by->limit[first + k];
      boost[k] = same_side && fabs(missing[k]) > 0.9 * fabs(before[k]) ? 2 * boost[k] : 1;
      before[k] = missing[k];
      double changed = *input + gain * boost[k] * missing[k];
      changed = changed < 0 ? 0 : changed > limit ? limit : changed;
      if (!(fabs(changed - *input) <= moved)) moved = fabs(changed - *input);
      *input = changed;
    }
    if (moved / fabs(gain) < ALLOCATION_PRECISION) return;
  }
}

/* Inputs on their grids: whole steps from 0 to the largest one within the limit; continuous ones stay. */
static void put_on_grid(const allotment *by, const double *inputs, double *rounded, int count) {
  for (int k = 0; k < count; k++) {
    double step = by->grid[k], whole = step > 0 ? rint(inputs[k] / step) : 0, most = step > 0 ? floor(by->limit[k] / step * (1 + 1e-12)) : 0;
    rounded[k] = step > 0 ? (whole < 0 ? 0 : whole > most ? most : whole) * step : inputs[k];
  }
}

/* Inputs that make the axial forces, exact and on the grids; returns the largest force missed by the exact ones. */
static double make_inputs(const allotment *by, const double *forces, double *inputs, double *rounded) {
  double missing[HALF];
  memcpy(inputs, by->start, NU * sizeof(double));
  correct(by, inputs, forces, 0);
  if (by->fine) {
    put_on_grid(by, inputs, inputs, HALF);
    correct(by, inputs, forces, HALF);
  }
  put_on_grid(by, inputs, rounded, NU);
  return missing_forces(by, inputs, forces, missing);
}

/* `make_inputs` for one set of forces. */
double allocate(const double *forces, const double *theta, const double *start, const double *limit, const double *grid, double area,
                int fine, double *inputs, double *rounded) {
  allotment by = {take(theta), start, limit, grid, area, fine};
  if (!by.w) return INFINITY;
  double missed = make_inputs(&by, forces, inputs, rounded);
  free(by.w);
  return missed;
}

/* Configurations whose first three weighted sums are the targets, (count, 3), and whose other sums are 0, with the inputs that
   hold them: each from the one before, the first from levels x and effective pressures a, which are brought into equilibrium
   before where `cold`. Ends at the first that fails, has a length below `shortest` or needs forces beyond [low, high].
   Of each: levels, effective actuation, observed, inputs, rounded, info (steps, residual in N, force missed in N, room: the smallest
   distance of a force to its limits over its range). Returns a status, and into `solved` how many come before it. */
int configurations(int count, const double *targets, int cold, const double *x, const double *a, const double *external,
                   const double *theta, const double *weights, const double *low, const double *high, double max_step, double tolerance,
                   double force_tolerance, double shortest, int max_iterations, const double *start, const double *limit, const double *grid, double area,
                   int fine, double *levels, double *actuations, double *observed, double *inputs, double *rounded, double *info,
                   int *solved) {
  work *w = prepare(a, 1, external, theta);
  allotment by = {w, start, limit, grid, area, fine};
  int status = SOLVED;
  *solved = 0;
  if (!w) return STALLED;
  memcpy(w->x, x, sizeof w->x);
  if (cold) status = settle(w, SEED_TOLERANCE, SEED_STEPS, info);
  for (; status == SOLVED && *solved < count; ++*solved) {
    double sums[HALF] = {0}, forces[HALF];
    memcpy(sums, targets, 3 * sizeof(double));
    status = solve_together(w, external, weights, sums, max_step, tolerance, force_tolerance, max_iterations, observed, info);
    for (int k = NPOINT; k < NOBS; k++) if (!(observed[k] >= shortest)) status = STALLED;
    info[3] = INFINITY;
    for (int k = 0; k < HALF; k++) {
      forces[k] = area * w->a[k];
      double room = fmin(forces[k] - low[k], high[k] - forces[k]) / (high[k] - low[k]);
      if (room < info[3]) info[3] = room;
    }
    memcpy(levels, w->x, sizeof w->x);
    memcpy(actuations, w->a, sizeof w->a);
    if (status == SOLVED && info[3] < -LIMIT_SLACK) status = BEYOND;
    if (status != SOLVED) break;
    info[2] = make_inputs(&by, forces, inputs, rounded);
    targets += 3; levels += (NLEV + 1) * NB; actuations += NU; observed += NOBS; inputs += NU; rounded += NU; info += 4;
  }
  free(w);
  return status;
}
